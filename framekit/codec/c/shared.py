"""Check codes and cases, as functions that read and functions that write have them alike."""

from __future__ import annotations

from typing import Any

from framekit.codec.c.expressions import CScope, Val, constant
from framekit.codec.c.source import CannotSayError, number
from framekit.codec.kinds.check import in_one_buffer
from framekit.codec.python.function import covered_parts, on_the_wire
from framekit.definition.kinds.check import Added
from framekit.definition.model.frames import everything, flat
from framekit.definition.model.segments import Check, Choose, Field, Segments


def work_out(r: Any, segment: Check, scope: CScope, code: str, start: str) -> bool:
    """Puts the number of a check code into a local; whether it may be that it cannot be worked out (then `bad` is set).

    `start`: where the check stands; without `over` it covers all before that.
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
    text = r.file.checks.finished(segment.method, code)
    bits = {"raw": 8, "nibbles": 4, "hex": 4, "HEX": 4, "dec": 0}[segment.form] * segment.size
    if bits and segment.method.width > bits:
        text = f"({text} & UINT64_C({(1 << bits) - 1}))"
    r.add(f"{code} = {text};")
    return fails


def _up_to_here(r: Any, names: Any, function: str, code: str, start: str) -> None:
    """All that stands in the buffer of the check from a segment on."""
    first = r.span(names[0])
    r.when(
        f"{first}.there && {first}.first <= {start}",
        f"{code} = {function}({code}, 0, {r.inn}.data + {first}.first, {start} - {first}.first);",
    )
    with r.block("else"):
        r.add("bad = true;")


def _runs(r: Any, segment: Check, names: list[str]) -> list[list[str]]:
    """Names of segments that stand one after the other in one buffer, together."""
    orders = list(_orders(r.segments))
    apart = {
        one.name for holder in everything(r.segments) if holder.has_cases for b in holder.blocks for one in flat(b)
    }
    apart |= {one.name for one in everything(r.segments) if one.is_list}  # of one that breaks off nothing counts
    found: list[list[str]] = []
    for name in names:
        if found:
            last = found[-1][-1]
            if not apart & {last, name} and any(
                last in order and name in order and order.index(name) == order.index(last) + 1 for order in orders
            ):
                found[-1].append(name)
                continue
        found.append([name])
    return found


def _orders(segments: Segments) -> Any:
    yield [one.name for one in on_the_wire(segments)]
    for segment in segments:
        for block in segment.blocks if segment.is_there_inside else ():
            yield from _orders(block)
        if segment.inner_record is not None:
            yield from _orders(segment.members)


def _run(r: Any, names: list[str], function: str, code: str, place: str) -> None:
    spans = [span for span in (r.span(name) for name in names) if span is not None]
    first, last = spans[0], spans[-1]
    there = " && ".join(f"{span}.there" for span in spans)
    size = f"{last}.last - {first}.first"
    r.when(there, f"{code} = {function}({code}, {place}, {first}.data + {first}.first, {size});", f"{place} += {size};")
    with r.block("else"):
        r.add("bad = true;")


def _added(r: Any, part: Added, scope: CScope, function: str, code: str, place: str) -> None:
    """Bytes that count and are not on the wire."""
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
            r.add(f"if ({' || '.join(tests)}) {{", "    bad = true;", "}")
        r.add(r.write_number(part.type, "number", "added", str(size), _At(part.at)))
        r.add(f"{code} = {function}({code}, {place}, added, {size});", f"{place} += {size};")


class _At:
    """What stands somewhere, for messages."""

    def __init__(self, at: Any) -> None:
        self.at = at


def put_code(r: Any, segment: Check, code: str, target: str) -> None:
    """Writes how a check code stands on the wire."""
    little = "true" if segment.order == "little" else "false"
    match segment.form:
        case "raw":
            r.add(f"{r.file.helper('put_int')}({target}, {code}, {segment.size}, {little});")
        case "nibbles":
            r.add(f"{r.file.helper('put_nibbles')}({target}, {code}, {segment.size}, {little});")
        case "dec":
            r.add(f"{r.file.helper('put_digits')}({target}, {code}, {segment.size}, 10, {little}, true);")
        case _:
            if little == "true" and segment.size % 2:
                raise CannotSayError(segment.at, "digits of a check code in pairs, of which one is missing")
            upper = "false" if segment.form == "hex" else "true"
            r.add(f"{r.file.helper('put_digits')}({target}, {code}, {segment.size}, 16, {little}, {upper});")


def case_tests(r: Any, segment: Choose, value: Val, here: Any) -> list[tuple[str, Segments]]:
    """The conditions of the cases, with what is there then; the value is put into a local first."""
    field = r.by_name.get(str(segment.on).strip())
    names = field.values if isinstance(field, Field) and field.values is not None else {}
    numbers = {name: one for one, name in names.items()}
    writer = r.writer(here[0])
    if value.kind == "number":
        local = r.local("int64_t", "chosen")
        nothing = f" && {value.there}" if value.there else ""
        text = value.text if not value.there else f"({value.there} ? {value.text} : 0)"
        is_there = r.local("bool", "is_there", "true") if value.there else ""
        if is_there:
            r.add(f"{is_there} = {value.there};")
            nothing = f" && {is_there}"
        if r.is_reader and "&bad" in text:
            r.add("bad = false;", f"{local} = {text};")
            r.when("bad", r.note("value", r.at), r.leave())
        else:
            r.add(f"{local} = {text};")
        chosen = Val("number", local)
    elif value.kind == "bytes" and not value.fold:
        nothing = f" && {value.there}" if value.there else ""
        local = r.local("struct framekit_bytes", "chosen", "{ NULL, 0 }")
        if r.is_reader and "&bad" in value.text:
            r.add("bad = false;", f"{local} = {writer.bytes(value)};")
            r.when("bad", r.note("value", r.at), r.leave())
        else:
            r.add(f"{local} = {writer.bytes(value)};")
        chosen = Val("bytes", local)
    else:
        raise CannotSayError(segment.at, "a choice by what is neither a number nor a text")
    found = []
    for keys, segments in segment.cases:
        values = [numbers.get(one, one) if isinstance(one, str) else one for one in keys]
        tests = []
        for one in values:
            key = constant(one.encode("latin-1", "replace") if isinstance(one, str) else int(one))
            tests.append(writer._same(segment.on.root, chosen, key))
        test = " || ".join(one for one in tests if one != "false") or "false"
        found.append((f"({test}){nothing}" if nothing or len(tests) > 1 else test, segments))
    return found
