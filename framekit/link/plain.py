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
from framekit.link.noise import LONGEST
from framekit.link.values import FrameValue
from framekit.link.verdicts import Good, Unfinished

UNSURE = -1
"""Instead of a place: look at it with care."""

WANTING = -2
"""Instead of a place: more bytes are wanted there before anything can be said."""

GOING_ON = ("next_start", "after_frame")
"""How to go on after a bad frame without waiting for anything."""

new_tuple = tuple.__new__
"""Makes a named tuple in a quarter of the time that calling its class takes."""

Taken = tuple[FrameInfo | None, int, dict[str, Any] | None, FrameError | None]
"""A candidate, its size as `measure` says it, its fields if it is good, its fault if it is bad."""

NOTHING: Taken = (None, 0, None, None)


class PlainLooking(Looking):
    """The part of a receiver that takes frames without looking at anything but their bytes."""

    def _plain(self, interest: Interest, found: list[Arrival], data: bytes | None = None) -> bool:
        """Adds what there is to `found` as long as it is plain; whether more bytes are wanted before anything else.

        `data` are the bytes of the stream's buffer; all frames in it count as used. Without it the first thing found
        is added, and a frame counts as handed over.
        """
        if self._is_strange():
            return False
        stream, noise, one = self.stream, self._noise, data is None
        while True:
            size = 0
            if data is not None:
                if noise.data and interest.starts is None:
                    self._noise_row(interest, data)
                place, size = self._row(interest, found, data)
                self._go_to(place)
            left = interest.left(stream.buffer, stream.position)
            if left is None:
                return False
            try:
                taken = self._taken(left, size)
            except EVALUATION_ERRORS:
                return False
            info, size, fields, _ = taken
            if info is None or fields is None:
                further = self._beside(found, left, taken, one)
                if further < 0 or (one and found):
                    return further == WANTING
                continue
            raw = bytes(stream.buffer[stream.position : stream.position + size])
            if self._inside is not None and not (left.alone and left.sure and self._inside.nothing_in(info, raw)):
                return False
            if noise.data:
                found.append(noise.take())
                if one:
                    return False
            found.append(self._arrived(Good(info, raw, fields, None), False))
            if one:
                return False
            self._use()

    def _row(self, interest: Interest, found: list[Arrival], data: bytes) -> tuple[int, int]:
        """Adds the good frames that stand in a row, and noise before them; gives the place behind them.

        And what `extent` said there, if that is less than 0.

        Locals and a long loop are for speed: a frame is to cost little more than its decoding.
        """
        stream, names, starting = self.stream, self._names, interest.starting
        place, end, offset = stream.position, len(data), stream.offset - stream.position
        until = at = 0
        add, noise = found.append, self._noise
        try:
            while place < end:
                start = starting[data[place]] or interest.start(data[place])
                left = start.left.get(data[place + start.at], start.others) if start.at else start.others
                if left.take is None:
                    break
                constant, extent, decode, name, refuse, inner, filling, search = left.take
                if constant is not None and data.startswith(constant, place):
                    raw, fields = constant, {}
                    behind = place + len(raw)
                else:
                    size = extent(data, place, end, names)
                    if size <= 0:
                        return place, size
                    behind = place + size
                    raw = data[place:behind]
                    if noise.data and (left.alone is None or (left.alone.proof and not left.alone.proof(raw))):
                        break  # so close behind noise it is no frame most of the time, and raising costs much
                    fields = decode(raw, names)
                    if (inner is not None and "unknown" in fields[inner]) or (search is not None and search(raw)):
                        break
                if place >= until:
                    until, at = stream.piece_of(place)
                started = at
                if behind > until:
                    until, at = stream.piece_of(behind - 1)
                if noise.data:
                    add(noise.take())
                value = FrameValue(name, fields, raw, refuse)
                add(new_tuple(FrameArrived, (value, raw, offset + place, started, at, False, filling)))
                place = behind
        except EVALUATION_ERRORS:
            return place, 0
        return place, 0

    def _noise_row(self, interest: Interest, data: bytes) -> None:
        """Goes on with a run of noise over places where surely nothing begins that would be told of."""
        stream, noise, names, starting = self.stream, self._noise, self._names, interest.starting
        first = place = stream.position
        bad_until = self._bad_until - stream.base
        skipped = place < bad_until
        if noise.skipped is not skipped or self._rules.symbols is not None or self._rules.resync not in GOING_ON:
            return
        end = min(len(data), place + LONGEST - len(noise.data), bad_until if skipped else len(data))
        try:
            while place < end:
                start = starting[data[place]] or interest.start(data[place])
                left = start.left.get(data[place + start.at], start.others) if start.at else start.others
                info = left.alone
                if not left.sure or (left.infos and info is None) or self._inside is not None:
                    break
                if info is not None:
                    size = info.extent(data, place, len(data), names)
                    if size < 0 or (
                        size > 0 and not (skipped and info.proof and not info.proof(data[place : place + size]))
                    ):
                        break
                place += 1
        except EVALUATION_ERRORS:
            pass
        if place > first and not self._candidates.said:
            self._collect(place - first, skipped)

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

    def _beside(self, found: list[Arrival], left: Left, taken: Taken, one: bool) -> int:
        """The next place after one where no good frame begins, or UNSURE or WANTING.

        What begins there comes to `found`, as far as it is anything yet; only the first if it is to be `one`.
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
                return self._reported(found, info, size, fault, one)
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

    def _reported(self, found: list[Arrival], info: FrameInfo, size: int, fault: FrameError, one: bool) -> int:
        """A bad frame that is a new one, after the noise before it."""
        stream = self.stream
        if self._rules.resync not in GOING_ON:
            return UNSURE
        if self._noise:
            found.append(self._noise.take())
            if one:
                return stream.position
        raw = bytes(stream.buffer[stream.position : stream.position + size])
        bad = self._bad(self._candidates.misread(info, raw, fault))
        assert isinstance(bad, BadFrame), "it is a new one, and no noise is before it"
        found.append(bad)
        return stream.position

    # ---- candidates ---------------------------------------------------------------------------------------

    def _taken(self, left: Left, size: int) -> Taken:
        """What begins at the present place. Raises what expressions and decoding raise.

        `size` is what `extent` said, if that has been asked already and wants more.
        """
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
            size, guessed = size or info.extent(buffer, place, len(buffer), names), info.guesses
        fault: FrameError | None = None
        if size > 0:
            raw = bytes(buffer[place : place + size])
            if info.proof is not None and not info.proof(raw):
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
