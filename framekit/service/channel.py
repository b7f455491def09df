"""One channel of a run: its engine on its port, its client, and the blocks that use them."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Collection, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, cast

from framekit.codec.codec import Codec, compile_protocol
from framekit.definition.kinds.base import constant_number
from framekit.definition.model import protocol as model
from framekit.link.arrivals import BadFrame
from framekit.link.engine import Engine
from framekit.link.events import MemoryAccess, Monitor, RequestHandler, Seen, ServiceDone, Tape
from framekit.link.services.client import ServiceClient
from framekit.link.services.server import MemoryServer, ServiceCounters
from framekit.link.slow import SlowStation
from framekit.link.values import FrameValue
from framekit.memory.memory import DeviceMemoryError
from framekit.run.block_state import BlockState, Failure
from framekit.run.block_words import BlockMemory, SettingError
from framekit.run.lanes import NOT_HELD, Held, LaneRules
from framekit.run.model import STATIONED, Block, Channel, JobCommand, JobRecord, RunModel
from framekit.run.own_memory import AddressedMemory
from framekit.run.transfer import BlockStarts, BlockTransfers, Ended, Read, neighbours
from framekit.runfile.devices import offering_faults
from framekit.service.device import DeviceService, ListeningPort, devices_of, port_for
from framekit.service.driver import Driver, Moment
from framekit.service.left_lines import ClosingPorts, LeftRequests
from framekit.service.written import NamedMemory, NamedServer, begun_log, client_of
from framekit.transport.clock import Clock
from framekit.transport.port import Port
from framekit.transport.schemes import line_of

log = logging.getLogger(__name__)

REPEATS = "retries"
"""The parameter for the number of repeated attempts, in protocols that have it."""


@dataclass(slots=True)
class ChannelCounters:
    """Counts the services of a channel apart from its blocks: requests `served` here, and transfers of jobs."""

    served: ServiceCounters = field(default_factory=ServiceCounters)
    done: int = 0
    failed: Counter[str] = field(default_factory=Counter)

    def ended(self, failure: str) -> None:
        """Count a transfer of a job, with the name of its failure, or '' for success."""
        if failure:
            self.failed[failure] += 1
        else:
            self.done += 1

    def add(self, other: ChannelCounters) -> None:
        """Add the counters of the channel that this channel replaces."""
        self.served.add(other.served)
        self.done += other.done
        self.failed.update(other.failed)

    def clear(self) -> None:
        """Reset all counters."""
        self.served.clear()
        self.done = 0
        self.failed.clear()

    @property
    def services(self) -> int:
        return self.served.done + self.done

    def reasons(self, protocol: model.Protocol) -> Counter[str]:
        """Return the errors by reason."""
        return self.failed + self.served.reasons(protocol)


class ChannelOwner:
    """Receives the events of channels; this base class has no blocks and ignores the events."""

    def opened(self, channel: int, is_open: bool) -> None:
        """Report whether exchanges can be started from now on."""

    def slow(self, channel: int, station: SlowStation, is_slow: bool) -> None:
        """Report a station that answers after the time limit, or in time again."""

    def waits(self, channel: int, station: Any, until: int) -> None:
        """Report that no request is sent to a station before `until` (ns), because late replies may come."""

    def goes_on(self, channel: int) -> None:
        """Report that requests no longer wait for late replies."""

    def is_shared(self, channel: int) -> bool:
        """Return whether blocks of other stations wait while an exchange with a station keeps the channel."""
        return False

    def takes(self, block: int) -> Block | None:
        """Return a RECEIVE block with its present settings; None if it does not accept a frame now."""
        return None

    def arrived(self, block: int, failure: Failure | None) -> None:
        """Report the frame of a RECEIVE block: None if it was stored, else the failure."""


class ChannelService:
    """Runs blocks on one channel; an answering role serves the own memory.

    `counters`: services without a block.
    """

    def __init__(
        self,
        channel: Channel,
        port: Port,
        clock: Clock,
        access: AddressedMemory,
        receiving: Iterable[Block],
        owner: ChannelOwner,
        monitor: Monitor | None = None,
        moment: Moment | None = None,
    ) -> None:
        self.channel = channel
        self.owner = owner
        self.counters = ChannelCounters()
        self.receiving: dict[str, list[Block]] = {}
        access = access.as_read_only() if self._only_shows else access
        protocol = channel.protocol
        codec = compile_protocol(protocol)
        self._writes = None if channel.asks else begun_log(f"channel {channel.number}", protocol)
        self._answering = server = self._server(codec, access)
        # without services, sequences answer requests: each sent frame counts as a service
        answers = server is None and channel.role is not None and not channel.asks
        answering, memory = server, cast(MemoryAccess, access)
        if self._writes is not None:
            memory = NamedMemory(access, self._writes, partial(client_of, port))
            answering = server and NamedServer(server, self._writes, partial(client_of, port))
        self.engine = Engine(
            protocol,
            codec,
            channel.role,
            params=channel.params,
            line=channel.line,
            own=channel.own,
            now=clock.now(),
            server=answering,
            memory=memory,
            ask=self._ask,
            on_frame=self._frame,
            monitor=monitor,
            on_send=self.counters.served.count if answers else None,
            is_stream=port.is_stream,
        )
        self.engine.on_bad = self._bad
        self.engine.late.slow.on_change = partial(owner.slow, channel.number)
        self.engine.late.on_wait = partial(owner.waits, channel.number)
        self.engine.late.on_end = partial(owner.goes_on, channel.number)
        self.engine.late.is_shared = partial(owner.is_shared, channel.number)
        if (
            channel.asks
            and channel.wiring.may_hear_itself
            and protocol.line.kind == "serial"
            and port.settings is not None
        ):
            self.engine.examine_replies(port.has_exact_times)
        self.driver = Driver(self.engine, port, clock, self._on_state, moment)
        self.receive_for(receiving)
        self.client = client = ServiceClient(protocol, codec, self.engine) if protocol.services else None
        self.transfers = BlockTransfers(
            self.engine,
            client,
            access.memory,
            protocol.frames,
            protocol.station,
            channel.mapping,
            self.driver.later,
            self.params_of,
        )
        self._clock = clock
        self.line = line_of(channel.port)
        """Name of the line that its port leads to."""
        self.is_on = False
        """Whether its port is, or should be, open."""
        self.waits_for_line = False
        """Whether its port is opened when no other port on the line is closing any more."""
        self.state = "closed"
        if channel.wiring.reconnect is not None:
            self.driver.longest_retry = channel.wiring.reconnect

    @property
    def _only_shows(self) -> bool:
        """Return whether clients of the channel may only read its memory."""
        return self.channel.read_only and not self.channel.asks

    def receive_for(self, blocks: Iterable[Block]) -> None:
        """Pass received frames to these RECEIVE blocks from now on, instead of the previous blocks."""
        self.receiving.clear()
        for block in blocks:
            self.receiving.setdefault(block.frame or "", []).append(block)
        self.engine.await_frames(self.receiving)

    def _server(self, codec: Codec, access: AddressedMemory) -> RequestHandler | None:
        protocol = self.channel.protocol
        if not protocol.services:
            return None
        return MemoryServer(
            protocol, codec, access.memory, mapping=self.channel.mapping, refresh=access.refresh,
            counters=self.counters.served, read_only=self.channel.read_only,
            written=None if self._writes is None else self._writes.note,
            kept=None if self._writes is None else self._writes.note_kept,
        )  # fmt: skip

    def _on_state(self, state: str) -> None:
        self.state = state
        if state != "open":
            self.transfers.closed("closed")
        self.owner.opened(self.channel.number, state == "open")

    def answer_connections(self, port: ListeningPort, access: AddressedMemory, monitor: Monitor | None) -> None:
        """Answer connections to this port as the channel does, with the same counters."""
        access = access.as_read_only() if self._only_shows else access
        port.answer(
            access, self._answering, monitor, self.engine.counters, self.driver.load, self.counters.served,
            self._writes, self.counters.failed,
        )  # fmt: skip

    def start(self) -> None:
        self.is_on = True
        self.driver.start()

    def switch_off(self) -> None:
        """Close the port until `start`; running exchanges end as closed."""
        self.is_on = False
        self.driver.switch_off()

    def stop(self) -> None:
        self.is_on = False
        self.driver.stop()

    @property
    def has_session(self) -> bool:
        """Return whether a session may have to be closed; a channel that is not open has no session."""
        return self.engine.has_session and self.driver.is_open

    def close_session(self, done: Callable[[], None]) -> None:
        """Close the session with the other side once all exchanges have ended, then call `done`."""
        self.driver.do(lambda now: self.engine.close_session(now, done))

    def starts_of(self, block: Block, ended: Ended) -> BlockStarts:
        """Return the object that starts the exchanges of a block without parameters.

        `ended` is called once for each.
        """
        return self.transfers.starts_of(block, ended, self.driver.carry_out)

    def start_block(self, block: Block, ended: Ended, now: int, *, repeats: bool = True) -> None:
        """Begin an exchange of a block; `ended` is called exactly once. Without `repeats` make a single attempt."""
        params = self._params_for(block, repeats)
        self.starts_of(block, self._overriding(params, ended) if params else ended).go(now)

    def _overriding(self, params: Mapping[str, Any], ended: Ended) -> Ended:
        """Override parameters until the exchange has ended."""
        back = self.engine.scope.override(params)

        def done(failure: Failure | None) -> None:
            back()
            ended(failure)

        return done

    def start_joined(self, reads: Sequence[Read[tuple[Block, Ended]]], *, repeats: bool = True) -> None:
        """Begin one read for several blocks without parameters of their own; each block gets its own result."""
        params = self._params_for(reads[0].key[0], repeats)
        back = self.engine.scope.override(params) if params else lambda: None
        left = len(reads)

        def telling(ended: Ended) -> Ended:
            def done(failure: Failure | None) -> None:
                nonlocal left
                left -= 1
                if left == 0:
                    back()
                ended(failure)

            return done

        joined = [Read((read.key[0], telling(read.key[1])), read.address, read.count) for read in reads]
        self.driver.do(lambda now: self.transfers.start_joined(joined, now))

    def _params_for(self, block: Block, repeats: bool) -> dict[str, Any]:
        """Return the parameters for this exchange only: those of its station, then those of the block."""
        if repeats and not block.params and not self.channel.stations:
            return {}
        found = {**self.params_of(self.station_of(block)), **block.params}
        found |= {name: block.sizes[field] for field, name in block.sized_by.items()}
        repeated = self.channel.protocol.params.get(REPEATS)
        if not repeats and repeated is not None and repeated.is_ is None and repeated.type == "number":
            found[REPEATS] = 0 if repeated.limits is None else max(0, repeated.limits[0])
        return found

    def params_of(self, station: Any) -> Mapping[str, Any]:
        """Return the parameters of the channel for a station."""
        rules = self.channel.stations.get(station) if self.channel.stations and isinstance(station, Hashable) else None
        return {} if rules is None else rules.params

    def station_of(self, block: Block) -> Any:
        """Return the station of a block; None if it has no station, or if its memory has no valid station."""
        if block.instruction not in STATIONED:
            return None
        try:
            return self.transfers.station_of(block)
        except (DeviceMemoryError, ValueError):
            return None

    def under_way(self, station: Any) -> str:
        """Describe the replies to the exchange under way with a station that could not be used; None: any station."""
        for run in self.engine.machine.order:
            if run.top is not None and run.unusable is not None and station in (None, run.top.x.station):
                return str(run.unusable)
        return ""

    def _ask(self, service: str, arguments: dict[str, Any], station: Any, done: ServiceDone) -> None:
        if self.client is not None:
            self.client.ask(service, arguments, station, done)

    def _frame(self, frame: FrameValue) -> None:
        """Store an unsolicited frame by the RECEIVE blocks that name it."""
        for block in self.receiving.get(frame.frame, ()):
            taking = self.owner.takes(block.id)
            if taking is None:
                continue
            try:
                self.transfers.store_frame(taking, frame)
            except (DeviceMemoryError, ValueError) as error:
                self.owner.arrived(block.id, Failure(outcome="cannot_store", cause=str(error)))
            else:
                self.owner.arrived(block.id, None)

    def _bad(self, bad: BadFrame) -> None:
        """Report failure of the RECEIVE blocks that name a bad frame, if no step has waited for it."""
        for block in self.receiving.get(bad.frame, ()) if self.receiving else ():
            if self.owner.takes(block.id) is not None:
                cause = f"{bad.cause} at byte {bad.place}"
                self.owner.arrived(block.id, Failure(outcome="damaged_frame", cause=cause))


RunMonitor = Callable[[int, Seen], None]
"""Receives all events of the lines, each with the number of its channel."""

Made = tuple[ChannelService, list[DeviceService]]
"""A channel and the devices on its line."""


class RunChannels:
    """Fills `channels`, by number, and the devices on their lines; reports events to `owner`.

    `moment`: called when the data from a line have been processed. `requests`: those of earlier channels on the lines.
    `offers_faults`: simulated devices have faults that can be switched on, in addition to their own.
    """

    def __init__(
        self, channels: dict[int, ChannelService], clock: Clock, access: AddressedMemory, owner: ChannelOwner,
        monitor: RunMonitor | Tape | None = None, moment: Moment | None = None, requests: LeftRequests | None = None,
        offers_faults: bool = False,
    ) -> None:  # fmt: skip
        self._clock = clock
        self._offers_faults = offers_faults
        self._moment = moment
        self.requests = LeftRequests() if requests is None else requests
        self._access = access
        self._owner = owner
        self._monitor = monitor
        self.channels = channels
        self.devices: dict[int, list[DeviceService]] = {}
        self.closing = ClosingPorts()

    def of_run(self, run: RunModel, number: int) -> Made:
        """Return a channel of a run; see `make`."""
        return self.make(run.channels[number], receiving(run, number), run.folder)

    def make(self, channel: Channel, blocks: Iterable[Block], folder: str) -> Made:
        """Return a channel and its devices, all not opened; `blocks` are its RECEIVE blocks.

        Raise DefinitionError for an invalid device file, ValueError for a port that cannot be created.
        """
        monitor = self._monitor
        listening = ListeningPort(channel, self._clock) if channel.listens else None
        simulated = [] if listening is not None else devices_of(channel, Path(folder))
        if self._offers_faults:
            simulated = list(map(offering_faults, simulated))
        port, devices = (listening, []) if listening is not None else port_for(channel, simulated, self._clock)
        watcher = None if monitor is None else watching(monitor, channel.number)
        for device in devices:
            device.watch_troubles(lambda trouble: self._trouble(channel.number, trouble))
        service = ChannelService(channel, port, self._clock, self._access, blocks, self._owner, watcher, self._moment)
        if listening is not None:
            service.answer_connections(listening, self._access, watcher)
        return service, devices

    def _trouble(self, number: int, what: str) -> None:
        """Report the failure of an action of a simulated device."""
        log.warning("channel %d: %s", number, what)
        if self._monitor is not None:
            watching(self._monitor, number)(Seen("", "trouble", self._clock.now(), reason=what))

    def put(self, number: int, made: Made) -> None:
        """Register the channel under this number; it continues the counters of the previous channel."""
        before = self.channels.get(number)
        if before is not None:
            made[0].counters.add(before.counters)
        self.channels[number], self.devices[number] = made

    def remove(self, number: int) -> None:
        """Forget a channel and its devices."""
        del self.channels[number], self.devices[number]

    def receive_for(self, run: RunModel, keep: Collection[int]) -> None:
        """Pass received frames to the blocks of this run; remove channels that it does not have, except `keep`."""
        for number in list(self.channels):
            if number in run.channels:
                self.channels[number].receive_for(receiving(run, number))
            elif number not in keep:
                self.remove(number)

    def open(self, number: int) -> None:
        """Open the ports of the devices on the line of a channel, then its own port unless it is switched off."""
        for device in self.devices[number]:
            device.start()
        if self.channels[number].channel.enabled:
            self.start(number)

    def start(self, number: int) -> None:
        """Open the port of a channel; if a modem still hangs up on its line, after that.

        The channel waits for the late replies that earlier channels on its line wait for.
        """
        channel = self.channels[number]
        channel.waits_for_line = True
        self.closing.open(channel.line, channel, channel.driver.port, partial(self._start, channel))

    def _start(self, channel: ChannelService) -> None:
        channel.waits_for_line = False
        if channel.channel.asks and not channel.is_on:
            self.requests.enter(channel.line, channel.engine, self._clock.now())
        channel.start()

    def switch_off(self, number: int) -> None:
        """Close the port of a channel until `start`; running exchanges end as closed."""
        self._closed(number, self.channels[number].switch_off)

    def close(self, number: int) -> None:
        """Close the port of a channel, and the ports of the devices on its line."""
        self._closed(number, self.channels[number].stop)
        for device in self.devices[number]:
            device.end()

    def _closed(self, number: int, close: Callable[[], None]) -> None:
        channel = self.channels[number]
        self.closing.cancel(channel.line, channel)
        channel.waits_for_line = False
        close()
        if channel.channel.asks:
            self.requests.leave(channel.line, channel.engine, self._clock.now())
        self.closing.add(channel.line, channel.driver.port)


def receiving(run: RunModel, channel: int) -> list[Block]:
    """Return the RECEIVE blocks of a channel."""
    return [block for block in run.blocks if block.channel == channel and block.instruction == "receive"]


def undisturbed(watcher: Callable[..., None], *what: object) -> None:
    """Call a watcher and log its exceptions, so that watching never affects an exchange.

    BrokenPipeError is raised: an output without a reader ends the run.
    """
    try:
        watcher(*what)
    except BrokenPipeError:
        raise
    except Exception:
        log.exception("a watcher of the run failed")


def watching(monitor: RunMonitor | Tape, channel: int) -> Monitor:
    """Return the monitor of one channel; exceptions of `monitor` are logged, as by `undisturbed`."""
    if isinstance(monitor, Tape):
        return monitor.of(channel)

    def told(seen: Seen) -> None:
        try:
            monitor(channel, seen)
        except BrokenPipeError:
            raise
        except Exception:
            log.exception("a watcher of the run failed")

    return told


class Exchanges:
    """Starts the exchanges of a run.

    `over(block, failure)` is called at the end of each exchange; `take_job` executes the commands of blocks without a
    channel.
    """

    def __init__(
        self,
        channels: Mapping[int, ChannelService],
        block_memory: BlockMemory,
        over: Callable[[BlockState, Failure | None], None],
    ) -> None:
        self._channels = channels
        self._block_memory = block_memory
        self._over = over
        self.take_job: Callable[[JobCommand | JobRecord], None] | None = None
        self._look = block_memory.settings.look
        self._shows_starts = block_memory.words.shows_starts
        self._alone: set[int] = set()

    def reset(self) -> None:
        """Allow joins of reads again that were refused before."""
        self._alone.clear()

    def forget(self, block: Block) -> None:
        """Discard the stored state of a block that was removed or replaced."""
        self._alone.discard(block.id)
        channel = self._channels.get(block.channel)
        if channel is not None:
            channel.transfers.forget(block)

    def station_of(self, state: BlockState) -> Hashable:
        """Return the station of a block with its present settings; None if it has none.

        The block with these settings is kept as `effective` until it starts.
        """
        known = state.at_station
        if known is not None:
            for given in state.given:
                if not given.holds():
                    break
            else:
                state.effective = state.block
                return known[0]
        if not state.has_station:
            return None
        try:
            block = self._look(state)
        except SettingError:
            return None
        station = self._channels[block.channel].station_of(block)
        found = station if isinstance(station, Hashable) else None
        if block is state.block and block.station_from is None:
            state.at_station = (found,)
        return found

    def held_until(self, number: int, station: Hashable) -> Held:
        """Return the time before which a channel sends no request to a station, because a late reply may come (ns).

        With it, whether requests to some other station may be sent.
        """
        channel = self._channels.get(number)
        if channel is None:
            return NOT_HELD
        late = channel.engine.late
        until = late.held_until(station) if late.until else 0
        return Held(until, until > 0 and late.has_stations, late.is_late(station))

    def prepare(self, number: int, blocks: Iterable[Block]) -> None:
        """Prepare the first starts of the blocks of an open channel."""
        for block in blocks:
            if block.job is None and block.channel == number:
                self._channels[number].transfers.prepare(block)

    # ---- starting -----------------------------------------------------------------------------------------

    def start(self, state: BlockState, now: int) -> None:
        """Begin the exchange of a block, and those of its companions; a job command goes to the jobs."""
        if self._shows_starts:
            self._block_memory.changed(state)
        starts, block = state.starts, state.effective
        if starts is not None and starts.block is block and not state.companions and not state.probing:
            state.effective = None
            starts.go(now)
            return
        block = block or self._effective(state)
        state.effective = None
        if block is not None and block.job is not None and self.take_job is not None:
            self.take_job(block.job)
            return
        if block is None:
            others, state.companions = state.companions, ()
            for other in others:
                self.start(other, now)
            return
        channel = self._channels[block.channel]
        if not state.companions:
            ended = partial(self._over, state)
            if state.probing or block.params or channel.channel.stations:
                channel.start_block(block, ended, now, repeats=not state.probing)
            else:
                state.starts = channel.starts_of(block, ended)
                state.starts.go(now)
            return
        states = [state, *state.companions]
        reads: list[Read[tuple[Block, Ended]]] = []
        for one in states:
            mine = self._effective(one)
            read = None if mine is None else channel.transfers.read_of(mine, self._joined_ending(one, states))
            if read is not None:
                reads.append(read)
            elif mine is not None:
                channel.start_block(mine, partial(self._over, one), now)
        if reads:
            channel.start_joined(reads, repeats=not state.probing)

    def _effective(self, state: BlockState) -> Block | None:
        """Return the block with its settings; invalid settings end the exchange, and None is returned."""
        try:
            return self._look(state)
        except SettingError as error:
            self._over(state, Failure(outcome="bad_setting", cause=str(error)))
            return None

    def _joined_ending(self, state: BlockState, states: list[BlockState]) -> Ended:
        """Return the callback for a joined read; if the device refuses it, its blocks are not joined again."""

        def ended(failure: Failure | None) -> None:
            refused = failure is not None and (failure.outcome == "refused" or failure.device_code is not None)
            if refused and failure is not None and failure.outcome != "no_reply":
                self._alone |= {one.id for one in states}
            self._over(state, failure)

        return ended

    # ---- joined reads -------------------------------------------------------------------------------------

    def joins(self, state: BlockState, others: list[BlockState]) -> list[BlockState]:
        """Return the waiting reads of the same station that are neighbours of this read."""
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
            return []  # its memory has no valid station: it fails by itself
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
            block = self._look(state)
        except SettingError:
            return None
        read = channel.transfers.read_of(block, lambda failure: None)
        return None if read is None else Read(state, read.address, read.count)


def rules_of(channel: Channel) -> LaneRules:
    """Return the rules of the scheduler for a channel."""
    retries = channel.protocol.params.get(REPEATS)
    number = channel.params.get(REPEATS, None if retries is None else constant_number(retries.default))
    return LaneRules(
        tries=1 + number if isinstance(number, int) else 1,
        silence=channel.silence,
        dead=channel.dead,
        stations={station: rules.dead for station, rules in channel.stations.items() if rules.own_dead},
        command_queue=channel.command_queue,
        command_start=channel.command_start,
    )
