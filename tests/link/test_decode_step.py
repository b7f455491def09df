# ruff: noqa: E501 - definitions in YAML
"""`decode:` in steps: the bytes of several frames are joined and decoded; wrong bytes are bad frames."""

from __future__ import annotations

from typing import Any

import pytest
from link.link_world import MS, Side

from framekit.link.events import LinkCounters

PIECES = """\
protocol: pieces
station: {type: none}
line: {speed: {default: 9600}, format: {default: 8E1}}
groups:
  piece: {from: server, head: [{const: 7E}, {field: last, type: u8}, {length: n, type: u8, of: [part]}], tail: [{check: sum8}]}
  message: {from: server}
frames:
  GO:    {from: client, body: [{const: 05}]}
  STOP:  {from: client, body: [{const: 04}]}
  PIECE: {group: piece, body: [{data: part, size: n}]}
  NAME:  {group: message, body: [{const: 01}, {field: text, type: ascii, end: 00}, {check: crc16-modbus, order: little}]}
  LEVEL: {group: message, body: [{const: 02}, {field: value, type: u16, range: 0..1000}]}
  SET:   {group: message, body: [{const: 03}, {field: value, type: u8, refuse: 9, range: 0..5}]}
sequences:
  collect:
    local: {joined: bytes, whole: frame, why: text, which: text}
    gives: {whole: whole, why: why, which: which}
    steps:
      - step: ask
        send: GO
        receive:
          - {frame: PIECE, when: it.last == 0, set: {joined: joined + it.part}, then: again}
          - {frame: PIECE, set: {joined: joined + it.part}, then: next}
        within: 1 s
      - step: read
        decode: {of: joined, frame: message, into: whole}
%s
roles:
  client: {lanes: {main: {exchange: collect}}}
"""
HANDLED = """\
        on_bad: {set: {why: cause, which: frame}, then: bad}
      - step: done
        then: end
      - step: bad
        send: STOP
"""
GOES_ON = """\
        on_bad: {set: {why: cause}}
      - step: done
        send: STOP
"""


def piece(part: bytes, last: bool) -> bytes:
    body = bytes([0x7E, last, len(part)]) + part
    return body + bytes([sum(body) & 0xFF])


def collected(data: bytes, more: str = "", size: int = 3) -> Side:
    """Return a client that received these bytes in pieces."""
    side = Side(PIECES % more, "client", counters=LinkCounters())
    side.ask()
    parts = [data[at : at + size] for at in range(0, len(data), size)]
    for number, part in enumerate(parts):
        side.gets(piece(part, number == len(parts) - 1))
    side.run(50 * MS)
    return side


def bad_ones(side: Side) -> list[tuple[Any, ...]]:
    return [
        (event.frame, event.reason, event.segment, event.place, event.raw.hex())
        for event in side.seen
        if event.kind == "bad"
    ]


@pytest.mark.parametrize("size", [1, 2, 3, 50])
@pytest.mark.parametrize(
    ("data", "frame", "fields", "refusal"),
    [
        ("01 61 62 00 50 39", "NAME", {"text": "ab"}, None),
        ("02 01 00", "LEVEL", {"value": 256}, None),
        ("03 05", "SET", {"value": 5}, None),
        ("03 06", "SET", {}, 9),
    ],
)
def test_pieces_become_one_frame(data: str, frame: str, fields: dict[str, Any], refusal: int | None, size: int) -> None:
    raw = bytes.fromhex(data)
    if frame == "NAME":
        raw = raw[:-2] + crc16_modbus(raw[:-2]).to_bytes(2, "little")
    side = collected(raw, size=size)
    (outcome,) = side.outcomes
    assert outcome.ok, outcome.cause
    whole = outcome.results["whole"]
    assert (whole.frame, whole.fields, whole.raw, whole.refusal) == (frame, fields, raw, refusal)
    assert bad_ones(side) == []
    assert side.engine.counters.bad == 0


def crc16_modbus(data: bytes) -> int:
    code = 0xFFFF
    for byte in data:
        code ^= byte
        for _ in range(8):
            code = code >> 1 ^ (0xA001 if code & 1 else 0)
    return code


WRONG = [
    ("01 61 62 00 00 00", "NAME", "check", "check", 4),
    ("02 07 D0", "LEVEL", "range", "value", 1),
    ("02 01", "LEVEL", "short", "value", 1),
    ("02 01 02 03", "LEVEL", "surplus", "", 3),
    ("", "NAME", "short", "const", 0),
]


@pytest.mark.parametrize(("data", "frame", "cause", "segment", "place"), WRONG)
def test_a_wrong_one_is_a_bad_frame_with_reason_and_offset(
    data: str, frame: str, cause: str, segment: str, place: int
) -> None:
    raw = bytes.fromhex(data)
    side = collected(raw) if raw else collected(b"", size=1)
    if not raw:
        side.gets(piece(b"", True))
        side.run(50 * MS)
    (outcome,) = side.outcomes
    assert (outcome.ok, outcome.outcome) == (False, "damaged_frame")
    assert cause in outcome.cause
    ((shown, reason, where, at, seen),) = bad_ones(side)
    assert (shown, reason, at, seen) == (frame, cause, place, raw.hex())
    assert segment in where
    assert side.engine.counters.bad == 1


def test_on_bad_says_what_follows() -> None:
    side = collected(bytes.fromhex("02 07 D0"), HANDLED)
    (outcome,) = side.outcomes
    assert outcome.ok
    assert (outcome.results["why"], outcome.results["which"], outcome.results["whole"]) == ("range", "LEVEL", None)
    assert side.taken() == [b"\x05", b"\x04"]
    side = collected(bytes.fromhex("02 00 07"), HANDLED)
    assert side.outcomes[0].results["whole"].fields == {"value": 7}
    assert side.taken() == [b"\x05"]


def test_an_on_bad_without_then_goes_on_with_the_next_step() -> None:
    side = collected(bytes.fromhex("02 07 D0"), GOES_ON)
    (outcome,) = side.outcomes
    assert outcome.ok, outcome.cause
    assert (outcome.results["why"], outcome.results["whole"]) == ("range", None)
    assert side.taken() == [b"\x05", b"\x04"]


def test_the_frames_that_are_decoded_are_not_looked_for_on_the_line() -> None:
    text = (PIECES % "").replace("        within: 1 s", "        within: 1 s\n        on_other: again")
    side = Side(text, "client")
    side.ask()
    side.gets(bytes.fromhex("02 00 07") + piece(bytes.fromhex("02 00 07"), True))
    side.run(50 * MS)
    assert [event.raw.hex() for event in side.seen if event.kind == "noise"] == ["020007"]
    assert side.outcomes[0].results["whole"].fields == {"value": 7}


def test_only_bytes_can_be_decoded() -> None:
    side = collected(b"\x02\x00\x07", "").outcomes
    assert side[0].ok
    text = (
        (PIECES % "")
        .replace("local: {joined: bytes,", "local: {list: list, joined: bytes,")
        .replace("of: joined", 'of: "either(none(), list)"')
    )
    broken = Side(text, "client")
    broken.ask()
    broken.gets(piece(b"\x02\x00\x07", True))
    broken.run(50 * MS)
    assert broken.outcomes[0].outcome == "expression"


def test_a_decoded_frame_announces() -> None:
    text = PIECES.replace("  message: {from: server}", "  message: {from: server, announces: {seen: 'wire[0]'}}")
    text = text.replace("sequences:\n", "state: {seen: {scope: line, type: u8}}\nsequences:\n", 1)
    side = Side(text % "", "client")
    side.ask()
    side.gets(piece(b"\x02\x00\x07", True))
    side.run(50 * MS)
    assert side.engine.scope["seen"] == 2
