"""The work of a row, compiled: changes and reads of a request in addition to a transfer, and the block or job that it
starts in a run. Commands of a run are the same blocks. Guide: serving, commands.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from framekit.definition.expression import Expression, Name, Text
from framekit.definition.model.frames import names_read
from framekit.definition.model.procedure import Target as SetTarget
from framekit.definition.model.services import After, BlockWork, PlaceOf, ServeWork
from framekit.definition.model.values import LayoutOf, Value
from framekit.link.packing import memory_of, values_of
from framekit.link.scope import Scope
from framekit.link.services.areas import Codes, DeviceAreas, Span, span_of
from framekit.link.services.matching import MatchedRow
from framekit.link.services.rows import RowFacts
from framekit.link.value_source import ValueCompiler
from framekit.link.values import (
    Evaluate,
    Names,
    bare_name,
    compile_expression,
    compile_optional,
)
from framekit.memory.memory import AccessError, unit_bits

CompilePart = Callable[[str, Value], Evaluate]
"""Compiles one word of a place, such as area or start."""


class CompiledPlace:
    """A place of memory: the words that are given, worked out on names."""

    def __init__(self, place: PlaceOf, compile_part: CompilePart) -> None:
        self._parts = [(name, compile_part(name, value)) for name, value in place.items()]

    def on(self, names: Names) -> dict[str, Any]:
        """Return the words with their values. Raise EVALUATION_ERRORS."""
        return {name: compute(names) for name, compute in self._parts}

    def where(self, names: Names) -> dict[str, Any]:
        """Return the same without the data that go there."""
        return {name: compute(names) for name, compute in self._parts if name != "data"}


@dataclass(frozen=True, slots=True)
class CompiledAfter:
    """A change after an exchange, if `when` holds."""

    when: Evaluate | None
    set: Sequence[tuple[SetTarget, Evaluate | None, Evaluate]]
    store: CompiledPlace | None


@dataclass(frozen=True, slots=True)
class CompiledJob:
    """A `JobWork` compiled; missing parts are None."""

    kind: str
    slot: Evaluate
    report: CompiledPlace | None
    host: Evaluate | None
    every: Evaluate | None
    late: Evaluate | None
    times: Evaluate | None


@dataclass(frozen=True, slots=True)
class CompiledBlock:
    """A `BlockWork` ready to be worked out. `calls` are services of the channel's protocol with their arguments."""

    work: BlockWork
    station: Evaluate | None
    params: Mapping[str, Evaluate]
    session: Evaluate | None
    read: CompiledPlace | None
    write: CompiledPlace | None
    into: CompiledPlace | None
    source: CompiledPlace | None
    calls: Sequence[tuple[str, Mapping[str, Evaluate]]]
    then: Sequence[CompiledAfter]
    job: CompiledJob | None = None


def compile_block(work: BlockWork, compile_value: Callable[[Value], Evaluate], part: CompilePart) -> CompiledBlock:
    """Compile a block; `part` compiles the words of places, in which areas may stand by their names."""

    def place(found: PlaceOf | None) -> CompiledPlace | None:
        return None if found is None else CompiledPlace(found, part)

    def values(fields: Mapping[str, Value]) -> dict[str, Evaluate]:
        return {name: compile_value(value) for name, value in fields.items()}

    def one(value: Value | None) -> Evaluate | None:
        return None if value is None else compile_value(value)

    asked = work.job
    job = None
    if asked is not None:
        rest = {key: one(getattr(asked, key)) for key in ("host", "every", "late", "times")}
        job = CompiledJob(kind=asked.kind, slot=compile_value(asked.slot), report=place(asked.report), **rest)
    return CompiledBlock(
        work=work,
        station=one(work.station),
        params=values(work.params),
        session=compile_optional(work.session),
        **{key: place(getattr(work, key)) for key in ("read", "write", "into", "source")},
        calls=[(call.service, values(call.arguments)) for call in work.calls],
        then=compile_afters(work.then, compile_value, part),
        job=job,
    )


def compile_afters(
    rows: Sequence[After], compile_value: Callable[[Value], Evaluate], part: CompilePart
) -> list[CompiledAfter]:
    """Compile the changes after an exchange."""
    return [
        CompiledAfter(
            when=compile_optional(row.when),
            set=[(target, compile_optional(target.key), compile_value(value)) for target, value in row.set],
            store=None if row.store is None else CompiledPlace(row.store, part),
        )
        for row in rows
    ]


StartBlock = Callable[[CompiledBlock, Names], "int | None"]
"""Takes the exchange that a request asks for, with the request's names; a number refuses it with that code."""


class BlockRefusedError(Exception):
    """The exchange is not made."""

    def __init__(self, code: int | None) -> None:
        super().__init__(code)
        self.code = code


class Work:
    """The work of one row, compiled."""

    def __init__(self, work: ServeWork, facts: RowFacts, areas: DeviceAreas, codes: Codes) -> None:
        shared = facts.shared
        self.facts = facts
        self.areas = areas
        self.grammar = shared.grammar
        self.codes = codes
        self._values = shared.values
        self._part = self.part_compiler(self._values, areas)
        self._holds = {name: (item.layout, item.type) for name, item in shared.protocol.state.items()}
        self.moves_data = work.moves_data
        self._reads_own_bytes = "own_bytes" in names_read(work)
        self._let = [(name, self._values.compile(value)) for name, value in work.let.items()]
        self._write = None if work.write is None else self._fields(work.write)
        self._span = None if work.span is None else self._fields(work.span)
        self._update = compile_optional(work.update)
        self._set = [(target, compile_optional(target.key), self._kept(target, value)) for target, value in work.set]
        self._drop = None if work.drop is None else (_word(work.drop["from"]), self._values.compile(work.drop["when"]))
        kept = {name for name, item in shared.protocol.state.items() if item.scope == "device"} | {"clock"}
        self._of_device = frozenset() if work.no_write else frozenset(kept)
        """Names of variables that the device keeps, if changing them is a write."""
        self._read = work.read
        self._read_fields = self._fields(work.read) if isinstance(work.read, Mapping) else None
        self._read_spans = compile_expression(work.read) if isinstance(work.read, Expression) else None
        self.block = None if work.block is None else compile_block(work.block, self._values.compile, self._part)
        self._each = compile_optional(work.each) or _each_of(work.span)
        self._each_as = work.each_as or _as_of(work.span)
        self._read_each = _each_of(work.read) if isinstance(work.read, Mapping) else None
        self._read_as = _as_of(work.read) if isinstance(work.read, Mapping) else None

    def _fields(self, fields: Mapping[str, Value]) -> dict[str, Evaluate]:
        return {name: self._part(name, value) for name, value in fields.items() if name not in ("each", "as")}

    @staticmethod
    def part_compiler(values: ValueCompiler, areas: DeviceAreas) -> CompilePart:
        """Compile the words of a place: a bare word that is an area is that area, not a variable."""

        def part(name: str, value: Value) -> Evaluate:
            word = bare_name(value) if isinstance(value, Expression) else None
            if word is not None and (name == "unit" or (name in ("area", "memory") and word in areas.areas)):
                return lambda names: word
            return values.compile(value)

        return part

    def _kept(self, target: SetTarget, value: Value) -> Evaluate:
        """Compile a value for a variable: a record of the variable's own layout remains a record."""
        if isinstance(value, LayoutOf) and value.layout in self._holds.get(target.name, ()):
            return self._values.fields(value.fields)
        return self._values.compile(value)

    # ---- doing it -----------------------------------------------------------------------------------------

    def do(self, reading: MatchedRow, start_block: Callable[[CompiledBlock, Names], None]) -> list[bytes] | None:
        """Carry out the work; return the data that were read, in the form of the frame, None if the work reads none.

        Raise DeviceMemoryError, BlockRefusedError, and EVALUATION_ERRORS for values that cannot be worked out.
        """
        names = reading.names
        scope = scope_of(names)
        for name, compute in self._let:
            names[name] = compute(names)
        if self.areas.read_only:
            self._check_kept(names, scope)
        if self._write is not None:
            self._do_write(self._write, names)
        if self._update is not None:
            self._do_update(self._update, reading)
        for target, key, compute in self._set:
            self._do_set(scope, target, None if key is None else key(names), compute(names))
        if self._drop is not None:
            self._do_drop(*self._drop, names, scope)
        data = self._do_read(names)
        if self.block is not None:
            start_block(self.block, names)
        return data

    def span_of(self, fields: Mapping[str, Evaluate], names: Names) -> Span:
        """Return the place that `area|memory|code|text, unit, start, count` mean. Raise UnknownAreaError."""
        if self._reads_own_bytes and "memory" in fields:
            names = Names({"own_bytes": self.areas.own_bytes(str(fields["memory"](names)))}, names)
        given = {name: compute(names) for name, compute in fields.items() if name != "data"}
        return span_of(self.areas, self.grammar, self.codes, given)

    def _do_write(self, fields: Mapping[str, Evaluate], names: Names) -> None:
        span = self.span_of(fields, names)
        data = fields["data"](names)
        self.areas.write(span, self.facts.packers[span.unit].to_memory(data, span.start, span.count))

    def _check_kept(self, names: Names, scope: Scope) -> None:
        """Raise AccessError where the device would keep something else afterwards."""
        for target, key, compute in self._set:
            if target.name in self._of_device:
                found = held(scope, target, None if key is None else key(names))
                if found is NOT_HELD or found != compute(names):
                    raise AccessError(f"{target.name} can only be read")
        if self._drop is not None and self._drop[0] in self._of_device:
            table, when = self._drop
            if any(when(Names({"key": key, "entry": entry}, names)) for key, entry in scope[table].items()):
                raise AccessError(f"{table} can only be read")

    def _do_set(self, scope: Scope, target: SetTarget, key: Any, value: Any) -> None:
        told = self.areas.kept
        if told is None or target.name not in self._of_device:
            assign(scope, target, key, value)
            return
        before = held(scope, target, key)
        assign(scope, target, key, value)
        after = held(scope, target, key)
        if before is NOT_HELD or before != after:
            told(_told_name(target, key), None if before is NOT_HELD else before, after)

    def _do_update(self, update: Evaluate, reading: MatchedRow) -> None:
        """Read, change and write elements; all places are validated before the first write."""
        todo: list[tuple[Span, Names]] = []
        for names in _levels(self._each, self._each_as, reading.names):
            if self._span is None:
                todo.extend((one.unit.span(one.start, one.count), names) for one in reading.targets)
            else:
                todo.append((self.span_of(self._span, names), names))
        for span, _ in todo:
            self.areas.check(span, write=True)
        for span, names in todo:
            mask = (1 << unit_bits(span.unit)) - 1
            old = values_of(self.areas.read(span, names), span.unit, span.count)
            new = [int(update(Names({"old": value}, names))) & mask for value in old]
            self.areas.write(span, memory_of(new, span.unit))

    def _do_drop(self, table: str, when: Evaluate, names: Names, scope: Scope) -> None:
        holder = scope[table]
        for key, entry in list(holder.items()):
            if when(Names({"key": key, "entry": entry}, names)):
                scope.drop_entry(table, key)
                if self.areas.kept is not None and table in self._of_device:
                    self.areas.kept(f"{table}[{key}]", entry, None)

    def _do_read(self, names: Names) -> list[bytes] | None:
        if self._read_spans is not None:
            return [self._packed(span, names) for span in self._read_spans(names)]
        if self._read_fields is None:
            return None
        fields = self._read_fields
        levels = _levels(self._read_each, self._read_as, names)
        return [b"".join([self._packed(self.span_of(fields, level), level) for level in levels])]

    def _packed(self, span: Span, names: Names) -> bytes:
        memory = self.areas.read(span, names)
        return self.facts.packers[span.unit].to_data(memory, span.start, span.count)


def _levels(each: Evaluate | None, name: str | None, names: Names) -> list[Names]:
    """Return the names for every item of a list; the names themselves when there is no list."""
    return [names] if each is None else [Names({name or "it": item}, names) for item in each(names)]


def _each_of(fields: Any) -> Evaluate | None:
    each = fields.get("each") if isinstance(fields, Mapping) else None
    return compile_expression(each) if isinstance(each, Expression) else None


def _as_of(fields: Any) -> str | None:
    return _word(fields["as"]) if isinstance(fields, Mapping) and "as" in fields else None


def _word(value: Any) -> str:
    """Return a word that is written down, bare or in quotes."""
    node = value.root if isinstance(value, Expression) else None
    if isinstance(node, Name):
        return node.name
    return node.value if isinstance(node, Text) else ""


NOT_HELD = object()


def held(scope: Scope, target: SetTarget, key: Any) -> Any:
    """Return the value that `assign` would replace; NOT_HELD if there is no value."""
    try:
        value = scope[target.name]
        if target.key is not None:
            value = value[key]
        return value if target.field is None else value[target.field]
    except (LookupError, TypeError, AttributeError):
        return NOT_HELD


def _told_name(target: SetTarget, key: Any) -> str:
    entry = "" if target.key is None else f"[{key!r:.40}]"
    return f"{target.name}{entry}{'' if target.field is None else f'.{target.field}'}"


def assign(scope: Scope, target: SetTarget, key: Any, value: Any) -> None:
    """Set `name`, `name[key]`, `name.field` or `name[key].field` of the state to `value`."""
    if target.key is None and target.field is None:
        scope.set(target.name, value)
    elif target.key is None:
        scope.set_entry(target.name, target.field, value)
    elif target.field is None:
        scope.set_entry(target.name, key, value)
    else:
        scope.set_entry(target.name, key, {**scope[target.name][key], target.field: value})


def scope_of(names: Names) -> Scope:
    """Return the engine's own names, which hold the state. Raise TypeError when these names are of no engine."""
    level: Names | None = names
    while level is not None:
        if isinstance(level, Scope):
            return level
        level = level.parent
    raise TypeError("a server needs the names of an engine")
