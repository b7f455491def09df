"""Write measuring functions in C, with the results of those in `codec/python/measure.py`.

The result is the length of the frame; 0 if it does not begin here; -n if at least n more bytes are needed; FK_QUIET if
only silence ends it; FK_LOST if its end cannot be found.
"""

from __future__ import annotations

from collections.abc import Iterable

from framekit.codec.python.choices import fixed_bytes
from framekit.codec.python.facts import (
    code_before_end,
    ending_checks,
    fixed_and_conditional,
    leading,
    looks_inside,
    whole_constant,
)
from framekit.codec.python.function import covered_paths, paths_read
from framekit.codec.python.measure import MOST, Finished, needed_names
from framekit.definition.expression import Expression, names_in
from framekit.definition.model.frames import Frame, bytes_of, without_when
from framekit.definition.model.segments import Check, Const, Field, Segment, Segments
from framekit.definition.problems import CannotSayError
from framekit.extras.generate_c.checks import finish_code, put_code
from framekit.extras.generate_c.expressions import CScope, Val
from framekit.extras.generate_c.functions import CFunctionWriter, FileFacts
from framekit.extras.generate_c.layout import CStruct
from framekit.extras.generate_c.source import CSource, identifier, string

Pairs = tuple[tuple[Segment, CScope], ...]
"""Segments, each with the scope of its names."""
LOST, QUIET = "FK_LOST", "FK_QUIET"


class CMeasureWriter(CFunctionWriter):
    """Write a measuring function. `place`: the offset while it is constant; then it is the local `at`."""

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
        self.tracked = {path for check in ending_checks(segments) for path in covered_paths(check, segments)}
        self.read: set[str] = set()
        """The paths of the values that have been passed."""
        self.looks_for_end = False
        self.ends = ""
        """The condition that ends a list after the current item."""

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
            elif self.static.all(self.segments).fixed is not None and not looks_inside(self.static, self.segments):
                self.place = self.static.all(self.segments).least
            else:
                self.list(self.pairs(self.segments, scope), ())
            self.return_total()
        except Finished:
            pass
        header = f"static int64_t {name}(const uint8_t *data, size_t size{self.file.context})"
        first = "const int64_t end = (int64_t)size;"
        return self.assembled(header, first, self.out.lines, ("int64_t at = 0;", "int64_t stop = 0;"), ("data", "data"))

    def _compare_start(self) -> None:
        constant = leading(self.segments)
        for place, byte in enumerate(constant):
            self.when(f"end > {place} && data[{place}] != {byte}", "return 0;")
        for place, allowed in self._first_bytes():
            if place < len(constant):
                continue
            with self.block(f"if (end > {place})"):
                if len(allowed) <= 8:
                    tests = " && ".join(f"data[{place}] != {one}" for one in sorted(allowed))
                    self.when(tests, "return 0;")
                else:
                    bits = [sum(1 << bit for bit in range(8) if 8 * row + bit in allowed) for row in range(32)]
                    rows = ", ".join(map(str, bits))
                    self.add(f"static const uint8_t allowed[32] = {{ {rows} }};")
                    self.when(f"(allowed[data[{place}] >> 3] >> (data[{place}] & 7) & 1) == 0", "return 0;")

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
                self.when(f"end < {wanted}", f"return end - {self.place + least};")
            return
        more = f"end - at - {least}"
        text = more if self.is_bounded() else f"at + {least} <= {self.most} ? {more} : {LOST}"
        self.when(f"end < at + {size}", f"return {text};")

    def want_until_stop(self, after: Pairs) -> None:
        least = self.least(after)
        self.when("end < stop", f"return stop + {least} <= {self.most} ? end - stop - {least} : {LOST};")

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
            self.when(f"at > {self.most}", f"return {LOST};")
        self.add("return at <= end ? at : end - at;")

    # ---- values -------------------------------------------------------------------------------------------

    def keep(self, local: str, text: str) -> None:
        """Write the assignment of a computed value to a local; the function returns FK_LOST if it fails."""
        self.worked_out(local, text, lambda: (f"return {LOST};",))

    def condition(self, expression: Expression, scope: CScope) -> str:
        text = self.writer(scope).condition(expression)
        if "&bad" not in text:
            return text
        local = self.local("bool", "holds", "false")
        self.keep(local, text)
        return local

    def size_text(self, expression: Expression, scope: CScope) -> str:
        """Return the text of a size, with a check for negative values.

        A negative size ends the frame with FK_LOST, or with 0 if no field of the frame is part of it.
        """
        value = self.writer(scope).value(expression)
        if value.kind != "number":
            raise CannotSayError(expression.at, "a size that is no number")
        if value.there:
            by_state = not (names_in(expression.root) & self.by_value_name.keys())
            self.when(f"!({value.there})", f"return {'0' if by_state else LOST};")
        local = self.kept(value, "told")
        if value.low < 0:
            by_fields = bool(names_in(expression.root) & self.by_value_name.keys())
            self.when(f"{local} < 0", f"return {LOST if by_fields else '0'};")
        if value.high > 1 << 40:
            self.when(f"{local} > {1 << 30}", f"return {LOST};")
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
    """The nesting depth of branches."""

    # ---- lists --------------------------------------------------------------------------------------------

    def pairs(self, segments: Segments, scope: CScope) -> Pairs:
        """Return the segments with those of records inlined."""
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
            span = self.span(segment.path)
            if span is not None:
                self.add(f"{span}.data = data;", f"{span}.first = (size_t){self.here};")
            if segment.when is not None:
                self._conditional(segment, segment.when, scope, behind)
            else:
                self.measure(segment, scope, behind)
            if span is not None:
                self.add(f"{span}.last = (size_t){self.here};", f"{span}.there = true;")
            self.read.update(map(segment.sibling_path, segment.value_names))

    def measure(self, segment: Segment, scope: CScope, after: Pairs) -> None:
        """Write how a present segment is passed."""
        measure = self.kind_of(segment).measure
        if measure is not None:
            measure(self, segment, scope, after)
        elif segment.takes_bytes:
            fixed = self.static.present(segment).fixed
            if fixed is None:
                raise CannotSayError(segment.at, f"where a segment of the kind '{segment.KEY}' ends")
            self.skip(str(fixed))

    def branch(self, pairs: Pairs, after: Pairs) -> bool:
        """Measure segments that may be absent; return whether the rest of the function is written."""
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
        is_tried = may_hold and any(isinstance(one, Check) for one, _ in after)
        constant = whole_constant(one for one, _ in after[place:]) if is_tried else first.data
        found = self.local("size_t", "found_place")
        find = self.file.helper("find")
        self.add(f"at += {before};")
        call = f"{find}(data, (size_t)at, size, {string(constant)}, {len(constant)}, &{found})"
        with self.block(f"while (at <= end && {call})"):
            self.add(f"at = (int64_t){found};")
            total = f"at + {behind}"
            self.when(f"{total} > {self.most}", f"return {LOST};")
            self.when(f"{total} > end", f"return end - ({total});")
            if not is_tried:
                self.add(f"return {total};")
            else:
                check = code_before_end([one for one, _ in after[:place]])
                with self.where("" if check is None else self._code_right(check)):
                    self._ends_here(total, f"at - ({before})")
                self.add("at++;")
        self.not_found(1)
        raise Finished

    def _code_right(self, check: Check) -> str:
        """Write the verification of the check code directly before `at`; return the local with the result."""
        right, code = self.local("bool", "code_right", "false"), self.local("uint64_t", "code")
        name, initial = self.file.checks.of(check.method, check.at)
        begin = f"(size_t)at - {check.size}"
        self.add(f"{code} = {name}(UINT64_C({initial}), 0, data, {begin});")
        finish_code(self, check, code)
        with self.block(""):
            self.add(f"uint8_t wanted[{check.size}];")
            put_code(self, check, code, "wanted")
            if check.form == "raw":
                self.add(f"{right} = memcmp(wanted, data + ({begin}), {check.size}) == 0;")
            else:
                same = self.file.helper("same_digits")
                self.add(f"{right} = {same}(wanted, data + ({begin}), {check.size});")
        return right

    def _ends_here(self, total: str, tail: str) -> None:
        """Write a return of the length if the frame ends here.

        It does if it is valid, or if its first fault is before the tail and no check code is wrong.
        """
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
        return segment.when is None or paths_read(segment, self.all_paths, segment.when) <= self.read

    def _size_of(self, after: Pairs) -> str:
        fixed, conditional = fixed_and_conditional(self.static, after)
        texts = [f"({self.condition(when, scope)} ? {size} : 0)" for size, when, scope in conditional]
        return " + ".join([str(fixed), *texts])

    def _until_silence(self, after: Pairs) -> None:
        behind = self.least(after)
        self.settle()
        self.when(f"end < at + {behind}", f"return end - at - {behind};")
        self.add(f"return end <= {self.most} ? {QUIET} : {LOST};")
        raise Finished

    def _to_tail(self, tail: Pairs) -> None:
        first = tail[0][0]
        assert isinstance(first, Const)
        self.want(0, tail)
        self.settle()
        self._search(first.data[:1], self.least(tail))

    def _search(self, what: bytes, least: int) -> None:
        """Write the move to the offset of some bytes, which may not have arrived yet."""
        found = self.local("size_t", "found_place")
        find = self.file.helper("find")
        call = f"{find}(data, (size_t)at, size, {string(what)}, {len(what)}, &{found})"
        with self.block(f"if (at > end || !{call})"):
            self.not_found(least)
        self.add(f"at = (int64_t){found};")
