"""What a sequence under way consists of: its lane, its run, its call frames, and what belongs to one exchange.

Only state, the time limits of a waiting run, and small questions about both. What moves a run on is in `runtime`.

A clock begins when the last bit of what the run sent has left. While a frame is arriving that fits so far, `within`
stands still; if it turns out to be none, the time it took is given back (guide: sequences).
"""

from __future__ import annotations

import enum
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

from framekit.definition.model.procedure import Lane, Session
from framekit.definition.times import NEVER
from framekit.link.events import Exchange, Outcome
from framekit.link.scope import Scope
from framekit.link.values import EVALUATION_ERRORS, FrameValue, Names, compile_optional

Next = Any
"""What a generated function gives: another one that goes on; None where the run waits; NOT_TAKEN."""

NOT_TAKEN: Any = object()
"""What a row or a handler gives that does not apply: nothing was done."""

MOST_STEPS = 20_000
"""So many steps of a lane at one instant, while no byte of the stream is used, are a circle in which nothing waits."""


class CircleError(Exception):
    """Steps go round without waiting."""


class State(enum.Enum):
    """What a run is doing: nothing that takes time, waiting for rows, for a time, for a service, or it is over.

    HELD: it waits to send, because replies to earlier requests are due. CHANGING: it waits until the line has other
    speed and format, behind what was sent.
    """

    GOING = "going"
    HELD = "held"
    CHANGING = "changing"
    RECEIVING = "receiving"
    PAUSING = "pausing"
    ASKING = "asking"
    DONE = "done"


class Rows:
    """Rows of a step, or its `always` rows: for each frame the function that tries the rows which name it, in order.

    `named`: for frames that the exchange does not expect; `expected`: for those that it does; `others`: for expected
    frames that no row names. `order`: the frames in the order of the rows; EXPECTED stands for those of the exchange.
    """

    EXPECTED = ""
    __slots__ = ("expected", "known", "named", "order", "others")

    def __init__(
        self, named: Mapping[str, Any], expected: Mapping[str, Any], others: Any | None, order: tuple[str, ...]
    ) -> None:
        self.named = named
        self.expected = expected
        self.others = others
        self.order = order
        self.known: dict[tuple[str, ...], tuple[dict[str, Any], tuple[str, ...]]] = {}

    def of(self, expected: tuple[str, ...]) -> tuple[dict[str, Any], tuple[str, ...]]:
        """The functions by frame, and the frames in order, for an exchange that expects these."""
        found = self.known.get(expected)
        if found is None:
            table = {name: (self.expected if name in expected else self.named)[name] for name in self.named}
            if self.others is not None:
                table = {**dict.fromkeys(expected, self.others), **table}
            order = [one for name in self.order for one in (expected if name == self.EXPECTED else (name,))]
            found = self.known[expected] = table, tuple(dict.fromkeys(order))
        return found


class CompiledStep:
    """A step, as its generated functions tell it: what it reacts to while it waits, and its time limits.

    `queue_rows`: queue or None, queue that has to have room or None, function. `numbered`: a late reply to it is never
    taken for another one. `is_timed`: it has a time limit. `back`: what goes on with results of a call or a service.
    """

    __slots__ = (
        "always", "back", "complete", "gap", "handlers", "index", "is_timed", "name", "numbered", "queue_rows",
        "retries", "rows", "wants_others", "within",
    )  # fmt: skip

    def __init__(
        self,
        name: str,
        index: int,
        rows: Rows,
        always: Rows | None = None,
        queue_rows: tuple[tuple[str | None, str | None, Any], ...] = (),
        handlers: Mapping[str, Any] | None = None,
        within: Any = None,
        complete: Any = None,
        gap: Any = None,
        retries: Any = None,
        back: Any = None,
        numbered: bool = False,
    ) -> None:
        self.name, self.index = name, index
        self.rows, self.always, self.queue_rows = rows, always, queue_rows
        self.handlers: Mapping[str, Any] = handlers or {}
        self.within, self.complete, self.gap, self.retries = within, complete, gap, retries
        self.back, self.numbered = back, numbered
        self.is_timed = within is not None or complete is not None or gap is not None
        self.wants_others = "on_other" in self.handlers or "on_bad" in self.handlers


class CompiledSequence:
    """A sequence: its class of call frames and the function of its first step. `has_always`: rows for every step."""

    __slots__ = ("begin", "frame", "has_always", "name", "takes")

    def __init__(self, name: str, frame: type[CallFrame], begin: Any, takes: tuple[str, ...], has_always: bool) -> None:
        self.name, self.frame, self.begin, self.takes, self.has_always = name, frame, begin, takes, has_always


class CallFrame:
    """One sequence of a run's calls. Generated classes add a slot `v_…` for each variable, `c_…` for each counter.

    `it`, `cause`, `frame`, `outcome` and `part` are the language's names. `sent`: what `resend` repeats.
    """

    __slots__ = (
        "caller", "cause", "d", "frame", "it", "m", "n", "nested", "outcome", "part", "part_index", "parts", "resends",
        "run", "s", "sent", "step",
    )  # fmt: skip

    gives: tuple[tuple[str, Callable[[Any], Any]], ...] = ()

    def results(self) -> dict[str, Any]:
        """What the sequence gives; generated classes have it in one."""
        return {}

    if TYPE_CHECKING:
        it: Any
        cause: str
        frame: str
        outcome: str
        part: dict[str, Any]
        caller: CallFrame | None
        d: Exchange
        m: Any
        n: Names
        nested: bool
        part_index: int
        parts: list[bytes] | None
        resends: int
        run: Run
        s: Scope
        sent: tuple[bytes, FrameValue] | None
        step: CompiledStep

        def __init__(
            self, run: Run, d: Exchange, caller: CallFrame | None, nested: bool, given: Mapping[str, Any]
        ) -> None: ...

        def names(self) -> Names:
            """Variables and what is above them by name, for frames whose fields are worked out."""


class LaneState:
    """One lane. `waiting` are exchanges not yet begun, oldest first."""

    def __init__(self, lane: Lane) -> None:
        self.name = lane.name
        self.exchange = lane.exchange
        self.listen = lane.listen
        self.waiting: deque[Exchange] = deque()
        self.running: list[Run] = []
        self.listener: Run | None = None
        self.held_until = 0
        self.steps_since = -1
        self.steps_done = 0
        self.steps_at = 0
        self._at_once = compile_optional(lane.at_once)

    def at_once(self, scope: Scope) -> int:
        """How many exchanges may run side by side."""
        if self._at_once is None:
            return 1
        try:
            return int(self._at_once(scope))
        except EVALUATION_ERRORS:
            return 1


class Run:
    """Sequences that call each other, in a lane; `top` is the call frame that is doing something.

    `unsent`: frames handed over that have not left; clocks wait for them. Times: `started` is when the step's clock
    began, `within` when it runs out before a frame has begun, `candidate` when the first byte of a frame came that fits
    so far, `deadline` when something has to happen. `exchange` is told the end. `agenda` are the sequences it runs one
    after the other, `doing` what the present one is for. `given_up`: nothing is repeated any more. `asked`: the
    sequence of an exchange that waits for what it has asked for. `rows`: by frame, what tries the rows of the step;
    `has_always`: callers may have rows too. `go_on`: what a pause, or a request held back, goes on with. `owed`: the
    reply to the last request that it has had carried out, until that is sent, and what it is to.
    """

    __slots__ = (
        "agenda", "asked", "candidate", "cause", "clock_waits", "complete", "deadline", "doing", "exchange", "expected",
        "gap", "given_up", "go_on", "has_always", "kind", "lane", "longest", "machine", "outcome", "owed", "pause",
        "rows", "started", "state", "top", "unsent", "wait_number", "wants_others", "within",
    )  # fmt: skip

    started: int
    within: int
    longest: int
    complete: int | None
    gap: int | None
    pause: int
    go_on: Any
    expected: tuple[str, ...]
    rows: Mapping[str, Any]
    wants_others: bool

    def __init__(self, machine: Any, lane: LaneState, kind: str, exchange: Exchange | None = None) -> None:
        """What a wait needs is set when it begins."""
        self.machine = machine
        self.lane = lane
        self.kind = self.doing = kind
        self.exchange = exchange
        self.top: CallFrame = None  # type: ignore[assignment] # as long as it has not begun, and when it is over
        self.agenda: list[tuple[str, str, Exchange]] = []
        self.outcome: Outcome | None = None
        self.owed: tuple[FrameValue, FrameValue | None] | None = None
        self.state = State.GOING
        self.unsent = self.wait_number = 0
        self.candidate: int | None = None
        self.deadline = NEVER
        self.clock_waits = self.has_always = self.given_up = False
        self.cause = ""
        self.asked: CallFrame | None = None

    @property
    def gives_way(self) -> bool:
        """Whether it is a listener in its first step."""
        if self.kind != "listen" or self.state is not State.RECEIVING:
            return False
        return self.top.caller is None and self.top.step.index == 0

    def calls(self) -> Iterator[CallFrame]:
        """The call frames, innermost first."""
        frame: CallFrame | None = self.top
        while frame is not None:
            yield frame
            frame = frame.caller


# ---- time limits ----------------------------------------------------------------------------------------------


def after(start: int, time: int) -> int:
    """`start` and `time` later; never stays never."""
    return start + time if time < NEVER else NEVER


def begin_clock(run: Run, now: int) -> None:
    """The run begins to wait, or its clock is set anew."""
    waits = run.clock_waits = run.unsent > 0
    run.started = now
    if run.state is State.PAUSING:
        run.deadline = NEVER if waits else after(now, run.pause)
        return
    frame = run.top
    step = frame.step
    run.complete = None if step.complete is None else int(step.complete(frame))
    run.gap = None if step.gap is None else int(step.gap(frame))
    longest = run.longest = NEVER if step.within is None else int(step.within(frame))
    run.within = within = NEVER if waits or longest >= NEVER else now + longest
    if run.candidate is None:
        run.deadline = within


def frame_arriving(run: Run, since: int, last: int, receiver_limits: bool) -> None:
    """Bytes of a frame that fits so far: the first came at `since`, the last at `last`.

    Where neither step nor receiver limits a pause, nor the step the whole, no pause may be longer than `within`.
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
    """It was no frame for this run after all."""
    if run.candidate is not None:
        if run.within < NEVER:
            run.within += now - run.candidate
        run.candidate = None
        run.deadline = run.within


class SessionState:
    """`is_open` between its opening and its end; `busy` while sequences open or close it.

    `keep_alive`: after how long a silence it has to be kept alive; None where it need not be. `on_end` is told its end.
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
        """What has to run before an exchange: pairs of `close` or `open` and a sequence; `mark` has no sequence."""
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
        """Whether an exchange can begin at once: nothing has to be opened or closed for it."""
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
        """The session is over, however that came."""
        self.is_open = False
        self.scope.reset_session()
        self.on_end()

    def failed(self, outcome: str) -> bool:
        """A failure of the procedure ends an open session if the definition says so. Tells whether it did."""
        session = self.session
        lost = session is not None and self.is_open and (session.lost_by is None or outcome in session.lost_by)
        if lost:
            self.end()
        return lost

    @property
    def reconnects(self) -> bool:
        """Whether a connection is of no use any more without its session."""
        return self.session is not None and self.session.reconnect

    def keep_alive_at(self, quiet_since: int) -> int:
        """When the line will have been quiet so long that the session has to be kept alive."""
        if self.keep_alive is None or not self.is_open or self.busy:
            return NEVER
        return min(quiet_since + int(self.keep_alive(self.scope)), NEVER)
