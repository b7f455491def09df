"""The job table: commands establish, abort and inspect jobs; a job repeats its transfer until it is complete or fails.

Sans-I/O: the owner passes the time, opens connections and carries out the transfers. The effects of a transfer come in
this order: its data, the status word of the command (once), the status bits. Numbers, limits and codes come from the
profile. This module also reads commands from words in the own memory; the application defines their meaning.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Container, Iterator
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Any, get_args
from typing import Protocol as Interface

from framekit.codec.shown import explain
from framekit.definition.model.frames import expressions_of
from framekit.definition.model.protocol import Protocol
from framekit.definition.times import NEVER
from framekit.extras.commreq.status_bits import StatusImage
from framekit.link.addresses import Address
from framekit.link.services.work import CompiledBlock, CompiledJob, CompiledPlace
from framekit.link.values import EVALUATION_ERRORS, Names, compile_expression
from framekit.memory.memory import DeviceMemory, DeviceMemoryError, unit_bits
from framekit.run.block_state import Failure
from framekit.run.commands import CommandBlocks, CommandFaultError, StatusPlaceError
from framekit.run.commands import CommandFrame as CommandWords
from framekit.run.model import (
    OTHERWISE,
    AfterLate,
    CodeClass,
    CommandKind,
    JobCommand,
    JobProfile,
    Order,
    OrderKind,
    OwnPlace,
)
from framekit.run.status import IrregularEvent, JobCounters, JobStatus, TableCounters


class JobState(Enum):
    """The state of a job."""

    IDLE = "idle"
    CONNECTING = "connecting"
    TRANSFERRING = "transferring"
    WAITING = "waiting"


@dataclass(frozen=True, slots=True, eq=False)
class Attempt:
    """An attempt to connect or to transfer, compared by identity."""

    slot: int
    order: Order


@dataclass(slots=True)
class JobSlot:
    """A slot of the table. Times that are not awaited are NEVER."""

    number: int
    state: JobState = JobState.IDLE
    order: Order | None = None
    asked: JobCommand | None = None
    """The command that has no answer yet."""
    by: int | None = None
    """The id of the command block that established the job."""
    attempt: Attempt | None = None
    """The connection or transfer in progress."""
    word: int = 0
    """The last code."""
    error: bool = False
    left: int = 0
    """The number of transfers that remain, if the job has a limit."""
    origin: int = 0
    """The time at which the job began."""
    boundary: int = 0
    """The beginning of the present period."""
    started: int = 0
    was_late: bool = False
    start_at: int = NEVER
    period_at: int = NEVER
    late_at: int = NEVER
    connect_by: int = NEVER
    last_good: int | None = None
    """The time of the last good transfer; None before the first."""
    last_error: int | None = None
    """The time of the last error; None before the first."""
    counters: JobCounters = field(default_factory=JobCounters)

    @property
    def active(self) -> bool:
        return self.state is not JobState.IDLE

    @property
    def deadline(self) -> int:
        """Return the time of the next action of this slot."""
        return min(self.start_at, self.period_at, self.late_at, self.connect_by)

    @property
    def period(self) -> int:
        """Return the period of the job; 0 for transfers back to back."""
        return 0 if self.order is None else self.order.period

    def watch_lateness(self, after_late: AfterLate, now: int) -> None:
        """Set the times at which a transfer that begins now is late.

        The limit of the period counts from the beginning of the present period if a late transfer is followed by the
        next period (`NEXT_PERIOD`), else from now.
        """
        self.was_late = False
        since = self.boundary if after_late is AfterLate.NEXT_PERIOD else now
        late = 0 if self.order is None else self.order.late
        self.period_at = since + self.period if self.period else NEVER
        self.late_at = now + late if late else NEVER

    def next_start(self, after_late: AfterLate, now: int) -> int:
        """Return when the transfer after the one that ended now starts; periods count from the start of the job."""
        if self.period == 0 or (self.was_late and after_late is AfterLate.AT_ONCE):
            return now
        periods = -((self.origin - now) // self.period)
        return max(self.boundary + self.period, self.origin + periods * self.period)

    def enter_period(self, now: int) -> None:
        """Note the start of a transfer; a late clock does not move the periods."""
        self.started = now
        self.boundary = self.origin + (now - self.origin) // self.period * self.period if self.period else now

    def rest(self) -> None:
        """Make the slot idle: no attempt and no awaited time; the last code stays."""
        self.state = JobState.IDLE
        self.attempt = None
        self.start_at = self.period_at = self.late_at = self.connect_by = NEVER

    @property
    def details(self) -> tuple[int, int]:
        """Return the two detail words: the last code, and 1 while a job is active."""
        return self.word, int(self.active)


class EventLog:
    """The last events, oldest first; `total` counts all events."""

    def __init__(self, profile: JobProfile) -> None:
        self._profile = profile
        self._events: deque[IrregularEvent] = deque(maxlen=profile.log)
        self.total = 0

    def add(self, name: str, at: int, slot: int | None = None, word: int = 0) -> None:
        """Add an event; drop the oldest event of a full log."""
        self.total += 1
        text, code = self._profile.text_of(word), self._profile.events.get(name)
        self._events.append(IrregularEvent(at=at, name=name, slot=slot, word=word, text=text, code=code))

    def __iter__(self) -> Iterator[IrregularEvent]:
        return iter(tuple(self._events))

    def __len__(self) -> int:
        return len(self._events)


def status_of(slot: JobSlot, profile: JobProfile) -> JobStatus:
    """Return the present state of a slot; an idle slot shows its last job."""
    order = slot.order
    status = JobStatus(
        slot=slot.number, kind="", state=slot.state.value, word=slot.word, text=profile.text_of(slot.word),
        error=slot.error, pending=slot.asked is not None, counters=slot.counters, last_good=slot.last_good,
        last_error=slot.last_error,
    )  # fmt: skip
    if order is None:
        return status
    host = order.host or ("" if order.channel is None else f"channel {order.channel}")
    return replace(
        status, kind=order.kind, remote=order.remote, own=order.place.text, count=order.count, host=host,
        period=order.period, left=slot.left if order.times else None,
    )  # fmt: skip


Store = Callable[[], Failure | None]
"""Store data that were read; return the failure if they cannot be stored."""

Watcher = Callable[[JobStatus, Failure | None], None]
"""Receive the state of a slot when a transfer has ended, is `late`, or could not begin, with its failure or None."""


class JobOwner(Interface):
    """The operations that a table needs from its owner."""

    def connect(self, attempt: Attempt) -> None:
        """Open a connection to the host of an order; call `connected` or `not_connected` of the table."""

    def begin(self, attempt: Attempt) -> None:
        """Begin a transfer; call `ended` of the table at its end."""

    def write_words(self, place: OwnPlace, words: tuple[int, ...]) -> bool:
        """Write words from a place on; return whether they could be written."""

    def write_bits(self, bits: tuple[int, ...]) -> None:
        """Write the status bits."""

    def answered(self, command: JobCommand, word: int | None) -> None:
        """Receive the answer to a command; None if it is never answered."""


class FailureWords:
    """The words of failed transfers, by the outcomes of the profile."""

    def __init__(self, profile: JobProfile) -> None:
        self._outcomes = profile.outcomes
        self._unknown = profile.words["closed"]
        self._words = {name: compile_expression(one.word) for name, one in profile.outcomes.items()}

    def word_of(self, failure: Failure) -> tuple[int, bool]:
        """Return the word, and whether the failure counts as a completed transfer.

        A code of the device makes the failure a refusal.
        """
        name = failure.outcome if failure.outcome in self._words else OTHERWISE
        if failure.device_code is not None and "refused" in self._words:
            name = "refused"
        try:
            word = int(self._words[name](Names({"code": failure.device_code or 0}))) & 0xFFFF
        except EVALUATION_ERRORS:
            word = 0
        return word or self._unknown, self._outcomes[name].completed


class CommandLimit:
    """Limit the commands in a scan to `most`; scans of `scan` ns count from `origin`."""

    def __init__(self, most: int, scan: int, origin: int) -> None:
        self._most, self._scan, self._origin = most, scan, origin
        self._current, self._taken = -1, 0

    def room_at(self, now: int) -> int:
        """Return when another command can be taken: now, or with the next scan."""
        current = (now - self._origin) // self._scan
        full = current == self._current and self._taken >= self._most
        return self._origin + (current + 1) * self._scan if full else now

    def takes(self, now: int) -> bool:
        """Count a command; return whether it is within the limit."""
        current = (now - self._origin) // self._scan
        if current != self._current:
            self._current, self._taken = current, 0
        self._taken += 1
        return self._taken <= self._most


LEAST_TIME = 1_000_000
"""The pause after a transfer that ends at the moment of its start (ns), so that such transfers do not repeat endlessly
at the same time."""


class JobTable:
    """The jobs of a run."""

    def __init__(self, profile: JobProfile, owner: JobOwner) -> None:
        self.profile = profile
        self.owner = owner
        self.slots = {number: JobSlot(number) for number in profile.slots}
        self.image = StatusImage(profile.bits, profile.slots, profile.scan, owner.write_bits)
        self.log = EventLog(profile)
        self.counters = TableCounters()
        self._failures = FailureWords(profile)
        self._limit = CommandLimit(profile.commands, profile.scan, 0)
        self.watcher: Watcher | None = None
        self.running = False

    # ---- life ---------------------------------------------------------------------------------------------

    def start(self, now: int) -> None:
        """Take commands from now on, with idle slots."""
        self.running = True
        self._limit = CommandLimit(self.profile.commands, self.profile.scan, now)
        for number in self.slots:
            self.slots[number] = JobSlot(number)
        self.image.start(now)

    def stop(self) -> None:
        """Abort all jobs and take no commands. The bits are 0; the codes stay for inspection."""
        self.running = False
        for slot in self.slots.values():
            slot.rest()
            slot.error = False
            asked, slot.asked = slot.asked, None
            if asked is not None:
                self.owner.answered(asked, None)
        self.image.stop()

    def reset(self, now: int) -> None:
        """Stop, set the counters to 0 and start."""
        self.stop()
        self.counters = TableCounters()
        self.start(now)

    def status(self) -> list[JobStatus]:
        """Return the state of every slot."""
        return [status_of(slot, self.profile) for slot in self.slots.values()]

    # ---- commands -----------------------------------------------------------------------------------------

    def take(self, command: JobCommand, now: int, refusal: int = 0) -> None:
        """Carry out a command, or answer with the reason of its refusal; `refusal` is the answer to an invalid command.

        A command beyond the limit of a scan is lost and never answered.
        """
        if not self.running or not self._limit.takes(now):
            self.counters.lost += 1
            self.log.add("lost", now, command.slot)
            if self.running:
                self.image.short(now)
            self.owner.answered(command, None)
            return
        self.counters.taken += 1
        self.counters.kinds[command.kind] = self.counters.kinds.get(command.kind, 0) + 1
        if refusal:
            self.refuse(command, refusal, now)
        elif command.slot is not None and command.slot not in self.slots:
            self.refuse(command, self.profile.words["no_slot"], now)
        elif command.kind == "abort":
            self._clear(list(self.slots) if command.slot is None else [command.slot], now)
            self._answer(command, self.profile.words["good"], now)
        elif command.slot is None:
            self.refuse(command, self.profile.words["no_slot"], now)
        elif command.kind == "inspect":
            self._inspect(command, self.slots[command.slot], now)
        elif command.order is not None:
            self._establish(command, self.slots[command.slot], now)

    def give_up(self, givers: Container[int], now: int) -> None:
        """End the jobs that these command blocks established, as an abort does."""
        for slot in self.slots.values():
            if slot.by in givers and slot.active:
                self._clear([slot.number], now)

    def room_at(self, now: int) -> int:
        """Return when another command can be taken: now, or with the next scan."""
        return self._limit.room_at(now)

    def fault(self, now: int, *, has_place: bool) -> None:
        """Log words that are not a command, or a command whose status word has no place. This is their only report."""
        self.counters.faults += 1
        self.log.add("fault", now, None, 0 if has_place else self.profile.words["no_place"])

    def refuse(self, command: JobCommand, word: int, now: int) -> None:
        """Answer an invalid command with `word`; it has no other effect."""
        self.counters.refused += 1
        self.log.add("refused", now, command.slot, word)
        self._answer(command, word, now)

    def _inspect(self, command: JobCommand, slot: JobSlot, now: int) -> None:
        """Write the detail words, then the answer; the bits stay as they are."""
        word = self.profile.words["good"]
        if command.into is not None and not self.owner.write_words(command.into, slot.details):
            word, _ = self._failures.word_of(Failure(outcome="cannot_store"))
        self._answer(command, word, now)

    def _clear(self, numbers: list[int], now: int) -> None:
        """End jobs at once: set their bits and codes to 0. Answer pending commands with the code `replaced`."""
        for number in numbers:
            slot = self.slots[number]
            slot.rest()
            slot.word, slot.error = 0, False
        self.image.clear(numbers)
        for number in numbers:
            self._tell(self.slots[number], self.profile.words["replaced"], now)

    def _establish(self, command: JobCommand, slot: JobSlot, now: int) -> None:
        order = command.order
        assert order is not None
        if order.kind == "report":
            self.refuse(command, self.profile.words["unsupported"], now)
            return
        self._clear([slot.number], now)
        slot.order, slot.asked, slot.by, slot.left = order, command, command.id, order.times
        slot.counters.established += 1
        slot.state = JobState.CONNECTING
        slot.origin = slot.boundary = slot.started = now
        slot.connect_by = now + self.profile.connect
        slot.watch_lateness(self.profile.after_late, now)
        slot.attempt = attempt = Attempt(slot.number, order)
        self.owner.connect(attempt)

    # ---- connections --------------------------------------------------------------------------------------

    def awaits(self, attempt: Attempt) -> bool:
        """Return whether a connection is still needed: not after its job has ended or another job took its slot."""
        slot = self.slots[attempt.slot]
        return slot.attempt is attempt and slot.state is JobState.CONNECTING

    def connected(self, attempt: Attempt, now: int) -> None:
        """Begin the first transfer: the connection to the host is open."""
        slot = self.slots[attempt.slot]
        if self.awaits(attempt):
            slot.connect_by = NEVER
            self._begin(slot)

    def not_connected(self, attempt: Attempt, reason: str, now: int) -> None:
        """End a job that has no connection; `reason` is one of the words of the profile.

        The error bit stays as it is: it is for errors of jobs that had a connection.
        """
        if not self.awaits(attempt):
            return
        slot = self.slots[attempt.slot]
        slot.word = word = self.profile.words[reason]
        slot.last_error = now
        slot.counters.ended += 1
        if self.profile.kind_of(word) is CodeClass.RESOURCE:
            self.image.short(now)
        self.log.add("ended", now, slot.number, word)
        slot.rest()
        self._tell(slot, word, now)
        self._watched(slot, Failure(outcome=reason))

    def lost(self, number: int, now: int) -> None:
        """End a job whose connection is lost."""
        slot = self.slots[number]
        if slot.active and slot.state is not JobState.CONNECTING:
            self._settle(slot, self.profile.words["closed"], False, now)
            self._watched(slot, Failure(outcome="closed"))

    def set_network(self, on: bool, now: int) -> None:
        """Set whether the network can be used at all."""
        if on != self.image.network and self.running:
            self.image.set_network(on, now)

    # ---- time ---------------------------------------------------------------------------------------------

    @property
    def deadline(self) -> int:
        """Return the time of the next action of `tick`."""
        if not self.running:
            return NEVER
        return min(self.image.deadline, *(slot.deadline for slot in self.slots.values()))

    def tick(self, now: int) -> None:
        """Carry out the actions that are due, in the order of their times; then show the bits of the scan."""
        while self.running:
            slot = min(self.slots.values(), key=lambda one: one.deadline)
            if slot.deadline > now:
                break
            self._due(slot, now)
        if self.running:
            self.image.tick(now)

    def _due(self, slot: JobSlot, now: int) -> None:
        at = slot.deadline
        if at == slot.period_at:
            slot.period_at = at + slot.period if self.profile.late_again else NEVER
            slot.counters.over_period += 1
            self._late(slot, self.profile.words["period"], now)
        elif at == slot.late_at:
            slot.late_at = NEVER
            slot.counters.late += 1
            self._late(slot, self.profile.words["late"], now)
        elif at == slot.connect_by and slot.attempt is not None:
            slot.connect_by = NEVER
            self.not_connected(slot.attempt, "connect_timeout", now)
        else:
            self._start(slot, now)

    def _late(self, slot: JobSlot, word: int, now: int) -> None:
        """Report a late transfer, which may still end well; fail it if its status word cannot be written."""
        slot.was_late = True
        if self._tell(slot, word, now):
            self._show(slot, word, True, now)
            self._watched(slot, Failure(outcome="late"))
        elif slot.state is JobState.CONNECTING and slot.attempt is not None:
            self.not_connected(slot.attempt, "no_word", now)
        else:
            self._settle(slot, self.profile.words["no_word"], False, now)

    def _start(self, slot: JobSlot, now: int) -> None:
        """Start the next transfer; a late clock does not move the periods."""
        slot.enter_period(now)
        slot.watch_lateness(self.profile.after_late, now)
        self._begin(slot)

    # ---- transfers ----------------------------------------------------------------------------------------

    def _begin(self, slot: JobSlot) -> None:
        assert slot.order is not None
        slot.state = JobState.TRANSFERRING
        slot.start_at = NEVER
        slot.attempt = attempt = Attempt(slot.number, slot.order)
        self.owner.begin(attempt)

    def ended(self, attempt: Attempt, failure: Failure | None, now: int, store: Store | None = None) -> None:
        """End a transfer. `store` stores its data, unless the attempt is no longer awaited."""
        slot = self.slots[attempt.slot]
        if slot.attempt is not attempt:
            return
        if failure is None and store is not None:
            failure = store()
        if failure is None:
            self._settle(slot, self.profile.words["good"], True, now)
        else:
            self._settle(slot, *self._failures.word_of(failure), now)
        self._watched(slot, failure)

    def _watched(self, slot: JobSlot, failure: Failure | None) -> None:
        if self.watcher is not None:
            self.watcher(status_of(slot, self.profile), failure)

    def _settle(self, slot: JobSlot, word: int, completed: bool, now: int) -> None:
        """Write the results of a transfer: status word, bits, detail words; then schedule the next or end the job."""
        slot.period_at = slot.late_at = NEVER
        slot.attempt = None
        if not self._tell(slot, word, now):
            word = self.profile.words["no_word"]
        kind = self.profile.kind_of(word)
        if completed:
            self.image.completed(slot.number, now)
        if kind is CodeClass.RESOURCE:
            self.image.short(now)
        if kind is CodeClass.GOOD:
            slot.counters.good += 1
            slot.last_good = now
        else:
            slot.counters.refused += completed
        self._show(slot, word, kind is not CodeClass.GOOD, now)
        if completed and slot.left:
            slot.left -= 1
        if kind in (CodeClass.FATAL, CodeClass.SYNTAX):
            slot.counters.ended += 1
            self.log.add("ended", now, slot.number, word)
            slot.rest()
        elif completed and slot.order is not None and slot.order.times and not slot.left:
            slot.rest()
        else:
            self._wait(slot, word, now)

    def _wait(self, slot: JobSlot, word: int, now: int) -> None:
        """Schedule the next transfer: at the beginning of a period, or as soon as possible."""
        slot.state = JobState.WAITING
        start = slot.next_start(self.profile.after_late, now)
        if word & 0xFF in self.profile.pause_after:
            start = max(start, now + self.profile.pause)
        slot.start_at = max(start, now + LEAST_TIME) if now == slot.started else start

    def _tell(self, slot: JobSlot, word: int, now: int) -> bool:
        """Answer the pending command once; return whether the word could be written."""
        asked, slot.asked = slot.asked, None
        return asked is None or self._answer(asked, word, now)

    def _show(self, slot: JobSlot, word: int, error: bool, now: int) -> None:
        if error and not slot.error:
            self.log.add("error", now, slot.number, word)
        if error:
            slot.last_error = now
        slot.word, slot.error = word, error
        self.image.set_error(slot.number, error, now)

    def _answer(self, command: JobCommand, word: int, now: int) -> bool:
        """Write the status word; return whether it could be written."""
        written = command.status is None or self.owner.write_words(command.status, (word,))
        if not written:
            word = self.profile.words["no_word"]
            self.log.add("error", now, command.slot, word)
        self.owner.answered(command, word)
        return written


KINDS: dict[str, CommandKind] = {kind: kind for kind in get_args(CommandKind)}
ALL = "all"


class RecordReader:
    """Read the commands of one application from `memory`."""

    def __init__(self, application: Protocol, memory: DeviceMemory) -> None:
        self.memory = memory
        self.blocks = CommandBlocks(application, memory)
        says = "".join(str(one) for one in expressions_of(self.blocks.rules.status))
        self._status_fields = {name for name in self.blocks.words.head() if name in says}

    def words_at(self, place: OwnPlace) -> bytes:
        """Return the words from a place on, as many as the longest command can have."""
        area, first = self.memory.area(place.address.area), place.address.first_bit // 8
        return area.read_bytes(first, min(2 * self.blocks.rules.most, area.size_bytes - first))

    def read(self, data: bytes, number: int | None) -> tuple[JobCommand, int]:
        """Return the command at the beginning of `data`, and the code of its refusal or 0.

        `number`: the id of the command block. Raise CommandFaultError for words that are not a command,
        StatusPlaceError if the status word has no place.
        """
        words = self._words(data)
        try:
            status = self._place(self.blocks.status_words(words), 16)
        except (DeviceMemoryError, *EVALUATION_ERRORS) as error:
            raise StatusPlaceError(explain(error)) from None
        try:
            refusal, block, names = self.blocks.plan(words)
            if refusal or block is None or block.job is None:
                return JobCommand(kind="job", slot=None, status=status, id=number), refusal
            return self._command(block, block.job, names, status, number), 0
        except (DeviceMemoryError, *EVALUATION_ERRORS) as error:
            raise CommandFaultError(explain(error)) from None

    def _words(self, data: bytes) -> CommandWords:
        try:
            return self.blocks.words.read(data)
        except CommandFaultError as error:
            if error.segment in self._status_fields:
                raise StatusPlaceError(str(error), error.segment, error.found) from None
            raise

    def _command(
        self, block: CompiledBlock, job: CompiledJob, names: Names, status: OwnPlace, number: int | None
    ) -> JobCommand:
        slot = job.slot(names)
        kind = KINDS[job.kind]
        into = self._place(block.into.on(names), 32) if kind == "inspect" and block.into is not None else None
        return JobCommand(
            kind=kind,
            slot=None if slot == ALL else int(slot),
            order=self._order(block, job, names, int(slot)) if kind == "job" else None,
            into=into,
            status=status,
            id=number,
        )

    def _order(self, block: CompiledBlock, job: CompiledJob, names: Names, slot: int) -> Order:
        kind: OrderKind = "report"
        moved, own = job.report, job.report
        if block.read is not None:
            kind, moved, own = "read", block.read, block.into
        elif block.write is not None:
            kind, moved, own = "write", block.write, block.source
        assert moved is not None and own is not None
        there = moved.on(names)
        every, late, times = (0 if one is None else int(one(names)) for one in (job.every, job.late, job.times))
        return Order(
            slot=slot,
            kind=kind,
            place=self._own(own, names),
            remote="" if kind == "report" else str(there["text"]),
            unit=there.get("unit"),
            count=int(there.get("count", 1)),
            host="" if job.host is None else str(job.host(names)),
            params={name: value(names) for name, value in block.params.items()},
            period=every,
            late=late,
            times=times,
        )

    def _own(self, place: CompiledPlace, names: Names) -> OwnPlace:
        given = place.on(names)
        return self._place({name: value for name, value in given.items() if name not in ("unit", "count")}, 1)

    def _place(self, given: dict[str, Any], bits: int) -> OwnPlace:
        """Return a place of the own memory that has room for so many bits. Raise DeviceMemoryError."""
        span = self.blocks.own_span(given)
        span = self.blocks.own_span({**given, "count": -(-bits // unit_bits(span.unit))})
        self.blocks.areas.check(span, write=False)
        return OwnPlace(address=Address(span.memory, span.unit, span.start), text=str(given.get("text", span.memory)))
