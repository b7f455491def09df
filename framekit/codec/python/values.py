"""Values for an encoder: what is given, what is computed, what must hold, in the order they depend on each other."""

from __future__ import annotations

from collections.abc import Iterable

from framekit.codec.python import forms
from framekit.codec.python.expressions import Entry, Scope, default_text
from framekit.codec.python.field_values import FieldValueWriter, Given
from framekit.codec.python.order import Task, run_in_order
from framekit.codec.python.reader import not_possible
from framekit.codec.python.source import Code, literal, quoted, text_source
from framekit.definition.expression.emit import AND, BIT_OR, COMPARE, OR, PRODUCT
from framekit.definition.expression.syntax import Expression
from framekit.definition.model.segments import (
    Bits,
    Choose,
    Count,
    Data,
    Field,
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
from framekit.definition.model.walk import flat


class ValueWriter(FieldValueWriter):
    """Writes the lines that bring the values of a frame into locals."""

    def values(self, segments: Iterable[Segment], scope: Scope, given: Given) -> None:
        """All values of a list of segments, also those in its wraps."""
        segments = tuple(segments)
        if given.in_cases is None and any(isinstance(segment, (Choose, Optional)) for segment in flat(segments)):
            given.in_cases = self.names.fresh("computed_in_cases"), self.names.fresh("elsewhere")
            self.add(f"{given.in_cases[0]}: dict[str, Any] = {{}}")
            self.add(f"{given.in_cases[1]}: tuple[str, ...] = ()")
        tasks: list[Task] = []
        with self.names_of(segments):
            for segment in segments:
                self.tasks_of(segment, scope, given, tasks)
            for task in tasks:
                task.waits_for.difference_update(task.gives)
            run_in_order(tasks)

    def check_names(self, given: Given) -> None:
        """What is given beyond what is needed must be known, or as computed."""
        check = self.module.function("check_given")
        computed = "{" + ", ".join(f"{quoted(name)}: {text}" for name, text in given.computed.items()) + "}"
        options = f", {text_source(*given.path)}" if given.path else ""
        absent = [f"() if {there} else {literal(names)}" for there, names in self.conditions_of(given)]
        if absent:
            options += f", absent={absent[0] if len(absent) == 1 else ' + '.join(f'({text})' for text in absent)}"
        if given.in_cases is not None:
            computed = f"{given.in_cases[0]} | {computed}" if given.computed else given.in_cases[0]
            options += f", elsewhere={given.in_cases[1]}"
        with self.out.block(f"if {self.more_than_needed(given)}:"):
            self.add(f"{check}({given.text}, {given.rules}, {computed}{options})")

    def more_than_needed(self, given: Given) -> str:
        """Text that tells whether there are values beyond those that anybody may give."""
        conditional = {name for _, names in self.conditions_of(given) for name in names}
        free = set(given.names) - set(given.computed) - conditional
        beyond = ""
        if given.in_cases is None and len(free) > given.needed:  # to ask for them takes half the time of the call
            beyond = f" and not {self.module.among(free, self.title)}({given.text})"
        return f"len({given.text}) != {given.needed}{beyond}"

    def conditions_of(self, given: Given) -> list[tuple[str, tuple[str, ...]]]:
        """Under what (a text) values are part of the frame, with their names."""
        found: dict[str, list[str]] = {}
        for segment, scope in given.conditional:
            assert segment.when is not None
            text = self.text(segment.when, scope, OR)
            for name in segment.value_names:
                found.setdefault(name, []).append(text)
            if isinstance(segment, Field) and segment.default is not None:  # a reader gives the default then
                default = default_text(self.text(segment.default, scope), segment)
                found[segment.name].append(f"{scope.entries[segment.name].text} == {default}")
        together: dict[str, list[str]] = {}
        for name, texts in found.items():
            together.setdefault(" or ".join(texts), []).append(name)
        return [(text, tuple(names)) for text, names in together.items()]

    def refuse_absent(self, given: Given) -> None:
        """In a case: what is given although the case leaves it out is refused as what belongs to another case."""
        for there, names in self.conditions_of(given):
            assert given.in_cases is not None
            with self.out.block(f"if not ({there}):"):
                nothing = f"if {given.text}.get(name) is not None"
                self.add(f"{given.in_cases[1]} += tuple(name for name in {literal(names)} {nothing})")

    def tasks_of(self, segment: Segment, scope: Scope, given: Given, tasks: list[Task]) -> None:
        given.names.extend(segment.value_names)
        if segment.when is not None and not isinstance(segment, Require):
            given.conditional.append((segment, scope))
        match segment:
            case Field():
                tasks.extend(self.field_tasks(segment, scope, given))
            case Bits(parts=parts):
                for part in parts:
                    tasks.append(self.bits_task(part, segment.when, scope, given))
                if segment.name is not None and segment.name in self.read_names:
                    scope.entries[segment.name] = Entry("0", sized=False, wire=self._own_room(segment, scope))
            case Data():
                tasks.extend(self.data_tasks(segment, scope, given))
            case Length() | Count():
                tasks.append(self._counted_task(segment, scope, given))
            case Value():
                tasks.extend(self._value_tasks(segment, scope, given))
            case Require(condition=condition):
                waits = self.waits(condition, segment.when)
                tasks.append(Task((), waits, lambda _: self._require(segment, condition, scope)))
            case Wrap(of=of):
                self.wrap_tasks(segment, of, scope, given, tasks)
            case Record() | Repeat() | Choose() | Optional() | Inner():
                tasks.extend(self.nested_tasks(segment, scope, given))

    def wrap_tasks(self, wrap: Wrap, of: tuple[Segment, ...], scope: Scope, given: Given, tasks: list[Task]) -> None:
        raise NotImplementedError

    def nested_tasks(self, segment: Segment, scope: Scope, given: Given) -> list[Task]:
        raise NotImplementedError

    def _own_room(self, segment: Length | Count | Bits, scope: Scope) -> str:
        """Text of the bytes of a number on the wire."""
        size = segment.type.size
        text = self.text(size, scope, PRODUCT + 1) if isinstance(size, Expression) else str(size)
        return self.if_present(segment, scope, text, "0")

    # ---- lengths, counts, values, conditions --------------------------------------------------------------

    def _counted_task(self, number: Length | Count, scope: Scope, given: Given) -> Task:
        if isinstance(number, Length):
            waits = {token for name in number.of for token in self.room_tokens(name)} | self._size_waits(number)
            return Task((number.name,), waits, lambda _: self._length(number, scope, given))
        waits = {number.of} | self._size_waits(number)
        return Task((number.name,), waits, lambda _: self._count(number, scope, given))

    def _size_waits(self, number: Length | Count) -> set[str]:
        """What has to be there before it can be told whether a number is there, and how many bytes it takes."""
        size = number.type.size
        return self.waits(number.when, size if isinstance(size, Expression) else None)

    def _length(self, length: Length, scope: Scope, given: Given) -> None:
        for name, target in self.targets.items():
            converted = any(isinstance(one, Data) and one.convert is not None for one in target.segments)
            if length.plain and name in length.of and target.only is None and converted:
                raise not_possible(length, f"'{name}' is not converted in every case", "count it as it is sent")
        text = self.room(length.of, scope, plain=length.plain)
        if length.unit != 1:
            text = f"{text} // {length.unit}" if " " not in text else f"({text}) // {length.unit}"
        self._number(length, text, scope, given)

    def _count(self, count: Count, scope: Scope, given: Given) -> None:
        items = scope.find(count.of)
        text = "()" if items is None else items.text
        self._number(count, self.count_of(text if text.isidentifier() else f"{text} or ()"), scope, given)

    def _number(self, number: Length | Count, text: str, scope: Scope, given: Given) -> None:
        local = self.names.fresh(number.name)
        plus = "" if not number.plus else f" + {number.plus}" if number.plus > 0 else f" - {-number.plus}"
        self.add(f"{local} = {text}{plus}")
        shown = self.or_nothing(number.name, local, number.when, scope)
        scope.entries[number.name] = Entry(shown, sized=False, wire=self._own_room(number, scope))
        given.computed[number.name] = local
        if number.limits is None and number.zero_means is None:
            self.refuse_digits(number, scope, local)
        else:
            limits = forms.value_range(number)
            path = *given.path, number.name
            found = "' is computed as ", Code(local), f", it must be {limits.least}..{limits.most}"
            condition = f"not {limits.least} <= {local} <= {limits.most}"
            if number.when is not None:
                condition = f"{self.text(number.when, scope, AND)} and {condition}"
            self.complain(condition, text_source(*path), text_source("'", *path, *found))

    def _value_tasks(self, value: Value, scope: Scope, given: Given) -> list[Task]:
        waits = self.waits(value.build or value.read, value.when)
        tasks = [Task((value.name,), waits, lambda missing: self._value(value, scope, given, missing), True)]
        tasks[0].prefer = value.build is None
        agree = self.waits(value.read) | {value.name}
        return [*tasks, Task((), agree, lambda _: self._agree(value, scope, given))]

    def _value(self, value: Value, scope: Scope, given: Given, missing: set[str]) -> None:
        local = self.names.fresh(value.name)
        if value.build is None and not missing:
            self.add(f"{local} = {self.if_there(self.writer(scope).value(value.read), value.when, scope)}")
            given.computed[value.name] = local
        else:
            text = self.writer(self.with_missing(scope, given, missing)).value(value.build or value.read)
            text = text if value.when is None else f"({self.if_there(text, value.when, scope)})"
            self.add(f"{local} = {given.value_or_worked_out(value.name, text)}")
        scope.entries[value.name] = Entry(local)

    def _agree(self, value: Value, scope: Scope, given: Given) -> None:
        """A value that was given or built must be what a reader will see."""
        local = scope.entries[value.name].text
        if given.computed.get(value.name) == local:
            return
        read = self.text(value.read, scope, BIT_OR)
        path = *given.path, value.name
        message = text_source("'", *path, "' does not agree with the other values")
        there = "" if value.when is None else f"{self.text(value.when, scope, AND)} and "
        self.complain(f"{there}{local} != {read}", text_source(*path), message)

    def _require(self, segment: Segment, condition: Expression, scope: Scope) -> None:
        text = self.writer(scope).negated(condition)
        if segment.when is not None:
            text = f"{self.text(segment.when, scope, COMPARE)} and {text}"
        self.complain(text, '"require"', quoted(f"it must hold that {condition}"))
