"""Report that the process stood still: it was suspended, or the machine was asleep or overloaded.

Each look passes the joined reports of troubles on, too.
"""

from __future__ import annotations

from framekit.run.trouble import SECOND, Troubles, lasted
from framekit.transport.clock import Clock

EVERY = 2 * SECOND
"""Time between two looks at the clock (ns)."""
LONG = 5 * SECOND
"""A look that is later than this (ns) is reported."""


class Standstill:
    """Compares the times of looks with the times that were asked for, between `start` and `stop`."""

    def __init__(self, clock: Clock, troubles: Troubles, run: str) -> None:
        self._clock, self._troubles, self._run = clock, troubles, run
        self._due = 0
        self._round = 0
        """Number of calls of `start` and `stop`; looks of earlier rounds have no effect."""

    def start(self) -> None:
        """Begin to look."""
        self._round += 1
        self._ask(self._clock.now() + EVERY, self._round)

    def stop(self) -> None:
        """End the looks."""
        self._round += 1

    def _ask(self, due: int, number: int) -> None:
        self._due = due
        self._clock.look_at(self._due, lambda: self._look(number))

    def _look(self, number: int) -> None:
        if number != self._round:
            return
        self._troubles.flush()
        now = self._clock.now()
        late = now - self._due
        if late > LONG:
            text = f"the process stood still for {lasted(late)} – it was suspended, or the machine asleep or overloaded"
            self._troubles.note(f"run {self._run}", text)
        self._ask(max(now, self._due) + EVERY, number)  # virtual time does not move for looks
