"""Values for an encoder: what is given, what is computed, what must hold, in the order they depend on each other."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

from framekit.codec.python import forms
from framekit.codec.python.building import Building
from framekit.codec.python.expressions import Entry, Scope, constant_of
from framekit.codec.python.nested import default_text
from framekit.codec.python.order import Task, run_in_order
from framekit.codec.python.rules import is_needed
from framekit.codec.python.shape import (
    everything,
    flat,
    follows_its_length,
    is_plain_name,
    value_names,
)
from framekit.codec.python.source import literal, quoted
from framekit.definition.expression.emit import AND, BIT_OR, COMPARE, OR
from framekit.definition.expression.syntax import Bytes, Expression, Number, Text
from framekit.definition.model.segments import (
    Bits,
    BitsPart,
    Choose,
    Count,
    Data,
    Field,
    FieldType,
    Inner,
    Length,
    Optional,
    Record,
    Repeat,
    Require,
    Segment,
    Value,
    Wrap,
)
from framekit.definition.model.visit import expressions_of


@dataclass(slots=True)
class Given:
    """A mapping of values being used up: its text, how many have to be there, and what is computed beside them."""

    text: str
    rules: str
    path: str = ""
    needed: int = 0
    computed: dict[str, str] = field(default_factory=dict)


class ValueWriter(Building):
    """Writes the lines that bring the values of a frame into locals."""

    def values(self, segments: Iterable[Segment], scope: Scope, given: Given) -> None:
        """All values of a list of segments, also those in its wraps."""
        tasks: list[Task] = []
        for segment in segments:
            self._tasks_of(segment, scope, given, tasks)
        for task in tasks:
            task.waits_for.difference_update(task.gives)
        run_in_order(tasks)

    def check_names(self, given: Given) -> None:
        """What is given beyond what is needed must be known, or as computed."""
        check = self.module.function("check_given")
        computed = "{" + ", ".join(f"{quoted(name)}: {text}" for name, text in given.computed.items()) + "}"
        if self.grows and given.path == "":
            computed = f"computed | {computed}" if given.computed else "computed"
        path = f", {quoted(given.path)}" if given.path else ""
        with self.out.block(f"if len({given.text}) != {given.needed}:"):
            self.add(f"{check}({given.text}, {given.rules}, {computed}{path})")

    def _tasks_of(self, segment: Segment, scope: Scope, given: Given, tasks: list[Task]) -> None:
        match segment:
            case Field():
                tasks.extend(self._field_tasks(segment, scope, given))
            case Bits(parts=parts):
                for part in parts:
                    tasks.append(self._bits_task(part, scope, given))
                if segment.name is not None:
                    scope.entries[segment.name] = Entry("0", sized=False, wire=self._fixed_room(segment, scope))
            case Data():
                tasks.extend(self._data_tasks(segment, scope, given))
            case Length() | Count():
                tasks.append(self._counted_task(segment, scope, given))
            case Value():
                tasks.extend(self._value_tasks(segment, scope, given))
            case Require(condition=condition):
                waits = self.waits(condition, segment.when)
                tasks.append(Task((), waits, lambda _: self._require(segment, condition, scope)))
            case Wrap(of=of):
                self._wrap_tasks(segment, of, scope, given, tasks)
            case Record() | Repeat() | Choose() | Optional() | Inner():
                tasks.extend(self._nested_tasks(segment, scope, given))

    def _fixed_room(self, segment: Segment, scope: Scope) -> str:
        return self.if_present(segment, scope, str(self.shapes.present(segment).fixed), "0")

    # ---- fields -------------------------------------------------------------------------------------------

    def _field_tasks(self, item: Field, scope: Scope, given: Given) -> list[Task]:
        needed = item.build is None and item.default is None and item.is_ is None and item.constants is None
        waits = self.waits(item.is_ or item.build or item.default)
        if needed and item.when is not None:
            waits |= self.waits(item.when)
        may_be_given = not needed and item.is_ is None
        first = Task((item.name,), waits, lambda missing: self._field(item, scope, given, needed, missing), may_be_given)
        if item.is_ is not None or (item.constants is not None and len(item.constants) == 1):
            return [first]
        waits = self.waits(item.when) | {item.name}
        return [first, Task((), waits, lambda _: self._judge(item, scope, scope.entries[item.name].text))]

    def _field(self, item: Field, scope: Scope, given: Given, needed: bool, missing: set[str]) -> None:
        local = self.names.fresh(item.name)
        sized = item.type.kind in ("ascii", "bytes")
        entry = Entry(local, sized=sized, wire=None)
        if item.constants is not None and len(item.constants) == 1:
            entry.text = literal(item.constants[0])
            given.computed[item.name] = entry.text
        elif item.is_ is not None:
            entry.text = self._computed(item.name, item.is_, local, scope, given)
        else:
            self.add(f"{local} = {self._given(item, scope, given, needed, missing)}")
            if item.values is not None:
                numbers = self.module.numbers(item.values, f"{self.title} {item.name}")
                self.add(f"{local} = {numbers}.get({local}, {local})")
        scope.entries[item.name] = entry
        if not sized and item.when is None:
            entry.wire = self.room((item.name,), scope)

    def _computed(self, name: str, expression: Expression, local: str, scope: Scope, given: Given) -> str:
        number = constant_of(expression)
        if number is None:
            self.add(f"{local} = {self.writer(scope).value(expression)}")
        text = local if number is None else str(number)
        given.computed[name] = text
        return text

    def _given(self, item: Field, scope: Scope, given: Given, needed: bool, missing: set[str]) -> str:
        """Text of a value that is given, or built, or has a default."""
        key = f"{given.text}[{quoted(item.name)}]"
        if needed:
            if item.when is None:
                given.needed += 1
                return key
            return f"{key} if {self.text(item.when, scope, OR)} else None"
        if item.constants is not None:
            return f"{given.text}.get({quoted(item.name)}, {literal(item.constants[0])})"
        expression = item.build or item.default
        assert expression is not None
        with_missing = self._with_missing(scope, given, missing)
        text = default_text(self.writer(with_missing).value(expression), item)
        if isinstance(expression.root, (Number, Text, Bytes)):
            return f"{given.text}.get({quoted(item.name)}, {text})"
        return f"{key} if {quoted(item.name)} in {given.text} else {self.writer(with_missing).value(expression)}"

    @staticmethod
    def _with_missing(scope: Scope, given: Given, missing: set[str]) -> Scope:
        """A scope in which names that are not worked out yet are those given."""
        inner = Scope(scope)
        inner.entries = {name: Entry(f"{given.text}[{quoted(name)}]") for name in missing}
        return inner

    def _judge(self, item: Field, scope: Scope, local: str) -> None:
        """What must hold for a value that was given or built."""
        if item.values is not None and item.only and item.constants is None:
            self._refuse(item, scope, f"{local} not in {self.module.value_names(item.values, item.name)}")
        if item.constants is not None:
            self._refuse_others(item.name, local, item.constants)
        limits = forms.value_range(item)
        by_type = item.type.kind == "int" and item.limits is None and item.zero_means is None and item.long is None
        if item.type.kind in ("ascii", "bytes"):
            self._judge_text(item, scope, local)
        elif not by_type and item.type.kind != "float":
            self._judge_range(item, scope, local, limits)
        if item.unit is not None and item.unit != 1:
            self._refuse(item, scope, f"{local} % {item.unit:_}")

    def _judge_range(self, item: Segment, scope: Scope, local: str, limits: forms.Range) -> None:
        if limits.least is not None and limits.most is not None:
            self._refuse(item, scope, f"not {limits.least} <= {local} <= {limits.most}")
        elif limits.least is not None:
            self._refuse(item, scope, f"{local} < {limits.least}")

    def _judge_text(self, item: Field, scope: Scope, local: str) -> None:
        size = item.type.size
        if isinstance(size, int):
            exact = item.type.kind == "bytes" or (item.type.pad is None and item.type.end is None)
            self._refuse(item, scope, f"len({local}) {'!=' if exact else '>'} {size}")

    def _refuse(self, item: Segment, scope: Scope, condition: str) -> None:
        if item.when is not None:
            condition = f"({self.text(item.when, scope, AND)} and {condition})"
        self.refuse_if(condition)

    def _refuse_others(self, name: str, local: str, constants: tuple[int | str | bytes, ...]) -> None:
        shown = ", ".join(repr(constant) for constant in constants)
        with self.out.block(f"if {local} not in {literal(constants)}:"):
            message = f"'{name}' is one of {shown}, not {{{local}!r}}".replace('"', "'")
            self.add(f'raise EncodeError({quoted(name)}, f"{message}")')

    def _bits_task(self, part: BitsPart, scope: Scope, given: Given) -> Task:
        return Task(
            (part.name,),
            self.waits(part.is_ or part.build),
            lambda missing: self._bits(part, scope, given, missing),
            part.is_ is None,
        )

    def _bits(self, part: BitsPart, scope: Scope, given: Given, missing: set[str]) -> None:
        local = self.names.fresh(part.name)
        key, name = f"{given.text}[{quoted(part.name)}]", quoted(part.name)
        text = local
        if part.constants is not None and len(part.constants) == 1:
            text = given.computed[part.name] = str(part.constants[0])
        elif part.is_ is not None:
            text = self._computed(part.name, part.is_, local, scope, given)
        elif part.build is not None and not isinstance(part.build.root, Number):
            build = self.writer(self._with_missing(scope, given, missing)).value(part.build)
            self.add(f"{local} = {key} if {name} in {given.text} else {build}")
        else:
            first = 0 if part.constants is None else part.constants[0]
            otherwise = first if part.build is None else self.writer(scope).text(part.build)
            self.add(f"{local} = {given.text}.get({name}, {otherwise})")
        if text == local and part.is_ is None:
            if part.values is not None:
                numbers = self.module.numbers(part.values, f"{self.title} {part.name}")
                self.add(f"{local} = {numbers}.get({local}, {local})")
            if part.constants is not None:
                self._refuse_others(part.name, local, part.constants)
        if text == local:
            most = (1 << part.high - part.low + 1) - 1
            self.refuse_if(f"{local} not in (0, 1)" if most == 1 else f"not 0 <= {local} <= {most}")
        scope.entries[part.name] = Entry(text, sized=False)

    # ---- data ---------------------------------------------------------------------------------------------

    def _data_tasks(self, data: Data, scope: Scope, given: Given) -> list[Task]:
        tasks = [Task((data.name,), self.waits(data.when), lambda _: self._data(data, scope, given))]
        if isinstance(data.size, Expression) and not self._sized_by_length(data):
            waits = {data.name} | self.waits(data.size, data.when)
            tasks.append(Task((), waits, lambda _: self._data_size(data, scope, given)))
        return tasks

    def _sized_by_length(self, segment: Data | Field) -> bool:
        return any(isinstance(one, Length) and follows_its_length(one, segment) for one in self.by_name.values())

    def _data(self, data: Data, scope: Scope, given: Given) -> None:
        local = self.names.fresh(data.name)
        key = f"{given.text}[{quoted(data.name)}]"
        if data.when is None:
            given.needed += 1
            self.add(f"{local} = {key}")
        else:
            self.add(f'{local} = {key} if {self.text(data.when, scope, OR)} else b""')
        if isinstance(data.size, int):
            self._refuse(data, scope, f"len({local}) {'!=' if data.pad is None else '>'} {data.size}")
        if data.least and (not isinstance(data.size, int) or data.pad is not None):
            self._refuse(data, scope, f"len({local}) < {data.least}")
        scope.entries[data.name] = Entry(local)

    def _data_size(self, data: Data, scope: Scope, given: Given) -> None:
        assert isinstance(data.size, Expression)
        local = scope.entries[data.name].text
        size = self.text(data.size, scope)
        found = f"len({local})" if data.pad is None else f"min(len({local}), {size})"
        line = f"{self.module.function('check_size')}({quoted(given.path + data.name)}, {found}, {size})"
        conditions = [] if data.when is None else [self.text(data.when, scope, AND)]
        for name in sorted(self.waits(data.size)):
            state = self.module.protocol.state.get(name)
            if state is not None and state.announced and scope.find(name) is None:
                conditions.append(f"{self.module.given(name)} is not None")
        if conditions:
            with self.out.block(f"if {' and '.join(conditions)}:"):
                self.add(line)
        else:
            self.add(line)

    # ---- lengths, counts, values, conditions --------------------------------------------------------------

    def _counted_task(self, number: Length | Count, scope: Scope, given: Given) -> Task:
        if isinstance(number, Length):
            waits = {token for name in number.of for token in self.room_tokens(name)}
            return Task((number.name,), waits, lambda _: self._length(number, scope, given))
        return Task((number.name,), {number.of}, lambda _: self._count(number, scope, given))

    def _length(self, length: Length, scope: Scope, given: Given) -> None:
        text = self.room(length.of, scope, plain=length.plain)
        if length.unit != 1:
            text = f"{text} // {length.unit}" if " " not in text else f"({text}) // {length.unit}"
        self._number(length, text, scope, given)

    def _count(self, count: Count, scope: Scope, given: Given) -> None:
        items = scope.find(count.of)
        self._number(count, f"len({'()' if items is None else items.text})", scope, given)

    def _number(self, number: Length | Count, text: str, scope: Scope, given: Given) -> None:
        local = self.names.fresh(number.name)
        plus = "" if not number.plus else f" + {number.plus}" if number.plus > 0 else f" - {-number.plus}"
        self.add(f"{local} = {text}{plus}")
        scope.entries[number.name] = Entry(local, sized=False, wire=self._fixed_room(number, scope))
        given.computed[number.name] = local
        if number.limits is not None or number.zero_means is not None:
            self._judge_range(number, scope, local, forms.value_range(number))

    def _value_tasks(self, value: Value, scope: Scope, given: Given) -> list[Task]:
        waits = self.waits(value.build or value.read)
        tasks = [Task((value.name,), waits, lambda missing: self._value(value, scope, given, missing), True)]
        tasks[0].prefer = value.build is None
        agree = self.waits(value.read) | {value.name}
        return [*tasks, Task((), agree, lambda _: self._agree(value, scope, given))]

    def _value(self, value: Value, scope: Scope, given: Given, missing: set[str]) -> None:
        local = self.names.fresh(value.name)
        key, name = f"{given.text}[{quoted(value.name)}]", quoted(value.name)
        if value.build is None and not missing:
            self.add(f"{local} = {self.writer(scope).value(value.read)}")
            given.computed[value.name] = local
        else:
            text = self.writer(self._with_missing(scope, given, missing)).value(value.build or value.read)
            self.add(f"{local} = {key} if {name} in {given.text} else {text}")
        scope.entries[value.name] = Entry(local)

    def _agree(self, value: Value, scope: Scope, given: Given) -> None:
        """A value that was given or built must be what a reader will see."""
        local = scope.entries[value.name].text
        if given.computed.get(value.name) == local:
            return
        read = self.text(value.read, scope, BIT_OR)
        with self.out.block(f"if {local} != {read if ' if ' not in read else f'({read})'}:"):
            message = f"'{given.path}{value.name}' does not agree with the other values"
            self.add(f"raise EncodeError({quoted(given.path + value.name)}, {quoted(message)})")

    def _require(self, segment: Segment, condition: Expression, scope: Scope) -> None:
        text = self.writer(scope).negated(condition)
        if segment.when is not None:
            text = f"{self.text(segment.when, scope, COMPARE)} and {text}"
        with self.out.block(f"if {text}:"):
            self.add(f'raise EncodeError("", {quoted(f"it must hold that {condition}")})')

    # ---- segments with others inside ----------------------------------------------------------------------

    def _wrap_tasks(
        self, wrap: Wrap, of: tuple[Segment, ...], scope: Scope, given: Given, tasks: list[Task]
    ) -> None:
        before = len(tasks)
        for segment in of:
            self._tasks_of(segment, scope, given, tasks)
        if wrap.name in self.asked_for:
            waits = {name for task in tasks[before:] for name in task.gives}
            gives = (f"bytes of {wrap.name}",)
            tasks.append(Task(gives, waits, lambda _: self.put_into_local(wrap, scope)))

    def put_into_local(self, segment: Segment, scope: Scope) -> None:
        """Writes the bytes of a segment into a local of their own."""
        raise NotImplementedError

    def _nested_tasks(self, segment: Segment, scope: Scope, given: Given) -> list[Task]:
        name = segment.name or ""
        outer = self._outer_names(segment)
        match segment:
            case Inner():
                tasks = [Task((name,), self.waits(segment.when), lambda _: self._plain_given(segment, scope, given))]
                if name in self.asked_for or isinstance(segment.size, Expression):
                    waits = {name} | self.waits(segment.when)
                    tasks.append(Task((f"bytes of {name}",), waits, lambda _: self.put_into_local(segment, scope)))
                return tasks
            case Record() if segment.when is None:
                tasks = [Task((name,), outer, lambda _: self._record(segment, scope, given))]
                if name in self.asked_for:
                    gives = (f"bytes of {name}",)
                    tasks.append(Task(gives, {name}, lambda _: self.put_into_local(segment, scope)))
                return tasks
            case Record():
                gives = (name, f"bytes of {name}")
                return [Task(gives, outer, lambda _: self.conditional_record(segment, scope, given))]
            case Repeat():
                return self._list_tasks(segment, scope, given)
        names = tuple(inner for one in flat((segment,)) for inner in value_names(one))
        assert isinstance(segment, (Choose, Optional))
        gives = (*names, f"bytes of {name}")
        return [Task(gives, outer, lambda _: self.branches(segment, scope, given))]

    def _list_tasks(self, repeat: Repeat, scope: Scope, given: Given) -> list[Task]:
        name = repeat.name
        tasks = [Task((name,), self.waits(repeat.when), lambda _: self._list(repeat, scope, given))]
        if isinstance(repeat.of, tuple):
            gives = (f"items of {name}", f"bytes of {name}")
            waits = self._outer_names(repeat) | {name}
            tasks.append(Task(gives, waits, lambda _: self.records(repeat, scope, given)))
        if isinstance(repeat.times, Expression) and not self._has_count(repeat):
            waits = self.waits(repeat.times, repeat.when) | {name}
            tasks.append(Task((), waits, lambda _: self._check_times(repeat, scope, given)))
        return tasks

    def _has_count(self, repeat: Repeat) -> bool:
        """Whether a count follows the list by itself."""
        return any(
            isinstance(one, Count) and one.of == repeat.name and not one.plus and is_plain_name(repeat.times, one.name)
            for one in self.by_name.values()
        )

    def _outer_names(self, segment: Segment) -> set[str]:
        """What is read inside a segment but is not given there."""
        inside = {name for one in everything((segment,)) for name in value_names(one)} - {segment.name}
        read = self.waits(*expressions_of(segment))
        own = {f"{what}{name}" for name in inside for what in ("", "items of ", "bytes of ")}
        return read - own

    def _plain_given(self, segment: Inner | Repeat, scope: Scope, given: Given) -> str:
        """A local for a value that has to be given."""
        local = self.names.fresh(segment.name)
        key = f"{given.text}[{quoted(segment.name)}]"
        if segment.when is None:
            given.needed += 1
            self.add(f"{local} = {key}")
        else:
            empty = "()" if isinstance(segment, Repeat) else "None"
            self.add(f"{local} = {key} if {self.text(segment.when, scope, OR)} else {empty}")
        scope.entries[segment.name] = Entry(local, "list" if isinstance(segment, Repeat) else "inner", Scope())
        return local

    def _list(self, repeat: Repeat, scope: Scope, given: Given) -> None:
        local = self._plain_given(repeat, scope, given)
        if isinstance(repeat.times, int):
            self._refuse(repeat, scope, f"len({local}) != {repeat.times}")

    def _check_times(self, repeat: Repeat, scope: Scope, given: Given) -> None:
        """A list must have as many items as other values say."""
        assert isinstance(repeat.times, Expression)
        check, name = self.module.function("check_size"), quoted(given.path + repeat.name)
        line = f"{check}({name}, len({scope.entries[repeat.name].text}), {self.text(repeat.times, scope)})"
        if repeat.when is None:
            self.add(line)
        else:
            with self.out.block(f"if {self.text(repeat.when, scope)}:"):
                self.add(line)

    def _record(self, record: Record, scope: Scope, given: Given) -> None:
        local = self.names.fresh(record.name)
        inner = Given(local, f"{given.rules}[{quoted(record.name)}].inside", f"{given.path}{record.name}.")
        if is_needed(record.of):
            given.needed += 1
            self.add(f"{local} = {given.text}[{quoted(record.name)}]")
        else:
            self.add(f"{local} = {given.text}.get({quoted(record.name)}, {{}})")
        inside = Scope(scope)
        scope.entries[record.name] = Entry(local, "record", inside, direct=True)
        self.values(record.of, inside, inner)
        self.check_names(inner)

    def conditional_record(self, record: Record, scope: Scope, given: Given) -> None:
        raise NotImplementedError

    def records(self, repeat: Repeat, scope: Scope, given: Given) -> None:
        raise NotImplementedError

    def branches(self, segment: Choose | Optional, scope: Scope, given: Given) -> None:
        raise NotImplementedError
