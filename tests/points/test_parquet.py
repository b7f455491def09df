"""Parquet files of values: typed columns, a file per hour, complete after crashes."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from decimal import Decimal
from pathlib import Path
from typing import Any

import pytest
from points.test_sinks import START, point, taken

from framekit.definition.problems import NOWHERE
from framekit.link.packing import Typed
from framekit.run.model import Point, Scaling
from framekit.run.points import PointValue
from framekit.sinks import parquet
from framekit.sinks.base import Sampled, value_type
from framekit.sinks.parquet import ParquetFiles

pq = pytest.importorskip("pyarrow.parquet", reason="pyarrow is not installed")
HOUR = 3_600_000_000_000
LEVEL = replace(point("level", "m"), scaling=Scaling(Decimal("0.1"), Decimal(0)))
STATE = replace(point("state"), names={0: "off", 2: "heating"})
COUNT = point("count")
POINTS = [LEVEL, STATE, COUNT]


def sample(time: int, values: Mapping[str, Any], quality: Any = "good") -> Sampled:
    return Sampled(time, tuple(PointValue(name, value, quality, "", time) for name, value in values.items()))


def sink_of(path: Path, **keys: Any) -> Any:
    return ParquetFiles(parquet=str(path), at=NOWHERE, **keys).make()


def rows_of(path: Path) -> list[list[Any]]:
    return [list(row.values()) for row in pq.read_table(path).to_pylist()]


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_a_file_an_hour_with_a_typed_column_for_each_point(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parquet, "CELLS_AT_ONCE", 8)  # two rows at once
    samples = [
        sample(START, {"level": 1.5, "state": "off", "count": 7}),
        sample(START + 1_000_000, {"state": "heating"}),
        sample(START + 2_000_000, {"level": 1.6}, "failed"),
        sample(START + HOUR, {"count": 8}),
    ]
    taken(sink_of(tmp_path / "oven.parquet"), samples, POINTS)
    assert names(tmp_path) == ["oven.20260301T120000.parquet", "oven.20260301T130000.parquet"]
    first, second = (tmp_path / name for name in names(tmp_path))
    schema = pq.read_schema(first)
    assert [str(column.type) for column in schema] == ["timestamp[ms, tz=UTC]", "double", "string", "int64"]
    assert schema.field("level").metadata == {b"unit": b"m"}
    assert [row[1:] for row in rows_of(first)] == [[1.5, "off", 7], [1.5, "heating", 7], [None, "heating", 7]]
    assert [row[0].isoformat() for row in rows_of(second)] == ["2026-03-01T13:00:00+00:00"]
    assert [row[1:] for row in rows_of(second)] == [[None, None, 8]]


def test_what_a_killed_program_has_left_goes_on(tmp_path: Path) -> None:
    path = tmp_path / "oven.parquet"
    killed = sink_of(path)
    killed.open(POINTS)
    killed.write([sample(START, {"count": 1})])
    killed._let_go()  # as the system does it
    part = tmp_path / "oven.parquet.part"
    part.write_bytes(part.read_bytes() + b'["2026-03-01T12:0')
    taken(sink_of(path), [sample(START + 1_000_000, {"count": 2})], POINTS)
    assert names(tmp_path) == ["oven.20260301T120000.parquet"]
    assert [row[3] for row in rows_of(tmp_path / names(tmp_path)[0])] == [1, 2]


@pytest.mark.parametrize("value", ["9" * 30, "[" * 100_000, '"x"'], ids=["large", "deep", "text"])
def test_rows_that_cannot_be_converted_are_put_aside_and_block_nothing(tmp_path: Path, value: str) -> None:
    rows = tmp_path / "oven.20260301T120000.parquet.rows"
    for stamp in ("first", "second"):
        head = json.dumps({"columns": [["count", "int64", ""]]})
        rows.write_text(f'{head}\n["{stamp}", {{"count": {value}}}]\n', "utf-8")
        taken(sink_of(tmp_path / "oven.parquet"), [], POINTS)
    aside = [tmp_path / f"{rows.stem}.damaged{number}" for number in ("", ".2")]
    assert [path.read_text("utf-8").splitlines()[1].split(",")[0] for path in aside] == ['["first"', '["second"']
    assert not rows.exists()


def test_other_points_begin_another_file_and_old_ones_go(tmp_path: Path) -> None:
    path = tmp_path / "oven.parquet"
    left = sink_of(path)
    left.open(POINTS)
    left.write([sample(START, {"count": 1})])
    left._let_go()
    taken(sink_of(path, rotate="day"), [sample(START + 1, {"count": 2})], [COUNT])
    assert names(tmp_path) == ["oven.20260301T120000.2.parquet", "oven.20260301T120000.parquet"]
    assert [pq.read_schema(tmp_path / name).names for name in names(tmp_path)] == [
        ["time", "count"], ["time", "level", "state", "count"],
    ]  # fmt: skip
    taken(sink_of(path, keep=1), [sample(START + HOUR, {"count": 3})], [COUNT])
    assert names(tmp_path) == ["oven.20260301T130000.parquet"]
    taken(sink_of(path), [], [COUNT])
    assert names(tmp_path) == ["oven.20260301T130000.parquet", "oven.parquet.part"], "no rows, no file"


@pytest.mark.parametrize(
    ("unit", "bits", "scaling", "wanted", "value"),
    [
        ("bit", 1, None, "bool", True),
        ("dword", 32, None, "int64", 4_000_000_000),
        ("lword", 64, None, "uint64", 18_000_000_000_000_000_000),
        ("dword", 32, Scaling(Decimal(1000), Decimal(5)), "int64", 4_000_000_000_005),
        ("lword", 64, Scaling(Decimal(10), Decimal(0)), "decimal128(38, 0)", 180_000_000_000_000_000_000),
        ("lword", 64, Scaling(Decimal(10) ** 30, Decimal(0)), "string", 10**40),
    ],
)
def test_no_number_is_changed(
    tmp_path: Path, unit: str, bits: int, scaling: Scaling | None, wanted: str, value: Any
) -> None:
    one: Point = replace(point("p"), form=Typed(unit, None, None, 1, 1, unit), scaling=scaling)
    assert (one.form.bits, value_type(one)) == (bits, wanted)
    taken(sink_of(tmp_path / "x.parquet"), [sample(START, {"p": value})], [one])
    found = rows_of(tmp_path / names(tmp_path)[0])[0][1]
    assert int(found) == value
