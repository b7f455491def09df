"""The other user-defined frames of the guide (chapters 7 and 9), both ways: ACK, NAK and the write of table 21."""

from __future__ import annotations

from typing import Any

import pytest
from construct_oracle import compile_construct

from framekit.codec.codec import compile_protocol
from framekit.definition.load.protocol import load_protocol_text
from framekit.definition.problems import DefinitionError

FRAMES = """
protocol: user-frames
profile: snet-user-frames
params: {size: {type: number, default: 8, range: 1..100}}
groups:
  ack: {from: server, head: [{const: ACK}], tail: [{const: ETX}, {check: sum8, as: hex}]}
  nak: {from: server, head: [{const: NAK}], tail: [{const: ETX}, {check: sum8, as: hex}]}
  write: {from: client, head: [{const: ENQ}], tail: [{const: EOT}, {check: sum8, as: hex}]}
frames:
  ACK: {group: ack, body: [{text: "01"}, {text: wSB}]}
  NAK: {group: nak, body: [{text: "01"}, {text: wSB}, {data: error, size: 2, convert: hex_to_ascii}]}
  WRITE:
    group: write
    body:
      - {text: "00"}
      - {text: wSB}
      - {text: "06%MW100"}
      - {text: "04"}
      - {data: words, size: size, convert: hex_to_ascii}
"""

CASES: list[tuple[str, dict[str, Any], str]] = [
    ("ACK", {}, "06 30 31 77 53 42 03 37 36"),
    ("NAK", {"error": b"\x11\x32"}, "15 30 31 77 53 42 31 31 33 32 03 34 43"),
    (
        "WRITE",
        {"words": bytes.fromhex("1234567890ABCDEF")},
        "05 30 30 77 53 42 30 36 25 4D 57 31 30 30 30 34 31 32 33 34 35 36 37 38 39 30 41 42 43 44 45 46 04",
    ),
]


@pytest.mark.parametrize("compiler", [compile_protocol, compile_construct], ids=["python", "construct"])
@pytest.mark.parametrize(("frame", "values", "expected"), CASES, ids=[case[0] for case in CASES])
def test_both_ways(compiler: Any, frame: str, values: dict[str, Any], expected: str) -> None:
    codec = compiler(load_protocol_text(FRAMES))
    data = bytes.fromhex(expected)
    if frame == "WRITE":
        data += b"%02X" % (sum(data) & 0xFF)
    else:
        assert data[-2:] == b"%02X" % (sum(data[:-2]) & 0xFF), "the sum as worked out by hand"
    assert codec.encode(frame, values) == data
    assert codec.decode(frame, data) == values


TOOL = FRAMES.replace("profile: snet-user-frames", "profile: snet-user-frames\nconversions: by_direction").replace(
    "error, size: 2, convert: hex_to_ascii", "error, size: 2, convert: ascii_to_hex"
)


@pytest.mark.parametrize("compiler", [compile_protocol, compile_construct], ids=["python", "construct"])
@pytest.mark.parametrize("frame", [case[0] for case in CASES])
def test_the_tools_own_names_of_conversions_give_the_same_bytes(compiler: Any, frame: str) -> None:
    values = next(case[1] for case in CASES if case[0] == frame)
    here, tool = (compiler(load_protocol_text(text)) for text in (FRAMES, TOOL))
    data = tool.encode(frame, values)
    assert data == here.encode(frame, values)
    assert tool.decode(frame, data) == values


def test_a_conversion_without_a_direction_is_refused() -> None:
    with pytest.raises(DefinitionError, match="conversions are named by the direction of the frame, and this has none"):
        load_protocol_text(TOOL.replace("nak: {from: server,", "nak: {from: both,"))
