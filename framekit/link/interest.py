"""Who is looked for at a place in the stream, prepared once for every set of frame names.

For each byte a frame may begin with: the expected candidates and the others, in the order of the rows.
"""

from __future__ import annotations

import re

from framekit.link.frame_table import FrameInfo, FrameTable

Level = tuple[FrameInfo, ...]


class Interest:
    """The candidates for one pair of name lists."""

    __slots__ = ("_found", "_others_all", "_wanted", "expected", "others", "starts")

    def __init__(self, table: FrameTable, expected: tuple[str, ...], others: tuple[str, ...]) -> None:
        self.expected = expected
        self.others = others
        self._wanted = tuple(table.infos[name] for name in dict.fromkeys(expected))
        self._others_all = tuple(table.infos[name] for name in dict.fromkeys(others) if name not in expected)
        self._found: dict[int, tuple[Level, Level]] = {}
        self.starts = self._start_pattern()

    def at(self, byte: int) -> tuple[Level, Level]:
        """The candidates that may begin with `byte`."""
        found = self._found.get(byte)
        if found is None:
            found = (_beginning(self._wanted, byte), _beginning(self._others_all, byte))
            self._found[byte] = found
        return found

    def _start_pattern(self) -> re.Pattern[bytes] | None:
        """Matches a byte that some candidate begins with; None when any byte may begin one."""
        firsts = {info.first for info in (*self._wanted, *self._others_all)}
        known = bytes(sorted(first for first in firsts if first is not None))
        if len(known) < len(firsts):
            return None
        return re.compile(b"[" + re.escape(known) + b"]") if known else re.compile(rb"[^\x00-\xff]")


def _beginning(infos: Level, byte: int) -> Level:
    return tuple(info for info in infos if info.first is None or info.first == byte)
