"""Memory profiles: the areas of a device family, how its places are written, and what has a meaning of its own.

A profile is the content of a file `NAME.memory.yaml`. What an address written in one of its forms means is
not known here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from framekit.definition.model.services import AddressForm
from framekit.definition.model.services import Area as AreaModel
from framekit.definition.model.values import Table
from framekit.definition.problems import Position
from framekit.memory.area import Area
from framekit.memory.memory import DeviceMemory

FixedKind = Literal["on", "off", "first_scan", "after_first_scan", "every_scan"]


@dataclass(frozen=True, slots=True, kw_only=True)
class ProfileArea(AreaModel):
    """An area of a profile: what an area of a protocol is, with other names for it.

    `retained`: its content outlasts a restart, where a run keeps its state.
    """

    aliases: tuple[str, ...] = ()
    retained: bool = False
    about: str = ""


@dataclass(frozen=True, slots=True)
class ClockBit:
    """A bit that is on for half of `period` nanoseconds and off for the other; `address` as it is written."""

    address: str
    period: int
    at: Position


@dataclass(frozen=True, slots=True)
class FixedBit:
    """A bit that is always on or off, on or off during the first scan only, or changes with every scan."""

    address: str
    kind: FixedKind
    at: Position


@dataclass(frozen=True, slots=True)
class CalendarWord:
    """A word that shows the date or the time: one part as a number, or two, low byte first, as two decimal digits."""

    address: str
    parts: tuple[str, ...]
    at: Position


@dataclass(frozen=True, slots=True)
class NamedPlace:
    """A place that has a name of its own; `address` as it is written."""

    address: str
    at: Position


@dataclass(frozen=True, slots=True)
class BlockItem:
    """`words` words, or one `bit`, from word `word` of a block's words on; `unit` is how they are read."""

    word: int
    bit: int | None = None
    words: int = 1
    unit: str = "word"

    @property
    def bits(self) -> range:
        """Its bits among those of a block."""
        first = 16 * self.word + (self.bit or 0)
        return range(first, first + (16 * self.words if self.bit is None else 1))


@dataclass(frozen=True, slots=True, kw_only=True)
class BlockWords:
    """Words that each block of a run has in `area`, one after the other, for `sets` sets of `blocks` blocks.

    `first` is the first word of block 0 of set 1, `words` how many each block has, `items` what they hold.
    """

    name: str
    area: str
    first: int
    words: int
    sets: int
    blocks: int
    items: Mapping[str, BlockItem]
    at: Position

    @property
    def end(self) -> int:
        """The first word behind those of all blocks."""
        return self.first + self.words * self.sets * self.blocks

    def base(self, set_number: int, block: int) -> int:
        """The first word of a block; sets count from 1, blocks from 0. Raises ValueError for any other."""
        if not 1 <= set_number <= self.sets or not 0 <= block < self.blocks:
            raise ValueError(
                f"there is no block {block} of set {set_number} – "
                f"sets are 1 to {self.sets}, blocks 0 to {self.blocks - 1}"
            )
        return self.first + self.words * (self.blocks * (set_number - 1) + block)


@dataclass(frozen=True, slots=True, kw_only=True)
class MemoryProfile:
    """Everything a profile says. `scan` is how long a scan counts, in nanoseconds.

    Of the file's `flags`, those that are addresses are in `named`, those that are words of blocks in `flags`.
    """

    name: str
    about: str
    source: str
    areas: Mapping[str, ProfileArea]
    tables: Mapping[str, Table]
    addresses: tuple[AddressForm, ...]
    clocks: tuple[ClockBit, ...]
    fixed: tuple[FixedBit, ...]
    scan: int
    calendar: tuple[CalendarWord, ...] = ()
    named: Mapping[str, NamedPlace]
    flags: Mapping[str, BlockWords]
    at: Position

    def create(self) -> DeviceMemory:
        """A memory with these areas, all 0."""
        return DeviceMemory(
            Area(area.name, size=area.size, unit=area.unit, access=area.access, aliases=area.aliases)
            for area in self.areas.values()
        )
