"""A quick look at the check code at the end of a frame, before anything else of the frame is read.

It serves to pass over candidates that cannot be good. What it does not know how to look at, it leaves to the codec.
"""

from __future__ import annotations

from collections.abc import Callable

from framekit.codec.checks import function_of, residue_of
from framekit.definition.model.frames import Frame
from framekit.definition.model.segments import Check, Wrap
from framekit.definition.model.visit import parts_of

Intact = Callable[[bytes | bytearray], bool]
"""Whether the check code of these bytes is right."""


def intact_of(frame: Frame) -> Intact | None:
    """For a frame that ends in a binary check code over everything before it; None for every other."""
    last = frame.segments[-1] if frame.segments else None
    if not isinstance(last, Check) or last.form != "raw" or last.verify != "error" or last.when is not None:
        return None
    if (
        last.method.kind == "fold"
        or last.over is not None
        or last.span is not None
        or any(parts_of(frame.segments, Wrap))
    ):
        return None
    code, size, order = function_of(last.method), last.size, last.order
    residue = residue_of(last.method, size, order)
    if residue is not None:
        return lambda raw: code(raw) == residue
    room = (1 << 8 * size) - 1

    def intact(raw: bytes | bytearray) -> bool:
        return raw[-size:] == (code(raw[:-size]) & room).to_bytes(size, order)

    return intact
