"""Framing of an unknown line: hypotheses from the captured pieces, each tested on all bytes."""

from __future__ import annotations

from bisect import bisect_right
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import log2

from framekit.extras.guess.model import Evidence, Framing, HeardBytes, HeardFrame, LengthField, Order
from framekit.extras.guess.pieces import Cutting, PieceStream, joined, streams_of
from framekit.extras.guess.stuffing import StuffingError, find_stuffing, plain_frame

MOST_MARK = 2
"""Largest size of a mark (bytes)."""
LARGEST_OFFSET = 16
"""Number of offsets tried for a length field, if the sizes of pieces are known."""
STREAM_OFFSET = 8
"""Number of offsets tried for a length field, if it alone cuts the streams."""
USUAL_WIDTHS = {2: 0, 1: 1, 4: 2}
"""Preference among widths that fit equally: if the high byte is always 0, the captured bytes do not decide."""
LARGEST_PLUS = 40
"""Largest number of bytes that a length field may leave uncounted."""
LONGEST_FRAME = 4096
MOST_PIECES = 2000
"""Number of pieces from which hypotheses are made; all pieces are used to test them."""
MOST = 0.85
"""Least share of pieces that must have a property for a hypothesis."""
SURE = 8.0
"""Evidence (bits) from which a length field or a mark is certain."""


@dataclass(frozen=True, slots=True)
class CutLine:
    """Result of applying a framing to a line: the frames in order of time, and how well their ends match the ends of
    pieces.
    """

    framing: Framing
    frames: tuple[HeardFrame, ...]
    noise: int
    fit: float


def as_heard(chunks: Sequence[HeardBytes]) -> Cutting:
    """Return the pieces as captured, merged where no pause separates them."""
    return Cutting("heard", tuple(joined(chunks)))


def framings_of(chunks: Sequence[HeardBytes], cutting: Cutting) -> list[CutLine]:
    """Return possible framings, most likely first; the last takes the pieces as frames."""
    pieces, is_whole = cutting.pieces, cutting.kind == "whole"
    streams = streams_of(pieces, () if cutting.kind == "heard" else chunks)
    ordered = sorted(
        (stream.numbers[stream.heard_at(start)], piece) for stream in streams
        for start, piece in zip(stream.starts, stream.pieces, strict=True)
        if start not in stream.signals
    )  # fmt: skip
    texts = [piece for _, piece in ordered[:MOST_PIECES]] or [piece.data for piece in pieces[:MOST_PIECES]]
    seen, found = set[Framing](), list[CutLine]()
    for framing in _hypotheses(texts, streams):
        if framing not in seen:
            seen.add(framing)
            cut = cut_line(framing, streams, is_whole)
            if cut.fit >= ENOUGH:
                cut = _weighed(cut, texts, is_whole)
                if framing.kind != "length" or cut.fit >= ENOUGH_ALONE or cut.framing.evidence.chance > 0:
                    found.append(cut)
    found.sort(key=_rank, reverse=True)
    start, end = _common(texts)
    plain = Framing("pauses", start[:MOST_MARK], end[:MOST_MARK], evidence=Evidence(len(texts), len(texts)))
    lengths = {len(text) for text in texts}
    if len(lengths) == 1 and len(texts) > 2:
        plain = replace(plain, kind="fixed", fixed=lengths.pop())
    return [*found, cut_line(plain, streams)]


FEW = 3
"""Number of pieces below which shared bytes are weak evidence."""
COVERED = 0.85
ENOUGH = 0.7
"""Least share of bytes in frames, and of frame ends at ends of pieces, for a framing to be accepted: a few frames come
in two pieces, or two frames in one piece.
"""
ENOUGH_ALONE = 0.8
"""The same limit for a length field seen with a single size of pieces, which any constant matches."""
BY_CUTTING = 1.0
"""Evidence (bits) of marks or of a length field that cut a stream without pieces."""
_PREFERRED = {"marks": 2, "length": 1, "fixed": 0, "pauses": 0}


def _rank(cut: CutLine) -> tuple[float, ...]:
    framing = cut.framing
    return (
        framing.start == framing.end != b"" and framing.kind == "marks", framing.stuffing is not None,
        framing.evidence.chance >= SURE, _PREFERRED[framing.kind], round(cut.fit, 2), len(framing.end),
        -abs(len(framing.start) - 1), framing.evidence.chance,
    )  # fmt: skip


# ---- cutting ----------------------------------------------------------------------------------------------------


def cut_line(framing: Framing, streams: Sequence[PieceStream], is_whole: bool = False) -> CutLine:
    """Apply a framing to streams and return its frames.

    `is_whole`: the streams are not cut into pieces, and adjacent frames are consistent.
    """
    frames: list[tuple[int, int, HeardFrame]] = []
    covered = whole = bounds = hit = ends = hit_ends = 0
    for stream in streams:
        found = cut_stream(framing, stream)
        starts = {*stream.starts, len(stream.data)}
        for begin, end in found:
            piece = stream.heard_at(begin)
            frame = HeardFrame(stream.times[piece], stream.direction, stream.data[begin:end])
            frames.append((stream.numbers[piece], begin, frame))
        covered += sum(end - begin for begin, end in found)
        whole += len(stream.data)
        edges = {edge for pair in found for edge in pair}
        ending = starts | {begin for begin, _ in found} if is_whole else starts
        bounds += len(starts)
        hit += len(starts & edges)
        ends += len(found)
        begin_mark = framing.start
        hit_ends += sum(
            end in ending or (bool(begin_mark) and stream.data.startswith(begin_mark, end)) for _, end in found
        )
    frames.sort(key=lambda one: one[:2])
    fit = 0.0
    if ends and whole and covered >= COVERED * whole:
        fit = min(covered / whole, hit / bounds, hit_ends / ends)
    return CutLine(framing, tuple(one for _, _, one in frames), whole - covered, fit)


def cut_stream(framing: Framing, stream: PieceStream) -> list[tuple[int, int]]:
    """Return the begin and end of each frame in a stream; bytes between frames are noise."""
    if framing.kind == "pauses":
        return [(start, start + len(piece)) for start, piece in zip(stream.starts, stream.pieces, strict=True)]
    data, starts = stream.data, {*stream.starts, len(stream.data)}
    ordered, at_start = [*stream.starts, len(data)], 0
    found, at, mark = list[tuple[int, int]](), 0, framing.start
    shared = framing.kind == "marks" and len(mark) == 1 and mark == framing.end
    while at < len(data):
        if at in stream.signals:
            ends = bisect_right(stream.starts, at)
            end: int | None = stream.starts[ends] if ends < len(stream.starts) else len(data)
        else:
            end = _end_of(framing, data, at, starts)
        if end is not None:
            found.append((at, end))
            at = end
            if shared and at < len(data) and not data.startswith(mark, at):
                at -= 1
            continue
        while ordered[at_start] <= at:
            at_start += 1
        after = ordered[at_start]
        if mark:
            place = data.find(mark, at + 1)
            after = min(after, place) if place >= 0 else after
        at = after
    return found


def _end_of(framing: Framing, data: bytes, at: int, starts: set[int]) -> int | None:
    """Return the end of the frame that begins at `at`; None if no frame begins there."""
    if not data.startswith(framing.start, at):
        return None
    if framing.kind == "fixed":
        end = at + framing.fixed
    elif framing.kind == "length":
        assert framing.length is not None
        number = value_at(framing.length, data, at)
        if number is None:
            return None
        end = at + number * framing.length.unit + framing.length.plus
        if end < at + framing.length.end or end - at > LONGEST_FRAME:
            return None
    else:
        return _end_by_mark(framing, data, at, starts)
    if end > len(data) or (framing.end and data[end - len(framing.end) : end] != framing.end):
        return None
    return end if end in starts or not framing.start or data.startswith(framing.start, end) or framing.end else None


def _end_by_mark(framing: Framing, data: bytes, at: int, starts: set[int]) -> int | None:
    """Return the offset after the first end mark; without stuffing, prefer the first end mark before the begin of a
    piece or of another frame.
    """
    start, end = framing.start, framing.end
    first_end: int | None = None
    place = at + len(start)
    if start == end and data.startswith(end, place):
        return None  # the end mark of the previous frame, followed by the start mark of this frame
    stuffing = framing.stuffing
    while True:
        place = data.find(end, place)
        if place < 0 or place - at > LONGEST_FRAME:
            return first_end
        if stuffing is not None and stuffing.kind == "doubled":
            first = place
            while first > at + len(start) and data[first - 1] == stuffing.escape:
                first -= 1
            if (place - first) % 2:
                place += 1
                continue
        after = place + len(end) + framing.behind
        if after > len(data):
            return first_end
        if stuffing is not None or after in starts or (start and data.startswith(start, after)):
            return after
        first_end = after if first_end is None else first_end
        place += 1


def value_at(length: LengthField, data: bytes, at: int) -> int | None:
    """Return the number in the length field of a frame that begins at `at`; None if it is no number."""
    raw = data[at + length.offset : at + length.end]
    if len(raw) < length.size:
        return None
    if length.form == "decimal":
        return int(raw) if raw.isdigit() else None
    if length.form == "hex":
        try:
            raw = bytes.fromhex(raw.decode("ascii"))
        except ValueError:
            return None
        if len(raw) != length.width:
            return None
    return int.from_bytes(raw, length.order)


# ---- hypotheses -------------------------------------------------------------------------------------------------


def _common(texts: Sequence[bytes]) -> tuple[bytes, bytes]:
    """Return the bytes that most pieces begin with and the bytes that most pieces end with, at most four each."""

    def longest(ends: Sequence[bytes]) -> bytes:
        for size in range(4, 0, -1):
            some = Counter(end[:size] for end in ends if len(end) >= size)
            if some and some.most_common(1)[0][1] >= MOST * len(ends):
                return some.most_common(1)[0][0]
        return b""

    start, end = longest([text[:4] for text in texts]), longest([text[:-5:-1] for text in texts])[::-1]
    if len(texts) < FEW:  # bytes that a few pieces share are a mark only if they recur
        start = next((start[:size] for size in (2, 1) if _often(start[:size], texts)), b"")
        end = next((end[-size:] for size in (2, 1) if _often(end[-size:], texts)), b"")
    return start, end


def _often(mark: bytes, texts: Sequence[bytes]) -> bool:
    return bool(mark) and sum(text.count(mark) for text in texts) >= 2 * FEW


def _hypotheses(texts: Sequence[bytes], streams: Sequence[PieceStream]) -> Iterator[Framing]:
    start, end = _common(texts)
    starts = [start[:size] for size in range(min(MOST_MARK, len(start)), -1, -1)]
    ends = [end[len(end) - size :] for size in range(min(MOST_MARK, len(end)), 0, -1)]
    for last in ends:
        for first in starts:
            yield from _with_stuffing(Framing("marks", first, last), streams)
    yield from _codes_behind(texts, end, streams)
    for length in _lengths(texts):
        for last in (*ends, b""):
            for first in starts:
                if len(first) <= length.offset:
                    yield Framing("length", first, last, length=length)
    if len(texts) < 2 * len(streams) + 3 or max(map(len, texts)) > 300:
        for length in _lengths_of_stream(streams):
            for first in starts:
                if len(first) <= length.offset:
                    yield Framing("length", first, length=length)
    usual, often = Counter(map(len, texts)).most_common(1)[0]
    if often >= MOST * len(texts) and often < len(texts) and usual > 1:
        yield Framing("fixed", start[:MOST_MARK], fixed=usual)


def _codes_behind(texts: Sequence[bytes], end: bytes, streams: Sequence[PieceStream]) -> Iterator[Framing]:
    """Yield framings by marks that begin with one escape byte and have a check code after the end mark."""
    for code_size in (2, 1):
        bodies = [text[:-code_size] for text in texts if len(text) > code_size + 2 * MOST_MARK]
        if len(bodies) < FEW:
            continue
        first, last = _common(bodies)
        first, last = first[:MOST_MARK], last[-MOST_MARK:]
        if len(first) == len(last) == MOST_MARK and first[0] == last[0] and first != last != end[-MOST_MARK:]:
            found = [
                one for one in _with_stuffing(Framing("marks", first, last, behind=code_size), streams) if one.stuffing
            ]
            yield from found


def _with_stuffing(framing: Framing, streams: Sequence[PieceStream]) -> Iterator[Framing]:
    """Yield the framing with the stuffing that its content shows, if any, and without stuffing."""
    start, end = framing.start, framing.end
    if len(end) == 2 and len(start) == 2 and start[0] == end[0] and start != end:
        # a lone end mark may stand in the content as the second half of a doubled byte
        pieces = [piece for stream in streams for piece in stream.pieces]
    else:
        pieces = [stream.data[begin:last] for stream in streams for begin, last in cut_stream(framing, stream)]
    inner = [
        piece[len(start) : len(piece) - len(end)]
        for piece in (one[: len(one) - framing.behind] for one in pieces[:MOST_PIECES])
        if len(piece) > len(start) + len(end) and piece.startswith(start) and piece.endswith(end)
    ]
    found = find_stuffing(inner, start, end) if inner else None
    if found is not None:
        yield replace(framing, stuffing=found[0], evidence=found[1])
    yield framing


def _lengths(texts: Sequence[bytes]) -> Iterator[LengthField]:
    """Yield numbers in the head of most pieces that determine their sizes."""
    whole = [text for text in texts if len(text) > 2]
    if len({len(text) for text in whole}) < 2:
        return
    shortest = sorted(map(len, whole))[len(whole) // 5]  # a few pieces are parts of frames
    found: list[tuple[int, LengthField]] = []
    for length in _fields(min(LARGEST_OFFSET, shortest)):
        if length.end > shortest:
            continue
        rests = Counter[int]()
        for text in whole:
            value = value_at(length, text, 0)
            if value is not None:
                rests[len(text) - value * length.unit] += 1
        if not rests:
            continue
        plus, often = rests.most_common(1)[0]
        if often >= 0.6 * len(whole) and -4 <= plus <= LARGEST_PLUS:
            found.append((often, replace(length, plus=plus)))
    found.sort(key=lambda one: (-one[0], one[1].unit, _unusual(one[1]), one[1].offset))
    for _, length in found[:6]:
        yield length


def _unusual(length: LengthField) -> int:
    """Return the order of preference of a length field, smaller first; for decimal digits the wider is preferred."""
    return -length.width if length.form == "decimal" else USUAL_WIDTHS[length.width]


def _fields(offsets: int) -> Iterator[LengthField]:
    for offset in range(offsets):
        for width in (1, 2, 4):
            orders: tuple[Order, ...] = ("big",) if width == 1 else ("big", "little")
            for order in orders:
                for unit in (1, 2):
                    yield LengthField(offset, width, order, 0, unit)
        for width in (1, 2):
            yield LengthField(offset, width, "big", 0, form="hex")
        for width in (2, 3, 4):
            yield LengthField(offset, width, "big", 0, form="decimal")


def _lengths_of_stream(streams: Sequence[PieceStream]) -> Iterator[LengthField]:
    """Yield length fields that lead from frame to frame through streams whose pieces are weak evidence."""
    found: list[tuple[float, LengthField]] = []
    for length in _fields(STREAM_OFFSET):
        for plus in range(length.end - 4 if length.offset else length.end, length.end + 12):
            one = replace(length, plus=plus)
            worth = _worth(one, streams)
            if worth > 0:
                found.append((worth, one))
    found.sort(key=lambda one: (-one[0], _unusual(one[1])))
    for _, length in found[:4]:
        yield length


def _worth(length: LengthField, streams: Sequence[PieceStream]) -> float:
    """Return the share of constant heads of the frames that a length field finds; 0 if it does not lead to the end."""
    heads: list[bytes] = []
    empty = 0
    for stream in streams:
        at, data = 0, stream.data
        while at < len(data):
            value = value_at(length, data, at)
            if value is None or not length.end <= value * length.unit + length.plus <= LONGEST_FRAME:
                return 0.0
            heads.append(data[at : at + STREAM_OFFSET])
            empty += value == 0
            at += value * length.unit + length.plus
        if at != len(data):
            return 0.0
    if len(heads) < 3 or empty > 0.3 * len(heads):
        return 0.0  # an element that is often 0 is no length
    own = range(length.offset, length.end)
    alike = [
        place for place in range(STREAM_OFFSET)
        if place not in own
        and Counter(head[place : place + 1] for head in heads).most_common(1)[0][1] >= MOST * len(heads)
    ]  # fmt: skip
    return len(alike) * log2(1 + len(heads)) if alike else 0.0


def readings_of(length: LengthField, frames: Sequence[HeardFrame]) -> list[LengthField]:
    """Return other length fields on the same bytes that fit nearly all frames: without a high byte that is 0, or with
    it.
    """
    low = length.end - 1 if length.order == "big" else length.offset
    if length.form != "binary" or length.width > 2:
        return []
    narrow = replace(length, offset=low, width=1, order="big")
    before, after = replace(narrow, offset=low - 1, width=2), replace(narrow, width=2, order="little")
    found = [one for one in (narrow, before, after) if one != length and one.offset >= 0]
    return [one for one in found if _fitting(one, frames) >= 0.9 * len(frames)]


def _fitting(length: LengthField, frames: Sequence[HeardFrame]) -> int:
    """Return the number of frames whose size matches the length field."""
    return sum(_is_size(length, frame.data) for frame in frames)


def _is_size(length: LengthField, text: bytes) -> bool:
    value = value_at(length, text, 0)
    return value is not None and len(text) == value * length.unit + length.plus


def _told_apart(length: LengthField, frames: Sequence[HeardFrame]) -> LengthField:
    """Return the low byte alone as the length field if a high byte may precede it as well as follow it."""
    others = readings_of(length, frames)
    narrow = next((one for one in others if one.width == 1), None)
    if length.width != 2 or narrow is None or len(others) < 2:
        return length
    return narrow if _fitting(narrow, frames) >= _fitting(length, frames) else length


def _weighed(cut: CutLine, texts: Sequence[bytes], is_whole: bool) -> CutLine:
    """Return the result with the evidence for the framing: the number of frames it finds, and how unlikely that is by
    chance.

    If no pieces exist to test the framing against, its frames come from the hypothesis alone and are nearly no
    evidence.
    """
    framing, frames = cut.framing, cut.frames
    plain = []
    for frame in frames:
        try:
            plain.append(plain_frame(framing, frame.data))
        except StuffingError:
            continue
    chance = framing.evidence.chance
    if framing.kind == "length" and framing.length is not None:
        pieces = set(texts)
        own = frames if 2 * len(texts) < len(frames) else [one for one in frames if one.data in pieces]
        sizes = {len(frame.data) for frame in own}
        length = _told_apart(framing.length, frames)
        framing = replace(framing, length=length)
        columns = [{frame.data[place] for frame in frames} for place in range(length.offset, length.end)]
        moving = max(1, sum(len(values) > 1 for values in columns))
        chance = 8.0 * moving * (len(sizes) - 1) - 7 - 8 * (moving - 1)
    elif framing.kind == "marks":
        inside = sum(len(frame.data) - len(framing.start) - len(framing.end) for frame in frames)
        chance = max(chance, inside * log2(256 / 255) * len(framing.end))
        around = len(framing.start), len(framing.end)
        text = all(0x20 <= byte < 0x7F for one in frames for byte in one.data[around[0] : len(one.data) - around[1]])
        if inside and text and not 0x20 <= framing.end[-1] < 0x7F:
            chance += SURE
    chance = min(chance, BY_CUTTING) if is_whole else chance
    return replace(cut, framing=replace(framing, evidence=Evidence(len(plain), len(frames), chance)))
