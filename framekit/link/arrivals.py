"""What a receiver finds in a stream: frames, bad frames, and bytes that belong to nothing.

Offsets count the bytes of the stream from its start; times are when the first and the last byte came.
"""

from __future__ import annotations

from dataclasses import dataclass

from framekit.link.values import FrameValue


@dataclass(slots=True)
class FrameArrived:
    """A good frame, or one that is to be refused (`value.refusal`). `other`: it was not among the expected ones."""

    value: FrameValue
    raw: bytes
    offset: int
    started_at: int
    ended_at: int
    other: bool = False


@dataclass(slots=True)
class BadFrame:
    """A frame with a fault that is not to be answered as a refusal.

    `cause`: check parity framing overrun constant where digits value range require short too_long length surplus cut.
    `segment` and `place` say where in the frame (name or kind; byte offset), `expected` and `found` what was wrong.
    """

    frame: str
    cause: str
    segment: str
    offset: int
    expected: str
    found: str
    raw: bytes
    started_at: int
    ended_at: int
    place: int = 0
    message: str = ""


@dataclass(slots=True)
class Noise:
    """A run of bytes that fit nothing. `skipped`: they belong to a bad frame that has been reported already."""

    data: bytes
    offset: int
    started_at: int
    ended_at: int
    skipped: bool = False


Arrival = FrameArrived | BadFrame | Noise
