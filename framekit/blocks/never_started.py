"""Blocks of a run that wait for each other's ends, and that nothing else starts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from framekit.blocks.model import Block, BlockEnd
from framekit.definition.problems import Problem


def never_started(blocks: Sequence[Block]) -> Iterator[Problem]:
    """A warning for each block that only starts behind blocks which wait for it, or for each other.

    A block without triggers may be fired by hand, so what starts behind it may start; a receiving block acts by itself.
    """
    waiting = {block.id: block for block in blocks if block.triggers and _only_behind(block)}
    while reached := [one for one in waiting.values() if any(before not in waiting for before in _before(one))]:
        for block in reached:
            del waiting[block.id]
    for block in waiting.values():
        numbers = [trigger.block for trigger in block.triggers if isinstance(trigger, BlockEnd)]
        others = " or ".join(f"block {number}" for number in dict.fromkeys(numbers))
        what = f"block {block.label} only starts behind {others}, which nothing starts"
        if {block.number} == set(numbers):
            what = f"block {block.label} only starts behind itself"
        yield Problem(block.at, what, "add once:, every: or another trigger", warning=True)


def _only_behind(block: Block) -> bool:
    return all(isinstance(trigger, BlockEnd) for trigger in block.triggers)


def _before(block: Block) -> Iterator[int]:
    """The blocks, by their ids, behind which a block starts."""
    for trigger in block.triggers:
        if isinstance(trigger, BlockEnd):
            yield block.id - block.number + trigger.block
