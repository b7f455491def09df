"""Walking over a model: every segment of a list in order, what their values are called, every expression in a part.

The segments say themselves what they hold (`blocks`, `inner_record`, `value_names`), whatever their kind.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import fields, is_dataclass, replace
from functools import cache
from typing import Any, TypeVar

from framekit.definition.expression import Expression
from framekit.definition.kinds.base import Segment, Segments
from framekit.definition.problems import Position

T = TypeVar("T")


# ---- segments -----------------------------------------------------------------------------------------------


def flat(segments: Iterable[Segment]) -> Iterator[Segment]:
    """Segments whose values belong to one record: also those in wraps, choices and optional parts."""
    for segment in segments:
        yield segment
        for block in segment.blocks:
            yield from flat(block)


def everything(segments: Iterable[Segment]) -> Iterator[Segment]:
    """Every segment, also those in records and lists; these come after the segments of the record around them."""
    for segment in flat(segments):
        yield segment
        yield from everything(segment.inner_record or ())


def leaves(segments: Iterable[Segment]) -> Iterator[Segment]:
    """The segments that stand for bytes themselves, in order: what is in wraps, choices and records, not those."""
    for segment in segments:
        inside = segment.blocks if segment.is_list or segment.inner_record is None else (segment.inner_record,)
        for block in inside:
            yield from leaves(block)
        if not inside and segment.takes_bytes:
            yield segment


def certain(segments: Iterable[Segment], there: bool = True) -> Iterator[tuple[Segment, bool]]:
    """Every segment of one record, and whether it is there in every such record but for its own condition."""
    for segment in segments:
        yield segment, there
        for block in segment.blocks:
            yield from certain(block, there and segment.is_there_inside and segment.when is None)


def by_value_name(segments: Iterable[Segment]) -> dict[str, Segment]:
    """The segments of one record that hold values, by the name of the value."""
    return {name: segment for segment in flat(segments) for name in segment.value_names}


def change_all(segments: Segments, change: Callable[[Segment], Segment]) -> Segments:
    """Every segment of one record changed, those that hold others before what they hold."""

    def all_changed(block: Segments) -> Segments:
        return tuple(change(segment).with_blocks(all_changed) for segment in block)

    return all_changed(segments)


def without_when(segment: Segment) -> Segment:
    return replace(segment, when=None)


# ---- names of values ----------------------------------------------------------------------------------------


def field_names(segments: Iterable[Segment]) -> set[str]:
    """The names that values of these segments have."""
    return {name for segment in flat(segments) for name in _own_names(segment)}


def names_needed(segments: Iterable[Segment]) -> list[str]:
    """Those without which no frame can be built: nothing else gives them a value."""
    found: list[str] = []
    for segment, there in certain(segments):
        if segment.when is not None or not there:
            continue
        found += segment.wanted_names
    return found


def names_always_there(segments: Iterable[Segment]) -> set[str]:
    """Those that every value has, whatever it holds."""
    found: set[str] = set()
    for segment, there in certain(segments):
        if there and segment.when is None and not segment.is_there_inside:
            found |= _own_names(segment)
    return found


def _own_names(segment: Segment) -> set[str]:
    if segment.value_names:
        return {name for name in segment.value_names if not name.startswith("_")}
    return {segment.name} if segment.name is not None and not segment.name.startswith("_") else set()


# ---- parts of any kind --------------------------------------------------------------------------------------


def parts_of(value: Any, kind: type[T]) -> Iterator[T]:
    """Everything of class `kind` inside `value` (itself included), outermost first; expressions are not entered."""
    left = [value]
    while left:
        value = left.pop()
        if isinstance(value, kind):
            yield value
        names = _names_of(value.__class__)
        if names:
            left += [getattr(value, name) for name in names]
        elif isinstance(value, dict):
            left += reversed(value.values())
        elif isinstance(value, (tuple, list)):
            left += reversed(value)


_NO_PARTS = frozenset({"str", "int", "bool", "bytes", "float", "None", "Position", "tuple", "frozenset"})


@cache
def _names_of(kind: type) -> tuple[str, ...]:
    """The fields of a class that may hold parts, the last one first: not those that say to be a number or a text."""
    if not is_dataclass(kind) or issubclass(kind, (Expression, Position)):
        return ()
    kinds = [(field.name, set(re.findall(r"\w+", str(field.type)))) for field in reversed(fields(kind))]
    return tuple(name for name, words in kinds if not words <= _NO_PARTS)


def expressions_of(value: Any) -> Iterator[Expression]:
    """Every expression inside `value`."""
    return parts_of(value, Expression)
