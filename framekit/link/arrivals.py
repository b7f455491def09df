"""The results of a receiver: frames, bad frames, and noise.

Offsets count the bytes of the stream from its start. Times are the arrival times of the first and the last byte.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from framekit.link.values import FrameValue


class FrameArrived:
    """A good frame, or a frame that must be refused (`value.refusal`).

    `value` is created on access, unless it has been set: that is cheaper for many frames a turn. All other attributes
    are set by the code that creates the frame, which takes half the time of an `__init__` or a named tuple.
    """

    __slots__ = ("decoded", "make", "offset", "raw", "times", "value")

    make: Callable[[dict[str, Any], bytes, int | None], FrameValue]
    """Create the value from the fields, the bytes and the refusal."""
    decoded: dict[str, Any]
    """The fields; frames inside are as the codec returns them."""
    raw: bytes
    offset: int
    times: tuple[int, int]
    """The arrival times of the first and the last byte."""
    value: FrameValue

    @property
    def started_at(self) -> int:
        return self.times[0]

    @property
    def ended_at(self) -> int:
        return self.times[1]

    def __getattr__(self, name: str) -> Any:
        """Create `value` on its first access."""
        if name != "value":
            raise AttributeError(name)
        self.value = self.make(self.decoded, self.raw, None)
        return self.value

    def __repr__(self) -> str:
        return f"<frame of {len(self.raw)} bytes at {self.offset}>"


ONLY_CHECK = sys.maxsize
"""The reach of a frame whose only fault is its check code."""


class Fault(NamedTuple):
    """The fault of a frame, and its place."""

    cause: str
    segment: str = ""
    place: int = 0
    expected: str = ""
    found: str = ""
    message: str = ""
    reach: int = 0
    """The offset of the first fault other than a check code; `ONLY_CHECK` if only the check code is wrong."""


class BadFrame:
    """A frame with a fault that is not answered with a refusal.

    The attributes of the fault cost much more than its detection, so they are determined on access. This must happen
    before a change of a variable or parameter that the frame depends on.
    """

    __slots__ = (
        "_explain", "cause", "ended_at", "expected", "found", "frame", "limit", "message", "offset", "place", "raw",
        "reach", "segment", "started_at",
    )  # fmt: skip

    cause: str
    """One of check parity framing overrun mark constant where digits value range require short too_long length surplus
    cut."""
    segment: str
    """The name or the kind of the wrong segment."""
    place: int
    """The byte offset of the fault in the frame."""
    expected: str
    found: str
    message: str
    reach: int
    limit: int
    """The upper bound of `reach`: the first place with a byte that the frame never has at this place."""

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
        """Determine the fault on the first access of its attributes."""
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
    """Bytes that may be a bad frame of several kinds, with the frames in the order of their limits.

    The frame with the longest correct part is determined on access, together with its fault.
    """

    __slots__ = ("_frames",)

    def __init__(self, frames: Sequence[BadFrame]) -> None:
        first, self._frames = frames[0], frames
        self.raw, self.offset, self.limit = first.raw, first.offset, first.limit
        self.started_at, self.ended_at = first.started_at, first.ended_at

    def __getattr__(self, name: str) -> Any:
        """Determine the frame and its fault on the first access."""
        if name not in _FOUND_OUT:
            raise AttributeError(name)
        furthest = furthest_of(self._frames)
        for field in _FOUND_OUT:
            setattr(self, field, getattr(furthest, field))
        return object.__getattribute__(self, name)


_FOUND_OUT = ("frame", *Fault._fields)


class Noise(NamedTuple):
    """A run of bytes that fit no frame."""

    data: bytes
    offset: int
    started_at: int
    ended_at: int
    skipped: bool = False
    """Whether the bytes belong to a bad frame that has been reported already."""


new_tuple = tuple.__new__
"""Create a named tuple in a quarter of the time of a call of its class."""

Arrival = FrameArrived | BadFrame | Noise


class ReportedBytes:
    """The end of the bytes that were reported as bad frames, so that noise does not repeat them."""

    __slots__ = ("_end",)

    def __init__(self) -> None:
        self._end = 0

    def bad(self, bad: BadFrame) -> None:
        """Note the report of a bad frame."""
        self._end = max(self._end, bad.offset + len(bad.raw))

    def new_bytes(self, noise: Noise) -> int:
        """Return how many of the last bytes of `noise` were in no reported bad frame."""
        return min(len(noise.data), max(0, noise.offset + len(noise.data) - self._end))
