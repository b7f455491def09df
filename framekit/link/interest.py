"""Who is looked for at a place in the stream, prepared once for every set of frame names.

For each byte a frame may begin with: the expected candidates and the others, in the order of the rows.
"""

from __future__ import annotations

import re

from framekit.codec.python.choices import fixed_bytes
from framekit.link.frame_table import FrameInfo, FrameTable

Level = tuple[FrameInfo, ...]
Likely = tuple[Level, int, dict[int, Level], Level]
"""All candidates; the place behind the first byte that tells them apart (0: none); those for its values; the others."""


class Interest:
    """The candidates for one pair of name lists."""

    __slots__ = ("_found", "_likely", "_rest", "_wanted", "expected", "others", "starts")

    def __init__(self, table: FrameTable, expected: tuple[str, ...], others: tuple[str, ...]) -> None:
        self.expected = expected
        self.others = others
        self._wanted = _on_line(table, expected)
        self._rest = _on_line(table, tuple(name for name in others if name not in expected))
        self._found: dict[int, tuple[Level, Level]] = {}
        self._likely: dict[int, Likely] = {}
        self.starts = self._start_pattern()

    def at(self, byte: int) -> tuple[Level, Level]:
        """The candidates that may begin with `byte`."""
        found = self._found.get(byte)
        if found is None:
            found = (_beginning(self._wanted, byte), _beginning(self._rest, byte))
            self._found[byte] = found
        return found

    def likely(self, buffer: bytearray, position: int) -> Level:
        """The expected candidates that may begin here and that no constant byte behind the first one contradicts."""
        byte = buffer[position]
        likely = self._likely.get(byte)
        if likely is None:
            likely = self._likely[byte] = _told_apart(self.at(byte)[0])
        everything, place, by_value, others = likely
        place += position
        if place == position or place >= len(buffer):
            return everything
        return by_value.get(buffer[place], others)

    def _start_pattern(self) -> re.Pattern[bytes] | None:
        """Matches a byte that some candidate begins with; None when any byte may begin one."""
        firsts = {info.first for info in (*self._wanted, *self._rest)}
        known = bytes(sorted(first for first in firsts if first is not None))
        if len(known) < len(firsts):
            return None
        return re.compile(b"[" + re.escape(known) + b"]") if known else re.compile(rb"[^\x00-\xff]")


def _on_line(table: FrameTable, names: tuple[str, ...]) -> Level:
    """Each frame once; frames that only stand in others are never looked for."""
    return tuple(info for name in dict.fromkeys(names) if (info := table.infos[name]).on_line)


def _told_apart(infos: Level) -> Likely:
    """The place with the fewest candidates left, whatever byte stands there."""
    best: Likely = (infos, 0, {}, infos)
    most = len(infos)
    allowed = [dict(fixed_bytes(info.frame.segments)) for info in infos]
    for place in sorted({place for one in allowed for place in one if place}):
        rows = [(info, one.get(place)) for info, one in zip(infos, allowed, strict=True)]
        values = {value for _, one in rows for value in one or ()}
        by_value = {value: tuple(info for info, one in rows if one is None or value in one) for value in values}
        others = tuple(info for info, one in rows if one is None)
        left = max(len(group) for group in (*by_value.values(), others))
        if left < most:
            best, most = (infos, place, by_value, others), left
    return best


def _beginning(infos: Level, byte: int) -> Level:
    return tuple(info for info in infos if info.first is None or info.first == byte)
