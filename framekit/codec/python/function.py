"""Hold the common state of generated functions: lines, locals, context, conditions, and offsets as source."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

from framekit.codec.python.expressions import ExpressionWriter, FieldScope, entries_read
from framekit.codec.python.facts import (
    PathTarget,
    fixed_and_conditional,
    is_followed,
    lengths_asked,
    names_asked_for,
    segments_at,
)
from framekit.codec.python.forms import value_range, wire_range
from framekit.codec.python.module import Module
from framekit.codec.python.source import Identifiers, Source, quoted
from framekit.definition.expression import (
    Attribute,
    Binary,
    Call,
    Expression,
    Name,
    Node,
    Number,
    Unary,
    children,
    names_in,
)
from framekit.definition.kinds.check import Added, Edges
from framekit.definition.model.frames import everything, leaves, nearest_path
from framekit.definition.model.segments import (
    LAST,
    Check,
    Count,
    Data,
    Field,
    FieldType,
    Length,
    Repeat,
    Segment,
    Segments,
    Value,
)

MISMATCH = "raise Mismatch"
"""The statement for bytes that do not fit."""


@dataclass(frozen=True, slots=True)
class Bounds:
    """The span of a segment: its buffer, the offset of its first byte and the offset after its last byte."""

    buffer: str
    first: Offset
    last: Offset


class FunctionWriter:
    """The common base of the writers of generated functions.

    `segments`: all segments that the function reads or builds.
    """

    def __init__(self, module: Module, segments: tuple[Segment, ...]) -> None:
        self.module = module
        self.static = module.static
        self.segments = segments
        self.out = Source()
        self.names = Identifiers(module.words())
        self.hoisted: dict[str, str] = {}
        """The locals of the context values that the function reads."""
        self.by_name = {segment.name: segment for segment in everything(segments) if segment.name}
        self.by_path = {segment.path: segment for segment in everything(segments) if segment.name}
        self.by_value_name: dict[str, list[Segment]] = {}
        for segment in everything(segments):
            for name in segment.value_names:
                self.by_value_name.setdefault(name, []).append(segment)
        self.field_names = self.by_value_name.keys()
        self.all_paths = {path for segment in everything(segments) for path in paths_of(segment)}
        """The paths of the segments and of all values in them."""

    def add(self, text: str) -> None:
        self.out.add(text)

    def context(self, name: str) -> str:
        """Return the local of a context value, which is read once at the start of the function."""
        if name not in self.hoisted:
            self.module.context.add(self.module.known(name, self.segments))
            self.hoisted[name] = self.names.fresh(name)
        return self.hoisted[name]

    def sizes_of(self, placed: Iterable[tuple[Segment, FieldScope]], level: int) -> tuple[int, list[str]]:
        """Return the total size of the unconditional segments, and the source of the size of each other segment.

        The segments have a fixed size when present.
        """
        fixed, conditional = fixed_and_conditional(self.static, placed)
        return fixed, [
            f"({size} if {self.writer(scope).text(when, level)} else 0)" for size, when, scope in conditional
        ]

    def write_hoisted(self, out: Source) -> None:
        """Write the assignments of the context values to their locals."""
        for name, local in self.hoisted.items():
            out.add(f"{local} = {self.module.given(name)}")

    def writer(self, scope: FieldScope) -> ExpressionWriter:
        return ExpressionWriter(self.module, scope, self.context)

    def may_be_negative(self, size: Node) -> bool:
        """Return whether a size can be negative."""
        asked: set[str] = set()
        ahead = [size]
        while ahead:
            node = ahead.pop()
            match node:
                case Number(value=value) if value < 0:
                    return True
                case Binary(operator="-") | Unary(operator="-" | "~"):
                    return True
                case Call(function="len" | "abs"):
                    continue
                case Name(name=name) | Attribute(name=name) if name not in asked:
                    if self._holds_negative(name):
                        return True
                    asked.add(name)
                    ahead += self._behind(name)
            ahead += children(node)
        return False

    def _holds_negative(self, name: str) -> bool:
        """Return whether a value of this name may be negative by the type that holds it."""
        found = self.by_value_name.get(name)
        if found is None:
            return self._given_negative(name)
        for one in found:
            if isinstance(one, Field | Length | Count):
                least = value_range(replace(one, limits=None)).least
            else:
                least = wire_range(one.of).least if isinstance(one, Repeat) and isinstance(one.of, FieldType) else 0
            if least is None or least < 0:
                return True
        return False

    def _behind(self, name: str) -> Iterator[Node]:
        """Yield the expressions from which values of this name may be computed."""
        for one in self.by_value_name.get(name, ()):
            given = one.read if isinstance(one, Value) else one.default if isinstance(one, Field) else None
            if given is not None:
                yield given.root

    def _given_negative(self, name: str) -> bool:
        """Return whether a table, a parameter or a state variable may be negative."""
        protocol = self.module.protocol
        parameter, state, table = protocol.params.get(name), protocol.state.get(name), protocol.tables.get(name)
        if parameter is not None:
            return parameter.limits is None or parameter.limits[0] < 0
        if table is not None:
            held = (*table.entries.items(), *table.ranges)
            return any(isinstance(one, int) and one < 0 for row in held for one in row)
        return state is None or not state.type.startswith("u")


class Function(FunctionWriter):
    """The state of a reading function while it is written; `title` is part of the names of its constants."""

    def __init__(self, module: Module, title: str, segments: tuple[Segment, ...]) -> None:
        super().__init__(module, segments)
        self.title = title
        self.regions: list[str] = []
        """Locals with the content of wraps that may be absent, if checks need it."""
        self.conditions: list[str] = []
        self.tells_wrong = False
        """Whether faults from `wrong_if` are distinguished from all other faults."""
        self.raises_wrong = False
        self.wrong: list[str] = []
        self.wrong_at_last: list[str] = []
        self.flag = ""
        """The local that records a fault, false at the start."""
        self.last: list[Callable[[], None]] = []
        """Readings to write after all other parts fit."""
        self.read_names = names_asked_for(segments)
        self.tracked = tracked_paths(segments)
        self.locals_of_values: dict[str, str] = {}
        self.in_branch = 0
        self.presets: dict[str, tuple[str, str]] = {}
        self.late: list[Callable[[], None]] = []
        self.bounds: dict[str, Bounds] = {}
        self.wire_parts = {
            segment.path: tuple(part.path for part in on_the_wire((segment,)) if part.name)
            for segment in everything(segments)
            if (segment.blocks or segment.is_record) and segment.name
        }
        self.trail: list[str] = []

    # ---- names --------------------------------------------------------------------------------------------

    def local(self, name: str, scope: FieldScope) -> str:
        """Return the local of a field; fields of the same name in several cases of a choice share a local."""
        if name in scope.entries and scope.entries[name].text:
            return scope.entries[name].text
        return self.names.fresh(name)

    def waits_for(self, expression: Expression, scope: FieldScope) -> bool:
        """Return whether an expression reads fields that are not available yet."""
        entries = entries_read(expression.root, scope, self.field_names)
        return any(entry is None or not entry.is_read for entry in entries)

    # ---- lines --------------------------------------------------------------------------------------------

    def mismatch_if(self, condition: str) -> None:
        """Add a condition under which the frame does not fit; it is written before any line that depends on it."""
        if condition not in self.conditions:
            self.conditions.append(condition)

    def wrong_if(self, condition: str) -> None:
        """Add a condition like `mismatch_if`, for a fault that alone never causes a refusal.

        This holds whatever the inner frames contain.
        """
        if not self.tells_wrong:
            self.mismatch_if(condition)
            return
        self.wrong.append(condition)
        if self.in_branch:
            self.flush()

    def wrong_at_last_if(self, condition: str) -> None:
        """Add a condition like `wrong_if`, for a fault that inner frames may still turn into a refusal."""
        if self.tells_wrong:
            self.wrong_at_last.append(condition)
        else:
            self.mismatch_if(condition)

    def finish(self) -> None:
        """Write the conditions and faults, then the readings that come last, when all other parts are read."""
        wrong, self.wrong = self.wrong, []
        self.flush()
        self._raise_wrong([self.flag, *wrong] if self.flag else wrong)
        for action in self.last:
            action()
        self._raise_wrong(self.wrong_at_last)

    def _raise_wrong(self, conditions: list[str]) -> None:
        if conditions:
            self.raises_wrong = True
            self.module.function("Wrong")
            with self.out.block(f"if {' or '.join(conditions)}:"):
                self.add("raise Wrong")

    def flush(self) -> None:
        """Write the conditions so far, and record the faults so far in the flag."""
        wrong, self.wrong = self.wrong, []
        if self.conditions:
            conditions, self.conditions = self.conditions, []
            self.module.function("Mismatch")
            with self.out.block(f"if {' or '.join(conditions)}:"):
                self.add(MISMATCH)
        if wrong:
            self.flag = self.flag or self.names.fresh("is_wrong")
            self.add(f"{self.flag} = {' or '.join([self.flag, *wrong])}")

    def flush_using(self, local: str) -> None:
        """Write the conditions if one of them reads a local that is about to change."""
        if any(re.search(rf"\b{local}\b", condition) for condition in (*self.conditions, *self.wrong)):
            self.flush()

    # ---- where segments stand -----------------------------------------------------------------------------

    def stands(self, segment: Segment, buffer: str, first: Offset, last: Offset) -> None:
        """Record the span of a segment; offsets that will change are kept in locals if they are needed later."""
        if segment.name is None:
            return
        path = segment.path
        if path in self.tracked:
            first, last = self._kept(segment, buffer, first, last)
        self.bounds[path] = Bounds(buffer, first, last)
        if segment.blocks or segment.is_record:
            return
        if path in self.trail:
            self.trail.remove(path)
        self.trail.append(path)

    def _kept(self, segment: Segment, buffer: str, first: Offset, last: Offset) -> tuple[Offset, Offset]:
        if segment.path in self.presets:
            start, end = self.presets[segment.path]
            self.add(f"{start}, {end} = {first.text(buffer)}, {last.text(buffer)}")
            return Offset(start, 0), Offset(end, 0)
        kept: list[Offset] = []
        for place, what in ((first, "start"), (last, "end")):
            if place.base in ("", "end"):
                kept.append(place)
            elif what == "end" and not self.in_branch and kept[0] != first and place.base == first.base:
                kept.append(kept[0].plus(place.offset - first.offset))
            else:
                local = self.names.fresh(f"{(segment.name or 'part').strip('_')}_{what}")
                self.add(f"{local} = {place.text(buffer)}")
                kept.append(Offset(local, 0))
        return kept[0], kept[1]

    def preset(self, segments: Iterable[Segment], place: str) -> None:
        """Give segments that may be absent an empty span at `place`, until they are read."""
        segments = tuple(segments)
        for leaf in standing_any_way(segments):
            if leaf.path in self.tracked and leaf.path not in self.presets:
                shown = (leaf.name or "part").strip("_")
                start, end = self.names.fresh(f"{shown}_start"), self.names.fresh(f"{shown}_end")
                self.presets[leaf.path] = start, end
                self.add(f"{start} = {end} = {place}")

    def pass_over(self, segments: Iterable[Segment], read: Iterable[Segment], place: str) -> None:
        """Give segments of later cases an empty span at `place`, after the segments that were read.

        Ranges may end with these segments.
        """
        if not self.presets:
            return
        here = {leaf.path for leaf in standing_any_way(tuple(read))}
        for path in dict.fromkeys(leaf.path for leaf in standing_any_way(tuple(segments))):
            if path in self.presets and path not in here:
                self.add(f"{' = '.join(self.presets[path])} = {place}")

    def bytes_between(self, paths: Iterable[str]) -> str:
        """Return the source of the bytes of these segments in this order."""
        pieces: list[Bounds] = []
        before = ""
        for path in paths:
            bounds = self.bounds.get(path)
            if bounds is None:
                continue
            if pieces and pieces[-1].buffer == bounds.buffer and self._follows(before, path):
                bounds = Bounds(bounds.buffer, pieces.pop().first, bounds.last)
            pieces.append(bounds)
            before = path
        return " + ".join(between(piece.buffer, piece.first, piece.last) for piece in pieces) or 'b""'

    def _follows(self, before: str, path: str) -> bool:
        if before not in self.trail or path not in self.trail:
            return False
        return self.trail.index(before) + 1 == self.trail.index(path)

    def room(self, targets: Mapping[str, PathTarget], *, plain: bool) -> str:
        """Return the source of the size of these segments in bytes, after all are read.

        `plain`: their size in memory.
        """
        fixed, parts = 0, []
        for path, target in targets.items():
            size = None if target.only is None else self.static.of(target.only).fixed
            if plain and any(isinstance(one, Data) and one.convert is not None for one in target.segments):
                value = self.locals_of_values.get(path, 'b""')
                there = target.only is not None and target.only.when is None
                parts.append(f"len({value})" if there else f"len({value} or b'')")
            elif size is not None:
                fixed += size
            else:
                parts.append(self.wire_size(path))
        return " + ".join([*([str(fixed)] if fixed or not parts else []), *parts])

    def wire_size(self, path: str) -> str:
        """Return the source of the encoded size of a segment that was read, in bytes."""
        parts = self.wire_parts.get(path, (path,))
        if parts != (path,):
            return " + ".join(self.wire_size(part) for part in parts) or "0"
        bounds = self.bounds.get(path)
        if bounds is None:
            return "0"
        first, last = bounds.first, bounds.last
        if first.base == last.base:
            return str(last.offset - first.offset)
        start = first.text(bounds.buffer)
        if " " in start:
            start = f"({start})"
        return last.text(bounds.buffer) if start == "0" else f"{last.text(bounds.buffer)} - {start}"


def paths_of(segment: Segment) -> set[str]:
    """Return the paths of a segment and of its own values."""
    return {segment.sibling_path(name) for name in (segment.name, *segment.value_names) if name}


def paths_read(segment: Segment, paths: Collection[str], *needed: str | Expression) -> frozenset[str]:
    """Return the members of `paths` that a segment needs: siblings by name, and names that its expressions read."""
    found = {segment.sibling_path(one) for one in needed if isinstance(one, str)}
    names = {name for one in needed if isinstance(one, Expression) for name in names_in(one.root)}
    found |= {nearest_path(name, segment, paths) for name in names}
    return frozenset(found & {*paths, LAST})


def tracked_paths(segments: tuple[Segment, ...]) -> set[str]:
    """Return the paths of the segments whose spans are needed.

    Spans are needed for checks, for lengths, and for `len(name)` of values without a length.
    """
    found: set[str] = set()
    for segment in everything(segments):
        if isinstance(segment, Check):
            found.update(covered_paths(segment, segments))
        if isinstance(segment, Length) and not is_followed(segment, segments):
            counted = (one for one in everything(segments) if one.path in segment.counted)
            found.update(segment.counted, (part.path for part in on_the_wire(counted)))
    asked = lengths_asked(segments)
    found.update(one.path for one in everything(segments) if one.name in asked)
    return found


def wire_paths(segments: Segments, paths: Iterable[str]) -> list[str]:
    """Return the paths of the parts that take bytes; a choice or `optional` is replaced by its content."""
    found: list[str] = []
    for path in paths:
        every = segments_at(path, segments)
        inside = any(one.has_cases for one in every)
        found += [part.path for part in on_the_wire(every)] if inside else [path]
    return found


def on_the_wire(segments: Iterable[Segment]) -> Iterator[Segment]:
    """Yield the segments that take bytes of their buffer: the content of records and cases, but wraps as a whole."""
    for segment in segments:
        inside = segment.blocks if segment.inner_record is None else (segment.inner_record,)
        if segment.is_there_inside or segment.is_list or not inside:
            if segment.takes_bytes:
                yield segment
            continue
        for block in inside:
            yield from on_the_wire(block)


def standing_any_way(segments: Segments) -> Iterator[Segment]:
    """Yield the segments that take bytes, the content of wraps as well as the wraps themselves."""
    yield from leaves(segments)
    yield from (one for one in on_the_wire(segments) if one.is_there_inside)


def standing(check: Check, segments: Iterable[Segment]) -> Iterator[Segment]:
    """Yield the segments that take bytes for a check.

    A wrap is yielded as a whole if the check covers encoded bytes; otherwise its content is yielded.
    """
    return on_the_wire(segments) if check.wire else leaves(segments)


def covers_later(check: Check, segments: tuple[Segment, ...]) -> bool:
    """Return whether a check covers a later segment."""
    order = [one.path for one in standing(check, segments)]
    if check.path not in order:
        return False
    return not set(order[order.index(check.path) + 1 :]).isdisjoint(covered_paths(check, segments))


def covered_paths(check: Check, segments: tuple[Segment, ...]) -> list[str]:
    """Return the paths of the segments in a check's `over`, in order."""
    return [path for part in covered_parts(check, segments) if isinstance(part, list) for path in part]


def covered_parts(check: Check, segments: tuple[Segment, ...]) -> list[list[str] | Added]:
    """Return the operands of a check's `over`: paths of runs of segments, and added bytes that are not transmitted."""
    found: list[list[str] | Added] = []
    for part in check.covers or ():
        if isinstance(part, Added):
            found.append(part)
            continue
        paths = paths_in_part(part, check, segments)
        if found and isinstance(found[-1], list):
            found[-1] += paths
        else:
            found.append(paths)
    return found


def paths_in_part(part: str | Edges, check: Check, segments: tuple[Segment, ...]) -> list[str]:
    """Return the paths of the segments of an operand of `over`: of a name, or of a range.

    Segments of several cases that share a path appear once.
    """
    if isinstance(part, str):
        named = (one for one in everything(segments) if one.path == check.sibling_path(part))
        return list(dict.fromkeys(one.path for one in standing(check, named)))
    order = list(dict.fromkeys(one.path for one in standing(check, segments)))
    first, last = part  # only the end may be the check itself: a field may have the name "here"
    edges = [check.sibling_path(first), check.path if last == "here" else check.sibling_path(last)]
    ends = {one.path: [leaf.path for leaf in standing(check, (one,))] for one in everything(segments)}
    first, last = (ends.get(edges[0]) or edges)[0], (ends.get(edges[1]) or edges)[-1]
    if first not in order or last not in order:
        lists = (one.of for one in everything(segments) if isinstance(one, Repeat) and isinstance(one.of, tuple))
        inside = (of for of in lists if any(leaf.path == check.path for leaf in leaves(of)))
        return next((paths_in_part(part, check, of) for of in inside), [])
    return order[order.index(first) : order.index(last) + (part[1] != "here")]


@dataclass(frozen=True, slots=True)
class Offset:
    """`offset` bytes after `base`: '' is the start and 'end' the end of the buffer, other names are locals."""

    base: str
    offset: int

    def plus(self, size: int) -> Offset:
        return Offset(self.base, self.offset + size)

    def text(self, buffer: str) -> str:
        """Return the source of the offset as a number."""
        if self.base == "":
            return str(self.offset)
        base = f"len({buffer})" if self.base == "end" else self.base
        return _sum(base, self.offset)


def _sum(base: str, offset: int) -> str:
    if offset == 0:
        return base
    return f"{base} + {offset}" if offset > 0 else f"{base} - {-offset}"


def index(buffer: str, place: Offset) -> str:
    """Return the source of a byte of the buffer."""
    return f"{buffer}[{place.offset if place.base == 'end' else place.text(buffer)}]"


def between(buffer: str, first: Offset, last: Offset) -> str:
    """Return the source of the bytes between two offsets."""
    if first == Offset("", 0) and last == Offset("end", 0):
        return buffer
    start = "" if first == Offset("", 0) else _bound(buffer, first)
    stop = "" if last == Offset("end", 0) else _bound(buffer, last)
    spaced = " " in start or " " in stop
    colon = " : " if spaced and start and stop else " :" if spaced and start else ": " if spaced else ":"
    return f"{buffer}[{start}{colon}{stop}]"


def _bound(buffer: str, place: Offset) -> str:
    if place.base == "end":
        return str(place.offset) if place.offset else f"len({buffer})"
    return place.text(buffer)


class Fields:
    """A dictionary in generated code: a literal as long as possible, then a variable to which values are added."""

    def __init__(self, variable: str, outer: tuple[Fields, str] | None = None) -> None:
        self.variable = variable
        self.outer = outer
        self.entries: list[tuple[str, str | Fields]] = []
        self.is_open = False

    def attach(self) -> None:
        """Become a value of the outer dictionary, when the first value is read."""
        if self.outer is not None:
            (fields, name), self.outer = self.outer, None
            fields.add(name, self)

    def add(self, name: str, value: str | Fields) -> None:
        self.attach()
        self.entries.append((name, value))

    def text(self, out: Source) -> str:
        """Return the dictionary as an expression with all values added so far."""
        if self.is_open:
            self.flush(out)
            return self.variable
        parts = [
            f"{quoted(name)}: {value if isinstance(value, str) else value.text(out)}" for name, value in self.entries
        ]
        return "{" + ", ".join(parts) + "}"

    def open(self, out: Source) -> None:
        """Turn the literal into a variable, so that later values may be conditional."""
        if self.is_open:
            self.flush(out)
            return
        out.add(f"{self.variable} = {self.text(out)}")
        self.is_open = True
        self.entries = []

    def flush(self, out: Source) -> None:
        """Write the pending values to the variable; a literal remains unchanged."""
        if not self.is_open:
            return
        entries, self.entries = self.entries, []
        for name, value in entries:
            out.add(f"{self.variable}[{quoted(name)}] = {value if isinstance(value, str) else value.text(out)}")
