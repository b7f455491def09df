"""Simulated devices as files describe them: protocol, role, memory with start values, parameters, station."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from framekit.blocks.device_settings import NO_FILE, DeviceSettings
from framekit.blocks.fault_plan import FaultPlan
from framekit.blocks.given import read_params, read_station
from framekit.blocks.load_fault_plan import read_fault_plan
from framekit.blocks.memory_settings import check_places, memory_of, put_values, read_mapping, start_value
from framekit.blocks.memory_sizes import read_sizes
from framekit.blocks.model import Place
from framekit.blocks.own_memory import AnyAddresses, addresses_of
from framekit.blocks.profile_places import check_profile
from framekit.definition.check import check_protocol
from framekit.definition.expression.syntax import names_in
from framekit.definition.load.device import DeviceDefinition, load_device_definition
from framekit.definition.load.documents import Documents
from framekit.definition.load.library import definition_path, load_protocol
from framekit.definition.load.reader import Broken, Reader
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.services import Area as AreaModel
from framekit.definition.model.walk import expressions_of
from framekit.definition.nodes import Entry, Scalar, read_nodes, without
from framekit.definition.nodes import Mapping as MappingNode
from framekit.definition.problems import DefinitionError, Position, Problem, did_you_mean
from framekit.definition.schema import kind_of
from framekit.link.addresses import AddressGrammar
from framekit.memory.memory import Area, DeviceMemory
from framekit.memory.profile import MemoryProfile, load_profile, load_profile_node

NO_PROFILE = ("set", "map", "sizes", "about", "source")
"""Keys of `memory:` that do not make a memory of its own."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Device:
    """A simulated device, ready to be put on a line. `grammar` reads addresses of its memory.

    `profile` is None for a memory that is the areas of the protocol. `mapping`: areas of the protocol that stand
    elsewhere in the memory (area → memory area and the number of its first element there). `shares`: it is the
    device of that name before it, over another protocol of the line (`also`): they have one memory.
    """

    name: str
    protocol: Protocol
    role: str | None
    own: Any
    params: Mapping[str, Any]
    areas: tuple[Area, ...]
    grammar: AddressGrammar
    profile: MemoryProfile | None
    mapping: Mapping[str, tuple[str, int]]
    initial: tuple[tuple[Place, tuple[int, ...]], ...]
    faults: FaultPlan | None = None
    shares: bool = False

    @property
    def station(self) -> str:
        """Its own station for people: bytes that are a text as this text, others as hex pairs; '' for none."""
        if isinstance(self.own, bytes):
            text = self.own.rstrip(b"\0")
            return (
                text.decode() if text.isascii() and text.decode().isprintable() and text else self.own.hex(" ").upper()
            )
        return "" if self.own is None else str(self.own)

    def areas_without_memory(self) -> list[str]:
        """Areas of the protocol that a memory of its own does not have: every request for them is refused."""
        if self.profile is None:
            return []
        known = {name for area in self.areas for name in (area.name, *area.aliases)}
        return [
            area.name
            for area in self.protocol.areas.values()
            if area.layout is None and area.name not in self.mapping and area.memory not in known
        ]

    def create_memory(self) -> DeviceMemory:
        """A memory of its own with the start values in it."""
        memory = DeviceMemory(
            Area(area.name, size=area.size, unit=area.unit, access=area.access, aliases=area.aliases)
            for area in self.areas
        )
        put_values(memory, self.initial)
        return memory


def load_devices(name: str | Path, folder: Path, settings: DeviceSettings | None = None) -> tuple[Device, ...]:
    """The device in a file, or one that simply serves a protocol's memory; once for every station that it has.

    `settings` go before what the file says. Raises DefinitionError with everything that is wrong.
    """
    reader = Reader()
    documents = Documents(reader)
    devices: tuple[Device, ...] = ()
    with suppress(Broken):
        definition = _definition(reader, documents, name, folder)
        if settings is not None:
            definition = replace(definition, root=settings.on(definition.root))
        devices = _DeviceLoader(reader, definition).load()
        devices += _over_others(reader, documents, definition, devices)
    file = definition_path(name, folder) if settings is None else None  # settings go before keys of the file
    problems = documents.first_words(reader.problems, file)
    if not devices or any(not problem.warning for problem in problems):
        raise DefinitionError(problems)
    return devices


def _over_others(
    reader: Reader, documents: Documents, definition: DeviceDefinition, devices: tuple[Device, ...]
) -> tuple[Device, ...]:
    """The same devices over the other protocols that the file names (`also`); what is wrong is noted."""
    root, found = definition.root, list[Device]()
    for node in reader.items(root.get("also")):
        with reader.going_on():
            protocol = load_protocol(documents.find(node, definition.path))
            if protocol.kind == "application" or protocol.name in {one.protocol.name for one in (*devices, *found)}:
                what = f"'{reader.text(node)}' is no other protocol for this line"
                raise reader.broken(node.at, what, "name a protocol, each once")
            own = tuple(entry for entry in root.entries if entry.key.text in ("device", "station"))
            given = tuple(entry for entry in reader.entries(root.get("params")) if entry.key.text in protocol.params)
            if given:
                own = (*own, Entry(Scalar("params", node.at), MappingNode(given, node.at)))
            part = replace(definition, protocol=protocol, root=MappingNode(own, root.at), plain=True)
            loader = _DeviceLoader(reader, part)
            for one, main in zip(loader.load(), devices, strict=False):
                known = {name for area in main.areas for name in (area.name, *area.aliases)}
                if main.mapping or known.isdisjoint(area.memory for area in protocol.areas.values()):
                    what = f"no area of '{protocol.name}' is in the memory of this device"
                    raise reader.broken(node.at, what, "name a protocol for the same memory, without map")
                one = replace(one, areas=main.areas, grammar=main.grammar, profile=main.profile, initial=())
                found.append(replace(one, name=main.name, shares=True))
    return tuple(found)


def _definition(reader: Reader, documents: Documents, name: str | Path, folder: Path) -> DeviceDefinition:
    """Raises Broken and DefinitionError."""
    path = definition_path(name, folder)
    kind = kind_of(read_nodes(path, noted=[]))
    if kind == "protocol":
        protocol = load_protocol(path)
        at = Position(str(name), 0, 0)
        if protocol.kind == "application":
            what = f"'{protocol.name}' has no line of its own"
            raise DefinitionError([Problem(at, what, "name a protocol that carries it")])
        return DeviceDefinition(protocol.name, protocol, MappingNode((), at), folder / "device", frozenset())
    if kind != "device":
        what = f"this is a {kind} file"
        raise DefinitionError([Problem(Position(str(name), 0, 0), what, "name a protocol or a device file")])
    definition = load_device_definition(reader, documents, path, folder)
    if definition.protocol.kind == "application" and (named := definition.root.get("protocol")) is not None:
        reader.note(named.at, f"'{definition.protocol.name}' has no line of its own", "name a protocol that carries it")
    if not definition.plain:
        reader.problems.extend(check_protocol(definition.protocol, definition.broken))
    return definition


class _DeviceLoader:
    def __init__(self, reader: Reader, definition: DeviceDefinition) -> None:
        self.reader = reader
        self.definition = definition
        self.protocol = definition.protocol
        self.root = definition.root
        self.is_protocol_sound = all(problem.warning for problem in reader.problems)

    def load(self) -> tuple[Device, ...]:
        """The devices; what is wrong is noted. Raises Broken where a wrong protocol leaves their memory open."""
        reader, role = self.reader, None
        with reader.going_on():
            role = self._role()
        stations = self._stations() or self._usual_station(role)
        settings = [
            entry for entry in reader.entries(self.root.get("params")) if not isinstance(entry.value, MappingNode)
        ]
        params = read_params(reader, settings, self.protocol)
        profile, areas, grammar = self._memory()
        reader.problems.extend(check_places(self.protocol, grammar))
        node = self.root.get("memory")
        mapped = node.get("map") if isinstance(node, MappingNode) else None
        device = Device(
            name=self.definition.name,
            protocol=self.protocol,
            role=role,
            own=None,
            params=params,
            areas=areas,
            grammar=grammar,
            profile=profile,
            mapping=read_mapping(reader, mapped, self.protocol, grammar),
            initial=self._initial(grammar),
            faults=read_fault_plan(reader, self.root.get("faults"), self.definition.path.parent, self.protocol),
        )
        if len(stations) < 2:
            return (replace(device, own=stations[0] if stations else None),)
        return tuple(replace(device, name=f"{device.name} {own}", own=own) for own in stations)

    def _memory(self) -> tuple[MemoryProfile | None, tuple[Area, ...], AddressGrammar]:
        """Profile, areas and addresses of the memory; where its description is wrong, any that look like addresses."""
        try:
            profile = self._profile()
        except DefinitionError as error:
            self.reader.problems.extend(error.problems)
            return None, (), AnyAddresses()
        sizes = self._sizes(profile)
        if profile is None:
            return None, *memory_of(self.protocol, sizes)
        self.reader.problems.extend(check_profile(profile))
        return profile, tuple(profile.create()), addresses_of(profile)

    def _stations(self) -> list[Any]:
        """The device's stations; what is wrong with one is noted."""
        found: list[Any] = []
        for node in self.reader.items(self.root.get("station")):
            with self.reader.going_on():
                station = read_station(self.reader, node, self.protocol)
                if station in found:
                    raise self.reader.broken(node.at, f"station {station} stands here twice", "leave one out")
                found.append(station)
        return found

    def _usual_station(self, role: str | None) -> list[Any]:
        """The station of a bare protocol's device for which none is given: 1, where it has to have one."""
        station = self.protocol.station
        if self.root.get("device") is not None or role is None or station.default is not None:
            return []
        lanes = self.protocol.roles[role].lanes
        sequences = [self.protocol.sequences[name] for lane in lanes for name in (*lane.exchange, lane.listen) if name]
        if station.type == "none" or not any("own" in names_in(one.root) for one in expressions_of(sequences)):
            return []
        if station.type != "number":
            self.reader.note(NO_FILE, f"'{self.protocol.name}' has stations", "say which one this is: --station")
            return []
        return [1 if station.limits is None else max(1, station.limits[0])]

    def _role(self) -> str | None:
        roles, node = self.protocol.roles, self.root.get("role")
        if not roles:
            return None
        if node is not None:
            role = self.reader.text(node)
            if role not in roles:
                raise self.reader.broken(node.at, f"there is no role '{role}'", did_you_mean(role, roles))
            return role
        own = [entry.key.text for entry in self.reader.entries(self.root.get("roles"))]
        usual = next((role for role in own if role in roles), self.protocol.serving_role)
        if usual is None:
            known = ", ".join(roles)
            what = f"no role of '{self.protocol.name}' listens, so nothing would answer (it has {known})"
            raise self.reader.broken(self.root.at, what, "give the protocol a role with listen:, or say role:")
        return usual

    def _profile(self) -> MemoryProfile | None:
        """The profile that the file describes; None for the areas of the protocol. Raises Broken, DefinitionError."""
        node = self.root.get("memory")
        described = isinstance(node, Scalar) or (
            isinstance(node, MappingNode) and any(entry.key.text not in NO_PROFILE for entry in node.entries)
        )
        if node is None or not described:
            if not self.is_protocol_sound:
                raise Broken("what the protocol says of its areas may be wrong")
            return None
        folder = self.definition.path.parent
        if isinstance(node, MappingNode):
            return load_profile_node(without(without(without(node, "set"), "map"), "sizes"), folder)
        return load_profile(self.reader.text(node), folder, node.at)

    def _sizes(self, profile: MemoryProfile | None) -> dict[str, AreaModel]:
        """How large areas of the protocol are, where the file says so."""
        memory = self.root.get("memory")
        node = memory.get("sizes") if isinstance(memory, MappingNode) else None
        if node is not None and profile is not None:
            what, todo = "sizes are for the areas of a protocol, and this memory has its own", "say them there"
            self.reader.note(node.at, what, todo)
            return {}
        return read_sizes(self.reader, node, self.protocol)

    def _initial(self, grammar: AddressGrammar) -> tuple[tuple[Place, tuple[int, ...]], ...]:
        node = self.root.get("memory")
        entries = self.reader.entries(node.get("set")) if isinstance(node, MappingNode) else ()
        return tuple(value for entry in entries if (value := start_value(self.reader, grammar, entry)) is not None)
