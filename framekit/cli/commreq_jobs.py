"""Command blocks that establish, abort and inspect jobs, carried out on a port until their jobs are over.

Each command is given when the one before has its status word; every transfer of the jobs is shown as it ends.
"""

from __future__ import annotations

import argparse
import asyncio
import signal
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING

from framekit.cli.common import duration_of, print_json
from framekit.cli.commreq_run import JUDGED, NO_ANSWER, REFUSED, CommandOutput
from framekit.link.codes import code_text

if TYPE_CHECKING:
    from framekit.api.settings import LineSettings
    from framekit.blocks.block_status import Failure
    from framekit.blocks.commands import CommandBlocks, CommandEnd
    from framekit.blocks.jobs.diagnosis import JobStatus
    from framekit.blocks.jobs.profile import JobProfile
    from framekit.definition.model.protocol import Protocol
    from framekit.service.job_line import JobLine

LATE = "late"
"""The outcome of a transfer that takes too long, and may still end well."""


def carry_out_jobs(
    application: Protocol, protocol: Protocol, records: list[bytes], arguments: argparse.Namespace
) -> int:
    """Carries commands to jobs out; the exit status. Raises Failure, DefinitionError."""
    from pathlib import Path

    from framekit.api.errors import FramekitError
    from framekit.blocks.jobs.load import load_job_profile
    from framekit.cli.one_shot import failed, settings_of
    from framekit.definition.problems import Position

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
        self, application: Protocol, profile: JobProfile, settings: LineSettings, arguments: argparse.Namespace
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
        from framekit.cli.one_shot import show
        from framekit.cli.unread import Unread
        from framekit.definition.problems import DefinitionError
        from framekit.service.job_line import JobLine
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
        from framekit.blocks.commands import CommandBlocks
        from framekit.codec.codec import compile_protocol
        from framekit.link.scope import Scope

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
        from framekit.blocks.command_words import CommandFaultError
        from framekit.memory.memory import DeviceMemoryError

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
        from framekit.blocks.block_status import Failure
        from framekit.blocks.commands import CommandEnd

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
