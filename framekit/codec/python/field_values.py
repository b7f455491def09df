"""Values of single fields for an encoder: given, computed, built or by default, and what must hold for them."""

from __future__ import annotations

from dataclasses import dataclass, field

from framekit.codec.python import forms
from framekit.codec.python.building import Building
from framekit.codec.python.expressions import Entry, Scope, constant_of, default_text
from framekit.codec.python.order import Task
from framekit.codec.python.source import Code, bytes_literal, literal, quoted, text_source
from framekit.definition.expression.emit import AND, OR
from framekit.definition.expression.syntax import Bytes, Expression, Number, Text
from framekit.definition.model.segments import BitsPart, Count, Data, Field, Length, Segment


@dataclass(slots=True)
class Given:
    """A mapping of values being used up: its text, how many have to be there, all names, and what is computed.

    `in_cases`: the locals with what the cases that are taken compute, and with the names of the others. `conditional`:
    the segments of these values that are there under a condition of their own.
    """

    text: str
    rules: str
    path: tuple[str | Code, ...] = ()
    needed: int = 0
    names: list[str] = field(default_factory=list)
    computed: dict[str, str] = field(default_factory=dict)
    in_cases: tuple[str, str] | None = None
    conditional: list[tuple[Segment, Scope]] = field(default_factory=list)

    def value(self, name: str) -> str:
        """Text of a value that is there."""
        return f"{self.text}[{quoted(name)}]"

    def value_or(self, name: str, otherwise: str) -> str:
        """Text of a value, or of a constant if it was not given."""
        return f"{self.text}.get({quoted(name)}, {otherwise})"

    def value_or_worked_out(self, name: str, otherwise: str) -> str:
        """Text of a value, or of what is worked out if it was not given."""
        return f"{self.value(name)} if {quoted(name)} in {self.text} else {otherwise}"


class FieldValueWriter(Building):
    """Writes the lines that bring single values into locals."""

    def field_tasks(self, item: Field, scope: Scope, given: Given) -> list[Task]:
        needed = item.build is None and item.default is None and item.is_ is None and item.constants is None
        waits = self.waits(item.is_ or item.build or item.default, item.when if item.default is None else None)
        may_be_given = not needed and item.is_ is None
        first = Task(
            (item.name,), waits, lambda missing: self._field(item, scope, given, needed, missing), may_be_given
        )
        if item.is_ is not None or (item.constants is not None and len(item.constants) == 1):
            return [first]
        waits = self.waits(item.when) | {item.name}
        tasks = [first, Task((), waits, lambda _: self._judge(item, scope, scope.entries[item.name].text))]
        size = item.type.size
        if isinstance(size, Expression) and item.type.kind in ("ascii", "bytes") and self.size_by_length(item) is None:
            tasks.append(Task((), waits | self.waits(size), lambda _: self._text_size(item, size, scope, given)))
        return tasks

    def _text_size(self, item: Field, size: Expression, scope: Scope, given: Given) -> None:
        """A text or bytes must be as long as other values say."""
        self._sized_as_told(item, item.name, size, scope, given)

    def local(self, name: str, given: Given) -> str:
        """The local that a value is to be in."""
        return self.names.fresh(name)

    def bind(self, local: str, text: str) -> None:
        """Brings a value into its local."""
        self.add(f"{local} = {text}")

    def _field(self, item: Field, scope: Scope, given: Given, needed: bool, missing: set[str]) -> None:
        local = self.local(item.name, given)
        sized = item.type.kind in ("ascii", "bytes")
        entry = Entry(local, sized=sized, wire=None)
        if item.constants is not None and len(item.constants) == 1:
            entry.text = literal(item.constants[0])
            given.computed[item.name] = entry.text
        elif item.is_ is not None:
            entry.text = self._computed(item.name, item.is_, local, scope, given, item.when)
            self.refuse_digits(item, scope, entry.text)
            if sized and isinstance(item.type.size, int) and entry.text == local:
                self._judge_text(item, scope, local)
        else:
            self.bind(local, self._given(item, scope, given, needed, missing))
            if item.type.kind == "bytes" and item.when is None:
                self.no_bytes(local)
            if item.values is not None:
                numbers = self.module.numbers(item.values, f"{self.title} {item.name}")
                self.add(f"{local} = {numbers}.get({local}, {local})")
        if item.name in given.computed and item.default is None:
            entry.text = self.or_nothing(item.name, entry.text, item.when, scope)
        scope.entries[item.name] = entry
        if not sized and item.when is None:
            entry.wire = self.room((item.name,), scope)

    def or_nothing(self, name: str, text: str, when: Expression | None, scope: Scope) -> str:
        """Text of a value for the expressions that read it: what is absent is nothing."""
        if when is None or name not in self.read_names:
            return text
        return f"({text} if {self.text(when, scope, OR)} else None)"

    def if_there(self, text: str, when: Expression | None, scope: Scope) -> str:
        """Text of what is worked out only for a segment that is there."""
        return text if when is None else f"({text}) if {self.text(when, scope, OR)} else None"

    def _computed(
        self, name: str, expression: Expression, local: str, scope: Scope, given: Given, when: Expression | None
    ) -> str:
        number = constant_of(expression)
        if number is None:
            self.add(f"{local} = {self.if_there(self.writer(scope).value(expression), when, scope)}")
        text = local if number is None else str(number)
        given.computed[name] = text
        return text

    def _given(self, item: Field, scope: Scope, given: Given, needed: bool, missing: set[str]) -> str:
        """Text of a value that is given, or built, or has a default."""
        if needed:
            if item.when is None:
                given.needed += 1
                return given.value(item.name)
            key = self.wanted(item.name, given)
            return f"{key} if {self.text(item.when, scope, OR)} else None"
        if item.constants is not None:
            return given.value_or(item.name, literal(item.constants[0]))
        expression = item.build or item.default
        assert expression is not None
        with_missing = self.with_missing(scope, given, missing)
        text = default_text(self.writer(with_missing).value(expression), item)
        if isinstance(expression.root, (Number, Text, Bytes)):
            return given.value_or(item.name, text)
        text = self.writer(with_missing).value(expression)
        if item.default is None and item.when is not None:
            text = f"({self.if_there(text, item.when, scope)})"
        return given.value_or_worked_out(item.name, text)

    def wanted(self, name: str, given: Given) -> str:
        """Text of a value that is wanted here; in a record it says itself whose value is missing."""
        if not given.path:
            return given.value(name)
        return f"{self.module.function('needed')}({given.text}, {quoted(name)}, {text_source(*given.path)})"

    def with_missing(self, scope: Scope, given: Given, missing: set[str]) -> Scope:
        """A scope in which names that are not worked out yet are those given."""
        inner = Scope(scope)
        inner.entries = {name: Entry(self.wanted(name, given)) for name in sorted(missing)}
        return inner

    def _judge(self, item: Field, scope: Scope, local: str) -> None:
        """What must hold for a value that was given or built."""
        if item.values is not None and item.only and item.constants is None:
            self.refuse(item, scope, f"{local} not in {self.module.value_names(item.values, item.name)}")
        if item.constants is not None:
            self._refuse_others(item.name, local, item.constants)
        limits = forms.value_range(item)
        by_type = item.type.kind == "int" and item.limits is None and item.zero_means is None and item.long is None
        if item.type.kind in ("ascii", "bytes"):
            self._judge_text(item, scope, local)
        elif not by_type and item.type.kind != "float":
            self.judge_range(item, scope, local, limits)
        if item.unit is not None and item.unit != 1:
            self.refuse(item, scope, f"{local} % {item.unit:_}")

    def judge_range(self, item: Segment, scope: Scope, local: str, limits: forms.Range) -> None:
        if limits.least is not None and limits.most is not None:
            self.refuse(item, scope, f"not {limits.least} <= {local} <= {limits.most}")
        elif limits.least is not None:
            self.refuse(item, scope, f"{local} < {limits.least}")

    def _judge_text(self, item: Field, scope: Scope, local: str) -> None:
        size = item.type.size
        if isinstance(size, int):
            exact = item.type.kind == "bytes" or (item.type.pad is None and item.type.end is None)
            self.refuse(item, scope, f"len({local}) {'!=' if exact else '>'} {size}")
        elif item.type.end is not None:
            condition = f"{literal(item.type.end.decode('latin-1'))} in {local}"
            if item.when is not None:
                condition = f"{self.text(item.when, scope, AND)} and {condition}"
            self.complain(condition, quoted(item.name), quoted(f"'{item.name}' holds its own end"))

    def refuse_digits(self, item: Field | Length | Count, scope: Scope, text: str) -> None:
        """A number that is worked out must fit into its hex digits: to format it says nothing of that."""
        if forms.hex_places(item.type) is None or text.isdigit():
            return
        limits = forms.value_range(item)
        if isinstance(item, Field) or item.plus < 0:
            self.judge_range(item, scope, text, limits)
        else:
            self.refuse(item, scope, f"{text} > {limits.most}")

    def refuse(self, item: Segment, scope: Scope, condition: str) -> None:
        if item.when is not None:
            condition = f"({self.text(item.when, scope, AND)} and {condition})"
        self.refuse_if(condition)

    def _refuse_others(self, name: str, local: str, constants: tuple[int | str | bytes, ...]) -> None:
        shown = ", ".join(repr(constant) for constant in constants)
        message = text_source(f"'{name}' is one of {shown}, not ", Code(f"repr({local})"))
        self.complain(f"{local} not in {literal(constants)}", quoted(name), message)

    def bits_task(self, part: BitsPart, when: Expression | None, scope: Scope, given: Given) -> Task:
        def write(missing: set[str]) -> None:
            self._bits(part, when, scope, given, missing)
            entry = scope.entries[part.name]
            entry.text = self.or_nothing(part.name, entry.text, when, scope)

        worked_out = part.is_ or part.build
        asked = part.name in self.read_names or worked_out is not None
        waits = self.waits(worked_out, when if asked else None)
        return Task((part.name,), waits, write, part.is_ is None)

    def _bits(self, part: BitsPart, when: Expression | None, scope: Scope, given: Given, missing: set[str]) -> None:
        local = self.local(part.name, given)
        text = local
        if part.constants is not None and len(part.constants) == 1:
            text = given.computed[part.name] = str(part.constants[0])
        elif part.is_ is not None:
            text = self._computed(part.name, part.is_, local, scope, given, when)
        elif part.build is not None and not isinstance(part.build.root, Number):
            build = self.writer(self.with_missing(scope, given, missing)).value(part.build)
            build = f"({self.if_there(build, when, scope)})" if when is not None else build
            self.bind(local, given.value_or_worked_out(part.name, build))
        else:
            first = 0 if part.constants is None else part.constants[0]
            otherwise = first if part.build is None else self.writer(scope).text(part.build)
            self.bind(local, given.value_or(part.name, str(otherwise)))
        if text == local and part.is_ is None:
            if part.values is not None:
                numbers = self.module.numbers(part.values, f"{self.title} {part.name}")
                self.add(f"{local} = {numbers}.get({local}, {local})")
            if part.constants is not None:
                self._refuse_others(part.name, local, part.constants)
        if text == local:
            most = (1 << part.high - part.low + 1) - 1
            condition = f"{local} not in (0, 1)" if most == 1 else f"not 0 <= {local} <= {most}"
            self.refuse_if(condition if when is None else f"({self.text(when, scope, AND)} and {condition})")
        scope.entries[part.name] = Entry(text, sized=False)

    # ---- data ---------------------------------------------------------------------------------------------

    def data_tasks(self, data: Data, scope: Scope, given: Given) -> list[Task]:
        filled = data.size if self.fills_up(data) and isinstance(data.size, Expression) else None
        tasks = [Task((data.name,), self.waits(data.when, filled), lambda _: self._data(data, scope, given))]
        if isinstance(data.size, Expression) and self.size_by_length(data) is None:
            waits = {data.name} | self.waits(data.size, data.when)
            tasks.append(Task((), waits, lambda _: self._data_size(data, scope, given)))
        return tasks

    def _data(self, data: Data, scope: Scope, given: Given) -> None:
        local = self.local(data.name, given)
        key = given.value(data.name) if data.pad is None else given.value_or(data.name, 'b""')
        if data.when is not None and data.pad is None:
            key = self.wanted(data.name, given)
        if data.when is None:
            given.needed += data.pad is None
            self.bind(local, key)
        else:
            self.add(f'{local} = {key} if {self.text(data.when, scope, OR)} else b""')
        if isinstance(data.size, (int, Expression)) or data.least or self.is_measured(data.name):
            self.no_bytes(local)
        if self.fills_up(data):
            self._fill_up(data, local, scope)
        if isinstance(data.size, int):
            self.refuse(data, scope, f"len({local}) != {data.size}")
        elif data.least:
            self.refuse(data, scope, f"len({local}) < {data.least}")
        scope.entries[data.name] = Entry(self.or_nothing(data.name, local, data.when, scope))

    def _fill_up(self, data: Data, local: str, scope: Scope) -> None:
        """Data that are too short get as long as they must be, before anybody asks for their length."""
        assert data.pad is not None and isinstance(data.size, (int, Expression))
        conditions = [] if data.when is None else [self.text(data.when, scope, AND)]
        size = str(data.size)
        if isinstance(data.size, Expression):
            conditions += self._is_announced(data.size, scope)
            size = self.bounded(data.size, scope)
        line = f"{local} = {local}.ljust({size}, {bytes_literal(bytes((data.pad,)))})"
        if conditions:
            with self.out.block(f"if {' and '.join(conditions)}:"):
                self.add(line)
        else:
            self.add(line)

    def is_measured(self, name: str) -> bool:
        """Whether something may depend on the length of data, beside their own size."""
        return bool(self.asked_for) or name in self.read_names

    def no_bytes(self, local: str) -> None:
        """Of what holds bytes otherwise bytes are made: its length may count something larger."""
        with self.out.block(f"if {self.is_other(local, 'bytes')} and {self.is_other(local, 'bytearray')}:"):
            self.add(f'{local} = b"" + {local}')

    def _data_size(self, data: Data, scope: Scope, given: Given) -> None:
        assert isinstance(data.size, Expression)
        self._sized_as_told(data, data.name, data.size, scope, given)

    def _sized_as_told(self, item: Field | Data, name: str, told: Expression, scope: Scope, given: Given) -> None:
        """A value must be as long as others say; one that is filled up may be shorter."""
        local, size = scope.entries[name].text, self.text(told, scope)
        is_text = isinstance(item, Field) and self.fills_up(item)
        found = f"max(len({local}), {size})" if is_text else f"len({local})"
        conditions = [] if item.when is None else [self.text(item.when, scope, AND)]
        conditions += self._is_announced(told, scope)
        self.compare_size((*given.path, name), found, size, conditions)

    def _is_announced(self, told: Expression, scope: Scope) -> list[str]:
        """Texts of the conditions that what a size goes by has been announced."""
        found = []
        for other in sorted(self.waits(told)):
            state = self.module.protocol.state.get(other)
            if state is not None and state.announced and scope.find(other) is None:
                found.append(f"{self.module.given(other)} is not None")
        return found
