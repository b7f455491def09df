"""The Python byte codes of a request and an exchange; they do not depend on the machine."""

from __future__ import annotations

import asyncio
import gc
import socket
import sys
import threading
from collections.abc import Awaitable, Callable
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

import framekit
from framekit.codec import codec
from framekit.codec.codec import compile_protocol
from framekit.definition.load import protocol as definitions
from framekit.definition.load.protocol import load_protocol
from framekit.link.engine import Engine
from framekit.link.events import Send
from framekit.link.services.client import TransferResult
from framekit.link.services.server import MemoryServer
from framekit.memory.memory import DeviceMemory
from framekit.runfile.devices import DeviceSettings, load_devices, memory_of
from framekit.service.client import ClientService
from framekit.service.device import Serving
from framekit.transport import clock as clocks
from framekit.transport.clock import AsyncioClock, Turns
from framekit.transport.port import Port, PortEvents

MOST_SERVED_IN_MEMORY = 1980
MOST_FOR_A_REQUEST = 2115
MOST_FOR_A_READ = 2642
MOST_FOR_A_READ_OVER_TCP = 3620
"""Measured with Python 3.11 for the cheapest exchange, since clocks make extra calls now and then.

In memory: engine and server alone. A request and a read: with driver and clock. Over TCP: also with asyncio, in turns
without time limit, because a traced read takes longer than a turn.
"""

pytestmark = pytest.mark.skipif(sys.version_info[:2] != (3, 11), reason="other versions have other byte codes")

READ_10 = bytes.fromhex("0001 0000 0006 01 03 0000 000A")
REFUSAL = bytes.fromhex("0001 0000 0003 01 83 02")
TEN = bytes.fromhex("0001 0000 0017 01 03 14") + bytes(range(20))


@pytest.fixture(autouse=True)
def unused_definitions(monkeypatch: pytest.MonkeyPatch) -> None:
    """Load and compile definitions again, since compiled definitions remember facts of the frames of earlier tests."""
    monkeypatch.setattr(definitions, "_kept", {})
    monkeypatch.setattr(codec, "_compiled", {})


class HandPort(Port):
    """A port whose other side is the test: all writes are transmitted at once, and recorded in `written`."""

    name, settings, is_stream = "by hand", None, True

    def __init__(self, clock: AsyncioClock) -> None:
        self.clock = clock
        self.written: list[bytes] = []
        self.events: PortEvents | None = None

    def open(self, events: PortEvents) -> None:
        self.events = events
        self.clock.call_soon(lambda: events.opened(self.clock.now()))

    def write(self, data: bytes) -> None:
        raise AssertionError("everything can be written through")

    def write_through(self, data: bytes) -> bool:
        self.written.append(data)
        return True

    def close(self) -> None:
        self.events = None

    def send_break(self, duration: int) -> None: ...

    def tell(self, data: bytes) -> None:
        assert self.events is not None
        self.events.received(data, self.clock.now())

    def reply(self) -> bytes:
        """Return ten registers, as the reply to the last request."""
        return self.written[-1][:2] + TEN[2:]


def codes_of(action: Callable[[], Any]) -> int:
    """Return the number of Python byte codes of an action, without those of the test itself."""
    count = 0

    def note(frame: FrameType, event: str, argument: Any) -> Any:
        nonlocal count
        if frame.f_code.co_filename == __file__:
            return None
        frame.f_trace_opcodes, frame.f_trace_lines = True, False
        count += event == "opcode"
        return note

    gc.disable()
    sys.settrace(note)
    try:
        action()
    finally:
        sys.settrace(None)
        gc.enable()
    return count


def in_a_loop(scenario: Callable[[AsyncioClock], Awaitable[None]]) -> None:
    async def run() -> None:
        await scenario(AsyncioClock(asyncio.get_running_loop()))

    asyncio.run(run())


async def opened(port: HandPort) -> None:
    while port.events is None:
        await asyncio.sleep(0)
    for _ in range(5):
        await asyncio.sleep(0)


def test_a_request_that_is_served_in_memory() -> None:
    protocol = load_protocol("modbus-tcp")
    codec = compile_protocol(protocol)
    server = MemoryServer(protocol, codec, DeviceMemory(memory_of(protocol)[0]))
    engine = Engine(protocol, codec, "server", own=1, is_stream=True, server=server)
    engine.opened(0)
    replies: list[bytes] = []

    def serve(now: int) -> None:
        (command,) = engine.receive(READ_10, now)
        assert isinstance(command, Send) and not engine.sent(now)
        replies.append(command.data)

    counts = [codes_of(partial(serve, now)) for now in range(1000, 6000, 1000)]
    assert replies == [READ_10[:5] + b"\x17\x01\x03\x14" + bytes(20)] * 5 and server.counters.done == 5
    assert min(counts) <= MOST_SERVED_IN_MEMORY


def test_a_request_that_is_served() -> None:
    async def scenario(clock: AsyncioClock) -> None:
        port = HandPort(clock)
        devices = load_devices("modbus-tcp", Path("."), DeviceSettings(initial={"40001": "1,2,3"}))
        serving = Serving(devices, clock, None)
        serving.serve(port)
        await opened(port)
        counts = [codes_of(lambda: port.tell(READ_10)) for _ in range(5)]
        assert port.written[-1][:15] == bytes.fromhex("0001 0000 0017 01 03 14 0001 0002 0003")
        assert (len(port.written), serving.stores[0].counters.done) == (5, 5)
        assert min(counts) <= MOST_FOR_A_REQUEST
        serving.stop()

    in_a_loop(scenario)


def test_a_read_of_a_client() -> None:
    async def scenario(clock: AsyncioClock) -> None:
        port = HandPort(clock)
        service = ClientService(load_protocol("modbus-tcp"), port, clock, role="client")
        service.start()
        await opened(port)
        results: list[TransferResult] = []

        def read() -> None:
            service.request(
                lambda client, now, done: client.read("40001", count=10, station=1, now=now, on_done=done),
                results.append,
            )
            port.tell(port.reply())

        counts = [codes_of(read) for _ in range(10)]
        assert [result.ok for result in results] == [True] * 10 and len(results[-1].values) == 10
        assert min(counts) <= MOST_FOR_A_READ
        service.stop()

    in_a_loop(scenario)


def test_a_refusal_does_not_make_later_reads_slower() -> None:
    async def scenario(clock: AsyncioClock) -> None:
        port = HandPort(clock)
        service = ClientService(load_protocol("modbus-tcp"), port, clock, role="client")
        service.start()
        await opened(port)
        results: list[TransferResult] = []

        def read(reply: bytes) -> None:
            service.request(
                lambda client, now, done: client.read("40001", count=10, station=1, now=now, on_done=done),
                results.append,
            )
            port.tell(port.written[-1][:2] + reply[2:])

        before = min(codes_of(partial(read, TEN)) for _ in range(3))
        read(REFUSAL)
        assert min(codes_of(partial(read, TEN)) for _ in range(3)) == before
        assert [result.ok for result in results] == [True] * 3 + [False] + [True] * 3
        service.stop()

    in_a_loop(scenario)


class Responder(threading.Thread):
    """Answer reads of ten registers on a socket, in a thread that is not counted."""

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self.listening = socket.create_server(("127.0.0.1", 0))
        self.port = self.listening.getsockname()[1]

    def run(self) -> None:
        connection, _ = self.listening.accept()
        with self.listening, connection:
            while request := connection.recv(100):
                connection.sendall(request[:2] + TEN[2:])


def test_a_read_over_tcp(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clocks, "Turns", partial(Turns, now=int))

    async def reads() -> int:
        responder = Responder()
        responder.start()
        async with framekit.aconnect("modbus-tcp", f"tcp://127.0.0.1:{responder.port}", station=1) as client:
            assert list(await client.read("40001", 10)) == [number * 0x0202 + 1 for number in range(10)]
            counts: list[int] = []
            count = 0

            def note(frame: FrameType, event: str, argument: Any) -> Any:
                nonlocal count
                frame.f_trace_opcodes, frame.f_trace_lines = True, False
                count += event == "opcode"
                return note

            gc.disable()
            sys.settrace(note)
            try:
                for _ in range(20):
                    count = 0
                    await client.read("40001", 10)
                    counts.append(count)
            finally:
                sys.settrace(None)
                gc.enable()
        return min(counts)

    assert asyncio.run(reads()) <= MOST_FOR_A_READ_OVER_TCP


@pytest.mark.long
def test_a_read_leaves_nothing_to_the_collector() -> None:
    async def scenario(clock: AsyncioClock) -> None:
        port = HandPort(clock)
        service = ClientService(load_protocol("modbus-tcp"), port, clock, role="client")
        service.start()
        await opened(port)
        results: list[TransferResult] = []

        def read() -> None:
            service.request(
                lambda client, now, done: client.read("40001", count=10, station=1, now=now, on_done=done),
                results.append,
            )
            port.tell(port.reply())

        for _ in range(5):
            read()
        gc.collect()
        gc.disable()
        try:
            for _ in range(20):
                read()
            assert gc.collect() == 0 and len(results) == 25
        finally:
            gc.enable()
        service.stop()

    in_a_loop(scenario)


CODES_OF_A_READ = {
    "mldp": (("%MW100", 1, "client", None), 3350, 3460),
    "srtp": (("%R1", None, "client", None), 3950, 4990),
    "df1": (("N7:0", 1, "full", 0), 7610, 8974),
}
"""Current values: place, station, role and own station; byte codes of client and server for ten words."""


@pytest.mark.parametrize("name", CODES_OF_A_READ)
def test_a_read_between_a_client_and_a_server(name: str) -> None:
    (place, station, role, own), most_of_client, most_of_server = CODES_OF_A_READ[name]

    async def scenario(clock: AsyncioClock) -> None:
        ports = HandPort(clock), HandPort(clock)
        settings = DeviceSettings(initial={place: "1,2,3"}, role=None if role == "client" else role)
        serving = Serving(load_devices(name, Path("."), settings), clock, None)
        serving.serve(ports[1])
        service = ClientService(load_protocol(name), ports[0], clock, role=role, own=own)
        service.start()
        await opened(ports[0])
        await opened(ports[1])
        results: list[TransferResult] = []

        def ask() -> None:
            service.request(
                lambda client, now, done: client.read(place, count=10, station=station, now=now, on_done=done),
                results.append,
            )

        def read() -> tuple[int, int]:
            """Return the byte codes of each side until both have sent everything."""
            counts = [codes_of(ask), 0]
            while any(port.written for port in ports):
                for side, other in ((1, 0), (0, 1)):
                    data = b"".join(ports[other].written)
                    ports[other].written.clear()
                    if data:
                        counts[side] += codes_of(lambda side=side, data=data: ports[side].tell(data))
            return counts[0], counts[1]

        counts = [read() for _ in range(8)]
        assert [result.ok for result in results] == [True] * 8 and results[-1].values[:3] == [1, 2, 3]
        assert min(client for client, _ in counts) <= most_of_client
        assert min(server for _, server in counts) <= most_of_server
        serving.stop()
        service.stop()

    in_a_loop(scenario)
