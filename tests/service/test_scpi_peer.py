"""PyVISA with pyvisa-py, an independent controller, with a simulated power supply on a real socket.

Skipped only if it is not installed.
"""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest
from peer_world import at_work, tcp_device

pyvisa = pytest.importorskip("pyvisa", reason="pyvisa is not installed")
pytest.importorskip("pyvisa_py", reason="pyvisa-py is not installed")

DEVICE = """
device: peer
protocol: scpi
params: {identity: "framekit,PS-1,42,1.0", curve: 00 0A 0D FF 23}
"""


def controlling(number: int) -> None:
    manager = pyvisa.ResourceManager("@py")
    try:
        supply = manager.open_resource(f"TCPIP::127.0.0.1::{number}::SOCKET", read_termination="\n", timeout=3000)
        supply.write_termination = "\n"
        assert supply.query("*IDN?") == "framekit,PS-1,42,1.0"
        assert supply.query("*esr?") == "128" and supply.query("*ESR?") == "0"
        supply.write("VOLT 12.5")
        supply.write("outp on")
        assert supply.query_ascii_values("MEASURE:VOLTAGE?") == [12.5]
        assert supply.query("OUTPUT?") == "1"
        supply.write("*ESE 48")
        supply.write("NOSUCH:THING 1")
        assert supply.query("*STB?") == "36"
        assert supply.query("SYST:ERR?") == '-113,"Undefined header"'
        assert supply.query("SYSTEM:ERROR?") == '0,"No error"'
        supply.write("VOLT twelve")
        assert supply.query("SYST:ERR?") == '-222,"Data out of range"'
        assert supply.query_binary_values("CURVE?", datatype="B") == [0, 10, 13, 255, 35]
        supply.write("*RST")
        assert supply.query_ascii_values("VOLT?") == [0]
        supply.close()
    finally:
        manager.close()


def test_it_controls_a_simulated_power_supply(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with tcp_device(tmp_path, DEVICE) as (number, _):
            await at_work(controlling, number)

    asyncio.run(scenario())
