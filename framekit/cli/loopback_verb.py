"""`framekit loopback PORT`: tests a port whose transmitted data is wired back, and says what failed."""

from __future__ import annotations

import argparse
import asyncio
from typing import TYPE_CHECKING, Any

from framekit.cli.common import add_json, print_json, table
from framekit.cli.main import WrongWords

if TYPE_CHECKING:
    from framekit.definition.times import LineFormat
    from framekit.service.loopback import LoopbackResult

SPEEDS = "1200,9600,19200,38400,115200"
SIMULATED = "sim:loop"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "port", metavar="PORT", help=f"/dev/ttyUSB0, any pyserial URL, or {SIMULATED} for a simulated one"
    )
    parser.add_argument("--speeds", default=SPEEDS, metavar="N,N…", help=f"bits a second; default: {SPEEDS}")
    parser.add_argument("--formats", default="8N1", metavar="F,F…", help="such as 8N1,7E1; default: 8N1")
    add_json(parser)


def run(arguments: argparse.Namespace) -> int:
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
                raise WrongWords(f"'{speed.strip()}' is not a speed – write bits a second, such as 9600")
            try:
                found.append(parse_format(form, int(speed)))
            except ValueError as error:
                raise WrongWords(str(error)) from None
    return found


def _simulated(lines: list[LineFormat]) -> list[LoopbackResult]:
    from framekit.service.loopback import Loopback
    from framekit.transport.clock import VirtualClock
    from framekit.transport.port import Port
    from framekit.transport.simulated_line import SimulatedLine

    clock = VirtualClock()
    found: list[LoopbackResult] = []

    def make(line: LineFormat) -> Port:
        return SimulatedLine(clock, line, echo=True).port("loop")

    Loopback(make, clock, lines, found.extend).start()
    clock.run_until_idle(1 << 60)
    return found


async def _real(url: str, lines: list[LineFormat]) -> list[LoopbackResult]:
    from framekit.service.loopback import Loopback
    from framekit.transport.clock import AsyncioClock
    from framekit.transport.schemes import open_port

    loop = asyncio.get_running_loop()
    clock = AsyncioClock(loop)
    ended: asyncio.Future[list[LoopbackResult]] = loop.create_future()
    try:
        Loopback(lambda line: open_port(url, line, clock), clock, lines, ended.set_result).start()
    except ValueError as error:
        raise WrongWords(str(error)) from None
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
