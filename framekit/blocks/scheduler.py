"""The scheduler: which block starts when.

Channels are independent; within a channel one exchange runs at a time, ordered by due time, then priority, then number.
A block that comes due while it waits or runs counts an overrun and runs once. The scheduler is told the time and calls
`start` for a block whose turn it is; how an exchange works is not known here.
"""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Callable, Collection, Hashable, Iterable, Mapping
from dataclasses import replace

from framekit.blocks.block_state import BlockState
from framekit.blocks.block_status import Failure
from framekit.blocks.conditions import Resolve
from framekit.blocks.counters import Counters
from framekit.blocks.lanes import Lane, LaneRules
from framekit.blocks.model import BLOCKS_IN_SET, After, Block, BlockEnd, Every, Silence
from framekit.blocks.triggers import Cycle, MemoryTriggers
from framekit.definition.times import NEVER
from framekit.memory.memory import DeviceMemory

LEAST_TIME = 1_000_000
"""One that ends at once holds its channel for 1 ms; a `while` block starts again 1 ms after its end at the earliest:
so blocks that fail at once and start each other, or themselves, stop nobody."""


Joins = Callable[[BlockState, list[BlockState]], list[BlockState]]
"""Which of the waiting blocks may come with the exchange of a block."""


class Scheduler:
    """Makes blocks due and starts them, channel by channel.

    `channels`: how each treats its line, or just the silence between two exchanges (ns). `start(state, now)` begins
    the exchange of a block and its companions; the end of each is told by `finished`. `wake()` asks the owner to call
    `tick` soon: something came due between two ticks. `ended(state, ok, now)` hears of every completion, after it has
    been counted and before anything that waits for it comes due. `station_of` tells which station a block talks to,
    `joins` which waiting blocks may come with another one's exchange, `sets` which parameter sets are enabled,
    `died(channel, station, dead)` hears of stations that are given up or back.
    """

    def __init__(
        self,
        blocks: Iterable[Block],
        memory: DeviceMemory,
        resolve: Resolve,
        channels: Mapping[int, LaneRules | int],
        start: Callable[[BlockState, int], None],
        wake: Callable[[], None],
        ended: Callable[[BlockState, bool, int], None] = lambda state, ok, now: None,
        *,
        station_of: Callable[[BlockState], Hashable] = lambda state: None,
        joins: Joins | None = None,
        sets: Mapping[int, bool] | None = None,
        died: Callable[[int, Hashable, bool], None] = lambda channel, station, dead: None,
    ) -> None:
        self.states = {block.id: BlockState(block) for block in blocks}
        self.memory = memory
        self.resolve = resolve
        self._start = start
        self._wake = wake
        self._tell_ended = ended
        self._joins = joins
        self._died = died
        self.sets = dict(sets or {})
        self.lanes: dict[int, Lane] = {}
        for channel, rules in channels.items():
            if isinstance(rules, int):
                rules = LaneRules(silence=Silence(between=rules))
            self.lanes[channel] = Lane(rules, station_of)
        self._station_of = station_of
        self._timers: list[tuple[int, int, Cycle | None, BlockState, int]] = []
        self._order = itertools.count()
        self._fired: list[BlockState] = []
        self._after: dict[tuple[int, bool], list[BlockState]] = {}
        self._active = False
        for state in self.states.values():
            self._await_ends(state)
            self._give_lane(state)

    def _give_lane(self, state: BlockState) -> None:
        """A block without a channel waits for nobody."""
        if state.block.lane not in self.lanes:
            self.lanes[state.block.lane] = Lane(LaneRules(), self._station_of)

    def _await_ends(self, state: BlockState) -> None:
        """Blocks whose ends this one waits for are those of its set."""
        for trigger in state.block.triggers:
            if isinstance(trigger, BlockEnd):
                key = BLOCKS_IN_SET * (state.block.set - 1) + trigger.block, trigger.ok
                self._after.setdefault(key, []).append(state)

    # ---- life ---------------------------------------------------------------------------------------------

    def begin(self, now: int) -> None:
        """Arms the triggers. Time triggers count from here."""
        self._active = True
        for state in self.states.values():
            self.arm(state, now)
        self.tick(now)

    def _set_on(self, state: BlockState) -> bool:
        return self.sets.get(state.block.set, True)

    def arm(self, state: BlockState, now: int) -> None:
        """Arms the triggers of a block; its time triggers count from here."""
        if not self._set_on(state):
            return
        block = state.block
        state.round += 1
        state.memory_triggers = MemoryTriggers(block, self.memory, self.resolve, self._fire_from_memory)
        for trigger in block.triggers:
            if isinstance(trigger, Every):
                self._timer(now + trigger.phase, Cycle(now + trigger.phase, trigger.period), state)
            elif isinstance(trigger, After):
                self._timer(now + trigger.delay, None, state)

    def _disarm(self, state: BlockState) -> None:
        state.round += 1
        if state.memory_triggers is not None:
            state.memory_triggers.cancel()
            state.memory_triggers = None

    def _timer(self, when: int, cycle: Cycle | None, state: BlockState) -> None:
        heapq.heappush(self._timers, (when, next(self._order), cycle, state, state.round))

    def end(self) -> None:
        """No block comes due any more; what runs may finish."""
        self._active = False
        self._timers.clear()
        self._fired.clear()
        for lane in self.lanes.values():
            lane.clear()
        for state in self.states.values():
            self._disarm(state)

    def reset(self, now: int) -> None:
        """As at the start: counters at zero, repetitions afresh, time triggers from now. What runs is still counted."""
        self.end()
        for state in self.states.values():
            state.counters = Counters(started=1) if state.running else Counters()
            state.starts_left = state.block.repeat
            state.enabled = state.block.enabled
            state.last_failure, state.last_outcome, state.last_end = None, "", None
            state.reasons.clear()
        for channel, lane in self.lanes.items():
            lane.forget_failures()
            self._mark_changes(channel)
        self.begin(now)

    # ---- channels, sets and blocks, on and off ------------------------------------------------------------

    def set_open(self, channel: int, is_open: bool, now: int = 0) -> None:
        """Blocks of a channel that is not open wait until it is."""
        lane = self.lanes[channel]
        if not is_open:
            lane.open = False
        elif not lane.open:
            lane.opened(now)
            self._mark_changes(channel)
            self._wake()

    def enable(self, number: int, on: bool, now: int) -> None:
        """Switches a block on or off; what runs ends as it does. Raises KeyError for a number there is not."""
        state = self.states[number]
        state.enabled = on
        if not on:
            self.lanes[state.block.lane].clear(lambda one: one is state)
        elif state.memory_triggers is not None and state.memory_triggers.level_holds():
            self._due(state, now)
            self._wake()

    def enable_set(self, number: int, on: bool, now: int) -> None:
        """Switches a parameter set on, its time triggers count from now, or off. Raises KeyError for an unknown one."""
        if number not in self.sets:
            raise KeyError(number)
        self.set_enabled(number, on, now)

    def set_enabled(self, number: int, on: bool, now: int) -> None:
        """As `enable_set`; a set that is new is one from here on."""
        if self.sets.get(number, True) == on:
            self.sets[number] = on
            return
        self.sets[number] = on
        for state in self.states.values():
            if state.block.set == number and self._active:
                self.arm(state, now) if on else self._disarm(state)
        if not on:
            for lane in self.lanes.values():
                lane.clear(lambda state: state.block.set == number)
        self._wake()

    # ---- change -------------------------------------------------------------------------------------------

    def hold(self, channels: Collection[int]) -> None:
        """Starts nothing on these channels until the next call; on all others it does."""
        for number, lane in self.lanes.items():
            lane.held = number in channels
        self._wake()

    def idle(self, channels: Collection[int]) -> bool:
        """Whether no exchange runs on any of these channels."""
        return not any(self.lanes[number].busy for number in channels if number in self.lanes)

    def add_channel(self, number: int, rules: LaneRules) -> None:
        """A channel that is new, or treats its line otherwise; it is not open yet. What waits there goes on waiting."""
        lane = self.lanes.setdefault(number, Lane(rules, self._station_of))
        lane.rules, lane.open = rules, False

    def remove_channel(self, number: int) -> None:
        """A channel none of whose blocks is there any more."""
        del self.lanes[number]

    def add(self, block: Block) -> BlockState:
        """A block that is new; `arm` it when everything it looks at is there."""
        self.states[block.id] = state = BlockState(block)
        in_order = sorted(self.states.items())
        self.states.clear()
        self.states.update(in_order)
        self._await_ends(state)
        self._give_lane(state)
        return state

    def remove(self, number: int) -> BlockState:
        """Takes a block out that does not run. Raises KeyError for a number there is not."""
        state = self.states.pop(number)
        self._disarm(state)
        self.lanes[state.block.lane].clear(lambda one: one is state)
        if state.block.job is not None:
            del self.lanes[state.block.lane]
        self._fired = [fired for fired in self._fired if fired is not state]
        for waiting in self._after.values():
            waiting[:] = [other for other in waiting if other is not state]
        return state

    # ---- becoming due -------------------------------------------------------------------------------------

    def fire(self, number: int, now: int) -> None:
        """Makes a block due by hand. Raises KeyError for a number there is not."""
        self._due(self.states[number], now)
        self.tick(now)

    def _fire_from_memory(self, block: Block) -> None:
        self._fired.append(self.states[block.id])
        self._wake()

    def _may_start(self, state: BlockState) -> bool:
        if not state.enabled or not self._active or state.starts_left == 0 or not self._set_on(state):
            return False
        return state.memory_triggers is None or not state.memory_triggers.held_back()

    def _due(self, state: BlockState, now: int) -> None:
        if not self._may_start(state):
            return
        if state.waiting or state.running:
            state.counters.overruns += 1
            if state.waiting:
                self.lanes[state.block.lane].look_again(state)
            return
        state.waiting = True
        self.lanes[state.block.lane].push(state, now)

    # ---- time ---------------------------------------------------------------------------------------------

    @property
    def deadline(self) -> int:
        """When `tick` has to be called next."""
        if self._fired:
            return 0
        deadline = self._timers[0][0] if self._timers else NEVER
        for lane in self.lanes.values():
            deadline = min(deadline, lane.deadline)
        return deadline

    def tick(self, now: int) -> None:
        """Makes due what is due now, and starts what can start."""
        while self._timers and self._timers[0][0] <= now:
            due, _, cycle, state, round_ = heapq.heappop(self._timers)
            if round_ != state.round:
                continue
            self._due(state, due)
            if cycle is not None:
                missed = cycle.step(now)
                if missed and self._may_start(state):
                    state.counters.overruns += missed
                self._timer(cycle.due, cycle, state)
        fired, self._fired = self._fired, []
        for state in fired:
            self._due(state, now)
        for lane in list(self.lanes.values()):
            if lane.deadline <= now:
                self._start_next(lane, now)

    def _start_next(self, lane: Lane, now: int) -> None:
        state = lane.take(now)
        if state is None:
            return
        joins = self._joins
        state.companions = ()
        if joins is not None and not state.probing:
            state.companions = tuple(lane.companions(lambda others: joins(state, others)))
        for one in (state, *state.companions):
            one.waiting = False
            if one.starts_left is not None:
                one.starts_left -= 1
            one.started_at = now
            one.counters.started += 1
        self._start(state, now)

    def finished(self, number: int, failure: Failure | None, now: int) -> None:
        """An exchange has ended, well if `failure` is None; blocks that wait for this come due.

        Telling it twice changes nothing.
        """
        state = self.states[number]
        if not state.running:
            return
        channel = state.block.lane
        lane = self.lanes[channel]
        lane.ended(state, failure, now, LEAST_TIME if now == state.started_at else 0)
        self._mark_changes(channel)
        if state.dead:
            state.dead = lane.is_dead(lane.station_of(state))
        self._ended(state, failure, now)
        if state.memory_triggers is not None and state.memory_triggers.level_holds():
            self._timer(now + LEAST_TIME, None, state)
        self._wake()

    def _mark_changes(self, channel: int) -> None:
        """The blocks that talk to a station that has died, or is back, show it."""
        lane = self.lanes[channel]
        for station, dead in lane.changes():
            for state in self.states.values():
                if state.block.channel == channel and lane.station_of(state) == station:
                    state.dead = dead
            self._died(channel, station, dead)

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
        self._fired.extend(self._after.get((state.block.id, ok), ()))
