"""Resolution of names once all frames are known: names of numbers, `station:` of rows, the words of items.

The fields of a name are narrowed to the relevant frames: for `it` of a row its frames, for `request` and `reply` of
a service row the frames it sends and takes. `station:` becomes a condition: the station that the frame names is this
one.

The field of a frame that holds its station follows from the values that fill it: services and sequences that build the
frame contain `{frame: {field: station}}`, or an expression over `station`, parameters, tables and numbers. The name of
a field has no meaning by itself, except if no constructor builds the frame: then a field called `station` is its
station. Fields that a parameter fills (`{frame: {device: device_id}}`, or their `default:`) are compared at the same
place, except parameters that only the client has or that are secret, and fields that a row of services judges itself.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Set
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cache
from typing import Any, TypeVar

from framekit.definition.expression import (
    Attribute,
    Compare,
    Expression,
    Index,
    List,
    Logic,
    Name,
    Node,
    Number,
    Text,
    both,
    is_constant,
    names_in,
    parse_expression,
    tells_setting,
)
from framekit.definition.load.reader import Reader
from framekit.definition.model.frames import (
    Frame,
    by_value_name,
    change_all,
    everything,
    field_names,
    flat,
    names_read_in,
    nearest_path,
)
from framekit.definition.model.procedure import Row, Sequence
from framekit.definition.model.sections import Parameter, StateVariable
from framekit.definition.model.segments import (
    ITEM_WORDS,
    LAST,
    Data,
    Field,
    ItemEnd,
    Repeat,
    Require,
    Segment,
    Segments,
)
from framekit.definition.model.services import ServiceRow
from framekit.definition.model.values import FrameOf, RecordOf, Value
from framekit.definition.problems import Position, did_you_mean

NumbersOf = Callable[[Node], "Mapping[str, int] | None"]
"""Function that returns the numbers by name for the field that a node reads; None if it has no names."""


def resolve_names(reader: Reader, value: Any, numbers_of: NumbersOf) -> Any:
    """Return a model value with every expression in it resolved."""
    if isinstance(value, Compare):
        value = _compared(reader, value, numbers_of)
    elif isinstance(value, Segment) and value.chooses_by is not None:
        value = value.with_numbers(reader, _numbers(value.chooses_by.root, numbers_of))
    return _changed(value, lambda part: resolve_names(reader, part, numbers_of))


def _changed(value: Any, change: Callable[[Any], Any]) -> Any:
    """Return a value with each of its parts changed; the same object if no part has changed."""
    if isinstance(value, Position):
        return value
    if isinstance(value, tuple):
        items = tuple(change(item) for item in value)
        return value if all(new is old for new, old in zip(items, value, strict=True)) else items
    if isinstance(value, dict):
        return {key: change(item) for key, item in value.items()}
    changes = {}
    for name in _field_names(value.__class__):
        old = getattr(value, name)
        if old.__class__ is not Position and (isinstance(old, (tuple, dict)) or _field_names(old.__class__)):
            new = change(old)
            if new is not old:
                changes[name] = new
    return replace(value, **changes) if changes else value


@cache
def _field_names(kind: type) -> tuple[str, ...]:
    """Return the names of the fields of a data class; an empty tuple for any other class."""
    return tuple(field.name for field in fields(kind)) if is_dataclass(kind) else ()


def _compared(reader: Reader, node: Compare, numbers_of: NumbersOf) -> Compare:
    operands = [node.first, *(operand for _, operand in node.rest)]
    numbers = next((found for operand in operands if (found := _numbers(operand, numbers_of)) is not None), None)
    if numbers is None:
        return node
    first, *rest = (_numbered(reader, operand, numbers) for operand in operands)
    return replace(
        node, first=first, rest=tuple((operator, new) for (operator, _), new in zip(node.rest, rest, strict=True))
    )


def _numbers(node: Node, numbers_of: NumbersOf) -> Mapping[str, int] | None:
    return numbers_of(node) if isinstance(node, (Name, Attribute)) else None


def _numbered(reader: Reader, node: Node, numbers: Mapping[str, int]) -> Node:
    if isinstance(node, Text):
        if node.value in numbers:
            return Number(node.at, numbers[node.value])
        reader.note(node.at, f"'{node.value}' is not a name of this field's values", did_you_mean(node.value, numbers))
    if isinstance(node, List):
        return replace(node, items=tuple(_numbered(reader, item, numbers) for item in node.items))
    return node


@dataclass(frozen=True, slots=True)
class _Fields:
    """The values of one frame."""

    paths: Set[str]
    numbers: Mapping[str, Mapping[str, int] | None]
    """Numbers by name for the paths of numbers; None for numbers without names."""


def numbers_by_name(named: Iterable[tuple[str, Mapping[int, str] | None]]) -> dict[str, Mapping[str, int] | None]:
    """Return the numbers by name for each field; None for a name whose fields differ (in their names, or in having
    any).
    """
    result: dict[str, Mapping[str, int] | None] = {}
    for name, values in named:
        numbers = None if values is None else {text: number for number, text in values.items()}
        if name in result and result[name] != numbers:
            numbers = None
        result[name] = numbers
    return result


T = TypeVar("T")


class NumberNames:
    """Resolve the names of numbers, narrowed to the frame and the record that has them."""

    def __init__(self, reader: Reader, frames: Mapping[str, Frame], state: Mapping[str, StateVariable]) -> None:
        self.reader = reader
        self.by_frame = {name: _named_fields(frame.segments) for name, frame in frames.items()}
        """The fields of each frame, by path, with their names of numbers."""
        fields = [item for known in self.by_frame.values() for item in known]
        named = [(path.rpartition(".")[2], values) for path, values in fields]
        named += [(name, variable.values) for name, variable in state.items() if variable.values]
        self.everywhere = numbers_by_name(named)

    def frame(self, frame: Frame) -> Frame:
        """Return the frame, with each name in an expression resolved in the innermost record that has it."""
        own = _Fields(
            {path for one in everything(frame.segments) for path in map(one.sibling_path, one.value_names)},
            numbers_by_name(self.by_frame[frame.name]),
        )
        head, body, tail = (self._scoped(part, own) for part in (frame.head, frame.body, frame.tail))
        apart: Frame = self._resolved(replace(frame, head=(), body=(), tail=()), None, own)
        return replace(apart, head=head, body=body, tail=tail)

    def _scoped(self, segments: Segments, own: _Fields) -> Segments:
        """Resolve the segments of one record, and those of the records in it."""

        def change(segment: Segment) -> Segment:
            found: Segment = self._resolved(segment.with_lists(lambda _: ()), segment, own)
            blocks = iter(segment.blocks)
            return found.with_blocks(lambda _: next(blocks)).with_record(lambda _: self._scoped(segment.members, own))

        return change_all(segments, change)

    def _resolved(self, value: Any, segment: Segment | None, own: _Fields) -> Any:
        """Resolve the names in a segment; None: in the frame itself."""

        def numbers(node: Node) -> Mapping[str, int] | None:
            name, *fields = _way_to(node)
            first = name if segment is None else nearest_path(name, segment, own.paths)
            path = ".".join((first, *fields))
            return own.numbers.get(path) if path in own.paths else self._anywhere(node)

        return resolve_names(self.reader, value, numbers)

    def plainly(self, value: T) -> T:
        resolved: T = resolve_names(self.reader, value, self._anywhere)
        return resolved

    def _anywhere(self, node: Node) -> Mapping[str, int] | None:
        return self.everywhere.get(node.name) if isinstance(node, (Name, Attribute)) else None

    def sequence(self, sequence: Sequence) -> Sequence:
        """Resolve the rows first, with `it` narrowed to their frames, then the rest of the sequence."""
        return self.plainly(_rows_changed(sequence, self._row))

    def _row(self, row: Row) -> Row:
        narrowed = numbers_by_name([item for name in row.frames for item in self.by_frame.get(name, ())])

        def numbers(node: Node) -> Mapping[str, int] | None:
            whose, *fields = _way_to(node)
            path = ".".join(fields)
            return narrowed[path] if whose == "it" and path in narrowed else self._anywhere(node)

        resolved: Row = resolve_names(self.reader, row, numbers)
        return resolved

    def service(self, row: ServiceRow) -> ServiceRow:
        """Resolve a row, with `request` and `reply` narrowed to its frames."""
        sent = () if row.request is None else self.by_frame.get(row.request.frame, ())
        replies = [reply.frame.frame for reply in row.reply if reply.frame is not None]
        frames = {
            "request": numbers_by_name(sent),
            "reply": numbers_by_name([item for name in replies for item in self.by_frame.get(name, ())]),
        }

        def numbers(node: Node) -> Mapping[str, int] | None:
            whose, *fields = _way_to(node)
            path = ".".join(fields)
            return frames[whose][path] if path in frames.get(whose, ()) else self._anywhere(node)

        resolved: ServiceRow = resolve_names(self.reader, row, numbers)
        return resolved


def _rows_changed(sequence: Sequence, change: Callable[[Row], Row]) -> Sequence:
    steps = tuple(
        step if step.receive is None else replace(step, receive=tuple(change(row) for row in step.receive))
        for step in sequence.steps
    )
    return replace(sequence, steps=steps, always=tuple(change(row) for row in sequence.always))


def _way_to(node: Node) -> tuple[str, ...]:
    """Return the name whose field an expression reads, and the path of the field; an item counts as its list."""
    match node:
        case Name(name=name):
            return (name,)
        case Attribute(value=value, name=name):
            return (*_way_to(value), name)
        case Index(value=value):
            return _way_to(value)
    return ("",)


def _named_fields(segments: tuple[Segment, ...]) -> list[tuple[str, Mapping[int, str] | None]]:
    """Return the paths of fields that hold numbers, with the names of the numbers."""
    return [
        (segment.sibling_path(name), names)
        for segment in everything(segments)
        for name, names in segment.numbers_with_names()
    ]


# ---- stations ----------------------------------------------------------------------------------------------


STATION = "station"

Path = tuple[str, ...]
"""Path of a field through the records of a frame."""

Way = tuple[tuple[Path, Expression], ...]
"""A way in which a constructor fills the station of a frame: fields with their expressions."""


@dataclass(frozen=True)
class Stations:
    """Station fields of frames."""

    ways: Mapping[str, tuple[Way, ...]]
    """Frame → the ways in which constructors fill its station."""
    given: Mapping[str, set[str]]
    """Frame → all fields that constructors fill."""
    settings: Mapping[str, Mapping[Path, tuple[Expression, ...]]]
    """Frame → fields that parameters fill, with all expressions used."""
    padding: Mapping[str, Mapping[Path, str]]
    """Frame → padded fields, each with its padding as a literal of the language."""

    @classmethod
    def derived(
        cls,
        frames: Mapping[str, Frame],
        built: Iterable[tuple[FrameOf, Collection[str], Collection[str]]],
        shared: Iterable[str],
        parameters: Mapping[str, Parameter],
    ) -> Stations:
        """Derive the stations of frames from constructors.

        `built`: constructors, each with the names that have another meaning there (arguments, variables), and the
        fields that are judged there. `shared`: the names that an expression may read in addition to `station`, because
        both sides have them.
        """
        known = {STATION, *shared}
        constructors: dict[str, list[dict[Path, Expression]]] = {}
        given: dict[str, set[str]] = {}
        everything: dict[str, dict[Path, list[Expression | None]]] = {}
        compared = {name for name, one in parameters.items() if one.is_compared}
        for made, hidden, judged in (one for one in built if one[0].frame in frames):
            segments = frames[made.frame].segments
            fields = dict(_filled(made.fields, segments))
            required = {name for one in _conditions(segments) for name in names_in(one.root)}
            by_default = dict(_defaults(made.fields, segments, compared - required))
            for path, value in (*fields.items(), *by_default.items()):
                is_known = path[-1] not in judged and names_in(value.root) <= known - {STATION} - set(hidden)
                everything.setdefault(made.frame, {}).setdefault(path, []).append(value if is_known else None)
            filled = {path: value for path, value in fields.items() if names_in(value.root) <= known}
            constructors.setdefault(made.frame, []).append(filled)
            given.setdefault(made.frame, set()).update(made.fields)
        ways = {name: _ways(found) for name, found in constructors.items()}
        for name, frame in frames.items():
            if name not in given and STATION in field_names(frame.segments):
                ways[name] = ((((STATION,), Expression(STATION, Name(frame.at, STATION))),),)
        settings = {name: _settings(found, compared) for name, found in everything.items()}
        return cls(ways, given, settings, {name: dict(_padding(frames[name].segments)) for name in {*ways, *settings}})

    def compared(self, reader: Reader, sequence: Sequence) -> Sequence:
        """Return the sequence with each `station:` expressed in the `when` of its row."""
        return _rows_changed(sequence, lambda row: row if row.station is None else self._row(reader, row, row.station))

    def _row(self, reader: Reader, row: Row, station: Expression) -> Row:
        if row.expected or "frame" not in row.places:
            reader.note(row.places[STATION], "only frames have a station", "leave station out, or name the frames")
        when = row.when
        alike: dict[object, list[str]] = {}
        for name in row.frames:
            if self.ways.get(name):
                fills = tuple(self.padding[name].get(path) for way in self.ways[name] for path, _ in way)
                alike.setdefault((_texts(self.ways[name]), fills), []).append(name)
        for names in reversed(alike.values()):
            ways = self.ways[names[0]]
            field = ways[0][0][0][0]
            others = [name for name in row.frames if name not in names and field in self.given.get(name, ())]
            when = both(_condition(ways, others, station, self.padding[names[0]]), when)
        for path, values, names in self._settings_of(row):
            others = [name for name in row.frames if name not in names and path[0] in self.given.get(name, ())]
            ways = tuple(((path, value),) for value in values)
            when = both(_condition(ways, others, station, self.padding[names[0]]), when)
        return replace(row, when=when)

    def _settings_of(self, row: Row) -> Iterator[tuple[Path, tuple[Expression, ...], list[str]]]:
        """Yield the fields that parameters fill, their expressions, and the frames of the row with them."""
        found: dict[tuple[Path, str | None, tuple[str, ...]], tuple[tuple[Expression, ...], list[str]]] = {}
        for name in row.frames:
            for path, values in self.settings.get(name, {}).items():
                texts = tuple(value.text for value in values)
                found.setdefault((path, self.padding[name].get(path), texts), (values, []))[1].append(name)
        for (path, _, _), (values, names) in found.items():
            yield path, values, names


def _filled(given: Mapping[str, Value], segments: tuple[Segment, ...]) -> Iterator[tuple[Path, Expression]]:
    """Yield the existing fields with the given values."""
    known = by_value_name(segments)
    for name, value in given.items():
        if isinstance(value, Expression) and name in known:
            yield (name,), value
        elif isinstance(value, RecordOf) and name in known:
            yield from (((name, *path), one) for path, one in _filled(value.fields, known[name].inner_record or ()))


def _defaults(
    given: Mapping[str, Value], segments: tuple[Segment, ...], parameters: Collection[str]
) -> Iterator[tuple[Path, Expression]]:
    """Yield the fields without a given value whose default depends on a parameter."""
    for name, segment in by_value_name(segments).items():
        default = segment.default if isinstance(segment, Field) else None
        if default is not None and name not in given and tells_setting(default, parameters):
            own = field_names(segments) - {name}
            if not names_in(default.root) & own:
                yield (name,), default


def _conditions(segments: Iterable[Segment]) -> Iterator[Expression]:
    """Yield the conditions that the frame itself requires, with a refusal of its own."""
    yield from (one.condition for one in flat(segments) if isinstance(one, Require))


def _padding(segments: tuple[Segment, ...]) -> Iterator[tuple[Path, str]]:
    """Yield the padded fields: data keep their padding when they are read, texts lose it."""
    for name, segment in by_value_name(segments).items():
        if isinstance(segment, Data) and segment.pad is not None:
            yield (name,), f"h'{segment.pad:02X}'"
        elif isinstance(segment, Field) and segment.type.value_kind == "text" and segment.type.pad is not None:
            letter = segment.type.pad.decode("latin-1")
            if letter.isprintable() and letter not in "'\\":
                yield (name,), f"'{letter}'"
        elif segment.is_record:
            yield from (((name, *path), one) for path, one in _padding(segment.inner_record or ()))


def _ways(constructors: list[dict[Path, Expression]]) -> tuple[Way, ...]:
    paths = {path for filled in constructors for path, value in filled.items() if STATION in names_in(value.root)}
    found = [tuple((path, filled[path]) for path in sorted(paths & filled.keys())) for filled in constructors]
    return tuple({_texts([way]): way for way in found if way}.values())


def _settings(
    filled: Mapping[Path, list[Expression | None]], compared: Collection[str]
) -> dict[Path, tuple[Expression, ...]]:
    """Return the fields that every constructor fills with a parameter of both sides, or else with a constant."""
    found: dict[Path, tuple[Expression, ...]] = {}
    for path, values in filled.items():
        known = {value.text: value for value in values if value is not None}
        named = [value for value in known.values() if tells_setting(value, compared)]
        if named and None not in values and all(value in named or is_constant(value) for value in known.values()):
            found[path] = tuple(known.values())
    return found


def _texts(ways: Iterable[Way]) -> tuple[tuple[Path, str], ...]:
    """Return a key of ways: equal for ways with equal texts at different places."""
    return tuple((path, value.text) for way in ways for path, value in way)


def _condition(
    ways: tuple[Way, ...], others: list[str], station: Expression, padding: Mapping[Path, str]
) -> Expression:
    """Return `'field' not in it or it.field == station`, for each way; `others`: frames with another use of the
    field.
    """
    at = station.at
    texts, nodes = [], list[Node]()
    first = ways[0][0][0][0]
    texts.append(f"'{first}' not in it")
    nodes.append(Compare(at, Text(at, first), (("not in", Name(at, "it")),)))
    if others:
        texts.append(f"it.frame in {others}")
        listed = List(at, tuple(Text(at, name) for name in others))
        nodes.append(Compare(at, Attribute(at, Name(at, "it"), "frame"), (("in", listed),)))
    for way in ways:
        pairs = [_same(path, value, station, at, padding.get(path)) for path, value in way]
        texts.append(" and ".join(text for text, _ in pairs))
        nodes.append(pairs[0][1] if len(pairs) == 1 else Logic(at, "and", tuple(node for _, node in pairs)))
    return Expression(" or ".join(texts), Logic(at, "or", tuple(nodes)))


def _same(path: Path, value: Expression, station: Expression, at: Position, pad: str | None) -> tuple[str, Node]:
    """Return the comparison of a field with `value` for this station, padded with `pad` if given."""
    node: Node = Name(at, "it")
    for name in path:
        node = Attribute(at, node, name)
    text = re.sub(rf"\b{STATION}\b", lambda _: station.text, value.text)
    if pad is not None:
        field, wanted = f"it.{'.'.join(path)}", f"({text})"
        longer, shorter = (field, wanted) if pad.startswith("h'") else (wanted, field)
        text = f"{longer}[0:len({shorter})] == {shorter} and only({longer}[len({shorter}):], {pad})"
        return text, parse_expression(text, at).root
    return f"it.{'.'.join(path)} == {text}", Compare(at, node, (("==", _put(value.root, station.root)),))


def _put(node: Any, station: Node) -> Any:
    """Return an expression with `station` replaced by another expression."""
    if isinstance(node, Name) and node.name == STATION:
        return station
    return _changed(node, lambda part: _put(part, station))


# ---- `index`, `last` and `previous` in the items of lists --------------------------------------------------


def with_item_words(segments: Segments, known: Collection[str], in_item: bool = False) -> Segments:
    """Return the segments with the words of items resolved.

    `known`: other known names; `in_item`: the segments are an item. The words are replaced by unique internal names; a
    field, variable, parameter, table or queue with the name of a word takes precedence over it. So both compilers and
    the checker see only unambiguous names.
    """
    names = {*known, *field_names(segments)}
    meant = {word: name for word, name in ITEM_WORDS.items() if word not in names} if in_item else {}

    def change(segment: Segment) -> Segment:
        if meant:
            segment = _renamed(segment, meant)
        return segment.with_record(lambda of: _inside(segment, of, names, in_item))

    return change_all(segments, change)


def _inside(holder: Segment, of: Segments, names: Collection[str], in_item: bool) -> Segments:
    """Return the segments of a record or an item; an item whose end shows whether it is the last gets an `ItemEnd`."""
    found = with_item_words(of, names, in_item or holder.is_list)
    if isinstance(holder, Repeat) and holder.times == "rest" and LAST in names_read_in(found):
        found = (*found, ItemEnd(at=holder.at))
    return found


def _renamed(segment: Segment, meant: Mapping[str, str]) -> Segment:
    """Return a segment with names in its own expressions replaced; inner segments are left unchanged."""

    def name(node: Any) -> Any:
        if isinstance(node, Name) and node.name in meant:
            return replace(node, name=meant[node.name])
        return _changed(node, name) if isinstance(node, (Node, tuple)) else node

    def expression(part: Any) -> Any:
        if isinstance(part, Expression):
            return replace(part, root=name(part.root)) if names_in(part.root) & meant.keys() else part
        return part if isinstance(part, Segment) else _changed(part, expression)

    changed: Segment = _changed(segment, expression)
    return changed
