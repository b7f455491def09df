"""A running run: channels, devices, memory and the scheduler on one clock, real or virtual.

All work is done in callbacks of the clock and of ports. This module prints no output; observers pass `monitor`.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Hashable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TypeVar

from framekit.definition.model.protocol import Protocol
from framekit.link.addresses import Address
from framekit.link.events import Tape
from framekit.link.late import LateReplies
from framekit.link.slow import SlowStation
from framekit.memory.clock_bits import SystemBits
from framekit.run.block_state import BlockState, BlockStatus, Failure
from framekit.run.block_words import BlockMemory, SettingError, status_of
from framekit.run.edit import Edit, Removed, added_blocks, plan_edit
from framekit.run.model import POINTS_SET, Block, Channel, Point, RunModel
from framekit.run.own_memory import AddressedMemory, addresses_of, store_pieces
from framekit.run.scheduler import Scheduler
from framekit.run.triggers import awaited_bits
from framekit.run.trouble import Troubles, listed_troubles
from framekit.runfile.devices import put_values
from framekit.service.channel import (
    ChannelOwner,
    ChannelService,
    Exchanges,
    Made,
    RunChannels,
    RunMonitor,
    rules_of,
    undisturbed,
)
from framekit.service.client import ClientService
from framekit.service.device import DeviceService
from framekit.service.line_delays import LineDelays
from framekit.service.order_doubts import NAME as ORDER_DOUBTS
from framekit.service.order_doubts import OrderDoubts
from framekit.service.points import PointService
from framekit.service.run_jobs import ResolveHost, RunJobs, jobs_at_work
from framekit.service.run_loop import RunLoop
from framekit.service.run_status import run_status
from framekit.service.sinks import SinkHost, SinkService
from framekit.service.standstill import Standstill
from framekit.service.state import StateFile, StateKeeper
from framekit.service.value_troubles import OF_BLOCKS, PORT, Item, ValueTroubles
from framekit.transport.clock import Clock, date_at

log = logging.getLogger(__name__)


LONGEST_SHUTDOWN = 5_000_000_000
"""A run ends after this (ns) even if a session could not be closed."""

LONGEST_CLOSING = 120_000_000_000
"""After its stop a run waits for ports that are closing for this long (ns) at most."""


def close_sessions(
    services: Iterable[ChannelService | ClientService], clock: Clock, within: int, end: Callable[[], None]
) -> None:
    """Close the sessions of channels or clients; `end` is called once, when all are closed or after `within` ns.

    Without sessions it is called at once.
    """
    with_session = [service for service in services if service.has_session]
    if not with_session:
        end()
        return
    waiting = set(range(len(with_session)))

    def over() -> None:
        waiting.clear()
        end()

    limit = clock.call_at(clock.now() + within, over)

    def left(number: int) -> None:
        """Count a closed session; called by an engine, so the end is postponed until that call has returned."""
        if number in waiting:
            waiting.remove(number)
            if not waiting:
                limit.cancel()
                clock.call_soon(end)

    for number, service in enumerate(with_session):
        service.close_session(partial(left, number))


OnEnd = Callable[[BlockState, bool], None]
"""Callback for every completion: the state of the block, and whether it succeeded."""


T = TypeVar("T")


def _there(what: str, number: int, known: Mapping[int, T]) -> T:
    """Return an existing item by its number. Raises ValueError."""
    if number not in known:
        raise ValueError(f"there is no {what} {number} – known: {', '.join(map(str, sorted(known)))}")
    return known[number]


def protocol_of(run: RunModel, block: Block) -> Protocol | None:
    """Return the protocol on the channel of a block; None for a block without a channel."""
    return None if block.job is not None else run.channels[block.channel].protocol


Applied = Callable[[Edit], None]


@dataclass(slots=True)
class _Prepared:
    """An edit with its channels made, which waits for its moment."""

    edit: Edit
    applied: Applied
    channels: dict[int, Made] = field(default_factory=dict)


def reports_port(channel: Channel) -> bool:
    """Return whether a port that is not open is trouble: not if the other side opens the connection."""
    return channel.asks or not (channel.listens or channel.wiring.modem is not None)


OnChannel = Callable[[int, ChannelService], None]
"""Callback for a channel that an edit added or changed, before it is opened."""


class RunService(ChannelOwner):
    """Executes a run. `resolve` finds hosts that jobs name; default: the system's resolver.

    `after`: an earlier run, ended, on the same clock; late replies to its requests are late here too.
    `offers_faults`: simulated devices have faults that can be switched on, in addition to their own.

    Raises DefinitionError for a wrong device file, ValueError for a port of no known kind.
    """

    def __init__(
        self,
        run: RunModel,
        clock: Clock,
        monitor: RunMonitor | Tape | None = None,
        on_end: OnEnd | None = None,
        resolve: ResolveHost | None = None,
        after: RunService | None = None,
        offers_faults: bool = False,
    ) -> None:
        self.run = run
        self.clock = clock
        self.memory = run.create_memory()
        self.grammar = addresses_of(run.memory)
        self.access = AddressedMemory(self.memory, self.grammar, self.refresh)
        self.loop = RunLoop(clock, self._act, self._next_time)
        self.channels: dict[int, ChannelService] = {}
        self.on_end = on_end
        self.block_memory = BlockMemory(self.memory, run.memory, run.status, clock.now, self.loop.set)
        self._words = self.block_memory.words
        self.exchanges = Exchanges(self.channels, self.block_memory, self._over)
        self.scheduler = Scheduler(
            run.blocks, self.memory, self.resolve,
            {number: rules_of(channel) for number, channel in run.channels.items()},
            self.exchanges.start, self.loop.wake, self._ended,
            station_of=self.exchanges.station_of, joins=self.exchanges.joins, sets=run.sets, died=self._died,
            look=self._look, held_until=self.exchanges.held_until, delayed=self._delayed, untaken=self._untaken,
        )  # fmt: skip
        for state in self.states.values():
            self.block_memory.add(state, protocol_of(run, state.block))
        self.jobs: RunJobs | None = None
        requests = None if after is None else after.lines.requests
        lines = RunChannels(self.channels, clock, self.access, self, monitor, self.loop, requests, offers_faults)
        self.lines: RunChannels = lines
        self.devices_on = lines.devices
        for number in run.channels:
            lines.put(number, lines.of_run(run, number))
        self.editor = RunEditor(self)
        self.removed = Removed()
        self.on_channel: OnChannel = lambda number, channel: None
        if run.jobs is not None:
            self.jobs = jobs_at_work(
                run.jobs, self.memory, self.channels, clock, self.finished, self.loop.wake, resolve, self
            )
            self.exchanges.take_job = self.jobs.take
        put_values(self.memory, run.initial)
        self.points = PointService(
            run.points, run.blocks, self.memory, clock, self.loop.wake, self.fire, read_only=run.only_reads
        )
        self._has_points = bool(run.points)
        self._never_open: dict[int, str] = {}
        host = SinkHost(run.name, clock, self.points, partial(run_status, self))
        self.troubles = Troubles(clock.now)
        self._standstill = Standstill(clock, self.troubles, run.name)
        self.delays = LineDelays(self.troubles, clock, lambda: self.states.values(), self._late_of)
        self.values = ValueTroubles(self.troubles, clock, self)
        self.delays.on_explained = self.values.explained
        self.points.table.on_quality = self._point_changed
        self.order_doubts = OrderDoubts(run.points, self.points.table, self.memory, self.troubles, clock)
        self.sinks = SinkService(run.sinks, run.points, self.points.table, clock, host, self.troubles)
        self.keeper = self._keeper()
        awaited = self._awaited()
        self.system = SystemBits(self.memory, run.memory, self._bit, awaited, date_at(clock))
        self._bits_first = self._looks_at_bits(awaited)
        self.running = False

    def _keeper(self) -> StateKeeper | None:
        """Restore the kept state and return its keeper; words of blocks come from the run and its counters."""
        state = self.run.state
        if state is None:
            return None
        shape = tuple(row for row in self.memory.shape if row[0] in state.areas)
        file = StateFile(Path(self.run.folder) / state.file, self.run.name, shape)
        keeper = StateKeeper(file, self.memory, self._kept_blocks, self.clock, state.every, self.troubles)
        keeper.restore(place for one in self.states.values() for place in self.block_memory.places(one.block))
        self._show_blocks()
        return keeper

    def _kept_blocks(self) -> list[BlockState]:
        """Return the blocks whose counters outlast a restart: those with a number in the file."""
        return [state for state in self.states.values() if state.block.set != POINTS_SET]

    @property
    def devices(self) -> list[DeviceService]:
        """Return the simulated devices of all channels."""
        return [device for devices in self.devices_on.values() for device in devices]

    # ---- addresses ----------------------------------------------------------------------------------------

    def resolve(self, text: str) -> Address:
        """Return the place of the own memory that a text names. Raises AddressError."""
        return self.grammar.parse(text)

    def _awaited(self) -> set[tuple[str, int]]:
        """Return the bits that triggers and points of the own memory depend on."""
        places = ((point.place.address, point.bits) for point in self.run.points if point.channel is None)
        shown = {(place.area, place.first_bit + bit) for place, bits in places for bit in range(bits)}
        return awaited_bits(self.run.triggers, self.resolve) | shown

    def _bit(self, text: str) -> tuple[str, int]:
        address = self.grammar.parse(text)
        return address.area, address.first_bit

    # ---- reports of the scheduler -------------------------------------------------------------------------

    def finished(self, number: int, failure: Failure | None) -> None:
        """Count the end of the command of a block."""
        self.scheduler.finished(number, failure, self.clock.now())

    def _over(self, state: BlockState, failure: Failure | None) -> None:
        """Count the end of the exchange of a block."""
        self.scheduler.over(state, failure, self.clock.now())

    def _look(self) -> None:
        """Continue work that waits for the end of an exchange, after an exchange that made no block due."""
        if self.jobs is not None or self.editor.waiting is not None:
            self.loop.wake()
        else:
            self.loop.look()

    def _died(self, channel: int, station: Hashable, dead: bool) -> None:
        """Note that a station is given up for now, or is back; `values` reports its failures."""
        log.info("channel %d: station %s %s", channel, station, "is given up for now" if dead else "is back")
        for state in self.states.values():
            if state.block.channel == channel:
                self.block_memory.changed(state)

    def slow(self, channel: int, station: SlowStation, is_slow: bool) -> None:
        """Report that a station answers too late, again when its time changes, and when it answers in time."""
        self.delays.slow(channel, station, is_slow)

    def waits(self, channel: int, station: Hashable, until: int) -> None:
        """Report that no request is sent to a station before `until`, because late replies may come."""
        for state in self.states.values():
            if state.running and state.block.channel == channel:
                self.values.waits(state.block, self._station_of(state), until)

    def _delayed(self, state: BlockState, until: int) -> None:
        """Report that a block waits, because late replies of its station may come before `until`."""
        self.values.waits(state.block, self._station_of(state), until)

    def _untaken(self, state: BlockState) -> None:
        """Set the fault bit of a command block that its channel does not take."""
        if state.block.fault is not None:
            store_pieces(self.memory, [(state.block.fault, 1, b"\x01")])

    def goes_on(self, channel: int) -> None:
        """Start the blocks that waited for late replies."""
        self.scheduler.look_at(channel)

    def is_shared(self, channel: int) -> bool:
        """Return whether blocks of other stations wait while an exchange with a station keeps the channel."""
        return self.scheduler.is_shared(channel)

    def _point_changed(self, point: Point, quality: str, why: str) -> None:
        """Report a point without a good value, with the channel and station of its first block."""
        state = self.states.get(point.blocks[0]) if point.blocks else None
        is_good = quality == "good"
        if state is None or state.block.job is not None or (self.values.is_quiet if is_good else not self.running):
            return
        channel = state.block.channel
        if is_good or (state.enabled and self.channels[channel].is_on):
            self.values.not_good(point, channel, self.exchanges.station_of(state), quality, why)

    def _ended(self, state: BlockState, ok: bool, now: int) -> None:
        self._words.completed(state.key, state, ok, now)
        if self._has_points:
            self.points.ended(state, ok, now)
        if not ok and state.last_failure is not None:
            self.values.failed(state.block, self._station_of(state), state.last_failure)
        elif not self.values.is_quiet:
            self.values.good(state.block)
        if self.on_end is not None:
            undisturbed(self.on_end, state, ok)

    def _station_of(self, state: BlockState) -> Hashable:
        return None if state.block.job is not None else self.exchanges.station_of(state)

    def forget_values(self, changed: Collection[int] = ()) -> None:
        """Expect no values of blocks and channels that were removed or switched off, or of these blocks."""

        def is_idle(channel: int, item: Item) -> bool:
            at_work = self.channels.get(channel)
            if at_work is None or not at_work.is_on:
                return True
            kind, what = item
            if kind == PORT:
                return False
            blocks = (what,) if kind in OF_BLOCKS else blocks_of.get(what, ())
            return not any(number not in changed and number in enabled for number in blocks)

        if not self.values.is_quiet:
            blocks_of: dict[Hashable, tuple[int, ...]] = {point.name: tuple(point.blocks) for point in self.run.points}
            enabled = {state.id for state in self.states.values() if state.enabled}
            self.values.forget(is_idle)

    def starts_by_itself(self, channel: int) -> bool:
        """Return whether an enabled block with a period asks on a channel."""
        states = (state for state in self.states.values() if state.block.channel == channel)
        return any(state.enabled and state.period and state.block.job is None for state in states)

    def overdue(self, blocks: Iterable[int], since: int) -> list[int]:
        """Return the blocks that wait since before a time; no block, if a block has ended well since."""
        states = [self.states[number] for number in blocks if number in self.states]
        if any(state.last_end is not None and state.last_end >= since and state.ended_well for state in states):
            return []
        return [
            state.id
            for state in states
            if state.enabled and state.period and (state.waiting or state.running or state.dead)
        ]

    def _late_of(self, channel: int) -> LateReplies | None:
        """Return the late replies of a channel; None if the run has no such channel."""
        at_work = self.channels.get(channel)
        return None if at_work is None else at_work.engine.late

    def is_explained(self, channel: int, station: Hashable) -> bool:
        """Return whether a reported trouble of a channel explains that the values of a station are too old."""
        blocks = (
            state
            for state in self.states.values()
            if state.block.channel == channel and (station is None or self._station_of(state) == station)
        )
        return self.delays.explains(channel, station, blocks)

    def under_way(self, channel: int, station: Hashable) -> str:
        """Describe the replies to the exchange under way that could not be used; '' without such replies."""
        return self.channels[channel].under_way(station) if channel in self.channels else ""

    # ---- reports of the channels --------------------------------------------------------------------------

    def opened(self, channel: int, is_open: bool) -> None:
        """Note whether exchanges can be started on a channel now."""
        now = self.clock.now()
        self.scheduler.set_open(channel, is_open, now)
        if is_open:
            self._never_open.pop(channel, None)
            self.values.opened(channel)
            self.exchanges.prepare(channel, (state.block for state in self.states.values()))
        elif self.running:
            why = self.channels[channel].state
            if not self.channels[channel].is_on:
                self.forget_values()
            elif reports_port(self.channels[channel].channel):
                works = self.channels[channel].driver.closed_by_engine
                self.values.lost(channel, why if works else f"port not open: {why}")
            if channel in self._never_open:
                self._never_open[channel] = why
            if self._has_points:
                self.points.table.closed(channel, why, now)
        if self.jobs is not None:
            self.jobs.opened(channel, is_open)

    def takes(self, block: int) -> Block | None:
        """Return a RECEIVE block with its present settings; None if it accepts no frame now."""
        self.refresh()
        if not self.scheduler.takes(block):
            return None
        try:
            return self.block_memory.settings.effective(self.states[block].block)
        except SettingError as error:
            self.arrived(block, Failure(outcome="bad_setting", cause=str(error)))
            return None

    def arrived(self, block: int, failure: Failure | None) -> None:
        """Handle the arrival of the frame of a RECEIVE block."""
        self.scheduler.arrived(block, failure, self.clock.now())

    # ---- life ---------------------------------------------------------------------------------------------

    def start(self) -> None:
        """Open the ports and arm the triggers."""
        self.running = self.points.at_work = True
        self._never_open = dict.fromkeys(self.channels, "")
        self.points.table.forget_changes()
        self.loop.start()
        self._standstill.start()
        now = self.clock.now()
        for number in self.channels:
            self.scheduler.set_open(number, False)
        for number in self.channels:
            self.lines.open(number)
        self.system.start(now)
        self.sinks.start()
        if self.jobs is not None:
            self.jobs.start()
        self.scheduler.begin(now)
        if self.keeper is not None:
            self.keeper.start()
        self.loop.set()

    def stop(self) -> None:
        """Stop: no further block starts, ports are closed, and the state is kept."""
        self.values.end()
        self.order_doubts.end()
        self._standstill.stop()
        self.running = False
        self.scheduler.end()
        self._stop_jobs()
        self.loop.stop()
        for number in self.channels:
            self.close_channel(number)
        if self.jobs is not None:
            self.jobs.hosts.close_all()
        self.points.at_work = False
        self.points.give_up("the run was stopped")
        self.sinks.stop()
        if self.keeper is not None:
            self.keeper.stop()
        self.troubles.flush(at_end=True)

    def finish(self, done: Callable[[], None], within: int = LONGEST_SHUTDOWN) -> None:
        """End in good order: no further block starts, open sessions are closed, then `stop`, then `done`.

        After `within` ns it stops the remaining work. Then all modems hang up, also those of channels that an edit
        has removed, for `LONGEST_CLOSING` at most.
        """
        self.scheduler.end()
        self._stop_jobs()

        def end() -> None:
            if self.running:
                self.stop()
            self._when_closed(done)

        close_sessions(self.channels.values(), self.clock, within, end)

    def _when_closed(self, done: Callable[[], None]) -> None:
        """Call `done` once, when no port is closing any more, or after `LONGEST_CLOSING`."""
        left = [done]

        def end() -> None:
            limit.cancel()
            if left:
                left.pop()()

        def give_up() -> None:
            log.warning("the run ends while ports are closing: %s", ", ".join(self.lines.closing.names))
            end()

        limit = self.clock.call_at(self.clock.now() + LONGEST_CLOSING, give_up)
        self.lines.closing.at_end(end)

    def _stop_jobs(self) -> None:
        if self.jobs is not None:
            self.jobs.stop()

    def close_channel(self, number: int) -> None:
        """Close the port of a channel, and those of the simulated devices on its line."""
        self.scheduler.set_open(number, False)
        self.lines.close(number)
        if self.jobs is not None and self.running:
            self.jobs.opened(number, False)

    def open_for_jobs(self, channel: Channel) -> None:
        """Open a channel that jobs request and the run lacks. Raises ValueError for a port that cannot be made."""
        number = channel.number
        self.lines.put(number, self.lines.make(channel, (), self.run.folder))
        self.scheduler.add_channel(number, rules_of(channel))
        self.on_channel(number, self.channels[number])
        self.lines.open(number)

    def close_for_jobs(self, number: int) -> None:
        """Close and remove a channel opened for jobs."""
        self.close_channel(number)
        self.scheduler.remove_channel(number)
        self.lines.remove(number)

    # ---- change -------------------------------------------------------------------------------------------

    def edit(self, run: RunModel, applied: Applied = lambda edit: None) -> None:
        """Apply an edited run once no exchange runs on the affected channels; then call `applied`.

        Raises DefinitionError with the reasons if it cannot be applied, ValueError for a port of no known kind; in both
        cases the run is not changed.
        """
        self.editor.request(run, applied)

    def look_again(self) -> None:
        """Adapt to changed blocks: frames go to the blocks that receive now, clocks run for the blocks that read
        them.
        """
        self.lines.receive_for(self.run, keep=() if self.jobs is None else self.jobs.hosts.opened)
        self.refresh()
        awaited = self._awaited()
        self.system.wait_for(awaited)
        self._bits_first = self._looks_at_bits(awaited)

    def fire(self, number: int) -> None:
        """Make a block due by hand. Raises ValueError for an unknown number, and for a block that receives."""
        self.check_fired(number)
        self.refresh()
        self.scheduler.fire(number, self.clock.now())
        self.loop.set()

    def check_fired(self, number: int) -> None:
        """Raise ValueError for an unknown block, or a block that cannot be made due."""
        if _there("block", number, self.states).block.instruction == "receive":
            raise ValueError(f"block {number} receives: nothing but its frame makes it due")

    def enable_set(self, number: int, on: bool = True) -> None:
        """Switch a set on – its time triggers count from now – or off. Raises ValueError for an unknown set."""
        _there("set", number, self.run.sets)
        self.scheduler.enable_set(number, on, self.clock.now())
        self.set_switched(number)
        self.forget_values()

    def enable_channel(self, number: int, on: bool = True) -> None:
        """Open the port of a channel, or close it: running exchanges fail, due blocks wait. Raises ValueError."""
        _there("channel", number, self.channels)
        self.lines.start(number) if on else self.lines.switch_off(number)

    def reset(self) -> None:
        """Reset to the state after the start: counters at zero, triggers afresh, the first scan again.

        Memory stays unchanged.
        """
        now = self.clock.now()
        self.points.give_up("the run was reset")
        self.system.start(now)
        self.exchanges.reset()
        self.removed.clear()
        for channel in self.channels.values():
            channel.counters.clear()
        if self.jobs is not None:
            self.jobs.reset()
        self.scheduler.reset(now)
        self._show_blocks()
        self.loop.set()

    def enable(self, number: int, on: bool = True) -> None:
        """Switch a block on or off; a running exchange ends normally. Raises ValueError for an unknown number."""
        state = _there("block", number, self.states)
        self.scheduler.enable(number, on, self.clock.now())
        self.block_memory.changed(state)
        self.forget_values()

    def _show_blocks(self) -> None:
        """Bring the words of all blocks up to date."""
        for state in self.states.values():
            self.block_memory.changed(state)

    def set_switched(self, number: int) -> None:
        """Show in the words of its blocks that a parameter set was switched on or off."""
        for state in self.states.values():
            if state.block.set == number:
                self.block_memory.changed(state)

    @property
    def states(self) -> dict[int, BlockState]:
        """Return the running blocks, with their counters, by their ids: numbers in set 1, 64 more for each further
        set.
        """
        return self.scheduler.states

    @property
    def problems(self) -> list[str]:
        """Return the parts that fail now or have lost data: a state that cannot be written, sinks that take no
        values. Of many parts the first are listed, and the others are one line.
        """
        of_values = self.delays.names | self.values.names | {ORDER_DOUBTS}
        return listed_troubles([trouble for trouble in self.troubles.present() if trouble.name not in of_values])

    @property
    def never_open(self) -> list[str]:
        """Return the channels whose ports could never be opened, each with the latest reason."""
        return [
            f"channel {number} was never open: {why}"
            for number, why in self._never_open.items()
            if why and number in self.channels
        ]

    def status(self) -> list[BlockStatus]:
        """Return the state of every block."""
        return [status_of(state) for state in self.states.values()]

    # ---- time ---------------------------------------------------------------------------------------------

    def refresh(self) -> None:
        """Bring the bits that the memory sets by itself up to date; they do not move before the start."""
        if self.running:
            self.system.update(self.clock.now())

    def _act(self, now: int) -> None:
        """Do everything that is due. Bits that no block depends on change after the blocks have started."""
        bits_first = self._bits_first
        if bits_first:
            self._show_bits(now)
        if self.editor.waiting is not None:
            self.editor.step()
        if self.jobs is not None:
            self.jobs.tick(now)
        self.scheduler.tick(now)
        if self._has_points:
            self.points.tick(now)
        if not bits_first and (self.system.look_at <= now or self._words.deadline <= now):
            self._show_bits(now)

    def _show_bits(self, now: int) -> None:
        """Set the bits that the memory sets by itself, and end the pulses that are over."""
        if self.system.look_at <= now:
            self.system.update(now)
        if self._words.deadline <= now:
            self._words.tick(now)

    def _looks_at_bits(self, awaited: Iterable[tuple[str, int]]) -> bool:
        """Return whether the run may read bits that the memory sets by itself, or words of blocks."""
        areas = self.system.areas | self.block_memory.areas
        if self.jobs is not None or any(self.memory.area(area).name in areas for area, _ in awaited):
            return True
        for block in self.run.blocks:
            if block.instruction not in ("send", "receive", "read", "write") or block.unless is not None:
                return True
            station = () if block.station_from is None else (block.station_from,)
            places = (*block.places, *block.data.values(), *station)
            if any(self.memory.area(place.address.area).name in areas for place in places):
                return True
        return False

    def _next_time(self) -> int:
        """Return the time of the next work (ns); 0: now."""
        due, bits, words = self.scheduler.deadline, self.system.due, self._words.deadline
        if bits < due:
            due = bits
        if words < due:
            due = words
        if self._has_points:
            due = min(due, self.points.deadline)
        return due if self.jobs is None else min(due, self.jobs.deadline)


class RunEditor:
    """Changes `service` to an edited run."""

    def __init__(self, service: RunService) -> None:
        self.service = service
        self.waiting: _Prepared | None = None

    def request(self, run: RunModel, applied: Applied) -> None:
        """Apply an edited run as soon as possible; `applied` is called then. A waiting edit is replaced.

        Raises DefinitionError with the reasons when it cannot be applied, ValueError for a port of no known kind; the
        run then continues unchanged.
        """
        service = self.service
        edit = plan_edit(service.run, run)
        prepared = _Prepared(edit, applied)
        for number in (*edit.channels.changed, *edit.channels.new):
            prepared.channels[number] = service.lines.of_run(run, number)
        self.waiting = prepared
        service.scheduler.hold(edit.touched)
        self.step()

    def step(self) -> None:
        """Apply the waiting edit if its moment has come."""
        prepared, service = self.waiting, self.service
        if prepared is None or not service.running or not service.scheduler.idle(prepared.edit.touched):
            return
        self.waiting = None
        self._apply(prepared)
        service.scheduler.hold(())
        prepared.applied(prepared.edit)

    def _apply(self, prepared: _Prepared) -> None:
        service, edit = self.service, prepared.edit
        scheduler, now = service.scheduler, service.clock.now()
        for number in (*edit.blocks.gone, *edit.blocks.changed):
            state = scheduler.remove(number)
            service.removed.add(state)
            service.block_memory.remove(state.block)
            service.exchanges.forget(state.block)
        if service.jobs is not None:
            service.jobs.give_up((*edit.blocks.gone, *edit.blocks.changed))
        for number in (*edit.channels.gone, *edit.channels.changed):
            service.close_channel(number)
            service.delays.forget(number)
        for number in edit.channels.gone:
            scheduler.remove_channel(number)
        for number, made in prepared.channels.items():
            scheduler.add_channel(number, rules_of(edit.run.channels[number]))
            service.lines.put(number, made)
        before, service.run = service.run.sets, edit.run
        for number, on in edit.run.sets.items():
            if before.get(number) != on:  # a switch by hand remains
                scheduler.set_enabled(number, on, now)
                service.set_switched(number)
        added = [scheduler.add(block) for block in added_blocks(edit)]
        for state in scheduler.states.values():
            state.starts = None  # its channel may be another
        for state in added:
            service.block_memory.add(state, protocol_of(edit.run, state.block))
        service.look_again()
        for number in prepared.channels:
            service.on_channel(number, service.channels[number])
            service.lines.open(number)
        for state in added:
            scheduler.arm(state, now)
        service.forget_values(edit.blocks.changed)
