"""The verb for command blocks: words, or a command with named fields, are explained, or carried out on a port.

Exit status: 0 done, 1 refused, 2 it is no command block, 3 no good answer came. Commands that establish, abort and
inspect jobs are carried out until their jobs are over: each is given when the one before has its status word, and
every transfer of the jobs is shown as it ends.
"""

from __future__ import annotations

import argparse
import asyncio
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from framekit.cli.common import (
    VerbError,
    WordsError,
    add,
    assignment,
    assignments,
    duration_of,
    load,
    print_json,
    tell_error,
    why_not,
)
from framekit.cli.device_verbs import add_line, carry_out
from framekit.codec.shown import code_text

if TYPE_CHECKING:
    from framekit import Client, Failure
    from framekit.api.settings import ClientSettings
    from framekit.cli.live_output import LiveOutput
    from framekit.definition.model.protocol import Protocol
    from framekit.extras.commreq.commands import (
        CommandBlocks,
        CommandEnd,
        JobLine,
        JobProfile,
        JobStatus,
        Meaning,
        Span,
    )


NO_COMMAND = 2
"""Exit status when the words are no command block."""

REFUSED, NO_ANSWER = 1, 3
"""Exit statuses: refused by the port or the device, no good answer came."""

JUDGED = ("refused", "no_such_place", "no_own_place", "cannot_send", "cannot_store", "not_allowed")
"""Outcomes of commands that were answered, or for which no request was sent."""


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
        "--set", action="append", default=[], metavar="ADDRESS=VALUE[,VALUE…]",
        help="start value in the own memory; may be repeated",
    )  # fmt: skip
    add(parser, "--for", help="end jobs after this time; default: when they are over")
    parser.add_argument("--explain", action="store_true", help="only say what the words mean, as without --port")


def run_commreq(arguments: argparse.Namespace) -> int:
    from framekit.extras.commreq.commands import application_of, blocks_of

    protocol = load(arguments.protocol)
    application = application_of(protocol, arguments.commands, arguments.protocol)
    blocks = blocks_of(application, protocol, arguments.role)
    try:
        records = [_record(blocks, given) for given in commands_in(arguments.words)]
    except ValueError as error:
        tell_error(arguments, WordsError.kind, str(error))
        return NO_COMMAND
    if arguments.port is None or arguments.explain:
        return max(explain(blocks, protocol, data, arguments) for data in records)
    return _carry_out(application, protocol, records, arguments)


def _carry_out(application: Protocol, protocol: Protocol, records: list[bytes], arguments: argparse.Namespace) -> int:
    """Carry out the commands until one fails; return the exit status."""
    from framekit.extras.commreq.commands import has_jobs

    if has_jobs(application):
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


# ---- explaining -------------------------------------------------------------------------------------------


def explain(blocks: CommandBlocks, protocol: Protocol, data: bytes, arguments: argparse.Namespace) -> int:
    """Print the meaning of a command block; return the exit status."""
    from framekit.extras.commreq.commands import CommandFaultError, meaning_in

    try:
        meaning = meaning_in(blocks, protocol, data)
    except CommandFaultError as error:
        return fault(arguments, error)
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
    """Return the command with its fields as a line."""
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
    """Return the words of each command, with the words of a file in place of @FILE; + separates commands.

    Raises VerbError.
    """
    found: list[list[str]] = [[]]
    for given in words:
        for word in _words_of(given[1:]) if given.startswith("@") else [given]:
            if word == "+":
                found.append([])
            else:
                found[-1].append(word)
    return found


def _words_of(file: str) -> list[str]:
    """Return the words of a file, in which # begins a comment. Raises VerbError."""
    try:
        lines = Path(file).read_text(encoding="utf-8").splitlines()
    except FileNotFoundError:
        raise WordsError(f"@{file}: there is no such file – check its name and folder") from None
    except OSError as error:
        raise VerbError(f"@{why_not(error)}") from None
    except UnicodeDecodeError:
        raise VerbError(f"@{file}: this is no text – write words with blanks between them") from None
    return [word for line in lines for word in line.partition("#")[0].replace(",", " ").split()]


def _record(blocks: CommandBlocks, given: list[str]) -> bytes:
    """Return the command block from words. Raises ValueError."""
    from framekit.extras.commreq.commands import record_of

    plain = [text for text in given if "=" not in text]
    return record_of(blocks.words, plain, assignments(text for text in given if "=" in text))


def fault(arguments: argparse.Namespace, why: object) -> int:
    """Report that words are no command; return the exit status."""
    tell_error(arguments, WordsError.kind, f"this is no command block: {why}")
    return NO_COMMAND


class CommandOutput:
    """Output of the effects of commands on an own memory, which begins with zeros and the values of --set."""

    def __init__(self, blocks: CommandBlocks, protocol: Protocol, arguments: argparse.Namespace) -> None:
        from framekit.api.errors import RequestError
        from framekit.extras.commreq.commands import CommandMemory

        self.arguments = arguments
        self.memory = CommandMemory(blocks, protocol)
        self.content, self.meaning, self.changes = self.memory.content, self.memory.meaning, self.memory.changes
        for text in arguments.set:
            address, values = assignment(text)
            try:
                self.memory.put(address, str(values))
            except RequestError as error:
                raise WordsError(f"--set {text}: {error}") from None

    def show(self, meaning: Meaning, place: Span, end: CommandEnd, before: dict[str, bytes]) -> None:
        """Print the end of a command and the changed memory."""
        changes = self.changes(before, place)
        if self.arguments.json:
            print_json(_as_json(meaning, end, changes))
            return
        print(command_line(meaning))
        for number, line in enumerate(meaning.does):
            print(f"{'' if number else 'does':<9}{line}")
        word = self.memory.addresses(place)
        self.show_changes({address: changes[address] for address in changes if address not in word})
        failed = "" if end.failure is None or end.failure.outcome == "refused" else f" ({end.failure.outcome})"
        print(f"status   {meaning.status} = {code_text(end.status)} {end.meaning}".rstrip() + failed)

    def show_changes(self, changes: dict[str, list[int]]) -> None:
        """Print the changes elsewhere in the memory."""
        for address, values in changes.items():
            print(f"{address:<8} {' '.join(map(str, values))}", flush=True)


class CommandRun:
    """The commands of one call: they share the line, the session and the memory."""

    def __init__(self, client: Client, blocks: CommandBlocks, arguments: argparse.Namespace) -> None:
        self.client = client
        self.blocks = blocks
        self.output = CommandOutput(blocks, client.protocol, arguments)

    def carry_out(self, data: bytes) -> int:
        """Carry out a command and print its result; return the exit status."""
        from framekit.extras.commreq.commands import CommandFaultError

        try:
            meaning, place = self.output.meaning(data)
        except CommandFaultError as error:
            return fault(self.output.arguments, error)
        before = self.output.content()
        end = self.client.command(self.blocks, data)
        if end.fault:
            return fault(self.output.arguments, end.fault)
        self.output.show(meaning, place, end, before)
        return 0 if end.failure is None else exit_status(end.failure.outcome)


def exit_status(outcome: str) -> int:
    """Return the exit status of a command that failed."""
    return REFUSED if outcome in JUDGED else NO_ANSWER


def _as_json(meaning: Meaning, end: CommandEnd, changes: dict[str, list[int]]) -> dict[str, Any]:
    return {
        "command": meaning.request, "words": meaning.words, "does": meaning.does, "memory": changes,
        "status": end.status, "meaning": end.meaning, "outcome": "" if end.failure is None else end.failure.outcome,
    }  # fmt: skip


LATE = "late"
"""Outcome of a transfer that takes too long, and may still succeed."""


def carry_out_jobs(
    application: Protocol, protocol: Protocol, records: list[bytes], arguments: argparse.Namespace
) -> int:
    """Carry out commands for jobs; return the exit status. Raises VerbError, DefinitionError."""
    from framekit.api.errors import FramekitError
    from framekit.cli.device_verbs import failed, settings_of
    from framekit.cli.live_output import live_output
    from framekit.extras.commreq.commands import profile_of

    profile = profile_of(application)
    try:
        settings = settings_of(arguments, protocol)
        settings.station_for(None)
        with live_output(arguments.json) as live:
            status = asyncio.run(JobCommands(application, profile, settings, arguments, live).carry_out(records))
            return live.report_losses(status)
    except FramekitError as error:
        return failed(arguments, error)


class JobCommands:
    """The commands of one call."""

    def __init__(
        self, application: Protocol, profile: JobProfile, settings: ClientSettings, arguments: argparse.Namespace,
        live: LiveOutput,
    ) -> None:  # fmt: skip
        self.application = application
        self.profile = profile
        self.settings = settings
        self.arguments = arguments
        self.live = live
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
        """Carry out the commands one after the other, then the jobs until they are over or stopped; return the exit
        status.
        """
        from framekit.api.errors import RequestError
        from framekit.cli.device_verbs import show
        from framekit.definition.problems import DefinitionError
        from framekit.extras.commreq.commands import blocks_on, line_of_jobs

        self.live.on_stop(self._stop)
        self.live.stops(self._stop)
        monitor = show if self.arguments.frames else None
        line = line_of_jobs(self.application, self.profile, self.settings, monitor, self._closed)
        output = CommandOutput(blocks_on(line), self.settings.protocol, self.arguments)
        line.table.watcher = self._transferred
        self.line, self.output = line, output
        try:
            line.start()
        except DefinitionError:
            raise
        except ValueError as error:
            raise RequestError(str(error)) from None
        self.began = line.clock.now()
        limit = duration_of(self.arguments.duration)
        if limit is not None:
            line.clock.call_at(self.began + limit, self._stop)
        try:
            with self.live.may_drop():
                status = 0
                for data in records:
                    status = await self._command(line, output, data)
                    if status or self.stopped:
                        return status
                await self._until(lambda: not line.active)
                return self._exit_status(line)
        finally:
            line.stop()

    def _closed(self, reason: str) -> None:
        """Print the reason why a connection is closed, or could not be opened; once, however often it is tried
        again.
        """
        if reason not in self.told:
            self.told.add(reason)
            print(f"framekit {self.arguments.verb}: {reason}", file=sys.stderr, flush=True)

    def _stop(self) -> None:
        self.stopped = True
        self.changed.set()

    async def _until(self, holds: Callable[[], bool]) -> None:
        """Wait until a condition holds, or all is stopped."""
        while not self.stopped and not holds():
            self.changed.clear()
            await self.changed.wait()

    # ---- commands -----------------------------------------------------------------------------------------

    async def _command(self, line: JobLine, output: CommandOutput, data: bytes) -> int:
        """Give a command, and print it when it has its status word; return the exit status."""
        from framekit.extras.commreq.commands import CommandFaultError

        ended: list[Failure | None] = []

        def answered(failure: Failure | None) -> None:
            """Note the answer; a first transfer that ends at the same moment belongs to it."""
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
        except CommandFaultError as error:
            return fault(self.arguments, error)
        await self._until(lambda: bool(ended))
        if not ended:
            return NO_ANSWER
        end, status = self._end(ended[0])
        output.show(meaning, place, end, self.before)
        self.before = output.content()
        return status

    def _end(self, failure: Failure | None) -> tuple[CommandEnd, int]:
        """Return the end of a command and the exit status; a command that is only late has not failed yet."""
        from framekit import Failure
        from framekit.extras.commreq.commands import CommandEnd

        words = self.profile.words
        word = words["good"] if failure is None else failure.device_code or 0
        text = self.profile.text_of(word)
        if failure is None:
            return CommandEnd(status=word, meaning=text), 0
        outcome = failure.outcome if self.cause is None else self.cause.outcome
        failed = Failure(outcome=outcome, device_code=word, meaning=text)
        if word in (words["late"], words["period"]):
            return CommandEnd(status=word, meaning=text, failure=failed), 0
        return CommandEnd(status=word, meaning=text, failure=failed), exit_status(outcome)

    # ---- transfers ----------------------------------------------------------------------------------------

    def _transferred(self, status: JobStatus, failure: Failure | None) -> None:
        """Print the end of a transfer, a late transfer, or the end of the job."""
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

    def _exit_status(self, line: JobLine) -> int:
        """Return the exit status when all jobs are over: a job that an error ended, or that transferred no data, is a
        failure.
        """
        jobs = [slot.counters for slot in line.table.slots.values() if slot.counters.established]
        bad = any(one.ended or not one.good for one in jobs)
        return NO_ANSWER if bad and not self.stopped else 0
