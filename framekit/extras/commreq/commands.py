"""Command blocks from Python: made from words and names, explained, and the own memory that they work on."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from framekit.api.errors import RequestError
from framekit.api.settings import ClientSettings
from framekit.codec.errors import EncodeError
from framekit.codec.plain import PlainValues, with_hint
from framekit.definition.load.reader import parse_number
from framekit.definition.model.frames import parts_of
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.services import JobWork
from framekit.definition.problems import Position, did_you_mean, no_such
from framekit.extras.commreq.command_meaning import Meaning as Meaning
from framekit.extras.commreq.command_meaning import meaning_of
from framekit.extras.commreq.job_profiles import load_job_profile
from framekit.extras.commreq.jobs import JobLine as JobLine
from framekit.link.addresses import Address, AddressError
from framekit.link.conversation import default_line
from framekit.link.events import Monitor
from framekit.link.packing import values_of
from framekit.link.scope import Scope
from framekit.link.services.areas import Span as Span
from framekit.memory.memory import DeviceMemory, DeviceMemoryError, unit_bits
from framekit.run.commands import CommandBlocks as CommandBlocks
from framekit.run.commands import CommandEnd as CommandEnd
from framekit.run.commands import CommandFaultError as CommandFaultError
from framekit.run.commands import CommandWords, bytes_of
from framekit.run.model import JobProfile as JobProfile
from framekit.run.status import JobStatus as JobStatus
from framekit.runfile.blocks import commands_for
from framekit.runfile.devices import memory_of
from framekit.transport.clock import AsyncioClock


def application_of(protocol: Protocol, name: str | None, asked: str) -> Protocol:
    """Return an application of commands: the named one, else that of the protocol `asked`. Raises DefinitionError."""
    return commands_for(protocol, name, Path.cwd(), Position(asked, 0, 0))


def has_jobs(application: Protocol) -> bool:
    """Return whether its commands control jobs, which repeat by themselves."""
    return any(parts_of(dict(application.services), JobWork))


def profile_of(application: Protocol) -> JobProfile:
    """Return the profile of its jobs. Raises DefinitionError."""
    return load_job_profile(application.name, Path.cwd(), Position(application.name, 1, 1))


def blocks_of(application: Protocol, protocol: Protocol | None, role: str | None) -> CommandBlocks:
    """Return command blocks over an empty memory, on an idle port that speaks `protocol`."""
    areas, _ = memory_of(application)
    scope = None
    if protocol is not None:
        scope = Scope(protocol, role=role or protocol.asking_role, line=default_line(protocol))
    return CommandBlocks(application, DeviceMemory(areas), channel=scope)


def blocks_on(line: JobLine) -> CommandBlocks:
    """Return command blocks over the memory of a line of jobs."""
    return CommandBlocks(line.application, line.memory)


def meaning_in(blocks: CommandBlocks, protocol: Protocol, data: bytes, *, validate: bool = True) -> Meaning:
    """Return the meaning of the command that begins with these bytes. Raises CommandFaultError if there is no command.

    `validate` also checks whether an idle port would refuse it.
    """
    return meaning_of(blocks.words.read(data), blocks, protocol, validate=validate)


class CommandMemory:
    """The own memory that commands work on, by the addresses of their application. It begins with zeros."""

    def __init__(self, blocks: CommandBlocks, protocol: Protocol) -> None:
        self.blocks = blocks
        self.protocol = protocol
        self.memory: DeviceMemory = blocks.areas.memory
        self.grammar = blocks.server.shared.grammar

    def put(self, address: str, values: str) -> None:
        """Write values separated by commas from an address on. Raises RequestError."""
        try:
            place = self.grammar.parse(address)
            numbers = [parse_number(value) for value in values.split(",")]
            self.memory.area(place.area).write_from(place.first_bit, place.unit, numbers, force=True)
        except (ValueError, DeviceMemoryError) as error:
            raise RequestError(str(error)) from None

    def content(self) -> dict[str, bytes]:
        """Return a copy of the memory."""
        return self.memory.snapshot()

    def meaning(self, data: bytes) -> tuple[Meaning, Span]:
        """Return the meaning of a command, and the place of its status word. Raises CommandFaultError."""
        meaning = meaning_in(self.blocks, self.protocol, data, validate=False)
        try:
            return meaning, self.blocks.status_place(self.blocks.words.read(data))
        except DeviceMemoryError as error:
            raise CommandFaultError(str(error)) from None

    def changes(self, before: Mapping[str, bytes], status: Span | None = None) -> dict[str, list[int]]:
        """Return the changed elements: the address of the first of each run, with the values from there on.

        The status word is a run by itself.
        """
        found: dict[str, list[int]] = {}
        word = {} if status is None else {status.memory: (status.start, status.start + status.count)}
        for area in self.memory:
            now = area.read_bytes(0, area.size_bytes)
            if now == before[area.name]:
                continue
            count = len(now) * 8 // unit_bits(area.unit)
            old, new = values_of(before[area.name], area.unit, count), values_of(now, area.unit, count)
            last = -2
            values: list[int] = []
            for place in (place for place in range(count) if old[place] != new[place]):
                if place != last + 1 or place in word.get(area.name, ()):
                    values = found.setdefault(self._address(area.name, area.unit, place), [])
                values.append(new[place])
                last = place
        return found

    def addresses(self, span: Span) -> set[str]:
        """Return the addresses of all elements of a place."""
        return {self._address(span.memory, span.unit, place) for place in range(span.start, span.start + span.count)}

    def _address(self, area: str, unit: str, place: int) -> str:
        """Return a place of the own memory as the application writes it, in words if no form fits."""
        address = Address(area, unit, place)
        try:
            return self.grammar.print(address) if area in self.grammar.areas else str(address)
        except AddressError:
            return str(address)


def record_of(words: CommandWords, plain: Sequence[str], fields: dict[str, object]) -> bytes:
    """Return the command block from words: all its words, those from the command on, or a command with named fields.

    Fields of the head may be given in addition. Raises ValueError.
    """
    head = {name: fields.pop(name) for name in list(fields) if name in words.head()}
    if len(plain) == 1 and not plain[0].lstrip("-")[:1].isdigit():
        return _named(words, plain[0], fields, head)
    if fields:
        name = next(iter(fields))
        hint = did_you_mean(name, words.head())
        raise ValueError(
            f"'{name}' is no field beside words – name the command instead of its number"
            + (f"; {hint}" if hint else "")
        )
    if not plain:
        raise ValueError("there are no words – give them, or the name of a command")
    return _numbered(words, plain, head)


def _named(words: CommandWords, name: str, fields: dict[str, object], head: dict[str, object]) -> bytes:
    """Return a command by its name. Raises ValueError."""
    if name not in words.requests:
        raise ValueError(no_such(f"'{words.application.name}' has no command", name, words.requests))
    try:
        return words.make(name, fields, head)
    except EncodeError as error:
        raise ValueError(f"{name}: {with_hint(error, words.application, name, fields, words.head())}") from None


def _numbered(words: CommandWords, texts: Sequence[str], head: dict[str, object]) -> bytes:
    """Return a whole block, or the words of a block from the command on. Raises ValueError."""
    data = bytes_of([parse_number(text) for text in texts])
    try:
        block = words.read(data)
        is_whole = len(block.raw) == len(data)
    except CommandFaultError:
        is_whole = False
    if is_whole:
        if not head:
            return data
        own = {name: block.block.fields[name] for name in words.head() if name != words.length}
        head, data = {**own, **head}, data[words.head_size :]
    elif not words.is_known(data) and (mismatch := words.head_mismatch(data)):
        raise ValueError(f"{mismatch} – correct the head, or leave it out")
    request, values = words.read_request(data)
    return words.make(request, PlainValues(words.application).to_plain(request, values), head)


def line_of_jobs(
    application: Protocol, profile: JobProfile, settings: ClientSettings, monitor: Monitor | None,
    closed: Callable[[str], None],
) -> JobLine:  # fmt: skip
    """Return jobs over a line, in the running loop; `closed` gets the reason of a closed connection."""
    clock = AsyncioClock(asyncio.get_running_loop())
    return JobLine(application, profile, settings.channel(), clock, monitor, closed)
