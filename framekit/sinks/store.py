"""What waits for a server is kept in SQLite: it outlasts servers, networks and the program, and is sent in order.

Every sample goes there before it is sent, and leaves it when the server has confirmed it. So a program that is killed
sends anew what was not confirmed, and nothing else.
"""

from __future__ import annotations

import json
import os
import sqlite3
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from framekit.definition.keys import NUMBER, Form, key, ref
from framekit.run.points import PointValue
from framekit.sinks.base import Sampled, SinkKind, open_alone

APPLICATION = 0x464B5746
"""What SQLite calls the application's number; it tells our files from others."""

MOST_WAITING = 100_000
"""Samples that wait for a sink at most."""

LONGEST_CLOSE = 1.0
"""Seconds."""

_TABLE = f"""
BEGIN;
PRAGMA application_id = {APPLICATION};
PRAGMA user_version = 1;
CREATE TABLE waiting (number INTEGER PRIMARY KEY, time INTEGER NOT NULL, points TEXT NOT NULL);
COMMIT;
"""
STORE = Form(ref("text"), lambda r, node: r.loader.file(node))


class StoreError(ValueError):
    """A file that is no store; the text says what to do."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NetworkSink(SinkKind):
    """A sink that sends values to a server. What it cannot send waits in the file `store`, `most` samples at most."""

    store: str = key(
        "store", STORE, "The file in which values wait for the server, also over a restart; default: one beside the "
        "run, named after it and the kind of the sink.", default="",
    )  # fmt: skip
    most: int = key(
        "most", NUMBER, "So many samples wait there at most; then the oldest go, and are counted. Default: 100000.",
        default=MOST_WAITING,
    )  # fmt: skip

    def mistakes_of_store(self) -> tuple[tuple[str, str, str], ...]:
        """What the keys of the store say wrongly."""
        return () if self.most > 0 else (("most", "nothing could wait", "give 1 or more, or leave most out"),)


class Store:
    """Samples that wait, in a file; the oldest first. Any thread may use it. Raises sqlite3.Error, OSError, StoreError.

    Once a method has returned, what it did outlasts a kill of the program. A loss of power may cost the last moments.
    """

    def __init__(self, path: Path, most: int) -> None:
        self.path, self._most = path, most
        self.dropped = 0
        self._lock = threading.Lock()
        self._file: int | None = None
        self._database: sqlite3.Connection | None = None
        self._first = self._next = 0

    def __len__(self) -> int:
        return self._next - self._first

    @property
    def is_open(self) -> bool:
        """Whether samples can be added."""
        return self._database is not None

    def open(self) -> None:
        """Goes on with what waits there."""
        with self._lock:
            self._file = open_alone(self.path.with_name(f"{self.path.name}.lock"))
            try:
                self._database = database = sqlite3.connect(self.path, isolation_level=None, check_same_thread=False)
                self._make(database)
                first, last = database.execute("SELECT min(number), max(number) FROM waiting").fetchone()
            except BaseException:
                self._close()
                raise
            self._first, self._next = (0, 0) if first is None else (first, last + 1)

    def _make(self, database: sqlite3.Connection) -> None:
        try:
            (application,) = database.execute("PRAGMA application_id").fetchone()
            (tables,) = database.execute("SELECT count(*) FROM sqlite_master").fetchone()
        except sqlite3.OperationalError:
            raise
        except sqlite3.DatabaseError:
            raise StoreError(f"{self.path} is no database – name another file") from None
        if application != APPLICATION and (application or tables):
            raise StoreError(f"{self.path} is a database of something else – name another file")
        database.execute("PRAGMA journal_mode = WAL")
        database.execute("PRAGMA synchronous = NORMAL")
        if not tables:
            database.executescript(_TABLE)

    def add(self, samples: Sequence[Sampled]) -> None:
        """Takes samples, the oldest first, all or none; those that are too many then are dropped, and counted."""
        with self._lock:
            database = self._opened()
            first, following = self._first, self._next + len(samples)
            rows = ((self._next + at, one.time, _text_of(one.values)) for at, one in enumerate(samples))
            database.execute("BEGIN IMMEDIATE")
            try:
                database.executemany("INSERT INTO waiting VALUES (?, ?, ?)", rows)
                if following - first > self._most:
                    first = following - self._most
                    database.execute("DELETE FROM waiting WHERE number < ?", (first,))
                database.execute("COMMIT")
            except BaseException:
                if database.in_transaction:
                    database.execute("ROLLBACK")
                raise
            self.dropped += first - self._first
            self._first, self._next = first, following

    def first(self, most: int) -> tuple[int, list[Sampled]]:
        """The oldest samples, and the number of the first of them."""
        with self._lock:
            if self._database is None:
                return 0, []
            rows = self._database.execute(
                "SELECT time, points FROM waiting WHERE number >= ? ORDER BY number LIMIT ?", (self._first, most)
            )
            return self._first, [Sampled(time, _values_of(text)) for time, text in rows]

    def done(self, start: int, number: int) -> None:
        """The samples from `start` on, so many, have been sent; what was dropped of them meanwhile was not lost."""
        with self._lock:
            if self._database is None:
                return  # the run has ended: they are sent once more after the next start
            end = start + number
            self._database.execute("DELETE FROM waiting WHERE number < ?", (end,))
            self.dropped -= min(self._first, end) - start
            self._first = max(self._first, end)

    def close(self) -> None:
        """The end; what waits stays in the file. A disk that hangs is not waited for."""
        if self._lock.acquire(timeout=LONGEST_CLOSE):
            try:
                self._close()
            finally:
                self._lock.release()

    def _close(self) -> None:
        database, self._database = self._database, None
        if database is not None:
            database.close()
        file, self._file = self._file, None
        if file is not None:
            os.close(file)

    def _opened(self) -> sqlite3.Connection:
        if self._database is None:
            raise StoreError(f"{self.path} is closed")
        return self._database


def _text_of(values: Sequence[PointValue]) -> str:
    fields = [(one.name, one.value, one.quality, one.reason, one.time, one.number) for one in values]
    return json.dumps(fields, ensure_ascii=False, separators=(",", ":"))


def _values_of(text: str) -> tuple[PointValue, ...]:
    found: list[list[Any]] = json.loads(text)
    return tuple(PointValue(*fields) for fields in found)
