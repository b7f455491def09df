"""What is wrong with a text that is no YAML, in sentences that say what to do.

The errors of PyYAML are told apart by their words and by the characters around the place; both of its scanners (the C
one and the Python one) are understood. Nothing here knows what a definition means.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import yaml

from framekit.definition.problems import Position, Problem

QUOTE_EXPRESSION = "quote the whole expression"
"""What to do about everything that YAML takes for its own punctuation inside an expression."""

_CLOSING = {"[": "]", "{": "}"}
_KEY_BEFORE = re.compile(r"[^\s#].*:\s+\S")


@dataclass(frozen=True, slots=True)
class _Place:
    """A mark of the scanner, and the text around it."""

    line: int
    column: int
    before: str
    sign: str

    @property
    def last_sign(self) -> str:
        """The last character before the place on its line, blanks left out."""
        return self.before.rstrip()[-1:]


@dataclass(frozen=True, slots=True)
class _Error:
    """An error of the scanner or parser: its words, where it was found, and where what it was reading began."""

    context: str
    words: str
    start: _Place
    found: _Place
    comment: _Place | None = None


_Finding = tuple[_Place, str, str]


def syntax_problem(error: yaml.YAMLError, text: str, file: str) -> Problem:
    """The problem that a YAML error of `text` is."""
    if not isinstance(error, yaml.MarkedYAMLError):
        return Problem(Position(file, 1, 1), "this is not YAML", "save the file as plain text in UTF-8")
    lines = text.splitlines()
    found = error.problem_mark or error.context_mark
    facts = _Error(
        context=error.context or "",
        words=error.problem or "",
        start=_place(error.context_mark or found, lines),
        found=_place(found, lines),
        comment=_swallowing(lines, error.context_mark or found, found),
    )
    place, what, todo = next(finding for explain in _EXPLANATIONS if (finding := explain(facts)) is not None)
    return Problem(Position(file, place.line, place.column), what, todo)


def _place(mark: Any, lines: list[str]) -> _Place:
    """Where a mark of either scanner points to."""
    if mark is None:
        return _Place(1, 1, "", "")
    number, column = int(mark.line), int(mark.column)
    line = lines[number] if number < len(lines) else ""
    return _Place(number + 1, column + 1, line[:column], line[column : column + 1])


def _swallowing(lines: list[str], start: Any, end: Any) -> _Place | None:
    """Where, in the lines of what was being read, a comment begins behind an open bracket."""
    if start is None or end is None:
        return None
    last = min(int(end.line) + 1, len(lines))
    for number in range(max(0, min(int(start.line), last - 3)), last):
        column = _comment_in_brackets(lines[number])
        if column is not None:
            return _Place(number + 1, column + 1, lines[number][:column], "#")
    return None


def _comment_in_brackets(line: str) -> int | None:
    """The column of a comment that begins inside brackets of this line."""
    depth, quote = 0, ""
    for column, sign in enumerate(line):
        if quote:
            quote = "" if sign == quote else quote
        elif sign in "'\"":
            quote = sign
        elif sign == "#" and line[column - 1 : column].isspace():
            return column if depth > 0 else None
        else:
            depth += (sign in "[{") - (sign in "]}")
    return None


# ---- one explanation after the other: the first that fits is given ------------------------------------------


def _tab(error: _Error) -> _Finding | None:
    if error.found.sign != "\t" and "tab character" not in error.words:
        return None
    return error.found, "a tab stands here", "indent with spaces"


def _colon(error: _Error) -> _Finding | None:
    if "mapping values are not allowed" not in error.words:
        return None
    found = error.found
    if _KEY_BEFORE.search(found.before):
        return found, "a second ': ' stands in this value", "quote the whole value"
    todo = "check its indentation, and the ':' of the line above"
    return _line_start(found), "this line does not fit the one above", todo


def _no_space(error: _Error) -> _Finding | None:
    if "unexpected ':'" not in error.words:
        return None
    return error.found, "a space is missing behind ':'", "write key: value"


def _token(error: _Error) -> _Finding | None:
    if "cannot start any token" not in error.words:
        return None
    return error.found, f"a value cannot begin with '{error.found.sign}'", "put it in quotes"


def _first_sign(error: _Error) -> _Finding | None:
    """`& * ! > |` begin something of YAML's own."""
    if not re.search(r"an anchor|an alias|a tag|block scalar|tag handle", f"{error.context} {error.words}"):
        return None
    sign = error.start.sign or error.found.sign
    return error.start, f"a value cannot begin with '{sign}'", "put it in quotes"


def _directive(error: _Error) -> _Finding | None:
    if "directive" not in error.context:
        return None
    return error.start, "a line cannot begin with '%'", "put the text in quotes"


def _quote(error: _Error) -> _Finding | None:
    if "quoted scalar" not in error.context and "double-quoted" not in error.context:
        return None
    if "escape" in error.words:
        return error.found, "a '\\' in double quotes changes what follows", "use single quotes, or write \\\\"
    return error.start, "the quote that opens here is not closed", "add the closing quote"


def _behind_quote(error: _Error) -> _Finding | None:
    if error.found.last_sign not in ("'", '"') or error.found.sign in ("", ":"):
        return None
    return error.found, "the value goes on behind its closing quote", QUOTE_EXPRESSION


def _comment(error: _Error) -> _Finding | None:
    """A `#` in a list or mapping in brackets has swallowed the rest of the line, closing brackets and all."""
    if error.comment is None or ("flow" not in error.context and "node content" not in error.words):
        return None
    return error.comment, "everything behind '#' is a comment", "put the value in quotes"


def _in_brackets(error: _Error) -> _Finding | None:
    if "flow mapping" not in error.context and "flow sequence" not in error.context:
        return None
    opening, sign = ("{" if "mapping" in error.context else "["), error.found.sign
    closing = _CLOSING[opening]
    if not sign or (error.found.line != error.start.line and sign not in _CLOSING):
        return error.start, f"the '{opening}' here is not closed", f"add '{closing}', or {QUOTE_EXPRESSION}"
    if sign in _CLOSING.values():
        return error.found, f"'{sign}' stands where '{closing}' is missing", f"close '{opening}' with '{closing}'"
    if error.found.last_sign in _CLOSING.values():
        return error.found, f"the value goes on behind '{error.found.last_sign}'", QUOTE_EXPRESSION
    return error.found, f"the value is cut at '{sign}'", QUOTE_EXPRESSION


def _nothing_there(error: _Error) -> _Finding | None:
    if "node content" not in error.words:
        return None
    sign = error.found.sign
    if sign in _CLOSING.values():
        return error.found, f"there is a '{sign}' too many", "remove it, or put the value in quotes"
    if sign == "-":
        return error.found, "a list written with '- ' cannot stand between brackets", "write [a, b], or use no brackets"
    before = f"before '{sign}'" if sign else "at the end of the file"
    return error.found, f"a value is missing {before}", "write one, or put the whole value in quotes"


def _behind_value(error: _Error) -> _Finding | None:
    closing = error.found.last_sign
    if closing not in _CLOSING.values() or not _is_block(error):
        return None
    if error.found.sign in _CLOSING.values():
        return error.found, f"there is a '{error.found.sign}' too many", "remove it"
    return error.found, f"the value goes on behind '{closing}'", QUOTE_EXPRESSION


def _simple_key(error: _Error) -> _Finding | None:
    if "simple key" not in error.context:
        return None
    return error.start, "this line has no ':'", "write it as key: value"


def _indentation(error: _Error) -> _Finding | None:
    if not _is_block(error):
        return None
    if "block collection" in error.context or "'-' indicator" in error.words:
        return (
            error.found,
            "this line stands where an item of a list is wanted",
            "begin it with '- ' or indent it otherwise",
        )
    return error.found, "this line is indented like none above it", "indent it like the keys it belongs to"


def _document(error: _Error) -> _Finding | None:
    if "document start" not in error.words:
        return None
    return error.found, "something stands behind the end of the document", "remove the '...' above"


def _anything(error: _Error) -> _Finding:
    return error.found, "this is no valid YAML", "check quotes, brackets and indentation here"


def _is_block(error: _Error) -> bool:
    return "expected key" in error.words or "block end" in error.words or "'-' indicator" in error.words


def _line_start(place: _Place) -> _Place:
    column = len(place.before) - len(place.before.lstrip())
    return _Place(place.line, column + 1, "", "")


_EXPLANATIONS: tuple[Callable[[_Error], _Finding | None], ...] = (
    _tab,
    _colon,
    _no_space,
    _token,
    _first_sign,
    _directive,
    _quote,
    _behind_quote,
    _comment,
    _in_brackets,
    _nothing_there,
    _behind_value,
    _simple_key,
    _indentation,
    _document,
    _anything,
)
