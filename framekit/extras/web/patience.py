"""Limits of HTTP connections: their number from one address, and the time without a complete request.

Connections are cheap for a client. Without these limits a few silent ones would keep every browser out.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from typing import Any, ClassVar, cast

from uvicorn.protocols.http.h11_impl import H11Protocol

MOST_OF_AN_ADDRESS = 16
"""HTTP connections of one address at a time."""
LONGEST_SILENCE = 5.0
"""Seconds in which a connection must complete a request."""
LONGEST_ANSWER = 6
"""Number of these periods within which a client must take an answer."""


class ImpatientProtocol(H11Protocol):
    """HTTP that closes connections beyond the limit of their address, and connections without progress."""

    open_connections: ClassVar[Counter[str]] = Counter()
    """Open connections of this process by address; a WebSocket counts until its handshake."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Accept the connection, or close it if its address has too many."""
        super().connection_made(cast(asyncio.Transport, transport))
        self._address = "" if self.client is None else self.client[0]
        self._is_counted = True
        self._checked: tuple[Any, int] = (None, 0)
        self.open_connections[self._address] += 1
        self._check = self.loop.call_later(LONGEST_SILENCE, self._check_progress)
        if self.open_connections[self._address] > MOST_OF_AN_ADDRESS:
            self.transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop counting the connection."""
        self._release()
        super().connection_lost(exc)

    def handle_websocket_upgrade(self, event: Any) -> None:
        """Hand the connection over to the WebSocket protocol; the page counts its browsers itself."""
        self._release()
        super().handle_websocket_upgrade(event)

    def _release(self) -> None:
        self._check.cancel()
        if self._is_counted:
            self._is_counted = False
            self.open_connections[self._address] -= 1
            if not self.open_connections[self._address]:
                del self.open_connections[self._address]

    def _check_progress(self) -> None:
        """Close a connection without a new request since the last check, or with an answer that is not taken."""
        cycle, (before, checks) = self.cycle, self._checked
        is_silent = cycle is None or (cycle is before and cycle.response_complete)
        checks = checks + 1 if cycle is before else 0
        if is_silent or checks >= LONGEST_ANSWER:
            self.transport.abort()
            return
        self._checked = cycle, checks
        self._check = self.loop.call_later(LONGEST_SILENCE, self._check_progress)
