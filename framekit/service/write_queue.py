"""Write records in a thread, so that the caller does not wait for a slow disk or reader.

Captures, and the standard streams of verbs at work, use it. The number of waiting bytes is limited by `most`.
"""

from __future__ import annotations

import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Callable

AT_ONCE = 1 << 16
"""Number of bytes up to which waiting records are joined for one write."""

LOOK_AGAIN = 1.0
LONGEST_STALL = 10.0
LONGEST_END = 60.0
"""Seconds: between two calls of `is_stopped` while the end waits; and for the end of a stopped program without progress
of the writes, and in all.
"""


class WriteQueue:
    """Passes joined records and their number to `write`, in order, in a thread that starts with the first record.

    `write` handles its failures. If it raises an error all the same, `has_failed` is called in the thread with the
    error and the number of records that are not written, and the queue is closed; then again for records that were
    added meanwhile.
    """

    def __init__(
        self,
        write: Callable[[bytes, int], object],
        most: int | None,
        name: str,
        has_failed: Callable[[BaseException, int], object] = lambda error, number: None,
    ) -> None:
        self.most = most
        """Number of waiting bytes from which on `add` refuses records; None: no limit."""
        self.change = threading.Condition()
        """Lock of the queue, and of the state that its owner keeps with it; notified of each change."""
        self.waiting = 0
        """Bytes that are not written yet."""
        self.has_begun = False
        """Whether a record was added."""
        self.is_ending = False
        """Whether the owner waits for the end of the queue."""
        self.is_closed = False
        """Whether the thread has ended: no record is accepted any more."""
        self._write, self._has_failed = write, has_failed
        self._records: deque[bytes] = deque()
        self._in_write = self._records_in_write = 0
        """Bytes that `write` has received and not written yet, and its number of records."""
        self.thread = threading.Thread(target=self._run, daemon=True, name=name)

    def add(self, record: bytes, *, wait: bool = False) -> bool:
        """Add a record; return False if too much waits, or if the queue is closed. `wait`: wait for room instead."""
        with self.change:
            while wait and self.is_full and not self.is_closed:
                self.change.wait()
            if self.is_full or self.is_closed:
                return False
            self._records.append(record)
            self.waiting += len(record)
            if not self.has_begun:
                self.has_begun = True
                self.thread.start()
            self.change.notify_all()
        return True

    @property
    def is_full(self) -> bool:
        """Return whether so much waits that `add` refuses records."""
        return self.most is not None and self.waiting >= self.most

    def discard(self) -> None:
        """Drop the waiting records; those of the present write do not count as waiting any more."""
        with self.change:
            self._records.clear()
            self.waiting = self._in_write = 0
            self.change.notify_all()

    # ---- for `write`, in the thread -------------------------------------------------------------------------

    def has_written(self, size: int) -> None:
        """Count bytes of the present write as written, before its end."""
        with self.change:
            size = min(size, self._in_write)  # else they were discarded meanwhile
            self._in_write -= size
            self.waiting -= size
            self.change.notify_all()

    def pause(self, seconds: float) -> None:
        """Wait before another attempt, at most until the queue ends."""
        with self.change:
            self.change.wait_for(lambda: self.is_ending, seconds)

    # ---- the end --------------------------------------------------------------------------------------------

    def close(self, is_stopped: Callable[[], bool] = lambda: False) -> bool:
        """Return when all records are written; False if `is_stopped` and the writes make no progress: they are dropped.

        Records are accepted until then.
        """
        with self.change:
            self.is_ending = True
            self.change.notify_all()
            try:
                if self._waits_for_end(is_stopped):
                    return True
                self.discard()
                return False
            finally:  # also after Ctrl-C
                self.is_closed = True

    def _waits_for_end(self, is_stopped: Callable[[], bool]) -> bool:
        """Wait for the thread; return False if a stopped program has waited too long."""
        if not self.has_begun:
            return True
        while not is_stopped():
            if self.change.wait_for(lambda: self.is_closed, timeout=LOOK_AGAIN):
                return True
        end = time.monotonic() + LONGEST_END
        while not self.is_closed:
            before, limit = self.waiting, min(LONGEST_STALL, end - time.monotonic())
            if not self.change.wait_for(lambda: self.is_closed or self.waiting != before, timeout=limit):  # noqa: B023
                return False
        return True

    # ---- the thread -----------------------------------------------------------------------------------------

    def _run(self) -> None:
        if sys.platform != "win32":  # the main thread takes all signals: only it can close what their handlers use
            signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGTERM, signal.SIGHUP))
        try:
            while records := self._next():
                self._write(records, self._records_in_write)
                self.has_written(len(records))
        except BaseException as error:
            self._has_failed(error, self._records_in_write + self._take_all())
            with self.change:
                self.is_closed = True
                self.change.notify_all()
            if later := self._take_all():
                self._has_failed(error, later)
            raise

    def _take_all(self) -> int:
        """Remove the waiting records and return their number."""
        with self.change:
            number = len(self._records)
            self._records.clear()
        return number

    def _next(self) -> bytes:
        """Wait for records and return them joined; close the queue and return none at its end."""
        with self.change:
            self.change.wait_for(lambda: self._records or self.is_ending)
            if not self._records:
                self.is_closed = True
                self.change.notify_all()
                return b""
            found = [self._records.popleft()]
            size = len(found[0])
            while self._records and size + len(self._records[0]) <= AT_ONCE:
                size += len(self._records[0])
                found.append(self._records.popleft())
            self._in_write, self._records_in_write = size, len(found)
            return b"".join(found)
