"""Parse expressions of Kaitai Struct into a tree of framekit's expression nodes and three Kaitai-specific nodes.

Expressions are not evaluated, and names are not resolved. A text that is too long, too deeply nested or no expression
raises CannotSayError. Source: the user guide of Kaitai Struct, Expression language.
"""

from __future__ import annotations

import re
import sys
from dataclasses import dataclass
from decimal import Decimal

from framekit.definition.expression import (
    Attribute,
    Compare,
    Conditional,
    Index,
    List,
    Name,
    Node,
    Number,
    OperatorGrammar,
    Real,
    Text,
    children,
)
from framekit.definition.problems import CannotSayError, Position

LONGEST = 10_000
"""Limit of the length of an expression."""
DEEPEST = 90
"""Limit of the nesting depth of operators; framekit's own expressions have a limit of 100."""
_DIGITS = 80
"""Limit of the digits of a number."""
_NESTED = 40
"""Limit of the nesting depth of parentheses, brackets and conditionals."""


@dataclass(frozen=True, slots=True)
class EnumMember(Node):
    """A member of an enumeration: `animal::cat`, `zoo::animal::cat`."""

    path: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Cast(Node):
    """A cast: `x.as<type>`."""

    value: Node
    type: str


@dataclass(frozen=True, slots=True)
class MethodCall(Node):
    """A method call: `x.name(a, b)`."""

    value: Node
    name: str
    arguments: tuple[Node, ...]


_TOKEN = re.compile(
    r"""\s*(?:
      (?P<real>[0-9][0-9_]*(?:\.[0-9][0-9_]*(?:[eE][+-]?[0-9]+)?|[eE][+-]?[0-9]+))
    | (?P<number>0[xX][0-9a-fA-F_]+|0[bB][01_]+|0[oO][0-7_]+|[0-9][0-9_]*)
    | (?P<text>"(?:[^"\\]|\\.)*"|'[^']*')
    | (?P<word>[A-Za-z_][A-Za-z0-9_]*)
    | (?P<sign>::|<<|>>|==|!=|<=|>=|[-+*/%&|^~<>()\[\],.:?])
    )""",
    re.VERBOSE | re.DOTALL,
)
_BINARY = (("|",), ("^",), ("&",), ("<<", ">>"), ("+", "-"), ("*", "/", "%"))
_COMPARE = ("==", "!=", "<", "<=", ">", ">=")
_WORDS = frozenset({"and", "or", "not"})
_ESCAPES = {
    "a": "\a", "b": "\b", "n": "\n", "r": "\r", "t": "\t", "v": "\v", "f": "\f", "e": "\x1b",
    "'": "'", '"': '"', "\\": "\\",
}  # fmt: skip
_ESCAPE = re.compile(r"\\(?:u([0-9a-fA-F]{4})|([0-7]+)|(.))", re.DOTALL)
BY_HAND = "write what it means by hand"
"""The advice for an expression without a form."""


def parse(text: str, at: Position) -> Node:
    """Return the tree of an expression; all of its nodes have the position `at`. Raises CannotSayError."""
    if len(text) > LONGEST:
        raise CannotSayError(at, f"an expression of more than {LONGEST} characters", "divide it")
    return _KsyParser(text, at).whole()


class _KsyParser(OperatorGrammar):
    """Parse one expression by recursive descent."""

    binary, signs = _BINARY, ("-", "+", "~")

    def __init__(self, text: str, at: Position) -> None:
        self.text, self.at = text, at
        self.tokens = self._cut()
        self.place = 0
        self.depth = 0

    def _wrong(self, what: str) -> CannotSayError:
        shown = self.text if len(self.text) <= 60 else f"{self.text[:59]}…"
        return CannotSayError(self.at, f"the expression '{shown}': {what}", "correct it")

    def _cut(self) -> list[tuple[str, str]]:
        found: list[tuple[str, str]] = []
        place, end = 0, len(self.text.rstrip())
        while place < end:
            match = _TOKEN.match(self.text, place)
            if match is None:
                raise self._wrong(f"{self.text[place:].lstrip()[:1]!r} begins nothing")
            kind = match.lastgroup or ""
            found.append((kind, match[kind]))
            place = match.end()
        return found

    def _here(self) -> Position:
        return self.at

    def _peek(self) -> str:
        """Return the next sign or word; '' for any other token, and at the end."""
        kind, text = self.tokens[self.place] if self.place < len(self.tokens) else ("", "")
        return text if kind in ("sign", "word") else ""

    def _accept(self, *texts: str) -> str | None:
        if (text := self._peek()) and text in texts:
            self.place += 1
            return text
        return None

    def _expect(self, text: str) -> None:
        if self._accept(text) is None:
            raise self._wrong(f"'{text}' is missing")

    def _word(self) -> str:
        kind, text = self.tokens[self.place] if self.place < len(self.tokens) else ("", "")
        if kind != "word":
            raise self._wrong("a name is missing")
        self.place += 1
        return text

    def whole(self) -> Node:
        if not self.tokens:
            raise self._wrong("it is empty")
        node = self._conditional()
        if self.place < len(self.tokens):
            raise self._wrong(f"'{self.tokens[self.place][1][:20]}' was not expected")
        waiting = [(node, 1)]
        while waiting:
            part, depth = waiting.pop()
            if depth > DEEPEST:
                raise self._wrong("it has too many operators in a row")
            waiting += [(one, depth + 1) for one in children(part)]
        return node

    def _conditional(self) -> Node:
        self.depth += 1
        if self.depth > _NESTED:
            raise self._wrong("it is nested too deeply")
        node = self._logic("or")
        if self._accept("?"):
            then = self._conditional()
            self._expect(":")
            node = Conditional(self.at, node, then, self._conditional())
        self.depth -= 1
        return node

    def _comparison(self) -> Node:
        first = self._binary(0)
        operator = self._accept(*_COMPARE)
        return first if operator is None else Compare(self.at, first, ((operator, self._binary(0)),))

    def _postfix(self) -> Node:
        node = self._atom()
        while True:
            if self._accept("."):
                name = self._word()
                if name == "as" and self._accept("<"):
                    node = Cast(self.at, node, self._type())
                elif self._accept("("):
                    node = MethodCall(self.at, node, name, self._items(")"))
                else:
                    node = Attribute(self.at, node, name)
            elif self._accept("["):
                index = self._conditional()
                self._expect("]")
                node = Index(self.at, node, index)
            else:
                return node

    def _type(self) -> str:
        name = self._word()
        while self._accept("::"):
            name += f"::{self._word()}"
        if self._accept("["):
            self._expect("]")
            name += "[]"
        self._expect(">")
        return name

    def _atom(self) -> Node:
        if self.place >= len(self.tokens):
            raise self._wrong("it ends too early")
        kind, text = self.tokens[self.place]
        self.place += 1
        match kind:
            case "number":
                return Number(self.at, self._number(text.replace("_", "")))
            case "real":
                return Real(self.at, Decimal(text.replace("_", "")), False)
            case "text":
                return Text(self.at, self._texts(text))
            case "word" if text not in _WORDS:
                return self._name(text)
        if text == "(":
            node = self._conditional()
            self._expect(")")
            return node
        if text == "[":
            return List(self.at, self._items("]"))
        if text == "::":
            return self._name(self._word())
        raise self._wrong(f"'{text}' was not expected")

    def _number(self, text: str) -> int:
        if len(text) > _DIGITS or (text[1:2].isalpha() and len(text) == 2):
            raise self._wrong(f"'{text[:20]}' is no number")
        return int(text, 0 if text[1:2].isalpha() else 10)

    def _texts(self, first: str) -> str:
        """Return adjacent texts as a single text."""
        words = [first]
        while self.place < len(self.tokens) and self.tokens[self.place][0] == "text":
            words.append(self.tokens[self.place][1])
            self.place += 1
        try:
            text = "".join(map(_text, words))
        except ValueError:
            raise self._wrong("a text with an escape that Kaitai does not have") from None
        if any("\ud800" <= sign <= "\udfff" for sign in text):
            raise self._wrong("a text with half a character")
        return text

    def _name(self, word: str) -> Node:
        path = [word]
        while self._accept("::"):
            path.append(self._word())
        if len(path) > 1:
            return EnumMember(self.at, tuple(path))
        following = self.tokens[self.place] if self.place < len(self.tokens) else ("", "")
        if word in ("sizeof", "bitsizeof") and following[1] == "<":
            raise CannotSayError(self.at, f"'{word}' asks for the size of a type", BY_HAND)
        if word == "f" and following[0] == "text":
            raise CannotSayError(self.at, "a text with values in it", BY_HAND)
        return Name(self.at, word)


def _text(word: str) -> str:
    return word[1:-1] if word[0] == "'" else _ESCAPE.sub(_sign, word[1:-1])


def _sign(match: re.Match[str]) -> str:
    """Return the character of an escape sequence. Raises ValueError for an unknown escape."""
    if match[1]:
        return chr(int(match[1], 16))
    if match[2]:
        digits = match[2].lstrip("0")[:_DIGITS] or "0"
        return chr(min(int(digits, 8), sys.maxunicode + 1))
    if match[3] not in _ESCAPES:
        raise ValueError
    return _ESCAPES[match[3]]
