"""What a command line or a program says of a device to serve, put on top of its file or of a bare protocol.

Everything is text, as it would stand in a device file; what it means is judged where device files are read.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from framekit.definition.nodes import Entry, Node, Scalar, Sequence
from framekit.definition.nodes import Mapping as MappingNode
from framekit.definition.problems import Position


@dataclass(frozen=True, slots=True, kw_only=True)
class DeviceSettings:
    """Several `stations` are so many devices, each with a memory of its own.

    `memory` is a profile's name; `initial` ADDRESS → values with commas between them; `sizes` ADDRESS → elements of
    the area there; `params` NAME → value; `mapping` AREA of the protocol → ADDRESS in the memory where it begins.
    """

    stations: tuple[str, ...] = ()
    role: str | None = None
    memory: str | None = None
    initial: Mapping[str, str] = field(default_factory=dict)
    sizes: Mapping[str, str] = field(default_factory=dict)
    params: Mapping[str, str] = field(default_factory=dict)
    mapping: Mapping[str, str] = field(default_factory=dict)

    def on(self, root: MappingNode) -> MappingNode:
        """The file with these settings in place of its own; start values and map entries are added to the file's."""
        changes: dict[str, Node] = {}
        if self.stations:
            at = _at("station", ",".join(self.stations))
            changes["station"] = Sequence(tuple(Scalar(text, at) for text in self.stations), at)
        if self.role is not None:
            changes["role"] = Scalar(self.role, _at("role", self.role))
        if self.params:
            changes["params"] = _joined(root.get("params"), _texts("param", self.params))
        if self.memory is not None or self.initial or self.sizes or self.mapping:
            changes["memory"] = self._memory(root.get("memory"))
        return _joined(root, changes)

    def _memory(self, node: Node | None) -> MappingNode:
        if isinstance(node, Scalar):
            node = MappingNode((Entry(Scalar("profile", node.at), node),), node.at)
        old = node if isinstance(node, MappingNode) else None
        changes: dict[str, Node] = {}
        if self.memory is not None:
            changes["profile"] = Scalar(self.memory, _at("memory", self.memory))
        given = {"set": ("set", self.initial), "sizes": ("size", self.sizes), "map": ("map", self.mapping)}
        for key, (flag, texts) in given.items():
            if texts:
                changes[key] = _joined(None if old is None else old.get(key), _texts(flag, texts))
        return _joined(old, changes)


def _texts(flag: str, texts: Mapping[str, str]) -> dict[str, Node]:
    """Values by name; one with commas is a list."""
    found: dict[str, Node] = {}
    for name, text in texts.items():
        at = _at(flag, f"{name}={text}")
        items = [part.strip() for part in text.strip("[]").split(",")] if flag == "set" else [text]
        values = tuple(Scalar(item, at) for item in items)
        found[name] = values[0] if len(values) == 1 else Sequence(values, at)
    return found


def _joined(old: Node | None, changes: Mapping[str, Node]) -> MappingNode:
    """The entries of a mapping, some replaced and some added."""
    entries: Iterable[Entry] = old.entries if isinstance(old, MappingNode) else ()
    kept = [entry for entry in entries if entry.key.text not in changes]
    added = [Entry(Scalar(name, getattr(node, "at", NO_FILE)), node) for name, node in changes.items()]
    return MappingNode((*kept, *added), NO_FILE if old is None else old.at)


def _at(flag: str, text: str) -> Position:
    return Position(f"--{flag} {text}", 0, 0)


NO_FILE = Position("the command line", 0, 0)
