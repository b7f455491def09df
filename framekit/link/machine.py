"""Moves sequences on: steps, words, calls, counters and clocks (language reference, section 7).

It is told what happened and decides what follows for the run concerned; which run that is, and when a lane starts one,
is decided elsewhere. Nothing that a definition writes can raise out of it: what cannot be worked out ends the run.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from framekit.definition.times import NEVER
from framekit.link.clocks import begin_clock
from framekit.link.environment import Environment, explain
from framekit.link.evaluate import EVALUATION_ERRORS
from framekit.link.exchange import Asked, Exchange, Outcome
from framekit.link.program import CompiledAction, CompiledSequence
from framekit.link.runs import Activation, Dealing, Run, State
from framekit.link.values import FrameValue

MOST_STEPS = 20_000
"""So many steps of a lane at one instant are a circle of steps in which nothing waits."""
STEPS_OF_TROUBLE = 200
"""What a step that could not be worked out counts for, so that trouble does not go round for long."""


class CircleError(Exception):
    """Steps go round without waiting."""


class Machine(Environment):
    """How runs move."""

    # ---- moving on ----------------------------------------------------------------------------------------

    def start(self, run: Run, activation: Activation) -> None:
        """The first step of a sequence on top of the run's stack."""
        run.stack.append(activation)
        self.enter(run, activation, 0)

    def start_run(self, run: Run, activation: Activation) -> None:
        """A run begins a sequence, and does everything in it that takes no time."""
        self.guarded(run, self.start, activation)

    def guarded(self, run: Run, do: Callable[..., Any], *arguments: Any) -> Any:
        """Does something for a run and what follows from it; what cannot be worked out ends its sequence."""
        result = None
        try:
            result = do(run, *arguments)
        except EVALUATION_ERRORS as error:
            self._trouble(run, error)
        except CircleError:
            self._circle(run)
        while run.state is State.GOING:
            try:
                self._advance(run)
            except EVALUATION_ERRORS as error:
                self._trouble(run, error)
            except CircleError:
                self._circle(run)
        return result

    def _advance(self, run: Run) -> None:
        while run.state is State.GOING:
            activation = run.stack[-1]
            phases = activation.step.phases
            if activation.phase < len(phases):
                activation.phase += 1
                phases[activation.phase - 1](self, run, activation)
            else:
                self.leave_step(run, activation)

    def _trouble(self, run: Run, error: Exception) -> None:
        """Something a definition wrote could not be worked out: the sequence ends, its callers may go on."""
        if run.state is State.DONE:
            return
        run.cause = explain(error)
        run.lane.steps_done += STEPS_OF_TROUBLE
        self.show("trouble", reason=f"{run.lane.name}, step {run.top.step.name}: {run.cause}")
        outcome = "queue_full" if isinstance(error, OverflowError) else "expression"
        try:
            self.fail(run, run.top, outcome)
        except EVALUATION_ERRORS:
            self.fail_run(run, outcome)

    def _circle(self, run: Run) -> None:
        run.cause = "steps go round without waiting"
        self.show("trouble", reason=f"{run.lane.name}: {run.cause}")
        self.fail_run(run, "circle")

    def enter(self, run: Run, activation: Activation, index: int) -> None:
        self._count(run)
        activation.index = index
        activation.step = activation.sequence.steps[index]
        activation.phase = 0
        activation.resends = 0
        activation.parts = None
        activation.sent = None
        self._going(run)

    def _going(self, run: Run) -> None:
        run.state = State.GOING
        run.deadline = NEVER
        self.changed = True

    def _count(self, run: Run) -> None:
        lane = run.lane
        if lane.steps_since != self.scope.now:
            lane.steps_since, lane.steps_done = self.scope.now, 0
        lane.steps_done += 1
        if lane.steps_done > MOST_STEPS:
            raise CircleError

    def skip_step(self, run: Run, activation: Activation) -> None:
        """The step's `when` does not hold: the following one."""
        activation.counters.pop(activation.index, None)
        self._enter_or_end(run, activation, activation.index + 1)

    def leave_step(self, run: Run, activation: Activation) -> None:
        """The step is done: its next piece, or where it says it goes."""
        parts = activation.parts
        if parts is not None and activation.part_index + 1 < len(parts):
            self.begin_piece(run, activation, activation.part_index + 1)
            return
        activation.counters.pop(activation.index, None)
        then = activation.step.then
        if then == "end":
            self.end(run, activation)
        elif then == "next":
            self._enter_or_end(run, activation, activation.index + 1)
        else:
            self.enter(run, activation, activation.sequence.index.get(then, activation.index))

    def _enter_or_end(self, run: Run, activation: Activation, index: int) -> None:
        if index < len(activation.sequence.steps):
            self.enter(run, activation, index)
        else:
            self.end(run, activation)

    def begin_piece(self, run: Run, activation: Activation, index: int) -> None:
        self._count(run)
        parts = activation.parts or []
        following = len(parts[index + 1]) if index + 1 < len(parts) else 0
        activation.part_index = index
        activation.phase = activation.step.piece_start
        activation.resends = 0
        activation.counters.pop(activation.index, None)
        activation.names["part"] = {
            "data": parts[index], "index": index, "last": int(not following), "next": following,
        }  # fmt: skip
        self._going(run)

    # ---- actions ------------------------------------------------------------------------------------------

    def take(self, run: Run, activation: Activation, action: CompiledAction, usual: str, outcome: str = "") -> None:
        """Does an action. `usual` is where it leads when it does not say; `outcome` the failure it stands for then."""
        if action.at_most is not None:
            counters = activation.counters.setdefault(activation.index, {})
            count = counters.get(action, 0)
            if count >= action.at_most(activation.names):
                self._used_up(run, activation, action)
                return
            counters[action] = count + 1
        for effect in action.effects:
            effect(self, run, activation)
        if action.fail is not None:
            self.abandon_above(run, activation)
            self.fail(run, activation, action.fail)
        elif action.then is None and outcome:
            self.abandon_above(run, activation)
            self.fail(run, activation, outcome)
        else:
            self.follow(run, activation, action.then or usual, action)

    def _used_up(self, run: Run, activation: Activation, action: CompiledAction) -> None:
        if action.otherwise is not None:
            self.take(run, activation, action.otherwise, "next")
        else:
            self.handle(run, "on_exhausted", "exhausted")

    def follow(self, run: Run, activation: Activation, word: str, action: CompiledAction | None = None) -> None:
        """Goes where a word says. A row that leads to another step keeps its count: no endless rounds."""
        if word == "again":
            return
        if word == "restart" and run.state is State.RECEIVING:
            begin_clock(run, self.scope.now)
            return
        self.abandon_above(run, activation)
        if word == "resend":
            self._resend(run, activation)
            return
        if word in ("next", "restart"):
            self.leave_step(run, activation)
            return
        counters = activation.counters.pop(activation.index, None)
        if word == "end":
            self.end(run, activation)
            return
        if counters and action in counters:
            activation.counters[activation.index] = {action: counters[action]}
        self.enter(run, activation, activation.sequence.index[word])

    def _resend(self, run: Run, activation: Activation) -> None:
        retries = activation.step.retries
        if retries is not None and activation.resends >= retries(activation.names):
            self.handle(run, "on_exhausted", "exhausted")
            return
        activation.resends += 1
        if activation.sent is not None:
            data, value = activation.sent
            self.put_out(run, data, value, repeated=True)
        if run.state is State.RECEIVING:
            begin_clock(run, self.scope.now)
        else:
            self.receive(run)

    def handle(self, run: Run, event: str, outcome: str = "", names: dict[str, Any] | None = None) -> bool:
        """Lets the run handle an event; without a handler it fails with `outcome`, if given. False: nothing done."""
        found = run.handler(event)
        if found is not None:
            activation, actions = found
            if names:
                activation.names.update(names)
            for action in actions:
                if action.when is None or action.when(activation.names):
                    self.take(run, activation, action, "next" if event == "on_byte" else "again", outcome)
                    return True
        if not outcome:
            return False
        self.fail(run, run.top, outcome)
        return True

    # ---- ends ---------------------------------------------------------------------------------------------

    def end(self, run: Run, activation: Activation) -> None:
        """A sequence has come to its end: results to its caller, or to whoever started it."""
        results = {name: evaluate(activation.names) for name, evaluate in activation.sequence.gives}
        run.stack.pop()
        if activation.nested:
            self._end_nested(run, activation.dealing, self._outcome(activation.dealing, results))
        elif run.stack:
            caller = run.stack[-1]
            for variable, result in caller.step.call_into:
                caller.names[variable] = results[result]
            self._going(run)
        else:
            self._finish(run, activation.dealing, self._outcome(activation.dealing, results))

    def fail(self, run: Run, activation: Activation, outcome: str) -> None:
        """A sequence fails: its caller handles that, or fails too."""
        run.stack.pop()
        if activation.nested:
            self._end_nested(run, activation.dealing, Outcome(False, outcome, run.cause))
        elif run.stack:
            self._going(run)
            self.handle(run, "on_fail", outcome, {"outcome": outcome})
        else:
            self._finish(run, activation.dealing, Outcome(False, outcome, run.cause))

    def fail_run(self, run: Run, outcome: str) -> None:
        """The whole run ends, whatever its sequences would do about it."""
        if run.state is not State.DONE:
            self.abandon_above(run, run.stack[0])
            dealing = run.stack[0].dealing
            run.stack.clear()
            self._finish(run, dealing, Outcome(False, outcome, run.cause))

    def abandon_above(self, run: Run, activation: Activation) -> None:
        """Drops the calls above an activation."""
        while run.stack and run.stack[-1] is not activation:
            dropped = run.stack.pop()
            if dropped.nested and dropped.dealing.exchange is not None:
                self.tell(dropped.dealing.exchange, Outcome(False, "abandoned", run.cause))

    def _finish(self, run: Run, dealing: Dealing, outcome: Outcome) -> None:
        run.state = State.DONE
        run.deadline = NEVER
        run.outcome = outcome
        self.changed = True
        self.ended.append(run)

    def _outcome(self, dealing: Dealing, results: dict[str, Any]) -> Outcome:
        reply, buffer = results.get("reply"), results.get("buffer", b"")
        return Outcome(
            True,
            reply=reply if type(reply) is FrameValue else None,
            buffer=buffer if isinstance(buffer, bytes) else b"",
            results=results,
            raw=dealing.raw,
        )

    # ---- calls, services ----------------------------------------------------------------------------------

    def call(self, run: Run, activation: Activation, name: str, arguments: dict[str, Any]) -> None:
        self.start(run, Activation(self.sequences[name], activation.dealing, arguments, False))

    def ask(self, run: Run, activation: Activation, service: str, arguments: dict[str, Any]) -> None:
        """Runs a service; its exchanges run inside this step."""
        if self.ask_service is None:
            raise ValueError("nobody here runs services")
        run.state = State.ASKING
        self.changed = True
        asked = _Asked(self, run, activation)
        before, self.asking = self.asking, run
        try:
            self.ask_service(service, arguments, activation.names["station"], asked)
        finally:
            self.asking = before

    def start_inside(self, run: Run, exchange: Exchange) -> None:
        """An exchange of the service that the run's `ask` step has asked for."""
        name = exchange.run or run.lane.exchange[0]
        dealing = Dealing(self.scope, exchange, True)
        self.start(run, Activation(self.sequences[name], dealing, arguments_of(self.sequences[name], dealing), True))

    def _end_nested(self, run: Run, dealing: Dealing, outcome: Outcome) -> None:
        run.state = State.ASKING
        self.changed = True
        exchange = dealing.exchange
        assert exchange is not None

        def tell() -> None:
            before, self.asking = self.asking, run
            try:
                exchange.on_done(outcome)
            finally:
                self.asking = before

        self.callbacks.append(tell)

    def answered(self, run: Run, activation: Activation, outcome: Outcome) -> None:
        """The service that `activation` asked for is done."""
        if run.state is not State.ASKING or not run.stack or run.top is not activation:
            return
        self._going(run)
        if not outcome.ok:
            run.cause = outcome.cause
            name = outcome.outcome or "refused"
            self.handle(run, "on_fail", name, {"outcome": name})

    # ---- waiting ------------------------------------------------------------------------------------------

    def receive(self, run: Run) -> None:
        """Waits for the rows of the step."""
        run.state = State.RECEIVING
        run.interest = run.frames_waited_for()
        run.wants_others = run.has_handler("on_other", "on_bad")
        run.candidate = None
        run.wait_number += 1
        self.changed = True
        begin_clock(run, self.scope.now)

    def pause(self, run: Run, time: int) -> None:
        """Waits for a time; bytes that are there already count as coming now."""
        if time <= 0:
            return
        run.state = State.PAUSING
        run.pause = time
        run.wait_number += 1
        self.changed = True
        begin_clock(run, self.scope.now)
        if run.has_handler("on_byte") and self.has_bytes():
            self.handle(run, "on_byte")

    def time_up(self, run: Run) -> None:
        """A time limit of the run has run out, or its pause is over."""
        self.guarded(run, self._time_up)

    def _time_up(self, run: Run) -> None:
        if run.state is State.PAUSING:
            self._going(run)
        elif run.state is State.RECEIVING:
            run.deadline = run.within = NEVER
            run.candidate = None
            run.cause = run.cause or "nothing came in time"
            self.handle(run, "on_timeout", "timeout")


class _Asked(Asked):
    """What the callback of an `ask` step gets."""

    def __init__(self, machine: Machine, run: Run, activation: Activation) -> None:
        self.machine, self.run, self.activation = machine, run, activation

    def __call__(self, outcome: Outcome) -> None:
        machine = self.machine
        machine.callbacks.append(lambda: machine.answered(self.run, self.activation, outcome))
        machine.changed = True


def arguments_of(sequence: CompiledSequence, dealing: Dealing) -> dict[str, Any]:
    """The arguments of an exchange's sequence: the names it takes, as the exchange has them."""
    return {name: dealing.names.get(name) for name in sequence.takes}
