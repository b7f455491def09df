"""Implement `const` and `text` (constant bytes), `skip` (ignored bytes) and the fill bytes of a fixed-size frame."""

from __future__ import annotations

from framekit.codec.kinds.base import SegmentKind
from framekit.codec.python.diagnosis import Behind, DiagnosisWriter
from framekit.codec.python.encode import EncodeWriter
from framekit.codec.python.encode_plan import PackArgument
from framekit.codec.python.expressions import FieldScope
from framekit.codec.python.function import Offset
from framekit.codec.python.measure import Finished, MeasureWriter, Pairs
from framekit.codec.python.reader import BufferReader, ScopedSegment
from framekit.codec.python.source import bytes_literal, literal, quoted
from framekit.definition.model.segments import Const, Fill, Skip


class ConstKind(SegmentKind[Const]):
    model = Const
    may_be_absent = True

    def struct_order(self, segment: Const) -> str | None:
        return ""

    def argument(self, w: EncodeWriter, segment: Const, scope: FieldScope, size: int) -> PackArgument:
        return PackArgument(f"{size}s", "", bytes_literal(segment.data))

    def diagnose(self, d: DiagnosisWriter, segment: Const, scope: FieldScope, behind: Behind) -> None:
        d.out.add(f"n.const({d.named(segment)}, {bytes_literal(segment.data)}{d.refuse(segment)})")

    def describe(self, segment: Const) -> str:
        data = segment.data
        return f"{data.hex(' ').upper()}" if not data.isalnum() else literal(data.decode("latin-1"))


class SkipKind(SegmentKind[Skip]):
    model = Skip
    may_be_absent = True

    def struct_order(self, segment: Skip) -> str | None:
        return ""

    def argument(self, w: EncodeWriter, segment: Skip, scope: FieldScope, size: int) -> PackArgument:
        fill = segment.fill
        if size and not fill.strip(b"\0"):
            return PackArgument(f"{size}x" if size > 1 else "x", "", "")
        return PackArgument(f"{size}s", "", bytes_literal((fill * size)[:size]))

    def diagnose(self, d: DiagnosisWriter, segment: Skip, scope: FieldScope, behind: Behind) -> None:
        d.out.add(f"n.skip({d.named(segment)}, {segment.size})")

    def describe(self, segment: Skip) -> str:
        return f"{segment.size} bytes" if segment.size > 1 else "1 byte"


class FillKind(SegmentKind[Fill]):
    model = Fill

    def read(self, r: BufferReader, item: ScopedSegment, segment: Fill, after: tuple[ScopedSegment, ...]) -> None:
        r.take_rest(item, after)
        r.function.mismatch_if(f"len({r.buffer}) != {segment.total}")

    def diagnose(self, d: DiagnosisWriter, segment: Fill, scope: FieldScope, behind: Behind) -> None:
        total, name = segment.total, d.named(segment)
        d.out.add(f"n.skip({name}, n.rest({d.behind(behind)}, {name}))")
        d.out.add(f'n.expect("short", "frame", n.end, {quoted(f"{total} bytes")}, lambda n: n.end >= {total})')
        d.out.add(f'n.expect("surplus", "frame", {total}, "its end", lambda n: n.end <= {total})')

    def measure(self, m: MeasureWriter, segment: Fill, scope: FieldScope, after: Pairs) -> None:
        m.place = Offset("start", segment.total)
        m.return_total()
        raise Finished
