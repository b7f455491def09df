"""The link engine of one side of a line: events in, commands out (guide: receiving, sequences, roles).

Sans-I/O: it has no clock, port or task. Events of one instant are handled in the order of the driver's calls (bytes
before times that run out at that instant). After each event, all effects that take no time follow: callbacks of
finished exchanges, lanes that can begin, delivered frames, queues, then the next frame in the bytes at hand. When times
run out: the receiver's first, then those of runs, earliest first and in the order of the lanes, then the session's
keep-alive.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Mapping
from datetime import datetime
from functools import partial
from operator import itemgetter
from typing import Any

from framekit.codec.shown import explain
from framekit.definition.model.protocol import Protocol
from framekit.definition.times import NEVER, LineFormat, parse_format
from framekit.link.ahead import Ahead
from framekit.link.arrivals import BadFrame, Noise
from framekit.link.events import (
    Ask,
    Break,
    ChangeLine,
    CharacterFault,
    Command,
    Exchange,
    LinkCounters,
    MemoryAccess,
    Monitor,
    Outcome,
    Reopen,
    RequestHandler,
    Send,
)
from framekit.link.frame_table import ProtocolCodec
from framekit.link.lanes import Lanes
from framekit.link.overdue import Latest
from framekit.link.own_echo import OWN_ECHO, EchoState, OwnEcho, Prove
from framekit.link.receiver import Receiver
from framekit.link.reception import OnFrame, Reception
from framekit.link.scope import DEFAULT_START, DeviceState, Scope
from framekit.link.sequences.compiler import program_of
from framekit.link.sequences.runtime import QUEUES, EngineFunctions, Machine
from framekit.link.sequences.state import (
    BREAK,
    BYTE,
    CLOSED,
    NOISE,
    NOT_SENT,
    LaneState,
    Other,
    Run,
    State,
    after,
)
from framekit.link.values import FrameValue, Names, plain

RECEIVING, PAUSING, HELD, DONE = State.RECEIVING, State.PAUSING, State.HELD, State.DONE
SILENT = State.SILENT

MOST_ROUNDS = 100_000
"""So many things that follow from one event, and no byte is used meanwhile, are a circle that no lane alone makes."""


LATE = "late: the reply to a request that is over"

MOST_HELD = 262_144
"""So many bytes are kept for runs that will wait later but do not wait yet."""


class Engine:
    """One side of a line. `role` None: frames alone are sent and received.

    `server` serves requests; `ask` runs services for `ask` steps; `memory` is for `store` and `memory()`.
    `device`: the state shared by engines of the same device. `on_frame` gets good frames that no step waited for.
    `monitor` gets a record of everything. `on_fault` gets all records but frames, `on_send` is called for each frame
    that a sequence sends; neither has frames decoded. `is_stream`: of the port, see `Output`.

    The parts: `machine` executes the sequences, `lanes` starts exchanges and offers frames to the runs, `reception`
    looks for frames in arriving bytes.

    Raise ParameterError for parameters that do not fit and KeyError for an unknown role. No other method raises:
    failures are reported by outcomes and to the monitor.
    """

    prove: Prove
    """Set by the client of the engine."""

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
        scope = Scope(
            protocol, role=role, own=own, line=line, params=params, now=now, clock_start=clock_start, device=device
        )
        program = program_of(protocol, codec)
        model = None if role is None else protocol.roles[role]
        session = protocol.sessions.get(model.session or "") if model else None
        context = Names({"request": None, "buffer": b""}, scope)
        receiver = Receiver(codec, protocol, context, program.table, self._frame_trouble)
        self.machine = machine = Machine(
            protocol, scope, program, receiver, session, is_stream=is_stream, server=server, memory=memory,
            ask_service=ask, monitor=monitor, on_fault=on_fault, on_send=on_send, counters=counters,
        )  # fmt: skip
        self.scope, self.table, self.ready, self.output = scope, machine.table, machine.ready, machine.output
        self.late, self.session, self.counters = machine.late, machine.session, machine.counters
        self.need_names = machine.need_names
        self.receiver = receiver
        scope.update({name: name for name in protocol.queues})
        scope["functions"] = EngineFunctions(machine)
        self.late.expected = program.replies_of(role)
        self.late.ahead = Ahead(codec, protocol, context, receiver)
        self.reception = Reception(machine, on_frame)
        self.lanes = Lanes(machine, self.reception, model.lanes if model else ())
        self.on_bad: Callable[[BadFrame], None] | None = None
        """Gets bad frames that no step waited for."""
        self.session.on_end = self.output.own_line
        self.output.on_change = self._line_changed if protocol.line.has_marks else machine.line_changed
        self._port_hears_marks = False
        self._announcing = frozenset(info.name for info in self.table.infos.values() if info.announces)
        self.was_closed = False
        self.is_busy = False
        """Whether effects of an event are being handled."""
        self.deadline = NEVER
        """The time of the next `tick`, as of the last event, or NEVER."""
        self._circle_at = -1

    # ---- events -------------------------------------------------------------------------------------------

    def opened(self, now: int) -> list[Command]:
        """Note that the port or the connection is open, with the line's own speed and format."""
        self.scope.now = now
        if self.scope.line.line != self.scope.line.own:
            self.scope.change_line(self.scope.line.own)
        self.receiver.reset()
        self.receiver.hear_marks(self._hears_marks)
        self.late.heard_until = now
        self._forget_echo()
        self.output.is_open = True
        self.was_closed = False
        self.machine.show("open")
        self.output.poll()
        self.lanes.stir_all()
        return self._finish()

    def _forget_echo(self) -> None:
        echo = self.machine.own_echo
        echo.forget()
        self.machine.echo = None if echo.state is EchoState.ABSENT else echo

    @property
    def own_echo(self) -> OwnEcho:
        """Return the echo of the line, as far as it is known."""
        return self.machine.own_echo

    def examine_replies(self, has_exact_times: bool) -> None:
        """Examine replies that equal their request from now on: the line may have an echo (`OwnEcho`)."""
        self.machine.own_echo = OwnEcho(EchoState.UNKNOWN, has_exact_times)
        self._forget_echo()

    def hear_marks(self) -> None:
        """Note, before the port opens, that it reports the ninth bits of characters."""
        self._port_hears_marks = True

    def hear_late(self) -> None:
        """Note, before the port opens, that a time of bytes is the time of their reading, not of their arrival."""
        self.receiver.has_exact_times = False

    @property
    def _hears_marks(self) -> bool:
        line = self.scope.line.line
        return self._port_hears_marks and self.protocol.line.has_marks and line is not None and line.has_marks

    def _line_changed(self, change: ChangeLine, is_other: bool) -> None:
        if is_other:
            self.receiver.hear_marks(self._hears_marks)
        self.machine.line_changed(change, is_other)

    @property
    def good_frames(self) -> int:
        """Return the number of good frames received so far."""
        return self.counters.received

    def closed(self, now: int, reason: str = "") -> list[Command]:
        """Note that the connection is gone: drop the output, and fail each run that does not handle that."""
        self.scope.now = now
        self.output.is_open = False
        self.was_closed = True
        self.machine.show("closed", reason=reason)
        self.output.clear()
        for run in self.machine.order:
            run.unsent = 0
        self.reception.show_noise(self.receiver.reset())
        self.session.end()
        for run in self.machine.order:
            if run.state is not DONE:
                run.cause = reason or "the connection is closed"
                if not self.lanes.handle(run, "on_closed", CLOSED):
                    self.machine.fail_run(run, "closed")
        self.lanes.fail_waiting("closed", reason)
        self.late.disconnected()
        return self._finish()

    def receive(self, data: bytes, now: int, faults: Iterable[CharacterFault] = ()) -> list[Command]:
        """Handle arriving bytes, the last of them at `now`; `faults` names damaged characters among them.

        Bytes come before time limits that have run out and were not ticked: a busy process reads them late. For the
        same reason only `tick` ends a frame by a pause, unless the times of the port are exact.
        """
        if self.deadline < now and self.receiver.has_exact_times:
            self._end_frames(now)
        self.scope.now = self.output.last_received = now
        self.receiver.append(data, now, faults)
        if data:
            for run in self.machine.order:
                if run.state is PAUSING and "on_byte" in run.top.wait.events:
                    self.machine.go(run, run.top, BYTE)
        return self._finish()

    def other_sender(self, now: int) -> list[Command]:
        """Note that following bytes come from another sender; the beginning of a frame before them is noise."""
        self.scope.now = now
        self.reception.drop()
        return self._finish()

    def line_break(self, now: int) -> list[Command]:
        """Note that the line was in break state. It ends a frame: a frame that shows its own end is good.

        A frame that it breaks off is shown and counted as bad; runs handle the break only. An exchange that begins
        because the frame before the break was good does not handle it.
        """
        self.scope.now = self.output.last_received = now
        runs = [(run, run.exchange) for run in self.machine.order if run.state is not DONE]
        if self.receiver.has_unread:
            self.receiver.broke(now)
            self.is_busy = True
            try:
                self._settle_cut()
            finally:
                self.is_busy = False
        self.reception.drop()
        self.machine.show("break", "in")
        for run, exchange in runs:
            if run.state is not DONE and run.exchange is exchange:
                self.lanes.handle(run, "on_break", BREAK)
        return self._finish()

    def sent(self, now: int) -> list[Command]:
        """Note that the last bit of the oldest queued command or break has left.

        Commands sent inside others are not reported by themselves.
        """
        self.scope.now = now
        output = self.output
        item = output.left()
        if item is None:
            return self._finish()
        self._has_left(item, now)
        if output.joined:
            joined, output.joined = output.joined, []
            for other in joined:
                self._has_left(other, now)
        elif item.run is None or self.is_busy or self.ready or self.lanes.keeps_times:
            pass
        elif not self.receiver.has_unread:
            return self._only_clocks(item.run)
        if self.receiver.has_unread:
            self.receiver.answered()
        return self._finish()

    def _only_clocks(self, run: Run) -> list[Command]:
        """Do as `_finish` where the only effect of an event is that the clock of a run begins."""
        if run.deadline < self.deadline:
            self.deadline = run.deadline
        commands = self.output.commands
        if commands:
            self.output.commands = []
        return commands

    def _has_left(self, item: Send | Break, now: int) -> None:
        """Note that the last bit of something has left: the clock of its run may begin."""
        run = item.run
        if run is None:
            if type(item) is Send and item.on_sent is not None:
                self.ready.append(item.on_sent)
            return
        if run.unsent > 1:
            run.unsent -= 1
            return
        run.unsent = 0
        if not run.clock_waits or run.state is DONE:
            return
        run.clock_waits, run.started = False, now
        if run.state is PAUSING:
            run.deadline = after(now, run.pause)
        elif (longest := run.longest) < NEVER:
            run.within = within = now + longest
            if run.candidate is None:
                run.deadline = within

    def control(self, lines: Mapping[str, bool], now: int) -> list[Command]:
        """Set the control lines (cts, dsr, dcd, ri). Frames are sent only while clear-to-send is on."""
        self.scope.now = now
        self.output.clear_to_send = lines.get("cts", True)
        if self.output.clear_to_send:
            self.output.held_until = NEVER
        self.output.poll()
        return self._finish()

    def tick(self, now: int) -> list[Command]:
        """Handle the passage of time; call this when `deadline` is reached, after all bytes that arrived before."""
        self._tick(now)
        return self._finish()

    # ---- requests -----------------------------------------------------------------------------------------

    def start(self, exchange: Exchange, now: int) -> list[Command]:
        """Queue an exchange; it begins when its lane has room. Its outcome comes by `ended`."""
        machine, scope, lanes = self.machine, self.scope, self.lanes
        if now > scope.now:
            scope.now = now
        lane = lanes.lane_of.get(exchange.run)
        if machine.asking is not None or exchange.inside is not None:
            run = machine.asking if exchange.inside is None else exchange.inside.run
            if run is not None and run.state is State.ASKING:
                machine.start_inside(run, exchange)
                return self._finish()
        if lane is None:
            machine.tell(exchange, Outcome(False, "no_sequence", f"role '{self.role}' runs no such exchange"))
        elif self.was_closed:
            machine.tell(exchange, Outcome(False, "closed", "the connection is closed"))
        elif (
            self.is_busy or self.ready or lane.spare is None or lane.waiting
            or self.session.busy or not self.output.is_open
        ):  # fmt: skip
            lane.waiting.append(exchange)
            machine.stir(lane)
        else:
            self.is_busy = True
            try:
                lanes.begin_exchange(lane, exchange)
            finally:
                self.is_busy = False
            if not self.ready and not lanes.keeps_times and not self.receiver.has_unread:
                return self._only_clocks(lane.running[-1])
        return self._finish()

    def cancel(self, exchange: Exchange, now: int) -> list[Command]:
        """End an exchange, begun or not; frames handed over for sending still go out.

        If its reply is due, other requests wait for the reply.
        """
        self.scope.now = max(self.scope.now, now)
        self.lanes.cancel(exchange)
        return self._finish()

    def give_up(self, exchange: Exchange, now: int) -> list[Command]:
        """Note that the caller has given up an exchange: its reply is awaited, but no request is repeated."""
        self.scope.now = max(self.scope.now, now)
        self.lanes.give_up(exchange)
        return self._finish()

    def leave_line(self, now: int) -> None:
        """Note that another engine may use the line from now on: replies to exchanges under way will be late there."""
        self.scope.now = max(self.scope.now, now)
        for run in self.machine.order:
            if run.asked is not None:
                self.late.miss(run, run.asked)

    def send_frame(
        self,
        frame: FrameValue | str,
        now: int,
        fields: Mapping[str, Any] | None = None,
        on_sent: Callable[[], None] | None = None,
    ) -> list[Command]:
        """Send a frame by itself. Raise ValueError for values that it cannot carry, KeyError for an unknown frame."""
        scope, table = self.scope, self.table
        scope.now = max(scope.now, now)
        value = None if isinstance(frame, str) else frame
        info = table.infos[frame if isinstance(frame, str) else frame.frame]
        given = table.completed(info, dict(fields or {}), scope) if value is None else value.fields
        data = info.encode(given if info.flat else plain(given), scope)

        def put_out() -> None:
            if info.announces or self.machine.monitor is not None:
                shown = value or FrameValue(info.name, given)
                table.mark_sent(shown, data, scope)
                self.machine.announce(shown)
                self.machine.show_sent(shown, data)
            self.counters.sent += 1
            self.output.put(Send(data, 0, False, None, info, on_sent))

        self._send_in_turn(value or FrameValue(info.name, given), put_out)
        return self._finish()

    def _send_in_turn(self, value: FrameValue, put_out: Callable[[], None]) -> None:
        """Send a frame outside of exchanges, or keep it while a reply is due that could be taken for its own reply."""
        late = self.late
        if late.items or late.sent_alone(value, any(run.asked is not None for run in self.machine.order)):
            late.items.append(partial(self._send_in_turn, value, put_out))
        else:
            put_out()

    @property
    def has_session(self) -> bool:
        """Return whether its role has sessions: one may have to be closed."""
        return self.session.session is not None

    def close_session(self, now: int, on_done: Callable[[], None] = lambda: None) -> list[Command]:
        """Close an open session as soon as no exchange runs or waits; `on_done` is called once, when all is sent."""
        self.scope.now = max(self.scope.now, now)
        self.lanes.on_shut = on_done
        self.lanes.keeps_times = True
        return self._finish()

    @property
    def held_until(self) -> int:
        """Return until when no request is sent because a reply is due (ns)."""
        return self.late.until

    def status(self) -> dict[str, Any]:
        """Return the published variables; a client has no values of the variables of a device."""
        return self.scope.published(of_device=self.machine.server is not None)

    def await_frames(self, names: Iterable[str]) -> None:
        """Want these frames at any time from now on, in addition to the frames of waiting steps."""
        self.reception.await_frames(names)

    # ---- effects ------------------------------------------------------------------------------------------

    def _finish(self) -> list[Command]:
        """Do all that follows and takes no time; return the commands, in order. A nested call returns no command."""
        if self.is_busy:
            return []
        ready, lanes = self.ready, self.lanes
        receiver = self.receiver
        if ready or receiver.has_unread or lanes.keeps_times:
            self.is_busy = True
            try:
                self._settle(ready)
            finally:
                self.is_busy = False
        deadline = NEVER
        for run in self.machine.order:
            if run.deadline < deadline:
                deadline = run.deadline
        if receiver.has_unread and self.reception.looked is not None:
            deadline = min(deadline, receiver.deadline)
        if ready or lanes.keeps_times or self.late.items:
            deadline = min(deadline, self._other_deadline())
        self.deadline = deadline
        commands = self.output.commands
        if commands:
            self.output.commands = []
        return commands

    def _other_deadline(self) -> int:
        deadline = min(self.late.until if self.late.items else NEVER, self.output.held_until)
        if self.session.keep_alive is not None:
            deadline = min(deadline, self._keep_alive_at())
        if self.lanes.is_holding:
            deadline = min(deadline, self.lanes.held_until)
        return self.scope.now if self.ready else deadline  # a circle: the rest comes later

    def _settle(self, ready: deque[Any]) -> None:
        """Handle the items of the ready queue, then the arrivals in the bytes at hand, until neither is left."""
        lanes, receiver = self.lanes, self.receiver
        for _ in range(MOST_ROUNDS):
            if ready:
                item = ready.popleft()
                kind = type(item)
                if kind is Run:
                    lanes.over(item)
                elif kind is LaneState:
                    lanes.fill(item)
                elif kind is FrameValue:
                    if not lanes.offer(item):
                        self._unsolicited(item, self._is_overdue(item))
                elif item is QUEUES:
                    lanes.offer_queues()
                else:
                    item()
            elif not (receiver.has_unread and self._next_arrival()) and (lanes.on_shut is None or not lanes.shut()):
                return
        place = self.receiver.stream.offset
        if place != self._circle_at:
            self._circle_at = place
            self._settle(ready)
            return
        self.machine.show("trouble", reason="one event leads to another without end")

    def _frame_trouble(self, frame: str, error: Exception) -> None:
        self.machine.show("trouble", frame=frame, reason=explain(error))

    # ---- arrivals -----------------------------------------------------------------------------------------

    def _next_arrival(self) -> bool:
        """Handle the next arrival in the bytes at hand. Return False if there is no arrival yet."""
        receiver = self.receiver
        reception = self.reception
        machine = self.machine
        order = machine.order
        if len(order) != 1 or (run := order[0]).plan is not reception.plan or run.state is not RECEIVING:
            reception.look_for()
        if reception.looked is None:
            if len(receiver.stream.buffer) > MOST_HELD:
                reception.drop_stale()
            return False
        event = receiver.next_of(reception.looked)
        if type(event) is FrameValue:
            self.counters.received += 1
            machine.last_frame = self.scope.now
            if machine.monitor is not None:
                machine.show_received(event, event.raw or b"", receiver.given_since)
            if event.frame in self._announcing:
                machine.accept(event)
            if not self.lanes.offer(event):
                self._not_taken(event)
        elif event is None:
            reception.note_progress()
            return False
        else:
            if isinstance(event, BadFrame):
                self._bad(event)
            elif isinstance(event, Noise):
                reception.show_noise([event])
                if not event.skipped:
                    any(self.lanes.handle(run, "on_noise", NOISE) for run in machine.order if run.state is RECEIVING)
            if receiver.broken:
                self.output.commands.append(Reopen(f"received bytes are no frames of '{self.protocol.name}'"))
        if reception.has_candidates and not receiver.has_unread:
            reception.drop_candidates()
        return True

    def _not_taken(self, value: FrameValue) -> None:
        """Handle a good frame that no row has taken yet: it may be another frame, or late."""
        receiver, late = self.receiver, self.late
        while (other := receiver.other_reading()) is not None:
            if other.value.frame in self._announcing:
                self.machine.accept(other.value)
            if self.lanes.offer(other.value):
                return
        if self._is_own_echo(value):
            if not self._handled_as_other(value):
                self.counters.not_taken += 1
                self.machine.show("not_taken", "in", value.raw or b"", value.frame, reason=OWN_ECHO)
            return
        is_awaited = value.frame in self.reception.awaited
        if late.open or late.numbered.is_watching:
            late.latest = self._latest()
        found = late.came(value, is_awaited)
        if found is None:
            self._note_unfit(value)
        is_late = found is not None and not found.by_itself
        for run in self.machine.order:
            if run.state is SILENT and found is not None:
                run.doubt.extra = self.scope.now
        is_taken = not is_late and self._handled_as_other(value)
        if is_awaited and not is_late:
            self.reception.hand_over(value)
        elif not is_taken:
            self._unsolicited(value, is_late)
        if found is not None and late.held_until(found.station) <= self.scope.now:
            self.lanes.release()

    def _is_overdue(self, value: FrameValue) -> bool:
        """Return whether a frame out of a queue is the late reply to a request with its number, and note that."""
        late = self.late
        if not late.numbered.is_watching:
            return False
        late.latest = self._latest()
        return late.answers_overdue(value) is not None

    def _latest(self) -> Latest:
        """Return when the last request left that waits for its reply, or whose reply is in doubt, and its exchange."""
        runs = [run for run in self.machine.order if run.state is RECEIVING or run.state is SILENT]
        return max(
            ((run.started, run.top.x) for run in runs if run.top.x.checks_echo), key=itemgetter(0), default=(0, None)
        )

    def _is_own_echo(self, value: FrameValue) -> bool:
        """Return whether a frame has the bytes of the request that a run waits for; its cause says so."""
        found = False
        for run in self.machine.order:
            sent = run.top.x.last_sent if run.state is RECEIVING and run.top.x.checks_echo else None
            if sent is not None and sent.raw == value.raw:
                run.cause, found = OWN_ECHO, True  # if no reply follows
                if self.own_echo.heard(run):
                    self.machine.echo = self.own_echo
        return found

    def _handled_as_other(self, value: FrameValue) -> bool:
        """Let the runs that wait handle a frame that no row takes; return whether a run did."""
        for run in self.machine.order:
            if run.state is RECEIVING and self.lanes.handle(run, "on_other", Other(value)):
                return True
        return False

    def _note_unfit(self, value: FrameValue) -> None:
        """Note a frame that a run waits for, and that repeats another request than the one of the run."""
        for run in self.machine.order:
            x = run.top.x if run.state is RECEIVING and value.frame in run.expected else None
            if x is not None and x.checks_echo:
                difference = self.table.difference(value, [one for one in (x.asked, x.last_sent) if one is not None])
                if difference:
                    run.unusable_replies().add_unfit(value.frame, difference)
                    run.cause = str(run.unusable)

    def _unsolicited(self, value: FrameValue, is_late: bool = False) -> None:
        """Count and show a good frame that no row took. A late reply is no frame that came by itself."""
        self.counters.not_taken += 1
        self.counters.late += is_late
        if is_late or self.machine.live:
            self.machine.show("not_taken", "in", value.raw or b"", value.frame, reason=LATE if is_late else "")
        if not is_late:
            self.reception.hand_over(value)

    def _bad(self, bad: BadFrame) -> None:
        """Note a bad frame, and offer it to the runs that wait."""
        self.reception.note_bad(bad)
        on_bad = self.on_bad
        if not self.reception.cutting and not self.lanes.offer_bad(bad) and on_bad is not None:
            self.ready.append(partial(on_bad, bad))

    # ---- time ---------------------------------------------------------------------------------------------

    def _end_frames(self, now: int) -> None:
        """End the frames that a pause before `now` ends. Other times wait for `tick`: the bytes may be older."""
        self.is_busy = True
        try:
            for _ in range(MOST_ROUNDS):
                if self.reception.looked is None or self.receiver.deadline > now:
                    return
                self.scope.now = max(self.scope.now, now)
                self.receiver.tick(now)
                self._settle(self.ready)
        finally:
            self.is_busy = False

    def _settle_cut(self) -> None:
        """Settle with the end of the frame at hand: a frame that is not complete is only shown and counted as bad."""
        self.reception.cutting = True
        try:
            self._settle(self.ready)
        finally:
            self.reception.cutting = False

    def _tick(self, now: int) -> None:
        """Handle everything that is due, in the documented order; also times that become due at the same instant."""
        now = self.scope.now = self.late.heard_until = max(now, self.scope.now)
        self.lanes.stir_all()
        self.is_busy = True
        try:
            self._settle(self.ready)
            for _ in range(MOST_ROUNDS):
                if not self._something_due(now):
                    return
                self._settle(self.ready)
        finally:
            self.is_busy = False

    def _something_due(self, now: int) -> bool:
        receiver = self.receiver
        if self.reception.looked is not None and receiver.deadline <= now:
            receiver.tick(now)
            return True
        if self.output.held_until <= now:
            self._hold_over()
            return True
        order = self.machine.order
        due = min((run for run in order if run.deadline <= now), key=lambda run: run.deadline, default=None)
        if due is not None:
            self._time_up(due)
            return True
        if self.late.items and self.late.until <= now:
            self.lanes.release()
            return True
        return self._keep_alive_at() <= now and self._keep_alive()

    def _time_up(self, run: Run) -> None:
        """Break off a frame that is arriving, then end the wait; a good frame may still be found in its bytes."""
        number = run.wait_number
        if run.state is HELD:
            self.lanes.hold_over(run)
            return
        if run.state is SILENT:
            self.machine.silence_over(run)
            return
        if run.state is RECEIVING and run.candidate is not None:
            run.deadline = NEVER
            run.cause = "a frame began and was not completed in time"
            self.receiver.cut()
            self.receiver.tick(self.scope.now)
            self._settle_cut()
            if run.state is not RECEIVING or run.wait_number != number:
                return
        self.machine.time_up(run)

    def _hold_over(self) -> None:
        """Drop the frames that clear-to-send has held back too long, and fail each run that does not handle that."""
        held = self.output.drop_held()
        reason = "clear-to-send stays off"
        self.machine.show("trouble", reason=f"{reason}; frames not sent: {len(held)}")
        for run, item in {item.run: item for item in held}.items():
            if run is None or run.state is DONE:
                continue
            run.cause, run.unsent = reason, 1
            self._has_left(item, self.scope.now)  # nothing is left to send, so the time limits of the run begin
            if not self.lanes.handle(run, "on_held", NOT_SENT):
                self.machine.fail_run(run, "held")

    def _keep_alive_at(self) -> int:
        """Return when the session has to be kept alive; never while there is other traffic under way."""
        session = self.session
        if session.keep_alive is None or self.output.outgoing is not None or not self.lanes.is_free:
            return NEVER
        return session.keep_alive_at(self.output.quiet_since)

    def _keep_alive(self) -> bool:
        session = self.session
        if session.session is None or session.session.keep_alive_run is None:
            return False
        names = (session.session.keep_alive_run,)
        return self.lanes.begin_sequences("keep_alive", names, session.station) is not None
