"""Write `wrap` in C: its end, the reading and building of its content. The codings are in `generate_c/codings.py`."""

from __future__ import annotations

from typing import Any

from framekit.codec.python.encode_plan import Task
from framekit.codec.python.facts import symbol_behind
from framekit.codec.python.measure import needed_names
from framekit.definition.codings import Hex, Plain
from framekit.definition.expression import Expression
from framekit.definition.model.frames import everything, flat
from framekit.definition.model.segments import Const, Segments, Wrap, exactly
from framekit.definition.problems import CannotSayError
from framekit.extras.generate_c.codings import open_wrap, wrap_up
from framekit.extras.generate_c.expressions import CScope
from framekit.extras.generate_c.functions import CKind
from framekit.extras.generate_c.layout import scope_of
from framekit.extras.generate_c.measure import LOST, CMeasureWriter, Pairs
from framekit.extras.generate_c.reader import Behind, Here, ReadWriter, has_checks
from framekit.extras.generate_c.source import identifier
from framekit.extras.generate_c.writer import Taken, WriteWriter

# ---- read -----------------------------------------------------------------------------------------------------


def _read(r: ReadWriter, segment: Wrap, here: Here, behind: Behind) -> None:
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
        size = r.rest(behind)
    elif isinstance(known, int):
        size = str(known)
    else:
        size = r.sized(known, scope, "short", "-1")
    r.take(size)
    r.stands(segment.path)
    raw, room = r.raw, ""
    if not isinstance(segment.coding, Plain):
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
    """Write that the values of missing content are absent, and that no check code covers it."""
    for one in flat(segments):
        for name in one.value_names:
            r.mark(struct.members.get(name), 0)
    for one in everything(segments):
        if one.path in r.spans:
            r.add(f"{r.spans[one.path]}.there = false;")
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
    """Return the size of a region with doubled escape bytes: it determines its own end, or takes the rest."""
    assert segment.escape is not None
    some = r.embedded_in(segment)
    stop = r.local("size_t", "wrap_end")
    if fixed is not None:
        where = f"{r.inn}.data, {r.at}, {r.inn}.end, {segment.escape}"
        call = f"{r.file.helper('end_of_stuffed')}({where}, {fixed}, &{stop}) == 0"
    elif any(r.static.present(one).fixed != 0 for one, _ in behind):
        call = f"{r.file.helper('end_of_region')}({r.inn}.data, {r.at}, {r.inn}.end, {segment.escape}, {some}, &{stop})"
    else:
        return r.rest(behind)
    r.when(f"!({call})", r.note("short", r.at), r.leave())
    return f"(int64_t)({stop} - {r.at})"


# ---- built ----------------------------------------------------------------------------------------------------


def _values(w: WriteWriter, segment: Wrap, taken: Taken) -> list[Task]:
    tasks: list[Task] = []
    for one in segment.of:
        tasks += w.tasks_of(one, taken)
    return tasks


def _put(w: WriteWriter, segment: Wrap, taken: Taken) -> None:
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
        size = max(w.most, content or 0)
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


# ---- measured -------------------------------------------------------------------------------------------------


def _measure(m: CMeasureWriter, segment: Wrap, scope: CScope, after: Pairs) -> None:
    fixed = m.static.all(segment.of).fixed
    if segment.escape is not None:
        _doubled(m, segment, scope, after, fixed)
        return
    known = segment.size
    if known is None and fixed is not None:
        known = segment.coding.sizes(exactly(fixed)).fixed
    if known is not None:
        needed = any(name in m.needed for one in flat(segment.of) for name in one.value_names)
        size = str(known) if isinstance(known, int) else m.size_text(known, scope)
        if needed:
            m.settle()
            m.add(f"stop = at + {size};")
            m.want_until_stop(after)
        m.skip(size)
        _content(m, segment, scope, after)
        return
    first = after[0][0] if after else None
    if isinstance(first, Const) and first.when is None and first.data[:1] and first.data[0] in segment.coding.never:
        m.settle()
        m._search(first.data[:1], m.least(after))
        _content(m, segment, scope, after)
        return
    if not isinstance(segment.coding, Hex) or isinstance(first, Const):
        m.rest(segment, after)
    raise CannotSayError(segment.at, "digits that only what they stand for tells the end of")


def _doubled(m: CMeasureWriter, segment: Wrap, scope: CScope, after: Pairs, fixed: int | None) -> None:
    assert segment.escape is not None
    behind = m.least(after)
    m.settle()
    if fixed is not None:
        _fixed_doubled(m, segment, scope, after, fixed)
        return
    some = m.embedded_in(segment)
    found = m.local("size_t", "found_place")
    helper = m.file.helper("end_of_region")
    with m.block(f"if (at > end || !{helper}(data, (size_t)at, size, {segment.escape}, {some}, &{found}))"):
        m.not_found(max(behind - 1, 1))
    m.add(f"at = (int64_t){found};")
    if symbol := symbol_behind(segment, (one for one, _ in after)):
        m.when(f"data[at + 1] != {symbol[1]}", f"return {LOST};")
    _content(m, segment, scope, after)


def _fixed_doubled(m: CMeasureWriter, segment: Wrap, scope: CScope, after: Pairs, fixed: int) -> None:
    """Measure content of fixed size with doubled escape bytes."""
    behind, found = m.least(after), m.local("size_t", "found_place")
    helper = m.file.helper("end_of_stuffed")
    with m.block(f"switch ({helper}(data, (size_t)at, size, {segment.escape}, {fixed}, &{found}))"):
        m.add("case 0:", "    break;", "case 1:", f"    return {-1 - behind};", "default:", f"    return {LOST};")
    m.add(f"at = (int64_t){found};")
    for place, byte in enumerate(symbol_behind(segment, (one for one, _ in after))):
        m.when(f"at + {place} < end && data[at + {place}] != {byte}", f"return {LOST};")
    _content(m, segment, scope, after)


def _content(m: CMeasureWriter, segment: Wrap, scope: CScope, after: Pairs) -> None:
    """Write the reading of values in a wrap that the sizes of later segments depend on."""
    needed = m.needed & needed_names(tuple(one for one, _ in after), m.segments)
    names = {name for one in flat(segment.of) for name in one.value_names if name in needed}
    if not names:
        return
    m.settle()
    frame = identifier(m.frame.name)
    scratch, notes = m.fresh("scratch"), m.fresh("notes")
    m.locals += [f"struct {m.file.frame_enum(m.frame.name)} {scratch};", f"struct fk_notes {notes};"]
    m.add(f"memset(&{notes}, 0, sizeof {notes});")
    m.add(f"{m.file.prefix}_fk_read_{frame}(data, (size_t)at{m.file.hand_on}, &{scratch}, &{notes});")
    found = scope_of(m.struct, f"{scratch}.")
    for name in names:
        scope.entries[name] = found.entries[name]


KINDS = (CKind(Wrap, read=_read, values=_values, put=_put, measure=_measure),)
