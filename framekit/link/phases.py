"""The keys of a step as functions, in the order in which the language does them.

After each phase the machine looks where the run stands: it may wait now, or be in another step or sequence.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from framekit.definition.expression.syntax import Expression
from framekit.definition.model.procedure import CallOf, Parts, Serve, Step
from framekit.definition.model.values import FrameOf, Value
from framekit.link.evaluate import compile_expression

if TYPE_CHECKING:
    from framekit.link.machine import Machine
    from framekit.link.program import CompiledStep, ProgramCompiler
    from framekit.link.runs import Activation, Run

Phase = Callable[["Machine", "Run", "Activation"], None]


def phases_of(step: Step, compiled: CompiledStep, compiler: ProgramCompiler) -> tuple[tuple[Phase, ...], int]:
    """The phases of a step, and the one where each piece of `parts` begins."""
    effects = compiler.effects
    phases: list[Phase] = []
    if step.when is not None:
        phases.append(_condition(step.when))
    if step.session is not None:
        phases.append(_session(step.session == "new"))
    if step.parts is not None:
        phases.append(_parts(step.parts))
    start = len(phases)
    if step.wait is not None:
        phases.append(_wait(step.wait))
    if step.hold_break is not None:
        phases.append(_break(step.hold_break))
    if step.flush:
        phases.append(_flush)
    phases.extend(effects.settings(step.set))
    if step.serve is not None:
        phases.append(_serve(step.serve))
    if step.call is not None:
        phases.append(_call(step.call, compiler))
    if step.ask is not None:
        phases.append(_ask(step.ask, compiler))
    phases.extend(effects.puts(step.put))
    if step.deliver is not None:
        phases.append(effects.deliver(step.deliver))
    if step.send is not None:
        phases.append(_send(step.send, step.urgent, compiler))
    if step.receive is not None:
        phases.append(_receive)
    elif step.branch is not None:
        phases.append(_branch)
    return tuple(phases), start


def _condition(when: Expression) -> Phase:
    holds = compile_expression(when)

    def phase(machine: Machine, run: Run, activation: Activation) -> None:
        if not holds(activation.names):
            machine.skip_step(run, activation)

    return phase


def _session(new: bool) -> Phase:
    def phase(machine: Machine, run: Run, activation: Activation) -> None:
        machine.set_session(new)

    return phase


def _parts(parts: Parts) -> Phase:
    of, size = compile_expression(parts.of), compile_expression(parts.size)

    def phase(machine: Machine, run: Run, activation: Activation) -> None:
        data, most = of(activation.names), size(activation.names)
        if most <= 0:
            raise ValueError(f"pieces of {most} bytes cannot be cut")
        activation.parts = [data[start : start + most] for start in range(0, len(data), most)]
        if activation.parts:
            machine.begin_piece(run, activation, 0)
        else:
            machine.leave_step(run, activation)

    return phase


def _wait(time: Expression) -> Phase:
    compute = compile_expression(time)

    def phase(machine: Machine, run: Run, activation: Activation) -> None:
        machine.pause(run, compute(activation.names))

    return phase


def _break(time: Expression) -> Phase:
    compute = compile_expression(time)

    def phase(machine: Machine, run: Run, activation: Activation) -> None:
        if machine.late.until and machine.is_held(run, activation):
            return
        machine.hold_break(run, compute(activation.names))

    return phase


def _flush(machine: Machine, run: Run, activation: Activation) -> None:
    if machine.flush is not None:
        machine.flush()


def _serve(serve: Serve) -> Phase:
    request = compile_expression(serve.request)
    buffer = None if serve.buffer is None else compile_expression(serve.buffer)
    station = None if serve.station is None else compile_expression(serve.station)
    check_only = serve.check_only

    def phase(machine: Machine, run: Run, activation: Activation) -> None:
        names = activation.names
        machine.serve(
            activation,
            request(names),
            b"" if buffer is None else buffer(names),
            names["station"] if station is None else station(names),
            check_only,
        )

    return phase


def _call(call: CallOf, compiler: ProgramCompiler) -> Phase:
    arguments = compiler.fields(call.arguments)
    sequence = call.sequence

    def phase(machine: Machine, run: Run, activation: Activation) -> None:
        machine.call(run, activation, sequence, arguments(activation.names))

    return phase


def _ask(ask: FrameOf, compiler: ProgramCompiler) -> Phase:
    arguments = compiler.fields(ask.fields)
    service = ask.frame

    def phase(machine: Machine, run: Run, activation: Activation) -> None:
        machine.ask(run, activation, service, arguments(activation.names))

    return phase


def _send(value: Value, urgent: bool, compiler: ProgramCompiler) -> Phase:
    compute = compiler.value(value)

    def phase(machine: Machine, run: Run, activation: Activation) -> None:
        value = compute(activation.names)
        if machine.late.until and not urgent and machine.is_held(run, activation, value):
            return
        activation.sent = machine.send(run, activation, value)

    return phase


def _receive(machine: Machine, run: Run, activation: Activation) -> None:
    machine.receive(run)


def _branch(machine: Machine, run: Run, activation: Activation) -> None:
    for action in activation.step.branch:
        if action.when is None or action.when(activation.names):
            machine.take(run, activation, action, "next")
            return
