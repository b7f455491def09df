"""`repeat`: a list, of records or of plain values."""

from __future__ import annotations

from framekit.codec.kinds.base import SegmentKind
from framekit.codec.python.diagnosis import Behind, DiagnosisWriter, inside_of
from framekit.codec.python.expressions import Entry, Scope
from framekit.codec.python.source import quoted
from framekit.definition.model.segments import (
    FieldType,
    Repeat,
)


class RepeatKind(SegmentKind[Repeat]):
    model = Repeat

    def declare(self, d: DiagnosisWriter, segment: Repeat, scope: Scope) -> None:
        inside = Scope(scope)
        d.declare(segment.inner_record or (), inside)
        scope.entries[segment.name] = Entry(f"n[{quoted(segment.name)}]", "list", inside)

    def diagnose(self, d: DiagnosisWriter, segment: Repeat, scope: Scope, behind: Behind) -> None:
        name, times = quoted(segment.name), d.ask(segment.times, scope)
        option = d.behind_option(segment.times == "rest", behind)
        if isinstance(segment.of, FieldType):
            parse = d.parse(segment.of)
            d.out.add(f"n.values({name}, {times}, {segment.of.fixed_size}, {parse}{d.refuse(segment)}{option})")
            return
        with d.out.block(f"for _ in n.items({name}, {times}{option}):"):
            d.list(segment.of, inside_of(scope, segment.name), ())
