"""The nodes of a YAML file, with positions: every scalar is uninterpreted text.

Readers of single keys need these alone; the conversion of a file to nodes is in `nodes`, with the library that it
needs.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field

from framekit.definition.problems import Position

NOTES = ("about", "doc", "source", "second_source")
"""Keys for human readers, in every part of every file."""


@dataclass(frozen=True)
class Scalar:
    """A single value as its text; `''` for an empty value."""

    text: str
    at: Position
    quoted: bool = False
    """Whether it is in quotes."""
    absent: bool = False
    """Whether its key has no colon, as `b)` in `{set: max(a, b)}`."""


@dataclass
class _Use:
    """Whether a loader has read an entry."""

    read: bool = False


@dataclass(frozen=True)
class Entry:
    """A key and its value."""

    key: Scalar
    value: Node
    use: _Use = field(default_factory=_Use, compare=False, repr=False)

    def holding(self, value: Node) -> Entry:
        """Return the entry with another value; reading one of them marks both as read."""
        return Entry(self.key, value, self.use)


@dataclass(frozen=True)
class Mapping:
    """Keys and values in the order written; every key once. `flow`: written in braces."""

    entries: tuple[Entry, ...]
    at: Position
    flow: bool = False

    def get(self, key: str) -> Node | None:
        """Return the value of a key and mark it as read; None for a missing key."""
        for entry in self.entries:
            if entry.key.text == key:
                entry.use.read = True
                return entry.value
        return None

    def value(self, key: str) -> Node | None:
        """Return the value of a key, without marking it as read: another loader reads it, or it selects the loader."""
        return next((entry.value for entry in self.entries if entry.key.text == key), None)

    def read_all(self) -> tuple[Entry, ...]:
        """Return all entries and mark them as read, for keys that the file's author chooses."""
        for entry in self.entries:
            entry.use.read = True
        return self.entries

    def keys(self) -> tuple[str, ...]:
        """Return the texts of the keys."""
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


def unread(node: Node) -> Iterator[tuple[Mapping, Entry]]:
    """Yield the entries that no loader has read, each with its mapping.

    A mapping without any read entry is skipped: it belongs to a part that is not loaded at all.
    """
    waiting: list[Node] = [node]
    while waiting:
        node = waiting.pop()
        if isinstance(node, Sequence):
            waiting.extend(node.items)
        elif isinstance(node, Mapping):
            looked_at = any(entry.use.read for entry in node.entries)
            for entry in node.entries:
                if entry.use.read:
                    waiting.append(entry.value)
                elif looked_at and entry.key.text not in NOTES:
                    yield node, entry


def words_in(node: Node | None) -> frozenset[str]:
    """Return all identifiers in the texts of a node."""
    found: set[str] = set()
    seen, waiting = {id(node)}, [node]
    while waiting:
        here = waiting.pop()
        if isinstance(here, Scalar):
            found.update(re.findall(r"[A-Za-z_]\w*", here.text))
            continue
        parts: list[Node] = list(here.items) if isinstance(here, Sequence) else []
        if isinstance(here, Mapping):
            parts = [part for entry in here.entries for part in (entry.key, entry.value)]
        waiting += [part for part in parts if id(part) not in seen]
        seen.update(map(id, parts))
    return frozenset(found)
