"""Reads the blocks of a run: instruction, places on both sides, station.

Triggers and the frames of SEND and RECEIVE have loaders of their own.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Any, Literal, TypeVar

from framekit.blocks.device import without
from framekit.blocks.given import read_station
from framekit.blocks.jobs.section import JobsSection
from framekit.blocks.load_channel import needs_own, needs_station
from framekit.blocks.load_command_block import CommandBlockLoader
from framekit.blocks.load_frame_block import FrameBlockLoader
from framekit.blocks.load_jobs import COMMANDS, JobBlockLoader
from framekit.blocks.load_rules import RulesLoader
from framekit.blocks.load_triggers import STARTS, TriggerLoader
from framekit.blocks.model import BLOCKS_IN_SET, Block, Channel, Instruction, Place
from framekit.definition.check.addresses import is_unit
from framekit.definition.expression.syntax import Expression, Name, names_in
from framekit.definition.load.reader import Broken, Reader
from framekit.definition.model.services import ServiceRow
from framekit.definition.nodes import Entry, Node, Scalar
from framekit.definition.nodes import Mapping as MappingNode
from framekit.definition.problems import Position, did_you_mean
from framekit.link.addresses import Address, AddressError, AddressGrammar
from framekit.memory.numbers import unit_bits

T = TypeVar("T")
INSTRUCTIONS: tuple[Instruction, ...] = ("read", "write", "send", "receive", "call", "command")


class BlockLoader:
    """Reads blocks; it knows the own memory's addresses and the run's channels."""

    def __init__(
        self,
        reader: Reader,
        grammar: AddressGrammar,
        channels: Mapping[int, Channel],
        known: Collection[str],
        root: MappingNode,
        jobs: JobsSection | Literal["wrong"] | None = None,
        folder: Path = Path(),
    ) -> None:
        self.reader = reader
        self.grammar = grammar
        self.channels = channels
        self.known = known
        self.spoilt = False
        self.without_own: set[int] = set()
        self.rules = RulesLoader(reader, root)
        self.triggers = TriggerLoader(reader, self.place, self.condition)
        self.frames = FrameBlockLoader(reader, self.place)
        self.commands = CommandBlockLoader(reader, folder, root, self.place)
        self.jobs = JobBlockLoader(reader, grammar, channels, jobs)

    def _try(self, read: Callable[[], T]) -> T | None:
        """What can be read; None for something broken: the rest of the block is read all the same."""
        try:
            return read()
        except Broken:
            self.spoilt = True
            return None

    def _maybe(self, read: Callable[[Node], T], node: Node | None) -> T | None:
        return None if node is None else self._try(lambda: read(node))

    # ---- own memory ---------------------------------------------------------------------------------------

    def place(self, node: Node, unit: str | None = None) -> Place:
        """A place of the own memory. Raises Broken."""
        text = self.reader.text(node)
        address = self._address(self.grammar, node.at, text, unit)
        return Place(address=address, text=text)

    def _address(
        self, grammar: AddressGrammar, at: Position, text: str, unit: str | None = None, count: int = 1
    ) -> Address:
        """An address, with room for `count` elements behind it. Raises Broken."""
        try:
            address = grammar.parse(text, unit)
            grammar.check(address, count)
        except AddressError as error:
            what, _, todo = str(error).partition(" – ")
            raise self.reader.broken(at, what, todo) from None
        return address

    def condition(self, node: Node) -> Expression:
        """An address by itself, or an expression whose names are addresses. Raises Broken."""
        scalar = self.reader.scalar(node)
        text = scalar.text.strip()
        try:
            self.grammar.parse(text)
            return Expression(text, Name(scalar.at, text))
        except AddressError:
            expression = self.reader.expression(node)
        for name in sorted(names_in(expression.root)):
            self.place(Scalar(name, scalar.at, False))
        return expression

    # ---- blocks -------------------------------------------------------------------------------------------

    def block(self, number: int, set_number: int, entry: Entry) -> Block:
        """Raises Broken when anything of it is wrong, after all of it has been looked at."""
        keys = self.reader.mapping(entry.value)
        in_memory = "command" in keys and "channel" not in keys and "commands" not in keys and self.jobs.reads_records
        if in_memory or any(name in keys for name in COMMANDS):
            return self._command(number, set_number, keys, entry)
        kinds = [name for name in INSTRUCTIONS if name in keys]
        if len(kinds) != 1:
            raise Broken("the schema has told what is wrong with the instruction")
        instruction = kinds[0]
        self.spoilt = False
        common = self._common(number, set_number, instruction, keys, entry)
        self._starts(instruction, keys, entry)
        channel = self._channel(keys, entry)
        common["params"] = self.rules.params(keys, channel.protocol)
        common |= {"channel": channel.number, **self._station(instruction, keys, channel, entry)}
        found: dict[str, Any] | None
        if instruction in ("read", "write"):
            found = self._try(lambda: self._transfer(instruction, keys, channel))
        elif instruction == "call":
            found = self._try(lambda: self._call(keys, channel))
        elif instruction == "command":
            found = self._try(lambda: self.commands.read(keys, channel))
        else:
            frames, protocol = self.frames, channel.protocol
            found = self._try(lambda: frames.read(instruction, keys, protocol, channel.number, number))
        if self.spoilt or found is None:
            raise Broken(entry.key.text)
        return Block(**common, **found)

    def _command(self, number: int, set_number: int, keys: MappingNode, entry: Entry) -> Block:
        """A block that establishes, aborts or inspects a job; what it says of its cycle is the job's."""
        instruction: Instruction = next((name for name in COMMANDS if name in keys), "command")
        self.spoilt = False
        started = without(keys, "every")
        common = self._common(number, set_number, instruction, started, entry)
        self._starts(instruction, started, entry)
        block_id = BLOCKS_IN_SET * (set_number - 1) + number
        if instruction == "command":
            record = self.jobs.record(keys, block_id)
            return Block(**common, channel=0, job=record, targets=(record.place.text,))
        command = self.jobs.command(keys, entry, block_id)
        if self.spoilt:
            raise Broken(entry.key.text)
        targets = () if command.order is None else (command.order.remote,)
        return Block(**common, channel=0, job=command, targets=targets)

    def _common(
        self, number: int, set_number: int, instruction: str, keys: MappingNode, entry: Entry
    ) -> dict[str, Any]:
        """What all blocks have."""
        reader = self.reader
        return {
            "number": number,
            "set": set_number,
            "name": self._maybe(reader.text, keys.get("name")) or f"block {number}",
            "instruction": instruction,
            "triggers": self._try(lambda: self.triggers.triggers(keys)) or (),
            "unless": self._maybe(self.condition, keys.get("unless")),
            "repeat": self._maybe(reader.number, keys.get("repeat")),
            "priority": self._maybe(reader.number, keys.get("priority")) or 0,
            "enabled": reader.flag(keys.get("enabled"), default=True),
            "merge": reader.flag(keys.get("merge"), default=True),
            "at": entry.key.at,
        }

    def _starts(self, instruction: str, keys: MappingNode, entry: Entry) -> None:
        """A RECEIVE block acts whenever its frame comes; every other one needs something that starts it."""
        given = [key for key in STARTS if key in keys]
        others = [entry.key.text for entry in keys.entries if entry.key.text not in STARTS]
        misspelt = any(difflib.get_close_matches(key, STARTS) for key in others) or "phase" in others
        if instruction == "receive" and given:
            node = keys.get(given[0])
            at = entry.key.at if node is None else node.at
            self.reader.note(at, "a receiving block acts whenever its frame comes", f"leave {given[0]} out")
        elif instruction != "receive" and not given and not misspelt:
            what = f"nothing starts block {entry.key.text}"
            self.reader.warn(entry.key.at, what, "add every:, when:, once: or another trigger")
        repeat = keys.get("repeat")
        if isinstance(repeat, Scalar) and repeat.text.strip() == "0":
            self.reader.note(repeat.at, "a block that runs 0 times never runs", "give 1 or more, or enabled: no")

    def _channel(self, keys: MappingNode, entry: Entry) -> Channel:
        """Raises Broken; what is wrong with the channel itself has been told there."""
        node = keys.get("channel")
        if node is None:
            if len(self.known) <= 1:
                if not self.channels:
                    raise Broken("the channel has been told")
                return next(iter(self.channels.values()))
            raise self.reader.broken(entry.key.at, f"block {entry.key.text} names no channel", "add channel: NUMBER")
        number = self.reader.number(node)
        if number not in self.channels:
            if str(number) in self.known:
                raise Broken("the channel has been told")
            raise self.reader.broken(node.at, f"there is no channel {number}", did_you_mean(str(number), self.known))
        return self.channels[number]

    def _station(self, instruction: str, keys: MappingNode, channel: Channel, entry: Entry) -> dict[str, Any]:
        node = keys.get("station")
        asks = instruction in ("read", "write", "call")
        names_own = asks or instruction == "command"
        if names_own and channel.own is None and channel.number not in self.without_own and needs_own(channel.protocol):
            self.without_own.add(channel.number)
            what = f"requests of '{channel.protocol.name}' name the asking side, and this channel has no number"
            self.reader.note(channel.at, what, "add own: to the channel")
        if node is None:
            if asks and channel.station is None and needs_station(channel.protocol):
                what = f"block {entry.key.text} does not say which station it talks to"
                self.reader.note(entry.key.at, what, "add station: to the block or to its channel")
            return {"station": channel.station}
        text = self.reader.text(node)
        if channel.protocol.station.type != "text" and not text.strip().isdigit():
            try:
                return {"station_from": Place(address=self.grammar.parse(text), text=text)}
            except AddressError:
                if channel.protocol.station.type == "number":
                    what = f"'{text}' is neither a station nor an address of the own memory"
                    self.reader.note(node.at, what, "write a number, or an address such as M100")
                    self.spoilt = True
                    return {}
        return {"station": self._maybe(lambda given: read_station(self.reader, given, channel.protocol), node)}

    # ---- instructions -------------------------------------------------------------------------------------

    def _transfer(self, instruction: str, keys: MappingNode, channel: Channel) -> dict[str, Any]:
        """READ and WRITE: addresses of the other side, and the own places beside them."""
        reader = self.reader
        unit = self._maybe(reader.text, keys.get("type"))
        if unit is not None and not is_unit(unit):
            raise Broken("the schema has told what is wrong with the unit")
        count = self._count(keys.get("count"))
        nodes = reader.items(keys.get(instruction))
        protocol = channel.protocol
        if instruction not in protocol.services:
            raise reader.broken(
                nodes[0].at, f"'{protocol.name}' has no service {instruction}", "use send and receive with its frames"
            )
        grammar = AddressGrammar(protocol.addresses, protocol.areas, protocol.tables)
        units: list[str] = []
        for node in nodes:
            with reader.going_on():
                address = self._address(grammar, node.at, reader.text(node), unit, count if len(nodes) == 1 else 1)
                units.append(unit or address.unit)
                if instruction == "write" and protocol.areas[address.area].access == "read":
                    reader.note(node.at, f"area '{address.area}' can only be read", "write to another area")
        places, values = self._own_side(instruction, keys, len(nodes), count)
        if len(units) == len(nodes):
            self._room(keys.get("into" if instruction == "read" else "from"), places, units, count)
        return {
            "targets": tuple(reader.text(node) for node in nodes),
            "units": tuple(units),
            "places": places,
            "unit": unit,
            "count": count,
            "values": values,
        }

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
        count = self._maybe(self.reader.number, node)
        if node is not None and count is not None and count < 1:
            self.reader.note(node.at, f"a count of {count} moves nothing", "give 1 or more")
        return max(1, count or 1)

    def _own_side(
        self, instruction: str, keys: MappingNode, targets: int, count: int
    ) -> tuple[tuple[Place, ...], tuple[int, ...] | None]:
        """The own places, one for each address, or the constants to write."""
        reader = self.reader
        word, other, does = ("into", "from", "go") if instruction == "read" else ("from", "into", "come from")
        wrong = keys.get(other)
        if wrong is not None and instruction == "read":
            reader.note(wrong.at, f"{other}: does not belong to a {instruction}", f"write {word}:")
        node, given = keys.get(word), keys.get("values")
        places = tuple(place for item in reader.items(node) if (place := self._maybe(self.place, item)) is not None)
        values = None if given is None else self._try(lambda: tuple(reader.number(one) for one in reader.items(given)))
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
        elif values is not None and len(values) == 1:
            values *= max(targets, count)
        own = len(reader.items(node))
        if own and own != targets:
            what = f"{targets} addresses of the other side stand against {own} own ones"
            reader.note(keys.at, what, "give as many of one as of the other")
        return places, values

    def _call(self, keys: MappingNode, channel: Channel) -> dict[str, Any]:
        """CALL: a service and its arguments."""
        reader = self.reader
        node = keys.get("call")
        name = reader.text(node)
        at = keys.at if node is None else node.at
        rows = channel.protocol.services.get(name)
        if rows is None:
            hint = did_you_mean(name, channel.protocol.services)
            raise reader.broken(at, f"'{channel.protocol.name}' has no service '{name}'", hint)
        entries = reader.entries(keys.get("with"))
        self._arguments(name, rows, entries, at)
        return {
            "service": name,
            "arguments": {
                entry.key.text: value
                for entry in entries
                if (value := self._maybe(self._plain, entry.value)) is not None
            },
        }

    def _arguments(self, service: str, rows: tuple[ServiceRow, ...], entries: tuple[Entry, ...], at: Position) -> None:
        """Arguments there are, with all that have no default."""
        if service in ("read", "write") or any(row.most_variables for row in rows):
            return
        known = {argument.name for row in rows for argument in row.takes}
        given = {entry.key.text for entry in entries}
        for entry in entries:
            if entry.key.text not in known:
                hint = did_you_mean(entry.key.text, known) or "leave it out"
                self.reader.note(entry.key.at, f"'{service}' takes no '{entry.key.text}'", hint)
        if len(rows) == 1 and given <= known:
            for argument in rows[0].takes:
                if argument.default is None and argument.name not in given:
                    self.reader.note(at, f"'{service}' is called without '{argument.name}'", "add it to with:")

    def _plain(self, node: Node) -> Any:
        return self.reader.constant(node)
