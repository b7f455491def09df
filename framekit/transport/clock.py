"""Clocks: real time on asyncio, and a virtual one on which a day passes in seconds.

Times are whole nanoseconds. Users of a clock ask it for the time and for calls at a time; they never sleep.
"""

from __future__ import annotations

import asyncio
import heapq
import itertools
import time
from collections import deque
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from functools import partial
from typing import Protocol

from framekit.definition.times import NEVER
from framekit.link.scope import DEFAULT_START

Callback = Callable[[], None]

NEVER_EARLY = 1_000
"""Added to each real delay (ns): a loop's clock counts in floating seconds and may call a little early."""

TICK = 1_000_000
"""Unit of the timers of uvloop (ns)."""


class Handle(Protocol):
    """A call that a clock will make."""

    def cancel(self) -> None:
        """Cancel the call; a second cancel, or a cancel after the call, has no effect."""


class Clock(Protocol):
    """The contract of a clock with its users."""

    def now(self) -> int:
        """Return the time (ns); it never decreases."""

    def moment(self) -> int:
        """Return the requested time of the call under way, however late the call is; outside of calls the time."""

    def call_at(self, when: int, callback: Callback) -> Handle:
        """Ask for a call at `when`, never earlier; as soon as possible after that, but not within `call_at`."""

    def call_soon(self, callback: Callback) -> Handle:
        """Ask for a call as soon as possible, in the order of the requests."""

    def look_at(self, when: int, callback: Callback) -> None:
        """Ask for a call at about `when` that only observes, such as the output of a display.

        No transmission is heard in pieces because of it, and virtual time does not move for it.
        """

    def alarm(self, callback: Callback) -> Alarm:
        """Return an alarm that calls `callback`; it is not set."""

    def bell(self, callback: Callback) -> Callable[[], object]:
        """Return a function that asks for a call of `callback` as soon as possible each time it is called."""

    def lag(self, source: Lagging) -> None:
        """Let `source` report its late events before each call, and where virtual time stops."""

    def end_lag(self, source: Lagging) -> None:
        """Note that `source` has no late events any more."""


class Alarm(Protocol):
    """A call that is moved again and again: cheaper than a cancel and a new request."""

    def set(self, when: int) -> None:
        """Move the call to `when`, never earlier; NEVER: no call."""

    def cancel(self) -> None:
        """Cancel the call, and drop each reference of the clock to the callback."""


class Lagging(Protocol):
    """A source of events that saves calls: it reports events late, before they can matter (see `Clock.lag`)."""

    def behind(self, until: int) -> int | None:
        """Return the time of the first report due of the events up to `until`; None if no event is unreported."""

    def catch_up(self, until: int) -> None:
        """Report all events up to `until`, the time that `behind` returned."""


class ExactAlarm:
    """An alarm that cancels outdated calls, so that a virtual clock makes no call without effect."""

    def __init__(self, clock: Clock, callback: Callback) -> None:
        self._clock = clock
        self._callback = callback
        self._call: Handle | None = None
        self._when = NEVER

    def set(self, when: int) -> None:
        if when == self._when:
            return
        self._when = when
        if self._call is not None:
            self._call.cancel()
        self._call = self._clock.call_at(when, self._ring) if when < NEVER else None

    def cancel(self) -> None:
        self.set(NEVER)

    def _ring(self) -> None:
        self._call, self._when = None, NEVER
        self._callback()


class LateAlarm:
    """An alarm that keeps an earlier call, and asks for the next call only then: most calls are moved before."""

    def __init__(self, clock: Clock, callback: Callback) -> None:
        self._clock = clock
        self._callback = callback
        self._call: Handle | None = None
        self._asked_for = NEVER
        self._when = NEVER

    def set(self, when: int) -> None:
        self._when = when
        if when < self._asked_for:
            if self._call is not None:
                self._call.cancel()
            self._asked_for = when
            self._call = self._clock.call_at(when, self._ring)

    def cancel(self) -> None:
        if self._call is not None:
            self._call.cancel()
        self._call, self._asked_for, self._when = None, NEVER, NEVER

    def _ring(self) -> None:
        """Call back, or ask for a call at a later time, however late this call is: other calls may be due before."""
        came = self._asked_for
        self._call, self._asked_for = None, NEVER
        when = self._when
        if when > came:
            self.set(when)
        else:
            self._when = NEVER
            self._callback()


class _Call:
    """A call in a heap; after the call, or a cancel, it holds no callback."""

    __slots__ = ("callback", "heap")

    def __init__(self, heap: _CallHeap, callback: Callback) -> None:
        self.heap = heap
        self.callback: Callback | None = callback

    def cancel(self) -> None:
        if self.callback is not None:
            self.callback = None
            self.heap.note_cancelled()

    def make(self) -> None:
        callback, self.callback = self.callback, None
        if callback is not None:
            callback()


class _CallHeap:
    """Calls in order of time, then of request."""

    def __init__(self) -> None:
        self._calls: list[tuple[int, int, _Call]] = []
        self._order = itertools.count()
        self._cancelled = 0
        self._lagging: dict[Lagging, None] = {}

    def _put(self, when: int, callback: Callback) -> _Call:
        call = _Call(self, callback)
        heapq.heappush(self._calls, (when, next(self._order), call))
        return call

    def note_cancelled(self) -> None:
        """Remove cancelled calls from the heap when most calls of it are cancelled."""
        self._cancelled += 1
        if self._cancelled > 64 and 2 * self._cancelled > len(self._calls):
            self._calls = [call for call in self._calls if call[2].callback is not None]
            heapq.heapify(self._calls)
            self._cancelled = 0

    @property
    def next_call(self) -> int | None:
        """Return the time of the next call; None without a call."""
        calls = self._calls
        while calls and calls[0][2].callback is None:
            heapq.heappop(calls)
            self._cancelled -= 1
        return calls[0][0] if calls else None

    # ---- late events ---------------------------------------------------------------------------------------

    def lag(self, source: Lagging) -> None:
        """Let `source` report its late events before each call, and where virtual time stops."""
        self._lagging[source] = None

    def end_lag(self, source: Lagging) -> None:
        """Note that `source` has no late events any more."""
        self._lagging.pop(source, None)

    def _catch_up(self, until: int) -> bool:
        """Let the source with the earliest late event report; return False if no source has a late event."""
        first, at = None, 0
        for source in self._lagging:
            due = source.behind(until)
            if due is not None and (first is None or due < at):
                first, at = source, due
        if first is None:
            return False
        self._moved(at)
        first.catch_up(at)
        return True

    def _moved(self, time: int) -> None:
        """Note that this time is reached."""


class VirtualClock(_CallHeap):
    """Time that only its methods move. Calls are made in order of time, then of request; a call may ask for others.

    An exception of a callback is raised by the method that moved the time.
    """

    def __init__(self, start: int = 0) -> None:
        super().__init__()
        self._now = start
        self._looks: list[tuple[int, int, Callback]] = []

    def now(self) -> int:
        return self._now

    moment = now

    def call_at(self, when: int, callback: Callback) -> Handle:
        now = self._now
        return self._put(when if when > now else now, callback)

    def call_soon(self, callback: Callback) -> Handle:
        return self._put(self._now, callback)

    def look_at(self, when: int, callback: Callback) -> None:
        heapq.heappush(self._looks, (when, next(self._order), callback))

    def alarm(self, callback: Callback) -> Alarm:
        return ExactAlarm(self, callback)

    def bell(self, callback: Callback) -> Callable[[], object]:
        return partial(self.call_soon, callback)

    def _moved(self, time: int) -> None:
        self._now = max(self._now, time)

    # ---- moving -------------------------------------------------------------------------------------------

    def run_until(self, time: int) -> None:
        """Make each call due up to `time`, and stop at this time."""
        while self._step(time):
            pass
        self._now = max(self._now, time)

    def run_for(self, duration: int) -> None:
        """Advance the clock by `duration` (ns), as `run_until` does."""
        self.run_until(self._now + duration)

    def advance(self) -> bool:
        """Make all calls of the next time that has a call; return False without a call."""
        due = self.next_call
        if due is not None:
            self.run_until(due)
        return due is not None

    def _step(self, limit: int) -> bool:
        """Make the next call due up to `limit`, or let a source report late events; return False if neither exists."""
        due = self.next_call
        until = limit if due is None or due > limit else due
        looks = self._looks
        if looks and looks[0][0] <= until:
            heapq.heappop(looks)[2]()
            return True
        if self._lagging and self._catch_up(until):
            return True
        if due is None or due > limit:
            return False
        self._now, _, call = heapq.heappop(self._calls)
        call.make()
        return True


MOST = 768
"""Limit of the work of a piece, and of a turn of a loop.

With the time of the pieces before (`LONGEST`) a turn takes 10 ms where a byte costs 4 µs and the first bad frames 3 ms.
"""

HALF = MOST // 2
"""Work after which a turn ends with the turn of the loop."""

PIECE = 12
"""Work of a piece in addition to its bytes, however short it is."""

LONGEST = 4_000_000
"""Limit of the time of a turn (ns): after that no other piece and no other call begins in the turn."""

FEWEST = 64
"""Size of a piece (bytes) while other pieces wait, so that no piece waits for long."""


class Turns:
    """Shares the turns of a loop among all ports: at most `MOST` of work in each turn, the rest later, in order.

    The work of a piece is its bytes and `PIECE`. A turn of slow pieces ends after `LONGEST`.
    The loop reports the end of a turn only if the turn has much work; without that report a turn lasts `LONGEST`.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, now: Callable[[], int] = time.monotonic_ns) -> None:
        self.used = 0
        """The work of this turn."""
        self._loop = loop
        self.now = now
        self._until = 0
        self._waiting: deque[tuple[int, Callback]] = deque()
        self._ends = False

    @property
    def waiting(self) -> int:
        """Return the number of pieces that wait for their turn."""
        return len(self._waiting)

    @property
    def room(self) -> int:
        """Return the size that a piece should have (bytes)."""
        if self._waiting:
            return FEWEST
        is_over = self.now() >= self._until and not self._ends
        return max(FEWEST, MOST - PIECE - (0 if is_over else self.used))

    def take(self, size: int, callback: Callback) -> bool:
        """Make the call that handles `size` bytes: now (return True), or after the pieces that wait (return False)."""
        work = size + PIECE
        if self._waiting or not self._has_begun(work):
            self._waiting.append((work, callback))
            self._end_soon()
            return False
        callback()
        if self.used > HALF or self.now() >= self._until:
            self._end_soon()
        return True

    def _has_begun(self, work: int) -> bool:
        """Count a piece in this turn, or begin another turn; return False if the piece has to wait."""
        now = self.now()
        if not self.used or (now >= self._until and not self._ends):
            self.used, self._until = work, now + LONGEST
            return True
        if self.used + work > MOST or now >= self._until:
            return False
        self.used += work
        return True

    def _end_soon(self) -> None:
        """End this turn with the turn of the loop."""
        if not self._ends:
            self._ends = True
            self._loop.call_soon(self._next)

    def _next(self) -> None:
        """Begin the next turn with the pieces that wait."""
        self._ends, self.used = False, 0
        while self._waiting and self._has_begun(self._waiting[0][0]):
            self._end_soon()
            self._waiting.popleft()[1]()


class AsyncioClock(_CallHeap):
    """Real time: the calls of an asyncio loop, with the times of `time.monotonic_ns`. `now` is safe in any thread.

    However late the loop is, calls are made in order of time, then of request; timers of a loop alone are not.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        super().__init__()
        self.loop = loop
        self._timer: asyncio.Handle | None = None
        self._timer_at = 0
        self._soon = False
        self._ringing = False
        self._moment = 0
        self._has_ticks = not isinstance(loop, asyncio.BaseEventLoop)
        """Whether the loop rounds delays to whole milliseconds, as uvloop does."""
        self.turns = Turns(loop)
        """The turns in which ports handle received bytes."""

    now = staticmethod(time.monotonic_ns)

    def moment(self) -> int:
        return self._moment if self._ringing else time.monotonic_ns()

    def _moved(self, time: int) -> None:
        self._moment = max(self._moment, time)

    def call_at(self, when: int, callback: Callback) -> Handle:
        call = self._put(when, callback)
        self._set_timer()
        return call

    def call_soon(self, callback: Callback) -> Handle:
        call = self._put(time.monotonic_ns(), callback)
        self._ring_soon()
        return call

    def look_at(self, when: int, callback: Callback) -> None:
        self.loop.call_later(max(0, when - time.monotonic_ns()) / 1e9, callback)

    def alarm(self, callback: Callback) -> Alarm:
        return LateAlarm(self, callback)

    def bell(self, callback: Callback) -> Callable[[], object]:
        return partial(self.loop.call_soon, callback)

    def _set_timer(self) -> None:
        """Set a timer of the loop for the next call; if the call is due, ask for it: loops wait whole milliseconds."""
        if self._ringing or self._soon:
            return
        due = self.next_call
        if due is None or (self._timer is not None and self._timer_at <= due):
            return
        delay = due - time.monotonic_ns()
        if delay <= 0:
            self._ring_soon()
            return
        if self._timer is not None:
            self._timer.cancel()
        if self._has_ticks:  # rounded up: a delay that is rounded to 0 ends at once, again and again until `due`
            delay = -(-delay // TICK) * TICK
        self._timer_at = due
        self._timer = self.loop.call_later((delay + NEVER_EARLY) / 1e9, self._time_up)

    def _ring_soon(self) -> None:
        """Make due calls in the next turn of the loop; a timer that is set remains, for calls that are left."""
        if not self._soon and not self._ringing:
            self._soon = True
            self.loop.call_soon(self._ring)

    def _time_up(self) -> None:
        self._timer = None
        self._ring()

    def _ring(self) -> None:
        """Make the calls that are due; after `LONGEST`, leave the other calls to the next turn.

        The loop handles an exception of a call, and the other calls follow.
        """
        self._soon = False
        self._ringing = True
        now, elapsed = time.monotonic_ns(), self.turns.now
        until = elapsed() + LONGEST
        try:
            while (due := self.next_call) is not None and due <= now:
                if self._lagging and self._catch_up(due):
                    continue
                self._moved(due)
                heapq.heappop(self._calls)[2].make()
                if elapsed() > until:
                    break
        finally:
            self._ringing = False
            self._set_timer()


def date_at(clock: Clock) -> Callable[[int], datetime]:
    """Return a function from a time of this clock to the date: the real date, or from 2000 on with virtual time."""
    if isinstance(clock, AsyncioClock):
        return lambda now: datetime.now()
    return lambda now: DEFAULT_START + timedelta(microseconds=now // 1000)


def utc_at(clock: Clock) -> Callable[[int], int]:
    """Return a function from a time of this clock to ns since 1970 (UTC), from 2000 on with virtual time."""
    if isinstance(clock, AsyncioClock):
        return lambda now: time.time_ns() - (clock.now() - now)
    start = int(DEFAULT_START.replace(tzinfo=UTC).timestamp()) * 1_000_000_000
    return lambda now: start + now
