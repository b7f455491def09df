"""The jobs of a run: the job table on the run's channels and memory.

Jobs share the connection of their channel with its blocks and with each other; the channel's engine runs one exchange
after the other, or several if its protocol supports that. The job table decides when a job starts.
"""

from __future__ import annotations

import asyncio
import errno
import os
import socket
from collections import deque
from collections.abc import Callable, Container, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from framekit.codec.codec import compile_protocol
from framekit.codec.shown import explain
from framekit.definition.model.protocol import Protocol
from framekit.definition.problems import NOWHERE
from framekit.definition.times import NEVER
from framekit.extras.commreq.job_table import Attempt, JobTable, RecordReader
from framekit.link.events import Command as LinkCommand
from framekit.link.events import Monitor
from framekit.link.packing import values_of
from framekit.link.services.client import TransferResult
from framekit.link.values import EVALUATION_ERRORS
from framekit.memory.memory import DeviceMemory, DeviceMemoryError, unit_bits
from framekit.run.block_state import Failure, failure_of
from framekit.run.commands import CommandFaultError, StatusPlaceError
from framekit.run.model import (
    Channel,
    JobCommand,
    JobProfile,
    JobRecord,
    JobsSection,
    Opening,
    Order,
    OwnPlace,
    channel_to,
    is_address,
)
from framekit.run.own_memory import AddressedMemory, read_piece, store_pieces
from framekit.run.status import JobsStatus
from framekit.runfile.devices import memory_of
from framekit.service.channel import ChannelOwner, ChannelService, RunChannels
from framekit.service.run_jobs import ChannelOpener, Found, ResolveHost
from framekit.transport.clock import AsyncioClock, Clock


def resolver_for(clock: Clock) -> ResolveHost:
    """Return the system's resolver on a real clock; on any other clock no name is known."""
    return SystemResolver(clock) if isinstance(clock, AsyncioClock) else lambda name, found: found([])


class SystemResolver:
    """Asks the system in a thread of the loop; answers arrive in callbacks of the clock."""

    def __init__(self, clock: AsyncioClock) -> None:
        self._clock = clock
        self._asking: set[asyncio.Task[None]] = set()

    def __call__(self, name: str, found: Found) -> None:
        task = asyncio.ensure_future(self._ask(name, found))
        self._asking.add(task)
        task.add_done_callback(self._asking.discard)

    async def _ask(self, name: str, found: Found) -> None:
        try:
            rows = await asyncio.get_running_loop().getaddrinfo(name, None, type=socket.SOCK_STREAM)
        except socket.gaierror as error:
            unknown = error.errno in (socket.EAI_NONAME, getattr(socket, "EAI_NODATA", None))  # not every system has it
            found([] if unknown else None)
        except (OSError, UnicodeError):
            found(None)
        else:
            found(list(dict.fromkeys(str(row[4][0]) for row in rows)))


FIRST_OPENED = 1001
"""First number of channels opened on demand, above those of a run."""

Way = Callable[[int | None, str], None]
"""Callback for the number of a channel; None with the reason, a word of a job profile, if no channel is available."""


class HostChannels:
    """Finds channels to hosts. `in_use`: whether a job uses a channel, or waits for it."""

    def __init__(
        self,
        section: JobsSection,
        channels: Mapping[int, ChannelService],
        clock: Clock,
        resolve: ResolveHost,
        opener: ChannelOpener,
        in_use: Callable[[int], bool],
    ) -> None:
        self._section = section
        self._channels = channels
        self._clock = clock
        self._resolve = resolve
        self._opener = opener
        self._in_use = in_use
        self.opened: list[int] = []
        """Channels opened here, the most recently requested last."""

    def find(self, attempt: Attempt, wanted: Callable[[], bool], way: Way) -> None:
        """Find the channel to a host: by the run, else by the address of the name.

        Open no channel unless it is still `wanted`.
        """
        host = attempt.order.host
        if attempt.order.channel is not None:
            way(attempt.order.channel, "no_channel")
            return
        number = self._channel_to(host)
        if number is None and host in self._section.hosts:
            host = self._section.hosts[host]
            number = self._channel_to(host)
        opening = self._section.opening
        if number is not None or is_address(host) or (opening is not None and opening.leads_anywhere):
            self._lead(number, host, way)
            return

        def found(addresses: list[str] | None) -> None:
            """Use the addresses of the name; empty: unknown; None: the resolver failed."""
            if not wanted():
                return
            if not addresses:
                way(None, "no_resolver" if addresses is None else "unknown_host")
                return
            numbers = (self._channel_to(address) for address in addresses)
            self._lead(next((number for number in numbers if number is not None), None), addresses[0], way)

        self._resolve(host, found)

    def _channel_to(self, host: str) -> int | None:
        return channel_to(host, {number: channel.channel for number, channel in self._channels.items()})

    # ---- opened when wanted -------------------------------------------------------------------------------

    def _lead(self, number: int | None, address: str, way: Way) -> None:
        if number is None:
            with suppress(ValueError):  # a port that cannot be made leads nowhere
                number = self._open(address)
        if number in self.opened:
            self.opened.remove(number)
            self.opened.append(number)
        way(number, "no_channel")

    def open_now(self) -> None:
        """Open the channel that leads to every host, before a job requests it. Raises ValueError."""
        opening = self._section.opening
        if opening is not None and opening.leads_anywhere:
            self._open("")

    def _open(self, address: str) -> int | None:
        """Return a channel to an address if the run allows a further channel; else None. Raises ValueError."""
        opening = self._section.opening
        if opening is None:
            return None
        port = opening.port_to(address)
        same = next((number for number in self.opened if self._channels[number].channel.port == port), None)
        if same is not None:
            return same
        if len(self.opened) >= opening.connections and not self._make_room():
            return None
        number = FIRST_OPENED
        while number in self._channels:
            number += 1
        self._opener.open_for_jobs(replace(opening.channel, number=number, port=port, host=address))
        self.opened.append(number)
        return number

    def _make_room(self) -> bool:
        """Close the channel that has been unused for the longest time; return whether an unused channel existed."""
        idle = next((number for number in self.opened if not self._in_use(number)), None)
        if idle is not None:
            self._close(idle)
        return idle is not None

    def _close(self, number: int) -> None:
        self.opened.remove(number)
        self._opener.close_for_jobs(number)

    def lost(self, number: int) -> None:
        """Handle a closed channel: a channel opened here is removed, unless a job requests it again."""
        if number in self.opened:
            self._clock.call_soon(lambda: self._give_up(number))

    def _give_up(self, number: int) -> None:
        if number in self.opened and self._channels[number].state != "open" and not self._in_use(number):
            self._close(number)

    def close_all(self) -> None:
        """Close every channel that was opened here."""
        for number in tuple(self.opened):
            self._close(number)


Finished = Callable[[int, Failure | None], None]

NO_NETWORK = tuple(os.strerror(number) for number in (errno.ENETDOWN, errno.ENETUNREACH, errno.EADDRNOTAVAIL))
"""System messages when no host at all can be reached; all others concern a single host."""


class JobService:
    """Runs the jobs of a run. `finished` is called at the end of each block's command, `wake` when times change."""

    def __init__(
        self,
        section: JobsSection,
        memory: DeviceMemory,
        channels: Mapping[int, ChannelService],
        clock: Clock,
        finished: Finished,
        wake: Callable[[], None],
        resolve: ResolveHost | None,
        opener: ChannelOpener,
    ) -> None:
        self.section = section
        self.memory = memory
        self.channels = channels
        self.clock = clock
        self._finished = finished
        self._wake = wake
        self.table = JobTable(section.profile, self)
        if section.opening is not None:
            compile_protocol(section.opening.channel.protocol)  # not in the midst of exchanges
        self.hosts = HostChannels(section, channels, clock, resolve or resolver_for(clock), opener, self._uses)
        self._channel_of: dict[int, int] = {}
        self._waiting: dict[int, list[Attempt]] = {}
        self._surplus: deque[JobCommand] = deque()
        self._records: RecordReader | None = None

    # ---- life ---------------------------------------------------------------------------------------------

    def start(self) -> None:
        """Accept commands from now on."""
        self._channel_of.clear()
        self._waiting.clear()
        self.table.start(self.clock.now())

    def stop(self) -> None:
        """Abort all jobs."""
        self.table.stop()
        while self._surplus:
            self.answered(self._surplus.popleft(), None)

    def reset(self) -> None:
        """Reset to the state after the start."""
        self.stop()
        self._channel_of.clear()
        self._waiting.clear()
        self.table.reset(self.clock.now())

    @property
    def deadline(self) -> int:
        """Return the time of the next work for `tick`."""
        return min(self.table.deadline, self.table.room_at(self.clock.now()) if self._surplus else NEVER)

    def status(self) -> JobsStatus:
        """Return the state of the slots, the last events, and the counted commands."""
        table = self.table
        counters = replace(table.counters, kinds=dict(table.counters.kinds))
        return JobsStatus(slots=tuple(table.status()), log=tuple(table.log), events=table.log.total, counters=counters)

    def tick(self, now: int) -> None:
        """Do the work that is due; waiting commands come first."""
        while self._surplus and self.table.room_at(now) <= now:
            self.table.take(self._surplus.popleft(), now)
        self.table.tick(now)

    def take(self, command: JobCommand | JobRecord) -> None:
        """Carry out a command of a block. Its status word is 0 until the answer.

        A record in memory is taken unchanged: its writer clears the status word, and commands in excess are lost.
        """
        if isinstance(command, JobRecord):
            self._take_record(command)
            return
        if command.status is not None:
            self.write_words(command.status, (0,))
        now = self.clock.now()
        if self.section.waits and (self._surplus or self.table.room_at(now) > now):
            self._surplus.append(command)
        else:
            self.table.take(command, now)
        self._wake()

    def _take_record(self, record: JobRecord) -> None:
        reader = self._reader(record.application)
        try:
            command, refusal = reader.read(reader.words_at(record.place), record.id)
        except CommandFaultError as error:
            self.table.fault(self.clock.now(), has_place=not isinstance(error, StatusPlaceError))
            self._show_fault(record, True)
            if record.id is not None:
                self._finished(record.id, Failure(outcome="cannot_send", cause=str(error)))
            return
        self._show_fault(record, False)
        self.table.take(command, self.clock.now(), refusal)
        self._wake()

    def _reader(self, application: Protocol) -> RecordReader:
        if self._records is None:
            self._records = RecordReader(application, self.memory)
        return self._records

    def take_words(self, data: bytes, application: Protocol, number: int | None) -> None:
        """Carry out the command that begins with these bytes. Raises CommandFaultError if the bytes are no command."""
        command, refusal = self._reader(application).read(data, number)
        self.table.take(command, self.clock.now(), refusal)
        self._wake()

    def _show_fault(self, record: JobRecord, fault: bool) -> None:
        if record.fault is not None:
            store_pieces(self.memory, [(record.fault, 1, bytes([fault]))])

    # ---- connections --------------------------------------------------------------------------------------

    def connect(self, attempt: Attempt) -> None:
        """Assign the channel to its host to a job; a closed channel is opened now."""
        self._channel_of.pop(attempt.slot, None)
        self.hosts.find(
            attempt, lambda: self.table.awaits(attempt), lambda number, reason: self._join(attempt, number, reason)
        )

    def _uses(self, number: int) -> bool:
        """Return whether a job uses a channel, or waits for it."""
        slots = self.table.slots
        return any(slots[slot].active for slot, channel in self._channel_of.items() if channel == number)

    def _no_way(self, attempt: Attempt, reason: str) -> None:
        self.table.not_connected(attempt, reason, self.clock.now())
        self._wake()

    def _join(self, attempt: Attempt, number: int | None, reason: str) -> None:
        """Continue a job with its channel, unless the job has ended meanwhile.

        A job waits, up to its time limit, for a channel that opens, or whose line another port still closes.
        """
        if not self.table.awaits(attempt):
            return
        channel = None if number is None else self.channels.get(number)
        if channel is None or number is None:
            self._no_way(attempt, reason)
            return
        self._channel_of[attempt.slot] = number
        if channel.state == "open":
            self.table.connected(attempt, self.clock.now())
            self._wake()
            return
        self._waiting.setdefault(number, []).append(attempt)
        if not (channel.waits_for_line or channel.driver.hurry()):
            self._waiting[number] = [one for one in self._waiting[number] if one is not attempt]
            self._no_way(attempt, "not_connected")

    def opened(self, number: int, is_open: bool) -> None:
        """Begin or end the jobs of a channel that has been opened or closed."""
        waiting, self._waiting[number] = self._waiting.get(number, []), []
        now = self.clock.now()
        if is_open:
            self.table.set_network(True, now)
        elif any(self.channels[number].state.endswith(reason) for reason in NO_NETWORK):
            self.table.set_network(False, now)
        for attempt in waiting:
            if is_open:
                self.table.connected(attempt, now)
            else:
                self.table.not_connected(attempt, "not_connected", now)
        if not is_open:
            for slot, channel in self._channel_of.items():
                if channel == number:
                    self.table.lost(slot, now)
            self.hosts.lost(number)
        self._wake()

    def give_up(self, blocks: Container[int]) -> None:
        """End the jobs that these blocks have started."""
        self.table.give_up(blocks, self.clock.now())
        self._wake()

    # ---- transfers ----------------------------------------------------------------------------------------

    def begin(self, attempt: Attempt) -> None:
        """Begin a transfer on the channel of its job."""
        channel, order = self.channels.get(self._channel_of.get(attempt.slot, 0)), attempt.order
        if channel is None or channel.client is None:
            self.table.ended(attempt, Failure(outcome="no_sequence"), self.clock.now())
            return

        def done(result: TransferResult) -> None:
            failure = failure_of(result)
            channel.counters.ended("" if failure is None else failure.outcome)
            self.table.ended(attempt, failure, self.clock.now(), lambda: self._store(order, result))
            self._wake()

        try:
            channel.driver.do(lambda now: self._start(channel, order, now, done))
        except (DeviceMemoryError, *EVALUATION_ERRORS) as error:
            self.table.ended(attempt, Failure(outcome="cannot_send", cause=explain(error)), self.clock.now())

    def _start(
        self, channel: ChannelService, order: Order, now: int, done: Callable[[TransferResult], None]
    ) -> list[LinkCommand]:
        client = channel.client
        assert client is not None
        station = channel.channel.station if order.station is None else order.station
        params = {**channel.params_of(station), **order.params}
        if order.kind == "read":
            return client.read(
                order.remote,
                station=station,
                unit=order.unit,
                count=order.count,
                params=params,
                now=now,
                on_done=done,
            ).commands
        unit = order.unit or client.grammar.parse(order.remote).unit
        data = read_piece(self.memory, order.place, order.count * unit_bits(unit))
        values = values_of(data, unit, order.count)
        return client.write(
            order.remote, values, station=station, unit=order.unit, params=params, now=now, on_done=done
        ).commands

    def _store(self, order: Order, result: TransferResult) -> Failure | None:
        """Store the read data at its place in the own memory, whole; return the failure, if any."""
        if order.kind != "read":
            return None
        client = self.channels[self._channel_of[order.slot]].client
        assert client is not None
        try:
            unit = order.unit or client.grammar.parse(order.remote).unit
            store_pieces(self.memory, [(order.place, order.count * unit_bits(unit), result.data)])
        except (DeviceMemoryError, ValueError) as error:
            return Failure(outcome="cannot_store", cause=str(error))
        return None

    # ---- words and bits -----------------------------------------------------------------------------------

    def write_words(self, place: OwnPlace, words: tuple[int, ...]) -> bool:
        """Write words into the own memory; return whether that was possible."""
        data = b"".join(word.to_bytes(2, "little") for word in words)
        try:
            store_pieces(self.memory, [(place, 16 * len(words), data)])
        except (DeviceMemoryError, ValueError):
            return False
        return True

    def write_bits(self, bits: tuple[int, ...]) -> None:
        """Write the status bits to the own memory, also if clients may not write there."""
        place = self.section.status
        if place is None:
            return
        data = sum(bit << index for index, bit in enumerate(bits)).to_bytes(-(-len(bits) // 8), "little")
        self.memory.area(place.address.area).write_bits(place.address.first_bit, len(bits), data, force=True)

    def answered(self, command: JobCommand, word: int | None) -> None:
        """Report the answer of a command to its block."""
        if command.id is None:
            return
        profile = self.section.profile
        if word == profile.words["good"]:
            self._finished(command.id, None)
        elif word is None:
            outcome = "queue_full" if self.table.running else "cancelled"
            self._finished(command.id, Failure(outcome=outcome, cause="the command was not taken"))
        else:
            meaning = profile.text_of(word)
            self._finished(command.id, Failure(outcome="refused", device_code=word, meaning=meaning))


Ended = Callable[[Failure | None], None]
"""Callback for the answer of a command, called once; None for success."""


class JobLine(ChannelOwner):
    """Jobs over a memory with the areas of `application`. `channel`: the way to hosts, as in `Opening`.

    `closed` is called with the reason why the connection to a host is closed, or could not be opened.
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
        watch = None if monitor is None else lambda number, seen: monitor(seen)
        self._lines = RunChannels(self.channels, clock, AddressedMemory(self.memory, grammar), self, watch)
        self._closed = closed
        self._ended: dict[int, Ended] = {}
        self._number = 0
        self._alarm = clock.alarm(self._tick)
        opening = Opening(channel=channel, connections=len(profile.slots))
        section = JobsSection(profile=profile, opening=opening, at=NOWHERE)
        self.jobs = JobService(
            section, self.memory, self.channels, clock, self._finished, self._arm, resolver_for(clock), self
        )
        self.table = self.jobs.table

    # ---- life ---------------------------------------------------------------------------------------------

    def start(self) -> None:
        """Accept commands from now on. Raises DefinitionError, ValueError for a port that cannot be made."""
        self.jobs.hosts.open_now()
        self.jobs.start()
        self._arm()

    def stop(self) -> None:
        """Abort all jobs and close their connections."""
        self.jobs.stop()
        self.jobs.hosts.close_all()
        self._arm()

    @property
    def active(self) -> bool:
        """Return whether a job is active."""
        return any(slot.active for slot in self.table.slots.values())

    def carry_out(self, data: bytes, ended: Ended) -> None:
        """Carry out the command that begins with these bytes; `ended` is called with its answer, perhaps at once.

        Raises CommandFaultError if the bytes are no command.
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
        """Make and open a channel. Raises ValueError for a port that cannot be made."""
        self._lines.put(channel.number, self._lines.make(channel, (), str(Path.cwd())))
        self._lines.open(channel.number)

    def close_for_jobs(self, number: int) -> None:
        """Close and remove a channel."""
        self._lines.close(number)
        self.jobs.opened(number, False)
        self._lines.remove(number)

    def opened(self, channel: int, is_open: bool) -> None:
        """Pass on whether exchanges can be started on a channel now."""
        if not is_open:
            self._closed(self.channels[channel].state)
        self.jobs.opened(channel, is_open)

    # ---- time ---------------------------------------------------------------------------------------------

    def _tick(self) -> None:
        self.jobs.tick(self.clock.now())
        self._arm()

    def _arm(self) -> None:
        self._alarm.set(self.jobs.deadline if self.table.running else NEVER)
