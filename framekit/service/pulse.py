"""When a run does what is due: soon, once something has come due by itself, and at the next time known beforehand.

One call of the clock for each; what is done then, and what is due next, is the run's business.
"""

from __future__ import annotations

from collections.abc import Callable

from framekit.definition.times import NEVER
from framekit.transport.clock import Clock, Handle


class Pulse:
    """Calls `act(now)` when something is due, between `start` and `stop`; `next_time(now)` says when that is."""

    def __init__(self, clock: Clock, act: Callable[[int], None], next_time: Callable[[int], int]) -> None:
        self.clock = clock
        self._act = act
        self._next_time = next_time
        self._timer: Handle | None = None
        self._woken = False
        self._running = False

    def start(self) -> None:
        """From now on it calls, as soon as somebody says `wake` or `set`."""
        self._running = True

    def stop(self) -> None:
        """It calls no more."""
        self._running = False
        self._cancel()

    def wake(self) -> None:
        """Something came due between two calls: one call soon is enough for all of it."""
        if not self._woken and self._running:
            self._woken = True
            self.clock.call_soon(self._beat)

    def set(self) -> None:
        """What is due next may be due at another time."""
        self._cancel()
        if self._running:
            now = self.clock.now()
            due = self._next_time(now)
            if due < NEVER:
                self._timer = self.clock.call_at(max(due, now), self._beat)

    def _cancel(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _beat(self) -> None:
        self._woken = True  # what comes due meanwhile is in the next time the timer is set for
        try:
            if self._running:
                self._act(self.clock.now())
        finally:
            self._woken = False
            self.set()
