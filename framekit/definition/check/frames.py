"""Frames: sizes and lengths that agree, numbers that fit their types, variable parts whose end can be found."""

from __future__ import annotations

from collections.abc import Iterator

from framekit.definition.check.names import field_names, flat
from framekit.definition.expression.syntax import Expression, names_in
from framekit.definition.model.frames import Frame
from framekit.definition.model.protocol import Protocol
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
    Skip,
    Value,
    Wrap,
)
from framekit.definition.problems import Position, Problem


def check_frame(protocol: Protocol, frame: Frame) -> list[Problem]:
    """Everything wrong with one frame by itself."""
    found = list(_level(frame.segments))
    found += _order_of_sizes(frame.segments, set())
    found += _ends(frame)
    if frame.delimited:
        found += _delimited(frame)
    found += _whole_size(frame)
    return found


def _level(segments: tuple[Segment, ...]) -> Iterator[Problem]:
    """Problems of segments on one level, and of the levels inside."""
    seen: dict[str, Segment] = {}
    for segment in flat(segments):
        for name in _value_names(segment):
            other = seen.get(name)
            if other is not None and other.when is None and segment.when is None and not _in_choice(segments, name):
                yield Problem(segment.at, f"there are two fields '{name}'", "give one of them another name")
            seen[name] = segment
        yield from _one(segment, segments)
        if isinstance(segment, (Record, Repeat)) and isinstance(segment.of, tuple):
            yield from _level(segment.of)


def _value_names(segment: Segment) -> tuple[str, ...]:
    if isinstance(segment, Bits):
        return tuple(part.name for part in segment.parts)
    if isinstance(segment, (Field, Data, Length, Count, Repeat, Record, Inner, Value)):
        return (segment.name,)
    return ()


def _in_choice(segments: tuple[Segment, ...], name: str) -> bool:
    return any(
        isinstance(segment, Choose) and any(name in field_names(case) for _, case in segment.cases)
        for segment in segments
    )


def _one(segment: Segment, level: tuple[Segment, ...]) -> Iterator[Problem]:
    """Problems of one segment by itself."""
    if isinstance(segment, Field):
        yield from _field(segment)
    elif isinstance(segment, Bits):
        yield from _bits(segment)
    elif isinstance(segment, (Length, Count)):
        yield from _limits(segment.type, segment.limits, segment.at)
    elif isinstance(segment, Data) and isinstance(segment.size, Expression):
        yield from _computed(segment, level)
    elif isinstance(segment, Inner) and not segment.frames:
        yield Problem(segment.at, f"'{segment.name}' can hold no frame", "name a group that has frames")


def _field(field: Field) -> Iterator[Problem]:
    yield from _limits(field.type, field.limits if field.unit is None else None, field.at)
    bounds = bounds_of(field.type)
    if bounds is None:
        return
    for constant in field.constants or ():
        if isinstance(constant, int) and not bounds[0] <= constant + field.plus <= bounds[1]:
            yield _too_large(constant, field.type, field.at)
    for number in field.values or ():
        if not bounds[0] <= number + field.plus <= bounds[1]:
            yield _too_large(number, field.type, field.at)
    if field.only and field.long is not None:
        yield Problem(field.at, "only: values cannot go with long:", "leave one of them out")


def _limits(type_: FieldType, limits: tuple[int, int] | None, at: Position) -> Iterator[Problem]:
    bounds = bounds_of(type_)
    if bounds is not None and limits is not None:
        for number in limits:
            if not bounds[0] <= number <= bounds[1]:
                yield _too_large(number, type_, at)
                return


def _too_large(number: int, type_: FieldType, at: Position) -> Problem:
    bounds = bounds_of(type_)
    assert bounds is not None
    return Problem(at, f"{number} does not fit: the field holds {bounds[0]} to {bounds[1]}", "use a wider type")


def bounds_of(type_: FieldType) -> tuple[int, int] | None:
    """Least and greatest number of a type; None when it holds no whole numbers or its size is computed."""
    size = type_.fixed_size
    if size is None:
        return None
    if type_.kind == "int":
        bits = size * 8
        return (-(1 << bits - 1), (1 << bits - 1) - 1) if type_.signed else (0, (1 << bits) - 1)
    if type_.kind == "digits":
        return 0, type_.base**size - 1
    return (0, 100**size - 1) if type_.kind == "bcd" else None


def _bits(bits: Bits) -> Iterator[Problem]:
    size = bits.type.fixed_size
    width = 0 if size is None else size * (4 if bits.type.kind == "digits" else 8)
    taken: dict[int, str] = {}
    for part in bits.parts:
        if size is not None and part.high >= width:
            yield Problem(part.at, f"bit {part.high} is beyond the {width} bits there are", "use a wider type")
        for place in range(part.low, part.high + 1):
            if place in taken:
                yield Problem(part.at, f"bit {place} belongs to '{taken[place]}' already", "give each bit one name")
                break
            taken[place] = part.name


def _computed(data: Data, level: tuple[Segment, ...]) -> Iterator[Problem]:
    """A size that is a plain field must be computed by somebody: a length does it, `build` or `is` too."""
    assert isinstance(data.size, Expression)
    for segment in flat(level):
        plain = (
            isinstance(segment, Field) and segment.is_ is None and segment.build is None and segment.constants is None
        )
        if plain and segment.name == data.size.text.strip():
            yield Problem(
                segment.at,
                f"'{segment.name}' is the size of '{data.name}', but nothing computes it",
                f"write {{length: {segment.name}, type: …, of: [{data.name}]}}",
                warning=True,
            )


def _order_of_sizes(segments: tuple[Segment, ...], before: set[str]) -> Iterator[Problem]:
    """Sizes, repetitions and conditions may only use what stands before them."""
    known, names = set(before), field_names(segments)
    for segment in flat(segments):
        for what, expression in _needed(segment):
            late = sorted((names_in(expression.root) & names) - known)
            for name in late:
                yield Problem(
                    expression.at, f"the {what} uses '{name}', which is read only later", f"move '{name}' before it"
                )
        if isinstance(segment, (Record, Repeat)) and isinstance(segment.of, tuple):
            yield from _order_of_sizes(segment.of, known)
        known.update(_value_names(segment))
        if segment.name:
            known.add(segment.name)


def _needed(segment: Segment) -> Iterator[tuple[str, Expression]]:
    """The expressions of a segment that must be known when it is read."""
    if segment.when is not None and not isinstance(segment, Value):
        yield "condition", segment.when
    for key, what in (("size", "size"), ("times", "number of items"), ("on", "choice")):
        value = getattr(segment, key, None)
        if isinstance(value, Expression):
            yield what, value
    if isinstance(segment, Require):
        yield "condition", segment.condition


def _ends(frame: Frame) -> Iterator[Problem]:
    """A part that takes the rest must have an end: a region's, a constant behind it, or the end of the frame."""
    open_part: Segment | None = None
    for segment in frame.segments:
        if takes_rest(segment):
            if open_part is not None and not frame.delimited:
                yield Problem(
                    segment.at,
                    f"two parts take the rest: nothing shows where '{open_part.name}' ends",
                    "give one a size, or put a constant between them",
                )
            open_part = segment
        elif open_part is not None and isinstance(segment, Const):
            open_part = None
        elif open_part is not None and not isinstance(segment, (Check, Skip, Require, Value)) and not _fixed(segment):
            yield Problem(
                segment.at,
                f"nothing shows where '{open_part.name}' ends and '{segment.name}' begins",
                "give one of them a size, or put a constant between them",
            )


def takes_rest(segment: Segment) -> bool:
    """Whether a segment reaches to the end of its region."""
    if isinstance(segment, (Data, Repeat)):
        return (segment.size if isinstance(segment, Data) else segment.times) == "rest"
    return isinstance(segment, Optional)


def _fixed(segment: Segment) -> bool:
    from framekit.definition.load.references import fixed_size

    return fixed_size(segment) is not None or isinstance(segment, (Bits, Field, Length, Count))


def _delimited(frame: Frame) -> Iterator[Problem]:
    """The tail of a delimited frame begins with its end constant, and the body cannot hold its first byte."""
    first = frame.tail[0] if frame.tail else None
    if not isinstance(first, Const):
        at = first.at if first is not None else frame.at
        yield Problem(at, f"the tail of '{frame.name}' must begin with a constant", "delimited bodies end there")
        return
    end = first.data[0]
    for segment in flat(frame.body):
        if _may_hold(segment, end):
            name = segment.name or "a segment"
            yield Problem(
                segment.at,
                f"'{name}' may hold {end:02X}, the byte that ends the body of '{frame.name}'",
                "leave delimited out, or send it as ASCII digits",
            )


def _may_hold(segment: Segment, byte: int) -> bool:
    if isinstance(segment, Const):
        return byte in segment.data
    if isinstance(segment, Data):
        return segment.convert != "hex_to_ascii"
    if isinstance(segment, (Field, Length, Count)):
        return segment.type.kind in ("int", "float", "bcd", "bytes")
    return isinstance(segment, Wrap) and segment.how == "escape"


def _whole_size(frame: Frame) -> Iterator[Problem]:
    from framekit.definition.load.references import fixed_size

    least = sum(fixed_size(segment) or 0 for segment in frame.segments)
    for limit, key in ((frame.size, "size"), (frame.most, "max")):
        if limit is not None and least > limit:
            yield Problem(
                frame.at, f"'{frame.name}' takes at least {least} bytes, {key} says {limit}", f"correct {key}"
            )
