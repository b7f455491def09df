"""Implement `check`: a check code."""

from __future__ import annotations

from collections.abc import Iterator

from framekit.codec.kinds.base import SegmentKind
from framekit.codec.python import forms
from framekit.codec.python.diagnosis import Behind, DiagnosisWriter
from framekit.codec.python.expressions import FieldScope
from framekit.codec.python.forms import code_bytes
from framekit.codec.python.function import Offset, between, covered_parts, covered_paths, covers_later, on_the_wire
from framekit.codec.python.measure import MeasureWriter, Pairs
from framekit.codec.python.reader import BufferReader, ScopedSegment, Slot
from framekit.codec.python.source import quoted
from framekit.definition.codings import Plain
from framekit.definition.expression import PRODUCT
from framekit.definition.kinds.check import Added
from framekit.definition.kinds.wrap import Wrap
from framekit.definition.model.segments import Check, Segments


class CheckKind(SegmentKind[Check]):
    model = Check

    def struct_order(self, segment: Check) -> str | None:
        return forms.check_code(segment)[1]

    def slot(self, r: BufferReader, item: ScopedSegment, segment: Check, size: int) -> Slot:
        if segment.verify != "error" or r.residue(segment) is not None:
            return super().slot(r, item, segment, size)
        code, order = forms.check_code(segment)
        return Slot(item, size, code, order, r.function.names.fresh("check"))

    def unpacked(self, r: BufferReader, slot: Slot, segment: Check, source: str, converted: bool) -> None:
        r.validate_check(segment, slot.item.scope, source, slot.code.endswith("s"))

    def diagnose(self, d: DiagnosisWriter, segment: Check, scope: FieldScope, behind: Behind) -> None:
        key = forms.needs(segment, d.writer(scope).text, "n.ctx")
        code = code_bytes(d.module, segment, _covered(d, segment, scope), key)
        options = ", digits=True" if segment.form in ("hex", "HEX") else ""
        options += "" if segment.verify == "error" else ", verify=False"
        options += ", keyed=True" if segment.method.is_keyed else ""
        if segment.verify == "off":
            d.out.add(f"n.skip({d.named(segment)}, {segment.size})")
        elif covers_later(segment, d.segments):
            name = quoted(segment.name or "check")
            d.out.add(f"n.skip({name}, {segment.size})")
            d.late_checks.append(f"n.verify({quoted(segment.path)}, lambda n: {code}{options})")
        else:
            d.out.add(f"n.check({d.named(segment)}, {segment.size}, lambda n: {code}{options})")

    def measure(self, m: MeasureWriter, segment: Check, scope: FieldScope, after: Pairs) -> None:
        if segment.ends:
            m.want(segment.size, after)
            end = m.place.plus(segment.size)
            key = forms.needs(segment, lambda value: m.text(value, scope))
            code = forms.code_text(m.module, segment, _measured(m, segment, scope), key)
            m.may_fail = m.may_fail or bool(segment.added or key) or segment.form != "raw"
            found = forms.code_number(m.module, segment, between("data", m.place, end))
            with m.out.block(f"if {forms.wrong_code(m.module, segment, found, code)}:"):
                m.add("return LOST")
        m.skip(str(segment.size))

    def describe(self, segment: Check) -> str:
        return f"check {segment.method.name}" + ("" if segment.form == "raw" else f" as {segment.form}")


def _covered(d: DiagnosisWriter, check: Check, scope: FieldScope) -> str:
    """Return the source of the bytes that a check covers, for a careful function."""
    if check.covers is None:
        return "n.data[: n.at]"
    parts = covered_parts(check, d.segments)
    if check.span is not None and check.span[1] == "here" and parts[0] and in_one_buffer(check, d.segments):
        return f"n.bytes_from({quoted(covered_paths(check, d.segments)[0])})"
    texts: list[str] = []
    for part in parts:
        if isinstance(part, Added):
            texts.append(forms.added_text(d.module, part, d.writer(scope).text(part.value, PRODUCT)))
        elif part:
            texts.append(f"n.bytes_of({', '.join(map(quoted, part))})")
    return " + ".join(texts) or 'b""'


def _measured(m: MeasureWriter, check: Check, scope: FieldScope) -> str:
    """Return the source of the bytes that a check covers, for a measuring function."""
    if check.covers is None:
        return between("data", Offset("start", 0), m.place)
    texts: list[str] = []
    for part in covered_parts(check, m.segments):
        if isinstance(part, Added):
            texts.append(forms.added_text(m.module, part, m.text(part.value, scope, PRODUCT)))
        else:
            texts += [between("data", first, last) for first, last in m.runs(part)]
    return " + ".join(texts) or 'b""'


def in_one_buffer(check: Check, segments: Segments) -> bool:
    """Return whether all covered bytes are part of the buffer that holds the check."""
    first, *others = covered_paths(check, segments)
    for buffer in _buffers(segments):
        outside = {one.path for one in on_the_wire(buffer)}
        if check in buffer and first in outside and set(others) <= outside | set(_in_plain_wraps(buffer)):
            return True
    return False


def _in_plain_wraps(buffer: Segments) -> Iterator[str]:
    """Yield the paths of the segments in wraps that only set a size and convert no bytes."""
    for one in on_the_wire(buffer):
        if isinstance(one, Wrap) and isinstance(one.coding, Plain) and one.escape is None:
            yield from (inside.path for inside in on_the_wire(one.of))
            yield from _in_plain_wraps(one.of)


def _buffers(segments: Segments) -> Iterator[Segments]:
    yield segments
    for segment in segments:
        if segment.is_there_inside:
            for block in segment.blocks:
                yield from _buffers(block)
