"""Watches on the words of one area: who wants to hear of which word.

A byte a word marks the watched ones, so that a write finds out at the speed of a memory scan that nobody
listens; only changed words somebody watches are looked at one by one. Nothing here reads or writes the area.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from framekit.memory.area import Area

Changed = Callable[["Area", int, int], None]
"""Called with the area, the first changed word and the number of words from it to the last changed one."""


class Watch:
    """Interest in `count` words of an area from `first_word` on, until `cancel`."""

    __slots__ = ("_table", "active", "area", "callback", "count", "first_word", "number")

    def __init__(self, table: WatchTable, area: Area, first_word: int, count: int, callback: Changed) -> None:
        self._table = table
        self.area = area
        self.first_word = first_word
        self.count = count
        self.callback = callback
        self.number = table.next_number()
        self.active = True

    def cancel(self) -> None:
        """No further calls, not even for the write that is being reported now. Twice does no harm."""
        if self.active:
            self.active = False
            self._table.remove(self)


class WatchTable:
    """The watches of an area of `words` words."""

    __slots__ = ("_by_word", "_marks", "next_number")

    def __init__(self, words: int) -> None:
        self.next_number = itertools.count().__next__
        self._marks = bytearray(words)
        self._by_word: dict[int, tuple[Watch, ...]] = {}

    def add(self, watch: Watch) -> None:
        for word in range(watch.first_word, watch.first_word + watch.count):
            self._marks[word] = 1
            self._by_word[word] = (*self._by_word.get(word, ()), watch)

    def remove(self, watch: Watch) -> None:
        for word in range(watch.first_word, watch.first_word + watch.count):
            left = tuple(other for other in self._by_word[word] if other is not watch)
            if left:
                self._by_word[word] = left
            else:
                del self._by_word[word]
                self._marks[word] = 0

    def touches(self, first: int, last: int) -> bool:
        """Whether one of the words `first`..`last` is watched."""
        return self._marks.find(1, first, last + 1) >= 0

    def changed(self, first: int, before: bytes, after: bytes) -> list[tuple[Watch, int, int]]:
        """In order of registration: watch, its first changed word, words from it to the last changed one.

        `before` and `after` are the bytes from word `first` on, and differ; the last word may be half a word.
        """
        if len(after) <= 2:  # the usual write: one word, which has changed
            return [(watch, first, 1) for watch in self._by_word.get(first, ())]
        found: dict[Watch, tuple[int, int]] = {}
        for word in self._watched(first, first + (len(after) + 1) // 2):
            at = 2 * (word - first)
            if before[at : at + 2] == after[at : at + 2]:
                continue
            for watch in self._by_word[word]:
                start = found[watch][0] if watch in found else word
                found[watch] = (start, word)
        in_order = sorted(found.items(), key=lambda item: item[0].number)
        return [(watch, start, last - start + 1) for watch, (start, last) in in_order]

    def _watched(self, first: int, end: int) -> Iterator[int]:
        word = self._marks.find(1, first, end)
        while word >= 0:
            yield word
            word = self._marks.find(1, word + 1, end)
