"""The own memory at the places of a run: pieces in memory's form, stored completely or not at all; fields of frames."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from decimal import Decimal
from functools import partial
from typing import Any

from framekit.definition.model.frames import Frame, flat
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.segments import Bits, BitsPart, Count, Data, Field, FieldType, Length, Segment, Value
from framekit.definition.model.services import AddressForm, AreaModel
from framekit.definition.model.values import Table
from framekit.link.addresses import Address, AddressError, AddressGrammar
from framekit.link.packing import memory_of_numbers, numbers_of
from framekit.memory.memory import AccessError, DeviceMemory, DeviceMemoryError, MemoryRangeError, unit_bits
from framekit.memory.profile import MemoryProfile
from framekit.memory.views import NumberView, view_of
from framekit.run.model import Block, OwnPlace

Piece = tuple[OwnPlace, int, bytes]
"""A place, the number of bits from there on, and their content in memory's form."""

_LIKE_AN_ADDRESS = re.compile(r"%?\w[\w.:/]*")


class OwnAddresses(AddressGrammar):
    """The addresses of a memory: the address forms and the named places of its profile."""

    def __init__(
        self, forms: Sequence[AddressForm], areas: Mapping[str, AreaModel], tables: Mapping[str, Table],
        names: Mapping[str, str],
    ) -> None:  # fmt: skip
        super().__init__(forms, areas, tables)
        self._names = names

    def parse(self, text: str, unit: str | None = None, *, check: bool = True) -> Address:
        """Parse an address of the grammar, or the name of an address."""
        return super().parse(self._names.get(text.strip(), text), unit, check=check)


class AnyAddresses(OwnAddresses):
    """A substitute for the addresses of a memory whose profile is wrong: accept every text that looks like an address.

    It allows the loader to check the rest of the file.
    """

    def __init__(self) -> None:
        super().__init__((), {}, {}, {})

    def parse(self, text: str, unit: str | None = None, *, check: bool = True) -> Address:
        """Return a place of the widest type. Raise AddressError for text with blanks or operators."""
        text = text.strip()
        if _LIKE_AN_ADDRESS.fullmatch(text) is None:
            raise AddressError(f"'{text}' is not an address – write it as one word")
        return Address("", unit or "lword", 0, text, type="float64")

    def check(self, address: Address, count: int = 1) -> None:
        """Accept every place."""


class ProtocolAddresses(AddressGrammar):
    """The addresses of a memory that has the areas of a protocol; `sizes` overrides the sizes of areas.

    Each area has the name of its `memory` key; the result `memory` of an address form overrides this name.
    """

    def __init__(self, protocol: Protocol, sizes: Mapping[str, AreaModel] | None = None) -> None:
        super().__init__(protocol.addresses, protocol.areas, protocol.tables)
        self._memory = {name: area.memory for name, area in protocol.areas.items()}
        self._there = {area.memory: area for area in protocol.areas.values()} | dict(protocol.areas) | dict(sizes or {})

    def place(self, text: str, unit: str | None = None) -> Address:
        """Return the place in memory, without a check that it exists; its part `area` is the area of the protocol."""
        address = super().parse(text, unit, check=False)
        memory = str(address.parts.get("memory") or self._memory[address.area])
        return replace(address, area=memory, parts={**address.parts, "area": address.area})

    def parse(self, text: str, unit: str | None = None, *, check: bool = True) -> Address:
        """Parse an address of the grammar; its `area` is the area of the memory."""
        address = self.place(text, unit)
        if check:
            self.check(address)
        return address

    def check(self, address: Address, count: int = 1) -> None:
        """Check a place like a grammar. Raises AddressError also for an area that the memory does not have."""
        area = self._there.get(address.area)
        if area is None or not area.size:
            what = f"{address} is in {address.area}, which this memory does not have"
            raise AddressError(f"{what} – say under 'sizes' how many elements it has")
        self.check_in(area, address, count)


def addresses_of(profile: MemoryProfile) -> OwnAddresses:
    """Return the addresses of a memory with this profile."""
    names = {name: place.address for name, place in profile.named.items()}
    return OwnAddresses(profile.addresses, profile.areas, profile.tables, names)


def read_piece(memory: DeviceMemory, place: OwnPlace, bits: int) -> bytes:
    """Return `bits` bits from a place on, in memory's form. Raise DeviceMemoryError."""
    return piece_reader(memory, place, bits)()


def piece_reader(memory: DeviceMemory, place: OwnPlace, bits: int) -> Callable[[], bytes]:
    """Return a function that reads like `read_piece`. Raise UnknownAreaError."""
    area, first = memory.area(place.address.area), place.address.first_bit
    if first % 8 == 0 and bits % 8 == 0:
        return area.bytes_reader(first // 8, bits // 8)
    return partial(area.read_bits, first, bits)


def piece_writer(
    memory: DeviceMemory, place: OwnPlace, bits: int, *, force: bool = False
) -> Callable[[bytes], None]:  # fmt: skip
    """Return a function that stores `bits` bits, in memory's form, from a place on. Raise DeviceMemoryError.

    `force`: also write to areas that are read-only for others.
    """
    area, first = memory.area(place.address.area), place.address.first_bit
    if area.access == "read" and not force:
        raise AccessError(f"{place.text} is in area {area.name}, which can only be read")
    if first + bits > area.size_bits:
        raise MemoryRangeError(f"{bits} bits from {place.text} on are not in area {area.name}")
    if (first | bits) % 8:
        return partial(area.write_bits, first, bits, force=force)
    return area.bytes_writer(first // 8, bits // 8)


def store_pieces(memory: DeviceMemory, pieces: Sequence[Piece]) -> None:
    """Store all pieces, or none if one of them cannot be stored. Raise DeviceMemoryError."""
    writers = [(piece_writer(memory, place, bits), data) for place, bits, data in pieces]
    for write, data in writers:
        write(data)


FramePart = Data | Field | BitsPart | Length | Count | Value
"""A part of a frame that has a name, and a value that memory can hold."""


def parts_of(segments: Sequence[Segment]) -> Iterator[tuple[str, FramePart]]:
    """Yield the parts of a frame that memory can hold, by name; also parts of wraps, choices and optional segments."""
    for segment in flat(segments):
        if isinstance(segment, Bits):
            yield from ((part.name, part) for part in segment.parts)
        elif isinstance(segment, (Data, Field, Length, Count, Value)):
            yield segment.name, segment


def takes_bytes(part: FramePart) -> bool:
    """Return whether the value is bytes or text, not a number."""
    return isinstance(part, Data) or (isinstance(part, Field) and part.type.kind in ("ascii", "bytes"))


def fixed_bytes(part: FramePart) -> int | None:
    """Return the fixed size of data or text in bytes, or None if the size varies."""
    size = part.type.size if isinstance(part, Field) else part.size if isinstance(part, Data) else None
    return size if isinstance(size, int) else None


def stored_by(block: Block, frames: Mapping[str, Frame]) -> Iterator[tuple[OwnPlace, int]]:
    """Yield the places that a block stores to, each with its number of bits, but not those of commands in memory.

    `frames`: the frames of the protocol of its channel.
    """
    if block.instruction == "read":
        for place, unit in zip(block.places, block.units, strict=False):
            yield place, unit_bits(unit) * (block.count if len(block.units) == 1 else 1)
    for result in block.results:
        yield result.place, result.bits
    if block.instruction == "receive" and block.frame is not None:
        parts = dict(parts_of(frames[block.frame].segments))
        for name, place in block.data.items():
            size = block.sizes.get(name) or fixed_bytes(parts[name]) or 1
            yield place, 8 * size if takes_bytes(parts[name]) else place.address.unit_bits


def mismatch(part: FramePart, place: OwnPlace) -> tuple[str, str] | None:
    """Return why the place cannot hold this part, and what to do; None if it can."""
    bits = place.address.unit_bits
    if takes_bytes(part):
        if place.address.first_bit % 8:
            return f"'{part.name}' is bytes, and {place.text} is in the middle of one", "name a byte or a word"
    elif _is_float(part) and float_bits_of(place.address) != bits:
        return no_fraction(part.name, place)
    return None


def may_overflow(part: FramePart, place: OwnPlace) -> bool:
    """Return whether this field has binary numbers that its place cannot hold."""
    if not isinstance(part, Field) or part.type.kind != "int" or part.limits is not None or part.unit is not None:
        return False
    bounds, type_ = part.type.bounds, place.address.type
    if bounds is None or place.address.unit_bits == 1:
        return False
    view = None if type_ is None else view_of(type_)
    if isinstance(view, NumberView) and view.kind != "float":
        return bounds[0] < view.bounds[0] or bounds[1] > view.bounds[1]
    return (bounds[1] - bounds[0]).bit_length() > place.address.unit_bits


def no_number(part: FramePart | None, value: Any) -> str | None:
    """Return why a field of plain numbers cannot be sent with a value; None if it can, or for another field."""
    if not isinstance(part, Field) or part.values or part.span is None:
        return None
    if not isinstance(value, int):
        return f"'{part.name}' is a number, not {value!r}"
    least, most = part.span
    if least <= value <= most:
        return None
    return f"'{part.name}' is {value}, " + (f"more than {most}" if value > most else f"less than {least}")


def float_bits_of(address: Address) -> int:
    """Return the size of a floating-point number at a place: 32 bits for two words; 0 if the place cannot hold one."""
    if address.type is not None and not address.type.startswith("float"):
        return 0
    return {16: 32, 32: 32, 64: 64}.get(address.unit_bits, 0)


def no_fraction(name: str, place: OwnPlace) -> tuple[str, str]:
    """Return why a place cannot hold a number with a fraction, and what to do."""
    address = place.address
    what = f"'{name}' may have a fraction, and {place.text} is {'of type' if address.type else 'a'} "
    what += address.type or address.unit
    if address.type:
        return what, "name a place of type float32 or float64"
    return what, "name a double word, which holds it as a floating-point number"


# ---- values -----------------------------------------------------------------------------------------------


def to_memory(part: FramePart, place: OwnPlace, value: Any, room: int | None) -> tuple[int, bytes]:
    """Return a value in memory's form, with its number of bits. `room`: the available bytes.

    Raise ValueError for a value that does not fit.
    """
    if takes_bytes(part):
        data = value.encode("latin-1") if isinstance(value, str) else bytes(value)
        size = fixed_bytes(part) if room is None else room
        if size is not None and len(data) > size:
            raise ValueError(f"'{part.name}' came with {len(data)} bytes, there is room for {size}")
        if isinstance(value, str) and size is not None:
            data = data.ljust(size, _pad(part))
        return 8 * len(data), data
    address = place.address
    number = value // _unit(part) if _unit(part) > 1 else value
    return address.unit_bits, stored_numbers(part.name, place, [number], address.unit_bits if _is_float(part) else 0)


def stored_numbers(name: str, place: OwnPlace, values: Sequence[Any], float_bits: int = 0) -> bytes:
    """Return numbers in memory's form, in the type of the place or as floating-point numbers of `float_bits` bits.

    With `float_bits` 0, only numbers that may have a fraction become floating-point numbers, of the 32 or 64 bits of
    the place. `name`: the field, for messages. Raise ValueError for a number that the place cannot hold unchanged.
    """
    address = place.address
    unit, type_ = address.unit, address.type
    if type_ is None and not float_bits and any(isinstance(value, (float, Decimal)) for value in values):
        float_bits = address.unit_bits
        if float_bits_of(address) != float_bits:
            raise ValueError(" – ".join(no_fraction(name, place)))
    if type_ is None and float_bits:
        unit, type_ = f"{'l' if float_bits == 64 else 'd'}word", f"float{float_bits}"
    try:
        return memory_of_numbers(values, unit, type_)
    except ValueError as error:
        raise ValueError(f"'{name}' cannot be stored in {place.text}: {error} – name a place that holds it") from None


def from_memory(part: FramePart, place: OwnPlace, memory: bytes) -> Any:
    """Return the value of a field for sending. Raise ValueError for a fraction where the field is a whole number."""
    if takes_bytes(part):
        if not isinstance(part, Field) or part.type.kind != "ascii":
            return memory
        return memory.rstrip(b"\0").decode("latin-1") if part.type.end is not None else memory.decode("latin-1")
    unit, type_ = place.address.unit, place.address.type
    if _is_float(part):
        type_ = type_ or f"float{place.address.unit_bits}"
    elif type_ is None and isinstance(part, Field) and part.type.signed and place.address.unit_bits > 1:
        type_ = f"int{place.address.unit_bits}"
    found = numbers_of(memory, unit, type_, 1)[0]
    if _is_float(part):
        return found
    if isinstance(found, float):
        if not math.isfinite(found) or int(found) != found:
            raise ValueError(f"{place.text} is {found:g}, and '{part.name}' is a whole number")
        found = int(found)
    return found * _unit(part)


def _unit(part: FramePart) -> int:
    """Return the factor from memory to the value: times are stored in the unit of the wire."""
    return part.unit if isinstance(part, Field) and part.unit else 1


def _is_float(part: FramePart) -> bool:
    return isinstance(part, Field) and part.type.value_kind == "number" and not part.type.is_whole_number


def _pad(part: FramePart) -> bytes:
    type_: FieldType | None = part.type if isinstance(part, Field) else None
    return b"\0" if type_ is None or type_.end is not None else type_.pad or b" "


Read = Callable[[], Any]


class FrameFields:
    """The fields of a SEND block: constants, and readers of the fields that come from memory.

    Raise ValueError if the size of data is not known, UnknownAreaError for a missing area.
    """

    def __init__(self, block: Block, parts: Mapping[str, FramePart], memory: DeviceMemory) -> None:
        self.block = block
        self.constants: dict[str, Any] = dict(block.values or {})
        self.readers = tuple(
            (name, field_reader(parts[name], place, block.sizes.get(name), memory))
            for name, place in block.data.items()
        )

    def read(self) -> dict[str, Any]:
        """Return the present fields. Raise DeviceMemoryError, ValueError."""
        fields = self.constants.copy()
        for name, read in self.readers:
            fields[name] = read()
        return fields


def field_reader(part: FramePart, place: OwnPlace, size: int | None, memory: DeviceMemory) -> Read:
    """Return a function that reads the value of a field from its place; `size`: bytes of a field of variable size."""
    if not takes_bytes(part):
        number = piece_reader(memory, place, place.address.unit_bits)
        return lambda: from_memory(part, place, number())
    if size is None:
        size = fixed_bytes(part)
    if size is None:
        raise ValueError(f"the size of '{part.name}' is not known – give the block size: {{{part.name}: N}}")
    read = piece_reader(memory, place, 8 * size)
    is_text = isinstance(part, Field) and part.type.kind == "ascii"
    return (lambda: from_memory(part, place, read())) if is_text else read


Refresh = Callable[[], None]


class AddressedMemory:
    """`memory('M0', 24)` and `store` of the language on a device memory. Raise ValueError for a missing place.

    With `read_only`, `store` raises ValueError too.
    """

    def __init__(
        self, memory: DeviceMemory, grammar: AddressGrammar, refresh: Refresh = lambda: None, *, read_only: bool = False
    ) -> None:  # fmt: skip
        self.memory = memory
        self.grammar = grammar
        self.refresh = refresh
        self.read_only = read_only

    def as_read_only(self) -> AddressedMemory:
        """Return the same memory without the right to store."""
        return AddressedMemory(self.memory, self.grammar, self.refresh, read_only=True)

    def read(self, address: str, size: int) -> bytes:
        self.refresh()
        place = self._place(address)
        try:
            return self.memory.read_bytes(place.area, place.first_bit // 8, size)
        except DeviceMemoryError as error:
            raise ValueError(str(error)) from None

    def write(self, address: str, data: bytes) -> None:
        if self.read_only:
            raise ValueError(f"{address} can only be read here")
        place = self._place(address)
        try:
            self.memory.write_bytes(place.area, place.first_bit // 8, data, force=True)
        except DeviceMemoryError as error:
            raise ValueError(str(error)) from None

    def _place(self, address: str) -> Address:
        place = self.grammar.parse(address)
        if place.first_bit % 8:
            raise ValueError(f"{address} is in the middle of a byte")
        return place
