"""A frame that is sent again with another number in one field: the same bytes with that number in their midst.

Where more of the frame would be different, or might be, there is no such way. It knows no sequences.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from struct import Struct, error
from typing import Any

from framekit.codec.python.forms import is_slice, struct_code
from framekit.definition.expression.syntax import names_in
from framekit.definition.model.segments import Check, Field
from framekit.definition.model.walk import expressions_of
from framekit.link.frame_info import FrameInfo
from framekit.link.spans import spans_of
from framekit.link.values import FrameValue

Patch = Callable[[Any], bytes | None]
"""The bytes with this value; None for one that has to be looked at with care."""


def patch_of(sent: FrameValue, name: str, infos: Mapping[str, FrameInfo]) -> Patch | None:
    """The way for a frame as it has been sent, and its field `name`."""
    raw, frame = sent.raw, infos[sent.frame].frame
    spans = None if raw is None else spans_of(sent, len(raw), infos)
    if raw is None or spans is None or any(isinstance(span.segment, Check) for span in spans):
        return None
    found = [span for span in spans if span.frame == sent.frame and span.segment.name == name]
    struct = _struct_of(found[0].segment) if len(found) == 1 else None
    if struct is None or any(name in names_in(one.root) for one in expressions_of(frame.segments)):
        return None
    pack, before, behind = struct.pack, raw[: found[0].start], raw[found[0].end :]

    def patch(value: Any) -> bytes | None:
        try:
            return before + pack(value) + behind
        except error:
            return None

    return patch


def _struct_of(segment: object) -> Struct | None:
    """How `struct` writes a field that is nothing but an unsigned number."""
    if not isinstance(segment, Field):
        return None
    kind = segment.type
    other = (
        segment.values, segment.limits, segment.plus, segment.unit, segment.long, segment.constants, segment.is_
    )  # fmt: skip
    if kind.kind != "int" or kind.signed or any(other) or segment.zero_means is not None or is_slice(kind):
        return None
    code, order = struct_code(kind) or ("", "")
    return Struct((order or "<") + code)
