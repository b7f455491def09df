"""omniplc, an independent client, with simulated controllers: 1C frames of MELSEC on a terminal, MEWTOCOL on TCP.

Skipped only if it is not installed.
"""

from __future__ import annotations

import asyncio
from pathlib import Path
from random import Random
from typing import Any

import pytest
from peer_world import at_work, pty_device, tcp_device

from framekit.definition.times import parse_format

omniplc = pytest.importorskip("omniplc", reason="omniplc is not installed")
MELSEC = """
device: peer
protocol: melsec-mc-1c
station: 3
params: {line_ends: yes}
memory: {set: {D100: [0x1234, 0xFFFE], M10: [1, 0, 1], X1F: 1, TS5: 1}, sizes: {R0: 100}}
"""
MEWTOCOL = """
device: peer
protocol: mewtocol
station: 1
memory: {set: {R10F: 1, X0A: 1, T5: 1, DT100: [0x1234, 2], LD5: 7}}
"""


def test_1c_frames_of_format_4(tmp_path: Path) -> None:
    kinds = omniplc.DataType

    def work(path: str) -> None:
        client = omniplc.MelsecMcSerialClient("1C", 3)
        client.configure_serial(path, 9600, 8, 1, "N")
        assert client.connect()
        assert client.read("D100", kinds.USHORT) == (True, 0x1234)
        assert client.read("D101", kinds.SHORT) == (True, -2)
        bits = [client.read(name, kinds.BOOL) for name in ("M10", "M11", "M12", "X1F", "T5")]
        assert bits == [(True, on) for on in (True, False, True, True, True)]
        random = Random(1)
        values = [random.randrange(1 << 64) for _ in range(16)]  # four words each, the low one first
        assert all(client.write(f"D{1000 + 4 * place}", kinds.ULONG, value) for place, value in enumerate(values))
        assert client.read_range("D1000", 16, kinds.ULONG) == (True, values)
        assert client.write("M320", kinds.BOOL, True) and client.write("Y2F", kinds.BOOL, True)
        assert client.read("R200", kinds.USHORT) == (False, None) and client.last_error_code == 6
        client.disconnect()

    async def scenario() -> None:
        async with pty_device(tmp_path, MELSEC, parse_format("8N1", 9600)) as (path, serving):
            await at_work(work, path)
            memory = serving.stores[0].memory
            assert memory.read("M", "bit", 319, 3) == [0, 1, 0] and memory.read("Y", "bit", 0x2E, 3) == [0, 1, 0]

    asyncio.run(scenario())


def test_contacts_of_mewtocol(tmp_path: Path) -> None:
    """Frames, contacts and refusals; in its words, the bytes are swapped compared with the manual's example."""

    def work(number: int) -> None:
        kinds = omniplc.DataType
        client: Any = omniplc.PanasonicMewtocolTcpClient("127.0.0.1", number, 1)
        assert client.connect()
        bits = [client.read(name, kinds.BOOL) for name in ("R10F", "R10E", "X000A", "T05")]
        assert bits == [(True, True), (True, False), (True, True), (True, True)]
        assert client.write("R20A", kinds.BOOL, True) and client.write("Y1F", kinds.BOOL, True)
        assert client.read("D100", kinds.USHORT) == (True, 0x3412)
        assert client.read("L5", kinds.USHORT) == (True, 0x0700)
        assert client.write("D200", kinds.USHORT, 0x0102)
        assert client.read("S3", kinds.USHORT) == (False, None) and client.last_error_code == 60  # it asks RD for RS
        client.disconnect()

    async def scenario() -> None:
        async with tcp_device(tmp_path, MEWTOCOL) as (number, serving):
            await at_work(work, number)
            memory = serving.stores[0].memory
            assert memory.read("R", "bit", 20 * 16 + 10, 1) == memory.read("Y", "bit", 16 + 15, 1) == [1]
            assert memory.read("DT", "word", 200, 1) == [0x0201]

    asyncio.run(scenario())
