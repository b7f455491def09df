"""`optional`: segments that are there when their values are given."""

from __future__ import annotations

from framekit.codec.kinds.base import SegmentKind
from framekit.codec.python.diagnosis import Behind, DiagnosisWriter
from framekit.codec.python.encode import Cases, EncodeWriter, Given
from framekit.codec.python.encode_plan import Task
from framekit.codec.python.expressions import Scope
from framekit.codec.python.function import Offset
from framekit.codec.python.measure import MeasureWriter, Pairs
from framekit.codec.python.reader import BufferReader, Item
from framekit.codec.python.registry import summary
from framekit.codec.python.source import quoted
from framekit.definition.model.frames import flat
from framekit.definition.model.segments import (
    Optional,
)


class OptionalKind(SegmentKind[Optional]):
    model = Optional

    def read(self, r: BufferReader, item: Item, segment: Optional, after: tuple[Item, ...]) -> None:
        end = r.region_end(after)
        items = [Item(segment, item.scope, item.fields) for segment in segment.of]
        if end.base == "end":
            name = r.function.names.fresh("region_end")
            r.function.add(f"{name} = {end.text(r.buffer)}")
            end = Offset(name, 0)
        r.prepare_names(items)
        item.fields.open(r.function.out)
        r.settle()
        r.branches_of_choice([(f"if {r.at} < {end.base}:", items)], after, fault=False)

    def tasks(self, w: EncodeWriter, segment: Optional, scope: Scope, given: Given) -> list[Task]:
        return w.branch_tasks(segment, scope, given)

    def cases(self, w: EncodeWriter, segment: Optional, scope: Scope, given: Given) -> Cases:
        names = [name for one in flat(segment.of) for name in w.inputs(one)]
        tests = " or ".join(f"{quoted(name)} in {given.text}" for name in names)
        return [(f"if {tests or 'True'}:", segment.of)]

    def diagnose(self, d: DiagnosisWriter, segment: Optional, scope: Scope, behind: Behind) -> None:
        if absent := d.absent(segment):
            d.out.add(absent)
        with d.out.block(f"if n.rest({d.behind(behind)}, {d.named(segment)}) > 0:"):
            d.list(segment.of, scope, behind, all_is_read=False)
        if absent := d.without(segment.of):
            with d.out.block("else:"):
                d.out.add(absent)

    def measure(self, m: MeasureWriter, segment: Optional, scope: Scope, after: Pairs) -> None:
        m.rest(segment, after)

    def describe(self, segment: Optional) -> str:
        return f"[{summary(segment.of)}]"
