"""Device files: a simulated device is its protocol with own state, sequences and roles on top, and a memory.

The memory part is handed on as nodes; what it means is the memory layer's business.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from framekit.definition.load.documents import Documents, Source, merged
from framekit.definition.load.library import definition_path
from framekit.definition.load.protocol import ProtocolLoader
from framekit.definition.load.reader import Reader
from framekit.definition.model.protocol import Protocol
from framekit.definition.nodes import Entry, Mapping, Node

OWN_SECTIONS = (
    "params", "state", "queues", "tables", "layouts", "sequences", "roles", "sessions", "errors", "server", "services",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class DeviceDefinition:
    """A device file as far as this layer reads it. `root` still holds `memory`, `station` and `params` as nodes.

    `broken`: names of things in it that could not be read.
    """

    name: str
    protocol: Protocol
    root: Mapping
    path: Path
    broken: frozenset[str]


def load_device_definition(reader: Reader, documents: Documents, name: str | Path, folder: Path) -> DeviceDefinition:
    """Raises Broken when it can't be read, DefinitionError when there is no such file; problems go to the reader."""
    path = definition_path(name, folder)
    root = documents.root(path, "device")
    base = documents.source(documents.find(_required(reader, root, "protocol"), path))
    own = Mapping(tuple(_own(entry) for entry in root.entries if entry.key.text in OWN_SECTIONS), root.at)
    whole = Source(merged(base.root, own), path, base.names, (str(path), *base.files), base.uses, base.application)
    loader = ProtocolLoader(reader, documents, whole)
    protocol = loader.load()
    title = reader.text(root.get("device"))
    return DeviceDefinition(title, replace(protocol, at=root.at), root, path, loader.broken(protocol))


def _own(entry: Entry) -> Entry:
    """A section of the device's own; of `params` only new definitions, what is set to a value is no part of it."""
    if entry.key.text != "params" or not isinstance(entry.value, Mapping):
        return entry
    defined = tuple(item for item in entry.value.entries if isinstance(item.value, Mapping))
    return Entry(entry.key, Mapping(defined, entry.value.at))


def _required(reader: Reader, root: Mapping, key: str) -> Node:
    node = root.get(key)
    if node is None:
        raise reader.broken(root.at, f"the device has no {key}", f"add {key}: NAME")
    return node
