"""`const` and `text`: bytes that are always there."""

from __future__ import annotations

from framekit.codec.kinds.base import SegmentKind
from framekit.codec.python.diagnosis import Behind, DiagnosisWriter
from framekit.codec.python.encode import EncodeWriter, PackArgument
from framekit.codec.python.expressions import Scope
from framekit.codec.python.source import bytes_literal, literal
from framekit.definition.model.segments import (
    Const,
)


class ConstKind(SegmentKind[Const]):
    model = Const

    def struct_order(self, segment: Const) -> str | None:
        return ""

    def argument(self, w: EncodeWriter, segment: Const, scope: Scope, size: int) -> PackArgument:
        return PackArgument(f"{size}s", "", bytes_literal(segment.data))

    def diagnose(self, d: DiagnosisWriter, segment: Const, scope: Scope, behind: Behind) -> None:
        d.out.add(f"n.const({d.named(segment)}, {bytes_literal(segment.data)}{d.refuse(segment)})")

    def describe(self, segment: Const) -> str:
        data = segment.data
        return f"{data.hex(' ').upper()}" if not data.isalnum() else literal(data.decode("latin-1"))
