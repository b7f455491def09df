"""The whole fast path of decoders: lists of segments, and those with others inside."""

from __future__ import annotations

from collections.abc import Iterable

from framekit.codec.python import forms
from framekit.codec.python.branches import BranchReader
from framekit.codec.python.choices import Switch, in_order, tree_of
from framekit.codec.python.expressions import Entry, Scope
from framekit.codec.python.function import MISFIT
from framekit.codec.python.places import Fields, Place, between
from framekit.codec.python.reader import Item, without_end
from framekit.codec.python.runs import shown_name
from framekit.codec.python.shape import may_be_empty
from framekit.codec.python.source import bytes_literal
from framekit.definition.expression.emit import BIT_OR
from framekit.definition.expression.syntax import Expression
from framekit.definition.model.segments import (
    Choose,
    FieldType,
    Inner,
    Optional,
    Repeat,
    Require,
    Segment,
    Value,
    Wrap,
)
from framekit.definition.model.walk import leaves


class Reader(BranchReader):
    """Reads everything a frame can hold."""

    def read(self, segments: Iterable[Segment], scope: Scope, fields: Fields, after: tuple[Item, ...] = ()) -> None:
        """Reads the segments; `after` is what follows them in the buffer."""
        items = self.items(segments, scope, fields)
        self.read_items(items, after)
        self.finish_deferred()
        for item in items:
            item.fields.attach()

    def read_items(self, items: list[Item], after: tuple[Item, ...]) -> None:
        place = 0
        while place < len(items):
            item = items[place]
            count = 1
            if item.segment.when is not None:
                count = _same_condition(items, place)
                self.conditional(items[place : place + count], (*items[place + count :], *after))
            elif (run := self.length_of_run(items[place:])) > 0:
                count = run
                behind = (*items[place + count :], *after)
                nothing = all(isinstance(one.segment, (Require, Value)) for one in behind)
                self.read_run(items[place : place + count], whole=place == 0 and nothing, last=nothing)
            elif not self.read_sized(item, (*items[place + 1 :], *after)):
                self._nested(item, (*items[place + 1 :], *after))
            place += count

    def _nested(self, item: Item, after: tuple[Item, ...]) -> None:
        match item.segment:
            case Repeat(of=FieldType() as of) as repeat:
                self._values(item, repeat, of, after)
            case Repeat() as repeat:
                self._records(item, repeat, after)
            case Choose() as choose:
                self.choose(item, choose, after)
            case Optional() as optional:
                self.optional(item, optional, after)
            case Wrap() as wrap:
                self._wrap(item, wrap, after)
            case Inner() as inner:
                self._inner(item, inner, after)
            case _:
                raise TypeError(f"no segment to read: {item.segment!r}")

    # ---- lists --------------------------------------------------------------------------------------------

    def _values(self, item: Item, repeat: Repeat, of: FieldType, after: tuple[Item, ...]) -> None:
        """A list of plain values."""
        size = of.fixed_size
        if size is None:
            raise without_end(repeat)
        local = self.function.local(repeat.name, item.scope)
        if repeat.times == "rest":
            first, last = self.take_rest(item, after)
            count = None
            if size > 1:
                start = first.text(self.buffer)
                room = last.text(self.buffer) if start == "0" else f"{last.text(self.buffer)} - ({start})"
                self.function.misfit_if(f"({room}) % {size}")
                self.function.flush()
        else:
            count = self._count(item, repeat.times)
            first, last = self.take(item, count if size == 1 else f"{size} * {count}")
            if forms.is_slice(of):  # a struct compares the size itself, before it makes anything
                self.function.misfit_if(f"{last.text(self.buffer)} > len({self.buffer})")
                self.function.flush()
        self.function.add(f"{local} = {self._list_text(of, size, first, last, count)}")
        item.scope.entries[repeat.name] = Entry(local, "list", None)
        self.function.names_of_values[repeat.name] = local
        item.fields.add(repeat.name, local)

    def _list_text(self, of: FieldType, size: int, first: Place, last: Place, count: str | None) -> str:
        raw = between(self.buffer, first, last)
        code = forms.struct_code(of)
        if code == ("B", ""):
            return f"list({raw})"
        if code is None or code[0].endswith("s"):
            place = self.function.names.fresh("place")
            one = f"{self.buffer}[{place} : {place} + {size}]"
            start, stop = first.text(self.buffer), last.text(self.buffer)
            return f"[{forms.parse(self.module, of, one)} for {place} in range({start}, {stop}, {size})]"
        if count is None:
            local = self.function.names.fresh("raw")
            self.function.add(f"{local} = {raw}")
            constant = self.module.list_structs("", *code, self.function.title, "values")
            return f"list({constant}[len({local}){f' // {size}' if size > 1 else ''}].unpack({local}))"
        start = first.text(self.buffer)
        behind = "" if start == "0" else f", {first.offset if first.base == 'end' else start}"
        if count.isdigit():
            constant = self.module.struct(f"{count}{code[0]}", code[1])
            return f"list({constant}.unpack_from({self.buffer}{behind}))"
        constant = self.module.list_structs("", *code, self.function.title, "values")
        return f"list({constant}[{count}].unpack_from({self.buffer}{behind}))"

    def _count(self, item: Item, times: int | Expression | str) -> str:
        """Text of how often something is repeated; a name or a number."""
        if isinstance(times, int):
            return str(times)
        assert isinstance(times, Expression)
        text = self.size_text(times, item.scope)
        if text.isidentifier():
            return text
        local = self.function.names.fresh("times")
        self.function.add(f"{local} = {text}")
        return local

    def _records(self, item: Item, repeat: Repeat, after: tuple[Item, ...]) -> None:
        """A list of records."""
        assert isinstance(repeat.of, tuple)
        function = self.function
        inside = Scope(item.scope)
        fields = Fields(function.names.fresh("item"))
        found = function.local(repeat.name, item.scope)
        least = self.shapes.all(repeat.of).least
        end = None
        if repeat.times == "rest":
            end = self._region_limit(after)
            header = f"while {self.at} < {end}:"
        else:
            count = self._count(item, repeat.times)
            header = f"for _ in range({count}):"
            if not count.isdigit():
                place = self.place.text(self.buffer)
                there = f"len({self.buffer}) - {f'({place})' if ' ' in place else place}"
                function.misfit_if(f"{count} * {least} > {there}" if least > 1 else f"{count} > {there}")
        first = self.place
        if repeat.name in function.tracked and first.base not in ("", "end"):
            local = function.names.fresh(f"{repeat.name}_start")
            function.add(f"{local} = {first.text(self.buffer)}")
            first = Place(local, 0)
        function.flush()
        self.settle()
        function.add(f"{found} = []")
        inside.entries[repeat.name] = Entry(found, "list", inside)  # the items before this one
        function.in_branch += 1
        with function.out.block(header):
            begin = None
            if may_be_empty(self.shapes, repeat):
                begin = function.names.fresh("item_start")
                function.add(f"{begin} = {self.at}")
            outside = self.deferred, self.in_item
            self.deferred, self.in_item = [], True
            self.read(repeat.of, inside, fields, ())
            self.deferred, self.in_item = outside
            self.settle()
            if begin is not None:
                function.misfit_if(f"{self.at} == {begin}")
            function.flush()
            function.add(f"{found}.append({fields.text(function.out)})")
        function.in_branch -= 1
        function.stands(repeat, self.buffer, first, self.place)
        for entry in inside.entries.values():
            entry.direct = False
        item.scope.entries[repeat.name] = Entry(found, "list", inside)
        function.names_of_values[repeat.name] = found
        item.fields.add(repeat.name, found)

    def _region_limit(self, after: tuple[Item, ...]) -> str:
        """A local with the place where what follows begins."""
        end = self.region_end(after)
        if end.base != "end":
            return end.base
        local = self.function.names.fresh("region_end")
        self.function.add(f"{local} = {end.text(self.buffer)}")
        return local

    # ---- wraps and inner frames ---------------------------------------------------------------------------

    def _wrap(self, item: Item, wrap: Wrap, after: tuple[Item, ...]) -> None:
        function = self.function
        plain = function.names.fresh(shown_name(wrap, "plain"))
        if function.in_branch and any(leaf.name in function.tracked for leaf in leaves(wrap.of)):
            function.regions.append(plain)
        fixed = self.shapes.all(wrap.of).fixed
        if wrap.how == "hex":
            if fixed is not None:
                first, last = self.take(item, str(2 * fixed))
            else:
                first, last = self.take_rest(item, after)
            self.module.imports.add("from binascii import unhexlify")
            function.add(f"{plain} = unhexlify({between(self.buffer, first, last)})")
        else:
            self._undouble(item, wrap, fixed, after, plain)
        inside = Reader(function, plain, function.names.fresh(f"{plain}_at"))
        inside.read(wrap.of, item.scope, item.fields)
        inside.close()
        if wrap.least:
            function.misfit_if(f"len({plain}) < {wrap.least}")
        if wrap.most is not None:
            most = str(wrap.most) if isinstance(wrap.most, int) else function.writer(item.scope).text(wrap.most, BIT_OR)
            function.misfit_if(f"len({plain}) > {most}")

    def _undouble(self, item: Item, wrap: Wrap, fixed: int | None, after: tuple[Item, ...], plain: str) -> None:
        """Puts the content of a region with doubled escape bytes into the local `plain`."""
        name, escape = self.module.function, f"{wrap.escape or 0:#04x}"
        embedded_texts = [bytes_literal(data) for data in self.module.embedded_frames(wrap)]
        embedded = self.module.embedded(wrap)
        if self.knows_behind(after):
            first, last = self.take_rest(item, after)
        else:
            first = self.keep(self.place)
            start = first.text(self.buffer)
            if fixed is not None:
                self.advance(f"{name('end_of_doubled')}({self.buffer}, {start}, {escape}, {fixed})")
            else:
                more = f", {embedded}" if embedded else ""
                self.advance(f"{name('end_of_region')}({self.buffer}, {start}, {escape}{more})")
            last = self.place
            self.function.stands(wrap, self.buffer, first, last)
        self.function.flush()
        self.function.add(f"{plain} = {between(self.buffer, first, last)}")
        single, double = (bytes_literal(bytes((wrap.escape or 0,)) * count) for count in (1, 2))
        with self.function.out.block(f"if {single} in {plain}:"):
            if embedded:
                tests = " or ".join(f"{frame} in {plain}" for frame in embedded_texts)
                with self.function.out.block(f"if {tests}:"):
                    self.function.add(f"{plain} = {name('without_embedded')}({plain}, {escape}, {embedded})")
            self.function.add(f"{plain} = {name('undouble')}({plain}, {single}, {double})")

    def _inner(self, item: Item, inner: Inner, after: tuple[Item, ...]) -> None:
        function = self.function
        local = function.local(inner.name, item.scope)
        choice = self.module.choice(inner.frames, function.title, inner.name)
        fixed = self.shapes.present(inner).fixed
        known = self.knows_behind(after)
        if isinstance(inner.size, Expression):
            first, last = self.take(item, self.size_text(inner.size, item.scope))
        elif fixed is not None and not (known and self.place.base == "end"):
            first, last = self.take(item, str(fixed))
        elif known or inner.size == "rest":
            first, last = self.take_rest(item, after)
        else:
            size = function.names.fresh(f"{inner.name}_size")
            measure, start = self.module.function("measure_first"), self.place.text(self.buffer)
            function.add(f"{size} = {measure}({choice}, {self.buffer}, {start}, len({self.buffer}), ctx)")
            with function.out.block(f"if {size} <= 0:"):
                function.add(MISFIT)
            first, last = self.take(item, size)
        self._first_that_fits(inner, local, choice, between(self.buffer, first, last))
        item.scope.entries[inner.name] = Entry(local, "inner")
        function.names_of_values[inner.name] = local
        item.fields.add(inner.name, local)

    def _first_that_fits(self, inner: Inner, local: str, choice: str, raw: str) -> None:
        """The value of a frame inside: at once where a byte leaves few, which spares a call and a loop."""
        function, decode = self.function, self.module.function("decode_first")
        if not raw.isidentifier():
            region = function.names.fresh(f"{inner.name}_bytes")
            function.add(f"{region} = {raw}")
            raw = region
        one, tree = function.names.fresh("one"), tree_of(self.shapes, in_order(self.shapes, inner.frames))
        at = tree.at if isinstance(tree, Switch) else 0
        anyway = f"{decode}({choice}, {raw}, ctx)"
        with function.out.block("try:"):
            function.add(f"{one} = {choice}.likely[{raw}[{at}]]")
            function.add(f"{local} = {anyway} if {one} is None else {{{one}[0]: {one}[1]({raw}, ctx)}}")
        with function.out.block("except MISFITS:"):
            function.add(f"{local} = {anyway}")


def _same_condition(items: list[Item], start: int) -> int:
    """How many segments from `start` on stand under the same `when`."""
    first, count = items[start], 1
    for item in items[start + 1 :]:
        when = item.segment.when
        if when is None or str(when) != str(first.segment.when) or item.scope is not first.scope:
            break
        count += 1
    return count
