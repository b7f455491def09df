"""What every coding of a `wrap` can be asked; a coding is a class with a row in `codings`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from framekit.definition.expression import Expression, Node
from framekit.definition.problems import Position, Problem
from framekit.definition.wire_types import EVERY_BYTE, Sizes


@dataclass(frozen=True, slots=True)
class Coding:
    """One way in which content stands on the wire. `never`: the bytes that never stand there then."""

    at: Position

    @property
    def never(self) -> frozenset[int]:
        return frozenset()

    @property
    def contents(self) -> frozenset[int]:
        """The bytes that may stand on the wire."""
        return EVERY_BYTE - self.never

    def sizes(self, plain: Sizes) -> Sizes:
        """Bytes on the wire of so many plain ones: each may become two, if the coding says nothing else."""
        return Sizes(plain.least, plain.times(1, 2).most)

    def size_of(self, plain: Node) -> Node | None:
        """The bytes on the wire of as many plain ones as an expression says; None if that depends on the content."""
        return None

    @property
    def expressions(self) -> tuple[tuple[str, Expression], ...]:
        """What must be known to read or build it: what messages call it, and the expression, which gives bytes."""
        return ()

    def check(self) -> Iterator[Problem]:
        """What is wrong with it by itself."""
        return iter(())

    def check_content(self, size: int | None) -> Iterator[Problem]:
        """What is wrong with content that always has so many bytes; None: that depends on its values."""
        return iter(())

    @property
    def shown(self) -> str:
        """What documents say of it."""
        raise NotImplementedError
