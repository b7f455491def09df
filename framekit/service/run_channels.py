"""The channels of a run, each with the simulated devices on its line: made, opened and closed together.

What blocks do on a channel, and when, is not known here.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Iterable
from pathlib import Path

from framekit.link.observe import Seen
from framekit.run.model import Block, Channel, Run
from framekit.service.channel import ChannelOwner, ChannelService
from framekit.service.device import DeviceService
from framekit.service.driver import Moment
from framekit.service.listening_port import ListeningPort
from framekit.service.memory_access import AddressedMemory
from framekit.service.ports import devices_of, port_for
from framekit.transport.clock import Clock

log = logging.getLogger(__name__)

RunMonitor = Callable[[int, Seen], None]
"""Gets everything seen on the lines: the channel's number and what was seen."""

Made = tuple[ChannelService, list[DeviceService]]
"""A channel and the devices on its line."""


class RunChannels:
    """Fills `channels`, by number, and the devices on their lines. `owner` is told what happens on them.

    `moment`: who wants to know when something that a line has brought has been dealt with.
    """

    def __init__(
        self, channels: dict[int, ChannelService], clock: Clock, access: AddressedMemory, owner: ChannelOwner,
        monitor: RunMonitor | None = None, moment: Moment | None = None,
    ) -> None:  # fmt: skip
        self._clock = clock
        self._moment = moment
        self._access = access
        self._owner = owner
        self._monitor = monitor
        self.channels = channels
        self.devices: dict[int, list[DeviceService]] = {}

    def of_run(self, run: Run, number: int) -> Made:
        """A channel of a run, as `make` gives it."""
        return self.make(run.channels[number], receiving(run, number), run.folder)

    def make(self, channel: Channel, blocks: Iterable[Block], folder: str) -> Made:
        """A channel with its devices, not open and none of these yet; `blocks` receive frames there.

        Raises DefinitionError for a wrong device file, ValueError for a port that cannot be made.
        """
        monitor = self._monitor
        listening = ListeningPort(channel, self._clock) if channel.listens else None
        port, devices = (
            port_for(channel, devices_of(channel, Path(folder)), self._clock) if listening is None else (listening, [])
        )
        watcher = None if monitor is None else lambda seen: undisturbed(monitor, channel.number, seen)
        for device in devices:
            device.watch_troubles(lambda trouble: self._trouble(channel.number, trouble))
        service = ChannelService(channel, port, self._clock, self._access, blocks, self._owner, watcher, self._moment)
        if listening is not None:
            service.answer_connections(listening, self._access, watcher)
        return service, devices

    def _trouble(self, number: int, what: str) -> None:
        """A simulated device could not do what it should."""
        log.warning("channel %d: %s", number, what)
        if self._monitor is not None:
            undisturbed(self._monitor, number, Seen("", "trouble", self._clock.now(), reason=what))

    def put(self, number: int, made: Made) -> None:
        """From now on this is the channel of that number."""
        before = self.channels.get(number)
        if before is not None:
            made[0].counters.add(before.counters)
        self.channels[number], self.devices[number] = made

    def remove(self, number: int) -> None:
        """A channel is no more."""
        del self.channels[number], self.devices[number]

    def receive_for(self, run: Run, keep: Collection[int]) -> None:
        """Frames go to the blocks of this run; channels that it does not have are no more, but for those to `keep`."""
        for number in list(self.channels):
            if number in run.channels:
                self.channels[number].receive_for(receiving(run, number))
            elif number not in keep:
                self.remove(number)

    def open(self, number: int) -> None:
        """Opens the port of a channel that is not switched off, and those of the devices on its line."""
        for device in self.devices[number]:
            device.start()
        if self.channels[number].channel.enabled:
            self.channels[number].start()

    def stop_devices(self, number: int) -> None:
        """Closes the ports of the devices on its line."""
        for device in self.devices[number]:
            device.stop()


def receiving(run: Run, channel: int) -> list[Block]:
    """The RECEIVE blocks of a channel."""
    return [block for block in run.blocks if block.channel == channel and block.instruction == "receive"]


def undisturbed(watcher: Callable[..., None], *what: object) -> None:
    """Tells a watcher; what it raises goes to the log, since no exchange may end otherwise because it is watched.

    Only an output that nobody reads any more is the end of the run.
    """
    try:
        watcher(*what)
    except BrokenPipeError:
        raise
    except Exception:
        log.exception("a watcher of the run failed")
