"""The scheduler: which block starts when.

Channels are independent; within a channel one exchange runs at a time, ordered by due time, then priority, then number.
A block that comes due while it waits or runs counts an overrun and runs once. The scheduler is told the time and calls
`start` for a block whose turn it is; how an exchange works is not known here.
"""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Callable, Collection, Hashable, Iterable, Iterator, Mapping, Sequence
from functools import partial

from framekit.definition.times import NEVER
from framekit.memory.memory import DeviceMemory
from framekit.run.block_state import BlockState, Failure
from framekit.run.lanes import BlockLane, LaneRules
from framekit.run.model import BLOCKS_IN_SET, Block, Silence
from framekit.run.triggers import ArmedTriggers, Cycle, Resolve


class TriggerRegistry:
    """Arms blocks. `wake` is called when one comes due by its memory triggers.

    `fired`: those that have come due since they were last taken, always the same list. `timers`: a heap of times when
    blocks are due next. `after`: blocks that wait for an end, by the block's id and whether it is a good one.
    """

    def __init__(self, memory: DeviceMemory, resolve: Resolve, wake: Callable[[], None]) -> None:
        self.memory = memory
        self.resolve = resolve
        self.fired: list[BlockState] = []
        self._wake = wake
        self.timers: list[tuple[int, int, Cycle | None, BlockState, int]] = []
        self._order = itertools.count()
        self.after: dict[tuple[int, bool], list[BlockState]] = {}

    def await_ends(self, state: BlockState) -> None:
        """From now on the block hears of the ends it waits for: those of blocks of its set."""
        for trigger in state.block.triggers:
            if trigger.follows is not None:
                number, ok = trigger.follows
                self.after.setdefault((BLOCKS_IN_SET * (state.block.set - 1) + number, ok), []).append(state)

    def arm(self, state: BlockState, now: int) -> None:
        """Arms the triggers of a block; its time triggers count from here."""
        state.round += 1
        note = partial(self.fired.append, state)
        state.armed = armed = ArmedTriggers(
            self.memory, self.resolve, note, self._wake, lambda when, cycle: self._at(when, cycle, state)
        )
        armed.arm(state.block.triggers, state.block.unless, now)

    def disarm(self, state: BlockState) -> None:
        """Nothing but the ends of other blocks makes it due any more."""
        state.round += 1
        if state.armed is not None:
            state.armed.cancel()
            state.armed = None

    def forget(self, state: BlockState) -> None:
        """A block is no more."""
        self.disarm(state)
        self.fired[:] = [fired for fired in self.fired if fired is not state]
        for waiting in self.after.values():
            waiting[:] = [other for other in waiting if other is not state]

    def clear(self) -> None:
        """Nothing comes due any more of what was to."""
        self.timers.clear()
        self.fired.clear()

    # ---- what happens -------------------------------------------------------------------------------------

    def ended_at_once(self, state: BlockState, ok: bool, later: int) -> None:
        """A block has ended while it was being started; one in whose chain it is already is due only `later`."""
        waiting = self.after.get((state.id, ok))
        if not waiting:
            return
        chain = (*state.chain, state.id)
        for one in waiting:
            if one.id in chain:
                self.at(later, one)
            else:
                one.chain = chain
                self.fired.append(one)

    # ---- time ---------------------------------------------------------------------------------------------

    def at(self, when: int, state: BlockState) -> None:
        """The block is due at `when`, if it has not been armed anew by then."""
        self._at(when, None, state)

    def _at(self, when: int, cycle: Cycle | None, state: BlockState) -> None:
        heapq.heappush(self.timers, (when, next(self._order), cycle, state, state.round))

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


class ReadyQueue:
    """Lanes by number. What changes a lane says so by `note` or `postpone`; `due` names it when its time has come."""

    def __init__(
        self, station_of: Callable[[BlockState], Hashable], held_until: Callable[[int, Hashable], int]
    ) -> None:
        self.lanes: dict[int, BlockLane] = {}
        self._station_of, self._held_until = station_of, held_until
        self._number = itertools.count()
        self.noted: list[BlockLane] = []
        """Lanes that may have something to do now."""
        self.waits_until = NEVER
        """Before this time no other lane has something to do."""
        self._heap: list[tuple[int, int, BlockLane]] = []

    def add(self, number: int, rules: LaneRules) -> BlockLane:
        """The lane of this number, which is made if there is none."""
        lane = self.lanes.get(number)
        if lane is None:
            held_until = partial(self._held_until, number)
            lane = self.lanes[number] = BlockLane(rules, self._station_of, next(self._number), held_until)
        return lane

    def remove(self, number: int) -> None:
        """Nothing waits there any more."""
        del self.lanes[number]

    def hold(self, numbers: Collection[int]) -> None:
        """Nothing starts in these lanes until the next call; in all others it does."""
        for number, lane in self.lanes.items():
            lane.held = number in numbers
            self.note(lane)

    def idle(self, numbers: Collection[int]) -> bool:
        """Whether nothing runs in any of these lanes."""
        return not any(self.lanes[number].busy for number in numbers if number in self.lanes)

    def clear(self, which: Callable[[BlockState], bool] = lambda state: True) -> None:
        """Forgets blocks that wait."""
        for lane in self.lanes.values():
            lane.clear(which)

    def note(self, lane: BlockLane) -> None:
        """Something about the lane is different: it may have something to do now."""
        if not lane.noted:
            lane.noted = True
            self.noted.append(lane)

    def postpone(self, lane: BlockLane) -> None:
        """It has nothing to do now: it is looked at when its time has come."""
        when = lane.deadline
        if when < lane.asked_for:
            lane.asked_for = when
            heapq.heappush(self._heap, (when, lane.order, lane))
            self.waits_until = self._heap[0][0]

    def due(self, now: int) -> Sequence[BlockLane]:
        """Return the lanes that may start something now, in their order; `postpone` a lane that starts nothing."""
        heap = self._heap
        if self.waits_until <= now:
            while heap and heap[0][0] <= now:
                when, _, lane = heapq.heappop(heap)
                if when == lane.asked_for:
                    lane.asked_for = NEVER
                    self.note(lane)
            self.waits_until = heap[0][0] if heap else NEVER
        found, self.noted = self.noted, []
        if len(found) == 1:
            found[0].noted = False
        elif found:
            for lane in found:
                lane.noted = False
            found.sort(key=lambda lane: lane.order)
        return found

    @property
    def deadline(self) -> int:
        """Return when the first lane has something to do; 0: now."""
        if self.noted:
            return 0
        if self.waits_until == NEVER:
            return NEVER
        heap = self._heap
        while heap:
            when, _, lane = heap[0]
            if when == lane.asked_for == lane.deadline:
                break
            heapq.heappop(heap)
            if when == lane.asked_for:
                lane.asked_for = NEVER
                self.postpone(lane)
        self.waits_until = heap[0][0] if heap else NEVER
        return self.waits_until


LEAST_TIME = 1_000_000
"""One that ends at once, or fails within 1 ms, holds its channel for 1 ms; a `while` block starts again 1 ms after its
end at the earliest, and so does one that blocks have started in a circle without waiting for anything: so blocks that
start each other, or themselves, and never wait for the other side, stop nothing."""

Joins = Callable[[BlockState, list[BlockState]], list[BlockState]]
"""Which of the waiting blocks may come with the exchange of a block."""


class Scheduler:
    """Makes blocks due and starts them, channel by channel.

    `channels`: how each treats its line, or just the silence between two exchanges (ns). `start(state, now)` begins
    the exchange of a block and its companions; the end of each is told by `finished`. `wake()` asks the owner to call
    `tick` soon: something came due between two ticks. `ended(state, ok, now)` hears of every completion, after it has
    been counted and before anything that waits for it comes due. `station_of` tells which station a block talks to,
    `joins` which waiting blocks may come with another one's exchange, `sets` which parameter sets are enabled,
    `died(channel, station, dead)` hears of stations that are given up or back. `look()`: nothing came due by the end of
    an exchange, but `deadline` may be another one. `held_until(channel, station)`: no request to the station is sent
    before this time.
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
        look: Callable[[], None] | None = None,
        held_until: Callable[[int, Hashable], int] = lambda channel, station: 0,
    ) -> None:
        self.states = {block.id: BlockState(block) for block in blocks}
        self.sets = dict(sets or {})
        self._registry = TriggerRegistry(memory, resolve, wake)
        self._ready = ReadyQueue(station_of, held_until)
        self.lanes = self._ready.lanes
        self._start = start
        self._wake = wake
        self._look = wake if look is None else look
        self._tell_ended = ended
        self._joins = joins
        self._died = died
        self._active = False
        self._starting: BlockState | None = None
        for channel, rules in channels.items():
            self._ready.add(channel, LaneRules(silence=Silence(between=rules)) if isinstance(rules, int) else rules)
        for state in self.states.values():
            self._take_in(state)

    def _take_in(self, state: BlockState) -> None:
        """A block without a channel waits for nothing: it has a lane of its own."""
        state.set_on = self.sets.get(state.block.set, True)
        self._registry.await_ends(state)
        state.queue = lane = self._ready.add(state.lane, LaneRules())
        if state.has_station:
            place = state.block.station_from
            lane.stations.add(repr(state.block.station) if place is None else place.text)

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
            self._registry.arm(state, now)

    def end(self) -> None:
        """No block comes due any more; what runs may finish."""
        self._active = False
        self._registry.clear()
        self._ready.clear()
        for state in self.states.values():
            self._registry.disarm(state)

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
            self._ready.note(lane)
            self._mark_changes(channel, lane)
            self._wake()

    def enable(self, number: int, on: bool, now: int) -> None:
        """Switches a block on or off; what runs ends as it does. Raises KeyError for a number there is not."""
        state = self.states[number]
        state.switched_on = on
        if not on:
            self.lanes[state.lane].clear(lambda one: one is state)
        elif state.armed is not None and state.armed.level_holds():
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
                    self.arm(state, now) if on else self._registry.disarm(state)
        if not on:
            self._ready.clear(lambda state: state.block.set == number)
        self._wake()

    # ---- change -------------------------------------------------------------------------------------------

    def hold(self, channels: Collection[int]) -> None:
        """Starts nothing on these channels until the next call; on all others it does."""
        self._ready.hold(channels)
        self._wake()

    def idle(self, channels: Collection[int]) -> bool:
        """Whether no exchange runs on any of these channels."""
        return self._ready.idle(channels)

    def add_channel(self, number: int, rules: LaneRules) -> None:
        """A channel that is new, or treats its line otherwise; it is not open yet. What waits there goes on waiting."""
        lane = self._ready.add(number, rules)
        lane.rules, lane.open = rules, False

    def remove_channel(self, number: int) -> None:
        """A channel none of whose blocks is there any more."""
        self._ready.remove(number)

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
        self._registry.forget(state)
        self.lanes[state.lane].clear(lambda one: one is state)
        if state.block.job is not None:
            self._ready.remove(state.lane)
        return state

    # ---- becoming due -------------------------------------------------------------------------------------

    def fire(self, number: int, now: int) -> None:
        """Makes a block due by hand. Raises KeyError for a number there is not."""
        self._due(self.states[number], now)
        self.tick(now)

    def takes(self, number: int) -> bool:
        """Whether a RECEIVE block takes its frame now. Raises KeyError for a number there is not."""
        return self._may_start(self.states[number])

    def _may_start(self, state: BlockState) -> bool:
        if not (state.switched_on and state.set_on and self._active and state.starts_left != 0):
            return False
        triggers = state.armed
        return triggers is None or triggers.unless is None or not triggers.unless()

    def _due(self, state: BlockState, now: int) -> None:
        if not (state.switched_on and state.set_on and self._active) or state.starts_left == 0:
            return
        triggers, lane = state.armed, state.queue
        if triggers is not None and triggers.unless is not None and triggers.unless():
            return
        if state.waiting or state.running:
            state.overruns += 1
            if state.waiting:
                lane.look_again(state)
                self._ready.note(lane)
            return
        state.waiting = True
        heapq.heappush(lane.waiting, (now, -state.block.priority, state.id, state))
        if not lane.running:
            self._ready.note(lane)

    # ---- time ---------------------------------------------------------------------------------------------

    @property
    def deadline(self) -> int:
        """Return when `tick` has to be called next; 0: now."""
        registry, ready = self._registry, self._ready
        if registry.fired or ready.noted:
            return 0
        turns = ready.waits_until if ready.waits_until == NEVER else ready.deadline
        timers = registry.timers
        return timers[0][0] if timers and timers[0][0] < turns else turns

    def tick(self, now: int) -> None:
        """Makes due what is due now, and starts what can start."""
        registry = self._registry
        timers, fired = registry.timers, registry.fired
        if timers and timers[0][0] <= now:
            for state, due, missed in registry.due(now):
                self._due(state, due)
                if missed and self._may_start(state):
                    state.overruns += missed
        if fired:
            came = fired.copy()
            fired.clear()
            for state in came:
                self._due(state, now)
        ready = self._ready
        if ready.noted or ready.waits_until <= now:
            for lane in ready.due(now):
                first = lane.take(now)
                if first is None:  # else its end says when the lane has something to do
                    ready.postpone(lane)
                    continue
                if lane.waiting and self._joins is not None and not first.probing:
                    self._join(lane, first, self._joins, now)
                else:
                    first.companions = ()
                    self._starting = first
                first.begun(now)
                self._start(first, now)
                self._starting = None

    def _join(self, lane: BlockLane, state: BlockState, joins: Joins, now: int) -> None:
        """Waiting blocks may come with the exchange of this one."""
        state.companions = tuple(lane.companions(lambda others: joins(state, others)))
        for one in state.companions:
            one.begun(now)

    def finished(self, number: int, failure: Failure | None, now: int) -> None:
        """Count the end of an exchange, as `over` does; a block that no longer exists has no end."""
        state = self.states.get(number)
        if state is not None:
            self.over(state, failure, now)

    def over(self, state: BlockState, failure: Failure | None, now: int) -> None:
        """Count the end of an exchange, a good end if `failure` is None; blocks that wait for it come due.

        A second report of the same end changes nothing.
        """
        if not state.running:
            return
        lane, registry = state.queue, self._registry
        at_once = now - state.started_at < (1 if failure is None else LEAST_TIME)  # real time goes on meanwhile
        lane.ended(state, failure, now, LEAST_TIME if at_once else 0)
        if lane.waiting or lane.failing:
            if lane.free_from > now:
                self._ready.postpone(lane)
            else:
                self._ready.note(lane)
        if lane.changed:
            self._mark_changes(state.lane, lane)
        if state.dead:
            state.dead = lane.is_dead(lane.station_of(state))
        self._ended(state, failure, now)
        armed = state.armed
        if armed is not None and armed.levels and armed.level_holds():
            registry.at(now + LEAST_TIME, state)
        if registry.fired or self._ready.noted:
            self._wake()
        else:
            self._look()

    def _mark_changes(self, channel: int, lane: BlockLane) -> None:
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
        state.started += 1
        self._ended(state, failure, now)
        self._wake()

    def _ended(self, state: BlockState, failure: Failure | None, now: int) -> None:
        ok = failure is None
        state.ended(failure, now)
        self._tell_ended(state, ok, now)
        if self._starting is state:
            self._registry.ended_at_once(state, ok, now + LEAST_TIME)
        elif waiting := self._registry.after.get((state.id, ok)):
            self._registry.fired.extend(waiting)
        if state.chain:
            state.chain = ()
