"""`repeat`, and layouts included `as` a name: lists and records.

Expressions in an item can read its number, whether it is the last, and the previous item. The loader gives these three
values internal names, which no file can contain (`load/resolve.py`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import ClassVar, Self

from framekit.definition.expression import Compare, Expression, Name, Number, both, names_in
from framekit.definition.keys import (
    BYTE,
    BYTES,
    FLAG,
    IDENTIFIER,
    NUMBER,
    Form,
    KeyReading,
    ValueKind,
    here,
    key,
    keys,
    ref,
)
from framekit.definition.kinds.base import (
    Contents,
    Given,
    Segment,
    SegmentLoading,
    Segments,
    all_fixed,
    contents_of,
    fixed_size,
    lack_default,
    sizes_of,
)
from framekit.definition.kinds.const import Const
from framekit.definition.kinds.field import Field
from framekit.definition.kinds.inner import Nested
from framekit.definition.problems import Problem, plural
from framekit.definition.tree import Mapping, Node, Scalar, Sequence
from framekit.definition.wire_types import (
    ENDS,
    EVERY_BYTE,
    SIZE,
    TEXT_KEYS,
    FieldType,
    Size,
    Sizes,
    load_size,
    load_type,
)

INDEX, LAST, PREVIOUS = "item.index", "item.last", "item.previous"
PLAIN = "value"
"""Name of the value in an item of a list of plain values with a separator or alignment."""
ITEM_WORDS = {"index": INDEX, "last": LAST, "previous": PREVIOUS}
"""Words in the items of a list, and the internal names that they stand for."""


def _items(reading: KeyReading) -> Segments | FieldType:
    node, until, separator = (reading.keys.get(name) for name in ("of", "until", "separator"))
    if isinstance(node, Sequence):
        if (end := reading.keys.get("end")) is not None:
            raise reading.reader.broken(end.at, "end: ends plain values, and these items are fields", "leave it out")
        found: Segments = reading.loader.load(node)
        if separator is not None:
            found = (_separator(reading, separator), *found)
        if until is not None:
            found = (*found, ItemEnd(at=until.at, until=reading.reader.expression(until)))
        return found
    if until is not None:
        what = "until asks for fields of an item, and these items are plain values"
        raise reading.reader.broken(until.at, what, "write of: [{field: NAME, type: …}]")
    type_ = load_type(reading.space, reading.keys, node, texts=True)
    if not _is_single(reading):
        if (end := reading.keys.get("end")) is not None:
            raise reading.reader.broken(
                end.at, "end: ends items that have a separator", "add separator:, or give a size"
            )
        return type_
    if isinstance(type_.size, Expression) and PLAIN in names_in(type_.size.root):
        what = f"the size of an item reads '{PLAIN}', which is the item itself here"
        raise reading.reader.broken(type_.size.at, what, "give the other field another name")
    item = Field(at=reading.keys.at, name=PLAIN, type=type_)
    return (item,) if separator is None else (_separator(reading, separator), item)


def _is_single(reading: KeyReading) -> bool:
    """Return whether the items are plain values with a separator or alignment."""
    node, more = reading.keys.get("of"), (reading.keys.get(name) for name in ("separator", "align"))
    return isinstance(node, Scalar) and any(one is not None for one in more)


def _separator(reading: KeyReading, node: Node) -> Const:
    """Return the separator: a constant at the beginning of every item but the first. Raises Broken."""
    times = reading.keys.get("times")
    if times is not None and load_size(reading.reader, times) == 1:
        raise reading.reader.broken(node.at, "a list of one item has no separator", "leave it out")
    is_not_first = Compare(node.at, Name(node.at, INDEX), ((">", Number(node.at, 0)),))
    return Const(at=node.at, data=reading.reader.bytes(node), when=Expression("index > 0", is_not_first))


def _align(reading: KeyReading, node: Node) -> int:
    found = reading.reader.number(node)
    if not 2 <= found <= MOST_ALIGNED:
        raise reading.reader.broken(node.at, f"align is from 2 to {MOST_ALIGNED}, not {found}", "correct it")
    return found


MOST_ALIGNED = 256
ALIGN = NUMBER._replace(read=_align)
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
    **{name: schema for name, schema in TEXT_KEYS.items() if name != "empty"},  # each takes some bytes
    "end": ENDS,
    "separator": {**BYTES.schema, "description": "Bytes between two items, not after the last one."},
    "until": {**ref("expression"), "description": "The list ends after the item for which this is true."},
}


@dataclass(frozen=True, slots=True, kw_only=True)
class ItemEnd(Segment):
    """The end of an item, which determines whether it is the last: by `until`, else by the end of the region."""

    takes_bytes: ClassVar[bool] = False

    until: Expression | None = None

    def needed(self) -> Iterator[tuple[str, Expression]]:
        if self.until is not None:
            yield "end of the list", self.until

    def given(self) -> Iterator[Given]:
        yield self.until, "any", None


@dataclass(frozen=True, slots=True, kw_only=True)
class Repeat(Segment):
    """A list: of records if `of` is segments, of plain values if it is a type."""

    KEY: ClassVar[str] = "repeat"
    VALUE: ClassVar[ValueKind | None] = "list"
    WANTED: ClassVar[bool] = True

    name: str = key("repeat", IDENTIFIER, "Name of the list.")
    times: Size | None = key("times", SIZE, "Number of items; an expression; or rest, as many as fit.", default=None)
    """Number of items; None if the items themselves show which is the last."""
    of: Segments | FieldType = keys(_ITEMS, _items)
    single: bool = keys({}, _is_single, default=False)
    """Whether the items are plain values; each is the field PLAIN of its segments."""
    align: int = key("align", ALIGN, "Each item begins at a multiple of this number of bytes in the list.", default=1)
    """Each item begins at a multiple of this number of bytes in the list; fill bytes are not checked."""
    between: bool = key("between", FLAG, "Nothing is filled up after the last item.", default=False)
    fill: int = key("fill", BYTE, "What is sent to fill up; default 00.", default=0)

    @classmethod
    def called(cls) -> str:
        return "list"

    @property
    def inner_record(self) -> Segments | None:
        return None if isinstance(self.of, FieldType) else self.of

    @property
    def is_list(self) -> bool:
        return True

    @property
    def plain_type(self) -> FieldType | None:
        """Return the type of the items if they are plain values; else None."""
        if isinstance(self.of, FieldType):
            return self.of
        last = self.of[-1] if self.single else None
        return last.type if isinstance(last, Field) else None

    @property
    def record(self) -> Segments | None:
        """Return the segments of an item if the items are records; else None."""
        return None if self.single else self.inner_record

    @property
    def until(self) -> Expression | None:
        """Return the condition that marks the last item, or None."""
        last = self.members[-1:]
        return last[0].until if last and isinstance(last[0], ItemEnd) else None

    @property
    def next_item(self) -> Segments:
        """Return the segments of every item after the first: segments that only the first item lacks are always
        present.
        """
        return tuple(replace(one, when=None) if _from_the_second(one) else one for one in self.members)

    @property
    def is_counted(self) -> bool:
        """Return whether the number of items is known before the first is read."""
        return self.times is not None and self.times != "rest"

    def with_record(self, change: Callable[[Segments], Segments]) -> Self:
        return self if isinstance(self.of, FieldType) else replace(self, of=change(self.of))

    def sizes(self, of_frame: Callable[[str], Sizes]) -> Sizes:
        item = self.of.sizes if isinstance(self.of, FieldType) else sizes_of(self.of, of_frame)
        least, most = (self.times, self.times) if isinstance(self.times, int) else (0 if self.times else 1, None)
        if self.align == 1:
            return item.times(least, most)
        greatest = None if most is None or item.most is None else self.filled(item.most, most)
        return Sizes(self.filled(item.least, least), greatest)

    def filled(self, item: int, times: int) -> int:
        """Return the size of a number of items of this size, with fill bytes."""
        more = -item % self.align
        return times * (item + more) - (more if times and self.between else 0)

    def contents(self, of_frame: Contents) -> frozenset[int]:
        if self.align > 1:
            return EVERY_BYTE  # fill bytes are not checked
        return self.of.contents if isinstance(self.of, FieldType) else contents_of(self.of, of_frame)

    @property
    def takes_rest(self) -> bool:
        return self.times == "rest"

    @property
    def size_expression(self) -> Expression | None:
        size = self.of.size if isinstance(self.of, FieldType) else None
        return size if isinstance(size, Expression) else None

    def needed(self) -> Iterator[tuple[str, Expression]]:
        yield from Segment.needed(self)
        if isinstance(self.times, Expression):
            yield "number of items", self.times

    def given(self) -> Iterator[Given]:
        yield from Segment.given(self)
        yield self.times if isinstance(self.times, Expression) else None, "number", None

    def check(self) -> Iterator[Problem]:
        if self.times is None and self.until is None:
            yield Problem(self.at, f"nothing says how many items '{self.name}' has", "add times or until")
        elif self.times is not None and self.until is not None:
            what = f"times and until both say where '{self.name}' ends"
            yield Problem(self.at, what, "leave one of them out")
        yield from self._check_align()
        if isinstance(self.of, FieldType):
            return
        if not self.of:
            yield Problem(self.at, f"an item of '{self.name}' is empty", "add segments to of")
        elif all(fixed_size(segment) == 0 for segment in self.of):
            yield Problem(self.at, f"an item of '{self.name}' takes no bytes", "add a segment that takes some")
        elif self.times == "rest" and all(_may_be_nothing(segment) for segment in self.of):
            what = f"an item of '{self.name}' may take no bytes, so nothing shows how many there are"
            yield Problem(self.at, what, "add a segment that always takes some, or a count")

    def _check_align(self) -> Iterator[Problem]:
        """Report an alignment without effect."""
        size = all_fixed(self.of) if not isinstance(self.of, FieldType) else None
        if self.align < 2:
            for set_, key_ in ((self.between, "between"), (self.fill, "fill")):
                if set_:
                    yield Problem(self.at, f"{key_} of '{self.name}' has no effect without align", "add align: N")
        elif size is not None and size % self.align == 0:
            what = f"every item of '{self.name}' takes {plural(size, 'byte')}, so align: {self.align} has no effect"
            yield Problem(self.at, what, "leave it out")
        elif self.between and self.times == 1:
            yield Problem(
                self.at, f"nothing stands between the items of '{self.name}', which is one", "leave align out"
            )


def _from_the_second(segment: Segment) -> bool:
    match segment.when:
        case Expression(root=Compare(first=Name(name=name), rest=((">", Number(value=0)),))):
            return name == INDEX
    return False


def _may_be_nothing(segment: Segment) -> bool:
    """Return whether a segment is present only under a condition, or in one of several cases."""
    in_cases = bool(segment.blocks) and not segment.is_there_inside
    return segment.when is not None or not segment.takes_bytes or in_cases


@dataclass(frozen=True, slots=True, kw_only=True)
class Record(Segment):
    """A layout included `as` a name: its fields form one value, a mapping."""

    VALUE: ClassVar[ValueKind | None] = "record"

    name: str
    of: Segments

    @property
    def inner_record(self) -> Segments | None:
        return self.of

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
    """The keys of `include`: a record if it has a name `as`, else the segments of the layout themselves."""

    KEY: ClassVar[str] = "include"

    of: Segments = key(
        "include", INCLUDED, "The layout whose segments are included here; FILE.layout for one of a used file."
    )
    record: str | None = key("as", IDENTIFIER, "Makes its values one record of this name.", default=None)
    depth: int | None = key("depth", NUMBER, "The greatest depth of a layout that includes itself.", default=None)

    @classmethod
    def load(cls, loader: SegmentLoading, keys: Mapping) -> Segments:
        reader = loader.space.reader
        layout, depth = keys.get("include"), keys.get("depth")
        if layout is not None and depth is not None:
            frame, record = loader.nested(layout, depth), keys.get("as")
            if record is None:
                what = "an include with depth makes a record, which has no name"
                raise reader.broken(keys.at, what, "add as: NAME")
            common = {**loader.common(keys, "include"), "name": reader.text(record)}
            return (Nested(**common, layout=reader.text(layout), frame=frame),)
        found = cls.attributes(loader, keys)
        when = reader.maybe(reader.expression, keys.get("when"))
        refuse = reader.maybe(reader.number, keys.get("refuse"))
        segments: Segments = found["of"]
        if found["record"] is not None:
            return (Record(at=keys.at, name=found["record"], of=segments, when=when, refuse=refuse),)
        if (name := keys.get("name")) is not None:
            loader.aliases[reader.text(name)] = tuple(part.name for part in segments if part.name)
        return tuple(_under(part, when, refuse) for part in segments)


def _under(segment: Segment, when: Expression | None, refuse: int | None) -> Segment:
    """Return an included segment with `when` and `refuse` of its include."""
    if when is not None:
        segment = replace(segment, when=both(when, segment.when))
    if refuse is not None and segment.refuse is None:
        segment = replace(segment, refuse=refuse)
    return segment
