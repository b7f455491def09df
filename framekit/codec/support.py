"""Implement check codes, conversions, swaps, number forms and functions of expressions for both compilers.

Their source is inlined into standalone generated modules. So each function uses only standard imports and other
functions of this module, and no constants. They are optimized where frames need it; comments give the measurements
(CPython 3.11).
"""

from __future__ import annotations

import binascii
import re
import struct
from array import array
from decimal import Decimal
from sys import byteorder
from typing import Any


class Unfit(ValueError):  # noqa: N818 - the fault of a value, not of the program
    """Report a value or bytes that a form cannot represent; the message is for users."""


# --- sums -----------------------------------------------------------------------------------------------------------


def word_sum_big(data: bytes | bytearray, mask: int = 0xFFFF) -> int:
    """Return the sum of big-endian words, masked by `mask`; an odd last byte is a high byte, as if followed by 00."""
    return (sum(data[::2]) << 8) + sum(data[1::2]) & mask


def word_sum_little(data: bytes | bytearray, mask: int = 0xFFFF) -> int:
    """Return the sum of little-endian words, masked by `mask`; an odd last byte is a low byte, as if followed by 00."""
    return sum(data[::2]) + (sum(data[1::2]) << 8) & mask


def xor8(data: bytes | bytearray) -> int:
    """Return the exclusive or of all bytes."""
    if len(data) > 40:  # folding one large number: 3 times as fast as a loop for 250 bytes
        number = int.from_bytes(data, "big")
        shift = 1 << (8 * len(data) - 1).bit_length() >> 1
        while shift >= 8:
            number ^= number >> shift
            shift >>= 1
        return number & 0xFF
    code = 0
    for byte in data:  # faster than functools.reduce
        code ^= byte
    return code


def xor_words(data: bytes | bytearray, size: int, little: bool = False) -> int:
    """Return the exclusive or of words of `size` bytes; the last word is padded with 00 at its end."""
    return int.from_bytes([xor8(data[place::size]) for place in range(size)], "little" if little else "big")


def or8(data: bytes | bytearray) -> int:
    """Return the bitwise or of all bytes."""
    code = 0
    for byte in data:
        code |= byte
    return code


def multiply(data: bytes | bytearray, start: int = 1, mask: int = 0xFF) -> int:
    """Return `start` multiplied by every byte, masked by `mask`; a byte 00 makes the code 0."""
    code = start
    for byte in data:
        code = code * byte & mask
    return code


# --- CRC ------------------------------------------------------------------------------------------------------------


def reflect(value: int, width: int) -> int:
    """Return `value` with its `width` bits in reverse order."""
    return int(f"{value:0{width}b}"[::-1], 2)


def make_crc_table(width: int, poly: int, refin: bool) -> tuple[int, ...]:
    """Return 256 registers: the result of each byte with an empty register.

    With `refin` the highest bit is the lowest power. Without it, codes of less than 8 bits are left-aligned in a byte.
    """
    table = [0] * 256
    if refin:
        mirrored = reflect(poly, width)
        for index in range(256):
            code = index
            for _ in range(8):
                code = code >> 1 ^ (mirrored if code & 1 else 0)
            table[index] = code
        return tuple(table)
    size = max(width, 8)
    divisor, top = poly << size - width, 1 << size - 1
    for index in range(256):
        code = index << size - 8
        for _ in range(8):
            code = (code << 1 ^ divisor if code & top else code << 1) & (1 << size) - 1
        table[index] = code
    return tuple(table)


def make_crc_words(poly: int, refin: bool) -> tuple[int, ...]:
    """Return the table of a 16-bit CRC for two bytes at once: the result of each word with an empty register.

    A word has the byte order of the register: its first byte is the low byte with `refin`, else the high byte. All rows
    are equal except for an exclusive or with a constant, which large numbers compute at once: 2 ms instead of 3 ms in a
    loop.
    """
    table = make_crc_table(16, poly, refin)
    after = [code >> 8 ^ table[code & 0xFF] if refin else code << 8 & 0xFFFF ^ table[code >> 8] for code in table]
    row, offsets = (after, table) if refin else (table, after)
    number, ones = (sum(code << 16 * index for index, code in enumerate(codes)) for codes in (row, [1] * 256))
    words = array("H", b"".join((number ^ offset * ones).to_bytes(512, "little") for offset in offsets))
    if byteorder == "big":
        words.byteswap()
    return tuple(words)  # indexing takes half the time of an array


def make_mirror() -> bytes:
    """Return 256 bytes with the bits of every byte in reverse order, for `bytes.translate`."""
    return bytes(reflect(byte, 8) for byte in range(256))


def crc_reflected(data: bytes | bytearray, table: tuple[int, ...], code: int) -> int:
    """Return a reflected CRC of any width; `code` is the register before, with the lowest power in the highest bit."""
    for byte in data:
        code = code >> 8 ^ table[(code ^ byte) & 0xFF]
    return code


def crc_forward(data: bytes | bytearray, table: tuple[int, ...], width: int, code: int) -> int:
    """Return a CRC of at least 8 bits that is not reflected; `code` is the register before."""
    shift = width - 8
    low = (1 << shift) - 1
    for byte in data:
        code = (code & low) << 8 ^ table[code >> shift ^ byte]
    return code


def crc_narrow(data: bytes | bytearray, table: tuple[int, ...], code: int) -> int:
    """Return a CRC of up to 8 bits; a code that is not reflected is left-aligned in the byte, before and after."""
    for byte in data:
        code = table[code ^ byte]
    return code


def crc16_reflected(data: bytes | bytearray, words: tuple[int, ...], code: int) -> int:
    """Return a reflected 16-bit CRC, two bytes per step.

    This is 1.2 times (23 bytes) to 1.9 times (250 bytes) as fast as single bytes.
    """
    odd = len(data) & 1
    units = array("H", data[:-1] if odd else data)
    if byteorder == "big":
        units.byteswap()
    for unit in units:
        code = words[code ^ unit]
    return code >> 8 ^ words[(code & 0xFF ^ data[-1]) << 8] if odd else code


def crc16_forward(data: bytes | bytearray, words: tuple[int, ...], code: int) -> int:
    """Return a 16-bit CRC that is not reflected; see `crc16_reflected`."""
    odd = len(data) & 1
    units = array("H", data[:-1] if odd else data)
    if byteorder == "little":
        units.byteswap()
    for unit in units:
        code = words[code ^ unit]
    return (code & 0xFF) << 8 ^ words[code >> 8 ^ data[-1]] if odd else code


def crc_1021_reflected(data: bytes | bytearray, mirror: bytes, init: int) -> int:
    """Return the reflected 16-bit CRC with polynomial 1021, from the library's fast forward CRC over mirrored bytes."""
    code = binascii.crc_hqx(data.translate(mirror), init)
    return mirror[code & 0xFF] << 8 | mirror[code >> 8]


def crc(
    data: bytes | bytearray,
    table: tuple[int, ...],
    width: int,
    init: int,
    refin: bool,
    refout: bool,
    xorout: int,
) -> int:
    """Return a CRC by its catalogue parameters, with the table of `make_crc_table(width, poly, refin)`."""
    if refin:
        code = crc_reflected(data, table, reflect(init, width))
    elif width < 8:
        code = crc_narrow(data, table, init << 8 - width) >> 8 - width
    else:
        code = crc_forward(data, table, width, init)
    return (code if refin == refout else reflect(code, width)) ^ xorout


# --- numbers as digits ----------------------------------------------------------------------------------------------


def build_hex(value: int, places: int) -> bytes:
    """Return upper-case hex digits, most significant first. Raises ValueError for a negative or too large value."""
    if not places or value >> 4 * places:
        raise Unfit(f"{value} does not fit into {places} hex digits")
    return b"%0*X" % (places, value)


def build_hex_little(value: int, places: int) -> bytes:
    """Return upper-case hex digits in little-endian pairs: 1234h is `3412`. Raises ValueError, also for odd places."""
    if not places or value >> 4 * places or places % 2:
        raise Unfit(f"{value} does not fit into {places} hex digits in pairs")
    return binascii.hexlify(value.to_bytes(places >> 1, "little")).upper()


def parse_hex(digits: bytes | bytearray) -> int:
    """Return a number from hex digits of either case, most significant first. Raises ValueError."""
    if not digits or digits.strip(b"0123456789ABCDEFabcdef"):  # int() also accepts signs, spaces, _ and 0x
        raise Unfit(f"{bytes(digits)!r} is not a number in hex digits")
    return int(digits, 16)


def parse_hex_little(digits: bytes | bytearray) -> int:
    """Return a number from little-endian pairs of hex digits. Raises ValueError."""
    if not digits or len(digits) % 2 or digits.strip(b"0123456789ABCDEFabcdef"):
        raise Unfit(f"{bytes(digits)!r} is not a number in pairs of hex digits")
    return int.from_bytes(binascii.unhexlify(digits), "little")


def build_dec(value: int, places: int) -> bytes:
    """Return decimal digits, most significant first. Raises ValueError for a negative or too large value."""
    digits = b"%0*d" % (places, value | 0)
    if value < 0 or len(digits) > places:
        raise Unfit(f"{value} does not fit into {places} decimal digits")
    return digits


def parse_dec(digits: bytes | bytearray) -> int:
    """Return a number from decimal digits, most significant first. Raises ValueError."""
    if not digits.isdigit():
        raise Unfit(f"{bytes(digits)!r} is not a number in decimal digits")
    return int(digits)


def build_oct(value: int, places: int) -> bytes:
    """Return octal digits, most significant first. Raises ValueError for a negative or too large value."""
    if not places or value >> 3 * places:
        raise Unfit(f"{value} does not fit into {places} octal digits")
    return b"%0*o" % (places, value)


def parse_oct(digits: bytes | bytearray) -> int:
    """Return a number from octal digits, most significant first. Raises ValueError."""
    if not digits or digits.strip(b"01234567"):
        raise Unfit(f"{bytes(digits)!r} is not a number in octal digits")
    return int(digits, 8)


def exact_decimal(value: Any) -> Decimal:
    """Return a number as Decimal: for a float the shortest decimal of the same value, without decimals if it is whole.

    Raises ValueError for other values.
    """
    if isinstance(value, float):
        value = repr(value).removesuffix(".0")
    elif not isinstance(value, (int, Decimal)):
        raise Unfit(f"{value!r} is not a number")
    number = Decimal(value)
    if not number.is_finite():
        raise Unfit(f"{number} cannot be written in digits")
    return number


def build_decimal(
    value: Any, size: int | None, decimals: int | None, sign: str, digits: int, fill: bytes, exponent: int, point: bool
) -> bytes:
    """Return a number as decimal text of `size` characters; None: as many as necessary, at most 256.

    None as value and size gives an empty text. `decimals`: number of digits after the point (None: as many as the value
    has); `digits`: minimum number before it. `fill`: the padding in front, zeros after the sign. `sign`: `minus`,
    `always`, `space` or `never`. With an `exponent` (its number of digits) one digit precedes the point. `point`: write
    the point even without decimals. Raises ValueError for a value without a representation.
    """
    if value is None and size is None:
        return b""
    whole = exact_decimal(value).as_tuple()
    negative, figures, power = whole.sign, whole.digits, int(whole.exponent)
    if abs(power) > 999 or len(figures) > 999:
        raise Unfit(f"{value} has too many digits")
    number = "".join(map(str, figures)).lstrip("0")
    behind, tail = decimals or 0, ""
    if exponent:
        tail = _exponent_text(value, len(number) - 1 + power if number else 0, exponent)
        power = -max(len(number) - 1, 0)
    elif decimals is None:
        behind = max(-power, 0)
    number = _with_decimals(value, number, power, behind)
    front = number[: len(number) - behind].rjust(digits or not behind, "0")
    text = front + (f".{number[len(number) - behind :]}" if behind or point else "") + tail
    if negative and sign == "never":
        raise Unfit(f"{value} is negative, and has no sign")
    signed = "-" if negative else {"always": "+", "space": " "}.get(sign, "")
    room = (256 if size is None else size) - len(signed) - len(text)
    if room < 0:
        raise Unfit(f"{value} has too many digits" if size is None else f"{value} does not fit into {size} characters")
    if size is None:
        return (signed + text).encode("ascii")
    if fill == b"0":
        return (signed + "0" * room + text).encode("ascii")
    return fill * room + (signed + text).encode("ascii")


def _exponent_text(value: Any, power: int, digits: int) -> str:
    """Return `E`, sign and `digits` digits of an exponent. Raises ValueError if it needs more."""
    text = f"E{power:+0{digits + 1}d}"
    if len(text) > digits + 2:
        raise Unfit(f"{value} needs an exponent of more than {digits} digits")
    return text


def _with_decimals(value: Any, number: str, power: int, decimals: int) -> str:
    """Return the digits of `number` × 10 ** `power`, the last `decimals` of them after the point.

    Raises ValueError if that would cut digits other than 0.
    """
    surplus = -power - decimals
    if surplus <= 0:
        return (number + "0" * -surplus).rjust(decimals, "0")
    if number[-surplus:].strip("0"):
        raise Unfit(f"{value} has more than {decimals} decimals")
    return number[:-surplus].rjust(decimals, "0")


def parse_decimal(
    text: bytes | bytearray,
    fixed: bool,
    decimals: int | None,
    sign: str,
    digits: int,
    fill: bytes,
    exponent: int,
    point: bool,
) -> Any:
    """Return the number of a decimal text: an int without point and exponent, else an exact Decimal. Raises ValueError.

    A text that `build_decimal` would write differently is refused, so that building restores the bytes. `fixed`: the
    text has a size.
    """
    plain = bytes(text.lstrip(fill) if fixed and fill != b"0" else text).removeprefix(b" " if sign == "space" else b"")
    if len(text) > 256 or not re.fullmatch(rb"[+-]?[0-9]*(\.[0-9]*)?(E[+-][0-9]{1,4})?", plain):
        raise Unfit(f"{bytes(text)!r} is not a number in decimal text")
    if not re.match(rb"[+-]?\.?[0-9]", plain):
        raise Unfit(f"{bytes(text)!r} has no digits")
    shown = plain.decode("ascii")
    is_whole = decimals == 0 and not exponent and not point and shown.lstrip("+-").isdigit()
    number = int(shown) if is_whole else Decimal(shown)
    if build_decimal(number, len(text) if fixed else None, decimals, sign, digits, fill, exponent, point) != text:
        raise Unfit(f"{bytes(text)!r} is not written as such numbers are")
    return number


def scaled(wire: int, factor: int, offset: int, places: int) -> Decimal:
    """Return `wire` times a factor plus an offset, both in units of 10 to the power -`places`; the result is exact."""
    return Decimal(f"{wire * factor + offset}E-{places}")


def unscaled(value: Any, factor: int, offset: int, places: int, least: int | None, most: int | None) -> int:
    """Return the reverse of `scaled`. Raises ValueError if no number from `least` to `most` represents the value."""
    whole = exact_decimal(value).as_tuple()
    power = int(whole.exponent) + places
    if abs(power) > 999 or len(whole.digits) > 999:
        raise Unfit(f"{value} has too many digits")
    number = int("".join(map(str, whole.digits))) * (-1 if whole.sign else 1) * 10 ** max(power, 0)
    unit = 10 ** max(-power, 0)
    wire: int = (number - offset * unit) // (factor * unit)
    if wire * factor * unit != number - offset * unit:
        raise Unfit(f"{value} is between two values, which are {Decimal(f'{abs(factor)}E-{places}')} apart")
    if (least is not None and wire < least) or (most is not None and wire > most):
        ends = sorted(scaled(one, factor, offset, places) for one in (least, most) if one is not None)
        raise Unfit(f"{value} does not fit into {' to '.join(map(str, ends))}")
    return wire


def find_stop(data: bytes | bytearray, stops: bytes | tuple[bytes, ...], at: int, end: int) -> int:
    """Return the first offset of one of several bytes or byte strings; -1 if none occurs before `end`."""
    found, longest = -1, max(map(len, stops)) if isinstance(stops, tuple) else 1
    for stop in stops:
        place = data.find(stop, at, end)
        if place >= 0 and (found < 0 or place < found):
            found, end = place, min(end, place + longest - 1)
    return found


def index_stop(data: bytes | bytearray, stops: bytes | tuple[bytes, ...], at: int) -> int:
    """Return the first offset of one of several bytes or byte strings. Raises ValueError if none occurs."""
    place = find_stop(data, stops, at, len(data))
    if place < 0:
        raise ValueError("none of the ends is there")
    return place


# --- numbers in other forms -----------------------------------------------------------------------------------------


def build_bcd(value: int, size: int) -> bytes:
    """Return two decimal digits per byte, most significant first.

    Raises ValueError for a negative or too large value.
    """
    if size == 1 and 0 <= value <= 99:  # by far the most frequent
        return b"%c" % (value + 6 * (value // 10))
    digits = f"{value:0{2 * size}d}"
    if value < 0 or len(digits) > 2 * size:
        raise Unfit(f"{value} does not fit into {size} bytes BCD")
    return bytes.fromhex(digits)


def parse_bcd(data: bytes | bytearray) -> int:
    """Return a number from two decimal digits per byte, most significant first. Raises ValueError for digits A to F."""
    if len(data) == 1:  # by far the most frequent
        number = data[0]
        if number > 0x99 or number & 0x0F > 9:
            raise Unfit(f"{number:02X} is not BCD")
        return number - 6 * (number >> 4)
    digits = data.hex()
    if not digits.isdecimal():
        raise Unfit(f"{digits.upper()} is not BCD")
    return int(digits)


def split_nibbles(data: bytes | bytearray) -> bytes:
    """Return each half byte as a byte 30h + nibble, high half first: A to F become 3A to 3F instead of letters."""
    return binascii.hexlify(data).translate(bytes.maketrans(b"abcdef", b":;<=>?"))


def join_nibbles(nibbles: bytes | bytearray) -> bytes:
    """Return the reverse of `split_nibbles`. Raises ValueError for an odd count or a byte outside 30h to 3Fh."""
    if nibbles.strip(b"0123456789:;<=>?"):
        raise Unfit(f"{bytes(nibbles)!r} is not made of half bytes")
    return binascii.unhexlify(nibbles.translate(bytes.maketrans(b":;<=>?", b"abcdef")))


def build_nibbles(value: int, size: int) -> bytes:
    """Return a number of `size` bytes, big-endian, as 2 × `size` half bytes. Raises OverflowError."""
    return split_nibbles(value.to_bytes(size, "big"))


def parse_nibbles(nibbles: bytes | bytearray) -> int:
    """Return a number from half bytes, big-endian. Raises ValueError."""
    return int.from_bytes(join_nibbles(nibbles), "big")


def reorder(data: bytes | bytearray, order: str) -> bytes:
    """Convert the big-endian bytes of a number of 2, 4 or 8 bytes to `order`, or back: the function is its own reverse.

    `ABCD` or `big`: unchanged; `DCBA` or `little`: last byte first; `BADC`: bytes of each word swapped; `CDAB`: last
    word first. Raises ValueError for any other order.
    """
    if order in ("big", "ABCD"):
        return bytes(data)
    if order in ("little", "DCBA"):
        return bytes(data[::-1])
    if order == "BADC":
        return swap(data, 2)
    if order == "CDAB":
        if len(data) == 4:  # by far the most frequent
            return bytes(data[2:] + data[:2])
        return swap(data[::-1], 2)
    raise Unfit(f"there is no byte order '{order}'")


def build_int(value: int, size: int, order: str, signed: bool = False) -> bytes:
    """Return an integer as `size` bytes in an order of `reorder`. Raises OverflowError if it does not fit."""
    return reorder(value.to_bytes(size, "big", signed=signed), order)


def parse_int(data: bytes | bytearray, order: str, signed: bool = False) -> int:
    """Return an integer from bytes in an order of `reorder`."""
    return int.from_bytes(reorder(data, order), "big", signed=signed)


def build_float(value: float, size: int, order: str) -> bytes:
    """Return an IEEE 754 number as 2, 4 or 8 bytes in an order of `reorder`.

    Raises OverflowError if it is too large.
    """
    return reorder(struct.pack({2: ">e", 4: ">f", 8: ">d"}[size], value), order)


def parse_float(data: bytes | bytearray, order: str) -> float:
    """Return an IEEE 754 number from 2, 4 or 8 bytes in an order of `reorder`."""
    value: float = struct.unpack({2: ">e", 4: ">f", 8: ">d"}[len(data)], reorder(data, order))[0]
    return value


def room(size: int) -> int:
    """Return a computed size unchanged. Raises ValueError if it exceeds the limit for frames."""
    if size > 1_048_576:
        raise Unfit(f"{size} bytes or digits are too many, 1048576 are possible")
    return size


# --- text -----------------------------------------------------------------------------------------------------------


def build_terminated(text: str, end: bytes) -> bytes:
    """Return text followed by the bytes `end`. Raises ValueError if `end` occurs earlier."""
    data = text.encode("latin-1") + end
    if data.find(end) != len(data) - len(end):
        raise Unfit(f"{text!r} holds its own end {end!r}")
    return data


def build_stopped(text: str, stops: bytes | tuple[bytes, ...]) -> bytes:
    """Return text that ends before the first of `stops` (bytes or byte strings).

    Raises ValueError if it contains one of them.
    """
    data = text.encode("latin-1")
    for stop in stops:
        if stop in data:
            shown = f"{stop:02X}" if isinstance(stop, int) else stop.hex(" ").upper()
            raise Unfit(f"{text!r} holds {shown}, which ends it")
    return data


# --- conversion, swap, escape ---------------------------------------------------------------------------------------


def hex_to_ascii(data: bytes | bytearray) -> bytes:
    """Return every byte as two upper-case hex digits."""
    return binascii.hexlify(data).upper()  # a little faster than data.hex().upper().encode()


def ascii_to_hex(digits: bytes | bytearray) -> bytes:
    """Return a byte for two hex digits of either case. Raises ValueError for an odd count or other characters."""
    return binascii.unhexlify(digits)  # bytes.fromhex would skip spaces


def swap(data: bytes | bytearray, size: int) -> bytes:
    """Return the bytes with each unit of `size` (2, 4 or 8) reversed; an incomplete unit at the end is unchanged."""
    rest = len(data) % size
    if rest:
        return swap(data[:-rest], size) + data[-rest:]
    units = array("H" if size == 2 else "I" if size == 4 else "Q", data)  # 2 to 5 times as fast as slices with a step
    units.byteswap()
    return units.tobytes()


# --- functions of expressions ---------------------------------------------------------------------------------------


def digits(n: int, width: int, base: int = 16) -> str:
    """Return `n` in exactly `width` upper-case digits of base 16, 10, 8 or 2. Raises ValueError."""
    if width > 4096:
        raise Unfit(f"{width} digits are too many")
    letter = {16: "X", 10: "d", 8: "o", 2: "b"}.get(base)
    if letter is None:
        raise Unfit(f"digits are of base 16, 10, 8 or 2, not {base}")
    text = format(n, f"0{width}{letter}")
    if n < 0 or len(text) > width:
        raise Unfit(f"{n} does not fit into {width} digits of base {base}")
    return text


def number(text: str | bytes | bytearray, base: int = 10) -> int:
    """Return the number in text or bytes that consist only of digits of `base`. Raises ValueError."""
    if not isinstance(text, str):
        text = text.decode("latin-1")
    if not text or text.lower().strip("0123456789abcdefghijklmnopqrstuvwxyz"[:base]):
        raise Unfit(f"{text!r} is not a number of base {base}")
    return int(text, base)


def bit(x: int, n: int) -> int:
    """Return bit `n` of `x`, 0 or 1; bit 0 is the lowest."""
    return x >> n & 1


def times(x: float, y: float) -> float:
    """Return `x * y` for numbers. Raises TypeError for texts and bytes, whose multiples could be of any size."""
    if not isinstance(x, (int, float)) or not isinstance(y, (int, float)):
        raise TypeError("'*' multiplies numbers")
    return x * y


def rotl8(x: int, n: int) -> int:
    """Return the byte `x` rotated left by `n` bits."""
    n &= 7
    x &= 0xFF
    return (x << n | x >> 8 - n) & 0xFF


def xor(one: bytes, other: bytes) -> bytes:
    """Return the bytewise exclusive or of two byte strings. Raises ValueError for different lengths."""
    if not isinstance(one, (bytes, bytearray)) or not isinstance(other, (bytes, bytearray)) or len(one) != len(other):
        raise Unfit("exclusive or takes as many bytes of both")
    return (int.from_bytes(one, "big") ^ int.from_bytes(other, "big")).to_bytes(len(one), "big")


def same(items: Any) -> bool:
    """Return whether all items are equal, which is true for an empty list."""
    return all(item == items[0] for item in items)


def find(table: Any, value: Any) -> Any:
    """Return the least key whose entry equals `value`, or None; for a list the index."""
    entries = enumerate(table) if isinstance(table, (list, tuple)) else table.items()
    return min([key for key, entry in entries if entry == value], default=None)


def find_last(table: Any, value: Any) -> Any:
    """Return the greatest key whose entry equals `value`, or None; for a list the index."""
    entries = enumerate(table) if isinstance(table, (list, tuple)) else table.items()
    return max([key for key, entry in entries if entry == value], default=None)


def item_at(items: Any, place: Any) -> Any:
    """Return the item at an index from `find` or `find_last`; None for None."""
    return None if place is None else items[place]


def free(table: Any) -> int | None:
    """Return the least key without an entry, or None if all are used.

    A table of the state has its first and last key as `limits`; a plain dictionary has the keys 0 to 255.
    """
    first, last = getattr(table, "limits", (0, 255))
    for key in range(first, last + 1):
        if key not in table:
            return key
    return None


def either(a: Any, b: Any) -> Any:
    """Return `a`, or `b` if `a` is None."""
    return b if a is None else a


def only(text: Any, letters: Any) -> bool:
    """Return whether `text` contains only `letters` (both text or both bytes); true for empty text."""
    return not text.strip(letters)


def span(bit: int, count: int) -> int:
    """Return the number of bytes that `count` bits from bit number `bit` on touch.

    Bit 0 is at the start of a byte.
    """
    return (bit % 8 + count + 7) // 8 if count else 0
