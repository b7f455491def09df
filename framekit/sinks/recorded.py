"""Values that a sink has kept, read again: a table of `csv` in both forms, `jsonl`, or the database of `sqlite`.

What `framekit history --csv` prints is such a table too. Values that were not good are left out.
"""

from __future__ import annotations

import csv
import io
import json
import sqlite3
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, NamedTuple

from framekit.definition.problems import did_you_mean
from framekit.sinks.sqlite import HistoryError, read_history

MOST_BYTES = 64_000_000
MOST_VALUES = 1_000_000
"""A file is read into memory whole: no larger one is, and no more values of one."""


class RecordedError(ValueError):
    """A file that holds no such values; the text says what to do."""


class _Value(NamedTuple):
    time: int
    point: str
    value: Any


def recorded(path: Path, point: str | None) -> tuple[tuple[int, ...], tuple[float, ...]]:
    """The numbers of a point, oldest first: when each came, in ns from the first one on, and what it was.

    `point` may be left out where the file has one point. Raises RecordedError.
    """
    try:
        if path.stat().st_size > MOST_BYTES:
            raise RecordedError(f"{path.name} is larger than {MOST_BYTES // 1_000_000} MB – cut it into pieces")
        rows = list(_rows(path, point))
    except (OSError, UnicodeDecodeError, csv.Error, sqlite3.Error, HistoryError) as error:
        what = getattr(error, "strerror", None) or error
        raise RecordedError(f"{path.name} cannot be read: {what} – name a file of values") from None
    names = list(dict.fromkeys(row.point for row in rows))
    if point is None and len(names) > 1:
        raise RecordedError(f"{path.name} has several points: {', '.join(names[:12])} – say which by point:")
    if point is not None and point not in names:
        raise RecordedError(f"{path.name} has no point '{point}' – {did_you_mean(point, names) or 'name another'}")
    found = sorted((row.time, _number(row, path)) for row in rows if point in (None, row.point) and row.value != "")
    if not found:
        raise RecordedError(f"{path.name} has no good values – name another file or point")
    if len(found) > MOST_VALUES:
        raise RecordedError(f"{path.name} has more than {MOST_VALUES} values – cut it into pieces")
    first = found[0][0]
    return tuple(time - first for time, _ in found), tuple(value for _, value in found)


def _number(row: _Value, path: Path) -> float:
    if isinstance(row.value, (int, float)):
        return row.value
    text = str(row.value)
    try:
        return int(text) if text.lstrip("-").isdecimal() else float(text)
    except ValueError:
        raise RecordedError(f"{path.name} has '{row.value}', which is no number – replay another point") from None


def _rows(path: Path, point: str | None) -> Iterator[_Value]:
    """What stands in a file, by what it begins with. A value that was not good is ''."""
    with path.open("rb") as file:
        begin = file.read(16)
    if begin.startswith(b"SQLite format 3"):
        for row in read_history(path):
            if point in (None, row.point):
                yield _Value(row.time, row.point, "" if row.value is None else row.value)
        return
    text = path.read_text("utf-8-sig")
    yield from _objects(text, path) if begin.lstrip().startswith(b"{") else _table(text, path)


def _objects(text: str, path: Path) -> Iterator[_Value]:
    for number, line in enumerate(text.splitlines(), 1):
        try:
            one = json.loads(line)
            name, value = str(one["point"]), one["value"]
            yield _Value(_time(one["time"]), name, "" if value is None else value)
        except (ValueError, KeyError, TypeError, RecursionError):
            raise RecordedError(f"{path.name}, line {number}, is no value of a point – name a file of jsonl") from None


def _table(text: str, path: Path) -> Iterator[_Value]:
    rows = csv.reader(io.StringIO(text))
    head = next(rows, [])
    if len(head) < 2 or head[0] != "time":
        raise RecordedError(f"{path.name} has no column time first – name a file of a sink, or framekit history --csv")
    columns = [] if head[1:3] == ["point", "value"] else [title.rpartition(" (")[0] or title for title in head[1:]]
    for row in rows:
        try:
            time = _time(row[0])
            cells = list(zip(columns, row[1:], strict=False)) if columns else [(row[1], row[2])]
        except (ValueError, IndexError):
            what = f"{path.name}, line {rows.line_num}, has no time and value"
            raise RecordedError(f"{what} – name a file of a sink, or framekit history --csv") from None
        yield from (_Value(time, name, cell) for name, cell in cells)


_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


def _time(text: str) -> int:
    """Nanoseconds since 1970 (UTC). Raises ValueError, TypeError."""
    moment = datetime.fromisoformat(text)
    since = (moment if moment.tzinfo else moment.replace(tzinfo=UTC)) - _EPOCH
    return since // timedelta(microseconds=1) * 1000
