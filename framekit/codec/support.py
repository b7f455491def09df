"""The plain functions behind both compilers: check codes, conversions, swaps, number forms, functions of expressions.

Their source is inlined into generated modules that stand alone. So every function here is on its own: it knows no
framekit, only standard imports and other functions of this module, and no constant of it. They are written for speed
where a frame needs them; comments say what was measured (CPython 3.11).
"""

from __future__ import annotations

import binascii
import re
import struct
from array import array
from decimal import Decimal
from sys import byteorder
from typing import Any


class Unfit(ValueError):  # noqa: N818 - a value, not a fault of the program
    """A value or bytes that a form cannot carry; what it says is meant for people."""


# --- sums -----------------------------------------------------------------------------------------------------------


def word_sum_big(data: bytes | bytearray, mask: int = 0xFFFF) -> int:
    """The sum of words, high byte first, cut by `mask`. An odd last byte is a high byte: a word with 00 behind it."""
    return (sum(data[::2]) << 8) + sum(data[1::2]) & mask


def word_sum_little(data: bytes | bytearray, mask: int = 0xFFFF) -> int:
    """The sum of words, low byte first, cut by `mask`. An odd last byte is a low byte: a word with 00 behind it."""
    return sum(data[::2]) + (sum(data[1::2]) << 8) & mask


def xor8(data: bytes | bytearray) -> int:
    """The exclusive or of all bytes."""
    if len(data) > 40:  # one big number folded onto itself: 3 times as fast as a loop over 250 bytes
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
    """The exclusive or of words of `size` bytes; the last one is filled up with 00 behind."""
    return int.from_bytes([xor8(data[place::size]) for place in range(size)], "little" if little else "big")


def or8(data: bytes | bytearray) -> int:
    """All bytes combined by OR."""
    code = 0
    for byte in data:
        code |= byte
    return code


def multiply(data: bytes | bytearray, start: int = 1, mask: int = 0xFF) -> int:
    """`start` multiplied by every byte, cut by `mask`. A byte 00 makes the code 0."""
    code = start
    for byte in data:
        code = code * byte & mask
    return code


# --- CRC ------------------------------------------------------------------------------------------------------------


def reflect(value: int, width: int) -> int:
    """`value` with its `width` bits in reverse order."""
    return int(f"{value:0{width}b}"[::-1], 2)


def make_crc_table(width: int, poly: int, refin: bool) -> tuple[int, ...]:
    """256 registers: what each byte makes of an empty one.

    With `refin` they hold the lowest power in the highest bit. Without it, codes under 8 bits stand left in a byte.
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
    """The table of a CRC of 16 bits for two bytes at once: 65536 registers, what each word makes of an empty one.

    A word is read as the register meets it, so the byte that comes first is the low one with `refin`, else the high
    one. Every row is another one with a constant put on, which big numbers do at once: 2 ms, a loop takes 3.
    """
    table = make_crc_table(16, poly, refin)
    after = [code >> 8 ^ table[code & 0xFF] if refin else code << 8 & 0xFFFF ^ table[code >> 8] for code in table]
    row, offsets = (after, table) if refin else (table, after)
    number, ones = (sum(code << 16 * index for index, code in enumerate(codes)) for codes in (row, [1] * 256))
    words = array("H", b"".join((number ^ offset * ones).to_bytes(512, "little") for offset in offsets))
    if byteorder == "big":
        words.byteswap()
    return tuple(words)  # its items are reached in half the time of the array's


def make_mirror() -> bytes:
    """256 bytes: every byte's bits in reverse order, for `bytes.translate`."""
    return bytes(reflect(byte, 8) for byte in range(256))


def crc_reflected(data: bytes | bytearray, table: tuple[int, ...], code: int) -> int:
    """A reflected CRC of any width. `code` is the register before and after, lowest power in the highest bit."""
    for byte in data:
        code = code >> 8 ^ table[(code ^ byte) & 0xFF]
    return code


def crc_forward(data: bytes | bytearray, table: tuple[int, ...], width: int, code: int) -> int:
    """A CRC of at least 8 bits that is not reflected. `code` is the register before and after."""
    shift = width - 8
    low = (1 << shift) - 1
    for byte in data:
        code = (code & low) << 8 ^ table[code >> shift ^ byte]
    return code


def crc_narrow(data: bytes | bytearray, table: tuple[int, ...], code: int) -> int:
    """A CRC of up to 8 bits; one that is not reflected stands left in the byte, before and after."""
    for byte in data:
        code = table[code ^ byte]
    return code


def crc16_reflected(data: bytes | bytearray, words: tuple[int, ...], code: int) -> int:
    """A reflected CRC of 16 bits, two bytes a step: 1.2 (23 bytes) to 1.9 times (250) as fast as one by one."""
    odd = len(data) & 1
    units = array("H", data[:-1] if odd else data)
    if byteorder == "big":
        units.byteswap()
    for unit in units:
        code = words[code ^ unit]
    return code >> 8 ^ words[(code & 0xFF ^ data[-1]) << 8] if odd else code


def crc16_forward(data: bytes | bytearray, words: tuple[int, ...], code: int) -> int:
    """A CRC of 16 bits that is not reflected; see `crc16_reflected`."""
    odd = len(data) & 1
    units = array("H", data[:-1] if odd else data)
    if byteorder == "little":
        units.byteswap()
    for unit in units:
        code = words[code ^ unit]
    return (code & 0xFF) << 8 ^ words[code >> 8 ^ data[-1]] if odd else code


def crc_1021_reflected(data: bytes | bytearray, mirror: bytes, init: int) -> int:
    """The reflected CRC of 16 bits with polynomial 1021: the library's fast forward one on mirrored bytes."""
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
    """A CRC by its catalogue parameters, with the table of `make_crc_table(width, poly, refin)`."""
    if refin:
        code = crc_reflected(data, table, reflect(init, width))
    elif width < 8:
        code = crc_narrow(data, table, init << 8 - width) >> 8 - width
    else:
        code = crc_forward(data, table, width, init)
    return (code if refin == refout else reflect(code, width)) ^ xorout


# --- numbers as digits ----------------------------------------------------------------------------------------------


def build_hex(value: int, places: int) -> bytes:
    """Upper-case hex digits, highest first. Raises ValueError if the value is negative or too large."""
    if not places or value >> 4 * places:
        raise Unfit(f"{value} does not fit into {places} hex digits")
    return b"%0*X" % (places, value)


def build_hex_little(value: int, places: int) -> bytes:
    """Upper-case hex digits, the last byte's two first: 1234h is `3412`. Raises ValueError, also for odd places."""
    if not places or value >> 4 * places or places % 2:
        raise Unfit(f"{value} does not fit into {places} hex digits in pairs")
    return binascii.hexlify(value.to_bytes(places >> 1, "little")).upper()


def parse_hex(digits: bytes | bytearray) -> int:
    """A number from hex digits of either case, highest first. Raises ValueError."""
    if not digits or digits.strip(b"0123456789ABCDEFabcdef"):  # int() alone takes signs, spaces, _ and 0x
        raise Unfit(f"{bytes(digits)!r} is not a number in hex digits")
    return int(digits, 16)


def parse_hex_little(digits: bytes | bytearray) -> int:
    """A number from pairs of hex digits, the last byte's first. Raises ValueError."""
    if not digits or len(digits) % 2 or digits.strip(b"0123456789ABCDEFabcdef"):
        raise Unfit(f"{bytes(digits)!r} is not a number in pairs of hex digits")
    return int.from_bytes(binascii.unhexlify(digits), "little")


def build_dec(value: int, places: int) -> bytes:
    """Decimal digits, highest first. Raises ValueError if the value is negative or too large."""
    digits = b"%0*d" % (places, value | 0)
    if value < 0 or len(digits) > places:
        raise Unfit(f"{value} does not fit into {places} decimal digits")
    return digits


def parse_dec(digits: bytes | bytearray) -> int:
    """A number from decimal digits, highest first. Raises ValueError."""
    if not digits.isdigit():
        raise Unfit(f"{bytes(digits)!r} is not a number in decimal digits")
    return int(digits)


def build_oct(value: int, places: int) -> bytes:
    """Octal digits, highest first. Raises ValueError if the value is negative or too large."""
    if not places or value >> 3 * places:
        raise Unfit(f"{value} does not fit into {places} octal digits")
    return b"%0*o" % (places, value)


def parse_oct(digits: bytes | bytearray) -> int:
    """A number from octal digits, highest first. Raises ValueError."""
    if not digits or digits.strip(b"01234567"):
        raise Unfit(f"{bytes(digits)!r} is not a number in octal digits")
    return int(digits, 8)


def exact_decimal(value: Any) -> Decimal:
    """A number as it is written: a float is the shortest decimal that means it, a whole one without decimals.

    Raises ValueError for others.
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
    """A number as decimal text; `size` None: as long as it takes, up to 256 characters; nothing is no text at all.

    `decimals` digits behind the point (None: as many as the value has), at least `digits` before it; `fill` stands in
    front, zeros behind the sign. `sign`: `minus`, `always`, `space` or `never`. With digits of an `exponent` one digit
    stands before the point. `point`: it stands without digits behind it too. Raises ValueError for what such a text
    cannot say.
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
        place = len(number) - 1 + power if number else 0
        tail = f"E{place:+0{exponent + 1}d}"
        if len(tail) > exponent + 2:
            raise Unfit(f"{value} needs an exponent of more than {exponent} digits")
        power = -max(len(number) - 1, 0)
    elif decimals is None:
        behind = max(-power, 0)
    surplus = -power - behind
    if surplus > 0:
        if number[-surplus:].strip("0"):
            raise Unfit(f"{value} has more than {behind} decimals")
        number = number[:-surplus]
    else:
        number += "0" * -surplus
    number = number.rjust(behind, "0")
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
    """The number that a decimal text shows: whole ones without point and exponent, others exact. Raises ValueError.

    What `build_decimal` would write otherwise is refused, so that the same bytes come of the number. `fixed`: the text
    has a size.
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
    """The number `wire` times a factor, and an offset more, both counted in 10 to the power -`places`; exact."""
    return Decimal(f"{wire * factor + offset}E-{places}")


def unscaled(value: Any, factor: int, offset: int, places: int, least: int | None, most: int | None) -> int:
    """The reverse of `scaled`. Raises ValueError for what no number from `least` to `most` stands for."""
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
    """The first place of one of some bytes, or of one of some pieces; -1 if none is there before `end`."""
    found, longest = -1, max(map(len, stops)) if isinstance(stops, tuple) else 1
    for stop in stops:
        place = data.find(stop, at, end)
        if place >= 0 and (found < 0 or place < found):
            found, end = place, min(end, place + longest - 1)
    return found


def index_stop(data: bytes | bytearray, stops: bytes | tuple[bytes, ...], at: int) -> int:
    """The first place of one of some bytes, or of one of some pieces. Raises ValueError if none is there."""
    place = find_stop(data, stops, at, len(data))
    if place < 0:
        raise ValueError("none of the ends is there")
    return place


# --- numbers in other forms -----------------------------------------------------------------------------------------


def build_bcd(value: int, size: int) -> bytes:
    """Two decimal digits a byte, highest first. Raises ValueError if the value is negative or too large."""
    if size == 1 and 0 <= value <= 99:  # by far the most frequent
        return b"%c" % (value + 6 * (value // 10))
    digits = f"{value:0{2 * size}d}"
    if value < 0 or len(digits) > 2 * size:
        raise Unfit(f"{value} does not fit into {size} bytes BCD")
    return bytes.fromhex(digits)


def parse_bcd(data: bytes | bytearray) -> int:
    """A number from bytes of two decimal digits, highest first. Raises ValueError for half bytes from A to F."""
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
    """Every half byte as a byte 30h + nibble, high one first: A to F become 3A to 3F, not the letters."""
    return binascii.hexlify(data).translate(bytes.maketrans(b"abcdef", b":;<=>?"))


def join_nibbles(nibbles: bytes | bytearray) -> bytes:
    """The reverse of `split_nibbles`. Raises ValueError for an odd count or a byte outside 30h to 3Fh."""
    if nibbles.strip(b"0123456789:;<=>?"):
        raise Unfit(f"{bytes(nibbles)!r} is not made of half bytes")
    return binascii.unhexlify(nibbles.translate(bytes.maketrans(b":;<=>?", b"abcdef")))


def build_nibbles(value: int, size: int) -> bytes:
    """A number of `size` bytes, big-endian, as 2 × `size` half bytes. Raises OverflowError."""
    return split_nibbles(value.to_bytes(size, "big"))


def parse_nibbles(nibbles: bytes | bytearray) -> int:
    """A number from half bytes, big-endian. Raises ValueError."""
    return int.from_bytes(join_nibbles(nibbles), "big")


def reorder(data: bytes | bytearray, order: str) -> bytes:
    """Big-endian bytes of a number of 2, 4 or 8 bytes put into `order`, and back: it is its own reverse.

    `ABCD` or `big` as it is, `DCBA` or `little` the last byte first, `BADC` the bytes of every word swapped, `CDAB`
    the last word first. Raises ValueError for another order.
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
    """An integer of `size` bytes in one of the orders of `reorder`. Raises OverflowError if it does not fit."""
    return reorder(value.to_bytes(size, "big", signed=signed), order)


def parse_int(data: bytes | bytearray, order: str, signed: bool = False) -> int:
    """An integer from bytes in one of the orders of `reorder`."""
    return int.from_bytes(reorder(data, order), "big", signed=signed)


def build_float(value: float, size: int, order: str) -> bytes:
    """An IEEE 754 number of 2, 4 or 8 bytes in an order of `reorder`. Raises OverflowError if it is too large."""
    return reorder(struct.pack({2: ">e", 4: ">f", 8: ">d"}[size], value), order)


def parse_float(data: bytes | bytearray, order: str) -> float:
    """An IEEE 754 number from 2, 4 or 8 bytes in one of the orders of `reorder`."""
    value: float = struct.unpack({2: ">e", 4: ">f", 8: ">d"}[len(data)], reorder(data, order))[0]
    return value


def room(size: int) -> int:
    """A size that is computed, as far as a frame has room for it. Raises ValueError."""
    if size > 1_048_576:
        raise Unfit(f"{size} bytes or digits are too many, 1048576 are possible")
    return size


# --- text -----------------------------------------------------------------------------------------------------------


def build_terminated(text: str, end: bytes) -> bytes:
    """Text and the bytes `end` behind it. Raises ValueError if `end` would be found before the end."""
    data = text.encode("latin-1") + end
    if data.find(end) != len(data) - len(end):
        raise Unfit(f"{text!r} holds its own end {end!r}")
    return data


def build_stopped(text: str, stops: bytes | tuple[bytes, ...]) -> bytes:
    """Text that ends before the first of `stops`, bytes or pieces. Raises ValueError if one of them stands in it."""
    data = text.encode("latin-1")
    for stop in stops:
        if stop in data:
            shown = f"{stop:02X}" if isinstance(stop, int) else stop.hex(" ").upper()
            raise Unfit(f"{text!r} holds {shown}, which ends it")
    return data


# --- conversion, swap, escape ---------------------------------------------------------------------------------------


def hex_to_ascii(data: bytes | bytearray) -> bytes:
    """Every byte as two upper-case hex digits."""
    return binascii.hexlify(data).upper()  # a little faster than data.hex().upper().encode()


def ascii_to_hex(digits: bytes | bytearray) -> bytes:
    """Two hex digits of either case become a byte. Raises ValueError for an odd count or anything but a digit."""
    return binascii.unhexlify(digits)  # bytes.fromhex would skip spaces


def swap(data: bytes | bytearray, size: int) -> bytes:
    """The bytes of every unit of `size` (2, 4 or 8) in reverse order; a rest that fills no unit stays as it is."""
    rest = len(data) % size
    if rest:
        return swap(data[:-rest], size) + data[-rest:]
    units = array("H" if size == 2 else "I" if size == 4 else "Q", data)  # 2 to 5 times as fast as slices with a step
    units.byteswap()
    return units.tobytes()


# --- functions of expressions ---------------------------------------------------------------------------------------


def digits(n: int, width: int, base: int = 16) -> str:
    """`n` in exactly `width` upper-case digits of base 16, 10, 8 or 2. Raises ValueError."""
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
    """The number that text or bytes show in digits of `base`, nothing else around them. Raises ValueError."""
    if not isinstance(text, str):
        text = text.decode("latin-1")
    if not text or text.lower().strip("0123456789abcdefghijklmnopqrstuvwxyz"[:base]):
        raise Unfit(f"{text!r} is not a number of base {base}")
    return int(text, base)


def bit(x: int, n: int) -> int:
    """Bit `n` of `x`, 0 or 1; bit 0 is the lowest."""
    return x >> n & 1


def times(x: float, y: float) -> float:
    """`x * y` of numbers; a text or bytes so many times could be of any size. Raises TypeError."""
    if not isinstance(x, (int, float)) or not isinstance(y, (int, float)):
        raise TypeError("'*' multiplies numbers")
    return x * y


def rotl8(x: int, n: int) -> int:
    """The byte `x` rotated left by `n` bits."""
    n &= 7
    x &= 0xFF
    return (x << n | x >> 8 - n) & 0xFF


def xor(one: bytes, other: bytes) -> bytes:
    """Each byte of one combined by exclusive or with that of the other. Raises ValueError for different lengths."""
    if not isinstance(one, (bytes, bytearray)) or not isinstance(other, (bytes, bytearray)) or len(one) != len(other):
        raise Unfit("exclusive or takes as many bytes of both")
    return (int.from_bytes(one, "big") ^ int.from_bytes(other, "big")).to_bytes(len(one), "big")


def same(items: Any) -> bool:
    """Whether all items are equal; so they are if there are none."""
    return all(item == items[0] for item in items)


def find(table: Any, value: Any) -> Any:
    """The least key whose entry equals `value`, None if there is none; in a list the place, the first one is 0."""
    entries = enumerate(table) if isinstance(table, (list, tuple)) else table.items()
    return min([key for key, entry in entries if entry == value], default=None)


def find_last(table: Any, value: Any) -> Any:
    """The greatest key whose entry equals `value`, None if there is none; in a list the place."""
    entries = enumerate(table) if isinstance(table, (list, tuple)) else table.items()
    return max([key for key, entry in entries if entry == value], default=None)


def item_at(items: Any, place: Any) -> Any:
    """What stands at a place that `find` or `find_last` gave; nothing at none."""
    return None if place is None else items[place]


def free(table: Any) -> int | None:
    """The least key without an entry, None if all are taken.

    A table of the state tells its first and last key as `limits`; a plain dictionary has room for the keys 0 to 255.
    """
    first, last = getattr(table, "limits", (0, 255))
    for key in range(first, last + 1):
        if key not in table:
            return key
    return None


def either(a: Any, b: Any) -> Any:
    """`a`, or `b` if `a` is None."""
    return b if a is None else a


def only(text: Any, letters: Any) -> bool:
    """Whether `text` is made of nothing but `letters`, both text or both bytes; empty text is."""
    return not text.strip(letters)


def span(bit: int, count: int) -> int:
    """How many bytes `count` bits from bit number `bit` on touch, each bit at its natural place in its byte."""
    return (bit % 8 + count + 7) // 8 if count else 0
