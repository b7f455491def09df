"""`framekit serve PROTOCOL --port PORT`: devices that answer on a port, with memory, until told to stop."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import signal
from pathlib import Path
from typing import TYPE_CHECKING

from framekit.cli.common import add_json, duration_of, told, why_not
from framekit.cli.main import Failure, NoPort, WrongWords
from framekit.cli.watch_options import add_capture, add_log, add_screen, begin_log, period_of
from framekit.transport.schemes import help_on_ports

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from framekit.blocks.device import Device
    from framekit.blocks.device_settings import DeviceSettings
    from framekit.blocks.model import ConnectionLimits
    from framekit.cli.serve_output import ServeOutput
    from framekit.definition.times import LineFormat
    from framekit.service.serving import Serving, ServingMonitor
    from framekit.service.serving_ports import Served
    from framekit.transport.clock import AsyncioClock
    from framekit.transport.port import Port


def add_arguments(parser: argparse.ArgumentParser) -> None:
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
    parser.add_argument(
        "--param", action="append", default=[], metavar="NAME=VALUE", help="parameter of the protocol; may be repeated"
    )
    parser.add_argument("--faults", metavar="PLAN", help="fault plan: what goes wrong with what the devices send")
    parser.add_argument("--role", help="role it plays; default: the one that answers")
    parser.add_argument("--speed", type=int, help="line speed in bits a second; default: the protocol's")
    parser.add_argument("--format", help="data bits, parity and stop bits, such as 8E1; default: the protocol's")
    parser.add_argument(
        "--idle-timeout", metavar="TIME",
        help="close a connection over which no good frame went for so long, or never; default: 10min",
    )  # fmt: skip
    parser.add_argument(
        "--connections", type=int, metavar="N", help="connections that one client address may have; default: 64"
    )
    parser.add_argument("--for", dest="duration", metavar="TIME", help="stop after this time, such as 10s")
    parser.add_argument("--quiet", action="store_true", help="do not show what goes over the line")
    add_screen(parser)
    parser.add_argument(
        "--status-every", metavar="TIME", help="show what was served and refused so often; SIGUSR1 shows it once"
    )
    add_capture(parser)
    add_log(parser)
    add_json(parser)


def run(arguments: argparse.Namespace) -> int:
    begin_log(arguments.log)
    duration, every = duration_of(arguments.duration), period_of(arguments.status_every)
    devices = _devices(arguments.devices, _settings(arguments), arguments.faults)
    line = _line(arguments, devices[0])
    if arguments.screen:
        return _live(arguments, devices, line, duration)
    status = 0
    with contextlib.suppress(asyncio.CancelledError):
        status = asyncio.run(_serve(arguments, devices, line, duration, every))
    return status


# ---- what is asked for ------------------------------------------------------------------------------------


def _settings(arguments: argparse.Namespace) -> DeviceSettings:
    from framekit.blocks.device_settings import DeviceSettings

    return DeviceSettings(
        stations=() if arguments.station is None else tuple(part.strip() for part in arguments.station.split(",")),
        role=arguments.role,
        memory=arguments.memory,
        initial=dict(_assigned(arguments.set, "ADDRESS=VALUE")),
        sizes=dict(_assigned(arguments.size, "ADDRESS=N")),
        params=dict(_assigned(arguments.param, "NAME=VALUE")),
        mapping=dict(_assigned(arguments.map, "AREA=ADDRESS")),
    )


def _assigned(texts: Iterable[str], form: str) -> Iterable[tuple[str, str]]:
    for text in texts:
        name, equals, value = text.partition("=")
        if not (name.strip() and equals and value.strip()):
            raise WrongWords(f"'{text}' is not {form}")
        yield name.strip(), value.strip()


def _devices(names: Sequence[str], settings: DeviceSettings, faults: str | None) -> list[Device]:
    """Raises DefinitionError, and WrongWords for devices that can't share a line."""
    from framekit.blocks.device import load_devices
    from framekit.blocks.load_fault_plan import with_faults
    from framekit.service.serving_ports import check_line

    found = [device for name in names for device in load_devices(name, Path.cwd(), settings)]
    found = with_faults(found, faults, Path.cwd())
    try:
        check_line(found)
    except ValueError as error:
        raise WrongWords(str(error)) from None
    return found


def _line(arguments: argparse.Namespace, device: Device) -> LineFormat | None:
    from framekit.service.serving_ports import line_of

    try:
        return line_of(device, arguments.speed, arguments.format)
    except ValueError as error:
        raise WrongWords(str(error)) from None


# ---- serving ----------------------------------------------------------------------------------------------


def _live(arguments: argparse.Namespace, devices: list[Device], line: LineFormat | None, duration: int | None) -> int:
    """The devices in the live display."""
    from framekit.cli.screen.serve_session import ServeSession
    from framekit.cli.screen.show import show

    return show(ServeSession(arguments, devices, line, duration))


async def _serve(
    arguments: argparse.Namespace, devices: list[Device], line: LineFormat | None, duration: int | None, every: int
) -> int:
    """Serves until the time is over, or SIGINT or SIGTERM asks to stop; the exit status.

    Raises NoPort when the port can't be had.
    """
    from framekit.cli.serve_output import JsonServeOutput, TextServeOutput
    from framekit.transport.clock import AsyncioClock

    loop = asyncio.get_running_loop()
    clock = AsyncioClock(loop)
    ended = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, ended.set)
    output = (JsonServeOutput if arguments.json else TextServeOutput)(devices, clock.now(), ended.set)
    for device in devices:
        for text in warnings_of(device):
            output.warning(text)
    lost: list[str] = []
    with contextlib.ExitStack() as stack:
        monitor = None if arguments.quiet else output.seen
        serving, served = await begin(arguments, devices, line, clock, monitor, lost.append, stack)
        output.ready(served)
        _show_status(output, serving, clock, every, ended)
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(ended.wait(), None if duration is None else duration / 1e9)
        ended.set()
        output.summary(serving)
    for trouble in lost:
        output.warning(trouble)
    output.check()
    return 1 if lost else 0


def _show_status(output: ServeOutput, serving: Serving, clock: AsyncioClock, every: int, ended: asyncio.Event) -> None:
    """Shows the status every `every` ns (0: never), and when SIGUSR1 asks for it."""

    def show() -> None:
        output.status(serving, clock.now())

    def go_on() -> None:
        if not ended.is_set():
            show()
            clock.call_at(clock.now() + every, go_on)

    if every:
        clock.call_at(clock.now() + every, go_on)
    if hasattr(signal, "SIGUSR1"):
        asyncio.get_running_loop().add_signal_handler(signal.SIGUSR1, show)


async def begin(
    arguments: argparse.Namespace,
    devices: Sequence[Device],
    line: LineFormat | None,
    clock: AsyncioClock,
    monitor: ServingMonitor | None,
    lost: Callable[[str], None],
    stack: contextlib.ExitStack,
) -> tuple[Serving, Served]:
    """Serves on the port that is asked for, until `stack` ends; also how the port is called. Raises Failure.

    `lost` is told at the end what the capture could not keep.
    """
    from framekit.service.serving import Serving

    first_state: asyncio.Future[str] = asyncio.get_running_loop().create_future()

    def state(port: str, text: str) -> None:
        if not first_state.done():
            first_state.set_result(text)

    wrap = _captured(arguments.capture, clock, stack, lost)
    limits = connection_limits(arguments.idle_timeout, arguments.connections)
    serving = Serving(devices, clock, line, monitor, on_state=state, wrap=wrap, limits=limits)
    stack.callback(serving.stop)
    return serving, await _open(arguments.port, serving, clock, first_state, stack)


def connection_limits(idle: str | None, per_address: int | None) -> ConnectionLimits:
    """What `--idle-timeout` and `--connections` say. Raises WrongWords."""
    from framekit.blocks.model import DEFAULT_LIMITS, ConnectionLimits
    from framekit.definition.times import parse_time

    try:
        return ConnectionLimits(
            idle=DEFAULT_LIMITS.idle if idle is None else parse_time(idle),
            per_address=DEFAULT_LIMITS.per_address if per_address is None else per_address,
        )
    except ValueError as error:
        raise WrongWords(str(error)) from None


def _captured(
    path: Path | None, clock: AsyncioClock, stack: contextlib.ExitStack, lost: Callable[[str], None]
) -> Callable[[Port], Port] | None:
    """Puts a capture around every port; it ends with `stack`. Raises Failure."""
    from framekit.service.capture import Capture

    if path is None:
        return None
    try:
        capture = Capture(path, (1,), clock)
    except OSError as error:
        raise Failure(why_not(error)) from None

    def close() -> None:
        capture.close()
        for trouble in capture.troubles:
            lost(trouble)

    stack.callback(close)
    return capture.around_next


async def _open(
    url: str, serving: Serving, clock: AsyncioClock, first_state: asyncio.Future[str], stack: contextlib.ExitStack
) -> Served:
    """Opens the port, or begins to listen; how it is called. Raises NoPort when that can't be done."""
    from framekit.service.serving_ports import begin_serving

    try:
        return await begin_serving(url, serving, clock, first_state, stack)
    except OSError as error:
        raise NoPort(f"{url}: {error.strerror}" if error.strerror else str(error)) from None
    except ValueError as error:
        raise WrongWords(str(error)) from None


def warnings_of(device: Device) -> list[str]:
    """What users should know of a device before it serves."""
    missing = device.areas_without_memory()
    found = [told(problem) for problem in device.protocol.warnings]
    if missing:
        what = f"the memory has no area for {', '.join(missing)} of {device.protocol.name}"
        found.append(f"{what}: requests for them are refused – add --map {missing[0]}=ADDRESS")
    return found
