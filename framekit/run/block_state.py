"""A block at work: what the scheduler counts and remembers of it, and how it is doing, as one frozen value.

The codes that its failures have in memory are one table for all protocols, `error_codes.csv`.
"""

from __future__ import annotations

import csv
import enum
from collections import Counter
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, TypeAlias

from framekit.codec.shown import code_text
from framekit.link.services.client import TransferResult
from framekit.run.model import STATIONED, Block, block_id, block_label
from framekit.run.triggers import ArmedTriggers, Every

if TYPE_CHECKING:
    from framekit.run.block_words import Given
    from framekit.run.lanes import BlockLane
    from framekit.run.transfer import BlockStarts

TABLE = Path(__file__).with_name("error_codes.csv")
FIRST_OWN = 0xFF00
"""Words from here on are framekit's own; those below are the codes of devices."""


class ErrorCode(enum.IntEnum):
    """framekit's word for each way an exchange can fail; the table says what it means and what to do."""

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
    """A row of the table: the outcome's name, what it means, what to do."""

    code: ErrorCode
    name: str
    meaning: str
    advice: str


@cache
def error_table() -> Mapping[str, ErrorMeaning]:
    """The rows of the table by the name of the outcome, in the order of their codes."""
    with TABLE.open(encoding="utf-8", newline="") as file:
        rows = [
            ErrorMeaning(ErrorCode(int(row["code"], 16)), row["name"], row["meaning"], row["advice"])
            for row in csv.DictReader(file)
        ]
    return MappingProxyType({row.name: row for row in rows})


def error_code(outcome: str) -> ErrorCode:
    """framekit's code of an outcome; `NONE` for '' (all is well), `FAILED` for a name that a protocol gives itself."""
    if not outcome:
        return ErrorCode.NONE
    row = error_table().get(outcome)
    return ErrorCode.FAILED if row is None else row.code


def status_word(outcome: str, device_code: int | None) -> int:
    """What STATUS shows: the code the device refused with, where it is a word of its own, else framekit's.

    Codes of 0, negative ones and those from FF00 on are none of their own: they would be taken for something else.
    """
    if outcome and device_code is not None:
        return device_code if 0 < device_code < FIRST_OWN else ErrorCode.REFUSED
    return error_code(outcome)


@dataclass(frozen=True, slots=True, kw_only=True)
class Failure:
    """An exchange that did not end well.

    `outcome` is its name (`no_reply`, `refused`, …), `cause` more in words. `device_code` is what the device refused
    with, `meaning` the name that its protocol gives to that. `at`: when, in nanoseconds of the run's clock.
    """

    outcome: str
    cause: str = ""
    device_code: int | None = None
    meaning: str = ""
    at: int = 0

    def __str__(self) -> str:
        """In words: the outcome, the device's code, and the reason, where it says more than these do."""
        code = "" if self.device_code is None else f" {code_text(self.device_code)}"
        reason, known = self.meaning or self.cause, error_table().get(self.outcome)
        says_more = reason and not (known is not None and known.meaning.startswith(reason))
        return f"{self.outcome}{code}" + (f": {reason}" if says_more else "")

    @property
    def error(self) -> int:
        """The word STATUS shows: the device's own code where it gave one that fits, else framekit's."""
        return status_word(self.outcome, self.device_code)

    @property
    def reason(self) -> ErrorCode:
        """framekit's code, whatever the device said."""
        return error_code(self.outcome)


@dataclass(frozen=True, slots=True, kw_only=True)
class BlockStatus:
    """A block's state and counters; started = done + failed + (1 if running). Sets count from 1, blocks from 0.

    `last_failure` stays after a normal completion, as STATUS does (Snet module guide, status flags). `last_end`: when
    the last exchange ended, in nanoseconds of the run's clock; None before the first.
    """

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
    last_end: int | None = None

    @property
    def id(self) -> int:
        """One number for set and block."""
        return block_id(self.set, self.block)

    @property
    def label(self) -> str:
        """The block as people write it."""
        return block_label(self.set, self.block)

    @property
    def running(self) -> bool:
        return self.started > self.done + self.failed

    @property
    def error(self) -> int:
        """STATUS: the word of the last abnormal completion, 0 before the first."""
        return 0 if self.last_failure is None else self.last_failure.error

    @property
    def reason(self) -> ErrorCode:
        """framekit's code of the last abnormal completion."""
        return ErrorCode.NONE if self.last_failure is None else self.last_failure.reason

    @property
    def device_code(self) -> int | None:
        """The device's own code of the last abnormal completion, if it gave one."""
        return None if self.last_failure is None else self.last_failure.device_code


Shown: TypeAlias = "BlockStatus | BlockState"
"""What the words of a block show."""

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
"""What the words of a block can show, by the names that memory profiles use: expressions on a block."""

PULSES = ("done", "failed")
"""Bits that go on at a normal and at an abnormal completion, and off again by themselves."""


def failure_of(result: TransferResult) -> Failure | None:
    """What went wrong with a transfer; None when it went well."""
    if result.ok:
        return None
    outcome = result.outcome or "failed"
    return Failure(outcome=outcome, cause=result.cause, device_code=result.code, meaning=result.meaning)


class BlockState:
    """A block at work: its counters, failures by their outcome, whether it waits or runs, and how it ended last.

    `overruns`: times it came due while it was still waiting or running.
    `companions`: blocks whose data come with the exchange of this one. `probing`: it asks a dead station. `round`
    counts how often it has been armed; timers of earlier rounds mean nothing. `key`: its set, and its
    number there. `chain`: the blocks that made it due one after the other, each of which ended while it was being
    started. `switched_on`: the block itself is on; `set_on`: its set is. `queue`: the lane in which it waits.
    `given`: its settings in memory; `effective`: the block as they say, from the look at its station to its start;
    `at_station`: the station of the block as the run file gives it, if that names the station. `starts`: starts its
    exchanges as long as its channel stays, if they have no parameters of their own.
    """

    queue: BlockLane

    __slots__ = (
        "armed", "at_station", "block", "chain", "companions", "dead", "done", "effective", "failed", "given",
        "has_station", "id", "key", "lane", "last_end", "last_failure", "overruns", "period", "probing", "queue",
        "reasons", "round", "running", "set_on", "started", "started_at", "starts", "starts_left", "switched_on",
        "waiting",
    )  # fmt: skip

    def __init__(self, block: Block) -> None:
        self.block = block
        self.id = block.id
        self.key = block.set, block.number
        self.has_station = block.instruction in STATIONED
        self.lane = block.lane
        self.period = min((trigger.period for trigger in block.triggers if isinstance(trigger, Every)), default=0)
        """Shortest period of its `every` triggers (ns); 0 without such a trigger."""
        self.chain: tuple[int, ...] = ()
        self.given: Sequence[Given] = ()
        self.effective: Block | None = None
        self.at_station: tuple[Hashable] | None = None
        self.starts: BlockStarts | None = None
        self.started = self.done = self.failed = self.overruns = 0
        self.switched_on = block.enabled
        self.set_on = True
        self.waiting = False
        self.starts_left = block.repeat
        self.armed: ArmedTriggers | None = None
        self.started_at = 0
        self.last_failure: Failure | None = None
        self.reasons: Counter[str] = Counter()
        self.last_end: int | None = None
        self.companions: tuple[BlockState, ...] = ()
        self.probing = False
        self.running = False
        self.dead = False
        self.round = 0

    @property
    def enabled(self) -> bool:
        """Whether it may come due: neither it nor its set is switched off."""
        return self.switched_on and self.set_on

    def begun(self, now: int) -> None:
        """An exchange of it begins."""
        self.waiting = False
        if self.starts_left is not None:
            self.starts_left -= 1
        self.started_at = now
        self.running = True
        self.started += 1

    def ended(self, failure: Failure | None, now: int) -> None:
        """An exchange of it has ended, well if `failure` is None."""
        self.running = False
        if failure is None:
            self.done += 1
        else:
            self.failed += 1
            self.reasons[failure.outcome] += 1
            self.last_failure = replace(failure, at=now)
        self.last_end = now

    def reset(self) -> None:
        """As at the start; what runs is still counted."""
        self.started, self.done, self.failed, self.overruns = int(self.running), 0, 0, 0
        self.starts_left = self.block.repeat
        self.switched_on = self.block.enabled
        self.last_failure, self.last_end = None, None
        self.reasons.clear()
