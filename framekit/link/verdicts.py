"""What a candidate can be found to be at a place in the stream.

A frame, good or bad, one that wants more bytes, or none at all. It knows neither the stream nor who asks.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from framekit.link.arrivals import BadFrame, EitherBad
from framekit.link.frame_info import FrameInfo


class Good:
    """A complete frame; `refusal` is the code it is to be refused with."""

    __slots__ = ("fields", "info", "raw", "refusal")

    def __init__(self, info: FrameInfo, raw: bytes, fields: dict[str, Any], refusal: int | None) -> None:
        self.info, self.raw, self.fields, self.refusal = info, raw, fields, refusal


class Bad:
    """A frame with a fault. `known_end`: its end does not depend on content that may be damaged.

    `open_at(size)`: of one that grew too long, whether silence could still have ended it with so many bytes.

    Most are never reported, so the report is made when it is asked for, and so is `size` where it takes work; that has
    to be before the place in the stream changes.
    """

    __slots__ = ("_bad", "_report", "_size", "known_end", "open_at")

    def __init__(
        self,
        report: Callable[[], BadFrame],
        size: int | Callable[[], int],
        known_end: bool,
        open_at: Callable[[int], bool] | None = None,
    ) -> None:
        self._report = report
        self.open_at = open_at
        self._bad: BadFrame | None = None
        self._size = size
        self.known_end = known_end

    @property
    def bad(self) -> BadFrame:
        if self._bad is None:
            self._bad = self._report()
        return self._bad

    @property
    def size(self) -> int:
        if not isinstance(self._size, int):
            self._size = self._size()
        return self._size


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


def worse(first: Bad | None, second: Bad) -> Bad:
    """The one that got further; of two that got equally far, the one asked first.

    One that silence could still have ended when the other was complete was none then: the other one is told. Where
    both end at the same place nothing depends on it before it is asked what was wrong.
    """
    if first is None:
        return second
    if first.open_at is not None and first.open_at(second.size):
        return second
    if second.open_at is not None and second.open_at(first.size):
        return first
    if first.size == second.size and first.known_end == second.known_end:
        return Bad(lambda: EitherBad(first.bad, second.bad), first.size, first.known_end)
    return second if second.bad.place > first.bad.place else first
