"""Places that a memory profile gives a meaning: clock and fixed bits, and names for places, held against its areas."""

from __future__ import annotations

from collections.abc import Iterator

from framekit.blocks.own_memory import addresses_of
from framekit.definition.problems import Position, Problem
from framekit.link.addresses import Address, AddressError
from framekit.memory.profile import ClockBit, FixedBit, MemoryProfile


def check_profile(profile: MemoryProfile) -> Iterator[Problem]:
    """What is no place of this memory, and bits that it cannot set by itself."""
    grammar = addresses_of(profile)

    def place(text: str, at: Position) -> Address | Problem:
        try:
            return grammar.parse(text)
        except AddressError as error:
            what, _, todo = str(error).partition(" – ")
            return Problem(at, what, todo)

    bits: tuple[ClockBit | FixedBit, ...] = (*profile.clocks, *profile.fixed)
    for bit in bits:
        found = place(bit.address, bit.at)
        if isinstance(found, Problem):
            yield found
        elif found.unit != "bit":
            yield Problem(bit.at, f"{bit.address} is a {found.unit}, and only bits are set by themselves", "name a bit")
        elif (area := profile.areas[found.area]).size * area.element_bits < 16 * (found.start // 16 + 1):
            what = f"{bit.address} is in no whole word of area {area.name}"
            yield Problem(bit.at, what, "make the area a multiple of 16 bits")
    for name, named in profile.named.items():
        found = place(named.address, named.at)
        if isinstance(found, Problem):
            yield Problem(found.at, f"'{name}': {found.what}", found.todo)
