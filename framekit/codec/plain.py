"""Convert values between codec form and plain (JSON) form: bytes as hex pairs, times with a unit, numbers also in hex.

The conversion follows the model of the frame: `10` becomes a number, a text or bytes, depending on the field.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from decimal import Decimal
from typing import Any

from framekit.codec.errors import EncodeError
from framekit.codec.shown import explain, shown, with_name
from framekit.definition.load.reader import parse_bytes, parse_number
from framekit.definition.model.frames import by_value_name, everything, flat
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.segments import (
    Bits,
    Count,
    Data,
    Field,
    FieldType,
    Inner,
    Length,
    Nested,
    Repeat,
    Segment,
)
from framekit.definition.problems import did_you_mean
from framekit.definition.times import format_time, parse_time


class PlainValues:
    """Convert the values of a protocol's frames between codec form and plain (JSON) form."""

    def __init__(self, protocol: Protocol) -> None:
        self.protocol = protocol
        self._known: dict[str, dict[str, list[Segment]]] = {}
        self._special: dict[str, dict[str, Segment]] = {}
        self._names: dict[str, dict[str, dict[int, str]]] = {}

    def from_plain(self, frame: str, fields: Mapping[str, Any]) -> dict[str, Any]:
        """Return the codec values of plain values; unknown names are kept, for the encoder to refuse.

        Raises EncodeError.
        """
        known = self._known.get(frame)
        if known is None:
            known = self._known[frame] = _by_name(self.protocol.frames[frame].segments)
        return self._read(known, fields)

    def to_plain(self, frame: str, fields: Mapping[str, Any]) -> dict[str, Any]:
        """Return JSON-ready values: bytes as upper-case hex pairs, times as text."""
        special = self._special.get(frame)
        if special is None:
            if frame not in self.protocol.frames:
                return {name: shown(value) for name, value in fields.items()}
            special = self._special[frame] = _special(self.protocol.frames[frame].segments)
        return self._written(special, fields)

    def named(self, frame: str, path: str, value: Any) -> Any:
        """Return a number together with its name in the frame, `2 (fast)`; any other value unchanged."""
        return with_name(self.names(frame), path, value)

    def names(self, frame: str) -> dict[str, dict[int, str]]:
        """Return the names of numbers by field, of a frame and its inner frames; see `names_of`."""
        names = self._names.get(frame)
        if names is None:
            names = self._names[frame] = names_of(self.protocol, frame)
        return names

    # ---- reading ------------------------------------------------------------------------------------------

    def _read(self, known: Mapping[str, Sequence[Segment]], fields: Mapping[str, Any]) -> dict[str, Any]:
        result = {}
        for name, value in fields.items():
            try:
                result[name] = self._of_one(name, known.get(name, ()), value)
            except (ValueError, TypeError) as error:
                if isinstance(error, EncodeError):
                    raise
                raise EncodeError(name, f"'{name}': {explain(error).partition(' – ')[0]}") from None
        return result

    def _of_one(self, name: str, segments: Sequence[Segment], value: Any) -> Any:
        """Return the value of a name, read by the first of its segments that accepts it.

        Several cases may share a name.
        """
        wrong: ValueError | TypeError | None = None
        for segment in sorted(segments, key=lambda one: not _has_fields(one, value)):
            names = dict(segment.numbers_with_names()).get(name)
            if names is not None and isinstance(value, str) and value in names.values():
                return value
            try:
                return self._value(segment, value)
            except (ValueError, TypeError) as error:
                wrong = wrong or error
        if wrong is not None:
            raise wrong
        return value

    def _value(self, segment: Segment, value: Any) -> Any:
        match segment:
            case Field(type=type_, unit=unit):
                return parse_time(value) if unit is not None and isinstance(value, str) else _typed(type_, value)
            case Data():
                return _bytes(value)
            case Length() | Count():
                return _number(value)
            case Repeat():
                items = value if isinstance(value, list) else [value]
                if (plain := segment.plain_type) is not None:
                    return [_typed(plain, item) for item in items]
                known = _by_name(segment.members)
                return [self._read(known, _mapping(item)) for item in items]
            case Segment(is_record=True):
                return self._read(_by_name(segment.members), _mapping(value))
            case Inner():
                if len(_mapping(value)) != 1:
                    raise ValueError("one frame with its values is wanted here: {frame: {name: value}}")
                ((frame, fields),) = value.items()
                if frame not in self.protocol.frames:
                    return {frame: fields}
                return {frame: self.from_plain(frame, _mapping(fields))}
            case Nested(frame=frame):
                return self.from_plain(frame, _mapping(value))
            case Bits():
                return _number(value)
        return _number(value) if isinstance(value, str) and _is_number(value) else value

    # ---- writing ------------------------------------------------------------------------------------------

    def _written(self, special: Mapping[str, Segment], fields: Mapping[str, Any]) -> dict[str, Any]:
        return {
            name: self._shown(special[name], value) if name in special else shown(value)
            for name, value in fields.items()
        }

    def _shown(self, segment: Segment, value: Any) -> Any:
        match segment:
            case Field() if isinstance(value, int):
                return format_time(value)
            case Repeat(record=of) if of is not None and isinstance(value, list):
                special = _special(of)
                return [self._written(special, item) for item in value]
            case Segment(is_record=True) if isinstance(value, dict):
                return self._written(_special(segment.members), value)
            case Inner() if isinstance(value, dict):
                return {frame: self.to_plain(frame, fields) for frame, fields in value.items()}
            case Nested(frame=frame) if isinstance(value, dict):
                return self.to_plain(frame, value)
        return shown(value)


def _by_name(segments: tuple[Segment, ...]) -> dict[str, list[Segment]]:
    """Return all segments by the names of their values, last segment first; several cases may share a name."""
    found: dict[str, list[Segment]] = {}
    for segment in flat(segments):
        for name in segment.value_names:
            found.setdefault(name, []).insert(0, segment)
    return found


def _has_fields(segment: Segment, value: Any) -> bool:
    """Return whether a record, or a list of records, has all given fields; True for every other segment."""
    if segment.inner_record is None:
        return True
    items = [one for one in (value if isinstance(value, list) else [value]) if isinstance(one, Mapping)]
    return all(set(one) <= _by_name(segment.inner_record).keys() for one in items)


def _special(segments: tuple[Segment, ...]) -> dict[str, Segment]:
    """Return the segments whose plain form depends on the model: times, and segments that hold other values."""
    return {
        name: segment
        for name, segment in by_value_name(segments).items()
        if segment.inner_record
        or isinstance(segment, (Inner, Nested))
        or (isinstance(segment, Field) and segment.unit is not None)
    }


def names_of(protocol: Protocol, frame: str) -> dict[str, dict[int, str]]:
    """Return the names of numbers by field, of a frame and its inner frames.

    Fields with the same name but different names of numbers are omitted.
    """
    found = _names_of(protocol, frame, {}) if frame in protocol.frames else {}
    return {field: dict(names) for field, names in found.items() if names}


def _names_of(
    protocol: Protocol, frame: str, found: dict[str, Mapping[int, str] | None], seen: tuple[str, ...] = ()
) -> dict[str, Mapping[int, str] | None]:
    for segment in everything(protocol.frames[frame].segments):
        for name, names in segment.numbers_with_names():
            found[name] = names if found.get(name, names) == names else None
        for inner in segment.frames_inside:
            if inner in protocol.frames and inner not in (frame, *seen):
                _names_of(protocol, inner, found, (frame, *seen))
    return found


def _typed(type_: FieldType, value: Any) -> Any:
    if type_.kind == "ascii":
        return value if isinstance(value, str) else str(value)
    if type_.kind == "bytes":
        return _bytes(value)
    if type_.kind in ("float", "hex_float"):
        return float(value)
    return _number(value) if type_.is_whole_number else _decimal(value)


def _decimal(value: Any) -> Any:
    """Return an exact decimal from text, or None from empty text. Raises ValueError for any other text."""
    if not isinstance(value, str):
        return value
    try:
        return Decimal(value) if value.strip() else None
    except ArithmeticError:
        raise ValueError(f"'{value}' is no number") from None


def _is_number(text: str) -> bool:
    try:
        parse_number(text)
    except ValueError:
        return False
    return True


def _number(value: Any) -> Any:
    return parse_number(value) if isinstance(value, str) else value


def _bytes(value: Any) -> Any:
    if isinstance(value, str):
        return parse_bytes(value) if value.strip() else b""
    if isinstance(value, list):
        return bytes(value)
    return value


def _mapping(value: Any) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise ValueError("a mapping {name: value} is wanted here")
    return value


# ---- hints where values are refused --------------------------------------------------------------------------

MOST = 8
"""Limit of the listed numbers of a field."""

MOST_NAMES = 16
"""Limit of the listed field names."""

Level = tuple[Mapping[str, Segment], Mapping[str, Any]]
"""The values that a frame or record can have, and the given values."""


def with_hint(
    error: EncodeError, protocol: Protocol, frame: str, given: Mapping[str, Any], more: Iterable[str] = ()
) -> str:
    """Return the message of an error, with a hint for its cause if there is a hint.

    `more` are names that fit elsewhere.
    """
    names = [path.rpartition(".")[2] for path in (error.field, *error.more)]
    levels = list(_levels(protocol, protocol.frames[frame].segments, given))
    found = {name: hint for name in names if (hint := _hint(name, levels, more))}
    hints = [f"{name}: {hint}" for name, hint in found.items()] if error.more else list(found.values())
    return f"{error} – {'; '.join(hints)}" if hints else str(error)


def _hint(name: str, levels: Iterable[Level], more: Iterable[str]) -> str:
    for known, given in levels:
        if name in given and name not in known:
            return _known(name, list(known), more)
        segment = known.get(name)
        numbers = None if segment is None else dict(segment.numbers_with_names()).get(name)
        if numbers and str(given.get(name)) not in {*numbers.values(), *map(str, numbers)}:
            return numbers_of(numbers)
        if isinstance(segment, Inner) and isinstance(value := given.get(name), Mapping):
            return next(
                (did_you_mean(str(frame), segment.frames) for frame in value if frame not in segment.frames), ""
            )
    return ""


def _known(name: str, known: list[str], more: Iterable[str]) -> str:
    """Return the closest known name, if any is close, and the list of fields."""
    near = did_you_mean(name, [*known, *more])
    names = ", ".join(known[:MOST_NAMES]) + (", …" if len(known) > MOST_NAMES else "")
    return f"{near} The fields are {names}" if near.startswith("did you mean") else f"the fields are {names}"


def numbers_of(values: Mapping[int, str]) -> str:
    """Return a hint that lists the numbers of a field: `give 1 (on), 2 (off) or 3 (both)`."""
    shown = [f"{number} ({text})" for number, text in list(values.items())[:MOST]]
    if len(values) > MOST:
        return f"give one of {', '.join(shown)}, …"
    return "give " + " or ".join([", ".join(shown[:-1]), shown[-1]] if len(shown) > 1 else shown)


def _levels(protocol: Protocol, segments: tuple[Segment, ...], given: Any) -> Iterator[Level]:
    """Yield the frame itself, then the given records, items and inner frames at every depth."""
    if not isinstance(given, Mapping):
        return
    known = by_value_name(segments)
    yield known, given
    for name, value in given.items():
        match known.get(name):
            case Segment(is_record=True, members=of):
                yield from _levels(protocol, of, value)
            case Repeat(record=of) if of is not None:
                for item in value if isinstance(value, list) else [value]:
                    yield from _levels(protocol, of, item)
            case Inner() if isinstance(value, Mapping):
                for frame, fields in value.items():
                    if frame in protocol.frames:
                        yield from _levels(protocol, protocol.frames[frame].segments, fields)
            case Nested(frame=frame):
                yield from _levels(protocol, protocol.frames[frame].segments, value)
