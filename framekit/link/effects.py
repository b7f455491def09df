"""What actions and steps do, as functions: set, store, put, take, deliver, send.

They are compiled with the sequence they stand in, since that decides which names are its own variables.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any

from framekit.definition.expression.syntax import Expression
from framekit.definition.model import protocol as model
from framekit.definition.model.procedure import Action, Sequence, Target
from framekit.definition.model.values import Value
from framekit.link.construct_values import Compute
from framekit.link.evaluate import compile_expression
from framekit.link.values import FrameValue
from framekit.link.variables import fit_of

if TYPE_CHECKING:
    from framekit.link.environment import Environment
    from framekit.link.runs import Activation, Run

Effect = Callable[["Environment", "Run", "Activation"], None]
Set = Callable[["Environment", "Activation", Any], None]


class EffectCompiler:
    """Effects of one sequence."""

    def __init__(self, sequence: Sequence, protocol: model.Protocol, value: Callable[[Value], Compute]) -> None:
        self.protocol = protocol
        self.value = value
        self.own = dict.fromkeys(sequence.takes, "")
        self.own.update(sequence.local)

    def of_action(self, action: Action) -> tuple[Effect, ...]:
        """In the language's order: take, set, store, put, deliver, send."""
        effects: list[Effect] = []
        if action.take is not None:
            effects.append(_take(action.take))
        effects.extend(self.settings(action.set))
        effects.extend(self._store(place, address) for place, address in action.store)
        effects.extend(self.puts(action.put))
        if action.deliver is not None:
            effects.append(self.deliver(action.deliver))
        if action.send is not None:
            effects.append(self.send(action.send))
        return tuple(effects)

    # ---- set ----------------------------------------------------------------------------------------------

    def settings(self, settings: Iterable[tuple[Target, Value]]) -> list[Effect]:
        return [_setting(self.setter(target), self.value(value)) for target, value in settings]

    def setter(self, target: Target) -> Set:
        """How a target is written."""
        name = target.name
        if target.field is not None:
            return _set_field(name, target.field)
        if target.key is not None:
            return _set_entry(name, compile_expression(target.key), name in self.own)
        if name in self.own or not self._is_shared(name):
            if name == "request":
                return _set_request
            fit = fit_of(self.own.get(name, ""))

            def set_own(machine: Environment, activation: Activation, value: Any) -> None:
                activation.names[name] = fit(value)

            return set_own
        return lambda machine, activation, value: machine.scope.set(name, value)

    def _is_shared(self, name: str) -> bool:
        return name in self.protocol.state or name in self.protocol.params or name == "clock"

    # ---- the others ---------------------------------------------------------------------------------------

    def _store(self, place: Expression, address: str) -> Effect:
        compute = compile_expression(place)

        def store(machine: Environment, run: Run, activation: Activation) -> None:
            machine.store(address, compute(activation.names))

        return store

    def puts(self, puts: Iterable[tuple[str, Mapping[str, Value]]]) -> list[Effect]:
        return [self._put(queue, fields) for queue, fields in puts]

    def _put(self, queue: str, fields: Mapping[str, Value]) -> Effect:
        compiled = tuple((name, self.value(value)) for name, value in fields.items())

        def put(machine: Environment, run: Run, activation: Activation) -> None:
            names = activation.names
            item = {name: compute(names) for name, compute in compiled}
            for value in item.values():
                if type(value) is FrameValue:
                    machine.complete(value, activation)
            machine.put(queue, item)

        return put

    def deliver(self, value: Value) -> Effect:
        compute = self.value(value)

        def deliver(machine: Environment, run: Run, activation: Activation) -> None:
            machine.deliver(compute(activation.names))

        return deliver

    def send(self, value: Value) -> Effect:
        """A frame that an action sends; it is not what `resend` repeats."""
        compute = self.value(value)

        def send(machine: Environment, run: Run, activation: Activation) -> None:
            machine.send(run, activation, compute(activation.names))

        return send


def _take(queue: str) -> Effect:
    def take(machine: Environment, run: Run, activation: Activation) -> None:
        activation.names["it"] = machine.take_item(queue)

    return take


def _setting(setter: Set, compute: Compute) -> Effect:
    def setting(machine: Environment, run: Run, activation: Activation) -> None:
        setter(machine, activation, compute(activation.names))

    return setting


def _set_request(machine: Environment, activation: Activation, value: Any) -> None:
    activation.names["request"] = value
    activation.dealing.answers(value)


def _set_field(name: str, field: str) -> Set:
    def set_field(machine: Environment, activation: Activation, value: Any) -> None:
        holder = activation.names[name]
        if type(holder) is FrameValue:
            holder.set_field(field, machine.number_named(holder.frame, field, value))
        else:
            holder[field] = value

    return set_field


def _set_entry(name: str, key: Callable[[Any], Any], own: bool) -> Set:
    def set_entry(machine: Environment, activation: Activation, value: Any) -> None:
        place = key(activation.names)
        if not own:
            machine.scope.set_entry(name, place, value)
            return
        changed = activation.names[name].copy()
        changed[place] = value
        activation.names[name] = changed

    return set_entry
