"""Segments without numbers: constants, skipped bytes, data, derived values, conditions."""

from __future__ import annotations

from dataclasses import replace
from io import BytesIO
from typing import Any

from construct import Container

from construct_oracle.base import SegmentConstruct, ValueSegment
from construct_oracle.faults import Place
from construct_oracle.filling import MISSING, Absent, Circular, Filling
from construct_oracle.rest import rest_size
from construct_oracle.sizes import wire_size
from construct_oracle.state import Reading
from construct_oracle.values import evaluated_size
from framekit.codec import support
from framekit.codec.evaluate import EVALUATION_ERRORS
from framekit.definition.expression import Expression
from framekit.definition.model.segments import Const, Data, Require, Skip, Value


class ConstantConstruct(SegmentConstruct):
    """Constant bytes. Parsing notes `constant` for other bytes; they are not a value of the record."""

    segment: Const

    def read(self, stream: BytesIO, context: Container, path: str, place: Place) -> None:
        reading: Reading = context._state
        data = reading.take(stream, len(self.segment.data), place)
        reading.leaf(data)
        if data != self.segment.data:
            reading.note(place, "constant", self.segment.data, data)

    def write(self, filling: Filling, stream: BytesIO, context: Container, path: str) -> None:
        stream.write(self.segment.data)
        context._state.leaf(self.segment.data)


class SkipConstruct(SegmentConstruct):
    """Ignored bytes. Builds `fill`, repeated and cut to size."""

    segment: Skip

    def read(self, stream: BytesIO, context: Container, path: str, place: Place) -> None:
        reading: Reading = context._state
        reading.leaf(reading.take(stream, self.segment.size, place))

    def write(self, filling: Filling, stream: BytesIO, context: Container, path: str) -> None:
        fill, size = self.segment.fill or b"\0", self.segment.size
        data = (fill * (size // len(fill) + 1))[:size]
        stream.write(data)
        context._state.leaf(data)


class DataConstruct(ValueSegment):
    """Bytes, converted and swapped between wire and memory.

    Parses `size` bytes, or up to the end of the region for `rest`; notes `digits` for invalid hex and `short` for fewer
    than `least` bytes. Builds exactly that size; shorter (or missing) bytes are filled with `pad`.
    """

    segment: Data

    def read(self, stream: BytesIO, context: Container, path: str, place: Place) -> None:
        data, reading = self.segment, context._state
        wire = reading.take(stream, self._wire_size(stream, reading, context, place), place)
        try:
            memory = self.to_memory(wire)
        except ValueError:
            reading.leaf(wire, len(wire) // 2)
            reading.note(place, "digits", "hex digits", wire)
            return
        reading.leaf(wire, len(memory))
        if len(memory) < data.least:
            reading.note(place, "short", f"{data.least} bytes", len(memory))
        for offset, byte in enumerate(wire):
            if byte in data.never:
                reading.note(replace(place, offset=place.offset + offset), "value", "another byte", byte)
                break
        reading.store(context, self.name, memory, place)

    def _wire_size(self, stream: BytesIO, reading: Reading, context: Container, place: Place) -> int:
        size = self.segment.size
        if size == "rest":
            return rest_size(self, stream, context, place)
        if isinstance(size, Expression):
            size = evaluated_size(size, reading, context, place)
        assert isinstance(size, int)
        return wire_size(self.segment, size)

    def to_memory(self, wire: bytes) -> bytes:
        """Convert wire bytes to memory. Raises ValueError for bytes that cannot be converted."""
        if self.segment.convert == "hex_to_ascii":
            wire = support.ascii_to_hex(wire)
        elif self.segment.convert == "ascii_to_hex":
            wire = support.hex_to_ascii(wire)
        return support.swap(wire, self.segment.swap) if self.segment.swap else wire

    def to_wire(self, memory: bytes) -> bytes:
        """Convert memory to wire bytes. Raises ValueError for bytes that cannot be converted."""
        if self.segment.swap:
            memory = support.swap(memory, self.segment.swap)
        if self.segment.convert == "hex_to_ascii":
            return support.hex_to_ascii(memory)
        return support.ascii_to_hex(memory) if self.segment.convert == "ascii_to_hex" else memory

    def fill(self, filling: Filling, name: str) -> Any:
        given = filling.given_of(name)
        if given is MISSING:
            if not filling.is_there(name):
                raise Absent(name)
            given = filling.echo_of(name)
            if given is MISSING and self.segment.pad is None:
                raise filling.error(name, f"'{name}' is missing")
            given = b"" if given is MISSING else given
        if not isinstance(given, (bytes, bytearray)):
            raise filling.error(name, f"'{name}' is bytes, not {given!r}")
        data = bytes(given)
        size = None if self.segment.pad is None else self._size(filling)
        return data if size is None else data.ljust(size, bytes((self.segment.pad or 0,)))

    def _size(self, filling: Filling) -> int | None:
        """Return the size in memory, or None if it follows from the data themselves."""
        size = self.segment.size
        if isinstance(size, int):
            return size
        if size == "rest":
            return None
        try:
            value = filling.size(size, self.name)
        except Circular:
            return None
        return value if isinstance(value, int) else None

    def write(self, filling: Filling, stream: BytesIO, context: Container, path: str) -> None:
        data, name = filling[self.name], self.name
        if len(data) < self.segment.least:
            raise filling.error(name, f"'{name}' has at least {self.segment.least} bytes, not {len(data)}")
        if not context._state.measuring:
            size = self._size(filling)
            if size is not None and size != len(data):
                raise filling.error(name, f"'{name}' has {size} bytes, not {len(data)}")
        try:
            wire = self.to_wire(data)
        except ValueError:
            raise filling.error(name, f"'{name}' is not made of pairs of hex digits") from None
        if set(wire) & set(self.segment.never):
            raise filling.error(name, f"'{name}' holds a byte that never stands in it")
        stream.write(wire)
        context._state.leaf(wire, len(data))


class DerivedConstruct(ValueSegment):
    """A derived value that takes no bytes.

    Parses to the value of the `read` expression, and notes `value` if that fails. Builds no bytes; a given value must
    equal the derived value.
    """

    segment: Value

    def read(self, stream: BytesIO, context: Container, path: str, place: Place) -> None:
        reading: Reading = context._state
        try:
            value = reading.evaluate(self.segment.read, context, self.name)
        except EVALUATION_ERRORS:
            reading.note(place, "value", str(self.segment.read), "nothing")
            return
        reading.store(context, self.name, _plain(value), place)

    def fill(self, filling: Filling, name: str) -> Any:
        given = filling.given_of(name)
        if given is not MISSING:
            return given
        if not filling.is_there(name):
            raise Absent(name)
        return _plain(filling.compute(self.segment.build or self.segment.read, name))

    def write(self, filling: Filling, stream: BytesIO, context: Container, path: str) -> None:
        value = filling[self.name]
        derived = _plain(filling.compute(self.segment.read, self.name))
        if derived != value:
            raise filling.error(self.name, f"'{self.name}' is computed as {derived!r}, not {value!r}")


def _plain(value: Any) -> Any:
    """Return a flag as a number, other values unchanged."""
    return int(value) if isinstance(value, bool) else value


class RequireConstruct(SegmentConstruct):
    """A condition. Parsing notes `require` if it is false or cannot be evaluated; building raises EncodeError."""

    segment: Require

    def read(self, stream: BytesIO, context: Container, path: str, place: Place) -> None:
        reading: Reading = context._state
        try:
            holds = reading.evaluate(self.segment.condition, context)
        except EVALUATION_ERRORS:
            holds = False
        if not holds:
            reading.note(place, "require", str(self.segment.condition), "")

    def write(self, filling: Filling, stream: BytesIO, context: Container, path: str) -> None:
        if not context._state.measuring and not filling.compute(self.segment.condition, self.label):
            raise filling.error(self.label, f"{self.segment.condition} does not hold")
