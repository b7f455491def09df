"""Two small protocols of decimal text, as users would write them: sentences of NMEA 0183, a temperature controller.

The sentences are the well-known examples of RMC and GGA, byte for byte (Dale DePriest, "NMEA data").
"""

from __future__ import annotations

from collections.abc import Iterator
from decimal import Decimal
from pathlib import Path
from random import Random
from typing import Any

import pytest
from link.link_world import compiled, cut_at, feed

import framekit
from framekit.codec.errors import EncodeError, FrameError
from framekit.definition.times import LineFormat
from framekit.link.receiver import Receiver
from framekit.link.scope import Scope

SENTENCES = """
protocol: sentences
line: {speed: {default: 4800}}
layouts:
  place:
    - {field: latitude, type: decimal, digits: 4, decimals: any, empty: yes, end: 2C}
    - {field: north_south, type: ascii, end: 2C}
    - {field: longitude, type: decimal, digits: 5, decimals: any, empty: yes, end: 2C}
    - {field: east_west, type: ascii, end: 2C}
  sum:
    - {const: 2A}
    - {check: xor8, over: talker..last, as: hex}
    - {const: 0D 0A}
frames:
  rmc:
    body:
      - {const: 24}
      - {field: talker, type: ascii, size: 2}
      - {text: "RMC,"}
      - {field: time, type: ascii, end: 2C}
      - {field: status, type: ascii, end: 2C}
      - {include: place}
      - {field: speed, type: decimal, digits: 3, decimals: any, empty: yes, end: 2C}
      - {field: course, type: decimal, digits: 3, decimals: any, empty: yes, end: 2C}
      - {field: date, type: ascii, end: 2C}
      - {field: variation, type: decimal, digits: 3, decimals: any, empty: yes, end: 2C}
      - {field: last, type: ascii, end: [2A]}
      - {include: sum}
  gga:
    body:
      - {const: 24}
      - {field: talker, type: ascii, size: 2}
      - {text: "GGA,"}
      - {field: time, type: ascii, end: 2C}
      - {include: place}
      - {field: quality, type: decimal, sign: never, end: 2C}
      - {field: satellites, type: decimal, sign: never, digits: 2, end: 2C}
      - {field: dilution, type: decimal, decimals: any, empty: yes, end: 2C}
      - {field: altitude, type: decimal, decimals: any, empty: yes, end: 2C}
      - {text: "M,"}
      - {field: geoid, type: decimal, decimals: any, empty: yes, end: 2C}
      - {text: "M,"}
      - {field: age, type: decimal, decimals: any, empty: yes, end: 2C}
      - {field: last, type: ascii, end: [2A]}
      - {include: sum}
"""
RMC = b"$GPRMC,123519,A,4807.038,N,01131.000,E,022.4,084.4,230394,003.1,W*6A\r\n"
GGA = b"$GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,*47\r\n"
READ = {
    "rmc": {
        "talker": "GP", "time": "123519", "status": "A", "latitude": Decimal("4807.038"), "north_south": "N",
        "longitude": Decimal("1131.000"), "east_west": "E", "speed": Decimal("22.4"), "course": Decimal("84.4"),
        "date": "230394", "variation": Decimal("3.1"), "last": "W",
    },
    "gga": {
        "talker": "GP", "time": "123519", "latitude": Decimal("4807.038"), "north_south": "N",
        "longitude": Decimal("1131.000"), "east_west": "E", "quality": 1, "satellites": 8, "dilution": Decimal("0.9"),
        "altitude": Decimal("545.4"), "geoid": Decimal("46.9"), "age": None, "last": "",
    },
}  # fmt: skip


@pytest.mark.parametrize(("frame", "data"), [("rmc", RMC), ("gga", GGA)])
def test_published_sentences_byte_for_byte(frame: str, data: bytes) -> None:
    _, codec = compiled(SENTENCES)
    values = codec.decode(frame, data)
    assert values == READ[frame]
    assert str(values["longitude"]) == "1131.000"
    assert codec.encode(frame, values) == data
    with pytest.raises(FrameError, match="check"):
        codec.decode(frame, data.replace(b"4807", b"4817"))


def received(pieces: list[bytes]) -> list[tuple[Any, ...]]:
    protocol, codec = compiled(SENTENCES)
    receiver = Receiver(codec, protocol, Scope(protocol, params={}, line=LineFormat(4800)))
    return feed(receiver, pieces, ("rmc", "gga"))


def test_a_stream_of_sentences_however_it_is_cut() -> None:
    stream = b"\xff$GP" + RMC + GGA.replace(b"*47", b"*48") + GGA + RMC.replace(b"022.4", b"") + RMC
    whole = received([stream])
    good = [event[:3] for event in whole if event[0] == "frame"]
    assert good == [("frame", "rmc", RMC), ("frame", "gga", GGA), ("frame", "rmc", RMC)]
    assert received([stream[place : place + 1] for place in range(len(stream))]) == whole
    random = Random("sentences")
    for _ in range(20):
        assert received(cut_at(stream, [random.randrange(len(stream)) for _ in range(5)])) == whole


OVEN = """
protocol: oven
extends: standard
station: {type: number, range: 1..99, default: 1}
groups:
  request:
    from: client
    head: [{const: STX}, {field: station, type: dec, size: 2}, {field: command, type: ascii, size: 2}]
    tail: [{const: ETX}, {check: xor8, over: 1..here, as: hex}]
  reply:
    from: server
    head: [{const: STX}, {field: station, type: dec, size: 2}, {field: command, type: ascii, size: 2}]
    tail: [{const: ETX}, {check: xor8, over: 1..here, as: hex}]
    echo: [station, command]
frames:
  ask: {group: request, where: {command: RD}, body: [{field: place, type: dec, size: 2}]}
  told:
    group: reply
    where: {command: RD}
    body: [{field: value, type: decimal, size: 6, sign: always, decimals: 1}]
  put:
    group: request
    where: {command: WR}
    body: [{field: place, type: dec, size: 2}, {field: value, type: decimal, size: 6, sign: always, decimals: 1}]
  done: {group: reply, where: {command: WR}, body: [{field: value, type: decimal, size: 6, sign: always, decimals: 1}]}
state: {points: {scope: device, table: 0..9, holds: f64}}
services:
  read_point:
    - takes: {place: {type: number, range: 0..9}}
      request: {ask: {station: station, place: place}}
      reply: {told: {station: station, value: "get(points, place, 0)"}}
      gives: {value: reply.value}
  write_point:
    - takes: {place: {type: number, range: 0..9}, value: {type: decimal, range: -99..999}}
      request: {put: {station: station, place: place, value: value}}
      reply: {done: {station: station, value: value}}
      serve: {set: {"points[place]": value}}
"""
DEVICE = "device: d\nprotocol: oven.yaml\nstation: 1\n"


@pytest.fixture
def oven(tmp_path: Path) -> Iterator[framekit.Client]:
    (tmp_path / "oven.yaml").write_text(OVEN, "utf-8")
    (tmp_path / "d.device.yaml").write_text(DEVICE, "utf-8")
    with framekit.connect(tmp_path / "oven.yaml", f"sim:{tmp_path / 'd.device.yaml'}", station=1) as client:
        yield client


def test_a_controller_with_decimal_registers(oven: framekit.Client) -> None:
    assert oven.call("read_point", {"place": 3}).results == {"value": 0}
    oven.call("write_point", {"place": 3, "value": Decimal("12.5")})
    assert oven.call("read_point", {"place": 3}).results == {"value": Decimal("12.5")}
    oven.call("write_point", {"place": 4, "value": -0.5})
    oven.call("write_point", {"place": 5, "value": "100"})
    assert [oven.call("read_point", {"place": place}).results["value"] for place in (4, 5)] == [Decimal("-0.5"), 100]


@pytest.mark.parametrize(
    ("value", "message"),
    [(12.55, "more than 1 decimals"), (1000, "1000 is not in -99..999"), ("much", "'much' is not a number")],
)
def test_what_a_register_cannot_hold_is_not_sent(oven: framekit.Client, value: object, message: str) -> None:
    with pytest.raises((framekit.RequestError, framekit.ExchangeError), match=message):
        oven.call("write_point", {"place": 3, "value": value})
    assert oven.call("read_point", {"place": 3}).results == {"value": 0}


def test_its_frames() -> None:
    _, codec = compiled(OVEN)
    data = codec.encode("told", {"station": 1, "value": 12.5})
    assert data == b"\x0201RD+012.5\x03" + b"%02X" % (
        0x30 ^ 0x31 ^ 0x52 ^ 0x44 ^ 0x2B ^ 0x30 ^ 0x31 ^ 0x32 ^ 0x2E ^ 0x35 ^ 3
    )
    assert codec.decode("told", data)["value"] == Decimal("12.5")
    with pytest.raises(EncodeError, match="more than 1 decimals"):
        codec.encode("told", {"station": 1, "value": 12.55})


@pytest.mark.parametrize("given", [2.5, Decimal("2.5"), Decimal(2)])
def test_a_whole_number_is_not_cut_off_in_silence(given: object) -> None:
    _, codec = compiled(OVEN)
    message = (
        f"'station' must be a whole number, and {given} is a {type(given).__name__} – round it; a field has fractions"
    )
    with pytest.raises(EncodeError, match=message):
        codec.encode("told", {"station": given, "value": 1})
    with pytest.raises(EncodeError, match="'station' must be a whole number, not str"):
        codec.encode("told", {"station": "2", "value": 1})
