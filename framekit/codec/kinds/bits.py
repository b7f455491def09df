"""Implement `bits`: a number that is cut into named bits."""

from __future__ import annotations

from dataclasses import replace

from framekit.codec.kinds.base import TypedKind, careful_entry
from framekit.codec.python import forms
from framekit.codec.python.diagnosis import Behind, DiagnosisWriter
from framekit.codec.python.encode import ConsumedValues, EncodeWriter
from framekit.codec.python.encode_plan import Lengths, Rules, RuleWriter, Task
from framekit.codec.python.expressions import FieldScope, NameEntry, constant_of
from framekit.codec.python.reader import ANY_WIDTH, BufferReader, ScopedSegment, Slot, shown_name
from framekit.codec.python.registry import type_text
from framekit.codec.python.source import literal, quoted
from framekit.definition.expression import Expression, Number
from framekit.definition.model.segments import Bits, BitsPart


class BitsKind(TypedKind[Bits]):
    model = Bits
    may_be_absent = True

    def slot(self, r: BufferReader, item: ScopedSegment, segment: Bits, size: int) -> Slot:
        code, order = forms.struct_code(segment.type) or ("", "")
        return Slot(item, size, code, order, r.function.names.fresh(shown_name(segment, "bits")))

    def unpacked(self, r: BufferReader, slot: Slot, segment: Bits, source: str, converted: bool) -> None:
        r.assign(slot.text, r.wire(segment.type, source, converted))
        _cut(r, slot.item, segment, slot.text)

    def read(self, r: BufferReader, item: ScopedSegment, segment: Bits, after: tuple[ScopedSegment, ...]) -> None:
        local = r.function.names.fresh(shown_name(segment, "bits"))
        r.function.add(f"{local} = {r.sized_number(item, segment)}")
        _cut(r, item, segment, local)

    def tasks(self, w: EncodeWriter, segment: Bits, scope: FieldScope, given: ConsumedValues) -> list[Task]:
        tasks = [_part_task(w, part, segment.when, scope, given) for part in segment.parts]
        if segment.name is not None and segment.name in w.read_names:
            scope.entries[segment.name] = NameEntry("0", sized=False, wire=w.own_room(segment, scope))
        return tasks

    def declare(self, d: DiagnosisWriter, segment: Bits, scope: FieldScope) -> None:
        super().declare(d, segment, scope)
        if segment.name:  # another case may have a value of the same name
            entry = replace(careful_entry(segment, sized=False), text="0")
            scope.entries.setdefault(segment.name, entry)

    def diagnose(self, d: DiagnosisWriter, segment: Bits, scope: FieldScope, behind: Behind) -> None:
        parts = {part.name: (part.low, (1 << part.high - part.low + 1) - 1) for part in segment.parts}
        among: dict[str, tuple[tuple[int, ...], str]] = {}
        for part in segment.parts:
            if part.constants is not None:
                among[part.name] = part.constants, "where"
            elif part.is_ is not None and (number := constant_of(part.is_)) is not None:
                among[part.name] = (number,), "value"
            if part.is_ is not None and part.name not in among:
                wanted = d.writer(scope).value(part.is_)
                call = f'n.same("value", {quoted(part.name)}, lambda n: {wanted}{d.refuse(segment)})'
                d.later(call, segment, part.is_)
        rules = f", among={literal(among)}" if among else ""
        size = d.ask(segment.type.size if segment.type.size is not None else 0, scope)
        d.out.add(
            f"n.bits({d.named(segment)}, {size}, {d.parse(segment.type)}, {literal(parts)}{d.refuse(segment)}{rules})"
        )

    def describe(self, segment: Bits) -> str:
        names = ", ".join(f"{part.name} {_places(part.low, part.high)}" for part in segment.parts)
        return f"bits {type_text(segment.type)} ({names})"

    def rules(self, w: RuleWriter, segment: Bits, always: bool, lengths: Lengths) -> Rules:
        for part in segment.parts:
            names = "" if part.values is None else w.module.numbers(part.values, f"{w.title} {part.name}")
            most = (1 << part.high - part.low + 1) - 1
            yield part.name, w.rule("number", forms.Range(0, most), False, names)


def _places(low: int, high: int) -> str:
    return str(low) if low == high else f"{low}-{high}"


def _part_task(
    w: EncodeWriter, part: BitsPart, when: Expression | None, scope: FieldScope, given: ConsumedValues
) -> Task:
    def write(missing: set[str]) -> None:
        _put_part(w, part, when, scope, given, missing)
        entry = scope.entries[part.name]
        entry.text = w.or_nothing(part.name, entry.text, when, scope)

    worked_out = part.is_ or part.build
    asked = part.name in w.read_names or worked_out is not None
    waits = w.waits(worked_out, when if asked else None)
    return Task((part.name,), waits, write, part.is_ is None)


def _put_part(
    w: EncodeWriter,
    part: BitsPart,
    when: Expression | None,
    scope: FieldScope,
    given: ConsumedValues,
    missing: set[str],
) -> None:
    local = w.local(part.name, given)
    text = local
    if part.constants is not None and len(part.constants) == 1:
        text = given.computed[part.name] = str(part.constants[0])
    elif part.is_ is not None:
        text = w.computed(part.name, part.is_, local, scope, given, when)
    elif part.build is not None and not isinstance(part.build.root, Number):
        build = w.writer(w.with_missing(scope, given, missing)).value(part.build)
        build = f"({w.if_there(build, when, scope)})" if when is not None else build
        w.bind(local, given.value_or_worked_out(part.name, build))
    else:
        first = 0 if part.constants is None else part.constants[0]
        otherwise = first if part.build is None else w.writer(scope).text(part.build)
        w.bind(local, given.value_or(part.name, str(otherwise)))
    if text == local and part.is_ is None:
        if part.values is not None:
            numbers = w.module.numbers(part.values, f"{w.title} {part.name}")
            w.add(f"{local} = {numbers}.get({local}, {local})")
        if part.constants is not None:
            w.refuse_others(part.name, local, part.constants, when, scope)
    if text == local:
        most = (1 << part.high - part.low + 1) - 1
        condition = f"{local} not in (0, 1)" if most == 1 else f"not 0 <= {local} <= {most}"
        w.refuse_where(when, scope, condition)
    scope.entries[part.name] = NameEntry(text, sized=False)


def _cut(r: BufferReader, item: ScopedSegment, bits: Bits, whole: str) -> None:
    """Write the assignments that cut the number `whole` into its named bits."""
    fixed = bits.type.fixed_size  # a number of computed size may have more bits than the names cover
    width = ANY_WIDTH if fixed is None else 8 * fixed // (2 if bits.type.kind == "digits" else 1)
    for part in bits.parts:
        local = r.function.local(part.name, item.scope)
        r.function.add(f"{local} = {bits_text(part, whole, width)}")
        r.declare(item, part.name, local)
        r.validate_value(item.scope, part.is_, part.constants, local)
    if bits.name is not None:
        wire = r.function.wire_size(bits.path) if fixed is None else str(fixed)
        item.scope.entries[bits.name] = NameEntry(whole, sized=False, wire=wire)


def bits_text(part: BitsPart, whole: str, width: int) -> str:
    """Return the source of some bits of the number `whole`, which has `width` bits."""
    text = f"{whole} >> {part.low}" if part.low else whole
    return text if part.high >= width - 1 else f"{text} & {(1 << part.high - part.low + 1) - 1:#x}"
