"""A layout that stands in itself: what an `include` with `depth` makes of it.

The layout one level deeper is a frame of its own that only stands here. So a level costs one function, however often it
is included, and nothing is deeper than the definition says.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from framekit.definition.keys import ValueKind
from framekit.definition.kinds.base import Contents, Segment, contents_of
from framekit.definition.wire_types import EVERY_BYTE, Sizes


@dataclass(frozen=True, slots=True, kw_only=True)
class Nested(Segment):
    """A record of the layout around it, one level deeper: the fields of the frame `frame`, which ends by itself."""

    name: str
    layout: str
    frame: str

    @property
    def value_names(self) -> tuple[str, ...]:
        return (self.name,)

    @property
    def frames_inside(self) -> tuple[str, ...]:
        return (self.frame,)

    def sizes(self, of_frame: Callable[[str], Sizes]) -> Sizes:
        return of_frame(self.frame)

    def contents(self, of_frame: Contents) -> frozenset[int]:
        segments = of_frame(self.frame)
        return EVERY_BYTE if segments is None else contents_of(segments, of_frame)

    def value_kinds(self) -> Iterator[tuple[str, ValueKind]]:
        yield self.name, "any"

    @property
    def wanted_names(self) -> tuple[str, ...]:
        return (self.name,)
