"""`framekit serve PROTOCOL --port PORT`: serve devices with memory on a port until a signal stops them."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import sys
import time
from collections.abc import Iterable
from functools import cached_property
from typing import TYPE_CHECKING, Any

from framekit.cli.common import (
    VerbError,
    WordsError,
    add,
    begin_log,
    duration_of,
    each_once,
    in_words,
    json_line,
    on_signal,
    period_of,
    plain,
    print_trouble,
    run_in_loop,
    seen_data,
    seen_text,
    tables,
    told,
    until,
    why_not,
    without_collecting,
)
from framekit.cli.live_output import LiveOutput, live_output
from framekit.cli.live_session import LiveSession, show
from framekit.cli.web_option import NoPage, add_web, page_of
from framekit.transport.schemes import help_on_ports

if TYPE_CHECKING:
    from framekit import AsyncServer, Seen
    from framekit.api.monitor import LiveView
    from framekit.api.server import Device
    from framekit.codec.contents import Requests


def add_serve_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "devices", nargs="+", metavar="PROTOCOL",
        help="name of a shipped protocol, a YAML file, or a device file; several devices share the line",
    )  # fmt: skip
    parser.add_argument(
        "--port", required=True, metavar="PORT",
        help=f"{help_on_ports(serves=True)}: listens there, or makes a new pseudo-terminal",
    )  # fmt: skip
    parser.add_argument(
        "--station", metavar="N[,N…]", help="own station; several are so many devices, each with its own memory"
    )
    parser.add_argument("--memory", metavar="PROFILE", help="memory profile; default: the areas of the protocol")
    parser.add_argument(
        "--map", action="append", default=[], metavar="AREA=ADDRESS",
        help="where an area of the protocol begins in the memory; may be repeated",
    )  # fmt: skip
    parser.add_argument(
        "--size", action="append", default=[], metavar="ADDRESS=N",
        help="how many elements the area has that begins there, also one that is not there without; may be repeated",
    )  # fmt: skip
    parser.add_argument(
        "--set", action="append", default=[], metavar="ADDRESS=VALUE[,VALUE…]",
        help="start value in memory; may be repeated",
    )  # fmt: skip
    add(parser, "--param")
    parser.add_argument(
        "--state", action="append", default=[], metavar="NAME=VALUE",
        help="start value of a state variable, such as passwords='{2: SECRET}'; may be repeated",
    )  # fmt: skip
    parser.add_argument("--faults", metavar="PLAN", help="fault plan: what goes wrong with what the devices send")
    parser.add_argument("--role", help="role it plays; default: the one that answers")
    add(parser, "--speed", "--format")
    parser.add_argument(
        "--idle-timeout", metavar="TIME",
        help="close a connection over which no good frame went for so long, or never; default: 10min",
    )  # fmt: skip
    parser.add_argument(
        "--connections", type=int, metavar="N", help="connections that one client address may have; default: 64"
    )
    parser.add_argument("--read-only", action="store_true", help="clients may write nothing; the protocol refuses it")
    parser.add_argument(
        "--allow", action="append", default=[], metavar="ADDRESS",
        help="only clients from there may connect: an address or a network such as 192.168.1.0/24; may be repeated",
    )  # fmt: skip
    add(parser, "--for")
    parser.add_argument("--quiet", action="store_true", help="do not show what goes over the line")
    add(parser, "--screen")
    add_web(parser)
    parser.add_argument(
        "--status-every", metavar="TIME", help="show the counts of requests at this interval; SIGUSR1 shows them once"
    )
    add(parser, "--capture", "--log", "--json")


def run_serve(arguments: argparse.Namespace) -> int:
    if not arguments.screen:
        with live_output(arguments.json, has_quiet=True, goes_on="the server") as live:
            return _run(arguments, live)
    return _run(arguments, None)


def _run(arguments: argparse.Namespace, live: LiveOutput | None) -> int:
    """Serve, without `live` in the display; return the exit status. Raises VerbError, DefinitionError."""
    begin_log(arguments.log)
    duration, every = duration_of(arguments.duration), period_of(arguments.status_every)
    server = server_of(arguments)
    if arguments.screen and arguments.web is not None:
        raise WordsError("--web tells its address in a line – leave --screen out")
    if live is None:
        return show(ServeSession(server, duration))
    with contextlib.suppress(asyncio.CancelledError):
        return run_in_loop(_serve(arguments, server, duration, every, page_of(arguments), live))
    return 0


def server_of(arguments: argparse.Namespace) -> AsyncServer:
    """Return the servers of the command line, not yet open. Raises DefinitionError, WordsError."""
    from framekit.api.server import aserve

    given: dict[str, Any] = {
        "station": None if arguments.station is None else [part.strip() for part in arguments.station.split(",")],
        "texts": _assigned(arguments.set, "ADDRESS=VALUE"),
        "sizes": _assigned(arguments.size, "ADDRESS=N"),
        "params": _assigned(arguments.param, "NAME=VALUE"),
        "state": _assigned(arguments.state, "NAME=VALUE"),
        "map": _assigned(arguments.map, "AREA=ADDRESS"),
        "read_only": arguments.read_only,
        "allow": [one for text in arguments.allow for one in text.split(",")],
    }
    options = ("role", "memory", "speed", "format", "faults", "idle_timeout", "connections")
    given |= {name: value for name in options if (value := getattr(arguments, name)) is not None}
    with in_words():
        server = aserve(arguments.devices, arguments.port, **given)
    server.capture = arguments.capture
    return server


def _assigned(texts: Iterable[str], form: str) -> dict[str, str]:
    def parted(text: str) -> tuple[str, str]:
        name, equals, value = text.partition("=")
        if not (name.strip() and equals and value.strip()):
            raise WordsError(f"'{text}' is not {form}")
        return name.strip(), value.strip()

    return each_once(parted(text) for text in texts)


async def _serve(
    arguments: argparse.Namespace, server: AsyncServer, duration: int | None, every: int, page: NoPage,
    live: LiveOutput,
) -> int:  # fmt: skip
    """Serve until the time is over, or SIGINT or SIGTERM arrives; return the exit status.

    Raises PortError if the port cannot be opened.
    """
    ended = asyncio.Event()
    live.on_stop(ended.set)
    output = (JsonServeOutput if arguments.json else TextServeOutput)(server)
    for text in warnings_of(server):
        output.warning(text)
    if not arguments.quiet:
        server.watch = output.seen
    server.on_trouble = print_trouble
    page.watch(server)
    try:
        await _open(server)
        async with page.of_devices(server):
            output.ready()
            _show_status(output, every, ended)
            with without_collecting(), live.may_drop():
                await until(duration, ended)
            ended.set()
            output.summary()
    finally:
        server.close_now()
    for trouble in server.lost:
        output.warning(trouble)
    return live.report_losses(1 if server.lost else 0)


async def _open(server: AsyncServer) -> None:
    """Open the server. Raise VerbError."""
    with in_words():
        try:
            await server.open()
        except ConnectionError:  # LineClosedError is one
            raise
        except OSError as error:
            raise VerbError(why_not(error)) from None


def _show_status(output: ServeOutput, every: int, ended: asyncio.Event) -> None:
    """Print the status every `every` ns (0: never), and at each SIGUSR1."""
    loop = asyncio.get_running_loop()

    def go_on() -> None:
        if not ended.is_set():
            output.status()
            loop.call_later(every / 1e9, go_on)

    if every:
        loop.call_later(every / 1e9, go_on)
    on_signal("SIGUSR1", output.status)


def warnings_of(server: AsyncServer) -> list[str]:
    """Return warnings about devices before they serve."""
    found = []
    for device in server.devices:
        missing = device.areas_without_memory()
        found += [told(problem) for problem in device.protocol.warnings]
        if missing:
            what = f"the memory has no area for {', '.join(missing)} of {device.protocol.name}"
            found.append(f"{what}: requests for them are refused – add --map {missing[0]}=ADDRESS")
    return found


class ServeOutput:
    """Watches devices."""

    def __init__(self, server: AsyncServer) -> None:
        self.server = server
        self.began = time.monotonic_ns()
        self.is_ready = False

    def line(self, text: str) -> None:
        print(text, flush=True)

    def seconds(self, at: int) -> float:
        return (at - self.began) / 1e9

    def warning(self, text: str) -> None:
        print(text, file=sys.stderr)

    def ready(self) -> None:
        """Note that the port is open, so that requests can arrive, and show it."""
        self.is_ready = True
        self.show_ready()

    def seen(self, port: str, number: int, seen: Seen) -> None:
        if self.is_ready:
            self.show(self.server.devices[number], seen)

    def show_ready(self) -> None:
        raise NotImplementedError

    def show(self, device: Device, seen: Seen) -> None:
        raise NotImplementedError

    def summary(self) -> None:
        raise NotImplementedError

    def status(self) -> None:
        """Print the status while serving."""
        raise NotImplementedError


class TextServeOutput(ServeOutput):
    """Output for readers, as text."""

    def show_ready(self) -> None:
        devices = self.server.devices
        own = list(dict.fromkeys(device.station for device in devices if device.own is not None))
        if own:
            stations = f" station{'s' if len(own) > 1 else ''} {', '.join(own)}"
        else:
            stations = " without a station of its own" if any(device.lacks_station for device in devices) else ""
        names = dict.fromkeys(device.protocol.name for device in devices)
        self.line(f"ready: {', '.join(names)}{stations} on {self.server.about}")

    def show(self, device: Device, seen: Seen) -> None:
        self.line(seen_text(seen, self.seconds(seen.at), ""))

    def summary(self) -> None:
        rows, reasons, status = [], [], []
        for one in self.server.status():
            own = one.device.station or "-"
            rows.append((own, str(one.services), str(one.errors)))
            reasons += [(own, text, str(count)) for text, count in one.reasons.items()]
            status += [(own, name, str(value)) for name, value in one.status.items()]
        reasons += [("line", text, str(count)) for text, count in sorted(self.server.line_errors.items())]
        found = tables(
            (rows, ("station", "services", "errors")),
            (reasons, ("where", "reason", "count")),
            (status, ("station", "status", "value")),
        )
        self.line(found.rstrip("\n"))

    def status(self) -> None:
        self.line(f"\nstatus at {self.seconds(time.monotonic_ns()):.3f} s")
        self.summary()
        self.line("")


class JsonServeOutput(ServeOutput):
    """Output as JSON, one object a line."""

    @cached_property
    def _requests(self) -> Requests:
        from framekit.codec.contents import Requests

        return Requests()

    def data(self, line: dict[str, Any]) -> None:
        self.line(json_line(line))

    def show_ready(self) -> None:
        server = self.server
        stations = [plain(device.own) for device in server.devices if device.own is not None]
        protocol = server.devices[0].protocol.name
        ready = {"event": "ready", "protocol": protocol, "port": server.port, "stations": stations}
        line = server.about.removeprefix(server.port).removeprefix(" at ")
        self.data({**ready, "line": line} if line else ready)

    def show(self, device: Device, seen: Seen) -> None:
        from framekit.codec.contents import contents_of

        contents = contents_of(device.protocol)
        self._requests.attach(contents, seen, self.server.port)
        is_answer = seen.direction == "out" and device.own is not None
        station = {"station": plain(device.own)} if is_answer else {}
        self.data(seen_data(seen, self.seconds(seen.at), contents, **station))

    def summary(self) -> None:
        for one in self.server.status():
            line = {
                "event": "station",
                "station": plain(one.device.own),
                "services": one.services,
                "errors": one.errors,
                "reasons": one.reasons,
                "status": {name: plain(value) for name, value in one.status.items()},
            }
            self.data({key: value for key, value in line.items() if value not in ({}, None)})
        self.data({"event": "line", "connections": self.server.connections, "reasons": dict(self.server.line_errors)})

    def status(self) -> None:
        self.data({"event": "status", "time": self.seconds(time.monotonic_ns())})
        self.summary()


class ServeSession(LiveSession):
    """Devices on one line; the first is channel 1, and shows the frames that all of them receive."""

    def __init__(self, server: AsyncServer, duration: int | None) -> None:
        super().__init__(f"serve {server.port}", duration)
        self.server = server
        self.is_open = False
        self._opening: asyncio.Task[None] | None = None

    def begin(self) -> LiveView:
        from framekit.api.monitor import FrameLog
        from framekit.api.server import view_of_devices

        view = view_of_devices(self.server, FrameLog(), self._state)
        self._opening = asyncio.get_running_loop().create_task(self._open())
        self._opening.add_done_callback(self._has_opened)
        return view

    def _has_opened(self, opening: asyncio.Task[None]) -> None:
        """End the session if an error has ended the opening."""
        if not opening.cancelled() and isinstance(error := opening.exception(), Exception):
            self.failure = error

    def _state(self) -> str:
        return f"on {self.server.about}" if self.is_open else "opening"

    async def _open(self) -> None:
        self.problems += warnings_of(self.server)
        await _open(self.server)
        self.is_open = True

    async def end(self) -> None:
        if self._opening is not None:
            self._opening.cancel()
            await asyncio.gather(self._opening, return_exceptions=True)
        self.server.close_now()
        self.problems += self.server.lost
        self.lost = bool(self.server.lost)
