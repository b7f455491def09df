"""Typed values at the places of a protocol or a memory: how they travel as elements of transfers, and back.

A type is a unit of memory (`word`) or a view of several bytes (`float32`, `string`); where none is given, the address
says what usually stands there. Language reference, section 10.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from framekit.definition.model.services import COUNTED_STRING, UNIT_BITS
from framekit.link.addresses import AddressGrammar
from framekit.link.packing import memory_of, values_of
from framekit.memory.memory import MemoryValueError, unit_bits
from framekit.memory.views import CountedTextView, NumberView, TextView, view_of

Value = int | float | str
"""What is written."""


class TypedError(ValueError):
    """A type, a count or a value that does not fit a place; the message says what to do."""


@dataclass(frozen=True, slots=True)
class Typed:
    """How `count` values of a type at a place of the unit `place` travel: as `units` × `unit` (None: its own unit)."""

    type: str
    view: NumberView | TextView | CountedTextView | None
    unit: str | None
    units: int
    count: int
    place: str

    @property
    def carrier(self) -> str:
        """The unit of the elements in which they travel."""
        return self.unit or self.place

    @property
    def bits(self) -> int:
        """What they take in all."""
        return self.units * unit_bits(self.carrier)

    @property
    def is_float(self) -> bool:
        """Whether the values are floating-point numbers."""
        return isinstance(self.view, NumberView) and self.view.kind == "float"

    @property
    def bounds(self) -> tuple[float, float] | None:
        """The least and the greatest number that such a place holds; None where it holds texts."""
        if self.view is None:
            return 0, (1 << unit_bits(self.carrier)) - 1
        return self.view.bounds if isinstance(self.view, NumberView) else None

    def values(self, data: bytes, numbers: Sequence[int]) -> list[Any]:
        """The values in what a transfer brought. Raises ValueError for data that hold none of this type."""
        try:
            match self.view:
                case NumberView() | CountedTextView() as view:
                    return list(view.read(data))
                case TextView() as view:
                    return [view.read(data, self.count, self.place)]
        except MemoryValueError as error:
            raise TypedError(f"{error} – read it as {self.carrier}") from None
        return list(numbers)

    def numbers(self, values: Sequence[Value]) -> list[int]:
        """What a transfer carries for the values. Raises TypedError for values that do not fit."""
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
    """How values of a type (None: what the address usually holds) at an address travel. Raises TypedError."""
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
    """How one number at each of several addresses travels: in `unit`, or (None) each in that of its place."""

    each: tuple[Typed, ...]

    @property
    def unit(self) -> str | None:
        units = {how.unit for how in self.each}
        return units.pop() if len(units) == 1 else None

    @property
    def type(self) -> str:
        """The type, or all there are."""
        return ", ".join(dict.fromkeys(how.type for how in self.each))

    def values(self, numbers: Sequence[int]) -> list[Any]:
        """The values in what a transfer brought."""
        return [
            number if how.view is None else how.values(memory_of([number], how.carrier), [number])[0]
            for how, number in zip(self.each, numbers, strict=True)
        ]

    def numbers(self, values: Sequence[Value]) -> list[int]:
        """What a transfer carries for the values. Raises TypedError for values that do not fit."""
        return [how.numbers([value])[0] for how, value in zip(self.each, values, strict=True)]


def typed_at_each(grammar: AddressGrammar, addresses: Sequence[str], type_: str | None, order: str | None) -> TypedEach:
    """As `typed_at`, for one number of each address. Raises TypedError, also for what is no list of addresses."""
    if isinstance(addresses, str) or not addresses:
        raise TypedError(f"several addresses are a list with one at least, not {addresses!r}")
    return TypedEach(tuple(typed_at(grammar, address, type_, order, 1) for address in addresses))


def _hint(address: object) -> str:
    """What to do with an address that is no text."""
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
