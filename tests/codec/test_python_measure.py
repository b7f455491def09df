"""Measuring: whole frames, frames that arrive byte by byte, among other bytes, cut and damaged."""

from __future__ import annotations

from functools import cache
from typing import Any

import pytest
import shipped
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from small_protocol import small_protocol
from spread import spread
from strategies import FrameValues

from framekit.codec.codec import Codec, compile_protocol
from framekit.definition.load.protocol import load_protocol

QUICK = settings(
    max_examples=25, deadline=None, database=None, derandomize=True, suppress_health_check=list(HealthCheck)
)


def codec_of(body: str, *sections: str, keys: str = "") -> Codec:
    return compile_protocol(small_protocol(body, *sections, keys=keys))


def calls_until_complete(codec: Codec, frame: str, data: bytes, ctx: dict[str, Any] | None = None) -> int:
    """Feed a frame byte by byte like a receiver; return the number of `measure` calls until it was complete."""
    seen, wanted, calls = 0, 1, 0
    for have in range(1, len(data) + 1):
        if have < wanted:
            continue
        found = codec.measure(frame, data, 0, have, ctx, seen)
        calls += 1
        assert found == codec.measure(frame, data, 0, have, ctx), "what was seen before changes nothing"
        if have == len(data):
            assert found == len(data)
        else:
            assert found < 0
            assert found not in (codec.QUIET, codec.LOST)
            wanted = have - found
            assert wanted <= len(data), "never more than the frame has"
        seen = have
    return calls


SIZED = "{length: n, type: u8, of: [d]}, {data: d, size: n}"
BODIES = {
    "fixed": ("{const: 01 02}, {field: a, type: u32}", {"a": 5}),
    "length": (f"{{field: a, type: u8}}, {SIZED}, {{check: sum8}}", {"a": 1, "d": b"abc"}),
    "length as digits": ("{length: n, type: hex, size: 2, of: [d]}, {data: d, size: n}", {"d": b"0123456789"}),
    "length of more": (
        "{length: n, type: u8, of: [a, d], plus: 1}, {field: a, type: u8}, {data: d, size: n - 2}",
        {"a": 9, "d": b"xy"},
    ),
    "converted": (
        "{length: n, type: u8, of: [d], plain: yes}, {data: d, size: n, convert: hex_to_ascii}",
        {"d": b"ab"},
    ),
    "count": ("{count: n, type: u8, of: r}, {repeat: r, times: n, of: u16}, {const: FF}", {"r": [1, 2, 3]}),
    "records": (
        f"{{count: c, type: u8, of: r}}, {{repeat: r, times: c, of: [{SIZED}]}}, {{const: FF}}",
        {"r": [{"d": b"abc"}, {"d": b""}, {"d": b"0123456789"}]},
    ),
    "a list that gives sizes": (
        "{count: n, type: u8, of: r}, {repeat: r, times: n, of: u8}, {data: d, size: sum(r)}",
        {"r": [1, 2, 3], "d": b"abcdef"},
    ),
    "records that give sizes": (
        "{count: n, type: u8, of: r}, {repeat: r, times: n, of: [{field: x, type: u8}]}, {data: d, size: sum(r.x)}",
        {"r": [{"x": 1}, {"x": 2}], "d": b"abc"},
    ),
    "condition": ("{field: a, type: u8}, {field: b, type: u16, when: a > 3}, {check: sum8}", {"a": 4, "b": 1}),
    "condition not met": ("{field: a, type: u8}, {field: b, type: u16, when: a > 3}, {check: sum8}", {"a": 3}),
    "choice": (
        f"{{field: k, type: u8}}, {{choose: k, cases: {{1: [{{field: x, type: u8}}], 2: [{SIZED}]}}}}",
        {"k": 2, "d": b"abc"},
    ),
    "long": ("{field: a, type: u8, long: {mark: 0xFF, type: u16}}, {field: b, type: u8}", {"a": 300, "b": 1}),
    "terminated": ("{field: a, type: ascii, end: 0D 0A}, {field: b, type: u16}", {"a": "hello", "b": 0x0D0A}),
    "value": ("{field: a, type: u8}, {value: n, read: a % 4}, {data: d, size: n}", {"a": 7, "d": b"abc"}),
    "bits": (
        "{bits: {n: 0-3, x: 4-7}, of: u8}, {data: d, size: n}, {const: 03}",
        {"n": 4, "x": 9, "d": b"abcd"},
    ),
    "constant behind the rest": ("{const: 02}, {data: d, size: rest}, {const: 0D 0A}", {"d": b"abc"}),
    "checked behind the rest": (
        "{const: 02}, {data: d, size: rest}, {const: 03}, {check: crc16-modbus}",
        {"d": b"a\x03b\x03\x03c"},
    ),
    "checked before the constant": (
        "{const: 02}, {data: d, size: rest}, {check: crc16-modbus}, {const: 03}, {field: a, type: u8}",
        {"d": b"a\x03b\x03\x03c", "a": 3},
    ),
    "digits of a check code before the constant": (
        "{text: '@'}, {data: d, size: rest, convert: hex_to_ascii}, {check: xor8, as: hex}, {text: '*'}, {const: CR}",
        {"d": b"*\r*"},
    ),
    "a list before the constant": (
        "{repeat: r, times: rest, of: [{field: a, type: dec, size: 3}]}, {check: sum8, as: hex}, {const: CR}",
        {"r": [{"a": 1}, {"a": 222}]},
    ),
    "hex": (
        "{text: ':'}, {wrap: hex, of: [{data: d, size: rest}, {check: lrc8}]}, {const: CR LF}",
        {"d": b"xy"},
    ),
    "hex without an end": (f"{{text: '$'}}, {{wrap: hex, of: [{SIZED}, {{check: sum8}}]}}", {"d": b"xyz"}),
    "hex whose content tells of what comes later": (
        "{wrap: hex, of: [{field: n, type: u8}, {data: d, size: rest}]}, {const: CR LF}, {data: e, size: n}",
        {"n": 3, "d": b"xy", "e": b"abc"},
    ),
    "COBS whose content tells of what comes later": (
        "{wrap: cobs, of: [{field: n, type: u8}, {data: d, size: rest}]}, {const: 00}, {data: e, size: n}",
        {"n": 3, "d": b"x\0y", "e": b"abc"},
    ),
    "a wrap with a size": (
        "{length: n, type: u16, of: [w]}, {name: w, wrap: cobs, size: n, of: [{data: d, size: rest}]}, {check: sum8}",
        {"d": b"x\0y"},
    ),
    "escape": (
        "{const: DLE STX}, {wrap: {escape: DLE}, of: [{data: d, size: rest}]}, {const: DLE ETX}, {check: sum8}",
        {"d": b"\x10\x10a\x03\x10"},
    ),
    "escape of fixed content": (
        "{const: DLE ENQ}, {wrap: {escape: DLE}, of: [{field: a, type: u16}]}, {check: sum8}",
        {"a": 0x1010},
    ),
}


@pytest.mark.parametrize("name", BODIES)
def test_frames_are_found_however_they_come(name: str) -> None:
    body, values = BODIES[name]
    codec = codec_of(f"[{body}]")
    data = codec.encode("f", values)
    assert codec.encode("f", codec.decode("f", data)) == data
    assert codec.measure("f", data) == len(data)
    assert codec.measure("f", data + b"\x00\x10\x03", 0, len(data)) == len(data)
    assert codec.measure("f", data + bytes(300)) == len(data), "what follows is not looked at"
    assert codec.measure("f", bytearray(b"\x10\x02" + data), 2) == len(data)
    calls_until_complete(codec, "f", data)


def test_a_frame_inside_with_an_end_of_its_own_before_a_delimited_body() -> None:
    group = "groups: {g: {head: [{inner: i, of: [inside]}], tail: [{const: 7E}], delimited: yes}}"
    inside = "frames:\n  inside: {body: [{const: 01}, {field: t, type: ascii, end: 00}]}"
    codec = codec_of("[{field: a, type: ascii, size: 2}]", group, inside, keys="group: g")
    data = codec.encode("f", {"i": {"inside": {"t": "abc"}}, "a": "xy"})
    assert data == b"\x01abc\0xy\x7e"
    calls_until_complete(codec, "f", data)


def test_only_leading_constants_say_that_a_frame_does_not_begin_here() -> None:
    codec = codec_of(
        "[{const: 01}, {wrap: {escape: 01}, of: [{const: 01 02}, {field: a, type: u8, is: 5}, {const: 09}]}]"
    )
    data = codec.encode("f", {})
    assert data == bytes.fromhex("01 01 01 02 05 09")
    for place in range(4):
        damaged = data[:place] + b"\x77" + data[place + 1 :]
        assert codec.measure("f", damaged) == 0
        assert codec.measure("f", damaged[: place + 1]) == 0, "as soon as it shows"
    assert codec.measure("f", bytes.fromhex("01 01 01 02 06 09")) == 6
    assert codec.measure("f", bytes.fromhex("01 01 01 02 05 08")) == 6


def test_a_constant_that_cannot_stand_in_the_content_ends_damaged_frames_too() -> None:
    codec = codec_of("[{text: '@'}, {data: d, size: rest, convert: hex_to_ascii}, {check: xor8, as: hex}, {const: CR}]")
    data = codec.encode("f", {"d": b"abc"})
    for place in range(1, len(data) - 1):
        assert codec.measure("f", data[:place] + b"0" + data[place + 1 :] + b"@00\r") == len(data)
    codec = codec_of("[{const: 40}, {data: d, size: rest}, {check: xor8, as: hex}, {const: CR}]")
    data = codec.encode("f", {"d": b"abc"})
    assert codec.measure("f", data[:-2] + b"?" + data[-1:]) == -1, "it may be part of the content"


def test_lost_ends() -> None:
    codec = codec_of("[{length: n, type: hex, size: 2, of: [d], range: 1..9}, {data: d, size: n}]", keys="max: 8")
    assert codec.measure("f", b"0G") == codec.LOST
    assert codec.measure("f", b"00") == codec.LOST
    assert codec.measure("f", b"07") == codec.LOST, "longer than max"
    assert codec.measure("f", b"06") == -6
    forgiving = codec_of("[{length: n, type: u8, of: [d], range: 1..2, refuse: 1}, {data: d, size: n}]")
    assert forgiving.measure("f", b"\x03") == -3, "to be refused when it is complete"
    table = codec_of("[{field: a, type: u8}, {data: d, size: 't[a]'}]", "tables: {t: {1: 2}}")
    assert table.measure("f", b"\x01") == -2
    assert table.measure("f", b"\x02") == table.LOST


def test_a_wrap_that_something_else_ends() -> None:
    codec = codec_of(
        "[{const: DLE STX}, {wrap: {escape: DLE}, of: [{data: d, size: rest}]}, {const: DLE ETX}, {check: sum8}]"
    )
    assert codec.measure("f", b"\x10\x02ab\x10") == -2
    assert codec.measure("f", b"\x10\x02ab\x10\x03") == -1
    assert codec.measure("f", b"\x10\x02ab\x10\x05") == codec.LOST, "as soon as it shows"
    fixed = codec_of(
        "[{const: DLE SOH}, {wrap: {escape: DLE}, of: [{field: a, type: u8}]}, {const: DLE}, {const: STX}, "
        "{field: b, type: u8}]"
    )
    assert fixed.measure("f", b"\x10\x01\x10\x10\x10\x02\x07") == 7
    assert fixed.measure("f", b"\x10\x01\x05\x10") == -2
    assert fixed.measure("f", b"\x10\x01\x05\x10\x05") == codec.LOST
    assert fixed.measure("f", b"\x10\x01\x05\x06") == codec.LOST
    refusing = codec_of(
        "[{const: DLE STX}, {wrap: {escape: DLE}, of: [{data: d, size: rest}]}, {const: DLE ETX, refuse: 3}]"
    )
    assert refusing.measure("f", b"\x10\x02ab\x10\x05") == 6, "to be refused"


def test_what_only_silence_ends() -> None:
    codec = codec_of("[{const: 01}, {data: d, size: rest}, {check: sum8}]", keys="max: 5")
    assert codec.measure("f", b"\x01") == -1
    assert codec.measure("f", b"\x01\x02") == codec.QUIET
    assert codec.measure("f", bytes([1, 2, 3, 4, 5])) == codec.QUIET
    assert codec.measure("f", bytes([1, 2, 3, 4, 5, 6])) == codec.LOST


def test_a_frame_that_is_too_long_is_given_up() -> None:
    codec = codec_of("[{const: 02}, {data: d, size: rest}, {const: 03}]", keys="max: 10")
    assert codec.measure("f", b"\x02" + bytes(8)) == -1
    assert codec.measure("f", b"\x02" + bytes(9)) == codec.LOST
    assert codec.measure("f", b"\x02" + bytes(9) + b"\x03") == codec.LOST


def test_a_frame_whose_values_make_it_too_long_is_given_up() -> None:
    """Also in the middle of a frame: a receiver that waits for 2 ** 62 bytes would never find another frame."""
    codec = codec_of(
        "[{count: n, type: u64, of: r}, {repeat: r, times: n, of: u16}, {field: k, type: u8}, {data: d, size: k}]"
    )
    calls_until_complete(codec, "f", codec.encode("f", {"r": [1, 2], "k": 2, "d": b"ab"}))
    assert codec.measure("f", bytes([0x40, *bytes(7), 0])) == codec.LOST


def test_delimited_bodies_end_at_the_first_byte_of_the_tail() -> None:
    codec = codec_of(
        "[{field: a, type: hex, size: 2}]",
        "groups: {g: {head: [{const: 02}, {field: k, type: ascii, size: 1}], delimited: yes, max: 30, "
        "tail: [{const: 03 04}, {check: sum8, as: hex, when: k == lower(k)}]}}",
        keys="group: g",
    )
    for key in "rR":
        calls_until_complete(codec, "f", codec.encode("f", {"k": key, "a": 7}))
    assert codec.measure("f", b"\x02R0\x03\x04") == 5, "also when the body is too short"
    assert codec.measure("f", b"\x02R0123456\x03\x04") == 11, "and when it is too long"
    assert codec.measure("f", b"\x02R" + b"0" * 40) == codec.LOST


INNER = (
    "groups: {g: {from: client}}",
    "frames:\n"
    "  one: {group: g, body: [{field: c, type: u8, is: 1}, {field: a, type: u16}]}\n"
    "  two: {group: g, body: [{field: c, type: u8, is: 2}, {length: n, type: u8, of: [d]}, {data: d, size: n}]}\n"
    "  any: {group: g, body: [{field: c, type: u8}, {data: d, size: rest}], refuse: 5}",
)


def test_inner_frames_give_the_length_of_the_outer_one() -> None:
    codec = codec_of("[{field: s, type: u8}, {inner: i, of: g}, {check: crc16-modbus, order: little}]", *INNER)
    for inner in ({"one": {"a": 3}}, {"two": {"d": b"abcd"}}):
        calls_until_complete(codec, "f", codec.encode("f", {"s": 1, "i": inner}))
    assert codec.measure("f", b"\x01\x07\x00\x00\x00") == codec.QUIET
    sized = codec_of("[{length: n, type: u8, of: [i]}, {inner: i, of: g, size: n}, {const: 03}]", *INNER)
    calls_until_complete(sized, "f", sized.encode("f", {"i": {"any": {"c": 9, "d": b"abc"}}}))


def test_no_more_is_wanted_than_a_frame_inside_takes_that_is_tried_later() -> None:
    """The eighth byte excludes the first candidate; the second candidate may be complete by then."""
    codec = codec_of(
        "[{inner: i, of: g}, {data: d, size: 6}]",
        "groups: {g: {from: client}}",
        "frames:\n  a: {group: g, body: [{field: k, type: u64, only: values, values: {1: one}}]}\n"
        "  b: {group: g, body: [{const: 02 10 03}]}",
    )
    data = codec.encode("f", {"i": {"b": {}}, "d": bytes(6)})
    assert codec.measure("f", data, 0, 7) == -2
    calls_until_complete(codec, "f", data)


def test_inner_frames_that_do_not_begin_here() -> None:
    codec = codec_of(
        "[{inner: i, of: g}, {const: 09}]",
        "groups: {g: {from: client}}",
        "frames:\n  a: {group: g, body: [{const: 01 02}]}\n"
        "  b: {group: g, body: [{const: 01 03}, {field: x, type: u8}]}",
    )
    assert codec.measure("f", b"\x02\x02") == 0
    assert codec.measure("f", b"\x01") == -2
    assert codec.measure("f", b"\x01\x02\x09") == 3
    assert codec.measure("f", b"\x01\x03\x00") == -1
    assert codec.measure("f", b"\x01\x04") == 0


def test_the_work_grows_with_the_size() -> None:
    """Bytes arrive one by one: `measure` is called rarely, and its search never starts anew."""
    codec = codec_of(f"[{{count: c, type: u8, of: r}}, {{repeat: r, times: c, of: [{SIZED}]}}]")
    data = codec.encode("f", {"r": [{"d": bytes(place % 5)} for place in range(200)]})
    assert calls_until_complete(codec, "f", data) < 40
    fixed = codec_of("[{length: n, type: u16, of: [d]}, {data: d, size: n}, {check: sum8}]")
    assert calls_until_complete(fixed, "f", fixed.encode("f", {"d": bytes(3000)})) <= 3


ENDED_BY_CONTENT = [name for name in shipped.PROTOCOLS if name not in ("standard", "modbus-rtu", "ge-rtu")]
"""Protocols with frames that end by content; all frames of the others end by silence."""


@cache
def made(name: str) -> tuple[Codec, FrameValues]:
    protocol = load_protocol(name)
    return compile_protocol(protocol), FrameValues(protocol)


@QUICK
@given(st.data())
@pytest.mark.parametrize("name", spread(ENDED_BY_CONTENT, 4))
def test_frames_of_shipped_definitions(name: str, data: st.DataObject) -> None:
    codec, strategies = made(name)
    frame = data.draw(st.sampled_from([name for name, one in codec.protocol.frames.items() if not one.inner]))
    values, ctx = data.draw(strategies.frame(frame))
    whole = codec.encode(frame, values, ctx)
    assume(codec.measure(frame, whole, 0, len(whole), ctx) != codec.QUIET)  # only silence ends it
    calls_until_complete(codec, frame, whole, ctx)
    fields, spans, fault = codec.trace(frame, whole, ctx)
    if fault is None:
        assert fields == codec.decode(frame, whole, ctx)
    else:
        assert fault.refuse is not None, "bytes of a frame that is always refused may fit another one's fault"
    covered = {place for _, first, last, _ in spans for place in range(first, last)}
    assert covered == set(range(len(whole))), "every byte belongs to a segment"
    cut = data.draw(st.integers(0, len(whole)))
    assert codec.measure(frame, whole[:cut], 0, cut, ctx) < 0 or cut in (0, len(whole))


def test_a_size_that_is_negative_without_any_field_fits_nothing() -> None:
    codec = codec_of(
        "[{const: 01}, {data: d, size: announced - 8}]",
        "state: {announced: {type: u16}}",
        keys="announces: {announced: 9}",
    )
    assert codec.measure("f", b"\x01\x02", 0, 2, {"announced": 9}) == 2
    assert codec.measure("f", b"\x01\x02", 0, 2, {"announced": 0}) == 0


@pytest.mark.parametrize("size", [8, 9, 30])
def test_a_long_run_of_one_byte_in_front_is_measured(size: int) -> None:
    codec = codec_of(f"[{{const: '{' '.join(['01'] * size)}'}}, {{field: a, type: u8}}]")
    data = b"\x01" * size + b"\x05"
    (frame,) = codec.frames
    assert calls_until_complete(codec, frame, data) >= 1
    assert codec.measure(frame, b"\x01\x02", 0, 2) == 0
