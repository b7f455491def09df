"""Groups and frames with everything inherited and included put in place (language reference, section 5); their static
sizes, and the bytes they may have."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Literal

from framekit.definition.expression import Expression
from framekit.definition.kinds.base import Segment, Segments, all_fixed, contents_of, fixed_size, least_size, sizes_of
from framekit.definition.kinds.const import Fill, Skip
from framekit.definition.model.static_size import ANY, Sizes
from framekit.definition.model.walk import parts_of
from framekit.definition.problems import Position

__all__ = ["Frame", "Group", "Layout", "Side", "StaticSizes", "all_fixed", "bytes_of", "fixed_size", "least_size"]

Side = Literal["client", "server", "both", "none"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Group:
    """Frames that share head and tail: only what is asked about the group itself; its frames hold the rest."""

    name: str
    frames: tuple[str, ...]
    side: Side
    inner: bool
    at: Position


@dataclass(frozen=True, slots=True, kw_only=True)
class Frame:
    """One frame: head, body and tail are flat lists of segments (includes inlined, `where` written into the fields).

    `groups`: its group and the groups that one extends, nearest first. `inner`: it has no line of its own and is only
    ever part of other frames. `size`: of the whole frame, the rest is `fill`. `most`: longest frame. `echo`: field of
    this reply → expression over the request's fields. `announces`: state variable → expression over this frame.
    `fixed_by_where`: names of the fields that `where` fixes. `refuse`: the frame exists to be refused with this code.
    """

    name: str
    at: Position
    groups: tuple[str, ...]
    side: Side
    head: tuple[Segment, ...]
    body: tuple[Segment, ...]
    tail: tuple[Segment, ...]
    inner: bool = False
    echo: Mapping[str, Expression]
    announces: Mapping[str, Expression]
    delimited: bool = False
    surplus: int | None = None
    size: int | None = None
    fill: int = 0
    most: int | None = None
    refuse: int | None = None
    fixed_by_where: frozenset[str] = frozenset()
    doc: str = ""

    @property
    def segments(self) -> tuple[Segment, ...]:
        return self.head + self.body + self.tail


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """A named list of segments that can be built and read by itself, or included."""

    name: str
    segments: tuple[Segment, ...]
    at: Position


class StaticSizes:
    """Sizes of segments of a protocol."""

    def __init__(self, frames: Mapping[str, Frame]) -> None:
        self.frames = frames
        self._known: dict[str, Sizes] = {}

    def frame(self, name: str) -> Sizes:
        """Sizes of a frame; one that holds itself has no bound, and one that is not there (it is broken) any size."""
        if name not in self._known:
            self._known[name] = ANY
            if name in self.frames:
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
            inner = {name for part in parts_of(here, Segment) for name in part.frames_inside} - known
            if any(self.frames[name].refuse is not None for name in inner):
                return True
            known |= inner
            wanted += [self.frames[name].segments for name in inner]
        return False


def bytes_of(segments: Iterable[Segment], frames: Mapping[str, Frame] | None = None) -> frozenset[int]:
    """The bytes that may stand in these segments; every byte where that cannot be told.

    `frames` are those that `inner` segments name; without them an inner frame may hold every byte.
    """
    known = {} if frames is None else frames
    return contents_of(segments, lambda name: known[name].segments if name in known else None)
