"""Translate expressions of a definition to Lua: each operator and function is a call of a function in `values.lua`.

An expression without a Lua form becomes a call that fails when it is reached; a frame that does not reach it is read.
"""

from __future__ import annotations

from collections.abc import Collection
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
            return self._node(node, scope, own)
        except CannotSayError as error:
            if error.problem not in self.problems:
                self.problems.append(error.problem)
            return f"X.limit({string(error.problem.what)})"

    def _node(self, node: Node, scope: FieldScope, own: Collection[str]) -> str:
        def of(part: Node) -> str:
            return self._node(part, scope, own)

        def late(part: Node) -> str:
            return f"function() return {self.text(part, scope, own)} end"

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
                return self._name(node, scope, own)
            case Attribute(value=value, name=name):
                return f"X.attr({of(value)}, {string(name)})"
            case Index(value=value, index=index):
                return f"X.{'item_at' if may_find_nothing(node) else 'index'}({of(value)}, {of(index)})"
            case Slice(value=value, start=start, stop=stop):
                edges = ("nil" if edge is None else of(edge) for edge in (start, stop))
                return f"X.slice({of(value)}, {', '.join(edges)})"
            case Call(function="none"):
                return "X.nothing"
            case Call(function=function, arguments=arguments):
                return self._call(node, function, arguments, scope, own)
            case Unary(operator=operator, operand=operand):
                return f"X.{_UNARY[operator]}({of(operand)})"
            case Binary(operator=operator, left=left, right=right):
                return f"X.{_BINARY[operator]}({of(left)}, {of(right)})"
            case Compare(first=first, rest=((operator, second),)):
                return f"X.{_COMPARE[operator]}({of(first)}, {of(second)})"
            case Compare(first=first, rest=rest):
                operands = [first, *(operand for _, operand in rest)]
                pairs = zip(operands, rest, strict=False)
                return f"X.all({', '.join(late(Compare(node.at, left, (one,))) for left, one in pairs)})"
            case Logic(operator=operator, operands=operands):
                return f"X.{'all' if operator == 'and' else 'any'}({', '.join(map(late, operands))})"
            case Conditional(condition=condition, then=then, otherwise=otherwise):
                return f"X.choose({of(condition)}, {late(then)}, {late(otherwise)})"
            case List(items=items):
                return f"X.list({listed(map(of, items))})"
        raise not_said(node.at, "a time that follows the line's speed")

    def _name(self, node: Name, scope: FieldScope, own: Collection[str]) -> str:
        name = node.name
        if name in own:
            return name
        if name in (INDEX, LAST, PREVIOUS):
            return f"X.item(n, {string(name)})"
        if scope.find(name) is not None:
            return f"X.of(n, {string(name)})"
        if name in self.protocol.tables:
            self.tables.add(name)
            return f"X.table({string(name)})"
        parameter = self.protocol.params.get(name)
        if parameter is not None and parameter.secret:
            raise not_said(node.at, f"'{name}', which is secret")
        if parameter is None and name not in self.protocol.state:
            raise not_said(node.at, f"'{name}', which only a running engine knows")
        self.asked.add(name)
        return f"X.given(n, {string(name)})"

    def _call(
        self, node: Node, function: str, arguments: tuple[Node, ...], scope: FieldScope, own: Collection[str]
    ) -> str:
        if function == "len" and isinstance(arguments[0], Name):
            entry = scope.find(arguments[0].name)
            if entry is not None and not entry.sized and entry.path:
                return f"X.room(n, {string(entry.path)})"
        if function not in _FUNCTIONS:
            raise not_said(node.at, f"the function '{function}'")
        return f"X.{function}({', '.join(self._node(one, scope, own) for one in arguments)})"


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
