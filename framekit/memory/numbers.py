"""Widths of memory units, and numbers as they stand in them: signed, floating-point, packed bits.

Memory itself holds bytes and hands out unsigned numbers; these helpers give them another reading. Nothing
here knows areas or where a value came from.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from functools import cache

from framekit.definition.model.services import UNIT_BITS
from framekit.memory.errors import MemoryValueError

UNSIGNED_CODES = {8: "B", 16: "H", 32: "I", 64: "Q"}
"""What `struct` calls unsigned numbers of so many bits."""

_FLOATS = {32: ("<I", "<f"), 64: ("<Q", "<d")}


@cache
def unit_bits(unit: str | int) -> int:
    """Width in bits of `bit`, `byte`, `word`, `dword`, `lword`, `6 bytes`, or of N bytes. ValueError else."""
    if isinstance(unit, str):
        known = UNIT_BITS.get(unit)
        if known is not None:
            return known
        number, _, kind = unit.partition(" ")
        if kind not in ("byte", "bytes") or not number.isdecimal():
            known_units = ", ".join(UNIT_BITS)
            raise ValueError(f"'{unit}' is not a unit – write {known_units}, or a size such as 6 bytes")
        unit = int(number)
    if unit < 1:
        raise ValueError("a unit has at least one byte")
    return 8 * unit


def as_signed(values: Iterable[int], unit: str | int) -> list[int]:
    """Unsigned values of this unit read as two's complement."""
    bits = unit_bits(unit)
    half, whole = 1 << (bits - 1), 1 << bits
    return [value - whole if value >= half else value for value in values]


def from_signed(values: Iterable[int], unit: str | int) -> list[int]:
    """The reverse of `as_signed`. Raises MemoryValueError for a value that does not fit."""
    bits = unit_bits(unit)
    half, mask = 1 << (bits - 1), (1 << bits) - 1
    result = []
    for value in values:
        if not -half <= value < half:
            raise MemoryValueError(f"{value} does not fit into {bits} bits with sign: {-half} to {half - 1}")
        result.append(value & mask)
    return result


def as_decimal(values: Iterable[int], unit: str | int) -> list[int]:
    """Unsigned values of this unit read as decimal digits of four bits (BCD). Raises MemoryValueError."""
    texts = [f"{value:0{unit_bits(unit) // 4}X}" for value in values]
    wrong = next((text for text in texts if not text.isdecimal()), None)
    if wrong is not None:
        raise MemoryValueError(f"0x{wrong} is no number in BCD: a digit is 0 to 9")
    return [int(text) for text in texts]


def from_decimal(values: Iterable[int], unit: str | int) -> list[int]:
    """The reverse of `as_decimal`. Raises MemoryValueError for a value that has no such form."""
    digits, result = unit_bits(unit) // 4, []
    for value in values:
        if not 0 <= value < 10**digits:
            raise MemoryValueError(f"{value} does not fit into {digits} decimal digits")
        result.append(int(str(value), 16))
    return result


def as_float(values: Iterable[int], unit: str | int = "dword") -> list[float]:
    """Unsigned dwords or lwords read as IEEE 754 numbers of 32 or 64 bits."""
    whole, real = _float_formats(unit)
    return [struct.unpack(real, struct.pack(whole, value))[0] for value in values]


def from_float(values: Iterable[float], unit: str | int = "dword") -> list[int]:
    """The reverse of `as_float`. Raises MemoryValueError for a number too large for 32 bits."""
    whole, real = _float_formats(unit)
    try:
        return [struct.unpack(whole, struct.pack(real, value))[0] for value in values]
    except OverflowError as problem:
        raise MemoryValueError(f"a number is too large for a floating-point {unit}") from problem


def _float_formats(unit: str | int) -> tuple[str, str]:
    formats = _FLOATS.get(unit_bits(unit))
    if formats is None:
        raise ValueError(f"a {unit} holds no floating-point number – only a dword or an lword does")
    return formats


def pack_bits(bits: Sequence[int]) -> bytes:
    """Bits in bytes, the first in bit 0 of the first byte, padded with 0. Raises MemoryValueError."""
    if not bits:
        return b""
    for bit in bits:
        if bit != 0 and bit != 1:
            raise MemoryValueError(f"{bit} is not a bit – only 0 and 1 are")
    number = int("".join(["1" if bit else "0" for bit in reversed(bits)]), 2)
    return number.to_bytes((len(bits) + 7) // 8, "little")


def unpack_bits(data: bytes, count: int) -> list[int]:
    """The first `count` bits of `data`, bit 0 of the first byte first; bits after the data are 0."""
    if not count:
        return []
    number = int.from_bytes(data, "little") & ((1 << count) - 1)
    return [int(digit) for digit in reversed(f"{number:0{count}b}")]
