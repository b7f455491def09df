"""TCP: a port that connects, and what ports of connections have in common (see `tcp_listener`).

A stream has no bit times: what the operating system has taken counts as sent. What the bytes mean is not known here.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket

from framekit.transport.clock import AsyncioClock
from framekit.transport.port import Port, PortEvents

CONNECT_WITHIN = 10.0
"""How long making a connection may take (s); some networks never refuse one."""
FAR_END_CLOSED = "the other side has closed the connection"

MOST = 1_536
"""So many bytes all connections together take in one turn of the loop: 10 ms where a byte costs 6 µs."""

FEWEST = 16
"""So many bytes each connection may take all the same."""


class Connection(asyncio.BufferedProtocol):
    """One connection, for as long as its port takes it for its own; what comes of it later is nobody's.

    What is sent in one go is dealt with in many turns, with those of others in between; the rest waits in the network.
    """

    def __init__(self, port: StreamPort) -> None:
        self.port = port
        self._taken = memoryview(bytearray(MOST))
        self.transport: asyncio.Transport | None = None
        self.is_full = False

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
        return self._taken[: max(FEWEST, MOST - self.port.clock.heard)]

    def buffer_updated(self, nbytes: int) -> None:
        if self.port.connection is self:
            self.port.clock.hear(nbytes)
            self.port.hear(self._taken[:nbytes].tobytes())

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
