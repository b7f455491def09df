"""Fields of frames in the own memory: how many bits they take there, and their values in memory's form and back.

A number takes the unit of its place, as `%MD50` or `M00003` says; one that does not fit is refused, never cut. Data and
text take bytes. Nothing here knows blocks or frames.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from framekit.blocks.model import Place
from framekit.definition.model.segments import (
    Bits,
    BitsPart,
    Count,
    Data,
    Field,
    FieldType,
    Length,
    Segment,
    Value,
)
from framekit.definition.model.walk import bounds_of, flat
from framekit.link.packing import memory_of, values_of
from framekit.memory.views import as_float, as_signed, from_float

FramePart = Data | Field | BitsPart | Length | Count | Value
"""What has a name and a value that memory can hold."""


def parts_of(segments: Sequence[Segment]) -> Iterator[tuple[str, FramePart]]:
    """Everything in a frame that memory can hold, by name; also what is in wraps, choices and optional parts."""
    for segment in flat(segments):
        if isinstance(segment, Bits):
            yield from ((part.name, part) for part in segment.parts)
        elif isinstance(segment, (Data, Field, Length, Count, Value)):
            yield segment.name, segment


def takes_bytes(part: FramePart) -> bool:
    """Whether its value is bytes or text, not a number."""
    return isinstance(part, Data) or (isinstance(part, Field) and part.type.kind in ("ascii", "bytes"))


def fixed_bytes(part: FramePart) -> int | None:
    """Bytes that data or text always has; None when that is open."""
    size = part.type.size if isinstance(part, Field) else part.size if isinstance(part, Data) else None
    return size if isinstance(size, int) else None


def misfit(part: FramePart, place: Place) -> tuple[str, str] | None:
    """What is wrong with this place for this part, and what to do; None when it fits."""
    bits = place.address.unit_bits
    if takes_bytes(part):
        if place.address.first_bit % 8:
            return f"'{part.name}' is bytes, and {place.text} is in the middle of one", "name a byte or a word"
    elif _is_float(part) and bits not in (32, 64):
        return f"'{part.name}' is a floating-point number, and {place.text} is a {place.address.unit}", (
            "name a double word or a long word"
        )
    return None


def may_overflow(part: FramePart, place: Place) -> bool:
    """Whether there are binary numbers of this field that its place cannot hold."""
    if not isinstance(part, Field) or part.type.kind != "int" or part.limits is not None or part.unit is not None:
        return False
    bounds = bounds_of(part.type)
    return bounds is not None and (bounds[1] - bounds[0]).bit_length() > place.address.unit_bits > 1


def no_number(part: FramePart | None, value: Any) -> str | None:
    """Why a field that holds plain numbers cannot be sent with a value; None when it can, or that is not known here."""
    if not isinstance(part, Field) or part.unit is not None or part.values or part.long or part.zero_means is not None:
        return None
    bounds = bounds_of(part.type)
    if bounds is None:
        return None
    if not isinstance(value, int):
        return f"'{part.name}' is a number, not {value!r}"
    least, most = bounds[0] - part.plus, bounds[1] - part.plus
    if least <= value <= most:
        return None
    return f"'{part.name}' is {value}, " + (f"more than {most}" if value > most else f"less than {least}")


# ---- values -----------------------------------------------------------------------------------------------


def to_memory(part: FramePart, place: Place, value: Any, room: int | None) -> tuple[int, bytes]:
    """Bits and content for a value. `room`: bytes there are for it. Raises ValueError for one that does not fit."""
    if takes_bytes(part):
        data = value.encode("latin-1") if isinstance(value, str) else bytes(value)
        size = fixed_bytes(part) if room is None else room
        if size is not None and len(data) > size:
            raise ValueError(f"'{part.name}' came with {len(data)} bytes, there is room for {size}")
        if isinstance(value, str) and size is not None:
            data = data.ljust(size, _pad(part))
        return 8 * len(data), data
    unit = place.address.unit
    if _is_float(part):
        return place.address.unit_bits, memory_of(from_float([value], unit), unit)
    try:
        return place.address.unit_bits, memory_of([_scaled(part, int(value))], unit)
    except ValueError:
        raise ValueError(f"'{part.name}' is {value}, that does not fit into {place.text} ({unit})") from None


def from_memory(part: FramePart, place: Place, memory: bytes) -> Any:
    """The value of a field for sending."""
    if takes_bytes(part):
        if not isinstance(part, Field) or part.type.kind != "ascii":
            return memory
        return memory.rstrip(b"\0").decode("latin-1") if part.type.end is not None else memory.decode("latin-1")
    unit = place.address.unit
    number = values_of(memory, unit, 1)
    if _is_float(part):
        return as_float(number, unit)[0]
    if isinstance(part, Field) and part.type.signed and place.address.unit_bits > 1:
        number = as_signed(number, unit)
    return number[0] * _unit(part)


def _scaled(part: FramePart, value: int) -> int:
    return value // _unit(part)


def _unit(part: FramePart) -> int:
    """Times are kept in the wire's unit."""
    return part.unit if isinstance(part, Field) and part.unit else 1


def _is_float(part: FramePart) -> bool:
    return isinstance(part, Field) and part.type.kind == "float"


def _pad(part: FramePart) -> bytes:
    type_: FieldType | None = part.type if isinstance(part, Field) else None
    return b"\0" if type_ is None or type_.end is not None else type_.pad or b" "
