"""Write `check` in C: its computation and its encoding, for readers, writers and measurers."""

from __future__ import annotations

from typing import Any

from framekit.codec.kinds.check import in_one_buffer
from framekit.codec.python.function import covered_parts, covers_later, on_the_wire
from framekit.definition.kinds.check import Added
from framekit.definition.model.frames import everything, flat
from framekit.definition.model.segments import Check, Segments
from framekit.definition.problems import CannotSayError
from framekit.extras.generate_c.checks import finish_code, put_code
from framekit.extras.generate_c.expressions import CScope
from framekit.extras.generate_c.functions import CKind
from framekit.extras.generate_c.measure import LOST, CMeasureWriter, Pairs
from framekit.extras.generate_c.reader import Behind, Here, ReadWriter
from framekit.extras.generate_c.source import number
from framekit.extras.generate_c.writer import Taken, WriteWriter

# ---- read -----------------------------------------------------------------------------------------------------


def _read(r: ReadWriter, segment: Check, here: Here, behind: Behind) -> None:
    r.begin()
    start = r.local("size_t", "check_start")
    r.add(f"{start} = {r.at};")
    r.take(str(segment.size))
    r.stands(segment.path)
    if segment.verify != "error":
        return
    if covers_later(segment, r.segments):
        reached = r.local("bool", "check_reached", "false")
        r.add(f"{reached} = true;")
        r.late.append(r.in_this_buffer(lambda: _verify(r, segment, here, start, reached)))
    else:
        _verify(r, segment, here, start)


def _verify(r: ReadWriter, segment: Check, here: Here, start: str, reached: str = "") -> None:
    """Compare a check code with the expected bytes; `reached`: the local that records whether it was read."""
    code = r.local("uint64_t", "code")
    wrong = r.file.helper("wrong_check")
    with r.block(f"if ({reached})" if reached else ""):
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


# ---- built ----------------------------------------------------------------------------------------------------


def _put(w: WriteWriter, segment: Check, taken: Taken) -> None:
    to, start = w.local("uint8_t *", "code_to", "NULL"), w.local("size_t", "check_start")
    w.add(f"{start} = {w.inn}.at;", f"{to} = {w.file.helper('put')}({w.n}, {segment.size});")

    def write() -> None:
        code = w.local("uint64_t", "code")
        with w.block(f"if ({to} != NULL)"):
            fails = work_out(w, segment, taken.scope, code, start)
            if fails:
                w.fail_if("bad", "value")
            put_code(w, segment, code, to)

    if segment.path in w.late_names:
        if w.in_wrap or w.in_list or segment.when is not None:
            raise CannotSayError(segment.at, "a check code in a part, before what it covers")
        w.late.append((segment, write))
    else:
        write()


# ---- measured -------------------------------------------------------------------------------------------------


def _measure(m: CMeasureWriter, segment: Check, scope: CScope, after: Pairs) -> None:
    if segment.ends:
        m.want(segment.size, after)
        start, code = m.local("size_t", "check_start"), m.local("uint64_t", "code")
        m.add(f"{start} = (size_t){m.here};")
        with m.block(""):
            m.add(f"uint8_t right[{segment.size}];", "struct fk_in in;", "struct fk_notes notes;")
            m.add("memset(&notes, 0, sizeof notes);", f"fk_open(&in, data, {start}, &notes);")
            m.file.helper("reader")
            if work_out(m, segment, scope, code, start):
                m.when("bad", f"return {LOST};")
            put_code(m, segment, code, "right")
            m.when(f"memcmp(right, data + {start}, {segment.size}) != 0", f"return {LOST};")
    m.skip(str(segment.size))


# ---- the parts of these ---------------------------------------------------------------------------------------


def work_out(r: Any, segment: Check, scope: CScope, code: str, start: str) -> bool:
    """Write the computation of a check code into a local; return whether it may fail (then `bad` is set at run time).

    `start`: the offset of the check, which covers all bytes before it unless it has `over`.
    """
    name, initial = r.file.checks.of(segment.method, segment.at)
    r.add(f"{code} = UINT64_C({initial});")
    fails = False
    if segment.covers is None:
        r.add(f"{code} = {name}({code}, 0, {r.inn}.data, {start});")
    else:
        place = r.local("size_t", "place")
        r.add("bad = false;", f"{place} = 0;")
        fails = True
        parts = covered_parts(segment, r.segments)
        if segment.span is not None and segment.span[1] == "here" and parts[0] and in_one_buffer(segment, r.segments):
            _up_to_here(r, parts[0], name, code, start)
            parts = []
        for part in parts:
            if isinstance(part, Added):
                _added(r, part, scope, name, code, place)
            elif part:
                for run in _runs(r, segment, part):
                    _run(r, run, name, code, place)
    finish_code(r, segment, code)
    return fails


def _up_to_here(r: Any, paths: Any, function: str, code: str, start: str) -> None:
    """Cover the bytes of the check's buffer from a segment up to the check."""
    first = r.span(paths[0])
    r.when(
        f"{first}.there && {first}.first <= {start}",
        f"{code} = {function}({code}, 0, {r.inn}.data + {first}.first, {start} - {first}.first);",
    )
    with r.block("else"):
        r.add("bad = true;")


def _runs(r: Any, segment: Check, paths: list[str]) -> list[list[str]]:
    """Group the paths of segments that are adjacent in one buffer."""
    orders = list(_orders(r.segments))
    apart = {
        one.path for holder in everything(r.segments) if holder.has_cases for b in holder.blocks for one in flat(b)
    }
    apart |= {one.path for one in everything(r.segments) if one.is_list}  # an incomplete list has no reliable span
    found: list[list[str]] = []
    for path in paths:
        if found:
            last = found[-1][-1]
            if not apart & {last, path} and any(
                last in order and path in order and order.index(path) == order.index(last) + 1 for order in orders
            ):
                found[-1].append(path)
                continue
        found.append([path])
    return found


def _orders(segments: Segments) -> Any:
    yield [one.path for one in on_the_wire(segments)]
    for segment in segments:
        for block in segment.blocks if segment.is_there_inside else ():
            yield from _orders(block)
        if segment.inner_record is not None:
            yield from _orders(segment.members)


def _run(r: Any, paths: list[str], function: str, code: str, place: str) -> None:
    spans = [span for span in (r.span(path) for path in paths) if span is not None]
    first, last = spans[0], spans[-1]
    there = " && ".join(f"{span}.there" for span in spans)
    size = f"{last}.last - {first}.first"
    r.when(there, f"{code} = {function}({code}, {place}, {first}.data + {first}.first, {size});", f"{place} += {size};")
    with r.block("else"):
        r.add("bad = true;")


def _added(r: Any, part: Added, scope: CScope, function: str, code: str, place: str) -> None:
    """Cover bytes that are not transmitted."""
    if part.type is None:
        value = r.writer(scope).value(part.value)
        if value.kind != "bytes" or value.there:
            raise CannotSayError(part.at, "bytes of a check code that are no plain bytes")
        extra = r.local("struct framekit_bytes", "extra", "{ NULL, 0 }")
        r.add(f"{extra} = {r.writer(scope).bytes(value)};")
        r.add(f"{code} = {function}({code}, {place}, {extra}.data, {extra}.size);", f"{place} += {extra}.size;")
        return
    value = r.number(part.value, scope)
    size = part.type.fixed_size or 1
    bounds = part.type.bounds
    assert bounds is not None
    with r.block(""):
        r.add(f"uint8_t added[{size}];", f"int64_t number = {value.text};")
        tests = [f"number < {number(bounds[0])}"] if value.low < bounds[0] else []
        tests += [f"number > {number(bounds[1])}"] if value.high > bounds[1] else []
        if tests:
            r.when(" || ".join(tests), "bad = true;")
        r.add(r.write_number(part.type, "number", "added", str(size), _At(part.at)))
        r.add(f"{code} = {function}({code}, {place}, added, {size});", f"{place} += {size};")


class _At:
    """A position for messages."""

    def __init__(self, at: Any) -> None:
        self.at = at


KINDS = (CKind(Check, read=_read, put=_put, measure=_measure),)
