"""The verbs of a line without a run: `monitor` shows it, `replay` sends a capture again, `loopback` tests a port."""

from __future__ import annotations

import argparse
import asyncio
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from framekit.cli.common import (
    ARROWS,
    PortError,
    ProgressLine,
    VerbError,
    WordsError,
    add,
    assignments,
    begin_log,
    duration_of,
    existing,
    filter_of,
    in_words,
    line_of,
    load,
    print_json,
    print_trouble,
    seen_data,
    seen_text,
    table,
    until,
    why_not,
)
from framekit.cli.live_output import LiveOutput, live_output
from framekit.cli.live_session import LiveSession, show
from framekit.definition.problems import plural
from framekit.transport.schemes import help_on_ports

if TYPE_CHECKING:
    from framekit import Seen
    from framekit.api.monitor import LineEvent, LineMonitor, LiveView, LoopbackResult, Replay
    from framekit.definition.model.protocol import Protocol
    from framekit.definition.times import LineFormat


def add_monitor_arguments(parser: argparse.ArgumentParser) -> None:
    add(parser, "protocol")
    parser.add_argument("--port", required=True, metavar="PORT", help=help_on_ports())
    add(parser, "--speed", "--format", "--param", "--filter", "--frame-name", "--bad")
    parser.add_argument("--bytes", action="store_true", help="show the bytes of frames instead of their fields")
    add(parser, "--ascii", help="show bytes, as ASCII")
    add(parser, "--screen", "--capture", "--log", "--for", "--json")


def run_monitor(arguments: argparse.Namespace) -> int:
    protocol = load(arguments.protocol)
    duration = duration_of(arguments.duration)
    if arguments.screen:
        begin_log(arguments.log)
        return show(MonitorSession(protocol, arguments, duration))
    printer = _Printer(protocol, arguments)
    with live_output(arguments.json, goes_on="the capture" if arguments.capture is not None else "") as live:
        begin_log(arguments.log)
        try:
            return asyncio.run(_listen(protocol, arguments, printer, duration, live))
        except OSError as error:
            raise VerbError(why_not(error)) from None


class _Printer:
    """Print the events that pass the filter: frames with the side that sends them and their fields, or their bytes."""

    def __init__(self, protocol: Protocol, arguments: argparse.Namespace) -> None:
        from framekit.codec.contents import Requests, contents_of

        self.protocol = protocol
        self.began = 0
        self._json, self._ascii = arguments.json, arguments.ascii
        self._shows_fields = not (arguments.bytes or arguments.ascii)
        self._contents, self._requests = contents_of(protocol), Requests()
        self._wanted = filter_of(arguments)

    def show(self, seen: Seen) -> None:
        from framekit.api.monitor import result_of

        self._requests.attach(self._contents, seen)
        if seen.kind not in ("open", "closed") and not self._wanted.takes(1, seen):
            return
        seconds = (seen.at - self.began) / 1e9
        if self._json:
            print_json(seen_data(seen, seconds, self._contents, result=result_of(self.protocol, seen)))
        elif seen.kind == "frame" and self._shows_fields:
            print(self._fields_line(seen, seconds))
        else:
            print(seen_text(seen, seconds, "", self._ascii))
        sys.stdout.flush()

    def _fields_line(self, seen: Seen, seconds: float) -> str:
        """Return the line of a frame: time, an arrow from the client or from the server, name and fields."""
        from framekit.api.rows import fields_text

        frame = self.protocol.frames.get(seen.frame)
        side = "" if frame is None else frame.side
        arrow = {"client": "→", "server": "←"}.get(side, ARROWS[seen.direction])
        place = f"{seen.client} {arrow}" if seen.client else arrow
        fields = self._contents.with_names(seen.frame, seen.fields, seen.request)
        return f"{seconds:10.3f}  {place} {seen.frame} {fields_text(fields)}".rstrip()

    def summary(self, monitor: LineMonitor) -> None:
        counters, share = monitor.listener.counters, monitor.load.share(time.monotonic_ns())
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
            frames, noise = plural(counters.received, "frame"), plural(counters.noise_bytes, "byte")
            print(f"{frames}, {counters.bad} bad, {noise} of noise{load}")


async def _listen(
    protocol: Protocol, arguments: argparse.Namespace, printer: _Printer, duration: int | None, live: LiveOutput
) -> int:
    """Listen until the time is over, or SIGINT or SIGTERM arrives; return the exit status.

    Raises WordsError, PortError.
    """
    ended = asyncio.Event()
    live.on_stop(ended.set)
    live.stops(ended.set)
    states: list[str] = []

    def state(text: str) -> None:
        states.append(text)
        if "open" not in states:
            ended.set()

    monitor = monitor_of(protocol, arguments, printer.show, state)
    monitor.watch_troubles(print_trouble)
    printer.began = time.monotonic_ns()
    monitor.start()
    try:
        with live.may_drop():
            await until(duration, ended)
    finally:
        monitor.stop()
    if states and "open" not in states:
        raise PortError(states[0])
    printer.summary(monitor)
    for trouble in monitor.lost:
        print(trouble, file=sys.stderr)
    return live.report_losses(1 if monitor.lost else 0)


def monitor_of(
    protocol: Protocol, arguments: argparse.Namespace, show: Callable[[Seen], None], on_state: Callable[[str], None]
) -> LineMonitor:
    """Return the monitor of the command line. Raises WordsError, OSError."""
    from framekit.api.monitor import LineMonitor

    line, params = line_of(protocol, arguments), assignments(arguments.param)
    with in_words():
        return LineMonitor.at(
            protocol, arguments.port, show, line=line, params=params, capture=arguments.capture, on_state=on_state
        )


class MonitorSession(LiveSession):
    """A session of the display that monitors a line."""

    def __init__(self, protocol: Protocol, arguments: argparse.Namespace, duration: int | None) -> None:
        super().__init__(f"monitor {arguments.port}", duration)
        self.protocol = protocol
        self._arguments = arguments
        self._monitor: LineMonitor | None = None
        self._state = "opening"

    def begin(self) -> LiveView:
        """Start the monitor and return its view. Raises VerbError, OSError."""
        from framekit.api.monitor import FrameLog, LineOf, LiveView

        log = FrameLog()
        log.know(1, self.protocol, None, assignments(self._arguments.param))

        def state(text: str) -> None:
            self._state = text

        self._monitor = monitor = monitor_of(self.protocol, self._arguments, lambda seen: log.add(1, seen), state)
        settings = monitor.port.settings
        name = self.protocol.name + ("" if settings is None else f" {settings}")
        monitor.start()
        return LiveView(log, time.monotonic_ns, {1: LineOf(name, lambda: self._state, monitor.load)})

    async def end(self) -> None:
        if self._monitor is not None:
            self._monitor.stop()
            self.problems = self._monitor.lost
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
    add(parser, "--speed", default=9600, help="line speed in bits a second; default: 9600")
    add(parser, "--format", default="8N1", help="data bits, parity and stop bits; default: 8N1")
    add(parser, "--json")


def run_replay(arguments: argparse.Namespace) -> int:
    from framekit.definition.times import parse_format

    if arguments.speed_up <= 0:
        raise WordsError(f"--speed-up {arguments.speed_up:g}: write a number above 0")
    try:
        line = parse_format(arguments.format, arguments.speed)
    except ValueError as error:
        raise WordsError(str(error)) from None
    from framekit.api.monitor import recorded

    path = existing(arguments.file)
    try:
        with in_words():
            events = recorded(path, arguments.direction, arguments.channel)
    except ValueError as error:
        raise VerbError(str(error)) from None
    with ProgressLine("replay") as progress, live_output(arguments.json, goes_on="the replay") as live:
        return asyncio.run(_replay(arguments, line, events, progress, live))


async def _replay(
    arguments: argparse.Namespace, line: LineFormat, events: list[LineEvent], progress: ProgressLine, live: LiveOutput
) -> int:
    from framekit.api.monitor import replay

    def waiting(place: str) -> None:
        print(f"waiting for a connection to {place}", file=sys.stderr, flush=True)

    speed_up = None if arguments.as_fast else arguments.speed_up

    def begun(replay: Replay) -> None:
        live.on_stop(replay.stop)
        progress.says = lambda: f"{replay.pieces_sent} of {plural(replay.pieces, 'piece')}"

    with in_words():
        sent, reason = await replay(
            events, arguments.port, line, direction=arguments.direction, speed_up=speed_up, waiting=waiting,
            begun=begun,
        )  # fmt: skip
    seconds = (sent.ended_at - sent.began) / 1e9 if sent.began else 0.0
    if arguments.json:
        data = {"sent": sent.bytes_sent, "pieces": sent.pieces_sent, "of": sent.pieces}
        print_json(data | {"received": sent.bytes_received, "seconds": round(seconds, 6), "reason": reason})
    else:
        pieces = f"{sent.pieces_sent} of {sent.pieces} pieces"
        gone, came = plural(sent.bytes_sent, "byte"), plural(sent.bytes_received, "byte")
        print(f"sent {pieces}, {gone} in {seconds:.3f} s; {came} came")
    if reason:
        raise (VerbError if sent.began else PortError)(reason)
    return 0


SPEEDS = "1200,9600,19200,38400,115200"


def add_loopback_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("port", metavar="PORT", help="/dev/ttyUSB0, any pyserial URL, or sim:loop for a simulated one")
    parser.add_argument("--speeds", default=SPEEDS, metavar="N,N…", help=f"bits a second; default: {SPEEDS}")
    parser.add_argument("--formats", default="8N1", metavar="F,F…", help="such as 8N1,7E1; default: 8N1")
    add(parser, "--json")


def run_loopback(arguments: argparse.Namespace) -> int:
    from framekit.api.monitor import loopback

    lines = _lines(arguments)
    with in_words():
        results = loopback(arguments.port, lines)
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


def _row(result: LoopbackResult) -> tuple[str, ...]:
    verdict = "; ".join(("passed" if result.passed else "failed: " + "; ".join(result.problems), *result.remarks))
    return str(result.line), str(result.sent), str(result.received), f"{result.measured_time / 1e6:.1f} ms", verdict


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
