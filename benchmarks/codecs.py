"""Decode and encode of five frames: generated Python against code by hand, construct, and pymodbus's framer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from benchmarks.by_hand import (
    decode_individual,
    decode_registers,
    decode_request,
    decode_write,
    encode_individual,
    encode_registers,
    encode_request,
    encode_write,
)
from benchmarks.measure import compare
from framekit.codec.codec import compile_protocol
from framekit.codec.construct_backend import compile_construct
from framekit.definition.load import load_protocol

Fields = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Case:
    """A frame with its values, and what encodes and decodes it by hand."""

    name: str
    protocol: str
    frame: str
    values: Fields
    encode: Callable[[Fields], bytes]
    decode: Callable[[bytes], Fields]
    pymodbus: bool = False


def registers(count: int) -> Fields:
    return {"station": 17, "pdu": {"read_holding_reply": {"values": bytes(range(2 * count))}}}


VARIABLES = [{"data": bytes([number, 0x34])} for number in range(4)]
REQUEST = {"station": 17, "pdu": {"read_holding": {"address": 107, "count": 3}}}
INDIVIDUAL = {"station": 32, "command": "r", "values": VARIABLES}
WRITE = {"payload": bytes(range(44))}
TEN, MANY = registers(10), registers(125)

CASES = (
    Case("read reply, 10 registers", "modbus-rtu", "reply_adu", TEN, encode_registers, decode_registers, True),
    Case("read reply, 125 registers", "modbus-rtu", "reply_adu", MANY, encode_registers, decode_registers, True),
    Case("read request", "modbus-rtu", "request_adu", REQUEST, encode_request, decode_request),
    Case("read reply, 4 variables", "mldp", "read_individual_reply", INDIVIDUAL, encode_individual, decode_individual),
    Case("WR.REQ", "third-party-plc", "WR.REQ", WRITE, encode_write, decode_write),
)


def run(rounds: int) -> list[dict[str, Any]]:
    """A row a frame and direction: microseconds by hand, and how many times that the others take."""
    return [row for case in CASES for row in _measure(case, rounds)]


def _measure(case: Case, rounds: int) -> list[dict[str, Any]]:
    protocol = load_protocol(case.protocol)
    codec, reference = compile_protocol(protocol), compile_construct(protocol)
    encode, decode = codec.encoders[case.frame], codec.decoders[case.frame]
    data = encode(case.values)
    values = decode(data)
    assert case.encode(case.values) == data, case.name
    assert case.decode(data) == values, case.name
    assert reference.encode(case.frame, case.values) == data and reference.decode(case.frame, data) == values, case.name
    decoders: dict[str, Callable[[], object]] = {
        "by hand": lambda: case.decode(data),
        "framekit": lambda: decode(data),
        "construct": lambda: reference.decode(case.frame, data),
    }
    encoders: dict[str, Callable[[], object]] = {
        "by hand": lambda: case.encode(case.values),
        "framekit": lambda: encode(case.values),
        "construct": lambda: reference.encode(case.frame, case.values),
    }
    if case.pymodbus:
        decoders["pymodbus"], encoders["pymodbus"] = _pymodbus(data)
    return [_row(case.name, "decode", decoders, rounds), _row(case.name, "encode", encoders, rounds)]


def _pymodbus(data: bytes) -> tuple[Callable[[], object], Callable[[], object]]:
    from pymodbus.framer import FramerRTU
    from pymodbus.pdu import DecodePDU

    framer = FramerRTU(DecodePDU(False))
    used, pdu = framer.handleFrame(data, 0, 0)
    assert pdu is not None and used == len(data) and framer.buildFrame(pdu) == data
    return (lambda: framer.handleFrame(data, 0, 0)), (lambda: framer.buildFrame(pdu))


def _row(name: str, direction: str, functions: dict[str, Callable[[], object]], rounds: int) -> dict[str, Any]:
    timings = compare(functions, rounds)
    base = timings["by hand"]
    row: dict[str, Any] = {"frame": name, "direction": direction, "by hand µs": round(base.median * 1e6, 3)}
    row["spread %"] = round(100 * timings["framekit"].spread / timings["framekit"].median, 1)
    for other in ("framekit", "construct", "pymodbus"):
        if other in timings:
            row[other] = round(timings[other].median / base.median, 2)
    return row


def as_table(rows: list[dict[str, Any]]) -> str:
    """The rows for people: times relative to the code by hand."""
    lines = [f"{'frame':<36}{'':<8}{'by hand':>10}{'framekit':>10}{'construct':>11}{'pymodbus':>10}{'spread':>8}"]
    for row in rows:
        others = "".join(f"{'× ' + str(row[name]) if name in row else '-':>{width}}" for name, width in WIDTHS.items())
        lines.append(f"{row['frame']:<36}{row['direction']:<8}{row['by hand µs']:>7} µs{others}{row['spread %']:>6} %")
    return "\n".join(lines)


WIDTHS = {"framekit": 10, "construct": 11, "pymodbus": 10}
