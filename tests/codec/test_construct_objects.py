"""Frames as constructs inside other constructs: nesting, context, sizes, errors that construct understands."""

from __future__ import annotations

import construct
import pytest
from construct_oracle import FrameConstruct
from small_protocol import small_codec

from framekit.codec.errors import EncodeError, FrameError
from framekit.codec.evaluate import MissingName


def test_frames_nest_in_constructs_of_the_users() -> None:
    frame = small_codec("[{field: a, type: u8}, {data: d, size: rest}, {check: sum8}]").frames["f"]
    record = construct.Struct("envelope" / construct.Prefixed(construct.Int16ub, frame), "end" / construct.Const(b"!"))
    data = record.build({"envelope": {"a": 1, "d": b"xy"}})
    assert data == b"\x00\x04\x01xy\xf2!"
    assert record.parse(data).envelope == {"a": 1, "d": b"xy"}
    assert record.parse(data).envelope.d == b"xy"


def test_mismatches_are_mismatches_for_construct_too() -> None:
    frame = small_codec("[{const: AA}, {field: a, type: u8}]").frames["f"]
    either = construct.Select("frame" / frame, "bytes" / construct.GreedyBytes)
    assert either.parse(b"\xaa\x01") == {"a": 1}
    assert either.parse(b"\xab\x01") == b"\xab\x01"
    with pytest.raises(construct.ConstructError) as caught:
        frame.parse(b"\xab\x01")
    assert isinstance(caught.value, FrameError)
    assert "parsing" in str(caught.value.path)
    with pytest.raises(construct.ConstructError) as refused:
        frame.build({"a": 300})
    assert isinstance(refused.value, EncodeError)


def test_the_context_comes_as_keywords() -> None:
    codec = small_codec(
        "[{field: a, type: u8, build: level + len(buffer)}]", "params: {level: {type: number, default: 3}}"
    )
    frame = codec.frames["f"]
    assert frame.build({}, buffer=b"xy") == b"\x05"
    assert frame.build({}, buffer=b"xy", level=1) == b"\x03"
    nested = construct.Struct("f" / construct.FixedSized(1, frame))
    assert nested.build({"f": {}}, buffer=b"") == b"\x03"
    assert codec.encode("f", {}, {"buffer": b"", "level": 9}) == b"\x09"
    with pytest.raises(EncodeError, match="'a' stands on 'buffer'"):
        frame.build({})
    reading = small_codec("[{data: d, size: len(buffer)}]").frames["f"]
    with pytest.raises(MissingName, match="buffer"):
        reading.parse(b"12")


def test_sizes_that_never_vary_are_known() -> None:
    assert small_codec("[{const: AA}, {field: a, type: u32}, {check: sum8, as: hex}]").frames["f"].sizeof() == 7
    assert small_codec("[{repeat: all, times: 3, of: [{field: a, type: u16}]}]").frames["f"].sizeof() == 6
    with pytest.raises(construct.SizeofError):
        small_codec("[{data: d, size: rest}]").frames["f"].sizeof()
    with pytest.raises(construct.SizeofError):
        small_codec("[{field: n, type: u8}, {field: a, type: u8, when: n > 1}]").frames["f"].sizeof()


def test_frames_keep_their_name_and_documentation() -> None:
    frame = small_codec("[{const: AA}]", keys="doc: says nothing").frames["f"]
    assert isinstance(frame, FrameConstruct)
    assert (frame.name, frame.docs) == ("f", "says nothing")


def test_tables_with_ranges_and_parameters_that_stand_on_others() -> None:
    codec = small_codec(
        "[{field: n, type: u16}, {field: k, type: u8, is: 'kinds[n]'}, {require: n != other}]",
        "tables: {kinds: {1: 7, 100-199: 8}}",
        "params: {other: {type: number, default: 150}}",
    )
    assert codec.encode("f", {"n": 1}) == b"\x00\x01\x07"
    assert codec.encode("f", {"n": 120}) == b"\x00\x78\x08"
    with pytest.raises(EncodeError):
        codec.encode("f", {"n": 99})
    with pytest.raises(EncodeError):
        codec.encode("f", {"n": 150})


def test_layouts_are_constructs_as_well() -> None:
    codec = small_codec(
        "[{field: a, type: u8}]",
        "layouts: {point: [{field: x, type: u8}, {data: rest, size: rest}]}",
        "areas: {P: {unit: byte, size: 4, layout: point}}",
    )
    assert codec.encode_layout("point", {"x": 1, "rest": b"ab"}) == b"\x01ab"
    assert codec.decode_layout("point", b"\x01ab") == {"x": 1, "rest": b"ab"}
    assert codec.layouts["point"].parse(b"\x01").rest == b""


def test_an_unknown_frame_is_a_key_error() -> None:
    codec = small_codec("[{const: AA}]")
    with pytest.raises(KeyError):
        codec.decode("g", b"\xaa")


def test_a_rest_may_end_at_the_first_place_where_everything_after_it_fits() -> None:
    codec = small_codec("[{data: d, size: rest}, {const: 3B}, {field: t, type: ascii, end: 00}, {check: sum8}]")
    data = codec.encode("f", {"d": b"a;b", "t": "c;d"})
    assert codec.decode("f", data) == {"d": b"a", "t": "b;c;d"}
    with pytest.raises(FrameError):
        codec.decode("f", data[:-1] + b"\x00")


def test_values_that_need_each_other_in_a_circle_are_missing() -> None:
    codec = small_codec("[{field: a, type: u8, build: b}, {field: b, type: u8, build: a}]")
    assert codec.encode("f", {"a": 1}) == b"\x01\x01"
    with pytest.raises(EncodeError, match="missing"):
        codec.encode("f", {})
