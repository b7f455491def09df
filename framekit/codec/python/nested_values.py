"""Values of segments with others inside, for an encoder: wraps, inner frames, lists, records, choices."""

from __future__ import annotations

from framekit.codec.python.expressions import Entry, Scope
from framekit.codec.python.field_values import Given
from framekit.codec.python.order import Task
from framekit.codec.python.rules import is_needed
from framekit.codec.python.shape import is_name, is_plain_name
from framekit.codec.python.source import quoted
from framekit.codec.python.values import ValueWriter
from framekit.definition.expression.emit import AND, BIT_OR, OR
from framekit.definition.expression.syntax import Binary, Expression, Number
from framekit.definition.model.segments import (
    Choose,
    Count,
    FieldType,
    Inner,
    Length,
    Optional,
    Record,
    Repeat,
    Segment,
    Wrap,
)
from framekit.definition.model.walk import everything, expressions_of, flat


class NestedValueWriter(ValueWriter):
    """Writes the lines that bring the values inside other segments into locals."""

    def wrap_tasks(self, wrap: Wrap, of: tuple[Segment, ...], scope: Scope, given: Given, tasks: list[Task]) -> None:
        before = len(tasks)
        for segment in of:
            self.tasks_of(segment, scope, given, tasks)
        if wrap.name in self.asked_for:
            waits = {name for task in tasks[before:] for name in task.gives}
            gives = (f"bytes of {wrap.name}",)
            tasks.append(Task(gives, waits, lambda _: self.put_into_local(wrap, scope)))

    def put_into_local(self, segment: Segment, scope: Scope) -> None:
        """Writes the bytes of a segment into a local of their own."""
        raise NotImplementedError

    def nested_tasks(self, segment: Segment, scope: Scope, given: Given) -> list[Task]:
        name = segment.name or ""
        outer = self._outer_names(segment)
        match segment:
            case Inner():
                return self._inner_tasks(segment, scope, given)
            case Record() if segment.when is None:
                return self._record_tasks(segment, outer, scope, given)
            case Record():
                both = (name, f"bytes of {name}")
                return [Task(both, outer, lambda _: self.conditional_record(segment, scope, given))]
            case Repeat():
                return self._list_tasks(segment, scope, given)
        inside = tuple(flat((segment,)))
        names = [inner for one in inside for inner in one.value_names]
        counted = [f"bytes of {one.name}" for one in inside if one.name in self.asked_for or one is segment]
        assert isinstance(segment, (Choose, Optional))
        return [Task((*names, *counted), outer, lambda _: self.branches(segment, scope, given))]

    def _inner_tasks(self, inner: Inner, scope: Scope, given: Given) -> list[Task]:
        name, waits = inner.name, self.waits(inner.when)
        tasks = [Task((name,), waits, lambda _: self._plain_given(inner, scope, given))]
        fixed = isinstance(inner.size, int) and any(self.shapes.frame(one).fixed != inner.size for one in inner.frames)
        if name in self.asked_for or isinstance(inner.size, Expression) or fixed:
            wire = (f"bytes of {name}",)
            tasks.append(Task(wire, waits | {name}, lambda _: self.put_into_local(inner, scope)))
        if isinstance(inner.size, Expression) or fixed:
            waits = waits | {f"bytes of {name}"}
            waits |= self.waits(inner.size) if isinstance(inner.size, Expression) else set()
            tasks.append(Task((), waits, lambda _: self._check_inner_size(inner, scope)))
        return tasks

    def _check_inner_size(self, inner: Inner, scope: Scope) -> None:
        """A frame inside must take as many bytes as other values say."""
        check, wire = self.module.function("check_size"), self.wires[inner.name]
        size = self.text(inner.size, scope) if isinstance(inner.size, Expression) else str(inner.size)
        line = f"{check}({quoted(inner.name)}, len({wire}), {size})"
        if inner.when is None:
            self.add(line)
        else:
            with self.out.block(f"if {self.text(inner.when, scope)}:"):
                self.add(line)

    def _record_tasks(self, record: Record, outer: set[str], scope: Scope, given: Given) -> list[Task]:
        name = record.name
        tasks = [Task((name,), outer, lambda _: self._record(record, scope, given))]
        if name in self.asked_for:
            tasks.append(Task((f"bytes of {name}",), {name}, lambda _: self.put_into_local(record, scope)))
        return tasks

    def _list_tasks(self, repeat: Repeat, scope: Scope, given: Given) -> list[Task]:
        name = repeat.name
        tasks = [Task((name,), self.waits(repeat.when), lambda _: self._list(repeat, scope, given))]
        if isinstance(repeat.of, tuple):
            gives = (f"items of {name}", f"bytes of {name}")
            waits = self._outer_names(repeat) | {name}
            tasks.append(Task(gives, waits, lambda _: self.records(repeat, scope, given)))
        if isinstance(repeat.times, Expression) and not self._is_counted(repeat):
            waits = self.waits(repeat.times, repeat.when) | {name}
            tasks.append(Task((), waits, lambda _: self._check_times(repeat, scope, given)))
        return tasks

    def _is_counted(self, repeat: Repeat) -> bool:
        """Whether a count or a length follows the list by itself."""
        here = [target.only for target in self.targets.values()]
        return any(isinstance(one, (Count, Length)) and _is_told_by(repeat, one) for one in here)

    def _outer_names(self, segment: Segment) -> set[str]:
        """What is read inside a segment but is not given there."""
        inside = {name for one in everything((segment,)) for name in one.value_names} - {segment.name}
        follow = {id(size) for one in everything((segment,)) if (size := self.size_by_length(one)) is not None}
        if isinstance(segment, Repeat):
            follow.add(id(segment.times))  # compared when the items are there; a length over them may give it
        read = self.waits(*(one for one in expressions_of(segment) if id(one) not in follow))
        own = {f"{what}{name}" for name in inside for what in ("", "items of ", "bytes of ")}
        return read - own

    def _plain_given(self, segment: Inner | Repeat, scope: Scope, given: Given) -> None:
        """A local for a value that has to be given."""
        local, key = self.local(segment.name, given), given.value(segment.name)
        if segment.when is not None:
            key = self.wanted(segment.name, given)
        if segment.when is None:
            given.needed += 1
            self.bind(local, key)
        else:
            empty = "()" if isinstance(segment, Repeat) else "None"
            self.add(f"{local} = {key} if {self.text(segment.when, scope, OR)} else {empty}")
        scope.entries[segment.name] = Entry(local, "list" if isinstance(segment, Repeat) else "inner", Scope())

    def _list(self, repeat: Repeat, scope: Scope, given: Given) -> None:
        self._plain_given(repeat, scope, given)
        local = scope.entries[repeat.name].text
        self.refuse_if(f"not isinstance({local}, (list, tuple))")
        if isinstance(repeat.of, FieldType) and self._is_asked_often(repeat):
            count = self.names.fresh(f"{repeat.name}_count")
            self.add(f"{count} = len({local})")
            self.counts[local] = count
        if isinstance(repeat.times, int):
            self.refuse(repeat, scope, f"{self.count_of(local)} != {repeat.times}")
        scope.entries[repeat.name].text = self.or_nothing(repeat.name, local, repeat.when, scope)

    def _is_asked_often(self, repeat: Repeat) -> bool:
        """Whether the number of a list's values is asked for before they are packed."""
        counts = (one for one in self.by_name.values() if isinstance(one, Count))
        return repeat.name in self.asked_for or any(one.of == repeat.name for one in counts)

    def _check_times(self, repeat: Repeat, scope: Scope, given: Given) -> None:
        """A list must have as many items as other values say."""
        assert isinstance(repeat.times, Expression)
        found = self.count_of(scope.entries[repeat.name].text)
        conditions = [] if repeat.when is None else [self.text(repeat.when, scope, AND)]
        conditions.append(f"{found} != {self.text(repeat.times, scope, BIT_OR)}")  # sooner than the call
        self.compare_size((*given.path, repeat.name), found, self.text(repeat.times, scope), conditions)

    def _record(self, record: Record, scope: Scope, given: Given) -> None:
        local = self.local(record.name, given)
        inner = Given(local, f"{given.rules}[{quoted(record.name)}].inside", (*given.path, f"{record.name}."))
        if is_needed(record.of):
            given.needed += 1
            self.bind(local, given.value(record.name))
        else:
            self.bind(local, given.value_or(record.name, "{}"))
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


def _is_told_by(repeat: Repeat, number: Count | Length) -> bool:
    """Whether the number of items is nothing but this count, or this length of the list divided by an item's size."""
    if number.plus or number.when is not None:
        return False
    if isinstance(number, Count):
        return number.of == repeat.name and is_plain_name(repeat.times, number.name)
    if number.of != (repeat.name,) or not isinstance(repeat.of, FieldType) or not isinstance(repeat.times, Expression):
        return False
    root, size = repeat.times.root, repeat.of.fixed_size
    if isinstance(root, Binary) and root.operator == "//" and isinstance(root.right, Number):
        return number.unit == 1 and is_name(root.left, number.name) and root.right.value == size
    return number.unit == size and is_name(root, number.name)
