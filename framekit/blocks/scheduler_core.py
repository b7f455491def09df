"""What the scheduler does by itself: blocks that come due wait for their turn, start, and end.

It is told the time and calls `start` for a block whose turn it is; how an exchange works is not known here, nor what
changes about blocks and channels while they are at work (see `scheduler`).
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Mapping

from framekit.blocks.arming import Arming
from framekit.blocks.block_state import BlockState, Prompt
from framekit.blocks.block_status import Failure
from framekit.blocks.conditions import Resolve
from framekit.blocks.lanes import Lane, LaneRules
from framekit.blocks.model import Block, Silence
from framekit.blocks.turns import Turns
from framekit.memory.memory import DeviceMemory

LEAST_TIME = 1_000_000
"""One that ends at once, or fails within 1 ms, holds its channel for 1 ms; a `while` block starts again 1 ms after its
end at the earliest, and so does one that blocks have started in a circle without waiting for anything: so blocks that
start each other, or themselves, and never wait for the other side, stop nobody."""


Joins = Callable[[BlockState, list[BlockState]], list[BlockState]]
"""Which of the waiting blocks may come with the exchange of a block."""


class SchedulerCore:
    """The blocks and their lanes. See `Scheduler` for what it is given."""

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
        prompt: Callable[[BlockState], Prompt | None] = lambda state: None,
    ) -> None:
        self.states = {block.id: BlockState(block) for block in blocks}
        self.sets = dict(sets or {})
        self._arming = Arming(memory, resolve, wake)
        self._turns = Turns(station_of)
        self.lanes = self._turns.lanes
        self._start = start
        self._wake = wake
        self._tell_ended = ended
        self._joins = joins
        self._died = died
        self._prompt = prompt
        self._active = False
        self._starting: BlockState | None = None
        for channel, rules in channels.items():
            self._turns.add(channel, LaneRules(silence=Silence(between=rules)) if isinstance(rules, int) else rules)
        for state in self.states.values():
            self._take_in(state)

    def _take_in(self, state: BlockState) -> None:
        """A block without a channel waits for nobody: it has a lane of its own."""
        state.set_on = self.sets.get(state.block.set, True)
        self._arming.await_ends(state)
        self._turns.add(state.lane, LaneRules())

    # ---- becoming due -------------------------------------------------------------------------------------

    def _may_start(self, state: BlockState) -> bool:
        if not (state.switched_on and state.set_on and self._active and state.starts_left != 0):
            return False
        triggers = state.memory_triggers
        return triggers is None or triggers.unless is None or not triggers.unless()

    def _due(self, state: BlockState, now: int) -> None:
        if not self._may_start(state):
            return
        lane = self.lanes[state.lane]
        if state.waiting or state.running:
            state.counters.overruns += 1
            if state.waiting:
                lane.look_again(state)
                self._turns.stir(lane)
            return
        state.waiting = True
        lane.push(state, now)
        self._turns.stir(lane)

    # ---- time ---------------------------------------------------------------------------------------------

    @property
    def deadline(self) -> int:
        """When `tick` has to be called next."""
        if self._arming.fired:
            return 0
        return min(self._arming.next_time, self._turns.deadline)

    def tick(self, now: int) -> None:
        """Makes due what is due now, and starts what can start."""
        if self._arming.next_time <= now:
            for state, due, missed in self._arming.due(now):
                self._due(state, due)
                if missed and self._may_start(state):
                    state.counters.overruns += missed
        if self._arming.fired:
            for state in self._arming.take_fired():
                self._due(state, now)
        for lane in self._turns.due(now):
            self._start_next(lane, now)
            self._turns.stir(lane)

    def start_promptly(self, now: int) -> None:
        """Starts the block that has come due, if it is the only one and has nobody to wait for.

        For whoever has more to do at that moment, none of which such a block looks at (see `prompt`). What others do
        in calls is written out here, since it stands between a trigger and the first byte.
        """
        fired, timers = self._arming.fired, self._arming.timers
        if len(fired) != 1 or (timers and timers[0][0] <= now):
            return
        state = fired[0]
        if state.prompt is None:
            self._prepare(state)
        if not (state.prompt and state.switched_on and state.set_on and self._active and state.starts_left != 0):
            return
        if self.lanes[state.lane].take_at_once(state, now):
            fired.clear()
            state.companions = ()
            afterwards = state.prompt()
            state.begun(now)
            self._starting = state
            if afterwards is None:
                self._start(state, now)
            else:
                afterwards()
            self._starting = None

    def _prepare(self, state: BlockState) -> None:
        state.prompt = self._prompt(state) or False

    def _begin(self, state: BlockState, now: int) -> None:
        state.companions = ()
        state.begun(now)
        self._starting = state
        self._start(state, now)
        self._starting = None

    def _start_next(self, lane: Lane, now: int) -> None:
        state = lane.take(now)
        if state is None:
            return
        joins = self._joins
        if joins is not None and lane.waiting and not state.probing:
            state.companions = tuple(lane.companions(lambda others: joins(state, others)))
            for one in state.companions:
                one.begun(now)
            state.begun(now)
            self._start(state, now)
        else:
            self._begin(state, now)

    def finished(self, number: int, failure: Failure | None, now: int) -> None:
        """An exchange has ended, well if `failure` is None; blocks that wait for this come due.

        Telling it twice changes nothing.
        """
        state = self.states[number]
        if not state.running:
            return
        channel = state.lane
        lane = self.lanes[channel]
        at_once = now - state.started_at < (1 if failure is None else LEAST_TIME)  # real time goes on meanwhile
        lane.ended(state, failure, now, LEAST_TIME if at_once else 0)
        self._turns.stir(lane)
        self._mark_changes(channel, lane)
        if state.dead:
            state.dead = lane.is_dead(lane.station_of(state))
        self._ended(state, failure, now)
        if state.memory_triggers is not None and state.memory_triggers.level_holds():
            self._arming.at(now + LEAST_TIME, state)
        self._wake()

    def _mark_changes(self, channel: int, lane: Lane) -> None:
        """The blocks that talk to a station that has died, or is back, show it."""
        for station, dead in lane.changes():
            for state in self.states.values():
                if state.block.channel == channel and lane.station_of(state) == station:
                    state.dead = dead
            self._died(channel, station, dead)

    def arrived(self, number: int, failure: Failure | None, now: int) -> None:
        """A frame of a RECEIVE block has come: it counts as one exchange, started and ended."""
        state = self.states[number]
        if state.starts_left:
            state.starts_left -= 1
        state.counters.started += 1
        self._ended(state, failure, now)
        self._wake()

    def _ended(self, state: BlockState, failure: Failure | None, now: int) -> None:
        state.ended(failure, now)
        self._tell_ended(state, failure is None, now)
        if self._starting is state:
            self._arming.ended_at_once(state, failure is None, now + LEAST_TIME)
        else:
            self._arming.ended(state, failure is None)
        if state.chain:
            state.chain = ()
