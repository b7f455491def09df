"""Reads the blocks of a run: instruction, places, triggers."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from typing import Any

from framekit.blocks.given import read_station
from framekit.blocks.model import (
    After,
    Block,
    BlockEnd,
    Changed,
    Channel,
    Every,
    Instruction,
    Place,
    Rising,
    Trigger,
    While,
)
from framekit.definition.expression.syntax import Expression, Name, names_in
from framekit.definition.load.reader import Reader
from framekit.definition.model.segments import Data, Field
from framekit.definition.nodes import Entry, Node, Scalar
from framekit.definition.nodes import Mapping as MappingNode
from framekit.definition.problems import did_you_mean
from framekit.link.addresses import AddressError, AddressGrammar

INSTRUCTIONS: tuple[Instruction, ...] = ("read", "write", "send", "receive", "call")
_BLOCK_END = re.compile(r"block\s+(\d+)\s+(done|failed)")


class BlockLoader:
    """Reads blocks; it knows the own memory's addresses and the run's channels."""

    def __init__(
        self, reader: Reader, grammar: AddressGrammar, channels: Mapping[int, Channel], known: Collection[str]
    ) -> None:
        self.reader = reader
        self.grammar = grammar
        self.channels = channels
        self.known = known
        self.ends: list[tuple[BlockEnd, Node]] = []

    # ---- own memory ---------------------------------------------------------------------------------------

    def place(self, node: Node, unit: str | None = None) -> Place:
        """A place of the own memory. Raises Broken."""
        text = self.reader.text(node)
        try:
            return Place(address=self.grammar.parse(text, unit), text=text)
        except AddressError as error:
            what, _, todo = str(error).partition(" – ")
            raise self.reader.broken(node.at, what, todo) from None

    def places(self, node: Node | None, unit: str | None = None) -> tuple[Place, ...]:
        return tuple(self.place(item, unit) for item in self.reader.items(node))

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
        """Raises Broken."""
        reader, keys = self.reader, self.reader.mapping(entry.value)
        kinds = [name for name in INSTRUCTIONS if name in keys]
        if len(kinds) != 1:
            raise reader.broken(
                entry.key.at, f"block {number} has {'no' if not kinds else 'more than one'} instruction",
                "write one of read, write, send, receive, call",
            )  # fmt: skip
        instruction = kinds[0]
        channel = self._channel(keys, entry)
        common = {
            "number": number,
            "set": set_number,
            "name": reader.maybe(reader.text, keys.get("name")) or f"block {number}",
            "instruction": instruction,
            "channel": channel.number,
            "triggers": self._triggers(keys),
            "unless": reader.maybe(self.condition, keys.get("unless")),
            "repeat": reader.maybe(reader.number, keys.get("repeat")),
            "priority": reader.maybe(reader.number, keys.get("priority")) or 0,
            "enabled": reader.flag(keys.get("enabled"), default=True),
            "at": entry.key.at,
            **self._station(keys, channel),
        }
        if instruction in ("read", "write"):
            return Block(**common, **self._transfer(instruction, keys, channel))
        if instruction == "call":
            return Block(**common, **self._call(keys, channel))
        return Block(**common, **self._frame(instruction, keys, channel))

    def _channel(self, keys: MappingNode, entry: Entry) -> Channel:
        node = keys.get("channel")
        if node is None:
            if len(self.channels) == 1 == len(self.known):
                return next(iter(self.channels.values()))
            raise self.reader.broken(entry.key.at, f"block {entry.key.text} names no channel", "add channel: NUMBER")
        number = self.reader.number(node)
        if number not in self.channels:
            if str(number) in self.known:
                raise self.reader.broken(node.at, f"channel {number} cannot be used", "mend the channel first")
            raise self.reader.broken(node.at, f"there is no channel {number}", did_you_mean(str(number), self.known))
        return self.channels[number]

    def _station(self, keys: MappingNode, channel: Channel) -> dict[str, Any]:
        node = keys.get("station")
        if node is None:
            return {"station": channel.station}
        text = self.reader.text(node)
        if channel.protocol.station.type != "text" and not text.strip().isdigit():
            try:
                return {"station_from": Place(address=self.grammar.parse(text), text=text)}
            except AddressError:
                return {"station": read_station(self.reader, node, channel.protocol)}
        return {"station": read_station(self.reader, node, channel.protocol)}

    # ---- instructions -------------------------------------------------------------------------------------

    def _transfer(self, instruction: str, keys: MappingNode, channel: Channel) -> dict[str, Any]:
        """READ and WRITE: addresses of the other side, and the own places beside them."""
        reader = self.reader
        unit = reader.maybe(reader.text, keys.get("type"))
        count = reader.maybe(reader.number, keys.get("count")) or 1
        nodes = reader.items(keys.get(instruction))
        protocol = channel.protocol
        if instruction not in protocol.services:
            raise reader.broken(
                nodes[0].at, f"'{protocol.name}' has no service {instruction}", "use send and receive with its frames"
            )
        grammar = AddressGrammar(protocol.addresses, protocol.areas, protocol.tables)
        for node in nodes:
            try:
                grammar.parse(reader.text(node), unit)
            except AddressError as error:
                what, _, todo = str(error).partition(" – ")
                reader.note(node.at, what, todo)
        own = keys.get("into" if instruction == "read" else "from")
        values = keys.get("values")
        places = self.places(own)
        if not places and values is None:
            word, does = ("into", "go") if instruction == "read" else ("from", "come from")
            what = f"the block does not say where its data {does}"
            raise reader.broken(keys.at, what, f"add {word}: with an address of the own memory")
        if places and len(places) != len(nodes):
            raise reader.broken(
                keys.at, f"{len(nodes)} addresses of the other side stand against {len(places)} own ones",
                "give as many of one as of the other",
            )  # fmt: skip
        return {
            "targets": tuple(reader.text(node) for node in nodes),
            "places": places,
            "unit": unit,
            "count": count,
            "values": None if values is None else tuple(reader.number(item) for item in reader.items(values)),
        }

    def _frame(self, instruction: str, keys: MappingNode, channel: Channel) -> dict[str, Any]:
        """SEND and RECEIVE: a frame, and places for its fields."""
        reader, protocol = self.reader, channel.protocol
        node = keys.get(instruction)
        assert node is not None
        name = reader.text(node)
        if name not in protocol.frames:
            raise reader.broken(
                node.at, f"'{protocol.name}' has no frame '{name}'", did_you_mean(name, protocol.frames)
            )
        fields = {part.name: part for part in protocol.frames[name].segments if isinstance(part, (Data, Field))}
        data: dict[str, Place] = {
            field: self.place(Scalar(part.memory, part.at, False)) for field, part in fields.items() if part.memory
        }
        for entry in reader.entries(keys.get("data")):
            with reader.going_on():
                if entry.key.text not in fields:
                    hint = did_you_mean(entry.key.text, fields)
                    raise reader.broken(entry.key.at, f"frame '{name}' has no field '{entry.key.text}'", hint)
                data[entry.key.text] = self.place(entry.value)
        values = {entry.key.text: self._plain(entry.value) for entry in reader.entries(keys.get("values"))}
        sizes = {entry.key.text: reader.number(entry.value) for entry in reader.entries(keys.get("size"))}
        return {"frame": name, "data": data, "values": values, "sizes": sizes}

    def _call(self, keys: MappingNode, channel: Channel) -> dict[str, Any]:
        reader = self.reader
        node = keys.get("call")
        assert node is not None
        name = reader.text(node)
        if name not in channel.protocol.services:
            hint = did_you_mean(name, channel.protocol.services)
            raise reader.broken(node.at, f"'{channel.protocol.name}' has no service '{name}'", hint)
        return {
            "service": name,
            "arguments": {entry.key.text: self._plain(entry.value) for entry in reader.entries(keys.get("with"))},
        }

    def _plain(self, node: Node) -> Any:
        return self.reader.constant(node)

    # ---- triggers -----------------------------------------------------------------------------------------

    def _triggers(self, keys: MappingNode) -> tuple[Trigger, ...]:
        reader = self.reader
        found: list[Trigger] = []
        if (node := keys.get("every")) is not None:
            period = reader.time(node)
            if period <= 0:
                raise reader.broken(node.at, "a cycle of no time never ends", "give a time such as 200 ms")
            phase = keys.get("phase")
            found.append(Every(period=period, phase=period if phase is None else reader.time(phase)))
        for item in reader.items(keys.get("when")):
            found.append(self._when(item))
        if (node := keys.get("while")) is not None:
            found.append(While(condition=self.condition(node)))
        if (node := keys.get("on_change")) is not None:
            words = keys.get("words")
            found.append(Changed(address=self.place(node).address, words=1 if words is None else reader.number(words)))
        if reader.flag(keys.get("once")):
            found.append(After(delay=0))
        if (node := keys.get("after")) is not None:
            found.append(After(delay=reader.time(node)))
        return tuple(found)

    def _when(self, node: Node) -> Trigger:
        match = _BLOCK_END.fullmatch(self.reader.text(node).strip())
        if match is None:
            return Rising(condition=self.condition(node))
        end = BlockEnd(block=int(match[1]), ok=match[2] == "done")
        self.ends.append((end, node))
        return end

    def check_ends(self, numbers: set[int]) -> None:
        """Notes triggers that wait for a block there is not."""
        for end, node in self.ends:
            if end.block not in numbers:
                known = ", ".join(map(str, sorted(numbers)))
                self.reader.note(node.at, f"there is no block {end.block} to wait for", f"known: {known}")
