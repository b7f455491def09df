"""Channels of a run in an answering role serve the run's own memory: several protocols look at the same words."""

from __future__ import annotations

import asyncio
import os
import select
from pathlib import Path

from framekit.blocks.load import load_run
from framekit.service.run import RunService
from framekit.transport.clock import AsyncioClock
from framekit.transport.pty_pair import PtyPair

LONGEST = 20
RUN = """
run: serving
memory: masterlogic
channels:
  1: {{port: {first}, protocol: mldp, role: server, own: 1}}
  2: {{port: {second}, protocol: modbus-rtu, role: server, own: 3, map: {{holding: M100, coil: M200}}}}
set: {{M100: [0x1234, 0x5678]}}
blocks: {{}}
"""
MLDP_READ = b"\x0501RSB06%MW10002\x04"


def crc(data: bytes) -> bytes:
    value = 0xFFFF
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ (0xA001 if value & 1 else 0)
    return data + value.to_bytes(2, "little")


def asked(path: str, request: bytes, size: int) -> bytes:
    descriptor = os.open(path, os.O_RDWR | os.O_NOCTTY)
    try:
        os.write(descriptor, request)
        reply = b""
        while len(reply) < size and select.select([descriptor], [], [], LONGEST)[0]:
            reply += os.read(descriptor, 256)
        return reply
    finally:
        os.close(descriptor)


def test_two_channels_serve_one_memory(tmp_path: Path) -> None:
    async def scenario() -> None:
        with PtyPair() as one, PtyPair() as other:
            path = tmp_path / "serving.run.yaml"
            path.write_text(RUN.format(first=one.first, second=other.first), "utf-8")
            opened = asyncio.Event()
            states: set[int] = set()

            def seen(channel: int, what: object) -> None:
                states.add(channel)
                if states == {1, 2}:
                    opened.set()

            service = RunService(load_run(path), AsyncioClock(asyncio.get_running_loop()), seen)
            service.start()
            try:
                await opened.wait()
                reply = await asyncio.to_thread(asked, other.second, crc(bytes.fromhex("03 03 0000 0002")), 9)
                assert reply == crc(bytes.fromhex("03 03 04 1234 5678"))
                written = await asyncio.to_thread(asked, other.second, crc(bytes.fromhex("03 06 0001 BEEF")), 8)
                assert written == crc(bytes.fromhex("03 06 0001 BEEF"))
                await asyncio.to_thread(asked, other.second, crc(bytes.fromhex("03 05 000A FF00")), 8)
                reply = await asyncio.to_thread(asked, one.second, MLDP_READ, 19)
                assert reply == b"\x0601RSB01041234BEEF\x03"
                reply = await asyncio.to_thread(asked, one.second, b"\x0501RSS0106%MW200\x04", 15)
                assert reply == b"\x0601RSS01020400\x03", "coil 11 is bit A of M200"
                assert service.memory.read("M", "word", 101) == [0xBEEF]
            finally:
                service.stop()

    asyncio.run(asyncio.wait_for(scenario(), LONGEST))
