"""A server: requests that arrive, served from a device's memory by the same rows that clients send them by.

Order: the request's own refusal, the server's, the first row that matches, its refusals, area, range and access, the
work, the reply. What is simply a transfer is done by one function a row (see `matching`), all else by `Work`. Nothing
from the wire raises out of here. Language reference, sections 12
and 13.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Protocol, TypeVar

from framekit.codec.shown import explain, refusal_text
from framekit.definition.expression import Expression, Name, Text
from framekit.definition.model import protocol as model
from framekit.definition.model.procedure import Target as SetTarget
from framekit.definition.model.services import After, BlockWork, PlaceOf, ServeWork
from framekit.definition.model.values import LayoutOf, Value
from framekit.link.construct_values import EACH, Compute, ValueCompiler, compile_value
from framekit.link.events import Served
from framekit.link.frame_table import ProtocolCodec
from framekit.link.packing import memory_of, values_of
from framekit.link.scope import Scope
from framekit.link.services.areas import Codes, DeviceAreas, Span, codes_of, span_of
from framekit.link.services.matching import (
    DamagedBufferError,
    ElsewhereError,
    MatchedRow,
    Matching,
    MismatchError,
    RefusedMatchError,
    Serve,
)
from framekit.link.services.rows import RowFacts, Rule, rows_of
from framekit.link.values import (
    EVALUATION_ERRORS,
    Evaluate,
    FrameValue,
    Names,
    bare_name,
    compile_expression,
    compile_optional,
)
from framekit.memory.memory import (
    AccessError,
    DeviceMemory,
    DeviceMemoryError,
    MemoryRangeError,
    UnknownAreaError,
    unit_bits,
)

CompilePart = Callable[[str, Value], Compute]
"""Compiles one word of a place, such as area or start."""


class CompiledPlace:
    """A place of memory: the words that are given, worked out on names."""

    def __init__(self, place: PlaceOf, compile_part: CompilePart) -> None:
        self._parts = [(name, compile_part(name, value)) for name, value in place.items()]

    def on(self, names: Names) -> dict[str, Any]:
        """The words with their values. Raises EVALUATION_ERRORS."""
        return {name: compute(names) for name, compute in self._parts}

    def where(self, names: Names) -> dict[str, Any]:
        """The same without the data that go there."""
        return {name: compute(names) for name, compute in self._parts if name != "data"}


@dataclass(frozen=True, slots=True)
class CompiledAfter:
    """What is done when an exchange has ended, if `when` holds."""

    when: Evaluate | None
    set: Sequence[tuple[SetTarget, Compute | None, Compute]]
    store: CompiledPlace | None


@dataclass(frozen=True, slots=True)
class CompiledJob:
    """A `JobWork` ready to be worked out; what it does not say is None."""

    kind: str
    slot: Compute
    report: CompiledPlace | None
    host: Compute | None
    every: Compute | None
    late: Compute | None
    times: Compute | None


@dataclass(frozen=True, slots=True)
class CompiledBlock:
    """A `BlockWork` ready to be worked out. `calls` are services of the channel's protocol with their arguments."""

    work: BlockWork
    station: Compute | None
    params: Mapping[str, Compute]
    session: Evaluate | None
    read: CompiledPlace | None
    write: CompiledPlace | None
    into: CompiledPlace | None
    source: CompiledPlace | None
    calls: Sequence[tuple[str, Mapping[str, Compute]]]
    then: Sequence[CompiledAfter]
    job: CompiledJob | None = None


def compile_block(work: BlockWork, compile_value: Callable[[Value], Compute], part: CompilePart) -> CompiledBlock:
    """Compiles a block; `part` compiles the words of places, in which areas may stand by their names."""

    def place(found: PlaceOf | None) -> CompiledPlace | None:
        return None if found is None else CompiledPlace(found, part)

    def values(fields: Mapping[str, Value]) -> dict[str, Compute]:
        return {name: compile_value(value) for name, value in fields.items()}

    def one(value: Value | None) -> Compute | None:
        return None if value is None else compile_value(value)

    job = work.job
    return CompiledBlock(
        job=None
        if job is None
        else CompiledJob(
            kind=job.kind,
            slot=compile_value(job.slot),
            report=place(job.report),
            host=one(job.host),
            every=one(job.every),
            late=one(job.late),
            times=one(job.times),
        ),
        work=work,
        station=None if work.station is None else compile_value(work.station),
        params=values(work.params),
        session=compile_optional(work.session),
        read=place(work.read),
        write=place(work.write),
        into=place(work.into),
        source=place(work.source),
        calls=[(call.service, values(call.arguments)) for call in work.calls],
        then=compile_afters(work.then, compile_value, part),
    )


def compile_afters(
    rows: Sequence[After], compile_value: Callable[[Value], Compute], part: CompilePart
) -> list[CompiledAfter]:
    """Compiles what is done afterwards."""
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
        self._values = ValueCompiler(shared.codec, shared.table.made)
        self._part = self.part_compiler(self._values, areas)
        self._holds = {name: (item.layout, item.type) for name, item in shared.protocol.state.items()}
        self.moves_data = any((work.write, work.span, work.update, work.read, work.each, work.block))
        self._let = [(name, self._values.compile(value)) for name, value in work.let.items()]
        self._write = None if work.write is None else self._fields(work.write)
        self._span = None if work.span is None else self._fields(work.span)
        self._update = compile_optional(work.update)
        self._set = [(target, compile_optional(target.key), self._kept(target, value)) for target, value in work.set]
        self._drop = None if work.drop is None else (_word(work.drop["from"]), self._values.compile(work.drop["when"]))
        self._read = work.read
        self._read_fields = self._fields(work.read) if isinstance(work.read, Mapping) else None
        self._read_spans = compile_expression(work.read) if isinstance(work.read, Expression) else None
        self.block = None if work.block is None else compile_block(work.block, self._values.compile, self._part)
        self._each = compile_optional(work.each) or _each_of(work.span)
        self._each_as = work.each_as or _as_of(work.span)
        self._read_each = _each_of(work.read) if isinstance(work.read, Mapping) else None
        self._read_as = _as_of(work.read) if isinstance(work.read, Mapping) else None

    def _fields(self, fields: Mapping[str, Value]) -> dict[str, Compute]:
        return {name: self._part(name, value) for name, value in fields.items() if name not in ("each", "as")}

    @staticmethod
    def part_compiler(values: ValueCompiler, areas: DeviceAreas) -> CompilePart:
        """Compiles the words of a place: a bare word that is an area is that area, not a variable."""

        def part(name: str, value: Value) -> Compute:
            word = bare_name(value) if isinstance(value, Expression) else None
            if word is not None and (name == "unit" or (name in ("area", "memory") and word in areas.areas)):
                return lambda names: word
            return values.compile(value)

        return part

    def _kept(self, target: SetTarget, value: Value) -> Compute:
        """A layout's record put into a variable of that layout stays a record."""
        if isinstance(value, LayoutOf) and value.layout in self._holds.get(target.name, ()):
            return self._values.fields(value.fields)
        return self._values.compile(value)

    # ---- doing it -----------------------------------------------------------------------------------------

    def do(self, reading: MatchedRow, start_block: Callable[[CompiledBlock, Names], None]) -> list[bytes] | None:
        """Does everything; the data that were read, as they stand in the frame, None if nothing was to be read.

        Raises DeviceMemoryError, BlockRefusedError, and EVALUATION_ERRORS for what cannot be worked out.
        """
        names = reading.names
        scope = scope_of(names)
        for name, compute in self._let:
            names[name] = compute(names)
        if self._write is not None:
            self._do_write(self._write, names)
        if self._update is not None:
            self._do_update(self._update, reading)
        for target, key, compute in self._set:
            assign(scope, target, None if key is None else key(names), compute(names))
        if self._drop is not None:
            self._do_drop(*self._drop, names, scope)
        data = self._do_read(names)
        if self.block is not None:
            start_block(self.block, names)
        return data

    def span_of(self, fields: Mapping[str, Compute], names: Names) -> Span:
        """The place that `area|memory|code|text, unit, start, count` mean. Raises UnknownAreaError."""
        given = {name: compute(names) for name, compute in fields.items() if name != "data"}
        return span_of(self.areas, self.grammar, self.codes, given)

    def _do_write(self, fields: Mapping[str, Compute], names: Names) -> None:
        span = self.span_of(fields, names)
        data = fields["data"](names)
        self.areas.write(span, self.facts.packers[span.unit].to_memory(data, span.start, span.count))

    def _do_update(self, update: Evaluate, reading: MatchedRow) -> None:
        """Reads, changes and writes element by element; all places are validated before the first is written."""
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

    def _do_drop(self, table: str, when: Compute, names: Names, scope: Scope) -> None:
        holder = scope[table]
        for key, entry in list(holder.items()):
            if when(Names({"key": key, "entry": entry}, names)):
                scope.drop_entry(table, key)

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
    """The names for every item of a list; the names themselves when there is no list."""
    return [names] if each is None else [Names({name or "it": item}, names) for item in each(names)]


def _each_of(fields: Any) -> Evaluate | None:
    each = fields.get("each") if isinstance(fields, Mapping) else None
    return compile_expression(each) if isinstance(each, Expression) else None


def _as_of(fields: Any) -> str | None:
    return _word(fields["as"]) if isinstance(fields, Mapping) and "as" in fields else None


def _word(value: Any) -> str:
    """A word that is written down, bare or in quotes."""
    node = value.root if isinstance(value, Expression) else None
    if isinstance(node, Name):
        return node.name
    return node.value if isinstance(node, Text) else ""


def assign(scope: Scope, target: SetTarget, key: Any, value: Any) -> None:
    """`name`, `name[key]`, `name.field` or `name[key].field` of the state becomes `value`."""
    if target.key is None and target.field is None:
        scope.set(target.name, value)
    elif target.key is None:
        scope.set_entry(target.name, target.field, value)
    elif target.field is None:
        scope.set_entry(target.name, key, value)
    else:
        scope.set_entry(target.name, key, {**scope[target.name][key], target.field: value})


def scope_of(names: Names) -> Scope:
    """The engine's own names, which hold the state. Raises TypeError when these names are of no engine."""
    level: Names | None = names
    while level is not None:
        if isinstance(level, Scope):
            return level
        level = level.parent
    raise TypeError("a server needs the names of an engine")


NOTHING_SAID = 1
"""The code of a refusal for which the definition has none."""


@dataclass(slots=True)
class ServiceCounters:
    """`done`: requests carried out; `refused`: how many were refused, by the code they were refused with.

    `unanswered`: requests whose reply could not be built.
    """

    done: int = 0
    refused: Counter[int] = field(default_factory=Counter)
    unanswered: int = 0

    def count(self) -> None:
        """One more has been carried out."""
        self.done += 1

    @property
    def errors(self) -> int:
        return self.refused.total() + self.unanswered

    def reasons(self, protocol: model.Protocol) -> Counter[str]:
        """The errors by what they were."""
        found = Counter({refusal_text(protocol, code): count for code, count in sorted(self.refused.items())})
        if self.unanswered:
            found["expression"] = self.unanswered
        return found

    def add(self, other: ServiceCounters) -> None:
        """What another counted goes on here."""
        self.done += other.done
        self.refused.update(other.refused)
        self.unanswered += other.unanswered

    def clear(self) -> None:
        """Counting begins anew."""
        self.done = self.unanswered = 0
        self.refused.clear()


Found = TypeVar("Found")


class Planned(Protocol):
    """A refusal that a plan of faults wants: its code, None for that of an address out of range."""

    @property
    def code(self) -> int | None: ...


Refuses = Callable[[FrameValue, bool], Planned | None]
"""Whether a request is refused because a plan says so; the second argument: it is only checked now."""


class ServedRow:
    """A row as a server uses it."""

    def __init__(
        self, facts: RowFacts, areas: DeviceAreas, codes: Codes, start_block: Callable[[CompiledBlock, Names], None]
    ) -> None:
        row, shared = facts.row, facts.shared

        def compiled(value: Value | None) -> Callable[[Names], Any] | None:
            return None if value is None else compile_value(value, shared.protocol, shared.codec, shared.table)

        self.facts = facts
        self.areas = areas
        self.service = row.service
        self.matching = Matching(facts, areas, codes, partial(self.go_on, check_only=False))
        self.refuse = facts.refuse
        self.work = None if row.serve is None else Work(row.serve, facts, areas, codes)
        self.start_block = start_block
        self.transfers = row.service in ("read", "write") and (self.work is None or not self.work.moves_data)
        self.replies = [
            (
                compile_optional(reply.when),
                compiled(reply.frame),
                compiled(reply.buffer),
            )
            for reply in row.reply
        ]

    def check(self, request: FrameValue, buffer: bytes, station: Any, names: Names) -> Served | None:
        """Whether a request would be refused, without the bytes beside it. None: the row does not fit."""
        reading = self.matching.read(request, buffer, station, names, False)
        return None if reading is None else self.go_on(request, reading, check_only=True)

    def asked(
        self, request: FrameValue, buffer: bytes, station: Any, names: Names
    ) -> tuple[CompiledBlock | None, Names] | None:
        """The exchange that a request asks for, and what it says. None: the row does not fit."""
        reading = self.matching.read(request, buffer, station, names, True)
        return None if reading is None else (None if self.work is None else self.work.block, reading.names)

    def go_on(self, request: FrameValue, reading: MatchedRow, *, check_only: bool) -> Served:
        """Serves what a request means, where the row's function does not do everything."""
        validate(self.refuse, reading.names, check_only)
        if reading.problem is not None:
            raise reading.problem
        for target in reading.targets:
            target.unit.check(target.start, target.count, self.service == "write")
        return Served(None) if check_only else self._reply(request, reading, self._do(reading))

    def _do(self, reading: MatchedRow) -> list[bytes] | None:
        """The row's work; the data for the reply as they stand in the frame, None if there are none."""
        data = None if self.work is None else self.work.do(reading, self.start_block)
        if not self.transfers:
            return data
        if self.service == "write":
            for target in reading.targets:
                if target.memory is None:
                    raise MemoryRangeError("the request brings no data to write")
                target.unit.write(target.start, target.count, target.memory)
            return data
        found = []
        for target in reading.targets:
            memory = target.unit.read(target.start, target.count, reading.names)
            found.append(self.facts.packers[target.unit.unit].to_data(memory, target.start, target.count))
        return found

    def _reply(self, request: FrameValue, reading: MatchedRow, data: Sequence[bytes] | None) -> Served:
        names = reading.names
        if data is not None:
            names["data"] = b"".join(data)
            names["bytes"] = len(names["data"])
            variables = [target.names for target in reading.targets]
            if len(variables) != len(data):
                variables = [Names(parent=names) for _ in data]
            names[EACH] = [{**own, "data": part} for part, own in zip(data, variables, strict=True)]
        for when, frame, buffer in self.replies:
            if when is None or when(names):
                reply = None if frame is None else frame(names)
                if reply is not None:
                    self.facts.shared.table.fill_echo(reply, request)
                return Served(reply, b"" if buffer is None else buffer(names))
        return Served(None)


class MemoryServer:
    """Serves a device's memory. `mapping` puts areas of the protocol elsewhere in it (see `DeviceAreas`).

    `on_block` starts blocks of a run for requests that ask for one. `refresh` brings the memory up to date before each
    request, `refuses` refuses requests that the device would serve, `counters` count what is done and refused.
    """

    def __init__(
        self,
        protocol: model.Protocol,
        codec: ProtocolCodec,
        memory: DeviceMemory,
        *,
        mapping: Mapping[str, tuple[str, int]] | None = None,
        on_block: StartBlock | None = None,
        refresh: Callable[[], None] | None = None,
        refuses: Refuses | None = None,
        counters: ServiceCounters | None = None,
    ) -> None:
        self.on_block = on_block
        self.refresh = refresh
        self.refuses = refuses
        self.counters = ServiceCounters() if counters is None else counters
        self.areas = DeviceAreas(protocol, codec, memory, mapping)
        self.shared = rows_of(protocol, codec)
        self._refuse = self.shared.refuse
        self._rows: dict[str, list[ServedRow]] = {}
        self._serving: dict[str, list[tuple[Serve, str]]] = {}
        self.codes = codes = codes_of(protocol)
        for facts in self.shared.served:
            row = ServedRow(facts, self.areas, codes, self._start_block)
            self._rows.setdefault(row.matching.frame, []).append(row)
        errors = protocol.errors
        self._memory_codes = {} if errors is None else {n: compile_expression(e) for n, e in errors.memory.items()}
        answer = None if errors is None else errors.answer
        self._answer = None if answer is None else compile_value(answer, protocol, codec, self.shared.table)

    def serve(self, request: FrameValue, buffer: bytes, station: Any, check_only: bool, names: Names) -> Served:
        """Does what a request asks for, or, with `check_only`, only says whether it would be refused.

        What depends on the bytes beside the request is not validated by `check_only`: they come later.
        """
        if self.refresh is not None:
            self.refresh()
        planned = None if self.refuses is None else self.refuses(request, check_only)
        if planned is not None:
            served = self.refuse(request, planned.code, buffer, station, names)
        else:
            try:
                served = self._serve(request, buffer, station, check_only, names)
            except (RefusedMatchError, DeviceMemoryError, BlockRefusedError, *EVALUATION_ERRORS) as error:
                known = Names({"request": request, "buffer": buffer, "station": station}, names)
                served = self._failed(request, error, known)
        if served.refusal:
            self.counters.refused[served.refusal] += 1
        elif not check_only:
            self.counters.done += 1
        return served

    def unanswered(self) -> None:
        """The reply to the request that was carried out last could not be built: that was no good service."""
        self.counters.done -= 1
        self.counters.unanswered += 1

    def asked(self, request: FrameValue, names: Names) -> tuple[CompiledBlock | None, Names]:
        """The exchange that a request asks for, whether it would be refused or not; nothing is done.

        Raises RefusedMatchError for a request that no row is for, and EVALUATION_ERRORS.
        """
        rows = self._rows.get(request.frame, ())
        return self._first([(row.asked, row.service) for row in rows], request, b"", None, names)

    def refuse(self, request: FrameValue, code: int | None, buffer: bytes, station: Any, names: Names) -> Served:
        """Refuses a request whatever it asks for; without a code as for an address that is out of range."""
        known = Names({"request": request, "buffer": buffer, "station": station}, names)
        return self._refused(request, self._code_or(code, "range", known), known)

    def _serve(self, request: FrameValue, buffer: bytes, station: Any, check_only: bool, names: Names) -> Served:
        if request.refusal is not None:
            raise RefusedMatchError(request.refusal)
        if self._refuse:
            validate(self._refuse, Names({"request": request, "buffer": buffer, "station": station}, names), check_only)
        if check_only:
            checks = [(row.check, row.service) for row in self._rows.get(request.frame, ())]
            return self._first(checks, request, buffer, station, names)
        serving = self._serving.get(request.frame)
        if serving is None:
            rows = self._rows.get(request.frame, ())
            serving = self._serving[request.frame] = [(row.matching.serving(), row.service) for row in rows]
        return self._first(serving, request, buffer, station, names)

    def _first(
        self, functions: Sequence[tuple[Callable[[FrameValue, bytes, Any, Names], Found | None], str]],
        request: FrameValue, buffer: bytes, station: Any, names: Names,
    ) -> Found:  # fmt: skip
        """What the first row that fits gives, by its function and service.

        Raises RefusedMatchError with the best reason why none does.
        """
        reason, damaged = "no_service", None
        for function, service in functions:
            try:
                found = function(request, buffer, station, names)
            except MismatchError:
                continue
            except ElsewhereError as error:
                if error.known and service == "write":
                    reason = "access"
                elif reason != "access":
                    reason = "unknown"
                continue
            except DamagedBufferError as error:
                damaged = damaged or error
                continue
            if found is not None:
                return found
        known = Names({"request": request, "buffer": buffer, "station": station}, names)
        if damaged is not None:
            raise RefusedMatchError(self._code_or(damaged.refuse, "range", known))
        raise RefusedMatchError(self._memory_code(reason, known))

    def _start_block(self, block: CompiledBlock, names: Names) -> None:
        code = None if self.on_block is None else self.on_block(block, names)
        if self.on_block is None or code is not None:
            raise BlockRefusedError(code)

    # ---- refusals -----------------------------------------------------------------------------------------

    def _failed(self, request: FrameValue, error: Exception, names: Names) -> Served:
        """A request that cannot be done."""
        if isinstance(error, RefusedMatchError):
            return self._refused(request, error.code, names)
        if isinstance(error, DeviceMemoryError):
            return self._refused(request, self._memory_code(kind_of(error), names), names)
        if isinstance(error, BlockRefusedError):
            return self._refused(request, self._code_or(error.code, "no_service", names), names)
        return self._refused(request, self._memory_code("range", names), names, _trouble(request, error))

    def _refused(self, request: FrameValue, code: int, names: Names, trouble: str = "") -> Served:
        if self._answer is None:
            return Served(None, b"", code, trouble)
        try:
            reply = self._answer(Names({"code": code}, names))
        except EVALUATION_ERRORS as error:
            return Served(None, b"", code, trouble or _trouble(request, error))
        self.shared.table.fill_echo(reply, request)
        return Served(reply, b"", code, trouble)

    def _code_or(self, code: int | None, kind: str, names: Names) -> int:
        return self._memory_code(kind, names) if code is None else code

    def _memory_code(self, kind: str, names: Names) -> int:
        """The code for `unknown`, `range`, `access` or `no_service`; the nearest one where the definition has none."""
        for name in (kind, "unknown", "range", "access", "no_service"):
            if name in self._memory_codes:
                return int(self._memory_codes[name](names))
        return NOTHING_SAID


def validate(refuse: Sequence[Rule], names: Names, check_only: bool) -> None:
    """Raises RefusedMatchError for the first rule whose condition holds."""
    for when, code, needs_buffer in refuse:
        if not (check_only and needs_buffer) and when(names):
            raise RefusedMatchError(int(code(names)))


def kind_of(error: DeviceMemoryError) -> str:
    """What the definition calls this refusal of the memory."""
    if isinstance(error, UnknownAreaError):
        return "unknown"
    return "access" if isinstance(error, AccessError) else "range"


def _trouble(request: FrameValue, error: Exception) -> str:
    return f"serving '{request.frame}': {explain(error)}"
