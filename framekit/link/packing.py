"""Convert elements of a transfer between the data bytes of a frame, device memory and typed values.

The intermediate form is memory's own: consecutive little-endian elements, bits packed with the first in bit 0. This
module knows no areas and no frames. Guide: services. Typed values travel as elements of transfers: a type is a unit of
memory (`word`) or a view of several bytes (`float32`, `string`). Without a type, the usual type of the address applies.
Language reference, section 10.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from decimal import Decimal
from functools import cache
from math import isfinite, isinf
from struct import Struct
from typing import Any

from framekit.codec.support import span, swap
from framekit.definition.model.services import COUNTED_STRING, NUMBER_BITS, UNIT_BITS, Packing
from framekit.link.addresses import AddressGrammar
from framekit.memory.memory import UNSIGNED_CODES, MemoryValueError, ordered, pack_bits, unit_bits, unpack_bits
from framekit.memory.views import CountedTextView, NumberView, TextView, view_of

_POINT_EACH = ("byte_each", "digit_each")
"""Forms with a byte for each bit."""
_DIGITS = bytes.maketrans(b"\0\1", b"01")


class PackingError(ValueError):
    """Data bytes or values that do not fit the requested elements."""


WORDS = ("word", "dword", "lword")


class Packer:
    """The conversion of a unit in a packing. Counts and starts are in units.

    `data` are the bytes in the frame, `memory` the same elements in memory's form.
    """

    __slots__ = ("_swapped", "bits", "bits_form", "order", "unit")

    def __init__(self, packing: Packing, unit: str) -> None:
        self.unit = unit
        self.bits = unit_bits(unit)
        self.bits_form = packing.bits
        self.order = "little" if packing.words and unit not in WORDS else packing.order
        self._swapped = self.bits // 8 if self.order == "big" and self.bits in (16, 32, 64) else 0

    def size(self, start: int, count: int) -> int:
        """Return the number of data bytes of `count` elements from `start` on."""
        if self.bits > 1:
            return count * self.bits // 8
        if self.bits_form in _POINT_EACH:
            return count
        if self.bits_form == "nibble_each":
            return (count + 1) // 2
        return span(start, count) if self.bits_form == "aligned" else (count + 7) // 8

    def most(self, start: int, data_bytes: int) -> int:
        """Return how many elements from `start` on fit into so many data bytes."""
        if self.bits > 1:
            return data_bytes * 8 // self.bits
        if self.bits_form in _POINT_EACH:
            return data_bytes
        if self.bits_form == "nibble_each":
            return data_bytes * 2
        return max(0, data_bytes * 8 - (start % 8 if self.bits_form == "aligned" else 0))

    def count_in(self, start: int, data_bytes: int) -> int:
        """Return the number of elements that exactly fill so many data bytes. Raise PackingError if there is none."""
        count = self.most(start, data_bytes)
        if self.size(start, count) != data_bytes:
            raise PackingError(f"{data_bytes} bytes are no whole number of {self.unit} elements")
        return count

    # ---- data bytes and memory ----------------------------------------------------------------------------

    def to_data(self, memory: bytes, start: int, count: int) -> bytes:
        """Return the data bytes of elements in memory's form."""
        if self.bits > 8:
            return swap(memory, self._swapped) if self._swapped else ordered(memory, self.order, self.bits // 8)
        if self.bits == 8 or self.bits_form == "packed":
            return memory
        if self.bits_form in _POINT_EACH:
            points = bytes(unpack_bits(memory, count))
            return points.translate(_DIGITS) if self.bits_form == "digit_each" else points
        if self.bits_form == "nibble_each":
            points = bytes(unpack_bits(memory, count))
            return bytes.fromhex(points.translate(_DIGITS).decode() + "0" * (count % 2))
        shifted = int.from_bytes(memory, "little") << start % 8
        return shifted.to_bytes(span(start, count), "little")

    def reader(self, start: int, count: int) -> Callable[[bytes], bytes]:
        """Return a function like `to_memory` for these elements that takes less work at each call."""
        if not self._swapped:
            return lambda data: self.to_memory(data, start, count)
        size, code = self.size(start, count), UNSIGNED_CODES[self.bits]

        def read(data: bytes) -> bytes:
            if len(data) != size:
                return self.to_memory(data, start, count)
            elements = array(code, data)
            elements.byteswap()
            return elements.tobytes()

        return read

    def to_memory(self, data: bytes, start: int, count: int) -> bytes:
        """Return the elements in memory's form; unused bits are 0.

        Raise PackingError for data of another size than `size(start, count)`, and for a nibble or digit, or a byte that
        stands for a bit, that is neither 0 nor 1.
        """
        wanted = count * self.bits // 8 if self.bits > 1 else self.size(start, count)
        if len(data) != wanted:
            raise PackingError(f"{count} × {self.unit} take {wanted} bytes, not {len(data)}")
        if self.bits > 8:
            return swap(data, self._swapped) if self._swapped else ordered(data, self.order, self.bits // 8)
        if self.bits == 8:
            return data
        if self.bits_form == "byte_each":
            return _packed(list(data))
        if self.bits_form == "digit_each":
            return _from_digits(data.decode("latin-1"))
        if self.bits_form == "nibble_each":
            return _from_digits(data.hex()[:count])  # an odd number of points is padded to a byte
        number = int.from_bytes(data, "little") >> (start % 8 if self.bits_form == "aligned" else 0)
        return (number & ((1 << count) - 1)).to_bytes((count + 7) // 8, "little")


class Packers(dict[str, Packer]):
    """The packers of a packing by unit, each created on first use."""

    def __init__(self, packing: Packing) -> None:
        super().__init__()
        self._packing = packing

    def __missing__(self, unit: str) -> Packer:
        packer = self[unit] = Packer(self._packing, unit)
        return packer


def in_unit(memory: bytes, order: str, one: str, other: str) -> bytes:
    """Convert elements of a unit in memory's form to elements of another unit, for an area of this order."""
    if order == "little" or one == other:
        return memory
    return ordered(ordered(memory, order, unit_bits(one) // 8), order, unit_bits(other) // 8)


def cut_memory(memory: bytes, first_bit: int, bits: int) -> bytes:
    """Return `bits` bits of data in memory's form, from bit `first_bit` on."""
    if first_bit % 8 == 0 and bits % 8 == 0:
        return memory[first_bit // 8 : (first_bit + bits) // 8]
    number = int.from_bytes(memory, "little") >> first_bit & ((1 << bits) - 1)
    return number.to_bytes((bits + 7) // 8, "little")


def join_memory(pieces: Sequence[tuple[bytes, int]]) -> bytes:
    """Join pieces of memory's form, each with its number of bits, without gaps."""
    if all(bits % 8 == 0 for _, bits in pieces[:-1]):
        return b"".join([data for data, _ in pieces])
    number = place = 0
    for data, bits in pieces:
        number |= int.from_bytes(data, "little") << place
        place += bits
    return number.to_bytes((place + 7) // 8, "little")


def values_of(memory: bytes, unit: str, count: int) -> list[int]:
    """Return elements in memory's form as unsigned numbers."""
    return list(reader_of(unit, count)(memory))


def reader_of(unit: str, count: int) -> Callable[[bytes], Iterable[int]]:
    """Return a function like `values_of` for so many elements, for repeated use."""
    bits = unit_bits(unit)
    if bits == 1:
        return lambda memory: unpack_bits(memory, count)
    size = bits // 8
    form = UNSIGNED_CODES.get(bits)
    if form is not None:
        return Struct(f"<{count}{form}").unpack_from
    places = range(0, count * size, size)
    return lambda memory: [int.from_bytes(memory[at : at + size], "little") for at in places]


def memory_of(values: Sequence[int], unit: str) -> bytes:
    """Return unsigned numbers, or negative numbers as two's complement, in memory's form. Raise PackingError."""
    bits = unit_bits(unit)
    if bits == 1:
        return _packed(values)
    least, most = -(1 << bits - 1), (1 << bits) - 1
    for value in values:
        if not isinstance(value, int) or not least <= value <= most:
            raise PackingError(f"{value!r} does not fit into a {unit}: 0 to {most}")
    return b"".join([(value & most).to_bytes(bits // 8, "little") for value in values])


def numbers_of(memory: bytes, unit: str, type_: str | None, count: int) -> list[Any]:
    """Return elements in memory's form as numbers of `type_`, unsigned without a type.

    Raise PackingError for invalid digits.
    """
    view = _view_of(unit, type_)
    if view is None:
        return values_of(memory, unit, count)
    try:
        numbers = view.read(memory)
    except MemoryValueError as error:
        raise PackingError(str(error)) from None
    return [shortest(number) for number in numbers] if type_ == "float32" else list(numbers)


def memory_of_numbers(numbers: Sequence[Any], unit: str, type_: str | None) -> bytes:
    """Return numbers in memory's form, as the reverse of `numbers_of`; only floating-point numbers hold fractions.

    Raise PackingError.
    """
    view = _view_of(unit, type_)
    if view is None:
        return memory_of([_whole(number, unit) for number in numbers], unit)
    as_held = _float if view.kind == "float" else _whole
    try:
        return view.write([as_held(number, view.type) for number in numbers])
    except MemoryValueError as error:
        raise PackingError(str(error)) from None


_FLOAT = Struct("<f")


def shortest(number: float) -> float:
    """Return the number with the fewest digits and the same value in 32 bits: 12.3, not 12.300000190734863."""
    short = (float(f"{number:.{digits}g}") for digits in range(6, 9))
    return next((one for one in short if _FLOAT.pack(one) == _FLOAT.pack(number)), number)


def _float(number: Any, kind: str) -> float:
    """Return a number for a view of floats. Raise PackingError for a non-number, or a number that is too large."""
    if isinstance(number, (int, float)):
        return number
    if isinstance(number, Decimal):
        with suppress(OverflowError):
            if not isinf(found := float(number)):
                return found
    raise PackingError("a value is not there" if number is None else f"{number} does not fit into a {kind}")


def _whole(number: Any, kind: str) -> int:
    """Return a number as an integer. Raise PackingError for a non-number, or a number with a fraction."""
    if isinstance(number, int):
        return number
    if isinstance(number, (Decimal, float)) and isfinite(number) and number == int(number):
        return int(number)
    raise PackingError("a value is not there" if number is None else f"{number} is no whole number, as a {kind} is")


@cache
def _view_of(unit: str, type_: str | None) -> NumberView | None:
    """Return the view of a type, if its numbers are as wide as the elements of this unit."""
    if type_ is None or NUMBER_BITS.get(type_) != unit_bits(unit):
        return None
    view = view_of(type_)
    return view if isinstance(view, NumberView) else None


def _packed(bits: Sequence[int]) -> bytes:
    try:
        return pack_bits(bits)
    except MemoryValueError as error:
        raise PackingError(str(error)) from None


def _from_digits(digits: str) -> bytes:
    """Return bits in memory's form from their digits, the first digit first."""
    if digits.strip("01"):
        wrong = next(digit for digit in digits if digit not in "01")
        raise PackingError(f"{wrong!r} is not a bit – only 0 and 1 are")
    return int(digits[::-1] or "0", 2).to_bytes((len(digits) + 7) // 8, "little")


# ---- typed values ------------------------------------------------------------------------------------------


Value = int | float | str
"""A value to write."""


class TypedError(ValueError):
    """A type, a count or a value that does not fit a place; the message includes a hint."""


@dataclass(frozen=True, slots=True)
class Typed:
    """The encoding of `count` values of a type: `units` elements of `unit` (None: the unit of the place, `place`)."""

    type: str
    view: NumberView | TextView | CountedTextView | None
    unit: str | None
    units: int
    count: int
    place: str

    @property
    def carrier(self) -> str:
        """Return the unit of the elements of the transfer."""
        return self.unit or self.place

    @property
    def bits(self) -> int:
        """Return the size of all values in bits."""
        return self.units * unit_bits(self.carrier)

    @property
    def is_float(self) -> bool:
        """Return whether the values are floating-point numbers."""
        return isinstance(self.view, NumberView) and self.view.kind == "float"

    @property
    def bounds(self) -> tuple[float, float] | None:
        """Return the least and the greatest number of the type; None for texts."""
        if self.view is None:
            return 0, (1 << unit_bits(self.carrier)) - 1
        return self.view.bounds if isinstance(self.view, NumberView) else None

    def values(self, data: bytes, numbers: Sequence[int]) -> list[Any]:
        """Return the values in the data of a transfer. Raise ValueError for data that do not hold this type."""
        if self.view is None:
            return list(numbers)
        try:
            match self.view:
                case NumberView() | CountedTextView() as view:
                    return list(view.read(data))
                case TextView() as view:
                    return [view.read(data, self.count, self.place)]
        except MemoryValueError as error:
            raise TypedError(f"{error} – read it as {self.carrier}") from None

    def numbers(self, values: Sequence[Value]) -> list[int]:
        """Return the elements of a transfer for the values. Raise TypedError for values that do not fit."""
        try:
            match self.view:
                case NumberView() as view:
                    return values_of(view.write(_numbers(values, self.type)), view.unit, len(values))
                case CountedTextView() as view:
                    return values_of(view.write(values), self.place, len(values))
                case TextView() as view:
                    data = view.write(_text(values), self.count, self.place)
                    return values_of(data, view.unit(self.place), self.units)
        except MemoryValueError as error:
            raise TypedError(str(error)) from None
        found = _numbers(values, self.type)
        if any(isinstance(value, float) for value in found):
            raise TypedError(f"a {self.type} holds no floating-point number – give a type such as float32")
        return [int(value) for value in found]


def typed_at(grammar: AddressGrammar, address: str, type_: str | None, order: str | None, count: int) -> Typed:
    """Return the encoding of values at an address. Raise TypedError.

    `type_`: the type of the values; default: the usual type of the address.
    """
    if not isinstance(address, str):
        raise TypedError(f"an address is a text: {_hint(address)}")
    if not isinstance(count, int):
        raise TypedError(f"count is {count!r}: it is a whole number")
    try:
        where = grammar.parse(address)
        place, type_ = where.unit, type_ or where.type
        if type_ == COUNTED_STRING and type_ == where.type and order is None:
            return Typed(type_, CountedTextView(where.unit_bits // 8), None, count, count, place)
        if type_ is None or _is_unit(type_):
            if order is not None:
                raise ValueError(f"order= is for numbers and text – give a type, such as uint32, not {type_ or 'none'}")
            return Typed(type_ or place, None, type_, count, count, place)
        view = view_of(type_, order)
    except ValueError as error:
        raise TypedError(str(error)) from None
    if isinstance(view, TextView):
        if place not in UNIT_BITS:  # its octets are a structure, which text would overwrite
            todo = "leave the type out" if where.type == COUNTED_STRING else "write its bytes as a number"
            raise TypedError(f"{address} is an element of {place} with a form of its own – {todo}")
        return Typed(type_, view, view.unit(place), view.units(count, place), count, place)
    return Typed(type_, view, view.unit, count, count, place)


@dataclass(frozen=True, slots=True)
class TypedEach:
    """The encoding of a number at each of several addresses."""

    each: tuple[Typed, ...]

    @property
    def unit(self) -> str | None:
        """Return the common unit of the transfer, or None if each place is transferred in its own unit."""
        units = {how.unit for how in self.each}
        return units.pop() if len(units) == 1 else None

    @property
    def type(self) -> str:
        """Return the type, or all different types."""
        return ", ".join(dict.fromkeys(how.type for how in self.each))

    def values(self, numbers: Sequence[int]) -> list[Any]:
        """Return the values in the elements of a transfer."""
        return [
            number if how.view is None else how.values(memory_of([number], how.carrier), [number])[0]
            for how, number in zip(self.each, numbers, strict=True)
        ]

    def numbers(self, values: Sequence[Value]) -> list[int]:
        """Return the elements of a transfer for the values. Raise TypedError for values that do not fit."""
        return [how.numbers([value])[0] for how, value in zip(self.each, values, strict=True)]


def typed_at_each(grammar: AddressGrammar, addresses: Sequence[str], type_: str | None, order: str | None) -> TypedEach:
    """Return the encoding of one number at each address, as `typed_at` does. Raise TypedError, also for a non-list."""
    if isinstance(addresses, str) or not addresses:
        raise TypedError(f"several addresses are a list with one at least, not {addresses!r}")
    return TypedEach(tuple(typed_at(grammar, address, type_, order, 1) for address in addresses))


def _hint(address: object) -> str:
    """Return how to write an address that is not a text."""
    if isinstance(address, int):
        return f"write '{address}'"
    return f"{address!r} is none – several have read_many and write_many"


def _is_unit(name: str) -> bool:
    try:
        return unit_bits(name) > 0
    except ValueError:
        return False


def _numbers(values: Sequence[Value], type_: str) -> list[int | float]:
    found: list[int | float] = []
    for value in values:
        if isinstance(value, str):
            raise TypedError(f"{value!r} is no {type_} – text has the type string")
        found.append(value)
    return found


def _text(values: Sequence[Value]) -> str:
    if len(values) != 1 or not isinstance(values[0], str):
        raise TypedError("a string is written as one text")
    return values[0]
