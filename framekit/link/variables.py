"""Types of variables: what a new one holds, and how a value fits into its width.

Used for state, for local variables of sequences and for tables. It knows no scopes, no sequences and no wire.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any

from framekit.codec.python.runtime import RangeTable
from framekit.definition.model.segments import Data, Field, Segment
from framekit.definition.model.values import Table

Fit = Callable[[Any], Any]
"""Makes a value fit its variable: numbers wrap at their width. Raises TypeError for a value of another kind."""

_INTEGER = re.compile(r"([ui])(8|16|24|32|40|48|56|64)")


def _unsigned(mask: int) -> Fit:
    def fit(value: Any) -> Any:
        return int(value) & mask if type(value) is not str else _refuse(value, "a number")

    return fit


def _signed(bits: int) -> Fit:
    half, mask = 1 << (bits - 1), (1 << bits) - 1

    def fit(value: Any) -> Any:
        return ((int(value) + half) & mask) - half if type(value) is not str else _refuse(value, "a number")

    return fit


def _flag(value: Any) -> Any:
    return 1 if value else 0


def _of_class(kind: type, words: str) -> Fit:
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


def _refuse(value: Any, wanted: str) -> Any:
    raise TypeError(f"{value!r} is not {wanted}")


_FITS: dict[str, Fit] = {
    "flag": _flag,
    "number": _of_class(int, "a number"),
    "time": _of_class(int, "a time"),
    "text": _of_class(str, "a text"),
    "choice": _of_class(str, "a text"),
    "bytes": _bytes,
    "list": _list,
}


def fit_of(type_: str, names: Mapping[int, str] | None = None, size: int | None = None) -> Fit:
    """How values fit a variable of this type; `names` of its numbers may be given instead of them.

    `size`: bytes of this length only.
    """
    if size is not None:
        return _sized(size)
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
    """What a variable of this type holds before anything is put into it; records and frames hold nothing."""
    if _INTEGER.fullmatch(type_) or type_ in ("flag", "number", "time"):
        return 0
    if type_ in ("text", "choice"):
        return ""
    if type_ == "bytes":
        return bytes(size or 0)
    return [] if type_ == "list" else None


def empty_record(segments: tuple[Segment, ...]) -> dict[str, Any]:
    """A record of a layout with nothing in it: numbers 0, texts and lists empty, bytes zero."""
    record: dict[str, Any] = {}
    for segment in segments:
        if isinstance(segment, Field):
            record[segment.name] = _empty_field(segment)
        elif isinstance(segment, Data):
            record[segment.name] = bytes(segment.size) if isinstance(segment.size, int) else b""
        elif segment.is_record:
            record.update(dict.fromkeys(segment.value_names, empty_record(segment.members)))
        elif segment.is_list:
            record.update((name, []) for name in segment.value_names)
        else:
            record.update((name, 0) for name, _ in segment.numbers_with_names())
            record.update(empty_record(segment.usual_block))
    return record


def _empty_field(segment: Field) -> Any:
    kind = segment.type.kind
    if kind == "ascii":
        return ""
    if kind == "bytes":
        return bytes(segment.type.fixed_size or 0)
    return 0.0 if kind == "float" else 0


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

    def get(self, key: Any, default: Any = None) -> Any:
        try:
            return self[key]
        except KeyError:
            return default

    def put(self, key: Any, value: Any) -> None:
        """Sets an entry. Raises ValueError for a key outside the table's range."""
        if not self._in_range(key):
            raise ValueError(f"{key!r} is not a key of a table {self.limits[0]}..{self.limits[1]}")
        dict.__setitem__(self, key, self.fit(value))


def table_values(table: Table) -> dict[Any, Any]:
    """A definition's table as expressions read it. A column that a row leaves out is there empty: 0, '' or no bytes."""
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
