"""Implement `repeat` (a list of records or of plain values), the end of an item, and `record`.

`as` at an included layout makes a record: its fields form one value.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from framekit.codec.kinds.base import SegmentKind
from framekit.codec.python import forms
from framekit.codec.python.diagnosis import Behind, DiagnosisWriter, inside_of
from framekit.codec.python.encode import ConsumedValues, EncodeWriter
from framekit.codec.python.encode_plan import Lengths, Rules, RuleWriter, Task
from framekit.codec.python.expressions import FieldScope, Kind, NameEntry
from framekit.codec.python.facts import is_name, is_plain_name, may_be_empty
from framekit.codec.python.function import Fields, Offset, between
from framekit.codec.python.measure import Finished, MeasureWriter, Pairs
from framekit.codec.python.reader import BufferReader, ScopedSegment, without_end
from framekit.codec.python.registry import summary, type_text
from framekit.codec.python.source import Code, Source, bytes_literal, quoted, text_source
from framekit.definition.expression import BIT_OR, PRODUCT, Binary, Expression, Number
from framekit.definition.model.frames import expressions_of, flat, names_read, names_read_in
from framekit.definition.model.segments import (
    INDEX,
    ITEM_WORDS,
    LAST,
    PLAIN,
    PREVIOUS,
    Const,
    Count,
    FieldType,
    ItemEnd,
    Length,
    Record,
    Repeat,
    Segments,
    Size,
    lack_default,
)


class RepeatKind(SegmentKind[Repeat]):
    model = Repeat
    may_be_absent = True

    def is_plain(self, segment: Repeat) -> bool:
        return isinstance(segment.of, FieldType)

    def read(self, r: BufferReader, item: ScopedSegment, segment: Repeat, after: tuple[ScopedSegment, ...]) -> None:
        if isinstance(segment.of, FieldType):
            _read_values(r, item, segment, segment.of, after)
        else:
            _read_records(r, item, segment, segment.of, after)

    def tasks(self, w: EncodeWriter, segment: Repeat, scope: FieldScope, given: ConsumedValues) -> list[Task]:
        name = segment.name
        tasks = [Task((name,), w.waits(segment.when), lambda _: _put(w, segment, scope, given))]
        if isinstance(segment.of, tuple):
            gives = (f"items of {name}", f"bytes of {segment.path}")
            waits = w.outer_names(segment) | {name}
            tasks.append(Task(gives, waits, lambda _: _put_records(w, segment, scope, given)))
        if isinstance(segment.times, Expression) and not _is_told(w, segment):
            waits = w.waits(segment.times, segment.when) | {name}
            tasks.append(Task((), waits, lambda _: _compare_times(w, segment, scope, given)))
        return tasks

    def bytes_text(self, w: EncodeWriter, segment: Repeat, scope: FieldScope) -> str:
        assert isinstance(segment.of, FieldType)
        return _list_bytes(w, segment.of, scope.entries[segment.name].text)

    def room_waits(self, w: EncodeWriter, segment: Repeat) -> set[str]:
        return {segment.name} if isinstance(segment.of, FieldType) else super().room_waits(w, segment)

    def room(self, w: EncodeWriter, segment: Repeat, scope: FieldScope, plain: bool) -> str | None:
        if not isinstance(segment.of, FieldType):
            return None
        count = w.count_of(w.local_of(segment, scope))
        return count if segment.of.fixed_size == 1 else f"{segment.of.fixed_size} * {count}"

    def declare(self, d: DiagnosisWriter, segment: Repeat, scope: FieldScope) -> None:
        inside = FieldScope(scope)
        d.declare(segment.inner_record or (), inside)
        scope.entries[segment.name] = NameEntry(f"n[{quoted(segment.name)}]", "list", inside)

    def diagnose(self, d: DiagnosisWriter, segment: Repeat, scope: FieldScope, behind: Behind) -> None:
        name = quoted(segment.name)
        times = "None" if segment.times is None else d.ask(segment.times, scope)
        option = d.behind_option(segment.times == "rest", behind)
        if isinstance(segment.of, FieldType):
            parse = d.parse(segment.of)
            d.out.add(f"n.values({name}, {times}, {segment.of.fixed_size}, {parse}{d.refuse(segment)}{option})")
            return
        inside = inside_of(scope, segment.name)
        words, item = item_words(segment), "_"
        if words:
            item = d.names.fresh("item")
            for word in words:
                inside.entries[word] = _word_entry(word, f"{item}.{word.partition('.')[2]}", segment)
        option += ", until=True" if segment.until is not None else ""
        option += f", align={segment.align}" if segment.align > 1 else ""
        option += ", between=True" if segment.between else ""
        option += f", single={quoted(PLAIN)}" if segment.single else ""
        with d.out.block(f"for {item} in n.items({name}, {times}{option}):"):
            outside, d.in_item = d.in_item, True
            d.list(segment.of, inside, ())
            d.in_item = outside

    def measure(self, m: MeasureWriter, segment: Repeat, scope: FieldScope, after: Pairs) -> None:
        item = segment.of.sizes if isinstance(segment.of, FieldType) else m.static.all(segment.of)
        if segment.times == "rest":
            m.rest(segment, after)
        times = str(segment.times)
        if isinstance(segment.times, Expression):
            times = m.size_text(segment.times, scope, PRODUCT + 1)
        if item.fixed is not None and segment.name not in m.needed and segment.until is None and segment.align == 1:
            whole = str(int(times) * item.fixed) if times.isdigit() else f"{item.fixed} * {times}"
            m.skip(times if item.fixed == 1 else whole)
        elif isinstance(segment.of, FieldType):
            size = segment.of.fixed_size or 0
            m.take(f"{size} * {times}", after)
            place = m.names.fresh("place")
            one = m.wire(segment.of, Offset(place, 0), Offset(place, size))
            local = m.set_value(segment.name, scope, f"[{one} for {place} in range(at, stop, {size})]")
            scope.entries[segment.name] = NameEntry(local, "list", FieldScope())
            m.advance("stop")
        else:
            _measure_records(m, segment, segment.of, scope, times, after)

    def describe(self, segment: Repeat) -> str:
        of = segment.of
        of = of if segment.plain_type is None else segment.plain_type
        inside = type_text(of) if isinstance(of, FieldType) else f"({summary(of)})"
        if segment.single and isinstance(first := segment.members[0], Const):
            inside += f" with {first.data.hex(' ').upper()} between"
        if segment.align > 1:
            inside += f" each at a multiple of {segment.align}"
        if segment.until is not None:
            return f"{segment.name} {inside} until {segment.until}"
        return f"{segment.name} {segment.times} × {inside}"

    def rules(self, w: RuleWriter, segment: Repeat, always: bool, lengths: Lengths) -> Rules:
        yield segment.name, _rule(w, segment, always, lengths)


class ItemEndKind(SegmentKind[ItemEnd]):
    model = ItemEnd

    def read(self, r: BufferReader, item: ScopedSegment, segment: ItemEnd, after: tuple[ScopedSegment, ...]) -> None:
        function = r.function
        last = function.names.fresh("is_last")
        if segment.until is None:
            function.add(f"{last} = {r.place.text(r.buffer)} >= {r.list_end}")
        else:
            function.flush()
            function.add(f"{last} = {function.writer(item.scope).text(segment.until)}")
        item.scope.entries[LAST] = NameEntry(last)

    def tasks(self, w: EncodeWriter, segment: ItemEnd, scope: FieldScope, given: ConsumedValues) -> list[Task]:
        if segment.until is None:
            return []
        until = segment.until
        return [Task((), w.waits(until), lambda _: _end_as_told(w, until, scope, given))]

    def diagnose(self, d: DiagnosisWriter, segment: ItemEnd, scope: FieldScope, behind: Behind) -> None:
        if segment.until is not None:
            item = scope.entries[LAST].text.partition(".")[0]
            d.out.add(f"n.ends({item}, lambda n: {d.writer(scope).text(segment.until)})")

    def measure(self, m: MeasureWriter, segment: ItemEnd, scope: FieldScope, after: Pairs) -> None:
        if segment.until is not None:
            m.item_ends = m.text(segment.until, scope)


def item_words(repeat: Repeat) -> list[str]:
    """Return the item words (`item.index`, `item.last`, `item.previous`) that a list needs, `last` also for `until`."""
    read = names_read_in(repeat.members)
    return [word for word in (INDEX, LAST, PREVIOUS) if word in read or (word == LAST and repeat.until is not None)]


def _word_entry(word: str, text: str, repeat: Repeat) -> NameEntry:
    """Return the scope entry of an item word; `text` is the source of its value."""
    if word == PREVIOUS:
        return NameEntry(text, "record", _names_of_record(repeat.members), may_be_absent=True)
    return NameEntry(text)


def _names_of_record(segments: Segments) -> FieldScope:
    """Return a scope with the names of a record that is held as one value."""
    found = FieldScope()
    for one in flat(segments):
        inside = _names_of_record(one.members) if one.inner_record is not None else None
        kind: Kind = "list" if one.is_list else "record" if one.is_record else "value"
        for name in one.value_names:
            found.entries[name] = NameEntry("", kind, inside)
    return found


def _end_as_told(w: EncodeWriter, until: Expression, scope: FieldScope, given: ConsumedValues) -> None:
    where = (*given.path[:-1], "]")
    message = text_source("'", *where, f"': {until} must hold in the last item and in no other")
    w.complain(f"bool({w.text(until, scope)}) is not {scope.entries[LAST].text}", text_source(*where), message)


def _rule(w: RuleWriter, repeat: Repeat, always: bool, lengths: Lengths) -> str:
    if isinstance(repeat.times, int):
        limits = forms.Range(repeat.times, repeat.times)
    else:
        limits = lengths.get(repeat.name, forms.Range(None, None))
    of = repeat.plain_type
    if of is not None:
        kind = forms.rule_type(of)
        size = of.fixed_size if kind in ("text", "bytes") else None
        item = forms.Range(None, size) if kind != "number" else forms.wire_range(of)
        fits = forms.refusing(w.module, of)
        return w.rule("list", limits, always, inside=f'{{"": {w.rule(kind, item, False, fits=fits)}}}')
    return w.rule("list", limits, always, inside=w.mapping(repeat.members))


def _put(w: EncodeWriter, repeat: Repeat, scope: FieldScope, given: ConsumedValues) -> None:
    w.plain_given(repeat, scope, given)
    local = scope.entries[repeat.name].text
    w.refuse_if(f"not isinstance({local}, (list, tuple))")
    if isinstance(repeat.of, FieldType) and _is_asked_often(w, repeat):
        count = w.names.fresh(f"{repeat.name}_count")
        w.add(f"{count} = len({local})")
        w.counts[local] = count
    if isinstance(repeat.times, int):
        w.refuse(repeat, scope, f"{w.count_of(local)} != {repeat.times}")
    scope.entries[repeat.name].text = w.or_nothing(repeat.name, local, repeat.when, scope)


def _is_asked_often(w: EncodeWriter, repeat: Repeat) -> bool:
    """Return whether the number of values of a list is needed before they are packed."""
    counts = (one for one in w.by_path.values() if isinstance(one, Count))
    return repeat.path in w.asked_for or any(one.counted == repeat.path for one in counts)


def _is_told(w: EncodeWriter, repeat: Repeat) -> bool:
    """Return whether a count or length is built from the list, so that their comparison is unnecessary."""
    here = [target.only for target in w.targets.values()]
    return any(isinstance(one, (Count, Length)) and _is_told_by(repeat, one) for one in here)


def _is_told_by(repeat: Repeat, number: Count | Length) -> bool:
    """Return whether the number of items equals this count, or this length of the list divided by the item size."""
    if number.plus or number.when is not None:
        return False
    if isinstance(number, Count):
        return number.counted == repeat.path and is_plain_name(repeat.times, number.name)
    if (
        number.counted != (repeat.path,)
        or not isinstance(repeat.of, FieldType)
        or not isinstance(repeat.times, Expression)
    ):
        return False
    root, size = repeat.times.root, repeat.of.fixed_size
    if isinstance(root, Binary) and root.operator == "//" and isinstance(root.right, Number):
        return number.unit == 1 and is_name(root.left, number.name) and root.right.value == size
    return number.unit == size and is_name(root, number.name)


def _compare_times(w: EncodeWriter, repeat: Repeat, scope: FieldScope, given: ConsumedValues) -> None:
    """Write the comparison of the number of items with the number that other values state."""
    assert isinstance(repeat.times, Expression)
    found = w.count_of(scope.entries[repeat.name].text)
    conditions = w.is_known(repeat.when, repeat.times, scope)
    conditions.append(f"{found} != {w.text(repeat.times, scope, BIT_OR)}")  # before the function call, which is slower
    w.compare_size((*given.path, repeat.name), found, w.text(repeat.times, scope), conditions)


def _item_scope(scope: FieldScope, name: str, items: str, of: Segments = ()) -> FieldScope:
    """Return the scope of an item, inside a scope that holds the list.

    So a list of the same name in the item is a separate entry. `items`: the local with the previous items, if
    expressions may read them.
    """
    around = FieldScope(scope)
    inside = FieldScope(around, of)
    if items:
        around.entries[name] = NameEntry(items, "list", inside)
    return inside


def _put_records(w: EncodeWriter, repeat: Repeat, scope: FieldScope, given: ConsumedValues) -> None:
    """Write the loop that validates and packs the records of a list."""
    assert isinstance(repeat.of, tuple)
    items = scope.entries[repeat.name].text
    there = items if items.isidentifier() else f"{items} or ()"
    item, wire = w.names.fresh("item"), w.names.fresh(f"{repeat.name}_bytes")
    w.flush()
    w.add(f'{wire} = b""')
    words = item_words(repeat)
    whole = PREVIOUS in words or _is_read_inside(w, repeat)
    complete = w.names.fresh(f"{repeat.name}_complete") if whole else ""
    if whole:
        w.add(f"{complete} = []")
    inside = _item_scope(scope, repeat.name, complete)
    place = w.names.fresh("place")
    path = (*given.path, f"{repeat.name}[", Code(place), "].")
    inner = ConsumedValues(item, f"{given.rules}[{quoted(repeat.name)}].inside", path)
    before = w.names.fresh("before") if may_be_empty(w.static, repeat) else ""
    if repeat.until is not None:
        where = *given.path, repeat.name
        message = text_source("'", *where, "' has at least one item")
        w.complain_where(repeat.when, scope, f"not {items}", text_source(*where), message)
    texts = {
        INDEX: place, LAST: f"({place} == len({items}) - 1)", PREVIOUS: f"({complete}[-1] if {complete} else None)"
    }  # fmt: skip
    for word in words:
        inside.entries[word] = _word_entry(word, texts[word], repeat)
    with w.out.block(f"for {place}, {item} in enumerate({there}):"), w.apart():
        if repeat.single:
            w.add(f"{item} = {{{quoted(PLAIN)}: {item}}}")
        fill = f"{wire} += {bytes_literal(bytes((repeat.fill,)))} * (-len({wire}) % {repeat.align})"
        if repeat.between:
            w.add(fill)
        if before:
            w.add(f"{before} = len({wire})")
        w.values(repeat.of, inside, inner)
        w.flush()
        if not repeat.single:
            w.check_names(inner)
        w.add(f"{wire} += {w.region(repeat.of, inside, w.names.fresh('part'))}")
        if before:
            where = (*path[:-1], "]")
            message = text_source("'", *where, "' takes no bytes, so nothing shows that it is there")
            w.complain(f"len({wire}) == {before}", text_source(*where), message)
        if repeat.align > 1 and not repeat.between:
            w.add(fill)
        if whole:
            values = inside.entries[PLAIN].text if repeat.single else _values_text(repeat.of, inside)
            w.add(f"{complete}.append({values})")
    w.wires[repeat.path] = wire
    inside.close()
    text = w.or_nothing(repeat.name, complete, repeat.when, scope) if complete else items
    scope.entries[repeat.name] = NameEntry(text, "list", inside)


def _values_text(segments: Segments, scope: FieldScope) -> str:
    """Return the source of a mapping with the values of a record and of its inner records, computed values too."""
    texts: dict[str, str] = {}
    for one in flat(segments):
        for name in one.value_names:
            entry = scope.entries.get(name)
            if entry is not None and entry.direct and entry.inside is not None:
                texts[name] = _values_text(one.members, entry.inside)
            elif entry is not None:
                texts[name] = entry.text
    return f"{{{', '.join(f'{quoted(name)}: {texts[name]}' for name in sorted(texts))}}}"


def _is_read_inside(w: EncodeWriter, repeat: Repeat) -> bool:
    """Return whether an expression reads fields of the items, which may be computed."""
    assert isinstance(repeat.of, tuple)
    return repeat.name in names_read(repeat.of) or any(
        f"items of {repeat.name}" in w.waits(*expressions_of(segment))
        for segment in w.by_path.values()
        if segment is not repeat
    )


def _list_bytes(w: EncodeWriter, of: FieldType, local: str) -> str:
    code = forms.struct_code(of)
    if code == ("B", ""):
        return f"bytes([*{local}])"
    if code is not None and not code[0].endswith("s"):
        return f"{w.packs(local, '', *code)}[{w.count_of(local)}](*{local})"
    one = forms.build(w.module, of, "value", str(of.fixed_size))
    return f'b"".join([{one} for value in {local}])'


def _read_values(
    r: BufferReader, item: ScopedSegment, repeat: Repeat, of: FieldType, after: tuple[ScopedSegment, ...]
) -> None:
    """Write the reading of a list of plain values."""
    size = of.fixed_size
    if size is None:
        raise without_end(repeat)
    local = r.function.local(repeat.name, item.scope)
    if repeat.times == "rest":
        first, last = r.take_rest(item, after)
        count = None
        if size > 1:
            start = first.text(r.buffer)
            room = last.text(r.buffer) if start == "0" else f"{last.text(r.buffer)} - ({start})"
            r.function.mismatch_if(f"({room}) % {size}")
            r.function.flush()
    else:
        count = _count(r, item, repeat.times)
        first, last = r.take(item, count if size == 1 else f"{size} * {count}")
        if forms.is_slice(of):  # a struct checks the size itself before it creates values
            r.function.mismatch_if(f"{last.text(r.buffer)} > len({r.buffer})")
            r.function.flush()
    r.function.add(f"{local} = {_list_text(r, of, size, first, last, count)}")
    r.declare(item, repeat.name, local, "list")


def _list_text(r: BufferReader, of: FieldType, size: int, first: Offset, last: Offset, count: str | None) -> str:
    raw = between(r.buffer, first, last)
    code = forms.struct_code(of)
    if code == ("B", ""):
        return f"list({raw})"
    if code is None or code[0].endswith("s"):
        place = r.function.names.fresh("place")
        one = f"{r.buffer}[{place} : {place} + {size}]"
        start, stop = first.text(r.buffer), last.text(r.buffer)
        return f"[{forms.parse(r.module, of, one)} for {place} in range({start}, {stop}, {size})]"
    if count is None:
        local = r.function.names.fresh("raw")
        r.function.add(f"{local} = {raw}")
        constant = r.module.list_structs("", *code, r.function.title, "values")
        return f"list({constant}[len({local}){f' // {size}' if size > 1 else ''}].unpack({local}))"
    start = first.text(r.buffer)
    behind = "" if start == "0" else f", {first.offset if first.base == 'end' else start}"
    if count.isdigit():
        constant = r.module.struct(f"{count}{code[0]}", code[1])
        return f"list({constant}.unpack_from({r.buffer}{behind}))"
    constant = r.module.list_structs("", *code, r.function.title, "values")
    return f"list({constant}[{count}].unpack_from({r.buffer}{behind}))"


def _count(r: BufferReader, item: ScopedSegment, times: Size | None) -> str:
    """Return the number of repetitions as a number or a local."""
    if isinstance(times, int):
        return str(times)
    assert isinstance(times, Expression)
    text = r.size_text(times, item.scope)
    if text.isidentifier():
        return text
    local = r.function.names.fresh("times")
    r.function.add(f"{local} = {text}")
    return local


def _read_records(
    r: BufferReader, item: ScopedSegment, repeat: Repeat, of: Segments, after: tuple[ScopedSegment, ...]
) -> None:
    """Write the loop that reads a list of records."""
    function = r.function
    fields = Fields(function.names.fresh("item"))
    found = function.local(repeat.name, item.scope)
    inside = _item_scope(item.scope, repeat.name, found, of)
    header, count, end = _item_loop(r, item, repeat, r.static.all(of).least, after)
    first = _list_start(r, repeat)
    function.flush()
    r.settle()
    function.add(f"{found} = []")
    fill = ""
    if repeat.align > 1:
        start = function.names.fresh("first")
        function.add(f"{start} = {r.at}")
        fill = _fill_text(repeat, r.at, start)
    function.in_branch += 1
    with function.out.block(header):
        if fill and repeat.between:
            function.add(fill)
            if end is not None:
                function.mismatch_if(f"{r.at} >= {end}")
                function.flush()
        begin = None
        if may_be_empty(r.static, repeat):
            begin = function.names.fresh("item_start")
            function.add(f"{begin} = {r.at}")
        _words_of_item(r, repeat, item_words(repeat), found, count, inside)
        outside = r.deferred, r.in_item, r.list_end
        filled = repeat.align - 1 if fill and not repeat.between else 0  # the last item may lack its fill bytes
        r.deferred, r.in_item, r.list_end = [], True, f"{end} - {filled}" if filled else end or ""
        r.read(of, inside, fields)
        r.deferred, r.in_item, r.list_end = outside
        r.settle()
        if begin is not None:
            function.mismatch_if(f"{r.at} == {begin}")
        if fill and not repeat.between:
            function.flush()
            function.add(fill)
        if repeat.until is not None:
            function.mismatch_if(f"{r.at} > len({r.buffer})")
        function.flush()
        values = inside.entries[PLAIN].text if repeat.single else fields.text(function.out)
        function.add(f"{found}.append({values})")
        if repeat.until is not None:
            with function.out.block(f"if {inside.entries[LAST].text}:"):
                function.add("break")
    function.in_branch -= 1
    function.stands(repeat, r.buffer, first, r.place)
    inside.close()
    r.declare(item, repeat.name, found, "list", inside)


def _item_loop(
    r: BufferReader, item: ScopedSegment, repeat: Repeat, least: int, after: tuple[ScopedSegment, ...]
) -> tuple[str, str | None, str | None]:
    """Write the locals that bound a list of items of `least` bytes or more.

    Return the header of the loop, the number of items, and the offset of the end; None if the list has no such bound.
    """
    if repeat.times == "rest":
        end = _region_limit(r, after)
        return f"while {r.at} < {end}:", None, end
    if repeat.times is None:
        return "while True:", None, None
    count = _count(r, item, repeat.times)
    if not count.isdigit():
        place = r.place.text(r.buffer)
        there = f"len({r.buffer}) - {f'({place})' if ' ' in place else place}"
        r.function.mismatch_if(f"{count} * {least} > {there}" if least > 1 else f"{count} > {there}")
    return f"for _ in range({count}):", count, None


def _list_start(r: BufferReader, repeat: Repeat) -> Offset:
    """Return the offset of the list, in a local if it is read later and the offset of the reader moves on."""
    first = r.place
    if repeat.path not in r.function.tracked or first.base in ("", "end"):
        return first
    local = r.function.names.fresh(f"{repeat.name}_start")
    r.function.add(f"{local} = {first.text(r.buffer)}")
    return Offset(local, 0)


def _words_of_item(
    r: BufferReader, repeat: Repeat, words: list[str], found: str, count: str | None, inside: FieldScope
) -> None:
    """Write the locals of the item words that are known before the item is read."""
    for word in words:
        if word == LAST and count is None:
            inside.entries[LAST] = NameEntry("", is_read=False)
            continue
        texts = {
            INDEX: f"len({found})", LAST: f"len({found}) == {count} - 1", PREVIOUS: f"{found}[-1] if {found} else None"
        }  # fmt: skip
        local = r.function.names.fresh(word.partition(".")[2])
        r.function.add(f"{local} = {texts[word]}")
        inside.entries[word] = _word_entry(word, local, repeat)


def _region_limit(r: BufferReader, after: tuple[ScopedSegment, ...]) -> str:
    """Return a local that holds the offset of the next segment."""
    end = r.region_end(after)
    if end.base != "end":
        return end.base
    local = r.function.names.fresh("region_end")
    r.function.add(f"{local} = {end.text(r.buffer)}")
    return local


def _measure_records(
    m: MeasureWriter, repeat: Repeat, of: Segments, scope: FieldScope, times: str, after: Pairs
) -> None:
    """Write the loop that measures items of variable size.

    At each item the minimum size of all remaining items is requested at once.
    """
    empty, behind, words = may_be_empty(m.static, repeat), m.least(after), item_words(repeat)
    least = 1 if empty else m.static.all(of).least
    if repeat.until is None and not times.isdigit():
        with m.out.block(f"if {times} > {m.most}:"):
            m.add("return LOST")
    m.settle()
    found = m.set_value(repeat.name, scope, "[]") if repeat.name in m.needed else None
    inside = _item_scope(scope, repeat.name, found or "", of)
    m.paths[id(inside)] = f"{m.path_of(scope)}[{quoted(repeat.name)}][-1]"
    needed = m.needed
    if found is not None or PREVIOUS in words:
        m.needed = needed | names_read(of) | _names_in_items(of)
    left = m.names.fresh("left")
    texts = _begin_words(m, repeat, words, times, left, inside)
    if repeat.until is not None and found is None and _can_be_resumed(m, repeat):
        _resume(m, repeat, after)
    fill = ""
    if repeat.align > 1:
        first = m.names.fresh("first")
        m.add(f"{first} = at")
        fill = _fill_text(repeat, "at", first)
    header = f"for {left} in range({times}, 0, -1):" if repeat.until is None else "while True:"
    with m.out.block(header):
        if fill and repeat.between:
            m.add(fill)
        if repeat.until is not None:
            _want_item(m, least, behind)
        elif least:
            _want_all_items(m, least, left, behind)
        ends = _measure_item(m, m.pairs(of, inside), empty)
        if fill and not repeat.between:
            m.add(fill)
        if found is not None:
            m.add(f"{found}.append({inside.entries[PLAIN].text if repeat.single else _item_text(inside, found)})")
        if repeat.until is not None:
            with m.out.block(f"if {ends}:"):
                m.add("break")
        _next_words(m, repeat, words, texts, _item_text(inside, found or ""))
    m.needed = needed
    if found is not None:
        inside.close()
        scope.entries[repeat.name] = NameEntry(found, "list", inside)


def _begin_words(
    m: MeasureWriter, repeat: Repeat, words: list[str], times: str, left: str, inside: FieldScope
) -> dict[str, str]:
    """Declare the item words, and write their values before the first item; return the text of each word."""
    texts = {INDEX: f"{times} - {left}", LAST: f"{left} == 1", PREVIOUS: m.names.fresh("previous")}
    if repeat.until is not None and INDEX in words:
        texts[INDEX] = m.names.fresh("index")
        m.add(f"{texts[INDEX]} = 0")
    if PREVIOUS in words:
        m.add(f"{texts[PREVIOUS]} = None")
    for word in words:
        inside.entries[word] = _word_entry(word, texts[word] if word == PREVIOUS else f"({texts[word]})", repeat)
    return texts


def _next_words(m: MeasureWriter, repeat: Repeat, words: list[str], texts: dict[str, str], item: str) -> None:
    """Write the item words after an item, given the source of its values."""
    if repeat.until is not None and INDEX in words:
        m.add(f"{texts[INDEX]} += 1")
    if PREVIOUS in words:
        m.add(f"{texts[PREVIOUS]} = {item}")


def _measure_item(m: MeasureWriter, item: Pairs, may_be_empty: bool) -> str:
    """Write the measurement of an item, and return the condition that ends the list; an empty item is an error."""
    before = m.names.fresh("before")
    if may_be_empty:
        m.add(f"{before} = at")
    outside, m.anew = m.anew, True
    finished = m.branch(item, ())
    ends, m.item_ends = m.item_ends, ""
    m.anew = outside
    if finished:
        raise Finished
    if may_be_empty:
        with m.out.block(f"if at == {before}:"):
            m.add("return LOST")
    return ends


def _fill_text(repeat: Repeat, place: str, first: str) -> str:
    """Return the line that skips the fill bytes of an item; `first` is the offset of the list."""
    return f"{place} += -({place} - {first}) % {repeat.align}"


def _want_item(m: MeasureWriter, least: int, behind: int) -> None:
    """Write a return unless the next item can be complete. Only that item is requested, as their number is unknown."""
    with m.out.block(f"if end < at + {least}:"):
        total = least + behind
        m.add(f"return end - at - {total} if at - start + {total} <= {m.most} else LOST")


def _want_all_items(m: MeasureWriter, least: int, left: str, behind: int) -> None:
    """Write a return unless the next item can be complete. The bytes of all remaining items are requested at once."""
    total = f"{least} * {left}" + (f" + {behind}" if behind else "")
    with m.out.block(f"if end < at + {least}:"):
        m.add(f"return end - at - ({total})" if behind else f"return end - at - {total}")


def _can_be_resumed(m: MeasureWriter, repeat: Repeat) -> bool:
    """Return whether items that an earlier call has passed need no second look.

    This requires items of fixed size and a condition that reads only their own values.
    """
    own = {name for one in repeat.members for name in one.value_names}
    asked = names_read_in(repeat.members)
    return m.static.all(repeat.members).fixed is not None and asked <= own and repeat.align == 1


def _resume(m: MeasureWriter, repeat: Repeat, after: Pairs) -> None:
    """Write the skip over fixed-size items that an earlier call has passed, except the last of them."""
    size, resume = m.static.all(repeat.members).fixed, m.resume(after)
    if size and resume is not None:
        passed = f"{resume} - at - {size}" if size > 1 else f"{resume} - at - 1"
        m.add(f"at += max({passed}, 0)" if size == 1 else f"at += max({passed}, 0) // {size} * {size}")


def _names_in_items(segments: Segments) -> set[str]:
    """Return the names of the values in an item, including those in records."""
    found = set[str]()
    for one in flat(segments):
        found.update(one.value_names)
        if one.is_record:
            found |= _names_in_items(one.members)
    return found


def _item_text(scope: FieldScope, found: str = "") -> str:
    """Return the source of a mapping with the values of an item or record, without the list `found` itself."""
    texts = {
        name: _item_text(entry.inside) if entry.direct and entry.inside is not None else entry.text
        for name, entry in scope.entries.items()
        if entry.text != found and name not in ITEM_WORDS.values()
    }
    return f"{{{', '.join(f'{quoted(name)}: {text}' for name, text in texts.items())}}}"


class RecordKind(SegmentKind[Record]):
    model = Record

    def is_plain(self, segment: Record) -> bool:
        return True

    def tasks(self, w: EncodeWriter, segment: Record, scope: FieldScope, given: ConsumedValues) -> list[Task]:
        name, outer = segment.name, w.outer_names(segment)
        if segment.when is not None:
            both = (name, f"bytes of {segment.path}")
            return [Task(both, outer, lambda _: _put_conditional(w, segment, scope, given))]
        tasks = [Task((name,), outer, lambda _: _put_record(w, segment, scope, given))]
        if segment.path in w.asked_for:
            tasks.append(Task((f"bytes of {segment.path}",), {name}, lambda _: w.put_into_local(segment, scope)))
        return tasks

    def declare(self, d: DiagnosisWriter, segment: Record, scope: FieldScope) -> None:
        inside = FieldScope(scope)
        d.declare(segment.of, inside)
        scope.entries[segment.name] = NameEntry(f"n[{quoted(segment.name)}]", "record", inside)

    def diagnose(self, d: DiagnosisWriter, segment: Record, scope: FieldScope, behind: Behind) -> None:
        before = len(d.deferred)
        with d.out.block(f"with n.record({quoted(segment.name)}):"):
            d.list(segment.of, inside_of(scope, segment.name), behind, all_is_read=False)
        for place in range(before, len(d.deferred)):
            one = d.deferred[place]
            d.deferred[place] = replace(one, line=f"n.within({quoted(segment.name)}, lambda: {one.line})")

    def describe(self, segment: Record) -> str:
        return f"{segment.name} ({summary(segment.of)})"

    def rules(self, w: RuleWriter, segment: Record, always: bool, lengths: Lengths) -> Rules:
        needed = always and lack_default(segment.of)
        yield segment.name, w.rule("mapping", forms.Range(None, None), needed, inside=w.mapping(segment.of))


def _put_record(w: EncodeWriter, record: Record, scope: FieldScope, given: ConsumedValues) -> None:
    local = w.local(record.name, given)
    inner = ConsumedValues(local, f"{given.rules}[{quoted(record.name)}].inside", (*given.path, f"{record.name}."))
    if lack_default(record.of):
        given.needed += 1
        w.bind(local, given.value(record.name))
    else:
        w.bind(local, given.value_or(record.name, "{}"))
    inside = FieldScope(scope)
    scope.entries[record.name] = NameEntry(local, "record", inside, direct=True)
    w.values(record.of, inside, inner)
    w.check_names(inner)


def _put_conditional(w: EncodeWriter, record: Record, scope: FieldScope, given: ConsumedValues) -> None:
    """Write the validation and packing of a record that may be absent."""
    assert record.when is not None
    wire, local = w.names.fresh(f"{record.name}_bytes"), w.names.fresh(record.name)
    w.flush()
    w.add(f'{wire} = b""')
    w.add(f"{local} = None")
    plain = w.preset_plain(record)
    before = len(w.out.lines)
    inside = FieldScope(scope)
    with w.out.block(f"if {w.text(record.when, scope)}:"), w.apart():
        needed = lack_default(record.of)
        w.add(f"{local} = {given.value(record.name) if needed else given.value_or(record.name, '{}')}")
        inner = ConsumedValues(local, f"{given.rules}[{quoted(record.name)}].inside", (*given.path, f"{record.name}."))
        w.values(record.of, inside, inner)
        w.flush()
        w.check_names(inner)
        w.add(f"{wire} = {w.region(record.of, inside, w.names.fresh('part'))}")
        w.add_plain(plain, record.of)
    _nothing_if_absent(w, inside, local, before)
    w.wires[record.path] = wire
    scope.entries[record.name] = NameEntry(local, "record", inside, direct=True)


def _nothing_if_absent(w: EncodeWriter, inside: FieldScope, record: str, before: int) -> None:
    """Write None into the readable names of an absent record, at line number `before`."""
    lines = Source(w.out.depth)
    for name, entry in _direct_entries(inside):
        if name in w.fields_read and entry.text.isidentifier():
            lines.add(f"{entry.text} = None")
        elif name in w.fields_read:
            entry.text = f"({entry.text} if {record} is not None else None)"
    w.out.lines[before:before] = lines.lines


def _direct_entries(scope: FieldScope) -> Iterator[tuple[str, NameEntry]]:
    """Yield the names of a record and of its inner records that other segments may read."""
    for name, entry in scope.entries.items():
        if entry.direct and entry.inside is not None:
            yield from _direct_entries(entry.inside)
        else:
            yield name, entry
