"""A run that changes its points and is killed.

Every value that it reported as stored must arrive (`test_mqtt_kills.py`). It is a process of its own. It writes to
`log`: `s N` at its start, `b N` before it changes a point to N, and `k N` when all its changes are stored.
"""

from __future__ import annotations

import asyncio
import os
import random
from pathlib import Path

POINTS = 4
RUN = """run: killed
memory: masterlogic
points:
{points}
channels:
  1: {{port: "sim:none.device.yaml", protocol: modbus-tcp, station: 1}}
sinks:
  - {{mqtt: "127.0.0.1:{port}", topic: "{{point}}", payload: plain, most: 1000000}}
"""
DEVICE = "device: none\nprotocol: modbus-tcp\nstation: 1\n"


def write_files(folder: Path, port: int) -> Path:
    (folder / "none.device.yaml").write_text(DEVICE, "utf-8")
    path = folder / "killed.run.yaml"
    points = "\n".join(f"  p{at}: {{address: '%MW{10 + at}', type: uint16}}" for at in range(POINTS))
    path.write_text(RUN.format(port=port, points=points), "utf-8")
    return path


def change(path: str, log: str, last: int, pause: float) -> None:
    """Change points to the numbers after the last begun number up to `last`, one number per `pause` seconds."""
    asyncio.run(_change(Path(path), Path(log), last, pause))


async def _change(path: Path, log: Path, last: int, pause: float) -> None:
    from framekit.api.run import AsyncRun
    from framekit.run.points import PointValue
    from framekit.service import sinks

    sinks.LONGEST_WAIT = 0.1
    begun = [int(line[2:]) for line in log.read_text().splitlines() if line.startswith("b ") and line[2:]]
    number = max(begun, default=0)
    file = os.open(log, os.O_WRONLY | os.O_APPEND)
    os.write(file, b"s %d\n" % number)
    run = AsyncRun(path)
    waiting = run._service.sinks.feeders[0]._waiting
    stored: set[int] = set()

    def changed(value: PointValue) -> None:
        stored.add(value.value)

    async with run:
        run.points.watch(changed)
        while number < last:
            for _ in range(min(random.randint(1, 30), last - number)):
                number += 1
                os.write(file, b"b %d\n" % number)
                run.memory[f"%MW{10 + number % POINTS}"] = number
                while number not in stored:
                    await asyncio.sleep(0)
                await asyncio.sleep(pause)
            while waiting.unsaved:
                await asyncio.sleep(0.0005)
            os.write(file, b"k %d\n" % number)
        while waiting.has_some:
            await asyncio.sleep(0.01)
