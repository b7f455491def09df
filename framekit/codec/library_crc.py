"""CRC functions of a compiled library: which of them computes a check method, found out by what they give.

The library has many CRCs by name, in Rust: six bytes take a tenth of the time of a table in Python, 255 a thirtieth.
Its functions are compared with our own on bytes of every kind, so no name or parameter of it has to be known here.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib import import_module
from typing import Any

from framekit.codec import support
from framekit.definition.model.checks import CheckMethod

_MODULES = {width: f"fastcrc.crc{width}" for width in (8, 16, 32, 64)}
_SAMPLES = (b"", b"123456789", bytes(range(256)), *(bytes([value]) for value in range(0, 256, 5)))


@dataclass(frozen=True, slots=True)
class LibraryCrc:
    """A function of the library, and what is put on its result by exclusive or."""

    module: str
    name: str
    xor: int

    @property
    def alias(self) -> str:
        """What generated modules call it; upper case, as no local of theirs."""
        return f"{self.module.rpartition('.')[2]}_{self.name}".upper()

    @property
    def import_line(self) -> str:
        return f"from {self.module} import {self.name} as {self.alias}"


@cache
def library_crc(method: CheckMethod) -> LibraryCrc | None:
    """The library's function for a CRC; None if it has none."""
    module = _MODULES.get(method.width)
    if module is None or method.kind != "crc":
        return None
    wanted, found = _codes(method), list[LibraryCrc]()
    for name, codes in _library(module):
        difference = wanted[0] ^ codes[0]
        if all(own ^ other == difference for own, other in zip(wanted, codes, strict=True)):
            found.append(LibraryCrc(module, name, difference))
    return min(found, key=lambda crc: (crc.xor != 0, crc.name), default=None)


def _codes(method: CheckMethod) -> list[int]:
    """Our own codes of the samples."""
    table = support.make_crc_table(method.width, method.poly, method.refin)
    rest = method.width, method.initial, method.refin, method.refout, method.xorout
    return [support.crc(sample, table, *rest) for sample in _SAMPLES]


@cache
def _library(module: str) -> list[tuple[str, list[int]]]:
    """The functions of one of the library's modules by name, with their codes of the samples."""
    functions: Any = import_module(module)
    names = sorted(functions.algorithms_available)
    return [(name, [getattr(functions, name)(sample) for sample in _SAMPLES]) for name in names]
