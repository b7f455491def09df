"""Values that a sink has kept, read again: a table of `csv` in both forms, `jsonl`, or the database of `sqlite`.

What `framekit history --csv` prints is such a table too. Values that were not good are left out.
"""

from __future__ import annotations

import csv
import json
import sqlite3
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple

from framekit.definition.problems import did_you_mean
from framekit.sinks.sqlite import HistoryError, read_history

MOST_BYTES = 64_000_000
MOST_VALUES = 1_000_000
"""No larger file is read, and no more values of a point."""
MOST_NAMES = 1000
"""So many names of points are kept for what is told."""


class RecordedError(ValueError):
    """A file that holds no such values; the text says what to do."""


class _Value(NamedTuple):
    time: int
    value: Any


class _Wanted:
    """Which point of a file is read: the one that is named, else the first. It keeps some names, to tell them."""

    def __init__(self, point: str | None) -> None:
        self.point = point
        self.names: dict[str, None] = {}

    def __call__(self, name: str, value: Any) -> bool:
        """Whether a value there is one of this point, and good."""
        if name == self.point or len(self.names) < MOST_NAMES:
            self.names[name] = None
        return name == (next(iter(self.names)) if self.point is None else self.point) and value not in ("", None)


def recorded(path: Path, point: str | None) -> tuple[tuple[int, ...], tuple[float, ...]]:
    """The numbers of a point, oldest first: when each came, in ns from the first one on, and what it was.

    `point` may be left out where the file has one point. Raises RecordedError.
    """
    wanted, found = _Wanted(point), list[_Value]()
    try:
        if path.stat().st_size > MOST_BYTES:
            raise RecordedError(f"{path.name} is larger than {MOST_BYTES // 1_000_000} MB – cut it into pieces")
        for one in _values(path, wanted):
            if len(found) == MOST_VALUES:
                raise RecordedError(f"{path.name} has more than {MOST_VALUES} values – cut it into pieces")
            found.append(one)
    except (OSError, UnicodeDecodeError, csv.Error, sqlite3.Error, HistoryError) as error:
        what = getattr(error, "strerror", None) or error
        raise RecordedError(f"{path.name} cannot be read: {what} – name a file of values") from None
    names = list(wanted.names)
    if point is None and len(names) > 1:
        raise RecordedError(f"{path.name} has several points: {', '.join(names[:12])} – say which by point:")
    if not found and point is not None and point not in names:
        raise RecordedError(f"{path.name} has no point '{point}' – {did_you_mean(point, names) or 'name another'}")
    if not found:
        raise RecordedError(f"{path.name} has no good values – name another file or point")
    numbers = sorted(((one.time, _number(one, path)) for one in found), key=itemgetter(0))
    first = numbers[0][0]
    return tuple(time - first for time, _ in numbers), tuple(value for _, value in numbers)


def _number(row: _Value, path: Path) -> float:
    if isinstance(row.value, (int, float)):
        return row.value
    text = str(row.value)
    try:
        return int(text) if text.lstrip("-").isdecimal() else float(text)
    except ValueError:
        raise RecordedError(f"{path.name} has '{row.value}', which is no number – replay another point") from None


def _values(path: Path, wanted: _Wanted) -> Iterator[_Value]:
    """The good values of one point in a file, by what the file begins with."""
    with path.open("rb") as file:
        begin = file.read(16)
    if begin.startswith(b"SQLite format 3"):
        yield from (_Value(row.time, row.value) for row in read_history(path) if wanted(row.point, row.value))
    else:
        yield from _objects(path, wanted) if begin.lstrip().startswith(b"{") else _table(path, wanted)


def _objects(path: Path, wanted: _Wanted) -> Iterator[_Value]:
    with path.open(encoding="utf-8", newline="\n") as lines:
        for number, line in enumerate(lines, 1):
            try:
                one = json.loads(line)
                time, value = _time(one["time"]), one["value"]
                is_wanted = wanted(str(one["point"]), value)
            except (ValueError, KeyError, TypeError, RecursionError):
                what = f"{path.name}, line {number}, is no value of a point"
                raise RecordedError(f"{what} – name a file of jsonl") from None
            if is_wanted:
                yield _Value(time, value)


def _table(path: Path, wanted: _Wanted) -> Iterator[_Value]:
    with path.open(encoding="utf-8-sig", newline="") as lines:
        rows = csv.reader(lines)
        head = next(rows, [])
        if len(head) < 2 or head[0] != "time":
            what = f"{path.name} has no column time first"
            raise RecordedError(f"{what} – name a file of a sink, or framekit history --csv")
        columns = [] if head[1:3] == ["point", "value"] else [title.rpartition(" (")[0] or title for title in head[1:]]
        for row in rows:
            try:
                time = _time(row[0])
                cells = zip(columns, row[1:], strict=False) if columns else [(row[1], row[2])]
            except (ValueError, IndexError):
                what = f"{path.name}, line {rows.line_num}, has no time and value"
                raise RecordedError(f"{what} – name a file of a sink, or framekit history --csv") from None
            yield from (_Value(time, cell) for name, cell in cells if wanted(name, cell))


_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


def _time(text: str) -> int:
    """Nanoseconds since 1970 (UTC). Raises ValueError, TypeError."""
    moment = datetime.fromisoformat(text)
    since = (moment if moment.tzinfo else moment.replace(tzinfo=UTC)) - _EPOCH
    return since // timedelta(microseconds=1) * 1000
