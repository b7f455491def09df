"""A running client: an engine on a port, transfers that can be given up, endless reads, and frames without an exchange.

Callbacks only, on a clock; waiting is built on top. Types of values are handled elsewhere.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

from framekit.codec.codec import compile_protocol
from framekit.definition.model.protocol import Protocol
from framekit.definition.times import LineFormat
from framekit.link.engine import Engine
from framekit.link.events import Monitor, ServiceDone
from framekit.link.services.client import Done, ServiceClient, Transfer, TransferResult
from framekit.link.services.server import MemoryServer
from framekit.link.slow import SlowStation
from framekit.link.values import FrameValue
from framekit.memory.memory import DeviceMemory
from framekit.run.own_memory import AddressedMemory
from framekit.runfile.devices import memory_of
from framekit.service.driver import Driver
from framekit.transport.clock import Clock
from framekit.transport.port import Port

log = logging.getLogger(__name__)

MOST_FRAMES = 1000
"""Largest number of received frames kept for later calls."""

Begin = Callable[[ServiceClient, int, Done], Transfer]
"""Function that starts a transfer of a client at a time (ns), with a callback for its end."""
StateChanged = Callable[[bool, str], None]
"""Callback for the state of the port: whether it is open, and why not."""


class ClientService:
    """A client on a port. Raises ParameterError for parameters that do not fit, KeyError for an unknown role.

    `role` None: frames without exchanges. `memory`: its own memory, for protocols in which the other side also sends
    requests. `frames`: received frames that no call waited for, oldest first; `lost_frames`: number of frames dropped
    because of lack of room.
    """

    def __init__(
        self,
        protocol: Protocol,
        port: Port,
        clock: Clock,
        *,
        role: str | None,
        params: Mapping[str, Any] | None = None,
        line: LineFormat | None = None,
        own: Any = None,
        on_state: StateChanged | None = None,
        on_frame: Callable[[], None] | None = None,
        monitor: Monitor | None = None,
    ) -> None:
        self.clock = clock
        codec = compile_protocol(protocol)
        areas, grammar = memory_of(protocol)
        self.memory = DeviceMemory(areas)
        self.frames: deque[FrameValue] = deque()
        self.lost_frames = 0
        self._on_state = on_state
        self._on_frame = on_frame
        self.engine = engine = Engine(
            protocol,
            codec,
            role,
            params=params,
            line=line,
            own=own,
            now=clock.now(),
            server=MemoryServer(protocol, codec, self.memory) if protocol.services else None,
            memory=AddressedMemory(self.memory, grammar),
            ask=self._ask,
            on_frame=self._frame,
            monitor=monitor,
            is_stream=port.is_stream,
        )
        engine.late.slow.on_change = self._slow
        if protocol.line.kind == "serial" and port.settings is not None:
            engine.examine_replies(port.has_exact_times)
        self.client = ServiceClient(protocol, codec, engine)
        self.driver = Driver(engine, port, clock, self._state)
        self._sending: list[Callable[[bool], None]] = []

    # ---- life ---------------------------------------------------------------------------------------------

    @property
    def is_open(self) -> bool:
        """Return whether requests can be sent now."""
        return self.driver.is_open

    def start(self) -> None:
        """Open the port, and open it again whenever it is lost."""
        self.driver.start()

    def stop(self) -> None:
        """Close the port; pending transfers fail as `closed`."""
        self.driver.stop()
        self.driver.is_open = False
        self.engine.closed(self.clock.now(), "closed by this side")
        self._fail_sending()

    @property
    def has_session(self) -> bool:
        """Return whether a session may have to be closed before `stop`."""
        return self.engine.has_session and self.is_open

    def close_session(self, done: Callable[[], None]) -> None:
        """End the session with the other side as soon as no exchange runs; then call `done`."""
        self.driver.do(lambda now: self.engine.close_session(now, done))

    def _state(self, state: str) -> None:
        if state != "open":
            self._fail_sending()
        if self._on_state is not None:
            self._on_state(state == "open", state)

    def _fail_sending(self) -> None:
        sending, self._sending = self._sending, []
        for ended in sending:
            ended(False)

    # ---- transfers ----------------------------------------------------------------------------------------

    def request(self, begin: Begin, on_done: Done) -> Transfer:
        """Start a transfer; `on_done` is called exactly once. Raises ValueError for an impossible request."""
        transfer = begin(self.client, self.clock.now(), on_done)
        self.driver.carry_out(transfer.commands)
        return transfer

    def give_up(self, transfer: Transfer, on_done: Done) -> None:
        """Give a transfer up, unless it has ended: its reply is awaited, and no further request is sent."""
        if transfer.reports_to(on_done):
            transfer.given_up = True
            self.driver.do(lambda now: self.engine.give_up(transfer, now))

    def _slow(self, station: SlowStation, is_slow: bool) -> None:
        if is_slow:
            log.warning("%s: %s", self.driver.port.name, station)
        else:
            log.info("%s: station %s answers in time again", self.driver.port.name, station.station)

    def _ask(self, service: str, arguments: dict[str, Any], station: Any, done: ServiceDone) -> None:
        self.client.ask(service, arguments, station, done)

    # ---- frames -------------------------------------------------------------------------------------------

    def send(self, frame: str, fields: Mapping[str, Any], ended: Callable[[bool], None]) -> None:
        """Send a frame without an exchange; `ended` is called once with whether it has left. Raises ValueError,
        KeyError.
        """

        def sent() -> None:
            if ended in self._sending:
                self._sending.remove(ended)
                ended(True)

        self._sending.append(ended)
        try:
            self.driver.do(lambda now: self.engine.send_frame(frame, now, fields, sent))
        except (ValueError, LookupError, TypeError):
            self._sending.remove(ended)
            raise

    def _frame(self, frame: FrameValue) -> None:
        self.frames.append(frame)
        if len(self.frames) > MOST_FRAMES:
            self.frames.popleft()
            self.lost_frames += 1
            log.warning(
                "%s: %d received frames are lost, as no block or program took them",
                self.driver.port.name,
                self.lost_frames,
            )
        if self._on_frame is not None:
            self._on_frame()

    def take_frame(self, names: tuple[str, ...]) -> FrameValue | None:
        """Return the oldest frame of these names (of any, without names) that was not taken; None if no frame waits."""
        for frame in self.frames:
            if not names or frame.frame in names:
                self.frames.remove(frame)
                return frame
        return None


LEAST_PAUSE = 100_000_000
"""Least pause after a failed read (ns), so that a dead line is not polled continuously."""

OnResult = Callable[[TransferResult], None]


class Polling:
    """Reads `count` elements of `unit` from `address` on until `stop`; each read begins `every` ns after the previous.

    With `every` 0 the next read begins when the previous has ended. `on_result` is called with every result; it may
    call `stop`.
    """

    def __init__(
        self, service: ClientService, address: str, *, station: Any, unit: str | None, count: int, every: int,
        on_result: OnResult,
    ) -> None:  # fmt: skip
        self._service = service
        self._read = service.client.reading((address, unit, count, station))
        self._every = every
        self._on_result = on_result
        self._clock = service.clock
        self._request: Transfer | None = None
        self._alarm = self._clock.alarm(self._next)
        self._due = 0
        self.is_running = False

    def start(self) -> None:
        """Begin the first read. Raises ValueError for an impossible request."""
        self.is_running = True
        try:
            self._begin()
        except ValueError:
            self.stop()
            raise

    def stop(self) -> None:
        """Stop polling; no result follows. The reply of a pending request is awaited and dropped."""
        self.is_running = False
        self._alarm.cancel()
        request, self._request = self._request, None
        if request is not None:
            self._service.give_up(request, self._told)

    def _next(self) -> None:
        try:
            self._begin()
        except ValueError as error:  # a parameter has another value since
            self._told(TransferResult(False, outcome="cannot_send", cause=str(error)))

    def _begin(self) -> None:
        self._due = self._clock.now() + self._every
        self._request = self._service.request(self._read.start, self._told)

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
            self._alarm.set(begin)
        else:
            self._next()
