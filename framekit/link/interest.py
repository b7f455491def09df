"""Who is looked for at a place in the stream, prepared once for every set of frame names.

For each byte a frame may begin with: the expected candidates and the others, in the order of the rows; and which of
them are left when a second byte has told them apart.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from framekit.codec.python.choices import fixed_bytes
from framekit.definition.model.segments import Const
from framekit.link.frame_info import Ends, FrameInfo, Make, Take, Taken, by_extent
from framekit.link.frame_table import FrameTable
from framekit.link.inside import InsideFinder
from framekit.link.values import FrameValue

Level = tuple[FrameInfo, ...]


class Left:
    """The expected candidates that two bytes leave.

    `alone`: the only one; for that, what takes it, and what `make`s a value of it. `whole`: its bytes, if it is only
    those two. `ends`: what finds their ends, once that was asked for. `is_slow`: it has to be measured first. `sure`:
    every other candidate, the others included, begins with other constants than there are, so that it is surely none.
    `is_none`: nothing begins here; `is_plain`: surely only the one, with none inside.
    """

    __slots__ = ("alone", "ends", "infos", "is_none", "is_plain", "is_slow", "make", "sure", "take", "whole")

    def __init__(self, infos: Level, sure: bool, inside: InsideFinder | None, take: Take | None = None) -> None:
        self.infos = infos
        self.ends: Ends | None = None
        self.alone = infos[0] if len(infos) == 1 else None
        self.sure = sure
        self.is_none = sure and not infos
        self.is_plain = sure and len(infos) == 1 and inside is None
        self.is_slow = False
        self.whole: bytes | None = None
        self.take: Take = take_nothing
        self.make: Make = make_nothing
        if self.alone is not None and (inside is None or sure):
            info, self.make = self.alone, self.alone.make
            self.is_slow = take is None and info.take is None and info.constant is None
            if info.constant is not None:
                self.take = partial(take_constant, info.constant)
            else:
                self.take = take or info.take or take_slowly(info, None if inside is None else inside.search_in(info))

    def told_apart_at(self, place: int) -> Left:
        """Itself, which the byte at `place` and the first one leave."""
        constant = None if self.alone is None else self.alone.constant
        if constant is not None and self.make is not make_nothing and len(constant) == place + 1 <= 2:
            self.whole = constant
        return self


def take_nothing(data: bytes, begin: int, end: int, names: Mapping[str, Any]) -> None:
    """What takes where there is nobody, or more than one."""


def take_constant(constant: bytes, data: bytes, begin: int, end: int, names: Mapping[str, Any]) -> Taken:
    """What takes a frame that is nothing but these bytes."""
    return (constant, {}) if data.startswith(constant, begin) else None


def make_nothing(fields: dict[str, Any], raw: bytes, refusal: int | None) -> FrameValue:
    """What makes a value where nothing is taken."""
    raise NotImplementedError


NOT_LOOKED = Left((), False, None)
"""Instead of who is left, where nobody has looked yet."""


def take_slowly(info: FrameInfo, search: Callable[[bytes], Any] | None) -> Take:
    """What takes a frame that has to be measured first; it raises what decoding does. `search` finds others inside."""
    extent, decode, inner = info.extent, info.decode, info.inner if info.guesses else None

    def take(data: bytes, begin: int, end: int, names: Mapping[str, Any]) -> Taken:
        size = extent(data, begin, end, names)
        if size <= 0:
            return None
        raw = data[begin : begin + size]
        fields = decode(raw, names)
        is_unsure = (inner is not None and "unknown" in fields[inner]) or (search is not None and search(raw))
        return None if is_unsure else (raw, fields)

    return take


class Start:
    """What may begin with one byte: `at` is the place of the byte that tells the candidates apart (0: none does).

    `left`: what is left by each of its values.
    """

    __slots__ = ("at", "left")

    def __init__(self, at: int, left: Mapping[int, Left], others: Left) -> None:
        self.at = at
        self.left = [left.get(byte, others) for byte in range(256)]


class Interest:
    """The candidates for one pair of name lists. `starting`: what `start` has found, by the first byte.

    `every`: for those as well as the others, told apart together. `starts` matches such a byte where not any may be
    one; `stops` as well the symbol before a byte that belongs to it. `rows`: what takes many of the only one that is
    expected, and that one; None where there is no such thing.
    """

    __slots__ = (
        "_ends",
        "_found",
        "_inside",
        "_rest",
        "_starts",
        "_wanted",
        "every",
        "expected",
        "others",
        "rows",
        "starting",
        "starts",
        "stops",
    )

    def __init__(
        self,
        table: FrameTable,
        expected: tuple[str, ...],
        others: tuple[str, ...] = (),
        inside: InsideFinder | None = None,
        symbol: int | None = None,
    ) -> None:
        self._inside = inside
        self.expected = expected
        self.others = others
        self._wanted = _on_line(table, expected)
        self._rest = _on_line(table, tuple(name for name in others if name not in expected))
        self._found: dict[int, tuple[Level, Level]] = {}
        self._ends: dict[int, Ends] = {}
        self._starts: dict[tuple[Level, Level], Start] = {}
        self.starting: list[Start | None] = [None] * 256
        self.starts = self._start_pattern()
        self.stops = self.starts if symbol is None else self._start_pattern(symbol)
        only = self._wanted[0] if len(self._wanted) == 1 and inside is None else None
        self.every: Interest = self
        if self._rest:
            self.every = Interest(table, tuple(info.name for info in (*self._wanted, *self._rest)), (), inside, symbol)
        self.rows = None if only is None or only.rows is None else (only.rows, only)

    def at(self, byte: int) -> tuple[Level, Level]:
        """The candidates that may begin with `byte`."""
        found = self._found.get(byte)
        if found is None:
            found = (_beginning(self._wanted, byte), _beginning(self._rest, byte))
            self._found[byte] = found
        return found

    def ends(self, left: Left, byte: int) -> Ends:
        """What finds the ends of the expected candidates behind `byte`: those left, if that is sure."""
        if left.sure:
            if left.ends is None:
                left.ends = by_extent(left.infos)
            return left.ends
        found = self._ends.get(byte)
        if found is None:
            found = self._ends[byte] = by_extent(self.at(byte)[0])
        return found

    def start(self, byte: int) -> Start:
        """The candidates that may begin with `byte`, told apart by another one; for the same ones the same object."""
        levels = self.at(byte)
        found = self._starts.get(levels)
        if found is None:
            found = self._starts[levels] = self._told_apart(*levels)
        self.starting[byte] = found
        return found

    def left(self, buffer: bytearray | bytes, position: int) -> Left | None:
        """The expected candidates that no constant byte contradicts here; None where not enough is there to tell."""
        if position >= len(buffer):
            return None
        start = self.starting[buffer[position]] or self.start(buffer[position])
        place = position + start.at
        return start.left[buffer[place]] if place < len(buffer) else None

    def _told_apart(self, infos: Level, rest: Level) -> Start:
        """By the place with the fewest candidates left, whatever byte stands there.

        A single one is told apart by what stands inside it.
        """
        whoever = self._left(infos, not rest)
        best = Start(0, {}, whoever)
        if len(infos) == 1 and infos[0].together is not None:
            place, takes = infos[0].together
            by_take = {take: Left(infos, not rest, self._inside, take) for take in set(takes) if take}
            return Start(place, {byte: by_take[take] for byte, take in enumerate(takes) if take}, whoever)
        most = len(infos)
        allowed = [dict(fixed_bytes(info.frame.segments)) for info in infos]
        for place in sorted({place for one in allowed for place in one if place}):
            rows = [(info, one.get(place)) for info, one in zip(infos, allowed, strict=True)]
            values = {value for _, one in rows for value in one or ()}
            left = {value: tuple(info for info, one in rows if one is None or value in one) for value in values}
            others = tuple(info for info, one in rows if one is None)
            fewest = max(len(group) for group in (*left.values(), others))
            if fewest < most:
                every, most = (*infos, *rest), fewest
                by_value = {
                    value: self._left(group, _sure(every, group, place, {value}, False)).told_apart_at(place)
                    for value, group in left.items()
                }
                best = Start(place, by_value, self._left(others, _sure(every, others, place, values, True)))
        return best

    def _left(self, infos: Level, sure: bool) -> Left:
        return Left(infos, sure, self._inside)

    def _start_pattern(self, *more: int) -> re.Pattern[bytes] | None:
        """Matches a byte that some candidate begins with, or one `more`; None when any byte may begin one."""
        firsts = {*more, *(info.first for info in (*self._wanted, *self._rest))}
        known = bytes(sorted(first for first in firsts if first is not None))
        if len(known) < len(firsts):
            return None
        return re.compile(b"[" + re.escape(known) + b"]") if known else re.compile(rb"[^\x00-\xff]")


def _on_line(table: FrameTable, names: tuple[str, ...]) -> Level:
    """Each frame once; frames that only stand in others are never looked for."""
    return tuple(info for name in dict.fromkeys(names) if (info := table.infos[name]).on_line)


def _sure(every: Level, left: Level, place: int, values: set[int], none_of_them: bool) -> bool:
    """Whether the constants that all others begin with contradict a byte at `place`: one of `values`, or none of them.

    What measures frames compares these constants; the value of a field it does not compare.
    """
    for info in every:
        if info not in left:
            first = info.frame.segments[0] if info.frame.segments else None
            constant = first.data if isinstance(first, Const) and first.when is None else b""
            if len(constant) <= place or (constant[place] in values) is not none_of_them:
                return False
    return True


def _beginning(infos: Level, byte: int) -> Level:
    return tuple(info for info in infos if info.first is None or info.first == byte)
