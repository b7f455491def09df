"""Formulas of parameters: whether they are constant, how long a result holds, and which depend on which.

It looks at expressions only; values are not known here.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

from framekit.definition.expression.syntax import Call, Expression, LineTime, names_in, walk
from framekit.definition.model.protocol import Parameter

CHANGING = frozenset({"memory", "empty", "full", "with_date"})
"""Functions whose result may be another one at any time."""


def depending(formulas: Mapping[str, Expression], names: Collection[str]) -> set[str]:
    """The formulas in which these names stand, or others that depend on them."""
    found: set[str] = set()
    while fresh := {
        name
        for name, expression in formulas.items()
        if name not in found and names_in(expression.root) & {*names, *found}
    }:
        found |= fresh
    return found


def lasting(formulas: Mapping[str, Parameter], given: Mapping[str, Any]) -> frozenset[str]:
    """Parameters whose formulas depend only on parameters, state, tables and the line, so that results can be kept."""

    def passing(name: str) -> bool:
        expression = formulas[name].is_ or formulas[name].default
        if name in given or expression is None:
            return True
        calls = {node.function for node in walk(expression.root) if isinstance(node, Call)}
        return not calls & CHANGING and not names_in(expression.root) & changing

    changing = {"now", "clock", "station", "request", "buffer"}
    while fresh := {name for name in formulas if name not in changing and not passing(name)}:
        changing |= fresh
    return frozenset(formulas) - changing


def is_constant(expression: Expression) -> bool:
    """Whether an expression reads nothing at all, so that it can be worked out once."""
    return not names_in(expression.root) and not any(
        isinstance(node, LineTime) or (isinstance(node, Call) and node.function in CHANGING)
        for node in walk(expression.root)
    )
