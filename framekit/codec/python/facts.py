"""Derive facts about segments that hold for every frame: the segments of a path, constants at the start of a frame.

This module reads the model and writes no source.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TypeVar

from framekit.codec.python.codings import starts
from framekit.definition.expression import Attribute, Call, Expression, Name, Node, children, names_in, walk
from framekit.definition.model.frames import (
    StaticSizes,
    certain,
    everything,
    expressions_of,
    flat,
    in_place_of_records,
    nearest_path,
)
from framekit.definition.model.segments import (
    Check,
    Const,
    Count,
    Data,
    Field,
    Inner,
    Length,
    Repeat,
    Segment,
    Segments,
    Wrap,
)
from framekit.definition.problems import Position


def may_be_empty(static: StaticSizes, repeat: Repeat) -> bool:
    """Return whether an item may take no bytes, which is a fault if only the bytes determine the number of items."""
    return isinstance(repeat.of, tuple) and not isinstance(repeat.times, int) and static.all(repeat.of).least == 0


@dataclass(frozen=True, slots=True)
class PathTarget:
    """The segments of a path: a single segment, or several if cases share the path."""

    segments: tuple[Segment, ...]
    only: Segment | None
    """The segment that is present in every case, or None."""


def targets_of(length: Length, segments: Iterable[Segment]) -> dict[str, PathTarget]:
    """Return the segments that a length counts, by path."""
    found = _index_of(_SameSegments(tuple(segments))).targets
    return {path: found[path] for path in length.counted if path in found}


Presence = frozenset[object]
"""The conditions and cases on which the presence of a segment depends."""


@dataclass(frozen=True, slots=True)
class _Index:
    """The segments of a list and of the records inside it, by path."""

    targets: dict[str, PathTarget]
    every: dict[str, list[Segment]]
    """All segments of a path."""
    presences: dict[str, dict[int, list[tuple[Position, Presence]]]]
    """The positions and presences of the segments of a path, by the number of their record."""


class _SameSegments:
    """A tuple of segments as a key: equal to the same tuple only, which needs no look at the segments."""

    def __init__(self, segments: Segments) -> None:
        self.segments = segments

    def __hash__(self) -> int:
        return id(self.segments)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _SameSegments) and other.segments is self.segments


@lru_cache(maxsize=16)
def _index_of(same: _SameSegments) -> _Index:
    """Return the index of segments; it is kept, because every length and count of a frame needs it."""
    found = _Index({}, {}, {})
    for segment in everything(same.segments):
        found.every.setdefault(segment.path, []).append(segment)
    for number, record in enumerate(records_in(same.segments)):
        found.targets.update(by_path(record))
        for segment, presence in _conditions(record):
            found.presences.setdefault(segment.path, {}).setdefault(number, []).append((segment.at, presence))
    return found


def segments_at(path: str, segments: Segments) -> Sequence[Segment]:
    """Return the segments of a path: several if cases share it."""
    return _index_of(_SameSegments(segments)).every.get(path, ())


def records_in(segments: Segments) -> Iterator[Segments]:
    """Yield the segments themselves, then those of every record and list at any depth."""
    yield segments
    yield from (one.inner_record for one in everything(segments) if one.inner_record)


def by_path(segments: Iterable[Segment]) -> dict[str, PathTarget]:
    """Return the segments of a record by their paths."""
    segments = tuple(segments)
    found: dict[str, list[Segment]] = {}
    for segment in flat(segments):
        if segment.name is not None:
            found.setdefault(segment.path, []).append(segment)
    always = {id(segment) for segment, there in certain(segments) if there}
    return {
        path: PathTarget(tuple(every), every[0] if len(every) == 1 and id(every[0]) in always else None)
        for path, every in found.items()
    }


def is_followed(length: Length, segments: tuple[Segment, ...]) -> bool:
    """Return whether the size of the counted segments is read from the length, so that no disagreement is possible."""
    found = [one for target in targets_of(length, segments).values() for one in target.segments]
    return bool(found) and all(
        follows_its_length(length, one) and comes_with(one.path, length, segments) for one in found
    )


def names_asked_for(segments: Iterable[Segment]) -> set[str]:
    """Return every name that these segments read, including records and lists, or count before conversion."""
    segments = tuple(segments)
    nodes = (node for expression in expressions_of(segments) for node in walk(expression.root))
    read = {node.name for node in nodes if isinstance(node, (Name, Attribute))}
    counted = {one.of for one in everything(segments) if isinstance(one, Count)}
    plain = {name for one in everything(segments) if isinstance(one, Length) and one.plain for name in one.of}
    return read | counted | plain


def lengths_asked(segments: Iterable[Segment]) -> set[str]:
    """Return the names whose length an expression in these segments reads."""
    nodes = (node for expression in expressions_of(tuple(segments)) for node in walk(expression.root))
    calls = (node.arguments[0] for node in nodes if isinstance(node, Call) and node.function == "len")
    return {argument.name for argument in calls if isinstance(argument, Name)}


def only_measured(segments: Iterable[Segment]) -> set[str]:
    """Return the names of which expressions in these segments read only the length."""
    return lengths_asked(segments) - values_read(segments)


def values_read(segments: Iterable[Segment]) -> set[str]:
    """Return the names of which expressions in these segments read more than the length."""
    read = set[str]()
    left: list[Node] = [expression.root for expression in expressions_of(tuple(segments))]
    while left:
        match left.pop():
            case Call(function="len", arguments=(Name(),)):
                continue
            case Name(name=name):
                read.add(name)
            case node:
                left += children(node)
    return read


def comes_with(path: str, number: Segment, segments: tuple[Segment, ...]) -> bool:
    """Return whether the segment of a path is present whenever the number that counts it is."""
    presences = _index_of(_SameSegments(segments)).presences
    counted = presences.get(path, {})
    for record, places in presences.get(number.path, {}).items():
        own = [there for at, there in places if at == number.at]
        others = [there for _, there in counted.get(record, ())]
        if own and others:
            return all(any(other <= there for other in others) for there in own)
    return False


def _conditions(segments: Iterable[Segment], around: Presence = frozenset()) -> Iterator[tuple[Segment, Presence]]:
    """Yield the segments of a record, each with all conditions and cases on which its presence depends."""
    for segment in segments:
        there = around if segment.when is None else around | {str(segment.when)}
        yield segment, there
        for case, block in enumerate(segment.blocks):
            yield from _conditions(block, there if segment.is_there_inside else there | {(id(segment), case)})


def ending_constants(
    static: StaticSizes, segments: Segments, after: Segments = (), in_item: bool = False
) -> Iterator[tuple[tuple[str, Position], bytes]]:
    """Yield path, position and constant for each part that takes the rest and has no end except that constant."""
    segments = tuple(in_place_of_records(segments))
    for place, segment in enumerate(segments):
        behind = (*segments[place + 1 :], *after)
        first = behind[0] if behind else None
        if _takes_rest(segment) and isinstance(first, Const):
            unread = {name for one in everything((segment, *behind)) for name in one.value_names}
            told = all(one.when is None or not names_in(one.when.root) & unread for one in behind)
            if in_item or not told or any(static.present(one).fixed is None for one in behind):
                yield (segment.path, segment.at), first.data
        for block in segment.blocks:
            inside = segment.is_there_inside
            yield from ending_constants(static, block, () if inside else behind, False if inside else in_item)
        if segment.inner_record is not None:
            is_list = segment.is_list
            yield from ending_constants(static, segment.members, () if is_list else behind, is_list or in_item)


def _takes_rest(segment: Segment) -> bool:
    """Return whether a segment extends to the next segment, whatever its content."""
    if isinstance(segment, Field):
        return segment.type.size is None and not segment.type.is_delimited and segment.long is None
    return segment.takes_rest or (isinstance(segment, Inner) and segment.size == "rest")


def leading(segments: tuple[Segment, ...]) -> bytes:
    """Return the constant bytes at the start of every frame of these segments, encoded, including those in wraps."""
    return _leading(segments)[0]


def _leading(segments: tuple[Segment, ...]) -> tuple[bytes, bool]:
    """Return the constants at the start, and whether all segments were constants."""
    found = b""
    for segment in segments:
        if segment.when is not None:
            return found, False
        if isinstance(segment, Const):
            found += segment.data
        elif segment.is_record or isinstance(segment, Wrap):
            inner, whole = _leading(segment.of if isinstance(segment, Wrap) else segment.members)
            if isinstance(segment, Wrap):
                inner = starts(segment.coding, inner)
                whole = whole and bool(inner)
            found += inner
            if not whole:
                return found, False
        elif segment.takes_bytes:
            return found, False
    return found, True


def begins_with_constants(static: StaticSizes, inner: Inner) -> bool:
    """Return whether one of the inner frames begins with constants that distinguish it from others."""
    return any(leading(static.segments(static.frames[name])) for name in inner.frames)


def ending_checks(segments: Iterable[Segment]) -> Iterator[Check]:
    """Return the check codes that end a frame immediately."""
    return (one for one in flat(segments) if isinstance(one, Check) and one.ends)


def looks_inside(static: StaticSizes, segments: Segments) -> bool:
    """Return whether measuring a frame of fixed size must examine more than its start.

    It must for an inner frame that begins with constants, and for a check code that ends the frame.
    """
    inner = any(isinstance(one, Inner) and begins_with_constants(static, one) for one in flat(segments))
    return inner or any(True for _ in ending_checks(segments))


def symbol_behind(wrap: Wrap, after: Iterable[Segment]) -> bytes:
    """Return the escape byte and its successor that follow a wrap.

    The result is empty if other bytes may follow, or may be refused.
    """
    found = whole_constant(after)
    return found[:2] if len(found) > 1 and found[0] == wrap.escape else b""


def whole_constant(segments: Iterable[Segment]) -> bytes:
    """Return the bytes of the constants at the start of a list, up to a conditional or refusable segment."""
    found = b""
    for segment in segments:
        if not isinstance(segment, Const) or segment.when is not None or segment.refuse is not None:
            break
        found += segment.data
    return found


def code_before_end(before: Sequence[Segment]) -> Check | None:
    """Return the check code directly before a constant that may end a frame, if it is quick to verify; else None.

    Most candidates for the end are wrong, and reading the frame for each of them would be slow.
    """
    check = before[-1] if before else None
    if not isinstance(check, Check) or check.when is not None or check.covers is not None or check.added:
        return None
    is_plain = check.verify == "error" and not check.method.is_keyed and check.order == "big"
    return check if is_plain and check.form in ("raw", "hex", "HEX") else None


def is_fixed(field: Field) -> bool:
    """Return whether a field has a single value when present, and no value when absent."""
    one = field.constants is not None and len(field.constants) == 1
    return one and (field.when is None or field.default is None)


def is_plain_name(expression: object, name: str) -> bool:
    """Return whether a size or number consists only of this name."""
    return isinstance(expression, Expression) and is_name(expression.root, name)


def is_name(node: object, name: str) -> bool:
    """Return whether a node of an expression is that name."""
    return isinstance(node, Name) and node.name == name


def follows_its_length(length: Length, target: Segment) -> bool:
    """Return whether the target's size is read from this length, so that no disagreement is possible."""
    return length.counted == (target.path,) and _is_sized_by(length, target)


def size_follows_value(segment: Segment, segments: Mapping[str, Segment]) -> bool:
    """Return whether a segment is as long as the given value.

    True if its size is a length that counts only it, or that counts a choice in which it is alone in its case.
    `segments`: all segments by path.
    """
    size = segment.size_expression
    name = size.root.name if size is not None and isinstance(size.root, Name) else None
    length = None if name is None else segments.get(nearest_path(name, segment, segments))
    if not isinstance(length, Length) or not _is_sized_by(length, segment) or len(length.counted) != 1:
        return False
    counted = segments.get(length.counted[0])
    if length.counted == (segment.path,) or counted is None or not counted.has_cases:
        return length.counted == (segment.path,)
    blocks = ([one for one in block if one.takes_bytes] for block in counted.blocks)
    return any(len(block) == 1 and block[0] is segment for block in blocks)


def _is_sized_by(length: Length, target: Segment) -> bool:
    """Return whether the size of the target consists only of this length."""
    if length.plus or length.unit != 1:
        return False
    if isinstance(target, Data):
        return is_plain_name(target.size, length.name) and (length.plain or target.convert is None)
    if isinstance(target, Wrap):
        return is_plain_name(target.size, length.name)
    return isinstance(target, Field) and is_plain_name(target.type.size, length.name) and target.long is None


def parts_around(static: StaticSizes, segments: Segments) -> tuple[Segments, Segments, Segments]:
    """Return the fixed segments at the start, the segments up to the last variable segment, and the fixed rest.

    The last two are empty if the size of the rest is not known in advance.
    """
    front, tail = static.split(segments)
    has_bytes = any(static.present(segment).fixed != 0 for segment in tail)
    if not has_bytes or not _is_known_before(static, front, tail):
        return segments, (), ()
    first = next(place for place, segment in enumerate(front) if static.is_variable(segment))
    return front[:first], front[first:], tail


def _is_known_before(static: StaticSizes, front: Segments, tail: Segments) -> bool:
    """Return whether the size of the tail is known before the first variable segment is read."""
    late: set[str] = set()
    variable = False
    for segment in front:
        variable = variable or static.is_variable(segment)
        if variable:
            late.update(name for one in everything((segment,)) for name in one.value_names)
    wanted = {name for segment in tail if segment.when is not None for name in names_in(segment.when.root)}
    own = {name for segment in everything(tail) for name in segment.value_names}
    return not wanted & (late | own)


Placed = TypeVar("Placed")


def fixed_and_conditional(
    static: StaticSizes, placed: Iterable[tuple[Segment, Placed]]
) -> tuple[int, list[tuple[int, Expression, Placed]]]:
    """Return the total size of the unconditional segments in bytes, and size and condition of each other segment.

    The segments have a fixed size when present.
    """
    fixed, conditional = 0, list[tuple[int, Expression, Placed]]()
    for segment, scope in placed:
        size = static.present(segment).fixed or 0
        if segment.when is None:
            fixed += size
        elif size:
            conditional.append((size, segment.when, scope))
    return fixed, conditional
