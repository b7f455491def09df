"""A channel with endless noise does not block other channels or signals: the handled pieces are counted."""

from __future__ import annotations

import asyncio
import os
import signal
import socket
from pathlib import Path
from random import Random

import pytest

from framekit.runfile.run_file import load_run
from framekit.service.run import RunService
from framekit.transport.clock import MOST, AsyncioClock, Callback, Turns

LONGEST = 180
FEW = 40
"""Largest number of pieces of noise that may be handled before other work; the flood has hundreds."""

RUN = """
run: flooded
memory: masterlogic
channels:
  1: {{port: "tcp://127.0.0.1:{noisy}", protocol: {protocol}, role: server, own: 3, map: {{holding: M100}}}}
  2: {{port: "tcp://127.0.0.1:{asking}", protocol: modbus-tcp, role: server, own: 1, map: {{holding: M100}}}}
set: {{M100: [0x1234]}}
blocks: {{}}
"""
READ = bytes.fromhex("0001 0000 0006 01 03 0000 0001")
REPLY = bytes.fromhex("0001 0000 0005 01 03 02 1234")


class Counted(Turns):
    """Count the pieces that connections take, and the most work of a turn."""

    pieces = most = 0

    def take(self, size: int, callback: Callback) -> bool:
        def counted() -> None:
            self.pieces += 1
            self.most = max(self.most, self.used)
            callback()

        return super().take(size, counted)


class Counting(AsyncioClock):
    """A clock whose turns are counted."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        super().__init__(loop)
        self.turns = self.counted = Counted(loop)

    @property
    def pieces(self) -> int:
        return self.counted.pieces


def free_port() -> int:
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


async def connected(port: int) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    while True:
        try:
            return await asyncio.open_connection("127.0.0.1", port)
        except ConnectionRefusedError:
            await asyncio.sleep(0)


async def flood(writer: asyncio.StreamWriter) -> None:
    noise = Random(3).randbytes(100_000)
    while True:
        writer.write(noise)
        await writer.drain()


async def scenario(folder: Path) -> None:
    loop = asyncio.get_running_loop()
    noisy_port, asking_port = free_port(), free_port()
    path = folder / "flooded.run.yaml"
    path.write_text(RUN.format(noisy=noisy_port, asking=asking_port, protocol="modbus-rtu"), "utf-8")
    clock = Counting(loop)
    service = RunService(load_run(path), clock, lambda channel, seen: None)
    service.start()
    reader, writer = await connected(asking_port)
    flooding = asyncio.create_task(flood((await connected(noisy_port))[1]))
    try:
        while clock.pieces < 20:
            await asyncio.sleep(0)
        for _ in range(5):
            before = clock.pieces
            writer.write(READ)
            assert await reader.readexactly(len(REPLY)) == REPLY
            assert clock.pieces - before < FEW
        stopped: asyncio.Future[int] = loop.create_future()
        loop.add_signal_handler(signal.SIGTERM, lambda: stopped.set_result(clock.pieces))
        before = clock.pieces
        os.kill(os.getpid(), signal.SIGTERM)
        assert await stopped - before < FEW
        before = clock.pieces
        service.stop()
        for _ in range(50):
            await asyncio.sleep(0)
        assert clock.pieces == before, "nothing is heard any more"
    finally:
        loop.remove_signal_handler(signal.SIGTERM)
        flooding.cancel()
        service.stop()


def test_another_channel_and_a_signal_have_their_turn_while_noise_comes(tmp_path: Path) -> None:
    asyncio.run(asyncio.wait_for(scenario(tmp_path), LONGEST))


CROWD = 120
"""Number of clients that send at once; the other channel waits for each about once, however much they send."""

ASKED = """
run: crowded
memory: masterlogic
channels:
  1: {{port: "tcp-listen://127.0.0.1:{crowded}", protocol: {protocol}, role: server, own: 3, map: {{holding: M100}}, clients: {{connections: 256}}}}
  2: {{port: "tcp-listen://127.0.0.1:{asking}", protocol: modbus-tcp, role: server, own: 1, map: {{holding: M100}}}}
set: {{M100: [0x1234]}}
blocks: {{}}
"""  # noqa: E501


async def crowd(folder: Path, protocol: str, data: bytes) -> None:
    loop = asyncio.get_running_loop()
    crowded, asking = free_port(), free_port()
    path = folder / "crowded.run.yaml"
    path.write_text(ASKED.format(crowded=crowded, asking=asking, protocol=protocol), "utf-8")
    clock = Counting(loop)
    service = RunService(load_run(path), clock, lambda channel, seen: None)
    service.start()
    clients: list[asyncio.StreamWriter] = []
    try:
        reader, writer = await connected(asking)
        clients += [(await connected(crowded))[1] for _ in range(CROWD)]
        for client in clients:
            client.write(data * (4000 // len(data)))
        while clock.pieces < 2 * CROWD:
            await asyncio.sleep(0)
        for _ in range(3):
            before = clock.pieces
            writer.write(READ)
            assert await reader.readexactly(len(REPLY)) == REPLY
            assert clock.pieces - before < 2 * CROWD, "none of the others has had many turns"
        assert clock.counted.most <= MOST
    finally:
        for client in clients:
            client.transport.abort()
        service.stop()


@pytest.mark.parametrize("protocol", ["modbus-tcp", "modbus-rtu"])
@pytest.mark.parametrize("data", [READ, Random(3).randbytes(1000)], ids=["requests", "noise"])
def test_many_clients_at_once_share_a_turn_and_leave_another_channel_its_own(
    protocol: str, data: bytes, tmp_path: Path
) -> None:
    asyncio.run(asyncio.wait_for(crowd(tmp_path, protocol, data), LONGEST))
