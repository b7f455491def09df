"""Write the steps of a sequence into the generator of the sequence: names, values, sends, actions, waits.

Text of a definition reaches the source only by `quoted`, `literal` and the expression emitter. The table STEP_KEYS has
the keys of a step; `compiler` makes the module of all generators. The position in a generator is a number, `pc`: a
block runs `if pc <= N`, so later blocks are reached by falling through, and earlier blocks by `continue`.
"""

from __future__ import annotations

import builtins
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, NamedTuple

from framekit.codec.evaluate import home_of
from framekit.codec.python.source import Source, literal, quoted
from framekit.definition.brought import bring, bring_word
from framekit.definition.expression import (
    ATOM,
    BIT_OR,
    ENGINE_FUNCTIONS,
    Attribute,
    Binary,
    Expression,
    LineTime,
    Name,
    Node,
    Number,
    emit,
    names_in,
)
from framekit.definition.keys import Form, key_of
from framekit.definition.model.frames import expressions_of, parts_of
from framekit.definition.model.procedure import (
    ADDED_KEYS,
    Action,
    CallOf,
    Decode,
    LineChange,
    Parts,
    Row,
    Sequence,
    Serve,
    Step,
    Target,
)
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.segments import Bits, Data, Field, Inner, Repeat, Segment
from framekit.definition.model.values import FrameOf, Value
from framekit.definition.schema import add_keys
from framekit.link import late
from framekit.link.awaited_replies import is_numbered
from framekit.link.frame_table import FrameTable
from framekit.link.sequences import runtime
from framekit.link.sequences.state import PARKED_EVENTS
from framekit.link.value_source import SourceModule, ValueNames, ValueWriter
from framekit.link.variables import empty_of

OF_EXCHANGE = frozenset({"request", "buffer", "expected", "station", "reply", "reply_buffer", "refusal"})
"""Names that belong to an exchange, or to a served request."""

OF_CALL = frozenset({"part", "cause", "frame", "outcome"})
"""Names that a call frame has while a step does its pieces, or handles an event."""

ENTRY, PART, WAIT, BLOCKS = 0, 1, 2, 3
"""Where a step may be gone on with: at its beginning, with its next piece, with waiting; so many places has a step."""

GOING, WAITING, PARKED, CALLING = "going", "waiting", "parked", "calling"
"""The state of the generator at a place of its source: it runs, or it waits for rows, for a time, or for a call."""


class Frames:
    """Facts about a protocol's frames that are known before a frame is sent or received."""

    def __init__(self, protocol: Protocol, table: FrameTable) -> None:
        self.protocol = protocol
        self.table, self.infos = table, table.infos
        self.plain: dict[str, set[str]] = {}
        self.inner: dict[str, set[str]] = {}
        for name, frame in protocol.frames.items():
            self.plain[name] = set(_always_there(frame.segments))
            self.inner[name] = {one.name for one in frame.segments if isinstance(one, Inner) and one.when is None}
        self.frame_is_field = any("frame" in names for names in self.plain.values())
        self.delivers = protocol.delivers

    def reads(self, frame: str) -> set[str]:
        """Return the names that building a frame may read, those of frames inside it included."""
        found: set[str] = set()
        for name in self._parts(frame, set()):
            mine: set[str] = set()
            model = self.protocol.frames[name]
            for expression in (*expressions_of(model.segments), *model.echo.values()):
                mine |= names_in(expression.root)
            found |= mine - self.plain[name]
        return found

    def echoes(self, frame: str) -> bool:
        """Return whether building a frame, or one inside it, repeats something of a request."""
        return any(self.infos[name].echo for name in self._parts(frame, set()))

    def _parts(self, frame: str, known: set[str]) -> set[str]:
        if frame not in known:
            known.add(frame)
            for part in parts_of(self.protocol.frames[frame].segments, Segment):
                for name in part.frames_inside:
                    self._parts(name, known)
        return known


def _always_there(segments: tuple[Segment, ...]) -> Iterator[str]:
    """Yield the fields that every received frame of these segments has."""
    for segment in segments:
        if segment.when is not None:
            continue
        if isinstance(segment, Bits):
            yield from (part.name for part in segment.parts)
        elif segment.inner_record is not None or isinstance(segment, (Field, Data, Inner, Repeat)):
            yield from segment.value_names


class SequenceNames:
    """How names are written in a generator. `frames`: those that a frame which has come may be, in a row for it."""

    def __init__(self, writer: StepWriter, in_row: bool, frames: tuple[str, ...] = ()) -> None:
        self.writer = writer
        self.in_row = in_row
        self.frames = frames

    def name(self, node: Name) -> str:
        name, writer = node.name, self.writer
        if name in writer.own:
            return writer.slot(name)
        if name == "it":
            return "got" if self.in_row else "it"
        if name in OF_CALL:
            return name
        if name in OF_EXCHANGE:
            return f"x.{name}"
        if name in writer.protocol.state:
            return f"{writer.holder(name)}[{quoted(name)}]"
        if name == "now":
            return "s.now"
        if name in writer.protocol.params:
            return f"n[{quoted(name)}]"
        return f"s[{quoted(name)}]"

    def attribute(self, node: Attribute) -> str:
        inner, frames = self._typed(node.value)
        known = self.writer.frames
        if frames is not None:
            if node.name == "frame" and not known.frame_is_field:
                return f"{inner}.frame"
            if (
                frames
                and node.name not in ("frame", "refusal")
                and all(node.name in known.plain[one] for one in frames)
            ):
                return f"{inner}.fields[{quoted(node.name)}]"
        return f"attribute({inner}, {quoted(node.name)})"

    def _typed(self, node: Node) -> tuple[str, tuple[str, ...] | None]:
        """Return source, and the received frames that the value may be: () for any frame, None for any value."""
        known = self.writer.frames
        if isinstance(node, Name) and not known.delivers:
            if node.name == "it" and self.frames and "it" not in self.writer.own:
                return "got", self.frames
            if node.name in self.writer.received:
                return self.writer.slot(node.name), self.writer.received[node.name]
        if isinstance(node, Attribute):
            source, frames = self._typed(node.value)
            if frames and all(node.name in known.inner[one] for one in frames):
                return f"{source}.fields[{quoted(node.name)}]", ()
        return emit(node, self, ATOM), None

    def line_time(self, node: LineTime) -> str:
        return f's["line"].{node.unit}({node.count[0]}, {node.count[1]})'

    def call(self, function: str, arguments: list[str]) -> str:
        if function in ENGINE_FUNCTIONS:
            return f's["functions"].{function}({", ".join(arguments)})'
        return f"{home_of(function)}.{function}({', '.join(arguments)})"


class StepWriter:
    """Writes a step into the generator of its sequence. `own`: the sequence's variables and types ("" for any).

    `received`: variables that hold received frames only, with the frames they may hold. `held`: its sequence runs for
    exchanges, so replies that are due may hold its request back. `listens`: a lane may listen with it. `doing`: the
    state of the generator at this place.
    """

    def __init__(
        self, module: SourceModule, frames: Frames, sequence: Sequence, number: int, index: int, held: bool,
        out: Source, listens: bool = False,
    ) -> None:  # fmt: skip
        self.module = module
        self.values = ValueWriter(frames.table, module)
        self.listens = listens
        self.frames = frames
        self.protocol = frames.protocol
        self.sequence = sequence
        self.step: Step = sequence.steps[index]
        self.number, self.index = number, index
        self.held = held
        self.own = own_variables(sequence, self.protocol)
        self.received = received_variables(sequence)
        self.out = out
        self.doing = GOING
        self._number = 0
        """The number of the block that is being written."""
        self._goes_back = False
        """Whether a wait has a jump to its own block or an earlier block."""
        self._steps = {step.name: place for place, step in enumerate(sequence.steps)}
        actions = actions_of(sequence, self.step)
        self._counted = {id(action): f"c{index}_{place}" for place, action in enumerate(actions) if action.at_most}
        self.repeats = "on_exhausted" in {*self.step.handlers, *sequence.handlers} or any(
            action.then == "resend" for action in actions
        )
        self._deep = 0
        self.uses_it = "it" in self.own or self.uses_item(sequence)

    @staticmethod
    def uses_item(sequence: Sequence) -> bool:
        """Return whether a received frame is used outside of the row that takes it."""
        actions = [action for step in sequence.steps for action in step.branch or ()]
        actions += [action for step in sequence.steps for one in step.handlers.values() for action in one]
        actions += [action for one in sequence.handlers.values() for action in one]
        others = [replace(step, receive=None) for step in sequence.steps]
        expressions = expressions_of([actions, others, tuple(sequence.gives.values())])
        rows = [row for step in sequence.steps for row in step.receive or ()]
        inside = expressions_of([row.otherwise for row in rows])
        return any("it" in names_in(one.root) for one in (*expressions, *inside))

    # ---- the generator ------------------------------------------------------------------------------------

    def write(self) -> None:
        """Write the whole step."""
        with self.at(ENTRY):
            if self.repeats:
                self.add("resends, sent = 0, None")
            for key in STEP_KEYS:
                if key.write_into(self):
                    return
            self.leave(is_last=True)

    @contextmanager
    def at(self, place: int) -> Iterator[None]:
        """Write a block of source that is entered at this place of the step."""
        self._number = number = self.index * BLOCKS + place
        self.out.add(f"if pc <= {number}:")
        self.out.depth += 1
        self.add(f"pc = {number}")
        yield
        self.out.depth -= 1

    def place(self, place: int) -> None:
        """Begin a block within the step."""
        self._number = number = self.index * BLOCKS + place
        self.out.depth -= 1
        self.out.add(f"if pc <= {number}:")
        self.out.depth += 1
        self.add(f"pc = {number}")

    def called(self, what: str) -> str:
        """Return the name of a constant of this step."""
        return f"q{self.number}_{self.index}_{what}"

    def local(self, name: str) -> str:
        """Return a local of the generator: `m` the machine, `s` its names, `x` the exchange, `n` the parameters."""
        return "x" if name == "d" else name

    def add(self, text: str) -> None:
        self.out.add(text)

    def jump(self, place: int) -> None:
        """Write a jump to a block."""
        self._goes_back = self._goes_back or place <= self._number
        self.add(f"pc = {place}")
        self.add("continue" if self.doing == GOING else "break")

    def jump_to_end(self) -> None:
        """Write the exit with a failure; `outcome` names it."""
        self.jump(len(self.sequence.steps) * BLOCKS)

    # ---- names and values ---------------------------------------------------------------------------------

    def slot(self, name: str) -> str:
        """Return a variable of the sequence."""
        assert re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", name), name
        return f"v_{name}"

    def holder(self, variable: str) -> str:
        """Return where a state variable is kept."""
        return "device" if self.protocol.state[variable].scope == "device" else "s"

    def value_names(self, row: tuple[str, ...] | None) -> ValueNames:
        """Return the names for values; `row`: they stand in a row for these frames."""
        return ValueNames(SequenceNames(self, row is not None, row or ()), self.names)

    def expression(self, expression: Expression, row: tuple[str, ...] | None = None) -> str:
        """Return the source of an expression; `row`: it is part of a row for these frames."""
        return emit(expression.root, SequenceNames(self, row is not None, row or ()))

    @property
    def names(self) -> str:
        """Return the source of names for the variables and the names of the exchange."""
        return f"named(x, {{{', '.join(f'{quoted(name)}: {self.slot(name)}' for name in self.own)}}}, n)"

    def value(self, value: Value, row: tuple[str, ...] | None = None) -> str:
        return self.values.value(value, self.value_names(row))

    def record(self, fields: Mapping[str, Value], row: tuple[str, ...] | None = None) -> str:
        return self.values.record(fields, self.value_names(row))

    # ---- set ----------------------------------------------------------------------------------------------

    def set(self, target: Target, value: Value, row: tuple[str, ...] | None = None) -> None:
        source = self.value(value, row)
        name = target.name
        if target.field is not None:
            holder = SequenceNames(self, row is not None).name(Name(self.step.at, name))
            self.add(f"set_field(m, {holder}, {quoted(target.field)}, {source})")
        elif target.key is not None:
            key = self.expression(target.key, row)
            if name not in self.own:
                self.add(f"s.set_entry({quoted(name)}, {key}, {source})")
                return
            self.add(f"found = {self.slot(name)}.copy()")
            self.add(f"found[{key}] = {source}")
            self.add(f"{self.slot(name)} = found")
        else:
            is_number = isinstance(value, Expression) and isinstance(value.root, (Binary, Number))
            self.assign(name, source, is_number=is_number)

    def assign(self, name: str, source: str, fits: bool = False, is_number: bool = False) -> None:
        """Set a variable. `fits`: the value has the variable's type; `is_number`: it is a number."""
        if name in self.own:
            type_ = self.own[name]
            if not fits and type_ not in ("", "frame", "record"):
                source = f"{self.module.constant('fit', f'FIT({quoted(type_)})')}({source})"
            if name == "request":
                source = f"x.answers({source})"
            self.add(f"{self.slot(name)} = {source}")
        elif (variable := self.protocol.state.get(name)) is not None and variable.most is None:
            mask = re.fullmatch(r"u([0-9]+)", variable.type) if is_number and not variable.values else None
            if mask is not None and variable.size is None:
                source = f"({source}) & {hex((1 << int(mask[1])) - 1)}"
            else:
                source = f"{self.module.constant('fit', f'FITS[{quoted(name)}]')}({source})"
            holder = self.holder(name)
            self.add(f"{holder}[{quoted(name)}] = {source}")
            self.add(f"{holder}.{'changes' if holder == 'device' else 'writes'} += 1")
        else:
            self.add(f"s.set({quoted(name)}, {source})")

    # ---- send ---------------------------------------------------------------------------------------------

    def send(self, value: Value, row: tuple[str, ...] | None = None, repeats: bool = False) -> None:
        """Send a frame; `repeats`: it is what `resend` sends again."""
        kept = "sent = " if repeats and self.repeats else ""
        if not isinstance(value, FrameOf):
            self.add(f"value = {self.value(value, row)}")
            with self.out.block("if value is not None:"):
                self.add(f"{kept}send_value(m, run, x, value, {self.names} if needs_names(m, value) else n)")
            if kept:
                with self.out.block("else:"):
                    self.add("sent = None")
        elif not self.values.is_plain(value.frame):
            self.add(f"{kept}send_made(m, run, x, {self.value(value, row)}, {self.names})")
        else:
            self._send_made(value, row, repeats)

    def _send_made(self, value: FrameOf, row: tuple[str, ...] | None, repeats: bool) -> None:
        frame, constant = value.frame, self.module.constant
        names = self.value_names(row)
        kept = "sent = " if repeats and self.repeats else ""
        self.add(f"value = {self.values.frame(value, names, sent=True)}")
        info = self.frames.infos[frame]
        if self.frames.echoes(frame):
            fill = constant("fill_echo", "TABLE.fill_echo")
            with self.out.block("if not x.checks_echo:"):
                if info.inner is None or not info.echo_fields <= value.fields.keys() | info.known.keys():
                    self.add(f"{fill}(value, x.answering, x.taken)")
                else:
                    self.add(f"inner = value.fields[{quoted(info.inner)}]")
                    with self.out.block("if type(inner) is FrameValue and inner.raw is None:"):
                        self.add(f"{fill}(inner, x.answering, x.taken)")
        held = constant("info", f"INFOS[{quoted(frame)}]")
        self.add(f"{kept}send_built(m, run, x, {held}, value, {self.context_of(frame)})")

    def context_of(self, frame: str) -> str:
        """Return the source of the names for building a frame."""
        return self.names if self.frames.reads(frame) & (OF_EXCHANGE | self.own.keys()) else "n"

    # ---- waiting ------------------------------------------------------------------------------------------

    def limits(self) -> None:
        """Write the time limits of a wait."""
        step = self.step
        if step.within is None and step.complete is None and step.gap is None:
            return
        self.add(f"run.longest = {'NEVER' if step.within is None else f'int({self.expression(step.within)})'}")
        self.add(f"run.complete = {'None' if step.complete is None else f'int({self.expression(step.complete)})'}")
        self.add(f"run.gap = {'None' if step.gap is None else f'int({self.expression(step.gap)})'}")

    def handlers(self, *events: str) -> dict[str, tuple[Action, ...]]:
        """Return the handlers of these events that the step, or the sequence, has."""
        found = {event: self.step.handlers.get(event) or self.sequence.handlers.get(event) or () for event in events}
        return {event: actions for event, actions in found.items() if actions}

    def park(self, what: str, doing: str = PARKED) -> None:
        """Write a wait for an event other than a row, with a loop for the handlers that may apply meanwhile."""
        events = self.handlers(*PARKED_EVENTS, *(("on_byte",) if what == "pause" else ()))
        always = self.sequence.always if doing == CALLING else ()
        name = self.called(what)
        arguments = [quoted(self.step.name), self._always(list(always)), literal(tuple(events))]
        self.module.constants[name] = f"{PARKS[what]}({', '.join(arguments)})"
        self.add(f"got = yield {name}")
        if doing != CALLING and not events:
            return
        before, self.doing = self.doing, doing
        with self.out.block("while got is not GO:"):
            if doing == CALLING:
                self._results()
            if always:
                with self.out.block("if type(got) is FrameValue:"):
                    self.rows(list(always), "always")
                    self.add("got = yield NOT_TAKEN")
                    self.add("continue")
            for event, actions in events.items():
                with self.out.block(f"if got is {EVENTS[event]}:"):
                    self.handle(event, actions)
            self.add("got = yield NOT_TAKEN")
        self.doing = before
        with self.out.block("if got is not GO:"):
            self.add("continue")

    def _results(self) -> None:
        """Write how the results of a call, or of a service, are taken."""
        into = self.step.call.into if self.step.call is not None else self.step.ask_into
        with self.out.block("if type(got) is dict:"):
            for variable, result in into.items():
                self.assign(variable, f"got[{quoted(result)}]", fits=True)
            self.add("got = GO")
            self.add("break")
        with self.out.block("if type(got) is Failed:"):
            self.add("outcome, cause = got.outcome, run.cause")
            self.handle("on_fail", self.handlers("on_fail").get("on_fail", ()), "outcome")

    def _always(self, rows: list[Row]) -> str:
        """Return the source of the frame names of rows; an empty name stands for expected frames."""
        named = tuple(dict.fromkeys(name for row in rows for name in (*row.frames, *(("",) if row.expected else ()))))
        return literal(named)

    def wait(self) -> None:
        """Write the wait for the rows of the step."""
        step, sequence = self.step, self.sequence
        rows = [row for row in step.receive or () if is_plain_row(row)]
        queued = [row for row in step.receive or () if not is_plain_row(row)]
        handlers = self.handlers("on_timeout", "on_bad", "on_other", "on_noise", *PARKED_EVENTS)
        arguments = [quoted(step.name), str(self.index), self._always(rows), self._always(list(sequence.always))]
        arguments.append(literal(tuple((row.queue, row.room) for row in queued)))
        arguments.append(literal(tuple(handlers)))
        timed = step.within is not None or step.complete is not None or step.gap is not None
        arguments += [str(timed), str(is_numbered(step, sequence, self.protocol))]
        name = self.called("wait")
        self.module.constants[name] = f"Wait({', '.join(arguments)})"
        if self.repeats:
            self.place(WAIT)
        self.limits()
        self.add(f"got = yield {name}")
        self.doing, self._goes_back = WAITING, False
        with self.out.block("while True:"):
            if rows or sequence.always:
                with self.out.block("if type(got) is FrameValue:"):
                    self.rows(rows, "")
                    self.rows(list(sequence.always), "always")
            if queued:
                with self.out.block("if type(got) is Item:"):
                    for place, row in enumerate(queued):
                        with self.out.block(f"if got.row == {place}:"):
                            self._queue_row(row)
            if timed:
                with self.out.block("if got is TIMEOUT:"):
                    self.handle("on_timeout", handlers.get("on_timeout", ()), '"timeout"')
            if "on_bad" in handlers:
                with self.out.block("if type(got) is Bad:"):
                    self.add("cause, frame = got.cause, got.frame")
                    self.handle("on_bad", handlers["on_bad"])
            if "on_other" in handlers:
                with self.out.block("if type(got) is Other:"):
                    self.add("it = got.value")
                    self.handle("on_other", handlers["on_other"])
            for event in ("on_noise", *PARKED_EVENTS):
                if event in handlers:
                    with self.out.block(f"if got is {EVENTS[event]}:"):
                        self.handle(event, handlers[event])
            self.add("got = yield NOT_TAKEN")
        self.doing = GOING
        if self._goes_back:
            self.add("continue")

    def rows(self, rows: list[Row], event: str) -> None:
        """Write the tests of rows for a received frame, in their order."""
        for row in rows:
            tests = [f"got.frame in {literal(frozenset(row.frames))}"] if len(row.frames) > 1 else []
            tests += [f"got.frame == {quoted(name)}" for name in row.frames] if len(row.frames) == 1 else []
            tests += ["got.frame in x.expected"] if row.expected else []
            frames = row.frames if not row.expected else ()
            with self.out.block(f"if {' or '.join(tests) or 'False'}:"):
                if row.when is None:
                    self._taken(row, frames, event)
                    continue
                self._condition(row.when, frames)
                with self.out.block("if fits:"):
                    self._taken(row, frames, event)

    def _condition(self, when: Expression, frames: tuple[str, ...]) -> None:
        with self.out.block("try:"):
            self.add(f"fits = {self.expression(when, frames)}")
        with self.out.block("except EVALUATION_ERRORS as error:"):
            self.add(f"fits = unclear(m, {quoted(self.step.name)}, error)")

    def _taken(self, row: Row, frames: tuple[str, ...], event: str) -> None:
        self.add("it = x.taken = got" if self.uses_it else "x.taken = got")
        with self.out.block("if run.asked is not None:"):
            self.add("replied(run)")
        self.add('run.cause = ""')
        self.act(row, "next", frames, event=event)

    def _queue_row(self, row: Row) -> None:
        self.add("got = got.value")
        if row.when is not None:
            self._condition(row.when, ())
            with self.out.block("if not fits:"):
                self.add("got = yield NOT_TAKEN")
                self.add("continue")
        with self.out.block("if run.asked is not None:"):
            self.add("replied(run)")
        if row.queue is not None:
            self.add("it = got")
            self.add(f"m.queues.take({quoted(row.queue)})")
        self.act(row, "next", ())

    def handle(self, event: str, actions: tuple[Action, ...], outcome: str = "") -> None:
        """Write the handlers of an event; if no handler applies, the step fails with `outcome`, or waits on."""
        usual = "next" if event == "on_byte" else "again"
        default = outcome if event in ("on_timeout", "on_exhausted", "on_fail") else ""
        for action in actions:
            if action.when is None:
                self.act(action, usual, None, default, event)
                return
            with self.out.block(f"if {self.expression(action.when)}:"):
                self.act(action, usual, None, default, event)
        if outcome:
            self.add(f"outcome = {outcome}")
            self.jump_to_end()
        else:
            self.add("got = yield NOT_TAKEN")
            self.add("continue")

    # ---- where it leads -----------------------------------------------------------------------------------

    def leaves(self) -> None:
        """Write for a handler that the reply to the request is waited for no longer."""
        with self.out.block("if run.asked is not None:"):
            self.add("missed(run)")

    def reset_counters(self, but: str | None = None) -> None:
        for counter in self._counted.values():
            if counter != but:
                self.add(f"{counter} = 0")

    @property
    def counters(self) -> tuple[str, ...]:
        return tuple(self._counted.values())

    def end(self) -> None:
        """Write the end of the sequence, with its results."""
        if self.listens:
            with self.out.block('if run.kind == "listen" and listens_again(m, run, x):'):
                self.jump(-1)
        fields = [f"{quoted(name)}: {self.expression(one)}" for name, one in self.sequence.gives.items()]
        self.add(f"return {{{', '.join(fields)}}}")

    def to_index(self, index: int, is_last: bool = False) -> None:
        """Write the way to a step. `is_last`: at the end of the block, where the next step is fallen into."""
        if index >= len(self.sequence.steps):
            self.end()
            return
        if index <= self.index:
            self.add("count(run)")
        if not is_last or index != self.index + 1:
            self.jump(index * BLOCKS)

    def leave(self, handler: bool = False, is_last: bool = False) -> None:
        """Write the end of the step: its next piece, or the way to the next step (`is_last`: see `to_index`)."""
        then = self.step.then
        if handler:
            self.leaves()
        if self.step.parts is not None:
            with self.out.block("if part_index + 1 < len(parts):"):
                self.reset_counters()
                self.add("part_index += 1")
                self.jump(self.index * BLOCKS + PART)
        if then == "end":
            self.end()
            return
        self.reset_counters()
        self.to_index(self.index + 1 if then == "next" else self._steps.get(then, self.index), is_last)

    # ---- actions ------------------------------------------------------------------------------------------

    def act(
        self, action: Action, usual: str, row: tuple[str, ...] | None = None, outcome: str = "", event: str = ""
    ) -> None:
        """Write an action, and the jump to the step that follows.

        `usual` is the next place if the action names no place; `outcome` source of the failure it stands for then.
        `event`: the handler of the action; "always": a row that may be a caller's; "branch": no wait is under way.
        """
        counter = self._counted.get(id(action))
        if counter is not None and action.at_most is not None:
            self._count(action, counter, row, event)
        asks_again = action.send is not None and action.fail is None and action.then in (None, "again", "restart")
        if asks_again and event == "on_timeout":
            self.add("still_due(run)")
        if action.take is not None:
            self.add(f"{'got = ' if row is not None else ''}it = m.take_item({quoted(action.take)})")
        for target, value in action.set:
            self.set(target, value, row)
        for place, address in action.store:
            self.add(f"m.store({quoted(address)}, {self.expression(place, row)})")
        for queue, fields in action.put:
            self.add(f"put(m, {quoted(queue)}, {self.record(fields, row)}, {self.names})")
        if action.deliver is not None:
            self.add(f"m.deliver({self.value(action.deliver, row)})")
        if action.send is not None:
            self.send(action.send, row)
        if action.because is not None:
            self.add(f"run.cause = str({self.expression(action.because, row)})")
        if action.fail is not None or (action.then is None and outcome):
            self.add(f"outcome = {outcome if action.fail is None else quoted(action.fail)}")
            self.jump_to_end()
            return
        self._follow(action.then or usual, counter, event)

    def _count(self, action: Action, counter: str, row: tuple[str, ...] | None, event: str) -> None:
        assert action.at_most is not None
        given_up = " or run.given_up" if action.then == "resend" else ""
        names = SequenceNames(self, row is not None, row or ())
        with self.out.block(f"if {counter} >= {emit(action.at_most.root, names, BIT_OR)}{given_up}:"):
            if action.otherwise is not None:
                self.act(action.otherwise, "next", row, "", event)
            else:
                self.exhausted()
        self.add(f"{counter} += 1")

    def exhausted(self) -> None:
        """Write the exit when a limit of the step is used up."""
        self._deep += 1
        if self._deep > 3:  # it can't end by going on with itself
            self.add('outcome = "exhausted"')
            self.jump_to_end()
        else:
            self.handle("on_exhausted", self.handlers("on_exhausted").get("on_exhausted", ()), '"exhausted"')
        self._deep -= 1

    def _follow(self, word: str, counter: str | None, event: str) -> None:
        handler = event.startswith("on_")
        if word == "again":
            self._again(event)
        elif word == "restart" and self.doing == WAITING:
            self.limits()
            self.add("got = yield RESTART")
            self.add("continue")
        elif word == "resend":
            self._resend()
        elif word in ("next", "restart"):
            if word == "restart" and self.doing == CALLING:
                with self.out.block("if run.state is State.RECEIVING:"):
                    self.add("got = yield RESTART")
                    self.add("continue")
            self.leave(handler)
        elif word == "end":
            self.end()
        else:
            if handler:
                self.leaves()
            self.reset_counters(counter)
            self.to_index(self._steps[word])

    def _resend(self) -> None:
        """Write that the frame of the step is sent again, if it may be."""
        most = "" if self.step.retries is None else f" or resends >= {self.expression(self.step.retries)}"
        with self.out.block(f"if run.given_up{most}:"):
            self.exhausted()
        self.add("resends += 1")
        self.add("still_due(run)")
        with self.out.block("if sent is not None:"):
            self.add("m.put_out(run, sent[0], sent[1], True)")
        if self.doing == WAITING:
            self.limits()
            self.add("got = yield RESTART")
            self.add("continue")
        else:
            self.jump(self.index * BLOCKS + WAIT)

    def _again(self, event: str) -> None:
        """Write that the wait goes on; without a wait, the step goes on."""
        if event == "branch":
            self.leave()
        elif event == "on_fail" and self.doing == CALLING:
            self.add("got = GO")
            self.add("break")
        elif self.doing == GOING:
            self.leave(handler=True)
        else:
            self.add("got = yield AGAIN")
            self.add("continue")


EVENTS = {
    "on_noise": "NOISE",
    "on_break": "BREAK",
    "on_closed": "CLOSED",
    "on_held": "NOT_SENT",
    "on_byte": "BYTE",
}
PARKS = {"pause": "Pause", "hold": "ParkedHold", "call": "ParkedCall", "ask": "Asking", "line": "Changing"}


def own_variables(sequence: Sequence, protocol: Protocol) -> dict[str, str]:
    """Return the variables of a sequence and their types; those that only `set` names included."""
    found = {**dict.fromkeys(sequence.takes, ""), **sequence.local}
    for target in parts_of(sequence, Target):
        name = target.name
        is_whole = target.field is None and target.key is None
        if is_whole and name != "clock" and name not in protocol.state and name not in protocol.params:
            found.setdefault(name, "")
    return found


def received_variables(sequence: Sequence) -> dict[str, tuple[str, ...]]:
    """Return the variables that only rows set, to the frame they have taken: with the frames that this may be."""
    found: dict[str, dict[str, None]] = {}
    others = {*sequence.takes}
    rows = [row for step in sequence.steps for row in step.receive or ()] + list(sequence.always)
    for row in rows:
        for target, value in row.set:
            is_taken = isinstance(value, Expression) and value.root == Name(value.root.at, "it")
            if is_taken and row.frames and not row.expected and target.field is None and target.key is None:
                found.setdefault(target.name, {}).update(dict.fromkeys(row.frames))
            else:
                others.add(target.name)
        for action in parts_of(row.otherwise, Action):
            others.update(target.name for target, _ in action.set)
    for step in sequence.steps:
        into = [] if step.call is None else list(step.call.into)
        others.update(target.name for target, _ in step.set)
        others.update([*into, *step.ask_into, *([step.decode.into] if step.decode is not None else [])])
        for action in parts_of([step.branch or (), step.handlers], Action):
            others.update(target.name for target, _ in action.set)
    for action in parts_of(sequence.handlers, Action):
        others.update(target.name for target, _ in action.set)
    return {name: tuple(frames) for name, frames in found.items() if name not in others and name in sequence.local}


def actions_of(sequence: Sequence, step: Step) -> list[Action]:
    """Return every action that may be taken in a step."""
    first: list[Action] = [*(step.receive or ()), *(step.branch or ()), *sequence.always]
    first += [action for handlers in (step.handlers, sequence.handlers) for one in handlers.values() for action in one]
    found: list[Action] = []
    for action in first:
        one: Action | None = action
        while one is not None:
            found.append(one)
            one = one.otherwise
    return found


def is_plain_row(row: Row) -> bool:
    """Return whether a row waits for frames."""
    return row.queue is None and row.room is None


def empty_value(type_: str) -> str:
    """Return the source of the first value of a variable of this type."""
    return literal(empty_of(type_))


class StepKey(NamedTuple):
    """A key that a step may have; `write` returns whether the rest of the step is not reached."""

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
    step.add(f"m.set_session({kind == 'new'})")


def _parts(step: StepWriter, parts: Parts) -> None:
    step.add(f"parts, part_index = cut_parts({step.expression(parts.of)}, {step.expression(parts.size)}), 0")
    with step.out.block("if not parts:"):
        step.add("part_index = 0")
        step.leave()
    step.place(PART)
    step.add("part = begin_part(run, parts, part_index)")
    if step.repeats:
        step.add("resends = 0")


def _wait(step: StepWriter, time: Expression) -> None:
    step.add(f"run.pause = {step.expression(time)}")
    with step.out.block("if run.pause > 0:"):
        step.park("pause")


def _hold_break(step: StepWriter, time: Expression) -> None:
    if step.held:
        with step.out.block("while late.holds.until and is_held(m, run, x, None):"):
            _hold(step)
        _gone(step)
    step.add(f"hold_break(m, run, {step.expression(time)})")


def _hold(step: StepWriter) -> None:
    """Write the loop of a step that is held back; a handler may leave it for another step."""
    before, step.doing = step.doing, PARKED
    events = step.handlers(*PARKED_EVENTS)
    name = step.called("hold")
    step.module.constants[name] = f"ParkedHold({quoted(step.step.name)}, (), {literal(tuple(events))})"
    step.add(f"got = yield {name}")
    if events:
        with step.out.block("while got is not GO:"):
            for event, actions in events.items():
                with step.out.block(f"if got is {EVENTS[event]}:"):
                    step.handle(event, actions)
            step.add("got = yield NOT_TAKEN")
        with step.out.block("if got is not GO:"):
            step.add("break")
    step.doing = before


def _gone(step: StepWriter) -> None:
    """Write the source after that loop."""
    if step.handlers(*PARKED_EVENTS):
        with step.out.block("else:"):  # it was not broken off
            step.add("got = GO")
        with step.out.block("if got is not GO:"):
            step.add("continue")


def _flush(step: StepWriter, _: bool) -> None:
    step.add("m.flush()")


def _set(step: StepWriter, settings: tuple[Any, ...]) -> None:
    for target, value in settings:
        step.set(target, value)


def _decode(step: StepWriter, decode: Decode) -> None:
    frames = literal(decode.frames)
    step.add(f"found = decoded(m, run, {step.names}, {frames}, {step.expression(decode.of)})")
    with step.out.block("if type(found) is Bad:"):
        step.add("cause, frame = found.cause, found.frame")
        step.handle("on_bad", step.handlers("on_bad").get("on_bad", ()), '"damaged_frame"')
    step.assign(decode.into, "found", fits=True)


def _serve(step: StepWriter, serve: Serve) -> None:
    buffer = 'b""' if serve.buffer is None else step.expression(serve.buffer)
    station = "x.station" if serve.station is None else step.expression(serve.station)
    step.add(f"serve(m, run, x, {step.expression(serve.request)}, {buffer}, {station}, {serve.check_only})")


def _call(step: StepWriter, called: CallOf) -> None:
    step.add(f"run.wanted = {quoted(called.sequence)}, {step.record(called.arguments)}")
    step.park("call", CALLING)


def _ask(step: StepWriter, asked: FrameOf) -> None:
    step.add(f"run.wanted = {quoted(asked.frame)}, {step.record(asked.fields)}")
    step.park("ask", CALLING)


def _put(step: StepWriter, puts: tuple[Any, ...]) -> None:
    for queue, fields in puts:
        step.add(f"put(m, {quoted(queue)}, {step.record(fields)}, {step.names})")


def _deliver(step: StepWriter, value: Value) -> None:
    step.add(f"m.deliver({step.value(value)})")


def _send(step: StepWriter, value: Value) -> None:
    if step.held and not step.step.urgent:
        with step.out.block(f"while late.holds.until and is_held(m, run, x, {step.value(value)}, {step.names}):"):
            _hold(step)
        _gone(step)
    step.send(value, repeats=True)


def _line(step: StepWriter, change: LineChange) -> None:
    if change.speed is None and change.format is None:
        step.add("run.change = own_line(m)")
    else:
        speed, format_ = ("None" if one is None else step.expression(one) for one in (change.speed, change.format))
        step.add(f"run.change = change_line(m, {speed}, {format_})")
    with step.out.block("if run.change is not None:"):
        step.park("line")


def _receive(step: StepWriter, _: Any) -> bool:
    step.wait()
    return True


def _branch(step: StepWriter, actions: tuple[Action, ...]) -> bool:
    for action in actions:
        if action.when is None:
            step.act(action, "next", event="branch")
            break
        with step.out.block(f"if {step.expression(action.when)}:"):
            step.act(action, "next", event="branch")
    else:
        if not step.repeats:
            return False
        step.leave()
    if step.repeats:  # a branch may send the frame again, and then waits
        step.wait()
    return True


STEP_KEYS = [
    StepKey("when", _when),
    StepKey("session", _session),
    StepKey("parts", _parts),
    StepKey("wait", _wait),
    StepKey("hold_break", _hold_break),
    StepKey("flush", _flush),
    StepKey("set", _set),
    StepKey("decode", _decode),
    StepKey("serve", _serve),
    StepKey("call", _call),
    StepKey("ask", _ask),
    StepKey("put", _put),
    StepKey("deliver", _deliver),
    StepKey("send", _send),
    StepKey("line", _line),
    StepKey("receive", _receive),
    StepKey("branch", _branch),
]
"""The keys of a step, in the order in which their effects happen."""


_OWN_FUNCTIONS = frozenset((*vars(runtime), *vars(late), *dir(builtins)))
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
    """Add a key that steps may have, with an effect before the effect of another key.

    `form`: the form of its value. `write`: writes its source into the generator, as the functions above do; the source
    may call `functions`. Raise ValueError for a key, or a function's name, that another module has.
    """
    key, module = key_of(name, form, doc), write.__module__
    if before not in {one.attribute for one in STEP_KEYS} - {name}:
        raise ValueError(f"no step key '{before}' is there to do '{name}' before it – name another one")
    for one in functions:
        bring_word("function of steps", one.__name__, one.__module__, one.__name__ in _OWN_FUNCTIONS)
    add_keys("protocol", "step", dict(key.schemas), module)
    bring(module)
    ADDED_FUNCTIONS.update((one.__name__, one) for one in functions)
    ADDED_KEYS[name] = key
    STEP_KEYS[:] = [one for one in STEP_KEYS if one.attribute != name]
    place = next(place for place, one in enumerate(STEP_KEYS) if one.attribute == before)
    STEP_KEYS.insert(place, StepKey(name, write))
