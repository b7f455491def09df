"""What a receiver finds in a stream: frames, bad frames, and bytes that belong to nothing.

Offsets count the bytes of the stream from its start; times are when the first and the last byte came.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from framekit.link.values import FrameValue


class FrameArrived:
    """A good frame, or one that is to be refused (`value.refusal`). `times`: when its first and last byte came.

    `decoded`: its fields, frames inside as the codec gives them; `make` makes a value of them, taking a refusal.
    `value` is the frame. It is made on demand, unless it has been given: many frames a turn are cheaper so.
    Its maker sets all attributes but that, which takes half the time of an `__init__` or a named tuple.
    """

    __slots__ = ("decoded", "make", "offset", "raw", "times", "value")

    make: Callable[[dict[str, Any], bytes, int | None], FrameValue]
    decoded: dict[str, Any]
    raw: bytes
    offset: int
    times: tuple[int, int]
    value: FrameValue

    @property
    def started_at(self) -> int:
        return self.times[0]

    @property
    def ended_at(self) -> int:
        return self.times[1]

    def __getattr__(self, name: str) -> Any:
        """Only asked for what is not known yet."""
        if name != "value":
            raise AttributeError(name)
        self.value = self.make(self.decoded, self.raw, None)
        return self.value

    def __repr__(self) -> str:
        return f"<frame of {len(self.raw)} bytes at {self.offset}>"


ONLY_CHECK = sys.maxsize
"""The reach of a frame of which nothing but the check code is wrong."""


class Fault(NamedTuple):
    """What is wrong with a frame, and where."""

    cause: str
    segment: str = ""
    place: int = 0
    expected: str = ""
    found: str = ""
    message: str = ""
    reach: int = 0
    """How far the bytes are right: up to the first fault but a check code; `ONLY_CHECK` if only that is wrong."""


class BadFrame:
    """A frame with a fault that is not to be answered as a refusal.

    `cause`: check parity framing overrun mark constant where digits value range require short too_long length surplus
    cut.
    `segment` and `place` say where in the frame (name or kind; byte offset), `expected` and `found` what was wrong.
    These cost much more to find out than that there is a fault: they are found out on demand, which has to be
    before a variable or parameter changes that the frame depends on.
    """

    __slots__ = (
        "_explain", "cause", "ended_at", "expected", "found", "frame", "limit", "message", "offset", "place", "raw",
        "reach", "segment", "started_at",
    )  # fmt: skip

    cause: str
    segment: str
    place: int
    expected: str
    found: str
    message: str
    reach: int
    limit: int
    """The greatest reach that it can have: the first place with a byte that the frame never has there."""

    def __init__(
        self,
        frame: str,
        raw: bytes,
        offset: int,
        started_at: int,
        ended_at: int,
        explain: Callable[[], Fault],
        limit: int = ONLY_CHECK,
    ) -> None:
        self.frame, self.raw, self.offset = frame, raw, offset
        self.started_at, self.ended_at = started_at, ended_at
        self._explain = explain
        self.limit = limit

    def __getattr__(self, name: str) -> Any:
        """Only asked for what is not known yet."""
        if name not in Fault._fields:
            raise AttributeError(name)
        for field, value in zip(Fault._fields, self._explain(), strict=True):
            setattr(self, field, value)
        if self.reach > self.limit:
            self.reach = self.limit
        return object.__getattribute__(self, name)

    def __repr__(self) -> str:
        return f"<bad {self.frame} at {self.offset}: {self.message or self.cause}>"


def furthest_of(frames: Sequence[BadFrame]) -> BadFrame:
    """Return the frame that was right furthest, of equals the first; `frames` are in the order of their limits.

    No more of them are read than the choice takes: none whose limit others have reached.
    """
    furthest = frames[0]
    for frame in frames[1:]:
        if frame.limit <= furthest.reach:
            break
        if frame.reach > furthest.reach:
            furthest = frame
    return furthest


class AnyBad(BadFrame):
    """Bytes that may have been any of several frames in the order of their limits: on demand, which was right furthest.

    Together with it is found out all that is wrong with them.
    """

    __slots__ = ("_frames",)

    def __init__(self, frames: Sequence[BadFrame]) -> None:
        first, self._frames = frames[0], frames
        self.raw, self.offset, self.limit = first.raw, first.offset, first.limit
        self.started_at, self.ended_at = first.started_at, first.ended_at

    def __getattr__(self, name: str) -> Any:
        """Only asked for what is not known yet."""
        if name not in _FOUND_OUT:
            raise AttributeError(name)
        furthest = furthest_of(self._frames)
        for field in _FOUND_OUT:
            setattr(self, field, getattr(furthest, field))
        return object.__getattribute__(self, name)


_FOUND_OUT = ("frame", *Fault._fields)


class Noise(NamedTuple):
    """A run of bytes that fit nothing. `skipped`: they belong to a bad frame that has been reported already."""

    data: bytes
    offset: int
    started_at: int
    ended_at: int
    skipped: bool = False


new_tuple = tuple.__new__
"""Makes a named tuple in a quarter of the time that calling its class takes."""

Arrival = FrameArrived | BadFrame | Noise


class ToldBytes:
    """What of a stream has been told as bad frames: bytes of them that are passed over again are not told twice."""

    __slots__ = ("_end",)

    def __init__(self) -> None:
        self._end = 0

    def bad(self, bad: BadFrame) -> None:
        """A bad frame is told."""
        self._end = max(self._end, bad.offset + len(bad.raw))

    def new_bytes(self, noise: Noise) -> int:
        """How many of its last bytes no bad frame had."""
        return min(len(noise.data), max(0, noise.offset + len(noise.data) - self._end))
