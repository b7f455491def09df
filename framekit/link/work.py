"""What a server does for a row when it is not simply the memory transfer: let, write, span, set, drop, read, block.

Done in this order, on the device's areas and the engine's state. Language reference, section 12.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from framekit.definition.expression.syntax import Expression, Name, Text
from framekit.definition.model.procedure import Target as SetTarget
from framekit.definition.model.services import ServeWork
from framekit.definition.model.values import LayoutOf, Value
from framekit.link.backwards import Codes, Reading
from framekit.link.block_work import CompiledBlock, CompilePart, compile_block
from framekit.link.construct_values import Compute, ValueCompiler
from framekit.link.device_areas import DeviceAreas, Span
from framekit.link.evaluate import Evaluate, Names, compile_expression
from framekit.link.invert import bare_name
from framekit.link.packing import memory_of, values_of
from framekit.link.places import span_of
from framekit.link.scope import Scope
from framekit.link.service_rows import RowFacts
from framekit.memory.memory import unit_bits

StartBlock = Callable[[CompiledBlock, Names], "int | None"]
"""Takes the exchange that a request asks for, with the request's names; a number refuses it with that code."""


class BlockRefusedError(Exception):
    """Nobody makes the exchange."""

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
        self._update = None if work.update is None else compile_expression(work.update)
        self._set = [(target, _maybe(target.key), self._kept(target, value)) for target, value in work.set]
        self._drop = None if work.drop is None else (_word(work.drop["from"]), self._values.compile(work.drop["when"]))
        self._read = work.read
        self._read_fields = self._fields(work.read) if isinstance(work.read, Mapping) else None
        self._read_spans = compile_expression(work.read) if isinstance(work.read, Expression) else None
        self.block = None if work.block is None else compile_block(work.block, self._values.compile, self._part)
        self._each = _maybe(work.each) or _each_of(work.span)
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

    def do(self, reading: Reading, scope: Scope, start_block: StartBlock | None) -> list[bytes] | None:
        """Does everything; the data that were read, as they stand in the frame, None if nothing was to be read.

        Raises DeviceMemoryError, BlockRefusedError, and EVALUATION_ERRORS for what cannot be worked out.
        """
        names = reading.names
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
            code = None if start_block is None else start_block(self.block, names)
            if start_block is None or code is not None:
                raise BlockRefusedError(code)
        return data

    def span_of(self, fields: Mapping[str, Compute], names: Names) -> Span:
        """The place that `area|memory|code|text, unit, start, count` mean. Raises UnknownAreaError."""
        given = {name: compute(names) for name, compute in fields.items() if name != "data"}
        return span_of(self.areas, self.grammar, self.codes, given)

    def _do_write(self, fields: Mapping[str, Compute], names: Names) -> None:
        span = self.span_of(fields, names)
        data = fields["data"](names)
        self.areas.write(span, self.facts.packer(span.unit).to_memory(data, span.start, span.count))

    def _do_update(self, update: Evaluate, reading: Reading) -> None:
        """Reads, changes and writes element by element; all places are judged before the first is written."""
        todo: list[tuple[Span, Names]] = []
        for names in _levels(self._each, self._each_as, reading.names):
            if self._span is None:
                todo.extend((target.span, names) for target in reading.targets)
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
        return self.facts.packer(span.unit).to_data(memory, span.start, span.count)


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


def _maybe(expression: Expression | None) -> Evaluate | None:
    return None if expression is None else compile_expression(expression)


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
