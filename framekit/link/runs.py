"""A sequence under way: its variables, where it stands, what it waits for and until when.

Only state, and small questions about it; `machine` moves it on.
"""

from __future__ import annotations

import enum
from collections import deque
from typing import TYPE_CHECKING, Any

from framekit.definition.times import NEVER
from framekit.link.evaluate import Names
from framekit.link.exchange import Exchange, Outcome
from framekit.link.program import CompiledAction, CompiledSequence, CompiledStep, names_of
from framekit.link.values import FrameValue

if TYPE_CHECKING:
    from framekit.link.lanes import LaneState
    from framekit.link.scope import Scope


class State(enum.Enum):
    """What a run is doing: nothing that takes time, waiting for rows, for a time, for a service, or it is over.

    HELD: it waits to send, because replies to earlier requests are due.
    """

    GOING = "going"
    HELD = "held"
    RECEIVING = "receiving"
    PAUSING = "pausing"
    ASKING = "asking"
    DONE = "done"


class Dealing:
    """What belongs to one exchange, or to a run without one; its sequences share it.

    `request` and `last_sent` are what replies have to repeat; `answering` and `last_taken` are what this side answers.
    `checks_echo`: this is the side that asked.
    """

    __slots__ = (
        "answering", "checks_echo", "exchange", "expected", "last_sent", "last_taken", "names", "raw", "request",
    )  # fmt: skip

    def __init__(self, scope: Scope, exchange: Exchange | None, checks_echo: bool, station: Any = None) -> None:
        self.exchange = exchange
        self.expected: tuple[str, ...] = ()
        self.checks_echo = checks_echo
        self.request: FrameValue | None = None
        self.last_sent: FrameValue | None = None
        self.answering: FrameValue | None = None
        self.last_taken: FrameValue | None = None
        self.raw = b""
        self.names = Names({"buffer": b"", "expected": ()}, scope)
        if station is not None:
            self.names["station"] = station
        if exchange is not None:
            self.expected = exchange.expected
            if exchange.request is not None:
                self.request = exchange.request.copy()
            if exchange.params:
                self.names.update(exchange.params)
                self.names.formulas = scope.formulas_for(exchange.params)
            self.names.update(exchange.arguments)
            self.names.update(buffer=exchange.buffer, expected=exchange.expected, request=self.request)
            if exchange.station is not None:
                self.names["station"] = exchange.station

    def answers(self, request: Any) -> None:
        """`request` is what this side answers now; the sequences it calls see it too."""
        self.names["request"] = request
        if not self.checks_echo and type(request) is FrameValue:
            self.answering = request

    def echo_sources(self) -> tuple[FrameValue, ...]:
        """Where a reply's echo is looked for: the request first, then the frame sent last."""
        return tuple(value for value in (self.request, self.last_sent) if value is not None)


class Activation:
    """One sequence of a run's stack of calls. `counters`: how often counted actions were taken, by the step's index."""

    __slots__ = (
        "counters",
        "dealing",
        "index",
        "names",
        "nested",
        "part_index",
        "parts",
        "phase",
        "resends",
        "sent",
        "sequence",
        "step",
    )  # fmt: skip

    def __init__(self, sequence: CompiledSequence, dealing: Dealing, arguments: dict[str, Any], nested: bool) -> None:
        self.sequence = sequence
        self.dealing = dealing
        self.names = Names(sequence.variables(), dealing.names)
        self.names["it"] = None
        self.names.update(arguments)
        self.nested = nested
        self.index = 0
        self.step: CompiledStep = sequence.steps[0]
        self.phase = 0
        self.counters: dict[int, dict[CompiledAction, int]] = {}
        self.resends = 0
        self.parts: list[bytes] | None = None
        self.part_index = 0
        self.sent: tuple[bytes, FrameValue] | None = None


class Run:
    """A stack of sequences in a lane. `unsent`: frames handed over that have not left; clocks wait for them.

    Times: `started` is when the step's clock began, `within` when it runs out before a frame has begun, `candidate`
    when the first byte of a frame came that fits so far, `deadline` when something has to happen. `agenda` are the
    sequences it runs one after the other, `doing` what the present one is for. `given_up`: nothing is
    repeated any more. `asked`: the sequence of an exchange that waits for what it has asked for.
    """

    __slots__ = (
        "agenda", "asked", "candidate", "cause", "clock_waits", "complete", "deadline", "doing", "gap", "given_up",
        "interest", "kind", "lane", "longest", "outcome", "pause", "stack", "started", "state", "unsent", "wait_number",
        "wants_others", "within",
    )  # fmt: skip

    def __init__(self, lane: LaneState, kind: str) -> None:
        self.lane = lane
        self.kind = kind
        self.stack: list[Activation] = []
        self.agenda: deque[tuple[str, str, Dealing]] = deque()
        self.doing = kind
        self.outcome = Outcome(True)
        self.state = State.GOING
        self.unsent = 0
        self.started = 0
        self.within = NEVER
        self.complete: int | None = None
        self.gap: int | None = None
        self.candidate: int | None = None
        self.pause = 0
        self.deadline = NEVER
        self.clock_waits = False
        self.wait_number = 0
        self.interest: tuple[str, ...] = ()
        self.wants_others = False
        self.cause = ""
        self.given_up = False
        self.longest = NEVER
        self.asked: Activation | None = None

    @property
    def top(self) -> Activation:
        return self.stack[-1]

    @property
    def gives_way(self) -> bool:
        """Whether it is a listener in its first step."""
        return self.kind == "listen" and len(self.stack) == 1 and self.top.index == 0 and self.state is State.RECEIVING

    def frames_waited_for(self) -> tuple[str, ...]:
        """The frames of the step's rows, then of `always` rows, its own sequence's and its callers'."""
        top = self.top
        own = top.step.names(top.dealing.expected)
        if not any(activation.sequence.always for activation in self.stack):
            return own
        found = dict.fromkeys(own)
        for activation in reversed(self.stack):
            found.update(dict.fromkeys(names_of(activation.sequence.always, activation.dealing.expected)))
        return tuple(found)

    def handler(self, event: str) -> tuple[Activation, tuple[CompiledAction, ...]] | None:
        """Who handles an event: the step, its sequence; a break also the callers, innermost first."""
        reach = reversed(self.stack) if event in ("on_break", "on_closed") else (self.stack[-1],)
        for activation in reach:
            actions = activation.step.handlers.get(event) or activation.sequence.handlers.get(event)
            if actions:
                return activation, actions
        return None

    def has_handler(self, *events: str) -> bool:
        top = self.top
        return any(event in top.step.handlers or event in top.sequence.handlers for event in events)
