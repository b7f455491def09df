"""Frames sent again with one number patched in: the bytes have to be those that the codec would have made."""

from __future__ import annotations

import random
from typing import Any

import pytest
from link.made_up_reads import ASKED, READS, Pair, changed, with_values
from link.sampled_frames import Frames, frames_of
from shipped import PROTOCOLS

from framekit.codec.codec import compile_protocol
from framekit.codec.errors import EncodeError
from framekit.definition.load import load_protocol_text
from framekit.definition.model.segments import Field
from framekit.link.frame_table import FrameTable
from framekit.link.patching import Patch, patch_of
from framekit.link.scope import Scope

EDGES = (0, 1, 0x0D, 0x7F, 0x80, 0xFF, 0x100, 0xFFFF, 0x10000, 0xFFFFFFFF, 1 << 32, (1 << 64) - 1, 1 << 64, -1)


def _patch(body: str, name: str = "tag", **fields: Any) -> Patch | None:
    """The way for a frame of these segments, once it has been sent with these values."""
    text = f"protocol: p\norder: big\nframes:\n  f: {{body: [{body}]}}\n"
    protocol = load_protocol_text(text, "p")
    table = FrameTable(protocol, compile_protocol(protocol))
    scope = Scope(protocol)
    value = table.made("f", {"tag": 1, **fields}, scope)
    table.encode(value, scope)
    return patch_of(value, name, table.infos)


@pytest.mark.parametrize(
    ("segment", "value", "wanted"),
    [
        ("{field: tag, type: u8}", 0xFE, "0A FE 0B"),
        ("{field: tag, type: u16}", 0x1234, "0A 1234 0B"),
        ("{field: tag, type: u16, order: little}", 0x1234, "0A 3412 0B"),
        ("{field: tag, type: u32}", 0x12345678, "0A 12345678 0B"),
        ("{field: tag, type: u32, order: little}", 0x12345678, "0A 78563412 0B"),
    ],
)
def test_the_number_stands_where_and_how_it_stood(segment: str, value: int, wanted: str) -> None:
    patch = _patch(f"{{const: 0A}}, {segment}, {{const: 0B}}")
    assert patch is not None
    assert patch(value) == bytes.fromhex(wanted)


@pytest.mark.parametrize("value", [-1, 0x10000, 1.5, "1", None, b"\0\1"])
def test_what_is_no_such_number_is_looked_at_with_care(value: object) -> None:
    patch = _patch("{field: tag, type: u16}")
    assert patch is not None and patch(value) is None


@pytest.mark.parametrize(
    ("body", "fields"),
    [
        ("{field: tag, type: u16, range: 0..9}", {}),
        ("{field: tag, type: u16, values: {1: one, 2: two}}", {}),
        ("{field: tag, type: u16, plus: 1}", {}),
        ("{field: tag, type: i16}", {}),
        ("{field: tag, type: hex, size: 4}", {}),
        ("{field: tag, type: bcd, size: 2}", {}),
        ("{field: tag, type: u16, is: 1}", {}),
        ("{bits: {tag: 0-6, more: 7}, of: u8}", {"more": 0}),
        ("{field: tag, type: u8}, {require: tag < 9}", {}),
        ("{field: tag, type: u8}, {value: twice, read: tag * 2}", {}),
        ("{field: tag, type: u8}, {field: low, type: u8, is: tag & 15}", {}),
        ("{field: tag, type: u8}, {field: more, type: u8, when: tag == 1}", {"more": 4}),
        ("{field: tag, type: u8}, {data: more, size: tag}", {"more": b"x"}),
        ("{field: other, type: u8}, {field: tag, type: u8}, {field: more, type: u8, when: other == 1}", {"other": 0}),
        ("{field: tag, type: u8}, {check: sum8}", {}),
        ("{field: tag, type: u8}, {check: sum8}, {const: 03}", {}),
        ("{wrap: hex, of: [{field: tag, type: u8}]}", {}),
        ("{wrap: {escape: 10}, of: [{field: tag, type: u8}]}, {const: 10 03}", {}),
        ("{optional: [{field: tag, type: u8}]}", {}),
    ],
)
def test_where_more_may_be_different_there_is_no_such_way(body: str, fields: dict[str, Any]) -> None:
    try:
        assert _patch(body, **fields) is None
    except ValueError as error:
        pytest.fail(f"the protocol is not one: {error}")


def _fields(frames: Frames, frame: str) -> list[str]:
    return [segment.name for segment in frames.protocol.frames[frame].segments if isinstance(segment, Field)]


@pytest.mark.parametrize("name", PROTOCOLS)
def test_the_bytes_are_those_of_the_codec(name: str) -> None:
    frames, numbers = frames_of(name), random.Random(name)
    for frame in frames.protocol.frames:
        for sample in frames.samples(frame):
            sent = frames.value(frame, sample.data)
            for field in _fields(frames, frame):
                patch = patch_of(sent, field, frames.table.infos)
                if patch is None:
                    continue
                assert patch(sample.read[field]) == sample.data
                for value in (*EDGES, numbers.getrandbits(16)):
                    _is_as_encoded(frames, frame, {**sample.values, field: value}, patch(value))


def _is_as_encoded(frames: Frames, frame: str, values: dict[str, Any], patched: bytes | None) -> None:
    if patched is None:
        return
    try:
        assert patched == frames.codec.encode(frame, values, frames.scope)
    except EncodeError as error:
        pytest.fail(f"{frame} {values} cannot be sent: {error}")


def test_some_shipped_requests_have_it() -> None:
    frames = frames_of("modbus-tcp")
    sent = frames.value("request_adu", frames.samples("request_adu")[0].data)
    assert patch_of(sent, "transaction", frames.table.infos) is not None
    assert patch_of(sent, "length", frames.table.infos) is None, "a length is what it is"


# ---- in the short way -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "changes",
    [
        [],
        [("number: {type: u16}", "number: {type: u16, initial: 0xFFFC}")],
        [("number: {type: u16}", "number: {type: flag}"), ("number + 1", "not number")],
        [(ASKED, f"{ASKED}, {{field: low, type: u8, is: tag & 3}}")],
        [(ASKED, f"{ASKED}, {{check: sum8}}")],
    ],
    ids=["as it is", "that goes round", "that is a flag", "named twice", "with a check code"],
)
def test_requests_by_both_ways_are_the_same(changes: list[tuple[str, str]]) -> None:
    pair = Pair(changed(*changes, text=READS))
    assert pair.read(*[with_values()] * 8) == [True] * 8


@pytest.mark.parametrize("build", ['"number % 200"', "clock.second", '"1 if now > 7 us else 0"', "late"])
@pytest.mark.parametrize("inside", [False, True], ids=["beside it", "in a frame inside"])
def test_what_else_is_another_value_every_time_is_worked_out(build: str, inside: bool) -> None:
    more = f"{{field: more, type: u8, build: {build}}}"
    added = [(ASKED, f"{ASKED}, {more}")]
    if inside:
        added = [
            (ASKED, f"{ASKED}, {{inner: mark, of: [stamp]}}"),
            ("pdu: request}}", "pdu: request, mark: {stamp: {}}}}"),
            ("  no:  ", f"  stamp: {{from: client, body: [{more}]}}\n  no:  "),
        ]
    pair = Pair(changed(("params: {", 'params: {late: {type: number, is: "number % 100"}, '), *added))
    assert pair.read(*[with_values()] * 5) == [True] * 5
    assert pair.request is not None, "there is a short way"


@pytest.mark.parametrize(
    "limit", [ASKED.replace("type: u16}", "type: u16, range: 0..4}"), f"{ASKED}, {{require: tag < 5}}"]
)
def test_a_number_that_cannot_be_sent_is_none_by_either_way(limit: str) -> None:
    pair = Pair(changed((ASKED, limit)))
    assert pair.read(*[with_values()] * 4) == [True] * 4
    assert pair.read(lambda asked: b"", lambda asked: b"") == [False, False]
    assert {one.outcome for one in pair.short.results[-2:]} == {"expression"}
