"""Encoders: one function a frame that takes values, works out the rest, and gives bytes."""

from __future__ import annotations

from collections.abc import Iterator

from framekit.codec.python.describe import summary, write_docstring
from framekit.codec.python.expressions import Entry, Scope, numbers_of
from framekit.codec.python.field_values import Given
from framekit.codec.python.module import Module
from framekit.codec.python.pieces import PieceWriter
from framekit.codec.python.rules import RuleWriter, is_needed
from framekit.codec.python.shape import may_be_empty, named, names_read
from framekit.codec.python.source import Code, Source, literal, quoted, text_source
from framekit.definition.expression.emit import AND, BIT_OR
from framekit.definition.model.frames import Frame
from framekit.definition.model.segments import (
    Bits,
    Check,
    Choose,
    Const,
    Count,
    Data,
    Field,
    Length,
    Optional,
    Record,
    Repeat,
    Segment,
    Value,
)
from framekit.definition.model.walk import expressions_of, flat, leaves


def write_encoder(
    module: Module, identifier: str, name: str, segments: tuple[Segment, ...], frame: Frame | None
) -> Source:
    """The source of `encode_…` of a frame, or of a layout if `frame` is None."""
    rules = module.rules(identifier, RuleWriter(module, identifier).rules(segments))
    writer = EncodeWriter(module, identifier, segments)
    given = Given("values", rules)
    scope = Scope()
    writer.values(segments, scope, given)
    writer.flush()
    writer.check_names(given)
    text = writer.region(segments, scope, writer.buffer, tail=tail_of(module, frame))
    longest = module.shapes.all(segments).most
    if frame is not None and frame.most is not None and (longest is None or longest > frame.most):
        writer.limit(text, frame.most)
        text = writer.buffer
    out = Source()
    kind = "frame" if frame is not None else "layout"
    with out.block(f"def encode_{identifier}(values: Mapping[str, Any], ctx: Context = DEFAULTS) -> bytes:"):
        write_docstring(out, f"Build the {kind} `{name}`. Raises EncodeError.", summary(segments))
        with out.block("try:"):
            out.extend(writer.out)
            out.add(f"return {as_bytes(text, segments)}")
        with out.block("except MISFITS as error:"):
            out.add(f"raise {module.function('encode_error')}(values, {rules}, error) from None")
    return out


def tail_of(module: Module, frame: Frame | None) -> tuple[Const, int] | None:
    """The constant that ends a delimited body, and the size of the head before it."""
    if frame is None or not frame.delimited or not frame.tail or not isinstance(frame.tail[0], Const):
        return None
    head = module.shapes.all(frame.head).fixed
    return None if head is None else (frame.tail[0], head)


def as_bytes(text: str, segments: tuple[Segment, ...]) -> str:
    """The result is bytes even if it begins with a value that was given, which may be a bytearray."""
    first = next(leaves(segments), None)
    is_given = isinstance(first, Data) or (isinstance(first, Field) and first.type.kind == "bytes")
    is_packed = text[0].isupper() or text.startswith('b"')
    return f'b"" + {text}' if is_given and not is_packed else text


class EncodeWriter(PieceWriter):
    """Writes the parts of an encoder that stand in branches and loops."""

    def limit(self, text: str, most: int) -> None:
        self.gather([text], self.buffer)
        message = text_source("the frame takes ", Code(f"len({self.buffer})"), f" bytes, more than {most}")
        self.complain(f"len({self.buffer}) > {most}", '""', message)

    def put_into_local(self, segment: Segment, scope: Scope) -> None:
        self.flush()
        local = self.names.fresh(f"{(segment.name or 'part').strip('_')}_bytes")
        if isinstance(segment, Record):
            text = self.region((segment,), scope, local)
        else:
            text = self.single(segment, scope)
        if text != local:
            self.add(f"{local} = {text}")
        self.wires[segment.name or ""] = local

    def records(self, repeat: Repeat, scope: Scope, given: Given) -> None:
        """A list of records: each item's values and bytes."""
        assert isinstance(repeat.of, tuple)
        items = scope.entries[repeat.name].text
        there = items if items.isidentifier() else f"{items} or ()"
        item, wire = self.names.fresh("item"), self.names.fresh(f"{repeat.name}_bytes")
        self.flush()
        self.add(f'{wire} = b""')
        whole = self._is_read_inside(repeat)
        complete = self.names.fresh(f"{repeat.name}_complete") if whole else ""
        if whole:
            self.add(f"{complete} = []")
        inside = Scope(scope)
        if whole:
            inside.entries[repeat.name] = Entry(complete, "list", inside)  # the items before this one
        place = self.names.fresh("place")
        path = (*given.path, f"{repeat.name}[", Code(place), "].")
        inner = Given(item, f"{given.rules}[{quoted(repeat.name)}].inside", path)
        before = self.names.fresh("before") if may_be_empty(self.shapes, repeat) else ""
        with self.out.block(f"for {place}, {item} in enumerate({there}):"):
            if before:
                self.add(f"{before} = len({wire})")
            self.values(repeat.of, inside, inner)
            self.flush()
            self.check_names(inner)
            self.add(f"{wire} += {self.region(repeat.of, inside, self.names.fresh('part'))}")
            if before:
                where = (*path[:-1], "]")
                message = text_source("'", *where, "' takes no bytes, so nothing shows that it is there")
                self.complain(f"len({wire}) == {before}", text_source(*where), message)
            if whole:
                names = {name for one in flat(repeat.of) for name in one.value_names}
                fields = ", ".join(
                    f"{quoted(name)}: {inside.entries[name].text}" for name in sorted(names) if name in inside.entries
                )
                self.add(f"{complete}.append({{{fields}}})")
        self.wires[repeat.name] = wire
        for entry in inside.entries.values():
            entry.direct = False
        text = self.or_nothing(repeat.name, complete, repeat.when, scope) if complete else items
        scope.entries[repeat.name] = Entry(text, "list", inside)

    def _is_read_inside(self, repeat: Repeat) -> bool:
        """Whether an expression reads fields of the items, which may be computed."""
        assert isinstance(repeat.of, tuple)
        return repeat.name in names_read(repeat.of) or any(
            f"items of {repeat.name}" in self._tokens_of(segment)
            for segment in self.by_name.values()
            if segment is not repeat
        )

    def _tokens_of(self, segment: Segment) -> set[str]:
        return self.waits(*expressions_of(segment))

    def conditional_record(self, record: Record, scope: Scope, given: Given) -> None:
        """A record that may be absent."""
        assert record.when is not None
        wire, local = self.names.fresh(f"{record.name}_bytes"), self.names.fresh(record.name)
        self.flush()
        self.add(f'{wire} = b""')
        self.add(f"{local} = None")
        before = len(self.out.lines)
        inside = Scope(scope)
        with self.out.block(f"if {self.text(record.when, scope)}:"):
            needed = is_needed(record.of)
            self.add(f"{local} = {given.value(record.name) if needed else given.value_or(record.name, '{}')}")
            inner = Given(local, f"{given.rules}[{quoted(record.name)}].inside", (*given.path, f"{record.name}."))
            self.values(record.of, inside, inner)
            self.flush()
            self.check_names(inner)
            self.add(f"{wire} = {self.region(record.of, inside, self.names.fresh('part'))}")
        self._nothing_if_absent(inside, local, before)
        self.wires[record.name] = wire
        scope.entries[record.name] = Entry(local, "record", inside, direct=True)

    def _nothing_if_absent(self, inside: Scope, record: str, before: int) -> None:
        """What a record gives is nothing where the record is absent: written at the line `before`."""
        lines = Source(self.out.depth)
        for name, entry in _direct_entries(inside):
            if name in self.fields_read and entry.text.isidentifier():
                lines.add(f"{entry.text} = None")
            elif name in self.fields_read:
                entry.text = f"({entry.text} if {record} is not None else None)"
        self.out.lines[before:before] = lines.lines

    def branches(self, segment: Choose | Optional, scope: Scope, given: Given) -> None:
        """A choice, or what is there when its values are given."""
        name = segment.name or ""
        wire = self.names.fresh("case_bytes" if isinstance(segment, Choose) else "optional_bytes")
        self.flush()
        has_checks = any(isinstance(one, Check) for one in flat((segment,)))
        if has_checks:
            self.late[name] = []
        else:
            self.add(f'{wire} = b""')
        outside = self._names_for_others(segment, scope)
        rooms = self._rooms_for_others(segment)
        cases = self._cases(segment, scope, given)
        everywhere = {name for one in flat((segment,)) for name in one.value_names}
        for header, segments in cases:
            with self.out.block(header):
                if segments is None:
                    self.add('raise EncodeError("", "no case fits")')
                    continue
                inside = self._branch(segments, scope, given, outside, rooms)
                others = everywhere - {name for one in flat(segments) for name in one.value_names}
                if others:
                    assert given.in_cases is not None
                    self.add(f"{given.in_cases[1]} += {literal(tuple(sorted(others)))}")
                if has_checks:
                    self.late[name].append((header, segments, inside))
                else:
                    self.add(f"{wire} = {self.region(segments, inside, self.names.fresh('part'))}")
        for outer, local in outside.items():
            scope.entries[outer] = Entry(local)
        self.rooms |= rooms
        if not has_checks:
            self.wires[name] = wire

    def _cases(
        self, segment: Choose | Optional, scope: Scope, given: Given
    ) -> list[tuple[str, tuple[Segment, ...] | None]]:
        """The headers of the cases with their segments; None: a case that must not be."""
        if isinstance(segment, Optional):
            names = [name for one in flat(segment.of) for name in _inputs(one)]
            tests = " or ".join(f"{quoted(name)} in {given.text}" for name in names)
            return [(f"if {tests or 'True'}:", segment.of)]
        numbers = numbers_of(segment.on, scope, self.by_name)
        on = self.text(segment.on, scope, BIT_OR)
        condition = "" if segment.when is None else f"{self.text(segment.when, scope, AND)} and "
        found: list[tuple[str, tuple[Segment, ...] | None]] = []
        for keys, segments in segment.cases:
            values = tuple(numbers.get(key, key) if isinstance(key, str) else key for key in keys)
            test = f"{on} == {literal(values[0])}" if len(values) == 1 else f"{on} in {literal(values)}"
            found.append((f"{'elif' if found else 'if'} {condition}{test}:", segments))
        last = "else:" if segment.when is None else f"elif {self.text(segment.when, scope)}:"
        return [*found, (last, segment.otherwise)]

    def _names_for_others(self, segment: Segment, scope: Scope) -> dict[str, str]:
        """Locals for names that expressions outside the branch may read."""
        found: dict[str, str] = {}
        for one in flat((segment,)):
            for name in one.value_names:
                if name in self.read_names and name not in found:
                    found[name] = self.names.fresh(name)
                    self.add(f"{found[name]} = None")
        return found

    def _rooms_for_others(self, segment: Segment) -> dict[str, str]:
        """Locals for the room that what lengths outside the branch count takes in it."""
        names = {one.name: None for one in flat((segment,)) if one is not segment and one.name in self.asked_for}
        found = {name: self.names.fresh(f"{name}_room") for name in names if name is not None}
        for local in found.values():
            self.add(f"{local} = 0")
        return found

    def _branch(
        self,
        segments: tuple[Segment, ...],
        scope: Scope,
        given: Given,
        outside: dict[str, str],
        rooms: dict[str, str],
    ) -> Scope:
        """The values of a case, in a scope of their own."""
        inner = Given(given.text, given.rules, given.path, in_cases=given.in_cases)
        inside = Scope(scope)
        self.values(segments, inside, inner)
        self.flush()
        self.refuse_absent(inner)
        if inner.computed:
            entries = ", ".join(f"{quoted(name)}: {text}" for name, text in inner.computed.items())
            assert given.in_cases is not None
            self.add(f"{given.in_cases[0]} |= {{{entries}}}")
        for name, local in outside.items():
            if name in inside.entries:
                self.add(f"{local} = {inside.entries[name].text}")
        with self.names_of(segments):
            for name in named(segments):
                if name in rooms:
                    self.add(f"{rooms[name]} = {self.room((name,), inside)}")
        return inside


def _direct_entries(scope: Scope) -> Iterator[tuple[str, Entry]]:
    """The names of a record and of the records in it, as far as others may read them."""
    for name, entry in scope.entries.items():
        if entry.direct and entry.inside is not None:
            yield from _direct_entries(entry.inside)
        else:
            yield name, entry


def _inputs(segment: Segment) -> tuple[str, ...]:
    """The names of a segment that somebody gives."""
    if isinstance(segment, (Length, Count, Value)) or (isinstance(segment, Field) and segment.is_ is not None):
        return ()
    if isinstance(segment, Bits):
        return tuple(part.name for part in segment.parts if part.is_ is None)
    return segment.value_names
