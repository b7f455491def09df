# ruff: noqa: E501 - definitions in YAML
"""Frames that interrupt others, starting with a byte that those cannot contain, for any cuts of the stream."""

from __future__ import annotations

from random import Random
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from link.link_world import MS, cut_at, feed, receiver_of

from framekit.link.arrivals import BadFrame, FrameArrived

STREAM = """
protocol: stream
frames:
  note:    {inside: [tick, mark], body: [{field: status, type: u8, range: 0x90..0x9F}, {field: key, type: u8, range: 0..0x7F}, {field: speed, type: u8, range: 0..0x7F}]}
  text:    {inside: [tick, mark], body: [{const: F0}, {data: d, size: rest, never: [F7, F8, F4]}, {const: F7}]}
  counted: {inside: tick, body: [{const: B0 01}, {length: n, type: u8, of: [d], range: 0..9}, {data: d, size: n, never: F8}, {check: sum8, as: hex}]}
  twin:    {body: [{const: B0 02}, {data: d, size: 2}]}
  loose:   {body: [{const: C0}, {data: d, size: 2}]}
  tight:   {inside: tick, body: [{const: C0}, {field: a, type: HEX, size: 2}, {field: b, type: HEX, size: 2}]}
  tick:    {body: [{const: F8}]}
  mark:    {body: [{const: F4}, {const: 01}]}
receiver: {resync: %s, gap: 50 ms}
"""
NAMES = ("note", "text", "counted", "twin", "loose", "tight", "tick", "mark")
GOOD = [b"\x90\x3c\x40", b"\xf0abc\xf7", b"\xf0\xf7", b"\xb0\x01\x02ab76", b"\xb0\x02ab", b"\xc012", b"\xc01234"]
WAYS = ["next_start", "after_frame", "after_quiet", "never"]
PIECES = [
    *GOOD, b"\xf8", b"\xf8", b"\xf4\x01", b"\xf4", b"\x01", b"\xf0", b"\xb0", b"\x90", b"\xc0", b"\xb0\x01\x00", b"3", b"\xf7", b"\xff"
]  # fmt: skip


def kinds(found: list[tuple[Any, ...]]) -> list[Any]:
    return [item[1] if item[0] == "frame" else item[0] for item in found]


def names(found: list[tuple[Any, ...]]) -> list[Any]:
    """Return the events, noise as its bytes only: the grouping of noise depends on the times of reading."""
    return [item for item in found if item[0] != "noise"]


def text(way: str = "next_start") -> str:
    return STREAM % way


@pytest.mark.parametrize("place", range(1, 7))
def test_a_frame_may_be_interrupted_behind_any_of_its_bytes(place: int) -> None:
    whole = GOOD[3]
    data = whole[:place] + b"\xf8" + whole[place:]
    for pieces in ([data], [data[at : at + 1] for at in range(len(data))]):
        found = feed(receiver_of(text()), pieces, NAMES)
        assert kinds(found) == ["tick", "counted"]
        assert b"".join(pieces) == data


def test_what_interrupts_is_handed_over_at_once_and_counts_in_nothing() -> None:
    receiver = receiver_of(text())
    receiver.append(b"\xf0ab\xf8", 0)
    inner = receiver.next(NAMES)
    assert isinstance(inner, FrameArrived) and (inner.value.frame, inner.offset) == ("tick", 3)
    receiver.append(b"\xf4", MS)
    assert receiver.next(NAMES) is None
    receiver.append(b"\x01c\xf7\x90", MS)
    mark, outer = receiver.next(NAMES), receiver.next(NAMES)
    assert isinstance(mark, FrameArrived) and mark.value.frame == "mark"
    assert isinstance(outer, FrameArrived) and (outer.value.frame, outer.raw) == ("text", b"\xf0abc\xf7")
    assert outer.value.fields["d"] == b"abc"


def test_between_frames_it_is_a_frame_as_any_other() -> None:
    data = b"\xf8" + GOOD[0] + b"\xf8" + GOOD[1] + b"\xf8\xf8"
    assert kinds(feed(receiver_of(text()), [data], NAMES)) == ["tick", "note", "tick", "text", "tick", "tick"]


def test_a_frame_that_may_not_be_interrupted_keeps_the_byte() -> None:
    assert kinds(feed(receiver_of(text()), [b"\xb0\x02\xf8\xf8"], NAMES)) == ["twin"]
    assert kinds(feed(receiver_of(text()), [b"\xc0\xf8\xf8"], ("loose", "tick"))) == ["loose"]


def test_another_frame_that_ends_before_it_comes_first() -> None:
    for pieces in ([b"\xc012\xf834"], [b"\xc0", b"1", b"2", b"\xf8", b"3", b"4"]):
        assert kinds(feed(receiver_of(text()), pieces, NAMES))[:2] == ["loose", "tick"]


def test_two_bytes_that_begin_as_what_interrupts_and_are_not_break_the_frame() -> None:
    for pieces in ([b"\xf0a\xf4\x02b\xf7"], [b"\xf0", b"a", b"\xf4", b"\x02", b"b", b"\xf7"]):
        found = feed(receiver_of(text()), pieces, NAMES)
        assert "text" not in kinds(found) and kinds(found)[0] == "bad"


def test_a_pause_that_is_too_long_ends_what_was_interrupted() -> None:
    receiver = receiver_of(text())
    receiver.append(b"\xf0a", 0)
    assert receiver.next(NAMES) is None
    receiver.append(b"\xf8", 500 * MS)
    found = receiver.arrivals(NAMES)
    assert isinstance(found[0], BadFrame) and found[0].cause == "cut"
    assert isinstance(found[-1], FrameArrived) and found[-1].value.frame == "tick"


@given(st.lists(st.sampled_from(PIECES), max_size=14), st.lists(st.integers(0, 200), max_size=9), st.sampled_from(WAYS))
def test_cutting_changes_nothing(parts: list[bytes], places: list[int], way: str) -> None:
    data = b"".join(parts)
    whole = feed(receiver_of(text(way)), [data], NAMES)
    assert names(feed(receiver_of(text(way)), cut_at(data, places), NAMES)) == names(whole)
    assert names(feed(receiver_of(text(way)), [data[at : at + 1] for at in range(len(data))], NAMES)) == names(whole)


@pytest.mark.parametrize("seed", range(40))
def test_frames_come_whole_out_of_a_stream_with_what_interrupts_everywhere(seed: int) -> None:
    random = Random(seed)
    sent: list[bytes] = [random.choice(GOOD[:4]) for _ in range(12)]
    wire, ticks = bytearray(), 0
    for frame in sent:
        for byte in frame:
            wire.append(byte)
            while random.random() < 0.3:
                wire.append(0xF8)
                ticks += 1
    places = [random.randrange(len(wire)) for _ in range(random.randrange(9))]
    found = feed(receiver_of(text()), cut_at(bytes(wire), places), NAMES)
    assert [item[0] for item in found] == ["frame"] * (len(sent) + ticks)
    assert kinds(found).count("tick") == ticks
