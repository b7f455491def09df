"""The verbs of a line without a run: `monitor` shows it, `replay` sends a capture again, `loopback` tests a port."""

from __future__ import annotations

import argparse
import asyncio
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from framekit.api.monitor import FrameLog, LineOf, LiveView
from framekit.cli.common import (
    PortError,
    VerbError,
    WordsError,
    add_capture,
    add_filter,
    add_json,
    add_line,
    add_log,
    add_params,
    add_protocol,
    add_screen,
    begin_log,
    duration_of,
    existing,
    filter_of,
    line_of,
    load,
    params_of,
    print_json,
    seen_data,
    seen_text,
    table,
    why_not,
)
from framekit.cli.screen.session import LiveSession
from framekit.transport.clock import AsyncioClock, Clock, VirtualClock
from framekit.transport.schemes import help_on_ports

if TYPE_CHECKING:
    from framekit.api.lines import LoopbackResult
    from framekit.api.monitor import LineMonitor
    from framekit.definition.model.protocol import Protocol
    from framekit.definition.times import LineFormat
    from framekit.link.observe import Seen
    from framekit.service.capture import Capture
    from framekit.transport.port import LineEvent, Port


def add_monitor_arguments(parser: argparse.ArgumentParser) -> None:
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


def run_monitor(arguments: argparse.Namespace) -> int:
    protocol = load(arguments.protocol)
    duration = duration_of(arguments.duration)
    begin_log(arguments.log)
    if arguments.screen:
        return _live(protocol, arguments, duration)
    printer = _Printer(protocol, arguments)
    try:
        return asyncio.run(_listen(protocol, arguments, printer, duration))
    except OSError as error:
        raise VerbError(why_not(error)) from None


def _live(protocol: Protocol, arguments: argparse.Namespace, duration: int | None) -> int:
    """The line in the live display."""
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
        from framekit.api.monitor import result_of

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
    """The monitor that a command line asks for, and its capture. Raises VerbError, OSError."""
    from framekit.api.monitor import LineMonitor
    from framekit.link.parameters import ParameterError
    from framekit.service.capture import Capture
    from framekit.transport.schemes import open_port

    try:
        port = open_port(protocol.line.port_of(arguments.port), line_of(protocol, arguments), clock, listen_only=True)
    except ValueError as error:
        raise WordsError(str(error)) from None
    capture = None
    if arguments.capture is not None:
        capture = Capture(arguments.capture, (1,), clock)
        port = capture.around(1, port)
    try:
        return LineMonitor(protocol, port, clock, show, params=params_of(arguments), on_state=on_state), capture
    except ParameterError as error:
        raise WordsError(str(error)) from None


async def _listen(protocol: Protocol, arguments: argparse.Namespace, printer: _Printer, duration: int | None) -> int:
    """Until the time is over, or SIGINT or SIGTERM asks to stop. Raises PortError."""
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
        raise PortError(failed[0])
    printer.summary(monitor, clock.now())
    lost = [] if capture is None else capture.troubles
    for trouble in lost:
        print(trouble, file=sys.stderr)
    return 1 if lost else 0


class MonitorSession(LiveSession):
    """A line between others."""

    def __init__(self, protocol: Protocol, arguments: argparse.Namespace, duration: int | None) -> None:
        self.title = f"monitor {arguments.port}"
        self.protocol = protocol
        self.problems: list[str] = []
        self._arguments = arguments
        self._duration = duration
        self._monitor: LineMonitor | None = None
        self._capture: Capture | None = None
        self._view: LiveView | None = None
        self._state = "opening"

    def begin(self) -> LiveView:
        """Raises VerbError, OSError."""
        clock = AsyncioClock(asyncio.get_running_loop())
        log = FrameLog({1: self.protocol}, params={1: params_of(self._arguments)})

        def state(text: str) -> None:
            self._state = text

        self._monitor, self._capture = monitor_of(
            self.protocol, self._arguments, clock, lambda seen: log.add(1, seen), state
        )
        settings = self._monitor.port.settings
        name = self.protocol.name + ("" if settings is None else f" {settings}")
        self._view = LiveView(log, clock, {1: LineOf(name, lambda: self._state, self._monitor.load)})
        self._monitor.start()
        return self._view

    @property
    def is_over(self) -> bool:
        return self._duration is not None and self._view is not None and self._view.elapsed >= self._duration

    async def end(self) -> None:
        if self._monitor is not None:
            self._monitor.stop()
        if self._capture is not None:
            self._capture.close()
            self.problems = self._capture.troubles
            self.lost = bool(self.problems)


def add_replay_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", metavar="FILE", type=Path, help="a capture: pcap or JSON lines")
    parser.add_argument(
        "--port", required=True, metavar="PORT",
        help=help_on_ports("tcp-listen://HOST:PORT for the first that connects"),
    )  # fmt: skip
    parser.add_argument(
        "--direction", choices=("in", "out"), default="out", help="which bytes to send; default: those once sent"
    )
    parser.add_argument("--channel", type=int, help="which channel of a capture that has several")
    pace = parser.add_mutually_exclusive_group()
    pace.add_argument("--speed-up", type=float, default=1.0, metavar="N", help="so many times faster than it was")
    pace.add_argument("--as-fast", action="store_true", help="without pauses")
    parser.add_argument("--speed", type=int, default=9600, help="line speed in bits a second; default: 9600")
    parser.add_argument("--format", default="8N1", help="data bits, parity and stop bits; default: 8N1")
    add_json(parser)


def run_replay(arguments: argparse.Namespace) -> int:
    from framekit.definition.times import parse_format

    if arguments.speed_up <= 0:
        raise WordsError(f"--speed-up {arguments.speed_up:g}: write a number above 0")
    try:
        line = parse_format(arguments.format, arguments.speed)
    except ValueError as error:
        raise WordsError(str(error)) from None
    events = _events(arguments)
    return asyncio.run(_replay(arguments, line, events))


def _events(arguments: argparse.Namespace) -> list[LineEvent]:
    """What is to be sent, from one channel. Raises VerbError."""
    from framekit.service.capture import CaptureError, CaptureReader

    try:
        with CaptureReader(existing(arguments.file)) as reader:
            found = [
                (channel, event)
                for channel, event in reader.events()
                if event.kind == "data" and event.direction == arguments.direction
            ]
    except CaptureError as error:
        raise VerbError(str(error)) from None
    channels = sorted({channel for channel, _ in found})
    if arguments.channel is None and len(channels) > 1:
        raise WordsError(f"the capture has the channels {', '.join(map(str, channels))} – choose one with --channel")
    events = [event for channel, event in found if arguments.channel in (None, channel)]
    if not events:
        raise WordsError(f"the capture has no bytes of direction {arguments.direction} there – try --direction")
    return events


async def _replay(arguments: argparse.Namespace, line: LineFormat, events: list[LineEvent]) -> int:
    from framekit.api.lines import Replay

    loop = asyncio.get_running_loop()
    ended: asyncio.Future[str] = loop.create_future()
    clock = AsyncioClock(loop)
    port = await _port(arguments, line, clock)
    speed_up = None if arguments.as_fast else arguments.speed_up
    replay = Replay(events, port, clock, ended.set_result, direction=arguments.direction, speed_up=speed_up)
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, replay.stop)
    replay.start()
    reason = await ended
    seconds = (replay.ended_at - replay.began) / 1e9 if replay.began else 0.0
    if arguments.json:
        told = {"sent": replay.bytes_sent, "pieces": replay.pieces_sent, "of": replay.pieces}
        print_json(told | {"received": replay.bytes_received, "seconds": round(seconds, 6), "reason": reason})
    else:
        pieces = f"{replay.pieces_sent} of {replay.pieces} pieces"
        print(f"sent {pieces}, {replay.bytes_sent} bytes in {seconds:.3f} s; {replay.bytes_received} bytes came")
    if reason:
        raise (VerbError if replay.began else PortError)(reason)
    return 0


async def _port(arguments: argparse.Namespace, line: LineFormat, clock: AsyncioClock) -> Port:
    """The port, not yet opened; where it is to be a listener, the first connection. Raises WordsError, PortError."""
    from framekit.transport.port import AcceptedPort
    from framekit.transport.schemes import make_listener, open_port, scheme_of

    first: asyncio.Future[AcceptedPort] = clock.loop.create_future()

    def accepted(port: AcceptedPort) -> None:
        if first.done():
            port.close()
        else:
            first.set_result(port)

    kind = scheme_of(arguments.port)
    try:
        if kind is None or kind.open is not None:
            return open_port(arguments.port, line, clock)
        listener = make_listener(arguments.port, clock, accepted)
    except ValueError as error:
        raise WordsError(str(error)) from None
    try:
        await listener.start()
    except OSError as error:
        raise PortError(f"{arguments.port}: {why_not(error)}") from None
    print(f"waiting for a connection to {listener.reached.partition('://')[2]}", file=sys.stderr, flush=True)
    try:
        return await first
    finally:
        listener.stop()


SPEEDS = "1200,9600,19200,38400,115200"
SIMULATED = "sim:loop"


def add_loopback_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "port", metavar="PORT", help=f"/dev/ttyUSB0, any pyserial URL, or {SIMULATED} for a simulated one"
    )
    parser.add_argument("--speeds", default=SPEEDS, metavar="N,N…", help=f"bits a second; default: {SPEEDS}")
    parser.add_argument("--formats", default="8N1", metavar="F,F…", help="such as 8N1,7E1; default: 8N1")
    add_json(parser)


def run_loopback(arguments: argparse.Namespace) -> int:
    lines = _lines(arguments)
    results = _simulated(lines) if arguments.port == SIMULATED else asyncio.run(_real(arguments.port, lines))
    if arguments.json:
        for result in results:
            print_json(_data(result))
    else:
        print(table([_row(result) for result in results], ("speed and format", "sent", "back", "time", "result")))
    return 0 if all(result.passed for result in results) else 1


def _lines(arguments: argparse.Namespace) -> list[LineFormat]:
    from framekit.definition.times import parse_format

    found = []
    for speed in arguments.speeds.split(","):
        for form in arguments.formats.split(","):
            if not speed.strip().isdigit():
                raise WordsError(f"'{speed.strip()}' is not a speed – write bits a second, such as 9600")
            try:
                found.append(parse_format(form, int(speed)))
            except ValueError as error:
                raise WordsError(str(error)) from None
    return found


def _simulated(lines: list[LineFormat]) -> list[LoopbackResult]:
    from framekit.api.lines import Loopback
    from framekit.transport.simulated_line import SimulatedLine

    clock = VirtualClock()
    found: list[LoopbackResult] = []

    def make(line: LineFormat) -> Port:
        return SimulatedLine(clock, line, echo=True).port("loop")

    Loopback(make, clock, lines, found.extend).start()
    clock.run_until_idle(1 << 60)
    return found


async def _real(url: str, lines: list[LineFormat]) -> list[LoopbackResult]:
    from framekit.api.lines import Loopback
    from framekit.transport.schemes import open_port

    loop = asyncio.get_running_loop()
    clock = AsyncioClock(loop)
    ended: asyncio.Future[list[LoopbackResult]] = loop.create_future()
    try:
        Loopback(lambda line: open_port(url, line, clock), clock, lines, ended.set_result).start()
    except ValueError as error:
        raise WordsError(str(error)) from None
    return await ended


def _row(result: LoopbackResult) -> tuple[str, ...]:
    told = "; ".join(("passed" if result.passed else "failed: " + "; ".join(result.problems), *result.remarks))
    return str(result.line), str(result.sent), str(result.received), f"{result.measured_time / 1e6:.1f} ms", told


def _data(result: LoopbackResult) -> dict[str, Any]:
    return {
        "line": str(result.line),
        "passed": result.passed,
        "sent": result.sent,
        "received": result.received,
        "seconds": result.measured_time / 1e9,
        "seconds_expected": result.expected_time / 1e9,
        "problems": result.problems,
        "remarks": result.remarks,
    }
