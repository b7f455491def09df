"""Command blocks explained in words: places, exchanges and refusals. No exchange takes place here."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from framekit.codec.plain import PlainValues
from framekit.definition.model.frames import flat
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.segments import Field
from framekit.definition.times import format_time
from framekit.link.addresses import Address, AddressError, AddressGrammar
from framekit.link.services.areas import address_of, codes_of
from framekit.link.services.matching import RefusedMatchError
from framekit.link.services.work import CompiledBlock, CompiledJob
from framekit.link.values import EVALUATION_ERRORS, Names, plain
from framekit.memory.memory import DeviceMemoryError, unit_bits
from framekit.run.commands import CommandBlocks, CommandFrame, words_of


@dataclass(frozen=True, slots=True, kw_only=True)
class Meaning:
    """An explained command. `names`: names of its numbers, by field; `does`: a line for each action.

    `refused`: the status word of a refusal in the present state, else 0; `because` is its meaning.
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


def meaning_of(command: CommandFrame, blocks: CommandBlocks, channel: Protocol, *, validate: bool = True) -> Meaning:
    """Return the meaning of a command on a channel that speaks `channel`; `validate` also checks for refusals."""
    application = blocks.words.application
    show = PlainValues(application)
    fields = plain(command.request.fields)
    head = {name: value for name, value in plain(command.block.fields).items() if name in blocks.words.head()}
    speaks = _Speaks(blocks, channel)
    try:
        block, names = blocks.server.asked(command.request, blocks.names_of(command))
        does = [] if block is None else list(speaks.lines(block, names))
    except (RefusedMatchError, DeviceMemoryError, *EVALUATION_ERRORS):
        does = []
    refused = blocks.plan(command)[0] if validate else 0
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
    """Return the names of the numbers of a frame, for fields that have names."""
    found = {}
    for segment in flat(application.frames[frame].segments):
        if isinstance(segment, Field) and segment.values and fields.get(segment.name) in segment.values:
            found[segment.name] = segment.values[fields[segment.name]]
    return found


class _Speaks:
    """Describe places and exchanges in text."""

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
        for word, place in (("sends", block.source), ("fills", block.into)):
            if place is not None and block.calls:
                yield f"{word} the own {self.own(place.where(names))}"
        for after in block.then:
            if after.store is not None:
                yield f"stores what it brings from the own {self.own(after.store.where(names))} on"

    def other(self, given: Mapping[str, Any]) -> str:
        """Return the text of a place of the other side."""
        try:
            return _with_count(self.there, address_of(self.there, self.codes, given), given.get("count"))
        except (DeviceMemoryError, AddressError) as error:
            return f"a place that is not there ({error})"

    def own(self, given: Mapping[str, Any]) -> str:
        """Return the text of a place of the own memory; areas in the words of the memory have no address form."""
        if "memory" in given:
            unit, count = given.get("unit") or "element", given.get("count")
            text = f"{unit} {given.get('start', 0)} of {given['memory']}"
            return text if count in (None, 1) else f"{text} ({count} × {unit})"
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
    """Return the text of a command to jobs: the slot, and the repetition of the transfer."""
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
