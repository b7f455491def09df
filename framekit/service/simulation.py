"""Simulates a run: one exchange of each block on a simulated line against a server of our own, to the bit time.

So the cost of a block has everything in it that its protocol does – split exchanges, acknowledgements, silences – and
no knowledge of it is needed here. Nothing of the run itself is touched: memories, ports and clocks are made for this.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from framekit.codec.codec import compile_protocol
from framekit.codec.samples import Sampler
from framekit.link.scope import Scope
from framekit.run.block_state import Failure
from framekit.run.feasibility import BlockKey, ChannelLoad, Cost, channel_loads
from framekit.run.model import Block, Channel, RunModel
from framekit.run.own_memory import AddressedMemory, addresses_of
from framekit.runfile.devices import Device, memory_of, put_values
from framekit.service.channel import ChannelOwner, ChannelService
from framekit.service.device import DeviceService
from framekit.transport.clock import VirtualClock
from framekit.transport.simulated_line import SimulatedLine, Transmission

LONGEST = 3_600_000_000_000
"""An exchange that has not ended after an hour never will."""

OWN = "own"


def loads_of(run: RunModel) -> tuple[ChannelLoad, ...]:
    """The load of each channel of a run, from exchanges on simulated lines."""
    return channel_loads(run, simulated_costs(run))


def simulated_costs(run: RunModel) -> dict[BlockKey, Cost]:
    """What an exchange of each block costs, by set and number."""
    found: dict[BlockKey, Cost] = {}
    for channel in (one for one in run.channels.values() if one.enabled):
        blocks = [block for block in run.blocks if block.channel == channel.number]
        found |= {key(block): arriving(channel, block) for block in blocks if block.instruction == "receive"}
        asking = [block for block in blocks if block.instruction != "receive"]
        if asking:
            found |= SimulatedChannel(run, channel, asking).costs()
    return found


def key(block: Block) -> BlockKey:
    return block.set, block.number


def arriving(channel: Channel, block: Block) -> Cost:
    """A frame that comes by itself: it is not asked for, it only takes its time on the line."""
    codec = compile_protocol(channel.protocol)
    assert block.frame is not None
    scope = Scope(channel.protocol, role=channel.role, own=channel.own, line=channel.line, params=channel.params)
    sizes = {len(sample.data) for sample in Sampler(codec, scope).samples(block.frame)}
    if not sizes:
        return Cost(0, doubt="its frame's size is not known")
    size = min(sizes)
    time = 0 if channel.line is None else size * channel.line.character_time
    return Cost(time, size, 1, "" if len(sizes) == 1 else "its frame has no fixed size; this is a short one")


class SimulatedChannel:
    """One channel with servers for the stations that its blocks talk to, on a clock of its own."""

    def __init__(self, run: RunModel, channel: Channel, blocks: Iterable[Block]) -> None:
        self.channel = channel
        self.clock = VirtualClock()
        self.line = SimulatedLine(self.clock, channel.line, fault=self._answer_time)
        self._last_sender = OWN
        self._sent: list[int] = []
        memory = run.memory.create()
        put_values(memory, run.initial)
        access = AddressedMemory(memory, addresses_of(run.memory))
        self.service = ChannelService(channel, self.line.port(OWN), self.clock, access, (), ChannelOwner())
        self.blocks = [self._with_station(block) for block in blocks]
        self.devices = self._servers(dict.fromkeys(block.station for block in self.blocks if _asks(block)))

    def _answer_time(self, transmission: Transmission) -> None:
        """A device thinks for a while before it answers; what it sends behind that comes at once."""
        if transmission.sender == OWN:
            self._sent.append(len(transmission.data))
        elif self._last_sender == OWN:
            transmission.pause(0, self.channel.answer)
        self._last_sender = transmission.sender

    # ---- the other side -----------------------------------------------------------------------------------

    def _with_station(self, block: Block) -> Block:
        """The block with a station that does not change: the one in memory now, or else the first there is."""
        if block.station_from is None:
            return block
        try:
            station = self.service.transfers.station_of(block)
        except ValueError:
            station = None
        limits = self.channel.protocol.station.limits
        return replace(block, station=station or max(1, limits[0] if limits else 1), station_from=None)

    def _servers(self, stations: Iterable[Any]) -> list[DeviceService]:
        protocol = self.channel.protocol
        role = None if self.channel.role is None else protocol.other_side(self.channel.role)
        if role is None or not protocol.services:
            return []
        areas, grammar = memory_of(protocol)
        found = []
        for station in stations:
            device = Device(
                name=str(station), protocol=protocol, role=role, own=station, params=self.channel.params, areas=areas,
                grammar=grammar, profile=None, mapping={}, initial=(),
            )  # fmt: skip
            found.append(DeviceService(device, self.line.port(device.name), self.clock, self.channel.line))
        return found

    # ---- exchanges ----------------------------------------------------------------------------------------

    def costs(self) -> dict[BlockKey, Cost]:
        """All blocks one after the other, twice: the second time connections and sessions are there."""
        for device in self.devices:
            device.start()
        self.service.start()
        self.clock.run_for(0)
        for block in self.blocks:
            self._exchange(block)
        return {key(block): self._exchange(block) for block in self.blocks}

    def _exchange(self, block: Block) -> Cost:
        """One exchange, from the end of the one before it to its own end."""
        ended: list[Failure | None] = []
        line, clock, counters = self.line, self.clock, self.service.engine.counters
        clock.run_for(max(0, self.service.engine.held_until - clock.now()))  # what is due of the one before
        began, carried, frames = clock.now(), line.bytes_carried, line.transmissions
        heard = counters.received
        self._sent.clear()
        self.service.start_block(block, ended.append)
        while not ended and clock.now() < began + LONGEST and clock.advance():
            pass
        duration, size, count = clock.now() - began, line.bytes_carried - carried, line.transmissions - frames
        if ended and (ended[0] is None or counters.received > heard):
            doubt = "" if ended[0] is None else f"with an empty device it ends with: {ended[0]}"
            return Cost(duration + self.channel.silence.between, size, count, doubt)
        size = self._sent[0] if self._sent else 0
        time = 0 if self.channel.line is None else size * self.channel.line.character_time
        doubt = f"only its request is counted: {ended[0] if ended else 'it does not end by itself'}"
        return Cost(time + self.channel.silence.between, size, min(1, len(self._sent)), doubt)


def _asks(block: Block) -> bool:
    return block.instruction in ("read", "write", "call")
