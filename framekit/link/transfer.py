"""One transfer under way: its exchanges one after the other, and what came of them.

It succeeds or fails as a whole: a part that fails fails the rest, and nothing that was read before is handed out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from framekit.link.exchange import Exchange, Outcome
from framekit.link.packing import cut_memory, join_memory, values_of
from framekit.link.requests import Piece, Plan
from framekit.link.values import FrameValue
from framekit.memory.memory import unit_bits


@dataclass(slots=True)
class TransferResult:
    """How a transfer ended. `outcome` is '' or a word such as no_reply, refused, unfit_reply; `cause` says more.

    `values` are the elements read, `data` the same in memory's form, both empty unless `ok`. `code` is the device's own
    when it refused, `meaning` its name. `exchanges` counts those that were started, `written` the elements that are
    known to be written, also when a later part failed. `gives` are a service's results, `reply` is the last reply,
    `raw` its bytes and `buffer` those beside it.
    """

    ok: bool
    values: list[int] = field(default_factory=list)
    data: bytes = b""
    outcome: str = ""
    cause: str = ""
    code: int | None = None
    meaning: str = ""
    exchanges: int = 0
    written: int = 0
    gives: dict[str, Any] = field(default_factory=dict)
    reply: FrameValue | None = None
    raw: bytes = b""
    buffer: bytes = b""


Done = Callable[[TransferResult], None]


@dataclass(slots=True)
class Answer:
    """What one exchange brought: a failure, or the data of its pieces and a service's results."""

    failure: TransferResult | None = None
    data: list[bytes] = field(default_factory=list)
    gives: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Job:
    """One exchange to be done: what to start, and how to read its outcome."""

    exchange: Exchange
    pieces: tuple[Piece, ...]
    judge: Callable[[Outcome], Answer]


class Transfer:
    """Runs the jobs of one transfer. `start` hands an exchange to the engine, `finish` makes the result of all data."""

    def __init__(
        self, jobs: Sequence[Job], start: Callable[[Exchange], None], finish: Callable[[list[bytes]], TransferResult],
        on_done: Done,
    ) -> None:  # fmt: skip
        self._jobs = jobs
        self._start = start
        self._finish = finish
        self._on_done = on_done
        self._next = 0
        self._going = False
        self._waiting = False
        self._over = False
        self._data: list[bytes] = []
        self._gives: dict[str, Any] = {}
        self._written = 0
        self._last = Outcome(False)

    def go(self) -> None:
        """Starts exchanges as long as their outcomes come at once."""
        if self._going:
            return
        self._going = True
        while not self._waiting and not self._over:
            if self._next == len(self._jobs):
                result = self._finish(self._data)
                result.gives = self._gives
                self._end(result)
                break
            job = self._jobs[self._next]
            self._next += 1
            self._waiting = True
            job.exchange.on_done = partial(self._ended, job)
            self._start(job.exchange)
        self._going = False

    def _ended(self, job: Job, outcome: Outcome) -> None:
        job.exchange.on_done = _told  # nothing is left that refers to itself, so it is freed at once
        self._waiting = False
        self._last = outcome
        answer = job.judge(outcome)
        if answer.failure is not None:
            self._end(answer.failure)
            return
        self._data.extend(answer.data)
        self._gives.update(answer.gives)
        self._written += sum(piece.count for piece in job.pieces if piece.data is not None)
        self.go()

    def _end(self, result: TransferResult) -> None:
        self._over = True
        result.exchanges, result.written = self._next, self._written
        result.reply, result.raw, result.buffer = self._last.reply, self._last.raw, self._last.buffer
        self._on_done(result)


def _told(outcome: Outcome) -> None:
    """An exchange is told once how it ended."""


def elements(
    plans: Sequence[Plan], wanted: Sequence[tuple[str, int]], data: Sequence[bytes]
) -> tuple[list[int], bytes]:
    """Values and memory form of everything that was read; `wanted` are units and counts in the order asked."""
    parts, place = [], 0
    for plan in plans:
        pieces = sum(len(exchange) for exchange in plan.exchanges)
        parts.append((_joined(plan, data[place : place + pieces]), plan.bits))
        place += pieces
    whole = join_memory(parts)
    values: list[int] = []
    first = 0
    for unit, count in wanted:
        bits = count * unit_bits(unit)
        values.extend(values_of(cut_memory(whole, first, bits), unit, count))
        first += bits
    return values, whole


def _joined(plan: Plan, data: Sequence[bytes]) -> bytes:
    """What the pieces of a plan brought, as one range; what was only read to be aligned is cut off."""
    pieces = [piece for exchange in plan.exchanges for piece in exchange]
    whole = join_memory([(part, piece.bits) for part, piece in zip(data, pieces, strict=True)])
    return cut_memory(whole, plan.skip, plan.bits)
