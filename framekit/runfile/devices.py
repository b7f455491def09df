"""Simulated devices as files describe them: protocol, role, memory with start values, parameters, station.

Settings of a command line or a program replace the settings of the device file, or complete a bare protocol.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from collections.abc import Mapping as MappingOf
from collections.abc import Sequence as SequenceOf
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from framekit.definition.expression import Call, Text, names_in, walk
from framekit.definition.load.documents import Documents
from framekit.definition.load.protocol import DeviceDefinition, definition_path, load_device_definition, load_protocol
from framekit.definition.load.reader import Broken, Reader
from framekit.definition.model.frames import expressions_of, parts_of
from framekit.definition.model.procedure import Action
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.services import AreaModel
from framekit.definition.nodes import Entry, Node, Scalar, Sequence, read_nodes, without
from framekit.definition.nodes import Mapping as MappingNode
from framekit.definition.problems import DefinitionError, Position, Problem, did_you_mean, parted
from framekit.definition.schema import kind_of
from framekit.link.addresses import Address, AddressError, AddressGrammar
from framekit.memory.memory import Area as MemoryArea
from framekit.memory.memory import DeviceMemory, OrderedArea
from framekit.memory.profile import ClockBit, FixedBit, MemoryProfile, load_profile, load_profile_node
from framekit.run.behaviours import Behaviour
from framekit.run.model import FaultPlan, Network, OwnPlace
from framekit.run.own_memory import AnyAddresses, ProtocolAddresses, addresses_of
from framekit.runfile.behave import BehaveLoader
from framekit.runfile.channels import needs_station, read_clients, read_mapping, read_params, read_station
from framekit.runfile.device_state import with_state
from framekit.runfile.fault_plans import load_fault_plan, mismatches, offered_faults, read_fault_plan
from framekit.runfile.transfers import number_for

NO_PROFILE = ("set", "map", "sizes", "about", "source")
"""Keys of `memory:` that do not define a memory of its own."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Device:
    """A simulated device, ready to be put on a line."""

    name: str
    protocol: Protocol
    role: str | None
    own: Any
    params: MappingOf[str, Any]
    areas: tuple[MemoryArea, ...]
    grammar: AddressGrammar
    """Reader of addresses of its memory."""
    profile: MemoryProfile | None
    """Profile of its memory; None if the memory has the areas of the protocol."""
    mapping: MappingOf[str, tuple[str, int]]
    """Areas of the protocol placed elsewhere in the memory: area → memory area and number of its first element
    there.
    """
    initial: tuple[tuple[OwnPlace, tuple[int, ...]], ...]
    faults: FaultPlan | None = None
    shares: bool = False
    """Whether it is the same device as the one before it, over another protocol of the line (`also`): both use one
    memory.
    """
    behaviours: tuple[Behaviour, ...] = ()
    clients: tuple[Network, ...] = ()
    """Networks whose clients are served; empty for all."""
    read_only: bool = False
    """Whether clients may not write."""

    @property
    def station(self) -> str:
        """Return the station for users: printable bytes as text, other bytes as hex pairs; '' for none."""
        if isinstance(self.own, bytes):
            text = self.own.rstrip(b"\0")
            return (
                text.decode() if text.isascii() and text.decode().isprintable() and text else self.own.hex(" ").upper()
            )
        return "" if self.own is None else str(self.own)

    @property
    def lacks_station(self) -> bool:
        """Return whether it has no station although requests of its protocol may name one."""
        by_default = self.protocol.station.default is not None
        return self.own is None and (by_default or needs_station(self.protocol))

    def areas_without_memory(self) -> list[str]:
        """Return the areas of the protocol that the device's own memory lacks: every request for them is refused."""
        if self.profile is None:
            return []
        known = {name for area in self.areas for name in (area.name, *area.aliases)}
        return [
            area.name
            for area in self.protocol.areas.values()
            if area.layout is None and area.name not in self.mapping and area.memory not in known
        ]

    def create_memory(self) -> DeviceMemory:
        """Return a new memory with the start values."""
        memory = DeviceMemory(area.anew() for area in self.areas)
        put_values(memory, self.initial)
        return memory


def load_devices(name: str | Path, folder: Path, settings: DeviceSettings | None = None) -> tuple[Device, ...]:
    """Load the device of a file, or a device that serves the memory of a bare protocol; one device for each station.

    `settings` take precedence over the file. Raises DefinitionError with all problems.
    """
    reader = Reader()
    documents = Documents(reader)
    devices: tuple[Device, ...] = ()
    with suppress(Broken):
        try:
            definition = _definition(reader, documents, name, folder)
        except Broken:
            _look_at_rest(reader, documents, definition_path(name, folder))
            raise
        if settings is not None:
            protocol = with_state(definition.protocol, settings.state)
            definition = replace(definition, root=settings.on(definition.root), protocol=protocol)
        devices = _DeviceLoader(reader, definition).load()
        devices += _over_others(reader, documents, definition, devices)
    file = definition_path(name, folder) if settings is None else None  # settings go before keys of the file
    problems = documents.first_words(reader.problems, file)
    if not devices or any(not problem.warning for problem in problems):
        raise DefinitionError(problems)
    return devices


def _look_at_rest(reader: Reader, documents: Documents, path: Path) -> None:
    """Note problems of the keys of a device file that do not depend on its protocol."""
    root = documents.roots.get(path.resolve())
    if root is not None:
        read_fault_plan(reader, root.get("faults"), path.parent, None)
        reader.tried(partial(read_clients, reader), root.get("clients"))


def _over_others(
    reader: Reader, documents: Documents, definition: DeviceDefinition, devices: tuple[Device, ...]
) -> tuple[Device, ...]:
    """Return the same devices over the other protocols that the file names (`also`); problems are noted."""
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
                one = replace(one, areas=main.areas, grammar=main.grammar, profile=main.profile, initial=(), clients=())
                found.append(replace(one, name=main.name, shares=True))
    return tuple(found)


def _definition(reader: Reader, documents: Documents, name: str | Path, folder: Path) -> DeviceDefinition:
    """Read the definition of a device or protocol file. Raises Broken and DefinitionError."""
    path = definition_path(name, folder)
    kind = kind_of(read_nodes(path, noted=[], begin="device: NAME or protocol: NAME"))
    if kind == "protocol":
        protocol = load_protocol(path)
        at = Position(str(name), 0, 0)
        if protocol.kind == "application":
            what = f"'{protocol.name}' has no line of its own"
            raise DefinitionError([Problem(at, what, "name a protocol that carries it")])
        return DeviceDefinition(protocol.name, protocol, MappingNode((), at), folder / "device")
    if kind != "device":
        what = f"this is a {kind} file"
        raise DefinitionError([Problem(Position(str(name), 0, 0), what, "name a protocol or a device file")])
    definition = load_device_definition(reader, documents, path, folder)
    if definition.protocol.kind == "application" and (named := definition.root.get("protocol")) is not None:
        reader.note(named.at, f"'{definition.protocol.name}' has no line of its own", "name a protocol that carries it")
    return definition


class _DeviceLoader:
    def __init__(self, reader: Reader, definition: DeviceDefinition) -> None:
        self.reader = reader
        self.definition = definition
        self.protocol = definition.protocol
        self.root = definition.root
        file = definition.root.at.file
        self.is_protocol_sound = all(problem.warning or problem.at.file == file for problem in reader.problems)
        """Whether the areas and addresses of the protocol are right; a device file does not change them."""

    def load(self) -> tuple[Device, ...]:
        """Return the devices; problems are noted."""
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
            initial=start_values(reader, grammar, node.get("set") if isinstance(node, MappingNode) else None),
            faults=read_fault_plan(reader, self.root.get("faults"), self.definition.path.parent, self.protocol),
            behaviours=self._behaviours(grammar),
            clients=reader.tried(partial(read_clients, reader), self.root.get("clients")) or (),
        )
        if len(stations) < 2:
            return (replace(device, own=stations[0] if stations else None),)
        return tuple(replace(device, name=f"{device.name} {own}", own=own) for own in stations)

    def _memory(self) -> tuple[MemoryProfile | None, tuple[MemoryArea, ...], AddressGrammar]:
        """Return profile, areas and address grammar of the memory; if its description is wrong, a grammar that accepts
        any address.
        """
        try:
            profile = self._profile()
        except Broken:
            return None, (), AnyAddresses()
        except DefinitionError as error:
            self.reader.problems.extend(error.problems)
            return None, (), AnyAddresses()
        sizes = self._sizes(profile)
        if profile is None:
            return None, *memory_of(self.protocol, sizes)
        self.reader.problems.extend(check_profile(profile))
        return profile, tuple(profile.create()), addresses_of(profile)

    def _behaviours(self, grammar: AddressGrammar) -> tuple[Behaviour, ...]:
        """Return the behaviours of the memory; an empty tuple if its addresses are unknown."""
        if isinstance(grammar, AnyAddresses):
            return ()
        loader, memory = BehaveLoader(self.reader, self.definition.path.parent, grammar), self.root.get("memory")
        found = loader.load(self.root.get("behave"))
        loader.check_start_values(memory.get("set") if isinstance(memory, MappingNode) else None, found)
        return found

    def _stations(self) -> list[Any]:
        """Return the stations of the device; a wrong station is noted and left out."""
        found: list[Any] = []
        for node in self.reader.items(self.root.get("station")):
            with self.reader.going_on():
                station = read_station(self.reader, node, self.protocol)
                if station in found:
                    raise self.reader.broken(node.at, f"station {station} stands here twice", "leave one out")
                found.append(station)
        return found

    def _usual_station(self, role: str | None) -> list[Any]:
        """Return the station of a bare protocol's device without a given station: 1 if the protocol needs a station
        number.
        """
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
            if not roles[role].listens:
                todo = did_you_mean(role, [one.name for one in roles.values() if one.listens])
                raise self.reader.broken(node.at, f"the role '{role}' only asks, so nothing would answer", todo)
            return role
        own = [entry.key.text for entry in self.reader.entries(self.root.get("roles"))]
        usual = next((role for role in own if role in roles), self.protocol.serving_role)
        if usual is None:
            known = ", ".join(roles)
            what = f"no role of '{self.protocol.name}' listens, so nothing would answer (it has {known})"
            raise self.reader.broken(self.root.at, what, "give the protocol a role with listen:, or say role:")
        return usual

    def _profile(self) -> MemoryProfile | None:
        """Return the profile of the file; None for the areas of the protocol. Raises Broken, DefinitionError."""
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
        """Return the sizes of areas of the protocol that the file gives."""
        memory = self.root.get("memory")
        node = memory.get("sizes") if isinstance(memory, MappingNode) else None
        if node is not None and profile is not None:
            what, todo = "sizes are for the areas of a protocol, and this memory has its own", "say them there"
            self.reader.note(node.at, what, todo)
            return {}
        return read_sizes(self.reader, node, self.protocol)


def with_faults(devices: SequenceOf[Device], name: str | None, folder: Path) -> list[Device]:
    """Return the devices with a plan added to their own.

    Raises DefinitionError, also for faults that the protocol does not support.
    """
    if name is None:
        return list(devices)
    plan = load_fault_plan(name, folder)
    if problems := [problem for device in devices for problem in mismatches(plan, device.protocol, line=False)]:
        raise DefinitionError(problems)
    return [replace(device, faults=plan.joined(device.faults)) for device in devices]


def offering_faults(device: Device) -> Device:
    """Return the device with faults that can be switched on while it works, in addition to its own."""
    offered = offered_faults(device.protocol)
    return replace(device, faults=offered if device.faults is None else device.faults.joined(offered))


# ---- settings of a command line or a program ---------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class DeviceSettings:
    """Settings that take precedence over a device file."""

    stations: tuple[str, ...] = ()
    """Stations; each is a device with its own memory."""
    role: str | None = None
    memory: str | None = None
    """Name of a memory profile."""
    initial: MappingOf[str, str] = field(default_factory=dict)
    """Start values: ADDRESS → values separated by commas."""
    sizes: MappingOf[str, str] = field(default_factory=dict)
    """Sizes of areas: ADDRESS → number of elements of its area."""
    params: MappingOf[str, str] = field(default_factory=dict)
    """Parameters: NAME → value."""
    mapping: MappingOf[str, str] = field(default_factory=dict)
    """AREA of the protocol → ADDRESS in the memory at which it begins."""
    state: MappingOf[str, Any] = field(default_factory=dict)
    """NAME of a state variable → its start value."""

    def on(self, root: MappingNode) -> MappingNode:
        """Return the file with these settings replaced; start values and map entries are added to the file's."""
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


def _texts(flag: str, texts: MappingOf[str, str]) -> dict[str, Node]:
    """Return the values by name; a value with commas is a list."""
    found: dict[str, Node] = {}
    for name, text in texts.items():
        at = _at(flag, f"{name}={text}")
        items = [part.strip() for part in text.strip("[]").split(",")] if flag == "set" else [text]
        values = tuple(Scalar(item, at) for item in items)
        found[name] = values[0] if len(values) == 1 else Sequence(values, at)
    return found


def _joined(old: Node | None, changes: MappingOf[str, Node]) -> MappingNode:
    """Return the entries of a mapping, with some replaced and some added."""
    entries: Iterable[Entry] = old.entries if isinstance(old, MappingNode) else ()
    kept = [entry for entry in entries if entry.key.text not in changes]
    added = [Entry(Scalar(name, getattr(node, "at", NO_FILE)), node) for name, node in changes.items()]
    return MappingNode((*kept, *added), NO_FILE if old is None else old.at)


def _at(flag: str, text: str) -> Position:
    return Position(f"--{flag} {text}", 0, 0)


NO_FILE = Position("the command line", 0, 0)


# ---- memory in files ---------------------------------------------------------------------------------------


def put_values(memory: DeviceMemory, initial: tuple[tuple[OwnPlace, tuple[int, ...]], ...]) -> None:
    """Write start values to a memory, also to areas that are read-only for clients."""
    for place, values in initial:
        memory.area(place.address.area).write_from(place.address.first_bit, place.address.unit, values, force=True)


def memory_of(
    protocol: Protocol, sizes: MappingOf[str, AreaModel] | None = None
) -> tuple[tuple[MemoryArea, ...], AddressGrammar]:
    """Return a memory with the areas and addresses of a protocol; `sizes`: areas of another size.

    A size of 0 omits an area.
    """
    found: dict[str, AreaModel] = {}
    for area in protocol.areas.values():
        if area.layout is None:
            found.setdefault(area.memory, area)
    found |= sizes or {}
    areas = (_memory_area(name, area) for name, area in found.items() if area.size)
    return tuple(areas), ProtocolAddresses(protocol, sizes)


def _memory_area(name: str, area: AreaModel) -> MemoryArea:
    if area.order == "little":
        return MemoryArea(name, size=area.size, unit=area.unit)
    return OrderedArea(name, size=area.size, unit=area.unit, order=area.order)


def check_places(protocol: Protocol, grammar: AddressGrammar) -> Iterator[Problem]:
    """Yield a problem for each address in a sequence, in `store` or `memory('…', N)`, that the memory lacks."""
    sequences = list(protocol.sequences.values())
    places = [(where.at, text) for action in parts_of(sequences, Action) for where, text in action.store]
    for expression in expressions_of(sequences):
        for node in walk(expression.root):
            if isinstance(node, Call) and node.function == "memory" and isinstance(node.arguments[0], Text):
                places.append((node.arguments[0].at, node.arguments[0].value))
    for at, text in places:
        try:
            address = grammar.parse(text)
        except AddressError as error:
            yield Problem(at, *parted(error))
        else:
            if address.first_bit % 8:
                yield Problem(at, f"{text} is in the middle of a byte", "name a byte or a word")


StartValue = tuple[OwnPlace, tuple[int, ...]]
"""Values of a memory from a place on."""


def start_values(reader: Reader, grammar: AddressGrammar, node: Node | None) -> tuple[StartValue, ...]:
    """Return the start values of a mapping `ADDRESS: value` or `ADDRESS: [values]`; broken entries are noted and left
    out.
    """
    found = (_start_value(reader, grammar, entry) for entry in reader.entries(node))
    return tuple(value for value in found if value is not None)


def _start_value(reader: Reader, grammar: AddressGrammar, entry: Entry) -> StartValue | None:
    with reader.going_on():
        text = entry.key.text
        with reader.refusing(entry.key.at):
            address = grammar.parse(text)
        values = tuple(number_for(reader, item, address) for item in reader.items(entry.value))
        with reader.refusing(entry.value.at):
            grammar.check(address, max(1, len(values)))
        bits = address.unit_bits
        for item, value in zip(reader.items(entry.value), values, strict=True):
            least = -(1 << bits - 1) if bits > 1 else 0
            if not least <= value < 1 << bits:
                what = f"{value} does not fit into a {address.unit}"
                raise reader.broken(item.at, what, f"give {least} to {(1 << bits) - 1}")
        return OwnPlace(address=address, text=text), tuple(value & ((1 << bits) - 1) for value in values)
    return None


MOST_ELEMENTS = 1 << 20


def read_sizes(reader: Reader, node: Node | None, protocol: Protocol) -> dict[str, AreaModel]:
    """Return the areas with the sizes of `sizes: {ADDRESS: elements}`, by name; broken entries are noted and left
    out.
    """
    found: dict[str, AreaModel] = {}
    grammar = ProtocolAddresses(protocol)
    for entry in reader.entries(node):
        with reader.going_on():
            address = _first_of(reader, grammar, entry)
            area = grammar.areas[str(address.parts["area"])]
            if address.area in found:
                raise reader.broken(entry.key.at, f"{entry.key.text} has a size already", "leave one out")
            size = reader.number(entry.value)
            if not 0 <= size <= MOST_ELEMENTS:
                raise reader.broken(entry.value.at, f"{size} is no size", f"write 0 to {MOST_ELEMENTS}")
            found[address.area] = replace(area, size=size * address.unit_bits // area.element_bits)
    return found


def _first_of(reader: Reader, grammar: ProtocolAddresses, entry: Entry) -> Address:
    """Return the first element of an area. Raises Broken."""
    text = entry.key.text
    with reader.refusing(entry.key.at):
        address = grammar.place(text)
    area = grammar.areas[str(address.parts["area"])]
    if address.start or address.unit_bits % area.element_bits or area.layout is not None:
        what = f"{text} is not the first {area.unit} of its area"
        raise reader.broken(entry.key.at, what, "a size belongs to a whole area: name its first element")
    return address


def check_profile(profile: MemoryProfile) -> Iterator[Problem]:
    """Yield a problem for each address outside of the memory, and for bits that the memory cannot set by itself."""
    grammar = addresses_of(profile)

    def place(text: str, at: Position) -> Address | Problem:
        try:
            return grammar.parse(text)
        except AddressError as error:
            return Problem(at, *parted(error))

    bits: tuple[ClockBit | FixedBit, ...] = (*profile.clocks, *profile.fixed)
    for bit in bits:
        found = place(bit.address, bit.at)
        if isinstance(found, Problem):
            yield found
        elif found.unit != "bit":
            yield Problem(bit.at, f"{bit.address} is a {found.unit}, and only bits are set by themselves", "name a bit")
        elif (area := profile.areas[found.area]).size * area.element_bits < 16 * (found.start // 16 + 1):
            what = f"{bit.address} is in no whole word of area {area.name}"
            yield Problem(bit.at, what, "make the area a multiple of 16 bits")
    for name, named in profile.named.items():
        found = place(named.address, named.at)
        if isinstance(found, Problem):
            yield Problem(found.at, f"'{name}': {found.what}", found.todo)
