"""Evaluate expressions of a definition directly, without generated code: for samples, start values and engines.

Each expression is emitted as Python once and looks its names up in `n`, a mapping or a `Lookup`. The possible errors
are `EVALUATION_ERRORS`; a name without a value may raise `MissingName`.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, lru_cache
from typing import Any, Protocol

from framekit.codec import ciphers, support
from framekit.codec.python.runtime import RangeTable, attribute
from framekit.definition.expression import ENGINE_FUNCTIONS, Attribute, Expression, LineTime, Name, Node, emit
from framekit.definition.model import protocol as model
from framekit.definition.model.sections import StateVariable

EVALUATION_ERRORS = (KeyError, TypeError, IndexError, ValueError, ArithmeticError, AttributeError)
"""The exceptions that an expression can raise for unsuitable values."""


class Lookup(Protocol):
    """Look up values by name."""

    def __getitem__(self, name: str, /) -> Any: ...


class MissingName(Exception):  # noqa: N818 - the caller turns it into an error for its purpose
    """Report a name that is neither a field nor in the context."""

    def __init__(self, name: str) -> None:
        self.name = name
        """The missing name."""
        super().__init__(f"the context has no '{name}'")


class LookedUp:
    """Emit every name as a look-up in the object whose source is `names`."""

    def __init__(self, names: str = "n") -> None:
        self.names = names

    def name(self, node: Name) -> str:
        return f"{self.names}[{node.name!r}]"

    def attribute(self, node: Attribute) -> str:
        return f"attribute({emit(node.value, self)}, {node.name!r})"

    def line_time(self, node: LineTime) -> str:
        return f"{self.names}['line'].{node.unit}({node.count[0]}, {node.count[1]})"

    def call(self, function: str, arguments: list[str]) -> str:
        owner = f"{self.names}['functions']" if function in ENGINE_FUNCTIONS else home_of(function)
        return f"{owner}.{function}({', '.join(arguments)})"


def home_of(function: str) -> str:
    """Return the key in HOMES of the module that defines a function."""
    return next(name for name, module in HOMES.items() if hasattr(module, function))


HOMES = {"support": support, "ciphers": ciphers}
"""The modules of the functions that an expression calls outside of generated modules."""
_BUILT_IN = {"len": len, "min": min, "max": max, "abs": abs, "sum": sum, "str": str}


@cache
def _compiled(source: str, attribute: Callable[[Any, str], Any]) -> Callable[[Any], Any]:
    code = compile(f"lambda n: {source}", "<expression>", "eval")
    function: Callable[[Any], Any] = eval(code, {"attribute": attribute, **HOMES, "__builtins__": _BUILT_IN})
    return function


@lru_cache(maxsize=8192)
def compiled(node: Node, attribute: Callable[[Any, str], Any]) -> Callable[[Any], Any]:
    """Return an expression as a function of a `Lookup`; `attribute` implements the dot. It raises EVALUATION_ERRORS.

    The functions are cached, because the engines of a protocol share their expressions.
    """
    return _compiled(emit(node, LookedUp()), attribute)


def evaluate(node: Node, names: Lookup) -> Any:
    """Return the value of `node`. Raises EVALUATION_ERRORS, and the exception of `names` for a name without a value."""
    return compiled(node, attribute)(names)


# ---- names that are no fields -------------------------------------------------------------------------------


def start_values(protocol: model.Protocol) -> dict[str, Any]:
    """Return the tables of a protocol, and the start values of its parameters and state that are constant."""
    known: dict[str, Any] = {name: RangeTable(table.entries, table.ranges) for name, table in protocol.tables.items()}
    for parameter in protocol.params.values():
        if parameter.secret and parameter.default is None:  # unknown until the user sets it
            known[parameter.name] = None
        if parameter.is_ is None:
            known |= _constant(parameter.name, parameter.default)
    for variable in protocol.state.values():
        if variable.keys is not None:
            known[variable.name] = {}
        elif variable.announced and variable.initial is None:
            known[variable.name] = None
        elif variable.given is not None:
            continue
        elif variable.initial is None:
            known |= _empty(variable)
        else:
            known |= _constant(variable.name, variable.initial)
    return known


def _constant(name: str, expression: Expression | None) -> dict[str, Any]:
    """Return `{name: value}` if the expression reads no names, else an empty mapping; flags are numbers."""
    try:
        value = None if expression is None else evaluate(expression.root, {})
    except EVALUATION_ERRORS:
        return {}
    return {} if expression is None else {name: int(value) if isinstance(value, bool) else value}


def _empty(variable: StateVariable) -> dict[str, Any]:
    if variable.type == "bytes":
        return {variable.name: bytes(variable.size or 0)}
    empty: dict[str, Any] = {"text": "", "list": [], "record": {}, "frame": None, "f32": 0.0, "f64": 0.0}
    return {variable.name: empty.get(variable.type, 0)}
