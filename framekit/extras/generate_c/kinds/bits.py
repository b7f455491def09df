"""Write `bits` in C."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from framekit.codec.python.encode_plan import Task
from framekit.codec.python.expressions import constant_of
from framekit.definition.expression import Expression
from framekit.definition.model.segments import Bits, BitsPart
from framekit.extras.generate_c.expressions import Val
from framekit.extras.generate_c.functions import CKind
from framekit.extras.generate_c.kinds.numbers import Awaited, among, if_number, measure_number, put_number
from framekit.extras.generate_c.reader import Behind, Here, ReadWriter
from framekit.extras.generate_c.source import number
from framekit.extras.generate_c.writer import Taken, WriteWriter

# ---- read -----------------------------------------------------------------------------------------------------


def _read(r: ReadWriter, segment: Bits, here: Here, behind: Behind) -> None:
    scope, struct, path = here
    refuse = r.refuse(segment)
    r.begin()
    later = [one for one in segment.parts if one.constants is None and one.is_ and constant_of(one.is_) is None]
    awaited = [(Awaited(r, segment, struct.members[one.name], here), one.is_) for one in later]
    size = r.sized(segment.type.size, scope, "length", refuse)
    r.take(size, refuse)
    r.stands(segment.path)
    for part in segment.parts:
        r.stands(segment.sibling_path(part.name))
    whole = r.local("uint64_t", "bits")
    wire, failing = r.read_number(segment.type, r.raw, size, segment)

    with if_number(r, segment, failing, f"{r.inn}.from"):
        if not failing:
            r.add(f"{whole} = (uint64_t){wire};")
        for part in segment.parts:
            member = struct.members[part.name]
            target = f"{path}{member.cname}"
            mask = number((1 << part.high - part.low + 1) - 1)
            source = whole if not failing else wire
            shifted = f"{source} >> {part.low}" if part.low else source
            r.add(f"{target} = ({member.ctype})({shifted} & {mask});")
            r.is_there(member, here, sure=not failing)
            among(r, segment, part, member, target, f"{r.inn}.from")
    for one, wanted in awaited:
        assert wanted is not None
        one.compare("value", partial(r.writer(scope).value, wanted), wanted)


# ---- built ----------------------------------------------------------------------------------------------------


def _values(w: WriteWriter, segment: Bits, taken: Taken) -> list[Task]:
    return [_part(w, part, segment.when, taken) for part in segment.parts]


def _part(w: WriteWriter, part: BitsPart, when: Expression | None, taken: Taken) -> Task:
    worked_out = part.is_ or part.build
    asked = part.name in w.asked_by_name or worked_out is not None

    def write(missing: set[str]) -> None:
        member = taken.member(part.name)
        local = w.local("int64_t", f"{part.name}_value")
        source = w.with_missing(taken)
        condition = w.holds(when, taken) if when is not None and asked else ""
        flag = w.given_flag(member, taken)
        given = f"(int64_t){taken.path}{member.cname}"
        if part.constants is not None and len(part.constants) == 1:
            w.add(f"{local} = {number(part.constants[0])};")
        elif part.is_ is not None:
            value = w.number(part.is_, source.scope)
            w.keep(local, f"{condition} ? {value.text} : 0" if condition else value.text)
        elif part.build is not None and not w.can_say(part.build, source, part.name):
            w.add(f"{local} = {given};")
            w.fail_if(f"{condition} && !{flag}" if condition else f"!{flag}", "value")
        elif part.build is not None:
            value = w.number(part.build, source.scope)
            text = f"{condition} ? {value.text} : 0" if condition else value.text
            w.when(flag, f"{local} = {given};")
            with w.block("else"):
                w.keep(local, text)
        else:
            first = 0 if part.constants is None else part.constants[0]
            w.add(f"{local} = {given};" if flag == "true" else f"{local} = {flag} ? {given} : {number(first)};")
            if part.constants is not None:
                tests = " && ".join(f"{local} != {number(one)}" for one in part.constants)
                w.fail_if(f"{condition} && {tests}" if condition else tests, "value")
        most = (1 << part.high - part.low + 1) - 1
        with w.block(f"if ({local} < 0 || {local} > {number(most)})"):
            w.fail("range")
            w.add(f"{local} = 0;")
        if when is not None:
            own = condition or w.holds(when, taken)
            w.fail_if(f"!{own} && {taken.path}{member.flag}", "value")
        taken.scope.entries[part.name] = Val("number", local, 0, most, there=condition)

    waits = w.waits(worked_out, when)
    return Task((part.name,), waits, write, part.is_ is None)


def _put(w: WriteWriter, segment: Bits, taken: Taken) -> None:
    parts = []
    for part in segment.parts:
        text = f"(uint64_t){taken.scope.entries[part.name].text}"
        parts.append(f"{text} << {part.low}" if part.low else text)
    text = w.size_of(segment.type.size, taken)
    put_number(w, replace(segment.type, signed=False), f"({' | '.join(parts) or '0'})", text, segment)


KINDS = (CKind(Bits, read=_read, values=_values, put=_put, measure=measure_number),)
