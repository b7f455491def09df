"""The doors of the definition layer: a protocol by name or path, or from a text; a simulated device from its file."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

from framekit.definition.check import check_protocol
from framekit.definition.load.documents import Documents, SourceText, merged
from framekit.definition.load.protocol import ProtocolLoader
from framekit.definition.load.reader import Broken, Reader
from framekit.definition.model.protocol import Protocol
from framekit.definition.nodes import Entry, Mapping, Node
from framekit.definition.problems import DefinitionError, Position, Problem, did_you_mean
from framekit.definition.sources import Sources, current_keeper, definition_file, shipped_folder, sources_of


@dataclass(frozen=True, slots=True)
class Loaded:
    """A protocol and what it was read from."""

    protocol: Protocol
    sources: Sources


MOST_KEPT = 32
"""So many loaded definitions are kept in a process, those asked for last."""
_kept: dict[tuple[str, Path], Loaded] = {}


def load_protocol(name: str | Path, folder: Path | None = None) -> Protocol:
    """The protocol in a file, or of a name: beside `folder` (default: here), else shipped.

    Raises DefinitionError with every problem of it and of the files it stands on; warnings are in the result.
    """
    return load_with_files(name, folder).protocol


def load_with_files(name: str | Path, folder: Path | None = None) -> Loaded:
    """As `load_protocol`, with what was read.

    What was loaded before in this process is given again while its files hold what they held, and every name in them
    still means the same file: runs and devices of one protocol share it, and what was compiled of it.
    """
    path = definition_path(name, folder)
    key = str(path), path.resolve()
    kept = _kept.get(key)
    if kept is not None and kept.sources.still_hold():
        return _keep(key, kept)
    keeper = current_keeper()
    before = None if keeper is None else keeper.loaded(path)
    loaded = _load(path) if before is None else Loaded(*before)
    if keeper is not None and before is None:
        keeper.was_loaded(path, loaded.protocol, loaded.sources)
    return _keep(key, loaded)


def _keep(key: tuple[str, Path], loaded: Loaded) -> Loaded:
    _kept.pop(key, None)
    while len(_kept) >= MOST_KEPT:
        _kept.pop(next(iter(_kept)), None)
    _kept[key] = loaded
    return loaded


def _load(path: Path) -> Loaded:
    reader = Reader()
    documents = Documents(reader)
    protocol = None
    with suppress(Broken):
        loader = ProtocolLoader(reader, documents, documents.source(path))
        protocol = loader.load()
        reader.problems.extend(check_protocol(protocol, loader.broken(protocol)))
    problems = documents.first_words(reader.problems, path)
    if protocol is None or any(not problem.warning for problem in problems):
        raise DefinitionError(problems)
    return Loaded(replace(protocol, warnings=tuple(problems)), sources_of(documents.roots, documents.found))


def load_protocol_text(text: str, name: str = "definition", folder: Path | None = None) -> Protocol:
    """A protocol from its text, as if it stood in `NAME.yaml` in `folder`. Raises DefinitionError."""
    with TemporaryDirectory() as temporary:
        path = Path(temporary) / f"{name}.yaml"
        path.write_text(text, encoding="utf-8")
        if folder is not None:
            for other in folder.glob("*.yaml"):
                (Path(temporary) / other.name).symlink_to(other.resolve())
        return _load(path).protocol


def definition_path(name: str | Path, folder: Path | None = None) -> Path:
    """Where a definition stands. Raises DefinitionError when there is none of that name."""
    found = definition_file(name, folder or Path.cwd())
    if found is None and Path(folder or Path.cwd(), name).is_dir():
        what = "this is a folder, not a file"
        raise DefinitionError([Problem(Position(str(name), 0, 0), what, "name a file in it")])
    if found is None and Path(name).suffix in (".yaml", ".yml"):
        what = f"there is no file '{Path(name).name}'"
        raise DefinitionError([Problem(Position(str(name), 0, 0), what, "check its name and folder")])
    if found is None:
        folders = (folder or Path.cwd(), shipped_folder("frames"))
        files = [file for one in folders for file in one.glob("*.yaml")]
        known = {file.stem for file in files if "." not in file.stem}
        shipped = ", ".join(sorted(file.stem for file in files if file.stem in known and file.parent == folders[1]))
        hint = did_you_mean(str(name), known) or f"name a YAML file, or one that comes with framekit: {shipped}"
        raise DefinitionError([Problem(Position(str(name), 0, 0), f"there is no definition '{name}'", hint)])
    return found


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
