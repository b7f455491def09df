"""Variables and parameters: the content of a new variable, fitting of values to their width, checks of given values.

Used for state, for local variables of sequences, for tables and parameters. No scopes, sequences or wire are known
here, nor the origin of a given value, nor the formulas of values that are not given.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Collection, Mapping
from decimal import Decimal
from typing import Any, NoReturn

from framekit.codec.python.runtime import RangeTable
from framekit.codec.support import exact_decimal
from framekit.definition.expression import ENGINE_FUNCTIONS, Call, Expression, names_in, parse_expression, walk
from framekit.definition.load.reader import parse_bytes, parse_constant, parse_flag, parse_number
from framekit.definition.model.sections import Parameter
from framekit.definition.model.values import Table
from framekit.definition.problems import NOWHERE, plural
from framekit.definition.times import NEVER, format_time, parse_time

Fit = Callable[[Any], Any]
"""Makes a value fit its variable: numbers wrap at their width. Raise TypeError for a value of another kind."""

_FLOATS = {"f32": "<f", "f64": "<d"}
_INTEGER = re.compile(r"([ui])(8|16|24|32|40|48|56|64)")


def _unsigned(mask: int) -> Fit:
    def fit(value: Any) -> Any:
        return (value if type(value) is int else _whole(value)) & mask

    return fit


def _signed(bits: int) -> Fit:
    half, mask = 1 << (bits - 1), (1 << bits) - 1

    def fit(value: Any) -> Any:
        return (((value if type(value) is int else _whole(value)) + half) & mask) - half

    return fit


def _whole(value: Any) -> int:
    """Return a whole number. Raise TypeError for a text or a missing value, ValueError for a fraction."""
    if not isinstance(value, (int, float, Decimal)):
        return _refuse(value, "a number")
    try:
        number = int(value)
    except OverflowError:
        raise ValueError(f"{value} is not a whole number") from None
    if number != value:
        raise ValueError(f"{value} is not a whole number")
    return number


def _float(type_: str) -> Fit:
    """Return the fit to the nearest number with this many bits. Raise ValueError for a number that is too large."""
    form = _FLOATS[type_]

    def fit(value: Any) -> Any:
        if not isinstance(value, (int, float, Decimal)):
            _refuse(value, "a number")
        try:
            return struct.unpack(form, struct.pack(form, value))[0]
        except (OverflowError, struct.error):
            raise ValueError(f"{value} does not fit into an {type_}") from None

    return fit


def _flag(value: Any) -> Any:
    return 1 if value else 0


def _of_class(kind: type | tuple[type, ...], words: str) -> Fit:
    def fit(value: Any) -> Any:
        return value if isinstance(value, kind) else _refuse(value, words)

    return fit


def _bytes(value: Any) -> Any:
    return bytes(value) if isinstance(value, (bytes, bytearray)) else _refuse(value, "bytes")


def _sized(size: int) -> Fit:
    def fit(value: Any) -> Any:
        found = _bytes(value)
        return found if len(found) == size else _refuse(value, f"{size} bytes")

    return fit


def _list(value: Any) -> Any:
    return list(value) if isinstance(value, (list, tuple)) else _refuse(value, "a list")


def _anything(value: Any) -> Any:
    return value


def _refuse(value: Any, wanted: str) -> NoReturn:
    raise TypeError(f"{value!r} is not {wanted}")


_FITS: dict[str, Fit] = {
    "flag": _flag,
    "number": _of_class(int, "a number"),
    "decimal": _of_class((int, float, Decimal), "a number"),
    "time": _of_class(int, "a time"),
    "text": _of_class(str, "a text"),
    "choice": _of_class(str, "a text"),
    "bytes": _bytes,
    "list": _list,
}


def fit_of(type_: str, names: Mapping[int, str] | None = None, size: int | None = None) -> Fit:
    """Return the fit of a variable of this type; `names` of its numbers are accepted, too.

    `size`: bytes of this length only.
    """
    if size is not None:
        return _sized(size)
    if type_ in _FLOATS:
        return _float(type_)
    match = _INTEGER.fullmatch(type_)
    if match is None:
        return _FITS.get(type_, _anything)
    bits = int(match[2])
    fit = _unsigned((1 << bits) - 1) if match[1] == "u" else _signed(bits)
    if not names:
        return fit
    numbers = {name: number for number, name in names.items()}
    return lambda value: fit(numbers.get(value, value) if isinstance(value, str) else value)


def empty_of(type_: str, size: int | None = None) -> Any:
    """Return the content of a new variable of this type; None for records and frames."""
    if type_ in _FLOATS:
        return 0.0
    if _INTEGER.fullmatch(type_) or type_ in ("flag", "number", "decimal", "time"):
        return 0
    if type_ in ("text", "choice"):
        return ""
    if type_ == "bytes":
        return bytes(size or 0)
    return [] if type_ == "list" else None


class StateTable(dict[Any, Any]):
    """A table variable: an entry a key of its range. With an initial value every key has an entry from the start."""

    __slots__ = ("fit", "initial", "limits")

    def __init__(self, limits: tuple[int, int], fit: Fit, initial: Callable[[], Any] | None) -> None:
        super().__init__()
        self.limits = limits
        self.fit = fit
        self.initial = initial

    def _in_range(self, key: object) -> bool:
        return isinstance(key, int) and self.limits[0] <= key <= self.limits[1]

    def __missing__(self, key: Any) -> Any:
        if self.initial is None or not self._in_range(key):
            raise KeyError(key)
        return self.initial()

    def __contains__(self, key: object) -> bool:
        return dict.__contains__(self, key) or (self.initial is not None and self._in_range(key))

    def items(self) -> Any:
        """Return all entries; with an initial value, one for each key of the range."""
        if self.initial is None:
            return super().items()
        return [(key, self[key]) for key in range(self.limits[0], self.limits[1] + 1)]

    def get(self, key: Any, default: Any = None) -> Any:
        try:
            return self[key]
        except KeyError:
            return default

    def put(self, key: Any, value: Any) -> None:
        """Set an entry. Raise ValueError for a key outside the table's range."""
        if not self._in_range(key):
            raise ValueError(f"{key!r} is not a key of a table {self.limits[0]}..{self.limits[1]}")
        dict.__setitem__(self, key, self.fit(value))


def table_values(table: Table) -> dict[Any, Any]:
    """Return a table of a definition for expressions. A column that a row leaves out is empty: 0, '' or no bytes."""
    columns: dict[str, Any] = {}
    for value in (*table.entries.values(), *(value for _, _, value in table.ranges)):
        if isinstance(value, Mapping):
            for name, constant in value.items():
                columns.setdefault(name, type(constant)())
    entries = {key: _filled(value, columns) for key, value in table.entries.items()}
    if not table.ranges:
        return entries
    return RangeTable(entries, tuple((low, high, _filled(value, columns)) for low, high, value in table.ranges))


def _filled(value: Any, columns: Mapping[str, Any]) -> Any:
    return {**columns, **value} if isinstance(value, Mapping) else value


def same_number(found: Any, wanted: Any) -> bool:
    """Return whether two values are the same; a float of 32 or 64 bits is the number that it is nearest to."""
    if isinstance(found, float) and isinstance(wanted, Decimal):
        return any(found == fit_of(type_)(wanted) for type_ in ("f32", "f64"))
    return bool(found == wanted)


# ---- given values of parameters -----------------------------------------------------------------------------


class ParameterError(ValueError):
    """A value that a parameter does not take; `name` is the parameter."""

    def __init__(self, name: str, what: str) -> None:
        self.name, self.what = name, what
        super().__init__(f"parameter '{name}': {what}")


def given_value(parameter: Parameter, value: Any) -> Any:
    """Return the checked value; an Expression for a time written with `chars` or `bits`. Raise ParameterError.

    Times are nanoseconds or text with a unit, flags 0 or 1, bytes are bytes or hex pairs.
    """
    if parameter.is_ is not None:
        raise ParameterError(parameter.name, f"it is always {parameter.is_} and cannot be set")
    try:
        taken = _TAKE[parameter.type](value)
    except ValueError as error:
        fault = f"what is given is no {parameter.type}" if parameter.secret else str(error)
        raise ParameterError(parameter.name, fault) from None
    if parameter.type == "list":
        return [_numbered(parameter, item, place) for place, item in enumerate(taken, start=1)]
    if not isinstance(taken, Expression):
        check_value(parameter, taken)
    return taken


def given_item(parameter: Parameter, item: Any) -> Any:
    """Return the checked value of one item of a list. Raise ParameterError."""
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
    """Raise ParameterError for a value out of range, of a wrong size, or not among the choices; items of lists too."""
    if isinstance(value, list):
        for item in value:
            check_value(parameter, item)
        return
    if parameter.type == "choice" and parameter.choices and value not in parameter.choices:
        raise ParameterError(parameter.name, f"'{value}' is none of {', '.join(parameter.choices)}")
    if parameter.size is not None and isinstance(value, bytes) and len(value) != parameter.size:
        raise ParameterError(parameter.name, f"{plural(len(value), 'byte')} are not {parameter.size}")
    if parameter.limits is None or not isinstance(value, (int, Decimal)):
        return
    low, high = parameter.limits
    is_time = "time" in (parameter.type, parameter.items)
    if not low <= value <= high and not (is_time and value >= NEVER):
        show: Callable[[Any], object] = format_time if is_time else str
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


def _take_decimal(value: Any) -> int | Decimal:
    """Return a number that may have a fraction, exactly; whole numbers remain whole."""
    if isinstance(value, int):
        return int(value)
    try:
        return exact_decimal(Decimal(value.strip()) if isinstance(value, str) else value)
    except ArithmeticError:
        raise ValueError(f"'{value}' is not a number") from None


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
    "decimal": _take_decimal,
    "flag": _take_flag,
    "choice": _take_text,
    "text": _take_text,
    "bytes": _take_bytes,
    "list": _take_list,
}


def depending(formulas: Mapping[str, Expression], names: Collection[str]) -> set[str]:
    """Return the formulas in which these names stand, or others that depend on them."""
    found: set[str] = set()
    while fresh := {
        name
        for name, expression in formulas.items()
        if name not in found and names_in(expression.root) & {*names, *found}
    }:
        found |= fresh
    return found


def lasting(formulas: Mapping[str, Parameter], given: Mapping[str, Any]) -> frozenset[str]:
    """Return the parameters whose results can be cached.

    Their formulas depend only on parameters, state, tables and the line.
    """

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
