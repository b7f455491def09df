"""The transfers of jobs: begun, settled, shown in words and bits, and waited for until the next one.

Sans-I/O. Commands and the passing of time are the table's; here is what they have in common.
"""

from __future__ import annotations

from framekit.blocks.block_status import Failure
from framekit.blocks.jobs.answers import FailureWords
from framekit.blocks.jobs.diagnosis import EventLog, TableCounters, status_of
from framekit.blocks.jobs.order import Command
from framekit.blocks.jobs.owner import JobOwner, Store, Watcher
from framekit.blocks.jobs.profile import CodeClass, JobProfile
from framekit.blocks.jobs.slot import Attempt, Slot, State
from framekit.blocks.jobs.status_image import StatusImage
from framekit.definition.times import NEVER

LEAST_TIME = 1_000_000
"""A transfer that ends at the very moment it began is followed by the next one 1 ms later: nobody is stopped by it."""


class JobTransfers:
    """What the jobs of a run are doing: their slots, and what they show. `scan`: how often bits are shown (ns)."""

    def __init__(self, profile: JobProfile, owner: JobOwner, scan: int | None) -> None:
        self.profile = profile
        self.owner = owner
        self.scan = scan or profile.scan
        self.slots = {number: Slot(number) for number in profile.slots}
        self.image = StatusImage(profile.bits, profile.slots, self.scan, owner.write_bits)
        self.log = EventLog(profile)
        self.counters = TableCounters()
        self._failures = FailureWords(profile)
        self.watcher: Watcher | None = None

    def _begin(self, slot: Slot) -> None:
        assert slot.order is not None
        slot.state = State.TRANSFERRING
        slot.start_at = NEVER
        slot.attempt = attempt = Attempt(slot.number, slot.order)
        self.owner.begin(attempt)

    def ended(self, attempt: Attempt, failure: Failure | None, now: int, store: Store | None = None) -> None:
        """A transfer is over. `store` puts its data in place, unless nobody waits for it any more."""
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

    def _watched(self, slot: Slot, failure: Failure | None) -> None:
        if self.watcher is not None:
            self.watcher(status_of(slot, self.profile), failure)

    def _settle(self, slot: Slot, word: int, completed: bool, now: int) -> None:
        """What came of a transfer: status word, bits, detail words; then the job waits, or is over."""
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

    def _wait(self, slot: Slot, word: int, now: int) -> None:
        """The next transfer starts at the beginning of a period, or as soon as it may."""
        slot.state = State.WAITING
        start = slot.next_start(self.profile.after_late, now)
        if word & 0xFF in self.profile.pause_after:
            start = max(start, now + self.profile.pause)
        slot.start_at = max(start, now + LEAST_TIME) if now == slot.started else start

    def _tell(self, slot: Slot, word: int, now: int) -> bool:
        """Answers the command that waits for it, once; whether the word could be written."""
        asked, slot.asked = slot.asked, None
        return asked is None or self._answer(asked, word, now)

    def _show(self, slot: Slot, word: int, error: bool, now: int) -> None:
        if error and not slot.error:
            self.log.add("error", now, slot.number, word)
        if error:
            slot.last_error = now
        slot.word, slot.error = word, error
        self.image.set_error(slot.number, error, now)

    def _answer(self, command: Command, word: int, now: int) -> bool:
        """Writes the status word; whether that could be done."""
        written = command.status is None or self.owner.write_words(command.status, (word,))
        if not written:
            word = self.profile.words["no_word"]
            self.log.add("error", now, command.slot, word)
        self.owner.answered(command, word)
        return written
