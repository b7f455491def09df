"""The job table: commands establish, abort and inspect jobs; each repeats its transfer until it is done, or fails.

Sans-I/O: the owner tells the time, finds connections and does the transfers. What a transfer brings comes in this
order: its data, the status word of the command (once), the status bits. Numbers, limits and codes are the profile's.
"""

from __future__ import annotations

from collections.abc import Container

from framekit.blocks.block_status import Failure
from framekit.blocks.jobs.answers import CommandLimit
from framekit.blocks.jobs.diagnosis import JobStatus, TableCounters, status_of
from framekit.blocks.jobs.order import Command
from framekit.blocks.jobs.owner import JobOwner
from framekit.blocks.jobs.profile import CodeClass, JobProfile
from framekit.blocks.jobs.slot import Attempt, Slot, State
from framekit.blocks.jobs.transfers import JobTransfers
from framekit.definition.times import NEVER


class JobTable(JobTransfers):
    """The jobs of a run. `scan`: how often bits are shown (ns), if not as the profile says."""

    def __init__(self, profile: JobProfile, owner: JobOwner, scan: int | None = None) -> None:
        super().__init__(profile, owner, scan)
        self._limit = CommandLimit(profile.commands, self.scan, 0)
        self.running = False

    # ---- life ---------------------------------------------------------------------------------------------

    def start(self, now: int) -> None:
        """Commands are taken from now on; everything is as if nothing had happened before."""
        self.running = True
        self._limit = CommandLimit(self.profile.commands, self.scan, now)
        for number in self.slots:
            self.slots[number] = Slot(number)
        self.image.start(now)

    def stop(self) -> None:
        """All jobs are aborted, and no command is taken; bits are 0, codes stay to be looked at."""
        self.running = False
        for slot in self.slots.values():
            slot.rest()
            slot.error = False
            asked, slot.asked = slot.asked, None
            if asked is not None:
                self.owner.answered(asked, None)
        self.image.stop()

    def reset(self, now: int) -> None:
        """As after the start, with counters at 0."""
        self.stop()
        self.counters = TableCounters()
        self.start(now)

    def status(self) -> list[JobStatus]:
        """How every slot is doing."""
        return [status_of(slot, self.profile) for slot in self.slots.values()]

    # ---- commands -----------------------------------------------------------------------------------------

    def take(self, command: Command, now: int, refusal: int = 0) -> None:
        """Carries a command out, or answers why not; `refusal` is the answer to one that is known to be wrong.

        One too many in a scan is lost, and never answered.
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
        """Ends the jobs that these have established, as an abort does; nobody waits for answers any more."""
        for slot in self.slots.values():
            if slot.by in givers and slot.active:
                self._clear([slot.number], now)

    def room_at(self, now: int) -> int:
        """When one more command can be taken: now, or with the next scan."""
        return self._limit.room_at(now)

    def fault(self, now: int, *, has_place: bool) -> None:
        """Notes words that are no command, or one whose status word has no place: nothing else tells of it."""
        self.counters.faults += 1
        self.log.add("fault", now, None, 0 if has_place else self.profile.words["no_place"])

    def refuse(self, command: Command, word: int, now: int) -> None:
        """Answers a command that is wrong; nothing else happens."""
        self.counters.refused += 1
        self.log.add("refused", now, command.slot, word)
        self._answer(command, word, now)

    def _inspect(self, command: Command, slot: Slot, now: int) -> None:
        """The detail words first, then the answer; bits stay as they are."""
        word = self.profile.words["good"]
        if command.into is not None and not self.owner.write_words(command.into, slot.details):
            word, _ = self._failures.word_of(Failure(outcome="cannot_store"))
        self._answer(command, word, now)

    def _clear(self, numbers: list[int], now: int) -> None:
        """Ends jobs at once: their bits and codes are 0. A command that still waits is told that it was replaced."""
        for number in numbers:
            slot = self.slots[number]
            slot.rest()
            slot.word, slot.error = 0, False
        self.image.clear(numbers)
        for number in numbers:
            self._tell(self.slots[number], self.profile.words["replaced"], now)

    def _establish(self, command: Command, slot: Slot, now: int) -> None:
        order = command.order
        assert order is not None
        if order.kind == "report":
            self.refuse(command, self.profile.words["unsupported"], now)
            return
        self._clear([slot.number], now)
        slot.order, slot.asked, slot.by, slot.left = order, command, command.id, order.times
        slot.counters.established += 1
        slot.state = State.CONNECTING
        slot.origin = slot.boundary = slot.started = now
        slot.connect_by = now + self.profile.connect
        slot.watch_lateness(self.profile.after_late, now)
        slot.attempt = attempt = Attempt(slot.number, order)
        self.owner.connect(attempt)

    # ---- connections --------------------------------------------------------------------------------------

    def awaits(self, attempt: Attempt) -> bool:
        """Whether a connection is still wanted: not any more once its job has ended, or another one took its slot."""
        slot = self.slots[attempt.slot]
        return slot.attempt is attempt and slot.state is State.CONNECTING

    def connected(self, attempt: Attempt, now: int) -> None:
        """There is a way to the host: the first transfer begins."""
        slot = self.slots[attempt.slot]
        if self.awaits(attempt):
            slot.connect_by = NEVER
            self._begin(slot)

    def not_connected(self, attempt: Attempt, reason: str, now: int) -> None:
        """There is none; `reason` is one of the profile's words. The job ends before it has begun.

        Its error bit stays as it is: that is for errors of jobs that were under way.
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
        """The connection of a job is gone: it ends, whatever it was doing."""
        slot = self.slots[number]
        if slot.active and slot.state is not State.CONNECTING:
            self._settle(slot, self.profile.words["closed"], False, now)
            self._watched(slot, Failure(outcome="closed"))

    def set_network(self, on: bool, now: int) -> None:
        """Whether the network can be used at all."""
        if on != self.image.network and self.running:
            self.image.set_network(on, now)

    # ---- time ---------------------------------------------------------------------------------------------

    @property
    def deadline(self) -> int:
        """When `tick` has something to do."""
        if not self.running:
            return NEVER
        return min(self.image.deadline, *(slot.deadline for slot in self.slots.values()))

    def tick(self, now: int) -> None:
        """Does what is due, in the order of its times; then shows the bits of the scan."""
        while self.running:
            slot = min(self.slots.values(), key=lambda one: one.deadline)
            if slot.deadline > now:
                break
            self._due(slot, now)
        if self.running:
            self.image.tick(now)

    def _due(self, slot: Slot, now: int) -> None:
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

    def _late(self, slot: Slot, word: int, now: int) -> None:
        """The transfer takes too long; it stays pending, and may still end well."""
        slot.was_late = True
        if self._tell(slot, word, now):
            self._show(slot, word, True, now)
            self._watched(slot, Failure(outcome="late"))
        elif slot.state is State.CONNECTING and slot.attempt is not None:
            self.not_connected(slot.attempt, "no_word", now)
        else:
            self._settle(slot, self.profile.words["no_word"], False, now)

    def _start(self, slot: Slot, now: int) -> None:
        """The time of a transfer has come; a clock that is late does not move the periods."""
        slot.enter_period(now)
        slot.watch_lateness(self.profile.after_late, now)
        self._begin(slot)
