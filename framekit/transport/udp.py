"""UDP: a port that talks to one host, one that answers the sender of the last datagram, and a listener.

The listener makes a port of every sender. A sender never says that it has finished: its port is there until it is
closed. A datagram is told as bytes that came without a pause; none is kept, and none is sent twice. The operating
system drops datagrams of strangers on a port that talks to one host; one that listens tells when the sender is
another one.
"""

from __future__ import annotations

import asyncio
import os
import socket
from collections import deque
from collections.abc import Callable
from typing import Any, cast

from framekit.transport.clock import MOST, PIECE, AsyncioClock, Turns
from framekit.transport.port import Accepted, AcceptedPort, Port, PortEvents, PortListener
from framekit.transport.tcp import bracketed

LARGEST = 65_507
"""Bytes that fit into a datagram (IPv4)."""

MOST_WAITING = 256
"""So many pieces wait for their turn; datagrams that come all the same are lost, as datagrams may be."""


class Datagrams:
    """What came in datagrams, told with its sender in turns of the loop; a large one in pieces without a pause."""

    def __init__(self, turns: Turns, tell: Callable[[bytes, Any], None]) -> None:
        self._turns = turns
        self._tell = tell
        self._waiting: deque[tuple[bytes, Any]] = deque()
        self._comes = self._asks = False

    def add(self, data: bytes, sender: Any) -> None:
        """A datagram came."""
        if len(self._waiting) < MOST_WAITING:
            size = MOST - PIECE
            self._waiting.extend((data[at : at + size], sender) for at in range(0, max(len(data), 1), size))
            self._ask()

    def _ask(self) -> None:
        """For a turn for the first that waits, and as long as there is room for the next."""
        if self._asks:
            return
        self._asks = True
        while self._waiting and not self._comes:
            self._comes = True
            self._turns.take(len(self._waiting[0][0]), self._next)
        self._asks = False

    def _next(self) -> None:
        self._comes = False
        if self._waiting:
            self._tell(*self._waiting.popleft())
            self._ask()

    def clear(self) -> None:
        """Nothing more is told."""
        self._waiting.clear()


class UdpPort(Port):
    """Datagrams to and from `host:number`, or with `listens`, at it: then they go to the sender of the last one."""

    def __init__(self, host: str, number: int, clock: AsyncioClock, *, listens: bool = False) -> None:
        self.host, self.number = host, number
        self.listens = listens
        self.name = f"udp{'-listen' if listens else ''}://{f'[{host}]' if ':' in host else host}:{number}"
        self.settings = None
        self.clock = clock
        self.peer: Any = None
        self._events: PortEvents | None = None
        self._endpoint: _Endpoint | None = None
        self._opening: asyncio.Task[None] | None = None
        self._sent_due = False

    # ---- life ---------------------------------------------------------------------------------------------

    def open(self, events: PortEvents) -> None:
        self.close()
        self._events = events
        self._endpoint = endpoint = _Endpoint(self)
        self._opening = self.clock.loop.create_task(self._open(endpoint))

    async def _open(self, endpoint: _Endpoint) -> None:
        place = (self.host, self.number)
        where: dict[str, Any] = {"local_addr": place} if self.listens else {"remote_addr": place}
        try:
            transport, _ = await self.clock.loop.create_datagram_endpoint(lambda: endpoint, **where)
        except (OSError, UnicodeError) as error:
            number = getattr(error, "errno", None) or 0
            why = os.strerror(number) if number > 0 else str(error)
            self.lost(endpoint, f"cannot {'listen at' if self.listens else 'reach'} {self.host}:{self.number}: {why}")
            return
        if self._endpoint is not endpoint:
            transport.close()
            return
        if self.listens:
            self.number = int(transport.get_extra_info("sockname")[1])
        if self._events is not None:
            self._events.opened(self.clock.now())

    def close(self) -> None:
        opening, self._opening = self._opening, None
        endpoint, self._endpoint = self._endpoint, None
        self._events = None
        self._sent_due = False
        if opening is not None:
            opening.cancel()
        if endpoint is not None and endpoint.transport is not None:
            endpoint.transport.close()

    def lost(self, endpoint: _Endpoint, reason: str) -> None:
        """The socket is gone, or could not be had."""
        events = self._events
        if self._endpoint is endpoint:
            self._opening = None
            self.close()
            if events is not None:
                events.closed(self.clock.now(), reason)

    # ---- bytes --------------------------------------------------------------------------------------------

    def write(self, data: bytes) -> None:
        transport = None if self._endpoint is None else self._endpoint.transport
        if transport is None or self._events is None:
            return
        if data and not (self.listens and self.peer is None):
            for start in range(0, len(data), LARGEST):
                transport.sendto(data[start : start + LARGEST], self.peer if self.listens else None)
        self._tell_when_sent()

    def send_break(self, duration: int) -> None:
        if self._endpoint is not None and self._endpoint.transport is not None:
            self._tell_when_sent()

    def _tell_when_sent(self) -> None:
        if not self._sent_due:
            self._sent_due = True
            self.clock.call_soon(self._left)

    def _left(self) -> None:
        if self._sent_due and self._events is not None:
            self._sent_due = False
            self._events.sent(self.clock.now())

    def hear(self, endpoint: _Endpoint, data: bytes, peer: Any) -> None:
        """A datagram came."""
        if self._endpoint is endpoint and self._events is not None:
            if peer != self.peer:
                is_other, self.peer = self.peer is not None, peer
                if is_other:
                    self._events.other_sender(self.clock.now())
            if data and self._events is not None:
                self._events.received(data, self.clock.now())


class _Endpoint(asyncio.DatagramProtocol):
    """One socket, for as long as its port takes it for its own."""

    def __init__(self, port: UdpPort) -> None:
        self.port = port
        self.transport: asyncio.DatagramTransport | None = None
        self._came = Datagrams(port.clock.turns, lambda data, sender: port.hear(self, data, sender))

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport = cast(asyncio.DatagramTransport, transport)  # its class is no subclass of that

    def datagram_received(self, data: bytes, addr: Any) -> None:
        self._came.add(data, addr)

    def error_received(self, exc: Exception) -> None:
        """Nobody listens there (yet): as on a line on which nobody answers, the time-outs say so."""

    def connection_lost(self, exc: Exception | None) -> None:
        if exc is not None:
            self.port.lost(self, str(exc) or type(exc).__name__)


MOST_KEPT = 16
"""Datagrams of a sender that wait until its port is opened; more are lost, as datagrams may be."""


class SenderPort(AcceptedPort):
    """Datagrams from and to one sender."""

    ends_itself = False

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


class UdpListener(asyncio.DatagramProtocol, PortListener):
    """Hears datagrams; `accepted` gets a port, not yet opened, for each sender. `number` 0 asks for any that is free.

    The port of a sender that has been closed is forgotten: the next datagram of the same sender makes a new one.
    """

    def __init__(self, host: str, number: int, clock: AsyncioClock, accepted: Accepted) -> None:
        self.host, self.number = host, number
        self.clock = clock
        self.accepted = accepted
        self.senders: dict[Any, SenderPort] = {}
        self._came = Datagrams(clock.turns, self._hear)
        self._socket: socket.socket | None = None
        self._opening: asyncio.Task[None] | None = None
        self._transport: asyncio.DatagramTransport | None = None

    @property
    def name(self) -> str:  # type: ignore[override]  # the number is known when it listens
        return f"udp-listen://{bracketed(self.host)}:{self.number}"

    @property
    def reached(self) -> str:  # type: ignore[override]
        return self.name

    def listen(self) -> None:
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

    async def start(self) -> None:
        self.listen()
        if self._opening is not None:
            await self._opening

    async def _open(self, listening: socket.socket) -> None:
        await self.clock.loop.create_datagram_endpoint(lambda: self, sock=listening)

    def stop(self) -> None:
        """Hears nothing and sends nothing more, also over the ports of senders."""
        self._came.clear()
        opening, self._opening = self._opening, None
        transport, self._transport = self._transport, None
        if opening is not None:
            opening.cancel()
        if transport is not None:
            transport.close()
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
