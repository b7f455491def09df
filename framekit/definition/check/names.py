"""Names in expressions: every bare word must have a meaning at its place."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from typing import Any

from framekit.definition.check.addresses import parts_in
from framekit.definition.check.requests import item_names
from framekit.definition.expression import (
    ENGINE_FUNCTIONS,
    Attribute,
    Call,
    Compare,
    Conditional,
    Expression,
    Name,
    Node,
    Text,
    names_in,
    walk,
)
from framekit.definition.kinds.base import Segment
from framekit.definition.model.checks import ready_methods
from framekit.definition.model.frames import (
    WIRE,
    Frame,
    by_value_name,
    expressions_of,
    field_names,
    flat,
    names_always_there,
    parts_of,
)
from framekit.definition.model.procedure import Action, Row, Sequence, Step, Target
from framekit.definition.model.protocol import Protocol, Rest
from framekit.definition.model.segments import INDEX, LAST, PREVIOUS
from framekit.definition.model.services import AS_NUMBERS, NUMBER_BITS, OFFERED, ServeWork, ServiceRow
from framekit.definition.model.values import EachOf, FrameOf, Value
from framekit.definition.problems import Position, Problem, did_you_mean, listed

BUILT_IN = frozenset({"station", "own", "role", "line", "now", "clock"})
EXCHANGE = frozenset({"request", "reply", "buffer", "reply_buffer", "expected", "refusal"})
IN_HANDLERS = frozenset({"cause", "frame", "outcome"})
ONLY_THERE = {
    "it": "it is what a row has taken: use it in a row, or in a step behind one",
    "part": "it is the piece of a step that has parts:",
    "cause": "it is known in on_bad and other handlers",
    "frame": "it is known in on_bad and other handlers; a frame's name is it.frame",
    "outcome": "it is known in on_fail",
    "reply": "it is what serve: answers: add serve: {request: …} before",
    "index": "it is the number of an item: use it in the segments of a repeat",
    "last": "it tells whether an item is the last one: use it in the segments of a repeat",
    "previous": "it is the item before: use it in the segments of a repeat",
}
"""Words that have a value at certain places only."""

IN_BLOCKS = frozenset({
    "result", "reply", "buffer", "data", "block", "outcome", "cause", "code", "ok", "refused", "status",
    "record",
})  # fmt: skip
"""Names known in the row of a command block and in its actions after an exchange, in addition to the usual names."""
OF_EVERY_FRAME = frozenset({"frame", "refusal"})


def behind_a_refusal(frame: Frame) -> set[str]:
    """Return the fields that may be missing in a refused frame: those from its first segment with a code on."""
    segments = list(flat(frame.segments))
    place = next((place for place, segment in enumerate(segments) if segment.refuse is not None), len(segments))
    return field_names(segments[place:]) - field_names(segments[:place])


def asked_for(expression: Expression) -> set[str]:
    """Return the fields whose presence an expression tests: `'station' in it`."""
    return {
        node.first.value
        for node in walk(expression.root)
        if isinstance(node, Compare) and isinstance(node.first, Text) and node.rest[0][0] in ("in", "not in")
    }


def takes_something(sequence: Sequence) -> bool:
    """Return whether a frame may have arrived that `it` refers to."""
    if sequence.always or "on_other" in sequence.handlers:
        return True
    return any(step.receive or any(action.take for action in parts_of(step, Action)) for step in sequence.steps)


def without_parts(segment: Segment) -> list[Any]:
    """Return the attributes of a segment without its inner segments, which are checked on their own."""
    parts = [
        getattr(segment, name)
        for name in segment.__dataclass_fields__
        if name not in ("of", "cases", "otherwise", "method")
    ]
    return [part for part in parts if part is not None]


class NameChecker:
    """Checks the names of one protocol. `globally`: names known everywhere in it; `broken`: names of broken parts."""

    def __init__(self, protocol: Protocol, broken: Collection[str] = ()) -> None:
        self.protocol = protocol
        self.broken = broken
        self.globally = BUILT_IN | protocol.params.keys() | protocol.state.keys() | protocol.tables.keys()
        self.globally |= protocol.queues.keys() | {INDEX, LAST, PREVIOUS}  # the loader puts them into items alone
        self.serves = any(step.serve is not None for step in parts_of(dict(protocol.sequences), Step))
        self.problems: list[Problem] = []

    def check(self, rest: Rest) -> list[Problem]:
        """Return the problems of all expressions in the protocol, and in the `rest` of its parts with errors."""
        protocol = self.protocol
        for partly_read in rest.frames:
            if partly_read.lost is not None:
                self._segments(partly_read.segments, EXCHANGE | partly_read.lost)
        for partly_read_row, words in rest.rows:
            self._service(partly_read_row, words)
        for frame in protocol.frames.values():
            self._segments(frame.segments, EXCHANGE)
            self._expressions(frame.announces, {*field_names(frame.segments), WIRE})
            self._echo(frame)
        for layout in protocol.layouts.values():
            self._segments(layout.segments, EXCHANGE)
        settings = [one for one in protocol.params.values() if one.type != "choice"]
        self._circle({one.name: one.is_ or one.default for one in settings}, "the parameter")
        for parameter in protocol.params.values():
            default = None if parameter.type == "choice" else parameter.default
            self._expressions([default, parameter.is_], EXCHANGE)
        self._expressions([*protocol.state.values()], EXCHANGE)
        self._expressions([protocol.line, protocol.receiver, *protocol.sessions.values()], ())
        self._expressions(protocol.roles, EXCHANGE)
        for sequence in protocol.sequences.values():
            self._sequence(sequence)
        for row in protocol.service_rows:
            self._service(row)
        self._expressions(protocol.server_refusals, EXCHANGE | (IN_BLOCKS if protocol.commands else set()))
        for method in protocol.checks.values():
            self._expressions([method.expression], {"data"} if method.kind == "code" else {"acc", "byte"})
            self._without_a_link([method.expression])
        self._commands()
        self._errors()
        return self.problems

    def _note(self, at: Position, what: str, todo: str = "") -> None:
        self.problems.append(Problem(at, what, todo))

    # ---- one expression -----------------------------------------------------------------------------------

    def _expressions(self, holder: Any, local: Collection[str]) -> None:
        known = self.globally | set(local)
        for expression in expressions_of(holder):
            self._names(expression, known)

    def _without_a_link(self, holder: Any) -> None:
        """Note uses of functions of the engine: frames, layouts and check codes are also built and read without a
        link.
        """
        for expression in expressions_of(holder):
            for node in walk(expression.root):
                if isinstance(node, Call) and node.function in ENGINE_FUNCTIONS:
                    what = f"'{node.function}' is known only while a link runs"
                    self._note(node.at, what, "work it out in a sequence or a service")

    def _names(self, expression: Expression, known: Collection[str]) -> None:
        for node in walk(expression.root):
            if isinstance(node, Call) and node.function == "code":
                self._code(node)
            if isinstance(node, Call) and node.function == "value":
                self._type_of_value(node)
            if not isinstance(node, Name) or node.name in known or node.name in self.broken:
                continue
            if node.name in ONLY_THERE:
                self._note(node.at, f"'{node.name}' has no value here", ONLY_THERE[node.name])
                continue
            self._note(node.at, f"there is no name '{node.name}' here", self._hint(node.name, known))

    def _code(self, call: Call) -> None:
        """Note a problem of the check method that a function computes: it must need bytes only."""
        name = call.arguments[0]
        if not isinstance(name, Text):
            self._note(name.at, "the name of a check code stands here", "write it in quotes")
            return
        method = self.protocol.checks.get(name.value) or ready_methods().get(name.value)
        if method is None:
            hint = did_you_mean(name.value, {*self.protocol.checks, *ready_methods()})
            self._note(name.at, f"there is no check method '{name.value}'", hint)
        elif method.kind != "code" and not method.is_of_bytes:
            self._note(name.at, f"the check code '{name.value}' takes more than bytes", "take another one")

    def _type_of_value(self, call: Call) -> None:
        """Note a problem of the type of a number in memory: it must be a constant."""
        name = call.arguments[1]
        if not isinstance(name, Text):
            self._note(
                name.at, "a type of numbers in memory stands here", f"write it in quotes: {', '.join(NUMBER_BITS)}"
            )
        elif name.value not in NUMBER_BITS:
            hint = did_you_mean(name.value, NUMBER_BITS)
            self._note(name.at, f"'{name.value}' is not a type of numbers in memory", hint)

    def _hint(self, name: str, known: Collection[str]) -> str:
        if name in self.protocol.frames:
            return f"write {{{name}: {{}}}} if the frame is meant"
        return did_you_mean(name, known) or f"write '{name}' in quotes if text is meant"

    def _circle(self, given: Mapping[str, Expression | None], kind: str, outside: Collection[str] = ()) -> None:
        """Note values that depend on themselves, directly or by others, unless `outside` has a value of the name."""
        rests = {name: names_in(one.root) & given.keys() for name, one in given.items() if one is not None}
        for name in outside:
            rests.get(name, set()).discard(name)
        for name, one in given.items():
            if one is not None and name in _reached(name, rests):
                self._note(one.at, f"{kind} '{name}' rests on itself", "break the circle: give a value without it")

    # ---- frames -------------------------------------------------------------------------------------------

    def _segments(self, segments: tuple[Segment, ...], outer: Collection[str], records: tuple[str, ...] = ()) -> None:
        known = set(outer) | field_names(segments)
        self._from_each_other(segments)
        for segment in flat(segments):
            self._expressions(without_parts(segment), known)
            self._without_a_link(without_parts(segment))
            self._from_itself(segment, outer, records)
            if segment.inner_record is not None:
                around = (*records, segment.name or "") if segment.is_record else ()
                self._segments(segment.inner_record, known, around)

    def _from_each_other(self, segments: tuple[Segment, ...]) -> None:
        """Note values that are computed from each other and therefore unknown until one of them is given."""
        given: dict[str, Expression] = {}
        for segment in flat(segments):
            for name, expression in segment.computed():
                given.setdefault(name, expression)  # `is` goes before `build`, and that before `default`
        reads = {
            name: names_in(one.root) & given.keys() - {name}
            for name, one in given.items()
            if not any(isinstance(node, Conditional) for node in walk(one.root))  # else it may read one of two
        }
        reach = {name: _reached(name, reads) for name in reads}
        reported: set[str] = set()
        for name in reads:
            circle = [other for other in reads if other in reach[name] and name in reach[other]]
            if circle and name not in reported:
                reported |= {*circle}
                what = f"{listed(repr(one) for one in circle)} follow from each other: one of them has to be given"
                todo = "let one of them follow from something else, if that is not meant"
                self.problems.append(Problem(given[name].at, what, todo, warning=True))

    def _from_itself(self, segment: Segment, outer: Collection[str], records: tuple[str, ...]) -> None:
        """Note values computed from themselves, unless their name has a meaning outside of the segment."""
        for name, expression in segment.computed():
            own = {(*records[place:], name) for place in range(len(records))}
            by_record = any(_path_of(node) in own for node in walk(expression.root) if isinstance(node, Attribute))
            here = name in names_in(expression.root) and name not in {*self.globally, *outer, *self.broken}
            if here or by_record:
                self._note(expression.at, f"'{name}' cannot be computed from itself", "name another value")

    def _echo(self, frame: Frame) -> None:
        """Note echoes that name no field of the frame, or expressions over fields that no frame of the other side
        has.
        """
        if not frame.echo:
            return
        fields = field_names(frame.segments)
        asked: set[str] = set()
        for other in self.protocol.frames.values():
            if other.name != frame.name and (other.inner or other.side != "server"):
                asked |= field_names(other.segments)
        for name, expression in frame.echo.items():
            if name not in fields:
                self._note(expression.at, f"'{frame.name}' has no field '{name}' to echo", did_you_mean(name, fields))
            elif not self.broken:
                self._names(expression, self.globally | asked | {"request"})

    # ---- procedure ----------------------------------------------------------------------------------------

    def _sequence(self, sequence: Sequence) -> None:
        local = EXCHANGE | set(sequence.takes) | sequence.local.keys()
        if not self.serves and not {"reply"} & {*sequence.takes, *sequence.local}:
            local -= {"reply"}
        taken = local | {"it"} if takes_something(sequence) else local
        self._expressions(sequence.gives, taken)
        self._expressions(sequence.always, local | {"it"})
        self._expressions(sequence.handlers, taken | IN_HANDLERS)
        for step in sequence.steps:
            here = taken | {"part"} if step.parts is not None else taken
            parts = [getattr(step, key) for key in step.__dataclass_fields__ if key not in ("receive", "handlers")]
            self._expressions([part for part in parts if part is not None and part is not step.send], here)
            self._sent(step.send, here)
            self._expressions(step.receive, here | {"it"})
            self._expressions(step.handlers, here | {"it"} | IN_HANDLERS)
            self._targets([step, *parts_of(step, Action)], here)
            for row in step.receive or ():
                self._row(row)
        self._targets(parts_of([sequence.always, dict(sequence.handlers)], Action), taken | {"it"})
        for row in sequence.always:
            self._row(row)

    def _sent(self, value: Value | None, known: Collection[str]) -> None:
        """Note a bare word in `send` that is neither a frame nor a variable."""
        root = value.root if isinstance(value, Expression) else None
        if isinstance(root, Name) and root.name not in {*self.globally, *known, *self.broken, *ONLY_THERE}:
            hint = did_you_mean(root.name, [*self.protocol.frames, *set(known) - EXCHANGE])
            self._note(root.at, f"there is no frame or variable '{root.name}' to send", hint)
        else:
            self._expressions(value, known)

    def _targets(self, actions: Iterable[Action | Step], local: Collection[str]) -> None:
        """Note targets of `set` that are not settable: variables, parameters and the clock are."""
        for action in actions:
            at = action.places.get("set", action.at)
            for target, _ in action.set:
                self._target(target, at, local)

    def _target(self, target: Target, at: Position, local: Collection[str] = ()) -> None:
        known = {*local, *self.protocol.state, *self.protocol.params, "clock"}
        if target.name not in known and target.name not in self.broken:
            hint = did_you_mean(target.name, known - EXCHANGE - {"it", "part"})
            self._note(at, f"there is no variable '{target.name}' to set", hint)

    def _row(self, row: Row) -> None:
        """Note uses of `it.field` for fields that no frame of the row has."""
        frames = [self.protocol.frames[name] for name in row.frames if name in self.protocol.frames]
        if not frames or row.expected or len(frames) < len(row.frames):
            return
        fields = set().union(*(field_names(frame.segments) for frame in frames)) | OF_EVERY_FRAME
        unsure = {name: frame.name for frame in frames for name in behind_a_refusal(frame)}
        for expression in expressions_of(row):
            asked = asked_for(expression)
            for node in walk(expression.root):
                if not isinstance(node, Attribute) or node.value != Name(node.value.at, "it") or node.name in asked:
                    continue
                if node.name not in fields:
                    names = ", ".join(f"'{frame.name}'" for frame in frames[:3])
                    what = f"no frame of this row has a field '{node.name}' ({names})"
                    self._note(node.at, what, did_you_mean(node.name, fields))
                elif node.name in unsure:
                    what = f"'{node.name}' may be missing: '{unsure[node.name]}' is taken when it is to be refused, too"
                    self._note(node.at, what, f"ask for it first: '{node.name}' in it and …")

    # ---- services -----------------------------------------------------------------------------------------

    def _service(self, row: ServiceRow, more: Collection[str] = ()) -> None:
        """Check a row; `more`: words that may be names of its own."""
        local = self._names_of_row(row) | {*more}
        run = None if row.run is None else row.run.root
        if isinstance(run, Name) and run.name not in self.globally | local:
            hint = did_you_mean(run.name, self.protocol.sequences)
            self._note(run.at, f"there is no sequence '{run.name}' to run", hint)
            row = replace(row, run=None)
        self._circle({one.name: one.default for one in row.takes}, "the argument", self.globally)
        self._expressions(replace(row, back_each={}), local)
        self._of_one_variable(row)
        self._values_named_like_places(row)
        items = item_names(self.protocol, row)
        self._expressions(dict(row.back_each) if items else {}, local | items)
        self._fields_of_frames(row)
        if row.serve is not None:
            block = row.serve.block
            self._stored(row.serve.set)
            self._there(row, row.serve)
            self._stored([item for after in (block.then if block else ()) for item in after.set])

    def _names_of_row(self, row: ServiceRow) -> set[str]:
        """Return the names that the expressions of a row may use in addition to those of the protocol."""
        offered = OFFERED if row.service in ("read", "write") else OFFERED - AS_NUMBERS
        local = set(EXCHANGE | offered) | {argument.name for argument in row.takes}
        if row.service in ("read", "write") or row.most_variables:
            local |= {name for form in self.protocol.addresses for name in form.results}
            local |= {part.name for form in self.protocol.addresses for part in parts_in(form)}
        if row.serve is not None:
            local |= self._names_of_serving(row.serve)
        for name in row.sequences & self.protocol.sequences.keys():
            local |= self.protocol.sequences[name].gives.keys()
        return local

    def _names_of_serving(self, serve: ServeWork) -> set[str]:
        """Return the names that `serve` of a row gives."""
        local = set(serve.let.keys()) | (set() if self.protocol.commands is None else IN_BLOCKS)
        if serve.each_as:
            local.add(serve.each_as)
        for part in (serve.read, serve.span):
            alias = part.get("as") if isinstance(part, dict) else None
            if isinstance(alias, Expression):
                local.add(alias.text)
        return local

    def _of_one_variable(self, row: ServiceRow) -> None:
        """Note names of a single variable outside `each` in the request of a row with several variables."""
        if row.most_variables < 2:
            return
        forms = self.protocol.addresses
        places = OFFERED.union(*(form.names for form in forms)) - {row.same, *self.globally}
        places -= {argument.name for argument in row.takes}
        sent = [row.request, row.buffer]
        inside = {id(part) for each in parts_of(sent, EachOf) for part in parts_of(each, Expression)}
        for expression in (part for part in parts_of(sent, Expression) if id(part) not in inside):
            for name in sorted(names_in(expression.root) & places):
                todo = f"use it in each, or add same: {name}" if name in ("unit", "area") else "use it in each"
                self._note(expression.root.at, f"'{name}' may differ from variable to variable", todo)

    def _values_named_like_places(self, row: ServiceRow) -> None:
        """Note a bare word that is a value of its field as well as a name of the address or the data."""
        places = OFFERED - self.globally - {argument.name for argument in row.takes}
        for sent in parts_of([row.request], FrameOf):
            frame = self.protocol.frames.get(sent.frame)
            fields = {} if frame is None else by_value_name(frame.segments)
            for name, value in sent.fields.items():
                word = value.root.name if isinstance(value, Expression) and isinstance(value.root, Name) else ""
                values = getattr(fields.get(name), "values", None) or {}
                if word in places and word in values.values():
                    what = f"'{word}' is a name of the address here, and '{name}' has a value '{word}'"
                    todo = f"write \"'{word}'\" for the value, or give it another name"
                    self.problems.append(Problem(value.at, what, todo, warning=row.service in ("read", "write")))

    def _there(self, row: ServiceRow, serve: ServeWork) -> None:
        """Note variables set to a field that may be absent: a variable always has a value."""
        frame = self.protocol.frames.get(row.request.frame) if row.request is not None else None
        if frame is None or row.when is not None or frame.name in self.broken:
            return
        unsure = field_names(frame.segments) - names_always_there(frame.segments)
        for target, value in serve.set:
            for given, holds in ((value, f"'{target.name}'"), (target.key, f"a key of '{target.name}'")):
                root = given.root if isinstance(given, Expression) else None
                if not isinstance(root, Attribute) or not isinstance(root.value, Name) or root.value.name != "request":
                    continue
                if root.name in unsure:
                    what = f"'request.{root.name}' may be absent, and {holds} is never nothing"
                    self._note(root.at, what, f"write either(request.{root.name}, …) with what it is then")

    def _stored(self, targets: Iterable[tuple[Target, Value]]) -> None:
        for target, value in targets:
            self._target(target, value.at)

    def _commands(self) -> None:
        rules = self.protocol.commands
        if rules is not None:
            self._expressions(rules, EXCHANGE | IN_BLOCKS)
            self._stored([item for after in rules.then for item in after.set])

    def _fields_of_frames(self, row: ServiceRow) -> None:
        """Note fields `request.…` and `reply.…` that the row's request, or all its replies, lack."""
        request = {row.request.frame} if row.request is not None else set()
        replies = {reply.frame.frame for reply in row.reply if reply.frame is not None}
        known = {"request": self._fields(request), "reply": self._fields(replies)}
        for expression in expressions_of(row):
            asked = asked_for(expression)
            for node in walk(expression.root):
                whose = node.value.name if isinstance(node, Attribute) and isinstance(node.value, Name) else ""
                fields = known.get(whose)
                if isinstance(node, Attribute) and fields is not None and node.name not in fields | asked:
                    what = f"the {whose} of this row has no field '{node.name}'"
                    self._note(node.at, what, did_you_mean(node.name, fields - OF_EVERY_FRAME))

    def _fields(self, frames: set[str]) -> set[str] | None:
        """Return the fields of these frames; None if they are unknown."""
        if not frames or not frames <= self.protocol.frames.keys() or frames & set(self.broken):
            return None
        found = {name for frame in frames for name in field_names(self.protocol.frames[frame].segments)}
        return found | OF_EVERY_FRAME

    def _errors(self) -> None:
        errors = self.protocol.errors
        if errors is None:
            return
        fields: set[str] = set()
        known = {**self.protocol.frames, **self.protocol.groups}
        if any(name not in known for name in errors.frames):
            return
        for name in (frame for group in errors.frames for frame in self.protocol.frames_of(group)):
            if name not in self.protocol.frames:
                return
            fields |= field_names(self.protocol.frames[name].segments)
        self._expressions(errors, fields | EXCHANGE | {"code"})


def _reached(name: str, reads: Mapping[str, set[str]]) -> set[str]:
    """Return all names that a value depends on; itself only if the dependence is circular."""
    seen, new = set[str](), reads[name]
    while new:
        seen |= new
        new = set().union(*(reads.get(other, ()) for other in new)) - seen
    return seen


def _path_of(node: Node) -> tuple[str, ...]:
    """Return the names of `record.part.field`; an empty tuple for other expressions."""
    if isinstance(node, Attribute):
        outer = _path_of(node.value)
        return (*outer, node.name) if outer else ()
    return (node.name,) if isinstance(node, Name) else ()
