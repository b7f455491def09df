"""pynmea2, an independent implementation, decodes a simulated receiver on a real terminal, and builds sentences for us.

Skipped only if it is not installed.
"""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest
import serial
from peer_world import at_work, pty_device

import framekit
from framekit.definition.times import LineFormat

pynmea2 = pytest.importorskip("pynmea2", reason="pynmea2 is not installed")

DEVICE = """
device: peer
protocol: nmea0183
params: {interval: 100 ms, here_latitude: 5130500, here_longitude: 7004, here_east: W}
"""
LINE = LineFormat(38400)


def listening(path: str) -> None:
    with serial.Serial(path, 38400, timeout=2) as port:
        port.write(str(pynmea2.QuerySentence("CC", "GP", "GGA")).encode() + b"\r\n")
        found = {}
        while found.keys() != {"RMC", "GGA"}:
            sentence = pynmea2.parse(port.readline().decode(), check=True)
            found[sentence.sentence_type] = sentence
        for one in found.values():
            assert (round(one.latitude, 6), round(one.longitude, 6)) == (51.508333, -0.116733)
        assert found["RMC"].datetime.isoformat() == "1994-03-23T12:35:19+00:00"
        assert (found["GGA"].gps_qual, found["GGA"].altitude) == (1, 545.4)


def test_it_reads_a_simulated_receiver(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with pty_device(tmp_path, DEVICE, LINE) as (path, _):
            await at_work(listening, path)

    asyncio.run(scenario())


@pytest.mark.parametrize(
    ("talker", "kind", "fields"),
    [
        ("GP", "GLL", ("4916.45", "N", "12311.12", "W", "225444", "A", "A")),
        ("GN", "ZDA", ("201530.00", "04", "07", "2002", "00", "00")),
        ("WI", "MWV", ("214.8", "R", "0.1", "K", "A")),
        ("GP", "GSA", ("A", "3", "04", "05", *[""] * 10, "2.5", "1.3", "2.1")),
        ("HE", "ROT", ("-0.3", "A")),
    ],
)
def test_its_sentences_are_read_and_built_alike(talker: str, kind: str, fields: tuple[str, ...]) -> None:
    written = str(getattr(pynmea2, kind)(talker, kind, fields)).encode() + b"\r\n"
    codec = framekit.load("nmea0183")
    frame = kind if kind != "ROT" else "other"
    found = codec.decode(written, frame)
    assert codec.encode(frame, **found.fields) == written
