"""One slot of a job table: the job in it, the times it waits for, and what became of its transfers so far.

The slot only keeps; who changes it, and when, is the table's business.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum

from framekit.blocks.jobs.order import Command, Order
from framekit.blocks.jobs.profile import AfterLate
from framekit.definition.times import NEVER


class State(Enum):
    """What a job is doing."""

    IDLE = "idle"
    CONNECTING = "connecting"
    TRANSFERRING = "transferring"
    WAITING = "waiting"


@dataclass(frozen=True, slots=True, eq=False)
class Attempt:
    """A connection that is looked for, or a transfer under way; each is itself alone."""

    slot: int
    order: Order


@dataclass(slots=True)
class JobCounters:
    """Counted from the start of the run on. `completed` = good ones and refused ones."""

    established: int = 0
    good: int = 0
    refused: int = 0
    late: int = 0
    over_period: int = 0
    ended: int = 0

    @property
    def completed(self) -> int:
        return self.good + self.refused


@dataclass(slots=True)
class Slot:
    """A slot. `word`: the last code; `asked`: the command that has no answer yet; `attempt`: what is under way.

    `by`: who gave the command that established its job.

    `origin` is when the job began, `boundary` the beginning of the period it is in; times that are not awaited are
    NEVER. `last_good` and `last_error` are times, None before the first.
    """

    number: int
    state: State = State.IDLE
    order: Order | None = None
    asked: Command | None = None
    by: int | None = None
    attempt: Attempt | None = None
    word: int = 0
    error: bool = False
    left: int = 0
    origin: int = 0
    boundary: int = 0
    started: int = 0
    was_late: bool = False
    start_at: int = NEVER
    period_at: int = NEVER
    late_at: int = NEVER
    connect_by: int = NEVER
    last_good: int | None = None
    last_error: int | None = None
    counters: JobCounters = field(default_factory=JobCounters)

    @property
    def active(self) -> bool:
        return self.state is not State.IDLE

    @property
    def deadline(self) -> int:
        """When something is due here."""
        return min(self.start_at, self.period_at, self.late_at, self.connect_by)

    @property
    def period(self) -> int:
        """Of the job in it; 0 for transfers back to back."""
        return 0 if self.order is None else self.order.period

    def watch_lateness(self, after_late: AfterLate, now: int) -> None:
        """A transfer begins: when it is late. Where transfers start with periods, it must be over before the next."""
        self.was_late = False
        since = self.boundary if after_late is AfterLate.NEXT_PERIOD else now
        late = 0 if self.order is None else self.order.late
        self.period_at = since + self.period if self.period else NEVER
        self.late_at = now + late if late else NEVER

    def next_start(self, after_late: AfterLate, now: int) -> int:
        """When the next transfer starts after one that ended now: periods are counted from the beginning of the job."""
        if self.period == 0 or (self.was_late and after_late is AfterLate.AT_ONCE):
            return now
        periods = -((self.origin - now) // self.period)
        return max(self.boundary + self.period, self.origin + periods * self.period)

    def enter_period(self, now: int) -> None:
        """A transfer starts now; a clock that is late does not move the periods."""
        self.started = now
        self.boundary = self.origin + (now - self.origin) // self.period * self.period if self.period else now

    def rest(self) -> None:
        """Nothing runs here, and nothing is waited for; the last code stays."""
        self.state = State.IDLE
        self.attempt = None
        self.start_at = self.period_at = self.late_at = self.connect_by = NEVER

    @property
    def details(self) -> tuple[int, int]:
        """The two detail words: the last code, and 1 while a job is active."""
        return self.word, int(self.active)
