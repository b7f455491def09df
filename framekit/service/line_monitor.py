"""Listens on a port that lies on a line between others; sends nothing and sets no control line.

The port is opened again when it is lost, as for those who take part. Nothing here prints.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from framekit.codec.codec import compile_protocol
from framekit.definition.model.protocol import Protocol
from framekit.link.events import CharacterFault, Command
from framekit.link.listener import Listener
from framekit.link.observe import Monitor, Seen
from framekit.service.driver import Driver
from framekit.service.line_load import LineLoad
from framekit.transport.clock import Clock
from framekit.transport.port import Port


class _Listening:
    """A listener as drivers know engines: it never has a command."""

    def __init__(self, listener: Listener, monitor: Monitor) -> None:
        self.listener = listener
        self.monitor = monitor

    @property
    def deadline(self) -> int:
        return self.listener.deadline

    def opened(self, now: int) -> list[Command]:
        self.monitor(Seen("", "open", now))
        return []

    def closed(self, now: int, reason: str = "") -> list[Command]:
        self.listener.ended(now)
        self.monitor(Seen("", "closed", now, reason=reason))
        return []

    def receive(self, data: bytes, now: int, faults: Iterable[CharacterFault] = ()) -> list[Command]:
        self.listener.receive(data, now, faults)
        return []

    def other_sender(self, now: int) -> list[Command]:
        self.listener.other_sender(now)
        return []

    def line_break(self, now: int) -> list[Command]:
        self.listener.line_break(now)
        return []

    def sent(self, now: int) -> list[Command]:
        return []

    def control(self, lines: Mapping[str, bool], now: int) -> list[Command]:
        return []

    def tick(self, now: int) -> list[Command]:
        self.listener.tick(now)
        return []


class LineMonitor:
    """Tells `monitor` everything that goes over the line. Raises ParameterError for parameters that do not fit."""

    def __init__(
        self,
        protocol: Protocol,
        port: Port,
        clock: Clock,
        monitor: Monitor,
        *,
        params: Mapping[str, Any] | None = None,
        on_state: Callable[[str], None] | None = None,
    ) -> None:
        self.protocol = protocol
        self.port = port
        self.clock = clock
        self.listener = Listener(
            protocol, compile_protocol(protocol), monitor, params=params, line=port.settings, now=clock.now()
        )
        self._driver = Driver(_Listening(self.listener, monitor), port, clock, on_state)

    @property
    def load(self) -> LineLoad:
        """How busy the line is."""
        return self._driver.load

    def start(self) -> None:
        """Opens the port."""
        self._driver.start()

    def stop(self) -> None:
        """Closes the port; what is unfinished is told."""
        self._driver.stop()
        self.listener.ended(self.clock.now())
