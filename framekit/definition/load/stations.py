"""`station:` of a row becomes a condition: the station that the frame names is this one.

Which field of a frame is its station follows from what fills it: services and sequences that build the frame say
`{frame: {field: station}}`, or an expression over `station`, parameters, tables and numbers. No field's name means
anything, except where nothing builds a frame: there a field called `station` is one.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

from framekit.definition.expression.syntax import (
    Attribute,
    Compare,
    Expression,
    List,
    Logic,
    Name,
    Node,
    Text,
    both,
    names_in,
)
from framekit.definition.kinds.base import Segment
from framekit.definition.load.reader import Reader
from framekit.definition.model.frames import Frame
from framekit.definition.model.procedure import Row, Sequence
from framekit.definition.model.values import FrameOf, RecordOf, Value
from framekit.definition.model.walk import by_value_name, field_names
from framekit.definition.problems import Position

STATION = "station"

Path = tuple[str, ...]
"""A field's way through the records of a frame."""

Way = tuple[tuple[Path, Expression], ...]
"""How one constructor fills the station of a frame: fields and what is in them."""


@dataclass(frozen=True)
class Stations:
    """Where frames carry their station.

    `ways`: frame → every way in which something fills its station. `given`: frame → all fields that something fills.
    """

    ways: Mapping[str, tuple[Way, ...]]
    given: Mapping[str, set[str]]

    @classmethod
    def derived(cls, frames: Mapping[str, Frame], built: Iterable[FrameOf], shared: Iterable[str]) -> Stations:
        """`shared`: what an expression may read beside `station`, as both sides have it."""
        known = {STATION, *shared}
        constructors: dict[str, list[dict[Path, Expression]]] = {}
        given: dict[str, set[str]] = {}
        for made in (one for one in built if one.frame in frames):
            fields = dict(_filled(made.fields, frames[made.frame].segments))
            filled = {path: value for path, value in fields.items() if names_in(value.root) <= known}
            constructors.setdefault(made.frame, []).append(filled)
            given.setdefault(made.frame, set()).update(made.fields)
        ways = {name: _ways(found) for name, found in constructors.items()}
        for name, frame in frames.items():
            if name not in given and STATION in field_names(frame.segments):
                ways[name] = ((((STATION,), Expression(STATION, Name(frame.at, STATION))),),)
        return cls(ways, given)

    def compared(self, reader: Reader, sequence: Sequence) -> Sequence:
        """The sequence with what each `station:` comes to in the `when` of its row."""

        def changed(rows: Iterable[Row]) -> tuple[Row, ...]:
            return tuple(row if row.station is None else self._row(reader, row, row.station) for row in rows)

        steps = tuple(
            step if step.receive is None else replace(step, receive=changed(step.receive)) for step in sequence.steps
        )
        return replace(sequence, steps=steps, always=changed(sequence.always))

    def _row(self, reader: Reader, row: Row, station: Expression) -> Row:
        if row.expected or "frame" not in row.places:
            reader.note(row.places[STATION], "only frames have a station", "leave station out, or name the frames")
        when = row.when
        alike: dict[object, list[str]] = {}
        for name in row.frames:
            if self.ways.get(name):
                alike.setdefault(_texts(self.ways[name]), []).append(name)
        for names in reversed(alike.values()):
            ways = self.ways[names[0]]
            field = ways[0][0][0][0]
            others = [name for name in row.frames if name not in names and field in self.given.get(name, ())]
            when = both(_condition(ways, others, station), when)
        return replace(row, when=when)


def _filled(given: Mapping[str, Value], segments: tuple[Segment, ...]) -> Iterator[tuple[Path, Expression]]:
    """Fields that there are, with what is given for them."""
    there = by_value_name(segments)
    for name, value in given.items():
        if isinstance(value, Expression) and name in there:
            yield (name,), value
        elif isinstance(value, RecordOf) and name in there:
            yield from (((name, *path), one) for path, one in _filled(value.fields, there[name].inner_record or ()))


def _ways(constructors: list[dict[Path, Expression]]) -> tuple[Way, ...]:
    paths = {path for filled in constructors for path, value in filled.items() if STATION in names_in(value.root)}
    found = [tuple((path, filled[path]) for path in sorted(paths & filled.keys())) for filled in constructors]
    return tuple({_texts([way]): way for way in found if way}.values())


def _texts(ways: Iterable[Way]) -> tuple[tuple[Path, str], ...]:
    """What ways have in common that say the same in different places."""
    return tuple((path, value.text) for way in ways for path, value in way)


def _condition(ways: tuple[Way, ...], others: list[str], station: Expression) -> Expression:
    """`'field' not in it or it.field == station`, for each way; `others` use such a field otherwise."""
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
        pairs = [_same(path, value, station, at) for path, value in way]
        texts.append(" and ".join(text for text, _ in pairs))
        nodes.append(pairs[0][1] if len(pairs) == 1 else Logic(at, "and", tuple(node for _, node in pairs)))
    return Expression(" or ".join(texts), Logic(at, "or", tuple(nodes)))


def _same(path: Path, value: Expression, station: Expression, at: Position) -> tuple[str, Node]:
    """Whether the field holds what `value` is for this station."""
    node: Node = Name(at, "it")
    for name in path:
        node = Attribute(at, node, name)
    text = re.sub(rf"\b{STATION}\b", lambda _: station.text, value.text)
    return f"it.{'.'.join(path)} == {text}", Compare(at, node, (("==", _put(value.root, station.root)),))


def _put(node: Any, station: Node) -> Any:
    """An expression with another one in the place of `station`."""
    if isinstance(node, Name) and node.name == STATION:
        return station
    if isinstance(node, tuple):
        return tuple(_put(item, station) for item in node)
    if isinstance(node, Node):
        return replace(node, **{field.name: _put(getattr(node, field.name), station) for field in fields(node)})
    return node
