"""`field`: one value."""

from __future__ import annotations

from framekit.codec.kinds.base import SegmentKind
from framekit.codec.python import forms
from framekit.codec.python.diagnosis import Behind, DiagnosisWriter
from framekit.codec.python.expressions import Entry, Scope, constant_of
from framekit.codec.python.measure import MeasureWriter, Pairs
from framekit.codec.python.source import bytes_literal, literal, quoted
from framekit.definition.model.segments import (
    Field,
    FieldType,
)


class FieldKind(SegmentKind[Field]):
    model = Field

    def declare(self, d: DiagnosisWriter, segment: Field, scope: Scope) -> None:
        sized = segment.type.kind in ("ascii", "bytes")
        scope.entries[segment.name] = Entry(
            f"n[{quoted(segment.name)}]", sized=sized, wire=f"n.room({quoted(segment.name)})"
        )

    def diagnose(self, d: DiagnosisWriter, segment: Field, scope: Scope, behind: Behind) -> None:
        name, type_ = quoted(segment.name), segment.type
        behind_it = f"{d.refuse(segment)}{_rules(segment)})"
        if segment.long is not None:
            longer = FieldType(**{slot: getattr(segment.long.type, slot) for slot in FieldType.__slots__})
            d.out.add(
                f"n.long({name}, {type_.fixed_size}, {d.parse(type_, segment)},"
                f" lambda raw: {forms.parse(d.module, type_, 'raw')} == {segment.long.mark:#x},"
                f" {longer.fixed_size}, {d.parse(longer, segment)}{behind_it}"
            )
        elif type_.size is None and type_.end is not None:
            plain = FieldType("ascii", None, pad=type_.pad)
            d.out.add(f"n.until({name}, {bytes_literal(type_.end)}, {d.parse(plain, segment)}{behind_it}")
        elif type_.size is None:
            size = f"lambda n: n.rest({d.behind(behind)}, {name})"
            d.out.add(f"n.field({name}, {size}, {d.parse(type_, segment)}{behind_it}")
        else:
            d.out.add(f"n.field({name}, {d.ask(type_.size, scope)}, {d.parse(type_, segment)}{behind_it}")
        if segment.is_ is not None and (segment.constants is not None or constant_of(segment.is_) is None):
            wanted = d.writer(scope).value(segment.is_)
            d.deferred.append(f'n.same("value", {name}, lambda n: {wanted}{d.refuse(segment)})')

    def measure(self, m: MeasureWriter, segment: Field, scope: Scope, after: Pairs) -> None:
        m.number(segment, scope, after)


def _rules(field: Field) -> str:
    """What must hold for the value, as options of the call."""
    rules = ""
    if field.constants is not None:
        rules = f', among={literal(field.constants)}, cause="where"'
    elif field.is_ is not None and (number := constant_of(field.is_)) is not None:
        rules = f", among=({number},)"
    elif field.only and field.values is not None:
        rules = f", among={literal(tuple(field.values))}"
    if field.limits is not None:
        rules += f", limits={literal(field.limits)}"
    return rules
