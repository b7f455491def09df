"""`check`: a check code."""

from __future__ import annotations

from collections.abc import Iterator

from framekit.codec.kinds.base import SegmentKind
from framekit.codec.python import forms
from framekit.codec.python.diagnosis import Behind, DiagnosisWriter
from framekit.codec.python.expressions import Scope
from framekit.codec.python.forms import code_bytes
from framekit.codec.python.function import covers_later, on_the_wire, span_names
from framekit.codec.python.reader import BufferReader, Item, Slot
from framekit.codec.python.source import quoted
from framekit.definition.model.frames import leaves
from framekit.definition.model.segments import (
    Check,
    Segments,
)


class CheckKind(SegmentKind[Check]):
    model = Check

    def struct_order(self, segment: Check) -> str | None:
        return forms.check_code(segment)[1]

    def slot(self, r: BufferReader, item: Item, segment: Check, size: int) -> Slot:
        if segment.verify != "error" or r.residue(segment) is not None:
            return super().slot(r, item, segment, size)
        code, order = forms.check_code(segment)
        return Slot(item, size, code, order, r.function.names.fresh("check"))

    def unpacked(self, r: BufferReader, slot: Slot, segment: Check, source: str, converted: bool) -> None:
        r.validate_check(segment, source, slot.code.endswith("s"))

    def diagnose(self, d: DiagnosisWriter, segment: Check, scope: Scope, behind: Behind) -> None:
        if segment.span is not None and not span_names(segment, d.segments):
            covered = 'b""'
        elif segment.over is not None:
            over = (d.by_name[name] for name in segment.over if name in d.by_name)
            covered = f"n.bytes_of({', '.join(quoted(leaf.name or '') for leaf in leaves(over))})"
        elif segment.span is not None and segment.span[1] == "here" and _in_one_buffer(segment, d.segments):
            covered = f"n.bytes_from({quoted(span_names(segment, d.segments)[0])})"
        elif segment.span is not None:
            covered = f"n.bytes_of({', '.join(quoted(name) for name in span_names(segment, d.segments))})"
        else:
            covered = "n.data[: n.at]"
        code = code_bytes(d.module, segment, covered)
        options = ", digits=True" if segment.form in ("hex", "HEX") else ""
        options += "" if segment.verify == "error" else ", verify=False"
        if segment.verify == "off":
            d.out.add(f"n.skip({d.named(segment)}, {segment.size})")
        elif covers_later(segment, d.segments):
            name = quoted(segment.name or "check")
            d.out.add(f"n.skip({name}, {segment.size})")
            d.late_checks.append(f"n.verify({name}, lambda n: {code}{options})")
        else:
            d.out.add(f"n.check({d.named(segment)}, {segment.size}, lambda n: {code}{options})")

    def describe(self, segment: Check) -> str:
        return f"check {segment.method.name}" + ("" if segment.form == "raw" else f" as {segment.form}")


def _in_one_buffer(check: Check, segments: Segments) -> bool:
    """Whether a check stands in the same buffer as everything it covers."""
    names = set(span_names(check, segments))
    return any(check in buffer and names <= {one.name for one in on_the_wire(buffer)} for buffer in _buffers(segments))


def _buffers(segments: Segments) -> Iterator[Segments]:
    yield segments
    for segment in segments:
        if segment.is_there_inside:
            for block in segment.blocks:
                yield from _buffers(block)
