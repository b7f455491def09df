"""Clocks: real time on asyncio, and a virtual one on which a day passes in seconds.

Times are whole nanoseconds. Whoever uses a clock only asks for the time and for calls at a time; it never sleeps.
"""

from __future__ import annotations

import asyncio
import heapq
import itertools
import time
from collections.abc import Callable
from typing import Protocol

Callback = Callable[[], None]


class Handle(Protocol):
    """A call that is to come."""

    def cancel(self) -> None:
        """The call will not come; cancelling twice, or after the call, does nothing."""


class Clock(Protocol):
    """What everything above the ports needs to know of time."""

    def now(self) -> int: ...

    def call_at(self, when: int, callback: Callback) -> Handle: ...

    def call_soon(self, callback: Callback) -> Handle: ...


class _VirtualHandle:
    __slots__ = ("callback", "clock")

    def __init__(self, clock: VirtualClock, callback: Callback) -> None:
        self.clock = clock
        self.callback: Callback | None = callback

    def cancel(self) -> None:
        if self.callback is not None:
            self.callback = None
            self.clock.note_cancelled()


class VirtualClock:
    """Time that only moves when told to. Calls come in order of time, then of asking; a call may ask for more."""

    def __init__(self, start: int = 0) -> None:
        self._now = start
        self._calls: list[tuple[int, int, _VirtualHandle]] = []
        self._order = itertools.count()
        self._cancelled = 0

    def now(self) -> int:
        return self._now

    def call_at(self, when: int, callback: Callback) -> Handle:
        """Asks for a call at `when`, or now if that has passed."""
        handle = _VirtualHandle(self, callback)
        heapq.heappush(self._calls, (max(when, self._now), next(self._order), handle))
        return handle

    def call_soon(self, callback: Callback) -> Handle:
        return self.call_at(self._now, callback)

    def note_cancelled(self) -> None:
        """Cancelled calls are thrown out of the heap when they make up most of it."""
        self._cancelled += 1
        if self._cancelled > 64 and 2 * self._cancelled > len(self._calls):
            self._calls = [call for call in self._calls if call[2].callback is not None]
            heapq.heapify(self._calls)
            self._cancelled = 0

    @property
    def next_call(self) -> int | None:
        """When the next call is due; None if there is none."""
        while self._calls and self._calls[0][2].callback is None:
            heapq.heappop(self._calls)
            self._cancelled -= 1
        return self._calls[0][0] if self._calls else None

    def run_until(self, time: int) -> None:
        """Makes every call due up to `time`, and stands there."""
        while (due := self.next_call) is not None and due <= time:
            self._step()
        self._now = max(self._now, time)

    def run_for(self, duration: int) -> None:
        self.run_until(self._now + duration)

    def run_until_idle(self, limit: int) -> None:
        """Makes calls until none is left, or `limit` is reached."""
        while (due := self.next_call) is not None and due <= limit:
            self._step()

    def _step(self) -> None:
        when, _, handle = heapq.heappop(self._calls)
        callback, handle.callback = handle.callback, None
        self._now = when
        if callback is not None:
            callback()


class AsyncioClock:
    """Real time: the calls of an asyncio loop. Times are those of `time.monotonic_ns`."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self.loop = loop

    def now(self) -> int:
        return time.monotonic_ns()

    def call_at(self, when: int, callback: Callback) -> Handle:
        return self.loop.call_later(max(0, when - time.monotonic_ns()) / 1e9, callback)

    def call_soon(self, callback: Callback) -> Handle:
        return self.loop.call_soon(callback)
