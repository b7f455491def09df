"""Where segments stand: in the bytes of every shipped frame where it can be said, and nowhere where it cannot."""

from __future__ import annotations

import random
from typing import Any

import pytest
from link.sampled_frames import Frames, frames_of
from shipped import PROTOCOLS

from framekit.codec.errors import EncodeError, FrameError
from framekit.codec.samples import Sample
from framekit.definition.model.segments import Data, Field
from framekit.link.same_reply import SameReply, learn
from framekit.link.spans import Span
from framekit.link.values import FrameValue, plain

TELLING = bytes.fromhex("00 01 02 03 04 05 06 0A 0D 10 1B 20 30 3A 7F 80 FF")
"""Bytes that protocols give a meaning."""


def _spans(body: str, **fields: Any) -> list[tuple[int, int]] | None:
    frames = Frames(f"protocol: p\norder: big\nframes:\n  f: {{body: [{body}]}}\n")
    data = frames.codec.encode("f", fields, frames.scope)
    found = frames.spans("f", data)
    return None if found is None else [(span.start, span.end) for span in found]


def test_one_stands_behind_the_other() -> None:
    body = (
        "{const: 10 02}, {field: a, type: u16}, {length: n, type: u8, of: [d]}, {skip: 2}, {data: d, size: n}, "
        "{require: a > 0}, {bits: {b: 0-6, c: 7}, of: u8}, {check: crc16-modbus}"
    )
    assert _spans(body, a=1, d=b"abc", b=0, c=1) == [
        (0, 2), (2, 4), (4, 5), (5, 7), (7, 10), (10, 10), (10, 11), (11, 13),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("body", "fields"),
    [
        ("{field: a, type: u8}, {field: b, type: u8, when: a == 1}", {"a": 1, "b": 2}),
        ("{data: d, size: 2, convert: hex_to_ascii}", {"d": b"ab"}),
        ("{data: d, size: 2, swap: 2}", {"d": b"ab"}),
        ("{data: d, size: 4, pad: 20}", {"d": b"ab"}),
        ("{wrap: hex, of: [{data: d, size: 2}]}", {"d": b"ab"}),
        ("{wrap: {escape: 10}, of: [{data: d, size: 2}]}, {const: 10 03}", {"d": b"a\x10"}),
        ("{optional: [{field: a, type: u8}]}", {"a": 1}),
        ("{field: a, type: u8}, {choose: a, cases: {1: [{field: b, type: u8}]}}", {"a": 1, "b": 2}),
        ("{count: n, type: u8, of: l}, {repeat: l, times: n, of: u8}", {"l": [1, 2]}),
        ("{length: n, type: u8, of: [t]}, {field: t, type: ascii, size: n}", {"t": "abc"}),
    ],
)
def test_where_a_place_is_more_than_a_sum_of_sizes_it_is_not_said(body: str, fields: dict[str, Any]) -> None:
    assert _spans(body, **fields) is None


def test_a_frame_that_is_filled_up_has_no_places() -> None:
    frames = Frames("protocol: p\nframes:\n  f: {size: 8, body: [{field: a, type: u8}]}\n")
    assert frames.spans("f", frames.codec.encode("f", {"a": 1}, frames.scope)) is None


@pytest.mark.parametrize("name", PROTOCOLS)
def test_places_are_where_the_values_stand(name: str) -> None:
    """Another number there, and the frame read anew has just that."""
    frames = frames_of(name)
    for frame in frames.protocol.frames:
        for sample in frames.samples(frame):
            spans = frames.spans(frame, sample.data)
            for span in spans or ():
                if span.frame != frame or not isinstance(span.segment, (Data, Field)) or span.start == span.end:
                    continue
                assert sample.data[span.start : span.end] == _bytes_of(span, sample, frames)


def _bytes_of(span: Span, sample: Sample, frames: Frames) -> bytes:
    """What a value is on the wire; where that is not plain, what stands there anyway."""
    there = sample.data[span.start : span.end]
    value, segment = sample.read[str(span.segment.name)], span.segment
    if isinstance(segment, Data):
        return bytes(value)
    kind = segment.type
    if kind.kind != "int" or kind.order not in ("big", "little") or segment.plus or segment.unit or segment.zero_means:
        return there
    return int(value).to_bytes(span.end - span.start, "big" if kind.order == "big" else "little", signed=kind.signed)


# ---- what is learned from shipped frames ----------------------------------------------------------------------------


def _replies(whole: FrameValue) -> list[FrameValue]:
    return [whole, *(value for value in whole.fields.values() if type(value) is FrameValue)]


def _changing(frames: Frames, whole: FrameValue) -> list[tuple[str, ...]]:
    """Which of its fields may be given other values: none, or one that is neither computed nor out of a table."""
    parts = frames.protocol.frames[whole.frame].segments
    free = [part for part in parts if isinstance(part, Field) and not (part.is_ or part.values or part.constants)]
    return [(), *((part.name,) for part in free)]


class Learned:
    """What was learned from a sample of a frame that was sent and came back; `changing`: its field that is new."""

    def __init__(
        self, frames: Frames, sample: Sample, same: SameReply, whole: FrameValue, holder: str, field: str
    ) -> None:
        self.frames = frames
        self.sample = sample
        self.same = same
        self.whole = whole
        self.holder, self.field = holder, field

    def again(self, data: bytes, others: dict[str, Any]) -> bytes | None:
        """The frame with other data and other values; None where it has no such form."""
        values = plain(self.whole.fields)
        if self.holder:
            ((_, inner),) = values[self.holder].items()
            inner[self.field] = data
        else:
            values[self.field] = data
        try:
            return self.frames.codec.encode(self.whole.frame, {**values, **others}, self.frames.scope)
        except (EncodeError, FrameError):
            return None

    def agrees(self, raw: bytes, sent: bytes) -> None:
        """Where the bytes fit, the codec finds the same frame in them, but for the data and what was sent anew."""
        if not self.same.fits(raw, sent):
            return
        frames, frame = self.frames, self.whole.frame
        assert frames.table.infos[frame].measure(raw, 0, len(raw), frames.scope, 0) == len(raw)
        value = frames.value(frame, raw)
        assert value.refusal is None
        asked = frames.value(frame, sent)
        holder = value.fields[self.holder] if self.holder else value
        found = raw[self.same.start : self.same.end]
        assert holder.fields[self.field] == found
        told = self.same.value(found, raw, asked.fields)
        assert (told.frame, told.fields) == (holder.frame, holder.fields)
        assert told.raw == holder.raw


def _learned(frames: Frames, frame: str, sample: Sample) -> list[tuple[Learned, tuple[str, ...]]]:
    whole = frames.value(frame, sample.data)
    found = []
    for reply in _replies(whole):
        holder = next((name for name, value in whole.fields.items() if value is reply), "")
        for part in frames.protocol.frames[reply.frame].segments:
            for changing in _changing(frames, whole) if isinstance(part, Data) else []:
                same = learn(
                    frames.table.infos, frames.scope, (), whole, changing, whole, reply, str(part.name)
                )  # fmt: skip
                if same is not None:
                    found.append((Learned(frames, sample, same, whole, holder, str(part.name)), changing))
    return found


@pytest.mark.parametrize("name", PROTOCOLS)
def test_what_fits_is_what_the_codec_reads(name: str) -> None:
    frames, chance = frames_of(name), random.Random(name)
    for frame in frames.protocol.frames:
        for sample in frames.samples(frame):
            for learned, changing in _learned(frames, frame, sample):
                raw = sample.data
                assert learned.same.fits(raw, raw)
                learned.agrees(raw, raw)
                size = learned.same.end - learned.same.start
                for _ in range(6):
                    data = bytes(chance.choice(TELLING) for _ in range(size))
                    others = {name: chance.choice((0, 1, 2, 3, 9, 200)) for name in changing}
                    again = learned.again(data, others)
                    if again is not None:
                        learned.agrees(again, again)
                    damaged = bytearray(again or raw)
                    damaged[chance.randrange(len(damaged))] = chance.choice(TELLING)
                    learned.agrees(bytes(damaged), again or raw)
                    learned.agrees(bytes(damaged[:-1]), raw)


def test_something_is_learned_from_shipped_frames() -> None:
    frames = frames_of("modbus-rtu")
    found = [
        learned
        for frame in frames.protocol.frames
        for sample in frames.samples(frame)
        for learned, _ in _learned(frames, frame, sample)
    ]
    assert {learned.whole.frame for learned in found} >= {"reply_adu"}
