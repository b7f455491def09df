"""How each kind of segment is read in C: a function for each, found by the class of the segment."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import Any

from framekit.codec.c.codings import open_wrap
from framekit.codec.c.expressions import MOST, CScope, Val, constant
from framekit.codec.c.layout import CMember
from framekit.codec.c.reader import READ, Behind, Here, ReadWriter, has_checks
from framekit.codec.c.shared import case_tests, put_code, work_out
from framekit.codec.c.source import CannotSayError, number, string
from framekit.codec.python.expressions import constant_of
from framekit.codec.python.facts import comes_with, is_followed, is_plain_name, may_be_empty, targets_of
from framekit.codec.python.function import covers_later, wire_names
from framekit.definition.codings import Plain
from framekit.definition.expression import Expression
from framekit.definition.model.segments import (
    INDEX,
    LAST,
    PREVIOUS,
    Bits,
    BitsPart,
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
    Record,
    Repeat,
    Require,
    Segment,
    Segments,
    Skip,
    Value,
    Wrap,
)
from framekit.definition.wire_types import exactly

# ---- constants and bytes without meaning --------------------------------------------------------------------


def _const(r: ReadWriter, segment: Const, here: Here, behind: Behind) -> None:
    helper = r.file.helper("constant")
    call = f"{helper}({r.n}, {string(segment.data)}, {len(segment.data)}, {r.refuse(segment)})"
    r.when(f"!{call}", r.leave())
    r.stands(segment.name)


def _skip(r: ReadWriter, segment: Skip, here: Here, behind: Behind) -> None:
    r.begin()
    r.take(str(segment.size))
    r.stands(segment.name)


def _fill(r: ReadWriter, segment: Fill, here: Here, behind: Behind) -> None:
    r.begin()
    r.take(_rest(r, behind))
    r.stands(segment.name)
    r.when(f"{r.inn}.end < {segment.total}", r.note("short", f"{r.inn}.end"))
    r.when(f"{r.inn}.end > {segment.total}", r.note("surplus", str(segment.total)))


def _rest(r: ReadWriter, behind: Behind) -> str:
    """The local with the number of bytes up to what is behind."""
    helper = r.file.helper("rest")
    size = r.local("int64_t", "rest")
    text = r.behind(behind)
    r.when(f"!{helper}({r.n}, {text}, &{size})", r.leave())
    return size


# ---- numbers, texts, bytes ----------------------------------------------------------------------------------


def _sized(r: ReadWriter, size: object, scope: CScope, reason: str, refuse: str, factor: str = "") -> str:
    """The text of a size in bytes."""
    if isinstance(size, int):
        return str(size * 2 if factor == "*" else size // 2 if factor == "/" else size)
    assert isinstance(size, Expression)
    value = r.number(size, scope)
    local = r.ask(value, reason, "size_told", refuse)
    if factor == "*":
        if value.high > MOST // 2:
            raise CannotSayError(size.at, "a size without bound")
        return f"2 * {local}"
    return f"({local} >> 1)" if factor == "/" else local


def _start(r: ReadWriter, name: str) -> tuple[str, str]:
    """The locals with the place and the turn of a segment that is compared later."""
    start, turn = r.local("size_t", f"{name}_start"), r.local("unsigned long", f"{name}_turn")
    r.add(f"{start} = fk_wire({r.n}, {r.at});", f"{turn} = notes->turn;")
    return start, turn


def _on_the_wire(type_: FieldType) -> FieldType:
    """The type of the number that stands there, of which a scaled one is worked out."""
    return type_.inside if type_.kind == "scaled" and type_.inside is not None else type_


def _changed(segment: Field | Length | Count, wire: str, type_: FieldType) -> str:
    """The text of the value from that of the number on the wire."""
    text = f"(int64_t){wire}" if "with_sign" not in wire else wire
    if type_.kind == "scaled":
        assert type_.scale is not None
        text = f"({text} * {number(type_.scale.factor)} + {number(type_.scale.offset)})"
    if isinstance(segment, Field):
        if segment.plus:
            text = f"({text} - {number(segment.plus)})"
        if segment.unit is not None and segment.unit != 1:
            text = f"({text} * {number(segment.unit)})"
    if segment.zero_means is not None:
        text = f"({wire} == 0 ? {number(segment.zero_means)} : {text})"
    return text


def _store_number(
    r: ReadWriter,
    segment: Field | Length | Count,
    member: CMember,
    here: Here,
    wire: str,
    failing: str,
    start: str,
    type_: FieldType,
) -> None:
    """Keeps a number, and what must hold for it. `start`: where it begins in the buffer."""
    target = f"{here[2]}{member.cname}"
    with _if_number(r, segment, failing, start):
        if member.high > MOST:
            r.add(f"{target} = ({member.ctype}){wire};")
        else:
            r.add(f"{target} = ({member.ctype}){_changed(segment, wire, type_)};")
        r.is_there(member, here, sure=not failing)
        _validate(r, segment, member, target, start)


@contextmanager
def _if_number(r: ReadWriter, segment: Segment, failing: str, start: str) -> Iterator[None]:
    """What is done with a number that was read. `failing`: the call that says that it is none (1), or too large."""
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


def _validate(r: ReadWriter, segment: Field | Length | Count, member: CMember, target: str, start: str) -> None:
    if isinstance(segment, Field):
        only = tuple(segment.values) if segment.only and segment.values is not None else None
        _among(r, segment, segment, member, target, start, only)
    if segment.limits is not None:
        tests = _outside(member, target, *segment.limits)
        if tests:
            r.when(tests, r.note("range", start, r.refuse(segment)))


def _among(
    r: ReadWriter,
    segment: Segment,
    one: Field | BitsPart,
    member: CMember,
    target: str,
    start: str,
    only: tuple[int, ...] | None = None,
) -> None:
    """A value that is always the same, or one of several."""
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


def _field(r: ReadWriter, segment: Field, here: Here, behind: Behind) -> None:
    scope, struct, _ = here
    member = struct.members[segment.name]
    type_ = segment.type
    r.begin()
    wanted = segment.is_
    if wanted is not None and segment.constants is None and constant_of(wanted) is not None:
        wanted = None  # it is compared at once
    awaited = None if wanted is None else _Awaited(r, segment, member, here)
    if segment.long is not None:
        _long(r, segment, member, here)
    elif type_.kind in ("ascii", "bytes"):
        _text(r, segment, member, here, behind)
    elif type_.is_delimited:
        _delimited_number(r, segment, member, here)
    elif type_.size is None:
        raise CannotSayError(segment.at, f"'{segment.name}' is a number that its end shows")
    elif member.kind == "decimal":
        refuse = r.refuse(segment)
        size = _sized(r, type_.size, scope, "length", refuse)
        r.take(size, refuse)
        r.stands(segment.name)
        _decimal(r, segment, member, here, size)
    else:
        refuse = r.refuse(segment)
        size = _sized(r, type_.size, scope, "length", refuse)
        r.take(size, refuse)
        r.stands(segment.name)
        if type_.kind in ("float", "hex_float"):
            _float(r, segment, member, here)
        else:
            wire, failing = r.read_number(_on_the_wire(type_), r.raw, size, segment)
            _store_number(r, segment, member, here, wire, failing, f"{r.inn}.from", type_)
    if awaited is not None and wanted is not None:
        awaited.compare("value", lambda: r.default_value(segment, wanted, scope), wanted)


def _delimited_number(r: ReadWriter, segment: Field, member: CMember, here: Here) -> None:
    """A number in text that certain bytes end."""
    type_, start = segment.type, r.local("size_t", "text_start")
    stop = _up_to_end(r, segment, start)
    size = f"(int64_t)({stop} - {start})"
    if type_.form is not None and type_.form.empty:
        with r.block(f"if ({stop} == {start})"):
            r.nothing(member)
            r.add(";")
        header = "else"
    else:
        header = ""
    sure, r.is_sure = r.is_sure, r.is_sure and not header
    with r.block(header):
        if member.kind == "decimal":
            _decimal(r, segment, member, here, size)
        else:
            wire, failing = r.read_number(_on_the_wire(type_), r.raw, size, segment)
            _store_number(r, segment, member, here, wire, failing, f"{r.inn}.from", type_)
    r.is_sure = sure
    if type_.end is not None:
        r.add(f"{r.at} += {len(type_.end)};")
    r.stands_from(segment.name, start)


def _decimal(r: ReadWriter, segment: Field, member: CMember, here: Here, size: str) -> None:
    """A number with as many digits behind its point as it has."""
    scope, _, path = here
    if segment.is_ is not None or segment.constants is not None or segment.limits is not None:
        raise CannotSayError(segment.at, "a number with any number of decimals that is compared with others")
    call = r.file.helper("decimal_value")
    form = r.decimal_form(segment.type, size)
    with _if_number(r, segment, f"{call}({r.raw}, {form}, &{path}{member.cname})", f"{r.inn}.from"):
        if member.has:
            r.add(f"{path}{member.flag} = true;")
    scope.entries[segment.name] = Val("other")


def _float(r: ReadWriter, segment: Field, member: CMember, here: Here) -> None:
    scope, _, path = here
    type_ = segment.type
    if type_.kind == "hex_float":
        raise CannotSayError(segment.at, "a float in hex digits")
    wire, _ = r.read_number(replace(type_, kind="int", signed=False), r.raw, "", segment)
    if member.size == 4:
        r.add(f"{path}{member.cname} = {r.file.helper('float')}((uint32_t){wire});")
    elif member.size == 8:
        r.add(f"{path}{member.cname} = {r.file.helper('double')}({wire});")
    else:
        raise CannotSayError(segment.at, f"a float of {member.size} bytes")
    if member.has:
        r.add(f"{path}{member.flag} = true;")
    scope.entries[segment.name] = Val("other")
    if segment.is_ is not None or segment.constants is not None:
        raise CannotSayError(segment.at, "a float that is always the same")
    _validate(r, segment, member, f"{path}{member.cname}", f"{r.inn}.from")


def _long(r: ReadWriter, segment: Field, member: CMember, here: Here) -> None:
    assert segment.long is not None
    short, longer = segment.type.fixed_size, segment.long.type.fixed_size
    if short is None or longer is None or segment.type.kind != "int" or segment.long.type.kind != "int":
        raise CannotSayError(segment.at, "a long form that is no plain number")
    start = r.local("size_t", "long_start")
    value = r.local("int64_t", "long_value")
    refuse = r.refuse(segment)
    r.add(f"{start} = {r.at};")
    r.take(str(short), refuse)
    wire, _ = r.read_number(segment.type, r.raw, str(short), segment)
    r.add(f"{value} = (int64_t){wire};")
    with r.block(f"if ({value} == {number(segment.long.mark)})"):
        r.take(str(longer), refuse)
        wire, _ = r.read_number(segment.long.type, r.raw, str(longer), segment)
        r.add(f"{value} = (int64_t){wire};")
    r.stands_from(segment.name, start)
    _store_number(r, segment, member, here, value, "", start, segment.type)


class _Awaited:
    """A value that is read now, and compared when what it has to be has been read. Made before it is read."""

    def __init__(self, r: ReadWriter, segment: Segment, member: CMember, here: Here, *, sure: bool = True) -> None:
        self.r, self.member, self.target = r, member, f"{here[2]}{member.cname}"
        self.refuse = r.refuse(segment)
        self.start, self.turn = _start(r, member.name)
        self.known = "" if r.is_sure and sure else r.known_of(member)

    def compare(self, cause: str, wanted: Callable[[], Val], *needed: str | Expression) -> None:
        self.r.later(lambda: self._write(cause, wanted()), *needed)

    def _write(self, cause: str, value: Val) -> None:
        """Compares it with what it should be, as far as that can be told."""
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


def _text(r: ReadWriter, segment: Field, member: CMember, here: Here, behind: Behind) -> None:
    scope, _, path = here
    type_, refuse = segment.type, r.refuse(segment)
    target = f"{path}{member.cname}"
    view = r.file.helper("view")
    if type_.is_delimited:
        start = r.local("size_t", "text_start")
        stop = _up_to_end(r, segment, start)
        r.add(f"{target} = {view}({r.raw}, {stop} - {start});")
        if type_.end is not None:
            r.add(f"{r.at} += {len(type_.end)};")
        r.stands_from(segment.name, start)
        place = start
    else:
        size = _rest(r, behind) if type_.size is None else _sized(r, type_.size, scope, "length", refuse)
        r.take(size, refuse)
        r.stands(segment.name)
        r.add(f"{target} = {view}({r.raw}, (size_t){size});")
        if type_.kind == "ascii" and type_.end is not None:
            r.add(f"{target}.size = {r.file.helper('before')}({target}, {string(type_.end)}, {len(type_.end)});")
        if type_.kind == "ascii" and type_.pad is not None:
            with r.block(f"while ({target}.size > 0 && {_is_pad(target, type_.pad)})"):
                r.add(f"{target}.size--;")
        place = f"{r.inn}.from"
    r.is_there(member, here)
    _validate(r, segment, member, target, place)


def _up_to_end(r: ReadWriter, segment: Field, start: str) -> str:
    """Takes what stands before the bytes that end it; the local with the place of these."""
    type_, refuse = segment.type, r.refuse(segment)
    stop = r.local("size_t", "text_end")
    r.add(f"{start} = {r.at};")
    if type_.end is not None:
        find = r.file.helper("find")
        found = f"{find}({r.inn}.data, {start}, {r.inn}.end, {string(type_.end)}, {len(type_.end)}, &{stop})"
    else:
        longest = max(map(len, type_.stops))
        if r.in_item and r.inn != "in":
            raise CannotSayError(segment.at, "a text in items of a list in a wrap, which ends before several bytes")
        limit = f"{r.inn}.end"
        if r.inn == "in":  # what ends the last item of a list may stand behind the list
            limit = f"({limit} + {longest} < size ? {limit} + {longest} : size)"
        find = r.file.helper("find_stop")
        found = f"{find}({r.inn}.data, {start}, {limit}, {r.stops(type_)}, {longest}, &{stop})"
        found = f"({found} && {stop} <= {r.inn}.end)"
    r.when(f"!{found}", r.note("short", r.at, refuse), r.leave())
    r.take(f"(int64_t)({stop} - {start})", refuse)
    return stop


def _is_pad(target: str, pad: bytes) -> str:
    return "(" + " || ".join(f"{target}.data[{target}.size - 1] == {byte}" for byte in sorted({*pad})) + ")"


def _data(r: ReadWriter, segment: Data, here: Here, behind: Behind) -> None:
    scope, struct, path = here
    member = struct.members[segment.name]
    target, refuse = f"{path}{member.cname}", r.refuse(segment)
    view = r.file.helper("view")
    factor = {"hex_to_ascii": "*", "ascii_to_hex": "/", None: ""}[segment.convert]
    r.begin()
    size = _rest(r, behind) if segment.size == "rest" else _sized(r, segment.size, scope, "length", refuse, factor)
    r.take(size, refuse)
    r.stands(segment.name)
    start = f"{r.inn}.from"
    found = f"{r.at} - {start}"

    def kept() -> None:
        r.is_there(member, here, sure=segment.convert is None)
        if segment.least:
            r.when(f"{target}.size < {segment.least}", r.note("short", start, refuse))

    if segment.never:
        _never(r, segment, refuse)
    if member.room and (segment.convert or segment.swap):
        room, capacity = f"{path}{member.room}", member.capacity
        factor = {"hex_to_ascii": " / 2", "ascii_to_hex": " * 2", None: ""}[segment.convert]
        r.when(f"({found}){factor} > {capacity}", "notes->no_room = true;", r.leave())
        with r.block(""):
            if segment.convert == "hex_to_ascii":
                r.add(f"if ({r.file.helper('unhex')}({r.raw}, {found}, {room})) {{")
            elif segment.convert == "ascii_to_hex":
                r.add(f"{r.file.helper('hex')}({r.raw}, {found}, {room});", "{")
            else:
                r.add(f"memcpy({room}, {r.raw}, {found});", "{")
            r.out.depth += 1
            r.add(f"{target} = {view}({room}, ({found}){factor});")
            if segment.swap:
                r.add(f"{r.file.helper('swap')}({room}, {target}.size, {segment.swap});")
            kept()
            r.out.depth -= 1
            if segment.convert == "hex_to_ascii":
                r.add("} else {", f"    {r.note('digits', start, refuse)}", "}")
            else:
                r.add("}")
    else:
        r.add(f"{target} = {view}({r.raw}, {found});")
        kept()


def _never(r: ReadWriter, segment: Data, refuse: str) -> None:
    place = r.local("size_t", "never_place")
    tests = " || ".join(f"{r.inn}.data[{place}] == {byte}" for byte in sorted({*segment.never}))
    with r.block(f"for ({place} = {r.inn}.from; {place} < {r.at}; {place}++)"), r.block(f"if ({tests})"):
        r.add(r.note("value", place, refuse), "break;")


def _bits(r: ReadWriter, segment: Bits, here: Here, behind: Behind) -> None:
    scope, struct, path = here
    refuse = r.refuse(segment)
    r.begin()
    later = [one for one in segment.parts if one.constants is None and one.is_ and constant_of(one.is_) is None]
    awaited = [(_Awaited(r, segment, struct.members[one.name], here), one.is_) for one in later]
    size = _sized(r, segment.type.size, scope, "length", refuse)
    r.take(size, refuse)
    r.stands(segment.name)
    for part in segment.parts:
        r.stands(part.name)
    whole = r.local("uint64_t", "bits")
    wire, failing = r.read_number(segment.type, r.raw, size, segment)

    with _if_number(r, segment, failing, f"{r.inn}.from"):
        if not failing:
            r.add(f"{whole} = (uint64_t){wire};")
        for part in segment.parts:
            member = struct.members[part.name]
            target = f"{path}{member.cname}"
            mask = number((1 << part.high - part.low + 1) - 1)
            source = whole if not failing else wire
            shifted = f"{source} >> {part.low}" if part.low else source
            r.add(f"{target} = ({member.ctype})({shifted} & {mask});")
            r.is_there(member, here, sure=not failing)
            _among(r, segment, part, member, target, f"{r.inn}.from")
    for one, wanted in awaited:
        assert wanted is not None
        one.compare("value", partial(r.writer(scope).value, wanted), wanted)


# ---- lengths and counts -------------------------------------------------------------------------------------


def _counted(r: ReadWriter, segment: Length | Count, here: Here, behind: Behind) -> None:
    scope, struct, _ = here
    member = struct.members[segment.name]
    refuse = r.refuse(segment)
    r.begin()
    wanted = _wanted_length(r, segment) if isinstance(segment, Length) else _wanted_count(r, segment, here)
    sure = segment.type.kind == "int" and segment.type.fixed_size is not None
    awaited = None if wanted is None else _Awaited(r, segment, member, here, sure=sure)
    size = _sized(r, segment.type.size, scope, "length", refuse)
    r.take(size, refuse)
    r.stands(segment.name)
    wire, failing = r.read_number(segment.type, r.raw, size, segment)
    _store_number(r, segment, member, here, wire, failing, f"{r.inn}.from", segment.type)
    if awaited is None or wanted is None:
        return
    plus = f" + {number(segment.plus)}" if segment.plus else ""
    needed = segment.of if isinstance(segment, Length) else (segment.of,)
    awaited.compare("length", lambda: Val("number", f"({wanted()}{plus})"), *needed)


def _wanted_length(r: ReadWriter, length: Length) -> Callable[[], str] | None:
    if is_followed(length, r.segments):
        return None
    targets = targets_of(length, r.segments)
    converted = [
        name
        for name, target in targets.items()
        if length.plain and any(isinstance(one, Data) and one.convert is not None for one in target.segments)
    ]
    if converted:
        raise CannotSayError(length.at, "a length before conversion, compared with what is converted")
    counted = [name for name in length.of if name not in converted]
    room = r.file.helper("room")
    spans = [r.span(name) for name in wire_names(r.segments, counted)]

    def text() -> str:
        total = " + ".join(f"{room}(&{span})" for span in spans if span is not None) or "0"
        return f"({total}) / {length.unit}" if length.unit != 1 else total

    return text


def _wanted_count(r: ReadWriter, count: Count, here: Here) -> Callable[[], str] | None:
    repeat = r.by_name.get(count.of)
    there = comes_with(count.of, count, r.segments)
    followed = isinstance(repeat, Repeat) and count.plus == 0 and is_plain_name(repeat.times, count.name)
    if not isinstance(repeat, Repeat) or (there and followed):
        return None
    member = here[1].members.get(count.of)
    if member is None:
        raise CannotSayError(count.at, "a count of a list that stands elsewhere")
    return lambda: f"(int64_t){here[2]}{member.cname}.count"


# ---- values and conditions ----------------------------------------------------------------------------------


def _value(r: ReadWriter, segment: Value, here: Here, behind: Behind) -> None:
    scope, struct, path = here
    member = struct.members[segment.name]
    r.begin()
    r.add(f"{r.inn}.from = {r.at};")
    value = r.writer(scope).value(segment.read)
    text = r.writer(scope).bytes(value) if value.kind == "bytes" else f"({member.ctype}){value.text}"
    if value.fold:
        upper = "true" if value.fold == "upper" else "false"
        folded = r.file.helper("folded")
        text = f"{folded}({text}, {upper}, {path}{member.room}, {member.capacity}, &notes->no_room)"
    there = value.there or "true"
    fails = "&bad" in text or "&bad" in there
    if fails:
        r.add("bad = false;")
    if value.there:
        r.when(there, f"{path}{member.cname} = {text};", f"{path}{member.flag} = true;")
        known = r.known.get(id(member), "")
        if known:
            r.add(f"{known} = {path}{member.flag} ? 1 : 2;")
        return
    r.add(f"{path}{member.cname} = {text};")
    if fails:
        r.when("bad", r.note("value", r.at, r.refuse(segment)))
        with r.block("else"):
            r.add(f"{path}{member.flag} = true;")
            r.stands(segment.name)
            r.stored(member, scope, segment.name, sure=False)
    else:
        r.add(f"{path}{member.flag} = true;")
        r.stands(segment.name)
        r.stored(member, scope, segment.name)


def _require(r: ReadWriter, segment: Require, here: Here, behind: Behind) -> None:
    r.begin()
    text = r.writer(here[0]).condition(segment.condition)
    if "&bad" in text:
        holds = r.local("bool", "holds", "false")
        r.add("bad = false;", f"{holds} = {text};")
        text = f"{holds} && !bad"
    r.when(f"!({text})", r.note("require", r.at, r.refuse(segment)))


# ---- check codes --------------------------------------------------------------------------------------------


def _check(r: ReadWriter, segment: Check, here: Here, behind: Behind) -> None:
    r.begin()
    start = r.local("size_t", "check_start")
    r.add(f"{start} = {r.at};")
    r.take(str(segment.size))
    r.stands(segment.name)
    if segment.verify != "error":
        return
    if covers_later(segment, r.segments):
        r.late.append(r.in_this_buffer(lambda: _verify(r, segment, here, start)))
    else:
        _verify(r, segment, here, start)


def _verify(r: ReadWriter, segment: Check, here: Here, start: str) -> None:
    """Compares a check code that was read with the bytes it should be."""
    code = r.local("uint64_t", "code")
    wrong = r.file.helper("wrong_check")
    with r.block(""):
        r.add(f"uint8_t right[{segment.size}];")
        fails = work_out(r, segment, here[0], code, start)
        put_code(r, segment, code, "right")
        compare = "memcmp(right, {raw}, {size}) != 0"
        if segment.form in ("hex", "HEX"):
            compare = f"!{r.file.helper('same_digits')}(right, {{raw}}, {{size}})"
        test = compare.format(raw=f"{r.inn}.data + {start}", size=segment.size)
        if fails:
            r.when("bad", r.note("value", start), "notes->unchecked = true;")
            with r.block(f"else if ({test})"):
                r.add(f"{wrong}_at({r.n}, fk_wire({r.n}, {start}));")
        else:
            r.when(test, f"{wrong}_at({r.n}, fk_wire({r.n}, {start}));")


# ---- choices and optional parts -----------------------------------------------------------------------------


def _choose(r: ReadWriter, segment: Choose, here: Here, behind: Behind) -> None:
    scope, struct, _ = here
    r.absent(segment)
    value = r.writer(scope).value(segment.on)
    sure, r.is_sure = r.is_sure, False
    tests = case_tests(r, segment, value, here)
    for place, (test, segments) in enumerate(tests):
        with r.block(f"{'else ' if place else ''}if ({test})"):
            r.without((segment,), struct, segments)
            r.list(segments, here, behind, all_is_read=False)
    with r.block("else" if tests else ""):
        if segment.otherwise is not None:
            r.without((segment,), struct, segment.otherwise)
            r.list(segment.otherwise, here, behind, all_is_read=False)
        else:
            r.add(r.note("value", r.at, r.refuse(segment)), r.leave())
    r.is_sure = sure


def _optional(r: ReadWriter, segment: Optional, here: Here, behind: Behind) -> None:
    _, struct, _ = here
    r.absent(segment)
    size = _rest(r, behind)
    sure, r.is_sure = r.is_sure, False
    with r.block(f"if ({size} > 0)"):
        r.list(segment.of, here, behind, all_is_read=False)
    with r.block("else"):
        r.without(segment.of, struct)
    r.is_sure = sure


# ---- records and lists --------------------------------------------------------------------------------------


def _record(r: ReadWriter, segment: Record, here: Here, behind: Behind) -> None:
    scope, struct, path = here
    member = struct.members[segment.name]
    assert member.inside is not None
    start = r.local("size_t", "record_start")
    r.begin()
    r.add(f"{start} = {r.at};")
    if member.has:
        r.add(f"{path}{member.flag} = true;")
    known = r.known.get(id(member), "")
    if known:
        r.add(f"{known} = 1;")
    inside = CScope(scope)
    inner_path = f"{path}{member.cname}."
    r.declare(segment.of, inside, member.inside, inner_path)
    entry = scope.entries.get(segment.name)
    if entry is not None:
        scope.entries[segment.name] = replace(entry, inside=inside)
    before = len(r.deferred)
    r.list(segment.of, (inside, member.inside, inner_path), behind, all_is_read=False)
    for one in r.deferred[before:]:
        one.write = _within(r, known, one.write)
    r.stands_from(segment.name, start)


def _within(r: ReadWriter, known: str, write: Callable[[], None]) -> Callable[[], None]:
    def inside() -> None:
        with r.block(f"if ({known} == 1)" if known else ""):
            write()

    return inside


def _repeat(r: ReadWriter, segment: Repeat, here: Here, behind: Behind) -> None:
    if isinstance(segment.of, FieldType):
        _values(r, segment, segment.of, here, behind)
    else:
        _items(r, segment, segment.of, here, behind)


def _values(r: ReadWriter, segment: Repeat, of: FieldType, here: Here, behind: Behind) -> None:
    scope, struct, path = here
    member = struct.members[segment.name]
    assert member.item is not None
    size, refuse = of.fixed_size, r.refuse(segment)
    if size is None:
        raise CannotSayError(segment.at, "a list of values of any size")
    r.begin()
    if segment.times == "rest":
        room = _rest(r, behind)
    else:
        times = (
            r.number(segment.times, scope)
            if isinstance(segment.times, Expression)
            else constant(int(segment.times or 0))
        )
        if times.high > MOST // max(size, 1):
            raise CannotSayError(segment.at, "a list without bound")
        local = r.ask(times, "length", "times", refuse)
        room = f"{size} * {local}"
    r.take(room, refuse)
    r.stands(segment.name)
    target, index = f"{path}{member.cname}", r.local("size_t", "index")
    found = f"({r.at} - {r.inn}.from)"
    header = ""
    if segment.times == "rest" and size > 1:
        r.when(f"{found} % {size} != 0", r.note("short", f"{r.inn}.from", refuse))
        header = "else"
    with r.block(header):
        r.when(f"{found} / {size} > {member.capacity}", "notes->no_room = true;", r.leave())
        inside = _on_the_wire(of)
        if of.kind == "fraction" and member.item.kind == "decimal":
            raise CannotSayError(segment.at, "a list of numbers with any number of decimals")
        fails = r.local("bool", "fails", "false") if inside.kind not in ("int", "float") else ""
        if fails:
            r.add(f"{fails} = false;")
        with r.block(f"for ({index} = 0; {index} < {found} / {size}; {index}++)"):
            raw = f"({r.inn}.data + {r.inn}.from + {size} * {index})"
            item = f"{target}.items[{index}]"
            if of.kind == "float":
                wire, _ = r.read_number(replace(of, kind="int", signed=False), raw, "", segment)
                how = "float" if size == 4 else "double"
                cast = "(uint32_t)" if size == 4 else ""
                r.add(f"{item} = {r.file.helper(how)}({cast}{wire});")
            else:
                wire, failing = r.read_number(inside, raw, str(size), segment)
                if failing:
                    r.when(f"{failing} != 0", f"{fails} = true;")
                if of.kind == "scaled":
                    assert of.scale is not None
                    wire = f"((int64_t){wire} * {number(of.scale.factor)} + {number(of.scale.offset)})"
                r.add(f"{item} = ({member.item.ctype}){wire};")
        r.add(f"{target}.count = {found} / {size};")
        if fails:
            r.when(fails, r.note("digits", f"{r.inn}.from", refuse), f"{target}.count = 0;")
        r.is_there(member, here, sure=segment.times != "rest" and not fails)


def _items(r: ReadWriter, segment: Repeat, of: Segments, here: Here, behind: Behind) -> None:
    scope, struct, path = here
    member = struct.members[segment.name]
    assert member.inside is not None
    target = f"{path}{member.cname}"
    start, begun = r.local("size_t", "list_start"), r.local("size_t", "item_start")
    r.begin()
    r.add(f"{start} = {r.at};", f"{target}.count = 0;")
    turn = r.local("unsigned long", "list_turn")
    r.add(f"{turn} = notes->turn;")
    count, whole = "", ""
    if segment.times == "rest":
        whole = r.local("size_t", "whole")
        size = _rest(r, behind)
        r.add(f"{whole} = {r.inn}.end;", f"{r.inn}.end = {start} + (size_t){size};")
        header = f"while ({r.at} < {r.inn}.end)"
    elif segment.times is None:
        header = ""
    else:
        times = (
            r.number(segment.times, scope) if isinstance(segment.times, Expression) else constant(int(segment.times))
        )
        count = r.ask(times, "length", "times")
        if times.low < 0:
            r.when(f"{count} < 0", r.note("length", r.at), r.leave())
        header = f"while ((int64_t){target}.count < {count})"
    ended = r.local("bool", "is_last", "false") if segment.until is not None else ""
    if segment.until is not None:
        r.add(f"{ended} = false;")
        header = f"while (!{ended})"
    item_path = f"{target}.items[{target}.count]."
    inside = CScope(scope)
    index = f"(int64_t){target}.count"
    filled = segment.align - 1 if segment.align > 1 and not segment.between else 0
    with r.block(header):
        if segment.align > 1 and segment.between:
            r.add(f"{r.at} += ({segment.align} - ({r.at} - {start}) % {segment.align}) % {segment.align};")
        r.add(f"{begun} = {r.at};")
        r.when(f"{target}.count >= {member.capacity}", "notes->no_room = true;", r.leave())
        r.forget(member.inside)
        r.initial(member.inside, item_path)
        inside.entries[INDEX] = Val("number", index, 0, member.capacity)
        last = f"{index} == {count} - 1" if count else f"{r.at} + {filled} >= {r.inn}.end"
        if ended:
            inside.entries[LAST] = Val("number", f"(int64_t){ended}", 0, 1, is_flag=True)
        else:
            inside.entries[LAST] = Val("number", f"(int64_t)({last})", 0, 1, is_flag=True)
        inside.entries[PREVIOUS] = _previous(r, member, target)
        r.declare(of, inside, member.inside, item_path)
        outside, r.in_item = r.in_item, True
        r.list(of, (inside, member.inside, item_path), ())
        r.in_item = outside
        r.add(f"{target}.count++;")
        if not isinstance(segment.times, int) and (may_be_empty(r.static, segment) or _has_open_number(of)):
            r.when(
                f"{r.at} == {begun}",
                f"fk_note_at({r.n}, FRAMEKIT_LENGTH, fk_wire({r.n}, {r.at}), {turn}, -1);",
                r.leave(),
            )
        if segment.align > 1 and not segment.between:
            r.take(f"(int64_t)(({segment.align} - ({r.at} - {start}) % {segment.align}) % {segment.align})")
        if not segment.between:
            r.stands_from(segment.name, r.at)
        r.add(f"(void){begun};")
    if whole:
        r.add(f"{r.inn}.end = {whole};")
    r.stands_from(segment.name, start)
    r.is_there(member, here)


def _has_open_number(segments: Segments) -> bool:
    """Whether there is a number that its end shows: of bad bytes it may take none, though a good one has a digit."""
    return any(isinstance(one, Field) and one.type.is_delimited and one.type.form is not None for one in segments)


def _previous(r: ReadWriter, member: CMember, target: str) -> Val:
    from framekit.codec.c.layout import scope_of

    assert member.inside is not None
    inside = scope_of(member.inside, f"{target}.items[{target}.count - 1].")
    return Val("record", target, there=f"{target}.count > 0", inside=inside)


def _item_end(r: ReadWriter, segment: ItemEnd, here: Here, behind: Behind) -> None:
    if segment.until is None:
        return
    entry = here[0].find(LAST)
    assert entry is not None
    ended = entry.text.removeprefix("(int64_t)")
    text = r.ask_whether(r.writer(here[0]).condition(segment.until), "value")
    r.add(f"{ended} = {text};")


# ---- frames inside, wraps -----------------------------------------------------------------------------------


def _inner(r: ReadWriter, segment: Inner, here: Here, behind: Behind) -> None:
    scope, struct, path = here
    member = struct.members[segment.name]
    fixed = r.static.present(segment).fixed
    start = r.local("size_t", "inner_start")
    r.begin()
    r.add(f"{start} = {r.at};")
    if isinstance(segment.size, Expression):
        size = _sized(r, segment.size, scope, "length", "-1")
    elif fixed is not None:
        size = str(fixed)
    elif segment.size == "rest" or r.knows_behind(behind):
        size = _rest(r, behind)
    else:
        size = _found_inside(r, segment, here)
    r.take(size)
    r.stands(segment.name)
    target = f"{path}{member.cname}"
    function = r.file.inner_reader(segment)
    fault = r.local("struct framekit_fault", "inner_fault", "{ FRAMEKIT_OK, 0, -1 }")
    r.add(f"{function}({r.raw}, {r.at} - {r.inn}.from{r.file.hand_on}, (void *)&{target}, &{fault}, notes);")
    r.when("notes->no_room", r.leave())
    r.when(
        f"{fault}.reason != FRAMEKIT_OK",
        "notes->turn++;",
        f"fk_note({r.n}, {fault}.reason, {start} + {fault}.offset, {fault}.refuse);",
    )
    r.is_there(member, here)


def _found_inside(r: ReadWriter, segment: Inner, here: Here) -> str:
    """The size of a frame inside that ends by itself."""
    size = r.local("int64_t", "inner_size")
    function = r.file.first_inside(segment)
    room = f"{r.at} < {r.inn}.end ? {r.inn}.end - {r.at} : 0"
    r.add(f"{size} = {function}({r.inn}.data + {r.at}, {room}{r.file.hand_on}, true, 0);")
    r.when(f"{size} <= 0", r.note("value", r.at), r.leave())
    return size


def _wrap(r: ReadWriter, segment: Wrap, here: Here, behind: Behind) -> None:
    scope, struct, path = here
    fixed = r.static.all(segment.of).fixed
    r.begin()
    opened = r.fresh("content")
    r.locals.append(f"struct fk_in {opened};")
    start = r.local("size_t", "wrap_start")
    r.add(f"{start} = {r.at};")
    known = segment.size
    if known is None and fixed is not None and segment.escape is None:
        known = segment.coding.sizes(exactly(fixed)).fixed
    if segment.escape is not None:
        size = _end_of_doubled(r, segment, fixed, behind)
    elif known is None:
        size = _rest(r, behind)
    elif isinstance(known, int):
        size = str(known)
    else:
        size = _sized(r, known, scope, "short", "-1")
    r.take(size)
    r.stands(segment.name)
    raw, room = r.raw, ""
    if not isinstance(segment.coding, Plain):
        from framekit.codec.c.source import identifier

        name = segment.name or ""
        shown = name.strip("_") if name.startswith("_") else name
        room = f"{identifier(shown)}_plain"
    r.add(f"memset(&{opened}, 0, sizeof {opened});")
    r.add(f"{opened}.outer = {r.n};", f"{opened}.start = {start};", f"{opened}.notes = notes;")
    r.add(f"{opened}.raw = {raw};", f"{opened}.raw_size = {r.at} - {r.inn}.from;", f"{opened}.quiet = {r.inn}.quiet;")
    has_content = r.local("bool", "has_content", "true")
    r.add(f"{has_content} = true;")
    fails = open_wrap(r, segment, opened, f"{path}{room}", struct.rooms.get(room, 0), fixed, has_content, here)
    outside = r.inn, r.deferred, r.in_item, r.is_sure
    r.inn, r.deferred, r.in_item = opened, [], False
    if fails:
        r.is_sure = False
        r.when(f"!{has_content}", f"{opened}.quiet = true;")
    inside = segment.of
    with r.part("0", -1, has_checks(inside)):
        _limits(r, segment, scope)
        r.region(inside, scope, path, struct, all_is_read=False)
    inn, deferred, r.in_item, r.is_sure = outside
    waiting, r.deferred = r.deferred, deferred
    if fails:
        with r.block(f"if (!{has_content})"):
            _forget_content(r, inside, struct)
    r.inn = inn
    r.deferred += waiting
    r.add(f"(void){has_content};", f"(void){start};")


def _forget_content(r: ReadWriter, segments: Segments, struct: Any) -> None:
    """What is worked out of nothing is no value of the frame, and no check code counts it."""
    from framekit.definition.model.frames import flat

    for one in flat(segments):
        for name in one.value_names:
            member = struct.members.get(name)
            known = "" if member is None else r.known.get(id(member), "")
            if known:
                r.add(f"{known} = 0;")
        if one.name in r.spans:
            r.add(f"{r.spans[one.name]}.there = false;")
    r.add(";")


def _limits(r: ReadWriter, segment: Wrap, scope: CScope) -> None:
    refuse = r.refuse(segment)
    if segment.least:
        r.when(f"{r.inn}.end < {segment.least}", r.note("short", "0", refuse))
    if segment.most is not None:
        text = str(segment.most) if isinstance(segment.most, int) else r.number(segment.most, scope).text
        if "&bad" in text:
            raise CannotSayError(segment.at, "a greatest size that may not be known")
        r.when(f"(int64_t){r.inn}.end > {text}", r.note("too_long", "0", refuse))


def _end_of_doubled(r: ReadWriter, segment: Wrap, fixed: int | None, behind: Behind) -> str:
    """The size of a region in which an escape byte is doubled: it shows its end itself, or takes the rest."""
    assert segment.escape is not None
    some = r.embedded_in(segment)
    stop = r.local("size_t", "wrap_end")
    if fixed is not None:
        where = f"{r.inn}.data, {r.at}, {r.inn}.end, {segment.escape}"
        call = f"{r.file.helper('end_of_stuffed')}({where}, {fixed}, &{stop}) == 0"
    elif any(r.static.present(one).fixed != 0 for one, _ in behind):
        call = f"{r.file.helper('end_of_region')}({r.inn}.data, {r.at}, {r.inn}.end, {segment.escape}, {some}, &{stop})"
    else:
        return _rest(r, behind)
    r.when(f"!({call})", r.note("short", r.at), r.leave())
    return f"(int64_t)({stop} - {r.at})"


READ.update(
    {
        Const: _const,
        Skip: _skip,
        Fill: _fill,
        Field: _field,
        Data: _data,
        Bits: _bits,
        Length: _counted,
        Count: _counted,
        Value: _value,
        Require: _require,
        Check: _check,
        Choose: _choose,
        Optional: _optional,
        Record: _record,
        Repeat: _repeat,
        ItemEnd: _item_end,
        Inner: _inner,
        Wrap: _wrap,
    }
)
