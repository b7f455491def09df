"""`require`: a condition that must hold."""

from __future__ import annotations

from framekit.codec.kinds.base import SegmentKind
from framekit.codec.python.diagnosis import Behind, DiagnosisWriter
from framekit.codec.python.encode import EncodeWriter, Given
from framekit.codec.python.encode_plan import Task
from framekit.codec.python.expressions import Scope
from framekit.codec.python.reader import BufferReader, Item
from framekit.codec.python.source import quoted
from framekit.definition.expression import COMPARE, Expression
from framekit.definition.model.segments import (
    Require,
)


class RequireKind(SegmentKind[Require]):
    model = Require

    def read(self, r: BufferReader, item: Item, segment: Require, after: tuple[Item, ...]) -> None:
        def refuse() -> None:
            r.function.mismatch_if(r.function.writer(item.scope).negated(segment.condition))

        r.when_known(segment.condition, item.scope, refuse)

    def tasks(self, w: EncodeWriter, segment: Require, scope: Scope, given: Given) -> list[Task]:
        waits = w.waits(segment.condition, segment.when)
        return [Task((), waits, lambda _: _demand(w, segment, segment.condition, scope))]

    def diagnose(self, d: DiagnosisWriter, segment: Require, scope: Scope, behind: Behind) -> None:
        text = d.writer(scope).text(segment.condition)
        d.out.add(f"n.require({quoted(segment.condition.text)}, lambda n: {text}{d.refuse(segment)})")

    def describe(self, segment: Require) -> str:
        return f"({segment.condition})"


def _demand(w: EncodeWriter, segment: Require, condition: Expression, scope: Scope) -> None:
    text = w.writer(scope).negated(condition)
    if segment.when is not None:
        text = f"{w.text(segment.when, scope, COMPARE)} and {text}"
    w.complain(text, '"require"', quoted(f"it must hold that {condition}"))
