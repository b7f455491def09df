"""Expressions for the engines: compiled once, evaluated on a `Names`; read backwards, to find the value of a name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from framekit.codec.evaluate import EVALUATION_ERRORS as EVALUATION_ERRORS
from framekit.codec.evaluate import compiled
from framekit.definition.expression import Expression, Name, Node, Undone, inverse_steps
from framekit.link.values import attribute

Evaluate = Callable[["Names"], Any]
Formula = Callable[["Names"], Any]


class Names(dict[str, Any]):
    """Values by name; a missing name is looked up in `formulas` (worked out at every use), then in `parent`."""

    __slots__ = ("formulas", "parent")

    def __init__(
        self,
        values: Mapping[str, Any] | None = None,
        parent: Names | None = None,
        formulas: Mapping[str, Formula] | None = None,
    ) -> None:
        super().__init__(values or {})
        self.parent = parent
        self.formulas = formulas

    def __missing__(self, name: str) -> Any:
        level: Names | None = self
        while level is not None:
            if name in level:
                return level[name]
            formulas = level.formulas
            if formulas is not None and name in formulas:
                return formulas[name](level)
            level = level.parent
        raise KeyError(name)

    @property
    def remembered(self) -> dict[Any, Any] | None:
        """What measuring has found out of a frame that is still coming; None where nothing tells when that ends."""
        return None if self.parent is None else self.parent.remembered

    def get(self, name: str, default: Any = None) -> Any:
        try:
            return self[name]
        except KeyError:
            return default


def compile_expression(expression: Expression) -> Evaluate:
    """A function of a `Names`. Evaluating raises KeyError (unknown name), TypeError, IndexError, ValueError or
    ArithmeticError; `EVALUATION_ERRORS` names them for callers that must go on."""
    return compiled(expression.root, attribute)


def compile_optional(expression: Expression | None) -> Evaluate | None:
    """The same for what may be missing."""
    return None if expression is None else compile_expression(expression)


CODEC_ERRORS = Exception
"""What a receiver takes for a frame that does not fit: whatever its functions raise, nothing ends the line."""


Undo = Callable[[int, int], int]


class NotReadableError(ValueError):
    """A result that no value of the name gives."""


@dataclass(frozen=True, slots=True)
class Inverse:
    """`name` stands alone in the expression; `steps` lead from the result back to it, outermost first.

    `undone` says the same as operators.
    """

    name: str
    steps: tuple[tuple[Undo, Evaluate], ...]
    undone: tuple[Undone, ...] = ()

    def solve(self, result: int, names: Names) -> int:
        """The value of the name. Raises NotReadableError, and EVALUATION_ERRORS for a column that is not there."""
        for undo, other in self.steps:
            result = undo(result, other(names))
        return result

    def source(self, result: str, written: Callable[[Expression], str]) -> str:
        """`solve` as source; `quotient` has to be known there."""
        for operator, unknown_left, other in self.undone:
            known = written(other)
            if operator == "*":
                result = f"quotient({result}, {known})"
            elif operator == "-" and not unknown_left:
                result = f"(({known}) - {result})"
            else:
                result = f"({result} {'-' if operator == '+' else '+'} ({known}))"
        return result


def inverse_of(expression: Expression) -> Inverse | None:
    """How to read an expression backwards; None if it cannot be, or has no name to read."""
    found = inverse_steps(expression)
    if found is None:
        return None
    name, undone = found
    steps = tuple((_undo(operator, left), compile_expression(other)) for operator, left, other in undone)
    return Inverse(name, steps, undone)


def bare_name(expression: Expression) -> str | None:
    """The word, if that is all there is."""
    node: Node = expression.root
    return node.name if isinstance(node, Name) else None


def _undo(operator: str, unknown_left: bool) -> Undo:
    if operator == "*":
        return quotient
    if operator == "+":
        return lambda result, other: result - other
    return (lambda result, other: result + other) if unknown_left else (lambda result, other: other - result)


def quotient(result: int, other: int) -> int:
    """What gives `result` when it is multiplied. Raises NotReadableError."""
    if other == 0 or result % other:
        raise NotReadableError(f"{result} is no multiple of {other}")
    return result // other
