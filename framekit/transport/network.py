"""TCP and UDP: ports that connect to a host, and listeners that create a port for each connection or sender.

TCP is a stream. Over UDP a datagram is reported as bytes without a pause; no datagram is stored or repeated. UDP has no
end of connection: the port of a sender exists until it is closed. On a port that talks to one host the operating system
drops datagrams of other senders; a listening port reports a change of sender.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import ipaddress
import os
import socket
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Protocol, cast

from framekit.definition.problems import error_text, printable
from framekit.transport.clock import MOST, PIECE, AsyncioClock, Turns
from framekit.transport.port import Accepted, AcceptedPort, Port, PortEvents
from framekit.transport.unread import UnreadInput

CONNECT_WITHIN = 10.0
"""Time limit for a connection (s); some networks never refuse one."""
FAR_END_CLOSED = "the other side has closed the connection"

NEWCOMER = 128
"""Cost of setting up a connection, as the number of bytes that cost as much."""


class Connection(asyncio.BufferedProtocol):
    """One connection, valid while its port refers to it; later events of the connection are dropped.

    Received data is processed in turns of limited size, alternating with other connections; the rest waits in the
    network. If other connections have used up a turn, the piece that has been read waits for the next turn, and reading
    pauses.
    """

    def __init__(self, port: StreamPort) -> None:
        self.port = port
        self._taken = memoryview(bytearray(MOST))
        self._turns = port.clock.turns
        self.transport: asyncio.Transport | None = None
        self.is_full = False
        self.waits = False
        self._unread: UnreadInput | None = None

    @property
    def has_unread(self) -> bool:
        """Return whether bytes have arrived that the port has not reported."""
        return self.waits or (self.transport is not None and bool(self._unread))

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        transport = cast(asyncio.Transport, transport)  # loops of other libraries have classes of their own
        with contextlib.suppress(OSError):
            connected: socket.socket = transport.get_extra_info("socket")
            self._unread = UnreadInput(connected.fileno())
            connected.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            connected.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        encrypts = transport.get_extra_info("sslcontext") is not None
        transport.set_write_buffer_limits(int(encrypts), 0)  # TLS reports "full" at the limit, not above it
        self.transport = transport
        if self.port.connection is self:
            self.port.connected()
        else:
            transport.abort()

    def get_buffer(self, sizehint: int) -> memoryview:
        return self._taken[: self._turns.room]

    def buffer_updated(self, nbytes: int) -> None:
        data = self._taken[:nbytes].tobytes()
        if not self._turns.take(nbytes, partial(self._hear, data)):
            self.waits = True
            if self.transport is not None:
                self.transport.pause_reading()

    def _hear(self, data: bytes) -> None:
        port = self.port
        if port.connection is self:
            port.hear(data)
        if self.waits:
            self.waits = False
            if port.connection is self:
                port.pace()

    def pause_writing(self) -> None:
        self.is_full = True

    def resume_writing(self) -> None:
        self.is_full = False
        if self.port.connection is self:
            self.port.left()

    def connection_lost(self, error: Exception | None) -> None:
        self.transport = None
        if self.port.connection is self:
            self.port.lost(FAR_END_CLOSED if error is None else self.port.why_lost(error))


class StreamPort(Port):
    """Common part of connecting and accepted ports."""

    is_stream = True

    def __init__(self, name: str, clock: AsyncioClock) -> None:
        self.name = name
        self.settings = None
        self.clock = clock
        self.connection: Connection | None = None
        self.events: PortEvents | None = None
        self._sent_due = False

    @property
    def has_unread(self) -> bool:
        return self.connection is not None and self.connection.has_unread

    def connected(self) -> None:
        """Report that the connection is established."""
        if self.events is not None:
            self.events.opened(self.clock.now())

    def hear(self, data: bytes) -> None:
        """Report received bytes."""
        if self.events is not None:
            self.events.received(data, self.clock.now())

    def pace(self) -> None:
        """Resume reading unless a piece waits for its turn."""
        transport = self._transport
        if transport is not None and not self._holds_back:
            transport.resume_reading()

    @property
    def _holds_back(self) -> bool:
        """Return whether reading must pause."""
        return self.connection is not None and self.connection.waits

    def lost(self, reason: str) -> None:
        """Report that the connection has ended, or could not be established."""
        events = self.events
        self._forget()
        if events is not None:
            events.closed(self.clock.now(), reason)

    def why_lost(self, error: Exception) -> str:
        """Return the reason for the end of a connection, as a text for users."""
        return _why(error)

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
        if connection is None or connection.transport is None or self._sent_due or self.events is None:
            self.write(data)
            return False
        connection.transport.write(data)
        self._sent_due = connection.is_full  # `left` is called when the operating system has taken the rest
        return not self._sent_due

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
        """Report `sent` if the operating system has taken all data."""
        connection = self.connection
        if self._sent_due and connection is not None and not connection.is_full and self.events is not None:
            self._sent_due = False
            self.events.sent(self.clock.now())

    def close(self) -> None:
        """Close the port; data already handed over is still sent."""
        transport = self.connection.transport if self.connection is not None else None
        self._forget()
        if transport is not None:
            transport.close()


class TcpPort(StreamPort):
    """A connection to `host:port`, made again at each opening of the port."""

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
                await self.connect(connection)
        except TimeoutError:
            reason = f"no connection to {self.host}:{self.number} within {self.connect_within:g} s"
        except (OSError, UnicodeError) as error:
            reason = f"no connection to {self.host}:{self.number}: {_why(error)}"
        else:
            return
        if self.connection is connection:
            self.lost(reason)

    async def connect(self, connection: Connection) -> None:
        """Make the connection. Raises OSError."""
        await self.clock.loop.create_connection(lambda: connection, self.host, self.number)

    def close(self) -> None:
        connecting, self._connecting = self._connecting, None
        if connecting is not None:
            connecting.cancel()
        super().close()


_WHAT_TO_DO = {
    errno.ECONNRESET: "the device may serve only a few connections; see whether another client is connected to it",
    errno.ECONNREFUSED: "nothing listens at that port number; see whether the number is right and the device is on",
    errno.EHOSTUNREACH: "see whether the address is right and the device is on",
    errno.ENETUNREACH: "see whether this machine is in the device's network",
    socket.EAI_NONAME: "see how the name is written, or write the address in numbers",
}


def _why(error: Exception) -> str:
    """Return the system's text of an error, without the leading address, and advice on what to check."""
    text = _said(error)
    todo = _WHAT_TO_DO.get(getattr(error, "errno", None) or 0)
    return f"{text} – {todo}" if todo else text


def _said(error: Exception) -> str:
    number = getattr(error, "errno", None) or 0
    return os.strerror(number) if number > 0 else error_text(error)


def host_and_port(url: str) -> tuple[str, int]:
    """Parse the `HOST:PORT` part of a URL, with brackets around an IPv6 address. Raises ValueError."""
    text = url.partition("://")[2]
    host, colon, number = text.rstrip("/").rpartition(":")
    if not colon or not number.isdecimal():
        example = f"{host or text or 'HOST'}:4001"
        raise ValueError(f"'{text}' is not HOST:PORT – write the number of the port, as in {example}")
    if len(number) > len("65535") or int(number) > 65535:
        raise ValueError(f"'{text}': the number of a port is 65535 at most – write another one")
    return host.strip("[]") or "127.0.0.1", int(number)


def bracketed(host: str) -> str:
    """Return a host in the form used before a port number: an IPv6 address in brackets."""
    return f"[{host}]" if ":" in host else host


def listening_at(text: str, local: str = "127.0.0.1") -> tuple[str, int]:
    """Parse `PORT` or `ADDRESS:PORT`, with brackets around an IPv6 address; return address and number.

    Raises ValueError.
    """
    host, _, port = text.rpartition(":")
    host = host.removeprefix("[").removesuffix("]") or local
    try:
        ipaddress.ip_address(host)
        fits = port.isdecimal() and int(port) < 65536
    except ValueError:
        fits = False
    if not fits:
        raise ValueError(f"'{text}' is no place to listen on")
    return host, int(port)


class TcpAcceptedPort(StreamPort, AcceptedPort):
    """An accepted connection. Bytes received before its opening wait.

    So do bytes received while data is still to be sent: a client that reads no replies cannot accumulate requests.
    """

    def __init__(self, name: str, clock: AsyncioClock) -> None:
        super().__init__(name, clock)
        self._is_open = False
        self._early = b""
        """Bytes received before the opening: uvloop reads once although `connection_made` pauses reading."""

    def connected(self) -> None:
        self._pause()

    def _pause(self) -> None:
        """Pause reading, until `pace` resumes it."""
        transport = self.connection.transport if self.connection is not None else None
        if transport is not None:
            transport.pause_reading()

    def open(self, events: PortEvents) -> None:
        self.events = events
        connection = self.connection
        self.clock.call_soon(lambda: self._begin(events, connection))

    def hear(self, data: bytes) -> None:
        if not self._is_open:
            self._early += data
            self._pause()
            return
        super().hear(data)
        if self._sent_due:
            self._pause()
        else:
            self.pace()

    def left(self) -> None:
        super().left()
        self.pace()

    @property
    def has_unread(self) -> bool:
        return not self._sent_due and super().has_unread

    @property
    def _holds_back(self) -> bool:
        return not self._is_open or self._sent_due or super()._holds_back

    def _forget(self) -> None:
        super()._forget()
        self._is_open = False
        self._early = b""

    def _begin(self, events: PortEvents, connection: Connection | None) -> None:
        if self.events is not events or self.connection is not connection:
            return
        if connection is None or connection.transport is None:
            self.lost("the connection is over")
            return
        self._is_open = True
        events.opened(self.clock.now())
        if self.connection is connection:
            early, self._early = self._early, b""
            if early:
                self.hear(early)
            else:
                self.pace()


class Closable(Protocol):
    """An object that works until it is closed."""

    def close(self) -> None: ...


class NetworkListener(ABC):
    """Base class of listeners: listen at `host` and pass a port, not yet opened, to `accepted` for each connection.

    `number` 0 requests any free port number. `admits` returns whether a client with that address may connect, for
    schemes in which accepting is expensive; `refused` is called with the address of a connection dropped because of too
    many others.
    """

    scheme: str
    reached_by: str
    """The scheme under which others connect."""
    kind: socket.SocketKind

    def __init__(self, host: str, number: int, clock: AsyncioClock, accepted: Accepted) -> None:
        self.host = host
        self.clock = clock
        self.accepted = accepted
        self._socket: socket.socket | None = None
        self._opening: asyncio.Task[None] | None = None
        self._at_work: Closable | None = None
        self.admits: Callable[[str], bool] = lambda host: True
        self.refused: Callable[[str], None] = lambda host: None
        self._is_at(number)

    def _is_at(self, number: int) -> None:
        self.number = number
        place = f"{bracketed(self.host)}:{number}"
        self.name, self.reached = f"{self.scheme}://{place}", f"{self.reached_by}://{place}"

    def listen(self) -> None:
        found = socket.getaddrinfo(self.host or None, self.number, type=self.kind, flags=socket.AI_PASSIVE)
        family, *_, address = min(found, key=lambda one: one[0] != socket.AF_INET)
        self._socket = listening = self._bound(family, (str(address[0]), int(address[1])))
        self._is_at(int(listening.getsockname()[1]))
        self._opening = self.clock.loop.create_task(self._open(listening))

    async def start(self) -> None:
        self.listen()
        if self._opening is not None:
            await self._opening

    @abstractmethod
    def _bound(self, family: socket.AddressFamily, address: tuple[str, int]) -> socket.socket:
        """Return the socket at that address. Raises OSError."""

    @abstractmethod
    async def _open(self, listening: socket.socket) -> None:
        """Begin to accept connections."""

    def stop(self) -> None:
        opening, self._opening = self._opening, None
        at_work, self._at_work = self._at_work, None
        if opening is not None:
            opening.cancel()
        if at_work is not None:
            at_work.close()
        elif self._socket is not None:
            self._socket.close()


class TcpListener(NetworkListener):
    """Accepts connections."""

    scheme, reached_by, kind = "tcp-listen", "tcp", socket.SOCK_STREAM

    def _bound(self, family: socket.AddressFamily, address: tuple[str, int]) -> socket.socket:
        return socket.create_server(address, family=family)

    async def _open(self, listening: socket.socket) -> None:
        self._at_work = await self.clock.loop.create_server(self._protocol, sock=listening)

    def _protocol(self) -> asyncio.BufferedProtocol:
        return AcceptedConnection(TcpAcceptedPort(self.host, self.clock), self.accepted)


def name_in(certificate: Mapping[str, Any]) -> str:
    """Return the common name in a verified certificate, on one line; empty if it has none."""
    parts = (part for group in certificate.get("subject", ()) for part in group)
    return printable(next((value for name, value in parts if name == "commonName"), ""))


class AcceptedConnection(Connection):
    """Connection of an accepted port from the start, which offers the port when established.

    `scheme`: the kind of the port.
    """

    def __init__(self, port: TcpAcceptedPort, accepted: Accepted, scheme: str = "tcp") -> None:
        super().__init__(port)
        self.scheme = scheme
        self.accepted_port = port
        self.accepted = accepted
        port.connection = self

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        host, number, *_ = transport.get_extra_info("peername") or (self.port.name, 0)
        self.port.sender = f"{bracketed(host)}:{number}"
        self.port.name = f"{self.scheme}://{self.port.sender}"
        self.accepted_port.host = str(host)
        self.accepted_port.identity = name_in(transport.get_extra_info("peercert") or {})
        super().connection_made(transport)
        self.port.clock.turns.take(NEWCOMER, self._offer)

    def _offer(self) -> None:
        if self.transport is not None:
            self.accepted(self.accepted_port)


LARGEST = 65_507
"""Largest size of a datagram (bytes, IPv4)."""

MOST_WAITING = 256
"""Largest number of pieces that wait for their turn; further datagrams are dropped, as UDP permits."""


class Datagrams:
    """Received datagrams, reported with their sender in turns of the loop; a large datagram in pieces without a
    pause.
    """

    def __init__(self, turns: Turns, tell: Callable[[bytes, Any], None]) -> None:
        self._turns = turns
        self._tell = tell
        self._waiting: deque[tuple[bytes, Any]] = deque()
        self._comes = self._asks = False

    def add(self, data: bytes, sender: Any) -> None:
        """Add a received datagram."""
        if len(self._waiting) < MOST_WAITING:
            size = MOST - PIECE
            self._waiting.extend((data[at : at + size], sender) for at in range(0, max(len(data), 1), size))
            self._ask()

    def __bool__(self) -> bool:
        """Return whether datagrams wait."""
        return bool(self._waiting)

    def _ask(self) -> None:
        """Request a turn for the first waiting piece, and further turns while turns are granted at once."""
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
        """Discard all waiting datagrams."""
        self._waiting.clear()


class DatagramPort(Port):
    """Common part of ports over datagrams: sent data has left in the next turn of the loop."""

    settings = None

    def __init__(self, clock: AsyncioClock) -> None:
        self.clock = clock
        self._events: PortEvents | None = None
        self._sent_due = False

    @property
    @abstractmethod
    def _is_ready(self) -> bool:
        """Return whether data can be sent."""

    def send_break(self, duration: int) -> None:
        if self._is_ready:
            self._tell_when_sent()

    def _tell_when_sent(self) -> None:
        if not self._sent_due:
            self._sent_due = True
            self.clock.call_soon(self._left)

    def _left(self) -> None:
        if self._sent_due and self._events is not None:
            self._sent_due = False
            self._events.sent(self.clock.now())


class UdpPort(DatagramPort):
    """Port that exchanges datagrams with `host:number`; with `listens`, bind to that address and reply to the latest
    sender.
    """

    def __init__(self, host: str, number: int, clock: AsyncioClock, *, listens: bool = False) -> None:
        super().__init__(clock)
        self.host, self.number = host, number
        self.listens = listens
        self.name = f"udp{'-listen' if listens else ''}://{bracketed(host)}:{number}"
        self.peer: Any = None
        self._endpoint: _Endpoint | None = None
        self._opening: asyncio.Task[None] | None = None

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
            what = f"cannot {'listen at' if self.listens else 'reach'} {self.host}:{self.number}"
            self.lost(endpoint, f"{what}: {_why(error)}")
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
        """Report that the socket was lost, or could not be opened."""
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

    @property
    def has_unread(self) -> bool:
        return self._endpoint is not None and self._endpoint.has_unread

    @property
    def _is_ready(self) -> bool:
        return self._endpoint is not None and self._endpoint.transport is not None

    def hear(self, endpoint: _Endpoint, data: bytes, peer: Any) -> None:
        """Report a received datagram."""
        if self._endpoint is endpoint and self._events is not None:
            if peer != self.peer:
                is_other, self.peer = self.peer is not None, peer
                if is_other:
                    self._events.other_sender(self.clock.now())
                if self.listens:
                    self.sender = f"{bracketed(str(peer[0]))}:{peer[1]}"
            if data and self._events is not None:
                self._events.received(data, self.clock.now())


class _Endpoint(asyncio.DatagramProtocol):
    """A socket, valid while its port refers to it."""

    def __init__(self, port: UdpPort) -> None:
        self.port = port
        self.transport: asyncio.DatagramTransport | None = None
        self._came = Datagrams(port.clock.turns, lambda data, sender: port.hear(self, data, sender))
        self._unread: UnreadInput | None = None

    @property
    def has_unread(self) -> bool:
        """Return whether datagrams have arrived that the port has not reported."""
        return bool(self._came) or (self.transport is not None and bool(self._unread))

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        endpoint = transport.get_extra_info("socket")
        if endpoint is not None:
            self._unread = UnreadInput(endpoint.fileno())
        self.transport = cast(asyncio.DatagramTransport, transport)  # no subclass of DatagramTransport

    def datagram_received(self, data: bytes, addr: Any) -> None:
        self._came.add(data, addr)

    def error_received(self, exc: Exception) -> None:
        """Ignore the error that no program listens at the host (yet): as on a silent line, time-outs report it."""

    def connection_lost(self, exc: Exception | None) -> None:
        self.transport = None
        if exc is not None:
            self.port.lost(self, error_text(exc))


MOST_KEPT = 16
"""Largest number of datagrams of a sender that wait for the opening of its port; more are dropped, as UDP permits."""


class SenderPort(DatagramPort, AcceptedPort):
    """Datagrams from and to one sender."""

    ends_itself = False

    def __init__(self, listener: UdpListener, address: Any) -> None:
        super().__init__(listener.clock)
        self.listener = listener
        self.address = address
        self.host = str(address[0])
        self.sender = f"{bracketed(self.host)}:{address[1]}"
        self.name = f"udp://{self.sender}"
        self._waiting: list[bytes] = []
        self._is_open = False

    def open(self, events: PortEvents) -> None:
        self._events = events
        self.clock.call_soon(lambda: self._begin(events))

    def _begin(self, events: PortEvents) -> None:
        if self._events is not events:
            return
        self._is_open = True
        events.opened(self.clock.now())
        waiting, self._waiting = self._waiting, []
        for data in waiting:
            self.hear(data)

    def hear(self, data: bytes) -> None:
        """Report a datagram of this sender, or keep it until the port is open."""
        if self._is_open and self._events is not None:
            self._events.received(data, self.clock.now())
        elif len(self._waiting) < MOST_KEPT:
            self._waiting.append(data)

    def write(self, data: bytes) -> None:
        if self._is_open:
            self.listener.send(data, self.address)
            self._tell_when_sent()

    @property
    def _is_ready(self) -> bool:
        return self._is_open

    def close(self) -> None:
        self._events = None
        self._is_open = self._sent_due = False
        self._waiting.clear()
        self.listener.forget(self)


class UdpListener(asyncio.DatagramProtocol, NetworkListener):
    """Listens to datagrams, with a port for each sender.

    A closed port is forgotten: the next datagram of its sender creates a new port.
    """

    scheme = reached_by = "udp-listen"
    kind = socket.SOCK_DGRAM

    def __init__(self, host: str, number: int, clock: AsyncioClock, accepted: Accepted) -> None:
        super().__init__(host, number, clock, accepted)
        self.senders: dict[Any, SenderPort] = {}
        self._came = Datagrams(clock.turns, self._hear)
        self._transport: asyncio.DatagramTransport | None = None

    def _bound(self, family: socket.AddressFamily, address: tuple[str, int]) -> socket.socket:
        listening = socket.socket(family, self.kind)
        try:
            listening.setblocking(False)
            listening.bind(address)
        except OSError:
            listening.close()
            raise
        return listening

    async def _open(self, listening: socket.socket) -> None:
        await self.clock.loop.create_datagram_endpoint(lambda: self, sock=listening)

    def stop(self) -> None:
        """Stop receiving and sending, also on the ports of senders."""
        self._came.clear()
        self._transport = None
        super().stop()

    def send(self, data: bytes, address: Any) -> None:
        """Send bytes to a sender, in several datagrams only if they do not fit into one."""
        if self._transport is not None and not self._transport.is_closing():
            for start in range(0, len(data), LARGEST):
                self._transport.sendto(data[start : start + LARGEST], address)

    def forget(self, port: SenderPort) -> None:
        """Forget a closed port."""
        if self.senders.get(port.address) is port:
            del self.senders[port.address]

    # ---- events of the socket -----------------------------------------------------------------------------

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._at_work = self._transport = cast(asyncio.DatagramTransport, transport)  # no subclass of DatagramTransport

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
        """Ignore the error that a sender does not listen any more: it will not send further requests."""
