"""Rows of good frames in a stream where nothing is strange, with noise between them: a loop that does little a frame.

It finds what looking at every place finds; where it is not sure of that, it stops and leaves the place to that.
"""

from __future__ import annotations

from bisect import bisect_right

from framekit.link.arrivals import Arrival, FrameArrived
from framekit.link.evaluate import EVALUATION_ERRORS
from framekit.link.interest import Interest, Left
from framekit.link.noise import LONGEST
from framekit.link.rough import GOING_ON, NOTHING, UNSURE, WANTING, RoughLooking, new_tuple

BEGUN = 1
"""Instead of what `extent` said: a frame has surely begun, and wants more bytes."""


class RowLooking(RoughLooking):
    """The part of a receiver that takes many frames a turn."""

    def _rows(self, interest: Interest, found: list[Arrival], data: bytes) -> int:
        """Adds what there is to `found` as long as it is sure; then UNSURE, or NOTHING or WANTING if that is all.

        `data` are the bytes of the stream's buffer. All frames count as used.
        """
        if self._is_strange():
            return UNSURE
        stream, total = self.stream, len(data)
        rough = not stream.silences and self._rules.resync in GOING_ON
        known = UNSURE
        while True:
            place, size, left = self._row(interest, found, data, rough)
            if place != stream.position:
                stream.position = place
                if self._candidates.said or self._inside is not None:
                    self._moved()
            if place >= total:
                return UNSURE if self._noise.data else NOTHING
            if size == BEGUN or self._is_begun(interest, left, data, size):
                return WANTING
            if not rough or place <= known:
                return UNSURE
            known = self._rough(interest, found, data, size)
            if known < 0:
                return known

    def _row(self, interest: Interest, found: list[Arrival], data: bytes, rough: bool) -> tuple[int, int, Left | None]:
        """Adds the good frames that stand in a row, and noise before them; gives the place behind them.

        And what `extent` said there, if that is less than 0, of the only candidate that is left. Locals and a long
        loop are for speed: a frame is to cost little more than its decoding.
        """
        stream, names, starting, noise = self.stream, self._names, interest.starting, self._noise
        place, end, offset = stream.position, len(data), stream.offset - stream.position
        add, ends, times, base = found.append, stream.ends, stream.times, stream.base
        piece = bisect_right(ends, base + place) - 1
        until = at = 0
        behind_noise, lost = bool(noise.data), end
        rough = rough and place >= self._bad_until - base and not (behind_noise and noise.skipped)
        longest = LONGEST - len(noise.data)
        try:
            while place < end:
                start = starting[data[place]] or interest.start(data[place])
                left = start.left[data[place + start.at]]
                take = left.take
                if take is not None:
                    taken = take(data, place, end, names)
                    if not taken:
                        if taken is None:
                            break
                        return place, BEGUN, None
                    raw, fields = taken
                    behind = place + len(raw)
                elif left.slow is None:
                    behind = self._behind_noise(interest, data, place, 0) if rough and left.is_none else UNSURE
                    if behind < 0 or behind - min(lost, place) >= longest:
                        break
                    lost, place = min(lost, place), behind
                    continue
                elif left.constant is not None and data.startswith(left.constant, place):
                    raw, fields = left.constant, {}
                    behind = place + len(raw)
                else:
                    extent, decode, inner, search = left.slow
                    size = extent(data, place, end, names)
                    if size <= 0:
                        return place, size, left
                    behind = place + size
                    raw = data[place:behind]
                    if behind_noise and left.alone is not None and left.alone.proof and not left.alone.proof(raw):
                        break  # so close behind noise it is no frame most of the time, and raising costs much
                    fields = decode(raw, names)
                    if (inner is not None and "unknown" in fields[inner]) or (search is not None and search(raw)):
                        break
                if behind <= until:
                    started = at
                else:
                    while place >= until:
                        piece += 1
                        until, at = ends[piece] - base, times[piece]
                    started = at
                    while behind > until:
                        piece += 1
                        until, at = ends[piece] - base, times[piece]
                if behind_noise or lost < place:
                    self._end_run(found, data, min(lost, place), place, False)
                    behind_noise, lost = False, end
                add(new_tuple(FrameArrived, (left.make, fields, raw, offset + place, started, at, False)))
                place = behind
            else:
                return place, 0, None
            if left.alone is not None and left.take is not None:
                return place, left.alone.extent(data, place, end, names), left
        except EVALUATION_ERRORS:
            return place, 0, None
        finally:
            if lost < place:
                noise.collect(stream, lost, place, False)
        return place, 0, None

    def _is_begun(self, interest: Interest, left: Left | None, data: bytes, size: int) -> bool:
        """Whether surely a frame has begun and wants more bytes.

        `size`: less than 0, if `extent` has said so of the only one that is `left`.
        """
        place, names, quiet = self.stream.position, self._names, self._quiet
        try:
            if left is not None and left.alone is not None:
                info = left.alone
                if size >= 0 or (self._inside is not None and not left.sure):
                    return False
                if self._inside is not None and not self._inside.nothing_from(info, data, place):
                    return False
                return size > quiet and quiet < info.checked(data, place, size, names) < 0
            infos = interest.at(data[place])[0]
            if self._inside is not None or interest.left(data, place) is not None:
                return False
            sizes = [info.measure(data, place, len(data), names, 0) for info in infos]
            return bool(sizes) and max(sizes) <= 0 and any(quiet < size < 0 for size in sizes)
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
