"""What an engine and those around it hand each other: exchanges and their outcomes, the server, the memory.

Plain values and small interfaces; nothing here does anything.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from framekit.link.evaluate import Names
from framekit.link.scope import Scope
from framekit.link.values import FrameValue

_NOTHING: Mapping[str, Any] = {}


@dataclass(slots=True)
class Outcome:
    """How an exchange ended. `outcome` is '' or the name of the failure, such as no_reply; `cause` says more in words.

    `results` are what the sequence gives; `reply` and `buffer` are those of that name; `raw` is the reply as received.
    """

    ok: bool
    outcome: str = ""
    cause: str = ""
    reply: FrameValue | None = None
    buffer: bytes = b""
    results: dict[str, Any] = field(default_factory=dict)
    raw: bytes = b""


class Exchange:
    """One run of an `exchange` sequence: `run` names it (None: the role's first). Or what belongs to any other run.

    `arguments` are what the service's call gave, for sequences that take them; `params` are names for this exchange
    alone, and for what its sequences ask. `expected` are the reply frames the service named, the error frame included.
    `inside` marks an exchange that an `ask` step has asked for: what the callback got as `done`. The engine says once
    that it has `ended`.

    Its sequences share the rest, from `begin` on. `asked` and `last_sent` are what replies have to repeat; `answering`
    and `last_taken` are what this side answers. `checks_echo`: this is the side that asked. `names`: where parameters
    are found, those of this exchange first.
    """

    __slots__ = (
        "answering", "arguments", "asked", "buffer", "checks_echo", "expected", "inside", "last_sent", "last_taken",
        "names", "on_done", "outside_session", "params", "raw", "refusal", "reply", "reply_buffer", "request", "run",
        "station",
    )  # fmt: skip

    asked: FrameValue | None
    last_sent: FrameValue | None
    answering: FrameValue | None
    last_taken: FrameValue | None
    names: Names
    raw: bytes
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

    def begin(self, scope: Scope, checks_echo: bool = True) -> Exchange:
        """Its sequences are about to run, on a request of their own that they may change."""
        self.checks_echo = checks_echo
        params, given = self.params, self.request
        self.names = Names(params, scope, scope.formulas_for(params)) if params else scope
        if given is not None:
            given = FrameValue(given.frame, given.fields.copy(), given.raw, given.refusal)
        self.request = self.asked = given
        self.reply = self.reply_buffer = self.refusal = self.last_sent = self.answering = self.last_taken = None
        self.raw = b""
        if self.station is None:
            self.station = scope["own"]
        return self

    def get(self, name: str) -> Any:
        """What a sequence that takes this name gets when nothing else gives it; None if there is no such thing."""
        return self.arguments[name] if name in self.arguments else self.names.get(name)

    def answers(self, request: Any) -> Any:
        """`request` is what this side answers now; the sequences it calls see it too."""
        self.request = request
        if not self.checks_echo and type(request) is FrameValue:
            self.answering = request
        return request

    def ended(self, outcome: Outcome) -> None:
        """It is over."""
        self.on_done(outcome)


@dataclass(slots=True)
class Served:
    """A server's answer: the reply to send (None: there is none), the bytes beside it, and the refusal's code or 0.

    `trouble`: what of the definition could not be worked out for the request.
    """

    reply: FrameValue | None
    reply_buffer: bytes = b""
    refusal: int = 0
    trouble: str = ""


class RequestHandler(Protocol):
    """Does what requests ask for, on a device's memory."""

    def serve(self, request: FrameValue, buffer: bytes, station: Any, check_only: bool, names: Names) -> Served: ...

    def unanswered(self) -> None:
        """The reply to the last request could not be built."""


class MemoryAccess(Protocol):
    """The device's memory, as `store` and `memory()` need it. Both raise ValueError."""

    def read(self, address: str, size: int) -> bytes: ...

    def write(self, address: str, data: bytes) -> None: ...


class Asked(Protocol):
    """What the callback of an `ask` step calls when the service is done; it also marks the exchanges made for it.

    `params` are the names that the exchange with this step brought along.
    """

    params: Mapping[str, Any]

    def __call__(self, outcome: Outcome) -> None: ...


Ask = Callable[[str, dict[str, Any], Any, Asked], None]
"""Runs a service of the protocol: its name, the arguments, the station, and what to call at the end."""
