"""Regions, check codes and inner frames in the construct codec."""

from __future__ import annotations

from typing import Any

import pytest
from construct_oracle import ConstructCodec
from small_protocol import small_codec

from framekit.codec.errors import EncodeError, FrameError


def fault(codec: ConstructCodec, data: bytes, frame: str = "f", ctx: dict[str, Any] | None = None) -> FrameError:
    with pytest.raises(FrameError) as caught:
        codec.decode(frame, data, ctx)
    return caught.value


# ---- wraps --------------------------------------------------------------------------------------------------


def test_hex_wraps_count_their_checks_in_binary() -> None:
    codec = small_codec(
        "[{text: ':'}, {wrap: hex, of: [{field: a, type: u8}, {data: d, size: rest}, "
        "{check: lrc8, over: a..here}]}, {const: CR LF}]"
    )
    data = b":1203E8" + b"03\r\n"
    assert codec.encode("f", {"a": 0x12, "d": b"\x03\xe8"}) == data
    assert codec.decode("f", data) == {"a": 0x12, "d": b"\x03\xe8"}
    assert codec.decode("f", data.lower()) == {"a": 0x12, "d": b"\x03\xe8"}
    assert fault(codec, b":1203E804\r\n").cause == "check"
    assert fault(codec, b":1203G803\r\n").cause == "digits"
    assert fault(codec, b":1203E80\r\n").cause == "digits"
    assert fault(codec, b":12\r\n").cause == "short"


def test_escape_wraps_end_at_the_first_single_escape() -> None:
    codec = small_codec(
        "[{const: DLE STX}, {wrap: {escape: DLE}, of: [{data: d, size: rest}], min: 1, max: 4}, {const: DLE ETX}]"
    )
    data = bytes.fromhex("10 02 41 10 10 42 10 03")
    assert codec.encode("f", {"d": b"A\x10B"}) == data
    assert codec.decode("f", data) == {"d": b"A\x10B"}
    assert fault(codec, bytes.fromhex("10 02 41 10 42 10 03")).cause == "constant"
    assert fault(codec, bytes.fromhex("10 02 10 03")).cause == "short"
    assert fault(codec, bytes.fromhex("10 02 41 41 41 41 41 10 03")).cause == "too_long"
    assert fault(codec, bytes.fromhex("10 02 41 10 10")).cause == "short"
    with pytest.raises(EncodeError):
        codec.encode("f", {"d": bytes(5)})


def test_escape_wraps_of_fixed_content_need_no_end_and_checks_may_span_wraps() -> None:
    codec = small_codec(
        "[{const: DLE ENQ}, {wrap: {escape: DLE}, of: [{field: a, type: u8}]}, {const: 55, name: c}, "
        "{check: sum8, over: [a, c]}]"
    )
    assert codec.encode("f", {"a": 0x10}) == bytes.fromhex("10 05 10 10 55 65")
    assert codec.decode("f", bytes.fromhex("10 05 10 10 55 65")) == {"a": 0x10}
    assert codec.decode("f", bytes.fromhex("10 05 11 55 66")) == {"a": 0x11}


def test_embedded_frames_are_passed_over() -> None:
    codec = small_codec(
        "[{const: DLE STX}, {wrap: {escape: DLE}, of: [{data: d, size: rest}], inside: [ack]}, {const: DLE ETX}]",
        "frames:\n  ack: {body: [{const: DLE ACK}]}",
    )
    assert codec.decode("f", bytes.fromhex("10 02 41 10 06 42 10 03")) == {"d": b"AB"}


# ---- checks -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("form", "code"),
    [
        ("", "83"),
        ("as: HEX", "38 33"),
        ("as: hex, case: lower", "38 33"),
        ("as: dec", "31 33 31"),
        ("as: nibbles", "38 33"),
    ],
)
def test_forms_of_check_codes(form: str, code: str) -> None:
    codec = small_codec(f"[{{data: d, size: 2}}, {{check: sum8{', ' if form else ''}{form}}}]")
    data = b"AB" + bytes.fromhex(code)
    assert codec.encode("f", {"d": b"AB"}) == data
    assert codec.decode("f", data) == {"d": b"AB"}
    assert fault(codec, b"AC" + bytes.fromhex(code)).cause == "check"


def test_a_check_may_stand_before_what_it_covers() -> None:
    codec = small_codec("[{check: crc16-modbus, over: [d], order: little}, {data: d, size: 9}]")
    data = bytes.fromhex("37 4B") + b"123456789"
    assert codec.encode("f", {"d": b"123456789"}) == data
    assert codec.decode("f", data) == {"d": b"123456789"}


def test_folds_and_parameters_of_methods() -> None:
    codec = small_codec(
        "[{data: d, size: 2}, {check: own}, {check: two}]",
        "checks: {own: {fold: 'rotl8(acc ^ byte, 1)', initial: 0}, two: {method: sum8, complement: twos}}",
    )
    encoded = codec.encode("f", {"d": b"\x01\x80"})
    assert encoded == bytes.fromhex("01 80 05 7A")
    assert codec.decode("f", encoded) == {"d": b"\x01\x80"}


def test_a_wrong_check_outweighs_other_faults_and_takes_the_refusal() -> None:
    codec = small_codec("[{field: x, type: u8, range: 1..5, refuse: 3}, {check: sum8}]")
    found = fault(codec, b"\x09\x09")
    assert (found.cause, found.refuse) == ("range", 3)
    found = fault(codec, b"\x09\x08")
    assert (found.cause, found.refuse) == ("check", None)
    unverified = small_codec("[{field: x, type: u8}, {check: sum8, verify: warn}]")
    assert unverified.decode("f", b"\x09\x08") == {"x": 9}


# ---- frames -------------------------------------------------------------------------------------------------


DELIMITED = """
groups:
  g: {delimited: yes, surplus: 0x12, head: [{const: ENQ}], tail: [{const: EOT}, {check: sum8}]}
"""


def test_delimited_bodies_have_an_end_whatever_is_in_them() -> None:
    codec = small_codec(
        "[{field: n, type: hex, size: 2}, {data: d, size: n, convert: hex_to_ascii, refuse: 5}]",
        DELIMITED,
        keys="group: g",
    )

    def sealed(data: bytes) -> bytes:
        return data + bytes((sum(data) & 0xFF,))

    assert codec.decode("f", sealed(b"\x0501AB\x04")) == {"n": 1, "d": b"\xab"}
    found = fault(codec, sealed(b"\x0501ABC\x04"))
    assert (found.cause, found.refuse, found.offset) == ("surplus", 0x12, 5)
    found = fault(codec, sealed(b"\x0502AB\x04"))
    assert (found.cause, found.refuse, found.fields) == ("short", 5, {"n": 2})
    assert fault(codec, sealed(b"\x0502AB\x04")[:-1] + b"\x00").cause == "check"
    assert fault(codec, b"\x0502AB").cause == "short"


def test_frames_of_fixed_size_are_filled() -> None:
    codec = small_codec(
        "[{field: x, type: u8}]", "groups: {g: {size: 5, fill: EE, tail: [{const: 55}]}}", keys="group: g"
    )
    assert codec.encode("f", {"x": 1}) == bytes.fromhex("01 EE EE EE 55")
    assert codec.decode("f", bytes.fromhex("01 00 00 00 55")) == {"x": 1}
    assert fault(codec, bytes.fromhex("01 00 00 55")).cause == "short"
    assert codec.frames["f"].sizeof() == 5


GROUPS = """
groups:
  inner: {from: client, head: [{field: code, type: u8}]}
frames:
  one: {group: inner, where: {code: [1, 9]}, body: [{field: a, type: u8, range: 0..9, refuse: 4}]}
  two: {group: inner, where: {code: 2}, body: [{data: d, size: rest}]}
  other: {group: inner, body: [], refuse: 7}
"""


def test_inner_frames_are_tried_in_order() -> None:
    codec = small_codec("[{inner: i, of: inner}, {check: sum8}]", GROUPS)
    assert codec.encode("f", {"i": {"one": {"a": 5}}}) == b"\x01\x05\x06"
    assert codec.encode("f", {"i": {"one": {"code": 9, "a": 5}}}) == b"\x09\x05\x0e"
    assert codec.decode("f", b"\x09\x05\x0e") == {"i": {"one": {"code": 9, "a": 5}}}
    assert codec.decode("f", b"\x02\x02") == {"i": {"two": {"code": 2, "d": b""}}}
    assert codec.decode("f", b"\x03\x03") == {"i": {"other": {"code": 3}}}
    assert codec.decode("f", b"\x03\x01\x04") == {"i": {"unknown": {"data": b"\x03\x01"}}}
    assert codec.encode("f", {"i": {"unknown": {"data": b"\x03\x01"}}}) == b"\x03\x01\x04"


def test_an_inner_frame_may_be_one_to_be_refused() -> None:
    codec = small_codec("[{inner: i, of: inner}, {check: sum8}]", GROUPS)
    found = fault(codec, b"\x01\x0a\x0b")
    assert (found.cause, found.refuse, found.offset) == ("range", 4, 1)
    assert found.fields == {"i": {"one": {"code": 1}}}
    assert fault(codec, b"\x01\x0a\x0c").refuse is None


def test_inner_values_are_checked_by_name() -> None:
    codec = small_codec("[{inner: i, of: inner}]", GROUPS)
    for values, field in [
        ({}, "i"),
        ({"i": {"three": {}}}, "i"),
        ({"i": {"one": {"a": 10}}}, "i.one.a"),
        ({"i": {"one": {"code": 2, "a": 1}}}, "i.one.code"),
        ({"i": {"one": {"a": 1}, "two": {}}}, "i"),
    ]:
        with pytest.raises(EncodeError) as caught:
            codec.encode("f", values)
        assert caught.value.field == field


def test_where_is_a_cause_of_its_own() -> None:
    codec = small_codec("[]", GROUPS, keys="group: inner, where: {code: [5, 6]}")
    assert codec.encode("f", {}) == b"\x05"
    assert codec.encode("f", {"code": 6}) == b"\x06"
    assert fault(codec, b"\x07").cause == "where"
    with pytest.raises(EncodeError):
        codec.encode("f", {"code": 7})


def test_replies_repeat_what_their_request_says() -> None:
    codec = small_codec(
        "[{field: seq, type: u8, default: 1}, {field: code, type: u8}]",
        "frames:\n  asked: {from: client, body: [{field: seq, type: u8}, {field: code, type: u8}]}",
        keys="from: server, echo: {seq: seq, code: request.code + 0x80}",
    )
    request = {"seq": 9, "code": 3}
    assert codec.encode("f", {}, {"request": request}) == b"\x09\x83"
    assert codec.encode("f", {"seq": 4}, {"request": request}) == b"\x04\x83"
    assert codec.encode("f", {"code": 1}) == b"\x01\x01"


def test_announced_sizes() -> None:
    codec = small_codec(
        "[{const: AA}, {data: d, size: left - 1}]",
        "state: {left: {scope: line, type: u16}}",
        "frames:\n  said: {announces: {left: n}, body: [{field: n, type: u8}]}",
    )
    assert codec.decode("f", b"\xaa\x01", {"left": 2}) == {"d": b"\x01"}
    assert codec.encode("f", {"d": b"\1\2\3"}) == b"\xaa\1\2\3"
    assert fault(codec, b"\xaa\x01").cause == "length"
    assert fault(codec, b"\xaa\x01", ctx={"left": 0}).cause == "length"
    with pytest.raises(EncodeError):
        codec.encode("f", {"d": b"\1\2\3"}, {"left": 2})
