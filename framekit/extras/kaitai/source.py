"""Write names and texts of a Kaitai file."""

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
"""Reserved words of Kaitai's target languages; a name that equals one gets a trailing underscore."""
_TYPES = re.compile(r"[usf]\d+(le|be)?|b\d+(le|be)?|strz?|bytes|bool|any|io|struct")
"""Built-in types of Kaitai, which cannot be names of other types."""
_CLASSES = {"true", "false", "none", "kaitai_struct", "kaitai_stream", "int_enum", "bytes_io"}
"""Type names whose class would collide with a class of Python or of Kaitai's runtime."""


def identifier(text: str) -> str:
    """Return a name that Kaitai allows: lower-case letters, digits and underscores, with a letter first."""
    name = re.sub(r"[^a-z0-9_]", "_", text.lower()).strip("_") or "x"
    name = name if name[0].isalpha() else f"n{name}"
    return f"{name}_" if name in _WORDS else name


def type_identifier(text: str) -> str:
    """Return a name for a type that is not used by Kaitai or a target language."""
    name = identifier(text)
    plain = name.rstrip("_")
    return f"{plain}_type" if _TYPES.fullmatch(plain) or plain in _CLASSES else name


class KsyNames:
    """Unique names of one namespace. Names that differ only in underscores or case collide in some target languages."""

    def __init__(self, taken: Iterable[str] = ()) -> None:
        self._taken = {_squashed(one) for one in taken}
        self._numbers: dict[str, int] = {}
        """The next number for a duplicate of each requested name."""

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
    """Return a text for `doc` on one line, without sequences that could end a comment.

    Kaitai copies these texts into comments of other languages.
    """
    text = printable(" ".join(text.split())).translate(_PROSE)
    return re.sub(r"(?<=[*/\]#])(?=[*/#])", " ", text)


_PROSE = str.maketrans({'"': "'", "\\": "/"})


def string(text: str) -> str:
    """Return a text literal with all but plain characters escaped; a character beyond 16 bits becomes U+FFFF."""
    plain = (one if one.isascii() and one.isprintable() and one not in '"\\' else _escaped(one) for one in text)
    return f'"{"".join(plain)}"'


def _escaped(sign: str) -> str:
    return f"\\u{ord(sign):04x}" if ord(sign) < 0x1_0000 else "\\uffff"


def data(value: bytes) -> str:
    """Return a bytes literal."""
    return f"[{', '.join(map(hex, value))}].as<bytes>"
