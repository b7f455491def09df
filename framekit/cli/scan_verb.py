"""`framekit scan PORT PROTOCOL`: find the stations of a line, and their speed and format, by harmless requests."""

from __future__ import annotations

import argparse
import re
from typing import TYPE_CHECKING, Any

from framekit.cli.common import (
    ProgressLine,
    WordsError,
    add,
    assignments,
    in_words,
    plain,
    print_json,
    run_in_loop,
    table,
    tell_error,
    until_stopped,
)
from framekit.definition.problems import plural
from framekit.transport.schemes import help_on_ports

if TYPE_CHECKING:
    from framekit.api.scan import FoundDevice, Scan

HEAD = ("port", "line", "station", "answer", "time")
"""Columns of the table; without `--hosts` it has no ports."""
PORT_FIRST = r"/dev/|COM\d|[a-z][a-z0-9-]+:"
"""The begin of a port, but not of the name or the file of a protocol."""


def add_scan_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("port", metavar="PORT", help=help_on_ports("sim:FILE"))
    add(parser, "protocol")
    parser.add_argument(
        "--stations", metavar="N..N", help="such as 1..32 or 1,2,5; default: 1..32, or those of the protocol"
    )
    parser.add_argument("--speeds", metavar="N,N…", help="bits a second; default: the protocol's")
    parser.add_argument("--formats", metavar="F,F…", help="such as 8N1,8E1; default: the protocol's")
    parser.add_argument(
        "--hosts", metavar="NETWORK", action="append", default=[],
        help="hosts for {host} in PORT: names, addresses, or a network such as 10.0.0.0/28; may be repeated",
    )  # fmt: skip
    parser.add_argument(
        "--timeout", metavar="TIME", help="time limit for each reply, such as 100ms; default: the protocol's"
    )
    parser.add_argument("--own", metavar="N", help="the own station, where the protocol has one")
    parser.add_argument("--role", help="the own role, where the protocol leaves a choice")
    add(parser, "--param", "--json")


def run_scan(arguments: argparse.Namespace) -> int:
    from framekit.api.scan import Scan, stations_of
    from framekit.cli.common import load

    if re.match(PORT_FIRST, arguments.protocol) and not re.match(PORT_FIRST, arguments.port):
        raise WordsError(f"write the port first: framekit scan {arguments.protocol} {arguments.port}")
    protocol = load(arguments.protocol)
    with in_words():
        scan = Scan(
            protocol, arguments.port,
            stations=None if arguments.stations is None else stations_of(arguments.stations),
            speeds=_speeds(arguments.speeds), formats=_parts(arguments.formats),
            hosts=[host for text in arguments.hosts for host in _parts(text)], timeout=arguments.timeout,
            role=arguments.role, own=arguments.own, params=assignments(arguments.param),
        )  # fmt: skip
    found: list[FoundDevice] = []
    with until_stopped(), ProgressLine("scan", lambda: _progress(scan, found)), in_words():
        run_in_loop(_collect(scan, found, arguments.json))
    if not arguments.json and found:
        first = 0 if arguments.hosts else 1
        print(table([_row(device)[first:] for device in found], HEAD[first:]))
    if scan.unreachable and not arguments.json:
        print(f"{plural(len(scan.unreachable), 'host')} without a connection")
    if not found:
        request = scan.probe.call or f"read {scan.probe.read}"
        tell_error(arguments, "no_reply", f"no device has answered {plural(scan.done, 'request')} ({request})")
    return 0 if found else 3


async def _collect(scan: Scan, found: list[FoundDevice], as_json: bool) -> None:
    async for device in scan.devices():
        found.append(device)
        if as_json:
            print_json(
                {
                    "port": device.port, "line": device.line, "station": plain(device.station),
                    "answer": device.answer, "detail": device.detail, "time": round(device.seconds, 6),
                }
            )  # fmt: skip


def _progress(scan: Scan, found: list[FoundDevice]) -> str:
    return f"{scan.done:,} of {scan.total:,} requests, {plural(len(found), 'device')}"


def _row(device: FoundDevice) -> tuple[str, ...]:
    station = "-" if device.station is None else _station_text(device.station)
    answer = f"{device.answer}: {device.detail}" if device.detail else device.answer
    return device.port, device.line or "-", station, answer, f"{device.seconds * 1000:.0f} ms"


def _station_text(station: Any) -> str:
    """Return a station as `--stations` takes it: a padded text without its padding."""
    text = station.rstrip(b"\0") if isinstance(station, bytes) else b""
    return text.decode("ascii") if text.isalnum() else str(plain(station))


def _parts(text: str | None) -> list[str]:
    return [] if text is None else [part.strip() for part in text.split(",") if part.strip()]


def _speeds(text: str | None) -> list[int]:
    try:
        return [int(part) for part in _parts(text)]
    except ValueError:
        raise WordsError(f"--speeds: '{text}' are no speeds – write them like 9600,19200") from None
