"""A channel's port that listens: while it is open, each connection made to it is answered by an engine of its own.

Nothing is sent or received on the port itself.
"""

from __future__ import annotations

from framekit.link.exchange import Server
from framekit.link.observe import LinkCounters, Monitor
from framekit.link.services.server import ServiceCounters
from framekit.run.model import Channel
from framekit.runfile.devices import Device
from framekit.service.device import DeviceStore
from framekit.service.line_load import LineLoad
from framekit.service.memory_access import AddressedMemory
from framekit.service.serving import Serving
from framekit.transport.clock import Clock
from framekit.transport.port import AcceptedPort, Port, PortEvents
from framekit.transport.schemes import make_listener


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
        self, access: AddressedMemory, server: Server | None, monitor: Monitor | None, counters: LinkCounters,
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
