"""dynamixel-sdk, an independent master, with a simulated drive on a real terminal.

Skipped only if it is not installed. Its byte stuffing has a bug: `txPacket` discards the stuffed packet and sends the
plain packet, so a header inside the content is transmitted unchanged.
"""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest
from peer_world import at_work, pty_device

from framekit.definition.times import LineFormat

sdk = pytest.importorskip("dynamixel_sdk", reason="dynamixel-sdk is not installed")

DEVICE = """
device: peer
protocol: dynamixel
station: 1
memory: {set: {T132: [166, 1, 0, 0], T200: [255, 255, 253, 1, 255, 255, 253, 253]}}
"""
LINE = LineFormat(57600)
GOOD = (sdk.COMM_SUCCESS, 0)


def opened(path: str) -> tuple[Any, Any]:
    port, packets = sdk.PortHandler(path), sdk.PacketHandler(2.0)
    sdk.port_handler.LATENCY_TIMER = (
        5000  # ms: it waits for a reply by the clock on the wall, on a machine that may be busy
    )
    assert port.openPort() and port.setBaudRate(57600)
    return port, packets


def reading_and_writing(path: str) -> None:
    port, packets = opened(path)
    try:
        assert packets.ping(port, 1) == (1060, *GOOD)
        assert packets.read4ByteTxRx(port, 1, 132) == (0x1A6, *GOOD)
        assert packets.write4ByteTxRx(port, 1, 116, 0x01020304) == GOOD
        assert packets.read4ByteTxRx(port, 1, 116) == (0x01020304, *GOOD)
        assert packets.write1ByteTxRx(port, 1, 64, 1) == GOOD
        assert packets.read1ByteTxRx(port, 1, 64) == (1, *GOOD)
        assert packets.write2ByteTxRx(port, 1, 1023, 1) == (sdk.COMM_SUCCESS, 4), "beyond the table: data range error"
        assert packets.reboot(port, 1) == GOOD
        assert packets.ping(port, 2)[1] == sdk.COMM_RX_TIMEOUT
    finally:
        port.closePort()


def stuffing(path: str) -> None:
    port, packets = opened(path)
    try:
        found = packets.readTxRx(port, 1, 200, 8)
        assert found == ([255, 255, 253, 1, 255, 255, 253, 253], *GOOD), "what a drive has stuffed is read as it was"
        sent: list[bytes] = []
        write, port.writePort = port.writePort, lambda packet: sent.append(bytes(packet)) or write(packet)
        packets.writeTxRx(port, 1, 300, 5, [255, 255, 253, 1, 2])
        assert sent[0].find(bytes([255, 255, 253]), 4) > 0 and sent[0].find(bytes([255, 255, 253, 253])) < 0
    finally:
        port.closePort()


@pytest.mark.long
@pytest.mark.parametrize("work", [reading_and_writing, stuffing])
def test_its_master(tmp_path: Path, work: Any) -> None:
    async def scenario() -> None:
        async with pty_device(tmp_path, DEVICE, LINE) as (path, _):
            await at_work(work, path)

    asyncio.run(scenario())
