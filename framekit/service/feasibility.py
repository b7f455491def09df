"""The load of a run's channels: the time that their blocks need in their cycles, and cycles for which a channel lacks
time.

The cost of an exchange is measured on a simulated line against a server of our own, to the bit time: so it includes all
effects of the protocol – split exchanges, acknowledgements, silences – without knowledge of the protocol here. The run
itself is not touched: memories, ports and clocks are made for this purpose.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

from framekit.codec.codec import compile_protocol
from framekit.codec.samples import Sampler
from framekit.definition.expression import Expression
from framekit.definition.problems import Problem
from framekit.definition.times import NEVER, format_time, milliseconds
from framekit.link.addresses import Address, AddressError, AddressGrammar
from framekit.link.scope import Scope
from framekit.memory.memory import DeviceMemory
from framekit.run.block_state import BlockState, Failure
from framekit.run.model import BLOCKS_IN_SET, Block, Channel, RunModel
from framekit.run.own_memory import AddressedMemory, addresses_of
from framekit.run.scheduler import Scheduler
from framekit.run.triggers import Condition, Every
from framekit.runfile.devices import Device, memory_of, put_values
from framekit.service.channel import ChannelOwner, ChannelService
from framekit.service.device import DeviceService, DeviceStore
from framekit.transport.clock import VirtualClock
from framekit.transport.simulated_line import SimulatedLine, Transmission

BlockKey = tuple[int, int]
"""Set and number of a block."""

MOST_EXCHANGES = 5_000
"""Largest number of simulated exchanges; longer common periods are judged by these."""

ROUNDS = 4
"""Number of simulated common periods, at whose begin all cycles start together."""

Cycle = tuple[Block, int, int]
"""A block with its period, and the duration of an exchange, both in ns."""


def cycle_starts(cycles: Sequence[Cycle]) -> dict[tuple[int, int], tuple[float, float]]:
    """Return the average time from start to start (ns) and the share of missed starts, by set and number of the
    block.
    """
    if not cycles:
        return {}
    play = _Play(cycles)
    once = math.lcm(*(period for _, period, _ in cycles))
    once *= max(1, math.ceil(sum(duration for *_, duration in cycles) / once))  # each block has its turn in it
    began = play.until(once, MOST_EXCHANGES // 4)
    before = {number: (state.started, state.overruns) for number, state in play.scheduler.states.items()}
    lasted = play.until((1 + ROUNDS) * once, MOST_EXCHANGES) - began
    found = {}
    for block, period, _ in cycles:
        state = play.scheduler.states[block.id]
        started, missed = state.started - before[block.id][0], state.overruns - before[block.id][1]
        follows = not any(trigger.is_cycle for trigger in state.block.triggers)
        reached = lasted / max(1, started) if missed or (started and follows) else float(period)
        found[block.set, block.number] = (max(reached, float(period)), missed / max(1, started + missed))
    return found


class _Play:
    """Simulates blocks that start by cycle or after another block; each exchange takes its fixed duration."""

    def __init__(self, cycles: Sequence[Cycle]) -> None:
        numbers = {block.id for block, _, _ in cycles}
        self.durations = {block.id: duration for block, _, duration in cycles}
        self.running: int | None = None
        self.ends_at = NEVER
        self.started = 0
        self.now = 0
        channel = cycles[0][0].channel
        blocks = [_only_cycles(block, period, numbers) for block, period, _ in cycles]
        self.scheduler = Scheduler(blocks, DeviceMemory([]), _no_place, {channel: 0}, self._start, lambda: None)
        self.scheduler.begin(0)

    def _start(self, state: BlockState, now: int) -> None:
        self.running = state.block.id
        self.ends_at = now + self.durations[state.block.id]
        self.started += 1

    def until(self, end: int, most: int) -> int:
        """Simulate up to time `end`, or until `most` exchanges have begun; return the time reached."""
        scheduler = self.scheduler
        while self.started < most and (due := min(scheduler.deadline, self.ends_at)) <= end:
            self.now = now = max(self.now, due)
            if self.running is not None and self.ends_at <= now:
                number, self.running, self.ends_at = self.running, None, NEVER
                scheduler.finished(number, None, now)
            scheduler.tick(now)
        if self.started < most:
            self.now = end
        return self.now


def _only_cycles(block: Block, period: int, others: set[int]) -> Block:
    """Return the block with cycles only: without triggers that depend on memory; a clock bit counts as a cycle."""
    kept = [
        trigger
        for trigger in block.triggers
        if trigger.is_cycle or (trigger.follows is not None and _follows(block, *trigger.follows) in others)
    ]
    triggers = tuple(kept) or (Every(period=period, phase=period),)
    return replace(block, triggers=triggers, unless=None, repeat=None, enabled=True)


def _follows(block: Block, number: int, ok: bool) -> int | None:
    """Return the id of the block of the same set whose success this one waits for; None if it waits for none."""
    return BLOCKS_IN_SET * (block.set - 1) + number if ok else None


def _no_place(text: str) -> Address:
    raise AddressError(f"{text} is not looked at here")


@dataclass(frozen=True, slots=True)
class Cost:
    """Cost of one exchange of a block."""

    duration: int
    """Time (ns) until the channel can begin the next exchange."""
    bytes: int = 0
    """Bytes on the wire in both directions."""
    frames: int = 0
    doubt: str = ""
    """Reason why the real exchange may take longer; '' if none is known."""


@dataclass(frozen=True, slots=True)
class BlockLoad:
    """The load caused by a block."""

    block: Block
    period: int | None
    """Period (ns); None if unknown."""
    cost: Cost
    reached: float = 0.0
    """Average time from start to start (ns) if the channel has only its cycles."""
    missed: float = 0.0
    """Share of the cycles for which the channel lacks time."""

    @property
    def busy(self) -> float:
        """Return the share of the channel's time that this block requires; 0 if its period is unknown."""
        return self.cost.duration / self.period if self.period else 0.0


@dataclass(frozen=True, slots=True)
class ChannelLoad:
    """All blocks of a channel.

    `busy`: share of the channel's time that the cycles require; `line`: share of the time with bytes on the wire, None
    without a line speed.
    """

    channel: Channel
    blocks: tuple[BlockLoad, ...]

    @property
    def busy(self) -> float:
        return sum(one.busy for one in self.blocks)

    @property
    def line(self) -> float | None:
        line = self.channel.line
        if line is None:
            return None
        return sum(one.cost.bytes * line.character_time / one.period for one in self.blocks if one.period)

    @property
    def round(self) -> int:
        """Return the total duration of one exchange of each block with a cycle (ns)."""
        return sum(one.cost.duration for one in self.blocks if one.period)


def channel_loads(run: RunModel, costs: Mapping[BlockKey, Cost]) -> tuple[ChannelLoad, ...]:
    """Return the load of each channel of a run, without channels and blocks that are disabled."""
    periods = Periods(run)
    found = []
    for channel in (one for one in run.channels.values() if one.enabled):
        blocks = [block for block in run.blocks if block.channel == channel.number and block.enabled]
        loads = [BlockLoad(block, periods.of(block), costs[block.set, block.number]) for block in blocks]
        starts = cycle_starts([(one.block, one.period, max(1, one.cost.duration)) for one in loads if one.period])
        found.append(ChannelLoad(channel, tuple(_reached(one, starts) for one in loads)))
    return tuple(found)


def _reached(load: BlockLoad, starts: Mapping[BlockKey, tuple[float, float]]) -> BlockLoad:
    key = load.block.set, load.block.number
    return load if key not in starts else BlockLoad(load.block, load.period, load.cost, *starts[key])


class Periods:
    """Periods of blocks: from cycles, clock bits, and blocks that follow them."""

    def __init__(self, run: RunModel) -> None:
        self.grammar: AddressGrammar = addresses_of(run.memory)
        self.clocks: dict[tuple[str, int], int] = {}
        for clock in run.memory.clocks:
            place = self.grammar.parse(clock.address)
            self.clocks[place.area, place.first_bit] = clock.period
        self.blocks = {(block.set, block.number): block for block in run.blocks}
        self.done_bits = dict(self._done_bits(run)) if run.status else {}

    def _done_bits(self, run: RunModel) -> Iterator[tuple[tuple[str, int], BlockKey]]:
        """Yield the bits in memory that pulse when a block succeeds."""
        for section in run.memory.flags.values():
            item = section.items.get("done")
            if item is None or item.bit is None:
                continue
            for key in self.blocks:
                with suppress(ValueError):
                    yield (section.area, 16 * (section.base(*key) + item.word) + item.bit), key

    def of(self, block: Block) -> int | None:
        """Return the shortest period (ns) of its triggers; None if unknown."""
        return self._of(block, frozenset())

    def _of(self, block: Block, seen: frozenset[BlockKey]) -> int | None:
        key = block.set, block.number
        known = _BlockPeriods(self, block.set, seen | {key})
        return min((period for trigger in block.triggers for period in trigger.periods(known)), default=None)

    def behind(self, key: BlockKey, seen: frozenset[BlockKey]) -> Iterator[int]:
        """Yield the period of another block that this block follows."""
        period = self._of(self.blocks[key], seen) if key in self.blocks and key not in seen else None
        if period is not None:
            yield period

    def rising(self, condition: Expression, seen: frozenset[BlockKey]) -> list[int]:
        """Return the period of the clock, or of the block, whose bit the condition contains: it rises no more often."""
        try:
            places = Condition(condition, self.grammar.parse).addresses.values()
        except AddressError:
            return []
        periods: list[int] = []
        for place in ((place.area, place.first_bit) for place in places if place.unit == "bit"):
            if place in self.clocks:
                periods.append(self.clocks[place])
            elif place in self.done_bits:
                periods.extend(self.behind(self.done_bits[place], seen))
        return periods if len(periods) == 1 else []


@dataclass(frozen=True, slots=True)
class _BlockPeriods:
    """Periods of the triggers of one block (`KnownPeriods`); `seen`: blocks whose period is being computed."""

    periods: Periods
    set: int
    seen: frozenset[BlockKey]

    def of_condition(self, condition: Expression) -> Iterable[int]:
        return self.periods.rising(condition, self.seen)

    def of_block(self, number: int) -> Iterable[int]:
        return self.periods.behind((self.set, number), self.seen)


# ---- messages ---------------------------------------------------------------------------------------------


def load_problems(loads: tuple[ChannelLoad, ...]) -> list[Problem]:
    """Return a warning for each block whose cycle the channel lacks time for."""
    return [
        Problem(one.block.at, _what(load, one), _todo(load, one), warning=True)
        for load in loads
        for one in load.blocks
        if one.missed > 0
    ]


def _what(load: ChannelLoad, one: BlockLoad) -> str:
    assert one.period is not None
    number, wants = one.block.label, format_time(one.period)
    if len([block for block in load.blocks if block.period]) == 1 or one.cost.duration > one.period:
        needs = f"one exchange takes {milliseconds(one.cost.duration)}"
    else:
        needs = f"channel {load.channel.number} needs {milliseconds(load.round)} for all its cycles"
    return f"block {number} wants {wants}, {needs}: it runs every {milliseconds(one.reached)}"


def _todo(load: ChannelLoad, one: BlockLoad) -> str:
    faster = "" if load.channel.line is None else ", a faster line"
    return f"use a longer period{faster} or fewer blocks on this channel"


# ---- costs of exchanges, on a simulated line ----------------------------------------------------------------


LONGEST = 3_600_000_000_000
"""Time limit of an exchange (ns): after an hour it counts as endless."""

OWN = "own"


def loads_of(run: RunModel) -> tuple[ChannelLoad, ...]:
    """Return the load of each channel of a run, from exchanges on simulated lines."""
    return channel_loads(run, simulated_costs(run))


def simulated_costs(run: RunModel) -> dict[BlockKey, Cost]:
    """Return the cost of an exchange of each block, by set and number."""
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
    """Return the cost of an unsolicited frame: only its time on the line."""
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
    """One channel with servers for the stations of its blocks, on a clock of its own."""

    def __init__(self, run: RunModel, channel: Channel, blocks: Iterable[Block]) -> None:
        self.channel = channel
        self.clock = VirtualClock()
        self.line = SimulatedLine(self.clock, channel.line, fault=self._answer_time)
        self._last_sender = OWN
        self._sent: list[int] = []
        memory = run.create_memory()
        put_values(memory, run.initial)
        access = AddressedMemory(memory, addresses_of(run.memory))
        self.service = ChannelService(channel, self.line.port(OWN), self.clock, access, (), ChannelOwner())
        self.blocks = [self._with_station(block) for block in blocks]
        self.devices = self._servers(dict.fromkeys(block.station for block in self.blocks if _asks(block)))

    def _answer_time(self, transmission: Transmission) -> None:
        """Delay the answer of a device by its processing time; further transmissions of the device follow at once."""
        if transmission.sender == OWN:
            self._sent.append(len(transmission.data))
        elif self._last_sender == OWN:
            transmission.pause(0, self.channel.answer)
        self._last_sender = transmission.sender

    # ---- the other side -----------------------------------------------------------------------------------

    def _with_station(self, block: Block) -> Block:
        """Return the block with a constant station: the present one in memory, or else the first possible."""
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
            store = DeviceStore(device, self.clock, is_trial=True)
            port = self.line.port(device.name)
            found.append(DeviceService(device, port, self.clock, self.channel.line, store=store))
        return found

    # ---- exchanges ----------------------------------------------------------------------------------------

    def costs(self) -> dict[BlockKey, Cost]:
        """Return the cost of each block: all run twice in order, and the second time connections and sessions are
        open.
        """
        for device in self.devices:
            device.start()
        self.service.start()
        self.clock.run_for(0)
        for block in self.blocks:
            self._exchange(block)
        return {key(block): self._exchange(block) for block in self.blocks}

    def _exchange(self, block: Block) -> Cost:
        """Return the cost of one exchange, from the end of the previous exchange to its own end."""
        ended: list[Failure | None] = []
        line, clock, counters = self.line, self.clock, self.service.engine.counters
        clock.run_for(max(0, self.service.engine.held_until - clock.now()))  # the hold of the previous exchange
        began, carried, frames = clock.now(), line.bytes_carried, line.transmissions
        heard = counters.received
        self._sent.clear()
        self.service.start_block(block, ended.append, began)
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
