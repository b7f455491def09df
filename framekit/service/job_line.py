"""Jobs without a run: a job table whose commands come from a program, with the channels that it wants and its memory.

What a command's words mean is its application's; who asks, and what is shown of it, is not known here.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from framekit.definition.model.protocol import Protocol
from framekit.definition.problems import NOWHERE
from framekit.definition.times import NEVER
from framekit.link.observe import Monitor
from framekit.memory.memory import DeviceMemory
from framekit.run.block_state import Failure
from framekit.run.job_profile import JobProfile
from framekit.run.model import Block, Channel, JobsSection, Opening
from framekit.runfile.devices import memory_of
from framekit.service.channel import ChannelService
from framekit.service.device import DeviceService
from framekit.service.jobs import JobService
from framekit.service.memory_access import AddressedMemory
from framekit.service.ports import devices_of, port_for
from framekit.service.resolver import resolver_for
from framekit.transport.clock import Clock, Handle

Ended = Callable[[Failure | None], None]
"""Told once how a command was answered; None when all is well."""


class JobLine:
    """Jobs over a memory with the areas of `application`. `channel`: what leads to hosts, as in `Opening`.

    `closed` is told why a way to a host is closed, or could not be opened.
    """

    def __init__(
        self,
        application: Protocol,
        profile: JobProfile,
        channel: Channel,
        clock: Clock,
        monitor: Monitor | None = None,
        closed: Callable[[str], None] = lambda reason: None,
    ) -> None:
        areas, grammar = memory_of(application)
        self.application = application
        self.clock = clock
        self.memory = DeviceMemory(areas)
        self.channels: dict[int, ChannelService] = {}
        self._access = AddressedMemory(self.memory, grammar)
        self._devices: dict[int, list[DeviceService]] = {}
        self._monitor = monitor
        self._closed = closed
        self._ended: dict[int, Ended] = {}
        self._number = 0
        self._timer: Handle | None = None
        opening = Opening(channel=channel, connections=len(profile.slots))
        section = JobsSection(profile=profile, opening=opening, at=NOWHERE)
        self.jobs = JobService(
            section, self.memory, self.channels, clock, self._finished, self._arm, resolver_for(clock), self
        )
        self.table = self.jobs.table

    # ---- life ---------------------------------------------------------------------------------------------

    def start(self) -> None:
        """Commands are taken from now on. Raises DefinitionError, ValueError for a port that cannot be made."""
        self.jobs.hosts.open_now()
        self.jobs.start()
        self._arm()

    def stop(self) -> None:
        """All jobs are aborted, and their connections closed."""
        self.jobs.stop()
        self.jobs.hosts.close_all()
        self._arm()

    @property
    def active(self) -> bool:
        """Whether a job is at work."""
        return any(slot.active for slot in self.table.slots.values())

    def carry_out(self, data: bytes, ended: Ended) -> None:
        """Carries out the command that begins with these bytes; `ended` is told its answer, perhaps at once.

        Raises CommandFaultError when they are none.
        """
        self._number += 1
        self._ended[self._number] = ended
        self.jobs.take_words(data, self.application, self._number)

    def _finished(self, number: int, failure: Failure | None) -> None:
        ended = self._ended.pop(number, None)
        if ended is not None:
            ended(failure)

    # ---- channels -----------------------------------------------------------------------------------------

    def open_for_jobs(self, channel: Channel) -> None:
        """Makes and opens a channel. Raises ValueError for a port that cannot be made."""
        port, devices = port_for(channel, devices_of(channel, Path.cwd()), self.clock)
        made = ChannelService(channel, port, self.clock, self._access, (), self, self._monitor)
        self.channels[channel.number], self._devices[channel.number] = made, devices
        for device in devices:
            device.start()
        made.start()

    def close_for_jobs(self, number: int) -> None:
        """Closes it, and forgets it."""
        self.channels[number].stop()
        self.jobs.opened(number, False)
        for device in self._devices.pop(number):
            device.stop()
        del self.channels[number]

    def opened(self, channel: int, is_open: bool) -> None:
        """Whether exchanges can be started on a channel now."""
        if not is_open:
            self._closed(self.channels[channel].state)
        self.jobs.opened(channel, is_open)

    def takes(self, block: int) -> Block | None:
        """There are no blocks that receive."""
        return None

    def arrived(self, block: int, failure: Failure | None) -> None:
        """There are no blocks that receive."""

    # ---- time ---------------------------------------------------------------------------------------------

    def _tick(self) -> None:
        self._timer = None
        self.jobs.tick(self.clock.now())
        self._arm()

    def _arm(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if self.table.running and self.jobs.deadline < NEVER:
            self._timer = self.clock.call_at(self.jobs.deadline, self._tick)
