"""Implement `wrap`: a region that is converted as a whole."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from framekit.codec.kinds.base import SegmentKind
from framekit.codec.python.codings import wire_coding
from framekit.codec.python.diagnosis import Behind, DiagnosisWriter, checks_option
from framekit.codec.python.encode import ConsumedValues, EncodeWriter
from framekit.codec.python.encode_plan import Task
from framekit.codec.python.expressions import FieldScope
from framekit.codec.python.facts import symbol_behind
from framekit.codec.python.function import between
from framekit.codec.python.measure import MeasureWriter, Pairs, needed_names
from framekit.codec.python.reader import BufferReader, ScopedSegment, not_possible, shown_name
from framekit.codec.python.registry import summary
from framekit.codec.python.source import Code, bytes_literal, quoted, text_source
from framekit.definition.codings import Hex
from framekit.definition.expression import BIT_OR, OR, Expression
from framekit.definition.model.frames import flat, leaves, names_always_there
from framekit.definition.model.segments import Const, Skip, Wrap, exactly


class WrapKind(SegmentKind[Wrap]):
    model = Wrap

    def read(self, r: BufferReader, item: ScopedSegment, segment: Wrap, after: tuple[ScopedSegment, ...]) -> None:
        function = r.function
        plain = function.names.fresh(shown_name(segment, "plain"))
        if function.in_branch and any(leaf.path in function.tracked for leaf in leaves(segment.of)):
            function.regions.append(plain)
        fixed = r.static.all(segment.of).fixed
        if segment.escape is not None:
            _unstuff(r, item, segment, fixed, after, plain)
        else:
            size = _size_on_wire(segment, fixed)
            if isinstance(size, Expression):
                first, last = r.take(item, r.size_text(size, item.scope))
            elif size is not None:
                first, last = r.take(item, str(size))
            else:
                first, last = r.take_rest(item, after)
            wire, read = between(r.buffer, first, last), wire_coding(segment.coding)
            function.add(
                f"{plain} = {read.read_text(r.module, segment.coding, wire, fixed, function.writer(item.scope).text)}"
            )
        inside = BufferReader(function, plain, function.names.fresh(f"{plain}_at"))
        inside.read(segment.of, item.scope, item.fields, all_is_read=False)
        inside.close()
        r.deferred += inside.deferred
        if segment.least:
            function.wrong_if(f"len({plain}) < {segment.least}")
        if segment.most is not None:
            most = (
                str(segment.most)
                if isinstance(segment.most, int)
                else function.writer(item.scope).text(segment.most, BIT_OR)
            )
            function.wrong_if(f"len({plain}) > {most}")

    def tasks(self, w: EncodeWriter, segment: Wrap, scope: FieldScope, given: ConsumedValues) -> list[Task]:
        tasks: list[Task] = []
        for one in segment.of:
            w.tasks_of(one, scope, given, tasks)
        compared = segment.size is not None and w.size_by_length(segment) is None
        if segment.path in w.asked_for or compared:
            waits = {name for task in tasks for name in task.gives}
            gives = (f"bytes of {segment.path}",)
            tasks.append(Task(gives, waits, lambda _: w.put_into_local(segment, scope)))
        if compared:
            waits = {*gives, *w.waits(segment.size_expression)}
            tasks.append(Task((), waits, lambda _: _compare_size(w, segment, scope, given)))
        return tasks

    def bytes_text(self, w: EncodeWriter, segment: Wrap, scope: FieldScope) -> str:
        buffer = w.names.fresh("plain")
        text = w.region(segment.of, scope, buffer)
        if segment.least or segment.most is not None:
            text = w.gather([text], buffer)
            _limit(w, segment, scope, buffer)
        if segment.escape is not None and text.isidentifier():
            single = bytes((segment.escape,))
            return f"{text}.replace({bytes_literal(single)}, {bytes_literal(2 * single)})"
        return wire_coding(segment.coding).build_text(w.module, segment.coding, text, lambda one: w.text(one, scope))

    def diagnose(self, d: DiagnosisWriter, segment: Wrap, scope: FieldScope, behind: Behind) -> None:
        fixed = d.static.all(segment.of).fixed
        option, size = "", "None"
        if segment.escape is None:
            open_up = wire_coding(segment.coding).careful_text(d.module, segment.coding, fixed, d.writer(scope).text)
            known = _size_on_wire(segment, fixed)
            size = "None" if known is None else d.ask(known, scope)
            option = d.behind_option(known is None, behind)
        else:
            escape = f"{segment.escape:#04x}"
            inside = d.module.embedded(segment)
            more = f", {inside}" if inside else ""
            open_up = f"lambda raw: {d.module.function('unstuffed')}(raw, {escape}{more})"
            if fixed is not None:
                size = f"lambda n: {d.module.function('end_of_stuffed')}(n.data, n.at, {escape}, {fixed}) - n.at"
            elif any(d.static.present(one).fixed != 0 for one, _ in behind):
                size = f"lambda n: {d.module.function('end_of_region')}(n.data, n.at, {escape}{more}) - n.at"
        option += checks_option(segment.of)
        with d.out.block(f"with n.inside({d.named(segment)}, {size}, {open_up}{option}):"):
            _diagnose_limits(d, segment, scope)
            outside, d.deferred, in_item, d.in_item = d.deferred, [], d.in_item, False
            d.region(segment.of, scope, all_is_read=False)
            d.deferred, d.in_item = outside + d.deferred, in_item

    def measure(self, m: MeasureWriter, segment: Wrap, scope: FieldScope, after: Pairs) -> None:
        fixed = m.static.all(segment.of).fixed
        if segment.escape is None:
            _measure_by_size_or_end(m, segment, scope, fixed, after)
            return
        m.settle()
        escape = f"{segment.escape:#04x}"
        behind = m.least(after)
        if fixed is not None:
            with m.out.block("try:"):
                m.add(f"at = {m.module.function('end_of_stuffed')}(data, at, {escape}, {fixed}, end)")
            with m.out.block("except IndexError:"):
                m.add(f"return -{1 + behind}")
            with m.out.block("except ValueError:"):
                m.add("return LOST")
            if follows := symbol_behind(segment, (one for one, _ in after)):
                with m.out.block(
                    f"if not {bytes_literal(follows)}.startswith(data[at:min(at + {len(follows)}, end)]):"
                ):
                    m.add("return LOST")
            _measure_content(m, segment, scope, after)
            return
        find = m.module.function("find_region_end")
        resume = m.resume(after)
        embedded = m.module.embedded(segment)
        more = f", {embedded}" if embedded else ""
        m.add(f"at = {find}(data, at, end, {escape}, {0 if resume is None else resume}{more})")
        with m.out.block("if at < 0:"):
            m.not_found(max(behind - 1, 1))
        # an escape byte that is not doubled must be the end
        if follows := symbol_behind(segment, (one for one, _ in after)):
            with m.out.block(f"if data[at + 1] != {follows[1]:#04x}:"):
                m.add("return LOST")
        _measure_content(m, segment, scope, after, 2)

    def describe(self, segment: Wrap) -> str:
        return f"{segment.coding.shown} ({summary(segment.of)})"


def _size_on_wire(wrap: Wrap, fixed: int | None) -> int | Expression | None:
    """Return the encoded size of a region without an end of its own; None if it extends to the next segment."""
    if wrap.size is not None or fixed is None:
        return wrap.size
    return wrap.coding.sizes(exactly(fixed)).fixed


def _compare_size(w: EncodeWriter, wrap: Wrap, scope: FieldScope, given: ConsumedValues) -> None:
    """Write the comparison of the encoded size with the size that other values state."""
    size, conditions = str(wrap.size), []
    if isinstance(wrap.size, Expression):
        size, conditions = w.text(wrap.size, scope), w.is_known(None, wrap.size, scope)
    name = wrap.name or ""
    path = (*given.path, "wrap" if name.startswith("_") else name)
    w.compare_size(path, f"len({w.wires[wrap.path]})", size, conditions)


def _limit(w: EncodeWriter, wrap: Wrap, scope: FieldScope, buffer: str) -> None:
    tests = [f"len({buffer}) < {wrap.least}"] if wrap.least else []
    if wrap.most is not None:
        most = str(wrap.most) if isinstance(wrap.most, int) else w.text(wrap.most, scope, OR)
        tests.append(f"len({buffer}) > {most}")
    message = text_source("the content takes ", Code(f"len({buffer})"), " bytes, that is not allowed")
    w.complain(" or ".join(tests), '""', message)


def _unstuff(
    r: BufferReader, item: ScopedSegment, wrap: Wrap, fixed: int | None, after: tuple[ScopedSegment, ...], plain: str
) -> None:
    """Write the removal of doubled escape bytes; the content goes into the local `plain`."""
    name, escape = r.module.function, f"{wrap.escape or 0:#04x}"
    embedded_texts = [bytes_literal(data) for data in r.module.embedded_frames(wrap)]
    embedded = r.module.embedded(wrap)
    if r.knows_behind(after):
        first, last = r.take_rest(item, after)
    else:
        first = r.keep(r.place)
        start = first.text(r.buffer)
        if fixed is not None:
            r.advance(f"{name('end_of_stuffed')}({r.buffer}, {start}, {escape}, {fixed})")
        else:
            more = f", {embedded}" if embedded else ""
            r.advance(f"{name('end_of_region')}({r.buffer}, {start}, {escape}{more})")
        last = r.place
        r.function.stands(wrap, r.buffer, first, last)
    r.function.flush()
    r.function.add(f"{plain} = {between(r.buffer, first, last)}")
    single = bytes_literal(bytes((wrap.escape or 0,)))
    read = wire_coding(wrap.coding)
    with r.function.out.block(f"if {single} in {plain}:"):
        if embedded:
            tests = " or ".join(f"{frame} in {plain}" for frame in embedded_texts)
            with r.function.out.block(f"if {tests}:"):
                r.function.add(f"{plain} = {name('without_embedded')}({plain}, {escape}, {embedded})")
        r.function.add(
            f"{plain} = {read.read_text(r.module, wrap.coding, plain, fixed, r.function.writer(item.scope).text)}"
        )


def _measure_content(
    m: MeasureWriter, wrap: Wrap, scope: FieldScope, after: Pairs, further: int = 0, is_there: bool = True
) -> None:
    """Write the reading of values in a wrap that the sizes of later segments depend on.

    The careful function reads them. It gets `further` bytes after the wrap too, which hold its end mark; `is_there`:
    these bytes have arrived.
    """
    needed = m.needed & needed_names(tuple(segment for segment, _ in after), m.segments)
    names = {name: one for one in flat(wrap.of) for name in one.value_names if name in needed}
    if names and m.in_digits:
        what = f"only '{next(iter(names))}' in a wrap tells how many digits there are around it"
        raise not_possible(wrap, what, "put a constant behind the digits that is none, or the wrap outside")
    if names:
        m.settle()
        m.may_fail = True
        if not is_there:
            m.want(further, after[1:])
        stop = f"at + {further}" if further else "at"
        always = names_always_there(wrap.of)
        content = m.module.function("content_of")
        m.add(f"fields = {content}(diagnose_{m.identifier}, bytes(data[start:{stop}]), ctx)")
        for name, one in names.items():
            there = f"[{quoted(name)}]" if name in always else f".get({quoted(name)})"
            m.set_value(name, scope, f"{m.path_of(scope)}{there}", one if one.is_record else None)


def _measure_by_size_or_end(m: MeasureWriter, wrap: Wrap, scope: FieldScope, fixed: int | None, after: Pairs) -> None:
    known = _size_on_wire(wrap, fixed)
    if known is not None:
        needed = any(name in m.needed for one in flat(wrap.of) for name in one.value_names)
        if isinstance(known, int):
            if needed:
                m.want(known, after)
            m.skip(str(known))
        elif needed:
            m.take(m.size_text(known, scope), after)
            m.advance("stop")
        else:
            m.skip(m.size_text(known, scope))
        _measure_content(m, wrap, scope, after)
        return
    first = after[0][0] if after else None
    if isinstance(first, Const) and first.when is None and first.data[:1] and first.data[0] in wrap.coding.never:
        m.settle()
        m.add(f"at = {m.search(f'{first.data[0]:#04x}', 'at', after)}")
        with m.out.block("if at < 0:"):
            m.not_found(m.least(after))
        _measure_content(m, wrap, scope, after, len(first.data), is_there=False)
        return
    if not isinstance(wrap.coding, Hex):
        m.rest(wrap, after)
    if isinstance(first, Const):
        m.rest(wrap, after)
    front = Skip(at=wrap.at, size=1)  # so that empty content differs from missing content
    inside = type(m)(m.module, f"{m.identifier}_content", (front, *wrap.of), m.most)
    inside.maybe_absent, inside.in_digits = m.maybe_absent, True
    given: dict[str, str] = {}
    inside.write(None, _handed(inside.needed, scope, "", given))
    m.module.extra.append(inside.function(f"Return the size of the content of the wrap in `{m.identifier}`."))
    m.settle()
    size = m.names.fresh("size")
    measure = m.module.function("measure_hex")
    texts = "".join(f", {quoted(name)}: {text}" for name, text in given.items())
    context = f"{{**ctx{texts}}}" if given else "ctx"
    m.add(f"{size} = {measure}(measure_{inside.identifier}, data, at, end, {context})")
    with m.out.block(f"if {size} <= 0:"):
        m.add(f"return {size}")
    m.skip(f"{size} - 1")


def _handed(names: Iterable[str], scope: FieldScope, path: str, given: dict[str, str]) -> FieldScope:
    """Return a scope in which the content of a wrap finds the outer values in its context.

    Fills `given` with the source of each value by its name in the context.
    """
    found = FieldScope()
    for name in sorted(names):
        entry = scope.find(name)
        if entry is not None and entry.direct and entry.inside is not None:
            inside = _handed(entry.inside.entries, entry.inside, f"{path}{name}.", given)
            found.entries[name] = replace(entry, inside=inside)
        elif entry is not None:
            given[f"{path}{name}"] = entry.text
            found.entries[name] = replace(entry, text=f"ctx[{quoted(f'{path}{name}')}]")
    return found


def _diagnose_limits(d: DiagnosisWriter, wrap: Wrap, scope: FieldScope) -> None:
    refuse = d.refuse(wrap)
    if wrap.least:
        rule = f'"short", {d.named(wrap)}, 0, {quoted(f"at least {wrap.least} bytes")}'
        d.out.add(f"n.expect({rule}, lambda n: n.end >= {wrap.least}{refuse})")
    if wrap.most is not None:
        most = str(wrap.most) if isinstance(wrap.most, int) else d.writer(scope).text(wrap.most, BIT_OR)
        rule = f'"too_long", {d.named(wrap)}, 0, "fewer bytes"'
        d.out.add(f"n.expect({rule}, lambda n: n.end <= {most}{refuse})")
