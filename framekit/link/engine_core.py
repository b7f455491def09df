"""What an engine is made of, and what follows from each event: everything that takes no time, and what is due.

What falls on one instant is done in this order: what the driver reports, in the order of its calls (bytes before times
that run out at that very instant); after each, everything that follows from it and takes no time – finished exchanges
are told, lanes begin what can begin, delivered frames, queues, then the next frame in the bytes at hand. When times run
out: the receiver's first, then those of runs, earliest first and in the order of the lanes, then the session's
keep-alive. Which events there are, `engine` says.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from datetime import datetime
from typing import Any

from framekit.codec.shown import explain
from framekit.definition.model.protocol import Protocol
from framekit.definition.times import NEVER, LineFormat, parse_format
from framekit.link.clock import DEFAULT_START
from framekit.link.counters import LinkCounters
from framekit.link.device_state import DeviceState
from framekit.link.direct_lane import DirectLane
from framekit.link.dispatch import Dispatcher
from framekit.link.evaluate import Names
from framekit.link.events import Command
from framekit.link.exchange import Ask, MemoryAccess, Server
from framekit.link.farewell import Farewell
from framekit.link.frame_table import Codec, FrameTable
from framekit.link.functions import EngineFunctions
from framekit.link.lanes import Lanes
from framekit.link.late import replies_of
from framekit.link.machine import Machine
from framekit.link.observe import Monitor
from framekit.link.output import Output
from framekit.link.program import compile_sequences
from framekit.link.receiver import Receiver
from framekit.link.reception import OnFrame, Reception
from framekit.link.runs import State
from framekit.link.scope import Scope
from framekit.link.sessions import SessionState

MOST_ROUNDS = 100_000
"""So many things that follow from one event, and no byte is used meanwhile, are a circle that no lane alone makes."""


class EngineCore:
    """The parts of one side of a line, and how they go on. See `Engine` for what it is given and raises."""

    def __init__(
        self,
        protocol: Protocol,
        codec: Codec,
        role: str | None,
        *,
        params: Mapping[str, Any] | None = None,
        line: LineFormat | None = None,
        own: Any = None,
        server: Server | None = None,
        now: int = 0,
        memory: MemoryAccess | None = None,
        ask: Ask | None = None,
        on_frame: OnFrame | None = None,
        monitor: Monitor | None = None,
        on_fault: Monitor | None = None,
        on_send: Callable[[], None] | None = None,
        clock_start: datetime = DEFAULT_START,
        device: DeviceState | None = None,
        counters: LinkCounters | None = None,
    ) -> None:
        if line is None and protocol.line.kind == "serial":
            line = parse_format(protocol.line.format, protocol.line.speed)
        self.protocol = protocol
        self.role = role
        self.scope = Scope(
            protocol, role=role, own=own, line=line, params=params, now=now, clock_start=clock_start, device=device
        )
        self.counters = LinkCounters() if counters is None else counters
        self._commands: list[Command] = []
        table = FrameTable(protocol, codec)
        self._context = Names({"request": None, "buffer": b""}, self.scope)
        self.receiver = Receiver(codec, protocol, self._context, table, self._frame_trouble)
        self.output = Output(protocol.line, self.scope, self._commands)
        self.machine = machine = Machine(self.scope, table, compile_sequences(protocol, table), self.output)
        machine.server, machine.memory, machine.ask_service, machine.monitor = server, memory, ask, monitor
        machine.on_fault, machine.on_send = on_fault, on_send
        self.scope.update({name: name for name in protocol.queues})
        self.scope["functions"] = EngineFunctions(machine)
        model = None if role is None else protocol.roles[role]
        machine.late.replies = replies_of(protocol, model)
        machine.session = SessionState(protocol.sessions.get(model.session or "") if model else None, self.scope)
        self.lanes = Lanes(model.lanes if model else (), machine)
        self.farewell = Farewell(machine, self.lanes, self.output)
        self.dispatcher = Dispatcher(machine, self.lanes)
        self.reception = Reception(self.receiver, self.dispatcher, self.counters, on_frame)
        self.direct = DirectLane(machine, self.lanes, self.receiver, self.counters, self._context)
        machine.flush = lambda: self.reception.show_noise(self.receiver.flush())
        self.is_busy = False
        self._circle_at = -1

    @property
    def deadline(self) -> int:
        """When `tick` is to be called; NEVER when nothing waits for time."""
        if self.direct.is_under_way:
            return self.direct.deadline
        if self.machine.callbacks or self.machine.ended:
            return self.scope.now
        deadline = self.lanes.deadline
        if self.reception.interest is not None:
            deadline = min(deadline, self.receiver.deadline)
        if self.machine.late.items:
            deadline = min(deadline, self.machine.late.until)
        return min(deadline, self._keep_alive_at())

    def _keep_alive_at(self) -> int:
        """When the session has to be kept alive; never while there is other traffic under way."""
        if not self.machine.session.is_open or self.output.outgoing is not None or not self.lanes.is_free:
            return NEVER
        return self.machine.session.keep_alive_at(self.output.quiet_since)

    # ---- what follows -------------------------------------------------------------------------------------

    def _finish(self) -> list[Command]:
        """Everything that follows and takes no time; then the commands, in order. Inside of itself it does nothing."""
        if self.is_busy:
            return []
        self.is_busy = True
        try:
            self._settle()
        finally:
            self.is_busy = False
        return self._given()

    def _given(self) -> list[Command]:
        """The commands that have come together, in order; none inside of what follows from an event."""
        if self.is_busy:
            return []
        commands = self._commands.copy()
        self._commands.clear()
        return commands

    def _told(self, tell: Callable[[], None]) -> list[Command]:
        """An exchange that was asked for directly is over; whoever asked may do what he likes."""
        self.is_busy = True
        try:
            tell()
        finally:
            self.is_busy = False
        machine = self.machine
        return self._finish() if machine.stirred or machine.callbacks or machine.ended else self._given()

    def _settle(self) -> None:
        machine, lanes = self.machine, self.lanes
        for _ in range(MOST_ROUNDS):
            if machine.ended:
                lanes.settle_ended()
            elif machine.callbacks:
                machine.callbacks.popleft()()
            elif machine.stirred and lanes.begin_what_can():
                continue
            elif machine.delivered:
                value = machine.delivered.popleft()
                if not self.dispatcher.offer(value, value.raw or b""):
                    self.reception.unsolicited(value)
            elif machine.has_queues and self.dispatcher.queue_rows():
                continue
            elif not self.reception.next_arrival() and not self.farewell.go_on():
                return
        place = self.receiver.stream.offset
        if place != self._circle_at:
            self._circle_at = place
            self._settle()
            return
        machine.show("trouble", reason="one event leads to another without end")

    def _frame_trouble(self, frame: str, error: Exception) -> None:
        self.machine.show("trouble", frame=frame, reason=explain(error))

    # ---- time ---------------------------------------------------------------------------------------------

    def _tick(self, now: int) -> None:
        """Everything that is due, in the documented order; new times due at the same instant as well."""
        self.scope.now = now
        self.direct.unfold()
        self.machine.stirred = True
        for _ in range(MOST_ROUNDS):
            if not self._something_due(now):
                return
            self.is_busy = True
            try:
                self._settle()
            finally:
                self.is_busy = False

    def _something_due(self, now: int) -> bool:
        receiver = self.receiver
        if self.reception.interest is not None and receiver.deadline <= now:
            receiver.tick(now)
            return True
        due = min((run for run in self.lanes.order if run.deadline <= now), key=lambda run: run.deadline, default=None)
        if due is not None:
            self._time_up(due)
            return True
        if self.machine.late.items and self.machine.late.until <= now:
            self.lanes.release()
            return True
        return self._keep_alive_at() <= now and self._keep_alive()

    def _time_up(self, run: Any) -> None:
        """A frame that is arriving is broken off first; a good one may still be found in what has come of it."""
        number = run.wait_number
        if run.state is State.HELD:
            self.lanes.hold_over(run)
            return
        if run.state is State.RECEIVING and run.candidate is not None:
            run.deadline = NEVER
            run.cause = "a frame began and was not completed in time"
            self.receiver.cut()
            self.receiver.tick(self.scope.now)
            self.reception.cutting = self.is_busy = True
            try:
                self._settle()
            finally:
                self.reception.cutting = self.is_busy = False
            if run.state is not State.RECEIVING or run.wait_number != number:
                return
        self.machine.time_up(run)

    def _keep_alive(self) -> bool:
        session = self.machine.session
        if session.session is None or session.session.keep_alive_run is None:
            return False
        names = (session.session.keep_alive_run,)
        return self.lanes.begin_sequences("keep_alive", names, session.station) is not None
