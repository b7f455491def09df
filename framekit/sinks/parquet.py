"""Files of columns for analysis: Parquet, a file for each hour or day, with a column for each point.

Rows are lines of JSON in another file, `NAME.parquet.part`, until the hour is over, because a Parquet file can be read
only when it is complete. After a crash the next start continues that file. While it is converted it has the name of the
Parquet file with the end `.rows`.
"""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, ClassVar, Literal

from framekit.definition.keys import NUMBER, Form, key, words
from framekit.definition.problems import error_text, plural
from framekit.run.model import Point
from framekit.run.points import PointValue
from framekit.sinks.base import FILE, Sampled, Sink, SinkKind, good_value, not_installed, value_type
from framekit.sinks.files import LinesFile, begins_like, keep_newest, name_with, stamp_of, unused
from framekit.sinks.opened_file import CUT

ROWS = ".rows"
"""End of the name of a file of rows that becomes a Parquet file; the rest is the name of that file."""

UNCONVERTIBLE = (ValueError, TypeError, LookupError, ArithmeticError, RecursionError)
"""Errors for rows that another program has changed, of the reader of JSON and of pyarrow: too large, too deep."""
CELLS_AT_ONCE = 500_000
"""Largest number of values in memory while a file is made."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ParquetFiles(SinkKind):
    """A table in Parquet files, one for each hour or day, with a typed column for each point."""

    word: ClassVar[str] = "parquet"
    is_local: ClassVar[bool] = True
    parquet: str = key(
        "parquet", FILE, "Parquet files; each gets the time of its first row as a part of its name: x.parquet becomes "
        "x.20260301T120000.parquet.",
    )  # fmt: skip
    rotate: Literal["hour", "day"] = key(
        "rotate", Form(words("a time", "hour", "day"), lambda r, node: r.reader.text(node)),
        "When a file is finished: each hour (the default) or each day, of UTC; and when the run ends.", default="hour",
    )  # fmt: skip
    keep: int | None = key("keep", NUMBER, "So many finished files are kept; default: all.", default=None)

    def mistakes(self) -> Iterator[tuple[str, str, str]]:
        yield from not_installed("pyarrow", "pyarrow")
        if self.keep is not None and self.keep < 1:
            yield "keep", "nothing would be kept", "give 1 or more, or leave keep out"

    def make(self) -> Sink:
        return ParquetSink(Path(self.parquet), self.rotate, self.keep)


class ParquetSink(LinesFile):
    """Rows wait as lines; each has the time and the changed values. A finished file is never written again.

    Rows that another program destroys before they are in a Parquet file are counted as lost.
    """

    noun: ClassVar[str] = "file of rows"

    def __init__(self, path: Path, rotate: Literal["hour", "day"], keep: int | None) -> None:
        super().__init__(path.with_name(f"{path.name}.part"), rotate, None)
        self.finished, self._most = path, keep
        self._rows, self._values = 0, Counter[str]()
        """Rows of this run in the file of rows, and their values by point."""
        self._own_from = 0
        """Offset of the first of these rows; those before are of an earlier run."""

    def head(self) -> bytes:
        columns = [(point.name, value_type(point), point.unit) for point in self._points]
        return json.dumps({"columns": columns}, ensure_ascii=False).encode() + b"\n"

    def lines(self, time: str, values: Sequence[PointValue]) -> Iterator[bytes]:
        yield json.dumps([time, {one.name: good_value(one) for one in values}], ensure_ascii=False).encode() + b"\n"

    def is_own(self, data: bytes) -> bool:
        return begins_like(data, rb'\{"columns": \[', b'{"columns": [')

    def _begin(self) -> None:
        super()._begin()
        if not self._rows:
            self._own_from = self._size

    def write(self, samples: Sequence[Sampled]) -> int:
        accepted = super().write(samples)
        self._rows += accepted
        for sample in samples[:accepted]:
            self._values.update(value.name for value in sample.values)
        return accepted

    def open(self, points: Sequence[Point]) -> None:
        if self.path.parent.is_dir():
            name = self.finished
            for rows in sorted(self.path.parent.iterdir()):
                if rows.name.startswith(f"{name.stem}.") and rows.name.endswith(f"{name.suffix}{ROWS}"):
                    self._complete(rows)
        super().open(points)

    def put_aside(self, stamp: str) -> Path:
        """Convert the rows to a Parquet file and return its name.

        They are renamed first: after a failure their name shows to which Parquet file they belong, so that no row is in
        two files.
        """
        target = name_with(self.finished, stamp)
        rows = target.with_name(f"{target.name}{ROWS}")
        self.path.rename(rows)
        try:
            return self._complete(rows)
        finally:
            self._forget_rows()

    def _complete(self, rows: Path) -> Path:
        """Convert a file of rows, which has the name of its Parquet file, unless that is complete, and delete it.

        Rows that cannot be converted, because another program has changed them, are renamed and counted as lost.
        """
        target = rows.with_suffix("")
        if not target.exists():
            try:
                self._convert(rows, target)
            except UNCONVERTIBLE as error:
                aside = unused(lambda number: rows.with_suffix(f".damaged{number}"))
                rows.rename(aside)
                self._lose(f"the rows in {aside} cannot be converted: {error_text(error)}")
                return aside
        rows.unlink()
        return target

    def _convert(self, lines: Path | int, target: Path) -> None:
        """Write the rows of a file or of a file descriptor to a Parquet file, which appears complete."""
        half = target.with_name(f"{target.name}.half")
        try:
            write_parquet(lines, half)
            half.rename(target)
        finally:
            half.unlink(missing_ok=True)
        self._aside.append(target)
        keep_newest(self.finished, self._most, self._aside)

    def leave(self, change: str) -> None:
        """Count the rows that another program has cut off, and convert those of a moved or deleted file, which is still
        open.
        """
        try:
            if self._file is not None:
                self._count_cut_rows(self._file)
                if change != CUT and self._began:
                    os.lseek(self._file, 0, os.SEEK_SET)
                    self._convert(self._file, name_with(self.finished, stamp_of(self._began)))
                    self._forget_rows()
        except (OSError, *UNCONVERTIBLE) as error:
            self._lose(f"its rows cannot be converted: {error_text(error)}")
        finally:
            super().leave(change)

    def _count_cut_rows(self, file: int) -> None:
        """Count the rows of this run that are no longer in the open file as lost."""
        size = os.fstat(file).st_size
        if size >= self._size:
            return
        kept, values = 0, Counter[str]()
        if size > self._own_from:
            os.lseek(file, self._own_from, os.SEEK_SET)
            with open(file, "rb", closefd=False) as source:
                for line in source:
                    if line.endswith(b"\n"):
                        kept += 1
                        values.update(iter(json.loads(line)[1]))
        lost, points = self._rows - kept, self._values - values
        self._rows, self._values = kept, values
        if lost and self._host is not None:
            self._host.loses(lost, points, f"another program has cut {plural(lost, 'row')} off {self.path}")

    def _lose(self, why: str) -> None:
        """Count all rows of this run in the file of rows as lost."""
        if self._host is not None:
            self._host.loses(self._rows, self._values, why)
        self._forget_rows()

    def _forget_rows(self) -> None:
        """Note that the file of rows has no rows of this run any more."""
        self._rows = 0
        self._values = Counter()

    def close(self) -> None:
        """Convert the rows of the last hour, so that its file is readable."""
        try:
            self._follow_path()
            if self._file is not None and self._began:
                self._finish()
        except OSError as error:
            raise OSError(error.errno, f"the last rows wait for the next run: {error_text(error)}") from error
        finally:
            super().close()


def write_parquet(lines: Path | int, target: Path) -> None:
    """Convert the lines of a file, or of a file descriptor, to a Parquet file, without a line that a crash has cut.

    Raises OSError; ValueError, TypeError and LookupError for lines that are no rows.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    with open(lines, encoding="utf-8", closefd=isinstance(lines, Path)) as source:
        columns = json.loads(next(source, ""))["columns"]
        types = {
            name: pa.type_for_alias(kind) if "(" not in kind else pa.decimal128(38, 0) for name, kind, _ in columns
        }
        fields = [pa.field("time", pa.timestamp("ms", tz="UTC"), nullable=False)]
        fields += [pa.field(name, types[name], metadata={"unit": unit} if unit else None) for name, _, unit in columns]
        schema = pa.schema(fields)
        at_once = max(1, CELLS_AT_ONCE // len(fields))
        with pq.ParquetWriter(target, schema) as writer:
            row: dict[str, Any] = dict.fromkeys(types)
            while some := [json.loads(line) for line in islice(source, at_once) if line.endswith("\n")]:
                cells: dict[str, list[Any]] = {name: [] for name in types}
                for _, changed in some:
                    row.update((name, _as(kind, changed[name])) for name, kind, _ in columns if name in changed)
                    for name, values in cells.items():
                        values.append(row[name])
                times = pa.array([time for time, _ in some], pa.string()).cast(pa.timestamp("ms", tz="UTC"))
                writer.write_table(pa.table([times, *(pa.array(cells[n], types[n]) for n in cells)], schema=schema))


def _as(kind: str, value: Any) -> Any:
    """Return a value in the type of its column."""
    if value is None or kind not in ("string", "bool", "double"):
        return value
    return {"string": str, "bool": bool, "double": float}[kind](value)
