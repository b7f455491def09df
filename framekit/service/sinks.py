"""Sinks at work: each takes values in a thread of its own, so that a slow or dead one never holds a line up.

Samples that a sink cannot take wait in memory, or for a server in a file (`Waiting`). The oldest sample is dropped and
counted when too many wait. On simulated time a sink is called at once, without threads.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from framekit.definition.problems import DefinitionError, Problem, error_text
from framekit.run.block_state import Failure
from framekit.run.model import Point
from framekit.run.points import PointTable, PointValue
from framekit.run.status import RunStatus, SinkStatus
from framekit.run.trouble import Dropped, SampleCount, Troubles, TroubleSource, lasted, remedy_of, waiting_text
from framekit.service.points import PointService
from framekit.service.waiting import AT_ONCE, Waiting
from framekit.sinks import Sink, SinkKind
from framekit.sinks.base import NeverTakenError, Sampled, fits
from framekit.sinks.store import MOST_WAITING, NetworkSink, Store
from framekit.transport.clock import AsyncioClock, Clock, Handle

log = logging.getLogger(__name__)

T = TypeVar("T")

LONGEST_ANSWER = 2.0
"""Time limit for the answer of a run to a sink (s)."""

MOST_COMMANDS = 1_000
"""Largest number of values from sinks that wait to be written."""

LONGEST_WAIT = 30.0
AT_END = 5.0
"""Seconds between two tries of a failing sink, and for the waiting samples when the run ends."""


LEAST_JUMP = 1_000_000_000
LEAST_BETWEEN_REPORTS = 60_000_000_000
"""A jump of the wall clock that is reported, and the time between two reports (ns)."""


class OpenError(ValueError):
    """A file or store of a sink that cannot be opened and written."""


class SinkHost:
    """A run, as its sinks see it from their threads."""

    def __init__(
        self, run: str, clock: Clock, points: PointService | None = None, status: Callable[[], RunStatus] | None = None
    ) -> None:
        self.run = run
        self._clock, self._points, self._status = clock, points, status
        self._under_way = 0

    def _soon(self, action: Callable[[], object]) -> None:
        """Call a function in the run's thread. Raises TimeoutError after the end of the run."""
        if not isinstance(self._clock, AsyncioClock):
            action()
            return
        try:
            self._clock.loop.call_soon_threadsafe(action)
        except RuntimeError:
            raise TimeoutError("the run has ended") from None

    def status(self) -> RunStatus:
        """Return the present status of the run. Raises TimeoutError."""
        assert self._status is not None
        return self._asked(self._status)

    def now(self) -> int:
        """Return the time of the run's clock."""
        return self._clock.now()

    def values(self) -> Sequence[PointValue]:
        """Return the present values of all points. Raises TimeoutError."""
        assert self._points is not None
        table = self._points.table
        return self._asked(lambda: list(table))

    def _asked(self, ask: Callable[[], T]) -> T:
        """Call a function in the run's thread, and return its result. Raises TimeoutError."""
        found: Future[T] = Future()

        def answer() -> None:
            try:
                found.set_result(ask())
            except Exception as error:
                found.set_exception(error)

        self._soon(answer)
        try:
            return found.result(LONGEST_ANSWER)
        except TimeoutError as error:
            raise TimeoutError(str(error) or f"the run did not answer for {LONGEST_ANSWER} s") from None

    def write(self, point: str, value: Any, who: str, answer: Callable[[str], None]) -> None:
        """Write a point; `answer` is called with the reason of a refusal, or ''."""

        def tell(why: str) -> None:
            try:
                answer(why)
            except Exception as error:  # a sink may raise any error; the write itself stays valid
                log.warning("point %s: the answer to %s is lost: %s", point, who, error_text(error))

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
            except Exception as error:  # values from outside may be of any kind
                self._under_way -= 1
                refuse(error_text(error))

        try:
            self._soon(write)
        except TimeoutError as error:
            refuse(str(error))


class SinkFeeder:
    """Feeds one sink. `threaded`: in a thread of its own. Its troubles go to `troubles`."""

    def __init__(
        self,
        kind: SinkKind,
        points: Sequence[Point],
        threaded: bool,
        host: SinkHost | None = None,
        troubles: Troubles | None = None,
    ) -> None:
        self.kind = kind
        self.points = [point for point in points if any(fits(pattern, point.name) for pattern in kind.points)]
        self.names = frozenset(point.name for point in self.points)
        self._sink: Sink = kind.make()
        self._threaded = threaded
        self._host = host
        self._troubles = troubles or Troubles(time.monotonic_ns)
        self._change = threading.Condition(threading.RLock())
        self._ending = self._is_over = False
        self._is_open = self._has_met = self._has_started = False
        self._thread: threading.Thread | None = None
        self._written = 0
        self._refused = Dropped()
        self._lost_server = ""
        """Reason why the sink must be opened again; '' if it need not."""
        store = Store(Path(kind.store), kind.most, self._store_has_moved) if isinstance(kind, NetworkSink) else None
        self._most = MOST_WAITING if store is None else store.most
        self._is_stored = store is not None
        name = f"sink {kind.word} {kind.target}"
        self.trouble = self._troubles.source(name, self._effect, self._count, is_file=kind.is_local)
        self.store_trouble: TroubleSource | None = None
        if store is not None:
            self.store_trouble = self._troubles.source(
                f"store {store.path}",
                lambda: waiting_text(self._waiting.unsaved, MOST_WAITING, " in memory only"),
            )
        self._waiting = Waiting(store, threaded, self._change, self._store_state, self._overflows)

    def _effect(self) -> str:
        """Describe the consequence of a trouble for the samples; at the end the reason has it."""
        return "" if self._is_over else waiting_text(len(self._waiting), self._most)

    def _count(self) -> SampleCount:
        """Return the numbers of waiting and of lost samples."""
        count, refused = self._waiting.count, self._refused
        points = Counter(count.points) + refused.points.copy()
        return SampleCount(count.waiting, count.lost + refused.samples, points)

    @property
    def status(self) -> SinkStatus:
        """Return the state of the sink."""
        store_problem = "" if self.store_trouble is None else self.store_trouble.reason
        count = self._count()
        return SinkStatus(
            kind=self.kind.word, target=self.kind.target, written=self._written, waiting=count.waiting,
            dropped=count.lost, problem="; ".join(filter(None, (self.trouble.reason, store_problem))),
        )  # fmt: skip

    def open(self) -> None:
        """Open the files and the store of the sink; a server is connected later, in its thread.

        Raises OpenError if they cannot be opened and written.
        """
        try:
            self._meet()
            self._waiting.open()
            if self.kind.is_local and not self._is_open:
                self._sink.open(self.points)
                self._is_open = True
        except Exception as error:  # a sink may raise anything
            self.abandon()
            raise OpenError(error_text(error)) from None

    def abandon(self) -> None:
        """Close everything that `open` opened."""
        self._close()
        self._waiting.close()

    def _meet(self) -> None:
        if self._host is not None and not self._has_met:
            self._has_met = True
            report = partial(self._troubles.note, self.trouble.name)
            self._sink.meet(_Meeting(self._host, self.lost, self.loses, report))

    def start(self) -> None:
        """Begin to take samples; those that an earlier run has left are sent first."""
        self._has_started = True
        self._meet()
        self._waiting.start()
        if self._threaded:
            name = f"framekit sink {self.kind.word}"
            self._thread = threading.Thread(target=self._run, name=name, daemon=True)
            self._thread.start()
        else:
            self._feed()

    def put(self, sample: Sampled) -> None:
        """Add a sample; never waits for the sink."""
        self._waiting.put(sample)
        if not self._threaded:
            self._feed()

    def lost(self, problem: str) -> None:
        """Note that the sink has lost its server."""
        with self._change:
            self._lost_server = problem
            self._change.notify_all()

    def loses(self, samples: int, points: Mapping[str, int], why: str) -> None:
        """Count samples that the sink had accepted, and has lost."""
        with self._change:
            self._refused.destroyed(samples, points)
        self.trouble.loses(why)

    def end(self) -> None:
        """End the input: no more samples follow."""
        self._waiting.end()

    def stop(self, until: float | None = None) -> None:
        """Write the waiting samples, at most to this moment (`time.monotonic`).

        The rest stays in the store; without a store it is lost.
        """
        if not self._has_started:
            self.abandon()
            return
        until = time.monotonic() + AT_END if until is None else until
        self.finish(until)
        if self._thread is not None:
            self._thread.join(max(0.0, until - time.monotonic()))
        else:
            self._feed()
            self._finish_sink()
        self._waiting.close()

    def finish(self, until: float) -> None:
        """Move samples from memory to the store, and write the waiting ones once more; then the thread ends."""
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
                if pause:  # new values do not shorten it
                    self._change.wait_for(lambda: self._ending, pause)
                else:
                    self._change.wait_for(lambda: self._ending or self._waiting.has_some or self._lost_server)
                ending = self._ending
            went_well = self._feed()
            if ending:
                break
        self._finish_sink()

    def _feed(self) -> bool:
        """Pass the waiting samples to the sink; return False if it has failed."""
        while True:
            try:
                start, samples = self._waiting.first(AT_ONCE)
                if self._is_stored:  # an earlier run may have had other points
                    samples = [self._known(one) for one in samples]
                if self._lost_server and self._is_open:
                    raise ConnectionError(self._lost_server)
                if not self._is_open:
                    self._lost_server = ""
                    self._sink.open(self.points)
                    self._is_open = True
                if not samples:
                    self.trouble.ends()
                    return True
                taken = self._sink.write(samples)
                if not isinstance(taken, int) or not 1 <= taken <= len(samples):
                    raise ValueError(f"write took {taken!r} of {len(samples)} samples")
            except NeverTakenError as error:
                self._refuse(start, samples[0], str(error))
                continue
            except Exception as error:  # a sink may raise anything; lines go on
                self._waiting.not_taken()
                self._close()
                self.trouble.begins(error_text(error))
                return False
            self._waiting.done(start, taken)
            with self._change:
                self._written += taken
            self.trouble.ends()

    def _refuse(self, start: int, sample: Sampled, why: str) -> None:
        """Drop the first sample."""
        self._waiting.done(start, 1)
        with self._change:
            self._refused.drop(start, (value.name for value in sample.values))
        self.trouble.loses(f"a sample is refused and dropped: {why}")

    def _known(self, sample: Sampled) -> Sampled:
        """Return the values of the points of this run."""
        if all(one.name in self.names for one in sample.values):
            return sample
        return sample._replace(values=tuple(one for one in sample.values if one.name in self.names))

    def _store_state(self, problem: str) -> None:
        """Note that the store fails for this reason, or works again."""
        if self.store_trouble is not None:
            self.store_trouble.begins(problem) if problem else self.store_trouble.ends()

    def _store_has_moved(self, change: str) -> None:
        """Report that the store has begun a new file."""
        if self.store_trouble is not None:
            self._troubles.note(self.store_trouble.name, change)

    def _overflows(self) -> None:
        """Note that too many samples wait."""
        self.trouble.loses(f"{self._most:,} samples wait, from now on the oldest are dropped")

    def _finish_sink(self) -> None:
        """Close the sink at the end; a file that cannot be completed is a trouble."""
        was_open = self._is_open
        reason = self._close()
        if reason and was_open and self.kind.is_local:
            self._is_over = True
            self.trouble.begins(reason)

    def _close(self) -> str:
        """Close the sink; return the reason if that fails, else ''."""
        self._is_open = False
        try:
            self._sink.close()
        except Exception as error:  # as above
            reason = error_text(error)
            log.warning("%s: %s", self.trouble.name, reason)
            return reason
        return ""


@dataclass(frozen=True, slots=True)
class _Meeting:
    """The run as one sink sees it."""

    host: SinkHost
    lost: Callable[[str], None]
    loses: Callable[[int, Mapping[str, int], str], None]
    report: Callable[[str], None]

    @property
    def run(self) -> str:
        return self.host.run

    def status(self) -> RunStatus:
        return self.host.status()

    def values(self) -> Sequence[PointValue]:
        return self.host.values()

    def now(self) -> int:
        return self.host.now()

    def write(self, point: str, value: Any, who: str, answer: Callable[[str], None]) -> None:
        self.host.write(point, value, who, answer)


class SinkService:
    """The sinks of a run: each gets changes as they come, or all values in a period."""

    def __init__(
        self, kinds: Iterable[SinkKind], points: Sequence[Point], table: PointTable, clock: Clock, host: SinkHost,
        troubles: Troubles,
    ) -> None:  # fmt: skip
        self._table, self._clock = table, clock
        threaded = isinstance(clock, AsyncioClock)
        self.feeders = [SinkFeeder(kind, points, threaded, host, troubles) for kind in kinds]
        self._timers: dict[int, Handle] = {}
        self._time_of_day = TimeOfDay(lambda: table.wall(clock.now()), clock.now, troubles)

    def open(self) -> None:
        """Open all files and stores. Raises DefinitionError with each that cannot be opened and written."""
        problems = []
        for feeder in self.feeders:
            try:
                feeder.open()
            except OpenError as error:
                problems.append(_not_opened(feeder.kind, str(error)))
        if problems:
            for feeder in self.feeders:
                feeder.abandon()
            raise DefinitionError(problems)

    def start(self) -> None:
        """Begin to feed the sinks."""
        for feeder in self.feeders:
            feeder.start()
            if feeder.kind.every is not None:
                self._every(feeder, self._clock.now() + feeder.kind.every)
        if any(feeder.kind.every is None for feeder in self.feeders):
            self._table.listeners.append(self._changed)

    def stop(self) -> None:
        """Stop to feed the sinks; the waiting samples are written."""
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
        self._time_of_day.look()
        for feeder in self.feeders:
            if feeder.kind.every is None and value.name in feeder.names:
                feeder.put(Sampled(value.time, (value,)))

    def _every(self, feeder: SinkFeeder, when: int) -> None:
        """Take all values at this time, and at the next; missed times are left out."""
        self._timers[id(feeder)] = self._clock.call_at(when, partial(self._take, feeder, when))

    def _take(self, feeder: SinkFeeder, when: int) -> None:
        period = feeder.kind.every or 1
        self._time_of_day.look()
        values = tuple(value for value in self._table if value.name in feeder.names)
        feeder.put(Sampled(self._table.wall(when), values))
        self._every(feeder, when + period * max(1, (self._clock.now() - when) // period + 1))

    @property
    def status(self) -> list[SinkStatus]:
        """Return the state of each sink."""
        return [feeder.status for feeder in self.feeders]


def _not_opened(kind: SinkKind, why: str) -> Problem:
    """Return the problem of a sink whose file or store cannot be opened and written, at its place in the run file."""
    reason, _, todo = why.partition(" – ")
    file = kind.store if isinstance(kind, NetworkSink) else kind.target
    what = reason if file in reason else f"{file} cannot be opened and written: {reason}"
    remedy = remedy_of(reason) or "make room or change its permissions"
    return Problem(kind.at, what, todo or f"{remedy}, or name another file")


class TimeOfDay:
    """Watches the wall clock for jumps against the run's clock, and reports them."""

    def __init__(self, wall: Callable[[], int], now: Callable[[], int], troubles: Troubles) -> None:
        self._wall, self._now, self._troubles = wall, now, troubles
        self._offset: int | None = None
        self._reported = -LEAST_BETWEEN_REPORTS

    def look(self) -> None:
        """Report a jump since the last call."""
        now = self._now()
        before, self._offset = self._offset, self._wall() - now
        if before is None or abs(self._offset - before) < LEAST_JUMP or now - self._reported < LEAST_BETWEEN_REPORTS:
            return
        self._reported = now
        way = "forward" if self._offset > before else "back"
        jump = lasted(abs(self._offset - before))
        self._troubles.note("clock", f"the time of day has jumped {way} by {jump}; no sink deletes values for that")
