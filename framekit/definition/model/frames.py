"""Groups and frames, with all inheritance and includes resolved (guide: frames).

Also walks over a model: the segments of a list in order, the names of their values, the expressions in a part. Segments
of every kind give their contents by `blocks`, `inner_record` and `value_names`. Also the static sizes of frames, and
their possible bytes.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Container, Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cache
from types import NoneType
from typing import Any, Literal, TypeVar

from framekit.definition.expression import Attribute, Expression, names_in, walk
from framekit.definition.kinds.base import Segment, Segments, all_fixed, contents_of, fixed_size, least_size, sizes_of
from framekit.definition.kinds.const import Fill, Skip
from framekit.definition.problems import Position
from framekit.definition.wire_types import ANY, Sizes

T = TypeVar("T")


# ---- segments -----------------------------------------------------------------------------------------------


def flat(segments: Iterable[Segment]) -> Iterator[Segment]:
    """Yield the segments whose values belong to one record, including those in wraps, choices and optional parts."""
    for segment in segments:
        yield segment
        for block in segment.blocks:
            yield from flat(block)


def everything(segments: Iterable[Segment]) -> Iterator[Segment]:
    """Yield every segment, including those in records and lists, which come after the segments of the surrounding
    record.
    """
    for segment in flat(segments):
        yield segment
        yield from everything(segment.inner_record or ())


def leaves(segments: Iterable[Segment]) -> Iterator[Segment]:
    """Yield the segments with bytes of their own, in order: the contents of wraps, choices and records instead of
    those.
    """
    for segment in segments:
        inside = segment.blocks if segment.is_list or segment.inner_record is None else (segment.inner_record,)
        for block in inside:
            yield from leaves(block)
        if not inside and segment.takes_bytes:
            yield segment


def in_place_of_records(segments: Segments) -> Iterator[Segment]:
    """Yield the segments, with records that are always present replaced by their segments."""
    for segment in segments:
        if segment.is_record and segment.when is None:
            yield from in_place_of_records(segment.members)
        else:
            yield segment


def certain(segments: Iterable[Segment], there: bool = True) -> Iterator[tuple[Segment, bool]]:
    """Yield every segment of one record, and whether it is always present apart from its own condition."""
    for segment in segments:
        yield segment, there
        for block in segment.blocks:
            yield from certain(block, there and segment.is_there_inside and segment.when is None)


def by_value_name(segments: Iterable[Segment]) -> dict[str, Segment]:
    """Return the segments of one record with values, by the name of the value."""
    return {name: segment for segment in flat(segments) for name in segment.value_names}


def change_all(segments: Segments, change: Callable[[Segment], Segment]) -> Segments:
    """Return the segments of one record changed, outer segments before inner segments."""

    def all_changed(block: Segments) -> Segments:
        return tuple(change(segment).with_blocks(all_changed) for segment in block)

    return all_changed(segments)


def with_holders(segments: Segments, holder: str = "") -> Segments:
    """Return the segments, each with the path of its record."""

    def change(segment: Segment) -> Segment:
        held = replace(segment, holder=holder) if holder else segment
        return held.with_record(lambda of: with_holders(of, held.path))

    return change_all(segments, change)


def nearest_path(name: str, segment: Segment, paths: Container[str]) -> str:
    """Return the path of a name in expressions of a segment: in the innermost record that has the name.

    `paths`: all existing paths. If no record has the name, return the name itself.
    """
    holder = segment.holder
    while holder and f"{holder}.{name}" not in paths:
        holder = holder.rpartition(".")[0]
    return f"{holder}.{name}" if holder else name


def without_when(segment: Segment) -> Segment:
    return replace(segment, when=None)


# ---- names of values ----------------------------------------------------------------------------------------


def field_names(segments: Iterable[Segment]) -> set[str]:
    """Return the names of the values of these segments."""
    return {name for segment in flat(segments) for name in _own_names(segment)}


def names_needed(segments: Iterable[Segment]) -> list[str]:
    """Return the names without which no frame can be built, because they get a value from no other source."""
    found: list[str] = []
    for segment, is_present in certain(segments):
        if segment.when is not None or not is_present:
            continue
        found += segment.wanted_names
    return found


def names_always_there(segments: Iterable[Segment]) -> set[str]:
    """Return the names that every value has, whatever its content."""
    found: set[str] = set()
    for segment, is_present in certain(segments):
        if is_present and segment.when is None and not segment.is_there_inside:
            found |= _own_names(segment)
    return found


def _own_names(segment: Segment) -> set[str]:
    if segment.value_names:
        return {name for name in segment.value_names if not name.startswith("_")}
    return {segment.name} if segment.name is not None and not segment.name.startswith("_") else set()


# ---- parts of any kind --------------------------------------------------------------------------------------


def parts_of(value: Any, kind: type[T]) -> Iterator[T]:
    """Yield everything of class `kind` inside `value` (itself included), outermost first; expressions are not
    entered.
    """
    left = [value]
    while left:
        value = left.pop()
        if value.__class__ in _PLAIN:
            continue
        if isinstance(value, kind):
            yield value
        names = _names_of(value.__class__)
        if names:
            left += [getattr(value, name) for name in names]
        elif isinstance(value, dict):
            left += reversed(value.values())
        elif isinstance(value, (tuple, list)):
            left += reversed(value)


_PLAIN = frozenset({str, int, bool, bytes, float, NoneType, Position, frozenset})
_NO_PARTS = frozenset({"str", "int", "bool", "bytes", "float", "None", "Position", "tuple", "frozenset"})


@cache
def _names_of(kind: type) -> tuple[str, ...]:
    """Return the fields of a class that may hold parts, in reverse order, without fields that hold plain numbers or
    texts.
    """
    if not is_dataclass(kind) or issubclass(kind, (Expression, Position)):
        return ()
    kinds = [(field.name, set(re.findall(r"\w+", str(field.type)))) for field in reversed(fields(kind))]
    return tuple(name for name, words in kinds if not words <= _NO_PARTS)


def expressions_of(value: Any) -> Iterator[Expression]:
    """Return every expression inside `value`."""
    return parts_of(value, Expression)


def names_read(value: Any) -> set[str]:
    """Return every name that an expression inside `value` reads."""
    return {name for expression in expressions_of(value) for name in names_in(expression.root)}


def names_read_in(segments: Iterable[Segment]) -> set[str]:
    """Return the names that expressions in one record or item read, inner records included, inner lists not."""
    found: set[str] = set()
    for segment in flat(segments):
        for expression in expressions_of(segment.with_lists(lambda _: ())):
            found |= names_in(expression.root)
        if segment.is_record:
            found |= names_read_in(segment.members)
    return found


# ---- groups, frames, layouts --------------------------------------------------------------------------------


__all__ = ["Frame", "Group", "Layout", "Side", "StaticSizes", "all_fixed", "bytes_of", "fixed_size", "least_size"]

Side = Literal["client", "server", "both", "none"]
Mark = Literal["first", "last", "none"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Group:
    """Frames that share head and tail; only the properties of the group itself are stored here, the rest in its
    frames.
    """

    name: str
    frames: tuple[str, ...]
    side: Side
    inner: bool
    at: Position


@dataclass(frozen=True, slots=True)
class Announced:
    """An announcement of a frame for later frames: the value of a state variable, or of its entry `key`."""

    name: str
    value: Expression
    key: Expression | None = None


WIRE = "wire"
"""Name in announcements for the bytes of the frame on the line."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Frame:
    """A frame: head, body and tail are flat lists of segments (includes inlined, `where` written into the fields)."""

    name: str
    at: Position
    groups: tuple[str, ...]
    """Its group and the groups that this extends, nearest first."""
    side: Side
    head: tuple[Segment, ...]
    body: tuple[Segment, ...]
    tail: tuple[Segment, ...]
    inner: bool = False
    """Whether it never occurs on a line by itself, only inside other frames."""
    echo: Mapping[str, Expression]
    """Field of this reply → expression over the request's fields."""
    announces: tuple[Announced, ...] = ()
    """Announced state variables, by expressions over this frame."""
    delimited: bool = False
    surplus: int | None = None
    size: int | None = None
    """Size of the whole frame (bytes), filled up with `fill`; None if variable."""
    fill: int = 0
    most: int | None = None
    """Size of the longest frame (bytes)."""
    inside: tuple[str, ...] = ()
    """Frames that may interrupt it after any of its bytes."""
    refuse: int | None = None
    """Code with which the frame is refused; None for a normal frame."""
    mark: Mark | None = None
    """Byte with its ninth bit set."""
    doc: str = ""

    @property
    def segments(self) -> tuple[Segment, ...]:
        return self.head + self.body + self.tail


@dataclass(frozen=True, slots=True, kw_only=True)
class PartlyRead:
    """The good segments of a frame with errors, which are checked, too."""

    name: str
    segments: Segments
    lost: frozenset[str] | None
    """The words of its broken segments, which may be names; None if its missing segments may have any name."""
    holders: frozenset[Position]
    """The places of segments inside which others could not be read."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """A named list of segments that can be built and read by itself, or included."""

    name: str
    segments: tuple[Segment, ...]
    at: Position


class StaticSizes:
    """Sizes of segments of a protocol."""

    def __init__(self, frames: Mapping[str, Frame]) -> None:
        self.frames = frames
        self._known: dict[str, Sizes] = {}

    def frame(self, name: str) -> Sizes:
        """Return the sizes of a frame; unbounded for a frame that contains itself, any for a missing (broken) frame."""
        if name not in self._known:
            self._known[name] = ANY
            if name in self.frames:
                self._known[name] = self.all(self.segments(self.frames[name]))
        return self._known[name]

    def segments(self, frame: Frame) -> Segments:
        """Return head, body and tail, with a skip or `Fill` for the free bytes of a frame of fixed size."""
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

    def all(self, segments: Iterable[Segment]) -> Sizes:
        return sizes_of(tuple(segments), self.frame)

    def of(self, segment: Segment) -> Sizes:
        """Return the sizes of a segment that may be absent."""
        sizes = self.present(segment)
        return sizes if segment.when is None else Sizes(0, sizes.most)

    def present(self, segment: Segment) -> Sizes:
        """Return the sizes of a segment that is present."""
        return segment.sizes(self.frame)

    def is_variable(self, segment: Segment) -> bool:
        """Return whether its size varies while it is present."""
        return self.present(segment).fixed is None

    def split(self, segments: Segments) -> tuple[Segments, Segments]:
        """Return the segments up to the last of variable size, and the rest; if none is variable, the rest is empty."""
        last = max((place for place, segment in enumerate(segments) if self.is_variable(segment)), default=-1)
        return (segments, ()) if last < 0 else (segments[: last + 1], segments[last + 1 :])

    def may_refuse(self, segments: Segments) -> bool:
        """Return whether a fault here, or in an inner frame, is answered with a refusal."""
        known: set[str] = set()
        wanted = [segments]
        while wanted:
            here = wanted.pop()
            if any(part.refuse is not None for part in parts_of(here, Segment)):
                return True
            inner = {name for part in parts_of(here, Segment) for name in part.frames_inside} - known
            if any(self.frames[name].refuse is not None for name in inner):
                return True
            known |= inner
            wanted += [self.frames[name].segments for name in inner]
        return False


def bytes_of(segments: Iterable[Segment], frames: Mapping[str, Frame] | None = None) -> frozenset[int]:
    """Return the bytes that may occur in these segments; every byte if that is unknown.

    `frames`: the frames that `inner` segments name; without them an inner frame may contain every byte.
    """
    known = {} if frames is None else frames
    return contents_of(segments, lambda name: known[name].segments if name in known else None)


def attributes_in(values: Any) -> set[str]:
    """Return the names of attributes (`….name`) that expressions read."""
    nodes = (node for one in expressions_of(values) for node in walk(one.root))
    return {node.name for node in nodes if isinstance(node, Attribute)}
