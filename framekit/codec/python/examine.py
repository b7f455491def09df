"""Writers of the careful functions: a list of calls, one a segment, that finds the first fault and where everything is.

What the calls do is `examination`; here they are only put down in the order of the segments.
"""

from __future__ import annotations

from collections.abc import Iterable

from framekit.codec.python import forms
from framekit.codec.python.codes import code_bytes
from framekit.codec.python.describe import write_docstring
from framekit.codec.python.expressions import Entry, ExpressionWriter, Scope, constant_of
from framekit.codec.python.function import span_names
from framekit.codec.python.module import Module
from framekit.codec.python.names import Names
from framekit.codec.python.nested import default_text, numbers_of
from framekit.codec.python.shape import Fill, everything, follows_its_length, is_plain_name, names_read, without_when
from framekit.codec.python.source import Source, bytes_literal, literal, quoted
from framekit.definition.expression.emit import BIT_OR, PRODUCT
from framekit.definition.expression.syntax import Expression, names_in
from framekit.definition.model.frames import Frame
from framekit.definition.model.segments import (
    Bits,
    Check,
    Choose,
    Const,
    Count,
    Data,
    Field,
    FieldType,
    Inner,
    Length,
    Optional,
    Record,
    Repeat,
    Require,
    Segment,
    Skip,
    Value,
    Wrap,
)


def write_examiner(
    module: Module, identifier: str, name: str, segments: tuple[Segment, ...], frame: Frame | None
) -> Source:
    """The source of `examine_…` of a frame or a layout."""
    writer = ExamineWriter(module, segments)
    body = Source()
    surplus = frame.surplus if frame is not None else None
    with body.block("with n.part(" + ("" if surplus is None else f"surplus={surplus:#x}") + "):"):
        writer.out = body
        writer.region(segments, Scope(), frame)
    out = Source()
    with out.block(f"def examine_{identifier}(data: bytes, ctx: Context) -> Examination:"):
        write_docstring(out, f"Read `{name}` carefully: all its places, and the first fault.", "")
        for context, local in writer.hoisted.items():
            out.add(f"{local} = {module.given(context)}")
        out.add(f"n = {module.function('Examination')}(data, ctx)")
        if frame is not None and frame.most is not None:
            with out.block(f"if len(data) > {frame.most}:"):
                out.add(f'n.note("too_long", "frame", {frame.most}, "at most {frame.most} bytes", str(len(data)))')
        out.extend(body)
        out.add("return n")
    return out


class ExamineWriter:
    """Writes the calls of one careful function."""

    def __init__(self, module: Module, segments: tuple[Segment, ...]) -> None:
        self.module = module
        self.shapes = module.shapes
        self.segments = segments
        self.by_name = {segment.name: segment for segment in everything(segments) if segment.name}
        self.out = Source()
        self.names = Names(module.words())
        self.hoisted: dict[str, str] = {}
        self.deferred: list[str] = []
        self.read_names = names_read(segments)
        self.asked_for = self._asked_for()

    def _asked_for(self) -> set[str]:
        """Names of segments without one of their own that a check or a length means."""
        found: set[str] = set()
        for segment in everything(self.segments):
            if isinstance(segment, Check):
                found.update((*(segment.over or ()), *span_names(segment, self.segments)))
            elif isinstance(segment, Length):
                found.update(segment.of)
        return found

    # ---- texts --------------------------------------------------------------------------------------------

    def context(self, name: str) -> str:
        """Context values are fetched once, outside everything that takes errors for faults of the frame."""
        if name not in self.hoisted:
            self.module.context.add(name)
            self.hoisted[name] = self.names.fresh(name)
        return self.hoisted[name]

    def writer(self, scope: Scope) -> ExpressionWriter:
        return ExpressionWriter(self.module, scope, self.context)

    def ask(self, what: int | Expression | str, scope: Scope, factor: str = "") -> str:
        """A number, or a function of `n` that gives it; `rest` is None."""
        if what == "rest":
            return "None"
        if isinstance(what, int):
            return str(eval(f"{what}{factor}")) if factor else str(what)
        assert isinstance(what, Expression)
        return f"lambda n: {self.writer(scope).text(what, PRODUCT if factor else 0)}{factor}"

    def behind(self, after: tuple[tuple[Segment, Scope], ...]) -> str:
        """Text of the bytes behind a segment that reaches to the end; a `lambda` if some may be absent."""
        fixed, parts = 0, []
        for segment, scope in after:
            size = self.shapes.present(segment).fixed
            if size is None:
                return self._constant_behind(after[0][0])
            if segment.when is None:
                fixed += size
            elif size:
                parts.append(f"({size} if {self.writer(scope).text(segment.when, BIT_OR)} else 0)")
        if not parts:
            return str(fixed)
        return "lambda n: " + " + ".join([*([str(fixed)] if fixed else []), *parts])

    def _constant_behind(self, segment: Segment) -> str:
        data = segment.data if isinstance(segment, Const) else b""
        return f"lambda n: n.end - n.data.index({bytes_literal(data)}, n.at, n.end)"

    def named(self, segment: Segment) -> str:
        """A segment's name as the careful functions know it: its kind, if it has no name and nobody asks for it."""
        name = segment.name or ""
        if name and (not name.startswith("_") or name in self.asked_for):
            return quoted(name)
        return quoted(type(segment).__name__.lower())

    @staticmethod
    def refuse(segment: Segment) -> str:
        return "" if segment.refuse is None else f", refuse={segment.refuse:#x}"

    # ---- lists --------------------------------------------------------------------------------------------

    def region(self, segments: tuple[Segment, ...], scope: Scope, frame: Frame | None = None) -> None:
        """A whole buffer. What stands behind its last variable part is read from the end, whatever came before."""
        self._declare(segments, scope)
        front, tail = self.shapes.split(segments)
        has_bytes = any(self.shapes.present(segment).fixed != 0 for segment in tail)
        if not has_bytes or not self._known_before(front, tail):
            self.list(segments, scope, ())
        else:
            first = next(place for place, segment in enumerate(front) if self.shapes.is_variable(segment))
            self.list(front[:first], scope, (), finish=False)
            behind = tuple((segment, scope) for segment in tail)
            surplus = "" if frame is None or frame.surplus is None else f", surplus={frame.surplus:#x}"
            with self.out.block(f"with n.part({self.behind(behind)}{surplus}):"):
                self.list(front[first:], scope, (), finish=False)
            self.list(tail, scope, (), finish=False)
        self.finish()

    def _known_before(self, front: tuple[Segment, ...], tail: tuple[Segment, ...]) -> bool:
        """Whether the size of the tail can be told before the first variable segment is read."""
        late: set[str] = set()
        variable = False
        for segment in front:
            variable = variable or self.shapes.is_variable(segment)
            if variable:
                late.update(name for one in everything((segment,)) for name in self._names(one))
        wanted = {name for segment in tail if segment.when is not None for name in names_in(segment.when.root)}
        own = {name for segment in everything(tail) for name in self._names(segment)}
        return not wanted & (late | own)

    @staticmethod
    def _names(segment: Segment) -> tuple[str, ...]:
        from framekit.codec.python.shape import value_names

        return value_names(segment)

    def list(
        self,
        segments: Iterable[Segment],
        scope: Scope,
        after: tuple[tuple[Segment, Scope], ...],
        finish: bool = True,
    ) -> None:
        """The segments of a list; `after`: what follows them in the buffer."""
        segments = tuple(segments)
        for place, segment in enumerate(segments):
            behind = (*((other, scope) for other in segments[place + 1 :]), *after)
            if segment.when is not None:
                self._conditional(segment, scope, behind)
            else:
                self._segment(segment, scope, behind)
        if finish:
            self.finish()

    def finish(self) -> None:
        """Comparisons that need what comes later."""
        deferred, self.deferred = self.deferred, []
        for line in deferred:
            self.out.add(line)

    def _conditional(self, segment: Segment, scope: Scope, behind: tuple[tuple[Segment, Scope], ...]) -> None:
        assert segment.when is not None
        condition = f'n.ask(lambda n: {self.writer(scope).text(segment.when)}, "value", {self.named(segment)})'
        with self.out.block(f"if {condition}:"):
            self._segment(without_when(segment), scope, behind)
        if isinstance(segment, Field) and segment.default is not None:
            default = default_text(self.writer(scope).value(segment.default), segment)
            with self.out.block("else:"):
                self.out.add(f"n.absent({quoted(segment.name)}, lambda n: {default})")

    # ---- names --------------------------------------------------------------------------------------------

    def _declare(self, segments: Iterable[Segment], scope: Scope) -> None:
        """Every field of a list by `n["name"]`."""
        for segment in segments:
            match segment:
                case Wrap(of=of) | Optional(of=of):
                    self._declare(of, scope)
                case Choose(cases=cases, otherwise=otherwise):
                    for _, case in cases:
                        self._declare(case, scope)
                    self._declare(otherwise or (), scope)
                case Bits(parts=parts):
                    for part in parts:
                        self._entry(scope, part.name, Entry(f'n["{part.name}"]'))
                    if segment.name:
                        self._entry(
                            scope, segment.name, Entry("0", sized=False, wire=f"n.room({quoted(segment.name)})")
                        )
                case Record(name=name, of=of):
                    inside = Scope(scope)
                    self._declare(of, inside)
                    self._entry(scope, name, Entry(f'n["{name}"]', "record", inside))
                case Repeat(name=name, of=of):
                    inside = Scope(scope)
                    if isinstance(of, tuple):
                        self._declare(of, inside)
                    self._entry(scope, name, Entry(f'n["{name}"]', "list", inside))
                case Inner(name=name):
                    self._entry(scope, name, Entry(f'n["{name}"]', "inner"))
                case Data(name=name) | Value(name=name):
                    self._entry(scope, name, Entry(f'n["{name}"]'))
                case Field(name=name, type=type_) | Length(name=name, type=type_) | Count(name=name, type=type_):
                    sized = type_.kind in ("ascii", "bytes")
                    entry = Entry(f'n["{name}"]', sized=sized, wire=f"n.room({quoted(name)})")
                    self._entry(scope, name, entry)

    @staticmethod
    def _entry(scope: Scope, name: str, entry: Entry) -> None:
        scope.entries[name] = entry

    # ---- segments -----------------------------------------------------------------------------------------

    def _segment(self, segment: Segment, scope: Scope, behind: tuple[tuple[Segment, Scope], ...]) -> None:
        add, name, refuse = self.out.add, self.named(segment), self.refuse(segment)
        match segment:
            case Const(data=data):
                add(f"n.const({name}, {bytes_literal(data)}{refuse})")
            case Skip(size=size):
                add(f"n.skip({name}, {size})")
            case Fill():
                add(f'n.skip("fill", n.rest({self.behind(behind)}, "fill"))')
            case Field():
                self._field(segment, scope, behind)
            case Length() | Count():
                self._counted(segment, scope)
            case Bits():
                self._bits(segment, scope)
            case Data():
                self._data(segment, scope, behind)
            case Value(read=read):
                self._later_or_now(read, scope, f"n.value({name}, lambda n: {self.writer(scope).value(read)}{refuse})")
            case Require(condition=condition):
                text = self.writer(scope).text(condition)
                line = f"n.require({quoted(condition.text)}, lambda n: {text}{refuse})"
                self.out.add(line)
            case Check():
                self._check(segment)
            case _:
                self._nested(segment, scope, behind)

    def _later_or_now(self, expression: Expression, scope: Scope, line: str) -> None:
        self.out.add(line)

    def _parse(self, type_: FieldType, number: Field | Length | Count | None = None) -> str:
        """A function from the bytes on the wire to the value."""
        wire = forms.parse(self.module, type_, "raw")
        if number is None or not forms.changes_value(number):
            return f"lambda raw: {wire}"
        if number.zero_means is not None and not (isinstance(number, Field) and (number.plus or number.unit)):
            return f"lambda raw: {wire} or {number.zero_means}"
        text = forms.value_of(number, wire)
        if number.zero_means is not None:
            text = forms.value_of(number, "wire")
            return f"lambda raw: (lambda wire: {text})({wire})"
        return f"lambda raw: {text}"

    def _rules(self, field: Field) -> str:
        rules = ""
        if field.constants is not None:
            rules = f', among={literal(field.constants)}, cause="where"'
        elif field.is_ is not None and (number := constant_of(field.is_)) is not None:
            rules = f", among=({number},)"
        elif field.only and field.values is not None:
            rules = f", among={literal(tuple(field.values))}"
        if field.limits is not None:
            rules += f", limits={literal(field.limits)}"
        return rules

    def _field(self, field: Field, scope: Scope, behind: tuple[tuple[Segment, Scope], ...]) -> None:
        name, type_ = quoted(field.name), field.type
        behind_it = f"{self.refuse(field)}{self._rules(field)})"
        if field.long is not None:
            longer = FieldType(**{slot: getattr(field.long.type, slot) for slot in FieldType.__slots__})
            self.out.add(
                f"n.long({name}, {type_.fixed_size}, {self._parse(type_, field)}, {field.long.mark:#x},"
                f" {longer.fixed_size}, {self._parse(longer, field)}{behind_it}"
            )
        elif type_.size is None and type_.end is not None:
            plain = FieldType("ascii", None, pad=type_.pad)
            self.out.add(f"n.until({name}, {bytes_literal(type_.end)}, {self._parse(plain, field)}{behind_it}")
        elif type_.size is None:
            size = f"lambda n: n.rest({self.behind(behind)}, {name})"
            self.out.add(f"n.field({name}, {size}, {self._parse(type_, field)}{behind_it}")
        else:
            self.out.add(f"n.field({name}, {self.ask(type_.size, scope)}, {self._parse(type_, field)}{behind_it}")
        if field.is_ is not None and (field.constants is not None or constant_of(field.is_) is None):
            wanted = self.writer(scope).value(field.is_)
            self.deferred.append(f'n.same("value", {name}, lambda n: {wanted}{self.refuse(field)})')

    def _counted(self, number: Length | Count, scope: Scope) -> None:
        limits = "" if number.limits is None else f", limits={literal(number.limits)}"
        name = quoted(number.name)
        size = self.ask(number.type.size if number.type.size is not None else 0, scope)
        self.out.add(f"n.field({name}, {size}, {self._parse(number.type, number)}{self.refuse(number)}{limits})")
        wanted = self._wanted_length(number) if isinstance(number, Length) else self._wanted_count(number)
        if wanted is not None:
            plus = "" if not number.plus else f" + {number.plus}" if number.plus > 0 else f" - {-number.plus}"
            self.deferred.append(f'n.same("length", {name}, lambda n: {wanted}{plus}{self.refuse(number)})')

    def _wanted_length(self, length: Length) -> str | None:
        targets = [self.by_name[name] for name in length.of if name in self.by_name]
        if len(targets) == 1 and follows_its_length(length, targets[0]):
            return None
        converted = [t for t in targets if length.plain and isinstance(t, Data) and t.convert is not None]
        rooms = [quoted(name) for name in length.of if name not in {target.name for target in converted}]
        parts = [f"n.room({', '.join(rooms)})"] if rooms else []
        parts += [f'len(n["{target.name}"])' for target in converted]
        total = " + ".join(parts) or "0"
        if length.unit != 1:
            total = f"({total}) // {length.unit}" if len(parts) > 1 else f"{total} // {length.unit}"
        return total

    def _wanted_count(self, count: Count) -> str | None:
        repeat = self.by_name.get(count.of)
        if not isinstance(repeat, Repeat) or (count.plus == 0 and is_plain_name(repeat.times, count.name)):
            return None
        return f'len(n["{count.of}"])'

    def _bits(self, bits: Bits, scope: Scope) -> None:
        parts = {part.name: (part.low, (1 << part.high - part.low + 1) - 1) for part in bits.parts}
        among: dict[str, tuple[tuple[int, ...], str]] = {}
        for part in bits.parts:
            if part.constants is not None:
                among[part.name] = part.constants, "where"
            elif part.is_ is not None and (number := constant_of(part.is_)) is not None:
                among[part.name] = (number,), "value"
            if part.is_ is not None and part.name not in among:
                wanted = self.writer(scope).value(part.is_)
                self.deferred.append(f'n.same("value", {quoted(part.name)}, lambda n: {wanted}{self.refuse(bits)})')
        rules = f", among={literal(among)}" if among else ""
        size = self.ask(bits.type.size if bits.type.size is not None else 0, scope)
        self.out.add(
            f"n.bits({self.named(bits)}, {size}, {self._parse(bits.type)}, {literal(parts)}{self.refuse(bits)}{rules})"
        )

    def _data(self, data: Data, scope: Scope, behind: tuple[tuple[Segment, Scope], ...]) -> None:
        factor = {"hex_to_ascii": " * 2", "ascii_to_hex": " // 2", None: ""}[data.convert]
        options = self.refuse(data)
        if data.size == "rest" and (bytes_behind := self.behind(behind)) != "0":
            options += f", behind={bytes_behind}"
        if data.least:
            options += f", least={data.least}"
        parse = f"lambda raw: {forms.memory_text(self.module, data, 'raw')}"
        self.out.add(f"n.data_field({quoted(data.name)}, {self.ask(data.size, scope, factor)}, {parse}{options})")

    def _check(self, check: Check) -> None:
        if check.over is not None:
            covered = f"n.bytes_of({', '.join(quoted(name) for name in check.over)})"
        elif check.span is not None and check.span[1] == "here" and self._in_one_buffer(check):
            covered = f"n.bytes_from({quoted(span_names(check, self.segments)[0])})"
        elif check.span is not None:
            names = [name for name in span_names(check, self.segments) if self._takes_bytes(name)]
            covered = f"n.bytes_of({', '.join(quoted(name) for name in names)})"
        else:
            covered = "n.data[: n.at]"
        code = code_bytes(self.module, check, covered)
        options = ", digits=True" if check.form in ("hex", "HEX") else ""
        options += "" if check.verify == "error" else ", verify=False"
        if check.verify == "off":
            self.out.add(f"n.skip({self.named(check)}, {check.size})")
        else:
            self.out.add(f"n.check({self.named(check)}, {check.size}, lambda n: {code}{options})")

    def _in_one_buffer(self, check: Check) -> bool:
        """Whether a check stands in the same buffer as everything it covers."""
        return any(
            check in segments and any(segment.name == span_names(check, self.segments)[0] for segment in segments)
            for segments in self._buffers(self.segments)
        )

    def _buffers(self, segments: tuple[Segment, ...]) -> Iterable[tuple[Segment, ...]]:
        yield segments
        for segment in segments:
            if isinstance(segment, Wrap):
                yield from self._buffers(segment.of)

    def _takes_bytes(self, name: str) -> bool:
        return not isinstance(self.by_name.get(name), (Value, Require))

    # ---- segments with others inside ----------------------------------------------------------------------

    def _nested(self, segment: Segment, scope: Scope, behind: tuple[tuple[Segment, Scope], ...]) -> None:
        match segment:
            case Record(name=name, of=of):
                with self.out.block(f"with n.record({quoted(name)}):"):
                    self.list(of, self._inside(scope, name), behind)
            case Repeat():
                self._repeat(segment, scope, behind)
            case Choose():
                self._choose(segment, scope, behind)
            case Optional(of=of):
                with self.out.block(f"if n.rest({self.behind(behind)}, {self.named(segment)}) > 0:"):
                    self.list(of, scope, behind)
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

    def _behind_option(self, needed: bool, behind: tuple[tuple[Segment, Scope], ...]) -> str:
        text = self.behind(behind) if needed else "0"
        return "" if text == "0" else f", behind={text}"

    def _repeat(self, repeat: Repeat, scope: Scope, behind: tuple[tuple[Segment, Scope], ...]) -> None:
        name, times = quoted(repeat.name), self.ask(repeat.times, scope)
        option = self._behind_option(repeat.times == "rest", behind)
        if isinstance(repeat.of, FieldType):
            parse = self._parse(repeat.of)
            self.out.add(f"n.values({name}, {times}, {repeat.of.fixed_size}, {parse}{self.refuse(repeat)}{option})")
            return
        with self.out.block(f"for _ in n.items({name}, {times}{option}):"):
            self.list(repeat.of, self._inside(scope, repeat.name), ())

    def _choose(self, choose: Choose, scope: Scope, behind: tuple[tuple[Segment, Scope], ...]) -> None:
        numbers = numbers_of(choose.on, scope, self.by_name)
        text = self.writer(scope).text(choose.on)
        self.out.add(f'case = n.ask(lambda n: {text}, "value", {self.named(choose)})')
        for place, (keys, segments) in enumerate(choose.cases):
            values = tuple(numbers.get(key, key) if isinstance(key, str) else key for key in keys)
            test = f"case == {literal(values[0])}" if len(values) == 1 else f"case in {literal(values)}"
            with self.out.block(f"{'elif' if place else 'if'} {test}:"):
                self.list(segments, scope, behind)
        with self.out.block("else:"):
            if choose.otherwise is not None:
                self.list(choose.otherwise, scope, behind)
            else:
                self.out.add(
                    f'raise n.stop("value", {self.named(choose)}, "one of the cases", str(case){self.refuse(choose)})'
                )

    def _wrap(self, wrap: Wrap, scope: Scope, behind: tuple[tuple[Segment, Scope], ...]) -> None:
        fixed = self.shapes.all(wrap.of).fixed
        option = ""
        known = all(self.shapes.present(segment).fixed is not None for segment, _ in behind)
        if wrap.how == "hex":
            open_up = self.module.function("hex_content")
            size = "None" if fixed is None else str(2 * fixed)
            option = self._behind_option(fixed is None, behind)
        else:
            escape = f"{wrap.escape or 0:#04x}"
            open_up = f"lambda raw: {self.module.function('doubled_content')}(raw, {escape})"
            size = "None"
            if known:
                option = self._behind_option(True, behind)
            elif fixed is not None:
                size = f"lambda n: {self.module.function('end_of_doubled')}(n.data, n.at, {escape}, {fixed}) - n.at"
            else:
                size = f"lambda n: {self.module.function('end_of_region')}(n.data, n.at, {escape}) - n.at"
        with self.out.block(f"with n.inside({self.named(wrap)}, {size}, {open_up}{option}):"):
            self._limits_of(wrap, scope)
            deferred, self.deferred = self.deferred, []
            self.region(wrap.of, scope)
            self.deferred = deferred

    def _limits_of(self, wrap: Wrap, scope: Scope) -> None:
        refuse = self.refuse(wrap)
        if wrap.least:
            rule = f'"short", {self.named(wrap)}, 0, "at least {wrap.least} bytes"'
            self.out.add(f"n.expect({rule}, lambda n: n.end >= {wrap.least}{refuse})")
        if wrap.most is not None:
            most = str(wrap.most) if isinstance(wrap.most, int) else self.writer(scope).text(wrap.most, BIT_OR)
            rule = f'"too_long", {self.named(wrap)}, 0, "fewer bytes"'
            self.out.add(f"n.expect({rule}, lambda n: n.end <= {most}{refuse})")

    def _inner(self, inner: Inner, scope: Scope, behind: tuple[tuple[Segment, Scope], ...]) -> None:
        choice = self.module.choice(inner.frames, "frames_of", inner.name)
        fixed = self.shapes.present(inner).fixed
        known = all(self.shapes.present(segment).fixed is not None for segment, _ in behind)
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
