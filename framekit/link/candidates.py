"""One candidate at one place: does it begin here, want more, fit, or have a fault?

Remembers what each candidate said, so that it is asked again only when the bytes it lacked are there. It knows what
codecs answer (`measure`, `decode`) and nothing of who waits for what.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from framekit.codec.errors import FrameError
from framekit.link.arrivals import BadFrame
from framekit.link.evaluate import EVALUATION_ERRORS, Names
from framekit.link.frame_table import FrameInfo
from framekit.link.inside import InsideFinder
from framekit.link.stream import Stream


class Good:
    """A complete frame; `refusal` is the code it is to be refused with."""

    __slots__ = ("fields", "info", "raw", "refusal")

    def __init__(self, info: FrameInfo, raw: bytes, fields: dict[str, Any], refusal: int | None) -> None:
        self.info, self.raw, self.fields, self.refusal = info, raw, fields, refusal


class Bad:
    """A frame with a fault. `known_end`: its end does not depend on content that may be damaged.

    What the fault is costs much more to find out than that there is one, so it is found out when somebody asks; that
    has to be before the place in the stream changes.
    """

    __slots__ = ("_bad", "_report", "known_end")

    def __init__(self, report: Callable[[], BadFrame], known_end: bool) -> None:
        self._report = report
        self._bad: BadFrame | None = None
        self.known_end = known_end

    @property
    def bad(self) -> BadFrame:
        if self._bad is None:
            self._bad = self._report()
        return self._bad


class Complete:
    """All its `size` bytes are there; whether anything is wrong with them has not been looked at yet."""

    __slots__ = ("size",)

    def __init__(self, size: int) -> None:
        self.size = size


class Unfinished:
    """Fits so far and wants more, or, if `silent`, waits for a silence.

    Its end does not stand in the first `seen` bytes. It may have found its end and lack only what follows: what it
    had at the call before is what is certain, so `seen` is one call behind `had`. With fewer than `wanted` bytes it is
    surely not complete.
    """

    __slots__ = ("had", "seen", "silent", "wanted")

    def __init__(self, silent: bool, had: int, seen: int, wanted: int) -> None:
        self.silent, self.had, self.seen, self.wanted = silent, had, seen, wanted


class _No:
    __slots__ = ()


NO = _No()
Result = Good | Bad | Complete | Unfinished | _No
Trouble = Callable[[str, Exception], None]
"""Told about an expression of a frame that could not be worked out: the frame's name and what happened."""


class Candidates:
    """What candidates said about the current place (`said`, by their names); `forget` when the place changes."""

    __slots__ = ("_context", "_lost", "_quiet", "_stream", "_trouble", "said")

    def __init__(self, stream: Stream, context: Names, quiet: int, lost: int, trouble: Trouble) -> None:
        self._stream = stream
        self._context = context
        self._quiet = quiet
        self._lost = lost
        self._trouble = trouble
        self.said: dict[str, Result] = {}

    def forget(self) -> None:
        if self.said:
            self.said = {}

    def ask(self, info: FrameInfo, end: int) -> Result:
        """What `info` is at the current place, with the bytes up to buffer index `end`."""
        said = self.said.get(info.name)
        stream = self._stream
        position = stream.position
        seen = before = 0
        if said is not None:
            if type(said) is not Unfinished or end - position <= said.had:
                return said
            seen, before = said.seen, said.had
        try:
            length = info.measure(stream.buffer, position, end, self._context, seen)
        except EVALUATION_ERRORS as error:
            self._trouble(info.name, error)
            length = 0
        result: Result
        if length > 0:
            result = Complete(length)
        elif length == 0:
            result = NO
        elif length == self._lost:
            result = self._without_end(info, position, end)
        else:
            silent = length == self._quiet
            result = Unfinished(silent, end - position, before, 0 if silent else end - position - length)
        self.said[info.name] = result
        return result

    def read(self, info: FrameInfo, complete: Complete) -> Result:
        """What a complete candidate holds: a good frame or a bad one."""
        position = self._stream.position
        result = self.said[info.name] = self._read(info, position, position + complete.size)
        return result

    def judge(
        self, infos: tuple[FrameInfo, ...], limit: int, silent: list[FrameInfo], inside: InsideFinder | None
    ) -> tuple[Good | None, Bad | None, list[FrameInfo]]:
        """The good frame of these, the bad one that got furthest, and those that want more than there is up to `limit`.

        The shortest good frame is taken, of equally long ones the first: as if the bytes had come one by one. Those
        that silence ends are added to `silent`.
        """
        complete: list[tuple[int, int, FrameInfo, Complete]] = []
        wanting: list[FrameInfo] = []
        furthest: Bad | None = None
        shortest: Good | None = None
        for place, info in enumerate(infos):
            end = limit if inside is None else inside.end_for(info.name, limit, self._stream.base)
            result = self.ask(info, end)
            if type(result) is Complete:
                complete.append((result.size, place, info, result))
            elif type(result) is Unfinished:
                (silent if result.silent else wanting).append(info)
            elif type(result) is Bad:
                furthest = worse(furthest, result)
            elif type(result) is Good and (shortest is None or len(result.raw) < len(shortest.raw)):
                shortest = result
        for size, _, info, found in sorted(complete, key=_by_size):
            if shortest is not None and size >= len(shortest.raw):
                break
            result = self.read(info, found)
            if type(result) is Good:
                return result, furthest, wanting
            if type(result) is Bad:
                furthest = worse(furthest, result)
        return shortest, furthest, wanting

    def at_silence(self, info: FrameInfo, end: int) -> Result:
        """A frame that silence ends, ended at buffer index `end`."""
        result = self._read(info, self._stream.position, end)
        self.said[info.name] = result
        return result

    def _read(self, info: FrameInfo, start: int, end: int) -> Result:
        raw = bytes(self._stream.buffer[start:end])
        fault = self._stream.fault_in(start, end)
        if fault is not None:
            return self._bad(info, raw, fault.value, found="a damaged character", known_end=True)
        try:
            return Good(info, raw, info.decode(raw, self._context), None)
        except EVALUATION_ERRORS as error:
            return self._judged(info, raw, error, True)

    def _judged(self, info: FrameInfo, raw: bytes, error: Exception, known_end: bool) -> Result:
        if not isinstance(error, FrameError):
            self._trouble(info.name, error)
            return NO
        if error.refuse is not None:
            return Good(info, raw, dict(error.fields), error.refuse)
        return Bad(partial(self._misread, info, raw, error), known_end)

    def _misread(self, info: FrameInfo, raw: bytes, error: FrameError) -> BadFrame:
        return self._report(
            info,
            raw,
            error.cause,
            segment=error.segment,
            place=error.offset,
            expected=error.expected,
            found=error.found,
            message=str(error),
        )

    def _bad(
        self, info: FrameInfo, raw: bytes, cause: str, *, expected: str = "", found: str = "",
        place: int = 0, known_end: bool = False,
    ) -> Bad:  # fmt: skip
        return Bad(partial(self._report, info, raw, cause, expected=expected, found=found, place=place), known_end)

    def _without_end(self, info: FrameInfo, start: int, end: int) -> Result:
        """A frame whose end is lost: the fewest bytes that show it, however many came at once."""
        low, high = start + 1, end
        while low < high:
            middle = (low + high) // 2
            if info.measure(self._stream.buffer, start, middle, self._context, 0) == self._lost:
                high = middle
            else:
                low = middle + 1
        raw = bytes(self._stream.buffer[start:low])
        fault = self._stream.fault_in(start, low)
        if fault is not None:
            return self._bad(info, raw, fault.value, found="a damaged character")
        try:
            info.decode(raw, self._context)
        except EVALUATION_ERRORS as error:
            judged = self._judged(info, raw, error, False)
            return judged if isinstance(judged, (Bad, _No)) else self._endless(info, raw)
        return self._endless(info, raw)

    def _endless(self, info: FrameInfo, raw: bytes) -> Bad:
        return self._bad(info, raw, "length", expected="a findable end", found="none")

    def cut(self, info: FrameInfo, end: int) -> Bad:
        """A frame that fitted and was broken off before buffer index `end`."""
        start = self._stream.position
        raw = bytes(self._stream.buffer[start:end])
        fault = self._stream.fault_in(start, end)
        cause = "cut" if fault is None else fault.value
        return self._bad(info, raw, cause, expected="more bytes", found="a pause", place=len(raw))

    def _report(
        self, info: FrameInfo, raw: bytes, cause: str, *, segment: str = "", place: int = 0,
        expected: str = "", found: str = "", message: str = "",
    ) -> BadFrame:  # fmt: skip
        stream = self._stream
        start = stream.position
        return BadFrame(
            frame=info.name,
            cause=cause,
            segment=segment,
            offset=stream.offset,
            expected=expected,
            found=found,
            raw=raw,
            started_at=stream.time_of(start),
            ended_at=stream.time_of(start + len(raw) - 1) if raw else stream.time_of(start),
            place=place,
            message=message,
        )


def _by_size(item: tuple[int, int, FrameInfo, Complete]) -> tuple[int, int]:
    return item[0], item[1]


def worse(first: Bad | None, second: Bad) -> Bad:
    """The one that got further; of two that got equally far, the one asked first."""
    return second if first is None or second.bad.place > first.bad.place else first
