"""The short way of an exchange against its sequence: whatever happens, both have to do and tell the same."""

from __future__ import annotations

import random
from collections import deque
from dataclasses import asdict
from typing import Any

import pytest
from link.service_loop import FRAMES, codec_of

from framekit.blocks.device import memory_of
from framekit.definition.times import NEVER
from framekit.link.client import Client
from framekit.link.engine import Engine
from framekit.link.events import CharacterFault, Command, LineFault, Reopen, Send
from framekit.link.observe import Seen
from framekit.link.services.server import MemoryServer
from framekit.link.transfer import TransferResult
from framekit.memory.memory import DeviceMemory

CASES: dict[str, tuple[str, Any]] = {
    "modbus-tcp": ("40001", 1),
    "modbus-rtu": ("40001", 1),
    "modbus-ascii": ("00003", 1),
    "mldp": ("%MW100", 1),
    "ge-rtu": ("40001", 1),
}
"""Where each is read, and from whom."""
LEARNED = {"modbus-tcp", "modbus-rtu", "ge-rtu"}
"""Where the place of the data in a reply is certain: neither hex digits nor lists around them."""
SECOND = 1_000_000_000


class LongWay(Engine):
    """An engine without the short way."""

    def direct_request(self, exchange: Any) -> None:
        return None


class Side:
    """A client with its engine, what it has sent, and everything it has told."""

    def __init__(self, protocol: str, engine: type[Engine], station: Any, watched: bool) -> None:
        self.station = station
        definition, codec = codec_of(protocol)
        self.seen: list[Seen] = []
        self.engine = engine(definition, codec, "client", own=1, monitor=self.seen.append if watched else None)
        self.client = Client(definition, codec, self.engine)
        self.results: list[dict[str, Any]] = []
        self.commands: list[Command] = []
        self.asked_directly = 0
        self.known = 0

    def do(self, commands: list[Command]) -> None:
        self.commands += commands

    def read(self, address: str, count: int, now: int) -> None:
        self.do(self.client.read(address, station=self.station, count=count, now=now, on_done=self.done))
        self.asked_directly += self.engine.direct.is_under_way

    def done(self, result: TransferResult) -> None:
        told = asdict(result)
        told["reply"] = None if result.reply is None else (result.reply.frame, repr(result.reply.complete()))
        told["gives"] = repr(told["gives"])
        self.results.append(told)

    def come(self, data: bytes, now: int, faults: tuple[CharacterFault, ...]) -> list[Command]:
        """Bytes; `known` counts those that were taken for a reply that is known already."""
        ask = self.engine.direct._ask
        same = None if ask is None or self.engine.machine.monitor is not None else ask.request.same
        taken = self.engine.counters.received
        commands = self.engine.receive(data, now, faults)
        self.known += same is not None and self.engine.counters.received > taken
        return commands

    def told(self) -> dict[str, Any]:
        """Everything that can be seen from outside."""
        engine = self.engine
        return {
            "commands": self.commands,
            "results": self.results,
            "seen": [repr(one) for one in self.seen],
            "deadline": engine.deadline,
            "status": engine.status(),
            "counters": asdict(engine.counters),
            "last": (engine.output.last_sent, engine.output.last_received),
            "offset": engine.receiver.stream.offset,
        }


class World:
    """Both sides, and a device whose answers are the same for both. `own`: the station that asks."""

    def __init__(self, protocol: str, station: Any, seed: int, watched: bool = True) -> None:
        self.random = random.Random(seed)
        self.sides = [Side(protocol, kind, station, watched) for kind in (Engine, LongWay)]
        definition, codec = codec_of(protocol)
        self.memory = DeviceMemory(memory_of(definition)[0])
        server = MemoryServer(definition, codec, self.memory)
        self.device = Engine(definition, codec, "server", own=1, server=server)
        self.device.opened(0)
        self.now = 0
        self.unsent = 0
        self.reply = b""
        self.both(lambda side: side.engine.opened(0))

    def both(self, action: Any) -> None:
        """The same for both sides; then they have to have told the same."""
        for side in self.sides:
            side.do(action(side) or [])
        short, long = (side.told() for side in self.sides)
        assert short == long
        commands = list(self.sides[0].commands)
        for side in self.sides:
            side.commands.clear()
        for command in commands:
            if isinstance(command, Send):
                self.unsent += 1
                self.answer(command.data)
            elif isinstance(command, Reopen):
                self.lost()

    def answer(self, data: bytes) -> None:
        """What the device says to a request; what it holds is different every time."""
        for area in self.memory.areas.values():
            area.write_bytes(0, self.random.randbytes(min(area.size_bytes, 400)))
        waiting = deque(self.device.receive(data, self.now))
        self.reply = b""
        while waiting:
            command = waiting.popleft()
            if isinstance(command, Send):
                self.reply += command.data
                waiting.extend(self.device.sent(self.now))

    # ---- what may happen ----------------------------------------------------------------------------------

    def read(self, address: str, count: int) -> None:
        for side in self.sides:
            side.read(address, count, self.now)
        self.both(lambda side: None)

    def left(self) -> None:
        """One frame has left the line."""
        if self.unsent:
            self.unsent -= 1
            self.both(lambda side: side.engine.sent(self.now))

    def come(self, data: bytes, faults: tuple[CharacterFault, ...] = ()) -> None:
        if data:
            self.both(lambda side: side.come(data, self.now, faults))

    def taken(self) -> bytes:
        """The device's reply, which comes only once."""
        data, self.reply = self.reply, b""
        return data

    def pieces(self) -> None:
        data = self.taken()
        cut = self.random.randrange(len(data) + 1)
        self.come(data[:cut])
        self.now += self.random.choice((0, 1_000_000, SECOND))
        self.come(data[cut:])

    def damaged(self) -> None:
        data = bytearray(self.taken())
        if data:
            data[self.random.randrange(len(data))] ^= 1 << self.random.randrange(8)
        self.come(bytes(data))

    def fault(self) -> None:
        data = self.taken()
        self.come(data, (CharacterFault(len(data) // 2, LineFault.PARITY),) if data else ())

    def tick(self) -> None:
        deadline = self.sides[0].engine.deadline
        if deadline < NEVER:
            self.now = max(self.now, deadline)
            self.both(lambda side: side.engine.tick(self.now))

    def lost(self) -> None:
        self.unsent, self.reply = 0, b""
        self.both(lambda side: side.engine.closed(self.now, "pulled"))
        self.both(lambda side: side.engine.opened(self.now))

    def step(self, address: str) -> None:
        """One thing that may happen, the usual ones more often."""
        self.now += self.random.choice((0, 1, 20_000, 3_000_000, SECOND // 10))
        match self.random.choice("rrrrllllllaaaaaaaaaapdnfttwbxg"):
            case "r":
                self.read(address, self.random.choice((1, 10, 10, 3)))
            case "l":
                self.left()
            case "a":
                self.come(self.taken())
            case "p":
                self.pieces()
            case "d":
                self.damaged()
            case "n":
                self.come(self.random.randbytes(self.random.randrange(1, 6)))
            case "f":
                self.fault()
            case "t":
                self.tick()
            case "w":
                self.come(2 * self.taken())
            case "b":
                self.both(lambda side: side.engine.line_break(self.now))
            case "x":
                self.lost()
            case "g":
                self.both(lambda side: side.engine.unfold())


def test_variables_of_an_exchange_begin_anew_with_the_next_one() -> None:
    text = (FRAMES / "modbus-tcp.yaml").read_text(encoding="utf-8")
    for old, new in (
        ("local: {answer: frame}", "local: {answer: frame, last: u16}"),
        ("send: {request_adu: {transaction: transaction,", "send: {request_adu: {transaction: transaction + last,"),
        ("set: {answer: it.pdu}", "set: {answer: it.pdu, last: it.transaction}"),
    ):
        assert text.count(old) == 1
        text = text.replace(old, new)
    world = World(text, 1, 0)
    for _ in range(4):
        world.read("40001", 1)
        world.left()
        world.come(world.taken())
    assert [result["ok"] for result in world.sides[0].results] == [True] * 4
    assert world.sides[0].asked_directly == 3, "the first one is worked out"


@pytest.mark.parametrize("protocol", CASES)
@pytest.mark.parametrize("watched", [True, False], ids=["watched", "unwatched"])
@pytest.mark.parametrize("seed", range(3))
def test_whatever_happens_both_ways_do_and_tell_the_same(protocol: str, seed: int, watched: bool) -> None:
    address, station = CASES[protocol]
    world = World(protocol, station, seed, watched)
    for _ in range(700):
        world.step(address)
    assert any(result["ok"] for result in world.sides[0].results)
    assert world.sides[0].asked_directly > 10
    assert (world.sides[0].known > 0) is (not watched and protocol in LEARNED)
