"""Names that are no fields: the context a caller gives, start values of parameters and state, tables.

`Names` is what expressions of a frame fall back on behind the frame's own fields. It knows no frames and no bytes.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from framekit.codec.construct_backend.expressions import EVALUATION_ERRORS, MissingName, evaluate
from framekit.definition.expression.syntax import Expression, LineTime, walk
from framekit.definition.model.protocol import Protocol, StateVariable
from framekit.definition.model.values import Table

CONTEXT_KEY = "_context"
"""The context entry under which `ConstructCodec` hands a whole mapping to construct."""


class RangeTable(dict[Any, Any]):
    """A table with entries for ranges of numbers beside those for single keys."""

    def __init__(self, table: Table) -> None:
        super().__init__(table.entries)
        self.ranges = table.ranges

    def __missing__(self, key: Any) -> Any:
        for first, last, value in self.ranges:
            if isinstance(key, int) and first <= key <= last:
                return value
        raise KeyError(key)

    def __contains__(self, key: object) -> bool:
        try:
            self[key]
        except KeyError:
            return False
        return True

    def get(self, key: Any, default: Any = None) -> Any:
        try:
            return self[key]
        except KeyError:
            return default


class Names:
    """The lookup behind the fields: what the caller gave, then start values, then tables."""

    def __init__(self, given: Mapping[str, Any], known: Mapping[str, Any] | Names) -> None:
        self.given = given
        self.known = known

    def __getitem__(self, name: str) -> Any:
        """The value of `name`. Raises MissingName."""
        try:
            return self.given[name]
        except KeyError:
            pass
        try:
            return self.known[name]
        except KeyError:
            raise MissingName(name) from None

    def is_unset(self, name: str) -> bool:
        """Whether the context has the name, but no value for it yet."""
        try:
            return self[name] is None
        except MissingName:
            return False

    @classmethod
    def of_params(cls, params: Mapping[str, Any], known: Mapping[str, Any]) -> Names:
        """From the keyword arguments of `parse` and `build`, or from the mapping a codec put there."""
        return cls(params.get(CONTEXT_KEY, params), known)


def known_names(protocol: Protocol) -> dict[str, Any]:
    """Tables and the start values that are constant: what can be known without a caller."""
    known: dict[str, Any] = {name: RangeTable(table) for name, table in protocol.tables.items()}
    for parameter in protocol.params.values():
        if parameter.is_ is None:
            known |= _constant(parameter.name, parameter.default)
    for variable in protocol.state.values():
        if variable.keys is not None:
            known[variable.name] = {}
        elif variable.announced:
            known[variable.name] = None
        elif variable.initial is None:
            known |= _empty(variable)
        else:
            known |= _constant(variable.name, variable.initial)
    return known


def _constant(name: str, expression: Expression | None) -> dict[str, Any]:
    """`{name: value}` when the expression needs nothing but itself."""
    if expression is None or any(isinstance(node, LineTime) for node in walk(expression.root)):
        return {}
    try:
        return {name: evaluate(expression.root, Names({}, {}).__getitem__)}
    except (MissingName, *EVALUATION_ERRORS):
        return {}


def _empty(variable: StateVariable) -> dict[str, Any]:
    empty: dict[str, Any] = {"text": "", "bytes": b"", "list": [], "record": {}, "frame": None}
    return {variable.name: empty.get(variable.type, 0)}
