"""`value`, `require`: a value without bytes, and a condition on the frame."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

from framekit.definition.expression import Expression
from framekit.definition.keys import EXPRESSION, IDENTIFIER, ValueKind, key
from framekit.definition.kinds.base import Given, Segment


@dataclass(frozen=True, slots=True, kw_only=True)
class Value(Segment):
    """A value without bytes: read by `read`; when building, the given value, else `build`, else `read`."""

    KEY: ClassVar[str] = "value"
    takes_bytes: ClassVar[bool] = False
    VALUE: ClassVar[ValueKind | None] = "any"

    name: str = key("value", IDENTIFIER, "Name of a value without bytes on the wire.")
    read: Expression = key("read", EXPRESSION, "How it follows from what was read.")
    build: Expression | None = key(
        "build", EXPRESSION, "How it follows when building, if it is not given; default: as read.", default=None
    )

    @property
    def given_names(self) -> tuple[str, ...]:
        return ()  # it may be given, without any consequence

    @property
    def follows(self) -> Expression | None:
        return self.read

    def needed(self) -> Iterator[tuple[str, Expression]]:
        yield from Segment.needed(self)
        yield "value", self.read

    def given(self) -> Iterator[Given]:
        yield from Segment.given(self)
        yield self.read, "any", None
        yield self.build, "any", None


@dataclass(frozen=True, slots=True, kw_only=True)
class Require(Segment):
    """A condition that must hold when building and when reading."""

    KEY: ClassVar[str] = "require"
    takes_bytes: ClassVar[bool] = False

    condition: Expression = key("require", EXPRESSION, "What must hold.")

    def needed(self) -> Iterator[tuple[str, Expression]]:
        yield from Segment.needed(self)
        yield "condition", self.condition

    def given(self) -> Iterator[Given]:
        yield from Segment.given(self)
        yield self.condition, "any", None
