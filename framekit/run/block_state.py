"""The state of a block at work: counters, last failure, trigger state, and the frozen status made from them.

All protocols share the table of failure codes, `error_codes.csv`.
"""

from __future__ import annotations

import csv
import enum
from collections import Counter
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Protocol, TypeAlias

from framekit.codec.shown import code_text
from framekit.link.services.client import TransferResult
from framekit.run.model import STATIONED, Block, block_id, block_label
from framekit.run.triggers import ArmedTriggers, Every

TABLE = Path(__file__).with_name("error_codes.csv")
FIRST_OWN = 0xFF00
"""Codes from this value on are framekit's own; codes below it are the codes of devices."""


class ErrorCode(enum.IntEnum):
    """framekit's code of each way an exchange can fail; the table has its meaning and its remedy."""

    NONE = 0
    NO_REPLY = 0xFF01
    TIMEOUT = 0xFF02
    DAMAGED_REPLY = 0xFF03
    UNFIT_REPLY = 0xFF04
    EXHAUSTED = 0xFF05
    DAMAGED_FRAME = 0xFF06
    LATE_REPLIES = 0xFF07
    REFUSED = 0xFF10
    CLOSED = 0xFF20
    CANCELLED = 0xFF21
    ABANDONED = 0xFF22
    NO_SEQUENCE = 0xFF23
    QUEUE_FULL = 0xFF24
    EXPRESSION = 0xFF25
    CIRCLE = 0xFF26
    CANNOT_STORE = 0xFF30
    CANNOT_SEND = 0xFF31
    BAD_SETTING = 0xFF32
    NOT_ALLOWED = 0xFF33
    DEAD = 0xFF40
    INTERRUPTED = 0xFF41
    FAILED = 0xFFFF


@dataclass(frozen=True, slots=True)
class ErrorMeaning:
    """A row of the table: code, name of the outcome, meaning, remedy."""

    code: ErrorCode
    name: str
    meaning: str
    advice: str


@cache
def error_table() -> Mapping[str, ErrorMeaning]:
    """Return the rows of the table by the name of the outcome, in the order of their codes."""
    with TABLE.open(encoding="utf-8", newline="") as file:
        rows = [
            ErrorMeaning(ErrorCode(int(row["code"], 16)), row["name"], row["meaning"], row["advice"])
            for row in csv.DictReader(file)
        ]
    return MappingProxyType({row.name: row for row in rows})


def error_code(outcome: str) -> ErrorCode:
    """Return framekit's code of an outcome: `NONE` for '' (success), `FAILED` for an outcome that a protocol names."""
    if not outcome:
        return ErrorCode.NONE
    row = error_table().get(outcome)
    return ErrorCode.FAILED if row is None else row.code


def status_word(outcome: str, device_code: int | None) -> int:
    """Return the value of STATUS: the error code of the device if it has one in the range of devices, else framekit's.

    Device codes of 0 or below, and from FF00 on, would be read with another meaning: they are shown as `REFUSED`.
    """
    if outcome and device_code is not None:
        return device_code if 0 < device_code < FIRST_OWN else ErrorCode.REFUSED
    return error_code(outcome)


@dataclass(frozen=True, slots=True, kw_only=True)
class Failure:
    """The failure of an exchange."""

    outcome: str
    """Name: `no_reply`, `refused`, …"""
    cause: str = ""
    """Details in words."""
    device_code: int | None = None
    """Error code of a refusal by the device."""
    meaning: str = ""
    """Name of this code in the protocol."""
    at: int = 0
    """Time, in nanoseconds of the run's clock."""

    def __str__(self) -> str:
        """Return the outcome, the device's code, and the reason if it adds information."""
        code = "" if self.device_code is None else f" {code_text(self.device_code)}"
        reason, known = self.meaning or self.cause, error_table().get(self.outcome)
        says_more = reason and not (known is not None and known.meaning.startswith(reason))
        return f"{self.outcome}{code}" + (f": {reason}" if says_more else "")

    @property
    def error(self) -> int:
        """Return the value of STATUS (see `status_word`)."""
        return status_word(self.outcome, self.device_code)

    @property
    def reason(self) -> ErrorCode:
        """Return framekit's code, also for a failure with a device code."""
        return error_code(self.outcome)


@dataclass(frozen=True, slots=True, kw_only=True)
class BlockStatus:
    """A block's state and counters; started = done + failed + (1 if running). Sets count from 1, blocks from 0."""

    set: int
    block: int
    name: str = ""
    instruction: str = ""
    channel: int = 0
    enabled: bool = True
    waiting: bool = False
    started: int = 0
    done: int = 0
    failed: int = 0
    overruns: int = 0
    dead: bool = False
    last_failure: Failure | None = None
    """Stays after a normal completion, as STATUS does (Snet module guide, status flags)."""
    last_end: int | None = None
    """End of the last exchange, in nanoseconds of the run's clock; None before the first end."""

    @property
    def id(self) -> int:
        """Return the number of the block among all sets."""
        return block_id(self.set, self.block)

    @property
    def label(self) -> str:
        """Return the name of the block in messages: set and number."""
        return block_label(self.set, self.block)

    @property
    def running(self) -> bool:
        return self.started > self.done + self.failed

    @property
    def error(self) -> int:
        """Return STATUS: the code of the last abnormal completion, 0 before the first."""
        return 0 if self.last_failure is None else self.last_failure.error

    @property
    def reason(self) -> ErrorCode:
        """Return framekit's code of the last abnormal completion."""
        return ErrorCode.NONE if self.last_failure is None else self.last_failure.reason

    @property
    def device_code(self) -> int | None:
        """Return the device's code of the last abnormal completion; None without a device code."""
        return None if self.last_failure is None else self.last_failure.device_code


Shown: TypeAlias = "BlockStatus | BlockState"
"""The source of the status words of a block."""

ITEMS: Mapping[str, str] = MappingProxyType(
    {
        "error": "(0 if block.last_failure is None else block.last_failure.error)",
        "reason": "(0 if block.last_failure is None else block.last_failure.reason)",
        "device_code": "(0 if block.last_failure is None else block.last_failure.device_code or 0)",
        "started_count": "block.started",
        "done_count": "block.done",
        "failed_count": "block.failed",
        "overrun_count": "block.overruns",
        "enabled": "block.enabled",
        "waiting": "block.waiting",
        "running": "block.running",
        "dead": "block.dead",
    }
)
"""The items of the status words of a block, by their names in memory profiles: expressions on a block."""

PULSES = ("done", "failed")
"""Bits that are set at a normal and at an abnormal completion, and reset after the time of a pulse."""


def failure_of(result: TransferResult) -> Failure | None:
    """Return the failure of a transfer; None for a success."""
    if result.ok:
        return None
    outcome = result.outcome or "failed"
    return Failure(outcome=outcome, cause=result.cause, device_code=result.code, meaning=result.meaning)


class Settings(Protocol):
    """The settings of a block in memory."""

    holds: Callable[[], bool]
    """Return whether the memory still has the settings of the run file."""


class Starter(Protocol):
    """Starts the exchanges of a block."""

    block: Block

    def go(self, now: int) -> None:
        """Begin an exchange."""


class BlockState:
    """The state and the counters of a block at work."""

    __slots__ = (
        "armed", "at_station", "block", "chain", "companions", "dead", "done", "effective", "failed", "given",
        "has_station", "id", "key", "lane", "last_end", "last_failure", "overruns", "period", "probing",
        "reasons", "round", "running", "set_on", "started", "started_at", "starts", "starts_left", "switched_on",
        "took", "waiting",
    )  # fmt: skip

    def __init__(self, block: Block) -> None:
        self.block = block
        self.id = block.id
        self.key = block.set, block.number
        self.has_station = block.instruction in STATIONED
        self.lane = block.lane
        """Number of the lane in which it waits."""
        self.period = min((trigger.period for trigger in block.triggers if isinstance(trigger, Every)), default=0)
        """Shortest period of its `every` triggers (ns); 0 without such triggers."""
        self.chain: tuple[int, ...] = ()
        """Ids of the blocks that made it due, one after the other, each with an end during its own start."""
        self.given: Sequence[Settings] = ()
        """Its settings in memory."""
        self.effective: Block | None = None
        """The block with these settings, from the request for its station to its start."""
        self.at_station: tuple[Hashable] | None = None
        """The station in the run file, if the run file names the station."""
        self.starts: Starter | None = None
        """Starts its exchanges while its channel stays, if they have no parameters of their own."""
        self.started = self.done = self.failed = 0
        self.overruns = 0
        """How often it came due while it was waiting or running."""
        self.switched_on = block.enabled
        """Whether the block itself is enabled."""
        self.set_on = True
        """Whether its set is enabled."""
        self.waiting = False
        self.starts_left = block.repeat
        self.armed: ArmedTriggers | None = None
        self.started_at = 0
        self.took = 0
        """Duration of the last exchange (ns)."""
        self.last_failure: Failure | None = None
        self.reasons: Counter[str] = Counter()
        """Number of failures, by outcome."""
        self.last_end: int | None = None
        self.companions: tuple[BlockState, ...] = ()
        """Blocks that get their data from the exchange of this block."""
        self.probing = False
        """Whether it asks a suspected or dead station."""
        self.running = False
        self.dead = False
        self.round = 0
        """How often it has been armed; timers of earlier rounds have no effect."""

    @property
    def enabled(self) -> bool:
        """Return whether it may come due: the block and its set are enabled."""
        return self.switched_on and self.set_on

    @property
    def ended_well(self) -> bool:
        """Return whether its last exchange was a success."""
        return self.last_end is not None and (self.last_failure is None or self.last_failure.at < self.last_end)

    def begun(self, now: int) -> None:
        """Count the start of an exchange."""
        self.waiting = False
        if self.starts_left is not None:
            self.starts_left -= 1
        self.started_at = now
        self.running = True
        self.started += 1

    def postponed(self) -> None:
        """Take back the start of an exchange that begins once more."""
        if self.starts_left is not None:
            self.starts_left += 1
        self.running = False
        self.started -= 1

    def ended(self, failure: Failure | None, now: int) -> None:
        """Count the end of an exchange, a success if `failure` is None."""
        self.running = False
        if failure is None:
            self.done += 1
        else:
            self.failed += 1
            self.reasons[failure.outcome] += 1
            self.last_failure = replace(failure, at=now)
        self.last_end, self.took = now, now - self.started_at

    def reset(self) -> None:
        """Set everything as at the start of the run; a running exchange stays counted."""
        self.started, self.done, self.failed, self.overruns = int(self.running), 0, 0, 0
        self.starts_left = self.block.repeat
        self.switched_on = self.block.enabled
        self.last_failure, self.last_end = None, None
        self.reasons.clear()
