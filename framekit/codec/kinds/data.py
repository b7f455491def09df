"""`data`: bytes."""

from __future__ import annotations

from framekit.codec.kinds.base import SegmentKind
from framekit.codec.python import forms
from framekit.codec.python.diagnosis import Behind, DiagnosisWriter
from framekit.codec.python.expressions import Entry, Scope
from framekit.codec.python.measure import MeasureWriter, Pairs
from framekit.codec.python.source import quoted
from framekit.definition.expression.emit import PRODUCT
from framekit.definition.model.segments import (
    Data,
)


class DataKind(SegmentKind[Data]):
    model = Data

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
