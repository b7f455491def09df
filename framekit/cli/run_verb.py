"""`framekit run FILE`: executes a run file, in real time or simulated, with printed output or a live display."""

from __future__ import annotations

import argparse
import asyncio
import io
import sys
import threading
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, Protocol, Self, TypeVar

from framekit.cli.common import (
    PortError,
    VerbError,
    WordsError,
    add,
    begin_log,
    duration_of,
    on_signal,
    period_of,
    print_json,
    reasons_of,
    run_in_loop,
    told_once,
    until,
    why_not,
    why_output_failed,
    without_collecting,
)
from framekit.cli.live_output import LiveOutput, live_output
from framekit.cli.live_session import LiveSession, show
from framekit.cli.web_option import NoPage, add_web, page_of
from framekit.definition.problems import error_text
from framekit.table_of_extras import OPTIONS, load

if TYPE_CHECKING:
    from framekit.api.monitor import LiveView
    from framekit.api.run import AsyncRun, Edit, OnSeen, RunCalls, RunModel, Tape, VirtualRun
    from framekit.cli.run_output import RunOutput

R = TypeVar("R", "AsyncRun", "VirtualRun", "AsyncRun | VirtualRun")


class FleetMember(Protocol):
    """The membership of a run in its fleet, which the extra `fleet` brings."""

    next_run: RunModel | None
    """The run of a rolled-out file, which must begin because it cannot be edited in."""
    over: asyncio.Event
    """Set when the run must end because `next_run` must begin."""

    def __enter__(self) -> Self: ...

    def __exit__(self, *_: object) -> None: ...

    def begins(self, run: RunCalls) -> None:
        """Report on this run from now on; it starts next."""

    def has_begun(self) -> None:
        """Report the start of the run."""

    def has_failed(self, error: Exception) -> RunModel:
        """Restore the previous file because the next run could not begin; return the previous run."""

    def edited(self, model: RunModel, content: bytes) -> None:
        """Report the run after an edit."""


class Watched(NamedTuple):
    """A run file and its content before it was loaded; None if it could not be read."""

    path: Path
    content: bytes | None


def add_run_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("run", metavar="RUN.yaml", type=Path, help="the run file")
    add(parser, "--for", help="stop after this time, such as 10s; default: run on")
    parser.add_argument(
        "--virtual", action="store_true", help="simulated time: as fast as it goes; needs --for, and only sim: ports"
    )
    parser.add_argument(
        "--watch",
        action="store_true",
        help="apply changes of the file while the run goes on, whole or not at all; SIGHUP looks at once",
    )
    parser.add_argument(
        "--control",
        action="store_true",
        help="take lines from standard input: fire N, enable N, disable N (also set N, channel N), reset, stop; with "
        "--screen by the key :",
    )
    parser.add_argument(
        "--read-only",
        action="store_true",
        help="refuse a file that could write into a device, and what others want to write into its memory",
    )
    add(parser, "--screen", "--ascii", "--capture")
    add_web(parser)
    parser.add_argument("--frames", action="store_true", help="show the frames on the lines, too")
    parser.add_argument("--lines", action="store_true", help="print a line a change on a terminal, too, and no table")
    parser.add_argument("--quiet", action="store_true", help="show nothing but troubles")
    parser.add_argument("--status", action="store_true", help="show the status of channels and blocks at the end")
    parser.add_argument(
        "--status-every",
        metavar="TIME",
        help="show the status of channels and blocks at this interval; SIGUSR1 shows it once",
    )
    add(parser, "--log", "--json")


def run_run(arguments: argparse.Namespace) -> int:
    if arguments.virtual or arguments.screen:
        return _run(arguments, None)
    with live_output(arguments.json, has_quiet=True, goes_on="the run") as live:
        live.status = _run(arguments, live)
        return live.status


def _refuse_pairs(arguments: argparse.Namespace) -> None:
    """Raise WordsError for options that exclude each other."""
    is_on_page = arguments.web is not None
    real = "is for runs in real time – leave --virtual out"
    in_lines = arguments.virtual and not arguments.screen
    for is_wrong, what in (
        (arguments.virtual and arguments.watch, f"--watch {real}"),
        (in_lines and arguments.control, f"--control {real}"),
        (arguments.virtual and is_on_page, f"--web {real}"),
        (arguments.screen and is_on_page, "--web tells its address in a line – leave --screen out"),
        (arguments.screen and arguments.watch, "--watch tells its edits in lines – leave --screen out"),
    ):
        if is_wrong:
            raise WordsError(what)


def _refuse_for_fleets(arguments: argparse.Namespace, *, has_token: bool) -> None:
    """Raise WordsError for options that a run of a fleet cannot have; with a token, files are rolled out to the run."""
    if arguments.screen:
        raise WordsError("--screen is not for runs of a fleet – leave it out, or the key fleet")
    for option, is_set in (
        ("--capture", arguments.capture is not None),
        ("--watch", arguments.watch),
        ("--read-only", arguments.read_only),
    ):
        if is_set and has_token:
            what = f"{option} is not for runs that files are rolled out to"
            raise WordsError(f"{what} – leave it out, or the fleet's token")


def _run(arguments: argparse.Namespace, live: LiveOutput | None) -> int:
    """Execute the run file, with `live` in real time; return the exit status. Raises VerbError, DefinitionError."""
    from framekit.api.check import loads_of
    from framekit.api.run import content_of, reads_only
    from framekit.api.run import loaded as load_run
    from framekit.cli.run_output import JsonOutput, TextOutput

    duration = duration_of(arguments.duration)
    if arguments.virtual and duration is None and not arguments.screen:
        raise WordsError("--virtual needs --for TIME")
    _refuse_pairs(arguments)
    watch = RunWatch(arguments)
    settle(arguments.run)
    began_with = Watched(arguments.run, content_of(arguments.run))
    loaded = load_run(arguments.run)
    if arguments.read_only:
        loaded = reads_only(loaded)
    if loaded.fleet is not None:
        _refuse_for_fleets(arguments, has_token=loaded.fleet.token is not None)
    if arguments.screen:
        session = RunSession(loaded, watch, virtual=arguments.virtual, duration=duration, controlled=arguments.control)
        return show(session)

    def make_output(model: RunModel) -> RunOutput:
        loads, doubts = loads_of(model)
        kind = JsonOutput if arguments.json else TextOutput
        output = kind(model, loads, with_frames=arguments.frames, quiet=arguments.quiet)
        output.as_ascii = arguments.ascii
        output.live = None if arguments.lines else live
        for line in told_once((*model.warnings, *doubts)):
            output.warning(line)
        return output

    output = make_output(loaded)
    if loaded.fleet is not None and arguments.virtual:
        output.warning("on simulated time the run is no part of its fleet")
    try:
        if live is None:
            assert duration is not None
            ended = _virtual(loaded, output, watch, duration)
        else:
            ended = run_in_loop(_real(arguments, watch, began_with, make_output, output, live, loaded, duration))
    except BrokenPipeError:
        raise
    except OSError as error:
        raise VerbError(why_output_failed(error) if live is None else why_not(error)) from None
    if ended.problems:
        return 1
    if ended.never_open:
        raise PortError("; ".join(ended.never_open))
    return 0


def made(make: Callable[..., R], run: RunModel, monitor: OnSeen | Tape | None, watch: RunWatch) -> R:
    """Return the run, not yet begun.

    Raises DefinitionError for a wrong device, VerbError for a port of no known kind.
    """
    from framekit.api.errors import RequestError
    from framekit.definition.problems import DefinitionError

    try:
        found = make(run, monitor=monitor, capture=watch.capture)
    except RequestError as error:
        raise VerbError(str(error)) from None
    try:
        found.open_sinks()
    except DefinitionError:
        found.stop()
        raise
    return found


def _virtual(loaded: RunModel, output: RunOutput, watch: RunWatch, duration: int) -> Ended:
    """Run for a simulated time."""
    from framekit.api.run import VirtualRun

    run = made(VirtualRun, loaded, None if watch.quiet else output.tape, watch)
    output.watches(run)
    watch.begin(run, output.catch_up)
    run.start()
    run.run_for(duration / 1e9)
    watch.at_end()
    run.stop()
    return _summary(run, output)


async def _real(
    arguments: argparse.Namespace, watch: RunWatch, began_with: Watched,
    make_output: Callable[[RunModel], RunOutput], output: RunOutput, live: LiveOutput, loaded: RunModel,
    duration: int | None,
) -> Ended:  # fmt: skip
    return await RealRun(arguments, watch, began_with, make_output, output, live).carry_out(loaded, duration)


class RealRun:
    """A run file in real time, with the options of the command line: one run, or several in sequence if files are
    rolled out.
    """

    def __init__(
        self, arguments: argparse.Namespace, watch: RunWatch, began_with: Watched,
        make_output: Callable[[RunModel], RunOutput], output: RunOutput, live: LiveOutput,
    ) -> None:  # fmt: skip
        self.path: Path = arguments.run
        self.watch, self.began_with = watch, began_with
        self._arguments = arguments
        self._make_output, self._output, self._live = make_output, output, live
        self._ended = asyncio.Event()
        self._ended_at_once = asyncio.Event()
        """Set by a signal after the event `_ended`."""
        self._gateway: FleetMember | None = None
        self._run: AsyncRun | None = None
        self._left: int | None = None
        """Remaining duration (ns); None: until it is ended."""

    async def carry_out(self, loaded: RunModel, duration: int | None) -> Ended:
        """Run until the time is over, or SIGINT or SIGTERM arrives; a second signal ends sessions and hanging up."""
        self._live.on_stop(self._is_signalled, at_hangup=not self._arguments.watch)
        if self._arguments.control:
            self._read_control()
        self._left = duration
        with self._in_fleet(loaded):
            page = page_of(self._arguments)
            while True:
                ended = await self._one(loaded, page)
                gateway = self._gateway
                if gateway is None or gateway.next_run is None:
                    break
                loaded, page = gateway.next_run, page_of(self._arguments)
                self._output = self._make_output(loaded)
        return ended

    def _in_fleet(self, loaded: RunModel) -> AbstractContextManager[object]:
        """Return a context for the membership of the run in its fleet, if any. Raises VerbError."""
        if loaded.fleet is None:
            return nullcontext()
        from framekit.api.errors import RequestError

        try:
            self._gateway = load(OPTIONS["fleet:"])(self.path, loaded, self.began_with.content or b"")
        except RequestError as error:
            raise VerbError(str(error)) from None
        assert self._gateway is not None
        return self._gateway

    def _begun(self, loaded: RunModel, page: NoPage) -> AsyncRun:
        """Return the run, not started. If the run of a rolled-out file cannot be made, return the previous run."""
        from framekit.api.run import AsyncRun

        gateway = self._gateway
        make = partial(AsyncRun, after=self._run, offers_faults=page.switches_faults)
        try:
            return made(make, loaded, self._monitor(page), self.watch)
        except (OSError, ValueError, VerbError) as error:
            if gateway is None or gateway.next_run is None:
                raise
            before = gateway.has_failed(ValueError(str(error)) if isinstance(error, VerbError) else error)
            self._output = self._make_output(before)
            return made(make, before, self._monitor(page), self.watch)

    def _monitor(self, page: NoPage) -> OnSeen | Tape | None:
        """Return the recorder of the frames of the lines: for the page, the output, or None."""
        return page.monitor(None if self.watch.quiet else self._output.tape)

    async def _one(self, loaded: RunModel, page: NoPage) -> Ended:
        gateway, loop = self._gateway, asyncio.get_running_loop()
        run = self._begun(loaded, page)
        output = self._output
        self._run = run
        output.watches(run)
        self.watch.begin(run, output.catch_up)
        if gateway is not None:
            gateway.begins(run)
        async with page.of_run(run):
            with without_collecting(), self._live.may_drop(run.trouble_source):
                run.start()
                if gateway is not None:
                    gateway.has_begun()
                watching = loop.create_task(self._watch_file(run)) if self._arguments.watch else None
                if watching is not None:
                    watching.add_done_callback(self._is_unwatched)
                began = loop.time()
                try:
                    await until(self._left, self._ended, *([] if gateway is None else [gateway.over]))
                finally:
                    if watching is not None:
                        watching.cancel()
                    self.watch.at_end()
                    await self._finish(run)
        if self._left is not None:
            self._left = max(0, self._left - round((loop.time() - began) * 1e9))
        return _summary(run, output)

    def _is_signalled(self) -> None:
        if self._ended.is_set():
            self._ended_at_once.set()
        self._ended.set()

    async def _finish(self, run: AsyncRun) -> None:
        """End the run in good order; a signal after the end has begun stops it at once."""
        finishing = asyncio.ensure_future(run.finish())
        signalled = asyncio.ensure_future(self._ended_at_once.wait())
        await asyncio.wait([finishing, signalled], return_when=asyncio.FIRST_COMPLETED)
        signalled.cancel()
        if finishing.done():
            await finishing
            return
        finishing.cancel()
        run.stop()
        problem = "ended by a second signal: sessions may be open, and modems may hold the line"
        print(f"framekit run: {problem}", file=sys.stderr)

    def _read_control(self) -> None:
        """Begin to read control lines; the end of the input ends the control, not the run."""
        loop = asyncio.get_running_loop()

        def take(line: str) -> None:
            is_stop = line.strip().lower() == "stop"
            if self._run is None or not (self._run.running or is_stop):
                return
            if trouble := controlled(self._run, line, self._ended.set):
                self._output.warning(f"control: {trouble}")

        def read() -> None:
            with suppress(RuntimeError, OSError, ValueError):  # the loop, or the input, is closed
                if isinstance(sys.stdin, io.TextIOWrapper):  # a wrong byte spoils its line, not the control
                    sys.stdin.reconfigure(errors="backslashreplace")
                for line in sys.stdin:
                    loop.call_soon_threadsafe(take, line)

        threading.Thread(target=read, name="framekit-control", daemon=True).start()

    def _is_unwatched(self, watching: asyncio.Task[None]) -> None:
        """Print a warning if an error has ended the watch of the run file; the run goes on."""
        if not watching.cancelled() and (error := watching.exception()) is not None:
            self._output.warning(f"{self.path} is not watched any more: {error_text(error)}")

    async def _watch_file(self, run: RunCalls) -> None:
        """Apply each change of the run file; print a warning for changes that cannot be applied, and go on."""
        from framekit.api.run import FileWatch, reads_only
        from framekit.cli.run_output import GOES_ON

        output = self._output

        def changed(model: RunModel) -> None:
            content = files.tried or b""

            def applied(edit: Edit) -> None:
                output.edited(edit)
                if self._gateway is not None:
                    self._gateway.edited(model, content)

            run.edit(reads_only(model) if self._arguments.read_only else model, applied)

        def missing(reason: str) -> None:
            output.catch_up()
            output.warning(f"{self.path} {f'cannot be read: {reason} – {GOES_ON}' if reason else 'can be read again'}")

        files = FileWatch(*self.began_with, changed, lambda error: output.refused(reasons_of(error)), missing)
        on_signal("SIGHUP", files.look_now)
        await files.watch()


def settle(path: Path) -> None:
    """Restore the previous file if the trial of a rolled-out file was interrupted. Raises VerbError."""
    from framekit.api.replaced_file import ReplacedFile

    try:
        ReplacedFile(path).settle()
    except OSError as error:
        raise VerbError(f"{path} cannot be made the one of before: {why_not(error)}") from None


class Ended(NamedTuple):
    """Failures of a run: samples or captures that could not be kept, and channels whose ports never opened."""

    problems: list[str]
    never_open: list[str]


def _summary(run: RunCalls, output: RunOutput) -> Ended:
    """Print the counters and the problems of stored data, and return the end of the run."""
    output.summary(run)
    problems = [*run.problems, *run.lost]
    for problem in problems:
        output.warning(problem)
    return Ended(problems, run.never_open)


class RunWatch:
    """Watches one run as the command line asks: `begin` before it starts."""

    def __init__(self, arguments: argparse.Namespace) -> None:
        """Read the options. Raise WordsError."""
        self.capture: Path | None = arguments.capture
        self._json: bool = arguments.json
        self.quiet: bool = arguments.quiet
        self._run: RunCalls | None = None
        self._every = period_of(arguments.status_every)
        self._at_end: bool = arguments.status or arguments.status_every is not None
        begin_log(arguments.log)

    def begin(self, run: RunCalls, catch_up: Callable[[], None]) -> None:
        """Begin the periodic status; `catch_up` prints the earlier events."""
        self._run, self._catch_up = run, catch_up
        if self._every:
            run.each(self._every, self.show)
        with suppress(RuntimeError):  # on simulated time there is no loop
            on_signal("SIGUSR1", self.show)

    def at_end(self) -> None:
        """Print the last status, if the options ask for it."""
        if self._at_end:
            self.show()

    def show(self) -> None:
        """Print the present status."""
        from framekit.cli.run_output import status_data, status_text

        if self._run is None:
            return
        self._catch_up()
        status, began = self._run.status(), self._run.began
        if self._json:
            print_json(status_data(status, began))
        else:
            print(f"\nstatus at {(status.at - began) / 1e9:.3f} s\n{status_text(status, began)}\n")
        sys.stdout.flush()


def controlled(run: RunCalls, line: str, stop: Callable[[], None]) -> str:
    """Execute a control line; return the reason if it is refused, else ''."""
    from framekit.api.errors import RequestError

    if line.strip().lower() == "stop":
        stop()
        return ""
    try:
        run.control(line)
    except RequestError as error:
        return str(error)
    return ""


class RunSession(LiveSession):
    """A run in the display; with `virtual` on simulated time at the speed of real time.

    `duration` None: until it is ended. `controlled`: whether it accepts control lines.
    """

    def __init__(
        self, run: RunModel, watch: RunWatch, *, virtual: bool, duration: int | None, controlled: bool = False
    ) -> None:
        super().__init__(f"run {run.name}", duration)
        self.controls = controlled
        self.model = run
        self.watch = watch
        self.virtual = virtual
        self.run: AsyncRun | VirtualRun | None = None
        self._stopped = False

    def control(self, line: str) -> str:
        return "" if self.run is None else controlled(self.run, line, self._stop)

    def _stop(self) -> None:
        self._stopped = True

    def begin(self) -> LiveView:
        """Start the run and return its view. Raises DefinitionError, VerbError, OSError."""
        from framekit.api.monitor import FrameLog
        from framekit.api.run import AsyncRun, VirtualRun, view_of

        log = FrameLog()
        make: Callable[..., AsyncRun | VirtualRun] = VirtualRun if self.virtual else AsyncRun
        self.run = run = made(make, self.model, log.add, self.watch)
        view = view_of(run, log)
        run.start()
        return view

    def step(self, duration: int) -> None:
        from framekit.api.run import VirtualRun

        if isinstance(self.run, VirtualRun):
            self.run.run_for(duration / 1e9)

    @property
    def is_over(self) -> bool:
        return self._stopped or super().is_over

    async def end(self) -> None:
        from framekit.api.run import AsyncRun

        if self.run is not None:
            if isinstance(self.run, AsyncRun):
                await self.run.finish()
            else:
                self.run.stop()
            self.problems = [*self.run.problems, *self.run.lost]
            self.lost = bool(self.problems)
