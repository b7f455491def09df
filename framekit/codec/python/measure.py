"""Measuring functions: how long is the frame that begins here, from as many bytes as are there.

They read only what sizes depend on, compare only the constants a frame begins with, and say how many bytes they want at
least, so that nobody has to ask for every single one.
"""

from __future__ import annotations

from collections.abc import Iterator

from framekit.codec.python.branches import default_text, numbers_of
from framekit.codec.python.choices import fixed_bytes
from framekit.codec.python.describe import write_docstring
from framekit.codec.python.expressions import Entry, Scope
from framekit.codec.python.measure_wraps import WrapMeasurer
from framekit.codec.python.measuring import Finished, Pairs
from framekit.codec.python.module import Module
from framekit.codec.python.places import Place
from framekit.codec.python.shape import leading, may_be_empty, names_read
from framekit.codec.python.source import Source, bytes_literal, literal, quoted
from framekit.definition.expression.emit import PRODUCT
from framekit.definition.expression.syntax import Expression
from framekit.definition.model.frames import Frame
from framekit.definition.model.segments import (
    Bits,
    Choose,
    Const,
    Count,
    Data,
    Field,
    FieldType,
    Fill,
    Inner,
    Length,
    Optional,
    Record,
    Repeat,
    Segment,
    Value,
    Wrap,
)
from framekit.definition.model.walk import without_when

MOST = 65_536 + 1_024
"""The longest frame where the definition gives none."""
_HEADER = "data: bytes | bytearray, start: int, end: int, ctx: Context = DEFAULTS, seen: int = 0"


def write_measurer(module: Module, identifier: str, frame: Frame, segments: tuple[Segment, ...]) -> Source:
    """The source of `measure_…` of a frame."""
    writer = MeasureWriter(module, identifier, segments, MOST if frame.most is None else frame.most)
    writer.write(frame)
    return writer.function(f"How long the frame `{frame.name}` at data[start] is; see the top of the module.")


def write_extent(module: Module, identifier: str, frame: Frame, segments: tuple[Segment, ...]) -> Source | None:
    """The source of `extent_…` of a frame that holds another one which decides on its size; None for others.

    It says what `measure_…` says, if everything fits: for those who decode at once what it found.
    """
    writer = ExtentWriter(module, identifier, segments, MOST if frame.most is None else frame.most)
    if not any(isinstance(segment, Inner) for segment in segments):
        return None
    writer.write(frame)
    if not writer.asks_inside:
        return None
    return writer.function(f"What `measure_{identifier}` says if a good frame is at data[start].")


class MeasureWriter(WrapMeasurer):
    """Writes one measuring function."""

    kind = "measure"

    def function(self, sentence: str) -> Source:
        """The function around what was written."""
        out = Source()
        with out.block(f"def {self.kind}_{self.identifier}({_HEADER}) -> int:"):
            write_docstring(out, sentence, "")
            for context, local in self.hoisted.items():
                out.add(f"{local} = {self.module.given(context)}")
                state = self.module.protocol.state.get(context)
                if state is not None and state.announced:
                    with out.block(f"if {local} is None:"):
                        out.add("return 0")
            if self.may_fail:
                with out.block("try:"):
                    out.extend(self.out)
                with out.block("except MISFITS:"):
                    out.add("return LOST")
            else:
                out.extend(self.out)
        return out

    def write(self, frame: Frame | None, scope: Scope | None = None) -> None:
        scope = Scope(scope)
        self._compare_start()
        try:
            if frame is not None and frame.delimited and frame.tail:
                self.list(self.pairs(frame.head, scope), ())
                tail = self.pairs(frame.tail, scope)
                self._to_tail(tail)
                self.list(tail, ())
            elif self.shapes.all(self.segments).fixed is not None and not self.inner_may_misfit():
                self.place = Place("start", self.shapes.all(self.segments).least)
            else:
                self.list(self.pairs(self.segments, scope), ())
            self.return_total()
        except Finished:
            return

    def _compare_start(self) -> None:
        constant = leading(self.shapes, self.segments)
        if len(constant) == 1:
            test = f"start < end and data[start] != {constant[0]:#04x}"
        else:
            begin = f"data[start : min(start + {len(constant)}, end)]"
            test = f"{begin} != {bytes_literal(constant)}[: end - start]"
        if constant:
            with self.out.block(f"if {test}:"):
                self.add("return 0")
        for place, allowed in self._first_bytes():
            if place >= len(constant):
                found = f"data[start + {place}]" if place else "data[start]"
                one = f"!= {min(allowed):#04x}" if len(allowed) == 1 else f"not in {literal(bytes(sorted(allowed)))}"
                with self.out.block(f"if start + {place} < end and {found} {one}:"):
                    self.add("return 0")

    def _first_bytes(self) -> Iterator[tuple[int, frozenset[int]]]:
        """The bytes a frame begins with, as far as constants, `where` and names that may not be others say it.

        Where nothing is read after a bad frame, one that begins otherwise has to be told of: it is no noise.
        """
        if self.module.protocol.receiver.resync == "never":
            return
        allowed: dict[int, frozenset[int]] = {}
        for place, values in fixed_bytes(self.segments):
            allowed[place] = allowed.get(place, values) & values
        for place in range(len(allowed)):
            if place not in allowed or len(allowed[place]) == 256:
                return
            yield place, allowed[place]

    def _to_tail(self, tail: Pairs) -> None:
        """A delimited body ends where the first byte of the tail stands."""
        first = tail[0][0]
        assert isinstance(first, Const)
        self.want(0, tail)
        place = self.place.text("")
        self.add(f"at = {self.search(f'{first.data[0]:#04x}', place, tail)}")
        with self.out.block("if at < 0:"):
            self.not_found(self.least(tail))
        self.looks_for_end = True
        self.place = Place("at", 0)

    # ---- lists --------------------------------------------------------------------------------------------

    def list(self, pairs: Pairs, after: Pairs) -> None:
        """The segments in order. Raises Finished when the rest of the function is written."""
        for place, (segment, scope) in enumerate(pairs):
            behind = (*pairs[place + 1 :], *after)
            if segment.when is not None:
                self._conditional(segment, scope, behind)
            else:
                self._segment(segment, scope, behind)

    def _branch(self, pairs: Pairs, after: Pairs) -> bool:
        """Segments of which it is not sure that they are there; whether nothing behind matters any more."""
        finished = False
        try:
            self.list(pairs, after)
            self.settle()
        except Finished:
            finished = True
        self.place = Place("at", 0)
        return finished

    def _conditional(self, segment: Segment, scope: Scope, behind: Pairs) -> None:
        assert segment.when is not None
        present = without_when(segment)
        names = [name for name in segment.value_names if name in self.needed]
        if self.shapes.present(segment).fixed == 0 and not names:
            return
        condition = self.text(segment.when, scope)
        self.settle()
        with self.out.block(f"if {condition}:"):
            self._branch(self.pairs((present,), scope), behind)
        if isinstance(segment, (Record, Wrap, Choose, Optional)):
            self._else_absent(segment, scope)
            return
        if not names:
            return
        with self.out.block("else:"):
            for name in names:
                text = "None"
                if isinstance(segment, Field) and segment.default is not None:
                    text = default_text(self.text(segment.default, scope), segment)
                else:
                    self.maybe_absent.add(name)
                self.add(f"{scope.entries[name].text} = {text}")

    def _else_absent(self, segment: Segment, scope: Scope) -> None:
        """What has names inside that is not there."""
        out, self.out = self.out, Source()
        self.absent((segment,), scope)
        out, self.out = self.out, out
        if out.lines:
            with self.out.block("else:"):
                self.out.extend(out)

    def _segment(self, segment: Segment, scope: Scope, after: Pairs) -> None:
        match segment:
            case Value(name=name, read=read):
                if name in self.needed:
                    self.set_value(name, scope, self.text(read, scope))
            case Field() | Length() | Count() | Bits():
                self.number(segment, scope, after)
            case Data():
                self.data(segment, scope, after)
            case Repeat():
                self._repeat(segment, scope, after)
            case Choose():
                self._choose(segment, scope, after)
            case Wrap():
                self.wrap(segment, scope, after)
            case Inner():
                self.inner(segment, scope, after)
            case Optional():
                self.rest(segment, after)
            case Fill(total=total):
                self.place = Place("start", total)
                self.return_total()
                raise Finished
            case _:
                self.skip(str(self.shapes.present(segment).fixed or 0))

    # ---- segments with others inside ----------------------------------------------------------------------

    def _repeat(self, repeat: Repeat, scope: Scope, after: Pairs) -> None:
        item = repeat.of.sizes if isinstance(repeat.of, FieldType) else self.shapes.all(repeat.of)
        if repeat.times == "rest":
            self.rest(repeat, after)
        times = str(repeat.times)
        if isinstance(repeat.times, Expression):
            times = self.size_text(repeat.times, scope, PRODUCT + 1)
        if item.fixed is not None and repeat.name not in self.needed:
            whole = str(int(times) * item.fixed) if times.isdigit() else f"{item.fixed} * {times}"
            self.skip(times if item.fixed == 1 else whole)
        elif isinstance(repeat.of, FieldType):
            size = repeat.of.fixed_size or 0
            self.take(f"{size} * {times}", after)
            place = self.names.fresh("place")
            one = self.wire(repeat.of, Place(place, 0), Place(place, size))
            local = self.set_value(repeat.name, scope, f"[{one} for {place} in range(at, stop, {size})]")
            scope.entries[repeat.name] = Entry(local, "list", Scope())
            self.advance("stop")
        else:
            self._records(repeat, repeat.of, scope, times, after)

    def _records(self, repeat: Repeat, of: tuple[Segment, ...], scope: Scope, times: str, after: Pairs) -> None:
        """Items of different size are walked through; what the others take at least is wanted at once."""
        empty, behind = may_be_empty(self.shapes, repeat), self.least(after)
        least = 1 if empty else self.shapes.all(of).least
        if not times.isdigit():
            with self.out.block(f"if {times} > {self.most}:"):
                self.add("return LOST")
        self.settle()
        inside = Scope(scope)
        found = self.set_value(repeat.name, scope, "[]") if repeat.name in self.needed else None
        left = self.names.fresh("left")
        needed = self.needed
        if found is not None:
            inside.entries[repeat.name] = Entry(found, "list", inside)  # the items before this one
            self.needed = needed | names_read(of) | {name for one in of for name in one.value_names}
        with self.out.block(f"for {left} in range({times}, 0, -1):"):
            total = " + ".join([*([f"{least} * {left}"] if least else []), *([str(behind)] if behind else [])])
            if least:
                with self.out.block(f"if end < at + {least}:"):
                    self.add(f"return end - at - ({total})" if behind else f"return end - at - {total}")
            before = self.names.fresh("before")
            if empty:
                self.add(f"{before} = at")
            outside, self.in_list = self.in_list, True
            finished = self._branch(self.pairs(of, inside), ())
            self.in_list = outside
            if finished:
                raise Finished
            if empty:
                with self.out.block(f"if at == {before}:"):
                    self.add("return LOST")
            if found is not None:
                fields = ", ".join(
                    f"{quoted(name)}: {entry.text}" for name, entry in inside.entries.items() if entry.text != found
                )
                self.add(f"{found}.append({{{fields}}})")
        self.needed = needed
        if found is not None:
            scope.entries[repeat.name] = Entry(found, "list", inside)

    def _choose(self, choose: Choose, scope: Scope, after: Pairs) -> None:
        numbers = numbers_of(choose.on, scope, self.by_name)
        case = self.names.fresh("case")
        self.add(f"{case} = {self.text(choose.on, scope)}")
        self.absent((choose,), scope)
        self.settle()
        finished = []
        for place, (keys, of) in enumerate(choose.cases):
            values = tuple(numbers.get(key, key) if isinstance(key, str) else key for key in keys)
            test = f"{case} == {literal(values[0])}" if len(values) == 1 else f"{case} in {literal(values)}"
            with self.out.block(f"{'elif' if place else 'if'} {test}:"):
                finished.append(self._branch(self.pairs(of, scope), after))
        with self.out.block("else:"):
            if choose.otherwise is None:
                self.add("return LOST")
            else:
                finished.append(self._branch(self.pairs(choose.otherwise, scope), after))
        if all(finished):
            raise Finished


class ExtentWriter(MeasureWriter):
    """Writes a measuring function that takes the frame inside at its word."""

    kind = "extent"

    def inner_size(self, size: str, choice: str, measure: str, arguments: str, seen: str) -> None:
        """Without reading it where one byte tells which frame it is."""
        self.add(f"{size} = {self.module.function('extent_first')}({choice}, {arguments})")
