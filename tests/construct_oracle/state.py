"""State of reading or writing a frame: the current region, the bytes seen so far, names of segments.

The state travels in the construct context of a frame (`context._state`); the records inside share it. It knows how
fields are looked up in contexts, but no kind of segment.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from io import BytesIO
from typing import TYPE_CHECKING, Any

from construct import Container, stream_tell

from construct_oracle.evaluate import BYTES_OF, evaluate
from construct_oracle.faults import Faults, Place, Stop
from construct_oracle.names import Names
from construct_oracle.sizes import Evaluate, KnownSizes
from framekit.codec.evaluate import EVALUATION_ERRORS, MissingName
from framekit.definition.expression import Expression
from framekit.definition.model.frames import parts_of
from framekit.definition.model.segments import ITEM_WORDS, Check, Segment

if TYPE_CHECKING:
    from construct_oracle.base import SegmentConstruct


@dataclass(slots=True)
class Leaf:
    """The bytes of a segment before its wrap is applied, and their number before conversion.

    No bytes: content of a wrap that could not be decoded.
    """

    data: bytes | None
    plain: int


@dataclass(frozen=True, slots=True)
class Mark:
    """The leaves of a named segment, and the offset and number of its bytes on the wire."""

    first: int
    last: int
    wire: int
    start: int = 0


class Unopened(Exception):  # noqa: N818 - it says what cannot be counted
    """Content that could not be decoded."""


class State:
    """Common state of reading and writing: leaves and marks, from which check codes and lengths are computed."""

    def __init__(self, names: Names) -> None:
        self.names = names
        self.leaves: list[Leaf] = []
        self.lists: dict[int, tuple[int, BytesIO, int, int]] = {}

    @contextmanager
    def as_it_stands(self, stream: BytesIO) -> Iterator[None]:
        """Let check codes cover the bytes between entry and exit as they are on the wire, wraps included."""
        first, start = len(self.leaves), stream.tell()
        yield
        self.lists[first] = len(self.leaves), stream, start, stream.tell()

    def leaf(self, data: bytes, plain: int | None = None) -> Leaf:
        leaf = Leaf(data, len(data) if plain is None else plain)
        self.leaves.append(leaf)
        return leaf

    def unopened(self) -> None:
        self.leaves.append(Leaf(None, 0))

    def bytes_of(self, first: int, last: int) -> bytes:
        found = bytearray()
        while first < last:
            end, stream, start, stop = self.lists.get(first, (first, None, 0, 0))
            if stream is not None and first < end <= last:
                found += stream.getvalue()[start:stop]
                first = end
            else:
                data = self.leaves[first].data
                if data is None:
                    raise Unopened
                found += data
                first += 1
        return bytes(found)

    def plain_size(self, mark: Mark) -> int:
        return sum(leaf.plain for leaf in self.leaves[mark.first : mark.last])

    @contextmanager
    def marked(self, name: str | None, stream: BytesIO, context: Container, path: str) -> Iterator[None]:
        """Record the bytes between entry and exit as the segment `name`."""
        first, start = len(self.leaves), stream_tell(stream, path)
        yield
        if name is not None:
            context._marks[name] = Mark(first, len(self.leaves), stream_tell(stream, path) - start, start)

    def mark_absent(self, segments: Iterable[Segment], context: Container, stream: BytesIO) -> None:
        """Record the offset of absent segments, since ranges may begin and end with them."""
        for segment in segments:
            if segment.name is not None:
                context._marks[segment.name] = Mark(len(self.leaves), len(self.leaves), 0, stream.tell())


def scopes(context: Container) -> Iterator[Container]:
    """Yield the context of a record and of its enclosing records, up to the frame."""
    while True:
        yield context
        if context._is_frame:
            return
        context = context._


def mark_of(context: Container, name: str) -> Mark:
    """Return the mark of the segment `name`. Raises KeyError if it is absent."""
    for scope in scopes(context):
        mark: Mark | None = scope._marks.get(name)
        if mark is not None:
            return mark
    raise KeyError(name)


def is_marked(context: Container, name: str) -> bool:
    """Return whether the segment `name` has been read or written."""
    return any(name in scope._marks for scope in scopes(context))


@dataclass(frozen=True, slots=True)
class Region:
    """The end of the readable bytes. `exact`: reading must reach this end, so the size of a rest is known."""

    end: int
    exact: bool


class Reading(State):
    """The state of reading a frame."""

    def __init__(self, names: Names, sizes: KnownSizes, region: Region) -> None:
        super().__init__(names)
        self.sizes = sizes
        self.faults = Faults()
        self.region = region
        self.following: tuple[SegmentConstruct, ...] = ()
        self.offset: Callable[[int], int] = lambda position: position
        self.later: list[Callable[[], None]] = []
        self.order = 0
        self.stopped = False

    def place(self, stream: BytesIO, label: str, refuse: int | None) -> Place:
        """Return the next place in reading order, at the stream position."""
        self.order += 1
        return Place(self.order, self.offset(stream.tell()), label, refuse)

    def note(self, place: Place, cause: str, expected: object = "", found: object = "") -> None:
        self.faults.note(place, cause, expected, found)

    def stop(self, place: Place, cause: str, expected: object = "", found: object = "") -> Stop:
        """Note a fault that prevents locating any later segment. Return the exception for the caller to raise."""
        self.note(place, cause, expected, found)
        return Stop(f"{cause} fault at '{place.label}'")

    def take(self, stream: BytesIO, size: int, place: Place) -> bytes:
        """Return the next `size` bytes of the region. Raises Stop if fewer are left."""
        left = self.region.end - stream.tell()
        if size > left:
            raise self.stop(place, "short", f"{size} bytes", f"{max(left, 0)}")
        return stream.read(size)

    def stopped_in(self, segments: Iterable[Segment]) -> None:
        """Record that these segments were not all read, so their check codes cannot all be compared."""
        self.stopped = True
        checks = (check for segment in segments for check in parts_of(segment, Check))
        self.faults.unchecked |= any(check.verify == "error" for check in checks)

    def finish(self) -> None:
        """Make the comparisons that were deferred until everything was read."""
        for compare in self.later:
            compare()
        self.later = []

    def copy(self) -> Reading:
        """Return an independent copy of the reading, without its faults."""
        other = Reading(self.names, self.sizes, self.region)
        other.following, other.offset, other.order = self.following, self.offset, self.order
        other.leaves, other.lists = list(self.leaves), dict(self.lists)
        return other

    def store(self, context: Container, name: str, value: Any, place: Place) -> None:
        """Add a value to the record that is being read."""
        context[name] = value
        context._values[name] = value
        context._orders[name] = place.order

    def leave_out(self, context: Container, names: Iterable[str]) -> None:
        """Mark these values as absent for expressions."""
        context._left_out.update(names)

    def evaluate(self, expression: Expression, context: Container, own: str = "") -> Any:
        """Return the value of an expression; `own` is the field it belongs to.

        The name `own` refers to the outer scope. Raises one of EVALUATION_ERRORS, also for fields that are not read
        yet. A field that is left out is absent. The list around an item holds only the items before it.
        """

        def lookup(name: str) -> Any:
            if name.startswith(BYTES_OF):
                return mark_of(context, name.removeprefix(BYTES_OF)).wire
            item: tuple[str, int] | None = None
            for scope in scopes(context):
                if name == own and scope is context:
                    continue
                if name in ITEM_WORDS.values():
                    if scope._words is not None:
                        return scope._words[name]
                    continue
                if name in scope._values:
                    value = scope._values[name]
                    return value[: item[1]] if item is not None and item[0] == name else value
                item = scope._item
                if name in scope._left_out:
                    return None
                if name in scope._declared:
                    raise KeyError(name)
                if name in scope._marks:
                    mark = scope._marks[name]
                    return self.bytes_of(mark.first, mark.last)
            return self.names[name]

        return evaluate(expression.root, lookup)

    def known_in(self, context: Container) -> Evaluate:
        """Return an `Evaluate` for the values read so far."""

        def known(expression: Expression) -> Any:
            try:
                return self.evaluate(expression, context)
            except (MissingName, *EVALUATION_ERRORS):
                return None

        return known

    def room(self, context: Container) -> Region:
        """Return the region that the current segment may take: without the known size of the following segments."""
        behind = self.sizes.all((construct.segment for construct in self.following), self.known_in(context))
        if behind is None or not self.region.exact:
            return Region(self.region.end, exact=False)
        return Region(self.region.end - behind, exact=True)

    def no_room(self, place: Place, start: int, room: Region) -> Stop:
        """Note a segment at `start` after which the following segments do not fit."""
        following, available = self.region.end - room.end, max(self.region.end - start, 0)
        unit = "byte" if following == 1 else "bytes"
        return self.stop(place, "short", f"at least {following} {unit}", str(available))

    @contextmanager
    def within(self, region: Region) -> Iterator[None]:
        """Read in another region of the same bytes, where no following segments are known yet."""
        before = self.region, self.following
        self.region, self.following = region, ()
        try:
            yield
        finally:
            self.region, self.following = before

    @contextmanager
    def deeper(self, region: Region, offset: Callable[[int], int]) -> Iterator[None]:
        """Read other bytes: the content of a wrap. `offset` converts offsets in the content to offsets in the frame."""
        outer, self.offset = self.offset, offset
        try:
            with self.within(region):
                yield
        finally:
            self.offset = outer


class Writing(State):
    """The state of building a frame. `measuring`: only sizes are needed, so check codes may be wrong.

    `texts`: each text with stop bytes, with its stream, start and end.
    """

    def __init__(self, names: Names, measuring: bool = False) -> None:
        super().__init__(names)
        self.measuring = measuring
        self.later: list[Callable[[], None]] = []
        self.texts: list[tuple[Segment, BytesIO, int, int]] = []

    @contextmanager
    def deeper(self) -> Iterator[None]:
        """Build other bytes, the content of a wrap; its check codes are written after all of it."""
        outer, self.later = self.later, []
        try:
            yield
            if not self.measuring:
                for _ in self.later:  # a code may cover a later code
                    for fill_in in (*outer, *self.later):  # a code may also cover codes outside the wrap
                        fill_in()
        finally:
            self.later = outer
