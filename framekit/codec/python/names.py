"""Identifiers for what a definition names: valid, readable, and clashing with nothing.

It knows Python's words and those that generated modules use themselves.
"""

from __future__ import annotations

import builtins
import keyword
import re
from collections.abc import Iterable

OWN_WORDS = frozenset(
    {
        "at", "behind", "binascii", "computed", "ctx", "data", "end", "error", "frame", "n", "raw",
        "seen", "size", "start", "stop", "struct", "unhexlify", "values",
    }
)  # fmt: skip
"""Parameters, locals and modules that generated functions use themselves."""

_PYTHON = OWN_WORDS | {*dir(builtins), *keyword.kwlist, "match", "case", "type"}
_OWN_PREFIXES = ("decode_", "encode_", "examine_", "measure_", "inner_", "pack_", "unpack_", "parse_", "build_")


def identifier(name: str) -> str:
    """`name` as an identifier in lower case: `WR.REQ` is `wr_req`, `7th` is `_7th`."""
    text = re.sub(r"[^0-9a-z_]", "_", name.lower()).strip("_") or "unnamed"
    return f"_{text}" if text[0].isdigit() else text


def constant_name(*names: str) -> str:
    """Names put together as a module constant: `READ_REPLY_HEAD`, `_7TH_HEAD`."""
    return identifier("_".join(identifier(name).strip("_") for name in names)).upper()


class Identifiers:
    """Gives out names that are not taken yet. `reserved` are those that may never be given out."""

    def __init__(self, reserved: Iterable[str] = ()) -> None:
        self._taken = {*reserved, *_PYTHON}

    def fresh(self, name: str) -> str:
        """`name` as an identifier nobody has yet: with `_` or `_2`, `_3` … behind if need be."""
        wanted = identifier(name)
        if wanted.startswith(_OWN_PREFIXES):
            wanted += "_"
        return self._take(wanted)

    def reserve(self, names: Iterable[str]) -> None:
        """Names that somebody has already."""
        self._taken.update(names)

    def constant(self, *names: str) -> str:
        """A module constant nobody has yet."""
        return self._take(constant_name(*names))

    def _take(self, wanted: str) -> str:
        found, number = wanted, 1
        while found in self._taken:
            number += 1
            found = f"{wanted.rstrip('_')}_" if number == 2 else f"{wanted.rstrip('_')}_{number - 1}"
        self._taken.add(found)
        return found
