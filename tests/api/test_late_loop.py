"""A process that is held up for a while: what is simulated in it goes on as if it had not been."""

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


def test_a_simulated_device_answers_in_time_however_late_the_loop_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lost = [0]

    def now() -> int:
        return time.monotonic_ns() + lost[0]

    monkeypatch.setattr(clocks, "time", SimpleNamespace(monotonic_ns=now))
    monkeypatch.setattr(clocks.AsyncioClock, "now", staticmethod(now))

    def hold_up() -> None:
        lost[0] += 10_000 * MS

    async def check() -> list[float]:
        params = {"reply_timeout": "2 s", "retries": 0}
        async with framekit.aconnect("modbus-rtu", f"sim:{device_file(tmp_path)}", station=7, params=params) as client:
            reading = asyncio.ensure_future(client.read("40001", 3))
            asyncio.get_running_loop().call_later(0.001, hold_up)  # while the request is on the line
            return list(await reading)

    assert asyncio.run(check()) == [100, 200, 300]
