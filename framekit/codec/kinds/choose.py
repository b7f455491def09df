"""`choose`: one of several lists of segments."""

from __future__ import annotations

from framekit.codec.kinds.base import SegmentKind
from framekit.codec.python.branches import numbers_of
from framekit.codec.python.diagnosis import Behind, DiagnosisWriter
from framekit.codec.python.expressions import Scope
from framekit.codec.python.measure import Finished, MeasureWriter, Pairs
from framekit.codec.python.source import literal
from framekit.definition.model.segments import (
    Choose,
    Segments,
)


class ChooseKind(SegmentKind[Choose]):
    model = Choose

    def diagnose(self, d: DiagnosisWriter, segment: Choose, scope: Scope, behind: Behind) -> None:
        numbers = numbers_of(segment.on, scope, d.by_name)
        text = d.writer(scope).text(segment.on)
        if absent := d.absent(segment):
            d.out.add(absent)
        d.out.add(f'case = n.ask(lambda n: {text}, "value", {d.named(segment)})')
        for place, (keys, segments) in enumerate(segment.cases):
            values = tuple(numbers.get(key, key) if isinstance(key, str) else key for key in keys)
            test = f"case == {literal(values[0])}" if len(values) == 1 else f"case in {literal(values)}"
            with d.out.block(f"{'elif' if place else 'if'} {test}:"):
                _diagnose_case(d, segment, segments, scope, behind)
        with d.out.block("else:"):
            if segment.otherwise is not None:
                _diagnose_case(d, segment, segment.otherwise, scope, behind)
            else:
                d.out.add(
                    f'raise n.stop("value", {d.named(segment)}, "one of the cases", str(case){d.refuse(segment)})'
                )

    def measure(self, m: MeasureWriter, segment: Choose, scope: Scope, after: Pairs) -> None:
        numbers = numbers_of(segment.on, scope, m.by_name)
        case = m.names.fresh("case")
        m.add(f"{case} = {m.text(segment.on, scope)}")
        m.absent((segment,), scope)
        m.settle()
        finished = []
        for place, (keys, of) in enumerate(segment.cases):
            values = tuple(numbers.get(key, key) if isinstance(key, str) else key for key in keys)
            test = f"{case} == {literal(values[0])}" if len(values) == 1 else f"{case} in {literal(values)}"
            with m.out.block(f"{'elif' if place else 'if'} {test}:"):
                finished.append(m.branch(m.pairs(of, scope), after))
        with m.out.block("else:"):
            if segment.otherwise is None:
                m.add("return LOST")
            else:
                finished.append(m.branch(m.pairs(segment.otherwise, scope), after))
        if all(finished):
            raise Finished


def _diagnose_case(d: DiagnosisWriter, segment: Choose, case: Segments, scope: Scope, behind: Behind) -> None:
    if absent := d.without((segment,), case):
        d.out.add(absent)
    d.list(case, scope, behind)
