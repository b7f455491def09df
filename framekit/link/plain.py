"""The quick way to the next thing in a stream where nothing is strange, read as soon as it is there whole.

It finds what looking at every place finds, only sooner; where it is not sure of that, it stops and changes nothing.
"""

from __future__ import annotations

from typing import Any

from framekit.codec.errors import FrameError
from framekit.link.arrivals import Arrival, BadFrame, Noise
from framekit.link.evaluate import CODEC_ERRORS
from framekit.link.frame_info import FrameInfo
from framekit.link.interest import Interest, Left
from framekit.link.rough import UNSURE, WANTING
from framekit.link.rows import RowLooking
from framekit.link.verdicts import Good, Unfinished

Taken = tuple[FrameInfo | None, int, dict[str, Any] | None, FrameError | None]
"""A candidate, its size as `measure` says it, its fields if it is good, its fault if it is bad."""

NOTHING: Taken = (None, 0, None, None)


class PlainLooking(RowLooking):
    """The part of a receiver that takes frames without looking at anything but their bytes."""

    def _plain(self, interest: Interest, found: list[Arrival]) -> bool:
        """Adds the first thing there is to `found` if it is plain; whether more bytes are wanted before anything else.

        A frame counts as handed over.
        """
        if self._is_strange():
            return False
        stream, noise = self.stream, self._noise
        while True:
            left = interest.left(stream.buffer, stream.position)
            if left is None:
                return False
            try:
                taken = self._taken(left)
            except CODEC_ERRORS:
                return False
            info, size, fields, _ = taken
            if info is None or fields is None:
                further = self._beside(found, left, taken)
                if further < 0 or found:
                    return further == WANTING
                continue
            raw = bytes(stream.buffer[stream.position : stream.position + size])
            if self._inside is not None and not (left.alone and left.sure and self._inside.nothing_in(info, raw)):
                return False
            found.append(noise.take() if noise.data else self._arrived(Good(info, raw, fields, None)))
            return False

    def _beside(self, found: list[Arrival], left: Left, taken: Taken) -> int:
        """The next place after one where no good frame begins, or UNSURE or WANTING.

        The first thing that is there comes to `found`, as far as it is anything yet.
        """
        stream, (info, size, _, fault) = self.stream, taken
        if (left.infos and info is None) or stream.silences or self._noise.is_long:
            return UNSURE
        if info is not None:
            place = stream.position
            if self._inside is not None and not (left.sure and self._inside.nothing_from(info, stream.buffer, place)):
                return UNSURE
            if size < 0:
                return self._wanting(info, size)
            if fault is not None and left.sure and stream.base + place >= self._bad_until:
                return self._reported(found, info, size, fault)
        if not left.sure or self._rules.resync == "never":
            return UNSURE
        passed_over = self._unusable()
        if isinstance(passed_over, Noise):
            found.append(passed_over)
        return UNSURE if passed_over is None else stream.position

    def _wanting(self, info: FrameInfo, size: int) -> int:
        """A frame has begun, as its only candidate says by `size`."""
        if size <= self._quiet:
            return UNSURE
        said, had = self._candidates.said, len(self.stream.buffer) - self.stream.position
        before = said.get(info.name)
        said[info.name] = Unfinished(False, had, before.had if type(before) is Unfinished else 0, had - size)
        return WANTING

    def _reported(self, found: list[Arrival], info: FrameInfo, size: int, fault: FrameError) -> int:
        """A bad frame that is a new one, after the noise before it."""
        stream = self.stream
        if not self._goes_on:
            return UNSURE
        if self._noise:
            found.append(self._noise.take())
            return stream.position
        raw = bytes(stream.buffer[stream.position : stream.position + size])
        bad = self._bad(self._candidates.misread(info, raw, fault))
        assert isinstance(bad, BadFrame), "it is a new one, and no noise is before it"
        found.append(bad)
        return stream.position

    # ---- candidates ---------------------------------------------------------------------------------------

    def _taken(self, left: Left) -> Taken:
        """What begins at the present place. Raises what expressions and decoding raise."""
        stream, names, info = self.stream, self._names, left.alone
        if info is None:
            return self._shortest(left) if left.infos else NOTHING
        buffer, place, said = stream.buffer, stream.position, self._candidates.said
        if said:
            before = said.get(info.name)
            if type(before) is not Unfinished or before.silent:
                return info, self._quiet, None, None
            size, guessed = info.measure(buffer, place, len(buffer), names, before.seen), False
        else:
            size, guessed = info.extent(buffer, place, len(buffer), names), info.guesses
        fault: FrameError | None = None
        if size > 0:
            raw = bytes(buffer[place : place + size])
            if info.intact is not None and not info.intact(raw):
                if stream.base + place < self._bad_until:
                    return info, size, None, None  # a bad frame or none: here both are passed over
                fault = info.misread(raw, names)  # what decoding would raise, at a tenth of the cost
            else:
                try:
                    fields = info.decode(raw, names)
                    if not guessed or info.holds_known(fields):
                        return info, size, fields, None
                except FrameError as error:
                    if error.refuse is not None:
                        return info, self._quiet, None, None
                    fault = error.with_traceback(None)
        if guessed:
            size = info.measure(buffer, place, len(buffer), names, 0)
        return info, size, None, fault if size > 0 else None

    def _shortest(self, left: Left) -> Taken:
        """The shortest good frame of several."""
        buffer, names, said = self.stream.buffer, self._names, self._candidates.said
        place, end = self.stream.position, len(buffer)
        whole: list[tuple[int, FrameInfo]] = []
        for info in left.infos:
            before = said.get(info.name)
            if said and (type(before) is not Unfinished or before.silent):
                return NOTHING
            if type(before) is Unfinished and end - place < before.wanted:
                continue
            size = info.measure(buffer, place, end, names, before.seen if type(before) is Unfinished else 0)
            if size > 0:
                whole.append((size, info))
        for size, info in sorted(whole, key=_size_of):
            raw = bytes(buffer[place : place + size])
            if len(whole) == 1 or info.intact is None or info.intact(raw):
                try:
                    return info, size, info.decode(raw, names), None
                except FrameError as error:
                    if error.refuse is not None:
                        break
        return NOTHING


def _size_of(item: tuple[int, FrameInfo]) -> int:
    return item[0]
