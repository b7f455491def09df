"""Places of the own memory that run files name: where they are, whether there is room, whether they may be written."""

from __future__ import annotations

from framekit.blocks.model import Place
from framekit.definition.load.reader import Reader
from framekit.definition.nodes import Node
from framekit.definition.problems import Position
from framekit.link.addresses import Address, AddressError, AddressGrammar


def address_at(
    reader: Reader, grammar: AddressGrammar, at: Position, text: str, unit: str | None = None, count: int = 1
) -> Address:
    """An address that stands at `at`, with room for `count` elements behind it. Raises Broken."""
    try:
        address = grammar.parse(text, unit)
        grammar.check(address, count)
    except AddressError as error:
        what, _, todo = str(error).partition(" – ")
        raise reader.broken(at, what, todo) from None
    return address


def read_place(reader: Reader, grammar: AddressGrammar, node: Node, bits: int, *, written: bool = False) -> Place:
    """A place of the own memory with room for so many bits from there on; `written` by the run. Raises Broken."""
    text = reader.text(node)
    try:
        address = grammar.parse(text)
        grammar.check(address, -(-bits // address.unit_bits))
    except AddressError as error:
        what, _, todo = str(error).partition(" – ")
        raise reader.broken(node.at, what, todo) from None
    place = Place(address=address, text=text)
    if written:
        check_written(reader, grammar, node, place)
    return place


def check_written(reader: Reader, grammar: AddressGrammar, node: Node, place: Place) -> None:
    """Notes a place that the run is to write, in an area that can only be read."""
    area = grammar.areas.get(place.address.area)
    if area is not None and area.access == "read":
        others = ", ".join(one.name for one in grammar.areas.values() if one.access == "rw")
        what = f"{place.text} is in area {area.name}, which can only be read"
        reader.note(node.at, what, f"name a place in {others}" if others else "")
