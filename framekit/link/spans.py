"""Where the segments of a frame stand in its bytes, for frames in which one simply follows the other.

Whatever makes places depend on more than sizes (conditions, conversions, lists) has none here. It reads no values.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from framekit.definition.model.frame_sizes import fixed_size
from framekit.definition.model.segments import Data, Inner, Segment
from framekit.link.frame_info import FrameInfo
from framekit.link.values import FrameValue


@dataclass(frozen=True, slots=True, eq=False)
class Span:
    """A segment of the frame `frame`, and the bytes it takes: from `start` to before `end`.

    Each is one of its own, whatever stands there.
    """

    frame: str
    segment: Segment
    start: int
    end: int


def spans_of(value: FrameValue, size: int, infos: Mapping[str, FrameInfo]) -> tuple[Span, ...] | None:
    """The segments of a frame with these fields that takes `size` bytes, those of frames inside too.

    None where places are not that simple.
    """
    found: list[Span] = []
    return tuple(found) if _place(value, 0, infos, found) == size else None


def _place(value: FrameValue, start: int, infos: Mapping[str, FrameInfo], found: list[Span]) -> int:
    """Adds the spans of a frame that begins at `start`; where it ends, -1 where that cannot be said."""
    info = infos.get(value.frame)
    if info is None or info.frame.size is not None:
        return -1
    for segment in info.frame.segments:
        inner = value.fields.get(segment.name or "")
        if segment.when is not None:
            return -1
        if isinstance(segment, Inner):
            start = _place(inner, start, infos, found) if type(inner) is FrameValue else -1
        else:
            size = _size(segment, inner)
            if size is None:
                return -1
            found.append(Span(info.name, segment, start, start + size))
            start += size
        if start < 0:
            return -1
    return start


def _size(segment: Segment, value: object) -> int | None:
    if not isinstance(segment, Data):
        return fixed_size(segment)
    plain = segment.convert is None and segment.pad is None and not segment.swap
    return len(value) if plain and isinstance(value, bytes) else None
