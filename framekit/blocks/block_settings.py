"""The words in memory that hold a block's settings, and what a block is when they have been changed there.

A number that is changed while the run goes on counts from the block's next exchange on. Where the words stand is the
memory profile's; what an exchange is, is not known here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial

from framekit.blocks.block_status import ITEMS, PULSES
from framekit.blocks.fields import fixed_bytes, parts_of
from framekit.blocks.model import Block
from framekit.blocks.own_memory import read_piece
from framekit.blocks.status_words import Key, get_item, put_item, words_of
from framekit.definition.model.protocol import Protocol
from framekit.definition.problems import Problem, did_you_mean
from framekit.link.packing import memory_of, values_of
from framekit.memory.memory import Area, DeviceMemory, unit_bits
from framekit.memory.profile import BlockItem, BlockWords

SLOTS = 4
"""Variables of a block that have settings."""

PLACES = {f"{kind}_{number}": (kind, number - 1) for kind in ("read", "write") for number in range(1, SLOTS + 1)}
SIZES = {f"{name}_size": slot for name, slot in PLACES.items()}
SETTINGS = ("station", *PLACES, *SIZES)
"""What the words of a block can set, by the names that memory profiles use."""

KINDS = {"read": "read", "receive": "read", "write": "write", "send": "write"}


class SettingError(ValueError):
    """A number in memory that a block cannot work with."""


@dataclass(frozen=True, slots=True)
class _Slot:
    """A variable of a block: how its place is written, its size, and what sets that: `count` or a field's name."""

    text: str
    size: int
    sets: str | None = None


class _Given:
    """The words of one section for a block as the run gives them, and where they stand: from word `first` of `area`."""

    __slots__ = ("area", "data", "first", "section", "words")

    def __init__(self, section: BlockWords, area: Area, first: int, words: list[int]) -> None:
        self.section = section
        self.area = area
        self.first = first
        self.words = words
        self.data = memory_of(words, "word")

    def put(self, item: BlockItem, value: int) -> None:
        """Another value for one item."""
        put_item(self.words, item, value)
        self.data = memory_of(self.words, "word")


def settings_sections(sections: Iterable[BlockWords]) -> tuple[BlockWords, ...]:
    """Those of a profile's sections that hold settings of blocks."""
    return tuple(section for section in sections if any(name in SETTINGS for name in section.items))


class BlockSettings:
    """Shows the settings of blocks in the words of `sections`, and reads them back before each exchange."""

    def __init__(self, memory: DeviceMemory, sections: Iterable[BlockWords]) -> None:
        self._memory = memory
        self._sections = tuple(sections)
        self._protocols: dict[Key, Protocol] = {}
        self._given: dict[Key, list[_Given]] = {}

    def show(self, block: Block, protocol: Protocol) -> None:
        """Puts a block's settings into its words, as the run gives them, over what stood there."""
        key = (block.set, block.number)
        self._protocols[key] = protocol
        shown = []
        for section, first in self.words(key):
            words = [0] * section.words
            for item, value in self._items(section, block, protocol):
                put_item(words, item, value)
            area = self._memory.area(section.area)
            area.write("word", first, words, force=True)
            shown.append(_Given(section, area, first, words))
        self._given[key] = shown

    def words(self, key: Key) -> Iterator[tuple[BlockWords, int]]:
        """The sections that have words for a block, and the first of them."""
        return words_of(self._sections, key)

    def forget(self, key: Key) -> None:
        """A block is no more: its words are free memory, and 0."""
        self._protocols.pop(key, None)
        for given in self._given.pop(key, ()):
            given.area.write("word", given.first, [0] * len(given.words), force=True)

    # ---- what the words say -------------------------------------------------------------------------------

    def _items(self, section: BlockWords, block: Block, protocol: Protocol) -> list[tuple[BlockItem, int]]:
        found = []
        slots = slots_of(block, protocol)
        kind = KINDS.get(block.instruction)
        for name, item in section.items.items():
            if name == "station" and isinstance(block.station, int):
                found.append((item, block.station))
            elif name in PLACES and PLACES[name][0] == kind and PLACES[name][1] < len(slots):
                text = slots[PLACES[name][1]].text
                found += _as_words(text, item)
            elif name in SIZES and SIZES[name][0] == kind and SIZES[name][1] < len(slots):
                found.append((item, slots[SIZES[name][1]].size))
        return found

    def effective(self, block: Block) -> Block:
        """The block with what stands in memory now; the same one while nothing has been changed there.

        What is only shown is put back where it was written over.

        Raises SettingError for a station or a size it cannot work with.
        """
        changed = block
        for given in self._given.get((block.set, block.number), ()):
            if block.station_from is not None:
                self._show_station(given, block)
            if not given.area.holds(2 * given.first, given.data):
                words = given.area.read("word", given.first, len(given.words))
                changed = self._changed(changed, given, words)
        return changed

    def unchanged(self, block: Block) -> Callable[[], bool]:
        """Tells at every call whether `effective` would give the block itself; for one with a station of its own."""
        holds = [
            given.area.holder(2 * given.first, given.data) for given in self._given.get((block.set, block.number), ())
        ]
        return holds[0] if len(holds) == 1 else lambda: all(one() for one in holds)

    def _show_station(self, given: _Given, block: Block) -> None:
        """A station that the run takes from elsewhere is only shown."""
        item, place = given.section.items.get("station"), block.station_from
        if item is None or place is None or self._protocols[block.set, block.number].station.type != "number":
            return
        number = values_of(read_piece(self._memory, place, place.address.unit_bits), place.address.unit, 1)[0]
        given.put(item, number)
        words = given.area.read("word", given.first, len(given.words))
        put_item(words, item, number)
        given.area.write("word", given.first, words, force=True)

    def _changed(self, block: Block, given: _Given, words: list[int]) -> Block:
        section, shown = given.section, list(given.words)
        settable = [(item, slot, get_item(words, item)) for item, slot in self._settable(block, section)]
        for item, _, value in settable:
            put_item(shown, item, value)
        if shown != words:
            given.area.write("word", given.first, shown, force=True)
        for item, slot, value in settable:
            if value != get_item(given.words, item):
                where = f"{section.area} word {section.base(block.set, block.number) + item.word}"
                with_it = self._with_station if slot is None else partial(self._with_size, slot)
                block = with_it(block, value, where)
        return block

    def _settable(self, block: Block, section: BlockWords) -> Iterator[tuple[BlockItem, _Slot | None]]:
        """The items that count when they are changed, each with its variable; None: the station."""
        slots = slots_of(block, self._protocols[block.set, block.number])
        kind = KINDS.get(block.instruction)
        for name, item in section.items.items():
            if name == "station" and isinstance(block.station, int) and block.station_from is None:
                yield item, None
            elif name in SIZES and SIZES[name][0] == kind and SIZES[name][1] < len(slots):
                slot = slots[SIZES[name][1]]
                if slot.sets is not None:
                    yield item, slot

    def _with_station(self, block: Block, station: int, where: str) -> Block:
        limits = self._protocols[block.set, block.number].station.limits
        if limits is not None and not limits[0] <= station <= limits[1]:
            raise SettingError(f"station {station} in {where} is not in {limits[0]}..{limits[1]}")
        return replace(block, station=station)

    def _with_size(self, slot: _Slot, block: Block, size: int, where: str) -> Block:
        assert slot.sets is not None
        if size < 1:
            raise SettingError(f"the size in {where} is 0: that moves nothing")
        if slot.sets != "count":
            return replace(block, sizes={**block.sizes, slot.sets: size})
        place = block.places[0]
        if place.address.first_bit + size * unit_bits(block.units[0]) > self._memory.area(place.address.area).size_bits:
            raise SettingError(f"the size {size} in {where} leaves no room from {place.text} on")
        return replace(block, count=size)


def slots_of(block: Block, protocol: Protocol) -> list[_Slot]:
    """The variables of a block, at most four: those of the other side for READ and WRITE, fields of a frame else."""
    if block.instruction in ("read", "write"):
        if len(block.targets) > 1:
            return [_Slot(text, 1) for text in block.targets[:SLOTS]]
        settable = "count" if block.places and block.values is None else None
        return [_Slot(text, block.count, settable) for text in block.targets]
    if block.frame is None:
        return []
    parts = dict(parts_of(protocol.frames[block.frame].segments))
    fixed = {name: fixed_bytes(parts[name]) for name in block.data}
    return [
        _Slot(place.text, block.sizes.get(name) or fixed[name] or 0, name if name in block.sizes else None)
        for name, place in list(block.data.items())[:SLOTS]
    ]


def _as_words(text: str, item: BlockItem) -> list[tuple[BlockItem, int]]:
    """An address as text, two characters a word, the first in the low byte; one that is too long is not shown."""
    data = text.encode("ascii", "replace").ljust(2 * item.words, b"\0")
    if len(data) > 2 * item.words:
        return []
    return [
        (BlockItem(word=item.word + at), int.from_bytes(data[2 * at : 2 * at + 2], "little"))
        for at in range(item.words)
    ]


def check_items(sections: Iterable[BlockWords]) -> Iterator[Problem]:
    """Items of a profile that no block has."""
    known = {*ITEMS, *PULSES, *SETTINGS}
    for section in sections:
        for name in section.items:
            if name not in known:
                yield Problem(section.at, f"'{name}' in '{section.name}' is nothing a block has", _hint(name, known))


def _hint(name: str, known: set[str]) -> str:
    return did_you_mean(name, known) or f"known: {', '.join(sorted(known))}"
