"""Which sequences are one question and one answer, so that their exchanges can take the short way (see `direct`).

Found out once for each sequence, from the definition. Nothing is sent or received here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from framekit.definition.expression.syntax import Attribute, Expression, Name, Node, names_in
from framekit.definition.model.procedure import Row, Sequence, Step, Target
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.values import FrameOf, Value
from framekit.definition.model.walk import expressions_of
from framekit.link.construct_values import Compute, compile_value
from framekit.link.evaluate import Evaluate, compile_expression
from framekit.link.frame_table import FrameTable
from framekit.link.invert import bare_name
from framekit.link.program import CompiledRow, CompiledSequence, CompiledStep
from framekit.link.scope import Scope
from framekit.link.variables import Fit, fit_of

Settings = tuple[tuple[str, Fit, Compute], ...]
"""Variables of the sequence that a row sets: name, what makes the value fit, the value."""


@dataclass(frozen=True, slots=True)
class Condition:
    """A condition of a step, what it has to be, and whether it may be another one every time."""

    holds: Evaluate
    wanted: bool
    changes: bool


@dataclass(frozen=True, slots=True)
class DirectPlan:
    """The step of a sequence that asks and waits, with what is certain of it before any exchange begins.

    `conditions` have to be as they are wanted for that step to be the first one done. `settings` are protocol variables
    that it sets, each with the names that its value reads. `fields` are those of the frame it makes to send, each with
    whether it may be another one every time, and what it reads; none when it sends one that is made already.
    `endings`: the rows that end the exchange well, with what they set; `rows` are all of the step, as they are written.
    `hands_over`: the only result is a reply that a row has put into a variable, as it came or as it stood in what came.
    """

    sequence: CompiledSequence
    index: int
    conditions: tuple[Condition, ...]
    settings: tuple[tuple[str, Compute, frozenset[str]], ...]
    send: Compute
    fields: tuple[tuple[str, Compute, bool, frozenset[str]], ...]
    endings: Mapping[CompiledRow, Settings]
    rows: tuple[Row, ...]
    hands_over: bool
    within: Evaluate | None
    within_changes: bool

    @property
    def step(self) -> CompiledStep:
        return self.sequence.steps[self.index]


def plan_of(sequence: CompiledSequence, protocol: Protocol, table: FrameTable, scope: Scope) -> DirectPlan | None:
    """The short way of a sequence; None when it has none."""
    model = protocol.sequences[sequence.name]
    found = None if model.always else _asking_step(model)
    if found is None:
        return None
    index, step = found
    fields = _fields_of(step.send)
    if fields is None or step.send is None or not all(_is_shared(protocol, target) for target, _ in step.set):
        return None
    rows = sequence.steps[index].rows
    endings = {
        compiled: _settings_of(row, model, protocol, table)
        for row, compiled in zip(step.receive or (), rows, strict=True)
        if _ends_well(row, model, index)
    }
    if not endings or any(row.queue or row.room for row in rows):
        return None

    def compiled_value(value: Value) -> Compute:
        return compile_value(value, protocol, table.codec, table)

    return DirectPlan(
        sequence=sequence,
        index=index,
        conditions=tuple(_conditions(model.steps[:index], step, scope)),
        settings=tuple((target.name, compiled_value(value), _reads(value)) for target, value in step.set),
        send=compiled_value(step.send),
        fields=tuple(
            (name, compiled_value(value), changes(value, scope), _reads(value)) for name, value in fields.items()
        ),
        endings=endings,
        rows=tuple(step.receive or ()),
        hands_over=_hands_over(model, step),
        within=None if step.within is None else compile_expression(step.within),
        within_changes=changes(step.within, scope),
    )


def _asking_step(model: Sequence) -> tuple[int, Step] | None:
    """The first step that sends and waits, if every step before it can be left out."""
    for index, step in enumerate(model.steps):
        if step.send is not None and step.receive:
            other = (
                step.session, step.parts, step.wait, step.hold_break, step.flush, step.serve, step.call, step.ask,
                step.put, step.deliver,
            )  # fmt: skip
            return None if any(other) else (index, step)
        if step.when is None:
            return None
    return None


def _fields_of(send: Value | None) -> Mapping[str, Value] | None:
    """The fields that a step gives the frame it sends: none, if that is the request; None for anything else."""
    if isinstance(send, FrameOf):
        return send.fields
    return {} if isinstance(send, Expression) and bare_name(send) == "request" else None


def _conditions(skipped: tuple[Step, ...], step: Step, scope: Scope) -> list[Condition]:
    wanted = [(one.when, False) for one in skipped] + [(step.when, True)]
    return [
        Condition(compile_expression(when), truth, changes(when, scope)) for when, truth in wanted if when is not None
    ]


def _ends_well(row: Row, model: Sequence, index: int) -> bool:
    """Whether a row only keeps something of its frame and is the end of the sequence."""
    other = (
        row.at_most, row.otherwise, row.take, row.store, row.put, row.deliver, row.send, row.fail, row.because
    )  # fmt: skip
    own = {*model.takes, *model.local} - {"request"}
    keeps = all(target.key is None and target.field is None and target.name in own for target, _ in row.set)
    return keeps and not any(other) and _leads_to_end(row, model, index)


def _leads_to_end(row: Row, model: Sequence, index: int) -> bool:
    """Whether the sequence ends behind this row, here or because its step is the last."""
    then = row.then or "next"
    if then == "next":
        step = model.steps[index]
        then = "end" if step.then == "next" and index == len(model.steps) - 1 else step.then
    return then == "end"


def _settings_of(row: Row, model: Sequence, protocol: Protocol, table: FrameTable) -> Settings:
    types = {**dict.fromkeys(model.takes, ""), **model.local}
    return tuple(
        (target.name, fit_of(types[target.name]), compile_value(value, protocol, table.codec, table))
        for target, value in row.set
    )


def _hands_over(model: Sequence, step: Step) -> bool:
    """Whether the sequence works nothing out of what came: then nothing can go wrong with it."""
    reply = model.gives.get("reply")
    set_by_rows = [value for row in step.receive or () for _, value in row.set]
    plain = all(isinstance(value, Expression) and _is_path(value.root) for value in set_by_rows)
    return plain and len(model.gives) == 1 and reply is not None and bare_name(reply) in model.local


def _is_path(node: Node) -> bool:
    """Whether it is a name, or what stands under a name in a name's value."""
    return isinstance(node, Name) or (isinstance(node, Attribute) and _is_path(node.value))


def _reads(value: Value) -> frozenset[str]:
    return frozenset(name for part in expressions_of(value) for name in names_in(part.root))


def _is_shared(protocol: Protocol, target: Target) -> bool:
    return target.key is None and target.field is None and target.name in protocol.state


def changes(value: Any, scope: Scope) -> bool:
    """Whether what a value comes to may change from one exchange of the same request to the next."""
    return any(scope.changes(part, within_exchange=False) for part in expressions_of(value))
