"""Simulated devices, for asyncio and without: they serve on a port while their memory is read and written."""

from __future__ import annotations

import asyncio
import time
import weakref
from collections import Counter
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

from framekit.api.errors import LineClosedError, RequestError
from framekit.api.loop_thread import Closing, LoopThread, with_arguments_of
from framekit.api.memory import Do, Memory
from framekit.api.monitor import FrameLog, LineOf, LiveView
from framekit.api.points import RunPoints
from framekit.api.run import nanoseconds
from framekit.api.settings import checked_station
from framekit.definition.problems import error_text
from framekit.definition.times import LineFormat
from framekit.link.events import Seen
from framekit.run.model import DEFAULT_LIMITS, ConnectionLimits, Network, in_both, network_of
from framekit.run.trouble import TroubleReport
from framekit.runfile.channels import line_of
from framekit.runfile.devices import Device as Device
from framekit.runfile.devices import DeviceSettings, load_devices, offering_faults, with_faults
from framekit.service.capture import Capture
from framekit.service.device import DeviceStore, Serving, ServingMonitor, check_line
from framekit.service.driver import LineLoad
from framekit.service.points import DevicePoints, begun_points
from framekit.transport.clock import AsyncioClock
from framekit.transport.schemes import scheme_of


@dataclass(frozen=True, slots=True)
class ServedDevice:
    """Work of a device: services carried out and refused, the refusals by their text, its published status."""

    device: Device
    services: int
    errors: int
    reasons: Mapping[str, int]
    status: Mapping[str, Any]


class AsyncServer:
    """Devices on a port, made by `framekit.aserve`. `async with` opens and closes it; so do `await` and `close`.

    `port`: name under which others connect; `about`: its description for users. Its memory may be used as soon as it is
    open. `watch` gets the events of the line, with the port and the number of the device; frames that all devices
    receive, once. `capture`: a file for them; `lost` lists after the end the data missing in it. `load`: the load of
    the line.
    """

    def __init__(
        self, devices: Sequence[Device], port: str, line: LineFormat | None, initial: Mapping[str, Any],
        monitor: Callable[[Seen], None] | None = None, limits: ConnectionLimits = DEFAULT_LIMITS,
    ) -> None:  # fmt: skip
        self.devices = tuple(devices)
        self.port = self.about = port
        self.do: Do = lambda action: action()
        self.line = line
        self.load = LineLoad(line, 0)
        self.watch: ServingMonitor | None = None
        self.capture: Path | None = None
        self.lost: list[str] = []
        self.on_trouble: Callable[[TroubleReport], None] = lambda report: None
        """Callback for a capture that cannot be written, called at once; set it before `open`."""
        self._initial = initial
        self._monitor = monitor
        self._limits = limits
        self._serving: Serving | None = None
        self._capturing: Capture | None = None
        self._points: list[DevicePoints] | None = None

    async def open(self) -> Self:
        """Begin to serve. Raises LineClosedError, RequestError for an invalid port or values that do not fit the
        memory.

        OSError for a capture that cannot be written.
        """
        if self._serving is not None:
            return self
        clock = AsyncioClock(asyncio.get_running_loop())
        self.load.begin(clock.now())
        wrap = None
        if self.capture is not None:
            self._capturing = Capture(self.capture, (1,), clock)
            self._capturing.troubles.listen(self.on_trouble)
            wrap = self._capturing.around_next
        watch = None if self._monitor is None and self.watch is None else self._seen
        self._serving = serving = Serving(self.devices, clock, self.line, watch, wrap=wrap, limits=self._limits)
        try:
            for address, values in self._initial.items():
                self._memory(0, lambda action: action()).write(address, values)
            self.port, self.about = await serving.begin(self.port)
        except BaseException as error:
            self.close_now()
            if isinstance(error, OSError):
                text = f"{self.port}: {error.strerror}" if error.strerror else error_text(error)
                raise LineClosedError(text, "closed", str(error)) from None
            if isinstance(error, ValueError):
                raise RequestError(str(error)) from None
            raise
        return self

    def offer_faults(self) -> None:
        """Give every device faults that can be switched on while it is served; call it before `open`."""
        self.devices = tuple(map(offering_faults, self.devices))

    @property
    def stores(self) -> Sequence[DeviceStore]:
        """Return the data of each device: its memory and its faults."""
        return self._opened().stores

    def _seen(self, port: str, number: int, seen: Seen) -> None:
        if self._monitor is not None:
            self._monitor(seen)
        sent = seen.direction == "out"
        if self.watch is None or (number and not sent and seen.kind != "trouble"):
            return
        if sent:
            self.load.bytes_out += len(seen.raw)
        else:
            self.load.bytes_in += len(seen.raw)
        self.watch(port, number, seen)

    async def close(self) -> None:
        """Stop serving, and close the port. Closing twice has no effect."""
        self.close_now()
        await asyncio.sleep(0)

    def close_now(self) -> None:
        """Close as `close` does, without running the loop: network connections are closed at its next turn."""
        if self._serving is not None:
            self._serving.stop()
        for one in self._points or ():
            one.stop()
        capture, self._capturing = self._capturing, None
        if capture is not None:
            capture.close()
            self.lost += capture.problems

    def __await__(self) -> Generator[Any, None, Self]:
        return self.open().__await__()

    async def __aenter__(self) -> Self:
        return await self.open()

    async def __aexit__(self, *error: object) -> None:
        await self.close()

    # ---- memory -------------------------------------------------------------------------------------------

    @property
    def memory(self) -> Memory:
        """Return the memory of the device, or of the first device."""
        return self._memory(0, self.do)

    def memory_of(self, station: Any) -> Memory:
        """Return the memory of the device with that station. Raises RequestError."""
        for number, device in enumerate(self.devices):
            if device.own == checked_station(device.protocol, station):
                return self._memory(number, self.do)
        known = ", ".join(str(device.own) for device in self.devices)
        raise RequestError(f"no device here has the station {station} – known: {known}")

    @property
    def points(self) -> list[RunPoints]:
        """Return for each device the values with a behaviour or a start value, by name or address; all may be written.

        A device over two protocols has them once.
        """
        serving = self._opened()
        if self._points is None:
            self._points = begun_points(serving.stores, serving.clock)
        return [RunPoints(one.service, self.do) for one in self._points]

    def _memory(self, number: int, do: Do) -> Memory:
        store = self._opened().stores[number]
        return Memory(store.memory, store.device.grammar, do, self._opened().clock.call_soon, store.refresh)

    def _opened(self) -> Serving:
        if self._serving is None:
            raise RequestError("it has no memory before it is opened")
        return self._serving

    # ---- counters -----------------------------------------------------------------------------------------

    @property
    def done(self) -> int:
        """Return the number of requests carried out."""
        return sum(store.counters.done for store in self._opened().stores)

    @property
    def refused(self) -> dict[int, int]:
        """Return the numbers of refused requests, by code."""
        found: Counter[int] = Counter()
        for store in self._opened().stores:
            found.update(store.counters.refused)
        return dict(found)

    @property
    def connections(self) -> int:
        """Return the number of connections made."""
        return self._opened().connections

    @property
    def line_errors(self) -> Mapping[str, int]:
        """Return the faults on the line: bad frames by their cause, noise, connections that were refused or closed."""
        return self._opened().line_errors

    def status(self) -> list[ServedDevice]:
        """Return the work of each device so far."""
        serving, found = self._opened(), []
        for number, store in enumerate(serving.stores):
            protocol, counters = store.device.protocol, store.counters
            reasons = dict(counters.reasons(protocol))
            found.append(ServedDevice(store.device, counters.done, counters.errors, reasons, serving.published(number)))
        return found


def view_of_devices(server: AsyncServer, log: FrameLog, state: Callable[[], str]) -> LiveView:
    """Return the view of devices that have not been opened yet; `log` gets the events that all of them receive."""
    lines = {}
    for number, device in enumerate(server.devices, 1):
        log.know(number, device.protocol, device.role, device.params)
        own = f" station {device.station}" if device.station else ""
        name = f"{device.protocol.name}{own}" + ("" if server.line is None else f" {server.line}")
        lines[number] = LineOf(name, state, server.load)
    server.watch = lambda port, number, seen: log.add(number + 1, seen)
    return LiveView(log, time.monotonic_ns, lines)


def aserve(
    device: str | Path | Sequence[str | Path],
    port: str,
    *,
    station: Any = None,
    memory: str | None = None,
    initial: Mapping[str, Any] | None = None,
    sizes: Mapping[str, int] | None = None,
    map: Mapping[str, str] | None = None,
    params: Mapping[str, Any] | None = None,
    state: Mapping[str, Any] | None = None,
    role: str | None = None,
    speed: int | None = None,
    format: str | None = None,
    faults: str | None = None,
    monitor: Callable[[Seen], None] | None = None,
    idle_timeout: str | float = DEFAULT_LIMITS.idle / 1e9,
    connections: int = DEFAULT_LIMITS.per_address,
    allow: Sequence[str] = (),
    read_only: bool = False,
    texts: Mapping[str, str] | None = None,
) -> AsyncServer:
    """Return simulated devices for asyncio, opened by `async with` or `await`; see `framekit.serve` for the
    arguments.
    """
    if memory is not None and not isinstance(memory, str):
        raise RequestError(f"memory is the name of a profile, not {memory!r} – start values go into initial")
    stations = () if station is None else tuple(station) if isinstance(station, (list, tuple, range)) else (station,)
    settings = DeviceSettings(
        stations=tuple(_text(one) for one in stations),
        role=role,
        memory=memory,
        initial=dict(texts or {}),
        sizes={name: _text(value) for name, value in (sizes or {}).items()},
        params={name: _text(value) for name, value in (params or {}).items()},
        mapping=dict(map or {}),
        state=dict(state or {}),
    )
    names = [device] if isinstance(device, (str, Path)) else list(device)
    found = [one for name in names for one in load_devices(name, Path.cwd(), settings)]
    found = [replace(one, read_only=read_only) for one in with_faults(found, faults, Path.cwd())]
    try:
        check_line(found)
        line = line_of(found[0].protocol, speed, format)
        limits = ConnectionLimits(nanoseconds(idle_timeout), connections, _clients(allow, found, port))
    except ValueError as error:
        raise RequestError(str(error)) from None
    return AsyncServer(found, port, line, initial or {}, monitor, limits)


def _clients(allow: Sequence[str], devices: Sequence[Device], port: str) -> tuple[Network, ...]:
    """Return the networks of allowed clients: those given here, else those of the files. Raises ValueError."""
    if not allow:
        found: tuple[Network, ...] = ()
        for device in devices:
            found = in_both(found, device.clients)
        return found
    kind = scheme_of(port)
    if kind is None or kind.listen is None:
        raise ValueError(f"'{port}' has no clients with addresses – leave out which of them are allowed")
    return tuple(map(network_of, [allow] if isinstance(allow, str) else allow))


def _text(value: Any) -> str:
    """Return a value as text in the form of a device file."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    return value.hex(" ") if isinstance(value, bytes) else str(value)


class Server(Closing):
    """Devices serving on a port, made by `framekit.serve`; `with` or `close` ends them. Threads may share it."""

    def __init__(self, server: AsyncServer) -> None:
        self._server = server
        self._thread = thread = LoopThread(f"framekit serves {server.port}")
        server.do = thread.do_even_stopped
        self._end = weakref.finalize(self, thread.end_with, server.close_now, server.close)
        try:
            thread.wait(server.open())
        except BaseException:
            self._end()
            raise

    def close(self) -> None:
        """Stop serving, and close the port. Closing twice has no effect."""
        self._end()

    @property
    def port(self) -> str:
        """Return the name under which others connect: with the assigned port number for `tcp://…:0`, the terminal's
        path for `pty:`.
        """
        return self._server.port

    @property
    def devices(self) -> tuple[Device, ...]:
        """Return the served devices, one for each station."""
        return self._server.devices

    @property
    def memory(self) -> Memory:
        """Return the memory of the device, or of the first device."""
        return self._server.memory

    def memory_of(self, station: Any) -> Memory:
        """Return the memory of the device with that station. Raises RequestError."""
        return self._server.memory_of(station)

    @property
    def done(self) -> int:
        """Return the number of requests carried out."""
        return self._server.done

    @property
    def refused(self) -> dict[int, int]:
        """Return the numbers of refused requests, by code."""
        return self._thread.do(lambda: self._server.refused)


@with_arguments_of(aserve)
def serve(server: AsyncServer) -> Server:
    """Serve simulated devices on a port at once; `framekit.aserve` does the same for asyncio.

    `device`: a protocol, whose services are served, or a device file; several share the line. `port`: `tcp://HOST:PORT`
    or `udp-listen://HOST:PORT` listens there (0 for any free number), `pty:` makes a pseudo-terminal, else a port as
    for `connect`. `station`: a number, or a list for as many devices. `memory`: a profile, instead of the protocol's
    own areas; `map`: places in it at which areas of the protocol begin. `initial`: ADDRESS → value or values. `sizes`:
    ADDRESS → elements of its area, also of an area that the protocol lacks by itself. `texts`: as `initial`, with texts
    in the form of device files. `state`: NAME → start value of a state variable, also a dict for a table or record, and
    a list. `params`, `role`, `speed`, `format`, `monitor`: as for `connect`. `faults`: a plan of
    faults in the transmissions of the devices. `idle_timeout` (seconds, a time such as `10 min`, or `never`): longest
    time of a connection without a good frame; `connections`: largest number for one client address; `allow`: addresses
    and networks of clients that may connect, such as `192.168.1.0/24`, instead of those in device files. `read_only`:
    clients may not write.

    Raises DefinitionError for a wrong file or setting of the device, RequestError, LineClosedError.
    """
    return Server(server)
