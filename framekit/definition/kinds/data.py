"""`data`: bytes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal

from framekit.definition.expression import Expression
from framekit.definition.expression import Node as ExpressionNode
from framekit.definition.keys import ADDRESS, BYTE, IDENTIFIER, NUMBER, Form, KeyReading, ValueKind, key, ref, words
from framekit.definition.kinds.base import Contents, Segment, constant_number
from framekit.definition.problems import Position, Problem
from framekit.definition.tree import Node
from framekit.definition.wire_types import DIGITS, EVERY_BYTE, SIZE, Size, Sizes, exactly


def _conversion(reading: KeyReading, node: Node) -> Literal["hex_to_ascii", "ascii_to_hex"] | None:
    """Return the conversion from memory to the wire, for either way in which a definition names it. Raises Broken."""
    reader, side = reading.reader, reading.loader.side
    name = reader.text(node)
    if name not in ("hex_to_ascii", "ascii_to_hex"):
        return None
    if not reading.space.turns_conversions(node.at.file):
        return "hex_to_ascii" if name == "hex_to_ascii" else "ascii_to_hex"
    if side not in ("client", "server"):
        what = "conversions are named by the direction of the frame, and this has none"
        todo = "say from: client or server in its group, or leave conversions: out"
        raise reader.broken(node.at, what, todo)
    to_digits = (name == "hex_to_ascii") == (side == "client")
    return "hex_to_ascii" if to_digits else "ascii_to_hex"


def _swap(reading: KeyReading, node: Node) -> int:
    reader = reading.reader
    swap = reader.number(node)
    if swap not in (0, 2, 4, 8):
        raise reader.broken(reading.keys.at, f"a swap of {swap} bytes does not exist", "use 2, 4 or 8")
    size, at = reading.found["size"], reading.keys.get("size")
    if swap and isinstance(size, int) and size % swap and at is not None:
        reader.warn(at.at, f"{size} bytes are not full units of {swap}", "the rest stays as it is")
    return swap


def _bytes(reading: KeyReading, node: Node) -> bytes:
    found = b"".join(reading.reader.bytes(item) for item in reading.reader.items(node))
    return bytes(sorted({*found}))


REQUEST = "request"
"""The name of the frame that a frame answers, in `shows:`."""


@dataclass(frozen=True, slots=True)
class ShownAs:
    """The layout that displays read bytes as, chosen by a number."""

    by: ExpressionNode
    """Computes the number from values of the frame, and from those of `request`, the frame that it answers."""
    layouts: Mapping[int, LayoutName]


@dataclass(frozen=True, slots=True)
class LayoutName:
    """The name of a layout, with its place in the file."""

    layout: str
    at: Position


def _shows(reading: KeyReading, node: Node) -> ShownAs:
    reader, entries = reading.reader, reading.reader.mapping(node).read_all()
    if len(entries) != 1:
        raise reader.broken(node.at, "this is not one expression with layouts", "write {EXPR: {NUMBER: LAYOUT}}")
    by = reader.expression_text(entries[0].key.text, entries[0].key.at)
    layouts: dict[int, LayoutName] = {}
    for entry in reader.entries(entries[0].value):
        with reader.going_on():
            layouts[reader.number(entry.key)] = LayoutName(reader.text(entry.value), entry.value.at)
    return ShownAs(by.root, layouts)


SHOWS = Form(
    {
        "type": "object",
        "additionalProperties": {"type": "object", "additionalProperties": ref("label")},
        "maxProperties": 1,
        "x-expected": "a value with layouts ({kind: {1: LAYOUT}})",
    },
    _shows,
)
NEVER = Form(
    {
        "type": ["array", "string", "integer", "number"],
        "items": BYTE.schema,
        "minItems": 1,
        "x-expected": "bytes ([7E, 7D])",
    },
    _bytes,
)
CONVERSION = Form(words("a conversion", "hex_to_ascii", "ascii_to_hex"), _conversion)
SWAP = Form(words("a swap", "2", "4", "8", 2, 4, 8), _swap)


@dataclass(frozen=True, slots=True, kw_only=True)
class Data(Segment):
    """Bytes. `size` counts them in memory, before conversion; `pad` fills shorter data; `least` is the least number."""

    KEY: ClassVar[str] = "data"
    HINTS: ClassVar[Mapping[str, str]] = {
        "inside": "write inside: beside body: of the frame, and never: here for the byte that they begin with"
    }
    VALUE: ClassVar[ValueKind | None] = "bytes"

    name: str = key("data", IDENTIFIER, "Name of the bytes.")
    size: Size = key("size", SIZE, "Number of bytes in memory; an expression; or rest, up to the end of the region.")
    swap: int = key(
        "swap", SWAP, "Bytes that are turned round together, before conversion when sending: 2, 4 or 8.", default=0
    )
    convert: Literal["hex_to_ascii", "ascii_to_hex"] | None = key(
        "convert",
        CONVERSION,
        "hex_to_ascii: a byte in memory is two digits on the wire; ascii_to_hex: the reverse.",
        default=None,
    )
    pad: int | None = key("pad", BYTE, "Byte that fills shorter data.", default=None)
    least: int = key("min", NUMBER, "Least number of bytes.", default=0)
    never: bytes = key(
        "never", NEVER, "Bytes that the data never contain: a constant of these bytes may end it.", default=b""
    )
    memory: str | None = key(
        "memory", ADDRESS, "Default address of the bytes for SEND and RECEIVE blocks.", default=None
    )

    shows: ShownAs | None = key(
        "shows",
        SHOWS,
        "EXPR: {NUMBER: LAYOUT}: displays read the bytes as this layout where the expression is the number.",
        default=None,
    )

    def on_wire(self, size: int) -> int:
        """Return the size on the wire of `size` bytes in memory."""
        return size * 2 if self.convert == "hex_to_ascii" else size // 2 if self.convert == "ascii_to_hex" else size

    def sizes(self, of_frame: Callable[[str], Sizes]) -> Sizes:
        if isinstance(self.size, int):
            return exactly(self.on_wire(self.size))
        return Sizes(self.on_wire(self.least), None)

    def contents(self, of_frame: Contents) -> frozenset[int]:
        return DIGITS if self.convert == "hex_to_ascii" else EVERY_BYTE - {*self.never}

    @property
    def takes_rest(self) -> bool:
        return self.size == "rest"

    @property
    def wanted_names(self) -> tuple[str, ...]:
        return (self.name,) if self.pad is None else ()

    @property
    def may_be_given(self) -> bool:
        return True

    def check(self) -> Iterator[Problem]:
        if self.never and self.convert is not None:
            what = f"never says what stands on the wire, and '{self.name}' is converted"
            yield Problem(self.at, what, "leave never or convert out")
        if self.pad is not None and self.pad in self.never:
            yield Problem(
                self.at, f"'{self.name}' is filled up with {self.pad:02X}, which never stands in it", "correct pad"
            )
        number = constant_number(self.size) if isinstance(self.size, Expression) else None
        if number is not None and number < 0:
            yield Problem(self.at, f"a size of {number} bytes cannot be", "give 0 or more, rest, or an expression")
        if isinstance(self.size, int):
            if self.least > self.size:
                what = f"'{self.name}' has {self.size} bytes and wants at least {self.least}"
                yield Problem(self.at, what, "leave min out")
            if self.convert == "ascii_to_hex" and self.size % 2:
                what = f"'{self.name}' has {self.size} digits in memory, two of them make one byte"
                yield Problem(self.at, what, "give an even size")
        elif self.size == "rest" and self.pad is not None:
            what = f"'{self.name}' takes the rest: nothing is filled up"
            yield Problem(self.at, what, "leave pad out, or give a size")
