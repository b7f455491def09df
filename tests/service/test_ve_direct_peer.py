"""vedirect, an independent implementation, reads the text blocks of a simulated charger on a real terminal.

Skipped only if it is not installed.
"""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest
import serial
from peer_world import at_work, pty_device

from framekit.definition.times import LineFormat

vedirect = pytest.importorskip("vedirect", reason="vedirect is not installed")

DEVICE = """
device: peer
protocol: ve-direct
params: {interval: 100 ms, battery: 13280, serial: HQ1234ABCDE}
"""
LINE = LineFormat(19200)


def charger(path: str) -> None:
    for _ in range(3):
        found = vedirect.VEDirect(path)
        assert (found.battery_volts, found.solar_volts, found.solar_power) == (13.28, 33.47, 112.0)
        assert (found.device_serial, found.device_MPPT_state) == ("HQ1234ABCDE", vedirect.MPPTState.Active)
    with serial.Serial(path, 19200, timeout=2) as port:  # the HEX messages of the manual, between its text blocks
        port.write(b":8F0ED0064000C\n:7F0ED0071\n")
        found = b""
        while found.count(b":") < 2 or not found.endswith(b"\n"):
            found += port.read(1)
        assert b":8F0ED0064000C\n" in found and b":7F0ED006400" in found


def test_it_reads_a_simulated_charger(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with pty_device(tmp_path, DEVICE, LINE) as (path, _):
            await at_work(charger, path)

    asyncio.run(scenario())
