"""Reading a frame in the middle of a buffer, from front to back: what follows says where it ends.

It knows what stands before a place and nothing of what stands behind; whoever needs that cannot be read so.
"""

from __future__ import annotations

from collections.abc import Iterable

from framekit.codec.python.choices import Switch, in_order, tree_of
from framekit.codec.python.expressions import Entry, Scope
from framekit.codec.python.function import MISFIT, Function
from framekit.codec.python.joined import Apart
from framekit.codec.python.measure import MOST
from framekit.codec.python.nested import Reader
from framekit.codec.python.places import Fields, Place, between, index
from framekit.codec.python.reader import Item
from framekit.codec.python.shape import leading
from framekit.codec.python.source import bytes_literal
from framekit.definition.expression.syntax import Expression
from framekit.definition.model.frames import Frame
from framekit.definition.model.segments import Check, Inner, Optional, Segment, Wrap

BEGIN = Place("begin", 0)


class NotInARow(Exception):  # noqa: N818 - a way out, no error
    """The frame cannot be read from front to back."""


class TakeReader(Reader):
    """Reads a frame in the middle of a buffer, whose end is where everything has been read. `most`: its longest.

    `is_ended`: the local `stop` is the place where the body ends. `raw_until`: what the local `raw` holds already.
    `checks`: conditions that hold only when everything is there. `asked`: the frames inside that have to be taken.
    `answer`: how what it finds is returned.
    """

    def __init__(self, function: Function, frame: Frame, is_inner: bool = False) -> None:
        super().__init__(function, "data", "at", BEGIN)
        self.most = MOST if frame.most is None else frame.most
        self.room = f"end - begin < {self.most}"
        self._is_inner = is_inner
        self.answer = "return "
        self.is_ended = False
        self.raw_until: Place | None = None
        self.asked: dict[str, None] = {}
        self.checks: list[str] = []

    def begun(self, *tests: str) -> str:
        """What is returned where bytes are wanted: that the frame has begun, if these tests hold.

        Measuring has to say so as well: it must not be too long, and what has been read must fit.
        """
        if self._is_inner:
            return MISFIT
        return f"{self.answer}() if {' and '.join(tests)} else None" if tests else f"{self.answer}()"

    def say_begun(self, *tests: str) -> None:
        """Writes that."""
        self.function.add(self.begun(*tests))

    def keep(self, place: Place) -> Place:
        return place if place.base in ("begin", "stop") else super().keep(place)

    # ---- where things end ---------------------------------------------------------------------------------

    def knows_behind(self, after: tuple[Item, ...]) -> bool:
        return self.is_ended and all(self._fixed_size(item) is not None for item in after)

    def region_end(self, after: tuple[Item, ...]) -> Place:
        if not self.knows_behind(after):
            raise NotInARow
        return Place("stop", -sum(self._fixed_size(item) or 0 for item in after))

    def _region_limit(self, after: tuple[Item, ...]) -> str:
        end = self.region_end(after)
        if end.offset:
            raise NotInARow
        return end.base

    def _fixed_size(self, item: Item) -> int | None:
        return None if item.segment.when is not None else self.shapes.present(item.segment).fixed

    def optional(self, item: Item, optional: Optional, after: tuple[Item, ...]) -> None:
        raise NotInARow

    # ---- what is read another way -------------------------------------------------------------------------

    def judge_residue(self, check: Check, residue: int, last: bool) -> None:
        """Over the frame's own bytes, which are wanted anyway."""
        if self.raw_until is None and not self.function.in_branch:
            self.raw_until = self.place.plus(check.size)
            self.function.add(f"raw = {between(self.buffer, BEGIN, self.raw_until)}")
            before = len(self.function.conditions)
            self.compare_residue(check, "raw", residue)
            self.checks = self.function.conditions[before:]
            del self.function.conditions[before:]
        else:
            super().judge_residue(check, residue, last=False)

    def _undouble(self, item: Item, wrap: Wrap, fixed: int | None, after: tuple[Item, ...], plain: str) -> None:
        """The region ends at the first escape byte that is not doubled; nothing else may stand in it."""
        if fixed is not None:
            if wrap.inside:
                raise NotInARow
            super()._undouble(item, wrap, fixed, after, plain)
            return
        function, escape = self.function, f"{wrap.escape or 0:#04x}"
        single, double = (bytes_literal(bytes((wrap.escape or 0,)) * count) for count in (1, 2))
        first = self.keep(self.place)
        function.flush()
        self.advance(f"{self.buffer}.find({single}, {first.text(self.buffer)})")
        with function.out.block(f"while 0 <= {self.at} < end - 1 and {self.buffer}[{self.at} + 1] == {escape}:"):
            function.add(f"{self.at} = {self.buffer}.find({single}, {self.at} + 2)")
        with function.out.block(f"if not 0 <= {self.at} < end - 1:"):
            self.say_begun(self.room)
        function.stands(wrap, self.buffer, first, self.place)
        function.add(f"{plain} = {between(self.buffer, first, self.place)}")
        with function.out.block(f"if {single} in {plain}:"):
            function.add(f"{plain} = {plain}.replace({double}, {single})")

    def _inner(self, item: Item, inner: Inner, after: tuple[Item, ...]) -> None:
        """A frame that has to be looked at to know where the one around it ends, or whether there is one."""
        known = self.shapes.present(inner).fixed is not None or self.knows_behind(after)
        begins = any(leading(self.shapes, self.shapes.segments(self.shapes.frames[name])) for name in inner.frames)
        if isinstance(inner.size, Expression) or (known and not begins):
            super()._inner(item, inner, after)
            return
        if inner.size == "rest":
            raise NotInARow
        function, tree = self.function, tree_of(self.shapes, in_order(self.shapes, inner.frames))
        local = function.local(inner.name, item.scope)
        name, take, fields = (function.names.fresh(one) for one in ("name", "take", f"{inner.name}_fields"))
        choice = self.module.choice(inner.frames, function.title, inner.name)
        deciding = index(self.buffer, self.place.plus(tree.at if isinstance(tree, Switch) else 0))
        first = self.keep(self.place)
        function.flush_using(self.at)
        function.add(f"{name}, {take} = {choice}.takes[{deciding}]")
        function.add(f"{self.at}, {fields} = {take}({self.buffer}, {first.text(self.buffer)}, end, ctx)")
        self.place = Place(self.at, 0)
        function.stands(inner, self.buffer, first, self.place)
        function.add(f"{local} = {{{name}: {fields}}}")
        item.scope.entries[inner.name] = Entry(local, "inner")
        function.names_of_values[inner.name] = local
        item.fields.add(inner.name, local)
        self.asked.update(dict.fromkeys(inner.frames))


class PairTakeReader(TakeReader):
    """Reads a frame and the one inside it as one."""

    def __init__(self, function: Function, frame: Frame, apart: Apart) -> None:
        super().__init__(function, frame)
        self.apart = apart

    def items(self, segments: Iterable[Segment], scope: Scope, fields: Fields) -> list[Item]:
        return [
            item
            for segment in segments
            for item in super(PairTakeReader, self).items((segment,), *self.apart.where(segment, scope, fields))
        ]
