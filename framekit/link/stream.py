"""The bytes a receiver has not used yet, with what is known of their timing and of damaged characters.

Offsets are those of the stream: they count bytes from its start and stay valid when the buffer moves.
It knows no frames.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable

from framekit.link.events import CharacterFault, LineFault

MOVE_AT = 4096
"""The used part of the buffer is dropped when longer than this and than the rest: each byte moves at most once."""


class Stream:
    """A buffer from `position` on. `base` is the offset of `buffer[0]`; pauses are offsets of the byte behind them.

    `ends` and `times`: of the pieces the bytes came in, the offsets behind them and when they came.
    """

    __slots__ = (
        "_removed", "base", "buffer", "ends", "faults", "last", "pauses", "position", "removed", "silences", "times",
    )  # fmt: skip

    def __init__(self) -> None:
        self.buffer = bytearray()
        self.position = 0
        self.base = 0
        self.removed = 0
        self._removed: list[tuple[int, int]] = []
        self.last = 0
        self.ends: list[int] = []
        self.times: list[int] = []
        self.faults: list[tuple[int, LineFault]] = []
        self.silences: list[int] = []
        self.pauses: list[int] = []

    @property
    def offset(self) -> int:
        """The stream offset of the current position, frames taken out of the middle of others included."""
        place = self.base + self.position
        if not self._removed:
            return place + self.removed
        while self._removed and self._removed[0][0] <= place:
            self.removed += self._removed.pop(0)[1]
        return place + self.removed

    def add(self, data: bytes, now: int, faults: Iterable[CharacterFault]) -> None:
        """More bytes, the last of which came at `now`; `tidy` before."""
        start = self.base + len(self.buffer)
        self.buffer += data
        self.ends.append(start + len(data))
        self.times.append(now)
        for fault in faults:
            self.faults.append((start + fault.index, fault.fault))
        self.last = now

    def tidy(self) -> None:
        """Forgets the used part of the buffer when that pays."""
        position, size = self.position, len(self.buffer)
        if position >= size:
            self.base += size
            self.buffer.clear()
            self.ends.clear()
            self.times.clear()
            if self.faults or self.silences or self.pauses:
                self.faults.clear()
                self.silences.clear()
                self.pauses.clear()
        elif position > MOVE_AT and position * 2 > size:
            del self.buffer[:position]
            self.base += position
            used = bisect_right(self.ends, self.base)
            del self.ends[:used], self.times[:used]
            self.faults = [item for item in self.faults if item[0] >= self.base]
            self.silences = [item for item in self.silences if item >= self.base]
            self.pauses = [item for item in self.pauses if item >= self.base]
        else:
            return
        self.position = 0

    def time_of(self, index: int) -> int:
        """When the byte at `buffer[index]` came."""
        times = self.times
        return times[0] if len(times) == 1 else times[bisect_right(self.ends, self.base + index)]

    def times_of(self, start: int, end: int) -> tuple[int, int]:
        """When the first and the last byte of `buffer[start:end]` came; there has to be one."""
        ends, times = self.ends, self.times
        first = bisect_right(ends, self.base + start)
        if self.base + end <= ends[first]:
            return times[first], times[first]
        return times[first], times[bisect_right(ends, self.base + end - 1)]

    @property
    def is_uneven(self) -> bool:
        """Whether something has been taken out behind the position, so that offsets there do not count on evenly."""
        return bool(self._removed)

    def fault_in(self, start: int, end: int) -> LineFault | None:
        """The first fault of a character in `buffer[start:end]`."""
        low, high = self.base + start, self.base + end
        for place, fault in self.faults:
            if low <= place < high:
                return fault
        return None

    def first_after(self, places: list[int], index: int) -> int | None:
        """The buffer index of the first of `places` behind `index`."""
        found = bisect_right(places, self.base + index)
        return places[found] - self.base if found < len(places) else None

    def remove(self, start: int, end: int) -> None:
        """Takes `buffer[start:end]` out of the middle; what lies behind moves up."""
        low, count = self.base + start, end - start
        del self.buffer[start:end]
        self._removed.append((low + 1, count))
        self.ends = [place - count if place > low else place for place in self.ends]
        self.faults = [
            (place - count if place >= low + count else place, fault)
            for place, fault in self.faults
            if not low <= place < low + count
        ]
        self.silences = [max(place - count, low) if place > low else place for place in self.silences]
        self.pauses = [max(place - count, low) if place > low else place for place in self.pauses]

    def clear(self) -> None:
        """Forgets every byte."""
        self.position = len(self.buffer)
        self.tidy()
