"""Write `data` in C."""

from __future__ import annotations

from framekit.codec.python.encode_plan import Task
from framekit.definition.expression import Expression
from framekit.definition.model.segments import Data
from framekit.definition.problems import CannotSayError
from framekit.extras.generate_c.expressions import CScope, Val
from framekit.extras.generate_c.functions import CKind
from framekit.extras.generate_c.kinds.field import told_size
from framekit.extras.generate_c.measure import CMeasureWriter, Pairs
from framekit.extras.generate_c.reader import Behind, Here, ReadWriter
from framekit.extras.generate_c.source import string
from framekit.extras.generate_c.writer import Taken, WriteWriter, both

# ---- read -----------------------------------------------------------------------------------------------------


def _read(r: ReadWriter, segment: Data, here: Here, behind: Behind) -> None:
    scope, struct, path = here
    member = struct.members[segment.name]
    target, refuse = f"{path}{member.cname}", r.refuse(segment)
    view = r.file.helper("view")
    factor = {"hex_to_ascii": "*", "ascii_to_hex": "/", None: ""}[segment.convert]
    r.begin()
    size = r.rest(behind) if segment.size == "rest" else r.sized(segment.size, scope, "length", refuse, factor)
    r.take(size, refuse)
    r.stands(segment.path)
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


# ---- built ----------------------------------------------------------------------------------------------------


def _values(w: WriteWriter, segment: Data, taken: Taken) -> list[Task]:
    tasks = [Task((segment.name,), w.waits(segment.when), lambda _: _take_data(w, segment, taken))]
    size = segment.size
    if isinstance(size, Expression) and not w.size_by_length(segment):
        waits = {segment.name} | w.waits(size, segment.when)
        tasks.append(Task((), waits, lambda _: told_size(w, segment, segment.name, size, taken)))
    return tasks


def _take_data(w: WriteWriter, segment: Data, taken: Taken) -> None:
    member = taken.member(segment.name)
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
    if segment.pad is not None and (segment.name in w.asked_by_name or segment.path in w.tracked):
        raise CannotSayError(segment.at, "data that are filled up, of which something else depends")
    taken.scope.entries[segment.name] = Val("bytes", local, there=there, is_text=False)


def _put(w: WriteWriter, segment: Data, taken: Taken) -> None:
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
    """Write the bytes with each unit reversed; an incomplete unit at the end is unchanged."""
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


# ---- measured -------------------------------------------------------------------------------------------------


def _measure(m: CMeasureWriter, segment: Data, scope: CScope, after: Pairs) -> None:
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


KINDS = (CKind(Data, read=_read, values=_values, put=_put, measure=_measure),)
