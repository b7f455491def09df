"""Reading on behind what is broken, so that everything wrong in a block is told at once."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from framekit.definition.load.reader import Broken
from framekit.definition.nodes import Node

T = TypeVar("T")


class Attempts:
    """Tries to read parts of something; `spoilt` says that one of them was broken, which has been told."""

    def __init__(self) -> None:
        self.spoilt = False

    def to(self, read: Callable[[], T]) -> T | None:
        """What can be read; None for something broken."""
        try:
            return read()
        except Broken:
            self.spoilt = True
            return None

    def maybe(self, read: Callable[[Node], T], node: Node | None) -> T | None:
        """What a node says; None where there is none, or where it is broken."""
        return None if node is None else self.to(lambda: read(node))
