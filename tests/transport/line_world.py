"""Listeners and simulated lines on a virtual clock, for the tests of the transport."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from framekit.definition.times import LineFormat, parse_format
from framekit.link.events import CharacterFault, LineFault
from framekit.transport.clock import VirtualClock
from framekit.transport.simulated_line import SimulatedLine, SimulatedPort, Transmission

SECOND = 1_000_000_000


@dataclass
class Listener:
    """Recorder of all events of a port."""

    port: SimulatedPort
    data: list[tuple[int, bytes]] = field(default_factory=list)
    faults: list[tuple[int, LineFault]] = field(default_factory=list)
    events: list[tuple[str, int]] = field(default_factory=list)
    lines: list[Mapping[str, bool]] = field(default_factory=list)

    def opened(self, now: int) -> None:
        self.events.append(("opened", now))

    def received(self, data: bytes, now: int, faults: tuple[CharacterFault, ...] = ()) -> None:
        assert data and all(0 <= fault.index < len(data) for fault in faults)
        self.faults += [(len(self.bytes) + fault.index, fault.fault) for fault in faults]
        self.data.append((now, data))

    def line_break(self, now: int) -> None:
        self.events.append(("break", now))

    def sent(self, now: int) -> None:
        self.events.append(("sent", now))

    def closed(self, now: int, reason: str) -> None:
        self.events.append((f"closed: {reason}", now))

    def control(self, lines: Mapping[str, bool], now: int) -> None:
        self.lines.append(lines)

    @property
    def bytes(self) -> bytes:
        return b"".join(data for _, data in self.data)

    @property
    def sent_at(self) -> list[int]:
        return [now for event, now in self.events if event == "sent"]

    def characters(self) -> list[tuple[int, int]]:
        """Return every character and its completion time; `received` guarantees no pause within an event."""
        step = self.port.line.character_time
        return [
            (now - (len(data) - 1 - index) * step, value) for now, data in self.data for index, value in enumerate(data)
        ]


class SlowLine(SimulatedLine):
    """A line that reports transmissions every `granularity` characters, not only at other events."""

    def __init__(self, *arguments: Any, granularity: int, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.granularity = granularity

    def _stops(self, transmission: Transmission) -> list[int]:
        return sorted(
            {*super()._stops(transmission), *range(self.granularity, len(transmission.data), self.granularity)}
        )


class World:
    """A line with open ports, on a virtual clock that begins at 0."""

    def __init__(self, ports: int = 2, text: str | None = "8N1", speed: int = 9600, **options: Any) -> None:
        self.clock = VirtualClock()
        self.settings: LineFormat | None = None if text is None else parse_format(text, speed)
        line = SlowLine if "granularity" in options else SimulatedLine
        self.line = line(self.clock, self.settings, **options)
        self.ports = [self.line.port(f"port {number}") for number in range(ports)]
        self.listeners = [Listener(port) for port in self.ports]
        for port, listener in zip(self.ports, self.listeners, strict=True):
            port.open(listener)
        self.clock.run_for(0)

    @property
    def character(self) -> int:
        return self.line.character_time
