"""`framekit call PROTOCOL --port PORT --station N SERVICE [NAME=VALUE …]`: runs a service of a device."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from framekit.cli.common import print_json
from framekit.cli.one_shot import add_line, assignments, carry_out

if TYPE_CHECKING:
    from framekit.api.client import Client


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_line(parser)
    parser.add_argument("service", metavar="SERVICE", help="a service of the protocol, other than read and write")
    parser.add_argument("arguments", nargs="*", metavar="NAME=VALUE", help="an argument; JSON for lists and records")
    parser.add_argument("--address", action="append", default=[], help="an address it is about; may be repeated")
    parser.add_argument("-n", "--count", type=int, default=1, metavar="COUNT", help="elements from one address on")


def run(arguments: argparse.Namespace) -> int:
    from framekit.codec.plain import PlainValues

    def call(client: Client) -> None:
        given = assignments(arguments.arguments)
        answer = client.call(arguments.service, given, addresses=arguments.address, count=arguments.count)
        results = PlainValues(client.protocol).to_plain("", answer.results)
        if arguments.json:
            print_json({"service": arguments.service, "results": results})
        else:
            for name, value in results.items():
                print(f"{name}: {value}")

    return carry_out(arguments, call, to_station=False)
