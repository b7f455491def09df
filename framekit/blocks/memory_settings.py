"""What files say of a memory: areas of a protocol that stand elsewhere in it, start values, places it must have."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from framekit.blocks.memory_sizes import areas_with
from framekit.blocks.model import Place
from framekit.blocks.own_memory import ProtocolAddresses
from framekit.blocks.typed_numbers import number_for
from framekit.definition.expression.syntax import Call, Text, walk
from framekit.definition.load.reader import Reader
from framekit.definition.model.procedure import Action
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.services import Area as AreaModel
from framekit.definition.model.walk import expressions_of, parts_of
from framekit.definition.nodes import Entry, Node
from framekit.definition.problems import Problem, did_you_mean
from framekit.link.addresses import AddressError, AddressGrammar
from framekit.memory.memory import Area, DeviceMemory


def put_values(memory: DeviceMemory, initial: tuple[tuple[Place, tuple[int, ...]], ...]) -> None:
    """Puts start values into a memory, also into areas that are read-only for others."""
    for place, values in initial:
        memory.write(place.address.area, place.address.unit, place.address.start, values, force=True)


def memory_of(
    protocol: Protocol, sizes: Mapping[str, AreaModel] | None = None
) -> tuple[tuple[Area, ...], AddressGrammar]:
    """A memory with the areas a protocol knows, those in `sizes` as large as there, addressed as the protocol does."""
    return areas_with(protocol, sizes or {}), ProtocolAddresses(protocol, sizes)


def read_mapping(
    reader: Reader, node: Node | None, protocol: Protocol, grammar: AddressGrammar
) -> dict[str, tuple[str, int]]:
    """`map: {AREA: ADDRESS}`: where areas of a protocol begin in a memory; what is broken is noted and left out."""
    found: dict[str, tuple[str, int]] = {}
    for entry in reader.entries(node):
        with reader.going_on():
            area = protocol.areas.get(entry.key.text)
            if area is None or area.layout is not None:
                what = f"'{protocol.name}' has no area '{entry.key.text}'"
                if area is not None:
                    what = f"area '{area.name}' is built from what the protocol knows, it stands in no memory"
                raise reader.broken(entry.key.at, what, did_you_mean(entry.key.text, protocol.areas))
            text = reader.text(entry.value)
            try:
                address = grammar.parse(text)
            except AddressError as error:
                raise reader.broken(entry.value.at, *_parted(error)) from None
            if address.first_bit % area.element_bits:
                what = f"{text} is not where a {area.unit} of area '{area.name}' can begin"
                raise reader.broken(entry.value.at, what, f"name a {area.unit}")
            found[area.name] = address.area, address.first_bit // area.element_bits
    return found


def check_places(protocol: Protocol, grammar: AddressGrammar) -> Iterator[Problem]:
    """Addresses that sequences mention, in `store` and in `memory('…', N)`, and that the memory does not have."""
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
            yield Problem(at, *_parted(error))
        else:
            if address.first_bit % 8:
                yield Problem(at, f"{text} is in the middle of a byte", "name a byte or a word")


def start_value(reader: Reader, grammar: AddressGrammar, entry: Entry) -> tuple[Place, tuple[int, ...]] | None:
    """`ADDRESS: value` or `ADDRESS: [values]`; None when it is broken, which is noted."""
    with reader.going_on():
        text = entry.key.text
        try:
            address = grammar.parse(text)
        except AddressError as error:
            raise reader.broken(entry.key.at, *_parted(error)) from None
        values = tuple(number_for(reader, item, address) for item in reader.items(entry.value))
        try:
            grammar.check(address, max(1, len(values)))
        except AddressError as error:
            raise reader.broken(entry.value.at, *_parted(error)) from None
        bits = address.unit_bits
        for item, value in zip(reader.items(entry.value), values, strict=True):
            if not (-(1 << bits - 1) if bits > 1 else 0) <= value < 1 << bits:
                raise reader.broken(item.at, f"{value} does not fit into a {address.unit}", "use a wider unit")
        return Place(address=address, text=text), tuple(value & ((1 << bits) - 1) for value in values)
    return None


def _parted(error: Exception) -> tuple[str, str]:
    what, _, todo = str(error).partition(" – ")
    return what, todo
