"""Segments with numbers or texts of their own: fields and bits; conversion between values and wire numbers."""

from __future__ import annotations

from functools import partial
from io import BytesIO
from typing import Any

from construct import Container

from construct_oracle.base import SegmentConstruct, ValueSegment
from construct_oracle.faults import Place
from construct_oracle.filling import MISSING, Absent, Circular, Filling
from construct_oracle.state import Reading
from construct_oracle.values import DAMAGED, of_type, read_wire, write_wire
from framekit.codec.evaluate import EVALUATION_ERRORS
from framekit.definition.expression import Expression
from framekit.definition.model.segments import Bits, BitsPart, Field


class FieldConstruct(ValueSegment):
    """One value: a number, a text or bytes.

    Parses to the value and notes `digits` (invalid number), `where` (not one of its constants), `value` (not the result
    of `is`, or without a name if only names are allowed) and `range`. Builds the given value, else the computed value.
    """

    segment: Field

    def read(self, stream: BytesIO, context: Container, path: str, place: Place) -> None:
        field, reading = self.segment, context._state
        wire = read_wire(field.type, stream, context, place)
        if field.long is not None and wire == field.long.mark:
            wire = read_wire(field.long.type, stream, context, place)
        if wire is DAMAGED:
            return
        value = self.from_wire(wire)
        self._validate(value, reading, place)
        reading.store(context, self.name, value, place)
        if field.is_ is not None:
            expected = field.is_
            reading.later.append(lambda: self._compare(value, expected, reading, context, place))

    def read_absent(self, context: Container, place: Place) -> None:
        if self.segment.default is None:
            return
        reading: Reading = context._state
        try:
            value = reading.evaluate(self.segment.default, context, self.name)
        except EVALUATION_ERRORS:
            return
        reading.store(context, self.name, value, place)

    def _validate(self, value: Any, reading: Reading, place: Place) -> None:
        field = self.segment
        if field.constants is not None and value not in field.constants:
            reading.note(place, "where", " or ".join(map(repr, field.constants)), value)
        if field.only and field.values is not None and value not in field.values:
            reading.note(place, "value", "a number with a name", value)
        if field.limits is not None and not field.limits[0] <= value <= field.limits[1]:
            reading.note(place, "range", "{}..{}".format(*field.limits), value)

    def _compare(self, value: Any, is_: Expression, reading: Reading, context: Container, place: Place) -> None:
        try:
            expected = reading.evaluate(is_, context, self.name)
        except EVALUATION_ERRORS:
            if not reading.faults.noted:
                reading.note(place, "value", str(is_), "nothing")
            return
        if value != expected:
            reading.note(place, "value", expected, value)

    def from_wire(self, wire: Any) -> Any:
        field = self.segment
        if field.zero_means is not None and wire == 0:
            return field.zero_means
        value = wire - field.plus if field.plus else wire
        return value if field.unit is None else value * field.unit

    def to_wire(self, value: Any) -> Any:
        field = self.segment
        if field.zero_means is not None and value == field.zero_means:
            return 0
        wire = value if field.unit is None else value // field.unit
        return wire + field.plus if field.plus else wire

    # ---- building -----------------------------------------------------------------------------------------

    def fill(self, filling: Filling, name: str) -> Any:
        field, given = self.segment, filling.given_of(name)
        is_there = filling.is_there if field.default is None else filling.is_held
        if given is MISSING and not is_there(name):
            raise Absent(name)
        if given is not MISSING:
            given = self._meant(given, filling)
        if field.is_ is not None:
            value = of_type(field.type, filling.compute(field.is_, name), name, filling)
            if given is not MISSING and given != value:
                raise filling.error(name, f"'{name}' is computed as {value!r}, not {given!r}")
            return value
        return given if given is not MISSING else self._not_given(filling)

    def _not_given(self, filling: Filling) -> Any:
        field, name = self.segment, self.name
        echo = filling.echo_of(name)
        if echo is not MISSING and (field.constants is None or echo in field.constants):
            return self._meant(echo, filling)
        chosen = field.constants is not None or field.build is not None
        if chosen and (field.default is None or filling.is_there(name)):
            if field.constants is not None:
                return field.constants[0]
            assert field.build is not None
            return self._meant(filling.compute(field.build, name), filling)
        if field.default is not None:
            return self._meant(filling.compute(field.default, name), filling)
        raise filling.error(name, f"'{name}' is missing")

    def _meant(self, value: Any, filling: Filling) -> Any:
        """Return a value of the field's type; names of numbers become the numbers. Raises EncodeError."""
        field = self.segment
        if value is None and not filling.is_there(self.name):
            return None
        if field.values is not None and isinstance(value, str) and field.type.kind != "ascii":
            number = next((number for number, text in field.values.items() if text == value), None)
            if number is None:
                raise filling.error(self.name, f"'{self.name}' has no value named {value!r}")
            return number
        return of_type(field.type, value, self.name, filling)

    def refuse_absent(self, filling: Filling, name: str) -> None:
        default = self.segment.default
        if default is None or filling[name] != self._meant(filling.compute(default, name), filling):
            super().refuse_absent(filling, name)

    def write(self, filling: Filling, stream: BytesIO, context: Container, path: str) -> None:
        field, name = self.segment, self.name
        value = measured_value(field, name, filling, stream, context)
        if value is None and (field.type.form is None or not field.type.form.empty):
            return
        if field.constants is not None and value not in field.constants:
            raise filling.error(name, f"'{name}' is {' or '.join(map(repr, field.constants))}, not {value!r}")
        if field.only and field.values is not None and value not in field.values:
            raise filling.error(name, f"'{name}' has no value {value!r}")
        if field.limits is not None and not field.limits[0] <= value <= field.limits[1]:
            raise filling.error(name, f"'{name}' is from {field.limits[0]} to {field.limits[1]}, not {value!r}")
        if field.unit is not None and value % field.unit:
            raise filling.error(name, f"'{name}' counts steps of {field.unit} ns, {value} is between two")
        wire = self.to_wire(value)
        if field.zero_means is not None and wire == 0 and value != field.zero_means:
            raise filling.error(name, f"'{name}' cannot be {value!r}: 0 on the wire means {field.zero_means}")
        start = stream.tell()
        if field.long is not None and wire >= field.long.mark:
            write_wire(field.type, field.long.mark, name, filling, stream, context)
            write_wire(field.long.type, wire, name, filling, stream, context)
        else:
            write_wire(field.type, wire, name, filling, stream, context)
        if field.type.stops:
            context._state.texts.append((field, stream, start, stream.tell()))


def measured_value(segment: Field | Bits, name: str, filling: Filling, stream: BytesIO, context: Container) -> Any:
    """Return the value to write, or None if only sizes are measured and the value depends on its own size."""
    try:
        return filling[name]
    except Circular:
        size = segment.type.size
        if not context._state.measuring or not isinstance(size, int) or getattr(segment, "long", None):
            raise
        stream.write(bytes(size))
        context._state.leaf(bytes(size))
        return None


class BitsConstruct(SegmentConstruct):
    """A number divided into named bits, each a value of the record.

    Parses every part and notes `where` and `value` as for fields. Builds the given or computed parts, 0 for other
    parts.
    """

    segment: Bits

    def __init__(self, segment: Bits) -> None:
        super().__init__(segment)
        self.parts = {part.name: part for part in segment.parts}

    def read(self, stream: BytesIO, context: Container, path: str, place: Place) -> None:
        reading: Reading = context._state
        number = read_wire(self.segment.type, stream, context, place)
        if number is DAMAGED:
            return
        for part in self.segment.parts:
            value = number >> part.low & (1 << part.high - part.low + 1) - 1
            if part.constants is not None and value not in part.constants:
                reading.note(place, "where", " or ".join(map(str, part.constants)), f"{part.name} = {value}")
            reading.store(context, part.name, value, place)
            if part.is_ is not None:
                reading.later.append(partial(self._compare, part, value, reading, context, place))

    def _compare(self, part: BitsPart, value: int, reading: Reading, context: Container, place: Place) -> None:
        assert part.is_ is not None
        try:
            expected = reading.evaluate(part.is_, context, part.name)
        except EVALUATION_ERRORS:
            if not reading.faults.noted:
                reading.note(place, "value", str(part.is_), "nothing")
            return
        if value != expected:
            reading.note(place, "value", f"{part.name} = {expected}", f"{value}")

    def fill(self, filling: Filling, name: str) -> Any:
        part, given = self.parts[name], filling.given_of(name)
        if given is MISSING and not filling.is_there(name):
            raise Absent(name)
        value = given if given is not MISSING else self._not_given(part, filling)
        if isinstance(value, str) and part.values is not None:
            value = next((number for number, text in part.values.items() if text == value), value)
        if not isinstance(value, int):
            raise filling.error(name, f"'{name}' is a whole number, not {value!r}")
        if part.is_ is not None and value != (expected := int(filling.compute(part.is_, name))):
            raise filling.error(name, f"'{name}' is computed as {expected}, not {value}")
        return int(value)

    def _not_given(self, part: BitsPart, filling: Filling) -> Any:
        if part.is_ is not None:
            return filling.compute(part.is_, part.name)
        echo = filling.echo_of(part.name)
        if echo is not MISSING and (part.constants is None or echo in part.constants):
            return echo
        if part.constants is not None:
            return part.constants[0]
        return 0 if part.build is None else filling.compute(part.build, part.name)

    def write(self, filling: Filling, stream: BytesIO, context: Container, path: str) -> None:
        number = 0
        for part in self.segment.parts:
            value = measured_value(self.segment, part.name, filling, stream, context)
            if value is None:
                return
            if part.constants is not None and value not in part.constants:
                raise filling.error(part.name, f"'{part.name}' cannot be {value}")
            if value < 0 or value >> part.high - part.low + 1:
                raise filling.error(part.name, f"'{part.name}' cannot be {value}: it is bits {part.low} to {part.high}")
            number |= value << part.low
        write_wire(self.segment.type, number, self.label, filling, stream, context)
