"""`field`: one value."""

from __future__ import annotations

from framekit.codec.kinds.base import SegmentKind
from framekit.codec.python import forms
from framekit.codec.python.diagnosis import Behind, DiagnosisWriter
from framekit.codec.python.expressions import Entry, Scope, constant_of
from framekit.codec.python.measure import MeasureWriter, Pairs
from framekit.codec.python.places import Place, between, index
from framekit.codec.python.reader import Item, Reader, Slot
from framekit.codec.python.source import bytes_literal, literal, quoted
from framekit.definition.expression.syntax import Expression
from framekit.definition.model.segments import (
    Field,
    FieldType,
    Long,
)


class FieldKind(SegmentKind[Field]):
    model = Field

    def slot(self, r: Reader, item: Item, segment: Field, size: int) -> Slot:
        code, order = forms.struct_code(segment.type) or ("", "")
        return Slot(item, size, code, order, r.function.local(segment.name, item.scope))

    def unpacked(self, r: Reader, slot: Slot, segment: Field, source: str, converted: bool) -> None:
        item, local = slot.item, slot.text
        r.assign(local, r.value_text(segment, local, r.wire(segment.type, source, converted)))
        sized = segment.type.kind in ("ascii", "bytes")
        r.declare(item, segment.name, local, sized=sized, wire=str(slot.size))
        r.judge_field(item, segment, local)

    def read(self, r: Reader, item: Item, segment: Field, after: tuple[Item, ...]) -> None:
        if segment.long is None:
            _read_sized(r, item, segment, after)
        else:
            _read_long(r, item, segment, segment.long)

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


def _read_sized(r: Reader, item: Item, segment: Field, after: tuple[Item, ...]) -> None:
    """A field whose size is an expression, whose end is marked, or that takes the rest."""
    type_, local = segment.type, r.function.local(segment.name, item.scope)
    if isinstance(type_.size, Expression):
        first, last = r.take(item, r.size_text(type_.size, item.scope))
    elif type_.fixed_size is not None:
        first, last = r.take(item, str(type_.fixed_size))
    elif type_.end is not None:
        first, last = _until_end(r, item, segment, type_.end)
        type_ = FieldType("ascii", None, pad=type_.pad)
    else:
        first, last = r.take_rest(item, after)
    wire = forms.parse(r.module, type_, between(r.buffer, first, last))
    r.function.add(f"{local} = {forms.value_of(segment, wire)}")
    sized = type_.kind in ("ascii", "bytes")
    r.declare(item, segment.name, local, sized=sized, wire=r.function.wire_size(segment.name))
    r.judge_field(item, segment, local)


def _until_end(r: Reader, item: Item, field: Field, end: bytes) -> tuple[Place, Place]:
    stop = r.function.names.fresh(f"{field.name}_end")
    first = r.keep(r.place)
    r.function.add(f"{stop} = {r.buffer}.index({bytes_literal(end)}, {first.text(r.buffer)})")
    r.advance(f"{stop} + {len(end)}")
    r.function.stands(item.segment, r.buffer, first, r.place)
    return first, Place(stop, 0)


def _read_long(r: Reader, item: Item, field: Field, long: Long) -> None:
    """A number whose values from the mark on follow as a longer number."""
    local = r.function.local(field.name, item.scope)
    short, longer = field.type.fixed_size or 1, long.type.fixed_size or 0
    first = r.keep(r.place) if field.name in r.function.tracked else r.place
    if short == 1 and field.type.kind == "int" and not field.type.signed:
        r.function.add(f"{local} = {index(r.buffer, first)}")
    else:
        raw = between(r.buffer, first, first.plus(short))
        r.function.add(f"{local} = {forms.parse(r.module, field.type, raw)}")
    r.advance(first.plus(short).text(r.buffer))
    with r.function.out.block(f"if {local} == {long.mark:#x}:"):
        raw = between(r.buffer, r.place, r.place.plus(longer))
        r.function.add(f"{local} = {forms.parse(r.module, long.type, raw)}")
        r.function.add(f"{r.at} += {longer}")
    if forms.changes_value(field):
        r.function.add(f"{local} = {forms.value_of(field, local)}")
    r.function.stands(field, r.buffer, first, r.place)
    r.declare(item, field.name, local, sized=False, wire=r.function.wire_size(field.name))
    r.judge_field(item, field, local)


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
