"""Numbers written as decimal text: with a sign, digits after a point, an exponent, and padding.

Each number has a single text, so that building gives the bytes that were read; any other text is refused.
`codec/support.py` reads and builds the text.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Decimal

from framekit.definition.expression import whole_and_places
from framekit.definition.keys import Schema, words
from framekit.definition.load.reader import Reader
from framekit.definition.tree import Mapping as Keys
from framekit.definition.tree import Node

SIGNS: Mapping[str, bytes] = {"minus": b"", "always": b"+", "space": b" ", "never": b""}
"""Sign of a number that is not negative."""
POINTS = {"decimals": False, "always": True}
"""Whether a point is written without a digit after it."""
_MOST_DIGITS = 200
_MOST_EXPONENT = 4


@dataclass(frozen=True, slots=True)
class DecimalForm:
    """Form of a decimal number."""

    decimals: int | None = 0
    """Digits after the point; None: as many as the value has."""
    sign: str = "minus"
    digits: int = 1
    """Least number of digits before the point."""
    fill: bytes = b"0"
    """Byte that pads a text of fixed size; zeros are inserted after the sign."""
    exponent: int = 0
    """Digits of the exponent, which is then always written, after a single digit before the point; 0: no exponent."""
    empty: bool = False
    """Whether an empty text means a missing value."""
    point: bool = False
    """Whether a point is written without digits after it."""

    @property
    def is_whole(self) -> bool:
        return self.decimals == 0 and not self.exponent and not self.empty and not self.point

    @property
    def least(self) -> int:
        """Return the number of characters of the shortest number."""
        if self.empty:
            return 0
        fraction = self.decimals + 1 if self.decimals else int(self.point)
        signs = self.sign in ("always", "space")
        return signs + max(self.digits, 0 if self.decimals else 1) + fraction + (self.exponent and self.exponent + 2)

    @property
    def contents(self) -> frozenset[int]:
        """Return the bytes that may occur in a number."""
        found = b"0123456789" + self.fill + SIGNS[self.sign]
        found += b"" if self.sign == "never" else b"-"
        found += b"." if self.point or self.decimals != 0 else b""
        return frozenset(found + (b"E+-" if self.exponent else b""))

    @property
    def arguments(self) -> tuple[int | str | bytes | None, ...]:
        """Return the arguments of the functions that read and build the number."""
        return self.decimals, self.sign, self.digits, self.fill, self.exponent, self.point


@dataclass(frozen=True, slots=True)
class Scale:
    """Linear scaling: value = number on the wire × `factor` + `offset`, both in units of 10 to the power of
    -`places`.
    """

    factor: int
    offset: int
    places: int

    @property
    def arguments(self) -> tuple[int, int, int]:
        """Return the arguments of the functions that scale."""
        return self.factor, self.offset, self.places


_NUMBER: Schema = {
    "type": ["string", "integer", "number"],
    "pattern": "^\\s*-?[0-9]{1,20}(\\.[0-9]{1,20})?\\s*$",
    "x-expected": "a number (0.1 or -40)",
}
SCALE_KEYS: Mapping[str, Schema] = {
    "scale": {**_NUMBER, "description": "The value is the whole number on the wire times this, exactly."},
    "offset": {**_NUMBER, "description": "With scale: the value is so much more."},
}
DECIMAL_KEYS: Mapping[str, Schema] = {
    "decimals": {
        "description": "Digits after the point of a decimal; any: as many as the value has; default 0, no point.",
        "type": ["string", "integer"],
        "pattern": "^(any|[0-9]+)$",
        "x-expected": "a number of digits, or any",
    },
    "point": {
        **words("a point", *POINTS),
        "description": "Whether a point may have no digit after it (16.): decimals (the default: never), always.",
    },
    "sign": {
        **words("a sign", *SIGNS),
        "description": "Sign of a decimal: minus where it is negative (the default), always, space instead of a plus, "
        "never.",
    },
    "digits": {
        "description": "Digits before the point of a decimal at least, with zeros in front; default 1.",
        "type": ["string", "integer"],
        "pattern": "^[0-9]+$",
        "x-expected": "a number of digits",
    },
    "exponent": {
        "description": "Digits of the exponent of a decimal: with 2, 1.5 is 1.5E+00.",
        "type": ["string", "integer"],
        "pattern": "^[0-9]+$",
        "x-expected": "a number of digits",
    },
    "empty": {
        "$ref": "common.schema.json#/$defs/flag",
        "description": "yes: a decimal of no characters is nothing.",
    },
}
"""The keys of `type: decimal`, in addition to those of every type."""


def load_form(reader: Reader, keys: Keys, size: object) -> DecimalForm:
    """Return the form from the keys of a decimal.

    `size`: its size, or None if an end byte delimits it. Raises Broken.
    """
    decimals_node = keys.get("decimals")
    has_any = decimals_node is not None and reader.text(decimals_node).strip() == "any"
    decimals = None if has_any else _digits(reader, decimals_node, 0)
    point_node, sign_node = keys.get("point"), keys.get("sign")
    point = point_node is not None and reader.one_of(point_node, POINTS, "a point")
    if point_node is not None and decimals:
        what = f"{decimals} digits always stand behind the point, point: has no effect"
        raise reader.broken(point_node.at, what, "leave point out")
    sign = "minus" if sign_node is None else reader.one_of(sign_node, {one: one for one in SIGNS}, "a sign")
    exponent = _exponent(reader, keys.get("exponent"), decimals)
    fill = _fill(reader, keys.get("pad"), size)
    digits = _leading_digits(reader, keys, size, fill)
    node = keys.get("empty")
    empty = node is not None and reader.flag(node)
    if node is not None and size is not None:
        what = "empty: belongs to a number that its end shows, this one has a size"
        raise reader.broken(node.at, what, "leave empty out, or write end: instead of size:")
    return DecimalForm(decimals, sign, digits, fill, exponent, empty, point)


def _exponent(reader: Reader, node: Node | None, decimals: int | None) -> int:
    """Return the number of digits of the exponent; 0: the number has none. Raises Broken."""
    exponent = _digits(reader, node, 0)
    if node is not None and not 1 <= exponent <= _MOST_EXPONENT:
        raise reader.broken(node.at, f"an exponent has 1 to {_MOST_EXPONENT} digits", "correct it")
    if node is not None and decimals is None:
        what = "decimals: any has no exponent: nothing would say where the point stands"
        raise reader.broken(node.at, what, "write decimals: N")
    return exponent


def _fill(reader: Reader, node: Node | None, size: object) -> bytes:
    """Return the byte that fills the size up. Raises Broken."""
    fill = b"0" if node is None or size is None else bytes((reader.byte(node),))
    if node is not None and size is None:
        raise reader.broken(node.at, "pad: fills a size up, and this number has none", "write digits: N, or a size")
    if node is not None and fill != b"0" and fill in b"123456789+-.E":
        what = f"{fill.hex().upper()} may stand in the number itself"
        raise reader.broken(node.at, what, "fill it up with 20 (spaces) or 30 (zeros)")
    return fill


def _leading_digits(reader: Reader, keys: Keys, size: object, fill: bytes) -> int:
    """Return the least number of digits before the point. Raises Broken where another key decides it."""
    node = keys.get("digits")
    if node is None:
        return 1
    digits = _digits(reader, node, 1)
    if size is not None and fill == b"0":
        what = "the size is filled up with zeros, digits: has no effect"
        raise reader.broken(node.at, what, "leave digits out, or write pad: 20")
    if keys.get("exponent") is not None:
        what = "one digit stands before the point of a number with an exponent"
        raise reader.broken(node.at, what, "leave digits out")
    return digits


def _digits(reader: Reader, node: Node | None, otherwise: int) -> int:
    """Return a number of digits. Raises Broken if it is too large."""
    number = otherwise if node is None else reader.number(node)
    if node is not None and not 0 <= number <= _MOST_DIGITS:
        raise reader.broken(node.at, f"0 to {_MOST_DIGITS} digits are possible", "correct the number")
    return number


def load_scale(reader: Reader, keys: Keys) -> Scale | None:
    """Return the scale from the keys `scale` and `offset`; None without them. Raises Broken."""
    scale_node, offset_node = keys.get("scale"), keys.get("offset")
    if scale_node is None:
        if offset_node is not None:
            what = "offset: goes with scale:"
            todo = (
                f"write plus: {-Decimal(_number(reader, offset_node))}: the number on the wire is the value plus this"
            )
            raise reader.broken(offset_node.at, what, todo)
        return None
    factor = _number(reader, scale_node)
    offset = Decimal(0) if offset_node is None else _number(reader, offset_node)
    if not factor:
        raise reader.broken(scale_node.at, "a scale of 0 leaves nothing of the number", "correct it")
    pairs = [whole_and_places(one) for one in (factor, offset)]
    places = max(digits for _, digits in pairs)
    times, more = (whole * 10 ** (places - digits) for whole, digits in pairs)
    return Scale(times, more, places)


def _number(reader: Reader, node: Node) -> Decimal:
    """Return a number with a decimal point. Raises Broken."""
    text = reader.text(node).strip()
    if not re.fullmatch(r"-?[0-9]{1,20}(\.[0-9]{1,20})?", text):
        raise reader.broken(node.at, f"'{text}' is not a number", "write one such as 0.1 or -40")
    return Decimal(text)
