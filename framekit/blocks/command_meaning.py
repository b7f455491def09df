"""What a command block means, in words: its fields, the places on both sides, the service it calls. Nothing is done.

Places of the other side are written as its protocol writes addresses, those of the own memory as the application does.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from framekit.blocks.command_words import Command, words_of
from framekit.blocks.commands import CommandBlocks
from framekit.codec.plain import PlainValues
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.segments import Field
from framekit.definition.model.walk import flat
from framekit.definition.times import format_time
from framekit.link.addresses import Address, AddressError, AddressGrammar
from framekit.link.evaluate import EVALUATION_ERRORS, Names
from framekit.link.services.areas import address_of, codes_of
from framekit.link.services.matching import RefusedError
from framekit.link.services.work import CompiledBlock, CompiledJob
from framekit.link.values import plain
from framekit.memory.memory import DeviceMemoryError, unit_bits


@dataclass(frozen=True, slots=True, kw_only=True)
class Meaning:
    """A command in words. `names` are the names of its numbers, by field; `does` one line for each thing it does.

    `refused`: the status word of a refusal as things stand now, else 0; `because` is its name.
    """

    words: list[int]
    request: str
    head: Mapping[str, Any]
    fields: Mapping[str, Any]
    names: Mapping[str, str]
    does: list[str]
    status: str
    refused: int
    because: str


def meaning_of(command: Command, blocks: CommandBlocks, channel: Protocol, *, judge: bool = True) -> Meaning:
    """What a command means on a channel that speaks `channel`; without `judge` not whether it would be refused."""
    application = blocks.words.application
    show = PlainValues(application)
    fields = plain(command.request.fields)
    head = {name: value for name, value in plain(command.block.fields).items() if name in blocks.words.head()}
    speaks = _Speaks(blocks, channel)
    try:
        block, names = blocks.server.asked(command.request, blocks.names_of(command))
        does = [] if block is None else list(speaks.lines(block, names))
    except (RefusedError, DeviceMemoryError, *EVALUATION_ERRORS):
        does = []
    refused = blocks.plan(command)[0] if judge else 0
    return Meaning(
        words=words_of(command.raw),
        request=command.request.frame,
        head=head,
        fields=show.to_plain(command.request.frame, fields),
        names=_number_names(application, command.request.frame, fields),
        does=does,
        status=speaks.own(blocks.status_words(command)),
        refused=refused,
        because=blocks.meaning(refused) if refused else "",
    )


def _number_names(application: Protocol, frame: str, fields: Mapping[str, Any]) -> dict[str, str]:
    """The names of the numbers of a frame, where they have any."""
    found = {}
    for segment in flat(application.frames[frame].segments):
        if isinstance(segment, Field) and segment.values and fields.get(segment.name) in segment.values:
            found[segment.name] = segment.values[fields[segment.name]]
    return found


class _Speaks:
    """Writes places and exchanges down."""

    def __init__(self, blocks: CommandBlocks, channel: Protocol) -> None:
        self.blocks = blocks
        self.there = AddressGrammar(channel.addresses, channel.areas, channel.tables)
        self.codes = codes_of(channel)
        self.here = blocks.server.shared.grammar

    def lines(self, block: CompiledBlock, names: Names) -> Iterator[str]:
        session = "" if block.session is None else block.session(names)
        if session:
            yield (
                "closes the session" if session == "end" else "closes the session, if one is open, and opens a new one"
            )
        station = None if block.station is None else block.station(names)
        if block.station is not None:
            yield f"other side: {station.hex(' ').upper() if isinstance(station, bytes) else station!r}"
        for word, place, own, between in (
            ("reads", block.read, block.into, "into"),
            ("writes", block.write, block.source, "from"),
        ):
            if place is None:
                continue
            given = place.where(names)
            line = f"{word} {self.other(given)}"
            yield line if own is None else f"{line} {between} the own {self.own(own.on(names))}"
        if block.job is not None:
            yield _job(block.job, names)
            if block.job.report is not None:
                yield f"reports the own {self.own(block.job.report.where(names))}"
            if block.job.kind == "inspect" and block.into is not None:
                yield f"stores two words from the own {self.own(block.into.on(names))} on"
        for service, arguments in block.calls:
            yield f"calls {service}" + "".join(f" {name}={_value(arguments[name], names)}" for name in arguments)
        for after in block.then:
            if after.store is not None:
                yield f"stores what it brings from the own {self.own(after.store.where(names))} on"

    def other(self, given: Mapping[str, Any]) -> str:
        """A place of the other side."""
        try:
            return _with_count(self.there, address_of(self.there, self.codes, given), given.get("count"))
        except (DeviceMemoryError, AddressError) as error:
            return f"a place that is not there ({error})"

    def own(self, given: Mapping[str, Any]) -> str:
        """A place of the own memory."""
        try:
            address = address_of(self.here, self.blocks.server.codes, given)
        except (DeviceMemoryError, AddressError) as error:
            return f"place that is not there ({error})"
        return _with_count(self.here, address, given.get("count"))


def _with_count(grammar: AddressGrammar, address: Address, count: Any) -> str:
    try:
        text = grammar.print(address)
        if unit_bits(address.unit) != unit_bits(grammar.areas[address.area].unit):
            raise AddressError(text)
    except AddressError:
        text = f"{address.unit} {address.start} of {address.area}"
    return text if count in (None, 1) else f"{text} ({count} × {address.unit})"


def _job(job: CompiledJob, names: Names) -> str:
    """A command to jobs: which slot, and how often the transfer is repeated."""
    slot = job.slot(names)
    if job.kind != "job":
        return f"{job.kind}s " + ("all jobs" if slot == "all" else f"the job in slot {slot}")
    every, late, times = (0 if one is None else int(one(names)) for one in (job.every, job.late, job.times))
    line = f"as the job in slot {slot}"
    if job.host is not None:
        line += f", with {job.host(names)}"
    line += f", every {format_time(every)}" if every else ", back to back"
    line += f", {times} times" if times else ", until it is aborted"
    return line + (f", late after {format_time(late)}" if late else "")


def _value(compute: Any, names: Names) -> str:
    try:
        value = compute(names)
    except EVALUATION_ERRORS:
        return "…"
    return value.hex(" ").upper() if isinstance(value, bytes) else str(value)
