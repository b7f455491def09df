"""READ of 10 registers over TCP loopback, one after the other: CPU time of this process per poll.

The bare client below sends the same bytes and makes the same checks only: the next request is sent from the callback of
the last reply. framekit's poll loop is `client.poll`; a loop of `await client.read(…)` and two READ blocks of a run
that start each other are measured, too. All share one event loop and one responder in another process.
"""

from __future__ import annotations

import asyncio
import struct
import time
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from pymodbus.client import AsyncModbusTcpClient

import framekit
from benchmarks.measure import interleave
from benchmarks.responder import VALUES, responder
from benchmarks.row import Row, Target, slower
from framekit.runfile.run_file import load_run
from framekit.service.run import RunService
from framekit.transport.clock import AsyncioClock

NAME = "Poll loop: READ of 10 registers over TCP loopback, CPU a poll"
TARGET = "≤ 1.3 × bare asyncio; ≤ 0.6 × pymodbus"
POLLS = 2000
HEAD = struct.Struct(">HHHBBB")
REPLY = struct.Struct(">9x10H")
REPLY_SIZE = 29

Polls = Callable[[], Awaitable[int | None]]
"""A function that polls `POLLS` times, or returns its number of polls."""


class BareClient(asyncio.Protocol):
    """A hand-written client with the same request and checks.

    It sends the next request from the callback of the last reply.
    """

    def __init__(self) -> None:
        self.transaction = 0
        self.received = b""
        self.left = 0
        self.values: list[int] = []

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self.transport = transport

    async def polls(self) -> None:
        self.left = POLLS
        self.done = asyncio.get_running_loop().create_future()
        self.ask()
        await self.done
        assert self.values == VALUES

    def ask(self) -> None:
        self.transaction = self.transaction + 1 & 0xFFFF
        self.transport.write(struct.pack(">HHHBBHH", self.transaction, 0, 6, 1, 3, 0, 10))

    def data_received(self, data: bytes) -> None:
        self.received += data
        if len(self.received) < REPLY_SIZE:
            return
        reply, self.received = self.received, b""
        if len(reply) != REPLY_SIZE or HEAD.unpack_from(reply) != (self.transaction, 0, 23, 1, 3, 20):
            raise ValueError(f"no such reply was expected: {reply.hex(' ')}")
        self.values = list(REPLY.unpack(reply))
        self.left -= 1
        if self.left:
            self.ask()
        else:
            self.done.set_result(None)


class ReadingBlocks:
    """A run with two READ blocks, each of which is due when the other has ended."""

    def __init__(self, port: int, folder: Path) -> None:
        file = folder / "poll.run.yaml"
        blocks = "".join(
            f'  {at}: {{read: "40001", count: 10, channel: 1, into: D00{at}00, when: block {3 - at} done}}\n'
            for at in (1, 2)
        )
        file.write_text(
            "run: poll\nmemory: masterlogic\nchannels:\n"
            f"  1: {{port: tcp://127.0.0.1:{port}, protocol: modbus-tcp, station: 1}}\nblocks:\n{blocks}",
            encoding="utf-8",
        )
        self.service = RunService(load_run(file), AsyncioClock(asyncio.get_running_loop()))
        self.service.start()

    def _count(self) -> int:
        """Return the number of finished reads; assert that all succeeded."""
        assert not any(state.failed for state in self.service.states.values())
        return sum(state.done for state in self.service.states.values())

    async def polls(self) -> int:
        """Let them read for a while; return the number of polls."""
        before = self._count()
        self.service.enable(2)
        self.service.fire(1)
        while self._count() < before + POLLS:
            await asyncio.sleep(0.01)
        self.service.enable(2, False)
        await asyncio.sleep(0.01)
        assert self.service.memory.read("D", "word", 100, 10) == VALUES
        return self._count() - before


@contextmanager
def reading_blocks(port: int) -> Iterator[ReadingBlocks]:
    with TemporaryDirectory() as folder:
        blocks = ReadingBlocks(port, Path(folder))
        yield blocks
        blocks.service.stop()


async def clients(port: int, measure: Callable[[dict[str, Polls]], Awaitable[None]]) -> None:
    """Open all three clients; close them when `measure` is done."""
    transport, bare = await asyncio.get_running_loop().create_connection(BareClient, "127.0.0.1", port)
    theirs = AsyncModbusTcpClient("127.0.0.1", port=port)
    await theirs.connect()
    async with framekit.aconnect("modbus-tcp", f"tcp://127.0.0.1:{port}", station=1) as ours:

        async def framekit_polls() -> None:
            for _ in range(POLLS):
                reading = await ours.read("40001", 10)
            assert reading == VALUES

        async def pymodbus_polls() -> None:
            for _ in range(POLLS):
                reply = await theirs.read_holding_registers(0, count=10, device_id=1)
            assert reply.registers == VALUES

        async def framekit_poll() -> None:
            remaining = POLLS
            last: tuple[int, ...] = ()

            def take(values: tuple[int, ...]) -> None:
                nonlocal remaining, last
                remaining, last = remaining - 1, values
                if not remaining:
                    poll.stop()

            poll = ours.poll("40001", 10, on_values=take)
            await poll
            assert list(last) == VALUES

        with reading_blocks(port) as blocks:
            await measure(
                {
                    "client.poll": framekit_poll,
                    "await client.read": framekit_polls,
                    "READ blocks": blocks.polls,
                    "bare asyncio": bare.polls,
                    "pymodbus": pymodbus_polls,
                }
            )
    theirs.close()
    transport.close()


def run(rounds: int) -> list[Row]:
    loop = asyncio.new_event_loop()
    rows: list[Row] = []

    def timed(polls: Polls) -> Callable[[], float]:
        async def all_of_them() -> float:
            begin = time.process_time()
            count = await polls()
            return (time.process_time() - begin) / (count or POLLS)

        return lambda: asyncio.run_coroutine_threadsafe(all_of_them(), loop).result()

    async def measure(found: dict[str, Polls]) -> None:
        functions = {name: timed(polls) for name, polls in found.items()}
        times = await asyncio.to_thread(interleave, functions, rounds)
        for what in ("client.poll", "await client.read", "READ blocks"):
            for other, bound in (("bare asyncio", 1.3), ("pymodbus", 0.6)):
                rows.append(slower(what, other, times[what], times[other], Target("at most", bound)))

    with responder() as port:
        loop.run_until_complete(clients(port, measure))
    loop.close()
    return rows
