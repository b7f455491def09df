"""Frames that may stand in the middle of others: found and taken out before the outer frame is measured.

A byte-stuffed region may hold them anywhere; they begin with the escape byte and something that is neither a doubled
escape nor the region's end. Without stuffing they begin with a byte that the outer frame never holds, and
follow any of its bytes. The module knows no protocol, only the segments of a frame.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

from framekit.codec.errors import FrameError
from framekit.definition.model.frames import bytes_of, fixed_size
from framekit.definition.model.segments import Const, Segment, Wrap
from framekit.link.frame_table import FrameInfo, FrameTable
from framekit.link.stream import Stream
from framekit.link.values import CODEC_ERRORS, Names

DONE = -1
"""The region has ended; the search is over."""


@dataclass(slots=True)
class InsideRule:
    """The frames that may stand in the region of an outer frame, and the segments before the region."""

    before: tuple[Segment, ...]
    escape: int
    frames: tuple[FrameInfo, ...]

    def region(self, buffer: bytes | bytearray, position: int, end: int) -> int | None:
        """Return where the region begins; None when it is not there yet, or this is another frame."""
        for segment in self.before:
            if isinstance(segment, Const):
                size = len(segment.data)
                if buffer[position : min(position + size, end)] != segment.data:
                    return None
            elif (known := fixed_size(segment)) is not None:
                size = known
            else:
                stop = plain_end(buffer, position, end, self.escape)
                if stop is None:
                    return None
                size = stop - position
            position += size
            if position > end:
                return None
        return position


@dataclass(slots=True)
class OwnByteRule:
    """The frames that may follow any byte of an outer frame, by the byte that they begin with.

    `front`: the bytes that the outer frame may have at each of its first places, as far as these are certain.
    """

    begins: re.Pattern[bytes]
    frames: dict[int, tuple[FrameInfo, ...]]
    front: tuple[frozenset[int], ...]

    def fits(self, begun: bytes | bytearray) -> bool:
        """Return whether the outer frame may begin so."""
        return all(byte in allowed for byte, allowed in zip(begun, self.front, strict=False))


def plain_end(buffer: bytes | bytearray, position: int, end: int, escape: int) -> int | None:
    """Return where doubled content ends: at the first escape byte that is not doubled; None if it is not there yet."""
    while True:
        found = buffer.find(escape, position, end)
        if found < 0 or found + 1 >= end:
            return None
        if buffer[found + 1] != escape:
            return found
        position = found + 2


class InsideFinder:
    """Searches arriving bytes for frames in the middle of others, every byte once.

    `places`: how far it has looked in each frame that may have begun at the present place. `holders`: the frames that
    may hold others. Up to the offset `_clear` of the stream, no frame inside begins that has not been taken out.
    """

    __slots__ = ("_clear", "_lost", "_marks", "_names", "_offset", "_quiet", "_rules", "places")

    def __init__(self, table: FrameTable, names: Names, quiet: int, lost: int) -> None:
        self._names = names
        self._quiet = quiet
        self._lost = lost
        self._rules, self._marks = table.once(rules_and_marks, table)
        self.places: dict[str, int] = {}
        self._clear = 0
        self._offset = -1

    def __bool__(self) -> bool:
        return bool(self._rules)

    def move(self, offset: int) -> None:
        """Begin anew if the position is another stream offset than before."""
        if self._offset != offset:
            self._offset, self.places = offset, {}

    def is_partly(self, offset: int) -> bool:
        """Return whether a frame that begins at a stream offset has been searched in part."""
        return self._offset == offset and bool(self.places)

    def is_none_behind(self, stream: Stream) -> bool:
        """Return whether surely no frame that may stand inside another follows the stream's position."""
        if self._marks is None:
            return False
        buffer, base = stream.buffer, stream.base
        if self._marks.search(buffer, max(stream.position, self._clear - base)) is not None:
            return False
        self._clear = base + len(buffer) - 1  # the last byte may begin a frame
        return True

    def end_for(self, outer: str, limit: int, base: int) -> int:
        """Return how far `outer` may be measured: up to the bytes that have been searched."""
        place = self.places.get(outer, DONE) if self.places else DONE
        return limit if place == DONE else min(limit, place - base)

    def find(self, stream: Stream, infos: tuple[FrameInfo, ...], limit: int) -> tuple[FrameInfo, int, int] | None:
        """Return the first frame inside one of `infos`, which begin at the stream's position, and its place.

        They have to come whole before `limit`, where a pause is too long.
        """
        for info in infos:
            rule = self._rules.get(info.name)
            if rule is None or self.places.get(info.name, 0) == DONE:
                continue
            if isinstance(rule, OwnByteRule):
                found = self._find_byte(stream, info, rule, infos, limit)
            else:
                found = self._find(stream, info, rule)
            if found is not None:
                return found
        return None

    def _find_byte(
        self, stream: Stream, info: FrameInfo, rule: OwnByteRule, infos: tuple[FrameInfo, ...], limit: int
    ) -> tuple[FrameInfo, int, int] | None:
        """Return the frame inside that begins with a byte of its own, unless the outer frame ends before it."""
        place = self.places.get(info.name)
        start = stream.position + 1 if place is None else place - stream.base
        match = rule.begins.search(stream.buffer, start, limit)
        if match is None:
            self.places[info.name] = stream.base + max(start, limit)
            return None
        found = match.start()
        self.places[info.name] = stream.base + found
        has_begun = rule.fits(stream.buffer[stream.position : found]) and self._goes_on(info, stream, found)
        if not has_begun or any(self._ends(one, stream, found) for one in infos):
            self.places[info.name] = DONE
            return None
        return self._at(stream, info.name, rule.frames[stream.buffer[found]], found, limit)

    def _goes_on(self, info: FrameInfo, stream: Stream, end: int) -> bool:
        """Return whether a frame has begun at the stream's position and wants more than there is before `end`."""
        try:
            return self._quiet < info.measure(stream.buffer, stream.position, end, self._names, 0) < 0
        except CODEC_ERRORS:
            return False

    def _ends(self, info: FrameInfo, stream: Stream, end: int) -> bool:
        """Return whether a good frame that begins at the stream's position ends before `end`, or may by silence."""
        buffer, position = stream.buffer, stream.position
        try:
            size = info.measure(buffer, position, end, self._names, 0)
            if size > 0:
                info.decode(bytes(buffer[position : position + size]), self._names)
        except FrameError as error:
            return error.refuse is not None
        except CODEC_ERRORS:
            return False
        return size > 0 or size == self._quiet

    def _find(self, stream: Stream, info: FrameInfo, rule: InsideRule) -> tuple[FrameInfo, int, int] | None:
        end, outer = len(stream.buffer), info.name
        place = self.places.get(outer)
        start = rule.region(stream.buffer, stream.position, end) if place is None else place - stream.base
        if start is None or (place is None and not self._has_begun(info, stream, start)):
            return None
        while True:
            found = stream.buffer.find(rule.escape, start, end)
            if found < 0 or found + 1 >= end:
                self.places[outer] = stream.base + (end if found < 0 else found)
                return None
            if stream.buffer[found + 1] != rule.escape:
                self.places[outer] = stream.base + found
                return self._at(stream, outer, rule.frames, found, end)
            start = found + 2

    def _has_begun(self, info: FrameInfo, stream: Stream, start: int) -> bool:
        """Return whether the bytes before the region, which begins at `start`, can be the beginning of this frame."""
        try:
            size = info.measure(stream.buffer, stream.position, start, self._names, 0)
        except CODEC_ERRORS:
            return False
        return size < 0 and size != self._lost

    def _at(
        self, stream: Stream, outer: str, frames: tuple[FrameInfo, ...], place: int, limit: int
    ) -> tuple[FrameInfo, int, int] | None:
        for info in frames:
            length = info.measure(stream.buffer, place, limit, self._names, 0)
            if length > 0:
                return info, place, place + length
            if length < 0:
                return None
        self.places[outer] = DONE
        return None


Rules = dict[str, InsideRule | OwnByteRule]
"""The frames that may hold others, by name."""


def rules_and_marks(table: FrameTable) -> tuple[Rules, re.Pattern[bytes] | None]:
    """Return the rules of a finder, the same for all receivers of a table."""
    rules = inside_rules(table)
    return rules, marks_of(rules.values())


def marks_of(rules: Iterable[InsideRule | OwnByteRule]) -> re.Pattern[bytes] | None:
    """Return a pattern of the beginnings of all frames inside; None if constants do not determine them.

    A beginning is the first byte of a frame if the outer frame never holds it, else its first two bytes.
    """
    starts = set()
    for rule in rules:
        if isinstance(rule, OwnByteRule):
            starts |= {re.escape(bytes((byte,))) for byte in rule.frames}
            continue
        for info in rule.frames:
            first = info.frame.segments[0]
            if not isinstance(first, Const) or first.when is not None or len(first.data) < 2:
                return None
            starts.add(re.escape(first.data[:2]))
    return re.compile(b"|".join(sorted(starts)), re.DOTALL) if starts else None


def inside_rules(table: FrameTable) -> Rules:
    """Return the outer frames that may hold others, by name. Frames whose region has no findable start are left out."""
    rules: Rules = {}
    for info in table.infos.values():
        if info.frame.inside:
            rules[info.name] = own_byte_rule(info, tuple(table.infos[name] for name in info.frame.inside))
            continue
        before: list[Segment] = []
        for segment in info.frame.segments:
            if isinstance(segment, Wrap) and segment.inside and segment.escape is not None:
                frames = tuple(table.infos[name] for name in segment.inside)
                rules[info.name] = InsideRule(tuple(before), segment.escape, frames)
                break
            if not _is_findable(segment):
                break
            before.append(segment)
    return rules


def own_byte_rule(outer: FrameInfo, frames: tuple[FrameInfo, ...]) -> OwnByteRule:
    """Return the rule for frames that begin with bytes which the outer frame never holds."""
    front: list[frozenset[int]] = []
    for segment in outer.frame.segments:
        size = fixed_size(segment)
        if segment.when is not None or size is None:
            break
        if isinstance(segment, Const):
            front += (frozenset((byte,)) for byte in segment.data)
        else:
            front += (bytes_of((segment,)),) * size
    found: dict[int, tuple[FrameInfo, ...]] = {}
    for info in frames:
        if info.first is not None:
            found[info.first] = (*found.get(info.first, ()), info)
    return OwnByteRule(re.compile(b"[" + re.escape(bytes(found)) + b"]"), found, tuple(front))


def _is_findable(segment: Segment) -> bool:
    if segment.when is not None:
        return False
    return fixed_size(segment) is not None or (isinstance(segment, Wrap) and segment.escape is not None)
