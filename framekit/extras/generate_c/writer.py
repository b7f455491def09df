"""Write encoders in C: one function per frame.

First all values are assigned to locals in the order of their dependencies, then the bytes are assembled. A failure is
recorded and the function continues without writing beyond the buffer. A length of assembled bytes (of an inner frame,
of a wrap) is computed by repeating the assembly. `kinds` writes the values and bytes of each kind of segment.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

from framekit.codec.python.encode_plan import Task, run_in_order
from framekit.codec.python.facts import ending_constants, size_follows_value
from framekit.codec.python.function import covered_paths, covers_later, wire_paths
from framekit.definition.expression import Call, Expression, Name, names_in, walk
from framekit.definition.model.frames import Frame, bytes_of, everything, expressions_of, flat
from framekit.definition.model.segments import Check, Const, Data, Field, FieldType, Length, Repeat, Segment, Segments
from framekit.definition.problems import CannotSayError
from framekit.extras.generate_c.expressions import CScope, Val
from framekit.extras.generate_c.functions import CFunctionWriter, FileFacts, stands
from framekit.extras.generate_c.layout import CMember, CStruct, scope_of
from framekit.extras.generate_c.source import CSource, string


def both(condition: str) -> str:
    """Return a condition as prefix of a test that applies if it holds; empty for no condition."""
    return f"{condition} && " if condition else ""


def late_checks(segments: Segments) -> set[str]:
    """Return the paths of the check codes that cover later bytes, directly or through another check code."""
    checks = [one for one in everything(segments) if isinstance(one, Check)]
    found = {one.path for one in checks if covers_later(one, segments)}
    while True:
        more = {one.path for one in checks if one.covers is not None and found & {*covered_paths(one, segments)}}
        if found and any(one.covers is None for one in checks):
            raise CannotSayError(checks[0].at, "a check code over all before it, with one that covers what comes later")
        if more <= found:
            return found
        found |= more


@dataclass(slots=True)
class Taken:
    """The source of the values of a list: the scope of their names, their struct, and the path to the struct."""

    scope: CScope
    struct: CStruct
    path: str

    def member(self, name: str) -> CMember:
        return self.struct.members[name]


class WriteWriter(CFunctionWriter):
    """Write a building function. `inn`: the local of the bytes that are currently assembled."""

    is_reader = False

    def __init__(self, file: FileFacts, frame: Frame, segments: Segments, struct: CStruct) -> None:
        super().__init__(file, segments)
        self.frame = frame
        self.struct = struct
        self.most = file.layouts.most_of(frame)
        self.inn = "out"
        for one in everything(segments):  # counted segments may have to be assembled first
            if isinstance(one, Length):
                self.tracked |= {*one.counted, *wire_paths(self.segments, one.counted)}
        self.used |= {"out", "w", "v", "context", "bad", "to", "round", "number", "index"}
        self.scopes: dict[int, Taken] = {}
        self.chosen: dict[int, str] = {}
        self.lengths: list[tuple[str, Callable[[], str]]] = []
        self.late: list[tuple[Check, Callable[[], None]]] = []
        self.late_names = late_checks(segments)
        self.ends = dict(ending_constants(self.static, segments))
        self.in_wrap = False
        self.in_list = False
        self.open_texts: list[tuple[str, str, str, bool]] = []

    def write(self, name: str, frame: Frame) -> CSource:
        taken = Taken(CScope(), self.struct, "v->")
        self.values(self.segments, taken)
        front = self.out
        self.out = CSource(1)
        tail = frame.tail[0] if frame.delimited and frame.tail else None
        if isinstance(tail, Const) and tail.data[0] in bytes_of(frame.body, self.static.frames):
            self._delimited(frame, taken, tail)
        else:
            self.bytes(self.segments, taken)
        for write in self._late_in_order():
            write()
        self._check_texts()
        longest = self.static.all(self.segments).most
        if frame.most is not None and (longest is None or longest > frame.most):
            with self.block(f"if (out.at > {frame.most})"):
                self.fail("too_long")
        front.lines += self.out.lines
        self.out = front
        lines = self._rounds(front.lines)
        self.file.helper("writer")
        struct = self.file.frame_enum(frame.name)
        header = f"static void {name}(const struct {struct} *v{self.file.context}, struct fk_out *w)"
        return self.assembled(header, "struct fk_out out = *w;", lines, end=("*w = out;",))

    def _late_in_order(self) -> list[Callable[[], None]]:
        """Return the postponed check codes, each after those that it covers."""
        waiting, ordered = list(self.late), list[Callable[[], None]]()
        while waiting:
            paths = {check.path for check, _ in waiting}
            ready = next(
                (one for one in waiting if not (paths - {one[0].path}) & {*covered_paths(one[0], self.segments)}), None
            )
            if ready is None:
                raise CannotSayError(waiting[0][0].at, "check codes that cover each other")
            waiting.remove(ready)
            ordered.append(ready[1])
        return ordered

    def _rounds(self, lines: list[str]) -> list[str]:
        """Return the lines in a loop that repeats until the lengths of assembled bytes are stable.

        The loop fails after five rounds.
        """
        if not self.lengths:
            return lines
        self.locals.append("unsigned round;")
        found = ["    for (round = 0;; round++) {", "        bool same = true;", "        out = *w;"]
        found += [f"    {line}" if line else "" for line in lines]
        for local, text in self.lengths:
            found += [
                f"        if ({local} != {text()}) {{",
                f"            {local} = {text()};",
                "            same = false;",
                "        }",
            ]
        found += ["        if (same) {", "            break;", "        }", "        if (round == 4) {"]
        found += ["            fk_fail(&out, FRAMEKIT_LENGTH);", "            break;", "        }", "    }"]
        self.file.helper("fail")
        return found

    def _delimited(self, frame: Frame, taken: Taken, tail: Const) -> None:
        """Write a delimited frame, with the check that its body does not contain its end."""
        begin = self.local("size_t", "body_start")
        self.bytes(frame.head, taken)
        self.add(f"{begin} = out.at;")
        self.bytes(frame.body, taken)
        held = self.file.helper("holds_end")
        with self.block(f"if ({held}(out.data, {begin}, out.at, {string(tail.data[:1])}, 1))"):
            self.fail("value")
        self.bytes(frame.tail, taken)

    # ---- texts --------------------------------------------------------------------------------------------

    @property
    def n(self) -> str:
        return f"&{self.inn}"

    def fail(self, reason: str) -> None:
        self.add(self.failing(reason))

    def failing(self, reason: str) -> str:
        return f"{self.file.helper('fail')}({self.n}, FRAMEKIT_{reason.upper()});"

    def fail_if(self, condition: str, reason: str) -> None:
        if condition and condition != "false":
            with self.block(f"if ({condition})"):
                self.fail(reason)

    def number_of(self, expression: Expression, taken: Taken, name: str) -> str:
        """Return a local with a number; if its computation fails, the values are refused."""
        value = self.number(expression, taken.scope)
        return self.kept(value, name)

    def keep(self, local: str, text: str) -> None:
        """Write the assignment of a computed value to a local; if it fails, the values are refused."""
        self.worked_out(local, text, lambda: (self.failing("value"),))

    def holds(self, expression: Expression, taken: Taken) -> str:
        """Return a local with the result of a condition."""
        text = self.writer(taken.scope).condition(expression)
        if text in ("true", "false"):
            return text
        local = self.local("bool", "holds", "false")
        self.keep(local, text)
        return local

    def condition(self, segment: Segment, taken: Taken) -> str:
        """Return the condition under which a segment is present; '' if it always is."""
        return "" if segment.when is None else self.holds(segment.when, taken)

    def size_of(self, size: object, taken: Taken, name: str = "size_told") -> str:
        """Return the text of a size, which may be computed; 0 for no size."""
        return self.number_of(size, taken, name) if isinstance(size, Expression) else str(size or 0)

    def fail_unless_told(
        self, segment: Segment | None, size: Expression, taken: Taken, found: str, name: str = "size_told"
    ) -> None:
        """Write the check that a size equals the size that other values state, if they are present.

        `found`: the size with the comparison operator that means a failure.
        """
        told = self.number_or_nothing(size, taken)
        conditions = ["" if segment is None else self.condition(segment, taken), told.there]
        kept = self.kept(replace(told, there=""), name)
        self.fail_if(" && ".join([*filter(None, conditions), f"{found} {kept}"]), "length")

    # ---- values -------------------------------------------------------------------------------------------

    def values(self, segments: Iterable[Segment], taken: Taken) -> None:
        """Write all values of a list of segments, including those in its wraps."""
        tasks: list[Task] = []
        for segment in segments:
            tasks += self.tasks_of(segment, taken)
        for task in tasks:
            task.waits_for.difference_update(task.gives)
            self._guarded(task)
        run_in_order(tasks)

    def _guarded(self, task: Task) -> None:
        """Set `missing` while a task runs that breaks a circle of dependencies."""
        write = task.write

        def checked(missing: set[str]) -> None:
            self.missing = missing
            write(missing)
            self.missing = set()

        task.write = checked

    missing: set[str] = set()  # noqa: RUF012 - never changed in place
    """The names that the current task takes from the given values."""

    def tasks_of(self, segment: Segment, taken: Taken) -> list[Task]:
        self.scopes[id(segment)] = taken
        values = self.kind_of(segment).values
        return [] if values is None else values(self, segment, taken)

    def with_missing(self, taken: Taken) -> Taken:
        """Return the source of the values with missing names replaced by the given values."""
        if not self.missing:
            return taken
        given = scope_of(taken.struct, taken.path).entries
        scope = CScope(taken.scope, {name: given[name] for name in self.missing if name in given})
        return Taken(scope, taken.struct, taken.path)

    def waits(self, *expressions: Expression | None) -> set[str]:
        """Return the tokens that must be available before these expressions can be evaluated."""
        found: set[str] = set()
        for expression in expressions:
            if expression is not None:
                found |= names_in(expression.root)
                for node in walk(expression.root):
                    if isinstance(node, Call) and node.function == "len" and isinstance(node.arguments[0], Name):
                        found.add(f"room of {node.arguments[0].name}")
        return found

    def outer_names(self, segment: Segment) -> set[str]:
        """Return the names that a segment reads but does not provide itself."""
        given = {name for one in flat((segment,)) for name in one.value_names}
        return self._read_in(segment) - (given if segment.inner_record is None else set())

    def _read_in(self, segment: Segment) -> set[str]:
        """Return the names that a segment and its content read, except those its records provide."""
        found = self.waits(*expressions_of(segment.with_lists(lambda _: ())))
        if isinstance(segment, Length):
            found |= set(segment.of)
        found.update(*(self._read_in(one) for block in segment.blocks for one in block))
        inside: set[str] = set().union(*(self._read_in(one) for one in segment.members))
        return found | inside - {name for one in flat(segment.members) for name in (one.name, *one.value_names)}

    def size_by_length(self, segment: Segment) -> bool:
        """Return whether the size of a segment is exactly a length that counts it."""
        return size_follows_value(segment, self.by_path)

    def given_flag(self, member: CMember, taken: Taken) -> str:
        return f"{taken.path}{member.flag}" if member.has else "true"

    def refuse_given(self, segments: Iterable[Segment], taken: Taken, but: Iterable[Segment] = ()) -> None:
        """Write the refusal of values that are given for absent segments."""
        here = {name for one in flat(but) for name in one.value_names}
        for one in flat(segments):
            for name in one.value_names:
                member = taken.struct.members.get(name)
                if member is not None and member.has and name not in here:
                    here.add(name)
                    self.fail_if(f"{taken.path}{member.flag}", "value")

    # ---- bytes --------------------------------------------------------------------------------------------

    def bytes(self, segments: Iterable[Segment], taken: Taken) -> None:
        """Write the bytes of a list of segments."""
        for segment in segments:
            put = self.kind_of(segment).put
            if put is None:
                continue
            begin = self.local("size_t", "begun")
            self.add(f"{begin} = {self.inn}.at;")
            with self.where(self.condition(segment, taken)):
                put(self, segment, taken)
            span = self.span(segment.path)
            if span is not None:
                self.add(*stands(span, f"{self.inn}.data", begin, f"{self.inn}.at"))
            end = self.ends.get((segment.path, segment.at))
            if end is not None:
                held = self.file.helper("holds_end")
                call = f"{held}({self.inn}.data, {begin}, {self.inn}.at, {string(end)}, {len(end)})"
                self.fail_if(call, "value")

    def open_text(self, segment: Field) -> None:
        """Record a text that must be followed by one of several delimiters."""
        self.file.helper("find_stop")
        stops = self.stops(segment.type)
        place = self.local("size_t", "text_stop")
        there = self.local("bool", "text_open", "false")
        starts = self.file.helper("starts_stop")
        if self.in_list:
            with self.block(f"if ({there} && !{starts}({self.inn}.data, {place}, {self.inn}.at, {stops}))"):
                self.fail("value")
        self.open_texts.append((place, there, stops, self.in_list))
        self.add(f"{place} = {self.inn}.at;", f"{there} = true;")

    def _check_texts(self) -> None:
        for place, there, stops, in_list in self.open_texts:
            starts = self.file.helper("starts_stop")
            last = "" if in_list else f" && {place} < out.at"
            with self.block(f"if ({there}{last} && !{starts}(out.data, {place}, out.at, {stops}))"):
                self.fail("value")

    def pointer(self) -> str:
        """Return the local that points to the destination of bytes."""
        if "to_place" not in self.used:
            self.local("uint8_t *", "to_place", "NULL")
        return "to_place"

    def can_say(self, expression: Expression, taken: Taken, name: str) -> bool:
        """Return whether the expression for a value that is not given has a C form; a missing form is reported."""
        try:
            value = self.writer(taken.scope).value(expression)
        except CannotSayError as error:
            self.file.to_give(self.frame.name, name, error.problem)
            return False
        return value.kind != "other"

    def number_or_nothing(self, expression: Expression, taken: Taken) -> Val:
        """Return a number that may be absent, with the condition of its presence."""
        value = self.writer(taken.scope).value(expression)
        if value.kind != "number":
            raise CannotSayError(expression.at, "a size that is no number")
        return value

    def is_simple(self, path: str) -> bool:
        """Return whether the size of a segment follows from its value."""
        segment = self.by_path.get(path)
        return isinstance(segment, (Data, Field, Repeat))

    def simple_room(self, path: str, taken: Taken, plain: bool) -> str | None:
        """Return the text of a segment's size if it follows from values; None if its bytes must be assembled first."""
        every = [one for one in everything(self.segments) if one.path == path]
        if len(every) != 1:
            return None
        segment = every[0]
        size = self.static.present(segment).fixed
        converted = isinstance(segment, Data) and segment.convert is not None
        if self.scopes.get(id(segment)) not in (None, taken) or segment.when is not None:
            return None
        if size is not None and not (plain and converted):
            return str(size) if self.scopes.get(id(segment)) is taken or not segment.value_names else None
        if self.scopes.get(id(segment)) is not taken:
            return None
        entry = taken.scope.entries.get(segment.name or "")
        return None if entry is None else _room_of_value(segment, entry.text, plain)


def _room_of_value(segment: Segment, value: str, plain: bool) -> str | None:
    """Return the text of a segment's size if it follows from the value in a local, otherwise None."""
    size = f"(int64_t){value}.size"
    match segment:
        case Data(pad=None, convert=convert):
            if plain or convert is None:
                return size
            return f"2 * {size}" if convert == "hex_to_ascii" else f"{size} / 2"
        case Field(type=FieldType(kind="ascii" | "bytes") as type_):
            fills = type_.pad is not None or (type_.end is not None and type_.size is not None)
            more = len(type_.end or b"")
            return None if fills else size + (f" + {more}" if more else "")
        case Repeat(of=FieldType() as of):
            return f"{of.fixed_size or 1} * (int64_t){value}.count"
    return None
