"""A client that reads one place after the other on a line whose replies come late.

Before each exchange the place gets a value that no other exchange has, so that a reply to another request, or of
another time, is detected. 10^5 exchanges with each line, on virtual time:

    FRAMEKIT_EXCHANGES=100000 pytest -m long tests/service/test_late_replies.py
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from random import Random
from typing import Any

from service.stalled_process import Plan, StalledClock, StalledPort

from framekit.definition.load.protocol import load_protocol, load_protocol_text
from framekit.definition.model.protocol import Protocol
from framekit.definition.times import parse_format
from framekit.link.events import CharacterFault, Seen
from framekit.link.services.client import Done, ServiceClient, Transfer, TransferResult
from framekit.run.model import FaultPlan, FaultRule
from framekit.runfile.devices import Device, memory_of
from framekit.service.client import ClientService
from framekit.service.device import DeviceService, DeviceStore
from framekit.transport.clock import VirtualClock
from framekit.transport.port import PassingPort, Port
from framekit.transport.simulated_line import SimulatedLine

MS = 1_000_000
SECOND = 1000 * MS

Lateness = Callable[[int], int]
"""How late a frame leaves that is written at a time (ns)."""

REGISTERS = """
protocol: registers
extends: standard
about: A definition of a user, with nothing but what standard gives.
station: {type: number, range: 0..255}
line: {speed: {default: 19200}, format: {default: 8N1}}
groups:
  request: {from: client, head: [{const: STX}, {field: station, type: u8}, {field: code, type: u8}], tail: [{check: crc16-modbus}]}
  reply: {from: server, head: [{const: STX}, {field: station, type: u8}, {field: code, type: u8}], tail: [{check: crc16-modbus}], echo: [station, code]}
frames:
  read: {group: request, where: {code: 1}, body: [{field: address, type: u16}, {field: count, type: u8}]}
  values: {group: reply, where: {code: 1}, body: [{length: size, type: u8, of: [data]}, {data: data, size: size}]}
  write: {group: request, where: {code: 2}, body: [{field: address, type: u16}, {length: size, type: u8, of: [data]}, {data: data, size: size}]}
  written: {group: reply, where: {code: 2}, body: []}
areas: {R: {unit: word, size: 1000}}
addresses: [{form: "R{start:dec}", area: "'R'", wire: yes}]
services:
  read:
    - {areas: [R], limit: {count: 100}, request: {read: {station: station, address: start, count: count}}, reply: {values: {data: data}}, packing: {order: big}}
  write:
    - {areas: [R], limit: {count: 100}, request: {write: {station: station, address: start, data: data}}, reply: {written: {}}, packing: {order: big}}
"""  # noqa: E501


@dataclass(frozen=True)
class Line:
    """A pair of roles of a protocol, the places to read, and the settings of both sides."""

    protocol: str
    places: tuple[str, ...]
    asking: str = "client"
    answering: str = "server"
    station: Any = 3
    own: Any = 1
    device_own: Any = 3
    speed: int = 115200
    format: str | None = "8N1"
    params: dict[str, Any] = field(default_factory=dict)
    device: dict[str, Any] = field(default_factory=dict)


def registers(first: str) -> tuple[str, ...]:
    """Return seven consecutive places; seven has no common factor with the intervals of faults."""
    stem = first.rstrip("0123456789")
    return tuple(f"{stem}{int(first[len(stem) :]) + at}" for at in range(7))


LINES = {
    "modbus-rtu": Line("modbus-rtu", registers("40001"), format="8E1"),
    "modbus-ascii": Line("modbus-ascii", registers("40001"), format="7E1"),
    "mldp": Line("mldp", registers("D100")),
    "ge-rtu": Line("ge-rtu", registers("40001"), format="8E1"),
    "registers": Line("registers", registers("R1")),
    "modbus-tcp": Line("modbus-tcp", registers("40001"), format=None),
    "melsec-mc-4e": Line("melsec-mc-4e", registers("D100"), format=None),
    "fins-tcp": Line("fins-tcp", registers("D100"), station=0, format=None),
    "srtp": Line("srtp", registers("R1"), format=None),
    "iec62056-21": Line("iec62056-21", (), station="", own="", device_own="12", speed=300, format="7E1"),
    "snp": Line("snp", registers("R1"), "master", "slave", "", "M", "S", 19200, "8O1"),
    "snp-x": Line("snp-x", registers("R1"), "master", "slave", bytes(8), bytes(8), bytes(8), 19200, "8O1"),
    "ccm": Line("ccm", registers("R1"), "master", "slave", speed=19200, format="8O1"),
    "ccm-peer": Line("ccm", registers("R1"), "peer", "peer", speed=19200, format="8O1"),
    "df1": Line("df1", registers("N7:0"), "full", "full", params={"node": 1}, device={"node": 3}),
    "df1-master": Line(
        "df1", registers("N7:0"), "master", "slave", params={"node": 9, "normal_nodes": [3]}, device={"node": 3}
    ),
}  # fmt: skip


@cache
def protocol_of(name: str) -> Protocol:
    return load_protocol_text(REGISTERS, name) if name == "registers" else load_protocol(name)


class OverlappingPort(PassingPort):
    """The port of a device whose frames leave late, each independently, so that later frames may overtake them."""

    def __init__(self, inner: Port, clock: VirtualClock, lateness: Lateness) -> None:
        super().__init__(inner)
        self.clock, self.lateness = clock, lateness

    def write(self, data: bytes) -> None:
        self.clock.call_at(self.clock.now() + self.lateness(self.clock.now()), lambda: self.inner.write(data))
        self.clock.call_soon(self._tell)

    def _tell(self) -> None:
        if self.events is not None:
            self.events.sent(self.clock.now())

    def sent(self, now: int) -> None:
        """Ignore the event: the device got it when it wrote."""


class KeepingPort(PassingPort):
    """The port of a device in front of a gateway that keeps some replies until the next request.

    `together`: the kept frames leave with the next reply, else as soon as the next request arrives.
    """

    def __init__(self, inner: Port, clock: VirtualClock, rate: float, together: bool, random: Random) -> None:
        super().__init__(inner)
        self.clock, self.rate, self.together, self.random = clock, rate, together, random
        self.kept = b""
        self.is_asked = False
        """Whether a request has arrived since the first frame was kept."""
        self.number = 0
        """How often frames were kept."""

    def write(self, data: bytes) -> None:
        if self.together and self.kept and self.is_asked:
            data, self.kept = self.kept + data, b""
        elif self.kept or self.random.random() < self.rate:
            self.number += not self.kept
            self.is_asked = self.is_asked and bool(self.kept)
            self.kept += data
            self.clock.call_soon(self._tell)
            return
        self.inner.write(data)

    def _tell(self) -> None:
        if self.events is not None:
            self.events.sent(self.clock.now())

    def received(self, data: bytes, now: int, faults: tuple[CharacterFault, ...] = ()) -> None:
        self.is_asked = True
        if self.kept and not self.together:
            kept, self.kept = self.kept, b""
            self.inner.write(kept)
        super().received(data, now, faults)


class LateWorld:
    """One exchange after the other; `wrong` lists the values that differ from the value during their exchange.

    `watched`: a monitor gets each record. `lateness`: how late each frame of the device is, independently; with
    `rules` the frames after a late frame wait for it. `stalls`: the process of the client stalls by this plan, from
    the first exchange on; `is_network`: everything it writes has left at once, as on a TCP connection; a read returns
    at most `room` bytes. `keeps`: a gateway keeps this part of the replies until the next request, see `KeepingPort`.
    """

    def __init__(
        self, name: str, *rules: FaultRule, watched: bool = False, seed: int = 1, lateness: Lateness | None = None,
        stalls: Plan | None = None, reads_first: bool = False, is_network: bool = False, room: int = 64,
        keeps: float = 0, together: bool = False, **params: Any,
    ) -> None:  # fmt: skip
        self.line = line = LINES[name]
        self.clock = VirtualClock()
        settings = None if line.format is None else parse_format(line.format, line.speed)
        wire = SimulatedLine(self.clock, settings)
        self.protocol = protocol = protocol_of(line.protocol)
        areas, grammar = memory_of(protocol)
        device = Device(
            name="device", protocol=protocol, role=line.answering, own=line.device_own,
            params=line.device, areas=areas, grammar=grammar, profile=None, mapping={}, initial=(),
        )  # fmt: skip
        plan = FaultPlan(seed=seed, rules=rules).of_line()
        port: Port = wire.port("device")
        if lateness is not None:
            port = OverlappingPort(port, self.clock, lateness)
        self.gateway = KeepingPort(port, self.clock, keeps, together, Random(f"{name} {keeps} {seed}"))
        if keeps:
            port = self.gateway
        self.device = DeviceService(device, port, self.clock, settings, store=DeviceStore(device, self.clock, plan))
        self.seen: list[Seen] = []
        self.process = StalledClock(self.clock, stalls or (lambda number: 0), reads_first)
        own: Port = wire.port("client")
        if stalls is not None:
            own = StalledPort(own, self.process, is_network, room)
        self.service = ClientService(
            protocol, own, self.clock if stalls is None else self.process, role=line.asking,
            params={**line.params, **params}, line=settings, own=line.own,
            monitor=self.seen.append if watched else None,
        )  # fmt: skip
        self.places = [grammar.parse(place) for place in line.places]
        self.wrong: list[str] = []
        self.outcomes: Counter[str] = Counter()
        self.number = 0
        self._ended: list[TransferResult] = []
        self.device.start()
        self.service.start()
        self.clock.run_for(SECOND)
        self.process.is_armed = True

    @property
    def late(self) -> int:
        return self.service.engine.counters.late

    @property
    def injected(self) -> Counter[str]:
        """Return the number of faults so far, by kind."""
        assert self.device.faults is not None
        return self.device.faults.injected

    def exchange(self) -> str:
        """Read the next place; return the outcome."""
        while not self.service.is_open:
            self.clock.run_for(100 * MS)
        self.number += 1
        at = self.number % len(self.places)
        place, value = self.places[at], self.number & 0xFFFF
        self.device.memory.write(place.area, place.unit, place.start, [value])
        self._ended.clear()
        asks_for = {"address": self.line.places[at], "station": self.line.station, "unit": None, "count": 1}

        def begin(client: ServiceClient, now: int, done: Done) -> Transfer:
            return client.read(**asks_for, now=now, on_done=done)

        self.service.request(begin, self._ended.append)
        ended, clock = self._ended, self.clock
        end = clock.now() + 3600 * SECOND
        while not ended and clock.now() < end and clock.advance():
            pass
        if not ended:
            outcome = "never ended"
        else:
            outcome = ended[0].outcome or "ok"
            if ended[0].ok and list(ended[0].values) != [value]:
                self.wrong.append(f"{self.number}: {ended[0].values} for {value}")
        self.outcomes[outcome] += 1
        return outcome

    def write(self, value: int) -> TransferResult:
        """Write a value to the first place; return the result."""
        self._ended.clear()

        def begin(client: ServiceClient, now: int, done: Done) -> Transfer:
            return client.write(self.line.places[0], [value], station=self.line.station, now=now, on_done=done)

        self.service.request(begin, self._ended.append)
        while not self._ended and self.clock.advance():
            pass
        return self._ended[0]

    def exchanges(self, count: int) -> None:
        for _ in range(count):
            self.exchange()
