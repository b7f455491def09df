"""Plain values at the borders of an engine: line events, commands, records for monitors, exchanges and their outcomes,
the server, the memory.

The engine is sans-I/O: a driver reports line events with their times (the `Engine` methods), and carries out the
commands that the engine returns. Times are whole nanoseconds of a monotonic clock.
"""

from __future__ import annotations

import enum
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol

from framekit.definition.times import LineFormat
from framekit.link.scope import Scope
from framekit.link.values import FrameValue, Names, plain

_NOTHING: Mapping[str, Any] = {}


class LineFault(enum.Enum):
    """A fault of a character, found by a port; `MARK` is no damage: the ninth bit of a line of nine bits is set."""

    PARITY = "parity"
    FRAMING = "framing"
    OVERRUN = "overrun"
    MARK = "mark"


@dataclass(frozen=True, slots=True)
class CharacterFault:
    """A damaged or marked character: its index in the bytes that are received with it (from 0), and its fault."""

    index: int
    fault: LineFault


@dataclass(slots=True)
class Send:
    """Send these bytes, not before the given time; the driver answers with `Engine.sent` when the last bit has left.

    `marked`: the byte (0 = first) that goes out with its ninth bit set; None for none.
    `inside` allows to put the bytes into the frame that is going out now (embedded responses). For the engine: the
    `run` that sends (None: no run), the `FrameInfo` of the frame, and the callback for the time the last bit has left.
    """

    data: bytes
    not_before: int = 0
    inside: bool = False
    marked: int | None = field(default=None, kw_only=True)
    run: Any = field(default=None, repr=False, compare=False)
    info: Any = field(default=None, repr=False, compare=False)
    on_sent: Callable[[], None] | None = field(default=None, repr=False, compare=False)


@dataclass(slots=True)
class Break:
    """Hold the line in break state for `duration` ns, not before the given time; then `Engine.sent`. `run`: whose."""

    duration: int
    not_before: int = 0
    run: Any = field(default=None, repr=False, compare=False)


@dataclass(slots=True)
class ChangeLine:
    """The line has this speed and format from now on; all that was sent before has left, so no `sent` follows.

    For the engine: the `run` that waits for the change (None: no run), and the number of its wait.
    """

    line: LineFormat
    run: Any = field(default=None, repr=False, compare=False)
    number: int = field(default=0, repr=False, compare=False)


@dataclass(frozen=True, slots=True)
class SetRts:
    """Switch the request-to-send line."""

    on: bool


@dataclass(frozen=True, slots=True)
class Reopen:
    """Close the connection and open it again: received bytes are no frames, or the session is lost."""

    reason: str


Command = Send | Break | ChangeLine | SetRts | Reopen


Direction = Literal["in", "out", ""]
Kind = Literal["frame", "bad", "noise", "break", "line", "open", "closed", "trouble", "not_taken"]


class Seen:
    """Something that happened. `at` is when its last byte came or it was handed over for sending (ns).

    `kind`: a frame; a bad one; noise; a line break; `line`, other settings of the line (`reason`); the connection;
    `trouble` (a step that could not be worked out, a circle of steps); `not_taken` follows a frame that no step waited
    for. `reason`: the cause of a bad frame, or words. `place` is the byte of a bad frame where the fault is.
    `repeated`: the same bytes were sent before. `fields` are made when they are asked for; `computed` reads them from
    the bytes of a frame that was sent. `client`: the other side, HOST:PORT, where several can be on one port.
    `request`: the fields of the frame that this one answers, where a display found them (`codec.contents.Requests`).
    """

    __slots__ = (
        "_computed", "_fields", "at", "client", "direction", "frame", "kind", "place", "raw", "reason", "repeated",
        "request", "segment", "started_at",
    )  # fmt: skip

    def __init__(
        self, direction: Direction, kind: Kind, at: int, raw: bytes = b"", frame: str = "",
        fields: Mapping[str, Any] | None = None, reason: str = "", started_at: int = 0, segment: str = "",
        place: int = 0, repeated: bool = False, computed: Callable[[], Mapping[str, Any]] | None = None,
    ) -> None:  # fmt: skip
        self.direction, self.kind, self.at, self.raw, self.frame = direction, kind, at, raw, frame
        self.reason, self.started_at, self.segment = reason, started_at, segment
        self.place, self.repeated = place, repeated
        self._fields: Mapping[str, Any] = _NOTHING if fields is None else fields
        self._computed = computed
        self.client = ""
        self.request: Mapping[str, Any] | None = None

    @property
    def fields(self) -> dict[str, Any]:
        """Return the fields of a frame as codecs give them: a frame inside is `{frame: fields}`."""
        computed, self._computed = self._computed, None
        found = self._fields if computed is None else computed()
        self._fields = made = {name: plain(value) for name, value in found.items()}
        return made

    def __repr__(self) -> str:
        return f"<{self.kind} {self.direction} {self.frame} {self.raw.hex(' ')} {self.reason}>"


Monitor = Callable[[Seen], None]


FrameRecord = tuple[Any, Direction, int, bytes, str, Any, int, bool]
"""A good frame: the mark of the tape, direction, time, bytes, frame, its fields, time of the first byte, `repeated`.

Fields of a frame that was sent: a function of its bytes and the names to call it with.
"""
Record = FrameRecord | tuple[Any, Seen]


class Tape:
    """Raw records of the frames that engines have seen, for a display that formats them in its own time.

    It is also a monitor: everything else is recorded as it is reported.
    """

    __slots__ = ("begins", "mark", "records")

    def __init__(self, begins: Callable[[], None], mark: Any = None, records: list[Record] | None = None) -> None:
        self.begins = begins
        """Called before the first record after each `take`; it must not raise."""
        self.mark = mark
        """Says which engine a record is of."""
        self.records: list[Record] = [] if records is None else records

    def of(self, mark: Any) -> Tape:
        """Return the same tape with another mark."""
        return Tape(self.begins, mark, self.records)

    def __call__(self, seen: Seen) -> None:
        """Record something other than a good frame."""
        if not self.records:
            self.begins()
        self.records.append((self.mark, seen))

    def take(self) -> list[Record]:
        """Return all records, and forget them."""
        found = self.records.copy()
        self.records.clear()
        return found


def seen_of(record: Record) -> Seen:
    """Return the content of a record of a tape."""
    if len(record) == 2:
        return record[1]
    _, direction, at, raw, frame, fields, started_at, repeated = record
    if direction == "in":
        return Seen("in", "frame", at, raw, frame, fields, "", started_at)
    read, names = fields
    return Seen("out", "frame", at, raw, frame, None, "", 0, "", 0, repeated, lambda: read(raw, names, None))


@dataclass(slots=True)
class LinkCounters:
    """Frames by themselves sent, good frames received, those not taken, bad frames, bytes of noise.

    `late`: those not taken that were replies whose exchange was over, or that answered a repeated request again.
    """

    sent: int = 0
    received: int = 0
    not_taken: int = 0
    late: int = 0
    bad: int = 0
    repeated: int = 0
    """Requests sent once more, because no reply came or because it was in doubt."""
    noise_bytes: int = 0


NO_REPLY = ("no_reply", "timeout")
"""Names of failures for a device from which no reply came."""


@dataclass(slots=True)
class Outcome:
    """How an exchange ended. `outcome` is '' or the name of the failure, such as no_reply; `cause` says more in words.

    `results` are the results of the sequence; `reply` and `buffer` are the results with these names; `raw` holds the
    bytes of the reply as received.
    """

    ok: bool
    outcome: str = ""
    cause: str = ""
    reply: FrameValue | None = None
    buffer: bytes = b""
    results: dict[str, Any] = field(default_factory=dict)
    raw: bytes = b""
    damaged: int = 0
    """Number of bad frames that arrived as replies."""

    @property
    def failure_name(self) -> str:
        """Return the name of the failure for users: `damaged_reply` if damaged replies came."""
        return "damaged_reply" if self.damaged and self.outcome in NO_REPLY else self.outcome


POSTPONED = "postponed"
"""The outcome of an exchange that lets requests to other stations go first; its caller begins it again."""


class Exchange:
    """One run of an `exchange` sequence: `run` names it (None: the role's first). Or what belongs to any other run.

    `arguments` are the arguments of the service's call, for sequences that take them; `params` are names for this
    exchange and for the services that its sequences ask for. `expected` are the reply frames the service named, the
    error frame included. `gives_way`: it ends with `POSTPONED` where it would keep a shared line while its reply is in
    doubt; its caller begins it again. `inside` marks an exchange of an `ask` step: the `done` that its callback got.
    The engine calls `ended` or `succeeded` once.

    Its sequences share the rest, from `begin` on. `asked` and `last_sent` are what replies have to repeat; `answering`
    and `taken` are what this side answers. `checks_echo`: this is the side that asked. `names`: where parameters
    are found, those of this exchange first.
    """

    __slots__ = (
        "answering", "arguments", "asked", "buffer", "checks_echo", "expected", "gives_way", "inside", "last_sent",
        "names", "on_done", "outside_session", "params", "refusal", "reply", "reply_buffer", "request", "run",
        "station", "taken",
    )  # fmt: skip

    asked: FrameValue | None
    last_sent: FrameValue | None
    answering: FrameValue | None
    taken: FrameValue | None
    names: Names
    checks_echo: bool
    reply: Any
    reply_buffer: Any
    refusal: Any
    request: Any

    def __init__(
        self,
        run: str | None = None,
        station: Any = None,
        request: FrameValue | None = None,
        buffer: bytes = b"",
        expected: tuple[str, ...] = (),
        outside_session: bool = False,
        on_done: Callable[[Outcome], None] = lambda outcome: None,
        inside: Any = None,
        arguments: Mapping[str, Any] = _NOTHING,
        params: Mapping[str, Any] = _NOTHING,
    ) -> None:
        self.run, self.station, self.request, self.buffer, self.expected = run, station, request, buffer, expected
        self.outside_session, self.on_done, self.inside = outside_session, on_done, inside
        self.arguments, self.params = arguments, params
        self.gives_way = False

    def begin(self, scope: Scope, checks_echo: bool = True, copies: bool = True) -> Exchange:
        """Prepare the start of its sequences, with a copy of the request that they may change."""
        self.checks_echo = checks_echo
        params, given = self.params, self.request
        self.names = Names(params, scope, scope.formulas_for(params)) if params else scope
        if copies and given is not None:
            given = given.copy()
        self.request = self.asked = given
        self.reply = self.reply_buffer = self.refusal = self.last_sent = self.answering = self.taken = None
        if self.station is None:
            self.station = scope["own"]
        return self

    def renew(self) -> None:
        """Reset the exchange of a listener that begins anew: no request has come yet."""
        self.request = self.asked = self.reply = self.reply_buffer = self.refusal = None
        self.last_sent = self.answering = self.taken = None
        self.buffer = b""

    def get(self, name: str) -> Any:
        """Return the value of a name that a sequence takes and its caller does not give; None if it is unknown."""
        return self.arguments[name] if name in self.arguments else self.names.get(name)

    def answers(self, request: Any) -> Any:
        """Set the request that this side answers; the sequences that it calls see it too."""
        self.request = request
        if not self.checks_echo and type(request) is FrameValue:
            self.answering = request
        return request

    @property
    def raw(self) -> bytes:
        """Return the bytes of the frame that was taken last."""
        return b"" if self.taken is None else self.taken.raw or b""

    def may_repeat(self) -> bool:
        """Return whether it may run again while its reply is in doubt. To be overridden."""
        return True

    def suspected(self, results: dict[str, Any]) -> None:
        """Take results that may come from an own echo: the reply equals the request. To be overridden."""
        self.succeeded(results)

    def succeeded(self, results: dict[str, Any]) -> None:
        """End the exchange with these results."""
        self.ended(outcome_of(self, results))

    def ended(self, outcome: Outcome) -> None:
        """End the exchange and pass the outcome to its callback."""
        self.on_done(outcome)


def outcome_of(x: Exchange, results: dict[str, Any]) -> Outcome:
    """Return how an exchange with these results has ended."""
    reply, buffer = results.get("reply"), results.get("buffer", b"")
    return Outcome(
        True, "", "", reply if type(reply) is FrameValue else None, buffer if isinstance(buffer, bytes) else b"",
        results, x.raw,
    )  # fmt: skip


@dataclass(slots=True)
class Served:
    """A server's answer: the reply to send (None: no reply), its buffer, and the refusal's code or 0.

    `trouble`: the expression of the definition that could not be evaluated for the request.
    """

    reply: FrameValue | None
    reply_buffer: bytes = b""
    refusal: int = 0
    trouble: str = ""


class RequestHandler(Protocol):
    """Does what requests ask for, on a device's memory."""

    def serve(self, request: FrameValue, buffer: bytes, station: Any, check_only: bool, names: Names) -> Served: ...

    def unanswered(self) -> None:
        """Note that the reply to the last request could not be built."""


class MemoryAccess(Protocol):
    """The device's memory, as `store` and `memory()` need it. Both raise ValueError."""

    def read(self, address: str, size: int) -> bytes: ...

    def write(self, address: str, data: bytes) -> None: ...


class ServiceDone(Protocol):
    """The function that the callback of an `ask` step calls when the service is done; it marks the service's exchanges.

    `params` are the names that the exchange with this step brought along.
    """

    params: Mapping[str, Any]

    def __call__(self, outcome: Outcome) -> None: ...


Ask = Callable[[str, dict[str, Any], Any, ServiceDone], None]
"""Runs a service of the protocol: its name, the arguments, the station, and what to call at the end."""
