"""Reading a buffer from front to back: places, what is left for a segment, conditions that wait for their names.

The fast path of decoders reads straight ahead and only gathers conditions; that a place lies beyond the end shows when
everything is read, at the latest. Which fault it was is not asked here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from framekit.codec.python.expressions import Entry, Scope, may_be_negative
from framekit.codec.python.function import Function
from framekit.codec.python.places import Fields, Place
from framekit.codec.python.source import bytes_literal
from framekit.definition.expression.emit import AND, SUM
from framekit.definition.expression.syntax import Expression
from framekit.definition.model.segments import Const, Record, Segment
from framekit.definition.problems import DefinitionError, Problem

START = Place("", 0)
END = Place("end", 0)


@dataclass(frozen=True, slots=True)
class Item:
    """A segment with the scope its names belong to and the dictionary its values go to."""

    segment: Segment
    scope: Scope
    fields: Fields


class BufferReader:
    """Reads one buffer. `buffer` is its text, `at` the local that holds the place once that is not fixed any more."""

    def __init__(self, function: Function, buffer: str, at: str) -> None:
        self.function = function
        self.module = function.module
        self.shapes = function.shapes
        self.buffer = buffer
        self.at = at
        self.begin = self.place = START
        self.deferred: list[Callable[[], None]] = []
        self.in_item = False  # of a list: what follows is the next item, not the end of the buffer

    def items(self, segments: Iterable[Segment], scope: Scope, fields: Fields) -> list[Item]:
        """The segments with those of records, so that structs may reach over their borders."""
        found: list[Item] = []
        for segment in segments:
            if isinstance(segment, Record) and segment.when is None:
                found.extend(self.record_items(segment, scope, fields))
            else:
                found.append(Item(segment, scope, fields))
        return found

    def record_items(self, record: Record, scope: Scope, fields: Fields) -> list[Item]:
        inner = Fields(self.function.local(record.name, scope), (fields, record.name))
        inside = Scope(scope)
        scope.entries[record.name] = Entry(inner.variable, "record", inside, direct=True, record=inner)
        return self.items(record.of, inside, inner)

    # ---- places -------------------------------------------------------------------------------------------

    def advance(self, text: str) -> None:
        """Lets the local of the place be `text`."""
        if text != self.at:
            self.function.flush_using(self.at)
            further = text.removeprefix(f"{self.at} + ")
            self.function.add(f"{self.at} = {text}" if further == text else f"{self.at} += {further}")
        self.place = Place(self.at, 0)

    def settle(self) -> None:
        """Puts the place into its local, so that branches and loops may move it."""
        self.advance(self.place.text(self.buffer))

    def keep(self, place: Place) -> Place:
        """A place that stays when the local moves on."""
        if place.base in ("", "end"):
            return place
        self.function.add(f"start = {place.text(self.buffer)}")
        return Place("start", 0)

    def take(self, item: Item, size: str) -> tuple[Place, Place]:
        """The places of a segment whose size is the text `size` (a sum at most)."""
        first = self.keep(self.place)
        start = first.text(self.buffer)
        self.advance(size if start == "0" else f"{start} + {size}")
        self.function.stands(item.segment, self.buffer, first, self.place)
        return first, self.place

    def region_end(self, after: tuple[Item, ...]) -> Place:
        """The end of a segment that reaches as far as what follows it leaves room."""
        fixed, conditional = 0, []
        for item in after:
            size = self.shapes.present(item.segment).fixed
            if size is None or self.in_item or not self._is_told(item):
                return self._next_constant(after[0])
            if item.segment.when is None:
                fixed += size
            elif size:
                writer = self.function.writer(item.scope)
                conditional.append(f"({size} if {writer.text(item.segment.when, AND)} else 0)")
        if not conditional:
            return Place("end", -fixed)
        end = self.function.names.fresh("region_end")
        parts = [f"len({self.buffer})", *([str(fixed)] if fixed else []), *conditional]
        self.function.add(f"{end} = {' - '.join(parts)}")
        return Place(end, 0)

    def knows_behind(self, after: tuple[Item, ...]) -> bool:
        """Whether the bytes that follow can be counted already."""
        return not self.in_item and all(
            self.shapes.present(item.segment).fixed is not None and self._is_told(item) for item in after
        )

    def _is_told(self, item: Item) -> bool:
        """Whether it can be told already if the segment is there."""
        when = item.segment.when
        return when is None or not self.function.waits_for(when, item.scope)

    def _next_constant(self, item: Item) -> Place:
        """Where the constant stands that ends what comes before it."""
        if not isinstance(item.segment, Const) or item.segment.when is not None:
            raise without_end(item.segment)
        end = self.function.names.fresh("region_end")
        start = self.place.text(self.buffer)
        self.function.add(f"{end} = {self.buffer}.index({bytes_literal(item.segment.data)}, {start})")
        return Place(end, 0)

    def take_rest(self, item: Item, after: tuple[Item, ...]) -> tuple[Place, Place]:
        """The places of a segment that takes everything what follows it leaves."""
        last = self.region_end(after)
        first = self.place
        if first.base == "" and last.base == "end":
            if first.offset - last.offset:
                self.function.misfit_if(f"len({self.buffer}) < {first.offset - last.offset}")
        elif first.base != "end" or last.base != "end":
            self.function.misfit_if(f"{first.text(self.buffer)} > {last.text(self.buffer)}")
        if last.base == "end":
            self.place = last
        else:
            first = self.keep(first)
            self.function.flush()
            self.advance(last.text(self.buffer))
        self.function.stands(item.segment, self.buffer, first, self.place)
        return first, last

    def close(self) -> None:
        """Everything is read: nothing may be left over, and nothing may have been read from beyond the end."""
        if self.place.base == "end":
            assert self.place.offset == 0, "segments behind a rest fill the buffer"
            return
        size = f"len({self.buffer}) != {self.place.text(self.buffer)}"
        if size not in self.function.conditions:
            self.function.conditions.insert(0, size)  # it costs less than any check code

    # ---- names and conditions -----------------------------------------------------------------------------

    def declare(self, item: Item, name: str, local: str, *, sized: bool = True, wire: str | None = None) -> None:
        """The value `name` of a segment is in `local` from now on."""
        item.scope.entries[name] = Entry(local, sized=sized, wire=wire)
        self.function.names_of_values[name] = local
        item.fields.add(name, local)

    def when_known(self, expression: Expression, scope: Scope, action: Callable[[], None]) -> None:
        """Does something with an expression at once, or when the fields it reads are there."""
        if self.function.waits_for(expression, scope):
            self.deferred.append(action)
        else:
            action()

    def finish_deferred(self) -> None:
        """Does what waited for later fields."""
        deferred, self.deferred = self.deferred, []
        for action in deferred:
            action()

    def size_text(self, expression: Expression, scope: Scope, level: int = SUM) -> str:
        """Text of a size; one that can come out negative is kept in a local and looked at."""
        text = self.function.writer(scope).text(expression, level)
        if not may_be_negative(expression.root):
            return text
        local = self.function.names.fresh("length")
        self.function.add(f"{local} = {self.function.writer(scope).text(expression)}")
        self.function.misfit_if(f"{local} < 0")
        return local


def without_end(segment: Segment) -> DefinitionError:
    """The complaint about a segment of which nothing says where it begins."""
    what = "nothing says where the segment before this one ends"
    return not_possible(segment, what, "give it a size, or a constant behind")


def not_possible(segment: Segment, what: str, todo: str) -> DefinitionError:
    """The complaint about something that cannot be compiled."""
    return DefinitionError([Problem(segment.at, what, todo)])
