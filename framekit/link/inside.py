"""Frames that may stand in the middle of others: found and taken out before the outer frame is measured.

A byte-stuffed region may hold them anywhere; they begin with the escape byte and something that is neither a doubled
escape nor the region's end. It knows no protocol, only the segments of a frame.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

from framekit.definition.model.frames import fixed_size
from framekit.definition.model.segments import Const, Segment, Wrap
from framekit.link.frame_table import FrameInfo, FrameTable
from framekit.link.stream import Stream
from framekit.link.values import CODEC_ERRORS, Names

DONE = -1
"""The region has ended: there is nothing more to look for."""

NEAR = 512
"""So many bytes are searched at once for the beginning of a frame inside another."""


@dataclass(slots=True)
class InsideRule:
    """Which frames may stand in the region of which outer frame, and what comes before the region."""

    before: tuple[Segment, ...]
    escape: int
    frames: tuple[FrameInfo, ...]

    def region(self, buffer: bytes | bytearray, position: int, end: int) -> int | None:
        """Where the region begins; None when it is not there yet, or this is another frame."""
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


def plain_end(buffer: bytes | bytearray, position: int, end: int, escape: int) -> int | None:
    """Where doubled content ends: at the first escape byte that is not doubled; None when that is not there yet."""
    while True:
        found = buffer.find(escape, position, end)
        if found < 0 or found + 1 >= end:
            return None
        if buffer[found + 1] != escape:
            return found
        position = found + 2


class InsideFinder:
    """Looks through what is arriving for frames in the middle of others, every byte once.

    `places`: how far it has looked in each frame that may have begun at the present place. `holders`: the frames that
    may hold others. Up to the offset `_clear` of the stream, no frame inside begins that has not been taken out.
    """

    __slots__ = ("_clear", "_lost", "_marks", "_names", "_rules", "holders", "places")

    def __init__(self, table: FrameTable, names: Names, lost: int) -> None:
        self._names = names
        self._lost = lost
        self._rules, self._marks = table.once(rules_and_marks, table)
        self.holders = frozenset(self._rules)
        self.places: dict[str, int] = {}
        self._clear = 0

    def __bool__(self) -> bool:
        return bool(self._rules)

    def forget(self) -> None:
        """The place in the stream has changed."""
        if self.places:
            self.places.clear()

    def is_none_behind(self, stream: Stream) -> bool:
        """Whether behind the stream's position there is surely no frame that may stand inside another."""
        if self._marks is None:
            return False
        buffer, base = stream.buffer, stream.base
        if self._marks.search(buffer, max(stream.position, self._clear - base)) is not None:
            return False
        self._clear = base + len(buffer) - 1  # the last byte may begin one
        return True

    def is_none_in(self, outer: str, raw: bytes) -> bool:
        """Whether no frame may stand inside `outer`, or surely none does in its bytes `raw`."""
        return outer not in self.holders or (self._marks is not None and self._marks.search(raw) is None)

    def first_mark(self, buffer: bytes | bytearray, start: int, end: int) -> int:
        """Up to where there is surely no frame inside another, of the next bytes from `start` on, up to `end`."""
        if self._marks is None or self.places:
            return start
        end = min(end, start + NEAR)
        match = self._marks.search(buffer, start, end)
        return end if match is None else match.start()

    def end_for(self, outer: str, limit: int, base: int) -> int:
        """How far `outer` may be measured: not over what has not been looked through."""
        place = self.places.get(outer, DONE) if self.places else DONE
        return limit if place == DONE else min(limit, place - base)

    def find(self, stream: Stream, infos: tuple[FrameInfo, ...]) -> tuple[FrameInfo, int, int] | None:
        """The first frame inside one of `infos`, which begin at the stream's position, and its place."""
        for info in infos:
            rule = self._rules.get(info.name)
            if rule is not None and self.places.get(info.name, 0) != DONE:
                found = self._find(stream, info, rule)
                if found is not None:
                    return found
        return None

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
                return self._at(stream, outer, rule, found)
            start = found + 2

    def _has_begun(self, info: FrameInfo, stream: Stream, start: int) -> bool:
        """Whether what stands before the region, which begins at `start`, can be the beginning of this frame."""
        try:
            size = info.measure(stream.buffer, stream.position, start, self._names, 0)
        except CODEC_ERRORS:
            return False
        return size < 0 and size != self._lost

    def _at(self, stream: Stream, outer: str, rule: InsideRule, place: int) -> tuple[FrameInfo, int, int] | None:
        for info in rule.frames:
            length = info.measure(stream.buffer, place, len(stream.buffer), self._names, 0)
            if length > 0:
                return info, place, place + length
            if length < 0:
                return None
        self.places[outer] = DONE
        return None


def rules_and_marks(table: FrameTable) -> tuple[dict[str, InsideRule], re.Pattern[bytes] | None]:
    """What a finder looks for, the same for all receivers of a table."""
    rules = inside_rules(table)
    return rules, marks_of(rules.values())


def marks_of(rules: Iterable[InsideRule]) -> re.Pattern[bytes] | None:
    """Matches the first two bytes of every frame that may stand inside another; None if they are not constants."""
    starts = set()
    for info in (info for rule in rules for info in rule.frames):
        first = info.frame.segments[0]
        if not isinstance(first, Const) or first.when is not None or len(first.data) < 2:
            return None
        starts.add(re.escape(first.data[:2]))
    return re.compile(b"|".join(sorted(starts))) if starts else None


def inside_rules(table: FrameTable) -> dict[str, InsideRule]:
    """The outer frames that may hold others, by name. Frames whose region has no findable start are left out."""
    rules = {}
    for info in table.infos.values():
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


def _is_findable(segment: Segment) -> bool:
    if segment.when is not None:
        return False
    return fixed_size(segment) is not None or (isinstance(segment, Wrap) and segment.escape is not None)
