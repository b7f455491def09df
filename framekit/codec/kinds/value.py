"""`value`: a value without bytes."""

from __future__ import annotations

from framekit.codec.kinds.base import SegmentKind
from framekit.codec.python.diagnosis import Behind, DiagnosisWriter
from framekit.codec.python.expressions import Entry, Scope
from framekit.codec.python.measure import MeasureWriter, Pairs
from framekit.codec.python.source import quoted
from framekit.definition.model.segments import (
    Value,
)


class ValueKind(SegmentKind[Value]):
    model = Value

    def declare(self, d: DiagnosisWriter, segment: Value, scope: Scope) -> None:
        scope.entries[segment.name] = Entry(f"n[{quoted(segment.name)}]")

    def diagnose(self, d: DiagnosisWriter, segment: Value, scope: Scope, behind: Behind) -> None:
        d.out.add(f"n.value({d.named(segment)}, lambda n: {d.writer(scope).value(segment.read)}{d.refuse(segment)})")

    def measure(self, m: MeasureWriter, segment: Value, scope: Scope, after: Pairs) -> None:
        if segment.name in m.needed:
            m.set_value(segment.name, scope, m.text(segment.read, scope))
