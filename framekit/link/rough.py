"""The quick way over noise: place after place where no good frame begins, and bad frames that are to be told.

It says of a place what looking at it with care says; where it is not sure of that, it stops before it.
"""

from __future__ import annotations

from functools import partial

from framekit.link.arrivals import Arrival, BadFrame
from framekit.link.candidates import fault_of
from framekit.link.evaluate import EVALUATION_ERRORS
from framekit.link.frame_info import FrameInfo
from framekit.link.interest import Interest
from framekit.link.looking import Looking
from framekit.link.noise import LONGEST
from framekit.link.verdicts import Unfinished

UNSURE = -1
"""Instead of a place: look at it with care."""

WANTING = -2
"""Instead of a place: more bytes are wanted there before anything can be said."""

GOING_ON = ("next_start", "after_frame")
"""How to go on after a bad frame without waiting for anything."""


class RoughLooking(Looking):
    """The part of a receiver that gets over noise many bytes a turn."""

    def _rough(self, interest: Interest, found: list[Arrival], data: bytes, size: int) -> int:
        """Goes on to the next place where a good frame may begin, or that it is not sure of; or WANTING.

        Noise and bad frames on the way are told. `size`: what `extent` has said of the first place, if that is less
        than 0. Locals and a long loop are for speed, as in rows of good frames.
        """
        stream, noise, starting, inside = self.stream, self._noise, interest.starting, self._inside
        first = place = stream.position
        end = min(len(data), place + LONGEST - len(noise.data))
        bad_until = self._bad_until - stream.base
        skipped = noise.skipped if noise.data else place < bad_until
        wanted: FrameInfo | None = None
        try:
            while place < end:
                start = starting[data[place]] or interest.start(data[place])
                left = start.left.get(data[place + start.at], start.others) if start.at else start.others
                info = left.alone
                if not left.sure or (info is None and left.infos):
                    break
                if info is not None:
                    if inside is not None and not inside.nothing_from(info, data, place):
                        break
                    size = self._rough_size(info, data, place, size, place < bad_until)
                    if size < 0:
                        wanted = info if size > self._quiet else None
                        break
                    if size > 0:
                        self._collect_run(found, first, place, skipped, True)
                        found.append(self._misread(info, data, place, size))
                        bad_until = first = place + size
                        self._bad_until = stream.base + bad_until
                        if self._rules.resync == "after_frame":
                            place, size = first, 0
                            continue
                        first = place
                if skipped is not (place < bad_until):
                    self._collect_run(found, first, place, skipped, True)
                    first, skipped = place, place < bad_until
                behind = self._behind_noise(interest, data, place, bad_until)
                if behind < 0:
                    break
                place, size = behind, 0
        except EVALUATION_ERRORS:
            wanted = None
        self._collect_run(found, first, place, skipped, False)
        if place != stream.position:
            stream.position = place
            self._moved()
        return place if wanted is None else self._wanting(wanted, size)

    def _rough_size(self, info: FrameInfo, data: bytes, place: int, size: int, skipped: bool) -> int:
        """Of a bad frame its size, 0 if it is none that is told; less than 0 as `measure`, QUIET where it is not sure.

        In what a bad frame left (`skipped`) others are none that are told.
        """
        size = size or info.extent(data, place, len(data), self._names)
        if size > 0:
            proof = info.proof
            if proof is None or proof(data[place : place + size]):
                return self._quiet
            if skipped:
                return 0
        if size and info.guesses:
            sure = info.measure(data, place, len(data), self._names, 0)
            return sure if sure <= 0 or sure == size else self._quiet
        return size

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

    def _collect_run(self, found: list[Arrival], start: int, end: int, skipped: bool, ends: bool) -> None:
        """Adds bytes to the run of noise, which `ends` there or goes on."""
        noise = self._noise
        if end > start:
            noise.collect(self.stream, start, end, skipped)
        if ends and noise.data:
            found.append(noise.take())

    def _misread(self, info: FrameInfo, data: bytes, place: int, size: int) -> BadFrame:
        """A bad frame, as its check code says: what is wrong is found out when somebody asks."""
        raw = data[place : place + size]
        return self._candidates.told(info, raw, place, partial(fault_of, info.misread(raw, self._names)))

    def _wanting(self, info: FrameInfo, size: int) -> int:
        """A frame has begun, as its only candidate says by `size`."""
        if size <= self._quiet:
            return UNSURE
        said, had = self._candidates.said, len(self.stream.buffer) - self.stream.position
        before = said.get(info.name)
        said[info.name] = Unfinished(False, had, before.had if type(before) is Unfinished else 0, had - size)
        return WANTING
