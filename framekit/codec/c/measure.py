"""How long the frame is that begins here, in C: as the measuring functions of `codec/python/measure.py` say it.

The result is its length; 0 where it does not begin; -n where it wants n bytes more at least; FK_QUIET where only
silence ends it, FK_LOST where its end cannot be found.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from framekit.codec.c.expressions import CScope, Val
from framekit.codec.c.functions import CFunctionWriter, FileFacts, pruned
from framekit.codec.c.layout import CStruct, scope_of
from framekit.codec.c.shared import case_tests
from framekit.codec.c.source import INDENT, CannotSayError, CSource, identifier, number, string
from framekit.codec.python.choices import fixed_bytes
from framekit.codec.python.facts import fixed_and_conditional, leading, may_be_empty
from framekit.codec.python.function import covered_names
from framekit.codec.python.measure import MOST, Finished, ending_checks, needed_names
from framekit.definition.codings import Hex
from framekit.definition.expression import Expression, names_in
from framekit.definition.model.frames import Frame, bytes_of, flat, without_when
from framekit.definition.model.segments import (
    INDEX,
    LAST,
    Bits,
    Check,
    Choose,
    Const,
    Count,
    Data,
    Field,
    FieldType,
    Fill,
    Inner,
    ItemEnd,
    Length,
    Optional,
    Repeat,
    Segment,
    Segments,
    Value,
    Wrap,
    exactly,
)

Pairs = tuple[tuple[Segment, CScope], ...]
LOST, QUIET = "FK_LOST", "FK_QUIET"


class CMeasureWriter(CFunctionWriter):
    """Writes one measuring function. `place`: where it stands while that is always the same; then it is in `at`."""

    is_reader = False

    def __init__(self, file: FileFacts, frame: Frame, segments: Segments, struct: CStruct) -> None:
        super().__init__(file, segments)
        self.frame = frame
        self.struct = struct
        self.most = MOST if frame.most is None else frame.most
        self.inn = "in"
        self.used |= {"data", "size", "end", "at", "context", "bad", "in", "stop", "found"}
        self.place: int | None = 0
        self.sure = 0
        self.needed = needed_names(segments)
        self.tracked = {name for check in ending_checks(segments) for name in covered_names(check, segments)}
        self.read: set[str] = set()
        self.looks_for_end = False
        self.ends = ""

    # ---- the function -------------------------------------------------------------------------------------

    def write(self, name: str) -> CSource:
        scope = CScope()
        self._compare_start()
        frame = self.frame
        try:
            if frame.delimited and frame.tail:
                self.list(self.pairs(frame.head, scope), ())
                tail = self.pairs(frame.tail, scope)
                self._to_tail(tail)
                self.list(tail, ())
            elif self.static.all(self.segments).fixed is not None and not self._looks_inside():
                self.place = self.static.all(self.segments).least
            else:
                self.list(self.pairs(self.segments, scope), ())
            self.return_total()
        except Finished:
            pass
        lines, locals_ = pruned(
            self.out.lines, ["bool bad = false;", "int64_t at = 0;", "int64_t stop = 0;", *self.locals]
        )
        body = "\n".join(lines)
        code = CSource()
        with code.block(f"static int64_t {name}(const uint8_t *data, size_t size{self.file.context})"):
            code.add("const int64_t end = (int64_t)size;", *locals_)
            if self.file.context and "context->" not in body and "context," not in body:
                code.add("(void)context;")
            if "data" not in body:
                code.add("(void)data;")
            code.lines.extend(lines)
        return code

    def _looks_inside(self) -> bool:
        inner = any(isinstance(one, Inner) and self.begins_with_constants(one) for one in flat(self.segments))
        return inner or any(True for _ in ending_checks(self.segments))

    def begins_with_constants(self, inner: Inner) -> bool:
        frames = (self.static.frames[name] for name in inner.frames)
        return any(leading(self.static, self.static.segments(frame)) for frame in frames)

    def _compare_start(self) -> None:
        constant = leading(self.static, self.segments)
        for place, byte in enumerate(constant):
            self.add(f"if (end > {place} && data[{place}] != {byte}) {{", "    return 0;", "}")
        for place, allowed in self._first_bytes():
            if place < len(constant):
                continue
            with self.block(f"if (end > {place})"):
                if len(allowed) <= 8:
                    tests = " && ".join(f"data[{place}] != {one}" for one in sorted(allowed))
                    self.add(f"if ({tests}) {{", "    return 0;", "}")
                else:
                    bits = [sum(1 << bit for bit in range(8) if 8 * row + bit in allowed) for row in range(32)]
                    rows = ", ".join(map(str, bits))
                    self.add(f"static const uint8_t allowed[32] = {{ {rows} }};")
                    self.add(
                        f"if ((allowed[data[{place}] >> 3] >> (data[{place}] & 7) & 1) == 0) {{", "    return 0;", "}"
                    )

    def _first_bytes(self) -> Iterable[tuple[int, frozenset[int]]]:
        if self.file.never_resyncs:
            return
        allowed: dict[int, frozenset[int]] = {}
        for place, values in fixed_bytes(self.segments):
            allowed[place] = allowed.get(place, values) & values
        for place in range(len(allowed)):
            if place not in allowed or len(allowed[place]) == 256:
                return
            yield place, allowed[place]

    # ---- places and wants ---------------------------------------------------------------------------------

    @property
    def here(self) -> str:
        return "at" if self.place is None else str(self.place)

    def settle(self) -> None:
        if self.place is not None:
            self.add(f"at = {self.place};")
            self.place = None

    def least(self, after: Pairs) -> int:
        return sum(self.static.of(segment).least for segment, _ in after)

    def is_bounded(self) -> bool:
        longest = self.static.all(self.segments).most
        return longest is not None and longest <= self.most

    def want(self, size: int, after: Pairs) -> None:
        least = size + self.least(after)
        if self.place is not None:
            wanted = self.place + size
            if wanted > self.sure:
                self.sure = wanted
                self.add(f"if (end < {wanted}) {{", f"    return end - {self.place + least};", "}")
            return
        more = f"end - at - {least}"
        text = more if self.is_bounded() else f"at + {least} <= {self.most} ? {more} : {LOST}"
        self.add(f"if (end < at + {size}) {{", f"    return {text};", "}")

    def want_until_stop(self, after: Pairs) -> None:
        least = self.least(after)
        self.add("if (end < stop) {", f"    return stop + {least} <= {self.most} ? end - stop - {least} : {LOST};", "}")

    def skip(self, size: str) -> None:
        if size.isdigit() and self.place is not None:
            self.place += int(size)
            return
        self.settle()
        self.add(f"at += {size};")

    def not_found(self, least: int) -> None:
        self.looks_for_end = True
        self.add(f"return end + {least} <= {self.most} ? {-least} : {LOST};")

    def return_total(self) -> None:
        if self.place is not None:
            self.add(f"return end >= {self.place} ? {self.place} : end - {self.place};")
            return
        longest = self.static.all(self.segments).most
        if self.looks_for_end or longest is None or longest > self.most:
            self.add(f"if (at > {self.most}) {{", f"    return {LOST};", "}")
        self.add("return at <= end ? at : end - at;")

    # ---- values -------------------------------------------------------------------------------------------

    def kept(self, value: Val, name: str) -> str:
        """The local with a number; the end is lost where it cannot be worked out."""
        if value.constant is not None:
            return value.text
        local = self.local("int64_t", name)
        self.keep(local, value.text)
        return local

    def keep(self, local: str, text: str) -> None:
        self.worked_out(local, text, lambda: (f"return {LOST};",))

    def condition(self, expression: Expression, scope: CScope) -> str:
        text = self.writer(scope).condition(expression)
        if "&bad" not in text:
            return text
        local = self.local("bool", "holds", "false")
        self.keep(local, text)
        return local

    def size_text(self, expression: Expression, scope: CScope) -> str:
        """A size that is not negative. Below 0 without any field of the frame, the frame fits nothing."""
        value = self.writer(scope).value(expression)
        if value.kind != "number":
            raise CannotSayError(expression.at, "a size that is no number")
        if value.there:
            by_state = not (names_in(expression.root) & self.by_value_name.keys())
            self.add(f"if (!({value.there})) {{", f"    return {'0' if by_state else LOST};", "}")
        local = self.kept(value, "told")
        if value.low < 0:
            by_fields = bool(names_in(expression.root) & self.by_value_name.keys())
            self.add(f"if ({local} < 0) {{", f"    return {LOST if by_fields else '0'};", "}")
        if value.high > 1 << 40:
            self.add(f"if ({local} > {1 << 30}) {{", f"    return {LOST};", "}")
        return local

    def set_number(self, name: str, scope: CScope, text: str, low: int, high: int) -> str:
        known = scope.entries.get(name)
        local = known.text if known is not None and known.kind == "number" and known.inside is None else ""
        if not local or not local.isidentifier():
            local = self.local("int64_t", f"{name}_value")
        there = self.local("bool", f"{name}_there", "false")
        self.keep(local, text)
        self.add(f"{there} = true;")
        low, high = (low, high) if known is None else (min(low, known.low), max(high, known.high))
        always = self.depth == 0
        scope.entries[name] = Val("number", local, low, high, there="" if always else there)
        return local

    depth = 0
    """How deep in branches the function stands."""

    # ---- lists --------------------------------------------------------------------------------------------

    def pairs(self, segments: Segments, scope: CScope) -> Pairs:
        """The segments with those of records."""
        found: list[tuple[Segment, CScope]] = []
        for segment in segments:
            if segment.is_record and segment.when is None:
                name = segment.value_names[0]
                known = scope.entries.get(name)
                inside = CScope(scope) if known is None or known.inside is None else known.inside
                scope.entries[name] = Val("record", "", inside=inside, wire="true")
                found += self.pairs(segment.members, inside)
            else:
                found.append((segment, scope))
        return tuple(found)

    def list(self, pairs: Pairs, after: Pairs) -> None:
        for place, (segment, scope) in enumerate(pairs):
            behind = (*pairs[place + 1 :], *after)
            span = self.span(segment.name)
            if span is not None:
                self.add(f"{span}.data = data;", f"{span}.first = (size_t){self.here};")
            if segment.when is not None:
                self._conditional(segment, segment.when, scope, behind)
            else:
                measure(self, segment, scope, behind)
            if span is not None:
                self.add(f"{span}.last = (size_t){self.here};", f"{span}.there = true;")
            self.read.update(segment.value_names)

    def branch(self, pairs: Pairs, after: Pairs) -> bool:
        """Segments of which it is not sure that they are there; whether nothing behind matters any more."""
        finished = False
        self.depth += 1
        try:
            self.list(pairs, after)
            self.settle()
        except Finished:
            finished = True
        self.depth -= 1
        self.place = None
        return finished

    def _conditional(self, segment: Segment, when: Expression, scope: CScope, behind: Pairs) -> None:
        names = [name for name in segment.value_names if name in self.needed]
        if self.static.present(segment).fixed == 0 and not names:
            return
        condition = self.condition(when, scope)
        self.settle()
        with self.block(f"if ({condition})"):
            self.branch(self.pairs((without_when(segment),), scope), behind)
        if names and isinstance(segment, Field) and segment.default is not None:
            value = self.writer(scope).value(segment.default)
            entry = scope.entries.get(segment.name)
            if value.kind != "number" or entry is None:
                raise CannotSayError(segment.at, "a default of which sizes depend")
            with self.block("else"):
                self.keep(entry.text, value.text)
                self.add(f"{entry.there} = true;")
            low, high = min(entry.low, value.low), max(entry.high, value.high)
            scope.entries[segment.name] = Val("number", entry.text, low, high, entry.there)

    # ---- what ends by what follows ------------------------------------------------------------------------

    def rest(self, segment: Segment, after: Pairs) -> None:
        place = self._constant(after)
        if place is None:
            self._until_silence(after)
            return
        first = after[place][0]
        assert isinstance(first, Const)
        before, behind = self._size_of(after[:place]), self._size_of(after[place:])
        may_hold = first.data[0] in bytes_of([segment, *(one for one, _ in after[:place])], self.static.frames)
        self.settle()
        found = self.local("size_t", "found_place")
        find = self.file.helper("find")
        self.add(f"at += {before};")
        call = f"{find}(data, (size_t)at, size, {string(first.data)}, {len(first.data)}, &{found})"
        with self.block(f"while (at <= end && {call})"):
            self.add(f"at = (int64_t){found};")
            total = f"at + {behind}"
            self.add(f"if ({total} > {self.most}) {{", f"    return {LOST};", "}")
            self.add(f"if ({total} > end) {{", f"    return end - ({total});", "}")
            if not may_hold or not any(isinstance(one, Check) for one, _ in after):
                self.add(f"return {total};")
            else:
                self._ends_here(total, f"at - ({before})")
                self.add("at++;")
        self.not_found(1)
        raise Finished

    def _ends_here(self, total: str, tail: str) -> None:
        """The frame ends here if everything from its tail on fits."""
        name = identifier(self.frame.name)
        scratch, notes, fault = self.fresh("scratch"), self.fresh("notes"), self.fresh("fault")
        self.locals += [f"struct {self.file.frame_enum(self.frame.name)} {scratch};", f"struct fk_notes {notes};",
                        f"struct framekit_fault {fault};"]  # fmt: skip
        self.add(f"memset(&{notes}, 0, sizeof {notes});")
        self.add(
            f"{self.file.prefix}_fk_read_{name}(data, (size_t)({total}){self.file.hand_on}, &{scratch}, &{notes});"
        )
        self.add(f"{self.file.helper('told')}(&{notes}, &{fault});")
        fits = f"{fault}.reason != FRAMEKIT_CHECK && (int64_t){fault}.offset < {tail}"
        self.when(
            f"{fault}.reason == FRAMEKIT_OK || {fault}.reason == FRAMEKIT_NO_ROOM || ({fits})", f"return {total};"
        )

    def _constant(self, after: Pairs) -> int | None:
        fixed = (self.static.present(segment).fixed is not None for segment, _ in after)
        if not (all(fixed) and all(self._is_told(one) for one, _ in after)):
            return None
        found = (place for place, (one, _) in enumerate(after) if isinstance(one, Const) and one.when is None)
        return next(found, None)

    def _is_told(self, segment: Segment) -> bool:
        when = segment.when
        return when is None or not (names_in(when.root) & self.by_value_name.keys()) - self.read

    def _size_of(self, after: Pairs) -> str:
        fixed, conditional = fixed_and_conditional(self.static, after)
        texts = [f"({self.condition(when, scope)} ? {size} : 0)" for size, when, scope in conditional]
        return " + ".join([str(fixed), *texts])

    def _until_silence(self, after: Pairs) -> None:
        behind = self.least(after)
        self.settle()
        self.add(f"if (end < at + {behind}) {{", f"    return end - at - {behind};", "}")
        self.add(f"return end <= {self.most} ? {QUIET} : {LOST};")
        raise Finished

    def _to_tail(self, tail: Pairs) -> None:
        first = tail[0][0]
        assert isinstance(first, Const)
        self.want(0, tail)
        self.settle()
        self._search(first.data[:1], self.least(tail))

    def _search(self, what: bytes, least: int) -> None:
        """Goes to the place of some bytes, which may still be to come."""
        found = self.local("size_t", "found_place")
        find = self.file.helper("find")
        call = f"{find}(data, (size_t)at, size, {string(what)}, {len(what)}, &{found})"
        with self.block(f"if (at > end || !{call})"):
            self.not_found(least)
        self.add(f"at = (int64_t){found};")


# ---- kinds --------------------------------------------------------------------------------------------------


def measure(m: CMeasureWriter, segment: Segment, scope: CScope, after: Pairs) -> None:
    """Writes how a segment that is there is passed."""
    kind = _KINDS.get(type(segment))
    if kind is None:
        if not segment.takes_bytes:
            return
        fixed = m.static.present(segment).fixed
        if fixed is None:
            raise CannotSayError(segment.at, f"where a segment of the kind '{segment.KEY}' ends")
        m.skip(str(fixed))
        return
    kind(m, segment, scope, after)


def _check(m: CMeasureWriter, segment: Check, scope: CScope, after: Pairs) -> None:
    if segment.ends:
        from framekit.codec.c.shared import put_code, work_out

        m.want(segment.size, after)
        start, code = m.local("size_t", "check_start"), m.local("uint64_t", "code")
        m.add(f"{start} = (size_t){m.here};")
        with m.block(""):
            m.add(f"uint8_t right[{segment.size}];", "struct fk_in in;", "struct fk_notes notes;")
            m.add("memset(&notes, 0, sizeof notes);", f"fk_open(&in, data, {start}, &notes);")
            m.file.helper("reader")
            if work_out(m, segment, scope, code, start):
                m.add("if (bad) {", f"    return {LOST};", "}")
            put_code(m, segment, code, "right")
            m.add(f"if (memcmp(right, data + {start}, {segment.size}) != 0) {{", f"    return {LOST};", "}")
    m.skip(str(segment.size))


def _fill(m: CMeasureWriter, segment: Fill, scope: CScope, after: Pairs) -> None:
    m.place = segment.total
    m.return_total()
    raise Finished


def _number(m: CMeasureWriter, segment: Field | Length | Count | Bits, scope: CScope, after: Pairs) -> None:
    needed = any(name in m.needed for name in segment.value_names)
    type_ = segment.type
    if isinstance(segment, Field) and segment.long is not None:
        _long(m, segment, scope, after, needed)
    elif isinstance(type_.size, Expression):
        size = m.size_text(type_.size, scope)
        if not needed:
            m.skip(size)
            return
        m.settle()
        m.add(f"stop = at + {size};")
        m.want_until_stop(after)
        _read(m, segment, scope, "(data + at)", size)
        m.add("at = stop;")
    elif type_.size is None:
        _text(m, segment, scope, after, needed)
    else:
        if needed:
            m.want(type_.size, after)
            raw = f"(data + {m.here})" if m.here != "0" else "data"
            _read(m, segment, scope, raw, str(type_.size))
        m.skip(str(type_.size))


def _read(m: CMeasureWriter, segment: Any, scope: CScope, raw: str, size: str) -> None:
    """The value of a number of which sizes depend."""
    type_ = segment.type
    if type_.kind in ("ascii", "bytes"):
        view = m.file.helper("view")
        local = m.local("struct framekit_bytes", f"{segment.name}_value", "{ NULL, 0 }")
        m.add(f"{local} = {view}({raw}, (size_t)({size}));")
        if type_.end is not None and type_.size is not None:
            m.add(f"{local}.size = {m.file.helper('before')}({local}, {string(type_.end)}, {len(type_.end)});")
        if type_.pad is not None:
            tests = " || ".join(f"{local}.data[{local}.size - 1] == {byte}" for byte in sorted({*type_.pad}))
            m.add(f"while ({local}.size > 0 && ({tests})) {{", f"    {local}.size--;", "}")
        is_text = type_.kind == "ascii"
        scope.entries[segment.name] = Val("bytes", local, is_text=is_text)
        if m.depth:
            there = m.local("bool", f"{segment.name}_there", "false")
            m.add(f"{there} = true;")
            scope.entries[segment.name] = Val("bytes", local, there=there, is_text=is_text)
        return
    wire, failing = m.read_number(type_, raw, size, segment)
    if failing:
        m.add(f"if ({failing} != 0) {{", f"    return {LOST};", "}")
    if isinstance(segment, Bits):
        whole = m.local("uint64_t", "bits")
        m.add(f"{whole} = (uint64_t){wire};")
        for part in segment.parts:
            if part.name in m.needed:
                most = (1 << part.high - part.low + 1) - 1
                m.set_number(part.name, scope, f"(int64_t)({whole} >> {part.low} & {number(most)})", 0, most)
        return
    from framekit.codec.c.layout import number_range

    low, high = number_range(segment, type_)
    if high > (1 << 63) - 1:
        raise CannotSayError(segment.at, "a number of 64 bits of which sizes depend")
    text = f"(int64_t){wire}" if "with_sign" not in wire else wire
    if isinstance(segment, Field):
        text = f"({text} - {number(segment.plus)})" if segment.plus else text
        text = f"({text} * {number(segment.unit)})" if segment.unit not in (None, 1) else text
    if segment.zero_means is not None:
        text = f"({wire} == 0 ? {number(segment.zero_means)} : {text})"
    local = m.set_number(segment.name, scope, text, low, high)
    if segment.limits is not None and segment.refuse is None:
        least, most = segment.limits
        m.add(f"if ({local} < {number(least)} || {local} > {number(most)}) {{", f"    return {LOST};", "}")


def _long(m: CMeasureWriter, segment: Field, scope: CScope, after: Pairs, needed: bool) -> None:
    assert segment.long is not None
    short, longer = segment.type.fixed_size or 1, segment.long.type.fixed_size or 0
    m.want(short, after)
    wire, _ = m.read_number(segment.type, f"(data + {m.here})", str(short), segment)
    from framekit.codec.c.layout import number_range

    low, high = number_range(segment, segment.type)
    local = m.set_number(segment.name, scope, f"(int64_t){wire}", min(low, 0), max(high, segment.long.mark))
    m.skip(str(short))
    m.settle()
    with m.block(f"if ({local} == {number(segment.long.mark)})"):
        if needed:
            m.depth += 1
            m.want(longer, after)
            wire, _ = m.read_number(segment.long.type, "(data + at)", str(longer), segment)
            m.add(f"{local} = (int64_t){wire};")
            m.depth -= 1
        m.add(f"at += {longer};")
    if needed and (segment.plus or segment.unit not in (None, 1) or segment.zero_means is not None):
        raise CannotSayError(segment.at, "a number with a long form of which sizes depend")


def _text(m: CMeasureWriter, segment: Any, scope: CScope, after: Pairs, needed: bool) -> None:
    """A text that its end marks, or that takes the rest."""
    type_ = segment.type
    if not type_.is_delimited:
        m.rest(segment, after)
        return
    m.settle()
    found = m.local("size_t", "found_place")
    if type_.end is not None:
        call = f"{m.file.helper('find')}(data, (size_t)at, size, {string(type_.end)}, {len(type_.end)}, &{found})"
    else:
        longest = max(map(len, type_.stops))
        helper = m.file.helper("find_stop")
        call = f"{helper}(data, (size_t)at, size, {m.stops(type_)}, {longest}, &{found})"
    with m.block(f"if (at > end || !{call})"):
        begun = max(map(len, type_.stops), default=0)
        m.not_found(max(1 + m.least(after) - begun, 1))
    if needed:
        _read(m, segment, scope, "(data + at)", f"{found} - (size_t)at")
    m.add(f"at = (int64_t){found}{f' + {len(type_.end)}' if type_.end is not None else ''};")


def _data(m: CMeasureWriter, segment: Data, scope: CScope, after: Pairs) -> None:
    if segment.size == "rest":
        m.rest(segment, after)
    if isinstance(segment.size, int):
        size = str(segment.on_wire(segment.size))
    else:
        assert isinstance(segment.size, Expression)
        size = m.size_text(segment.size, scope)
        if segment.convert is not None:
            size = f"2 * {size}" if segment.convert == "hex_to_ascii" else f"({size} >> 1)"
    if segment.name not in m.needed:
        m.skip(size)
        return
    if segment.convert is not None or segment.swap:
        raise CannotSayError(segment.at, "converted data of which sizes depend")
    m.settle()
    m.add(f"stop = at + {size};")
    m.want_until_stop(after)
    local = m.local("struct framekit_bytes", f"{segment.name}_value", "{ NULL, 0 }")
    m.add(f"{local} = {m.file.helper('view')}(data + at, (size_t)({size}));", "at = stop;")
    scope.entries[segment.name] = Val("bytes", local, is_text=False)


def _value(m: CMeasureWriter, segment: Value, scope: CScope, after: Pairs) -> None:
    if segment.name not in m.needed:
        return
    value = m.writer(scope).value(segment.read)
    if value.kind == "bytes" and not value.fold:
        scope.entries[segment.name] = value
    elif value.kind == "number":
        m.set_number(segment.name, scope, value.text, value.low, value.high)
    else:
        raise CannotSayError(segment.at, f"the value '{segment.name}', of which sizes depend")


def _choose(m: CMeasureWriter, segment: Choose, scope: CScope, after: Pairs) -> None:
    value = m.writer(scope).value(segment.on)
    if "&bad" in value.text and value.kind == "number":
        value = Val("number", m.kept(value, "chosen_by"), value.low, value.high, value.there)
    elif "&bad" in value.text:
        raise CannotSayError(segment.at, "a choice by what may have no value")
    tests = case_tests(m, segment, value, (scope, m.struct, ""))
    m.settle()
    finished = []
    for place, (test, segments) in enumerate(tests):
        with m.block(f"{'else ' if place else ''}if ({test})"):
            finished.append(m.branch(m.pairs(segments, scope), after))
    with m.block("else" if tests else ""):
        if segment.otherwise is None:
            m.add(f"return {LOST};")
        else:
            finished.append(m.branch(m.pairs(segment.otherwise, scope), after))
    if all(finished):
        raise Finished


def _optional(m: CMeasureWriter, segment: Segment, scope: CScope, after: Pairs) -> None:
    m.rest(segment, after)


def _repeat(m: CMeasureWriter, segment: Repeat, scope: CScope, after: Pairs) -> None:
    if segment.times == "rest":
        m.rest(segment, after)
    if segment.name in m.needed:
        raise CannotSayError(segment.at, f"the list '{segment.name}', of which sizes depend")
    item = segment.of.sizes if isinstance(segment.of, FieldType) else m.static.all(segment.of)
    times = str(segment.times)
    if isinstance(segment.times, Expression):
        times = m.size_text(segment.times, scope)
    if item.fixed is not None and segment.until is None and segment.align == 1:
        m.skip(str(int(times) * item.fixed) if times.isdigit() else f"{item.fixed} * {times}")
        return
    if isinstance(segment.of, FieldType):
        raise CannotSayError(segment.at, "a list of values of any size")
    _records(m, segment, segment.of, scope, times, after)


def _records(m: CMeasureWriter, segment: Repeat, of: Segments, scope: CScope, times: str, after: Pairs) -> None:
    """Items of different size are walked through."""
    empty, behind = may_be_empty(m.static, segment), m.least(after)
    least = 1 if empty else m.static.all(of).least
    if segment.until is None and not times.isdigit():
        m.add(f"if ({times} > {m.most}) {{", f"    return {LOST};", "}")
    m.settle()
    left, before, first = (m.local("int64_t", one) for one in ("left", "before", "first"))
    index = m.local("int64_t", "index")
    inside = CScope(scope)
    inside.entries[INDEX] = Val("number", index, 0, m.most)
    inside.entries[LAST] = Val("number", f"(int64_t)({left} == 1)", 0, 1, is_flag=True)
    m.add(f"{first} = at;", f"{index} = 0;")
    header = f"for ({left} = {times}; {left} > 0; {left}--)" if segment.until is None else "for (;;)"
    fill = f"at += ({segment.align} - (at - {first}) % {segment.align}) % {segment.align};"
    with m.block(header):
        if segment.align > 1 and segment.between:
            m.add(fill)
        if segment.until is not None:
            total = least + behind
            text = f"at + {total} <= {m.most} ? end - at - {total} : {LOST}"
            m.add(f"if (end < at + {least}) {{", f"    return {text};", "}")
        elif least:
            total_text = f"{least} * {left}" + (f" + {behind}" if behind else "")
            m.add(f"if (end < at + {least}) {{", f"    return end - at - ({total_text});", "}")
        m.add(f"{before} = at;")
        first_line, known = len(m.out.lines), len(m.locals)
        finished = m.branch(m.pairs(of, inside), ())
        flags = [one.split()[1] for one in m.locals[known:] if one.startswith("bool ")]  # nothing of the item before
        m.out.lines[first_line:first_line] = [f"{INDENT * m.out.depth}{flag} = false;" for flag in flags]
        ends, m.ends = m.ends, ""
        if finished:
            raise Finished
        if empty:
            m.add(f"if (at == {before}) {{", f"    return {LOST};", "}")
        m.add(f"(void){before};")
        if segment.align > 1 and not segment.between:
            m.add(fill)
        m.add(f"{index}++;")
        if segment.until is not None:
            m.add(f"if ({ends}) {{", "    break;", "}")


def _item_end(m: CMeasureWriter, segment: ItemEnd, scope: CScope, after: Pairs) -> None:
    if segment.until is not None:
        m.ends = m.condition(segment.until, scope)


def _inner(m: CMeasureWriter, segment: Inner, scope: CScope, after: Pairs) -> None:
    fixed = m.static.present(segment).fixed
    if isinstance(segment.size, Expression):
        m.skip(m.size_text(segment.size, scope))
        return
    if segment.size == "rest":
        m.rest(segment, after)
    if fixed is not None and not m.begins_with_constants(segment):
        m.skip(str(fixed))
        return
    behind = m.least(after)
    if any(m.static.frame(name).least for name in segment.frames):
        m.want(1, after)
    size = m.local("int64_t", "inner_size")
    several = behind if len(segment.frames) > 1 else 0
    function = m.file.first_inside(segment)
    m.settle()
    m.add(f"{size} = {function}(data + at, size - (size_t)at{m.file.hand_on}, false, {several});")
    with m.block(f"if ({size} <= 0)"):
        m.add(f"if ({size} == {QUIET} && end > {m.most}) {{", f"    return {LOST};", "}")
        if not behind or several:
            m.add(f"return {size};")
        else:
            m.add(f"return {size} < 0 && {size} > {QUIET} ? {size} - {behind} : {size};")
    m.add(f"at += {size};")


def _wrap(m: CMeasureWriter, segment: Wrap, scope: CScope, after: Pairs) -> None:
    fixed = m.static.all(segment.of).fixed
    if segment.escape is not None:
        _doubled(m, segment, scope, after, fixed)
        return
    known = segment.size
    if known is None and fixed is not None:
        known = segment.coding.sizes(exactly(fixed)).fixed
    if known is not None:
        needed = any(name in m.needed for one in flat(segment.of) for name in one.value_names)
        size = str(known) if isinstance(known, int) else m.size_text(known, scope)
        if needed:
            m.settle()
            m.add(f"stop = at + {size};")
            m.want_until_stop(after)
        m.skip(size)
        _content(m, segment, scope, after)
        return
    first = after[0][0] if after else None
    if isinstance(first, Const) and first.when is None and first.data[:1] and first.data[0] in segment.coding.never:
        m.settle()
        m._search(first.data[:1], m.least(after))
        _content(m, segment, scope, after)
        return
    if not isinstance(segment.coding, Hex) or isinstance(first, Const):
        m.rest(segment, after)
    raise CannotSayError(segment.at, "digits that only what they stand for tells the end of")


def _doubled(m: CMeasureWriter, segment: Wrap, scope: CScope, after: Pairs, fixed: int | None) -> None:
    assert segment.escape is not None
    behind = m.least(after)
    m.settle()
    if fixed is not None:
        _fixed_doubled(m, segment, scope, after, fixed)
        return
    some = m.embedded_in(segment)
    found = m.local("size_t", "found_place")
    helper = m.file.helper("end_of_region")
    with m.block(f"if (at > end || !{helper}(data, (size_t)at, size, {segment.escape}, {some}, &{found}))"):
        m.not_found(max(behind - 1, 1))
    m.add(f"at = (int64_t){found};")
    if symbol := _symbol_behind(segment, after):
        m.add(f"if (data[at + 1] != {symbol[1]}) {{", f"    return {LOST};", "}")
    _content(m, segment, scope, after)


def _fixed_doubled(m: CMeasureWriter, segment: Wrap, scope: CScope, after: Pairs, fixed: int) -> None:
    """Content of so many bytes, of which one is doubled."""
    behind, found = m.least(after), m.local("size_t", "found_place")
    helper = m.file.helper("end_of_stuffed")
    with m.block(f"switch ({helper}(data, (size_t)at, size, {segment.escape}, {fixed}, &{found}))"):
        m.add("case 0:", "    break;", "case 1:", f"    return {-1 - behind};", "default:", f"    return {LOST};")
    m.add(f"at = (int64_t){found};")
    for place, byte in enumerate(_symbol_behind(segment, after)):
        m.add(f"if (at + {place} < end && data[at + {place}] != {byte}) {{", f"    return {LOST};", "}")
    _content(m, segment, scope, after)


def _symbol_behind(segment: Wrap, after: Pairs) -> bytes:
    """The escape byte and its follower behind a wrap; empty if something else may stand there, or is to be refused."""
    found = b""
    for one, _ in after:
        if not isinstance(one, Const) or one.when is not None or one.refuse is not None:
            break
        found += one.data
    return found[:2] if len(found) > 1 and found[0] == segment.escape else b""


def _content(m: CMeasureWriter, segment: Wrap, scope: CScope, after: Pairs) -> None:
    """Values of a wrap that sizes behind it depend on."""
    needed = m.needed & needed_names(tuple(one for one, _ in after), m.segments)
    names = {name for one in flat(segment.of) for name in one.value_names if name in needed}
    if not names:
        return
    m.settle()
    frame = identifier(m.frame.name)
    scratch, notes = m.fresh("scratch"), m.fresh("notes")
    m.locals += [f"struct {m.file.frame_enum(m.frame.name)} {scratch};", f"struct fk_notes {notes};"]
    m.add(f"memset(&{notes}, 0, sizeof {notes});")
    m.add(f"{m.file.prefix}_fk_read_{frame}(data, (size_t)at{m.file.hand_on}, &{scratch}, &{notes});")
    found = scope_of(m.struct, f"{scratch}.")
    for name in names:
        scope.entries[name] = found.entries[name]


_KINDS: dict[type[Segment], Callable[..., None]] = {
    Check: _check,
    Fill: _fill,
    Field: _number,
    Length: _number,
    Count: _number,
    Bits: _number,
    Data: _data,
    Value: _value,
    Choose: _choose,
    Repeat: _repeat,
    ItemEnd: _item_end,
    Optional: _optional,
    Inner: _inner,
    Wrap: _wrap,
}
