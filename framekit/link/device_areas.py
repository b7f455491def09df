"""The areas a protocol speaks of, as places of a device's memory: mapped, with a base, or built from state.

Bit areas may lie on word memory and the reverse: places are bits over the whole area. Data are in memory's form. It
knows neither requests nor codes. Language reference, sections 9 and 12.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from framekit.definition.model.protocol import Protocol
from framekit.definition.model.services import Area
from framekit.link.evaluate import Names
from framekit.link.frame_table import Codec
from framekit.link.packing import cut_memory
from framekit.memory.memory import AccessError, DeviceMemory, MemoryRangeError, UnknownAreaError, unit_bits
from framekit.memory.memory import Area as MemoryArea

OWN = "own"
"""The unit that stands for the memory area's own."""


@dataclass(frozen=True, slots=True)
class Span:
    """`count` elements of `unit` from `start` on, of a protocol's area, or, with `area` None, of a memory area."""

    area: str | None
    memory: str
    unit: str
    start: int
    count: int

    def language_attribute(self, name: str) -> Any:
        """The same words behind a dot."""
        if name not in self.__slots__:
            raise KeyError(name)
        return getattr(self, name)


class DeviceAreas:
    """Access to a device's memory through the areas of a protocol.

    `mapping` puts a protocol's area somewhere else: area → memory area and the number, in the protocol area's units, of
    its element 0 there. Methods raise DeviceMemoryError for places that are not there or may not be written.
    """

    def __init__(
        self,
        protocol: Protocol,
        codec: Codec,
        memory: DeviceMemory,
        mapping: Mapping[str, tuple[str, int]] | None = None,
    ) -> None:
        self.areas = protocol.areas
        self.codec = codec
        self.memory = memory
        self.mapping = dict(mapping or {})
        self._records = {
            variable.layout: name
            for name, variable in protocol.state.items()
            if variable.layout is not None and variable.type == "record" and variable.keys is None
        }

    def span(self, area: str, unit: str | None, start: int, count: int) -> Span:
        """A place of a protocol's area. Raises UnknownAreaError."""
        model = self.areas.get(area)
        if model is None:
            raise UnknownAreaError(f"there is no area '{area}'")
        memory = self.mapping[area][0] if area in self.mapping else model.memory
        return Span(area, memory, unit or model.unit, start, count)

    def memory_span(self, memory: str, unit: str | None, start: int, count: int) -> Span:
        """A place of a memory area by its own name. Raises UnknownAreaError."""
        own = self.memory.area(memory).unit
        return Span(None, memory, own if unit in (None, OWN) else str(unit), start, count)

    def own_bytes(self, memory: str) -> int:
        """Bytes of one element of a memory area; 0 of bits. Raises UnknownAreaError."""
        return unit_bits(self.memory.area(memory).unit) // 8

    # ---- judging ------------------------------------------------------------------------------------------

    def check(self, span: Span, *, write: bool) -> None:
        """Raises DeviceMemoryError when the span cannot be read, or written."""
        area = None if span.area is None else self.areas[span.area]
        bits = unit_bits(span.unit)
        first, end = span.start * bits, (span.start + span.count) * bits
        if span.count < 1 or first < 0 or (area is not None and end > area.size * area.element_bits):
            raise MemoryRangeError(f"{span.count} × {span.unit} from {span.start} on is not in area {span.area}")
        if area is not None and write and (area.access == "read" or area.layout is not None):
            raise AccessError(f"area {area.name} can only be read")
        if area is None or area.layout is None:
            there, base = self._place(span)
            if base + end > there.size_bits:
                raise MemoryRangeError(f"{span.count} × {span.unit} from {span.start} on is not in area {there.name}")
            if write and there.access == "read":
                raise AccessError(f"area {there.name} can only be read")

    def _place(self, span: Span) -> tuple[MemoryArea, int]:
        """The memory area, and the bit of it where the protocol's area begins."""
        base = 0
        if span.area in self.mapping:
            base = self.mapping[span.area][1] * self.areas[span.area].element_bits
        return self.memory.area(span.memory), base

    # ---- access -------------------------------------------------------------------------------------------

    def read(self, span: Span, names: Names) -> bytes:
        """The elements in memory's form. `names` are what an area built from state is built of."""
        self.check(span, write=False)
        bits = unit_bits(span.unit)
        first, count = span.start * bits, span.count * bits
        if span.area is not None and self.areas[span.area].layout is not None:
            return cut_memory(self._built(self.areas[span.area], names), first, count)
        there, base = self._place(span)
        if (base + first) % 8 == 0 and count % 8 == 0:
            return there.read_bytes((base + first) // 8, count // 8)
        return there.read_bits(base + first, count)

    def _built(self, area: Area, names: Names) -> bytes:
        """The bytes of an area that is a layout: of the record that has this layout, or of its own formulas."""
        layout = area.layout
        assert layout is not None
        record = self._records.get(layout)
        data = self.codec.layouts[layout][0]({} if record is None else dict(names[record]), names)
        size = (area.size * area.element_bits + 7) // 8
        return data[:size].ljust(size, b"\0")

    def write(self, span: Span, data: bytes) -> None:
        """Puts elements in memory's form."""
        self.check(span, write=True)
        bits = unit_bits(span.unit)
        first, count = span.start * bits, span.count * bits
        there, base = self._place(span)
        if (base + first) % 8 == 0 and count % 8 == 0:
            there.write_bytes((base + first) // 8, data)
        else:
            there.write_bits(base + first, count, data)
