"""Facts about segments that hold for every frame of their kind: what a name means, constants a frame begins with.

It reads the model and writes nothing.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

from framekit.codec.python.codings import starts
from framekit.definition.expression import Attribute, Call, Expression, Name, Node, children, names_in, walk
from framekit.definition.model.frames import StaticSizes, certain, everything, expressions_of, flat, in_place_of_records
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
    """Whether an item may come out without bytes: a fault where only what is read tells how many there are."""
    return isinstance(repeat.of, tuple) and not isinstance(repeat.times, int) and static.all(repeat.of).least == 0


@dataclass(frozen=True, slots=True)
class Target:
    """What has a path: one segment, or several if cases share it; `only`: the one that is there in every case."""

    segments: tuple[Segment, ...]
    only: Segment | None


def targets_of(length: Length, segments: Iterable[Segment]) -> dict[str, Target]:
    """What a length counts, by path."""
    found: dict[str, Target] = {}
    for of in records_in(tuple(segments)):
        found |= {path: target for path, target in by_path(of).items() if path in length.counted}
    return {path: found[path] for path in length.counted if path in found}


def records_in(segments: Segments) -> Iterator[Segments]:
    """The segments themselves, then those of every record and list in them."""
    yield segments
    yield from (one.inner_record for one in everything(segments) if one.inner_record)


def by_path(segments: Iterable[Segment]) -> dict[str, Target]:
    """The segments of one record by their paths."""
    segments = tuple(segments)
    found: dict[str, list[Segment]] = {}
    for segment in flat(segments):
        if segment.name is not None:
            found.setdefault(segment.path, []).append(segment)
    always = {id(segment) for segment, there in certain(segments) if there}
    return {
        path: Target(tuple(every), every[0] if len(every) == 1 and id(every[0]) in always else None)
        for path, every in found.items()
    }


def is_followed(length: Length, segments: tuple[Segment, ...]) -> bool:
    """Whether the size of what a length counts is read from it, so that nothing can disagree."""
    found = [one for target in targets_of(length, segments).values() for one in target.segments]
    return bool(found) and all(
        follows_its_length(length, one) and comes_with(one.path, length, segments) for one in found
    )


def names_asked_for(segments: Iterable[Segment]) -> set[str]:
    """Every name that something in these segments reads, also of a record or a list, or counts before conversion."""
    segments = tuple(segments)
    nodes = (node for expression in expressions_of(segments) for node in walk(expression.root))
    read = {node.name for node in nodes if isinstance(node, (Name, Attribute))}
    counted = {one.of for one in everything(segments) if isinstance(one, Count)}
    plain = {name for one in everything(segments) if isinstance(one, Length) and one.plain for name in one.of}
    return read | counted | plain


def lengths_asked(segments: Iterable[Segment]) -> set[str]:
    """The names whose length an expression in these segments asks for."""
    nodes = (node for expression in expressions_of(tuple(segments)) for node in walk(expression.root))
    calls = (node.arguments[0] for node in nodes if isinstance(node, Call) and node.function == "len")
    return {argument.name for argument in calls if isinstance(argument, Name)}


def only_measured(segments: Iterable[Segment]) -> set[str]:
    """The names of which expressions in these segments read nothing but the length."""
    found, read = set[str](), set[str]()
    left: list[Node] = [expression.root for expression in expressions_of(tuple(segments))]
    while left:
        match left.pop():
            case Call(function="len", arguments=(Name(name=name),)):
                found.add(name)
            case Name(name=name):
                read.add(name)
            case node:
                left += children(node)
    return found - read


def comes_with(path: str, number: Segment, segments: tuple[Segment, ...]) -> bool:
    """Whether the segment of that path is there wherever a number of the same record is that counts it."""
    for of in records_in(segments):
        places = tuple(_conditions(of))
        own = [there for one, there in places if (one.path, one.at) == (number.path, number.at)]
        others = [there for one, there in places if one.path == path]
        if own and others:
            return all(any(other <= there for other in others) for there in own)
    return False


def _conditions(
    segments: Iterable[Segment], around: frozenset[object] = frozenset()
) -> Iterator[tuple[Segment, frozenset[object]]]:
    """The segments of one record, each with all that it depends on whether it is there."""
    for segment in segments:
        there = around if segment.when is None else around | {str(segment.when)}
        yield segment, there
        for case, block in enumerate(segment.blocks):
            yield from _conditions(block, there if segment.is_there_inside else there | {(id(segment), case)})


def ending_constants(
    static: StaticSizes, segments: Segments, after: Segments = (), in_item: bool = False
) -> Iterator[tuple[tuple[str, Position], bytes]]:
    """By path and place: the constant that ends a part which takes the rest, where nothing else tells its end."""
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
    """Whether a segment reaches as far as what follows it leaves room, whatever it holds."""
    if isinstance(segment, Field):
        return segment.type.size is None and not segment.type.is_delimited and segment.long is None
    return segment.takes_rest or (isinstance(segment, Inner) and segment.size == "rest")


def leading(segments: tuple[Segment, ...]) -> bytes:
    """The constant bytes that every such frame begins with, also those inside wraps, as they stand on the wire."""
    return _leading(segments)[0]


def _leading(segments: tuple[Segment, ...]) -> tuple[bytes, bool]:
    """The constants at the start, and whether all segments were constants."""
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
    """Whether one of the frames that may stand there begins with constants, which tell it from others."""
    return any(leading(static.segments(static.frames[name])) for name in inner.frames)


def ending_checks(segments: Iterable[Segment]) -> Iterator[Check]:
    """The check codes that end a frame at once."""
    return (one for one in flat(segments) if isinstance(one, Check) and one.ends)


def looks_inside(static: StaticSizes, segments: Segments) -> bool:
    """Whether more than the size counts of a frame of fixed size, as an inner frame that begins with constants."""
    inner = any(isinstance(one, Inner) and begins_with_constants(static, one) for one in flat(segments))
    return inner or any(True for _ in ending_checks(segments))


def symbol_behind(wrap: Wrap, after: Iterable[Segment]) -> bytes:
    """The escape byte and its follower behind a wrap; empty if something else may stand there, or is to be refused."""
    found = whole_constant(after)
    return found[:2] if len(found) > 1 and found[0] == wrap.escape else b""


def whole_constant(segments: Iterable[Segment]) -> bytes:
    """The bytes of the constants at the start of a list, up to one that is not always there, or is to be refused."""
    found = b""
    for segment in segments:
        if not isinstance(segment, Const) or segment.when is not None or segment.refuse is not None:
            break
        found += segment.data
    return found


def code_before_end(before: Sequence[Segment]) -> Check | None:
    """The check code right before a constant that may end a frame, if a look tells whether it is right.

    Most places where a frame could end are no end, and to read what is before each of them takes long.
    """
    check = before[-1] if before else None
    if not isinstance(check, Check) or check.when is not None or check.covers is not None or check.added:
        return None
    is_plain = check.verify == "error" and not check.method.is_keyed and check.order == "big"
    return check if is_plain and check.form in ("raw", "hex", "HEX") else None


def is_fixed(field: Field) -> bool:
    """Whether a field has one value wherever it is there, and none elsewhere."""
    one = field.constants is not None and len(field.constants) == 1
    return one and (field.when is None or field.default is None)


def is_plain_name(expression: object, name: str) -> bool:
    """Whether a size or number is nothing but the value of that name."""
    return isinstance(expression, Expression) and is_name(expression.root, name)


def is_name(node: object, name: str) -> bool:
    """Whether a node of an expression is that name."""
    return isinstance(node, Name) and node.name == name


def follows_its_length(length: Length, target: Segment) -> bool:
    """Whether the target's size is read from this very length, so that the two cannot disagree."""
    return length.counted == (target.path,) and _is_sized_by(length, target)


def size_follows_value(segment: Segment, segments: Mapping[str, Segment]) -> bool:
    """Whether a segment is as long as what is given for it: its size is a length that counts it, or counts a choice in
    which it stands alone in its case. `segments`: all, by their paths."""
    for length in (one for one in segments.values() if isinstance(one, Length)):
        if follows_its_length(length, segment):
            return True
        choice = segments.get(length.counted[0]) if len(length.counted) == 1 else None
        if choice is not None and choice.has_cases and _is_sized_by(length, segment):
            blocks = ([one for one in block if one.takes_bytes] for block in choice.blocks)
            if any(len(block) == 1 and block[0] is segment for block in blocks):
                return True
    return False


def _is_sized_by(length: Length, target: Segment) -> bool:
    """Whether the target's size is the number of that length, as it stands."""
    if length.plus or length.unit != 1:
        return False
    if isinstance(target, Data):
        return is_plain_name(target.size, length.name) and (length.plain or target.convert is None)
    if isinstance(target, Wrap):
        return is_plain_name(target.size, length.name)
    return isinstance(target, Field) and is_plain_name(target.type.size, length.name) and target.long is None


def parts_around(static: StaticSizes, segments: Segments) -> tuple[Segments, Segments, Segments]:
    """The fixed segments at the start, those up to the last variable one, and the fixed ones behind it.

    The last two are empty if the size of the end cannot be told beforehand.
    """
    front, tail = static.split(segments)
    has_bytes = any(static.present(segment).fixed != 0 for segment in tail)
    if not has_bytes or not _is_known_before(static, front, tail):
        return segments, (), ()
    first = next(place for place, segment in enumerate(front) if static.is_variable(segment))
    return front[:first], front[first:], tail


def _is_known_before(static: StaticSizes, front: Segments, tail: Segments) -> bool:
    """Whether the size of the tail can be told before the first variable segment is read."""
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
    """The bytes of segments of fixed size: of those always there, and of each under a condition with that."""
    fixed, conditional = 0, list[tuple[int, Expression, Placed]]()
    for segment, scope in placed:
        size = static.present(segment).fixed or 0
        if segment.when is None:
            fixed += size
        elif size:
            conditional.append((size, segment.when, scope))
    return fixed, conditional
