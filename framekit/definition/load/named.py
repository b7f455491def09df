"""Names of numbers in expressions: `it.answer == 'ACK'` becomes a comparison with the number ACK stands for.

A text beside a field, bits or variable with `values` is replaced; a name that its values do not have is a problem,
found before anything runs. Which field is meant goes by its name, narrowed to the frames in question.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import fields, is_dataclass, replace
from typing import Any

from framekit.definition.expression.syntax import Attribute, Compare, Expression, List, Name, Node, Number, Text
from framekit.definition.load.reader import Reader
from framekit.definition.model.segments import Choose
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
        if isinstance(value, Choose):
            value = _cases(reader, value, numbers_of)
        return _changed(value, lambda part: resolve_names(reader, part, numbers_of))
    return value


def _cases(reader: Reader, choose: Choose, numbers_of: NumbersOf) -> Choose:
    """A choice by a field whose numbers have names: its cases may be written with these names."""
    numbers = _numbers(choose.on.root, numbers_of)
    if numbers is None:
        return choose

    def number(key: int | str) -> int | str:
        if isinstance(key, str) and key not in numbers:
            what = f"'{key}' is not a name of this field's values"
            reader.note(choose.at, what, did_you_mean(key, numbers))
        return numbers.get(key, key) if isinstance(key, str) else key

    return replace(choose, cases=tuple((tuple(map(number, keys)), segments) for keys, segments in choose.cases))


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
