"""Write `value` and `require` in C, which take no bytes."""

from __future__ import annotations

from dataclasses import replace

from framekit.codec.python.encode_plan import Task
from framekit.definition.model.segments import Require, Segment, Value
from framekit.definition.problems import CannotSayError
from framekit.extras.generate_c.expressions import MOST, CScope, Val
from framekit.extras.generate_c.functions import CKind
from framekit.extras.generate_c.layout import CMember, val_of
from framekit.extras.generate_c.measure import CMeasureWriter, Pairs
from framekit.extras.generate_c.reader import Behind, Here, ReadWriter
from framekit.extras.generate_c.source import number
from framekit.extras.generate_c.writer import Taken, WriteWriter, both

# ---- read -----------------------------------------------------------------------------------------------------


def _read(r: ReadWriter, segment: Value, here: Here, behind: Behind) -> None:
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
            r.stands(segment.path)
            r.stored(member, scope, segment.name, sure=False)
    else:
        r.add(f"{path}{member.flag} = true;")
        r.stands(segment.path)
        r.stored(member, scope, segment.name)


def _read_require(r: ReadWriter, segment: Require, here: Here, behind: Behind) -> None:
    r.begin()
    text = r.writer(here[0]).condition(segment.condition)
    if "&bad" in text:
        holds = r.local("bool", "holds", "false")
        r.add("bad = false;", f"{holds} = {text};")
        text = f"{holds} && !bad"
    r.when(f"!({text})", r.note("require", r.at, r.refuse(segment)))


# ---- built ----------------------------------------------------------------------------------------------------


def _values(w: WriteWriter, segment: Value, taken: Taken) -> list[Task]:
    def write(missing: set[str]) -> None:
        member = taken.member(segment.name)
        is_text = member.kind == "bytes"
        local = w.value_local(f"{segment.name}_value", is_text=is_text)
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
        member = taken.member(segment.name)
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
    """Return the text of a `struct framekit_bytes`; a text in one letter case gets a buffer of its own."""
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
    """Return the condition that a value differs; it is computed here, as the computation may fail."""
    if member.kind == "bytes":
        text = f"!{w.file.helper('same_bytes')}({local}, {_folded(w, value, segment)})"
    else:
        text = f"{local} != {value.text}"
    if value.there:
        text = f"{value.there} && {text}"
    kept = w.local("bool", "differs", "false")
    w.keep(kept, text)
    return kept


def _require_values(w: WriteWriter, segment: Require, taken: Taken) -> list[Task]:
    def write(missing: set[str]) -> None:
        with w.where(w.condition(segment, taken)):
            w.fail_if(f"!{w.holds(segment.condition, taken)}", "require")

    return [Task((), w.waits(segment.condition, segment.when), write)]


# ---- measured -------------------------------------------------------------------------------------------------


def _measure(m: CMeasureWriter, segment: Value, scope: CScope, after: Pairs) -> None:
    if segment.name not in m.needed:
        return
    value = m.writer(scope).value(segment.read)
    if value.kind == "bytes" and not value.fold:
        scope.entries[segment.name] = value
    elif value.kind == "number":
        m.set_number(segment.name, scope, value.text, value.low, value.high)
    else:
        raise CannotSayError(segment.at, f"the value '{segment.name}', of which sizes depend")


KINDS = (
    CKind(Value, read=_read, values=_values, measure=_measure),
    CKind(Require, read=_read_require, values=_require_values),
)
