"""Write `inner` in C: a frame inside a frame."""

from __future__ import annotations

from framekit.codec.python.encode_plan import Task
from framekit.codec.python.facts import begins_with_constants
from framekit.definition.expression import Expression
from framekit.definition.model.segments import Inner
from framekit.extras.generate_c.expressions import CScope, Val
from framekit.extras.generate_c.functions import CKind
from framekit.extras.generate_c.layout import inner_name
from framekit.extras.generate_c.measure import LOST, QUIET, CMeasureWriter, Pairs
from framekit.extras.generate_c.reader import Behind, Here, ReadWriter
from framekit.extras.generate_c.source import identifier
from framekit.extras.generate_c.writer import Taken, WriteWriter

# ---- read -----------------------------------------------------------------------------------------------------


def _read(r: ReadWriter, segment: Inner, here: Here, behind: Behind) -> None:
    scope, struct, path = here
    member = struct.members[segment.name]
    fixed = r.static.present(segment).fixed
    start = r.local("size_t", "inner_start")
    r.begin()
    r.add(f"{start} = {r.at};")
    if isinstance(segment.size, Expression):
        size = r.sized(segment.size, scope, "length", "-1")
    elif fixed is not None:
        size = str(fixed)
    elif segment.size == "rest" or r.knows_behind(behind):
        size = r.rest(behind)
    else:
        size = _found_inside(r, segment, here)
    r.take(size)
    r.stands(segment.path)
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
    """Return the size of an inner frame that determines its own end."""
    size = r.local("int64_t", "inner_size")
    function = r.file.first_inside(segment)
    room = f"{r.at} < {r.inn}.end ? {r.inn}.end - {r.at} : 0"
    r.add(f"{size} = {function}({r.inn}.data + {r.at}, {room}{r.file.hand_on}, true, 0);")
    nearest = r.file.nearest_inside(segment)
    fault = r.local("struct framekit_fault", "nearest", "{ FRAMEKIT_OK, 0, -1 }")
    with r.block(f"if ({size} <= 0)"):
        r.add(f"{nearest}({r.inn}.data + {r.at}, {room}{r.file.hand_on}, &{fault}, notes);")
        r.when("notes->no_room", r.leave())
        r.when(f"{fault}.reason == FRAMEKIT_OK", r.note("value", r.at), r.leave())
        r.add("notes->turn++;", f"fk_note({r.n}, {fault}.reason, {r.at} + {fault}.offset, -1);", r.leave())
    return size


# ---- built ----------------------------------------------------------------------------------------------------


def _values(w: WriteWriter, segment: Inner, taken: Taken) -> list[Task]:
    member = taken.member(segment.name)
    span = w.span(segment.path)
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


def _put(w: WriteWriter, segment: Inner, taken: Taken) -> None:
    member = taken.member(segment.name)
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


# ---- measured -------------------------------------------------------------------------------------------------


def _measure(m: CMeasureWriter, segment: Inner, scope: CScope, after: Pairs) -> None:
    fixed = m.static.present(segment).fixed
    if isinstance(segment.size, Expression):
        m.skip(m.size_text(segment.size, scope))
        return
    if segment.size == "rest":
        m.rest(segment, after)
    if fixed is not None and not begins_with_constants(m.static, segment):
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
        m.when(f"{size} == {QUIET} && end > {m.most}", f"return {LOST};")
        if not behind or several:
            m.add(f"return {size};")
        else:
            m.add(f"return {size} < 0 && {size} > {QUIET} ? {size} - {behind} : {size};")
    m.add(f"at += {size};")


KINDS = (CKind(Inner, read=_read, values=_values, put=_put, measure=_measure),)
