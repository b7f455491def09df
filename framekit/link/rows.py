"""Rows of good frames in a stream where nothing is strange, with noise between them: a loop that does little a frame.

It finds what looking at every place finds; where it is not sure of that, it stops and leaves the place to that.
"""

from __future__ import annotations

from bisect import bisect_right

from framekit.link.arrivals import Arrival, FrameArrived
from framekit.link.evaluate import EVALUATION_ERRORS
from framekit.link.interest import Interest, Left
from framekit.link.rough import GOING_ON, UNSURE, WANTING, RoughLooking

new_tuple = tuple.__new__
"""Makes a named tuple in a quarter of the time that calling its class takes."""


class RowLooking(RoughLooking):
    """The part of a receiver that takes many frames a turn."""

    def _rows(self, interest: Interest, found: list[Arrival], data: bytes) -> int:
        """Adds what there is to `found` as long as it is sure; then UNSURE, or WANTING if there is no more of it.

        `data` are the bytes of the stream's buffer. All frames count as used.
        """
        if self._is_strange():
            return UNSURE
        stream = self.stream
        rough = not stream.silences and self._rules.resync in GOING_ON
        known = UNSURE
        while True:
            place, size, left = self._row(interest, found, data)
            if place != stream.position:
                stream.position = place
                if self._candidates.said or self._inside is not None:
                    self._moved()
            if size < 0 and left is not None and self._is_begun(left, data, size):
                return WANTING
            if not rough or place <= known or place >= len(data):
                return UNSURE
            known = self._rough(interest, found, data, size)
            if known < 0:
                return known

    def _row(self, interest: Interest, found: list[Arrival], data: bytes) -> tuple[int, int, Left | None]:
        """Adds the good frames that stand in a row, and noise before them; gives the place behind them.

        And what `extent` said there, if that is less than 0, of the only candidate that is left. Locals and a long
        loop are for speed: a frame is to cost little more than its decoding.
        """
        stream, names, starting, noise = self.stream, self._names, interest.starting, self._noise
        place, end, offset = stream.position, len(data), stream.offset - stream.position
        add, ends, times, base = found.append, stream.ends, stream.times, stream.base
        piece = bisect_right(ends, base + place) - 1
        until = at = 0
        behind_noise = bool(noise.data)
        try:
            while place < end:
                start = starting[data[place]] or interest.start(data[place])
                left = start.left.get(data[place + start.at], start.others) if start.at else start.others
                if left.take is None:
                    break
                constant, take, extent, decode, make, inner, search = left.take
                if take is not None:
                    taken = take(data, place, end, names)
                    if taken is None:
                        return place, extent(data, place, end, names), left
                    raw, fields = taken
                    behind = place + len(raw)
                elif constant is not None and data.startswith(constant, place):
                    raw, fields = constant, {}
                    behind = place + len(raw)
                else:
                    size = extent(data, place, end, names)
                    if size <= 0:
                        return place, size, left
                    behind = place + size
                    raw = data[place:behind]
                    if behind_noise and (left.alone is None or (left.alone.proof and not left.alone.proof(raw))):
                        break  # so close behind noise it is no frame most of the time, and raising costs much
                    fields = decode(raw, names)
                    if (inner is not None and "unknown" in fields[inner]) or (search is not None and search(raw)):
                        break
                while place >= until:
                    piece += 1
                    until, at = ends[piece] - base, times[piece]
                started = at
                while behind > until:
                    piece += 1
                    until, at = ends[piece] - base, times[piece]
                if behind_noise:
                    add(noise.take())
                    behind_noise = False
                add(new_tuple(FrameArrived, (make, fields, raw, offset + place, started, at, False)))
                place = behind
        except EVALUATION_ERRORS:
            return place, 0, None
        return place, 0, None

    def _is_begun(self, left: Left, data: bytes, size: int) -> bool:
        """Whether surely a frame has begun whose `extent` says `size`, so that more bytes are wanted."""
        info, place = left.alone, self.stream.position
        if info is None or size <= self._quiet:
            return False
        if self._inside is not None and not (left.sure and self._inside.nothing_from(info, data, place)):
            return False
        if not info.guesses:
            return True
        try:
            return self._quiet < info.measure(data, place, len(data), self._names, 0) < 0
        except EVALUATION_ERRORS:
            return False

    def _is_strange(self) -> bool:
        """Whether something has happened that needs a look at every place."""
        stream = self.stream
        return bool(
            self._now != stream.last
            or stream.pauses
            or stream.faults
            or stream.is_uneven
            or self._skipping
            or (stream.silences and self._noise.data)
        )
