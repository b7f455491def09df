"""UDP: a listener that makes a port of every sender whose datagrams come to one number.

A sender never says that it has finished: its port is there until it is closed. What the bytes mean is not known
here.
"""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable
from typing import Any, cast

from framekit.transport.clock import AsyncioClock
from framekit.transport.port import Port, PortEvents
from framekit.transport.tcp_port import bracketed
from framekit.transport.udp_port import LARGEST, Datagrams

MOST_KEPT = 16
"""Datagrams of a sender that wait until its port is opened; more are lost, as datagrams may be."""


class SenderPort(Port):
    """Datagrams from and to one sender; it can't be opened again. Those that come before it is opened wait."""

    opens_again = False
    ends_itself = False
    """Whether the other side tells when it has finished."""

    def __init__(self, listener: UdpListener, address: Any) -> None:
        self.listener = listener
        self.address = address
        self.host = str(address[0])
        self.name = f"udp://{bracketed(self.host)}:{address[1]}"
        self.settings = None
        self._clock = listener.clock
        self._events: PortEvents | None = None
        self._waiting: list[bytes] = []
        self._is_open = self._sent_due = False

    def open(self, events: PortEvents) -> None:
        self._events = events
        self._clock.call_soon(lambda: self._begin(events))

    def _begin(self, events: PortEvents) -> None:
        if self._events is not events:
            return
        self._is_open = True
        events.opened(self._clock.now())
        waiting, self._waiting = self._waiting, []
        for data in waiting:
            self.hear(data)

    def hear(self, data: bytes) -> None:
        """A datagram of this sender came."""
        if self._is_open and self._events is not None:
            self._events.received(data, self._clock.now())
        elif len(self._waiting) < MOST_KEPT:
            self._waiting.append(data)

    def write(self, data: bytes) -> None:
        if self._is_open:
            self.listener.send(data, self.address)
            self._tell_when_sent()

    def send_break(self, duration: int) -> None:
        if self._is_open:
            self._tell_when_sent()

    def _tell_when_sent(self) -> None:
        if not self._sent_due:
            self._sent_due = True
            self._clock.call_soon(self._left)

    def _left(self) -> None:
        if self._sent_due and self._events is not None:
            self._sent_due = False
            self._events.sent(self._clock.now())

    def close(self) -> None:
        self._events = None
        self._is_open = self._sent_due = False
        self._waiting.clear()
        self.listener.forget(self)


class UdpListener(asyncio.DatagramProtocol):
    """Hears datagrams; `accepted` gets a port, not yet opened, for each sender. `number` 0 asks for any that is free.

    The port of a sender that has been closed is forgotten: the next datagram of the same sender makes a new one.
    """

    def __init__(self, host: str, number: int, clock: AsyncioClock, accepted: Callable[[SenderPort], None]) -> None:
        self.host, self.number = host, number
        self.clock = clock
        self.accepted = accepted
        self.senders: dict[Any, SenderPort] = {}
        self._came = Datagrams(clock.loop, self._hear)
        self._socket: socket.socket | None = None
        self._opening: asyncio.Task[None] | None = None
        self._transport: asyncio.DatagramTransport | None = None

    def listen(self) -> int:
        """Begins to listen; the port number, which matters where 0 was asked for. Raises OSError."""
        found = socket.getaddrinfo(self.host or None, self.number, type=socket.SOCK_DGRAM, flags=socket.AI_PASSIVE)
        family, kind, protocol, _, address = min(found, key=lambda one: one[0] != socket.AF_INET)
        self._socket = listening = socket.socket(family, kind, protocol)
        try:
            listening.setblocking(False)
            listening.bind(address)
        except OSError:
            listening.close()
            raise
        self.number = int(listening.getsockname()[1])
        self._opening = self.clock.loop.create_task(self._open(listening))
        return self.number

    async def start(self) -> int:
        """As `listen`, in a coroutine; datagrams are heard when it returns. Raises OSError."""
        number = self.listen()
        if self._opening is not None:
            await self._opening
        return number

    async def _open(self, listening: socket.socket) -> None:
        await self.clock.loop.create_datagram_endpoint(lambda: self, sock=listening)

    def stop(self) -> None:
        """Hears nothing and sends nothing more."""
        self._came.clear()
        if self._opening is not None:
            self._opening.cancel()
        if self._transport is not None:
            self._transport.close()
        elif self._socket is not None:
            self._socket.close()

    def send(self, data: bytes, address: Any) -> None:
        """Sends bytes to a sender, in more than one datagram only where they do not fit into one."""
        if self._transport is not None and not self._transport.is_closing():
            for start in range(0, len(data), LARGEST):
                self._transport.sendto(data[start : start + LARGEST], address)

    def forget(self, port: SenderPort) -> None:
        """A port is closed."""
        if self.senders.get(port.address) is port:
            del self.senders[port.address]

    # ---- events of the socket -----------------------------------------------------------------------------

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.DatagramTransport, transport)  # its class is no subclass of that

    def datagram_received(self, data: bytes, addr: Any) -> None:
        self._came.add(data, addr)

    def _hear(self, data: bytes, addr: Any) -> None:
        port = self.senders.get(addr)
        if port is None:
            port = self.senders[addr] = SenderPort(self, addr)
            self.accepted(port)
        if data and self.senders.get(addr) is port:
            port.hear(data)

    def error_received(self, exc: Exception) -> None:
        """A sender does not listen any more: it will not ask again."""
