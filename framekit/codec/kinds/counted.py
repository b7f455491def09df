"""Implement `length` and `count`: numbers that state the size of other segments."""

from __future__ import annotations

from typing import TypeVar

from framekit.codec.kinds.base import TypedValueKind
from framekit.codec.python import forms
from framekit.codec.python.diagnosis import Behind, DiagnosisWriter
from framekit.codec.python.encode import ConsumedValues, EncodeWriter
from framekit.codec.python.encode_plan import Lengths, Rules, RuleWriter, Task
from framekit.codec.python.expressions import FieldScope, NameEntry
from framekit.codec.python.facts import comes_with, is_followed, is_plain_name, targets_of
from framekit.codec.python.function import FunctionWriter, wire_paths
from framekit.codec.python.reader import BufferReader, Comparison, ScopedSegment, not_possible
from framekit.codec.python.registry import type_text
from framekit.codec.python.source import Code, literal, quoted, text_source
from framekit.definition.model.segments import Count, Data, Length, Repeat

C = TypeVar("C", Length, Count)


class CountedKind(TypedValueKind[C]):
    """Read a number that must agree with the counted segments; each kind defines which quantity it counts."""

    def compare(self, r: BufferReader, item: ScopedSegment, segment: C) -> None:
        """Defer the comparison of the number with the counted segments until these are read."""
        raise NotImplementedError

    def wanted(self, d: DiagnosisWriter, segment: C) -> str | None:
        """Return the source of the expected number, or None if no disagreement is possible."""
        raise NotImplementedError

    def must_hold(self, r: BufferReader, item: ScopedSegment, segment: C, local: str) -> None:
        r.validate_limits(segment, local)
        self.compare(r, item, segment)

    def read(self, r: BufferReader, item: ScopedSegment, segment: C, after: tuple[ScopedSegment, ...]) -> None:
        """Write the reading of a number whose size is an expression."""
        local = r.function.local(segment.name, item.scope)
        r.function.add(f"{local} = {forms.value_of(segment, r.sized_number(item, segment))}")
        r.declare(item, segment.name, local, sized=False, wire=r.function.wire_size(segment.path))
        self.must_hold(r, item, segment, local)

    def diagnose(self, d: DiagnosisWriter, segment: C, scope: FieldScope, behind: Behind) -> None:
        _diagnose(d, segment, scope, self.wanted(d, segment))

    def rules(self, w: RuleWriter, segment: C, always: bool, lengths: Lengths) -> Rules:
        yield segment.name, w.rule("number", forms.value_range(segment), False)


class LengthKind(CountedKind[Length]):
    model = Length
    may_be_absent = True

    def compare(self, r: BufferReader, item: ScopedSegment, segment: Length) -> None:
        """Defer the comparison of a length with the bytes it counts, unless their size follows from the length."""
        function = r.function
        if is_followed(segment, function.segments):
            return
        targets = targets_of(segment, function.segments)
        local = item.scope.entries[segment.name].text
        parts = [part for path in targets for part in function.wire_parts.get(path, (path,))]

        def compare() -> None:
            total = function.room(targets, plain=segment.plain)
            if segment.unit != 1:
                total = f"{total} // {segment.unit}" if total.isalnum() else f"({total}) // {segment.unit}"
            function.mismatch_if(f"{local} != {total}{forms.plus_text(segment.plus)}")

        r.deferred.append(Comparison(compare, lambda: all(part in function.bounds for part in parts)))

    def wanted(self, d: DiagnosisWriter, segment: Length) -> str | None:
        return _room_of(d, segment)

    def tasks(self, w: EncodeWriter, segment: Length, scope: FieldScope, given: ConsumedValues) -> list[Task]:
        waits = {token for path in segment.counted for token in w.room_tokens(path)} | w.size_waits(segment)
        return [Task((segment.name,), waits, lambda _: _put_length(w, segment, scope, given))]

    def describe(self, segment: Length) -> str:
        counted = ", ".join(name for name in segment.of if not name.startswith("_")) or "what follows"
        return f"{segment.name} {type_text(segment.type)} = length of {counted}"


def _put_length(w: EncodeWriter, length: Length, scope: FieldScope, given: ConsumedValues) -> None:
    counted = [w.targets[path] for path in length.counted if path in w.targets] if length.plain else []
    for target in counted:
        converted = any(isinstance(one, Data) and one.convert is not None for one in target.segments)
        if target.only is None and converted:
            raise not_possible(
                length, f"'{target.segments[0].name}' is not converted in every case", "count it as it is sent"
            )
    text = w.room(length.counted, scope, plain=length.plain)
    if length.unit != 1:
        text = f"{text} // {length.unit}" if " " not in text else f"({text}) // {length.unit}"
    _put_number(w, length, text, scope, given)


def counted_room(d: DiagnosisWriter, length: Length) -> tuple[list[str], dict[str, str]] | None:
    """Return the segments that a length counts, or None if no disagreement is possible.

    The result is the paths of segments that take bytes, and the names of values that are counted before conversion,
    each with the source to append if the value may be absent.
    """
    if is_followed(length, d.segments):
        return None
    targets = targets_of(length, d.segments)
    converted = {
        path: "" if target.only is not None and target.only.when is None else " or ()"
        for path, target in targets.items()
        if length.plain and any(isinstance(one, Data) and one.convert is not None for one in target.segments)
    }
    whole = wire_paths(d.segments, [path for path in length.counted if path not in converted])
    return whole, {targets[path].segments[0].name or "": text for path, text in converted.items()}


def _room_of(d: DiagnosisWriter, length: Length) -> str | None:
    """Return the source of the expected length, or None if no disagreement is possible."""
    found = counted_room(d, length)
    if found is None:
        return None
    paths, converted = found
    rooms = [quoted(path) for path in paths]
    parts = [f"n.room({', '.join(rooms)})"] if rooms else []
    parts += [f"len(n[{quoted(name)}]{otherwise})" for name, otherwise in converted.items()]
    total = " + ".join(parts) or "0"
    if length.unit != 1:
        total = f"({total}) // {length.unit}" if len(parts) > 1 else f"{total} // {length.unit}"
    return total


class CountKind(CountedKind[Count]):
    model = Count
    may_be_absent = True

    def compare(self, r: BufferReader, item: ScopedSegment, segment: Count) -> None:
        """Defer the comparison of a count with its list, unless the number of items follows from the count."""
        absent = absent_behind(segment, r.function)
        if absent is None:
            return
        local, plus = item.scope.entries[segment.name].text, forms.plus_text(segment.plus)

        def compare() -> None:
            items = item.scope.find(segment.of)
            if items is not None:
                r.function.mismatch_if(f"{local} != len({items.text}{absent}){plus}")

        r.deferred.append(Comparison(compare, lambda: item.scope.find(segment.of) is not None))

    def wanted(self, d: DiagnosisWriter, segment: Count) -> str | None:
        absent = absent_behind(segment, d)
        return None if absent is None else f"len(n[{quoted(segment.of)}]{absent})"

    def tasks(self, w: EncodeWriter, segment: Count, scope: FieldScope, given: ConsumedValues) -> list[Task]:
        waits = {segment.of} | w.size_waits(segment)
        return [Task((segment.name,), waits, lambda _: _put_count(w, segment, scope, given))]

    def describe(self, segment: Count) -> str:
        return f"{segment.name} {type_text(segment.type)} = number of {segment.of}"


def _put_count(w: EncodeWriter, count: Count, scope: FieldScope, given: ConsumedValues) -> None:
    items = scope.find(count.of)  # None: the list is part of a case or an `optional`
    text = f"{given.text}.get({quoted(count.of)})" if items is None else items.text
    _put_number(w, count, w.count_of(text if text.isidentifier() else f"{text} or ()"), scope, given)


def _put_number(w: EncodeWriter, number: Length | Count, text: str, scope: FieldScope, given: ConsumedValues) -> None:
    local = w.names.fresh(number.name)
    w.add(f"{local} = {text}{forms.plus_text(number.plus)}")
    shown = w.or_nothing(number.name, local, number.when, scope)
    scope.entries[number.name] = NameEntry(shown, sized=False, wire=w.own_room(number, scope))
    given.computed[number.name] = local
    if number.limits is None and number.zero_means is None:
        w.refuse_digits(number, scope, local)
    else:
        limits = forms.value_range(number)
        path = *given.path, number.name
        allowed = f"at least {limits.least}" if limits.most is None else f"{limits.least}..{limits.most}"
        found = "' is computed as ", Code(local), f", it must be {allowed}"
        condition = f"{local} < {limits.least}"
        if limits.most is not None:
            condition = f"not {limits.least} <= {local} <= {limits.most}"
        w.complain_where(number.when, scope, condition, text_source(*path), text_source("'", *path, *found))


def absent_behind(count: Count, writer: FunctionWriter) -> str | None:
    """Return the source to append to a counted list that may be absent ('' if always present).

    None if no disagreement is possible.
    """
    repeat = writer.by_path.get(count.counted)
    there = comes_with(count.counted, count, writer.segments)
    followed = isinstance(repeat, Repeat) and count.plus == 0 and is_plain_name(repeat.times, count.name)
    if not isinstance(repeat, Repeat) or (there and followed):
        return None
    return "" if there else " or ()"


def _diagnose(d: DiagnosisWriter, segment: Length | Count, scope: FieldScope, wanted: str | None) -> None:
    limits = "" if segment.limits is None else f", limits={literal(segment.limits)}"
    name = quoted(segment.name)
    size = d.ask(segment.type.size if segment.type.size is not None else 0, scope)
    d.out.add(f"n.field({name}, {size}, {d.parse(segment.type, segment)}{d.refuse(segment)}{limits})")
    if wanted is not None:
        plus = forms.plus_text(segment.plus)
        counted = segment.of if isinstance(segment, Length) else (segment.of,)
        d.later(f'n.same("length", {name}, lambda n: {wanted}{plus}{d.refuse(segment)})', segment, *counted)
