"""Job profiles: how many slots a family of devices has, its limits, where its status bits stand and what its codes are.

A profile is the content of a file `NAME.jobs.yaml`. How a job runs is not known here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

from framekit.codec.shown import code_text
from framekit.definition.expression import Expression
from framekit.definition.problems import Position


class CodeClass(Enum):
    """What becomes of a job whose transfer ends with a code."""

    GOOD = "good"
    TRANSIENT = "transient"
    """It goes on."""
    RESOURCE = "resource"
    """It goes on, and something was short: shown for a while by a bit of its own."""
    SYNTAX = "syntax"
    """It never began."""
    FATAL = "fatal"
    """It ends."""


class AfterLate(Enum):
    """When the next transfer starts after one that took longer than its period."""

    NEXT_PERIOD = "next_period"
    AT_ONCE = "at_once"


@dataclass(frozen=True, slots=True)
class Minor:
    """What the high byte of a word adds to its low byte; `kind` None: as the low byte says."""

    text: str
    kind: CodeClass | None = None


@dataclass(frozen=True, slots=True)
class Major:
    """What the low byte of a word says, and its minor codes by their numbers."""

    text: str
    kind: CodeClass
    minors: Mapping[int, Minor] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class TimeUnit:
    """A unit in which periods are counted: how long one is (ns), and how many there may be."""

    time: int
    most: int


@dataclass(frozen=True, slots=True, kw_only=True)
class StatusBits:
    """Which bit of the status area shows what; bits count from 1, 0 is none. `done` and `error`: first and step."""

    size: int
    any_error: int
    network: int
    resource: int
    ready: int
    done: tuple[int, int]
    error: tuple[int, int]


@dataclass(frozen=True, slots=True, kw_only=True)
class JobOutcome:
    """How a transfer can end badly: its word, and whether an exchange was completed all the same.

    `word` is an expression over `code`, the device's own code.
    """

    word: Expression
    completed: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class EventCode:
    """The number of an event in the log and what stands beside it."""

    number: int
    entries: tuple[int, ...] = ()


WORDS = (
    "good", "late", "period", "replaced", "no_slot", "unknown_host", "no_resolver", "no_channel", "not_connected",
    "connect_timeout", "closed", "no_word", "no_place", "unsupported",
)  # fmt: skip
"""The words a profile gives: what a command is answered with, beside the outcomes of transfers."""

OTHERWISE = "otherwise"
"""The outcome that stands for those a profile does not name."""


@dataclass(frozen=True, slots=True, kw_only=True)
class JobProfile:
    """Everything a profile says. Times in nanoseconds.

    `commands` may come in a scan. `connect`: how long the first connection may take. `pause`: after a word whose low
    byte is in `pause_after` the next transfer waits at least so long. `late_unit` and `late_most` limit how a time-out
    is given. `late_again`: a late transfer is told again with every further period.
    """

    name: str
    about: str
    source: str
    first: int
    last: int
    commands: int
    scan: int
    log: int
    connect: int
    pause: int
    pause_after: frozenset[int]
    units: Mapping[int, TimeUnit]
    late_unit: int
    late_most: int
    lengths: Mapping[str, int]
    after_late: AfterLate
    late_again: bool
    bits: StatusBits
    words: Mapping[str, int]
    outcomes: Mapping[str, JobOutcome]
    codes: Mapping[int, Major]
    events: Mapping[str, EventCode]
    at: Position

    @property
    def slots(self) -> range:
        """The numbers of the slots."""
        return range(self.first, self.last + 1)

    def kind_of(self, word: int) -> CodeClass:
        """What becomes of a job with this word; what no code says ends it."""
        major = self.codes.get(word & 0xFF)
        if major is None:
            return CodeClass.FATAL
        minor = major.minors.get(word >> 8)
        return major.kind if minor is None or minor.kind is None else minor.kind

    def text_of(self, word: int) -> str:
        """A word by name; empty for 0, which nothing ever answers."""
        if word == 0:
            return ""
        major = self.codes.get(word & 0xFF)
        if major is None:
            return "unknown code"
        minor = major.minors.get(word >> 8)
        if minor is not None:
            return f"{major.text}: {minor.text}"
        return major.text if word < 0x100 else f"{major.text}, {code_text(word >> 8, 2)}"

    def misfit_period(self, period: int) -> str | None:
        """Why a period cannot be counted in any of the units; None when it can."""
        if period == 0 or any(
            period % unit.time == 0 and period // unit.time <= unit.most for unit in self.units.values()
        ):
            return None
        least = min(unit.time for unit in self.units.values())
        return "is no multiple" if period % least else "is too long"
