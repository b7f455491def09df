"""Keys of run files that a later version carries out: they are refused, so that none is ignored without a word."""

from __future__ import annotations

from framekit.definition.load.reader import Reader
from framekit.definition.nodes import Mapping, Node

RUN = {
    "uses": "",
}
CHANNEL = {
    "record": "",
}
BLOCK = {
    "variables": "list the addresses in read or write",
    "status": "",
}


def note_later(reader: Reader, root: Mapping) -> None:
    """Notes every key that has no effect yet, with what to write instead."""
    _note(reader, root, RUN, "a run")
    for channel in _entries(root.get("channels")):
        _note(reader, channel, CHANNEL, "a channel")
    for block in _entries(root.get("blocks")):
        _note(reader, block, BLOCK, "a block")


def _entries(node: Node | None) -> list[Node]:
    return [entry.value for entry in node.entries] if isinstance(node, Mapping) else []


def _note(reader: Reader, node: Node, keys: dict[str, str], where: str) -> None:
    for entry in node.entries if isinstance(node, Mapping) else ():
        name = entry.key.text
        if name in keys:
            reader.note(entry.key.at, f"'{name}' of {where} comes with a later version", keys[name] or "leave it out")
