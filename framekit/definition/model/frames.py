"""Groups and frames with everything inherited and included put in place. Language reference, section 5."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from framekit.definition.expression.syntax import Expression
from framekit.definition.model.segments import Segment
from framekit.definition.problems import Position

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
