"""Faults of reading a frame, in segment order, and the errors that callers of a construct get.

Reading continues after a fault as long as the next segment can be located; `Stop` ends a region if it cannot. This
module knows no kind of segment.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from construct import ConstructError

from framekit.codec.errors import EncodeError, FrameError


class ConstructFrameError(FrameError, ConstructError):
    """A `FrameError` that is also a `ConstructError`, as construct's `Select` and `Optional` expect of a mismatch."""

    def __init__(self, fault: Fault, refuse: int | None, fields: Mapping[str, Any], path: str) -> None:
        place = fault.place
        super().__init__(
            fault.cause, place.label, place.offset, fault.expected, fault.found, refuse=refuse, fields=fields
        )
        self.path = path


class ConstructEncodeError(EncodeError, ConstructError):
    """An `EncodeError` that is also a `ConstructError`."""

    def __init__(self, field: str, message: str, path: str | None = None) -> None:
        super().__init__(field, message)
        self.path = path


class Stop(ConstructError):  # noqa: N818 - it is a signal between constructs of one frame
    """End the reading of this region; the reason has already been noted."""


@dataclass(frozen=True, slots=True)
class Place:
    """The place of a fault: rank in reading order, offset in the frame, segment label, refusal code."""

    order: int
    offset: int
    label: str
    refuse: int | None


@dataclass(frozen=True, slots=True)
class Fault:
    """A fault at a place; `cause` as in `FrameError`."""

    place: Place
    cause: str
    expected: str = ""
    found: str = ""


class Faults:
    """Collect the faults of a frame and select the decisive fault."""

    def __init__(self) -> None:
        self.noted: list[Fault] = []
        self.unchecked = False

    def note(self, place: Place, cause: str, expected: object = "", found: object = "") -> None:
        self.noted.append(Fault(place, cause, text_of(expected), text_of(found)))

    def verdict(self) -> Fault | None:
        """Return the decisive fault: a wrong check code before all others, else the first fault in the frame."""
        wrong_checks = [fault for fault in self.noted if fault.cause == "check"]
        return min(wrong_checks or self.noted, key=lambda fault: (fault.place.offset, fault.place.order), default=None)

    def refusal(self, fault: Fault) -> int | None:
        """Return the refusal code for `fault`: only if every check code was present and right."""
        return None if fault.cause == "check" or self.unchecked else fault.place.refuse


def text_of(value: object) -> str:
    """Return a short text for a message: bytes as hex pairs."""
    if isinstance(value, (bytes, bytearray)):
        shown = bytes(value[:8]).hex(" ").upper()
        return f"{shown} …" if len(value) > 8 else shown
    return value if isinstance(value, str) else repr(value)
