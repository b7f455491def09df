"""When a run does what is due: soon, once something has come due by itself, and at the next time known beforehand.

One call of the clock for each, or none where an event of a line is just being dealt with: then its end is soon enough.
What is done, and what is due next, is the run's business.
"""

from __future__ import annotations

from collections.abc import Callable

from framekit.definition.times import NEVER
from framekit.transport.clock import Clock


class Pulse:
    """Calls `act(now)` when something is due, between `start` and `stop`; `next_time(now)` says when that is.

    `inside`: an event is being dealt with; whoever says so calls `end` afterwards. `first(now)`, once it has been set,
    is called before everything else until `first_until`, which `next_time` may set: when something has to go before it.
    """

    def __init__(self, clock: Clock, act: Callable[[int], None], next_time: Callable[[int], int]) -> None:
        self.clock = clock
        self.inside = False
        self.first: Callable[[int], None] | None = None
        self._act = act
        self._next_time = next_time
        self._ask_soon = clock.bell(self._beat)
        self._alarm = clock.alarm(self._beat)
        self.first_until = NEVER
        self._woken = False
        self._running = False

    def start(self) -> None:
        """From now on it calls, as soon as somebody says `wake` or `set`."""
        self._running = True

    def stop(self) -> None:
        """It calls no more."""
        self._running = False
        self._alarm.cancel()

    def wake(self) -> None:
        """Something came due between two calls: one call soon is enough for all of it."""
        if not self._woken and self._running:
            self._woken = True
            if not self.inside:
                self._ask_soon()

    def end(self) -> None:
        """The event has been dealt with."""
        self.inside = False
        if self._woken:
            self._beat()

    def set(self) -> None:
        """What is due next may be due at another time."""
        if not self._running:
            self._alarm.cancel()
            return
        now = self.clock.now()
        due = self._next_time(now)
        self._alarm.set(due if due > now or due == NEVER else now)

    def _beat(self) -> None:
        """As asked for; where an event came first, that has done it already, and this finds nothing due."""
        self._woken = True  # what comes due meanwhile is in the next time the timer is set for
        try:
            if self._running:
                now = self.clock.now()
                if self.first is not None and now < self.first_until:
                    self.first(now)
                self._act(now)
        finally:
            self._woken = False
            self.set()
