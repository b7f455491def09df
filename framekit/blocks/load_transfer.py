"""READ and WRITE blocks: the addresses of the other side, and the places of the own memory, or values, beside them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from framekit.blocks.attempts import Attempts
from framekit.blocks.model import Channel, Place
from framekit.blocks.own_places import address_at
from framekit.blocks.typed_numbers import number_for
from framekit.definition.check.addresses import is_unit
from framekit.definition.load.reader import Broken, Reader
from framekit.definition.nodes import Mapping, Node
from framekit.definition.problems import is_nearly
from framekit.link.addresses import Address, AddressError, AddressGrammar
from framekit.link.packing import PackingError, memory_of
from framekit.memory.memory import unit_bits


class TransferLoader:
    """Reads what such a block has of its own. `place` reads places of the own memory, `written` those to write."""

    def __init__(
        self, reader: Reader, grammar: AddressGrammar, attempts: Attempts,
        place: Callable[[Node], Place], written: Callable[[Node], Place],
    ) -> None:  # fmt: skip
        self.reader = reader
        self.grammar = grammar
        self.attempts = attempts
        self.place = place
        self.written = written

    def read(self, instruction: str, keys: Mapping, channel: Channel) -> dict[str, Any]:
        """Addresses of the other side, and the own places beside them. Raises Broken."""
        reader = self.reader
        unit = self.attempts.maybe(reader.text, keys.get("type"))
        if unit is not None and not is_unit(unit):
            raise Broken("the schema has told what is wrong with the unit")
        nodes = reader.items(keys.get(instruction))
        count = self._count(keys.get("count")) if len(nodes) == 1 else 1
        protocol = channel.protocol
        if instruction not in protocol.services:
            raise reader.broken(
                nodes[0].at, f"'{protocol.name}' has no service {instruction}", "use send and receive with its frames"
            )
        grammar = AddressGrammar(protocol.addresses, protocol.areas, protocol.tables)
        units: list[str] = []
        types: list[Address | None] = []
        for node in nodes:
            with reader.going_on():
                address = address_at(reader, grammar, node.at, reader.text(node), unit, count)
                units.append(unit or address.unit)
                types.append(address if unit is None else None)
                if instruction == "write" and protocol.areas[address.area].access == "read":
                    reader.note(node.at, f"area '{address.area}' can only be read", "write to another area")
        places, values = self._own_side(instruction, keys, types or [None], len(nodes), count)
        if len(units) == len(nodes):
            self._fitting(reader.items(keys.get("values")), values or (), units)
            self._room(keys.get("into" if instruction == "read" else "from"), places, units, count)
        return {
            "targets": tuple(reader.text(node) for node in nodes),
            "units": tuple(units),
            "places": places,
            "unit": unit,
            "count": count,
            "values": values,
        }

    def _fitting(self, nodes: Sequence[Node], values: Sequence[int], units: list[str]) -> None:
        """Constants that the elements they are for can hold."""
        for at, (node, value) in enumerate(zip(nodes, values, strict=False)):
            try:
                memory_of([value], units[min(at, len(units) - 1)])
            except PackingError as error:
                self.reader.note(node.at, str(error), "correct it, or give another type")

    def _room(self, node: Node | None, places: tuple[Place, ...], units: list[str], count: int) -> None:
        """Own places with room for everything that is moved."""
        for item, place, unit in zip(self.reader.items(node), places, units, strict=False):
            address = place.address
            bits = unit_bits(unit) * (count if len(units) == 1 else 1)
            try:
                self.grammar.check(address, -(-bits // address.unit_bits))
            except AddressError as error:
                what, _, todo = str(error).partition(" – ")
                self.reader.note(item.at, what, todo)

    def _count(self, node: Node | None) -> int:
        count = self.attempts.maybe(self.reader.number, node)
        if node is not None and count is not None and count < 1:
            self.reader.note(node.at, f"a count of {count} moves nothing", "give 1 or more")
        return max(1, count or 1)

    def _numbers(self, nodes: Sequence[Node], types: list[Address | None], wanted: int) -> tuple[int, ...]:
        """What the elements get: one number stands for all of them. Raises Broken."""
        given = list(nodes) * wanted if len(nodes) == 1 else nodes
        return tuple(number_for(self.reader, node, types[min(at, len(types) - 1)]) for at, node in enumerate(given))

    def _own_side(
        self, instruction: str, keys: Mapping, types: list[Address | None], targets: int, count: int
    ) -> tuple[tuple[Place, ...], tuple[int, ...] | None]:
        """The own places, one for each address, or the constants to write."""
        reader = self.reader
        word, other, does = ("into", "from", "go") if instruction == "read" else ("from", "into", "come from")
        wrong = keys.get(other)
        if wrong is not None and instruction == "read":
            reader.note(wrong.at, f"{other}: does not belong to a {instruction}", f"write {word}:")
        node, given = keys.get(word), keys.get("values")
        where = self.written if instruction == "read" else self.place
        tried = (self.attempts.maybe(where, item) for item in reader.items(node))
        places = tuple(place for place in tried if place is not None)
        values = (
            None
            if given is None
            else self.attempts.to(lambda: self._numbers(reader.items(given), types, max(targets, count)))
        )
        misspelt = any(is_nearly(name, entry.key.text) for entry in keys.entries for name in (word, "values"))
        if misspelt and node is None and given is None:
            raise Broken("the schema has told what is wrong with the key")
        if node is None and given is None and wrong is None:
            what = f"the block does not say where its data {does}"
            raise reader.broken(keys.at, what, f"add {word}: with an address of the own memory")
        if instruction == "read" and given is not None:
            reader.note(given.at, "a read has no values to write", "leave values out")
        elif node is not None and given is not None:
            reader.note(given.at, "the block has values and an own place", "leave one of them out")
        elif values is not None and len(values) not in (1, max(targets, count)):
            wanted = max(targets, count)
            reader.note(keys.at, f"{len(values)} values stand for {wanted} places", f"give one value, or {wanted}")
        own = len(reader.items(node))
        if own and own != targets:
            what = f"{targets} addresses of the other side stand against {own} own ones"
            reader.note(keys.at, what, "give as many of one as of the other")
        return places, values
