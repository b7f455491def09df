"""Values that a file gives as lists, records and maps: plain constants with their positions, of no type yet."""

from __future__ import annotations

from dataclasses import dataclass

from framekit.definition.problems import Position
from framekit.definition.tree import Node, Scalar, Sequence


@dataclass(frozen=True, slots=True)
class GivenValue:
    """A value of a file: a text, a list of values, or named values."""

    at: Position
    value: str | tuple[GivenValue, ...] | tuple[GivenEntry, ...]
    is_map: bool = False

    @property
    def text(self) -> str | None:
        """Return the text of a single value; None for lists and maps."""
        return self.value if isinstance(self.value, str) else None

    @property
    def items(self) -> tuple[GivenValue, ...] | None:
        """Return the items of a list; None for other values."""
        if isinstance(self.value, str) or self.is_map:
            return None
        return tuple(item for item in self.value if isinstance(item, GivenValue))

    @property
    def entries(self) -> tuple[GivenEntry, ...] | None:
        """Return the entries of a map; None for other values."""
        if isinstance(self.value, str) or not self.is_map:
            return None
        return tuple(entry for entry in self.value if isinstance(entry, GivenEntry))


@dataclass(frozen=True, slots=True)
class GivenEntry:
    """A named value."""

    name: str
    at: Position
    value: GivenValue


def given_value(node: Node) -> GivenValue:
    """Return the content of a node; all its keys count as read."""
    if isinstance(node, Scalar):
        return GivenValue(node.at, node.text)
    if isinstance(node, Sequence):
        return GivenValue(node.at, tuple(given_value(item) for item in node.items))
    entries = tuple(GivenEntry(entry.key.text, entry.key.at, given_value(entry.value)) for entry in node.read_all())
    return GivenValue(node.at, entries, is_map=True)
