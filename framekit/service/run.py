"""A run at work: channels, devices, memory and the scheduler on one clock, real or virtual.

Everything happens in callbacks of the clock and of ports. Nothing here prints; whoever watches gives `monitor`.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from framekit.blocks.block_memory import BlockMemory, status_of
from framekit.blocks.block_settings import SettingError
from framekit.blocks.block_status import BlockStatus, Failure
from framekit.blocks.conditions import Condition
from framekit.blocks.device import put_values
from framekit.blocks.model import Block, Changed, Rising, Run, While
from framekit.blocks.own_memory import addresses_of
from framekit.blocks.scheduler import BlockState, Scheduler
from framekit.blocks.triggers import bits_of
from framekit.definition.times import NEVER
from framekit.link.addresses import Address
from framekit.link.observe import Seen
from framekit.memory.clock_bits import SystemBits
from framekit.service.channel import ChannelService
from framekit.service.device import DeviceService
from framekit.service.memory_access import AddressedMemory
from framekit.service.ports import devices_of, port_for
from framekit.service.state_file import StateFile
from framekit.service.state_keeper import StateKeeper
from framekit.transport.clock import Clock, Handle

RunMonitor = Callable[[int, Seen], None]
"""Gets everything seen on the lines: the channel's number and what was seen."""
OnEnd = Callable[[BlockStatus, bool], None]
"""Told of every completion: how the block is doing then, and whether it ended well."""


class RunService:
    """Carries a run out. Raises DefinitionError when a device file is wrong, ValueError for a port of no known kind."""

    def __init__(self, run: Run, clock: Clock, monitor: RunMonitor | None = None, on_end: OnEnd | None = None) -> None:
        self.on_end = on_end
        self.run = run
        self.clock = clock
        self.memory = run.memory.create()
        self.grammar = addresses_of(run.memory)
        access = AddressedMemory(self.memory, self.grammar, self.refresh)
        self.devices: list[DeviceService] = []
        self.channels: dict[int, ChannelService] = {}
        folder = Path(run.folder)
        found = {number: devices_of(channel, folder) for number, channel in run.channels.items()}
        for number, channel in run.channels.items():
            port, devices = port_for(channel, found[number], clock)
            self.devices += devices
            receiving = [block for block in run.blocks if block.channel == number and block.instruction == "receive"]
            self.channels[number] = ChannelService(
                channel,
                port,
                clock,
                access,
                receiving,
                self,
                self._watcher(number, monitor),
            )
        pauses = {number: channel.pause for number, channel in run.channels.items()}
        self.block_memory = BlockMemory(self.memory, run.memory, run.status)
        self.scheduler = Scheduler(
            run.blocks, self.memory, self.resolve, pauses, self._start_block, self._wake, self._ended
        )
        for state in self.scheduler.states.values():
            self.block_memory.add(state, run.channels[state.block.channel].protocol)
        put_values(self.memory, run.initial)
        self.keeper = self._keeper()
        self.system = SystemBits(self.memory, run.memory, self._bit, self._awaited_bits())
        self._timer: Handle | None = None
        self._woken = False
        self.running = False

    def _keeper(self) -> StateKeeper | None:
        """What was kept is put back; words of blocks come from the run and its counters."""
        state = self.run.state
        if state is None:
            return None
        shape = tuple(row for row in self.memory.shape if row[0] in state.areas)
        file = StateFile(Path(self.run.folder) / state.file, self.run.name, shape)
        keeper = StateKeeper(file, self.memory, self.states.values, self.clock, state.every)
        keeper.restore(place for one in self.states.values() for place in self.block_memory.places(one.block))
        for one in self.states.values():
            self.block_memory.changed(one)
        return keeper

    @staticmethod
    def _watcher(number: int, monitor: RunMonitor | None) -> Callable[[Seen], None] | None:
        return None if monitor is None else lambda seen: monitor(number, seen)

    # ---- addresses ----------------------------------------------------------------------------------------

    def resolve(self, text: str) -> Address:
        """The place of the own memory that a text names. Raises AddressError."""
        return self.grammar.parse(text)

    def _bit(self, text: str) -> tuple[str, int]:
        address = self.grammar.parse(text)
        return address.area, address.first_bit

    def _awaited_bits(self) -> set[tuple[str, int]]:
        """The bits that triggers look at: only those clocks have to tick."""
        found: set[tuple[str, int]] = set()
        for block in self.run.blocks:
            for trigger in block.triggers:
                if isinstance(trigger, (Rising, While)):
                    places = Condition(trigger.condition, self.resolve).addresses.values()
                    found |= {(place.area, bit) for place in places for bit in range_of(place, place.unit_bits)}
                elif isinstance(trigger, Changed):
                    place = trigger.address
                    found |= {(place.area, bit) for bit in range_of(place, bits_of(trigger))}
        return found

    # ---- life ---------------------------------------------------------------------------------------------

    def start(self) -> None:
        """Opens the ports and arms the triggers."""
        self.running = True
        now = self.clock.now()
        for number in self.channels:
            self.scheduler.set_open(number, False)
        for device in self.devices:
            device.start()
        for channel in self.channels.values():
            channel.start()
        self.system.start(now)
        self.scheduler.begin(now)
        if self.keeper is not None:
            self.keeper.start()
        self._arm()

    def stop(self) -> None:
        """No block starts any more; ports are closed, and the state is kept."""
        self.running = False
        self.scheduler.end()
        if self._timer is not None:
            self._timer.cancel()
        for channel in self.channels.values():
            channel.stop()
        for device in self.devices:
            device.stop()
        if self.keeper is not None:
            self.keeper.stop()

    def fire(self, number: int) -> None:
        """Makes a block due by hand. Raises KeyError for a number there is not."""
        self.scheduler.fire(number, self.clock.now())
        self._arm()

    def enable(self, number: int, on: bool = True) -> None:
        """Switches a block on or off. Raises KeyError for a number there is not."""
        self.scheduler.enable(number, on, self.clock.now())
        self.block_memory.changed(self.states[number])

    @property
    def states(self) -> dict[int, BlockState]:
        """The blocks at work, with their counters, by number."""
        return self.scheduler.states

    @property
    def problems(self) -> list[str]:
        """What keeps the run from doing all it should: a state that cannot be written."""
        return [self.keeper.problem] if self.keeper is not None and self.keeper.problem else []

    def status(self) -> list[BlockStatus]:
        """How every block is doing now."""
        return [status_of(state) for state in self.states.values()]

    # ---- blocks -------------------------------------------------------------------------------------------

    def _start_block(self, state: BlockState, now: int) -> None:
        number = state.block.number
        self.refresh()

        def ended(failure: Failure | None) -> None:
            self.scheduler.finished(number, failure, self.clock.now())

        self.block_memory.started(state)
        try:
            block = self.block_memory.effective(state.block)
        except SettingError as error:
            ended(Failure(outcome="bad_setting", cause=str(error)))
        else:
            self.channels[block.channel].start_block(block, ended)

    def _ended(self, state: BlockState, ok: bool, now: int) -> None:
        self.block_memory.ended(state, ok, now)
        if self.on_end is not None:
            self.on_end(status_of(state), ok)

    def opened(self, channel: int, is_open: bool) -> None:
        """Whether exchanges can be started on a channel now."""
        self.scheduler.set_open(channel, is_open)

    def takes(self, block: int) -> Block | None:
        """A RECEIVE block with its settings as they are now; None when it takes no frame now."""
        self.refresh()
        if not self.scheduler.takes(block):
            return None
        try:
            return self.block_memory.effective(self.states[block].block)
        except SettingError as error:
            self.arrived(block, Failure(outcome="bad_setting", cause=str(error)))
            return None

    def arrived(self, block: int, failure: Failure | None) -> None:
        """The frame of a RECEIVE block came."""
        self.scheduler.arrived(block, failure, self.clock.now())

    # ---- time ---------------------------------------------------------------------------------------------

    def refresh(self) -> None:
        """The bits that the memory sets by itself, as they are now."""
        self.system.update(self.clock.now())

    def _wake(self) -> None:
        """Something came due between two ticks: one call soon is enough for all of it."""
        if not self._woken and self.running:
            self._woken = True
            self.clock.call_soon(self._tick)

    def _tick(self) -> None:
        self._woken = True  # what comes due meanwhile is in the next time the timer is set for
        try:
            if self.running:
                self.refresh()
                self.block_memory.tick(self.clock.now())
                self.scheduler.tick(self.clock.now())
        finally:
            self._woken = False
            self._arm()

    def _arm(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        now = self.clock.now()
        due = min(self.scheduler.deadline, self.system.next_change(now), self.block_memory.deadline)
        if self.running and due < NEVER:
            self._timer = self.clock.call_at(max(due, now), self._tick)


def range_of(address: Address, bits: int) -> range:
    """`bits` bits of its area from an address on."""
    return range(address.first_bit, address.first_bit + bits)
