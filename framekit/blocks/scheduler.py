"""The scheduler: which block starts when.

Channels are independent; within a channel one exchange runs at a time, ordered by due time, then priority, then number.
A block that comes due while it waits or runs counts an overrun and runs once. The scheduler is told the time and calls
`start` for a block whose turn it is; how an exchange works is not known here.
"""

from __future__ import annotations

from collections.abc import Collection

from framekit.blocks.block_state import BlockState
from framekit.blocks.lanes import LaneRules
from framekit.blocks.model import Block
from framekit.blocks.scheduler_core import SchedulerCore


class Scheduler(SchedulerCore):
    """Makes blocks due and starts them, channel by channel.

    `channels`: how each treats its line, or just the silence between two exchanges (ns). `start(state, now)` begins
    the exchange of a block and its companions; the end of each is told by `finished`. `wake()` asks the owner to call
    `tick` soon: something came due between two ticks. `ended(state, ok, now)` hears of every completion, after it has
    been counted and before anything that waits for it comes due. `station_of` tells which station a block talks to,
    `joins` which waiting blocks may come with another one's exchange, `sets` which parameter sets are enabled,
    `died(channel, station, dead)` hears of stations that are given up or back, `prompt` gives a quick start, which
    may fail, to blocks without conditions that look at nothing that the owner brings up to date before `tick`.
    """

    # ---- life ---------------------------------------------------------------------------------------------

    def begin(self, now: int) -> None:
        """Arms the triggers. Time triggers count from here."""
        self._active = True
        for state in self.states.values():
            self.arm(state, now)
        self.tick(now)

    def arm(self, state: BlockState, now: int) -> None:
        """Arms the triggers of a block, unless its set is off; its time triggers count from here."""
        if state.set_on:
            self._arming.arm(state, now)

    def end(self) -> None:
        """No block comes due any more; what runs may finish."""
        self._active = False
        self._arming.clear()
        self._turns.clear()
        for state in self.states.values():
            self._arming.disarm(state)

    def reset(self, now: int) -> None:
        """As at the start: counters at zero, repetitions afresh, time triggers from now. What runs is still counted."""
        self.end()
        for state in self.states.values():
            state.reset()
        for channel, lane in self.lanes.items():
            lane.forget_failures()
            self._mark_changes(channel, lane)
        self.begin(now)

    # ---- channels, sets and blocks, on and off ------------------------------------------------------------

    def set_open(self, channel: int, is_open: bool, now: int = 0) -> None:
        """Blocks of a channel that is not open wait until it is."""
        lane = self.lanes[channel]
        if not is_open:
            lane.open = False
        elif not lane.open:
            lane.opened(now)
            for state in self.states.values():
                if state.lane == channel and state.prompt is None:
                    self._prepare(state)  # takes longer than a start, so it is not left to the first one
            self._turns.stir(lane)
            self._mark_changes(channel, lane)
            self._wake()

    def enable(self, number: int, on: bool, now: int) -> None:
        """Switches a block on or off; what runs ends as it does. Raises KeyError for a number there is not."""
        state = self.states[number]
        state.switched_on = on
        if not on:
            self.lanes[state.lane].clear(lambda one: one is state)
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
            if state.block.set == number:
                state.set_on = on
                if self._active:
                    self.arm(state, now) if on else self._arming.disarm(state)
        if not on:
            self._turns.clear(lambda state: state.block.set == number)
        self._wake()

    # ---- change -------------------------------------------------------------------------------------------

    def hold(self, channels: Collection[int]) -> None:
        """Starts nothing on these channels until the next call; on all others it does."""
        self._turns.hold(channels)
        self._wake()

    def idle(self, channels: Collection[int]) -> bool:
        """Whether no exchange runs on any of these channels."""
        return self._turns.idle(channels)

    def add_channel(self, number: int, rules: LaneRules) -> None:
        """A channel that is new, or treats its line otherwise; it is not open yet. What waits there goes on waiting.

        Quick starts of its blocks are asked for anew.
        """
        lane = self._turns.add(number, rules)
        lane.rules, lane.open = rules, False
        for state in self.states.values():
            if state.lane == number:
                state.prompt = None

    def remove_channel(self, number: int) -> None:
        """A channel none of whose blocks is there any more."""
        self._turns.remove(number)

    def add(self, block: Block) -> BlockState:
        """A block that is new; `arm` it when everything it looks at is there."""
        self.states[block.id] = state = BlockState(block)
        in_order = sorted(self.states.items())
        self.states.clear()
        self.states.update(in_order)
        self._take_in(state)
        return state

    def remove(self, number: int) -> BlockState:
        """Takes a block out that does not run. Raises KeyError for a number there is not."""
        state = self.states.pop(number)
        self._arming.forget(state)
        self.lanes[state.lane].clear(lambda one: one is state)
        if state.block.job is not None:
            self._turns.remove(state.lane)
        return state

    # ---- becoming due -------------------------------------------------------------------------------------

    def fire(self, number: int, now: int) -> None:
        """Makes a block due by hand. Raises KeyError for a number there is not."""
        self._due(self.states[number], now)
        self.tick(now)

    def takes(self, number: int) -> bool:
        """Whether a RECEIVE block takes its frame now. Raises KeyError for a number there is not."""
        return self._may_start(self.states[number])
