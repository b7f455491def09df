"""What a scalar means once a key gives it a meaning: numbers, flags, bytes, ranges, constants.

Every function raises ValueError with a sentence that says what was expected; nothing here knows keys or files.
"""

from __future__ import annotations

import re

from framekit.definition.model.values import Constant
from framekit.definition.times import parse_time

CONTROL_NAMES = {
    name: code
    for code, name in enumerate(
        [
            "NUL",
            "SOH",
            "STX",
            "ETX",
            "EOT",
            "ENQ",
            "ACK",
            "BEL",
            "BS",
            "HT",
            "LF",
            "VT",
            "FF_",
            "CR",
            "SO",
            "SI",
            "DLE",
            "DC1",
            "DC2",
            "DC3",
            "DC4",
            "NAK",
            "SYN",
            "ETB",
            "CAN",
            "EM",
            "SUB",
            "ESC",
            "FS",
            "GS",
            "RS",
            "US",
        ]
    )
    if name != "FF_"
} | {"SP": 0x20, "DEL": 0x7F, "TAB": 0x09, "XON": 0x11, "XOFF": 0x13}
"""Names of control characters; form feed has none, since `FF` is the byte."""

FLAGS = {"yes": 1, "true": 1, "on": 1, "no": 0, "false": 0, "off": 0}

_NUMBER = re.compile(r"[-+]?(?:0[xX][0-9a-fA-F]+|\d+)")


def parse_number(text: str) -> int:
    """`12`, `0x0C`, `-3`; a leading zero changes nothing."""
    text = text.strip()
    if not _NUMBER.fullmatch(text):
        raise ValueError(f"'{text}' is not a whole number – write it like 10 or 0x0A")
    return int(text, 16 if "x" in text.lower() else 10)


def parse_flag(text: str) -> int:
    """`yes` or `no` (also true, false, on, off) as 1 or 0."""
    try:
        return FLAGS[text.strip().lower()]
    except KeyError:
        raise ValueError(f"'{text}' is neither yes nor no") from None


def parse_bytes(text: str) -> bytes:
    """Hex pairs and names of control characters: `1B 54`, `DLE STX`, `0D0A`."""
    result = bytearray()
    for word in text.split():
        if word.upper() in CONTROL_NAMES and word.isupper():
            result.append(CONTROL_NAMES[word.upper()])
        elif re.fullmatch(r"(?:[0-9a-fA-F]{2})+", word):
            result += bytes.fromhex(word)
        else:
            raise ValueError(f"'{word}' is neither hex digits in pairs nor the name of a control character")
    if not result:
        raise ValueError("no bytes are given – write hex pairs such as 1B 54, or names such as DLE STX")
    return bytes(result)


def parse_range(text: str) -> tuple[int, int]:
    """`a..b` of numbers or times, both ends included."""
    first, dots, last = text.partition("..")
    if not dots:
        raise ValueError(f"'{text}' is not a range – write it like 1..16")
    low, high = _end_of_range(first), _end_of_range(last)
    if low > high:
        raise ValueError(f"the range {text} is empty – its first number is greater than its last")
    return low, high


def _end_of_range(text: str) -> int:
    text = text.strip()
    if _NUMBER.fullmatch(text):
        return parse_number(text)
    try:
        return parse_time(text)
    except ValueError:
        raise ValueError(f"'{text}' is neither a number nor a time") from None


def parse_places(text: str) -> tuple[int, int]:
    """Bit places `5` or `4-7`, lowest first."""
    low, dash, high = text.partition("-")
    places = parse_number(low), parse_number(high if dash else low)
    if not 0 <= places[0] <= places[1]:
        raise ValueError(f"'{text}' is not a bit or a range of bits – write it like 5 or 4-7")
    return places


def parse_constant(text: str) -> Constant:
    """A value of a table or a column: a number, a time, `h'…'` bytes, `'quoted'` or bare text."""
    text = text.strip()
    if _NUMBER.fullmatch(text):
        return parse_number(text)
    if re.fullmatch(r"h'[^']*'", text):
        try:
            return bytes.fromhex(text[2:-1])
        except ValueError:
            raise ValueError(f"{text} is not bytes – write pairs of hex digits, such as h'10 3A'") from None
    if len(text) >= 2 and text[0] == text[-1] == "'":
        return text[1:-1]
    try:
        return parse_time(text)
    except ValueError:
        return text


def parse_quoted(text: str) -> Constant:
    """Such a value in YAML's quotes: a text as it stands, but for `h'…'` and `'quoted'`, which need them."""
    inner = text.strip()
    return parse_constant(inner) if re.fullmatch(r"h?'[^']*'", inner) else text


def parse_key(text: str) -> int | str:
    """A table's key: a number, or text."""
    text = text.strip()
    return parse_number(text) if _NUMBER.fullmatch(text) else text
