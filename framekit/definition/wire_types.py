"""Static sizes; field types: what `type: u16`, `type: hex, size: 4` and their companions mean.

The words that `type:` may have are the rows of `TYPES`, each with the kind of type it makes; what there is of a kind
here is a row of `TYPE_KINDS`. How bytes of a kind are read and built is told to the compiler, by the same name.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Literal, get_args

from framekit.definition.expression import Expression
from framekit.definition.keys import Form, KeyReading, Meanings, Schema, ValueKind, here, keys, ref
from framekit.definition.load.reader import Reader
from framekit.definition.problems import did_you_mean
from framekit.definition.tree import Mapping as Keys
from framekit.definition.tree import Node, Scalar


@dataclass(frozen=True, slots=True)
class Sizes:
    """Least and most bytes on the wire; `most` is None where there is no bound."""

    least: int
    most: int | None

    @property
    def fixed(self) -> int | None:
        return self.least if self.least == self.most else None

    def __add__(self, other: Sizes) -> Sizes:
        most = None if self.most is None or other.most is None else self.most + other.most
        return Sizes(self.least + other.least, most)

    def times(self, least: int, most: int | None) -> Sizes:
        bound = None if self.most is None or most is None else self.most * most
        return Sizes(self.least * least, 0 if self.most == 0 else bound)


NOTHING = Sizes(0, 0)
ANY = Sizes(0, None)


def exactly(size: int) -> Sizes:
    return Sizes(size, size)


def either(sizes: Iterable[Sizes]) -> Sizes:
    """The sizes of one of several possibilities."""
    found = list(sizes)
    if not found:
        return NOTHING
    most = [size.most for size in found]
    return Sizes(min(size.least for size in found), None if None in most else max(m for m in most if m is not None))


def of_any_frame(name: str) -> Sizes:
    """The sizes of a frame where frames are not known."""
    return ANY


Size = int | Expression | Literal["rest"]
"""A number of bytes, an expression for it, or everything up to the end of the region."""

Order = Literal["big", "little", "BADC", "CDAB"]

ORDERS: dict[str, Order] = {
    "big": "big", "ABCD": "big", "little": "little", "DCBA": "little", "BADC": "BADC", "CDAB": "CDAB",
}  # fmt: skip
assert set(ORDERS.values()) == set(get_args(Order))

EVERY_BYTE = frozenset(range(256))
DIGITS = frozenset(b"0123456789ABCDEFabcdef")
MOST_OF_NUMBER = 256
"""A number has so many bytes at most."""


@dataclass(frozen=True, slots=True)
class FieldType:
    """How one value is written on the wire.

    `size` is bytes on the wire (digits: places; bcd: bytes). `base` 16, 10 or 8 and `upper` are for digits, `pad` (one
    byte) and `end` for ascii. Mid-endian orders exist for integers and floats of 2, 4 and 8 bytes.
    """

    kind: str
    size: int | Expression | None
    signed: bool = False
    order: Order = "big"
    base: int = 16
    upper: bool = True
    pad: bytes | None = None
    end: bytes | None = None

    @property
    def fixed_size(self) -> int | None:
        return self.size if isinstance(self.size, int) else None

    @property
    def sizes(self) -> Sizes:
        if isinstance(self.size, int):
            return exactly(self.size)
        return Sizes(len(self.end), None) if self.end is not None and self.size is None else ANY

    @property
    def is_whole_number(self) -> bool:
        return TYPE_KINDS[self.kind].whole

    @property
    def value_kind(self) -> ValueKind:
        return TYPE_KINDS[self.kind].value

    @property
    def contents(self) -> frozenset[int]:
        """The bytes that such a value may have on the wire."""
        return TYPE_KINDS[self.kind].contents

    @property
    def bounds(self) -> tuple[int, int] | None:
        """Least and greatest number; None when it holds no whole numbers or its size is computed."""
        size = self.fixed_size
        return TYPE_KINDS[self.kind].bounds(self, size) if self.is_whole_number and size is not None else None

    @property
    def digit_bits(self) -> int:
        """Bits that one unit of the size holds."""
        return 4 if self.kind == "digits" else 8


@dataclass(frozen=True, slots=True)
class TypeKind:
    """A kind of type. `value`: what its values are; `whole`: whole numbers, from `bounds`; `contents`: its bytes."""

    value: ValueKind
    whole: bool = False
    bounds: Callable[[FieldType, int], tuple[int, int] | None] = lambda type_, size: None
    contents: frozenset[int] = EVERY_BYTE


def _bounds_of_bits(type_: FieldType, size: int) -> tuple[int, int]:
    bits = size * 8
    return (-(1 << bits - 1), (1 << bits - 1) - 1) if type_.signed else (0, (1 << bits) - 1)


TYPE_KINDS: dict[str, TypeKind] = {
    "int": TypeKind("number", True, _bounds_of_bits),
    "float": TypeKind("number"),
    "digits": TypeKind("number", True, lambda type_, size: (0, type_.base**size - 1), DIGITS),
    "bcd": TypeKind(
        "number",
        True,
        lambda type_, size: (0, 100**size - 1),
        frozenset(high << 4 | low for high in range(10) for low in range(10)),
    ),
    "ascii": TypeKind("text"),
    "bytes": TypeKind("bytes"),
}

# ---- how the words are read ---------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class TypeKeys:
    """The word of a type with its companions `size order case pad end`."""

    space: Meanings
    keys: Keys
    scalar: Scalar

    @property
    def reader(self) -> Reader:
        return self.space.reader

    def size(self, number: bool = True) -> int | Expression:
        """What `size` says. Raises Broken where it is missing, and for a number that is too long."""
        reader, node, name = self.reader, self.keys.get("size"), self.scalar.text
        if node is None:
            raise reader.broken(self.scalar.at, f"a field of type '{name}' needs a size", "add size: N")
        size = load_size(reader, node)
        if size == "rest":
            raise reader.broken(node.at, f"a field of type '{name}' cannot take the rest", "use data: … size: rest")
        if size == 0:
            raise reader.broken(node.at, "a size of 0 holds nothing", "give the number of bytes or digits")
        if number and isinstance(size, int) and size > MOST_OF_NUMBER:
            what = f"a number of {size} bytes is too long: {MOST_OF_NUMBER} are possible"
            raise reader.broken(self.scalar.at, what, "use data: for it")
        return size

    def order(self, size: int | Expression) -> Order:
        """The byte order that is said here, or that of the file."""
        order = given_order(self.reader, self.keys)
        if order is None:
            return ORDERS[self.space.order(self.scalar.at.file)]
        if order in ("BADC", "CDAB") and size not in (2, 4, 8):
            at = self.keys.get("order")
            assert at is not None
            raise self.reader.broken(at.at, f"{order} needs a type of 2, 4 or 8 bytes", "use big or little")
        return order


LoadType = Callable[[TypeKeys], FieldType]


def _int(size: int, signed: bool) -> LoadType:
    return lambda given: FieldType("int", size, signed=signed, order=given.order(size))


def _float(size: int) -> LoadType:
    return lambda given: FieldType("float", size, signed=True, order=given.order(size))


def _any_int(signed: bool) -> LoadType:
    def load(given: TypeKeys) -> FieldType:
        size = given.size()
        return FieldType("int", size, signed=signed, order=given.order(size))

    return load


def _digits(base: int) -> LoadType:
    def load(given: TypeKeys) -> FieldType:
        reader = given.reader
        order = given_order(reader, given.keys) or "big"
        case = reader.maybe(reader.text, given.keys.get("case")) or "upper"
        return FieldType("digits", given.size(number=False), order=order, base=base, upper=case != "lower")

    return load


def _bcd(given: TypeKeys) -> FieldType:
    size = given.size()
    return FieldType("bcd", size, order=given_order(given.reader, given.keys) or "big")


def _ascii(given: TypeKeys) -> FieldType:
    reader, keys_ = given.reader, given.keys
    pad, end = reader.maybe(reader.bytes, keys_.get("pad")), reader.maybe(reader.bytes, keys_.get("end"))
    if end is not None and keys_.get("size") is None:
        return FieldType("ascii", None, end=end)
    return FieldType("ascii", given.size(number=False), pad=pad, end=end)


TYPES: dict[str, LoadType] = {
    **{f"{sign}{bits}": _int(bits // 8, sign == "i") for sign in "ui" for bits in (8, 16, 24, 32, 40, 48, 56, 64)},
    "f32": _float(4),
    "f64": _float(8),
    "uint": _any_int(False),
    "int": _any_int(True),
    "hex": _digits(16),
    "HEX": _digits(16),
    "dec": _digits(10),
    "oct": _digits(8),
    "bcd": _bcd,
    "ascii": _ascii,
    "bytes": lambda given: FieldType("bytes", given.size(number=False)),
}


def load_type(space: Meanings, mapping: Keys, type_node: Node | None) -> FieldType:
    """The type named by `type_node`, completed by `size order case pad end` of a mapping. Raises Broken."""
    scalar = space.reader.scalar(type_node)
    if scalar.text not in TYPES:
        raise space.reader.broken(scalar.at, f"there is no type '{scalar.text}'", did_you_mean(scalar.text, TYPES))
    return TYPES[scalar.text](TypeKeys(space, mapping, scalar))


def load_size(reader: Reader, node: Node) -> Size:
    """A number of bytes, `rest`, or an expression."""
    text = reader.text(node).strip()
    if text == "rest":
        return "rest"
    return reader.bytes_at_most(node) if re.fullmatch(r"\d+|0x[0-9a-fA-F]+", text) else reader.expression(node)


def given_order(reader: Reader, mapping: Keys) -> Order | None:
    """The byte order that keys say, if they do. Raises Broken."""
    node = mapping.get("order")
    return None if node is None else reader.one_of(node, ORDERS, "a byte order")


# ---- keys of types in other parts ---------------------------------------------------------------------------

SIZE = Form(here("size"), lambda r, node: load_size(r.reader, node))
_BYTES_OR_DIGITS = "Number of bytes, or of digits for hex, dec and oct."


def type_keys(
    name: str, doc: str, *, size: str = _BYTES_OR_DIGITS, case: bool = True, more: Mapping[str, Schema] | None = None
) -> FieldType:
    """The attribute of a type: the key with its word, and those that complete it."""
    schemas: dict[str, Schema] = {
        name: {**ref("type_name"), "description": doc},
        "size": {**here("size"), "description": size},
        "order": here("number_order"),
        **({"case": here("digit_case")} if case else {}),
        **(more or {}),
    }

    def read(reading: KeyReading) -> FieldType:
        return load_type(reading.space, reading.keys, reading.keys.get(name))

    declared: FieldType = keys(schemas, read)
    return declared
