"""Writing in a thread, so that the caller does not wait; the number of waiting bytes is limited."""

from __future__ import annotations

import threading
from collections.abc import Callable


class Behind:
    """Passes records to `write`, in order, in a thread of its own; about `most` bytes may wait.

    `error`: the OSError raised by `write`; then `on_error` is called in the thread, and later records are discarded.
    """

    def __init__(
        self, write: Callable[[bytes], object], most: int, name: str, on_error: Callable[[], object] = lambda: None
    ) -> None:
        self.error: OSError | None = None
        self._write = write
        self._most = most
        self._on_error = on_error
        self._records: list[bytes] = []
        self._waiting = 0
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
        while True:
            with self._change:
                while not self._records and not self._ended:
                    self._change.wait()
                records, self._records = self._records, []
            if not records:
                return
            data = b"".join(records)
            if self.error is None:
                try:
                    self._write(data)
                except OSError as error:
                    self.error = error
                    self._on_error()
            with self._change:
                self._waiting -= len(data)
                self._change.notify_all()
