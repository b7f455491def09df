"""Translate expressions of a definition to Lua: each operator and function is a call of a function in `values.lua`.

An expression without a Lua form becomes a call that fails when it is reached; a frame that does not reach it is read.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

from framekit.codec.python.expressions import FieldScope
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
    Real,
    Slice,
    Text,
    Unary,
    may_find_nothing,
)
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.segments import INDEX, LAST, PREVIOUS
from framekit.definition.problems import CannotSayError, Problem
from framekit.extras.wireshark.source import listed, not_said, number, string

_BINARY = {
    "+": "add", "-": "sub", "*": "mul", "//": "div", "%": "mod", "&": "band", "|": "bor", "^": "bxor", "<<": "shl",
    ">>": "shr",
}  # fmt: skip
_UNARY = {"-": "neg", "~": "inv", "not": "no"}
_COMPARE = {
    "==": "eq", "!=": "ne", "<": "lt", "<=": "le", ">": "gt", ">=": "ge", "in": "isin", "not in": "notin",
}  # fmt: skip
_FUNCTIONS = frozenset(
    {
        "len", "min", "max", "abs", "sum", "lower", "upper", "text", "number", "digits", "bit", "rotl8", "same", "get",
        "find", "find_last", "either", "only", "span", "ms", "xor",
    }
)  # fmt: skip


class LuaExpressions:
    """Write the expressions of a protocol."""

    def __init__(self, protocol: Protocol) -> None:
        self.protocol = protocol
        self.problems: list[Problem] = []
        """The expressions without a Lua form."""
        self.asked: set[str] = set()
        """The names that expressions read and no field has: parameters and state."""
        self.tables: set[str] = set()
        """The names of the tables that expressions read."""

    def function(self, expression: Expression, scope: FieldScope) -> str:
        """Return a Lua function that evaluates the expression while a frame is read."""
        return f"function(n) return {self.text(expression.root, scope)} end"

    def text(self, node: Node, scope: FieldScope, own: Collection[str] = ()) -> str:
        """Return an expression in Lua; `own` are Lua names that it may read.

        An expression without a Lua form becomes a call that fails when it is reached.
        """
        try:
            return _ScopedWriter(self, scope, own).value(node)
        except CannotSayError as error:
            if error.problem not in self.problems:
                self.problems.append(error.problem)
            return f"X.limit({string(error.problem.what)})"


@dataclass(frozen=True, slots=True)
class _ScopedWriter:
    """Write the nodes of an expression in one scope. Raises CannotSayError for a node without a Lua form."""

    expressions: LuaExpressions
    scope: FieldScope
    own: Collection[str]
    """Lua names that the expression may read."""

    def value(self, node: Node) -> str:
        match node:
            case Number(value=value):
                return number(value, node.at)
            case Real(value=value):
                return f"({float(value)!r})"
            case Text(value=text):
                return string(text)
            case Bytes(value=data):
                return f"X.bytes({string(data)})"
            case Name():
                return self.name(node)
            case Attribute(value=value, name=name):
                return f"X.attr({self.value(value)}, {string(name)})"
            case Index(value=value, index=index):
                function = "item_at" if may_find_nothing(node) else "index"
                return f"X.{function}({self.value(value)}, {self.value(index)})"
            case Slice(value=value, start=start, stop=stop):
                edges = ("nil" if edge is None else self.value(edge) for edge in (start, stop))
                return f"X.slice({self.value(value)}, {', '.join(edges)})"
            case Call(function="none"):
                return "X.nothing"
            case Call(function=function, arguments=arguments):
                return self.call(node, function, arguments)
            case List(items=items):
                return f"X.list({listed(map(self.value, items))})"
        return self.operation(node)

    def operation(self, node: Node) -> str:
        match node:
            case Unary(operator=operator, operand=operand):
                return f"X.{_UNARY[operator]}({self.value(operand)})"
            case Binary(operator=operator, left=left, right=right):
                return f"X.{_BINARY[operator]}({self.value(left)}, {self.value(right)})"
            case Compare(first=first, rest=((operator, second),)):
                return f"X.{_COMPARE[operator]}({self.value(first)}, {self.value(second)})"
            case Compare(first=first, rest=rest):
                operands = [first, *(operand for _, operand in rest)]
                pairs = zip(operands, rest, strict=False)
                return f"X.all({', '.join(self.late(Compare(node.at, left, (one,))) for left, one in pairs)})"
            case Logic(operator=operator, operands=operands):
                return f"X.{'all' if operator == 'and' else 'any'}({', '.join(map(self.late, operands))})"
            case Conditional(condition=condition, then=then, otherwise=otherwise):
                return f"X.choose({self.value(condition)}, {self.late(then)}, {self.late(otherwise)})"
        raise not_said(node.at, "a time that follows the line's speed")

    def late(self, node: Node) -> str:
        """Return a Lua function that evaluates the node when its value is needed."""
        return f"function() return {self.expressions.text(node, self.scope, self.own)} end"

    def name(self, node: Name) -> str:
        name, protocol = node.name, self.expressions.protocol
        if name in self.own:
            return name
        if name in (INDEX, LAST, PREVIOUS):
            return f"X.item(n, {string(name)})"
        if self.scope.find(name) is not None:
            return f"X.of(n, {string(name)})"
        if name in protocol.tables:
            self.expressions.tables.add(name)
            return f"X.table({string(name)})"
        parameter = protocol.params.get(name)
        if parameter is not None and parameter.secret:
            raise not_said(node.at, f"'{name}', which is secret")
        if parameter is None and name not in protocol.state:
            raise not_said(node.at, f"'{name}', which only a running engine knows")
        self.expressions.asked.add(name)
        return f"X.given(n, {string(name)})"

    def call(self, node: Node, function: str, arguments: tuple[Node, ...]) -> str:
        if function == "len" and isinstance(arguments[0], Name):
            entry = self.scope.find(arguments[0].name)
            if entry is not None and not entry.sized and entry.path:
                return f"X.room(n, {string(entry.path)})"
        if function not in _FUNCTIONS:
            raise not_said(node.at, f"the function '{function}'")
        return f"X.{function}({', '.join(map(self.value, arguments))})"


def constant(value: Any, at: Any) -> str:
    """Return the Lua source of a value of a table, a parameter or a constant. Raises CannotSayError."""
    if value is None:
        return "X.nothing"
    if isinstance(value, int):
        return number(int(value), at)
    if isinstance(value, float):
        return f"({value!r})"
    if isinstance(value, str):
        return string(value)
    if isinstance(value, bytes):
        return f"X.bytes({string(value)})"
    if isinstance(value, (list, tuple)):
        return f"X.list({listed(constant(one, at) for one in value)})"
    if isinstance(value, dict):
        entries = ", ".join(f"[{constant(key, at)}] = {constant(one, at)}" for key, one in value.items())
        return f"{{ entries = {{ {entries} }}, ranges = {{}} }}"
    raise not_said(at, "a value that is neither number, text nor bytes")
