"""Fingerprints of model values: equal for definitions, or parts of definitions, with equal content."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from decimal import Decimal
from enum import Enum

from framekit.definition.problems import Position, Problem


def fingerprint(value: object) -> str:
    """Return a short text for a model value (dataclasses, mappings, sequences, plain values); positions do not count.

    Raises TypeError for values of other classes inside.
    """
    digest = hashlib.sha256()
    for piece in _pieces(value):
        digest.update(piece.encode())
    return digest.hexdigest()[:32]


def _pieces(value: object) -> Iterator[str]:
    """Yield the content as texts which differ where values differ."""
    if isinstance(value, (Position, Problem)):
        return
    if is_dataclass(value) and not isinstance(value, type):
        yield f"{type(value).__name__}("
        for field in fields(value):
            yield f"{field.name}="
            yield from _pieces(getattr(value, field.name))
        yield ")"
    elif value is None or isinstance(value, (str, bytes, int, float, Decimal, Enum)):
        yield f"{value!r},"
    elif isinstance(value, Mapping):
        yield "{"
        for key, item in value.items():
            yield f"{key!r}:"
            yield from _pieces(item)
        yield "}"
    elif isinstance(value, (tuple, list, frozenset, set)):
        yield "["
        for item in sorted(value, key=repr) if isinstance(value, (frozenset, set)) else value:
            yield from _pieces(item)
        yield "]"
    else:
        raise TypeError(f"a {type(value).__name__} has no fingerprint")
