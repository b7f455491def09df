"""A layout included `as` a name: its fields make one value."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from framekit.codec.kinds.base import SegmentKind
from framekit.codec.python import forms
from framekit.codec.python.diagnosis import Behind, DiagnosisWriter, inside_of
from framekit.codec.python.encode import EncodeWriter, Given
from framekit.codec.python.encode_plan import Lengths, Rules, RuleWriter, Task
from framekit.codec.python.expressions import NameEntry, Scope
from framekit.codec.python.registry import summary
from framekit.codec.python.source import Source, quoted
from framekit.definition.model.segments import Record, lack_default


class RecordKind(SegmentKind[Record]):
    model = Record

    def tasks(self, w: EncodeWriter, segment: Record, scope: Scope, given: Given) -> list[Task]:
        name, outer = segment.name, w.outer_names(segment)
        if segment.when is not None:
            both = (name, f"bytes of {name}")
            return [Task(both, outer, lambda _: _put_conditional(w, segment, scope, given))]
        tasks = [Task((name,), outer, lambda _: _put(w, segment, scope, given))]
        if name in w.asked_for:
            tasks.append(Task((f"bytes of {name}",), {name}, lambda _: w.put_into_local(segment, scope)))
        return tasks

    def declare(self, d: DiagnosisWriter, segment: Record, scope: Scope) -> None:
        inside = Scope(scope)
        d.declare(segment.of, inside)
        scope.entries[segment.name] = NameEntry(f"n[{quoted(segment.name)}]", "record", inside)

    def diagnose(self, d: DiagnosisWriter, segment: Record, scope: Scope, behind: Behind) -> None:
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


def _put(w: EncodeWriter, record: Record, scope: Scope, given: Given) -> None:
    local = w.local(record.name, given)
    inner = Given(local, f"{given.rules}[{quoted(record.name)}].inside", (*given.path, f"{record.name}."))
    if lack_default(record.of):
        given.needed += 1
        w.bind(local, given.value(record.name))
    else:
        w.bind(local, given.value_or(record.name, "{}"))
    inside = Scope(scope)
    scope.entries[record.name] = NameEntry(local, "record", inside, direct=True)
    w.values(record.of, inside, inner)
    w.check_names(inner)


def _put_conditional(w: EncodeWriter, record: Record, scope: Scope, given: Given) -> None:
    """A record that may be absent."""
    assert record.when is not None
    wire, local = w.names.fresh(f"{record.name}_bytes"), w.names.fresh(record.name)
    w.flush()
    w.add(f'{wire} = b""')
    w.add(f"{local} = None")
    plain = w.preset_plain(record.name, (record,))
    before = len(w.out.lines)
    inside = Scope(scope)
    with w.out.block(f"if {w.text(record.when, scope)}:"), w.apart():
        needed = lack_default(record.of)
        w.add(f"{local} = {given.value(record.name) if needed else given.value_or(record.name, '{}')}")
        inner = Given(local, f"{given.rules}[{quoted(record.name)}].inside", (*given.path, f"{record.name}."))
        w.values(record.of, inside, inner)
        w.flush()
        w.check_names(inner)
        w.add(f"{wire} = {w.region(record.of, inside, w.names.fresh('part'))}")
        w.add_plain(plain, record.of)
    _nothing_if_absent(w, inside, local, before)
    w.wires[record.name] = wire
    scope.entries[record.name] = NameEntry(local, "record", inside, direct=True)


def _nothing_if_absent(w: EncodeWriter, inside: Scope, record: str, before: int) -> None:
    """What a record gives is nothing where the record is absent: written at the line `before`."""
    lines = Source(w.out.depth)
    for name, entry in _direct_entries(inside):
        if name in w.fields_read and entry.text.isidentifier():
            lines.add(f"{entry.text} = None")
        elif name in w.fields_read:
            entry.text = f"({entry.text} if {record} is not None else None)"
    w.out.lines[before:before] = lines.lines


def _direct_entries(scope: Scope) -> Iterator[tuple[str, NameEntry]]:
    """The names of a record and of the records in it, as far as others may read them."""
    for name, entry in scope.entries.items():
        if entry.direct and entry.inside is not None:
            yield from _direct_entries(entry.inside)
        else:
            yield name, entry
