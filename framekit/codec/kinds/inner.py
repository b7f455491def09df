"""`inner`: a frame inside a frame."""

from __future__ import annotations

from framekit.codec.kinds.base import SegmentKind
from framekit.codec.python.diagnosis import Behind, DiagnosisWriter
from framekit.codec.python.expressions import Entry, Scope
from framekit.codec.python.source import quoted
from framekit.definition.expression.syntax import Expression
from framekit.definition.model.segments import (
    Inner,
)


class InnerKind(SegmentKind[Inner]):
    model = Inner

    def declare(self, d: DiagnosisWriter, segment: Inner, scope: Scope) -> None:
        scope.entries[segment.name] = Entry(f"n[{quoted(segment.name)}]", "inner")

    def diagnose(self, d: DiagnosisWriter, segment: Inner, scope: Scope, behind: Behind) -> None:
        choice = d.module.choice(segment.frames, "frames_of", segment.name)
        fixed = d.shapes.present(segment).fixed
        known = all(d.shapes.present(one).fixed is not None and d.is_told(one) for one, _ in behind)
        option = ""
        if isinstance(segment.size, Expression):
            size = d.ask(segment.size, scope)
        elif fixed is not None:
            size = str(fixed)
        elif known or segment.size == "rest":
            size, option = "None", d.behind_option(True, behind)
        else:
            measure = d.module.function("measure_first")
            size = f"lambda n: {measure}({choice}, n.data, n.at, n.end, n.ctx)"
        d.out.add(f"n.inner({quoted(segment.name)}, {size}, {choice}{option})")
