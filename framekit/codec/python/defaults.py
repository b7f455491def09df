"""What a module knows of the context by itself: start values of parameters and state that are constants."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from framekit.codec.python.expressions import ExpressionWriter, Scope, is_flag
from framekit.codec.support import times
from framekit.definition.expression.syntax import Attribute, Call, Expression, Index, LineTime, Name, walk
from framekit.definition.model.protocol import Protocol, StateVariable

_EMPTY: dict[str, Any] = {"text": "", "bytes": b"", "list": [], "record": {}}


def default_values(protocol: Protocol, names: Iterable[str]) -> dict[str, Any]:
    """Start values of the named parameters and variables, as far as they are constants."""
    found: dict[str, Any] = {}
    for name in sorted(names):
        parameter, variable = protocol.params.get(name), protocol.state.get(name)
        if parameter is not None and parameter.is_ is None and is_constant(parameter.default):
            found[name] = _value(parameter.default)
        elif variable is not None:
            if variable.announced:
                found[name] = None
            elif variable.initial is None:
                found[name] = _start_of(variable)
            elif is_constant(variable.initial):
                found[name] = _value(variable.initial)
    return found


def _start_of(variable: StateVariable) -> Any:
    if variable.keys is not None:
        return {}
    return _EMPTY.get(variable.type, 0)


def is_constant(expression: Expression | None) -> bool:
    """Whether an expression is worked out from nothing but itself."""
    if expression is None:
        return False
    return not any(isinstance(node, (Name, Attribute, Index, LineTime, Call)) for node in walk(expression.root))


def _value(expression: Expression | None) -> Any:
    assert expression is not None
    text = ExpressionWriter(_Nothing(), Scope(), str).text(expression)
    value = eval(text, {"__builtins__": {}, "times": times})
    return int(value) if is_flag(expression.root) else value


class _Nothing:
    """No tables, and no functions but what operators stand for."""

    def table(self, name: str) -> str | None:
        return None

    def function(self, name: str) -> str:
        return name
