"""Base constructs of all segments: presence, offset in the frame, and values.

The construct of a segment gets the context of a record: it reads into the record, and writes from its `Filling`.
"""

from __future__ import annotations

from io import BytesIO
from typing import Any

from construct import Construct, Container

from construct_oracle.faults import Place
from construct_oracle.filling import MISSING, Filling
from construct_oracle.state import Reading
from framekit.codec.evaluate import EVALUATION_ERRORS
from framekit.definition.model.segments import (
    Bits,
    Choose,
    Count,
    Data,
    Field,
    Inner,
    Length,
    Nested,
    Optional,
    Record,
    Repeat,
    Segment,
    Value,
    Wrap,
)


def value_names(segment: Segment) -> tuple[str, ...]:
    """Return the names of the values that the segment itself adds to its record."""
    if isinstance(segment, Bits):
        return tuple(part.name for part in segment.parts)
    valued = (Field, Data, Length, Count, Repeat, Record, Inner, Nested, Value)
    return (segment.name,) if isinstance(segment, valued) else ()


def named_segments(segments: tuple[Segment, ...]) -> list[Segment]:
    """Return the segments whose values belong to one record, including those in wraps, choices and optional parts."""
    found: list[Segment] = []
    for segment in segments:
        found.append(segment)
        if isinstance(segment, (Wrap, Optional)):
            found.extend(named_segments(segment.of))
        elif isinstance(segment, Choose):
            for _, case in segment.cases:
                found.extend(named_segments(case))
            found.extend(named_segments(segment.otherwise or ()))
    return found


def names_of(segments: tuple[Segment, ...]) -> set[str]:
    """Return the names of all values of these segments."""
    return {name for segment in named_segments(segments) for name in value_names(segment)}


def label_of(segment: Segment) -> str:
    """Return the name of a segment for fault messages: its own name, or its kind if the loader made the name up."""
    if segment.name and not segment.name.startswith("_"):
        return segment.name
    return type(segment).__name__.lower()


class SegmentConstruct(Construct):
    """A segment of a frame, only usable inside a record.

    Parsing stores into the record's context and notes faults instead of raising them; building reads the record's
    filling. A segment takes no bytes if its `when` is false. Raises Stop if no later segment can be located (parsing),
    EncodeError (building).
    """

    def __init__(self, segment: Segment) -> None:
        super().__init__()
        self.segment = segment
        self.name = segment.name
        self.label = label_of(segment)
        self.flagbuildnone = True

    # ---- to be written by subclasses ----------------------------------------------------------------------

    def read(self, stream: BytesIO, context: Container, path: str, place: Place) -> None:
        """Read the segment, which is present."""
        raise NotImplementedError

    def write(self, filling: Filling, stream: BytesIO, context: Container, path: str) -> None:
        """Write the segment, which is present."""
        raise NotImplementedError

    def read_absent(self, context: Container, place: Place) -> None:
        """Store the value of an absent segment, if any."""

    def refuse_absent(self, filling: Filling, name: str) -> None:
        """Refuse a value `name` that was given for an absent segment. Raises EncodeError."""
        given = filling.given_of(name)
        if given is not None:
            raise filling.error(name, f"'{name}' is not part of this frame, but {given!r} is given")

    # ---- construct ----------------------------------------------------------------------------------------

    def _parse(self, stream: BytesIO, context: Container, path: str) -> None:
        reading: Reading = context._state
        place = reading.place(stream, self.label, self.segment.refuse)
        if not self._is_there(reading, context, place):
            reading.leave_out(context, names_of((self.segment,)))
            reading.mark_absent(named_segments((self.segment,)), context, stream)
            self.read_absent(context, place)
            return
        with reading.marked(self.segment.name, stream, context, path):
            self.read(stream, context, f"{path} -> {self.label}", place)

    def _is_there(self, reading: Reading, context: Container, place: Place) -> bool:
        if self.segment.when is None:
            return True
        try:
            return bool(reading.evaluate(self.segment.when, context))
        except EVALUATION_ERRORS:
            raise reading.stop(place, "value", str(self.segment.when), "nothing") from None

    def _build(self, obj: Any, stream: BytesIO, context: Container, path: str) -> Any:
        filling: Filling = obj
        if not self.holds(filling):
            context._state.mark_absent(named_segments((self.segment,)), context, stream)
            return obj
        with context._state.marked(self.segment.name, stream, context, path):
            self.write(filling, stream, context, f"{path} -> {self.label}")
        return obj

    def holds(self, filling: Filling) -> bool:
        """Return whether the segment's own `when` is true for these values."""
        when = self.segment.when
        return when is None or bool(filling.compute(when, self.label))


class ValueSegment(SegmentConstruct):
    """A segment that is one value of its record, under its own name."""

    name: str

    def fill(self, filling: Filling, name: str) -> Any:
        """Return the value to build, given or computed. Raises EncodeError, Absent."""
        raise NotImplementedError

    def refuse_other(self, filling: Filling, value: Any) -> None:
        """Refuse a given value that differs from the computed value. Raises EncodeError."""
        given = filling.given_of(self.name)
        if given is not MISSING and given != value:
            raise filling.error(self.name, f"'{self.name}' is computed as {value!r}, not {given!r}")
