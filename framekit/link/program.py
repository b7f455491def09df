"""Sequences prepared for running: every expression a function, every step a list of things to do.

Made once when an engine starts; running one is `machine`'s business.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from framekit.definition.model import protocol as model
from framekit.definition.model.procedure import Action, Row, Sequence, Step
from framekit.definition.model.values import Value
from framekit.link.construct_values import Compute, compile_value
from framekit.link.effects import Effect, EffectCompiler
from framekit.link.evaluate import Evaluate, compile_expression
from framekit.link.frame_table import FrameTable
from framekit.link.late import is_numbered
from framekit.link.phases import Phase, phases_of
from framekit.link.variables import empty_of

if TYPE_CHECKING:
    from framekit.definition.expression.syntax import Expression


class CompiledAction:
    """An action; `effects` are done in their order before `then` or `fail`.

    `asks_again`: it sends something and waits on.
    """

    __slots__ = ("asks_again", "at_most", "because", "effects", "fail", "otherwise", "then", "when")

    def __init__(self, action: Action, compiler: ProgramCompiler) -> None:
        self.when = compiler.maybe(action.when)
        self.at_most = compiler.maybe(action.at_most)
        self.otherwise = None if action.otherwise is None else CompiledAction(action.otherwise, compiler)
        self.effects: tuple[Effect, ...] = compiler.effects.of_action(action)
        self.then = action.then
        self.fail = action.fail
        self.asks_again = action.send is not None and action.fail is None and action.then in (None, "again", "restart")
        self.because = compiler.maybe(action.because)


class CompiledRow(CompiledAction):
    """A row of a receive matrix."""

    __slots__ = ("expected", "frames", "queue", "room")

    def __init__(self, row: Row, compiler: ProgramCompiler) -> None:
        super().__init__(row, compiler)
        self.frames = row.frames
        self.expected = row.expected
        self.queue = row.queue
        self.room = row.room


Handlers = Mapping[str, tuple[CompiledAction, ...]]


class CompiledStep:
    """A step. `phases` are what it does before it waits; `piece_start` is where each piece of `parts` begins anew.

    `numbered`: a late reply to it is never taken for another one.
    """

    __slots__ = (
        "_matching", "branch", "complete", "gap", "handlers", "interests", "into", "name", "numbered", "phases",
        "piece_start", "queue_rows", "retries", "rows", "then", "within",
    )  # fmt: skip

    def __init__(self, step: Step, compiler: ProgramCompiler) -> None:
        self.name = step.name
        self.rows = tuple(CompiledRow(row, compiler) for row in step.receive or ())
        self.branch = tuple(CompiledAction(action, compiler) for action in step.branch or ())
        self.handlers = compiler.handlers(step.handlers)
        self.within = compiler.maybe(step.within)
        self.complete = compiler.maybe(step.complete)
        self.gap = compiler.maybe(step.gap)
        self.retries = compiler.maybe(step.retries)
        self.then = step.then
        self.numbered = is_numbered(step, compiler.protocol)
        self.into: tuple[tuple[str, str], ...] = tuple((step.call.into if step.call else step.ask_into).items())
        self.queue_rows = tuple(row for row in self.rows if row.queue or row.room)
        self.phases: tuple[Phase, ...] = ()
        self.phases, self.piece_start = phases_of(step, self, compiler)
        self._matching: dict[tuple[str, tuple[str, ...]], tuple[CompiledRow, ...]] = {}
        self.interests: dict[tuple[str, ...], tuple[str, ...]] = {}

    def names(self, expected: tuple[str, ...]) -> tuple[str, ...]:
        """The frames that rows wait for, in their order; `expected` are the replies of the exchange."""
        found = self.interests.get(expected)
        if found is None:
            found = self.interests[expected] = names_of(self.rows, expected)
        return found

    def matching(self, frame: str, expected: tuple[str, ...]) -> tuple[CompiledRow, ...]:
        """The rows that name a frame."""
        key = (frame, expected)
        found = self._matching.get(key)
        if found is None:
            found = self._matching[key] = rows_naming(self.rows, frame, expected)
        return found


class CompiledSequence:
    """A sequence. `locals` make fresh variables for every run."""

    __slots__ = ("always", "gives", "handlers", "index", "locals", "name", "steps", "takes")

    def __init__(self, sequence: Sequence, compiler: ProgramCompiler) -> None:
        self.name = sequence.name
        self.takes = sequence.takes
        self.locals = tuple(sequence.local.items())
        self.always = tuple(CompiledRow(row, compiler) for row in sequence.always)
        self.handlers = compiler.handlers(sequence.handlers)
        self.index = {step.name: index for index, step in enumerate(sequence.steps)}
        self.steps = tuple(CompiledStep(step, compiler) for step in sequence.steps)
        self.gives = tuple((name, compile_expression(item)) for name, item in sequence.gives.items())

    def variables(self) -> dict[str, Any]:
        """The variables of a new run, with nothing in them."""
        return {name: empty_of(type_) for name, type_ in self.locals}


class ProgramCompiler:
    """Compiles one sequence."""

    def __init__(self, sequence: Sequence, protocol: model.Protocol, table: FrameTable) -> None:
        self.sequence = sequence
        self.protocol = protocol
        self.table = table
        self.effects = EffectCompiler(sequence, protocol, self.value)

    def maybe(self, expression: Expression | None) -> Evaluate | None:
        return None if expression is None else compile_expression(expression)

    def value(self, value: Value) -> Compute:
        return compile_value(value, self.protocol, self.table.codec, self.table)

    def fields(self, fields: Mapping[str, Value]) -> Callable[..., dict[str, Any]]:
        compiled = tuple((name, self.value(item)) for name, item in fields.items())
        return lambda names: {name: compute(names) for name, compute in compiled}

    def handlers(self, handlers: Mapping[str, tuple[Action, ...]]) -> dict[str, tuple[CompiledAction, ...]]:
        return {event: tuple(CompiledAction(action, self) for action in actions) for event, actions in handlers.items()}


def compile_sequences(protocol: model.Protocol, table: FrameTable) -> dict[str, CompiledSequence]:
    """Every sequence of a protocol, ready to run."""
    return {
        name: CompiledSequence(sequence, ProgramCompiler(sequence, protocol, table))
        for name, sequence in protocol.sequences.items()
    }


def names_of(rows: tuple[CompiledRow, ...], expected: tuple[str, ...]) -> tuple[str, ...]:
    """The frames these rows wait for, each once, in the order of the rows."""
    found: dict[str, None] = {}
    for row in rows:
        found.update(dict.fromkeys(row.frames))
        if row.expected:
            found.update(dict.fromkeys(expected))
    return tuple(found)


def rows_naming(rows: tuple[CompiledRow, ...], frame: str, expected: tuple[str, ...]) -> tuple[CompiledRow, ...]:
    """The rows that wait for a frame, in their order."""
    return tuple(row for row in rows if frame in row.frames or (row.expected and frame in expected))
