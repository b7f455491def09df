"""Load a `Protocol` from a definition file, by name, by path or from a text; load a simulated device from its file.

`ProtocolLoader` runs the loaders of all sections in the order of their dependencies.
"""

from __future__ import annotations

import glob
import os
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from shutil import copyfile
from tempfile import TemporaryDirectory
from typing import Any, TypeVar

from framekit.definition.check.protocol import check_protocol
from framekit.definition.keys import read_keys, read_part
from framekit.definition.kinds.data import LayoutName
from framekit.definition.load.documents import Documents, SourceText, joined, merged, scalar_of
from framekit.definition.load.frames import FrameLoader, SegmentLoader, resolve_references
from framekit.definition.load.namespace import Namespace, Owned, used_entries
from framekit.definition.load.procedure import ProcedureLoader, ValueLoader
from framekit.definition.load.reader import Broken, Reader
from framekit.definition.load.resolve import NumberNames, Stations, with_item_words
from framekit.definition.load.services import ServiceLoader, load_address_forms
from framekit.definition.model.frames import Frame, Layout, attributes_in, names_read, parts_of
from framekit.definition.model.procedure import Role, Sequence, Session
from framekit.definition.model.protocol import Protocol, Rest
from framekit.definition.model.sections import Line, Parameter, Probe, Queue, Receiver, StateVariable, StationType
from framekit.definition.model.services import AddressForm, AreaModel, CommandRules, Errors, Refusal, ServiceRow
from framekit.definition.model.values import FrameOf, LayoutOf, ReadAs, Table
from framekit.definition.nodes import Entry, Node, Scalar
from framekit.definition.nodes import Mapping as MappingNode
from framekit.definition.problems import DefinitionError, Position, Problem, did_you_mean
from framekit.definition.sources import Sources, current_cache, definition_file, known_definitions, sources_of
from framekit.definition.tree import words_in

T = TypeVar("T")
SECTIONS_OF_NAMES = (
    "checks", "tables", "params", "state", "queues", "layouts", "groups", "frames", "sequences", "roles",
    "sessions",
)  # fmt: skip
"""Sections whose names other sections use."""


class ProtocolLoader:
    """Reads one source. Problems go to the reader; broken parts are missing from the result."""

    def __init__(self, reader: Reader, documents: Documents, source: SourceText) -> None:
        self.reader = reader
        self.documents = documents
        self.source = source
        self.space = Namespace(reader, source)
        self.frames = FrameLoader(self.space)
        self.values = ValueLoader(self.space, self.frames)
        self.procedure = ProcedureLoader(self.values)
        self.broken_layouts: set[str] = set()
        self.words_of_forms: set[str] = set()
        self.rest = Rest()
        """What could be read of parts with errors, after `load`."""

    def load(self) -> Protocol:
        """Return the protocol as far as it could be read. Raise Broken if a whole section of names is none."""
        self._require_sections()
        frames = self.frames.load_all()
        groups = self.frames.load_groups()
        procedure = self.procedure
        sequences = self._each("sequences", procedure.sequence)
        roles = self._each("roles", lambda one: self._named(Role, one))
        sessions = self._each("sessions", lambda one: self._named(Session, one))
        services = ServiceLoader(self.values)
        rows = {name: services.rows(owned.entry) for name, owned in self.space.section("services").items()}
        areas, forms = self._areas()
        errors = self._errors(services)
        refusals = self._refusals(services)
        commands = self._commands(services)
        parts = [frames, sequences, roles, sessions, rows, forms, errors, refusals, commands]
        layouts = self._layouts(parts, areas)
        line, receiver = self._section(Line, "line"), self._section(Receiver, "receiver")
        parameters, state, tables = self._variables([*parts, layouts, line, receiver], frames)
        sequences = self._compared(sequences, frames, rows, parameters, forms)
        resolve = NumberNames(self.reader, frames, state)
        self.rest = Rest(tuple(self.frames.partly), tuple(services.partly))
        return Protocol(
            **self._head(),
            line=line,
            params=parameters,
            state=state,
            queues=self._each("queues", lambda one: self._named(Queue, one)),
            tables=tables,
            checks=self._each("checks", lambda entry: self.space.check(entry.key)),
            layouts=resolve.plainly(layouts),
            groups=groups,
            frames={name: resolve.frame(frame) for name, frame in frames.items()},
            receiver=receiver,
            sequences={name: resolve.sequence(sequence) for name, sequence in sequences.items()},
            roles=roles,
            sessions=sessions,
            areas=areas,
            addresses=resolve.plainly(forms),
            errors=resolve.plainly(errors),
            server_refusals=resolve.plainly(refusals),
            services={name: tuple(resolve.service(row) for row in found) for name, found in rows.items()},
            commands=resolve.plainly(commands),
            commands_file=self._commands_file(),
            probe=None if self._own("probe") is None else self._section(Probe, "probe"),
            warnings=(),
        )

    def _require_sections(self) -> None:
        """Raise Broken if the schema refuses the shape of a section of names: each reference would be reported."""
        problems = self.reader.problems
        for root in (source.root for source in (self.source, self.source.application) if source is not None):
            for key in SECTIONS_OF_NAMES:
                node = root.get(key)
                if node is not None and not isinstance(node, MappingNode) and any(not one.warning for one in problems):
                    raise Broken(key)

    def _compared(
        self,
        sequences: dict[str, Sequence],
        frames: Mapping[str, Frame],
        services: Mapping[str, tuple[ServiceRow, ...]],
        parameters: Mapping[str, Parameter],
        forms: Iterable[AddressForm],
    ) -> dict[str, Sequence]:
        """Return the sequences with the `station:` of their rows resolved."""
        of_places = {name for form in forms for name in form.names}
        built: list[tuple[FrameOf, set[str], set[str]]] = []
        for row in (row for found in services.values() for row in found):
            names = of_places if row.service in ("read", "write") else {argument.name for argument in row.takes}
            judged = attributes_in([row.back, row.back_each, row.when, row.refuse])
            built += [(made, names, judged) for made in (row.request,) if made is not None]
        for one in sequences.values():
            built += [(made, {*one.takes, *one.local}, set()) for made in parts_of(one, FrameOf)]
        shared = (*self.space.section("params"), *self.space.section("tables"))
        stations = Stations.derived(frames, built, shared, parameters)
        return {name: stations.compared(self.reader, sequence) for name, sequence in sequences.items()}

    def _head(self) -> dict[str, Any]:
        """Return the description of a definition, such as its name and source, and the files it was read from."""
        source, root = self.source, self.source.root
        profile = root.get("profile")
        return {
            "name": self._name(),
            "family": self._text("family"),
            "about": self._text("about"),
            "source": self._text("source"),
            "kind": "application" if root.get("protocol") is None else "protocol",
            "profile": self._text("profile") or None,
            "order": "little" if self._text("order") == "little" else "big",
            "station": self._section(StationType, "station"),
            "sources": source.files + (source.application.files if source.application else ()),
            "at": source.at,
            "profile_at": source.at if profile is None else profile.at,
        }

    def broken(self, loaded: Protocol) -> frozenset[str]:
        """Return the names of parts that could not be read completely.

        References to them are not reported as unknown.
        """
        named = {*self.frames.outlines, *self.space.section("frames")}
        missing = (named - loaded.frames.keys()) | self.broken_layouts | self.procedure.partly
        missing |= self.space.twice
        for section in ("params", "state", "queues", "tables", "sequences", "roles", "sessions"):
            missing |= self.space.section(section).keys() - getattr(loaded, section).keys()
        return frozenset(missing | (self._elsewhere("areas").section("areas").keys() - loaded.areas.keys()))

    def check(self, loaded: Protocol) -> list[Problem]:
        """Return the problems of the loaded protocol, without consequences of parts that could not be read."""
        return check_protocol(loaded, self.broken(loaded), frozenset(self.words_of_forms), self.rest)

    # ---- parts --------------------------------------------------------------------------------------------

    def _name(self) -> str:
        return self._text("protocol") or self._text("application") or self._text("device")

    def _own(self, key: str) -> Any:
        """Return a section of the definition, or else of its application."""
        node = self.source.root.get(key)
        if node is None and self.source.application is not None:
            node = self.source.application.root.get(key)
        return node

    def _text(self, key: str) -> str:
        return scalar_of(self.source.root.get(key)) or ""

    def _commands_file(self) -> str:
        """Return the name of the application of commands; its path if its file is in the folder of the definition."""
        node = self.source.root.get("commands")
        name = scalar_of(node) or ""
        if node is None or Path(name).suffix not in (".yaml", ".yml"):
            return name
        file = Path(node.at.file).resolve().parent / name
        return str(file) if file.is_file() else name

    def _each(self, section: str, load: Callable[[Entry], T]) -> dict[str, T]:
        found = {}
        for name, owned in self.space.section(section).items():
            with self.reader.going_on():
                found[name] = load(owned.entry)
        return found

    def _section(self, part: type[T], key: str) -> T:
        """Return a section that is a single mapping; its defaults if it is missing or broken."""
        node = self._own(key)
        if node is None:
            return part()
        known = {"at": node.at} if "at" in part.__dataclass_fields__ else {}  # type: ignore[attr-defined]
        with self.reader.going_on():
            return part(**read_keys(part, self, self.reader.mapping(node), lambda: None, **known))
        return part()

    def _named(self, part: type[T], entry: Entry, **known: Any) -> T:
        """Return the part under a name that the author of the file chooses. Raise Broken."""
        return read_part(part, self, entry.value, name=entry.key.text, at=entry.key.at, **known)

    def _elsewhere(self, key: str) -> Namespace:
        """Return the namespace of `areas: FILE` or `addresses: FILE`.

        Return the own namespace if the section is in this file.
        """
        name = scalar_of(self._own(key))
        if name is None:
            return self.space
        if name in self.space.uses:
            return self.space.uses[name]
        with self.reader.going_on():
            path = self.documents.find(self._own(key), self.source.path)
            return Namespace(self.reader, self.documents.source(path))
        return self.space

    def _areas(self) -> tuple[dict[str, AreaModel], tuple[AddressForm, ...]]:
        areas = {}
        for name, owned in self._elsewhere("areas").section("areas").items():
            with self.reader.going_on():
                areas[name] = self._named(AreaModel, owned.entry)
        space = self._elsewhere("addresses")
        node = space.source.root.get("addresses")
        if node is None and space.source.application is not None:
            node = space.source.application.root.get("addresses")
        tables = [*self.space.section("tables"), *space.section("tables")]
        node = None if isinstance(node, Scalar) else node
        forms = load_address_forms(self.reader, node, areas, tables)
        good = {form.at for form in forms}
        for item in self.reader.items(node):
            if item.at not in good:
                self.words_of_forms |= {"addresses", *words_in(item)}
        return areas, forms

    def _errors(self, services: ServiceLoader) -> Errors | None:
        node = self._own("errors")
        if node is not None:
            with self.reader.going_on():
                return services.errors(node)
        return None

    def _commands(self, services: ServiceLoader) -> CommandRules | None:
        """Return the rules for command blocks; None for a protocol, which only names an application with rules."""
        node = self.source.root.get("commands")
        if isinstance(node, MappingNode):
            with self.reader.going_on():
                return services.rules(node)
        return None

    def _refusals(self, services: ServiceLoader) -> tuple[Refusal, ...]:
        node = self._own("server")
        found = []
        for item in self.reader.items(node.get("refuse") if isinstance(node, MappingNode) else None):
            with self.reader.going_on():
                found.append(read_part(Refusal, services, item))
        return tuple(found)

    def _layouts(self, parts: list[Any], areas: Mapping[str, AreaModel]) -> dict[str, Layout]:
        """Return the layouts that are built or parsed by themselves; all other layouts are only included in frames."""
        wanted = {value.layout: value.at for value in parts_of(parts, LayoutOf)}
        wanted |= {value.layout: value.at for value in parts_of(parts, ReadAs)}
        wanted |= {area.layout: area.at for area in areas.values() if area.layout}
        wanted |= {shown.layout: shown.at for shown in parts_of(parts, LayoutName)}
        for owned in self._joined("state").values():
            for key in ("list", "record", "holds"):
                node = owned.entry.value.value(key) if isinstance(owned.entry.value, MappingNode) else None
                if isinstance(node, Scalar) and node.text in self.space.section("layouts"):
                    wanted[node.text] = node.at
        found: dict[str, Layout] = {}
        own = {name: owned.entry.key.at for name, owned in self.space.section("layouts").items()}
        for name, at in (own | wanted).items():  # report the problems of a layout even if no frame includes it
            before = len(self.reader.problems)
            with self.reader.going_on():
                loader = SegmentLoader(self.space, self.frames)
                segments = loader.layout(Scalar(name, at, False))
                if name in wanted:
                    whose, missing = f"layout '{name}'", self.frames.missing
                    segments = resolve_references(((), segments, ()), loader.aliases, whose, missing)[1]
                    segments = with_item_words(segments, loader.known)
                    missing.tell()
                found[name] = Layout(name=name, segments=segments, at=at)
                if loader.spoilt:
                    self.broken_layouts.add(name)
            if any(not problem.warning for problem in self.reader.problems[before:]):
                self.broken_layouts.add(name)
        return {name: layout for name, layout in found.items() if name in wanted and name not in self.broken_layouts}

    def _variables(
        self, parts: list[Any], frames: Mapping[str, Frame]
    ) -> tuple[dict[str, Parameter], dict[str, StateVariable], dict[str, Table]]:
        """Return the own parameters, state and tables, and those of used files that this definition reads."""
        announced = {one.name for frame in frames.values() for one in frame.announces}
        result: dict[str, dict[str, Any]] = {"params": {}, "state": {}, "tables": {}}

        def add(section: str, name: str, owned: Owned, space: Namespace) -> None:
            with self.reader.going_on():
                if section == "tables":
                    if (table := space.table(name)) is not None:
                        result[section][name] = table
                elif section == "params":
                    result[section][name] = self._named(Parameter, owned.entry)
                else:
                    keys = self.reader.mapping(owned.entry.value)
                    for key in ("list", "record"):
                        if "table" not in keys and (node := keys.value(key)) is not None:
                            space.layout(node)
                    result[section][name] = read_part(
                        StateVariable, space, keys, name=name, at=owned.entry.key.at, announced=name in announced
                    )

        for section in result:
            for name, owned in self._joined(section).items():
                add(section, name, owned, self.space)
        while True:
            mentioned = names_read([*parts, result])
            size = sum(map(len, result.values()))
            for section, found in result.items():
                for name, (space, owned) in used_entries(self.space, section).items():
                    if name in mentioned and name not in found:
                        add(section, name, owned, space)
            if sum(map(len, result.values())) == size:
                return result["params"], result["state"], result["tables"]

    def _joined(self, section: str) -> dict[str, Owned]:
        """Return the entries of a section.

        In params and state, keys of the protocol override those of its application.
        """
        entries = dict(self.space.section(section))
        application = self.source.application
        if application is None or section == "tables":
            return entries
        for entry in application.section(section):
            own = entries[entry.key.text]
            if own.source is not application and isinstance(own.entry.value, MappingNode):
                assert isinstance(entry.value, MappingNode)
                both = own.entry.holding(joined(entry.value, own.entry.value, 1))
                entries[entry.key.text] = Owned(both, own.source, False)
        return entries


# ---- by name, path or text ----------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Loaded:
    """A protocol and the files it was read from."""

    protocol: Protocol
    sources: Sources


MOST_KEPT = 32
"""Number of loaded definitions that a process keeps, by their most recent use."""
_kept: dict[tuple[str, Path], Loaded] = {}


def load_protocol(name: str | Path, folder: Path | None = None) -> Protocol:
    """Return the protocol in a file, or by name: from `folder` (default: the working folder) or a searched folder.

    Raise DefinitionError with all problems of the file and of its bases; the result contains the warnings.
    """
    return load_with_files(name, folder).protocol


def load_with_files(name: str | Path, folder: Path | None = None) -> Loaded:
    """Return the result of `load_protocol` with the files that were read.

    A definition loaded earlier in this process is returned again while its files have the same content and every name
    in them still leads to the same file. Runs and devices of one protocol thus share it and its compiled code.
    """
    path = definition_path(name, folder)
    key = str(path), path.resolve()
    kept = _kept.get(key)
    if kept is not None and kept.sources.still_hold():
        return _keep(key, kept)
    cache = current_cache()
    before = None if cache is None else cache.loaded(path)
    loaded = _load(path) if before is None else Loaded(*before)
    if cache is not None and before is None:
        cache.was_loaded(path, loaded.protocol, loaded.sources)
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
        reader.problems.extend(loader.check(protocol))
    problems = documents.first_words(reader.problems, path)
    if protocol is None or any(not problem.warning for problem in problems):
        raise DefinitionError(problems)
    return Loaded(replace(protocol, warnings=tuple(problems)), sources_of(documents.roots, documents.found))


def load_protocol_text(text: str, name: str = "definition", folder: Path | None = None) -> Protocol:
    """Return a protocol from its text, as if it were the file `NAME.yaml` in `folder`. Raise DefinitionError."""
    with TemporaryDirectory() as temporary:
        path = Path(temporary) / f"{name}.yaml"
        path.write_text(text, encoding="utf-8")
        if folder is not None:
            for other in folder.glob("*.yaml"):
                beside = Path(temporary) / other.name
                try:
                    beside.symlink_to(other.resolve())
                except OSError:  # Windows restricts links to few users
                    copyfile(other, beside)
        return _load(path).protocol


def definition_path(name: str | Path, folder: Path | None = None) -> Path:
    """Return the path of a definition. Raise DefinitionError if it does not exist."""
    found = definition_file(name, folder or Path.cwd())
    if found is None and os.path.isdir(Path(folder or Path.cwd(), name)):
        what = "this is a folder, not a file"
        raise DefinitionError([Problem(Position(str(name), 0, 0), what, "name a file in it")])
    if found is None and Path(name).suffix in (".yaml", ".yml"):
        what = f"there is no file '{Path(name).name}'"
        raise DefinitionError([Problem(Position(str(name), 0, 0), what, "check its name and folder")])
    if found is None:
        own = {file.stem for file in (folder or Path.cwd()).glob("*.yaml") if "." not in file.stem}
        ours = {file.stem for file in known_definitions() if "." not in file.stem}
        known, shipped = own | ours, ", ".join(sorted(ours))
        wanted = Path(folder or Path.cwd(), name)
        with_it = sorted(file.name for file in wanted.parent.glob(f"{glob.escape(wanted.name)}.*.yaml"))
        hint = (
            f"did you mean {with_it[0]}?"
            if with_it
            else did_you_mean(str(name), known) or f"name a YAML file, or one that comes with framekit: {shipped}"
        )
        raise DefinitionError([Problem(Position(str(name), 0, 0), f"there is no definition '{name}'", hint)])
    return found


OWN_SECTIONS = (
    "params", "state", "queues", "tables", "layouts", "sequences", "roles", "sessions", "errors", "server", "services",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class DeviceDefinition:
    """A device file as read by this layer."""

    name: str
    protocol: Protocol
    root: MappingNode
    """The nodes of the file, with `memory`, `station` and `params` not interpreted yet."""
    path: Path
    plain: bool = False
    """Whether the device has no rules of its own and shares the checked protocol with everything else that loads it."""


def load_device_definition(reader: Reader, documents: Documents, name: str | Path, folder: Path) -> DeviceDefinition:
    """Return the definition of a device. Raise Broken if it cannot be read, DefinitionError if the file does not exist.

    Problems go to the reader.
    """
    path = definition_path(name, folder)
    root = documents.root(path, "device")
    found = documents.find(_required(reader, root, "protocol"), path)
    own = MappingNode(tuple(_own(entry) for entry in root.entries if entry.key.text in OWN_SECTIONS), root.at)
    plain = None if any(_says(entry) for entry in own.entries) else _protocol(found)
    if plain is not None:
        return DeviceDefinition(reader.text(root.get("device")), plain, root, path, plain=True)
    base = documents.source(found)
    whole = SourceText(merged(base.root, own), path, base.names, (str(path), *base.files), base.uses, base.application)
    loader = ProtocolLoader(reader, documents, whole)
    protocol = replace(loader.load(), at=root.at)
    reader.problems.extend(loader.check(protocol))
    return DeviceDefinition(reader.text(root.get("device")), protocol, root, path)


def _own(entry: Entry) -> Entry:
    """Return a section of the device; `params` without the entries that only set a value."""
    if entry.key.text != "params" or not isinstance(entry.value, MappingNode):
        return entry
    defined = tuple(item for item in entry.value.entries if isinstance(item.value, MappingNode))
    return entry.holding(MappingNode(defined, entry.value.at))


def _says(entry: Entry) -> bool:
    return not isinstance(entry.value, MappingNode) or bool(entry.value.entries)


def _protocol(path: Path) -> Protocol | None:
    """Return the protocol in a file; None if it is invalid, which the full load of the device reports."""
    try:
        found = load_protocol(path)
    except DefinitionError:
        return None
    return None if found.kind == "application" else found


def _required(reader: Reader, root: MappingNode, key: str) -> Node:
    node = root.get(key)
    if node is None:
        raise reader.broken(root.at, f"the device has no {key}", f"add {key}: NAME")
    return node
