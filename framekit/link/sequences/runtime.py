"""The functions that generators of sequences call, and the loop that moves generators on; steps take no time.

No text of a definition raises an exception out of here: an expression that fails ends the sequence, and is shown.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from framekit.codec.errors import FrameError
from framekit.codec.shown import code_text, explain
from framekit.definition.model.procedure import Session
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.services import NUMBER_BITS
from framekit.definition.times import NEVER, parse_format
from framekit.link.events import (
    POSTPONED,
    Ask,
    Break,
    ChangeLine,
    Exchange,
    LinkCounters,
    MemoryAccess,
    Monitor,
    Outcome,
    RequestHandler,
    Seen,
    Send,
    Tape,
    outcome_of,
)
from framekit.link.frame_table import FrameInfo, FrameTable, announce
from framekit.link.late import LateReplies, expect_reply_to_unsent, fresh, missed
from framekit.link.output import Output
from framekit.link.own_echo import OwnEcho
from framekit.link.receiver import Receiver
from framekit.link.scope import LinkFunctions, Scope, with_date
from framekit.link.sequences.state import (
    AGAIN,
    BYTE,
    GO,
    MOST_STEPS,
    NO_NAMES,
    NOT_TAKEN,
    RESTART,
    TIMEOUT,
    Bad,
    Changing,
    CircleError,
    CompiledSequence,
    Failed,
    LaneState,
    Level,
    Parked,
    ParkedCall,
    ParkedHold,
    Pause,
    Run,
    SessionState,
    State,
    Wait,
    after,
    begin_clock,
)
from framekit.link.values import EVALUATION_ERRORS, FrameValue, Names, frames_in, plain
from framekit.memory.views import NUMBER_VIEWS

RECEIVING, PAUSING, ASKING, DONE, GOING = State.RECEIVING, State.PAUSING, State.ASKING, State.DONE, State.GOING

STEPS_OF_TROUBLE = 200
"""The number of steps that a failed step counts for, so that a circle of failures ends soon."""

NOTHING: Mapping[str, Any] = {}
NO_RESULTS: dict[str, Any] = {}

SILENCE = Parked("silence", (), ())
"""An exchange in doubt waits for silence."""

QUEUES = object()
"""Stands in `ready` where rows that wait for an item or for room are to be asked."""


class QueueFull(OverflowError, ValueError):  # noqa: N818 - says what is the case
    """An item was put into a queue that has no room."""


class Queues:
    """The queues of an engine, by name."""

    def __init__(self, protocol: Protocol) -> None:
        self.items: dict[str, deque[Any]] = {name: deque() for name in protocol.queues}
        self._sizes = {name: queue.size for name, queue in protocol.queues.items()}

    def put(self, name: str, item: Any) -> None:
        """Raise QueueFull, KeyError."""
        items = self.items[name]
        if len(items) >= self._sizes[name]:
            raise QueueFull(f"the queue '{name}' is full")
        items.append(item)

    def take(self, name: str) -> Any:
        """Return the oldest item. Raise IndexError when there is none."""
        return self.items[name].popleft()

    def have_some(self, wanted: tuple[tuple[str | None, str | None], ...]) -> bool:
        """Return whether one of these has an item, or room."""
        for queue, room in wanted:
            if (queue is not None and self.items[queue]) or (room is not None and not self.full(room)):
                return True
        return False

    def empty(self, name: str) -> bool:
        return not self.items[name]

    def full(self, name: str) -> bool:
        return len(self.items[name]) >= self._sizes[name]


class Machine:
    """Executes the sequences of an engine: the state that all runs share, and the functions that move runs on.

    The caller of its methods handles the items of `ready` next, in order.
    """

    def __init__(
        self, protocol: Protocol, scope: Scope, program: Any, receiver: Receiver, session: Session | None, *,
        is_stream: bool, server: RequestHandler | None, memory: MemoryAccess | None, ask_service: Ask | None,
        monitor: Monitor | None, on_fault: Monitor | None, on_send: Callable[[], None] | None,
        counters: LinkCounters | None,
    ) -> None:  # fmt: skip
        self.scope = scope
        self.receiver = receiver
        self.server = server
        self.memory = memory
        self.ask_service = ask_service
        """Runs the services of `ask` steps."""
        self.monitor = monitor
        """Gets a record of everything."""
        self.tape = monitor if isinstance(monitor, Tape) else None
        """The monitor, if it records frames instead of showing them."""
        self.on_fault = on_fault
        """Gets all records but frames; no frame is decoded for it."""
        self.on_send = on_send
        """Called for each frame that a sequence sends."""
        self.counters = LinkCounters() if counters is None else counters
        self.table: FrameTable = program.table
        self.sequences: Mapping[str, CompiledSequence] = program.sequences
        self.need_names = program.need_names
        """The frames that are built on names of the exchange."""
        self.shown_later = program.shown_later
        """The frames that can be decoded from their bytes at any later time, each with the names that this needs."""
        self.shown_plain = frozenset(name for name in self.shown_later if not self.table.infos[name].has_lists)
        """The frames of `shown_later` that hold no lists or records."""
        self._known_names: dict[str, tuple[int, dict[str, Any]]] = {}
        self.copies = program.changes
        """Whether sequences change fields of frames, so that each exchange has to have a request of its own."""
        self.output = Output(protocol.line, scope, [], is_stream)
        self.late = LateReplies(protocol, scope, self.table)
        self.own_echo = OwnEcho()
        self.echo: OwnEcho | None = None
        """`own_echo` while replies that equal their request are examined."""
        self.suspected: Exchange | None = None
        """The exchange whose last reply equals its request, and may be an own echo."""
        self.queues = Queues(protocol)
        self.session = SessionState(session, scope)
        self.last_frame = scope.now
        """Time of the last good frame, received or sent (ns)."""
        self.ready: deque[Any] = deque()
        """The queue of work: runs that are over, lanes that may begin an exchange, frames to be offered as if they had
        arrived, QUEUES, and calls."""
        self.order: tuple[Run, ...] = ()
        """The runs, in the order in which arriving frames are offered to them; some may be over."""
        self.live = 0
        """The number of runs under way."""
        self.asking: Run | None = None
        """The run whose `ask` step starts the exchanges of the current call; None if no `ask` step does."""
        self.flush: Callable[[], object] = receiver.flush
        """Drop bytes that are no frame yet; the engine's reception takes awaited frames among them first."""

    def stir(self, lane: LaneState) -> None:
        """Note that an exchange or a listener may begin in a lane."""
        if not lane.is_queued:
            lane.is_queued = True
            self.ready.append(lane)

    # ---- going on -----------------------------------------------------------------------------------------

    def begin(self, run: Run, sequence: CompiledSequence, x: Exchange) -> None:
        """Begin a sequence in a run, and carry it out up to its first wait."""
        run.state = GOING
        run.top = level = run.base
        level.generator = sequence.begin(run, x, NOTHING)
        level.x = x
        lane = run.lane
        if lane.steps_since != self.scope.now:
            lane.steps_since, lane.steps_done = self.scope.now, 1
        else:
            try:
                count(run)
            except CircleError:
                self._circle(run)
                return
        self.go(run, level, None)

    def go(self, run: Run, level: Level, value: Any) -> bool:
        """Send a value to a generator of a run and handle its next wait or its end. Return whether it applied."""
        due = run.asked
        try:
            wait = level.generator.send(value)
        except StopIteration as end:
            result = end.value
            if (
                level is run.top and level.caller is None and type(result) is dict
                and not (self.late.open or self.receiver.has_unread)
            ):  # fmt: skip
                self.finish(run, None, result)
                return True
            return run.state is DONE or self._go_on(run, *self._left(run, level, result), due)
        except CircleError:
            self._circle(run)
            return True
        if type(wait) is Wait and level is run.top:
            self._park(run, level, wait)
            return True
        return self._waits(run, level, wait, due, False)

    def _go_on(self, run: Run, level: Level | None, value: Any, due: Any, error: Exception | None = None) -> bool:
        """Do the same for the calls that follow, if there are any; or raise an error in the generator."""
        while level is not None:
            try:
                wait = level.generator.send(value) if error is None else level.generator.throw(error)
            except StopIteration as end:
                if run.state is DONE:
                    return True
                level, value = self._left(run, level, end.value)
                error = None
                continue
            except CircleError:
                self._circle(run)
                return True
            return self._waits(run, level, wait, due, True)
        return True

    def _waits(self, run: Run, level: Level, wait: Any, due: Any, applied: bool) -> bool:
        """Handle the wait that a generator yields. Return whether the value sent to it applied, or `applied`."""
        if wait is NOT_TAKEN:
            return applied
        if wait is AGAIN or wait is RESTART or run.state is DONE:
            run.asked = due
            if wait is RESTART:
                begin_clock(run, self.scope.now)
            return True
        if level is not run.top:
            self._abandon_above(run, level)
        kind = type(wait)
        if kind is Wait:
            self._park(run, level, wait)
            return True
        level.wait = wait
        run.expected = NO_NAMES
        run.wait_number += 1
        if kind is ParkedCall:
            try:
                count(run)
            except CircleError:
                self._circle(run)
                return True
            name, given = run.wanted
            run.state = GOING
            run.top = called = Level(self.sequences[name].begin(run, level.x, given), level.x, level, False)
            return self._go_on(run, called, None, due)
        if kind is Pause:
            self._pause(run)
            if "on_byte" in wait.events and not self.receiver.is_empty:
                return self._go_on(run, level, BYTE, due)
        elif kind is ParkedHold:
            until = self.late.held_until(level.x.station)
            if level.x.gives_way and self.late.gives_way(run, until):
                self.fail_run(run, POSTPONED)
                return True
            run.state, run.started, run.deadline = State.HELD, self.scope.now, until
            self.late.on_wait(level.x.station, until)
        elif kind is Changing:
            run.state, run.deadline = State.CHANGING, NEVER
            run.change.run, run.change.number = run, run.wait_number
        else:
            error = self._ask(run, level)
            if error is not None:
                return self._go_on(run, level, None, due, error)
        return True

    def _park(self, run: Run, level: Level, wait: Wait) -> None:
        """Let a run wait for rows."""
        x = level.x
        now = self.scope.now
        level.wait = wait
        run.state = RECEIVING
        run.candidate = None
        run.plan = plan = (
            (wait.plans.get(x.expected) or wait.plan(x.expected)) if level.caller is None else wait.plan_in(level)
        )
        run.expected = plan.frames
        run.wait_number += 1
        if wait.queues and self.queues.have_some(wait.queues):
            self.queues_changed()
        if run.lane.waiting:
            self.stir(run.lane)
        run.started = now
        run.clock_waits = run.unsent > 0 and (wait.is_timed or x.checks_echo)
        if wait.is_timed:
            run.deadline = run.within = NEVER if run.clock_waits or run.longest >= NEVER else now + run.longest
        else:
            run.complete = run.gap = None
            run.longest = run.deadline = run.within = NEVER
        if wait.numbered:
            if self.late.numbered.is_watching and x.checks_echo:
                run.asked = x
        elif x.checks_echo and x.last_sent is not None:
            run.asked, run.asked_at = x, now
            self.late.within = run.longest

    def _pause(self, run: Run) -> None:
        now = self.scope.now
        run.state = PAUSING
        run.candidate = None
        run.clock_waits = run.unsent > 0
        run.started = now
        run.deadline = NEVER if run.clock_waits else after(now, run.pause)

    def _ask(self, run: Run, level: Level) -> Exception | None:
        """Run a service; its exchanges run inside this step. Return the error if the service cannot be called."""
        run.state, run.deadline = ASKING, NEVER
        service, given = run.wanted
        before, self.asking = self.asking, run
        try:
            if self.ask_service is None:
                raise ValueError("nobody here runs services")
            self.ask_service(service, given, level.x.station, Asked(self, run, level))
        except EVALUATION_ERRORS as error:
            return error
        finally:
            self.asking = before
        return None

    def _left(self, run: Run, level: Level, result: Any) -> tuple[Level | None, Any]:
        """Handle the end of a sequence, with results or failed; return the caller to go on with and its value.

        Return None for both if no caller goes on now.
        """
        if level is not run.top:
            self._abandon_above(run, level)
        caller = level.caller
        is_certain = not (self.late.open or self.receiver.has_unread)
        if not is_certain and type(result) is dict and self._is_doubted(run, level, result):
            return None, None
        if caller is None:
            if type(result) is dict:
                self.finish(run, None, result)
            else:
                expect_reply_to_unsent(run)
                self.finish(run, failure_of(run, level.x, result))
            return None, None
        run.top = caller
        if level.nested:
            self._end_nested(run, level.x, result if type(result) is dict else failure_of(run, level.x, result))
            return None, None
        if run.asked is not None:
            missed(run)
        run.state, run.deadline, run.expected = GOING, NEVER, NO_NAMES
        return caller, result

    def _is_doubted(self, run: Run, level: Level, results: dict[str, Any]) -> bool:
        """Keep the line silent and run an exchange again whose reply may belong to an earlier request."""
        is_exchange = level.nested or (level.caller is None and run.doing == "exchange")
        if not is_exchange or not level.x.checks_echo:
            return False
        if self.receiver.has_unread:
            self.late.note_excess(run, level.x, self.order)
        until = self.late.doubts(run, level.x, results)
        if not until:
            return False
        if run.given_up or self.late.is_endless(run) or not level.x.may_repeat():
            run.cause = "replies cannot be told from those to earlier requests"
            self.fail_run(run, "cancelled" if run.given_up else "late_replies")
            return True
        if level.x.gives_way and self.late.gives_way(run, until):
            self.fail_run(run, POSTPONED)
            return True
        run.state, run.deadline, run.expected, run.candidate = State.SILENT, until, NO_NAMES, None
        self.late.on_wait(level.x.station, until)
        level.wait = SILENCE
        run.wait_number += 1
        return True

    def silence_over(self, run: Run) -> None:
        """Run an exchange again after the silence, if that is over."""
        until = self.late.silent(run)
        if until > self.scope.now:
            run.deadline = until
            return
        level = run.top
        x = level.x
        x.request = fresh(x.request)
        x.begin(self.scope, True, self.copies)
        level.generator = self.sequences[x.run or run.lane.exchange[0]].begin(run, x, NOTHING)
        run.state, run.deadline = GOING, NEVER
        self.counters.repeated += 1
        self.go(run, level, None)

    def _circle(self, run: Run) -> None:
        run.cause = "steps go round without waiting"
        self.show("trouble", reason=f"{run.lane.name}: {run.cause}")
        self.fail_run(run, "circle")

    def fail_run(self, run: Run, outcome: str) -> None:
        """End the whole run; handlers of its sequences are not called."""
        if run.state is not DONE:
            *_, first = run.calls()
            self._abandon_above(run, first)
            expect_reply_to_unsent(run)
            self.finish(run, Outcome(False, outcome, run.cause))

    def finish(self, run: Run, outcome: Outcome | None, results: dict[str, Any] = NO_RESULTS) -> None:
        """End the run with results, or with `outcome`."""
        if run.state is DONE:
            return
        if run.asked is not None:
            missed(run)
        if run.doubt is not None:
            self.late.ended(run)
        run.state, run.deadline, run.expected = DONE, NEVER, NO_NAMES
        run.top = run.base.generator = None  # type: ignore[assignment] # break the reference cycle
        run.outcome = outcome
        run.results = results
        self.ready.append(run)

    def _abandon_above(self, run: Run, level: Level) -> None:
        """Drop the calls above a level."""
        while run.top is not None and run.top is not level:
            dropped = run.top
            run.top = dropped.caller  # type: ignore[assignment] # of what stands above another one
            if dropped.nested:
                self.tell(dropped.x, Outcome(False, "abandoned", run.cause))

    def go_on(self, run: Run) -> None:
        """Go on with a run that was held back, or whose pause or change of the line is over."""
        if run.asked is not None:
            missed(run)
        run.state, run.deadline = GOING, NEVER
        self.go(run, run.top, GO)

    def time_up(self, run: Run) -> None:
        """Handle the end of a time limit or of a pause of the run."""
        if run.state is PAUSING:
            self.go_on(run)
        elif run.state is RECEIVING:
            run.deadline = run.within = NEVER
            run.candidate = None
            if not run.cause:
                run.cause = "nothing came in time" if run.unusable is None else str(run.unusable)
            if run.top.wait.numbered and run.top.x.checks_echo:
                run.asked = run.top.x
            self.go(run, run.top, TIMEOUT)

    # ---- services that steps ask for ----------------------------------------------------------------------

    def start_inside(self, run: Run, exchange: Exchange) -> None:
        """Start an exchange of the service that the `ask` step of the run has called."""
        sequence = self.sequences[exchange.run or run.lane.exchange[0]]
        x = exchange.begin(self.scope)
        self.late.prepare(exchange)
        run.first_open = self.late.count
        run.top = level = Level(sequence.begin(run, x, NOTHING), x, run.top, True)
        run.state = GOING
        try:
            count(run)
        except CircleError:
            self._circle(run)
        else:
            self.go(run, level, None)

    def _end_nested(self, run: Run, x: Exchange, result: dict[str, Any] | Outcome) -> None:
        if run.asked is not None:
            missed(run)
        if run.doubt is not None:
            self.late.ended(run)
        run.state, run.deadline, run.expected = ASKING, NEVER, NO_NAMES

        def tell() -> None:
            before, self.asking = self.asking, run
            try:
                if isinstance(result, Outcome):
                    x.ended(result)
                elif self.suspected is x:
                    x.suspected(result)
                else:
                    x.succeeded(result)
            finally:
                self.asking = before

        self.ready.append(tell)

    def answered(self, run: Run, level: Level, x: Exchange, outcome: Outcome) -> None:
        """Continue a step with the outcome of the service that it has called."""
        if run.state is not ASKING or run.top is not level or level.x is not x:
            return
        run.state, run.deadline = GOING, NEVER
        if outcome.ok:
            self.go(run, level, outcome.results)
        else:
            run.cause = outcome.cause
            self.go(run, level, Failed(outcome.outcome or "refused", {}))

    # ---- sending ------------------------------------------------------------------------------------------

    def announce(self, value: FrameValue) -> None:
        """Set the variables that a frame announces, when it is accepted or first sent."""
        info = self.table.infos.get(value.frame)
        if info is not None and info.announces:
            announce(info.announces, value, self.scope)

    def accept(self, value: FrameValue) -> None:
        """Set the variables that a received frame announces; show an expression that fails."""
        try:
            self.announce(value)
        except EVALUATION_ERRORS as error:
            self.show("trouble", frame=value.frame, reason=explain(error))

    def put_out(self, run: Run, data: bytes, value: FrameValue, repeated: bool = False) -> None:
        """Send the bytes of a frame, and show it."""
        self.last_frame = self.scope.now
        self.counters.repeated += repeated
        if run.owed is not None:
            self.settle_owed(run, value)
        if self.on_send is not None:
            self.on_send()
        if self.monitor is not None:
            self.show_sent(value, data, repeated)
        if self.output.put(Send(data, 0, False, run, self.table.infos[value.frame])):
            run.unsent += 1

    def settle_owed(self, run: Run, value: FrameValue) -> None:
        """Note that a frame is sent that may be, or contain, the reply to the last request."""
        assert run.owed is not None
        reply = run.owed[0]
        if reply.was_built or reply.frame in frames_in(value):
            run.owed = None  # else it was rebuilt from its fields, or is deep inside

    def line_changed(self, change: ChangeLine, is_other: bool) -> None:
        """Note that the line has these settings, after everything sent before has left; its run goes on."""
        if is_other and self.monitor is not None:
            self.show("line", "out", reason=str(change.line))
        run = change.run
        if run is not None and run.state is State.CHANGING and run.wait_number == change.number:
            self.ready.append(partial(self._changed, run, change.number))

    def _changed(self, run: Run, number: int) -> None:
        if run.state is State.CHANGING and run.wait_number == number:
            self.go_on(run)

    # ---- queues, memory -----------------------------------------------------------------------------------

    def queues_changed(self) -> None:
        """Note that a row that waits for an item or for room may be able to go on."""
        if QUEUES not in self.ready:
            self.ready.append(QUEUES)

    def take_item(self, queue: str) -> Any:
        self.queues_changed()
        return self.queues.take(queue)

    def deliver(self, value: Any) -> None:
        """Offer a frame as if it had arrived. Raise TypeError for another value."""
        if type(value) is not FrameValue:
            raise TypeError("only a frame can be delivered")
        self.ready.append(value)

    def store(self, address: str, data: bytes) -> None:
        if self.memory is None:
            raise ValueError("there is no memory to store into")
        self.memory.write(address, bytes(data))

    # ---- showing ------------------------------------------------------------------------------------------

    @property
    def is_watched(self) -> bool:
        """Return whether faults are shown."""
        return self.on_fault is not None or self.monitor is not None

    def show(self, kind: Any, direction: Any = "", raw: bytes = b"", frame: str = "", **more: Any) -> None:
        on_fault = None if kind == "frame" else self.on_fault
        if on_fault is None and self.monitor is None:
            return
        seen = Seen(direction, kind, self.scope.now, raw, frame, **more)
        if on_fault is not None:
            on_fault(seen)
        if self.monitor is not None:
            self.monitor(seen)

    def show_sent(self, value: FrameValue, data: bytes, repeated: bool = False) -> None:
        """Show a frame that goes out. Its fields are read from its bytes later, if that gives the same."""
        if self.monitor is not None:
            frame, pending, scope = value.frame, value.rest, self.scope
            if type(pending) is tuple and pending[3] is None and frame in self.shown_later:
                kept, tape = self._known_names.get(frame), self.tape
                if kept is None or kept[0] != scope.settings or pending[2] is not scope:
                    kept = self._shown_names(frame, pending[2])
                if kept is not None and tape is not None:
                    if not tape.records:
                        tape.begins()
                    tape.records.append(
                        (tape.mark, "out", scope.now, data, frame, (pending[0].read_back, kept[1]), 0, repeated)
                    )
                    return
                if kept is not None:
                    read = partial(pending[0].read_back, data, kept[1], None)
                    self.monitor(Seen("out", "frame", scope.now, data, frame, None, "", 0, "", 0, repeated, read))
                    return
            self.monitor(Seen("out", "frame", scope.now, data, frame, _plain_of(value), "", 0, "", 0, repeated))

    def _shown_names(self, frame: str, context: Mapping[str, Any]) -> tuple[int, dict[str, Any]] | None:
        """Return the names that a frame is read back with, as they are now, and the number of `settings` so far.

        None if they cannot be worked out.

        They are parameters and constants. Names of the engine itself are kept until a parameter is set.
        """
        needed, scope = self.shown_later[frame], self.scope
        try:
            found = scope.settings, {name: context[name] for name in needed}
        except EVALUATION_ERRORS:
            return None
        if context is scope and not any(name in (scope.formulas or {}) for name in needed):
            self._known_names[frame] = found
        return found

    def show_received(self, value: FrameValue, raw: bytes, started_at: int) -> None:
        """Show a good frame, or a frame that is to be refused, whose first byte came at `started_at`."""
        if self.monitor is not None:
            tape, frame = self.tape, value.frame
            if tape is not None and frame in self.shown_plain and value.refusal is None:
                if not tape.records:
                    tape.begins()
                tape.records.append(
                    (tape.mark, "in", self.scope.now, raw, frame, value.fields.copy(), started_at, False)
                )  # fmt: skip
                return
            reason = "" if value.refusal is None else f"refused with {code_text(value.refusal)}"
            if frame in self.shown_plain:
                fields = value.fields.copy()
            elif frame in self.shown_later:
                fields = {
                    name: plain(one) if type(one) in (list, dict) else one  # of the program, which may change it
                    for name, one in value.fields.items()
                }
            else:
                fields = _plain_of(value)
            self.monitor(Seen("in", "frame", self.scope.now, raw, frame, fields, reason, started_at))

    def set_session(self, new: bool) -> None:
        self.session.end()
        if new:
            self.session.opened()

    def tell(self, exchange: Exchange, outcome: Outcome) -> None:
        """Schedule the callback of an exchange with this outcome."""
        self.ready.append(partial(exchange.ended, outcome))


def _plain_of(value: FrameValue) -> dict[str, Any]:
    """Return all fields of a frame as codecs give them."""
    return {name: plain(one) for name, one in value.complete().items()}


class EngineFunctions(LinkFunctions):
    """What expressions find under the name `functions`: queues, the device's memory, the clock."""

    def __init__(self, machine: Machine) -> None:
        super().__init__(machine.scope)
        self._machine = machine

    def empty(self, queue: str) -> int:
        return int(self._machine.queues.empty(queue))

    def full(self, queue: str) -> int:
        return int(self._machine.queues.full(queue))

    def memory(self, address: str, size: int) -> bytes:
        """Return bytes of the device's memory. Raise ValueError."""
        if self._machine.memory is None:
            raise ValueError("there is no memory to read")
        return self._machine.memory.read(address, size)

    def value(self, address: str, type_: str) -> float:
        """Return the number at an address of the device's memory, low word first. Raise ValueError."""
        return NUMBER_VIEWS[type_].read(self.memory(address, NUMBER_BITS[type_] // 8))[0]

    def with_date(self, clock: Mapping[str, int], frame: Any, mode: int | str) -> dict[str, int]:
        return with_date(clock, frame, mode)


class Asked:
    """The argument of the callback of an `ask` step."""

    def __init__(self, machine: Machine, run: Run, level: Level) -> None:
        self.machine, self.run, self.level, self.x = machine, run, level, level.x
        self.params = level.x.params

    def __call__(self, outcome: Outcome) -> None:
        self.machine.ready.append(partial(self.machine.answered, self.run, self.level, self.x, outcome))


def failure_of(run: Run, x: Exchange, failed: Failed) -> Outcome:
    """Return the outcome of a failure, with the results as far as there are any: a refusing reply, say."""
    found = outcome_of(x, failed.results)
    found.ok, found.outcome, found.cause = False, failed.outcome, run.cause
    found.damaged = 0 if run.unusable is None else run.unusable.bad
    return found


# ---- functions for generators ---------------------------------------------------------------------------------------


def count(run: Run) -> None:
    """Count a step that may be part of a cycle. Raise CircleError after too many steps without new input or time."""
    lane, machine = run.lane, run.machine
    if lane.steps_since != machine.scope.now:
        lane.steps_since, lane.steps_done = machine.scope.now, 0
    lane.steps_done += 1
    if lane.steps_done > MOST_STEPS:
        place = machine.receiver.stream.offset
        if place == lane.steps_at:
            raise CircleError
        lane.steps_at, lane.steps_done = place, 0  # thousands of frames that came at once


def listens_again(m: Machine, run: Run, x: Exchange) -> bool:
    """Return whether a listener that has ended begins anew: no exchange waits for its lane. Raise CircleError."""
    lane, now = run.lane, m.scope.now
    if lane.waiting or not m.output.is_open or run.top is not run.base:
        return False
    if lane.steps_since != now:
        lane.steps_since, lane.steps_done = now, 1
    else:
        count(run)
    run.cause, run.deadline, run.unusable = "", NEVER, None
    x.renew()
    return True


def trouble(run: Run, x: Exchange, step: str, error: Exception) -> str:
    """Handle an expression that cannot be evaluated: show it, and return the outcome of the failed sequence."""
    machine = run.machine
    if machine.server is not None and _owes_reply(run, x):
        run.owed = None
        machine.server.unanswered()
    run.cause = explain(error)
    run.lane.steps_done += STEPS_OF_TROUBLE
    machine.show("trouble", reason=f"{run.lane.name}, step {step}: {run.cause}")
    return "queue_full" if isinstance(error, OverflowError) else "expression"


def _owes_reply(run: Run, x: Exchange) -> bool:
    """Return whether the request it took last has been carried out and its reply was not built yet."""
    if run.owed is None or run.state is DONE:
        return False
    reply, taken = run.owed
    return x.reply is reply and x.taken is taken and not reply.was_built


def unclear(m: Machine, step: str, error: Exception) -> bool:
    """Show that the condition of a row cannot be evaluated; return False, because it does not hold."""
    m.show("trouble", reason=f"step {step}, condition of a row: {explain(error)}")
    return False


def cut_parts(data: bytes, most: int) -> list[bytes]:
    """Return the data of a step in pieces. Raise ValueError for pieces without bytes."""
    if most <= 0:
        raise ValueError(f"pieces of {most} bytes cannot be cut")
    return [data[start : start + most] for start in range(0, len(data), most)]


def begin_part(run: Run, parts: list[bytes], index: int) -> dict[str, Any]:
    """Begin a piece of the data of a step; return its variables."""
    count(run)
    if run.asked is not None:
        missed(run)
    following = len(parts[index + 1]) if index + 1 < len(parts) else 0
    return {"data": parts[index], "index": index, "last": int(not following), "next": following}


def hold_break(m: Machine, run: Run, duration: int) -> None:
    if duration > 0 and m.output.put(Break(duration, 0, run)):
        run.unsent += 1
        if m.monitor is not None:
            m.show("break", "out")


def change_line(m: Machine, speed: Any, format: Any) -> ChangeLine | None:
    """Queue a change of speed and format; None keeps a setting.

    Return the pending change, or None if it is done.
    """
    line = m.scope.line.line
    if line is None:  # a stream has no settings
        return None
    shape = str(line).partition(" ")[2] if format is None else format
    return m.output.change_line(parse_format(shape, line.speed if speed is None else speed))


def own_line(m: Machine) -> ChangeLine | None:
    """Change the line as `change_line` does, to its own settings."""
    own = m.scope.line.own
    return None if own is None else change_line(m, own.speed, str(own).partition(" ")[2])


def decoded(m: Machine, run: Run, names: Names, frames: tuple[str, ...], data: Any) -> FrameValue | Bad:
    """Decode bytes as the first of these frames that fits; otherwise return, count and show the fault.

    Raise TypeError if `data` is no bytes.
    """
    table = m.table
    if not isinstance(data, (bytes, bytearray)):
        raise TypeError("only bytes can be decoded")
    raw, found = bytes(data), list[tuple[int, str, FrameError]]()
    for name in sorted(frames, key=lambda one: table.infos[one].refuse is not None):
        try:
            value: FrameValue = table.received(name, table.infos[name].decode(raw, names), raw, None)
        except FrameError as error:
            if error.refuse is not None:
                value = table.received(name, dict(error.fields), raw, error.refuse)
                m.accept(value)
                return value
            first = error.also or error
            found.append((len(raw) if first.cause == "check" else first.offset, name, error))
        else:
            m.accept(value)
            return value
    _, frame, fault = max(found, key=lambda one: one[0])  # the first of those that got furthest
    run.state = GOING
    run.cause = f"{frame}: {fault}"
    m.counters.bad += 1
    m.show(
        "bad", "in", raw, frame, reason=fault.cause, started_at=m.scope.now, segment=fault.segment, place=fault.offset
    )
    return Bad(fault.cause, frame)


def serve(m: Machine, run: Run, x: Exchange, request: Any, buffer: bytes, station: Any, check_only: bool) -> None:
    """Serve a request; set `reply`, `reply_buffer` and `refusal` of the exchange."""
    if m.server is None:
        raise ValueError("nobody here serves requests")
    if type(request) is not FrameValue:
        raise TypeError("only a frame can be served")
    served = m.server.serve(request, buffer, station, check_only, x.names)
    x.request, x.reply_buffer = request, served.reply_buffer
    x.reply = reply = served.reply
    x.refusal = refusal = served.refusal
    if not x.checks_echo:
        x.answering = request
    if served.trouble:
        m.show("trouble", frame=request.frame, reason=served.trouble)
    if check_only:
        run.owed = None
    else:
        x.buffer = served.reply_buffer
        run.owed = None if reply is None or refusal else (reply, x.taken)


def put(m: Machine, queue: str, item: dict[str, Any], names: Names) -> None:
    """Put an item into a queue; a frame in it gets its computed fields now."""
    for value in item.values():
        if type(value) is FrameValue and value.raw is None:
            m.table.encode(value, names)
            value.complete()
    m.queues.put(queue, item)
    m.queues_changed()


def set_field(m: Machine, holder: Any, field: str, value: Any) -> None:
    """Set a field of a frame or a record."""
    if type(holder) is FrameValue:
        numbers = m.table.infos[holder.frame].numbers.get(field)
        holder.set_field(field, numbers.get(value, value) if numbers and isinstance(value, str) else value)
    else:
        holder[field] = value


def needs_names(m: Machine, value: Any) -> bool:
    """Return whether a frame is built on names of the exchange."""
    return type(value) is not FrameValue or value.frame in m.need_names


def send_value(m: Machine, run: Run, x: Exchange, value: Any, names: Names) -> tuple[bytes, FrameValue]:
    """Send a frame value. Raise ValueError for values that the frame cannot carry."""
    if type(value) is not FrameValue:
        raise TypeError(f"{value!r} is no frame and cannot be sent")
    return send_made(m, run, x, value, names)


def named(x: Exchange, own: dict[str, Any], n: Names) -> Names:
    """Return the names of an exchange (`OF_EXCHANGE`) with a sequence's `own` variables, which precede them."""
    return Names(
        {
            **x.arguments, "buffer": x.buffer, "expected": x.expected, "refusal": x.refusal, "reply": x.reply,
            "reply_buffer": x.reply_buffer, "request": x.request, "station": x.station, **own,
        },
        n,
    )  # fmt: skip


def send_made(m: Machine, run: Run, x: Exchange, value: FrameValue, names: Names) -> tuple[bytes, FrameValue]:
    """Send a frame that has been made; its fields are worked out on `names`."""
    if not x.checks_echo:
        m.table.fill_echo(value, x.answering, x.taken)
    return send_built(m, run, x, m.table.infos[value.frame], value, names)


def send_built(
    m: Machine, run: Run, x: Exchange, info: FrameInfo, value: FrameValue, names: Names
) -> tuple[bytes, FrameValue]:
    """Send a frame whose fields are all given."""
    data = m.table.build(info, value, names)
    if info.announces:
        announce(info.announces, value, m.scope)
    x.last_sent = value
    m.last_frame = m.scope.now
    if (owed := run.owed) is not None:
        if owed[0].rest is None:
            m.settle_owed(run, value)
        else:
            run.owed = None
    if m.on_send is not None:
        m.on_send()
    if m.monitor is not None:
        m.show_sent(value, data)
    if m.output.put(Send(data, 0, False, run, info)):
        run.unsent += 1
    return data, value
