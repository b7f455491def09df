"""The sequences of a protocol as one Python module: a function a step, a class of call frames a sequence.

Everything that can be known when the protocol is loaded is resolved here: variables are slots, rows comparisons in
their order, frames built by their builders. Parameters and state are looked up every time.
"""

from __future__ import annotations

import builtins
from collections.abc import Mapping
from types import CodeType
from typing import Any

from framekit.codec.evaluate import HOMES
from framekit.codec.python.source import literal, quoted
from framekit.definition.expression import Expression
from framekit.definition.model.frames import parts_of
from framekit.definition.model.procedure import HANDLERS, Action, LineChange, Row, Sequence, Target
from framekit.definition.model.protocol import Protocol
from framekit.definition.sources import current_cache
from framekit.link.frame_table import FrameTable, ProtocolCodec, made_once, table_of
from framekit.link.late import Replies, is_numbered, replies_of
from framekit.link.sequences import runtime
from framekit.link.sequences.state import NOT_TAKEN, CallFrame, CompiledSequence, CompiledStep, Rows, State, begin_clock
from framekit.link.sequences.writing import (
    ADDED_FUNCTIONS,
    OF_EXCHANGE,
    STEP_KEYS,
    Frames,
    SequenceModule,
    StepWriter,
    empty_value,
    is_plain_row,
    own_variables,
)
from framekit.link.values import EACH, EVALUATION_ERRORS, HOLDERS, FrameValue, Names, attribute, plain, read_as
from framekit.link.variables import fit_of

_OF_EXCHANGE = sorted(OF_EXCHANGE)

DEFAULTS = {"on_timeout": '"timeout"', "on_exhausted": '"exhausted"', "on_fail": "a.outcome"}
"""Source of the failure that a handler's action stands for when it says nothing else."""


class Program:
    """The frames and sequences of a protocol, ready for engines; those of one codec share it."""

    def __init__(self, protocol: Protocol, codec: ProtocolCodec) -> None:
        self.protocol = protocol
        self.table = table = table_of(protocol, codec)
        cache = current_cache()

        def make() -> CodeType:
            return compile(sequence_source(protocol, table), f"<sequences of {protocol.name}>", "exec")

        code = make() if cache is None else cache.code(protocol, "sequences", make)
        self.sequences, self.need_names, self.shown_later = load_sequences(code, protocol, table)
        self._replies: dict[str | None, Replies] = {}

    def replies_of(self, role: str | None) -> Replies:
        """What exchanges of a role wait for."""
        found = self._replies.get(role)
        if found is None:
            found = self._replies[role] = replies_of(self.protocol, None if role is None else self.protocol.roles[role])
        return found


def program_of(protocol: Protocol, codec: ProtocolCodec) -> Program:
    """The program of a protocol, made once for a codec."""
    return made_once(protocol, codec, Program, lambda: Program(protocol, codec))


def sequence_source(protocol: Protocol, table: FrameTable) -> str:
    """Source of the module of a protocol's sequences."""
    module = SequenceModule()
    frames = Frames(protocol, table)
    held = _of_exchanges(protocol)
    for number, sequence in enumerate(protocol.sequences.values()):
        _SequenceWriter(module, frames, sequence, number, sequence.name in held).write()
    own = {name for sequence in protocol.sequences.values() for name in own_variables(sequence, protocol)}
    needing = tuple(name for name in protocol.frames if frames.reads(name) & (OF_EXCHANGE | own))
    module.functions.add()
    module.functions.add()
    module.functions.add(f"NEED_NAMES.update({literal(needing)})")
    targets = parts_of((tuple(protocol.sequences.values()), tuple(protocol.services.values())), Target)
    changes = any(target.field is not None for target in targets)
    if not changes:
        module.functions.add(f"SHOWN_LATER.update({literal(_shown_later(protocol, frames, own))})")
    return module.text(f"The sequences of {protocol.name}.")


def _shown_later(protocol: Protocol, frames: Frames, own: set[str]) -> dict[str, tuple[str, ...]]:
    """The frames that can be read back on a few names kept when they are sent, with these: parameters and constants."""
    fixed = {*protocol.params, *protocol.tables, "own", "role", "line"}
    changing = {*OF_EXCHANGE, *own, *protocol.state, "now", "clock", "functions"}
    if next(parts_of(tuple(protocol.sequences.values()), LineChange), None) is not None:
        changing.add("line")
    read = {name: frames.reads(name) for name in protocol.frames}
    return {name: tuple(sorted(found & fixed)) for name, found in read.items() if not found & changing}


def load_sequences(
    code: CodeType, protocol: Protocol, table: FrameTable
) -> tuple[dict[str, CompiledSequence], set[str], dict[str, tuple[str, ...]]]:
    """The sequences that compiled code makes; frames built on names of an exchange; those that may be shown later."""
    found: dict[str, CompiledSequence] = {}
    need_names: set[str] = set()
    later: dict[str, tuple[str, ...]] = {}
    state = protocol.state.values()
    names: dict[str, Any] = {
        **_GLOBALS,
        **ADDED_FUNCTIONS,
        "__builtins__": _BUILTINS,
        "SEQUENCES": found,
        "NEED_NAMES": need_names,
        "SHOWN_LATER": later,
        "TABLE": table,
        "INFOS": table.infos,
        "LAYOUTS": table.codec.layouts,
        "FIT": fit_of,
        "FITS": {one.name: fit_of(one.type, one.values, one.size) for one in state},
    }
    exec(code, names)
    return found, need_names, later


def _of_exchanges(protocol: Protocol) -> set[str]:
    """The sequences that exchanges, or what opens and closes their sessions, may run."""
    waiting = list(protocol.exchanged)
    for session in protocol.sessions.values():
        waiting += [*session.open, *session.close, *([session.keep_alive_run] if session.keep_alive_run else ())]
    waiting += [name for name in protocol.sequences if not protocol.roles]
    return {sequence.name for sequence in protocol.called_from(waiting)}


class _SequenceWriter:
    """Writes one sequence. `held`: it may be one that replies to earlier requests hold back."""

    def __init__(self, module: SequenceModule, frames: Frames, sequence: Sequence, number: int, held: bool) -> None:
        self.module = module
        self.sequence = sequence
        self.number = number
        self.protocol = frames.protocol
        self.own = own_variables(sequence, frames.protocol)
        self.steps = [StepWriter(module, frames, sequence, number, index, held) for index in range(len(sequence.steps))]

    def write(self) -> None:
        out = self.module.functions
        self._frame()
        for step in self.steps:
            out.add()
            out.add()
            out.comment(f"{self.sequence.name}, step {step.step.name}")
            self._functions(step)
            self._tables(step)
        self._gives()
        out.add()
        out.add()
        name = quoted(self.sequence.name)
        takes, always = literal(tuple(self.sequence.takes)), bool(self.sequence.always)
        out.add(
            f"SEQUENCES[{name}] = CompiledSequence({name}, {self._class}, {self.steps[0].called()}, {takes}, {always})"
        )

    @property
    def _class(self) -> str:
        return f"Frame_{self.number}"

    def _frame(self) -> None:
        """The class of its call frames."""
        out, sequence, first = self.module.functions, self.sequence, self.steps[0]
        slots = [f"v_{name}" for name in self.own] + [counter for step in self.steps for counter in step.counters]
        out.add()
        out.add()
        with out.block(f"class {self._class}(CallFrame):"):
            out.add(f"__slots__ = {literal(tuple(slots))}")
            out.add()
            with out.block("def __init__(a, run, d, caller, nested, given):"):
                out.add("a.run, a.d, a.caller, a.nested = run, d, caller, nested")
                out.add("a.m = m = run.machine")
                out.add("a.s, a.n = m.scope, d.names")
                out.add("a.it = a.sent = a.parts = None")
                out.add("a.resends = 0")
                for name in self.own:
                    if name in sequence.takes or name not in sequence.local:
                        text = quoted(name)
                        other = f"d.{name}" if name in OF_EXCHANGE else f"d.get({text})"
                        out.add(f"{first.slot(name)} = given[{text}] if {text} in given else {other}")
                    else:
                        out.add(f"{first.slot(name)} = {empty_value(sequence.local[name])}")
                for counter in slots[len(self.own) :]:
                    out.add(f"a.{counter} = 0")
            out.add()
            with out.block("def names(a):"):
                shared = [name for name in _OF_EXCHANGE if name not in self.own]
                fields = [f"{quoted(name)}: d.{name}" for name in shared]
                fields += [f"{quoted(name)}: {first.slot(name)}" for name in self.own]
                out.add("d = a.d")
                out.add(f"return Names({{**d.arguments, {', '.join(fields)}}}, d.names)")

    def _functions(self, step: StepWriter) -> None:
        with step.function():
            step.add(f"a.step = {step.called('step')}")
            if step.repeats:
                step.add("a.resends = 0")
                step.add("a.sent = None")
            if step.step.parts is not None:
                step.add("a.parts = None")
            for key in STEP_KEYS:
                if key.write_into(step):
                    return
            step.leave()

    def _gives(self) -> None:
        last = self.steps[-1]
        given = []
        for place, (name, expression) in enumerate(self.sequence.gives.items()):
            with last.function(f"gives_{place}"):
                last.add(f"return {last.expression(expression)}")
            given.append(f"({quoted(name)}, {last.called(f'gives_{place}')})")
        if given:
            out = self.module.functions
            with last.function("results"):
                fields = [f"{quoted(name)}: {last.expression(one)}" for name, one in self.sequence.gives.items()]
                last.add(f"return {{{', '.join(fields)}}}")
            out.add()
            out.add()
            out.add(f"{self._class}.results = {last.called('results')}")
            out.add(f"{self._class}.gives = ({', '.join(given)},)")

    # ---- what a waiting step reacts to --------------------------------------------------------------------

    def _tables(self, step: StepWriter) -> None:
        """The step with the functions of its rows, limits and handlers."""
        model, sequence = step.step, self.sequence
        arguments = [quoted(model.name), str(step.index)]
        arguments.append(self._rows(step, [row for row in model.receive or () if is_plain_row(row)], "row", ""))
        if sequence.always:
            arguments.append(f"always={self._rows(step, list(sequence.always), 'always', 'always')}")
        queues = [
            self._queue_row(step, row, place) for place, row in enumerate(model.receive or ()) if not is_plain_row(row)
        ]
        if queues:
            arguments.append(f"queue_rows=({', '.join(queues)},)")
        handlers = {event: model.handlers.get(event) or sequence.handlers.get(event) or () for event in HANDLERS}
        written = [
            f"{quoted(event)}: {self._handler(step, event, actions)}" for event, actions in handlers.items() if actions
        ]
        if written:
            arguments.append(f"handlers={{{', '.join(written)}}}")
        for key in ("within", "complete", "gap", "retries"):
            limit: Expression | None = getattr(model, key)
            if limit is not None:
                with step.function(key):
                    step.add(f"return {step.expression(limit)}")
                arguments.append(f"{key}={step.called(key)}")
        if step.goes_on:
            arguments.append(f"back={step.called('back')}")
        if is_numbered(model, self.protocol):
            arguments.append("numbered=True")
        out = self.module.functions
        out.add()
        out.add()
        out.add(f"{step.called('step')} = CompiledStep({', '.join(arguments)})")

    def _rows(self, step: StepWriter, rows: list[Row], what: str, event: str) -> str:
        """Source of a table of rows."""
        named: dict[str, str] = {}
        expected: dict[str, str] = {}
        made: dict[tuple[tuple[int, ...], tuple[str, ...]], str] = {}

        def function(some: list[Row], frames: tuple[str, ...]) -> str:
            key = tuple(id(row) for row in some), frames
            if key not in made:
                made[key] = step.called(f"{what}_{len(made)}")
                with step.function(f"{what}_{len(made) - 1}", "a, it"):
                    self._try_rows(step, some, frames, event)
            return made[key]

        for places, frames in _alike(rows).items():
            name = function([rows[place] for place in places], frames)
            more = [row for place, row in enumerate(rows) if place in places or row.expected]
            other = name if len(more) == len(places) else function(more, frames)
            for frame in frames:
                named[frame], expected[frame] = name, other
        rest = [row for row in rows if row.expected]
        others = function(rest, ()) if rest else "None"
        order = tuple(one for row in rows for one in (*row.frames, *((Rows.EXPECTED,) if row.expected else ())))
        return f"Rows({_mapping(named)}, {_mapping(expected)}, {others}, {literal(order)})"

    def _try_rows(self, step: StepWriter, rows: list[Row], frames: tuple[str, ...], event: str) -> None:
        for row in rows:
            if row.when is None:
                self._taken(step, row, frames, event)
                return
            self._condition(step, row.when, frames)
            with step.out.block("if fits:"):
                self._taken(step, row, frames, event)
        step.add("return NOT_TAKEN")

    def _condition(self, step: StepWriter, when: Expression, frames: tuple[str, ...]) -> None:
        with step.out.block("try:"):
            step.add(f"fits = {step.expression(when, frames)}")
        with step.out.block("except EVALUATION_ERRORS as error:"):
            step.add("fits = unclear(a, error)")

    def _taken(self, step: StepWriter, row: Row, frames: tuple[str, ...], event: str) -> None:
        d = step.local("d")
        step.add("a.it = it")
        step.add(f'{d}.raw = it.raw or b""')
        with step.out.block(f"if not {d}.checks_echo:"):
            step.add(f"{d}.last_taken = it")
        step.add("run = a.run")
        with step.out.block("if run.asked is not None:"):
            step.add("replied(run)")
        step.add('run.cause = ""')
        step.act(row, "next", frames, event=event)

    def _queue_row(self, step: StepWriter, row: Row, place: int) -> str:
        """Source of a row that waits for an item or for room."""
        with step.function(f"queue_{place}", "a, it"):
            if row.when is not None:
                self._condition(step, row.when, ())
                with step.out.block("if not fits:"):
                    step.add("return NOT_TAKEN")
            with step.out.block("if a.run.asked is not None:"):
                step.add("replied(a.run)")
            if row.queue is not None:
                step.add("a.it = it")
                step.add(f"{step.local('m')}.queues.take({quoted(row.queue)})")
            step.act(row, "next", ())
        return f"({literal(row.queue)}, {literal(row.room)}, {step.called(f'queue_{place}')})"

    def _handler(self, step: StepWriter, event: str, actions: tuple[Action, ...]) -> str:
        """The name of the function of a handler."""
        with step.function(event):
            usual, outcome = "next" if event == "on_byte" else "again", DEFAULTS.get(event, "")
            for action in actions:
                if action.when is None:
                    step.act(action, usual, None, outcome, event)
                    break
                with step.out.block(f"if {step.expression(action.when)}:"):
                    step.act(action, usual, None, outcome, event)
            else:
                step.add("return NOT_TAKEN")
        return step.called(event)


def _alike(rows: list[Row]) -> dict[tuple[int, ...], tuple[str, ...]]:
    """The frames that rows name, by the rows that name them."""
    found: dict[tuple[int, ...], tuple[str, ...]] = {}
    for frame in dict.fromkeys(name for row in rows for name in row.frames):
        places = tuple(place for place, row in enumerate(rows) if frame in row.frames)
        found[places] = (*found.get(places, ()), frame)
    return found


def _mapping(functions: Mapping[str, str]) -> str:
    return "{" + ", ".join(f"{quoted(name)}: {function}" for name, function in functions.items()) + "}"


# ---- what generated functions use -------------------------------------------------------------------------------


def plain_fields(fields: Mapping[str, Any]) -> dict[str, Any]:
    """The fields of a frame as its builder takes them; frames inside are `{frame: fields}`."""
    return {name: plain(value) if type(value) in HOLDERS else value for name, value in fields.items()}


def number_of(numbers: Mapping[str, int], value: Any) -> Any:
    """The number behind a name of a field's values."""
    return numbers.get(value, value) if type(value) is str else value


_USED = (
    "abandon_above", "ask", "begin_part", "call", "change_line", "count", "cut_parts", "decoded", "end", "exhausted",
    "fail", "handled", "has_more", "hold_break", "is_held", "missed", "own_line", "pause", "put", "replied", "resend",
    "send_made", "send_value", "serve", "set_field", "still_due", "unclear", "wait",
)  # fmt: skip
_GLOBALS: dict[str, Any] = {
    **{name: getattr(runtime, name) for name in _USED},
    "CallFrame": CallFrame,
    "CompiledSequence": CompiledSequence,
    "CompiledStep": CompiledStep,
    "EACH": EACH,
    "EVALUATION_ERRORS": EVALUATION_ERRORS,
    "FrameValue": FrameValue,
    "NOT_TAKEN": NOT_TAKEN,
    "Names": Names,
    "Rows": Rows,
    "State": State,
    "attribute": attribute,
    "begin_clock": begin_clock,
    "number_of": number_of,
    "plain": plain,
    "plain_fields": plain_fields,
    "read_as": read_as,
    **HOMES,
    "__name__": "framekit_sequences",
}
_BUILTINS = {name: getattr(builtins, name) for name in ("__build_class__", "abs", "len", "max", "min", "str", "sum")}
