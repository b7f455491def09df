"""A layout that stands in itself, one level deeper: the fields of a frame that only stands here."""

from __future__ import annotations

from framekit.codec.kinds.base import SegmentKind
from framekit.codec.python import forms
from framekit.codec.python.diagnosis import Behind, DiagnosisWriter
from framekit.codec.python.encode import EncodeWriter, Given
from framekit.codec.python.encode_plan import Lengths, Rules, RuleWriter, Task
from framekit.codec.python.expressions import NameEntry, Scope
from framekit.codec.python.function import MISMATCH, between
from framekit.codec.python.measure import MeasureWriter, Pairs
from framekit.codec.python.module import Module
from framekit.codec.python.reader import BufferReader, Item
from framekit.codec.python.source import quoted
from framekit.definition.model.segments import Nested


class NestedKind(SegmentKind[Nested]):
    model = Nested

    def read(self, r: BufferReader, item: Item, segment: Nested, after: tuple[Item, ...]) -> None:
        function = r.function
        local = function.local(segment.name, item.scope)
        level, fixed = _level(r.module, segment, function.title), r.static.present(segment).fixed
        size = str(fixed)
        if fixed is None:
            size = function.names.fresh(f"{segment.name}_size")
            function.flush()
            start = r.place.text(r.buffer)
            function.add(f"{size} = {level}.measure({r.buffer}, {start}, len({r.buffer}), ctx)")
            with function.out.block(f"if {size} <= 0:"):
                function.add(MISMATCH)
        first, last = r.take(item, size)
        function.flush()
        function.add(f"{local} = {level}.decode({between(r.buffer, first, last)}, ctx)")
        item.scope.entries[segment.name] = NameEntry(local, "inner")
        function.names_of_values[segment.name] = local
        item.fields.add(segment.name, local)

    def tasks(self, w: EncodeWriter, segment: Nested, scope: Scope, given: Given) -> list[Task]:
        name, waits = segment.name, w.waits(segment.when)
        tasks = [Task((name,), waits, lambda _: w.plain_given(segment, scope, given))]
        if name in w.asked_for:
            tasks.append(Task((f"bytes of {name}",), waits | {name}, lambda _: w.put_into_local(segment, scope)))
        return tasks

    def bytes_text(self, w: EncodeWriter, segment: Nested, scope: Scope) -> str:
        level, encode = _level(w.module, segment, w.title), w.module.function("encode_nested")
        value = scope.entries[segment.name].text
        text = f"{encode}({level}, {value}, {quoted(segment.name)}, ctx)"
        return w.if_present(segment, scope, text, 'b""')

    def declare(self, d: DiagnosisWriter, segment: Nested, scope: Scope) -> None:
        scope.entries[segment.name] = NameEntry(f"n[{quoted(segment.name)}]", "inner")

    def diagnose(self, d: DiagnosisWriter, segment: Nested, scope: Scope, behind: Behind) -> None:
        level = _level(d.module, segment, "frames_of")
        d.out.add(f"n.nested({quoted(segment.name)}, {level})")

    def measure(self, m: MeasureWriter, segment: Nested, scope: Scope, after: Pairs) -> None:
        fixed = m.static.present(segment).fixed
        if fixed is not None:
            m.skip(str(fixed))
            return
        level, behind, size = _level(m.module, segment, m.identifier), m.least(after), m.names.fresh("size")
        m.want(m.static.present(segment).least, after)
        m.add(f"{size} = {level}.measure(data, {m.place.text('')}, end, ctx)")
        with m.out.block(f"if {size} <= 0:"):
            found = f"{size} - {behind} if QUIET < {size} < 0" if behind else f"{size} if QUIET < {size} < 0"
            m.add(f"return {found} and end - start - {size} <= {m.most} else LOST")
        m.skip(size)

    def describe(self, segment: Nested) -> str:
        return f"{segment.name} ({segment.layout} once more)"

    def rules(self, w: RuleWriter, segment: Nested, always: bool, lengths: Lengths) -> Rules:
        yield segment.name, w.rule("mapping", forms.Range(None, None), always)


def _level(module: Module, segment: Nested, hint: str) -> str:
    """Text of the frame that is one level deeper: its functions."""
    return f"{module.choice((segment.frame,), hint, segment.name)}.everything[0]"
