"""The keys of a step, in the order in which the language does them: what each writes into the step's functions.

A key of the language is a row of `STEP_KEYS`: the step's attribute and the function that writes what it does. A key
that waits ends the function and begins another one for what follows.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from framekit.codec.python.source import quoted
from framekit.definition.brought import bring
from framekit.definition.expression.syntax import Expression
from framekit.definition.keys import Form, key_of
from framekit.definition.model.procedure import ADDED_KEYS, Action, CallOf, Parts, Serve
from framekit.definition.model.values import FrameOf, Value
from framekit.definition.schema import add_keys
from framekit.link.sequences.writing import StepWriter


class StepKey(NamedTuple):
    """A key that a step may have; `write` tells whether nothing of the step is reached behind it."""

    attribute: str
    write: Callable[[StepWriter, Any], bool | None]

    def write_into(self, step: StepWriter) -> bool:
        found = step.step
        value = found.more[self.attribute] if self.attribute in found.more else getattr(found, self.attribute, None)
        return value is not None and value is not False and bool(self.write(step, value))


def _when(step: StepWriter, condition: Expression) -> None:
    with step.out.block(f"if not ({step.expression(condition)}):"):
        step.reset_counters()
        step.to_index(step.index + 1)


def _session(step: StepWriter, kind: str) -> None:
    step.add(f"{step.local('m')}.set_session({kind == 'new'})")


def _parts(step: StepWriter, parts: Parts) -> None:
    with step.out.block(f"if not cut_parts(a, {step.expression(parts.of)}, {step.expression(parts.size)}):"):
        step.leave()
    step.add("begin_part(a, 0)")
    step.add(f"return {step.called('part')}(a)")
    step.split("part")


def _wait(step: StepWriter, time: Expression) -> None:
    step.add(f"time = {step.expression(time)}")
    with step.out.block("if time > 0:"):
        step.add(f"return pause(a, time, {step.called('waited')})")
    step.add(f"return {step.called('waited')}(a)")
    step.split("waited")


def _hold_break(step: StepWriter, time: Expression) -> None:
    if step.held:
        step.add(f"return {step.called('break')}(a)")
        step.split("break")
        with step.out.block(f"if {step.local('m')}.late.until and is_held(a, {step.called('break')}):"):
            step.add("return None")
    step.add(f"hold_break(a, {step.expression(time)})")


def _flush(step: StepWriter, _: bool) -> None:
    with step.out.block(f"if {step.local('m')}.flush is not None:"):
        step.add("m.flush()")


def _set(step: StepWriter, settings: tuple[Any, ...]) -> None:
    for target, value in settings:
        step.set(target, value)


def _serve(step: StepWriter, serve: Serve) -> None:
    buffer = 'b""' if serve.buffer is None else step.expression(serve.buffer)
    station = f"{step.local('d')}.station" if serve.station is None else step.expression(serve.station)
    step.add(f"serve(a, {step.expression(serve.request)}, {buffer}, {station}, {serve.check_only})")


def _call(step: StepWriter, called: CallOf) -> None:
    step.add(f"return call(a, {quoted(called.sequence)}, {step.record(called.arguments)})")
    _goes_on(step, called.into)


def _ask(step: StepWriter, asked: FrameOf) -> None:
    step.add(f"ask(a, {quoted(asked.frame)}, {step.record(asked.fields)})")
    step.add("return None")
    _goes_on(step, step.step.ask_into)


def _goes_on(step: StepWriter, into: Mapping[str, str]) -> None:
    """What follows when the results are there."""
    step.split("back", "a, results")
    for variable, result in into.items():
        step.assign(variable, f"results[{quoted(result)}]", fits=True)
    step.add(f"return {step.goes_on}(a)")
    step.split("after")


def _put(step: StepWriter, puts: tuple[Any, ...]) -> None:
    for queue, fields in puts:
        step.add(f"put(a, {quoted(queue)}, {step.record(fields)})")


def _deliver(step: StepWriter, value: Value) -> None:
    step.add(f"{step.local('m')}.deliver({step.value(value)})")


def _send(step: StepWriter, value: Value) -> None:
    if step.held and not step.step.urgent:
        step.add(f"return {step.called('send')}(a)")
        step.split("send")
        held = f"is_held(a, {step.called('send')}, {step.value(value)})"
        with step.out.block(f"if {step.local('m')}.late.until and {held}:"):
            step.add("return None")
    step.send(value, repeats=True)


def _receive(step: StepWriter, _: Any) -> bool:
    step.add(f"return wait(a, {step.called('step')})")
    return True


def _branch(step: StepWriter, actions: tuple[Action, ...]) -> bool:
    for action in actions:
        if action.when is None:
            step.act(action, "next", event="branch")
            return True
        with step.out.block(f"if {step.expression(action.when)}:"):
            step.act(action, "next", event="branch")
    return False


STEP_KEYS = [
    StepKey("when", _when),
    StepKey("session", _session),
    StepKey("parts", _parts),
    StepKey("wait", _wait),
    StepKey("hold_break", _hold_break),
    StepKey("flush", _flush),
    StepKey("set", _set),
    StepKey("serve", _serve),
    StepKey("call", _call),
    StepKey("ask", _ask),
    StepKey("put", _put),
    StepKey("deliver", _deliver),
    StepKey("send", _send),
    StepKey("receive", _receive),
    StepKey("branch", _branch),
]
"""What a step does, in this order."""


ADDED_FUNCTIONS: dict[str, Callable[..., Any]] = {}
"""Functions that keys call which programs bring by themselves."""


def add_step_key(
    name: str,
    form: Form,
    doc: str,
    write: Callable[[StepWriter, Any], bool | None],
    *functions: Callable[..., Any],
    before: str = "send",
) -> None:
    """A key that steps may have from now on, done before another one.

    `form`: how its value looks and is read. `write`: what it writes into the step's functions, as those above; what it
    writes may call `functions`.
    """
    bring(write.__module__)
    ADDED_FUNCTIONS.update((one.__name__, one) for one in functions)
    ADDED_KEYS[name] = key_of(name, form, doc)
    add_keys("protocol", "step", dict(ADDED_KEYS[name].schemas))
    place = next(place for place, one in enumerate(STEP_KEYS) if one.attribute == before)
    STEP_KEYS.insert(place, StepKey(name, write))
