"""Clocks: real time on asyncio, and a virtual one on which a day passes in seconds.

Times are whole nanoseconds. What uses a clock only asks for the time and for calls at a time; it never sleeps.
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
"""Asked for on top of a real delay (ns): a loop's clock counts in floating seconds and may ring a little early."""


class Handle(Protocol):
    """A call that is to come."""

    def cancel(self) -> None:
        """The call will not come; cancelling twice, or after the call, does nothing."""


class Clock(Protocol):
    """What everything above the ports needs to know of time."""

    def now(self) -> int:
        """The time, ns; it never goes back."""

    def moment(self) -> int:
        """The time for which the call under way was asked, however late it comes; outside of calls that is now."""

    def call_at(self, when: int, callback: Callback) -> Handle:
        """Asks for a call at `when`, never earlier; as soon as possible if that has passed. Never from inside here."""

    def call_soon(self, callback: Callback) -> Handle:
        """Asks for a call as soon as possible, in the order of asking."""

    def alarm(self, callback: Callback) -> Alarm:
        """An alarm that calls `callback`; it is not set yet."""

    def bell(self, callback: Callback) -> Callable[[], object]:
        """What asks for a call of `callback` as soon as possible, as often as it is called."""

    def lag(self, source: Lagging) -> None:
        """From now on `source` is asked, before each call and where virtual time stops, what it has still to tell."""

    def end_lag(self, source: Lagging) -> None:
        """`source` has told everything and need not be asked any more."""


class Alarm(Protocol):
    """One call that is moved again and again: cheaper than to cancel one and ask for another."""

    def set(self, when: int) -> None:
        """The call will come at `when`, never earlier, and not when it was set to before; NEVER: not at all."""

    def cancel(self) -> None:
        """The call will not come, and the clock keeps nothing of its caller."""


class Lagging(Protocol):
    """Something that saves calls: it tells late what could not be noticed earlier (see `Clock.lag`)."""

    def behind(self, until: int) -> int | None:
        """When the first thing that has happened up to `until` and is still to be told can be told; None: nothing."""

    def catch_up(self, until: int) -> None:
        """Tells everything that has happened up to `until`, the time that `behind` gave."""


class ExactAlarm:
    """Asks for nothing that is not wanted any more, so that a virtual clock has no calls in which nothing happens."""

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
    """Lets an earlier call come, and only then asks for the one that is wanted: most are moved before they come."""

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
        """However late it is: a time after the one that has come gets a call of its own, others may come before it."""
        came = self._asked_for
        self._call, self._asked_for = None, NEVER
        when = self._when
        if when > came:
            self.set(when)
        else:
            self._when = NEVER
            self._callback()


class _Call:
    """A call in a heap; when it has been made or cancelled it holds nothing any more."""

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
    """Calls in order of time, then of asking."""

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
        """Cancelled calls are thrown out of the heap when they make up most of it."""
        self._cancelled += 1
        if self._cancelled > 64 and 2 * self._cancelled > len(self._calls):
            self._calls = [call for call in self._calls if call[2].callback is not None]
            heapq.heapify(self._calls)
            self._cancelled = 0

    @property
    def next_call(self) -> int | None:
        """When the next call is due; None if there is none."""
        calls = self._calls
        while calls and calls[0][2].callback is None:
            heapq.heappop(calls)
            self._cancelled -= 1
        return calls[0][0] if calls else None

    # ---- those who lag behind -----------------------------------------------------------------------------

    def lag(self, source: Lagging) -> None:
        """From now on `source` is asked, before each call and where virtual time stops, what it has still to tell."""
        self._lagging[source] = None

    def end_lag(self, source: Lagging) -> None:
        """`source` has told everything and need not be asked any more."""
        self._lagging.pop(source, None)

    def _catch_up(self, until: int) -> bool:
        """Lets the one that is furthest behind tell; then everything has to be looked at again."""
        first, at = None, 0
        for source in self._lagging:
            behind = source.behind(until)
            if behind is not None and (first is None or behind < at):
                first, at = source, behind
        if first is None:
            return False
        self._moved(at)
        first.catch_up(at)
        return True

    def _moved(self, time: int) -> None:
        """It is that time, or later."""


class VirtualClock(_CallHeap):
    """Time that only moves when told to. Calls come in order of time, then of asking; a call may ask for more.

    What a callback raises comes out of the method that moved the time.
    """

    def __init__(self, start: int = 0) -> None:
        super().__init__()
        self._now = start

    def now(self) -> int:
        return self._now

    moment = now

    def call_at(self, when: int, callback: Callback) -> Handle:
        now = self._now
        return self._put(when if when > now else now, callback)

    def call_soon(self, callback: Callback) -> Handle:
        return self._put(self._now, callback)

    def alarm(self, callback: Callback) -> Alarm:
        return ExactAlarm(self, callback)

    def bell(self, callback: Callback) -> Callable[[], object]:
        return partial(self.call_soon, callback)

    def _moved(self, time: int) -> None:
        self._now = max(self._now, time)

    # ---- moving -------------------------------------------------------------------------------------------

    def run_until(self, time: int) -> None:
        """Makes every call due up to `time`, and stands there."""
        while self._step(time):
            pass
        self._now = max(self._now, time)

    def run_for(self, duration: int) -> None:
        """`run_until` so much later."""
        self.run_until(self._now + duration)

    def advance(self) -> bool:
        """Goes to the next call and makes all that are due at that time; False if there is none."""
        due = self.next_call
        if due is not None:
            self.run_until(due)
        return due is not None

    def _step(self, limit: int) -> bool:
        """Makes the next call due up to `limit`, or lets one that lags behind catch up; False: nothing is left."""
        due = self.next_call
        until = limit if due is None or due > limit else due
        if self._lagging and self._catch_up(until):
            return True
        if due is None or due > limit:
            return False
        self._now, _, call = heapq.heappop(self._calls)
        call.make()
        return True


MOST = 768
"""So much work is done in one piece and in one turn of a loop.

With what pieces before it took (`LONGEST`) that is 10 ms where a byte costs 4 µs and a first crowd of bad frames 3 ms.
"""

PIECE = 12
"""What comes in one piece costs as much as so many bytes, however short it is."""

LONGEST = 4_000_000
"""When so much time of a turn has gone (ns), no other piece and no other call that is due begins in it."""

FEWEST = 64
"""As many bytes as this come in one piece where others wait, so that none of them has to wait for long."""


class Turns:
    """Shares the turns of a loop among all ports: at most `MOST` of work in each, the rest in the next ones, in order.

    The work of a piece is its bytes and `PIECE`. Where pieces need more time than that, a turn ends after `LONGEST`.
    The loop is asked to tell the end of a turn only where it has been used much; little work counts as one turn for
    `LONGEST`. `used`: the work of this turn; `waiting`: pieces that are to come.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, now: Callable[[], int] = time.monotonic_ns) -> None:
        self.used = 0
        self._loop = loop
        self.now = now
        self._until = 0
        self._waiting: deque[tuple[int, Callback]] = deque()
        self._ends = False

    @property
    def waiting(self) -> int:
        return len(self._waiting)

    @property
    def room(self) -> int:
        """So many bytes a piece should have."""
        if self._waiting:
            return FEWEST
        is_over = self.now() >= self._until and not self._ends
        return max(FEWEST, MOST - PIECE - (0 if is_over else self.used))

    def take(self, size: int, callback: Callback) -> bool:
        """Makes the call that deals with `size` bytes: now (True), or when those before it have had their turn."""
        work = size + PIECE
        if self._waiting or not self._has_begun(work):
            self._waiting.append((work, callback))
            self._end_soon()
            return False
        callback()
        if self.used > MOST // 2 or self.now() >= self._until:
            self._end_soon()
        return True

    def _has_begun(self, work: int) -> bool:
        """Counts a piece that may begin in this turn, or begins another one."""
        now = self.now()
        if not self.used or (now >= self._until and not self._ends):
            self.used, self._until = work, now + LONGEST
            return True
        if self.used + work > MOST or now >= self._until:
            return False
        self.used += work
        return True

    def _end_soon(self) -> None:
        """This turn ends when the loop's does."""
        if not self._ends:
            self._ends = True
            self._loop.call_soon(self._next)

    def _next(self) -> None:
        """A turn is over: calls that wait are first in the next one."""
        self._ends, self.used = False, 0
        while self._waiting and self._has_begun(self._waiting[0][0]):
            self._end_soon()
            self._waiting.popleft()[1]()


class AsyncioClock(_CallHeap):
    """Real time: the calls of an asyncio loop. Times are those of `time.monotonic_ns`; threads may ask for `now`.

    However late the loop is, calls come in order of time, then of asking (timers of a loop alone do not).
    `turns`: what ports hear is dealt with in these.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        super().__init__()
        self.loop = loop
        self._timer: asyncio.Handle | None = None
        self._timer_at = 0
        self._soon = False
        self._ringing = False
        self._moment = 0
        self.turns = Turns(loop)

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

    def alarm(self, callback: Callback) -> Alarm:
        return LateAlarm(self, callback)

    def bell(self, callback: Callback) -> Callable[[], object]:
        return partial(self.loop.call_soon, callback)

    def _set_timer(self) -> None:
        """One timer of the loop, for the next call; no timer where it is due, since loops wait whole milliseconds."""
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
        self._timer_at = due
        self._timer = self.loop.call_later((delay + NEVER_EARLY) / 1e9, self._time_up)

    def _ring_soon(self) -> None:
        """In the next turn of the loop; a timer that is set stays, and finds then what is left to do."""
        if not self._soon and not self._ringing:
            self._soon = True
            self.loop.call_soon(self._ring)

    def _time_up(self) -> None:
        self._timer = None
        self._ring()

    def _ring(self) -> None:
        """Makes what is due, in the next turn what is left when this one has taken long.

        What a call raises goes to the loop, and the others come all the same.
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
    """The date at a time of this clock: today's where it is real, and from 2000 on where it is not."""
    if isinstance(clock, AsyncioClock):
        return lambda now: datetime.now()
    return lambda now: DEFAULT_START + timedelta(microseconds=now // 1000)


def utc_at(clock: Clock) -> Callable[[int], int]:
    """Nanoseconds since 1970 (UTC) at a time of this clock: today's where it is real, from 2000 on where it is not."""
    if isinstance(clock, AsyncioClock):
        return lambda now: time.time_ns() - (clock.now() - now)
    start = int(DEFAULT_START.replace(tzinfo=UTC).timestamp()) * 1_000_000_000
    return lambda now: start + now
