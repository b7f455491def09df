"""The holds of a line: until when no request is sent to a station, because a reply to an earlier request may come.

A hold concerns its station alone where every reply names its station, else the whole line. Sans-I/O.
"""

from __future__ import annotations

from collections.abc import Hashable
from typing import Any

from framekit.link.slow import key_of

LINE = ("line",)
"""Key of the hold, or of a time, that concerns every station."""


class Holds:
    """The ends of the holds of a line, by station. `LateReplies` decides which stations a hold of the line concerns."""

    __slots__ = ("_ends", "is_by_station", "until")

    def __init__(self) -> None:
        self.until = 0
        """End of the longest hold (ns); 0: no hold."""
        self.is_by_station = False
        """Whether replies name their station, so that each station has a hold of its own."""
        self._ends: dict[Hashable, int] = {}

    def key(self, station: Any) -> Hashable:
        """Return the key of a station; None is every station."""
        return key_of(station) if self.is_by_station and station is not None else LINE

    def extend(self, station: Any, end: int) -> None:
        """Hold back requests to a station up to a time at least; station None: to every station."""
        key = self.key(station)
        if end > self._ends.get(key, 0):
            self._ends[key] = end
            self.until = max(self.until, end)

    def replace(self, station: Any, end: int) -> None:
        """Hold back requests to a station up to this time, instead of an earlier or a later time; 0: end the hold."""
        if end:
            self._ends[self.key(station)] = end
        else:
            self._ends.pop(self.key(station), None)
        self.until = max(self._ends.values(), default=0)

    def end_of(self, station: Any) -> int:
        """Return the end of the hold for a station (ns); 0 if it has none."""
        return max(self._ends.get(LINE, 0), self._ends.get(self.key(station), 0))

    def drop_over(self, now: int) -> None:
        """Drop the holds that have ended."""
        self._ends = {key: end for key, end in self._ends.items() if end > now}
        self.until = max(self._ends.values(), default=0)

    def clear(self) -> None:
        """End every hold."""
        self._ends.clear()
        self.until = 0
