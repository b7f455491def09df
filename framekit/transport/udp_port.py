"""UDP: a port that talks to one host, and one that listens and answers the sender of the last datagram.

A datagram is told as bytes that came without a pause; none is kept, and none is sent twice. The operating system drops
datagrams of strangers on a port that talks to one host; one that listens tells when the sender is another one. What
the bytes mean is not known here. See `udp_listener` for ports of their own for each sender.
"""

from __future__ import annotations

import asyncio
import os
from collections import deque
from collections.abc import Callable
from typing import Any, cast

from framekit.transport.clock import AsyncioClock
from framekit.transport.port import Port, PortEvents

LARGEST = 65_507
"""Bytes that fit into a datagram (IPv4)."""

MOST = 1_536
"""So many bytes of datagrams are told in one turn of the loop; the rest of a larger one follows in the next turns."""

MOST_WAITING = 256
"""So many pieces wait for their turn; datagrams that come all the same are lost, as datagrams may be."""


class Datagrams:
    """What came in datagrams, told with its sender, few bytes a turn of the loop and without a pause between them."""

    def __init__(self, loop: asyncio.AbstractEventLoop, tell: Callable[[bytes, Any], None]) -> None:
        self._loop = loop
        self._tell = tell
        self._waiting: deque[tuple[bytes, Any]] = deque()

    def add(self, data: bytes, sender: Any) -> None:
        """A datagram came."""
        if self._waiting:
            if len(self._waiting) < MOST_WAITING:
                self._put(data, sender)
            return
        if len(data) > MOST:
            self._put(data[MOST:], sender)
            self._loop.call_soon(self._next)
        self._tell(data[:MOST], sender)

    def _put(self, data: bytes, sender: Any) -> None:
        self._waiting.extend((data[at : at + MOST], sender) for at in range(0, max(len(data), 1), MOST))

    def _next(self) -> None:
        if self._waiting:
            data, sender = self._waiting.popleft()
            if self._waiting:
                self._loop.call_soon(self._next)
            self._tell(data, sender)

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
        self._came = Datagrams(port.clock.loop, lambda data, sender: port.hear(self, data, sender))

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport = cast(asyncio.DatagramTransport, transport)  # its class is no subclass of that

    def datagram_received(self, data: bytes, addr: Any) -> None:
        self._came.add(data, addr)

    def error_received(self, exc: Exception) -> None:
        """Nobody listens there (yet): as on a line on which nobody answers, the time-outs say so."""

    def connection_lost(self, exc: Exception | None) -> None:
        if exc is not None:
            self.port.lost(self, str(exc) or type(exc).__name__)
