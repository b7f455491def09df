"""`where:` – fields of a frame fixed to constants, or computed, for this frame alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from framekit.definition.expression.syntax import Expression
from framekit.definition.load.reader import Reader
from framekit.definition.load.scalars import parse_bytes, parse_number
from framekit.definition.model.segments import Bits, BitsPart, Choose, Field, Optional, Segment, Wrap
from framekit.definition.nodes import Mapping, Node, Scalar
from framekit.definition.problems import did_you_mean

Parts = tuple[tuple[Segment, ...], tuple[Segment, ...], tuple[Segment, ...]]


@dataclass(frozen=True, slots=True)
class Where:
    """What one field is fixed to: constants as written, or a `build` expression."""

    key: Scalar
    constants: tuple[Scalar, ...] = ()
    build: Expression | None = None


def load_where(reader: Reader, node: Node) -> dict[str, Where]:
    """`{field: constant | [constants] | {build: EXPR}}`. Raises Broken."""
    result = {}
    for entry in reader.entries(node):
        if isinstance(entry.value, Mapping):
            where = Where(entry.key, build=reader.expression(entry.value.get("build")))
        else:
            where = Where(entry.key, tuple(reader.scalar(item) for item in reader.items(entry.value)))
        result[entry.key.text] = where
    return result


def apply_where(reader: Reader, parts: Parts, wheres: dict[str, Where], frame: Scalar) -> Parts:
    """The segments with the constants written into their fields; unknown fields are noted."""
    left = dict(wheres)

    def change(segment: Segment) -> Segment:
        if isinstance(segment, Field) and segment.name in wheres:
            left.pop(segment.name, None)
            return _fixed_field(reader, segment, wheres[segment.name])
        if isinstance(segment, Bits):
            fixed = []
            for part in segment.parts:
                if part.name in wheres:
                    left.pop(part.name, None)
                    part = _fixed_bits(reader, part, wheres[part.name])
                fixed.append(part)
            return replace(segment, parts=tuple(fixed))
        return segment

    head, body, tail = (change_all(part, change) for part in parts)
    for where in left.values():
        known = [segment.name for part in parts for segment in part if isinstance(segment, Field)]
        reader.note(
            where.key.at,
            f"frame '{frame.text}' has no field '{where.key.text}' to fix",
            did_you_mean(where.key.text, known),
        )
    return head, body, tail


def change_all(segments: tuple[Segment, ...], change: Callable[[Segment], Segment]) -> tuple[Segment, ...]:
    """Every segment changed, also those inside wraps, choices and optional parts (whose fields are the frame's)."""
    result = []
    for segment in segments:
        segment = change(segment)
        if isinstance(segment, (Wrap, Optional)):
            segment = replace(segment, of=change_all(segment.of, change))
        elif isinstance(segment, Choose):
            cases = tuple((keys, change_all(of, change)) for keys, of in segment.cases)
            otherwise = None if segment.otherwise is None else change_all(segment.otherwise, change)
            segment = replace(segment, cases=cases, otherwise=otherwise)
        result.append(segment)
    return tuple(result)


def _fixed_field(reader: Reader, field: Field, where: Where) -> Field:
    if where.build is not None:
        return replace(field, build=where.build)
    return replace(field, constants=tuple(_constant(reader, field, scalar) for scalar in where.constants))


def _fixed_bits(reader: Reader, part: BitsPart, where: Where) -> BitsPart:
    if where.build is not None:
        return replace(part, build=where.build)
    return replace(part, constants=tuple(reader.number(scalar) for scalar in where.constants))


def _constant(reader: Reader, field: Field, scalar: Scalar) -> int | str | bytes:
    text = scalar.text
    if field.type.kind == "ascii":
        return text
    if field.values is not None and text in field.values.values():
        return next(number for number, name in field.values.items() if name == text)
    try:
        return parse_bytes(text) if field.type.kind == "bytes" else parse_number(text)
    except ValueError as error:
        what, _, todo = str(error).partition(" – ")
        raise reader.broken(scalar.at, what, todo) from None
