"""From step to step: words, actions, counters, handlers, and how sequences end (language reference, section 7).

What cannot be worked out raises here; the machine on top of it sees to that.
"""

from __future__ import annotations

from typing import Any

from framekit.definition.times import NEVER
from framekit.link.clocks import begin_clock
from framekit.link.environment import Environment
from framekit.link.evaluate import EVALUATION_ERRORS
from framekit.link.exchange import Outcome
from framekit.link.program import CompiledAction
from framekit.link.runs import Activation, Dealing, Run, State
from framekit.link.values import FrameValue

MOST_STEPS = 20_000
"""So many steps of a lane at one instant, while no byte of the stream is used, are a circle in which nothing waits."""


class CircleError(Exception):
    """Steps go round without waiting."""


class Steps(Environment):
    """How a run gets from one step, and one sequence, to another."""

    # ---- moving on ----------------------------------------------------------------------------------------

    def start(self, run: Run, activation: Activation) -> None:
        """The first step of a sequence on top of the run's stack."""
        run.stack.append(activation)
        self.enter(run, activation, 0)

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
        if run.asked is not None:
            self._missed(run)
        run.state = State.GOING
        run.deadline = NEVER
        self.changed = True

    def _count(self, run: Run) -> None:
        lane = run.lane
        if lane.steps_since != self.scope.now:
            lane.steps_since, lane.steps_done = self.scope.now, 0
        lane.steps_done += 1
        if lane.steps_done > MOST_STEPS:
            place = self.stream_place()
            if place == lane.steps_at:
                raise CircleError
            lane.steps_at, lane.steps_done = place, 0  # thousands of frames that came at once

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
            if count >= action.at_most(activation.names) or (run.given_up and action.then == "resend"):
                self._used_up(run, activation, action)
                return
            counters[action] = count + 1
        if action.asks_again and outcome == "timeout":
            self._still_due(run)
        for effect in action.effects:
            effect(self, run, activation)
        if action.because is not None:
            run.cause = str(action.because(activation.names))
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
        if run.given_up or (retries is not None and activation.resends >= retries(activation.names)):
            self.handle(run, "on_exhausted", "exhausted")
            return
        activation.resends += 1
        self._still_due(run)
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
            for variable, result in caller.step.into:
                caller.names[variable] = results[result]
            self._going(run)
        else:
            self._finish(run, activation.dealing, self._outcome(activation.dealing, results))

    def fail(self, run: Run, activation: Activation, outcome: str) -> None:
        """A sequence fails: its caller handles that, or fails too."""
        run.stack.pop()
        if activation.nested:
            self._end_nested(run, activation.dealing, self._failure(run, activation, outcome))
        elif run.stack:
            self._going(run)
            self.handle(run, "on_fail", outcome, {"outcome": outcome, "cause": run.cause})
        else:
            self._finish(run, activation.dealing, self._failure(run, activation, outcome))

    def _failure(self, run: Run, activation: Activation, outcome: str) -> Outcome:
        """The outcome of a failure, with the results as far as there are any: a refusing reply, say."""
        results = {}
        for name, evaluate in activation.sequence.gives:
            try:
                results[name] = evaluate(activation.names)
            except EVALUATION_ERRORS:
                continue
        found = self._outcome(activation.dealing, results)
        found.ok, found.outcome, found.cause = False, outcome, run.cause
        return found

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
        if run.asked is not None:
            self._missed(run)
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

    def _end_nested(self, run: Run, dealing: Dealing, outcome: Outcome) -> None:
        if run.asked is not None:
            self._missed(run)
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

    # ---- late replies -------------------------------------------------------------------------------------

    def _missed(self, run: Run) -> None:
        """What the run has asked for has not come, and it waits no longer."""
        self._still_due(run)
        run.asked = None

    def _still_due(self, run: Run) -> None:
        """What it has asked for has not come; it asks again, or does something else."""
        if run.asked is not None:
            self.late.missed(run.asked.names, run.started, run.longest)

    def is_held(self, run: Run, activation: Activation, value: Any = None) -> bool:
        """Whether an exchange has to wait before it sends `value`, or a break: then it does, and goes on from there."""
        dealing, late = activation.dealing, self.late
        if not dealing.checks_echo or late.until <= self.scope.now or self._repeats(activation, value):
            return False
        activation.phase -= 1
        run.state = State.HELD
        run.started, run.deadline = self.scope.now, late.until
        self.changed = True
        return True

    def _repeats(self, activation: Activation, value: Any) -> bool:
        """Whether the exchange has sent the same bytes last: whichever reply comes, it is one to this request."""
        last = activation.dealing.last_sent
        return last is not None and type(value) is FrameValue and self.table.encode(value, activation.names) == last.raw

    # ---- waiting ------------------------------------------------------------------------------------------

    def receive(self, run: Run) -> None:
        """Waits for the rows of the step."""
        run.state = State.RECEIVING
        self.stirred = True
        run.interest = run.frames_waited_for()
        run.wants_others = run.has_handler("on_other", "on_bad")
        run.candidate = None
        run.wait_number += 1
        self.changed = True
        begin_clock(run, self.scope.now)
        top = run.stack[-1]
        if top.dealing.checks_echo and top.dealing.last_sent is not None and not top.step.numbered:
            run.asked = top
            self.late.within = run.longest

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
