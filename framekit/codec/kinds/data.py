"""`data`: bytes."""

from __future__ import annotations

from framekit.codec.kinds.base import SegmentKind
from framekit.codec.python import forms
from framekit.codec.python.diagnosis import Behind, DiagnosisWriter
from framekit.codec.python.expressions import Entry, Scope
from framekit.codec.python.measure import MeasureWriter, Pairs
from framekit.codec.python.places import between
from framekit.codec.python.reader import Item, Reader, Slot
from framekit.codec.python.source import quoted
from framekit.definition.expression.emit import PRODUCT
from framekit.definition.expression.syntax import Expression
from framekit.definition.model.segments import (
    Data,
)


class DataKind(SegmentKind[Data]):
    model = Data

    def slot(self, r: Reader, item: Item, segment: Data, size: int) -> Slot:
        return Slot(item, size, f"{size}s", "", r.function.local(segment.name, item.scope))

    def unpacked(self, r: Reader, slot: Slot, segment: Data, source: str, converted: bool) -> None:
        local = slot.text
        r.assign(local, forms.memory_text(r.module, segment, source))
        r.declare(slot.item, segment.name, local)
        if isinstance(segment.size, int) and segment.least > segment.size:
            r.function.misfit_if(f"len({local}) < {segment.least}")

    def read(self, r: Reader, item: Item, segment: Data, after: tuple[Item, ...]) -> None:
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
            r.function.misfit_if(f"len({local}) != {r.size_text(segment.size, item.scope)}")
        if segment.least:
            r.function.misfit_if(f"len({local}) < {segment.least}")

    def declare(self, d: DiagnosisWriter, segment: Data, scope: Scope) -> None:
        scope.entries[segment.name] = Entry(f"n[{quoted(segment.name)}]")

    def diagnose(self, d: DiagnosisWriter, segment: Data, scope: Scope, behind: Behind) -> None:
        factor = {"hex_to_ascii": " * 2", "ascii_to_hex": " // 2", None: ""}[segment.convert]
        options = d.refuse(segment)
        if segment.size == "rest" and (bytes_behind := d.behind(behind)) != "0":
            options += f", behind={bytes_behind}"
        if segment.least:
            options += f", least={segment.least}"
        parse = f"lambda raw: {forms.memory_text(d.module, segment, 'raw')}"
        d.out.add(f"n.data_field({quoted(segment.name)}, {d.ask(segment.size, scope, factor)}, {parse}{options})")

    def measure(self, m: MeasureWriter, segment: Data, scope: Scope, after: Pairs) -> None:
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
