"""The areas of a protocol as places in the memory of a device: mapped, with a base, or built from state.

Bit areas may be in word memory and the reverse: offsets are bits over the whole area. Data are in memory's form. The
address keys of a definition (area, memory, code or text, with unit, start and count) name places here and on the other
side. Guide: areas, serving.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from framekit.definition.model.protocol import Protocol
from framekit.definition.model.services import AreaModel, held_type
from framekit.link.addresses import Address, AddressGrammar, code_of
from framekit.link.frame_table import ProtocolCodec
from framekit.link.packing import cut_memory
from framekit.link.values import Names
from framekit.memory.memory import AccessError, DeviceMemory, MemoryRangeError, UnknownAreaError, ordered, unit_bits
from framekit.memory.memory import Area as MemoryArea

OWN = "own"
"""The name for the memory area's own unit."""

MOST_UNITS = 4096
"""The limit of cached areas with their units: requests may name any number of units."""

Written = Callable[["AreaUnit", int, int, bytes, bytes], None]
"""Receive a write: area, first element, number of elements, and their data before and after, in memory's form."""

Kept = Callable[[str, Any, Any], None]
"""Receive a change of a variable of the device by a request: its name, and its value before and after."""

Codes = dict[Any, list[tuple[str, str]]]
"""The codes of areas on the wire, each with the areas that have it and the units they count in."""


@dataclass(frozen=True, slots=True)
class Span:
    """`count` elements of `unit` from `start` on, of an area of a protocol or, with `area` None, of a memory area."""

    area: str | None
    memory: str
    unit: str
    start: int
    count: int

    def language_attribute(self, name: str) -> Any:
        """Return the key `name` of the span. Raise KeyError for another name."""
        if name not in self.__slots__:
            raise KeyError(name)
        return getattr(self, name)


class AreaUnit:
    """An area counted in a unit. Methods raise DeviceMemoryError for missing elements and forbidden writes.

    `read` and `write` require elements that `check` has accepted.
    """

    __slots__ = (
        "_device", "_order", "area", "bits", "build", "is_plain", "memory", "most", "name", "offset", "read_only",
        "shift", "there", "type", "unit",
    )  # fmt: skip

    def __init__(
        self, model: AreaModel | None, device: DeviceMemory, memory: str, unit: str, offset: int = 0,
        build: Callable[[Names], bytes] | None = None, *, read_only: bool = False, type_: str | None = None,
        shift: int = 0,
    ) -> None:  # fmt: skip
        self.read_only = read_only
        """Whether all writes are forbidden."""
        self.name = None if model is None else model.name
        self.type = type_
        """The usual type of the elements."""
        self.area = model
        self.memory = memory
        self.unit = unit
        self.bits = unit_bits(unit)
        self._device = device
        self.there = there = device.area(memory) if memory in device else None
        self.shift = shift
        """The distance in bits by which all elements are shifted, for example for words at odd bytes."""
        self.offset = offset = offset + shift
        self.build = build
        """Return the bytes of an area that is built from state; None for an area in memory."""
        kept = "little" if there is None else there.order
        self._order = kept if model is None else model.order
        same = self._order == kept or (build is not None)
        self.is_plain = (
            self._order == kept == "little"
            or (same and self.bits <= 8)
            or (kept == "little" and build is None and self.bits == 16)
        )
        """Whether its bytes are those of the memory, in the same order."""
        self.most = 0
        """The number of elements that can be read without a check, from bit `offset` of `there` on; 0 if a check is
        necessary."""
        if build is None and there is not None and offset <= there.size_bits:
            whole = there.size_bits - offset
            self.most = (whole if model is None else min(whole, model.size * model.element_bits - shift)) // self.bits

    def span(self, start: int, count: int) -> Span:
        """Return a span of this area."""
        return Span(self.name, self.memory, self.unit, start, count)

    def check(self, start: int, count: int, write: bool) -> None:
        """Raise DeviceMemoryError if these elements cannot be read, or written."""
        area = self.area
        first, end = start * self.bits, (start + count) * self.bits
        if count < 1 or first < 0 or (area is not None and end + self.shift > area.size * area.element_bits):
            raise MemoryRangeError(f"{count} × {self.unit} from {start} on is not in area {self.name}")
        if area is not None and write and (area.access == "read" or self.build is not None):
            raise AccessError(f"area {area.name} can only be read")
        if self.build is None:
            there = self.present()
            if self.offset + end > there.size_bits:
                raise MemoryRangeError(f"{count} × {self.unit} from {start} on is not in area {there.name}")
            if write and (self.read_only or there.access == "read"):
                raise AccessError(f"area {there.name} can only be read")

    def present(self) -> MemoryArea:
        """Return the memory area. Raise UnknownAreaError if the device does not have it."""
        return self.there or self._device.area(self.memory)

    def read(self, start: int, count: int, names: Names) -> bytes:
        """Return the elements in memory's form. `names`: the state for an area that is built from state."""
        first, count = self.offset + start * self.bits, count * self.bits
        if not self.is_plain:
            return ordered(self._read(first, count, names), self._order, self.bits // 8)
        if self.build is not None:
            return cut_memory(self.build(names), first, count)
        there = self.present()
        if first % 8 == 0 and count % 8 == 0:
            return there.read_bytes(first // 8, count // 8)
        return there.read_bits(first, count)

    def write(self, start: int, count: int, data: bytes) -> None:
        """Write elements in memory's form."""
        first, count = self.offset + start * self.bits, count * self.bits
        there = self.present()
        if not self.is_plain:
            self._write(there, first, count, ordered(data, self._order, self.bits // 8))
            return
        if first % 8 == 0 and count % 8 == 0:
            there.write_bytes(first // 8, data)
        else:
            there.write_bits(first, count, data)

    def _read(self, first: int, bits: int, names: Names) -> bytes:
        """Return bits in the byte order of the area; the memory may keep the bytes of a word in another order."""
        if self.build is not None:
            return cut_memory(self.build(names), first, bits)
        there = self.present()
        if there.order == self._order:
            return there.read_bits(first, bits)
        return cut_memory(self._words(there, first, bits), first % 16, bits)

    def _words(self, there: MemoryArea, first: int, bits: int) -> bytes:
        """Return the whole words that contain these bits, in the byte order of the area."""
        start, end = first // 16 * 16, min(-(-(first + bits) // 16) * 16, there.size_bits)
        return self._turned(there, there.read_bits(start, end - start))

    def _turned(self, there: MemoryArea, words: bytes) -> bytes:
        """Swap words between the byte orders of memory and area; half a word at the end of the memory is copied."""
        whole = len(words) // 2 * 2
        return ordered(ordered(words[:whole], there.order, 2), self._order, 2) + words[whole:]

    def _write(self, there: MemoryArea, first: int, bits: int, data: bytes) -> None:
        if there.order == self._order:
            there.write_bits(first, bits, data)
            return
        words = self._words(there, first, bits)
        mask = ((1 << bits) - 1) << first % 16
        number = int.from_bytes(words, "little") & ~mask | int.from_bytes(data, "little") << first % 16
        whole = self._turned(there, number.to_bytes(len(words), "little"))
        start = first // 16 * 16
        there.write_bits(start, min(len(whole) * 8, there.size_bits - start), whole)


class ToldUnit(AreaUnit):
    """The same area; it reports every write with the data before and after."""

    __slots__ = ("_told",)

    def __init__(self, unit: AreaUnit, told: Written) -> None:
        for name in AreaUnit.__slots__:
            setattr(self, name, getattr(unit, name))
        self._told = told

    def write(self, start: int, count: int, data: bytes) -> None:
        none = Names()
        before = self.read(start, count, none)
        super().write(start, count, data)
        self._told(self, start, count, before, self.read(start, count, none))


class DeviceAreas:
    """Access to the memory of a device through the areas of a protocol.

    `mapping` moves areas of the protocol: area → memory area, and the position of element 0 in it, in the units of the
    area. With `read_only` all writes are forbidden. `written` receives every write, `kept` every variable of the device
    that a request changes. Methods raise DeviceMemoryError for missing places and forbidden writes.
    """

    def __init__(
        self,
        protocol: Protocol,
        codec: ProtocolCodec,
        memory: DeviceMemory,
        mapping: Mapping[str, tuple[str, int]] | None = None,
        *,
        read_only: bool = False,
        written: Written | None = None,
        kept: Kept | None = None,
    ) -> None:
        self.kept = kept
        self.areas = protocol.areas
        self._forms = protocol.addresses
        self.read_only = read_only
        self.written = written
        self.codec = codec
        self.memory = memory
        self.mapping = dict(mapping or {})
        self._units: dict[tuple[str, str | None, int], AreaUnit] = {}
        self._records = {
            variable.layout: name
            for name, variable in protocol.state.items()
            if variable.layout is not None and variable.type == "record" and variable.keys is None
        }

    def unit(self, area: str, unit: str | None = None, shift: int = 0) -> AreaUnit:
        """Return an area of the protocol counted in a unit (default: its own), shifted by `shift` bits.

        Raise UnknownAreaError.
        """
        found = self._units.get((area, unit, shift))
        if found is None:
            model = self.areas.get(area)
            if model is None:
                raise UnknownAreaError(f"there is no area '{area}'")
            memory, first = self.mapping.get(area, (model.memory, 0))
            if model.layout is None:
                found = self._made(model, memory, unit or model.unit, first * model.element_bits, shift=shift)
            else:
                found = self._made(model, memory, unit or model.unit, 0, self._builder(model), shift=shift)
            if len(self._units) < MOST_UNITS:
                self._units[area, unit, shift] = found
        return found

    def own_unit(self, memory: str, unit: str | None = None) -> AreaUnit:
        """Return a memory area by its own name, counted in a unit. Raise UnknownAreaError."""
        own = self.memory.area(memory).unit
        return self._made(None, memory, own if unit in (None, OWN) else str(unit))

    def _made(
        self, model: AreaModel | None, memory: str, unit: str, offset: int = 0,
        build: Callable[[Names], bytes] | None = None, *, shift: int = 0,
    ) -> AreaUnit:  # fmt: skip
        type_ = None if model is None else held_type(self._forms, model, unit)
        made = AreaUnit(
            model, self.memory, memory, unit, offset, build, read_only=self.read_only, type_=type_, shift=shift
        )
        return made if self.written is None else ToldUnit(made, self.written)

    def _builder(self, area: AreaModel) -> Callable[[Names], bytes]:
        """Return a function that builds the bytes of an area from its layout and the record with this layout.

        Without such a record, the layout has no values but its own formulas.
        """
        layout = area.layout
        assert layout is not None
        record, encode = self._records.get(layout), self.codec.layouts[layout][0]
        size = (area.size * area.element_bits + 7) // 8

        def build(names: Names) -> bytes:
            data = encode({} if record is None else dict(names[record]), names)
            return data[:size].ljust(size, b"\0")

        return build

    # ---- places -------------------------------------------------------------------------------------------

    def own_bytes(self, memory: str) -> int:
        """Return the bytes of an element of a memory area; 0 for bits. Raise UnknownAreaError."""
        return unit_bits(self.memory.area(memory).unit) // 8

    def at(self, span: Span) -> AreaUnit:
        """Return the area of a span. Raise UnknownAreaError."""
        return self.own_unit(span.memory, span.unit) if span.area is None else self.unit(span.area, span.unit)

    def check(self, span: Span, *, write: bool) -> None:
        """Raise DeviceMemoryError if the span cannot be read, or written."""
        self.at(span).check(span.start, span.count, write)

    # ---- access -------------------------------------------------------------------------------------------

    def read(self, span: Span, names: Names) -> bytes:
        """Return the elements in memory's form. `names`: the state for an area that is built from state."""
        there = self.at(span)
        there.check(span.start, span.count, False)
        return there.read(span.start, span.count, names)

    def write(self, span: Span, data: bytes) -> None:
        """Write elements in memory's form."""
        there = self.at(span)
        there.check(span.start, span.count, True)
        there.write(span.start, span.count, data)


# ---- places by the address keys of a definition ---------------------------------------------------------------


def codes_of(protocol: Protocol) -> Codes:
    """Return the codes of areas on the wire, with the areas and the unit each of them counts in."""
    codes: Codes = {}
    for area in protocol.areas.values():
        for unit in dict.fromkeys((*area.codes, area.unit)):
            code = code_of(area, unit)
            if code is not None:
                codes.setdefault(code, []).append((area.name, unit))
    return codes


def span_of(areas: DeviceAreas, grammar: AddressGrammar, codes: Codes, given: Mapping[str, Any]) -> Span:
    """Return the span in the device's memory that the address keys name. Raise UnknownAreaError."""
    start, count, unit = int(given.get("start", 0)), int(given.get("count", 1)), given.get("unit")
    if "memory" in given:
        return areas.own_unit(str(given["memory"]), unit).span(start, count)
    if "text" in given:
        address = grammar.parse(str(given["text"]), unit, check=False)
        if address.shift:
            raise MemoryRangeError(f"{address} does not begin at a whole {address.unit}")
        return areas.unit(address.area, address.unit).span(address.start + start, count)
    if "code" in given:
        area, own = _coded(codes, given["code"])
        return areas.unit(area, unit or own).span(start, count)
    return areas.unit(str(given["area"]), unit).span(start, count)


def address_of(grammar: AddressGrammar, codes: Codes, given: Mapping[str, Any]) -> Address:
    """Return the address on the other side that the address keys name. Raise UnknownAreaError and AddressError."""
    start, unit = int(given.get("start", 0)), given.get("unit")
    if "text" in given:
        address = grammar.parse(str(given["text"]), unit, check=False)
        return address if start == 0 else grammar.advance(address, start)
    area, own = _coded(codes, given["code"]) if "code" in given else (str(given["area"]), None)
    if area not in grammar.areas:
        raise UnknownAreaError(f"there is no area '{area}'")
    address = Address(area, unit or own or grammar.areas[area].unit, start)
    unit_bits(address.unit)
    return address


def _coded(codes: Codes, code: Any) -> tuple[str, str]:
    found = codes.get(code)
    if not found:
        raise UnknownAreaError(f"no area has the code {code}")
    return found[0]
