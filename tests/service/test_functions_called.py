"""How many Python functions a request and an exchange come to, counted from what the port tells to what it is given."""

from __future__ import annotations

import asyncio
import gc
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

from framekit.definition.load.protocol import load_protocol
from framekit.link.services.client import TransferResult
from framekit.runfile.devices import DeviceSettings, load_devices
from framekit.runfile.run_file import load_run
from framekit.service.client import ClientService
from framekit.service.device import Serving
from framekit.service.run import RunService
from framekit.transport.clock import AsyncioClock
from framekit.transport.port import Port, PortEvents
from framekit.transport.schemes import SCHEMES, Scheme

MOST_FOR_A_REQUEST = 67
MOST_FOR_A_READ = 89
MOST_FOR_A_BLOCK = 162
"""What holds now, of the exchange with the fewest: clocks call something now and then. The goal for a block is 120."""

READ_10 = bytes.fromhex("0001 0000 0006 01 03 0000 000A")
TEN = bytes.fromhex("0001 0000 0017 01 03 14") + bytes(range(20))


class HandPort(Port):
    """A port whose other side is the test: everything leaves at once, and stands in `written`."""

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
        """Ten registers, as an answer to what was written last."""
        return self.written[-1][:2] + TEN[2:]


def calls_of(action: Callable[[], Any]) -> int:
    """How many Python functions are called."""
    count = -1  # the action itself

    def note(frame: FrameType, event: str, argument: Any) -> None:
        nonlocal count
        count += event == "call"

    gc.disable()
    sys.setprofile(note)
    try:
        action()
    finally:
        sys.setprofile(None)
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


def test_a_request_that_is_served() -> None:
    async def scenario(clock: AsyncioClock) -> None:
        port = HandPort(clock)
        devices = load_devices("modbus-tcp", Path("."), DeviceSettings(initial={"40001": "1,2,3"}))
        serving = Serving(devices, clock, None)
        serving.serve(port)
        await opened(port)
        counts = [calls_of(lambda: port.tell(READ_10)) for _ in range(5)]
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

        counts = [calls_of(read) for _ in range(10)]
        assert [result.ok for result in results] == [True] * 10 and len(results[-1].values) == 10
        assert min(counts) <= MOST_FOR_A_READ
        service.stop()

    in_a_loop(scenario)


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


def test_an_exchange_of_a_read_block_that_is_shown_to_a_monitor(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ports: list[HandPort] = []

    def made(url: str, settings: Any, clock: AsyncioClock, wiring: Any) -> HandPort:
        ports.append(HandPort(clock))
        return ports[-1]

    monkeypatch.setitem(SCHEMES, "hand", Scheme(form="hand:", open=made))
    file = tmp_path / "r.run.yaml"
    file.write_text(
        "run: reads\nmemory: masterlogic\nchannels:\n  1: {port: 'hand:', protocol: modbus-tcp, station: 1}\n"
        "blocks:\n  1: {read: '40001', count: 10, channel: 1, into: D00100, every: 1 h}\n",
        encoding="utf-8",
    )

    async def scenario(clock: AsyncioClock) -> None:
        shown: list[str] = []
        service = RunService(load_run(file), clock, lambda channel, seen: shown.append(seen.kind))
        service.start()
        while not ports:
            await asyncio.sleep(0)
        (port,) = ports
        await opened(port)

        def read() -> None:
            service.fire(1)
            port.tell(port.reply())

        if port.written:
            port.tell(port.reply())
        counts = [calls_of(read) for _ in range(10)]
        assert service.states[1].done >= 10
        assert shown[-2:] == ["frame", "frame"]
        assert min(counts) <= MOST_FOR_A_BLOCK
        service.stop()

    in_a_loop(scenario)


CALLS_OF_A_READ = {
    "mldp": (("%MW100", 1, "client", None), 105, 97),
    "srtp": (("%R1", None, "client", None), 118, 127),
    "df1": (("N7:0", 1, "full", 0), 217, 252),
}
"""What holds now: place, station, role and own station; functions of the client and of the server for ten words."""


@pytest.mark.parametrize("name", CALLS_OF_A_READ)
def test_a_read_between_a_client_and_a_server(name: str) -> None:
    (place, station, role, own), most_of_client, most_of_server = CALLS_OF_A_READ[name]

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
            """Functions called by each side until neither has anything to tell the other."""
            counts = [calls_of(ask), 0]
            while any(port.written for port in ports):
                for side, other in ((1, 0), (0, 1)):
                    data = b"".join(ports[other].written)
                    ports[other].written.clear()
                    if data:
                        counts[side] += calls_of(lambda side=side, data=data: ports[side].tell(data))
            return counts[0], counts[1]

        counts = [read() for _ in range(8)]
        assert [result.ok for result in results] == [True] * 8 and results[-1].values[:3] == [1, 2, 3]
        assert min(client for client, _ in counts) <= most_of_client
        assert min(server for _, server in counts) <= most_of_server
        serving.stop()
        service.stop()

    in_a_loop(scenario)
