"""The jobs of a run: the job table on the run's channels and memory.

Jobs share the connection of their channel with its blocks and with each other; the channel's engine does one exchange
after the other, or several where its protocol can. When what starts is the table's business.
"""

from __future__ import annotations

import errno
import os
from collections import deque
from collections.abc import Callable, Container, Mapping

from framekit.codec.codec import compile_protocol
from framekit.codec.shown import explain
from framekit.definition.model.protocol import Protocol
from framekit.definition.times import NEVER
from framekit.link.evaluate import EVALUATION_ERRORS
from framekit.link.events import Command as LinkCommand
from framekit.link.packing import values_of
from framekit.link.services.client import TransferResult
from framekit.memory.memory import DeviceMemory, DeviceMemoryError, unit_bits
from framekit.run.block_state import Failure, failure_of
from framekit.run.commands import CommandFaultError, StatusPlaceError
from framekit.run.job_records import RecordReader
from framekit.run.job_status import Attempt
from framekit.run.job_table import JobTable
from framekit.run.model import JobCommand, JobRecord, JobsSection, Order, Place
from framekit.run.own_memory import read_piece, store_pieces
from framekit.service.channel import ChannelService
from framekit.service.host_channels import ChannelOpener, HostChannels
from framekit.service.resolver import Resolve
from framekit.transport.clock import Clock

Finished = Callable[[int, Failure | None], None]

NO_NETWORK = tuple(os.strerror(number) for number in (errno.ENETDOWN, errno.ENETUNREACH, errno.EADDRNOTAVAIL))
"""What systems say when nobody at all can be reached; anything else is the trouble of one host."""


class JobService:
    """Carries out the jobs of a run. `finished` is told the end of each block's command, `wake` when times change."""

    def __init__(
        self,
        section: JobsSection,
        memory: DeviceMemory,
        channels: Mapping[int, ChannelService],
        clock: Clock,
        finished: Finished,
        wake: Callable[[], None],
        resolve: Resolve,
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
        self.hosts = HostChannels(section, channels, clock, resolve, opener, self._uses)
        self._channel_of: dict[int, int] = {}
        self._waiting: dict[int, list[Attempt]] = {}
        self._surplus: deque[JobCommand] = deque()
        self._records: RecordReader | None = None

    # ---- life ---------------------------------------------------------------------------------------------

    def start(self) -> None:
        """Commands are taken from now on."""
        self._channel_of.clear()
        self._waiting.clear()
        self.table.start(self.clock.now())

    def stop(self) -> None:
        """All jobs are aborted."""
        self.table.stop()
        while self._surplus:
            self.answered(self._surplus.popleft(), None)

    def reset(self) -> None:
        """As after the start."""
        self.stop()
        self._channel_of.clear()
        self._waiting.clear()
        self.table.reset(self.clock.now())

    @property
    def deadline(self) -> int:
        """When `tick` has something to do."""
        return min(self.table.deadline, self.table.room_at(self.clock.now()) if self._surplus else NEVER)

    def tick(self, now: int) -> None:
        """Does what is due; commands that had to wait come first."""
        while self._surplus and self.table.room_at(now) <= now:
            self.table.take(self._surplus.popleft(), now)
        self.table.tick(now)

    def take(self, command: JobCommand | JobRecord) -> None:
        """Carries a block's command out. Its status word is 0 from here until it has its answer.

        A record in memory is taken as it stands: who writes it clears its status word, and commands too many are lost.
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
        """Carries out the command that begins with these bytes. Raises CommandFaultError when they are none."""
        command, refusal = self._reader(application).read(data, number)
        self.table.take(command, self.clock.now(), refusal)
        self._wake()

    def _show_fault(self, record: JobRecord, fault: bool) -> None:
        if record.fault is not None:
            store_pieces(self.memory, [(record.fault, 1, bytes([fault]))])

    # ---- connections --------------------------------------------------------------------------------------

    def connect(self, attempt: Attempt) -> None:
        """The job uses the channel that leads to its host; one that is not open is opened now."""
        self._channel_of.pop(attempt.slot, None)
        self.hosts.find(
            attempt, lambda: self.table.awaits(attempt), lambda number, reason: self._join(attempt, number, reason)
        )

    def _uses(self, number: int) -> bool:
        """Whether a job is on a channel, or waits for it."""
        slots = self.table.slots
        return any(slots[slot].active for slot, channel in self._channel_of.items() if channel == number)

    def _no_way(self, attempt: Attempt, reason: str) -> None:
        self.table.not_connected(attempt, reason, self.clock.now())
        self._wake()

    def _join(self, attempt: Attempt, number: int | None, reason: str) -> None:
        """Of a job that is no more nothing is known."""
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
        if not channel.driver.hurry():
            self._waiting[number] = [one for one in self._waiting[number] if one is not attempt]
            self._no_way(attempt, "not_connected")

    def opened(self, number: int, is_open: bool) -> None:
        """A channel is open, or is not: its jobs begin, or end."""
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
        """Ends the jobs that these blocks have established."""
        self.table.give_up(blocks, self.clock.now())
        self._wake()

    # ---- transfers ----------------------------------------------------------------------------------------

    def begin(self, attempt: Attempt) -> None:
        """Begins a transfer on the channel of its job."""
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
            )
        unit = order.unit or client.grammar.parse(order.remote).unit
        data = read_piece(self.memory, order.place, order.count * unit_bits(unit))
        values = values_of(data, unit, order.count)
        return client.write(
            order.remote, values, station=station, unit=order.unit, params=params, now=now, on_done=done
        )

    def _store(self, order: Order, result: TransferResult) -> Failure | None:
        """What was read, at its place in the own memory, whole."""
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

    def write_words(self, place: Place, words: tuple[int, ...]) -> bool:
        """Puts words into the own memory; whether they could be."""
        data = b"".join(word.to_bytes(2, "little") for word in words)
        try:
            store_pieces(self.memory, [(place, 16 * len(words), data)])
        except (DeviceMemoryError, ValueError):
            return False
        return True

    def write_bits(self, bits: tuple[int, ...]) -> None:
        """Puts the status bits into the own memory, also where others may not write."""
        place = self.section.status
        if place is None:
            return
        data = sum(bit << index for index, bit in enumerate(bits)).to_bytes(-(-len(bits) // 8), "little")
        self.memory.area(place.address.area).write_bits(place.address.first_bit, len(bits), data, force=True)

    def answered(self, command: JobCommand, word: int | None) -> None:
        """The block of a command has ended."""
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
