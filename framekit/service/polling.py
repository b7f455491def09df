"""One read that is asked for again and again: the next request goes out from the callback of the last reply.

Values and failures are the owner's business.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from framekit.link.services.client import Client, Done, Transfer, TransferResult
from framekit.service.client import ClientService
from framekit.transport.clock import Handle

LEAST_PAUSE = 100_000_000
"""After a failure the next read begins so much later at least (ns), so that a dead line is not asked without end."""

OnResult = Callable[[TransferResult], None]


class Polling:
    """Reads `count` elements of `unit` from `address` on until `stop`; each begins `every` ns after the one before.

    0: as soon as the last reply is there. `on_result` is told every end of a read; it may call `stop`.
    """

    def __init__(
        self, service: ClientService, address: str, *, station: Any, unit: str | None, count: int, every: int,
        on_result: OnResult,
    ) -> None:  # fmt: skip
        self._service = service
        self._asks_for = {"address": address, "station": station, "unit": unit, "count": count}
        self._every = every
        self._on_result = on_result
        self._clock = service.clock
        self._request: Transfer | None = None
        self._timer: Handle | None = None
        self._due = 0
        self.is_running = False

    def start(self) -> None:
        """Begins the first read. Raises ValueError for what cannot be asked."""
        self.is_running = True
        try:
            self._read()
        except ValueError:
            self.stop()
            raise

    def stop(self) -> None:
        """Ends it; nothing is told any more. What has been asked is waited for and dropped."""
        self.is_running = False
        if self._timer is not None:
            self._timer.cancel()
        request, self._request = self._request, None
        if request is not None:
            self._service.give_up(request)

    def _next(self) -> None:
        self._timer = None
        try:
            self._read()
        except ValueError as error:  # a parameter has another value since
            self._told(TransferResult(False, outcome="cannot_send", cause=str(error)))

    def _read(self) -> None:
        self._due = self._clock.now() + self._every
        self._request = self._service.request(self._begin, self._told)

    def _begin(self, client: Client, now: int, done: Done) -> Transfer:
        return client.read(**self._asks_for, now=now, on_done=done)

    def _told(self, result: TransferResult) -> None:
        if self.is_running:
            self._request = None
            self._on_result(result)
            self._go_on(0 if result.ok else LEAST_PAUSE)

    def _go_on(self, pause: int) -> None:
        now = self._clock.now()
        begin = max(self._due, now + pause)
        if not self.is_running:
            return
        if begin > now:
            self._timer = self._clock.call_at(begin, self._next)
        else:
            self._next()
