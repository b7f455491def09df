"""Write `choose` and `optional` in C."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

from framekit.codec.python.encode_plan import Task
from framekit.codec.python.function import standing_any_way
from framekit.codec.python.measure import Finished
from framekit.definition.model.frames import flat, nearest_path
from framekit.definition.model.segments import Choose, Field, Optional, Segment, Segments
from framekit.definition.problems import CannotSayError
from framekit.extras.generate_c.expressions import CScope, Val, constant
from framekit.extras.generate_c.functions import CKind
from framekit.extras.generate_c.measure import LOST, CMeasureWriter, Pairs
from framekit.extras.generate_c.reader import Behind, Here, ReadWriter
from framekit.extras.generate_c.source import INDENT
from framekit.extras.generate_c.writer import Taken, WriteWriter

# ---- read -----------------------------------------------------------------------------------------------------


def _read(r: ReadWriter, segment: Choose, here: Here, behind: Behind) -> None:
    scope, struct, _ = here
    r.absent(segment)
    value = r.writer(scope).value(segment.on)
    sure, r.is_sure = r.is_sure, False
    for header, segments in _cases(r, segment, value, here):
        with r.block(header):
            if segments is not None:
                r.without((segment,), struct, segments)
                r.list(segments, here, behind, all_is_read=False)
            else:
                r.add(r.note("value", r.at, r.refuse(segment)), r.leave())
    r.is_sure = sure


def _read_optional(r: ReadWriter, segment: Optional, here: Here, behind: Behind) -> None:
    _, struct, _ = here
    r.absent(segment)
    size = r.rest(behind)
    sure, r.is_sure = r.is_sure, False
    with r.block(f"if ({size} > 0)"):
        r.list(segment.of, here, behind, all_is_read=False)
    with r.block("else"):
        r.without(segment.of, struct)
    r.is_sure = sure


# ---- built ----------------------------------------------------------------------------------------------------


def _values(w: WriteWriter, segment: Choose | Optional, taken: Taken) -> list[Task]:
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
        cases = _cases(w, segment, value, (taken.scope, taken.struct, taken.path))
    else:
        flags = []
        for one in flat(segment.of):
            for name in one.given_names:
                member = taken.struct.members.get(name)
                if member is not None and member.has:
                    flags.append(f"{taken.path}{member.flag}")
        cases = [(f"if ({' || '.join(flags) or 'true'})", segment.of), ("else", None)]
    with w.block(f"if ({guard})" if guard else ""):
        for place, (header, segments) in enumerate(cases):
            with w.block(header):
                if segments is None:
                    _not_there(w, segment, taken)
                    continue
                w.add(f"{case} = {place};")
                inner = Taken(CScope(taken.scope), taken.struct, taken.path)
                w.scopes[id(segments)] = inner
                w.values(segments, inner)
                w.refuse_given((segment,), taken, segments)
                for name in names & inner.scope.entries.keys() & (w.asked_by_name | {*w.by_name}):
                    _hand_out(w, name, inner.scope.entries[name], outside, taken)
    if guard:
        with w.block("else"):
            w.refuse_given((segment,), taken)
            w.add(";")
    for name, (local, there, value) in outside.items():
        taken.scope.entries[name] = replace(value, text=local, there=there)
        w.out.lines.insert(first_line, f"{INDENT * w.out.depth}{there} = false;")


def _not_there(w: WriteWriter, segment: Choose | Optional, taken: Taken) -> None:
    """Write a failure if no case fits, or the check that an optional part is absent."""
    if isinstance(segment, Choose):
        w.fail("value")
    else:
        w.refuse_given((segment,), taken)
        w.add(";")


def _hand_out(w: WriteWriter, name: str, value: Val, outside: dict[str, tuple[str, str, Val]], taken: Taken) -> None:
    """Write a value of a case to a local, for expressions outside of the case."""
    if value.kind not in ("number", "bytes"):
        if name in w.asked_by_name and value.kind == "record":
            raise CannotSayError(w.by_name[name].at, f"the record '{name}' of a case, which is read outside it")
        return
    if name not in outside:
        local = w.value_local(f"{name}_out", is_text=value.kind == "bytes")
        outside[name] = local, w.local("bool", f"{name}_is_out", "false"), value
    local, there, known = outside[name]
    if known.kind != value.kind:
        raise CannotSayError(w.by_name[name].at, f"'{name}' is of another kind in another case")
    low, high = min(known.low, value.low), max(known.high, value.high)
    outside[name] = local, there, replace(known, low=low, high=high)
    w.add(f"{local} = {value.text};", f"{there} = {value.there or 'true'};")


def _put(w: WriteWriter, segment: Choose | Optional, taken: Taken) -> None:
    case = w.chosen[id(segment)]
    for one in standing_any_way((segment,)):  # segments of cases that are not chosen are empty
        span = w.span(one.path)
        if span is not None:
            w.add(f"{span}.data = {w.inn}.data;", f"{span}.first = {span}.last = {w.inn}.at;", f"{span}.there = true;")
    for place, segments in enumerate(segment.blocks):
        inner = w.scopes.get(id(segments))
        if inner is None:
            continue
        with w.block(f"if ({case} == {place})"):
            w.bytes(segments, inner)


# ---- measured -------------------------------------------------------------------------------------------------


def _measure(m: CMeasureWriter, segment: Choose, scope: CScope, after: Pairs) -> None:
    value = m.writer(scope).value(segment.on)
    if "&bad" in value.text and value.kind == "number":
        value = Val("number", m.kept(value, "chosen_by"), value.low, value.high, value.there)
    elif "&bad" in value.text:
        raise CannotSayError(segment.at, "a choice by what may have no value")
    cases = _cases(m, segment, value, (scope, m.struct, ""))
    m.settle()
    finished = []
    for header, segments in cases:
        with m.block(header):
            if segments is None:
                m.add(f"return {LOST};")
            else:
                finished.append(m.branch(m.pairs(segments, scope), after))
    if all(finished):
        raise Finished


def _measure_optional(m: CMeasureWriter, segment: Segment, scope: CScope, after: Pairs) -> None:
    m.rest(segment, after)


# ---- the parts of these ---------------------------------------------------------------------------------------


def _cases(r: Any, segment: Choose, value: Val, here: Any) -> list[tuple[str, Segments | None]]:
    """Return the header line of each case with its segments; None marks a forbidden case.

    The value is assigned to a local first.
    """
    writer, is_number = r.writer(here[0]), value.kind == "number"
    if not is_number and (value.kind != "bytes" or value.fold):
        raise CannotSayError(segment.at, "a choice by what is neither a number nor a text")
    local = r.value_local("chosen", is_text=not is_number)
    text, there = value.text if is_number else writer.bytes(value), value.there
    if is_number and there:
        there = r.local("bool", "is_there", "true")
        r.add(f"{there} = {value.there};")
        text = f"({value.there} ? {text} : 0)"
    if r.is_reader:
        r.worked_out(local, text, lambda: (r.note("value", r.at), r.leave()))
    else:
        r.add(f"{local} = {text};")
    chosen = Val(value.kind, local)
    found: list[tuple[str, Segments | None]] = []
    for place, (keys, segments) in enumerate(_constant_keys(r, segment)):
        tests = [writer.same(segment.on.root, chosen, key) for key in keys]
        test = " || ".join(one for one in tests if one != "false") or "false"
        test = f"({test})" if there or len(tests) > 1 else test
        found.append((f"{'else ' if place else ''}if ({test}{f' && {there}' if there else ''})", segments))
    return [*found, ("else" if found else "", segment.otherwise)]


def _constant_keys(r: Any, segment: Choose) -> Iterator[tuple[list[Val], Segments | None]]:
    """Yield each case with its keys as constants; a name of a value becomes its number."""
    field = r.by_path.get(nearest_path(str(segment.on).strip(), segment, r.by_path))
    names = field.values if isinstance(field, Field) and field.values is not None else {}
    numbers = {name: number for number, name in names.items()}
    for keys, segments in segment.cases:
        known = [numbers.get(key, key) if isinstance(key, str) else key for key in keys]
        texts = [key.encode("latin-1", "replace") if isinstance(key, str) else int(key) for key in known]
        yield [constant(text) for text in texts], segments


KINDS = (
    CKind(Choose, read=_read, values=_values, put=_put, measure=_measure),
    CKind(Optional, read=_read_optional, values=_values, put=_put, measure=_measure_optional),
)
