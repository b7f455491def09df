"""The scheduler of blocks: make blocks due by their triggers, and start them in turn.

Channels are independent; within a channel one exchange runs at a time, ordered by due time, then priority, then number.
A block that comes due while it waits or runs counts an overrun and runs once. The caller gives the time; the scheduler
calls `start` for the next block of a channel and knows neither protocols nor ports.
"""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Callable, Collection, Hashable, Iterable, Iterator, Mapping, Sequence
from functools import partial

from framekit.definition.times import NEVER
from framekit.link.events import POSTPONED
from framekit.memory.memory import DeviceMemory
from framekit.run.block_state import BlockState, Failure
from framekit.run.lanes import NOT_HELD, BlockLane, Held, LaneRules
from framekit.run.model import BLOCKS_IN_SET, Block, Silence
from framekit.run.triggers import ArmedTriggers, Cycle, Resolve


class TriggerRegistry:
    """Arms blocks, and collects those that come due. `wake` is called when a memory trigger makes a block due."""

    def __init__(self, memory: DeviceMemory, resolve: Resolve, wake: Callable[[], None]) -> None:
        self.memory = memory
        self.resolve = resolve
        self.fired: list[BlockState] = []
        """Blocks that have come due since the last tick; always the same list."""
        self._wake = wake
        self.timers: list[tuple[int, int, Cycle | None, BlockState, int]] = []
        """A heap: due time, order, cycle, block, and its round."""
        self._order = itertools.count()
        self.after: dict[tuple[int, bool], list[BlockState]] = {}
        """Blocks that wait for an end, by the id of the ending block and whether the end is a success."""

    def await_ends(self, state: BlockState) -> None:
        """Register a block with the blocks of its set for whose ends it waits."""
        for trigger in state.block.triggers:
            if trigger.follows is not None:
                number, ok = trigger.follows
                self.after.setdefault((BLOCKS_IN_SET * (state.block.set - 1) + number, ok), []).append(state)

    def arm(self, state: BlockState, now: int) -> None:
        """Arm the triggers of a block; its time triggers count from `now`."""
        state.round += 1
        note = partial(self.fired.append, state)
        state.armed = armed = ArmedTriggers(
            self.memory, self.resolve, note, self._wake, lambda when, cycle: self._at(when, cycle, state)
        )
        armed.arm(state.block.triggers, state.block.unless, now)

    def disarm(self, state: BlockState) -> None:
        """Disarm all triggers of a block but the ends of other blocks."""
        state.round += 1
        if state.armed is not None:
            state.armed.cancel()
            state.armed = None

    def forget(self, state: BlockState) -> None:
        """Remove a block."""
        self.disarm(state)
        self.fired[:] = [fired for fired in self.fired if fired is not state]
        for waiting in self.after.values():
            waiting[:] = [other for other in waiting if other is not state]

    def clear(self) -> None:
        """Drop all timers, and blocks that have come due."""
        self.timers.clear()
        self.fired.clear()

    # ---- events -------------------------------------------------------------------------------------------

    def ended_at_once(self, state: BlockState, ok: bool, later: int) -> None:
        """Make the blocks due that wait for an end during the start itself; a block of the chain is due `later`."""
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
        """Make the block due at `when`, unless it is armed anew before."""
        self._at(when, None, state)

    def _at(self, when: int, cycle: Cycle | None, state: BlockState) -> None:
        heapq.heappush(self.timers, (when, next(self._order), cycle, state, state.round))

    def due(self, now: int) -> Iterator[tuple[BlockState, int, int]]:
        """Yield the blocks with an expired timer: the block, its due time, and the number of periods missed since."""
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
    """Lanes by number, and the times when they can start blocks. Changes of a lane are reported by `note`."""

    def __init__(
        self, station_of: Callable[[BlockState], Hashable], held_until: Callable[[int, Hashable], Held]
    ) -> None:
        self.lanes: dict[int, BlockLane] = {}
        self._station_of, self._held_until = station_of, held_until
        self._number = itertools.count()
        self.noted: list[BlockLane] = []
        """Lanes that may be able to start a block now."""
        self.waits_until = NEVER
        """Before this time no other lane can start a block."""
        self._heap: list[tuple[int, int, BlockLane]] = []

    def add(self, number: int, rules: LaneRules) -> BlockLane:
        """Return the lane of this number; it is made if it does not exist."""
        lane = self.lanes.get(number)
        if lane is None:
            held_until = partial(self._held_until, number)
            lane = self.lanes[number] = BlockLane(rules, self._station_of, next(self._number), held_until)
        return lane

    def remove(self, number: int) -> None:
        """Remove a lane without blocks."""
        del self.lanes[number]

    def hold(self, numbers: Collection[int]) -> None:
        """Hold these lanes back until the next call; all other lanes start blocks."""
        for number, lane in self.lanes.items():
            lane.held = number in numbers
            self.note(lane)

    def idle(self, numbers: Collection[int]) -> bool:
        """Return whether all of these lanes are without a running block."""
        return not any(self.lanes[number].busy for number in numbers if number in self.lanes)

    def clear(self, which: Callable[[BlockState], bool] = lambda state: True) -> None:
        """Drop waiting blocks."""
        for lane in self.lanes.values():
            lane.clear(which)

    def note(self, lane: BlockLane) -> None:
        """Note a change of the lane: it may be able to start a block now."""
        if not lane.noted:
            lane.noted = True
            self.noted.append(lane)

    def postpone(self, lane: BlockLane) -> None:
        """Look at the lane again when it can start a block, at its `deadline`."""
        when = lane.deadline
        if when < lane.asked_for:
            lane.asked_for = when
            heapq.heappush(self._heap, (when, lane.order, lane))
            self.waits_until = self._heap[0][0]

    def due(self, now: int) -> Sequence[BlockLane]:
        """Return the lanes that may start a block now, in their order; `postpone` a lane that starts no block."""
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
        """Return when the first lane can start a block; 0: now."""
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
"""Shortest time of an exchange in the turns of a channel (ns).

A block that ends at once, or fails within this time, holds its channel until the time is over. A `while` block starts
again this time after its end at the earliest, and so does a block that is started in a circle without a wait. So blocks
that start each other, or themselves, without a wait for the other side, hold up no other block."""

Joins = Callable[[BlockState, list[BlockState]], list[BlockState]]
"""Return the waiting blocks that get their data from the exchange of a block."""


class Scheduler:
    """Makes blocks due and starts them, channel by channel.

    `channels`: the rules of each channel, or only the silence between two exchanges (ns). `start(state, now)` begins
    the exchange of a block and its companions; the caller reports the end of each to `finished` or `over`. `wake()`
    requests a call of `tick` soon: a block came due between two ticks. `ended(state, ok, now)` is called for every
    completion, after it has been counted and before the blocks that wait for it come due. `station_of` returns the
    station of a block, `joins` its companions. `sets`: the parameter sets, and whether they are enabled.
    `died(channel, station, dead)` is called when a station dies or comes back, `look()` when the end of an exchange
    made no block due but may have changed `deadline`. `held_until(channel, station)` returns the time before which no
    request to the station is sent, and `delayed(state, until)` is called for a block that waits for that, up to a time
    (ns). `untaken(state)` is called for a command block that may not wait for its channel.
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
        held_until: Callable[[int, Hashable], Held] = lambda channel, station: NOT_HELD,
        delayed: Callable[[BlockState, int], None] = lambda state, until: None,
        untaken: Callable[[BlockState], None] = lambda state: None,
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
        self._delayed = delayed
        self._untaken = untaken
        self._active = False
        self._began = 0
        """Time of the start of the run, or of its last reset (ns)."""
        self._starting: BlockState | None = None
        for channel, rules in channels.items():
            self._ready.add(channel, LaneRules(silence=Silence(between=rules)) if isinstance(rules, int) else rules)
        for state in self.states.values():
            self._take_in(state)

    def _take_in(self, state: BlockState) -> None:
        """Register a block with its triggers and its lane; a block without a channel has a lane of its own."""
        state.set_on = self.sets.get(state.block.set, True)
        self._registry.await_ends(state)
        lane = self._ready.add(state.lane, LaneRules())
        if state.has_station:
            place = state.block.station_from
            lane.stations.add(repr(state.block.station) if place is None else place.text)

    # ---- life ---------------------------------------------------------------------------------------------

    def begin(self, now: int) -> None:
        """Arm the triggers of all blocks. Time triggers count from `now`."""
        self._active, self._began = True, now
        for state in self.states.values():
            self.arm(state, now)
        self.tick(now)

    def arm(self, state: BlockState, now: int) -> None:
        """Arm the triggers of a block, unless its set is off; its time triggers count from `now`."""
        if state.set_on:
            self._registry.arm(state, now)

    def end(self) -> None:
        """Let no block come due any more; running exchanges may finish."""
        self._active = False
        self._registry.clear()
        self._ready.clear()
        for state in self.states.values():
            self._registry.disarm(state)

    def reset(self, now: int) -> None:
        """Set all blocks as at the start, time triggers counting from `now`; running exchanges stay counted."""
        self.end()
        for state in self.states.values():
            state.reset()
        for channel, lane in self.lanes.items():
            lane.forget_failures()
            self._mark_changes(channel, lane)
        self.begin(now)

    # ---- channels, sets and blocks, on and off ------------------------------------------------------------

    def set_open(self, channel: int, is_open: bool, now: int = 0) -> None:
        """Note whether a channel is open; while it is not, its blocks wait."""
        lane = self.lanes[channel]
        if not is_open:
            lane.open = False
        elif not lane.open:
            lane.opened(now)
            self._ready.note(lane)
            self._mark_changes(channel, lane)
            self._wake()

    def enable(self, number: int, on: bool, now: int) -> None:
        """Switch a block on or off; a running exchange is not affected. Raise KeyError for an unknown number."""
        state = self.states[number]
        state.switched_on = on
        if not on:
            self.lanes[state.lane].clear(lambda one: one is state)
        elif state.armed is not None and state.armed.level_holds():
            self._due(state, now)
            self._wake()

    def enable_set(self, number: int, on: bool, now: int) -> None:
        """Switch a parameter set on (its time triggers count from `now`) or off. Raise KeyError if it is unknown."""
        if number not in self.sets:
            raise KeyError(number)
        self.set_enabled(number, on, now)

    def set_enabled(self, number: int, on: bool, now: int) -> None:
        """Switch a parameter set on or off; an unknown set is added."""
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
        """Hold the blocks of these channels back until the next call; all other channels start blocks."""
        self._ready.hold(channels)
        self._wake()

    def idle(self, channels: Collection[int]) -> bool:
        """Return whether no exchange runs on any of these channels."""
        return self._ready.idle(channels)

    def add_channel(self, number: int, rules: LaneRules) -> None:
        """Add a channel, or change its rules; it is not open yet. Its waiting blocks go on waiting."""
        lane = self._ready.add(number, rules)
        lane.rules, lane.open = rules, False

    def remove_channel(self, number: int) -> None:
        """Remove a channel without blocks."""
        self._ready.remove(number)

    def add(self, block: Block) -> BlockState:
        """Add a block; the caller arms it (`arm`) when everything that its triggers read exists."""
        self.states[block.id] = state = BlockState(block)
        in_order = sorted(self.states.items())
        self.states.clear()
        self.states.update(in_order)
        self._take_in(state)
        return state

    def remove(self, number: int) -> BlockState:
        """Remove a block that does not run, and return its state. Raise KeyError for an unknown number."""
        state = self.states.pop(number)
        self._registry.forget(state)
        self.lanes[state.lane].clear(lambda one: one is state)
        if state.block.job is not None:
            self._ready.remove(state.lane)
        return state

    # ---- becoming due -------------------------------------------------------------------------------------

    def fire(self, number: int, now: int) -> None:
        """Make a block due by hand. Raise KeyError for an unknown number."""
        self._due(self.states[number], now)
        self.tick(now)

    def takes(self, number: int) -> bool:
        """Return whether a RECEIVE block takes its frame now. Raise KeyError for an unknown number."""
        return self._may_start(self.states[number])

    def _may_start(self, state: BlockState) -> bool:
        if not (state.switched_on and state.set_on and self._active and state.starts_left != 0):
            return False
        triggers = state.armed
        return triggers is None or triggers.unless is None or not triggers.unless()

    def _due(self, state: BlockState, now: int) -> None:
        if not (state.switched_on and state.set_on and self._active) or state.starts_left == 0:
            return
        triggers = state.armed
        if triggers is not None and triggers.unless is not None and triggers.unless():
            return
        lane = self.lanes[state.lane]
        if state.waiting or state.running:
            state.overruns += 1
            if state.waiting:
                lane.look_again(state)
                self._ready.note(lane)
            return
        if state.block.commands is not None and (fault := lane.command_fault(now - self._began)):
            self._refuse(state, fault, now)
            return
        state.waiting = True
        heapq.heappush(lane.waiting, (now, -state.block.priority, state.id, state))
        if not lane.running:
            self._ready.note(lane)

    def _refuse(self, state: BlockState, fault: str, now: int) -> None:
        """Count a command block that may not wait as an exchange, started and failed."""
        if state.starts_left:
            state.starts_left -= 1
        state.started += 1
        self._untaken(state)
        self._ended(state, Failure(outcome="queue_full", cause=fault), now)
        if (armed := state.armed) is not None and armed.levels and armed.level_holds():
            self._registry.at(now + LEAST_TIME, state)

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
        """Make blocks due, and start the blocks that can start now."""
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
                if lane.delayed:
                    self._report_delays(lane)
                if first is None:  # else the end of the block looks after the lane
                    ready.postpone(lane)
                    continue
                if lane.waiting and self._joins is not None and not lane.is_failing(first):
                    self._join(lane, first, self._joins, now)
                else:
                    first.companions = ()
                    self._starting = first
                first.begun(now)
                self._start(first, now)
                self._starting = None

    def _report_delays(self, lane: BlockLane) -> None:
        found, lane.delayed = lane.delayed, []
        for state, until in found:
            self._delayed(state, until)

    def look_at(self, channel: int) -> None:
        """Start blocks of a channel that were delayed: requests no longer wait for late replies."""
        lane = self.lanes[channel]
        if lane.delays and not lane.running:
            self._ready.note(lane)
            self._wake()

    def is_shared(self, channel: int) -> bool:
        """Return whether the blocks of a channel ask several stations."""
        lane = self.lanes.get(channel)
        return lane is not None and len(lane.stations) > 1

    def _join(self, lane: BlockLane, state: BlockState, joins: Joins, now: int) -> None:
        """Set the companions of a block: waiting blocks that get their data from its exchange."""
        state.companions = tuple(lane.companions(lambda others: joins(state, others)))
        for one in state.companions:
            one.begun(now)

    def finished(self, number: int, failure: Failure | None, now: int) -> None:
        """Count the end of an exchange, as `over` does; ignore a block that no longer exists."""
        state = self.states.get(number)
        if state is not None:
            self.over(state, failure, now)

    def over(self, state: BlockState, failure: Failure | None, now: int) -> None:
        """Count the end of an exchange, a success if `failure` is None; make the blocks due that wait for it.

        A second report of the same end has no effect.
        """
        if not state.running:
            return
        lane = self.lanes[state.lane]
        if failure is not None and (failure.outcome == POSTPONED or lane.tries_again(state, failure)):
            self._postpone(state, lane, now)
            return
        at_once = now - state.started_at < (1 if failure is None else LEAST_TIME)  # real time goes on meanwhile
        lane.ended(state, failure, now, LEAST_TIME if at_once else 0)
        if lane.waiting or lane.failing or lane.delays:
            if lane.free_from > now:
                self._ready.postpone(lane)
            else:
                self._ready.note(lane)
        if lane.changed:
            self._mark_changes(state.lane, lane)
        if state.dead:
            state.dead = lane.is_dead(lane.station_of(state))
        self._ended(state, failure, now)
        if (armed := state.armed) is not None and armed.levels and armed.level_holds():
            self._registry.at(now + LEAST_TIME, state)
        if self._registry.fired or self._ready.noted:
            self._wake()
        else:
            self._look()

    def _postpone(self, state: BlockState, lane: BlockLane, now: int) -> None:
        """Let a block wait for another turn, before other blocks of its station: blocks of other stations go first.

        The start of its exchange does not count.
        """
        state.postponed()
        lane.postponed(state, now)
        if state.switched_on and state.set_on and self._active:
            state.waiting = True
            heapq.heappush(lane.waiting, (0, -state.block.priority, state.id, state))
        self._ready.note(lane)
        self._wake()

    def _mark_changes(self, channel: int, lane: BlockLane) -> None:
        """Note a death or a return of stations in the blocks that ask them, and report it."""
        for station, dead in lane.changes():
            for state in self.states.values():
                if state.block.channel == channel and lane.station_of(state) == station:
                    state.dead = dead
            self._died(channel, station, dead)

    def arrived(self, number: int, failure: Failure | None, now: int) -> None:
        """Count a received frame of a RECEIVE block as an exchange, started and ended."""
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
