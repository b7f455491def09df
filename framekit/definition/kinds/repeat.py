"""`repeat`, and layouts included `as` a name: lists and records."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import ClassVar, Self

from framekit.definition.expression import Expression, both
from framekit.definition.keys import IDENTIFIER, Form, KeyReading, ValueKind, here, key, keys, ref
from framekit.definition.kinds.base import (
    Contents,
    Given,
    Segment,
    SegmentLoading,
    Segments,
    contents_of,
    fixed_size,
    lack_default,
    sizes_of,
)
from framekit.definition.problems import Problem
from framekit.definition.tree import Mapping, Sequence
from framekit.definition.wire_types import SIZE, FieldType, Size, Sizes, load_type


def _items(reading: KeyReading) -> Segments | FieldType:
    node = reading.keys.get("of")
    if isinstance(node, Sequence):
        found: Segments = reading.loader.load(node)
        return found
    return load_type(reading.space, reading.keys, node)


_ITEMS = {
    "of": {
        "description": "The segments of an item, or the type of plain numbers.",
        "type": ["array", "string"],
        "items": here("segment"),
        "if": {"type": "string"},
        "then": ref("type_name"),
    },
    "size": {**here("size"), "description": "Number of bytes or digits of a plain number."},
    "order": here("number_order"),
    "case": here("digit_case"),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Repeat(Segment):
    """A list: of records when `of` is segments, of plain values when it is a type."""

    KEY: ClassVar[str] = "repeat"

    name: str = key("repeat", IDENTIFIER, "Name of the list.")
    times: Size = key("times", SIZE, "Number of items; an expression; or rest, as many as fit.")
    of: Segments | FieldType = keys(_ITEMS, _items)

    @classmethod
    def called(cls) -> str:
        return "list"

    @property
    def value_names(self) -> tuple[str, ...]:
        return (self.name,)

    @property
    def inner_record(self) -> Segments | None:
        return None if isinstance(self.of, FieldType) else self.of

    @property
    def is_list(self) -> bool:
        return True

    def with_record(self, change: Callable[[Segments], Segments]) -> Self:
        return self if isinstance(self.of, FieldType) else replace(self, of=change(self.of))

    def sizes(self, of_frame: Callable[[str], Sizes]) -> Sizes:
        item = self.of.sizes if isinstance(self.of, FieldType) else sizes_of(self.of, of_frame)
        return item.times(self.times, self.times) if isinstance(self.times, int) else item.times(0, None)

    def contents(self, of_frame: Contents) -> frozenset[int]:
        return self.of.contents if isinstance(self.of, FieldType) else contents_of(self.of, of_frame)

    @property
    def takes_rest(self) -> bool:
        return self.times == "rest"

    @property
    def size_expression(self) -> Expression | None:
        size = self.of.size if isinstance(self.of, FieldType) else None
        return size if isinstance(size, Expression) else None

    def value_kinds(self) -> Iterator[tuple[str, ValueKind]]:
        yield self.name, "list"

    @property
    def wanted_names(self) -> tuple[str, ...]:
        return (self.name,)

    def needed(self) -> Iterator[tuple[str, Expression]]:
        yield from Segment.needed(self)
        if isinstance(self.times, Expression):
            yield "number of items", self.times

    def given(self) -> Iterator[Given]:
        yield from Segment.given(self)
        yield self.times if isinstance(self.times, Expression) else None, "number", None

    def check(self) -> Iterator[Problem]:
        if isinstance(self.of, FieldType):
            return
        if not self.of:
            yield Problem(self.at, f"an item of '{self.name}' is empty", "add segments to of")
        elif all(fixed_size(segment) == 0 for segment in self.of):
            yield Problem(self.at, f"an item of '{self.name}' takes no bytes", "add a segment that takes some")
        elif self.times == "rest" and all(_may_be_nothing(segment) for segment in self.of):
            what = f"an item of '{self.name}' may take no bytes, so nothing shows how many there are"
            yield Problem(self.at, what, "add a segment that always takes some, or a count")


def _may_be_nothing(segment: Segment) -> bool:
    """Whether a segment is there only under a condition, or in one of several cases."""
    in_cases = bool(segment.blocks) and not segment.is_there_inside
    return segment.when is not None or not segment.takes_bytes or in_cases


@dataclass(frozen=True, slots=True, kw_only=True)
class Record(Segment):
    """A layout included `as` a name: its fields make one value, a mapping."""

    name: str
    of: Segments

    @property
    def value_names(self) -> tuple[str, ...]:
        return (self.name,)

    @property
    def inner_record(self) -> Segments | None:
        return self.of

    def value_kinds(self) -> Iterator[tuple[str, ValueKind]]:
        yield self.name, "record"

    @property
    def wanted_names(self) -> tuple[str, ...]:
        return (self.name,) if lack_default(self.of) else ()

    @property
    def may_be_given(self) -> bool:
        return True

    def with_record(self, change: Callable[[Segments], Segments]) -> Self:
        return replace(self, of=change(self.of))

    def sizes(self, of_frame: Callable[[str], Sizes]) -> Sizes:
        return sizes_of(self.of, of_frame)


INCLUDED = Form(ref("label"), lambda r, node: r.loader.layout(node))


@dataclass(frozen=True, slots=True, kw_only=True)
class IncludeKeys(Segment):
    """The keys of `include`: a record where it has a name `as`, else the segments of the layout themselves."""

    KEY: ClassVar[str] = "include"

    of: Segments = key("include", INCLUDED, "The layout whose segments stand here; FILE.layout for one of a used file.")
    record: str | None = key("as", IDENTIFIER, "Makes its values one record of this name.", default=None)

    @classmethod
    def load(cls, loader: SegmentLoading, keys: Mapping) -> Segments:
        found = cls.attributes(loader, keys)
        reader = loader.space.reader
        when = reader.maybe(reader.expression, keys.get("when"))
        refuse = reader.maybe(reader.number, keys.get("refuse"))
        segments: Segments = found["of"]
        if found["record"] is not None:
            return (Record(at=keys.at, name=found["record"], of=segments, when=when, refuse=refuse),)
        if (name := keys.get("name")) is not None:
            loader.aliases[reader.text(name)] = tuple(part.name for part in segments if part.name)
        return tuple(_under(part, when, refuse) for part in segments)


def _under(segment: Segment, when: Expression | None, refuse: int | None) -> Segment:
    """An included segment with the `when` and `refuse` of its include."""
    if when is not None:
        segment = replace(segment, when=both(when, segment.when))
    if refuse is not None and segment.refuse is None:
        segment = replace(segment, refuse=refuse)
    return segment
