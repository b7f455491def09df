"""What runs compiled sequences: the machine that all runs of an engine share, and what generated functions call.

Everything that takes no time is done at once, then a run waits (guide: sequences). A generated function
gives the one that goes on, or None when its run waits. Nothing that a definition writes can raise out of the machine:
what cannot be worked out ends the sequence, and that is shown.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Mapping
from functools import partial
from typing import Any

from framekit.codec.errors import FrameError
from framekit.codec.shown import code_text, explain
from framekit.definition.model.protocol import Protocol
from framekit.definition.times import NEVER, parse_format
from framekit.link.events import (
    Ask,
    Break,
    ChangeLine,
    Exchange,
    MemoryAccess,
    Monitor,
    Outcome,
    RequestHandler,
    Seen,
    Send,
)
from framekit.link.frame_table import FrameTable, announce
from framekit.link.late import LateReplies
from framekit.link.output import Output
from framekit.link.scope import LinkFunctions, Scope, with_date
from framekit.link.sequences.state import (
    MOST_STEPS,
    NOT_TAKEN,
    CallFrame,
    CircleError,
    CompiledSequence,
    CompiledStep,
    Next,
    Run,
    SessionState,
    State,
    after,
    begin_clock,
)
from framekit.link.values import EVALUATION_ERRORS, FrameValue, Names, frames_in, plain

RECEIVING, PAUSING, ASKING, DONE, GOING = State.RECEIVING, State.PAUSING, State.ASKING, State.DONE, State.GOING

STEPS_OF_TROUBLE = 200
"""What a step that could not be worked out counts for, so that trouble does not go round for long."""


class QueueFull(OverflowError, ValueError):  # noqa: N818 - says what is the case
    """An item was put into a queue that has no room."""


class Queues:
    """The queues of an engine, by name. `is_due`: a row that waits for an item or for room may have it now."""

    def __init__(self, protocol: Protocol) -> None:
        self.is_due = False
        self.items: dict[str, deque[Any]] = {name: deque() for name in protocol.queues}
        self._sizes = {name: queue.size for name, queue in protocol.queues.items()}

    def put(self, name: str, item: Any) -> None:
        """Raises QueueFull, KeyError."""
        items = self.items[name]
        if len(items) >= self._sizes[name]:
            raise QueueFull(f"the queue '{name}' is full")
        items.append(item)
        self.is_due = True

    def take(self, name: str) -> Any:
        """The oldest item. Raises IndexError when there is none."""
        self.is_due = True
        return self.items[name].popleft()

    def empty(self, name: str) -> bool:
        return not self.items[name]

    def full(self, name: str) -> bool:
        return len(self.items[name]) >= self._sizes[name]


class Machine:
    """What all runs of an engine share, and how they go on.

    `changed`: what runs wait for may be other than before; `stirred`: a lane may have room for something to begin.
    `monitor` is shown everything. `on_fault` is shown everything but frames, `on_send` is told of each frame that goes
    out: with these alone no frame is read for being shown. `last_frame`: when the last good frame came or went.
    `delivered`: frames to be offered as if they had arrived. `callbacks`: to be called when everything else is done.
    `is_open`: the line is there. `is_idle`: no byte was left to be looked at after the last event. `awaits_frames`:
    some frames are wanted whenever they come, so what has come of one is no remainder of the past. `need_names`: the
    frames that are built on names of the exchange. `shown_later`: those that can be read from their
    bytes at any time, on these names as they were; none where a step changes fields.
    """

    def __init__(
        self, scope: Scope, table: FrameTable, sequences: Mapping[str, CompiledSequence], output: Output
    ) -> None:
        self.scope = scope
        self.table = table
        self.sequences = sequences
        self.output = output
        self.late = LateReplies(scope.protocol, scope)
        self.queues = Queues(scope.protocol)
        self.session = SessionState(None, scope)
        self.server: RequestHandler | None = None
        self.memory: MemoryAccess | None = None
        self.ask_service: Ask | None = None
        self.monitor: Monitor | None = None
        self.on_fault: Monitor | None = None
        self.on_send: Callable[[], None] | None = None
        self.last_frame = scope.now
        self.flush: Callable[[], None] | None = None
        self.delivered: deque[FrameValue] = deque()
        self.callbacks: deque[Callable[[], None]] = deque()
        self.ended: deque[Run] = deque()
        self.need_names: Collection[str] = table.infos
        self.shown_later: Mapping[str, tuple[str, ...]] = {}
        self.is_open = False
        self.is_idle = True
        self.awaits_frames = False
        self.changed = True
        self.stirred = True
        self.asking: Run | None = None
        self.has_bytes: Callable[[], bool] = lambda: False
        self.count_bad: Callable[[], None] = lambda: None
        self.stream_place: Callable[[], int] = lambda: 0
        self.drop_stale: Callable[[], None] = lambda: None

    # ---- going on -----------------------------------------------------------------------------------------

    def start(self, run: Run, sequence: CompiledSequence, context: Exchange) -> None:
        """A run begins a sequence, and does everything in it that takes no time."""
        run.state = GOING
        run.top = sequence.frame(run, context, None, False, {})
        run.has_always = sequence.has_always
        lane = run.lane
        if lane.steps_since != self.scope.now:
            lane.steps_since, lane.steps_done = self.scope.now, 1
            self.go(run, sequence.begin, run.top)
        else:
            self.go(run, _first, sequence, run.top)

    def go(self, run: Run, do: Callable[..., Next], *arguments: Any) -> Next:
        """Does something for a run, and what follows from it. Tells whether it was NOT_TAKEN."""
        try:
            following = do(*arguments)
            if following is NOT_TAKEN:
                return NOT_TAKEN
            while following is not None:
                following = following(run.top)
        except EVALUATION_ERRORS as error:
            self._trouble(run, error)
        except CircleError:
            self._circle(run)
        return None

    def _trouble(self, run: Run, error: Exception) -> None:
        """Something a definition wrote could not be worked out: the sequence ends, its callers may go on."""
        if self.server is not None and self._owes_reply(run):
            run.owed = None
            self.server.unanswered()
        while run.state is not DONE:
            run.cause = explain(error)
            run.lane.steps_done += STEPS_OF_TROUBLE
            self.show("trouble", reason=f"{run.lane.name}, step {run.top.step.name}: {run.cause}")
            try:
                following = fail(run.top, "queue_full" if isinstance(error, OverflowError) else "expression")
                while following is not None:
                    following = following(run.top)
                return
            except EVALUATION_ERRORS as another:
                error = another
            except CircleError:
                self._circle(run)
                return

    def _owes_reply(self, run: Run) -> bool:
        """Whether the request it took last has been carried out and its reply was not built yet."""
        if run.owed is None or run.state is DONE:
            return False
        reply, taken = run.owed
        d = run.top.d
        return d.reply is reply and d.last_taken is taken and not reply.was_built

    def _circle(self, run: Run) -> None:
        run.cause = "steps go round without waiting"
        self.show("trouble", reason=f"{run.lane.name}: {run.cause}")
        self.fail_run(run, "circle")

    def fail_run(self, run: Run, outcome: str) -> None:
        """The whole run ends, whatever its sequences would do about it."""
        if run.state is not DONE:
            *_, first = run.calls()
            abandon_above(first)
            finish(run, Outcome(False, outcome, run.cause))

    def time_up(self, run: Run) -> None:
        """A time limit of the run has run out, or its pause is over."""
        self.go(run, _time_up, run)

    def go_on(self, run: Run) -> None:
        """What has held it back is over: it sends now."""
        self.go(run, _go_on, run)

    def start_inside(self, run: Run, exchange: Exchange) -> None:
        """An exchange of the service that the run's `ask` step has asked for."""
        self.go(run, _start_inside, run, exchange)

    # ---- sending ------------------------------------------------------------------------------------------

    def announce(self, value: FrameValue) -> None:
        """What a frame says about later ones, when it is accepted or first sent."""
        info = self.table.infos.get(value.frame)
        if info is not None and info.announces:
            announce(info.announces, value, self.scope)

    def accept(self, value: FrameValue) -> None:
        """What a frame that came says about later ones; what cannot be worked out is shown."""
        try:
            self.announce(value)
        except EVALUATION_ERRORS as error:
            self.show("trouble", frame=value.frame, reason=explain(error))

    def put_out(self, run: Run, data: bytes, value: FrameValue, repeated: bool = False) -> None:
        """Gives the bytes of a frame to the line, and shows it."""
        self.last_frame = self.scope.now
        reply = None if run.owed is None else run.owed[0]
        if reply is not None and reply.raw is None and reply.pending is None and reply.frame in frames_in(value):
            run.owed = None  # it was made anew of its fields, or stands deep inside
        if self.on_send is not None:
            self.on_send()
        if self.monitor is not None:
            self.show_sent(value, data, repeated)
        if self.output.put(Send(data, 0, False, run, self.table.infos[value.frame])):
            run.unsent += 1

    def left(self, run: Run) -> None:
        """The last bit of something the run sent has left the line: its clock may begin."""
        run.unsent = unsent = run.unsent - 1 if run.unsent > 1 else 0
        if unsent or not run.clock_waits or run.state is DONE:
            return
        now, run.clock_waits = self.scope.now, False
        run.started = now
        if run.state is PAUSING:
            run.deadline = after(now, run.pause)
            return
        run.within = now + run.longest if run.longest < NEVER else NEVER
        if run.candidate is None:
            run.deadline = run.within

    def line_changed(self, change: ChangeLine, is_other: bool) -> None:
        """All that was sent before has left, and the line has these settings: a run that waits for that goes on."""
        if is_other and self.monitor is not None:
            self.show("line", "out", reason=str(change.line))
        run = change.run
        if run is not None and run.state is State.CHANGING and run.wait_number == change.number:
            self.callbacks.append(partial(self.go_on, run))

    # ---- queues, memory -----------------------------------------------------------------------------------

    def take_item(self, queue: str) -> Any:
        self.changed = self.stirred = True
        return self.queues.take(queue)

    def deliver(self, value: Any) -> None:
        """A frame is offered as if it had arrived."""
        if type(value) is not FrameValue:
            raise TypeError("only a frame can be delivered")
        self.delivered.append(value)
        self.changed = self.stirred = True

    def store(self, address: str, data: bytes) -> None:
        if self.memory is None:
            raise ValueError("there is no memory to store into")
        self.memory.write(address, bytes(data))

    # ---- showing ------------------------------------------------------------------------------------------

    @property
    def is_watched(self) -> bool:
        """Whether faults are shown to anybody."""
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
        """A frame that goes out. Its fields are read from its bytes when they are asked for, if that is the same."""
        if self.monitor is not None:
            names = self.shown_later.get(value.frame)
            computed = None if names is None else self.table.read_later(value, names)
            fields = None if computed is not None else _plain_of(value)
            now = self.scope.now
            self.monitor(Seen("out", "frame", now, data, value.frame, fields, "", 0, "", 0, repeated, computed))

    def show_received(self, value: FrameValue, raw: bytes, started_at: int) -> None:
        """A good frame, or one that is to be refused, whose first byte came at `started_at`."""
        if self.monitor is not None:
            reason = "" if value.refusal is None else f"refused with {code_text(value.refusal)}"
            if value.frame in self.shown_later:
                fields = value.fields.copy()
                for name, one in fields.items():
                    if type(one) in (list, dict):  # of the program, which may change it
                        fields[name] = plain(one)
            else:
                fields = _plain_of(value)
            self.monitor(Seen("in", "frame", self.scope.now, raw, value.frame, fields, reason, started_at))

    def set_session(self, new: bool) -> None:
        self.session.end()
        if new:
            self.session.opened()

    def tell(self, exchange: Exchange, outcome: Outcome) -> None:
        """Calls back when everything that follows at this point has been done."""
        self.callbacks.append(partial(exchange.ended, outcome))


def _plain_of(value: FrameValue) -> dict[str, Any]:
    """All fields of a frame as codecs give them."""
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
        """Bytes of the device's memory. Raises ValueError."""
        if self._machine.memory is None:
            raise ValueError("there is no memory to read")
        return self._machine.memory.read(address, size)

    def with_date(self, clock: Mapping[str, int], frame: Any, mode: int | str) -> dict[str, int]:
        return with_date(clock, frame, mode)


class _Asked:
    """What the callback of an `ask` step gets."""

    def __init__(self, frame: CallFrame) -> None:
        self.frame = frame
        self.run = frame.run
        self.params = frame.d.params

    def __call__(self, outcome: Outcome) -> None:
        machine, run, frame = self.run.machine, self.run, self.frame
        machine.callbacks.append(lambda: machine.go(run, _answered, frame, outcome))
        machine.changed = True


# ---- from sequence to sequence ----------------------------------------------------------------------------------


def _first(sequence: CompiledSequence, frame: CallFrame) -> Next:
    count(frame.run)
    return sequence.begin(frame)


def count(run: Run) -> None:
    """A step is begun that may be one of a circle. Raises CircleError."""
    lane, machine = run.lane, run.machine
    if lane.steps_since != machine.scope.now:
        lane.steps_since, lane.steps_done = machine.scope.now, 0
    lane.steps_done += 1
    if lane.steps_done > MOST_STEPS:
        place = machine.stream_place()
        if place == lane.steps_at:
            raise CircleError
        lane.steps_at, lane.steps_done = place, 0  # thousands of frames that came at once


def call(a: CallFrame, name: str, given: dict[str, Any]) -> Next:
    """Begins another sequence; its results come to `back` of the step."""
    run = a.run
    count(run)
    sequence = run.machine.sequences[name]
    run.top = sequence.frame(run, a.d, a, False, given)
    run.has_always = run.has_always or sequence.has_always
    return sequence.begin


def _start_inside(run: Run, exchange: Exchange) -> Next:
    machine = run.machine
    sequence = machine.sequences[exchange.run or run.lane.exchange[0]]
    run.top = sequence.frame(run, exchange.begin(machine.scope), run.top, True, {})
    run.has_always = run.has_always or sequence.has_always
    return _first(sequence, run.top)


def ask(a: CallFrame, service: str, given: dict[str, Any]) -> None:
    """Runs a service; its exchanges run inside this step."""
    run, machine = a.run, a.m
    if machine.ask_service is None:
        raise ValueError("nobody here runs services")
    run.state = ASKING
    machine.changed = True
    before, machine.asking = machine.asking, run
    try:
        machine.ask_service(service, given, a.d.station, _Asked(a))
    finally:
        machine.asking = before


def _answered(a: CallFrame, outcome: Outcome) -> Next:
    """The service that a step asked for is done."""
    run = a.run
    if run.state is not ASKING or run.top is not a:
        return None
    run.state, run.deadline = GOING, NEVER
    a.m.changed = True
    if outcome.ok:
        return a.step.back(a, outcome.results)
    run.cause = outcome.cause
    name = outcome.outcome or "refused"
    a.outcome, a.cause = name, run.cause
    return handled(a, "on_fail", name)


def end(a: CallFrame) -> Next:
    """A sequence has come to its end: results to its caller, or to what started it."""
    run = a.run
    results = a.results()
    caller = a.caller
    if caller is None:
        machine = a.m
        if run.kind == "listen" and not run.lane.waiting and machine.is_open and run.state is not DONE:
            return _listen_again(run)
        finish(run, _outcome(a.d, results))
        return None
    run.top = caller
    if a.nested:
        _end_nested(run, a.d, _outcome(a.d, results))
        return None
    if run.asked is not None:
        missed(run)
    run.state, run.deadline = GOING, NEVER
    return partial(_back, results)


def _back(results: dict[str, Any], a: CallFrame) -> Next:
    return a.step.back(a, results)


def _listen_again(run: Run) -> Next:
    """A listener begins anew: nothing else waits for its lane."""
    count(run)
    run.cause = ""
    run.deadline = NEVER
    machine = run.machine
    sequence = machine.sequences[run.lane.listen]
    run.top = sequence.frame(run, Exchange().begin(machine.scope, False), None, False, {})
    run.has_always = sequence.has_always
    return sequence.begin


def fail(a: CallFrame, outcome: str) -> Next:
    """A sequence fails: its caller handles that, or fails too."""
    run, caller = a.run, a.caller
    if run.state is DONE:
        return None
    if caller is None:
        finish(run, _failure(a, outcome))
        return None
    run.top = caller
    if a.nested:
        _end_nested(run, a.d, _failure(a, outcome))
        return None
    if run.asked is not None:
        missed(run)
    run.state, run.deadline = GOING, NEVER
    caller.outcome, caller.cause = outcome, run.cause
    return handled(caller, "on_fail", outcome)


def _failure(a: CallFrame, outcome: str) -> Outcome:
    """The outcome of a failure, with the results as far as there are any: a refusing reply, say."""
    results = {}
    for name, give in a.gives:
        try:
            results[name] = give(a)
        except EVALUATION_ERRORS:
            continue
    found = _outcome(a.d, results)
    found.ok, found.outcome, found.cause = False, outcome, a.run.cause
    return found


def _outcome(d: Exchange, results: dict[str, Any]) -> Outcome:
    reply, buffer = results.get("reply"), results.get("buffer", b"")
    return Outcome(
        True,
        "",
        "",
        reply if type(reply) is FrameValue else None,
        buffer if isinstance(buffer, bytes) else b"",
        results,
        d.raw,
    )


def finish(run: Run, outcome: Outcome) -> None:
    """The run is over."""
    if run.state is DONE:
        return
    if run.asked is not None:
        missed(run)
    run.state = DONE
    run.deadline = NEVER
    run.outcome = outcome
    run.top = None  # type: ignore[assignment] # nothing leads from one to the other when both are over
    machine = run.machine
    machine.changed = True
    machine.ended.append(run)


def _end_nested(run: Run, d: Exchange, outcome: Outcome) -> None:
    if run.asked is not None:
        missed(run)
    run.state, run.deadline = ASKING, NEVER
    machine = run.machine
    machine.changed = True

    def tell() -> None:
        before, machine.asking = machine.asking, run
        try:
            d.ended(outcome)
        finally:
            machine.asking = before

    machine.callbacks.append(tell)


def abandon_above(a: CallFrame) -> None:
    """Drops the calls above a call frame."""
    run = a.run
    while run.top is not None and run.top is not a:
        dropped = run.top
        run.top = dropped.caller  # type: ignore[assignment] # of what stands above another one
        if dropped.nested:
            run.machine.tell(dropped.d, Outcome(False, "abandoned", run.cause))


# ---- handlers ---------------------------------------------------------------------------------------------------


def handled(a: CallFrame, event: str, outcome: str) -> Next:
    """What the step's handler of an event does; without one that applies the sequence fails with `outcome`."""
    handler = a.step.handlers.get(event)
    if handler is not None:
        following = handler(a)
        if following is not NOT_TAKEN:
            return following
    return fail(a.run.top, outcome)


def exhausted(a: CallFrame) -> Next:
    """A limit of the step is used up."""
    return handled(a, "on_exhausted", "exhausted")


def resend(a: CallFrame) -> Next:
    """Sends again what the step has sent, if it may."""
    run, retries = a.run, a.step.retries
    if run.given_up or (retries is not None and a.resends >= retries(a)):
        return exhausted(a)
    a.resends += 1
    still_due(run)
    if a.sent is not None:
        run.machine.put_out(run, a.sent[0], a.sent[1], True)
    if run.state is RECEIVING:
        begin_clock(run, run.machine.scope.now)
        return None
    return wait(a, a.step)


def unclear(a: CallFrame, error: Exception) -> bool:
    """A condition that cannot be worked out for a frame does not hold; that is shown."""
    a.m.show("trouble", reason=f"step {a.step.name}, condition of a row: {explain(error)}")
    return False


# ---- waiting ----------------------------------------------------------------------------------------------------


def wait(a: CallFrame, step: CompiledStep) -> Next:
    """Waits for the rows of the step."""
    run = a.run
    if run.state is DONE:
        return None
    machine, d = run.machine, a.d
    run.state = RECEIVING
    machine.changed = True
    if run.lane.waiting:
        machine.stirred = True
    expected = d.expected
    run.rows, run.expected = step.rows.known.get(expected) or step.rows.of(expected)
    run.wants_others = step.wants_others
    if run.has_always:
        run.expected = _with_always(run)
    run.candidate = None
    run.wait_number += 1
    if step.queue_rows:
        machine.queues.is_due = True
    if step.is_timed:
        begin_clock(run, machine.scope.now)
    else:
        run.started = machine.scope.now
        run.complete = run.gap = None
        run.longest = run.within = run.deadline = NEVER
        run.clock_waits = False
    if d.checks_echo and d.last_sent is not None and not step.numbered:
        run.asked = a
        machine.late.within = run.longest
    return None


def _with_always(run: Run) -> tuple[str, ...]:
    """The frames of the step's rows, then of `always` rows, its own sequence's and its callers'."""
    found = dict.fromkeys(run.expected)
    for frame in run.calls():
        if frame.step.always is not None:
            found.update(dict.fromkeys(frame.step.always.of(frame.d.expected)[1]))
    return tuple(found)


def pause(a: CallFrame, time: int, go_on: Any) -> Next:
    """Waits for a time, then `go_on`; bytes that are there already count as coming now."""
    run, machine = a.run, a.m
    if run.state is DONE:
        return None
    run.state = PAUSING
    run.pause = time
    run.go_on = go_on
    run.wait_number += 1
    machine.changed = True
    begin_clock(run, machine.scope.now)
    handler = a.step.handlers.get("on_byte")
    if handler is not None and machine.has_bytes():
        following = handler(a)
        if following is not NOT_TAKEN:
            return following
    return None


def _go_on(run: Run) -> Next:
    if run.asked is not None:
        missed(run)
    run.state, run.deadline = GOING, NEVER
    run.machine.changed = True
    return run.go_on(run.top)


def _time_up(run: Run) -> Next:
    if run.state is PAUSING:
        return _go_on(run)
    if run.state is not RECEIVING:
        return None
    run.deadline = run.within = NEVER
    run.candidate = None
    run.cause = run.cause or "nothing came in time"
    return handled(run.top, "on_timeout", "timeout")


# ---- late replies -----------------------------------------------------------------------------------------------


def missed(run: Run) -> None:
    """What the run has asked for has not come, and it waits no longer."""
    still_due(run)
    run.asked = None


def still_due(run: Run) -> None:
    """What it has asked for has not come; it asks again, or does something else."""
    if run.asked is not None:
        run.machine.late.missed(run.asked.names(), run.started, run.longest)


def replied(run: Run) -> None:
    """A row takes what came: what the run has asked for is due no longer."""
    asked, run.asked = run.asked, None
    late = run.machine.late
    if asked is not None and late.until:
        late.extend(asked.names(), run.started, run.longest)


def is_held(a: CallFrame, go_on: Any, value: Any = None) -> bool:
    """Whether an exchange has to wait before it sends `value`, or a break: then it does, and `go_on` is done after."""
    machine, d, run = a.m, a.d, a.run
    late, now = machine.late, machine.scope.now
    if not d.checks_echo or late.until <= now or _repeats(a, value):
        return False
    run.state = State.HELD
    run.go_on = go_on
    run.started, run.deadline = now, late.until
    machine.changed = True
    return True


def _repeats(a: CallFrame, value: Any) -> bool:
    """Whether the exchange has sent the same bytes last: whichever reply comes, it is one to this request."""
    last = a.d.last_sent
    return last is not None and type(value) is FrameValue and a.m.table.encode(value, a.names()) == last.raw


# ---- what steps and rows do -------------------------------------------------------------------------------------


def cut_parts(a: CallFrame, data: bytes, most: int) -> bool:
    """Cuts what a step does piece by piece. Tells whether there is a piece."""
    if most <= 0:
        raise ValueError(f"pieces of {most} bytes cannot be cut")
    a.parts = [data[start : start + most] for start in range(0, len(data), most)]
    return bool(a.parts)


def begin_part(a: CallFrame, index: int) -> None:
    """The step is done for this piece."""
    count(a.run)
    if a.run.asked is not None:
        missed(a.run)
    parts = a.parts or []
    following = len(parts[index + 1]) if index + 1 < len(parts) else 0
    a.part_index = index
    a.resends = 0
    a.part = {"data": parts[index], "index": index, "last": int(not following), "next": following}


def has_more(a: CallFrame) -> bool:
    """Whether another piece follows."""
    return bool(a.parts) and a.part_index + 1 < len(a.parts or ())


def hold_break(a: CallFrame, duration: int) -> None:
    machine, run = a.m, a.run
    if duration > 0 and machine.output.put(Break(duration, 0, run)):
        run.unsent += 1
        if machine.monitor is not None:
            machine.show("break", "out")


def change_line(a: CallFrame, speed: Any, format: Any, go_on: Any) -> Next:
    """Other speed and format when all that was sent has left; the run goes on then. None stays as it is."""
    run, machine = a.run, a.m
    line = machine.scope.line.line
    if run.state is DONE:
        return None
    if line is None:  # there is nothing to change on a stream
        return go_on
    shape = str(line).partition(" ")[2] if format is None else format
    change = machine.output.change_line(parse_format(shape, line.speed if speed is None else speed))
    if change is None:
        return go_on
    return _until_changed(run, change, go_on)


def own_line(a: CallFrame, go_on: Any) -> Next:
    """As `change_line`, to the line's own settings."""
    own = a.m.scope.line.own
    return go_on if own is None else change_line(a, own.speed, str(own).partition(" ")[2], go_on)


def _until_changed(run: Run, change: ChangeLine, go_on: Any) -> Next:
    run.state, run.deadline = State.CHANGING, NEVER
    run.go_on = go_on
    run.wait_number += 1
    run.machine.changed = True
    change.run, change.number = run, run.wait_number
    return None


def decoded(a: CallFrame, frames: tuple[str, ...], data: Any) -> FrameValue | None:
    """Bytes as the first of these frames that they are; None if they are none: that is counted and shown.

    Raises TypeError for what is no bytes.
    """
    machine, run, names, table = a.m, a.run, a.names(), a.m.table
    if not isinstance(data, (bytes, bytearray)):
        raise TypeError("only bytes can be decoded")
    raw, found = bytes(data), list[tuple[int, str, FrameError]]()
    for name in sorted(frames, key=lambda one: table.infos[one].refuse is not None):
        try:
            value: FrameValue = table.received(name, table.infos[name].decode(raw, names), raw, None)
        except FrameError as error:
            if error.refuse is not None:
                value = table.received(name, dict(error.fields), raw, error.refuse)
                machine.accept(value)
                return value
            first = error.also or error
            found.append((len(raw) if first.cause == "check" else first.offset, name, error))
        else:
            machine.accept(value)
            return value
    _, frame, fault = max(found, key=lambda one: one[0])  # the first of those that got furthest
    a.cause, a.frame, run.state = fault.cause, frame, GOING
    run.cause = f"{frame}: {fault}"
    machine.count_bad()
    machine.show(
        "bad", "in", raw, frame, reason=fault.cause, started_at=machine.scope.now, segment=fault.segment,
        place=fault.offset,
    )  # fmt: skip
    return None


def serve(a: CallFrame, request: Any, buffer: bytes, station: Any, check_only: bool) -> None:
    """Has a request done; its answer stands in `reply`, `reply_buffer` and `refusal` then."""
    machine, d = a.m, a.d
    if machine.server is None:
        raise ValueError("nobody here serves requests")
    if type(request) is not FrameValue:
        raise TypeError("only a frame can be served")
    served = machine.server.serve(request, buffer, station, check_only, d.names)
    if served.trouble:
        machine.show("trouble", frame=request.frame, reason=served.trouble)
    d.reply, d.reply_buffer, d.refusal = served.reply, served.reply_buffer, served.refusal
    d.answers(request)
    is_owed = not check_only and served.reply is not None and not served.refusal
    a.run.owed = (served.reply, d.last_taken) if is_owed and served.reply is not None else None
    if not check_only:
        d.buffer = served.reply_buffer


def put(a: CallFrame, queue: str, item: dict[str, Any]) -> None:
    """Puts an item into a queue; a frame in it gets its computed fields now."""
    machine = a.m
    for value in item.values():
        if type(value) is FrameValue and value.raw is None:
            machine.table.encode(value, a.names())
            value.complete()
    machine.queues.put(queue, item)
    machine.changed = machine.stirred = True


def set_field(a: CallFrame, holder: Any, field: str, value: Any) -> None:
    """Sets a field of a frame or a record."""
    if type(holder) is FrameValue:
        numbers = a.m.table.infos[holder.frame].numbers.get(field)
        holder.set_field(field, numbers.get(value, value) if numbers and isinstance(value, str) else value)
    else:
        holder[field] = value


def send_value(a: CallFrame, value: Any) -> tuple[bytes, FrameValue] | None:
    """Sends a frame value; None sends nothing. Raises ValueError for values that the frame cannot carry."""
    if value is None:
        return None
    if type(value) is not FrameValue:
        raise TypeError(f"{value!r} is no frame and cannot be sent")
    return send_made(a, value, a.names() if value.frame in a.m.need_names else a.n)


def send_made(a: CallFrame, value: FrameValue, names: Names) -> tuple[bytes, FrameValue]:
    """Sends a frame that has been made; its fields are worked out on `names`."""
    machine, d = a.m, a.d
    if not d.checks_echo:
        machine.table.fill_echo(value, d.answering, d.last_taken)
    data = machine.table.encode(value, names)
    machine.announce(value)
    d.last_sent = value
    machine.put_out(a.run, data, value)
    return data, value
