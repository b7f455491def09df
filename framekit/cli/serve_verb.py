"""`framekit serve PROTOCOL --port PORT`: devices that answer on a port, with memory, until told to stop."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import signal
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from framekit.api.monitor import FrameLog, LineOf, LiveView
from framekit.cli.common import (
    PortError,
    VerbError,
    WordsError,
    add_capture,
    add_json,
    add_log,
    add_screen,
    begin_log,
    duration_of,
    period_of,
    seen_data,
    seen_text,
    table,
    told,
    why_not,
)
from framekit.cli.screen.session import LiveSession
from framekit.service.line_load import LineLoad
from framekit.transport.clock import AsyncioClock
from framekit.transport.schemes import help_on_ports

if TYPE_CHECKING:
    from collections.abc import Iterable

    from framekit.definition.times import LineFormat
    from framekit.link.observe import Seen
    from framekit.run.model import ConnectionLimits
    from framekit.runfile.devices import Device, DeviceSettings
    from framekit.service.serving import ServedAt, Serving, ServingMonitor
    from framekit.transport.port import Port


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


def run_serve(arguments: argparse.Namespace) -> int:
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
    from framekit.runfile.devices import DeviceSettings

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
            raise WordsError(f"'{text}' is not {form}")
        yield name.strip(), value.strip()


def _devices(names: Sequence[str], settings: DeviceSettings, faults: str | None) -> list[Device]:
    """Raises DefinitionError, and WordsError for devices that can't share a line."""
    from framekit.runfile.devices import load_devices, with_faults
    from framekit.service.serving import check_line

    found = [device for name in names for device in load_devices(name, Path.cwd(), settings)]
    found = with_faults(found, faults, Path.cwd())
    try:
        check_line(found)
    except ValueError as error:
        raise WordsError(str(error)) from None
    return found


def _line(arguments: argparse.Namespace, device: Device) -> LineFormat | None:
    from framekit.service.serving import line_of

    try:
        return line_of(device, arguments.speed, arguments.format)
    except ValueError as error:
        raise WordsError(str(error)) from None


# ---- serving ----------------------------------------------------------------------------------------------


def _live(arguments: argparse.Namespace, devices: list[Device], line: LineFormat | None, duration: int | None) -> int:
    """The devices in the live display."""
    from framekit.cli.screen.show import show

    return show(ServeSession(arguments, devices, line, duration))


async def _serve(
    arguments: argparse.Namespace, devices: list[Device], line: LineFormat | None, duration: int | None, every: int
) -> int:
    """Serves until the time is over, or SIGINT or SIGTERM asks to stop; the exit status.

    Raises PortError when the port can't be had.
    """
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
) -> tuple[Serving, ServedAt]:
    """Serves on the port that is asked for, until `stack` ends; also how the port is called. Raises VerbError.

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
    """What `--idle-timeout` and `--connections` say. Raises WordsError."""
    from framekit.definition.times import parse_time
    from framekit.run.model import DEFAULT_LIMITS, ConnectionLimits

    try:
        return ConnectionLimits(
            idle=DEFAULT_LIMITS.idle if idle is None else parse_time(idle),
            per_address=DEFAULT_LIMITS.per_address if per_address is None else per_address,
        )
    except ValueError as error:
        raise WordsError(str(error)) from None


def _captured(
    path: Path | None, clock: AsyncioClock, stack: contextlib.ExitStack, lost: Callable[[str], None]
) -> Callable[[Port], Port] | None:
    """Puts a capture around every port; it ends with `stack`. Raises VerbError."""
    from framekit.service.capture import Capture

    if path is None:
        return None
    try:
        capture = Capture(path, (1,), clock)
    except OSError as error:
        raise VerbError(why_not(error)) from None

    def close() -> None:
        capture.close()
        for trouble in capture.troubles:
            lost(trouble)

    stack.callback(close)
    return capture.around_next


async def _open(
    url: str, serving: Serving, clock: AsyncioClock, first_state: asyncio.Future[str], stack: contextlib.ExitStack
) -> ServedAt:
    """Opens the port, or begins to listen; how it is called. Raises PortError when that can't be done."""
    from framekit.service.serving import begin_serving

    try:
        return await begin_serving(url, serving, clock, first_state, stack)
    except OSError as error:
        raise PortError(f"{url}: {error.strerror}" if error.strerror else str(error)) from None
    except ValueError as error:
        raise WordsError(str(error)) from None


def warnings_of(device: Device) -> list[str]:
    """What users should know of a device before it serves."""
    missing = device.areas_without_memory()
    found = [told(problem) for problem in device.protocol.warnings]
    if missing:
        what = f"the memory has no area for {', '.join(missing)} of {device.protocol.name}"
        found.append(f"{what}: requests for them are refused – add --map {missing[0]}=ADDRESS")
    return found


class ServeOutput:
    """Watches devices. `began` is when time began; `lost` is called when nobody reads the output any more."""

    def __init__(self, devices: Sequence[Device], began: int, lost: Callable[[], None]) -> None:
        self.devices = devices
        self.began = began
        self.lost = lost
        self.is_ready = False
        self._trouble: OSError | None = None

    def line(self, text: str) -> None:
        """Prints a line at once. When that can't be done, serving ends."""
        if self._trouble is None:
            try:
                print(text, flush=True)
            except OSError as error:
                self._trouble = error
                self.lost()

    def check(self) -> None:
        """Raises OSError when something could not be printed."""
        if self._trouble is not None:
            raise self._trouble

    def seen(self, port: str, number: int, seen: Seen) -> None:
        """Every device hears what comes: the first one's ears are enough."""
        if self.is_ready and (number == 0 or seen.direction == "out" or seen.kind == "trouble"):
            self.show(port, number, seen)

    def show(self, port: str, number: int, seen: Seen) -> None:
        raise NotImplementedError

    def warning(self, text: str) -> None:
        print(text, file=sys.stderr)

    def ready(self, served: ServedAt) -> None:
        """The port is open: requests can come."""
        self.is_ready = True
        self.show_ready(served)

    def show_ready(self, served: ServedAt) -> None:
        raise NotImplementedError

    def summary(self, serving: Serving) -> None:
        raise NotImplementedError

    def status(self, serving: Serving, now: int) -> None:
        """The same while it goes on."""
        raise NotImplementedError

    def reasons(self, serving: Serving, number: int) -> dict[str, int]:
        """Why a device has refused requests, and how often."""
        from framekit.codec.shown import refusal_text

        protocol, counters = self.devices[number].protocol, serving.stores[number].counters
        return {refusal_text(protocol, code): count for code, count in sorted(counters.refused.items())}


def _client(port: str) -> str:
    """A connection by its other side; nothing for the one port there is."""
    return port.removeprefix("tcp://") if port.startswith("tcp://") else ""


class TextServeOutput(ServeOutput):
    """For people."""

    def show_ready(self, served: ServedAt) -> None:
        own = list(dict.fromkeys(device.station for device in self.devices if device.own is not None))
        stations = f" station{'s' if len(own) > 1 else ''} {', '.join(own)}" if own else ""
        names = dict.fromkeys(device.protocol.name for device in self.devices)
        self.line(f"ready: {', '.join(names)}{stations} on {served.about}")

    def show(self, port: str, number: int, seen: Seen) -> None:
        self.line(seen_text(seen, (seen.at - self.began) / 1e9, _client(port)))

    def summary(self, serving: Serving) -> None:
        rows, reasons, status = [], [], []
        for number, store in enumerate(serving.stores):
            own = store.device.station or "-"
            rows.append((own, str(store.counters.done), str(store.counters.errors)))
            reasons += [(own, text, str(count)) for text, count in self.reasons(serving, number).items()]
            status += [(own, name, str(value)) for name, value in serving.published(number).items()]
        reasons += [("line", text, str(count)) for text, count in sorted(serving.line_errors.items())]
        self.line("\n" + table(rows, ("station", "services", "errors")))
        if reasons:
            self.line("\n" + table(reasons, ("where", "reason", "count")))
        if status:
            self.line("\n" + table(status, ("station", "status", "value")))

    def status(self, serving: Serving, now: int) -> None:
        self.line(f"\nstatus at {(now - self.began) / 1e9:.3f} s")
        self.summary(serving)
        self.line("")


class JsonServeOutput(ServeOutput):
    """One JSON object a line."""

    def data(self, line: dict[str, Any]) -> None:
        self.line(json.dumps(line, ensure_ascii=False))

    def show_ready(self, served: ServedAt) -> None:
        stations = [_plain(device.own) for device in self.devices if device.own is not None]
        protocol = self.devices[0].protocol.name
        ready = {"event": "ready", "protocol": protocol, "port": served.port, "stations": stations}
        line = served.about.removeprefix(served.port).removeprefix(" at ")
        self.data({**ready, "line": line} if line else ready)

    def show(self, port: str, number: int, seen: Seen) -> None:
        from framekit.codec.plain import PlainValues

        device = self.devices[number]
        where = {"client": _client(port)} if _client(port) else {}
        if seen.direction == "out" and device.own is not None:
            where["station"] = _plain(device.own)
        self.data(seen_data(seen, (seen.at - self.began) / 1e9, PlainValues(device.protocol), **where))

    def summary(self, serving: Serving) -> None:
        for number, store in enumerate(serving.stores):
            counters = store.counters
            line = {
                "event": "station",
                "station": _plain(store.device.own),
                "services": counters.done,
                "errors": counters.errors,
                "reasons": self.reasons(serving, number),
                "status": {name: _plain(value) for name, value in serving.published(number).items()},
            }
            self.data({key: value for key, value in line.items() if value not in ({}, None)})
        self.data({"event": "line", "connections": serving.connections, "reasons": dict(serving.line_errors)})

    def status(self, serving: Serving, now: int) -> None:
        self.data({"event": "status", "time": (now - self.began) / 1e9})
        self.summary(serving)


def _plain(value: Any) -> Any:
    return value.hex(" ").upper() if isinstance(value, bytes) else value


class ServeSession(LiveSession):
    """Devices on one line; the first is channel 1, and shows what all of them hear."""

    def __init__(
        self, arguments: argparse.Namespace, devices: list[Device], line: LineFormat | None, duration: int | None
    ) -> None:
        self.title = f"serve {arguments.port}"
        self.devices = devices
        self.problems: list[str] = []
        self.serving: Serving | None = None
        self._lost: list[str] = []
        self._arguments = arguments
        self._line = line
        self._duration = duration
        self._stack = contextlib.ExitStack()
        self._opening: asyncio.Task[None] | None = None
        self._state = "opening"
        self._view: LiveView | None = None

    def begin(self) -> LiveView:
        clock = AsyncioClock(asyncio.get_running_loop())
        numbered = dict(enumerate(self.devices, 1))
        log = FrameLog(
            {number: device.protocol for number, device in numbered.items()},
            {number: device.role for number, device in numbered.items()},
            {number: device.params for number, device in numbered.items()},
        )
        load = LineLoad(self._line, clock.now())
        lines = {number: LineOf(self._name(device), lambda: self._state, load) for number, device in numbered.items()}
        self._view = LiveView(log, clock, lines)
        self._opening = asyncio.get_running_loop().create_task(self._open(clock, _watcher(log, load)))
        return self._view

    def _name(self, device: Device) -> str:
        own = f" station {device.station}" if device.station else ""
        return f"{device.protocol.name}{own}" + ("" if self._line is None else f" {self._line}")

    async def _open(self, clock: AsyncioClock, monitor: Callable[[str, int, Seen], None]) -> None:
        for device in self.devices:
            self.problems += warnings_of(device)
        try:
            self.serving, served = await begin(
                self._arguments, self.devices, self._line, clock, monitor, self._lost.append, self._stack
            )
        except VerbError as failure:
            self.failure = failure
        else:
            self._state = f"on {served.about}"

    @property
    def is_over(self) -> bool:
        late = self._duration is not None and self._view is not None and self._view.elapsed >= self._duration
        return late or self.failure is not None

    async def end(self) -> None:
        if self._opening is not None:
            self._opening.cancel()
            await asyncio.gather(self._opening, return_exceptions=True)
        self._stack.close()
        self.problems += self._lost
        self.lost = bool(self._lost)


def _watcher(log: FrameLog, load: LineLoad) -> Callable[[str, int, Seen], None]:
    """Every device hears what comes: the first one's ears are enough."""

    def watch(port: str, number: int, seen: Seen) -> None:
        sent = seen.direction == "out"
        if number and not sent and seen.kind != "trouble":
            return
        log.add(number + 1, seen)
        if sent:
            load.bytes_out += len(seen.raw)
        else:
            load.bytes_in += len(seen.raw)

    return watch
