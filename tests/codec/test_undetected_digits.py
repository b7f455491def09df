"""Undetected errors of 8-bit checks in hex digits without parity, compared with theory (docs/faults.md)."""

from __future__ import annotations

import math
from itertools import product
from random import Random

import pytest

from framekit.codec.codec import compile_protocol
from framekit.codec.errors import FrameError
from framekit.definition.load.protocol import load_protocol

TRIES = 20_000
DIGITS = b"0123456789ABCDEF"


def cancelling(differences: list[int], modulus: int) -> float:
    """Return the probability that the sum of two of these differences, all equally likely, is zero."""
    return sum((one + other) % modulus == 0 for one, other in product(differences, repeat=2)) / len(differences) ** 2


def measured(frame: bytes, first: int, count: int, decode: object) -> float:
    """Return the share of frames with two wrong digits that are accepted."""
    random = Random(len(frame))
    taken = 0
    for _ in range(TRIES):
        data = bytearray(frame)
        for place in random.sample(range(first, first + count), 2):
            data[place] = random.choice([digit for digit in DIGITS if digit != data[place]])
        try:
            decode(bytes(data))  # type: ignore[operator]
        except FrameError:
            continue
        taken += 1
    return taken / TRIES


def assert_as_foreseen(found: float, theory: float) -> None:
    assert abs(found - theory) <= 4 * math.sqrt(theory * (1 - theory) / TRIES), (found, theory)


def test_a_sum_over_digits() -> None:
    """Wrong digits cancel if their ASCII codes do, since the sum of two of them has no carry."""
    codec = compile_protocol(load_protocol("mldp"))
    data = bytes(value for value in range(0, 240, 2))
    frame = codec.encode(
        "read_continuous_reply",
        {"station": 1, "command": "r", "type": "SB", "values": [{"data": data}]},
    )
    theory = cancelling([digit - other for digit in DIGITS for other in DIGITS if digit != other], 256)
    first = frame.index(data.hex().upper().encode())
    found = measured(frame, first, 240, lambda wrong: codec.decode("read_continuous_reply", wrong))
    assert_as_foreseen(found, theory)


def test_a_sum_over_bytes_in_digits() -> None:
    """Two wrong digits cancel only if both are high digits or both are low digits."""
    codec = compile_protocol(load_protocol("modbus-ascii"))
    values = Random(5).randbytes(200)
    frame = codec.encode("reply_adu", {"station": 1, "pdu": {"read_holding_reply": {"values": values}}})
    low = [number - other for number in range(16) for other in range(16) if number != other]
    theory = (cancelling(low, 256) + cancelling([16 * difference for difference in low], 256)) / 4
    first = frame.index(values.hex().upper().encode())
    found = measured(frame, first, 400, lambda wrong: codec.decode("reply_adu", wrong))
    assert_as_foreseen(found, theory)


@pytest.mark.parametrize("name", ["mldp", "modbus-ascii"])
def test_one_wrong_digit_never_passes(name: str) -> None:
    codec = compile_protocol(load_protocol(name))
    mldp = {"station": 1, "command": "r", "type": "SB", "values": [{"data": b"\x12\x34"}]}
    ascii_ = {"station": 1, "pdu": {"read_holding_reply": {"values": b"\x12\x34"}}}
    frame, fields = {"mldp": ("read_continuous_reply", mldp), "modbus-ascii": ("reply_adu", ascii_)}[name]
    good = codec.encode(frame, fields)
    place = good.index(b"1234")
    for digit in DIGITS:
        for index in range(place, place + 4):
            data = good[:index] + bytes([digit]) + good[index + 1 :]
            if data != good:
                with pytest.raises(FrameError):
                    codec.decode(frame, data)
