"""Samples that wait for one sink: in memory, and for a server also in its store.

Samples go from memory into the store, and from the store to the server. While the store cannot be written, they go from
memory to the server directly: a full disk does not stop a publication.
"""

from __future__ import annotations

import sqlite3
import threading
import time
from collections import deque
from collections.abc import Callable

from framekit.definition.problems import error_text
from framekit.run.trouble import Dropped, SampleCount
from framekit.sinks.base import Sampled
from framekit.sinks.store import MOST_WAITING, Store, StoreError

AT_ONCE = 1_000
"""Largest number of samples passed on together."""

RETRY = 1.0
LONGEST_FLIGHT = 30.0
"""Seconds: between two attempts to write a store, and for a server to take samples that were sent from memory."""

STORE_ERRORS = (sqlite3.Error, OSError, StoreError)


class InMemory:
    """Samples that wait in memory, oldest first; the oldest is dropped when too many wait. Any thread may use it."""

    def __init__(self) -> None:
        self.dropped = Dropped()
        self._lock = threading.Lock()
        self._waiting: deque[Sampled] = deque()
        self._first = 0

    def __len__(self) -> int:
        return len(self._waiting)

    def put(self, sample: Sampled) -> bool:
        """Add a sample; False: the oldest was dropped for it."""
        with self._lock:
            is_full = len(self._waiting) >= MOST_WAITING
            if is_full:
                self._drop_first()
            self._waiting.append(sample)
        return not is_full

    def first(self, most: int) -> tuple[int, list[Sampled]]:
        """Return the oldest samples, and the number of the first of them."""
        with self._lock:
            count = min(most, len(self._waiting))
            self.dropped.sending(self._first + count)
            return self._first, [self._waiting[at] for at in range(count)]

    def done(self, start: int, number: int) -> None:
        """Remove `number` samples from `start` on, which have arrived elsewhere."""
        with self._lock:
            end = start + number
            self.dropped.confirmed(end)
            while self._first < end:
                self._waiting.popleft()
                self._first += 1

    def clear(self) -> None:
        """Drop all samples."""
        with self._lock:
            self.dropped.sending(self._first)
            while self._waiting:
                self._drop_first()

    def _drop_first(self) -> None:
        self.dropped.drop(self._first, (value.name for value in self._waiting.popleft().values))
        self._first += 1


class Waiting:
    """The samples that wait for one sink. With a `store` a thread of its own writes it if `threaded`.

    `change` is notified of new samples. `store_state` receives the reason when the store fails, '' when it works again;
    `overflows` is called when samples are dropped because too many wait.
    """

    def __init__(
        self,
        store: Store | None,
        threaded: bool,
        change: threading.Condition,
        store_state: Callable[[str], None],
        overflows: Callable[[], None] = lambda: None,
    ) -> None:
        self._memory, self._store = InMemory(), store
        self._change, self._store_state, self._overflows = change, store_state, overflows
        self._ending = False
        self._thread: threading.Thread | None = None
        self._threaded = threaded and store is not None
        self._is_direct = store is None
        """Samples go from memory to the sink: it has no store, or its store cannot be written at present."""
        self._is_failing = False
        """The last attempt to write or read the store has failed."""
        self._in_flight = False
        """The sink has samples from memory although it has a store, which must not get them meanwhile."""

    def __len__(self) -> int:
        return len(self._memory) + (0 if self._store is None else len(self._store))

    @property
    def unsaved(self) -> int:
        """Return the number of samples that are in memory only."""
        return len(self._memory)

    @property
    def count(self) -> SampleCount:
        """Return the numbers of waiting and of dropped samples."""
        dropped = [self._memory.dropped, *([] if self._store is None else [self._store.dropped])]
        points = dropped[0].points.copy()
        for other in dropped[1:]:
            points.update(other.points.copy())  # another thread may drop samples meanwhile
        return SampleCount(len(self), sum(one.samples for one in dropped), points)

    def open(self) -> None:
        """Open the store, if any. Raises sqlite3.Error, OSError, StoreError."""
        if self._store is not None and not self._store.is_open:
            self._store.open()

    def start(self) -> None:
        """Begin to keep samples; those of an earlier run wait already."""
        if self._threaded:
            self._thread = threading.Thread(target=self._run, name="framekit store", daemon=True)
            self._thread.start()
        elif self._store is not None:
            self._keep()

    def put(self, sample: Sampled) -> None:
        """Add a sample; with threads the caller never waits for a disk."""
        has_room = self._memory.put(sample)
        with self._change:
            self._change.notify_all()
        if not has_room:
            self._overflows()
        if not self._threaded and self._store is not None:
            self._keep()

    def first(self, most: int) -> tuple[int, list[Sampled]]:
        """Return the oldest samples that can be sent, and the number of the first of them.

        Each call is followed by `done` or `not_taken`.
        """
        store = self._store
        if store is not None:
            try:
                start, samples = store.first(most)
            except STORE_ERRORS as error:
                self._store_fails(error)
            else:
                if samples:
                    return start, samples
        with self._change:
            if not self._is_direct:
                return 0, []
            start, samples = self._memory.first(most)
            self._in_flight = store is not None and bool(samples)
            return start, samples

    def done(self, start: int, number: int) -> None:
        """Remove `number` samples from `start` on, which the sink has accepted."""
        store = self._store
        if store is None or self._in_flight:
            self._memory.done(start, number)
            self.not_taken()
            return
        try:
            store.done(start, number)
        except STORE_ERRORS as error:  # the store remembers that they were sent
            self._store_fails(error)

    def not_taken(self) -> None:
        """Return the samples of the last `first` call to the queue."""
        with self._change:
            self._in_flight = False
            self._change.notify_all()

    @property
    def has_some(self) -> bool:
        """Return whether samples can be sent."""
        if self._store is not None and not self._is_failing:
            return bool(len(self._store))
        return self._is_direct and bool(len(self._memory))

    def end(self) -> None:
        """End the input: no more samples follow."""
        with self._change:
            self._ending = True
            self._change.notify_all()

    def join(self, until: float) -> None:
        """Wait until the samples in memory are in the store, at most to this moment (`time.monotonic`)."""
        if self._thread is not None:
            self._thread.join(max(0.0, until - time.monotonic()))
        elif not self._threaded:
            self._keep()

    def close(self) -> None:
        """Close the store, which keeps its samples; samples in memory only are dropped."""
        if self._store is not None:
            try:
                self._store.close()
            except STORE_ERRORS as error:
                self._store_fails(error)
        self._memory.clear()

    # ---- the store ----------------------------------------------------------------------------------------

    def _run(self) -> None:
        """Write the store. After a failure the next attempt is made with the first sample after a pause."""
        self._keep()
        while True:
            with self._change:
                if self._is_failing:
                    self._change.wait_for(lambda: self._ending, RETRY)
                    self._change.wait_for(lambda: self._ending or not self._in_flight, LONGEST_FLIGHT)
                    self._is_direct = self._in_flight  # False: the next sample is for the store
                self._change.wait_for(lambda: self._ending or len(self._memory) or self._is_direct)
                ending = self._ending
            self._keep()
            if ending:
                return

    def _keep(self) -> None:
        """Move samples from memory into the store."""
        store = self._store
        if store is None:
            return
        with self._change:
            if not self._change.wait_for(lambda: not self._in_flight, LONGEST_FLIGHT):
                return
            self._is_direct = False
        try:
            if not store.is_open:
                store.open()
            while True:
                start, samples = self._memory.first(AT_ONCE)
                if not samples:
                    return
                before = store.dropped.samples
                if self._is_failing:
                    store.first(1)  # a store that cannot be read gets no more samples
                store.add(samples)
                self._memory.done(start, len(samples))
                if store.dropped.samples > before:
                    self._overflows()
                if self._is_failing:
                    self._is_failing = False
                    self._store_state("")
                with self._change:
                    self._change.notify_all()
        except STORE_ERRORS as error:
            self._store_fails(error)

    def _store_fails(self, error: Exception) -> None:
        with self._change:
            self._is_failing = self._is_direct = True
            self._change.notify_all()
        self._store_state(error_text(error))
