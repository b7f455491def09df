"""State of a function that builds bytes, and the texts of what values depend on and how much room they take."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager

from framekit.codec.python.expressions import ExpressionWriter, Scope
from framekit.codec.python.module import Module
from framekit.codec.python.names import Names
from framekit.codec.python.reader import not_possible
from framekit.codec.python.shape import follows_its_length, named, names_read
from framekit.codec.python.source import Code, Source, text_source
from framekit.definition.expression.emit import OR, PRODUCT
from framekit.definition.expression.syntax import Attribute, Call, Expression, Index, Name, Node, children, walk
from framekit.definition.model.segments import (
    Bits,
    Count,
    Data,
    Field,
    FieldType,
    Length,
    Repeat,
    Segment,
)
from framekit.definition.model.walk import everything, expressions_of

Placed = tuple[Segment, Scope]
"""A segment and the scope its names belong to."""


class Building:
    """What all parts of an encoder share.

    `fields_read`: names that expressions read of something that has fields. `wires`: the local with the bytes of a
    segment, by its name. `asked_for`: names whose bytes a length counts.
    `targets`: what the names mean where something is being written. `rooms`: the local with the room that something in
    one of several cases takes, by its name. `counts`: the local with the number of values in a list, by the list's own.
    """

    def __init__(self, module: Module, title: str, segments: tuple[Segment, ...]) -> None:
        self.module = module
        self.shapes = module.shapes
        self.title = title
        self.segments = segments
        self.out = Source()
        self.names = Names(module.words())
        self.conditions: list[str] = []
        self.by_name = {segment.name: segment for segment in everything(segments) if segment.name}
        self.read_names = names_read(segments)
        nodes = (node for expression in expressions_of(segments) for node in walk(expression.root))
        self.fields_read = {node.name for node in nodes if isinstance(node, Attribute)}
        self.asked_for = {
            name for segment in everything(segments) if isinstance(segment, Length) for name in segment.of
        }
        self.wires: dict[str, str] = {}
        self.targets = named(segments)
        self.rooms: dict[str, str] = {}
        self.counts: dict[str, str] = {}

    def add(self, text: str) -> None:
        self.out.add(text)

    def refuse_if(self, condition: str) -> None:
        """The values are refused if `condition` holds; the rules tell why."""
        if condition not in self.conditions:
            self.conditions.append(condition)

    def complain(self, condition: str, field: str, message: str) -> None:
        """The values are refused if `condition` holds; `field` and `message` as they stand in the source."""
        with self.out.block(f"if {condition}:"):
            self.add(f"raise EncodeError({field}, {message})")

    def compare_size(self, path: tuple[str | Code, ...], found: str, wanted: str, conditions: list[str]) -> None:
        """The value is refused if its size (a text) is not the one that is wanted, where the conditions hold."""
        line = f"{self.module.function('check_size')}({text_source(*path)}, {found}, {wanted})"
        if conditions:
            with self.out.block(f"if {' and '.join(conditions)}:"):
                self.add(line)
        else:
            self.add(line)

    def flush(self) -> None:
        if self.conditions:
            conditions, self.conditions = self.conditions, []
            self.module.function("Misfit")
            with self.out.block(f"if {' or '.join(conditions)}:"):
                self.add("raise Misfit")

    def writer(self, scope: Scope) -> ExpressionWriter:
        return ExpressionWriter(
            self.module, scope, lambda name: self.module.given(self.module.known(name, self.by_name))
        )

    def text(self, expression: Expression, scope: Scope, level: int = 0) -> str:
        return self.writer(scope).text(expression, level)

    def if_present(self, segment: Segment, scope: Scope, text: str, otherwise: str) -> str:
        """The text under the segment's condition."""
        if segment.when is None:
            return text
        return f"({text} if {self.text(segment.when, scope, OR)} else {otherwise})"

    # ---- what expressions wait for ------------------------------------------------------------------------

    def waits(self, *expressions: Expression | None) -> set[str]:
        """What has to be there before these expressions can be worked out."""
        found: set[str] = set()
        for expression in expressions:
            if expression is not None:
                found |= self._tokens(expression.root)
        return found

    def _tokens(self, node: Node) -> set[str]:
        if isinstance(node, Call) and node.function == "len" and isinstance(node.arguments[0], Name):
            name = node.arguments[0].name
            return self.room_tokens(name) if self._has_no_length(name) else {name}
        if isinstance(node, (Attribute, Index)) and isinstance(node.value, Name):
            inner = {token for child in children(node) if child is not node.value for token in self._tokens(child)}
            return inner | {f"items of {node.value.name}" if self._is_records(node.value.name) else node.value.name}
        if isinstance(node, Name):
            return {f"items of {node.name}" if self._is_records(node.name) else node.name}
        return {token for child in children(node) for token in self._tokens(child)}

    def _is_records(self, name: str) -> bool:
        segment = self.by_name.get(name)
        return isinstance(segment, Repeat) and isinstance(segment.of, tuple)

    def _has_no_length(self, name: str) -> bool:
        segment = self.by_name.get(name)
        if isinstance(segment, Field):
            return segment.type.kind not in ("ascii", "bytes")
        return segment is not None and not isinstance(segment, (Data, Repeat))

    @contextmanager
    def names_of(self, segments: Iterable[Segment]) -> Iterator[None]:
        """While the segments of a list are written, their names mean them."""
        outside = self.targets
        self.targets = {**outside, **named(segments)}
        yield
        self.targets = outside

    def size_by_length(self, segment: Segment) -> Expression | None:
        """The size of a segment that is nothing but a length that counts it: then it is as long as what is given."""
        size = segment.type.size if isinstance(segment, Field) else segment.size if isinstance(segment, Data) else None
        lengths = (one for one in self.by_name.values() if isinstance(one, Length))
        follows = isinstance(size, Expression) and any(follows_its_length(one, segment) for one in lengths)
        return size if follows and isinstance(size, Expression) else None

    def room_tokens(self, name: str) -> set[str]:
        """What has to be there before the size of a segment on the wire can be told."""
        target = self.targets.get(name)
        if target is None:
            return set()
        segment = target.only
        if segment is None:
            return {f"bytes of {name}"}
        found = self.waits(segment.when)
        if self.shapes.present(segment).fixed is not None:
            return found
        match segment:
            case Data(name=data):
                return found | {data}
            case Field(name=field):
                size = segment.type.size
                return found | {field} | self.waits(size if isinstance(size, Expression) else None)
            case Repeat(name=repeat, of=FieldType()):
                return found | {repeat}
            case Length(type=type_) | Count(type=type_) | Bits(type=type_):
                return found | self.waits(type_.size if isinstance(type_.size, Expression) else None)
        return {f"bytes of {name}"}

    def fills_up(self, item: Data | Field) -> bool:
        """Whether a value that is too short is filled up to a size that others tell."""
        if isinstance(item, Data):
            return item.pad is not None and item.size != "rest" and self.size_by_length(item) is None
        is_filled = item.type.pad is not None or item.type.end is not None
        return is_filled and isinstance(item.type.size, Expression) and self.size_by_length(item) is None

    def bounded(self, size: Expression, scope: Scope) -> str:
        """Text of a size that is computed: what is filled up to it has a bound."""
        return f"{self.module.function('room')}({self.text(size, scope)})"

    # ---- room ---------------------------------------------------------------------------------------------

    def room(self, names: Iterable[str], scope: Scope, *, plain: bool = False) -> str:
        """Text of the bytes these segments take on the wire; `plain`: before conversion."""
        fixed, parts = 0, []
        for name in names:
            target = self.targets.get(name)
            if target is None:
                continue
            segment = target.only
            if segment is None:
                if name not in self.rooms:
                    raise not_possible(
                        target.segments[0],
                        f"the size of '{name}' goes round in a circle",
                        "size it by that length alone",
                    )
                parts.append(self.rooms[name])
                continue
            size = self.shapes.present(segment).fixed
            if size is not None and not (plain and isinstance(segment, Data)):
                if segment.when is None:
                    fixed += size
                else:
                    parts.append(self.if_present(segment, scope, str(size), "0"))
            elif text := self._size_of(segment, scope, plain):
                parts.append(text)
        return " + ".join([*([str(fixed)] if fixed or not parts else []), *parts])

    def is_other(self, local: str, type_: str) -> str:
        """Text that tells whether a value is of another type, or of one derived from it."""
        return f"type({local}) is not {type_}"

    def count_of(self, local: str) -> str:
        """Text of the number of values in a list."""
        return self.counts.get(local, f"len({local})")

    def _size_of(self, segment: Segment, scope: Scope, plain: bool) -> str:
        wire = self.wires.get(segment.name or "")
        if wire is not None:
            return f"len({wire})"
        entry = scope.find(segment.name or "")
        local = "" if entry is None else entry.text
        match segment:
            case Data(convert=convert):
                text = f"len({local})"
                if not plain and convert is not None:
                    text = f"2 * {text}" if convert == "hex_to_ascii" else f"{text} // 2"
            case Repeat(of=FieldType() as of):
                count = self.count_of(local)
                text = count if of.fixed_size == 1 else f"{of.fixed_size} * {count}"
            case Length(type=type_) | Count(type=type_) | Bits(type=type_) if isinstance(type_.size, Expression):
                text = self.text(type_.size, scope, PRODUCT + 1)
            case Field(long=None):
                text = f"len({local})"
                is_number = segment.type.kind not in ("ascii", "bytes")
                if isinstance(segment.type.size, Expression) and (is_number or self.fills_up(segment)):
                    text = self.text(segment.type.size, scope, PRODUCT + 1)
                elif segment.type.end is not None:
                    text += f" + {len(segment.type.end)}"
            case Field():
                assert segment.long is not None
                short, longer = segment.type.fixed_size or 1, segment.long.type.fixed_size or 0
                text = f"({short} if {local} < {segment.long.mark} else {short + longer})"
            case _:
                return "0"
        return self.if_present(segment, scope, text, "0")
