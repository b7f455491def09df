"""The verb for command blocks: words, or a command with named fields, are explained, or carried out on a port.

Exit status: 0 done, 1 refused, 2 it is no command block, 3 no good answer came. Commands that establish, abort and
inspect jobs are carried out until their jobs are over: each is given when the one before has its status word, and
every transfer of the jobs is shown as it ends.
"""

from __future__ import annotations

import argparse
import asyncio
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from framekit.cli.common import VerbError, WordsError, assignment, duration_of, load, print_json, why_not
from framekit.cli.device_verbs import add_line, carry_out
from framekit.codec.shown import code_text
from framekit.definition.model.walk import parts_of

if TYPE_CHECKING:
    from framekit.api.client import Client
    from framekit.api.settings import ClientSettings
    from framekit.definition.model.protocol import Protocol
    from framekit.link.addresses import AddressGrammar
    from framekit.link.services.areas import Span
    from framekit.memory.memory import DeviceMemory
    from framekit.run.block_state import Failure
    from framekit.run.commands import CommandBlocks, CommandEnd, CommandWords, Meaning
    from framekit.run.job_profile import JobProfile
    from framekit.run.job_table import JobStatus
    from framekit.service.jobs import JobLine


NO_COMMAND = 2
"""Exit status when the words are no command block."""

FAULT, REFUSED, NO_ANSWER = 2, 1, 3
"""Exit statuses: no command block, refused by the port or the device, no good answer came."""

JUDGED = ("refused", "no_such_place", "no_own_place", "cannot_send", "cannot_store", "not_allowed")
"""Outcomes of commands that were answered, or that nothing was sent for."""


def add_commreq_arguments(parser: argparse.ArgumentParser) -> None:
    add_line(parser, port_required=False)
    parser.add_argument(
        "words",
        nargs="+",
        metavar="WORD",
        help="decimal, 0x… or @FILE; or the name of a command, and FIELD=VALUE …; + and the next command",
    )
    parser.add_argument("--commands", metavar="NAME", help="the application of commands; default: the protocol's")
    parser.add_argument(
        "--set", action="append", default=[], metavar="ADDRESS=VALUE,…", help="own memory; may be repeated"
    )
    parser.add_argument(
        "--for",
        dest="duration",
        metavar="TIME",
        help="end jobs after this time; default: when they are over",
    )
    parser.add_argument("--explain", action="store_true", help="only say what the words mean, as without --port")


def run_commreq(arguments: argparse.Namespace) -> int:
    from framekit.definition.problems import Position
    from framekit.runfile.blocks import commands_for

    protocol = load(arguments.protocol)
    at = Position(arguments.protocol, 0, 0)
    application = commands_for(protocol, arguments.commands, Path.cwd(), at)
    blocks = _blocks(application, protocol, arguments)
    try:
        records = [record_of(blocks.words, given) for given in commands_in(arguments.words)]
    except ValueError as error:
        print(f"framekit {arguments.verb}: {error}", file=sys.stderr)
        return NO_COMMAND
    if arguments.port is None or arguments.explain:
        return max(explain(blocks, protocol, data, arguments) for data in records)
    return _carry_out(application, protocol, records, arguments)


def _carry_out(application: Protocol, protocol: Protocol, records: list[bytes], arguments: argparse.Namespace) -> int:
    """Carries the commands out until one fails; the exit status."""
    from framekit.definition.model.services import JobWork

    if any(parts_of(dict(application.services), JobWork)):
        return carry_out_jobs(application, protocol, records, arguments)
    if arguments.duration is not None:
        raise WordsError("--for is for commands that repeat by themselves – leave it out")

    status = 0

    def act(client: Client) -> None:
        nonlocal status
        commands = CommandRun(client, client.command_blocks(application), arguments)
        for data in records:
            status = commands.carry_out(data)
            if status:
                return

    return carry_out(arguments, act, to_station=False) or status


def _blocks(application: Protocol, protocol: Protocol, arguments: argparse.Namespace) -> CommandBlocks:
    """Command blocks on a port that has done nothing yet, over an empty memory."""
    from framekit.codec.codec import compile_protocol
    from framekit.link.frame_vectors import default_line
    from framekit.link.scope import Scope
    from framekit.memory.memory import DeviceMemory
    from framekit.run.commands import CommandBlocks
    from framekit.runfile.devices import memory_of

    role = arguments.role or protocol.asking_role
    channel = Scope(protocol, role=role, line=default_line(protocol))
    areas, _ = memory_of(application)
    return CommandBlocks(application, compile_protocol(application), DeviceMemory(areas), channel=channel)


# ---- explaining -------------------------------------------------------------------------------------------


def explain(blocks: CommandBlocks, protocol: Protocol, data: bytes, arguments: argparse.Namespace) -> int:
    """Says what a command block means; the exit status."""
    from framekit.run.commands import CommandFaultError, meaning_of

    try:
        meaning = meaning_of(blocks.words.read(data), blocks, protocol)
    except CommandFaultError as error:
        print(f"framekit {arguments.verb}: this is no command block: {error}", file=sys.stderr)
        return NO_COMMAND
    if arguments.json:
        print_json(_meaning_as_json(meaning))
    else:
        print("\n".join(_lines(meaning)))
    return 0


def _meaning_as_json(meaning: Meaning) -> dict[str, Any]:
    return {
        "words": meaning.words, "command": meaning.request, "head": meaning.head, "fields": meaning.fields,
        "does": meaning.does, "status": meaning.status, "refused": meaning.refused, "because": meaning.because,
    }  # fmt: skip


def command_line(meaning: Meaning) -> str:
    """The command with its fields."""
    shown = [
        f"{name} {value}" + (f" ({meaning.names[name]})" if name in meaning.names else "")
        for name, value in meaning.fields.items()
    ]
    return f"command  {meaning.request}: " + ", ".join(shown)


def _lines(meaning: Meaning) -> list[str]:
    lines = ["words    " + " ".join(f"{word:04X}" for word in meaning.words), command_line(meaning)]
    lines += [f"{'' if number else 'does':<9}{line}" for number, line in enumerate(meaning.does)]
    lines.append(f"status   {meaning.status}")
    if meaning.refused:
        lines.append(
            f"refused  {code_text(meaning.refused)} {meaning.because}, by a port that has done nothing yet".rstrip()
        )
    return lines


def commands_in(words: list[str]) -> list[list[str]]:
    """The words of each command, with those of files in place of @FILE; + stands between two. Raises VerbError."""
    found: list[list[str]] = [[]]
    for given in words:
        for word in _words_of(given[1:]) if given.startswith("@") else [given]:
            if word == "+":
                found.append([])
            else:
                found[-1].append(word)
    return found


def _words_of(file: str) -> list[str]:
    """The words in a file, in which # begins a remark. Raises VerbError."""
    try:
        lines = Path(file).read_text(encoding="utf-8").splitlines()
    except FileNotFoundError:
        raise WordsError(f"@{file}: there is no such file – check its name and folder") from None
    except OSError as error:
        raise VerbError(f"@{why_not(error)}") from None
    except UnicodeDecodeError:
        raise VerbError(f"@{file}: this is no text – write words with blanks between them") from None
    return [word for line in lines for word in line.partition("#")[0].replace(",", " ").split()]


def record_of(words: CommandWords, given: list[str]) -> bytes:
    """The command block that is meant: all its words, those from the command on, or a command with named fields.

    Fields of the words before the command may be given beside either. Raises ValueError.
    """
    from framekit.definition.problems import did_you_mean

    plain = [text for text in given if "=" not in text]
    fields = dict(assignment(text) for text in given if "=" in text)
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
    """A command by its name. Raises ValueError."""
    from framekit.codec.encode_hints import with_hint
    from framekit.codec.errors import EncodeError
    from framekit.definition.problems import did_you_mean

    if name not in words.requests:
        hint = did_you_mean(name, words.requests)
        raise ValueError(f"'{words.application.name}' has no command '{name}'" + (f" – {hint}" if hint else ""))
    try:
        return words.make(name, fields, head)
    except EncodeError as error:
        raise ValueError(f"{name}: {with_hint(error, words.application, name, fields, words.head())}") from None


def _numbered(words: CommandWords, texts: list[str], head: dict[str, object]) -> bytes:
    """A whole block, or the words of one from the command on. Raises ValueError."""
    from framekit.codec.plain import PlainValues
    from framekit.definition.load.reader import parse_number
    from framekit.run.commands import CommandFaultError, bytes_of

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
    elif not words.is_known(data) and (misfit := words.head_misfit(data)):
        raise ValueError(f"{misfit} – correct the first word, or leave the head out")
    request, values = words.read_request(data)
    return words.make(request, PlainValues(words.application).to_plain(request, values), head)


class CommandOutput:
    """What commands do to an own memory, printed. `memory` begins with zeros and what --set puts there."""

    def __init__(self, blocks: CommandBlocks, protocol: Protocol, arguments: argparse.Namespace) -> None:
        self.blocks = blocks
        self.protocol = protocol
        self.arguments = arguments
        self.memory: DeviceMemory = blocks.areas.memory
        self.grammar: AddressGrammar = blocks.server.shared.grammar
        for text in arguments.set:
            self._put(text)

    def _put(self, text: str) -> None:
        """A start value of the own memory. Raises WordsError."""
        from framekit.definition.load.reader import parse_number
        from framekit.memory.memory import DeviceMemoryError

        address, values = assignment(text)
        try:
            place = self.grammar.parse(address)
            numbers = [parse_number(value) for value in str(values).split(",")]
            self.memory.write(place.area, place.unit, place.start, numbers, force=True)
        except (ValueError, DeviceMemoryError) as error:
            raise WordsError(f"--set {text}: {error}") from None

    def content(self) -> dict[str, bytes]:
        """The memory as it is now."""
        return {area.name: area.read_bytes(0, area.size_bytes) for area in self.memory}

    def meaning(self, data: bytes) -> tuple[Meaning, Span]:
        """What a command means, and the place of its status word. Raises CommandFaultError, DeviceMemoryError."""
        from framekit.run.commands import meaning_of

        command = self.blocks.words.read(data)
        return meaning_of(command, self.blocks, self.protocol, judge=False), self.blocks.status_place(command)

    def fault(self, why: str) -> int:
        """Tells that words are no command; the exit status."""
        print(f"framekit {self.arguments.verb}: this is no command block: {why}", file=sys.stderr)
        return FAULT

    def show(self, meaning: Meaning, place: Span, end: CommandEnd, before: dict[str, bytes]) -> None:
        """How a command ended, with what it changed."""
        changes = self.changes(before, place)
        if self.arguments.json:
            print_json(_as_json(meaning, end, changes))
            return
        word = {self._address(place.memory, place.unit, one) for one in _places(place)}
        self._print(meaning, end, {address: changes[address] for address in changes if address not in word})

    def _print(self, meaning: Meaning, end: CommandEnd, changes: dict[str, list[int]]) -> None:
        print(command_line(meaning))
        for number, line in enumerate(meaning.does):
            print(f"{'' if number else 'does':<9}{line}")
        self.show_changes(changes)
        failed = "" if end.failure is None or end.failure.outcome == "refused" else f" ({end.failure.outcome})"
        print(f"status   {meaning.status} = {code_text(end.status)} {end.meaning}".rstrip() + failed)

    def show_changes(self, changes: dict[str, list[int]]) -> None:
        """What is otherwise in the memory."""
        for address, values in changes.items():
            print(f"{address:<8} {' '.join(map(str, values))}", flush=True)

    def changes(self, before: dict[str, bytes], status: Span | None = None) -> dict[str, list[int]]:
        """The elements that are others now: the address of the first of each run, with the values from there on.

        The status word is a run by itself.
        """
        from framekit.link.packing import values_of
        from framekit.memory.memory import unit_bits

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

    def _address(self, area: str, unit: str, place: int) -> str:
        """A place of the own memory as the application writes it; in words where it has no form for that."""
        from framekit.link.addresses import Address, AddressError

        address = Address(area, unit, place)
        try:
            return self.grammar.print(address) if area in self.grammar.areas else str(address)
        except AddressError:
            return str(address)


class CommandRun:
    """The commands of one call: they share the line, the session and the memory."""

    def __init__(self, client: Client, blocks: CommandBlocks, arguments: argparse.Namespace) -> None:
        self.client = client
        self.blocks = blocks
        self.output = CommandOutput(blocks, client.protocol, arguments)

    def carry_out(self, data: bytes) -> int:
        """Carries a command out and prints what came of it; the exit status."""
        from framekit.memory.memory import DeviceMemoryError
        from framekit.run.commands import CommandFaultError

        try:
            meaning, place = self.output.meaning(data)
        except (CommandFaultError, DeviceMemoryError) as error:
            return self.output.fault(str(error))
        before = self.output.content()
        end = self.client.command(self.blocks, data)
        if end.fault:
            return self.output.fault(end.fault)
        self.output.show(meaning, place, end, before)
        if end.failure is None:
            return 0
        return REFUSED if end.failure.outcome in JUDGED else NO_ANSWER


def _places(span: Span) -> range:
    return range(span.start, span.start + span.count)


def _as_json(meaning: Meaning, end: CommandEnd, changes: dict[str, list[int]]) -> dict[str, Any]:
    return {
        "command": meaning.request, "words": meaning.words, "does": meaning.does, "memory": changes,
        "status": end.status, "meaning": end.meaning, "outcome": "" if end.failure is None else end.failure.outcome,
    }  # fmt: skip


LATE = "late"
"""The outcome of a transfer that takes too long, and may still end well."""


def carry_out_jobs(
    application: Protocol, protocol: Protocol, records: list[bytes], arguments: argparse.Namespace
) -> int:
    """Carries commands to jobs out; the exit status. Raises VerbError, DefinitionError."""
    from framekit.api.errors import FramekitError
    from framekit.cli.device_verbs import failed, settings_of
    from framekit.definition.problems import Position
    from framekit.runfile.job_profiles import load_job_profile

    profile = load_job_profile(application.name, Path.cwd(), Position(application.name, 1, 1))
    try:
        settings = settings_of(arguments, protocol)
        settings.station_for(None)
        return asyncio.run(JobCommands(application, profile, settings, arguments).carry_out(records))
    except FramekitError as error:
        return failed(arguments, error)


class JobCommands:
    """The commands of one call."""

    def __init__(
        self, application: Protocol, profile: JobProfile, settings: ClientSettings, arguments: argparse.Namespace
    ) -> None:
        self.application = application
        self.profile = profile
        self.settings = settings
        self.arguments = arguments
        self.line: JobLine | None = None
        self.output: CommandOutput | None = None
        self.changed = asyncio.Event()
        self.stopped = False
        self.before: dict[str, bytes] = {}
        self.answered = False
        self.cause: Failure | None = None
        self.began = 0
        self.told: set[str] = set()

    async def carry_out(self, records: list[bytes]) -> int:
        """The commands one after the other, then their jobs until they are over, or somebody stops them."""
        from framekit.api.errors import RequestError
        from framekit.cli.common import Unread
        from framekit.cli.device_verbs import show
        from framekit.definition.problems import DefinitionError
        from framekit.service.jobs import JobLine
        from framekit.transport.clock import AsyncioClock

        loop = asyncio.get_running_loop()
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.add_signal_handler(number, self._stop)
        unread = Unread(loop, self._stop)
        clock = AsyncioClock(loop)
        monitor = show if self.arguments.frames else None
        line = JobLine(self.application, self.profile, self.settings.channel(), clock, monitor, self._closed)
        output = CommandOutput(self._blocks(line), self.settings.protocol, self.arguments)
        line.table.watcher = self._transferred
        self.line, self.output = line, output
        try:
            line.start()
        except DefinitionError:
            raise
        except ValueError as error:
            raise RequestError(str(error)) from None
        self.began = clock.now()
        limit = duration_of(self.arguments.duration)
        if limit is not None:
            clock.call_at(self.began + limit, self._stop)
        try:
            status = 0
            for data in records:
                status = await self._command(line, output, data)
                unread.check()
                if status or self.stopped:
                    return status
            await self._until(lambda: not line.active)
            unread.check()
            return self._verdict(line)
        finally:
            line.stop()

    def _blocks(self, line: JobLine) -> CommandBlocks:
        from framekit.codec.codec import compile_protocol
        from framekit.link.scope import Scope
        from framekit.run.commands import CommandBlocks

        channel = Scope(self.application, role=None)
        return CommandBlocks(self.application, compile_protocol(self.application), line.memory, channel=channel)

    def _closed(self, reason: str) -> None:
        """Tells why a connection is closed, or could not be made; once, however often it is tried again."""
        if reason not in self.told:
            self.told.add(reason)
            print(f"framekit {self.arguments.verb}: {reason}", file=sys.stderr, flush=True)

    def _stop(self) -> None:
        self.stopped = True
        self.changed.set()

    async def _until(self, holds: Callable[[], bool]) -> None:
        """Waits until something holds, or somebody stops it all."""
        while not self.stopped and not holds():
            self.changed.clear()
            await self.changed.wait()

    # ---- commands -----------------------------------------------------------------------------------------

    async def _command(self, line: JobLine, output: CommandOutput, data: bytes) -> int:
        """Gives one command, and shows it when it has its status word; the exit status."""
        from framekit.memory.memory import DeviceMemoryError
        from framekit.run.commands import CommandFaultError

        ended: list[Failure | None] = []

        def answered(failure: Failure | None) -> None:
            """The first transfer, if there was one, belongs to the answer: it is told in this very moment."""
            self.answered = True
            asyncio.get_running_loop().call_soon(shown, failure)

        def shown(failure: Failure | None) -> None:
            ended.append(failure)
            self.changed.set()

        try:
            meaning, place = output.meaning(data)
            self.before = output.content()
            self.cause = None
            line.carry_out(data, answered)
            self.answered = False
        except (CommandFaultError, DeviceMemoryError) as error:
            return output.fault(str(error))
        await self._until(lambda: bool(ended))
        if not ended:
            return NO_ANSWER
        end, status = self._end(ended[0])
        output.show(meaning, place, end, self.before)
        self.before = output.content()
        return status

    def _end(self, failure: Failure | None) -> tuple[CommandEnd, int]:
        """How a command ended, and the exit status; one that is only late has not failed yet."""
        from framekit.run.block_state import Failure
        from framekit.run.commands import CommandEnd

        words = self.profile.words
        word = words["good"] if failure is None else failure.device_code or 0
        text = self.profile.text_of(word)
        if failure is None:
            return CommandEnd(status=word, meaning=text), 0
        outcome = failure.outcome if self.cause is None else self.cause.outcome
        failed = Failure(outcome=outcome, device_code=word, meaning=text)
        if word in (words["late"], words["period"]):
            return CommandEnd(status=word, meaning=text, failure=failed), 0
        return CommandEnd(status=word, meaning=text, failure=failed), REFUSED if outcome in JUDGED else NO_ANSWER

    # ---- transfers ----------------------------------------------------------------------------------------

    def _transferred(self, status: JobStatus, failure: Failure | None) -> None:
        """A transfer has ended, or is late, or the job is over."""
        self.changed.set()
        if self.answered:
            self.answered, self.cause = False, failure
            return
        assert self.line is not None and self.output is not None
        changes, self.before = self.output.changes(self.before), self.output.content()
        seconds = (self.line.clock.now() - self.began) / 1e9
        count = status.counters.completed
        late = failure is not None and failure.outcome == LATE
        if self.arguments.json:
            print_json({
                "event": "transfer", "job": status.slot, "time": round(seconds, 6), "transfers": count, "late": late,
                "active": status.state != "idle", "status": status.word, "meaning": status.text, "memory": changes,
            })  # fmt: skip
            return
        what = f"transfer {count + 1} is late" if late else f"transfer {count}"
        cause = "" if failure is None or failure.outcome in ("refused", LATE) else f" ({failure.outcome})"
        text = f"job {status.slot:<5}{what} after {seconds:.3f} s = {code_text(status.word)} {status.text}{cause}"
        print(text, flush=True)
        self.output.show_changes(changes)

    def _verdict(self, line: JobLine) -> int:
        """The exit status when all jobs are over: one that an error ended, or that moved nothing, is no success."""
        jobs = [slot.counters for slot in line.table.slots.values() if slot.counters.established]
        bad = any(one.ended or not one.good for one in jobs)
        return NO_ANSWER if bad and not self.stopped else 0
