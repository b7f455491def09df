"""Choices whose cases have fields of the same name, with different sizes, conditions and defaults."""

from __future__ import annotations

from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import pytest
from test_two_compilers import Pair, built, read, same_fault

from framekit.codec.codec import compile_protocol
from framekit.definition.load.protocol import load_protocol, load_protocol_text
from framekit.extras.wireshark.generate import generate_dissector

ADDRESSES = """
protocol: addresses
params: {kind: {type: choice, of: [short, long, name], default: short}}
layouts:
  short:
    - {bits: {has_a: 0, has_b: 1, more: 2-7}, of: u8, build: {has_a: 1, has_b: b != 0, more: 0}}
    - {require: more == 0}
    - {field: a, type: u8, long: {mark: 0xFF, type: u16}, when: has_a, default: 0}
    - {field: b, type: u8, when: has_b, default: 0}
  long:
    - {bits: {has_c: 0, has_a: 1, has_b: 2}, of: u16, build: {has_c: 0, has_a: a != 7, has_b: b != 1}}
    - {field: c, type: u8, when: has_c, default: 3}
    - {field: a, type: u16, when: has_a, default: 7}
    - {field: b, type: u24, when: has_b, default: 1}
frames:
  f:
    body:
      - choose: kind
        cases: {short: [{include: short}], long: [{include: long}]}
        else: [{field: a, type: u32}, {data: b, size: 2}]
      - {data: rest, size: rest}
"""


@cache
def both() -> Pair:
    return Pair(load_protocol_text(ADDRESSES))


@pytest.mark.parametrize("kind", ["short", "long", "name"])
def test_both_compilers_agree_whatever_is_given(kind: str) -> None:
    right = 0
    for a, b, c in product((None, 0, 7, 300, "ab"), (None, 0, 1, b"zz"), (None, 3)):
        given = {"a": a, "b": b, "c": c, "rest": b"hi"}
        values = {name: value for name, value in given.items() if value is not None}
        reference, compiled = both().build("f", values, {"kind": kind})
        assert compiled == reference, values
        if isinstance(reference, bytes):
            right += 1
            one, other = both().read("f", reference, {"kind": kind})
            assert one == other
            assert all(one[name] == value for name, value in values.items())
    assert right > 2


@pytest.mark.parametrize(
    ("kind", "values", "data"),
    [
        ("short", {}, "01 00"),
        ("short", {"a": 300, "b": 1}, "03 FF 01 2C 01"),
        ("long", {}, "00 00"),
        ("long", {"a": 7, "b": 2}, "00 04 00 00 02"),
        ("long", {"c": 9, "has_c": 1}, "00 01 09"),
        ("name", {"a": 1, "b": b"zz"}, "00 00 00 01 7A 7A"),
    ],
)
def test_the_case_that_is_taken_says_how_a_field_looks(kind: str, values: dict[str, Any], data: str) -> None:
    wanted = bytes.fromhex(data)
    assert both().build("f", values | {"rest": b""}, {"kind": kind}) == (wanted, wanted)


@pytest.mark.parametrize("kind", ["short", "name"])
def test_a_field_of_another_case_is_refused_even_with_its_default(kind: str) -> None:
    values = {"a": 1, "b": b"zz" if kind == "name" else 1, "rest": b""}
    for codec in (both().reference, both().compiled):
        assert isinstance(built(lambda codec=codec: codec.encode("f", values, {"kind": kind})), bytes)
        assert not isinstance(built(lambda codec=codec: codec.encode("f", values | {"c": 3}, {"kind": kind})), bytes)


def test_damaged_bytes_have_the_same_fault() -> None:
    for kind, data in product(("short", "long", "name"), ("", "07", "FF", "07 01", "01 FF 2C", "00 08 01", "00 00 00")):
        same_fault(both(), "f", bytes.fromhex(data), {"kind": kind})
    assert isinstance(read(lambda: both().reference.decode("f", b"\x04", {"kind": "short"})), tuple)


SAME_NAMES = """
protocol: same
layouts: {one: [{field: x, type: u8}], two: [{field: y, type: u16}]}
frames:
  f:
    body:
      - {field: kind, type: u8}
      - choose: kind
        cases:
          1: [{include: one, as: part}]
          2: [{include: two, as: part}]
          3: [{data: part, size: 1}]
          4: [{repeat: parts, times: 2, of: [{field: a, type: u8}]}]
          5: [{repeat: parts, times: 2, of: [{field: b, type: u8}, {field: a, type: u8, when: b > 1}]}]
      - {value: z, read: part.x, when: kind == 1}
"""


@pytest.mark.parametrize(
    ("data", "values"),
    [
        ("01 07", {"kind": 1, "part": {"x": 7}, "z": 7}),
        ("02 01 00", {"kind": 2, "part": {"y": 256}}),
        ("03 09", {"kind": 3, "part": b"\x09"}),
        ("04 01 02", {"kind": 4, "parts": [{"a": 1}, {"a": 2}]}),
        ("05 01 02 03", {"kind": 5, "parts": [{"b": 1}, {"b": 2, "a": 3}]}),
    ],
)
def test_records_and_lists_of_one_name_differ_from_case_to_case(
    data: str, values: dict[str, Any], tmp_path: Path
) -> None:
    path = tmp_path / "same.yaml"
    path.write_text(SAME_NAMES, "utf-8")
    frame = compile_protocol(load_protocol(path)).frames["f"]
    assert frame.decode(bytes.fromhex(data), {}) == values
    if "parts" not in values:
        assert frame.encode(values, {}) == bytes.fromhex(data)
    with pytest.raises(ValueError, match="short"):
        frame.decode(bytes.fromhex(data)[:-1], {})


def test_a_dissector_has_records_and_lists_of_one_name(tmp_path: Path) -> None:
    path = tmp_path / "same.yaml"
    path.write_text(SAME_NAMES, "utf-8")
    made = generate_dissector(load_protocol(path))
    assert made.left_out == () and all(f'"{name}"' in made.source for name in "xyab")
