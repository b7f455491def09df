"""`framekit replay FILE --port PORT`: sends what went in one direction of a capture, in its own time or faster.

To a port, or, on a listener, to whoever connects first.
"""

from __future__ import annotations

import argparse
import asyncio
import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from framekit.cli.common import add_json, existing, print_json, why_not
from framekit.cli.main import Failure, NoPort, WrongWords
from framekit.transport.schemes import help_on_ports

if TYPE_CHECKING:
    from framekit.definition.times import LineFormat
    from framekit.transport.clock import AsyncioClock
    from framekit.transport.port import LineEvent, Port


def add_arguments(parser: argparse.ArgumentParser) -> None:
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


def run(arguments: argparse.Namespace) -> int:
    from framekit.definition.times import parse_format

    if arguments.speed_up <= 0:
        raise WrongWords(f"--speed-up {arguments.speed_up:g}: write a number above 0")
    try:
        line = parse_format(arguments.format, arguments.speed)
    except ValueError as error:
        raise WrongWords(str(error)) from None
    events = _events(arguments)
    return asyncio.run(_replay(arguments, line, events))


def _events(arguments: argparse.Namespace) -> list[LineEvent]:
    """What is to be sent, from one channel. Raises Failure."""
    from framekit.service.capture import CaptureError, CaptureReader

    try:
        with CaptureReader(existing(arguments.file)) as reader:
            found = [
                (channel, event)
                for channel, event in reader.events()
                if event.kind == "data" and event.direction == arguments.direction
            ]
    except CaptureError as error:
        raise Failure(str(error)) from None
    channels = sorted({channel for channel, _ in found})
    if arguments.channel is None and len(channels) > 1:
        raise WrongWords(f"the capture has the channels {', '.join(map(str, channels))} – choose one with --channel")
    events = [event for channel, event in found if arguments.channel in (None, channel)]
    if not events:
        raise WrongWords(f"the capture has no bytes of direction {arguments.direction} there – try --direction")
    return events


async def _replay(arguments: argparse.Namespace, line: LineFormat, events: list[LineEvent]) -> int:
    from framekit.service.replay import Replay
    from framekit.transport.clock import AsyncioClock

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
        raise (Failure if replay.began else NoPort)(reason)
    return 0


async def _port(arguments: argparse.Namespace, line: LineFormat, clock: AsyncioClock) -> Port:
    """The port, not yet opened; where it is to be a listener, the first connection. Raises WrongWords, NoPort."""
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
        raise WrongWords(str(error)) from None
    try:
        await listener.start()
    except OSError as error:
        raise NoPort(f"{arguments.port}: {why_not(error)}") from None
    print(f"waiting for a connection to {listener.reached.partition('://')[2]}", file=sys.stderr, flush=True)
    try:
        return await first
    finally:
        listener.stop()
