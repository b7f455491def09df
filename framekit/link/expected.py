"""Which frames are expected at a place in the stream, prepared once for every set of frame names.

For each byte a frame may begin with: the expected candidates and the others, in the order of the rows; and which of
them are left when a second byte has told them apart.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

from framekit.codec.python.choices import fixed_bytes
from framekit.definition.model.segments import Const
from framekit.link.frame_table import Ends, FrameInfo, FrameTable, by_extent

Level = tuple[FrameInfo, ...]


class Left:
    """The expected candidates that two bytes leave.

    `alone`: the only one. `sure`: every other candidate, the others included, begins with other constants than there
    are, so that it is surely none. `ends`: what finds their ends, once that was asked for. `names`: theirs.
    """

    __slots__ = ("alone", "ends", "infos", "names", "sure")

    def __init__(self, infos: Level, sure: bool) -> None:
        self.infos = infos
        self.sure = sure
        self.names = tuple(info.name for info in infos)
        self.alone = infos[0] if len(infos) == 1 else None
        self.ends: Ends | None = None


class Start:
    """What may begin with one byte: `at` is the place of the byte that tells the candidates apart (0: none does).

    `left`: what is left by each of its values.
    """

    __slots__ = ("at", "left")

    def __init__(self, at: int, left: Mapping[int, Left], others: Left) -> None:
        self.at = at
        self.left = [left.get(byte, others) for byte in range(256)]


class ExpectedFrames:
    """The candidates for one pair of name lists. `starting`: what `start` has found, by the first byte.

    `every`: for those as well as the others, told apart together. `starts` matches a byte that may begin a frame; None
    where any byte may; `stops` as well the symbol before a byte that belongs to it.
    """

    __slots__ = (
        "_found", "_rest", "_starts", "_wanted", "every", "expected", "others", "starting", "starts", "stops"
    )  # fmt: skip

    def __init__(
        self, table: FrameTable, expected: tuple[str, ...], others: tuple[str, ...] = (), symbol: int | None = None
    ) -> None:
        self.expected = expected
        self.others = others
        self._wanted = _on_line(table, expected)
        self._rest = _on_line(table, tuple(name for name in others if name not in expected))
        self._found: dict[int, tuple[Level, Level]] = {}
        self._starts: dict[tuple[Level, Level], Start] = {}
        self.starting: list[Start | None] = [None] * 256
        self.starts = self._start_pattern()
        self.stops = self.starts if symbol is None else self._start_pattern(symbol)
        self.every: ExpectedFrames = self
        if self._rest:
            self.every = ExpectedFrames(table, tuple(info.name for info in (*self._wanted, *self._rest)))

    def at(self, byte: int) -> tuple[Level, Level]:
        """The candidates that may begin with `byte`."""
        found = self._found.get(byte)
        if found is None:
            found = (_beginning(self._wanted, byte), _beginning(self._rest, byte))
            self._found[byte] = found
        return found

    def levels(self, buffer: bytes | bytearray, place: int, end: int) -> tuple[Level, ...]:
        """The candidates that may begin at `place`, without those that the byte before `end` excludes that tells."""
        start = self.starting[buffer[place]] or self.start(buffer[place])
        at = place + start.at
        if at < end:
            left = start.left[buffer[at]]
            if left.sure:
                return (left.infos,)
        return self.at(buffer[place])

    def ends(self, left: Left, byte: int) -> Ends:
        """What finds the ends of the expected candidates behind `byte`: those left, if that is sure."""
        left.ends = by_extent(left.infos if left.sure else self.at(byte)[0])
        return left.ends

    def start(self, byte: int) -> Start:
        """The candidates that may begin with `byte`, told apart by another one; for the same ones the same object."""
        levels = self.at(byte)
        found = self._starts.get(levels)
        if found is None:
            found = self._starts[levels] = self._told_apart(*levels)
        self.starting[byte] = found
        return found

    def _told_apart(self, infos: Level, rest: Level) -> Start:
        """By the place with the fewest candidates left, whatever byte stands there."""
        best = Start(0, {}, Left(infos, not rest))
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
                    value: Left(group, _sure(every, group, place, {value}, False)) for value, group in left.items()
                }
                best = Start(place, by_value, Left(others, _sure(every, others, place, values, True)))
        return best

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
