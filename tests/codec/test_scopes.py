"""Segments of the same name in several records: each name refers to the segment of its own record."""

from __future__ import annotations

from typing import Any

import pytest

from framekit.codec.codec import Codec, compile_protocol
from framekit.codec.errors import FrameError
from framekit.definition.load.protocol import load_protocol_text
from framekit.definition.problems import DefinitionError

TWO_TABLES = """
protocol: p
layouts:
  one: [{field: kind, type: u8, values: {1: a, 2: b}}, %s]
  two: [{field: kind, type: u8, values: {5: a, 6: b}}, %s]
frames:
  f: {body: [{include: one, as: t}, {include: two, as: u}, %s]}
"""
BY_NAME = "{field: x, type: u8, when: kind == 'a'}"
BY_CASE = "{choose: kind, cases: {a: [{field: x, type: u8}], b: []}}"
PLAIN = "{skip: 0}"


def codec_of(text: str) -> Codec:
    return compile_protocol(load_protocol_text(text, "scopes"))


@pytest.mark.parametrize(
    ("inside", "behind", "values", "data"),
    [
        (BY_NAME, PLAIN, {"t": {"kind": 1, "x": 7}, "u": {"kind": 5, "x": 8}}, "01 07 05 08"),
        (BY_NAME, PLAIN, {"t": {"kind": 2}, "u": {"kind": 5, "x": 8}}, "02 05 08"),
        (BY_CASE, PLAIN, {"t": {"kind": 1, "x": 7}, "u": {"kind": 6}}, "01 07 06"),
        (
            PLAIN,
            "{field: x, type: u8, when: t.kind == 'a'}, {field: y, type: u8, when: u.kind == 'b'}",
            {"t": {"kind": 1}, "u": {"kind": 6}, "x": 7, "y": 8},
            "01 06 07 08",
        ),
    ],
)
def test_names_of_numbers_are_those_of_the_field_in_that_record(
    inside: str, behind: str, values: dict[str, Any], data: str
) -> None:
    codec = codec_of(TWO_TABLES % (inside, inside, behind))
    assert codec.encode("f", values) == bytes.fromhex(data)
    assert codec.decode("f", bytes.fromhex(data)) == values


def test_a_text_is_no_name_of_a_number_that_the_frame_has_under_the_same_name() -> None:
    codec = codec_of("""
protocol: p
layouts: {r: [{field: kind, type: ascii, size: 1}, {field: x, type: u8, when: kind == 'a'}]}
frames: {f: {body: [{field: kind, type: u8, values: {1: a}}, {include: r, as: t}]}}
""")
    assert codec.decode("f", b"\1a\7") == {"kind": 1, "t": {"kind": "a", "x": 7}}


def test_fields_before_a_fault_are_told_though_a_later_record_has_the_same_names() -> None:
    codec = codec_of("""
protocol: p
layouts: {r: [{field: d, type: u8}]}
frames: {f: {body: [{field: d, type: u8}, {include: r, as: t}, {field: k, type: u8, range: 1..2}, {check: sum8}]}}
""")
    with pytest.raises(FrameError) as caught:
        codec.decode("f", bytes.fromhex("01 02 09 0C"))
    assert (caught.value.segment, caught.value.fields) == ("k", {"d": 1, "t": {"d": 2}})


def test_values_of_the_same_name_are_measured_by_what_each_follows_from() -> None:
    codec = codec_of("""
protocol: p
layouts:
  s: [{field: a, type: u8}, {value: v, read: a}, {data: d, size: v}]
  r: [{field: b, type: u8}, {value: v, read: b}, {data: d, size: v}]
frames: {f: {body: [{include: s, as: t}, {include: r, as: u}, {field: z, type: u8}]}}
""")
    data = bytes.fromhex("01 78 02 79 7A 03")
    assert codec.measure("f", data) == len(data)
    assert codec.encode("f", {"t": {"a": 1, "d": b"x"}, "u": {"b": 2, "d": b"yz"}, "z": 3}) == data


def test_a_size_is_never_that_of_a_field_outside_if_the_record_has_the_name_later() -> None:
    text = "protocol: p\nlayouts: {r: [{data: d, size: n}, {field: n, type: u8}]}\n"
    with pytest.raises(DefinitionError, match="the size uses 'n', which is read only later"):
        codec_of(f"{text}frames: {{f: {{body: [{{field: n, type: u8}}, {{include: r, as: t}}]}}}}")


def test_what_is_compared_later_waits_for_the_segment_of_its_own_record() -> None:
    """The earlier record has its own `d`; the length counts another `d`."""
    codec = codec_of("""
protocol: p
layouts: {r: [{data: d, size: 1}]}
frames:
  f:
    body:
      - {include: r, as: t}
      - {choose: t.d == h'01', cases: {1: [{length: n, type: u8, of: [d]}], 0: []}}
      - {field: k, type: u8}
      - {data: d, size: k}
""")
    data = bytes.fromhex("01 02 02 61 62")
    assert codec.encode("f", {"t": {"d": b"\1"}, "k": 2, "d": b"ab"}) == data
    assert codec.decode("f", data) == {"t": {"d": b"\1"}, "n": 2, "k": 2, "d": b"ab"}
    assert codec.trace("f", data)[2] is None
    with pytest.raises(FrameError, match="n at byte 1: length, expected 2, found 3"):
        codec.decode("f", bytes.fromhex("01 03 02 61 62"))


def test_a_check_of_a_record_covers_what_stands_in_a_case_of_another_only_by_its_record() -> None:
    """The check covers `a` of its record, not the `a` in a case of the frame."""
    codec = codec_of("""
protocol: p
layouts: {r: [{field: a, type: u8}, {check: xor8, over: [a]}]}
frames: {f: {body: [{field: k, type: u8}, {choose: k, cases: {1: [{field: a, type: u8}], 2: []}}, {include: r, as: t}]}}
""")
    assert codec.encode("f", {"k": 1, "a": 3, "t": {"a": 9}}) == bytes.fromhex("01 03 09 09")


def test_a_check_code_that_was_never_reached_is_not_compared() -> None:
    """The check code covers a later segment, so it is compared last; the frame ends before."""
    codec = codec_of("""
protocol: p
frames: {f: {body: [{field: a, type: u16}, {check: sum8, over: [b]}, {field: b, type: u8}]}}
""")
    with pytest.raises(FrameError, match="a at byte 0: short"):
        codec.decode("f", b"\1")


def test_a_list_in_the_items_of_a_list_of_the_same_name_is_another_one() -> None:
    codec = codec_of("""
protocol: p
frames:
  f:
    body:
      - repeat: r
        times: 2
        of: [{count: n, type: u8, of: r}, {repeat: r, times: n, of: [{field: n, type: u8}]}]
""")
    values = {"r": [{"n": 1, "r": [{"n": 7}]}, {"n": 2, "r": [{"n": 8}, {"n": 9}]}]}
    data = bytes.fromhex("01 07 02 08 09")
    assert (codec.encode("f", values), codec.decode("f", data)) == (data, values)
    assert codec.measure("f", data) == len(data)
