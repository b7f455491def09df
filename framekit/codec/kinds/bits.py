"""`bits`: a number cut into named bits."""

from __future__ import annotations

from framekit.codec.kinds.base import SegmentKind
from framekit.codec.python.diagnosis import Behind, DiagnosisWriter
from framekit.codec.python.expressions import Entry, Scope, constant_of
from framekit.codec.python.measure import MeasureWriter, Pairs
from framekit.codec.python.source import literal, quoted
from framekit.definition.model.segments import (
    Bits,
)


class BitsKind(SegmentKind[Bits]):
    model = Bits

    def declare(self, d: DiagnosisWriter, segment: Bits, scope: Scope) -> None:
        for part in segment.parts:
            scope.entries[part.name] = Entry(f"n[{quoted(part.name)}]")
        if segment.name:
            scope.entries[segment.name] = Entry("0", sized=False, wire=f"n.room({quoted(segment.name)})")

    def diagnose(self, d: DiagnosisWriter, segment: Bits, scope: Scope, behind: Behind) -> None:
        parts = {part.name: (part.low, (1 << part.high - part.low + 1) - 1) for part in segment.parts}
        among: dict[str, tuple[tuple[int, ...], str]] = {}
        for part in segment.parts:
            if part.constants is not None:
                among[part.name] = part.constants, "where"
            elif part.is_ is not None and (number := constant_of(part.is_)) is not None:
                among[part.name] = (number,), "value"
            if part.is_ is not None and part.name not in among:
                wanted = d.writer(scope).value(part.is_)
                d.deferred.append(f'n.same("value", {quoted(part.name)}, lambda n: {wanted}{d.refuse(segment)})')
        rules = f", among={literal(among)}" if among else ""
        size = d.ask(segment.type.size if segment.type.size is not None else 0, scope)
        d.out.add(
            f"n.bits({d.named(segment)}, {size}, {d.parse(segment.type)}, {literal(parts)}{d.refuse(segment)}{rules})"
        )

    def measure(self, m: MeasureWriter, segment: Bits, scope: Scope, after: Pairs) -> None:
        m.number(segment, scope, after)
