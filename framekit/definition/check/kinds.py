"""Kinds of expressions: whether a number, a time, a text or bytes comes out, and whether operators get what they take.

Only what is certain is judged: a name of unknown or mixed kind is `any`, and `any` fits everywhere. Which names there
are is decided elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Literal

from framekit.definition.expression.syntax import (
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
    Slice,
    Text,
    Unary,
)
from framekit.definition.problems import Position, Problem

Kind = Literal["number", "time", "text", "bytes", "list", "frame", "table", "any"]
Attributes = Callable[[Attribute], Kind]

WORDS: dict[str, str] = {
    "number": "a number",
    "time": "a time",
    "text": "a text",
    "bytes": "bytes",
    "list": "a list",
    "frame": "a frame",
    "table": "a table",
}
_FUNCTION_KINDS: dict[str, Kind] = {
    "number": "number", "flag": "number", "text": "text", "bytes": "bytes", "time": "time",
}  # fmt: skip
_TAKES: dict[str, tuple[tuple[Kind, ...], ...]] = {
    "len": (("text", "bytes", "list", "table"),),
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
    "only": (("text",), ("text",)),
}
"""What functions take, as far as it is checked."""

_SEQUENCES: frozenset[Kind] = frozenset({"text", "bytes", "list"})


def never_an_attribute(node: Attribute) -> Kind:
    """What `x.name` is when nothing is known about it."""
    return "number" if isinstance(node.value, Name) and node.value.name == "line" else "any"


class KindChecker:
    """Works out kinds, with the kinds of names given by `names`, and collects what does not fit."""

    def __init__(self, names: Mapping[str, Kind], attributes: Attributes = never_an_attribute) -> None:
        self.names = names
        self.attributes = attributes
        self.problems: list[Problem] = []
        self.expression: Expression | None = None
        self.named_numbers: frozenset[str] = frozenset()

    def wants(self, expression: Expression | None, wanted: Kind) -> None:
        """Notes what is wrong inside, and a result that is not `wanted`. A 0 is a time too."""
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
        elif wanted in ("text", "bytes") and found in ("text", "bytes"):
            todo = "write bytes as h'…' and text in quotes"
        else:
            todo = ""
        self._note(expression.at, what, todo)

    def kind(self, expression: Expression) -> Kind:
        """The kind of an expression; problems inside it are noted."""
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
            case LineTime():
                return "time"
            case Text():
                return "text"
            case Bytes():
                return "bytes"
            case Name(name=name):
                return self.names.get(name, "any")
            case Attribute(value=value):
                self._kind(value)
                return self.attributes(node)
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
        if kind in ("number", "time"):
            self._inside(value.at, f"{WORDS[kind]} has no parts to take with [ ]")
        if kind in _SEQUENCES and place not in ("number", "any"):
            self._inside(index.at, f"a place in {WORDS[kind]} is a number, this is {WORDS[place]}")
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
        gives = FUNCTIONS[node.function].gives
        if gives == "same":
            return _common(kinds) if len(kinds) > 1 else "any"
        return _FUNCTION_KINDS.get(gives, "any")

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
        elif isinstance(holder, List):
            for one in holder.items:
                kind = self._kind(one)
                if "any" not in (kind, left) and kind != left and not _zero_time(item, one, left, kind):
                    self._incomparable(one, left, kind)

    def _incomparable(self, operand: Node, left: Kind, right: Kind) -> None:
        what = f"{WORDS[left]} cannot be compared with {WORDS[right]}"
        self._inside(operand.at, what, _how_to_compare(operand, left, right))


def _combined(operator: str, left: Kind, right: Kind) -> Kind | None:
    """What an operator gives; None when it does not take these."""
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
    """Whether a time is compared with a plain 0."""
    return {left, right} == {"number", "time"} and (_is_zero(first) or _is_zero(second))


def _how_to_join(left: Kind, right: Kind, operator: str) -> str:
    if {left, right} == {"number", "time"}:
        return "give the number a unit, such as 50 ms"
    if {left, right} == {"number", "text"} and operator == "*":
        return "make a number of the text with number(…), or write the text as often as it stands there"
    if {left, right} == {"number", "text"}:
        return "make a text of the number with text(…), or a number of the text with number(…)"
    return ""


def _how_to_compare(operand: Node, left: Kind, right: Kind) -> str:
    if {left, right} == {"number", "time"}:
        return "give the number a unit, such as 50 ms"
    if {left, right} == {"number", "text"} and isinstance(operand, Number):
        return "put the number in quotes"
    if {left, right} == {"number", "text"}:
        return "leave the quotes out, or give the field values: with names"
    if {left, right} == {"bytes", "text"}:
        return "write bytes as h'…'"
    return ""
