"""Data in memory's form read as other types: signed numbers, floating-point numbers, text, in any order of bytes.

A view is a reading of the same bits; which transfer brought them, and from where, is not known here.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

from framekit.codec.support import swap
from framekit.definition.model.services import NUMBER_BITS
from framekit.definition.problems import did_you_mean
from framekit.memory.errors import MemoryValueError
from framekit.memory.numbers import (
    UNSIGNED_CODES,
    as_decimal,
    as_float,
    as_signed,
    from_decimal,
    from_float,
    from_signed,
)  # fmt: skip

Order = Literal["ABCD", "CDAB", "BADC", "DCBA"]
"""Where the bytes of 0xAABBCCDD stand in two words, each written with its high byte first."""

ORDERS: tuple[str, ...] = get_args(Order)
_UNITS = {8: "byte", 16: "word", 32: "dword", 64: "lword"}
_FORMATS = {_UNITS[bits]: code for bits, code in UNSIGNED_CODES.items()}
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
        """The numbers in data in memory's form. Raises MemoryValueError for digits that are none."""
        data = self._ordered(data)
        code = _FORMATS[self.unit]
        numbers = [number for (number,) in struct.iter_unpack("<" + code, data)]
        if self.kind == "float":
            return as_float(numbers, self.unit)
        if self.kind == "bcd":
            return as_decimal(numbers, self.unit)
        return as_signed(numbers, self.unit) if self.kind == "signed" else numbers

    def write(self, values: Sequence[float]) -> bytes:
        """Memory's form of the numbers. Raises MemoryValueError for one that does not fit."""
        for value in values:
            if not isinstance(value, (int, float)) or (self.kind != "float" and not isinstance(value, int)):
                raise MemoryValueError(f"{value!r} is no {self.type}")
        if self.kind == "float":
            numbers = from_float(values, self.unit)
        elif self.kind == "bcd":
            numbers = from_decimal([int(value) for value in values], self.unit)
        elif self.kind == "signed":
            numbers = from_signed([int(value) for value in values], self.unit)
        else:
            numbers = [int(value) for value in values]
        try:
            return self._ordered(struct.pack(f"<{len(numbers)}{_FORMATS[self.unit]}", *numbers))
        except struct.error:
            raise MemoryValueError(f"{_outside(numbers)} does not fit into a {self.type}") from None

    def _ordered(self, data: bytes) -> bytes:
        """Between memory's form and elements with their low byte first: the same both ways."""
        size = struct.calcsize(_FORMATS[self.unit])
        if size > 1 and self.bytes_swapped:
            data = swap(data, 2)
        if size > 2 and self.words_reversed:
            data = swap(swap(data, size), 2)
        return data


@dataclass(frozen=True, slots=True)
class TextView:
    """Characters, one a byte. In words the high byte comes first, unless `bytes_swapped`."""

    bytes_swapped: bool
    encoding: str = "latin-1"

    def unit(self, place: str) -> str:
        """The unit in which text at a place of that unit is transferred."""
        return "byte" if place == "byte" else "word"

    def units(self, characters: int, place: str) -> int:
        """How many of these units hold so many characters."""
        return characters if place == "byte" else (characters + 1) // 2

    def read(self, data: bytes, characters: int, place: str) -> str:
        """The text in data in memory's form, up to the first 00."""
        return self._ordered(data, place)[:characters].partition(b"\0")[0].decode(self.encoding)

    def write(self, text: str, characters: int, place: str) -> bytes:
        """Memory's form of the text, filled up with 00. Raises MemoryValueError for one that does not fit."""
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
    """Texts in elements of `size` bytes: a word with the number of characters, then these, the first in the high byte.

    What is behind them is not looked at, and 00 when written.
    """

    size: int
    encoding: str = "latin-1"

    def read(self, data: bytes) -> list[str]:
        """The texts in data in memory's form; a number beyond the element's end counts as all of it."""
        elements = [data[at : at + self.size] for at in range(0, len(data), self.size)]
        return [
            swap(one[2:], 2)[: int.from_bytes(one[:2], "little")].decode(self.encoding) for one in elements
        ]  # fmt: skip

    def write(self, texts: Sequence[object]) -> bytes:
        """Memory's form of the texts. Raises MemoryValueError for what is none, or does not fit."""
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


def view_of(type_: str, order: str | None = None) -> NumberView | TextView:
    """The view of a name of `VIEWS`. Raises ValueError for another name, or an unknown order."""
    if order is not None and order not in ORDERS:
        raise ValueError(f"'{order}' is no order of bytes – write {', '.join(ORDERS)}")
    reversed_, swapped = order in ("ABCD", "BADC"), order in ("BADC", "DCBA")
    if type_ == "string":
        return TextView(swapped)
    if type_ not in _TYPES:
        hint = did_you_mean(type_, VIEWS)
        raise ValueError(f"'{type_}' is not a type – {hint or 'known: ' + ', '.join(VIEWS)}")
    bits, kind = _TYPES[type_]
    return NumberView(type_, _UNITS[bits], kind, reversed_, swapped)


def _outside(numbers: Sequence[int]) -> int:
    return max(numbers, key=abs)
