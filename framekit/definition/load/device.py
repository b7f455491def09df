"""Device files: a simulated device is its protocol with own state, sequences and roles on top, and a memory.

The memory part is handed on as nodes; what it means is the memory layer's business.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from framekit.definition.load.documents import Documents, SourceText, merged
from framekit.definition.load.library import definition_path, load_protocol
from framekit.definition.load.protocol import ProtocolLoader
from framekit.definition.load.reader import Reader
from framekit.definition.model.protocol import Protocol
from framekit.definition.nodes import Entry, Mapping, Node
from framekit.definition.problems import DefinitionError

OWN_SECTIONS = (
    "params", "state", "queues", "tables", "layouts", "sequences", "roles", "sessions", "errors", "server", "services",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class DeviceDefinition:
    """A device file as far as this layer reads it. `root` still holds `memory`, `station` and `params` as nodes.

    `broken`: names of things in it that could not be read. `plain`: the device has no rules of its own; its
    protocol is as it is loaded by itself, checked, and shared with whoever else loads it.
    """

    name: str
    protocol: Protocol
    root: Mapping
    path: Path
    broken: frozenset[str]
    plain: bool = False


def load_device_definition(reader: Reader, documents: Documents, name: str | Path, folder: Path) -> DeviceDefinition:
    """Raises Broken when it can't be read, DefinitionError when there is no such file; problems go to the reader."""
    path = definition_path(name, folder)
    root = documents.root(path, "device")
    found = documents.find(_required(reader, root, "protocol"), path)
    own = Mapping(tuple(_own(entry) for entry in root.entries if entry.key.text in OWN_SECTIONS), root.at)
    plain = None if any(_says(entry) for entry in own.entries) else _protocol(found)
    if plain is not None:
        return DeviceDefinition(reader.text(root.get("device")), plain, root, path, frozenset(), plain=True)
    base = documents.source(found)
    whole = SourceText(merged(base.root, own), path, base.names, (str(path), *base.files), base.uses, base.application)
    loader = ProtocolLoader(reader, documents, whole)
    protocol = loader.load()
    title = reader.text(root.get("device"))
    return DeviceDefinition(title, replace(protocol, at=root.at), root, path, loader.broken(protocol))


def _own(entry: Entry) -> Entry:
    """A section of the device's own; of `params` only new definitions, what is set to a value is no part of it."""
    if entry.key.text != "params" or not isinstance(entry.value, Mapping):
        return entry
    defined = tuple(item for item in entry.value.entries if isinstance(item.value, Mapping))
    return entry.holding(Mapping(defined, entry.value.at))


def _says(entry: Entry) -> bool:
    return not isinstance(entry.value, Mapping) or bool(entry.value.entries)


def _protocol(path: Path) -> Protocol | None:
    """The protocol in a file; None if it is no right one, which is told when it is read with the device's own rules."""
    try:
        found = load_protocol(path)
    except DefinitionError:
        return None
    return None if found.kind == "application" else found


def _required(reader: Reader, root: Mapping, key: str) -> Node:
    node = root.get(key)
    if node is None:
        raise reader.broken(root.at, f"the device has no {key}", f"add {key}: NAME")
    return node
