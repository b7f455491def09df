"""Static sizes; field types: the meaning of `type: u16`, `type: hex, size: 4` and the keys that complete them.

The words of `type:` are the rows of `TYPES`, each with its kind of type; the properties of a kind are a row of
`TYPE_KINDS`. The compiler has the code that reads and builds each kind, under the same name.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from decimal import Decimal
from typing import Literal, get_args

from framekit.definition.decimals import DECIMAL_KEYS, SCALE_KEYS, DecimalForm, Scale, load_form, load_scale
from framekit.definition.expression import Expression, whole_and_places
from framekit.definition.keys import BYTE, Form, KeyReading, Meanings, Schema, ValueKind, here, keys, ref, words
from framekit.definition.load.reader import Reader
from framekit.definition.problems import did_you_mean
from framekit.definition.tree import Mapping as Keys
from framekit.definition.tree import Node, Scalar, Sequence


@dataclass(frozen=True, slots=True)
class Sizes:
    """Least and greatest size on the wire (bytes); `most` is None if unbounded."""

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
    """Return the sizes of alternatives."""
    found = list(sizes)
    if not found:
        return NOTHING
    most = [size.most for size in found]
    return Sizes(min(size.least for size in found), None if None in most else max(m for m in most if m is not None))


def of_any_frame(name: str) -> Sizes:
    """Return the sizes of an unknown frame."""
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
"""Largest size of a number (bytes)."""


@dataclass(frozen=True, slots=True)
class FieldType:
    """Form of a value on the wire."""

    kind: str
    size: int | Expression | None
    """Bytes on the wire (digits: characters; bcd: bytes); None for a text or decimal that ends at `end` or before
    `stops`.
    """
    signed: bool = False
    order: Order = "big"
    """Byte order; mid-endian orders exist for integers and floats of 2, 4 and 8 bytes."""
    base: int = 16
    """16, 10 or 8, for digits."""
    upper: bool = True
    """Whether hex digits are capital letters."""
    pad: bytes | None = None
    """Byte that pads a text of type ascii."""
    end: bytes | None = None
    """Bytes that end a text or decimal, and belong to it."""
    stops: tuple[bytes, ...] = ()
    """Bytes before which a text or decimal ends; they belong to the next segment."""
    form: DecimalForm | None = None
    """Form of a decimal."""
    scale: Scale | None = None
    """Scale applied to the number of the type `inside`, which is on the wire."""
    inside: FieldType | None = None

    @property
    def fixed_size(self) -> int | None:
        return self.size if isinstance(self.size, int) else None

    @property
    def is_delimited(self) -> bool:
        """Return whether certain bytes mark its end."""
        return self.size is None and (self.end is not None or bool(self.stops))

    @property
    def before_end(self) -> FieldType:
        """Return the type of the value without its end bytes."""
        inside = None if self.inside is None else self.inside.before_end
        return replace(self, end=None, stops=(), inside=inside)

    @property
    def has_long_stops(self) -> bool:
        """Return whether it ends before a sequence of more than one byte."""
        return any(len(stop) > 1 for stop in self.stops)

    @property
    def sizes(self) -> Sizes:
        if isinstance(self.size, int):
            return exactly(self.size)
        if self.size is not None:
            return ANY
        least = 0 if self.form is None else self.form.least
        return Sizes(least + len(self.end or b""), None)

    @property
    def is_whole_number(self) -> bool:
        return TYPE_KINDS[self.kind].whole

    @property
    def has_fractions(self) -> bool:
        """Return whether its values are numbers that may have a fraction."""
        return self.value_kind == "number" and not self.is_whole_number

    @property
    def float_bits(self) -> int:
        """Return the bits of a floating-point number; 0 for other types."""
        size = self.fixed_size or 0
        return {"float": 8 * size, "hex_float": 4 * size}.get(self.kind, 0)

    def writes(self, value: Decimal) -> bool:
        """Return whether a number with a fraction can be written exactly."""
        number, places = whole_and_places(value)
        if self.scale is not None:
            common = max(places, self.scale.places)
            number *= 10 ** (common - places)
            grown = 10 ** (common - self.scale.places)
            return bool((number - self.scale.offset * grown) % (self.scale.factor * grown) == 0)
        if self.form is None or self.form.decimals is None or self.form.exponent:
            return True
        return bool(number * 10**self.form.decimals % 10**places == 0)

    @property
    def value_kind(self) -> ValueKind:
        return TYPE_KINDS[self.kind].value

    @property
    def contents(self) -> frozenset[int]:
        """Return the bytes that a value may have on the wire."""
        if self.form is not None:
            return self.form.contents | frozenset(self.end or b"")
        if self.inside is not None:
            return self.inside.contents
        return TYPE_KINDS[self.kind].contents - frozenset(stop[0] for stop in self.stops if len(stop) == 1)

    def plain_bytes(self, value: int | str | bytes) -> bytes | None:
        """Return a value as its bytes on the wire; None for types without a plain form."""
        size = self.fixed_size or 0
        if isinstance(value, bytes):
            return value if len(value) == size else None
        if isinstance(value, str):
            return value.encode("latin-1") if self.kind == "ascii" and len(value) == size else None
        if self.kind != "int" or self.order not in ("big", "little"):
            return None
        try:
            return value.to_bytes(size, "little" if self.order == "little" else "big", signed=self.signed)
        except OverflowError:
            return None

    @property
    def bounds(self) -> tuple[int, int] | None:
        """Return the least and greatest number; None for types without whole numbers or with a computed size."""
        size = self.fixed_size
        return TYPE_KINDS[self.kind].bounds(self, size) if self.is_whole_number and size is not None else None


def shown_stops(stops: Iterable[bytes]) -> str:
    """Return alternative end bytes, in words."""
    return " or ".join(stop.hex(" ").upper() for stop in dict.fromkeys(stops))


@dataclass(frozen=True, slots=True)
class TypeKind:
    """A kind of type.

    `value`: kind of its values; `whole`: whole numbers, within `bounds`; `contents`: its possible bytes.
    """

    value: ValueKind
    whole: bool = False
    bounds: Callable[[FieldType, int], tuple[int, int] | None] = lambda type_, size: None
    contents: frozenset[int] = EVERY_BYTE


def bounds_of_bits(bits: int, signed: bool) -> tuple[int, int]:
    """Return the least and the greatest whole number of `bits` bits."""
    return (-(1 << bits - 1), (1 << bits - 1) - 1) if signed else (0, (1 << bits) - 1)


def _bounds_of_bits(type_: FieldType, size: int) -> tuple[int, int]:
    return bounds_of_bits(8 * size, type_.signed)


def _bounds_of_text(type_: FieldType, size: int) -> tuple[int, int]:
    form = type_.form
    assert form is not None
    most = 10 ** (size - (form.sign in ("always", "space"))) - 1
    return (0 if form.sign == "never" else min(0, 1 - 10 ** (size - 1))), most


TYPE_KINDS: dict[str, TypeKind] = {
    "int": TypeKind("number", True, _bounds_of_bits),
    "float": TypeKind("number"),
    "hex_int": TypeKind("number", True, lambda type_, size: _bounds_of_bits(type_, size // 2), DIGITS),
    "hex_float": TypeKind("number", contents=DIGITS),
    "decimal": TypeKind("number", True, _bounds_of_text),
    "fraction": TypeKind("number"),
    "scaled": TypeKind("number"),
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
    """The word of a type with the keys that complete it: `size order case pad end`, and those of decimals."""

    space: Meanings
    keys: Keys
    scalar: Scalar

    @property
    def reader(self) -> Reader:
        return self.space.reader

    def size(self, number: bool = True) -> int | Expression:
        """Return the size. Raises Broken if it is missing, and for a number that is too long."""
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

    def ends(self) -> tuple[bytes | None, tuple[bytes, ...]]:
        """Return the end bytes that belong to the value, and the alternative bytes that belong to the next segment.

        Raises Broken.
        """
        reader, node = self.reader, self.keys.get("end")
        if not isinstance(node, Sequence):
            return reader.maybe(reader.bytes, node), ()
        stops = tuple(dict.fromkeys(reader.bytes(item) for item in reader.items(node)))
        for one in stops:
            for other in stops:
                if 0 < other.find(one, 1) < len(other) - len(one):  # it would end the text within the other
                    what = f"{one.hex(' ').upper()} stands within {other.hex(' ').upper()}, and would end it earlier"
                    raise reader.broken(node.at, what, "leave one of them out")
        return None, stops

    @property
    def upper(self) -> bool:
        """Return whether hex digits are built with capital letters."""
        return (self.reader.maybe(self.reader.text, self.keys.get("case")) or "upper") != "lower"

    def order(self, size: int | Expression) -> Order:
        """Return the byte order given here, or that of the file. Raises Broken."""
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
    def load(given: TypeKeys) -> FieldType:
        node = given.keys.get("as")
        if node is not None and not signed:
            what = "numbers without a sign have a type of their own in hex digits"
            raise given.reader.broken(node.at, what, f"write type: hex, size: {2 * size}")
        if node is not None:
            return _in_hex(given, "hex_int", size)
        return FieldType("int", size, signed=signed, order=given.order(size))

    return load


def _float(size: int) -> LoadType:
    def load(given: TypeKeys) -> FieldType:
        if given.keys.get("as") is not None:
            return _in_hex(given, "hex_float", size)
        return FieldType("float", size, signed=True, order=given.order(size))

    return load


def _in_hex(given: TypeKeys, kind: str, size: int) -> FieldType:
    """Return a number whose bytes are hex digits."""
    return FieldType(kind, 2 * size, signed=True, order=given.order(size), upper=given.upper)


def _any_int(signed: bool) -> LoadType:
    def load(given: TypeKeys) -> FieldType:
        size = given.size()
        return FieldType("int", size, signed=signed, order=given.order(size))

    return load


def _digits(base: int) -> LoadType:
    def load(given: TypeKeys) -> FieldType:
        order = given_order(given.reader, given.keys) or "big"
        return FieldType("digits", given.size(number=False), order=order, base=base, upper=given.upper)

    return load


def _bcd(given: TypeKeys) -> FieldType:
    size = given.size()
    return FieldType("bcd", size, order=given_order(given.reader, given.keys) or "big")


def _ascii(given: TypeKeys) -> FieldType:
    reader, keys_ = given.reader, given.keys
    pad, (end, stops) = reader.maybe(reader.bytes, keys_.get("pad")), given.ends()
    if (end is not None or stops) and keys_.get("size") is None:
        return FieldType("ascii", None, end=end, stops=stops)
    if stops:
        node = keys_.get("end")
        assert node is not None
        what = "a text of this size ends by it, not by a choice of bytes"
        raise reader.broken(node.at, what, "leave size or end out")
    return FieldType("ascii", given.size(number=False), pad=pad, end=end)


def _decimal(given: TypeKeys) -> FieldType:
    """Return the type of a number in decimal text. Raises Broken."""
    reader, node, size_node = given.reader, given.keys.get("end"), given.keys.get("size")
    end, stops = given.ends()
    if size_node is not None and node is not None:
        what = "a decimal has a size, or an end that shows it, not both"
        raise reader.broken(node.at, what, "leave one of them out")
    if size_node is None and node is None:
        what = "nothing says how many characters a decimal has"
        raise reader.broken(given.scalar.at, what, "add size: N, or end: BYTES")
    size = None if size_node is None else given.size()
    form = load_form(reader, given.keys, size)
    held = form.contents & frozenset(one[0] for one in ((end,) if end is not None else stops))
    if held and node is not None:
        what = f"{min(held):02X} may stand in the number itself, and cannot show its end"
        raise reader.broken(node.at, what, "correct end")
    if isinstance(size, int) and size < form.least:
        what = f"the number takes {form.least} characters at least, size says {size}"
        raise reader.broken(given.scalar.at, what, "give a larger size, or fewer decimals")
    kind = "decimal" if form.is_whole else "fraction"
    return FieldType(kind, size, signed=form.sign != "never", end=end, stops=stops, form=form)


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
    "decimal": _decimal,
    "ascii": _ascii,
    "bytes": lambda given: FieldType("bytes", given.size(number=False)),
}


def load_type(space: Meanings, mapping: Keys, type_node: Node | None, *, texts: bool = False) -> FieldType:
    """Return the type named by `type_node`, completed by `size order case pad end` of a mapping. Raises Broken.

    `texts`: the mapping has the keys of decimals.
    """
    scalar = space.reader.scalar(type_node)
    if scalar.text not in TYPES:
        raise space.reader.broken(scalar.at, f"there is no type '{scalar.text}'", did_you_mean(scalar.text, TYPES))
    if scalar.text == "decimal" and not texts:
        raise space.reader.broken(
            scalar.at, "a decimal stands in fields and lists only", "write type: dec, with a size"
        )
    type_ = TYPES[scalar.text](TypeKeys(space, mapping, scalar))
    scale = load_scale(space.reader, mapping) if texts else None
    if scale is None:
        return type_
    if not type_.is_whole_number:
        what = "scale: belongs to whole numbers on the wire"
        raise space.reader.broken(scalar.at, what, "leave scale out, or take another type")
    return replace(type_, kind="scaled", scale=scale, inside=type_)


def load_size(reader: Reader, node: Node) -> Size:
    """Return a number of bytes, `rest`, or an expression. Raises Broken."""
    text = reader.text(node).strip()
    if text == "rest":
        return "rest"
    return reader.bytes_at_most(node) if re.fullmatch(r"\d+|0x[0-9a-fA-F]+", text) else reader.expression(node)


def given_order(reader: Reader, mapping: Keys) -> Order | None:
    """Return the byte order that keys give, or None. Raises Broken."""
    node = mapping.get("order")
    return None if node is None else reader.one_of(node, ORDERS, "a byte order")


# ---- keys of types in other parts ---------------------------------------------------------------------------

SIZE = Form(here("size"), lambda r, node: load_size(r.reader, node))
_BYTES_OR_DIGITS = "Number of bytes, or of digits for hex, dec and oct."
AS_HEX: Schema = {
    **words("a form", "hex"),
    "description": "hex: each byte of a signed number or a float is written as two hex digits.",
}
ENDS: Schema = {
    "description": "Bytes that end a text or decimal and belong to it. With a list, the first that comes "
    "ends it, and belongs to the next segment.",
    "type": ["array", "string", "integer", "number"],
    "items": ref("bytes"),
    "minItems": 1,
    "if": {"type": "array"},
    "else": ref("bytes"),
    "x-expected": "bytes (0D 0A), or a list of them ([2C, 2A] or [0D 0A, 0A])",
}
TEXT_KEYS: Mapping[str, Schema] = {
    "pad": {**BYTE.schema, "description": "Byte that fills a shorter ascii text, or a decimal in front."},
    "as": AS_HEX,
    **DECIMAL_KEYS,
    **SCALE_KEYS,
}
"""The keys of types that only fields and lists have."""


def type_keys(
    name: str, doc: str, *, size: str = _BYTES_OR_DIGITS, case: bool = True, texts: bool = False
) -> FieldType:
    """Declare the attribute of a type: the key with its word, and those that complete it; `texts`: also those of
    decimals.
    """
    schemas: dict[str, Schema] = {
        name: {**ref("type_name"), "description": doc},
        "size": {**here("size"), "description": size},
        "order": here("number_order"),
        **({"case": here("digit_case")} if case else {}),
        **({**TEXT_KEYS, "end": ENDS} if texts else {}),
    }

    def read(reading: KeyReading) -> FieldType:
        return load_type(reading.space, reading.keys, reading.keys.get(name), texts=texts)

    declared: FieldType = keys(schemas, read)
    return declared
