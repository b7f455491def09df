"""Taking functions: one call finds the end of a frame in a stream, judges it and reads it, out of the buffer itself.

Only for frames that can be read from front to back, and only what is surely good: everything else is left to those who
measure and decode. A receiver uses them for what comes in rows.
"""

from __future__ import annotations

from collections.abc import Mapping

from framekit.codec.python.choices import Switch, in_order, tree_of
from framekit.codec.python.describe import write_docstring
from framekit.codec.python.expressions import Entry, Scope
from framekit.codec.python.function import MISFIT, Function
from framekit.codec.python.measure import MOST
from framekit.codec.python.module import Module
from framekit.codec.python.nested import Reader
from framekit.codec.python.places import Fields, Place, between, index
from framekit.codec.python.reader import Item
from framekit.codec.python.shape import leading
from framekit.codec.python.source import Source, bytes_literal
from framekit.definition.expression.syntax import Expression
from framekit.definition.model.frames import Frame
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.segments import Check, Const, Inner, Optional, Wrap
from framekit.definition.model.visit import parts_of
from framekit.definition.problems import DefinitionError

BEGIN = Place("begin", 0)


class NotInARow(Exception):  # noqa: N818 - a way out, no error
    """The frame cannot be read from front to back."""


def write_takes(module: Module, protocol: Protocol, identifiers: Mapping[str, str]) -> dict[str, Source]:
    """The sources of `take_…` by identifiers: of all frames that are looked for on the line and can be read so.

    And of those inside them, as far as they are read from the same buffer.
    """
    found: dict[str, Source] = {}
    inside = {name for frame in protocol.frames.values() for part in parts_of(frame, Inner) for name in part.frames}
    on_line = [name for name, frame in protocol.frames.items() if not frame.inner and name not in inside]
    for name in on_line:
        writer = TakeWriter(module, identifiers[name], protocol.frames[name])
        if writer.can_be_taken:
            found[identifiers[name]] = writer.function_on_line()
    done: set[str] = set()
    while left := [name for name in module.taken if name not in done]:
        for name in left:
            writer = TakeWriter(module, identifiers[name], protocol.frames[name])
            if writer.can_be_taken:
                found[identifiers[name]] = writer.inner_function()
        done.update(left)
    return found


class TakeWriter:
    """Writes one taking function."""

    def __init__(self, module: Module, identifier: str, frame: Frame) -> None:
        self.module, self.identifier, self.frame = module, identifier, frame
        self.segments = segments = module.shapes.segments(frame)
        self.function = Function(module, identifier, segments)
        self.function.names.fresh(BEGIN.base)
        self.fields = Fields(self.function.names.fresh("fields"))
        self.reader = TakeReader(self.function)
        self.can_be_taken = frame.surplus is None and not all(isinstance(segment, Const) for segment in segments)
        try:
            if self.can_be_taken:
                self._read()
        except (NotInARow, DefinitionError):
            self.can_be_taken = False

    def _read(self) -> None:
        reader, function, scope = self.reader, self.function, Scope()
        items = reader.items(self.segments, scope, self.fields)
        tail = len(self.frame.tail) if self.frame.delimited else 0
        if tail:
            self._read_delimited(items[:-tail], items[-tail:])
        else:
            reader.read_items(items, ())
        reader.finish_deferred()
        for item in items:
            item.fields.attach()
        for action in function.late:
            action()
        place = reader.place.text("data")
        function.conditions.insert(0, f"{place} > end")
        longest, most = function.shapes.all(self.segments).most, self.frame.most or MOST
        if longest is None or longest > most:
            function.misfit_if(f"{place} - begin > {most}")

    def _read_delimited(self, before: list[Item], tail: list[Item]) -> None:
        """The first byte of the tail ends the body, wherever it stands behind the head."""
        reader, head = self.reader, self.function.shapes.all(self.frame.head).fixed
        first = tail[0].segment
        if head is None or not isinstance(first, Const) or self.segments != self.frame.segments:
            raise NotInARow
        mark = bytes_literal(first.data[:1])
        self.function.add(f"stop = data.index({mark}, {BEGIN.plus(head).text('data')})")
        reader.is_ended = True
        reader.read_items(before, ())
        reader.is_ended = False
        if reader.place != Place("stop", 0):
            self.function.misfit_if(f"{reader.place.text('data')} != stop")
            self.function.flush()
            reader.place = Place("stop", 0)
        reader.read_items(tail, ())

    # ---- functions ----------------------------------------------------------------------------------------

    def _head(self, out: Source, sentence: str, refusal: str) -> None:
        write_docstring(out, sentence, "")
        for context, local in self.function.hoisted.items():
            out.add(f"{local} = {self.module.given(context)}")
            state = self.module.protocol.state.get(context)
            if state is not None and state.announced:
                with out.block(f"if {local} is None:"):
                    out.add(refusal)

    def inner_function(self) -> Source:
        function, out = self.function, Source()
        function.flush()
        result = self.fields.text(function.out)
        header = "data: bytes, begin: int, end: int, ctx: Context"
        with out.block(f"def take_{self.identifier}({header}) -> tuple[int, dict[str, Any]]:"):
            self._head(out, f"The place behind the frame `{self.frame.name}` at data[begin], and its values.", MISFIT)
            out.extend(function.out)
            out.add(f"return {self.reader.place.text('data')}, {result}")
        return out

    def function_on_line(self) -> Source:
        function, reader, out = self.function, self.reader, Source()
        if reader.raw_until != reader.place:
            function.add(f"raw = {between('data', BEGIN, reader.place)}")
        function.flush()
        result = self.fields.text(function.out)
        header = "data: bytes, begin: int, end: int, ctx: Context"
        with out.block(f"def take_{self.identifier}({header}) -> tuple[bytes, dict[str, Any]] | None:"):
            about = f"The bytes and values of the frame `{self.frame.name}` at data[begin], if it is surely good."
            self._head(out, about, "return None")
            with out.block("try:"):
                out.extend(function.out)
            with out.block("except MISFITS:"):
                out.add("return None")
            out.add(f"return raw, {result}")
        return out


class TakeReader(Reader):
    """Reads a frame in the middle of a buffer, whose end is where everything has been read.

    `is_ended`: the local `stop` is the place where the body ends. `raw_until`: what the local `raw` holds already.
    """

    def __init__(self, function: Function) -> None:
        super().__init__(function, "data", "at", BEGIN)
        self.is_ended = False
        self.raw_until: Place | None = None

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
            self.compare_residue(check, "raw", residue)
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
        self.advance(f"{self.buffer}.index({single}, {first.text(self.buffer)})")
        with function.out.block(f"while {self.buffer}[{self.at} + 1] == {escape}:"):
            function.add(f"{self.at} = {self.buffer}.index({single}, {self.at} + 2)")
        function.stands(wrap, self.buffer, first, self.place)
        function.flush()
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
        self.module.taken.update(dict.fromkeys(inner.frames))
