"""Write encoders: one function per frame that takes values, computes the rest, and returns bytes.

First all values are assigned to locals in the order of their dependencies. Then the bytes are assembled: runs of fixed
segments are packed at once, other segments individually, check codes over the bytes so far. The kinds of segments write
their own values and bytes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from framekit.codec.python import forms
from framekit.codec.python.encode_plan import (
    Coverage,
    PackArgument,
    PackPlan,
    RuleWriter,
    Task,
    is_literal,
    run_in_order,
    sum_of,
)
from framekit.codec.python.expressions import FieldScope, NameEntry, constant_of, default_text
from framekit.codec.python.facts import by_path, ending_constants, lengths_asked, size_follows_value, values_read
from framekit.codec.python.forms import code_bytes, needs
from framekit.codec.python.function import FunctionWriter, covers_later, on_the_wire
from framekit.codec.python.module import Module
from framekit.codec.python.reader import not_possible
from framekit.codec.python.registry import kind_of, struct_order, summary, write_docstring
from framekit.codec.python.source import MOST_NAMES, Code, Source, bytes_literal, literal, quoted, text_source
from framekit.definition.expression import (
    AND,
    BIT_OR,
    OR,
    PRODUCT,
    Attribute,
    Call,
    Expression,
    Index,
    Name,
    Node,
    children,
    walk,
)
from framekit.definition.model.frames import (
    Frame,
    bytes_of,
    everything,
    expressions_of,
    flat,
    in_place_of_records,
    leaves,
    names_read,
    parts_of,
    without_when,
)
from framekit.definition.model.segments import (
    Bits,
    Check,
    Const,
    Count,
    Data,
    Field,
    FieldType,
    Fill,
    Inner,
    Length,
    Repeat,
    Segment,
)
from framekit.definition.problems import DefinitionError
from framekit.definition.wire_types import shown_stops

Placed = tuple[Segment, FieldScope]
"""A segment and the scope of its names."""
CIRCLE = "its size goes round in a circle: such a frame can be read, not built"
"""The message for a size that depends on itself."""
Waiting = tuple[str, Check, FieldScope]
"""A check code that covers later bytes: the mark in its place, the check, and the scope of its names."""
Cases = list[tuple[str, tuple[Segment, ...] | None]]
"""Header line of each branch, with its segments; None marks a forbidden case."""


@dataclass(slots=True)
class ConsumedValues:
    """A mapping of values while it is consumed."""

    text: str
    """The source of the mapping."""
    rules: str
    """The source of the rules of its values."""
    path: tuple[str | Code, ...] = ()
    """The path of the mapping, for messages."""
    needed: int = 0
    """The number of values that must be given."""
    names: list[str] = field(default_factory=list)
    """All names that the mapping may contain."""
    computed: dict[str, str] = field(default_factory=dict)
    """The source of each computed value, by name."""
    in_cases: tuple[str, str] | None = None
    """The locals that hold the computed values of the chosen cases, and the names of the other cases."""
    conditional: list[tuple[Segment, FieldScope]] = field(default_factory=list)
    """The segments of these values that have a condition of their own."""

    def value(self, name: str) -> str:
        """Return the source of a value that must be given."""
        return f"{self.text}[{quoted(name)}]"

    def value_or(self, name: str, otherwise: str) -> str:
        """Return the source of a value, or of a constant if it is not given."""
        return f"{self.text}.get({quoted(name)}, {otherwise})"

    def value_or_worked_out(self, name: str, otherwise: str) -> str:
        """Return the source of a value, or of a computed value if it is not given."""
        return f"{self.value(name)} if {quoted(name)} in {self.text} else {otherwise}"


Number = Field | Length | Count | Bits
"""The segments that hold a number."""


@dataclass(slots=True)
class _Region:
    """The bytes of a list of segments while they are written."""

    buffer: str
    """The local for all bytes so far."""
    before: str
    """The source of the bytes before the region, which checks may cover."""
    texts: list[str] = field(default_factory=list)
    """The source of each part."""
    waiting: list[Waiting] = field(default_factory=list)
    """The check codes that cover later bytes."""


class _Ended(NamedTuple):
    """A text that ends before one of several bytes, with the locals of the bytes that follow it."""

    segment: Segment
    scope: FieldScope
    behind: list[str]


@dataclass(slots=True)
class KeptBytes:
    """Some bytes of a buffer that checks may cover."""

    paths: tuple[str, ...]
    """The paths of the segments in these bytes."""
    text: str
    """The source of the bytes."""
    on_wire: bool | None = None
    """True for checks that cover wraps in encoded form, False for the other checks, None for both."""


def write_encoder(
    module: Module, identifier: str, name: str, segments: tuple[Segment, ...], frame: Frame | None
) -> Source:
    """Return the source of `encode_…` of a frame, or of a layout if `frame` is None."""
    rules = module.rules(identifier, RuleWriter(module, identifier).mapping(segments))
    writer = EncodeWriter(module, identifier, segments)
    given = ConsumedValues("values", rules)
    scope = FieldScope()
    writer.values(segments, scope, given)
    writer.flush()
    writer.check_names(given)
    text = writer.region(segments, scope, writer.buffer, tail=tail_of(module, frame), is_whole=True)
    longest = module.static.all(segments).most
    if frame is not None and frame.most is not None and (longest is None or longest > frame.most):
        writer.limit(text, frame.most)
        text = writer.buffer
    out = Source()
    kind = "frame" if frame is not None else "layout"
    with out.block(f"def encode_{identifier}(values: Mapping[str, Any], ctx: Context = DEFAULTS) -> bytes:"):
        write_docstring(out, f"Build the {kind} `{name}`. Raises EncodeError.", summary(segments))
        with out.block("try:"):
            out.extend(writer.out)
            built, texts = as_bytes(text, segments), texts_inside(segments) if frame is not None else {}
            if texts:
                read_back = module.function("read_back")
                built = f"{read_back}({built}, values, decode_{identifier}, ctx, {literal(tuple(texts.items()))})"
            out.add(f"return {built}")
        with out.block("except MISMATCHES as error:"):
            out.add(f"raise {module.function('encode_error')}(values, {rules}, error) from None")
    return out


def texts_inside(segments: Iterable[Segment]) -> dict[tuple[str, ...], str]:
    """Return the paths of texts in lists, cases and similar that end before certain bytes, with these bytes in words.

    The byte after the text is known only when the frame is built. `region` checks texts at the top level that end
    before single bytes.
    """
    found: dict[tuple[str, ...], tuple[bytes, ...]] = {}

    def look(segments: Iterable[Segment], path: tuple[str, ...], is_inside: bool) -> None:
        for segment in segments:
            of = segment.plain_type if isinstance(segment, Repeat) else segment.number_type
            here = (*path, segment.name or "")
            is_open = is_inside or isinstance(segment, Repeat)
            if isinstance(of, FieldType) and of.stops and (is_open or of.has_long_stops):
                found[here] = found.get(here, ()) + of.stops
            if isinstance(segment, Repeat) and segment.single:
                continue
            if segment.inner_record is not None:
                look(segment.inner_record, here, True)
            for block in segment.blocks if segment.inner_record is None else ():
                look(block, path, True)

    look(segments, (), False)
    return {path: shown_stops(stops) for path, stops in found.items()}


def tail_of(module: Module, frame: Frame | None) -> tuple[Const, int | Segment] | None:
    """Return the constant that ends a delimited body, and the size of the head or the segment that follows the head.

    The segment is returned if the size of the head varies. None if the first byte of that constant is impossible in the
    body.
    """
    if frame is None or not frame.delimited or not frame.tail or not isinstance(frame.tail[0], Const):
        return None
    if frame.tail[0].data[0] not in bytes_of(frame.body, module.static.frames):
        return None
    head = module.static.all(frame.head).fixed
    if head is not None:
        return frame.tail[0], head
    return frame.tail[0], next(one for one in in_place_of_records((*frame.body, *frame.tail)) if one.takes_bytes)


def as_bytes(text: str, segments: tuple[Segment, ...]) -> str:
    """Return source that gives bytes, even if it begins with a given value, which may be a bytearray."""
    first = next(leaves(segments), None)
    is_given = isinstance(first, Data) or (isinstance(first, Field) and first.type.kind == "bytes")
    is_packed = text[0].isupper() or text.startswith('b"')
    return f'b"" + {text}' if is_given and not is_packed else text


def _given_in(segments: Iterable[Segment]) -> set[str]:
    """Return the tokens that the segments of a record provide to waiting tasks."""
    found: set[str] = set()
    for segment in flat(segments):
        found |= {f"{what}{name}" for name in segment.value_names for what in ("", "items of ")}
        found.add(f"bytes of {segment.path}")
    return found


def _covered_itself(check: Check) -> DefinitionError:
    return not_possible(check, "a check covers what comes later, and is covered itself", "put it last")


class EncodeWriter(FunctionWriter):
    """Write an encoder.

    The attributes `asked_for`, `targets`, `rooms`, `wires`, `plains`, `late` and `postponed` refer to segments by path.
    """

    def __init__(self, module: Module, title: str, segments: tuple[Segment, ...]) -> None:
        super().__init__(module, segments)
        self.title = title
        self.conditions: list[str] = []
        self.read_names = names_read(segments)
        nodes = (node for expression in expressions_of(segments) for node in walk(expression.root))
        self.fields_read = {node.name for node in nodes if isinstance(node, Attribute)}
        """Attributes of records and items that expressions read."""
        self.asked_for = {
            path for segment in everything(segments) if isinstance(segment, Length) for path in segment.counted
        }
        """Segments whose bytes a length counts, and frames whose length an expression reads."""
        self.values_read = values_read(segments) | self.fields_read
        """Names and attributes of which expressions read more than the length."""
        measured = lengths_asked(segments)
        self.asked_for |= {one.path for one in everything(segments) if one.name in measured and one.frames_inside}
        """Segments whose bytes a length counts, and frames whose length an expression reads."""
        self.wires: dict[str, str] = {}
        """The local with the bytes of a segment."""
        self.targets = by_path(segments)
        """The segments of the record being written and of the records around it."""
        self.meant = dict(self.by_name)
        """The segment of each name in the record being written."""
        self.rooms: dict[str, str] = {}
        """The local with the size of a segment that belongs to one of several cases."""
        self.counts: dict[str, str] = {}
        """The local with the number of values in a list, by the local of the list."""
        self.coverage = Coverage(segments)
        self.ends = dict(ending_constants(self.static, segments))
        """The constants that end a part, by path and position of the part."""
        self.buffer = "frame"
        """The local with the bytes of the whole frame."""
        self.gathered: dict[str, str] = {}
        """The buffer that holds a sum of bytes, by the text of the sum."""
        self.parts: list[KeptBytes] = []
        """The bytes that checks may cover."""
        self.plains: dict[str, str] = {}
        """The local with the covered bytes of a segment that may be absent."""
        self.begun: set[str] = set()
        """The buffers that have been assigned."""
        self.late: dict[str, list[tuple[str, tuple[Segment, ...], FieldScope]]] = {}
        """The cases of a choice with check codes: header, segments, scope."""
        self.postponed: set[str] = set()
        """The checks that wait for bytes after them."""

    def refuse_if(self, condition: str) -> None:
        """Refuse the values if `condition` holds; the rules explain the reason."""
        if condition not in self.conditions:
            self.conditions.append(condition)

    def complain(self, condition: str, field: str, message: str) -> None:
        """Refuse the values if `condition` holds; `field` and `message` are source."""
        with self.out.block(f"if {condition}:"):
            self.add(f"raise EncodeError({field}, {message})")

    def compare_size(self, path: tuple[str | Code, ...], found: str, wanted: str, conditions: list[str]) -> None:
        """Refuse a value whose size (source) differs from the expected size, if all conditions hold."""
        self.add_if(conditions, f"{self.module.function('check_size')}({text_source(*path)}, {found}, {wanted})")

    def add_if(self, conditions: list[str], line: str) -> None:
        """Write a line that runs if all conditions hold, or always if the list is empty."""
        if not conditions:
            self.add(line)
            return
        with self.out.block(f"if {' and '.join(conditions)}:"):
            self.add(line)

    def flush(self) -> None:
        if self.conditions:
            conditions, self.conditions = self.conditions, []
            self.module.function("Mismatch")
            with self.out.block(f"if {' or '.join(conditions)}:"):
                self.add("raise Mismatch")

    def context(self, name: str) -> str:
        """Return the source of a context value, which is read at each use."""
        return self.module.given(self.module.known(name, self.segments))

    def text(self, expression: Expression, scope: FieldScope, level: int = 0) -> str:
        return self.writer(scope).text(expression, level)

    def if_present(self, segment: Segment, scope: FieldScope, text: str, otherwise: str) -> str:
        """Return the source, made conditional on the segment's condition."""
        if segment.when is None:
            return text
        return f"({text} if {self.text(segment.when, scope, OR)} else {otherwise})"

    # ---- what expressions wait for ------------------------------------------------------------------------

    def waits(self, *expressions: Expression | None) -> set[str]:
        """Return the tokens that must be available before these expressions can be evaluated."""
        found: set[str] = set()
        for expression in expressions:
            if expression is not None:
                found |= self._tokens(expression.root)
        return found

    def _tokens(self, node: Node) -> set[str]:
        if isinstance(node, Call) and node.function == "len" and isinstance(node.arguments[0], Name):
            name = node.arguments[0].name
            return self.room_tokens(self.meant[name].path) if self._has_no_length(name) else {name}
        if isinstance(node, (Attribute, Index)) and isinstance(node.value, Name):
            inner = {token for child in children(node) if child is not node.value for token in self._tokens(child)}
            return inner | {f"items of {node.value.name}" if self._is_records(node.value.name) else node.value.name}
        if isinstance(node, Name):
            return {f"items of {node.name}" if self._is_records(node.name) else node.name}
        return {token for child in children(node) for token in self._tokens(child)}

    def _is_records(self, name: str) -> bool:
        segment = self.meant.get(name)
        return isinstance(segment, Repeat) and isinstance(segment.of, tuple)

    def _has_no_length(self, name: str) -> bool:
        segment = self.meant.get(name)
        if isinstance(segment, Field):
            return segment.type.kind not in ("ascii", "bytes")
        return segment is not None and not isinstance(segment, (Data, Repeat))

    @contextmanager
    def names_of(self, segments: Iterable[Segment]) -> Iterator[None]:
        """Resolve names to the segments of a record while its segments are written."""
        segments = tuple(segments)
        outside = self.targets, self.meant
        self.targets = self.targets | by_path(segments)
        self.meant = self.meant | {one.name: one for one in flat(segments) if one.name}
        yield
        self.targets, self.meant = outside

    def size_by_length(self, segment: Segment) -> Expression | None:
        """Return the size of a segment if it is exactly a length counting it, so that it follows the given value.

        None for any other size.
        """
        return segment.size_expression if size_follows_value(segment, self.by_path) else None

    def fills_up(self, item: Data | Field) -> bool:
        """Return whether a short value is padded to a size that other values state."""
        if isinstance(item, Data):
            return item.pad is not None and item.size != "rest" and self.size_by_length(item) is None
        is_filled = item.type.pad is not None or item.type.end is not None
        return is_filled and isinstance(item.type.size, Expression) and self.size_by_length(item) is None

    def bounded(self, size: Expression, scope: FieldScope) -> str:
        """Return the source of a computed size with an upper bound, so that padding is bounded."""
        return f"{self.module.function('room')}({self.text(size, scope)})"

    # ---- room ---------------------------------------------------------------------------------------------

    def room(self, paths: Iterable[str], scope: FieldScope, *, plain: bool = False) -> str:
        """Return the source of the encoded size of these segments in bytes; `plain`: the size before conversion."""
        fixed, parts = 0, []
        for path in paths:
            target = self.targets.get(path)
            if target is None:
                continue
            segment = target.only
            if segment is None:
                if path not in self.rooms:
                    raise not_possible(
                        target.segments[0],
                        f"the size of '{target.segments[0].name}' goes round in a circle",
                        "size it by that length alone",
                    )
                parts.append(self.rooms[path])
                continue
            size = self.static.present(segment).fixed
            if size is not None and not (plain and isinstance(segment, Data)):
                if segment.when is None:
                    fixed += size
                else:
                    parts.append(self.if_present(segment, scope, str(size), "0"))
            elif text := self._size_of(segment, scope, plain):
                parts.append(text)
        return " + ".join([*([str(fixed)] if fixed or not parts else []), *parts])

    def is_other(self, local: str, type_: str) -> str:
        """Return the source of the condition that a value is not exactly of a type."""
        return f"type({local}) is not {type_}"

    def local_of(self, segment: Segment, scope: FieldScope) -> str:
        """Return the local of a segment's value, empty if it has none."""
        entry = scope.find(segment.name or "")
        return "" if entry is None else entry.text

    def _size_of(self, segment: Segment, scope: FieldScope, plain: bool) -> str:
        wire = self.wires.get(segment.path)
        if wire is not None:
            return f"len({wire})"
        if segment.path in self.rooms:
            return self.rooms[segment.path]
        text = kind_of(segment).room(self, segment, scope, plain)
        if text is None:  # a length counts bytes that can only be assembled after the length is known
            self.add(f"raise EncodeError({quoted(segment.name or '')}, {quoted(CIRCLE)})")
            text = "0"
        return self.if_present(segment, scope, text, "0")

    def room_tokens(self, path: str) -> set[str]:
        """Return the tokens that must be available before the encoded size of a segment can be computed."""
        target = self.targets.get(path)
        if target is None:
            return set()
        segment = target.only
        if segment is None:
            return {f"bytes of {path}"}
        found = self.waits(segment.when)
        if self.static.present(segment).fixed is not None:
            return found
        waits: set[str] = kind_of(segment).room_waits(self, segment)
        return waits if waits == {f"bytes of {path}"} else found | waits

    def count_of(self, local: str) -> str:
        """Return the source of the number of values in a list."""
        return self.counts.get(local, f"len({local})")

    def local(self, name: str, given: ConsumedValues) -> str:
        """Return a new local for a value."""
        return self.names.fresh(name)

    def bind(self, local: str, text: str) -> None:
        """Assign a value to its local."""
        self.add(f"{local} = {text}")

    def or_nothing(self, name: str, text: str, when: Expression | None, scope: FieldScope) -> str:
        """Return the source of a value for expressions: None if the segment is absent."""
        if when is None or name not in self.read_names | self.fields_read:
            return text
        return f"({text} if {self.text(when, scope, OR)} else None)"

    def if_there(self, text: str, when: Expression | None, scope: FieldScope, otherwise: str = "None") -> str:
        """Return source that is evaluated only if the segment is present."""
        return text if when is None else f"({text}) if {self.text(when, scope, OR)} else {otherwise}"

    def computed(
        self,
        name: str,
        expression: Expression,
        local: str,
        scope: FieldScope,
        given: ConsumedValues,
        when: Expression | None,
    ) -> str:
        number = constant_of(expression)
        if number is None:
            self.add(f"{local} = {self.if_there(self.writer(scope).value(expression), when, scope)}")
        text = local if number is None else str(number)
        given.computed[name] = text
        return text

    def wanted(self, name: str, given: ConsumedValues) -> str:
        """Return the source of a required value; in a record the source reports a missing value with its full path."""
        if not given.path:
            return given.value(name)
        return f"{self.module.function('needed')}({given.text}, {quoted(name)}, {text_source(*given.path)})"

    def with_missing(self, scope: FieldScope, given: ConsumedValues, missing: set[str]) -> FieldScope:
        """Return a scope in which names that are not computed yet refer to the given values."""
        inner = FieldScope(scope)
        inner.entries = {name: NameEntry(self.wanted(name, given)) for name in sorted(missing)}
        return inner

    def validate_range(self, item: Segment, scope: FieldScope, local: str, limits: forms.Range) -> None:
        if limits.least is not None and limits.most is not None:
            self.refuse(item, scope, f"not {limits.least} <= {local} <= {limits.most}")
        elif limits.least is not None:
            self.refuse(item, scope, f"{local} < {limits.least}")

    def refuse_digits(self, item: Field | Length | Count, scope: FieldScope, text: str) -> None:
        """Write the check that a computed number fits its hex digits, since formatting it does not check this."""
        if forms.hex_places(item.type) is None or text.isdigit():
            return
        limits = forms.value_range(item)
        if isinstance(item, Field) or item.plus < 0:
            self.validate_range(item, scope, text, limits)
        else:
            self.refuse(item, scope, f"{text} > {limits.most}")

    def refuse(self, item: Segment, scope: FieldScope, condition: str) -> None:
        """Refuse the values like `refuse_if`, but only if the segment is present."""
        self.refuse_where(item.when, scope, condition)

    def refuse_where(self, when: Expression | None, scope: FieldScope, condition: str) -> None:
        """Refuse the values like `refuse_if`, but only if the condition `when` of the segment holds."""
        self.refuse_if(condition if when is None else f"({self.text(when, scope, AND)} and {condition})")

    def complain_where(
        self, when: Expression | None, scope: FieldScope, condition: str, field: str, message: str
    ) -> None:
        """Refuse the values like `complain`, but only if the condition `when` of the segment holds."""
        there = "" if when is None else f"{self.text(when, scope, AND)} and "
        self.complain(f"{there}{condition}", field, message)

    def refuse_others(
        self,
        name: str,
        local: str,
        constants: tuple[int | str | bytes, ...],
        when: Expression | None,
        scope: FieldScope,
    ) -> None:
        shown = ", ".join(repr(constant) for constant in constants)
        message = text_source(f"'{name}' is one of {shown}, not ", Code(f"repr({local})"))
        self.complain_where(when, scope, f"{local} not in {literal(constants)}", quoted(name), message)

    # ---- data ---------------------------------------------------------------------------------------------

    def is_measured(self, name: str) -> bool:
        """Return whether other values depend on the length of data."""
        return bool(self.asked_for) or name in self.read_names

    def no_bytes(self, local: str) -> None:
        """Write the conversion of other bytes-like values to bytes, as their length may count larger elements."""
        with self.out.block(f"if {self.is_other(local, 'bytes')} and {self.is_other(local, 'bytearray')}:"):
            self.add(f'{local} = b"" + {local}')

    def sized_as_told(
        self, item: Field | Data, name: str, told: Expression, scope: FieldScope, given: ConsumedValues
    ) -> None:
        """Write the check that a value has the size that other values state; a padded value may be shorter."""
        local, size = scope.entries[name].text, self.text(told, scope)
        is_text = isinstance(item, Field) and self.fills_up(item)
        found = f"max(len({local}), {size})" if is_text else f"len({local})"
        self.compare_size((*given.path, name), found, size, self.is_known(item.when, told, scope))

    def is_known(self, when: Expression | None, told: Expression, scope: FieldScope) -> list[str]:
        """Return the conditions that a segment is present, and that the announced state in its size is known."""
        found = [] if when is None else [self.text(when, scope, AND)]
        for other in sorted(self.waits(told)):
            state = self.module.protocol.state.get(other)
            if state is not None and state.announced and scope.find(other) is None:
                found.append(f"{self.module.given(other)} is not None")
        return found

    def values(self, segments: Iterable[Segment], scope: FieldScope, given: ConsumedValues) -> None:
        """Write all values of a list of segments, including those in its wraps."""
        segments = tuple(segments)
        if given.in_cases is None and any(segment.has_cases for segment in flat(segments)):
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

    def tasks_of(self, segment: Segment, scope: FieldScope, given: ConsumedValues, tasks: list[Task]) -> None:
        """Add the tasks of a segment to `tasks`, and its names to `given`."""
        given.names.extend(segment.value_names)
        if segment.when is not None and segment.condition is None:
            given.conditional.append((segment, scope))
        tasks.extend(kind_of(segment).tasks(self, segment, scope, given))

    def check_names(self, given: ConsumedValues) -> None:
        """Write the check that values beyond the required ones are known, or equal the computed values."""
        check = self.module.function("check_given")
        computed = "{" + ", ".join(f"{quoted(name)}: {text}" for name, text in given.computed.items()) + "}"
        options = f", {text_source(*given.path)}" if given.path else ""
        absent = [f"() if {there} else {literal(names)}" for there, names in self.conditions_of(given)]
        if absent:
            options += f", absent={absent[0] if len(absent) == 1 else ' + '.join(f'({text})' for text in absent)}"
        if given.in_cases is not None:
            computed = f"{given.in_cases[0]} | {computed}" if given.computed else given.in_cases[0]
            options += f", elsewhere={given.in_cases[1]}"
        more = self.more_than_needed(given)
        if given.needed and given.computed and not absent and given.in_cases is None and not given.path:
            constants = {name: text for name, text in given.computed.items() if text.isdecimal()}
            if constants:  # constants may be given too
                same = " and ".join(f"{given.text}.get({quoted(name)}) == {text}" for name, text in constants.items())
                more += f" and not (len({given.text}) == {given.needed + len(constants)} and {same})"
        with self.out.block(f"if {more}:"):
            self.add(f"{check}({given.text}, {given.rules}, {computed}{options})")

    def more_than_needed(self, given: ConsumedValues) -> str:
        """Return the source of the condition that values are given beyond those that may be given without a check."""
        conditional = {name for _, names in self.conditions_of(given) for name in names}
        free = set(given.names) - set(given.computed) - conditional
        beyond = ""
        if given.in_cases is None and len(free) > given.needed:  # this test takes half the time of the call
            beyond = f" and not {self.module.among(free, self.title)}({given.text})"
        if not given.needed:  # no value was read from it, so it may not be a mapping
            return f"{given.text} != {{}}{beyond}"
        return f"len({given.text}) != {given.needed}{beyond}"

    def conditions_of(self, given: ConsumedValues) -> list[tuple[str, tuple[str, ...]]]:
        """Return the conditions (source) of conditional values, each with the names of the values."""
        found: dict[str, list[str]] = {}
        for segment, scope in given.conditional:
            assert segment.when is not None
            text = self.text(segment.when, scope, OR)
            for name in segment.value_names:
                found.setdefault(name, []).append(text)
            if isinstance(segment, Field) and segment.default is not None:  # a reader returns the default in this case
                default = default_text(self.text(segment.default, scope, BIT_OR), segment)
                found[segment.name].append(f"{scope.entries[segment.name].text} == {default}")
        together: dict[str, list[str]] = {}
        for name, texts in found.items():
            together.setdefault(" or ".join(texts), []).append(name)
        return [(text, tuple(names)) for text, names in together.items()]

    def refuse_absent(self, given: ConsumedValues) -> None:
        """Record given values of a case whose condition is false.

        The generated encoder refuses them like values of other cases.
        """
        for there, names in self.conditions_of(given):
            assert given.in_cases is not None
            with self.out.block(f"if not ({there}):"):
                nothing = f"if {given.text}.get(name) is not None"
                self.add(f"{given.in_cases[1]} += tuple(name for name in {literal(names)} {nothing})")

    def own_room(self, segment: Length | Count | Bits, scope: FieldScope) -> str:
        """Return the source of the encoded size of a number in bytes."""
        size = segment.type.size
        text = self.text(size, scope, PRODUCT + 1) if isinstance(size, Expression) else str(size)
        return self.if_present(segment, scope, text, "0")

    # ---- lengths, counts, values, conditions --------------------------------------------------------------

    def size_waits(self, number: Length | Count) -> set[str]:
        """Return the tokens that must be available before the presence and size of a number are known."""
        size = number.type.size
        return self.waits(number.when, size if isinstance(size, Expression) else None)

    def outer_names(self, segment: Segment) -> set[str]:
        """Return the tokens that a segment reads but does not provide itself."""
        follow = {id(size) for one in everything((segment,)) if (size := self.size_by_length(one)) is not None}
        if isinstance(segment, Repeat):
            follow.add(id(segment.times))  # compared after the items are built; a length over them may provide it
        return self._read_in(segment, follow) - _given_in(one for block in segment.blocks for one in block)

    def _read_in(self, segment: Segment, follow: set[int]) -> set[str]:
        """Return the tokens that a segment and its content wait for, except those its records provide.

        Expressions in `follow` are ignored.
        """
        own = expressions_of(segment.with_lists(lambda _: ()))
        found = self.waits(*(one for one in own if id(one) not in follow))
        if isinstance(segment, Length):
            found.update(token for path in segment.counted for token in self.room_tokens(path))
        elif isinstance(segment, Count):
            found.add(segment.of)
        for block in segment.blocks:
            found.update(*(self._read_in(one, follow) for one in block))
        if segment.inner_record is not None:
            with self.names_of(segment.inner_record):
                inside = set().union(*(self._read_in(one, follow) for one in segment.inner_record))
            found |= inside - _given_in(segment.inner_record)
        return found

    def plain_given(self, segment: Segment, scope: FieldScope, given: ConsumedValues) -> None:
        """Write the assignment of a value that must be given to a local."""
        name = segment.value_names[0]
        local = self.local(name, given)
        if segment.when is None:
            given.needed += 1
            self.bind(local, given.value(name))
        else:
            key, empty = self.wanted(name, given), "()" if segment.is_list else "None"
            self.add(f"{local} = {key} if {self.text(segment.when, scope, OR)} else {empty}")
        scope.entries[name] = NameEntry(
            local, "list" if segment.is_list else "inner", FieldScope(), sized=not segment.frames_inside
        )

    # ---- runs ---------------------------------------------------------------------------------------------

    def length_of_run(self, placed: list[Placed]) -> int:
        """Return how many of the segments can be packed at once."""
        order, first = "", placed[0][0]
        mark = self.coverage.of(leaf.path for leaf in leaves((first,)))
        for count, (segment, scope) in enumerate(placed):
            numbers = self.numbers_of(segment)
            wanted = None if isinstance(segment, (Check, Fill)) else struct_order(without_when(segment))
            if numbers is not None and count:
                wanted = numbers[1]
            same_when = str(segment.when) == str(first.when) and (segment.when is None or scope is placed[0][1])
            marked = self.coverage.of((segment.path,)) != mark
            if wanted is None or not same_when or marked or (order and wanted and wanted != order):
                return max(count, 1)
            if numbers is not None:
                return count + 1
            order = order or wanted
        return len(placed)

    def numbers_of(self, segment: Segment) -> tuple[str, str] | None:
        """Return the `struct` code and byte order of a list of numbers, which ends a run.

        None for all other segments.
        """
        if not isinstance(segment, Repeat) or not isinstance(segment.of, FieldType) or segment.path in self.wires:
            return None
        if (segment.path, segment.at) in self.ends:
            return None
        code = forms.struct_code(segment.of)
        return None if code is None or code == ("B", "") or code[0].endswith("s") else code

    def run(self, placed: list[Placed]) -> str:
        """Return the source of the bytes of a run, made conditional on the common condition of its segments."""
        segment, scope = placed[0]
        if len(placed) == 1 and (struct_order(without_when(segment)) is None):
            return self._ended(segment, self.single(segment, scope))
        last, numbers = placed[-1], self.numbers_of(placed[-1][0])
        plan = PackPlan(self.module, self.title)
        for one, inside in placed if numbers is None else placed[:-1]:
            size = self.static.present(one).fixed or 0
            plan.add(kind_of(one).argument(self, one, inside, size))
        if numbers is None:
            text = plan.text()
        else:  # one struct packs the run and the list
            (code, order), local = numbers, last[1].entries[last[0].name or ""].text
            before, texts = plan.finished()
            packs = self.packs(local, before, code, plan.order or order)
            text = f"{packs}[{self.count_of(local)}]({', '.join([*texts, f'*{local}'])})"
        return self.if_present(segment, scope, text, 'b""')

    def number_argument(self, segment: Number, scope: FieldScope, size: int) -> PackArgument:
        """Return the pack argument of a number of fixed size."""
        wire = self.wire(segment, scope)
        if forms.hex_places(segment.type) is not None:
            return PackArgument(f"{size}s", "", wire, (segment.type,))
        code, order = forms.struct_code(segment.type) or (f"{size}s", "")
        if code.endswith("s"):
            return PackArgument(code, "", forms.build(self.module, segment.type, wire, str(size)))
        return PackArgument(code, order, wire)

    def packs(self, local: str, before: str, code: str, order: str) -> str:
        """Return the module constant with the packers of a list and the codes `before` it, by the number of values."""
        return self.module.list_structs(before, code, order, self.title, "values", packs=True)

    def wire(self, segment: Number, scope: FieldScope) -> str:
        """Return the source of the number or text that is encoded."""
        if isinstance(segment, Bits):
            parts = []
            for part in segment.parts:
                text = scope.entries[part.name].text
                if text != "0":
                    parts.append(f"{text} << {part.low}" if part.low else text)
            return " | ".join(parts) or "0"
        return forms.wire_of(segment, self.local_of(segment, scope))

    def data_text(self, data: Data, scope: FieldScope) -> str:
        """Return the source of the encoded bytes of data."""
        return forms.wire_text(self.module, data, scope.entries[data.name].text)

    def placed(self, segments: Iterable[Segment], scope: FieldScope) -> list[Placed]:
        """Return the segments with those of records inlined, without segments that take no bytes."""
        found: list[Placed] = []
        for segment in segments:
            if segment.is_record and segment.when is None:
                inside = scope.entries[segment.value_names[0]].inside
                assert inside is not None
                found.extend(self.placed(segment.members, inside))
            elif segment.takes_bytes:
                found.append((segment, scope))
        return found

    def region(
        self,
        segments: Iterable[Segment],
        scope: FieldScope,
        buffer: str,
        before: str = "",
        tail: tuple[Const, int | Segment] | None = None,
        is_whole: bool = False,
    ) -> str:
        """Return the source of the bytes of a list of segments.

        Checks are computed over the bytes in the local `buffer` so far, preceded by the bytes `before` (source).
        `tail`: the constant whose first byte must not occur before it, from an offset or a segment on. `is_whole`: no
        other bytes surround the segments, so that the byte after a text shows whether the text ends there.
        """
        placed = self.placed(segments, scope)
        region = _Region(buffer, before)
        ended: list[_Ended] = []
        apart = [at for at, (one, _) in enumerate(placed) if any(one is mark for mark in tail or ())]
        place = 0
        while place < len(placed):
            segment, inside = placed[place]
            if tail is not None:
                self._delimit(region, segment, *tail)
            end = next((one for one in apart if one > place), len(placed))
            count = self._add_bytes(region, placed[place:], end - place)
            if ended:
                is_surely_there = any(self.static.of(one).least for one, _ in placed[place : place + count])
                self._follows(ended, region.texts, is_surely_there)
            if is_whole and count == 1 and self._may_go_on(segment, placed[place + 1 :]):
                ended.append(_Ended(segment, inside, []))
            place += count
        self._refuse_open(ended)
        self._work_out_all(region)
        return sum_of(region.texts)

    def _delimit(self, region: _Region, segment: Segment, mark: Const, start: int | Segment) -> None:
        """Write the offset of a delimited body before its first segment, and the check of the body before its end."""
        if segment is start:
            self._gather_all(region)
            self.add(f"body_start = {f'len({region.buffer})' if region.texts else 0}")
        if segment is mark:
            region.texts = [self.gather(region.texts, region.buffer)]
            self._keep_apart(region.buffer, mark, str(start) if isinstance(start, int) else "body_start")

    def _add_bytes(self, region: _Region, placed: list[Placed], most: int) -> int:
        """Add the bytes of the first segments to a region, at most `most`; return how many segments were added."""
        segment, scope = placed[0]
        if isinstance(segment, Check) and covers_later(segment, self.segments):
            region.texts.append(f"<{segment.path}>")
            region.waiting.append((region.texts[-1], segment, scope))
            self.postponed.add(segment.path)
        elif isinstance(segment, Check):
            self._settle(region.waiting, region.texts, segment)
            if segment.path in self.coverage.whole:
                self._gather_all(region)
            region.texts.append(self._kept(placed[:1], self._check(segment, scope, [region.before, *region.texts])))
        elif isinstance(segment, Fill):
            region.texts = [self._filled(segment, placed[1:], region.texts, region.buffer)]
        elif segment.path in self.late:
            self._gather_all(region)
            region.texts.append(self._ended(segment, self._late(segment, [region.before, *region.texts])))
            self._keep((segment,), region.texts[-1])
        else:
            run = placed[: self.length_of_run(placed[:most])]
            region.texts.append(self._kept(run, self.run(run)))
            return len(run)
        return 1

    def _gather_all(self, region: _Region) -> None:
        """Write the assignment of all bytes of a region so far to the local of its buffer."""
        if region.texts:
            region.texts = [self.gather(region.texts, region.buffer)]

    def _work_out_all(self, region: _Region) -> None:
        """Insert the postponed check codes, in an order in which each covers only known bytes."""
        waiting = region.waiting
        while waiting:
            others = {check.path for _, check, _ in waiting}
            ready = next((one for one in waiting if others.isdisjoint(self.coverage.paths(one[1]) or ())), None)
            if ready is None or ready[0] not in region.texts:
                raise _covered_itself((ready or waiting[0])[1])
            self._work_out(ready, waiting, region.texts)

    def _may_go_on(self, segment: Segment, behind: list[Placed]) -> bool:
        """Return whether the bytes after a text may begin with a byte that does not end the text."""
        type_ = segment.number_type
        if type_ is None or not type_.stops or type_.has_long_stops:
            return False
        first = behind[0][0] if behind else None
        is_end = isinstance(first, Const) and first.when is None and first.data[:1] in type_.stops
        return first is not None and not is_end

    def _follows(self, ended: list[_Ended], texts: list[str], is_surely_there: bool) -> None:
        """Add the last bytes to texts whose end is uncertain; `is_surely_there`: they contain at least one byte."""
        if texts[-1].startswith("<") or len(texts) < 2:  # a check code that is inserted later, or fill bytes
            ended.clear()
            return
        if not texts[-1].startswith('b"'):
            local = self.names.fresh("after")
            self.add(f"{local} = {texts[-1]}")
            texts[-1] = local
        for one in ended:
            one.behind.append(texts[-1])
        if is_surely_there:
            self._refuse_open(ended)

    def _refuse_open(self, ended: list[_Ended]) -> None:
        """Write the refusal of texts without an end byte after them, which would be read as longer."""
        for segment, scope, behind in ended:
            assert segment.number_type is not None
            stops = segment.number_type.stops
            first = behind[0] if len(behind) == 1 else f"({' or '.join(behind)})"
            condition = f"{first}[:1] not in ({', '.join(map(bytes_literal, stops))},)"
            what = f"{segment.title} ends before {shown_stops(stops)}, and something else follows it"
            self.complain_where(segment.when, scope, condition, quoted(segment.name or ""), quoted(what))
        ended.clear()

    def _settle(self, waiting: list[Waiting], texts: list[str], by: Check) -> None:
        """Write the postponed codes that check `by` covers, as all of their bytes are known now."""
        covered = self.coverage.paths(by)
        known = {path for part in self.parts for path in part.paths}
        for one in list(waiting):
            mark, check, _ = one
            if covered is None or check.path in covered:
                if mark not in texts or not known.issuperset(self.coverage.paths(check) or ()):
                    raise _covered_itself(check)
                self._work_out(one, waiting, texts)

    def _work_out(self, one: Waiting, waiting: list[Waiting], texts: list[str]) -> None:
        """Insert the code of a postponed check in its place."""
        mark, check, scope = one
        waiting.remove(one)
        self.postponed.discard(check.path)
        texts[texts.index(mark)] = self._kept([(check, scope)], self._check(check, scope, []))

    def _keep_apart(self, buffer: str, tail: Const, start: str) -> None:
        """Write the check that a delimited body does not contain its end."""
        mark = bytes_literal(tail.data[:1])
        body = buffer if start == "0" else f"{buffer}[{start}:]"
        message = f"the body holds {tail.data[0]:02X}, which ends it"
        self.complain(f"{mark} in {body}", '""', quoted(message))

    def _late(self, segment: Segment, before: list[str]) -> str:
        """Write the bytes of a choice that contains check codes, after the bytes before it are known."""
        wire = self.names.fresh("case_bytes")
        self.add(f'{wire} = b""')
        plain = self.preset_plain(segment)
        for header, segments, scope in self.late[segment.path]:
            with self.out.block(header), self.apart():
                self.add(f"{wire} = {self.region(segments, scope, self.names.fresh('part'), sum_of(before))}")
                self.add_plain(plain, segments)
        return wire

    @contextmanager
    def apart(self) -> Iterator[None]:
        """Drop the kept bytes of a case, conditional record or item afterwards, as they do not exist outside of it."""
        before = len(self.parts)
        yield
        del self.parts[before:]

    def preset_plain(self, segment: Segment) -> str | None:
        """Return a local for the covered bytes of a segment that may be absent, preset to empty.

        None unless checks cover the segment and wraps in it make the covered bytes differ from its bytes.
        """
        paths = [leaf.path for leaf in leaves((segment,))]
        if not self.coverage.of(paths) or not any(one.is_there_inside for one in on_the_wire((segment,))):
            return None
        plain = self.plains[segment.path] = self.names.fresh("covered")
        self.add(f'{plain} = b""')
        return plain

    def add_plain(self, plain: str | None, segments: tuple[Segment, ...]) -> None:
        """Write the assignment of the covered bytes in the branch where the segments are present."""
        if plain is not None:
            self.add(f"{plain} = {sum_of(self._parts_of([leaf.path for leaf in leaves(segments)], False))}")

    def gather(self, texts: list[str], buffer: str) -> str:
        """Write the assignment of all bytes so far to the buffer's local."""
        text = sum_of(texts)
        if text != buffer:
            first = buffer not in self.begun
            self.begun.add(buffer)
            self.add(f"{buffer}{': bytes' if first else ''} = {text}")
            self.gathered = {known: local for known, local in self.gathered.items() if local != buffer}
            if " + " in text and buffer not in text and not self.out.depth:
                self.gathered[text] = buffer
        return buffer

    def _filled(self, fill: Fill, behind: list[Placed], texts: list[str], buffer: str) -> str:
        """Write the padding of all bytes so far, so that the frame reaches its fixed size."""
        self.gather(texts, buffer)
        fixed, parts = self.sizes_of(behind, OR)
        room = " - ".join([str(fill.total - fixed), *parts])
        message = text_source("the values take ", Code(f"len({buffer})"), " bytes, more than ", Code(room))
        self.complain(f"len({buffer}) > {room}", '""', message)
        self.gathered.clear()
        paths = (fill.path,)
        if self.coverage.of(paths):
            local = self.names.fresh("fill")
            self.add(f"{local} = b''.ljust({room} - len({buffer}), {bytes_literal(bytes((fill.byte,)))})")
            self.parts.append(KeptBytes(paths, local))
            self.add(f"{buffer} += {local}")
        else:
            self.add(f"{buffer} = {buffer}.ljust({room}, {bytes_literal(bytes((fill.byte,)))})")
        return buffer

    # ---- what checks cover --------------------------------------------------------------------------------

    def _kept(self, placed: list[Placed], text: str) -> str:
        """Return the source of a run, assigned to a local if a check covers its bytes."""
        segments = tuple(segment for segment, _ in placed)
        standing = tuple(on_the_wire(segments))
        if self.coverage.of(one.path for one in standing) and not text.isidentifier() and not is_literal(text):
            named = [one.name for one in standing if one.name and not one.name.startswith("_")]
            local = self.names.fresh(f"{named[0]}_bytes" if len(named) == 1 else "covered")
            self.add(f"{local} = {text}")
            text = local
        self._keep(segments, text)
        return text

    def _keep(self, segments: tuple[Segment, ...], text: str) -> None:
        """Record that `text` is the source of these segments' bytes; wraps record their content themselves."""
        plain = tuple(leaf.path for leaf in leaves(segments))
        on_wire = tuple(one.path for one in on_the_wire(segments))
        if plain == on_wire:
            self.parts.append(KeptBytes(plain, text))
            return
        self.parts.append(KeptBytes(on_wire, text, True))
        if not segments[0].is_there_inside:
            self.parts.append(KeptBytes(plain, self.plains.get(segments[0].path, text), False))

    def _check(self, check: Check, scope: FieldScope, before: list[str]) -> str:
        covered = sum_of([text for text in before if text])
        if check.path not in self.coverage.whole:
            if not self.postponed.isdisjoint(self.coverage.paths(check) or ()):
                raise _covered_itself(check)
            texts: list[str] = []
            for part in self.coverage.parts(check):
                if isinstance(part, list):
                    texts += self._parts_of(part, check.wire)
                else:
                    texts.append(forms.added_text(self.module, part, self.text(part.value, scope, PRODUCT)))
            covered = sum_of(texts)
            for text, buffer in self.gathered.items():
                if covered == text or covered.startswith(f"{text} + "):
                    covered = buffer + covered.removeprefix(text)
        key = needs(check, lambda value: self.text(value, scope))
        return self.if_present(check, scope, code_bytes(self.module, replace(check, when=None), covered, key), 'b""')

    def _parts_of(self, paths: list[str], on_wire: bool) -> list[str]:
        texts: list[str] = []
        left = list(paths)
        known = [part for part in reversed(self.parts) if part.on_wire in (None, on_wire)]
        while left:
            part = next((part for part in known if left[0] in part.paths), None)
            texts.extend([] if part is None else [part.text])
            left = left[max(1, 0 if part is None else len({*part.paths} & {*left})) :]
        return texts

    def _ended(self, segment: Segment, text: str) -> str:
        """Return the source of a part that a constant ends, after writing the check that it lacks the constant."""
        constant = self.ends.get((segment.path, segment.at))
        if constant is None:
            return text
        if not text.isidentifier():
            local = self.names.fresh(f"{(segment.name or 'part').strip('_')}_bytes")
            self.add(f"{local} = {text}")
            text = local
        end = bytes_literal(constant)
        held = f"{end} in {text}" if len(constant) == 1 else f"({text} + {end}).find({end}) != len({text})"
        shown = segment.name if segment.name and not segment.name.startswith("_") else "a part"
        what = f"'{shown}' holds {constant.hex(' ').upper()}, which ends it"
        self.complain(held, quoted(shown), quoted(what))
        return text

    # ---- single segments ----------------------------------------------------------------------------------

    def single(self, segment: Segment, scope: FieldScope) -> str:
        """Return the source of the bytes of a segment outside of a run."""
        known = self.wires.get(segment.path)
        if known is not None:
            return known
        kind = kind_of(segment)
        if isinstance(segment, Inner):
            text: str = kind.bytes_text(self, segment, scope)
            return text
        return self.if_present(segment, scope, kind.bytes_text(self, without_when(segment), scope), 'b""')

    def limit(self, text: str, most: int) -> None:
        """Write the check that the frame has at most `most` bytes."""
        self.gather([text], self.buffer)
        message = text_source("the frame takes ", Code(f"len({self.buffer})"), f" bytes, more than {most}")
        self.complain(f"len({self.buffer}) > {most}", '""', message)

    def put_into_local(self, segment: Segment, scope: FieldScope) -> None:
        """Write the bytes of a segment into a local, for lengths that count them."""
        inside = {leaf.path for leaf in leaves(flat((segment,)))}
        for check in parts_of(segment, Check):
            if check.path not in self.coverage.whole and not inside.issuperset(self.coverage.paths(check) or ()):
                what = "a length counts a check code that covers what stands before it"
                raise not_possible(check, what, "let it count what stands beside the check")
        self.flush()
        local = self.names.fresh(f"{(segment.name or 'part').strip('_')}_bytes")
        if segment.is_record:
            text = self.region((segment,), scope, local)
        else:
            text = self.single(segment, scope)
        if text != local:
            self.add(f"{local} = {text}")
        self.wires[segment.path] = local
        if segment.name in scope.entries and segment.frames_inside:
            scope.entries[segment.name].wire = f"len({local})"

    def branch_tasks(self, segment: Segment, scope: FieldScope, given: ConsumedValues) -> list[Task]:
        inside = tuple(flat((segment,)))
        names = [inner for one in inside for inner in one.value_names]
        counted = [f"bytes of {one.path}" for one in inside if one.path in self.asked_for or one is segment]
        outer = self.outer_names(segment)
        return [Task((*names, *counted), outer, lambda _: self.branches(segment, scope, given))]

    def branches(self, segment: Segment, scope: FieldScope, given: ConsumedValues) -> None:
        """Write the branches of a choice, or of an `optional`."""
        path = segment.path
        wire = self.names.fresh("case_bytes" if segment.chooses_by is not None else "optional_bytes")
        self.flush()
        has_checks = any(isinstance(one, Check) for one in flat((segment,)))
        plain = None
        room = None
        if has_checks:
            self.late[path] = []
            if path in self.asked_for:  # the size is needed before its bytes are assembled
                room = self.rooms[path] = self.names.fresh(f"{(segment.name or '').strip('_')}_room")
                self.add(f"{room} = 0")
        else:
            self.add(f'{wire} = b""')
            plain = self.preset_plain(segment)
        outside = self._names_for_others(segment, scope)
        rooms = self._rooms_for_others(segment)
        cases: Cases = kind_of(segment).cases(self, segment, scope, given)
        other_names = self._other_names(segment)
        known = dict(self.rooms)
        for header, segments in cases:
            here = {one.path for one in flat(segments or ())}
            self.rooms = known | {other: local for other, local in rooms.items() if other not in here}
            with self.out.block(header), self.apart():
                if segments is None:
                    self.add('raise EncodeError("", "no case fits")')
                    continue
                inside = self._branch(segments, scope, given, outside, rooms)
                if others := other_names(segments):
                    assert given.in_cases is not None
                    self.add(f"{given.in_cases[1]} += {others}")
                if room is not None:
                    with self.names_of(segments):
                        paths = [one.path for one in segments if one.takes_bytes]
                        self.add(f"{room} = {self.room(paths, inside)}")
                if has_checks:
                    self.late[path].append((header, segments, inside))
                else:
                    self.add(f"{wire} = {self.region(segments, inside, self.names.fresh('part'))}")
                    self.add_plain(plain, segments)
        for outer, local in outside.items():
            record = scope.entries.get(outer)
            if record is None or record.kind != "record":
                scope.entries[outer] = NameEntry(local)
        self.rooms = known | rooms
        if not has_checks:
            self.wires[path] = wire

    def _other_names(self, segment: Segment) -> Callable[[Iterable[Segment]], str]:
        """Return the function from a case to source of the names that only other cases have; empty if there are none.

        Above `MOST_NAMES` names a local holds those of all cases, so that the source grows with their number only.
        """
        names = {name for one in flat((segment,)) for name in one.value_names}
        local = ""
        if len(names) > MOST_NAMES:
            local = self.names.fresh("case_names")
            self.add(f"{local} = {literal(sorted(names))}")

        def call(case: Iterable[Segment]) -> str:
            own = {name for one in flat(case) for name in one.value_names}
            if local:
                return f"tuple(name for name in {local} if name not in {literal(tuple(sorted(own)))})"
            return literal(tuple(sorted(names - own))) if names - own else ""

        return call

    def _names_for_others(self, segment: Segment, scope: FieldScope) -> dict[str, str]:
        """Return locals for the names of a branch that expressions outside of it may read, preset to None."""
        found: dict[str, str] = {}
        for one in flat((segment,)):
            for name in one.value_names:
                if name in self.read_names | self.fields_read and name not in found:
                    found[name] = self.names.fresh(name)
                    scope.entries[name] = NameEntry(found[name])
                    self.add(f"{found[name]} = None")
        return found

    def _rooms_for_others(self, segment: Segment) -> dict[str, str]:
        """Return locals for the sizes of a branch's segments that lengths outside of it count, preset to 0."""
        counted = (one for one in flat((segment,)) if one is not segment and one.path in self.asked_for)
        names = {one.path: one.name for one in counted}
        found = {path: self.names.fresh(f"{name}_room") for path, name in names.items()}
        for local in found.values():
            self.add(f"{local} = 0")
        return found

    def _branch(
        self,
        segments: tuple[Segment, ...],
        scope: FieldScope,
        given: ConsumedValues,
        outside: dict[str, str],
        rooms: dict[str, str],
    ) -> FieldScope:
        """Write the values of a case; return its scope."""
        inner = ConsumedValues(given.text, given.rules, given.path, in_cases=given.in_cases)
        inside = FieldScope(scope)
        self.values(segments, inside, inner)
        self.flush()
        self.refuse_absent(inner)
        if inner.computed:
            entries = ", ".join(f"{quoted(name)}: {text}" for name, text in inner.computed.items())
            assert given.in_cases is not None
            self.add(f"{given.in_cases[0]} |= {{{entries}}}")
        for name, local in outside.items():
            entry = inside.entries.get(name)
            if entry is not None and entry.kind == "record" and entry.inside is not None:
                self.add(f"{local} = {self._record_text(entry)}")
                entry.inside.close()
                scope.entries[name] = NameEntry(local, "record", entry.inside, may_be_absent=True)
            elif entry is not None:
                self.add(f"{local} = {entry.text}")
        with self.names_of(segments):
            for path in by_path(segments):
                if path in rooms:
                    self.add(f"{rooms[path]} = {self.room((path,), inside)}")
        return inside

    def _record_text(self, entry: NameEntry) -> str:
        """Return the source of the values of a record that expressions read, including computed values and defaults."""
        if not entry.direct or entry.inside is None:
            return entry.text
        known = {name: one for name, one in entry.inside.entries.items() if name in self.fields_read}
        return "{" + ", ".join(f"{quoted(name)}: {self._record_text(one)}" for name, one in known.items()) + "}"
