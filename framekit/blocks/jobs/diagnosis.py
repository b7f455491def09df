"""What can be looked up about jobs: events that are kept, counters, and how every job is doing.

These are views and records; what happens is the table's business.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field

from framekit.blocks.jobs.profile import EventCode, JobProfile
from framekit.blocks.jobs.slot import JobCounters, Slot
from framekit.link.codes import code_text


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


def status_of(slot: Slot, profile: JobProfile) -> JobStatus:
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
