"""`diagnose_…` of a frame: a careful function made of calls, one a segment, that finds the first fault and all places.

`runtime_diagnosis` has the called methods; this module writes the calls in the order of the segments. The kinds of
segments write their own calls.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

from framekit.codec.python import forms
from framekit.codec.python.expressions import FieldScope, default_text, entries_read
from framekit.codec.python.facts import names_asked_for, parts_around
from framekit.codec.python.function import (
    FunctionWriter,
    covered_paths,
    paths_of,
    paths_read,
    standing_any_way,
    wire_paths,
)
from framekit.codec.python.module import Module
from framekit.codec.python.registry import kind_of, write_docstring
from framekit.codec.python.source import MOST_NAMES, Source, bytes_literal, literal, quoted
from framekit.definition.expression import BIT_OR, PRODUCT, Expression
from framekit.definition.model.frames import Frame, everything, flat, without_when
from framekit.definition.model.segments import Check, Const, Count, Field, FieldType, Length, Segment

Behind = tuple[tuple[Segment, FieldScope], ...]
"""The segments that follow a segment in its buffer, each with the scope of its names."""


def write_diagnosis(
    module: Module, identifier: str, name: str, segments: tuple[Segment, ...], frame: Frame | None
) -> Source:
    """Return the source of `diagnose_…` of a frame or a layout."""
    writer = DiagnosisWriter(module, segments)
    body = Source()
    surplus = frame.surplus if frame is not None else None
    options = ("" if surplus is None else f", surplus={surplus:#x}") + checks_option(segments)
    with body.block(f"with n.part({options.removeprefix(', ')}):"):
        writer.out = body
        writer.region(segments, FieldScope(), frame)
        for line in writer.late_checks:
            writer.out.add(line)
    out = Source()
    with out.block(f"def diagnose_{identifier}(data: bytes, ctx: Context) -> Diagnosis:"):
        write_docstring(out, f"Read `{name}` carefully: all spans, and the first fault.", "")
        writer.write_hoisted(out)
        out.add(f"n = {module.function('Diagnosis')}(data, ctx)")
        if frame is not None and frame.most is not None:
            with out.block(f"if len(data) > {frame.most}:"):
                most = quoted(f"at most {frame.most} bytes")
                out.add(f'n.note("too_long", "frame", {frame.most}, {most}, str(len(data)))')
        out.extend(body)
        out.add("return n")
    return out


def checks_option(segments: tuple[Segment, ...]) -> str:
    """Return the argument that marks a part with check codes; empty for none."""
    there = any(isinstance(segment, Check) and segment.verify == "error" for segment in everything(segments))
    return ", checks=True" if there else ""


@dataclass(frozen=True, slots=True)
class DeferredCall:
    """A call that needs later segments: those of these paths, and their values."""

    line: str
    paths: frozenset[str]


class DiagnosisWriter(FunctionWriter):
    """Write the calls of a careful function."""

    def __init__(self, module: Module, segments: tuple[Segment, ...]) -> None:
        super().__init__(module, segments)
        self.deferred: list[DeferredCall] = []
        self.passed: set[str] = set()
        """The paths of the segments whose calls have been written, and of their values."""
        self.in_item = False
        """Whether a list item is read, which is followed by the next item instead of the end of the buffer."""
        self.late_checks: list[str] = []
        self.read_entries: set[int] = set()
        self.asked_by_name = names_asked_for(segments)
        self.asked_for = self._asked_for()

    def _asked_for(self) -> set[str]:
        """Return the paths of segments that a check or a length refers to."""
        found: set[str] = set()
        for segment in everything(self.segments):
            if isinstance(segment, Check):
                found.update(covered_paths(segment, self.segments))
            elif isinstance(segment, Length):
                found.update(segment.counted, wire_paths(self.segments, segment.counted))
        return found

    # ---- texts --------------------------------------------------------------------------------------------

    def ask(self, what: int | Expression | str, scope: FieldScope, factor: str = "") -> str:
        """Return a number, or a function of `n` that computes it; None for `rest`."""
        if what == "rest":
            return "None"
        if isinstance(what, int):
            return str(what * 2 if factor == " * 2" else what // 2 if factor else what)
        assert isinstance(what, Expression)
        return f"lambda n: {self.writer(scope).text(what, PRODUCT if factor else 0)}{factor}"

    def behind(self, after: Behind) -> str:
        """Return source of the number of bytes after a segment of open end; a `lambda` if some may be absent."""
        after = tuple(self._in_place_of_records(after))
        if not self.knows_behind(after):
            return self._constant_behind(after[0][0])
        fixed, parts = self.sizes_of(after, BIT_OR)
        if not parts:
            return str(fixed)
        return "lambda n: " + " + ".join([*([str(fixed)] if fixed else []), *parts])

    def knows_behind(self, after: Behind) -> bool:
        """Return whether the size of the following bytes is already known."""
        return not self.in_item and all(
            self.static.present(segment).fixed is not None and self._is_told(segment, scope)
            for segment, scope in self._in_place_of_records(after)
        )

    def _is_told(self, segment: Segment, scope: FieldScope) -> bool:
        """Return whether the names that the segment's condition reads have been read already."""
        when = segment.when
        entries = () if when is None else entries_read(when.root, scope, self.field_names)
        return all(id(entry) in self.read_entries for entry in entries)

    def _in_place_of_records(self, after: Behind) -> Iterator[tuple[Segment, FieldScope]]:
        """Yield the segments with those of unconditional records inlined."""
        for segment, scope in after:
            if segment.is_record and segment.when is None:
                inside = inside_of(scope, segment.value_names[0])
                yield from self._in_place_of_records(tuple((one, inside) for one in segment.members))
            else:
                yield segment, scope

    def _constant_behind(self, segment: Segment) -> str:
        data = segment.data if isinstance(segment, Const) else b""
        return f"lambda n: n.end - n.data.index({bytes_literal(data)}, n.at, n.end)"

    def named(self, segment: Segment) -> str:
        """Return the name of a segment in the careful functions: its kind if it has no name and no reference."""
        name = segment.name or ""
        if name and (not name.startswith("_") or segment.path in self.asked_for):
            return quoted(name)
        return quoted(type(segment).__name__.lower())

    @staticmethod
    def refuse(segment: Segment) -> str:
        return "" if segment.refuse is None else f", refuse={segment.refuse:#x}"

    # ---- names --------------------------------------------------------------------------------------------

    def parse(self, type_: FieldType, number: Field | Length | Count | None = None) -> str:
        """Return a function from the encoded bytes to the value."""
        wire = forms.parse(self.module, type_, "raw")
        if number is None or not forms.changes_value(number):
            return f"lambda raw: {wire}"
        if number.zero_means is not None and not (isinstance(number, Field) and (number.plus or number.unit)):
            return f"lambda raw: {wire} or {number.zero_means}"
        text = forms.value_of(number, wire)
        if number.zero_means is not None:
            text = forms.value_of(number, "wire")
            return f"lambda raw: (lambda wire: {text})({wire})"
        return f"lambda raw: {text}"

    def region(
        self, segments: tuple[Segment, ...], scope: FieldScope, frame: Frame | None = None, *, all_is_read: bool = True
    ) -> None:
        """Write the calls of a whole buffer. Segments after its last variable part are read from the end."""
        self.declare(segments, scope)
        if frame is not None and frame.delimited and frame.tail and isinstance(frame.tail[0], Const):
            self._delimited(frame, scope, frame.tail[0].data[0])
        else:
            front, middle, tail = parts_around(self.static, segments)
            behind = tuple((segment, scope) for segment in tail)
            self.list(front, scope, (), finish=False)
            if middle:
                with self.out.block(f"with n.attempt({self.behind(behind)}{checks_option(middle)}):"):
                    self.list(middle, scope, behind, finish=False)
            self.list(tail, scope, (), finish=False)
        self.finish(all_is_read=all_is_read)

    def _delimited(self, frame: Frame, scope: FieldScope, mark: int) -> None:
        """Write the calls of a frame whose body ends where its tail begins."""
        surplus = "" if frame.surplus is None else f", surplus={frame.surplus:#x}"
        behind = tuple((segment, scope) for segment in (*frame.body, *frame.tail))
        self.list(frame.head, scope, behind, finish=False)
        with self.out.block(f"with n.part(n.until_tail({mark:#04x}){surplus}{checks_option(frame.body)}):"):
            self.list(frame.body, scope, (), finish=False)
        self.list(frame.tail, scope, (), finish=False)

    def list(
        self,
        segments: Iterable[Segment],
        scope: FieldScope,
        after: Behind,
        finish: bool = True,
        all_is_read: bool = True,
    ) -> None:
        """Write the calls of a list of segments; `after`: the segments that follow it in the buffer.

        `finish`: write the deferred comparisons that are possible at its end; `all_is_read`: write all of them, as the
        record is complete.
        """
        pairs = tuple((segment, scope) for segment in segments)
        outside = self.deferred
        if finish:
            self.deferred = []
        for place, (segment, _) in enumerate(pairs):
            behind = (*pairs[place + 1 :], *after)
            if segment.when is not None:
                self._conditional(segment, scope, behind)
            else:
                self._segment(segment, scope, behind)
            self.read_entries.update(id(scope.entries[name]) for name in segment.value_names)
            self.passed.update(path for one in everything((segment,)) for path in paths_of(one))
        if finish:
            self.finish(all_is_read=all_is_read)
            self.deferred = outside + self.deferred

    def later(self, line: str, segment: Segment, *needed: str | Expression) -> None:
        """Defer a call of a segment until the named siblings, and the names its expressions read, have been read."""
        self.deferred.append(DeferredCall(line, paths_read(segment, self.all_paths, *needed)))

    def finish(self, *, all_is_read: bool) -> None:
        """Write the comparisons whose segments have been read; with `all_is_read` all comparisons."""
        deferred, self.deferred = self.deferred, []
        for one in deferred:
            if all_is_read or one.paths <= self.passed:
                self.out.add(one.line)
            else:
                self.deferred.append(one)

    def _conditional(self, segment: Segment, scope: FieldScope, behind: Behind) -> None:
        assert segment.when is not None
        condition = f'n.ask(lambda n: {self.writer(scope).text(segment.when)}, "value", {self.named(segment)})'
        with self.out.block(f"if {condition}:"):
            self._segment(without_when(segment), scope, behind)
        if isinstance(segment, Field) and segment.default is not None:
            default = default_text(self.writer(scope).value(segment.default), segment)
            with self.out.block("else:"):
                self.out.add(f"n.absent({quoted(segment.name)}, lambda n: {default})")
            return
        absent = [line for line in (self.absent(segment), self.without((segment,))) if line]
        if absent:
            with self.out.block("else:"):
                for line in absent:
                    self.out.add(line)

    def without(self, segments: Iterable[Segment]) -> str:
        """Return the call that marks the names of absent segments as absent, if an expression reads any."""
        names, records = self._asked_names(segments)
        return _without(literal(tuple(sorted(names))), literal(tuple(sorted(records)))) if names or records else ""

    def without_other_cases(self, segment: Segment) -> Callable[[Iterable[Segment]], str]:
        """Return the function from a case to the call that marks the names of the other cases as absent.

        Above `MOST_NAMES` names a local holds those of all cases, so that the source grows with their number only.
        """
        names, records = self._asked_names((segment,))
        local = ""
        if len(names) + len(records) > MOST_NAMES:
            local = self.names.fresh("case_names")
            self.out.add(f"{local} = set({literal(sorted(names))}), {literal(tuple(sorted(records)))}")

        def call(case: Iterable[Segment]) -> str:
            own = {name for one in flat(case) for name in one.value_names if name in self.asked_by_name}
            if local:
                some = literal(tuple(sorted(own)))
                others = f'tuple(path for path in {local}[1] if path.partition(".")[0] not in {some})'
                return _without(f"{local}[0].difference({some})", others if records else "()")
            paths = {path for path in records if path.partition(".")[0] not in own}
            if not names - own and not paths:
                return ""
            return _without(literal(tuple(sorted(names - own))), literal(tuple(sorted(paths))))

        return call

    def _asked_names(self, segments: Iterable[Segment]) -> tuple[set[str], set[str]]:
        """Return the names of these segments that expressions read, and the paths of the records among them."""
        wanted = [one for one in flat(segments) if not self.asked_by_name.isdisjoint(one.value_names)]
        records = {path for one in wanted for path in _records_in(one)}
        names = {name for one in wanted for name in one.value_names if name in self.asked_by_name}
        return names - records, records

    def absent(self, segment: Segment) -> str:
        """Return the call that marks a segment as absent for the checks that cover it."""
        paths = [one.path for one in standing_any_way((segment,)) if one.path in self.asked_for]
        return f"n.nothing({', '.join(map(quoted, paths))})" if paths else ""

    # ---- segments with others inside ----------------------------------------------------------------------

    def declare(self, segments: Iterable[Segment], scope: FieldScope) -> None:
        """Declare the fields of a list, which are read as `n["name"]`."""
        for segment in segments:
            for block in segment.blocks:
                self.declare(block, scope)
            kind_of(segment).declare(self, segment, scope)

    def _segment(self, segment: Segment, scope: FieldScope, behind: Behind) -> None:
        """Write the calls of a present segment."""
        kind_of(segment).diagnose(self, segment, scope, behind)

    def behind_option(self, needed: bool, behind: Behind) -> str:
        text = self.behind(behind) if needed else "0"
        return "" if text == "0" else f", behind={text}"


def inside_of(scope: FieldScope, name: str) -> FieldScope:
    """Return the names inside a record or a list."""
    entry = scope.find(name)
    assert entry is not None and entry.inside is not None
    return entry.inside


def _without(names: str, records: str) -> str:
    """Return the call that marks names and records as absent; the arguments are source of tuples."""
    return f"n.without({names})" if records == "()" else f"n.without({names}, {records})"


def _records_in(segment: Segment) -> Iterator[str]:
    """Yield the name of a record, and those of its inner records as `outer.inner`; no name for any other segment."""
    if segment.is_record and segment.name is not None:
        yield segment.name
        for inside in flat(segment.members):
            yield from (f"{segment.name}.{path}" for path in _records_in(inside))
