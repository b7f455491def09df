"""Write decoders: they read a buffer from front to back on the fast path, which only collects conditions.

An offset beyond the end is detected at the latest after everything is read. `diagnosis` determines the fault. Segments
of fixed size are read in runs with one struct; the kinds of segments write how all others are read.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

from framekit.codec.checks import residue_of
from framekit.codec.python import forms
from framekit.codec.python.expressions import FieldScope, Kind, NameEntry, constant_of, default_text
from framekit.codec.python.forms import code_text, is_call
from framekit.codec.python.function import (
    MISMATCH,
    Fields,
    Function,
    Offset,
    between,
    covers_later,
    index,
    paths_in_part,
)
from framekit.codec.python.registry import kind_of, struct_order
from framekit.codec.python.source import Source, bytes_literal, literal, quoted
from framekit.definition.expression import AND, BIT_OR, PRODUCT, SUM, Expression
from framekit.definition.kinds.check import Edges
from framekit.definition.model.frames import everything, flat, without_when
from framekit.definition.model.segments import Bits, Check, Const, Count, Field, FieldType, Length, Segment
from framekit.definition.problems import DefinitionError, Problem

START = Offset("", 0)


@dataclass(frozen=True, slots=True)
class ScopedSegment:
    """A segment with the scope of its names and the dictionary of its values."""

    segment: Segment
    scope: FieldScope
    fields: Fields


ANY_WIDTH = 1 << 20
"""The width in bits of a number whose size is computed."""
_FEW = 6
"""Limit of the allowed values that are written into a condition."""
_FEW_BYTES = 4
"""Limit of the single bytes that are read by index, which is faster than a struct."""


@dataclass(slots=True)
class Slot:
    """A segment of a run."""

    item: ScopedSegment
    size: int
    code: str
    """Its struct code."""
    order: str
    """The byte order that the code requires."""
    local: str | None
    """The local of its value, or None."""
    source: str = ""
    """The source of the unpacked value; the local itself after unpacking."""

    @property
    def text(self) -> str:
        """Return the local of a slot that has a value."""
        assert self.local is not None
        return self.local


@dataclass(slots=True)
class Chunk:
    """The slots that share one struct code: a slot, several paddings, or several fields of hex digits."""

    slots: list[Slot]
    local: str | None

    @property
    def size(self) -> int:
        return sum(slot.size for slot in self.slots)

    @property
    def code(self) -> str:
        if self.local is None:
            return f"{self.size}x" if self.size != 1 else "x"
        return self.slots[0].code if len(self.slots) == 1 else f"{self.size}s"

    @property
    def order(self) -> str:
        return self.slots[0].order if len(self.slots) == 1 and not self.code.endswith("s") else ""


@dataclass(frozen=True, slots=True)
class Comparison:
    """A deferred comparison; `is_ready` returns whether everything it compares has been read."""

    write: Callable[[], None]
    is_ready: Callable[[], bool]


def _records_in(segment: Segment) -> Iterator[Segment]:
    """Yield the segment if it is a record, or the records inside it if it is a wrap."""
    if segment.is_record:
        yield segment
    elif segment.is_there_inside:
        for inner in (one for block in segment.blocks for one in block):
            yield from _records_in(inner)


class BufferReader:
    """Write the reading of a buffer.

    `buffer` is its source, `at` the local of the offset once the offset is variable. Dictionaries for values that are
    read in a branch exist before the branch.
    """

    def __init__(self, function: Function, buffer: str, at: str) -> None:
        self.function = function
        self.module = function.module
        self.static = function.static
        self.buffer = buffer
        self.at = at
        self.place = START
        self.deferred: list[Comparison] = []
        self.body_begins: Segment | None = None
        """The first segment of a body that ends at the first byte of the tail."""
        self.body_place = START
        self.in_item = False
        """Whether a list item is read, which is followed by the next item instead of the end of the buffer."""
        self.list_end = ""
        """The local with the end of the enclosing list, if the list extends to the end of its region."""

    def items(self, segments: Iterable[Segment], scope: FieldScope, fields: Fields) -> list[ScopedSegment]:
        """Return the segments with those of records inlined, so that structs may extend across record borders."""
        found: list[ScopedSegment] = []
        for segment in segments:
            if segment.is_record and segment.when is None:
                found.extend(self.record_items(segment, scope, fields))
            else:
                found.append(ScopedSegment(segment, scope, fields))
        return found

    def record_items(self, record: Segment, scope: FieldScope, fields: Fields) -> list[ScopedSegment]:
        """Return the items of a record, with a scope and a dictionary of their own."""
        (name,) = record.value_names
        inner = Fields(self.function.local(name, scope), (fields, name))
        inside = FieldScope(scope, record.members)
        scope.entries[name] = NameEntry(inner.variable, "record", inside, direct=True, record=inner)
        return self.items(record.members, inside, inner)

    # ---- places -------------------------------------------------------------------------------------------

    def advance(self, text: str) -> None:
        """Assign the offset `text` to the local `at`."""
        if text != self.at:
            self.function.flush_using(self.at)
            further = text.removeprefix(f"{self.at} + ")
            self.function.add(f"{self.at} = {text}" if further == text else f"{self.at} += {further}")
        self.place = Offset(self.at, 0)

    def settle(self) -> None:
        """Move the offset into its local, so that branches and loops may change it."""
        self.advance(self.place.text(self.buffer))

    def keep(self, place: Offset) -> Offset:
        """Return an offset that stays valid when the local changes."""
        if place.base in ("", "end"):
            return place
        self.function.add(f"start = {place.text(self.buffer)}")
        return Offset("start", 0)

    def take(self, item: ScopedSegment, size: str) -> tuple[Offset, Offset]:
        """Return the start and end offset of a segment; `size` is the source of its size (at most a sum)."""
        first = self.keep(self.place)
        start = first.text(self.buffer)
        self.advance(size if start == "0" else f"{start} + {size}")
        self.function.stands(item.segment, self.buffer, first, self.place)
        return first, self.place

    def region_end(self, after: tuple[ScopedSegment, ...]) -> Offset:
        """Return the end of a segment that extends to the following segments."""
        told = all(self.static.present(item.segment).fixed is not None and self._is_told(item) for item in after)
        if after and (self.in_item or not told):
            return self._next_constant(after[0])
        fixed, conditional = self.function.sizes_of(((item.segment, item.scope) for item in after), AND)
        if not conditional:
            return Offset("end", -fixed)
        end = self.function.names.fresh("region_end")
        parts = [f"len({self.buffer})", *([str(fixed)] if fixed else []), *conditional]
        self.function.add(f"{end} = {' - '.join(parts)}")
        return Offset(end, 0)

    def knows_behind(self, after: tuple[ScopedSegment, ...]) -> bool:
        """Return whether the size of the following bytes is already known."""
        return not self.in_item and all(
            self.static.present(item.segment).fixed is not None and self._is_told(item) for item in after
        )

    def _is_told(self, item: ScopedSegment) -> bool:
        """Return whether the presence of the segment is already known."""
        when = item.segment.when
        return when is None or not self.function.waits_for(when, item.scope)

    def _next_constant(self, item: ScopedSegment) -> Offset:
        """Return the offset of the constant that ends the segments before it."""
        if not isinstance(item.segment, Const) or item.segment.when is not None:
            raise without_end(item.segment)
        end = self.function.names.fresh("region_end")
        start = self.place.text(self.buffer)
        self.function.add(f"{end} = {self.buffer}.index({bytes_literal(item.segment.data)}, {start})")
        return Offset(end, 0)

    def take_rest(self, item: ScopedSegment, after: tuple[ScopedSegment, ...]) -> tuple[Offset, Offset]:
        """Return the start and end offset of a segment that takes all bytes up to the following segments."""
        if self.in_item and not after:
            what = f"nothing shows where {item.segment.title} ends in an item of a list"
            raise not_possible(item.segment, what, "give all in it a size of its own, or put a constant behind it")
        last = self.region_end(after)
        first = self.place
        if first.base == "" and last.base == "end":
            if first.offset - last.offset:
                self.function.mismatch_if(f"len({self.buffer}) < {first.offset - last.offset}")
        elif first.base != "end" or last.base != "end":
            self.function.mismatch_if(f"{first.text(self.buffer)} > {last.text(self.buffer)}")
        if last.base == "end":
            self.place = last
        else:
            first = self.keep(first)
            self.function.flush()
            self.advance(last.text(self.buffer))
        self.function.stands(item.segment, self.buffer, first, self.place)
        return first, last

    def close(self) -> None:
        """Add the condition that the whole buffer and no byte beyond its end was read."""
        if self.place.base == "end":
            assert self.place.offset == 0, "segments behind a rest fill the buffer"
            return
        size = f"len({self.buffer}) != {self.place.text(self.buffer)}"
        if size not in self.function.conditions:
            self.function.conditions.insert(0, size)  # it costs less than any check code

    # ---- names and conditions -----------------------------------------------------------------------------

    def declare(
        self, item: ScopedSegment, name: str, local: str, kind: Kind = "value", inside: FieldScope | None = None, *,
        sized: bool = True, wire: str | None = None,
    ) -> None:  # fmt: skip
        """Record that the value `name` of a segment is in `local` from now on."""
        item.scope.entries[name] = NameEntry(local, kind, inside, sized=sized, wire=wire)
        self.function.locals_of_values[item.segment.sibling_path(name)] = local
        item.fields.add(name, local)

    def when_known(self, expression: Expression, scope: FieldScope, action: Callable[[], None]) -> None:
        """Call an action immediately, or after the fields that the expression reads are available."""
        if self.function.waits_for(expression, scope):
            self.deferred.append(Comparison(action, lambda: not self.function.waits_for(expression, scope)))
        else:
            action()

    def finish_deferred(self, *, all_is_read: bool) -> None:
        """Write the deferred comparisons that are ready; the others remain deferred unless `all_is_read`."""
        deferred, self.deferred = self.deferred, []
        for one in deferred:
            if all_is_read or one.is_ready():
                one.write()
            else:
                self.deferred.append(one)

    def size_text(self, expression: Expression, scope: FieldScope, level: int = SUM) -> str:
        """Return the source of a size; a size that may be negative is assigned to a local and checked."""
        text = self.function.writer(scope).text(expression, level)
        if not self.function.may_be_negative(expression.root):
            return text
        local = self.function.names.fresh("length")
        self.function.add(f"{local} = {self.function.writer(scope).text(expression)}")
        self.function.mismatch_if(f"{local} < 0")
        return local

    def validate_field(self, item: ScopedSegment, field: Field, local: str) -> None:
        self.validate_value(item.scope, field.is_, field.constants, local)
        if field.only and field.values is not None and field.constants is None:
            self._validate_among(local, tuple(field.values), field)
        self.validate_limits(field, local)

    def validate_value(
        self,
        scope: FieldScope,
        is_: Expression | None,
        constants: tuple[int | str | bytes, ...] | None,
        local: str,
    ) -> None:
        if constants is not None:
            if len(constants) == 1:
                self.function.mismatch_if(f"{local} != {literal(constants[0])}")
            else:
                self.function.mismatch_if(f"{local} not in {literal(constants)}")
        if is_ is not None:
            number = constant_of(is_)

            def compare() -> None:
                text = self.function.writer(scope).text(is_, BIT_OR)
                self.function.mismatch_if(f"{local} != {text if number is None else number}")

            self.when_known(is_, scope, compare)

    def _validate_among(self, local: str, allowed: tuple[int, ...], field: Field) -> None:
        if len(allowed) <= _FEW:
            self.function.mismatch_if(f"{local} not in {literal(allowed)}")
        elif field.values is not None:
            names = self.module.value_names(field.values, f"{self.function.title} {field.name}")
            self.function.mismatch_if(f"{local} not in {names}")

    def validate_limits(self, number: Field | Length | Count, local: str) -> None:
        """Add the limits that the type does not enforce."""
        if number.limits is None:
            return
        least, most = number.limits
        free = forms.value_range(replace(number, limits=None))
        low = free.least is None or least > free.least
        high = free.most is None or most < free.most
        if low and high:
            self.function.mismatch_if(f"not {least} <= {local} <= {most}")
        elif low:
            self.function.mismatch_if(f"{local} < {least}")
        elif high:
            self.function.mismatch_if(f"{local} > {most}")

    # ---- check codes --------------------------------------------------------------------------------------

    def validate_check(self, check: Check, scope: FieldScope, local: str, is_slice: bool) -> None:
        """Compare a check code that was read into `local` with the code of its range."""
        if covers_later(check, self.function.segments):
            if self.function.in_branch:
                raise not_possible(check, "a check under a condition covers what comes later", "put it behind that")
            code = local
            if not local.isidentifier():  # the offset at which it is read changes until then
                code = self.function.names.fresh(check.name or "check")
                self.function.add(f"{code} = {local}")
            self.function.late.append(lambda: self._compare_check(check, scope, code, is_slice))
        else:
            self._compare_check(check, scope, local, is_slice)

    def _compare_check(self, check: Check, scope: FieldScope, local: str, is_slice: bool) -> None:
        key = forms.needs(check, self.function.writer(scope).text)
        code = code_text(self.module, check, self.range_text(check, scope), key)
        found = forms.code_number(self.module, check, local) if is_slice else local
        self.function.wrong_if(forms.wrong_code(self.module, check, found, code))

    def residue(self, check: Check) -> int | None:
        """Return the code over all bytes up to the check's own end, or None if the codes must be compared."""
        if check.form != "raw" or check.covers is not None or check.verify != "error":
            return None
        return residue_of(check.method, check.size, check.order)

    def validate_residue(self, check: Check, residue: int, last: bool) -> None:
        """Write a single call over the check and all bytes before it, instead of cutting and comparing.

        `last`: the check ends the buffer.
        """
        covered = self.buffer if last else between(self.buffer, START, self.place.plus(check.size))
        code = self.module.check(check.method, covered)
        self.function.wrong_if(f"({code}) != {residue:#x}" if not is_call(code) or residue else code)

    def range_text(self, check: Check, scope: FieldScope) -> str:
        """Return the source of the bytes that a check covers; the check itself begins at the current offset."""
        if check.covers is None:
            return between(self.buffer, START, self.place)
        texts: list[str] = []
        run: list[str] = []
        for part in (*check.covers, None):
            if isinstance(part, str):
                run += paths_in_part(part, check, self.function.segments)
                continue
            texts.append(self.function.bytes_between(run))
            run = []
            if isinstance(part, tuple):
                texts.append(self._range_text(part, paths_in_part(part, check, self.function.segments)))
            elif part is not None:
                texts.append(forms.added_text(self.module, part, self.function.writer(scope).text(part.value, PRODUCT)))
        return " + ".join(text for text in texts if text != 'b""') or 'b""'

    def _range_text(self, edges: Edges, covered: list[str]) -> str:
        """Return the source of the bytes of a range, a single slice if it is in one buffer."""
        paths = [path for path in covered if path in self.function.bounds]
        if not paths:
            return 'b""'
        first = self.function.bounds[paths[0]]
        if {self.function.bounds[path].buffer for path in paths} != {first.buffer}:
            return self.function.bytes_between(paths)
        if first.buffer == self.buffer and edges[1] == "here":
            return between(self.buffer, first.first, self.place)
        return between(first.buffer, first.first, self.function.bounds[paths[-1]].last)

    def length_of_run(self, items: list[ScopedSegment]) -> int:
        """Return how many of the first items fit into one struct."""
        order = ""
        for count, item in enumerate(items):
            segment = item.segment
            free = isinstance(segment, Check) and segment.when is None and self.residue(segment) is not None
            wanted = "" if free else struct_order(segment)
            if wanted is None or (order and wanted and wanted != order) or (count and segment is self.body_begins):
                return count
            order = order or wanted
        return len(items)

    def read_run(self, items: list[ScopedSegment], whole: bool, last: bool) -> None:
        """Write the reading of a run.

        `whole`: the run is the whole buffer, so that the struct checks the buffer's size; `last`: no bytes follow.
        """
        slots = [self._slot(item) for item in items]
        chunks = self._chunks(slots)
        base = self.place
        exact = self._unpack(chunks, base, whole)
        for slot in slots:
            self.function.stands(slot.item.segment, self.buffer, self.place, self.place.plus(slot.size))
            self.place = self.place.plus(slot.size)
        self.place = base
        for chunk in chunks:
            if len(chunk.slots) > 1 and chunk.local is not None:
                self._digits_of(chunk)
        constant: tuple[Offset, bytes, bool] | None = None
        for slot in slots:
            segment = slot.item.segment
            if isinstance(segment, Const):
                start, data, refused = constant or (self.place, b"", False)
                constant = start, data + segment.data, refused or segment.refuse is not None
            else:
                self._compare_constant(constant)
                constant = None
                joined = any(slot in chunk.slots for chunk in chunks if len(chunk.slots) > 1)
                self._unpacked(slot, converted=joined, last=last and slot is slots[-1])
            self.place = self.place.plus(slot.size)
        self._compare_constant(constant)
        if exact:
            self.place = Offset("end", 0)

    # ---- unpacking ----------------------------------------------------------------------------------------

    def _slot(self, item: ScopedSegment) -> Slot:
        size = self.static.present(item.segment).fixed or 0
        slot: Slot = kind_of(item.segment).slot(self, item, item.segment, size)
        return slot

    def _unpacked(self, slot: Slot, converted: bool, last: bool) -> None:
        """Write the conversion of an unpacked slot to its value, and its checks.

        `self.place` is the offset of the segment.
        """
        segment = slot.item.segment
        if slot.local is not None:
            kind_of(segment).unpacked(self, slot, segment, slot.local if converted else slot.source, converted)
            return
        residue = self.residue(segment) if isinstance(segment, Check) else None
        if isinstance(segment, Check) and residue is not None:
            self.validate_residue(segment, residue, last)

    def _chunks(self, slots: list[Slot]) -> list[Chunk]:
        chunks: list[Chunk] = []
        for slot in slots:
            last = chunks[-1] if chunks else None
            if last is not None and slot.local is None and last.local is None:
                last.slots.append(slot)
            elif last is not None and _join_as_digits(last, slot):
                last.local = self.function.names.fresh("digits") if len(last.slots) == 1 else last.local
                last.slots.append(slot)
            else:
                chunks.append(Chunk([slot], slot.local))
        return chunks

    def _unpack(self, chunks: list[Chunk], base: Offset, whole: bool) -> bool:
        """Write the line that unpacks all values; return whether it checks the size of the buffer."""
        wanted = [chunk for chunk in chunks if chunk.local is not None]
        if not wanted:
            return False
        first, last = chunks.index(wanted[0]), chunks.index(wanted[-1])
        place = base.plus(sum(chunk.size for chunk in chunks[:first]))
        if len(wanted) == 1 and wanted[0].code[-1] in "Bs":
            self._slice(wanted[0], place)
            return False
        exact = whole and base == START
        if not exact and self._single_bytes(chunks, wanted, base):
            return False
        for chunk in wanted:
            chunk.slots[0].source = chunk.local or ""
        taken = chunks if exact else chunks[first : last + 1]
        order = next((chunk.order for chunk in wanted if chunk.order), "")
        constant = self.module.struct("".join(chunk.code for chunk in taken), order, self.function.title)
        targets = ", ".join(chunk.local or "" for chunk in wanted)
        targets = f"({targets},)" if len(wanted) == 1 else targets
        offset = place.text(self.buffer)
        behind = "" if exact or offset == "0" else f", {place.offset if place.base == 'end' else offset}"
        self.function.add(f"{targets} = {constant}.unpack{'' if exact else '_from'}({self.buffer}{behind})")
        return exact

    def _slice(self, chunk: Chunk, place: Offset) -> None:
        """Read the only value at an offset, a byte or bytes, by index or slice."""
        is_byte = chunk.code == "B"
        text = index(self.buffer, place) if is_byte else between(self.buffer, place, place.plus(chunk.size))
        if len(chunk.slots) == 1:
            chunk.slots[0].source = text
        else:
            chunk.local = text

    def _single_bytes(self, chunks: list[Chunk], wanted: list[Chunk], base: Offset) -> bool:
        """Read single bytes by index if they are few and at fixed offsets; return whether they are."""
        if len(wanted) > _FEW_BYTES or base.base not in ("", "end") or any(chunk.code != "B" for chunk in wanted):
            return False
        place = base
        for chunk in chunks:
            if chunk.local is not None:
                chunk.slots[0].source = index(self.buffer, place)
            place = place.plus(chunk.size)
        return True

    def _digits_of(self, chunk: Chunk) -> None:
        """Write the conversion of adjacent fields of hex digits to their numbers, all at once."""
        self.module.imports.add("from binascii import unhexlify")
        codes, orders = "", set()
        for slot in chunk.slots:
            type_ = type_of(slot.item.segment)
            places = forms.hex_places(type_) or 0
            codes += forms.INT_CODES[places]
            if places > 1:
                orders.add("<" if type_.order == "little" else ">")
        constant = self.module.struct(codes, next(iter(orders), ""), self.function.title, "digits")
        targets = ", ".join(slot.local or "" for slot in chunk.slots)
        self.function.add(f"{targets} = {constant}.unpack(unhexlify({chunk.local}))")

    # ---- what becomes of the values -----------------------------------------------------------------------

    def _compare_constant(self, constant: tuple[Offset, bytes, bool] | None) -> None:
        """Write the comparison of constants: their offset, their bytes, and whether one of them may cause a refusal."""
        if constant is None:
            return
        place, data, refused = constant
        if len(data) == 1:
            condition = f"{index(self.buffer, place)} != {data[0]:#04x}"
        else:
            condition = f"{between(self.buffer, place, place.plus(len(data)))} != {bytes_literal(data)}"
        if refused or self.function.in_branch or place.base not in ("", "end"):
            self.function.mismatch_if(condition)
        else:
            self.function.wrong_at_last_if(condition)

    def value_text(self, number: Field | Length | Count, local: str, wire: str) -> str:
        """Return the source of the value; a wire value that is used twice is assigned to the local first."""
        if forms.reads_twice(number) and wire != local:
            self.function.add(f"{local} = {wire}")
            wire = local
        return forms.value_of(number, wire)

    def assign(self, local: str, text: str) -> None:
        if text != local:
            self.function.add(f"{local} = {text}")

    def wire(self, type_: FieldType, source: str, converted: bool) -> str:
        """Return the source of the wire value, given the unpacked source."""
        if converted or not forms.is_slice(type_):
            return source
        if type_.kind == "bcd" and type_.fixed_size == 1:
            return f"{self.module.bcd_numbers()}[{source}]"
        places = forms.hex_places(type_)
        if places is None:
            return forms.parse(self.module, type_, source)
        self.module.imports.add("from binascii import unhexlify")
        raw = f"unhexlify({source})"
        return f"{raw}[0]" if places == 1 else f"int.from_bytes({raw}, {quoted(type_.order)})"

    def sized_number(self, item: ScopedSegment, segment: Length | Count | Bits) -> str:
        """Return the source of an encoded number of computed size."""
        size = segment.type.size
        first, last = self.take(item, self.size_text(size, item.scope) if isinstance(size, Expression) else str(size))
        return forms.parse(self.module, segment.type, between(self.buffer, first, last))

    def conditional(self, items: list[ScopedSegment], after: tuple[ScopedSegment, ...]) -> None:
        """Write the reading of segments under a common condition; an absent field has its default."""
        first = items[0]
        assert first.segment.when is not None
        condition = self.function.writer(first.scope).text(first.segment.when)
        inside = [ScopedSegment(without_when(item.segment), item.scope, item.fields) for item in items]
        if all(self._is_known_condition(one) for one in inside):
            text = self.function.writer(first.scope).text(first.segment.when, AND)
            for item in inside:
                assert item.segment.condition is not None
                holds = self.function.writer(item.scope).negated(item.segment.condition)
                self.function.mismatch_if(f"{text} and {holds}")
            return
        self._branches([(f"if {condition}:", inside)], after, items)

    def _is_known_condition(self, item: ScopedSegment) -> bool:
        """Return whether the item is a `require` whose condition can already be evaluated."""
        condition = item.segment.condition
        return condition is not None and not self.function.waits_for(condition, item.scope)

    def _branches(
        self,
        branches: list[tuple[str, list[ScopedSegment]]],
        after: tuple[ScopedSegment, ...],
        absent: Iterable[ScopedSegment],
    ) -> None:
        """Write cases of which at most one is taken; if none is, the items in `absent` get their defaults."""
        function = self.function
        for _, items in branches:
            for item in items:
                if holds_values(item.segment):
                    item.fields.attach()
                    item.fields.open(function.out)
        function.flush()
        self.settle()
        known = [(item.scope, set(item.scope.entries)) for _, items in branches for item in items]
        defaults = [item for item in absent if isinstance(item.segment, Field) and item.segment.default is not None]
        flags = _Flags(function)
        function.in_branch += 1
        for header, items in branches:
            with function.out.block(header):
                self._branch(items, after, {(id(item.fields), item.segment.name) for item in defaults}, flags)
            self.place = Offset(self.at, 0)
        lines = self._else_lines(known, defaults, [item for _, items in branches for item in items])
        function.in_branch -= 1
        if lines:
            with function.out.block("else:"):
                for line in lines:
                    function.add(line)
        for item in defaults:
            assert item.segment.name is not None
            item.fields.add(item.segment.name, item.scope.entries[item.segment.name].text)

    def _branch(
        self,
        items: list[ScopedSegment],
        after: tuple[ScopedSegment, ...],
        unconditional: set[tuple[int, str | None]],
        flags: _Flags,
    ) -> None:
        """Write the segments of a case.

        `unconditional`: mapping and name of the values that are added after all cases.
        """
        expanded: list[ScopedSegment] = []
        for item in items:
            if item.segment.is_record and item.segment.when is None:
                expanded.extend(self.record_items(item.segment, item.scope, item.fields))
            else:
                expanded.append(item)
        outside, self.deferred = self.deferred, []  # comparisons deferred outside are written after all branches
        self.read_items(expanded, after)
        self.finish_deferred(all_is_read=False)
        left, self.deferred = self.deferred, outside
        for scope, record in ((item.scope, one) for item in items for one in _records_in(item.segment)):
            entry = scope.entries.get(record.name or "")
            if entry is not None and entry.record is not None:
                entry.record.attach()
                entry.record.open(self.function.out)
                entry.direct, entry.may_be_absent = False, True
                if entry.inside is not None:
                    entry.inside.close()
        for item in expanded:
            mapping = id(item.fields)
            item.fields.entries = [entry for entry in item.fields.entries if (mapping, entry[0]) not in unconditional]
        self.function.flush()
        for item in (*expanded, *items):
            if holds_values(item.segment):  # otherwise the deferred value was read before the branch
                item.fields.flush(self.function.out)
        if left:
            self._compare_behind(flags.raised(), left, [item.fields for item in (*expanded, *items)])
        if self.place != Offset(self.at, 0):
            self.advance(self.place.text(self.buffer))

    def _compare_behind(self, flag: str, left: list[Comparison], fields: list[Fields]) -> None:
        """Defer the remaining comparisons of a branch; they apply only if that branch was taken."""

        def write() -> None:
            self.function.flush()
            for values in fields:
                values.flush(self.function.out)
            with self.function.out.block(f"if {flag}:"):
                for one in left:
                    one.write()
                self.function.flush()
                for values in fields:
                    values.flush(self.function.out)

        self.deferred.append(Comparison(write, lambda: all(one.is_ready() for one in left)))

    def _else_lines(
        self, known: list[tuple[FieldScope, set[str]]], defaults: list[ScopedSegment], items: list[ScopedSegment]
    ) -> list[str]:
        """Return the lines for no chosen branch: defaults, and None for names that expressions may read."""
        function = self.function
        lines, done = [], {item.segment.name for item in defaults}
        for item in defaults:
            assert isinstance(item.segment, Field) and item.segment.default is not None
            local = item.scope.entries[item.segment.name].text
            lines.append(
                f"{local} = {default_text(function.writer(item.scope).value(item.segment.default), item.segment)}"
            )
        for scope, before in known:
            for name, entry in scope.entries.items():
                if name not in before and name not in done and name in function.read_names:
                    done.add(name)
                    lines.append(f"{entry.text} = None")
        for item in items:
            for segment in everything((item.segment,)):
                bounds = function.bounds.get(segment.path)
                if segment.path in function.tracked and bounds is not None:
                    bases = [place.base for place in (bounds.first, bounds.last) if place.base not in ("", "end")]
                    here = self.at if bounds.buffer == self.buffer else "0"  # in a wrap that is absent
                    lines += [" = ".join((*dict.fromkeys(bases), here))] if bases else []
                    own = {segment.name or "", *segment.value_names} if segment.holder == item.segment.holder else set()
                    for name in own & item.scope.entries.keys():
                        item.scope.entries[name].wire = function.wire_size(segment.path)
        return lines

    def prepare_names(self, items: list[ScopedSegment]) -> None:
        """Declare a local for each name of a case that expressions elsewhere may read."""
        function = self.function
        for item in items:
            for segment in flat((item.segment,)):
                for name in segment.value_names:
                    if name in function.read_names and name not in item.scope.entries:
                        local = function.names.fresh(name)
                        function.add(f"{local} = None")
                        item.scope.entries[name] = NameEntry(local, is_read=False)

    def branches_of_choice(
        self, branches: list[tuple[str, list[ScopedSegment]]], after: tuple[ScopedSegment, ...], *, fault: bool
    ) -> None:
        function = self.function
        function.flush()
        self.settle()
        function.preset((item.segment for _, items in branches for item in items), self.at)
        flags = _Flags(function)
        function.in_branch += 1
        for place, (header, items) in enumerate(branches):
            later = [item.segment for _, others in branches[place + 1 :] for item in others]
            with function.out.block(header):
                self._branch(items, after, set(), flags)
                function.pass_over(later, (item.segment for item in items), self.at)
            self.place = Offset(self.at, 0)
        function.in_branch -= 1
        if fault:
            with function.out.block("else:"):
                function.add(MISMATCH)

    def read(self, segments: Iterable[Segment], scope: FieldScope, fields: Fields, *, all_is_read: bool = True) -> None:
        """Write the reading of the segments of a buffer or item; `all_is_read`: no other part of the frame follows."""
        items = self.items(segments, scope, fields)
        self.read_items(items, ())
        self.finish_deferred(all_is_read=all_is_read)
        for item in items:
            item.fields.attach()

    def read_items(self, items: list[ScopedSegment], after: tuple[ScopedSegment, ...]) -> None:
        place = 0
        while place < len(items):
            item = items[place]
            count = 1
            if item.segment is self.body_begins:
                self._keep_body_place()
            if item.segment.when is not None:
                count = _same_condition(items, place)
                self.conditional(items[place : place + count], (*items[place + count :], *after))
            elif (run := self.length_of_run(items[place:])) > 0:
                count = run
                behind = (*items[place + count :], *after)
                nothing = all(not one.segment.takes_bytes for one in behind)
                self.read_run(items[place : place + count], whole=place == 0 and nothing, last=nothing)
            else:
                kind_of(item.segment).read(self, item, item.segment, (*items[place + 1 :], *after))
            for one in items[place : place + count]:
                one.fields.attach()  # attach records too that hold no values
            place += count

    def _keep_body_place(self) -> None:
        self.body_place = self.place
        if self.place.base not in ("", "end"):
            local = self.function.names.fresh("body_start")
            self.function.add(f"{local} = {self.place.text(self.buffer)}")
            self.body_place = Offset(local, 0)


class _Flags:
    """Locals that record which of several branches was taken; each is false before the branches."""

    def __init__(self, function: Function) -> None:
        self._function = function
        self._before = len(function.out.lines)
        self._depth = function.out.depth

    def raised(self) -> str:
        """Return a new flag that the current branch sets to true."""
        flag = self._function.names.fresh("is_there")
        line = Source(self._depth)
        line.add(f"{flag} = False")
        self._function.out.lines[self._before : self._before] = line.lines
        self._function.add(f"{flag} = True")
        return flag


def holds_values(segment: Segment) -> bool:
    """Return whether a segment has a value or contains segments with values."""
    return any(one.value_names for one in flat((segment,)))


def without_end(segment: Segment) -> DefinitionError:
    """Return the error for a segment whose beginning is undefined."""
    what = "nothing says where the segment before this one ends"
    return not_possible(segment, what, "give it a size, or a constant behind")


def not_possible(segment: Segment, what: str, todo: str) -> DefinitionError:
    """Return the error for a definition that cannot be compiled."""
    return DefinitionError([Problem(segment.at, what, todo)])


def type_of(segment: Segment) -> FieldType:
    """Return the type of a segment that has one type."""
    assert isinstance(segment, (Field, Bits, Length, Count))
    return segment.type


def shown_name(segment: Segment, otherwise: str) -> str:
    """Return a segment's own name, or `otherwise` if it has no name."""
    return otherwise if segment.name is None or segment.name.startswith("_") else segment.name


def _join_as_digits(chunk: Chunk, slot: Slot) -> bool:
    """Return whether a field of hex digits may be decoded together with the fields before it."""
    types = []
    for other in (*chunk.slots, slot):
        if not isinstance(other.item.segment, (Field, Bits, Length, Count)):
            return False
        type_ = other.item.segment.type
        if forms.hex_places(type_) is None:
            return False
        types.append(type_)
    return len({type_.order for type_ in types if type_.fixed_size != 2}) <= 1


def _same_condition(items: list[ScopedSegment], start: int) -> int:
    """Return how many segments from `start` on have the same `when`."""
    first, count = items[start], 1
    for item in items[start + 1 :]:
        when = item.segment.when
        if when is None or str(when) != str(first.segment.when) or item.scope is not first.scope:
            break
        count += 1
    return count
