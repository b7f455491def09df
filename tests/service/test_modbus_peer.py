"""Our client with a pymodbus server: RTU and ASCII on a pseudo-terminal, and TCP. Real ports, real time."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from pymodbus import FramerType
from pymodbus.server import ModbusSerialServer, ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from framekit.runfile.run_file import load_run
from framekit.service.run import RunService
from framekit.transport.clock import AsyncioClock
from framekit.transport.pty_port import PtyPair

RUN = """
run: peer
memory: masterlogic
channels:
  1: {{port: "{port}", protocol: {protocol}, {line} params: {{reply_timeout: 2 s}}}}
set: {{M200: [11, 22, 33], M210: 0xBEEF, M220: 5}}
blocks:
  0: {{read: "40010", station: 1, count: 10, into: M100, once: yes}}
  1: {{read: "30005", station: 1, count: 2, into: M120, when: block 0 done}}
  2: {{read: "00003", station: 1, count: 12, into: M130.0, when: block 1 done}}
  3: {{write: "40101", station: 1, count: 3, from: M200, when: block 2 done}}
  4: {{write: "40110", station: 1, from: M210, when: block 3 done}}
  5: {{write: "00021", station: 1, count: 3, from: M220.0, when: block 4 done}}
  6: {{read: "49000", station: 1, into: M140, when: block 5 done}}
"""


class Peer:
    """A pymodbus device with some values; it records writes."""

    def __init__(self) -> None:
        self.written: list[tuple[int, int, list[Any]]] = []
        coils = [bool(number % 3) for number in range(64)]
        registers = [1000 + number for number in range(200)]
        self.device = SimDevice(
            id=1,
            simdata=(
                [SimData(0, values=coils, datatype=DataType.BITS)],
                [SimData(0, values=coils, datatype=DataType.BITS)],
                [SimData(0, values=registers, datatype=DataType.REGISTERS)],
                [SimData(0, values=registers[::-1], datatype=DataType.REGISTERS)],
            ),
            action=self._action,
        )

    async def _action(
        self, function: int, start: int, address: int, count: int, registers: list[int], values: list[Any] | None
    ) -> None:
        if values is not None:
            self.written.append((function, address, list(values)))


@asynccontextmanager
async def served(server: Any) -> AsyncIterator[None]:
    assert await server.listen()
    try:
        yield
    finally:
        await server.shutdown()


async def carry_out(path: Path, until: Callable[[RunService], bool]) -> RunService:
    """Run a run file until a condition is true, which is tested after every event on the line."""
    something = asyncio.Event()
    service = RunService(
        load_run(path), AsyncioClock(asyncio.get_running_loop()), lambda channel, seen: something.set()
    )
    service.start()
    try:
        async with asyncio.timeout(180):
            while not until(service):
                await something.wait()
                something.clear()
                await asyncio.sleep(0)
    finally:
        service.stop()
    return service


def done(service: RunService) -> bool:
    return service.states[6].done + service.states[6].failed > 0


def check(service: RunService, peer: Peer) -> None:
    memory = service.memory
    assert memory.read("M", "word", 100, 10) == list(range(1009, 1019))
    assert memory.read("M", "word", 120, 2) == [1195, 1194]
    assert memory.read("M", "bit", 130 * 16, 12) == [int(bool(number % 3)) for number in range(2, 14)]
    assert [values for _, address, values in peer.written if address == 100] == [[11, 22, 33]]
    assert [values for _, address, values in peer.written if address == 109] == [[0xBEEF]]
    assert [values for _, address, values in peer.written if address == 20] == [[True, False, True]]
    counters = service.states
    assert all((counters[number].done, counters[number].failed) == (1, 0) for number in range(6))
    assert (counters[6].done, counters[6].failed) == (0, 1), "the device has no register 49000"
    assert str(service.states[6].last_failure) == "refused 0x0002: illegal data address"
    assert memory.read("M", "word", 140) == [0]


@pytest.mark.parametrize(
    ("protocol", "framer", "line"),
    [("modbus-rtu", FramerType.RTU, "speed: 19200,"), ("modbus-ascii", FramerType.ASCII, "speed: 9600,")],
)
def test_serial(tmp_path: Path, protocol: str, framer: FramerType, line: str) -> None:
    async def scenario() -> None:
        peer = Peer()
        with PtyPair() as pair:
            path = tmp_path / "peer.run.yaml"
            path.write_text(RUN.format(port=pair.first, protocol=protocol, line=line), encoding="utf-8")
            async with served(ModbusSerialServer(peer.device, framer=framer, port=pair.second, baudrate=19200)):
                service = await carry_out(path, done)
        check(service, peer)

    asyncio.run(scenario())


def test_tcp(tmp_path: Path) -> None:
    async def scenario() -> None:
        peer = Peer()
        server = ModbusTcpServer(peer.device, address=("127.0.0.1", 0))
        async with served(server):
            number = server.transport.sockets[0].getsockname()[1]
            path = tmp_path / "peer.run.yaml"
            path.write_text(
                RUN.format(port=f"tcp://127.0.0.1:{number}", protocol="modbus-tcp", line=""), encoding="utf-8"
            )
            service = await carry_out(path, done)
        check(service, peer)

    asyncio.run(scenario())
