"""Branches in the fast path of decoders: segments under a condition, choices, optional parts."""

from __future__ import annotations

from collections.abc import Iterable

from framekit.codec.python.expressions import Entry, Scope
from framekit.codec.python.function import MISFIT
from framekit.codec.python.places import Place
from framekit.codec.python.reader import Item
from framekit.codec.python.sized import SizedReader
from framekit.codec.python.source import literal
from framekit.definition.expression.emit import AND, BIT_OR
from framekit.definition.expression.syntax import Expression
from framekit.definition.model.segments import (
    Choose,
    Field,
    Optional,
    Record,
    Require,
    Segment,
)
from framekit.definition.model.walk import everything, without_when


class BranchReader(SizedReader):
    """Reads what may be there or not. Everything read in a branch goes into dictionaries that are there before."""

    def read_items(self, items: list[Item], after: tuple[Item, ...]) -> None:
        """Reads the items; `after` is what follows them in the buffer."""
        raise NotImplementedError

    def conditional(self, items: list[Item], after: tuple[Item, ...]) -> None:
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
            if isinstance(item.segment, Record) and item.segment.when is None:
                expanded.extend(self.record_items(item.segment, item.scope, item.fields))
            else:
                expanded.append(item)
        outside, self.deferred = self.deferred, []  # what waits outside is compared behind all branches
        self.read_items(expanded, after)
        self.finish_deferred()
        self.deferred = outside
        for item in items:
            entry = item.scope.entries.get(item.segment.name or "")
            if isinstance(item.segment, Record) and entry is not None and entry.record is not None:
                entry.record.attach()
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
        for name in (segment.name or "", *segment.value_names):
            if name in scope.entries:
                scope.entries[name].wire = self.function.wire_size(segment.name or "")

    def choose(self, item: Item, choose: Choose, after: tuple[Item, ...]) -> None:
        function = self.function
        on = function.writer(item.scope).text(choose.on, BIT_OR)
        if not on.isidentifier():
            local = function.names.fresh("case")
            function.add(f"{local} = {on}")
            on = local
        numbers = numbers_of(choose.on, item.scope, function.by_name)
        branches: list[tuple[str, list[Item]]] = []
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
                for name in segment.value_names:
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
        function.preset((item.segment for _, items in branches for item in items), self.at)
        function.in_branch += 1
        for header, items in branches:
            with function.out.block(header):
                self._branch(items, after, set())
            self.place = Place(self.at, 0)
        function.in_branch -= 1
        if fault:
            with function.out.block("else:"):
                function.add(MISFIT)

    def optional(self, item: Item, optional: Optional, after: tuple[Item, ...]) -> None:
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
