"""Read and write a value of a type: sizes, invalid digits, values of the wrong kind."""

from __future__ import annotations

from decimal import Decimal
from io import BytesIO
from typing import Any

from construct import Construct, ConstructError, Container

from construct_oracle.faults import Place
from construct_oracle.filling import Filling
from construct_oracle.forms import FormError, form_of
from construct_oracle.state import Reading
from framekit.codec.evaluate import EVALUATION_ERRORS
from framekit.codec.shown import explain
from framekit.definition.expression import Expression
from framekit.definition.model.segments import FieldType

DAMAGED: Any = object()
"""The value of invalid digits."""


def read_size(type_: FieldType, reading: Reading, context: Container, place: Place) -> int:
    """Return the size of a value in bytes. Raises Stop if it cannot be evaluated."""
    if not isinstance(type_.size, Expression):
        return type_.size or 0
    return evaluated_size(type_.size, reading, context, place)


def evaluated_size(expression: Expression, reading: Reading, context: Container, place: Place) -> int:
    """Return the size that an expression gives while reading. Raises Stop if it cannot be evaluated."""
    try:
        size = reading.evaluate(expression, context)
    except EVALUATION_ERRORS:
        raise reading.stop(place, "length", str(expression), "nothing") from None
    if not isinstance(size, int) or size < 0:
        raise reading.stop(place, "length", f"a size ({expression})", size)
    return int(size)


def read_wire(type_: FieldType, stream: BytesIO, context: Container, place: Place) -> Any:
    """Return the number, text or bytes on the wire, or DAMAGED (and note it) if invalid. Raises Stop."""
    reading: Reading = context._state
    if type_.is_delimited:
        raw = _terminated(type_, stream, reading, place)
        form = form_of(type_, 0)
    else:
        size = read_size(type_, reading, context, place)
        raw = reading.take(stream, size, place)
        form = form_of(type_, size)
    reading.leaf(raw)
    try:
        return form.parse(raw)
    except ConstructError:
        reading.note(place, "digits", f"{type_.kind}", raw)
        return DAMAGED


def _terminated(type_: FieldType, stream: BytesIO, reading: Reading, place: Place) -> bytes:
    ends = (type_.end,) if type_.end is not None else type_.stops
    start = stream.tell()
    behind = 0 if type_.end is not None else max(map(len, ends))  # the stop byte belongs to the next segment
    left = stream.read(max(reading.region.end + behind - start, 0))
    found = min((where for end in ends if (where := left.find(end)) >= 0), default=-1)
    if found < 0 or start + found > reading.region.end:
        raise reading.stop(place, "short", f"an end {ends!r}", left)
    taken = found + len(type_.end or b"")
    stream.seek(start + taken)
    return left[:taken]


def write_wire(type_: FieldType, wire: Any, name: str, filling: Filling, stream: BytesIO, context: Container) -> None:
    """Write a number, text or bytes. Raises EncodeError if it does not fit."""
    form = _building_form(type_, wire, name, filling, context._state.measuring)
    try:
        data = form.build(wire)
    except (ConstructError, ValueError, OverflowError) as error:
        why = explain(error).splitlines()[-1] if isinstance(error, FormError) else "that does not fit into its bytes"
        raise filling.error(name, f"'{name}' cannot be {wire!r}: {why}") from None
    stream.write(data)
    context._state.leaf(data)


def _building_form(type_: FieldType, wire: Any, name: str, filling: Filling, measuring: bool) -> Construct:
    if not isinstance(type_.size, Expression):
        return form_of(type_, type_.size or 0)
    own = len(wire) if isinstance(wire, (str, bytes)) and type_.pad is None else None
    if measuring and own is not None:
        return form_of(type_, own)
    size = filling.size(type_.size, name)
    if size is None and own is not None:
        size = own
    if not isinstance(size, int) or size < 0:
        raise filling.error(name, f"'{name}' has no size: '{type_.size}' is {size!r}")
    return form_of(type_, size)


def of_type(type_: FieldType, value: Any, name: str, filling: Filling) -> Any:
    """Return the given value as the type's Python type. Raises EncodeError for another type."""
    if type_.kind == "ascii":
        wanted, fits = "text", isinstance(value, str)
    elif type_.kind == "bytes":
        wanted, fits = "bytes", isinstance(value, (bytes, bytearray))
        value = bytes(value) if fits else value
    elif type_.kind in ("float", "hex_float"):
        wanted, fits = "a number", isinstance(value, (int, float))
        value = float(value) if fits else value
    elif type_.kind in ("fraction", "scaled"):
        wanted, fits = (
            "a number",
            isinstance(value, (int, float, Decimal))
            or (value is None and type_.kind == "fraction" and type_.form.empty),
        )
        value = Decimal(repr(value)) if isinstance(value, float) else value
    else:
        wanted, fits = "a whole number", isinstance(value, int)
        value = int(value) if fits else value
    if not fits:
        raise filling.error(name, f"'{name}' is {wanted}, not {value!r}")
    return value
