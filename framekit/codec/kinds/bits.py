"""`bits`: a number cut into named bits."""

from __future__ import annotations

from framekit.codec.kinds.base import SegmentKind
from framekit.codec.python import forms
from framekit.codec.python.diagnosis import Behind, DiagnosisWriter
from framekit.codec.python.expressions import Entry, Scope, constant_of
from framekit.codec.python.measure import MeasureWriter, Pairs
from framekit.codec.python.reader import ANY_WIDTH, Item, Reader, Slot, shown_name
from framekit.codec.python.source import literal, quoted
from framekit.definition.model.segments import (
    Bits,
    BitsPart,
)


class BitsKind(SegmentKind[Bits]):
    model = Bits

    def slot(self, r: Reader, item: Item, segment: Bits, size: int) -> Slot:
        code, order = forms.struct_code(segment.type) or ("", "")
        return Slot(item, size, code, order, r.function.names.fresh(shown_name(segment, "bits")))

    def unpacked(self, r: Reader, slot: Slot, segment: Bits, source: str, converted: bool) -> None:
        r.assign(slot.text, r.wire(segment.type, source, converted))
        _cut(r, slot.item, segment, slot.text)

    def read(self, r: Reader, item: Item, segment: Bits, after: tuple[Item, ...]) -> None:
        local = r.function.names.fresh(shown_name(segment, "bits"))
        r.function.add(f"{local} = {r.sized_number(item, segment)}")
        _cut(r, item, segment, local)

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


def _cut(r: Reader, item: Item, bits: Bits, whole: str) -> None:
    """Cuts a number into its named bits."""
    fixed = bits.type.fixed_size  # one of computed size may have more bits than any name takes
    width = ANY_WIDTH if fixed is None else 8 * fixed // (2 if bits.type.kind == "digits" else 1)
    for part in bits.parts:
        local = r.function.local(part.name, item.scope)
        r.function.add(f"{local} = {bits_text(part, whole, width)}")
        r.declare(item, part.name, local)
        r.judge_value(item.scope, part.is_, part.constants, local)
    if bits.name is not None:
        wire = r.function.wire_size(bits.name) if fixed is None else str(fixed)
        item.scope.entries[bits.name] = Entry(whole, sized=False, wire=wire)


def bits_text(part: BitsPart, whole: str, width: int) -> str:
    """Text of some bits of the number `whole`, which has `width` bits."""
    text = f"{whole} >> {part.low}" if part.low else whole
    return text if part.high >= width - 1 else f"{text} & {(1 << part.high - part.low + 1) - 1:#x}"
