"""Values in a definition: expressions, constructors of frames and layouts, lists and records.

They occur in `send`, `put`, `with`, service rows and replies. Engines evaluate them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from framekit.definition.expression import Expression
from framekit.definition.problems import Position


@dataclass(frozen=True, slots=True)
class FrameOf:
    """`{frame: {field: value, …}}`: makes a frame value."""

    frame: str
    fields: Mapping[str, Value]
    at: Position


@dataclass(frozen=True, slots=True)
class LayoutOf:
    """`{layout: {field: value, …}}`: makes bytes of the layout."""

    layout: str
    fields: Mapping[str, Value]
    at: Position


@dataclass(frozen=True, slots=True)
class ReadAs:
    """`{layout: bytes}`: reads bytes as that layout."""

    layout: str
    source: Value
    at: Position


@dataclass(frozen=True, slots=True)
class ListOf:
    """`[value, …]`."""

    items: tuple[Value, ...]
    at: Position


@dataclass(frozen=True, slots=True)
class RecordOf:
    """`{name: value, …}` that is neither a frame nor a layout."""

    fields: Mapping[str, Value]
    at: Position


@dataclass(frozen=True, slots=True)
class EachOf:
    """`{each: {field: value}}`: one record for every variable of a list request; with `when`, for the matching
    variables.
    """

    fields: Mapping[str, Value]
    at: Position
    when: Expression | None = None


Value = Expression | FrameOf | LayoutOf | ReadAs | ListOf | RecordOf | EachOf

Constant = int | str | bytes
TableValue = Constant | Mapping[str, Constant] | tuple[Constant, ...]


@dataclass(frozen=True, slots=True)
class Table:
    """A named table; `ranges` are the keys written `1200-19200` as (first, last, value)."""

    name: str
    entries: Mapping[int | str, TableValue]
    ranges: tuple[tuple[int, int, TableValue], ...]
    at: Position
