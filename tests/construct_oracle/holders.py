"""Segments that contain segments: sequences, records, repeats, choices, optional parts."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import nullcontext
from io import BytesIO
from typing import Any

from construct import Construct, Container

from construct_oracle.base import SegmentConstruct, ValueSegment, named_segments, names_of
from construct_oracle.faults import Place
from construct_oracle.filling import MISSING, Absent, Filling, Plan
from construct_oracle.rest import rest_size
from construct_oracle.state import Reading, Region, State
from construct_oracle.values import DAMAGED, evaluated_size, of_type, read_wire, write_wire
from framekit.codec.evaluate import EVALUATION_ERRORS
from framekit.definition.expression import Expression
from framekit.definition.model.segments import (
    INDEX,
    LAST,
    PLAIN,
    PREVIOUS,
    Choose,
    FieldType,
    ItemEnd,
    Optional,
    Record,
    Repeat,
    lack_default,
)


class Segments(Construct):
    """A sequence of segments; their values belong to the enclosing record.

    Parses and builds each in turn, in the given context. Raises Stop if the next segment cannot be located.
    """

    def __init__(self, subcons: tuple[SegmentConstruct, ...]) -> None:
        super().__init__()
        self.subcons = subcons
        self.flagbuildnone = True

    def _parse(self, stream: BytesIO, context: Container, path: str) -> None:
        reading: Reading = context._state
        behind = reading.following
        for index, subcon in enumerate(self.subcons):
            reading.following = self.subcons[index + 1 :] + behind
            subcon._parsereport(stream, context, path)
        reading.following = behind

    def _build(self, obj: Any, stream: BytesIO, context: Container, path: str) -> Any:
        for subcon in self.subcons:
            subcon._build(obj, stream, context, path)
        return obj


class Fields(Construct):
    """A record: segments whose values form a mapping, in a context of their own.

    Parses to a Container of the values. Builds from a `Filling`, and refuses values that were given for absent
    segments.
    """

    def __init__(self, segments: Segments, plan: Plan) -> None:
        super().__init__()
        self.segments = segments
        self.plan = plan
        self.declared = frozenset(plan.values)

    def open(self, stream: BytesIO, context: Container) -> Container:
        """Return the context of a record before reading; its values are collected in `_values`."""
        return open_context(context, context._state, stream, self.declared)

    def _parse(self, stream: BytesIO, context: Container, path: str) -> Container:
        inner = self.open(stream, context)
        self.segments._parse(stream, inner, path)
        return inner._values

    def _build(self, obj: Any, stream: BytesIO, context: Container, path: str) -> Any:
        inner = open_context(context, context._state, stream, self.declared)
        self.segments._build(obj, stream, inner, path)
        obj.refuse_absent()
        return obj


class ReadRecord(Container):
    """The values of a record that is being read. In expressions, a missing value is absent instead of an error."""

    def value_or_nothing(self, name: str) -> Any:
        return self.get(name)


def open_context(
    outer: Container, state: State, stream: BytesIO, declared: frozenset[str], is_frame: bool = False
) -> Container:
    """Return a context for a record, like that of construct's Struct, with the extra entries for frame segments."""
    context = Container(
        _=outer,
        _params=outer.get("_params"),
        _parsing=isinstance(state, Reading),
        _building=not isinstance(state, Reading),
        _sizing=False,
        _io=stream,
        _index=outer.get("_index"),
        _state=state,
        _declared=declared,
        _values=Container() if is_frame else ReadRecord(),
        _orders={},
        _marks={},
        _left_out=set(),
        _item=None,
        _words=None,
        _is_frame=is_frame,
    )
    context._root = outer.get("_root", context)
    return context


class RecordConstruct(ValueSegment):
    """A layout under its own name: parses to and builds from a mapping. All its values may be computed."""

    segment: Record

    def __init__(self, segment: Record, fields: Fields) -> None:
        super().__init__(segment)
        self.fields = fields

    def read(self, stream: BytesIO, context: Container, path: str, place: Place) -> None:
        reading: Reading = context._state
        room = reading.room(context)
        with reading.within(room) if room.exact else nullcontext():  # otherwise later segments end a rest
            inner = self.fields.open(stream, context)
            reading.store(context, self.name, inner._values, place)
            self.fields.segments._parse(stream, inner, path)

    def fill(self, filling: Filling, name: str) -> Any:
        given = filling.given_of(name)
        if given is MISSING:
            if not filling.is_there(name):
                raise Absent(name)
            if lack_default(self.segment.of):
                raise filling.error(name, f"'{name}' is missing")
            given = {}
        return _inner_filling(self.fields.plan, given, filling, name)

    def write(self, filling: Filling, stream: BytesIO, context: Container, path: str) -> None:
        self.fields._build(filling[self.name], stream, context, path)


def _inner_filling(plan: Plan, given: Any, outer: Filling, name: str, item: tuple[str, int] | None = None) -> Filling:
    if not isinstance(given, Mapping):
        raise outer.error(name, f"'{name}' is a mapping of fields, not {given!r}")
    return Filling(plan, given, outer.names, outer, f"{outer.path}{name}.", item=item)


class RepeatConstruct(ValueSegment):
    """A list of records, or of plain values of one type.

    Parses `times` items, or as many as the region contains. Builds every item of the given list. Raises Stop (parsing)
    if the number cannot be evaluated.
    """

    segment: Repeat

    def __init__(self, segment: Repeat, fields: Fields | None) -> None:
        super().__init__(segment)
        self.fields = fields

    def read(self, stream: BytesIO, context: Container, path: str, place: Place) -> None:
        reading: Reading = context._state
        if self.fields is None:
            self._read_values(reading, stream, context, place)
            return
        items: list[Any] = []
        if not self.segment.single:
            reading.store(context, self.name, items, place)
        times = self._times(reading, context, place)
        with reading.within(self._room(reading, stream, context, place)), reading.as_it_stands(stream):
            start = stream.tell()
            while self._goes_on(items, times, reading, stream):
                if self.segment.between:
                    self._pass_fill(start, reading, stream, place)
                before = stream.tell()
                inner = self.fields.open(stream, context)
                inner._item = self.name, len(items)
                inner._words = {INDEX: len(items), PREVIOUS: items[-1] if items else None}
                if times is not None:
                    inner._words[LAST] = len(items) == times - 1
                items.append(inner._values)
                with reading.within(Region(reading.region.end, exact=False)):  # another item may follow
                    self.fields.segments._parse(stream, inner, f"{path}[{len(items) - 1}]")
                if not isinstance(self.segment.times, int) and stream.tell() == before:
                    raise reading.stop(place, "length", "items that take room", "0 bytes")
                if not self.segment.between:
                    self._pass_fill(start, reading, stream, place)
                if self.segment.until is not None and inner._words[LAST]:
                    break
                if self.segment.until is None and times is None:
                    inner._words[LAST] = stream.tell() >= reading.region.end
        if self.segment.single and all(PLAIN in item for item in items):
            reading.store(context, self.name, [item[PLAIN] for item in items], place)

    def _pass_fill(self, start: int, reading: Reading, stream: BytesIO, place: Place) -> None:
        """Skip the padding after an item."""
        reading.leaf(reading.take(stream, -(stream.tell() - start) % self.segment.align, place))

    def _goes_on(self, items: list[Any], times: int | None, reading: Reading, stream: BytesIO) -> bool:
        if self.segment.until is not None:
            return True  # until an item ends the list, or bytes are missing
        return len(items) < times if times is not None else stream.tell() < reading.region.end

    def _read_values(self, reading: Reading, stream: BytesIO, context: Container, place: Place) -> None:
        """Read plain values; the list is absent if a value cannot be read."""
        assert isinstance(self.segment.of, FieldType)
        items: list[Any] = []
        times = self._times(reading, context, place)
        with reading.within(self._room(reading, stream, context, place)):
            while len(items) < times if times is not None else stream.tell() < reading.region.end:
                left, size = reading.region.end - stream.tell(), self.segment.of.fixed_size
                if times is None and size is not None and left < size:
                    reading.leaf(reading.take(stream, left, place))
                    reading.note(place, "short", f"{size} bytes", f"{left}")
                    return
                items.append(read_wire(self.segment.of, stream, context, place))
        if all(item is not DAMAGED for item in items):
            reading.store(context, self.name, items, place)

    def _room(self, reading: Reading, stream: BytesIO, context: Container, place: Place) -> Region:
        if self.segment.times != "rest":
            return reading.room(context)
        return Region(stream.tell() + rest_size(self, stream, context, place), exact=True)

    def _times(self, reading: Reading, context: Container, place: Place) -> int | None:
        times = self.segment.times
        if isinstance(times, Expression):
            return evaluated_size(times, reading, context, place)
        return times if isinstance(times, int) else None

    def fill(self, filling: Filling, name: str) -> Any:
        given = filling.given_of(name)
        if given is MISSING and not filling.is_there(name):
            raise Absent(name)
        if given is MISSING:
            raise filling.error(name, f"'{name}' is missing")
        if not isinstance(given, (list, tuple)):
            raise filling.error(name, f"'{name}' is a list, not {given!r}")
        of = self.segment.of
        if isinstance(of, FieldType):
            return [of_type(of, item, f"{name}[{place}]", filling) for place, item in enumerate(given)]
        assert self.fields is not None
        plan = self.fields.plan
        if self.segment.single:
            given = [{PLAIN: item} for item in given]
        items = [
            _inner_filling(plan, item, filling, f"{name}[{place}]", (name, place)) for place, item in enumerate(given)
        ]
        for place, item in enumerate(items):
            previous = items[place - 1] if place else None
            item.words = {INDEX: place, LAST: place == len(items) - 1, PREVIOUS: previous}
        return items

    def write(self, filling: Filling, stream: BytesIO, context: Container, path: str) -> None:
        items = filling[self.name]
        if self.segment.until is not None and not items:
            raise filling.error(self.name, f"'{self.name}' has at least one item")
        if not context._state.measuring and self.segment.is_counted:
            times = self.segment.times
            wanted = filling.compute(times, self.name) if isinstance(times, Expression) else times
            if wanted != len(items):
                raise filling.error(self.name, f"'{self.name}' has {wanted} items, not {len(items)}")
        with context._state.as_it_stands(stream):
            self._write_items(items, filling, stream, context, path)

    def _write_items(self, items: list[Any], filling: Filling, stream: BytesIO, context: Container, path: str) -> None:
        start, segment = stream.tell(), self.segment
        for place, item in enumerate(items):
            if place and segment.align > 1:
                self._fill_up(start, stream, context)
            if self.fields is not None:
                before = stream.tell()
                self.fields._build(item, stream, context, f"{path}[{place}]")
                if stream.tell() == before and not isinstance(self.segment.times, int):
                    name = f"{self.name}[{place}]"
                    raise filling.error(name, f"'{name}' takes no bytes, so nothing shows that it is there")
            else:
                assert isinstance(self.segment.of, FieldType)
                write_wire(self.segment.of, item, f"{self.name}[{place}]", filling, stream, context)
        if items and segment.align > 1 and not segment.between:
            self._fill_up(start, stream, context)

    def _fill_up(self, start: int, stream: BytesIO, context: Container) -> None:
        fill = bytes((self.segment.fill,)) * (-(stream.tell() - start) % self.segment.align)
        stream.write(fill)
        context._state.leaf(fill)


class ItemEndConstruct(SegmentConstruct):
    """The end of an item. Parses to whether `until` makes it the last item; builds no bytes."""

    segment: ItemEnd

    def read(self, stream: BytesIO, context: Container, path: str, place: Place) -> None:
        if self.segment.until is None:
            return
        try:
            context._words[LAST] = bool(context._state.evaluate(self.segment.until, context))
        except EVALUATION_ERRORS:
            raise context._state.stop(place, "value", str(self.segment.until), "nothing") from None

    def write(self, filling: Filling, stream: BytesIO, context: Container, path: str) -> None:
        until = self.segment.until
        if until is None or context._state.measuring:
            return
        if bool(filling.compute(until, "until")) is not filling.word(LAST):
            raise filling.error("", f"{until} must hold in the last item and in no other")


class ChooseConstruct(SegmentConstruct):
    """One of several sequences, selected by the value of an expression; their values belong to the enclosing record.

    Parsing notes `value` and raises Stop if neither a case nor an `else` exists; building raises EncodeError.
    """

    segment: Choose

    def __init__(self, segment: Choose, cases: tuple[Segments, ...], otherwise: Segments | None) -> None:
        super().__init__(segment)
        self.cases = cases
        self.otherwise = otherwise

    def case_of(self, value: Any) -> Segments | None:
        """Return the sequence for a value."""
        for (keys, _), segments in zip(self.segment.cases, self.cases, strict=True):
            if value in keys:
                return segments
        return self.otherwise

    def chosen(self, filling: Filling) -> Segments | None:
        """Return the sequence for values that are being built."""
        return self.case_of(filling.compute(self.segment.on, self.label))

    def read(self, stream: BytesIO, context: Container, path: str, place: Place) -> None:
        reading: Reading = context._state
        try:
            value = reading.evaluate(self.segment.on, context)
        except EVALUATION_ERRORS:
            raise reading.stop(place, "value", str(self.segment.on), "nothing") from None
        segments = self.case_of(value)
        if segments is None:
            raise reading.stop(place, "value", "one of the cases", value)
        case_segments = tuple(construct.segment for construct in segments.subcons)
        reading.leave_out(context, names_of((self.segment,)) - names_of(case_segments))
        segments._parse(stream, context, path)

    def write(self, filling: Filling, stream: BytesIO, context: Container, path: str) -> None:
        segments = self.chosen(filling)
        if segments is None:
            raise filling.error(self.label, f"there is no case for {filling.compute(self.segment.on, self.label)!r}")
        segments._build(filling, stream, context, path)


class OptionalConstruct(SegmentConstruct):
    """Segments that may be missing at the end of a region; their values belong to the enclosing record.

    Parses them if bytes are left in the region, builds them if one of their values is given.
    """

    segment: Optional

    def __init__(self, segment: Optional, segments: Segments, names: tuple[str, ...]) -> None:
        super().__init__(segment)
        self.segments = segments
        self.names = names

    def is_wanted(self, filling: Filling) -> bool:
        """Return whether a value inside is given."""
        return any(filling.given_of(name) is not MISSING for name in self.names)

    def read(self, stream: BytesIO, context: Container, path: str, place: Place) -> None:
        reading: Reading = context._state
        if rest_size(self, stream, context, place) > 0:
            self.segments._parse(stream, context, path)
        else:
            reading.leave_out(context, self.names)
            reading.mark_absent(named_segments(self.segment.of), context, stream)

    def write(self, filling: Filling, stream: BytesIO, context: Container, path: str) -> None:
        if self.is_wanted(filling):
            self.segments._build(filling, stream, context, path)
        else:
            context._state.mark_absent(named_segments(self.segment.of), context, stream)
