"""Sinks at work: each takes values in a thread of its own, so that a slow or dead one never holds a line up.

What a sink cannot take waits in memory, the oldest is dropped when too much waits, and what is dropped is counted. On
simulated time there are no threads: a sink is called at once.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial

from framekit.run.model import Point
from framekit.run.points import PointTable, PointValue
from framekit.sinks import Sink, SinkKind
from framekit.sinks.base import Sampled, fits
from framekit.transport.clock import AsyncioClock, Clock, Handle

log = logging.getLogger(__name__)

MOST_WAITING = 100_000
"""Samples that wait for a sink at most."""

AT_ONCE = 1_000
"""Samples that a sink is given at once at most."""

LONGEST_WAIT = 30.0
AT_END = 5.0
"""Seconds: between two tries of a sink that fails, and for what waits when the run ends."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SinkStatus:
    """A sink: its kind and target, the samples it has taken, that wait, that were dropped, and what is wrong now."""

    kind: str
    target: str
    written: int
    waiting: int
    dropped: int
    problem: str = ""


class SinkFeeder:
    """Feeds one sink. `threaded`: in a thread of its own."""

    def __init__(self, kind: SinkKind, points: Sequence[Point], threaded: bool) -> None:
        self.kind = kind
        self.points = [point for point in points if any(fits(pattern, point.name) for pattern in kind.points)]
        self.names = frozenset(point.name for point in self.points)
        self._sink: Sink = kind.make()
        self._threaded = threaded
        self._waiting: deque[Sampled] = deque()
        self._change = threading.Condition()
        self._ending = False
        self._is_open = False
        self._thread: threading.Thread | None = None
        self._written = self._dropped = 0
        self._problem = ""

    @property
    def status(self) -> SinkStatus:
        """How it is doing now."""
        with self._change:
            return SinkStatus(
                kind=self.kind.word, target=self.kind.target, written=self._written, waiting=len(self._waiting),
                dropped=self._dropped, problem=self._problem,
            )  # fmt: skip

    def start(self) -> None:
        """From now on it takes samples."""
        if self._threaded:
            name = f"framekit sink {self.kind.word}"
            self._thread = threading.Thread(target=self._run, name=name, daemon=True)
            self._thread.start()

    def put(self, sample: Sampled) -> None:
        """One more sample; never waits for the sink."""
        with self._change:
            if len(self._waiting) >= MOST_WAITING:
                self._waiting.popleft()
                self._dropped += 1
            self._waiting.append(sample)
            self._change.notify()
        if not self._threaded:
            self._feed()

    def end(self) -> None:
        """Nothing more comes: what waits is written, and that is the end."""
        with self._change:
            self._ending = True
            self._change.notify()

    def stop(self, within: float = AT_END) -> None:
        """Waits for the end for so many seconds; what then still waits is dropped."""
        self.end()
        if self._thread is not None:
            self._thread.join(within)
        else:
            self._feed()
            self._close()
        with self._change:
            self._dropped += len(self._waiting)
            self._waiting.clear()

    # ---- in the thread ------------------------------------------------------------------------------------

    def _run(self) -> None:
        pause = 0.0
        while True:
            with self._change:
                if pause:  # values that come meanwhile do not make it shorter
                    self._change.wait_for(lambda: self._ending, pause)
                else:
                    self._change.wait_for(lambda: self._ending or self._waiting)
                ending = self._ending
            went_well = self._feed()
            if ending:
                break
            pause = 0.0 if went_well else min(max(1.0, 2 * pause), LONGEST_WAIT)
        self._close()

    def _feed(self) -> bool:
        """Gives the sink what waits; False when it has failed."""
        while True:
            with self._change:
                samples = [self._waiting[at] for at in range(min(AT_ONCE, len(self._waiting)))]
                dropped = self._dropped
            try:
                if not self._is_open:
                    self._sink.open(self.points)
                    self._is_open = True
                if not samples:
                    return True
                taken = self._sink.write(samples)
                if not isinstance(taken, int) or not 1 <= taken <= len(samples):
                    raise ValueError(f"write took {taken!r} of {len(samples)} samples")
            except Exception as error:  # a sink is anybody's: whatever it raises, lines go on
                self._fail(_in_words(error))
                return False
            with self._change:
                lost = self._dropped - dropped  # of these, while they were written
                for _ in range(taken - lost):
                    self._waiting.popleft()
                self._dropped -= min(lost, taken)
                self._written += taken
                self._problem = ""

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


def _in_words(error: Exception) -> str:
    """What went wrong, as the system or the library says it."""
    words = error.strerror if isinstance(error, OSError) else str(error)
    return words or type(error).__name__


class SinkService:
    """The sinks of a run: each gets changes as they come, or all values so often."""

    def __init__(self, kinds: Iterable[SinkKind], points: Sequence[Point], table: PointTable, clock: Clock) -> None:
        self._table, self._clock = table, clock
        threaded = isinstance(clock, AsyncioClock)
        self.feeders = [SinkFeeder(kind, points, threaded) for kind in kinds]
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
        for feeder in self.feeders:
            feeder.end()
        until = time.monotonic() + AT_END  # one limit for all
        for feeder in self.feeders:
            feeder.stop(max(0.0, until - time.monotonic()))

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
