"""Implement `field`: one value of a type."""

from __future__ import annotations

from framekit.codec.kinds.base import TypedValueKind
from framekit.codec.python import forms
from framekit.codec.python.diagnosis import Behind, DiagnosisWriter
from framekit.codec.python.encode import ConsumedValues, EncodeWriter
from framekit.codec.python.encode_plan import Lengths, Rules, RuleWriter, Task
from framekit.codec.python.expressions import FieldScope, NameEntry, constant_of, default_text
from framekit.codec.python.facts import is_fixed
from framekit.codec.python.function import Offset, between, index
from framekit.codec.python.reader import BufferReader, ScopedSegment
from framekit.codec.python.registry import type_text
from framekit.codec.python.source import bytes_literal, literal, quoted
from framekit.codec.support import build_int
from framekit.definition.expression import OR, PRODUCT, Bytes, Expression, Number, Text
from framekit.definition.model.segments import Field, FieldType, Long


class FieldKind(TypedValueKind[Field]):
    model = Field
    may_be_absent = True

    def is_plain(self, segment: Field) -> bool:
        return segment.long is None

    def struct_order(self, segment: Field) -> str | None:
        return super().struct_order(segment) if segment.long is None else None

    def must_hold(self, r: BufferReader, item: ScopedSegment, segment: Field, local: str) -> None:
        r.validate_field(item, segment, local)

    def read(self, r: BufferReader, item: ScopedSegment, segment: Field, after: tuple[ScopedSegment, ...]) -> None:
        if segment.long is None:
            _read_sized(r, item, segment, after)
        else:
            _read_long(r, item, segment, segment.long)

    def tasks(self, w: EncodeWriter, segment: Field, scope: FieldScope, given: ConsumedValues) -> list[Task]:
        needed = segment.build is None and segment.default is None and segment.is_ is None and segment.constants is None
        waits = w.waits(segment.is_ or segment.build or segment.default)
        if segment.default is None or segment.build is not None or segment.constants is not None:
            waits |= w.waits(segment.when)
        if segment.when is not None:
            waits |= w.waits(segment.default)
        may_be_given = not needed and segment.is_ is None
        first = Task(
            (segment.name,), waits, lambda missing: _value(w, segment, scope, given, needed, missing), may_be_given
        )
        if segment.is_ is not None or is_fixed(segment):
            return [first]
        waits = w.waits(segment.when) | {segment.name}
        tasks = [first, Task((), waits, lambda _: _validate(w, segment, scope, scope.entries[segment.name].text))]
        size = segment.type.size
        if (
            isinstance(size, Expression)
            and segment.type.kind in ("ascii", "bytes")
            and w.size_by_length(segment) is None
        ):
            tasks.append(
                Task((), waits | w.waits(size), lambda _: w.sized_as_told(segment, segment.name, size, scope, given))
            )
        return tasks

    def bytes_text(self, w: EncodeWriter, segment: Field, scope: FieldScope) -> str:
        if segment.long is not None:
            return _long_bytes(w, segment, segment.long, scope)
        size = segment.type.size
        local = scope.entries[segment.name].text
        if segment.type.form is not None and size is None:
            text = "0"
        elif (size is None and segment.type.end is None) or w.size_by_length(segment) is not None:
            text = f"len({local})"
        else:
            text = w.bounded(size, scope) if isinstance(size, Expression) else str(size or f"len({local})")
        return forms.build(w.module, segment.type, w.wire(segment, scope), text)

    def room_waits(self, w: EncodeWriter, segment: Field) -> set[str]:
        return {segment.name} | super().room_waits(w, segment)

    def room(self, w: EncodeWriter, segment: Field, scope: FieldScope, plain: bool) -> str | None:
        local = w.local_of(segment, scope)
        if segment.long is not None:
            short, longer = segment.type.fixed_size or 1, segment.long.type.fixed_size or 0
            return f"({short} if {forms.operand(w.wire(segment, scope))} < {segment.long.mark} else {short + longer})"
        text = f"len({local})"
        is_number = segment.type.kind not in ("ascii", "bytes")
        if segment.type.is_delimited and is_number:
            return f"len({forms.build(w.module, segment.type, w.wire(segment, scope), '0')})"
        if isinstance(segment.type.size, Expression) and (is_number or w.fills_up(segment)):
            text = w.text(segment.type.size, scope, PRODUCT + 1)
        elif segment.type.end is not None:
            text += f" + {len(segment.type.end)}"
        return text

    def diagnose(self, d: DiagnosisWriter, segment: Field, scope: FieldScope, behind: Behind) -> None:
        name, type_ = quoted(segment.name), segment.type
        behind_it = f"{d.refuse(segment)}{_rules(segment)})"
        if segment.long is not None:
            longer = FieldType(**{slot: getattr(segment.long.type, slot) for slot in FieldType.__slots__})
            d.out.add(
                f"n.long({name}, {type_.fixed_size}, {d.parse(type_, segment)},"
                f" lambda raw: {forms.parse(d.module, type_, 'raw')} == {segment.long.mark:#x},"
                f" {longer.fixed_size}, {d.parse(longer, segment)}{behind_it}"
            )
        elif type_.is_delimited:
            parse, find = d.parse(type_.before_end, segment), ""
            if type_.end is not None:
                end = bytes_literal(type_.end)
            else:
                end, find = forms.stops_literal(type_), f", find={d.module.function('find_stop')}"
            d.out.add(f"n.until({name}, {end}, {parse}{behind_it.removesuffix(')')}{find})")
        elif type_.size is None:
            size = f"lambda n: n.rest({d.behind(behind)}, {name})"
            d.out.add(f"n.field({name}, {size}, {d.parse(type_, segment)}{behind_it}")
        else:
            d.out.add(f"n.field({name}, {d.ask(type_.size, scope)}, {d.parse(type_, segment)}{behind_it}")
        if segment.is_ is not None and (segment.constants is not None or constant_of(segment.is_) is None):
            wanted = d.writer(scope).value(segment.is_)
            d.later(f'n.same("value", {name}, lambda n: {wanted}{d.refuse(segment)})', segment, segment.is_)

    def describe(self, segment: Field) -> str:
        text = f"{segment.name} {type_text(segment.type)}"
        if segment.constants is not None:
            return f"{text} = {' or '.join(_constant(value) for value in segment.constants)}"
        if segment.is_ is not None:
            return f"{text} = {segment.is_}"
        return text

    def rules(self, w: RuleWriter, segment: Field, always: bool, lengths: Lengths) -> Rules:
        yield segment.name, _rule(w, segment, always, lengths)


def _rule(w: RuleWriter, field: Field, always: bool, lengths: Lengths) -> str:
    kind = forms.rule_type(field.type)
    needed = always and field.build is None and field.default is None and field.is_ is None and field.constants is None
    names = "" if field.values is None else w.module.numbers(field.values, f"{w.title} {field.name}")
    if kind in ("text", "bytes"):
        return w.rule(kind, _text_range(field, lengths), needed, names)
    limits = forms.value_range(field) if kind == "number" else forms.Range(*(field.limits or (None, None)))
    fits = forms.refusing(w.module, field.type)
    return w.rule(kind, limits, needed, names, only=field.only, unit=field.unit or 1, fits=fits)


def _text_range(field: Field, lengths: Lengths) -> forms.Range:
    size = field.type.fixed_size
    if size is not None:
        whole = field.type.kind == "bytes" or (field.type.pad is None and field.type.end is None)
        return forms.Range(size if whole else None, size)
    return lengths.get(field.name, forms.Range(None, None))


def _constant(value: int | str | bytes) -> str:
    return value.hex(" ").upper() if isinstance(value, bytes) else str(value)


def _value(
    w: EncodeWriter, item: Field, scope: FieldScope, given: ConsumedValues, needed: bool, missing: set[str]
) -> None:
    local = w.local(item.name, given)
    sized = item.type.kind in ("ascii", "bytes")
    entry = NameEntry(local, sized=sized, wire=None)
    if item.constants is not None and is_fixed(item):
        entry.text = literal(item.constants[0])
        given.computed[item.name] = entry.text
    elif item.is_ is not None:
        entry.text = w.computed(item.name, item.is_, local, scope, given, item.when)
        w.refuse_digits(item, scope, entry.text)
        if sized and isinstance(item.type.size, int) and entry.text == local:
            _validate_text(w, item, scope, local)
    else:
        w.bind(local, _given(w, item, scope, given, needed, missing))
        if item.type.kind == "bytes" and item.when is None:
            w.no_bytes(local)
        if item.values is not None:
            numbers = w.module.numbers(item.values, f"{w.title} {item.name}")
            w.add(f"{local} = {numbers}.get({local}, {local})")
    if item.name in given.computed and item.default is None:
        entry.text = w.or_nothing(item.name, entry.text, item.when, scope)
    scope.entries[item.name] = entry
    if not sized and item.when is None:
        entry.wire = w.room((item.path,), scope)


def _given(
    w: EncodeWriter, item: Field, scope: FieldScope, given: ConsumedValues, needed: bool, missing: set[str]
) -> str:
    """Return the source of a value that the caller gives, that is built, or that has a default."""
    if needed:
        if item.when is None:
            given.needed += 1
            return given.value(item.name)
        key = w.wanted(item.name, given)
        return f"{key} if {w.text(item.when, scope, OR)} else None"
    writer = w.writer(w.with_missing(scope, given, missing))
    default = "None" if item.default is None else default_text(writer.value(item.default), item)
    chosen = item.build or item.default
    text = default if item.build is None else default_text(writer.value(item.build), item)
    if item.constants is not None:
        chosen, text = None, literal(item.constants[0])
    if text != default and item.when is not None:
        text = f"({w.if_there(text, item.when, scope, default)})"
    elif chosen is None or isinstance(chosen.root, (Number, Text, Bytes)):
        return given.value_or(item.name, text)
    return given.value_or_worked_out(item.name, text)


def _validate(w: EncodeWriter, item: Field, scope: FieldScope, local: str) -> None:
    """Write the checks of a value that was given or built."""
    if item.values is not None and item.only and item.constants is None:
        w.refuse(item, scope, f"{local} not in {w.module.value_names(item.values, item.name)}")
    if item.constants is not None:
        w.refuse_others(item.name, local, item.constants, item.when, scope)
    limits = forms.value_range(item)
    by_type = item.type.kind == "int" and item.limits is None and item.zero_means is None and item.long is None
    if item.type.kind in ("ascii", "bytes"):
        _validate_text(w, item, scope, local)
    elif not item.type.is_whole_number:
        if item.limits is not None:
            w.validate_range(item, scope, local, forms.Range(*item.limits))
    elif not by_type:
        w.validate_range(item, scope, local, limits)
    if item.unit is not None and item.unit != 1:
        w.refuse(item, scope, f"{local} % {item.unit:_}")


def _validate_text(w: EncodeWriter, item: Field, scope: FieldScope, local: str) -> None:
    size = item.type.size
    if isinstance(size, int):
        exact = item.type.kind == "bytes" or (item.type.pad is None and item.type.end is None)
        w.refuse(item, scope, f"len({local}) {'!=' if exact else '>'} {size}")
    elif item.type.end is not None:
        condition = f"{literal(item.type.end.decode('latin-1'))} in {local}"
        w.complain_where(item.when, scope, condition, quoted(item.name), quoted(f"'{item.name}' holds its own end"))


def _long_bytes(w: EncodeWriter, field: Field, long: Long, scope: FieldScope) -> str:
    wire = w.wire(field, scope)
    short = forms.build(w.module, field.type, wire, str(field.type.fixed_size))
    if field.type.fixed_size == 1 and field.type.kind == "int" and not field.type.signed:
        short = f"bytes(({wire},))"
    mark = _mark(w, field.type, long.mark)
    longer = forms.build(w.module, long.type, wire, str(long.type.fixed_size))
    return f"({short} if {forms.operand(wire)} < {long.mark:#x} else {mark} + {longer})"


def _mark(w: EncodeWriter, type_: FieldType, mark: int) -> str:
    """Return the source of the bytes that announce the long form."""
    size = type_.fixed_size or 1
    if type_.kind == "int":
        return bytes_literal(build_int(mark, size, type_.order, type_.signed))
    return forms.build(w.module, type_, str(mark), str(size))


def _read_sized(r: BufferReader, item: ScopedSegment, segment: Field, after: tuple[ScopedSegment, ...]) -> None:
    """Write the reading of a field with computed size, with an end mark, or that takes all remaining bytes."""
    type_, local = segment.type, r.function.local(segment.name, item.scope)
    if isinstance(type_.size, Expression):
        first, last = r.take(item, r.size_text(type_.size, item.scope))
    elif type_.fixed_size is not None:
        first, last = r.take(item, str(type_.fixed_size))
    elif type_.is_delimited:
        first, last = _until_end(r, item, segment)
        type_ = type_.before_end
    else:
        first, last = r.take_rest(item, after)
    wire = forms.parse(r.module, type_, between(r.buffer, first, last))
    r.function.add(f"{local} = {forms.value_of(segment, wire)}")
    sized = type_.kind in ("ascii", "bytes")
    r.declare(item, segment.name, local, sized=sized, wire=r.function.wire_size(segment.path))
    r.validate_field(item, segment, local)


def _until_end(r: BufferReader, item: ScopedSegment, field: Field) -> tuple[Offset, Offset]:
    stop = r.function.names.fresh(f"{field.name}_end")
    first = r.keep(r.place)
    r.function.add(f"{stop} = {forms.find_end(r.module, field.type, r.buffer, first.text(r.buffer))}")
    r.advance(f"{stop} + {len(field.type.end)}" if field.type.end is not None else stop)
    r.function.stands(item.segment, r.buffer, first, r.place)
    return first, Offset(stop, 0)


def _read_long(r: BufferReader, item: ScopedSegment, field: Field, long: Long) -> None:
    """Write the reading of a number that continues in a longer number if its short form equals the mark."""
    local = r.function.local(field.name, item.scope)
    short, longer = field.type.fixed_size or 1, long.type.fixed_size or 0
    first = r.keep(r.place) if field.path in r.function.tracked else r.place
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
    r.declare(item, field.name, local, sized=False, wire=r.function.wire_size(field.path))
    r.validate_field(item, field, local)


def _rules(field: Field) -> str:
    """Return the checks of the value as keyword arguments of the diagnosing call."""
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
