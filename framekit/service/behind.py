"""Writing in a thread, so that the caller does not wait; the number of waiting bytes is limited."""

from __future__ import annotations

import threading
from collections.abc import Callable


class Behind:
    """Passes joined records and their number to `write`, in order, in a thread; about `most` bytes may wait.

    `write` handles its failures. If it raises an error all the same, `has_failed` is called in the thread with the
    error and the number of records that are not written, and later records are refused.
    """

    def __init__(
        self,
        write: Callable[[bytes, int], object],
        most: int,
        name: str,
        has_failed: Callable[[BaseException, int], object],
    ) -> None:
        self.failed = False
        """Whether an error has ended the thread and is reported."""
        self._write = write
        self._has_failed = has_failed
        self._most = most
        self._records: list[bytes] = []
        self._in_write = 0
        """Number of records that the thread is writing."""
        self._waiting = 0
        """Bytes of records that are not written yet."""
        self._ended = False
        self._change = threading.Condition()
        self._thread = threading.Thread(target=self._run, daemon=True, name=name)
        self._thread.start()

    def write(self, record: bytes, *, wait: bool = False) -> bool:
        """Add a record; return False if too much waits. `wait`: wait for room instead."""
        with self._change:
            while wait and self._waiting >= self._most and not self._ended:
                self._change.wait()
            if self._waiting >= self._most or self._ended:
                return False
            self._records.append(record)
            self._waiting += len(record)
            self._change.notify_all()
        return True

    def close(self) -> None:
        """Return when all accepted records are written."""
        with self._change:
            self._ended = True
            self._change.notify_all()
        self._thread.join()

    def _run(self) -> None:
        try:
            self._write_records()
        except BaseException as error:
            with self._change:
                self._ended = True
                self._change.notify_all()
                number = self._in_write + len(self._records)
            self._has_failed(error, number)
            self.failed = True
            raise

    def _write_records(self) -> None:
        """Write records until the end."""
        while True:
            with self._change:
                while not self._records and not self._ended:
                    self._change.wait()
                records, self._records = self._records, []
            if not records:
                return
            data, self._in_write = b"".join(records), len(records)
            self._write(data, self._in_write)
            with self._change:
                self._waiting -= len(data)
                self._change.notify_all()
