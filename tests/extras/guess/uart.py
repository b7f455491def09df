"""A model of UARTs: the characters that a receiver gets from a sender of another speed or format."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass, field

from framekit.definition.times import LineFormat
from framekit.link.events import CharacterFault, LineFault
from framekit.transport.clock import Clock
from framekit.transport.port import Port, PortEvents

SECOND = 1_000_000_000


def parity_bit(value: int, parity: str) -> int:
    """Return the parity bit of a character."""
    ones = value.bit_count() & 1
    return {"E": ones, "O": 1 - ones, "M": 1, "S": 0}[parity]


@dataclass
class Wire:
    """The level of a line over time: 1 before the first edge, inverted by each edge. Times in ns."""

    edges: list[float] = field(default_factory=list)
    end: float = 0.0

    def level(self, at: float) -> int:
        return 1 - (bisect_right(self.edges, at) & 1)

    def send(self, data: bytes, line: LineFormat, pause: float = 0.0, between: float = 0.0) -> None:
        """Transmit characters after a `pause` (ns), with a rest of `between` (ns) after each."""
        bit = SECOND / line.speed
        self.end += pause
        for value in data:
            value &= (1 << line.data_bits) - 1
            bits = [0, *(value >> place & 1 for place in range(line.data_bits))]
            if line.parity != "N":
                bits.append(parity_bit(value, line.parity))
            for level in bits:
                self._set(level)
                self.end += bit
            self._set(1)
            self.end += bit * line.stop_bits + between

    def send_break(self, duration: float) -> None:
        self._set(0)
        self.end += duration
        self._set(1)

    def _set(self, level: int) -> None:
        if self.level(self.end) != level:
            self.edges.append(self.end)


@dataclass(frozen=True)
class Received:
    """A received character: time of its end (ns), value, fault; or a break if `is_break`."""

    at: float
    value: int
    fault: LineFault | None = None
    is_break: bool = False


def receive(wire: Wire, line: LineFormat, begin: float = 0.0, end: float | None = None) -> Iterator[Received]:
    """Yield the characters that a receiver gets from `begin` on.

    It samples the middle of each bit after a falling edge. After a framing error, the low level counts as the next
    start bit; after a break, the receiver waits for a high level.
    """
    bit, at = SECOND / line.speed, begin
    end = wire.end if end is None else end
    is_low = False
    while at < end:
        if not is_low:
            place = bisect_right(wire.edges, at)
            place += place & 1  # the next falling edge has an even index
            if wire.level(at) == 0 and at == begin:
                start = at
            elif place >= len(wire.edges):
                return
            else:
                start = wire.edges[place]
        else:
            start = at - bit / 2
        if start >= end:
            return
        is_low = False
        middle = start + bit / 2
        if wire.level(middle):  # too short for a start bit
            at = middle
            continue
        value = sum(wire.level(middle + (place + 1) * bit) << place for place in range(line.data_bits))
        behind = middle + (line.data_bits + 1) * bit
        parity = None
        if line.parity != "N":
            parity, behind = wire.level(behind), behind + bit
        if not wire.level(behind):
            if value == 0 and not parity:
                yield Received(behind, 0, is_break=True)
                place = bisect_right(wire.edges, behind)
                if place >= len(wire.edges):
                    return
                at = wire.edges[place + (1 - (place & 1))] if place & 1 == 0 else wire.edges[place]
                continue
            yield Received(behind, value, LineFault.FRAMING)
            at, is_low = behind, True
            continue
        wrong = parity is not None and parity != parity_bit(value, line.parity)
        yield Received(behind, value, LineFault.PARITY if wrong else None)
        at = behind


class UartPort(Port):
    """A port on a recorded wire; each change of speed or format starts the wire from the beginning.

    `refused` are speeds that the device does not support; `log` records all calls.
    """

    sees_damage = True

    def __init__(self, wire: Wire, clock: Clock, refused: tuple[int, ...] = ()) -> None:
        self.name, self.settings = "uart", LineFormat(9600)
        self.wire, self.clock, self.refused = wire, clock, refused
        self.log: list[str] = []
        self._events: PortEvents | None = None
        self._use = 0

    def open(self, events: PortEvents) -> None:
        self.log.append("open")
        self._events = events
        self.clock.call_soon(lambda: events.opened(self.clock.now()))

    def write(self, data: bytes) -> None:
        self.log.append("write")

    def send_break(self, duration: int) -> None:
        self.log.append("break")

    def close(self) -> None:
        self.log.append("close")
        self._events = None
        self._use += 1

    def change_line(self, line: LineFormat) -> None:
        self._use += 1
        if line.speed in self.refused:
            events, self._events = self._events, None
            if events is not None:
                self.clock.call_soon(lambda: events.closed(self.clock.now(), f"the device cannot be set to {line}"))
            return
        self._hear(receive(self.wire, line), self.clock.now(), self._use)

    def _hear(self, coming: Iterator[Received], began: int, use: int) -> None:
        """Deliver the next character at its time."""
        one = next(coming, None)
        if one is None:
            return

        def tell() -> None:
            if use != self._use or self._events is None:
                return
            now = self.clock.now()
            if one.is_break:
                self._events.line_break(now)
            else:
                faults = () if one.fault is None else (CharacterFault(0, one.fault),)
                self._events.received(bytes([one.value]), now, faults)
            self._hear(coming, began, use)

        self.clock.call_at(began + round(one.at), tell)
