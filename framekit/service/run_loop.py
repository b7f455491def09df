"""The loop of a run: it acts at once when blocks have come due, by a timer when they come due later."""

from __future__ import annotations

from collections.abc import Callable

from framekit.definition.times import NEVER
from framekit.transport.clock import Clock


class RunLoop:
    """Calls `act(now)` when work is due, between `start` and `stop`.

    `next_time()` returns the time of the next work; 0: now.
    """

    def __init__(self, clock: Clock, act: Callable[[int], None], next_time: Callable[[], int]) -> None:
        self.clock = clock
        self.inside = False
        """Whether an event is being handled; its source calls `end` afterwards."""
        self._now = clock.now
        self._act = act
        self._next_time = next_time
        self._ask_soon = clock.bell(self._beat)
        self._alarm = clock.alarm(self._beat)
        self._woken = False
        """Whether a call of `act` is scheduled, or in progress."""
        self._moved = False
        """Whether the timer must be set at the end of the event."""
        self._running = False

    def start(self) -> None:
        """Begin to call, as soon as `wake` or `set` is called."""
        self._running = True

    def stop(self) -> None:
        """End the calls."""
        self._running = False
        self._alarm.cancel()

    def wake(self) -> None:
        """Request a call soon: a block came due between two calls."""
        if not self._woken and self._running:
            self._woken = True
            if not self.inside:
                self._ask_soon()

    def look(self) -> None:
        """Set the timer, at the end of an event that is being handled: the next time may have changed."""
        if self.inside or self._woken:
            self._moved = True
        else:
            self.set()

    def end(self) -> None:
        """Act, if the event that has been handled made blocks due."""
        self.inside = False
        if self._woken:
            self._beat()
        elif self._moved:
            self.set()

    def set(self) -> None:
        """Set the timer: the next time may have changed."""
        self._moved = False
        if self._running:
            self._alarm.set(self._next_time() or self._now())
        else:
            self._alarm.cancel()

    def _beat(self) -> None:
        """Act; a call after an event that has acted already finds no block due."""
        self._woken = True  # the timer is set at the end, so that it includes blocks that come due meanwhile
        try:
            if self._running:
                self._act(self._now())
        finally:
            self._woken = self._moved = False
            self._alarm.set((self._next_time() or self._now()) if self._running else NEVER)
