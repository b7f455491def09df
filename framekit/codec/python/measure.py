"""Write measuring functions: the length of the frame that begins at an offset, from the bytes available so far.

They read only values that sizes depend on, compare only the constants at the start of a frame, and return how many more
bytes they need at least, so that they are not called for every byte. The kinds of segments write how they are passed.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from framekit.codec.python import forms
from framekit.codec.python.choices import fixed_bytes
from framekit.codec.python.expressions import FieldScope, NameEntry, default_text, entries_read, may_fail
from framekit.codec.python.facts import (
    code_before_end,
    ending_checks,
    fixed_and_conditional,
    leading,
    looks_inside,
    whole_constant,
)
from framekit.codec.python.function import FunctionWriter, Offset, between, covered_paths, index
from framekit.codec.python.module import Module
from framekit.codec.python.registry import kind_of, write_docstring
from framekit.codec.python.source import Source, bytes_literal, literal, quoted
from framekit.definition.expression import SUM, Attribute, Expression, names_in, walk
from framekit.definition.model.frames import Frame, bytes_of, everything, flat, without_when
from framekit.definition.model.segments import (
    PREVIOUS,
    Bits,
    Check,
    Const,
    Count,
    Field,
    FieldType,
    Inner,
    ItemEnd,
    Length,
    Repeat,
    Segment,
    Value,
)

Pairs = tuple[tuple[Segment, FieldScope], ...]
"""Segments, each with the scope of its names."""


class Finished(Exception):  # noqa: N818 - control flow, not an error
    """Raised when the rest of the function is written.

    Later segments do not affect the length, or the length cannot be computed.
    """


Number = Field | Length | Count | Bits
"""The segments that hold a number."""
MOST = 65_536 + 1_024
"""The longest frame in bytes if the definition sets no limit."""
_HEADER = "data: bytes | bytearray, start: int, end: int, ctx: Context = DEFAULTS, seen: int = 0"


def write_measurer(module: Module, identifier: str, frame: Frame, segments: tuple[Segment, ...]) -> Source:
    """Return the source of `measure_…` of a frame."""
    writer = MeasureWriter(module, identifier, segments, MOST if frame.most is None else frame.most)
    writer.write(frame)
    return writer.function(f"Measure the frame `{frame.name}` at data[start]; see the top of the module.")


def write_extent(module: Module, identifier: str, frame: Frame, segments: tuple[Segment, ...]) -> Source | None:
    """Return the source of `extent_…` of a frame whose size depends on an inner frame; None for other frames.

    If the frame is valid, it returns the result of `measure_…`; the frame is decoded immediately afterwards.
    """
    writer = ExtentWriter(module, identifier, segments, MOST if frame.most is None else frame.most)
    if not any(isinstance(segment, Inner) for segment in segments):
        return None
    writer.write(frame)
    if not writer.asks_inside:
        return None
    return writer.function(f"Return the result of `measure_{identifier}` for a valid frame at data[start].")


class MeasureWriter(FunctionWriter):
    """Write a measuring function.

    `place` is relative to `start` while the offset is fixed, then it is the local `at`.
    """

    kind = "measure"
    asks_inside = False
    """Whether the size depends on an inner frame."""

    def __init__(self, module: Module, identifier: str, segments: tuple[Segment, ...], most: int) -> None:
        super().__init__(module, segments)
        self.identifier = identifier
        self.most = most
        self.may_fail = False
        self.place = Offset("start", 0)
        self.sure = 0
        self.needed = needed_names(segments)
        self.maybe_absent: set[str] = set()
        self.paths: dict[int, str] = {}
        self.anew = False
        """Whether `seen` does not apply to the current part, so that searches begin at its start."""
        self.in_digits = False
        self.looks_for_end = False
        self.item_ends = ""
        """The source of the condition that ends a list after the current item."""
        self.tracked = {path for check in ending_checks(segments) for path in covered_paths(check, segments)}
        self.passed: list[tuple[str, Offset, Offset]] = []

    def pairs(self, segments: tuple[Segment, ...], scope: FieldScope) -> Pairs:
        """Return the segments with those of records inlined."""
        found: list[tuple[Segment, FieldScope]] = []
        for segment in segments:
            if segment.is_record and segment.when is None:
                found.extend(self.pairs(segment.members, self._inside(segment, scope)))
            else:
                found.append((segment, scope))
        return tuple(found)

    def _inside(self, record: Segment, scope: FieldScope) -> FieldScope:
        """Return the scope of a record, shared by records of the same name in several cases."""
        (name,) = record.value_names
        known = scope.entries.get(name)
        inside = FieldScope(scope, record.members) if known is None or known.inside is None else known.inside
        scope.entries[name] = NameEntry(name, "record", inside, direct=True)
        self.paths[id(inside)] = f"{self.path_of(scope)}[{quoted(name)}]"
        return inside

    def path_of(self, scope: FieldScope) -> str:
        """Return the source of the mapping in which the careful function stores the values of a scope."""
        return self.paths.get(id(scope), "fields")

    def absent(self, segments: Iterable[Segment], scope: FieldScope, wrapped: bool = False) -> None:
        """Write None into needed names whose segments may be absent.

        `wrapped`: the segments are in a wrap, whose records are read as single values.
        """
        for segment in segments:
            if segment.is_record and not wrapped:
                self.absent(segment.members, self._inside(segment, scope))
                continue
            for name in segment.value_names:
                if name in self.needed:
                    self.maybe_absent.add(name)
                    self.set_value(name, scope, "None", segment if segment.is_record else None)
            for block in segment.blocks:
                self.absent(block, scope, wrapped or segment.is_there_inside)

    # ---- texts --------------------------------------------------------------------------------------------

    def text(self, expression: Expression, scope: FieldScope, level: int = 0) -> str:
        """Return the source of an expression; if it can fail, the function will return LOST on an error."""
        if may_fail(expression.root) or _names_of(expression) & self.maybe_absent:
            self.may_fail = True
        return self.writer(scope).text(expression, level)

    def size_text(self, expression: Expression, scope: FieldScope, level: int = SUM) -> str:
        """Return the source of a size, with a check for negative values.

        A negative size ends the frame with LOST, or with 0 if no field of the frame is part of it.
        """
        text = self.text(expression, scope, level)
        if not self.may_be_negative(expression.root):
            return text
        local = self.names.fresh("length")
        self.add(f"{local} = {self.text(expression, scope)}")
        by_fields = any(scope.find(name) is not None for name in names_in(expression.root))
        with self.out.block(f"if {local} < 0:"):
            self.add("return LOST" if by_fields else "return 0")
        return local

    def set_value(self, name: str, scope: FieldScope, text: str, record: Segment | None = None) -> str:
        """Write the assignment of a value to the local of its name.

        All fields of a `record` are in one local, which may be None.
        """
        known = scope.entries.get(name)
        local = self.names.fresh(name) if known is None or known.direct else known.text
        scope.entries[name] = NameEntry(local) if record is None else _whole(local, record)
        self.add(f"{local} = {text}")
        return local

    # ---- places and wants ---------------------------------------------------------------------------------

    def least(self, after: Pairs) -> int:
        """Return the minimum size of the segments in bytes."""
        return sum(self.static.of(segment).least for segment, _ in after)

    def want(self, size: int, after: Pairs) -> None:
        """Write a return of the number of missing bytes unless `size` more bytes are available."""
        least = size + self.least(after)
        if self.place.base == "start":
            wanted = self.place.offset + size
            if wanted > self.sure:
                self.sure = wanted
                with self.out.block(f"if end - start < {wanted}:"):
                    self.add(f"return end - start - {self.place.offset + least}")
            return
        place = self.place.text("")
        more = f"end - {place} - {least}" if " " not in place else f"end - ({place}) - {least}"
        with self.out.block(f"if end < {place} + {size}:"):
            if self._is_bounded():
                self.add(f"return {more}")
            else:
                self.add(f"return {more} if {place} - start + {least} <= {self.most} else LOST")

    def _is_bounded(self) -> bool:
        """Return whether every such frame is short enough, regardless of its values."""
        longest = self.static.all(self.segments).most
        return longest is not None and longest <= self.most

    def want_until(self, local: str, after: Pairs) -> None:
        """Write a return of the number of missing bytes unless the bytes up to the offset `local` are available."""
        least = self.least(after)
        behind = f" + {least}" if least else ""
        with self.out.block(f"if end < {local}:"):
            back = f" - {least}" if least else ""
            self.add(f"return end - {local}{back} if {local} - start{behind} <= {self.most} else LOST")

    def advance(self, text: str) -> None:
        if text != "at":
            further = text.removeprefix("at + ")
            self.add(f"at = {text}" if further == text else f"at += {further}")
        self.place = Offset("at", 0)

    def settle(self) -> None:
        """Move the offset into its local."""
        if self.place != Offset("at", 0):
            self.advance(self.place.text(""))

    def skip(self, size: str) -> None:
        """Move on by a size without reading bytes."""
        if size.isdigit():
            self.place = self.place.plus(int(size))
        else:
            self.advance(f"{self.place.text('')} + {size}")

    def resume(self, after: Pairs, overlap: int = 0) -> str | None:
        """Return the source of the offset at which a search continues; None if it must begin anew.

        An earlier call may have found the end and requested the bytes after it, so that many bytes are searched again.
        """
        most = self.static.all(segment for segment, _ in after).most
        if most is None or self.anew:
            return None
        return f"start + seen - {most + overlap}" if most + overlap else "start + seen"

    def search(self, what: str, place: str, after: Pairs, overlap: int = 0) -> str:
        """Return the source of the offset of some bytes from `place` on, -1 if they are missing."""
        resume = self.resume(after, overlap)
        return f"data.find({what}, {place if resume is None else f'max({place}, {resume})'}, end)"

    def not_found(self, least: int) -> None:
        """Write the return for an end that has not arrived yet; at least `least` bytes arrive with it."""
        self.looks_for_end = True
        self.add(f"return -{least} if end - start + {least} <= {self.most} else LOST")

    def return_total(self) -> None:
        """Write the return of the length for a frame that ends at the current offset."""
        if self.place.base == "start":
            total = str(self.place.offset)
            self.add(f"return {total} if end - start >= {total} else end - start - {total}")
            return
        self.add(f"size = {self.place.text('')} - start")
        longest = self.static.all(self.segments).most
        if self.looks_for_end or longest is None or longest > self.most:
            with self.out.block(f"if size > {self.most}:"):
                self.add("return LOST")
        self.add("return size if size <= end - start else end - start - size")

    def number(self, segment: Number, scope: FieldScope, after: Pairs) -> None:
        needed = any(name in self.needed for name in segment.value_names)
        type_ = segment.type
        if isinstance(segment, Field) and segment.long is not None:
            self._long(segment, scope, after)
        elif isinstance(type_.size, Expression):
            size = self.size_text(type_.size, scope)
            if needed:
                self.take(size, after)
                self._read(segment, scope, Offset("at", 0), Offset("stop", 0))
                self.advance("stop")
            else:
                self.skip(size)
        elif type_.size is None:
            self._text(segment, scope, after, needed)
        else:
            if needed:
                self.want(type_.size, after)
                self._read(segment, scope, self.place, self.place.plus(type_.size))
            self.skip(str(type_.size))

    def take(self, size: str, after: Pairs) -> None:
        """Write the assignment of the end of a segment that must be read to `stop`."""
        self.settle()
        self.add(f"stop = at + {size}")
        self.want_until("stop", after)

    def _read(self, segment: Number, scope: FieldScope, first: Offset, last: Offset) -> None:
        wire = self.wire(segment.type, first, last)
        if isinstance(segment, Bits):
            whole = self.names.fresh("bits")
            self.add(f"{whole} = {wire}")
            for part in segment.parts:
                if part.name in self.needed:
                    mask = (1 << part.high - part.low + 1) - 1
                    self.set_value(part.name, scope, f"{whole} >> {part.low} & {mask:#x}")
            return
        if segment.zero_means is not None:
            wire = self.set_value(segment.name, scope, wire)
        local = self.set_value(segment.name, scope, forms.value_of(segment, wire))
        if segment.limits is not None and segment.refuse is None:
            with self.out.block(f"if not {segment.limits[0]} <= {local} <= {segment.limits[1]}:"):
                self.add("return LOST")

    def wire(self, type_: FieldType, first: Offset, last: Offset) -> str:
        if type_.kind == "int" and type_.fixed_size == 1 and not type_.signed:
            return index("data", first)
        self.may_fail = self.may_fail or type_.kind in (
            "digits",
            "bcd",
            "hex_int",
            "hex_float",
            "decimal",
            "fraction",
            "scaled",
        )
        return forms.parse(self.module, type_.before_end, between("data", first, last))

    def _long(self, field: Field, scope: FieldScope, after: Pairs) -> None:
        assert field.long is not None
        short, longer = field.type.fixed_size or 1, field.long.type.fixed_size or 0
        self.want(short, after)
        local = self.set_value(field.name, scope, self.wire(field.type, self.place, self.place.plus(short)))
        self.advance(self.place.plus(short).text(""))
        with self.out.block(f"if {local} == {field.long.mark:#x}:"):
            if field.name in self.needed:
                self.want(longer, after)
                wire = self.wire(field.long.type, self.place, self.place.plus(longer))
                self.add(f"{local} = {wire}")
            self.add(f"at += {longer}")
        if field.name in self.needed and forms.changes_value(field):
            self.add(f"{local} = {forms.value_of(field, local)}")

    def _text(self, segment: Number, scope: FieldScope, after: Pairs, needed: bool) -> None:
        """Measure a text with an end mark, or a text that takes the rest."""
        type_ = segment.type
        if not type_.is_delimited:
            self.rest(segment, after)
            return
        self.settle()
        self.search_end(type_, after)
        with self.out.block("if stop < 0:"):
            begun = max(map(len, type_.stops), default=0)  # all bytes of a delimiter except the last may have arrived
            self.not_found(max(1 + self.least(after) - begun, 1))
        if needed and isinstance(segment, Field):
            self._read(segment, scope, Offset("at", 0), Offset("stop", 0))
        self.advance(f"stop + {len(type_.end)}" if type_.end is not None else "stop")

    def search_end(self, type_: FieldType, after: Pairs) -> None:
        """Write the assignment of the offset of the delimiter, or -1, to `stop`; the value begins at `at`."""
        if type_.end is not None:
            self.add(f"stop = {self.search(bytes_literal(type_.end), 'at', after, len(type_.end))}")
            return
        resume = self.resume(after, max(map(len, type_.stops)))
        start = "at" if resume is None else f"max(at, {resume})"
        self.add(f"stop = {self.module.function('find_stop')}(data, {forms.stops_literal(type_)}, {start}, end)")

    # ---- what ends by what follows ------------------------------------------------------------------------

    def rest(self, segment: Segment, after: Pairs) -> None:
        """Measure a part that extends to a later constant at which the whole frame fits, or else to silence.

        The parts before the constant, such as a check code, have a fixed size and are counted backwards from it.
        """
        place = self._constant(after)
        if place is None:
            self._until_silence(after)
            return
        first, before, behind = after[place][0], self._size_of(after[:place]), self._size_of(after[place:])
        assert isinstance(first, Const)
        may_hold = first.data[0] in bytes_of([segment, *(one for one, _ in after[:place])], self.static.frames)
        is_tried = may_hold and any(isinstance(one, Check) for one, _ in after)
        constant = whole_constant(one for one, _ in after[place:]) if is_tried else first.data
        self.settle()
        self.add(f"behind = {behind}")
        self.add(f"at = max({'at' if before == '0' else f'at + {before}'}, start + seen - behind)")
        with self.out.block(f"while (at := data.find({bytes_literal(constant)}, at, end)) >= 0:"):
            self.add("size = at - start + behind")
            with self.out.block(f"if size > {self.most}:"):
                self.add("return LOST")
            with self.out.block("if size > end - start:"):
                self.add("return end - start - size")
            if not is_tried:
                self.add("return size")
            else:
                ends_here = self.module.function("ends_here")
                whole = "bytes(data[start : start + size])"
                tail = "at - start" if before == "0" else f"at - start - ({before})"
                fits = f"{ends_here}(decode_{self.identifier}, {whole}, ctx, {tail})"
                with self.out.block(f"if {self._code_before(after[:place])}{fits}:"):
                    self.add("return size")
                self.add("at += 1")
        self.not_found(1)
        raise Finished

    def _code_before(self, before: Pairs) -> str:
        """Return the condition that the check code directly before `at` is correct, followed by `and`.

        Empty if only decoding can verify the code.
        """
        check = code_before_end([one for one, _ in before])
        if check is None:
            return ""
        found = f"data[at - {check.size} : at]"
        wanted = forms.code_bytes(self.module, check, f"data[start : at - {check.size}]")
        if check.form == "raw":
            return f"{found} == {wanted} and "
        return f"{found}.upper() == {wanted if check.form == 'HEX' else f'({wanted}).upper()'} and "

    def _constant(self, after: Pairs) -> int | None:
        """Return the index of the constant to search for; None if there is none, or its distance is unknown."""
        fixed = (self.static.present(segment).fixed is not None for segment, _ in after)
        if not (all(fixed) and all(self._is_told(*one) for one in after)):
            return None
        found = (place for place, (one, _) in enumerate(after) if isinstance(one, Const) and one.when is None)
        return next(found, None)

    def _is_told(self, segment: Segment, scope: FieldScope) -> bool:
        """Return whether the presence of the segment is already known."""
        when = segment.when
        return when is None or None not in entries_read(when.root, scope, self.field_names)

    def _size_of(self, after: Pairs) -> str:
        """Return the source of the size of segments that have a fixed size when present."""
        fixed, conditional = fixed_and_conditional(self.static, after)
        texts = [f"({size} if {self.text(when, scope, SUM)} else 0)" for size, when, scope in conditional]
        return " + ".join([str(fixed), *texts])

    def _until_silence(self, after: Pairs) -> None:
        """Write the end by silence. Raises Finished."""
        self.settle()
        behind = self.least(after)
        shortest = f"at - start + {behind}" if behind else "at - start"
        self.add(f"size = {shortest}")
        with self.out.block("if end - start < size:"):
            self.add("return end - start - size")
        self.add(f"return QUIET if end - start <= {self.most} else LOST")
        raise Finished

    def inner_size(self, size: str, choice: str, measure: str, arguments: str, seen: str, behind: str) -> None:
        """Write the assignment of the size of an inner frame to the local `size`."""
        self.add(f"{size} = {measure}({choice}, {arguments}{seen}{behind})")

    def function(self, sentence: str) -> Source:
        """Return the complete function around the lines written so far."""
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
                with out.block("except MISMATCHES:"):
                    out.add("return LOST")
            else:
                out.extend(self.out)
        return out

    def write(self, frame: Frame | None, scope: FieldScope | None = None) -> None:
        scope = FieldScope(scope)
        self._compare_start()
        try:
            if frame is not None and frame.delimited and frame.tail:
                self.anew = True
                self.list(self.pairs(frame.head, scope), ())
                self.anew = False
                tail = self.pairs(frame.tail, scope)
                self._to_tail(tail)
                self.list(tail, ())
            elif self.static.all(self.segments).fixed is not None and not looks_inside(self.static, self.segments):
                self.place = Offset("start", self.static.all(self.segments).least)
            else:
                self.list(self.pairs(self.segments, scope), ())
            self.return_total()
        except Finished:
            return

    def _compare_start(self) -> None:
        constant = leading(self.segments)
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
        """Yield the possible first bytes of a frame, by constants, `where` and exclusive names.

        If a bad frame stops reading (`resync: never`), frames with other first bytes are not excluded: they must be
        reported, as they are no noise.
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
        """Measure a delimited body, which ends at the first byte of the tail."""
        first = tail[0][0]
        assert isinstance(first, Const)
        self.want(0, tail)
        place = self.place.text("")
        self.add(f"at = {self.search(f'{first.data[0]:#04x}', place, tail)}")
        with self.out.block("if at < 0:"):
            self.not_found(self.least(tail))
        self.place = Offset("at", 0)

    # ---- lists --------------------------------------------------------------------------------------------

    def list(self, pairs: Pairs, after: Pairs) -> None:
        """Measure the segments in order. Raises Finished when the rest of the function is written."""
        for place, (segment, scope) in enumerate(pairs):
            behind = (*pairs[place + 1 :], *after)
            first = self._kept(segment, "start")
            if segment.when is not None:
                self._conditional(segment, scope, behind)
            else:
                kind_of(segment).measure(self, segment, scope, behind)
            if self.tracked:
                self.passed.append((segment.path, first, self._kept(segment, "end")))

    def _kept(self, segment: Segment, what: str) -> Offset:
        """Return the current offset, in a local of its own if a check code covers the segment."""
        if segment.path not in self.tracked or self.place.base == "start":
            return self.place
        local = self.names.fresh(f"{(segment.name or 'part').strip('_')}_{what}")
        self.add(f"{local} = {self.place.text('')}")
        return Offset(local, 0)

    def runs(self, paths: Iterable[str]) -> Iterator[tuple[Offset, Offset]]:
        """Yield the spans of segments that have been passed, adjacent segments joined."""
        order = [path for path, _, _ in self.passed]
        places = [order.index(path) for path in paths if path in order]
        for at, place in enumerate(places):
            if at == 0 or place != places[at - 1] + 1:
                first = self.passed[place][1]
            if at + 1 == len(places) or places[at + 1] != place + 1:
                yield first, self.passed[place][2]

    def branch(self, pairs: Pairs, after: Pairs) -> bool:
        """Measure segments that may be absent; return whether the rest of the function is written."""
        finished = False
        try:
            self.list(pairs, after)
            self.settle()
        except Finished:
            finished = True
        self.place = Offset("at", 0)
        return finished

    def _conditional(self, segment: Segment, scope: FieldScope, behind: Pairs) -> None:
        assert segment.when is not None
        present = without_when(segment)
        names = [name for name in segment.value_names if name in self.needed]
        if self.static.present(segment).fixed == 0 and not names:
            return
        condition = self.text(segment.when, scope)
        self.settle()
        with self.out.block(f"if {condition}:"):
            self.branch(self.pairs((present,), scope), behind)
        if segment.blocks or segment.is_record:
            self._else_absent(segment, scope)
            return
        names = [name for name in names if name in scope.entries]  # values of an inner frame are not read here
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

    def _else_absent(self, segment: Segment, scope: FieldScope) -> None:
        """Write the values of the names in an absent segment."""
        out, self.out = self.out, Source()
        self.absent((segment,), scope)
        out, self.out = self.out, out
        if out.lines:
            with self.out.block("else:"):
                self.out.extend(out)


def _whole(text: str, record: Segment) -> NameEntry:
    """Return the entry of a record that is held as one value, as are its inner records; each of them may be None."""
    inside = FieldScope()
    inside.entries = {one.name: _whole("", one) for one in flat(record.members) if one.is_record and one.name}
    return NameEntry(text, "record", inside, may_be_absent=True)


def _names_of(expression: Expression) -> set[str]:
    """Return every name in an expression, including fields of records."""
    fields = {node.name for node in walk(expression.root) if isinstance(node, Attribute)}
    return names_in(expression.root) | fields


def needed_names(segments: tuple[Segment, ...], before: tuple[Segment, ...] = ()) -> set[str]:
    """Return the names that sizes, counts and conditions depend on, directly or indirectly.

    Fields of records are included, also of records in `before`.
    """
    found: set[str] = set()
    values: dict[str, set[str]] = {}
    records = {segment.name for segment in everything((*before, *segments)) if segment.is_record} | {PREVIOUS}
    for segment in everything(segments):
        if isinstance(segment, Value):
            values.setdefault(segment.name, set()).update(_names_of(segment.read))
        if isinstance(segment, Field) and segment.default is not None and segment.when is not None:
            values.setdefault(segment.name, set()).update(_names_of(segment.default))
        for expression in size_expressions(segment):
            found |= names_in(expression.root)
            if records & names_in(expression.root):
                found |= _names_of(expression)
    known: set[str] = set()
    while found - known:
        name = min(found - known)
        known.add(name)
        found |= values.get(name, set())
    return found


def size_expressions(segment: Segment) -> list[Expression]:
    """Return the expressions that determine the size of a segment, or end the frame."""
    times = segment.times if isinstance(segment, Repeat) else None
    until = segment.until if isinstance(segment, ItemEnd) else None
    added = [value for _, value in segment.needed()] if isinstance(segment, Check) and segment.ends else []
    found = (segment.when, segment.chooses_by, segment.size_expression, times, until, *added)
    return [expression for expression in found if isinstance(expression, Expression)]


class ExtentWriter(MeasureWriter):
    """Write a measuring function that assumes a valid inner frame."""

    kind = "extent"

    def inner_size(self, size: str, choice: str, measure: str, arguments: str, seen: str, behind: str) -> None:
        """Write the size of the inner frame, without reading it if one byte selects it."""
        self.add(f"{size} = {self.module.function('extent_first')}({choice}, {arguments}{behind})")
