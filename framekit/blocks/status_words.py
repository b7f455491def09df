"""The words in memory in which every block shows its state: counters, error, and pulses at its completions.

Where they stand is the memory profile's. Sans-I/O: the owner tells the time, and calls `tick` when `deadline` has come.
A pulse lasts one scan of the profile. A completion while a pulse is on ends that pulse first: every completion makes
exactly one rising edge, at its own moment, after its counters are in memory.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator, Mapping

from framekit.blocks.block_status import ITEMS, PULSES, BlockStatus
from framekit.definition.model.services import UNIT_BITS
from framekit.definition.times import NEVER
from framekit.memory.memory import DeviceMemory
from framekit.memory.profile import BlockItem, BlockWords

Key = tuple[int, int]
"""Set and number of a block."""


def status_sections(sections: Iterable[BlockWords]) -> tuple[BlockWords, ...]:
    """Those of a profile's sections that show the state of blocks."""
    return tuple(section for section in sections if any(name in ITEMS or name in PULSES for name in section.items))


class StatusWords:
    """Shows blocks in the words of `sections`; areas that are read-only for others are written all the same.

    `pulse` is how long a pulse lasts, in nanoseconds. Blocks for which a section has no words are not shown there.
    """

    def __init__(self, memory: DeviceMemory, sections: Iterable[BlockWords], pulse: int) -> None:
        self._memory = memory
        self._sections = tuple(sections)
        self._pulse = pulse
        self._ends: list[tuple[int, Key]] = []
        self._end_of: dict[Key, int] = {}
        self._shows = [name for name in ITEMS if any(name in section.items for section in self._sections)]
        self.shows_starts = any(
            name in self._shows for name in ("started_count", "waiting", "running", "overrun_count")
        )

    # ---- what happens -------------------------------------------------------------------------------------

    def show(self, status: BlockStatus) -> None:
        """Brings the words of a block up to date; its pulses stay as they are."""
        self._write((status.set, status.block), self._values(status))

    def completed(self, status: BlockStatus, ok: bool, now: int) -> None:
        """An exchange has ended: the counts, then the pulse of its kind."""
        key = (status.set, status.block)
        self._write(key, dict.fromkeys(PULSES, 0))
        self._write(key, self._values(status))
        if self._write(key, {"done" if ok else "failed": 1}):
            self._end_of[key] = now + self._pulse
            heapq.heappush(self._ends, (now + self._pulse, key))

    def forget(self, key: Key) -> None:
        """A block is no more: its words are 0."""
        self._end_of.pop(key, None)
        self._write(key, dict.fromkeys((*ITEMS, *PULSES), 0))

    # ---- time ---------------------------------------------------------------------------------------------

    @property
    def deadline(self) -> int:
        """When a pulse ends next."""
        return self._ends[0][0] if self._ends else NEVER

    def tick(self, now: int) -> None:
        """Ends the pulses whose time is over."""
        while self._ends and self._ends[0][0] <= now:
            _, key = heapq.heappop(self._ends)
            if self._end_of.get(key, NEVER) <= now:
                del self._end_of[key]
                self._write(key, dict.fromkeys(PULSES, 0))

    # ---- words --------------------------------------------------------------------------------------------

    def _values(self, status: BlockStatus) -> dict[str, int]:
        return {name: int(ITEMS[name](status)) for name in self._shows}

    def words(self, key: Key) -> Iterator[tuple[BlockWords, int]]:
        """The sections that have words for a block, and the first of them."""
        return words_of(self._sections, key)

    def _write(self, key: Key, values: Mapping[str, int]) -> bool:
        """Puts values in place, all words of a section at once; whether any of them has a place."""
        found = False
        for section, first in self.words(key):
            items = [(item, values[name]) for name, item in section.items.items() if name in values]
            if not items:
                continue
            found = True
            area = self._memory.area(section.area)
            words = area.read("word", first, section.words)
            before = list(words)
            for item, value in items:
                put_item(words, item, value)
            if words != before:
                area.write("word", first, words, force=True)
        return found


def words_of(sections: Iterable[BlockWords], key: Key) -> Iterator[tuple[BlockWords, int]]:
    """The sections that have words for a block, and the first of them."""
    for section in sections:
        if 1 <= key[0] <= section.sets and 0 <= key[1] < section.blocks:
            yield section, section.base(*key)


def put_item(words: list[int], item: BlockItem, value: int) -> None:
    """Puts a number where an item of a block stands; bits beyond its size are lost, so counters begin anew at 0."""
    if item.bit is not None:
        mask = 1 << item.bit
        words[item.word] = words[item.word] | mask if value else words[item.word] & ~mask
        return
    for at in range(UNIT_BITS[item.unit] // 16):
        words[item.word + at] = value >> 16 * at & 0xFFFF


def get_item(words: list[int], item: BlockItem) -> int:
    """The number that stands at an item of a block."""
    if item.bit is not None:
        return words[item.word] >> item.bit & 1
    return sum(words[item.word + at] << 16 * at for at in range(UNIT_BITS[item.unit] // 16))
