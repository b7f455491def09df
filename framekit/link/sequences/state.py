"""A sequence under way: its lane, its run, the waits and events of its generators, and its time limits.

A generator yields a wait: rows (`Wait`), or another wait (`Pause`, `ParkedHold`, `ParkedCall`, `Asking`, `Changing`).
The engine sends it a frame, or an event (see below). It yields NOT_TAKEN if no row or handler applies, AGAIN if it
waits on, and RESTART if it waits on with its clock set anew. It returns its results, or `Failed`.

A clock begins when the last bit that the run sent has left. While a frame is arriving that fits so far, `within`
stands still; if the bytes turn out to be no frame, the time they took is given back (guide: sequences).
"""

from __future__ import annotations

import enum
from collections import deque
from collections.abc import Callable, Generator, Iterator, Mapping
from typing import Any

from framekit.definition.model.procedure import Lane, Session
from framekit.definition.times import NEVER
from framekit.link.events import Exchange, Outcome
from framekit.link.scope import Scope
from framekit.link.unusable import UnusableReplies
from framekit.link.values import EVALUATION_ERRORS, FrameValue, compile_optional

MOST_STEPS = 20_000
"""So many jumps back of a lane at one instant, while no byte of the stream is used, are a circle."""


class CircleError(Exception):
    """Steps go round without waiting."""


class State(enum.Enum):
    """The state of a run: going on without taking time, waiting for rows, for a time, for a service, or over.

    HELD: it waits to send, because replies to earlier requests are due. SILENT: its reply may belong to one of
    these; it waits for silence and then asks again. CHANGING: it waits until the line has other speed and format,
    after everything that was sent before.
    """

    GOING = "going"
    HELD = "held"
    SILENT = "silent"
    CHANGING = "changing"
    RECEIVING = "receiving"
    PAUSING = "pausing"
    ASKING = "asking"
    DONE = "done"


# ---- values sent to generators --------------------------------------------------------------------------------------


class Event:
    """Something that came, of which there is no more to say."""

    __slots__ = ("name",)

    def __init__(self, name: str) -> None:
        self.name = name

    def __repr__(self) -> str:
        return self.name


GO, TIMEOUT, NOISE, BREAK, CLOSED, NOT_SENT, BYTE = map(
    Event, ("GO", "TIMEOUT", "NOISE", "BREAK", "CLOSED", "NOT_SENT", "BYTE")
)
PARKED_EVENTS = ("on_break", "on_closed", "on_held")
"""Handlers of events that do not wait for a row: they apply in every wait, and to the callers too."""


class Bad:
    """A damaged frame."""

    __slots__ = ("cause", "frame")

    def __init__(self, cause: str, frame: str) -> None:
        self.cause, self.frame = cause, frame


class Other:
    """A good frame that no row takes."""

    __slots__ = ("value",)

    def __init__(self, value: FrameValue) -> None:
        self.value = value


class Item:
    """A queue has an item (`value`), or room, for the row at this place."""

    __slots__ = ("row", "value")

    def __init__(self, row: int, value: Any) -> None:
        self.row, self.value = row, value


class Failed:
    """A sequence, or a service, has failed; `results` as far as there are any."""

    __slots__ = ("outcome", "results")

    def __init__(self, outcome: str, results: dict[str, Any]) -> None:
        self.outcome, self.results = outcome, results


# ---- values that generators yield -----------------------------------------------------------------------------------

NOT_TAKEN, AGAIN, RESTART = map(Event, ("NOT_TAKEN", "AGAIN", "RESTART"))


class Parked:
    """A wait for an event other than a row. `events`: handlers that apply; `always`: frames of rows for every step."""

    __slots__ = ("always", "events", "name")

    def __init__(self, name: str, always: tuple[str, ...], events: tuple[str, ...]) -> None:
        self.name, self.always, self.events = name, always, frozenset(events)

    def names(self, expected: tuple[str, ...]) -> tuple[str, ...]:
        """Return the frames of its rows, for an exchange that expects these."""
        return names_of(self.always, expected)


class Plan:
    """The frames that a run looks for: those of a wait, for an exchange that expects these, and of its callers' rows.

    `frames`: in their order. `looks`: there are frames to look for; `others`: other frames are looked for too.
    `is_numbered`: the reply carries the number of its request.
    """

    __slots__ = ("frames", "is_numbered", "looks", "others")

    def __init__(self, wait: Wait, frames: dict[str, None]) -> None:
        self.frames, self.others, self.is_numbered = frames, wait.wants_others, wait.numbered
        self.looks = bool(frames) or wait.looks


class Pause(Parked):
    """It waits for `run.pause`."""

    __slots__ = ()


class ParkedHold(Parked):
    """It waits because replies are due."""

    __slots__ = ()


class ParkedCall(Parked):
    """It waits for the sequence `run.wanted`."""

    __slots__ = ()


class Asking(Parked):
    """It waits for the service `run.wanted`."""

    __slots__ = ()


class Changing(Parked):
    """It waits until the line has changed."""

    __slots__ = ()


class Wait:
    """Rows of a step. `frames`, `always`: those that its rows, and rows for every step, name ("" for those expected).

    `queues`: queue or None, queue that has to have room or None. `numbered`: a late reply to it is never mistaken for
    another reply. `is_timed`: it has a time limit. `wants_others`: other frames are looked for too.
    """

    __slots__ = (
        "always", "events", "frames", "index", "is_timed", "looks", "name", "numbered", "plans",
        "queues", "wants_others",
    )  # fmt: skip

    def __init__(
        self, name: str, index: int, frames: tuple[str, ...], always: tuple[str, ...],
        queues: tuple[tuple[str | None, str | None], ...], events: tuple[str, ...], is_timed: bool, numbered: bool,
    ) -> None:  # fmt: skip
        self.name, self.index, self.queues, self.numbered = name, index, queues, numbered
        self.frames, self.always = frames, always
        self.events, self.is_timed = frozenset(events), is_timed
        self.wants_others = "on_other" in self.events or "on_bad" in self.events
        self.looks = self.wants_others or "on_noise" in self.events
        self.plans: dict[Any, Plan] = {}

    def names(self, expected: tuple[str, ...]) -> dict[str, None]:
        """Return the frames of its rows in order, for an exchange that expects these."""
        return self.plan(expected).frames

    def plan(self, expected: tuple[str, ...]) -> Plan:
        """Return the frames to look for, for an exchange that expects these."""
        found = self.plans.get(expected)
        if found is None:
            frames = dict.fromkeys(names_of((*self.frames, *self.always), expected))
            found = self.plans[expected] = Plan(self, frames)
        return found

    def plan_in(self, level: Level) -> Plan:
        """Return the same with the rows of those that have called it."""
        names: list[Any] = [level.x.expected]
        one = level.caller
        while one is not None:
            names.append(one.wait.names(one.x.expected))
            one = one.caller
        key = tuple(names)
        found = self.plans.get(key)
        if found is None:
            own = self.names(level.x.expected)
            frames = dict.fromkeys([*own, *(name for some in key[1:] for name in some)])
            found = self.plans[key] = Plan(self, frames)
        return found


def names_of(names: tuple[str, ...], expected: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names in order; "" stands for those expected."""
    return tuple(one for name in names for one in (expected if name == "" else (name,)))


NO_NAMES: dict[str, None] = {}

# ---- sequences and runs ---------------------------------------------------------------------------------------------

Sequence = Callable[["Run", Exchange, Mapping[str, Any]], Generator[Any, Any, Any]]


class CompiledSequence:
    """A sequence: the function that makes its generator, its parameters. `has_always`: it has rows for every step."""

    __slots__ = ("begin", "has_always", "name", "takes")

    def __init__(self, name: str, begin: Sequence, takes: tuple[str, ...], has_always: bool) -> None:
        self.name, self.begin, self.takes, self.has_always = name, begin, takes, has_always


class Level:
    """One generator of a run's calls. `nested`: a service that its caller has asked for runs it. `wait`: its last."""

    __slots__ = ("caller", "generator", "nested", "wait", "x")

    def __init__(self, generator: Generator[Any, Any, Any], x: Exchange, caller: Level | None, nested: bool) -> None:
        self.generator, self.x, self.caller, self.nested = generator, x, caller, nested
        self.wait: Any = None


class LaneState:
    """One lane. `waiting` are exchanges not yet begun, oldest first."""

    def __init__(self, lane: Lane) -> None:
        self.name = lane.name
        self.exchange = lane.exchange
        self.listen = lane.listen
        self.waiting: deque[Exchange] = deque()
        self.running: list[Run] = []
        self.spare: Run | None = None
        """A run that is over and has kept its place in the order, to be used once more."""
        self.listener: Run | None = None
        self.is_queued = False
        """It stands in the ready queue: an exchange or a listener may begin in it."""
        self.held_until = 0
        self.steps_since = -1
        self.steps_done = 0
        self.steps_at = 0
        self._at_once = compile_optional(lane.at_once)

    def at_once(self, scope: Scope) -> int:
        """Return how many exchanges may run side by side."""
        if self._at_once is None:
            return 1
        try:
            return int(self._at_once(scope))
        except EVALUATION_ERRORS:
            return 1


class Run:
    """Sequences that call each other, in a lane; `top` is the innermost call.

    `unsent`: frames handed over that have not left; clocks wait for them. Times: `started` is when the step's clock
    began, `within` when it runs out before a frame has begun, `candidate` when the first byte of a frame came that fits
    so far, `deadline` when something has to happen. `exchange` gets the outcome. `agenda` are the sequences it runs in
    turn, `doing` the purpose of the present sequence. `given_up`: no request is repeated any more. `asked`: the
    exchange that waits for the reply to its request. `expected`: the frames it takes now. `wanted`: the sequence or
    service that it calls. `owed`: the reply to the last served request, until it is sent, and that request.
    """

    __slots__ = (
        "agenda", "asked", "asked_at", "base", "candidate", "cause", "change", "clock_waits", "complete", "deadline",
        "doing", "doubt", "exchange", "expected", "first_open", "gap", "given_up", "kind", "lane", "longest", "machine",
        "outcome", "owed", "pause", "plan", "results", "started", "state", "top", "unsent", "unusable",
        "wait_number", "wanted", "within",
    )  # fmt: skip

    def __init__(self, machine: Any, lane: LaneState, kind: str, exchange: Exchange | None = None) -> None:
        self.machine = machine
        self.lane = lane
        self.base = Level(None, None, None, False)  # type: ignore[arg-type] # given when it begins
        self.unsent = self.wait_number = 0
        self.kind = self.doing = kind
        self.exchange = exchange
        self.top: Level = None  # type: ignore[assignment] # as long as it has not begun, and when it is over
        self.agenda: list[tuple[str, str, Exchange]] | None = None
        self.owed: tuple[FrameValue, FrameValue | None] | None = None
        self.state = State.GOING
        self.candidate: int | None = None
        self.deadline = NEVER
        self.clock_waits = self.given_up = False
        self.cause = ""
        self.unusable: UnusableReplies | None = None
        """The replies of the exchange that arrived and could not be used."""
        self.asked: Exchange | None = None
        self.asked_at = 0
        """Time at which the last request was handed over for sending: no reply to it came before (ns)."""
        self.doubt: Any = None
        """The replies so far, of an exchange whose replies may belong to earlier requests (`late.Doubt`)."""
        self.first_open = 0
        """Number of the first open request that can be its own."""
        self.expected: Mapping[str, None] = NO_NAMES
        self.plan: Plan | None = None

    def unusable_replies(self) -> UnusableReplies:
        """Return the record of the replies that arrived and could not be used."""
        if self.unusable is None:
            self.unusable = UnusableReplies()
        return self.unusable

    started: int
    within: int
    longest: int
    complete: int | None
    gap: int | None
    pause: int
    outcome: Outcome | None
    results: dict[str, Any]
    wanted: tuple[str, dict[str, Any]]
    change: Any

    @property
    def gives_way(self) -> bool:
        """Return whether it is a listener in its first step."""
        return (
            self.kind == "listen" and self.state is State.RECEIVING
            and self.top.caller is None and self.top.wait.index == 0
        )  # fmt: skip

    def calls(self) -> Iterator[Level]:
        """Yield the levels, innermost first."""
        level: Level | None = self.top
        while level is not None:
            yield level
            level = level.caller


# ---- time limits ----------------------------------------------------------------------------------------------


def after(start: int, time: int) -> int:
    """Return the moment `time` after `start`; NEVER stays NEVER."""
    return start + time if time < NEVER else NEVER


def begin_clock(run: Run, now: int) -> None:
    """Start, or restart, the clock of a waiting run."""
    waits = run.clock_waits = run.unsent > 0
    run.started = now
    run.within = within = NEVER if waits or run.longest >= NEVER else now + run.longest
    if run.candidate is None:
        run.deadline = within


def frame_arriving(run: Run, since: int, last: int, receiver_limits: bool) -> None:
    """Note bytes of a frame that fits so far: the first came at `since`, the last at `last`.

    If neither the step nor the receiver limits pauses, and the step does not limit the frame, no pause may be longer
    than `within`.
    """
    if run.candidate is None:
        run.candidate = max(since, run.started)
    gap = run.gap
    if gap is None and run.complete is None and not receiver_limits:
        gap = run.longest
    deadline = NEVER if gap is None else after(last, gap)
    if run.complete is not None:
        deadline = min(deadline, after(run.candidate, run.complete))
    run.deadline = deadline


def frame_gone(run: Run, now: int) -> None:
    """Note that the arriving bytes were no frame for this run."""
    if run.candidate is not None:
        if run.within < NEVER:
            run.within += now - run.candidate
        run.candidate = None
        run.deadline = run.within


class SessionState:
    """`is_open` between its opening and its end; `busy` while sequences open or close it.

    `keep_alive`: the silence after which it has to be kept alive; None: never. `on_end` is called at its end.
    """

    def __init__(self, session: Session | None, scope: Scope) -> None:
        self.session = session
        self.scope = scope
        self.is_open = False
        self.busy = False
        self.station: Any = None
        self.on_end: Callable[[], None] = lambda: None
        self._one_station = compile_optional(session.one_station if session else None)
        self.keep_alive = compile_optional(session.keep_alive_after if session else None)

    def plan(self, exchange: Exchange) -> list[tuple[str, str]]:
        """Return the steps before an exchange: pairs of `close` or `open` and a sequence; `mark` has no sequence."""
        session = self.session
        if session is None:
            return []
        if self.is_open and not exchange.outside_session and not self._another(exchange.station):
            return []
        closing = [("close", name) for name in session.close] + [("ended", "")] if self.is_open else []
        if exchange.outside_session:
            return closing
        return [*closing, ("begin", ""), *(("open", name) for name in session.open), ("opened", "")]

    def is_ready(self, station: Any, outside: bool) -> bool:
        """Return whether an exchange can begin at once, without opening or closing the session."""
        if self.session is None:
            return True
        return self.is_open and not self.busy and not outside and not self._another(station)

    def _another(self, station: Any) -> bool:
        return self._one_station is not None and station != self.station and bool(self._one_station(self.scope))

    def begin(self, station: Any) -> None:
        self.station = station
        self.scope.reset_session()

    def opened(self) -> None:
        self.is_open = True

    def end(self) -> None:
        """End the session and reset its variables."""
        self.is_open = False
        self.scope.reset_session()
        self.on_end()

    def failed(self, outcome: str) -> bool:
        """End an open session after a failure of the procedure, if the definition says so; return whether it ended."""
        session = self.session
        lost = session is not None and self.is_open and (session.lost_by is None or outcome in session.lost_by)
        if lost:
            self.end()
        return lost

    @property
    def reconnects(self) -> bool:
        """Return whether a connection is of no use any more without its session."""
        return self.session is not None and self.session.reconnect

    def keep_alive_at(self, quiet_since: int) -> int:
        """Return when the line will have been quiet so long that the session has to be kept alive."""
        if self.keep_alive is None or not self.is_open or self.busy:
            return NEVER
        return min(quiet_since + int(self.keep_alive(self.scope)), NEVER)
