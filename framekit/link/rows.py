"""Rows of good frames in a stream where nothing is strange, with noise between them: a loop that does little a frame.

It finds what looking at every place finds; where it is not sure of that, it stops and leaves the place to that.
"""

from __future__ import annotations

from bisect import bisect_right
from typing import Any

from framekit.link.arrivals import Arrival, FrameArrived
from framekit.link.evaluate import CODEC_ERRORS
from framekit.link.interest import NOT_LOOKED, Interest
from framekit.link.rough import NOTHING, UNSURE, WANTING, RoughLooking

NONE_TAKEN: tuple[Any, Any] = (None, None)


class RowLooking(RoughLooking):
    """The part of a receiver that takes many frames a turn."""

    def _rows(self, interest: Interest, found: list[Arrival], data: bytes) -> int:
        """Adds what there is to `found` as long as it is sure; then UNSURE, or NOTHING or WANTING if that is all.

        `data` are the bytes of the stream's buffer. All frames count as used.
        """
        stream = self.stream
        first = stream.position
        if first >= len(data) or self._is_strange() or (self._noise.data and not self._goes_on):
            return UNSURE
        take = self._row if interest.rows is None else self._many
        stream.position, ended = place, _ = take(interest, found, data, first)
        if found and type(found[-1]) is FrameArrived:
            self._good_since = True
        if place != first and (self._candidates.said or (self._inside is not None and self._inside.places)):
            self._moved()
        if ended == WANTING:
            return WANTING
        if place >= len(data):
            return UNSURE if self._noise.data else NOTHING
        return WANTING if self._is_begun(interest, data) else UNSURE

    def _row(self, interest: Interest, found: list[Arrival], data: bytes, place: int) -> tuple[int, int]:
        """Adds the frames that stand in a row, and noise before them; gives the place behind, and why it ends there.

        Locals and a long loop are for speed: a frame is to cost little more than its decoding.
        """
        stream, names, starting, add = self.stream, self._names, interest.starting, found.append
        end, base, ends, times = len(data), stream.base, stream.ends, stream.times
        offset = base + stream.removed
        piece = 0 if base + place < ends[0] else bisect_right(ends, base + place)
        until, came = ends[piece] - base, (times[piece], times[piece])
        try:
            if self._noise.data:
                place, left, raw, fields = self._over(interest, found, data, place, NOT_LOOKED, None)
                if left is NOT_LOOKED:
                    return place, fields
                add(self._arrival(left.make, fields, raw, place))
                place += len(raw)
            while place < end:
                start = starting[data[place]] or interest.start(data[place])
                left = start.left[data[place + start.at]]
                if left.whole is not None:
                    raw, fields = left.whole, {}
                else:
                    taken = left.take(data, place, end, names)
                    raw, fields = taken or NONE_TAKEN
                    if raw is None:
                        if taken == ():
                            return place, WANTING
                        if stream.silences or not self._goes_on:
                            return place, UNSURE
                        place, left, raw, fields = self._over(interest, found, data, place, left, taken)
                        if left is NOT_LOOKED:
                            return place, fields
                behind = place + len(raw)
                arrived = FrameArrived()
                arrived.make, arrived.decoded, arrived.raw = left.make, fields, raw
                arrived.offset = offset + place
                if behind > until:
                    while place >= until:
                        piece += 1
                        until = ends[piece] - base
                    since = times[piece]
                    while behind > until:
                        piece += 1
                        until = ends[piece] - base
                    arrived.times = since, times[piece]
                    came = times[piece], times[piece]
                else:
                    arrived.times = came
                add(arrived)
                place = behind
        except CODEC_ERRORS:
            pass
        return place, UNSURE

    def _many(self, interest: Interest, found: list[Arrival], data: bytes, place: int) -> tuple[int, int]:
        """As `_row`, where one frame is expected, many of which are taken at once."""
        assert interest.rows is not None
        (rows, only), stream, names, add = interest.rows, self.stream, self._names, found.append
        end, offset, now, ends = len(data), stream.base + stream.removed, stream.last, stream.ends
        came = now, now
        newest = 0 if len(ends) == 1 else ends[-2] - stream.base
        behind_noise = bool(self._noise.data)
        try:
            while place < end:
                left, raw, taken = NOT_LOOKED, None, None
                if not behind_noise:
                    since, count = now if place >= newest else stream.time_of(place), len(found)
                    first = came if since == now else (since, now)
                    place, taken = rows(data, place, end, names, first, came, offset, FrameArrived, only.make, add)
                    if since != now and count < len(found):
                        one = found[count]  # a frame begun in older bytes ends in the newest, unless they are read anew
                        if isinstance(one, FrameArrived) and one.offset + len(one.raw) <= offset + newest:
                            self._date(found[count:])
                    if taken == ():
                        return place, WANTING
                    if place >= end:
                        break
                    start = interest.starting[data[place]] or interest.start(data[place])
                    left = start.left[data[place + start.at]]
                    if taken is None:
                        taken = left.take(data, place, end, names)
                    raw, fields = taken or NONE_TAKEN
                if raw is None:
                    if taken == ():
                        return place, WANTING
                    if stream.silences or not self._goes_on:
                        break
                    place, left, raw, fields = self._over(interest, found, data, place, left, taken)
                    if left is NOT_LOOKED:
                        return place, fields
                    behind_noise = False
                add(self._arrival(only.make, fields, raw, place))
                place += len(raw)
        except CODEC_ERRORS:
            pass
        return place, UNSURE

    def _date(self, found: list[Arrival]) -> None:
        """When frames came that do not all reach into the newest bytes."""
        stream = self.stream
        for arrived in found:
            if isinstance(arrived, FrameArrived):
                place = arrived.offset - stream.removed - stream.base
                arrived.times = stream.times_of(place, place + len(arrived.raw))

    def _is_begun(self, interest: Interest, data: bytes) -> bool:
        """Whether surely a frame has begun at the present place, and wants more bytes."""
        place, names, quiet = self.stream.position, self._names, self._quiet
        try:
            left = interest.left(data, place)
            if left is not None and left.alone is not None:
                info = left.alone
                if self._inside is not None and not (left.sure and self._inside.nothing_from(info, data, place)):
                    return False
                size = info.extent(data, place, len(data), names)
                return quiet < size < 0 and quiet < info.checked(data, place, size, names) < 0
            if left is not None:
                return False
            infos, others = interest.at(data[place])
            if self._inside is not None:
                for info in (*infos, *others):
                    if not self._inside.nothing_from(info, data, place):
                        return False
            sizes = [info.measure(data, place, len(data), names, 0) for info in infos]
            return bool(sizes) and max(sizes) <= 0 and any(quiet < size < 0 for size in sizes)
        except CODEC_ERRORS:
            return False

    def _is_strange(self) -> bool:
        """Whether something has happened that needs a look at every place."""
        stream = self.stream
        if self._now != stream.last or self._skipping:
            return True
        if not stream.is_marked:
            return False
        silent_noise = stream.silences and self._noise.data
        return bool(stream.pauses or stream.faults or stream.taken_out or silent_noise)
