"""Between the scheduler and the channels: a block that may start becomes an exchange, or shares one with neighbours.

It knows which station a block talks to now, and which waiting reads go together, but not when what starts.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Mapping
from functools import partial

from framekit.run.block_state import BlockState, Failure
from framekit.run.block_words import BlockMemory, SettingError
from framekit.run.lanes import LaneRules
from framekit.run.model import Block, Channel, JobCommand, JobRecord
from framekit.run.transfer import Ended, Read, neighbours
from framekit.service.channel import ChannelService


class Exchanges:
    """The exchanges of a run. `finished(id, failure)` is told the end of each block's; `take_job` carries out the
    commands of blocks that have no channel."""

    def __init__(
        self,
        channels: Mapping[int, ChannelService],
        block_memory: BlockMemory,
        finished: Callable[[int, Failure | None], None],
    ) -> None:
        self._channels = channels
        self._block_memory = block_memory
        self._finished = finished
        self.take_job: Callable[[JobCommand | JobRecord], None] | None = None
        self._alone: set[int] = set()
        self._stations: dict[int, tuple[Block, Hashable]] = {}

    def reset(self) -> None:
        """Reads that were refused together may be tried together again."""
        self._alone.clear()

    def forget(self, block: Block) -> None:
        """A block is no more, or another one: nothing is known of it."""
        self._alone.discard(block.id)
        self._stations.pop(block.id, None)
        channel = self._channels.get(block.channel)
        if channel is not None:
            channel.transfers.forget(block)

    def station_of(self, state: BlockState) -> Hashable:
        """The station a block talks to as its settings are now; None where there is none."""
        if not state.has_station:
            return None
        try:
            block = self._block_memory.settings.effective(state.block)
        except SettingError:
            return None
        known = self._stations.get(state.id)
        if known is not None and known[0] is block:
            return known[1]
        station = self._channels[block.channel].station_of(block)
        found = station if isinstance(station, Hashable) else None
        if block is state.block and block.station_from is None:
            self._stations[state.id] = block, found
        return found

    def prepare(self, number: int, blocks: Iterable[Block]) -> None:
        """A channel is open: its blocks get ready."""
        for block in blocks:
            if block.job is None and block.channel == number:
                self._channels[number].transfers.prepare(block)

    # ---- starting -----------------------------------------------------------------------------------------

    def start(self, state: BlockState, now: int) -> None:
        """Begins the exchange of a block, and of those that come with it; or its command, where that is for jobs."""
        if self._block_memory.words.shows_starts:
            self._block_memory.changed(state)
        if state.block.job is not None and self.take_job is not None:
            self.take_job(state.block.job)
            return
        try:
            block = self._block_memory.settings.effective(state.block)
        except SettingError as error:
            self._spoiled(state, error)
            others: list[BlockState] = list(state.companions)
            state.companions = ()
            for other in others:
                self.start(other, now)
            return
        channel = self._channels[block.channel]
        if not state.companions:
            channel.start_block(block, partial(self._finished, state.id), repeats=not state.probing)
            return
        states = [state, *state.companions]
        reads: list[Read[tuple[Block, Ended]]] = []
        for one in states:
            mine = self._effective(one)
            read = None if mine is None else channel.transfers.read_of(mine, self._joined_ending(one, states))
            if read is not None:
                reads.append(read)
            elif mine is not None:
                channel.start_block(mine, self._ending(one))
        if reads:
            channel.start_joined(reads)

    def _effective(self, state: BlockState) -> Block | None:
        """The block with its settings; one that they spoil has ended."""
        try:
            return self._block_memory.settings.effective(state.block)
        except SettingError as error:
            self._spoiled(state, error)
            return None

    def _spoiled(self, state: BlockState, error: SettingError) -> None:
        self._finished(state.id, Failure(outcome="bad_setting", cause=str(error)))

    def _ending(self, state: BlockState) -> Ended:
        return partial(self._finished, state.id)

    def _joined_ending(self, state: BlockState, states: list[BlockState]) -> Ended:
        """A joined read that the device refuses is not joined again: each block asks for itself from then on."""

        def ended(failure: Failure | None) -> None:
            refused = failure is not None and (failure.outcome == "refused" or failure.device_code is not None)
            if refused and failure is not None and failure.outcome != "no_reply":
                self._alone |= {one.id for one in states}
            self._finished(state.id, failure)

        return ended

    # ---- joined reads -------------------------------------------------------------------------------------

    def joins(self, state: BlockState, others: list[BlockState]) -> list[BlockState]:
        """The waiting reads of the same station that lie beside this one."""
        if state.block.job is not None:
            return []
        channel = self._channels[state.block.channel]
        merge = channel.channel.merge
        if merge is None or channel.client is None or state.block.params:
            return []
        first = self._read_of(channel, state)
        if first is None:
            return []
        station = self.station_of(state)
        if station is None and state.block.station_from is not None:
            return []  # its memory names no station: it fails by itself
        reads = [
            read
            for other in others
            if not other.block.params
            and not (station is None and other.block.station_from is not None)
            and (read := self._read_of(channel, other)) is not None
            and self.station_of(other) == station
        ]
        return [read.key for read in neighbours(first, reads, merge, channel.client.grammar)]

    def _read_of(self, channel: ChannelService, state: BlockState) -> Read[BlockState] | None:
        if state.id in self._alone:
            return None
        try:
            block = self._block_memory.settings.effective(state.block)
        except SettingError:
            return None
        read = channel.transfers.read_of(block, _nobody)
        return None if read is None else Read(state, read.address, read.count)


def _nobody(failure: Failure | None) -> None:
    return None


def rules_of(channel: Channel) -> LaneRules:
    """How the scheduler treats a channel."""
    return LaneRules(
        silence=channel.silence,
        dead=channel.dead,
        stations={station: rules.dead for station, rules in channel.stations.items() if rules.own_dead},
    )
