"""The store of samples that wait for a server: an SQLite file that survives the server, the network and the program.

Every sample is stored before it is sent, and removed when the server has confirmed it. After a kill the program sends
only the unconfirmed samples again.
"""

from __future__ import annotations

import json
import os
import sqlite3
import threading
from collections.abc import Callable, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path

from framekit.definition.keys import NUMBER, Form, key, ref
from framekit.run.points import PointValue
from framekit.run.trouble import Dropped
from framekit.sinks.base import Sampled, SinkKind
from framekit.sinks.database import bound_log, close_moved, connected, lock_of, transaction, write_once
from framekit.sinks.opened_file import REPLACED, OpenedFile

APPLICATION = 0x464B5746
"""The application id in the SQLite header; it identifies stores of framekit."""

MOST_WAITING = 100_000
"""Default limit of samples that wait for a sink."""

LONGEST_CLOSE = 1.0
"""Time limit for closing (s)."""

_TABLE = f"""
BEGIN;
PRAGMA application_id = {APPLICATION};
PRAGMA user_version = 1;
CREATE TABLE waiting (number INTEGER PRIMARY KEY, time INTEGER NOT NULL, points TEXT NOT NULL);
COMMIT;
"""
STORE = Form(ref("text"), lambda r, node: r.loader.file(node))


class StoreError(ValueError):
    """Raised for a file that is no store; the text contains the remedy."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NetworkSink(SinkKind):
    """A sink that sends values to a server. Unsent samples wait in the file `store`, at most `most`."""

    store: str = key(
        "store", STORE, "The file in which values wait for the server, also over a restart; default: one beside the "
        "run, named after it and the kind of the sink.", default="",
    )  # fmt: skip
    most: int = key(
        "most", NUMBER, "So many samples wait there at most; then the oldest go, and are counted. Default: 100000.",
        default=MOST_WAITING,
    )  # fmt: skip

    def mistakes_of_store(self) -> tuple[tuple[str, str, str], ...]:
        """Return the mistakes in the keys of the store."""
        return () if self.most > 0 else (("most", "nothing could wait", "give 1 or more, or leave most out"),)


class Store:
    """Samples that wait, in a file; the oldest first. Any thread may use it. Raises sqlite3.Error, OSError, StoreError.

    The effect of a method survives a kill of the program after its return. A loss of power may cost the last moments.
    If another program moves or deletes the file, its samples are copied to a new file at the path, and `has_moved` is
    called with a message.
    """

    def __init__(self, path: Path, most: int, has_moved: Callable[[str], None] = lambda change: None) -> None:
        self.path, self.most, self._has_moved = path, most, has_moved
        self._opened_file: OpenedFile | None = None
        self.dropped = Dropped()
        self._lock = threading.Lock()
        self._file: int | None = None
        self._database: sqlite3.Connection | None = None
        self._first = self._next = 0
        self._damaged: set[int] = set()
        """The numbers of samples in the file that cannot be read."""
        self._kept_from = 0
        """The number of the oldest sample in the file; those before `_first` were sent already."""

    def __len__(self) -> int:
        return self._next - self._first

    @property
    def is_open(self) -> bool:
        """Return whether samples can be added."""
        return self._database is not None

    def open(self) -> None:
        """Open the file with the samples of earlier runs."""
        with self._lock:
            self._file = lock_of(self.path)
            try:
                self._database = database = self._connected()
                first, last = database.execute("SELECT min(number), max(number) FROM waiting").fetchone()
            except BaseException:
                self._close()
                raise
            self._first, self._next = (self._next, self._next) if first is None else (max(self._first, first), last + 1)
            self._kept_from = self._first if first is None else first

    def _connected(self) -> sqlite3.Connection:
        """Return the database at the path, which is made if it is missing or empty."""
        database = connected(self.path)
        try:
            self._make(database)
            write_once(database, "user_version", 1)
            self._opened_file = OpenedFile(self.path)
        except BaseException:
            database.close()
            raise
        return database

    def _follow_path(self, database: sqlite3.Connection) -> sqlite3.Connection:
        """Return the database; if its file was moved or deleted, a new one at the path with the samples.

        Raises StoreError if the path has the samples of another store; the open file is used on.
        """
        change = "" if self._opened_file is None else self._opened_file.change()
        if not change:
            return database
        if change == REPLACED and not _is_empty_store(self.path):
            raise StoreError(f"{self.path} was replaced – end the run, and start it again")
        new = self.path.with_name(f".{self.path.name}.new")
        new.unlink(missing_ok=True)
        try:
            with closing(connected(new)) as copy:
                copy.executescript(_TABLE)
                rows = database.execute("SELECT * FROM waiting WHERE number >= ?", (self._first,))
                with transaction(copy):
                    copy.executemany("INSERT INTO waiting VALUES (?, ?, ?)", rows)
            new.replace(self.path)
        finally:
            new.unlink(missing_ok=True)
        self._database = None
        close_moved(database, self.path)
        self._database, self._kept_from = self._connected(), self._first
        self._has_moved(change)
        return self._database

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
        bound_log(database)
        if not tables:
            database.executescript(_TABLE)

    def add(self, samples: Sequence[Sampled]) -> None:
        """Add samples, oldest first, all or none; the oldest of too many are dropped and counted."""
        with self._lock:
            database = self._follow_path(self._opened())
            first, following = self._first, self._next + len(samples)
            rows = ((self._next + at, one.time, _text_of(one.values)) for at, one in enumerate(samples))
            gone: list[tuple[int, str]] = []
            with transaction(database):
                database.executemany("INSERT INTO waiting VALUES (?, ?, ?)", rows)
                if following - first > self.most:
                    first = following - self.most
                    gone = database.execute("SELECT number, points FROM waiting WHERE number < ?", (first,)).fetchall()
                if first > self._kept_from:
                    database.execute("DELETE FROM waiting WHERE number < ?", (first,))
            for number, text in gone:
                if number >= self._first and number not in self._damaged:
                    self.dropped.drop(number, (value.name for value in self._values_of(number, text)))
            self._first, self._next, self._kept_from = first, following, first

    def first(self, most: int) -> tuple[int, list[Sampled]]:
        """Return the oldest samples, and the number of the first of them."""
        with self._lock:
            if self._database is None:
                return 0, []
            rows = self._database.execute(
                "SELECT number, time, points FROM waiting WHERE number >= ? ORDER BY number LIMIT ?",
                (self._first, most),
            )
            found = [Sampled(time, self._values_of(at, text)) for at, time, text in rows]
            self.dropped.sending(self._first + len(found))
            return self._first, found

    def done(self, start: int, number: int) -> None:
        """Remove `number` samples from `start` on, which were sent.

        If that fails, the store still knows that they were sent: `first` does not return them again, and the next
        change of the file removes them.
        """
        with self._lock:
            if self._database is None:
                return  # the run has ended: they are sent once more after the next start
            end = start + number
            self.dropped.confirmed(end)
            self._first = max(self._first, end)
            with transaction(self._database):
                self._database.execute("DELETE FROM waiting WHERE number < ?", (self._first,))
            self._kept_from = self._first

    def close(self) -> None:
        """Close the file, which keeps its samples; does not wait long for a disk that hangs."""
        if self._lock.acquire(timeout=LONGEST_CLOSE):
            try:
                if self._database is not None:
                    self._follow_path(self._database)
            except (sqlite3.Error, OSError, StoreError):
                self._drop_all()
                raise
            finally:
                self._close()
                self._lock.release()

    def _drop_all(self) -> None:
        """Count the samples of a moved file as lost: the next run does not find them."""
        if self._database is None:
            return
        with suppress(sqlite3.Error):
            rows = self._database.execute("SELECT number, points FROM waiting WHERE number >= ?", (self._first,))
            for number, text in rows:
                self.dropped.drop(number, (value.name for value in self._values_of(number, text)))
            self._first = self._next

    def _close(self) -> None:
        database, self._database = self._database, None
        if database is not None:
            if self._opened_file is not None and self._opened_file.change():
                close_moved(database, self.path)
            else:
                database.close()
        file, self._file = self._file, None
        if file is not None:
            os.close(file)

    def _values_of(self, number: int, text: str) -> tuple[PointValue, ...]:
        """Return the values of a sample; an empty tuple for a damaged sample, which counts as dropped."""
        try:
            return tuple(PointValue(*fields) for fields in json.loads(text))
        except (ValueError, TypeError):
            if number not in self._damaged:
                self._damaged.add(number)
                self.dropped.drop(number, ())
            return ()

    def _opened(self) -> sqlite3.Connection:
        if self._database is None:
            raise StoreError(f"{self.path} is closed")
        return self._database


def _is_empty_store(path: Path) -> bool:
    """Return whether the database at a path is a store without samples, without touching its files.

    Raise sqlite3.Error.
    """
    with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro&immutable=1", uri=True)) as database:
        (application,) = database.execute("PRAGMA application_id").fetchone()
        if application != APPLICATION:
            return False
        (waiting,) = database.execute("SELECT count(*) FROM waiting").fetchone()
        return not waiting


def _text_of(values: Sequence[PointValue]) -> str:
    fields = [(one.name, one.value, one.quality, one.reason, one.time, one.number) for one in values]
    return json.dumps(fields, ensure_ascii=False, separators=(",", ":"))
