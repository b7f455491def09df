"""`framekit read PROTOCOL --port PORT --station N ADDRESS …`: values of a device, once or again and again."""

from __future__ import annotations

import argparse
import itertools
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from framekit.cli.common import print_json, table
from framekit.cli.one_shot import add_line, add_type, carry_out, failed

if TYPE_CHECKING:
    from framekit.api.client import Client
    from framekit.api.results import Reading
    from framekit.link.addresses import AddressGrammar


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_line(parser)
    parser.add_argument("addresses", nargs="+", metavar="ADDRESS", help="as the protocol writes addresses")
    parser.add_argument(
        "-n",
        "--count",
        type=int,
        default=1,
        metavar="COUNT",
        help="values from each address on; of a string, characters",
    )
    add_type(parser)
    parser.add_argument("--every", metavar="TIME", help="read again and again, such as every 1s, until Ctrl-C")
    parser.add_argument("--times", type=int, metavar="N", help="with --every: stop after N readings")


def run(arguments: argparse.Namespace) -> int:
    def check(grammar: AddressGrammar) -> None:
        from framekit.api.typed import typed

        for address in arguments.addresses:
            typed(grammar, address, arguments.type, arguments.order, arguments.count)

    if arguments.every is None:
        return carry_out(arguments, lambda client: output(arguments, read(client, arguments)), check=check)
    status = 0

    def repeat(client: Client) -> None:
        nonlocal status
        try:
            for _ in cycle(arguments.every, arguments.times):
                status = once(client, arguments)
        except KeyboardInterrupt:
            return

    return carry_out(arguments, repeat, check=check) or status


def cycle(every: str, times: int | None) -> Iterator[None]:
    """Comes round at the times of reading, without drift; times that were missed are left out. Raises RequestError."""
    from framekit.api.errors import RequestError
    from framekit.definition.times import parse_time

    try:
        period = max(1, parse_time(every))
    except ValueError as error:
        raise RequestError(f"--every: {error}") from None
    if times is not None and times < 1:
        raise RequestError(f"--times: {times} is no number of readings – give 1 or more")
    begin = time.monotonic_ns()
    for number in itertools.count():
        if number == times:
            return
        if number:
            begin += ((time.monotonic_ns() - begin) // period + 1) * period
            time.sleep(max(0, begin - time.monotonic_ns()) / 1e9)
        yield


def once(client: Client, arguments: argparse.Namespace) -> int:
    """One of many readings: a failure is printed, and it goes on."""
    from framekit.api.errors import ExchangeError

    try:
        output(arguments, read(client, arguments))
    except ExchangeError as error:
        return failed(arguments, error)
    return 0


def read(client: Client, arguments: argparse.Namespace) -> list[Reading[Any]]:
    """The readings of all addresses; in one request where each is one value."""
    addresses, type_, order = arguments.addresses, arguments.type, arguments.order
    if len(addresses) > 1 and arguments.count == 1 and type_ != "string":
        return [client.read_many(addresses, type=type_, order=order)]
    return [client.read(address, arguments.count, type=type_, order=order) for address in addresses]


def output(arguments: argparse.Namespace, readings: list[Reading[Any]]) -> None:
    """One JSON object, or a line for each address."""
    if arguments.json:
        shown = {
            "station": _plain(readings[0].station),
            "addresses": arguments.addresses,
            "type": readings[0].type,
            "values": [value for reading in readings for value in reading],
        }
        print_json(shown)
        return
    if len(readings) < len(arguments.addresses):
        values = [[value] for value in readings[0]]
    else:
        values = [list(reading) for reading in readings]
    rows = [
        (address, " ".join(_shown(item, readings[0].type) for item in some))
        for address, some in zip(arguments.addresses, values, strict=True)
    ]
    print(table(rows[1:], rows[0]), flush=True)


def _shown(value: Any, type_: str) -> str:
    return f"{value:.7g}" if isinstance(value, float) and "float32" in type_ else str(value)


def _plain(station: Any) -> Any:
    return station.hex(" ").upper() if isinstance(station, bytes) else station
