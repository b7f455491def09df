"""The link procedure: sequences, steps, rows, roles and sessions. Language reference, sections 7 and 8."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from framekit.definition.expression.syntax import Expression
from framekit.definition.model.values import FrameOf, Value
from framekit.definition.problems import Position

HANDLERS = (
    "on_timeout",
    "on_bad",
    "on_other",
    "on_noise",
    "on_break",
    "on_closed",
    "on_exhausted",
    "on_fail",
    "on_byte",
)


@dataclass(frozen=True, slots=True)
class Target:
    """What `set` writes: a variable, an entry of a table (`name[key]`), or a field of a frame or record (`….field`)."""

    name: str
    key: Expression | None = None
    field: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Action:
    """What happens, in this order: when → at_most/otherwise → take → set → store → put → deliver → send → then or fail.

    `then` is `next`, `end`, `again`, `restart`, `resend` or a step; None with no `fail` stands for the place's default.
    `places`: key → where its value stands, for messages.
    """

    at: Position
    places: Mapping[str, Position] = field(default_factory=dict, compare=False)
    when: Expression | None = None
    at_most: Expression | None = None
    otherwise: Action | None = None
    take: str | None = None
    set: tuple[tuple[Target, Value], ...] = ()
    store: tuple[tuple[Expression, str], ...] = ()
    put: tuple[tuple[str, Mapping[str, Value]], ...] = ()
    deliver: Value | None = None
    send: Value | None = None
    then: str | None = None
    fail: str | None = None
    because: Expression | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Row(Action):
    """A row of a receive matrix. `frames`: in the order tried; `expected`: also the exchange's own replies."""

    frames: tuple[str, ...] = ()
    expected: bool = False
    queue: str | None = None
    room: str | None = None


@dataclass(frozen=True, slots=True)
class Parts:
    """`parts: {of, size}`: the step is done once for each piece."""

    of: Expression
    size: Expression


@dataclass(frozen=True, slots=True)
class Serve:
    """`serve:`: the frame to serve, the bytes beside it, the station it came for, and whether it is only judged."""

    request: Expression
    buffer: Expression | None = None
    station: Expression | None = None
    check_only: bool = False


@dataclass(frozen=True, slots=True)
class CallOf:
    """`call: SEQUENCE, with: {…}, into: {variable: result}`."""

    sequence: str
    arguments: Mapping[str, Value]
    into: Mapping[str, str]


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """One step; keys it does not have are None or empty. `handlers`: event → actions, the first that applies.

    `places`: key → where its value stands, for messages. `urgent`: replies that are due do not hold its frame back.
    """

    name: str
    at: Position
    places: Mapping[str, Position] = field(default_factory=dict, compare=False)
    when: Expression | None = None
    session: str | None = None
    parts: Parts | None = None
    wait: Expression | None = None
    hold_break: Expression | None = None
    flush: bool = False
    set: tuple[tuple[Target, Value], ...] = ()
    serve: Serve | None = None
    call: CallOf | None = None
    ask: FrameOf | None = None
    ask_into: Mapping[str, str] = field(default_factory=dict)
    put: tuple[tuple[str, Mapping[str, Value]], ...] = ()
    deliver: Value | None = None
    send: Value | None = None
    urgent: bool = False
    receive: tuple[Row, ...] | None = None
    branch: tuple[Action, ...] | None = None
    then: str = "next"
    within: Expression | None = None
    complete: Expression | None = None
    gap: Expression | None = None
    retries: Expression | None = None
    handlers: Mapping[str, tuple[Action, ...]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Sequence:
    """A named list of steps with arguments, results, local variables (name → type) and handlers for every step."""

    name: str
    at: Position
    takes: tuple[str, ...]
    gives: Mapping[str, Expression]
    local: Mapping[str, str]
    always: tuple[Row, ...]
    handlers: Mapping[str, tuple[Action, ...]]
    steps: tuple[Step, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Lane:
    """One of the things a role does side by side: exchanges (up to `at_once`), and what runs when none does."""

    name: str
    exchange: tuple[str, ...]
    listen: str | None
    at_once: Expression | None
    at: Position
    places: Mapping[str, Position] = field(default_factory=dict, compare=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class Role:
    """A side of the line: its lanes in the order frames are offered to them. `other_side`: the role that answers it."""

    name: str
    session: str | None
    lanes: tuple[Lane, ...]
    at: Position
    other_side: str | None = None

    @property
    def exchanges(self) -> bool:
        """Whether services can be called in it."""
        return any(lane.exchange for lane in self.lanes)

    @property
    def listens(self) -> tuple[str, ...]:
        """The sequences that run whenever a lane is free."""
        return tuple(lane.listen for lane in self.lanes if lane.listen is not None)


@dataclass(frozen=True, slots=True, kw_only=True)
class Session:
    """What has to be open before an exchange runs. `lost_by` is None for any failure, else the outcomes that end it.

    `reconnect`: a connection whose session is lost, or cannot be opened, is closed and opened again.
    """

    name: str
    open: tuple[str, ...]
    close: tuple[str, ...]
    one_station: Expression | None
    keep_alive_after: Expression | None
    keep_alive_run: str | None
    lost_by: tuple[str, ...] | None
    reconnect: bool
    at: Position
