"""A block at work: what the scheduler counts and remembers of it.

Who changes it, and when, is the scheduler's business.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from typing import Literal

from framekit.blocks.block_status import Failure
from framekit.blocks.counters import Counters
from framekit.blocks.model import STATIONED, Block
from framekit.blocks.triggers import MemoryTriggers

Prompt = Callable[[], Callable[[], None] | None]
"""A quick start of a block: what is to be done once it counts as begun, None where it has to start as usual."""


class BlockState:
    """A block at work: its counters, failures by their outcome, whether it waits or runs, and how it ended last.

    `companions`: blocks whose data come with the exchange of this one. `probing`: it asks a dead station. `round`
    counts how often it has been armed; timers of earlier rounds mean nothing. `prompt`: its quick
    start, False where it has none, None before somebody has asked. `key`: its set, and its number there. `chain`: the
    blocks that made it due one after the other, each of which ended while it was being started. `switched_on`: the
    block itself is on; `set_on`: its set is.
    """

    __slots__ = (
        "block",
        "chain",
        "companions",
        "counters",
        "dead",
        "has_station",
        "id",
        "key",
        "lane",
        "last_end",
        "last_failure",
        "last_outcome",
        "memory_triggers",
        "probing",
        "prompt",
        "reasons",
        "round",
        "set_on",
        "started_at",
        "starts_left",
        "switched_on",
        "waiting",
    )  # fmt: skip

    def __init__(self, block: Block) -> None:
        self.block = block
        self.id = block.id
        self.key = block.set, block.number
        self.has_station = block.instruction in STATIONED
        self.lane = block.lane
        self.chain: tuple[int, ...] = ()
        self.counters = Counters()
        self.switched_on = block.enabled
        self.set_on = True
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
        self.prompt: Prompt | Literal[False] | None = None
        self.dead = False
        self.round = 0

    @property
    def enabled(self) -> bool:
        """Whether it may come due: neither it nor its set is switched off."""
        return self.switched_on and self.set_on

    @property
    def running(self) -> bool:
        return self.counters.running > 0

    @property
    def started(self) -> int:
        return self.counters.started

    @property
    def done(self) -> int:
        return self.counters.done

    @property
    def failed(self) -> int:
        return self.counters.failed

    @property
    def overruns(self) -> int:
        return self.counters.overruns

    def begun(self, now: int) -> None:
        """An exchange of it begins."""
        self.waiting = False
        if self.starts_left is not None:
            self.starts_left -= 1
        self.started_at = now
        self.counters.started += 1

    def ended(self, failure: Failure | None, now: int) -> None:
        """An exchange of it has ended, well if `failure` is None."""
        if failure is None:
            self.counters.done += 1
            self.last_outcome = ""
        else:
            self.counters.failed += 1
            self.reasons[failure.outcome] += 1
            self.last_failure = replace(failure, at=now)
            self.last_outcome = str(failure)
        self.last_end = now

    def reset(self) -> None:
        """As at the start; what runs is still counted."""
        self.counters = Counters(started=1) if self.running else Counters()
        self.starts_left = self.block.repeat
        self.switched_on = self.block.enabled
        self.last_failure, self.last_outcome, self.last_end = None, "", None
        self.reasons.clear()
