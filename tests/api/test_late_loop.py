"""A blocked process: simulated time continues as if the process had not been blocked."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
from api_world import device_file

import framekit
from framekit.transport import clock as clocks

MS = 1_000_000


@pytest.mark.parametrize("faults", ["", "faults: slow\nrules: [{fault: delay, time: 100 ms}]\n"])
def test_a_simulated_device_answers_in_time_however_late_the_loop_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, faults: str
) -> None:
    device = device_file(tmp_path)
    if faults:
        (tmp_path / "slow.faults.yaml").write_text(faults, encoding="utf-8")
        device.write_text(device.read_text(encoding="utf-8") + "faults: slow.faults.yaml\n", encoding="utf-8")
    lost = [0]

    def now() -> int:
        return time.monotonic_ns() + lost[0]

    monkeypatch.setattr(clocks, "time", SimpleNamespace(monotonic_ns=now))
    monkeypatch.setattr(clocks.AsyncioClock, "now", staticmethod(now))

    def hold_up() -> None:
        lost[0] += 10_000 * MS

    async def check() -> list[float]:
        params = {"reply_timeout": "2 s", "retries": 0}
        async with framekit.aconnect("modbus-rtu", f"sim:{device}", station=7, params=params) as client:
            reading = asyncio.ensure_future(client.read("40001", 3))
            asyncio.get_running_loop().call_later(0.001, hold_up)  # during the transmission of the request
            return list(await reading)

    assert asyncio.run(check()) == [100, 200, 300]
