"""Write numbers in C for fields, lengths, counts and bits: reading, comparison, encoding and measuring."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

from framekit.codec.python import forms
from framekit.codec.python.expressions import constant_of
from framekit.definition.expression import Expression
from framekit.definition.model.segments import Bits, BitsPart, Count, Field, FieldType, Length, Segment
from framekit.definition.problems import CannotSayError
from framekit.extras.generate_c.expressions import LEAST, MOST, CScope, Val
from framekit.extras.generate_c.functions import order_of_bytes
from framekit.extras.generate_c.layout import CMember, number_range
from framekit.extras.generate_c.measure import LOST, CMeasureWriter, Pairs
from framekit.extras.generate_c.reader import Here, ReadWriter
from framekit.extras.generate_c.source import number, string
from framekit.extras.generate_c.writer import WriteWriter

Number = Field | Length | Count
"""The segments that hold one number."""


# ---- read -----------------------------------------------------------------------------------------------------


def wire_type(type_: FieldType) -> FieldType:
    """Return the type of the encoded number, from which a scaled number is computed."""
    return type_.inside if type_.kind == "scaled" and type_.inside is not None else type_


def _changed(segment: Number, wire: str) -> str:
    """Return the text of the value, given the text of the encoded number."""
    text = f"(int64_t){wire}" if "with_sign" not in wire else wire
    if segment.type.scale is not None:
        text = f"({text} * {number(segment.type.scale.factor)} + {number(segment.type.scale.offset)})"
    if isinstance(segment, Field):
        text = f"({text} - {number(segment.plus)})" if segment.plus else text
        text = f"({text} * {number(segment.unit)})" if segment.unit not in (None, 1) else text
    if segment.zero_means is not None:
        text = f"({wire} == 0 ? {number(segment.zero_means)} : {text})"
    return text


def float_bits(type_: FieldType) -> tuple[FieldType, bool]:
    """Return the type of the number with the bits of a float, and whether the float has 32 bits."""
    return replace(type_, kind="digits" if type_.kind == "hex_float" else "int", signed=False), type_.float_bits == 32


def read_float(r: ReadWriter, type_: FieldType, raw: str, size: str, segment: Segment) -> tuple[str, str]:
    """Return the text of a float, and the call that detects invalid bytes; '' if all bytes are valid."""
    if type_.float_bits not in (32, 64):
        raise CannotSayError(segment.at, f"a float of {type_.float_bits // 8} bytes")
    if type_.kind == "hex_float" and type_.order not in ("big", "little"):
        raise CannotSayError(segment.at, f"digits of a number in the order {type_.order}")
    bits, is_short = float_bits(type_)
    wire, failing = r.read_number(bits, raw, size, segment)
    text = f"{r.file.helper('float')}((uint32_t){wire})" if is_short else f"{r.file.helper('double')}({wire})"
    return text, failing


def store_number(r: ReadWriter, segment: Number, here: Here, read: tuple[str, str], start: str = "") -> None:
    """Write the assignment of a number and its checks. `read`: the result of `read_number`; `start`: its offset."""
    member, (wire, failing) = here[1].members[segment.name], read
    target, start = f"{here[2]}{member.cname}", start or f"{r.inn}.from"
    with if_number(r, segment, failing, start):
        if member.high > MOST:
            r.add(f"{target} = ({member.ctype}){wire};")
        else:
            r.add(f"{target} = ({member.ctype}){_changed(segment, wire)};")
        r.is_there(member, here, sure=not failing)
        validate_read(r, segment, member, target, start)


@contextmanager
def if_number(r: ReadWriter, segment: Segment, failing: str, start: str) -> Iterator[None]:
    """Write the code for a valid number inside the context.

    `failing`: the call that returns 1 for no number, 2 for too large.
    """
    if not failing:
        yield
        return
    with r.block(f"switch ({failing})"):
        r.add("case 0:")
        r.out.depth += 1
        yield
        r.add("break;")
        r.out.depth -= 1
        r.add("case 1:", f"    {r.note('digits', start, r.refuse(segment))}", "    break;")
        r.add("default:", "    notes->no_room = true;", f"    {r.leave()}")


def validate_read(r: ReadWriter, segment: Field | Length | Count, member: CMember, target: str, start: str) -> None:
    if isinstance(segment, Field):
        only = tuple(segment.values) if segment.only and segment.values is not None else None
        among(r, segment, segment, member, target, start, only)
    if segment.limits is not None:
        tests = _outside(member, target, *segment.limits)
        if tests:
            r.when(tests, r.note("range", start, r.refuse(segment)))


def among(
    r: ReadWriter,
    segment: Segment,
    one: Field | BitsPart,
    member: CMember,
    target: str,
    start: str,
    only: tuple[int, ...] | None = None,
) -> None:
    """Write the check of a value with one or several allowed values."""
    among: tuple[int | str | bytes, ...] | None = only
    if one.constants is not None:
        among = one.constants
    elif one.is_ is not None and (found := constant_of(one.is_)) is not None:
        among = (found,)
    if among is not None:
        tests = " && ".join(_differs(r, member, target, value) for value in among)
        r.when(tests, r.note("value" if one.constants is None else "where", start, r.refuse(segment)))


def _outside(member: CMember, target: str, low: int, high: int) -> str:
    if member.kind == "float":
        return f"!({target} >= {low} && {target} <= {high})"
    if member.places:
        low, high = low * 10**member.places, high * 10**member.places
    if member.high > MOST:
        return " || ".join([*([f"{target} < {number(low)}"] if low > 0 else []), f"{target} > {_unsigned(high)}"])
    tests = [f"(int64_t){target} < {number(low)}"] if low > member.low else []
    tests += [f"(int64_t){target} > {number(high)}"] if high < member.high else []
    return " || ".join(tests)


def _unsigned(value: int) -> str:
    return f"UINT64_C({value})"


def _differs(r: ReadWriter, member: CMember, target: str, one: int | str | bytes) -> str:
    if isinstance(one, int):
        if member.kind != "number" or member.places:
            raise CannotSayError(member.at, "a constant of a number that is not whole")
        if member.high > MOST:
            return f"{target} != {_unsigned(one)}" if one >= 0 else "true"
        return f"(int64_t){target} != {number(one)}"
    data = one.encode("latin-1", "replace") if isinstance(one, str) else one
    view, same = r.file.helper("view"), r.file.helper("same_bytes")
    return f"!{same}({target}, {view}((const uint8_t *){string(data)}, {len(data)}))"


def _start(r: ReadWriter, name: str) -> tuple[str, str]:
    """Return the locals with offset and turn of a segment that is compared later."""
    start, turn = r.local("size_t", f"{name}_start"), r.local("unsigned long", f"{name}_turn")
    r.add(f"{start} = fk_wire({r.n}, {r.at});", f"{turn} = notes->turn;")
    return start, turn


class Awaited:
    """A value that is read now and compared after its expected value is known. Created before the value is read."""

    def __init__(self, r: ReadWriter, segment: Segment, member: CMember, here: Here, *, sure: bool = True) -> None:
        self.r, self.segment, self.member, self.target = r, segment, member, f"{here[2]}{member.cname}"
        self.refuse = r.refuse(segment)
        self.start, self.turn = _start(r, member.name)
        self.known = "" if r.is_sure and sure else r.known_of(member)

    def compare(self, cause: str, wanted: Callable[[], Val], *needed: str | Expression) -> None:
        """Defer the comparison until the needed segments are read."""
        self.r.later(lambda: self._write(cause, wanted()), self.segment, *needed)

    def _write(self, cause: str, value: Val) -> None:
        """Write the comparison with the expected value, if that is known at run time."""
        r, member, target = self.r, self.member, self.target
        note = f"fk_note_at({r.n}, FRAMEKIT_{cause.upper()}, {self.start}, {self.turn}, {self.refuse});"
        with r.block(f"if ({self.known} == 1)" if self.known else ""):
            if member.kind == "bytes":
                if value.kind != "bytes" or value.fold:
                    raise CannotSayError(member.at, "a text compared with what is none")
                text = f"!{r.file.helper('same_bytes')}({target}, {r.writer(CScope()).bytes(value)})"
            elif member.kind == "number" and not member.places and value.kind == "number":
                if member.high > MOST:
                    raise CannotSayError(member.at, "a number of 64 bits compared with another")
                text = f"(int64_t){target} != {value.text}"
            else:
                raise CannotSayError(member.at, "a value compared with another kind")
            if value.there:
                text = f"!({value.there}) || {text}"
            differs = text
            if "&bad" in text:
                differs = r.local("bool", "differs", "false")
                r.add("bad = false;", f"{differs} = {text};")
                with r.block("if (bad)"):
                    r.when("notes->reason == FRAMEKIT_OK && !notes->wrong_check", note)
                differs = f"!bad && {differs}"
            r.when(differs, note)


# ---- built ----------------------------------------------------------------------------------------------------


def bound(w: WriteWriter, member: CMember, local: str) -> None:
    """Write the refusal of a number outside the range of its type, and replace it for later computations."""
    if member.places:
        return
    low, high = member.low, member.high
    tests = [] if low == LEAST else [f"{local} < {number(low)}"]
    tests += [] if high == MOST else [f"{local} > {number(high)}"]
    if not tests:
        return
    with w.block(f"if ({' || '.join(tests)})"):
        w.fail("range")
        w.add(f"{local} = {number(min(max(0, low), high))};")


def wire_number(segment: Number, local: str) -> str:
    """Return the text of the encoded number, given the text of the value."""
    text = local
    if isinstance(segment, Field):
        if segment.unit is not None and segment.unit != 1:
            text = f"{text} / {number(segment.unit)}"
        if segment.plus:
            text = f"{text} + {number(segment.plus)}"
    if segment.zero_means is not None:
        text = f"({local} == {number(segment.zero_means)} ? 0 : {text})"
    return f"({text})" if text != local else text


def put_number(w: WriteWriter, type_: FieldType, wire: str, size: str, segment: Segment) -> None:
    if type_.kind == "decimal":
        put_decimal(w, type_, f"{wire}, 0", size, segment)
        return
    to = w.pointer()
    w.add(f"{to} = {w.file.helper('put')}({w.n}, {size});")
    with w.block(f"if ({to} != NULL)"):
        fixed = type_.fixed_size
        if type_.kind == "int" and fixed is not None and fixed <= 8:
            value = w.local("uint64_t", "number")
            w.add(f"{value} = (uint64_t){wire};")
            for shift, place in zip(range(8 * (fixed - 1), -1, -8), order_of_bytes(type_, fixed), strict=True):
                w.add(f"{to}[{place}] = (uint8_t)({f'{value} >> {shift}' if shift else value} & 0xFF);")
        elif type_.kind == "int" and type_.signed:
            little = "true" if type_.order == "little" else "false"
            w.add(f"{w.file.helper('put_signed')}({to}, {wire}, {size}, {little});")
        else:
            w.add(w.write_number(type_, wire, to, size, segment))


def put_float(w: WriteWriter, type_: FieldType, value: str, segment: Segment) -> None:
    bits, is_short = float_bits(type_)
    text = f"{w.file.helper('float_bits' if is_short else 'double_bits')}({value})"
    put_number(w, bits, f"(uint64_t){text}", str(type_.fixed_size), segment)


def put_decimal(w: WriteWriter, type_: FieldType, value: str, size: str, segment: Segment) -> None:
    """Write a number as decimal text. `value`: the number and its decimals, as arguments."""
    w.add(f"{w.file.helper('put_decimal')}({w.n}, {value}, {w.decimal_form(type_, size)});")


def put_scaled(w: WriteWriter, type_: FieldType, local: str, segment: Segment) -> None:
    """Write the encoded number of a scaled value."""
    assert type_.inside is not None and type_.scale is not None
    scale, inside = type_.scale, type_.inside
    low, high = forms.wire_range(inside).least, forms.wire_range(inside).most
    if low is None or high is None:
        raise CannotSayError(segment.at, "a scaled number of computed size")
    wire = w.local("int64_t", "scaled_wire")
    ends = sorted(one * scale.factor + scale.offset for one in (low, high))
    outside = [f"{local} < {number(max(ends[0], LEAST))}", f"{local} > {number(min(ends[1], MOST))}"]
    with w.block(f"if ({' || '.join(outside)})"):
        w.fail("range")
        w.add(f"{wire} = 0;")
    with w.block("else"):
        moved = f"({local} - {number(scale.offset)})"
        w.fail_if(f"{moved} % {number(scale.factor)} != 0", "value")
        w.add(f"{wire} = {moved} / {number(scale.factor)};")
    put_number(w, inside, wire, str(inside.fixed_size or 0), segment)


def fits(w: WriteWriter, type_: FieldType, local: str, size: str) -> None:
    """Write the check that a number fits into the bytes or digits that other values state."""
    signed = "true" if type_.signed else "false"
    base = {"int": 256, "digits": type_.base, "bcd": 100}.get(type_.kind, 256)
    w.fail_if(f"!{w.file.helper('fits')}({local}, {size}, {base}, {signed})", "range")


# ---- measured -------------------------------------------------------------------------------------------------


def measure_number(m: CMeasureWriter, segment: Field | Length | Count | Bits, scope: CScope, after: Pairs) -> None:
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
    """Write the reading of a number that sizes depend on."""
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
        m.when(f"{failing} != 0", f"return {LOST};")
    if isinstance(segment, Bits):
        whole = m.local("uint64_t", "bits")
        m.add(f"{whole} = (uint64_t){wire};")
        for part in segment.parts:
            if part.name in m.needed:
                most = (1 << part.high - part.low + 1) - 1
                m.set_number(part.name, scope, f"(int64_t)({whole} >> {part.low} & {number(most)})", 0, most)
        return
    low, high = number_range(segment, type_)
    if high > (1 << 63) - 1:
        raise CannotSayError(segment.at, "a number of 64 bits of which sizes depend")
    local = m.set_number(segment.name, scope, _changed(segment, wire), low, high)
    if segment.limits is not None and segment.refuse is None:
        least, most = segment.limits
        m.when(f"{local} < {number(least)} || {local} > {number(most)}", f"return {LOST};")


def _long(m: CMeasureWriter, segment: Field, scope: CScope, after: Pairs, needed: bool) -> None:
    assert segment.long is not None
    short, longer = segment.type.fixed_size or 1, segment.long.type.fixed_size or 0
    m.want(short, after)
    wire, _ = m.read_number(segment.type, f"(data + {m.here})", str(short), segment)
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
    """Measure a text with an end mark, or a text that takes the rest."""
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
