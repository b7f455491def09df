"""Expressions for the engines: compiled once, evaluated on a `Names`; read backwards, to find the value of a name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from framekit.codec.evaluate import ENGINE_FUNCTIONS as ENGINE_FUNCTIONS
from framekit.codec.evaluate import EVALUATION_ERRORS as EVALUATION_ERRORS
from framekit.codec.evaluate import compiled
from framekit.definition.expression import Binary, Expression, LineTime, Name, Node, names_in, walk
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

    def get(self, name: str, default: Any = None) -> Any:
        try:
            return self[name]
        except KeyError:
            return default


def compile_expression(expression: Expression) -> Evaluate:
    """A function of a `Names`. Evaluating raises KeyError (unknown name), TypeError, IndexError, ValueError or
    ArithmeticError; `EVALUATION_ERRORS` names them for callers that must go on."""
    return compiled(expression.root, attribute)


CODEC_ERRORS = Exception
"""What a receiver takes for a frame that does not fit: whatever its functions raise, nothing ends the line."""


KNOWN = frozenset({"area"})
"""Names that have a value before anything is read backwards: the area's columns are constants."""

Undo = Callable[[int, int], int]


class NotReadableError(ValueError):
    """A result that no value of the name gives."""


@dataclass(frozen=True, slots=True)
class Inverse:
    """`name` stands alone in the expression; `steps` lead from the result back to it, outermost first.

    `undone` says the same as operators: what is undone, whether the name stood left of it, and the other side.
    """

    name: str
    steps: tuple[tuple[Undo, Evaluate], ...]
    undone: tuple[tuple[str, bool, Expression], ...] = ()

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


def is_constant(expression: Expression) -> bool:
    """Whether an expression reads no names and no line."""
    return not names_in(expression.root) and not any(isinstance(node, LineTime) for node in walk(expression.root))


def inverse_of(expression: Expression) -> Inverse | None:
    """How to read an expression backwards; None if it cannot be, or has no name to read."""
    steps: list[tuple[Undo, Evaluate]] = []
    undone: list[tuple[str, bool, Expression]] = []
    node = expression.root
    while not isinstance(node, Name):
        if not isinstance(node, Binary):
            return None
        left, right = names_in(node.left) - KNOWN, names_in(node.right) - KNOWN
        if bool(left) == bool(right):
            return None
        operator = node.operator
        undo = _undo(operator, unknown_left=bool(left))
        if undo is None:
            return None
        known, node = (node.right, node.left) if left else (node.left, node.right)
        other = Expression(expression.text, known)
        steps.append((undo, compile_expression(other)))
        undone.append((operator, bool(left), other))
    return None if node.name in KNOWN else Inverse(node.name, tuple(steps), tuple(undone))


def bare_name(expression: Expression) -> str | None:
    """The word, if that is all there is."""
    node: Node = expression.root
    return node.name if isinstance(node, Name) else None


def _undo(operator: str, *, unknown_left: bool) -> Undo | None:
    if operator == "+":
        return lambda result, other: result - other
    if operator == "-":
        return (lambda result, other: result + other) if unknown_left else (lambda result, other: other - result)
    return quotient if operator == "*" else None


def quotient(result: int, other: int) -> int:
    """What gives `result` when it is multiplied. Raises NotReadableError."""
    if other == 0 or result % other:
        raise NotReadableError(f"{result} is no multiple of {other}")
    return result // other
