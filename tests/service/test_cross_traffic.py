"""Two stations that send requests to each other at the same time, on a full-duplex line that damages transmissions.

`FRAMEKIT_EXCHANGES` sets the number of exchanges of both sides together; docs/protocols gives the figures of 100,000.
"""

from __future__ import annotations

import math
import os
from collections import Counter
from dataclasses import dataclass, field
from functools import cache
from random import Random
from typing import Any

import pytest
from spread import spread

from framekit.codec.codec import Codec, compile_protocol
from framekit.codec.errors import FrameError
from framekit.definition.load.protocol import load_protocol
from framekit.definition.times import parse_format
from framekit.link.engine import Engine
from framekit.link.events import Command, Served
from framekit.link.services.client import ServiceClient, TransferResult
from framekit.link.services.server import MemoryServer
from framekit.link.values import FrameValue, Names
from framekit.memory.memory import DeviceMemory
from framekit.run.own_memory import AddressedMemory
from framekit.runfile.devices import memory_of
from framekit.service.driver import Driver
from framekit.transport.clock import VirtualClock
from framekit.transport.simulated_line import SimulatedLine, Transmission

EXCHANGES = int(os.environ.get("FRAMEKIT_EXCHANGES", "600"))
BCC = Names({"check_kind": "bcc", "max_packet": 250, "processor": "slc"})


@cache
def df1() -> Codec:
    return compile_protocol(load_protocol("df1"))


@dataclass
class Damage:
    """Replace `wrong_bytes` random bytes of every hundredth transmission.

    `in_packets` counts damage that a BCC covers completely, including the BCC itself; `passed` counts damaged messages
    that were accepted.
    """

    random: Random
    wrong_bytes: int
    hit: int = 0
    in_packets: int = 0
    passed: int = 0

    def __call__(self, transmission: Transmission) -> None:
        if self.random.random() < 0.01:
            self.hit += 1
            good = bytes(transmission.data)
            places = self.random.sample(range(len(good)), min(self.wrong_bytes, len(good)))
            for index in places:
                transmission.flip(index, self.random.randrange(1, 256))
            if good[:2] == b"\x10\x02":
                self.in_packets += not {0, 1, len(good) - 3, len(good) - 2} & set(places)
                self.passed += self._passes(bytes(transmission.data))

    @staticmethod
    def _passes(data: bytes) -> bool:
        try:
            df1().decode("message", data, BCC)
        except FrameError:
            return False
        return True


@dataclass
class Station:
    """A station: its client sends requests without pauses, its server answers.

    `executed` lists (source, number) in order.
    """

    number: int
    other: int
    clock: VirtualClock
    line: SimulatedLine
    params: dict[str, Any]
    todo: int
    outcomes: Counter[str] = field(default_factory=Counter)
    executed: list[tuple[int, int]] = field(default_factory=list)
    known: dict[int, int | None] = field(default_factory=dict)
    wrong: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        codec, protocol = df1(), df1().protocol
        areas, grammar = memory_of(protocol)
        self.memory = DeviceMemory(areas)
        self.server = MemoryServer(protocol, codec, self.memory)
        self.engine = Engine(
            protocol, codec, "full", params={"node": self.number, **self.params}, line=self.line.settings,
            own=self.number, server=self, memory=AddressedMemory(self.memory, grammar), now=0,
        )  # fmt: skip
        self.client = ServiceClient(protocol, codec, self.engine)
        self.driver = Driver(self.engine, self.line.port(str(self.number)), self.clock)
        self.random = Random(self.number)

    def serve(self, request: FrameValue, buffer: bytes, station: Any, check_only: bool, names: Names) -> Served:
        self.executed.append((request.fields["src"], request.fields["tns"]))
        return self.server.serve(request, buffer, station, check_only, names)

    def unanswered(self) -> None:
        self.server.unanswered()

    def next(self) -> None:
        """Write a random value to a random place, or read a place and compare it."""
        if self.todo == 0:
            return
        self.todo -= 1
        place, value = self.random.randrange(100), self.random.randrange(1, 65536)
        if self.random.random() < 0.5:
            self.driver.do(lambda now: self._write(place, value, now))
        else:
            self.driver.do(lambda now: self._read(place, now))

    def _write(self, place: int, value: int, now: int) -> list[Command]:
        def ended(result: TransferResult) -> None:
            self.known[place] = value if result.ok else None
            self.ended(result)

        return self.client.write(f"N7:{place}", [value], station=self.other, now=now, on_done=ended).commands

    def _read(self, place: int, now: int) -> list[Command]:
        def ended(result: TransferResult) -> None:
            if result.ok:
                expected = [self.known.get(number, 0) for number in range(place, place + 3)]
                if any(one not in (None, other) for one, other in zip(expected, result.values, strict=True)):
                    self.wrong.append(f"N7:{place} read as {result.values}, not {expected}")
            self.ended(result)

        return self.client.read(f"N7:{place}", count=3, station=self.other, now=now, on_done=ended).commands

    def ended(self, result: TransferResult) -> None:
        self.outcomes["ok" if result.ok else result.outcome] += 1
        self.clock.call_soon(self.next)


def run(wrong_bytes: int, params: dict[str, Any], exchanges: int) -> tuple[list[Station], Damage]:
    clock = VirtualClock()
    damage = Damage(Random(3), wrong_bytes)
    line = SimulatedLine(clock, parse_format("8N1", 19200), fault=damage)
    stations = [Station(1, 2, clock, line, params, exchanges // 2), Station(2, 1, clock, line, params, exchanges // 2)]
    for station in stations:
        station.driver.start()
    clock.run_for(0)
    for station in stations:
        station.next()
    while any(station.outcomes.total() < exchanges // 2 for station in stations):
        clock.run_for(1_000_000_000)
    return stations, damage


@pytest.mark.parametrize("embedded", spread(["yes", "no"], 2))
@pytest.mark.long
def test_every_exchange_is_done_or_reported_and_executed_once(embedded: str) -> None:
    stations, damage = run(3, {"check_kind": "crc", "embedded": embedded, "ack_timeout": "500 ms"}, EXCHANGES)
    for station in stations:
        assert station.wrong == []
        assert station.outcomes.total() == EXCHANGES // 2
        assert station.outcomes["ok"] >= 0.99 * EXCHANGES / 2, station.outcomes
        repeated = [one for one, other in zip(station.executed, station.executed[1:], strict=False) if one == other]
        assert repeated == [], "a message that was repeated is delivered once"
    assert damage.hit > EXCHANGES / 100


@pytest.mark.long
def test_a_sum_lets_pass_what_theory_says() -> None:
    """Three wrong bytes cancel out with probability 1/255; every accepted wrong value comes from such a message."""
    stations, damage = run(3, {"check_kind": "bcc", "ack_timeout": "500 ms"}, EXCHANGES)
    theory = damage.in_packets / 255
    assert abs(damage.passed - theory) <= 4 * math.sqrt(theory), (damage.passed, theory)
    for station in stations:
        assert station.outcomes.total() == EXCHANGES // 2
        assert damage.passed or station.wrong == []


@pytest.mark.parametrize("outstanding", [1, 3])
def test_commands_outstanding_are_matched_by_their_number(outstanding: int) -> None:
    clock = VirtualClock()
    line = SimulatedLine(clock, parse_format("8N1", 19200))
    asking, peer = (Station(number, 3 - number, clock, line, {"outstanding": outstanding}, 0) for number in (1, 2))
    for station in (asking, peer):
        station.driver.start()
    peer.memory.write("file7", "word", 0, list(range(100, 160)))
    clock.run_for(0)
    found: dict[int, Any] = {}
    for place in range(0, 60, 5):

        def ask(now: int, place: int = place) -> list[Command]:
            return asking.client.read(
                f"N7:{place}", count=5, station=2, now=now, on_done=lambda done: found.update({place: done.values})
            ).commands

        asking.driver.do(ask)
    most = 0
    while len(found) < 12:
        clock.run_for(1_000_000)
        most = max(most, len(peer.executed) - len(found))
    assert found == {place: list(range(100 + place, 105 + place)) for place in range(0, 60, 5)}
    assert (most > 1) == (outstanding > 1), "a second command is executed before the first one's reply has come"
    assert len(peer.executed) == 12
