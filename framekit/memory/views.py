"""Data in memory's form read as other types: signed, decimal, floating-point numbers, text, in any order of bytes."""

from __future__ import annotations

import struct
import sys
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Literal, get_args

from framekit.codec.support import swap
from framekit.definition.model.services import NUMBER_BITS, UNIT_BITS
from framekit.definition.problems import did_you_mean
from framekit.memory.memory import UNSIGNED_CODES, MemoryValueError, unit_bits

Order = Literal["ABCD", "CDAB", "BADC", "DCBA"]
"""Order of the bytes of 0xAABBCCDD in two words, each written with its high byte first."""

ORDERS: tuple[str, ...] = get_args(Order)
_UNITS = {8: "byte", 16: "word", 32: "dword", 64: "lword"}
_FORMATS = {
    "unsigned": UNSIGNED_CODES,
    "bcd": UNSIGNED_CODES,
    "signed": {bits: code.lower() for bits, code in UNSIGNED_CODES.items()},
    "float": {32: "f", 64: "d"},
}
"""Codes of numbers in `struct`, by their kind and their size in bits."""
_KINDS = {"i": "signed", "u": "unsigned", "f": "float", "b": "bcd"}
_TYPES = {name: (bits, _KINDS[name[0]]) for name, bits in NUMBER_BITS.items()}
VIEWS: tuple[str, ...] = (*_TYPES, "string")
"""The names of the types."""


@dataclass(frozen=True, slots=True)
class NumberView:
    """Numbers of a type. `unit` is the unit of memory that holds one."""

    type: str
    unit: str
    kind: str
    words_reversed: bool
    bytes_swapped: bool

    def read(self, data: bytes) -> list[int] | list[float]:
        """Return the numbers from data in memory's form. Raises MemoryValueError for invalid BCD digits."""
        numbers = [number for (number,) in struct.iter_unpack(f"<{self._code}", self._ordered(data))]
        return as_decimal(numbers, self.unit) if self.kind == "bcd" else numbers

    def write(self, values: Sequence[float]) -> bytes:
        """Convert numbers to memory's form; a fraction is rounded to the nearest float.

        Raises MemoryValueError for a number that does not fit, and for a whole number that a float would change.
        """
        for value in values:
            if not isinstance(value, (int, float)) or (self.kind != "float" and not isinstance(value, int)):
                raise MemoryValueError(f"{value} is no {self.type}")
            if self.kind == "float" and isinstance(value, int) and abs(value) > 1 << 24:
                self._keeps(value)
        numbers = values
        if self.kind == "bcd":
            numbers = from_decimal([int(value) for value in values], self.unit)
        try:
            return self._ordered(struct.pack(f"<{len(numbers)}{self._code}", *numbers))
        except OverflowError as problem:
            raise MemoryValueError(f"a number is too large for a floating-point {self.unit}") from problem
        except struct.error:
            half = 1 << unit_bits(self.unit) - 1
            if self.kind == "signed":
                wrong = next(value for value in numbers if not -half <= value < half)
                what = f"{wrong} does not fit into {unit_bits(self.unit)} bits with sign: {-half} to {half - 1}"
            else:
                what = f"{max(numbers, key=abs)} does not fit into a {self.type}"
            raise MemoryValueError(what) from None

    def _keeps(self, value: int) -> None:
        """Raise MemoryValueError if the float type cannot represent this whole number exactly."""
        code = f"<{self._code}"
        with suppress(OverflowError, struct.error):
            held = int(struct.unpack(code, struct.pack(code, value))[0])
            if held != value:
                raise MemoryValueError(f"{value} has more digits than a {self.type} holds: it would be {held}")

    @property
    def bounds(self) -> tuple[float, float]:
        """Return the least and the greatest representable number."""
        bits = unit_bits(self.unit)
        if self.kind == "float":
            most: float = struct.unpack(">f", b"\x7f\x7f\xff\xff")[0] if bits == 32 else sys.float_info.max
            return -most, most
        if self.kind == "bcd":
            return 0, 10 ** (bits // 4) - 1
        return (-1 << bits - 1, (1 << bits - 1) - 1) if self.kind == "signed" else (0, (1 << bits) - 1)

    @property
    def _code(self) -> str:
        return _FORMATS[self.kind][unit_bits(self.unit)]

    def _ordered(self, data: bytes) -> bytes:
        """Convert between memory's form and elements with their low byte first; the conversion is its own inverse."""
        size = unit_bits(self.unit) // 8
        if size > 1 and self.bytes_swapped:
            data = swap(data, 2)
        if size > 2 and self.words_reversed:
            data = swap(swap(data, size), 2)
        return data


@dataclass(frozen=True, slots=True)
class TextView:
    """Characters, one in each byte. In words the high byte comes first, unless `bytes_swapped`."""

    bytes_swapped: bool
    encoding: str = "latin-1"

    def unit(self, place: str) -> str:
        """Return the unit in which text is transferred at a place of unit `place`."""
        return "byte" if place == "byte" else "word"

    def units(self, characters: int, place: str) -> int:
        """Return the number of units required for this number of characters."""
        return characters if place == "byte" else (characters + 1) // 2

    def read(self, data: bytes, characters: int, place: str) -> str:
        """Return the text from data in memory's form, up to the first 00."""
        return self._ordered(data, place)[:characters].partition(b"\0")[0].decode(self.encoding)

    def write(self, text: str, characters: int, place: str) -> bytes:
        """Convert a text to memory's form, padded with 00. Raises MemoryValueError if it does not fit."""
        try:
            data = text.encode(self.encoding)
        except UnicodeEncodeError as error:
            raise MemoryValueError(f"{error.object[error.start]!r} is no character of {self.encoding}") from None
        if len(data) > characters:
            raise MemoryValueError(f"{text!r} has {len(data)} characters, there is room for {characters}")
        size = self.units(characters, place) * (1 if place == "byte" else 2)
        return self._ordered(data.ljust(size, b"\0"), place)

    def _ordered(self, data: bytes, place: str) -> bytes:
        return data if place == "byte" or self.bytes_swapped else swap(data, 2)


@dataclass(frozen=True, slots=True)
class CountedTextView:
    """Texts in elements of `size` bytes: a word with the number of characters, then the characters, the first in the
    high byte.

    Bytes after the characters are ignored when read, and 00 when written.
    """

    size: int
    encoding: str = "latin-1"

    def read(self, data: bytes) -> list[str]:
        """Return the texts from data in memory's form; a number beyond the element's end counts as the whole
        element.
        """
        elements = [data[at : at + self.size] for at in range(0, len(data), self.size)]
        return [
            swap(one[2:], 2)[: int.from_bytes(one[:2], "little")].decode(self.encoding) for one in elements
        ]  # fmt: skip

    def write(self, texts: Sequence[object]) -> bytes:
        """Convert texts to memory's form. Raises MemoryValueError for a value that is no text, or does not fit."""
        return b"".join(self._element(text) for text in texts)

    def _element(self, text: object) -> bytes:
        if not isinstance(text, str):
            raise MemoryValueError(f"{text!r} is no text")
        try:
            data = text.encode(self.encoding)
        except UnicodeEncodeError as error:
            raise MemoryValueError(f"{error.object[error.start]!r} is no character of {self.encoding}") from None
        room = self.size - 2
        if len(data) > room:
            raise MemoryValueError(f"{text!r} has {len(data)} characters, there is room for {room}")
        return len(data).to_bytes(2, "little") + swap(data.ljust(room, b"\0"), 2)


NUMBER_VIEWS = {name: NumberView(name, _UNITS[bits], kind, False, False) for name, (bits, kind) in _TYPES.items()}
"""The views of numbers with the low word first."""


def view_of(type_: str, order: str | None = None) -> NumberView | TextView:
    """Return the view named in `VIEWS`. Raises ValueError for another name, or an unknown order."""
    if order is not None and order not in ORDERS:
        raise ValueError(f"'{order}' is no order of bytes – write {', '.join(ORDERS)}")
    reversed_, swapped = order in ("ABCD", "BADC"), order in ("BADC", "DCBA")
    if type_ == "string":
        return TextView(swapped)
    if type_ not in _TYPES:
        known = (*UNIT_BITS, *VIEWS)
        hint = did_you_mean(type_, known)
        raise ValueError(f"'{type_}' is not a type – {hint or 'known: ' + ', '.join(known)}")
    bits, kind = _TYPES[type_]
    return NumberView(type_, _UNITS[bits], kind, reversed_, swapped)


def as_signed(values: Iterable[int], unit: str | int) -> list[int]:
    """Convert unsigned values of this unit to signed values (two's complement)."""
    bits = unit_bits(unit)
    half, whole = 1 << (bits - 1), 1 << bits
    return [value - whole if value >= half else value for value in values]


def as_decimal(values: Iterable[int], unit: str | int) -> list[int]:
    """Convert unsigned values of this unit from BCD, four bits a digit. Raises MemoryValueError."""
    texts = [f"{value:0{unit_bits(unit) // 4}X}" for value in values]
    wrong = next((text for text in texts if not text.isdecimal()), None)
    if wrong is not None:
        raise MemoryValueError(f"0x{wrong} is no number in BCD: a digit is 0 to 9")
    return [int(text) for text in texts]


def from_decimal(values: Iterable[int], unit: str | int) -> list[int]:
    """Convert numbers to BCD; the inverse of `as_decimal`.

    Raises MemoryValueError for a number with too many digits.
    """
    digits, result = unit_bits(unit) // 4, []
    for value in values:
        if not 0 <= value < 10**digits:
            raise MemoryValueError(f"{value} does not fit into {digits} decimal digits")
        result.append(int(str(value), 16))
    return result


def float_view(unit: str) -> NumberView:
    """Return the view of dwords or lwords as IEEE 754 numbers of 32 or 64 bits. Raises ValueError for another unit."""
    bits = unit_bits(unit)
    if bits not in _FORMATS["float"]:
        raise ValueError(f"a {unit} holds no floating-point number – only a dword or an lword does")
    return NumberView(f"float{bits}", unit, "float", False, False)
