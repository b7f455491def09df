"""The dedicated service: devices that answer on a line, or on every connection that a listener accepts.

Over UDP each sender has what a connection has over TCP.

Each device has one store, however many connections there are. Nothing here prints; what watches gives `monitor`.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from framekit.definition.times import NEVER, LineFormat
from framekit.link.events import LinkCounters, Monitor, Seen
from framekit.link.exchange import RequestHandler
from framekit.link.services.server import ServiceCounters
from framekit.run.model import DEFAULT_LIMITS, Channel, ConnectionLimits
from framekit.run.own_memory import AddressedMemory
from framekit.runfile.devices import Device
from framekit.service.device import DeviceService, DeviceStore, stores_of
from framekit.service.driver import LineLoad
from framekit.transport.clock import Clock
from framekit.transport.port import AcceptedPort, Port, PortEvents, PortListener, SharedPort
from framekit.transport.schemes import make_listener, open_port, scheme_of

ServingMonitor = Callable[[str, int, Seen], None]
"""Gets everything seen: the port's name, which of the devices saw it, and what it saw."""

MOST_CONNECTIONS = 256
"""At once; one more is closed as soon as it is made."""


class Serving:
    """Serves devices, all of which hear the same line. `wrap` may put something around every port, faults say.

    `line_errors` counts bad frames by their cause, bytes that were no frame, and connections refused or closed here.
    """

    def __init__(
        self,
        devices: Sequence[Device | DeviceStore],
        clock: Clock,
        line: LineFormat | None,
        monitor: ServingMonitor | None = None,
        *,
        wrap: Callable[[Port], Port] | None = None,
        limits: ConnectionLimits = DEFAULT_LIMITS,
    ) -> None:
        self.clock = clock
        self.line = line
        self.monitor = monitor
        self.wrap = wrap or (lambda port: port)
        self.stores = stores_of(devices, clock)
        self.stations: dict[Port, list[DeviceService]] = {}
        self.line_errors: Counter[str] = Counter()
        self.connections = 0
        self.limits = limits
        self.listener: PortListener | None = None
        self._own_port: Port | None = None
        self._hosts: dict[Port, str] = {}
        self._idle_alarm = clock.alarm(self._close_idle)

    # ---- ports --------------------------------------------------------------------------------------------

    def serve(self, port: Port) -> None:
        """Answers on a port, which is opened, and opened again when it is lost, until `stop`."""
        self._begin(port, lambda state: None)

    async def begin(self, url: str) -> tuple[str, str]:
        """Listens at `url`, or opens that port. Raises ValueError for what is no port, OSError.

        Gives where it is served: the port as others have to name it, and the same for people, with the line's settings.
        """
        url = self.stores[0].device.protocol.line.port_of(url)
        kind = scheme_of(url)
        if kind is not None and kind.listen is not None:
            listener = await self.listen(url)
            return listener.reached, listener.reached
        self._own_port = port = open_port(url, self.line, self.clock, serves=True)
        first_state: asyncio.Future[str] = asyncio.get_running_loop().create_future()

        def state(text: str) -> None:
            if not first_state.done():
                first_state.set_result(text)

        self._begin(port, state)
        reached = await first_state
        if reached != "open":
            raise OSError(reached if url in reached else f"{url}: {reached}")
        return port.name, port.describes()

    async def listen(self, url: str) -> PortListener:
        """Answers every connection to `url`, over UDP every sender by itself. Raises ValueError, OSError."""
        self.listener = listener = make_listener(url, self.clock, self.accept)
        await listener.start()
        return listener

    def accept(self, port: AcceptedPort) -> None:
        """Answers on a connection, or closes it where there are too many."""
        if not self._has_room(port):
            self.line_errors["connections refused"] += 1
            port.close()
            return
        self.connections += 1
        self._hosts[port] = port.host

        def state(text: str) -> None:
            if text != "open":
                self.clock.call_soon(lambda: self._end(port))

        self._begin(port, state)
        self._set_idle_alarm()

    def _has_room(self, port: AcceptedPort) -> bool:
        """Whether one more may be served. A sender of datagrams never ends by itself: it takes an older one's place."""
        in_the_way = [one for one, host in self._hosts.items() if host == port.host]
        if len(in_the_way) < self.limits.per_address:
            if len(self._hosts) < MOST_CONNECTIONS:
                return True
            in_the_way = list(self._hosts)
        if not port.ends_itself:
            self._end(min(in_the_way, key=self._last_frame))
        return not port.ends_itself

    def _last_frame(self, port: Port) -> int:
        """When the last good frame went over a connection; at first when it was made."""
        return max(service.engine.last_frame for service in self.stations[port])

    def _set_idle_alarm(self) -> None:
        oldest = min(map(self._last_frame, self._hosts), default=NEVER)
        self._idle_alarm.set(NEVER if oldest == NEVER else oldest + self.limits.idle)

    def _close_idle(self) -> None:
        """Time is up for the connections over which nothing good went for too long."""
        since = self.clock.now() - self.limits.idle
        for port in sorted((port for port in self._hosts if self._last_frame(port) <= since), key=self._last_frame):
            self.line_errors["idle connections closed"] += 1
            self._end(port)
        self._set_idle_alarm()

    def _begin(self, port: Port, on_state: Callable[[str], None]) -> None:
        wrapped = self.wrap(port)
        shared = None if len(self.stores) == 1 else SharedPort(wrapped, self.clock)
        services = []
        for number, store in enumerate(self.stores):
            services.append(
                DeviceService(
                    store.device,
                    wrapped if shared is None else shared.user(),
                    self.clock,
                    self.line,
                    self._shown_to(port, number),
                    on_fault=partial(self._count_fault, number),
                    store=store,
                    on_state=on_state if number == 0 else None,
                )
            )
        self.stations[port] = services
        for service in services:
            service.start()

    def _shown_to(self, port: Port, number: int) -> Callable[[Seen], None] | None:
        monitor, name = self.monitor, port.name
        if monitor is None:
            return None

        def shown(seen: Seen) -> None:
            seen.client = port.sender
            monitor(name, number, seen)

        return shown

    def _count_fault(self, number: int, seen: Seen) -> None:
        """All devices hear the same: one of them counts what was wrong with it. What a bad frame left goes with it."""
        if seen.kind == "trouble":
            self.line_errors["could not be worked out"] += 1
        elif number == 0 and seen.kind == "bad":
            self.line_errors[f"bad frame: {seen.reason}"] += 1
        elif number == 0 and seen.kind == "noise" and not seen.reason:
            self.line_errors["bytes of noise"] += len(seen.raw)

    def _end(self, port: Port) -> None:
        """A connection is over: it will not come again, another one may."""
        self._hosts.pop(port, None)
        for service in self.stations.pop(port, ()):
            service.stop()

    def stop(self) -> None:
        """Accepts no more, and closes all ports."""
        if self.listener is not None:
            self.listener.stop()
        self._idle_alarm.cancel()
        for port in list(self.stations):
            self._end(port)
        if self._own_port is not None:
            self._own_port.release()

    # ---- status -------------------------------------------------------------------------------------------

    def published(self, number: int) -> dict[str, Any]:
        """The published variables of a device, those of scope line or session as its latest connection has them."""
        services = next(reversed(self.stations.values()), None)
        return {} if services is None else services[number].engine.status()


def check_line(devices: list[Device]) -> None:
    """Whether devices can share a line. Raises ValueError with a sentence."""
    alone = [device for device in devices if not device.shares]
    for number, device in enumerate(alone):
        others = alone[:number]
        if any(device.own is not None and device.own == other.own for other in others):
            raise ValueError(f"two devices have the station {device.own} – give one of them another")
        if others and not set(device.protocol.sources) & set(others[0].protocol.sources):
            protocols = f"{others[0].protocol.name} and {device.protocol.name}"
            raise ValueError(f"{protocols} can't share a line – serve them on two ports")
    if len(alone) > 1 and any(device.own is None for device in alone):
        raise ValueError("several devices on one line need stations – add station to their files")


class ListeningPort(Port):
    """Listens where `channel` says. Raises ValueError for what is no address, and on a clock that is not real."""

    def __init__(self, channel: Channel, clock: Clock) -> None:
        self.listener = make_listener(channel.port, clock, self._accept)
        self.channel = channel
        self.clock = clock
        self.name = channel.port
        self.settings = None
        self.serving: Serving | None = None

    def answer(
        self, access: AddressedMemory, server: RequestHandler | None, monitor: Monitor | None, counters: LinkCounters,
        load: LineLoad, services: ServiceCounters,
    ) -> None:  # fmt: skip
        """From now on connections are answered from this memory by this server, and counted here."""
        channel = self.channel
        device = Device(
            name=f"channel {channel.number}", protocol=channel.protocol, role=channel.role, own=channel.own,
            params=channel.params, areas=(), grammar=access.grammar, profile=None, mapping=channel.mapping, initial=(),
        )  # fmt: skip
        store = DeviceStore(
            device, self.clock, access=access, server=server, link=counters, load=load, counters=services
        )
        watch = None if monitor is None else lambda port, number, seen: monitor(seen)
        self.serving = Serving([store], self.clock, channel.line, watch, limits=channel.limits)

    def _accept(self, port: AcceptedPort) -> None:
        assert self.serving is not None
        self.serving.accept(port)

    def open(self, events: PortEvents) -> None:
        now = self.clock.now()
        try:
            self.listener.listen()
        except OSError as error:
            reason = f"{self.channel.port}: {error.strerror or error}"
            self.clock.call_soon(lambda: events.closed(now, reason))
            return
        self.name = self.listener.name
        self.clock.call_soon(lambda: events.opened(now))

    def write(self, data: bytes) -> None:
        """The port itself has no sender."""

    def close(self) -> None:
        self.listener.stop()
        if self.serving is not None:
            self.serving.stop()

    def send_break(self, duration: int) -> None:
        """The port itself has no sender."""
