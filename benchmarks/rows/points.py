"""Points read periodically over TCP loopback: CPU time of this process for one reading.

Twenty points of one device are joined to one request; 200 points of 20 devices are 20 requests. The loop by hand, over
pymodbus's client, does the same work: one task for each device sleeps until the next period, reads, scales each
register and keeps value, quality and time. The responder sends other values in each reply.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from pymodbus.client import AsyncModbusTcpClient

from benchmarks.measure import interleave
from benchmarks.responder import responder
from benchmarks.row import Row, slower
from framekit.runfile.run_file import load_run
from framekit.service.run import RunService
from framekit.transport.clock import AsyncioClock

NAME = "Points: 20 of one device, 200 of 20 devices, read over TCP loopback, CPU a reading"
TARGET = "no target; against a hand-written loop over pymodbus"
SHAPES = {"20 points, 1 device, every 2 ms": (1, 20, 2), "200 points, 20 devices, every 20 ms": (20, 10, 20)}
"""The number of devices, the points of each, and the period in ms."""
SECONDS = 1.0
"""The time in which readings are counted, after `WARM`."""
WARM = 0.3
SCALE = 0.1

Count = Callable[[], int]
"""The number of readings so far."""
Reader = Callable[[int, int, int, int], AbstractAsyncContextManager[Count]]


def run_file(port: int, devices: int, each: int, period: int) -> str:
    channels = "".join(
        f"  {device}: {{port: tcp://127.0.0.1:{port}, protocol: modbus-tcp, station: 1}}\n"
        for device in range(1, devices + 1)
    )
    points = "".join(
        f'  d{device}p{place}: {{channel: {device}, address: "{40001 + place}", scale: {SCALE}, every: {period} ms}}\n'
        for device in range(1, devices + 1)
        for place in range(each)
    )
    return f"run: points\nchannels:\n{channels}points:\n{points}"


@asynccontextmanager
async def run_of_points(port: int, devices: int, each: int, period: int) -> AsyncIterator[Count]:
    """Read the points by a run."""
    with TemporaryDirectory() as folder:
        file = Path(folder) / "points.run.yaml"
        file.write_text(run_file(port, devices, each, period), encoding="utf-8")
        service = RunService(load_run(file), AsyncioClock(asyncio.get_running_loop()))
        service.start()
        try:
            yield lambda: sum(channel.engine.counters.received for channel in service.channels.values())
        finally:
            service.stop()


@asynccontextmanager
async def loop_by_hand(port: int, devices: int, each: int, period: int) -> AsyncIterator[Count]:
    """Read the points by tasks over pymodbus's client."""
    loop = asyncio.get_running_loop()
    done, is_over = 0, False
    points: dict[str, tuple[float, str, int]] = {}

    async def read(device: int, client: AsyncModbusTcpClient) -> None:
        nonlocal done
        due = loop.time()
        while not is_over:
            reply = await client.read_holding_registers(0, count=each, device_id=1)
            now = time.time_ns()
            for place, value in enumerate(reply.registers):
                points[f"d{device}p{place}"] = value * SCALE, "good", now
            done += 1
            due = max(due + period / 1000, loop.time())
            await asyncio.sleep(due - loop.time())

    clients = [AsyncModbusTcpClient("127.0.0.1", port=port) for _ in range(devices)]
    for client in clients:
        await client.connect()
    tasks = [asyncio.create_task(read(device, client)) for device, client in enumerate(clients, start=1)]
    try:
        yield lambda: done
    finally:
        is_over = True  # a cancelled request of pymodbus does not end
        await asyncio.gather(*tasks)
        for client in clients:
            client.close()


def measure(
    reader: Reader,
    port: int,
    shape: tuple[int, int, int],
    make_loop: Callable[[], asyncio.AbstractEventLoop] = asyncio.new_event_loop,
) -> float:
    """Return the processor time of a reading (seconds)."""

    async def measured() -> float:
        async with reader(port, *shape) as count:
            await asyncio.sleep(WARM)
            begin, before = time.process_time(), count()
            await asyncio.sleep(SECONDS)
            took, readings = time.process_time() - begin, count() - before
            assert readings > SECONDS * 1000 / shape[2] / 10, f"{readings} readings"
            return took / readings

    with asyncio.Runner(loop_factory=make_loop) as runner:
        return runner.run(measured())


def run(rounds: int) -> list[Row]:
    rows = []
    with contextlib.ExitStack() as stack:
        port = stack.enter_context(responder("counting"))
        for what, shape in SHAPES.items():
            readers = {"run": run_of_points, "by hand": loop_by_hand}
            measures = {
                name: (lambda reader=reader, shape=shape: measure(reader, port, shape))
                for name, reader in readers.items()
            }
            found = interleave(measures, rounds)
            rows.append(slower(what, "loop over pymodbus", found["run"], found["by hand"], None))
    return rows
