"""`require`: a condition that must hold."""

from __future__ import annotations

from framekit.codec.kinds.base import SegmentKind
from framekit.codec.python.diagnosis import Behind, DiagnosisWriter
from framekit.codec.python.expressions import Scope
from framekit.codec.python.reader import Item, Reader
from framekit.codec.python.source import quoted
from framekit.definition.model.segments import (
    Require,
)


class RequireKind(SegmentKind[Require]):
    model = Require

    def read(self, r: Reader, item: Item, segment: Require, after: tuple[Item, ...]) -> None:
        def refuse() -> None:
            r.function.misfit_if(r.function.writer(item.scope).negated(segment.condition))

        r.when_known(segment.condition, item.scope, refuse)

    def diagnose(self, d: DiagnosisWriter, segment: Require, scope: Scope, behind: Behind) -> None:
        text = d.writer(scope).text(segment.condition)
        d.out.add(f"n.require({quoted(segment.condition.text)}, lambda n: {text}{d.refuse(segment)})")
