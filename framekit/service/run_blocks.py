"""The blocks of a run at work: the scheduler says which starts when, exchanges carry it out, memory shows how it goes.

Channels tell it what happens on them. What opens and closes them is not known here.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Hashable, Mapping

from framekit.definition.model.protocol import Protocol
from framekit.memory.memory import DeviceMemory
from framekit.run.block_state import BlockState, BlockStatus, Failure, Prompt
from framekit.run.block_words import BlockMemory, SettingError, status_of
from framekit.run.model import Block, Run
from framekit.run.scheduler import Scheduler
from framekit.run.triggers import Resolve
from framekit.service.channel import ChannelService
from framekit.service.exchanges import Exchanges, rules_of
from framekit.service.jobs import JobService
from framekit.service.run_channels import undisturbed
from framekit.transport.clock import Clock

log = logging.getLogger(__name__)

OnEnd = Callable[[BlockStatus, bool], None]
"""Told of every completion: how the block is doing then, and whether it ended well."""


class RunBlocks:
    """`channels` are those of the run; `wake` asks for a tick, `refresh` brings the memory's own bits up to date.

    `is_prompt` tells which blocks depend on nothing that changes by itself.
    `jobs` carries out the commands of blocks that have no channel, where the run has jobs.
    """

    def __init__(
        self, run: Run, clock: Clock, memory: DeviceMemory, resolve: Resolve, channels: Mapping[int, ChannelService],
        wake: Callable[[], None], refresh: Callable[[], None], on_end: OnEnd | None,
        is_prompt: Callable[[Block], bool],
    ) -> None:  # fmt: skip
        self._clock = clock
        self._refresh = refresh
        self._is_prompt = is_prompt
        self.on_end = on_end
        self.jobs: JobService | None = None
        self.memory = BlockMemory(memory, run.memory, run.status)
        self.exchanges = Exchanges(channels, self.memory, self.finished)
        self.scheduler = Scheduler(
            run.blocks,
            memory,
            resolve,
            {number: rules_of(channel) for number, channel in run.channels.items()},
            self._start,
            wake,
            self._ended,
            station_of=self.exchanges.station_of,
            joins=self.exchanges.joins,
            sets=run.sets,
            died=self._died,
            prompt=self._prompt,
        )
        for state in self.states.values():
            self.memory.add(state, protocol_of(run, state.block))

    @property
    def states(self) -> dict[int, BlockState]:
        """The blocks by their ids."""
        return self.scheduler.states

    def show(self) -> None:
        """Brings the words of all blocks up to date."""
        for state in self.states.values():
            self.memory.changed(state)

    def set_switched(self, number: int) -> None:
        """A parameter set is on or off: the words of its blocks show it."""
        for state in self.states.values():
            if state.block.set == number:
                self.memory.changed(state)

    # ---- what the scheduler says --------------------------------------------------------------------------

    def _start(self, state: BlockState, now: int) -> None:
        if state.block.job is None or self.jobs is None:
            self.exchanges.start(state)
        else:
            self.memory.started(state)
            self.jobs.take(state.block.job)

    def _prompt(self, state: BlockState) -> Prompt | None:
        return self.exchanges.prompt(state, self._clock) if self._is_prompt(state.block) else None

    def finished(self, number: int, failure: Failure | None) -> None:
        """The exchange of a block, or its command, has ended."""
        if number in self.states:
            self.scheduler.finished(number, failure, self._clock.now())

    def _died(self, channel: int, station: Hashable, dead: bool) -> None:
        """A station is given up for now, or back."""
        log.log(
            logging.WARNING if dead else logging.INFO,
            "channel %d: station %s %s", channel, station, "does not answer, it is asked rarely" if dead else "is back",
        )  # fmt: skip
        for state in self.states.values():
            if state.block.channel == channel:
                self.memory.changed(state)

    def _ended(self, state: BlockState, ok: bool, now: int) -> None:
        self.memory.ended(state, ok, now)
        if self.on_end is not None:
            undisturbed(self.on_end, status_of(state), ok)

    # ---- what channels say --------------------------------------------------------------------------------

    def opened(self, channel: int, is_open: bool) -> None:
        """Whether exchanges can be started on a channel now."""
        self.scheduler.set_open(channel, is_open, self._clock.now())
        if self.jobs is not None:
            self.jobs.opened(channel, is_open)

    def takes(self, block: int) -> Block | None:
        """A RECEIVE block with its settings as they are now; None when it takes no frame now."""
        self._refresh()
        if not self.scheduler.takes(block):
            return None
        try:
            return self.memory.effective(self.states[block].block)
        except SettingError as error:
            self.arrived(block, Failure(outcome="bad_setting", cause=str(error)))
            return None

    def arrived(self, block: int, failure: Failure | None) -> None:
        """The frame of a RECEIVE block came."""
        self.scheduler.arrived(block, failure, self._clock.now())


def protocol_of(run: Run, block: Block) -> Protocol | None:
    """What is spoken on the channel of a block; None for one that has none."""
    return None if block.job is not None else run.channels[block.channel].protocol
