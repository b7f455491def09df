"""The nodes of a YAML file: scalars, mappings and lists with positions.

Every scalar is text, nothing has been given a meaning yet. How a file becomes nodes is not known here.
"""

from __future__ import annotations

from dataclasses import dataclass

from framekit.definition.problems import Position


@dataclass(frozen=True)
class Scalar:
    """A single value as its text; `''` when nothing is written.

    `quoted`: in quotes. `absent`: not even a colon stands behind its key, as `b)` in `{set: max(a, b)}` has no value.
    """

    text: str
    at: Position
    quoted: bool = False
    absent: bool = False


@dataclass(frozen=True)
class Entry:
    """A key and its value."""

    key: Scalar
    value: Node


@dataclass(frozen=True)
class Mapping:
    """Keys and values in the order written; every key once. `flow`: written in braces."""

    entries: tuple[Entry, ...]
    at: Position
    flow: bool = False

    def get(self, key: str) -> Node | None:
        """The value of a key; None when there is no such key."""
        return next((entry.value for entry in self.entries if entry.key.text == key), None)

    def keys(self) -> tuple[str, ...]:
        """The texts of the keys."""
        return tuple(entry.key.text for entry in self.entries)

    def __contains__(self, key: object) -> bool:
        return any(entry.key.text == key for entry in self.entries)


@dataclass(frozen=True)
class Sequence:
    """Items in the order written. `flow`: written in brackets."""

    items: tuple[Node, ...]
    at: Position
    flow: bool = False


Node = Scalar | Mapping | Sequence
