"""Write `repeat`, records, and the end of an item in C."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from framekit.codec.python.encode_plan import Task
from framekit.codec.python.facts import may_be_empty
from framekit.codec.python.measure import Finished
from framekit.definition.expression import Attribute, Expression, Name, walk
from framekit.definition.model.frames import expressions_of
from framekit.definition.model.segments import (
    INDEX,
    LAST,
    PREVIOUS,
    Field,
    FieldType,
    ItemEnd,
    Record,
    Repeat,
    Segments,
)
from framekit.definition.problems import CannotSayError
from framekit.extras.generate_c.expressions import MOST, CScope, Val, constant
from framekit.extras.generate_c.functions import CKind
from framekit.extras.generate_c.kinds.numbers import (
    put_decimal,
    put_float,
    put_number,
    put_scaled,
    read_float,
    wire_type,
)
from framekit.extras.generate_c.layout import CMember, scope_of
from framekit.extras.generate_c.measure import LOST, CMeasureWriter, Pairs
from framekit.extras.generate_c.reader import Behind, Here, ReadWriter
from framekit.extras.generate_c.source import INDENT, number, string
from framekit.extras.generate_c.writer import Taken, WriteWriter, both

# ---- read -----------------------------------------------------------------------------------------------------


def _read_record(r: ReadWriter, segment: Record, here: Here, behind: Behind) -> None:
    scope, struct, path = here
    member = struct.members[segment.name]
    assert member.inside is not None
    start = r.local("size_t", "record_start")
    r.begin()
    r.add(f"{start} = {r.at};")
    if member.has:
        r.add(f"{path}{member.flag} = true;")
    r.mark(member, 1)
    known = r.known.get(id(member), "")
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
    r.stands_from(segment.path, start)


def _within(r: ReadWriter, known: str, write: Callable[[], None]) -> Callable[[], None]:
    def inside() -> None:
        with r.block(f"if ({known} == 1)" if known else ""):
            write()

    return inside


def _read(r: ReadWriter, segment: Repeat, here: Here, behind: Behind) -> None:
    if isinstance(segment.of, FieldType):
        _read_values(r, segment, segment.of, here, behind)
    else:
        _items(r, segment, segment.of, here, behind)


def _read_values(r: ReadWriter, segment: Repeat, of: FieldType, here: Here, behind: Behind) -> None:
    scope, struct, path = here
    member = struct.members[segment.name]
    assert member.item is not None
    size, refuse = of.fixed_size, r.refuse(segment)
    if size is None:
        raise CannotSayError(segment.at, "a list of values of any size")
    r.begin()
    if segment.times == "rest":
        room = r.rest(behind)
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
    r.stands(segment.path)
    target, index = f"{path}{member.cname}", r.local("size_t", "index")
    found = f"({r.at} - {r.inn}.from)"
    header = ""
    if segment.times == "rest" and size > 1:
        r.when(f"{found} % {size} != 0", r.note("short", f"{r.inn}.from", refuse))
        header = "else"
    with r.block(header):
        r.when(f"{found} / {size} > {member.capacity}", "notes->no_room = true;", r.leave())
        inside = wire_type(of)
        if of.kind == "fraction" and member.item.kind == "decimal":
            raise CannotSayError(segment.at, "a list of numbers with any number of decimals")
        fails = r.local("bool", "fails", "false") if inside.kind not in ("int", "float") else ""
        if fails:
            r.add(f"{fails} = false;")
        with r.block(f"for ({index} = 0; {index} < {found} / {size}; {index}++)"):
            raw = f"({r.inn}.data + {r.inn}.from + {size} * {index})"
            item = f"{target}.items[{index}]"
            if of.kind in ("float", "hex_float"):
                wire, failing = read_float(r, of, raw, str(size), segment)
            else:
                wire, failing = r.read_number(inside, raw, str(size), segment)
            if failing:
                r.when(f"{failing} != 0", f"{fails} = true;")
            if of.kind == "scaled":
                assert of.scale is not None
                wire = f"((int64_t){wire} * {number(of.scale.factor)} + {number(of.scale.offset)})"
            r.add(f"{item} = {wire};" if member.item.kind == "float" else f"{item} = ({member.item.ctype}){wire};")
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
    loop = _loop(r, segment, scope, target, start, behind)
    item_path = f"{target}.items[{target}.count]."
    inside = CScope(scope)
    with r.block(loop.header):
        if segment.align > 1 and segment.between:
            r.add(f"{r.at} += ({segment.align} - ({r.at} - {start}) % {segment.align}) % {segment.align};")
        r.add(f"{begun} = {r.at};")
        r.when(f"{target}.count >= {member.capacity}", "notes->no_room = true;", r.leave())
        r.forget(member.inside)
        r.initial(member.inside, item_path)
        _declare_item_words(r, segment, member, target, loop, inside)
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
            r.stands_from(segment.path, r.at)
        r.add(f"(void){begun};")
    if loop.whole:
        r.add(f"{r.inn}.end = {loop.whole};")
    r.stands_from(segment.path, start)
    r.is_there(member, here)


@dataclass(frozen=True, slots=True)
class _ItemLoop:
    """The loop that reads the items of a list."""

    header: str
    count: str = ""
    """The local with the number of items, if it is known before they are read."""
    whole: str = ""
    """The local with the end of the input, if the list ends its own region."""
    ended: str = ""
    """The local that is true after the last item, if a condition ends the list."""


def _loop(r: ReadWriter, segment: Repeat, scope: CScope, target: str, start: str, behind: Behind) -> _ItemLoop:
    """Write the locals that end the loop over the items; return the loop."""
    header = count = whole = ended = ""
    if segment.times == "rest":
        whole = r.local("size_t", "whole")
        size = r.rest(behind)
        r.add(f"{whole} = {r.inn}.end;", f"{r.inn}.end = {start} + (size_t){size};")
        header = f"while ({r.at} < {r.inn}.end)"
    elif segment.times is not None:
        times = (
            r.number(segment.times, scope) if isinstance(segment.times, Expression) else constant(int(segment.times))
        )
        count = r.ask(times, "length", "times")
        if times.low < 0:
            r.when(f"{count} < 0", r.note("length", r.at), r.leave())
        header = f"while ((int64_t){target}.count < {count})"
    if segment.until is not None:
        ended = r.local("bool", "is_last", "false")
        r.add(f"{ended} = false;")
        header = f"while (!{ended})"
    return _ItemLoop(header, count, whole, ended)


def _declare_item_words(
    r: ReadWriter, segment: Repeat, member: CMember, target: str, loop: _ItemLoop, inside: CScope
) -> None:
    """Declare the words that expressions of an item may read: its index, whether it is last, and the previous item."""
    index = f"(int64_t){target}.count"
    if loop.ended:
        last = loop.ended
    elif loop.count:
        last = f"({index} == {loop.count} - 1)"
    else:
        filled = segment.align - 1 if segment.align > 1 and not segment.between else 0
        last = f"({r.at} + {filled} >= {r.inn}.end)"
    inside.entries[INDEX] = Val("number", index, 0, member.capacity)
    inside.entries[LAST] = Val("number", f"(int64_t){last}", 0, 1, is_flag=True)
    inside.entries[PREVIOUS] = _previous(member, target)


def _has_open_number(segments: Segments) -> bool:
    """Return whether the segments contain a delimited number, which may take no bytes if it is invalid."""
    return any(isinstance(one, Field) and one.type.is_delimited and one.type.form is not None for one in segments)


def _previous(member: CMember, target: str) -> Val:
    assert member.inside is not None
    inside = scope_of(member.inside, f"{target}.items[{target}.count - 1].")
    return Val("record", target, there=f"{target}.count > 0", inside=inside)


def _read_item_end(r: ReadWriter, segment: ItemEnd, here: Here, behind: Behind) -> None:
    if segment.until is None:
        return
    entry = here[0].find(LAST)
    assert entry is not None
    ended = entry.text.removeprefix("(int64_t)")
    text = r.ask_whether(r.writer(here[0]).condition(segment.until), "value")
    r.add(f"{ended} = {text};")


# ---- built ----------------------------------------------------------------------------------------------------


def _record_values(w: WriteWriter, segment: Record, taken: Taken) -> list[Task]:
    member = taken.member(segment.name)
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
        with w.where(condition):
            w.values(segment.of, inner)
        taken.scope.entries[segment.name] = Val("record", "", there=condition, inside=inner.scope, wire="true")

    return [Task((segment.name,), w.outer_names(segment), write)]


def _values(w: WriteWriter, segment: Repeat, taken: Taken) -> list[Task]:
    member = taken.member(segment.name)
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


def _item_end_values(w: WriteWriter, segment: ItemEnd, taken: Taken) -> list[Task]:
    if segment.until is None:
        return []
    until = segment.until

    def write(missing: set[str]) -> None:
        last = taken.scope.find(LAST)
        assert last is not None
        w.fail_if(f"{w.holds(until, taken)} != ({last.text} != 0)", "value")

    return [Task((), w.waits(until), write)]


def _put_record(w: WriteWriter, segment: Record, taken: Taken) -> None:
    w.bytes(segment.of, w.scopes[id(segment.of)])


def _put(w: WriteWriter, segment: Repeat, taken: Taken) -> None:
    member = taken.member(segment.name)
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
        if of.kind in ("float", "hex_float"):
            put_float(w, of, item, segment)
            return
        if of.kind == "fraction":
            put_decimal(w, of, f"(int64_t){item}, {member.places}", str(of.fixed_size), segment)
            return
        if member.high > MOST:
            put_number(w, of, item, str(of.fixed_size), segment)
            return
        value = w.local("int64_t", "item_value")
        w.add(f"{value} = (int64_t){item};")
        if of.kind == "scaled":
            put_scaled(w, of, value, segment)
            return
        tests = f"{value} < {number(member.low)} || {value} > {number(member.high)}"
        with w.block(f"if ({tests})"):
            w.fail("range")
            w.add(f"{value} = 0;")
        put_number(w, of, value, str(of.fixed_size), segment)


# ---- measured -------------------------------------------------------------------------------------------------


def _measure(m: CMeasureWriter, segment: Repeat, scope: CScope, after: Pairs) -> None:
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
    """Write the loop that measures items of variable size."""
    empty, behind = may_be_empty(m.static, segment), m.least(after)
    least = 1 if empty else m.static.all(of).least
    if segment.until is None and not times.isdigit():
        m.when(f"{times} > {m.most}", f"return {LOST};")
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
            m.when(f"end < at + {least}", f"return {text};")
        elif least:
            total_text = f"{least} * {left}" + (f" + {behind}" if behind else "")
            m.when(f"end < at + {least}", f"return end - at - ({total_text});")
        m.add(f"{before} = at;")
        first_line, known = len(m.out.lines), len(m.locals)
        finished = m.branch(m.pairs(of, inside), ())
        flags = [one.split()[1] for one in m.locals[known:] if one.startswith("bool ")]  # flags of the previous item
        m.out.lines[first_line:first_line] = [f"{INDENT * m.out.depth}{flag} = false;" for flag in flags]
        ends, m.ends = m.ends, ""
        if finished:
            raise Finished
        if empty:
            m.when(f"at == {before}", f"return {LOST};")
        m.add(f"(void){before};")
        if segment.align > 1 and not segment.between:
            m.add(fill)
        m.add(f"{index}++;")
        if segment.until is not None:
            m.when(ends, "break;")


def _measure_item_end(m: CMeasureWriter, segment: ItemEnd, scope: CScope, after: Pairs) -> None:
    if segment.until is not None:
        m.ends = m.condition(segment.until, scope)


KINDS = (
    CKind(Record, read=_read_record, values=_record_values, put=_put_record),
    CKind(Repeat, read=_read, values=_values, put=_put, measure=_measure),
    CKind(ItemEnd, read=_read_item_end, values=_item_end_values, measure=_measure_item_end),
)
