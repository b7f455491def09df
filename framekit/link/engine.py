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
from typing import Any

from framekit.codec.shown import explain
from framekit.definition.model.protocol import Protocol
from framekit.definition.times import NEVER, LineFormat, parse_format
from framekit.link.arrivals import BadFrame, FrameArrived, Noise, ToldBytes
from framekit.link.candidates import ExpectedFrames
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
    Tape,
)
from framekit.link.frame_table import ProtocolCodec
from framekit.link.lanes import Lanes
from framekit.link.receiver import Receiver
from framekit.link.scope import DEFAULT_START, DeviceState, Scope
from framekit.link.sequences.compiler import program_of
from framekit.link.sequences.runtime import QUEUES, EngineFunctions
from framekit.link.sequences.state import (
    BREAK,
    BYTE,
    CLOSED,
    NOISE,
    Bad,
    Item,
    LaneState,
    Other,
    Plan,
    Run,
    SessionState,
    State,
    after,
    frame_arriving,
    frame_gone,
)
from framekit.link.values import FrameValue, Names, plain

RECEIVING, PAUSING, HELD, DONE = State.RECEIVING, State.PAUSING, State.HELD, State.DONE
SILENT = State.SILENT

OnFrame = Callable[[FrameValue], None]

MOST_ROUNDS = 100_000
"""So many things that follow from one event, and no byte is used meanwhile, are a circle that no lane alone makes."""

OWN_ECHO = "you hear your own request: set `echo: yes`"

LATE = "late: the reply to a request that is over"

MOST_HELD = 262_144
"""So many bytes are kept for runs that will wait later but do not wait yet."""

MOST_KNOWN = 1024
"""For so many combinations of steps that wait the expected frames are kept ready."""


class Engine(Lanes):
    """One side of a line. `role` None: frames alone are sent and received.

    `server` serves requests; `ask` runs services for `ask` steps; `memory` is for `store` and `memory()`.
    `device`: the state shared by engines of the same device. `on_frame` gets good frames that no step waited for,
    `on_bad` such bad frames. `monitor` gets a record of everything. `on_fault` gets all records but frames, `on_send`
    is called for each frame that a sequence sends; neither has frames decoded. `is_stream`: of the port, see `Output`.
    `deadline`: the time of the next `tick`, as of the last event; NEVER without one.
    Raises ParameterError for parameters that do not fit and KeyError for an unknown role. No other method raises:
    failures are reported by outcomes and to the monitor.
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
        scope = Scope(
            protocol, role=role, own=own, line=line, params=params, now=now, clock_start=clock_start, device=device
        )
        program = program_of(protocol, codec)
        model = None if role is None else protocol.roles[role]
        super().__init__(protocol, scope, program, model.lanes if model else (), is_stream)
        self.counters = LinkCounters() if counters is None else counters
        self.server, self.memory, self.ask_service, self.monitor = server, memory, ask, monitor
        self.tape = monitor if isinstance(monitor, Tape) else None
        self.on_fault, self.on_send, self.on_frame = on_fault, on_send, on_frame
        self.on_bad: Callable[[BadFrame], None] | None = None
        context = Names({"request": None, "buffer": b""}, scope)
        self.receiver = Receiver(codec, protocol, context, self.table, self._frame_trouble)
        self.receiver.on_scan = self._limit_pauses
        scope.update({name: name for name in protocol.queues})
        scope["functions"] = EngineFunctions(self)
        self.late.expected = program.replies_of(role)
        self.session = SessionState(protocol.sessions.get(model.session or "") if model else None, scope)
        self.session.on_end = self.output.own_line
        self.output.on_change = self._line_changed if protocol.line.has_marks else self.line_changed
        self._port_hears_marks = False
        self.awaited: frozenset[str] = frozenset()
        self.cutting = False
        """Frames are being broken off because a time limit has run out; they are only shown."""
        self._told = ToldBytes()
        replies = self.late.expected.frames  # first, for the bytes of one may be those of a request too
        self._all = tuple(sorted(self.table.on_line, key=lambda name: name not in replies))
        self.looked: ExpectedFrames | None = self.receiver.expect(self._all)
        self._known: dict[Any, ExpectedFrames | None] = {}
        self._plan: Plan | None = None
        self._limited: list[tuple[Run, State, int]] | None = None
        self._own_gap = True
        self._announcing = frozenset(info.name for info in self.table.infos.values() if info.announces)
        self.is_idle = True
        """No byte was left to be looked at after the last event."""
        self.is_busy = False
        self._keeps_times = self.session.keep_alive is not None
        """Effects depend on other times than those of runs: keep-alive, lanes held back, the end of the session."""
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
        self.late.forget()
        self.is_open = self.output.is_open = True
        self.was_closed = False
        self.show("open")
        self.output.poll()
        self.stir_all()
        return self._finish()

    def hear_marks(self) -> None:
        """Note, before the port opens, that it reports the ninth bits of characters."""
        self._port_hears_marks = True

    @property
    def _hears_marks(self) -> bool:
        line = self.scope.line.line
        return self._port_hears_marks and self.protocol.line.has_marks and line is not None and line.has_marks

    def _line_changed(self, change: ChangeLine, is_other: bool) -> None:
        if is_other:
            self.receiver.hear_marks(self._hears_marks)
        self.line_changed(change, is_other)

    def closed(self, now: int, reason: str = "") -> list[Command]:
        """Note that the connection is gone: drop the output, and fail each run that does not handle that."""
        self.scope.now = now
        self.is_open = self.output.is_open = False
        self.was_closed = True
        self.show("closed", reason=reason)
        self.output.clear()
        for run in self.order:
            run.unsent = 0
        self.show_noise(self.receiver.reset())
        self.session.end()
        for run in self.order:
            if run.state is not DONE:
                run.cause = reason or "the connection is closed"
                if not self._handle(run, "on_closed", CLOSED):
                    self.fail_run(run, "closed")
        self.fail_waiting("closed", reason)
        self.late.forget()
        return self._finish()

    def receive(self, data: bytes, now: int, faults: Iterable[CharacterFault] = ()) -> list[Command]:
        """Bytes came, the last of them at `now`; `faults` names damaged characters among them."""
        if self.deadline < now:
            self._tick(now)
        self.scope.now = self.output.last_received = now
        self.receiver.append(data, now, faults)
        self.is_idle = False
        if data:
            for run in self.order:
                if run.state is PAUSING and "on_byte" in run.wait.events:
                    self.go(run, run.top, BYTE)
        return self._finish()

    def other_sender(self, now: int) -> list[Command]:
        """Note that following bytes come from another sender; the beginning of a frame before them is noise."""
        self.scope.now = now
        self.show_noise(self.receiver.flush())
        return self._finish()

    def line_break(self, now: int) -> list[Command]:
        """Note that the line was in break state; the beginning of a frame before it is noise."""
        self.scope.now = self.output.last_received = now
        self.show_noise(self.receiver.flush())
        self.show("break", "in")
        for run in self.order:
            if run.state is not DONE:
                self._handle(run, "on_break", BREAK)
        return self._finish()

    def sent(self, now: int) -> list[Command]:
        """The last bit of the oldest command to send, or of a break, has left (not of those sent inside others)."""
        self.scope.now = now
        output = self.output
        item = output.left()
        if item is None:
            return self._finish()
        if not self.is_idle:
            self.receiver.answered()
        self._has_left(item, now)
        if output.joined:
            joined, output.joined = output.joined, []
            for other in joined:
                self._has_left(other, now)
            return self._finish()
        if self.is_busy or item.run is None or self.ready or self._keeps_times or not self.is_idle:
            return self._finish()
        return self._only_clocks(item.run)

    def _only_clocks(self, run: Run) -> list[Command]:
        """Do as `_finish` where the only effect of an event is that the clock of a run begins."""
        if run.deadline < self.deadline:
            self.deadline = run.deadline
        commands = self.commands
        if commands:
            self.commands = self.output.commands = []
        return commands

    def _has_left(self, item: Send | Break, now: int) -> None:
        """Note that the last bit of something has left: the clock of its run may begin."""
        run = item.run
        if run is None:
            if type(item) is Send and item.on_sent is not None:
                self.ready.append(item.on_sent)
            return
        run.unsent = unsent = run.unsent - 1 if run.unsent > 1 else 0
        if not run.clock_waits or unsent or run.state is DONE:
            return
        run.clock_waits, run.started = False, now
        if run.state is PAUSING:
            run.deadline = after(now, run.pause)
        elif run.longest < NEVER:
            run.within = now + run.longest
            if run.candidate is None:
                run.deadline = run.within

    def control(self, lines: Mapping[str, bool], now: int) -> list[Command]:
        """Set the control lines (cts, dsr, dcd, ri). Frames are sent only while clear-to-send is on."""
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
        scope = self.scope
        if now > scope.now:
            scope.now = now
        lane = self.lane_of.get(exchange.run)
        if self.asking is not None or exchange.inside is not None:
            run = self.asking if exchange.inside is None else exchange.inside.run
            if run is not None and run.state is State.ASKING:
                self.start_inside(run, exchange)
                return self._finish()
        if lane is None:
            self.tell(exchange, Outcome(False, "no_sequence", f"role '{self.role}' runs no such exchange"))
        elif self.was_closed:
            self.tell(exchange, Outcome(False, "closed", "the connection is closed"))
        elif self.is_busy or self.ready or lane.spare is None or lane.waiting or self.session.busy or not self.is_open:
            lane.waiting.append(exchange)
            self.stir(lane)
        else:
            self.is_busy = True
            try:
                self.begin_exchange(lane, exchange)
            finally:
                self.is_busy = False
            if self.is_idle and not self.ready and not self._keeps_times:
                return self._only_clocks(lane.running[-1])
        return self._finish()

    def cancel(self, exchange: Exchange, now: int) -> list[Command]:
        """End an exchange, begun or not; frames handed over for sending still go out.

        If its reply is due, other requests wait for the reply.
        """
        self.scope.now = max(self.scope.now, now)
        self.cancel_now(exchange)
        return self._finish()

    def give_up(self, exchange: Exchange, now: int) -> list[Command]:
        """Note that the caller has given up an exchange: its reply is awaited, but no request is repeated."""
        self.scope.now = max(self.scope.now, now)
        self.give_up_now(exchange)
        return self._finish()

    def send_frame(
        self,
        frame: FrameValue | str,
        now: int,
        fields: Mapping[str, Any] | None = None,
        on_sent: Callable[[], None] | None = None,
    ) -> list[Command]:
        """Sends a frame by itself. Raises ValueError for values that it cannot carry, KeyError for an unknown frame."""
        scope, table = self.scope, self.table
        scope.now = max(scope.now, now)
        value = None if isinstance(frame, str) else frame
        info = table.infos[frame if isinstance(frame, str) else frame.frame]
        given = table.completed(info, dict(fields or {}), scope) if value is None else value.fields
        data = info.encode(given if info.flat else plain(given), scope)

        def put_out() -> None:
            if info.announces or self.monitor is not None:
                shown = value or FrameValue(info.name, given)
                table.mark_sent(shown, data, scope)
                self.announce(shown)
                self.show_sent(shown, data)
            self.counters.sent += 1
            self.output.put(Send(data, 0, False, None, info, on_sent))

        self._send_in_turn(value or FrameValue(info.name, given), put_out)
        return self._finish()

    def _send_in_turn(self, value: FrameValue, put_out: Callable[[], None]) -> None:
        """Puts a frame out that is sent by itself, or keeps it while a reply is due that its own could be taken for."""
        late = self.late
        if late.items or late.sent_alone(value, any(run.asked is not None for run in self.order)):
            late.items.append(partial(self._send_in_turn, value, put_out))
        else:
            put_out()

    @property
    def has_session(self) -> bool:
        """Whether its role has sessions: one may have to be closed."""
        return self.session.session is not None

    def close_session(self, now: int, on_done: Callable[[], None] = lambda: None) -> list[Command]:
        """Closes an open session as soon as no exchange runs or waits; `on_done` is called once, when all is sent."""
        self.scope.now = max(self.scope.now, now)
        self.on_shut = on_done
        self._keeps_times = True
        return self._finish()

    @property
    def held_until(self) -> int:
        """Until when no request is sent because a reply is due (ns)."""
        return self.late.until

    def status(self) -> dict[str, Any]:
        """Published variables; those of a device on a device alone: a client has no value of them."""
        return self.scope.published(of_device=self.server is not None)

    def await_frames(self, names: Iterable[str]) -> None:
        """From now on these frames are wanted whenever they come, whatever else is under way."""
        self.awaited = frozenset(names)
        self._known.clear()
        self._plan = None

    # ---- what follows -------------------------------------------------------------------------------------

    def _finish(self) -> list[Command]:
        """Do all that follows and takes no time; return the commands, in order. A nested call returns no command."""
        if self.is_busy:
            return []
        ready = self.ready
        if ready or not self.is_idle or self.on_shut is not None:
            self.is_busy = True
            try:
                self._settle(ready)
            finally:
                self.is_busy = False
        deadline = NEVER
        for run in self.order:
            if run.deadline < deadline:
                deadline = run.deadline
        if not self.is_idle and self.looked is not None:
            deadline = min(deadline, self.receiver.deadline)
        if self._keeps_times or ready or self.late.items:
            deadline = min(deadline, self._other_deadline())
        self.deadline = deadline
        commands = self.commands
        if commands:
            self.commands = self.output.commands = []
        return commands

    def _other_deadline(self) -> int:
        deadline = self.late.until if self.late.items else NEVER
        if self.session.keep_alive is not None:
            deadline = min(deadline, self._keep_alive_at())
        if self.is_holding:
            deadline = min(deadline, super().held_until)
        return self.scope.now if self.ready else deadline  # a circle: the rest comes later

    def _settle(self, ready: deque[Any]) -> None:
        for _ in range(MOST_ROUNDS):
            if ready:
                item = ready.popleft()
                kind = type(item)
                if kind is Run:
                    self.over(item)
                elif kind is LaneState:
                    self.fill(item)
                elif kind is FrameValue:
                    if not self.offer(item):
                        self.unsolicited(item)
                elif item is QUEUES:
                    self._queue_rows()
                else:
                    item()
            elif (self.is_idle or not self._next_arrival()) and (self.on_shut is None or not self.shut()):
                return
        place = self.receiver.stream.offset
        if place != self._circle_at:
            self._circle_at = place
            self._settle(ready)
            return
        self.show("trouble", reason="one event leads to another without end")

    def _frame_trouble(self, frame: str, error: Exception) -> None:
        self.show("trouble", frame=frame, reason=explain(error))

    # ---- to the runs that wait ----------------------------------------------------------------------------

    def offer(self, value: FrameValue) -> bool:
        """Offer a good frame to the rows of the runs that wait; return whether a row took it.

        Lanes are asked in the order written, in a lane the older exchange first; the first row that fits takes it.
        """
        name = value.frame
        for run in self.order:
            if name in run.expected:
                level = run.top
                x = level.x
                if x.checks_echo and not self.table.repeats(value, x.asked, x.last_sent, x.names):
                    continue
                if self.go(run, level, value):
                    return True
                caller = level.caller
                while caller is not None:
                    if name in caller.wait.names(caller.x.expected) and self.go(run, caller, value):
                        return True
                    caller = caller.caller
        return False

    def _queue_rows(self) -> None:
        """Rows that wait for an item or for room; where one was taken, the next may be."""
        queues = self.queues
        for run in self.order:
            if run.state is not RECEIVING:
                continue
            for place, (queue, room) in enumerate(run.wait.queues):
                if queue is not None:
                    items = queues.items[queue]
                    if items and self.go(run, run.top, Item(place, items[0])):
                        self.queues_changed()
                        return
                elif room is not None and not queues.full(room) and self.go(run, run.top, Item(place, None)):
                    self.queues_changed()
                    return

    def _handle(self, run: Run, event: str, value: Any) -> bool:
        """Let a run handle an event, with the effects; return whether it has a handler that applies.

        A break and a lost connection are also for the callers, innermost first.
        """
        for level in run.calls():
            if event in level.wait.events:
                return self.go(run, level, value) or run.state is DONE
            if event not in ("on_break", "on_closed"):
                break
        return False

    def _offer_bad(self, bad: BadFrame) -> bool:
        """A bad frame goes to the lane whose rows name it, else to the first with a handler. False: to none."""
        receiving = [run for run in self.order if run.state is RECEIVING]
        for run in receiving:
            if bad.frame in run.expected:
                run.unusable_replies().add_bad(bad)
                run.cause = str(run.unusable)
                self._handle(run, "on_bad", Bad(bad.cause, bad.frame))
                return True
        for run in receiving:
            run.cause = f"{bad.frame}: {bad.cause}"
            if self._handle(run, "on_bad", Bad(bad.cause, bad.frame)):
                return True
        return False

    # ---- arrivals -----------------------------------------------------------------------------------------

    def has_bytes(self) -> bool:
        return not self.receiver.is_empty

    def stream_place(self) -> int:
        return self.receiver.stream.offset

    def _next_arrival(self) -> bool:
        """Handle the next arrival in the bytes at hand. Return False if there is no arrival yet."""
        receiver, order = self.receiver, self.order
        if len(order) != 1 or (run := order[0]).plan is not self._plan or run.state is not RECEIVING:
            self._look_for()
        if self.looked is None:
            if len(receiver.stream.buffer) > MOST_HELD:
                self.drop_stale()
            self.is_idle = receiver.is_idle
            return False
        event = receiver.next_of(self.looked)
        if type(event) is FrameValue:
            self.counters.received += 1
            self.last_frame = self.scope.now
            if self.monitor is not None:
                self.show_received(event, event.raw or b"", receiver.given_since)
            if event.frame in self._announcing:
                self.accept(event)
            if not self.offer(event):
                self._not_taken(event)
        elif event is None:
            waiting = receiver.waiting
            is_wanted = not waiting
            for run in self.order:
                if run.state is RECEIVING and (waiting or run.candidate is not None):
                    is_wanted |= self._note_progress(run, waiting)
            receiver.pauses.own_gap = self._own_gap or not is_wanted  # no step limits the pauses of other frames
            self.is_idle = receiver.is_idle
            return False
        elif isinstance(event, BadFrame):
            self._bad(event)
        elif isinstance(event, Noise):
            self.show_noise([event])
            if not event.skipped:
                any(self._handle(run, "on_noise", NOISE) for run in self.order if run.state is RECEIVING)
        if receiver.broken:
            self.commands.append(Reopen("the stream is out of step"))
        self.is_idle = is_idle = receiver.is_idle
        if is_idle:
            for run in self.order:
                if run.candidate is not None and run.state is RECEIVING:
                    frame_gone(run, self.scope.now)
        return True

    def _look_for(self) -> None:
        """Select the frames to look for: worked out once for each combination of steps that wait."""
        order, self._plan = self.order, None
        key: Any = () if self.live else None
        for run in order:
            if run.state is RECEIVING:
                key = run.plan if key == () else (key, run.plan)
            elif run.state is HELD or run.state is SILENT:
                key = (key, HELD)
        if len(order) == 1 and type(key) is Plan:
            self._plan = key
        found = self._known.get(key, key)
        if found is key:
            if len(self._known) >= MOST_KNOWN:
                self._known.clear()
            found = self._known[key] = self._looked_now()
        self.looked = found

    def _limit_pauses(self) -> None:
        """Set, once for each wait, whether the steps that wait limit pauses themselves."""
        waits = [(run, run.state, run.wait_number) for run in self.order]
        if waits == self._limited:
            return
        self._limited = waits
        own_gap = is_limited = False
        for run in self.order:
            if run.state is RECEIVING:
                own_gap = own_gap or run.gap is not None
                is_limited = is_limited or run.complete is not None or run.longest < NEVER
        pauses, self._own_gap = self.receiver.pauses, not own_gap
        pauses.own_gap, pauses.is_idle = self._own_gap, not is_limited

    def _looked_now(self) -> ExpectedFrames | None:
        """The frames of the rows that wait, and the others; None while the runs that will wait do not yet."""
        names: dict[str, None] = {}
        looks = others = held = False
        for run in self.order:
            if run.state is HELD or run.state is SILENT:
                held = looks = others = True
            elif run.state is RECEIVING and run.plan is not None:
                looks = looks or run.plan.looks
                names.update(run.plan.frames)
                others = others or run.plan.others
        if not self.live or (held and not names):
            return self.receiver.expect(self._all)
        if not looks:
            return None
        rest = tuple(name for name in self._all if name not in names and (others or name in self.awaited))
        return self.receiver.expect(tuple(names), rest)

    def _note_progress(self, run: Run, waiting: tuple[str, ...]) -> bool:
        """The clock of a run for which a frame is arriving, or turned out not to be; whether one is."""
        receiver = self.receiver
        is_arriving = any(name in run.expected for name in waiting)
        if is_arriving:
            limited = receiver.pauses.defines_gap and receiver.pauses.own_gap
            frame_arriving(run, receiver.waiting_since, receiver.stream.last, limited)
        else:
            frame_gone(run, self.scope.now)
        return is_arriving

    def _not_taken(self, value: FrameValue) -> None:
        """Handle a good frame that no row has taken yet: it may be another frame, or late."""
        receiver, late = self.receiver, self.late
        while (other := receiver.other_reading()) is not None:
            if other.value.frame in self._announcing:
                self.accept(other.value)
            if self.offer(other.value):
                return
        if self._is_own_echo(value):
            if not self._handled_as_other(value):
                self.counters.not_taken += 1
                self.show("not_taken", "in", value.raw or b"", value.frame, reason=OWN_ECHO)
            return
        is_awaited = value.frame in self.awaited
        found = late.came(value, is_awaited)
        if found is None:
            self._note_unfit(value)
        is_late = found is not None and not found.by_itself
        for run in self.order:
            if run.state is SILENT and found is not None:
                run.doubt.extra = self.scope.now
        is_taken = not is_late and self._handled_as_other(value)
        if is_awaited and not is_late:
            self._hand_over(value)
        elif not is_taken:
            self.unsolicited(value, is_late)
        if found is not None and not late.until:
            self.release()

    def _is_own_echo(self, value: FrameValue) -> bool:
        """Return whether a frame has the bytes of the request that a run waits for; its cause says so."""
        found = False
        for run in self.order:
            sent = run.top.x.last_sent if run.state is RECEIVING and run.top.x.checks_echo else None
            if sent is not None and sent.raw == value.raw:
                run.cause, found = OWN_ECHO, True  # if no reply follows
        return found

    def _handled_as_other(self, value: FrameValue) -> bool:
        """Let the runs that wait handle a frame that no row takes; return whether a run did."""
        return any(self._handle(run, "on_other", Other(value)) for run in self.order if run.state is RECEIVING)

    def _note_unfit(self, value: FrameValue) -> None:
        """Note a frame that a run waits for, and that repeats another request than the one of the run."""
        for run in self.order:
            x = run.top.x if run.state is RECEIVING and value.frame in run.expected else None
            if x is not None and x.checks_echo:
                difference = self.table.difference(value, [one for one in (x.asked, x.last_sent) if one is not None])
                if difference:
                    run.unusable_replies().add_unfit(value.frame, difference)
                    run.cause = str(run.unusable)

    def unsolicited(self, value: FrameValue, is_late: bool = False) -> None:
        """A good frame that was not taken. A late reply is no frame that came by itself."""
        self.counters.not_taken += 1
        self.counters.late += is_late
        if is_late or self.live:
            self.show("not_taken", "in", value.raw or b"", value.frame, reason=LATE if is_late else "")
        if not is_late:
            self._hand_over(value)

    def _hand_over(self, value: FrameValue) -> None:
        """Gives a frame that came by itself to who wants such frames."""
        if self.on_frame is not None:
            self.ready.append(partial(self.on_frame, value))

    def _bad(self, bad: BadFrame) -> None:
        self._told.bad(bad)
        self.counters.bad += 1
        self.late.noisy = self.scope.now
        if self.is_watched:  # to find out what is wrong takes work
            self.show(
                "bad", "in", bad.raw, bad.frame,
                reason=bad.cause, started_at=bad.started_at, segment=bad.segment, place=bad.place,
            )  # fmt: skip
        on_bad = self.on_bad
        if not self.cutting and not self._offer_bad(bad) and on_bad is not None:
            self.ready.append(partial(on_bad, bad))

    def flush(self) -> None:
        """Drop bytes that are no frame yet; frames that are wanted at any time are taken first."""
        names = tuple(name for name in self._all if name in self.awaited)
        cutting, self.cutting = self.cutting, True  # a step is under way: bad frames are shown, and nothing more
        while names and (event := self.receiver.next((), names)) is not None:
            if isinstance(event, FrameArrived):
                self.counters.received += 1
                self.last_frame = self.scope.now
                if self.monitor is not None:
                    self.show_received(event.value, event.raw, event.times[0])
                self._hand_over(event.value)
            elif isinstance(event, BadFrame):
                self._bad(event)
            else:
                self.show_noise([event])
        self.cutting = cutting
        self.show_noise(self.receiver.flush())

    def show_noise(self, found: Iterable[Noise]) -> None:
        for noise in found:
            count = self._told.new_bytes(noise)
            if not count:
                continue
            self.counters.noise_bytes += count
            self.late.noisy = self.scope.now
            reason = "what a bad frame left" if noise.skipped else ""
            self.show("noise", "in", noise.data[-count:], started_at=noise.started_at, reason=reason)

    def drop_stale(self) -> None:
        receiver = self.receiver
        if receiver.stream.is_marked or not (self.is_idle or receiver.is_idle):
            self.show_noise(receiver.flush())

    # ---- time ---------------------------------------------------------------------------------------------

    def _tick(self, now: int) -> None:
        """Everything that is due, in the documented order; new times due at the same instant as well."""
        now = self.scope.now = max(now, self.scope.now)
        self.stir_all()
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
        if self.looked is not None and receiver.deadline <= now:
            receiver.tick(now)
            self.is_idle = False
            return True
        due = min((run for run in self.order if run.deadline <= now), key=lambda run: run.deadline, default=None)
        if due is not None:
            self._time_up(due)
            return True
        if self.late.items and self.late.until <= now:
            self.release()
            return True
        return self._keep_alive_at() <= now and self._keep_alive()

    def _time_up(self, run: Run) -> None:
        """Break off a frame that is arriving, then end the wait; a good frame may still be found in its bytes."""
        number = run.wait_number
        if run.state is HELD:
            self.hold_over(run)
            return
        if run.state is SILENT:
            self.silence_over(run)
            return
        if run.state is RECEIVING and run.candidate is not None:
            run.deadline = NEVER
            run.cause = "a frame began and was not completed in time"
            self.receiver.cut()
            self.receiver.tick(self.scope.now)
            self.cutting, self.is_idle = True, False
            try:
                self._settle(self.ready)
            finally:
                self.cutting = False
            if run.state is not RECEIVING or run.wait_number != number:
                return
        self.time_up(run)

    def _keep_alive_at(self) -> int:
        """When the session has to be kept alive; never while there is other traffic under way."""
        session = self.session
        if session.keep_alive is None or self.output.outgoing is not None or not self.is_free:
            return NEVER
        return session.keep_alive_at(self.output.quiet_since)

    def _keep_alive(self) -> bool:
        session = self.session
        if session.session is None or session.session.keep_alive_run is None:
            return False
        names = (session.session.keep_alive_run,)
        return self.begin_sequences("keep_alive", names, session.station) is not None
