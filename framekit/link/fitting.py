"""Which frames of a protocol some bytes are, where nobody knows what to expect. No line and no time is involved."""

from __future__ import annotations

import typing
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

from framekit.codec.errors import FrameError
from framekit.codec.functions import Context, FrameFunctions

if TYPE_CHECKING:
    from framekit.definition.model.protocol import Protocol


class FrameFacts(typing.Protocol):
    """What has to be known of a frame."""

    @property
    def name(self) -> str: ...
    @property
    def inner(self) -> bool: ...
    @property
    def side(self) -> str: ...
    @property
    def refuse(self) -> int | None: ...


Catalogue = Mapping[str, FrameFacts]
"""The frames of a protocol by their names."""


class Fit(NamedTuple):
    """A frame that the bytes are; `refusal` is the code a server would refuse it with."""

    frame: str
    fields: dict[str, Any]
    refusal: int | None = None


def candidates(protocol: Protocol, frame: str | None = None, side: str | None = None) -> list[str]:
    """The frames to try: one or those of a group, or all that stand on the line and may come from that side.

    Raises KeyError for a frame or group there is not.
    """
    return list(protocol.frames_of(frame)) if frame is not None else of_side(protocol.frames, side)


def of_side(frames: Catalogue, side: str | None = None) -> list[str]:
    """The frames that stand on the line and come from that side (None: from either); those that are refused last.

    A frame that no side sends (`from: none`) is only for procedures: as an answer it would hide what is wrong.
    """
    sides = (side, "both") if side is not None else ("client", "server", "both")
    found = [one for one in frames.values() if not one.inner and one.side in sides]
    return [one.name for one in sorted(found, key=lambda one: one.refuse is not None)]


def fitting(
    codec: FrameFunctions, frames: Catalogue, data: bytes, names: list[str], context: Context | None = None
) -> tuple[list[Fit], list[tuple[str, FrameError]]]:
    """The frames that the bytes are, and why they are not the others. Frames to be refused count only alone."""
    fits: list[Fit] = []
    faults: list[tuple[str, FrameError]] = []
    for name in names:
        frame = frames[name]
        if fits and frame.refuse is not None:
            continue
        try:
            fits.append(Fit(name, codec.decode(name, data, context), frame.refuse))
        except FrameError as error:
            if error.refuse is not None and error.cause != "check":
                fits.append(Fit(name, error.fields, error.refuse))
            faults.append((name, error))
    whole = [fit for fit in fits if fit.refusal is None]
    known = [fit for fit in whole if not _holds_unknown(fit.fields)]
    return known or whole or fits, faults


def nearest(faults: list[tuple[str, FrameError]]) -> tuple[str, FrameError] | None:
    """The frame that fits best, and its fault."""
    return max(faults, key=lambda fault: (fault[1].cause == "check", fault[1].offset), default=None)


def reason(faults: list[tuple[str, FrameError]], data: bytes) -> str:
    """Why the bytes are no frame: what the frame that fits best has to say."""
    if not data:
        return "there are no bytes to decode"
    best = nearest(faults)
    if best is None:
        return "this protocol has no frames that could be tried"
    return f"no frame fits; nearest is '{best[0]}': {best[1]}"


def _holds_unknown(fields: Mapping[str, Any]) -> bool:
    """Whether a frame inside is none that the protocol knows."""
    return any(isinstance(value, dict) and ("unknown" in value or _holds_unknown(value)) for value in fields.values())
