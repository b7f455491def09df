"""An expression's tree as Python source: the one place where the language's operators and functions get their meaning.

Both users stand on it: the codec compiler (names are local variables) and the link engine (names are looked up).
Only whitelisted nodes are written, and every literal by `repr`, so nothing of a file's text gets into the source.
"""

from __future__ import annotations

from typing import Protocol

from framekit.definition.expression.syntax import (
    Attribute,
    Binary,
    Bytes,
    Call,
    Compare,
    Conditional,
    Index,
    LineTime,
    List,
    Logic,
    Name,
    Node,
    Number,
    Slice,
    Text,
    Unary,
)
from framekit.definition.times import NEVER

CONDITIONAL, OR, AND, NOT, COMPARE, BIT_OR, BIT_XOR, BIT_AND, SHIFT, SUM, PRODUCT, SIGN, ATOM = range(13)
_BINARY = {
    "|": BIT_OR,
    "^": BIT_XOR,
    "&": BIT_AND,
    "<<": SHIFT,
    ">>": SHIFT,
    "+": SUM,
    "-": SUM,
    "*": PRODUCT,
    "//": PRODUCT,
    "%": PRODUCT,
}
_METHODS = {"lower": "lower", "upper": "upper"}
_SAME_IN_PYTHON = {"len", "min", "max", "abs", "sum"}
WIDEST_SHIFT = 256
"""Shifts are cut here, so that a number from the wire can't ask for a gigabyte of bits."""


MOST_TIMES = 4096
"""Numbers up to this multiply what stands beside them at once; all others only numbers."""


class NameWriter(Protocol):
    """What a user of the emitter decides: how names, attributes, line times and the other functions are written."""

    def name(self, node: Name) -> str:
        """Source of a bare word; an atom."""

    def attribute(self, node: Attribute) -> str:
        """Source of `x.name`; an atom."""

    def line_time(self, node: LineTime) -> str:
        """Source of a time in characters or bits; an atom."""

    def call(self, function: str, arguments: list[str]) -> str:
        """Source of a call of one of the functions this module does not write itself; an atom."""


def emit(node: Node, names: NameWriter, level: int = CONDITIONAL) -> str:
    """Python source of `node`, in parentheses if it binds weaker than `level`."""
    text, own = _Emitter(names).node(node)
    return f"({text})" if own < level else text


class _Emitter:
    def __init__(self, names: NameWriter) -> None:
        self.names = names

    def at_least(self, node: Node, level: int) -> str:
        return emit(node, self.names, level)

    def node(self, node: Node) -> tuple[str, int]:
        match node:
            case Number(value=value):
                return (str(value), ATOM) if value >= 0 else (str(value), SIGN)
            case Text(value=value):
                return repr(value), ATOM
            case Bytes(value=data):
                return repr(data), ATOM
            case Name():
                return self.names.name(node), ATOM
            case LineTime():
                return self.names.line_time(node), ATOM
            case Attribute():
                return self.names.attribute(node), ATOM
            case Index(value=value, index=index):
                return f"{self.at_least(value, ATOM)}[{self.at_least(index, CONDITIONAL)}]", ATOM
            case Slice():
                return self._slice(node), ATOM
            case Call(function=function, arguments=arguments):
                return self._call(function, [self.at_least(part, CONDITIONAL) for part in arguments])
            case List(items=items):
                return f"[{', '.join(self.at_least(item, CONDITIONAL) for item in items)}]", ATOM
            case _:
                return self._operator(node)

    def _operator(self, node: Node) -> tuple[str, int]:
        match node:
            case Unary(operator="not", operand=operand):
                return f"not {self.at_least(operand, NOT)}", NOT
            case Unary(operator=operator, operand=operand):
                return f"{operator}{self.at_least(operand, SIGN)}", SIGN
            case Binary(operator=operator, left=left, right=right):
                return self._binary(operator, left, right)
            case Compare(first=first, rest=rest):
                parts = [self.at_least(first, BIT_OR)]
                parts += [f"{operator} {self.at_least(operand, BIT_OR)}" for operator, operand in rest]
                return " ".join(parts), COMPARE
            case Logic(operator=operator, operands=operands):
                level = OR if operator == "or" else AND
                return f" {operator} ".join(self.at_least(part, level + 1) for part in operands), level
            case Conditional(condition=condition, then=then, otherwise=otherwise):
                choice = f"{self.at_least(then, OR)} if {self.at_least(condition, OR)}"
                return f"{choice} else {self.at_least(otherwise, CONDITIONAL)}", CONDITIONAL
        raise TypeError(f"no expression node: {node!r}")

    def _binary(self, operator: str, left: Node, right: Node) -> tuple[str, int]:
        level = _BINARY[operator]
        second = self.at_least(right, level + 1)
        if operator in ("<<", ">>") and not isinstance(right, Number):
            second = f"min({self.at_least(right, CONDITIONAL)}, {WIDEST_SHIFT})"
        numbers = [part.value for part in (left, right) if isinstance(part, Number)]
        if operator == "*" and (not numbers or (len(numbers) == 1 and numbers[0] > MOST_TIMES)):
            return self.names.call("times", [self.at_least(left, CONDITIONAL), self.at_least(right, CONDITIONAL)]), ATOM
        return f"{self.at_least(left, level)} {operator} {second}", level

    def _slice(self, node: Slice) -> str:
        start = self.at_least(node.start, CONDITIONAL) if node.start else ""
        stop = self.at_least(node.stop, CONDITIONAL) if node.stop else ""
        return f"{self.at_least(node.value, ATOM)}[{start}:{stop}]"

    def _call(self, function: str, arguments: list[str]) -> tuple[str, int]:
        if function in _SAME_IN_PYTHON:
            return f"{function}({', '.join(arguments)})", ATOM
        if function in _METHODS:
            return f"{_owner(arguments[0])}.{_METHODS[function]}()", ATOM
        if function == "none":
            return "None", ATOM
        if function == "text":
            return f"str({arguments[0]})", ATOM
        if function == "get":
            return f"{_owner(arguments[0])}.get({arguments[1]}, {arguments[2]})", ATOM
        if function == "ms":
            return f"(({arguments[0]}) * 1000000)", ATOM
        if function == "limit":
            return f"(({arguments[0]}) or {NEVER})", ATOM
        return self.names.call(function, arguments), ATOM


def _owner(text: str) -> str:
    """Source of what a method is called of: in parentheses if it is more than a name."""
    return text if text.isidentifier() else f"({text})"
