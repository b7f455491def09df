"""What an engine and those around it hand each other: exchanges and their outcomes, the server, the memory.

Plain values and small interfaces; nothing here does anything.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from framekit.link.evaluate import Names
from framekit.link.values import FrameValue


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


@dataclass(slots=True, eq=False, repr=False)
class Exchange:
    """One run of an `exchange` sequence: `run` names it (None: the role's first).

    `arguments` are what the service's call gave, for sequences that take them; `params` are names for this exchange
    alone, and for what its sequences ask. `expected` are the reply frames the service named, the error frame included.
    `inside` marks an exchange that an `ask` step has asked for: what the callback got as `done`. The engine says once
    that it has `ended`.
    """

    run: str | None = None
    station: Any = None
    request: FrameValue | None = None
    buffer: bytes = b""
    expected: tuple[str, ...] = ()
    outside_session: bool = False
    on_done: Callable[[Outcome], None] = lambda outcome: None
    inside: Any = None
    arguments: Mapping[str, Any] = field(default_factory=dict)
    params: Mapping[str, Any] = field(default_factory=dict)

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
