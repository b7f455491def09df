"""What goes into and comes out of a link engine, as plain values.

The engine is sans-I/O: a driver tells it what happened on the line and when (the `Engine` methods), and carries out
the commands it returns. Times are whole nanoseconds of one monotonic clock; nothing here knows where it comes from.
"""

from __future__ import annotations

import enum
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any


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


@dataclass(frozen=True, slots=True)
class SetRts:
    """Switch the request-to-send line."""

    on: bool


@dataclass(frozen=True, slots=True)
class Reopen:
    """Close the connection and open it again: the stream is out of step and cannot be trusted."""

    reason: str


Command = Send | Break | SetRts | Reopen
