"""Simulated devices, for asyncio and without: they answer on a port; their memory is read and written meanwhile."""

from __future__ import annotations

import asyncio
import weakref
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from framekit.api.errors import LineClosedError, RequestError
from framekit.api.loop_thread import LoopStoppedError, LoopThread
from framekit.api.memory import Do, Memory
from framekit.api.run import nanoseconds
from framekit.api.settings import checked_station
from framekit.definition.times import LineFormat
from framekit.link.observe import Seen
from framekit.run.model import DEFAULT_LIMITS, ConnectionLimits
from framekit.runfile.devices import Device, DeviceSettings, load_devices, with_faults
from framekit.service.serving import Serving, begin_serving, check_line, line_of
from framekit.transport.clock import AsyncioClock


class AsyncServer:
    """Devices on a port, made by `framekit.aserve`. `async with` opens and closes it; so do `await` and `close`.

    `port` is where others reach it. Its memory may be used as soon as it is open.
    """

    def __init__(
        self, devices: Sequence[Device], port: str, line: LineFormat | None, initial: Mapping[str, Any],
        monitor: Callable[[Seen], None] | None = None, limits: ConnectionLimits = DEFAULT_LIMITS,
    ) -> None:  # fmt: skip
        self.devices = tuple(devices)
        self.port = port
        self.do: Do = lambda action: action()
        self._line = line
        self._initial = initial
        self._monitor = monitor
        self._limits = limits
        self._serving: Serving | None = None
        self._stack = ExitStack()

    async def open(self) -> Self:
        """Begins to serve. Raises LineClosedError, RequestError for what is no port or does not fit the memory."""
        if self._serving is not None:
            return self
        loop = asyncio.get_running_loop()
        clock = AsyncioClock(loop)
        first_state: asyncio.Future[str] = loop.create_future()

        def state(port: str, text: str) -> None:
            if not first_state.done():
                first_state.set_result(text)

        self._serving = serving = Serving(
            self.devices, clock, self._line, self._watch(), on_state=state, limits=self._limits
        )
        self._stack.callback(serving.stop)
        try:
            for address, values in self._initial.items():
                self._memory(0, lambda action: action()).write(address, values)
            self.port = (await begin_serving(self.port, serving, clock, first_state, self._stack)).port
        except BaseException as error:
            self.close_now()
            if isinstance(error, OSError):
                raise LineClosedError(f"{self.port}: {error.strerror or error}", "closed", str(error)) from None
            if isinstance(error, ValueError):
                raise RequestError(str(error)) from None
            raise
        return self

    def _watch(self) -> Callable[[str, int, Seen], None] | None:
        monitor = self._monitor
        return None if monitor is None else lambda port, number, seen: monitor(seen)

    async def close(self) -> None:
        """Answers no more, and closes the port. Closing twice does nothing."""
        self.close_now()
        await asyncio.sleep(0)

    def close_now(self) -> None:
        """As `close`, without letting the loop go on: network connections are told at its next turn."""
        self._stack.close()

    def __await__(self) -> Generator[Any, None, Self]:
        return self.open().__await__()

    async def __aenter__(self) -> Self:
        return await self.open()

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    # ---- memory -------------------------------------------------------------------------------------------

    @property
    def memory(self) -> Memory:
        """The memory of the device, of the first where there are several."""
        return self._memory(0, self.do)

    def memory_of(self, station: Any) -> Memory:
        """The memory of the device with that station. Raises RequestError."""
        for number, device in enumerate(self.devices):
            if device.own == checked_station(device.protocol, station):
                return self._memory(number, self.do)
        known = ", ".join(str(device.own) for device in self.devices)
        raise RequestError(f"no device here has the station {station} – known: {known}")

    def _memory(self, number: int, do: Do) -> Memory:
        store = self._opened().stores[number]
        return Memory(store.memory, store.device.grammar, do, self._opened().clock.call_soon, store.refresh)

    def _opened(self) -> Serving:
        if self._serving is None:
            raise RequestError("it has no memory before it is opened")
        return self._serving

    @property
    def done(self) -> int:
        """How many requests have been carried out."""
        return sum(store.counters.done for store in self._opened().stores)

    @property
    def refused(self) -> dict[int, int]:
        """How many requests were refused, by the code they were refused with."""
        found: dict[int, int] = {}
        for store in self._opened().stores:
            for code, count in store.counters.refused.items():
                found[code] = found.get(code, 0) + count
        return found


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
    role: str | None = None,
    speed: int | None = None,
    format: str | None = None,
    faults: str | None = None,
    monitor: Callable[[Seen], None] | None = None,
    idle_timeout: str | float = DEFAULT_LIMITS.idle / 1e9,
    connections: int = DEFAULT_LIMITS.per_address,
) -> AsyncServer:
    """Simulated devices for asyncio, opened by `async with` or `await`; see `framekit.serve` for the arguments."""
    if memory is not None and not isinstance(memory, str):
        raise RequestError(f"memory is the name of a profile, not {memory!r} – start values go into initial")
    stations = () if station is None else tuple(station) if isinstance(station, (list, tuple, range)) else (station,)
    settings = DeviceSettings(
        stations=tuple(_text(one) for one in stations),
        role=role,
        memory=memory,
        sizes={name: _text(value) for name, value in (sizes or {}).items()},
        params={name: _text(value) for name, value in (params or {}).items()},
        mapping=dict(map or {}),
    )
    names = [device] if isinstance(device, (str, Path)) else list(device)
    found = [one for name in names for one in load_devices(name, Path.cwd(), settings)]
    found = with_faults(found, faults, Path.cwd())
    try:
        check_line(found)
        line = line_of(found[0], speed, format)
        limits = ConnectionLimits(nanoseconds(idle_timeout), connections)
    except ValueError as error:
        raise RequestError(str(error)) from None
    return AsyncServer(found, port, line, initial or {}, monitor, limits)


def _text(value: Any) -> str:
    """A value as it would stand in a device file."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    return value.hex(" ") if isinstance(value, bytes) else str(value)


class Server:
    """Devices at work on a port, made by `framekit.serve`; `with` or `close` ends them. Threads may share it."""

    def __init__(self, server: AsyncServer) -> None:
        self._server = server
        self._thread = thread = LoopThread(f"framekit serves {server.port}")
        server.do = thread.do_even_stopped
        self._end = weakref.finalize(self, _end, thread, server)
        try:
            thread.wait(server.open())
        except BaseException:
            self._end()
            raise

    def close(self) -> None:
        """Answers no more, and closes the port. Closing twice does nothing."""
        self._end()

    def __enter__(self) -> Server:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def port(self) -> str:
        """Where others reach it: the number that was free for `tcp://…:0`, the terminal's path for `pty:`."""
        return self._server.port

    @property
    def devices(self) -> tuple[Device, ...]:
        """What is served, one for each station."""
        return self._server.devices

    @property
    def memory(self) -> Memory:
        """The memory of the device, of the first where there are several."""
        return self._server.memory

    def memory_of(self, station: Any) -> Memory:
        """The memory of the device with that station. Raises RequestError."""
        return self._server.memory_of(station)

    @property
    def done(self) -> int:
        """How many requests have been carried out."""
        return self._server.done

    @property
    def refused(self) -> dict[int, int]:
        """How many requests were refused, by the code they were refused with."""
        return self._thread.do(lambda: self._server.refused)


def _end(thread: LoopThread, server: AsyncServer) -> None:
    try:
        if thread.is_here:
            server.close_now()
        else:
            thread.wait(server.close())
    except LoopStoppedError:
        return
    thread.stop()


def serve(
    device: str | Path | Sequence[str | Path],
    port: str,
    *,
    station: Any = None,
    memory: str | None = None,
    initial: Mapping[str, Any] | None = None,
    sizes: Mapping[str, int] | None = None,
    map: Mapping[str, str] | None = None,
    params: Mapping[str, Any] | None = None,
    role: str | None = None,
    speed: int | None = None,
    format: str | None = None,
    faults: str | None = None,
    monitor: Callable[[Seen], None] | None = None,
    idle_timeout: str | float = DEFAULT_LIMITS.idle / 1e9,
    connections: int = DEFAULT_LIMITS.per_address,
) -> Server:
    """Simulated devices that answer on a port at once; `framekit.aserve` does the same for asyncio.

    `device`: a protocol, whose services are served, or a device file; several share the line. `port`:
    `tcp://HOST:PORT` or `udp-listen://HOST:PORT` listens there (0 for any number that is free), `pty:` makes a
    pseudo-terminal, else a port as for `connect`. `station`: a number, or a list for as many devices. `memory`: a
    profile, instead of the protocol's own areas; `map`: where areas of the protocol begin in it. `initial`: ADDRESS →
    value or values. `sizes`: ADDRESS → elements of the area there, also of one the protocol has not by itself.
    `params`, `role`, `speed`, `format`, `monitor`: as for `connect`. `faults`: a fault plan, of what goes wrong with
    what the devices send. `idle_timeout` (seconds, a time such as `10 min`, or `never`): how long a connection may go
    without a good frame; `connections`: of one client address.

    Raises DefinitionError for a wrong file or setting of the device, RequestError, LineClosedError.
    """
    return Server(
        aserve(
            device, port, station=station, memory=memory, initial=initial, sizes=sizes, map=map, params=params,
            role=role, speed=speed, format=format, faults=faults, monitor=monitor, idle_timeout=idle_timeout,
            connections=connections,
        )
    )  # fmt: skip
