"""Build C source: lines, names, texts. Only this module turns text of a definition into C.

`identifier` makes a C name of any text, `string` a literal of any bytes, `comment` a comment of any text. All other
text of a line comes from the generator, or is a number.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager

from framekit.definition.problems import NOWHERE, CannotSayError, Position

INDENT = "    "

_WORDS = """
auto break case char const continue default do double else enum extern float for goto if inline int long register
restrict return short signed sizeof static struct switch typedef union unsigned void volatile while asm fortran bool
true false nullptr constexpr alignas alignof static_assert thread_local typeof typeof_unqual catch class const_cast
delete dynamic_cast explicit export friend mutable namespace new operator private protected public reinterpret_cast
static_cast template this throw try typeid typename using virtual wchar_t char8_t char16_t char32_t concept requires
decltype noexcept co_await co_return co_yield and and_eq bitand bitor compl not not_eq or or_eq xor xor_eq NULL EOF
errno offsetof assert unix linux i386 arm vax pascal far near huge interrupt SIZE_MAX WCHAR_MAX WCHAR_MIN memcpy
memcmp memset memmove memchr
"""
_KEYWORDS = frozenset(_WORDS.split())
"""Words of C and C++, and macros of the included headers and of compilers."""
_MACROS = re.compile(
    r"U?INT(_LEAST|_FAST)?(8|16|32|64)_(C|MIN|MAX)|U?INT(MAX|PTR)_(C|MIN|MAX)|(PTRDIFF|SIG_ATOMIC|WINT)_M.*"
)


def identifier(name: str) -> str:
    """Return a C name for any text: other characters than letters, digits and _ become _.

    Reserved words get a trailing _.
    """
    found = "".join(sign if sign.isascii() and (sign.isalnum() or sign == "_") else "_" for sign in name)
    if not found or not found[0].isalpha():
        found = f"x{found}"
    while "__" in found:  # C++ reserves names with two consecutive underscores
        found = found.replace("__", "_")
    return f"{found}_" if found in _KEYWORDS or _MACROS.fullmatch(found) else found


class CNames:
    """The names of a C scope; two sources with the same name are refused."""

    def __init__(self, where: str) -> None:
        self.where = where
        self.taken: dict[str, str] = {}

    def take(self, name: str, of: str, at: Position = NOWHERE) -> str:
        """Reserve a C name for a purpose. Raises CannotSayError if the name is reserved for another purpose."""
        other = self.taken.setdefault(name, of)
        if other != of:
            raise CannotSayError(at, f"{of} and {other} are both called '{name}' in {self.where}", "rename one of them")
        return name


def string(data: bytes) -> str:
    """Return a string literal of these bytes: letters and digits unchanged, every other byte as three octal digits."""
    # an escape takes at most three octal digits, so a digit after it is separate
    shown = (chr(byte) if byte < 128 and chr(byte).isalnum() else f"\\{byte:03o}" for byte in data)
    return f'"{"".join(shown)}"'


def comment(text: str) -> str:
    """Return a comment with any text, on a single line."""
    shown = text.encode("ascii", "backslashreplace").decode("ascii")
    shown = "".join(sign if sign.isprintable() else " " for sign in shown)
    shown = shown.replace("*/", "* /").replace("/*", "/ *")
    while "??" in shown:
        shown = shown.replace("??", "? ?")
    return f"/* {shown.rstrip(chr(92) + ' ')} */"


def number(value: int) -> str:
    """Return a literal of a whole number of at most 64 bits."""
    if value == -(1 << 63):
        return "INT64_MIN"
    if value < 0:
        return f"(-{number(-value)})"
    if value > (1 << 63) - 1:
        return f"UINT64_C({value})"
    return str(value) if value < 1 << 31 else f"INT64_C({value})"


class CSource:
    """The lines of a function; `block` puts braces around the lines added inside it."""

    def __init__(self, depth: int = 0) -> None:
        self.lines: list[str] = []
        self.depth = depth

    def add(self, *lines: str) -> None:
        self.lines.extend(f"{INDENT * self.depth}{line}" if line else "" for line in lines)

    def extend(self, other: CSource) -> None:
        """Add the lines of another source at the current indentation."""
        self.add(*other.lines)

    @contextmanager
    def block(self, header: str, behind: str = "") -> Iterator[None]:
        self.add(f"{header} {{" if header else "{")
        self.depth += 1
        try:
            yield
        finally:
            self.depth -= 1
            self.add(f"}}{behind}")

    def when(self, test: str, *lines: str) -> None:
        """Add lines that run if a condition holds."""
        with self.block(f"if ({test})"):
            self.add(*lines)

    def text(self) -> str:
        return "\n".join(self.lines) + "\n"
