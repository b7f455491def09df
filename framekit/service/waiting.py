"""Samples that wait for a sink: in memory, and for a server in a file, where a thread puts them at once."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable

from framekit.sinks.base import Sampled
from framekit.sinks.store import MOST_WAITING, Store

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
