"""What goes into and comes out of a link engine, as plain values; and what it tells about itself.

The engine is sans-I/O: a driver tells it what happened on the line and when (the `Engine` methods), and carries out
the commands it returns. Times are whole nanoseconds of one monotonic clock; nothing here knows where it comes from.
"""

from __future__ import annotations

import enum
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from framekit.definition.times import LineFormat
from framekit.link.values import plain


class LineFault(enum.Enum):
    """What a port found wrong with one character."""

    PARITY = "parity"
    FRAMING = "framing"
    OVERRUN = "overrun"


@dataclass(frozen=True, slots=True)
class CharacterFault:
    """A damaged character: its place in the bytes handed over with it (0 = first byte) and what was wrong."""

    index: int
    fault: LineFault


@dataclass(slots=True)
class Send:
    """Send these bytes, not before the given time; the driver answers with `Engine.sent` when the last bit has left.

    `inside` allows to put the bytes into the frame that is going out now (embedded responses). For the engine: the
    `run` that sends (None: none), what is known of the frame (`info`), and who is told when the last bit has left.
    """

    data: bytes
    not_before: int = 0
    inside: bool = False
    run: Any = field(default=None, repr=False, compare=False)
    info: Any = field(default=None, repr=False, compare=False)
    on_sent: Callable[[], None] | None = field(default=None, repr=False, compare=False)


@dataclass(slots=True)
class Break:
    """Hold the line in break state for `duration` ns, not before the given time; then `Engine.sent`. `run`: whose."""

    duration: int
    not_before: int = 0
    run: Any = field(default=None, repr=False, compare=False)


@dataclass(slots=True)
class ChangeLine:
    """The line has this speed and format from now on; all that was sent before has left, so no `sent` follows.

    For the engine: the `run` that waits for it (None: none), and the number of that wait.
    """

    line: LineFormat
    run: Any = field(default=None, repr=False, compare=False)
    number: int = field(default=0, repr=False, compare=False)


@dataclass(frozen=True, slots=True)
class SetRts:
    """Switch the request-to-send line."""

    on: bool


@dataclass(frozen=True, slots=True)
class Reopen:
    """Close the connection and open it again: the stream is out of step and cannot be trusted."""

    reason: str


Command = Send | Break | ChangeLine | SetRts | Reopen


Direction = Literal["in", "out", ""]
Kind = Literal["frame", "bad", "noise", "break", "line", "open", "closed", "trouble", "not_taken"]


class Seen:
    """Something that happened. `at` is when its last byte came or it was handed over for sending (ns).

    `kind`: a frame; a bad one; noise; a line break; `line`, other settings of the line (`reason`); the connection;
    `trouble` (a step that could not be worked out, a circle of steps); `not_taken` follows a frame that no step waited
    for. `reason`: the cause of a bad frame, or words. `place` is the byte of a bad frame where the fault is.
    `repeated`: the same bytes were sent before. `fields` are made when they are asked for; `computed` reads them from
    the bytes of a frame that was sent. `client`: the other side, HOST:PORT, where several can be on one port.
    """

    __slots__ = (
        "_computed", "_fields", "at", "client", "direction", "frame", "kind", "place", "raw", "reason", "repeated",
        "segment", "started_at",
    )  # fmt: skip

    def __init__(
        self, direction: Direction, kind: Kind, at: int, raw: bytes = b"", frame: str = "",
        fields: Mapping[str, Any] | None = None, reason: str = "", started_at: int = 0, segment: str = "",
        place: int = 0, repeated: bool = False, computed: Callable[[], Mapping[str, Any]] | None = None,
    ) -> None:  # fmt: skip
        self.direction, self.kind, self.at, self.raw, self.frame = direction, kind, at, raw, frame
        self.reason, self.started_at, self.segment = reason, started_at, segment
        self.place, self.repeated = place, repeated
        self._fields: Mapping[str, Any] = _NOTHING if fields is None else fields
        self._computed = computed
        self.client = ""

    @property
    def fields(self) -> dict[str, Any]:
        """The fields of a frame as codecs give them: a frame inside is `{frame: fields}`."""
        computed, self._computed = self._computed, None
        found = self._fields if computed is None else computed()
        self._fields = made = {name: plain(value) for name, value in found.items()}
        return made

    def __repr__(self) -> str:
        return f"<{self.kind} {self.direction} {self.frame} {self.raw.hex(' ')} {self.reason}>"


_NOTHING: Mapping[str, Any] = {}


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
