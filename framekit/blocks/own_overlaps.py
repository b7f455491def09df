"""Places of the own memory in which several blocks of a run store, and those where the state of blocks is shown.

Two blocks that store in the very same place may take turns; two that share a part of one spoil each other's data, and
so do two that store there in cycles of their own. Only warnings come from here.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from framekit.blocks.fields import fixed_bytes, parts_of, takes_bytes
from framekit.blocks.model import Block, Channel, Every, Place
from framekit.blocks.status_words import status_sections, words_of
from framekit.definition.problems import Problem
from framekit.memory.memory import unit_bits
from framekit.memory.profile import BlockWords


@dataclass(frozen=True, slots=True)
class _Stored:
    """`bits` bits from a place on, which a block stores."""

    block: Block
    place: Place
    first: int
    bits: int

    @property
    def end(self) -> int:
        return self.first + self.bits

    def __str__(self) -> str:
        count = -(-self.bits // self.place.address.unit_bits)
        return self.place.text if count == 1 else f"{self.place.text} ({count} × {self.place.address.unit})"


def overlaps(
    blocks: Sequence[Block], channels: Mapping[int, Channel], sections: Sequence[BlockWords] = ()
) -> Iterator[Problem]:
    """A warning for each two blocks that store in one place, and for each that stores where state is shown.

    `sections`: the words of blocks in the memory, if the run shows them.
    """
    stored: dict[str, list[_Stored]] = {}
    for block in blocks:
        for one in _stored(block, channels):
            stored.setdefault(one.place.address.area, []).append(one)
    shown = _shown(blocks, sections)
    for area, found in stored.items():
        found.sort(key=lambda one: (one.first, one.block.id))
        yield from _pairs(found)
        yield from _over_words(found, shown.get(area, []))


def _pairs(found: list[_Stored]) -> Iterator[Problem]:
    """Each two blocks once; `found` is in the order of places."""
    told: set[frozenset[int]] = set()
    for at, one in enumerate(found):
        for other in found[at + 1 :]:
            if other.first >= one.end:
                break
            pair = frozenset((one.block.id, other.block.id))
            if len(pair) == 2 and pair not in told and _spoils(one, other):
                told.add(pair)
                first, second = sorted((one, other), key=lambda stored: stored.block.id)
                places = " and ".join(dict.fromkeys((str(first), str(second))))
                what = f"blocks {first.block.label} and {second.block.label} store in one place: {places}"
                yield Problem(second.block.at, what, "move one of them", warning=True)


def _spoils(one: _Stored, other: _Stored) -> bool:
    """Whether two blocks that store in one place are in each other's way, and do not just take turns."""
    if (one.first, one.bits) != (other.first, other.bits):
        return True
    return all(any(isinstance(trigger, Every) for trigger in stored.block.triggers) for stored in (one, other))


def _over_words(found: list[_Stored], shown: list[tuple[int, int, Block]]) -> Iterator[Problem]:
    for one in found:
        for first, end, block in shown:
            if one.first < end and first < one.end:
                what = f"block {one.block.label} stores in {one.place.text}, where the state of block {block.label} "
                yield Problem(one.block.at, what + "is shown", "name another place", warning=True)
                break


def _shown(blocks: Sequence[Block], sections: Sequence[BlockWords]) -> dict[str, list[tuple[int, int, Block]]]:
    """Where the state of the blocks is shown: area → first bit, end, block."""
    found: dict[str, list[tuple[int, int, Block]]] = {}
    for block in blocks:
        for section, word in words_of(status_sections(sections), (block.set, block.number)):
            found.setdefault(section.area, []).append((16 * word, 16 * (word + section.words), block))
    return found


def _stored(block: Block, channels: Mapping[int, Channel]) -> Iterator[_Stored]:
    for place, bits in _pieces(block, channels):
        yield _Stored(block, place, place.address.first_bit, bits)


def _pieces(block: Block, channels: Mapping[int, Channel]) -> Iterator[tuple[Place, int]]:
    """What a block stores: the place and how many bits; commands in memory say it only when they are given."""
    if block.instruction == "read":
        for place, unit in zip(block.places, block.units, strict=False):
            yield place, unit_bits(unit) * (block.count if len(block.units) == 1 else 1)
    for result in block.results:
        yield result.place, result.bits
    if block.instruction == "receive" and block.frame is not None:
        parts = dict(parts_of(channels[block.channel].protocol.frames[block.frame].segments))
        for name, place in block.data.items():
            size = block.sizes.get(name) or fixed_bytes(parts[name]) or 1
            yield place, 8 * size if takes_bytes(parts[name]) else place.address.unit_bits
