"""Static sizes of frames and their segments, with the frames that may stand inside others."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from framekit.definition.model.frames import Frame
from framekit.definition.model.segments import Fill, Inner, Segment, Segments, Skip, sizes_of
from framekit.definition.model.static_size import ANY, Sizes, of_any_frame
from framekit.definition.model.walk import parts_of


class StaticSizes:
    """Sizes of segments of a protocol."""

    def __init__(self, frames: Mapping[str, Frame]) -> None:
        self.frames = frames
        self._known: dict[str, Sizes] = {}

    def frame(self, name: str) -> Sizes:
        """Sizes of a frame; a frame that holds itself has no bound."""
        if name not in self._known:
            self._known[name] = ANY
            self._known[name] = self.all(self.segments(self.frames[name]))
        return self._known[name]

    def segments(self, frame: Frame) -> Segments:
        """Head, body and tail, with a skip or `Fill` for what a frame of fixed size leaves free."""
        if frame.size is None:
            return frame.segments
        fixed = self.all(frame.segments).fixed
        if fixed is None:
            room: Segment = Fill(at=frame.at, name="_fill", total=frame.size, byte=frame.fill)
        elif frame.size > fixed:
            room = Skip(at=frame.at, name="_fill", size=frame.size - fixed, fill=bytes((frame.fill,)))
        else:
            return frame.segments
        return (*frame.head, *frame.body, room, *frame.tail)

    def all(self, segments: Iterable[Segment]) -> Sizes:
        return sizes_of(tuple(segments), self.frame)

    def of(self, segment: Segment) -> Sizes:
        """Sizes of a segment that may be absent."""
        sizes = self.present(segment)
        return sizes if segment.when is None else Sizes(0, sizes.most)

    def present(self, segment: Segment) -> Sizes:
        """Sizes of a segment that is there."""
        return segment.sizes(self.frame)

    def is_variable(self, segment: Segment) -> bool:
        """Whether its size depends on more than whether it is there."""
        return self.present(segment).fixed is None

    def split(self, segments: Segments) -> tuple[Segments, Segments]:
        """The segments up to the last of variable size, and the others behind it (all, if none is variable: none)."""
        last = max((place for place, segment in enumerate(segments) if self.is_variable(segment)), default=-1)
        return (segments, ()) if last < 0 else (segments[: last + 1], segments[last + 1 :])

    def may_refuse(self, segments: Segments) -> bool:
        """Whether a fault here, or in a frame inside, is one that is answered with a refusal."""
        known: set[str] = set()
        wanted = [segments]
        while wanted:
            here = wanted.pop()
            if any(part.refuse is not None for part in parts_of(here, Segment)):
                return True
            inner = {name for part in parts_of(here, Inner) for name in part.frames} - known
            if any(self.frames[name].refuse is not None for name in inner):
                return True
            known |= inner
            wanted += [self.frames[name].segments for name in inner]
        return False


def fixed_size(segment: Segment) -> int | None:
    """Bytes a segment always takes; None when that depends on content, or on a frame inside."""
    return all_fixed((segment,))


def all_fixed(segments: Segments) -> int | None:
    """Bytes that segments always take; None when that depends on content, or on a frame inside."""
    return sizes_of(segments, of_any_frame).fixed


def least_size(segments: Segments) -> int:
    """Bytes that segments take at least; those of frames inside do not count."""
    return sizes_of(segments, of_any_frame).least
