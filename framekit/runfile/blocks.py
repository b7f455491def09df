"""Read the blocks of a run: the keys common to all blocks, blocks with commands, and blocks for jobs."""

from __future__ import annotations

import difflib
import re
from collections.abc import Collection, Iterator
from collections.abc import Mapping as MappingOf
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal, get_args

from framekit.definition.expression import Expression, Name, names_in
from framekit.definition.load.documents import without_effect
from framekit.definition.load.protocol import load_protocol
from framekit.definition.load.reader import Broken, Reader
from framekit.definition.model.frames import parts_of
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.services import CommandCall, ServiceRow
from framekit.definition.nodes import Entry, Mapping, Node, Scalar, unread, without
from framekit.definition.nodes import Mapping as MappingNode
from framekit.definition.problems import DefinitionError, Position, Problem, did_you_mean, is_nearly, parted
from framekit.definition.times import NEVER, format_time
from framekit.link.addresses import AddressError, AddressGrammar
from framekit.memory.memory import unit_bits
from framekit.run.model import (
    BLOCKS_IN_SET,
    Block,
    Channel,
    CommandKind,
    Instruction,
    JobCommand,
    JobProfile,
    JobRecord,
    JobsSection,
    Order,
    OrderKind,
    OwnPlace,
    channel_to,
    is_address,
)
from framekit.run.triggers import TRIGGERS, TriggerReader
from framekit.runfile.channels import (
    Attempts,
    RulesLoader,
    beside,
    needs_own,
    needs_station,
    read_channel_number,
    read_params,
    read_station,
)  # fmt: skip
from framekit.runfile.transfers import CallLoader, FrameBlockLoader, OwnPlaces, TransferLoader

INSTRUCTIONS: tuple[Instruction, ...] = ("read", "write", "send", "receive", "call", "command")


def _without_zeros(address: str) -> str:
    """Return an address without the zeros in front of its number: `F93` for `F00093`."""
    return re.sub(r"(?<=\D)0+(?=\w)", "", address, count=1)


class BlockLoader:
    """Reads blocks, given the address grammar of the own memory and the channels of the run."""

    def __init__(
        self,
        reader: Reader,
        grammar: AddressGrammar,
        channels: MappingOf[int, Channel],
        known: Collection[str],
        root: MappingNode,
        jobs: JobsSection | Literal["wrong"] | None = None,
        folder: Path = Path(),
        own_bits: Collection[str] = (),
        broken: MappingOf[int, Channel] = MappingProxyType({}),
    ) -> None:
        """Prepare the loader; `own_bits`: bits that the own memory sets by itself, as its profile writes them.

        `broken`: channels with errors whose protocol is known; their blocks are checked as far as possible.
        """
        self.broken = broken
        self.reader = reader
        self.grammar = grammar
        self._own_bits = {_without_zeros(bit): bit for bit in own_bits}
        self.channels = channels
        self.known = known
        self.attempts = attempts = Attempts()
        self.without_own: set[int] = set()
        self.rules = RulesLoader(reader, root)
        self.channel_nodes = reader.entries(root.get("channels"))
        self.places = places = OwnPlaces(reader, grammar)
        self.triggers = TriggerReader(reader, lambda node: places.place(node).address, self.condition, places.room)
        self.transfers = TransferLoader(reader, attempts, places)
        self.calls = CallLoader(reader, attempts, places, folder)
        self.frames = FrameBlockLoader(reader, places)
        self.commands = CommandBlockLoader(reader, folder, root, places)
        self.jobs = JobBlockLoader(reader, places, channels, known, jobs)

    # ---- own memory ---------------------------------------------------------------------------------------

    def condition(self, node: Node) -> Expression:
        """Return an address by itself, or an expression whose names are addresses. Raise Broken."""
        scalar = self.reader.scalar(node)
        text = scalar.text.strip()
        try:
            address = self.grammar.parse(text)
        except AddressError:
            expression = self.reader.expression(node)
        else:
            bit = self._own_bits.get(_without_zeros(text), text)
            if address.unit != "bit" and bit != text:
                what = f"'{text}' is a word, which is no condition here; the bit of this number is {bit}"
                raise self.reader.broken(scalar.at, what, f"write {bit}")
            return Expression(text, Name(scalar.at, text))
        for name in sorted(names_in(expression.root)):
            self.places.place(Scalar(name, scalar.at, False))
        return expression

    # ---- blocks -------------------------------------------------------------------------------------------

    def block(self, number: int, set_number: int, entry: Entry) -> Block:
        """Return one block. Check all its keys before raising Broken for the invalid ones."""
        keys = self.reader.mapping(entry.value)
        if self._is_record(keys) or any(name in keys for name in COMMANDS):
            return self._command(number, set_number, keys, entry)
        kinds = [name for name in INSTRUCTIONS if name in keys]
        self.attempts.spoilt = False
        if len(kinds) != 1:
            if keys.get("channel") is not None:
                self._channel(keys, entry)
            raise Broken("the schema has told what is wrong with the instruction")
        instruction = kinds[0]
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
            found = self.attempts.to(lambda: self.frames.read(instruction, keys, channel, number))
        if self.attempts.spoilt or found is None:
            raise Broken(entry.key.text)
        places = " of several places" if len(found.get("targets", ())) > 1 else ""
        self._without_effect(keys, f"beside {instruction}:{places}")
        if instruction == "send":
            common["params"] |= {name: found["sizes"][field] for field, name in found["sized_by"].items()}
        return Block(**common, **found)

    def _without_effect(self, keys: MappingNode, where: str) -> None:
        """Note the keys that have not been read: they have no effect in this block."""
        if sum(name in keys for name in (*INSTRUCTIONS, "report", "abort", "inspect")) != 1:
            return  # the schema reports this and asks for a single instruction
        self.reader.problems.extend(without_effect(entry, where) for _, entry in unread(keys))

    def _is_record(self, keys: MappingNode) -> bool:
        """Return whether a block is a command to jobs whose words are in memory."""
        return "command" in keys and "channel" not in keys and "commands" not in keys and self.jobs.reads_records

    def _command(self, number: int, set_number: int, keys: MappingNode, entry: Entry) -> Block:
        """Return a block that starts, aborts or inspects a job.

        `every` of a block that starts a job is the period of the job.
        """
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
        """Return the attributes that all blocks have."""
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
        """Note triggers on a RECEIVE block, which acts on every frame that arrives.

        Warn if any other block has no trigger.
        """
        given = [key for key in TRIGGERS if key in keys]
        if given == ["once"] and self.attempts.maybe(self.reader.flag, keys.get("once")) is False:
            given = []
        others = [entry.key.text for entry in keys.entries if entry.key.text not in TRIGGERS]
        misspelt = any(difflib.get_close_matches(key, TRIGGERS) for key in others) or "phase" in others
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
        """Return the channel of a block. Raise Broken.

        Problems of the channel itself have been reported at the channel.
        """
        node = keys.get("channel")
        if node is None:
            if len(self.known) <= 1:
                if not self.channels:
                    raise Broken("the channel has been told")
                return next(iter(self.channels.values()))
            raise self.reader.broken(entry.key.at, f"block {entry.key.text} names no channel", "add channel: NUMBER")
        number = read_channel_number(self.reader, node, self.known)
        if number in self.broken and number not in self.channels:
            self.attempts.spoilt = True
            return self.broken[number]
        if number not in self.channels:
            if str(number) in self.known:
                raise Broken("the channel has been told")
            raise self.reader.broken(node.at, f"there is no channel {number}", did_you_mean(str(number), self.known))
        return self.channels[number]

    def _misspelt(self, channel: Channel) -> bool:
        """Return whether the channel has a misspelt `station` key, which has been reported."""
        keys = next((one.value for one in self.channel_nodes if one.key.text == str(channel.number)), None)
        return any(is_nearly("station", one.key.text) for one in getattr(keys, "entries", ()))

    def _station(self, instruction: str, keys: MappingNode, channel: Channel, entry: Entry) -> dict[str, Any]:
        if instruction in ("send", "receive"):
            return {"station": channel.station}
        node = keys.get("station")
        is_right = channel.number not in self.broken and not channel.listens
        asks = is_right and instruction in ("read", "write", "call")
        names_own = asks or (is_right and instruction == "command")
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
                return {"station_from": OwnPlace(address=self.grammar.parse(text), text=text)}
            except AddressError:
                if channel.protocol.station.type == "number":
                    what = f"'{text}' is neither a station nor an address of the own memory"
                    self.reader.note(node.at, what, "write a number, or an address such as M100")
                    self.attempts.spoilt = True
                    return {}
        return {"station": self.attempts.maybe(lambda given: read_station(self.reader, given, channel.protocol), node)}


class CommandBlockLoader:
    """Reads blocks with `command:`."""

    def __init__(self, reader: Reader, folder: Path, root: Mapping, places: OwnPlaces) -> None:
        self.reader = reader
        self.folder = folder
        self._root = root
        self._places = places
        self._found: dict[tuple[str, str], Protocol | None] = {}

    def read(self, keys: Mapping, channel: Channel) -> dict[str, Any]:
        """Return the attributes of a block with `command:`. Raise Broken."""
        node, fault = keys.get("command"), keys.get("fault")
        assert node is not None
        place = self._places.place(node, "word")
        return {
            "places": (place,),
            "targets": (place.text,),
            "commands": self._application(keys, channel, node),
            "fault": None if fault is None else self._places.written(fault, "bit"),
        }

    def _application(self, keys: Mapping, channel: Channel, block: Node) -> Protocol:
        of_channel = self._of_channel(channel)
        named = next((node for node in (keys.get("commands"), of_channel, self._root.get("commands")) if node), None)
        name = "" if named is None else self.reader.text(named)
        known = (name, channel.protocol.name)
        if known not in self._found:
            self._found[known] = None
            at = block.at if named is None else named.at
            try:
                self._found[known] = commands_for(channel.protocol, name or None, self.folder, at)
            except DefinitionError as error:
                self.reader.of_file(error, name, at)
        found = self._found[known]
        if found is None:
            raise Broken(name)
        return found

    def _of_channel(self, channel: Channel) -> Node | None:
        for entry in self.reader.entries(self._root.get("channels")):
            if entry.key.at == channel.at and isinstance(entry.value, Mapping):
                return entry.value.get("commands")
        return None


def commands_for(protocol: Protocol, name: str | None, folder: Path, at: Position) -> Protocol:
    """Return the application of commands of a channel: `name`, or else the application that its protocol names.

    Raise DefinitionError if neither names an application, or if it does not fit the protocol.
    """
    wanted = name or protocol.commands_file
    if not wanted:
        what = f"'{protocol.name}' names no application of commands"
        raise DefinitionError([Problem(at, what, "add commands: NAME; on a command line --commands NAME")])
    application = load_protocol(beside(wanted, folder), folder)
    problems = list(mismatches(application, protocol, at))
    if problems:
        raise DefinitionError(problems)
    return application


def mismatches(application: Protocol, protocol: Protocol, at: Position) -> Iterator[Problem]:
    """Yield the reasons why an application of commands cannot work on a channel that uses `protocol`."""
    if application.commands is None:
        yield Problem(at, f"'{application.name}' has no command blocks", "name an application with commands:")
        return
    for row in application.service_rows:
        yield from _missing(row, application, protocol, at)


def _missing(row: ServiceRow, application: Protocol, protocol: Protocol, at: Position) -> Iterator[Problem]:
    block = None if row.serve is None else row.serve.block
    if block is None:
        return
    whose = f"command '{row.service}' of '{application.name}'"
    for call in parts_of(block.calls, CommandCall):
        rows = protocol.services.get(call.service)
        if not rows:
            hint = did_you_mean(call.service, protocol.services)
            yield Problem(at, f"{whose} calls '{call.service}', which '{protocol.name}' has not", hint)
            continue
        taken = {argument.name for one in rows for argument in one.takes}
        for name in call.arguments.keys() - taken:
            hint = did_you_mean(name, taken)
            yield Problem(at, f"{whose} gives '{call.service}' a '{name}', which that does not take", hint)
    for name in block.params.keys() - protocol.params.keys():
        hint = did_you_mean(name, protocol.params)
        yield Problem(at, f"{whose} gives '{protocol.name}' a parameter '{name}', which that has not", hint)
    for kind in ("read", "write"):
        if getattr(block, kind) is not None and kind not in protocol.services:
            yield Problem(at, f"{whose} has {kind}, which '{protocol.name}' has not", "take another application")


COMMANDS: tuple[CommandKind, ...] = ("job", "abort", "inspect")
ALL = "all"
MOST_TIMES = 0xFFFF

_KINDS: tuple[OrderKind, ...] = get_args(OrderKind)


class JobBlockLoader:
    """Reads commands to jobs."""

    def __init__(
        self,
        reader: Reader,
        places: OwnPlaces,
        channels: MappingOf[int, Channel],
        known: Collection[str],
        section: JobsSection | Literal["wrong"] | None,
    ) -> None:
        self.reader = reader
        self.known = known
        """The numbers of all channels as written; those missing in `channels` could not be read."""
        self.places = places
        self.channels = channels
        self.section = section

    def command(self, keys: MappingNode, entry: Entry, number: int) -> JobCommand:
        """Return the command of a block. Check all its keys before raising Broken for the invalid ones."""
        if self.section == "wrong":
            raise Broken("what is wrong with the jobs of the run has been told")
        if self.section is None:
            raise self.reader.broken(entry.key.at, "the run has no jobs", "add jobs: {profile: NAME, status: ADDRESS}")
        profile = self.section.profile
        before = len(self.reader.problems)
        kind = next(name for name in COMMANDS if name in keys)
        slot: int | None = None
        with self.reader.going_on():
            slot = self._slot(keys.get(kind), kind, profile)
        status = self.reader.tried(lambda node: self.places.written(node, bits=16), keys.get("status"))
        into = keys.get("into") if kind == "inspect" else None
        into_place = self.reader.tried(lambda node: self.places.written(node, bits=32), into)
        order = None
        with self.reader.going_on():
            if kind == "job":
                order = self._order(slot or profile.first, keys, entry, self.section)
            elif kind == "inspect" and into is None:
                what = "the block does not say where the detail words go"
                self.reader.note(entry.key.at, what, "add into: with an address of the own memory")
        if any(not problem.warning for problem in self.reader.problems[before:]):
            raise Broken(entry.key.text)
        return JobCommand(kind=kind, slot=slot, order=order, status=status, into=into_place, id=number)

    @property
    def reads_records(self) -> bool:
        """Return whether the jobs of the run accept commands whose words are in memory."""
        return isinstance(self.section, JobsSection) and self.section.commands is not None

    def record(self, keys: MappingNode, number: int) -> JobRecord:
        """Return the command of a block whose words are in memory. Raise Broken."""
        section = self.section
        assert isinstance(section, JobsSection) and section.commands is not None
        node, fault = keys.get("command"), keys.get("fault")
        assert node is not None
        return JobRecord(
            place=self.places.place(node, bits=16),
            application=section.commands,
            fault=self.reader.maybe(self.places.written, fault),
            id=number,
        )

    def _slot(self, node: Node | None, kind: str, profile: JobProfile) -> int | None:
        if kind == "abort" and node is not None and self.reader.text(node).strip() == ALL:
            return None
        number = self.reader.number(node)
        if number not in profile.slots and node is not None:
            todo = f"slots are {profile.first} to {profile.last}" + (f", or {ALL}" if kind == "abort" else "")
            raise self.reader.broken(node.at, f"there is no slot {number}", todo)
        return number

    # ---- orders -------------------------------------------------------------------------------------------

    def _order(self, slot: int, keys: MappingNode, entry: Entry, section: JobsSection) -> Order:
        reader, profile = self.reader, section.profile
        kind = next((name for name in _KINDS if name in keys), None)
        if kind is None:
            wrong = next((name for name in ("send", "receive", "call") if name in keys), None)
            if wrong is None:
                raise Broken("the schema has told that there is no instruction")
            raise reader.broken(self._at(keys, wrong, entry), f"a job cannot {wrong}", "it can read, write or report")
        channel, host = self._host(keys, entry, section)
        model = self._model(channel, section)
        count = reader.maybe(reader.number, keys.get("count"))
        if count is not None and count < 1:
            reader.note(self._at(keys, "count", entry), f"a count of {count} moves nothing", "give 1 or more")
        count = max(1, 1 if count is None else count)
        unit = reader.maybe(reader.text, keys.get("type"))
        own_key = {"read": "into", "write": "from", "report": "report"}[kind]
        own = keys.get(own_key)
        if own is None:
            does = "go" if kind == "read" else "come from"
            what = f"the block does not say where its data {does}"
            raise reader.broken(entry.key.at, what, f"add {own_key}: with an address of the own memory")
        remote = "" if kind == "report" else reader.text(keys.get(kind))
        found = self._unit(remote, unit, count, model, keys.get(kind), kind) or unit
        bits = 1 if found is None else unit_bits(found) * count
        place = (self.places.written if kind == "read" else self.places.place)(own, bits=bits)
        found = found or place.address.unit
        most = profile.lengths.get(found)
        if most is not None and count > most:
            what = f"{count} {found}s are too many for one transfer"
            reader.note(self._at(keys, "count", entry), what, f"{most} are the most")
        return Order(
            slot=slot,
            kind=kind,
            place=place,
            remote=remote,
            unit=unit if remote else found,
            count=count,
            host=host,
            channel=channel if not host else None,
            station=self._station(keys, model),
            **self._times(keys, entry, profile),
        )

    def _at(self, keys: MappingNode, key: str, entry: Entry) -> Any:
        node = keys.get(key)
        return entry.key.at if node is None else node.at

    def _unit(
        self, remote: str, unit: str | None, count: int, model: Channel | None, node: Node | None, kind: str
    ) -> str | None:
        """Return the unit of the transferred elements, or None if the protocol of the host is not known."""
        if model is None or not remote or node is None:
            return None
        protocol = model.protocol
        if kind not in protocol.services:
            self.reader.note(node.at, f"'{protocol.name}' has no service {kind}", "name another channel")
            return None
        grammar = AddressGrammar(protocol.addresses, protocol.areas, protocol.tables)
        try:
            address = grammar.parse(remote, unit)
            grammar.check(address, count)
        except AddressError as error:
            self.reader.note(node.at, *parted(error))
            return None
        if kind == "write" and protocol.areas[address.area].access == "read":
            self.reader.note(node.at, f"area '{address.area}' can only be read", "write to another area")
        return unit or address.unit

    def _model(self, channel: int | None, section: JobsSection) -> Channel | None:
        """Return the channel of the run, or the template of channels that are opened for hosts without a channel."""
        if channel is not None:
            return self.channels[channel]
        return None if section.opening is None else section.opening.channel

    def _host(self, keys: MappingNode, entry: Entry, section: JobsSection) -> tuple[int | None, str]:
        """Return the number of the channel, if the run knows it at load time, and the host as written."""
        node, named = keys.get("host"), keys.get("channel")
        if node is not None and named is not None:
            self.reader.note(named.at, "the host says which channel it is", "leave channel out")
        if node is not None:
            host = self.reader.text(node)
            address = section.hosts.get(host, host)
            number = channel_to(host, self.channels)
            number = channel_to(address, self.channels) if number is None else number
            if number is None and is_address(address) and section.opening is None:
                self.reader.warn(node.at, f"no channel leads to {address}", "add host: to a channel, or open: to jobs")
            return number, host
        if named is not None:
            number = read_channel_number(self.reader, named, self.known)
            if number not in self.channels:
                if str(number) in self.known:
                    raise Broken("the problems of the channel have been reported")
                hint = did_you_mean(str(number), self.known)
                raise self.reader.broken(named.at, f"there is no channel {number}", hint)
            return number, ""
        if len(self.channels) == 1:
            return next(iter(self.channels)), ""
        what = f"block {entry.key.text} does not say which host it talks to"
        raise self.reader.broken(entry.key.at, what, "add host:, or channel:")

    def _station(self, keys: MappingNode, model: Channel | None) -> Any:
        node = keys.get("station")
        if model is None:
            return None if node is None else self.reader.constant(node)
        return model.station if node is None else read_station(self.reader, node, model.protocol)

    def _times(self, keys: MappingNode, entry: Entry, profile: JobProfile) -> dict[str, Any]:
        reader = self.reader
        period = reader.maybe(reader.time, keys.get("every")) or 0
        at = self._at(keys, "every", entry)
        if period >= NEVER:
            reader.note(at, "never is no period", "leave every out, or give a time such as 1 s")
        elif (wrong := profile.mismatch_period(period)) is not None:
            units = ", ".join(f"{format_time(unit.time)} (at most {unit.most})" for unit in profile.units.values())
            reader.note(at, f"a period of {format_time(period)} {wrong}", f"periods count {units}")
        late = reader.maybe(reader.time, keys.get("late")) or 0
        at = self._at(keys, "late", entry)
        most = profile.late_unit * profile.late_most
        if late % profile.late_unit or late > most:
            what = f"a time-out of {'never' if late >= NEVER else format_time(late)} cannot be counted"
            reader.note(at, what, f"give a multiple of {format_time(profile.late_unit)}, at most {format_time(most)}")
        elif 0 < period < late:
            reader.warn(at, "the period is over before the time-out", "leave late out: a period that is over is told")
        times = reader.maybe(reader.number, keys.get("times")) or 0
        if not 0 <= times <= MOST_TIMES:
            reader.note(
                self._at(keys, "times", entry), f"{times} transfers cannot be counted", f"give 0 to {MOST_TIMES}"
            )
        return {"period": period, "late": late, "times": times}
