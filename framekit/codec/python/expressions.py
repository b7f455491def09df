"""Expressions of a definition as Python text: what their names mean where they stand.

A `Scope` knows the fields around an expression; tables become module constants, everything else is asked of the
context. The meaning of operators and functions is `expression.emit`'s, shared with the engines.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, fields, replace
from typing import Any, Literal, Protocol

from framekit.codec.python.source import literal, quoted
from framekit.definition.expression import (
    AND,
    ATOM,
    COMPARE,
    CONDITIONAL,
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
    Logic,
    Name,
    Node,
    Number,
    Text,
    Unary,
    children,
    emit,
    may_find_nothing,
    walk,
)
from framekit.definition.model.frames import flat
from framekit.definition.model.segments import LAST, Field, Segment

Kind = Literal["value", "list", "record", "inner"]
_WIRE = "bytes on the wire of "
_LITERAL = '"'
_OPPOSITE = {
    "==": "!=", "!=": "==", "<": ">=", "<=": ">", ">": "<=", ">=": "<", "in": "not in", "not in": "in",
}  # fmt: skip


@dataclass(slots=True)
class NameEntry:
    """What a name stands for: its text, its shape, the names inside it, and the text of its size on the wire.

    `sized`: Python's `len` of it is the language's. `is_read`: it has its value, not just a place for it.
    `direct`: the names inside a record are locals of their own; `record` is then what puts the record together.
    `path`: of the segment, where the careful reading knows its size.
    """

    text: str
    kind: Kind = "value"
    inside: Scope | None = None
    wire: str | None = None
    sized: bool = True
    is_read: bool = True
    may_be_absent: bool = False
    direct: bool = False
    record: Any = None
    path: str = ""


class Scope:
    """Fields by name, innermost first. `declared`: names of its fields, also of those not read yet."""

    def __init__(self, parent: Scope | None = None, declared: Iterable[Segment] = ()) -> None:
        self.parent = parent
        self.declared = {name for segment in flat(declared) for name in segment.value_names}
        self.entries: dict[str, NameEntry] = {}

    def close(self) -> None:
        """From outside, what is in records is only to be had through their values."""
        for entry in self.entries.values():
            entry.direct = False
            if entry.inside is not None and entry.kind == "record":
                entry.inside.close()

    def find(self, name: str) -> NameEntry | None:
        scope: Scope | None = self
        while scope is not None:
            if name in scope.entries:
                return scope.entries[name]
            scope = None if name in scope.declared else scope.parent
        return None


def entry_of(node: Node, scope: Scope) -> NameEntry | None:
    """What a node stands for, when it is a field, a part of one, or an item of a list."""
    if isinstance(node, Name):
        return scope.find(node.name)
    if isinstance(node, Attribute):
        outer = entry_of(node.value, scope)
        return None if outer is None or outer.inside is None else outer.inside.entries.get(node.name)
    if isinstance(node, Index):
        outer = entry_of(node.value, scope)
        return NameEntry("", "record", outer.inside) if outer is not None and outer.kind == "list" else None
    return None


def entries_read(node: Node, scope: Scope, fields: Iterable[str]) -> Iterator[NameEntry | None]:
    """The fields that an expression reads, of a record those of it; None for one that nothing is known of yet."""
    if isinstance(node, Name) and (node.name in fields or node.name == LAST):
        yield scope.find(node.name)
    outer = entry_of(node.value, scope) if isinstance(node, Attribute) else None
    if isinstance(node, Attribute) and outer is not None and outer.kind == "record" and outer.inside is not None:
        yield outer.inside.entries.get(node.name)
        return
    for child in children(node):
        yield from entries_read(child, scope, fields)


class Outside(Protocol):
    """What an expression needs of the module and the function around it."""

    def table(self, name: str) -> str | None:
        """The module constant of a table; None if there is no table of that name."""

    def function(self, name: str) -> str:
        """The name of a inlined function."""


class ExpressionWriter:
    """Writes expressions for one place. `context` gives the text of a name that no field and no table has."""

    def __init__(self, module: Outside, scope: Scope, context: Callable[[str], str]) -> None:
        self.module = module
        self.scope = scope
        self.context = context

    def text(self, expression: Expression, level: int = CONDITIONAL) -> str:
        """Python text of the expression, in parentheses if it binds weaker than `level`."""
        return emit(self._prepared(expression.root), self, level)

    def negated(self, expression: Expression) -> str:
        """Text of `not expression`, with the opposite comparison where there is one; for an operand of `or`."""
        root = expression.root
        if isinstance(root, Unary) and root.operator == "not":
            return emit(self._prepared(root.operand), self, AND)
        if isinstance(root, Compare) and len(root.rest) == 1:
            operator, right = root.rest[0]
            opposite = replace(root, rest=((_OPPOSITE[operator], right),))
            return emit(self._prepared(opposite), self, AND)
        return f"not {self.text(expression, COMPARE)}"

    def value(self, expression: Expression) -> str:
        """Text of the expression as a field's value: flags are numbers."""
        return f"int({self.text(expression)})" if is_flag(expression.root) else self.text(expression)

    def _prepared(self, node: Node) -> Node:
        """`len(x)` of something that has no length of its own means its bytes on the wire."""
        if isinstance(node, Call) and node.function == "len" and isinstance(node.arguments[0], Name):
            entry = self.scope.find(node.arguments[0].name)
            if entry is not None and not entry.sized and entry.wire is not None:
                return Name(node.at, _WIRE + node.arguments[0].name)
        if isinstance(node, (Text, Bytes)):
            return Name(node.at, _LITERAL + literal(node.value))
        changes: dict[str, Any] = {}
        for field in fields(node):
            old = getattr(node, field.name)
            new = self._part(old)
            if new is not old:
                changes[field.name] = new
        return replace(node, **changes) if changes else node

    def _part(self, part: Any) -> Any:
        if isinstance(part, Node):
            return self._prepared(part)
        if isinstance(part, tuple):
            items = tuple(self._part(item) for item in part)
            return part if all(new is old for new, old in zip(items, part, strict=True)) else items
        return part

    # ---- what the emitter asks ----------------------------------------------------------------------------

    def name(self, node: Name) -> str:
        if node.name.startswith(_LITERAL):
            return node.name.removeprefix(_LITERAL)
        if node.name.startswith(_WIRE):
            entry = self.scope.find(node.name.removeprefix(_WIRE))
            assert entry is not None
            return f"({entry.wire})"
        entry = self.scope.find(node.name)
        if entry is not None:
            return entry.text
        return self.module.table(node.name) or self.context(node.name)

    def attribute(self, node: Attribute) -> str:
        entry = entry_of(node.value, self.scope)
        if entry is not None and entry.direct and entry.inside is not None and node.name in entry.inside.entries:
            return entry.inside.entries[node.name].text
        text = emit(node.value, self, ATOM)
        if (
            entry is not None and entry.kind == "record" and not self._is_of_items(node.value)
        ):  # what is not there is nothing
            text = f"({text} or {{}})" if self._may_be_absent(node.value) else text
            return f"{text}.get({quoted(node.name)})"
        if entry is not None and entry.kind == "list":
            return f"[item.get({quoted(node.name)}) for item in {text}]"
        if self._from_table(node.value) and not may_find_nothing(node.value):
            return f"{text}[{quoted(node.name)}]"
        return f"{self.module.function('attribute')}({text}, {quoted(node.name)})"

    def _is_of_items(self, node: Node) -> bool:
        """Whether a node stands for what all items of a list have there."""
        if not isinstance(node, Attribute):
            return False
        entry = entry_of(node.value, self.scope)
        return (entry is not None and entry.kind == "list") or self._is_of_items(node.value)

    def _may_be_absent(self, node: Node) -> bool:
        entry = entry_of(node, self.scope)
        absent = may_find_nothing(node) or (entry is not None and entry.may_be_absent)
        return absent or (isinstance(node, Attribute) and self._may_be_absent(node.value))

    def _from_table(self, node: Node) -> bool:
        while isinstance(node, (Attribute, Index)):
            node = node.value
        known = isinstance(node, Name) and self.scope.find(node.name) is None
        return known and isinstance(node, Name) and self.module.table(node.name) is not None

    def line_time(self, node: LineTime) -> str:
        return f"{self.context('line')}.{node.unit}({node.count[0]}, {node.count[1]})"

    def call(self, function: str, arguments: list[str]) -> str:
        return f"{self.module.function(function)}({', '.join(arguments)})"


def is_flag(node: Node) -> bool:
    """Whether an expression gives true or false."""
    match node:
        case Compare() | Unary(operator="not"):
            return True
        case Logic(operands=operands):
            return all(is_flag(operand) for operand in operands)
        case Conditional(then=then, otherwise=otherwise):
            return is_flag(then) or is_flag(otherwise)
        case Call(function=function):
            return FUNCTIONS[function].gives == "flag"
        case Name(name=name):
            return name == LAST
    return False


def constant_of(expression: Expression | None) -> int | None:
    """The number of an expression that is a plain number."""
    if expression is None or not isinstance(expression.root, Number):
        return None
    return expression.root.value


def may_fail(node: Node) -> bool:
    """Whether working out an expression on values from the wire can raise an error."""
    for part in walk(node):
        match part:
            case Index() | Attribute() | LineTime():
                return True
            case Call(function=function) if function not in (
                "len",
                "min",
                "max",
                "abs",
                "lower",
                "upper",
                "get",
                "bit",
            ):
                return True
            case Binary(operator="*", left=left, right=right):
                if not isinstance(left, Number) and not isinstance(right, Number):
                    return True
            case Binary(operator=operator, right=right) if operator in ("//", "%", "<<", ">>"):
                if not (isinstance(right, Number) and right.value > 0):
                    return True
    return False


def default_text(text: str, field: Field) -> str:
    """A default given by a name of `values` is its number."""
    if field.values is not None:
        for number, name in field.values.items():
            if text == literal(name):
                return str(number)
    return text
