"""The same frames read and written with construct, and with the framer of pymodbus."""

from __future__ import annotations

from collections.abc import Callable

from benchmarks.cases import CASES, Case
from benchmarks.measure import compare
from benchmarks.row import Row, Target, faster
from framekit.codec.construct_backend import compile_construct

NAME = "Generated codecs against libraries"
TARGET = "≥ 15 × faster than construct, ≥ 8 × faster than pymodbus's RTU framer"
TARGETS = {"construct": Target("at least", 15), "pymodbus": Target("at least", 8)}

Functions = dict[str, Callable[[], object]]


def run(rounds: int) -> list[Row]:
    return [row for case in CASES for row in _measure(case, rounds)]


def _measure(case: Case, rounds: int) -> list[Row]:
    data, fields = case.checked()
    encode, decode = case.codec.encoders[case.frame], case.codec.decoders[case.frame]
    decoders: Functions = {"framekit": lambda: decode(data)}
    encoders: Functions = {"framekit": lambda: encode(case.values)}
    _add_construct(case, data, fields, decoders, encoders)
    if case.frame == "reply_adu":
        _add_pymodbus(data, decoders, encoders)
    rows = []
    for direction, functions in (("decode", decoders), ("encode", encoders)):
        found = compare(functions, rounds)
        ours = found.pop("framekit")
        rows += [faster(f"{case.name}: {direction}", name, ours, its, TARGETS[name]) for name, its in found.items()]
    return rows


def _add_construct(case: Case, data: bytes, fields: object, decoders: Functions, encoders: Functions) -> None:
    reference = compile_construct(case.codec.protocol)
    assert reference.encode(case.frame, case.values) == data and reference.decode(case.frame, data) == fields
    decoders["construct"] = lambda: reference.decode(case.frame, data)
    encoders["construct"] = lambda: reference.encode(case.frame, case.values)


def _add_pymodbus(data: bytes, decoders: Functions, encoders: Functions) -> None:
    from pymodbus.framer import FramerRTU
    from pymodbus.pdu import DecodePDU

    framer = FramerRTU(DecodePDU(False))
    used, pdu = framer.handleFrame(data, 0, 0)
    assert pdu is not None and used == len(data) and framer.buildFrame(pdu) == data
    decoders["pymodbus"] = lambda: framer.handleFrame(data, 0, 0)
    encoders["pymodbus"] = lambda: framer.buildFrame(pdu)
