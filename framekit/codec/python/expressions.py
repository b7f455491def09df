"""Write expressions of a definition as Python source, with their names resolved.

A `FieldScope` holds the fields around an expression; tables become module constants; all other names are read from the
context. `expression.emit` defines the operators and functions, for engines too.
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
    """The meaning of a name."""

    text: str
    """The source of its value."""
    kind: Kind = "value"
    inside: FieldScope | None = None
    """The names inside a record, or inside the items of a list."""
    wire: str | None = None
    """The source of its size on the wire in bytes."""
    sized: bool = True
    """Whether the language's `len` of it is Python's `len`."""
    is_read: bool = True
    """Whether it already has its value."""
    may_be_absent: bool = False
    """Whether its value may be None."""
    direct: bool = False
    """Whether the names inside a record are locals."""
    record: Any = None
    """The object that assembles a record whose names are locals."""
    path: str = ""
    """The path of the segment, if the careful reading records its size."""


class FieldScope:
    """Fields by name, searched from the innermost scope outwards."""

    def __init__(self, parent: FieldScope | None = None, declared: Iterable[Segment] = ()) -> None:
        self.parent = parent
        self.declared = {name for segment in flat(declared) for name in segment.value_names}
        """Names of the fields of this scope, also of fields that are not read yet."""
        self.entries: dict[str, NameEntry] = {}

    def close(self) -> None:
        """Make the names inside records accessible only through the value of the record."""
        for entry in self.entries.values():
            entry.direct = False
            if entry.inside is not None and entry.kind == "record":
                entry.inside.close()

    def find(self, name: str) -> NameEntry | None:
        """Return the entry of a name from the innermost scope that declares it, or None."""
        scope: FieldScope | None = self
        while scope is not None:
            if name in scope.entries:
                return scope.entries[name]
            scope = None if name in scope.declared else scope.parent
        return None


def entry_of(node: Node, scope: FieldScope) -> NameEntry | None:
    """Return the entry of a node that is a field, a part of a field, or an item of a list; else None."""
    if isinstance(node, Name):
        return scope.find(node.name)
    if isinstance(node, Attribute):
        outer = entry_of(node.value, scope)
        return None if outer is None or outer.inside is None else outer.inside.entries.get(node.name)
    if isinstance(node, Index):
        outer = entry_of(node.value, scope)
        return NameEntry("", "record", outer.inside) if outer is not None and outer.kind == "list" else None
    return None


def entries_read(node: Node, scope: FieldScope, fields: Iterable[str]) -> Iterator[NameEntry | None]:
    """Yield the entries of the fields that an expression reads; None for a field that is not known yet.

    For an attribute of a record only the attribute's entry is yielded.
    """
    if isinstance(node, Name) and (node.name in fields or node.name == LAST):
        yield scope.find(node.name)
    outer = entry_of(node.value, scope) if isinstance(node, Attribute) else None
    if isinstance(node, Attribute) and outer is not None and outer.kind == "record" and outer.inside is not None:
        yield outer.inside.entries.get(node.name)
        return
    for child in children(node):
        yield from entries_read(child, scope, fields)


class Outside(Protocol):
    """The module and function around an expression, as far as the expression needs them."""

    def table(self, name: str) -> str | None:
        """Return the module constant of a table, or None if no table has that name."""

    def function(self, name: str) -> str:
        """Return the name of an inlined function."""


class ExpressionWriter:
    """Write expressions in a scope. `context` returns the source of a name that is neither a field nor a table."""

    def __init__(self, module: Outside, scope: FieldScope, context: Callable[[str], str]) -> None:
        self.module = module
        self.scope = scope
        self.context = context

    def text(self, expression: Expression, level: int = CONDITIONAL) -> str:
        """Return the source of an expression, in parentheses if it binds weaker than `level`."""
        return emit(self._prepared(expression.root), self, level)

    def negated(self, expression: Expression) -> str:
        """Return the source of `not expression` as an operand of `or`, with the opposite comparison if possible."""
        root = expression.root
        if isinstance(root, Unary) and root.operator == "not":
            return emit(self._prepared(root.operand), self, AND)
        if isinstance(root, Compare) and len(root.rest) == 1:
            operator, right = root.rest[0]
            opposite = replace(root, rest=((_OPPOSITE[operator], right),))
            return emit(self._prepared(opposite), self, AND)
        return f"not {self.text(expression, COMPARE)}"

    def value(self, expression: Expression) -> str:
        """Return the source of an expression as a field's value: flags become numbers."""
        return f"int({self.text(expression)})" if is_flag(expression.root) else self.text(expression)

    def _prepared(self, node: Node) -> Node:
        """Return the node with literals resolved, and `len(x)` of a value without a length as its encoded size."""
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
        ):  # attributes of an absent record are None
            text = f"({text} or {{}})" if self._may_be_absent(node.value) else text
            return f"{text}.get({quoted(node.name)})"
        if entry is not None and entry.kind == "list":
            return f"[item.get({quoted(node.name)}) for item in {text}]"
        if self._from_table(node.value) and not may_find_nothing(node.value):
            return f"{text}[{quoted(node.name)}]"
        return f"{self.module.function('attribute')}({text}, {quoted(node.name)})"

    def _is_of_items(self, node: Node) -> bool:
        """Return whether a node refers to an attribute of all items of a list."""
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
    """Return whether an expression results in true or false."""
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
    """Return the number of an expression that is a plain number, else None."""
    if expression is None or not isinstance(expression.root, Number):
        return None
    return expression.root.value


def may_fail(node: Node) -> bool:
    """Return whether evaluating an expression on values from the wire can raise an error."""
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
    """Return a default with a name from `values` replaced by its number."""
    if field.values is not None:
        for number, name in field.values.items():
            if text == literal(name):
                return str(number)
    return text
