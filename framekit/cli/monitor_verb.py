"""`framekit monitor --port PORT PROTOCOL`: shows what goes over a line between others; sends nothing."""

from __future__ import annotations

import argparse
import asyncio
import signal
import sys
from typing import TYPE_CHECKING

from framekit.cli.common import add_json, add_protocol, duration_of, load, print_json, why_not
from framekit.cli.line_options import add_filter, add_line, add_params, filter_of, line_of, params_of
from framekit.cli.main import Failure, NoPort, WrongWords
from framekit.cli.seen_output import seen_data, seen_text
from framekit.cli.watch_options import add_capture, add_log, add_screen, begin_log
from framekit.transport.schemes import help_on_ports

if TYPE_CHECKING:
    from collections.abc import Callable

    from framekit.definition.model.protocol import Protocol
    from framekit.link.observe import Seen
    from framekit.service.capture import Capture
    from framekit.service.line_monitor import LineMonitor
    from framekit.transport.clock import Clock


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_protocol(parser)
    parser.add_argument("--port", required=True, metavar="PORT", help=help_on_ports())
    add_line(parser)
    add_params(parser)
    add_filter(parser)
    parser.add_argument("--ascii", action="store_true", help="show bytes as ASCII instead of hex")
    add_screen(parser)
    add_capture(parser)
    add_log(parser)
    parser.add_argument("--for", dest="duration", metavar="TIME", help="stop after this time, such as 10s")
    add_json(parser)


def run(arguments: argparse.Namespace) -> int:
    protocol = load(arguments.protocol)
    duration = duration_of(arguments.duration)
    begin_log(arguments.log)
    if arguments.screen:
        return _live(protocol, arguments, duration)
    printer = _Printer(protocol, arguments)
    try:
        return asyncio.run(_listen(protocol, arguments, printer, duration))
    except OSError as error:
        raise Failure(why_not(error)) from None


def _live(protocol: Protocol, arguments: argparse.Namespace, duration: int | None) -> int:
    """The line in the live display."""
    from framekit.cli.screen.session import MonitorSession
    from framekit.cli.screen.show import show

    return show(MonitorSession(protocol, arguments, duration))


class _Printer:
    """Prints what is seen, as far as the filter wants it."""

    def __init__(self, protocol: Protocol, arguments: argparse.Namespace) -> None:
        from framekit.codec.plain import PlainValues

        self.protocol = protocol
        self.began = 0
        self._json, self._ascii = arguments.json, arguments.ascii
        self._plain = PlainValues(protocol)
        self._wanted = filter_of(arguments)

    def show(self, seen: Seen) -> None:
        from framekit.service.frame_log import result_of

        if seen.kind not in ("open", "closed") and not self._wanted.takes(1, seen):
            return
        seconds = (seen.at - self.began) / 1e9
        if self._json:
            print_json(seen_data(seen, seconds, self._plain, result=result_of(self.protocol, seen)))
        else:
            print(seen_text(seen, seconds, "", self._ascii))
        sys.stdout.flush()

    def summary(self, monitor: LineMonitor, now: int) -> None:
        counters, share = monitor.listener.counters, monitor.load.share(now)
        if self._json:
            line = {
                "event": "line",
                "frames": counters.received,
                "bad": counters.bad,
                "noise_bytes": counters.noise_bytes,
                "line_measured": None if share is None else round(share, 6),
            }
            print_json(line)
        else:
            load = "" if share is None else f", line load {100 * share:.1f} %"
            print(f"{counters.received} frames, {counters.bad} bad, {counters.noise_bytes} bytes of noise{load}")


def monitor_of(
    protocol: Protocol,
    arguments: argparse.Namespace,
    clock: Clock,
    show: Callable[[Seen], None],
    on_state: Callable[[str], None] | None = None,
) -> tuple[LineMonitor, Capture | None]:
    """The monitor that a command line asks for, and its capture. Raises Failure, OSError."""
    from framekit.link.parameters import ParameterError
    from framekit.service.capture import Capture
    from framekit.service.line_monitor import LineMonitor
    from framekit.transport.schemes import open_port

    try:
        port = open_port(protocol.line.port_of(arguments.port), line_of(protocol, arguments), clock, listen_only=True)
    except ValueError as error:
        raise WrongWords(str(error)) from None
    capture = None
    if arguments.capture is not None:
        capture = Capture(arguments.capture, (1,), clock)
        port = capture.around(1, port)
    try:
        return LineMonitor(protocol, port, clock, show, params=params_of(arguments), on_state=on_state), capture
    except ParameterError as error:
        raise WrongWords(str(error)) from None


async def _listen(protocol: Protocol, arguments: argparse.Namespace, printer: _Printer, duration: int | None) -> int:
    """Until the time is over, or SIGINT or SIGTERM asks to stop. Raises NoPort."""
    from framekit.transport.clock import AsyncioClock

    loop = asyncio.get_running_loop()
    clock, ended = AsyncioClock(loop), asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, ended.set)
    failed: list[str] = []
    opened: list[str] = []

    def state(text: str) -> None:
        if text == "open":
            opened.append(text)
        elif not opened:
            failed.append(text)
            ended.set()

    monitor, capture = monitor_of(protocol, arguments, clock, printer.show, state)
    printer.began = clock.now()
    monitor.start()
    try:
        await asyncio.wait_for(ended.wait(), None if duration is None else duration / 1e9)
    except TimeoutError:
        pass
    finally:
        monitor.stop()
        if capture is not None:
            capture.close()
    if failed:
        raise NoPort(failed[0])
    printer.summary(monitor, clock.now())
    lost = [] if capture is None else capture.troubles
    for trouble in lost:
        print(trouble, file=sys.stderr)
    return 1 if lost else 0
