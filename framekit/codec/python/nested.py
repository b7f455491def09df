"""Segments with others inside, in the fast path of decoders: conditions, choices, repeats, wraps, inner frames."""

from __future__ import annotations

from collections.abc import Iterable

from framekit.codec.python import forms
from framekit.codec.python.expressions import Entry, Scope
from framekit.codec.python.function import MISFIT
from framekit.codec.python.places import Fields, Place, between
from framekit.codec.python.reader import Item, without_end
from framekit.codec.python.runs import shown_name
from framekit.codec.python.shape import everything, value_names, without_when
from framekit.codec.python.sized import SizedReader
from framekit.codec.python.source import literal
from framekit.definition.expression.emit import AND, BIT_OR, PRODUCT
from framekit.definition.expression.syntax import Expression
from framekit.definition.model.segments import (
    Choose,
    Field,
    FieldType,
    Inner,
    Optional,
    Record,
    Repeat,
    Require,
    Segment,
    Wrap,
)


class Reader(SizedReader):
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
                self._conditional(items[place : place + count], (*items[place + count :], *after))
            elif (run := self.length_of_run(items[place:])) > 0:
                count = run
                self.read_run(items[place : place + count], whole=count == len(items) and not after)
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
                self._choose(item, choose, after)
            case Optional() as optional:
                self._optional(item, optional, after)
            case Wrap() as wrap:
                self._wrap(item, wrap, after)
            case Inner() as inner:
                self._inner(item, inner, after)
            case _:
                raise TypeError(f"no segment to read: {item.segment!r}")

    # ---- branches -----------------------------------------------------------------------------------------

    def _conditional(self, items: list[Item], after: tuple[Item, ...]) -> None:
        """Segments under one `when`; a field that is absent has its default."""
        first = items[0]
        assert first.segment.when is not None
        condition = self.function.writer(first.scope).text(first.segment.when)
        inside = [Item(without_when(item.segment), item.scope, item.fields) for item in items]
        if all(isinstance(item.segment, Require) for item in inside):
            text = self.function.writer(first.scope).text(first.segment.when, AND)
            for item in inside:
                assert isinstance(item.segment, Require)
                holds = self.function.writer(item.scope).negated(item.segment.condition)
                self.function.misfit_if(f"{text} and {holds}")
            return
        self._branches([(f"if {condition}:", inside)], after, items)

    def _branches(
        self, branches: list[tuple[str, list[Item]]], after: tuple[Item, ...], absent: Iterable[Item]
    ) -> None:
        """Code for cases of which one or none is taken. `absent`: what gets its default if none is."""
        function = self.function
        for _, items in branches:
            for item in items:
                item.fields.attach()
                item.fields.open(function.out)
        function.flush()
        self.settle()
        known = [(item.scope, set(item.scope.entries)) for _, items in branches for item in items]
        defaults = [item for item in absent if isinstance(item.segment, Field) and item.segment.default is not None]
        function.in_branch += 1
        for header, items in branches:
            with function.out.block(header):
                self._branch(items, after, {item.segment.name for item in defaults})
            self.place = Place(self.at, 0)
        lines = self._else_lines(known, defaults, [item for _, items in branches for item in items])
        function.in_branch -= 1
        if lines:
            with function.out.block("else:"):
                for line in lines:
                    function.add(line)
        for item in defaults:
            assert item.segment.name is not None
            item.fields.add(item.segment.name, item.scope.entries[item.segment.name].text)

    def _branch(self, items: list[Item], after: tuple[Item, ...], unconditional: set[str | None]) -> None:
        expanded: list[Item] = []
        for item in items:
            if isinstance(item.segment, Record):
                expanded.extend(self.record_items(item.segment, item.scope, item.fields))
            else:
                expanded.append(item)
        self.read_items(expanded, after)
        self.finish_deferred()
        for item in items:
            entry = item.scope.entries.get(item.segment.name or "")
            if isinstance(item.segment, Record) and entry is not None and entry.record is not None:
                entry.record.open(self.function.out)
                entry.direct = False
        for item in expanded:
            item.fields.entries = [entry for entry in item.fields.entries if entry[0] not in unconditional]
        self.function.flush()
        for item in expanded:
            item.fields.flush(self.function.out)
        for item in items:
            item.fields.flush(self.function.out)
        if self.place != Place(self.at, 0):
            self.advance(self.place.text(self.buffer))

    def _else_lines(self, known: list[tuple[Scope, set[str]]], defaults: list[Item], items: list[Item]) -> list[str]:
        """What has to be so when nothing was read: defaults, and names that expressions may ask for."""
        function = self.function
        lines, done = [], {item.segment.name for item in defaults}
        for item in defaults:
            assert isinstance(item.segment, Field) and item.segment.default is not None
            local = item.scope.entries[item.segment.name].text
            lines.append(
                f"{local} = {default_text(function.writer(item.scope).value(item.segment.default), item.segment)}"
            )
        for scope, before in known:
            for name, entry in scope.entries.items():
                if name not in before and name not in done and name in function.read_names:
                    done.add(name)
                    lines.append(f"{entry.text} = None")
        for item in items:
            for segment in everything((item.segment,)):
                bounds = function.bounds.get(segment.name or "")
                if segment.name in function.tracked and bounds is not None:
                    lines.append(f"{bounds.first.base} = {bounds.last.base} = {self.at}")
                    self._wire_by_bounds(item.scope, segment)
        return lines

    def _wire_by_bounds(self, scope: Scope, segment: Segment) -> None:
        for name in (segment.name or "", *value_names(segment)):
            if name in scope.entries:
                scope.entries[name].wire = self.function.wire_size(segment.name or "")

    def _choose(self, item: Item, choose: Choose, after: tuple[Item, ...]) -> None:
        function = self.function
        on = function.writer(item.scope).text(choose.on, BIT_OR)
        if not on.isidentifier():
            local = function.names.fresh("case")
            function.add(f"{local} = {on}")
            on = local
        numbers = numbers_of(choose.on, item.scope, function.by_name)
        branches = []
        for keys, segments in choose.cases:
            values = tuple(numbers.get(key, key) if isinstance(key, str) else key for key in keys)
            test = f"{on} == {literal(values[0])}" if len(values) == 1 else f"{on} in {literal(values)}"
            items = [Item(segment, item.scope, item.fields) for segment in segments]
            branches.append((f"{'elif' if branches else 'if'} {test}:", items))
        item.fields.open(function.out)
        if choose.otherwise is not None:
            branches.append(("else:", [Item(segment, item.scope, item.fields) for segment in choose.otherwise]))
        self._prepare_names([inner for _, items in branches for inner in items])
        self._branches_of_choice(branches, after, fault=choose.otherwise is None)

    def _prepare_names(self, items: list[Item]) -> None:
        """Names of cases that expressions elsewhere may read have a local before any case is taken."""
        function = self.function
        for item in items:
            for segment in (item.segment,):
                for name in value_names(segment):
                    if name in function.read_names and name not in item.scope.entries:
                        local = function.names.fresh(name)
                        function.add(f"{local} = None")
                        item.scope.entries[name] = Entry(local)

    def _branches_of_choice(
        self, branches: list[tuple[str, list[Item]]], after: tuple[Item, ...], *, fault: bool
    ) -> None:
        function = self.function
        function.flush()
        self.settle()
        function.in_branch += 1
        for header, items in branches:
            with function.out.block(header):
                expanded = [one for item in items for one in self.items((item.segment,), item.scope, item.fields)]
                self._branch(expanded, after, set())
            self.place = Place(self.at, 0)
        function.in_branch -= 1
        if fault:
            with function.out.block("else:"):
                function.add(MISFIT)

    def _optional(self, item: Item, optional: Optional, after: tuple[Item, ...]) -> None:
        end = self.region_end(after)
        items = [Item(segment, item.scope, item.fields) for segment in optional.of]
        if end.base == "end":
            name = self.function.names.fresh("region_end")
            self.function.add(f"{name} = {end.text(self.buffer)}")
            end = Place(name, 0)
        self._prepare_names(items)
        item.fields.open(self.function.out)
        self.settle()
        self._branches_of_choice([(f"if {self.at} < {end.base}:", items)], after, fault=False)

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
        else:
            count = self._count(item, repeat.times)
            first, last = self.take(item, count if size == 1 else f"{size} * {count}")
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
        order = code[1] or ">"
        if count is None:
            constant = self.module.struct(code[0], code[1])
            return f"[value for (value,) in {constant}.iter_unpack({raw})]"
        if count.isdigit():
            constant = self.module.struct(f"{count}{code[0]}", code[1])
            return f"list({constant}.unpack({raw}))"
        self.module.imports.add("import struct")
        return f'list(struct.unpack(f"{order}{{{count}}}{code[0]}", {raw}))'

    def _count(self, item: Item, times: int | Expression | str) -> str:
        """Text of how often something is repeated; a name or a number."""
        if isinstance(times, int):
            return str(times)
        assert isinstance(times, Expression)
        text = self.size_text(times, item.scope, PRODUCT + 1)
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
                there = f"len({self.buffer}) - {self.place.text(self.buffer)}"
                function.misfit_if(f"{count} * {least} > {there}" if least > 1 else f"{count} > {there}")
        first = self.keep(self.place) if repeat.name in function.tracked else self.place
        function.flush()
        self.settle()
        function.add(f"{found} = []")
        function.in_branch += 1
        with function.out.block(header):
            begin = None
            if end is not None and least == 0:
                begin = function.names.fresh("item_start")
                function.add(f"{begin} = {self.at}")
            self.read(repeat.of, inside, fields, ())
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
        fixed = self.shapes.all(wrap.of).fixed
        if wrap.how == "hex":
            if fixed is not None:
                first, last = self.take(item, str(2 * fixed))
            else:
                first, last = self.take_rest(item, after)
            self.module.imports.add("from binascii import unhexlify")
            function.add(f"{plain} = unhexlify({between(self.buffer, first, last)})")
        else:
            function.add(f"{plain} = {self._undoubled(item, wrap, fixed, after)}")
        inside = Reader(function, plain, function.names.fresh(f"{plain}_at"))
        inside.read(wrap.of, item.scope, item.fields)
        inside.close()
        if wrap.least:
            function.misfit_if(f"len({plain}) < {wrap.least}")
        if wrap.most is not None:
            most = str(wrap.most) if isinstance(wrap.most, int) else function.writer(item.scope).text(wrap.most, BIT_OR)
            function.misfit_if(f"len({plain}) > {most}")

    def _undoubled(self, item: Item, wrap: Wrap, fixed: int | None, after: tuple[Item, ...]) -> str:
        """Text of the content of a region with doubled escape bytes."""
        name, escape = self.module.function, f"{wrap.escape or 0:#04x}"
        if all(self.shapes.present(other.segment).fixed is not None for other in after):
            first, last = self.take_rest(item, after)
        else:
            first = self.keep(self.place)
            start = first.text(self.buffer)
            if fixed is not None:
                self.advance(f"{name('end_of_doubled')}({self.buffer}, {start}, {escape}, {fixed})")
            else:
                self.advance(f"{name('end_of_region')}({self.buffer}, {start}, {escape})")
            last = self.place
            self.function.stands(wrap, self.buffer, first, last)
        return f"{name('undouble_escape')}({between(self.buffer, first, last)}, {escape})"

    def _inner(self, item: Item, inner: Inner, after: tuple[Item, ...]) -> None:
        function = self.function
        local = function.local(inner.name, item.scope)
        choice = self.module.choice(inner.frames, function.title, inner.name)
        fixed = self.shapes.present(inner).fixed
        known = all(self.shapes.present(other.segment).fixed is not None for other in after)
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
        decode = self.module.function("decode_first")
        function.add(f"{local} = {decode}({choice}, {between(self.buffer, first, last)}, ctx)")
        item.scope.entries[inner.name] = Entry(local, "inner")
        function.names_of_values[inner.name] = local
        item.fields.add(inner.name, local)


def _same_condition(items: list[Item], start: int) -> int:
    """How many segments from `start` on stand under the same `when`."""
    first, count = items[start], 1
    for item in items[start + 1 :]:
        when = item.segment.when
        if when is None or str(when) != str(first.segment.when) or item.scope is not first.scope:
            break
        count += 1
    return count


def default_text(text: str, field: Field) -> str:
    """A default given by a name of `values` is its number."""
    if field.values is not None:
        for number, name in field.values.items():
            if text == literal(name):
                return str(number)
    return text


def numbers_of(on: Expression, scope: Scope, by_name: dict[str, Segment]) -> dict[str, int]:
    """The numbers behind names in the cases of a choice on a field with `values`."""
    segment = by_name.get(str(on).strip())
    if isinstance(segment, Field) and segment.values is not None:
        return {name: number for number, name in segment.values.items()}
    return {}
