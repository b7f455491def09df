"""When a run, or what follows a memory, acts: one call soon for all that came due, a timer for what is due later."""

from __future__ import annotations

from collections.abc import Callable

from framekit.transport.clock import Clock


class RunLoop:
    """Calls `act(now)` when something is due, between `start` and `stop`; `next_time()` says when that is.

    `inside`: an event is being dealt with; what says so calls `end` afterwards.
    """

    def __init__(self, clock: Clock, act: Callable[[int], None], next_time: Callable[[], int]) -> None:
        self.clock = clock
        self.inside = False
        self._act = act
        self._next_time = next_time
        self._ask_soon = clock.bell(self._beat)
        self._alarm = clock.alarm(self._beat)
        self._woken = self._moved = False
        self._running = False

    def start(self) -> None:
        """From now on it calls, as soon as `wake` or `set` is called."""
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

    def look(self) -> None:
        """Nothing came due, but what is due next may be due at another time."""
        if self.inside or self._woken:
            self._moved = True
        else:
            self.set()

    def end(self) -> None:
        """The event has been dealt with."""
        self.inside = False
        if self._woken:
            self._beat()
        elif self._moved:
            self.set()

    def set(self) -> None:
        """What is due next may be due at another time."""
        self._moved = False
        if not self._running:
            self._alarm.cancel()
            return
        due = self._next_time()
        self._alarm.set(due if due else self.clock.now())

    def _beat(self) -> None:
        """As asked for; where an event came first, that has done it already, and this finds nothing due."""
        self._woken = True  # what comes due meanwhile is in the next time the timer is set for
        try:
            if self._running:
                self._act(self.clock.now())
        finally:
            self._woken = False
            self.set()
