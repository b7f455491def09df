"""Facts about segments that hold for every frame of their kind: sizes, what can vary, constants a frame begins with.

It reads the model and writes nothing.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from framekit.definition.expression.syntax import Attribute, Expression, Name, names_in, walk
from framekit.definition.model.frames import Frame
from framekit.definition.model.segments import (
    Bits,
    Check,
    Choose,
    Const,
    Count,
    Data,
    Field,
    FieldType,
    Inner,
    Length,
    Optional,
    Record,
    Repeat,
    Require,
    Segment,
    Skip,
    Value,
    Wrap,
)
from framekit.definition.model.visit import expressions_of, parts_of


@dataclass(frozen=True, slots=True)
class Sizes:
    """Least and most bytes on the wire; `most` is None where there is no bound."""

    least: int
    most: int | None

    @property
    def fixed(self) -> int | None:
        return self.least if self.least == self.most else None

    def __add__(self, other: Sizes) -> Sizes:
        most = None if self.most is None or other.most is None else self.most + other.most
        return Sizes(self.least + other.least, most)

    def times(self, least: int, most: int | None) -> Sizes:
        bound = None if self.most is None or most is None else self.most * most
        return Sizes(self.least * least, 0 if self.most == 0 else bound)


NOTHING = Sizes(0, 0)
ANY = Sizes(0, None)


def either(sizes: Iterable[Sizes]) -> Sizes:
    """The sizes of one of several possibilities."""
    found = list(sizes)
    if not found:
        return NOTHING
    most = [size.most for size in found]
    return Sizes(min(size.least for size in found), None if None in most else max(m for m in most if m is not None))


@dataclass(frozen=True, slots=True, kw_only=True)
class Fill(Segment):
    """What a frame of fixed size leaves free between body and tail: `total` is the size of the whole frame."""

    total: int
    byte: int


class Shapes:
    """Sizes of segments; frames are needed for those inside others."""

    def __init__(self, frames: Mapping[str, Frame]) -> None:
        self.frames = frames
        self.trees: dict[tuple[str, ...], Any] = {}  # kept for `choices`: a large one takes its time
        self._known: dict[str, Sizes] = {}

    def frame(self, name: str) -> Sizes:
        """Sizes of a frame; a frame that holds itself has no bound."""
        if name not in self._known:
            self._known[name] = ANY
            self._known[name] = self.all(self.segments(self.frames[name]))
        return self._known[name]

    def segments(self, frame: Frame) -> tuple[Segment, ...]:
        """Head, body and tail, with a skip or `Fill` for what a frame of fixed size leaves free."""
        if frame.size is None:
            return frame.segments
        fixed = self.all(frame.segments).fixed
        if fixed is None:
            room: Segment = Fill(at=frame.at, name="_fill", total=frame.size, byte=frame.fill)
        elif frame.size > fixed:
            room = Skip(at=frame.at, name="_fill", size=frame.size - fixed, fill=bytes((frame.fill,)))
        else:
            return frame.segments
        return (*frame.head, *frame.body, room, *frame.tail)

    def may_refuse(self, segments: tuple[Segment, ...]) -> bool:
        """Whether a fault here, or in a frame inside, is one that is answered with a refusal."""
        known: set[str] = set()
        wanted = [segments]
        while wanted:
            here = wanted.pop()
            if any(part.refuse is not None for part in parts_of(here, Segment)):
                return True
            inner = {name for part in parts_of(here, Inner) for name in part.frames} - known
            if any(self.frames[name].refuse is not None for name in inner):
                return True
            known |= inner
            wanted += [self.frames[name].segments for name in inner]
        return False

    def all(self, segments: Iterable[Segment]) -> Sizes:
        segments = tuple(segments)
        total = NOTHING
        for segment in segments:
            if isinstance(segment, Fill):
                return Sizes(segment.total, segment.total)
            total += self.of(segment)
        return total

    def of(self, segment: Segment) -> Sizes:
        """Sizes of a segment that may be absent."""
        sizes = self.present(segment)
        return sizes if segment.when is None else Sizes(0, sizes.most)

    def present(self, segment: Segment) -> Sizes:
        """Sizes of a segment that is there."""
        match segment:
            case Const(data=data):
                return Sizes(len(data), len(data))
            case Skip(size=size) | Check(size=size):
                return Sizes(size, size)
            case Field(type=type_, long=long):
                sizes = of_type(type_)
                return sizes if long is None else Sizes(sizes.least, (sizes + of_type(long.type)).most)
            case Bits(type=type_) | Length(type=type_) | Count(type=type_):
                return of_type(type_)
            case Data():
                return _of_data(segment)
            case Value() | Require():
                return NOTHING
            case Record(of=of):
                return self.all(of)
            case Optional(of=of):
                return Sizes(0, self.all(of).most)
            case Repeat(times=times, of=of):
                item = of_type(of) if isinstance(of, FieldType) else self.all(of)
                return item.times(times, times) if isinstance(times, int) else item.times(0, None)
        return self._with_others(segment)

    def _with_others(self, segment: Segment) -> Sizes:
        match segment:
            case Choose(cases=cases, otherwise=otherwise):
                lists = [of for _, of in cases] + ([] if otherwise is None else [otherwise])
                return either(self.all(of) for of in lists)
            case Wrap(how=how, of=of):
                content = self.all(of)
                return content.times(2, 2) if how == "hex" else Sizes(content.least, content.times(1, 2).most)
            case Inner(size=int(size)):
                return Sizes(size, size)
            case Inner(size=None, frames=names):
                return either(self.frame(name) for name in names)
        return ANY

    def is_variable(self, segment: Segment) -> bool:
        """Whether its size depends on more than whether it is there."""
        return self.present(segment).fixed is None

    def split(self, segments: tuple[Segment, ...]) -> tuple[tuple[Segment, ...], tuple[Segment, ...]]:
        """The segments up to the last of variable size, and the others behind it (all, if none is variable: none)."""
        last = max((place for place, segment in enumerate(segments) if self.is_variable(segment)), default=-1)
        return (segments, ()) if last < 0 else (segments[: last + 1], segments[last + 1 :])


def of_type(type_: FieldType) -> Sizes:
    size = type_.fixed_size
    if size is not None:
        return Sizes(size, size)
    return (
        Sizes(len(type_.end), None) if type_.kind == "ascii" and type_.end is not None and type_.size is None else ANY
    )


def may_be_empty(shapes: Shapes, repeat: Repeat) -> bool:
    """Whether an item may come out without bytes: a fault where only what is read tells how many there are."""
    return isinstance(repeat.of, tuple) and not isinstance(repeat.times, int) and shapes.all(repeat.of).least == 0


def on_wire(data: Data, size: int) -> int:
    """Bytes on the wire for so many in memory."""
    return size * 2 if data.convert == "hex_to_ascii" else size // 2 if data.convert == "ascii_to_hex" else size


def _of_data(data: Data) -> Sizes:
    if isinstance(data.size, int):
        return Sizes(on_wire(data, data.size), on_wire(data, data.size))
    return Sizes(on_wire(data, data.least), None)


def flat(segments: Iterable[Segment]) -> Iterator[Segment]:
    """Every segment whose fields belong to the frame itself: also those in wraps, choices and optional parts."""
    for segment in segments:
        yield segment
        if isinstance(segment, (Wrap, Optional)):
            yield from flat(segment.of)
        elif isinstance(segment, Choose):
            for _, case in segment.cases:
                yield from flat(case)
            yield from flat(segment.otherwise or ())


def everything(segments: Iterable[Segment]) -> Iterator[Segment]:
    """Every segment, also those in records and repeats."""
    for segment in flat(segments):
        yield segment
        if isinstance(segment, (Record, Repeat)) and isinstance(segment.of, tuple):
            yield from everything(segment.of)


def value_names(segment: Segment) -> tuple[str, ...]:
    """The names of the values a segment itself holds."""
    if isinstance(segment, Bits):
        return tuple(part.name for part in segment.parts)
    if isinstance(segment, (Field, Data, Length, Count, Repeat, Record, Inner, Value)):
        return (segment.name,)
    return ()


@dataclass(frozen=True, slots=True)
class Target:
    """What a name means: one segment, or several if cases share it; `only`: the one that is there in every case."""

    segments: tuple[Segment, ...]
    only: Segment | None


def targets_of(length: Length, segments: Iterable[Segment]) -> dict[str, Target]:
    """What a length counts, by name: in its own list, else in the lists around it."""
    segments = tuple(segments)
    found = {name: target for name, target in named(segments).items() if name in length.of}
    for holder in flat(segments):
        if isinstance(holder, (Record, Repeat)) and isinstance(holder.of, tuple):
            inner = [one for one in everything(holder.of) if (one.name, one.at) == (length.name, length.at)]
            if inner:
                found |= targets_of(length, holder.of)
    return {name: found[name] for name in length.of if name in found}


def named(segments: Iterable[Segment]) -> dict[str, Target]:
    """The segments of a list by their names."""
    segments = tuple(segments)
    found: dict[str, list[Segment]] = {}
    for segment in flat(segments):
        if segment.name is not None:
            found.setdefault(segment.name, []).append(segment)
    always = {id(segment) for segment in _always(segments)}
    return {
        name: Target(tuple(every), every[0] if len(every) == 1 and id(every[0]) in always else None)
        for name, every in found.items()
    }


def _always(segments: Iterable[Segment]) -> Iterator[Segment]:
    for segment in segments:
        yield segment
        if isinstance(segment, Wrap):
            yield from _always(segment.of)


def is_followed(length: Length, targets: Mapping[str, Target]) -> bool:
    """Whether the size of what a length counts is read from it, so that nothing can disagree."""
    found = [segment for target in targets.values() for segment in target.segments]
    return bool(found) and all(follows_its_length(length, segment) for segment in found)


def names_read(segments: Iterable[Segment]) -> set[str]:
    """Every name that an expression in these segments reads."""
    return {name for expression in expressions_of(tuple(segments)) for name in names_in(expression.root)}


def names_asked_for(segments: Iterable[Segment]) -> set[str]:
    """Every name that something in these segments reads, also of a record or a list."""
    segments = tuple(segments)
    nodes = (node for expression in expressions_of(segments) for node in walk(expression.root))
    attributes = {node.name for node in nodes if isinstance(node, Attribute)}
    return names_read(segments) | attributes | {one.of for one in everything(segments) if isinstance(one, Count)}


def is_always_there(name: str, segments: Iterable[Segment]) -> bool:
    """Whether a segment stands under no condition, in no choice and in no optional part."""
    return any(
        one.when is None
        and (
            one.name == name
            or (isinstance(one, (Record, Wrap)) and is_always_there(name, one.of))
            or (isinstance(one, Repeat) and isinstance(one.of, tuple) and is_always_there(name, one.of))
        )
        for one in segments
    )


def without_when(segment: Segment) -> Segment:
    return replace(segment, when=None)


def leading(shapes: Shapes, segments: tuple[Segment, ...]) -> bytes:
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
        elif isinstance(segment, (Record, Wrap)):
            inner, whole = _leading(segment.of)
            if isinstance(segment, Wrap):
                inner = wrapped(segment, inner)
            found += inner
            if not whole:
                return found, False
        elif not isinstance(segment, (Value, Require)):
            return found, False
    return found, True


def wrapped(wrap: Wrap, plain: bytes) -> bytes:
    """Plain content as it stands on the wire."""
    if wrap.how == "hex":
        return plain.hex().upper().encode()
    single = bytes((wrap.escape or 0,))
    return plain.replace(single, single * 2)


def is_plain_name(expression: object, name: str) -> bool:
    """Whether a size or number is nothing but the value of that name."""
    return isinstance(expression, Expression) and is_name(expression.root, name)


def is_name(node: object, name: str) -> bool:
    """Whether a node of an expression is that name."""
    return isinstance(node, Name) and node.name == name


def follows_its_length(length: Length, target: Segment) -> bool:
    """Whether the target's size is read from this very length, so that the two cannot disagree."""
    if length.of != (target.name,) or length.plus or length.unit != 1:
        return False
    if isinstance(target, Data):
        return is_plain_name(target.size, length.name) and (length.plain or target.convert is None)
    return isinstance(target, Field) and is_plain_name(target.type.size, length.name) and target.long is None
