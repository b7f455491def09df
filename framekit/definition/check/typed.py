"""Kinds of expressions – number, time, text, bytes – and the places in a definition that require a kind.

The places are times of steps, sizes, defaults, and fields of constructors. This module knows the kind of each name and
the kind that each key requires, and checks the operands of operators.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

from framekit.definition.expression import (
    FUNCTIONS,
    Attribute,
    Binary,
    Bytes,
    Call,
    Compare,
    Conditional,
    Expression,
    Index,
    LineTime,
    List,
    Logic,
    Name,
    Node,
    Number,
    Real,
    Slice,
    Text,
    Unary,
)
from framekit.definition.keys import ValueKind, expressions_with_kinds
from framekit.definition.kinds.base import Segment, Segments, constant_number, most_bytes
from framekit.definition.model.checks import CheckMethod, not_installed
from framekit.definition.model.frames import WIRE, Frame, certain, expressions_of, field_names, flat, parts_of
from framekit.definition.model.procedure import Action, Row, Sequence, Step
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.sections import Parameter, StateVariable
from framekit.definition.model.segments import INDEX, LAST, PREVIOUS, Inner, Repeat
from framekit.definition.model.services import ServiceRow
from framekit.definition.model.values import FrameOf, Table, Value
from framekit.definition.problems import Position, Problem, did_you_mean, plural
from framekit.definition.wire_types import bounds_of_bits

Kind = ValueKind
Attributes = Callable[[Attribute], Kind]

WORDS: dict[str, str] = {
    "number": "a number",
    "time": "a time",
    "text": "a text",
    "bytes": "bytes",
    "list": "a list",
    "record": "a record",
    "frame": "a frame",
    "table": "a table",
}
_FUNCTION_KINDS: dict[str, Kind] = {
    "number": "number", "flag": "number", "text": "text", "bytes": "bytes", "time": "time",
}  # fmt: skip
_TAKES: dict[str, tuple[tuple[Kind, ...], ...]] = {
    "len": (("text", "bytes", "list", "table", "frame"),),
    "find": (("table", "list"),),
    "find_last": (("table", "list"),),
    "lower": (("text",),),
    "upper": (("text",),),
    "number": (("text", "bytes"), ("number",)),
    "digits": (("number",), ("number",), ("number",)),
    "bit": (("number",), ("number",)),
    "rotl8": (("number",), ("number",)),
    "ms": (("number",),),
    "limit": (("time", "number"),),
    "abs": (("number", "time"),),
    "same": (("list",),),
    "sum": (("list", "bytes"),),
    "span": (("number",), ("number",)),
    "only": (("text", "bytes"), ("text", "bytes")),
    "xor": (("bytes",), ("bytes",)),
    "memory": (("text",), ("number",)),
    "value": (("text",), ("text",)),
    "aes": (("bytes",), ("bytes",), ("bytes",)),
    "random": (("number",),),
    "code": (("text",), ("bytes",)),
}
"""Kinds of the arguments of functions, as far as they are checked."""

_SEQUENCES: frozenset[Kind] = frozenset({"text", "bytes", "list"})
_WITHOUT_FIELDS: frozenset[Kind] = frozenset({"number", "time", "text", "bytes"})


class _Held(NamedTuple):
    """A record or a list of records, with its segments."""

    name: str
    members: Segments
    is_one: bool
    """Whether one record is meant."""
    is_item: bool = False
    """Whether it is one record of a list."""


def held_in(segments: Iterable[Segment]) -> dict[str, _Held]:
    """Return the records and lists of records by name; those of one name in several cases together."""
    found: dict[str, _Held] = {}
    for one in flat(segments):
        if one.inner_record is not None and one.name is not None and not (isinstance(one, Repeat) and one.single):
            before = found.get(one.name)
            members = one.members if before is None else (*before.members, *one.members)
            found[one.name] = _Held(one.name, members, one.is_record)
    return found


def never_an_attribute(node: Attribute) -> Kind:
    """Return the kind of `x.name` without knowledge of `x`."""
    return "number" if isinstance(node.value, Name) and node.value.name == "line" else "any"


class KindChecker:
    """Determines the kinds of expressions, with the kinds of names given by `names`, and collects problems.

    `holders`: the records and lists of records by name; `columns`: the names in the rows of tables; `measured`: the
    inner frames whose length is known, None outside of frames; `inside`: the names of inner frames.
    """

    def __init__(self, names: Mapping[str, Kind], attributes: Attributes = never_an_attribute) -> None:
        self.names = names
        self.attributes = attributes
        self.holders: Mapping[str, _Held] = {}
        self.columns: Mapping[str, Collection[str]] = {}
        self.problems: list[Problem] = []
        self.expression: Expression | None = None
        self.named_numbers: frozenset[str] = frozenset()
        self.measured: frozenset[str] | None = None
        self.inside: frozenset[str] = frozenset()
        self.frames_in: Mapping[str, Mapping[str, Collection[str]]] = {}
        """For each inner frame the frames that it may be, with their fields; empty outside of frames."""

    def wants(self, expression: Expression | None, wanted: Kind) -> None:
        """Note problems inside an expression, and a kind other than `wanted`. A 0 is a time too."""
        if expression is None:
            return
        found = self.kind(expression)
        if found in ("any", wanted) or wanted == "any":
            return
        if wanted == "time" and _is_zero(expression.root):
            return
        shown = expression.text if "'" in expression.text else f"'{expression}'"
        what = f"{WORDS[wanted]} is wanted here, {shown} is {WORDS[found]}"
        if wanted == "time" and isinstance(expression.root, Number):
            todo = f"write it with its unit, such as {expression} ms"
        elif wanted == "time" and found == "number":
            todo = "multiply it by a unit, such as 1 ms, or make it a time"
        elif wanted == "number" and found == "time":
            todo = "write it without a unit"
        elif wanted == "number" and expression.root == Name(expression.root.at, "data") and "values" in self.names:
            todo = "write value, which is the element as a number"
        elif wanted == "number" and found == "bytes" and not isinstance(expression.root, Bytes):
            todo = _NUMBER_OF_BYTES
        elif wanted == "number" and found == "text" and not isinstance(expression.root, Text):
            todo = "number(TEXT, 10) makes a number of digits"
        elif wanted in ("text", "bytes") and found in ("text", "bytes"):
            todo = "write bytes as h'…' and text in quotes"
        else:
            todo = ""
        self._note(expression.at, what, todo)

    def kind(self, expression: Expression) -> Kind:
        """Return the kind of an expression; problems inside it are noted."""
        self.expression = expression
        return self._kind(expression.root)

    def _note(self, at: Position, what: str, todo: str = "") -> None:
        self.problems.append(Problem(at, what, todo))

    def _inside(self, at: Position, what: str, todo: str = "") -> None:
        self._note(at, f'in the expression "{self.expression}": {what}', todo)

    # ---- nodes --------------------------------------------------------------------------------------------

    def _kind(self, node: Node) -> Kind:
        match node:
            case Number(is_time=is_time):
                return "time" if is_time else "number"
            case Real():
                return "number"
            case LineTime():
                return "time"
            case Text():
                return "text"
            case Bytes():
                return "bytes"
            case Name(name=name):
                return "any" if self._is_whole(node) else self.names.get(name, "any")
            case Attribute():
                return self._attribute(node)
            case List(items=items):
                for item in items:
                    self._kind(item)
                return "list"
            case Index(value=value, index=index):
                return self._index(value, index)
            case Slice(value=value):
                return self._slice(node, self._kind(value))
            case Call():
                return self._call(node)
        return self._operator(node)

    def _attribute(self, node: Attribute) -> Kind:
        holder = self._held(node.value)
        if holder is None:
            kind = self._kind(node.value)
            if kind in _WITHOUT_FIELDS:
                self._inside(node.at, f"{WORDS[kind]} has no '{node.name}'")
            is_line = isinstance(node.value, Name) and node.value.name == "line"
            if is_line and "line" in self.names:  # a value named `line`
                return "any"
            if is_line and node.name != "speed":
                self._inside(node.at, f"the line has no '{node.name}'", "write line.speed if that is meant")
            self._in_inner_frame(node)
            columns = self._columns(node.value)
            if columns is not None and node.name not in columns:
                what = "has" if columns else "holds no rows with names, so there is"
                self._inside(node.at, f"the table {what} no '{node.name}'", did_you_mean(node.name, columns))
            return self.attributes(node)
        names = field_names(holder.members)
        if node.name not in names:
            what = f"'{holder.name}' has no field '{node.name}'"
            self._inside(node.at, what, did_you_mean(node.name, names))
            return "any"
        if self._is_whole(node):
            return "any"
        return field_kinds(holder.members).get(node.name, "any") if holder.is_one else "list"

    def _in_inner_frame(self, node: Attribute) -> None:
        """Note an attribute of an inner frame that names none of its frames, or no field of the named frame."""
        match node.value:
            case Name(name=inner) if inner in self.frames_in and node.name not in self.frames_in[inner]:
                frames = self.frames_in[inner]
                having = next((frame for frame, fields in frames.items() if node.name in fields), "")
                todo = f"write {inner}.{having}.{node.name}" if having else did_you_mean(node.name, frames)
                self._inside(node.at, f"'{inner}' may be no frame '{node.name}'", todo)
            case Attribute(value=Name(name=inner), name=frame) if frame in self.frames_in.get(inner, {}):
                fields = self.frames_in[inner][frame]
                if frame != "unknown" and node.name not in fields:
                    what = f"the frame '{frame}' has no '{node.name}'"
                    self._inside(node.at, what, did_you_mean(node.name, fields))

    def _columns(self, node: Node) -> Collection[str] | None:
        """Return the names in the rows of the table from which a row is taken."""
        if isinstance(node, Index) and isinstance(node.value, Name) and self.names.get(node.value.name) == "table":
            return self.columns.get(node.value.name)
        return None

    def _held(self, node: Node) -> _Held | None:
        """Return the record or list of records that a node refers to."""
        match node:
            case Name(name=name):
                return self.holders.get(name)
            case Index(value=value, index=index):
                outer = self._held(value)
                if outer is not None and not outer.is_one:
                    self._kind(index)
                    return outer._replace(is_one=True, is_item=True)
            case Attribute(value=value, name=name):
                outer = self._held(value)
                found = None if outer is None else held_in(outer.members).get(name)
                if outer is not None and found is not None:
                    return found._replace(is_one=outer.is_one and found.is_one, is_item=outer.is_item)
        return None

    def _is_whole(self, node: Node) -> bool:
        """Return whether a node is a whole record, which has fields but no value; that is noted."""
        holder = self._held(node)
        if holder is None or not holder.is_one or holder.is_item:
            return False
        what = f"the record '{holder.name}' has no value of its own"
        field = min(field_names(holder.members), default="")
        self._inside(node.at, what, field and f"name a field of it, such as {holder.name}.{field}")
        return True

    def _operator(self, node: Node) -> Kind:
        match node:
            case Unary(operator="not", operand=operand):
                self._kind(operand)
                return "number"
            case Unary(operator=operator, operand=operand):
                kind = self._kind(operand)
                if kind not in ("number", "time", "any"):
                    self._inside(node.at, f"'{operator}' wants a number, this is {WORDS[kind]}")
                return kind
            case Binary():
                return self._binary(node)
            case Compare():
                return self._compare(node)
            case Logic(operands=operands):
                return _common([self._kind(operand) for operand in operands])
            case Conditional(condition=condition, then=then, otherwise=otherwise):
                self._kind(condition)
                return _common([self._kind(then), self._kind(otherwise)])
        return "any"

    def _index(self, value: Node, index: Node) -> Kind:
        kind, place = self._kind(value), self._kind(index)
        holder = self._held(value)
        if kind in ("number", "time"):
            self._inside(value.at, f"{WORDS[kind]} has no parts to take with [ ]")
        if kind in _SEQUENCES and place not in ("number", "any"):
            self._inside(index.at, f"a place in {WORDS[kind]} is a number, this is {WORDS[place]}")
        if kind == "list" and holder is not None:
            return "any" if holder.is_one else "record"
        if kind == "text":
            return "text"
        return "number" if kind == "bytes" else "any"

    def _slice(self, node: Slice, kind: Kind) -> Kind:
        for end in (node.start, node.stop):
            if end is not None and self._kind(end) not in ("number", "any"):
                self._inside(end.at, "the ends of a piece are numbers")
        if kind in ("number", "time"):
            self._inside(node.at, f"{WORDS[kind]} has no pieces")
        return kind

    def _call(self, node: Call) -> Kind:
        kinds = [self._argument(argument) for argument in node.arguments]
        for argument, kind, takes in zip(node.arguments, kinds, _TAKES.get(node.function, ()), strict=False):
            if kind != "any" and kind not in takes:
                wanted = ", ".join(WORDS[one] for one in takes[:-1])
                wanted += (" or " if wanted else "") + WORDS[takes[-1]]
                self._inside(argument.at, f"'{node.function}' takes {wanted} here, this is {WORDS[kind]}")
        if node.function == "len":
            self._length_of_frame(node.arguments[0], kinds[0])
        if FUNCTIONS[node.function].is_extra:
            self.problems += not_installed(node.at, f"'{node.function}'")
        gives = FUNCTIONS[node.function].gives
        if node.function == "only":
            self._same(node, kinds)
        if gives == "same":
            self._same(node, kinds)
            return _common(kinds) if len(kinds) > 1 else "any"
        return _FUNCTION_KINDS.get(gives, "any")

    def _length_of_frame(self, frame: Node, kind: Kind) -> None:
        """Note the length of an inner frame that is not known: it is known in the outer frame only, if always
        present.
        """
        last = frame.name if isinstance(frame, (Name, Attribute)) else ""
        if kind != "frame" and not (self.measured is None and isinstance(frame, Attribute) and last in self.inside):
            return
        if self.measured is None or not isinstance(frame, Name):
            todo = f"add {{value: size, read: len({last or 'pdu'})}} there, and name that value here"
            self._inside(frame.at, "the length of a frame is known in the frame around it only", todo)
        elif frame.name not in self.measured:
            what = f"the frame '{frame.name}' may be absent, so nothing says how long it is"
            self._inside(frame.at, what, "take a length: that counts it")

    def _same(self, node: Call, kinds: list[Kind]) -> None:
        """Note incomparable arguments: `min` and `max` take one list, or several values of one kind; `only` takes two
        of one kind.
        """
        if len(kinds) == 1 and kinds[0] in ("number", "time"):
            self._inside(node.at, f"'{node.function}' of one value takes a list, this is {WORDS[kinds[0]]}")
        for argument, kind in zip(node.arguments[1:], kinds[1:], strict=True):
            if (
                "any" not in (kind, kinds[0])
                and kind != kinds[0]
                and not _zero_time(node.arguments[0], argument, kinds[0], kind)
            ):
                self._incomparable(argument, kinds[0], kind)

    def _argument(self, node: Node) -> Kind:
        return "number" if isinstance(node, Name) and node.name in self.named_numbers else self._kind(node)

    def _binary(self, node: Binary) -> Kind:
        left, right = self._kind(node.left), self._kind(node.right)
        if "any" in (left, right):
            return "any"
        result = _combined(node.operator, left, right)
        if result is None and not (node.operator in "+-" and (_is_zero(node.left) or _is_zero(node.right))):
            at, what = node.left.at, f"{WORDS[left]} and {WORDS[right]} do not go together with '{node.operator}'"
            self._inside(at, what, _how_to_join(left, right, node.operator))
        return result or "any"

    def _compare(self, node: Compare) -> Kind:
        operands = [node.first, *(operand for _, operand in node.rest)]
        kinds = [self._kind(operand) for operand in operands]
        for place, (operator, operand) in enumerate(node.rest):
            left, right = kinds[place], kinds[place + 1]
            if operator in ("in", "not in"):
                self._membership(operands[place], operand, left, right)
            elif "any" not in (left, right) and left != right and not _zero_time(operands[place], operand, left, right):
                self._incomparable(operand, left, right)
        return "number"

    def _membership(self, item: Node, holder: Node, left: Kind, right: Kind) -> None:
        if right in ("number", "time"):
            self._inside(holder.at, f"{WORDS[right]} holds nothing", "write a list: [1, 2]")
        elif isinstance(holder, Name) and holder.name in self.frames_in and isinstance(item, Text):
            self._in_inner_frame(Attribute(item.at, holder, item.value))
        elif isinstance(holder, List):
            for one in holder.items:
                kind = self._kind(one)
                if "any" not in (kind, left) and kind != left and not _zero_time(item, one, left, kind):
                    self._incomparable(one, left, kind)

    def _incomparable(self, operand: Node, left: Kind, right: Kind) -> None:
        what = f"{WORDS[left]} cannot be compared with {WORDS[right]}"
        self._inside(operand.at, what, _how_to_compare(operand, left, right))


def _combined(operator: str, left: Kind, right: Kind) -> Kind | None:
    """Return the kind of the result of an operator; None if it does not accept these operands."""
    numbers = ("number", "time")
    if left == right == "number":
        return "number"
    if operator in "+-" and left == right == "time":
        return "time"
    if operator == "+" and left == right and left in _SEQUENCES:
        return left
    if operator == "*" and left in numbers and right in numbers:
        return "time"
    if operator == "*" and {left, right} & (_SEQUENCES - {"text"}) and "number" in (left, right):
        return right if left == "number" else left
    if operator in ("//", "%") and left == "time" and right in numbers:
        return "number" if right == "time" and operator == "//" else "time"
    return None


def _common(kinds: list[Kind]) -> Kind:
    return kinds[0] if len(set(kinds)) == 1 else "any"


def _is_zero(node: Node) -> bool:
    return isinstance(node, Number) and node.value == 0


def _zero_time(first: Node, second: Node, left: Kind, right: Kind) -> bool:
    """Return whether a time is compared with a plain 0."""
    return {left, right} == {"number", "time"} and (_is_zero(first) or _is_zero(second))


_NUMBER_OF_BYTES = (
    "make it a field of a number, such as {field: NAME, type: u16} or f32, in the frame or in a layout: {LAYOUT: BYTES}"
    " reads bytes as that; BYTES[0] is the number of one byte"
)


def _how_to_join(left: Kind, right: Kind, operator: str) -> str:
    if {left, right} == {"number", "time"}:
        return "give the number a unit, such as 50 ms"
    if {left, right} == {"number", "text"} and operator == "*":
        return "make a number of the text with number(…), or write the text as often as it stands there"
    if {left, right} == {"number", "text"}:
        return "make a text of the number with text(…), or a number of the text with number(…)"
    return _NUMBER_OF_BYTES if {left, right} == {"number", "bytes"} else ""


def _how_to_compare(operand: Node, left: Kind, right: Kind) -> str:
    if {left, right} == {"number", "time"}:
        return "give the number a unit, such as 50 ms"
    if {left, right} == {"number", "text"} and isinstance(operand, Number):
        return "put the number in quotes"
    if {left, right} == {"number", "text"}:
        return "leave the quotes out, or give the field values: with names"
    if {left, right} == {"bytes", "text"}:
        return "write bytes as h'…'"
    return _NUMBER_OF_BYTES if {left, right} == {"number", "bytes"} else ""


VARIABLE_KINDS: dict[str, Kind] = {
    "flag": "number", "number": "number", "decimal": "number", "time": "time", "text": "text", "choice": "text",
    "bytes": "bytes", "list": "list", "frame": "frame",
}  # fmt: skip


def field_kinds(segments: Iterable[Segment]) -> dict[str, Kind]:
    """Return the kinds of the values of segments; a field whose numbers have names is `any`, since names stand for
    numbers.
    """
    found: dict[str, Kind] = {}
    for segment in flat(segments):
        for name, kind in segment.value_kinds():
            add_kind(found, name, kind)
    return found


def named_numbers(segments: Iterable[Segment]) -> frozenset[str]:
    """Return the names of values that count as numbers in functions and may be compared with a text."""
    numbers = [(segment, dict(segment.numbers_with_names())) for segment in flat(segments)]
    named = {name for _, names in numbers for name, values in names.items() if values is not None}
    others = {segment.name for segment, names in numbers if segment.name and names.get(segment.name) is None}
    return frozenset(named - others)


def add_kind(found: dict[str, Kind], name: str, kind: Kind) -> None:
    """Add the kind of a name; a name with two kinds is `any`."""
    found[name] = kind if found.get(name, kind) == kind else "any"


def kind_of_variable(type_: str) -> Kind:
    """Return the kind of a parameter, argument or variable of the given type."""
    return "number" if type_[:1] in "uif" and type_[1:].isdigit() else VARIABLE_KINDS.get(type_, "any")


def kind_of_state(variable: StateVariable) -> Kind:
    """Return the kind of a state variable."""
    if variable.keys is not None:
        return "table"
    return "any" if variable.values else kind_of_variable(variable.type)


_OFFERED: dict[str, Kind] = {
    "start": "number", "count": "number", "bytes": "number", "first": "number", "done": "number", "total": "number",
    "element_bytes": "number", "data": "bytes", "bits": "list", "value": "number", "values": "list", "text": "text",
}  # fmt: skip
_BUILT_IN: dict[str, Kind] = {"role": "text", "now": "time", "buffer": "bytes", "reply_buffer": "bytes"}


def columns_of(table: Table) -> frozenset[str]:
    """Return the names in the rows of a table."""
    rows = [*table.entries.values(), *(value for _, _, value in table.ranges)]
    return frozenset(name for row in rows if isinstance(row, Mapping) for name in row)


def check_kinds(protocol: Protocol) -> list[Problem]:
    """Return a problem for every expression whose kind is wrong for its place."""
    return _Kinds(protocol).check()


class _Kinds:
    def __init__(self, protocol: Protocol) -> None:
        self.protocol = protocol
        self.found: list[Problem] = []
        self.local: Mapping[str, Kind] = {}  # variables of the sequence that is looked at
        names: dict[str, Kind] = dict(_BUILT_IN)
        names |= {name: kind_of_variable(parameter.type) for name, parameter in protocol.params.items()}
        names |= {name: kind_of_state(variable) for name, variable in protocol.state.items()}
        names |= dict.fromkeys(protocol.tables, "table")
        untold = protocol.kind == "application"  # the carrying protocol defines the stations
        station = "any" if untold else VARIABLE_KINDS.get(protocol.station.type, "any")
        self.columns = {
            name: columns_of(table) for name, table in protocol.tables.items() if name not in protocol.state
        }
        self.inside = frozenset(
            name
            for frame in protocol.frames.values()
            for name, kind in field_kinds(frame.segments).items()
            if kind == "frame"
        )
        self.globally: dict[str, Kind] = names | {"station": station, "own": station}

    def check(self) -> list[Problem]:
        protocol = self.protocol
        for parameter in protocol.params.values():
            self._parameter(parameter)
        for variable in protocol.state.values():
            self._variable(variable)
        self._line()
        for frame in protocol.frames.values():
            self._segments(frame.segments, {})
            self._announces(frame)
        for layout in protocol.layouts.values():
            self._segments(layout.segments, {})
        for method in protocol.checks.values():
            self._method(method)
        for sequence in protocol.sequences.values():
            self._sequence(sequence)
        for row in protocol.service_rows:
            self._service(row)
        if protocol.errors is not None:
            self._made(self._checker({"code": "any"}), [row.frame for row in protocol.errors.answer])
        return self.found

    def _checker(self, local: Mapping[str, Kind] | None = None, attributes: Attributes | None = None) -> KindChecker:
        checker = KindChecker({**self.globally, **(local or {})}, attributes or never_an_attribute)
        checker.problems = self.found
        checker.columns = self.columns
        checker.inside = self.inside
        return checker

    # ---- sections -----------------------------------------------------------------------------------------

    def _parameter(self, parameter: Parameter) -> None:
        wanted = kind_of_variable(parameter.type)
        checker = self._checker()
        if parameter.type not in ("choice", "list"):
            checker.wants(parameter.default, wanted)
        checker.wants(parameter.is_, wanted)

    def _variable(self, variable: StateVariable) -> None:
        if variable.layout is None and not variable.values:
            self._checker().wants(variable.initial, kind_of_variable(variable.type))

    def _line(self) -> None:
        protocol, checker = self.protocol, self._checker()
        for part in (protocol.line, protocol.receiver, *protocol.sessions.values(), *protocol.lanes):
            self._keys(checker, part)

    def _method(self, method: CheckMethod) -> None:
        """Check the expression of a check method: bytes of the code's width, or the next number of a fold."""
        if method.expression is None:
            return
        if method.kind != "code":
            self._checker({"acc": "number", "byte": "number"}).wants(method.expression, "number")
            return
        before = len(self.found)
        self._checker({"data": "bytes"}).wants(method.expression, "bytes")
        for result in _results(method.expression.root) if len(self.found) == before else ():
            most = most_bytes(result)
            if most is not None and most != method.width // 8:
                what = f"the code '{method.name}' has {plural(most, 'byte')}, and its width is {method.width} bits"
                todo = f"write width: {8 * most}, or take other bytes" if most else "take other bytes"
                self.found.append(Problem(result.at, what, todo))

    # ---- frames -------------------------------------------------------------------------------------------

    def _segments(
        self,
        segments: Segments,
        outer: Mapping[str, Kind],
        outer_held: Mapping[str, _Held] = MappingProxyType({}),
        outer_measured: frozenset[str] = frozenset(),
        outer_frames: Mapping[str, Mapping[str, Collection[str]]] = MappingProxyType({}),
    ) -> None:
        own = field_kinds(segments)
        always = (one for one, is_present in certain(segments) if is_present and one.when is None and one.frames_inside)
        measured = (outer_measured - own.keys()) | {one.name for one in always if one.name is not None}
        local = {**outer, **own}
        checker = self._checker(local)
        checker.holders = {**{name: held for name, held in outer_held.items() if name not in own}, **held_in(segments)}
        checker.named_numbers, checker.measured = named_numbers(segments), measured
        frames_in = {name: frames for name, frames in outer_frames.items() if name not in own}
        known = self.protocol.frames
        for one in flat(segments):
            if isinstance(one, Inner):
                frames = {name: field_names(known[name].segments) for name in one.frames if name in known}
                frames_in[one.name] = {**frames_in.get(one.name, {}), **frames, "unknown": {"data"}}
        checker.frames_in = frames_in
        for segment in flat(segments):
            self._segment(checker, segment)
            if segment.is_list and segment.inner_record is not None:
                words: dict[str, Kind] = {INDEX: "number", LAST: "number", PREVIOUS: "record"}
                before = _Held("previous", segment.inner_record, is_one=True, is_item=True)
                self._segments(
                    segment.inner_record, local | words, checker.holders | {PREVIOUS: before}, measured, frames_in
                )
            elif segment.inner_record is not None:
                self._segments(segment.inner_record, local, checker.holders, measured, frames_in)

    def _segment(self, checker: KindChecker, segment: Segment) -> None:
        for expression, kind, values in segment.given():
            if expression is not None:
                self._for_field(checker, expression, kind, values)

    def _for_field(
        self, checker: KindChecker, expression: Expression, kind: Kind, values: Mapping[int, str] | None
    ) -> None:
        """Check the value given for a field: it must have the field's kind, or be one of the names of its values."""
        if values is None:
            checker.wants(expression, kind)
            return
        checker.kind(expression)
        for text in _results(expression.root):
            if isinstance(text, Text) and text.value not in values.values():
                what = f"'{text.value}' is not a name of this field's values"
                self.found.append(Problem(text.at, what, did_you_mean(text.value, values.values())))

    def _announces(self, frame: Frame) -> None:
        checker = self._checker({**field_kinds(frame.segments), WIRE: "bytes"})
        for one in frame.announces:
            self._set(checker, self.protocol.state.get(one.name), one.key, one.value)

    # ---- sequences ----------------------------------------------------------------------------------------

    def _sequence(self, sequence: Sequence) -> None:
        local: dict[str, Kind] = dict.fromkeys(sequence.takes, "any")
        local |= {name: kind_of_variable(type_) for name, type_ in sequence.local.items()}
        checker = self._checker(local)
        self.local = local
        for step in sequence.steps:
            self._step(checker, step, local)
        for row in sequence.always:
            self._row(row, local)
        self._actions(checker, dict(sequence.handlers))
        self.local = {}

    def _step(self, checker: KindChecker, step: Step, local: Mapping[str, Kind]) -> None:
        for part in (step, step.parts, step.decode, step.serve, step.line):
            self._keys(checker, part)
        self._settings(checker, step)
        self._sent(checker, step)
        self._made(checker, [step.put, step.call, [] if step.ask is None else step.ask.fields])
        for row in step.receive or ():
            self._row(row, local)
        self._actions(checker, [step.branch, dict(step.handlers)])

    def _keys(self, checker: KindChecker, part: Any) -> None:
        """Check the expressions of keys that require a kind."""
        for expression, kind in () if part is None else expressions_with_kinds(part):
            checker.wants(expression, kind)

    def _row(self, row: Row, local: Mapping[str, Kind]) -> None:
        frames = [self.protocol.frames[name] for name in row.frames if name in self.protocol.frames]
        known: dict[str, Kind] = {}
        for frame in frames if not row.expected and len(frames) == len(row.frames) else ():
            for name, kind in field_kinds(frame.segments).items():
                add_kind(known, name, kind)

        def attribute(node: Attribute) -> Kind:
            if isinstance(node.value, Name) and node.value.name == "it":
                return known.get(node.name, "any")
            return never_an_attribute(node)

        self._actions(self._checker({**local, "it": "frame" if row.frames else "any"}, attribute), [row])

    def _actions(self, checker: KindChecker, holder: Any) -> None:
        """Check all actions in it, their `else` included."""
        for action in parts_of(holder, Action):
            self._keys(checker, action)
            for expression, _ in action.store:
                checker.wants(expression, "bytes")
            self._settings(checker, action)
            self._sent(checker, action)
            self._made(checker, [action.put])

    def _sent(self, checker: KindChecker, part: Step | Action) -> None:
        """Check that only frames are sent and delivered."""
        for value in (part.send, part.deliver):
            if isinstance(value, Expression):
                checker.wants(value, "frame")
            elif value is not None:
                self._made(checker, [value])

    def _settings(self, checker: KindChecker, holder: Step | Action) -> None:
        """Check the kinds of the values that `set` stores in variables."""
        for target, value in holder.set:
            variable = self.protocol.state.get(target.name)
            parameter = self.protocol.params.get(target.name)
            wanted: Kind = "any"
            if target.name in self.local:
                pass  # it goes before a variable of the state
            elif target.field is None and variable is not None:
                self._set(checker, variable, target.key, value)
                continue
            elif target.field is None and target.key is None and parameter is not None:
                wanted = kind_of_variable(parameter.type)
            if isinstance(value, Expression):
                checker.wants(value, wanted if wanted not in ("list", "frame") else "any")
            else:
                self._made(checker, [value])

    def _set(self, checker: KindChecker, variable: StateVariable | None, key: Expression | None, value: Value) -> None:
        """Check the new value of a variable of the state, or of its entry `key`: its kind, and the range of a
        number.
        """
        wanted: Kind = "any"
        if variable is not None and not variable.values and variable.layout is None:
            wanted = kind_of_variable(variable.type) if key is not None or variable.keys is None else "any"
        if isinstance(value, Expression):
            checker.wants(value, wanted if wanted not in ("list", "frame") else "any")
        else:
            self._made(checker, [value])
        if key is not None and variable is not None and variable.keys is not None:
            checker.wants(key, "number")
            self._never_in(key, variable.keys, f"'{variable.name}' has the keys")
        if variable is not None and variable.type[0] in "ui" and variable.type[1:].isdigit():
            bounds = bounds_of_bits(int(variable.type[1:]), variable.type[0] == "i")
            self._never_in(value, bounds, f"'{variable.name}' holds")

    def _never_in(self, value: Value, limits: tuple[int, int], holder: str) -> None:
        """Report a constant number outside of the limits."""
        number = constant_number(value) if isinstance(value, Expression) else None
        if number is not None and isinstance(value, Expression) and not limits[0] <= number <= limits[1]:
            what = f"{number} does not fit: {holder} {limits[0]} to {limits[1]}"
            self.found.append(Problem(value.at, what, "correct one of them"))

    # ---- constructors -------------------------------------------------------------------------------------

    def _made(self, checker: KindChecker, holders: Collection[Any]) -> None:
        """Check the values of fields in constructors of frames; other expressions are checked by themselves."""
        validated: set[int] = set()
        for made in parts_of(list(holders), FrameOf):
            frame = self.protocol.frames.get(made.frame)
            fields = {} if frame is None else _known_values(frame)
            for name, value in made.fields.items():
                if isinstance(value, Expression) and name in fields:
                    validated.add(id(value))
                    self._for_field(checker, value, *fields[name])
        for expression in expressions_of(list(holders)):
            if id(expression) not in validated:
                checker.kind(expression)

    def _service(self, row: ServiceRow) -> None:
        local = dict(_OFFERED) if row.service in ("read", "write") else {}
        local |= {argument.name: kind_of_variable(argument.type) for argument in row.takes}
        local |= dict.fromkeys((*row.back, *row.back_each), "any")
        checker = self._checker(local)
        for argument in row.takes:
            checker.wants(argument.default, kind_of_variable(argument.type) if argument.type != "list" else "any")
        self._keys(checker, row.limit)
        self._made(checker, [row.request, row.buffer])
        let: dict[str, Kind] = {} if row.serve is None else dict.fromkeys(row.serve.let, "any")
        answering = self._checker({**local, "data": "bytes", "bytes": "number", "element_bytes": "number", **let})
        for reply in row.reply:
            self._made(answering, [reply.frame, reply.buffer])
        self._made(answering, [dict(row.gives)])


def _known_values(frame: Frame) -> dict[str, tuple[Kind, Mapping[int, str] | None]]:
    """Return the values of a frame whose kind is known, with the names of their numbers."""
    known: dict[str, tuple[Kind, Mapping[int, str] | None]] = {}
    for segment in flat(frame.segments):
        values = dict(segment.numbers_with_names())
        for name, kind in segment.value_kinds():
            if name == segment.name and kind not in ("list", "frame") and segment.value_names == (name,):
                known[name] = (kind, values.get(name))
            else:
                known.pop(name, None)
    return known


def _results(node: Node) -> Iterable[Node]:
    """Yield the possible results of an expression with conditions."""
    if isinstance(node, Conditional):
        yield from _results(node.then)
        yield from _results(node.otherwise)
    else:
        yield node
