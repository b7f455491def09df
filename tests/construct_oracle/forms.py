"""Wire forms of single values: construct objects for the field types, built from the library's own classes.

A form reads exactly its bytes and returns a number, a text or bytes; it does not know the meaning of the value.
"""

from __future__ import annotations

from dataclasses import replace
from decimal import Decimal, localcontext
from fractions import Fraction
from functools import lru_cache
from typing import Any

import construct
from construct import (
    Adapter,
    Bytes,
    BytesInteger,
    Construct,
    GreedyBytes,
    Transformed,
    stream_read,
    stream_write,
)  # fmt: skip

from framekit.codec import support
from framekit.definition.decimals import DecimalForm, Scale
from framekit.definition.model.segments import FieldType, Order

_FLOATS = {2: construct.Float16b, 4: construct.Float32b, 8: construct.Float64b}
_DIGITS = {
    (16, True): (support.build_hex, support.parse_hex),
    (10, True): (support.build_dec, support.parse_dec),
    (8, True): (support.build_oct, support.parse_oct),
    (16, False): (support.build_hex_little, support.parse_hex_little),
    (10, False): (lambda *number: support.build_dec(*number)[::-1], lambda digits: support.parse_dec(digits[::-1])),
    (8, False): (lambda *number: support.build_oct(*number)[::-1], lambda digits: support.parse_oct(digits[::-1])),
}


class FormError(construct.ConstructError):
    """Bytes that are not a valid number or text, or a value without such a form."""


class Digits(Adapter):
    """A number in ASCII digits of base 16, 10 or 8.

    Parses digits of either case into an `int`; builds exactly this number of places. Raises FormError for other
    characters, negative numbers and numbers with too many digits.
    """

    def __init__(self, places: int, base: int, order: Order, upper: bool) -> None:
        super().__init__(Bytes(places))
        self.places = places
        self.upper = upper
        self.to_digits, self.to_number = _DIGITS[base, order != "little"]

    def _decode(self, obj: bytes, context: Any, path: str) -> int:
        try:
            return self.to_number(obj)
        except ValueError as error:
            raise FormError(str(error), path) from None

    def _encode(self, obj: int, context: Any, path: str) -> bytes:
        try:
            digits = self.to_digits(obj, self.places)
        except ValueError as error:
            raise FormError(str(error), path) from None
        return digits if self.upper else digits.lower()


class Bcd(Adapter):
    """A number with two decimal digits per byte.

    Parses into an `int`, builds `size` bytes. Raises FormError for half bytes above 9 and for numbers that do not fit.
    """

    def __init__(self, size: int, order: Order) -> None:
        super().__init__(Bytes(size))
        self.size = size
        self.little = order == "little"

    def _decode(self, obj: bytes, context: Any, path: str) -> int:
        try:
            return support.parse_bcd(obj[::-1] if self.little else obj)
        except ValueError as error:
            raise FormError(str(error), path) from None

    def _encode(self, obj: int, context: Any, path: str) -> bytes:
        try:
            data = support.build_bcd(obj, self.size)
        except ValueError as error:
            raise FormError(str(error), path) from None
        return data[::-1] if self.little else data


class Text(Adapter):
    """Latin-1 text in `size` bytes, up to `end` if given, without the `pad` bytes after it.

    Builds exactly `size` bytes, filled up with `pad` (with 00 after an `end`). Raises FormError for text that is too
    long, not Latin-1, or too short without `pad` or `end`.
    """

    def __init__(self, size: int, pad: bytes | None, end: bytes | None) -> None:
        super().__init__(Bytes(size))
        self.size = size
        self.pad = pad
        self.end = end

    def _decode(self, obj: bytes, context: Any, path: str) -> str:
        data = obj if self.end is None else obj.split(self.end, 1)[0]
        return (data.rstrip(self.pad) if self.pad else data).decode("latin-1")

    def _encode(self, obj: str, context: Any, path: str) -> bytes:
        filled = self.pad if self.end is None else self.pad or b"\0"
        try:
            data = obj.encode("latin-1")
        except UnicodeError:
            raise FormError(f"{obj!r} has characters that are no bytes", path) from None
        if len(data) > self.size or (filled is None and len(data) < self.size):
            raise FormError(f"{obj!r} does not fit into {self.size} characters", path)
        return data if filled is None else data.ljust(self.size, filled)


class StoppedText(Adapter):
    """Latin-1 text up to a stop byte, which is not read with it. Raises FormError if the text contains a stop byte."""

    def __init__(self, stops: tuple[bytes, ...]) -> None:
        super().__init__(GreedyBytes)
        self.stops = stops

    def _decode(self, obj: bytes, context: Any, path: str) -> str:
        return obj.decode("latin-1")

    def _encode(self, obj: str, context: Any, path: str) -> bytes:
        try:
            data = obj.encode("latin-1")
        except UnicodeError:
            raise FormError(f"{obj!r} has characters that are no bytes", path) from None
        if any(stop in data for stop in self.stops):
            raise FormError(f"{obj!r} holds what ends it", path)
        return data


class DecimalText(Adapter):
    """A number in decimal text, as `decimal.Decimal` formats it, with `size` characters or up to its end.

    Parses only texts that it would build itself: into an `int` if the number is whole, else into a `Decimal`. Raises
    FormError for all other texts, and for numbers that the text cannot represent exactly.
    """

    def __init__(self, size: int | None, form: DecimalForm, end: bytes | None) -> None:
        super().__init__(GreedyBytes if size is None else Bytes(size))
        self.size = size
        self.form = form
        self.end = end or b""

    def _decode(self, obj: bytes, context: Any, path: str) -> Any:
        obj = obj.removesuffix(self.end)
        if not obj and self.form.empty:
            return None
        try:
            text = obj.decode("ascii")
            number = Decimal(text.strip(self.form.fill.decode("latin-1") if self.form.fill != b"0" else " "))
        except (ArithmeticError, UnicodeError):
            raise FormError(f"{obj!r} is no number", path) from None
        if not number.is_finite():
            raise FormError(f"{obj!r} is no number", path)
        value = int(number) if self.form.is_whole and number == number.to_integral_value() else number
        if self._text(value, path) != obj:
            raise FormError(f"{obj!r} is written otherwise", path)
        return value

    def _encode(self, obj: Any, context: Any, path: str) -> bytes:
        return (b"" if obj is None else self._text(obj, path)) + self.end

    def _text(self, obj: Any, path: str) -> bytes:
        form = self.form
        number = Decimal(obj)
        if abs(number.adjusted()) > 900:
            raise FormError(f"{obj} is too large", path)
        with localcontext() as exact:
            exact.prec = 3000
            body = self._digits(number, form, path)
        negative = number.is_signed() and not (isinstance(obj, int) and not obj)
        if negative and form.sign == "never":
            raise FormError(f"{obj} has a sign", path)
        sign = "-" if negative else {"always": "+", "space": " "}.get(form.sign, "")
        if self.size is None:
            if len(sign + body) > 256:
                raise FormError(f"{obj} is too long", path)
            return (sign + body).encode()
        room = self.size - len(sign + body)
        if room < 0:
            raise FormError(f"{obj} does not fit into {self.size} characters", path)
        if form.fill == b"0":
            return (sign + "0" * room + body).encode()
        return form.fill * room + (sign + body).encode()

    @staticmethod
    def _digits(number: Decimal, form: DecimalForm, path: str) -> str:
        size = abs(number)
        if form.exponent:
            bare = "." if form.point and not form.decimals else ""
            mantissa, _, place = f"{size:.{form.decimals}E}".partition("E")
            power = int(place) if size else 0
            mantissa = mantissa if size else f"{Decimal(0):.{form.decimals}f}"
            if Decimal(f"{mantissa}E{power}") != size or len(str(abs(power))) > form.exponent:
                raise FormError(f"{number} has too many digits", path)
            return f"{mantissa}{bare}E{'-' if power < 0 else '+'}{abs(power):0{form.exponent}}"
        decimals = max(-number.as_tuple().exponent, 0) if form.decimals is None else form.decimals
        body = f"{size:.{decimals}f}"
        if Decimal(body) != size:
            raise FormError(f"{number} has too many decimals", path)
        front, point, behind = body.partition(".")
        text = front.lstrip("0").rjust(form.digits, "0") if point else front.rjust(form.digits, "0")
        return text + (point or ("." if form.point else "")) + behind


class UpTo(Construct):
    """Bytes up to `end` at any offset (`NullTerminated` examines only multiples of its size)."""

    def __init__(self, end: bytes) -> None:
        super().__init__()
        self.end = end

    def _parse(self, stream: Any, context: Any, path: str) -> bytes:
        found = b""
        while not found.endswith(self.end):
            found += stream_read(stream, 1, path)
        return found[: -len(self.end)]

    def _build(self, obj: bytes, stream: Any, context: Any, path: str) -> bytes:
        stream_write(stream, obj + self.end, len(obj) + len(self.end), path)
        return obj


class TerminatedText(Adapter):
    """Latin-1 text up to the bytes `end`, which are read, too.

    Builds both; raises FormError if the text contains `end`.
    """

    def __init__(self, end: bytes) -> None:
        super().__init__(UpTo(end))
        self.end = end

    def _decode(self, obj: bytes, context: Any, path: str) -> str:
        return obj.decode("latin-1")

    def _encode(self, obj: str, context: Any, path: str) -> bytes:
        try:
            return support.build_terminated(obj, self.end)[: -len(self.end)]
        except UnicodeError:
            raise FormError(f"{obj!r} has characters that are no bytes", path) from None
        except ValueError as error:
            raise FormError(str(error), path) from None


class Scaled(Adapter):
    """A number times a scale plus an offset: a `Decimal`. Raises FormError for values that no number gives."""

    def __init__(self, inside: Construct, scale: Scale, bounds: tuple[int, int] | None) -> None:
        super().__init__(inside)
        self.factor, self.offset = (Fraction(number, 10**scale.places) for number in (scale.factor, scale.offset))
        self.places = scale.places
        self.bounds = bounds

    def _decode(self, obj: int, context: Any, path: str) -> Decimal:
        with localcontext() as exact:
            exact.prec = 400
            value = obj * self.factor + self.offset
            return Decimal(value.numerator * 10**self.places // value.denominator).scaleb(-self.places)

    def _encode(self, obj: Any, context: Any, path: str) -> int:
        wire = (Fraction(obj) - self.offset) / self.factor
        if wire.denominator != 1 or (self.bounds is not None and not self.bounds[0] <= wire <= self.bounds[1]):
            raise FormError(f"{obj} stands for no number", path)
        return int(wire)


class HexText(Adapter):
    """The bytes of another form as two hex digits each. Raises FormError for other characters."""

    def __init__(self, inside: Construct, size: int, upper: bool) -> None:
        super().__init__(Bytes(size))
        self.inside = inside
        self.upper = upper

    def _decode(self, obj: bytes, context: Any, path: str) -> Any:
        if obj.strip(b"0123456789ABCDEFabcdef"):
            raise FormError(f"{obj!r} are no hex digits", path)
        return self.inside.parse(bytes.fromhex(obj.decode("ascii")))

    def _encode(self, obj: Any, context: Any, path: str) -> bytes:
        digits = self.inside.build(obj).hex()
        return (digits.upper() if self.upper else digits).encode()


class NoDigits(Adapter):
    """A number of no bytes, which a computed size may require: parses as 0. Raises FormError for other numbers."""

    def __init__(self) -> None:
        super().__init__(Bytes(0))

    def _decode(self, obj: bytes, context: Any, path: str) -> int:
        return 0

    def _encode(self, obj: int, context: Any, path: str) -> bytes:
        if obj:
            raise FormError(f"{obj} does not fit into 0 bytes", path)
        return b""


@lru_cache(maxsize=1024)
def form_of(type_: FieldType, size: int) -> Construct:
    """Return the form of `type_` in `size` bytes (for digits: places). Text with an `end` takes the bytes up to it."""
    match type_.kind:
        case "int":
            return _ordered(BytesInteger(size, signed=type_.signed), size, type_.order) if size else NoDigits()
        case "float":
            return _ordered(_FLOATS[size], size, type_.order)
        case "digits":
            return Digits(size, type_.base, type_.order, type_.upper)
        case "bcd":
            return Bcd(size, type_.order)
        case "hex_int" | "hex_float":
            inside = replace(type_, kind=type_.kind.removeprefix("hex_"), size=size // 2)
            return HexText(form_of(inside, size // 2), size, type_.upper)
        case "scaled":
            return Scaled(form_of(type_.inside, size), type_.scale, type_.inside.bounds)
        case "decimal" | "fraction":
            return DecimalText(None if type_.size is None else size, type_.form, type_.end)
        case "ascii" if type_.stops:
            return StoppedText(type_.stops)
        case "ascii":
            return TerminatedText(type_.end) if type_.size is None and type_.end else Text(size, type_.pad, type_.end)
    return Bytes(size)


def _ordered(form: Construct, size: int, order: Order) -> Construct:
    """Return a big-endian form with its bytes reordered; construct has no classes for mid-endian orders."""
    if order == "big":
        return form

    def reorder(data: bytes) -> bytes:
        return support.reorder(data, order)

    return Transformed(form, reorder, size, reorder, size)
