"""The quick way through a stream where nothing is strange: many frames a turn, each read as soon as it is there whole.

It finds what looking at every place finds, only sooner; where it is not sure of that, it stops and changes nothing.
"""

from __future__ import annotations

from typing import Any

from framekit.codec.errors import FrameError
from framekit.link.arrivals import Arrival, BadFrame, FrameArrived, Noise
from framekit.link.evaluate import EVALUATION_ERRORS
from framekit.link.frame_info import FrameInfo
from framekit.link.interest import Interest, Left
from framekit.link.looking import Looking
from framekit.link.verdicts import Bad, Complete, Result, Unfinished

UNSURE = -1
"""Instead of a place: look at it with care."""

WANTING = -2
"""Instead of a place: more bytes are wanted there before anything can be said."""

GOING_ON = ("next_start", "after_frame")
"""How to go on after a bad frame without waiting for anything."""

new_tuple = tuple.__new__
"""Makes a named tuple in a quarter of the time that calling its class takes."""

Taken = tuple[FrameInfo | None, int, dict[str, Any] | None]


class PlainLooking(Looking):
    """The part of a receiver that takes frames without looking at anything but their bytes."""

    def _plain(self, interest: Interest, found: list[Arrival], data: bytes | None = None) -> bool:
        """Adds what there is to `found` as long as it is plain; whether more bytes are wanted before anything else.

        `data` are the bytes of the stream's buffer; all frames in it count as used. Without it the first thing found
        is added, and a frame counts as handed over. Locals and the long loop are for speed: a frame is to cost little
        more than its decoding.
        """
        stream, said, noise = self.stream, self._candidates.said, self._noise
        if self._is_strange():
            return False
        one, names, inside, whole = data is None, self._names, self._inside, data or stream.buffer
        place, end = stream.position, len(whole)
        fresh, last, offset = stream.fresh, stream.last, stream.offset - place
        starting, received = interest.starting, self.table.received_as
        while place < end:
            start = starting[whole[place]] or interest.start(whole[place])
            left = start.others
            if start.at:
                if place + start.at >= end:
                    break
                left = start.left.get(whole[place + start.at], left)
            info, size, fields, value = left.alone, 0, None, None
            try:
                if info is not None and not said:
                    size = info.extent(whole, place, end, names)
                elif left.infos:
                    info, size, fields = self._taken(left, place, end, said)
                if size > 0 and info is not None:
                    raw = bytes(whole[place : place + size])
                    value = received(info, info.decode(raw, names) if fields is None else fields, raw, None)
            except EVALUATION_ERRORS as error:
                if not isinstance(error, FrameError) or error.refuse is not None:
                    break
            if info is None or value is None or (info.guesses and not info.guessed_right(value)):
                further = self._beside(found, left, place, size)
                if further < 0 or (one and found):
                    return further == WANTING  # the stream is where it stopped
                place, said = further, {}
                continue
            if inside is not None and not (left.alone and left.sure and inside.nothing_in(info, raw)):
                break
            if noise.data:
                found.append(noise.take())
                if one:
                    break
            started = last if place >= fresh else stream.time_of(place)
            ended = last if place + size > fresh else stream.time_of(place + size - 1)
            found.append(new_tuple(FrameArrived, (value, raw, offset + place, started, ended, False)))
            if one:
                self._given = size
                self._declined.append(info.name)
                break
            place, said = place + size, {}
        self._go_to(place)
        return False

    def _go_to(self, place: int) -> None:
        if place != self.stream.position:
            self.stream.position = place
            self._moved()

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

    def _beside(self, found: list[Arrival], left: Left, place: int, size: int) -> int:
        """The next place after one where no good frame begins, or UNSURE or WANTING.

        `size` is what the only candidate said. What that is comes to `found`, as far as it is anything yet.
        """
        self._go_to(place)
        stream, info = self.stream, left.alone
        if (left.infos and info is None) or stream.silences or self._noise.is_long:
            return UNSURE
        if info is not None:
            if self._inside is not None and not (left.sure and self._inside.nothing_from(info, stream.buffer, place)):
                return UNSURE
            before = self._candidates.said.get(info.name)
            if info.guesses and before is None:
                size = info.measure(stream.buffer, place, len(stream.buffer), self._names, 0)
            if size < 0:
                return self._wanting(info, place, size)
            if size > 0 and left.sure and stream.base + place >= self._bad_until:
                return self._reported(found, info, place, size)
        if not left.sure or self._rules.resync == "never":
            return UNSURE
        passed_over = self._unusable()
        if isinstance(passed_over, Noise):
            found.append(passed_over)
        return UNSURE if passed_over is None else stream.position

    def _wanting(self, info: FrameInfo, place: int, size: int) -> int:
        """A frame has begun, as its only candidate says by `size`."""
        if size <= self._quiet:
            return UNSURE
        said, had = self._candidates.said, len(self.stream.buffer) - place
        before = said.get(info.name)
        said[info.name] = Unfinished(False, had, before.had if type(before) is Unfinished else 0, had - size)
        return WANTING

    def _reported(self, found: list[Arrival], info: FrameInfo, place: int, size: int) -> int:
        """A bad frame that is a new one, after the noise before it."""
        if self._rules.resync not in GOING_ON:
            return UNSURE
        if self._noise:
            found.append(self._noise.take())
            return place
        bad = self._candidates.read(info, Complete(size))
        arrival = self._bad(bad) if type(bad) is Bad else None
        if not isinstance(arrival, BadFrame):
            return UNSURE
        found.append(arrival)
        return self.stream.position

    def _taken(self, left: Left, place: int, end: int, said: dict[str, Result]) -> Taken:
        """The shortest good frame of several, or of one that has been asked before, with its size and perhaps fields.

        No frame if that is not sure. Raises what expressions and decoding raise.
        """
        buffer, names = self.stream.buffer, self._names
        whole: list[tuple[int, FrameInfo]] = []
        size = self._quiet
        for info in left.infos:
            seen = 0
            if said:
                before = said.get(info.name)
                if type(before) is not Unfinished or before.silent:
                    return left.alone, self._quiet, None
                if end - place < before.wanted and left.alone is None:
                    continue
                seen = before.seen
            size = info.measure(buffer, place, end, names, seen)
            if size > 0:
                whole.append((size, info))
        if left.alone is not None or not whole:
            return left.alone, size, None
        if len(whole) == 1:
            return whole[0][1], whole[0][0], None
        for size, info in sorted(whole, key=_size_of):
            raw = bytes(buffer[place : place + size])
            if info.intact is None or info.intact(raw):
                try:
                    return info, size, info.decode(raw, names)
                except FrameError as error:
                    if error.refuse is not None:
                        raise
        return None, 0, None


def _size_of(item: tuple[int, FrameInfo]) -> int:
    return item[0]
