"""Plays the cycles of one channel through with the real scheduler, each exchange taking a known time.

Nothing is sent and no clock is needed: the times are those of the scheduler's own deadlines.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from framekit.blocks.block_state import BlockState
from framekit.blocks.model import BLOCKS_IN_SET, Block, BlockEnd, Every
from framekit.blocks.scheduler import Scheduler
from framekit.definition.times import NEVER
from framekit.link.addresses import Address, AddressError
from framekit.memory.memory import DeviceMemory

MOST_EXCHANGES = 5_000
"""So many exchanges are played through at most; cycles that have not met again by then are judged by these."""

ROUNDS = 4
"""So often all cycles begin together."""

Cycle = tuple[Block, int, int]
"""A block with its period, and what an exchange takes, both in ns."""


def cycle_starts(cycles: Sequence[Cycle]) -> dict[tuple[int, int], tuple[float, float]]:
    """For the blocks of one channel, by set and number: ns from start to start, and the share of missed starts."""
    if not cycles:
        return {}
    play = _Play(cycles)
    once = math.lcm(*(period for _, period, _ in cycles))
    began = play.until(once, MOST_EXCHANGES // 4)
    before = {number: replace(state.counters) for number, state in play.scheduler.states.items()}
    lasted = play.until((1 + ROUNDS) * once, MOST_EXCHANGES) - began
    found = {}
    for block, period, _ in cycles:
        counters = play.scheduler.states[block.id].counters
        started = counters.started - before[block.id].started
        missed = counters.overruns - before[block.id].overruns
        follows = not any(isinstance(trigger, Every) for trigger in play.scheduler.states[block.id].block.triggers)
        reached = lasted / started if started and (missed or follows) else float(period)
        found[block.set, block.number] = (max(reached, float(period)), missed / max(1, started + missed))
    return found


class _Play:
    """Blocks that start in their cycles, or behind one that does, and do nothing but take their time."""

    def __init__(self, cycles: Sequence[Cycle]) -> None:
        numbers = {block.id for block, _, _ in cycles}
        self.durations = {block.id: duration for block, _, duration in cycles}
        self.running: int | None = None
        self.ends_at = NEVER
        self.started = 0
        self.now = 0
        channel = cycles[0][0].channel
        blocks = [_only_cycles(block, period, numbers) for block, period, _ in cycles]
        self.scheduler = Scheduler(blocks, DeviceMemory([]), _no_place, {channel: 0}, self._start, lambda: None)
        self.scheduler.begin(0)

    def _start(self, state: BlockState, now: int) -> None:
        self.running = state.block.id
        self.ends_at = now + self.durations[state.block.id]
        self.started += 1

    def until(self, end: int, most: int) -> int:
        """Plays on to `end`, or until so many exchanges have begun; when that is."""
        scheduler = self.scheduler
        while self.started < most and (due := min(scheduler.deadline, self.ends_at)) <= end:
            self.now = now = max(self.now, due)
            if self.running is not None and self.ends_at <= now:
                number, self.running, self.ends_at = self.running, None, NEVER
                scheduler.finished(number, None, now)
            scheduler.tick(now)
        if self.started < most:
            self.now = end
        return self.now


def _only_cycles(block: Block, period: int, others: set[int]) -> Block:
    """The block without triggers that ask for memory; a clock bit is a cycle."""
    kept = [
        trigger
        for trigger in block.triggers
        if isinstance(trigger, Every)
        or (isinstance(trigger, BlockEnd) and trigger.ok and _follows(block, trigger) in others)
    ]
    triggers = tuple(kept) or (Every(period=period, phase=period),)
    return replace(block, triggers=triggers, unless=None, repeat=None, enabled=True)


def _follows(block: Block, trigger: BlockEnd) -> int:
    """The id of the block whose end this one waits for: it is in the same set."""
    return BLOCKS_IN_SET * (block.set - 1) + trigger.block


def _no_place(text: str) -> Address:
    raise AddressError(f"{text} is not looked at here")
