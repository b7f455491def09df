"""How a run is doing at one moment: its channels, blocks, jobs and sinks, as frozen values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from framekit.codec.shown import code_text
from framekit.run.block_state import BlockStatus
from framekit.run.edit import RemovedBlocks
from framekit.run.model import EventCode
from framekit.run.trouble import Trouble

USER_DEFINED = "user-defined"
"""The displayed driver of a protocol that has frames only."""


@dataclass(slots=True)
class JobCounters:
    """The counts of a slot since the start of the run."""

    established: int = 0
    good: int = 0
    refused: int = 0
    late: int = 0
    over_period: int = 0
    ended: int = 0

    @property
    def completed(self) -> int:
        """Return the number of completed transfers: good and refused ones."""
        return self.good + self.refused


@dataclass(frozen=True, slots=True, kw_only=True)
class IrregularEvent:
    """An irregular event of the table."""

    at: int
    """The time of the event (ns)."""
    name: str
    slot: int | None
    """The slot, or None if the event belongs to no slot."""
    word: int
    """The code of the event; 0 if it has no code."""
    text: str
    code: EventCode | None = None
    """The number of the event in the profile, if it has one."""

    def __str__(self) -> str:
        """Return the event in words, with its time."""
        return f"{self.at / 1e9:.3f} s {self.what}"

    @property
    def what(self) -> str:
        """Return the event in words, without its time."""
        slot = "" if self.slot is None else f" slot {self.slot}"
        number = "" if self.code is None else f" event {code_text(self.code.number, 2)}" + "".join(
            f" {code_text(entry)}" for entry in self.code.entries
        )  # fmt: skip
        word = f" {code_text(self.word)} {self.text}" if self.word else ""
        return f"{self.name}{slot}{number}{word}"


@dataclass(slots=True)
class TableCounters:
    """The counts of commands since the start."""

    taken: int = 0
    lost: int = 0
    """Commands beyond the limit of a scan, and commands to a stopped table."""
    faults: int = 0
    """Words that are not a command, and commands whose status word has no place."""
    refused: int = 0
    kinds: dict[str, int] = field(default_factory=dict)
    """The numbers of taken commands by kind."""


@dataclass(frozen=True, slots=True, kw_only=True)
class JobStatus:
    """The state of a slot: type and state of its job, last code and error, counters, both ends of the transfer."""

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


@dataclass(frozen=True, slots=True, kw_only=True)
class ChannelStatus:
    """A channel: its module information and its service status.

    `driver`: protocol and role, or user-defined; `line`: speed and format, '' on connections; `line_type`:
    kind of interface and half duplex, '' if not given; `mode`: run or stop;
    `state`: open, or why not. `services` and `errors` count exchanges that ended, of blocks and of jobs, and requests
    that were served here; `reasons` the errors by outcome.
    `frames_in` counts good frames, `bad` damaged ones, `noise_bytes` bytes outside of frames. `load`: the part of the
    time that the line was busy, None without a speed.
    """

    number: int
    port: str
    driver: str
    role: str | None
    station: Any
    line: str
    line_type: str
    mode: str
    state: str
    blocks: int
    services: int
    errors: int
    reasons: Mapping[str, int]
    frames_in: int
    bad: int
    noise_bytes: int
    late: int
    """Replies that came after their exchange was over, or after its request was repeated."""
    repeated: int
    """Requests sent once more."""
    slow: tuple[str, ...]
    """Stations that answer after the time limit, and what to set."""
    bytes_in: int
    bytes_out: int
    load: float | None
    reopenings: int
    step: str = "in step"
    """`in step`; `holding` while late replies are awaited; `out of step` while replies are believed only with care."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StationStatus:
    """A station that blocks of a channel exchange frames with."""

    channel: int
    station: Any
    blocks: int
    """The number of its blocks."""
    done: int
    failed: int
    """How often exchanges with it succeeded and failed."""
    dead: bool
    """Whether it is given up for now."""
    answers: bool
    """Whether it answered in the last exchange with it, also with a refusal."""


@dataclass(frozen=True, slots=True, kw_only=True)
class JobsStatus:
    """The jobs of a run: their slots, the last events, oldest first, of `events` there were, and counted commands."""

    slots: tuple[JobStatus, ...]
    log: tuple[IrregularEvent, ...]
    events: int
    counters: TableCounters


@dataclass(frozen=True, slots=True, kw_only=True)
class SinkStatus:
    """A sink: its kind and target, the numbers of taken, waiting and dropped samples, and its present problem."""

    kind: str
    target: str
    written: int
    waiting: int
    dropped: int
    problem: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class RunStatus:
    """Everything at one moment; `at` is in nanoseconds of the run's clock. `jobs`: None where the run has none.

    `removed`: what blocks counted that edits took out; the channels' totals have it too.
    """

    run: str
    at: int
    running: bool
    channels: tuple[ChannelStatus, ...]
    blocks: tuple[BlockStatus, ...]
    jobs: JobsStatus | None = None
    removed: tuple[RemovedBlocks, ...] = ()
    sinks: tuple[SinkStatus, ...] = ()
    stations: tuple[StationStatus, ...] = ()
    troubles: tuple[Trouble, ...] = ()
    """The parts that fail now or have lost data."""
