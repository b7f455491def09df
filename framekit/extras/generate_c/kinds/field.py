"""Write `field` in C: numbers, texts and bytes."""

from __future__ import annotations

from dataclasses import replace

from framekit.codec.python import forms
from framekit.codec.python.encode_plan import Task
from framekit.codec.python.expressions import constant_of
from framekit.codec.python.facts import is_fixed
from framekit.definition.expression import Expression, Text
from framekit.definition.model.segments import Data, Field, Segment
from framekit.definition.problems import CannotSayError
from framekit.extras.generate_c.expressions import LEAST, MOST, CScope, Val, constant
from framekit.extras.generate_c.functions import CKind
from framekit.extras.generate_c.kinds.numbers import (
    Awaited,
    bound,
    fits,
    if_number,
    measure_number,
    put_decimal,
    put_float,
    put_number,
    put_scaled,
    read_float,
    store_number,
    validate_read,
    wire_number,
    wire_type,
)
from framekit.extras.generate_c.layout import CMember, val_of
from framekit.extras.generate_c.reader import Behind, Here, ReadWriter
from framekit.extras.generate_c.source import number, string
from framekit.extras.generate_c.writer import Taken, WriteWriter, both

# ---- read -----------------------------------------------------------------------------------------------------


def _read(r: ReadWriter, segment: Field, here: Here, behind: Behind) -> None:
    scope, struct, _ = here
    member = struct.members[segment.name]
    type_ = segment.type
    r.begin()
    wanted = segment.is_
    if wanted is not None and segment.constants is None and constant_of(wanted) is not None:
        wanted = None  # compared immediately
    awaited = None if wanted is None else Awaited(r, segment, member, here)
    if segment.long is not None:
        _long(r, segment, here)
    elif type_.kind in ("ascii", "bytes"):
        _text(r, segment, member, here, behind)
    elif type_.is_delimited:
        _delimited_number(r, segment, member, here)
    elif type_.size is None:
        raise CannotSayError(segment.at, f"'{segment.name}' is a number that its end shows")
    else:
        refuse = r.refuse(segment)
        size = r.sized(type_.size, scope, "length", refuse)
        r.take(size, refuse)
        r.stands(segment.path)
        if type_.kind in ("float", "hex_float"):
            _read_float(r, segment, member, here, size)
        elif member.kind == "decimal":
            _decimal(r, segment, member, here, size)
        else:
            store_number(r, segment, here, r.read_number(wire_type(type_), r.raw, size, segment))
    if awaited is not None and wanted is not None:
        awaited.compare("value", lambda: r.default_value(segment, wanted, scope), wanted)


def _delimited_number(r: ReadWriter, segment: Field, member: CMember, here: Here) -> None:
    """Write the reading of a number in text that ends at certain bytes."""
    type_, start = segment.type, r.local("size_t", "text_start")
    stop = _up_to_end(r, segment, start)
    size = f"(int64_t)({stop} - {start})"
    if type_.form is not None and type_.form.empty:
        with r.block(f"if ({stop} == {start})"):
            r.mark(member, 2)
            r.add(";")
        header = "else"
    else:
        header = ""
    sure, r.is_sure = r.is_sure, r.is_sure and not header
    with r.block(header):
        if member.kind == "decimal":
            _decimal(r, segment, member, here, size)
        else:
            store_number(r, segment, here, r.read_number(wire_type(type_), r.raw, size, segment))
    r.is_sure = sure
    if type_.end is not None:
        r.add(f"{r.at} += {len(type_.end)};")
    r.stands_from(segment.path, start)


def _decimal(r: ReadWriter, segment: Field, member: CMember, here: Here, size: str) -> None:
    """Write the reading of a number with a variable number of decimals."""
    scope, _, path = here
    if segment.is_ is not None or segment.constants is not None or segment.limits is not None:
        raise CannotSayError(segment.at, "a number with any number of decimals that is compared with others")
    call = r.file.helper("decimal_value")
    form = r.decimal_form(segment.type, size)
    with if_number(r, segment, f"{call}({r.raw}, {form}, &{path}{member.cname})", f"{r.inn}.from"):
        if member.has:
            r.add(f"{path}{member.flag} = true;")
    scope.entries[segment.name] = Val("other")


def _read_float(r: ReadWriter, segment: Field, member: CMember, here: Here, size: str) -> None:
    if segment.is_ is not None or segment.constants is not None:
        raise CannotSayError(segment.at, "a float that is always the same")
    target, start = f"{here[2]}{member.cname}", f"{r.inn}.from"
    text, failing = read_float(r, segment.type, r.raw, size, segment)
    with if_number(r, segment, failing, start):
        r.add(f"{target} = {text};")
        if member.has:
            r.add(f"{here[2]}{member.flag} = true;")
        validate_read(r, segment, member, target, start)
    here[0].entries[segment.name] = Val("other")


def _long(r: ReadWriter, segment: Field, here: Here) -> None:
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
    r.stands_from(segment.path, start)
    store_number(r, segment, here, (value, ""), start)


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
        r.stands_from(segment.path, start)
        place = start
    else:
        size = r.rest(behind) if type_.size is None else r.sized(type_.size, scope, "length", refuse)
        r.take(size, refuse)
        r.stands(segment.path)
        r.add(f"{target} = {view}({r.raw}, (size_t){size});")
        if type_.kind == "ascii" and type_.end is not None:
            r.add(f"{target}.size = {r.file.helper('before')}({target}, {string(type_.end)}, {len(type_.end)});")
        if type_.kind == "ascii" and type_.pad is not None:
            with r.block(f"while ({target}.size > 0 && {_is_pad(target, type_.pad)})"):
                r.add(f"{target}.size--;")
        place = f"{r.inn}.from"
    r.is_there(member, here)
    validate_read(r, segment, member, target, place)


def _up_to_end(r: ReadWriter, segment: Field, start: str) -> str:
    """Write the reading up to the end mark of a text; return the local with the offset of the end mark."""
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
        if r.inn == "in":  # the end of the last item may be outside of the list
            limit = f"({limit} + {longest} < size ? {limit} + {longest} : size)"
        find = r.file.helper("find_stop")
        found = f"{find}({r.inn}.data, {start}, {limit}, {r.stops(type_)}, {longest}, &{stop})"
        found = f"({found} && {stop} <= {r.inn}.end)"
    r.when(f"!{found}", r.note("short", r.at, refuse), r.leave())
    r.take(f"(int64_t)({stop} - {start})", refuse)
    return stop


def _is_pad(target: str, pad: bytes) -> str:
    return "(" + " || ".join(f"{target}.data[{target}.size - 1] == {byte}" for byte in sorted({*pad})) + ")"


# ---- built ----------------------------------------------------------------------------------------------------


def _values(w: WriteWriter, segment: Field, taken: Taken) -> list[Task]:
    waits = w.waits(segment.is_ or segment.build or segment.default)
    if segment.default is None or segment.build is not None or segment.constants is not None:
        waits |= w.waits(segment.when)
    if segment.when is not None:
        waits |= w.waits(segment.default)
    needed = segment.build is None and segment.default is None and segment.is_ is None and segment.constants is None
    tasks = [Task((segment.name,), waits, lambda _: _take(w, segment, taken), not needed and segment.is_ is None)]
    if segment.is_ is None and not is_fixed(segment):
        waits = w.waits(segment.when) | {segment.name}
        tasks.append(Task((), waits, lambda _: _validate(w, segment, taken)))
    size = segment.type.size
    if isinstance(size, Expression) and segment.type.kind in ("ascii", "bytes") and not w.size_by_length(segment):
        waits = w.waits(segment.when, size) | {segment.name}
        tasks.append(Task((), waits, lambda _: told_size(w, segment, segment.name, size, taken)))
    return tasks


def _take(w: WriteWriter, segment: Field, taken: Taken) -> None:
    member = taken.member(segment.name)
    if member.kind == "float":
        _take_float(w, segment, member, taken)
        return
    if member.kind == "decimal":
        _take_decimal(w, segment, member, taken)
        return
    is_text = member.kind == "bytes"
    local = w.value_local(f"{segment.name}_value", is_text=is_text)
    there = ""
    if not is_text and member.high > MOST:
        _take_wide(w, segment, member, taken)
        return
    condition = ""
    uses_when = segment.default is None or segment.build is not None or segment.constants is not None
    if segment.when is not None and uses_when and not (segment.constants is not None and is_fixed(segment)):
        condition = w.holds(segment.when, taken)
    if segment.constants is not None and is_fixed(segment):
        w.add(f"{local} = {_shown(w, segment.constants[0])};")
        if segment.when is not None:
            condition = w.holds(segment.when, taken)
            there = condition
    elif segment.is_ is not None:
        with w.where(condition):
            _work_out(w, segment, segment.is_, local, w.with_missing(taken), is_text)
        there = condition
    else:
        there = _take_given(w, segment, member, taken, local, condition)
    if not is_text:
        bound(w, member, local)
    entry = val_of(member, local)
    if not is_text and entry.kind == "number":
        limits = forms.value_range(segment)
        low = entry.low if limits.least is None else max(entry.low, min(limits.least, 0))
        high = entry.high if limits.most is None else min(entry.high, max(limits.most, 0))
        entry = replace(entry, text=local, low=min(low, entry.low), high=max(high, entry.high))
    taken.scope.entries[segment.name] = replace(entry, there=there, wire=_room_text(segment))


def _take_given(w: WriteWriter, segment: Field, member: CMember, taken: Taken, local: str, condition: str) -> str:
    """Write the assignment of a value that callers may give, or its default; return when the value is present."""
    is_text = member.kind == "bytes"
    given = f"{'' if is_text else '(int64_t)'}{taken.path}{member.cname}"
    source, flag = w.with_missing(taken), w.given_flag(member, taken)
    chosen = segment.build or segment.default
    plain_text = segment.values is not None and chosen is not None and isinstance(chosen.root, Text)
    worked_out = chosen if segment.constants is None and not plain_text else None
    if worked_out is not None and not w.can_say(worked_out, source, segment.name):
        w.add(f"{local} = {given};")
        w.fail_if(f"{condition} && !{flag}" if condition else f"!{flag}", "value")
        return condition
    if segment.constants is not None:
        w.add(f"{local} = {flag} ? {given} : {_shown(w, segment.constants[0])};")
        return ""
    if chosen is None:
        w.add(f"{local} = {given};")
        if condition:
            w.fail_if(f"{condition} && !{flag}", "value")
        return condition or _flag_of_empty(segment, member, taken)
    w.when(flag, f"{local} = {given};")
    if not condition or segment.build is None:
        with w.block("else"):
            _work_out(w, segment, chosen, local, source, is_text)
        return ""
    with w.block(f"else if ({condition})"):
        _work_out(w, segment, segment.build, local, source, is_text)
    with w.block("else"):
        if segment.default is not None:
            _work_out(w, segment, segment.default, local, source, is_text)
        else:
            w.add(";")
    return condition if segment.default is None else ""


def _room_text(segment: Field) -> str:
    """Return the size in bytes of a value without a length of its own; empty for other values."""
    size = segment.type.fixed_size
    if segment.type.kind in ("ascii", "bytes") or size is None or segment.long is not None:
        return ""
    return str(size)


def _shown(w: WriteWriter, value: int | str | bytes) -> str:
    if isinstance(value, int):
        return number(value)
    data = value.encode("latin-1", "replace") if isinstance(value, str) else value
    return f"{w.file.helper('view')}((const uint8_t *){string(data)}, {len(data)})"


def _work_out(w: WriteWriter, segment: Field, expression: Expression, local: str, taken: Taken, is_text: bool) -> None:
    value = w.default_value(segment, expression, taken.scope)
    if value.kind == "none":
        w.add(";")
        return
    if value.kind != ("bytes" if is_text else "number") or value.fold:
        raise CannotSayError(expression.at, f"'{segment.name}' is worked out as another kind of value")
    text = w.writer(taken.scope).bytes(value) if is_text else value.text
    if value.there:
        nothing = w.file.helper("view") + "(NULL, 0)" if is_text else "0"
        text = f"({value.there} ? {text} : {nothing})"
    w.keep(local, text)
    if value.there and segment.when is None:
        w.fail_if(f"!{value.there}", "value")


def _take_float(w: WriteWriter, segment: Field, member: CMember, taken: Taken) -> None:
    chosen = segment.build or segment.default
    if segment.is_ is not None or segment.constants is not None:
        raise CannotSayError(segment.at, "a float that is always the same")
    given = f"{taken.path}{member.cname}"
    local = w.local(member.ctype, f"{segment.name}_value")
    w.add(f"{local} = {given};")
    if chosen is not None:
        value = constant_of(chosen)
        if value is None or abs(value) > 1 << 24:
            raise CannotSayError(segment.at, "a float whose default is worked out")
        w.when(f"!{w.given_flag(member, taken)}", f"{local} = {value};")
    elif segment.when is not None:
        condition = w.holds(segment.when, taken)
        w.fail_if(f"{condition} && !{w.given_flag(member, taken)}", "value")
    taken.scope.entries[segment.name] = Val("other", local)


def _take_decimal(w: WriteWriter, segment: Field, member: CMember, taken: Taken) -> None:
    if segment.build is not None or segment.default is not None:
        raise CannotSayError(segment.at, "a default of a number with any number of decimals")
    local = w.local(member.ctype, f"{segment.name}_value", "{ 0, 0 }")
    w.add(f"{local} = {taken.path}{member.cname};")
    there = _flag_of_empty(segment, member, taken)
    if segment.when is not None:
        there = w.holds(segment.when, taken)
        w.fail_if(f"{there} && !{w.given_flag(member, taken)}", "value")
    taken.scope.entries[segment.name] = Val("other", local, there=there)


def _flag_of_empty(segment: Field, member: CMember, taken: Taken) -> str:
    """Return the condition that a number is present if its text may be empty; '' for other fields."""
    form = segment.type.form
    return f"{taken.path}{member.flag}" if form is not None and form.empty else ""


def _take_wide(w: WriteWriter, segment: Field, member: CMember, taken: Taken) -> None:
    """Write the assignment of an unsigned 64-bit number."""
    plain = segment.plus == 0 and segment.unit is None and segment.zero_means is None and segment.is_ is None
    if not plain or segment.when is not None or segment.limits is not None or segment.long is not None:
        raise CannotSayError(segment.at, "a number of 64 bits with keys of its own")
    if segment.constants is not None:
        raise CannotSayError(segment.at, "a number of 64 bits that is always the same")
    chosen = segment.build or segment.default
    local = w.local("uint64_t", f"{segment.name}_value")
    w.add(f"{local} = {taken.path}{member.cname};")
    if chosen is not None:
        value = constant_of(chosen)
        if value is None or value < 0:
            raise CannotSayError(segment.at, "a number of 64 bits whose default is worked out")
        w.when(f"!{w.given_flag(member, taken)}", f"{local} = {number(value)};")
    taken.scope.entries[segment.name] = Val("other", local)


def _validate(w: WriteWriter, segment: Field, taken: Taken) -> None:
    """Write the checks of a value that was given or built."""
    member = taken.member(segment.name)
    entry = taken.scope.entries[segment.name]
    local = entry.text
    condition = w.condition(segment, taken)
    there = both(condition)
    if segment.when is not None and member.has:
        flag = f"{taken.path}{member.flag}"
        if segment.default is not None and member.kind in ("number", "bytes"):
            value = w.default_value(segment, segment.default, taken.scope)
            differs = _differs(w, member, local, value, segment)
            w.fail_if(f"!{condition} && {flag} && {differs}", "value")
        else:
            w.fail_if(f"!{condition} && {flag}", "value")
    if segment.constants is not None:
        tests = " && ".join(_differs(w, member, local, _constant(one), segment) for one in segment.constants)
        w.fail_if(f"{there}{tests}", "value")
    elif segment.only and segment.values is not None:
        tests = " && ".join(f"{local} != {number(one)}" for one in segment.values)
        w.fail_if(f"{there}{tests}", "value")
    if member.kind == "bytes":
        _validate_text(w, segment, local, there)
    elif member.kind == "float" and segment.limits is not None:
        low, high = segment.limits
        w.fail_if(f"{there}!({local} >= {low} && {local} <= {high})", "range")
    elif member.kind == "number" and member.high <= MOST and not member.places:
        _validate_number(w, segment, local, there)
    elif member.places and segment.limits is not None:
        low, high = (one * 10**member.places for one in segment.limits)
        w.fail_if(f"{there}({local} < {number(low)} || {local} > {number(high)})", "range")


def _validate_number(w: WriteWriter, segment: Field, local: str, there: str) -> None:
    """Write the checks of a whole number against its range and its unit."""
    limits = forms.value_range(segment)
    tests = [] if limits.least is None or limits.least <= LEAST else [f"{local} < {number(limits.least)}"]
    tests += [] if limits.most is None or limits.most >= MOST else [f"{local} > {number(limits.most)}"]
    if tests:
        w.fail_if(f"{there}({' || '.join(tests)})", "range")
    if segment.unit is not None and segment.unit != 1:
        w.fail_if(f"{there}{local} % {number(segment.unit)} != 0", "value")


def _constant(one: int | str | bytes) -> Val:
    return constant(one.encode("latin-1", "replace") if isinstance(one, str) else one)


def _differs(w: WriteWriter, member: CMember, local: str, value: Val, segment: Segment) -> str:
    if value.kind == "none":
        return "true"
    if member.kind == "bytes" and value.kind == "bytes" and not value.fold:
        text = f"!{w.file.helper('same_bytes')}({local}, {w.writer(CScope()).bytes(value)})"
    elif member.kind == "number" and value.kind == "number":
        if member.places:
            raise CannotSayError(segment.at, "a scaled number compared with another")
        text = f"{local} != {value.text}"
    else:
        raise CannotSayError(segment.at, "a default of another kind")
    if "&bad" in text:
        raise CannotSayError(segment.at, "a default that may have no value")
    return f"!({value.there} && !({text}))" if value.there else text


def _validate_text(w: WriteWriter, segment: Field, local: str, there: str) -> None:
    type_ = segment.type
    if isinstance(type_.size, int):
        exact = type_.kind == "bytes" or (type_.pad is None and type_.end is None)
        w.fail_if(f"{there}{local}.size {'!=' if exact else '>'} {type_.size}", "length")
    elif type_.end is not None:
        held = w.file.helper("holds_end")
        call = f"{held}({local}.data, 0, {local}.size, {string(type_.end)}, {len(type_.end)})"
        w.fail_if(f"{there}{local}.size > 0 && {call}", "value")
    for stop in type_.stops:
        holds, view = w.file.helper("holds"), w.file.helper("view")
        w.fail_if(f"{there}{holds}({local}, {view}((const uint8_t *){string(stop)}, {len(stop)}))", "value")


def told_size(w: WriteWriter, segment: Field | Data, name: str, size: Expression, taken: Taken) -> None:
    """Write the check that a value has the size that other values state; a padded value may be shorter."""
    local = taken.scope.entries[name].text
    if isinstance(segment, Data):
        filled = segment.pad is not None
    else:
        filled = segment.type.pad is not None or segment.type.end is not None
    w.fail_unless_told(segment, size, taken, f"(int64_t){local}.size {'>' if filled else '!='}")


def _put_text(w: WriteWriter, segment: Field, taken: Taken) -> None:
    type_ = segment.type
    local = taken.scope.entries[segment.name].text
    w.add(f"{w.file.helper('put_bytes')}({w.n}, {local}.data, {local}.size);")
    if type_.is_delimited:
        _put_end(w, segment)
        return
    pad = type_.pad if type_.end is None else (type_.pad or b"\0")
    if type_.kind == "ascii" and pad is not None and type_.size is not None:
        size = w.size_of(type_.size, taken)
        if len(pad) != 1:
            raise CannotSayError(segment.at, "a text that is filled up with several bytes")
        left = f"{size} - (int64_t){local}.size"
        w.when(f"{left} > 0", f"{w.file.helper('put_fill')}({w.n}, {string(pad)}, 1, {left});")


def _put_end(w: WriteWriter, segment: Field) -> None:
    """Write the end mark of a text, or note that one of several end marks must follow."""
    end = segment.type.end
    if end is not None:
        w.add(f"{w.file.helper('put_bytes')}({w.n}, {string(end)}, {len(end)});")
        return
    w.open_text(segment)
    if w.inn != "out":
        raise CannotSayError(segment.at, "a text in a wrap that ends before one of several bytes")


def _put(w: WriteWriter, segment: Field, taken: Taken) -> None:
    type_ = segment.type
    local = taken.scope.entries[segment.name].text
    if type_.kind in ("ascii", "bytes"):
        _put_text(w, segment, taken)
    elif type_.kind == "fraction":
        entry = taken.scope.entries[segment.name]
        size = w.size_of(type_.size, taken)
        member = taken.member(segment.name)
        value = f"{local}.number, {local}.places" if member.kind == "decimal" else f"{local}, {member.places}"
        with w.block(f"if ({entry.there})" if entry.there and type_.form is not None and type_.form.empty else ""):
            put_decimal(w, type_, value, size, segment)
        if type_.is_delimited:
            _put_end(w, segment)
    elif type_.is_delimited:
        if type_.kind == "scaled":
            put_scaled(w, type_, local, segment)
        else:
            put_number(w, type_, wire_number(segment, local), "0", segment)
        _put_end(w, segment)
    elif type_.kind in ("float", "hex_float"):
        put_float(w, type_, local, segment)
    elif segment.long is not None:
        short, longer = segment.type.fixed_size or 1, segment.long.type.fixed_size or 0
        wire = wire_number(segment, local)
        with w.block(f"if ({wire} < {number(segment.long.mark)})"):
            put_number(w, segment.type, wire, str(short), segment)
        with w.block("else"):
            put_number(w, segment.type, number(segment.long.mark), str(short), segment)
            put_number(w, segment.long.type, wire, str(longer), segment)
    elif type_.kind == "scaled":
        assert type_.inside is not None and type_.scale is not None
        put_scaled(w, type_, local, segment)
    elif type_.size is None:
        raise CannotSayError(segment.at, f"'{segment.name}' is a number that its end shows")
    else:
        size = w.size_of(type_.size, taken)
        if isinstance(type_.size, Expression):
            fits(w, type_, local, size)
        put_number(w, type_, wire_number(segment, local), size, segment)


KINDS = (CKind(Field, read=_read, values=_values, put=_put, measure=measure_number),)
