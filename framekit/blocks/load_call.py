"""CALL blocks: a service of the channel's protocol, the arguments that it takes, and where its results go."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from framekit.blocks.attempts import Attempts
from framekit.blocks.given import raw_value
from framekit.blocks.model import ArgumentPlace, Channel, Place, ResultPlace
from framekit.blocks.own_places import address_at
from framekit.blocks.results import (
    ANY,
    LONGEST,
    NoResultError,
    Shape,
    argument_bits,
    is_path,
    shape_at,
    shapes_of,
)
from framekit.definition.expression.syntax import Expression
from framekit.definition.load.reader import Reader
from framekit.definition.model.services import Argument, Packing, ServiceRow
from framekit.definition.nodes import Entry, Mapping, Node
from framekit.definition.problems import Position, did_you_mean, listed
from framekit.link.addresses import Address, AddressGrammar
from framekit.link.parameters import ParameterError
from framekit.link.services.planning import TYPES, checked
from framekit.link.services.rows import wants_address

_BYTES = ("text", "choice", "bytes")
_ELEMENTS = ("number", "flag", "time")


class CallLoader:
    """Reads what such a block has of its own.

    `place` reads addresses of the own memory, `written` those to write, `room` notes where there is too little of it.
    """

    def __init__(
        self, reader: Reader, attempts: Attempts, place: Callable[[Node], Place], written: Callable[[Node], Place],
        room: Callable[[Node, Address, int], None],
    ) -> None:  # fmt: skip
        self.reader = reader
        self.attempts = attempts
        self.place = place
        self.written = written
        self.room = room

    def read(self, keys: Mapping, channel: Channel) -> dict[str, Any]:
        """A service, its arguments and its results. Raises Broken."""
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
        constants, places = reader.entries(keys.get("with")), self._named(keys.get("from"), name, "ARGUMENT")
        sizes = {entry.key.text: entry for entry in reader.entries(keys.get("size"))}
        self._arguments(name, rows, (*constants, *places), at)
        arguments: dict[str, Any] = {}
        for entry in constants:
            with reader.going_on():
                arguments[entry.key.text] = self._value(rows, entry)
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
        packings = {row.packing for row in rows}
        return {
            "service": name,
            "arguments": arguments,
            "argument_places": argument_places,
            "results": tuple(results),
            "packing": packings.pop() if len(packings) == 1 else Packing(),
            **self._about(keys, channel, rows, name, at),
        }

    def _named(self, node: Node | None, service: str, what: str) -> tuple[Entry, ...]:
        """Names with places. Raises Broken for a place by itself."""
        if node is None:
            return ()
        if not isinstance(node, Mapping):
            told = "results of a call go to places by their names" if what == "RESULT" else "a call takes arguments"
            key = "into" if what == "RESULT" else "from"
            raise self.reader.broken(node.at, told, f"write {key}: {{{what}: ADDRESS}}")
        return node.read_all()

    # ---- arguments ----------------------------------------------------------------------------------------

    def _value(self, rows: tuple[ServiceRow, ...], entry: Entry) -> Any:
        """A value as the argument of that name takes it, where all rows agree on that. Raises Broken."""
        taken = _taken(rows, entry.key.text)
        if not taken or taken[0].type not in TYPES or any(one.type != taken[0].type for one in taken):
            return self.reader.constant(entry.value)
        value = raw_value(self.reader, entry.value)
        try:
            checked(taken[0], value)
        except ParameterError as error:
            if len(taken) == 1:
                what, _, todo = str(error).replace("parameter", "argument", 1).partition(" – ")
                raise self.reader.broken(entry.value.at, what, todo) from None
        return value

    def _from(self, rows: tuple[ServiceRow, ...], entry: Entry, sizes: dict[str, Entry]) -> ArgumentPlace:
        """A place that an argument is read from. Raises Broken."""
        name, reader = entry.key.text, self.reader
        taken = _taken(rows, name)
        type_ = taken[0].type if taken else "number"
        if type_ not in (*_BYTES, *_ELEMENTS, "list") or any(one.type != type_ for one in taken):
            raise reader.broken(entry.key.at, f"'{name}' cannot come from the memory", "give it in with:")
        if type_ == "list" and any(one.items not in (None, "number") for one in taken):
            raise reader.broken(entry.key.at, f"'{name}' is no list of numbers", "give it in with:")
        place = self.place(entry.value)
        size = sizes.pop(name, None)
        count = 1 if size is None else self._size(size)
        if size is None and type_ not in _ELEMENTS:
            what = f"nothing says how many {'elements' if type_ == 'list' else 'bytes'} '{name}' has"
            reader.note(entry.key.at, what, f"add size: {{{name}: N}}")
        elif size is not None and type_ in _ELEMENTS:
            reader.note(size.key.at, f"'{name}' is one number and has no size", "leave it out")
            count = 1
        self.room(entry.value, place.address, argument_bits(type_, count, place.address.unit))
        signed = any(one.limits is not None and one.limits[0] < 0 for one in taken)
        return ArgumentPlace(place=place, type=type_, size=count, signed=signed)

    def _arguments(self, service: str, rows: tuple[ServiceRow, ...], entries: tuple[Entry, ...], at: Position) -> None:
        """Arguments there are, with all that have no default."""
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
        """The addresses on the other side that a call is about."""
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
        """A result and its place. Raises Broken."""
        reader = self.reader
        result = reader.expression(entry.key)
        if not is_path(result.root):
            what = f"'{entry.key.text}' names no result"
            raise reader.broken(entry.key.at, what, "write names with dots, such as time.hour")
        shape = self._shape(service, known, result, entry)
        place = self.written(entry.value)
        node = sizes.pop(entry.key.text, None)
        size = shape.size if node is None else self._size(node)
        bits = place.address.unit_bits
        if shape.kind == "record":
            names = list(shape.parts or ())
            hint = f"name one of them, such as {entry.key.text}.{names[0]}" if names else ""
            raise reader.broken(entry.key.at, f"'{entry.key.text}' is a record of several values", hint)
        if node is not None and shape.kind == "number":
            reader.note(node.key.at, f"'{entry.key.text}' is one number and has no size", "leave it out")
            size = None
        elif shape.is_long and size is None:
            what = f"nothing says how much room there is for '{entry.key.text}', which has any number of "
            what += "elements" if shape.kind == "list" else "bytes"
            reader.note(entry.key.at, what, f"add size: {{{entry.key.text}: N}}; what does not come is 0")
        if size is not None:
            bits = 8 * size if shape.kind in ("bytes", "text") else bits * size
        self.room(entry.value, place.address, bits)
        item = shape.item or ANY
        return ResultPlace(result=result, place=place, size=size, scale=max(shape.scale, item.scale), bits=bits)

    def _shape(self, service: str, known: list[dict[str, Shape]], result: Expression, entry: Entry) -> Shape:
        """What kind of value the rows give under this name. Raises Broken when none does."""
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
        raise self.reader.broken(entry.key.at, f"'{service}' gives {problem}", problem.hint)

    def _size(self, entry: Entry) -> int:
        size = self.reader.number(entry.value)
        if not 1 <= size <= LONGEST:
            raise self.reader.broken(entry.value.at, f"a size of {size} cannot be", f"give 1 to {LONGEST}")
        return size


def _taken(rows: tuple[ServiceRow, ...], name: str) -> list[Argument]:
    return [argument for row in rows for argument in row.takes if argument.name == name]
