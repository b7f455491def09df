"""Python source being written: lines with indentation, long ones broken at brackets, literals as people write them.

This is the one place where text of a file becomes source: `quoted`, `text_source`, `docstring` and `comment` write
signs as `repr` does, so that the text stays data. All other text of a line is the generator's own. The module knows
Python's layout and no protocol.
"""

from __future__ import annotations

import builtins
import keyword
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from itertools import groupby
from typing import Any

from framekit.definition.problems import printable

WIDTH = 110
"""Limit of the line length."""
INDENT = "    "
_NAMED_ALIKE = re.compile(r'"(\w+)": \1_?')
_MANY = 5
"""Number of mapping entries named like their values from which they share lines."""
MOST_NAMES = 16
"""Names of other cases that the code of a case lists; more are listed once for all cases."""
_OPENING, _CLOSING = "([{", ")]}"


class Source:
    """Lines of a module or a function; `block` indents the lines added inside it."""

    def __init__(self, depth: int = 0) -> None:
        self.lines: list[str] = []
        self.depth = depth

    def add(self, text: str = "", about: str = "") -> None:
        """Add a statement, with an optional comment; a long statement is broken over several lines.

        Raises ValueError for a character that only a literal may contain: the text was written without `quoted`.
        """
        if not text.isprintable():
            raise ValueError(f"no line of source: {text!r}")
        self.lines.extend(broken(INDENT * self.depth + text) if text else [""])
        if about:
            self.lines[-1] += f"  # {printable(about)}"

    def comment(self, text: str) -> None:
        """Add a comment line."""
        self.lines.append(f"{INDENT * self.depth}# {printable(text)}")

    def docstring(self, *lines: str) -> None:
        """Add a docstring of these lines; quotes, backslashes and control characters in them are escaped."""
        indent = INDENT * self.depth
        # escape quotes before other quotes and at the end of a line, which could end the docstring
        first, *others = [printable(re.sub(r'"(?="|\Z)', r"\"", line.replace("\\", "\\\\"))) for line in lines]
        if not others:
            self.lines.append(f'{indent}"""{first}"""')
            return
        self.lines.append(f'{indent}"""{first}')
        self.lines.extend(indent + line if line else "" for line in others)
        self.lines.append(f'{indent}"""')

    def extend(self, other: Source) -> None:
        """Add the lines of another source at the current indentation."""
        self.lines.extend(INDENT * self.depth + line if line else "" for line in other.lines)

    @contextmanager
    def block(self, header: str) -> Iterator[None]:
        self.add(header)
        before = len(self.lines)
        self.depth += 1
        try:
            yield
            if len(self.lines) == before:
                self.add("pass")
        finally:
            self.depth -= 1

    def text(self) -> str:
        return "\n".join(self.lines) + "\n"


_LOGIC = re.compile(
    r"""(\s*)((?:lambda n: |return |(?:\w+(?:: \w+)?|\w+\["[^"]*"\]) [+|]?= |\w+=|"[^"]*": )?)(.*?)(,?)""", re.DOTALL
)
"""A line with an expression: indentation, an optional name or key, the expression, an optional comma."""


def broken(line: str) -> list[str]:
    """Return the line unchanged, or with the content of its last outermost brackets on separate lines."""
    if len(line) <= WIDTH:
        return [line]
    if (start := re.match(r"(\s*)(if|elif|while) (.*):$", line)) is not None:
        if operands := _operands(start[3]):
            return [f"{start[1]}{start[2]} (", *_joined(operands, start[1]), f"{start[1]}):"]
    elif (logic := _LOGIC.fullmatch(line)) is not None and (operands := _operands(logic[3])):
        return [f"{logic[1]}{logic[2]}(", *_joined(operands, logic[1]), f"{logic[1]}){logic[4]}"]
    if (targets := re.match(r"(\s*)((?:\w+, )+\w+)( = .*)$", line)) is not None and len(targets[2]) > WIDTH // 2:
        rows = _packed(targets[2].split(", "), targets[1])
        return [f"{targets[1]}(", *rows, *broken(f"{targets[1]}){targets[3]}")]
    brackets = _outermost(line)
    return [line] if brackets is None else _with_broken_brackets(line, *brackets)


def _with_broken_brackets(line: str, opening: int, closing: int) -> list[str]:
    """Return the line with the content of the brackets at two offsets on separate lines."""
    indent = line[: len(line) - len(line.lstrip())]
    items = [item.strip() for item in _split(line[opening + 1 : closing], ",")]
    is_tuple = len(items) > 1 or line[opening + 1 : closing].rstrip().endswith(",")
    loop = _split(line[opening + 1 : closing], " for ")
    if len(loop) > 1:
        inner = [f"{indent}{INDENT}{'for ' if place else ''}{part.strip()}" for place, part in enumerate(loop)]
    elif len(items) > 12 and all(re.fullmatch(r"[\w.\"'\\]+", item) for item in items):
        inner = _packed(items, indent)
    else:
        inner = []
        for is_plain, some in groupby(items, lambda item: _NAMED_ALIKE.fullmatch(item) is not None):
            row = list(some)
            if is_plain and len(row) >= _MANY:
                inner += _packed(row, indent)
            else:
                inner += [one for item in row for one in broken(f"{indent}{INDENT}{item}{',' if is_tuple else ''}")]
    return [line[: opening + 1], *inner, indent + line[closing:]]


def _joined(operands: Sequence[tuple[str, str]], indent: str) -> list[str]:
    """Return operands, each on lines of its own, deeper than `indent`, with the operator first."""
    found: list[str] = []
    for operator, operand in operands:
        line, *rest = broken(f"{indent}{INDENT}{operand}")
        found += [f"{indent}{INDENT}{operator}{line.strip()}", *rest]
    return found


_BITS = re.compile(r"\w+( << \d+)?")


def _operands(text: str) -> list[tuple[str, str]]:
    """Return the operands of the weakest operator outside of brackets, each with the operator before it.

    Operators are those of a choice (`a if c else b`), `or` and `and`, and `|` between plain operands. Return an empty
    list if the text has none of them.
    """
    if choice := _parts_of_choice(text):
        return choice
    for word in (" or ", " and "):
        if len(parts := _split(text, word)) > 1:
            return [("", parts[0]), *((word.lstrip(), part) for part in parts[1:])]
    bits = _split(text, " | ")
    if len(bits) > 1 and all(_BITS.fullmatch(part) for part in bits):
        return [("", bits[0]), *(("| ", part) for part in bits[1:])]
    return []


def _parts_of_choice(text: str) -> list[tuple[str, str]]:
    """Return the operands of `a if c else b`, which may go on with `if d else e`; an empty list for other texts."""
    found: list[tuple[str, str]] = []
    for place, part in enumerate(_split(text, " else ")):
        value, *condition = _split(part, " if ")
        found.append(("else " if place else "", value))
        found += [("if ", operand) for operand in condition]
    return found if len(found) > 1 and " for " not in text else []


def _packed(items: list[str], indent: str) -> list[str]:
    rows, row = [], indent + INDENT
    for item in items:
        if len(row) + len(item) > WIDTH and row.strip():
            rows.append(row.rstrip())
            row = indent + INDENT
        row += f"{item.strip()}, "
    rows.append(row.rstrip())
    return rows


def _outermost(line: str) -> tuple[int, int] | None:
    """Return the offsets of the outermost bracket pair with the most content.

    So the largest call of a sum is broken.
    """
    found, stack = None, []
    for sign, place in _outside_texts(line, "#"):
        if sign == "#":
            break
        if sign in _OPENING:
            stack.append(place)
        elif stack:
            opening = stack.pop()
            if not stack and place - opening > 1 and (found is None or place - opening >= found[1] - found[0]):
                found = opening, place
    return found


_ENDS_OF_TEXT = {quote: re.compile(rf"(?:[^{quote}\\]|\\.)*{quote}", re.DOTALL) for quote in "\"'"}


@cache
def _signs(separator: str) -> re.Pattern[str]:
    """Return a pattern for a quote, a bracket or the separator."""
    return re.compile("[" + re.escape(f"\"'{_OPENING}{_CLOSING}") + "]|" + re.escape(separator))


def _outside_texts(text: str, separator: str) -> Iterator[tuple[str, int]]:
    """Yield each bracket and separator outside of quotes, with its offset."""
    signs, place = _signs(separator), 0
    while found := signs.search(text, place):
        sign, place = found[0], found.end()
        if sign in _ENDS_OF_TEXT:
            end = _ENDS_OF_TEXT[sign].match(text, place)
            place = len(text) if end is None else end.end()
        else:
            yield sign, found.start()


def _split(text: str, separator: str) -> list[str]:
    """Return `text` cut at each `separator` outside of brackets and quotes."""
    if separator not in text:
        return [text] if text.strip() else []
    parts, depth, start = [], 0, 0
    for sign, place in _outside_texts(text, separator):
        if sign != separator:
            depth += 1 if sign in _OPENING else -1
        elif depth == 0:
            parts.append(text[start:place])
            start = place + len(separator)
    parts.append(text[start:])
    return [part for part in parts if part.strip()]


def literal(value: Any) -> str:
    """Return a value as generated source; texts are in double quotes."""
    if isinstance(value, str):
        return quoted(value)
    if isinstance(value, (bytes, bytearray)):
        return bytes_literal(bytes(value))
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{literal(key)}: {literal(item)}" for key, item in value.items()) + "}"
    if isinstance(value, tuple):
        return "(" + ", ".join(literal(item) for item in value) + ("," if len(value) == 1 else "") + ")"
    if isinstance(value, list):
        return "[" + ", ".join(literal(item) for item in value) + "]"
    return repr(value)


class Code(str):
    """Source inside a text: its value is formatted when the text is needed."""


def text_source(*parts: str | Code) -> str:
    """Return the source of a text: the parts unchanged, and the values of the `Code` parts."""
    if not any(isinstance(part, Code) for part in parts):
        return quoted("".join(parts))
    if any(isinstance(part, Code) and re.search(r"[^\w ()+\-.]", part) for part in parts):  # no f-string
        return " + ".join(f"str({part})" if isinstance(part, Code) else quoted(part) for part in parts)
    shown = (
        f"{{{part}}}" if isinstance(part, Code) else _escaped(part).replace("{", "{{").replace("}", "}}")
        for part in parts
    )
    return f'f"{"".join(shown)}"'


def quoted(text: str) -> str:
    """Return the text as a string literal in double quotes."""
    return f'"{_escaped(text)}"'


def _escaped(text: str) -> str:
    """Return the text with escapes for a literal in double quotes: of quotes, and of characters that `repr` escapes."""
    return printable(text.replace("\\", "\\\\").replace('"', '\\"'))


def bytes_literal(data: bytes) -> str:
    """Return bytes in double quotes: letters unchanged, other bytes as \\xNN; long runs of one byte as a product."""
    if len(data) > 8 and len(set(data)) == 1:
        return f"({bytes_literal(data[:1])} * {len(data)})"
    shown = "".join(chr(byte) if 0x20 <= byte < 0x7F and byte not in b'"\\' else f"\\x{byte:02x}" for byte in data)
    return f'b"{shown}"'


def grouped(value: int) -> str:
    """Return a number with underscores between thousands, if it has at least six digits."""
    return f"{value:_}" if abs(value) >= 100_000 else str(value)


OWN_WORDS = frozenset(
    {
        "at", "behind", "binascii", "computed", "ctx", "data", "end", "error", "frame", "n", "raw",
        "seen", "size", "start", "stop", "struct", "unhexlify", "values",
    }
)  # fmt: skip
"""Parameters, locals and modules that generated functions use themselves."""

_PYTHON = OWN_WORDS | {*dir(builtins), *keyword.kwlist, "match", "case", "type"}
_OWN_PREFIXES = ("decode_", "encode_", "diagnose_", "measure_", "inner_", "pack_", "unpack_", "parse_", "build_")


def identifier(name: str) -> str:
    """Return `name` as an identifier in lower case: `WR.REQ` is `wr_req`, `7th` is `_7th`."""
    text = re.sub(r"[^0-9a-z_]", "_", name.lower()).strip("_") or "unnamed"
    return f"_{text}" if text[0].isdigit() else text


def constant_name(*names: str) -> str:
    """Return joined names as the name of a module constant: `READ_REPLY_HEAD`, `_7TH_HEAD`."""
    return identifier("_".join(identifier(name).strip("_") for name in names)).upper()


class UniqueNames:
    """Give out each name once, equal names numbered `NAME_2`, `NAME_3` …, in time that does not grow with their number.

    `taken`: names that are never given out.
    """

    def __init__(self, taken: Iterable[str] = ()) -> None:
        self._taken = set(taken)
        self._numbers: dict[str, int] = {}
        """The last number of each wanted name."""

    def reserve(self, names: Iterable[str]) -> None:
        """Take names without giving them out."""
        self._taken.update(names)

    def take(self, wanted: str, numbered: str = "", first: int = 2) -> str:
        """Return `wanted` if it is free, or else the free name `NUMBERED_N` with the least number from `first`.

        `numbered`: the name before the number, if it is not `wanted`; the number 1 is left out.
        """
        found, number = wanted, self._numbers.get(wanted, first - 1)
        while found in self._taken:
            number += 1
            found = f"{numbered or wanted}_{number if number > 1 else ''}"
        self._numbers[wanted] = number
        self._taken.add(found)
        return found


class Identifiers:
    """Give out identifiers that are free. `reserved`: names that are never given out."""

    def __init__(self, reserved: Iterable[str] = ()) -> None:
        self._names = UniqueNames({*reserved, *_PYTHON})

    def fresh(self, name: str) -> str:
        """Return `name` as a free identifier, numbered `NAME_`, `NAME_2`, `NAME_3` … if the name is taken."""
        wanted = identifier(name)
        if wanted.startswith(_OWN_PREFIXES):
            wanted += "_"
        return self._take(wanted)

    def reserve(self, names: Iterable[str]) -> None:
        """Take names without giving them out."""
        self._names.reserve(names)

    def constant(self, *names: str) -> str:
        """Return a free name of a module constant."""
        return self._take(constant_name(*names))

    def _take(self, wanted: str) -> str:
        return self._names.take(wanted, wanted.rstrip("_"), first=1)
