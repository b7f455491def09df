"""Typed access to nodes for the loaders, with one list of problems, and the parsers of scalars.

A loader that cannot continue with a part (a frame, a sequence, a row) notes the problem and raises `Broken`. The caller
leaves that part out and continues with the next, so that all problems of a file are reported at once.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from collections.abc import Mapping as Mapping_
from contextlib import contextmanager, suppress
from typing import TypeVar

from framekit.definition.expression import Bytes, Expression, ExpressionError, parse_expression
from framekit.definition.model.values import Constant
from framekit.definition.numbers import whole_number
from framekit.definition.problems import DefinitionError, Position, Problem, did_you_mean, parted
from framekit.definition.times import UNITS, parse_time
from framekit.definition.tree import Entry, Mapping, Node, Scalar, Sequence

T = TypeVar("T")
P = TypeVar("P")
MOST_BYTES = 1_048_576
"""Maximum number of bytes of a frame, and of items of its lists."""
MOST_ELEMENTS = 16_777_216
"""Maximum number of elements of a memory area."""


class Broken(Exception):  # noqa: N818 - a signal between loaders, not an error by itself
    """Raised if the part being loaded is unusable; the problem has been noted."""


class Reader:
    """Read nodes as values of keys, and collect their problems."""

    def __init__(self) -> None:
        self.problems: list[Problem] = []

    # ---- problems -----------------------------------------------------------------------------------------

    def note(self, at: Position, what: str, todo: str = "") -> None:
        """Add a problem; reading continues."""
        self.problems.append(Problem(at, what, todo))

    def warn(self, at: Position, what: str, todo: str = "") -> None:
        self.problems.append(Problem(at, what, todo, warning=True))

    def broken(self, at: Position, what: str, todo: str = "") -> Broken:
        """Add a problem and return the exception for the caller to raise."""
        self.note(at, what, todo)
        return Broken(what)

    def of_file(self, error: DefinitionError, name: str, at: Position) -> None:
        """Add the problems of a file; a missing file is a problem of the place that names it."""
        for problem in error.problems:
            missing = problem.at.file == name and not problem.at.line
            self.problems.append(Problem(at, problem.what, problem.todo) if missing else problem)

    @contextmanager
    def going_on(self) -> Iterator[None]:
        """Leave a broken part out, and continue after it."""
        with suppress(Broken):
            yield

    @contextmanager
    def refusing(self, at: Position) -> Iterator[None]:
        """Turn a ValueError into a problem at `at`; its text holds the error and, after a dash, the remedy."""
        try:
            yield
        except ValueError as error:
            raise self.broken(at, *parted(error)) from None

    def unknown(self, at: Position, kind: str, word: str, known: Iterator[str] | list[str]) -> Broken:
        return self.broken(at, f"there is no {kind} '{word}'", did_you_mean(word, known) or f"add it to {kind}s:")

    # ---- scalars ------------------------------------------------------------------------------------------

    def scalar(self, node: Node | None) -> Scalar:
        if not isinstance(node, Scalar):
            raise self._shape(node, "a single value")
        return node

    def text(self, node: Node | None) -> str:
        return self.scalar(node).text

    def _parsed(self, node: Node | None, parse: Callable[[str], T]) -> T:
        scalar = self.scalar(node)
        try:
            return parse(scalar.text)
        except ValueError as error:
            raise self.broken(scalar.at, *parted(error)) from None

    def number(self, node: Node | None) -> int:
        return self._parsed(node, parse_number)

    def count(self, node: Node | None, most: int, of: str) -> int:
        """Return a number from 0 to `most`; `of` names the counted items in the message."""
        number = self.number(node)
        if not 0 <= number <= most:
            what = f"{number} {of} are not possible: 0 to {most} are"
            raise self.broken(self.scalar(node).at, what, "give a number in this range")
        return number

    def bytes_at_most(self, node: Node | None) -> int:
        """Return a number of bytes, digits or items in a frame, at most `MOST_BYTES`."""
        return self.count(node, MOST_BYTES, "bytes or items in a frame")

    def constant(self, node: Node | None) -> Constant:
        """Return a number, a time, `h'…'` bytes or a text."""
        return self._parsed(node, parse_constant)

    def cell(self, node: Node | None) -> Constant:
        """Return the constant of a table or a column: a quoted scalar is a text, unless it holds bytes."""
        quoted = self.scalar(node).quoted
        return self._parsed(node, parse_quoted if quoted else parse_constant)

    def flag(self, node: Node | None, default: bool = False) -> bool:
        return default if node is None else bool(self._parsed(node, parse_flag))

    def bytes(self, node: Node | None) -> bytes:
        return self._parsed(node, parse_bytes)

    def byte(self, node: Node | None) -> int:
        data = self.bytes(node)
        if len(data) != 1:
            raise self.broken(self.scalar(node).at, "one byte is wanted here", "write two hex digits or one name")
        return data[0]

    def range(self, node: Node | None) -> tuple[int, int]:
        return self._parsed(node, parse_range)

    def time(self, node: Node | None) -> int:
        """Return a time in nanoseconds: `10 ms`, or a unit alone, such as `ms` for 1 ms."""
        return self._parsed(node, lambda text: parse_time(f"1 {text}" if text in UNITS else text))

    def places(self, node: Node | None) -> tuple[int, int]:
        return self._parsed(node, parse_places)

    def one_of(self, node: Node | None, words: Mapping_[str, T], kind: str) -> T:
        scalar = self.scalar(node)
        if scalar.text not in words:
            raise self.broken(scalar.at, f"'{scalar.text}' is not {kind}", did_you_mean(scalar.text, words))
        return words[scalar.text]

    # ---- expressions --------------------------------------------------------------------------------------

    def expression(self, node: Node | None, *, of_places: bool = False) -> Expression:
        scalar = self.scalar(node)
        return self.expression_text(scalar.text, inside(scalar), of_places=of_places)

    def expression_text(self, text: str, at: Position, *, of_places: bool = False) -> Expression:
        try:
            return parse_expression(text, at, of_places=of_places)
        except ExpressionError as error:
            self.problems.append(error.problem)
            raise Broken(str(error)) from None

    def target(self, key: Scalar) -> tuple[str, Expression | None, str | None]:
        """Return the target of `set`: a variable, the key of a table (`name[key]`), a field of a record (`….field`)."""
        match = _TARGET.fullmatch(key.text)
        if match is None:
            todo = "name a variable, table[key] or frame.field – quote it in YAML"
            raise self.broken(key.at, f"'{key.text}' cannot be set", todo)
        first, index = inside(key), match["key"]
        at = Position(first.file, first.line, first.column + match.start("key"))
        return match["name"], None if index is None else self.expression_text(index, at), match["field"]

    def maybe(self, read: Callable[[Node], T], node: Node | None) -> T | None:
        return None if node is None else read(node)

    def tried(self, read: Callable[[Node], T], node: Node | None) -> T | None:
        """Read a node as `maybe` does, but return None if it is broken; reading continues."""
        with self.going_on():
            return None if node is None else read(node)
        return None

    # ---- collections --------------------------------------------------------------------------------------

    def each(self, parts: Iterable[P], read: Callable[[P], T]) -> tuple[T, ...]:
        """Return the results of reading all parts; raise Broken after the last part if one is broken."""
        found: list[T] = []
        broken: Broken | None = None
        for part in parts:
            try:
                found.append(read(part))
            except Broken as error:
                broken = broken or error
        if broken is not None:
            raise broken
        return tuple(found)

    def by_name(self, entries: Iterable[Entry], read: Callable[[Node], T]) -> dict[str, T]:
        """Return the values of entries by their keys; raise Broken after the last entry if one is broken."""
        return dict(self.each(entries, lambda entry: (entry.key.text, read(entry.value))))

    def mapping(self, node: Node | None) -> Mapping:
        if not isinstance(node, Mapping):
            raise self._shape(node, "a mapping (name: value)")
        return node

    def sequence(self, node: Node | None) -> Sequence:
        if not isinstance(node, Sequence):
            raise self._shape(node, "a list")
        return node

    def entries(self, node: Node | None) -> tuple[Entry, ...]:
        return () if node is None else self.mapping(node).read_all()

    def items(self, node: Node | None) -> tuple[Node, ...]:
        """Return the items of a list; a single node counts as a list with this item, None as an empty list."""
        if node is None:
            return ()
        return node.items if isinstance(node, Sequence) else (node,)

    def texts(self, node: Node | None) -> tuple[str, ...]:
        return tuple(self.text(item) for item in self.items(node))

    def _shape(self, node: Node | None, wanted: str) -> Broken:
        if node is None:
            return Broken(f"{wanted} is missing")  # the schema has reported it
        return self.broken(node.at, f"{wanted} is wanted here")


def inside(scalar: Scalar) -> Position:
    """Return the position of the text of a scalar, without its quote."""
    return Position(scalar.at.file, scalar.at.line, scalar.at.column + 1) if scalar.quoted else scalar.at


_CONTROLS = (
    "NUL SOH STX ETX EOT ENQ ACK BEL BS HT LF VT - CR SO SI DLE DC1 DC2 DC3 DC4 NAK SYN ETB CAN EM SUB ESC FS GS RS US"
)
CONTROL_NAMES = {name: code for code, name in enumerate(_CONTROLS.split()) if name != "-"}
CONTROL_NAMES |= {"SP": 0x20, "DEL": 0x7F, "TAB": 0x09, "XON": 0x11, "XOFF": 0x13}
"""Names of control characters; form feed has no name, since `FF` is the byte."""

FLAGS = {"yes": 1, "true": 1, "on": 1, "no": 0, "false": 0, "off": 0}

_TARGET = re.compile(r"\s*(?P<name>\w+)(?:\[(?P<key>.*)\])?(?:\.(?P<field>\w+))?\s*")
_NUMBER = re.compile(r"[-+]?(?:0[xX][0-9a-fA-F]+|\d+)")


def parse_number(text: str) -> int:
    """Return the number of `12`, `0x0C`, `-3`; a leading zero is without effect."""
    text = text.strip()
    if not _NUMBER.fullmatch(text):
        raise ValueError(f"'{text}' is not a whole number – write it like 10 or 0x0A")
    return whole_number(text, 16 if "x" in text.lower() else 10)


def parse_flag(text: str) -> int:
    """Parse `yes` or `no` (also true, false, on, off) as 1 or 0. Raise ValueError."""
    try:
        return FLAGS[text.strip().lower()]
    except KeyError:
        raise ValueError(f"'{text}' is neither yes nor no") from None


def parse_bytes(text: str) -> bytes:
    """Parse hex pairs and names of control characters: `1B 54`, `DLE STX`, `0D0A`. Raise ValueError."""
    result = bytearray()
    for word in text.split():
        if word.upper() in CONTROL_NAMES and word.isupper():
            result.append(CONTROL_NAMES[word.upper()])
        elif re.fullmatch(r"(?:[0-9a-fA-F]{2})+", word):
            result += bytes.fromhex(word)
        else:
            raise ValueError(f"'{word}' is neither hex digits in pairs nor the name of a control character")
    if not result:
        raise ValueError("no bytes are given – write hex pairs such as 1B 54, or names such as DLE STX")
    return bytes(result)


def parse_range(text: str) -> tuple[int, int]:
    """Parse `a..b` with numbers or times, both ends included. Raise ValueError."""
    first, dots, last = text.partition("..")
    if not dots:
        raise ValueError(f"'{text}' is not a range – write it like 1..16")
    low, high = _end_of_range(first), _end_of_range(last)
    if low > high:
        raise ValueError(f"the range {text} is empty – its first number is greater than its last")
    return low, high


def _end_of_range(text: str) -> int:
    text = text.strip()
    if _NUMBER.fullmatch(text):
        return parse_number(text)
    try:
        return parse_time(text)
    except ValueError:
        raise ValueError(f"'{text}' is neither a number nor a time") from None


def parse_places(text: str) -> tuple[int, int]:
    """Parse bit places `5` or `4-7`, lowest first. Raise ValueError."""
    low, dash, high = text.partition("-")
    places = parse_number(low), parse_number(high if dash else low)
    if not 0 <= places[0] <= places[1]:
        raise ValueError(f"'{text}' is not a bit or a range of bits – write it like 5 or 4-7")
    return places


def parse_constant(text: str) -> Constant:
    """Parse a value of a table or a column: a number, a time, `h'…'` bytes, `'quoted'` or bare text.

    Raise ValueError.
    """
    text = text.strip()
    if _NUMBER.fullmatch(text):
        return parse_number(text)
    if re.fullmatch(r"h'[^']*'", text):
        try:
            return bytes.fromhex(text[2:-1])
        except ValueError:
            raise ValueError(f"{text} is not bytes – write pairs of hex digits, such as h'10 3A'") from None
    if len(text) >= 2 and text[0] == text[-1] == "'":
        return text[1:-1]
    try:
        return parse_time(text)
    except ValueError:
        return text


def parse_quoted(text: str) -> Constant:
    """Return a scalar in YAML's quotes as a text; `h'…'` and `'quoted'` in the quotes are parsed."""
    inner = text.strip()
    return parse_constant(inner) if re.fullmatch(r"h?'[^']*'", inner) else text


def parse_key(text: str) -> int | str:
    """Parse the key of a table: a number or a text."""
    text = text.strip()
    return parse_number(text) if _NUMBER.fullmatch(text) else text


def literal_bytes(scalar: Scalar) -> Expression:
    """Return bytes written as hex pairs, as an expression. Raise ValueError."""
    return Expression(scalar.text, Bytes(scalar.at, parse_bytes(scalar.text) if scalar.text.strip() else b""))
