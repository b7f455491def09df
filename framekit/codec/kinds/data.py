"""`data`: bytes."""

from __future__ import annotations

from framekit.codec.kinds.base import SegmentKind
from framekit.codec.python import forms
from framekit.codec.python.diagnosis import Behind, DiagnosisWriter
from framekit.codec.python.expressions import Entry, Scope
from framekit.codec.python.source import quoted
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
