"""TCP: a listener that makes a port of every connection it accepts.

What the bytes mean is not known here.
"""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable

from framekit.transport.clock import AsyncioClock
from framekit.transport.port import PortEvents
from framekit.transport.tcp_port import Connection, StreamPort, bracketed


class AcceptedPort(StreamPort):
    """A connection somebody else has made; it can't be opened again. Bytes that come before it is opened wait.

    So do those that come while something is still to be sent: whoever takes no replies cannot heap up requests.
    """

    opens_again = False
    ends_itself = True
    """Whether the other side tells when it has finished."""
    host = ""
    """The address of the other side."""

    def connected(self) -> None:
        transport = self.connection.transport if self.connection is not None else None
        if transport is not None:
            transport.pause_reading()

    def open(self, events: PortEvents) -> None:
        self.events = events
        connection = self.connection
        self.clock.call_soon(lambda: self._begin(events, connection))

    def hear(self, data: bytes) -> None:
        super().hear(data)
        self._pace()

    def left(self) -> None:
        super().left()
        self._pace()

    def _pace(self) -> None:
        transport = self._transport
        if transport is not None and self._sent_due:
            transport.pause_reading()
        elif transport is not None:
            transport.resume_reading()

    def _begin(self, events: PortEvents, connection: Connection | None) -> None:
        if self.events is not events or self.connection is not connection:
            return
        if connection is None or connection.transport is None:
            self.lost("the connection is over")
            return
        events.opened(self.clock.now())
        if self.connection is connection and connection.transport is not None:
            connection.transport.resume_reading()


Accepted = Callable[[AcceptedPort], None]


class TcpListener:
    """Accepts connections; `accepted` gets a port, not yet opened, for each. `number` 0 asks for any that is free."""

    def __init__(self, host: str, number: int, clock: AsyncioClock, accepted: Accepted) -> None:
        self.host, self.number = host, number
        self.clock = clock
        self.accepted = accepted
        self._socket: socket.socket | None = None
        self._serving: asyncio.Task[None] | None = None
        self._server: asyncio.Server | None = None

    def listen(self) -> int:
        """Begins to listen; the port number, which matters where 0 was asked for. Raises OSError."""
        found = socket.getaddrinfo(self.host or None, self.number, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
        family, *_, address = min(found, key=lambda one: one[0] != socket.AF_INET)
        self._socket = listening = socket.create_server((str(address[0]), int(address[1])), family=family)
        self.number = int(listening.getsockname()[1])
        self._serving = self.clock.loop.create_task(self._serve(listening))
        return self.number

    async def start(self) -> int:
        """As `listen`, in a coroutine; connections are accepted when it returns. Raises OSError."""
        number = self.listen()
        if self._serving is not None:
            await self._serving
        return number

    async def _serve(self, listening: socket.socket) -> None:
        self._server = await self.clock.loop.create_server(self._protocol, sock=listening)

    def _protocol(self) -> asyncio.BufferedProtocol:
        return _AcceptedConnection(AcceptedPort(self.host, self.clock), self.accepted)

    def stop(self) -> None:
        """Accepts no more; ports that have been accepted stay open."""
        if self._serving is not None:
            self._serving.cancel()
        if self._server is not None:
            self._server.close()
        elif self._socket is not None:
            self._socket.close()


class _AcceptedConnection(Connection):
    """Is its port's connection from the start, and offers the port when it is made."""

    def __init__(self, port: AcceptedPort, accepted: Accepted) -> None:
        super().__init__(port)
        self.accepted_port = port
        self.accepted = accepted
        port.connection = self

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        host, number, *_ = transport.get_extra_info("peername") or (self.port.name, 0)
        self.port.name = f"tcp://{bracketed(host)}:{number}"
        self.accepted_port.host = str(host)
        super().connection_made(transport)
        self.accepted(self.accepted_port)


def listen(host: str, number: int, clock: AsyncioClock, accepted: Accepted) -> TcpListener:
    """Listens at `host:number` from now on; `accepted` gets a port for each connection. Raises OSError."""
    listener = TcpListener(host, number, clock, accepted)
    listener.listen()
    return listener
