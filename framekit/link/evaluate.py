"""Expressions for the engines: compiled once, evaluated on a `Names`.

A `Names` is one level of the lookup order of the language (fields, variables, what a service offers, state, parameters,
tables, built-in); what a level does not have, its parent has. The codecs take the same object as their context.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

from framekit.codec import support
from framekit.definition.expression.emit import emit
from framekit.definition.expression.syntax import Attribute, Expression, LineTime, Name
from framekit.link.values import attribute

Evaluate = Callable[["Names"], Any]
Formula = Callable[["Names"], Any]

ENGINE_FUNCTIONS = ("empty", "full", "memory", "with_date")


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


class _EngineNames:
    """How names are written for the engine: everything is looked up in the `Names` called `n`."""

    def name(self, node: Name) -> str:
        return f"n[{node.name!r}]"

    def attribute(self, node: Attribute) -> str:
        return f"attribute({emit(node.value, self)}, {node.name!r})"

    def line_time(self, node: LineTime) -> str:
        return f"n['line'].{node.unit}({node.count[0]}, {node.count[1]})"

    def call(self, function: str, arguments: list[str]) -> str:
        if function in ENGINE_FUNCTIONS:
            return f"n['functions'].{function}({', '.join(arguments)})"
        return f"support.{function}({', '.join(arguments)})"


_GLOBALS: dict[str, Any] = {
    "attribute": attribute,
    "support": support,
    "__builtins__": {
        "len": len,
        "min": min,
        "max": max,
        "abs": abs,
        "sum": sum,
        "str": str,
    },
}


@cache
def _compiled(source: str) -> Evaluate:
    code = compile(f"lambda n: {source}", "<expression>", "eval")
    function: Evaluate = eval(code, dict(_GLOBALS))
    return function


def compile_expression(expression: Expression) -> Evaluate:
    """A function of a `Names`. Evaluating raises KeyError (unknown name), TypeError, IndexError, ValueError or
    ArithmeticError; `EVALUATION_ERRORS` names them for callers that must go on."""
    return _compiled(emit(expression.root, _EngineNames()))


EVALUATION_ERRORS = (KeyError, TypeError, IndexError, ValueError, ArithmeticError, AttributeError)

CODEC_ERRORS = Exception
"""What a receiver takes for a frame that does not fit: whatever its functions raise, nothing ends the line."""
