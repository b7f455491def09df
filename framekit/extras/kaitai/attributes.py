"""Read attributes of a Kaitai Struct file as far as their keys need no values; track regions and the amount of work.

Sizes that need no values are computed here, so that the number of bytes after an attribute is known.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any
from typing import Protocol as Interface

from framekit.definition.expression import (
    Attribute,
    Binary,
    Compare,
    Name,
    Node,
    Number,
    Unary,
)
from framekit.definition.nodes import Mapping as MappingNode
from framekit.definition.nodes import Node as YamlNode
from framekit.definition.nodes import Scalar, Sequence
from framekit.definition.problems import CannotSayError, Position
from framekit.definition.wire_types import NOTHING, Sizes
from framekit.extras.kaitai.description import KsyAttribute, KsyEnum, KsyType, one_number, whole

Keys = dict[str, Any]
MOST_SEGMENTS = 4000
"""Limit of the segments of a frame, including nested segments."""
MOST_WORK = 100_000
"""Limit of the segments and parts of expressions of all frames together."""
DEEPEST = 24
"""Limit of the nesting depth of types that use each other."""
MOST_BYTES = 1 << 20
"""Limit of a constant size in bytes."""
NUMBER = re.compile(r"([us])([1248])(le|be)?")
FLOAT = re.compile(r"f([48])(le|be)?")
BITS = re.compile(r"b([1-9][0-9]?)(le|be)?")
_GREATEST = re.compile(r"_io\.size <= ([0-9]{1,7})")
_DIGITS_IN_TEXT = re.compile(r"-?[0-9]{1,20}|0x[0-9a-fA-F]{1,20}")
OF_ALL = frozenset({"id", "doc", "doc-ref", "if", "repeat", "repeat-expr", "repeat-until", "type", "valid"})
OF_TEXTS = frozenset({"size", "size-eos", "terminator", "include", "consume", "eos-error", "pad-right", "encoding"})
OF_BYTES = OF_TEXTS - {"encoding"} | {"process"}


class LeftOutError(Exception):
    """Raised after a part that cannot be imported has been reported."""


class WorkDone:
    """Count the parts that have been written. Raises CannotSayError beyond the limit."""

    def __init__(self) -> None:
        self.all = 0
        self._begun = 0

    def begin(self) -> None:
        """Start the count of a frame."""
        self._begun = self.all

    def add(self, at: Position, number: int) -> None:
        """Count `number` parts. Raises CannotSayError beyond the limits of the file or of the frame."""
        self.all += number
        if self.all > MOST_WORK:
            raise CannotSayError(at, "the file says too much in all", f"{MOST_WORK} parts are taken over; divide it")
        if self.all - self._begun > 8 * MOST_SEGMENTS:
            raise CannotSayError(at, "a type of too many parts in all", "divide it")


@dataclass(slots=True, eq=False)
class Region:
    """A stream: the whole stream, or the substream of an attribute with a size."""

    is_taken: bool = False
    """Whether a part has taken all remaining bytes."""
    counts_back: bool = False
    """Whether a part has taken the remaining bytes except those of the parts after it."""
    is_exact: bool = False
    """Whether the description itself states where the region ends."""
    most: int | None = None
    """The maximum size in bytes, or None."""

    @property
    def is_used_up(self) -> bool:
        return self.is_taken or self.counts_back or self.is_exact


@dataclass(slots=True)
class KsyPart:
    """Segments, and the number of bytes that they take."""

    segments: list[Keys]
    sizes: Sizes = NOTHING


def is_end(attribute: KsyAttribute) -> bool:
    """Return whether an attribute takes no bytes and only states that the stream ends there."""
    size, valid = attribute.keys.get("size"), attribute.keys.get("valid")
    said = valid.value("expr") if isinstance(valid, MappingNode) and len(valid.entries) == 1 else None
    if not isinstance(size, Scalar) or whole(size.text) != 0 or not isinstance(said, Scalar):
        return False
    return said.text.strip() == "_io.eof" and attribute.keys.keys() <= {"id", "size", "valid", "doc"}


def greatest(attribute: KsyAttribute) -> int | None:
    """Return the maximum size of the stream if that is all an attribute states, else None."""
    size, valid = attribute.keys.get("size"), attribute.keys.get("valid")
    said = valid.value("expr") if isinstance(valid, MappingNode) and len(valid.entries) == 1 else None
    if not isinstance(size, Scalar) or whole(size.text) != 0 or not isinstance(said, Scalar):
        return None
    match = _GREATEST.fullmatch(said.text.strip())
    return int(match[1]) if match is not None and attribute.keys.keys() <= {"size", "valid", "doc"} else None


def plain_encoding(written: str) -> str:
    return re.sub(r"[-_ ]", "", written.lower())


def with_keys(attribute: KsyAttribute, **changes: YamlNode | None) -> KsyAttribute:
    """Return an attribute with changed keys; a key with the value None is removed."""
    keys = {key: node for key, node in attribute.keys.items() if key not in changes}
    return KsyAttribute(attribute.at, attribute.name, keys | {k: v for k, v in changes.items() if v is not None})


def without_repeat(attribute: KsyAttribute) -> KsyAttribute:
    """Return an attribute without its condition and repetition."""
    out = {"if", "repeat", "repeat-expr", "repeat-until"}
    keys = {key: node for key, node in attribute.keys.items() if key not in out}
    return KsyAttribute(attribute.at, attribute.name, keys)


class StaticTypes:
    """Compute the sizes of types that need no values; each is computed once."""

    def __init__(self) -> None:
        self._known: dict[KsyType, int | None] = {}
        self._depth = 0

    def of_type(self, type_: KsyType) -> int | None:
        """Return the size of a type in bytes, or None if it varies."""
        if type_ not in self._known:
            self._known[type_] = None  # for a type that contains itself
            self._depth += 1
            if self._depth <= DEEPEST:
                self._known[type_] = self.behind(type_)[-1]
            self._depth -= 1
        return self._known[type_]

    def behind(self, type_: KsyType) -> list[int | None]:
        """Return the number of bytes after each attribute of a type, and finally the size of the whole type."""
        units: list[tuple[int, int | None]] = []  # number of attributes that share bytes, and their size
        bits = 0
        for attribute in type_.seq:
            width = bits_of(attribute, type_)
            if width is None:
                bits = 0
                units.append((1, self.of_attribute(attribute, type_)))
                continue
            number = units.pop()[0] if bits else 0
            bits += width[0]
            units.append((number + 1, -(-bits // 8)))
            bits = 0 if bits % 8 == 0 else bits
        found: list[int | None] = []
        after: int | None = 0
        for number, size in reversed(units):
            found += [after] * number
            after = None if after is None or size is None else after + size
        return [*reversed(found), after]

    def of_attribute(self, attribute: KsyAttribute, type_: KsyType) -> int | None:
        """Return the size of an attribute in bytes, or None if it varies."""
        keys = attribute.keys
        size = keys.get("size")
        number = whole(size.text) if isinstance(size, Scalar) else None
        if number == 0 and "repeat" not in keys:
            return 0
        if "if" in keys or "repeat" in keys:
            return None
        if "contents" in keys:
            try:
                return len(contents_of(keys["contents"]))
            except CannotSayError:
                return None
        if size is not None or "size-eos" in keys or "terminator" in keys:
            return number
        said = keys.get("type")
        text = said.text if isinstance(said, Scalar) else ""
        if (match := NUMBER.fullmatch(text)) is not None:
            return int(match[2])
        if (match := FLOAT.fullmatch(text)) is not None:
            return int(match[1])
        found = type_.find_type(text.partition("(")[0]) if text not in ("", "str", "strz") else None
        return None if found is None else self.of_type(found)


class FileParts(Interface):
    """The file being written, as far as types need it."""

    work: WorkDone
    order: str
    static: StaticTypes

    def tell(self, at: Position, what: str, todo: str, *, warning: bool = False) -> None:
        """Report an omitted part, or as a warning a part that is imported with a difference."""

    def table(self, enum: KsyEnum) -> str:
        """Return the name of the table of an enumeration."""

    def layout(self, type_: KsyType, segments: list[Keys]) -> str:
        """Return the name of the layout with these segments."""

    def letters(self) -> str:
        """Return the name of a parameter that holds the ASCII characters."""


def bits_of(attribute: KsyAttribute, type_: KsyType) -> tuple[int, str] | None:
    """Return the number of bits of an attribute and their order; None for an attribute that is no bit field."""
    said = attribute.keys.get("type")
    match = BITS.fullmatch(said.text) if isinstance(said, Scalar) else None
    if match is None or not 1 <= int(match[1]) <= 64:
        return None
    return int(match[1]), match[2] or type_.bit_endian


def contents_of(node: YamlNode) -> bytes:
    """Return the bytes of `contents`. In a list, texts of digits are bytes too, as in Kaitai.

    Raises CannotSayError.
    """
    if isinstance(node, Scalar) and (node.quoted or whole(node.text) is None):
        try:
            return node.text.encode("utf-8")
        except UnicodeEncodeError:
            raise CannotSayError(node.at, "contents: of half a character", "write its bytes") from None
    data = bytearray()
    for item in node.items if isinstance(node, Sequence) else (node,):
        number = _byte_of(item) if isinstance(item, Scalar) else None
        if number is not None and 0 <= number <= 255:
            data.append(number)
        elif isinstance(item, Scalar) and isinstance(node, Sequence) and number is None:
            data += contents_of(Scalar(item.text, item.at, True))
        else:
            raise CannotSayError(item.at, "contents: of what is no byte and no text", "write numbers up to 255")
    return bytes(data)


def _byte_of(item: Scalar) -> int | None:
    """Return the number of an item of `contents`, or None for a text. Raises CannotSayError."""
    if item.quoted:
        return int(item.text, 0 if "x" in item.text else 10) if _DIGITS_IN_TEXT.fullmatch(item.text) else None
    if item.text.strip()[:2].lower() == "0o":
        raise CannotSayError(item.at, f"contents: {item.text[:20]}, a text in YAML 1.1", "write it in base 10 or 16")
    return whole(one_number(item).text)


def left_of(node: Node) -> int | None:
    """Return N of `_io.size - _io.pos - N`, the remaining bytes except N; None for any other expression."""
    match node:
        case Binary(
            operator="-",
            left=Attribute(value=Name(name="_io"), name="size"),
            right=Attribute(value=Name(name="_io"), name="pos"),
        ):
            return 0
        case Binary(operator="-", left=left, right=Number(value=value)):
            before = left_of(left)
            return None if before is None else before + value
    return None


def left_more(node: Node) -> int | None:
    """Return N of a condition that more than N bytes remain; None for any other condition."""
    match node:
        case Unary(operator="not", operand=Attribute(value=Name(name="_io"), name="eof")):
            return 0
        case Compare(first=first, rest=((">", Number(value=value)),)):
            before = left_of(first)
            return None if before is None else before + value
    return None


def is_built_in(text: str) -> bool:
    """Return whether a type is built into Kaitai."""
    return text in ("str", "strz") or any(one.fullmatch(text) for one in (NUMBER, FLOAT, BITS))
