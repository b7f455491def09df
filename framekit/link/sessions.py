"""The session of a role: whether one is open, with whom, and which sequences an exchange needs before it can run."""

from __future__ import annotations

from typing import Any

from framekit.definition.model.procedure import Session
from framekit.definition.times import NEVER
from framekit.link.evaluate import Evaluate, compile_expression
from framekit.link.exchange import Exchange
from framekit.link.scope import Scope


class SessionState:
    """`is_open` between its opening and its end; `busy` while sequences open or close it.

    `keep_alive`: after how long a silence it has to be kept alive; None where it need not be.
    """

    def __init__(self, session: Session | None, scope: Scope) -> None:
        self.session = session
        self.scope = scope
        self.is_open = False
        self.busy = False
        self.station: Any = None
        self._one_station = _maybe(session and session.one_station)
        self.keep_alive = _maybe(session and session.keep_alive_after)

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


def _maybe(expression: Any) -> Evaluate | None:
    return None if expression is None else compile_expression(expression)
