"""How jobs are doing: a slot with its job and its transfers so far, events and counters, the status bits."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from enum import Enum

from framekit.definition.times import NEVER
from framekit.link.codes import code_text
from framekit.run.job_profile import AfterLate, EventCode, JobProfile, StatusBits
from framekit.run.model import JobCommand, Order


class JobState(Enum):
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
class JobSlot:
    """A slot. `word`: the last code; `asked`: the command that has no answer yet; `attempt`: what is under way.

    `by`: who gave the command that established its job.

    `origin` is when the job began, `boundary` the beginning of the period it is in; times that are not awaited are
    NEVER. `last_good` and `last_error` are times, None before the first.
    """

    number: int
    state: JobState = JobState.IDLE
    order: Order | None = None
    asked: JobCommand | None = None
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
        return self.state is not JobState.IDLE

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
        self.state = JobState.IDLE
        self.attempt = None
        self.start_at = self.period_at = self.late_at = self.connect_by = NEVER

    @property
    def details(self) -> tuple[int, int]:
        """The two detail words: the last code, and 1 while a job is active."""
        return self.word, int(self.active)


@dataclass(frozen=True, slots=True, kw_only=True)
class Event:
    """Something that was not as it should be: when (ns), what, in which slot (None: in none), with which word.

    `code`: the profile's number for it, where it has one.
    """

    at: int
    name: str
    slot: int | None
    word: int
    text: str
    code: EventCode | None = None

    def __str__(self) -> str:
        """In words, with its time."""
        return f"{self.at / 1e9:.3f} s {self.what}"

    @property
    def what(self) -> str:
        """In words, without its time."""
        slot = "" if self.slot is None else f" slot {self.slot}"
        number = "" if self.code is None else f" event {code_text(self.code.number, 2)}" + "".join(
            f" {code_text(entry)}" for entry in self.code.entries
        )  # fmt: skip
        word = f" {code_text(self.word)} {self.text}" if self.word else ""
        return f"{self.name}{slot}{number}{word}"


class EventLog:
    """The last events, oldest first; `total` counts all there were."""

    def __init__(self, profile: JobProfile) -> None:
        self._profile = profile
        self._events: deque[Event] = deque(maxlen=profile.log)
        self.total = 0

    def add(self, name: str, at: int, slot: int | None = None, word: int = 0) -> None:
        """Keeps an event; the oldest one is forgotten when there are too many."""
        self.total += 1
        text, code = self._profile.text_of(word), self._profile.events.get(name)
        self._events.append(Event(at=at, name=name, slot=slot, word=word, text=text, code=code))

    def __iter__(self) -> Iterator[Event]:
        return iter(tuple(self._events))

    def __len__(self) -> int:
        return len(self._events)


@dataclass(slots=True)
class TableCounters:
    """Commands since the start: those taken, lost (too many in a scan), refused; by kind those carried out.

    `faults`: words that were no command, or one whose status word has no place.
    """

    taken: int = 0
    lost: int = 0
    faults: int = 0
    refused: int = 0
    kinds: dict[str, int] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class JobStatus:
    """How a slot is doing: type and state, its detail words and bits, its counters, what goes where."""

    slot: int
    kind: str
    state: str
    word: int
    text: str
    error: bool
    pending: bool
    counters: JobCounters
    remote: str = ""
    own: str = ""
    count: int = 0
    host: str = ""
    period: int = 0
    left: int | None = None
    last_good: int | None = None
    last_error: int | None = None


def status_of(slot: JobSlot, profile: JobProfile) -> JobStatus:
    """A view for a moment; an idle slot shows the job it had last."""
    order = slot.order
    common = {
        "slot": slot.number,
        "state": slot.state.value,
        "word": slot.word,
        "text": profile.text_of(slot.word),
        "error": slot.error,
        "pending": slot.asked is not None,
        "counters": slot.counters,
        "last_good": slot.last_good,
        "last_error": slot.last_error,
    }
    if order is None:
        return JobStatus(kind="", **common)  # type: ignore[arg-type]
    return JobStatus(
        kind=order.kind,
        remote=order.remote,
        own=order.place.text,
        count=order.count,
        host=order.host or ("" if order.channel is None else f"channel {order.channel}"),
        period=order.period,
        left=slot.left if order.times else None,
        **common,  # type: ignore[arg-type]
    )


WriteBits = Callable[[tuple[int, ...]], None]


class StatusImage:
    """The bits of `slots`; `write` gets all of them whenever one has changed. `scan` in nanoseconds."""

    def __init__(self, layout: StatusBits, slots: range, scan: int, write: WriteBits) -> None:
        self.layout = layout
        self.slots = slots
        self.scan = scan
        self._write = write
        self.ready = False
        self.network = True
        self.resource = False
        self._done: set[int] = set()
        self._pulsing: set[int] = set()
        self._errors: set[int] = set()
        self._shown: tuple[int, ...] = (0,) * layout.size
        self._origin = 0
        self._due = NEVER

    # ---- what happens -------------------------------------------------------------------------------------

    def start(self, now: int) -> None:
        """Scans count from here; everything is 0 until the first one."""
        self._origin = now
        self.ready, self.network, self.resource = True, True, False
        self._forget(self.slots)
        self._touch(now)

    def stop(self) -> None:
        """All bits are 0, at once."""
        self.ready = self.network = self.resource = False
        self._forget(self.slots)
        self._due = NEVER
        self._show((0,) * self.layout.size)

    def completed(self, slot: int, now: int) -> None:
        """A transfer is over, well or not: one pulse, with the next scan."""
        self._done.add(slot)
        self._touch(now)

    def set_error(self, slot: int, on: bool, now: int) -> None:
        """Whether a slot shows an error, from the next scan on."""
        (self._errors.add if on else self._errors.discard)(slot)
        self._touch(now)

    def set_network(self, on: bool, now: int) -> None:
        """Whether the network can be used."""
        self.network = on
        self._touch(now)

    def short(self, now: int) -> None:
        """Something was short: one scan long."""
        self.resource = True
        self._touch(now)

    def clear(self, slots: Iterable[int]) -> None:
        """The bits of these slots are 0, at once."""
        self._forget(slots)
        bits = list(self._shown)
        for slot in slots:
            for first, step in (self.layout.done, self.layout.error):
                bits[first + step * (slot - self.slots.start) - 1] = 0
        if self.layout.any_error:
            shown = (self.layout.error[0] + self.layout.error[1] * index - 1 for index in range(len(self.slots)))
            bits[self.layout.any_error - 1] = int(any(bits[place] for place in shown))
        self._show(tuple(bits))

    def _forget(self, slots: Iterable[int]) -> None:
        for slot in slots:
            for group in (self._done, self._pulsing, self._errors):
                group.discard(slot)

    # ---- scans --------------------------------------------------------------------------------------------

    @property
    def deadline(self) -> int:
        """When `tick` has something to show."""
        return self._due

    def tick(self, now: int) -> None:
        """Shows what has happened, when a scan has begun."""
        if self._due > now:
            return
        self._due = NEVER
        self._pulsing, rising = set(), self._done - self._pulsing
        self._pulsing |= rising
        self._done -= rising
        self._show(self._bits())
        if self._pulsing or self._done or self.resource:
            self._touch(now)
        self.resource = False

    def _touch(self, now: int) -> None:
        """The next scan that begins after `now` shows it."""
        if self._due == NEVER:
            self._due = self._origin + ((now - self._origin) // self.scan + 1) * self.scan

    def _bits(self) -> tuple[int, ...]:
        bits = [0] * (self.layout.size + 1)
        bits[self.layout.any_error] = int(bool(self._errors))
        bits[self.layout.network] = int(self.network)
        bits[self.layout.resource] = int(self.resource)
        bits[self.layout.ready] = int(self.ready)
        for group, (first, step) in ((self._pulsing, self.layout.done), (self._errors, self.layout.error)):
            for slot in group:
                bits[first + step * (slot - self.slots.start)] = 1
        return tuple(bits[1:])

    def _show(self, bits: tuple[int, ...]) -> None:
        if bits != self._shown:
            self._shown = bits
            self._write(bits)
