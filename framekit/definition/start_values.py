"""Start values of state variables that a file gives as lists, records and maps.

`StartValues` converts plain constants by the type of the variable and collects the problems of wrong ones. A record
needs only some of its fields: the others are empty. Guide: files.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any

from framekit.definition.given_values import GivenEntry, GivenValue
from framekit.definition.load.reader import parse_bytes, parse_flag, parse_number
from framekit.definition.model.frames import Layout, by_value_name
from framekit.definition.model.sections import FLOAT_BITS, StateVariable
from framekit.definition.model.segments import Bits, Count, Data, Field, FieldType, Length, Repeat, Segment, Value
from framekit.definition.problems import Position, Problem, did_you_mean, plural
from framekit.definition.times import parse_time
from framekit.definition.wire_types import bounds_of_bits

_INTEGER = re.compile(r"([ui])(8|16|24|32|40|48|56|64)")


class _WrongError(Exception):
    """A value that does not fit its place; the problem has been noted."""


class StartValues:
    """Converts given start values by the layouts of a definition; `problems` collects the faults."""

    def __init__(self, layouts: Mapping[str, Layout]) -> None:
        self.layouts = layouts
        self.problems: list[Problem] = []

    def of(self, variable: StateVariable) -> Any:
        """Return the given start value of a variable: a dict for a table or record, a list; None for a wrong value."""
        assert variable.given is not None
        try:
            if variable.keys is not None:
                return self._table(variable, variable.keys, variable.given)
            layout = self.layouts.get(variable.layout or "")
            if variable.type == "list" and layout is not None:
                return self._list(variable, layout, variable.given)
            if variable.type == "record" and layout is not None:
                return self._record(layout.segments, variable.given)
            return self._plain(variable, variable.given)
        except _WrongError:
            pass
        return None

    # ---- the forms ----------------------------------------------------------------------------------------

    def _table(self, variable: StateVariable, limits: tuple[int, int], given: GivenValue) -> dict[int, Any]:
        entries = given.entries
        low, high = limits
        if entries is None:
            raise self._wrong(given.at, f"'{variable.name}' is a table", f"write {{KEY: value}}, keys {low} to {high}")
        found: dict[int, Any] = {}
        for entry in entries:
            try:
                found[self._key(variable, limits, entry)] = self._held(variable, entry.value)
            except _WrongError:
                continue
        return found

    def _key(self, variable: StateVariable, limits: tuple[int, int], entry: GivenEntry) -> int:
        low, high = limits
        number = self._converted(parse_number, entry.name, entry.at)
        if not low <= number <= high:
            raise self._wrong(entry.at, f"{number} is no key of '{variable.name}'", f"give {low} to {high}")
        return int(number)

    def _held(self, variable: StateVariable, given: GivenValue) -> Any:
        """Return an entry of a table."""
        layout = self.layouts.get(variable.type)
        if layout is not None:
            return self._record(layout.segments, given)
        return self._plain(variable, given)

    def _list(self, variable: StateVariable, layout: Layout, given: GivenValue) -> list[Any]:
        items = given.items
        if items is None:
            raise self._wrong(given.at, f"'{variable.name}' is a list", "write [{NAME: value, …}, …]")
        if variable.most is not None and len(items) > variable.most:
            what = f"{plural(len(items), 'item')} do not fit: '{variable.name}' holds {variable.most}"
            self._note(given.at, what, "leave some out")
        return [self._record(layout.segments, item) for item in items]

    def given_fields(self, segments: tuple[Segment, ...], given: GivenValue) -> dict[str, Any]:
        """Return the given fields of a record, converted; wrong ones are left out, their problems are noted."""
        try:
            return self._fields(segments, given)
        except _WrongError:
            return {}

    def _record(self, segments: tuple[Segment, ...], given: GivenValue) -> dict[str, Any]:
        """Return a record with the given fields; the others are empty, those that the encoder computes are missing."""
        fields = self._fields(segments, given)
        computed = _computed(segments)
        return {name: value for name, value in empty_record(segments).items() if name not in computed} | fields

    def _fields(self, segments: tuple[Segment, ...], given: GivenValue) -> dict[str, Any]:
        known = by_value_name(segments)
        if given.entries is None:
            names = ", ".join(
                name for name, segment in known.items() if not isinstance(segment, (Count, Length, Value))
            )
            raise self._wrong(given.at, "this is no record", f"write {{NAME: value}} with some of {names}")
        computed = _computed(segments)
        record: dict[str, Any] = {}
        for entry in given.entries:
            segment = known.get(entry.name)
            if segment is None or entry.name in computed:
                what = f"there is no field '{entry.name}'" if segment is None else f"'{entry.name}' is computed"
                hint = did_you_mean(entry.name, known) if segment is None else "leave it out"
                self._note(entry.at, what, hint or f"the fields are {', '.join(known)}")
                continue
            try:
                record[entry.name] = self._field(entry.name, segment, entry.value)
            except _WrongError:
                continue
        return record

    # ---- fields of records --------------------------------------------------------------------------------

    def _field(self, name: str, segment: Segment, given: GivenValue) -> Any:
        if isinstance(segment, Repeat):
            if given.items is None:
                raise self._wrong(given.at, f"'{name}' is a list", "write […]")
            if segment.plain_type is None:
                return [self._record(segment.members, item) for item in given.items]
            return [self._typed(name, segment.plain_type, item) for item in given.items]
        if segment.is_record:
            return self._record(segment.members, given)
        if isinstance(segment, Data):
            return self._converted(_bytes, self._text(given), given.at)
        names = dict(segment.numbers_with_names()).get(name)
        for number, text in (names or {}).items():
            if given.text == text:
                return number
        if isinstance(segment, Bits):
            most = next(part.most for part in segment.parts if part.name == name)
            return self._number(name, given, None if most is None else (0, most), names)
        if isinstance(segment, Field):
            if segment.unit is not None:
                return self._converted(parse_time, self._text(given), given.at)
            if segment.type.is_whole_number:
                bounds = segment.limits
                if bounds is None and segment.type.bounds is not None:
                    bounds = (segment.type.bounds[0] - segment.plus, segment.type.bounds[1] - segment.plus)
                return self._number(name, given, bounds, names)
            return self._typed(name, segment.type, given)
        raise self._wrong(given.at, f"'{name}' cannot be given", "leave it out")

    def _typed(self, name: str, type_: FieldType, given: GivenValue) -> Any:
        text, size = self._text(given), type_.fixed_size
        if type_.kind == "ascii":
            if not text.isascii() or (size is not None and len(text) > size):
                raise self._wrong(given.at, f"'{text}' does not fit into '{name}'", f"give {size} ASCII characters")
            return text
        if type_.kind == "bytes":
            data: bytes = self._converted(_bytes, text, given.at)
            if size is not None and len(data) != size:
                raise self._wrong(given.at, f"'{name}' has {plural(size, 'byte')}", "write them as hex pairs")
            return data
        if type_.is_whole_number:
            return self._number(name, given, type_.bounds, None)
        return self._converted(float, text, given.at)

    def _number(
        self, name: str, given: GivenValue, bounds: tuple[int, int] | None, names: Mapping[int, str] | None
    ) -> int:
        text = self._text(given)
        try:
            number = parse_number(text)
        except ValueError as error:
            hint = did_you_mean(text, list(names.values())) if names else ""
            what, _, todo = str(error).partition(" – ")
            raise self._wrong(given.at, what, hint or todo or "write a number") from None
        if bounds is not None and not bounds[0] <= number <= bounds[1]:
            what = f"{number} does not fit: '{name}' holds {bounds[0]} to {bounds[1]}"
            raise self._wrong(given.at, what, "correct it")
        return number

    # ---- plain values -------------------------------------------------------------------------------------

    def _plain(self, variable: StateVariable, given: GivenValue) -> Any:
        """Return a value of a plain type, such as u16, text or time."""
        type_, text = variable.type, self._text(given)
        match = _INTEGER.fullmatch(type_)
        if match is not None:
            number = variable.number_of(text)
            return number if number != text else self._number(
                variable.name, given, bounds_of_bits(int(match[2]), match[1] == "i"), variable.values
            )  # fmt: skip
        if type_ == "text":
            return text
        if type_ == "bytes":
            data: bytes = self._converted(_bytes, text, given.at)
            if variable.size is not None and len(data) != variable.size:
                raise self._wrong(given.at, f"'{variable.name}' has {variable.size} bytes", "write them as hex pairs")
            return data
        readers: dict[str, Callable[[str], Any]] = {"flag": parse_flag, "number": parse_number, "time": parse_time}
        if type_ in FLOAT_BITS:
            return self._converted(float, text, given.at)
        if type_ not in readers:
            raise self._wrong(given.at, f"entries of type {type_} cannot be given", "leave them out")
        return self._converted(readers[type_], text, given.at)

    def _text(self, given: GivenValue) -> str:
        if given.text is None:
            raise self._wrong(given.at, "this must be a single value", "write a single value")
        return given.text

    # ---- problems -----------------------------------------------------------------------------------------

    def _converted(self, convert: Callable[[str], Any], text: str, at: Position) -> Any:
        try:
            return convert(text)
        except ValueError as error:
            what, _, todo = str(error).partition(" – ")
            raise self._wrong(at, what, todo or "correct it") from None

    def _note(self, at: Position, what: str, todo: str) -> None:
        self.problems.append(Problem(at, what, todo))

    def _wrong(self, at: Position, what: str, todo: str) -> _WrongError:
        self._note(at, what, todo)
        return _WrongError(what)


def _bytes(text: str) -> bytes:
    return parse_bytes(text) if text.strip() else b""


def _computed(segments: tuple[Segment, ...]) -> set[str]:
    """Return the names of the values that are computed from others."""
    return {name for name, one in by_value_name(segments).items() if isinstance(one, (Count, Length, Value))}


def empty_record(segments: tuple[Segment, ...]) -> dict[str, Any]:
    """Return an empty record of a layout: numbers 0, texts and lists empty, bytes zero."""
    record: dict[str, Any] = {}
    for segment in segments:
        if isinstance(segment, Field):
            record[segment.name] = _empty_field(segment)
        elif isinstance(segment, Data):
            record[segment.name] = bytes(segment.size) if isinstance(segment.size, int) else b""
        elif segment.is_record:
            record.update(dict.fromkeys(segment.value_names, empty_record(segment.members)))
        elif segment.is_list:
            record.update((name, []) for name in segment.value_names)
        else:
            record.update((name, 0) for name, _ in segment.numbers_with_names())
            record.update(empty_record(segment.usual_block))
    return record


def _empty_field(segment: Field) -> Any:
    kind = segment.type.kind
    if kind == "ascii":
        return ""
    if kind == "bytes":
        return bytes(segment.type.fixed_size or 0)
    return 0.0 if kind == "float" else 0
