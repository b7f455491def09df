"""What `read`, `write` and `call` share: how a line is named, a client on it, and what failures print and return.

Exit status: 0 done, 1 the device refused, 2 what was asked cannot be asked, 3 no good answer came.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from framekit.cli.common import add_json, add_protocol, assignment, load, print_json
from framekit.cli.main import WrongWords
from framekit.transport.schemes import help_on_ports

if TYPE_CHECKING:
    from framekit.api.client import Client
    from framekit.api.errors import FramekitError
    from framekit.api.settings import LineSettings
    from framekit.definition.model.protocol import Protocol
    from framekit.link.addresses import AddressGrammar
    from framekit.link.observe import Seen

TIMEOUT, RETRIES = "reply_timeout", "retries"
"""The parameters that --timeout and --retries stand for."""


def add_line(parser: argparse.ArgumentParser, *, port_required: bool = True) -> None:
    """PROTOCOL and the options that name a line and a device on it."""
    add_protocol(parser)
    parser.add_argument("--port", required=port_required, help=help_on_ports("sim:FILE"))
    parser.add_argument("--station", metavar="N", help="the device's station")
    parser.add_argument("--speed", type=int, metavar="BITS", help="bits a second; default: the protocol's")
    parser.add_argument("--format", metavar="8E1", help="data bits, parity, stop bits; default: the protocol's")
    parser.add_argument("--own", metavar="N", help="the own station, where the protocol has one")
    parser.add_argument("--role", help="the own role, where the protocol leaves a choice")
    parser.add_argument(
        "--param", action="append", default=[], metavar="NAME=VALUE", help="value of a parameter; may be repeated"
    )
    parser.add_argument("--timeout", metavar="TIME", help=f"the same as --param {TIMEOUT}=TIME")
    parser.add_argument("--retries", metavar="N", help=f"the same as --param {RETRIES}=N")
    parser.add_argument("--frames", action="store_true", help="show the frames on standard error")
    add_json(parser)


def add_type(parser: argparse.ArgumentParser) -> None:
    """--type and --order."""
    from framekit.memory.views import ORDERS, VIEWS

    parser.add_argument(
        "--type",
        metavar="TYPE",
        help=f"bit, byte, word, dword, lword, {', '.join(VIEWS)}; default: as the address says",
    )
    parser.add_argument(
        "--order", choices=ORDERS, help="where the bytes of a number stand; default: CDAB, low word first"
    )


def carry_out(
    arguments: argparse.Namespace, action: Callable[[Client], None], *, to_station: bool = True,
    check: Callable[[AddressGrammar], object] | None = None,
) -> int:  # fmt: skip
    """Connects and acts; the exit status. `to_station`: nothing can be done without knowing which.

    `check` raises RequestError for what cannot be asked on any line: where there is no line, that is what is told.
    """
    from framekit.api.async_client import AsyncClient
    from framekit.api.client import Client
    from framekit.api.errors import FramekitError, LineClosedError, RequestError
    from framekit.link.addresses import AddressGrammar

    try:
        settings = settings_of(arguments)
        settings.station_for(None, needed=to_station)
        with Client(AsyncClient(settings, monitor=show if arguments.frames else None)) as client:
            action(client)
    except LineClosedError as error:
        protocol = settings.protocol
        try:
            if check is not None:
                check(AddressGrammar(protocol.addresses, protocol.areas, protocol.tables))
        except RequestError as wrong:
            return failed(arguments, wrong)
        return failed(arguments, error)
    except FramekitError as error:
        return failed(arguments, error)
    return 0


def settings_of(arguments: argparse.Namespace, protocol: Protocol | None = None) -> LineSettings:
    """The line that is named; `protocol`: if it is loaded already. Raises DefinitionError, RequestError."""
    from framekit.api.settings import line_settings

    params = assignments(arguments.param)
    for name, value in ((TIMEOUT, arguments.timeout), (RETRIES, arguments.retries)):
        if value is not None:
            params[name] = value
    return line_settings(
        protocol or load(arguments.protocol), arguments.port, station=arguments.station, speed=arguments.speed,
        format=arguments.format, own=arguments.own, role=arguments.role, params=params,
    )  # fmt: skip


def assignments(texts: Sequence[str]) -> dict[str, Any]:
    """Several NAME=VALUE. Raises RequestError."""
    from framekit.api.errors import RequestError

    try:
        return dict(assignment(text) for text in texts)
    except WrongWords as failure:
        raise RequestError(str(failure)) from None


def failed(arguments: argparse.Namespace, error: FramekitError) -> int:
    """Prints what went wrong; the exit status."""
    from framekit.api.errors import ExchangeError, LineClosedError, NoReplyError, RefusedError, ReplyError, RequestError
    from framekit.blocks.error_codes import ErrorCode

    if arguments.json and isinstance(error, ExchangeError):
        shown: dict[str, Any] = {"error": error.outcome, "message": str(error)}
        if isinstance(error, RefusedError):
            shown |= {"code": error.code, "meaning": error.meaning}
        print_json(shown)
    print(f"framekit {arguments.verb}: {error}", file=sys.stderr)
    if isinstance(error, RequestError):
        return 2
    if isinstance(error, ExchangeError) and error.error_code is ErrorCode.FAILED:
        return 3  # a name that the protocol gives to an exchange without a good answer
    return 3 if isinstance(error, (NoReplyError, ReplyError, LineClosedError)) else 1


def show(seen: Seen) -> None:
    """A line on standard error for everything that goes over the line."""
    from framekit.cli.seen_output import seen_text

    if seen.kind not in ("open", "closed"):
        print(seen_text(seen, "", "").lstrip(), file=sys.stderr, flush=True)
