"""A history of values in SQLite: the embedded default, read by `framekit history` and by every tool for SQLite."""

from __future__ import annotations

import os
import sqlite3
import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

from framekit.definition.keys import key
from framekit.definition.times import NEVER
from framekit.run.model import Point
from framekit.sinks.base import FILE, PERIOD, Host, Sampled, Sink, SinkKind, as_glob, good_value
from framekit.sinks.database import bound_log, close_moved, connected, lock_of, transaction
from framekit.sinks.opened_file import OpenedFile

APPLICATION = 0x464B4856
"""The application id in the SQLite header; it identifies histories of framekit."""

VERSION = 1
CLEANING = 600_000_000_000
"""The time between two removals of old values, and before the first (ns)."""
MOST_REMOVED = 10_000
"""Number of rows that are deleted together."""
LONGEST_QUERY = 5.0
"""Largest duration of a query for a course (s)."""
CHECK_EVERY = 10_000
"""Number of instructions of SQLite between two checks of this duration."""

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
    """Raised for a file that holds no history; the text contains the remedy."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SqliteHistory(SinkKind):
    """A table of values. `keep` (ns): age from which values are deleted."""

    word: ClassVar[str] = "sqlite"
    is_local: ClassVar[bool] = True
    sqlite: str = key("sqlite", FILE, "A database of SQLite with a table history.")
    keep: int | None = key("keep", PERIOD, "How long values are kept there; default: for ever.", default=None)

    def mistakes(self) -> Iterator[tuple[str, str, str]]:
        if self.keep is not None and self.keep < 1:
            yield "keep", "nothing would be kept", "give 1 or more, or leave keep out"
        elif self.keep is not None and self.keep >= NEVER:
            yield "keep", "'keep: never' has no effect: without keep values stay for ever", "remove it"

    def make(self) -> Sink:
        return SqliteSink(Path(self.sqlite), self.keep)


class SqliteSink(Sink):
    """Writes samples, as many as come together in one transaction. Raises sqlite3.Error, HistoryError, OSError.

    If another program moves, deletes or replaces the database, the next samples go to the database at the path.
    """

    def __init__(self, path: Path, keep: int | None) -> None:
        self.path, self._keep = path, keep
        self._host: Host | None = None
        self._database: sqlite3.Connection | None = None
        self._lock: int | None = None
        self._points: Sequence[Point] = ()
        self._opened: OpenedFile | None = None
        self._numbers: dict[str, int] = {}
        self._ages: RowAges | None = None

    def meet(self, host: Host) -> None:
        self._host = host

    def _now(self) -> int:
        return time.monotonic_ns() if self._host is None else self._host.now()

    def open(self, points: Sequence[Point]) -> None:
        self._points = points
        self._lock = lock_of(self.path)
        was_empty = self._opened is None and self.path.exists() and not self.path.stat().st_size
        try:
            self._database = database = connected(self.path)
            is_new = not _is_history(database, self.path)
            bound_log(database)
            if is_new:
                database.executescript(_TABLES)
            with transaction(database):
                for point in points:
                    database.execute(_POINT, (point.name, point.unit))
            self._opened = OpenedFile(self.path)
            self._numbers = dict(database.execute("SELECT name, id FROM points"))
            if self._keep is not None and self._ages is None:
                self._ages = RowAges(_last_row(database), self._keep)
        except BaseException:
            self.close()
            raise
        if was_empty and self._host is not None:
            self._host.report("the file was empty, a new history begins")

    def _follow_path(self) -> None:
        """Open the database at the path if it is another file than the open one."""
        change = "" if self._database is None or self._opened is None else self._opened.change()
        if change:
            self._ages = None  # its rows are those of the other file
            self.close()
            self.open(self._points)
            if self._host is not None:
                self._host.report(change)

    def write(self, samples: Sequence[Sampled]) -> int:
        self._follow_path()
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
        with transaction(database):
            database.executemany("INSERT INTO history VALUES (?, ?, ?, ?, ?)", rows)
        if self._ages is not None:
            now = self._now()
            self._ages.written(now, samples[-1].time, _last_row(database))
            if self._ages.is_due(now):
                self._remove_old(database, now)
        return len(samples)

    def _remove_old(self, database: sqlite3.Connection, now: int) -> None:
        """Remove rows that are too old. A failed removal is repeated after the next write."""
        assert self._ages is not None
        with suppress(sqlite3.Error):
            for where, limits in self._ages.old(now):
                one_by_one = f"DELETE FROM history WHERE rowid IN (SELECT rowid FROM history WHERE {where} LIMIT ?)"
                while database.execute(one_by_one, (*limits, MOST_REMOVED)).rowcount == MOST_REMOVED:
                    pass
            self._ages.removed(now)

    def close(self) -> None:
        database, self._database = self._database, None
        if database is not None:
            if self._ages is not None and self._ages.has_rows:
                self._remove_old(database, self._now())
            if self._opened is not None and self._opened.change():
                close_moved(database, self.path)
            else:
                database.close()
        lock, self._lock = self._lock, None
        if lock is not None:
            os.close(lock)


class RowAges:
    """The ages of the rows of a history, independent of jumps of the wall clock.

    Rows of this run age by the run's clock, which does not jump. Rows of earlier runs have only their times, which are
    compared with the earliest clock of this run, computed from the least observed difference between wall clock and
    run's clock. So a jump forward makes no row older. `last`: the last row of earlier runs.
    """

    def __init__(self, last: int, keep: int) -> None:
        self._last, self._keep = last, keep
        self._began: int | None = None
        self._offset = 0
        """Least difference between the times of values and the run's clock (ns)."""
        self._due = 0
        self._marks: deque[tuple[int, int]] = deque()
        """Times of the run's clock, and the last row at each: it and the earlier rows are at least as old."""

    @property
    def has_rows(self) -> bool:
        """Return whether a row was written in this run."""
        return self._began is not None

    def written(self, now: int, time: int, row: int) -> None:
        """Note that the rows up to `row` are written; the last of them has a value of this time."""
        if self._began is None:
            self._began, self._offset, self._due = now, time - now, now + CLEANING
            self._marks.append((now, self._last))
        self._offset = min(self._offset, time - now)
        before, last = self._marks[-1] if self._marks else (self._began, self._last)
        if row > last and now >= before + max(min(CLEANING, self._keep // 8), self._keep // 1000):
            self._marks.append((now, row))

    def is_due(self, now: int) -> bool:
        """Return whether old rows must be deleted."""
        return now >= self._due

    def old(self, now: int) -> Iterator[tuple[str, tuple[int, ...]]]:
        """Yield the conditions for old rows, with their arguments."""
        yield "rowid <= ? AND time < ?", (self._last, self._offset + now - self._keep)
        rows = [row for at, row in self._marks if at <= now - self._keep]
        if rows:
            yield "rowid <= ?", (rows[-1],)

    def removed(self, now: int) -> None:
        """Note that the old rows were removed."""
        self._due = now + CLEANING
        while self._marks and self._marks[0][0] <= now - self._keep:
            self._marks.popleft()


def _last_row(database: sqlite3.Connection) -> int:
    (row,) = database.execute("SELECT max(rowid) FROM history").fetchone()
    return row or 0


def _storable(value: Any) -> Any:
    """Convert whole numbers beyond the range of SQLite to texts."""
    return str(value) if isinstance(value, int) and not -(1 << 63) <= value < 1 << 63 else value


def _is_history(database: sqlite3.Connection, path: Path) -> bool:
    """Return whether the file holds a history; False for an empty one. Raises HistoryError for anything else."""
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
    """Yield the values of a history, oldest first; of the points whose names match one of `points`, `*` for any text.

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


@dataclass(frozen=True, slots=True, kw_only=True)
class Course:
    """The values of a point over a span of time, in steps of equal length."""

    since: int
    """Begin of the first step, in ns since 1970 (UTC)."""
    step: int
    """Length of a step (ns)."""
    least: list[float | None]
    greatest: list[float | None]
    """Least and greatest number in each step; the number before it if the step has no value, None if it is not good."""


_NUMBER = "CASE WHEN quality = 'good' THEN {} END"
_STEPS = """
SELECT (time - :since) / :step AS at, min({number}), max({number}) FROM history
WHERE point = :point AND time >= :since AND time < :until GROUP BY at"""
_LAST = """
SELECT (time - :since) / :step AS at, {number}, max(time) FROM history
WHERE point = :point AND time >= :since AND time < :until GROUP BY at"""
_BEFORE = """
SELECT {number} FROM history WHERE point = :point AND time < :since ORDER BY time DESC LIMIT 1"""


def read_course(path: Path, point: str, words: Mapping[str, float], since: int, until: int, steps: int) -> Course:
    """Return the numbers of a point between two times, at most two for each of `steps` steps.

    `words`: the numbers of values that are words. Raises HistoryError for a file that holds none, and if the query
    takes too long; sqlite3.Error.
    """
    if not os.path.isfile(path):
        raise HistoryError(f"there is no {path} – has the run been started?")
    step = max(1, -(-(until - since) // steps))
    number = _NUMBER.format("number_of(value)" if words else "value")
    end = time.monotonic() + LONGEST_QUERY
    with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)) as database:
        database.create_function("number_of", 1, lambda value: words.get(value, value), deterministic=True)
        database.set_progress_handler(lambda: time.monotonic() > end, CHECK_EVERY)
        if not _is_history(database, path):
            raise HistoryError(f"{path} holds no history yet")
        found = database.execute("SELECT id FROM points WHERE name = ?", (point,)).fetchone()
        given = {"point": -1 if found is None else found[0], "since": since, "until": until, "step": step}
        try:
            spans = {at: (low, high) for at, low, high in database.execute(_STEPS.format(number=number), given)}
            last = {at: value for at, value, _ in database.execute(_LAST.format(number=number), given)}
            before = database.execute(_BEFORE.format(number=number), given).fetchone()
        except sqlite3.OperationalError as error:
            if time.monotonic() > end:
                raise HistoryError("the history has too many values for this span – choose a shorter span") from None
            raise error
    least, greatest, value = list[float | None](), list[float | None](), None if before is None else before[0]
    for at in range(-(-(until - since) // step)):
        low, high = spans.get(at, (value, value))
        least.append(_as_number(low))
        greatest.append(_as_number(high))
        value = last.get(at, value)
    return Course(since=since, step=step, least=least, greatest=greatest)


def _as_number(value: Any) -> float | None:
    """Return a stored value as a number; None for a text, and for a value that is not good."""
    return float(value) if isinstance(value, (int, float)) else None
