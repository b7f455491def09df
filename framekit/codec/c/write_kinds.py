"""How each kind of segment is written in C: its values brought into locals, its bytes put together."""

from __future__ import annotations

from dataclasses import replace

from framekit.codec.c.codings import wrap_up
from framekit.codec.c.expressions import LEAST, MOST, CScope, Val, constant
from framekit.codec.c.functions import order_of_bytes
from framekit.codec.c.layout import CMember, inner_name, val_of
from framekit.codec.c.shared import case_tests, put_code, work_out
from framekit.codec.c.source import INDENT, CannotSayError, identifier, number, string
from framekit.codec.c.writer import BYTES, VALUES, Taken, WriteWriter
from framekit.codec.python import forms
from framekit.codec.python.encode_plan import Task
from framekit.codec.python.expressions import constant_of
from framekit.codec.python.facts import is_fixed
from framekit.codec.python.function import standing_any_way, wire_names
from framekit.definition.codings import Plain
from framekit.definition.expression import Attribute, Expression, Name, Text, walk
from framekit.definition.model.frames import expressions_of, flat
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

Number = Field | Length | Count


def both(condition: str) -> str:
    """Before a test: it counts where the condition holds; '' for none."""
    return f"{condition} && " if condition else ""


def _nothing(w: WriteWriter, segment: Segment, taken: Taken) -> list[Task]:
    return []


# ---- values of fields ---------------------------------------------------------------------------------------


def _field(w: WriteWriter, segment: Field, taken: Taken) -> list[Task]:
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
        tasks.append(Task((), waits, lambda _: _told_size(w, segment, segment.name, size, taken)))
    return tasks


def _member(taken: Taken, name: str) -> CMember:
    return taken.struct.members[name]


def _take(w: WriteWriter, segment: Field, taken: Taken) -> None:
    member = _member(taken, segment.name)
    given = f"{taken.path}{member.cname}"
    if member.kind == "float":
        _take_float(w, segment, member, taken)
        return
    if member.kind == "decimal":
        _take_decimal(w, segment, member, taken)
        return
    is_text = member.kind == "bytes"
    local = w.local("struct framekit_bytes" if is_text else "int64_t", f"{segment.name}_value",
                    "{ NULL, 0 }" if is_text else "0")  # fmt: skip
    there = ""
    wide = not is_text and member.high > MOST
    if wide:
        _take_wide(w, segment, member, taken)
        return
    cast = "" if is_text else "(int64_t)"
    source = w.with_missing(taken)
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
        if condition:
            with w.block(f"if ({condition})"):
                _work_out(w, segment, segment.is_, local, source, is_text)
            there = condition
        else:
            _work_out(w, segment, segment.is_, local, source, is_text)
    else:
        flag = w.given_flag(member, taken)
        chosen = segment.build or segment.default
        plain_text = segment.values is not None and chosen is not None and isinstance(chosen.root, Text)
        worked_out = chosen if segment.constants is None and not plain_text else None
        if worked_out is not None and not w.can_say(worked_out, source, segment.name):
            w.add(f"{local} = {cast}{given};")
            w.fail_if(f"{condition} && !{flag}" if condition else f"!{flag}", "value")
            chosen = None
            there = condition
        if segment.constants is not None:
            w.add(f"{local} = {flag} ? {cast}{given} : {_shown(w, segment.constants[0])};")
        elif chosen is None and (segment.build or segment.default) is not None:
            pass
        elif chosen is None:
            w.add(f"{local} = {cast}{given};")
            there = _flag_of_empty(segment, member, taken)
            if condition:
                w.fail_if(f"{condition} && !{flag}", "value")
                there = condition
        else:
            w.when(flag, f"{local} = {cast}{given};")
            default = segment.default
            if condition and segment.build is not None:
                with w.block(f"else if ({condition})"):
                    _work_out(w, segment, segment.build, local, source, is_text)
                with w.block("else"):
                    if default is not None:
                        _work_out(w, segment, default, local, source, is_text)
                    else:
                        w.add(";")
                there = condition if default is None else ""
            else:
                with w.block("else"):
                    _work_out(w, segment, chosen, local, source, is_text)
    if not is_text:
        _bound(w, segment, member, local, condition)
    entry = val_of(member, local)
    if not is_text and entry.kind == "number":
        entry = replace(entry, text=local)
    if not is_text and entry.kind == "number":
        limits = forms.value_range(segment)
        low = entry.low if limits.least is None else max(entry.low, min(limits.least, 0))
        high = entry.high if limits.most is None else min(entry.high, max(limits.most, 0))
        entry = replace(entry, low=min(low, entry.low), high=max(high, entry.high))
    taken.scope.entries[segment.name] = replace(entry, there=there, wire=_room_text(w, segment, taken, local))


def _room_text(w: WriteWriter, segment: Field, taken: Taken, local: str) -> str:
    """The bytes it takes, of what has no length of its own."""
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
    value: Val | None = None
    if segment.values is not None and isinstance(expression.root, Text):
        named = {name: one for one, name in segment.values.items()}
        if expression.root.value in named:
            value = constant(named[expression.root.value])
    if value is None:
        value = w.writer(taken.scope).value(expression)
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


def _bound(w: WriteWriter, segment: Number, member: CMember, local: str, condition: str) -> None:
    """A number outside what its type holds is refused, and nothing is worked out with it."""
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
    """The condition under which a number stands there, whose text may be empty; '' for others."""
    form = segment.type.form
    return f"{taken.path}{member.flag}" if form is not None and form.empty else ""


def _take_wide(w: WriteWriter, segment: Field, member: CMember, taken: Taken) -> None:
    """A number of 64 bits without a sign."""
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
    """What must hold for a value that was given or built."""
    member = _member(taken, segment.name)
    entry = taken.scope.entries[segment.name]
    local = entry.text
    condition = w.condition(segment, taken)
    there = both(condition)
    if segment.when is not None and member.has:
        flag = f"{taken.path}{member.flag}"
        if segment.default is not None and member.kind in ("number", "bytes"):
            value = w.writer(taken.scope).value(segment.default) if not isinstance(segment.default.root, Text) else None
            if value is None:
                value = _default_of(w, segment, segment.default, taken)
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
        limits = forms.value_range(segment)
        tests_ = [] if limits.least is None or limits.least <= LEAST else [f"{local} < {number(limits.least)}"]
        tests_ += [] if limits.most is None or limits.most >= MOST else [f"{local} > {number(limits.most)}"]
        if tests_:
            w.fail_if(f"{there}({' || '.join(tests_)})", "range")
        if segment.unit is not None and segment.unit != 1:
            w.fail_if(f"{there}{local} % {number(segment.unit)} != 0", "value")
    elif member.places and segment.limits is not None:
        low, high = (one * 10**member.places for one in segment.limits)
        w.fail_if(f"{there}({local} < {number(low)} || {local} > {number(high)})", "range")


def _constant(one: int | str | bytes) -> Val:
    return constant(one.encode("latin-1", "replace") if isinstance(one, str) else one)


def _default_of(w: WriteWriter, segment: Field, default: Expression, taken: Taken) -> Val:
    if segment.values is not None and isinstance(default.root, Text):
        named = {name: one for one, name in segment.values.items()}
        if default.root.value in named:
            return constant(named[default.root.value])
    return w.writer(taken.scope).value(default)


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


def _told_size(w: WriteWriter, segment: Field | Data, name: str, size: Expression, taken: Taken) -> None:
    """A value must be as long as others say; one that is filled up may be shorter."""
    local = taken.scope.entries[name].text
    if isinstance(segment, Data):
        filled = segment.pad is not None
    else:
        filled = segment.type.pad is not None or segment.type.end is not None
    w.fail_unless_told(segment, size, taken, f"(int64_t){local}.size {'>' if filled else '!='}")


# ---- other values -------------------------------------------------------------------------------------------


def _data(w: WriteWriter, segment: Data, taken: Taken) -> list[Task]:
    tasks = [Task((segment.name,), w.waits(segment.when), lambda _: _take_data(w, segment, taken))]
    size = segment.size
    if isinstance(size, Expression) and not w.size_by_length(segment):
        waits = {segment.name} | w.waits(size, segment.when)
        tasks.append(Task((), waits, lambda _: _told_size(w, segment, segment.name, size, taken)))
    return tasks


def _take_data(w: WriteWriter, segment: Data, taken: Taken) -> None:
    member = _member(taken, segment.name)
    local = w.local("struct framekit_bytes", f"{segment.name}_value", "{ NULL, 0 }")
    given = f"{taken.path}{member.cname}"
    there = ""
    if segment.when is not None:
        condition = w.holds(segment.when, taken)
        view = w.file.helper("view")
        w.add(f"{local} = {condition} ? {given} : {view}(NULL, 0);")
        flag = f"{taken.path}{member.flag}"
        w.fail_if(f"!{condition} && {flag}", "value")
        if segment.pad is None:
            w.fail_if(f"{condition} && !{flag}", "value")
        there = condition
    else:
        w.add(f"{local} = {given};")
    guard = both(there)
    if isinstance(segment.size, int):
        w.fail_if(f"{guard}{local}.size {'>' if segment.pad is not None else '!='} {segment.size}", "length")
    if segment.least and not (isinstance(segment.size, int) and segment.pad is None):
        w.fail_if(f"{guard}{local}.size < {segment.least}", "length")
    if segment.never:
        holds = w.file.helper("holds_byte")
        w.fail_if(f"{holds}({local}, {string(segment.never)}, {len(segment.never)})", "value")
    if segment.convert == "ascii_to_hex":
        w.fail_if(f"{local}.size % 2 != 0", "digits")
    if segment.pad is not None and segment.name in w.asked_by_name | w.tracked:
        raise CannotSayError(segment.at, "data that are filled up, of which something else depends")
    taken.scope.entries[segment.name] = Val("bytes", local, there=there, is_text=False)


def _bits(w: WriteWriter, segment: Bits, taken: Taken) -> list[Task]:
    return [_part(w, part, segment.when, taken) for part in segment.parts]


def _part(w: WriteWriter, part: BitsPart, when: Expression | None, taken: Taken) -> Task:
    worked_out = part.is_ or part.build
    asked = part.name in w.asked_by_name or worked_out is not None

    def write(missing: set[str]) -> None:
        member = _member(taken, part.name)
        local = w.local("int64_t", f"{part.name}_value")
        source = w.with_missing(taken)
        condition = w.holds(when, taken) if when is not None and asked else ""
        flag = w.given_flag(member, taken)
        given = f"(int64_t){taken.path}{member.cname}"
        if part.constants is not None and len(part.constants) == 1:
            w.add(f"{local} = {number(part.constants[0])};")
        elif part.is_ is not None:
            value = w.number(part.is_, source.scope)
            w.keep(local, f"{condition} ? {value.text} : 0" if condition else value.text)
        elif part.build is not None and not w.can_say(part.build, source, part.name):
            w.add(f"{local} = {given};")
            w.fail_if(f"{condition} && !{flag}" if condition else f"!{flag}", "value")
        elif part.build is not None:
            value = w.number(part.build, source.scope)
            text = f"{condition} ? {value.text} : 0" if condition else value.text
            w.when(flag, f"{local} = {given};")
            with w.block("else"):
                w.keep(local, text)
        else:
            first = 0 if part.constants is None else part.constants[0]
            w.add(f"{local} = {given};" if flag == "true" else f"{local} = {flag} ? {given} : {number(first)};")
            if part.constants is not None:
                tests = " && ".join(f"{local} != {number(one)}" for one in part.constants)
                w.fail_if(f"{condition} && {tests}" if condition else tests, "value")
        most = (1 << part.high - part.low + 1) - 1
        with w.block(f"if ({local} < 0 || {local} > {number(most)})"):
            w.fail("range")
            w.add(f"{local} = 0;")
        if when is not None:
            own = condition or w.holds(when, taken)
            w.fail_if(f"!{own} && {taken.path}{member.flag}", "value")
        taken.scope.entries[part.name] = Val("number", local, 0, most, there=condition)

    waits = w.waits(worked_out, when)
    return Task((part.name,), waits, write, part.is_ is None)


def _length(w: WriteWriter, segment: Length, taken: Taken) -> list[Task]:
    def write(missing: set[str]) -> None:
        member = _member(taken, segment.name)
        local = w.local("int64_t", f"{segment.name}_value")
        text = _room_of(w, segment, taken)
        if segment.unit != 1:
            text = f"({text}) / {segment.unit}"
        if segment.plus:
            text = f"{text} + {number(segment.plus)}"
        w.add(f"{local} = {text};")
        _number_told(w, segment, member, local, taken)

    waits = w.waits(segment.when) | {name for name in segment.of if w.is_simple(name)}
    return [Task((segment.name,), waits, write)]


def _number_told(w: WriteWriter, segment: Length | Count, member: CMember, local: str, taken: Taken) -> None:
    condition = w.condition(segment, taken)
    there = both(condition)
    limits = forms.value_range(segment)
    tests = [f"{local} < {number(max(limits.least or 0, LEAST))}"] if limits.least is not None else []
    tests += [f"{local} > {number(limits.most)}"] if limits.most is not None and limits.most <= MOST else []
    if tests:
        with w.block(f"if ({there}({' || '.join(tests)}))"):
            w.fail("range")
    w.when(
        f"{local} < {number(member.low)} || {local} > {number(min(member.high, MOST))}",
        f"{local} = {number(max(member.low, 0))};",
    )
    if segment.when is not None and member.has:
        w.fail_if(f"!{condition} && {taken.path}{member.flag}", "value")
    taken.scope.entries[segment.name] = Val("number", local, member.low, min(member.high, MOST), there=condition)


def _room_of(w: WriteWriter, length: Length, taken: Taken) -> str:
    """Text of the bytes that a length counts: worked out at once, or when they have been put together."""
    texts = []
    for name in length.of:
        text = w.simple_room(name, taken, length.plain)
        if text is None:
            break
        texts.append(text)
    else:
        return " + ".join(texts) or "0"
    if length.plain:
        raise CannotSayError(length.at, "a length before conversion of what is put together in several ways")
    if w.in_list:
        raise CannotSayError(length.at, "a length in items of a list, of what is put together in several ways")
    room = w.file.helper("room")
    spans = [w.span(name) for name in wire_names(w.segments, length.of)]
    local = w.local("int64_t", f"{length.name}_room")
    w.lengths.append((local, lambda: " + ".join(f"{room}(&{one})" for one in spans if one is not None) or "0"))
    return local


def _count(w: WriteWriter, segment: Count, taken: Taken) -> list[Task]:
    def write(missing: set[str]) -> None:
        member, counted = _member(taken, segment.name), taken.struct.members.get(segment.of)
        if counted is None:
            raise CannotSayError(segment.at, "a count of a list that stands elsewhere")
        local = w.local("int64_t", f"{segment.name}_value")
        text = f"(int64_t){taken.path}{counted.cname}.count"
        if counted.has:
            text = f"({taken.path}{counted.flag} ? {text} : 0)"
        w.add(f"{local} = {text}{f' + {number(segment.plus)}' if segment.plus else ''};")
        _number_told(w, segment, member, local, taken)

    return [Task((segment.name,), w.waits(segment.when), write)]


def _value(w: WriteWriter, segment: Value, taken: Taken) -> list[Task]:
    def write(missing: set[str]) -> None:
        member = _member(taken, segment.name)
        is_text = member.kind == "bytes"
        local = w.local("struct framekit_bytes" if is_text else "int64_t", f"{segment.name}_value",
                        "{ NULL, 0 }" if is_text else "0")  # fmt: skip
        condition = w.condition(segment, taken)
        source = w.with_missing(taken)
        there = w.local("bool", f"{segment.name}_there", "false")
        flag = f"{taken.path}{member.flag}"
        w.when(flag, f"{local} = {'' if is_text else '(int64_t)'}{taken.path}{member.cname};", f"{there} = true;")
        with w.block(f"else if ({condition})" if condition else "else"):
            if segment.build is not None and not w.can_say(segment.build, source, segment.name):
                w.fail("value")
                value = Val("none")
            else:
                value = w.writer(source.scope).value(segment.build or segment.read)
            if value.kind == "none":
                w.add(f"{there} = false;")
            else:
                if value.kind != ("bytes" if is_text else "number"):
                    raise CannotSayError(segment.at, f"the value '{segment.name}' is built as another kind")
                text = _folded(w, value, segment) if is_text else value.text
                if value.there:
                    nothing = f"{w.file.helper('view')}(NULL, 0)" if is_text else "0"
                    text = f"({value.there} ? {text} : {nothing})"
                w.keep(local, text)
                w.add(f"{there} = {value.there or 'true'};")
        if condition:
            with w.block("else"):
                w.add(f"{there} = false;")
            w.fail_if(f"!{condition} && {flag}", "value")
        if not is_text:
            _bound_value(w, member, local)
        entry = val_of(member, local)
        certain = segment.when is None
        taken.scope.entries[segment.name] = replace(entry, text=local, there="" if certain else there)

    def agree(missing: set[str]) -> None:
        entry = taken.scope.entries[segment.name]
        member = _member(taken, segment.name)
        value = w.writer(taken.scope).value(segment.read)
        condition = both(w.condition(segment, taken))
        if value.kind == "none":
            return
        text = _differs_kept(w, member, entry.text, value, segment)
        w.fail_if(f"{condition}{text}", "value")

    waits = w.waits(segment.build or segment.read, segment.when)
    tasks = [Task((segment.name,), waits, write, True)]
    tasks[0].prefer = segment.build is None
    return [*tasks, Task((), w.waits(segment.read) | {segment.name}, agree)]


def _folded(w: WriteWriter, value: Val, segment: Segment) -> str:
    """The text of a struct framekit_bytes; letters of one case are put into room of their own."""
    text = w.writer(CScope()).bytes(value)
    if not value.fold:
        return text
    if value.most_size is None or value.most_size > 64:
        raise CannotSayError(segment.at, "letters of one case of a text of any size")
    room = w.fresh("folded")
    w.locals.append(f"uint8_t {room}[{value.most_size or 1}];")
    upper = "true" if value.fold == "upper" else "false"
    return f"{w.file.helper('folded')}({text}, {upper}, {room}, sizeof {room}, &bad)"


def _bound_value(w: WriteWriter, member: CMember, local: str) -> None:
    with w.block(f"if ({local} < {number(member.low)} || {local} > {number(min(member.high, MOST))})"):
        w.fail("value")
        w.add(f"{local} = {number(min(max(0, member.low), member.high))};")


def _differs_kept(w: WriteWriter, member: CMember, local: str, value: Val, segment: Segment) -> str:
    """The condition that a value is another; it is worked out here, as it may fail."""
    if member.kind == "bytes":
        text = f"!{w.file.helper('same_bytes')}({local}, {_folded(w, value, segment)})"
    else:
        text = f"{local} != {value.text}"
    if value.there:
        text = f"{value.there} && {text}"
    kept = w.local("bool", "differs", "false")
    w.keep(kept, text)
    return kept


def _require(w: WriteWriter, segment: Require, taken: Taken) -> list[Task]:
    def write(missing: set[str]) -> None:
        guard = w.condition(segment, taken)
        if guard:
            with w.block(f"if ({guard})"):
                w.fail_if(f"!{w.holds(segment.condition, taken)}", "require")
        else:
            w.fail_if(f"!{w.holds(segment.condition, taken)}", "require")

    return [Task((), w.waits(segment.condition, segment.when), write)]


def _item_end(w: WriteWriter, segment: ItemEnd, taken: Taken) -> list[Task]:
    if segment.until is None:
        return []
    until = segment.until

    def write(missing: set[str]) -> None:
        last = taken.scope.find(LAST)
        assert last is not None
        w.fail_if(f"{w.holds(until, taken)} != ({last.text} != 0)", "value")

    return [Task((), w.waits(until), write)]


# ---- values inside others -----------------------------------------------------------------------------------


def _choose(w: WriteWriter, segment: Choose | Optional, taken: Taken) -> list[Task]:
    inside = tuple(flat((segment,)))
    names = [name for one in inside for name in one.value_names]
    names += [one.name for one in inside if one.name]
    outer = w.outer_names(segment)
    return [Task(tuple(dict.fromkeys(names)), outer, lambda _: _branches(w, segment, taken))]


def _branches(w: WriteWriter, segment: Choose | Optional, taken: Taken) -> None:
    case = w.local("int", "case_taken", "-1")
    w.chosen[id(segment)] = case
    w.add(f"{case} = -1;")
    first_line = len(w.out.lines)
    guard = w.condition(segment, taken)
    outside: dict[str, tuple[str, str, Val]] = {}
    names = {name for one in flat((segment,)) for name in one.value_names}
    if isinstance(segment, Choose):
        value = w.writer(taken.scope).value(segment.on)
        tests = case_tests(w, segment, value, (taken.scope, taken.struct, taken.path))
        rows: list[tuple[str, Segments]] = list(tests)
        if segment.otherwise is not None:
            rows.append(("", segment.otherwise))
    else:
        flags = []
        for one in flat(segment.of):
            for name in one.given_names:
                member = taken.struct.members.get(name)
                if member is not None and member.has:
                    flags.append(f"{taken.path}{member.flag}")
        rows = [(" || ".join(flags) or "true", segment.of)]
    first = True
    with w.block(f"if ({guard})" if guard else ""):
        for place, (test, segments) in enumerate(rows):
            word = "" if first else "else "
            header = f"{word}if ({test})" if test else word.strip()
            first = False
            with w.block(header):
                w.add(f"{case} = {place};")
                inner = Taken(CScope(taken.scope), taken.struct, taken.path)
                w.scopes[id(segments)] = inner
                w.values(segments, inner)
                w.refuse_given((segment,), taken, segments)
                for name in names & inner.scope.entries.keys() & (w.asked_by_name | {*w.by_name}):
                    _hand_out(w, name, inner.scope.entries[name], outside, taken)
        if isinstance(segment, Choose) and segment.otherwise is None:
            with w.block("else"):
                w.fail("value")
        elif isinstance(segment, Optional):
            with w.block("else"):
                w.refuse_given((segment,), taken)
                w.add(";")
    if guard:
        with w.block("else"):
            w.refuse_given((segment,), taken)
            w.add(";")
    for name, (local, there, value) in outside.items():
        taken.scope.entries[name] = replace(value, text=local, there=there)
        w.out.lines.insert(first_line, f"{INDENT * w.out.depth}{there} = false;")


def _hand_out(w: WriteWriter, name: str, value: Val, outside: dict[str, tuple[str, str, Val]], taken: Taken) -> None:
    """What expressions outside a case may read of it."""
    if value.kind not in ("number", "bytes"):
        if name in w.asked_by_name and value.kind == "record":
            raise CannotSayError(w.by_name[name].at, f"the record '{name}' of a case, which is read outside it")
        return
    if name not in outside:
        type_ = "int64_t" if value.kind == "number" else "struct framekit_bytes"
        local = w.local(type_, f"{name}_out", "0" if value.kind == "number" else "{ NULL, 0 }")
        outside[name] = local, w.local("bool", f"{name}_is_out", "false"), value
    local, there, known = outside[name]
    if known.kind != value.kind:
        raise CannotSayError(w.by_name[name].at, f"'{name}' is of another kind in another case")
    low, high = min(known.low, value.low), max(known.high, value.high)
    outside[name] = local, there, replace(known, low=low, high=high)
    w.add(f"{local} = {value.text};", f"{there} = {value.there or 'true'};")


def _record(w: WriteWriter, segment: Record, taken: Taken) -> list[Task]:
    member = _member(taken, segment.name)
    assert member.inside is not None
    inside_struct = member.inside

    def write(missing: set[str]) -> None:
        inner = Taken(CScope(taken.scope), inside_struct, f"{taken.path}{member.cname}.")
        w.scopes[id(segment.of)] = inner
        condition = w.condition(segment, taken)
        if condition:
            w.fail_if(f"!{condition} && {taken.path}{member.flag}", "value")
            if segment.wanted_names:
                w.fail_if(f"{condition} && !{taken.path}{member.flag}", "value")
            with w.block(f"if ({condition})"):
                w.values(segment.of, inner)
        else:
            w.values(segment.of, inner)
        taken.scope.entries[segment.name] = Val("record", "", there=condition, inside=inner.scope, wire="true")

    names = (segment.name, *(one.name for one in flat(segment.of) if one.name))
    return [Task(names, w.outer_names(segment), write)]


def _repeat(w: WriteWriter, segment: Repeat, taken: Taken) -> list[Task]:
    member = _member(taken, segment.name)
    path = f"{taken.path}{member.cname}"

    def write(missing: set[str]) -> None:
        condition = w.condition(segment, taken)
        if condition:
            w.fail_if(f"{condition} != {taken.path}{member.flag}", "value")
        guard = both(condition)
        w.fail_if(f"{guard}{path}.count > {member.capacity}", "no_room")
        if isinstance(segment.times, int):
            w.fail_if(f"{guard}{path}.count != {segment.times}", "length")
        if segment.until is not None:
            w.fail_if(f"{guard}{path}.count == 0", "length")
        taken.scope.entries[segment.name] = Val("list", path, there=condition, wire=f"{path}.count")

    def compare(missing: set[str]) -> None:
        assert isinstance(segment.times, Expression)
        w.fail_unless_told(segment, segment.times, taken, f"(int64_t){path}.count !=", "times_told")

    tasks = [Task((segment.name,), w.waits(segment.when), write)]
    if isinstance(segment.times, Expression):
        tasks.append(Task((), w.waits(segment.times, segment.when) | {segment.name}, compare))
    return tasks


def _inner(w: WriteWriter, segment: Inner, taken: Taken) -> list[Task]:
    member = _member(taken, segment.name)
    span = w.span(segment.name)
    wire = ""
    if span is not None:
        local = w.local("int64_t", f"{segment.name}_room")
        room = w.file.helper("room")
        w.lengths.append((local, lambda: f"{room}(&{span})"))
        wire = local

    def write(missing: set[str]) -> None:
        if segment.when is not None:
            condition = w.holds(segment.when, taken)
            w.fail_if(f"{condition} != {taken.path}{member.flag}", "value")
        taken.scope.entries[segment.name] = Val("other", "", wire=wire)

    return [Task((segment.name,), w.waits(segment.when), write)]


def _wrap(w: WriteWriter, segment: Wrap, taken: Taken) -> list[Task]:
    tasks: list[Task] = []
    for one in segment.of:
        tasks += w.tasks_of(one, taken)
    return tasks


def _no_bytes(w: WriteWriter, segment: Segment, taken: Taken) -> None:
    """What takes no bytes."""


# ---- bytes --------------------------------------------------------------------------------------------------


def _put_const(w: WriteWriter, segment: Const, taken: Taken) -> None:
    w.add(f"{w.file.helper('put_bytes')}({w.n}, {string(segment.data)}, {len(segment.data)});")


def _put_skip(w: WriteWriter, segment: Skip, taken: Taken) -> None:
    helper = w.file.helper("put_fill")
    w.add(f"{helper}({w.n}, {string(segment.fill)}, {len(segment.fill)}, {segment.size});")


def _put_fill(w: WriteWriter, segment: Fill, taken: Taken) -> None:
    behind = 0
    order = list(w.segments)
    for one in order[order.index(segment) + 1 :]:
        size = w.static.present(one).fixed or 0
        if one.when is not None and size:
            raise CannotSayError(one.at, "what fills a frame up, before a part that may be absent")
        behind += size
    room = f"{segment.total - behind} - (int64_t){w.inn}.at"
    w.fail_if(f"{room} < 0", "too_long")
    helper = w.file.helper("put_fill")
    w.add(f"{helper}({w.n}, {string(bytes((segment.byte,)))}, 1, {room} < 0 ? 0 : {room});")


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
    """What ends a text, or that one of several ends has to follow it."""
    end = segment.type.end
    if end is not None:
        w.add(f"{w.file.helper('put_bytes')}({w.n}, {string(end)}, {len(end)});")
        return
    w.open_text(segment)
    if w.inn != "out":
        raise CannotSayError(segment.at, "a text in a wrap that ends before one of several bytes")


def _put_decimal(w: WriteWriter, type_: FieldType, value: str, size: str, segment: Segment) -> None:
    """A number as decimal text. `value`: the number and its places, as arguments."""
    w.add(f"{w.file.helper('put_decimal')}({w.n}, {value}, {w.decimal_form(type_, size)});")


def _put_field(w: WriteWriter, segment: Field, taken: Taken) -> None:
    type_ = segment.type
    local = taken.scope.entries[segment.name].text
    if type_.kind in ("ascii", "bytes"):
        _put_text(w, segment, taken)
    elif type_.kind == "fraction":
        entry = taken.scope.entries[segment.name]
        size = w.size_of(type_.size, taken)
        member = _member(taken, segment.name)
        value = f"{local}.number, {local}.places" if member.kind == "decimal" else f"{local}, {member.places}"
        with w.block(f"if ({entry.there})" if entry.there and type_.form is not None and type_.form.empty else ""):
            _put_decimal(w, type_, value, size, segment)
        if type_.is_delimited:
            _put_end(w, segment)
    elif type_.is_delimited:
        if type_.kind == "scaled":
            _put_scaled(w, type_, local, segment)
        else:
            _put_number(w, type_, _wire(segment, local), "0", segment)
        _put_end(w, segment)
    elif type_.kind == "float":
        bits = f"{w.file.helper('float_bits' if type_.fixed_size == 4 else 'double_bits')}({local})"
        _put_number(w, replace(type_, kind="int"), f"(uint64_t){bits}", str(type_.fixed_size), segment)
    elif segment.long is not None:
        short, longer = segment.type.fixed_size or 1, segment.long.type.fixed_size or 0
        wire = _wire(segment, local)
        with w.block(f"if ({wire} < {number(segment.long.mark)})"):
            _put_number(w, segment.type, wire, str(short), segment)
        with w.block("else"):
            _put_number(w, segment.type, number(segment.long.mark), str(short), segment)
            _put_number(w, segment.long.type, wire, str(longer), segment)
    elif type_.kind == "scaled":
        assert type_.inside is not None and type_.scale is not None
        _put_scaled(w, type_, local, segment)
    elif type_.size is None:
        raise CannotSayError(segment.at, f"'{segment.name}' is a number that its end shows")
    else:
        size = w.size_of(type_.size, taken)
        if isinstance(type_.size, Expression):
            _fits(w, type_, local, size)
        _put_number(w, type_, _wire(segment, local), size, segment)


def _put_scaled(w: WriteWriter, type_: FieldType, local: str, segment: Segment) -> None:
    """The number on the wire, of which the value is so many times and more."""
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
    _put_number(w, inside, wire, str(inside.fixed_size or 0), segment)


def _fits(w: WriteWriter, type_: FieldType, local: str, size: str) -> None:
    """A number must fit into as many bytes or digits as others tell."""
    signed = "true" if type_.signed else "false"
    base = {"int": 256, "digits": type_.base, "bcd": 100}.get(type_.kind, 256)
    w.fail_if(f"!{w.file.helper('fits')}({local}, {size}, {base}, {signed})", "range")


def _wire(segment: Number, local: str) -> str:
    """The text of the number on the wire from that of the value."""
    text = local
    if isinstance(segment, Field):
        if segment.unit is not None and segment.unit != 1:
            text = f"{text} / {number(segment.unit)}"
        if segment.plus:
            text = f"{text} + {number(segment.plus)}"
    if segment.zero_means is not None:
        text = f"({local} == {number(segment.zero_means)} ? 0 : {text})"
    return f"({text})" if text != local else text


def _put_number(w: WriteWriter, type_: FieldType, wire: str, size: str, segment: Segment) -> None:
    if type_.kind == "decimal":
        _put_decimal(w, type_, f"{wire}, 0", size, segment)
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


def _put_data(w: WriteWriter, segment: Data, taken: Taken) -> None:
    local = taken.scope.entries[segment.name].text
    if segment.swap:
        _put_swapped(w, segment, local)
    else:
        names = {"hex_to_ascii": "put_hex_bytes", "ascii_to_hex": "put_unhex_bytes", None: "put_bytes"}
        w.add(f"{w.file.helper(names[segment.convert])}({w.n}, {local}.data, {local}.size);")
    if segment.pad is not None and segment.size != "rest":
        left = f"{w.size_of(segment.size, taken)} - (int64_t){local}.size"
        if segment.convert is not None or segment.swap:
            raise CannotSayError(segment.at, "data that are filled up and converted")
        w.when(f"{left} > 0", f"{w.file.helper('put_fill')}({w.n}, {string(bytes((segment.pad,)))}, 1, {left});")


def _put_swapped(w: WriteWriter, segment: Data, local: str) -> None:
    """The bytes of each unit turned round; what fills no unit stays."""
    place = w.local("size_t", "unit_place")
    with w.block(f"for ({place} = 0; {place} < {local}.size; {place}++)"):
        unit, at = segment.swap, w.local("size_t", "turned_place")
        inside = f"{local}.size / {unit} * {unit}"
        turned = f"{place} / {unit} * {unit} + {unit - 1} - {place} % {unit}"
        w.add(f"{at} = {place} < {inside} ? {turned} : {place};")
        names = {"hex_to_ascii": "put_hex_bytes", None: "put_bytes"}
        if segment.convert == "ascii_to_hex":
            raise CannotSayError(segment.at, "digits that are swapped")
        w.add(f"{w.file.helper(names[segment.convert])}({w.n}, {local}.data + {at}, 1);")


def _put_bits(w: WriteWriter, segment: Bits, taken: Taken) -> None:
    parts = []
    for part in segment.parts:
        text = f"(uint64_t){taken.scope.entries[part.name].text}"
        parts.append(f"{text} << {part.low}" if part.low else text)
    text = w.size_of(segment.type.size, taken)
    _put_number(w, replace(segment.type, signed=False), f"({' | '.join(parts) or '0'})", text, segment)


def _put_counted(w: WriteWriter, segment: Length | Count, taken: Taken) -> None:
    type_ = segment.type
    local = taken.scope.entries[segment.name].text
    size = w.size_of(type_.size, taken)
    if isinstance(type_.size, Expression):
        _fits(w, type_, local, size)
    _put_number(w, type_, _wire(segment, local), size, segment)


def _put_check(w: WriteWriter, segment: Check, taken: Taken) -> None:
    to, start = w.local("uint8_t *", "code_to", "NULL"), w.local("size_t", "check_start")
    w.add(f"{start} = {w.inn}.at;", f"{to} = {w.file.helper('put')}({w.n}, {segment.size});")

    def write() -> None:
        code = w.local("uint64_t", "code")
        with w.block(f"if ({to} != NULL)"):
            fails = work_out(w, segment, taken.scope, code, start)
            if fails:
                w.fail_if("bad", "value")
            put_code(w, segment, code, to)

    if segment.name in w.late_names:
        if w.in_wrap or w.in_list or segment.when is not None:
            raise CannotSayError(segment.at, "a check code in a part, before what it covers")
        w.late.append((segment, write))
    else:
        write()


def _put_choose(w: WriteWriter, segment: Choose | Optional, taken: Taken) -> None:
    case = w.chosen[id(segment)]
    for one in standing_any_way((segment,)):  # of a case that is not taken nothing is there
        span = w.span(one.name)
        if span is not None:
            w.add(f"{span}.data = {w.inn}.data;", f"{span}.first = {span}.last = {w.inn}.at;", f"{span}.there = true;")
    for place, segments in enumerate(segment.blocks):
        inner = w.scopes.get(id(segments))
        if inner is None:
            continue
        with w.block(f"if ({case} == {place})"):
            w.bytes(segments, inner)


def _put_record(w: WriteWriter, segment: Record, taken: Taken) -> None:
    w.bytes(segment.of, w.scopes[id(segment.of)])


def _put_repeat(w: WriteWriter, segment: Repeat, taken: Taken) -> None:
    member = _member(taken, segment.name)
    path = f"{taken.path}{member.cname}"
    index = w.local("size_t", "index")
    limit = f"{path}.count && {index} < {member.capacity}"
    header = f"for ({index} = 0; {index} < {limit}; {index}++)"
    if isinstance(segment.of, FieldType):
        assert member.item is not None
        _put_values(w, segment, segment.of, member.item, f"{path}.items[{index}]", header)
        return
    assert member.inside is not None
    scope = CScope(taken.scope)
    inner = Taken(scope, member.inside, f"{path}.items[{index}].")
    scope.entries[INDEX] = Val("number", f"(int64_t){index}", 0, member.capacity)
    scope.entries[LAST] = Val("number", f"(int64_t)({index} + 1 == {path}.count)", 0, 1, is_flag=True)
    asked = {node.name for e in expressions_of(segment.of) for node in walk(e.root) if isinstance(node, Attribute)
             and isinstance(node.value, Name) and node.value.name == PREVIOUS}  # fmt: skip
    previous = CScope()
    before = {name: w.local("int64_t", f"previous_{name}") for name in sorted(asked)}
    for name, local in before.items():
        one = member.inside.members.get(name)
        if one is None or one.kind != "number" or one.has or one.high > MOST or one.places:
            raise CannotSayError(segment.at, f"'{name}' of the item before")
        previous.entries[name] = Val("number", local, one.low, one.high)
    scope.entries[PREVIOUS] = Val("record", "", there=f"{index} > 0", inside=previous)
    start, begun = w.local("size_t", "list_start"), w.local("size_t", "item_start")
    w.add(f"{start} = {w.inn}.at;")
    outside, w.in_list = w.in_list, True
    fill = string(bytes((segment.fill,)))
    pad = f"(int64_t)(({segment.align} - ({w.inn}.at - {start}) % {segment.align}) % {segment.align})"
    with w.block(header):
        if segment.align > 1 and segment.between:
            w.add(f"{w.file.helper('put_fill')}({w.n}, {fill}, 1, {pad});")
        w.add(f"{begun} = {w.inn}.at;")
        w.values(segment.of, inner)
        w.bytes(segment.of, inner)
        if not isinstance(segment.times, int) and w.static.all(segment.of).least == 0:
            w.fail_if(f"{w.inn}.at == {begun}", "length")
        if segment.align > 1 and not segment.between:
            w.add(f"{w.file.helper('put_fill')}({w.n}, {fill}, 1, {pad});")
        for name, local in before.items():
            w.add(f"{local} = {scope.entries[name].text};")
    w.in_list = outside


def _put_values(w: WriteWriter, segment: Repeat, of: FieldType, member: CMember, item: str, header: str) -> None:
    with w.block(header):
        if of.kind == "float":
            bits = f"{w.file.helper('float_bits' if of.fixed_size == 4 else 'double_bits')}({item})"
            _put_number(w, replace(of, kind="int"), f"(uint64_t){bits}", str(of.fixed_size), segment)
            return
        if of.kind == "fraction":
            _put_decimal(w, of, f"(int64_t){item}, {member.places}", str(of.fixed_size), segment)
            return
        if member.high > MOST:
            _put_number(w, of, item, str(of.fixed_size), segment)
            return
        value = w.local("int64_t", "item_value")
        w.add(f"{value} = (int64_t){item};")
        if of.kind == "scaled":
            _put_scaled(w, of, value, segment)
            return
        tests = f"{value} < {number(member.low)} || {value} > {number(member.high)}"
        with w.block(f"if ({tests})"):
            w.fail("range")
            w.add(f"{value} = 0;")
        _put_number(w, of, value, str(of.fixed_size), segment)


def _put_inner(w: WriteWriter, segment: Inner, taken: Taken) -> None:
    member = _member(taken, segment.name)
    path = f"{taken.path}{member.cname}"
    begin = w.local("size_t", "inner_begin")
    upper = w.file.prefix.upper()
    inside = w.fresh("inside")
    w.locals.append(f"struct fk_out {inside};")
    w.add(f"{begin} = {w.inn}.at;")
    w.add(f"{inside} = {w.inn};", f"{inside}.data += {begin};", f"{inside}.room -= {begin};", f"{inside}.at = 0;")
    with w.block(f"switch ((int){path}.frame)"):
        for frame in member.frames:
            name = identifier(frame)
            w.add(f"case {upper}_FRAME_{name}:")
            w.add(f"    {w.file.prefix}_fk_write_{name}(&{path}.of.{inner_name(frame)}{w.file.hand_on}, &{inside});")
            w.add("    break;")
        w.add(f"case {upper}_FRAME_UNKNOWN:")
        unknown = f"{path}.of.unknown"
        w.add(f"    {w.file.helper('put_bytes')}(&{inside}, {unknown}.data, {unknown}.size);", "    break;")
        w.add("default:", f"    {w.file.helper('fail')}(&{inside}, FRAMEKIT_VALUE);", "    break;")
    w.add(f"{w.inn}.at = {begin} + {inside}.at;")
    w.when(f"{inside}.reason != FRAMEKIT_OK", f"{w.file.helper('fail')}({w.n}, {inside}.reason);")
    if isinstance(segment.size, Expression):
        if not w.size_by_length(segment):
            w.fail_unless_told(None, segment.size, taken, f"(int64_t){inside}.at !=")
    elif isinstance(segment.size, int):
        w.fail_if(f"{inside}.at != {segment.size}", "length")


def _put_wrap(w: WriteWriter, segment: Wrap, taken: Taken) -> None:
    begin = w.local("size_t", "wrap_begin")
    w.add(f"{begin} = {w.inn}.at;")
    if isinstance(segment.coding, Plain):
        plain = w.local("size_t", "plain_begin")
        inside = w.fresh("region")
        w.locals.append(f"struct fk_out {inside};")
        w.add(f"{plain} = {w.inn}.at;")
        w.add(f"{inside} = {w.inn};", f"{inside}.data += {plain};", f"{inside}.room -= {plain};", f"{inside}.at = 0;")
    else:
        content = w.static.all(segment.of).most
        size = max(w.struct_most(), content or 0)
        inside, buffer = w.fresh("content"), w.fresh("plain")
        w.locals += [f"struct fk_out {inside};", f"uint8_t {buffer}[{max(size, 1)}];"]
        w.add(f"{inside}.data = {buffer};", f"{inside}.room = sizeof {buffer};", f"{inside}.at = 0;")
        w.add(f"{inside}.reason = {w.inn}.reason;")
    outside, w.inn = w.inn, inside
    in_wrap, w.in_wrap = w.in_wrap, True
    w.bytes(segment.of, taken)
    w.inn, w.in_wrap = outside, in_wrap
    w.add(f"{w.inn}.reason = {inside}.reason;")
    if segment.least:
        w.fail_if(f"{inside}.at < {segment.least}", "length")
    if segment.most is not None:
        w.fail_if(f"(int64_t){inside}.at > {w.size_of(segment.most, taken, 'most_told')}", "length")
    if isinstance(segment.coding, Plain):
        w.add(f"{w.inn}.at += {inside}.at;")
    else:
        wrap_up(w, segment, inside)
    if segment.size is not None and not w.size_by_length(segment):
        if isinstance(segment.size, Expression):
            w.fail_unless_told(None, segment.size, taken, f"(int64_t)({w.inn}.at - {begin}) !=")
        else:
            w.fail_if(f"{w.inn}.at - {begin} != {segment.size}", "length")


VALUES.update(
    {
        Const: _nothing, Skip: _nothing, Fill: _nothing, Check: _nothing, Field: _field, Data: _data, Bits: _bits,
        Length: _length, Count: _count, Value: _value, Require: _require, ItemEnd: _item_end, Choose: _choose,
        Optional: _choose, Record: _record, Repeat: _repeat, Inner: _inner, Wrap: _wrap,
    }
)  # fmt: skip
BYTES.update(
    {
        Const: _put_const, Skip: _put_skip, Fill: _put_fill, Check: _put_check, Field: _put_field, Data: _put_data,
        Bits: _put_bits, Length: _put_counted, Count: _put_counted, Choose: _put_choose, Optional: _put_choose,
        Record: _put_record, Repeat: _put_repeat, Inner: _put_inner, Wrap: _put_wrap, Value: _no_bytes,
        Require: _no_bytes, ItemEnd: _no_bytes,
    }
)  # fmt: skip
