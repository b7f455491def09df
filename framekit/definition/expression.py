"""Expressions: their syntax tree, its output as Python source, and the parser from text to tree.

Text is never evaluated. The parser accepts operators, literals and the listed functions; it does not know which names
exist. The writer outputs known nodes only and every literal by `repr`, so no text of a file reaches the source. Both
the codec compiler (names are local variables) and the link engine (names are looked up) use the writer: it alone
defines the operators and functions of the language.
"""

from __future__ import annotations

import re
import struct
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from decimal import Decimal
from fractions import Fraction
from typing import Protocol as Interface

from framekit.definition.numbers import whole_number
from framekit.definition.problems import Position, Problem, did_you_mean, parted
from framekit.definition.times import LINE_UNITS, NEVER, UNITS


@dataclass(frozen=True, slots=True)
class Node:
    """A node of an expression; `at` is the position of its start."""

    at: Position


@dataclass(frozen=True, slots=True)
class Number(Node):
    """A whole number, or a time in nanoseconds if `is_time`."""

    value: int
    is_time: bool = False


@dataclass(frozen=True, slots=True)
class Real(Node):
    """A number with a fraction: a float if `is_float`, else exact."""

    value: Decimal
    is_float: bool


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
    """Yield the direct child nodes of a node, in order."""
    names = _fields.get(node.__class__)
    if names is None:
        names = _fields[node.__class__] = tuple(field.name for field in fields(node) if "Node" in str(field.type))
    for name in names:
        yield from _nodes_in(getattr(node, name))


_fields: dict[type[Node], tuple[str, ...]] = {}
"""For each node class, the names of its fields that hold nodes."""


def _nodes_in(value: object) -> Iterator[Node]:
    if isinstance(value, Node):
        yield value
    elif isinstance(value, tuple):
        for item in value:
            yield from _nodes_in(item)


def walk(node: Node) -> Iterator[Node]:
    """Yield the node and all nodes below it, outermost first."""
    yield node
    for child in children(node):
        yield from walk(child)


def ordered_by_need(given: Mapping[str, Expression]) -> list[str]:
    """Return the names in the order of evaluation, each after the names that its expression reads.

    Names in a circle are left out. An expression that reads its own name means a name of an outer scope.
    """
    ordered: list[str] = []
    while ready := [
        name
        for name, one in given.items()
        if name not in ordered and not (names_in(one.root) & given.keys()) - {name, *ordered}
    ]:
        ordered += ready
    return ordered


def names_in(node: Node) -> set[str]:
    """Return the bare words that an expression reads, without attribute names."""
    return {part.name for part in walk(node) if isinstance(part, Name)}


@dataclass(frozen=True, slots=True)
class KnownFunction:
    """A function of the language: number of arguments, type of the result, and whether it needs an extra."""

    fewest: int
    most: int
    gives: str
    is_extra: bool = False


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
    "empty": KnownFunction(1, 1, "flag"),
    "full": KnownFunction(1, 1, "flag"),
    "memory": KnownFunction(2, 2, "bytes"),
    "value": KnownFunction(2, 2, "number"),
    "with_date": KnownFunction(3, 3, "any"),
    "xor": KnownFunction(2, 2, "bytes"),
    "aes": KnownFunction(2, 3, "bytes", is_extra=True),
    "random": KnownFunction(1, 1, "bytes"),
    "code": KnownFunction(2, 2, "bytes"),
}


ENGINE_FUNCTIONS = frozenset({"empty", "full", "memory", "value", "with_date", "random", "code"})
"""Functions that need a running engine; their result may change at any time."""
COLUMNS = frozenset({"area"})
"""Names with constant values when an expression is inverted: the columns of an area."""


def is_constant(expression: Expression) -> bool:
    """Return whether an expression reads no names and no state, so that it can be evaluated once."""
    return not names_in(expression.root) and not any(
        isinstance(node, LineTime) or (isinstance(node, Call) and node.function in ENGINE_FUNCTIONS)
        for node in walk(expression.root)
    )


def needs_extra(expression: Expression) -> bool:
    """Return whether an expression calls a function of an optional extra."""
    calls = (node for node in walk(expression.root) if isinstance(node, Call))
    return any(FUNCTIONS[call.function].is_extra for call in calls)


Undone = tuple[str, bool, Expression]
"""An operation to undo: its operator, whether the wanted name is in the left operand, and the other operand."""


def inverse_steps(expression: Expression) -> tuple[str, tuple[Undone, ...]] | None:
    """Return the single name that can be computed from the result, with the operations to undo.

    Return None if this is impossible.
    """
    undone: list[Undone] = []
    node = expression.root
    while not isinstance(node, Name):
        if not isinstance(node, Binary) or node.operator not in ("+", "-", "*"):
            return None
        left, right = names_in(node.left) - COLUMNS, names_in(node.right) - COLUMNS
        if bool(left) == bool(right):
            return None
        known, rest = (node.right, node.left) if left else (node.left, node.right)
        undone.append((node.operator, bool(left), Expression(expression.text, known)))
        node = rest
    return None if node.name in COLUMNS else (node.name, tuple(undone))


def tells_setting(value: Expression, parameters: Collection[str]) -> bool:
    """Return whether the value of one of these parameters can be computed from a field with this value."""
    steps = inverse_steps(value)
    return steps is not None and steps[0] in parameters


def both(first: Expression, second: Expression | None) -> Expression:
    """Return `first and second`."""
    if second is None:
        return first
    return Expression(f"({first}) and ({second})", Logic(first.at, "and", (first.root, second.root)))


# ---- the tree as Python source ------------------------------------------------------------------------------


CONDITIONAL, OR, AND, NOT, COMPARE, BIT_OR, BIT_XOR, BIT_AND, SHIFT, SUM, PRODUCT, SIGN, ATOM = range(13)
_BINARY = ({"|"}, {"^"}, {"&"}, {"<<", ">>"}, {"+", "-"}, {"*", "//", "%"})
"""Binary operators by precedence, lowest first."""
_BINARY_OF_PLACES = (*_BINARY[:-1], {*_BINARY[-1], "/"})
_LEVELS = {op: level for level, operators in enumerate(_BINARY_OF_PLACES, start=BIT_OR) for op in operators}
_METHODS = {"lower": "lower", "upper": "upper"}
_SAME_IN_PYTHON = {"len", "min", "max", "abs", "sum"}
WIDEST_SHIFT = 256
"""Maximum shift width, so that a received number cannot ask for a gigabyte of bits."""


MOST_TIMES = 4096
"""Numbers up to this limit multiply directly; all other products go through `times`, which accepts numbers only."""


class NameWriter(Interface):
    """The parts of the output that its user decides: names, attributes, line times and the other functions."""

    def name(self, node: Name) -> str:
        """Return the source of a bare word as an atom."""

    def attribute(self, node: Attribute) -> str:
        """Return the source of `x.name` as an atom."""

    def line_time(self, node: LineTime) -> str:
        """Return the source of a time in characters or bits as an atom."""

    def call(self, function: str, arguments: list[str]) -> str:
        """Return the source of a call of a function that this module does not write itself, as an atom."""


def emit(node: Node, names: NameWriter, level: int = CONDITIONAL) -> str:
    """Return the Python source of `node`, in parentheses if its precedence is lower than `level`."""
    text, own = _Emitter(names).node(node)
    return f"({text})" if own < level else text


def may_find_nothing(node: Node) -> bool:
    """Return whether a node looks up an item by `find` or `find_last`, which may find no item."""
    return isinstance(node, Index) and isinstance(node.index, Call) and node.index.function in ("find", "find_last")


class _Emitter:
    def __init__(self, names: NameWriter) -> None:
        self.names = names

    def at_least(self, node: Node, level: int) -> str:
        return emit(node, self.names, level)

    def node(self, node: Node) -> tuple[str, int]:
        match node:
            case Number(value=value):
                return (str(value), ATOM) if value >= 0 else (str(value), SIGN)
            case Real(value=value, is_float=is_float):
                if is_float:
                    return f"({float(value)!r})", ATOM
                number, places = whole_and_places(value)
                return self.names.call("scaled", [str(number), "1", "0", str(places)]), ATOM
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
            case Index(value=value, index=index) if may_find_nothing(node):
                parts = [self.at_least(value, CONDITIONAL), self.at_least(index, CONDITIONAL)]
                return self.names.call("item_at", parts), ATOM
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
        level = _LEVELS[operator]
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
    """Return the source of the object of a method call, in parentheses if it is not a plain name."""
    return text if text.isidentifier() else f"({text})"


# ---- parser --------------------------------------------------------------------------------------------------


_TOKEN = re.compile(
    r"""\s*(?:
      (?P<bytes>h'[^']*')
    | (?P<text>'(?:[^'\\]|\\.)*')
    | (?P<time>(?:\d+(?:\.\d+)?)\s*(?:ns|us|ms|s|min|h|d|chars?|bits?)\b)
    | (?P<real>\d+\.\d+)
    | (?P<number>0[xX][0-9a-fA-F]+|\d+)
    | (?P<word>[A-Za-z_][A-Za-z0-9_]*)
    | (?P<sign><<|>>|==|!=|<=|>=|//|[-+*/%&|^~<>()\[\],.:])
    )""",
    re.VERBOSE,
)

_LONGEST = 100
"""Maximum length of an expression in messages."""

Token = tuple[str, str, Position]
"""Kind (a group of the pattern), text and position."""


class ExpressionError(ValueError):
    """Raised for an expression that does not parse; `problem` has the place and the reason."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        super().__init__(str(problem))


def expression_error(text: str, what: str, at: Position, todo: str = "") -> ExpressionError:
    """Return the error for a problem at `at` in the expression `text`."""
    shown = text if len(text) <= _LONGEST else f"{text[: _LONGEST - 1]}…"
    return ExpressionError(Problem(at, f'in the expression "{shown}": {what}', todo))


def place_of(at: Position, offset: int) -> Position:
    """Return the position of the character at `offset` in an expression that begins at `at`."""
    return Position(at.file, at.line, at.column + offset)


def tokens_of(text: str, at: Position, *, of_places: bool = False) -> list[Token]:
    """Return the tokens of an expression that begins at `at`; only an expression of places has fractions and `/`.

    Raise ExpressionError.
    """
    found: list[Token] = []
    offset, end = 0, len(text.rstrip())
    while offset < end:
        match = _TOKEN.match(text, offset)
        if match is None:
            start = offset + len(text[offset:]) - len(text[offset:].lstrip())
            raise expression_error(text, _strange(text[start]), place_of(at, start))
        kind = match.lastgroup or ""
        place = place_of(at, match.start(kind))
        if not of_places and kind == "real":
            raise expression_error(text, "numbers are whole", place, "write 3, or a time with its unit, such as 3.5 s")
        if not of_places and match[kind] == "/":
            raise expression_error(text, "'/' is no operator, numbers are whole: use '//'", place)
        found.append((kind, match[kind], place))
        offset = match.end()
    return found


def _strange(sign: str) -> str:
    """Return the problem of a character that begins no token."""
    if sign == "'":
        return "a text has no closing quote"
    if sign == "=":
        return "'=' is no operator, comparison is '=='"
    if sign == "!":
        return "'!' is no operator, write 'not'"
    if sign == "?":
        return "'?' is no operator, write 'a if condition else b'"
    if sign in '"“”„‘’`':
        return "text stands in single quotes: '…'"
    return f"'{sign}' does not belong in an expression"


def time_of(word: str, at: Position) -> Node:
    """Return the number of nanoseconds, or the line time, of a word such as `50 ms` or `2 chars`."""
    match = re.fullmatch(r"([\d.]+)\s*(\w+)", word)
    assert match is not None
    whole, _, places = match[1].partition(".")
    count, unit = Fraction(whole_number(whole + places), 10 ** len(places)), match[2]
    if unit.rstrip("s") + "s" in LINE_UNITS and unit not in UNITS:
        return LineTime(at, (count.numerator, count.denominator), unit.rstrip("s") + "s")
    return Number(at, int(count * UNITS[unit]), is_time=True)


_FRACTION = re.compile(r"-?[0-9]{1,20}\.[0-9]{1,20}")


def real_number(text: str, at: Position, float_bits: int = 0) -> Expression | None:
    """Return the constant for a text such as `-0.5`; None for all other texts. In expressions, numbers are whole.

    `float_bits`: round the constant to a float with this number of bits; 0: keep it exact.
    """
    if not _FRACTION.fullmatch(text.strip()):
        return None
    value = Decimal(text.strip())
    if float_bits == 32:
        value = Decimal(struct.unpack("<f", struct.pack("<f", value))[0])
    return Expression(text.strip(), Real(at, value, bool(float_bits)))


def whole_and_places(value: Decimal) -> tuple[int, int]:
    """Return a finite decimal as a whole number and its decimal places: -0.25 → (-25, 2).

    Unlike decimal arithmetic, this never rounds, whatever the number of digits.
    """
    sign, digits, exponent = value.as_tuple()
    number = int("".join(map(str, digits))) * 10 ** max(0, int(exponent))
    return -number if sign else number, max(0, -int(exponent))


_COMPARE = {"==", "!=", "<", "<=", ">", ">=", "in", "not in"}
_RESERVED = {"if", "else", "or", "and", "not", "in"}
_DEPTH = 48
_DEEPEST = 100


def parse_expression(text: str, at: Position, *, of_places: bool = False) -> Expression:
    """Return the tree of `text`, which begins at `at` in its file. Raise ExpressionError.

    `of_places`: the expression reads numbers at places of a memory. Texts in quotes are names, since an address need
    not be a word; numbers may have fractions, and `/` divides exactly. Numbers of frames are whole.
    """
    return Expression(text, _Parser(text, at, of_places).whole())


class OperatorGrammar(ABC):
    """The common grammar of expression languages: operators by precedence, and lists of expressions.

    A subclass defines its operators, the whole expression (`_conditional`) and the operand after its signs
    (`_postfix`).
    """

    binary: Sequence[Collection[str]]
    """Binary operators by precedence, lowest first."""
    signs: Collection[str]
    """Signs allowed before an operand; `+` has no effect."""

    @abstractmethod
    def _here(self) -> Position:
        """Return the position of the next token."""

    @abstractmethod
    def _accept(self, *words: str) -> str | None:
        """Consume and return the next token if it is one of these words, else return None."""

    @abstractmethod
    def _expect(self, word: str) -> None:
        """Consume the next token; raise the error of the language if it is not this word."""

    @abstractmethod
    def _conditional(self) -> Node:
        """Parse a whole expression."""

    @abstractmethod
    def _comparison(self) -> Node: ...

    @abstractmethod
    def _postfix(self) -> Node:
        """Parse an operand with its attributes and subscripts."""

    def _logic(self, operator: str) -> Node:
        def operand() -> Node:
            return self._logic("and") if operator == "or" else self._negation()

        first = operand()
        operands = [first]
        while self._accept(operator):
            operands.append(operand())
        return first if len(operands) == 1 else Logic(first.at, operator, tuple(operands))

    def _negation(self) -> Node:
        at = self._here()
        negations = 0
        while self._accept("not"):
            negations += 1
        node = self._comparison()
        for _ in range(negations):
            node = Unary(at, "not", node)
        return node

    def _binary(self, level: int) -> Node:
        if level == len(self.binary):
            return self._unary()
        node = self._binary(level + 1)
        while (operator := self._accept(*self.binary[level])) is not None:
            node = Binary(node.at, operator, node, self._binary(level + 1))
        return node

    def _unary(self) -> Node:
        at = self._here()
        signs = []
        while (sign := self._accept(*self.signs)) is not None:
            signs.append(sign)
        node = self._postfix()
        for sign in reversed(signs):
            node = node if sign == "+" else Unary(at, sign, node)
        return node

    def _items(self, end: str) -> tuple[Node, ...]:
        items: list[Node] = []
        if self._accept(end):
            return ()
        while True:
            items.append(self._conditional())
            if self._accept(end):
                return tuple(items)
            self._expect(",")


class _Parser(OperatorGrammar):
    signs = ("-", "~")

    def __init__(self, text: str, at: Position, of_places: bool) -> None:
        self.text, self.at, self.of_places = text, at, of_places
        self.binary = _BINARY_OF_PLACES if of_places else _BINARY
        self.tokens = tokens_of(text, at, of_places=of_places)
        self.place = 0
        self.depth = 0

    def _error(self, what: str, at: Position, todo: str = "") -> ExpressionError:
        return expression_error(self.text, what, at, todo)

    def _peek(self) -> str:
        if self.place >= len(self.tokens):
            return ""
        kind, word, _ = self.tokens[self.place]
        return word if kind in ("sign", "word") else kind

    def _here(self) -> Position:
        if self.place < len(self.tokens):
            return self.tokens[self.place][2]
        return place_of(self.at, len(self.text))

    def _accept(self, *words: str) -> str | None:
        if self.place < len(self.tokens) and self._peek() in words and self.tokens[self.place][0] in ("sign", "word"):
            self.place += 1
            return self.tokens[self.place - 1][1]
        return None

    def _expect(self, word: str) -> None:
        if self._accept(word) is None:
            found = self._peek()
            raise self._error(f"'{word}' is missing" + (f" before '{found}'" if found else " at the end"), self._here())

    # ---- grammar ------------------------------------------------------------------------------------------

    def whole(self) -> Node:
        if not self.tokens:
            raise self._error("it is empty", self.at, "write an expression, or leave the key out")
        node = self._conditional()
        if self.place < len(self.tokens):
            found = self.tokens[self.place][1]
            raise self._error(f"'{found}' was not expected here", self._here(), self._unit_hint(node))
        self._bounded(node)
        return node

    def _bounded(self, root: Node) -> None:
        """Raise if operators are nested too deeply to be evaluated, or if a value could become arbitrarily large."""
        found = [(root, 1)]
        while found:
            node, depth = found.pop()
            if depth > _DEEPEST:
                raise self._error("it has too many operators in a row", node.at, "split it into several values")
            match node:
                case (
                    Binary(operator="*", left=Text() | Bytes() | List())
                    | Binary(operator="*", right=Text() | Bytes() | List())
                ):
                    raise self._error("'*' multiplies numbers", node.at, "write out what comes several times")
                case Binary(operator="<<", right=Number(value=bits)) if bits > WIDEST_SHIFT:
                    what = f"{bits} bits are too many, {WIDEST_SHIFT} are possible"
                    raise self._error(what, node.right.at, "shift by fewer")
            found += [(part, depth + 1) for part in children(node)]

    def _unit_hint(self, node: Node) -> str:
        """Return the remedy for unknown units, such as `3 sec` and `50 msec`."""
        kind, word, _ = self.tokens[self.place]
        if not isinstance(node, Number) or kind != "word":
            return ""
        return did_you_mean(word, [*UNITS, *LINE_UNITS]) or "units of time: " + ", ".join([*UNITS, *LINE_UNITS])

    def _conditional(self) -> Node:
        self.depth += 1
        if self.depth > _DEPTH:
            raise self._error("it is nested too deeply", self._here(), "split it into several values")
        node = self._logic("or")
        if self._accept("if"):
            condition = self._logic("or")
            self._expect("else")
            node = Conditional(node.at, condition, node, self._conditional())
        self.depth -= 1
        return node

    def _comparison(self) -> Node:
        first = self._binary(0)
        rest: list[tuple[str, Node]] = []
        while (operator := self._comparison_operator()) is not None:
            rest.append((operator, self._binary(0)))
        return Compare(first.at, first, tuple(rest)) if rest else first

    def _comparison_operator(self) -> str | None:
        word = self._peek()
        if word == "not" and self.place + 1 < len(self.tokens) and self.tokens[self.place + 1][1] == "in":
            self.place += 2
            return "not in"
        return self._accept(word) if word in _COMPARE else None

    def _postfix(self) -> Node:
        node = self._atom()
        while True:
            if self._accept("."):
                node = Attribute(node.at, node, self._word("a name must follow the dot"))
            elif self._accept("["):
                node = self._subscript(node)
            else:
                return node

    def _subscript(self, value: Node) -> Node:
        start = None if self._peek() == ":" else self._conditional()
        if self._accept(":"):
            stop = None if self._peek() == "]" else self._conditional()
            self._expect("]")
            return Slice(value.at, value, start, stop)
        self._expect("]")
        assert start is not None
        return Index(value.at, value, start)

    def _word(self, complaint: str) -> str:
        if self.place < len(self.tokens) and self.tokens[self.place][0] == "word":
            self.place += 1
            return self.tokens[self.place - 1][1]
        raise self._error(complaint, self._here())

    def _atom(self) -> Node:
        if self.place >= len(self.tokens):
            raise self._error("it ends too early", self._here(), "quote the whole expression if it has a comma")
        kind, word, at = self.tokens[self.place]
        self.place += 1
        if kind == "number":
            return self._numeral(lambda: Number(at, whole_number(word, 16 if word[:2] in ("0x", "0X") else 10)), at)
        if kind == "real":
            return Real(at, Decimal(word), is_float=True)
        if kind == "time":
            return self._numeral(lambda: time_of(word, at), at)
        if kind == "text":
            value = re.sub(r"\\(.)", r"\1", word[1:-1])
            return Name(at, value) if self.of_places else Text(at, value)
        if kind == "bytes":
            return self._bytes(word, at)
        if word == "(":
            node = self._conditional()
            self._expect(")")
            return node
        if word == "[":
            return List(at, self._items("]"))
        if kind == "word" and word not in _RESERVED:
            return self._name(word, at)
        doubled = self.place > 1 and self.tokens[self.place - 2][1] == word
        todo = {"&": "write 'and'", "|": "write 'or'"}.get(word, "") if doubled else ""
        raise self._error(f"'{word}' was not expected here", at, todo)

    def _numeral(self, read: Callable[[], Node], at: Position) -> Node:
        """Return the number or time of a token. Raises ExpressionError if it has too many digits."""
        try:
            return read()
        except ValueError as error:
            what, todo = parted(error)
            raise self._error(what, at, todo) from None

    def _name(self, word: str, at: Position) -> Node:
        if self._accept("("):
            return self._call(word, at)
        if word in ("true", "false"):
            return Number(at, int(word == "true"))
        return Number(at, NEVER, is_time=True) if word == "never" else Name(at, word)

    def _call(self, word: str, at: Position) -> Node:
        function = FUNCTIONS.get(word)
        if function is None:
            raise self._error(f"there is no function '{word}'", at, did_you_mean(word, FUNCTIONS))
        arguments = self._items(")")
        if not function.fewest <= len(arguments) <= function.most:
            wanted = (
                str(function.fewest) if function.fewest == function.most else f"{function.fewest} to {function.most}"
            )
            raise self._error(f"'{word}' takes {wanted} arguments, not {len(arguments)}", at)
        return Call(at, word, arguments)

    def _bytes(self, word: str, at: Position) -> Node:
        try:
            return Bytes(at, bytes.fromhex(word[2:-1]))
        except ValueError:
            raise self._error(f"{word} is not bytes", at, "write pairs of hex digits, such as h'10 3A'") from None
