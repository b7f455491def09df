"""Check methods: the parameters of a check code; the ready methods that every definition may name.

Codes made with a key (MACs) are among them: HMAC (RFC 2104) and AES-CMAC (RFC 4493). `codec` computes all of them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from types import MappingProxyType
from typing import Literal, NamedTuple, get_args

from framekit.definition.brought import bring_word
from framekit.definition.expression import Bytes, Expression
from framekit.definition.problems import Position, Problem, plural, without_library


class Mac(NamedTuple):
    """A code of `size` bytes made with a key."""

    size: int
    key_sizes: tuple[int, ...] = ()
    """Possible sizes of the key (bytes); empty for any."""
    is_extra: bool = False
    """Whether it requires the extra `cryptography`."""


AES_KEY_SIZES = (16, 24, 32)
"""Sizes of AES keys (bytes); equal to those in `aes_key` of `codec/ciphers.py`, which generated modules include."""

MACS: Mapping[str, Mac] = {
    "hmac-md5": Mac(16),
    "hmac-sha1": Mac(20),
    "hmac-sha224": Mac(28),
    "hmac-sha256": Mac(32),
    "hmac-sha384": Mac(48),
    "hmac-sha512": Mac(64),
    "cmac-aes": Mac(16, AES_KEY_SIZES, is_extra=True),
}
"""MAC methods by name."""

LIBRARY = "cryptography"
"""Library for some codes and for ciphers; it is an extra."""


def not_installed(at: Position, what: str) -> Iterator[Problem]:
    """Report a missing library that `what` needs."""
    if find_spec(LIBRARY) is None:
        yield Problem(at, *without_library(what, LIBRARY))


def wrong_size(name: str, value: Expression, allowed: tuple[int, ...], what: str) -> Iterator[Problem]:
    """Report constant bytes in the definition whose number is not allowed."""
    if isinstance(value.root, Bytes) and len(value.root.value) not in allowed:
        fault = f"{name} has {plural(len(value.root.value), 'byte')}"
        yield Problem(value.root.at, fault, what)


CHECK_KINDS = {"sum", "word_sum", "xor", "sum7", "xor7", "or", "multiply", "crc", "fold", "code", *MACS}
Complement = Literal["ones", "twos"]
WIDEST = 128
"""Width of the widest accepted check code (bits)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckMethod:
    """A way to compute a check code of `width` bits over bytes.

    The code starts at `initial`, every byte is processed, the result is cut to `width` bits, complemented, and at last
    combined with `mask` by AND (None: every bit counts). The processing depends on `kind`:

    - `sum`: bytes are added; `sum7`: the same, cut to 7 bits.
    - `word_sum`: words of two bytes in `order` are added. An odd last byte is a word with 00 after it.
    - `xor`: bytes are combined by exclusive or; `xor7`: the same, cut to 7 bits. A width of more than 8 bits takes
      words of so many bytes in `order`, the last one filled up with 00 at its end.
    - `or`: bytes are combined by OR. `multiply`: bytes are multiplied (ready methods start at 1).
    - `crc`: polynomial division with the catalogue's parameters; `initial` is its init: the register before the first
      byte, highest power in the highest bit whatever `refin` is.
    - one of `MACS`: a code made with a key, which the check gives.
    - `code`: `expression` over `data`, all covered bytes, gives the bytes of the code; those are not shown, as of MACs.
    - `fold`: `expression` over `acc` and `byte` gives the next `acc`; compilers give it its meaning.

    `poly`, `refin`, `refout`, `xorout` are for `crc` only, `expression` for `fold` and `code` only.
    """

    name: str
    kind: str
    width: int = 8
    order: Literal["big", "little"] = "big"
    initial: int = 0
    complement: Complement | None = None
    mask: int | None = None
    poly: int = 0
    refin: bool = False
    refout: bool = False
    xorout: int = 0
    expression: Expression | None = None

    @property
    def size(self) -> int:
        """Return the size of the code as a plain number (bytes)."""
        return (self.width + 7) // 8

    @property
    def is_keyed(self) -> bool:
        """Return whether a key is required to compute the code."""
        return self.kind in MACS or self.kind == "code"

    @property
    def is_of_bytes(self) -> bool:
        """Return whether the code depends on bytes only."""
        return self.kind != "fold" and not self.is_keyed

    def fault(self) -> str | None:
        """Return the fault of the parameters, in one sentence; None if they are correct."""
        if self.kind not in CHECK_KINDS:
            return f"'{self.kind}' is no kind of check"
        if self.kind in MACS and self != CheckMethod(name=self.name, kind=self.kind, width=8 * MACS[self.kind].size):
            return f"{self.kind} takes nothing but a key"
        if not 1 <= self.width <= WIDEST and self.kind not in MACS:
            return f"a check code of {self.width} bits is not possible: 1 to {WIDEST} are"
        if self.complement not in (None, *get_args(Complement)):
            return f"the complement is 'ones' or 'twos', not '{self.complement}'"
        if self.order not in ("big", "little"):
            return f"the order is 'big' or 'little', not '{self.order}'"
        numbers = {"initial": self.initial, "mask": self.mask or 0, "poly": self.poly, "xorout": self.xorout}
        for name, value in numbers.items():
            if not 0 <= value < 1 << self.width:
                return f"{name} {value:#x} does not fit into {self.width} bits"
        if self.kind == "xor" and self.width > 8 and self.width % 8:
            return f"an exclusive or of words takes whole bytes, {self.width} bits are none"
        if self.kind == "crc" and self.poly == 0:
            return "a CRC needs its polynomial: poly"
        if (self.kind in ("fold", "code")) != (self.expression is not None):
            return "an expression belongs to a fold or a code, and only there"
        if self.kind == "code" and self.width % 8:
            return f"a code of bytes has no {self.width} bits"
        return None


CATALOGUE = Path(__file__).with_name("crc_catalogue.csv")

SIMPLE = (
    CheckMethod(name="sum8", kind="sum"),
    CheckMethod(name="sum16", kind="sum", width=16),
    CheckMethod(name="sum32", kind="sum", width=32),
    CheckMethod(name="sum7", kind="sum7", width=7),
    CheckMethod(name="wsum16", kind="word_sum", width=16),
    CheckMethod(name="wsum16-little", kind="word_sum", width=16, order="little"),
    CheckMethod(name="wsum32", kind="word_sum", width=32),
    CheckMethod(name="wsum32-little", kind="word_sum", width=32, order="little"),
    CheckMethod(name="xor8", kind="xor"),
    CheckMethod(name="xor16", kind="xor", width=16),
    CheckMethod(name="xor16-little", kind="xor", width=16, order="little"),
    CheckMethod(name="xor7", kind="xor7", width=7),
    CheckMethod(name="or8", kind="or"),
    CheckMethod(name="mul8", kind="multiply", initial=1),
    CheckMethod(name="lrc8", kind="sum", complement="twos"),
)
SIMPLE_ALIASES = {"lrc": "lrc8"}


@dataclass(frozen=True, slots=True)
class CatalogueEntry:
    """A CRC of the catalogue: its method, its other names, and its code over the nine bytes `123456789`."""

    method: CheckMethod
    aliases: tuple[str, ...]
    check: int


@cache
def crc_catalogue() -> tuple[CatalogueEntry, ...]:
    """Return every CRC of the data file, in order of width."""
    lines = CATALOGUE.read_text(encoding="ascii").splitlines()
    return tuple(_entry(line) for line in lines if line and not line.startswith("#"))


def _entry(line: str) -> CatalogueEntry:
    name, width, poly, init, refin, refout, xorout, check, aliases = line.split(",")
    method = CheckMethod(
        name=name,
        kind="crc",
        width=int(width),
        poly=int(poly, 16),
        initial=int(init, 16),
        refin=refin == "yes",
        refout=refout == "yes",
        xorout=int(xorout, 16),
    )
    return CatalogueEntry(method, tuple(aliases.split()), int(check, 16))


ADDED: dict[str, CheckMethod] = {}
"""Methods registered by programs."""


def add_method(method: CheckMethod, module: str) -> None:
    """Register a method for definitions, of a kind of its own; `module`: the module that provides it.

    Raises ValueError for a name that another module has, and for parameters that do not fit together.
    """
    fault = replace(method, kind="sum").fault()
    if fault is not None:
        raise ValueError(fault)
    is_known = method.name in ready_methods() or method.kind in CHECK_KINDS
    bring_word("check method", method.name, module, is_known)
    CHECK_KINDS.add(method.kind)
    ADDED[method.name] = method
    ready_methods.cache_clear()


@cache
def ready_methods() -> Mapping[str, CheckMethod]:
    """Return all ready methods by name and by alias; an alias returns the method with its main name."""
    methods = {method.name: method for method in SIMPLE}
    methods.update((alias, methods[name]) for alias, name in SIMPLE_ALIASES.items())
    methods.update(ADDED)
    methods.update((name, CheckMethod(name=name, kind=name, width=8 * mac.size)) for name, mac in MACS.items())
    for entry in crc_catalogue():
        methods.update((name, entry.method) for name in (entry.method.name, *entry.aliases))
    return MappingProxyType(methods)
