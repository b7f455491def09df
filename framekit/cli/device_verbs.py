"""The verbs of one exchange with one device: `read`, `write` and `call`."""

from __future__ import annotations

import argparse
import itertools
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

from framekit.cli.common import (
    PortError,
    VerbError,
    WordsError,
    add,
    assignments,
    each_once,
    existing,
    load,
    plain,
    print_json,
    table,
    tell_error,
    time_of,
)
from framekit.definition.problems import error_text
from framekit.transport.schemes import help_on_ports, scheme_name

if TYPE_CHECKING:
    from framekit import Seen
    from framekit.api.client import Client
    from framekit.api.errors import FramekitError
    from framekit.api.settings import AddressGrammar, ClientSettings
    from framekit.api.values import Reading
    from framekit.definition.model.protocol import Protocol


TIMEOUT, RETRIES = "reply_timeout", "retries"
"""Parameters set by --timeout and --retries."""


def add_line(parser: argparse.ArgumentParser, *, port_required: bool = True) -> None:
    """Add PROTOCOL and the options that name a line and a device on it."""
    add(parser, "protocol")
    parser.add_argument("--port", required=port_required, help=help_on_ports("sim:FILE"))
    parser.add_argument("--station", metavar="N", help="the device's station")
    add(parser, "--speed", "--format")
    parser.add_argument("--own", metavar="N", help="the own station, where the protocol has one")
    parser.add_argument("--role", help="the own role, where the protocol leaves a choice")
    add(parser, "--param")
    parser.add_argument("--timeout", metavar="TIME", help=f"the same as --param {TIMEOUT}=TIME")
    parser.add_argument("--retries", metavar="N", help=f"the same as --param {RETRIES}=N")
    parser.add_argument("--frames", action="store_true", help="show the frames on standard error")
    add(parser, "--json")


def add_type(parser: argparse.ArgumentParser) -> None:
    """Add --type and --order."""
    from framekit.api.values import ORDERS, VIEWS

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
    """Connect and run an action as `connected_to` does; frames are shown without waiting for their reader."""
    from framekit.cli.live_output import live_output

    with live_output(arguments.json) if arguments.frames else nullcontext():
        return connected_to(arguments, action, to_station=to_station, check=check)


def connected_to(
    arguments: argparse.Namespace, action: Callable[[Client], None], *, to_station: bool = True,
    check: Callable[[AddressGrammar], object] | None = None,
) -> int:  # fmt: skip
    """Connect and run an action; return the exit status. `to_station`: the action requires a station.

    `check` raises RequestError for a request that is impossible on any line: if the line cannot be opened, that error
    is reported.
    """
    from framekit.api.client import AsyncClient, Client
    from framekit.api.errors import FramekitError, LineClosedError, RequestError
    from framekit.api.settings import grammar_of

    settings = None
    try:
        settings = settings_of(arguments)
        settings.station_for(None, needed=to_station)
        with Client(AsyncClient(settings, monitor=show if arguments.frames else None)) as client:
            action(client)
    except LineClosedError as error:
        try:
            if check is not None and settings is not None:
                check(grammar_of(settings.protocol))
        except RequestError as wrong:
            return failed(arguments, wrong)
        return failed(arguments, error)
    except FramekitError as error:
        return failed(arguments, error, settings)
    return 0


def settings_of(arguments: argparse.Namespace, protocol: Protocol | None = None) -> ClientSettings:
    """Return the settings of the line from the command line; `protocol`: if already loaded.

    Raises DefinitionError, RequestError, WordsError.
    """
    from framekit.api.settings import line_settings

    params = assignments(arguments.param)
    for name, value in ((TIMEOUT, arguments.timeout), (RETRIES, arguments.retries)):
        if value is not None:
            params[name] = value
    return line_settings(
        protocol or load(arguments.protocol), arguments.port, station=arguments.station, speed=arguments.speed,
        format=arguments.format, own=arguments.own, role=arguments.role, params=params,
    )  # fmt: skip


def failed(arguments: argparse.Namespace, error: FramekitError, settings: ClientSettings | None = None) -> int:
    """Print an error, with advice on `settings` if no reply came; return the exit status."""
    from framekit import ErrorCode
    from framekit.api.errors import ExchangeError, LineClosedError, NoReplyError, RefusedError, ReplyError, RequestError

    kind = error.outcome if isinstance(error, ExchangeError) else _kind_of(error)
    more = {"code": error.code, "meaning": error.meaning} if isinstance(error, RefusedError) else {}
    has_remedy = " – " in str(error) or ": set `" in str(error)
    is_silent = settings is not None and isinstance(error, NoReplyError) and not has_remedy
    advice = _look_at(settings) if settings is not None and is_silent else ""
    tell_error(arguments, kind, str(error) + (f" – {advice}" if advice else ""), **more)
    if isinstance(error, RequestError):
        return 2
    if isinstance(error, ExchangeError) and error.error_code is ErrorCode.NOT_ALLOWED:
        return 2  # no request was sent
    if isinstance(error, ExchangeError) and error.error_code is ErrorCode.FAILED:
        return 3  # a name that the protocol gives to an exchange without a good answer
    return 3 if isinstance(error, (NoReplyError, ReplyError, LineClosedError)) else 1


def _look_at(settings: ClientSettings) -> str:
    """Return advice for a missing reply: check the station, and on a serial line the settings of the device."""
    station = "" if settings.station is None else f"the station ({settings.station})"
    if scheme_name(settings.port):
        return f"check {station}" if station else ""
    own = settings.protocol.line
    line = settings.line or f"{own.speed} {own.format}"
    try_it = f"'framekit record {settings.port} --try' finds speed and format where others talk"
    return f"check {station + ', ' if station else ''}speed and format ({line}) and the wires; {try_it}"


def _kind_of(error: FramekitError) -> str:
    from framekit.api.errors import LineClosedError, RequestError

    if isinstance(error, RequestError):
        return WordsError.kind
    return PortError.kind if isinstance(error, LineClosedError) else VerbError.kind


def show(seen: Seen) -> None:
    """Print a line on standard error for each event of the line."""
    from framekit.cli.common import seen_text

    if seen.kind not in ("open", "closed"):
        print(seen_text(seen, "", "", stream=sys.stderr).lstrip(), file=sys.stderr, flush=True)


def add_read_arguments(parser: argparse.ArgumentParser) -> None:
    add_line(parser)
    parser.add_argument("addresses", nargs="+", metavar="ADDRESS", help="as the protocol writes addresses")
    add(parser, "-n, --count", default=1, help="values from each address on; of a string, characters")
    add_type(parser)
    parser.add_argument("--every", metavar="TIME", help="read again and again, such as every 1s, until Ctrl-C")
    parser.add_argument("--times", type=int, metavar="N", help="with --every: stop after N readings")


def run_read(arguments: argparse.Namespace) -> int:
    def check(grammar: AddressGrammar) -> None:
        from framekit.api.values import typed

        for address in arguments.addresses:
            typed(grammar, address, arguments.type, arguments.order, arguments.count)

    if arguments.every is None:
        return carry_out(arguments, lambda client: output(arguments, read(client, arguments)), check=check)
    from framekit.cli.live_output import live_output

    status, gone = 0, threading.Event()
    with live_output(arguments.json) as live:
        live.on_gone(gone.set)

        def repeat(client: Client) -> None:
            nonlocal status
            with live.until_stopped(), live.may_drop():
                for _ in cycle(arguments.every, arguments.times, gone):
                    status = once(client, arguments)

        status = connected_to(arguments, repeat, check=check) or status
        return live.report_losses(status)


def cycle(every: str, times: int | None, ended: threading.Event) -> Iterator[None]:
    """Yield at the times of reading, without drift, until `ended`; missed times are left out. Raises WordsError."""
    period = max(1, time_of("--every", every))
    if times is not None and times < 1:
        raise WordsError(f"--times: {times} is no number of readings – give 1 or more")
    begin = time.monotonic_ns()
    for number in itertools.count():
        if number == times:
            return
        if number:
            begin += ((time.monotonic_ns() - begin) // period + 1) * period
            if ended.wait(max(0, begin - time.monotonic_ns()) / 1e9):
                return
        yield


def once(client: Client, arguments: argparse.Namespace) -> int:
    """Read once and return the exit status; a failure is printed."""
    from framekit.api.errors import ExchangeError

    try:
        output(arguments, read(client, arguments))
    except ExchangeError as error:
        return failed(arguments, error, client.client.settings)
    return 0


def read(client: Client, arguments: argparse.Namespace) -> list[Reading[Any]]:
    """Return the readings of all addresses; in one request if each is a single value."""
    addresses, type_, order = arguments.addresses, arguments.type, arguments.order
    if len(addresses) > 1 and arguments.count == 1 and type_ != "string":
        return [client.read_many(addresses, type=type_, order=order)]
    return [client.read(address, arguments.count, type=type_, order=order) for address in addresses]


def output(arguments: argparse.Namespace, readings: list[Reading[Any]]) -> None:
    """Print one JSON object, or a line for each address."""
    if arguments.json:
        shown = {
            "station": plain(readings[0].station),
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
    _hint_at_order(arguments, values)


def _hint_at_order(arguments: argparse.Namespace, values: list[list[Any]]) -> None:
    """Print a line for the first uncommon number that is common with another order of words."""
    from framekit.api.values import likely_order

    type_ = arguments.type or ""
    for address, some in zip(arguments.addresses, values, strict=True):
        for value in some:
            likely = likely_order(type_, arguments.order, value)
            if likely is not None:
                order, other = likely
                hint = f"{address}: {_shown(value, type_)}, with --order {order} it would be {_shown(other, type_)}"
                print(f"framekit read: {hint}", file=sys.stderr)
                return


def _shown(value: Any, type_: str) -> str:
    return f"{value:.7g}" if isinstance(value, float) and "float32" in type_ else str(value)


def add_write_arguments(parser: argparse.ArgumentParser) -> None:
    add_line(parser)
    parser.add_argument("address", metavar="ADDRESS", help="as the protocol writes addresses")
    parser.add_argument("values", nargs="+", metavar="VALUE", help="decimal, 0x…, or as --type says")
    add(parser, "-n, --count", help="characters of a string, filled up with 00")
    add_type(parser)


def run_write(arguments: argparse.Namespace) -> int:
    from framekit.api.values import check_written, values_at

    texts, type_, order, count = arguments.values, arguments.type, arguments.order, arguments.count

    def check(grammar: AddressGrammar) -> None:
        check_written(grammar, arguments.address, texts, type_, order, count)

    def write(client: Client) -> None:
        values = values_at(client.place(arguments.address), texts, type_)
        client.write(arguments.address, values, type=type_, order=order, count=count)
        if arguments.json:
            print_json({"address": arguments.address, "written": len(values)})

    return carry_out(arguments, write, check=check)


def add_call_arguments(parser: argparse.ArgumentParser) -> None:
    add_line(parser)
    parser.add_argument("service", metavar="SERVICE", help="a service of the protocol, other than read and write")
    parser.add_argument(
        "arguments",
        nargs="*",
        metavar="NAME=VALUE",
        help="an argument; JSON for lists and records; @FILE for bytes of a file",
    )
    parser.add_argument(
        "--save",
        action="append",
        default=[],
        metavar="RESULT=FILE",
        help="write bytes of the results to a new file; may be repeated",
    )
    parser.add_argument("--address", action="append", default=[], help="an address it is about; may be repeated")
    add(parser, "-n, --count", default=1, help="elements from one address on")


def _file_of_result(text: str) -> tuple[str, Path]:
    """Split `RESULT=FILE` of --save. Raises WordsError, also for a file that exists."""
    name, equals, file = text.partition("=")
    if not name or not equals or not file:
        raise WordsError(f"--save: '{text}' is not RESULT=FILE")
    if os.path.lexists(file):
        raise WordsError(f"--save: {file} is there already – name another file, or delete it first")
    return name, Path(file)


def _with_files(protocol: Protocol, service: str, given: dict[str, Any]) -> dict[str, Any]:
    """Return arguments with the content of their files: `@FILE` of an argument of bytes. Raises WordsError."""
    taken = [argument for row in protocol.services.get(service, ()) for argument in row.takes]
    of_bytes = {argument.name for argument in taken if argument.type == "bytes"}
    found = dict(given)
    for name, value in given.items():
        if name in of_bytes and isinstance(value, str) and value.startswith("@"):
            path = existing(Path(value[1:]))
            try:
                found[name] = path.read_bytes()
            except OSError as error:
                raise WordsError(f"{path} cannot be read: {error_text(error)}") from None
    return found


def _bytes_of(results: Mapping[str, Any], path: str) -> bytes:
    """Return a result of bytes; names with dots are fields of records. Raises WordsError."""
    value: Any = results
    for name in path.split("."):
        if not isinstance(value, Mapping) or name not in value:
            known = ", ".join(value) if isinstance(value, Mapping) else ""
            raise WordsError(f"--save: there is no result '{path}'{f' – known: {known}' if known else ''}")
        value = value[name]
    if not isinstance(value, bytes):
        raise WordsError(f"--save: '{path}' is no result of bytes")
    return value


def _save(path: Path, data: bytes) -> None:
    """Write a new file. Raises WordsError."""
    try:
        with path.open("xb") as file:
            file.write(data)
    except OSError as error:
        raise WordsError(f"--save: {path} cannot be written: {error_text(error)}") from None


def run_call(arguments: argparse.Namespace) -> int:
    from framekit.codec.plain import PlainValues
    from framekit.codec.result_names import ResultNames

    places = each_once(_file_of_result(text) for text in arguments.save)

    def call(client: Client) -> None:
        given = _with_files(client.protocol, arguments.service, assignments(arguments.arguments))
        answer = client.call(arguments.service, given, addresses=arguments.address, count=arguments.count)
        for name, path in places.items():
            _save(path, _bytes_of(answer.results, name))
        if arguments.json:
            results = PlainValues(client.protocol).to_plain("", answer.results)
            names = {"names": dict(answer.names)} if answer.names else {}
            print_json({"service": arguments.service, "results": results} | names)
        else:
            for name, value in ResultNames(client.protocol).with_names(arguments.service, answer.results).items():
                print(f"{name}: {value}")

    return carry_out(arguments, call, to_station=False)
