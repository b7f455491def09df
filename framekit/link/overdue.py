"""Requests whose reply did not come in time, and the late replies that carry the number of their request.

A reply with a number is never taken for the reply to another request: no request waits for it, and it closes exactly
its own request. It shows how slow its station is.
"""

from __future__ import annotations

from collections.abc import Mapping

from framekit.link.events import Exchange
from framekit.link.frame_table import FrameTable
from framekit.link.sequences.state import NO_NAMES, Run
from framekit.link.slow import NO_PROMPT, Prompt, SlowStations
from framekit.link.values import FrameValue, Names

LONGEST = 60_000_000_000
"""Upper limit of every hold, and of the time for which a request is open (ns)."""

HORIZON = 21
"""An open request is dropped after this many times its time limit: no later reply is expected."""

MOST_OPEN = 64
"""Upper limit of the number of open requests; the oldest is dropped first."""


Latest = tuple[int, Exchange | None]
"""When the last request left that waits for its reply (ns), and its exchange; 0 and None if none waits."""


class OpenRequest:
    """A request whose reply has not come and may still come."""

    __slots__ = (
        "asked", "at", "by_itself", "ends", "exchange", "frames", "is_foreign", "is_met", "is_passed", "names",
        "number", "sent", "station", "within",
    )  # fmt: skip

    def __init__(
        self, x: Exchange | None, sent: FrameValue | None, names: Names, at: int, within: int,
        frames: Mapping[str, None] = NO_NAMES,
    ) -> None:  # fmt: skip
        self.exchange = x
        self.asked = sent if x is None else x.asked
        self.sent, self.names = sent, names
        self.station = None if x is None else x.station
        self.frames = frames
        """Frames that the step waited for; empty: every reply of the role."""
        self.at, self.within = at, within
        self.number = 0
        """Number of this request among all that were ever open on the line."""
        self.ends = 0
        """Time after which no reply to it is expected."""
        self.by_itself = False
        """Whether a SEND block or a program sent it, without an exchange."""
        self.is_met = False
        """Whether its reply has come, presumably: a reply that could not be used, or the reply to a later request."""
        self.is_passed = False
        """Whether the reply to a later request, which could have been its own, has been proved."""
        self.is_foreign = False
        """Whether an engine of another protocol sent it: every frame may be its reply, and no frame closes it."""

    def fits(self, reply: FrameValue, table: FrameTable) -> bool:
        """Return whether a reply is of a kind that this request waited for, and repeats the fields of its `echo`."""
        is_kind = not self.frames or reply.frame in self.frames
        return is_kind and table.repeats(reply, self.asked, self.sent, self.names)

    def is_repeated_by(self, other: OpenRequest) -> bool:
        """Return whether another request is the same object, or has the same bytes and the same exchange."""
        if other is self:
            return True
        sent, again = self.sent, other.sent
        return self.exchange is other.exchange and sent is not None and again is not None and sent.raw == again.raw

    def limit(self, limits: Mapping[str, str]) -> str:
        """Return the name of the setting for its time limit; `limits`: the time limits, see `Replies`."""
        found = next((one for one in limits if self.names.get(one) == self.within), next(iter(limits), ""))
        return limits.get(found, "")

    def prompt(self, latest: Latest, now: int) -> Prompt:
        """Return the event that a present reply came with, and whether a slightly longer limit would have caught it.

        A request of a later exchange with the station, or a repeat of this request, may have prompted it.
        """
        left, exchange = latest
        is_same = exchange is self.exchange
        if exchange is None or not (is_same or exchange.station == self.station):
            return NO_PROMPT
        if left < self.at + self.within or now - left > self.within // 8:
            return NO_PROMPT
        return Prompt("repeat" if is_same else "request", now - self.at - self.within <= self.within // 8)


def request_of(run: Run, x: Exchange) -> OpenRequest:
    """Return the request whose reply a run waits for, or has waited for last."""
    frames = NO_NAMES if run.plan is None else run.plan.frames
    return OpenRequest(x, x.last_sent, x.names, run.started, run.longest, frames)


class NumberedRequests:
    """The overdue requests of a line whose replies carry their number, and the lateness of these replies."""

    __slots__ = ("_answered", "_last", "_piled", "_requests", "_slow", "_table", "is_watching")

    def __init__(self, table: FrameTable, slow: SlowStations) -> None:
        self._table, self._slow = table, slow
        self._requests: list[OpenRequest] = []
        """Overdue requests, oldest first; `ends` of each is set."""
        self._piled: set[OpenRequest] = set()
        """Requests that were sent while an older request was overdue: they may have waited for it in the device."""
        self._answered: dict[OpenRequest, int] = {}
        """Overdue requests that were repeated and got a reply then, each with the time of the reply (ns)."""
        self._last = 0
        """Time of the last late reply (ns)."""
        self.is_watching = False
        """Whether replies in time are noted too: a reply was overdue, and perhaps a station is still slow."""

    def add(self, request: OpenRequest, now: int) -> None:
        """Note a request whose time limit has run out."""
        self.is_watching = True
        self._drop([one for one in self._requests if one.ends <= now])
        request.within, request.ends = min(request.within, LONGEST), now + LONGEST
        if any(one.at + one.within <= request.at for one in self._requests):
            self._piled.add(request)
        self._requests.append(request)
        if len(self._requests) > MOST_OPEN:
            self._drop(self._requests[:1])

    def took(self, request: OpenRequest, now: int) -> None:
        """Note a reply to a request; if the same bytes were sent before, it may be the reply to these."""
        self._drop([one for one in self._requests if one.ends <= now])
        own = [one for one in self._requests if one.is_repeated_by(request)]
        if own:
            self._answered.setdefault(own[0], now)
        else:
            self._slow.answered_in_time(request.station, now)
            self.is_watching = bool(self._requests) or self._slow.number > 0

    def came(self, reply: FrameValue, limits: Mapping[str, str], latest: Latest, now: int) -> OpenRequest | None:
        """Return the overdue request that a reply answers, and note its lateness; None if it answers none.

        `limits`: the time limits, see `Replies`.
        """
        fitting = [one for one in self._requests if one.ends > now and one.fits(reply, self._table)]
        if not fitting:
            return None
        request = next(one for one in fitting if one.is_repeated_by(fitting[-1]))  # older ones: numbers begin again
        at = self._answered.get(request, now)
        begin = max(request.at, self._last) if request in self._piled else request.at
        self._last = at
        self._drop([request])
        if at - request.at >= request.within:  # else it was given up before
            time = max(at - begin, request.within)
            self._slow.answered_late(request.station, time, request.limit(limits), now, request.prompt(latest, at))
        return request

    def clear(self) -> None:
        """Drop all requests: no reply to them can come."""
        self._drop(list(self._requests))

    def _drop(self, requests: list[OpenRequest]) -> None:
        for request in requests:
            self._requests.remove(request)
            self._piled.discard(request)
            self._answered.pop(request, None)
