"""`length` and `count`: numbers that say how large something else is."""

from __future__ import annotations

from framekit.codec.kinds.base import SegmentKind
from framekit.codec.python import forms
from framekit.codec.python.diagnosis import Behind, DiagnosisWriter
from framekit.codec.python.expressions import Entry, Scope
from framekit.codec.python.measure import MeasureWriter, Pairs
from framekit.codec.python.reader import Item, Reader, Slot
from framekit.codec.python.shape import (
    is_always_there,
    is_followed,
    is_plain_name,
    targets_of,
)
from framekit.codec.python.source import literal, quoted
from framekit.definition.model.segments import (
    Count,
    Data,
    Length,
    Repeat,
)


class LengthKind(SegmentKind[Length]):
    model = Length

    def slot(self, r: Reader, item: Item, segment: Length, size: int) -> Slot:
        code, order = forms.struct_code(segment.type) or ("", "")
        return Slot(item, size, code, order, r.function.local(segment.name, item.scope))

    def unpacked(self, r: Reader, slot: Slot, segment: Length, source: str, converted: bool) -> None:
        item, local = slot.item, slot.text
        r.assign(local, r.value_text(segment, local, r.wire(segment.type, source, converted)))
        r.declare(item, segment.name, local, sized=False, wire=str(slot.size))
        r.judge_limits(segment, local)
        r.compare_length(item, segment)

    def read(self, r: Reader, item: Item, segment: Length, after: tuple[Item, ...]) -> None:
        _read_number(r, item, segment)
        r.compare_length(item, segment)

    def declare(self, d: DiagnosisWriter, segment: Length, scope: Scope) -> None:
        sized = segment.type.kind in ("ascii", "bytes")
        scope.entries[segment.name] = Entry(
            f"n[{quoted(segment.name)}]", sized=sized, wire=f"n.room({quoted(segment.name)})"
        )

    def diagnose(self, d: DiagnosisWriter, segment: Length, scope: Scope, behind: Behind) -> None:
        _diagnose(d, segment, scope, _room_of(d, segment))

    def measure(self, m: MeasureWriter, segment: Length, scope: Scope, after: Pairs) -> None:
        m.number(segment, scope, after)


def _room_of(d: DiagnosisWriter, length: Length) -> str | None:
    """Text of the length that must come out; None where nothing can disagree."""
    targets = targets_of(length, d.segments)
    if is_followed(length, targets):
        return None
    single = [target.only for target in targets.values()]
    converted = [t for t in single if length.plain and isinstance(t, Data) and t.convert is not None]
    rooms = [quoted(name) for name in length.of if name not in {target.name for target in converted}]
    parts = [f"n.room({', '.join(rooms)})"] if rooms else []
    parts += [f"len(n[{quoted(target.name)}])" for target in converted]
    total = " + ".join(parts) or "0"
    if length.unit != 1:
        total = f"({total}) // {length.unit}" if len(parts) > 1 else f"{total} // {length.unit}"
    return total


class CountKind(SegmentKind[Count]):
    model = Count

    def slot(self, r: Reader, item: Item, segment: Count, size: int) -> Slot:
        code, order = forms.struct_code(segment.type) or ("", "")
        return Slot(item, size, code, order, r.function.local(segment.name, item.scope))

    def unpacked(self, r: Reader, slot: Slot, segment: Count, source: str, converted: bool) -> None:
        item, local = slot.item, slot.text
        r.assign(local, r.value_text(segment, local, r.wire(segment.type, source, converted)))
        r.declare(item, segment.name, local, sized=False, wire=str(slot.size))
        r.judge_limits(segment, local)
        r.compare_count(item, segment)

    def read(self, r: Reader, item: Item, segment: Count, after: tuple[Item, ...]) -> None:
        _read_number(r, item, segment)
        r.compare_count(item, segment)

    def declare(self, d: DiagnosisWriter, segment: Count, scope: Scope) -> None:
        sized = segment.type.kind in ("ascii", "bytes")
        scope.entries[segment.name] = Entry(
            f"n[{quoted(segment.name)}]", sized=sized, wire=f"n.room({quoted(segment.name)})"
        )

    def diagnose(self, d: DiagnosisWriter, segment: Count, scope: Scope, behind: Behind) -> None:
        _diagnose(d, segment, scope, _items_of(d, segment))

    def measure(self, m: MeasureWriter, segment: Count, scope: Scope, after: Pairs) -> None:
        m.number(segment, scope, after)


def _read_number(r: Reader, item: Item, segment: Length | Count) -> None:
    """A number whose size is an expression."""
    local = r.function.local(segment.name, item.scope)
    r.function.add(f"{local} = {forms.value_of(segment, r.sized_number(item, segment))}")
    r.declare(item, segment.name, local, sized=False, wire=r.function.wire_size(segment.name))
    r.judge_limits(segment, local)


def _items_of(d: DiagnosisWriter, count: Count) -> str | None:
    """Text of the number of items; None where nothing can disagree."""
    repeat = d.by_name.get(count.of)
    there = is_always_there(count.of, d.segments)
    followed = isinstance(repeat, Repeat) and count.plus == 0 and is_plain_name(repeat.times, count.name)
    if not isinstance(repeat, Repeat) or (there and followed):
        return None
    return f"len(n[{quoted(count.of)}]{'' if there else ' or ()'})"


def _diagnose(d: DiagnosisWriter, segment: Length | Count, scope: Scope, wanted: str | None) -> None:
    limits = "" if segment.limits is None else f", limits={literal(segment.limits)}"
    name = quoted(segment.name)
    size = d.ask(segment.type.size if segment.type.size is not None else 0, scope)
    d.out.add(f"n.field({name}, {size}, {d.parse(segment.type, segment)}{d.refuse(segment)}{limits})")
    if wanted is not None:
        plus = "" if not segment.plus else f" + {segment.plus}" if segment.plus > 0 else f" - {-segment.plus}"
        d.deferred.append(f'n.same("length", {name}, lambda n: {wanted}{plus}{d.refuse(segment)})')
