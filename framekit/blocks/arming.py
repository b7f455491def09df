"""What makes blocks due while they are armed: times in a heap, watches on memory, ends of other blocks.

Nothing here counts or starts anything: whether a block that is due may start, and when, is the scheduler's business.
"""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Callable, Iterator
from functools import partial

from framekit.blocks.block_state import BlockState
from framekit.blocks.conditions import Resolve
from framekit.blocks.model import BLOCKS_IN_SET, After, BlockEnd, Every
from framekit.blocks.triggers import Cycle, MemoryTriggers
from framekit.definition.times import NEVER
from framekit.memory.memory import DeviceMemory


class Arming:
    """Arms blocks. `wake` is called when one comes due by its memory triggers.

    `fired`: those that have come due since somebody took them, always the same list. `timers`: a heap of times when
    blocks are due next.
    """

    def __init__(self, memory: DeviceMemory, resolve: Resolve, wake: Callable[[], None]) -> None:
        self.memory = memory
        self.resolve = resolve
        self.fired: list[BlockState] = []
        self._wake = wake
        self.timers: list[tuple[int, int, Cycle | None, BlockState, int]] = []
        self._order = itertools.count()
        self._after: dict[tuple[int, bool], list[BlockState]] = {}

    def await_ends(self, state: BlockState) -> None:
        """From now on the block hears of the ends it waits for: those of blocks of its set."""
        for trigger in state.block.triggers:
            if isinstance(trigger, BlockEnd):
                key = BLOCKS_IN_SET * (state.block.set - 1) + trigger.block, trigger.ok
                self._after.setdefault(key, []).append(state)

    def arm(self, state: BlockState, now: int) -> None:
        """Arms the triggers of a block; its time triggers count from here."""
        state.round += 1
        note = partial(self.fired.append, state)
        state.memory_triggers = MemoryTriggers(state.block, self.memory, self.resolve, note, self._wake)
        for trigger in state.block.triggers:
            if isinstance(trigger, Every):
                self._at(now + trigger.phase, Cycle(now + trigger.phase, trigger.period), state)
            elif isinstance(trigger, After):
                self.at(now + trigger.delay, state)

    def disarm(self, state: BlockState) -> None:
        """Nothing but the ends of other blocks makes it due any more."""
        state.round += 1
        if state.memory_triggers is not None:
            state.memory_triggers.cancel()
            state.memory_triggers = None

    def forget(self, state: BlockState) -> None:
        """A block is no more."""
        self.disarm(state)
        self.fired[:] = [fired for fired in self.fired if fired is not state]
        for waiting in self._after.values():
            waiting[:] = [other for other in waiting if other is not state]

    def clear(self) -> None:
        """Nothing comes due any more of what was to."""
        self.timers.clear()
        self.fired.clear()

    # ---- what happens -------------------------------------------------------------------------------------

    def ended(self, state: BlockState, ok: bool) -> None:
        """A block has ended, well or not."""
        waiting = self._after.get((state.id, ok))
        if waiting:
            self.fired.extend(waiting)

    def ended_at_once(self, state: BlockState, ok: bool, later: int) -> None:
        """A block has ended while it was being started; one in whose chain it is already is due only `later`."""
        waiting = self._after.get((state.id, ok))
        if not waiting:
            return
        chain = (*state.chain, state.id)
        for one in waiting:
            if one.id in chain:
                self.at(later, one)
            else:
                one.chain = chain
                self.fired.append(one)

    def take_fired(self) -> list[BlockState]:
        """Those that have come due since this was asked last."""
        fired = self.fired.copy()
        self.fired.clear()
        return fired

    # ---- time ---------------------------------------------------------------------------------------------

    def at(self, when: int, state: BlockState) -> None:
        """The block is due at `when`, if it has not been armed anew by then."""
        self._at(when, None, state)

    def _at(self, when: int, cycle: Cycle | None, state: BlockState) -> None:
        heapq.heappush(self.timers, (when, next(self._order), cycle, state, state.round))

    @property
    def next_time(self) -> int:
        """When a block is due by its time next."""
        return self.timers[0][0] if self.timers else NEVER

    def due(self, now: int) -> Iterator[tuple[BlockState, int, int]]:
        """Blocks whose time has come: when that was, and how many times more it has come since then."""
        timers = self.timers
        while timers and timers[0][0] <= now:
            due, _, cycle, state, round_ = heapq.heappop(timers)
            if round_ == state.round:
                missed = 0
                if cycle is not None:
                    missed = cycle.step(now)
                    self._at(cycle.due, cycle, state)
                yield state, due, missed
