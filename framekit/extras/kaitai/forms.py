"""Define how values of a type are read in a Kaitai file: the attribute, and the conversion to the value."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from framekit.definition.decimals import SIGNS
from framekit.definition.wire_types import FieldType, Order
from framekit.extras.kaitai.source import string

ENCODING = "ISO-8859-1"
"""Texts of a definition have one byte per character."""
_WIDEST = 8


@dataclass(frozen=True, slots=True)
class KsyForm:
    """The reading of a value."""

    keys: dict[str, Any]
    """The keys of the attribute."""
    kind: str
    """The kind of the value."""
    value: Callable[[str], str] | None = None
    """Writes the value, given the path of the attribute; None if they are equal."""
    takes_size: bool = False
    """Whether a size must be added to the keys."""
    not_said: str = ""
    """How the value differs from the value of the definition; empty if both are equal."""
    more: bytes = b""
    """Further bytes of its end mark."""
    valid: Callable[[str], str] | None = None
    """Writes the condition that the value is encoded correctly."""
    not_looked_at: str = ""
    """The part of the encoding that `valid` does not check; empty for none."""

    @property
    def is_number(self) -> bool:
        return self.kind in ("int", "float")


def form_of(type_: FieldType) -> KsyForm:
    """Return the reading of a type."""
    size = type_.fixed_size
    match type_.kind:
        case "int" if size is not None and size <= _WIDEST:
            return _int(size, type_.signed, type_.order)
        case "float" if type_.order in ("big", "little"):
            return KsyForm({"type": f"f{size}{_endian(type_.order)}"}, "float")
        case "digits" | "hex_int":
            return _digits(type_, size)
        case "decimal":
            return _decimal(type_)
        case "bcd" if size is not None and size <= _WIDEST:
            return KsyForm(
                {"size": size}, "int", lambda path: _bcd(path, size, type_.order),
                valid=lambda path: " and ".join(f"{path}[{at}] < 160 and {path}[{at}] % 16 < 10" for at in range(size)),
            )  # fmt: skip
        case "scaled" if type_.inside is not None and type_.scale is not None:
            return _scaled(type_)
        case "ascii":
            return _text(type_, "str", None)
        case "bytes":
            return KsyForm({}, "bytes", takes_size=True)
        case "fraction" | "hex_float":
            return _text(type_, "str", None, "Kaitai makes no number with a fraction of text: it stays text")
        case "int" | "float" | "bcd":
            return KsyForm({}, "bytes", takes_size=True, not_said="Kaitai has no such number: it stays bytes")
    return KsyForm({}, "bytes", takes_size=True, not_said="a program of its own reads this type: it stays bytes")


def _endian(order: Order) -> str:
    return "le" if order == "little" else "be"


def wide(text: str) -> str:
    """Return a number as 64 bits, since computed numbers have 32 bits in some target languages."""
    return f"{_atom(text)}.as<s8>"


def _signed(text: str, bits: int) -> str:
    return f"({text} >= {1 << bits - 1} ? {text} - {1 << bits} : {text})"


def _places(size: int, order: Order) -> list[int]:
    """Return the offsets of the bytes of a number, most significant first."""
    if order == "little":
        return [*range(size - 1, -1, -1)]
    if order == "BADC":
        return [one ^ 1 for one in range(size)]
    if order == "CDAB":
        return [(size // 2 - 1 - one // 2) * 2 + one % 2 for one in range(size)]
    return [*range(size)]


def _int(size: int, signed: bool, order: Order) -> KsyForm:
    bits = 8 * size
    if order in ("BADC", "CDAB"):
        places = _places(size, order)

        def value(path: str) -> str:
            parts = ((wide(f"{path}[{place}]"), 8 * (size - 1 - at)) for at, place in enumerate(places))
            sum_ = " | ".join(f"({part} << {shift})" for part, shift in parts)
            return _signed(f"({sum_})", bits) if signed else f"({sum_})"

        return KsyForm({"size": size}, "int", value)
    sign = "s" if signed else "u"
    if size == 1:
        return KsyForm({"type": f"{sign}1"}, "int")
    if size in (2, 4, 8):
        return KsyForm({"type": f"{sign}{size}{_endian(order)}"}, "int")
    whole = {"type": f"b{bits}{_endian(order)}"}
    return KsyForm(whole, "int", (lambda path: _signed(path, bits)) if signed else None)


def _digits(type_: FieldType, size: int | None) -> KsyForm:
    def number(path: str) -> str:
        """Return the digits as a number, with the pairs of digits in byte order."""
        base = "" if type_.base == 10 else f"({type_.base})"
        if type_.order == "big" or size is None:
            return f"{path}.to_i{base}"
        pairs = [f"{path}.substring({2 * place}, {2 * place + 2})" for place in _places(size // 2, type_.order)]
        return f"({' + '.join(pairs)}).to_i{base}"

    if type_.order != "big" and (size is None or size % 2):
        return _text(type_, "str", None, "Kaitai turns no digits round of which it does not know how many there are")
    form = _text(type_, "int", number)
    if type_.kind == "hex_int" and size is not None:
        form = replace(form, value=lambda path: _signed(number(path), 4 * size))
    if size is None or size > _MOST_DIGITS:
        return replace(form, not_looked_at=_SIGNS_TOO)
    return replace(form, valid=lambda path: _only_digits(path, size, type_.base))


_MOST_DIGITS = 32
_SIGNS_TOO = "signs, spaces and '_' may stand among the digits"
_DIGITS = {8: (("0", "7"),), 10: (("0", "9"),), 16: (("0", "9"), ("A", "F"), ("a", "f"))}


def _only_digits(path: str, size: int, base: int) -> str:
    def is_digit(at: int) -> str:
        one = f"{path}.substring({at}, {at + 1})"
        rows = " or ".join(f'({one} >= "{low}" and {one} <= "{high}")' for low, high in _DIGITS[base])
        return f"({rows})"

    return " and ".join(map(is_digit, range(size)))


def _decimal(type_: FieldType) -> KsyForm:
    """Return the reading of a whole number as text; the only valid text is formatted again and compared."""
    decimal = type_.form
    assert decimal is not None
    size, is_sized = type_.fixed_size, type_.size is not None
    if is_sized and decimal.fill not in (b"0", b" "):
        return _text(type_, "str", None, "Kaitai does not take away what fills a text up in front")
    form = _text(type_, "int", lambda path: f"{path}.to_i")
    if is_sized and size is None:
        return replace(form, not_looked_at="signs, and what fills it up, may be others")

    def valid(path: str) -> str:
        number = f"{path}.to_i"
        plus = string(SIGNS[decimal.sign].decode("ascii"))
        sign = plus if decimal.sign == "never" else f'({number} < 0 ? "-" : {plus})'
        digits = f"({number} < 0 ? -{number} : {number}).to_s"
        if decimal.digits > 1:
            zeros = f"{string('0' * decimal.digits)}.substring(0, {decimal.digits} - {digits}.length)"
            digits = f"({digits}.length < {decimal.digits} ? {zeros} + {digits} : {digits})"
        if size is None:
            return f"{path} == {sign} + {digits}"
        least = f"{sign}.length + {digits}.length"
        fill = f"{string(decimal.fill.decode('ascii') * size)}.substring(0, {size} - ({least}))"
        parts = (sign, fill, digits) if decimal.fill == b"0" else (fill, sign, digits)
        return f"{least} <= {size} and {path} == {' + '.join(parts)}"

    return replace(form, valid=valid)


def _text(type_: FieldType, kind: str, value: Callable[[str], str] | None, not_said: str = "") -> KsyForm:
    keys: dict[str, Any] = {"type": "str", "encoding": ENCODING}
    more = b""
    if type_.size is not None:
        if type_.pad is not None:
            keys["pad-right"] = type_.pad[0]
        if type_.end is not None:
            keys["terminator"] = type_.end[0]
            if len(type_.end) > 1:
                not_said = not_said or "Kaitai ends a text at one byte: it ends at the first of them"
            elif type_.pad is not None:
                not_said = not_said or "Kaitai does not take away what fills a text up before its end"
    elif type_.end is not None:
        keys["terminator"] = type_.end[0]
        more = type_.end[1:]
    elif len(type_.stops) == 1:
        keys |= {"terminator": type_.stops[0][0], "consume": False}
    not_looked_at = "" if not more else "the first byte of its end ends it even alone, and the frame fails then"
    return KsyForm(keys, kind, value, type_.size is not None, not_said, more, not_looked_at=not_looked_at)


def _bcd(path: str, size: int, order: Order) -> str:
    parts = (
        f"{wide(f'({path}[{place}] >> 4) * 10 + ({path}[{place}] & 15)')} * {100 ** (size - 1 - at)}"
        for at, place in enumerate(_places(size, order))
    )
    return f"({' + '.join(parts)})"


def _atom(text: str) -> str:
    return text if text.isidentifier() else f"({text})"


def _scaled(type_: FieldType) -> KsyForm:
    assert type_.inside is not None and type_.scale is not None
    inside, scale = form_of(type_.inside), type_.scale
    if inside.not_said or inside.kind != "int":
        return inside

    def value(path: str) -> str:
        number = inside.value(path) if inside.value is not None else path
        number = number if scale.factor == 1 and scale.offset == 0 else wide(number)
        number = number if scale.factor == 1 else f"{number} * {scale.factor}"
        number = number if scale.offset == 0 else f"{number} + {scale.offset}"
        return f"({number})" if scale.places == 0 else f"({_atom(number)} / {float(10**scale.places)})"

    kind = "int" if scale.places == 0 else "float"
    return replace(inside, kind=kind, value=value)
