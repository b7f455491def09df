"""Text of an expression to its tree: a small precedence-climbing parser over a whitelisted grammar.

It knows operators, literals and the list of functions; it does not know which names exist. Nothing is ever
evaluated from text.
"""

from __future__ import annotations

import re
from fractions import Fraction

from framekit.definition.expression.emit import WIDEST_SHIFT
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
    children,
)
from framekit.definition.problems import Position, Problem, did_you_mean
from framekit.definition.times import LINE_UNITS, NEVER, UNITS

_TOKEN = re.compile(
    r"""\s*(?:
      (?P<bytes>h'[^']*')
    | (?P<text>'(?:[^'\\]|\\.)*')
    | (?P<time>(?:\d+(?:\.\d+)?)\s*(?:ns|us|ms|s|min|h|d|chars?|bits?)\b)
    | (?P<number>0[xX][0-9a-fA-F]+|\d+)
    | (?P<word>[A-Za-z_][A-Za-z0-9_]*)
    | (?P<sign><<|>>|==|!=|<=|>=|//|[-+*%&|^~<>()\[\],.:])
    )""",
    re.VERBOSE,
)

_LONGEST = 100
"""So much of an expression is shown."""

Token = tuple[str, str, Position]
"""Kind (a group of the pattern), text and place."""


class ExpressionError(ValueError):
    """An expression that does not parse; `problem` says where and why."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        super().__init__(str(problem))


def expression_error(text: str, what: str, at: Position, todo: str = "") -> ExpressionError:
    """What is wrong in the expression `text`, at `at`."""
    shown = text if len(text) <= _LONGEST else f"{text[: _LONGEST - 1]}…"
    return ExpressionError(Problem(at, f'in the expression "{shown}": {what}', todo))


def place_of(at: Position, offset: int) -> Position:
    """The place of a character of an expression that begins at `at`."""
    return Position(at.file, at.line, at.column + offset)


def tokens_of(text: str, at: Position) -> list[Token]:
    """The tokens of an expression that begins at `at`. Raises ExpressionError."""
    found: list[Token] = []
    offset = 0
    while offset < len(text.rstrip()):
        match = _TOKEN.match(text, offset)
        if match is None:
            start = offset + len(text[offset:]) - len(text[offset:].lstrip())
            raise expression_error(text, _strange(text[start]), place_of(at, start))
        kind = match.lastgroup or ""
        found.append((kind, match[kind], place_of(at, match.start(kind))))
        offset = match.end()
    return found


def _strange(sign: str) -> str:
    """What is wrong with a sign that begins no token."""
    if sign == "'":
        return "a text has no closing quote"
    if sign == "=":
        return "'=' is no operator, comparison is '=='"
    if sign == "/":
        return "'/' is no operator, numbers are whole: use '//'"
    if sign == "!":
        return "'!' is no operator, write 'not'"
    if sign == "?":
        return "'?' is no operator, write 'a if condition else b'"
    if sign in '"“”„‘’`':
        return "text stands in single quotes: '…'"
    return f"'{sign}' does not belong in an expression"


def time_of(word: str, at: Position) -> Node:
    """The number, or the time on the line, that a word such as `50 ms` or `2 chars` means."""
    match = re.fullmatch(r"([\d.]+)\s*(\w+)", word)
    assert match is not None
    count, unit = Fraction(match[1]), match[2]
    if unit.rstrip("s") + "s" in LINE_UNITS and unit not in UNITS:
        return LineTime(at, (count.numerator, count.denominator), unit.rstrip("s") + "s")
    return Number(at, int(count * UNITS[unit]), is_time=True)


_BINARY = ({"|"}, {"^"}, {"&"}, {"<<", ">>"}, {"+", "-"}, {"*", "//", "%"})
_COMPARE = {"==", "!=", "<", "<=", ">", ">=", "in", "not in"}
_RESERVED = {"if", "else", "or", "and", "not", "in"}
_DEPTH = 48
_DEEPEST = 100


def parse_expression(text: str, at: Position) -> Expression:
    """The tree of `text`, which stands at `at` in its file. Raises ExpressionError."""
    return Expression(text, _Parser(text, at).whole())


class _Parser:
    def __init__(self, text: str, at: Position) -> None:
        self.text, self.at = text, at
        self.tokens = tokens_of(text, at)
        self.place = 0
        self.depth = 0

    def _position(self, offset: int) -> Position:
        return place_of(self.at, offset)

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
        return self._position(len(self.text))

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
        """No more operators inside each other than can be worked out, and nothing that makes endless values."""
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
        """What to write for `3 sec` and `50 msec`."""
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

    def _binary(self, level: int) -> Node:
        if level == len(_BINARY):
            return self._unary()
        node = self._binary(level + 1)
        while (operator := self._accept(*_BINARY[level])) is not None:
            node = Binary(node.at, operator, node, self._binary(level + 1))
        return node

    def _unary(self) -> Node:
        at = self._here()
        signs = []
        while (sign := self._accept("-", "~")) is not None:
            signs.append(sign)
        node = self._postfix()
        for sign in reversed(signs):
            node = Unary(at, sign, node)
        return node

    def _postfix(self) -> Node:
        node = self._atom()
        while True:
            if self._accept("."):
                if isinstance(node, Number) and self._peek() == "number":
                    raise self._error("numbers are whole", node.at, "write 3, or a time with its unit, such as 3.5 s")
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
            return Number(at, int(word, 16 if word[:2] in ("0x", "0X") else 10))
        if kind == "time":
            return time_of(word, at)
        if kind == "text":
            return Text(at, re.sub(r"\\(.)", r"\1", word[1:-1]))
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

    def _items(self, end: str) -> tuple[Node, ...]:
        items: list[Node] = []
        if self._accept(end):
            return ()
        while True:
            items.append(self._conditional())
            if self._accept(end):
                return tuple(items)
            self._expect(",")

    def _bytes(self, word: str, at: Position) -> Node:
        try:
            return Bytes(at, bytes.fromhex(word[2:-1]))
        except ValueError:
            raise self._error(f"{word} is not bytes", at, "write pairs of hex digits, such as h'10 3A'") from None
