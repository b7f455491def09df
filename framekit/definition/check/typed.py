"""Where values of a definition must be of a kind: times of steps, sizes, defaults, what constructors give to fields.

The rules of kinds are in `kinds`; here is which names have which kind, and which key wants what.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from typing import Any

from framekit.definition.check.kinds import Attributes, Kind, KindChecker, never_an_attribute
from framekit.definition.check.value_kinds import (
    VARIABLE_KINDS,
    add_kind,
    field_kinds,
    kind_of_segment,
    kind_of_state,
    kind_of_variable,
    named_numbers,
)
from framekit.definition.expression.syntax import Attribute, Conditional, Expression, Name, Node, Text
from framekit.definition.model.frames import Frame
from framekit.definition.model.procedure import Action, Row, Sequence, Step
from framekit.definition.model.protocol import Parameter, Protocol, StateVariable
from framekit.definition.model.segments import (
    Bits,
    Choose,
    Count,
    Data,
    Field,
    Length,
    Require,
    Segment,
    Value,
    Wrap,
)
from framekit.definition.model.services import ServiceRow
from framekit.definition.model.values import FrameOf
from framekit.definition.model.walk import expressions_of, flat, parts_of
from framekit.definition.problems import Problem, did_you_mean

_OFFERED: dict[str, Kind] = {
    "start": "number", "count": "number", "bytes": "number", "first": "number", "done": "number", "total": "number",
    "element_bytes": "number", "data": "bytes", "bits": "list", "text": "text",
}  # fmt: skip
_BUILT_IN: dict[str, Kind] = {"role": "text", "now": "time", "buffer": "bytes", "reply_buffer": "bytes"}


def check_kinds(protocol: Protocol) -> list[Problem]:
    """Every expression whose value cannot be what its place wants."""
    return _Kinds(protocol).check()


class _Kinds:
    def __init__(self, protocol: Protocol) -> None:
        self.protocol = protocol
        self.found: list[Problem] = []
        self.local: Mapping[str, Kind] = {}  # variables of the sequence that is looked at
        names: dict[str, Kind] = dict(_BUILT_IN)
        names |= {name: kind_of_variable(parameter.type) for name, parameter in protocol.params.items()}
        names |= {name: kind_of_state(variable) for name, variable in protocol.state.items()}
        names |= dict.fromkeys(protocol.tables, "table")
        untold = protocol.kind == "application"  # the protocol that carries it says what stations are
        station = "any" if untold else VARIABLE_KINDS.get(protocol.station.type, "any")
        self.globally: dict[str, Kind] = names | {"station": station, "own": station}

    def check(self) -> list[Problem]:
        protocol = self.protocol
        for parameter in protocol.params.values():
            self._parameter(parameter)
        for variable in protocol.state.values():
            self._variable(variable)
        self._line()
        for frame in protocol.frames.values():
            self._segments(frame.segments, {})
            self._announces(frame)
        for layout in protocol.layouts.values():
            self._segments(layout.segments, {})
        for sequence in protocol.sequences.values():
            self._sequence(sequence)
        for rows in protocol.services.values():
            for row in rows:
                self._service(row)
        if protocol.errors is not None:
            self._made(self._checker({"code": "any"}), [protocol.errors.answer])
        return self.found

    def _checker(self, local: Mapping[str, Kind] | None = None, attributes: Attributes | None = None) -> KindChecker:
        checker = KindChecker({**self.globally, **(local or {})}, attributes or never_an_attribute)
        checker.problems = self.found
        return checker

    # ---- sections -----------------------------------------------------------------------------------------

    def _parameter(self, parameter: Parameter) -> None:
        wanted = kind_of_variable(parameter.type)
        checker = self._checker()
        if parameter.type not in ("choice", "list"):
            checker.wants(parameter.default, wanted)
        checker.wants(parameter.is_, wanted)

    def _variable(self, variable: StateVariable) -> None:
        if variable.layout is None and not variable.values:
            self._checker().wants(variable.initial, kind_of_variable(variable.type))

    def _line(self) -> None:
        line, receiver = self.protocol.line, self.protocol.receiver
        checker = self._checker()
        for time in (line.turnaround, line.key_delay, line.late, receiver.gap, receiver.quiet):
            checker.wants(time, "time")
        for session in self.protocol.sessions.values():
            checker.wants(session.keep_alive_after, "time")
        for role in self.protocol.roles.values():
            for lane in role.lanes:
                checker.wants(lane.at_once, "number")

    # ---- frames -------------------------------------------------------------------------------------------

    def _segments(self, segments: tuple[Segment, ...], outer: Mapping[str, Kind]) -> None:
        local = {**outer, **field_kinds(segments)}
        checker = self._checker(local)
        checker.named_numbers = named_numbers(segments)
        for segment in flat(segments):
            self._segment(checker, segment)
            if segment.inner_record is not None:
                self._segments(segment.inner_record, local)

    def _segment(self, checker: KindChecker, segment: Segment) -> None:
        checker.wants(segment.when, "any")
        for key in ("size", "times", "most"):
            value = getattr(segment, key, None)
            if isinstance(value, Expression):
                checker.wants(value, "number")
        match segment:
            case Field(type=type_, values=values):
                if isinstance(type_.size, Expression):
                    checker.wants(type_.size, "number")
                for expression in (segment.is_, segment.build, segment.default):
                    if expression is not None:
                        self._for_field(checker, expression, kind_of_segment(segment), values)
            case Bits(parts=parts):
                for part in parts:
                    for expression in (part.is_, part.build):
                        if expression is not None:
                            self._for_field(checker, expression, "number", part.values)
            case Require(condition=condition):
                checker.wants(condition, "any")
            case Value(read=read, build=build):
                checker.wants(read, "any")
                checker.wants(build, "any")
            case Choose(on=on):
                checker.wants(on, "any")
            case Wrap(insert=insert):
                checker.wants(insert, "any")

    def _for_field(
        self, checker: KindChecker, expression: Expression, kind: Kind, values: Mapping[int, str] | None
    ) -> None:
        """What a field is given: of its kind, or one of its names."""
        if values is None:
            checker.wants(expression, kind)
            return
        checker.kind(expression)
        for text in _results(expression.root):
            if text.value not in values.values():
                what = f"'{text.value}' is not a name of this field's values"
                self.found.append(Problem(text.at, what, did_you_mean(text.value, values.values())))

    def _announces(self, frame: Frame) -> None:
        checker = self._checker(field_kinds(frame.segments))
        for name, expression in frame.announces.items():
            variable = self.protocol.state.get(name)
            checker.wants(expression, "any" if variable is None else kind_of_state(variable))

    # ---- sequences ----------------------------------------------------------------------------------------

    def _sequence(self, sequence: Sequence) -> None:
        local: dict[str, Kind] = dict.fromkeys(sequence.takes, "any")
        local |= {name: kind_of_variable(type_) for name, type_ in sequence.local.items()}
        checker = self._checker(local)
        self.local = local
        for step in sequence.steps:
            self._step(checker, step, local)
        for row in sequence.always:
            self._row(row, local)
        for actions in sequence.handlers.values():
            self._actions(checker, actions)
        self.local = {}

    def _step(self, checker: KindChecker, step: Step, local: Mapping[str, Kind]) -> None:
        for time in (step.wait, step.hold_break, step.within, step.complete, step.gap):
            checker.wants(time, "time")
        checker.wants(step.retries, "number")
        checker.wants(step.when, "any")
        if step.parts is not None:
            checker.wants(step.parts.of, "bytes")
            checker.wants(step.parts.size, "number")
        checker.wants(step.serve.buffer if step.serve is not None else None, "bytes")
        self._settings(checker, step)
        self._made(checker, [step.send, step.deliver, step.put, step.call, [] if step.ask is None else step.ask.fields])
        for row in step.receive or ():
            self._row(row, local)
        self._actions(checker, step.branch or ())
        for actions in step.handlers.values():
            self._actions(checker, actions)

    def _row(self, row: Row, local: Mapping[str, Kind]) -> None:
        frames = [self.protocol.frames[name] for name in row.frames if name in self.protocol.frames]
        known: dict[str, Kind] = {}
        for frame in frames if not row.expected and len(frames) == len(row.frames) else ():
            for name, kind in field_kinds(frame.segments).items():
                add_kind(known, name, kind)

        def attribute(node: Attribute) -> Kind:
            if isinstance(node.value, Name) and node.value.name == "it":
                return known.get(node.name, "any")
            return never_an_attribute(node)

        self._actions(self._checker({**local, "it": "frame" if row.frames else "any"}, attribute), [row])

    def _actions(self, checker: KindChecker, actions: Iterable[Action]) -> None:
        for action in actions:
            checker.wants(action.when, "any")
            checker.wants(action.at_most, "number")
            for expression, _ in action.store:
                checker.wants(expression, "bytes")
            self._settings(checker, action)
            self._made(checker, [action.send, action.deliver, action.put])
            if action.otherwise is not None:
                self._actions(checker, [action.otherwise])

    def _settings(self, checker: KindChecker, holder: Step | Action) -> None:
        """What `set` puts into a variable is of its kind."""
        for target, value in holder.set:
            variable = self.protocol.state.get(target.name)
            parameter = self.protocol.params.get(target.name)
            wanted: Kind = "any"
            if target.name in self.local:
                pass  # it goes before a variable of the state
            elif target.field is None and variable is not None and not variable.values and variable.layout is None:
                wanted = kind_of_variable(variable.type) if target.key is not None or variable.keys is None else "any"
            elif target.field is None and target.key is None and parameter is not None:
                wanted = kind_of_variable(parameter.type)
            if isinstance(value, Expression):
                checker.wants(value, wanted if wanted not in ("list", "frame") else "any")
            else:
                self._made(checker, [value])

    # ---- constructors -------------------------------------------------------------------------------------

    def _made(self, checker: KindChecker, holders: Collection[Any]) -> None:
        """Constructors of frames: what each field is given. Other expressions are looked at for themselves."""
        judged: set[int] = set()
        for made in parts_of(list(holders), FrameOf):
            frame = self.protocol.frames.get(made.frame)
            fields = {} if frame is None else {segment.name: segment for segment in flat(frame.segments)}
            for name, value in made.fields.items():
                segment = fields.get(name)
                if isinstance(value, Expression) and isinstance(segment, Field):
                    judged.add(id(value))
                    self._for_field(checker, value, kind_of_segment(segment), segment.values)
                elif isinstance(value, Expression) and isinstance(segment, (Data, Length, Count)):
                    judged.add(id(value))
                    checker.wants(value, kind_of_segment(segment))
        for expression in expressions_of(list(holders)):
            if id(expression) not in judged:
                checker.kind(expression)

    def _service(self, row: ServiceRow) -> None:
        local = dict(_OFFERED) if row.service in ("read", "write") else {}
        local |= {argument.name: kind_of_variable(argument.type) for argument in row.takes}
        local |= dict.fromkeys((*row.back, *row.back_each), "any")
        checker = self._checker(local)
        for argument in row.takes:
            checker.wants(argument.default, kind_of_variable(argument.type) if argument.type != "list" else "any")
        checker.wants(row.limit.count, "number")
        checker.wants(row.limit.bytes, "number")
        self._made(checker, [row.request, row.buffer])
        let: dict[str, Kind] = {} if row.serve is None else dict.fromkeys(row.serve.let, "any")
        answering = self._checker({**local, "data": "bytes", "bytes": "number", "element_bytes": "number", **let})
        for reply in row.reply:
            self._made(answering, [reply.frame, reply.buffer])


def _results(node: Node) -> Iterable[Text]:
    """The texts that an expression may come to."""
    if isinstance(node, Text):
        yield node
    elif isinstance(node, Conditional):
        yield from _results(node.then)
        yield from _results(node.otherwise)
