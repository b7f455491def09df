"""The quick way over noise: place after place where no good frame begins, and bad frames that are to be told.

It says of a place what looking at it with care says; where it is not sure of that, it stops before it.
"""

from __future__ import annotations

from functools import partial
from typing import Any

from framekit.link.arrivals import Arrival, BadFrame, Fault, FrameArrived, Noise, new_tuple
from framekit.link.candidates import fault_of
from framekit.link.evaluate import CODEC_ERRORS, Names
from framekit.link.frame_info import FrameInfo, Taken
from framekit.link.interest import NOT_LOOKED, Interest, Left
from framekit.link.looking import Looking
from framekit.link.noise import LONGEST

UNSURE = -1
"""Instead of a place: look at it with care."""

WANTING = -2
"""Instead of a place: more bytes are wanted there before anything can be said."""

NOTHING = -3
"""Instead of a place: nothing is left."""


class RoughLooking(Looking):
    """The part of a receiver that gets over noise many bytes a turn."""

    def _over(
        self, interest: Interest, found: list[Arrival], data: bytes, place: int, left: Left, taken: Taken
    ) -> tuple[int, Left, Any, Any]:
        """Gets over noise to the next good frame: its place, who it is, its bytes and fields.

        Noise and bad frames on the way are told. NOT_LOOKED and None, if it ends at that place, then UNSURE or WANTING.
        `taken`: what `left` has found at `place`, unless that is NOT_LOOKED. Locals and a long loop are for speed, as
        in rows of good frames.
        """
        stream, noise, starting, names = self.stream, self._noise, interest.starting, self._names
        first, total = place, len(data)
        self._good_since = self._good_since or bool(found and type(found[-1]) is FrameArrived)
        limit = min(total, place + LONGEST - len(noise.data))
        bad_until = self._bad_until - stream.base
        skipped = noise.skipped if noise.data else place < bad_until
        stops, symbol = interest.stops, self._rules.symbols
        size = 0
        known = proof = None
        try:
            while True:
                if left is not NOT_LOOKED:
                    info = left.alone
                    if taken and left.is_plain and info is not None:
                        size = taken[1]
                        if size and info is not known:
                            known, proof = info, info.intact
                        if size and (proof is None or place < bad_until):
                            size = UNSURE if proof is None else 0
                    elif left.is_none:
                        size = 0
                    elif taken == ():
                        size = WANTING
                    else:
                        size = self._bad_size(left, data, place, taken, place < bad_until)
                    if size < 0:
                        break
                    if size > 0 and info is not None:
                        self._end_run(found, data, first, place, skipped)
                        bad = self._misread(info, data, place, size)
                        found.append(bad)
                        bad_until, first, skipped = place + self._bad_reach(size, bad.started_at), place, True
                        self._bad_until = stream.base + bad_until
                    elif skipped is not (place < bad_until):
                        self._end_run(found, data, first, place, skipped)
                        first, skipped = place, not skipped
                    if size > 0 and self._rules.resync == "after_frame":
                        place = first = bad_until
                    elif data[place] == symbol:
                        if place + 1 == total:
                            break
                        place += 2
                    elif stops is None:
                        place += 1
                    else:
                        match = stops.search(data, place + 1)
                        behind = total if match is None else match.start()
                        place = bad_until if place < bad_until < behind else behind
                if place >= limit:
                    break
                start = starting[data[place]] or interest.start(data[place])
                left = start.left[data[place + start.at]]
                taken = self._slowly(left, data, place) if left.is_slow else left.take(data, place, total, names)
                if taken and taken[0] is not None:
                    self._end_run(found, data, first, place, skipped)
                    first = place
                    self._good_since = True
                    return place, left, taken[0], taken[1]
        except CODEC_ERRORS:
            size = 0
        finally:
            if place > first:
                noise.collect(stream, first, place, skipped)
        return place, NOT_LOOKED, None, WANTING if size == WANTING else UNSURE

    def _bad_size(self, left: Left, data: bytes, place: int, taken: Taken, is_skipped: bool) -> int:
        """How long the bad frame is that is to be told of at a place where none has been found that is good.

        0 if there is none, or nobody is told of it, as of all that begin in one that has been told; UNSURE; WANTING.
        """
        info, names = left.alone, self._names
        if info is None or not left.sure:
            return UNSURE
        if self._inside is not None and not self._inside.nothing_from(info, data, place):
            return UNSURE
        proof = info.intact
        if taken:
            return UNSURE if proof is None and taken[1] else 0 if is_skipped else int(taken[1])
        size = info.extent(data, place, len(data), names)
        if size > 0 and (proof is None or proof(data[place : place + size])):
            return UNSURE
        if size == 0 or (size > 0 and is_skipped):
            return 0
        size = info.checked(data, place, size, names)
        return size if size >= 0 else WANTING if size > self._quiet else UNSURE

    def _slowly(self, left: Left, data: bytes, place: int) -> Taken:
        """What a frame is that has to be measured: no frame most of the time, so that its check code is tried first."""
        assert left.alone is not None
        info, names = left.alone, self._names
        size = info.extent(data, place, len(data), names)
        if size <= 0 or (info.intact is not None and not info.intact(data[place : place + size])):
            return None
        return left.take(data, place, len(data), names)

    def _end_run(self, found: list[Arrival], data: bytes, start: int, end: int, skipped: bool) -> None:
        """The run of noise ends: what was known of it, and `data[start:end]`."""
        stream, noise = self.stream, self._noise
        if not noise.data:
            if end > start:
                ends, base = stream.ends, stream.base
                started = ended = stream.last
                if len(ends) > 1 and base + start < ends[-2]:
                    started, ended = stream.times_of(start, end)
                offset = base + stream.removed + start
                found.append(new_tuple(Noise, (data[start:end], offset, started, ended, skipped)))
            return
        if end > start:
            noise.collect(stream, start, end, skipped)
        found.append(noise.take())

    def _misread(self, info: FrameInfo, data: bytes, place: int, size: int) -> BadFrame:
        """A bad frame, as its check code says: what is wrong is found out when somebody asks."""
        stream, raw = self.stream, data[place : place + size]
        started, ended = stream.times_of(place, place + size)
        explain = partial(_fault, info, raw, self._names)
        return BadFrame(info.name, raw, stream.base + stream.removed + place, started, ended, explain)


def _fault(info: FrameInfo, raw: bytes, names: Names) -> Fault:
    return fault_of(info.misread(raw, names))
