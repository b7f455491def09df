"""The tree of an expression: what the parser makes and the emitter and the checker read.

Nodes are frozen values with the place where they stand. Nothing here evaluates anything.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields

from framekit.definition.problems import Position


@dataclass(frozen=True, slots=True)
class Node:
    """A part of an expression; `at` is where it begins."""

    at: Position


@dataclass(frozen=True, slots=True)
class Number(Node):
    """A whole number, or a time in nanoseconds when `is_time`."""

    value: int
    is_time: bool = False


@dataclass(frozen=True, slots=True)
class LineTime(Node):
    """A time in characters or bits of the line: `80 chars`, `3.5 chars`; `count` is (numerator, denominator)."""

    count: tuple[int, int]
    unit: str


@dataclass(frozen=True, slots=True)
class Text(Node):
    """Text in single quotes."""

    value: str


@dataclass(frozen=True, slots=True)
class Bytes(Node):
    """`h'10 3A'`."""

    value: bytes


@dataclass(frozen=True, slots=True)
class Name(Node):
    """A bare word."""

    name: str


@dataclass(frozen=True, slots=True)
class Attribute(Node):
    """`x.name`."""

    value: Node
    name: str


@dataclass(frozen=True, slots=True)
class Index(Node):
    """`x[i]`."""

    value: Node
    index: Node


@dataclass(frozen=True, slots=True)
class Slice(Node):
    """`x[a:b]`; either end may be missing."""

    value: Node
    start: Node | None
    stop: Node | None


@dataclass(frozen=True, slots=True)
class Call(Node):
    """`f(x, …)` with one of the language's functions."""

    function: str
    arguments: tuple[Node, ...]


@dataclass(frozen=True, slots=True)
class Unary(Node):
    """`- ~ not`."""

    operator: str
    operand: Node


@dataclass(frozen=True, slots=True)
class Binary(Node):
    """Arithmetic and bit operators."""

    operator: str
    left: Node
    right: Node


@dataclass(frozen=True, slots=True)
class Compare(Node):
    """`a < b <= c`, `x in y`: the first operand, then (operator, operand) pairs."""

    first: Node
    rest: tuple[tuple[str, Node], ...]


@dataclass(frozen=True, slots=True)
class Logic(Node):
    """`and` or `or` over two or more operands."""

    operator: str
    operands: tuple[Node, ...]


@dataclass(frozen=True, slots=True)
class Conditional(Node):
    """`a if c else b`."""

    condition: Node
    then: Node
    otherwise: Node


@dataclass(frozen=True, slots=True)
class List(Node):
    """`[a, b]`."""

    items: tuple[Node, ...]


@dataclass(frozen=True, slots=True)
class Expression:
    """A whole expression with its text as written."""

    text: str
    root: Node

    @property
    def at(self) -> Position:
        return self.root.at

    def __str__(self) -> str:
        return self.text


def children(node: Node) -> Iterator[Node]:
    """The direct parts of a node, in order."""
    names = _fields.get(node.__class__)
    if names is None:
        names = _fields[node.__class__] = tuple(field.name for field in fields(node))
    for name in names:
        yield from _nodes_in(getattr(node, name))


_fields: dict[type[Node], tuple[str, ...]] = {}
"""The names of the fields of each class of nodes."""


def _nodes_in(value: object) -> Iterator[Node]:
    if isinstance(value, Node):
        yield value
    elif isinstance(value, tuple):
        for item in value:
            yield from _nodes_in(item)


def walk(node: Node) -> Iterator[Node]:
    """The node and everything below it, outermost first."""
    yield node
    for child in children(node):
        yield from walk(child)


def names_in(node: Node) -> set[str]:
    """The bare words an expression reads (not the names behind a dot)."""
    return {part.name for part in walk(node) if isinstance(part, Name)}


@dataclass(frozen=True, slots=True)
class KnownFunction:
    """A function of the language: how many arguments it takes and what kind of value it gives."""

    fewest: int
    most: int
    gives: str
    needs_engine: bool = False


FUNCTIONS: dict[str, KnownFunction] = {
    "len": KnownFunction(1, 1, "number"),
    "min": KnownFunction(1, 8, "same"),
    "max": KnownFunction(1, 8, "same"),
    "abs": KnownFunction(1, 1, "number"),
    "sum": KnownFunction(1, 1, "number"),
    "lower": KnownFunction(1, 1, "text"),
    "upper": KnownFunction(1, 1, "text"),
    "text": KnownFunction(1, 1, "text"),
    "number": KnownFunction(1, 2, "number"),
    "digits": KnownFunction(2, 3, "text"),
    "bit": KnownFunction(2, 2, "number"),
    "rotl8": KnownFunction(2, 2, "number"),
    "same": KnownFunction(1, 1, "flag"),
    "get": KnownFunction(3, 3, "any"),
    "find": KnownFunction(2, 2, "any"),
    "find_last": KnownFunction(2, 2, "any"),
    "free": KnownFunction(1, 1, "number"),
    "either": KnownFunction(2, 2, "any"),
    "none": KnownFunction(0, 0, "any"),
    "only": KnownFunction(2, 2, "flag"),
    "span": KnownFunction(2, 2, "number"),
    "ms": KnownFunction(1, 1, "time"),
    "limit": KnownFunction(1, 1, "time"),
    "empty": KnownFunction(1, 1, "flag", needs_engine=True),
    "full": KnownFunction(1, 1, "flag", needs_engine=True),
    "memory": KnownFunction(2, 2, "bytes", needs_engine=True),
    "with_date": KnownFunction(3, 3, "any", needs_engine=True),
}


def both(first: Expression, second: Expression | None) -> Expression:
    """`first and second`."""
    if second is None:
        return first
    return Expression(f"({first}) and ({second})", Logic(first.at, "and", (first.root, second.root)))
