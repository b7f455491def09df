"""Expressions of a definition in Kaitai's language, which tells numbers, flags, texts and bytes apart.

A name is a path from the type in which the expression stands: `count`, `_parent.count`, `part.as<case_1>.count`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from framekit.codec.kaitai.source import data, identifier, string
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
from framekit.definition.problems import CannotSayError

MOST_ENTRIES = 64
"""Entries of a table that become a chain of choices."""
_BINARY = {"+": "+", "-": "-", "*": "*", "//": "/", "%": "%", "&": "&", "|": "|", "^": "^", "<<": "<<", ">>": ">>"}
_PARAMETERS = {"number": ("s8", "int"), "flag": ("bool", "bool"), "text": ("str", "str"), "choice": ("str", "str"),
               "bytes": ("bytes", "bytes"), "time": ("s8", "int")}  # fmt: skip
_MOST = (1 << 63) - 1


@dataclass(frozen=True, slots=True)
class KsyEntry:
    """What a name stands for: its path, what kind of value that is, and what is in it."""

    path: str
    kind: str
    members: Mapping[str, KsyEntry] = field(default_factory=dict)
    why_not: str = ""

    def behind(self, path: str) -> KsyEntry:
        """The same, seen from a type that holds it at `path`."""
        return replace(self, path=f"{path}.{self.path}")


class Scope:
    """Names that a type has, and those of the type around it, which is `up` away."""

    def __init__(self, outer: Scope | None = None, up: str = "_parent.") -> None:
        self.outer, self.up = outer, up
        self.entries: dict[str, KsyEntry] = {}

    def find(self, name: str) -> KsyEntry | None:
        if name in self.entries:
            return self.entries[name]
        found = None if self.outer is None else self.outer.find(name)
        return None if found is None else replace(found, path=f"{self.up}{found.path}")


@dataclass(frozen=True, slots=True)
class Said:
    """A part of an expression: its text, which binds tightest, and its kind."""

    text: str
    kind: str


class KaitaiExpressions:
    """Writes the expressions of one protocol. `params`: what is asked of the outside, name → type."""

    def __init__(self, protocol: Protocol) -> None:
        self.protocol = protocol
        self.params: dict[str, str] = {}

    def number(self, expression: Expression, scope: Scope) -> str:
        """Raises CannotSayError."""
        return self._number(self.said(expression.root, scope), expression.root)

    def condition(self, expression: Expression, scope: Scope) -> str:
        """Raises CannotSayError."""
        return self._flag(self.said(expression.root, scope), expression.root)

    def value(self, expression: Expression, scope: Scope) -> Said:
        """Its text and kind; flags are numbers. Raises CannotSayError."""
        said = self.said(expression.root, scope)
        return Said(self._number(said, expression.root), "int") if said.kind == "bool" else said

    def said(self, node: Node, scope: Scope) -> Said:
        """Raises CannotSayError."""
        match node:
            case Number(value=value) if abs(value) <= _MOST:
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
                return Said(entry.path, entry.kind)
            case Index(value=value, index=index):
                return self._index(node, value, index, scope)
            case Call(function=function, arguments=arguments):
                return self._call(node, function, arguments, scope)
            case Unary(operator="not", operand=operand):
                return Said(f"(not {self._flag(self.said(operand, scope), operand)})", "bool")
            case Unary(operator=operator, operand=operand):
                return Said(f"({operator}{self._number(self.said(operand, scope), operand)})", "int")
            case Binary(operator=operator, left=left, right=right):
                return self._binary(operator, self.said(left, scope), self.said(right, scope), node)
            case Compare(first=first, rest=rest):
                operands = [first, *(one for _, one in rest)]
                parts = [self._compared(a, op, b, scope) for a, (op, b) in zip(operands, rest, strict=False)]
                return Said(f"({' and '.join(parts)})", "bool")
            case Logic(operator=operator, operands=operands):
                flags = (self._flag(self.said(one, scope), one) for one in operands)
                return Said(f"({f' {operator} '.join(flags)})", "bool")
            case Conditional(condition=condition, then=then, otherwise=otherwise):
                flag = self._flag(self.said(condition, scope), condition)
                return self._chosen(flag, self.said(then, scope), self.said(otherwise, scope), node)
        raise self._not(node, "this expression")

    def _not(self, node: Node, what: str) -> CannotSayError:
        return CannotSayError(node.at, f"{what} is left out", "Kaitai's expressions have nothing like it")

    def _number(self, said: Said, node: Node) -> str:
        if said.kind == "bool":
            return f"({said.text} ? 1 : 0)"
        if said.kind in ("int", "float"):
            return said.text
        raise self._not(node, "a number made of another kind of value")

    def _flag(self, said: Said, node: Node) -> str:
        if said.kind == "bool":
            return said.text
        if said.kind in ("int", "float"):
            return f"({said.text} != 0)"
        if said.kind in ("str", "bytes"):
            return f"({said.text}.length != 0)"
        raise self._not(node, "a condition that asks whether something is there")

    def _name(self, node: Node, name: str, scope: Scope) -> Said:
        entry = scope.find(name)
        if entry is not None:
            if entry.why_not:
                raise CannotSayError(node.at, f"'{name}' is not asked for", entry.why_not)
            return Said(entry.path, entry.kind)
        if name in (LAST, PREVIOUS):
            raise self._not(node, f"the word '{name.partition('.')[2]}' in an item")
        parameter, state = self.protocol.params.get(name), self.protocol.state.get(name)
        type_ = parameter.type if parameter is not None and not parameter.secret else None
        if state is not None and state.keys is None:
            numbers = state.type[:1] in "ui" and state.type[1:].isdigit()
            type_ = "number" if numbers else state.type
        if type_ not in _PARAMETERS:
            raise CannotSayError(node.at, f"'{name}' is left out", "only framekit knows it while it runs")
        self.params[name], kind = _PARAMETERS[type_]
        return Said(f"_root.{identifier(name)}", kind)

    def _entry(self, node: Node, scope: Scope) -> KsyEntry | None:
        if isinstance(node, Name):
            return scope.find(node.name)
        if isinstance(node, Attribute):
            outer = self._entry(node.value, scope)
            inner = None if outer is None or outer.kind != "record" else outer.members.get(node.name)
            return None if inner is None or outer is None else inner.behind(outer.path)
        if isinstance(node, Index):
            outer = self._entry(node.value, scope)
            if outer is not None and outer.kind == "list" and outer.members:
                index = self._number(self.said(node.index, scope), node.index)
                return replace(outer, path=f"{outer.path}[{index}]", kind="record")
        return None

    def _index(self, node: Node, value: Node, index: Node, scope: Scope) -> Said:
        table = self.protocol.tables.get(value.name) if isinstance(value, Name) else None
        if table is not None and isinstance(value, Name) and scope.find(value.name) is None:
            return self._looked_up(node, index, scope, None)
        said, at = self.said(value, scope), self.said(index, scope)
        if said.kind != "bytes":
            raise self._not(node, "an item that is looked for")
        return Said(f"{said.text}[{self._number(at, index)}]", "int")

    def _looked_up(self, node: Node, key: Node, scope: Scope, otherwise: Said | None) -> Said:
        """An entry of a table of numbers, as a chain of choices."""
        name = node.value if isinstance(node, Index) else node.arguments[0] if isinstance(node, Call) else None
        table = self.protocol.tables[name.name] if isinstance(name, Name) else None
        entries = {} if table is None else dict(table.entries)
        plain = all(isinstance(one, int) for one in entries.values())
        if table is None or not entries or table.ranges or not plain or len(entries) > MOST_ENTRIES:
            raise self._not(node, "a table of this kind")
        asked = self.said(key, scope)
        text = otherwise.text if otherwise is not None else repr([*entries.values()][-1])
        rows = [*entries.items()] if otherwise is not None else [*entries.items()][:-1]
        for one, value in reversed(rows):
            shown = string(one) if isinstance(one, str) else str(one)
            text = f"({asked.text} == {shown} ? {value!r} : {text})"
        return Said(text, "int")

    def _binary(self, operator: str, left: Said, right: Said, node: Node) -> Said:
        if operator == "+" and left.kind == right.kind == "str":
            return Said(f"({left.text} + {right.text})", "str")
        if operator not in _BINARY:
            raise self._not(node, f"the operator '{operator}'")
        texts = self._number(left, node), self._number(right, node)
        kind = "float" if "float" in (left.kind, right.kind) else "int"
        return Said(f"({texts[0]} {_BINARY[operator]} {texts[1]})", kind)

    def _compared(self, left: Node, operator: str, right: Node, scope: Scope) -> str:
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

    def _call(self, node: Call, function: str, arguments: tuple[Node, ...], scope: Scope) -> Said:
        if function == "get" and isinstance(arguments[0], Name) and arguments[0].name in self.protocol.tables:
            return self._looked_up(node, arguments[1], scope, self.said(arguments[2], scope))
        if function not in ("len", "min", "max", "abs", "number", "text", "bit"):
            raise self._not(node, f"the function '{function}'")
        said = [self.said(one, scope) for one in arguments]
        first = said[0]
        if function == "len" and first.kind in ("bytes", "str", "list"):
            return Said(f"{first.text}.{'size' if first.kind == 'list' else 'length'}", "int")
        if function == "number" and first.kind == "str":
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
