"""Translate expressions of a definition to Kaitai's language, which distinguishes numbers, flags, texts and bytes.

A name becomes a path from the type that contains the expression: `count`, `_parent.count`, `part.as<case_1>.count`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

from framekit.definition.expression import (
    Attribute,
    Binary,
    Bytes,
    Call,
    Compare,
    Conditional,
    Expression,
    Index,
    List,
    Logic,
    Name,
    Node,
    Number,
    Text,
    Unary,
)
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.segments import LAST, PREVIOUS
from framekit.definition.problems import CannotSayError, Position
from framekit.extras.kaitai.source import KsyNames, data, string

MOST_ENTRIES = 64
"""Limit of the entries of a table that is written as a chain of conditionals."""
MOST_TEXT = 8000
"""Limit of the length of an expression, which may grow exponentially when parts are repeated."""
TOP_NAMES = ("frame", "content", "end")
"""Names of the top type, besides the parameters of the protocol."""
_BINARY = {"+": "+", "-": "-", "*": "*", "//": "/", "%": "%", "&": "&", "|": "|", "^": "^", "<<": "<<", ">>": ">>"}
_PARAMETERS = {"number": ("s8", "int"), "flag": ("bool", "bool"), "text": ("str", "str"), "choice": ("str", "str"),
               "bytes": ("bytes", "bytes"), "time": ("s8", "int")}  # fmt: skip
MOST_NUMBER = (1 << 63) - 1
"""The greatest number in Kaitai; the least is its negative."""
_FAILS = "(1 / 0)"
"""An expression without a value: evaluating it fails."""


Presence = tuple[object, object]
"""A condition: the record that it belongs to, and its expression."""


@dataclass(frozen=True, slots=True)
class KsyEntry:
    """The meaning of a name."""

    path: str
    """Its path in Kaitai."""
    kind: str
    """The kind of its value."""
    members: Mapping[str, KsyEntry] = field(default_factory=dict)
    """The names inside a record, or inside the items of a list."""
    why_not: str = ""
    """Why the value cannot be used in expressions; empty if it can."""
    is_natural: bool = False
    """Whether it is a number that is never negative."""
    needs: frozenset[Presence] = frozenset()
    """The conditions under which it is present."""

    def behind(self, path: str) -> KsyEntry:
        """Return the entry as seen from a type that holds it at `path`."""
        return replace(self, path=f"{path}.{self.path}")


class TypeScope:
    """The names of a type and of the types around it; `up` is the path to the next outer type."""

    def __init__(
        self, outer: TypeScope | None = None, up: str = "_parent.", *, is_record: bool = True, is_apart: bool = False
    ) -> None:  # fmt: skip
        """Create a scope.

        `is_record`: the values form a record of their own; `is_apart`: the type is read without access to its
        surroundings.
        """
        self.outer, self.up, self.is_apart = outer, up, is_apart
        self.record: object = object() if outer is None or is_record else outer.record
        self.entries: dict[str, KsyEntry] = {}
        self.holds: set[Presence] = set()
        """The conditions that are true wherever the type is read."""

    def find(self, name: str) -> KsyEntry | None:
        """Return the entry of a name, its path adjusted to this scope, or None."""
        if name in self.entries:
            return self.entries[name]
        found = None if self.outer is None else self.outer.find(name)
        if found is not None and self.is_apart:
            return replace(found, why_not="it stands outside of what is read apart from the frame")
        return None if found is None else replace(found, path=f"{self.up}{found.path}")

    def is_there(self, entry: KsyEntry) -> bool:
        """Return whether a value is present wherever this type is read."""
        left: frozenset[Presence] = entry.needs
        scope: TypeScope | None = self
        while left and scope is not None:
            left, scope = left - scope.holds, scope.outer
        return not left

    def condition(self, node: Node) -> Presence:
        """Return the fact that a condition holds in this record."""
        return self.record, _shape(node)

    def conditions(self, node: Node) -> set[Presence]:
        """Return all facts that follow from a condition."""
        parts = node.operands if isinstance(node, Logic) and node.operator == "and" else ()
        return {self.condition(one) for one in (node, *parts)}

    def where(self, *nodes: Node) -> TypeScope:
        """Return this scope with the given conditions assumed true."""
        scope = TypeScope(self, "", is_record=False)
        for node in nodes:
            scope.holds |= self.conditions(node)
        return scope


def _shape(value: Any) -> object:
    """Return an expression without its positions, for comparison."""
    if isinstance(value, Node):
        parts = (_shape(getattr(value, one.name)) for one in fields(value) if one.name != "at")
        return (type(value).__name__, *parts)
    return tuple(map(_shape, value)) if isinstance(value, tuple) else value


@dataclass(frozen=True, slots=True)
class Said:
    """A translated part of an expression: its text, in parentheses if necessary, and its kind."""

    text: str
    kind: str


class KaitaiExpressions:
    """Translate the expressions of a protocol; the callback `tell` receives each translation with different details."""

    def __init__(self, protocol: Protocol, tell: Callable[[Position, str, str], None]) -> None:
        self.protocol, self.tell = protocol, tell
        self.params: dict[str, tuple[str, str]] = {}
        """Parameters of the top type by the protocol's names: Kaitai's name and type."""
        self._names = KsyNames(TOP_NAMES)

    def number(self, expression: Expression, scope: TypeScope) -> str:
        """Return an expression as a number. Raises CannotSayError."""
        return self._number(self.said(expression.root, scope), expression.root)

    def condition(self, expression: Expression, scope: TypeScope) -> str:
        """Return an expression as a condition. Raises CannotSayError."""
        return self._truth(expression.root, scope)

    def value(self, expression: Expression, scope: TypeScope) -> Said:
        """Return an expression as a value; flags become numbers. Raises CannotSayError."""
        said = self.said(expression.root, scope)
        return Said(self._number(said, expression.root), "int") if said.kind == "bool" else said

    def is_natural(self, expression: Expression, scope: TypeScope) -> bool:
        """Return whether the number is certainly never negative."""
        return self._is_natural(expression.root, scope)

    def said(self, node: Node, scope: TypeScope) -> Said:
        """Return the translation of a node. Raises CannotSayError."""
        said = self._said(node, scope)
        if len(said.text) > MOST_TEXT:
            raise CannotSayError(node.at, "an expression is left out", f"it takes more than {MOST_TEXT} characters")
        return said

    def _said(self, node: Node, scope: TypeScope) -> Said:
        match node:
            case Number(value=value) if abs(value) <= MOST_NUMBER:
                return Said(str(value) if value >= 0 else f"({value})", "int")
            case Text(value=value):
                return Said(string(value), "str")
            case Bytes(value=value):
                return Said(data(value), "bytes")
            case Name(name=name):
                return self._name(node, name, scope)
            case Attribute(name=name):
                entry = self._entry(node, scope)
                if entry is None:
                    raise self._not(node, f"'.{name}'")
                return self._known(node, name, entry, scope)
            case Index(value=value, index=index):
                return self._index(node, value, index, scope)
            case Call(function=function, arguments=arguments):
                return self._call(node, function, arguments, scope)
            case Unary(operator="not", operand=operand):
                return Said(f"(not {self._truth(operand, scope)})", "bool")
            case Unary(operator=operator, operand=operand):
                return Said(f"({operator}{self._number(self.said(operand, scope), operand)})", "int")
            case Binary():
                return self._binary(node, scope)
            case Compare(first=first, rest=rest):
                operands = [first, *(one for _, one in rest)]
                parts = [self._compared(a, op, b, scope) for a, (op, b) in zip(operands, rest, strict=False)]
                return Said(f"({' and '.join(parts)})", "bool")
            case Logic():
                return self._logic(node, scope)
            case Conditional(condition=condition, then=then, otherwise=otherwise):
                flag = self._truth(condition, scope)
                return self._chosen(flag, self.said(then, scope.where(condition)), self.said(otherwise, scope), node)
        raise self._not(node, "this expression")

    def _not(self, node: Node, what: str) -> CannotSayError:
        return CannotSayError(node.at, f"{what} is left out", "Kaitai's expressions have nothing like it")

    def _number(self, said: Said, node: Node) -> str:
        if said.kind == "bool":
            return f"({said.text} ? 1 : 0)"
        if said.kind in ("int", "float"):
            return said.text
        raise self._not(node, "a number made of another kind of value")

    def _truth(self, node: Node, scope: TypeScope) -> str:
        """Return the condition that a node is true."""
        if isinstance(node, Logic):
            flags = (self._truth(one, inside) for one, inside in _operands(node, scope))
            return f"({f' {node.operator} '.join(flags)})"
        return self._flag(self.said(node, scope), node)

    def _logic(self, node: Logic, scope: TypeScope) -> Said:
        """Return the value of the deciding operand, as in the definition language: `a or 5` is a number."""
        *others, last = [(one, self.said(one, inside)) for one, inside in _operands(node, scope)]
        if all(said.kind == "bool" for _, said in (*others, last)):
            return Said(self._truth(node, scope), "bool")
        found = last[1]
        for one, said in reversed(others):
            first, second = (said, found) if node.operator == "or" else (found, said)
            found = self._chosen(self._flag(said, one), first, second, node)
        return found

    def _flag(self, said: Said, node: Node) -> str:
        if said.kind == "bool":
            return said.text
        if said.kind in ("int", "float"):
            return f"({said.text} != 0)"
        if said.kind in ("str", "bytes"):
            return f"({said.text}.length != 0)"
        raise self._not(node, "a condition that asks whether something is there")

    def _name(self, node: Node, name: str, scope: TypeScope) -> Said:
        entry = scope.find(name)
        if entry is not None:
            return self._known(node, name, entry, scope)
        if name in (LAST, PREVIOUS):
            raise self._not(node, f"the word '{name.partition('.')[2]}' in an item")
        parameter, state = self.protocol.params.get(name), self.protocol.state.get(name)
        type_ = parameter.type if parameter is not None and not parameter.secret else None
        if state is not None and state.keys is None:
            numbers = state.type[:1] in "ui" and state.type[1:].isdigit()
            type_ = "number" if numbers else state.type
        if type_ not in _PARAMETERS:
            raise CannotSayError(node.at, f"'{name}' is left out", "only framekit knows it while it runs")
        here, kind = _PARAMETERS[type_]
        if name not in self.params:
            self.params[name] = self._names.new(name), here
        return Said(f"_root.{self.params[name][0]}", kind)

    def _known(self, node: Node, name: str, entry: KsyEntry, scope: TypeScope) -> Said:
        """Return the value of an entry. Raises CannotSayError if it may be absent, as Kaitai has no absent values."""
        why = entry.why_not or ("" if scope.is_there(entry) else "it may be absent, and Kaitai has no value for that")
        if why:
            raise CannotSayError(node.at, f"'{name}' is not asked for", why)
        return Said(entry.path, entry.kind)

    def _entry(self, node: Node, scope: TypeScope) -> KsyEntry | None:
        if isinstance(node, Name):
            return scope.find(node.name)
        if isinstance(node, Attribute):
            outer = self._entry(node.value, scope)
            inner = None if outer is None or outer.kind != "record" else outer.members.get(node.name)
            if inner is None or outer is None:
                return None
            found, needs = inner.behind(outer.path), outer.needs | inner.needs
            return replace(found, why_not=outer.why_not or inner.why_not, needs=needs)
        if isinstance(node, Index):
            outer = self._entry(node.value, scope)
            if outer is not None and outer.kind == "list" and outer.members:
                index = self._number(self.said(node.index, scope), node.index)
                return replace(outer, path=f"{outer.path}[{index}]", kind="record")
        return None

    def _index(self, node: Node, value: Node, index: Node, scope: TypeScope) -> Said:
        table = self.protocol.tables.get(value.name) if isinstance(value, Name) else None
        if table is not None and isinstance(value, Name) and scope.find(value.name) is None:
            return self._looked_up(node, index, scope, None)
        said, at = self.said(value, scope), self.said(index, scope)
        if said.kind != "bytes":
            raise self._not(node, "an item that is looked for")
        return Said(f"{said.text}[{self._number(at, index)}]", "int")

    def _looked_up(self, node: Node, key: Node, scope: TypeScope, otherwise: Said | None) -> Said:
        """Return an entry of a table of numbers, as a chain of conditionals."""
        name = node.value if isinstance(node, Index) else node.arguments[0] if isinstance(node, Call) else None
        table = self.protocol.tables[name.name] if isinstance(name, Name) else None
        entries = {} if table is None else dict(table.entries)
        plain = all(isinstance(one, int) for one in entries.values())
        if table is None or not entries or table.ranges or not plain or len(entries) > MOST_ENTRIES:
            raise self._not(node, "a table of this kind")
        asked = self.said(key, scope)
        text = otherwise.text if otherwise is not None else _FAILS
        for one, value in reversed(entries.items()):
            shown = string(one) if isinstance(one, str) else str(one)
            text = f"({asked.text} == {shown} ? {value!r} : {text})"
        return Said(text, "int")

    def _binary(self, node: Binary, scope: TypeScope) -> Said:
        operator, left, right = node.operator, self.said(node.left, scope), self.said(node.right, scope)
        if operator == "+" and left.kind == right.kind == "str":
            return Said(f"({left.text} + {right.text})", "str")
        if operator not in _BINARY:
            raise self._not(node, f"the operator '{operator}'")
        a, b = self._number(left, node), self._number(right, node)
        kind = "float" if "float" in (left.kind, right.kind) else "int"
        if operator in ("//", "%") and not (self._is_natural(node.left, scope) and self._is_natural(node.right, scope)):
            if not isinstance(node.right, Number) or node.right.value <= 0:
                why = "languages that Kaitai writes do not agree on divisions of negative numbers"
                raise CannotSayError(node.at, f"the operator '{operator}' is left out", why)
            a = f"({a} - {a} % {b})" if operator == "//" else a  # subtracting the remainder makes the division exact
        return Said(f"({a} {_BINARY[operator]} {b})", kind)

    def _is_natural(self, node: Node, scope: TypeScope) -> bool:
        """Return whether a number is never negative."""
        match node:
            case Number(value=value):
                return value >= 0
            case Name() | Attribute():
                entry = self._entry(node, scope)
                return entry is not None and entry.is_natural
            case Index(value=value):
                table = self.protocol.tables.get(value.name) if isinstance(value, Name) else None
                return table is None or all(isinstance(one, int) and one >= 0 for one in table.entries.values())
            case Binary(operator="+" | "*" | "//" | "%" | "&" | "|" | "<<" | ">>", left=left, right=right):
                return self._is_natural(left, scope) and self._is_natural(right, scope)
            case Conditional(then=then, otherwise=otherwise):
                return self._is_natural(then, scope) and self._is_natural(otherwise, scope)
            case Call(function="min" | "max", arguments=arguments):
                return all(self._is_natural(one, scope) for one in arguments)
            case Call(function=function):
                return function in ("len", "abs", "bit")
        return isinstance(node, Compare)

    def _compared(self, left: Node, operator: str, right: Node, scope: TypeScope) -> str:
        if operator in ("in", "not in"):
            if not isinstance(right, List):
                raise self._not(right, "a search in a table or text")
            flags = " or ".join(self._compared(left, "==", one, scope) for one in right.items) or "false"
            return f"({flags})" if operator == "in" else f"(not ({flags}))"
        first, second = self.said(left, scope), self.said(right, scope)
        if first.kind == second.kind == "bool":
            return f"{first.text} {operator} {second.text}"
        if first.kind in ("str", "bytes") and first.kind == second.kind:
            return f"{first.text} {operator} {second.text}"
        return f"{self._number(first, left)} {operator} {self._number(second, right)}"

    def _chosen(self, flag: str, then: Said, otherwise: Said, node: Node) -> Said:
        if then.kind == otherwise.kind:
            return Said(f"({flag} ? {then.text} : {otherwise.text})", then.kind)
        texts = self._number(then, node), self._number(otherwise, node)
        return Said(f"({flag} ? {texts[0]} : {texts[1]})", "float" if "float" in (then.kind, otherwise.kind) else "int")

    def _call(self, node: Call, function: str, arguments: tuple[Node, ...], scope: TypeScope) -> Said:
        if function == "get" and isinstance(arguments[0], Name) and arguments[0].name in self.protocol.tables:
            return self._looked_up(node, arguments[1], scope, self.said(arguments[2], scope))
        if function not in ("len", "min", "max", "abs", "number", "text", "bit"):
            raise self._not(node, f"the function '{function}'")
        said = [self.said(one, scope) for one in arguments]
        first = said[0]
        if function == "len" and first.kind in ("bytes", "str", "list"):
            return Said(f"{first.text}.{'size' if first.kind == 'list' else 'length'}", "int")
        if function == "number" and first.kind == "str":
            self.tell(node.at, "'number' also reads signs, spaces and '_'", "Kaitai does not look at each character")
            base = "" if len(said) == 1 else self._number(said[1], node)
            return Said(f"{first.text}.to_i({base})" if base else f"{first.text}.to_i", "int")
        numbers = [self._number(one, node) for one in said]
        match function:
            case "abs":
                return Said(f"({numbers[0]} < 0 ? -{numbers[0]} : {numbers[0]})", "int")
            case "bit":
                return Said(f"(({numbers[0]} >> {numbers[1]}) & 1)", "int")
            case "text":
                return Said(f"{numbers[0]}.to_s", "str")
            case "min" | "max":
                best = numbers[0]
                for one in numbers[1:]:
                    best = f"({best} {'<' if function == 'min' else '>'} {one} ? {best} : {one})"
                return Said(best, "int")
        raise self._not(node, f"the function '{function}' of such a value")


def _operands(node: Logic, scope: TypeScope) -> Iterator[tuple[Node, TypeScope]]:
    """Yield the operands of `and` and `or` with their scopes; after an `and`, the earlier operands are true."""
    inside = scope.where()
    for operand in node.operands:
        yield operand, inside
        if node.operator == "and":
            inside.holds |= scope.conditions(operand)
