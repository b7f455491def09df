"""Lua source being written: texts, names, numbers. This is the one place where text of a definition becomes Lua.

`string` makes the literal of any text or bytes, `comment` a comment of any text. All other text is the generator's own.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Any

from framekit.definition.problems import CannotSayError, Position

EXACT = 1 << 53
"""Numbers of Lua are exact below this."""


def not_said(at: Position, what: str) -> CannotSayError:
    """What has no form in Lua."""
    return CannotSayError(at, what, "where it is reached, the frame is shown as bytes")


def string(value: str | bytes) -> str:
    """A literal: letters, digits, spaces and a few signs as they are, every other byte as three digits.

    Text of a definition is of bytes (latin-1); other signs are those of UTF-8, as messages show them.
    """
    if isinstance(value, bytes):
        data = value
    else:
        data = value.encode("latin-1" if all(ord(sign) < 256 for sign in value) else "utf-8")
    return '"' + "".join(map(_sign, data)) + '"'


def utf8(text: str) -> str:
    """A literal of text that is shown to people."""
    return string(text.encode("utf-8"))


def _sign(byte: int) -> str:
    sign = chr(byte)
    return sign if (byte < 128 and sign.isalnum()) or sign in " _.,:;()+*/=<>!?'-" else f"\\{byte:03d}"


def comment(text: str) -> str:
    """A comment of any text, on one line."""
    shown = "".join(sign if sign.isascii() and sign.isprintable() else " " for sign in text)
    return f"-- {shown}".rstrip()


def number(value: int, at: Position) -> str:
    """A whole number that is exact. Raises CannotSayError for others."""
    if abs(value) >= EXACT:
        raise not_said(at, f"the number {value}, which has more than 53 bits")
    return str(value) if value >= 0 else f"({value})"


def identifier(name: str) -> str:
    """A name for fields of Wireshark: small letters, digits and _."""
    return re.sub(r"[^a-z0-9_]", "_", name.lower())


def table(entries: Mapping[str, Any]) -> str:
    """A table of texts that are Lua already, by names of the generator; those that are None are left out."""
    return "{ " + ", ".join(f"{name} = {text}" for name, text in entries.items() if text is not None) + " }"


def listed(texts: Iterable[str]) -> str:
    """A list of texts that are Lua already."""
    return "{ " + ", ".join(texts) + " }"


def flag(value: object) -> str | None:
    """`true`, or nothing to write."""
    return "true" if value else None
