"""How single values stand on the wire: construct objects for the field types, built from the library's own classes.

A form reads exactly its bytes and gives a number, a text or bytes; what the value means is not known here.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import construct
from construct import Adapter, Bytes, BytesInteger, Construct, GreedyBytes, NullTerminated, Transformed

from framekit.codec import support
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
    """Bytes that are no such number or text, or a value that has no such form."""


class Digits(Adapter):
    """A number in ASCII digits of base 16, 10 or 8.

    Parses digits of either case into an `int`; builds exactly as many places. Raises FormError for other characters,
    negative numbers and numbers with too many digits.
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
    """A number with two decimal digits in every byte.

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
    """Latin-1 text in `size` bytes: up to `end` where there is one, without the `pad` bytes behind it.

    Builds exactly `size` bytes, filled up with `pad` (00 behind an `end`). Raises FormError for text that is too long,
    too short with neither `pad` nor `end`, or not Latin-1.
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


class TerminatedText(Adapter):
    """Latin-1 text up to the bytes `end`, which are read with it. Builds both; raises FormError for `end` inside."""

    def __init__(self, end: bytes) -> None:
        super().__init__(NullTerminated(GreedyBytes, term=end))
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


class NoDigits(Adapter):
    """A number of no bytes, which a computed size may ask for: parses as 0. Raises FormError for other numbers."""

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
    """The form of `type_` in `size` bytes (digits: places). Text with an `end` takes what it takes."""
    match type_.kind:
        case "int":
            return _ordered(BytesInteger(size, signed=type_.signed), size, type_.order) if size else NoDigits()
        case "float":
            return _ordered(_FLOATS[size], size, type_.order)
        case "digits":
            return Digits(size, type_.base, type_.order, type_.upper)
        case "bcd":
            return Bcd(size, type_.order)
        case "ascii":
            return TerminatedText(type_.end) if type_.size is None and type_.end else Text(size, type_.pad, type_.end)
    return Bytes(size)


def _ordered(form: Construct, size: int, order: Order) -> Construct:
    """A big-endian form with its bytes put into `order`; mid-endian orders are beyond construct's own classes."""
    if order == "big":
        return form

    def reorder(data: bytes) -> bytes:
        return support.reorder(data, order)

    return Transformed(form, reorder, size, reorder, size)
