"""The same frames decoded and encoded by construct, by pymodbus's framer, and decoded as Kaitai's Python does."""

from __future__ import annotations

from collections.abc import Callable
from struct import pack, unpack
from typing import Any

from benchmarks.by_construct import in_construct, kaitai_reply
from benchmarks.by_hand_numbers import decode_numbers, encode_numbers
from benchmarks.cases import CASES, REGISTERS, REPLY, Case, builder_of, codec_of
from benchmarks.measure import compare
from benchmarks.row import Row, Target, faster, slower

NAME = "Generated codecs against libraries"
TARGET = "≥ 15 × faster than construct, ≥ 8 × than pymodbus's RTU framer, ≥ 5 × than Kaitai's Python"
TARGETS = {
    "construct": Target("at least", 15),
    "construct compiled": Target("at least", 15),
    "pymodbus": Target("at least", 8),
    "Kaitai": Target("at least", 5),
}
BY_HAND = Target("at most", 1.3)
Functions = dict[str, Callable[[], object]]


def run(rounds: int) -> list[Row]:
    return [row for case in CASES for row in _measure(case, rounds)]


def _measure(case: Case, rounds: int) -> list[Row]:
    data, _ = case.checked()
    encode, decode = case.codec.encoders[case.frame], case.codec.decoders[case.frame]
    decoders: Functions = {"framekit": lambda: decode(data)}
    encoders: Functions = {"framekit": lambda: encode(case.values)}
    _add_construct(case, data, decoders, encoders)
    rows = _rows(case, "decode", decoders, rounds) + _rows(case, "encode", encoders, rounds)
    return rows + _pymodbus(case, data, rounds) if case.frame == "reply_adu" else rows


def _rows(case: Case, direction: str, functions: Functions, rounds: int) -> list[Row]:
    found = compare(functions, rounds)
    ours = found.pop("framekit")
    return [faster(f"{case.name}: {direction}", name, ours, its, TARGETS[name]) for name, its in found.items()]


def _add_construct(case: Case, data: bytes, decoders: Functions, encoders: Functions) -> None:
    """Add constructs written by hand, interpreted and compiled, if they exist for this frame."""
    written = in_construct(case.frame, case.values)
    if written is None:
        return
    construct, values = written
    for name, one in (("construct", construct), ("construct compiled", construct.compile())):
        assert one.build(values) == data and one.parse(data).content.data == data[:-2], case.name
        decoders[name] = lambda one=one: one.parse(data)  # type: ignore[misc]
        encoders[name] = lambda one=one: one.build(values)  # type: ignore[misc]


def _pymodbus(case: Case, data: bytes, rounds: int) -> list[Row]:
    """Add pymodbus, which uses registers as numbers; framekit's bytes are converted from and to numbers here, too."""
    from pymodbus.framer import FramerRTU
    from pymodbus.pdu import DecodePDU
    from pymodbus.pdu.register_message import ReadHoldingRegistersResponse

    framer = FramerRTU(DecodePDU(False))
    used, pdu = framer.handleFrame(data, 0, 0)
    assert pdu is not None and used == len(data) and framer.buildFrame(pdu) == data
    numbers, form = list(pdu.registers), f">{len(pdu.registers)}H"
    encode, decode = case.codec.encoders[case.frame], case.codec.decoders[case.frame]

    build = builder_of("modbus-rtu", *REPLY)

    def named() -> bytes:
        return build(station=17, values=pack(form, *numbers))

    def encoded() -> bytes:
        return encode({"station": 17, "pdu": {"read_holding_reply": {"values": pack(form, *numbers)}}})

    def built() -> Any:
        return framer.buildFrame(ReadHoldingRegistersResponse(dev_id=17, registers=numbers))

    assert named() == encoded() == built() == data
    kaitai = kaitai_reply()
    kaitai(data)
    decoders: Functions = {
        "framekit": lambda: unpack(form, decode(data)["pdu"]["read_holding_reply"]["values"]),
        "pymodbus": lambda: framer.handleFrame(data, 0, 0),
    }
    rows = _rows(case, "bytes to numbers", decoders, rounds)
    rows += _encode_rows(f"{case.name}: numbers to bytes", named, encoded, built, rounds)
    rows += _numbers(case, data, numbers, (lambda: framer.handleFrame(data, 0, 0), built), rounds)
    return rows + _rows(case, "decode", {"framekit": lambda: decode(data), "Kaitai": lambda: kaitai(data)}, rounds)


def _encode_rows(
    name: str,
    named: Callable[[], object],
    nested: Callable[[], object],
    pymodbus: Callable[[], object],
    rounds: int,
) -> list[Row]:
    """Return rows of encoding named values, like pymodbus's, and decoded (nested) values, which is more work."""
    found = compare({"named": named, "nested": nested, "pymodbus": pymodbus}, rounds)
    return [
        faster(name, "pymodbus", found["named"], found["pymodbus"], TARGETS["pymodbus"]),
        faster(f"{name}, nested values", "pymodbus", found["nested"], found["pymodbus"], None),
    ]


def _numbers(
    case: Case, data: bytes, numbers: list[int], pymodbus: tuple[Callable[[], object], ...], rounds: int
) -> list[Row]:
    """Measure the same with a definition whose registers are numbers, which need no conversion."""
    codec, build = codec_of(REGISTERS), builder_of(REGISTERS, *REPLY)
    encode, decode = codec.encoders[case.frame], codec.decoders[case.frame]
    values = {"station": 17, "pdu": {"read_holding_reply": {"values": numbers}}}
    assert encode(values) == encode_numbers(values) == data and decode(data) == decode_numbers(data)

    decoders: Functions = {
        "framekit": lambda: decode(data),
        "by hand": lambda: decode_numbers(data),
        "pymodbus": pymodbus[0],
    }

    def nested() -> bytes:  # pymodbus puts its values together in this time, too
        return encode({"station": 17, "pdu": {"read_holding_reply": {"values": numbers}}})

    def by_hand() -> bytes:
        return encode_numbers({"station": 17, "pdu": {"read_holding_reply": {"values": numbers}}})

    found, name = compare(decoders, rounds), f"{case.name} as numbers"
    rows = [faster(f"{name}: decode", "pymodbus", found["framekit"], found["pymodbus"], TARGETS["pymodbus"])]
    rows.append(slower(f"{name}: decode", "by hand", found["framekit"], found["by hand"], BY_HAND))
    rows += _encode_rows(f"{name}: encode", lambda: build(station=17, values=numbers), nested, pymodbus[1], rounds)
    found = compare({"framekit": nested, "by hand": by_hand}, rounds)
    return [*rows, slower(f"{name}: encode, nested values", "by hand", found["framekit"], found["by hand"], BY_HAND)]
