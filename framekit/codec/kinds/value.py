"""Implement `value` (a computed value without bytes) and `require` (a condition)."""

from __future__ import annotations

from framekit.codec.kinds.base import SegmentKind
from framekit.codec.python.diagnosis import Behind, DiagnosisWriter
from framekit.codec.python.encode import ConsumedValues, EncodeWriter
from framekit.codec.python.encode_plan import Lengths, Rules, RuleWriter, Task
from framekit.codec.python.expressions import FieldScope, NameEntry
from framekit.codec.python.measure import MeasureWriter, Pairs
from framekit.codec.python.reader import BufferReader, ScopedSegment
from framekit.codec.python.source import quoted, text_source
from framekit.definition.expression import BIT_OR, COMPARE, Expression
from framekit.definition.model.segments import Require, Value


class ValueKind(SegmentKind[Value]):
    model = Value

    def is_plain(self, segment: Value) -> bool:
        return True

    def read(self, r: BufferReader, item: ScopedSegment, segment: Value, after: tuple[ScopedSegment, ...]) -> None:
        r.when_known(segment.read, item.scope, lambda: _work_out(r, item, segment))

    def tasks(self, w: EncodeWriter, segment: Value, scope: FieldScope, given: ConsumedValues) -> list[Task]:
        waits = w.waits(segment.build or segment.read, segment.when)
        tasks = [Task((segment.name,), waits, lambda missing: _put(w, segment, scope, given, missing), True)]
        tasks[0].prefer = segment.build is None
        agree = w.waits(segment.read) | {segment.name}
        return [*tasks, Task((), agree, lambda _: _agree(w, segment, scope, given))]

    def diagnose(self, d: DiagnosisWriter, segment: Value, scope: FieldScope, behind: Behind) -> None:
        d.out.add(f"n.value({d.named(segment)}, lambda n: {d.writer(scope).value(segment.read)}{d.refuse(segment)})")

    def measure(self, m: MeasureWriter, segment: Value, scope: FieldScope, after: Pairs) -> None:
        if segment.name in m.needed:
            m.set_value(segment.name, scope, m.text(segment.read, scope))

    def describe(self, segment: Value) -> str:
        return f"{segment.name} := {segment.read}"

    def rules(self, w: RuleWriter, segment: Value, always: bool, lengths: Lengths) -> Rules:
        yield segment.name, 'Rule("any")'


def _put(w: EncodeWriter, value: Value, scope: FieldScope, given: ConsumedValues, missing: set[str]) -> None:
    local = w.names.fresh(value.name)
    if value.build is None and not missing:
        w.add(f"{local} = {w.if_there(w.writer(scope).value(value.read), value.when, scope)}")
        given.computed[value.name] = local
    else:
        text = w.writer(w.with_missing(scope, given, missing)).value(value.build or value.read)
        text = text if value.when is None else f"({w.if_there(text, value.when, scope)})"
        w.add(f"{local} = {given.value_or_worked_out(value.name, text)}")
    scope.entries[value.name] = NameEntry(local)


def _agree(w: EncodeWriter, value: Value, scope: FieldScope, given: ConsumedValues) -> None:
    """Write the check that a value that was given or built equals the value that a reader computes."""
    local = scope.entries[value.name].text
    if given.computed.get(value.name) == local:
        return
    read = w.text(value.read, scope, BIT_OR)
    path = *given.path, value.name
    message = text_source("'", *path, "' does not agree with the other values")
    w.complain_where(value.when, scope, f"{local} != {read}", text_source(*path), message)


def _work_out(r: BufferReader, item: ScopedSegment, value: Value) -> None:
    local = r.function.local(value.name, item.scope)
    r.function.add(f"{local} = {r.function.writer(item.scope).value(value.read)}")
    r.declare(item, value.name, local)


class RequireKind(SegmentKind[Require]):
    model = Require
    may_be_absent = True

    def read(self, r: BufferReader, item: ScopedSegment, segment: Require, after: tuple[ScopedSegment, ...]) -> None:
        def refuse() -> None:
            r.function.mismatch_if(r.function.writer(item.scope).negated(segment.condition))

        r.when_known(segment.condition, item.scope, refuse)

    def tasks(self, w: EncodeWriter, segment: Require, scope: FieldScope, given: ConsumedValues) -> list[Task]:
        waits = w.waits(segment.condition, segment.when)
        return [Task((), waits, lambda _: _demand(w, segment, segment.condition, scope))]

    def diagnose(self, d: DiagnosisWriter, segment: Require, scope: FieldScope, behind: Behind) -> None:
        text = d.writer(scope).text(segment.condition)
        d.out.add(f"n.require({quoted(segment.condition.text)}, lambda n: {text}{d.refuse(segment)})")

    def describe(self, segment: Require) -> str:
        return f"({segment.condition})"


def _demand(w: EncodeWriter, segment: Require, condition: Expression, scope: FieldScope) -> None:
    text = w.writer(scope).negated(condition)
    if segment.when is not None:
        text = f"{w.text(segment.when, scope, COMPARE)} and {text}"
    w.complain(text, '"require"', quoted(f"it must hold that {condition}"))
