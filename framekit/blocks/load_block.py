"""Reads the blocks of a run: what all of them have, channel and station.

Triggers, and what each instruction has of its own, have loaders of their own.
"""

from __future__ import annotations

import difflib
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, Literal

from framekit.blocks.attempts import Attempts
from framekit.blocks.given import read_params, read_station
from framekit.blocks.jobs.section import JobsSection
from framekit.blocks.load_call import CallLoader
from framekit.blocks.load_channel import needs_own, needs_station
from framekit.blocks.load_command_block import CommandBlockLoader
from framekit.blocks.load_frame_block import FrameBlockLoader
from framekit.blocks.load_jobs import COMMANDS, JobBlockLoader
from framekit.blocks.load_rules import RulesLoader
from framekit.blocks.load_transfer import TransferLoader
from framekit.blocks.load_triggers import STARTS, TriggerLoader
from framekit.blocks.model import BLOCKS_IN_SET, Block, Channel, Instruction, Place
from framekit.blocks.own_places import address_at, check_written
from framekit.definition.expression.syntax import Expression, Name, names_in
from framekit.definition.load.documents import without_effect
from framekit.definition.load.reader import Broken, Reader
from framekit.definition.nodes import Entry, Node, Scalar, without
from framekit.definition.nodes import Mapping as MappingNode
from framekit.definition.problems import did_you_mean, is_nearly
from framekit.definition.tree import unread
from framekit.link.addresses import Address, AddressError, AddressGrammar

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
        self.attempts = attempts = Attempts()
        self.without_own: set[int] = set()
        self.rules = RulesLoader(reader, root)
        self.channel_nodes = reader.entries(root.get("channels"))
        self.triggers = TriggerLoader(reader, self.place, self.condition, self.room)
        self.transfers = TransferLoader(reader, grammar, attempts, self.place, self.written)
        self.calls = CallLoader(reader, attempts, self.place, self.written, self.room)
        self.frames = FrameBlockLoader(reader, self.place, self.written)
        self.commands = CommandBlockLoader(reader, folder, root, self.place, self.written)
        self.jobs = JobBlockLoader(reader, grammar, channels, jobs)

    # ---- own memory ---------------------------------------------------------------------------------------

    def place(self, node: Node, unit: str | None = None) -> Place:
        """A place of the own memory. Raises Broken."""
        text = self.reader.text(node)
        address = address_at(self.reader, self.grammar, node.at, text, unit)
        return Place(address=address, text=text)

    def written(self, node: Node, unit: str | None = None) -> Place:
        """A place of the own memory that the run is to write; an area that can only be read is noted. Raises Broken."""
        place = self.place(node, unit)
        check_written(self.reader, self.grammar, node, place)
        return place

    def room(self, node: Node, address: Address, bits: int) -> None:
        """Notes that so many bits from an address on are not all in its area."""
        try:
            self.grammar.check(address, -(-bits // address.unit_bits))
        except AddressError as error:
            what, _, todo = str(error).partition(" – ")
            self.reader.note(node.at, what, todo)

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
        if self._is_record(keys) or any(name in keys for name in COMMANDS):
            return self._command(number, set_number, keys, entry)
        kinds = [name for name in INSTRUCTIONS if name in keys]
        if len(kinds) != 1:
            raise Broken("the schema has told what is wrong with the instruction")
        instruction = kinds[0]
        self.attempts.spoilt = False
        common = self._common(number, set_number, instruction, keys, entry)
        self._starts(instruction, keys, entry)
        channel = self._channel(keys, entry)
        if channel.listens:
            node = keys.get("channel") or entry.key
            what = f"channel {channel.number} listens for connections and answers on them"
            self.reader.note(node.at, what, "leave the block out, or use another channel")
        if instruction == "send":
            common["params"] = read_params(self.reader, self.reader.entries(keys.get("params")), channel.protocol)
        elif instruction != "receive":
            common["params"] = self.rules.params(keys, channel.protocol)
        common |= {"channel": channel.number, **self._station(instruction, keys, channel, entry)}
        found: dict[str, Any] | None
        if instruction in ("read", "write"):
            found = self.attempts.to(lambda: self.transfers.read(instruction, keys, channel))
        elif instruction == "call":
            found = self.attempts.to(lambda: self.calls.read(keys, channel))
        elif instruction == "command":
            found = self.attempts.to(lambda: self.commands.read(keys, channel))
        else:
            frames, protocol = self.frames, channel.protocol
            found = self.attempts.to(lambda: frames.read(instruction, keys, protocol, channel.number, number))
        if self.attempts.spoilt or found is None:
            raise Broken(entry.key.text)
        places = " of several places" if len(found.get("targets", ())) > 1 else ""
        self._without_effect(keys, f"beside {instruction}:{places}")
        if instruction == "send":
            common["params"] |= {name: found["sizes"][field] for field, name in found["sized_by"].items()}
        return Block(**common, **found)

    def _without_effect(self, keys: MappingNode, where: str) -> None:
        """Keys that nothing has read: what such a block does not look at."""
        if sum(name in keys for name in (*INSTRUCTIONS, "report", "abort", "inspect")) != 1:
            return  # which one is meant the schema asks
        self.reader.problems.extend(without_effect(entry, where) for _, entry in unread(keys))

    def _is_record(self, keys: MappingNode) -> bool:
        """Whether a block is a command to jobs whose words stand in memory."""
        return "command" in keys and "channel" not in keys and "commands" not in keys and self.jobs.reads_records

    def _command(self, number: int, set_number: int, keys: MappingNode, entry: Entry) -> Block:
        """A block that establishes, aborts or inspects a job; the cycle of one that establishes is the job's."""
        instruction: Instruction = next((name for name in COMMANDS if name in keys), "command")
        self.attempts.spoilt = False
        started = without(keys, "every") if instruction == "job" else keys
        common = self._common(number, set_number, instruction, started, entry)
        self._starts(instruction, started, entry)
        block_id = BLOCKS_IN_SET * (set_number - 1) + number
        if instruction == "command":
            record = self.jobs.record(keys, block_id)
            self._without_effect(keys, "beside command:")
            return Block(**common, channel=0, job=record, targets=(record.place.text,))
        command = self.jobs.command(keys, entry, block_id)
        if self.attempts.spoilt:
            raise Broken(entry.key.text)
        self._without_effect(keys, f"beside {instruction}:")
        targets = () if command.order is None else (command.order.remote,)
        return Block(**common, channel=0, job=command, targets=targets)

    def _common(
        self, number: int, set_number: int, instruction: str, keys: MappingNode, entry: Entry
    ) -> dict[str, Any]:
        """What all blocks have."""
        reader = self.reader
        has_turn = instruction in INSTRUCTIONS and instruction != "receive" and not self._is_record(keys)
        joins = instruction == "read" and len(reader.items(keys.get("read"))) == 1
        return {
            "number": number,
            "set": set_number,
            "name": self.attempts.maybe(reader.text, keys.get("name")) or f"block {number}",
            "instruction": instruction,
            "triggers": self.attempts.to(lambda: self.triggers.triggers(keys)) or (),
            "unless": self.attempts.maybe(self.condition, keys.get("unless")),
            "repeat": self.attempts.maybe(reader.number, keys.get("repeat")),
            "priority": (self.attempts.maybe(reader.number, keys.get("priority")) or 0) if has_turn else 0,
            "enabled": reader.flag(keys.get("enabled"), default=True),
            "merge": reader.flag(keys.get("merge"), default=True) if joins else True,
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
            cycle = "" if instruction == "job" else "every:, "
            self.reader.warn(entry.key.at, what, f"add {cycle}when:, once: or another trigger")
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

    def _misspelt(self, channel: Channel) -> bool:
        """Whether the channel has a key that is nearly `station`; that it is none has been told."""
        keys = next((one.value for one in self.channel_nodes if one.key.text == str(channel.number)), None)
        return any(is_nearly("station", one.key.text) for one in getattr(keys, "entries", ()))

    def _station(self, instruction: str, keys: MappingNode, channel: Channel, entry: Entry) -> dict[str, Any]:
        if instruction in ("send", "receive"):
            return {"station": channel.station}
        node = keys.get("station")
        asks = instruction in ("read", "write", "call")
        names_own = asks or instruction == "command"
        if names_own and channel.own is None and channel.number not in self.without_own and needs_own(channel.protocol):
            self.without_own.add(channel.number)
            what = f"requests of '{channel.protocol.name}' name the asking side, and this channel has no number"
            self.reader.note(channel.at, what, "add own: to the channel")
        if node is None:
            if asks and channel.station is None and needs_station(channel.protocol) and not self._misspelt(channel):
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
                    self.attempts.spoilt = True
                    return {}
        return {"station": self.attempts.maybe(lambda given: read_station(self.reader, given, channel.protocol), node)}
