"""Neighbouring reads of one station as one: which go together, and which part of the data is whose.

Addresses are places of the other side. Who waits for what, and how the read is done, is not known here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

from framekit.blocks.model import Merge
from framekit.link.addresses import Address, AddressError, AddressGrammar

Key = TypeVar("Key")


@dataclass(frozen=True, slots=True)
class Read(Generic[Key]):
    """`count` elements from `address` on, for `key`."""

    key: Key
    address: Address
    count: int

    @property
    def end(self) -> int:
        return self.address.start + self.count


def neighbours(first: Read[Key], others: Sequence[Read[Key]], merge: Merge, grammar: AddressGrammar) -> list[Read[Key]]:
    """Those of the others that one read can bring with the first: no gap too wide, not too many elements in all."""
    chosen = [first]
    least, end = first.address.start, first.end
    added = True
    while added:
        added = False
        for other in others:
            if other in chosen or not _same_row(first.address, other.address, grammar):
                continue
            gap = max(other.address.start - end, least - other.end, 0)
            low, high = min(least, other.address.start), max(end, other.end)
            if gap <= merge.gap and (merge.most is None or high - low <= merge.most):
                chosen.append(other)
                least, end, added = low, high, True
    return chosen[1:]


def _same_row(one: Address, other: Address, grammar: AddressGrammar) -> bool:
    """Whether the second place is so many elements from the first: a file or another table is somewhere else."""
    if (one.area, one.unit) != (other.area, other.unit):
        return False
    try:
        return grammar.print(grammar.advance(one, other.start - one.start)) == grammar.print(grammar.advance(other, 0))
    except AddressError:
        return False


def joined(reads: Sequence[Read[Key]]) -> tuple[Address, int]:
    """Where one read for all of them begins, and how many elements it has."""
    first = min(reads, key=lambda read: read.address.start)
    return first.address, max(read.end for read in reads) - first.address.start
