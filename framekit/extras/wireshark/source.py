"""Build Lua source: texts, names, numbers. Only this module turns text of a definition into Lua.

`string` makes a literal of any text or bytes, `comment` a comment of any text. All other text comes from the generator.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Any

from framekit.definition.problems import CannotSayError, Position

EXACT = 1 << 53
"""Lua represents whole numbers below this limit exactly."""


def not_said(at: Position, what: str) -> CannotSayError:
    """Return the error for a part without a Lua form."""
    return CannotSayError(at, what, "where it is reached, the frame is shown as bytes")


def string(value: str | bytes) -> str:
    """Return a literal: letters, digits, spaces and some punctuation unchanged, every other byte as three digits.

    Text of a definition is bytes (latin-1); text with other characters is encoded as UTF-8, as in messages.
    """
    if isinstance(value, bytes):
        data = value
    else:
        data = value.encode("latin-1" if all(ord(sign) < 256 for sign in value) else "utf-8")
    return '"' + "".join(map(_sign, data)) + '"'


def utf8(text: str) -> str:
    """Return a literal of text for display."""
    return string(text.encode("utf-8"))


def _sign(byte: int) -> str:
    sign = chr(byte)
    return sign if (byte < 128 and sign.isalnum()) or sign in " _.,:;()+*/=<>!?'-" else f"\\{byte:03d}"


def comment(text: str) -> str:
    """Return a comment with any text, on a single line."""
    shown = "".join(sign if sign.isascii() and sign.isprintable() else " " for sign in text)
    return f"-- {shown}".rstrip()


def number(value: int, at: Position) -> str:
    """Return an exact whole number. Raises CannotSayError for numbers of more than 53 bits."""
    if abs(value) >= EXACT:
        raise not_said(at, f"the number {value}, which has more than 53 bits")
    return str(value) if value >= 0 else f"({value})"


def identifier(name: str) -> str:
    """Return a name for Wireshark fields: lower-case letters, digits and underscores."""
    return re.sub(r"[^a-z0-9_]", "_", name.lower())


def table(entries: Mapping[str, Any]) -> str:
    """Return a table of Lua sources by names of the generator; entries of None are omitted."""
    return "{ " + ", ".join(f"{name} = {text}" for name, text in entries.items() if text is not None) + " }"


def listed(texts: Iterable[str]) -> str:
    """Return a list of Lua sources."""
    return "{ " + ", ".join(texts) + " }"


def flag(value: object) -> str | None:
    """Return `true`, or None for a false value, which needs no entry."""
    return "true" if value else None
