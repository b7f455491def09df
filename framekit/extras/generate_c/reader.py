"""Write decoders in C: one function per frame, which reads like the careful functions in `codec/python/diagnosis.py`.

So the first fault, its offset and its reason are equal. After a fault that prevents further reading, control jumps to
the end of the enclosing part. `kinds` writes the reading of each kind of segment.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

from framekit.codec.python.facts import fixed_and_conditional, parts_around
from framekit.codec.python.function import paths_of, paths_read, standing_any_way
from framekit.definition.expression import Expression
from framekit.definition.kinds.base import Segment
from framekit.definition.model.frames import Frame, everything, flat, without_when
from framekit.definition.model.segments import Check, Const, Field, Segments
from framekit.definition.problems import CannotSayError
from framekit.extras.generate_c.expressions import MOST, CScope, Val
from framekit.extras.generate_c.functions import CFunctionWriter, FileFacts, stands
from framekit.extras.generate_c.layout import CMember, CStruct, val_of
from framekit.extras.generate_c.source import CSource, string

Behind = tuple[tuple[Segment, CScope], ...]
"""The later segments of a buffer, with the scopes of their names."""


@dataclass(slots=True)
class LaterLines:
    """A comparison that needs later segments and values, identified by their paths."""

    write: Callable[[], None]
    paths: frozenset[str]


class ReadWriter(CFunctionWriter):
    """Write a reading function."""

    is_reader = True

    def __init__(self, file: FileFacts, segments: Segments, struct: CStruct) -> None:
        super().__init__(file, segments)
        self.struct = struct
        self.inn = "in"
        """The local of the bytes that are currently read."""
        self.used |= {"in", "n", "v", "data", "size", "context", "notes", "bad", "from"}
        self.stop = "stop"
        """The label for the end of the current part."""
        self.labels: set[str] = set()
        self.is_sure = True
        """Whether the current segment is read in every frame without a fault so far."""
        self.in_item = False
        self.deferred: list[LaterLines] = []
        self.late: list[Callable[[], None]] = []
        self.passed: set[str] = set()
        self.known: dict[int, str] = {}
        self.started: dict[int, tuple[str, str]] = {}

    # ---- the whole function -------------------------------------------------------------------------------

    def write(self, name: str, frame: Frame) -> CSource:
        """Return the whole function of a frame."""
        scope = CScope()
        surplus = -1 if frame.surplus is None else frame.surplus
        self.initial(self.struct, "v->")
        if frame.most is not None:
            self.when(f"size > {frame.most}", f"fk_note(&in, FRAMEKIT_TOO_LONG, {frame.most}, -1);")
        if self._needs_limit(frame):
            self.when(f"size > {self.file.layouts.most_of(frame)}", "notes->no_room = true;", "return;")
        with self.part("0", surplus, has_checks(self.segments)):
            self.region(self.segments, scope, "v->", self.struct, frame)
            for write in self.late:
                write()
        self.file.helper("reader")
        struct = self.file.frame_enum(frame.name)
        header = f"static void {name}(const uint8_t *data, size_t size{self.file.context}, struct {struct} *v,"
        begin = ("fk_open(&in, data, size, notes);",)
        return self.assembled(f"{header} struct fk_notes *notes)", "struct fk_in in;", self.out.lines, begin=begin)

    def _needs_limit(self, frame: Frame) -> bool:
        """Return whether the frame has no limit, so that the struct's capacity limits it."""
        return frame.most is None and self.static.all(self.segments).most is None

    def initial(self, struct: CStruct, path: str) -> None:
        """Write the initial flags and counts of a struct."""
        for member in struct.members.values():
            at = f"{path}{member.cname}"
            if member.has:
                self.add(f"{path}{member.flag} = false;")
            match member.kind:
                case "record":
                    assert member.inside is not None
                    self.initial(member.inside, f"{at}.")
                case "list" | "values":
                    self.add(f"{at}.count = 0;")
                case "inner":
                    self.file.helper("view")
                    self.add(f"{at}.frame = {self.file.prefix.upper()}_FRAME_UNKNOWN;")
                    self.add(f"{at}.of.unknown = fk_view(NULL, 0);")
                case "bytes":
                    self.file.helper("view")
                    self.add(f"{at} = fk_view(NULL, 0);")
                case "decimal":
                    self.add(f"{at}.number = {at}.places = 0;")
                case _:
                    self.add(f"{at} = 0;")

    # ---- texts --------------------------------------------------------------------------------------------

    @property
    def n(self) -> str:
        return f"&{self.inn}"

    @property
    def at(self) -> str:
        return f"{self.inn}.at"

    @property
    def raw(self) -> str:
        """Return the text of the bytes that were taken last."""
        return f"({self.inn}.data + {self.inn}.from)"

    def refuse(self, segment: Segment) -> str:
        return "-1" if segment.refuse is None else str(segment.refuse)

    def note(self, reason: str, place: str, refuse: str = "-1") -> str:
        return f"fk_note({self.n}, FRAMEKIT_{reason.upper()}, {place}, {refuse});"

    def leave(self) -> str:
        """Return the statement that leaves the current part."""
        self.labels.add(self.stop)
        return f"goto {self.stop};"

    def begin(self) -> None:
        self.add("notes->turn++;")

    def take(self, size: str, refuse: str = "-1") -> None:
        take = self.file.helper("take")
        self.when(f"!{take}({self.n}, {size}, {refuse})", self.leave())

    def stands(self, path: str) -> None:
        """Store the span of the segment that was taken last."""
        self.stands_from(path, f"{self.inn}.from")

    def stands_from(self, path: str, start: str) -> None:
        span = self.span(path)
        if span is not None:
            self.add(*stands(span, f"{self.inn}.data", start, self.at))

    def ask(self, value: Val, reason: str, name: str, refuse: str = "-1") -> str:
        """Return a local with a computed number; the part ends if the computation fails."""
        if value.constant is not None:
            return value.text
        local = self.local("int64_t", name)
        self.worked_out(local, value.text, lambda: (self.note(reason, self.at, refuse), self.leave()))
        return local

    def ask_whether(self, text: str, reason: str, refuse: str = "-1") -> str:
        """Return the text of a computed condition; the part ends if the computation fails."""
        if "&bad" not in text:
            return text
        local = self.local("bool", "holds", "false")
        self.worked_out(local, text, lambda: (self.note(reason, self.at, refuse), self.leave()))
        return local

    # ---- names --------------------------------------------------------------------------------------------

    def declare(self, segments: Iterable[Segment], scope: CScope, struct: CStruct, path: str) -> None:
        """Declare the names of a list, of which no value has been read."""
        for segment in flat(segments):
            for name in segment.value_names:
                member = struct.members.get(name)
                if member is None or name in scope.entries:
                    continue
                known = self.known.get(id(member), "")
                if name in self.asked_by_name or member.kind == "record":
                    known = known or self.local("unsigned", f"{name}_known")
                    self.known[id(member)] = known
                text = f"{path}{member.cname}"
                scope.entries[name] = self._entry(member, segment.sibling_path(name), text, known)
            if segment.name and not segment.value_names and segment.name in self.asked_by_name:
                self._wire_entry(segment, scope)

    def _wire_entry(self, segment: Segment, scope: CScope) -> None:
        """Declare a segment without a value whose length expressions read."""
        span = self.span(segment.path)
        if span is not None and segment.name not in scope.entries:
            room = self.file.helper("room")
            scope.entries[segment.name or ""] = Val("other", "", wire=f"{room}(&{span})")

    def _entry(self, member: CMember, path: str, text: str, known: str) -> Val:
        value = val_of(member, text)
        if member.kind in ("record",):
            assert member.inside is not None
            return Val("record", text, there=f"{known} == 1" if known else "", inside=CScope(), wire="true")
        span = self.span(path) if member.kind not in ("bytes", "list", "values") else None
        wire = value.wire if span is None else f"{self.file.helper('room')}(&{span})"
        if not known:
            return replace(value, wire=wire, known="false")
        return replace(value, wire=wire, known=f"{known} != 0", there=f"{known} == 1")

    def known_of(self, member: CMember) -> str:
        """Return the local that records the state of a member: 0 not read, 1 read, 2 absent."""
        if id(member) not in self.known:
            self.known[id(member)] = self.local("unsigned", f"{member.name}_known")
        return self.known[id(member)]

    def is_there(self, member: CMember, here: Here, *, sure: bool = True) -> None:
        """Record that the value of a member is present, for users of the struct and for expressions."""
        if member.has:
            self.add(f"{here[2]}{member.flag} = true;")
        self.stored(member, here[0], member.name, sure=sure)

    def stored(self, member: CMember, scope: CScope, name: str, *, sure: bool = True) -> None:
        """Make the value of a name available to expressions."""
        self.mark(member, 1)
        entry = scope.entries.get(name)
        if entry is not None and sure and self.is_sure and entry.kind != "record":
            scope.entries[name] = replace(entry, known="", there="")

    def mark(self, member: CMember | None, state: int) -> None:
        """Set the state of a member for expressions: 0 not read, 1 read, 2 absent."""
        known = "" if member is None else self.known.get(id(member), "")
        if known:
            self.add(f"{known} = {state};")

    def forget(self, struct: CStruct) -> None:
        """Reset the states of an item's members before the item is read."""
        for member in struct.members.values():
            self.mark(member, 0)
            if member.kind == "record" and member.inside is not None:
                self.forget(member.inside)

    # ---- parts --------------------------------------------------------------------------------------------

    @contextmanager
    def part(self, behind: str, surplus: int, checks: bool) -> Iterator[None]:
        """Write a part that is followed by a number of bytes; reading continues after the part in every case."""
        whole = self.local("size_t", "whole")
        outside, self.stop = self.stop, self.fresh("part_stop")
        self.add(f"{whole} = {self.inn}.end;")
        if behind != "0":
            self.add(f"{self.inn}.end = {whole} - (size_t){behind};")
        yield
        self.when(f"{self.at} < {self.inn}.end", "notes->turn++;", self.note("surplus", self.at, str(surplus)))
        self._stopped(checks, [])
        self.add(f"{self.at} = {self.inn}.end;", f"{self.inn}.end = {whole};")
        self.stop = outside

    @contextmanager
    def attempt(self, behind: str, checks: bool) -> Iterator[None]:
        """Write a part followed by bytes that are read even if the part fails."""
        start, whole, tail = (
            self.local("size_t", "begun"),
            self.local("size_t", "whole"),
            self.local("int64_t", "tail"),
        )
        self.add(f"{start} = {self.at};", f"{whole} = {self.inn}.end;", f"{tail} = (int64_t){whole} - {behind};")
        outside, self.stop = self.stop, self.fresh("attempt_stop")
        sure, self.is_sure = self.is_sure, False
        yield
        self.is_sure = sure
        label, self.stop = self.stop, outside
        if label in self.labels:
            done = self.fresh("attempt_done")
            self.add(f"goto {done};")
            self.out.lines.append(f"{label}:")
            self.when(f"{tail} < (int64_t){start}", self.leave())
            self.add(f"{self.at} = (size_t){tail};", f"{self.inn}.end = {whole};")
            if checks:
                self.add("notes->unchecked = true;")
            self.out.lines.append(f"{done}:")
            self.add(";")
        else:
            self.add(f"(void){whole};", f"(void){tail};", f"(void){start};")

    def _stopped(self, checks: bool, lines: list[str]) -> None:
        """Write the end of a part that could not be read."""
        if self.stop not in self.labels:
            return
        if not checks and not lines:
            self.out.lines.append(f"{self.stop}:")
            self.add(";")
            return
        done = self.fresh("part_done")
        self.add(f"goto {done};")
        self.out.lines.append(f"{self.stop}:")
        if checks:
            self.add("notes->unchecked = true;")
        self.add(*lines)
        self.out.lines.append(f"{done}:")
        self.add(";")

    def region(
        self,
        segments: Segments,
        scope: CScope,
        path: str,
        struct: CStruct,
        frame: Frame | None = None,
        *,
        all_is_read: bool = True,
    ) -> None:
        """Write the reading of a buffer.

        The segments after its last variable part are read even after a fault in it.
        """
        self.declare(segments, scope, struct, path)
        here = (scope, struct, path)
        if frame is not None and frame.delimited and frame.tail and isinstance(frame.tail[0], Const):
            self._delimited(frame, here, frame.tail[0].data[:1])
        else:
            front, middle, tail = parts_around(self.static, segments)
            behind = tuple((segment, scope) for segment in tail)
            self.list(front, here, (), finish=False)
            if middle:
                text = self.behind(behind)
                with self.attempt(text, has_checks(middle)):
                    self.list(middle, here, behind, finish=False)
            self.list(tail, here, (), finish=False)
        self.finish(all_is_read=all_is_read)

    def _delimited(self, frame: Frame, here: Here, mark: bytes) -> None:
        surplus = -1 if frame.surplus is None else frame.surplus
        behind = tuple((segment, here[0]) for segment in (*frame.body, *frame.tail))
        self.list(frame.head, here, behind, finish=False)
        place = self.local("size_t", "tail_place")
        find = self.file.helper("find")
        found = f"{find}({self.inn}.data, {self.at}, {self.inn}.end, {string(mark)}, 1, &{place})"
        self.when(f"!{found}", self.note("short", self.at), self.leave())
        sure, self.is_sure = self.is_sure, False
        with self.part(f"({self.inn}.end - {place})", surplus, has_checks(frame.body)):
            self.list(frame.body, here, (), finish=False)
        self.is_sure = sure
        self.list(frame.tail, here, (), finish=False)

    def list(
        self, segments: Iterable[Segment], here: Here, after: Behind, finish: bool = True, all_is_read: bool = True
    ) -> None:
        """Write the reading of the segments of a list, given the segments that follow it in the buffer."""
        segments = tuple(segments)
        scope = here[0]
        outside = self.deferred
        if finish:
            self.deferred = []
        for place, segment in enumerate(segments):
            behind = (*((other, scope) for other in segments[place + 1 :]), *after)
            if segment.when is not None:
                self._conditional(segment, segment.when, here, behind)
            else:
                self.kind_of(segment).read(self, segment, here, behind)
            self.passed.update(path for one in everything((segment,)) for path in paths_of(one))
        if finish:
            self.finish(all_is_read=all_is_read)
            self.deferred = outside + self.deferred

    def later(self, write: Callable[[], None], segment: Segment, *needed: str | Expression) -> None:
        """Defer a comparison of a segment until the named siblings, and the names its expressions read, have been read.

        The segment belongs to the current buffer.
        """
        wanted = paths_read(segment, self.all_paths, *needed)
        self.deferred.append(LaterLines(self.in_this_buffer(write), wanted))

    def in_this_buffer(self, write: Callable[[], None]) -> Callable[[], None]:
        """Return a writer that later applies to the current buffer, whichever buffer is read then."""
        inn = self.inn

        def written() -> None:
            outside, self.inn = self.inn, inn
            write()
            self.inn = outside

        return written

    def finish(self, *, all_is_read: bool) -> None:
        deferred, self.deferred = self.deferred, []
        for one in deferred:
            if all_is_read or one.paths <= self.passed:
                one.write()
            else:
                self.deferred.append(one)

    def _conditional(self, segment: Segment, when: Expression, here: Here, behind: Behind) -> None:
        scope, struct, _ = here
        condition = self.ask_whether(self.writer(scope).condition(when), "value")
        sure, self.is_sure = self.is_sure, False
        with self.block(f"if ({condition})"):
            self.kind_of(segment).read(self, without_when(segment), here, behind)
        lines = CSource(self.out.depth + 1)
        out, self.out = self.out, lines
        if isinstance(segment, Field) and segment.default is not None:
            self._default(segment, segment.default, here)
        else:
            self.absent(segment)
            self.without((segment,), struct)
        self.out = out
        if lines.lines:
            with self.block("else"):
                self.out.lines.extend(lines.lines)
        self.is_sure = sure

    def _default(self, segment: Field, default: Expression, here: Here) -> None:
        """Write the default of an absent field."""
        scope, struct, path = here
        member = struct.members[segment.name]
        self.begin()
        self.add(f"{self.inn}.from = {self.at};")
        value = self.default_value(segment, default, scope)
        text = self.writer(scope).bytes(value) if value.kind == "bytes" else f"({member.ctype}){value.text}"
        if value.kind not in ("number", "bytes"):
            raise CannotSayError(default.at, "a default of this kind")
        if "&bad" in text:
            self.add("bad = false;")
        self.add(f"{path}{member.cname} = {text};")
        if "&bad" in text:
            self.when("bad", self.note("value", self.at))
            with self.block("else"):
                self.stored(member, scope, segment.name)
        else:
            self.stored(member, scope, segment.name)
        self.stands(segment.path)

    def without(self, segments: Iterable[Segment], struct: CStruct, there: Iterable[Segment] = ()) -> None:
        """Mark the values of these segments as absent for expressions, except those of the segments in `there`."""
        known = {name for one in flat(there) for name in one.value_names}
        for one in flat(segments):
            for name in one.value_names:
                member = struct.members.get(name)
                if name in self.asked_by_name and name not in known and member is not None:
                    self.mark(member, 2)
                    if member.kind == "record" and member.inside is not None:
                        for inner in member.inside.members.values():
                            self.mark(inner, 2)

    def absent(self, segment: Segment) -> None:
        """Write an empty span for each part of an absent segment."""
        for one in standing_any_way((segment,)):
            span = self.span(one.path)
            if span is not None:
                self.add(f"{span}.data = {self.inn}.data;", f"{span}.first = {span}.last = {self.at};",
                         f"{span}.there = true;")  # fmt: skip

    # ---- sizes --------------------------------------------------------------------------------------------

    def rest(self, behind: Behind) -> str:
        """Return a local with the number of bytes up to the later segments."""
        helper = self.file.helper("rest")
        size = self.local("int64_t", "rest")
        text = self.behind(behind)
        self.when(f"!{helper}({self.n}, {text}, &{size})", self.leave())
        return size

    def sized(self, size: object, scope: CScope, reason: str, refuse: str, factor: str = "") -> str:
        """Return the text of a size in bytes."""
        if isinstance(size, int):
            return str(size * 2 if factor == "*" else size // 2 if factor == "/" else size)
        assert isinstance(size, Expression)
        value = self.number(size, scope)
        local = self.ask(value, reason, "size_told", refuse)
        if factor == "*":
            if value.high > MOST // 2:
                raise CannotSayError(size.at, "a size without bound")
            return f"2 * {local}"
        return f"({local} >> 1)" if factor == "/" else local

    # ---- what is behind -----------------------------------------------------------------------------------

    def behind(self, after: Behind) -> str:
        """Return the text of the number of bytes after a segment that takes the rest."""
        after = tuple(self._in_place_of_records(after))
        if not self.knows_behind(after):
            return self._constant_behind(after[0][0])
        fixed, conditional = fixed_and_conditional(self.static, after)
        parts = [f"({self.writer(scope).condition(when)} ? {size} : 0)" for size, when, scope in conditional]
        if not parts:
            return str(fixed)
        text = " + ".join([str(fixed), *parts])
        return self.ask(Val("number", f"(int64_t)({text})"), "length", "behind")

    def knows_behind(self, after: Behind) -> bool:
        return not self.in_item and all(
            self.static.present(segment).fixed is not None and self._is_told(segment)
            for segment, _ in self._in_place_of_records(after)
        )

    def _is_told(self, segment: Segment) -> bool:
        return segment.when is None or paths_read(segment, self.all_paths, segment.when) <= self.passed

    def _in_place_of_records(self, after: Behind) -> Iterator[tuple[Segment, CScope]]:
        for segment, scope in after:
            if segment.is_record and segment.when is None:
                entry = scope.find(segment.value_names[0])
                inside = entry.inside if entry is not None and entry.inside is not None else scope
                yield from self._in_place_of_records(tuple((one, inside) for one in segment.members))
            else:
                yield segment, scope

    def _constant_behind(self, segment: Segment) -> str:
        if not isinstance(segment, Const):
            raise CannotSayError(segment.at, "what ends by what follows it, which is no constant")
        place = self.local("size_t", "end_place")
        find = self.file.helper("find")
        found = (
            f"{find}({self.inn}.data, {self.at}, {self.inn}.end, {string(segment.data)}, {len(segment.data)}, &{place})"
        )
        self.when(f"!{found}", self.note("length", self.at), self.leave())
        return f"(int64_t)({self.inn}.end - {place})"


Here = tuple[CScope, CStruct, str]
"""The destination of the values of a list: the scope of their names, their struct, and the path to the struct."""


def has_checks(segments: Segments) -> bool:
    """Return whether a part contains check codes whose failure makes it invalid."""
    return any(isinstance(segment, Check) and segment.verify == "error" for segment in everything(segments))
