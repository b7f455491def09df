"""Implement `inner` (a frame inside a frame) and nested layouts (a layout inside itself)."""

from __future__ import annotations

from typing import TypeVar

from framekit.codec.kinds.base import SegmentKind, careful_entry
from framekit.codec.python import forms
from framekit.codec.python.choices import Switch, in_order, tree_of
from framekit.codec.python.diagnosis import Behind, DiagnosisWriter
from framekit.codec.python.encode import ConsumedValues, EncodeWriter
from framekit.codec.python.encode_plan import Lengths, Rules, RuleWriter, Task
from framekit.codec.python.expressions import FieldScope, NameEntry
from framekit.codec.python.facts import begins_with_constants, only_measured
from framekit.codec.python.function import MISMATCH, Function, between
from framekit.codec.python.measure import MeasureWriter, Pairs
from framekit.codec.python.module import Module
from framekit.codec.python.reader import BufferReader, ScopedSegment, holds_values
from framekit.codec.python.source import quoted
from framekit.definition.expression import AND, Expression
from framekit.definition.model.frames import everything
from framekit.definition.model.segments import Inner, Nested

F = TypeVar("F", Inner, Nested)


class FrameInside(SegmentKind[F]):
    """Implement the common part of both kinds of inner frames: the value is a mapping that must be given."""

    def declare(self, d: DiagnosisWriter, segment: F, scope: FieldScope) -> None:
        scope.entries[segment.name] = careful_entry(segment, "inner", sized=False)

    def rules(self, w: RuleWriter, segment: F, always: bool, lengths: Lengths) -> Rules:
        yield segment.name, w.rule("mapping", forms.Range(None, None), always)


class InnerKind(FrameInside[Inner]):
    model = Inner

    def read(self, r: BufferReader, item: ScopedSegment, segment: Inner, after: tuple[ScopedSegment, ...]) -> None:
        function = r.function
        local = function.local(segment.name, item.scope)
        choice = r.module.choice(segment.frames, function.title, segment.name)
        fixed = r.static.present(segment).fixed
        known = r.knows_behind(after)
        if isinstance(segment.size, Expression):
            first, last = r.take(item, r.size_text(segment.size, item.scope))
        elif fixed is not None and not (known and r.place.base == "end"):
            first, last = r.take(item, str(fixed))
        elif known or segment.size == "rest":
            first, last = r.take_rest(item, after)
        else:
            size = function.names.fresh(f"{segment.name}_size")
            measure, start = r.module.function("measure_first"), r.place.text(r.buffer)
            function.add(f"{size} = {measure}({choice}, {r.buffer}, {start}, len({r.buffer}), ctx, whole=True)")
            with function.out.block(f"if {size} <= 0:"):
                function.add(MISMATCH)
            first, last = r.take(item, size)
        region = between(r.buffer, first, last)
        if _may_come_last(function, segment):
            if not region.isidentifier():
                raw = function.names.fresh(f"{segment.name}_bytes")
                function.add(f"{raw} = {region}")
                region = raw
            function.last.append(lambda: _first_that_fits(r, segment, local, choice, region))
        else:
            _first_that_fits(r, segment, local, choice, region)
        r.declare(item, segment.name, local, "inner", sized=False, wire=function.wire_size(segment.path))

    def tasks(self, w: EncodeWriter, segment: Inner, scope: FieldScope, given: ConsumedValues) -> list[Task]:
        name, waits = segment.name, w.waits(segment.when)
        is_read = name in w.values_read
        tasks = [Task((name,), waits, lambda _: w.plain_given(segment, scope, given))]
        if is_read:
            tasks = [Task((name, f"bytes of {segment.path}"), waits, lambda _: _read_back(w, segment, scope, given))]
        fixed = isinstance(segment.size, int) and any(
            w.static.frame(one).fixed != segment.size for one in segment.frames
        )
        if not is_read and (segment.path in w.asked_for or isinstance(segment.size, Expression) or fixed):
            wire = (f"bytes of {segment.path}",)
            tasks.append(Task(wire, waits | {name}, lambda _: w.put_into_local(segment, scope)))
        if isinstance(segment.size, Expression) or fixed:
            waits = waits | {f"bytes of {segment.path}"}
            waits |= w.waits(segment.size) if isinstance(segment.size, Expression) else set()
            tasks.append(Task((), waits, lambda _: _compare_size(w, segment, scope)))
        return tasks

    def bytes_text(self, w: EncodeWriter, segment: Inner, scope: FieldScope) -> str:
        name, value = segment.name, scope.entries[segment.name].text
        choice, encode = w.module.choice(segment.frames, w.title, name), w.module.function("encode_one")
        if segment.when is not None:
            return w.if_present(segment, scope, f"{encode}({choice}, {value}, {quoted(name)}, ctx)", 'b""')
        wire, frame, fields = (w.names.fresh(one) for one in (f"{name}_bytes", "frame_name", "fields"))
        w.flush()
        with w.out.block("try:"):
            w.add(f"(({frame}, {fields}),) = {value}.items()")
            w.add(f"{wire} = {choice}.encoders[{frame}]({fields}, ctx)")
        with w.out.block("except MISMATCHES:"):
            w.add(f"{wire} = {encode}({choice}, {value}, {quoted(name)}, ctx)")
        return wire

    def diagnose(self, d: DiagnosisWriter, segment: Inner, scope: FieldScope, behind: Behind) -> None:
        choice = d.module.choice(segment.frames, "frames_of", segment.name)
        fixed = d.static.present(segment).fixed
        option = ""
        if isinstance(segment.size, Expression):
            size = d.ask(segment.size, scope)
        elif fixed is not None:
            size = str(fixed)
        elif segment.size == "rest" or d.knows_behind(behind):
            size, option = "None", d.behind_option(True, behind)
        else:
            measure = d.module.function("measure_first")
            size = f"lambda n: {measure}({choice}, n.data, n.at, n.end, n.ctx, whole=True)"
            option = ", found=True"
        d.out.add(f"n.inner({quoted(segment.name)}, {size}, {choice}{option})")

    def measure(self, m: MeasureWriter, segment: Inner, scope: FieldScope, after: Pairs) -> None:
        fixed = m.static.present(segment).fixed
        if isinstance(segment.size, Expression):
            told = m.size_text(segment.size, scope)
            m.skip(told)
            _has_size(m, segment, scope, told)
            return
        if segment.size == "rest":
            m.rest(segment, after)
        if fixed is not None:
            _has_size(m, segment, scope, str(fixed))
        if fixed is not None and not begins_with_constants(m.static, segment):
            m.skip(str(fixed))
            return
        choice = m.module.choice(segment.frames, m.identifier, segment.name)
        behind = m.least(after)
        size = m.names.fresh(f"{segment.name}_size")
        if any(m.static.frame(name).least for name in segment.frames):
            m.want(1, after)
        place = m.place.text("")
        most = m.static.all(segment for segment, _ in after).most
        m.asks_inside = True
        seen = ""
        if most is not None and not m.anew:
            offset = f"({place} - start) - {most}" if m.place.base == "at" else str(m.place.offset + most)
            seen = f", max(seen - {offset}, 0)" if offset != "0" else ", seen"
        several = behind if len(segment.frames) > 1 else 0  # a shorter frame may follow the frame that wants more bytes
        more = f", behind={several}" if several else ""
        m.inner_size(size, choice, m.module.function("measure_first"), f"data, {place}, end, ctx", seen, more)
        with m.out.block(f"if {size} <= 0:"):
            with m.out.block(f"if {size} == QUIET and end - start > {m.most}:"):
                m.add("return LOST")
            is_told = not behind or several
            m.add(f"return {size}" if is_told else f"return {size} - {behind} if QUIET < {size} < 0 else {size}")
        m.skip(size)
        _has_size(m, segment, scope, size)

    def describe(self, segment: Inner) -> str:
        shown = ", ".join(segment.frames[:3]) + (", …" if len(segment.frames) > 3 else "")
        return f"{segment.name} (one of {shown})" if len(segment.frames) > 1 else f"{segment.name} ({shown})"


def _read_back(w: EncodeWriter, segment: Inner, scope: FieldScope, given: ConsumedValues) -> None:
    """Write the bytes of an inner frame into a local, and read the values from them that expressions use.

    So the expressions have its computed values and constants too, as in a reader.
    """
    w.plain_given(segment, scope, given)
    entry, choice = scope.entries[segment.name], w.module.choice(segment.frames, w.title, segment.name)
    w.put_into_local(segment, scope)
    local = w.names.fresh(f"{segment.name}_read")
    text = f"{w.module.function('read_inside')}({choice}, {w.wires[segment.path]}, {entry.text}, ctx)"
    w.add(f"{local} = {w.if_present(segment, scope, text, 'None')}")
    entry.text = local


def _has_size(m: MeasureWriter, segment: Inner | Nested, scope: FieldScope, size: str) -> None:
    """Declare the name of an inner frame of which only the size is known while measuring."""
    if segment.name in only_measured(m.segments):
        scope.entries[segment.name] = NameEntry("None", "inner", sized=False, wire=size)


def _compare_size(w: EncodeWriter, inner: Inner, scope: FieldScope) -> None:
    """Write the comparison of the size of an inner frame with the size that other values state."""
    if isinstance(inner.size, Expression):
        size, conditions = w.text(inner.size, scope), w.is_known(inner.when, inner.size, scope)
    else:
        size, conditions = str(inner.size), [] if inner.when is None else [w.text(inner.when, scope, AND)]
    w.compare_size((inner.name,), f"len({w.wires[inner.path]})", size, conditions)


def _may_come_last(function: Function, inner: Inner) -> bool:
    """Return whether no other segment needs the value, so that it can be read after all checks of the outer frame."""
    if not function.tells_wrong or function.in_branch or inner.name in function.read_names:
        return False
    every = tuple(everything(function.segments))
    return not any(one.has_cases or (one.when is not None and holds_values(one)) for one in every)


def _first_that_fits(r: BufferReader, inner: Inner, local: str, choice: str, raw: str) -> None:
    """Write the reading of an inner frame into `local`.

    The deciding byte selects the decoder directly if only one frame is likely; otherwise `decode_first` tries them all.
    """
    function, decode = r.function, r.module.function("decode_first")
    if not raw.isidentifier():
        region = function.names.fresh(f"{inner.name}_bytes")
        function.add(f"{region} = {raw}")
        raw = region
    one, mismatch = function.names.fresh("one"), function.names.fresh("mismatch")
    tree = tree_of(r.static, in_order(r.static, inner.frames))
    at = tree.at if isinstance(tree, Switch) else 0
    anyway = f"{decode}({choice}, {raw}, ctx)"
    with function.out.block("try:"):
        function.add(f"{one} = {choice}.likely[{raw}[{at}]]")
        function.add(f"{local} = {anyway} if {one} is None else {{{one}[0]: {one}[1]({raw}, ctx)}}")
    with function.out.block(f"except MISMATCHES as {mismatch}:"):
        function.add(f"{local} = {decode}({choice}, {raw}, ctx, {mismatch})")


class NestedKind(FrameInside[Nested]):
    model = Nested

    def read(self, r: BufferReader, item: ScopedSegment, segment: Nested, after: tuple[ScopedSegment, ...]) -> None:
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
        r.declare(item, segment.name, local, "inner", sized=False, wire=function.wire_size(segment.path))

    def tasks(self, w: EncodeWriter, segment: Nested, scope: FieldScope, given: ConsumedValues) -> list[Task]:
        name, waits = segment.name, w.waits(segment.when)
        tasks = [Task((name,), waits, lambda _: w.plain_given(segment, scope, given))]
        if segment.path in w.asked_for:
            tasks.append(
                Task((f"bytes of {segment.path}",), waits | {name}, lambda _: w.put_into_local(segment, scope))
            )
        return tasks

    def bytes_text(self, w: EncodeWriter, segment: Nested, scope: FieldScope) -> str:
        level, encode = _level(w.module, segment, w.title), w.module.function("encode_nested")
        value = scope.entries[segment.name].text
        text = f"{encode}({level}, {value}, {quoted(segment.name)}, ctx)"
        return w.if_present(segment, scope, text, 'b""')

    def diagnose(self, d: DiagnosisWriter, segment: Nested, scope: FieldScope, behind: Behind) -> None:
        level = _level(d.module, segment, "frames_of")
        d.out.add(f"n.nested({quoted(segment.name)}, {level})")

    def measure(self, m: MeasureWriter, segment: Nested, scope: FieldScope, after: Pairs) -> None:
        fixed = m.static.present(segment).fixed
        if fixed is not None:
            m.skip(str(fixed))
            _has_size(m, segment, scope, str(fixed))
            return
        level, behind, size = _level(m.module, segment, m.identifier), m.least(after), m.names.fresh("size")
        m.want(m.static.present(segment).least, after)
        m.add(f"{size} = {level}.measure(data, {m.place.text('')}, end, ctx)")
        with m.out.block(f"if {size} <= 0:"):
            found = f"{size} - {behind} if QUIET < {size} < 0" if behind else f"{size} if QUIET < {size} < 0"
            m.add(f"return {found} and end - start - {size} <= {m.most} else LOST")
        m.skip(size)
        _has_size(m, segment, scope, size)

    def describe(self, segment: Nested) -> str:
        return f"{segment.name} ({segment.layout} once more)"


def _level(module: Module, segment: Nested, hint: str) -> str:
    """Return the source of the frame object of the next nesting level."""
    return f"{module.choice((segment.frame,), hint, segment.name)}.everything[0]"
