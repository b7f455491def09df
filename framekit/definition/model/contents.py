"""Which bytes segments may have on the wire: whether a constant that ends something can stand inside it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from framekit.definition.model.frames import Frame
from framekit.definition.model.segments import (
    Bits,
    Check,
    Choose,
    Const,
    Count,
    Data,
    Field,
    FieldType,
    Inner,
    Length,
    Optional,
    Record,
    Repeat,
    Require,
    Segment,
    Value,
    Wrap,
)

ANY = frozenset(range(256))
DIGITS = frozenset(b"0123456789ABCDEFabcdef")
_BCD = frozenset(high << 4 | low for high in range(10) for low in range(10))


def bytes_of(segments: Iterable[Segment], frames: Mapping[str, Frame] | None = None) -> frozenset[int]:
    """The bytes that may stand in these segments; every byte where that cannot be told.

    `frames` are those that `inner` segments name; without them an inner frame may hold every byte.
    """
    found: frozenset[int] = frozenset()
    for segment in segments:
        if len(found) == 256:
            break
        found |= _bytes_of(segment, frames or {})
    return found


def _bytes_of(segment: Segment, frames: Mapping[str, Frame]) -> frozenset[int]:
    match segment:
        case Const(data=data):
            return frozenset(data)
        case Value() | Require():
            return frozenset()
        case Data(convert="hex_to_ascii") | Wrap(how="hex") | Check(form="hex" | "HEX" | "dec"):
            return DIGITS
        case Field(long=None):
            return _small_numbers(segment) or _of_type(segment.type)
        case Length(type=type_) | Count(type=type_) | Bits(type=type_):
            return _of_type(type_)
        case Repeat(of=of):
            return _of_type(of) if isinstance(of, FieldType) else bytes_of(of, frames)
        case Optional(of=of) | Record(of=of):
            return bytes_of(of, frames)
        case Choose(cases=cases, otherwise=otherwise):
            every = [*(one for _, case in cases for one in case), *(otherwise or ())]
            return bytes_of(every, frames)
        case Inner(frames=names):
            if any(name not in frames for name in names):
                return ANY
            others = {name: frame for name, frame in frames.items() if name not in names}  # none stands inside itself
            return bytes_of([one for name in names for one in frames[name].segments], others)
    return ANY


def _small_numbers(field: Field) -> frozenset[int] | None:
    """The bytes of a number of one byte that has a range, and goes out as it is."""
    if field.type.kind != "int" or field.type.size != 1 or field.limits is None:
        return None
    if field.zero_means is not None or field.unit is not None or field.limits[0] + field.plus < 0:
        return None
    return frozenset(range(field.limits[0] + field.plus, min(field.limits[1] + field.plus, 255) + 1))


def _of_type(type_: FieldType) -> frozenset[int]:
    return DIGITS if type_.kind == "digits" else _BCD if type_.kind == "bcd" else ANY
