"""The bad frame that a receiver reports where no candidate at a position is good.

Every candidate is measured and read again, with all details. That is slow, so a receiver asks only for bad frames that
it reports; of a crowd of bad frames it reports a part.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from operator import itemgetter

from framekit.codec.errors import FrameError
from framekit.link.arrivals import ONLY_CHECK, AnyBad, BadFrame, Fault, furthest_of
from framekit.link.candidates import Levels
from framekit.link.events import LineFault
from framekit.link.frame_table import FrameInfo
from framekit.link.stream import Marks, Stream, marked_in
from framekit.link.values import CODEC_ERRORS, Names

Complete = tuple[int, int, FrameInfo]
"""A complete frame: its size, its index in its level, the frame."""

Trouble = Callable[[str, Exception], None]
"""Called with a frame's name and the error if an expression of the frame cannot be evaluated."""


class BadCandidate:
    """A bad frame, and what decides which of several bad frames is reported."""

    __slots__ = ("frame", "has_end", "open_at", "size")

    def __init__(self, frame: BadFrame, size: int, has_end: bool, open_at: Callable[[int], bool] | None = None) -> None:
        self.frame = frame
        self.size = size
        self.has_end = has_end
        """Whether the end of the frame is independent of content that may be damaged."""
        self.open_at = open_at
        """Of a frame that grew too long: whether silence could still end it at a size."""


class BadFrames:
    """Finds the bad frame to report at the stream's position."""

    __slots__ = ("_lost", "_names", "_quiet", "_stream", "_trouble", "marks")

    def __init__(self, stream: Stream, names: Names, quiet: int, lost: int, trouble: Trouble) -> None:
        self._stream, self._names, self._trouble = stream, names, trouble
        self._quiet, self._lost = quiet, lost
        self.marks: Marks | None = None
        """The ninth bits of the stream, on a line that has them."""

    def worst(self, levels: Levels, limit: int, reach_of: Callable[[FrameInfo], int], at_once: bool) -> BadCandidate:
        """Return the bad frame that got furthest; one of the candidates has to be bad.

        `reach_of`: the buffer index up to which each candidate is measured. `at_once`: a bad frame is reported before
        a longer frame that lacks a byte within the size of the bad frame.
        """
        bad_by_level: list[Sequence[BadCandidate]] = []
        shortest: int | None = None
        for level in levels:
            bad, complete, wanting, is_silent = self._measured(level.infos, reach_of)
            if self.marks is not None:
                complete = self._marked(complete, bool(bad or wanting or is_silent))
            for size, _, info in complete:
                if not (at_once and self._lacks(info, shortest, size)):
                    bad.append(self.complete(info, size))
                    if (shortest is None or size < shortest) and self._fits(info, size):
                        shortest = size
            if bad:
                bad_by_level.append(bad)
            elif wanting and not bad_by_level:
                bad_by_level.append((self._cut(wanting[0], limit),))
        return furthest(bad_by_level) if bad_by_level else self._cut(levels[0].infos[0], limit)

    def _measured(
        self, infos: Iterable[FrameInfo], reach_of: Callable[[FrameInfo], int]
    ) -> tuple[list[BadCandidate], list[Complete], list[FrameInfo], bool]:
        """Measure candidates: return those without an end, complete, incomplete; and whether silence ends others."""
        bad: list[BadCandidate] = []
        complete: list[Complete] = []
        wanting: list[FrameInfo] = []
        is_silent = False
        for number, info in enumerate(infos):
            size = self._measure(info, reach_of(info))
            if size > 0:
                complete.append((size, number, info))
            elif size == self._lost:
                bad.append(self._without_end(info, reach_of(info)))
            elif size == self._quiet:
                is_silent = True
            elif size:
                wanting.append(info)
        complete.sort(key=itemgetter(0, 1))
        return bad, complete, wanting, is_silent

    def _marked(self, complete: list[Complete], is_other: bool) -> list[Complete]:
        """Return the complete frames with the mark at their end; if no candidate is left, the first of all."""
        marks = self.marks
        marked = [one for one in complete if marks is None or marks.ends(one[2], one[0])]
        return marked if marked or is_other else sorted(complete, key=itemgetter(1))[:1]

    def complete(self, info: FrameInfo, size: int) -> BadCandidate:
        """Return a complete frame of `size` bytes as bad."""
        start = self._stream.position
        raw = bytes(self._stream.buffer[start : start + size])
        fault = self._stream.fault_in(start, start + size)
        if fault is not None:
            return self._bad(info, raw, partial(_damaged, fault), True)
        if self.marks is not None and (wrong := self.marks.wrong_in(info, start, start + size)) is not None:
            return self._wrongly_marked(info, raw, wrong)
        if info.intact is not None and not info.intact(raw):
            error: Exception = info.misread(raw, self._names)
            return self._bad(info, raw, partial(_fault_of, error), True)
        return self._decoded(info, raw, True)

    def at_silence(self, infos: Iterable[FrameInfo], end_for: Callable[[FrameInfo], int]) -> BadCandidate:
        """Return the bad frame that got furthest, of frames that silence ends."""
        bad = [self._ended(info, end_for(info)) for info in infos]
        return furthest((bad,))

    def _ended(self, info: FrameInfo, end: int) -> BadCandidate:
        """Return a frame that silence or a break ends at buffer index `end` as bad."""
        start = self._stream.position
        if not self.is_broken(info, end) or self._stream.fault_in(start, end) is not None:
            return self.complete(info, end - start)
        raw = bytes(self._stream.buffer[start:end])
        return self._bad(info, raw, partial(_cut_off, len(raw), "a break"), False)

    def is_broken(self, info: FrameInfo, end: int) -> bool:
        """Return whether a break, a fault of the line, is the only end of a frame at buffer index `end`."""
        stream, marks = self._stream, self.marks
        if stream.broken_at != stream.base + end or info.is_checked:
            return False
        return marks is None or not marks.stops(info, end)

    def _lacks(self, info: FrameInfo, shortest: int | None, size: int) -> bool:
        """Return whether a frame of fixed size lacks a constant byte within the first `shortest` bytes."""
        return shortest is not None and info.is_fixed and size > shortest and not self._fits(info, shortest)

    def _fits(self, info: FrameInfo, size: int) -> bool:
        return info.fits(self._stream.buffer, self._stream.position, size) == size

    def _measure(self, info: FrameInfo, end: int) -> int:
        try:
            return info.measure(self._stream.buffer, self._stream.position, end, self._names, 0)
        except CODEC_ERRORS:
            return 0

    # ---- faults of a frame ----------------------------------------------------------------------------------

    def _decoded(self, info: FrameInfo, raw: bytes, has_end: bool) -> BadCandidate:
        """Return a frame as bad for the reason that decoding gives."""
        try:
            info.decode(raw, self._names)
        except CODEC_ERRORS as error:
            if isinstance(error, FrameError) and error.refuse is not None:
                return self._bad(info, raw, _endless, has_end)
            if not (isinstance(error, FrameError) or has_end):  # a frame with an end has been read before
                self._trouble(info.name, error)
            return self._bad(info, raw, partial(_fault_of, error), has_end)
        return self._bad(info, raw, _endless, has_end)

    def _cut(self, info: FrameInfo, limit: int) -> BadCandidate:
        """Return a frame that is incomplete at buffer index `limit` as bad."""
        stream, marks, start = self._stream, self.marks, self._stream.position
        end = limit if marks is None else marks.end_for(info, limit)
        raw = bytes(stream.buffer[start:end])
        fault = stream.fault_in(start, end)
        wrong = None if marks is None else marks.wrong_in(info, start, end)
        if fault is None and wrong is not None:
            return self._wrongly_marked(info, raw, wrong)
        what = "a pause" if marks is None or marks.next(end) != end else "the first byte of another frame"
        what = "a break" if stream.broken_at == stream.base + end else what
        found = _cut_off(len(raw), what, "cut" if fault is None else fault.value)
        return self._bad(info, raw, partial(self._broken_off, info, raw, found), False)

    def _broken_off(self, info: FrameInfo, raw: bytes, found: Fault) -> Fault:
        """Return the wrong check code of an incomplete frame that ends like a complete frame, else `found`."""
        if found.cause == "cut":
            try:
                info.decode(raw, self._names)
            except CODEC_ERRORS as error:
                if isinstance(error, FrameError) and error.cause == "check" and error.also is None:
                    return _fault_of(error)
        return found

    def _without_end(self, info: FrameInfo, end: int) -> BadCandidate:
        """Return a frame without an end up to buffer index `end` as bad, with the fewest bytes that prove it."""
        start = self._stream.position
        low, high = start + 1, end
        while low < high:
            middle = (low + high) // 2
            if self._measure(info, middle) == self._lost:
                high = middle
            else:
                low = middle + 1
        raw = bytes(self._stream.buffer[start:low])
        fault = self._stream.fault_in(start, low)
        if fault is not None:
            bad = self._bad(info, raw, partial(_damaged, fault), False)
        else:
            bad = self._decoded(info, raw, False)
        bad.frame.limit = min(bad.frame.limit, bad.size - 1)  # the last byte shows the fault
        bad.open_at = lambda size: self._measure(info, start + size) == self._quiet
        return bad

    def _wrongly_marked(self, info: FrameInfo, raw: bytes, wrong: int) -> BadCandidate:
        """Return a frame as bad in which the ninth bit of the byte at `wrong` has the other value."""
        expected, found = "no mark", "a mark"
        if wrong == marked_in(info, len(raw)):
            expected, found = found, expected
        return self._bad(info, raw, lambda: Fault("mark", "", wrong, expected, found, reach=wrong), True)

    def _bad(self, info: FrameInfo, raw: bytes, explain: Callable[[], Fault], has_end: bool) -> BadCandidate:
        stream = self._stream
        start = stream.position
        started, ended = stream.times_of(start, start + max(len(raw), 1))
        fits = len(raw) if info.frame.inside else info.fits(raw, 0, len(raw))
        limit = fits if fits < len(raw) else ONLY_CHECK
        frame = BadFrame(info.name, raw, stream.offset_of(start), started, ended, explain, limit)
        return BadCandidate(frame, len(raw), has_end)


def _damaged(fault: LineFault) -> Fault:
    return Fault(fault.value, found="a damaged character")


def _cut_off(size: int, what: str, cause: str = "cut") -> Fault:
    return Fault(cause, place=size, expected="more bytes", found=what, reach=size)


def _endless() -> Fault:
    return Fault("length", expected="a findable end", found="none")


def _fault_of(error: Exception) -> Fault:
    """Return the fault that decoding has raised."""
    if not isinstance(error, FrameError):
        return Fault("value", expected="values that fit together")
    other = error.also if error.cause == "check" else error
    reach = ONLY_CHECK if other is None else other.offset
    return Fault(error.cause, error.segment, error.offset, error.expected, error.found, str(error), reach)


def furthest(levels: Sequence[Sequence[BadCandidate]]) -> BadCandidate:
    """Return the bad frame to report: of the expected frames, of the other frames …, each in the order of the rows.

    It is the frame that was right furthest; of equal frames a frame with all its fixed bytes, then the longest, then
    the first. So the choice depends on the bytes, not on when the candidates became complete. Where all frames end at
    the same place, the choice is made when the fault is asked for.
    """
    if len(levels) == 1 == len(levels[0]):
        return levels[0][0]
    bad = [one for level in levels for one in level]
    last = _without_open(bad)
    ranked = sorted(
        (one for one in bad if one.size <= last), key=lambda one: (-one.frame.limit, -one.size, not one.has_end)
    )
    first, frames = ranked[0], [one.frame for one in ranked]
    if len({(one.size, one.has_end) for one in ranked}) == 1:
        return first if len(ranked) == 1 else BadCandidate(AnyBad(frames), first.size, first.has_end)
    return ranked[frames.index(furthest_of(frames))]


def _without_open(bad: Sequence[BadCandidate]) -> int:
    """Return the size up to which frames were bad when the first of them was to be reported.

    Then every longer frame waited only for a silence, which could still have ended it.
    """
    sizes = sorted({one.size for one in bad})
    for last in sizes[:-1]:
        if all(one.open_at is not None and one.open_at(last) for one in bad if one.size > last):
            return last
    return sizes[-1]
