"""Every kind of segment in the construct codec: encoding, decoding, and the faults of other bytes."""

from __future__ import annotations

from typing import Any

import pytest
from construct_oracle import ConstructCodec
from small_protocol import small_codec

from framekit.codec.errors import EncodeError, FrameError


def both_ways(codec: ConstructCodec, values: dict[str, Any], data: str, ctx: dict[str, Any] | None = None) -> None:
    """Assert that `values` encode to these bytes (hex), and that these decode to `values` and the computed values."""
    wanted = bytes.fromhex(data)
    assert codec.encode("f", values, ctx).hex(" ") == wanted.hex(" ")
    found = codec.decode("f", wanted, ctx)
    assert {name: found[name] for name in values} == values
    assert codec.encode("f", found, ctx) == wanted


def fault(codec: ConstructCodec, data: str, ctx: dict[str, Any] | None = None) -> FrameError:
    with pytest.raises(FrameError) as caught:
        codec.decode("f", bytes.fromhex(data), ctx)
    return caught.value


def refused(codec: ConstructCodec, values: dict[str, Any], ctx: dict[str, Any] | None = None) -> str:
    """Return the field in the encoder's error."""
    with pytest.raises(EncodeError) as caught:
        codec.encode("f", values, ctx)
    return caught.value.field


# ---- constants and numbers ----------------------------------------------------------------------------------


def test_constants_are_built_and_compared() -> None:
    codec = small_codec("[{const: DLE STX}, {text: AB}]")
    both_ways(codec, {}, "10 02 41 42")
    found = fault(codec, "10 02 41 43")
    assert (found.cause, found.segment, found.offset) == ("constant", "const", 2)
    assert fault(codec, "10 02 41").cause == "short"
    assert fault(codec, "10 02 41 42 00").cause == "surplus"


@pytest.mark.parametrize(
    ("type_", "value", "data"),
    [
        ("type: u8", 200, "C8"),
        ("type: i16", -2, "FF FE"),
        ("type: u16, order: little", 0x1234, "34 12"),
        ("type: u24", 0x123456, "12 34 56"),
        ("type: u32, order: CDAB", 0x12345678, "56 78 12 34"),
        ("type: u32, order: BADC", 0x12345678, "34 12 78 56"),
        ("type: u64, order: DCBA", 1, "01 00 00 00 00 00 00 00"),
        ("type: f32", 1.5, "3F C0 00 00"),
        ("type: f64, order: little", -2.0, "00 00 00 00 00 00 00 C0"),
        ("type: hex, size: 4", 0xBEEF, "42 45 45 46"),
        ("type: hex, size: 4, order: little", 0x1234, "33 34 31 32"),
        ("type: hex, size: 2, case: lower", 0xAB, "61 62"),
        ("type: dec, size: 3", 42, "30 34 32"),
        ("type: oct, size: 3", 8, "30 31 30"),
        ("type: bcd, size: 2", 1234, "12 34"),
        ("type: bcd, size: 2, order: little", 1234, "34 12"),
        ("type: ascii, size: 3", "abc", "61 62 63"),
        ("type: ascii, size: 4, pad: 20", "ab", "61 62 20 20"),
        ("type: ascii, end: 00", "ab", "61 62 00"),
        ("type: bytes, size: 2", b"\x01\xff", "01 FF"),
        ("type: u8, plus: 0x20", 5, "25"),
        ("type: u16, unit: ms", 10_000_000, "00 0A"),
        ("type: u8, zero_means: 256", 256, "00"),
        ("'type': u8, 'long': {mark: 0xFF, type: u16}", 254, "FE"),
        ("'type': u8, 'long': {mark: 0xFF, type: u16}", 255, "FF 00 FF"),
    ],
)
def test_types_of_fields(type_: str, value: Any, data: str) -> None:
    both_ways(small_codec(f"[{{const: AA}}, {{field: x, {type_}}}]"), {"x": value}, f"AA {data}")


@pytest.mark.parametrize(
    ("type_", "value"),
    [
        ("type: u8", 256),
        ("type: u8", -1),
        ("type: u8", "1"),
        ("type: u8", 1.5),
        ("type: hex, size: 2", 256),
        ("type: bcd, size: 1", 100),
        ("type: ascii, size: 2", "abc"),
        ("type: ascii, size: 2", "a"),
        ("type: ascii, size: 2", b"ab"),
        ("type: ascii, size: 1", "€"),
        ("type: ascii, end: 61", "ab"),
        ("type: bytes, size: 2", b"a"),
        ("type: u8, plus: 1", 255),
        ("type: u8, range: 1..5", 6),
        ("type: u8, zero_means: 256", 0),
        ("type: u8, values: {1: one}, only: values", 2),
        ("type: u8, values: {1: one}", "two"),
        ("type: f32", "1"),
    ],
)
def test_values_that_do_not_fit_are_refused_by_name(type_: str, value: Any) -> None:
    assert refused(small_codec(f"[{{field: x, {type_}}}]"), {"x": value}) == "x"


def test_digits_that_are_none_are_a_fault_and_reading_goes_on() -> None:
    codec = small_codec(
        "[{field: a, type: hex, size: 2}, {field: b, type: dec, size: 1}, {field: c, type: bcd, size: 1}]"
    )
    found = fault(codec, "30 5F 37 99")
    assert (found.cause, found.segment, found.offset, found.fields) == ("digits", "a", 0, {})
    assert fault(codec, "30 30 41 99").segment == "b"
    assert fault(codec, "30 30 31 9A").fields == {"a": 0, "b": 1}


def test_fields_with_names_are_numbers() -> None:
    codec = small_codec("[{field: x, type: u8, values: {6: ACK, 21: NAK}, only: values, refuse: 9}]")
    assert codec.encode("f", {"x": "NAK"}) == b"\x15"
    assert codec.decode("f", b"\x06") == {"x": 6}
    found = fault(codec, "07")
    assert (found.cause, found.refuse) == ("value", 9)


def test_computed_fields() -> None:
    codec = small_codec(
        "[{field: a, type: u8, is: b + 1}, {field: b, type: u8}, {field: c, type: u8, build: b * 2}, "
        "{field: d, type: u8, default: 7}]"
    )
    both_ways(codec, {"b": 1}, "02 01 02 07")
    both_ways(codec, {"b": 1, "c": 9, "d": 8}, "02 01 09 08")
    assert refused(codec, {"a": 3, "b": 1}) == "a"
    assert refused(codec, {}) == "b"
    found = fault(codec, "03 01 02 07")
    assert (found.cause, found.segment, found.offset) == ("value", "a", 0)


def test_a_name_in_its_own_build_means_the_context() -> None:
    codec = small_codec("[{field: seq, type: u8, build: seq}]", "state: {seq: {scope: line, type: u8, initial: 5}}")
    assert codec.encode("f", {}) == b"\x05"
    assert codec.encode("f", {}, {"seq": 6}) == b"\x06"
    assert codec.frames["f"].build({}, seq=7) == b"\x07"


def test_absent_fields_have_their_default() -> None:
    codec = small_codec(
        "[{field: n, type: u8}, {field: x, type: u8, when: n > 1, default: 4}, {field: y, type: u8, when: n > 2}]"
    )
    assert codec.decode("f", b"\x01") == {"n": 1, "x": 4}
    both_ways(codec, {"n": 1, "x": 4}, "01")
    both_ways(codec, {"n": 3, "x": 4, "y": 5}, "03 04 05")
    assert refused(codec, {"n": 1, "x": 5}) == "x"
    assert refused(codec, {"n": 1, "y": 5}) == "y"
    assert refused(codec, {"n": 3}) == "y"


def test_bits() -> None:
    codec = small_codec("[{bits: {a: 0, b: 4-6, c: 7}, of: u8, is: {c: 1}, build: {b: a + 1}, values: {b: {5: five}}}]")
    both_ways(codec, {"a": 1, "b": 3}, "B1")
    assert codec.encode("f", {"b": "five"}) == b"\xd0"
    assert codec.encode("f", {"a": 1}) == b"\xa1"
    assert codec.decode("f", b"\x8f") == {"a": 1, "b": 0, "c": 1}
    assert fault(codec, "01").cause == "value"
    assert refused(codec, {"b": 8}) == "b"
    assert refused(codec, {"c": 0}) == "c"


# ---- lengths, lists, data -----------------------------------------------------------------------------------


def test_lengths_and_counts() -> None:
    codec = small_codec(
        "[{length: n, type: u8, of: [d, items], plus: 1}, {data: d, size: 2, convert: hex_to_ascii}, "
        "{count: k, type: u8, of: items},"
        " {repeat: items, times: k, of: u16}]"
    )
    both_ways(codec, {"d": b"\x12\x34", "items": [1, 2]}, "09 31 32 33 34 02 00 01 00 02")
    found = fault(codec, "0A 31 32 33 34 02 00 01 00 02")
    assert (found.cause, found.segment, found.offset) == ("length", "n", 0)
    assert refused(codec, {"d": b"\1\2", "items": [], "n": 9}) == "n"
    assert refused(codec, {"d": b"\1\2", "items": [], "k": 1}) == "k"
    assert refused(codec, {"d": b"\1\2\3", "items": []}) == "d"


def test_plain_lengths_in_words() -> None:
    codec = small_codec(
        "[{length: n, type: u8, of: [d], plain: yes, unit: words, range: 1..2}, "
        "{data: d, size: n * 2, convert: hex_to_ascii, swap: 2}]"
    )
    both_ways(codec, {"n": 1, "d": b"\x12\x34"}, "01 33 34 31 32")
    assert refused(codec, {"d": bytes(6)}) == "n"
    assert fault(codec, "03 30 30 30 30 30 30 30 30 30 30 30 30").cause == "range"


def test_data() -> None:
    codec = small_codec("[{data: a, size: 4, pad: EE, swap: 4}, {data: b, size: rest, convert: ascii_to_hex, min: 2}]")
    both_ways(codec, {"a": b"\1\2\3\4", "b": b"1A"}, "04 03 02 01 1A")
    assert codec.encode("f", {"a": b"\1", "b": b"1A"}) == bytes.fromhex("EE EE EE 01 1A")
    assert fault(codec, "04 03 02 01").cause == "short"
    assert fault(codec, "04 03 02").segment == "a"
    assert refused(codec, {"a": bytes(5), "b": b"1A"}) == "a"
    assert refused(codec, {"a": b"", "b": b"1G"}) == "b"
    assert refused(codec, {"a": b"", "b": b""}) == "b"


def test_repeats_of_records_read_to_the_end() -> None:
    codec = small_codec(
        "[{repeat: all, times: rest, of: [{field: x, type: u8}, {field: y, type: u8, is: x + 1}]}, {const: FF}]"
    )
    assert codec.encode("f", {"all": [{"x": 1}, {"x": 5}]}) == bytes.fromhex("01 02 05 06 FF")
    assert codec.decode("f", bytes.fromhex("01 02 05 06 FF")) == {"all": [{"x": 1, "y": 2}, {"x": 5, "y": 6}]}
    assert codec.decode("f", b"\xff") == {"all": []}
    found = fault(codec, "01 02 05 07 FF")
    assert (found.cause, found.offset) == ("value", 3)
    assert fault(codec, "01 02 05 FF").cause == "short"
    assert refused(codec, {"all": [{"x": 1}, {"x": 1, "y": 5}]}) == "all[1].y"
    assert refused(codec, {"all": [{"z": 1}]}) == "all[0].z"


def test_choices() -> None:
    codec = small_codec(
        "[{field: kind, type: u8}, {choose: kind, cases: {1: [{field: a, type: u8}], '2,3': [{field: b, type: u16}]}}]"
    )
    both_ways(codec, {"kind": 1, "a": 9}, "01 09")
    both_ways(codec, {"kind": 3, "b": 9}, "03 00 09")
    found = fault(codec, "04 09")
    assert (found.cause, found.segment) == ("value", "choose")
    assert refused(codec, {"kind": 1, "a": 9, "b": 1}) == "b"
    assert refused(codec, {"kind": 1}) == "a"


def test_optional_parts() -> None:
    codec = small_codec(
        "[{field: a, type: u8}, {optional: [{field: b, type: u8}, {field: c, type: u8, default: 3}]}, {const: EE}]"
    )
    both_ways(codec, {"a": 1}, "01 EE")
    both_ways(codec, {"a": 1, "b": 2}, "01 02 03 EE")
    assert fault(codec, "01 02 EE").cause == "short"
    assert refused(codec, {"a": 1, "c": 3}) == "b"


def test_records() -> None:
    codec = small_codec(
        "[{include: point, as: p}, {field: sum, type: u8, is: p.x + p.y}]",
        "layouts: {point: [{field: x, type: u8}, {field: y, type: u8, default: 2}]}",
    )
    both_ways(codec, {"p": {"x": 1, "y": 5}}, "01 05 06")
    assert codec.encode("f", {"p": {"x": 1}}) == b"\1\2\3"
    assert refused(codec, {}) == "p"
    assert refused(codec, {"p": 5}) == "p"


def test_skipped_bytes_derived_values_and_conditions() -> None:
    codec = small_codec(
        "[{skip: 3, fill: A1 A2}, {field: t, type: ascii, size: 2, build: 'digits(v, 2)'}, "
        "{value: v, read: 'number(t, 16)'},"
        " {require: v != 5, refuse: 7}]"
    )
    assert codec.encode("f", {"v": 0x2A}) == b"\xa1\xa2\xa12A"
    assert codec.decode("f", b"???2a") == {"t": "2a", "v": 0x2A}
    assert refused(codec, {"t": "2A", "v": 3}) == "v"
    assert refused(codec, {"v": 5}) == "require"
    assert (fault(codec, "00 00 00 30 35").cause, fault(codec, "00 00 00 30 35").refuse) == ("require", 7)
    assert fault(codec, "00 00 00 30 5F").cause == "value"
