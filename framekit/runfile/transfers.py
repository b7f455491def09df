"""Read the transfers of blocks: READ, WRITE, SEND, RECEIVE and CALL blocks, and the memory places they use.

Reading a block continues after a broken key (`Attempts`), so that all problems are reported at once.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from collections.abc import Mapping as MappingOf
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from framekit.definition.check.addresses import is_unit
from framekit.definition.expression import Expression, Name
from framekit.definition.kinds.base import constant_number
from framekit.definition.load.reader import Broken, Reader
from framekit.definition.model.frames import Frame, field_names, names_needed
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.segments import Data
from framekit.definition.model.services import COUNTED_STRING, Packing, ServiceRow
from framekit.definition.nodes import Entry, Mapping, Node, Scalar
from framekit.definition.nodes import Mapping as MappingNode
from framekit.definition.problems import Position, did_you_mean, is_nearly, listed, parted, plural
from framekit.link.addresses import Address, AddressError, AddressGrammar
from framekit.link.packing import PackingError, memory_of
from framekit.link.services.rows import wants_address
from framekit.link.variables import given_value
from framekit.memory.memory import MemoryValueError, unit_bits
from framekit.memory.views import CountedTextView, NumberView, view_of
from framekit.run.model import ArgumentPlace, Channel, OwnPlace, ResultPlace
from framekit.run.own_memory import (
    FramePart,
    fixed_bytes,
    float_bits_of,
    may_overflow,
    mismatch,
    no_fraction,
    no_number,
    parts_of,
    takes_bytes,
)
from framekit.run.transfer import (
    ANY,
    LONGEST,
    NoResultError,
    Shape,
    argument_bits,
    is_path,
    shape_at,
    shapes_of,
)
from framekit.runfile.argument_values import ArgumentValues, taken_by
from framekit.runfile.channels import Attempts

T = TypeVar("T")


class OwnPlaces:
    """Reads places of the own memory, given its address grammar."""

    def __init__(self, reader: Reader, grammar: AddressGrammar) -> None:
        self.reader = reader
        self.grammar = grammar

    def place(self, node: Node, unit: str | None = None, bits: int = 1) -> OwnPlace:
        """Return a place with room for `bits` bits from its address on. Raise Broken."""
        text = self.reader.text(node)
        with self.reader.refusing(node.at):
            address = self.grammar.parse(text, unit)
            self.grammar.check(address, -(-bits // address.unit_bits))
        return OwnPlace(address=address, text=text)

    def written(self, node: Node, unit: str | None = None, bits: int = 1) -> OwnPlace:
        """Return a place that the run writes; a read-only area is noted. Raise Broken."""
        place = self.place(node, unit, bits)
        area = self.grammar.areas.get(place.address.area)
        if area is not None and area.access == "read":
            others = ", ".join(one.name for one in self.grammar.areas.values() if one.access == "rw")
            what = f"{place.text} is in area {area.name}, which can only be read"
            self.reader.note(node.at, what, f"name a place in {others}" if others else "")
        return place

    def room(self, node: Node, address: Address, bits: int) -> None:
        """Note if `bits` bits from an address on do not fit into its area."""
        try:
            self.grammar.check(address, -(-bits // address.unit_bits))
        except AddressError as error:
            self.reader.note(node.at, *parted(error))


class TransferLoader:
    """Reads the keys of READ and WRITE blocks."""

    def __init__(self, reader: Reader, attempts: Attempts, places: OwnPlaces) -> None:
        self.reader = reader
        self.attempts = attempts
        self.places = places

    def read(self, instruction: str, keys: Mapping, channel: Channel) -> dict[str, Any]:
        """Return the addresses of the other side with the own places or constants. Raise Broken."""
        reader = self.reader
        unit = self.attempts.maybe(reader.text, keys.get("type"))
        if unit is not None and not is_unit(unit):
            raise Broken("the schema has told what is wrong with the unit")
        nodes = reader.items(keys.get(instruction))
        if not nodes:
            raise Broken("the schema has told that nothing is read or written")
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
            own = keys.get("into" if instruction == "read" else "from")
            self._room(own, places, units, count)
            self._same_type(own, places, types)
        return {
            "targets": tuple(reader.text(node) for node in nodes),
            "units": tuple(units),
            "places": places,
            "unit": unit,
            "count": count,
            "values": values,
        }

    def _fitting(self, nodes: Sequence[Node], values: Sequence[int], units: list[str]) -> None:
        """Note constants that do not fit into the elements they are for."""
        for at, (node, value) in enumerate(zip(nodes, values, strict=False)):
            try:
                memory_of([value], units[min(at, len(units) - 1)])
            except PackingError as error:
                self.reader.note(node.at, str(error), "correct it, or give another type")

    def _same_type(self, node: Node | None, places: tuple[OwnPlace, ...], others: list[Address | None]) -> None:
        """Note places of different types: elements are copied unchanged, so types given on both sides must agree."""
        for item, place, other in zip(self.reader.items(node), places, others, strict=False):
            own = place.address.type
            if own is not None and other is not None and other.type is not None and other.type != own:
                what = f"{place.text} holds {own}, and {other} holds {other.type}"
                self.reader.note(
                    item.at, what, "name a place of the same type, or add type: to move elements as they are"
                )

    def _room(self, node: Node | None, places: tuple[OwnPlace, ...], units: list[str], count: int) -> None:
        """Note own places without room for all transferred elements."""
        for item, place, unit in zip(self.reader.items(node), places, units, strict=False):
            self.places.room(item, place.address, unit_bits(unit) * (count if len(units) == 1 else 1))

    def _count(self, node: Node | None) -> int:
        count = self.attempts.maybe(self.reader.number, node)
        if node is not None and count is not None and count < 1:
            self.reader.note(node.at, f"a count of {count} moves nothing", "give 1 or more")
        return max(1, count or 1)

    def _numbers(self, nodes: Sequence[Node], types: list[Address | None], wanted: int) -> tuple[int, ...]:
        """Return the numbers to write; a single number applies to all elements. Raise Broken."""
        given = list(nodes) * wanted if len(nodes) == 1 else nodes
        return tuple(number_for(self.reader, node, types[min(at, len(types) - 1)]) for at, node in enumerate(given))

    def _own_side(
        self, instruction: str, keys: Mapping, types: list[Address | None], targets: int, count: int
    ) -> tuple[tuple[OwnPlace, ...], tuple[int, ...] | None]:
        """Return the own places, one for each address, or the constants to write."""
        reader = self.reader
        word, other, does = ("into", "from", "go") if instruction == "read" else ("from", "into", "come from")
        wrong = keys.get(other)
        if wrong is not None and instruction == "read":
            reader.note(wrong.at, f"{other}: does not belong to a {instruction}", f"write {word}:")
        node, given = keys.get(word), keys.get("values")
        where = self.places.written if instruction == "read" else self.places.place
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
        elif values is not None:
            self._compare_numbers(keys, len(values), targets, count)
        own = len(reader.items(node))
        if own and own != targets:
            what = f"{targets} addresses of the other side stand against {own} own ones"
            reader.note(keys.at, what, "give as many of one as of the other")
        return places, values

    def _compare_numbers(self, keys: Mapping, values: int, targets: int, count: int) -> None:
        """Report a number of values that is neither 1 nor the number of elements to write."""
        wanted = max(targets, count)
        if values in (1, wanted):
            return
        todo = f"give one value, or {wanted}" if wanted > 1 else "give one value"
        if targets == 1:
            todo += f", or write count: {values}" if keys.get("count") else f", or add count: {values}"
        self.reader.note(keys.at, f"{values} values stand for {plural(wanted, 'place')}", todo)


class FrameBlockLoader:
    """Reads SEND and RECEIVE blocks. Missing fields are only reported if no key of the block is broken."""

    def __init__(self, reader: Reader, places: OwnPlaces) -> None:
        self.reader = reader
        self.places = places
        self.received: dict[tuple[int, str], int] = {}
        self.attempts = Attempts()

    def read(self, instruction: str, keys: MappingNode, channel: Channel, number: int) -> dict[str, Any]:
        """Return frame, data, values and sizes of a block. Raise Broken if the protocol does not have the frame."""
        reader, protocol = self.reader, channel.protocol
        node = keys.get(instruction)
        name = reader.text(node)
        if node is None or name not in protocol.frames:
            at = keys.at if node is None else node.at
            raise reader.broken(at, f"'{protocol.name}' has no frame '{name}'", did_you_mean(name, protocol.frames))
        frame = protocol.frames[name]
        self.attempts.spoilt = False
        self._direction(instruction, frame, node, channel)
        self._once(instruction, frame, node, (channel.number, frame.name), number)
        fields = dict(parts_of(frame.segments))
        where = self.places.written if instruction == "receive" else self.places.place
        data = dict(self._own_memory(fields))
        for entry in reader.entries(keys.get("data")):
            with self.attempts.going_on():
                self._known(entry.key, frame, fields)
                place = where(entry.value)
                self._fits(fields[entry.key.text], place, instruction, entry.value)
                data[entry.key.text] = place
        values = self._values(keys.get("values"), frame, fields) if instruction == "send" else {}
        for entry in reader.entries(keys.get("data")):
            if entry.key.text in values:
                what = f"'{entry.key.text}' stands in data: and in values:"
                reader.note(entry.key.at, what, "leave one of them out")
        sizes = self._sizes(keys.get("size"), frame, fields)
        sized_by = self._sized_by(keys.get("size"), sizes, fields, protocol) if instruction == "send" else {}
        if instruction == "send":
            sizes = self._sizes_of_parameters(data, fields, channel) | sizes
        self._room(keys.get("data"), data, sizes, fields)
        if instruction == "send" and not self.attempts.spoilt:
            self._missing(frame, {*data, *values}, data.keys() - values.keys() - sizes.keys(), keys)
        return {"frame": name, "data": data, "values": values, "sizes": sizes, "sized_by": sized_by}

    def _own_memory(self, fields: MappingOf[str, FramePart]) -> Iterator[tuple[str, OwnPlace]]:
        """Yield the places that the definition of a frame assigns to its fields."""
        for name, part in fields.items():
            memory = getattr(part, "memory", None)
            if memory:
                with self.attempts.going_on():
                    yield name, self.places.place(Scalar(memory, part.at, False))

    def _fits(self, part: FramePart, place: OwnPlace, instruction: str, node: Node) -> None:
        """Note a place that cannot hold the values of a field; warn if it cannot hold all of them."""
        wrong = mismatch(part, place)
        if wrong is not None:
            self.reader.note(node.at, *wrong)
        elif instruction == "receive" and may_overflow(part, place):
            what = f"{place.text} ({place.address.unit}) cannot hold every value of '{part.name}'"
            self.reader.warn(node.at, what, "name a wider place; values that do not fit are refused")

    def _room(
        self, node: Node | None, data: MappingOf[str, OwnPlace], sizes: MappingOf[str, int],
        fields: MappingOf[str, FramePart],
    ) -> None:  # fmt: skip
        """Note own places without room for the bytes of a field, whose size the block gives or the definition fixes."""
        for entry in self.reader.entries(node):
            name = entry.key.text
            if name not in data or not takes_bytes(fields[name]):
                continue
            size = sizes.get(name) or fixed_bytes(fields[name])
            if size:
                self.places.room(entry.value, data[name].address, 8 * size)

    def _direction(self, instruction: str, frame: Frame, node: Node, channel: Channel) -> None:
        """Note a frame that belongs to the opposite direction.

        Without roles the run is the client. A role that only makes requests receives the frames of others and sends as
        client.
        """
        own = None if channel.role is None else channel.protocol.roles[channel.role]
        if own is not None and (instruction != "send" or own.listens or not own.exchanges):
            return
        wrong, done, other = ("server", "sent", "receive") if instruction == "send" else ("client", "received", "send")
        if frame.side == wrong:
            what = f"'{frame.name}' comes from the {wrong}, it cannot be {done}"
            self.reader.note(node.at, what, f"use {other}:, or another frame")

    def _once(self, instruction: str, frame: Frame, node: Node, key: tuple[int, str], number: int) -> None:
        """Note a frame that a second block of the channel receives, or that only occurs inside other frames."""
        if frame.inner:
            self.reader.note(node.at, f"'{frame.name}' stands inside other frames", "name a frame that carries it")
        if instruction == "receive":
            first = self.received.setdefault(key, number)
            if first != number:
                self.reader.note(node.at, f"block {first} receives '{frame.name}' already", "let one block take it")

    def _known(self, key: Scalar, frame: Frame, fields: MappingOf[str, FramePart]) -> None:
        if key.text not in fields:
            hint = did_you_mean(key.text, fields)
            raise self.reader.broken(key.at, f"frame '{frame.name}' has no field '{key.text}'", hint)

    def _values(self, node: Node | None, frame: Frame, fields: MappingOf[str, FramePart]) -> dict[str, Any]:
        known = dict.fromkeys(field_names(frame.segments))
        found: dict[str, Any] = {}
        for entry in self.reader.entries(node):
            with self.attempts.going_on():
                if entry.key.text not in known:
                    what = f"frame '{frame.name}' has no field '{entry.key.text}'"
                    raise self.reader.broken(entry.key.at, what, did_you_mean(entry.key.text, known))
                if entry.key.text not in fields:
                    raise self.reader.broken(entry.key.at, *_holds_others(entry.key.text, frame))
                value = found[entry.key.text] = self.reader.constant(entry.value)
                wrong = no_number(fields.get(entry.key.text), value)
                if wrong is not None:
                    self.reader.note(entry.value.at, wrong, "correct it")
        return found

    def _sizes(self, node: Node | None, frame: Frame, fields: MappingOf[str, FramePart]) -> dict[str, int]:
        found: dict[str, int] = {}
        for entry in self.reader.entries(node):
            with self.attempts.going_on():
                self._known(entry.key, frame, fields)
                size = self.reader.number(entry.value)
                fixed = getattr(fields[entry.key.text], "size", None)
                if isinstance(fixed, int) and size != fixed:
                    what = f"'{entry.key.text}' has {fixed} bytes, not {size}"
                    raise self.reader.broken(entry.value.at, what, "leave the size out")
                if size < 1:
                    what = f"'{entry.key.text}' cannot have {size} bytes"
                    raise self.reader.broken(entry.value.at, what, "give 1 or more")
                found[entry.key.text] = size
        return found

    def _sized_by(
        self, node: Node | None, sizes: MappingOf[str, int], fields: MappingOf[str, FramePart], protocol: Protocol
    ) -> dict[str, str]:
        """Return the fields whose size is both given in the block and taken from a parameter, with that parameter."""
        found = {}
        for entry in self.reader.entries(node):
            name = _size_parameter(entry.key.text, fields, protocol)
            if entry.key.text in sizes and name:
                with self.attempts.going_on(), self.reader.refusing(entry.value.at):
                    given_value(protocol.params[name], sizes[entry.key.text])
                    found[entry.key.text] = name
        return found

    def _sizes_of_parameters(
        self, names: Iterable[str], fields: MappingOf[str, FramePart], channel: Channel
    ) -> dict[str, int]:
        """Return the sizes of fields that parameters of the channel give."""
        found: dict[str, int] = {}
        for name in names:
            parameter = _size_parameter(name, fields, channel.protocol)
            size = channel.params.get(parameter) if parameter else None
            if parameter and size is None:
                size = constant_number(channel.protocol.params[parameter].default)
            if isinstance(size, int):
                found[name] = size
        return found

    def _missing(self, frame: Frame, given: set[str], unsized: set[str], keys: MappingNode) -> None:
        """Note fields without a value, and data without a size."""
        fields = dict(parts_of(frame.segments))
        data = [one for one in frame.segments if isinstance(one, Data) and one.when is None]
        for name in dict.fromkeys([*names_needed(frame.segments), *(one.name for one in data)]):
            if name not in fields:
                self.reader.note(keys.at, *_holds_others(name, frame))
            elif name not in given:
                what = f"nothing gives '{name}' of '{frame.name}'"
                self.reader.note(keys.at, what, f"add data: {{{name}: ADDRESS}}, or values")
        for one in data:
            if one.name in unsized and not isinstance(one.size, int):
                what = f"nothing says how many bytes '{one.name}' of '{frame.name}' has"
                self.reader.note(keys.at, what, f"add size: {{{one.name}: N}}")


def _size_parameter(name: str, fields: MappingOf[str, FramePart], protocol: Protocol) -> str:
    """Return the parameter that is the size of a field; an empty text if its size is anything else."""
    size = getattr(fields.get(name), "size", None)
    parameter = size.root.name if isinstance(size, Expression) and isinstance(size.root, Name) else ""
    return parameter if parameter in protocol.params and parameter not in fields else ""


def _holds_others(name: str, frame: Frame) -> tuple[str, str]:
    """Return problem and remedy for a value given to a list, a record or an inner frame."""
    return f"a block cannot give '{name}' of '{frame.name}', which holds values itself", "send it from a program"


_BYTES = ("text", "choice", "bytes")
_ELEMENTS = ("number", "decimal", "flag", "time")


class CallLoader:
    """Reads the keys of CALL blocks."""

    def __init__(self, reader: Reader, attempts: Attempts, places: OwnPlaces, folder: Path) -> None:
        self.reader = reader
        self.attempts = attempts
        self.places = places
        self.values = ArgumentValues(reader, folder)

    def service(self, keys: Mapping, channel: Channel) -> tuple[str, tuple[ServiceRow, ...]]:
        """Return the name of the called service and its rows. Raise Broken."""
        reader, protocol = self.reader, channel.protocol
        node = keys.get("call")
        name = reader.text(node)
        at = keys.at if node is None else node.at
        rows = protocol.services.get(name)
        if rows is None:
            hint = did_you_mean(name, protocol.services)
            raise reader.broken(at, f"'{protocol.name}' has no service '{name}'", hint)
        if name in ("read", "write"):
            raise reader.broken(at, f"{name} is an instruction of its own", f"write {name}: ADDRESS")
        return name, rows

    def constants(
        self, keys: Mapping, protocol: Protocol, name: str, rows: tuple[ServiceRow, ...], places: tuple[Entry, ...] = ()
    ) -> dict[str, Any]:
        """Return the constant arguments of a call; `places`: the arguments that come from the memory."""
        node, entries = keys.get("call"), self.reader.entries(keys.get("with"))
        self._arguments(name, rows, (*entries, *places), keys.at if node is None else node.at)
        found: dict[str, Any] = {}
        for entry in entries:
            with self.reader.going_on():
                found[entry.key.text] = self.values.read(protocol, rows, entry)
        return found

    def read(self, keys: Mapping, channel: Channel) -> dict[str, Any]:
        """Return the attributes of a block that calls a service: arguments and results. Raise Broken."""
        reader, protocol = self.reader, channel.protocol
        name, rows = self.service(keys, channel)
        node = keys.get("call")
        at = keys.at if node is None else node.at
        places = self._named(keys.get("from"), name, "ARGUMENT")
        sizes = {entry.key.text: entry for entry in reader.entries(keys.get("size"))}
        arguments = self.constants(keys, protocol, name, rows, places)
        argument_places = {}
        for entry in places:
            if entry.key.text in arguments:
                what = f"'{entry.key.text}' stands in with: and in from:"
                self.reader.note(entry.key.at, what, "leave one of them out")
            found = self.attempts.to(partial(self._from, rows, entry, sizes))
            if found is not None:
                argument_places[entry.key.text] = found
        known = [shapes_of(protocol, row) for row in rows]
        results = []
        for entry in self._named(keys.get("into"), name, "RESULT"):
            stored = self.attempts.to(partial(self._into, name, known, entry, sizes))
            if stored is not None:
                results.append(stored)
        for entry in sizes.values():
            hint = did_you_mean(entry.key.text, [*argument_places, *(str(one.result) for one in results)])
            self.reader.note(entry.key.at, f"'{entry.key.text}' stands neither in from: nor in into:", hint)
        return {
            "service": name,
            "arguments": arguments,
            "argument_places": argument_places,
            "results": tuple(results),
            "packing": packing_of(rows),
            **self._about(keys, channel, rows, name, at),
        }

    def _named(self, node: Node | None, service: str, what: str) -> tuple[Entry, ...]:
        """Return pairs of a name and a place. Raise Broken for a place without a name."""
        if node is None:
            return ()
        if not isinstance(node, Mapping):
            fault = "results of a call go to places by their names" if what == "RESULT" else "a call takes arguments"
            key = "into" if what == "RESULT" else "from"
            raise self.reader.broken(node.at, fault, f"write {key}: {{{what}: ADDRESS}}")
        return node.read_all()

    # ---- arguments ----------------------------------------------------------------------------------------

    def _from(self, rows: tuple[ServiceRow, ...], entry: Entry, sizes: dict[str, Entry]) -> ArgumentPlace:
        """Return the place from which an argument is read. Raise Broken."""
        name, reader = entry.key.text, self.reader
        taken = taken_by(rows, name)
        type_ = taken[0].type if taken else "number"
        if type_ not in (*_BYTES, *_ELEMENTS, "list") or any(one.type != type_ for one in taken):
            raise reader.broken(entry.key.at, f"'{name}' cannot come from the memory", "give it in with:")
        if type_ == "list" and any(one.items not in (None, "number") for one in taken):
            raise reader.broken(entry.key.at, f"'{name}' is no list of numbers", "give it in with:")
        place = self.places.place(entry.value)
        size = sizes.pop(name, None)
        count = 1 if size is None else self._size(size)
        if size is None and type_ not in _ELEMENTS:
            what = f"nothing says how many {'elements' if type_ == 'list' else 'bytes'} '{name}' has"
            reader.note(entry.key.at, what, f"add size: {{{name}: N}}")
        elif size is not None and type_ in _ELEMENTS:
            reader.note(size.key.at, f"'{name}' is one number and has no size", "leave it out")
            count = 1
        self.places.room(entry.value, place.address, argument_bits(type_, count, place.address.unit))
        signed = any(one.limits is not None and one.limits[0] < 0 for one in taken)
        return ArgumentPlace(place=place, type=type_, size=count, signed=signed)

    def _arguments(self, service: str, rows: tuple[ServiceRow, ...], entries: tuple[Entry, ...], at: Position) -> None:
        """Note unknown arguments, and missing arguments that have no default."""
        known = {argument.name for row in rows for argument in row.takes}
        given = {entry.key.text for entry in entries}
        for entry in entries:
            if entry.key.text not in known:
                hint = did_you_mean(entry.key.text, known) or "leave it out"
                self.reader.note(entry.key.at, f"'{service}' takes no '{entry.key.text}'", hint)
        if len(rows) == 1 and given <= known:
            missing = [f"'{one.name}'" for one in rows[0].takes if one.default is None and one.name not in given]
            if missing:
                todo = f"add {'it' if len(missing) == 1 else 'them'} to with:"
                self.reader.note(at, f"'{service}' is called without {listed(missing)}", todo)

    def _about(
        self, keys: Mapping, channel: Channel, rows: tuple[ServiceRow, ...], service: str, at: Position
    ) -> dict[str, Any]:
        """Return the addresses on the other side that a call refers to."""
        reader, protocol = self.reader, channel.protocol
        node = keys.get("addresses")
        nodes = reader.items(node)
        takes = [row for row in rows if wants_address(row)]
        if node is not None and not takes:
            reader.note(node.at, f"'{service}' is about no addresses", "leave them out")
            return {}
        if node is None:
            if len(takes) == len(rows):
                reader.note(at, f"'{service}' is about addresses of the other side", "add addresses: ADDRESS")
            for key in ("count", "type"):
                if (alone := keys.get(key)) is not None:
                    reader.note(alone.at, f"{key}: says something about addresses, and there are none", "leave it out")
            return {}
        unit = self.attempts.maybe(reader.text, keys.get("type"))
        count_node = keys.get("count")
        count = self.attempts.maybe(reader.number, count_node) or 1
        if count_node is not None and len(nodes) > 1:
            reader.note(count_node.at, "each of several addresses is one element", "leave count out")
        grammar = AddressGrammar(protocol.addresses, protocol.areas, protocol.tables)
        for item in nodes:
            with reader.going_on():
                address_at(reader, grammar, item.at, reader.text(item), unit, count if len(nodes) == 1 else 1)
        most = max((row.most_variables for row in takes), default=0) or 1
        if len(nodes) > most:
            reader.note(nodes[most].at, f"'{service}' takes {most} addresses at most", "use several blocks")
        return {"addresses": tuple(reader.text(item) for item in nodes), "unit": unit, "count": count}

    # ---- results ------------------------------------------------------------------------------------------

    def _into(self, service: str, known: list[dict[str, Shape]], entry: Entry, sizes: dict[str, Entry]) -> ResultPlace:
        """Return a result and its place. Raise Broken."""
        reader = self.reader
        result = reader.expression(entry.key)
        if not is_path(result.root):
            what = f"'{entry.key.text}' names no result"
            raise reader.broken(entry.key.at, what, "write names with dots, such as time.hour")
        shape = self.shape(service, known, result, entry.key.at)
        place = self.places.written(entry.value)
        node = sizes.pop(entry.key.text, None)
        size = shape.size if node is None else self._size(node)
        bits = place.address.unit_bits
        if shape.kind == "record":
            names = list(shape.parts or ())
            hint = f"name one of them, such as {entry.key.text}.{names[0]}" if names else ""
            raise reader.broken(entry.key.at, f"'{entry.key.text}' is a record of several values", hint)
        float_bits = 0
        if (shape.item or shape).is_real or (place.address.type or "").startswith("float"):
            bits = float_bits = float_bits_of(place.address)
            if not bits:
                raise reader.broken(entry.value.at, *no_fraction(entry.key.text, place))
        if node is not None and shape.kind == "number":
            reader.note(node.key.at, f"'{entry.key.text}' is one number and has no size", "leave it out")
            size = None
        elif shape.is_long and size is None:
            what = f"nothing says how much room there is for '{entry.key.text}', which has any number of "
            what += "elements" if shape.kind == "list" else "bytes"
            reader.note(entry.key.at, what, f"add size: {{{entry.key.text}: N}}; what does not come is 0")
        if size is not None:
            bits = 8 * size if shape.kind in ("bytes", "text") else bits * size
        self.places.room(entry.value, place.address, bits)
        item = shape.item or ANY
        scale = max(shape.scale, item.scale)
        return ResultPlace(result=result, place=place, size=size, scale=scale, bits=bits, float_bits=float_bits)

    def shape(self, service: str, known: list[dict[str, Shape]], result: Expression, at: Position) -> Shape:
        """Return the shape of the value that the rows return under a name. Raise Broken if no row returns it."""
        found: list[Shape] = []
        problem: NoResultError | None = None
        for shapes in known:
            try:
                found.append(shape_at(result, shapes))
            except NoResultError as error:
                problem = problem or error
        if found:
            return found[0] if all(one == found[0] for one in found) else ANY
        assert problem is not None
        raise self.reader.broken(at, f"'{service}' gives {problem}", problem.hint)

    def _size(self, entry: Entry) -> int:
        size = self.reader.number(entry.value)
        if not 1 <= size <= LONGEST:
            raise self.reader.broken(entry.value.at, f"a size of {size} cannot be", f"give 1 to {LONGEST}")
        return size


def packing_of(rows: tuple[ServiceRow, ...]) -> Packing:
    """Return how the rows of a service pack elements into data if all agree, else the plain packing."""
    packings = {row.packing for row in rows}
    return packings.pop() if len(packings) == 1 else Packing()


# ---- places and values of the own memory -------------------------------------------------------------------


def address_at(
    reader: Reader, grammar: AddressGrammar, at: Position, text: str, unit: str | None = None, count: int = 1
) -> Address:
    """Return the address in `text`, with room for `count` elements; `at` is its position in the file. Raise Broken."""
    with reader.refusing(at):
        address = grammar.parse(text, unit)
        grammar.check(address, count)
    return address


_FRACTION = re.compile(r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?")


def number_for(reader: Reader, node: Node, place: Address | None) -> int:
    """Return the raw element that stores a written value; without a type for the place, the number itself.

    `0x…` always gives the raw element, except for texts. Raise Broken.
    """
    text = reader.text(node)
    type_ = None if place is None else place.type
    if place is not None and type_ == COUNTED_STRING:
        texts = CountedTextView(place.unit_bits // 8)
        return _element(reader, node, lambda: texts.write([text]))
    view = None if type_ is None or "x" in text.lower() else view_of(type_)
    if not isinstance(view, NumberView):
        return reader.number(node)
    if view.kind == "float" and not _FRACTION.fullmatch(text.strip()):
        raise reader.broken(node.at, f"'{text}' is no {type_}", "write a number such as 1.5")
    number = float(text) if view.kind == "float" else reader.number(node)
    return _element(reader, node, lambda: view.write([number]))


def _element(reader: Reader, node: Node, write: Callable[[], bytes]) -> int:
    """Return the element with these bytes. Raise Broken for a value that does not fit."""
    try:
        return int.from_bytes(write(), "little")
    except MemoryValueError as error:
        raise reader.broken(node.at, str(error), "correct it") from None
