"""Typed values of calls: their conversion to units of transfers, and the results of calls."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, Literal, ParamSpec, TypeVar, overload

from framekit.api.errors import ReplyError, RequestError
from framekit.definition.load.reader import parse_number
from framekit.definition.model.services import COUNTED_STRING, NUMBER_BITS, UNIT_BITS
from framekit.link.addresses import Address, AddressGrammar
from framekit.link.packing import PackingError, Typed, TypedEach, Value, memory_of, typed_at, typed_at_each
from framekit.memory.memory import MemoryValueError
from framekit.memory.views import ORDERS as ORDERS
from framekit.memory.views import VIEWS as VIEWS
from framekit.memory.views import NumberView, view_of
from framekit.memory.word_order import likely_with_reversed_words, order_of, reversed_view

T = TypeVar("T")
"""Type of the values: int, float or str."""
P = ParamSpec("P")


@dataclass(slots=True, eq=False)
class Reading(Sequence[T], Generic[T]):
    """Values that were read, in the order of the call: a sequence, equal to a list or tuple of the same values."""

    values: tuple[T, ...]
    type: str
    """Their unit or type."""
    addresses: tuple[str, ...]
    station: Any
    data: bytes
    """The values in the form of device memory: low byte first, bits packed."""
    raw: bytes = b""
    """The bytes of the last reply frame."""

    @property
    def value(self) -> T:
        """Return the first value: the only value if a single element was read."""
        return self.values[0]

    @overload
    def __getitem__(self, index: int) -> T: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[T, ...]: ...
    def __getitem__(self, index: int | slice) -> T | tuple[T, ...]:
        return self.values[index]

    def __len__(self) -> int:
        return len(self.values)

    def __iter__(self) -> Iterator[T]:
        return iter(self.values)

    def __eq__(self, other: object) -> bool:
        if isinstance(other, Reading):
            return self.values == other.values
        if isinstance(other, (list, tuple)):
            return self.values == tuple(other)
        return NotImplemented

    def __hash__(self) -> int:
        return hash(self.values)

    def __repr__(self) -> str:
        return f"Reading({list(self.values)!r}, {self.type} at {', '.join(self.addresses)})"


@dataclass(frozen=True, slots=True)
class Frame:
    """A frame: its name, its fields as decoded by the codec (an inner frame is `{name: fields}`), its bytes.

    `refusal`: code with which a server refuses it.
    """

    name: str
    fields: Mapping[str, Any]
    raw: bytes = b""
    refusal: int | None = None

    def __getitem__(self, name: str) -> Any:
        return self.fields[name]


@dataclass(frozen=True, slots=True)
class Answer:
    """The results of a service."""

    results: Mapping[str, Any] = field(default_factory=dict)
    """The results by their names in the protocol."""
    reply: Frame | None = None
    """The reply frame, which may be a frame inside `raw`."""
    raw: bytes = b""
    """The bytes of the last frame received."""
    names: Mapping[str, str] = field(default_factory=dict)
    """The names of numbers in the results, by place: `{"faults.faults[0].group": "low CPU battery"}`."""

    def __getitem__(self, name: str) -> Any:
        return self.results[name]


IntType = Literal[
    "bit", "byte", "word", "dword", "lword",
    "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64", "bcd16", "bcd32",
]  # fmt: skip
"""Types whose values are int: the units of memory, and numbers with and without sign, also in BCD."""
FloatType = Literal["float32", "float64"]
TextType = Literal["string"]


def typed(grammar: AddressGrammar, address: str, type_: str | None, order: str | None, count: int) -> Typed:
    """Return the conversion for an address, as in `framekit.link.packing`. Raises RequestError."""
    return asked(typed_at, grammar, address, type_, order, count)


def typed_each(grammar: AddressGrammar, addresses: Sequence[str], type_: str | None, order: str | None) -> TypedEach:
    """Return the conversion for one number of each address.

    Raises RequestError, also for a value that is no list of addresses.
    """
    return asked(typed_at_each, grammar, addresses, type_, order)


def asked(make: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
    """Return the result of `make`. Raises RequestError for its ValueError: impossible values, types, addresses."""
    try:
        return make(*args, **kwargs)
    except ValueError as error:
        raise RequestError(str(error)) from None


def answered(read: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
    """Return the result of `read` on a reply. Raises ReplyError for unfit data."""
    try:
        return read(*args, **kwargs)
    except ValueError as error:
        raise ReplyError(str(error), "unfit_reply") from None


def values_given(values: Value | Sequence[Value]) -> list[Value]:
    """Return one value or several as a list. Raises RequestError for an invalid value."""
    if isinstance(values, (int, float, str)):
        return [values]
    if not isinstance(values, Sequence) and not hasattr(values, "__iter__"):
        raise RequestError(f"{values!r} cannot be written – give a number, a text or a list of them")
    return list(values)


# ---- from texts -------------------------------------------------------------------------------------------


def values_at(place: Address, texts: Sequence[str], type_: str | None) -> list[Value]:
    """Return values of a type (None: the usual type of the place) from texts. Raises RequestError."""
    values = [_value_of(text, type_) if type_ else _value_at(place, text) for text in texts]
    _refuse_signs(place.unit, values, type_ or place.type)
    return values


def check_written(
    grammar: AddressGrammar, address: str, texts: Sequence[str], type_: str | None, order: str | None,
    count: int | None,
) -> None:  # fmt: skip
    """Raise RequestError for texts that cannot be written there, regardless of the device."""
    how = typed(grammar, address, type_, order, count or len(texts))
    try:
        memory_of(how.numbers(values_at(grammar.parse(address), texts, type_)), how.carrier)
    except PackingError as error:
        raise RequestError(str(error)) from None


def _refuse_signs(place: str, values: list[Value], type_: str | None) -> None:
    """Refuse negative numbers without a signed type: elements of a memory have no sign.

    Raises RequestError.
    """
    negative = next((value for value in values if isinstance(value, (int, float)) and value < 0), None)
    if negative is None or (type_ is not None and type_ not in UNIT_BITS):
        return
    unit = type_ or place
    bits = UNIT_BITS.get(unit, 0)
    hint = f" – for a number with sign write --type int{bits}" if bits in (8, 16, 32, 64) else ""
    raise RequestError(f"{negative} does not fit into a {unit}: 0 to {(1 << bits) - 1 if bits else '…'}{hint}")


def _value_at(place: Address, text: str) -> Value:
    """Return a value for the usual type of a place from a text; `0x…` is the unconverted element. Raises
    RequestError.
    """
    view = None if place.type not in NUMBER_BITS or "x" not in text.lower() else view_of(str(place.type))
    if not isinstance(view, NumberView):
        return _value_of(text, place.type)
    try:
        return view.read(memory_of([int(_value_of(text, None))], place.unit))[0]
    except (PackingError, MemoryValueError) as error:
        raise RequestError(str(error)) from None


def _value_of(text: str, type_: str | None) -> Value:
    """Return a value from its text. Raises RequestError."""
    if type_ in ("string", COUNTED_STRING):
        return text
    try:
        if type_ in ("float32", "float64"):
            return float(text)
        return parse_number(text)
    except ValueError:
        what = type_ or "whole number"
        hint = (
            "" if type_ in ("float32", "float64") else " – write --type float32 for a fraction, --type string for text"
        )
        raise RequestError(f"'{text}' is no {what}{hint}") from None


def likely_order(type_: str, order: str | None, value: Any) -> tuple[str, float] | None:
    """Return another order of words, and the value in it, if a floating-point value is uncommon and that is common."""
    view = view_of(type_, order) if type_ in VIEWS else None
    if not isinstance(view, NumberView) or view.kind != "float":
        return None
    other = likely_with_reversed_words(view, value)
    return None if other is None else (order_of(reversed_view(view)), other)
