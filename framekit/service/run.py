"""A run at work: channels, devices, memory and the scheduler on one clock, real or virtual.

Everything happens in callbacks of the clock and of ports. Nothing here prints; whoever watches gives `monitor`.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from framekit.blocks.conditions import Condition
from framekit.blocks.device import put_values
from framekit.blocks.model import Run
from framekit.blocks.scheduler import BlockState, Scheduler
from framekit.definition.times import NEVER
from framekit.link.addresses import Address, AddressGrammar
from framekit.link.observe import Seen
from framekit.memory.clock_bits import SystemBits
from framekit.service.channel import ChannelService
from framekit.service.device import DeviceService
from framekit.service.ports import devices_of, port_for
from framekit.transport.clock import Clock, Handle

RunMonitor = Callable[[int, Seen], None]
"""Gets everything seen on the lines: the channel's number and what was seen."""


class RunService:
    """Carries a run out. Raises DefinitionError when a device file is wrong, ValueError for a port of no known kind."""

    def __init__(self, run: Run, clock: Clock, monitor: RunMonitor | None = None) -> None:
        self.run = run
        self.clock = clock
        self.memory = run.memory.create()
        put_values(self.memory, run.initial)
        self.grammar = AddressGrammar(run.memory.addresses, run.memory.areas, run.memory.tables)
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
                self.memory,
                receiving,
                self._arrived,
                self._opener(number),
                self._watcher(number, monitor),
            )
        pauses = {number: channel.pause for number, channel in run.channels.items()}
        self.scheduler = Scheduler(run.blocks, self.memory, self.resolve, pauses, self._start_block, self._wake)
        self.system = SystemBits(self.memory, run.memory, self._bit, self._awaited_bits())
        self._timer: Handle | None = None
        self._woken = False
        self.running = False

    def _opener(self, number: int) -> Callable[[bool], None]:
        return lambda is_open: self.scheduler.set_open(number, is_open)

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
                expression = getattr(trigger, "condition", None)
                if expression is not None:
                    places = Condition(expression, self.resolve).addresses.values()
                    found |= {(place.area, bit) for place in places for bit in range_of(place)}
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
        self._arm()

    def stop(self) -> None:
        """No block starts any more; ports are closed."""
        self.running = False
        self.scheduler.end()
        if self._timer is not None:
            self._timer.cancel()
        for channel in self.channels.values():
            channel.stop()
        for device in self.devices:
            device.stop()

    def fire(self, number: int) -> None:
        """Makes a block due by hand. Raises KeyError for a number there is not."""
        self.scheduler.fire(number, self.clock.now())
        self._arm()

    @property
    def states(self) -> dict[int, BlockState]:
        """The blocks at work, with their counters, by number."""
        return self.scheduler.states

    # ---- blocks -------------------------------------------------------------------------------------------

    def _start_block(self, state: BlockState, now: int) -> None:
        number = state.block.number
        self.system.update(now)

        def ended(ok: bool, outcome: str) -> None:
            self.scheduler.finished(number, ok, outcome, self.clock.now())

        self.channels[state.block.channel].start_block(state.block, ended)

    def _arrived(self, number: int, ok: bool, outcome: str) -> None:
        self.scheduler.arrived(number, ok, outcome, self.clock.now())

    # ---- time ---------------------------------------------------------------------------------------------

    def _wake(self) -> None:
        """Something came due between two ticks: one call soon is enough for all of it."""
        if not self._woken and self.running:
            self._woken = True
            self.clock.call_soon(self._tick)

    def _tick(self) -> None:
        self._woken = False
        if not self.running:
            return
        now = self.clock.now()
        self.system.update(now)
        self.scheduler.tick(now)
        self._arm()

    def _arm(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        now = self.clock.now()
        due = min(self.scheduler.deadline, self.system.next_change(now))
        if self.running and due < NEVER:
            self._timer = self.clock.call_at(max(due, now), self._tick)


def range_of(address: Address) -> range:
    """The bits of its area that an address covers."""
    return range(address.first_bit, address.first_bit + address.unit_bits)
