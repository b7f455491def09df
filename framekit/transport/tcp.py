"""TCP: a port that connects to a host, and a listener that makes a port of every connection it accepts."""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket

from framekit.transport.clock import MOST, AsyncioClock
from framekit.transport.port import Accepted, AcceptedPort, Port, PortEvents, PortListener

CONNECT_WITHIN = 10.0
"""How long making a connection may take (s); some networks never refuse one."""
FAR_END_CLOSED = "the other side has closed the connection"

NEWCOMER = 128
"""To make a connection ready costs as much as so many bytes."""


class Connection(asyncio.BufferedProtocol):
    """One connection, for as long as its port takes it for its own; what comes of it later is nobody's.

    What is sent in one go is dealt with in many turns, with those of others in between; the rest waits in the network.
    Where others have used up a turn, the piece that has been read waits for the next, and no more is read.
    """

    def __init__(self, port: StreamPort) -> None:
        self.port = port
        self._taken = memoryview(bytearray(MOST))
        self.transport: asyncio.Transport | None = None
        self.is_full = False
        self.waits = False

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        with contextlib.suppress(OSError):
            connected: socket.socket = transport.get_extra_info("socket")
            connected.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            connected.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        transport.set_write_buffer_limits(0)
        self.transport = transport
        if self.port.connection is self:
            self.port.connected()
        else:
            transport.abort()

    def get_buffer(self, sizehint: int) -> memoryview:
        return self._taken[: self.port.clock.turns.room]

    def buffer_updated(self, nbytes: int) -> None:
        data = self._taken[:nbytes].tobytes()
        self.waits = not self.port.clock.turns.take(nbytes, lambda: self._hear(data))
        if self.waits and self.transport is not None:
            self.transport.pause_reading()

    def _hear(self, data: bytes) -> None:
        waited, self.waits = self.waits, False
        if self.port.connection is not self:
            return
        self.port.hear(data)
        if waited and self.port.connection is self:
            self.port.pace()

    def pause_writing(self) -> None:
        self.is_full = True

    def resume_writing(self) -> None:
        self.is_full = False
        if self.port.connection is self:
            self.port.left()

    def connection_lost(self, error: Exception | None) -> None:
        self.transport = None
        if self.port.connection is self:
            self.port.lost(FAR_END_CLOSED if error is None else str(error) or type(error).__name__)


class StreamPort(Port):
    """What connected and accepted ports have in common."""

    is_stream = True

    def __init__(self, name: str, clock: AsyncioClock) -> None:
        self.name = name
        self.settings = None
        self.clock = clock
        self.connection: Connection | None = None
        self.events: PortEvents | None = None
        self._sent_due = False

    def connected(self) -> None:
        """The connection is there."""
        if self.events is not None:
            self.events.opened(self.clock.now())

    def hear(self, data: bytes) -> None:
        """Bytes have come."""
        if self.events is not None:
            self.events.received(data, self.clock.now())

    def pace(self) -> None:
        """More is read, but not while a piece waits for its turn."""
        transport = self._transport
        if transport is not None and not self._holds_back:
            transport.resume_reading()

    @property
    def _holds_back(self) -> bool:
        """Whether nothing is to be read now."""
        return self.connection is not None and self.connection.waits

    def lost(self, reason: str) -> None:
        """The connection is over, or could not be made."""
        events = self.events
        self._forget()
        if events is not None:
            events.closed(self.clock.now(), reason)

    def _forget(self) -> None:
        self.events = self.connection = None
        self._sent_due = False

    def write(self, data: bytes) -> None:
        transport = self._transport
        if transport is not None:
            transport.write(data)
            self._tell_when_sent()

    def write_through(self, data: bytes) -> bool:
        connection = self.connection
        transport = None if connection is None or self.events is None else connection.transport
        if connection is None or transport is None or self._sent_due:
            self.write(data)
            return False
        transport.write(data)
        self._sent_due = connection.is_full  # `left` is called when the operating system has taken the rest
        return not connection.is_full

    def send_break(self, duration: int) -> None:
        if self._transport is not None:
            self._tell_when_sent()

    @property
    def _transport(self) -> asyncio.Transport | None:
        return None if self.connection is None or self.events is None else self.connection.transport

    def _tell_when_sent(self) -> None:
        if not self._sent_due:
            self._sent_due = True
            connection = self.connection
            self.clock.call_soon(lambda: self.left() if self.connection is connection else None)

    def left(self) -> None:
        """The operating system may have taken everything."""
        connection = self.connection
        if self._sent_due and connection is not None and not connection.is_full and self.events is not None:
            self._sent_due = False
            self.events.sent(self.clock.now())

    def close(self) -> None:
        """What has been handed over is still sent."""
        transport = self.connection.transport if self.connection is not None else None
        self._forget()
        if transport is not None:
            transport.close()


class TcpPort(StreamPort):
    """A connection to `host:port`, made anew whenever the port is opened."""

    def __init__(self, host: str, number: int, clock: AsyncioClock, connect_within: int | None = None) -> None:
        super().__init__(f"tcp://{bracketed(host)}:{number}", clock)
        self.connect_within = CONNECT_WITHIN if connect_within is None else connect_within / 1e9
        self.host, self.number = host, number
        self._connecting: asyncio.Task[None] | None = None

    def open(self, events: PortEvents) -> None:
        self.close()
        self.events = events
        self.connection = connection = Connection(self)
        self._connecting = self.clock.loop.create_task(self._connect(connection))

    async def _connect(self, connection: Connection) -> None:
        try:
            async with asyncio.timeout(self.connect_within):
                await self.clock.loop.create_connection(lambda: connection, self.host, self.number)
        except TimeoutError:
            reason = f"no connection to {self.host}:{self.number} within {self.connect_within:g} s"
        except (OSError, UnicodeError) as error:
            number = getattr(error, "errno", None) or 0
            why = os.strerror(number) if number > 0 else getattr(error, "strerror", None) or str(error)
            reason = f"no connection to {self.host}:{self.number}: {why}"
        else:
            return
        if self.connection is connection:
            self.lost(reason)

    def close(self) -> None:
        connecting, self._connecting = self._connecting, None
        if connecting is not None:
            connecting.cancel()
        super().close()


def bracketed(host: str) -> str:
    """A host as it stands before a port number."""
    return f"[{host}]" if ":" in host else host


class TcpAcceptedPort(StreamPort, AcceptedPort):
    """A connection that the other side has made. Bytes that come before it is opened wait.

    So do those that come while something is still to be sent: a client that takes no replies cannot heap up requests.
    """

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
        if self._sent_due and self._transport is not None:
            self._transport.pause_reading()
        else:
            self.pace()

    def left(self) -> None:
        super().left()
        self.pace()

    @property
    def _holds_back(self) -> bool:
        return self._sent_due or super()._holds_back

    def _begin(self, events: PortEvents, connection: Connection | None) -> None:
        if self.events is not events or self.connection is not connection:
            return
        if connection is None or connection.transport is None:
            self.lost("the connection is over")
            return
        events.opened(self.clock.now())
        if self.connection is connection and connection.transport is not None:
            connection.transport.resume_reading()


class TcpListener(PortListener):
    """Accepts connections; `accepted` gets a port, not yet opened, for each. `number` 0 asks for any that is free."""

    def __init__(self, host: str, number: int, clock: AsyncioClock, accepted: Accepted) -> None:
        self.host, self.number = host, number
        self.clock = clock
        self.accepted = accepted
        self._socket: socket.socket | None = None
        self._serving: asyncio.Task[None] | None = None
        self._server: asyncio.Server | None = None

    @property
    def name(self) -> str:  # type: ignore[override]  # the number is known when it listens
        return f"tcp-listen://{bracketed(self.host)}:{self.number}"

    @property
    def reached(self) -> str:  # type: ignore[override]
        return f"tcp://{bracketed(self.host)}:{self.number}"

    def listen(self) -> None:
        found = socket.getaddrinfo(self.host or None, self.number, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
        family, *_, address = min(found, key=lambda one: one[0] != socket.AF_INET)
        self._socket = listening = socket.create_server((str(address[0]), int(address[1])), family=family)
        self.number = int(listening.getsockname()[1])
        self._serving = self.clock.loop.create_task(self._serve(listening))

    async def start(self) -> None:
        self.listen()
        if self._serving is not None:
            await self._serving

    async def _serve(self, listening: socket.socket) -> None:
        self._server = await self.clock.loop.create_server(self._protocol, sock=listening)

    def _protocol(self) -> asyncio.BufferedProtocol:
        return _AcceptedConnection(TcpAcceptedPort(self.host, self.clock), self.accepted)

    def stop(self) -> None:
        serving, self._serving = self._serving, None
        server, self._server = self._server, None
        if serving is not None:
            serving.cancel()
        if server is not None:
            server.close()
        elif self._socket is not None:
            self._socket.close()


class _AcceptedConnection(Connection):
    """Is its port's connection from the start, and offers the port when it is made."""

    def __init__(self, port: TcpAcceptedPort, accepted: Accepted) -> None:
        super().__init__(port)
        self.accepted_port = port
        self.accepted = accepted
        port.connection = self

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        host, number, *_ = transport.get_extra_info("peername") or (self.port.name, 0)
        self.port.name = f"tcp://{bracketed(host)}:{number}"
        self.accepted_port.host = str(host)
        super().connection_made(transport)
        self.port.clock.turns.take(NEWCOMER, self._offer)

    def _offer(self) -> None:
        if self.transport is not None:
            self.accepted(self.accepted_port)
