"""`framekit run FILE`: carries out a run file, in real time or simulated, printed or live on the screen."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import gc
import signal
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from framekit.api.monitor import FrameLog, LineOf, LiveView
from framekit.cli.common import (
    VerbError,
    WordsError,
    add_capture,
    add_json,
    add_log,
    add_screen,
    begin_log,
    duration_of,
    period_of,
    print_json,
    told_once,
    why_not,
)
from framekit.cli.screen.session import LiveSession
from framekit.transport.clock import AsyncioClock, Clock, VirtualClock

if TYPE_CHECKING:
    from framekit.cli.run_output import RunOutput
    from framekit.run.model import RunModel
    from framekit.service.capture import Capture
    from framekit.service.channel import ChannelService
    from framekit.service.run import RunService


class Watched(NamedTuple):
    """A run file whose changes count, and what it said before it was loaded."""

    path: Path
    content: bytes | None


def add_run_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("run", metavar="RUN.yaml", type=Path, help="the run file")
    parser.add_argument(
        "--for", dest="duration", metavar="TIME", help="stop after this time, such as 10s; default: run on"
    )
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
        help="take lines from standard input: fire N, enable N, disable N, stop; with --screen by the key :",
    )
    add_watch(parser)
    add_json(parser)


def run_run(arguments: argparse.Namespace) -> int:
    from framekit.api.status import content_of
    from framekit.cli.run_output import JsonOutput, TextOutput
    from framekit.run.feasibility import load_problems
    from framekit.runfile.run_file import load_run
    from framekit.service.simulation import loads_of

    duration = duration_of(arguments.duration)
    if arguments.virtual and duration is None and not arguments.screen:
        raise WordsError("--virtual needs --for TIME")
    watch = RunWatch(arguments)
    if arguments.virtual and arguments.watch:
        raise WordsError("--watch is for runs in real time – leave --virtual out")
    if arguments.virtual and arguments.control and not arguments.screen:
        raise WordsError("--control is for runs in real time – leave --virtual out")
    if arguments.screen and arguments.watch:
        raise WordsError("--watch tells its edits in lines – leave --screen out")
    watched = Watched(arguments.run, content_of(arguments.run)) if arguments.watch else None
    loaded = load_run(arguments.run)
    loads = loads_of(loaded)
    if arguments.screen:
        return _live(loaded, watch, arguments, duration)
    output = JsonOutput(loaded, loads) if arguments.json else TextOutput(loaded, loads)
    output.as_ascii = arguments.ascii
    for line in told_once((*loaded.warnings, *load_problems(loads))):
        output.warning(line)
    try:
        if arguments.virtual:
            assert duration is not None
            problems = _virtual(loaded, output, watch, duration)
        else:
            problems = asyncio.run(_real(loaded, output, watch, duration, watched, arguments.control))
    except BrokenPipeError:
        raise
    except OSError as error:
        raise VerbError(why_not(error)) from None
    return 1 if problems else 0


def _live(loaded: RunModel, watch: RunWatch, arguments: argparse.Namespace, duration: int | None) -> int:
    """The run in the live display; simulated time goes on as real time does."""
    from framekit.cli.screen.show import show

    return show(RunSession(loaded, watch, virtual=arguments.virtual, duration=duration, controlled=arguments.control))


def _virtual(loaded: RunModel, output: RunOutput, watch: RunWatch, duration: int) -> list[str]:
    """Runs for a simulated time; what could not be kept or captured."""
    clock = VirtualClock()
    service = output.service(loaded, clock)
    watch.begin(service, clock)
    service.start()
    clock.run_for(duration)
    watch.at_end()
    ended: list[bool] = []
    service.finish(lambda: ended.append(True))
    while not ended and clock.advance():
        pass
    return _summary(service, output, watch)


async def _real(
    loaded: RunModel,
    output: RunOutput,
    watch: RunWatch,
    duration: int | None,
    watched: Watched | None,
    controlled: bool,
) -> list[str]:
    """Runs until the time is over, or SIGINT or SIGTERM asks to stop; what could not be kept or captured.

    `watched` is the file whose changes count.
    """
    from framekit.cli.common import Unread

    loop = asyncio.get_running_loop()
    ended = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, ended.set)
    unread = Unread(loop, ended.set)
    service = output.service(loaded, AsyncioClock(loop))
    watch.begin(service, service.clock)
    gc.collect()
    gc.freeze()  # a large run is half a million objects; a collection that looks at them all stops it for 0.2 s
    service.start()
    if controlled:
        control(service, output, ended.set)
    watching = None if watched is None else loop.create_task(_watch_file(watched, service, output))
    try:
        await asyncio.wait_for(ended.wait(), None if duration is None else duration / 1e9)
    except TimeoutError:
        pass
    finally:
        if watching is not None:
            watching.cancel()
        if unread.error is None:
            watch.at_end()
        left = asyncio.Event()
        service.finish(left.set)
        await left.wait()
        gc.unfreeze()
        unread.check()
        problems = _summary(service, output, watch)
    return problems


async def _watch_file(watched: Watched, service: RunService, output: RunOutput) -> None:
    """Applies what the file says whenever it says something else; what it cannot apply is told, and the run goes on."""
    from framekit.api.status import FileWatch, reasons

    files = FileWatch(
        watched.path,
        watched.content,
        lambda run: service.edit(run, output.edited),
        lambda error: output.refused(reasons(error)),
    )
    if hasattr(signal, "SIGHUP"):
        asyncio.get_running_loop().add_signal_handler(signal.SIGHUP, files.look_now)
    await files.watch()


def _summary(service: RunService, output: RunOutput, watch: RunWatch) -> list[str]:
    output.summary(service)
    problems = [*service.problems, *watch.end()]
    for problem in problems:
        output.warning(problem)
    return problems


def add_watch(parser: argparse.ArgumentParser) -> None:
    """--screen, --ascii, --capture, --status, --status-every and --log."""
    add_screen(parser)
    parser.add_argument("--ascii", action="store_true", help="show bytes as ASCII instead of hex")
    add_capture(parser)
    parser.add_argument("--status", action="store_true", help="show the status of channels and blocks at the end")
    parser.add_argument(
        "--status-every", metavar="TIME", help="show the status of channels and blocks so often; SIGUSR1 shows it once"
    )
    add_log(parser)


class RunWatch:
    """Watches one run as the command line asks: `begin` before it starts, `end` when it has stopped."""

    def __init__(self, arguments: argparse.Namespace) -> None:
        """Raises WordsError."""
        self._path: Path | None = arguments.capture
        self._json: bool = arguments.json
        self._capture: Capture | None = None
        self._service: RunService | None = None
        self._captured: set[int] = set()
        self._missing: list[str] = []
        self._began = 0
        self._every = period_of(arguments.status_every)
        self._at_end: bool = arguments.status or arguments.status_every is not None
        begin_log(arguments.log)

    def begin(self, service: RunService, clock: Clock, silent: bool = False) -> None:
        """Puts the capture around the ports and asks for the times of the status, unless `silent`. Raises OSError."""
        self._service, self._began = service, clock.now()
        if self._path is not None:
            from framekit.service.capture import Capture

            self._capture = Capture(self._path, tuple(service.channels), clock)
            self._captured = set(service.channels)
            for number, channel in service.channels.items():
                self._tap(number, channel)
            service.on_channel = self._tap
        if silent:
            return
        if self._every:
            clock.call_at(self._began + self._every, self._next)
        if hasattr(signal, "SIGUSR1"):
            with contextlib.suppress(RuntimeError):
                asyncio.get_running_loop().add_signal_handler(signal.SIGUSR1, self.show)

    def _tap(self, number: int, channel: ChannelService) -> None:
        """Puts the capture around the port of a channel; one that came later has no place in it."""
        if self._capture is None:
            return
        if number in self._captured:
            channel.driver.port = self._capture.around(number, channel.driver.port)
        else:
            self._missing.append(f"channel {number} came later: it is not in the capture")

    def _next(self) -> None:
        if self._service is not None and self._service.running:
            self.show()
            clock = self._service.clock
            clock.call_at(clock.now() + self._every, self._next)

    def at_end(self) -> None:
        """Shows the status for the last time, where it was asked for."""
        if self._at_end:
            self.show()

    def show(self) -> None:
        """Prints the status as it is now."""
        from framekit.api.status import run_status
        from framekit.cli.run_output import status_data, status_text

        if self._service is None:
            return
        status = run_status(self._service)
        if self._json:
            print_json(status_data(status, self._began))
        else:
            print(f"\nstatus at {(status.at - self._began) / 1e9:.3f} s\n{status_text(status, self._began)}\n")
        sys.stdout.flush()

    def end(self) -> list[str]:
        """Ends the capture; what is not in it is told."""
        if self._capture is None:
            return []
        self._capture.close()
        return [*self._capture.troubles, *self._missing]


def control(service: RunService, output: RunOutput, stop: Callable[[], None]) -> None:
    """Begins to read; the end of the input ends the control, not the run. `stop` is called for the line `stop`."""
    from framekit.api.status import ControlError, carry_out

    loop = asyncio.get_running_loop()

    def take(line: str) -> None:
        if not service.running:
            return
        if line.strip().lower() == "stop":
            stop()
            return
        try:
            carry_out(service, line)
        except ControlError as error:
            output.warning(f"control: {error}")

    def read() -> None:
        with suppress(RuntimeError, OSError, ValueError):  # the loop, or the input, is closed: nobody listens any more
            for line in sys.stdin:
                loop.call_soon_threadsafe(take, line)

    threading.Thread(target=read, name="framekit-control", daemon=True).start()


class RunSession(LiveSession):
    """A run; with `virtual` on simulated time that goes on as real time does. `duration` None: until it is ended.

    `controlled`: it takes control lines.
    """

    def __init__(
        self, run: RunModel, watch: RunWatch, *, virtual: bool, duration: int | None, controlled: bool = False
    ) -> None:
        self.controls = controlled
        self.title = f"run {run.name}"
        self.run = run
        self.watch = watch
        self.service: RunService | None = None
        self.problems: list[str] = []
        self._duration = duration
        self._virtual = VirtualClock() if virtual else None
        self._view: LiveView | None = None
        self._stopped = False

    def control(self, line: str) -> str:
        from framekit.api.status import ControlError, carry_out

        if line.strip().lower() == "stop":
            self._stopped = True
        elif self.service is not None:
            try:
                carry_out(self.service, line)
            except ControlError as error:
                return str(error)
        return ""

    def begin(self) -> LiveView:
        """Raises DefinitionError, ValueError, OSError."""
        from framekit.service.run import RunService

        clock: Clock = self._virtual or AsyncioClock(asyncio.get_running_loop())
        channels = self.run.channels
        log = FrameLog(
            {number: channel.protocol for number, channel in channels.items()},
            {number: channel.role for number, channel in channels.items()},
            {number: channel.params for number, channel in channels.items()},
        )
        self.service = service = RunService(self.run, clock, log.add)
        self.watch.begin(service, clock, silent=True)
        lines = {number: _line_of(channel) for number, channel in service.channels.items()}
        tapped = service.on_channel

        def came(number: int, channel: ChannelService) -> None:
            """A channel that jobs wanted."""
            model = channel.channel
            log.know(number, model.protocol, model.role, model.params)
            lines[number] = _line_of(channel)
            tapped(number, channel)

        service.on_channel = came
        self._view = LiveView(log, clock.now, lines, service.status)
        service.start()
        return self._view

    def step(self, duration: int) -> None:
        if self._virtual is not None:
            self._virtual.run_for(duration)

    @property
    def is_over(self) -> bool:
        if self._stopped:
            return True
        return self._duration is not None and self._view is not None and self._view.elapsed >= self._duration

    async def end(self) -> None:
        if self.service is not None:
            left = asyncio.Event()
            self.service.finish(left.set)
            if self._virtual is None:
                await left.wait()
            while not left.is_set() and self._virtual is not None and self._virtual.advance():
                pass
            self.problems = [*self.service.problems, *self.watch.end()]
            self.lost = bool(self.problems)


def _line_of(channel: ChannelService) -> LineOf:
    model = channel.channel
    line = "" if model.line is None else f" {model.line}"
    return LineOf(f"{model.protocol.name} {model.role or ''}".rstrip() + line, _state(channel), channel.driver.load)


def _state(channel: ChannelService) -> Callable[[], str]:
    return lambda: channel.state
