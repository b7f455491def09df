"""Distinguish the echo of a request from a reply with the same bytes.

A line has an echo if a client hears the frames that it sends. The states of a line:

    unknown   no proof yet; a reply equal to its request is suspected
      | a reply came that differs from its request, and no copy of the request before it
    absent    every reply is believed
      | a copy of the request came that no step takes
    present   the first copy of each request is the echo; only a second copy is a reply

A line with exact times needs no proof: an echo begins before the last bit of the request has left. Elsewhere an adapter
may report the echo late, so a transfer whose reply is suspected asks for another reply that cannot be equal
(`services.client`).
"""

from __future__ import annotations

import enum
from collections.abc import Callable
from typing import Any

from framekit.link.events import Exchange, Outcome
from framekit.link.sequences.state import Run
from framekit.link.values import FrameValue

OWN_ECHO = "you hear your own request: set `echo: yes`"
"""Cause of a failure after a copy of the request came and no reply."""

UNPROVED = "the reply equals the request, as an echo does, and no other reply came: set `echo: yes` or `echo: no`"
"""Cause of the failure of a transfer whose reply is suspected."""


class EchoState(enum.Enum):
    """Whether a line has an echo of its own requests."""

    UNKNOWN = "unknown"
    ABSENT = "absent"
    PRESENT = "present"


CAUSES = {EchoState.UNKNOWN: UNPROVED, EchoState.ABSENT: "", EchoState.PRESENT: OWN_ECHO}
"""For each state, why a suspected reply is not believed."""


class Suspicion(Exchange):
    """The end of an exchange whose reply may be an own echo."""

    __slots__ = ("suspected_exchange",)

    def __init__(self, exchange: Exchange) -> None:
        self.suspected_exchange = exchange

    def succeeded(self, results: dict[str, Any]) -> None:
        """Report the results as suspected."""
        self.suspected_exchange.suspected(results)

    def ended(self, outcome: Outcome) -> None:
        """Report the failure."""
        self.suspected_exchange.ended(outcome)


Transmission = tuple[int, int, int]
"""A key of a request that was sent."""

Prove = Callable[[Any, Callable[[str], None]], None]
"""Find out whether a suspected reply is an echo; report the reason why it is not believed, '' if it is."""


class OwnEcho:
    """The echo of a line, as far as the exchanges of an engine have shown it."""

    __slots__ = ("_copy", "_first", "_has_exact_times", "_heard", "state")

    def __init__(self, first: EchoState = EchoState.ABSENT, has_exact_times: bool = False) -> None:
        """`has_exact_times`: the port reports when each bit came and left; simulated ports do."""
        self.state = self._first = first
        self._has_exact_times = has_exact_times
        self._heard: Transmission | None = None
        """The last transmission of which a copy has come, which may be its echo."""
        self._copy: tuple[Transmission, bool] | None = None
        """The transmission that the offered frame follows, and whether the frame is a copy of it."""

    def forget(self) -> None:
        """Begin anew: the line may be another."""
        self.state = self._first
        self._heard = self._copy = None

    def heard(self, run: Run) -> bool:
        """Note a copy of the request of a run that no step takes. Return whether replies are examined."""
        if self._first is EchoState.ABSENT:
            return False
        self.state, self._heard = EchoState.PRESENT, transmission_of(run)
        return True

    def takes(self, run: Run, x: Exchange, value: FrameValue) -> bool:
        """Return whether a frame that is offered to a run is the echo of its request."""
        sent, is_copy = transmission_of(run), x.last_sent is not None and x.last_sent.raw == value.raw
        self._copy = sent, is_copy
        if not is_copy or self._heard == sent:
            return False
        if self.state is EchoState.PRESENT:
            return True
        return self._has_exact_times and (run.clock_waits or run.machine.receiver.given_since < run.started)

    def suspects(self) -> bool:
        """Note that a step took the frame that was offered last; return whether it may be the echo of its request."""
        sent, is_copy = self._copy or (None, True)
        if not is_copy:
            if self._heard != sent:
                self.state = EchoState.ABSENT
            return False
        if self.state is not EchoState.UNKNOWN or self._has_exact_times:
            return False
        self._heard = sent
        return True


def transmission_of(run: Run) -> Transmission:
    """Return a key of the request that a run sent last: the run, the number of its wait, repeats on the line."""
    return id(run), run.wait_number, run.machine.counters.repeated
