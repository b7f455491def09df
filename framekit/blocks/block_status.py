"""How a block is doing, as one frozen value: what memory, terminals and programs show of it.

It is a view for a moment. Who counts, and where the words stand, is not known here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Protocol

from framekit.blocks.error_codes import ErrorCode, error_code, status_word
from framekit.blocks.model import BLOCKS_IN_SET
from framekit.link.codes import code_text
from framekit.link.services.client import TransferResult

EXPLAINED = ("damaged_frame", "cannot_store", "cannot_send", "bad_setting")
"""Outcomes that say little without their cause."""


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
        """In words: the outcome, the device's code with its meaning, the cause where the outcome says too little."""
        if self.device_code is not None:
            return f"{self.outcome} {code_text(self.device_code)}" + (f": {self.meaning}" if self.meaning else "")
        return f"{self.outcome}: {self.cause}" if self.cause and self.outcome in EXPLAINED else self.outcome

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
        """One number for set and block: that of the block in set 1, and 64 more for each further set."""
        return BLOCKS_IN_SET * (self.set - 1) + self.block

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


class Countable(Protocol):
    """What words show of a block: of a status, or of a block at work."""

    @property
    def started(self) -> int: ...
    @property
    def done(self) -> int: ...
    @property
    def failed(self) -> int: ...
    @property
    def overruns(self) -> int: ...
    @property
    def enabled(self) -> bool: ...
    @property
    def waiting(self) -> bool: ...
    @property
    def running(self) -> bool: ...
    @property
    def dead(self) -> bool: ...
    @property
    def last_failure(self) -> Failure | None: ...


ITEMS: Mapping[str, Callable[[Countable], int]] = MappingProxyType(
    {
        "error": lambda status: 0 if status.last_failure is None else status.last_failure.error,
        "reason": lambda status: 0 if status.last_failure is None else status.last_failure.reason,
        "device_code": lambda status: 0 if status.last_failure is None else status.last_failure.device_code or 0,
        "started_count": lambda status: status.started,
        "done_count": lambda status: status.done,
        "failed_count": lambda status: status.failed,
        "overrun_count": lambda status: status.overruns,
        "enabled": lambda status: status.enabled,
        "waiting": lambda status: status.waiting,
        "running": lambda status: status.running,
        "dead": lambda status: status.dead,
    }
)
"""What the words of a block can show, by the names that memory profiles use."""

PULSES = ("done", "failed")
"""Bits that go on at a normal and at an abnormal completion, and off again by themselves."""


def failure_of(result: TransferResult) -> Failure | None:
    """What went wrong with a transfer; None when it went well."""
    if result.ok:
        return None
    outcome = result.outcome or "failed"
    return Failure(outcome=outcome, cause=result.cause, device_code=result.code, meaning=result.meaning)
