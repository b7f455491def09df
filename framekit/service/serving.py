"""The dedicated service: devices that answer on a line, or on every connection that a listener accepts.

Each device has one store, however many connections there are. Nothing here prints; whoever watches gives `monitor`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

from framekit.blocks.device import Device
from framekit.definition.times import LineFormat
from framekit.link.observe import Seen
from framekit.service.device import DeviceService, DeviceStore
from framekit.transport.clock import AsyncioClock, Clock
from framekit.transport.port import Port
from framekit.transport.shared_port import SharedPort
from framekit.transport.tcp_listener import AcceptedPort, TcpListener

ServingMonitor = Callable[[str, int, Seen], None]
"""Gets everything seen: the port's name, which of the devices saw it, and what it saw."""

MOST_CONNECTIONS = 256
"""At once; one more is closed as soon as it is made."""


class Serving:
    """Serves devices, all of which hear the same line. `wrap` may put something around every port, faults say.

    `line_errors` counts bad frames by their cause, and bytes that were no frame.

    `on_state(port, state)` is told when a port opens ('open') or why it was closed.
    """

    def __init__(
        self,
        devices: Sequence[Device],
        clock: Clock,
        line: LineFormat | None,
        monitor: ServingMonitor | None = None,
        *,
        on_state: Callable[[str, str], None] | None = None,
        wrap: Callable[[Port], Port] | None = None,
    ) -> None:
        self.clock = clock
        self.line = line
        self.monitor = monitor
        self.on_state = on_state or (lambda port, state: None)
        self.wrap = wrap or (lambda port: port)
        self.stores = [DeviceStore(device, clock) for device in devices]
        self.stations: dict[Port, list[DeviceService]] = {}
        self.line_errors: Counter[str] = Counter()
        self.connections = 0
        self.listener: TcpListener | None = None

    # ---- ports --------------------------------------------------------------------------------------------

    def serve(self, port: Port) -> None:
        """Answers on a port, which is opened, and opened again when it is lost, until `stop`."""
        self._begin(port, lambda state: self.on_state(port.name, state))

    async def listen(self, host: str, number: int) -> int:
        """Answers on every connection made to `host:number`; the number, where 0 asks for any. Raises OSError."""
        if not isinstance(self.clock, AsyncioClock):
            raise ValueError("a listener needs real time")
        self.listener = TcpListener(host, number, self.clock, self._accepted)
        return await self.listener.start()

    def _accepted(self, port: AcceptedPort) -> None:
        if len(self.stations) >= MOST_CONNECTIONS:
            port.close()
            return
        self.connections += 1

        def state(text: str) -> None:
            if text != "open":
                self.clock.call_soon(lambda: self._end(port))
            self.on_state(port.name, text)

        self._begin(port, state)

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
                    self._watcher(port, number),
                    store=store,
                    on_state=on_state if number == 0 else None,
                )
            )
        self.stations[port] = services
        for service in services:
            service.start()

    def _watcher(self, port: Port, number: int) -> Callable[[Seen], None]:
        store, counts_frames = self.stores[number], not self.stores[number].device.protocol.services

        def watch(seen: Seen) -> None:
            if number == 0 and seen.kind in ("bad", "noise"):
                self._count_line_error(seen)
            elif counts_frames and seen.kind == "frame" and seen.direction == "out":
                store.counters.done += 1
            if self.monitor is not None:
                self.monitor(port.name, number, seen)

        return watch

    def _count_line_error(self, seen: Seen) -> None:
        """All devices hear the same: one of them counts what was wrong with it. What a bad frame left goes with it."""
        if seen.kind == "bad":
            self.line_errors[f"bad frame: {seen.reason}"] += 1
        elif not seen.reason:
            self.line_errors["bytes of noise"] += len(seen.raw)

    def _end(self, port: Port) -> None:
        """A connection is over: it will not come again, another one may."""
        for service in self.stations.pop(port, ()):
            service.stop()

    def stop(self) -> None:
        """Accepts no more, and closes all ports."""
        if self.listener is not None:
            self.listener.stop()
        for port in list(self.stations):
            self._end(port)

    # ---- status -------------------------------------------------------------------------------------------

    def published(self, number: int) -> dict[str, Any]:
        """The published variables of a device, those of scope line or session as its latest connection has them."""
        services = next(reversed(self.stations.values()), None)
        return {} if services is None else services[number].engine.status()
