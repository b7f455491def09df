"""Frames inside frames: select the matching candidate and find its end."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from io import BytesIO
from typing import Any

from construct import Container

from construct_oracle.base import ValueSegment
from construct_oracle.faults import Place
from construct_oracle.filling import MISSING, Absent, Filling
from construct_oracle.frame import FrameConstruct, Outcome
from construct_oracle.rest import rest_size
from construct_oracle.sizes import nothing_known
from construct_oracle.state import Reading
from construct_oracle.values import evaluated_size
from framekit.codec.python.facts import in_place_of_records
from framekit.definition.expression import Expression
from framekit.definition.model.frames import Frame
from framekit.definition.model.segments import Inner, Nested

UNKNOWN = "unknown"
"""The name for the bytes of an inner region that no frame fits."""


class NestedConstruct(ValueSegment):
    """A layout that contains itself, one level deeper. Parses to its fields, builds from them."""

    segment: Nested

    def __init__(self, segment: Nested, frames: Mapping[str, FrameConstruct]) -> None:
        super().__init__(segment)
        self.frames = frames

    def read(self, stream: BytesIO, context: Container, path: str, place: Place) -> None:
        reading: Reading = context._state
        start = stream.tell()
        data = stream.read(max(reading.region.end - start, 0))
        outcome = self.frames[self.segment.frame].read(data, reading.names, context, path, exact=False)
        stream.seek(start + outcome.size)
        reading.leaf(data[: outcome.size])
        reading.store(context, self.name, outcome.values, place)
        if outcome.fault is not None:
            inner = outcome.fault.place
            inner_place = reading.place(stream, inner.label, outcome.refuse)
            moved = Place(
                inner_place.order, reading.offset(start + inner.offset), inner_place.label, inner_place.refuse
            )
            reading.note(moved, outcome.fault.cause, outcome.fault.expected, outcome.fault.found)

    def fill(self, filling: Filling, name: str) -> Any:
        given = filling.given_of(name)
        if given is MISSING:
            if not filling.is_there(name):
                raise Absent(name)
            raise filling.error(name, f"'{name}' is missing")
        if not isinstance(given, Mapping):
            raise filling.error(name, f"'{name}' is a mapping of fields, not {given!r}")
        return given

    def write(self, filling: Filling, stream: BytesIO, context: Container, path: str) -> None:
        prefix = f"{filling.path}{self.name}."
        frame = self.frames[self.segment.frame]
        data = frame.to_bytes(filling[self.name], filling.names, context, path, prefix)
        stream.write(data)
        context._state.leaf(data)


class InnerConstruct(ValueSegment):
    """A frame inside a frame: one of several candidates.

    Parses to a Container with one entry, the frame's name and its values, from the first candidate that fits or is to
    be refused (candidates that exist to be refused come last); to `unknown` with the bytes if none fits but the region
    is known. Builds from such a mapping. Raises Stop (parsing) if none fits and the end of the frame is unknown.
    """

    segment: Inner

    def __init__(self, segment: Inner, frames: Mapping[str, FrameConstruct], models: Mapping[str, Frame]) -> None:
        super().__init__(segment)
        self.frames = frames
        self.always = replace(segment, when=None)
        self.candidates = sorted(segment.frames, key=lambda name: models[name].refuse is not None)

    def read(self, stream: BytesIO, context: Container, path: str, place: Place) -> None:
        reading: Reading = context._state
        start = stream.tell()
        data, exact = self._region(stream, reading, context, place)
        for name in self.candidates:
            outcome = self.frames[name].read(data, reading.names, context, f"{path} -> {name}", exact)
            if outcome.is_usable:
                break
        else:
            if not exact:
                raise reading.stop(place, "value", "one of its frames", data)
            name, outcome = UNKNOWN, Outcome(Container(data=data), len(data), None, None)
        size = len(data) if exact else outcome.size
        stream.seek(stream.tell() + size)
        reading.leaf(data[:size])
        reading.store(context, self.name, Container({name: outcome.values}), place)
        if outcome.fault is not None:
            inner = outcome.fault.place
            inner_place = reading.place(stream, inner.label, outcome.refuse)
            moved = Place(
                inner_place.order, reading.offset(start + inner.offset), inner_place.label, inner_place.refuse
            )
            reading.note(moved, outcome.fault.cause, outcome.fault.expected, outcome.fault.found)

    def _region(self, stream: BytesIO, reading: Reading, context: Container, place: Place) -> tuple[bytes, bool]:
        """Return the bytes that the frame may take, and whether it must take all of them."""
        start = stream.tell()
        size = self.segment.size or reading.sizes.of(self.always, nothing_known)
        if isinstance(size, Expression):
            size = evaluated_size(size, reading, context, place)
        if isinstance(size, int):
            data, exact = reading.take(stream, size, place), True
        elif size == "rest":
            data, exact = stream.read(rest_size(self, stream, context, place)), True
        else:
            room = reading.room(context)
            if room.end < start:
                raise reading.no_room(place, start, room)
            behind = in_place_of_records(tuple(construct.segment for construct in reading.following))
            known = (reading.sizes.of(replace(segment, when=None), nothing_known) for segment in behind)
            data, exact = stream.read(room.end - start), room.exact and None not in known
        stream.seek(start)
        return data, exact

    def fill(self, filling: Filling, name: str) -> Any:
        given = filling.given_of(name)
        if given is MISSING:
            if not filling.is_there(name):
                raise Absent(name)
            raise filling.error(name, f"'{name}' is missing")
        if not isinstance(given, Mapping) or len(given) != 1:
            raise filling.error(name, f"'{name}' is a frame {{name: fields}}, not {given!r}")
        (frame,) = given
        if frame not in self.segment.frames and frame != UNKNOWN:
            raise filling.error(name, f"'{name}' cannot be the frame {frame!r}")
        return given

    def write(self, filling: Filling, stream: BytesIO, context: Container, path: str) -> None:
        ((frame, values),) = filling[self.name].items()
        prefix = f"{filling.path}{self.name}.{frame}."
        if frame != UNKNOWN:
            data = self.frames[frame].to_bytes(values, filling.names, context, path, prefix)
        else:
            given = values.get("data") if isinstance(values, Mapping) else None
            if not isinstance(given, bytes):
                raise filling.error(self.name, f"'{prefix}data' is bytes, not {given!r}")
            data = given
        size = self.segment.size
        if not context._state.measuring and isinstance(size, (int, Expression)):
            wanted = filling.size(size, self.name) if isinstance(size, Expression) else size
            if wanted is not None and wanted != len(data):
                raise filling.error(self.name, f"'{self.name}' has {wanted} bytes, not {len(data)}")
        stream.write(data)
        context._state.leaf(data)
