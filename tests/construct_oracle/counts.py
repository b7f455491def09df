"""Numbers that follow from other segments: lengths and counts."""

from __future__ import annotations

from io import BytesIO
from typing import Any

from construct import Container

from construct_oracle.base import ValueSegment
from construct_oracle.faults import Place
from construct_oracle.filling import MISSING, Absent, Circular, Filling
from construct_oracle.state import Reading, is_marked, mark_of
from construct_oracle.values import DAMAGED, read_wire, write_wire
from framekit.definition.model.segments import Count, Length


class Computed(ValueSegment):
    """A number computed from other segments: a length or a count.

    Parses to the number, and notes `length` after everything is read if the other segments disagree; `range` and
    `digits` as for a field. Builds the computed number, and refuses another given number.
    """

    segment: Length | Count

    def computed(self, filling: Filling) -> int:
        """Return the number that the given values require."""
        raise NotImplementedError

    def measured(self, context: Container) -> int | None:
        """Return the number that the read segments require, or None if it cannot be determined."""
        raise NotImplementedError

    def read(self, stream: BytesIO, context: Container, path: str, place: Place) -> None:
        segment, reading = self.segment, context._state
        wire = read_wire(segment.type, stream, context, place)
        if wire is DAMAGED:
            return
        value = segment.zero_means if wire == 0 and segment.zero_means is not None else wire
        if segment.limits is not None and not segment.limits[0] <= value <= segment.limits[1]:
            reading.note(place, "range", "{}..{}".format(*segment.limits), value)
        reading.store(context, self.name, value, place)
        reading.later.append(lambda: self._compare(value, reading, context, place))

    def _compare(self, value: int, reading: Reading, context: Container, place: Place) -> None:
        expected = self.measured(context)
        if expected is not None and expected != value:
            reading.note(place, "length", expected, value)

    def fill(self, filling: Filling, name: str) -> Any:
        if filling.given_of(name) is MISSING and not filling.is_there(name):
            raise Absent(name)
        value = self.computed(filling)
        self.refuse_other(filling, value)
        return value

    def write(self, filling: Filling, stream: BytesIO, context: Container, path: str) -> None:
        segment, name = self.segment, self.name
        if context._state.measuring and isinstance(segment.type.size, int):
            stream.write(bytes(segment.type.size))  # the length may include its own size
            context._state.leaf(bytes(segment.type.size))
            return
        value = filling[name]
        if segment.limits is not None and not segment.limits[0] <= value <= segment.limits[1]:
            raise filling.error(name, f"'{name}' is from {segment.limits[0]} to {segment.limits[1]}, not {value}")
        if segment.zero_means is not None and value == 0:
            raise filling.error(name, f"'{name}' cannot be 0, which means {segment.zero_means}")
        wire = 0 if value == segment.zero_means else value
        write_wire(segment.type, wire, name, filling, stream, context)


class LengthConstruct(Computed):
    """The size of the named segments; see `Computed`."""

    segment: Length

    def computed(self, filling: Filling) -> int:
        try:
            size = sum(filling.size_of(name, self.segment.plain) for name in self.segment.of)
        except Circular:
            raise filling.error(self.name, f"'{self.name}' counts what it decides itself") from None
        return size // self.segment.unit + self.segment.plus

    def measured(self, context: Container) -> int | None:
        size = 0
        for name in self.segment.of:
            try:
                mark = mark_of(context, name)
            except KeyError:
                if context._state.stopped:
                    return None
                continue  # absent, so its size is 0
            size += context._state.plain_size(mark) if self.segment.plain else mark.wire
        return size // self.segment.unit + self.segment.plus


class CountConstruct(Computed):
    """The number of items of the named list; see `Computed`."""

    segment: Count

    def computed(self, filling: Filling) -> int:
        items = filling.value_or_nothing(self.segment.of)
        return (0 if items is None else len(items)) + self.segment.plus  # an absent list has no items

    def measured(self, context: Container) -> int | None:
        items = context._values.get(self.segment.of)
        if items is None and self.segment.of not in context._left_out:
            return None
        if context._state.stopped and not is_marked(context, self.segment.of):
            return None
        return len(items or ()) + self.segment.plus  # an absent list has no items
