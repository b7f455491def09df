"""The fixed list of functions that expressions may call, with the number of arguments each takes.

What a function does is defined where it is run; the parser and the checker only need to know that it exists.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Function:
    """A function of the language: how many arguments it takes and what kind of value it gives."""

    fewest: int
    most: int
    gives: str
    needs_engine: bool = False


FUNCTIONS: dict[str, Function] = {
    "len": Function(1, 1, "number"),
    "min": Function(1, 8, "same"),
    "max": Function(1, 8, "same"),
    "abs": Function(1, 1, "number"),
    "sum": Function(1, 1, "number"),
    "lower": Function(1, 1, "text"),
    "upper": Function(1, 1, "text"),
    "text": Function(1, 1, "text"),
    "number": Function(1, 2, "number"),
    "digits": Function(2, 3, "text"),
    "bit": Function(2, 2, "number"),
    "rotl8": Function(2, 2, "number"),
    "same": Function(1, 1, "flag"),
    "get": Function(3, 3, "any"),
    "find": Function(2, 2, "any"),
    "find_last": Function(2, 2, "any"),
    "free": Function(1, 1, "number"),
    "either": Function(2, 2, "any"),
    "none": Function(0, 0, "any"),
    "only": Function(2, 2, "flag"),
    "span": Function(2, 2, "number"),
    "ms": Function(1, 1, "time"),
    "limit": Function(1, 1, "time"),
    "empty": Function(1, 1, "flag", needs_engine=True),
    "full": Function(1, 1, "flag", needs_engine=True),
    "memory": Function(2, 2, "bytes", needs_engine=True),
    "with_date": Function(3, 3, "any", needs_engine=True),
}
