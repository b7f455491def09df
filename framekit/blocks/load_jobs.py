"""Reads the blocks of a run that establish, abort and inspect jobs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from framekit.blocks.given import read_station
from framekit.blocks.jobs.order import Command, CommandKind, Kind, Order, Record
from framekit.blocks.jobs.profile import JobProfile
from framekit.blocks.jobs.section import JobsSection, channel_to, is_address
from framekit.blocks.model import Channel, Place
from framekit.blocks.own_places import read_place
from framekit.definition.load.reader import Broken, Reader
from framekit.definition.nodes import Entry, Node
from framekit.definition.nodes import Mapping as MappingNode
from framekit.definition.times import NEVER, format_time
from framekit.link.addresses import AddressError, AddressGrammar
from framekit.memory.memory import unit_bits

COMMANDS: tuple[CommandKind, ...] = ("job", "abort", "inspect")
ALL = "all"
MOST_TIMES = 0xFFFF

_KINDS: dict[str, Kind] = {"read": "read", "write": "write", "report": "report"}


class JobBlockLoader:
    """Reads commands to jobs. `grammar` reads addresses of the own memory."""

    def __init__(
        self,
        reader: Reader,
        grammar: AddressGrammar,
        channels: Mapping[int, Channel],
        section: JobsSection | Literal["wrong"] | None,
    ) -> None:
        self.reader = reader
        self.grammar = grammar
        self.channels = channels
        self.section = section

    def command(self, keys: MappingNode, entry: Entry, number: int) -> Command:
        """The command of a block. Raises Broken when anything of it is wrong, after all of it has been looked at."""
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
        status = self._word(keys.get("status"), 1)
        into = self._word(keys.get("into"), 2) if kind == "inspect" else None
        order = None
        with self.reader.going_on():
            if kind == "job":
                order = self._order(slot or profile.first, keys, entry, self.section)
            elif kind == "inspect" and keys.get("into") is None:
                what = "the block does not say where the detail words go"
                self.reader.note(entry.key.at, what, "add into: with an address of the own memory")
        if any(not problem.warning for problem in self.reader.problems[before:]):
            raise Broken(entry.key.text)
        return Command(kind=kind, slot=slot, order=order, status=status, into=into, id=number)

    @property
    def reads_records(self) -> bool:
        """Whether the jobs of the run take commands whose words stand in memory."""
        return isinstance(self.section, JobsSection) and self.section.commands is not None

    def record(self, keys: MappingNode, number: int) -> Record:
        """The command of a block whose words stand in memory. Raises Broken."""
        section = self.section
        assert isinstance(section, JobsSection) and section.commands is not None
        node, fault = keys.get("command"), keys.get("fault")
        assert node is not None
        return Record(
            place=read_place(self.reader, self.grammar, node, 16),
            application=section.commands,
            fault=None if fault is None else read_place(self.reader, self.grammar, fault, 1, written=True),
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

    # ---- places -------------------------------------------------------------------------------------------

    def _word(self, node: Node | None, words: int) -> Place | None:
        """A place to write, with room for so many words; None for none, and for one that is wrong."""
        with self.reader.going_on():
            return None if node is None else read_place(self.reader, self.grammar, node, 16 * words, written=True)
        return None

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
        place = read_place(reader, self.grammar, own, bits, written=kind == "read")
        found = found or place.address.unit
        most = profile.lengths.get(found)
        if most is not None and count > most:
            what = f"{count} {found}s are too many for one transfer"
            reader.note(self._at(keys, "count", entry), what, f"{most} are the most")
        return Order(
            slot=slot,
            kind=_KINDS[kind],
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
        """The unit of what is moved, where the protocol that is spoken there is known."""
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
            what, _, todo = str(error).partition(" – ")
            self.reader.note(node.at, what, todo)
            return None
        if kind == "write" and protocol.areas[address.area].access == "read":
            self.reader.note(node.at, f"area '{address.area}' can only be read", "write to another area")
        return unit or address.unit

    def _model(self, channel: int | None, section: JobsSection) -> Channel | None:
        """The channel as the run says it, or what is opened for a host without one."""
        if channel is not None:
            return self.channels[channel]
        return None if section.opening is None else section.opening.channel

    def _host(self, keys: MappingNode, entry: Entry, section: JobsSection) -> tuple[int | None, str]:
        """The channel, if the run knows it now, and the host as it is written."""
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
            number = self.reader.number(named)
            if number not in self.channels:
                known = ", ".join(map(str, self.channels))
                raise self.reader.broken(named.at, f"there is no channel {number}", f"known: {known}")
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
        elif (wrong := profile.misfit_period(period)) is not None:
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
