"""A simulated line: any number of ports on one pair of wires, exact to the bit time, on any clock.

A burst of bytes handed over at once is delivered to the others as one event, at the moment its last stop bit ends –
what a receiver sees is the same as with an event a character, since no character of a burst comes later than it would.
On a stream (no baud rate) bytes arrive after `latency`. What the bytes mean is not known here.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass, field

from framekit.definition.times import LineFormat
from framekit.link.events import CharacterFault, LineFault
from framekit.transport.clock import Clock
from framekit.transport.port import Port, PortEvents


@dataclass(slots=True)
class Burst:
    """Bytes on their way from one port: when the first bit went out, when the last one will have, what got damaged."""

    sender: SimulatedPort
    data: bytearray
    start: int
    end: int
    faults: dict[int, LineFault] = field(default_factory=dict)
    dropped: bool = False


Disturb = Callable[[Burst], None]
"""Changes a burst on its way: its bytes, its faults, its end, or whether it arrives."""


class SimulatedLine:
    """A line that its ports share. `full_duplex` keeps two talkers from damaging each other's characters.

    `disturb` may change every burst; `echo` lets a port hear what it sends, as many RS-485 adapters do.
    """

    def __init__(
        self,
        clock: Clock,
        line: LineFormat | None,
        *,
        full_duplex: bool = True,
        latency: int = 0,
        disturb: Disturb | None = None,
        echo: bool = False,
    ) -> None:
        self.clock = clock
        self.line = line
        self.full_duplex = full_duplex
        self.latency = latency
        self.disturb = disturb
        self.echo = echo
        self.ports: list[SimulatedPort] = []
        self.under_way: list[Burst] = []
        self.bytes_carried = 0

    @property
    def character_time(self) -> int:
        return 0 if self.line is None else self.line.character_time

    def port(self, name: str) -> SimulatedPort:
        """A new port on this line."""
        port = SimulatedPort(self, name)
        self.ports.append(port)
        return port

    def transmit(self, sender: SimulatedPort, data: bytes, start: int) -> Burst:
        """Puts a burst on the line; it is delivered when its last character is complete."""
        burst = Burst(sender, bytearray(data), start, start + len(data) * self.character_time)
        if not self.full_duplex:
            self._collide(burst)
        self.under_way.append(burst)
        self.clock.call_at(burst.end + self.latency, lambda: self._deliver(burst))
        return burst

    def _collide(self, burst: Burst) -> None:
        """Characters that two ports send at the same time are damaged in both bursts."""
        for other in self.under_way:
            if other.sender is not burst.sender and other.end > burst.start:
                self._damage(other, burst.start, burst.end)
                self._damage(burst, other.start, other.end)

    def _damage(self, burst: Burst, start: int, end: int) -> None:
        step = self.character_time or 1
        for index in range(len(burst.data)):
            begins = burst.start + index * step
            if begins < end and begins + step > start:
                burst.data[index] ^= 0x55
                burst.faults[index] = LineFault.FRAMING

    def _deliver(self, burst: Burst) -> None:
        self.under_way.remove(burst)
        self.bytes_carried += len(burst.data)
        if self.disturb is not None:
            self.disturb(burst)
        if burst.dropped or not burst.data:
            return
        data, now = bytes(burst.data), self.clock.now()
        faults = tuple(CharacterFault(index, fault) for index, fault in sorted(burst.faults.items()))
        for port in self.ports:
            if port is not burst.sender or self.echo:
                port.hear(data, now, faults)

    def break_from(self, sender: SimulatedPort, duration: int) -> None:
        """The line is held in break state: the others notice after one character time."""
        if duration <= self.character_time:
            return

        def notice() -> None:
            for port in self.ports:
                if port is not sender and port.events is not None:
                    port.events.line_break(self.clock.now())

        self.clock.call_at(self.clock.now() + max(self.character_time, 1), notice)


class SimulatedPort(Port):
    """One port of a simulated line."""

    def __init__(self, line: SimulatedLine, name: str) -> None:
        self.shared = line
        self.line = line.line
        self.name = name
        self.events: PortEvents | None = None
        self._free = 0

    def open(self, events: PortEvents) -> None:
        self.events = events
        self.shared.clock.call_soon(self._opened)

    def _opened(self) -> None:
        if self.events is not None:
            self.events.opened(self.shared.clock.now())

    def write(self, data: bytes) -> None:
        if self.events is None or not data:
            return
        start = max(self.shared.clock.now(), self._free)
        burst = self.shared.transmit(self, data, start)
        self._free = burst.end
        self.shared.clock.call_at(burst.end, self._sent)

    def _sent(self) -> None:
        if self.events is not None:
            self.events.sent(self.shared.clock.now())

    def hear(self, data: bytes, now: int, faults: tuple[CharacterFault, ...]) -> None:
        """Bytes come in from the line."""
        if self.events is not None:
            self.events.received(data, now, faults)

    def send_break(self, duration: int) -> None:
        start = max(self.shared.clock.now(), self._free)
        self._free = start + duration
        self.shared.clock.call_at(start, lambda: self.shared.break_from(self, duration))
        self.shared.clock.call_at(self._free, self._sent)

    def close(self) -> None:
        self.events = None

    def pull(self, reason: str = "pulled out") -> None:
        """The port goes away, as an adapter does that is unplugged."""
        events, self.events = self.events, None
        if events is not None:
            events.closed(self.shared.clock.now(), reason)


class ByteErrors:
    """Flips one bit in a byte now and then; with parity on the line the character is flagged. Seeded, so repeatable."""

    def __init__(self, rate: float, seed: int, line: LineFormat | None = None) -> None:
        self.rate = rate
        self.random = random.Random(seed)
        self.parity = line is not None and line.parity in "EO"
        self.damaged = 0

    def __call__(self, burst: Burst) -> None:
        for index in range(len(burst.data)):
            if self.random.random() < self.rate:
                burst.data[index] ^= 1 << self.random.randrange(8)
                self.damaged += 1
                if self.parity:
                    burst.faults[index] = LineFault.PARITY
