"""A run at work: channels, devices, memory and the scheduler on one clock, real or virtual.

Everything happens in callbacks of the clock and of ports. Nothing here prints; whoever watches gives `monitor`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

from framekit.link.addresses import Address
from framekit.memory.clock_bits import SystemBits
from framekit.run.block_state import BlockState, BlockStatus
from framekit.run.block_words import status_of
from framekit.run.edit import Removed
from framekit.run.model import Block, Channel, Run
from framekit.run.own_memory import addresses_of
from framekit.run.triggers import awaited_bits
from framekit.runfile.devices import put_values
from framekit.service.channel import ChannelService
from framekit.service.device import DeviceService
from framekit.service.edit import Applied, RunEditor
from framekit.service.ending import LONGEST_FAREWELL, Ending
from framekit.service.exchanges import rules_of
from framekit.service.jobs import JobService
from framekit.service.memory_access import AddressedMemory, date_at
from framekit.service.pulse import Pulse
from framekit.service.resolver import Resolve, resolver_for
from framekit.service.run_blocks import OnEnd, RunBlocks
from framekit.service.run_channels import RunChannels, RunMonitor
from framekit.service.state_file import StateFile
from framekit.service.state_keeper import StateKeeper
from framekit.transport.clock import Clock

OnChannel = Callable[[int, ChannelService], None]
"""Gets a channel that an edit has brought or changed, before it is opened."""


class RunService:
    """Carries a run out. `resolve` finds hosts that jobs name; default: the system's way.

    Raises DefinitionError when a device file is wrong, ValueError for a port of no known kind.
    """

    def __init__(
        self,
        run: Run,
        clock: Clock,
        monitor: RunMonitor | None = None,
        on_end: OnEnd | None = None,
        resolve: Resolve | None = None,
    ) -> None:
        self.run = run
        self.clock = clock
        self.memory = run.memory.create()
        self.grammar = addresses_of(run.memory)
        self.access = AddressedMemory(self.memory, self.grammar, self.refresh)
        self.pulse = Pulse(clock, self._act, self._next_time)
        self.channels: dict[int, ChannelService] = {}
        self.blocks = blocks = RunBlocks(
            run, clock, self.memory, self.resolve, self.channels, self.pulse.wake, self.refresh, on_end, self._is_prompt
        )
        self.scheduler, self.block_memory, self.exchanges = blocks.scheduler, blocks.memory, blocks.exchanges
        self.pulse.first = self.scheduler.start_promptly
        self.lines = lines = RunChannels(self.channels, clock, self.access, blocks, monitor, self.pulse)
        self.devices_on = lines.devices
        for number in run.channels:
            lines.put(number, lines.of_run(run, number))
        self.editor = RunEditor(self)
        self.removed = Removed()
        self.on_channel: OnChannel = lambda number, channel: None
        self.jobs = blocks.jobs = self._jobs(resolve or resolver_for(clock))
        put_values(self.memory, run.initial)
        self.keeper = self._keeper()
        awaited = awaited_bits(run.blocks, self.resolve)
        self.system = SystemBits(self.memory, run.memory, self._bit, awaited, date_at(clock))
        self._pulses_count = self._look_at_words(awaited)
        self.running = False

    def _jobs(self, resolve: Resolve) -> JobService | None:
        section = self.run.jobs
        if section is None:
            return None
        wake, done = self.pulse.wake, self.blocks.finished
        return JobService(section, self.memory, self.channels, self.clock, done, wake, resolve, self)

    def _keeper(self) -> StateKeeper | None:
        """What was kept is put back; words of blocks come from the run and its counters."""
        state = self.run.state
        if state is None:
            return None
        shape = tuple(row for row in self.memory.shape if row[0] in state.areas)
        file = StateFile(Path(self.run.folder) / state.file, self.run.name, shape)
        keeper = StateKeeper(file, self.memory, self.states.values, self.clock, state.every)
        keeper.restore(place for one in self.states.values() for place in self.block_memory.places(one.block))
        self.blocks.show()
        return keeper

    @property
    def devices(self) -> list[DeviceService]:
        """The simulated devices of all channels."""
        return [device for devices in self.devices_on.values() for device in devices]

    # ---- addresses ----------------------------------------------------------------------------------------

    def resolve(self, text: str) -> Address:
        """The place of the own memory that a text names. Raises AddressError."""
        return self.grammar.parse(text)

    def _bit(self, text: str) -> tuple[str, int]:
        address = self.grammar.parse(text)
        return address.area, address.first_bit

    # ---- life ---------------------------------------------------------------------------------------------

    def start(self) -> None:
        """Opens the ports and arms the triggers."""
        self.running = True
        self.pulse.start()
        now = self.clock.now()
        for number in self.channels:
            self.scheduler.set_open(number, False)
        for number in self.channels:
            self.lines.open(number)
        self.system.start(now)
        if self.jobs is not None:
            self.jobs.start()
        self.scheduler.begin(now)
        if self.keeper is not None:
            self.keeper.start()
        self.pulse.set()

    def stop(self) -> None:
        """No block starts any more; ports are closed, and the state is kept."""
        self.running = False
        self.scheduler.end()
        self._stop_jobs()
        self.pulse.stop()
        for number in self.channels:
            self.close_channel(number)
        if self.jobs is not None:
            self.jobs.hosts.close_all()
        if self.keeper is not None:
            self.keeper.stop()

    def finish(self, done: Callable[[], None], within: int = LONGEST_FAREWELL) -> None:
        """Ends in good order: no block starts any more, open sessions are closed, then `stop`, then `done`.

        After `within` ns it stops whatever is left.
        """
        self.scheduler.end()
        self._stop_jobs()

        def end() -> None:
            if self.running:
                self.stop()
            done()

        Ending(self.channels.values(), self.clock, within, end)

    def _stop_jobs(self) -> None:
        if self.jobs is not None:
            self.jobs.stop()

    def close_channel(self, number: int) -> None:
        """Closes the port of a channel, and those of the simulated devices on its line."""
        self.scheduler.set_open(number, False)
        self.channels[number].stop()
        if self.jobs is not None and self.running:
            self.jobs.opened(number, False)
        self.lines.stop_devices(number)

    def open_for_jobs(self, channel: Channel) -> None:
        """A channel that jobs want and the run does not have. Raises ValueError for a port that cannot be made."""
        number = channel.number
        self.lines.put(number, self.lines.make(channel, (), self.run.folder))
        self.scheduler.add_channel(number, rules_of(channel))
        self.on_channel(number, self.channels[number])
        self.lines.open(number)

    def close_for_jobs(self, number: int) -> None:
        """Closes such a channel, and forgets it."""
        self.close_channel(number)
        self.scheduler.remove_channel(number)
        self.lines.remove(number)

    # ---- change -------------------------------------------------------------------------------------------

    def edit(self, run: Run, applied: Applied = lambda edit: None) -> None:
        """Applies an edited run once no exchange runs on the channels it touches; `applied` is called then.

        Raises DefinitionError with the reasons when it cannot be, ValueError for a port of no known kind: then nothing
        changes.
        """
        self.editor.request(run, applied)

    def look_again(self) -> None:
        """The blocks are others: frames go to those that receive now, clocks tick for those that look at them."""
        self.lines.receive_for(self.run, keep=() if self.jobs is None else self.jobs.hosts.opened)
        self.refresh()
        awaited = awaited_bits(self.run.blocks, self.resolve)
        self.system.wait_for(awaited)
        self._pulses_count = self._look_at_words(awaited)

    def fire(self, number: int) -> None:
        """Makes a block due by hand. Raises KeyError for a number there is not, ValueError for one that receives."""
        block = self.states[number].block
        if block.instruction == "receive":
            raise ValueError(f"block {number} receives: nothing but its frame makes it due")
        self.refresh()
        self.scheduler.fire(number, self.clock.now())
        self.pulse.set()

    def enable_set(self, number: int, on: bool = True) -> None:
        """Switches a parameter set on or off. Raises KeyError for a number there is not."""
        self.scheduler.enable_set(number, on, self.clock.now())
        self.blocks.set_switched(number)

    def enable_channel(self, number: int, on: bool = True) -> None:
        """Opens the port of a channel, or closes it: what runs there fails, what is due waits. Raises KeyError."""
        channel = self.channels[number]
        channel.start() if on else channel.switch_off()

    def reset(self) -> None:
        """As after the start: counters at zero, triggers afresh, the first scan again. Memory stays as it is."""
        now = self.clock.now()
        self.system.start(now)
        self.exchanges.reset()
        self.removed.clear()
        for channel in self.channels.values():
            channel.counters.clear()
        if self.jobs is not None:
            self.jobs.reset()
        self.scheduler.reset(now)
        self.blocks.show()
        self.pulse.set()

    def enable(self, number: int, on: bool = True) -> None:
        """Switches a block on or off. Raises KeyError for a number there is not."""
        self.scheduler.enable(number, on, self.clock.now())
        self.block_memory.changed(self.states[number])

    @property
    def states(self) -> dict[int, BlockState]:
        """The blocks at work, with their counters, by their ids: numbers in set 1, 64 more for each further set."""
        return self.scheduler.states

    @property
    def problems(self) -> list[str]:
        """What keeps the run from doing all it should: a state that cannot be written."""
        return [self.keeper.problem] if self.keeper is not None and self.keeper.problem else []

    def status(self) -> list[BlockStatus]:
        """How every block is doing now."""
        return [status_of(state) for state in self.states.values()]

    # ---- time ---------------------------------------------------------------------------------------------

    def refresh(self) -> None:
        """The bits that the memory sets by itself, as they are now; they do not move before the start."""
        if self.running:
            self.system.update(self.clock.now())

    def _act(self, now: int) -> None:
        """Does what is due; what somebody waits for, and nothing here has a say in, has been started already."""
        self.system.update(now)
        self.editor.step()
        self.block_memory.tick(now)
        if self.jobs is not None:
            self.jobs.tick(now)
        self.scheduler.tick(now)

    def _is_prompt(self, block: Block) -> bool:
        """Whether what a block does depends on nothing that changes by itself: bits of the memory, jobs, conditions."""
        if block.instruction not in ("send", "read", "write") or block.job is not None or block.unless is not None:
            return False
        places = [*block.places, *block.data.values(), *([] if block.station_from is None else [block.station_from])]
        changing = self.system.areas | self.block_memory.areas
        return not any(place.address.area in changing for place in places)

    def _look_at_words(self, awaited: Iterable[tuple[str, int]]) -> bool:
        """Whether the end of a pulse in the words of blocks may make a block due."""
        return any(self.memory.area(area).name in self.block_memory.areas for area, _ in awaited)

    def _next_time(self, now: int) -> int:
        """When something is due next; until something else than the end of a pulse is, quick starts come first."""
        due, pulses = min(self.scheduler.deadline, self.system.next_change(now)), self.block_memory.deadline
        if self.jobs is not None:
            due = min(due, self.jobs.deadline)
        self.pulse.first_until = min(due, pulses) if self._pulses_count else due
        return min(due, pulses)
