"""Who is looked for at a place in the stream, prepared once for every set of frame names.

For each byte a frame may begin with: the expected candidates and the others, in the order of the rows.
"""

from __future__ import annotations

import re

from framekit.link.frame_table import FrameInfo, FrameTable

Level = tuple[FrameInfo, ...]


class Interest:
    """The candidates for one pair of name lists."""

    __slots__ = ("_found", "_rest", "_wanted", "expected", "others", "starts")

    def __init__(self, table: FrameTable, expected: tuple[str, ...], others: tuple[str, ...]) -> None:
        self.expected = expected
        self.others = others
        self._wanted = _on_line(table, expected)
        self._rest = _on_line(table, tuple(name for name in others if name not in expected))
        self._found: dict[int, tuple[Level, Level]] = {}
        self.starts = self._start_pattern()

    def at(self, byte: int) -> tuple[Level, Level]:
        """The candidates that may begin with `byte`."""
        found = self._found.get(byte)
        if found is None:
            found = (_beginning(self._wanted, byte), _beginning(self._rest, byte))
            self._found[byte] = found
        return found

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


def _beginning(infos: Level, byte: int) -> Level:
    return tuple(info for info in infos if info.first is None or info.first == byte)
