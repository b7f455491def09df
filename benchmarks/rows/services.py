"""A read of ten words over TCP as users run it, CPU time of each side: `framekit serve`, `await client.read`, a run.

Each server is a process of its own: `framekit serve --quiet`, and pymodbus's server for Modbus TCP; its time is
measured by the system. The clients run in this process. Every shipped protocol is measured with its own client and
server (DF1: full duplex; SNP and SNP-X: without break, which TCP does not carry, and with the pauses of their lines).
In every round, pymodbus's client and server are measured, too.
"""

from __future__ import annotations

import asyncio
import contextlib
import subprocess
import sys
import time
from collections.abc import Awaitable, Callable, Iterator
from contextlib import AsyncExitStack, ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from pymodbus.client import AsyncModbusTcpClient

import framekit
from benchmarks.measure import Timing, interleave
from benchmarks.row import Row, Target, slower
from framekit.runfile.run_file import load_run
from framekit.service.run import RunService
from framekit.transport.clock import AsyncioClock

NAME = "Serve, read, run: READ of 10 words over TCP, CPU a read of server and client"
TARGET = (
    "serve ≤ 0.7 ×, read ≤ 0.8 ×, run ≤ 0.8 × pymodbus for modbus-tcp; both sides ≤ 1.2 × mldp, 1.5 × srtp, 2 × df1"
)
READS = 300
VALUES = list(range(1, 11))
PLACES = {
    "modbus-tcp": "40001",
    "modbus-rtu": "40001",
    "modbus-ascii": "40001",
    "ge-rtu": "40001",
    "mldp": "%MW100",
    "srtp": "%R1",
    "ccm": "%R1",
    "df1": "N7:0",
    "snp": "%R1",
    "snp-x": "%R1",
}
STATIONS: dict[str, dict[str, Any]] = {
    "srtp": {},
    "ccm": {"station": 1, "own": 2},
    "df1": {"station": 1, "role": "full"},
    "snp": {"params": {"use_break": "no"}},
    "snp-x": {"params": {"use_break": "no"}},
}
"""Roles and parameters by protocol; all others have stations, and request from station 1."""
FEW = {"snp": 20, "snp-x": 20}
"""Reads per round on lines that pause between messages."""
TARGETS = {("modbus-tcp", "serve"): 0.7, ("modbus-tcp", "read"): 0.8}
TARGETS |= {(name, "serve"): bound for name, bound in (("mldp", 1.2), ("srtp", 1.5), ("df1", 2.0))}
TARGETS |= {(name, "read"): bound for name, bound in (("mldp", 1.2), ("srtp", 1.5), ("df1", 2.0))}
THEIRS = """
import asyncio, sys
from pymodbus.datastore import ModbusDeviceContext, ModbusSequentialDataBlock, ModbusServerContext
from pymodbus.server import ModbusTcpServer

async def main():
    block = ModbusSequentialDataBlock(1, list(range(1, 200)))
    context = ModbusServerContext(devices=ModbusDeviceContext(hr=block), single=True)
    server = ModbusTcpServer(context, address=("127.0.0.1", 0))
    await server.listen()
    print(server.transport.sockets[0].getsockname()[1], flush=True)
    await asyncio.to_thread(sys.stdin.read)

asyncio.run(main())
"""


class ServerProcess:
    """A server in a process of its own, and its processor time."""

    def __init__(self, process: subprocess.Popen[str], port: int) -> None:
        self.port = port
        self._time = Path(f"/proc/{process.pid}/schedstat")

    def seconds(self) -> float:
        """Return the system's processor time for all its threads; the main thread does the work."""
        return int(self._time.read_text().split()[0]) / 1e9


@contextlib.contextmanager
def server_process(command: list[str]) -> Iterator[ServerProcess]:
    """Start the server; its first line ends with the port."""
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            line = process.stdout.readline()
            yield ServerProcess(process, int(line.split()[-1].rpartition(":")[2]))
        finally:
            process.terminate()


def framekit_server(protocol: str) -> list[str]:
    values = f"{PLACES[protocol]}={','.join(map(str, VALUES))}"
    serve = [sys.executable, "-m", "framekit", "serve", protocol, "--port", "tcp://127.0.0.1:0", "--set", values]
    settings = STATIONS.get(protocol, {})
    params = [word for name, value in settings.get("params", {}).items() for word in ("--param", f"{name}={value}")]
    return [*serve, "--quiet", *params, *(("--role", settings["role"]) if "role" in settings else ())]


Reads = Callable[[], Awaitable[None]]


def blocks_of(port: int, folder: Path) -> RunService:
    """Return a run with two READ blocks, each due when the other has ended, with a monitor of frames."""
    file = folder / "reads.run.yaml"
    blocks = "".join(
        f'  {at}: {{read: "40001", count: 10, channel: 1, into: D00{at}00, when: block {3 - at} done}}\n'
        for at in (1, 2)
    )
    channel = f"{{port: tcp://127.0.0.1:{port}, protocol: modbus-tcp, station: 1}}"
    text = f"run: reads\nmemory: masterlogic\nchannels:\n  1: {channel}\nblocks:\n{blocks}"
    file.write_text(text, encoding="utf-8")
    return RunService(load_run(file), AsyncioClock(asyncio.get_running_loop()), lambda channel, seen: None)


async def read_by_blocks(service: RunService) -> None:
    """Let the blocks read until they have made as many reads as the others."""

    def count() -> int:
        assert not any(state.failed for state in service.states.values())
        return sum(state.done for state in service.states.values())

    before = count()
    service.enable(2)
    service.fire(1)
    while count() < before + READS:
        await asyncio.sleep(0.002)
    service.enable(2, False)
    while (now := count()) != before:
        before = now
        await asyncio.sleep(0.005)
    assert service.memory.read("D", "word", 100, 10) == VALUES


def run(rounds: int) -> list[Row]:
    loop = asyncio.new_event_loop()
    sides: dict[str, ServerProcess] = {}
    clients: dict[str, Reads] = {}
    server_times: dict[str, list[float]] = {}

    def timed(name: str) -> Callable[[], float]:
        async def all_of_them() -> float:
            begin = time.process_time()
            await clients[name]()
            return (time.process_time() - begin) / FEW.get(name, READS)

        def measure() -> float:
            before = sides[name].seconds()
            took = asyncio.run_coroutine_threadsafe(all_of_them(), loop).result()
            server_times.setdefault(name, []).append((sides[name].seconds() - before) / FEW.get(name, READS))
            return took

        return measure

    async def everything(stack: ExitStack) -> dict[str, Any]:
        async with AsyncExitStack() as opened:
            theirs = AsyncModbusTcpClient("127.0.0.1", port=sides["pymodbus"].port)
            await theirs.connect()

            async def their_reads() -> None:
                for _ in range(READS):
                    reply = await theirs.read_holding_registers(0, count=10, device_id=1)
                assert reply.registers == VALUES

            clients["pymodbus"] = their_reads
            for name, place in PLACES.items():
                asking: dict[str, Any] = STATIONS.get(name, {"station": 1})
                line = framekit.aconnect(name, f"tcp://127.0.0.1:{sides[name].port}", **asking)
                clients[name] = reads_of(await opened.enter_async_context(line), place, FEW.get(name, READS))
            service = blocks_of(sides["modbus-tcp"].port, Path(stack.enter_context(TemporaryDirectory())))
            service.start()
            sides["run"] = sides["modbus-tcp"]
            clients["run"] = lambda: read_by_blocks(service)
            found = await asyncio.to_thread(interleave, {name: timed(name) for name in clients}, rounds)
            service.stop()
            theirs.close()
            return found

    with ExitStack() as stack:
        sides["pymodbus"] = stack.enter_context(server_process([sys.executable, "-c", THEIRS]))
        for name in PLACES:
            sides[name] = stack.enter_context(server_process(framekit_server(name)))
        read = loop.run_until_complete(everything(stack))
    loop.close()
    return table_of(read, server_times)


def reads_of(line: Any, place: str, count: int) -> Reads:
    """Read over a connection, one read after the other."""

    async def reads() -> None:
        for _ in range(count):
            reading = await line.read(place, 10)
        assert list(reading) == VALUES

    return reads


def table_of(read: dict[str, Timing], served: dict[str, list[float]]) -> list[Row]:
    """Return the rows of server and client for every protocol, and of the run."""
    servers = {name: Timing(tuple(times)) for name, times in served.items()}
    rows = []
    for side, times in (("serve", servers), ("read", read)):
        for name in PLACES:
            bound = TARGETS.get((name, side))
            target = None if bound is None else Target("at most", bound)
            rows.append(slower(f"{side} {name}", "pymodbus", times[name], times["pymodbus"], target))
    at_most = Target("at most", 0.8)
    rows.append(slower("run modbus-tcp, READ blocks, monitor", "pymodbus", read["run"], read["pymodbus"], at_most))
    return rows
