"""`where:` – fields of a frame fixed to constants, or computed, for this frame alone."""

from __future__ import annotations

from dataclasses import dataclass, replace

from framekit.definition.expression.syntax import Expression
from framekit.definition.load.reader import Reader
from framekit.definition.load.scalars import parse_number
from framekit.definition.model.segments import Bits, BitsPart, Field, Segment
from framekit.definition.model.walk import bounds_of, change_all
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


def _fixed_field(reader: Reader, field: Field, where: Where) -> Field:
    if where.build is not None:
        return replace(field, build=where.build)
    constants = tuple(_constant(reader, field, scalar) for scalar in where.constants)
    for scalar, constant in zip(where.constants, constants, strict=True):
        _fits(reader, field, scalar, constant)
    return replace(field, constants=constants)


def _fixed_bits(reader: Reader, part: BitsPart, where: Where) -> BitsPart:
    if where.build is not None:
        return replace(part, build=where.build)
    constants = tuple(_number(reader, part, scalar) for scalar in where.constants)
    most = (1 << part.high - part.low + 1) - 1
    for scalar, number in zip(where.constants, constants, strict=True):
        if not 0 <= number <= most:
            reader.note(scalar.at, f"{number} does not fit: '{part.name}' holds 0 to {most}", "give it more bits")
    return replace(part, constants=constants)


def _constant(reader: Reader, field: Field, scalar: Scalar) -> int | str | bytes:
    if field.type.kind == "ascii":
        return scalar.text
    return reader.bytes(scalar) if field.type.kind == "bytes" else _number(reader, field, scalar)


def _number(reader: Reader, field: Field | BitsPart, scalar: Scalar) -> int:
    """A number, or a name of one. Raises Broken."""
    for number, name in (field.values or {}).items():
        if name == scalar.text:
            return number
    try:
        return parse_number(scalar.text)
    except ValueError as error:
        what, _, todo = str(error).partition(" – ")
        if field.values:
            what = f"'{scalar.text}' is neither a number nor a name in the values of '{field.name}'"
            todo = did_you_mean(scalar.text, field.values.values())
        raise reader.broken(scalar.at, what, todo) from None


def _fits(reader: Reader, field: Field, scalar: Scalar, constant: int | str | bytes) -> None:
    """A constant has the size of its field, and respects what the field says about its values."""
    if isinstance(constant, int):
        _number_fits(reader, field, scalar, constant)
        return
    size = field.type.fixed_size
    padded = field.type.pad is not None
    if size is not None and (len(constant) > size or (len(constant) < size and not padded)):
        what = f"'{scalar.text}' has {len(constant)} bytes, '{field.name}' has {size}"
        reader.note(scalar.at, what, "shorten it" if padded else "correct it, or add pad: to the field")


def _number_fits(reader: Reader, field: Field, scalar: Scalar, number: int) -> None:
    bounds = bounds_of(field.type) if field.long is None else None
    if bounds is not None and not bounds[0] <= number + field.plus <= bounds[1]:
        what = f"{number} does not fit: '{field.name}' holds {bounds[0] - field.plus} to {bounds[1] - field.plus}"
        reader.note(scalar.at, what, "use a wider type, or correct it")
    elif field.limits is not None and field.unit is None and not field.limits[0] <= number <= field.limits[1]:
        low, high = field.limits
        reader.note(scalar.at, f"{number} is not in {low}..{high}, the range of '{field.name}'", "correct one of them")
    elif field.only and field.values is not None and number not in field.values:
        reader.note(scalar.at, f"{number} has no name in the values of '{field.name}'", "add it there, or correct it")
