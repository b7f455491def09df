"""Files of columns for analysis: Parquet, a file for each hour or day, with a column for each point.

Rows are lines of JSON in another file, `NAME.parquet.part`, until the hour is over: a Parquet file can be read
only when it is complete. After a crash the next start continues that file.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, ClassVar, Literal

from framekit.definition.keys import NUMBER, Form, key, words
from framekit.definition.problems import error_text, plural
from framekit.run.points import PointValue
from framekit.sinks.base import FILE, Sink, SinkKind, good_value, not_installed, value_type
from framekit.sinks.files import LinesFile, begins_like, keep_newest, name_with, stamp_of

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
    """Rows wait as lines; each has the time and the changed values. A finished file is never written again."""

    noun: ClassVar[str] = "file of rows"

    def __init__(self, path: Path, rotate: Literal["hour", "day"], keep: int | None) -> None:
        super().__init__(path.with_name(f"{path.name}.part"), rotate, None)
        self.finished, self._most = path, keep
        self._rows = 0
        """Number of rows since the last Parquet file, as far as this run has made them."""

    def head(self) -> bytes:
        columns = [(point.name, value_type(point), point.unit) for point in self._points]
        return json.dumps({"columns": columns}, ensure_ascii=False).encode() + b"\n"

    def lines(self, time: str, values: Sequence[PointValue]) -> Iterator[bytes]:
        self._rows += 1
        yield json.dumps([time, {one.name: good_value(one) for one in values}], ensure_ascii=False).encode() + b"\n"

    def is_own(self, data: bytes) -> bool:
        return begins_like(data, rb'\{"columns": \[', b'{"columns": [')

    def put_aside(self, stamp: str) -> Path:
        """Convert the rows to a Parquet file and return its name; they are deleted when it is complete."""
        target = self._convert(self.path, stamp)
        self.path.unlink()
        return target

    def _convert(self, lines: Path | int, stamp: str) -> Path:
        """Write the rows of a file or of a file descriptor to a Parquet file, which appears complete; return its
        name.
        """
        target = name_with(self.finished, stamp)
        half = target.with_name(f"{target.name}.half")
        try:
            write_parquet(lines, half)
            half.rename(target)
        finally:
            half.unlink(missing_ok=True)
        self._rows = 0
        self._aside.append(target)
        keep_newest(self.finished, self._most, self._aside)
        return target

    def leave(self) -> None:
        """Convert the rows of a moved or deleted file, which is still open: they exist nowhere else."""
        try:
            if self._file is not None and self._began:
                os.lseek(self._file, 0, os.SEEK_SET)
                self._convert(self._file, stamp_of(self._began))
        except (OSError, ValueError, StopIteration) as error:
            if self._host is not None:
                self._host.report(f"{plural(self._rows, 'row')} of the moved file were lost: {error_text(error)}")
        finally:
            super().leave()

    def close(self) -> None:
        """Convert the rows of the last hour, so that its file is readable."""
        try:
            self._follow_path()
            if self._file is not None and self._began:
                self._finish()
        finally:
            super().close()


def write_parquet(lines: Path | int, target: Path) -> None:
    """Convert the lines of a file, or of a file descriptor, to a Parquet file, without a line that a crash has cut.

    Raises OSError and ValueError.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    with open(lines, encoding="utf-8", closefd=isinstance(lines, Path)) as source:
        columns = json.loads(next(source))["columns"]
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
