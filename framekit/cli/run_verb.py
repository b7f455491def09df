"""`framekit run RUN.yaml`: carries a run out, showing frames as they go by and the blocks' counters at the end."""

from __future__ import annotations

import argparse
import asyncio
import gc
import signal
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from framekit.cli.common import add_json, duration_of, told_once, why_not
from framekit.cli.main import Failure, WrongWords
from framekit.cli.watch_options import Watch, add_watch

if TYPE_CHECKING:
    from framekit.blocks.model import Run
    from framekit.cli.run_output import Output
    from framekit.service.run import RunService


class Watched(NamedTuple):
    """A run file whose changes count, and what it said before it was loaded."""

    path: Path
    content: bytes | None


def add_arguments(parser: argparse.ArgumentParser) -> None:
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


def run(arguments: argparse.Namespace) -> int:
    from framekit.blocks.feasibility import load_problems
    from framekit.blocks.load import load_run
    from framekit.cli.run_output import JsonOutput, TextOutput
    from framekit.service.file_watch import content_of
    from framekit.service.rehearsal import loads_of

    duration = duration_of(arguments.duration)
    if arguments.virtual and duration is None and not arguments.screen:
        raise WrongWords("--virtual needs --for TIME")
    watch = Watch(arguments)
    if arguments.virtual and arguments.watch:
        raise WrongWords("--watch is for runs in real time – leave --virtual out")
    if arguments.virtual and arguments.control and not arguments.screen:
        raise WrongWords("--control is for runs in real time – leave --virtual out")
    if arguments.screen and arguments.watch:
        raise WrongWords("--watch tells its edits in lines – leave --screen out")
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
        raise Failure(why_not(error)) from None
    return 1 if problems else 0


def _live(loaded: Run, watch: Watch, arguments: argparse.Namespace, duration: int | None) -> int:
    """The run in the live display; simulated time goes on as real time does."""
    from framekit.cli.screen.session import RunSession
    from framekit.cli.screen.show import show

    return show(RunSession(loaded, watch, virtual=arguments.virtual, duration=duration, controlled=arguments.control))


def _virtual(loaded: Run, output: Output, watch: Watch, duration: int) -> list[str]:
    """Runs for a simulated time; what could not be kept or captured."""
    from framekit.transport.clock import VirtualClock

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
    loaded: Run, output: Output, watch: Watch, duration: int | None, watched: Watched | None, controlled: bool
) -> list[str]:
    """Runs until the time is over, or SIGINT or SIGTERM asks to stop; what could not be kept or captured.

    `watched` is the file whose changes count.
    """
    from framekit.cli.control_lines import control
    from framekit.cli.unread import Unread
    from framekit.transport.clock import AsyncioClock

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


async def _watch_file(watched: Watched, service: RunService, output: Output) -> None:
    """Applies what the file says whenever it says something else; what it cannot apply is told, and the run goes on."""
    from framekit.service.file_watch import FileWatch, reasons

    files = FileWatch(
        watched.path,
        watched.content,
        lambda run: service.edit(run, output.edited),
        lambda error: output.refused(reasons(error)),
    )
    if hasattr(signal, "SIGHUP"):
        asyncio.get_running_loop().add_signal_handler(signal.SIGHUP, files.look_now)
    await files.watch()


def _summary(service: RunService, output: Output, watch: Watch) -> list[str]:
    output.summary(service)
    problems = [*service.problems, *watch.end()]
    for problem in problems:
        output.warning(problem)
    return problems
