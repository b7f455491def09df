"""pyMeterBus, an independent master, with a simulated meter on a real terminal.

Skipped only if it is not installed.
"""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import Any

import pytest
import serial
from peer_world import at_work, pty_device

from framekit.definition.times import LineFormat

meterbus = pytest.importorskip("meterbus", reason="pyMeterBus is not installed")

RECORDS = {
    "0C 13 27 04 85 02": 2850427 / 1000,  # m3, eight digits
    "02 5B 17 00": 23,  # flow temperature, 16 bits
    "04 06 E8 03 00 00": 1000e3,  # 1000 kWh in 32 bits, which it gives in Wh
    "84 10 06 F4 01 00 00": 500e3,  # the same of tariff 1: a DIFE
    "05 2B 00 00 20 41": 10.0,  # W, a float
    "04 FD 08 07 00 00 00": 7,  # access number: a VIFE
}
DEVICE = f"""
device: peer
protocol: m-bus
station: 5
params: {{meter_number: 0x87654321, meter_records: {" ".join(RECORDS)}, answer_delay: 0 ms}}
"""
LINE = LineFormat(9600, parity="E")


def answered(port: Any) -> Any:
    return meterbus.load(meterbus.recv_frame(port, 1))


def readout(path: str) -> None:
    with serial.Serial(path, 9600, parity="N", timeout=2) as port:
        meterbus.send_ping_frame(port, 5)
        assert isinstance(answered(port), meterbus.TelegramACK)
        for address in (5, 254, 5):
            meterbus.send_request_frame(port, address)
            telegram = answered(port)
            found = json.loads(telegram.to_JSON())["body"]
            assert found["header"]["identification"].replace(", ", "").replace("0x", "") == "87654321"
            assert (found["header"]["manufacturer"], found["header"]["medium"]) == ("ABC", "0x7")
            values = [float(record["value"]) for record in found["records"]]
            assert values == pytest.approx(list(RECORDS.values()))


def selection(path: str) -> None:
    with serial.Serial(path, 9600, parity="N", timeout=2) as port:
        meterbus.send_select_frame(port, "87654321FFFFFFFF")
        assert isinstance(answered(port), meterbus.TelegramACK)
        meterbus.send_request_frame(port, meterbus.ADDRESS_NETWORK_LAYER)
        assert len(answered(port).records) == len(RECORDS)
        port.timeout = 0.3
        for other in ("87654320FFFFFFFF", "8765432104430207"):
            meterbus.send_select_frame(port, other)
            assert not meterbus.recv_frame(port, 1)
            meterbus.send_request_frame(port, meterbus.ADDRESS_NETWORK_LAYER)
            assert not meterbus.recv_frame(port, 1)


@pytest.mark.parametrize("work", [readout, selection])
def test_its_master(tmp_path: Path, work: Any) -> None:
    async def scenario() -> None:
        async with pty_device(tmp_path, DEVICE, LINE) as (path, _):
            await at_work(work, path)

    asyncio.run(scenario())
