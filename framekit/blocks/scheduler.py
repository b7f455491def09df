"""The scheduler: which block starts when.

Channels are independent; within a channel one exchange runs at a time, ordered by due time, then priority, then number.
A block that comes due while it waits or runs counts an overrun and runs once. The scheduler is told the time and calls
`start` for a block whose turn it is; how an exchange works is not known here.
"""

from __future__ import annotations

import heapq
import itertools
from collections import Counter
from collections.abc import Callable, Collection, Iterable
from dataclasses import replace

from framekit.blocks.block_status import Failure
from framekit.blocks.conditions import Resolve
from framekit.blocks.counters import Counters
from framekit.blocks.model import After, Block, BlockEnd, Every
from framekit.blocks.triggers import Cycle, MemoryTriggers
from framekit.definition.times import NEVER
from framekit.memory.memory import DeviceMemory

LEAST_TIME = 1_000_000
"""One that ends at once holds its channel for 1 ms; a `while` block starts again 1 ms after its end at the earliest:
so blocks that fail at once and start each other, or themselves, stop nobody."""


class BlockState:
    """A block at work: its counters, failures by their outcome, whether it waits or runs, and how it ended last."""

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

    @property
    def running(self) -> bool:
        return self.counters.running > 0


class _Lane:
    """The blocks of one channel that wait, and whether one is running."""

    def __init__(self, pause: int) -> None:
        self.pause = pause
        self.waiting: list[tuple[int, int, int, BlockState]] = []
        self.busy = False
        self.open = True
        self.held = False
        self.free_from = 0

    @property
    def startable(self) -> bool:
        """Whether a block waits that may start once the line is free."""
        return bool(self.waiting) and self.open and not self.busy and not self.held


class Scheduler:
    """Makes blocks due and starts them, channel by channel.

    `start(state, now)` begins the exchange of a block; its end is told by `finished`. `wake()` asks the owner to call
    `tick` soon: something came due between two ticks. `ended(state, ok, now)` hears of every completion, after it has
    been counted and before anything that waits for it comes due.
    """

    def __init__(
        self,
        blocks: Iterable[Block],
        memory: DeviceMemory,
        resolve: Resolve,
        pauses: dict[int, int],
        start: Callable[[BlockState, int], None],
        wake: Callable[[], None],
        ended: Callable[[BlockState, bool, int], None] = lambda state, ok, now: None,
    ) -> None:
        self.states = {block.number: BlockState(block) for block in blocks}
        self.memory = memory
        self.resolve = resolve
        self._start = start
        self._wake = wake
        self._tell_ended = ended
        self._lanes = {channel: _Lane(pause) for channel, pause in pauses.items()}
        self._timers: list[tuple[int, int, Cycle | None, BlockState]] = []
        self._order = itertools.count()
        self._fired: list[BlockState] = []
        self._after: dict[tuple[int, bool], list[BlockState]] = {}
        self._active = False

    # ---- life ---------------------------------------------------------------------------------------------

    def begin(self, now: int) -> None:
        """Arms the triggers. Time triggers count from here."""
        self._active = True
        for state in self.states.values():
            self.arm(state, now)
        self.tick(now)

    def arm(self, state: BlockState, now: int) -> None:
        """Arms the triggers of a block; its time triggers count from here."""
        block = state.block
        state.memory_triggers = MemoryTriggers(block, self.memory, self.resolve, self._fire_from_memory)
        for trigger in block.triggers:
            if isinstance(trigger, Every):
                self._timer(now + trigger.phase, Cycle(now + trigger.phase, trigger.period), state)
            elif isinstance(trigger, After):
                self._timer(now + trigger.delay, None, state)
            elif isinstance(trigger, BlockEnd):
                self._after.setdefault((trigger.block, trigger.ok), []).append(state)

    def _timer(self, when: int, cycle: Cycle | None, state: BlockState) -> None:
        heapq.heappush(self._timers, (when, next(self._order), cycle, state))

    def end(self) -> None:
        """No block comes due any more; what runs may finish."""
        self._active = False
        self._timers.clear()
        for lane in self._lanes.values():
            for *_, state in lane.waiting:
                state.waiting = False
            lane.waiting.clear()
        for state in self.states.values():
            if state.memory_triggers is not None:
                state.memory_triggers.cancel()

    def set_open(self, channel: int, is_open: bool) -> None:
        """Blocks of a channel that is not open wait until it is."""
        self._lanes[channel].open = is_open
        if is_open:
            self._wake()

    # ---- change -------------------------------------------------------------------------------------------

    def hold(self, channels: Collection[int]) -> None:
        """Starts nothing on these channels until the next call; on all others it does."""
        for number, lane in self._lanes.items():
            lane.held = number in channels
        self._wake()

    def idle(self, channels: Collection[int]) -> bool:
        """Whether no exchange runs on any of these channels."""
        return not any(self._lanes[number].busy for number in channels if number in self._lanes)

    def add_channel(self, number: int, pause: int) -> None:
        """A channel that is new, or has another pause; it is not open yet. What waits there goes on waiting."""
        lane = self._lanes.setdefault(number, _Lane(pause))
        lane.pause, lane.open = pause, False

    def remove_channel(self, number: int) -> None:
        """A channel none of whose blocks is there any more."""
        del self._lanes[number]

    def add(self, block: Block) -> BlockState:
        """A block that is new; `arm` it when everything it looks at is there."""
        self.states[block.number] = state = BlockState(block)
        in_order = sorted(self.states.items())
        self.states.clear()
        self.states.update(in_order)
        return state

    def remove(self, number: int) -> BlockState:
        """Takes a block out that does not run. Raises KeyError for a number there is not."""
        state = self.states.pop(number)
        if state.memory_triggers is not None:
            state.memory_triggers.cancel()
        lane = self._lanes[state.block.channel]
        lane.waiting = [entry for entry in lane.waiting if entry[3] is not state]
        heapq.heapify(lane.waiting)
        self._timers = [entry for entry in self._timers if entry[3] is not state]
        heapq.heapify(self._timers)
        self._fired = [fired for fired in self._fired if fired is not state]
        for waiting in self._after.values():
            waiting[:] = [other for other in waiting if other is not state]
        return state

    # ---- becoming due -------------------------------------------------------------------------------------

    def enable(self, number: int, on: bool, now: int) -> None:
        """Switches a block on or off; what runs ends as it does. Raises KeyError for a number there is not."""
        state = self.states[number]
        state.enabled = on
        if on and state.memory_triggers is not None and state.memory_triggers.level_holds():
            self._due(state, now)
            self._wake()

    def fire(self, number: int, now: int) -> None:
        """Makes a block due by hand. Raises KeyError for a number there is not."""
        self._due(self.states[number], now)
        self.tick(now)

    def _fire_from_memory(self, block: Block) -> None:
        self._fired.append(self.states[block.number])
        self._wake()

    def _may_start(self, state: BlockState) -> bool:
        if not state.enabled or not self._active or state.starts_left == 0:
            return False
        return state.memory_triggers is None or not state.memory_triggers.held_back()

    def _due(self, state: BlockState, now: int) -> None:
        if not self._may_start(state):
            return
        if state.waiting or state.running:
            state.counters.overruns += 1
            return
        if state.starts_left is not None:
            state.starts_left -= 1
        state.waiting = True
        block = state.block
        heapq.heappush(self._lanes[block.channel].waiting, (now, -block.priority, block.number, state))

    # ---- time ---------------------------------------------------------------------------------------------

    @property
    def deadline(self) -> int:
        """When `tick` has to be called next."""
        if self._fired:
            return 0
        times = [self._timers[0][0]] if self._timers else []
        times += [lane.free_from for lane in self._lanes.values() if lane.startable]
        return min(times, default=NEVER)

    def tick(self, now: int) -> None:
        """Makes due what is due now, and starts what can start."""
        while self._timers and self._timers[0][0] <= now:
            due, _, cycle, state = heapq.heappop(self._timers)
            self._due(state, due)
            if cycle is not None:
                missed = cycle.step(now)
                if missed and self._may_start(state):
                    state.counters.overruns += missed
                self._timer(cycle.due, cycle, state)
        fired, self._fired = self._fired, []
        for state in fired:
            self._due(state, now)
        for lane in self._lanes.values():
            self._start_next(lane, now)

    def _start_next(self, lane: _Lane, now: int) -> None:
        if not lane.startable or now < lane.free_from:
            return
        *_, state = heapq.heappop(lane.waiting)
        lane.busy = True
        state.waiting = False
        state.started_at = now
        state.counters.started += 1
        self._start(state, now)

    def finished(self, number: int, failure: Failure | None, now: int) -> None:
        """An exchange has ended, well if `failure` is None; blocks that wait for this come due.

        Telling it twice changes nothing.
        """
        state = self.states[number]
        if not state.running:
            return
        lane = self._lanes[state.block.channel]
        lane.busy = False
        lane.free_from = now + max(lane.pause, LEAST_TIME if now == state.started_at else 0)
        self._ended(state, failure, now)
        if state.memory_triggers is not None and state.memory_triggers.level_holds():
            self._timer(now + LEAST_TIME, None, state)
        self._wake()

    def takes(self, number: int) -> bool:
        """Whether a RECEIVE block takes its frame now. Raises KeyError for a number there is not."""
        return self._may_start(self.states[number])

    def arrived(self, number: int, failure: Failure | None, now: int) -> None:
        """A frame of a RECEIVE block has come: it counts as one exchange, started and ended."""
        state = self.states[number]
        if state.starts_left:
            state.starts_left -= 1
        state.counters.started += 1
        self._ended(state, failure, now)
        self._wake()

    def _ended(self, state: BlockState, failure: Failure | None, now: int) -> None:
        ok = failure is None
        if failure is None:
            state.counters.done += 1
            state.last_outcome = ""
        else:
            state.counters.failed += 1
            state.reasons[failure.outcome] += 1
            state.last_failure = replace(failure, at=now)
            state.last_outcome = str(failure)
        state.last_end = now
        self._tell_ended(state, ok, now)
        self._fired.extend(self._after.get((state.block.number, ok), ()))
