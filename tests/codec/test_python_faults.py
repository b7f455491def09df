"""Faults of decoded frames: precedence, offset and refusal; and values that encoders refuse."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from small_protocol import small_protocol

from framekit.codec.codec import Codec, compile_protocol
from framekit.codec.errors import EncodeError, FrameError
from framekit.definition.load.protocol import load_protocol
from framekit.definition.problems import DefinitionError


def codec_of(body: str, *sections: str, keys: str = "") -> Codec:
    return compile_protocol(small_protocol(body, *sections, keys=keys))


def fault(codec: Codec, data: str, ctx: dict[str, Any] | None = None) -> FrameError:
    """Return the fault of these bytes; assert that `trace` finds the same fault."""
    with pytest.raises(FrameError) as caught:
        codec.decode("f", bytes.fromhex(data), ctx)
    found = codec.trace("f", bytes.fromhex(data), ctx)[2]
    assert found is not None
    assert str(found) == str(caught.value)
    return caught.value


def refused(codec: Codec, values: dict[str, Any], ctx: dict[str, Any] | None = None) -> str:
    """Return the path in the encoder's error; the message must be a whole sentence."""
    with pytest.raises(EncodeError) as caught:
        codec.encode("f", values, ctx)
    assert str(caught.value)
    return caught.value.field


def test_bytes_are_shown_in_capitals() -> None:
    body = "[{const: AB}, {wrap: hex, of: [{field: a, type: u8}]}, {field: t, type: ascii, end: CD}, {check: sum8}]"
    shown = {
        "EF 30 31 CD 1D": "const at byte 0: constant, expected AB, found EF",
        "AB FA FB CD 6D": "wrap at byte 1: digits, expected wrapped content, found FA FB",
        "AB 30 31 EF FB": "t at byte 3: short, expected the end CD, found none",
        "AB 30 31 CD EF": "check at byte 4: check, expected D9, found EF",
    }
    codec = codec_of(body)
    assert {data: str(fault(codec, data)).split("f.")[-1] for data in shown} == shown


# ---- which fault counts -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("body", "data", "cause", "segment", "offset"),
    [
        ("[{const: 01}, {field: a, type: u8}, {const: 02}]", "03 00 04", "constant", "const", 0),
        ("[{const: 01}, {field: a, type: u8, range: 1..2}, {const: 02}]", "01 05 04", "range", "a", 1),
        ("[{field: a, type: hex, size: 2}, {field: b, type: u8, is: 3}]", "30 2F 04", "digits", "a", 0),
        ("[{field: a, type: u8, is: b + 1}, {field: b, type: u8, range: 1..2}]", "09 07", "value", "a", 0),
        (
            "[{length: n, type: u8, of: [a, b]}, {field: a, type: u8}, {field: b, type: u16}]",
            "04 00 00 00",
            "length",
            "n",
            0,
        ),
        ("[{field: a, type: u8}, {data: d, size: a}, {field: e, type: u8}]", "05 01 02", "short", "d", 1),
        ("[{field: a, type: u8}, {data: d, size: a - 3}]", "01", "length", "d", 1),
        (
            "[{field: a, type: i8}, {data: d, size: a}, {field: b, type: u8}, {field: c, type: u8}]",
            "FF 05",
            "length",
            "d",
            1,
        ),
        ("[{field: a, type: u8, plus: 1}, {repeat: r, times: a, of: u8}, {const: 05}]", "00 05", "length", "r", 1),
        ("[{value: v, read: 2 * a}, {field: a, type: i8}, {field: b, type: hex, size: v}]", "FF", "length", "b", 1),
        (
            "[{count: n, type: i8, of: r}, {repeat: r, times: n, of: [{field: a, type: u8}]}, {const: 05}]",
            "FF 05",
            "length",
            "r",
            1,
        ),
        ("[{field: a, type: u8, values: {1: one}, only: values}, {require: a > 5}]", "02", "value", "a", 0),
        ("[{field: a, type: u8}, {require: a > 5}]", "02", "require", "require", 1),
        ("[{bits: {a: 0-3, b: 4-7}, of: u8, is: {b: 2}}]", "31", "value", "b", 0),
        ("[{field: a, type: ascii, end: 00}]", "41 42", "short", "a", 0),
        ("[{choose: 5, cases: {1: [{const: 01}]}}]", "01", "value", "choose", 0),
        ("[{data: d, size: rest, min: 3}]", "01 02", "short", "d", 0),
        ("[{text: ':'}, {wrap: hex, of: [{field: a, type: u8}], name: w}]", "3A 30 47", "digits", "w", 1),
        ("[{repeat: r, times: rest, of: u16}]", "00 01 02", "short", "r", 0),
        ("[{repeat: r, times: rest, of: u16}, {check: sum8}]", "00 01 02 03", "short", "r", 0),
        ("[{repeat: r, times: rest, of: u16}, {check: sum8}]", "00 01 02 04", "check", "check", 3),
        ("[{repeat: r, times: rest, of: u16}, {const: 03}]", "00 01 02 03", "short", "r", 0),
        ("[{check: xor8, over: [d], name: one}, {data: d, size: 1}, {check: xor8}]", "01 02 09", "check", "one", 0),
    ],
)
def test_the_first_fault_counts(body: str, data: str, cause: str, segment: str, offset: int) -> None:
    found = fault(codec_of(body), data)
    assert (found.cause, found.segment, found.offset, found.refuse) == (cause, segment, offset, None)


def test_a_wrong_check_outweighs_everything_before_it() -> None:
    codec = codec_of("[{const: 01}, {field: a, type: u8, range: 1..2, refuse: 7}, {data: d, size: a}, {check: sum8}]")
    assert fault(codec, "01 05 00 00 00 00 00 06").refuse == 7
    found = fault(codec, "01 05 00 00 00 00 00 FF")
    assert (found.cause, found.refuse) == ("check", None)
    assert codec.decode("f", bytes.fromhex("01 01 09 0B")) == {"a": 1, "d": b"\t"}


def test_a_refused_fault_needs_a_right_check() -> None:
    codec = codec_of("[{field: a, type: u8, range: 1..2, refuse: 7}, {field: b, type: u8}, {check: sum8}]")
    found = fault(codec, "05 01 06")
    assert (found.cause, found.refuse, found.fields) == ("range", 7, {})
    assert fault(codec, "05 01 07").refuse is None
    assert fault(codec, "05 01").refuse is None, "the check was not reached"


INSIDE = """
groups:
  inner: {from: client, head: [{field: code, type: u8}]}
frames:
  one: {group: inner, where: {code: 1}, body: [{field: a, type: u8, range: 0..9, refuse: 4}]}
  other: {group: inner, body: [], refuse: 7}
"""
AROUND = {
    "plain": "[{const: AA}, {inner: i, of: inner}, {check: sum8, over: [i]}, {const: 55}]",
    "wrap": "[{const: AA}, {wrap: hex, min: 2, of: [{inner: i, of: inner}, {check: sum8}]}, {const: 55}]",
    "branch": "[{const: AA}, {wrap: {escape: AB}, name: w, min: 2, of: [{inner: i, of: inner}]}, {const: AB},"
    " {const: 55, name: e}, {check: sum8, over: [i], when: 1 == 1}]",
    "read": "[{const: AA}, {inner: i, of: inner}, {require: i.one.a != 8}, {check: sum8, over: [i]}, {const: 55}]",
}


@pytest.mark.parametrize(
    ("around", "data", "cause", "refuse", "is_found_out"),
    [
        ("plain", "AA 01 05 07 55", "check", None, False),
        ("plain", "AA 01 0A 07 55", "check", None, False),
        ("plain", "AA 01 0A 0B 55", "range", 4, True),
        ("plain", "AA 01 05 06 56", "constant", None, False),
        ("plain", "AA 01 0A 0B 56", "range", 4, True),
        ("plain", "AB 01 0A 0B 55", "constant", None, True),
        ("plain", "AA 01 05 07 56", "check", None, False),
        ("wrap", "AA 30 31 30 35 30 37 55", "check", None, False),
        ("wrap", "AA 30 31 30 41 30 37 55", "check", None, False),
        ("wrap", "AA 30 31 30 41 30 42 55", "range", 4, True),
        ("wrap", "AA 30 30 55", "short", None, False),
        ("wrap", "AA 30 47 30 31 55", "digits", None, True),
        ("branch", "AA 01 05 AB 55 07", "check", None, False),
        ("branch", "AA 01 0A AB 55 07", "check", None, False),
        ("branch", "AA 01 0A AB 55 0B", "range", 4, True),
        ("branch", "AA 01 AB 55 01", "short", None, False),
        ("branch", "AA 01 05 AB 55 06 00", "surplus", None, True),
        ("read", "AA 01 0A 07 55", "check", None, True),
        ("read", "AA 01 05 07 55", "check", None, False),
    ],
)
def test_what_is_never_refused_is_found_out_when_it_is_asked_for(
    around: str, data: str, cause: str, refuse: int | None, is_found_out: bool
) -> None:
    """The only fault around an inner frame is a wrong check code, constant or wrap size.

    Its cause is computed on demand.
    """
    codec = codec_of(AROUND[around], INSIDE)
    with pytest.raises(FrameError) as caught:
        codec.decode("f", bytes.fromhex(data))
    assert ("cause" in vars(caught.value)) is is_found_out
    assert (caught.value.cause, caught.value.refuse) == (cause, refuse)
    wanted = codec.trace("f", bytes.fromhex(data))[2]
    assert wanted is not None
    for name in ("cause", "segment", "offset", "expected", "found", "refuse", "fields"):
        assert getattr(caught.value, name) == getattr(wanted, name)
    assert str(caught.value) == str(wanted)


def test_fields_before_the_fault_are_there() -> None:
    codec = codec_of("[{field: a, type: u8}, {field: b, type: u8}, {require: a < b, refuse: 3}, {field: c, type: u8}]")
    assert fault(codec, "05 01 09").fields == {"a": 5, "b": 1}


def test_constants_fixed_by_where_have_a_cause_of_their_own() -> None:
    codec = codec_of(
        "[{field: x, type: u8}]",
        "groups: {g: {head: [{field: kind, type: u8}, {bits: {low: 0-3, high: 4-7}, of: u8}]}}",
        keys="group: g, where: {kind: [4, 5], high: 2}",
    )
    assert codec.encode("f", {"low": 1, "x": 0}) == bytes.fromhex("04 21 00")
    assert codec.encode("f", {"kind": 5, "x": 0}) == bytes.fromhex("05 20 00")
    assert (fault(codec, "06 21 00").segment, fault(codec, "06 21 00").cause) == ("kind", "where")
    assert (fault(codec, "05 31 00").segment, fault(codec, "05 31 00").cause) == ("high", "where")
    assert refused(codec, {"kind": 6, "x": 0}) == "kind"
    assert refused(codec, {"high": 3, "x": 0}) == "high"


def test_checks_that_only_warn_are_told_apart() -> None:
    codec = codec_of("[{field: a, type: u8}, {check: sum8, verify: warn}]")
    assert codec.decode("f", b"\x01\x02") == {"a": 1}
    assert len(codec.check_warnings("f", b"\x01\x02")) == 1
    assert codec.check_warnings("f", b"\x01\x01") == []


def test_delimited_frames_have_an_end_whatever_is_in_them() -> None:
    codec = codec_of(
        "[{length: n, type: dec, size: 1, of: [d], range: 0..3, refuse: 1}, "
        "{field: d, type: ascii, size: n, refuse: 2}]",
        "groups: {g: {head: [{const: 02}], tail: [{const: 03}, {check: sum8}], delimited: yes, surplus: 9, max: 20}}",
        keys="group: g",
    )
    assert codec.encode("f", {"d": "ab"}) == bytes.fromhex("02 32 61 62 03 FA")
    assert fault(codec, "02 31 61 62 03 F9").refuse == 9
    assert fault(codec, "02 34 61 62 03 FC").refuse == 1
    assert (fault(codec, "02 32 61 03 98").cause, fault(codec, "02 32 61 03 98").refuse) == ("short", 2)
    assert fault(codec, "02 31 61 62 03 00").cause == "check"
    assert refused(codec, {"d": "\x03"}) == ""


# ---- inner frames -------------------------------------------------------------------------------------------

INNER = (
    "groups: {g: {from: client}}",
    "frames:\n"
    "  one: {group: g, body: [{field: code, type: u8, is: 1}, {field: a, type: u8, range: 0..9, refuse: 4}]}\n"
    "  two: {group: g, body: [{field: code, type: u8, is: 2}, {data: d, size: rest}]}\n"
    "  other: {group: g, body: [{field: code, type: u8}, {data: rest, size: 1}], refuse: 8}",
)


def test_inner_frames_are_told_apart_by_what_they_begin_with() -> None:
    codec = codec_of("[{const: 55}, {inner: i, of: g}, {check: sum8}]", *INNER)
    assert codec.decode("f", bytes.fromhex("55 01 05 5B")) == {"i": {"one": {"code": 1, "a": 5}}}
    assert codec.decode("f", bytes.fromhex("55 02 57")) == {"i": {"two": {"code": 2, "d": b""}}}
    assert codec.decode("f", bytes.fromhex("55 07 00 5C")) == {"i": {"other": {"code": 7, "rest": b"\0"}}}
    assert codec.decode("f", bytes.fromhex("55 07 5C")) == {"i": {"unknown": {"data": b"\x07"}}}
    assert codec.encode("f", {"i": {"unknown": {"data": b"\x07"}}}) == bytes.fromhex("55 07 5C")


def test_an_inner_fault_is_the_outer_frames() -> None:
    codec = codec_of("[{const: 55}, {inner: i, of: g}, {check: sum8}]", *INNER)
    found = fault(codec, "55 01 0B 61")
    assert (found.cause, found.refuse, found.segment, found.offset) == ("range", 4, "i.one.a", 2)
    assert found.fields == {"i": {"one": {"code": 1}}}
    assert fault(codec, "55 01 0B 62").refuse is None


def test_inner_values_are_refused_with_their_path() -> None:
    codec = codec_of("[{inner: i, of: g}]", *INNER)
    assert refused(codec, {"i": {"one": {"a": 10}}}) == "i.one.a"
    assert refused(codec, {"i": {"nobody": {}}}) == "i"
    assert refused(codec, {"i": 5}) == "i"


# ---- values -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("body", "values", "field"),
    [
        ("[{field: a, type: u8}]", {}, "a"),
        ("[{field: a, type: u8}]", {"a": 256}, "a"),
        ("[{field: a, type: u8}]", {"a": -1}, "a"),
        ("[{field: a, type: u8}]", {"a": "1"}, "a"),
        ("[{field: a, type: u8}]", {"a": 1.0}, "a"),
        ("[{field: a, type: u8}]", {"a": 1, "b": 2}, "b"),
        ("[{field: a, type: u8, range: 3..5}]", {"a": 6}, "a"),
        ("[{field: a, type: u8, is: 3}]", {"a": 4}, "a"),
        ("[{field: a, type: u8, values: {1: one}, only: values}]", {"a": "two"}, "a"),
        ("[{field: a, type: u8, values: {1: one}, only: values}]", {"a": 2}, "a"),
        ("[{field: a, type: u8, unit: ms}]", {"a": 1_500_000}, "a"),
        ("[{field: a, type: u8, zero_means: 256}]", {"a": 0}, "a"),
        ("[{field: a, type: hex, size: 2}]", {"a": 256}, "a"),
        ("[{field: a, type: bcd, size: 1}]", {"a": 100}, "a"),
        ("[{field: a, type: ascii, size: 2}]", {"a": "abc"}, "a"),
        ("[{field: a, type: ascii, size: 2}]", {"a": "€x"}, "a"),
        ("[{field: a, type: bytes, size: 2}]", {"a": b"abc"}, "a"),
        ("[{field: a, type: f32}]", {"a": "x"}, "a"),
        ("[{bits: {a: 0-3}, of: u8}]", {"a": 16}, "a"),
        ("[{length: n, type: u8, of: [d]}, {data: d, size: n}]", {"d": bytes(256)}, "d"),
        ("[{length: n, type: u8, of: [d]}, {data: d, size: n}]", {"d": "ab"}, "d"),
        ("[{length: n, type: u8, of: [d]}, {data: d, size: n}]", {"d": b"ab", "n": 3}, "n"),
        ("[{field: n, type: u8}, {data: d, size: n}]", {"n": 3, "d": b"ab"}, "d"),
        ("[{data: d, size: 2, pad: 00}]", {"d": b"abc"}, "d"),
        ("[{repeat: r, times: 2, of: u8}]", {"r": [1]}, "r"),
        ("[{repeat: r, times: 2, of: u8}]", {"r": [1, 256]}, "r[1]"),
        ("[{repeat: r, times: 2, of: [{field: x, type: u8}]}]", {"r": [{"x": 1}, {"x": 256}]}, "r[1].x"),
        ("[{repeat: r, times: 2, of: [{field: x, type: u8}]}]", {"r": [{"x": 1}, {}]}, "r[1].x"),
        ("[{repeat: r, times: 1, of: [{field: x, type: u8}]}]", {"r": [{"x": 1, "y": 1}]}, "r[0].y"),
        ("[{field: a, type: u8}, {require: a > 3}]", {"a": 3}, "require"),
        ("[{field: a, type: u8}, {optional: [{field: b, type: u8}, {field: c, type: u8}]}]", {"a": 1, "c": 2}, "b"),
        ("[{field: a, type: u8}, {choose: a, cases: {1: [{field: b, type: u8}]}, else: []}]", {"a": 2, "b": 2}, "b"),
    ],
)
def test_values_are_refused_by_name(body: str, values: dict[str, Any], field: str) -> None:
    assert refused(codec_of(body), values) == field


def test_values_may_refer_to_each_other() -> None:
    codec = codec_of(
        "[{field: t, type: ascii, size: 2, build: 'digits(v, 2)'}, {value: v, read: 'number(t, 16)'}, "
        "{field: sum, type: u8, is: v + len(d)}, {data: d, size: rest}]"
    )
    wanted = b"0A\x0cab"
    for values in ({"v": 10}, {"t": "0A"}, {"t": "0A", "v": 10, "sum": 12}):
        assert codec.encode("f", {**values, "d": b"ab"}) == wanted
    assert codec.decode("f", wanted) == {"t": "0A", "v": 10, "sum": 12, "d": b"ab"}
    assert refused(codec, {"t": "0B", "v": 10, "d": b""}) == "v"
    assert refused(codec, {"d": b""}) in ("v", "t")


def test_checks_in_cases_cover_what_stands_before() -> None:
    codec = codec_of(
        "[{const: 02}, {field: kind, type: u8}, {data: d, size: 2}, "
        "{choose: kind, cases: {1: [{check: sum8}], 2: [{const: EE}, {check: crc16-modbus, order: little}]}, else: []}]"
    )
    assert codec.encode("f", {"kind": 1, "d": b"ab"}) == bytes.fromhex("02 01 61 62 C6")
    whole = codec.encode("f", {"kind": 2, "d": b"ab"})
    assert codec.encode("f", {"kind": 3, "d": b"ab"}) == bytes.fromhex("02 03 61 62")
    for data in (bytes.fromhex("02 01 61 62 C6"), whole, bytes.fromhex("02 03 61 62")):
        assert codec.encode("f", codec.decode("f", data)) == data
    assert fault(codec, "02 01 61 62 C7").cause == "check"
    assert fault(codec, whole[:-1].hex() + "00").cause == "check"


def test_what_the_context_lacks_is_named() -> None:
    codec = codec_of("[{field: a, type: u8}, {require: a < station}]")
    with pytest.raises(KeyError, match="station"):
        codec.decode("f", b"\x01")
    with pytest.raises(EncodeError, match="station"):
        codec.encode("f", {"a": 1})
    assert codec.decode("f", b"\x01", {"station": 2}) == {"a": 1}


def test_announced_sizes_fit_nothing_before_they_are_said() -> None:
    codec = codec_of(
        "[{const: 02}, {data: d, size: announced - 1}, {field: next, type: u8}]",
        "state: {announced: {scope: line, type: u16}}",
        keys="announces: {announced: next}",
    )
    assert codec.encode("f", {"d": b"abc", "next": 1}) == b"\x02abc\x01"
    assert fault(codec, "02 61 01").cause == "length"
    assert codec.measure("f", b"\x02a\x01") == 0
    assert codec.decode("f", b"\x02a\x01", {"announced": 2}) == {"d": b"a", "next": 1}
    with pytest.raises(EncodeError, match="'d' has a length of 3, it must be 1"):
        codec.encode("f", {"d": b"abc", "next": 1}, {"announced": 2})


def test_a_check_in_a_list_has_to_say_what_it_covers() -> None:
    with pytest.raises(DefinitionError, match="over"):
        codec_of("[{repeat: r, times: 2, of: [{field: x, type: u8}, {check: sum8}]}]")
    codec = codec_of("[{repeat: r, times: 2, of: [{field: x, type: u16}, {check: sum8, over: [x]}]}]")
    data = codec.encode("f", {"r": [{"x": 0x0102}, {"x": 0x0304}]})
    assert data == bytes.fromhex("01 02 03 03 04 07")
    assert codec.decode("f", data) == {"r": [{"x": 0x0102}, {"x": 0x0304}]}
    assert fault(codec, "01 02 03 03 04 08").cause == "check"


# ---- anything at all ----------------------------------------------------------------------------------------


@settings(max_examples=150, deadline=None, database=None, derandomize=True)
@given(st.data())
def test_noise_raises_nothing_but_frame_errors(data: st.DataObject) -> None:
    codec = compile_protocol(load_protocol(data.draw(st.sampled_from(["mldp", "modbus-ascii", "modbus-rtu"]))))
    frame = data.draw(st.sampled_from(sorted(codec.frames)))
    start = data.draw(st.sampled_from([b"", b"\x05", b"\x06", b"\x0530rSB", b":0103", b"\x01\x03"]))
    noise = start + data.draw(st.binary(max_size=40))
    fields, spans, found = codec.trace(frame, noise)
    try:
        assert codec.decode(frame, noise) == fields
        assert found is None
    except FrameError as error:
        assert found is not None
        assert (error.cause, error.offset, error.refuse) == (found.cause, found.offset, found.refuse)
    assert all(0 <= first <= last <= len(noise) for _, first, last, _ in spans)
    size = codec.measure(frame, noise)
    assert size <= len(noise)
    assert codec.measure(frame, bytearray(b"zz" + noise), 2, 2 + len(noise)) == size


def test_bits_with_the_name_of_a_field_in_another_case() -> None:
    cases = (
        "{1: [{bits: {x: 0, y: 1}, of: u8, name: mask}],"
        " 2: [{field: mask, type: u8}, {field: more, type: u8, when: mask & 1}]}"
    )
    body = f"[{{field: kind, type: u8}}, {{choose: kind, cases: {cases}}}]"
    codec = codec_of(body)
    for data in (bytes((2, 3, 9)), bytes((1, 3))):
        fields, _, wrong = codec.trace("f", data)
        assert (fields, wrong) == (codec.decode("f", data), None)
