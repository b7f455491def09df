"""Names of numbers, resolved all over a definition: each field's names narrowed to the frames that are meant.

`it` of a row means its frames, `request` and `reply` of a service row the frames it sends and takes. What resolving
one expression means is in `named`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import fields, is_dataclass, replace
from typing import Any, TypeVar

from framekit.definition.expression.syntax import Attribute, Compare, Expression, List, Name, Node, Number, Text
from framekit.definition.kinds.base import Segment
from framekit.definition.load.reader import Reader
from framekit.definition.model.frames import Frame
from framekit.definition.model.procedure import Row, Sequence
from framekit.definition.model.sections import StateVariable
from framekit.definition.model.services import ServiceRow
from framekit.definition.model.walk import flat
from framekit.definition.problems import did_you_mean

NumbersOf = Callable[[Node], "Mapping[str, int] | None"]
"""The numbers behind the names of what a node reads; None when it has no names."""


def resolve_names(reader: Reader, value: Any, numbers_of: NumbersOf) -> Any:
    """A model value with every expression in it resolved."""
    if isinstance(value, Expression):
        root = _resolved(reader, value.root, numbers_of)
        return value if root is value.root else Expression(value.text, root)
    if isinstance(value, tuple):
        items = tuple(resolve_names(reader, item, numbers_of) for item in value)
        return value if all(new is old for new, old in zip(items, value, strict=True)) else items
    if isinstance(value, dict):
        return {key: resolve_names(reader, item, numbers_of) for key, item in value.items()}
    if is_dataclass(value) and not isinstance(value, type):
        if isinstance(value, Segment) and value.chooses_by is not None:
            value = value.with_numbers(reader, _numbers(value.chooses_by.root, numbers_of))
        return _changed(value, lambda part: resolve_names(reader, part, numbers_of))
    return value


def _changed(value: Any, change: Callable[[Any], Any]) -> Any:
    changes = {}
    for field in fields(value):
        old = getattr(value, field.name)
        if isinstance(old, (tuple, dict)) or is_dataclass(old):
            new = change(old)
            if new is not old:
                changes[field.name] = new
    return replace(value, **changes) if changes else value


def _resolved(reader: Reader, node: Node, numbers_of: NumbersOf) -> Node:
    def inner(part: Any) -> Any:
        if isinstance(part, Node):
            return _resolved(reader, part, numbers_of)
        if isinstance(part, tuple):
            items = tuple(inner(item) for item in part)
            return part if all(new is old for new, old in zip(items, part, strict=True)) else items
        return part

    if isinstance(node, Compare):
        node = _compared(reader, node, numbers_of)
    changes = {}
    for field in fields(node):
        old = getattr(node, field.name)
        if isinstance(old, (Node, tuple)):
            new = inner(old)
            if new is not old:
                changes[field.name] = new
    return replace(node, **changes) if changes else node


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


def numbers_by_name(named: Iterable[tuple[str, Mapping[int, str] | None]]) -> dict[str, Mapping[str, int] | None]:
    """Field name → numbers by name; None for a name whose fields do not agree (one has no values, or others)."""
    result: dict[str, Mapping[str, int] | None] = {}
    for name, values in named:
        numbers = None if values is None else {text: number for number, text in values.items()}
        if name in result and result[name] != numbers:
            numbers = None
        result[name] = numbers
    return result


T = TypeVar("T")


class NumberNames:
    """Resolves the names of numbers, narrowed to the frames in question."""

    def __init__(self, reader: Reader, frames: Mapping[str, Frame], state: Mapping[str, StateVariable]) -> None:
        self.reader = reader
        self.by_frame = {name: _named_fields(frame.segments) for name, frame in frames.items()}
        everything = [item for fields in self.by_frame.values() for item in fields]
        everything += [(name, variable.values) for name, variable in state.items() if variable.values]
        self.everywhere = numbers_by_name(everything)

    def frame(self, frame: Frame) -> Frame:
        own = numbers_by_name(self.by_frame[frame.name])

        def numbers(node: Node) -> Mapping[str, int] | None:
            name = node.name if isinstance(node, (Name, Attribute)) else ""
            if isinstance(node, Name) and name in own:
                return own[name]
            return self.everywhere.get(name)

        resolved: Frame = resolve_names(self.reader, frame, numbers)
        return resolved

    def plainly(self, value: T) -> T:
        resolved: T = resolve_names(self.reader, value, self._anywhere)
        return resolved

    def _anywhere(self, node: Node) -> Mapping[str, int] | None:
        return self.everywhere.get(node.name) if isinstance(node, (Name, Attribute)) else None

    def sequence(self, sequence: Sequence) -> Sequence:
        """Rows first, with `it` narrowed to their frames; what is resolved there is a number already afterwards."""
        return self.plainly(_rows_changed(sequence, self._row))

    def _row(self, row: Row) -> Row:
        narrowed = numbers_by_name([item for name in row.frames for item in self.by_frame.get(name, ())])

        def numbers(node: Node) -> Mapping[str, int] | None:
            match node:
                case Attribute(value=Name(name="it"), name=name) if name in narrowed:
                    return narrowed[name]
            return self._anywhere(node)

        resolved: Row = resolve_names(self.reader, row, numbers)
        return resolved

    def service(self, row: ServiceRow) -> ServiceRow:
        """`request` and `reply` narrowed to the frames of the row."""
        sent = () if row.request is None else self.by_frame.get(row.request.frame, ())
        replies = [reply.frame.frame for reply in row.reply if reply.frame is not None]
        frames = {
            "request": numbers_by_name(sent),
            "reply": numbers_by_name([item for name in replies for item in self.by_frame.get(name, ())]),
        }

        def numbers(node: Node) -> Mapping[str, int] | None:
            match node:
                case Attribute(value=Name(name=("request" | "reply") as whose), name=name) if name in frames[whose]:
                    return frames[whose][name]
            return self._anywhere(node)

        resolved: ServiceRow = resolve_names(self.reader, row, numbers)
        return resolved


def _rows_changed(sequence: Sequence, change: Callable[[Row], Row]) -> Sequence:
    steps = tuple(
        step if step.receive is None else replace(step, receive=tuple(change(row) for row in step.receive))
        for step in sequence.steps
    )
    return replace(sequence, steps=steps, always=tuple(change(row) for row in sequence.always))


def _named_fields(segments: tuple[Segment, ...]) -> list[tuple[str, Mapping[int, str] | None]]:
    found: list[tuple[str, Mapping[int, str] | None]] = []
    for segment in flat(segments):
        found.extend(segment.numbers_with_names())
        found.extend(_named_fields(segment.inner_record or ()))
    return found
