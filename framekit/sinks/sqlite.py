"""A history of values in SQLite: the embedded default, read by `framekit history` and by every tool for SQLite."""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

from framekit.definition.keys import key
from framekit.definition.times import NEVER
from framekit.run.model import Point
from framekit.sinks.base import FILE, PERIOD, Sampled, Sink, SinkKind, as_glob, good_value, open_alone

APPLICATION = 0x464B4856
"""What SQLite calls the application's number; it tells our files from others."""

VERSION = 1
CLEANING = 600_000_000_000
"""How often values that are too old are taken out (ns of the values' time)."""

_TABLES = f"""
BEGIN;
PRAGMA application_id = {APPLICATION};
PRAGMA user_version = {VERSION};
CREATE TABLE points (id INTEGER PRIMARY KEY, name TEXT NOT NULL UNIQUE, unit TEXT NOT NULL);
CREATE TABLE history (
    point INTEGER NOT NULL, time INTEGER NOT NULL, value, quality TEXT NOT NULL, reason TEXT NOT NULL);
CREATE INDEX by_point ON history (point, time);
CREATE INDEX by_time ON history (time);
COMMIT;
"""
_POINT = "INSERT INTO points (name, unit) VALUES (?, ?) ON CONFLICT (name) DO UPDATE SET unit = excluded.unit"


class HistoryError(ValueError):
    """A file that holds no history; the text says what to do."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SqliteHistory(SinkKind):
    """A table of values. `keep` (ns): older ones are taken out."""

    word: ClassVar[str] = "sqlite"
    is_local: ClassVar[bool] = True
    sqlite: str = key("sqlite", FILE, "A database of SQLite with a table history.")
    keep: int | None = key("keep", PERIOD, "How long values are kept there; default: for ever.", default=None)

    def mistakes(self, points: Sequence[Point]) -> Iterator[tuple[str, str, str]]:
        if self.keep is not None and self.keep < 1:
            yield "keep", "nothing would be kept", "give 1 or more, or leave keep out"
        elif self.keep is not None and self.keep >= NEVER:
            yield "keep", "'keep: never' has no effect: without keep values stay for ever", "remove it"

    def make(self) -> Sink:
        return SqliteSink(Path(self.sqlite), self.keep)


class SqliteSink(Sink):
    """Writes samples, as many as come together in one transaction. Raises sqlite3.Error, HistoryError."""

    def __init__(self, path: Path, keep: int | None) -> None:
        self.path, self._keep = path, keep
        self._database: sqlite3.Connection | None = None
        self._lock: int | None = None
        self._numbers: dict[str, int] = {}
        self._cleaned = 0

    def open(self, points: Sequence[Point]) -> None:
        self._lock = open_alone(self.path.with_name(f"{self.path.name}.lock"))
        try:
            self._database = database = sqlite3.connect(self.path, isolation_level=None, check_same_thread=False)
            if not _is_history(database, self.path):
                database.execute("PRAGMA journal_mode = WAL")
                database.executescript(_TABLES)
            database.execute("PRAGMA synchronous = NORMAL")
            database.execute("BEGIN")
            for point in points:
                database.execute(_POINT, (point.name, point.unit))
            database.execute("COMMIT")
            self._numbers = dict(database.execute("SELECT name, id FROM points"))
        except BaseException:
            self.close()
            raise

    def write(self, samples: Sequence[Sampled]) -> int:
        database = self._database
        if database is None or not samples:
            return 0
        rows = (
            (
                self._numbers[one.name],
                sample.time,
                _storable(good_value(one)),
                one.quality,
                one.reason,
            )
            for sample in samples
            for one in sample.values
        )
        database.execute("BEGIN IMMEDIATE")
        try:
            database.executemany("INSERT INTO history VALUES (?, ?, ?, ?, ?)", rows)
            now = samples[-1].time
            if self._keep is not None and now >= self._cleaned + CLEANING:
                database.execute("DELETE FROM history WHERE time < ?", (now - self._keep,))
                self._cleaned = now
            database.execute("COMMIT")
        except BaseException:
            if database.in_transaction:
                database.execute("ROLLBACK")
            raise
        return len(samples)

    def close(self) -> None:
        database, self._database = self._database, None
        if database is not None:
            database.close()
        lock, self._lock = self._lock, None
        if lock is not None:
            os.close(lock)


def _storable(value: Any) -> Any:
    """Whole numbers that SQLite has no room for as texts."""
    return str(value) if isinstance(value, int) and not -(1 << 63) <= value < 1 << 63 else value


def _is_history(database: sqlite3.Connection, path: Path) -> bool:
    """Whether the file holds a history; False for an empty one. Raises HistoryError for anything else."""
    try:
        (application,) = database.execute("PRAGMA application_id").fetchone()
        (version,) = database.execute("PRAGMA user_version").fetchone()
        (tables,) = database.execute("SELECT count(*) FROM sqlite_master").fetchone()
    except sqlite3.DatabaseError as error:
        if isinstance(error, sqlite3.OperationalError):
            raise
        raise HistoryError(f"{path} is no database – name another file") from None
    if not application and not tables:
        return False
    if application != APPLICATION:
        raise HistoryError(f"{path} is a database of something else – name another file")
    if version != VERSION:
        raise HistoryError(f"{path} has version {version} of a history, this framekit reads {VERSION} – move it away")
    return True


class HistoryRow(NamedTuple):
    """A value of a history; `time` in ns since 1970 (UTC)."""

    time: int
    point: str
    value: Any
    unit: str
    quality: str
    reason: str


def read_history(
    path: Path, points: Sequence[str] = ("*",), since: int | None = None, until: int | None = None
) -> Iterator[HistoryRow]:
    """The values of a history, oldest first; of the points whose names fit one of `points`, `*` for any text.

    Raises HistoryError for a file that holds none, sqlite3.Error.
    """
    if not os.path.isfile(path):
        raise HistoryError(f"there is no {path} – has the run been started?")
    where, given = ["(" + " OR ".join("name GLOB ?" for _ in points) + ")"], list[Any](map(as_glob, points))
    if since is not None:
        where, given = [*where, "time >= ?"], [*given, since]
    if until is not None:
        where, given = [*where, "time <= ?"], [*given, until]
    with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)) as database:
        if not _is_history(database, path):
            raise HistoryError(f"{path} holds no history yet")
        rows = database.execute(
            "SELECT time, name, value, unit, quality, reason FROM history JOIN points ON points.id = history.point "
            f"WHERE {' AND '.join(where)} ORDER BY time, history.rowid",
            given,
        )
        yield from map(HistoryRow._make, rows)
