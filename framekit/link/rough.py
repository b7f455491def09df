"""The quick way over noise: place after place where no good frame begins, and bad frames that are to be told.

It says of a place what looking at it with care says; where it is not sure of that, it stops before it.
"""

from __future__ import annotations

from functools import partial

from framekit.link.arrivals import Arrival, BadFrame, Fault, Noise
from framekit.link.candidates import fault_of
from framekit.link.evaluate import EVALUATION_ERRORS, Names
from framekit.link.frame_info import FrameInfo
from framekit.link.interest import Interest
from framekit.link.looking import Looking
from framekit.link.noise import LONGEST
from framekit.link.verdicts import Unfinished

UNSURE = -1
"""Instead of a place: look at it with care."""

WANTING = -2
"""Instead of a place: more bytes are wanted there before anything can be said."""

NOTHING = -3
"""Instead of a place: nothing is left."""

GOING_ON = ("next_start", "after_frame")
"""How to go on after a bad frame without waiting for anything."""


new_tuple = tuple.__new__
"""Makes a named tuple in a quarter of the time that calling its class takes."""


class RoughLooking(Looking):
    """The part of a receiver that gets over noise many bytes a turn."""

    def _rough(self, interest: Interest, found: list[Arrival], data: bytes, size: int) -> int:
        """Goes on to the next place where a good frame may begin, or that it is not sure of; or WANTING.

        Noise and bad frames on the way are told. `size`: what `extent` has said of the first place, if that is less
        than 0. Locals and a long loop are for speed, as in rows of good frames.
        """
        stream, noise, starting, inside = self.stream, self._noise, interest.starting, self._inside
        first = place = stream.position
        total, names = len(data), self._names
        end = min(total, place + LONGEST - len(noise.data))
        bad_until = self._bad_until - stream.base
        skipped = noise.skipped if noise.data else place < bad_until
        simple = interest.starts is None and self._rules.symbols is None
        known = wanted = proof = None
        try:
            while place < end:
                start = starting[data[place]] or interest.start(data[place])
                left = start.left[data[place + start.at]]
                info = left.alone
                if not left.is_clear:
                    break
                if inside is not None and info is not None and not inside.nothing_from(info, data, place):
                    break
                size = 0 if info is None else size or info.extent(data, place, total, names)
                if size and info is not None:
                    if info is not known:
                        known, proof = info, info.proof
                    if size > 0 and (proof is None or proof(data[place : place + size])):
                        break
                    if size < 0 or place >= bad_until:
                        size = info.checked(data, place, size, names)
                    else:
                        size = 0  # a bad frame or none: here both are passed over
                    if size < 0:
                        wanted = info if size > self._quiet else None
                        break
                    if size > 0:
                        self._end_run(found, data, first, place, skipped)
                        found.append(self._misread(info, data, place, size))
                        bad_until = first = place + size
                        self._bad_until = stream.base + bad_until
                        if self._rules.resync == "after_frame":
                            place, size = first, 0
                            continue
                        first, skipped = place, True
                if skipped is not (place < bad_until):
                    self._end_run(found, data, first, place, skipped)
                    first, skipped = place, not skipped
                behind = place + 1 if simple else self._behind_noise(interest, data, place, bad_until)
                if behind < 0:
                    break
                place, size = behind, 0
        except EVALUATION_ERRORS:
            wanted = None
        if place > first:
            noise.collect(stream, first, place, skipped)
        if place != stream.position:
            stream.position = place
            self._moved()
        return place if wanted is None else self._wanting(wanted, size)

    def _behind_noise(self, interest: Interest, data: bytes, place: int, bad_until: int) -> int:
        """How far nothing begins if nothing begins at `place`; UNSURE where that takes another byte."""
        symbols = self._rules.symbols
        if data[place] == symbols:
            return place + 2 if place + 1 < len(data) else UNSURE
        if interest.starts is None:
            return place + 1
        match = interest.starts.search(data, place + 1)
        behind = len(data) if match is None else match.start()
        if symbols is not None:
            escape = data.find(symbols, place + 1, behind)
            behind = behind if escape < 0 else escape
        return bad_until if place < bad_until < behind else behind

    def _end_run(self, found: list[Arrival], data: bytes, start: int, end: int, skipped: bool) -> None:
        """The run of noise ends: what was known of it, and `data[start:end]`."""
        stream, noise = self.stream, self._noise
        if not noise.data:
            if end > start:
                offset = stream.offset - stream.position + start
                started, ended = stream.times_of(start, end)
                found.append(new_tuple(Noise, (data[start:end], offset, started, ended, skipped)))
            return
        if end > start:
            noise.collect(stream, start, end, skipped)
        found.append(noise.take())

    def _misread(self, info: FrameInfo, data: bytes, place: int, size: int) -> BadFrame:
        """A bad frame, as its check code says: what is wrong is found out when somebody asks."""
        raw = data[place : place + size]
        return self._candidates.told(info, raw, place, partial(_fault, info, raw, self._names))

    def _wanting(self, info: FrameInfo, size: int) -> int:
        """A frame has begun, as its only candidate says by `size`."""
        if size <= self._quiet:
            return UNSURE
        said, had = self._candidates.said, len(self.stream.buffer) - self.stream.position
        before = said.get(info.name)
        said[info.name] = Unfinished(False, had, before.had if type(before) is Unfinished else 0, had - size)
        return WANTING


def _fault(info: FrameInfo, raw: bytes, names: Names) -> Fault:
    return fault_of(info.misread(raw, names))
