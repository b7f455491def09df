"""64 channels that poll at once in one process, compared with a channel that polls 64 times as often: CPU per poll."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable

import framekit
from benchmarks.measure import interleave
from benchmarks.responder import VALUES, responder
from benchmarks.row import Row, Target, slower

NAME = "64 channels at once, one process"
TARGET = "CPU a poll not higher than that of one channel × 64"
CHANNELS = 64
POLLS = 10


async def poll(client: framekit.AsyncClient, count: int) -> None:
    for _ in range(count):
        reading = await client.read("40001", 10)
    assert reading == VALUES


def run(rounds: int) -> list[Row]:
    loop = asyncio.new_event_loop()
    with responder() as port:
        return loop.run_until_complete(_measure(port, rounds))


async def _measure(port: int, rounds: int) -> list[Row]:
    loop = asyncio.get_running_loop()
    async with contextlib.AsyncExitStack() as stack:
        clients = [
            await stack.enter_async_context(framekit.aconnect("modbus-tcp", f"tcp://127.0.0.1:{port}", station=1))
            for _ in range(CHANNELS)
        ]

        async def at_once() -> float:
            begin = time.process_time()
            await asyncio.gather(*(poll(client, POLLS) for client in clients))
            return (time.process_time() - begin) / (CHANNELS * POLLS)

        async def one() -> float:
            begin = time.process_time()
            await poll(clients[0], CHANNELS * POLLS)
            return (time.process_time() - begin) / (CHANNELS * POLLS)

        def done(work: Callable[[], object]) -> Callable[[], float]:
            return lambda: asyncio.run_coroutine_threadsafe(work(), loop).result()  # type: ignore[arg-type]

        times = await asyncio.to_thread(interleave, {"64 at once": done(at_once), "one": done(one)}, rounds)
    return [slower("a poll of 64 at once", "one × 64", times["64 at once"], times["one"], Target("at most", 1.0))]
