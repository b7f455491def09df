"""Find the end of the rest of a region: by the size of the following segments, or by trying matches of a constant."""

from __future__ import annotations

from io import BytesIO

from construct import Container

from construct_oracle.base import SegmentConstruct
from construct_oracle.faults import Place, Stop
from construct_oracle.state import Reading
from framekit.codec.python.facts import in_place_of_records
from framekit.definition.model.segments import Const


def rest_size(construct: SegmentConstruct, stream: BytesIO, context: Container, place: Place) -> int:
    """Return the number of bytes that a `rest` takes. Raises Stop if its end is before its start.

    If the size of the following segments is unknown but they begin with a constant, the rest ends at the first match of
    the constant from which on all following segments fit.
    """
    reading: Reading = context._state
    room, start = reading.room(context), stream.tell()
    first = next(in_place_of_records(tuple(reading_after.segment for reading_after in reading.following)), None)
    if not room.exact and isinstance(first, Const):
        found = _first_fit(construct, first.data, stream, context)
        if found is not None:
            return found - start
    if room.end < start:
        raise reading.no_room(place, start, room)
    return room.end - start


def _first_fit(construct: SegmentConstruct, constant: bytes, stream: BytesIO, context: Container) -> int | None:
    """Return the first offset of `constant` from which on everything fits; restore the stream position."""
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
    """Return whether the rest up to `end` and all following segments can be read without a fault.

    Reading works on copies of all state.
    """
    trial = context._state.copy()
    trial_context = Container(context, _state=trial)
    for key in ("_values", "_marks", "_orders"):
        trial_context[key] = Container(context[key])
    following, region = trial.following, trial.region
    try:
        trial.following = ()
        trial.region = type(region)(end, exact=True)
        construct._parse(stream, trial_context, "(trial)")
        trial.region = region
        for index, subcon in enumerate(following):
            trial.following = following[index + 1 :]
            subcon._parse(stream, trial_context, "(trial)")
    except Stop:
        return False
    trial.finish()
    return not trial.faults.noted and (not region.exact or stream.tell() == region.end)
