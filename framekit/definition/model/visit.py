"""Walking over a model: every expression, and every value of a class, that a part of it holds."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from functools import cache
from typing import Any, TypeVar

from framekit.definition.expression.syntax import Expression
from framekit.definition.problems import Position

T = TypeVar("T")


def parts_of(value: Any, kind: type[T]) -> Iterator[T]:
    """Everything of class `kind` inside `value` (itself included), outermost first; expressions are not entered."""
    if isinstance(value, kind):
        yield value
    if isinstance(value, (Expression, Position)):
        return
    if isinstance(value, dict):
        for item in value.values():
            yield from parts_of(item, kind)
    elif isinstance(value, (tuple, list)):
        for item in value:
            yield from parts_of(item, kind)
    else:
        for name in _names_of(value.__class__):
            yield from parts_of(getattr(value, name), kind)


@cache
def _names_of(kind: type) -> tuple[str, ...]:
    """The fields of a class that may hold parts."""
    return tuple(field.name for field in fields(kind)) if is_dataclass(kind) else ()


def expressions_of(value: Any) -> Iterator[Expression]:
    """Every expression inside `value`."""
    return parts_of(value, Expression)
