"""One read that is asked for again and again: the next request goes out from the callback of the last reply.

As long as nothing else happens on the line, a reply is taken by comparing it with the one before, and the next request
is written at once; anything else goes the way of every transfer. Values and failures are the owner's business.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from framekit.link.client import Client
from framekit.link.direct_read import DirectRead, FromWire
from framekit.link.events import Command
from framekit.link.transfer import Done, TransferResult
from framekit.service.client import ClientService, Request
from framekit.transport.clock import Handle

LEAST_PAUSE = 100_000_000
"""After a failure the next read begins so much later at least (ns), so that a dead line is not asked without end."""

OnNumbers = Callable[[tuple[int, ...]], None]
OnResult = Callable[[TransferResult], None]


class Polling:
    """Reads `count` elements of `unit` from `address` on until `stop`; each begins `every` ns after the one before.

    0: as soon as the last reply is there. `on_result` is told every end of a read. `on_numbers`, where it is given,
    gets the numbers of replies whose bytes are nothing else; what it raises goes to `on_raised`. All may call `stop`.
    `quick_reads` counts them.
    """

    def __init__(
        self, service: ClientService, address: str, *, station: Any, unit: str | None, count: int, every: int,
        on_result: OnResult, on_numbers: OnNumbers | None, on_raised: Callable[[Exception], None],
    ) -> None:  # fmt: skip
        self._service = service
        self._asks_for = {"address": address, "station": station, "unit": unit, "count": count}
        self._every = every
        self._on_result = on_result
        self._on_numbers = on_numbers
        self._on_raised = on_raised
        self.quick_reads = 0
        self._lane = service.engine.direct
        self._driver, self._clock = service.driver, service.clock
        self._ask: DirectRead | None = None
        self._from_wire: FromWire | None = None
        self._request: Request | None = None
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
        if self._driver.quick == self._take:
            self._driver.quick = None
        if self._timer is not None:
            self._timer.cancel()
        request, self._request = self._request, None
        if request is not None:
            self._service.give_up(request)

    # ---- the way of every transfer --------------------------------------------------------------------------

    def _next(self) -> None:
        self._timer = None
        try:
            self._read()
        except ValueError as error:  # a parameter has another value since
            self._told(TransferResult(False, outcome="cannot_send", cause=str(error)))

    def _read(self) -> None:
        if self._driver.quick is None:  # nobody else has the shortest way, or not any more
            self._driver.quick = self._take
        self._due = self._clock.now() + self._every
        self._request = self._service.request(self._begin, self._told)

    def _begin(self, client: Client, now: int, done: Done) -> list[Command]:
        """By the short way, once the read is known."""
        self._ask = ask = client.repeated(**self._asks_for, on_done=done)
        self._from_wire = None if ask is None or self._on_numbers is None else ask.from_wire
        commands = None if ask is None else client.engine.ask(ask, now)
        return client.read(**self._asks_for, now=now, on_done=done) if commands is None else commands

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

    # ---- the shortest way -----------------------------------------------------------------------------------

    def _take(self, data: bytes, now: int) -> bool:
        """Whether these bytes are the reply again; then it has been told, and the next request sent."""
        ask = self._ask
        same = None if ask is None else self._lane.take_same(ask, data, now)
        if ask is None or same is None:
            return False
        if self._from_wire is None or self._on_numbers is None:
            ask.brought(same, data)
            return True
        self.quick_reads += 1
        try:
            self._on_numbers(self._from_wire(data, same.start))
        except Exception as error:  # whatever it is, the line has nothing to do with it
            self._on_raised(error)
        if self._every:
            self._go_on(0)
        elif self.is_running:
            self._again(ask)
        return True

    def _again(self, ask: DirectRead) -> None:
        now = self._clock.now()
        request = self._lane.again(ask, now)
        if request is None:
            self._next()
        elif self._driver.write_through(request):
            self._lane.left_at_once(now)
