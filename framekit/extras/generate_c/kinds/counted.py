"""Write `length` and `count` in C."""

from __future__ import annotations

from collections.abc import Callable

from framekit.codec.python import forms
from framekit.codec.python.encode_plan import Task
from framekit.codec.python.facts import comes_with, is_followed, is_plain_name, targets_of
from framekit.codec.python.function import wire_paths
from framekit.definition.expression import Expression
from framekit.definition.model.segments import Count, Data, Length, Repeat
from framekit.definition.problems import CannotSayError
from framekit.extras.generate_c.expressions import LEAST, MOST, Val
from framekit.extras.generate_c.functions import CKind
from framekit.extras.generate_c.kinds.numbers import (
    Awaited,
    fits,
    measure_number,
    put_number,
    store_number,
    wire_number,
)
from framekit.extras.generate_c.layout import CMember
from framekit.extras.generate_c.reader import Behind, Here, ReadWriter
from framekit.extras.generate_c.source import number
from framekit.extras.generate_c.writer import Taken, WriteWriter, both

# ---- read -----------------------------------------------------------------------------------------------------


def _read(r: ReadWriter, segment: Length | Count, here: Here, behind: Behind) -> None:
    scope, struct, _ = here
    member = struct.members[segment.name]
    refuse = r.refuse(segment)
    r.begin()
    wanted = _wanted_length(r, segment) if isinstance(segment, Length) else _wanted_count(r, segment, here)
    sure = segment.type.kind == "int" and segment.type.fixed_size is not None
    awaited = None if wanted is None else Awaited(r, segment, member, here, sure=sure)
    size = r.sized(segment.type.size, scope, "length", refuse)
    r.take(size, refuse)
    r.stands(segment.path)
    store_number(r, segment, here, r.read_number(segment.type, r.raw, size, segment))
    if awaited is None or wanted is None:
        return
    plus = f" + {number(segment.plus)}" if segment.plus else ""
    needed = segment.of if isinstance(segment, Length) else (segment.of,)
    awaited.compare("length", lambda: Val("number", f"({wanted()}{plus})"), *needed)


def _wanted_length(r: ReadWriter, length: Length) -> Callable[[], str] | None:
    if is_followed(length, r.segments):
        return None
    targets = targets_of(length, r.segments)
    targeted = (one for target in targets.values() for one in target.segments)
    if length.plain and any(isinstance(one, Data) and one.convert is not None for one in targeted):
        raise CannotSayError(length.at, "a length before conversion, compared with what is converted")
    room = r.file.helper("room")
    spans = [r.span(name) for name in wire_paths(r.segments, length.counted)]

    def text() -> str:
        total = " + ".join(f"{room}(&{span})" for span in spans if span is not None) or "0"
        return f"({total}) / {length.unit}" if length.unit != 1 else total

    return text


def _wanted_count(r: ReadWriter, count: Count, here: Here) -> Callable[[], str] | None:
    repeat = r.by_path.get(count.counted)
    there = comes_with(count.counted, count, r.segments)
    followed = isinstance(repeat, Repeat) and count.plus == 0 and is_plain_name(repeat.times, count.name)
    if not isinstance(repeat, Repeat) or (there and followed):
        return None
    member = here[1].members.get(count.of)
    if member is None:
        raise CannotSayError(count.at, "a count of a list that stands elsewhere")
    return lambda: f"(int64_t){here[2]}{member.cname}.count"


# ---- built ----------------------------------------------------------------------------------------------------


def _length_values(w: WriteWriter, segment: Length, taken: Taken) -> list[Task]:
    def write(missing: set[str]) -> None:
        member = taken.member(segment.name)
        local = w.local("int64_t", f"{segment.name}_value")
        text = _room_of(w, segment, taken)
        if segment.unit != 1:
            text = f"({text}) / {segment.unit}"
        if segment.plus:
            text = f"{text} + {number(segment.plus)}"
        w.add(f"{local} = {text};")
        _number_told(w, segment, member, local, taken)

    waits = w.waits(segment.when) | {name for name in segment.of if w.is_simple(segment.sibling_path(name))}
    return [Task((segment.name,), waits, write)]


def _number_told(w: WriteWriter, segment: Length | Count, member: CMember, local: str, taken: Taken) -> None:
    condition = w.condition(segment, taken)
    there = both(condition)
    limits = forms.value_range(segment)
    tests = [f"{local} < {number(max(limits.least or 0, LEAST))}"] if limits.least is not None else []
    tests += [f"{local} > {number(limits.most)}"] if limits.most is not None and limits.most <= MOST else []
    if tests:
        with w.block(f"if ({there}({' || '.join(tests)}))"):
            w.fail("range")
    w.when(
        f"{local} < {number(member.low)} || {local} > {number(min(member.high, MOST))}",
        f"{local} = {number(max(member.low, 0))};",
    )
    if segment.when is not None and member.has:
        w.fail_if(f"!{condition} && {taken.path}{member.flag}", "value")
    taken.scope.entries[segment.name] = Val("number", local, member.low, min(member.high, MOST), there=condition)


def _room_of(w: WriteWriter, length: Length, taken: Taken) -> str:
    """Return the text of the bytes that a length counts: computed immediately, or after they are assembled."""
    texts = []
    for path in length.counted:
        text = w.simple_room(path, taken, length.plain)
        if text is None:
            break
        texts.append(text)
    else:
        return " + ".join(texts) or "0"
    if length.plain:
        raise CannotSayError(length.at, "a length before conversion of what is put together in several ways")
    if w.in_list:
        raise CannotSayError(length.at, "a length in items of a list, of what is put together in several ways")
    room = w.file.helper("room")
    spans = [w.span(name) for name in wire_paths(w.segments, length.counted)]
    local = w.local("int64_t", f"{length.name}_room")
    w.lengths.append((local, lambda: " + ".join(f"{room}(&{one})" for one in spans if one is not None) or "0"))
    return local


def _count_values(w: WriteWriter, segment: Count, taken: Taken) -> list[Task]:
    def write(missing: set[str]) -> None:
        member, counted = taken.member(segment.name), taken.struct.members.get(segment.of)
        if counted is None:
            raise CannotSayError(segment.at, "a count of a list that stands elsewhere")
        local = w.local("int64_t", f"{segment.name}_value")
        text = f"(int64_t){taken.path}{counted.cname}.count"
        if counted.has:
            text = f"({taken.path}{counted.flag} ? {text} : 0)"
        w.add(f"{local} = {text}{f' + {number(segment.plus)}' if segment.plus else ''};")
        _number_told(w, segment, member, local, taken)

    return [Task((segment.name,), w.waits(segment.when), write)]


def _put(w: WriteWriter, segment: Length | Count, taken: Taken) -> None:
    type_ = segment.type
    local = taken.scope.entries[segment.name].text
    size = w.size_of(type_.size, taken)
    if isinstance(type_.size, Expression):
        fits(w, type_, local, size)
    put_number(w, type_, wire_number(segment, local), size, segment)


KINDS = (
    CKind(Length, read=_read, values=_length_values, put=_put, measure=measure_number),
    CKind(Count, read=_read, values=_count_values, put=_put, measure=measure_number),
)
