"""Files of values: `csv` for spreadsheets, `jsonl` for programs, with rotation by size, day or hour."""

from __future__ import annotations

import csv
import errno
import io
import json
import os
import re
from abc import abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Literal

from framekit.definition.keys import NUMBER, Form, KeyReading, key, words
from framekit.definition.tree import Node
from framekit.run.model import Point
from framekit.run.points import PointValue, iso_time, nanoseconds_of, value_text
from framekit.sinks.base import FILE, Host, Sampled, Sink, SinkKind, as_record, good_value, open_alone
from framekit.sinks.opened_file import OpenedFile

_SIZES = {"KB": 1_000, "MB": 1_000_000, "GB": 1_000_000_000}
_ROTATE = re.compile(r"\s*([0-9]+)\s*(KB|MB|GB)\s*")
_COMMON = {"day": len("2026-03-01"), "hour": len("2026-03-01T12")}
"""The length of the common prefix of all times of a day, or an hour."""

ROOM = 4096
"""Free space that must be available when a file is opened, in bytes."""

SET_BACK = 3_600_000_000_000
"""A time further than this before the first time of a file (ns) begins a new file."""

_TIME = rb"[0-9]{4}-[0-9]{2}-[0-9]{2}T[0-9]{2}:[0-9]{2}:[0-9]{2}\.[0-9]{3}Z"
"""A time written by `iso_time`."""

_EXAMPLE = b"2000-01-01T00:00:00.000Z"

Rotation = int | Literal["day", "hour"]
"""When a new file begins: after a number of bytes, or each day or hour (UTC)."""


def read_rotation(reading: KeyReading, node: Node) -> Rotation:
    """Return `day`, `hour`, or a size in bytes. Raise Broken."""
    text = reading.reader.text(node)
    match = _ROTATE.fullmatch(text)
    if match is None and text.strip() == "day":
        return "day"
    if match is None and text.strip() == "hour":
        return "hour"
    if match is None:
        raise reading.reader.broken(
            node.at, f"'{text}' is no size of a file", "write day, hour, or a size such as 10 MB"
        )
    if not int(match[1]):
        raise reading.reader.broken(node.at, "a file of no size holds nothing", "give a size such as 10 MB")
    return int(match[1]) * _SIZES[match[2]]


ROTATION = Form(
    {
        "type": "string",
        "pattern": "^\\s*(day|hour|[0-9]+\\s*(KB|MB|GB))\\s*$",
        "x-expected": "day, hour, or a size (10 MB)",
    },
    read_rotation,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class FileSink(SinkKind):
    """A file that grows line by line, with optional rotation."""

    is_local: ClassVar[bool] = True
    rotate: Rotation | None = key(
        "rotate", ROTATION, "day, hour, or a size: then the file gets the time of its first line as a name, and a new "
        "one begins. Days and hours are those of UTC.", default=None,
    )  # fmt: skip
    keep: int | None = key("keep", NUMBER, "So many of the files before it are kept; default: all.", default=None)

    def mistakes(self) -> Iterator[tuple[str, str, str]]:
        if self.keep is not None and self.rotate is None:
            yield "keep", "'keep' has no effect: there is one file, and nothing before it", "add rotate: day"
        elif self.keep is not None and self.keep < 1:
            yield "keep", "nothing would be kept", "give 1 or more, or leave keep out"


@dataclass(frozen=True, slots=True, kw_only=True)
class CsvFile(FileSink):
    """Comma-separated values. `form`: a line for each value, or a column for each point."""

    word: ClassVar[str] = "csv"
    csv: str = key("csv", FILE, "A table of comma-separated values.")
    form: str | None = key(
        "form", Form(words("a form", "rows", "columns"), lambda r, node: r.reader.text(node)),
        "rows: a line for each value; columns: a column for each point. Default: columns where every is given.",
        default=None,
    )  # fmt: skip

    def make(self) -> Sink:
        columns = self.every is not None if self.form is None else self.form == "columns"
        return (CsvColumns if columns else CsvRows)(Path(self.csv), self.rotate, self.keep)


@dataclass(frozen=True, slots=True, kw_only=True)
class JsonLines(FileSink):
    """One JSON object a line."""

    word: ClassVar[str] = "jsonl"
    jsonl: str = key("jsonl", FILE, "A file with a JSON object for each value.")

    def make(self) -> Sink:
        return JsonFile(Path(self.jsonl), self.rotate, self.keep)


class ForeignFileError(ValueError):
    """Raised for a file whose content no sink of this kind has written; the text contains the remedy."""


class LinesFile(Sink):
    """A file of complete lines: opening removes a partial line left by a crash.

    A file with another first line, such as after a change of points, is put aside, and the user is informed of both
    names. A file of other content is never touched: `open` raises ForeignFileError.

    If another program moves, deletes, replaces or cuts the file, the next row goes to the file at the path, after its
    head row. Raises OSError.
    """

    noun: ClassVar[str]
    """The noun for such a file in messages."""

    def __init__(self, path: Path, rotate: Rotation | None, keep: int | None) -> None:
        self.path, self._rotate, self._keep = path, rotate, keep
        self._host: Host | None = None
        self._points: Sequence[Point] = ()
        self._file: int | None = None
        self._opened: OpenedFile | None = None
        self._size = 0
        self._began = ""
        self._aside: list[Path] = []
        """Files finished by this run, in order; they are newer than all others, regardless of their names."""

    @abstractmethod
    def head(self) -> bytes:
        """Return the first line of every file."""

    @abstractmethod
    def is_own(self, data: bytes) -> bool:
        """Return whether a file that begins with `data` was written by a sink of this kind, with any points."""

    @abstractmethod
    def lines(self, time: str, values: Sequence[PointValue]) -> Iterator[bytes]:
        """Yield the lines of a sample."""

    def meet(self, host: Host) -> None:
        self._host = host

    def open(self, points: Sequence[Point]) -> None:
        self._points = points
        self._begin()
        self._try_room()

    def _begin(self) -> None:
        """Continue the existing file or begin it; a file with another first line is put aside.

        Raise ForeignFileError for a file of other content.
        """
        self._file = file = open_alone(self.path)
        head = self.head()
        data = _read_at(file, 0, max(len(head), 1 << 16))
        is_blank = not data.strip(b"\0")  # of zero bytes only: what a loss of power leaves of a file
        if not (is_blank or (head and data.startswith(head)) or self.is_own(data)):
            self._let_go()
            raise ForeignFileError(f"{self.path} is no {self.noun} of framekit – move it away, or name another file")
        first = data.splitlines(keepends=True)[len(head.splitlines()) : len(head.splitlines()) + 1]
        self._began = self.time_in(first[0]) if first else ""
        if data and not data.startswith(head):
            if not head.startswith(data):  # else a crash has cut the head
                file = self._begin_anew()
            data = b""
        self._size = _whole_lines(file) if data else 0
        os.ftruncate(file, self._size)
        if not data:
            self._began = ""
            self._put(head)
        self._opened = OpenedFile(self.path)

    def _begin_anew(self) -> int:
        """Put the file aside because it has other columns, report that, and return the descriptor of a new file."""
        aside = self._finish()
        self._file = file = open_alone(self.path)
        if os.fstat(file).st_size:  # a path such as /dev/stdout, which leads to the same file again
            self._let_go()
            raise FileExistsError(errno.EEXIST, f"{self.path} leads to {aside} – name another file")
        if self._host is not None:
            self._host.report(f"the file has other columns, it is {aside} now – a new file begins")
        return file

    def _follow_path(self) -> None:
        """Open the file at the path if it is another file than the open one, or was cut."""
        change = "" if self._file is None or self._opened is None else self._opened.change(self._size)
        if change:
            self.leave(change)
            self._begin()
            if self._host is not None:
                self._host.report(change)

    def leave(self, change: str) -> None:
        """Close the file that is no longer at the path, or was cut."""
        self._let_go()

    def _try_room(self) -> None:
        """Write a block after the last line and remove it, to ensure space for values. Raise OSError."""
        if self._file is not None:
            self._put(b" " * ROOM)
            self._size -= ROOM
            os.ftruncate(self._file, self._size)

    def time_in(self, line: bytes) -> str:
        """Return the time at the start of a line; '' if it has none."""
        match = re.search(rb"[0-9]{4}-[0-9]{2}-[0-9]{2}T[0-9:.]+Z", line)
        return "" if match is None else match[0].decode()

    def write(self, samples: Sequence[Sampled]) -> int:
        self._follow_path()
        waiting = bytearray()
        for count, sample in enumerate(samples):
            time = iso_time(sample.time)
            data = b"".join(self.lines(time, sample.values))
            if self._is_over(time, len(waiting) + len(data)):
                if waiting:
                    self._put(waiting)
                    return count
                self._finish()
                self._begin()
            self._began = self._began or time
            waiting += data
        self._put(waiting)
        return len(samples)

    def _is_over(self, time: str, more: int) -> bool:
        """Return whether the file belongs to another day or hour, or is too full for `more` bytes.

        A file without values is never over. A time shortly before the first time of the file is out of order, such as
        a value that was read late. A time long before it means that the clock was set back.
        """
        if self._rotate is None or not self._began:
            return False
        if isinstance(self._rotate, int):
            return self._size + more > self._rotate
        common = _COMMON[self._rotate]
        if time[:common] == self._began[:common]:
            return False
        return time > self._began or nanoseconds_of(self._began) - nanoseconds_of(time) > SET_BACK

    def _put(self, data: bytes | bytearray) -> None:
        """Append data completely, or not at all: a partial write on a full disk is undone."""
        if self._file is None or not data:
            return
        try:
            written = os.write(self._file, data)
            if written < len(data):
                raise OSError("the disk is full")
        except OSError:
            os.ftruncate(self._file, self._size)
            raise
        self._size += len(data)

    def _finish(self) -> Path:
        """Close the file, put it aside under the time of its first line, and return its new name."""
        self._let_go()
        return self.put_aside(stamp_of(self._began))

    def put_aside(self, stamp: str) -> Path:
        """Rename a finished file, delete old files beyond `keep`, and return the new name.

        A symbolic link at the path stays; the file to which it leads is renamed.
        """
        place = self.path if not self.path.is_symlink() else Path(os.path.realpath(self.path))
        target = name_with(place, stamp)
        place.rename(target)
        self._aside.append(target)
        keep_newest(place, self._keep, self._aside)
        return target

    def close(self) -> None:
        self._let_go()

    def _let_go(self) -> None:
        file, self._file = self._file, None
        if file is not None:
            os.close(file)


def stamp_of(time: str) -> str:
    """Return the time of a first line as a part of a file name; `before` for a file without values."""
    return re.sub(r"[-:]", "", time).partition(".")[0] or "before"


def name_with(path: Path, stamp: str) -> Path:
    """Return an unused file name that contains the stamp."""
    return unused(lambda number: path.with_name(f"{path.stem}.{stamp}{number}{path.suffix}"))


def unused(path_of: Callable[[str], Path]) -> Path:
    """Return the first of the paths `path_of('')`, `path_of('.2')`, `path_of('.3')` … that does not exist."""
    found, number = path_of(""), 1
    while os.path.lexists(found):
        number += 1
        found = path_of(f".{number}")
    return found


def keep_newest(path: Path, most: int | None, finished: list[Path]) -> None:
    """Keep the newest `most` of the files named by `name_with`, or all (None).

    `finished`: the files of this run, in order.
    """
    if most is None:
        return
    pattern = re.compile(rf"{re.escape(path.stem)}\.(\d{{8}}T\d{{6}})(?:\.(\d+))?{re.escape(path.suffix)}")
    before = [
        (match[1], int(match[2] or 1), one)
        for one in path.parent.iterdir()
        if one not in finished and (match := pattern.fullmatch(one.name))
    ]
    known = [*(one for _, _, one in sorted(before)), *finished]
    for old in known[: max(0, len(known) - most)]:
        old.unlink(missing_ok=True)
    del finished[: max(0, len(finished) - most)]


def begins_like(data: bytes, pattern: bytes, example: bytes) -> bool:
    """Return whether data begin with a pattern.

    Data that are shorter, such as after a crash, are completed from an example, which matches the pattern.
    """
    return re.match(pattern, data + example[len(data) :]) is not None


def _read_at(file: int, start: int, size: int) -> bytes:
    """Return at most `size` bytes of a file."""
    os.lseek(file, start, os.SEEK_SET)
    return os.read(file, size)


def _whole_lines(file: int) -> int:
    """Return the offset after the last complete line of a file."""
    end = os.fstat(file).st_size
    while end:
        begin = max(0, end - 4096)
        found = _read_at(file, begin, end - begin).rfind(b"\n")
        if found >= 0:
            return begin + found + 1
        end = begin
    return 0


def _csv_line(*cells: object) -> bytes:
    """Return a row as one line; line ends within a text are written as \\n and \\r."""
    text = io.StringIO()
    plain = [cell.replace("\r", "\\r").replace("\n", "\\n") if isinstance(cell, str) else cell for cell in cells]
    csv.writer(text, lineterminator="\n").writerow(["" if cell is None else cell for cell in plain])
    return text.getvalue().encode()


def _cell(point: Point, value: PointValue) -> str | None:
    """Return the cell of a value; None if it is not good."""
    good = good_value(value)
    return None if good is None else value_text(point, good)


class CsvTable(LinesFile):
    """A table: a head row, whose first title is `time`, then rows that begin with a time."""

    noun: ClassVar[str] = "csv file"

    def is_own(self, data: bytes) -> bool:
        head, end, rows = data.partition(b"\n")
        if not end:
            return begins_like(head, b"time,", b"time,")
        return head.startswith(b"time,") and begins_like(rows, _TIME + b",", _EXAMPLE + b",")


class CsvRows(CsvTable):
    """`time,point,value,unit,quality,reason`, a line for each value; the cell of a bad value is empty."""

    def head(self) -> bytes:
        return _csv_line("time", "point", "value", "unit", "quality", "reason")

    def open(self, points: Sequence[Point]) -> None:
        self._by_name = {point.name: point for point in points}
        super().open(points)

    def lines(self, time: str, values: Sequence[PointValue]) -> Iterator[bytes]:
        for one in values:
            point = self._by_name[one.name]
            yield _csv_line(time, one.name, _cell(point, one), point.unit, one.quality, one.reason)


class CsvColumns(CsvTable):
    """A column for each point, its unit in the head; a cell is empty where the value is not good."""

    def __init__(self, path: Path, rotate: Rotation | None, keep: int | None) -> None:
        super().__init__(path, rotate, keep)
        self._last: dict[str, PointValue] = {}

    def head(self) -> bytes:
        titles = (f"{point.name} ({point.unit})" if point.unit else point.name for point in self._points)
        return _csv_line("time", *titles)

    def lines(self, time: str, values: Sequence[PointValue]) -> Iterator[bytes]:
        self._last.update((one.name, one) for one in values)
        seen = ((point, self._last.get(point.name)) for point in self._points)
        yield _csv_line(time, *(None if value is None else _cell(point, value) for point, value in seen))


class JsonFile(LinesFile):
    """`{"time", "point", "value", "unit", "quality"}`, and the `reason` of a bad value."""

    noun: ClassVar[str] = "jsonl file"

    def head(self) -> bytes:
        return b""

    def is_own(self, data: bytes) -> bool:
        return begins_like(
            data, rb'\{"time": "' + _TIME + b'", "point": "', b'{"time": "' + _EXAMPLE + b'", "point": "'
        )

    def open(self, points: Sequence[Point]) -> None:
        self._units = {point.name: point.unit for point in points}
        super().open(points)

    def lines(self, time: str, values: Sequence[PointValue]) -> Iterator[bytes]:
        for one in values:
            yield json.dumps(as_record(time, one, self._units[one.name]), ensure_ascii=False).encode() + b"\n"
