"""iec62056-21, an independent reader, with a simulated meter on a real socket, like a meter with a converter.

Skipped only if it is not installed.
"""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest
from peer_world import at_work, tcp_device

client = pytest.importorskip("iec62056_21.client", reason="iec62056-21 is not installed")

LINES = b"0.0(12345678)\r\n1.8.0(000123.4*kWh)\r\n2.8.0(000000.7*kWh)\r\n"
DEVICE = f"""
device: peer
protocol: iec62056-21
station: "12345678"
params: {{reaction: 20 ms, model: '\\2FK-1', readings: {LINES.hex(" ").upper()}}}
"""


def reading(number: int) -> None:
    reader = client.Iec6205621Client.with_tcp_transport(("127.0.0.1", number), device_address="12345678")
    reader.connect()
    try:
        for _ in range(2):
            found = reader.standard_readout()
            assert (reader.manufacturer_id, reader.identification) == ("ABC", "2FK-1"), "it passes the backslash over"
            assert reader.switchover_baudrate == 9600
            assert [(value.address, value.value, value.unit) for value in found.data] == [
                ("0.0", "12345678", None),
                ("1.8.0", "000123.4", "kWh"),
                ("2.8.0", "000000.7", "kWh"),
            ]
    finally:
        reader.disconnect()


def test_its_reader(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with tcp_device(tmp_path, DEVICE) as (number, _):
            await at_work(reading, number)

    asyncio.run(scenario())
