"""Simulated devices for programs without asyncio: the async ones, in a thread of their own."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

from framekit.api.async_server import AsyncServer, aserve
from framekit.api.loop_thread import LoopStoppedError, LoopThread
from framekit.api.memory import Memory
from framekit.blocks.device import Device
from framekit.blocks.model import DEFAULT_LIMITS
from framekit.link.observe import Seen


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
