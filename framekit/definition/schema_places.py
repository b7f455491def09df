"""Paths of a schema error as places in the file: the node there, its position, and what a user calls it.

The names are those of sections of definitions and runs; what a schema demands is not known here.
"""

from __future__ import annotations

from collections.abc import Iterable

from framekit.definition.problems import Position
from framekit.definition.tree import Mapping, Node, Scalar, Sequence

Path = tuple[str | int, ...]

_NOUNS = {
    "areas": "area",
    "channels": "channel",
    "checks": "check method",
    "frames": "frame",
    "groups": "group",
    "layouts": "layout",
    "params": "parameter",
    "queues": "queue",
    "roles": "role",
    "sequences": "sequence",
    "services": "service",
    "sessions": "session",
    "state": "state variable",
    "tables": "table",
    "blocks": "block",
    "sets": "set",
    "lanes": "lane",
    "flags": "flags entry",
}
_NUMBERED = ("channels", "blocks", "sets")
_DEEPER = {("memory", 2), ("sets", 3), ("roles", 3)}
"""Sections that do not stand at the top: the first key of the path, and where in the path the entry's name stands."""

_LISTED = {
    "addresses": ("address form", "", 1),
    "frames": ("frame case", "name", 1),
    "conversations": ("conversation", "name", 1),
    "services": ("row", "name", 2),
    "sequences": ("step", "step", 3),
}
"""Lists whose items have names: section → noun, key of the name, place of the item's number in the path."""


class Places:
    """Finds nodes by path and names them."""

    def __init__(self, root: Node) -> None:
        self.root = root

    def node(self, path: Iterable[str | int]) -> Node:
        """The node at a path of the plain tree."""
        node: Node | None = self.root
        for step in path:
            if isinstance(node, Sequence) and isinstance(step, int):
                node = node.items[step]
            elif isinstance(node, Mapping):
                node = node.get(str(step))
        assert node is not None  # paths come from the tree
        return node

    def key(self, path: Path, key: str) -> Position:
        """Where a key of the mapping at `path` stands."""
        node = self.node(path)
        if isinstance(node, Mapping):
            for entry in node.entries:
                if entry.key.text == key:
                    return entry.key.at
        return node.at

    def place(self, path: Path) -> str:
        """The nearest thing around with a name: `frame 'X'`, `step 'ask' of sequence 'exchange'`; '' for none."""
        return self._named(path)[0]

    def is_named(self, path: Path) -> bool:
        """Whether the path leads to a thing with a name, not into one."""
        return bool(path) and self._named(path)[1] == len(path)

    def _named(self, path: Path) -> tuple[str, int]:
        parts: list[str] = []
        end = 0
        for index in range(1, len(path)):
            part = self._entry(path, index) if isinstance(path[index], str) else self._item(path, index)
            if part:
                parts.insert(0, part)
                end = index + 1
        return " of ".join(parts), end

    def _entry(self, path: Path, index: int) -> str:
        section, name = path[index - 1], path[index]
        if section not in _NOUNS or (index != 1 and (path[0], index) not in _DEEPER):
            return ""
        noun = _NOUNS[str(section)]
        return f"{noun} {name}" if section in _NUMBERED else f"{noun} '{name}'"

    def _item(self, path: Path, index: int) -> str:
        noun, key, depth = _LISTED.get(str(path[0]), ("", "", 0))
        if not noun or index != depth or (path[0] == "sequences" and path[2] != "steps"):
            return ""
        item = self.node(path[: index + 1])
        name = item.get(key) if isinstance(item, Mapping) else None
        return f"{noun} '{name.text}'" if isinstance(name, Scalar) and name.text else f"{noun} {int(path[index]) + 1}"
