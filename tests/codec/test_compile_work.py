"""The work of loading, compiling and checking a definition grows in proportion to its size, not to the square."""

from __future__ import annotations

import cProfile
import pstats
from collections.abc import Callable
from pathlib import Path

import pytest
from spread import spread

from framekit.api.check import check_file
from framekit.codec.codec import compile_protocol
from framekit.codec.python.generate import generate_source
from framekit.definition.load.protocol import load_protocol_text


def body(*segments: str) -> str:
    return "frames:\n  f:\n    body:\n" + "".join(f"      - {{{segment}}}\n" for segment in segments)


def constant(number: int) -> str:
    return f"{number >> 8 & 255:02X} {number & 255:02X}"


def cases(count: int) -> str:
    return ", ".join(f"{case}: [{{field: x{case}, type: u8}}]" for case in range(count))


def records(count: int) -> str:
    """Return cases with a record each."""
    return ", ".join(f"{case}: [{{include: record, as: r{case}}}]" for case in range(count))


SHAPES: dict[str, Callable[[int], str]] = {
    "frames": lambda count: (
        "frames:\n"
        + "".join(
            f"  f{number}: {{body: [{{const: {constant(number)}}}, {{field: a, type: u8}}]}}\n"
            for number in range(count)
        )
    ),
    "fields": lambda count: body(*(f"field: a{number}, type: u8" for number in range(count))),
    "fields with lengths": lambda count: body(
        *(
            f"length: n{number}, type: u8, of: d{number}}}\n      - {{data: d{number}, size: n{number}"
            for number in range(count)
        )
    ),
    "conditions": lambda count: body("field: a, type: u32", *(f"require: 'a != {number}'" for number in range(count))),
    "optional fields": lambda count: body(
        "field: a, type: u32", *(f"field: b{number}, type: u8, when: a == {number}" for number in range(count))
    ),
    "cases": lambda count: body("field: a, type: u16", f"choose: a, cases: {{{cases(count)}}}"),
    "cases whose fields are read": lambda count: body(
        "field: a, type: u16",
        f"choose: a, cases: {{{cases(count)}}}",
        *(f"require: 'either(x{number}, 0) < 200'" for number in range(count)),
    ),
    "cases whose records are read": lambda count: body(
        "field: a, type: u16",
        f"choose: a, cases: {{{records(count)}}}",
        *(f"require: 'either(r{number}.x, 0) < 200'" for number in range(count)),
    ),
}


GROWTH = 2.7
"""Largest growth of the work for twice the size; quadratic work would grow by 4."""


def definition(shape: str, count: int) -> str:
    return f"protocol: many\nlayouts: {{record: [{{field: x, type: u8}}]}}\n{SHAPES[shape](count)}"


def calls(path: Path, shape: str, count: int) -> int:
    """Return the number of calls that a check takes."""
    path.write_text(definition(shape, count))
    profile = cProfile.Profile()
    with profile:
        checked = check_file(str(path))
    assert checked.what.startswith("protocol many") and not checked.problems
    return sum(row[1] for row in pstats.Stats(profile).stats.values())  # type: ignore[attr-defined]


@pytest.mark.parametrize("shape", spread([*SHAPES], 4))
def test_the_work_of_a_check_grows_with_the_definition(tmp_path: Path, shape: str) -> None:
    path = tmp_path / "many.protocol.yaml"
    calls(path, shape, 1)  # imports and caches
    few, some, many = (calls(path, shape, count) for count in (50, 100, 200))
    assert many - some < GROWTH * (some - few)


@pytest.mark.parametrize("shape", spread(SHAPES, 3))
def test_the_source_grows_with_the_definition(shape: str) -> None:
    few, some, many = (
        len(generate_source(load_protocol_text(definition(shape, count)), standalone=False)) for count in (50, 100, 200)
    )
    assert many - some < GROWTH * (some - few)


def test_many_cases_are_told_apart() -> None:
    """The number of cases exceeds the limit up to which each case lists the names of the others."""
    codec = compile_protocol(load_protocol_text(definition("cases whose records are read", 40)))
    values = {"a": 39, "r39": {"x": 7}}
    assert codec.decode("f", codec.encode("f", values, {}), {}) == values
    with pytest.raises(ValueError, match="there is no 'r3' in this frame"):
        codec.encode("f", {**values, "r3": {"x": 1}}, {})
    with pytest.raises(ValueError, match="require"):
        codec.decode("f", bytes.fromhex("00 27 C8"), {})
    _, _, fault = codec.trace("f", bytes.fromhex("00 27 C8"))
    assert fault is not None and fault.cause == "require" and fault.fields == {"a": 39, "r39": {"x": 200}}
