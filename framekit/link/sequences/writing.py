"""Writes Python functions for the parts of a sequence: names, values, settings, sends, actions, and where they lead.

Text of a definition reaches the source only by `quoted`, `literal` and the expression emitter. What a step's keys come
to stands in the table STEP_KEYS; how functions become a module in `compiler`.
"""

from __future__ import annotations

import builtins
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
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
from framekit.definition.model.values import EachOf, FrameOf, LayoutOf, ListOf, ReadAs, RecordOf, Value
from framekit.definition.schema import add_keys
from framekit.link.frame_table import FrameInfo, FrameTable
from framekit.link.sequences import runtime
from framekit.link.variables import empty_of

OF_EXCHANGE = frozenset({"request", "buffer", "expected", "station", "reply", "reply_buffer", "refusal"})
"""Names that belong to an exchange, or to what is served."""

OF_CALL = frozenset({"part", "cause", "frame", "outcome"})
"""Names that a call frame has while a step does its pieces, or handles an event."""

MOST_DEEP = 16
"""A step goes on to the next one by calling it; after so many the machine does, so that no stack grows."""

_LOCALS = {"m": "a.m", "s": "a.s", "d": "a.d", "device": "a.s.device"}
"""Locals that functions may use, and where they come from."""


class Frames:
    """What is known of a protocol's frames before anything is sent or received."""

    def __init__(self, protocol: Protocol, table: FrameTable) -> None:
        self.protocol = protocol
        self.infos = table.infos
        self.plain: dict[str, set[str]] = {}
        self.inner: dict[str, set[str]] = {}
        for name, frame in protocol.frames.items():
            self.plain[name] = set(_always_there(frame.segments))
            self.inner[name] = {one.name for one in frame.segments if isinstance(one, Inner) and one.when is None}
        self.frame_is_field = any("frame" in names for names in self.plain.values())
        self.delivers = protocol.delivers

    def reads(self, frame: str) -> set[str]:
        """The names that building a frame may read, those of frames inside it included."""
        found: set[str] = set()
        for name in self._parts(frame, set()):
            mine: set[str] = set()
            model = self.protocol.frames[name]
            for expression in (*expressions_of(model.segments), *model.echo.values()):
                mine |= names_in(expression.root)
            found |= mine - self.plain[name]
        return found

    def echoes(self, frame: str) -> bool:
        """Whether building a frame, or one inside it, repeats something of a request."""
        return any(self.infos[name].echo for name in self._parts(frame, set()))

    def _parts(self, frame: str, known: set[str]) -> set[str]:
        if frame not in known:
            known.add(frame)
            for part in parts_of(self.protocol.frames[frame].segments, Segment):
                for name in part.frames_inside:
                    self._parts(name, known)
        return known

    def made_plainly(self, frame: str) -> bool:
        """Whether nothing but constants has to be added to the fields of a frame before it is sent."""
        info = self.infos[frame]
        return not {name for name, *_ in info.computed} & {name for name, *_ in info.echo}


def _always_there(segments: tuple[Segment, ...]) -> Iterator[str]:
    """The fields that every received frame of these segments has."""
    for segment in segments:
        if segment.when is not None:
            continue
        if isinstance(segment, Bits):
            yield from (part.name for part in segment.parts)
        elif segment.inner_record is not None or isinstance(segment, (Field, Data, Inner, Repeat)):
            yield from segment.value_names


class SequenceModule:
    """Functions of a module, and the constants that they use: each is written once."""

    def __init__(self) -> None:
        self.functions = Source()
        self._constants: dict[str, str] = {}

    def constant(self, kind: str, source: str) -> str:
        """The name of a module constant that is worked out when the module is loaded."""
        found = self._constants.get(source)
        if found is None:
            found = self._constants[source] = f"{kind}_{len(self._constants)}"
        return found

    def text(self, about: str) -> str:
        out = Source()
        out.docstring(about)
        for source, name in self._constants.items():
            out.add(f"{name} = {source}")
        return out.text() + self.functions.text()


class SequenceNames:
    """How names are written in a function of a sequence. `frames`: those that `it`, a received frame, may be."""

    def __init__(self, writer: StepWriter, in_row: bool, frames: tuple[str, ...] = ()) -> None:
        self.writer = writer
        self.in_row = in_row
        self.frames = frames

    def name(self, node: Name) -> str:
        name, writer = node.name, self.writer
        if name in writer.own:
            return writer.slot(name)
        if name == "it":
            return "it" if self.in_row else "a.it"
        if name in OF_CALL:
            return f"a.{name}"
        if name in OF_EXCHANGE:
            return f"{writer.local('d')}.{name}"
        if name in writer.protocol.state:
            return f"{writer.holder(name)}[{quoted(name)}]"
        if name == "now":
            return f"{writer.local('s')}.now"
        if name in writer.protocol.params:
            return f"a.n[{quoted(name)}]"
        return f"{writer.local('s')}[{quoted(name)}]"

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
        """Source, and the received frames that it may be: () for any frame, None where it may be anything."""
        known = self.writer.frames
        if isinstance(node, Name) and not known.delivers:
            if node.name == "it" and self.frames and "it" not in self.writer.own:
                return "it", self.frames
            if node.name in self.writer.received:
                return self.writer.slot(node.name), self.writer.received[node.name]
        if isinstance(node, Attribute):
            source, frames = self._typed(node.value)
            if frames and all(node.name in known.inner[one] for one in frames):
                return f"{source}.fields[{quoted(node.name)}]", ()
        return emit(node, self, ATOM), None

    def line_time(self, node: LineTime) -> str:
        return f'{self.writer.local("s")}["line"].{node.unit}({node.count[0]}, {node.count[1]})'

    def call(self, function: str, arguments: list[str]) -> str:
        if function in ENGINE_FUNCTIONS:
            return f'{self.writer.local("s")}["functions"].{function}({", ".join(arguments)})'
        return f"{home_of(function)}.{function}({', '.join(arguments)})"


class StepWriter:
    """Writes the functions of one step. `own`: the variables of its sequence and their types ("" for any).

    `received`: variables that hold received frames only, and which these may be. `held`: its sequence runs for
    exchanges, so replies that are due may hold its request back.
    """

    def __init__(
        self, module: SequenceModule, frames: Frames, sequence: Sequence, number: int, index: int, held: bool
    ) -> None:
        self.module = module
        self.frames = frames
        self.protocol = frames.protocol
        self.sequence = sequence
        self.step: Step = sequence.steps[index]
        self.index = index
        self.held = held
        self.prefix = f"q{number}_"
        self.own = own_variables(sequence, self.protocol)
        self.received = received_variables(sequence)
        self.out = Source()
        self.repeats = False
        self._steps = {step.name: place for place, step in enumerate(sequence.steps)}
        self._used: dict[str, None] = {}
        self._after = ""
        actions = actions_of(sequence, self.step)
        self._counted = {id(action): f"c{index}_{place}" for place, action in enumerate(actions) if action.at_most}
        self.repeats = "on_exhausted" in {*self.step.handlers, *sequence.handlers} or any(
            action.then == "resend" for action in actions
        )

    # ---- functions ----------------------------------------------------------------------------------------

    def called(self, what: str = "", index: int | None = None) -> str:
        """The name of a function of this step, or of another one."""
        return f"{self.prefix}{self.index if index is None else index}{what and '_'}{what}"

    @contextmanager
    def function(self, what: str = "", parameters: str = "a") -> Iterator[None]:
        """A function of the step; what is added inside is its body."""
        self._begin(what, parameters)
        yield
        self._end()

    def _begin(self, what: str, parameters: str) -> None:
        self._open = what, parameters
        self.out, self._used = Source(), {}

    def _end(self) -> None:
        what, parameters = self._open
        functions = self.module.functions
        functions.add()
        functions.add()
        with functions.block(f"def {self.called(what)}({parameters}):"):
            if self._used:
                sources = ", ".join(_LOCALS[name] for name in self._used)
                functions.add(f"{', '.join(self._used)} = {sources}")
            functions.extend(self.out)

    def split(self, what: str, parameters: str = "a") -> None:
        """What follows is a function of its own."""
        self._end()
        self._begin(what, parameters)

    def local(self, name: str) -> str:
        """A local of the function."""
        self._used[name] = None
        return name

    def add(self, text: str) -> None:
        self.out.add(text)

    # ---- names and values ---------------------------------------------------------------------------------

    def slot(self, name: str) -> str:
        """A variable of the sequence."""
        assert re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", name), name
        return f"a.v_{name}"

    def holder(self, variable: str) -> str:
        """Where a state variable is kept."""
        return self.local("device" if self.protocol.state[variable].scope == "device" else "s")

    def expression(self, expression: Expression, row: tuple[str, ...] | None = None) -> str:
        """Source of an expression; `row`: it stands in a row for these frames."""
        return emit(expression.root, SequenceNames(self, row is not None, row or ()))

    def value(self, value: Value, row: tuple[str, ...] | None = None) -> str:
        match value:
            case Expression():
                return self.expression(value, row)
            case FrameOf(frame=frame, fields=fields):
                make = self.module.constant("make", "TABLE.made")
                return f"{make}({quoted(frame)}, {self.record(fields, row)}, a.names())"
            case LayoutOf(layout=layout, fields=fields):
                encode = self.module.constant("layout", f"LAYOUTS[{quoted(layout)}][0]")
                return f"{encode}(plain({self.record(fields, row)}), a.names())"
            case ReadAs(layout=layout, source=source):
                functions = self.module.constant("layout", f"LAYOUTS[{quoted(layout)}]")
                return f"read_as({functions}, {self.value(source, row)}, a.names())"
            case ListOf(items=items):
                return f"[{', '.join(self.value(item, row) for item in items)}]"
            case RecordOf(fields=fields):
                return self.record(fields, row)
            case EachOf():
                return "a.names()[EACH]"  # there is none in a sequence: it cannot be worked out
        raise TypeError(f"no value of a definition: {value!r}")

    def record(self, fields: Mapping[str, Value], row: tuple[str, ...] | None = None) -> str:
        return "{" + ", ".join(f"{quoted(name)}: {self.value(value, row)}" for name, value in fields.items()) + "}"

    # ---- set ----------------------------------------------------------------------------------------------

    def set(self, target: Target, value: Value, row: tuple[str, ...] | None = None) -> None:
        source = self.value(value, row)
        name = target.name
        if target.field is not None:
            holder = SequenceNames(self, row is not None).name(Name(self.step.at, name))
            self.add(f"set_field(a, {holder}, {quoted(target.field)}, {source})")
        elif target.key is not None:
            key = self.expression(target.key, row)
            if name not in self.own:
                self.add(f"{self.local('s')}.set_entry({quoted(name)}, {key}, {source})")
                return
            self.add(f"found = {self.slot(name)}.copy()")
            self.add(f"found[{key}] = {source}")
            self.add(f"{self.slot(name)} = found")
        else:
            is_number = isinstance(value, Expression) and isinstance(value.root, (Binary, Number))
            self.assign(name, source, is_number=is_number)

    def assign(self, name: str, source: str, fits: bool = False, is_number: bool = False) -> None:
        """Sets a variable. `fits`: it is what the variable may hold; `is_number`: surely a number."""
        if name in self.own:
            type_ = self.own[name]
            if not fits and type_ not in ("", "frame", "record"):
                source = f"{self.module.constant('fit', f'FIT({quoted(type_)})')}({source})"
            if name == "request":
                source = f"{self.local('d')}.answers({source})"
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
            self.add(f"{self.local('s')}.set({quoted(name)}, {source})")

    # ---- send ---------------------------------------------------------------------------------------------

    def send(self, value: Value, row: tuple[str, ...] | None = None, repeats: bool = False) -> None:
        """Sends a frame; `repeats`: it is what `resend` sends again."""
        if not isinstance(value, FrameOf):
            self.add(f"{'a.sent = ' if repeats else ''}send_value(a, {self.value(value, row)})")
        elif not self.frames.made_plainly(value.frame):
            self.add(f"{'a.sent = ' if repeats else ''}send_made(a, {self.value(value, row)}, a.names())")
        else:
            self._send_made(value, row, repeats)

    def _send_made(self, value: FrameOf, row: tuple[str, ...] | None, repeats: bool) -> None:
        frame, info = value.frame, self.frames.infos[value.frame]
        names = self.context_of(frame)
        d, constant = self.local("d"), self.module.constant
        fields = [f"{quoted(name)}: {self._sent_field(info, name, one, row)}" for name, one in value.fields.items()]
        known = {name: one for name, one in info.known.items() if name not in value.fields}
        fields += [f"{quoted(name)}: {literal(one)}" for name, one in known.items()]
        encode = constant("encode", f"INFOS[{quoted(frame)}].encode")
        self.add(f"value = FrameValue({quoted(frame)}, {{{', '.join(fields)}}})")
        if names == "names":
            self.add("names = a.names()")
        if self.frames.echoes(frame):
            with self.out.block(f"if not {d}.checks_echo:"):
                self.add(f"{constant('fill_echo', 'TABLE.fill_echo')}(value, {d}.answering, {d}.last_taken)")
        if info.flat:
            self.add(f"data = {encode}(value.fields, {names})")
        elif info.inner in value.fields and len(info.shape) == 1:
            inner = quoted(info.inner or "")
            self.add("fields = value.fields")
            inner_plain = constant("inner_plain", "TABLE.inner_plain")
            self.add(f"data = {encode}({{**fields, {inner}: {inner_plain}(fields[{inner}])}}, {names})")
        else:
            self.add(f"data = {encode}(plain_fields(value.fields), {names})")
        self.add(f"{constant('mark_sent', 'TABLE.mark_sent')}(value, data, {names})")
        if info.announces:
            self.add(f"{self.local('m')}.announce(value)")
        self.add(f"{d}.last_sent = value")
        if repeats and self.repeats:
            self.add("a.sent = data, value")
        self.add(f"{self.local('m')}.put_out(a.run, data, value)")

    def _sent_field(self, info: FrameInfo, name: str, value: Value, row: tuple[str, ...] | None) -> str:
        """Source of a field of a frame that is sent: names of numbers become these."""
        if isinstance(value, FrameOf) and self.frames.made_plainly(value.frame):
            inner = self.frames.infos[value.frame]
            fields = [f"{quoted(key)}: {self._sent_field(inner, key, one, row)}" for key, one in value.fields.items()]
            known = {key: one for key, one in inner.known.items() if key not in value.fields}
            fields += [f"{quoted(key)}: {literal(one)}" for key, one in known.items()]
            return f"FrameValue({quoted(value.frame)}, {{{', '.join(fields)}}})"
        source = self.value(value, row)
        if name in info.numbers and not (isinstance(value, Expression) and isinstance(value.root, (Number, Binary))):
            numbers = self.module.constant("numbers", f"INFOS[{quoted(info.name)}].numbers[{quoted(name)}]")
            return f"number_of({numbers}, {source})"
        return source

    def context_of(self, frame: str) -> str:
        """Source of the names on which a frame is built."""
        needed = self.frames.reads(frame)
        is_own = needed & (OF_EXCHANGE | self.own.keys())
        return "names" if is_own else "a.n"

    # ---- where it leads -----------------------------------------------------------------------------------

    def leaves(self) -> None:
        """In a handler: what was asked for is waited for no longer."""
        with self.out.block("if a.run.asked is not None:"):
            self.add("missed(a.run)")

    def reset_counters(self, but: str | None = None) -> None:
        for counter in self._counted.values():
            if counter != but:
                self.add(f"a.{counter} = 0")

    @property
    def counters(self) -> tuple[str, ...]:
        return tuple(self._counted.values())

    def to_index(self, index: int) -> None:
        """On to a step."""
        if index >= len(self.sequence.steps):
            self.add("return end(a)")
        elif index > self.index and index % MOST_DEEP:
            self.add(f"return {self.called(index=index)}(a)")
        else:
            self.add("count(a.run)")
            self.add(f"return {self.called(index=index)}")

    def leave(self, handler: bool = False) -> None:
        """The step is done: its next piece, or where it says it goes."""
        then = self.step.then
        if handler:
            self.leaves()
        if self.step.parts is not None:
            with self.out.block("if has_more(a):"):
                self.reset_counters()
                self.add("begin_part(a, a.part_index + 1)")
                self.add(f"return {self.called('part')}")
        if then == "end":
            self.add("return end(a)")
            return
        self.reset_counters()
        self.to_index(self.index + 1 if then == "next" else self._steps.get(then, self.index))

    @property
    def goes_on(self) -> str:
        """What the step does behind its call or its service; "" if it has none."""
        return self.called("after") if self.step.call is not None or self.step.ask is not None else ""

    # ---- actions ------------------------------------------------------------------------------------------

    def act(
        self, action: Action, usual: str, row: tuple[str, ...] | None = None, outcome: str = "", event: str = ""
    ) -> None:
        """Does an action, and returns what follows.

        `usual` is where it leads when it does not say; `outcome` source of the failure it stands for then. `event`: the
        handler it stands in; "always": a row that may be a caller's; "branch": nothing waits.
        """
        counter = self._counted.get(id(action))
        if counter is not None and action.at_most is not None:
            self._count(action, counter, row, event)
        asks_again = action.send is not None and action.fail is None and action.then in (None, "again", "restart")
        if asks_again and event == "on_timeout":
            self.add("still_due(a.run)")
        if action.take is not None:
            self.add(f"{'it = ' if row is not None else ''}a.it = {self.local('m')}.take_item({quoted(action.take)})")
        for target, value in action.set:
            self.set(target, value, row)
        for place, address in action.store:
            self.add(f"{self.local('m')}.store({quoted(address)}, {self.expression(place, row)})")
        for queue, fields in action.put:
            self.add(f"put(a, {quoted(queue)}, {self.record(fields, row)})")
        if action.deliver is not None:
            self.add(f"{self.local('m')}.deliver({self.value(action.deliver, row)})")
        if action.send is not None:
            self.send(action.send, row)
        if action.because is not None:
            self.add(f"a.run.cause = str({self.expression(action.because, row)})")
        if action.fail is not None or (action.then is None and outcome):
            self.add("abandon_above(a)")
            self.add(f"return fail(a, {outcome if action.fail is None else quoted(action.fail)})")
            return
        self._follow(action.then or usual, counter, event)

    def _count(self, action: Action, counter: str, row: tuple[str, ...] | None, event: str) -> None:
        assert action.at_most is not None
        given_up = " or a.run.given_up" if action.then == "resend" else ""
        names = SequenceNames(self, row is not None, row or ())
        with self.out.block(f"if a.{counter} >= {emit(action.at_most.root, names, BIT_OR)}{given_up}:"):
            if action.otherwise is not None:
                self.act(action.otherwise, "next", row, "", event)
            else:
                if event == "branch":
                    self.add("a.run.state = State.GOING")
                self.add("return exhausted(a)")
        self.add(f"a.{counter} += 1")

    def _follow(self, word: str, counter: str | None, event: str) -> None:
        handler = event.startswith("on_")
        if word == "again":
            self._again(event)
            return
        if word == "restart" and event != "branch":
            with self.out.block("if a.run.state is State.RECEIVING:"):
                self.add(f"begin_clock(a.run, {self.local('s')}.now)")
                self.add("return None")
        if event in ("always", "on_break", "on_closed"):
            self.add("abandon_above(a)")
        if word == "resend":
            if event == "branch":
                self.add("a.run.state = State.GOING")
            self.add("return resend(a)")
        elif word in ("next", "restart"):
            self.leave(handler)
        elif word == "end":
            self.add("return end(a)")
        else:
            if handler:
                self.leaves()
            self.reset_counters(counter)
            self.to_index(self._steps[word])

    def _again(self, event: str) -> None:
        """Waits on; where nothing waits, the step goes on."""
        if event == "branch":
            self.leave()
            return
        if event in ("on_fail", "on_exhausted") or (event == "on_bad" and self.step.decode is not None):
            with self.out.block("if a.run.state is State.GOING:"):
                if self.goes_on:
                    self.add(f"return {self.goes_on}(a)")
                else:
                    self.leave(handler=True)
        self.add("return None")


def own_variables(sequence: Sequence, protocol: Protocol) -> dict[str, str]:
    """The variables of a sequence and their types; those that only `set` names included."""
    found = {**dict.fromkeys(sequence.takes, ""), **sequence.local}
    for target in parts_of(sequence, Target):
        name = target.name
        is_whole = target.field is None and target.key is None
        if is_whole and name != "clock" and name not in protocol.state and name not in protocol.params:
            found.setdefault(name, "")
    return found


def received_variables(sequence: Sequence) -> dict[str, tuple[str, ...]]:
    """The variables that only rows set, to the frame they have taken: with the frames that this may be."""
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
    """Every action that may be taken in a step."""
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
    """Whether a row waits for frames."""
    return row.queue is None and row.room is None


def empty_value(type_: str) -> str:
    """Source of what a new variable of a type holds."""
    return literal(empty_of(type_))


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


def _decode(step: StepWriter, decode: Decode) -> None:
    frames = literal(decode.frames)
    step.add(f"found = decoded(a, {frames}, {step.expression(decode.of)})")
    with step.out.block("if found is None:"):
        step.add('return handled(a, "on_bad", "damaged_frame")')
    step.assign(decode.into, "found", fits=True)


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


def _line(step: StepWriter, change: LineChange) -> None:
    if change.speed is None and change.format is None:
        step.add(f"return own_line(a, {step.called('lined')})")
    else:
        speed, format_ = ("None" if one is None else step.expression(one) for one in (change.speed, change.format))
        step.add(f"return change_line(a, {speed}, {format_}, {step.called('lined')})")
    step.split("lined")


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
"""What a step does, in this order."""


_OWN_FUNCTIONS = frozenset((*vars(runtime), *dir(builtins)))
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
    writes may call `functions`. Raises ValueError for a key, or a function's name, that another module has.
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
