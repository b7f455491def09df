"""Implement `choose` (one of several segment lists) and `optional` (a list that is present if its values are given)."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from framekit.codec.kinds.base import SegmentKind
from framekit.codec.python.diagnosis import Behind, DiagnosisWriter
from framekit.codec.python.encode import Cases, ConsumedValues, EncodeWriter
from framekit.codec.python.encode_plan import Task
from framekit.codec.python.expressions import FieldScope
from framekit.codec.python.function import FunctionWriter, Offset
from framekit.codec.python.measure import Finished, MeasureWriter, Pairs
from framekit.codec.python.reader import BufferReader, ScopedSegment
from framekit.codec.python.registry import summary
from framekit.codec.python.source import literal, quoted
from framekit.definition.expression import AND, BIT_OR
from framekit.definition.model.frames import flat, nearest_path
from framekit.definition.model.segments import Choose, Field, Optional, Segments


class ChooseKind(SegmentKind[Choose]):
    model = Choose

    def read(self, r: BufferReader, item: ScopedSegment, segment: Choose, after: tuple[ScopedSegment, ...]) -> None:
        function = r.function
        on = function.writer(item.scope).text(segment.on, BIT_OR)
        if not on.isidentifier():
            local = function.names.fresh("case")
            function.add(f"{local} = {on}")
            on = local
        branches: list[tuple[str, list[ScopedSegment]]] = []
        for header, segments in _headers(function, segment, on):
            branches.append((header, [ScopedSegment(one, item.scope, item.fields) for one in segments]))
        item.fields.open(function.out)
        if segment.otherwise is not None:
            branches.append(("else:", [ScopedSegment(one, item.scope, item.fields) for one in segment.otherwise]))
        r.prepare_names([inner for _, items in branches for inner in items])
        r.branches_of_choice(branches, after, fault=segment.otherwise is None)

    def tasks(self, w: EncodeWriter, segment: Choose, scope: FieldScope, given: ConsumedValues) -> list[Task]:
        return w.branch_tasks(segment, scope, given)

    def cases(self, w: EncodeWriter, segment: Choose, scope: FieldScope, given: ConsumedValues) -> Cases:
        on = w.text(segment.on, scope, BIT_OR)
        condition = "" if segment.when is None else f"{w.text(segment.when, scope, AND)} and "
        last = "else:" if segment.when is None else f"elif {w.text(segment.when, scope)}:"
        return [*_headers(w, segment, condition + on), (last, segment.otherwise)]

    def diagnose(self, d: DiagnosisWriter, segment: Choose, scope: FieldScope, behind: Behind) -> None:
        text = d.writer(scope).text(segment.on)
        if absent := d.absent(segment):
            d.out.add(absent)
        d.out.add(f'case = n.ask(lambda n: {text}, "value", {d.named(segment)})')
        without_others = d.without_other_cases(segment)
        for header, segments in _headers(d, segment, "case"):
            with d.out.block(header):
                _diagnose_case(d, without_others, segments, scope, behind)
        with d.out.block("else:"):
            if segment.otherwise is not None:
                _diagnose_case(d, without_others, segment.otherwise, scope, behind)
            else:
                d.out.add(
                    f'raise n.stop("value", {d.named(segment)}, "one of the cases", str(case){d.refuse(segment)})'
                )

    def measure(self, m: MeasureWriter, segment: Choose, scope: FieldScope, after: Pairs) -> None:
        case = m.names.fresh("case")
        m.add(f"{case} = {m.text(segment.on, scope)}")
        m.absent((segment,), scope)
        m.settle()
        finished = []
        for header, of in _headers(m, segment, case):
            with m.out.block(header):
                finished.append(m.branch(m.pairs(of, scope), after))
        with m.out.block("else:"):
            if segment.otherwise is None:
                m.add("return LOST")
            else:
                finished.append(m.branch(m.pairs(segment.otherwise, scope), after))
        if all(finished):
            raise Finished

    def describe(self, segment: Choose) -> str:
        shown = "; ".join(f"{', '.join(str(key) for key in keys)}: {summary(of)}" for keys, of in segment.cases)
        return f"by {segment.on} ({shown})"


def _headers(writer: FunctionWriter, choose: Choose, on: str) -> Iterator[tuple[str, Segments]]:
    """Yield the header line and the segments of each case; `on` is the source of the tested value.

    Names of numbers in case keys are replaced by their numbers.
    """
    field = writer.by_path.get(nearest_path(str(choose.on).strip(), choose, writer.by_path))
    names = field.values if isinstance(field, Field) and field.values is not None else {}
    numbers: dict[object, object] = {name: number for number, name in names.items()}
    for place, (keys, segments) in enumerate(choose.cases):
        values = tuple(numbers.get(key, key) if isinstance(key, str) else key for key in keys)
        test = f"{on} == {literal(values[0])}" if len(values) == 1 else f"{on} in {literal(values)}"
        yield f"{'elif' if place else 'if'} {test}:", segments


def _diagnose_case(
    d: DiagnosisWriter, without_others: Callable[[Segments], str], case: Segments, scope: FieldScope, behind: Behind
) -> None:
    if absent := without_others(case):
        d.out.add(absent)
    d.declare(case, scope)  # another case may have a record or list of the same name
    d.list(case, scope, behind, all_is_read=False)


class OptionalKind(SegmentKind[Optional]):
    model = Optional

    def read(self, r: BufferReader, item: ScopedSegment, segment: Optional, after: tuple[ScopedSegment, ...]) -> None:
        end = r.region_end(after)
        items = [ScopedSegment(segment, item.scope, item.fields) for segment in segment.of]
        if end.base == "end":
            name = r.function.names.fresh("region_end")
            r.function.add(f"{name} = {end.text(r.buffer)}")
            end = Offset(name, 0)
        r.prepare_names(items)
        item.fields.open(r.function.out)
        r.settle()
        r.branches_of_choice([(f"if {r.at} < {end.base}:", items)], after, fault=False)

    def tasks(self, w: EncodeWriter, segment: Optional, scope: FieldScope, given: ConsumedValues) -> list[Task]:
        return w.branch_tasks(segment, scope, given)

    def cases(self, w: EncodeWriter, segment: Optional, scope: FieldScope, given: ConsumedValues) -> Cases:
        names = [name for one in flat(segment.of) for name in one.given_names]
        tests = " or ".join(f"{quoted(name)} in {given.text}" for name in names)
        return [(f"if {tests or 'True'}:", segment.of)]

    def diagnose(self, d: DiagnosisWriter, segment: Optional, scope: FieldScope, behind: Behind) -> None:
        if absent := d.absent(segment):
            d.out.add(absent)
        with d.out.block(f"if n.rest({d.behind(behind)}, {d.named(segment)}) > 0:"):
            d.list(segment.of, scope, behind, all_is_read=False)
        if absent := d.without(segment.of):
            with d.out.block("else:"):
                d.out.add(absent)

    def measure(self, m: MeasureWriter, segment: Optional, scope: FieldScope, after: Pairs) -> None:
        m.rest(segment, after)

    def describe(self, segment: Optional) -> str:
        return f"[{summary(segment.of)}]"
