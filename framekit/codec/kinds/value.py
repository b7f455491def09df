"""`value`: a value without bytes."""

from __future__ import annotations

from framekit.codec.kinds.base import SegmentKind
from framekit.codec.python.diagnosis import Behind, DiagnosisWriter
from framekit.codec.python.expressions import Entry, Scope
from framekit.codec.python.measure import MeasureWriter, Pairs
from framekit.codec.python.reader import Item, Reader
from framekit.codec.python.source import quoted
from framekit.definition.model.segments import (
    Value,
)


class ValueKind(SegmentKind[Value]):
    model = Value

    def read(self, r: Reader, item: Item, segment: Value, after: tuple[Item, ...]) -> None:
        r.when_known(segment.read, item.scope, lambda: _work_out(r, item, segment))

    def declare(self, d: DiagnosisWriter, segment: Value, scope: Scope) -> None:
        scope.entries[segment.name] = Entry(f"n[{quoted(segment.name)}]")

    def diagnose(self, d: DiagnosisWriter, segment: Value, scope: Scope, behind: Behind) -> None:
        d.out.add(f"n.value({d.named(segment)}, lambda n: {d.writer(scope).value(segment.read)}{d.refuse(segment)})")

    def measure(self, m: MeasureWriter, segment: Value, scope: Scope, after: Pairs) -> None:
        if segment.name in m.needed:
            m.set_value(segment.name, scope, m.text(segment.read, scope))


def _work_out(r: Reader, item: Item, value: Value) -> None:
    local = r.function.local(value.name, item.scope)
    r.function.add(f"{local} = {r.function.writer(item.scope).value(value.read)}")
    r.declare(item, value.name, local)
