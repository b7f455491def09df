"""The bytes a receiver has not used yet, with what is known of their timing and of damaged characters.

Offsets are those of the stream: they count bytes from its start and stay valid when the buffer moves.
It knows no frames.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable

from framekit.link.events import CharacterFault, LineFault

COPIED = 4096
"""A rest of so many bytes is copied when more come; behind a longer one they are appended, which grows no slower."""


class Stream:
    """A buffer from `position` on. `base` is the offset of `buffer[0]`; pauses are offsets of the byte behind them.

    `ends` and `times`: of the pieces the bytes came in, the offsets behind them and when they came. The buffer is
    `bytes` as long as it is short, so that nobody has to copy it. `taken_out`: what has been behind the position, so
    that offsets there do not count on evenly; `removed`: how many bytes have been before it. `is_marked`: there may be
    something in it, or a fault, silence or pause.
    """

    __slots__ = (
        "base", "buffer", "ends", "faults", "is_marked", "last", "pauses", "position", "removed", "silences",
        "taken_out", "times",
    )  # fmt: skip

    def __init__(self) -> None:
        self.buffer: bytes | bytearray = b""
        self.position = 0
        self.base = 0
        self.removed = 0
        self.taken_out: list[tuple[int, int]] = []
        self.last = 0
        self.ends: list[int] = []
        self.times: list[int] = []
        self.faults: list[tuple[int, LineFault]] = []
        self.silences: list[int] = []
        self.pauses: list[int] = []
        self.is_marked = False

    @property
    def offset(self) -> int:
        """The stream offset of the current position, frames taken out of the middle of others included."""
        place = self.base + self.position
        if not self.taken_out:
            return place + self.removed
        while self.taken_out and self.taken_out[0][0] <= place:
            self.removed += self.taken_out.pop(0)[1]
        return place + self.removed

    def add(self, data: bytes, now: int, faults: Iterable[CharacterFault]) -> bool:
        """More bytes, the last of which came at `now`; whether there have been others. What has been used is dropped,
        unless much more follows it.
        """
        rest = len(self.buffer) - self.position
        if rest > COPIED or self.is_marked or faults:
            return self._add(data, now, faults)
        self.base = base = self.base + self.position
        self.last = now
        if not rest:
            self.buffer = bytes(data)
            self.ends, self.times = [base + len(data)], [now]
            self.position = 0
            return False
        self.buffer = buffer = bytes(self.buffer[self.position :]) + data
        self.position, ends = 0, self.ends
        if len(ends) == 1 or ends[-2] <= base:
            self.ends, self.times = [ends[-1], base + len(buffer)], [self.times[-1], now]
        else:
            used = bisect_right(ends, base)
            self.ends, self.times = [*ends[used:], base + len(buffer)], [*self.times[used:], now]
        return True

    def _add(self, data: bytes, now: int, faults: Iterable[CharacterFault]) -> bool:
        """As `add`, whatever there is to be remembered."""
        rest = len(self.buffer) - self.position
        if self.position and (rest <= COPIED or self.position > rest):
            self.tidy()
        if rest <= COPIED:
            self.buffer = bytes(self.buffer) + data
        else:
            self.buffer = bytearray(self.buffer) if type(self.buffer) is bytes else self.buffer
            self.buffer += data
        end = self.base + len(self.buffer)
        self.ends.append(end)
        self.times.append(now)
        for fault in faults:
            self.faults.append((end - len(data) + fault.index, fault.fault))
        self.is_marked = bool(self.faults or self.silences or self.pauses or self.taken_out)
        self.last = now
        return bool(rest)

    def mark(self, places: list[int], place: int) -> None:
        """Notes something at a place, behind all that is noted in `places`."""
        places.append(place)
        self.is_marked = True

    def tidy(self) -> None:
        """Forgets the used part of the buffer."""
        self.buffer = buffer = self.buffer[self.position :]
        self.base = base = self.base + self.position
        self.position, ends = 0, self.ends
        if not buffer:
            self.ends, self.times = [], []
        else:
            used = bisect_right(ends, base)
            self.ends, self.times = ends[used:], self.times[used:]
        if self.is_marked:
            self.faults = [item for item in self.faults if buffer and item[0] >= base]
            self.silences = [item for item in self.silences if buffer and item >= base]
            self.pauses = [item for item in self.pauses if buffer and item >= base]
            self.is_marked = bool(self.faults or self.silences or self.pauses or self.taken_out)

    def time_of(self, index: int) -> int:
        """When the byte at `buffer[index]` came."""
        place = self.base + index
        return self.times[0 if place < self.ends[0] else bisect_right(self.ends, place)]

    def times_of(self, start: int, end: int) -> tuple[int, int]:
        """When the first and the last byte of `buffer[start:end]` came; there has to be one."""
        ends, times = self.ends, self.times
        if len(ends) == 1 or ends[-2] <= self.base + start:
            return times[-1], times[-1]
        first = bisect_right(ends, self.base + start)
        if self.base + end <= ends[first]:
            return times[first], times[first]
        return times[first], times[bisect_right(ends, self.base + end - 1)]

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
        self.buffer = self.buffer[:start] + self.buffer[end:]
        self.taken_out.append((low + 1, count))
        self.is_marked = True
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
