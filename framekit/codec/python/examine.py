"""Writers of the careful functions: a list of calls, one a segment, that finds the first fault and where everything is.

What the calls do is `examination`; here they are only put down in the order of the segments.
"""

from __future__ import annotations

from collections.abc import Iterable

from framekit.codec.python.branches import default_text, numbers_of
from framekit.codec.python.describe import write_docstring
from framekit.codec.python.examine_segments import SegmentExaminer
from framekit.codec.python.examining import Behind
from framekit.codec.python.expressions import Scope
from framekit.codec.python.module import Module
from framekit.codec.python.source import Source, literal, quoted
from framekit.definition.expression.emit import BIT_OR
from framekit.definition.expression.syntax import Expression, names_in
from framekit.definition.model.frames import Frame
from framekit.definition.model.segments import (
    Check,
    Choose,
    Const,
    Field,
    FieldType,
    Inner,
    Optional,
    Record,
    Repeat,
    Segment,
    Wrap,
)
from framekit.definition.model.walk import everything, flat, leaves, without_when


def write_examiner(
    module: Module, identifier: str, name: str, segments: tuple[Segment, ...], frame: Frame | None
) -> Source:
    """The source of `examine_…` of a frame or a layout."""
    writer = ExamineWriter(module, segments)
    body = Source()
    surplus = frame.surplus if frame is not None else None
    options = ("" if surplus is None else f", surplus={surplus:#x}") + _checks_option(segments)
    with body.block(f"with n.part({options.removeprefix(', ')}):"):
        writer.out = body
        writer.region(segments, Scope(), frame)
        writer.compare_late_checks()
    out = Source()
    with out.block(f"def examine_{identifier}(data: bytes, ctx: Context) -> Examination:"):
        write_docstring(out, f"Read `{name}` carefully: all its places, and the first fault.", "")
        for context, local in writer.hoisted.items():
            out.add(f"{local} = {module.given(context)}")
        out.add(f"n = {module.function('Examination')}(data, ctx)")
        if frame is not None and frame.most is not None:
            with out.block(f"if len(data) > {frame.most}:"):
                most = quoted(f"at most {frame.most} bytes")
                out.add(f'n.note("too_long", "frame", {frame.most}, {most}, str(len(data)))')
        out.extend(body)
        out.add("return n")
    return out


def _checks_option(segments: tuple[Segment, ...]) -> str:
    """Says that there are check codes in a part."""
    there = any(isinstance(segment, Check) and segment.verify == "error" for segment in everything(segments))
    return ", checks=True" if there else ""


class ExamineWriter(SegmentExaminer):
    """Writes the calls of one careful function."""

    def region(self, segments: tuple[Segment, ...], scope: Scope, frame: Frame | None = None) -> None:
        """A whole buffer. What stands behind its last variable part is read from the end, whatever came before."""
        self.declare(segments, scope)
        if frame is not None and frame.delimited and frame.tail and isinstance(frame.tail[0], Const):
            self._delimited(frame, scope, frame.tail[0].data[0])
        else:
            front, middle, tail = self._parts(segments)
            behind = tuple((segment, scope) for segment in tail)
            self.list(front, scope, (), finish=False)
            if middle:
                with self.out.block(f"with n.attempt({self.behind(behind)}{_checks_option(middle)}):"):
                    self.list(middle, scope, behind, finish=False)
            self.list(tail, scope, (), finish=False)
        self.finish()

    def _delimited(self, frame: Frame, scope: Scope, mark: int) -> None:
        """A frame whose body ends where its tail begins, whatever is in it."""
        surplus = "" if frame.surplus is None else f", surplus={frame.surplus:#x}"
        self.list(frame.head, scope, (), finish=False)
        with self.out.block(f"with n.part(n.until_tail({mark:#04x}){surplus}{_checks_option(frame.body)}):"):
            self.list(frame.body, scope, (), finish=False)
        self.list(frame.tail, scope, (), finish=False)

    def _parts(
        self, segments: tuple[Segment, ...]
    ) -> tuple[tuple[Segment, ...], tuple[Segment, ...], tuple[Segment, ...]]:
        """The fixed segments at the start, those up to the last variable one, and the fixed ones behind it.

        The last two are empty if the size of the end cannot be told beforehand.
        """
        front, tail = self.shapes.split(segments)
        has_bytes = any(self.shapes.present(segment).fixed != 0 for segment in tail)
        if not has_bytes or not self._known_before(front, tail):
            return segments, (), ()
        first = next(place for place, segment in enumerate(front) if self.shapes.is_variable(segment))
        return front[:first], front[first:], tail

    def _known_before(self, front: tuple[Segment, ...], tail: tuple[Segment, ...]) -> bool:
        """Whether the size of the tail can be told before the first variable segment is read."""
        late: set[str] = set()
        variable = False
        for segment in front:
            variable = variable or self.shapes.is_variable(segment)
            if variable:
                late.update(name for one in everything((segment,)) for name in one.value_names)
        wanted = {name for segment in tail if segment.when is not None for name in names_in(segment.when.root)}
        own = {name for segment in everything(tail) for name in segment.value_names}
        return not wanted & (late | own)

    def list(
        self,
        segments: Iterable[Segment],
        scope: Scope,
        after: Behind,
        finish: bool = True,
    ) -> None:
        """The segments of a list; `after`: what follows them in the buffer."""
        segments = tuple(segments)
        outside = self.deferred
        if finish:
            self.deferred = []
        for place, segment in enumerate(segments):
            behind = (*((other, scope) for other in segments[place + 1 :]), *after)
            if segment.when is not None:
                self._conditional(segment, scope, behind)
            else:
                self.segment(segment, scope, behind)
            self.read_names.update(name for one in everything((segment,)) for name in one.value_names)
        if finish:
            self.finish()
            self.deferred = outside

    def finish(self) -> None:
        """Comparisons that need what comes later."""
        deferred, self.deferred = self.deferred, []
        for line in deferred:
            self.out.add(line)

    def _conditional(self, segment: Segment, scope: Scope, behind: Behind) -> None:
        assert segment.when is not None
        condition = f'n.ask(lambda n: {self.writer(scope).text(segment.when)}, "value", {self.named(segment)})'
        with self.out.block(f"if {condition}:"):
            self.segment(without_when(segment), scope, behind)
        if isinstance(segment, Field) and segment.default is not None:
            default = default_text(self.writer(scope).value(segment.default), segment)
            with self.out.block("else:"):
                self.out.add(f"n.absent({quoted(segment.name)}, lambda n: {default})")
            return
        absent = [line for line in (self._absent(segment), self._without((segment,))) if line]
        if absent:
            with self.out.block("else:"):
                for line in absent:
                    self.out.add(line)

    def _without(self, segments: Iterable[Segment], there: Iterable[Segment] = ()) -> str:
        """The call that says that what expressions read of these segments is nothing, but for what is `there`."""
        known = {name for one in flat(there) for name in one.value_names}
        wanted = [one for one in flat(segments) if set(one.value_names) & self.asked_by_name - known]
        records = sorted({one.name for one in wanted if isinstance(one, Record)})
        names = {name for one in wanted for name in one.value_names} & self.asked_by_name - known - set(records)
        texts = [literal(tuple(sorted(names))), *([literal(tuple(records))] if records else [])]
        return f"n.without({', '.join(texts)})" if wanted else ""

    def _absent(self, segment: Segment) -> str:
        """The call that says that nothing of a segment is there, as far as checks ask for it."""
        names = [leaf.name or "" for leaf in leaves((segment,)) if leaf.name in self.asked_for]
        return f"n.nothing({', '.join(quoted(name) for name in names)})" if names else ""

    # ---- segments with others inside ----------------------------------------------------------------------

    def nested(self, segment: Segment, scope: Scope, behind: Behind) -> None:
        match segment:
            case Record(name=name, of=of):
                with self.out.block(f"with n.record({quoted(name)}):"):
                    self.list(of, self._inside(scope, name), behind)
            case Repeat():
                self._repeat(segment, scope, behind)
            case Choose():
                self._choose(segment, scope, behind)
            case Optional(of=of):
                if absent := self._absent(segment):
                    self.out.add(absent)
                with self.out.block(f"if n.rest({self.behind(behind)}, {self.named(segment)}) > 0:"):
                    self.list(of, scope, behind)
                if absent := self._without(of):
                    with self.out.block("else:"):
                        self.out.add(absent)
            case Wrap():
                self._wrap(segment, scope, behind)
            case Inner():
                self._inner(segment, scope, behind)
            case _:
                raise TypeError(f"no segment to examine: {segment!r}")

    @staticmethod
    def _inside(scope: Scope, name: str) -> Scope:
        entry = scope.find(name)
        assert entry is not None and entry.inside is not None
        return entry.inside

    def _behind_option(self, needed: bool, behind: Behind) -> str:
        text = self.behind(behind) if needed else "0"
        return "" if text == "0" else f", behind={text}"

    def _repeat(self, repeat: Repeat, scope: Scope, behind: Behind) -> None:
        name, times = quoted(repeat.name), self.ask(repeat.times, scope)
        option = self._behind_option(repeat.times == "rest", behind)
        if isinstance(repeat.of, FieldType):
            parse = self.parse(repeat.of)
            self.out.add(f"n.values({name}, {times}, {repeat.of.fixed_size}, {parse}{self.refuse(repeat)}{option})")
            return
        with self.out.block(f"for _ in n.items({name}, {times}{option}):"):
            self.list(repeat.of, self._inside(scope, repeat.name), ())

    def _choose(self, choose: Choose, scope: Scope, behind: Behind) -> None:
        numbers = numbers_of(choose.on, scope, self.by_name)
        text = self.writer(scope).text(choose.on)
        if absent := self._absent(choose):
            self.out.add(absent)
        self.out.add(f'case = n.ask(lambda n: {text}, "value", {self.named(choose)})')
        for place, (keys, segments) in enumerate(choose.cases):
            values = tuple(numbers.get(key, key) if isinstance(key, str) else key for key in keys)
            test = f"case == {literal(values[0])}" if len(values) == 1 else f"case in {literal(values)}"
            with self.out.block(f"{'elif' if place else 'if'} {test}:"):
                self._case(choose, segments, scope, behind)
        with self.out.block("else:"):
            if choose.otherwise is not None:
                self._case(choose, choose.otherwise, scope, behind)
            else:
                self.out.add(
                    f'raise n.stop("value", {self.named(choose)}, "one of the cases", str(case){self.refuse(choose)})'
                )

    def _case(self, choose: Choose, segments: tuple[Segment, ...], scope: Scope, behind: Behind) -> None:
        if absent := self._without((choose,), segments):
            self.out.add(absent)
        self.list(segments, scope, behind)

    def _wrap(self, wrap: Wrap, scope: Scope, behind: Behind) -> None:
        fixed = self.shapes.all(wrap.of).fixed
        option = ""
        if wrap.how == "hex":
            open_up = self.module.function("hex_content")
            size = "None" if fixed is None else str(2 * fixed)
            option = self._behind_option(fixed is None, behind)
        else:
            escape = f"{wrap.escape or 0:#04x}"
            open_up = f"lambda raw: {self.module.function('doubled_content')}(raw, {escape})"
            size = "None"
            inside = self.module.embedded(wrap)
            if inside:
                open_up = f"lambda raw: {self.module.function('doubled_content')}(raw, {escape}, {inside})"
            if fixed is not None:
                size = f"lambda n: {self.module.function('end_of_doubled')}(n.data, n.at, {escape}, {fixed}) - n.at"
            elif any(self.shapes.present(segment).fixed != 0 for segment, _ in behind):
                more = f", {inside}" if inside else ""
                size = f"lambda n: {self.module.function('end_of_region')}(n.data, n.at, {escape}{more}) - n.at"
        option += _checks_option(wrap.of)
        with self.out.block(f"with n.inside({self.named(wrap)}, {size}, {open_up}{option}):"):
            self._limits_of(wrap, scope)
            outside, self.deferred = self.deferred, []
            self.region(wrap.of, scope)
            self.deferred = outside

    def _limits_of(self, wrap: Wrap, scope: Scope) -> None:
        refuse = self.refuse(wrap)
        if wrap.least:
            rule = f'"short", {self.named(wrap)}, 0, {quoted(f"at least {wrap.least} bytes")}'
            self.out.add(f"n.expect({rule}, lambda n: n.end >= {wrap.least}{refuse})")
        if wrap.most is not None:
            most = str(wrap.most) if isinstance(wrap.most, int) else self.writer(scope).text(wrap.most, BIT_OR)
            rule = f'"too_long", {self.named(wrap)}, 0, "fewer bytes"'
            self.out.add(f"n.expect({rule}, lambda n: n.end <= {most}{refuse})")

    def _inner(self, inner: Inner, scope: Scope, behind: Behind) -> None:
        choice = self.module.choice(inner.frames, "frames_of", inner.name)
        fixed = self.shapes.present(inner).fixed
        known = all(self.shapes.present(one).fixed is not None and self.is_told(one) for one, _ in behind)
        option = ""
        if isinstance(inner.size, Expression):
            size = self.ask(inner.size, scope)
        elif fixed is not None:
            size = str(fixed)
        elif known or inner.size == "rest":
            size, option = "None", self._behind_option(True, behind)
        else:
            measure = self.module.function("measure_first")
            size = f"lambda n: {measure}({choice}, n.data, n.at, n.end, n.ctx)"
        self.out.add(f"n.inner({quoted(inner.name)}, {size}, {choice}{option})")
