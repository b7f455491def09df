"""`repeat`: a list, of records or of plain values."""

from __future__ import annotations

from framekit.codec.kinds.base import SegmentKind
from framekit.codec.python.diagnosis import Behind, DiagnosisWriter, inside_of
from framekit.codec.python.expressions import Entry, Scope
from framekit.codec.python.measure import Finished, MeasureWriter, Pairs
from framekit.codec.python.places import Place
from framekit.codec.python.shape import may_be_empty, names_read
from framekit.codec.python.source import quoted
from framekit.definition.expression.emit import PRODUCT
from framekit.definition.expression.syntax import Expression
from framekit.definition.model.segments import (
    FieldType,
    Repeat,
    Segments,
)


class RepeatKind(SegmentKind[Repeat]):
    model = Repeat

    def declare(self, d: DiagnosisWriter, segment: Repeat, scope: Scope) -> None:
        inside = Scope(scope)
        d.declare(segment.inner_record or (), inside)
        scope.entries[segment.name] = Entry(f"n[{quoted(segment.name)}]", "list", inside)

    def diagnose(self, d: DiagnosisWriter, segment: Repeat, scope: Scope, behind: Behind) -> None:
        name, times = quoted(segment.name), d.ask(segment.times, scope)
        option = d.behind_option(segment.times == "rest", behind)
        if isinstance(segment.of, FieldType):
            parse = d.parse(segment.of)
            d.out.add(f"n.values({name}, {times}, {segment.of.fixed_size}, {parse}{d.refuse(segment)}{option})")
            return
        with d.out.block(f"for _ in n.items({name}, {times}{option}):"):
            d.list(segment.of, inside_of(scope, segment.name), ())

    def measure(self, m: MeasureWriter, segment: Repeat, scope: Scope, after: Pairs) -> None:
        item = segment.of.sizes if isinstance(segment.of, FieldType) else m.shapes.all(segment.of)
        if segment.times == "rest":
            m.rest(segment, after)
        times = str(segment.times)
        if isinstance(segment.times, Expression):
            times = m.size_text(segment.times, scope, PRODUCT + 1)
        if item.fixed is not None and segment.name not in m.needed:
            whole = str(int(times) * item.fixed) if times.isdigit() else f"{item.fixed} * {times}"
            m.skip(times if item.fixed == 1 else whole)
        elif isinstance(segment.of, FieldType):
            size = segment.of.fixed_size or 0
            m.take(f"{size} * {times}", after)
            place = m.names.fresh("place")
            one = m.wire(segment.of, Place(place, 0), Place(place, size))
            local = m.set_value(segment.name, scope, f"[{one} for {place} in range(at, stop, {size})]")
            scope.entries[segment.name] = Entry(local, "list", Scope())
            m.advance("stop")
        else:
            _measure_records(m, segment, segment.of, scope, times, after)


def _measure_records(m: MeasureWriter, repeat: Repeat, of: Segments, scope: Scope, times: str, after: Pairs) -> None:
    """Items of different size are walked through; what the others take at least is wanted at once."""
    empty, behind = may_be_empty(m.shapes, repeat), m.least(after)
    least = 1 if empty else m.shapes.all(of).least
    if not times.isdigit():
        with m.out.block(f"if {times} > {m.most}:"):
            m.add("return LOST")
    m.settle()
    inside = Scope(scope)
    found = m.set_value(repeat.name, scope, "[]") if repeat.name in m.needed else None
    left = m.names.fresh("left")
    needed = m.needed
    if found is not None:
        inside.entries[repeat.name] = Entry(found, "list", inside)  # the items before this one
        m.needed = needed | names_read(of) | {name for one in of for name in one.value_names}
    with m.out.block(f"for {left} in range({times}, 0, -1):"):
        total = " + ".join([*([f"{least} * {left}"] if least else []), *([str(behind)] if behind else [])])
        if least:
            with m.out.block(f"if end < at + {least}:"):
                m.add(f"return end - at - ({total})" if behind else f"return end - at - {total}")
        before = m.names.fresh("before")
        if empty:
            m.add(f"{before} = at")
        outside, m.in_list = m.in_list, True
        finished = m.branch(m.pairs(of, inside), ())
        m.in_list = outside
        if finished:
            raise Finished
        if empty:
            with m.out.block(f"if at == {before}:"):
                m.add("return LOST")
        if found is not None:
            fields = ", ".join(
                f"{quoted(name)}: {entry.text}" for name, entry in inside.entries.items() if entry.text != found
            )
            m.add(f"{found}.append({{{fields}}})")
    m.needed = needed
    if found is not None:
        scope.entries[repeat.name] = Entry(found, "list", inside)
