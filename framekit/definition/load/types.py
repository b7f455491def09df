"""Field types: what `type: u16`, `type: hex, size: 4` and their companions mean."""

from __future__ import annotations

import re
from typing import get_args

from framekit.definition.expression.syntax import Expression
from framekit.definition.load.namespace import Namespace
from framekit.definition.load.reader import Reader
from framekit.definition.model.segments import FieldType, Order, Size
from framekit.definition.nodes import Mapping, Node, Scalar
from framekit.definition.problems import did_you_mean

DIGIT_BASES = {"hex": 16, "HEX": 16, "dec": 10, "oct": 8}
ORDERS: dict[str, Order] = {
    "big": "big", "ABCD": "big", "little": "little", "DCBA": "little", "BADC": "BADC", "CDAB": "CDAB",
}  # fmt: skip
TYPES = (
    *(f"{sign}{bits}" for sign in "ui" for bits in (8, 16, 24, 32, 40, 48, 56, 64)),
    "f32", "f64", "uint", "int", *DIGIT_BASES, "bcd", "ascii", "bytes",
)  # fmt: skip

MOST_OF_NUMBER = 256
"""A number has so many bytes at most."""

assert set(ORDERS.values()) == set(get_args(Order))


def load_size(reader: Reader, node: Node) -> Size:
    """A number of bytes, `rest`, or an expression."""
    text = reader.text(node).strip()
    if text == "rest":
        return "rest"
    return reader.bytes_at_most(node) if re.fullmatch(r"\d+|0x[0-9a-fA-F]+", text) else reader.expression(node)


def load_type(space: Namespace, keys: Mapping, type_node: Node | None, *, digits_of: bool = False) -> FieldType:
    """The type named by `type_node`, completed by `size order case pad end` of `keys`. Raises Broken."""
    reader = space.reader
    scalar = reader.scalar(type_node)
    name = scalar.text
    if name not in TYPES:
        raise reader.broken(scalar.at, f"there is no type '{name}'", did_you_mean(name, TYPES))
    if name in DIGIT_BASES:
        return _digits(space, keys, scalar)
    if match := re.fullmatch(r"([ui])(\d+)", name):
        size = int(match[2]) // 8
        return FieldType("int", size, signed=match[1] == "i", order=_order(space, keys, size, scalar))
    if match := re.fullmatch(r"f(\d+)", name):
        size = int(match[1]) // 8
        return FieldType("float", size, signed=True, order=_order(space, keys, size, scalar))
    if name == "ascii":
        return _ascii(space, keys, scalar)
    wanted = _size(reader, keys, scalar)
    if name != "bytes" and isinstance(wanted, int) and wanted > MOST_OF_NUMBER:
        what = f"a number of {wanted} bytes is too long: {MOST_OF_NUMBER} are possible"
        raise reader.broken(scalar.at, what, "use data: for it")
    if name == "bcd":
        return FieldType("bcd", wanted, order=given_order(reader, keys) or "big")
    if name == "bytes":
        return FieldType("bytes", wanted)
    return FieldType("int", wanted, signed=name == "int", order=_order(space, keys, wanted, scalar))


def _size(reader: Reader, keys: Mapping, scalar: Scalar) -> int | Expression:
    node = keys.get("size")
    if node is None:
        raise reader.broken(scalar.at, f"a field of type '{scalar.text}' needs a size", "add size: N")
    size = load_size(reader, node)
    if size == "rest":
        raise reader.broken(node.at, f"a field of type '{scalar.text}' cannot take the rest", "use data: … size: rest")
    if size == 0:
        raise reader.broken(node.at, "a size of 0 holds nothing", "give the number of bytes or digits")
    return size


def given_order(reader: Reader, keys: Mapping) -> Order | None:
    """The byte order that keys say, if they do. Raises Broken."""
    node = keys.get("order")
    return None if node is None else reader.one_of(node, ORDERS, "a byte order")


def _order(space: Namespace, keys: Mapping, size: int | Expression, scalar: Scalar) -> Order:
    order = given_order(space.reader, keys)
    if order is None:
        return ORDERS[space.order(scalar.at.file)]
    if order in ("BADC", "CDAB") and size not in (2, 4, 8):
        at = keys.get("order")
        assert at is not None
        raise space.reader.broken(at.at, f"{order} needs a type of 2, 4 or 8 bytes", "use big or little")
    return order


def _digits(space: Namespace, keys: Mapping, scalar: Scalar) -> FieldType:
    reader = space.reader
    order = given_order(reader, keys) or "big"
    case = reader.maybe(reader.text, keys.get("case")) or "upper"
    return FieldType(
        "digits", _size(reader, keys, scalar), order=order, base=DIGIT_BASES[scalar.text], upper=case != "lower"
    )


def _ascii(space: Namespace, keys: Mapping, scalar: Scalar) -> FieldType:
    reader = space.reader
    pad, end = reader.maybe(reader.bytes, keys.get("pad")), reader.maybe(reader.bytes, keys.get("end"))
    if end is not None and keys.get("size") is None:
        return FieldType("ascii", None, end=end)
    return FieldType("ascii", _size(reader, keys, scalar), pad=pad, end=end)
