"""Given values of parameters: checked against type, range and choices, and taken as text or as values.

It knows nothing of where a value comes from, nor of the formulas that stand in for those not given.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import Any

from framekit.definition.expression import ENGINE_FUNCTIONS, Call, Expression, names_in, parse_expression, walk
from framekit.definition.load.reader import parse_bytes, parse_constant, parse_flag, parse_number
from framekit.definition.model.sections import Parameter
from framekit.definition.problems import NOWHERE, plural
from framekit.definition.times import NEVER, format_time, parse_time


class ParameterError(ValueError):
    """A value that a parameter does not take; `name` is the parameter."""

    def __init__(self, name: str, what: str) -> None:
        self.name, self.what = name, what
        super().__init__(f"parameter '{name}': {what}")


def given_value(parameter: Parameter, value: Any) -> Any:
    """The checked value; an Expression for a time written with `chars` or `bits`. Raises ParameterError.

    Times are nanoseconds or text with a unit, flags 0 or 1, bytes are bytes or hex pairs.
    """
    if parameter.is_ is not None:
        raise ParameterError(parameter.name, f"it is always {parameter.is_} and cannot be set")
    try:
        taken = _TAKE[parameter.type](value)
    except ValueError as error:
        raise ParameterError(parameter.name, str(error)) from None
    if parameter.type == "list":
        return [_numbered(parameter, item, place) for place, item in enumerate(taken, start=1)]
    if not isinstance(taken, Expression):
        check_value(parameter, taken)
    return taken


def given_item(parameter: Parameter, item: Any) -> Any:
    """The checked value of one item of a list. Raises ParameterError."""
    try:
        taken = _take_item(item) if parameter.items is None else _TAKE[parameter.items](item)
    except ValueError as error:
        raise ParameterError(parameter.name, str(error)) from None
    if isinstance(taken, Expression):
        raise ParameterError(parameter.name, f"'{item}' depends on the line – write a time such as 50 ms")
    check_value(parameter, taken)
    return taken


def _numbered(parameter: Parameter, item: Any, place: int) -> Any:
    try:
        return given_item(parameter, item)
    except ParameterError as error:
        raise ParameterError(parameter.name, f"item {place}: {error.what}") from None


def check_value(parameter: Parameter, value: Any) -> None:
    """Raises ParameterError for a value out of range, of a wrong size, or not among the choices; items of lists too."""
    if isinstance(value, list):
        for item in value:
            check_value(parameter, item)
        return
    if parameter.type == "choice" and parameter.choices and value not in parameter.choices:
        raise ParameterError(parameter.name, f"'{value}' is none of {', '.join(parameter.choices)}")
    if parameter.size is not None and isinstance(value, bytes) and len(value) != parameter.size:
        raise ParameterError(parameter.name, f"{plural(len(value), 'byte')} are not {parameter.size}")
    if parameter.limits is None or not isinstance(value, int):
        return
    low, high = parameter.limits
    is_time = "time" in (parameter.type, parameter.items)
    if not low <= value <= high and not (is_time and value >= NEVER):
        show: Callable[[int], object] = format_time if is_time else int
        raise ParameterError(parameter.name, f"{show(value)} is not in {show(low)}..{show(high)}")


def _take_time(value: Any) -> Any:
    if isinstance(value, int) and not isinstance(value, bool):
        return value
    if not isinstance(value, str):
        raise ValueError(f"{value!r} is not a time – write a number and a unit, such as 50 ms")
    try:
        return parse_time(value)
    except ValueError as error:
        if "char" in value or "bit" in value:
            return parse_expression(value, NOWHERE)
        raise error


def _take_number(value: Any) -> int:
    if isinstance(value, str):
        return parse_number(value)
    if not isinstance(value, int):
        raise ValueError(f"{value!r} is not a whole number")
    return int(value)


def _take_flag(value: Any) -> int:
    if isinstance(value, str):
        return parse_flag(value)
    if value in (0, 1):
        return int(value)
    raise ValueError(f"{value!r} is neither yes nor no")


def _take_text(value: Any) -> str:
    if not isinstance(value, str):
        raise ValueError(f"{value!r} is not a text")
    return value


def _take_bytes(value: Any) -> bytes:
    if isinstance(value, str):
        return parse_bytes(value) if value.strip() else b""
    if not isinstance(value, (bytes, bytearray)):
        raise ValueError(f"{value!r} is not bytes – write hex pairs")
    return bytes(value)


def _take_list(value: Any) -> list[Any]:
    if isinstance(value, str):
        value = [item.strip() for item in value.strip("[] ").split(",") if item.strip()]
    if not isinstance(value, (list, tuple)):
        raise ValueError(f"{value!r} is not a list")
    return list(value)


def _take_item(value: Any) -> Any:
    return parse_constant(value) if isinstance(value, str) else value


_TAKE: dict[str, Callable[[Any], Any]] = {
    "time": _take_time,
    "number": _take_number,
    "flag": _take_flag,
    "choice": _take_text,
    "text": _take_text,
    "bytes": _take_bytes,
    "list": _take_list,
}


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
        return not calls & ENGINE_FUNCTIONS and not names_in(expression.root) & changing

    changing = {"now", "clock", "station", "request", "buffer"}
    while fresh := {name for name in formulas if name not in changing and not passing(name)}:
        changing |= fresh
    return frozenset(formulas) - changing
