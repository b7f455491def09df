"""A fault plan as a value: which faults, how often, in which window of time, and the seed that makes it repeatable.

It says what is to happen to the frames of one side; how a port or a server does it is not known here.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from framekit.definition.problems import NOWHERE, Position
from framekit.definition.times import NEVER

Kind = Literal[
    "delay", "jitter", "no_reply", "wrong_check", "wrong_station", "error_reply", "truncate", "extra", "glue", "split",
    "echo", "noise", "stray", "disconnect",
]  # fmt: skip
Side = Literal["replies", "requests"]

LINE_KINDS: frozenset[Kind] = frozenset(("noise", "stray"))
"""Faults that happen to a line and not to a single frame."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultRule:
    """One fault. Times are ns; `begin` and `end` count from the first opening of the port.

    `rate` is the probability for each frame (of noise: for each bit), `every` hits each so many frames; with neither it
    always happens, at most `times` times. `of` is None where the file does not say. What `time`, `size` (bytes), `data`
    and `code` mean is the kind's business; None: its usual value.
    """

    kind: Kind
    of: Side | None = None
    rate: float | None = None
    every: int | None = None
    times: int | None = None
    begin: int = 0
    end: int = NEVER
    frame: str | None = None
    time: int | None = None
    size: int | None = None
    data: bytes | None = None
    before: bool = False
    code: int | None = None
    at: Position = NOWHERE

    @property
    def is_window(self) -> bool:
        """Whether it is a disconnection that begins and ends by itself, whatever is sent."""
        return self.kind == "disconnect" and self.every is None and self.rate is None and self.end < NEVER


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultPlan:
    """Rules in the order of the file. One that does not say `of` is about replies."""

    name: str = "faults"
    seed: int = 0
    rules: tuple[FaultRule, ...] = ()
    at: Position = NOWHERE

    def rules_of(self, side: Side) -> tuple[FaultRule, ...]:
        """The rules about what one side sends."""
        return tuple(rule for rule in self.rules if (rule.of or "replies") == side)

    def of_line(self) -> FaultPlan:
        """The plan of a whole line: the side that asks hears itself.

        A device alone can only give it that by sending back what it hears.
        """
        usual: dict[Kind, Side] = {"echo": "requests"}
        return replace(self, rules=tuple(replace(one, of=one.of or usual.get(one.kind)) for one in self.rules))

    def joined(self, other: FaultPlan | None) -> FaultPlan:
        """Its own rules, then those of another plan."""
        return self if other is None else replace(self, rules=self.rules + other.rules)
