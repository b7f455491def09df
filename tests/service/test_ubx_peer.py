"""pyubx2, an independent implementation, with a simulated receiver on a real terminal, and message by message.

Skipped only if it is not installed.
"""

from __future__ import annotations

import asyncio
from pathlib import Path
from random import Random
from typing import Any

import pytest
import serial
from peer_world import at_work, pty_device

import framekit
from framekit.definition.times import LineFormat

pyubx2 = pytest.importorskip("pyubx2", reason="pyubx2 is not installed")

DEVICE = """
device: peer
protocol: ubx
params: {here_latitude: -338567844, here_longitude: 1512152967}
"""
LINE = LineFormat(38400)


def asking(path: str) -> None:
    with serial.Serial(path, 38400, timeout=2) as port:
        reader = pyubx2.UBXReader(port, quitonerror=pyubx2.ERR_RAISE)

        def asked(kind: str, name: str, mode: int = pyubx2.POLL, **fields: Any) -> Any:
            port.write(pyubx2.UBXMessage(kind, name, mode, **fields).serialize())
            return reader.read()[1]

        fix = asked("NAV", "NAV-PVT")
        assert (fix.identity, fix.fixType, fix.numSV) == ("NAV-PVT", 3, 9)
        assert (fix.lat, fix.lon, fix.height) == (-33.8567844, 151.2152967, 456789)
        version = asked("MON", "MON-VER")
        assert version.swVersion.rstrip(b"\0") == b"ROM CORE 3.01 (107888)"
        done = asked("CFG", "CFG-RATE", pyubx2.SET, measRate=200, navRate=2, timeRef=0)
        assert (done.identity, done.clsID, done.msgID) == ("ACK-ACK", 6, 8)
        rate = asked("CFG", "CFG-RATE")
        assert (rate.measRate, rate.navRate, rate.timeRef) == (200, 2, 0)
        assert asked("NAV", "NAV-SAT").identity == "ACK-NAK"


def test_it_asks_a_simulated_receiver(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with pty_device(tmp_path, DEVICE, LINE) as (path, _):
            await at_work(asking, path)

    asyncio.run(scenario())


@pytest.mark.parametrize(
    ("kind", "name", "frame", "size"),
    [("NAV", "NAV-PVT", "position", 92), ("NAV", "NAV-POSLLH", "position_llh", 28), ("MON", "MON-VER", "version", 100)],
)
def test_messages_of_any_content_are_built_alike(kind: str, name: str, frame: str, size: int) -> None:
    random = Random(1)
    codec = framekit.load("ubx")
    for _ in range(50):
        content = random.randbytes(size) if frame != "version" else bytes(random.randrange(48, 91) for _ in range(size))
        written = pyubx2.UBXMessage(kind, name, pyubx2.GET, payload=content).serialize()
        found = codec.decode(written, frame)
        assert codec.encode(frame, **found.fields) == written
        theirs = pyubx2.UBXReader.parse(written)
        if frame != "version":
            assert tuple(round(float(found[name]), 7) for name in ("latitude", "longitude")) == (theirs.lat, theirs.lon)
