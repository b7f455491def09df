"""Implement `data`: a sequence of bytes."""

from __future__ import annotations

from framekit.codec.kinds.base import SegmentKind
from framekit.codec.python import forms
from framekit.codec.python.diagnosis import Behind, DiagnosisWriter
from framekit.codec.python.encode import ConsumedValues, EncodeWriter
from framekit.codec.python.encode_plan import Lengths, PackArgument, Rules, RuleWriter, Task
from framekit.codec.python.expressions import FieldScope, NameEntry
from framekit.codec.python.function import between
from framekit.codec.python.measure import MeasureWriter, Pairs
from framekit.codec.python.reader import BufferReader, ScopedSegment, Slot
from framekit.codec.python.source import bytes_literal, quoted
from framekit.definition.expression import AND, OR, PRODUCT, Expression
from framekit.definition.model.segments import Data


class DataKind(SegmentKind[Data]):
    model = Data
    may_be_absent = True

    def struct_order(self, segment: Data) -> str | None:
        return "" if isinstance(segment.size, int) else None

    def slot(self, r: BufferReader, item: ScopedSegment, segment: Data, size: int) -> Slot:
        return Slot(item, size, f"{size}s", "", r.function.local(segment.name, item.scope))

    def unpacked(self, r: BufferReader, slot: Slot, segment: Data, source: str, converted: bool) -> None:
        local = slot.text
        r.assign(local, forms.memory_text(r.module, segment, source))
        r.declare(slot.item, segment.name, local)
        if isinstance(segment.size, int) and segment.least > segment.size:
            r.function.mismatch_if(f"len({local}) < {segment.least}")
        if segment.never:
            r.function.mismatch_if(forms.holds_never(segment, local))

    def read(self, r: BufferReader, item: ScopedSegment, segment: Data, after: tuple[ScopedSegment, ...]) -> None:
        if segment.size == "rest":
            first, last = r.take_rest(item, after)
        elif isinstance(segment.size, int):
            first, last = r.take(item, str(segment.on_wire(segment.size)))
        elif segment.convert is None:
            first, last = r.take(item, r.size_text(segment.size, item.scope))
        else:
            size = r.size_text(segment.size, item.scope, PRODUCT + 1)
            first, last = r.take(item, f"2 * {size}" if segment.convert == "hex_to_ascii" else f"{size} // 2")
        local = r.function.local(segment.name, item.scope)
        wire = between(r.buffer, first, last)
        r.function.add(f"{local} = {forms.memory_text(r.module, segment, wire)}")
        r.declare(item, segment.name, local)
        if segment.convert == "ascii_to_hex" and isinstance(segment.size, Expression):
            r.function.mismatch_if(f"len({local}) != {r.size_text(segment.size, item.scope)}")
        if segment.least:
            r.function.mismatch_if(f"len({local}) < {segment.least}")
        if segment.never:
            r.function.mismatch_if(forms.holds_never(segment, local))

    def tasks(self, w: EncodeWriter, segment: Data, scope: FieldScope, given: ConsumedValues) -> list[Task]:
        filled = segment.size if w.fills_up(segment) and isinstance(segment.size, Expression) else None
        tasks = [Task((segment.name,), w.waits(segment.when, filled), lambda _: _put(w, segment, scope, given))]
        if isinstance(segment.size, Expression) and w.size_by_length(segment) is None:
            waits = {segment.name} | w.waits(segment.size, segment.when)
            tasks.append(Task((), waits, lambda _: _compare_size(w, segment, scope, given)))
        return tasks

    def argument(self, w: EncodeWriter, segment: Data, scope: FieldScope, size: int) -> PackArgument:
        return PackArgument(f"{size}s", "", w.data_text(segment, scope))

    def bytes_text(self, w: EncodeWriter, segment: Data, scope: FieldScope) -> str:
        return w.data_text(segment, scope)

    def room_waits(self, w: EncodeWriter, segment: Data) -> set[str]:
        return {segment.name}

    def room(self, w: EncodeWriter, segment: Data, scope: FieldScope, plain: bool) -> str | None:
        text = f"len({w.local_of(segment, scope)})"
        if not plain and segment.convert is not None:
            text = f"2 * {text}" if segment.convert == "hex_to_ascii" else f"{text} // 2"
        return text

    def diagnose(self, d: DiagnosisWriter, segment: Data, scope: FieldScope, behind: Behind) -> None:
        factor = {"hex_to_ascii": " * 2", "ascii_to_hex": " // 2", None: ""}[segment.convert]
        options = d.refuse(segment)
        if segment.size == "rest" and (bytes_behind := d.behind(behind)) != "0":
            options += f", behind={bytes_behind}"
        if segment.least:
            options += f", least={segment.least}"
        if segment.never:
            options += f", never={bytes_literal(segment.never)}"
        parse = f"lambda raw: {forms.memory_text(d.module, segment, 'raw')}"
        d.out.add(f"n.data_field({quoted(segment.name)}, {d.ask(segment.size, scope, factor)}, {parse}{options})")

    def measure(self, m: MeasureWriter, segment: Data, scope: FieldScope, after: Pairs) -> None:
        if segment.size == "rest":
            m.rest(segment, after)
        elif isinstance(segment.size, int):
            size = str(segment.on_wire(segment.size))
        elif segment.convert is None:
            size = m.size_text(segment.size, scope)
        else:
            text = m.size_text(segment.size, scope, PRODUCT + 1)
            size = f"2 * {text}" if segment.convert == "hex_to_ascii" else f"{text} // 2"
        if segment.name not in m.needed:
            m.skip(size)
            return
        m.take(size, after)
        m.may_fail = m.may_fail or segment.convert is not None
        m.set_value(segment.name, scope, forms.memory_text(m.module, segment, "data[at:stop]"))
        m.advance("stop")

    def describe(self, segment: Data) -> str:
        how = "" if segment.convert is None else f" {segment.convert}"
        return f"{segment.name} bytes[{segment.size}]{how}"

    def rules(self, w: RuleWriter, segment: Data, always: bool, lengths: Lengths) -> Rules:
        kind = "digits" if segment.convert == "ascii_to_hex" else "bytes"
        yield segment.name, w.rule(kind, _range_of(segment, lengths), always and segment.pad is None)


def _range_of(data: Data, lengths: Lengths) -> forms.Range:
    if isinstance(data.size, int):
        return forms.Range(data.least if data.pad is not None else data.size, data.size)
    limits = lengths.get(data.name, forms.Range(None, None)) if data.convert is None else forms.Range(None, None)
    return forms.Range(max(data.least, limits.least or 0) or None, limits.most)


def _put(w: EncodeWriter, data: Data, scope: FieldScope, given: ConsumedValues) -> None:
    local = w.local(data.name, given)
    key = given.value(data.name) if data.pad is None else given.value_or(data.name, 'b""')
    if data.when is not None and data.pad is None:
        key = w.wanted(data.name, given)
    if data.when is None:
        given.needed += data.pad is None
        w.bind(local, key)
    else:
        w.add(f'{local} = {key} if {w.text(data.when, scope, OR)} else b""')
    if isinstance(data.size, (int, Expression)) or data.least or data.never or w.is_measured(data.name):
        w.no_bytes(local)
    if w.fills_up(data):
        _fill_up(w, data, local, scope)
    if isinstance(data.size, int):
        w.refuse(data, scope, f"len({local}) != {data.size}")
    elif data.least:
        w.refuse(data, scope, f"len({local}) < {data.least}")
    if data.never:
        what = f"'{data.name}' holds a byte that never stands in it: {' or '.join(f'{one:02X}' for one in data.never)}"
        w.complain(forms.holds_never(data, local), quoted(data.name), quoted(what))
    scope.entries[data.name] = NameEntry(w.or_nothing(data.name, local, data.when, scope))


def _fill_up(w: EncodeWriter, data: Data, local: str, scope: FieldScope) -> None:
    """Write the padding of short data to their full size, before their length is used."""
    assert data.pad is not None and isinstance(data.size, (int, Expression))
    if isinstance(data.size, Expression):
        size, conditions = w.bounded(data.size, scope), w.is_known(data.when, data.size, scope)
    else:
        size, conditions = str(data.size), [] if data.when is None else [w.text(data.when, scope, AND)]
    w.add_if(conditions, f"{local} = {local}.ljust({size}, {bytes_literal(bytes((data.pad,)))})")


def _compare_size(w: EncodeWriter, data: Data, scope: FieldScope, given: ConsumedValues) -> None:
    assert isinstance(data.size, Expression)
    w.sized_as_told(data, data.name, data.size, scope, given)
