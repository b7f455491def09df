"""READ of 10 registers over TCP loopback, one after the other: CPU time of this process a poll.

The bare client below sends the same bytes and makes the same checks, and nothing else. All three share one event loop
and one responder in another process.
"""

from __future__ import annotations

import asyncio
import struct
import time
from collections.abc import Awaitable, Callable

from pymodbus.client import AsyncModbusTcpClient

import framekit
from benchmarks.measure import interleave
from benchmarks.responder import VALUES, responder
from benchmarks.row import Row, Target, slower

NAME = "Poll loop: READ of 10 registers over TCP loopback, CPU a poll"
TARGET = "≤ 1.3 × bare asyncio; ≤ 0.6 × pymodbus"
POLLS = 400
HEAD = struct.Struct(">HHHBBB")
REPLY = struct.Struct(">9x10H")
REPLY_SIZE = 29

Polls = Callable[[], Awaitable[None]]


class BareClient(asyncio.Protocol):
    """The same request and the same checks by hand: the next request goes out from the callback of the last reply."""

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


async def clients(port: int, measure: Callable[[dict[str, Polls]], Awaitable[None]]) -> None:
    """Opens all three, and closes them when `measure` is done."""
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

        await measure({"framekit": framekit_polls, "bare asyncio": bare.polls, "pymodbus": pymodbus_polls})
    theirs.close()
    transport.close()


def run(rounds: int) -> list[Row]:
    loop = asyncio.new_event_loop()
    rows: list[Row] = []

    def timed(polls: Polls) -> Callable[[], float]:
        async def all_of_them() -> float:
            begin = time.process_time()
            await polls()
            return (time.process_time() - begin) / POLLS

        return lambda: asyncio.run_coroutine_threadsafe(all_of_them(), loop).result()

    async def measure(found: dict[str, Polls]) -> None:
        functions = {name: timed(polls) for name, polls in found.items()}
        times = await asyncio.to_thread(interleave, functions, rounds)
        for other, bound in (("bare asyncio", 1.3), ("pymodbus", 0.6)):
            rows.append(slower("poll", other, times["framekit"], times[other], Target("at most", bound)))

    with responder() as port:
        loop.run_until_complete(clients(port, measure))
    loop.close()
    return rows
