"""Where the rest of a region ends: by what is known to follow, or by trying the places where a constant stands."""

from __future__ import annotations

from io import BytesIO

from construct import Container

from construct_oracle.base import SegmentConstruct
from construct_oracle.faults import Place, Stop
from construct_oracle.state import Reading
from framekit.codec.python.facts import in_place_of_records
from framekit.definition.model.segments import Const


def rest_size(construct: SegmentConstruct, stream: BytesIO, context: Container, place: Place) -> int:
    """How many bytes a `rest` takes. Raises Stop when its end is before its start.

    Where what follows has no known size but begins with a constant, the rest ends at the first place where that
    constant stands and everything after it fits.
    """
    reading: Reading = context._state
    room, start = reading.room(context), stream.tell()
    first = next(in_place_of_records(tuple(one.segment for one in reading.following)), None)
    if not room.exact and isinstance(first, Const):
        found = _first_fit(construct, first.data, stream, context)
        if found is not None:
            return found - start
    if room.end < start:
        raise reading.no_room(place, start, room)
    return room.end - start


def _first_fit(construct: SegmentConstruct, constant: bytes, stream: BytesIO, context: Container) -> int | None:
    """The first place of `constant` from which on everything fits; the stream is left where it was."""
    reading: Reading = context._state
    start = stream.tell()
    region = stream.read(reading.region.end - start)
    found = region.find(constant)
    try:
        while found >= 0:
            stream.seek(start)
            if _fits_at(start + found, construct, stream, context):
                return start + found
            found = region.find(constant, found + 1)
        return None
    finally:
        stream.seek(start)


def _fits_at(end: int, construct: SegmentConstruct, stream: BytesIO, context: Container) -> bool:
    """Reads the rest up to `end` and what follows on copies of everything. Whether no fault is found."""
    trial = context._state.copy()
    there = Container(context, _state=trial)
    for key in ("_values", "_marks", "_orders"):
        there[key] = Container(context[key])
    following, region = trial.following, trial.region
    try:
        trial.following = ()
        trial.region = type(region)(end, exact=True)
        construct._parse(stream, there, "(trial)")
        trial.region = region
        for index, subcon in enumerate(following):
            trial.following = following[index + 1 :]
            subcon._parse(stream, there, "(trial)")
    except Stop:
        return False
    trial.finish()
    return not trial.faults.noted and (not region.exact or stream.tell() == region.end)
