"""Sinks at work: each takes values in a thread of its own, so that a slow or dead one never holds a line up.

What a sink cannot take waits in memory, or for a server in a file (`Waiting`). The oldest is dropped when too much
waits, and what is dropped is counted.
On simulated time there are no threads: a sink is called at once.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from framekit.run.block_state import Failure
from framekit.run.model import Point
from framekit.run.points import PointTable, PointValue
from framekit.run.status import RunStatus, SinkStatus
from framekit.service.points import PointService
from framekit.sinks import Sink, SinkKind
from framekit.sinks.base import NeverTakenError, Sampled, fits
from framekit.sinks.store import MOST_WAITING, NetworkSink, Store
from framekit.transport.clock import AsyncioClock, Clock, Handle

AT_ONCE = 1_000
"""Samples that are given on at once at most."""


class InMemory:
    """Samples that wait in memory, the oldest first; too many push the oldest out. Any thread may use it."""

    def __init__(self) -> None:
        self.dropped = 0
        self._lock = threading.Lock()
        self._waiting: deque[Sampled] = deque()
        self._first = 0

    def __len__(self) -> int:
        return len(self._waiting)

    def put(self, sample: Sampled) -> None:
        """One more."""
        with self._lock:
            if len(self._waiting) >= MOST_WAITING:
                self._waiting.popleft()
                self._first += 1
                self.dropped += 1
            self._waiting.append(sample)

    def first(self, most: int) -> tuple[int, list[Sampled]]:
        """The oldest samples, and the number of the first of them."""
        with self._lock:
            return self._first, [self._waiting[at] for at in range(min(most, len(self._waiting)))]

    def done(self, start: int, number: int) -> None:
        """The samples from `start` on, so many, are somewhere else; what was pushed out of them was not lost."""
        with self._lock:
            end = start + number
            self.dropped -= min(self._first, end) - start
            while self._first < end:
                self._waiting.popleft()
                self._first += 1

    def clear(self) -> None:
        """What waits never will be taken."""
        with self._lock:
            self.dropped += len(self._waiting)
            self._first += len(self._waiting)
            self._waiting.clear()


class Waiting:
    """What waits for one sink. With a `store` it goes from memory into that, by a thread of its own if `threaded`.

    `change` is notified of what comes; `told` hears of what is wrong with the store, '' when all is well again.
    """

    def __init__(
        self, store: Store | None, threaded: bool, change: threading.Condition, told: Callable[[str], None]
    ) -> None:
        self._memory, self._store = InMemory(), store
        self._change, self._told = change, told
        self._ending = False
        self._thread: threading.Thread | None = None
        self._threaded = threaded and store is not None

    def __len__(self) -> int:
        return len(self._memory) + (0 if self._store is None else len(self._store))

    @property
    def unsaved(self) -> int:
        """How many are in memory only."""
        return len(self._memory)

    @property
    def dropped(self) -> int:
        """How many were too many."""
        return self._memory.dropped + (0 if self._store is None else self._store.dropped)

    def start(self) -> None:
        """From now on samples are kept; those of an earlier run wait already."""
        if self._threaded:
            self._thread = threading.Thread(target=self._run, name="framekit store", daemon=True)
            self._thread.start()
        elif self._store is not None:
            self._keep()

    def put(self, sample: Sampled) -> None:
        """One more; never waits for a disk, where there are threads."""
        self._memory.put(sample)
        with self._change:
            self._change.notify_all()
        if not self._threaded and self._store is not None:
            self._keep()

    def first(self, most: int) -> tuple[int, list[Sampled]]:
        """The oldest samples that can be sent, and the number of the first of them."""
        return (self._memory if self._store is None else self._store).first(most)

    def done(self, start: int, number: int) -> None:
        """The samples from `start` on, so many, have been sent."""
        (self._memory if self._store is None else self._store).done(start, number)

    @property
    def has_some(self) -> bool:
        """Whether there is something to send."""
        return bool(len(self._memory if self._store is None else self._store))

    def end(self) -> None:
        """Nothing more comes."""
        with self._change:
            self._ending = True
            self._change.notify_all()

    def join(self, until: float) -> None:
        """Waits until what is in memory is in the store, at most to this moment (`time.monotonic`)."""
        if self._thread is not None:
            self._thread.join(max(0.0, until - time.monotonic()))

    def close(self) -> None:
        """The store is let go of, with what waits in it; what is in memory only is dropped."""
        if self._store is not None:
            self._store.close()
        self._memory.clear()

    # ---- the store ----------------------------------------------------------------------------------------

    def _run(self) -> None:
        went_well = True
        while True:
            with self._change:
                if went_well:
                    self._change.wait_for(lambda: self._ending or len(self._memory) or not self._is_open)
                else:
                    self._change.wait_for(lambda: self._ending, 1.0)
                ending = self._ending
            went_well = self._keep()
            if ending:
                return

    @property
    def _is_open(self) -> bool:
        return self._store is None or self._store.is_open

    def _keep(self) -> bool:
        """Puts what is in memory into the store; False when that has failed."""
        store = self._store
        if store is None:
            return True
        try:
            if not store.is_open:
                store.open()
            while True:
                start, samples = self._memory.first(AT_ONCE)
                if samples:
                    store.add(samples)
                    self._memory.done(start, len(samples))
                self._told("")
                with self._change:
                    self._change.notify_all()
                if not samples:
                    return True
        except Exception as error:  # whatever the disk or SQLite say, lines go on
            self._told(f"values cannot be kept in {store.path}: {getattr(error, 'strerror', None) or error}")
            return False


log = logging.getLogger(__name__)

T = TypeVar("T")

LONGEST_ANSWER = 2.0
"""Seconds in which a run says how it is doing."""

MOST_COMMANDS = 1_000
"""So many values that sinks want written are under way at most."""

LONGEST_WAIT = 30.0
AT_END = 5.0
"""Seconds: between two tries of a sink that fails, and for what waits when the run ends."""


class SinkHost:
    """A run, as its sinks see it from their threads."""

    def __init__(
        self, run: str, clock: Clock, points: PointService | None = None, status: Callable[[], RunStatus] | None = None
    ) -> None:
        self.run = run
        self._clock, self._points, self._status = clock, points, status
        self._under_way = 0

    def _soon(self, action: Callable[[], object]) -> None:
        """Does something in the run's thread. Raises TimeoutError when the run has ended."""
        if not isinstance(self._clock, AsyncioClock):
            action()
            return
        try:
            self._clock.loop.call_soon_threadsafe(action)
        except RuntimeError:
            raise TimeoutError("the run has ended") from None

    def status(self) -> RunStatus:
        """How the run is doing now. Raises TimeoutError."""
        assert self._status is not None
        return self._asked(self._status)

    def values(self) -> Sequence[PointValue]:
        """What all points are now. Raises TimeoutError."""
        assert self._points is not None
        table = self._points.table
        return self._asked(lambda: list(table))

    def _asked(self, ask: Callable[[], T]) -> T:
        """What a function gives in the run's thread. Raises TimeoutError."""
        found: Future[T] = Future()

        def answer() -> None:
            try:
                found.set_result(ask())
            except Exception as error:
                found.set_exception(error)

        self._soon(answer)
        return found.result(LONGEST_ANSWER)

    def write(self, point: str, value: Any, who: str, told: Callable[[str], None]) -> None:
        """Has a point written; `told` hears why not, or ''."""

        def tell(why: str) -> None:
            try:
                told(why)
            except Exception as error:  # a sink may raise anything; what was done stays so
                log.warning("point %s: the answer to %s is lost: %s", point, who, _in_words(error))

        def refuse(why: str) -> None:
            log.warning("point %s: %r was refused to %s: %s", point, value, who, why)
            tell(why)

        def written(failure: Failure | None) -> None:
            self._under_way -= 1
            tell("" if failure is None else f"it was not written: {failure}")

        def write() -> None:
            if self._under_way >= MOST_COMMANDS:
                refuse(f"{MOST_COMMANDS} values wait to be written")
                return
            self._under_way += 1
            try:
                assert self._points is not None
                self._points.write(point, value, who, written)
            except Exception as error:  # what comes from outside may be anything
                self._under_way -= 1
                refuse(_in_words(error))

        try:
            self._soon(write)
        except TimeoutError as error:
            refuse(str(error))


class SinkFeeder:
    """Feeds one sink. `threaded`: in a thread of its own."""

    def __init__(self, kind: SinkKind, points: Sequence[Point], threaded: bool, host: SinkHost | None = None) -> None:
        self.kind = kind
        self.points = [point for point in points if any(fits(pattern, point.name) for pattern in kind.points)]
        self.names = frozenset(point.name for point in self.points)
        self._sink: Sink = kind.make()
        self._threaded = threaded
        self._host = host
        self._change = threading.Condition(threading.RLock())
        self._is_stored = isinstance(kind, NetworkSink)
        store = Store(Path(kind.store), kind.most) if isinstance(kind, NetworkSink) else None
        self._waiting = Waiting(store, threaded, self._change, self._tell_of_store)
        self._ending = False
        self._is_open = False
        self._thread: threading.Thread | None = None
        self._written = self._refused = 0
        self._problem = self._store_problem = self._lost = ""

    @property
    def status(self) -> SinkStatus:
        """How it is doing now."""
        with self._change:
            return SinkStatus(
                kind=self.kind.word, target=self.kind.target, written=self._written, waiting=len(self._waiting),
                dropped=self._waiting.dropped + self._refused, problem=self._store_problem or self._problem,
            )  # fmt: skip

    def start(self) -> None:
        """From now on it takes samples; what an earlier run has left is sent first."""
        if self._host is not None:
            self._sink.meet(_Meeting(self._host, self.lost))
        self._waiting.start()
        if self._threaded:
            name = f"framekit sink {self.kind.word}"
            self._thread = threading.Thread(target=self._run, name=name, daemon=True)
            self._thread.start()
        else:
            self._feed()

    def put(self, sample: Sampled) -> None:
        """One more sample; never waits for the sink."""
        self._waiting.put(sample)
        if not self._threaded:
            self._feed()

    def lost(self, problem: str) -> None:
        """The sink has lost its server."""
        with self._change:
            self._lost = problem
            self._change.notify_all()

    def end(self) -> None:
        """Nothing more comes."""
        self._waiting.end()

    def stop(self, until: float | None = None) -> None:
        """Writes what waits, at most to this moment (`time.monotonic`); the rest stays in its store, or is dropped."""
        until = time.monotonic() + AT_END if until is None else until
        self.finish(until)
        if self._thread is not None:
            self._thread.join(max(0.0, until - time.monotonic()))
        else:
            self._feed()
            self._close()
        self._waiting.close()

    def finish(self, until: float) -> None:
        """What is in memory goes to the store, and what waits is written once more; then its thread ends."""
        self.end()
        self._waiting.join(until)
        with self._change:
            self._ending = True
            self._change.notify_all()

    # ---- in the thread ------------------------------------------------------------------------------------

    def _run(self) -> None:
        pause = 0.0
        went_well = self._feed()  # opens it
        while True:
            pause = 0.0 if went_well else min(max(1.0, 2 * pause), LONGEST_WAIT)
            with self._change:
                if pause:  # values that come meanwhile do not make it shorter
                    self._change.wait_for(lambda: self._ending, pause)
                else:
                    self._change.wait_for(lambda: self._ending or self._waiting.has_some or self._lost)
                ending = self._ending
            went_well = self._feed()
            if ending:
                break
        self._close()

    def _feed(self) -> bool:
        """Gives the sink what waits; False when it has failed."""
        while True:
            start, samples = self._waiting.first(AT_ONCE)
            if self._is_stored:  # an earlier run may have had other points
                samples = [self._known(one) for one in samples]
            try:
                if self._lost and self._is_open:
                    raise ConnectionError(self._lost)
                if not self._is_open:
                    self._lost = ""
                    self._sink.open(self.points)
                    self._is_open = True
                if not samples:
                    self._mended()
                    return True
                taken = self._sink.write(samples)
                if not isinstance(taken, int) or not 1 <= taken <= len(samples):
                    raise ValueError(f"write took {taken!r} of {len(samples)} samples")
                self._waiting.done(start, taken)
            except NeverTakenError as error:
                self._refuse(start, str(error))
                continue
            except Exception as error:  # a sink may raise anything; lines go on
                self._fail(_in_words(error))
                return False
            with self._change:
                self._written += taken
            self._mended()

    def _refuse(self, start: int, why: str) -> None:
        """The first sample is dropped."""
        self._waiting.done(start, 1)
        with self._change:
            self._refused += 1
        log.warning("sink %s %s: a sample is refused and dropped: %s", self.kind.word, self.kind.target, why)

    def _known(self, sample: Sampled) -> Sampled:
        """The values of points that there are."""
        if all(one.name in self.names for one in sample.values):
            return sample
        return sample._replace(values=tuple(one for one in sample.values if one.name in self.names))

    def _tell_of_store(self, problem: str) -> None:
        with self._change:
            told, self._store_problem = self._store_problem, problem
        if problem and told != problem:
            log.warning("sink %s %s: %s", self.kind.word, self.kind.target, problem)

    def _mended(self) -> None:
        """All is well."""
        with self._change:
            told, self._problem = self._problem, ""
        if told:
            log.info("sink %s %s: it takes values again", self.kind.word, self.kind.target)

    def _fail(self, problem: str) -> None:
        self._close()
        with self._change:
            told, self._problem = self._problem, problem
        if told != problem:
            log.warning("sink %s %s: %s", self.kind.word, self.kind.target, problem)

    def _close(self) -> None:
        self._is_open = False
        try:
            self._sink.close()
        except Exception as error:  # as above
            log.warning("sink %s %s: %s", self.kind.word, self.kind.target, _in_words(error))


@dataclass(frozen=True, slots=True)
class _Meeting:
    """The run as one sink sees it."""

    host: SinkHost
    lost: Callable[[str], None]

    @property
    def run(self) -> str:
        return self.host.run

    def status(self) -> RunStatus:
        return self.host.status()

    def values(self) -> Sequence[PointValue]:
        return self.host.values()

    def write(self, point: str, value: Any, who: str, told: Callable[[str], None]) -> None:
        self.host.write(point, value, who, told)


def _in_words(error: Exception) -> str:
    """What went wrong, as the system or the library says it."""
    words = error.strerror if isinstance(error, OSError) else ""
    return words or str(error) or type(error).__name__


class SinkService:
    """The sinks of a run: each gets changes as they come, or all values so often."""

    def __init__(
        self, kinds: Iterable[SinkKind], points: Sequence[Point], table: PointTable, clock: Clock, host: SinkHost
    ) -> None:
        self._table, self._clock = table, clock
        threaded = isinstance(clock, AsyncioClock)
        self.feeders = [SinkFeeder(kind, points, threaded, host) for kind in kinds]
        self._timers: dict[int, Handle] = {}

    def start(self) -> None:
        """Begins."""
        for feeder in self.feeders:
            feeder.start()
            if feeder.kind.every is not None:
                self._every(feeder, self._clock.now() + feeder.kind.every)
        if any(feeder.kind.every is None for feeder in self.feeders):
            self._table.listeners.append(self._changed)

    def stop(self) -> None:
        """Nothing comes any more; what waits is written."""
        for timer in self._timers.values():
            timer.cancel()
        if self._changed in self._table.listeners:
            self._table.listeners.remove(self._changed)
        until = time.monotonic() + AT_END  # one limit for all
        for feeder in self.feeders:
            feeder.end()
        for feeder in self.feeders:
            feeder.finish(until)
        for feeder in self.feeders:
            feeder.stop(until)

    def _changed(self, value: PointValue) -> None:
        for feeder in self.feeders:
            if feeder.kind.every is None and value.name in feeder.names:
                feeder.put(Sampled(value.time, (value,)))

    def _every(self, feeder: SinkFeeder, when: int) -> None:
        """Takes all values at a time, and at the next; times that were missed are left out."""
        self._timers[id(feeder)] = self._clock.call_at(when, partial(self._take, feeder, when))

    def _take(self, feeder: SinkFeeder, when: int) -> None:
        period = feeder.kind.every or 1
        values = tuple(value for value in self._table if value.name in feeder.names)
        feeder.put(Sampled(self._table.wall(when), values))
        self._every(feeder, when + period * max(1, (self._clock.now() - when) // period + 1))

    @property
    def status(self) -> list[SinkStatus]:
        """How each is doing now."""
        return [feeder.status for feeder in self.feeders]

    @property
    def problems(self) -> list[str]:
        """What keeps sinks from taking what they should, and what they have lost."""
        found = []
        for one in self.status:
            if one.problem or one.dropped:
                lost = f"{one.dropped} samples were dropped" if one.dropped else ""
                found.append(f"sink {one.kind} {one.target}: {', '.join(filter(None, (one.problem, lost)))}")
        return found
