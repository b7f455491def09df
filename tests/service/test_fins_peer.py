"""fins, an independent client, with a simulated controller on real TCP. Skipped only if it is not installed."""

from __future__ import annotations

import asyncio
from pathlib import Path
from random import Random
from typing import Any

import pytest
from peer_world import at_work, tcp_device

tcp = pytest.importorskip("fins.tcp", reason="fins is not installed")
common = pytest.importorskip("fins.fins_common", reason="fins is not installed")

DEVICE = """
device: peer
protocol: fins-tcp
params: {model: CJ2M-CPU33}
memory:
  sizes: {CIO0: 64}
  set: {D100: [4660, 2, 0xFFFE], D110: [0, 0x4148], CIO10.05: 1, T7: 99, C7: 98, W3: 7, H4: 8}
"""
AREAS = common.FinsPLCMemoryAreas()


def connected(number: int) -> Any:
    client = tcp.TCPFinsConnection()
    client.connect("127.0.0.1", port=number)
    return client


def answer(data: bytes) -> tuple[bytes, bytes]:
    """Return the end code and the text of a response."""
    frame = common.FinsResponseFrame()
    frame.from_bytes(data)
    return frame.end_code, frame.text


def words_and_bits(number: int) -> None:
    client = connected(number)
    assert (client.srce_node_add, client.dest_node_add) == (239, 1)
    assert client.read("d", 100, "i", 3) == [4660, 2, -2]
    assert client.read("d", 110, "r") == 12.5
    assert (client.read("w", 3, "ui"), client.read("h", 4, "ui")) == (7, 8)
    assert client.write([1, -1, 32767], "d", 300, "i").end_code == bytes(2)
    assert client.read("d", 300, "i", 3) == [1, -1, 32767]
    assert client.write(-1.5, "w", 20, "l").end_code == bytes(2)
    assert client.read("w", 20, "l") == -1.5
    assert answer(client.memory_area_read(AREAS.CIO_BIT, bytes([0, 10, 4]), 3)) == (bytes(2), bytes([0, 1, 0]))
    assert answer(client.memory_area_write(AREAS.CIO_BIT, bytes([0, 10, 15]), b"\1\1", 2)) == (bytes(2), b"")
    assert answer(client.memory_area_read(AREAS.CIO_WORD, bytes([0, 10, 0]), 2)) == (bytes(2), b"\x80\x20\0\1")
    assert answer(client.memory_area_read(AREAS.TIMER_WORD, bytes([0, 7, 0]))) == (bytes(2), bytes([0, 99]))
    assert answer(client.memory_area_read(AREAS.COUNTER_WORD, bytes([0x80, 7, 0]))) == (bytes(2), bytes([0, 98]))
    random = Random(1)
    for _ in range(20):
        values = [random.randrange(65536) for _ in range(random.randrange(2, 400))]
        assert client.write(values, "d", 1000, "ui").end_code == bytes(2)
        assert client.read("d", 1000, "ui", len(values)) == values


def the_rest(number: int) -> None:
    client = connected(number)
    code, text = answer(client.cpu_unit_data_read())
    assert (code, text[:20]) == (bytes(2), b"CJ2M-CPU33".ljust(20))
    assert answer(client.cpu_unit_status_read())[1][:2] == b"\1\4"
    assert answer(client.change_to_program_mode()) == (bytes(2), b"")
    assert answer(client.cpu_unit_status_read())[1][:2] == b"\0\0"
    assert answer(client.change_to_run_mode())[0] == bytes(2)
    assert answer(client.memory_area_read(AREAS.CIO_WORD, bytes([0, 60, 0]), 5))[0] == b"\x11\x04"
    assert answer(client.memory_area_read(b"\x55"))[0] == b"\x11\x01"
    assert answer(client.program_area_read(0))[0] == b"\x04\x01"


@pytest.mark.parametrize("work", [words_and_bits, the_rest])
def test_its_client(tmp_path: Path, work: Any) -> None:
    async def scenario() -> None:
        async with tcp_device(tmp_path, DEVICE) as (number, _):
            await at_work(work, number)

    asyncio.run(scenario())
