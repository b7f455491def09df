"""TCP: a port that connects, and a listener that makes a port of every connection it accepts."""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import Callable

from framekit.transport.clock import AsyncioClock
from framekit.transport.port import Port, PortEvents


class _Connection(asyncio.Protocol):
    """Hands the events of one connection to its port."""

    def __init__(self, port: StreamPort) -> None:
        self.port = port

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        with contextlib.suppress(OSError):
            transport.get_extra_info("socket").setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.port.connected(transport)

    def data_received(self, data: bytes) -> None:
        self.port.hear(data)

    def connection_lost(self, error: Exception | None) -> None:
        self.port.lost(str(error) if error is not None else "the other side has closed the connection")


class StreamPort(Port):
    """What connected and accepted ports have in common."""

    def __init__(self, name: str, clock: AsyncioClock) -> None:
        self.name = name
        self.line = None
        self.clock = clock
        self.events: PortEvents | None = None
        self.transport: asyncio.Transport | None = None

    def connected(self, transport: asyncio.Transport) -> None:
        self.transport = transport
        if self.events is not None:
            self.events.opened(self.clock.now())

    def hear(self, data: bytes) -> None:
        if self.events is not None:
            self.events.received(data, self.clock.now())

    def lost(self, reason: str) -> None:
        events, self.events, self.transport = self.events, None, None
        if events is not None:
            events.closed(self.clock.now(), reason)

    def write(self, data: bytes) -> None:
        """A stream has no bit times: what is handed over counts as sent."""
        if self.transport is not None:
            self.transport.write(data)
            self.clock.call_soon(self._sent)

    def _sent(self) -> None:
        if self.events is not None and self.transport is not None:
            self.events.sent(self.clock.now())

    def send_break(self, duration: int) -> None:
        self.clock.call_soon(self._sent)

    def close(self) -> None:
        self.events = None
        transport, self.transport = self.transport, None
        if transport is not None:
            transport.close()


class TcpPort(StreamPort):
    """A connection to `host:port`, made anew whenever the port is opened."""

    def __init__(self, host: str, number: int, clock: AsyncioClock) -> None:
        super().__init__(f"tcp://{host}:{number}", clock)
        self.host, self.number = host, number
        self._connecting: asyncio.Task[None] | None = None

    def open(self, events: PortEvents) -> None:
        self.events = events
        self._connecting = self.clock.loop.create_task(self._connect())

    async def _connect(self) -> None:
        try:
            await self.clock.loop.create_connection(lambda: _Connection(self), self.host, self.number)
        except OSError as error:
            self.lost(str(error))

    def close(self) -> None:
        if self._connecting is not None:
            self._connecting.cancel()
        super().close()


class AcceptedPort(StreamPort):
    """A connection somebody else has made; it can't be opened again."""

    def open(self, events: PortEvents) -> None:
        self.events = events
        if self.transport is not None:
            self.clock.call_soon(lambda: events.opened(self.clock.now()))
        else:
            self.clock.call_soon(lambda: self.lost("the connection is over"))


class TcpListener:
    """Accepts connections; `accepted` gets a port for each."""

    def __init__(self, host: str, number: int, clock: AsyncioClock, accepted: Callable[[AcceptedPort], None]) -> None:
        self.host, self.number = host, number
        self.clock = clock
        self.accepted = accepted
        self.server: asyncio.Server | None = None

    async def start(self) -> int:
        """Begins to listen; the port number, which matters where 0 was asked for. Raises OSError."""
        self.server = await self.clock.loop.create_server(self._protocol, self.host, self.number)
        self.number = self.server.sockets[0].getsockname()[1]
        return self.number

    def _protocol(self) -> asyncio.Protocol:
        port = AcceptedPort(f"tcp://{self.host}:{self.number}", self.clock)
        listener = self

        class Accepted(_Connection):
            def connection_made(self, transport: asyncio.BaseTransport) -> None:
                super().connection_made(transport)
                listener.accepted(port)

        return Accepted(port)

    def stop(self) -> None:
        if self.server is not None:
            self.server.close()
