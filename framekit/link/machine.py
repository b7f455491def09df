"""Runs sequences: everything that takes no time is done at once, then a run waits (language reference, section 7).

It is told what happened to which run; when a lane starts one is decided elsewhere. Nothing that a definition writes can
raise out of it: what cannot be worked out ends the sequence, and that is shown.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from framekit.codec.shown import explain
from framekit.definition.times import NEVER
from framekit.link.evaluate import EVALUATION_ERRORS
from framekit.link.exchange import Asked, Exchange, Outcome
from framekit.link.program import CompiledSequence
from framekit.link.runs import Activation, Dealing, Run, State
from framekit.link.steps import CircleError, Steps

STEPS_OF_TROUBLE = 200
"""What a step that could not be worked out counts for, so that trouble does not go round for long."""


class Machine(Steps):
    """How runs go on."""

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

    def go_on(self, run: Run) -> None:
        """What has held it back is over: it sends now."""
        self._going(run)

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

    def answered(self, run: Run, activation: Activation, outcome: Outcome) -> None:
        """The service that `activation` asked for is done."""
        if run.state is not State.ASKING or not run.stack or run.top is not activation:
            return
        self._going(run)
        if outcome.ok:
            for variable, result in activation.step.into:
                activation.names[variable] = outcome.results[result]
        else:
            run.cause = outcome.cause
            name = outcome.outcome or "refused"
            self.handle(run, "on_fail", name, {"outcome": name, "cause": run.cause})


class _Asked(Asked):
    """What the callback of an `ask` step gets."""

    def __init__(self, machine: Machine, run: Run, activation: Activation) -> None:
        self.machine, self.run, self.activation = machine, run, activation
        exchange = activation.dealing.exchange
        self.params = {} if exchange is None else exchange.params

    def __call__(self, outcome: Outcome) -> None:
        machine = self.machine
        machine.callbacks.append(lambda: machine.guarded(self.run, machine.answered, self.activation, outcome))
        machine.changed = True


def arguments_of(sequence: CompiledSequence, dealing: Dealing) -> dict[str, Any]:
    """The arguments of an exchange's sequence: the names it takes, as the exchange has them."""
    return {name: dealing.names.get(name) for name in sequence.takes}
