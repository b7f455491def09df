"""What an engine tells about itself: trace events to a monitor, if there is one, and counters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal

Kind = Literal["frame", "bad", "noise", "break", "open", "closed", "trouble", "not_taken"]


@dataclass(slots=True)
class Seen:
    """Something that happened. `at` is when its last byte came or it was handed over for sending (ns).

    `kind`: a frame; a bad one; noise; a line break; the connection; `trouble` (a step that could not be worked out, a
    circle of steps); `not_taken` follows a frame that nobody waited for. `reason`: the cause of a bad frame, or words.
    `place` is the byte of a bad frame where the fault is. `repeated`: the same bytes were sent before.
    """

    direction: Literal["in", "out", ""]
    kind: Kind
    at: int
    raw: bytes = b""
    frame: str = ""
    fields: dict[str, Any] = field(default_factory=dict)
    reason: str = ""
    started_at: int = 0
    segment: str = ""
    place: int = 0
    repeated: bool = False


Monitor = Callable[[Seen], None]


@dataclass(slots=True)
class LinkCounters:
    """Frames by themselves sent, good frames received, those not taken, bad frames, bytes of noise.

    `late`: those not taken that were replies whose exchange was over, or that answered a repeated request again.
    """

    sent: int = 0
    received: int = 0
    not_taken: int = 0
    late: int = 0
    bad: int = 0
    noise_bytes: int = 0
