"""A client and a device of every shipped protocol on a simulated line, with a fault plan for its frames."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from functools import cache
from typing import Any

from framekit.codec.codec import compile_protocol
from framekit.definition.load.protocol import load_protocol
from framekit.definition.times import parse_format
from framekit.link.engine import Engine
from framekit.link.events import Seen
from framekit.link.frame_faults import FrameFaults
from framekit.link.scope import Scope
from framekit.link.services.client import ServiceClient, TransferResult
from framekit.run.model import FaultPlan, FaultRule
from framekit.runfile.devices import Device, memory_of
from framekit.service.device import DeviceService, DeviceStore
from framekit.service.driver import Driver
from framekit.service.faults import FaultInjector, FaultyPort
from framekit.transport.clock import VirtualClock
from framekit.transport.simulated_line import SimulatedLine

MS = 1_000_000
SECOND = 1000 * MS


@dataclass(frozen=True)
class Link:
    """A pair of roles of a protocol, with the station and the address in the device."""

    protocol: str
    asking: str = "client"
    answering: str = "server"
    station: Any = 3
    address: str = "40001"
    speed: int = 19200
    format: str | None = "8E1"
    params: dict[str, Any] = field(default_factory=dict)
    own: dict[str, Any] = field(default_factory=dict)
    me: Any = 1
    service: str = ""
    """The service to call, for protocols without reads and writes by address."""
    count: int = 4
    """Number of values that an exchange reads or writes."""

    def __str__(self) -> str:
        return f"{self.protocol}-{self.asking}"


LINKS = [
    Link("modbus-rtu"),
    Link("modbus-ascii", format="7E1"),
    Link("modbus-tcp", format=None),
    Link("mldp", address="D100"),
    Link("ge-rtu"),
    Link("ccm", "master", "slave", address="R1", format="8O1"),
    Link("ccm", "peer", "peer", address="R1", format="8O1"),
    Link("df1", "full", "full", address="N7:0", own={"node": 1}),
    Link("srtp", format=None, address="R1", params={"allow": "writes"}),
    Link("df1", "master", "slave", address="N7:0", params={"normal_nodes": [3]}, own={"node": 9}),
    Link("uss", address="P700", count=1),
    Link("melsec-mc-1c", address="D100", format="7E1"),
    Link("rk512-3964r", station=None, address="DB10.DW0", me=None),
    Link("rk512-3964r", "peer", "peer", station=None, address="DB10.DW0", me=None, params={"priority": "low"}),
]


loaded = cache(load_protocol)


class FaultWorld:
    """A sequence of exchanges with faults; values read by the client are compared with the memory of the device."""

    def __init__(self, link: Link, *rules: FaultRule, seed: int = 1, echo: bool = False) -> None:
        self.link = link
        self.clock = VirtualClock()
        self.plan = FaultPlan(seed=seed, rules=rules).of_line()
        settings = None if link.format is None else parse_format(link.format, link.speed)
        self.line = SimulatedLine(self.clock, settings)
        self.protocol = loaded(link.protocol)
        codec = compile_protocol(self.protocol)
        areas, grammar = memory_of(self.protocol)
        server_params = {"node": link.station} if "node" in self.protocol.params else {}
        device = Device(
            name="device", protocol=self.protocol, role=link.answering, own=link.station,
            params=server_params, areas=areas, grammar=grammar, profile=None, mapping={}, initial=(),
        )  # fmt: skip
        store = DeviceStore(device, self.clock, self.plan)
        self.device = DeviceService(device, self.line.port("device"), self.clock, settings, store=store)
        self.injector = self.device.faults
        assert self.injector is not None
        client_params = {**link.params, **link.own}
        own = link.own.get("node", link.me)
        self.engine = Engine(
            self.protocol, codec, link.asking, params=client_params, line=settings, own=own, now=0,
            monitor=self._watch,
        )  # fmt: skip
        self.seen: Counter[str] = Counter()
        self.client = ServiceClient(self.protocol, codec, self.engine)
        self.engine.machine.ask_service = self.client.ask
        scope = Scope(self.protocol, role=link.asking, own=own, line=settings, params=client_params)
        frames = FrameFaults(self.protocol, codec, scope, answers=False)
        self.asking = FaultInjector(self.plan, self.clock, frames, answers=False, name="client")
        self.port = self.line.port("client")
        self.driver = Driver(self.engine, FaultyPort(self.port, self.asking), self.clock)
        self.outcomes: list[str] = []
        self.wrong: list[str] = []
        self.known: list[int | None] = [0] * link.count
        self.before = [0] * link.count
        self.number = 0
        self.device.start()
        self.driver.start()
        self.clock.run_for(SECOND)

    def _watch(self, seen: Seen) -> None:
        self.seen["repeated" if seen.repeated else seen.kind] += 1

    @property
    def injected(self) -> Counter[str]:
        assert self.injector is not None
        return self.injector.injected + self.asking.injected

    def no_more(self) -> None:
        """End the faults."""
        assert self.injector is not None
        for injector in (self.injector, self.asking):
            injector.rules.clear()

    def exchange(self) -> str:
        """Write new values, or read, or call the service; return the outcome."""
        done: list[TransferResult] = []
        while not self.driver.is_open:
            self.clock.run_for(100 * MS)
        self.number += 1
        write = self.number % 2 == 1
        values = [(self.number * 251 + index * 4097) & 0x7FFF for index in range(self.link.count)]
        keys: dict[str, Any] = {"station": self.link.station, "on_done": done.append}

        def start(now: int) -> Any:
            if self.link.service:
                return self.client.call(self.link.service, now=now, **keys).commands
            if write:
                return self.client.write(self.link.address, values, now=now, **keys).commands
            return self.client.read(self.link.address, count=self.link.count, now=now, **keys).commands

        self.driver.do(start)
        end = self.clock.now() + 3600 * SECOND
        while not done and self.clock.now() < end and self.clock.advance():
            pass
        assert done, "an exchange has not ended within an hour"
        outcome = done[0].outcome or "ok"
        self.outcomes.append(outcome)
        if self.link.service:
            return outcome
        place = self.device.device.grammar.parse(self.link.address)
        stored = self.device.memory.read(place.area, place.unit, place.start, self.link.count)
        if write:
            self.known = list(values) if done[0].ok else [None] * self.link.count
            if done[0].ok and stored != values:
                self.wrong.append(f"{self.number}: written {values}, there is {stored}")
            if not done[0].ok and stored not in (values, self.before):
                self.wrong.append(f"{self.number}: {stored} was never written")
        elif done[0].ok and list(done[0].values) != stored:
            self.wrong.append(f"{self.number}: read {done[0].values}, there is {stored}")
        self.before = stored
        return outcome
