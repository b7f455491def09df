"""Watches on the words of one area: who wants to hear of which word.

A byte a word marks the watched ones, so that a write finds out at the speed of a memory scan that nobody
listens; a mask a word says which of its bits anybody wants to hear of, so that a write to its other bits is nearly as
quick. Nothing here reads or writes the area.
"""

from __future__ import annotations

import itertools
from array import array
from collections.abc import Callable, Iterator
from functools import reduce
from operator import or_
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from framekit.memory.area import Area

Changed = Callable[["Area", int, int], None]
"""Called with the area, the first changed word and the number of words from it to the last changed one."""

ALL_BITS = 0xFFFF


class Watch:
    """Interest in `count` words from `first_word` on, of each in the bits of `mask`, until `cancel`."""

    __slots__ = ("_table", "active", "area", "callback", "count", "first_word", "mask", "number")

    def __init__(
        self, table: WatchTable, area: Area, first_word: int, count: int, callback: Changed, mask: int
    ) -> None:
        self._table = table
        self.area = area
        self.first_word = first_word
        self.count = count
        self.callback = callback
        self.mask = mask
        self.number = table.next_number()
        self.active = True

    def cancel(self) -> None:
        """No further calls, not even for the write that is being reported now. Twice does no harm."""
        if self.active:
            self.active = False
            self._table.remove(self)


class WatchTable:
    """The watches of an area of `words` words.

    `marks`: 1 for a word that is watched, else 0; `masks`: which bits of each word count for anybody; `by_word`: those
    that watch a word, in order of registration.
    """

    __slots__ = ("by_word", "marks", "masks", "next_number")

    def __init__(self, words: int) -> None:
        self.next_number = itertools.count().__next__
        self.marks = bytearray(words)
        self.masks = array("H", bytes(2 * words))
        self.by_word: dict[int, tuple[Watch, ...]] = {}

    def add(self, watch: Watch) -> None:
        for word in range(watch.first_word, watch.first_word + watch.count):
            self._listen(word, (*self.by_word.get(word, ()), watch))

    def remove(self, watch: Watch) -> None:
        for word in range(watch.first_word, watch.first_word + watch.count):
            self._listen(word, tuple(other for other in self.by_word[word] if other is not watch))

    def _listen(self, word: int, watches: tuple[Watch, ...]) -> None:
        """From now on these watch the word."""
        self.marks[word] = bool(watches)
        self.masks[word] = reduce(or_, (watch.mask for watch in watches), 0)
        if watches:
            self.by_word[word] = watches
        else:
            del self.by_word[word]

    def changed(self, first: int, before: bytes, after: bytes) -> list[tuple[Watch, int, int]]:
        """In order of registration: watch, its first changed word, words from it to the last changed one.

        `before` and `after` are the bytes from word `first` on, and differ; the last word may be half a word.
        """
        found: dict[Watch, tuple[int, int]] = {}
        for word in self._watched(first, first + (len(after) + 1) // 2):
            at = 2 * (word - first)
            changed = int.from_bytes(before[at : at + 2], "little") ^ int.from_bytes(after[at : at + 2], "little")
            if changed & self.masks[word]:
                for watch in self.by_word[word]:
                    if changed & watch.mask:
                        start = found[watch][0] if watch in found else word
                        found[watch] = (start, word)
        in_order = sorted(found.items(), key=lambda item: item[0].number)
        return [(watch, start, last - start + 1) for watch, (start, last) in in_order]

    def _watched(self, first: int, end: int) -> Iterator[int]:
        word = self.marks.find(1, first, end)
        while word >= 0:
            yield word
            word = self.marks.find(1, word + 1, end)
