"""The words of an expression: numbers, times, texts, bytes, names and signs, each with its position.

What may follow what is not known here.
"""

from __future__ import annotations

import re
from fractions import Fraction

from framekit.definition.expression.syntax import LineTime, Node, Number
from framekit.definition.problems import Position, Problem
from framekit.definition.times import LINE_UNITS, UNITS

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
