"""Static sizes: the least and most bytes that something takes, whatever it holds."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

MOST_BYTES = 1_048_576
"""Bytes of a frame, and items of its lists, at most."""


@dataclass(frozen=True, slots=True)
class Sizes:
    """Least and most bytes on the wire; `most` is None where there is no bound."""

    least: int
    most: int | None

    @property
    def fixed(self) -> int | None:
        return self.least if self.least == self.most else None

    def __add__(self, other: Sizes) -> Sizes:
        most = None if self.most is None or other.most is None else self.most + other.most
        return Sizes(self.least + other.least, most)

    def times(self, least: int, most: int | None) -> Sizes:
        bound = None if self.most is None or most is None else self.most * most
        return Sizes(self.least * least, 0 if self.most == 0 else bound)


NOTHING = Sizes(0, 0)
ANY = Sizes(0, None)


def exactly(size: int) -> Sizes:
    return Sizes(size, size)


def either(sizes: Iterable[Sizes]) -> Sizes:
    """The sizes of one of several possibilities."""
    found = list(sizes)
    if not found:
        return NOTHING
    most = [size.most for size in found]
    return Sizes(min(size.least for size in found), None if None in most else max(m for m in most if m is not None))


def of_any_frame(name: str) -> Sizes:
    """The sizes of a frame where frames are not known."""
    return ANY
