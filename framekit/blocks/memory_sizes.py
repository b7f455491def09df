"""Sizes of a device's memory: how many elements areas of it have, where the protocol's own figure does not suit.

An area is named by the address of its first element, so areas that only addresses tell apart can be added. It knows
no protocol, and not what stands in an area.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from framekit.blocks.own_memory import ProtocolAddresses
from framekit.definition.load.reader import Reader
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.services import Area
from framekit.definition.nodes import Entry, Node
from framekit.link.addresses import Address, AddressError
from framekit.memory.memory import Area as MemoryArea

MOST_ELEMENTS = 1 << 20


def protocol_areas(protocol: Protocol) -> dict[str, Area]:
    """The areas that memory with a protocol's areas has, by their name there; each has the protocol's size."""
    found: dict[str, Area] = {}
    for area in protocol.areas.values():
        if area.layout is None:
            found.setdefault(area.memory, area)
    return found


def areas_with(protocol: Protocol, sizes: Mapping[str, Area]) -> tuple[MemoryArea, ...]:
    """The areas of a memory, those in `sizes` as large as there; a size of 0 leaves an area out."""
    return tuple(
        MemoryArea(name, size=area.size, unit=area.unit)
        for name, area in {**protocol_areas(protocol), **sizes}.items()
        if area.size
    )


def read_sizes(reader: Reader, node: Node | None, protocol: Protocol) -> dict[str, Area]:
    """`sizes: {ADDRESS: elements}` by names of memory areas; what is broken is noted and left out."""
    found: dict[str, Area] = {}
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
    """The first element of an area. Raises Broken."""
    text = entry.key.text
    try:
        address = grammar.place(text)
    except AddressError as error:
        what, _, todo = str(error).partition(" – ")
        raise reader.broken(entry.key.at, what, todo) from None
    area = grammar.areas[str(address.parts["area"])]
    if address.start or address.unit_bits % area.element_bits or area.layout is not None:
        what = f"{text} is not the first {area.unit} of its area"
        raise reader.broken(entry.key.at, what, "a size belongs to a whole area: name its first element")
    return address
