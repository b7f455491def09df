"""The check methods that every definition may name: simple sums and the CRCs of the public catalogue.

The CRCs stand in `crc_catalogue.csv`, read when a method is first asked for. Nothing here computes a code.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

from framekit.definition.model.checks import CheckMethod

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
    """Every CRC of the data file, narrow ones first."""
    lines = CATALOGUE.read_text(encoding="ascii").splitlines()
    return tuple(_entry(line) for line in lines if line and not line.startswith("#"))


def _entry(line: str) -> CatalogueEntry:
    name, width, poly, init, refin, refout, xorout, check, aliases = line.split(",")
    method = from_crc(
        name,
        width=int(width),
        poly=int(poly, 16),
        init=int(init, 16),
        refin=refin == "yes",
        refout=refout == "yes",
        xorout=int(xorout, 16),
    )
    return CatalogueEntry(method, tuple(aliases.split()), int(check, 16))


@cache
def ready_methods() -> Mapping[str, CheckMethod]:
    """All ready methods by name and by alias; an alias gives the method with its main name."""
    methods = {method.name: method for method in SIMPLE}
    methods.update((alias, methods[name]) for alias, name in SIMPLE_ALIASES.items())
    for entry in crc_catalogue():
        methods.update((name, entry.method) for name in (entry.method.name, *entry.aliases))
    return MappingProxyType(methods)


def from_ready(ready: str, /, **overrides: Any) -> CheckMethod:
    """The method named `ready` with other parameters (fields of `CheckMethod`).

    Raises KeyError for an unknown name, ValueError with one sentence when the parameters do not fit together.
    """
    return _sound(replace(ready_methods()[ready], **overrides))


def from_crc(
    name: str,
    *,
    width: int,
    poly: int,
    init: int = 0,
    refin: bool = False,
    refout: bool = False,
    xorout: int = 0,
) -> CheckMethod:
    """A CRC from its catalogue parameters. Raises ValueError with one sentence when they do not fit together."""
    return _sound(
        CheckMethod(
            name=name,
            kind="crc",
            width=width,
            poly=poly,
            initial=init,
            refin=refin,
            refout=refout,
            xorout=xorout,
        )
    )


def _sound(method: CheckMethod) -> CheckMethod:
    fault = method.fault()
    if fault is not None:
        raise ValueError(fault)
    return method
