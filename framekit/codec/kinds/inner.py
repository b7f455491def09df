"""`inner`: a frame inside a frame."""

from __future__ import annotations

from framekit.codec.kinds.base import SegmentKind
from framekit.codec.python.diagnosis import Behind, DiagnosisWriter
from framekit.codec.python.expressions import Entry, Scope
from framekit.codec.python.measure import MeasureWriter, Pairs
from framekit.codec.python.source import quoted
from framekit.definition.expression.syntax import Expression
from framekit.definition.model.segments import (
    Inner,
)


class InnerKind(SegmentKind[Inner]):
    model = Inner

    def declare(self, d: DiagnosisWriter, segment: Inner, scope: Scope) -> None:
        scope.entries[segment.name] = Entry(f"n[{quoted(segment.name)}]", "inner")

    def diagnose(self, d: DiagnosisWriter, segment: Inner, scope: Scope, behind: Behind) -> None:
        choice = d.module.choice(segment.frames, "frames_of", segment.name)
        fixed = d.shapes.present(segment).fixed
        known = all(d.shapes.present(one).fixed is not None and d.is_told(one) for one, _ in behind)
        option = ""
        if isinstance(segment.size, Expression):
            size = d.ask(segment.size, scope)
        elif fixed is not None:
            size = str(fixed)
        elif known or segment.size == "rest":
            size, option = "None", d.behind_option(True, behind)
        else:
            measure = d.module.function("measure_first")
            size = f"lambda n: {measure}({choice}, n.data, n.at, n.end, n.ctx)"
        d.out.add(f"n.inner({quoted(segment.name)}, {size}, {choice}{option})")

    def measure(self, m: MeasureWriter, segment: Inner, scope: Scope, after: Pairs) -> None:
        fixed = m.shapes.present(segment).fixed
        if isinstance(segment.size, Expression):
            m.skip(m.size_text(segment.size, scope))
            return
        if segment.size == "rest":
            m.rest(segment, after)
        if fixed is not None and not m.begins_with_constants(segment):
            m.skip(str(fixed))
            return
        choice = m.module.choice(segment.frames, m.identifier, segment.name)
        behind = m.least(after)
        size = m.names.fresh(f"{segment.name}_size")
        if any(m.shapes.frame(name).least for name in segment.frames):
            m.want(1, after)
        place = m.place.text("")
        most = m.shapes.all(segment for segment, _ in after).most
        m.asks_inside = True
        seen = ""
        if most is not None:
            offset = f"({place} - start) - {most}" if m.place.base == "at" else str(m.place.offset + most)
            seen = f", max(seen - {offset}, 0)" if offset != "0" else ", seen"
        m.inner_size(size, choice, m.module.function("measure_first"), f"data, {place}, end, ctx", seen)
        with m.out.block(f"if {size} <= 0:"):
            with m.out.block(f"if {size} == QUIET and end - start > {m.most}:"):
                m.add("return LOST")
            m.add(f"return {size} - {behind} if QUIET < {size} < 0 else {size}" if behind else f"return {size}")
        m.skip(size)
