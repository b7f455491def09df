"""What an engine shows to whoever watches: every frame sent and received, bad frames, noise, and trouble.

Made only when somebody watches.
"""

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
