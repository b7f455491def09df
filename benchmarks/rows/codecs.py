"""Decode, encode and build in generated Python, compared with code by hand with the same checks and the same values."""

from __future__ import annotations

from functools import partial

from benchmarks.cases import CASES, NAMED, Case, Named
from benchmarks.measure import compare
from benchmarks.row import Row, Target, slower

NAME = "Generated codecs against code by hand"
TARGET = "≤ 1.3 × the time of struct/bytes code with the same checks and values"
AT_MOST = Target("at most", 1.3)


def run(rounds: int) -> list[Row]:
    return [row for case in CASES for row in _measure(case, rounds)] + [_build(named, rounds) for named in NAMED]


def _build(named: Named, rounds: int) -> Row:
    """Measure building from named values; by hand, too."""
    build = named.checked()
    found = compare(
        {"framekit": partial(build, **named.values), "by hand": partial(named.by_hand, **named.values)}, rounds
    )
    return slower(f"{named.name}: build", "by hand", found["framekit"], found["by hand"], AT_MOST)


def _measure(case: Case, rounds: int) -> list[Row]:
    data, _ = case.checked()
    encode, decode = case.codec.encoders[case.frame], case.codec.decoders[case.frame]
    rows = []
    for direction, functions in (
        ("decode", {"framekit": lambda: decode(data), "by hand": lambda: case.decode(data)}),
        ("encode", {"framekit": lambda: encode(case.values), "by hand": lambda: case.encode(case.values)}),
    ):
        found = compare(functions, rounds)
        rows.append(slower(f"{case.name}: {direction}", "by hand", found["framekit"], found["by hand"], AT_MOST))
    return rows
