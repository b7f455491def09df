"""The replies that exchanges of a role wait for: frames, the requests that ask for them, steps with numbered replies.

Worked out once from the definition, when a protocol is compiled; `late` uses it while a line is at work.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

from framekit.definition.expression import Attribute, Binary, Expression, Name, names_in
from framekit.definition.model.frames import parts_of
from framekit.definition.model.procedure import Role, Row, Sequence, Step
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.segments import Check, Field, Segment
from framekit.definition.model.values import FrameOf
from framekit.link.values import (
    EVALUATION_ERRORS,
    Evaluate,
    FrameValue,
    Inverse,
    Names,
    bare_name,
    compile_optional,
    inverse_of,
)


class Beginning(NamedTuple):
    """One of the first steps of an exchange: it sends `when` that holds, and then waits for a reply or for none."""

    when: Evaluate | None
    has_reply: bool


class Replies(NamedTuple):
    """The replies that exchanges of a role wait for."""

    frames: frozenset[str]
    """Replies that repeat no number of their request."""
    requests: frozenset[str]
    """Frames with which services ask for these replies, and frames that carry one of these requests."""
    waits: tuple[Evaluate, ...]
    """Time limits of the steps that wait for them."""
    stations: Mapping[str, tuple[str, Inverse]] = {}
    """For each request the field that holds the station."""
    beginnings: tuple[tuple[Beginning, ...], ...] = ()
    """For each exchange its first steps that send, and whether a reply follows."""
    is_single: bool = True
    """Whether each reply is one frame, so that replies can be counted: every step that waits sends a request."""
    limits: Mapping[str, str] = {}
    """Parameters that are time limits of the steps, each with the setting to change; '' if that is not clear."""
    name_stations: bool = False
    """Whether every reply repeats the station of its request."""
    unproven: frozenset[str] = frozenset()
    """Replies that have no check code and repeat no field of their request: noise can look like them."""
    numbered: frozenset[str] = frozenset()
    """Replies that repeat a number of their request."""

    def is_broadcast(self, value: FrameValue, names: Names) -> bool:
        """Return whether an exchange sends this request without waiting for a reply: its station is a broadcast."""
        if value.frame not in self.stations:
            return False
        field, inverse = self.stations[value.frame]
        try:
            station = inverse.solve(value.fields[field], names)
            known = Names({"request": value, "station": station}, names)
            return bool(self.beginnings) and not any(_has_reply(steps, known) for steps in self.beginnings)
        except EVALUATION_ERRORS:
            return False


def replies_of(protocol: Protocol, role: Role | None) -> Replies:
    """Return the replies that the exchanges of a role wait for."""
    if role is None:
        return Replies(frozenset(), frozenset(), ())
    session = protocol.sessions.get(role.session or "")
    run = [name for lane in role.lanes for name in lane.exchange]
    run += () if session is None else (*session.open, *session.close)
    sequences = list(protocol.called_from(run))
    placed = [(step, sequence) for sequence in sequences for step in sequence.steps if step.receive]
    waiting = [step for step, _ in placed]
    steps = [step for step, sequence in placed if not is_numbered(step, sequence, protocol)]
    frames = _frames_of(steps, protocol)
    asking = [*_requests(frames, protocol), *(carrier for one in sequences for carrier in _carriers(one, steps))]
    exchanges = [protocol.sequences[name] for lane in role.lanes for name in lane.exchange]
    stations = _stations(asking)
    return Replies(
        frames,
        requests=frozenset(one.frame for one in asking),
        waits=tuple(wait for step in steps if (wait := compile_optional(step.within)) is not None),
        stations=stations,
        beginnings=tuple(tuple(_beginnings(sequence)) for sequence in exchanges),
        is_single=all(step.send is not None for step in steps),
        limits=_limits([*steps, *waiting], protocol),
        name_stations=_name_stations(frames, stations, protocol),
        unproven=frozenset(name for name in frames if _is_unproven(name, protocol)),
        numbered=_frames_of(waiting, protocol) - frames,
    )


def _frames_of(steps: list[Step], protocol: Protocol) -> frozenset[str]:
    """Return the frames that steps wait for."""
    return frozenset(name for step in steps for name in _waited_for(step.receive or (), protocol))


def _requests(replies: frozenset[str], protocol: Protocol) -> Iterator[FrameOf]:
    """Yield the requests of the service rows that are answered with one of these replies."""
    for row in protocol.service_rows:
        if row.request is not None and any(reply.frame and reply.frame.frame in replies for reply in row.reply):
            yield row.request


def _limits(steps: list[Step], protocol: Protocol) -> dict[str, str]:
    """Return the parameters that are time limits of steps, each with the setting to change."""
    named = [bare_name(step.within) for step in steps if step.within is not None]
    return {name: _setting_of(name, protocol) for name in named if name is not None and name in protocol.params}


def _is_unproven(name: str, protocol: Protocol) -> bool:
    """Return whether a reply has no check code and repeats no field of its request."""
    frame = protocol.frames[name]
    return not frame.echo and not any(parts_of(frame.segments, Check))


def _setting_of(name: str, protocol: Protocol) -> str:
    """Return the parameter to set for a time limit: itself, or the first of the sum that gives its value."""
    formula = protocol.params[name].is_
    if formula is None:
        return name
    node = formula.root
    while isinstance(node, Binary) and node.operator == "+":
        node = node.left
    is_time = isinstance(node, Name) and node.name in protocol.params and protocol.params[node.name].type == "time"
    return _setting_of(node.name, protocol) if isinstance(node, Name) and is_time else ""


def _has_reply(steps: tuple[Beginning, ...], names: Names) -> bool:
    """Return whether the first of these steps that is not skipped waits for a reply."""
    return next((step.has_reply for step in steps if step.when is None or step.when(names)), True)


def _beginnings(sequence: Sequence) -> Iterator[Beginning]:
    """Return the steps with which a sequence can begin."""
    for number, step in enumerate(sequence.steps):
        when = compile_optional(step.when)
        yield Beginning(when, step.send is None or _waits(sequence, number))
        if when is None:
            return


def _waits(sequence: Sequence, number: int) -> bool:
    """Return whether a step that waits for a frame can follow, or a step whose effect is unknown here."""
    numbers = {step.name: place for place, step in enumerate(sequence.steps)}
    waiting, seen = [number], set[int]()
    while waiting:
        place = waiting.pop()
        if place in seen or place >= len(sequence.steps):
            continue
        seen.add(place)
        step = sequence.steps[place]
        if step.receive or step.branch or step.call is not None or step.ask is not None:
            return True
        if step.then != "end":
            waiting.append(place + 1 if step.then == "next" else numbers[step.then])
        if step.when is not None and place != number:
            waiting.append(place + 1)
    return False


def _carriers(sequence: Sequence, steps: list[Step]) -> Iterator[FrameOf]:
    """Return the frames in which steps send the request that a sequence takes."""
    for step in sequence.steps:
        if step in steps and isinstance(step.send, FrameOf):
            values = (one for one in step.send.fields.values() if isinstance(one, Expression))
            if any(bare_name(value) in sequence.takes for value in values):
                yield step.send


def _stations(asking: list[FrameOf]) -> dict[str, tuple[str, Inverse]]:
    """Return for each request the field that holds the station, and the function that reads it."""
    found = {}
    for request in asking:
        for name, value in request.fields.items():
            inverse = inverse_of(value) if isinstance(value, Expression) else None
            if inverse is not None and inverse.name == "station":
                found[request.frame] = name, inverse
    return found


def _name_stations(frames: frozenset[str], stations: Mapping[str, tuple[str, Inverse]], protocol: Protocol) -> bool:
    """Return whether every reply that comes by itself on the line repeats the station of its request."""
    fields = {field for field, _ in stations.values()}
    inside = {name for frame in frames for part in protocol.frames[frame].segments for name in part.frames_inside}
    on_line = frames - inside
    echoes = [{bare_name(source) for source in protocol.frames[name].echo.values()} for name in on_line]
    return bool(fields) and bool(echoes) and all(names & fields for names in echoes)


def is_numbered(step: Step, sequence: Sequence, protocol: Protocol) -> bool:
    """Return whether each reply repeats a number that every request of the step gets anew: no other reply has it.

    A step without a request waits for the reply to a request that its sequence has put into a queue.
    """
    if isinstance(step.send, FrameOf):
        numbers = set(_fields_that_read(step.send, _counted(step, protocol)))
    elif step.send is None and any(one.put for one in sequence.steps):
        counted = set[str]().union(*(_counted(one, protocol) for one in sequence.steps))
        numbers = {field.name for field in _fields_of_frames(protocol) if _reads(field, counted)}
    else:
        return False
    frames = _waited_for(step.receive or (), protocol)
    return bool(numbers and frames) and all(_repeats_number(name, numbers, protocol) for name in frames)


def _counted(step: Step, protocol: Protocol) -> set[str]:
    """Return the state variables that a step counts on."""
    return {
        target.name
        for target, value in step.set
        if target.name in protocol.state and isinstance(value, Expression) and target.name in names_in(value.root)
    }


def _fields_of_frames(protocol: Protocol) -> Iterator[Field]:
    """Yield the fields of all frames."""
    return (field for frame in protocol.frames.values() for field in parts_of(frame.segments, Field))


def _reads(field: Field, variables: set[str]) -> bool:
    """Return whether a field is computed from one of these variables when a frame is built."""
    values = (field.is_, field.build, field.default)
    return any(isinstance(value, Expression) and bool(names_in(value.root) & variables) for value in values)


def _fields_that_read(frame: FrameOf, variables: set[str]) -> Iterator[str]:
    """Yield the fields whose values depend on variables; a field of a frame inside has the path to it as its name."""
    for name, value in frame.fields.items():
        if isinstance(value, FrameOf):
            yield from (f"{name}.{inner}" for inner in _fields_that_read(value, variables))
        elif isinstance(value, Expression) and names_in(value.root) & variables:
            yield name


def _repeats_number(name: str, fields: set[str], protocol: Protocol) -> bool:
    """Return whether a reply repeats a numbering field of its request, by itself or in a frame inside.

    Other frames inside are no replies: the device sends them by itself, or because it cannot read a request.
    """
    frame = protocol.frames[name]
    if any(_path_of(source) in fields for source in frame.echo.values()):
        return True
    inside = {inner for part in parts_of(frame.segments, Segment) for inner in part.frames_inside}
    return any(_path_of(source) in fields for inner in inside for source in protocol.frames[inner].echo.values())


def _path_of(expression: Expression) -> str | None:
    """Return the name or the path `field.field` that an expression consists of; None for other expressions."""
    names: list[str] = []
    node = expression.root
    while isinstance(node, Attribute):
        names.append(node.name)
        node = node.value
    return ".".join(reversed([*names, node.name])) if isinstance(node, Name) else None


def _waited_for(rows: tuple[Row, ...], protocol: Protocol) -> set[str]:
    found = {name for row in rows for name in row.frames}
    return found.union(_of_services(protocol)) if any(row.expected for row in rows) else found


def _of_services(protocol: Protocol) -> Iterator[str]:
    for row in protocol.service_rows:
        yield from (reply.frame.frame for reply in row.reply if reply.frame is not None)
    errors = protocol.errors
    for name in () if errors is None else errors.frames:
        yield from protocol.frames_of(name)
