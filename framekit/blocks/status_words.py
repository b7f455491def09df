"""The words in memory in which every block shows its state: counters, error, and pulses at its completions.

Where they stand is the memory profile's. Sans-I/O: the owner tells the time, and calls `tick` when `deadline` has come.
A pulse lasts one scan of the profile. A completion while a pulse is on ends that pulse first: every completion makes
exactly one rising edge, at its own moment, after its counters are in memory.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable, Iterator
from struct import Struct

from framekit.blocks.block_status import ITEMS, PULSES, Countable
from framekit.definition.model.services import UNIT_BITS
from framekit.definition.times import NEVER
from framekit.memory.memory import Area, DeviceMemory
from framekit.memory.profile import BlockItem, BlockWords

Key = tuple[int, int]
"""Set and number of a block."""

_NUMBERS = {16: Struct("<H"), 32: Struct("<I"), 64: Struct("<Q")}


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
        self._places: dict[Key, tuple[_Place, ...]] = {}
        shown = {name for section in self._sections for name in section.items}
        self.shows_starts = any(name in shown for name in ("started_count", "waiting", "running", "overrun_count"))

    # ---- what happens -------------------------------------------------------------------------------------

    def show(self, key: Key, status: Countable) -> None:
        """Brings the words of a block up to date; its pulses stay as they are."""
        for place in self._places_of(key):
            place.show(status)

    def completed(self, key: Key, status: Countable, ok: bool, now: int) -> None:
        """An exchange has ended: the counts, then the pulse of its kind."""
        pulses = False
        for place in self._places_of(key):
            pulses |= place.completed(status, PULSES[0] if ok else PULSES[1])
        if pulses:
            if key not in self._end_of:
                heapq.heappush(self._ends, (now + self._pulse, key))
            self._end_of[key] = now + self._pulse

    def forget(self, key: Key) -> None:
        """A block is no more: its words are 0."""
        if self._end_of.pop(key, None) is not None:
            self._ends = [entry for entry in self._ends if entry[1] != key]
            heapq.heapify(self._ends)
        for place in self._places_of(key):
            place.clear()
        self._places.pop(key, None)

    # ---- time ---------------------------------------------------------------------------------------------

    @property
    def deadline(self) -> int:
        """When a pulse ends next, at the earliest."""
        return self._ends[0][0] if self._ends else NEVER

    def tick(self, now: int) -> None:
        """Ends the pulses whose time is over."""
        while self._ends and self._ends[0][0] <= now:
            key = self._ends[0][1]
            end = self._end_of[key]
            if end > now:  # another pulse has begun since
                heapq.heapreplace(self._ends, (end, key))
                continue
            heapq.heappop(self._ends)
            del self._end_of[key]
            for place in self._places_of(key):
                place.end_pulses()

    # ---- words --------------------------------------------------------------------------------------------

    def words(self, key: Key) -> Iterator[tuple[BlockWords, int]]:
        """The sections that have words for a block, and the first of them."""
        return words_of(self._sections, key)

    def _places_of(self, key: Key) -> tuple[_Place, ...]:
        found = self._places.get(key)
        if found is None:
            places = [_Place(self._memory.area(one.area), first, one) for one, first in self.words(key)]
            found = self._places[key] = tuple(place for place in places if place.shows_something)
        return found


class _Place:
    """The words of one block in one section, with where everything in them stands."""

    __slots__ = ("_area", "_at", "_every_pulse", "_flags", "_numbers", "_pulses", "_size", "shows_something")

    def __init__(self, area: Area, first: int, section: BlockWords) -> None:
        self._area = area
        self._at, self._size = 2 * first, 2 * section.words
        self._numbers: list[tuple[Callable[[Countable], int], Callable[..., None], int, int]] = []
        self._flags: list[tuple[Callable[[Countable], int], int]] = []
        self._pulses = dict.fromkeys(PULSES, 0)
        for name, item in section.items.items():
            read = ITEMS.get(name)
            if name in self._pulses and item.bit is not None:
                self._pulses[name] = 1 << 16 * item.word + item.bit
            elif read is not None and item.bit is not None:
                self._flags.append((read, 1 << 16 * item.word + item.bit))
            elif read is not None and (bits := UNIT_BITS[item.unit]) in _NUMBERS:
                self._numbers.append((read, _NUMBERS[bits].pack_into, 2 * item.word, (1 << bits) - 1))
        self._every_pulse = sum(self._pulses.values())
        self.shows_something = bool(self._numbers or self._flags or self._every_pulse)

    def show(self, status: Countable) -> None:
        before = self._area.read_bytes(self._at, self._size)
        self._put(before, self._shown(before, status))

    def completed(self, status: Countable, pulse: str) -> bool:
        """Whether there is a pulse for it."""
        before = self._area.read_bytes(self._at, self._size)
        if self._every_pulse:
            before = self._without_pulses(before)
        self._put(before, self._shown(before, status), self._pulses[pulse])
        return bool(self._pulses[pulse])

    def end_pulses(self) -> None:
        if self._every_pulse:
            self._without_pulses(self._area.read_bytes(self._at, self._size))

    def clear(self) -> None:
        """Everything that this place shows is 0."""
        data = bytearray(self._area.read_bytes(self._at, self._size))
        for _, pack_into, at, _ in self._numbers:
            pack_into(data, at, 0)
        bits = self._every_pulse | sum(bit for _, bit in self._flags)
        self._area.write_bytes(self._at, self._cleared(bytes(data), bits), force=True)

    def _shown(self, before: bytes, status: Countable) -> bytes:
        """The bytes with what the counts are now; bits beyond a counter's size are lost, so it begins anew at 0."""
        data = bytearray(before)
        for read, pack_into, at, most in self._numbers:
            pack_into(data, at, read(status) & most)
        if self._flags:
            bits = int.from_bytes(data, "little")
            for read, bit in self._flags:
                bits = bits | bit if read(status) else bits & ~bit
            return bits.to_bytes(self._size, "little")
        return bytes(data)

    def _put(self, before: bytes, data: bytes, pulse: int = 0) -> None:
        """The counts, if they are others, and then a pulse: both are there when the pulse is seen."""
        if pulse:
            data = (int.from_bytes(data, "little") | pulse).to_bytes(self._size, "little")
        if data != before:
            self._area.write_bytes(self._at, data, force=True)

    def _without_pulses(self, before: bytes) -> bytes:
        """Ends the pulses that are on; the bytes as they are then."""
        after = self._cleared(before, self._every_pulse)
        if after != before:
            self._area.write_bytes(self._at, after, force=True)
        return after

    def _cleared(self, data: bytes, bits: int) -> bytes:
        return (int.from_bytes(data, "little") & ~bits).to_bytes(self._size, "little")


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
