"""The link engine of one side of a line: events in, commands out (guide: receiving, sequences, roles).

Sans-I/O: it has no clock, port or task. What falls on one instant is done in this order: what the driver reports, in
the order of its calls (bytes before times that run out at that very instant); after each, everything that follows from
it and takes no time – finished exchanges are told, lanes begin what can begin, delivered frames, queues, then the next
frame in the bytes at hand. When times run out: the receiver's first, then those of runs, earliest first and in the
order of the lanes, then the session's keep-alive.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from datetime import datetime
from functools import partial
from typing import Any

from framekit.codec.shown import explain
from framekit.definition.model.protocol import Protocol
from framekit.definition.times import NEVER, LineFormat, parse_format
from framekit.link.events import (
    Ask,
    ChangeLine,
    CharacterFault,
    Command,
    Exchange,
    LinkCounters,
    MemoryAccess,
    Monitor,
    Outcome,
    RequestHandler,
    Send,
)
from framekit.link.frame_table import ProtocolCodec
from framekit.link.lanes import Lanes, Shutdown
from framekit.link.output import Output
from framekit.link.receiver import Receiver
from framekit.link.reception import Dispatcher, OnFrame, Reception
from framekit.link.scope import DEFAULT_START, DeviceState, Scope
from framekit.link.sequences.compiler import program_of
from framekit.link.sequences.runtime import EngineFunctions, Machine
from framekit.link.sequences.state import Run, SessionState, State, frame_gone
from framekit.link.values import FrameValue, Names, plain

MOST_ROUNDS = 100_000
"""So many things that follow from one event, and no byte is used meanwhile, are a circle that no lane alone makes."""


class Engine:
    """One side of a line. `role` None: frames alone are sent and received.

    `server` does what requests ask for; `ask` runs services for `ask` steps; `memory` is for `store` and `memory()`.
    `device`: what engines that play the same device share. `on_frame` gets good frames that no step waited for.
    `monitor` is shown everything; without one that costs nothing. `on_fault` is shown everything but frames, `on_send`
    is told of each frame that a sequence sends; neither has frames read. `is_stream`: of the port, see `Output`.
    `deadline`: when `tick` is to be called, as it was after the last event; NEVER when nothing waits for time.
    Raises ParameterError for parameters that do not fit and KeyError for an unknown role. Nothing else here raises:
    what cannot be done is reported by outcomes and to the monitor.
    """

    def __init__(
        self,
        protocol: Protocol,
        codec: ProtocolCodec,
        role: str | None,
        *,
        params: Mapping[str, Any] | None = None,
        line: LineFormat | None = None,
        own: Any = None,
        server: RequestHandler | None = None,
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
        is_stream: bool = False,
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
        program = program_of(protocol, codec)
        table = program.table
        self._context = Names({"request": None, "buffer": b""}, self.scope)
        self.receiver = Receiver(codec, protocol, self._context, table, self._frame_trouble)
        self.output = Output(protocol.line, self.scope, self._commands, is_stream)
        self.machine = machine = Machine(self.scope, table, program.sequences, self.output)
        machine.server, machine.memory, machine.ask_service, machine.monitor = server, memory, ask, monitor
        machine.on_fault, machine.on_send = on_fault, on_send
        machine.need_names, machine.shown_later = program.need_names, program.shown_later
        self.scope.update({name: name for name in protocol.queues})
        self.scope["functions"] = EngineFunctions(machine)
        model = None if role is None else protocol.roles[role]
        machine.late.expected = program.replies_of(role)
        machine.session = SessionState(protocol.sessions.get(model.session or "") if model else None, self.scope)
        machine.session.on_end = self.output.own_line
        self.output.on_change = self._line_changed if protocol.line.has_marks else machine.line_changed
        self._port_hears_marks = False
        self.lanes = Lanes(model.lanes if model else (), machine)
        self.shutdown = Shutdown(machine, self.lanes, self.output)
        self.dispatcher = Dispatcher(machine, self.lanes)
        self.reception = Reception(self.receiver, self.dispatcher, self.counters, on_frame)
        machine.flush = self.reception.flush
        self.is_busy = False
        self.deadline = NEVER
        self._circle_at = -1

    # ---- events -------------------------------------------------------------------------------------------

    def opened(self, now: int) -> list[Command]:
        """The port, or the connection, is there, with the line's own speed and format."""
        self.scope.now = now
        if self.scope.line.line != self.scope.line.own:
            self.scope.change_line(self.scope.line.own)
        self.receiver.reset()
        self.receiver.hear_marks(self._hears_marks)
        self.machine.late.forget()
        self.machine.is_open = self.output.is_open = True
        self.lanes.was_closed = False
        self.machine.stirred = True
        self.machine.show("open")
        self.output.poll()
        return self._finish()

    def hear_marks(self) -> None:
        """Of the port, before it opens: it tells the ninth bits of characters."""
        self._port_hears_marks = True

    @property
    def _hears_marks(self) -> bool:
        line = self.scope.line.line
        return self._port_hears_marks and self.protocol.line.has_marks and line is not None and line.has_marks

    def _line_changed(self, change: ChangeLine, is_other: bool) -> None:
        if is_other:
            self.receiver.hear_marks(self._hears_marks)
        self.machine.line_changed(change, is_other)

    def closed(self, now: int, reason: str = "") -> list[Command]:
        """The connection is gone; what was to be sent is dropped, and a run that does not handle it fails."""
        self.scope.now = now
        self.machine.is_open = self.output.is_open = False
        self.lanes.was_closed = True
        self.machine.show("closed", reason=reason)
        self.output.clear()
        for run in self.lanes.order:
            run.unsent = 0
        self.reception.show_noise(self.receiver.reset())
        self.machine.session.end()
        self.dispatcher.closed(reason or "the connection is closed")
        self.lanes.fail_waiting("closed", reason)
        self.machine.late.forget()
        return self._finish()

    def receive(self, data: bytes, now: int, faults: Iterable[CharacterFault] = ()) -> list[Command]:
        """Bytes came, the last of them at `now`; `faults` names damaged characters among them."""
        if self.deadline < now:
            self._tick(now)
        self.scope.now = self.output.last_received = now
        self.receiver.append(data, now, faults)
        self.machine.is_idle = False
        if data:
            for run in self.lanes.order:
                if run.state is State.PAUSING:
                    self.dispatcher.byte()
                    break
        return self._finish()

    def other_sender(self, now: int) -> list[Command]:
        """What comes from now on comes from another sender. What had come before of a frame belongs to nothing."""
        self.scope.now = now
        self.reception.show_noise(self.receiver.flush())
        return self._finish()

    def line_break(self, now: int) -> list[Command]:
        """The line was in break state. What had come before of a frame belongs to nothing."""
        self.scope.now = self.output.last_received = now
        self.reception.show_noise(self.receiver.flush())
        self.machine.show("break", "in")
        self.dispatcher.line_break()
        return self._finish()

    def sent(self, now: int) -> list[Command]:
        """The last bit of the oldest command to send, or of a break, has left (not of those sent inside others)."""
        self.scope.now = now
        machine = self.machine
        items = self.output.left()
        if items and not machine.is_idle:
            self.receiver.answered()
        for item in items:
            if item.run is not None:
                machine.left(item.run)
            if type(item) is Send and item.on_sent is not None:
                machine.callbacks.append(item.on_sent)
        return self._finish()

    def control(self, lines: Mapping[str, bool], now: int) -> list[Command]:
        """The control lines as they are now (cts, dsr, dcd, ri). Without clear-to-send nothing is sent."""
        self.scope.now = now
        self.output.clear_to_send = lines.get("cts", True)
        self.output.poll()
        return self._finish()

    def tick(self, now: int) -> list[Command]:
        """Time has passed; to be called when `deadline` is reached."""
        self._tick(now)
        return self._finish()

    # ---- what is asked of it ------------------------------------------------------------------------------

    def start(self, exchange: Exchange, now: int) -> list[Command]:
        """Queues an exchange; it begins when its lane has room. Its outcome comes by `ended`."""
        scope, machine = self.scope, self.machine
        if now > scope.now:
            scope.now = now
        run = machine.asking if exchange.inside is None else exchange.inside.run
        lane = self.lanes.lane_of.get(exchange.run)
        if run is not None and run.state is State.ASKING:
            machine.start_inside(run, exchange)
        elif lane is None:
            machine.tell(exchange, Outcome(False, "no_sequence", f"role '{self.role}' runs no such exchange"))
        elif self.lanes.was_closed:
            machine.tell(exchange, Outcome(False, "closed", "the connection is closed"))
        else:
            lane.waiting.append(exchange)
        machine.changed = machine.stirred = True
        return self._finish()

    def cancel(self, exchange: Exchange, now: int) -> list[Command]:
        """Ends an exchange, begun or not; what has been handed over for sending still goes out.

        If its reply is due, other requests wait for that.
        """
        self.scope.now = max(self.scope.now, now)
        self.lanes.cancel(exchange)
        return self._finish()

    def give_up(self, exchange: Exchange, now: int) -> list[Command]:
        """An exchange is given up by its caller. What has been asked is waited for, but not asked again."""
        self.scope.now = max(self.scope.now, now)
        self.lanes.give_up(exchange)
        return self._finish()

    def send_frame(
        self,
        frame: FrameValue | str,
        now: int,
        fields: Mapping[str, Any] | None = None,
        on_sent: Callable[[], None] | None = None,
    ) -> list[Command]:
        """Sends a frame by itself. Raises ValueError for values that it cannot carry, KeyError for an unknown frame."""
        scope, machine = self.scope, self.machine
        scope.now = max(scope.now, now)
        table = machine.table
        value = None if isinstance(frame, str) else frame
        info = table.infos[frame if isinstance(frame, str) else frame.frame]
        given = table.completed(info, dict(fields or {}), scope) if value is None else value.fields
        data = info.encode(given if info.flat else plain(given), scope)

        def put_out() -> None:
            if info.announces or machine.monitor is not None:
                shown = value or FrameValue(info.name, given)
                table.mark_sent(shown, data, scope)
                machine.announce(shown)
                machine.show_sent(shown, data)
            self.counters.sent += 1
            self.output.put(Send(data, 0, False, None, info, on_sent))

        self._send_in_turn(value or FrameValue(info.name, given), put_out)
        return self._finish()

    def _send_in_turn(self, value: FrameValue, put_out: Callable[[], None]) -> None:
        """Puts a frame out that is sent by itself, or keeps it while a reply is due that its own could be taken for."""
        late = self.machine.late
        if late.items or late.asked(value, any(run.asked is not None for run in self.lanes.order)):
            late.items.append(partial(self._send_in_turn, value, put_out))
        else:
            put_out()

    @property
    def has_session(self) -> bool:
        """Whether its role has sessions: one may have to be closed."""
        return self.machine.session.session is not None

    def close_session(self, now: int, on_done: Callable[[], None] = lambda: None) -> list[Command]:
        """Closes an open session as soon as no exchange runs or waits; `on_done` is called once, when all is sent."""
        self.scope.now = max(self.scope.now, now)
        self.shutdown.ask(on_done)
        return self._finish()

    @property
    def last_frame(self) -> int:
        """When the last good frame came or went (ns); at first when the engine was made."""
        return self.machine.last_frame

    @property
    def held_until(self) -> int:
        """Until when nothing is asked for because a reply is due (ns)."""
        return self.machine.late.until

    def status(self) -> dict[str, Any]:
        """Published variables; those of a device on a device alone: a client has no value of them."""
        return self.scope.published(of_device=self.machine.server is not None)

    # ---- time and what follows ---------------------------------------------------------------------

    def _keep_alive_at(self) -> int:
        """When the session has to be kept alive; never while there is other traffic under way."""
        session = self.machine.session
        if session.keep_alive is None or self.output.outgoing is not None or not self.lanes.is_free:
            return NEVER
        return session.keep_alive_at(self.output.quiet_since)

    # ---- what follows -------------------------------------------------------------------------------------

    def _finish(self) -> list[Command]:
        """Everything that follows and takes no time; then the commands, in order. Inside of itself it does nothing."""
        if self.is_busy:
            return []
        machine, deadline = self.machine, NEVER
        if (
            machine.stirred
            or not machine.is_idle
            or machine.ended
            or machine.callbacks
            or machine.delivered
            or machine.queues.is_due
            or self.shutdown.on_done is not None
        ):
            self.is_busy = True
            try:
                self._settle()
            finally:
                self.is_busy = False
        for run in self.lanes.order:
            if run.deadline < deadline:
                deadline = run.deadline
        if self.lanes.is_holding:
            deadline = min(deadline, self.lanes.held_until)
        if not machine.is_idle and self.reception.expected is not None:
            deadline = min(deadline, self.receiver.deadline)
        if machine.late.items:
            deadline = min(deadline, machine.late.until)
        if machine.session.keep_alive is not None:
            deadline = min(deadline, self._keep_alive_at())
        if machine.callbacks or machine.ended:  # a circle: the rest comes later
            deadline = self.scope.now
        self.deadline = deadline
        if not self._commands:
            return []
        commands = self._commands.copy()
        self._commands.clear()
        return commands

    def _settle(self) -> None:
        machine, lanes, receiver = self.machine, self.lanes, self.receiver
        for _ in range(MOST_ROUNDS):
            if machine.ended:
                lanes.settle_ended()
            elif machine.callbacks:
                machine.callbacks.popleft()()
            elif machine.stirred and lanes.begin_what_can():
                continue
            elif machine.delivered:
                value = machine.delivered.popleft()
                if not self.dispatcher.offer(value):
                    self.reception.unsolicited(value)
            elif machine.queues.is_due and self.dispatcher.queue_rows():
                continue
            else:
                if not machine.is_idle:
                    found = self.reception.next_arrival()
                    machine.is_idle = receiver.is_idle
                    if found:
                        continue
                else:  # what to look for is worked out when something comes
                    for run in lanes.order:
                        if run.candidate is not None and run.state is State.RECEIVING:
                            frame_gone(run, self.scope.now)
                if self.shutdown.on_done is None or not self.shutdown.go_on():
                    return
        place = receiver.stream.offset
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
        now = self.scope.now = max(now, self.scope.now)
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
        if self.reception.expected is not None and receiver.deadline <= now:
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

    def _time_up(self, run: Run) -> None:
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
