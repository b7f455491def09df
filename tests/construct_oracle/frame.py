"""Whole frames and layouts as constructs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from io import BytesIO
from typing import Any

from construct import Construct, Container, SizeofError, stream_read_entire, stream_write

from construct_oracle.faults import (
    ConstructEncodeError,
    ConstructFrameError,
    Fault,
    Place,
    Stop,
)
from construct_oracle.filling import Circular, Filling, Plan
from construct_oracle.holders import Segments, open_context
from construct_oracle.names import Names
from construct_oracle.sizes import KnownSizes
from construct_oracle.state import Reading, Region, Writing
from framekit.codec.evaluate import MissingName
from framekit.definition.model.frames import Frame, everything, in_place_of_records
from framekit.definition.model.segments import Const, Segment


@dataclass(frozen=True, slots=True)
class Outcome:
    """The result of reading: values, number of bytes, and the decisive fault with its refusal."""

    values: Container
    size: int
    fault: Fault | None
    refuse: int | None

    @property
    def is_usable(self) -> bool:
        """Return whether the frame is good or to be refused."""
        return self.fault is None or self.refuse is not None


class FrameConstruct(Construct):
    """A frame of a protocol (or a layout): head, body and tail.

    Parses the whole stream, which must hold exactly one frame, into a Container of its values; use `Prefixed`,
    `FixedSized` or the like if more data follow. Builds from a mapping; computed values may be left out. Parameters,
    state, `request` and other names of its expressions are keyword arguments of `parse` and `build`; constant defaults
    are known. `sizeof` gives the size of frames of fixed size.

    Raises ConstructFrameError (a FrameError) when parsing, ConstructEncodeError (an EncodeError) when building, and
    MissingName if parsing needs a name that was not given.
    """

    def __init__(
        self,
        frame: Frame,
        sections: tuple[Segments, Segments, Segments],
        plan: Plan,
        sizes: KnownSizes,
        known: Mapping[str, Any],
    ) -> None:
        super().__init__()
        self.name = frame.name
        self.docs = frame.doc
        self.frame = frame
        self.head, self.body, self.tail = sections
        self.plan = plan
        self.declared = frozenset(plan.values)
        self.sizes = sizes
        self.known = known

    # ---- construct ----------------------------------------------------------------------------------------

    def _parse(self, stream: BytesIO, context: Container, path: str) -> Container:
        names = Names.of_params(context._params, self.known)
        outcome = self.read(stream_read_entire(stream, path), names, context, path)
        if outcome.fault is not None:
            raise ConstructFrameError(outcome.fault, outcome.refuse, outcome.values, path)
        return outcome.values

    def _build(self, obj: Any, stream: BytesIO, context: Container, path: str) -> Any:
        data = self.to_bytes(obj, Names.of_params(context._params, self.known), context, path)
        stream_write(stream, data, len(data), path)
        return obj

    def _sizeof(self, context: Container, path: str) -> int:
        size = self.sizes.of_frame(self.frame)
        if size is None:
            raise SizeofError(f"the size of {self.frame.name} varies", path=path)
        return size

    # ---- parsing ------------------------------------------------------------------------------------------

    def read(self, data: bytes, names: Names, outer: Container, path: str, exact: bool = True) -> Outcome:
        """Read a frame from the start of `data`; `exact`: the frame must take all of it."""
        stream = BytesIO(data)
        reading = Reading(names, self.sizes, Region(len(data), exact))
        context = open_context(outer, reading, stream, self.declared, is_frame=True)
        try:
            self._read_sections(stream, reading, context, path)
        except Stop:
            reading.stopped_in(self.frame.segments)
        else:
            self._read_end(stream, reading, len(data))
        reading.finish()
        fault = reading.faults.verdict()
        if fault is None:
            return Outcome(context._values, stream.tell(), None, None)
        orders = context._orders
        last = reading.order + 1 if fault.cause == "check" else fault.place.order  # keep values of a wrong code
        values = Container((name, value) for name, value in context._values.items() if orders[name] < last)
        return Outcome(values, stream.tell(), fault, reading.faults.refusal(fault))

    def _read_sections(self, stream: BytesIO, reading: Reading, context: Container, path: str) -> None:
        reading.following = self.body.subcons + self.tail.subcons
        self.head._parse(stream, context, path)
        end = self._end_of_body(stream, reading, context)
        if end is None:
            reading.following = self.tail.subcons
            self.body._parse(stream, context, path)
            end = self._end_of_body(stream, reading, context)  # values of the body may determine the size of the tail
            if end is not None and stream.tell() < end:
                reading.leaf(reading.take(stream, end - stream.tell(), reading.place(stream, "frame", None)))
        else:
            self._read_bounded(end, stream, reading, context, path)
        reading.following = ()
        self.tail._parse(stream, context, path)

    def _end_of_body(self, stream: BytesIO, reading: Reading, context: Container) -> int | None:
        """Return the end of the body if a mark or the frame size decides it; None if it follows from the segments."""
        if self.frame.delimited:
            start, mark = stream.tell(), self.end_mark
            found = stream.getvalue().find(mark, start, reading.region.end)
            if found < 0:
                raise reading.stop(reading.place(stream, "tail", None), "short", mark)
            return found
        if self.frame.size is None:
            return None
        tail = self.sizes.all((construct.segment for construct in self.tail.subcons), reading.known_in(context))
        return None if tail is None else min(self.frame.size - tail, reading.region.end)

    @property
    def end_mark(self) -> bytes:
        """Return the first byte of the tail's first constant, which ends a delimited body."""
        first = next((item.segment for item in self.tail.subcons if isinstance(item.segment, Const)), None)
        return b"" if first is None else first.data[:1]

    def _read_bounded(self, end: int, stream: BytesIO, reading: Reading, context: Container, path: str) -> None:
        """Read a body that ends at `end`, also if its content is wrong."""
        with reading.within(Region(end, exact=self.frame.size is None)):  # otherwise fill bytes may follow
            try:
                self.body._parse(stream, context, path)
            except Stop:
                reading.stopped_in(self.frame.body)
            else:
                left = stream.tell()
                if self.frame.size is None and left < end:
                    place = reading.place(stream, "body", self.frame.surplus)
                    reading.note(place, "surplus", "", stream.getvalue()[left:end])
        reading.leaf(stream.getvalue()[stream.tell() : end])
        stream.seek(end)

    def _read_end(self, stream: BytesIO, reading: Reading, size: int) -> None:
        """Note surplus bytes after the last segment, and a frame that is too short or too long."""
        place = reading.place(stream, "frame", self.frame.surplus)
        if reading.region.exact and stream.tell() < size:
            reading.note(place, "surplus", "", stream.getvalue()[stream.tell() :])
        if self.frame.size is not None and stream.tell() < self.frame.size:
            reading.note(place, "short", f"{self.frame.size} bytes", size)
        if self.frame.most is not None and stream.tell() > self.frame.most:
            reading.note(Place(place.order, 0, "frame", None), "too_long", f"{self.frame.most} bytes", size)

    # ---- building -----------------------------------------------------------------------------------------

    def to_bytes(self, values: Any, names: Names, outer: Container, path: str, prefix: str = "") -> bytes:
        """Return the frame of these values; `prefix` precedes the names of its fields in errors."""
        if not isinstance(values, Mapping):
            raise ConstructEncodeError(prefix.rstrip("."), f"a frame is made of a mapping, not of {values!r}", path)
        try:
            filling = Filling(self.plan, values, names, None, prefix, self.frame.echo)
            stream = BytesIO()
            writing = Writing(names)
            context = open_context(outer, writing, stream, self.declared, is_frame=True)
            with writing.deeper():
                self._write_sections(filling, stream, context, path)
            filling.refuse_absent()
        except Circular as error:
            raise ConstructEncodeError(error.name, f"'{error.name}' is missing", path) from None
        except MissingName as error:
            raise ConstructEncodeError(prefix.rstrip("."), str(error), path) from None
        data = stream.getvalue()
        for segment, written, start, place in writing.texts:
            stops = () if segment.number_type is None else segment.number_type.stops
            ends = min((at for stop in stops if (at := data.find(stop, start)) >= 0), default=-1)
            if written is stream and segment in self.open_texts and ends != place:
                raise ConstructEncodeError(prefix + (segment.name or ""), f"'{segment.name}' does not end there", path)
        if self.frame.most is not None and len(data) > self.frame.most:
            raise ConstructEncodeError(
                prefix.rstrip("."), f"{self.frame.name} has at most {self.frame.most} bytes, not {len(data)}", path
            )
        return data

    @property
    def open_texts(self) -> list[Segment]:
        """Return texts with stop bytes that are followed by other segments or contained in others."""
        behind = [segment for segment in in_place_of_records(self.frame.segments) if segment.takes_bytes]
        inside = [segment for segment in everything(self.frame.segments) if segment not in behind]
        return [
            reading
            for reading in (*behind[:-1], *inside)
            if reading.number_type is not None and reading.number_type.stops
        ]

    def _write_sections(self, filling: Filling, stream: BytesIO, context: Container, path: str) -> None:
        self.head._build(filling, stream, context, path)
        start = stream.tell()
        self.body._build(filling, stream, context, path)
        if self.frame.delimited and self.end_mark in stream.getvalue()[start:]:
            raise filling.error("", f"the body of {self.frame.name} holds its end {self.end_mark.hex().upper()}")
        if self.frame.size is not None:
            room = self.frame.size - stream.tell() - filling.size_of_all(self.tail.subcons)
            if room < 0:
                raise filling.error("", f"{self.frame.name} has {self.frame.size} bytes, {-room} more are given")
            fill = bytes((self.frame.fill,)) * room
            stream.write(fill)
            context._state.leaf(fill)
        self.tail._build(filling, stream, context, path)
