"""A layout included `as` a name: its fields make one value."""

from __future__ import annotations

from framekit.codec.kinds.base import SegmentKind
from framekit.codec.python.diagnosis import Behind, DiagnosisWriter, inside_of
from framekit.codec.python.expressions import Entry, Scope
from framekit.codec.python.source import quoted
from framekit.definition.model.segments import (
    Record,
)


class RecordKind(SegmentKind[Record]):
    model = Record

    def declare(self, d: DiagnosisWriter, segment: Record, scope: Scope) -> None:
        inside = Scope(scope)
        d.declare(segment.of, inside)
        scope.entries[segment.name] = Entry(f"n[{quoted(segment.name)}]", "record", inside)

    def diagnose(self, d: DiagnosisWriter, segment: Record, scope: Scope, behind: Behind) -> None:
        with d.out.block(f"with n.record({quoted(segment.name)}):"):
            d.list(segment.of, inside_of(scope, segment.name), behind)
