"""Names and texts of a Kaitai file being written, and what has no form in one."""

from __future__ import annotations

import keyword
import re
from collections.abc import Iterable

from framekit.definition.problems import printable

_WORDS = {one.lower() for one in keyword.kwlist} | set(
    re.findall(
        r"\w+",
        """
    abstract auto base bool boolean byte case catch char const debugger default delegate delete do double enum
    explicit export extends extern final fixed float foreach friend func function go goto implements inline
    instanceof int interface internal let local long map module mro mutable namespace native new nil null object
    operator out package params private property protected public range register require self short signed sizeof static
    string struct super switch synchronized template then this throw throws typedef typeof union unless unsigned
    until using var virtual void volatile when close end begin
    """,
    )
)
"""Words of languages that Kaitai compiles to; a name that is one of them gets a `_` behind it."""
_TYPES = re.compile(r"[usf]\d+(le|be)?|b\d+(le|be)?|strz?|bytes|bool|any|io|struct")
"""Types that Kaitai has itself: a type of such a name would be one of them."""
_CLASSES = {"true", "false", "none", "kaitai_struct", "kaitai_stream", "int_enum", "bytes_io"}
"""What makes a class that Python has already, or cannot have."""


def identifier(text: str) -> str:
    """A name as Kaitai allows it: small letters, digits and `_`, a letter first."""
    name = re.sub(r"[^a-z0-9_]", "_", text.lower()).strip("_") or "x"
    name = name if name[0].isalpha() else f"n{name}"
    return f"{name}_" if name in _WORDS else name


def type_identifier(text: str) -> str:
    """A name of a type: none that Kaitai, or a language, has already."""
    name = identifier(text)
    plain = name.rstrip("_")
    return f"{plain}_type" if _TYPES.fullmatch(plain) or plain in _CLASSES else name


class KsyNames:
    """Names of one place, each given once. Two that differ in `_` and capitals only are one in some languages."""

    def __init__(self, taken: Iterable[str] = ()) -> None:
        self._taken = {_squashed(one) for one in taken}
        self._numbers: dict[str, int] = {}
        """The name that is wanted → the next number for another one like it."""

    def new(self, text: str) -> str:
        return self._given(identifier(text))

    def new_type(self, text: str) -> str:
        return self._given(type_identifier(text))

    def _given(self, wanted: str) -> str:
        name, number = wanted, self._numbers.get(wanted, 2)
        while _squashed(name) in self._taken:
            name, number = f"{wanted.rstrip('_')}_{number}", number + 1
        self._numbers[wanted] = number
        self._taken.add(_squashed(name))
        return name


def _squashed(name: str) -> str:
    return name.replace("_", "")


def prose(text: str) -> str:
    """A text for `doc`, on one line: Kaitai copies it into comments, and does not keep it from ending them."""
    text = printable(" ".join(text.split())).translate(_PROSE)
    return re.sub(r"(?<=[*/\]#])(?=[*/#])", " ", text)


_PROSE = str.maketrans({'"': "'", "\\": "/"})


def string(text: str) -> str:
    """A text in an expression: every sign but plain ones by its number. What no byte is becomes one that none is."""
    plain = (one if one.isascii() and one.isprintable() and one not in '"\\' else _escaped(one) for one in text)
    return f'"{"".join(plain)}"'


def _escaped(sign: str) -> str:
    return f"\\u{ord(sign):04x}" if ord(sign) < 0x1_0000 else "\\uffff"


def data(value: bytes) -> str:
    """Bytes in an expression."""
    return f"[{', '.join(map(hex, value))}].as<bytes>"
