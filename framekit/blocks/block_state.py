"""A block at work: what the scheduler counts and remembers of it.

Who changes it, and when, is the scheduler's business.
"""

from __future__ import annotations

from collections import Counter

from framekit.blocks.block_status import Failure
from framekit.blocks.counters import Counters
from framekit.blocks.model import Block
from framekit.blocks.triggers import MemoryTriggers


class BlockState:
    """A block at work: its counters, failures by their outcome, whether it waits or runs, and how it ended last.

    `companions`: blocks whose data come with the exchange of this one. `probing`: it asks a dead station. `round`
    counts how often it has been armed; timers of earlier rounds mean nothing.
    """

    def __init__(self, block: Block) -> None:
        self.block = block
        self.counters = Counters()
        self.enabled = block.enabled
        self.waiting = False
        self.starts_left = block.repeat
        self.memory_triggers: MemoryTriggers | None = None
        self.started_at = 0
        self.last_failure: Failure | None = None
        self.last_outcome = ""
        self.reasons: Counter[str] = Counter()
        self.last_end: int | None = None
        self.companions: tuple[BlockState, ...] = ()
        self.probing = False
        self.dead = False
        self.round = 0

    @property
    def running(self) -> bool:
        return self.counters.running > 0
