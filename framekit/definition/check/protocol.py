"""Run all checks of a protocol in order; this module checks its small sections, its command blocks and its profile."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from decimal import Decimal
from typing import Any

from framekit.definition.check.addresses import check_forms, check_parts, check_texts
from framekit.definition.check.frames import FrameEnds, check_frame, check_partly_read
from framekit.definition.check.names import NameChecker
from framekit.definition.check.procedure import check_procedure
from framekit.definition.check.services import check_constructors_of, check_services
from framekit.definition.check.typed import check_kinds
from framekit.definition.expression import Bytes, Expression, List, Name, Number, Real, Text, is_constant
from framekit.definition.kinds.base import constant_number
from framekit.definition.model.frames import Frame, bytes_of, parts_of
from framekit.definition.model.procedure import Row, Sequence
from framekit.definition.model.protocol import Protocol, Rest
from framekit.definition.model.sections import Parameter, Queue, StateVariable
from framekit.definition.model.segments import Check, Const, Data, Field, Segment
from framekit.definition.model.services import BlockWork, CommandRules, PlaceOf
from framekit.definition.model.values import RecordOf
from framekit.definition.problems import NOWHERE, Position, Problem, did_you_mean, plural
from framekit.definition.start_values import StartValues
from framekit.definition.times import MOST_SPEED, format_time, is_format
from framekit.definition.wire_types import bounds_of_bits

MOST_VARIABLES = 4


def check_profile(protocol: Protocol) -> list[Problem]:
    """Return the violations of the protocol's profile, if it declares a profile."""
    if protocol.profile is None:
        return []
    if protocol.profile not in PROFILES:
        hint = did_you_mean(protocol.profile, PROFILES)
        return [Problem(protocol.profile_at, f"there is no profile '{protocol.profile}'", hint)]
    check = PROFILES[protocol.profile]
    return [problem for frame in protocol.frames.values() for problem in check(frame)]


def _user_frames(frame: Frame) -> Iterator[Problem]:
    """Check a user-defined frame of the Snet tool (guide, 7.3).

    Heads hold constants, bodies four variables at most; a sent body has no variable of fixed size.
    """
    for segment in frame.head:
        if not isinstance(segment, Const):
            yield Problem(segment.at, "a head holds only constants in this profile", "move it to the body")
    for segment in frame.tail:
        if not isinstance(segment, (Const, Check)):
            what = "a tail holds only constants and a check in this profile"
            yield Problem(segment.at, what, "move it to the body")
    variables = [segment for segment in frame.body if isinstance(segment, (Data, Field))]
    if not frame.body:
        what = "the body is empty, which this profile does not allow"
        yield Problem(frame.at, what, "give it a constant or a variable")
    for segment in frame.body:
        if not isinstance(segment, (Data, Field, Const)) and not segment.is_ignored:
            what = "a body holds only constants and variables in this profile"
            yield Problem(segment.at, what, "leave the profile out")
    for segment in variables[MOST_VARIABLES:]:
        what = f"the body has more than {MOST_VARIABLES} variables"
        yield Problem(segment.at, what, "split the frame, or leave the profile out")
    for segment in variables if frame.side == "client" else ():
        if isinstance(segment, Field) or isinstance(segment.size, int):
            what = "a sent body has no fixed-size variable in this profile"
            todo = "write {data: NAME, size: rest}, or the name of a parameter as its size"
            yield Problem(segment.at, what, todo)
    for segment in variables if frame.side == "server" else ():
        if isinstance(segment, Data) and segment.size == "rest" and segment is not frame.body[-1]:
            what = "a variable-size variable must be the last of a received body"
            yield Problem(segment.at, what, "move it to the end")


PROFILES: dict[str, Callable[[Frame], Iterable[Problem]]] = {"snet-user-frames": _user_frames}


PLACES = ("area", "memory", "code", "text")
"""The words that select the area of a place; a place has exactly one of them."""


def check_commands(protocol: Protocol, broken: Collection[str] = ()) -> Iterator[Problem]:
    """Yield all problems of command blocks."""
    rules = protocol.commands
    if rules is not None and protocol.kind == "protocol":
        what = "a protocol has no command blocks of its own"
        yield Problem(rules.at, what, "write commands: NAME with the application that has them")
    if protocol.commands_file and protocol.kind == "application":
        what = "an application says itself how its command blocks are read"
        yield Problem(protocol.at, what, "write commands: {frame, request, status, failed}")
    if rules is not None and rules.frame not in broken:
        yield from _rules(protocol, rules)
    for work in parts_of(dict(protocol.services), BlockWork):
        if rules is None and not protocol.commands_file and "commands" not in broken:
            what = "nothing makes exchanges of these requests"
            yield Problem(work.at, what, "add commands: to the application", warning=True)
        report = None if work.job is None else work.job.report
        for where in (work.read, work.write, work.into, work.source, report):
            yield from _place(work.at, where)
        if work.calls and work.read is None and work.into is not None and "data" not in work.into:
            yield Problem(work.at, "nothing says which data of the call go into the own memory", "add data: to into")
        for after in work.then:
            yield from _stored(protocol, after.store, after.at)


def _rules(protocol: Protocol, rules: CommandRules) -> Iterator[Problem]:
    frame = protocol.frames.get(rules.frame)
    inner = [part.name or "" for part in parts_of(frame, Segment) if part.frames_inside]
    if frame is not None and rules.request not in inner:
        hint = did_you_mean(rules.request, inner) or "give it {inner: NAME, of: GROUP}"
        yield Problem(rules.at, f"frame '{rules.frame}' carries no '{rules.request}'", hint)
    if rules.most < 1:
        yield Problem(rules.at, "a command block has no words", "give most: 1 or more")
    yield from _place(rules.at, rules.status)
    for after in rules.then:
        yield from _stored(protocol, after.store, after.at)


def _stored(protocol: Protocol, place: PlaceOf | None, at: Position) -> Iterator[Problem]:
    yield from _place(at, place)
    if place is None:
        return
    data = place.get("data")
    if data is None:
        yield Problem(at, "nothing says what is stored", "add data: to store")
    elif isinstance(data, RecordOf):
        names = ", ".join(f"'{name}'" for name in data.fields)
        hint = next((did_you_mean(name, protocol.layouts) for name in data.fields), "")
        yield Problem(data.at, f"{names} is no layout, so it has no bytes to store", hint or "name a layout")


def _place(at: Position, place: PlaceOf | None) -> Iterator[Problem]:
    if place is None:
        return
    given = [word for word in PLACES if word in place]
    if len(given) != 1:
        yield Problem(at, "a place has exactly one of area, memory, code and text", "say which area is meant")


RESERVED = frozenset({
    "it", "part", "request", "reply", "buffer", "reply_buffer", "expected", "own", "role", "now", "frame", "refusal",
    "station", "line", "clock", "cause", "outcome",
})  # fmt: skip
"""Words with a predefined meaning, which cannot be used as names."""

PLAIN_TYPES = ("flag", "text", "bytes", "time", "list", "record", "frame", "number", "f32", "f64")
_INTEGER = re.compile(r"([ui])(8|16|24|32|40|48|56|64)")


def check_sections(protocol: Protocol, is_whole: bool) -> Iterator[Problem]:
    """Yield the problems of each section by itself; `is_whole`: every part of the definition was read."""
    yield from _names(protocol)
    for parameter in protocol.params.values():
        yield from _parameter(parameter)
    for variable in protocol.state.values():
        yield from _variable(protocol, variable)
    for queue in protocol.queues.values():
        yield from _queue(queue)
    for sequence in protocol.sequences.values():
        yield from _locals(protocol, sequence)
    yield from _station(protocol)
    yield from _line(protocol)
    yield from _marks(protocol)
    yield from _delimiter(protocol, is_whole)


def _groups(protocol: Protocol) -> Iterator[Problem]:
    """Warn about groups without frames, and about rows that wait for an empty group of any file."""
    if not protocol.frames:
        return
    empty = [group for group in protocol.groups.values() if not group.frames]
    for group in empty:
        if group.at.file == protocol.at.file:
            what = f"no frame is in the group '{group.name}'"
            yield Problem(group.at, what, f"write group: {group.name} in frames, or remove it", warning=True)
    names = " or ".join(f"'{group.name}'" for group in empty if group.at.file != protocol.at.file)
    for sequence in protocol.sequences.values() if names else ():
        for row in parts_of(sequence, Row):
            if not row.frames and not row.expected and row.queue is None and row.room is None:
                what = f"the sequence '{sequence.name}' waits for a frame of the group {names}, and no frame is in it"
                yield Problem(protocol.at, what, "write group: with that name in frames", warning=True)
                break


def _names(protocol: Protocol) -> Iterator[Problem]:
    """Report names with two meanings, and predefined words used as names."""
    seen: dict[str, str] = {}
    sections: dict[str, Mapping[str, Any]] = {
        "parameter": protocol.params, "variable": protocol.state, "table": protocol.tables, "queue": protocol.queues,
    }  # fmt: skip
    for kind, section in sections.items():
        for name, item in section.items():
            at = item.at
            if name in RESERVED:
                yield Problem(at, f"'{name}' has a meaning of its own, it cannot name a {kind}", "give it another name")
            elif name in seen:
                yield Problem(at, f"the {kind} '{name}' is a {seen[name]} too", "give one of them another name")
            seen.setdefault(name, kind)


# ---- parameters and state -----------------------------------------------------------------------------------


def _parameter(parameter: Parameter) -> Iterator[Problem]:
    name, default = parameter.name, parameter.default
    if parameter.is_ is not None and default is not None:
        yield Problem(parameter.at, f"'{name}' has a default, and is: computes it always", "leave one of them out")
    if parameter.limits is not None and not {parameter.type, parameter.items} & {"number", "decimal", "time"}:
        todo = "add of: number" if parameter.type == "list" else "leave range out, or make it a number or a time"
        yield Problem(parameter.at, f"a {parameter.type} has no range", todo)
    if parameter.type == "choice" and not parameter.choices:
        yield Problem(parameter.at, f"'{name}' has nothing to choose from", "add of: [words]")
    if parameter.secret and parameter.type in ("bytes", "text"):
        yield from _not_told(parameter)
    if default is None:
        return
    if parameter.type == "choice":
        yield from _choice(parameter, default)
    yield from _in_range(parameter, default)
    if parameter.size is not None and isinstance(default.root, Bytes) and len(default.root.value) != parameter.size:
        what = f"the default of '{name}' has {plural(len(default.root.value), 'byte')}, not {parameter.size}"
        yield Problem(default.at, what, "correct one of them")


def _not_told(parameter: Parameter) -> Iterator[Problem]:
    """Report a secret parameter whose value is in the definition: generated code would contain the secret too."""
    written = parameter.default or parameter.is_
    if written is not None and (parameter.default is not None or is_constant(written)):
        what = f"'{parameter.name}' is secret, and its value stands here and in generated code"
        yield Problem(written.at, what, "leave it out: runs and devices give it")


def _choice(parameter: Parameter, default: Expression) -> Iterator[Problem]:
    word = default.root.value if isinstance(default.root, Text) else None
    if isinstance(default.root, Name):
        word = default.root.name
    if word is not None and word not in parameter.choices and parameter.choices:
        what = f"'{word}' is not a choice of '{parameter.name}'"
        yield Problem(default.at, what, did_you_mean(word, parameter.choices))


def _in_range(parameter: Parameter, default: Expression) -> Iterator[Problem]:
    if parameter.limits is None:
        return
    low, high = parameter.limits
    for node in default.root.items if isinstance(default.root, List) else (default.root,):
        if isinstance(node, (Number, Real)) and not low <= node.value <= high:
            value, least, most = (_shown(number, parameter) for number in (node.value, low, high))
            what = f"the default {value} of '{parameter.name}' is not in {least}..{most}"
            yield Problem(node.at, what, "correct one of them")


def _shown(number: int | Decimal, parameter: Parameter) -> str:
    is_time = "time" in (parameter.type, parameter.items)
    return format_time(int(number)) if is_time else str(number)


def _variable(protocol: Protocol, variable: StateVariable) -> Iterator[Problem]:
    type_ = variable.type
    plain = type_ in PLAIN_TYPES or _INTEGER.fullmatch(type_)
    if variable.keys is not None and not plain and type_ not in protocol.layouts:
        what = f"there is no type or layout '{type_}' for the entries of '{variable.name}'"
        yield Problem(variable.at, what, did_you_mean(type_, [*PLAIN_TYPES, *protocol.layouts]) or "write u16, text, …")
    if variable.given is not None:
        values = StartValues(protocol.layouts)
        values.of(variable)
        yield from values.problems
    number = constant_number(variable.initial)
    match = _INTEGER.fullmatch(type_)
    if number is not None and match is not None and variable.initial is not None:
        low, high = bounds_of_bits(int(match[2]), match[1] == "i")
        if not low <= number <= high:
            what = f"{number} does not fit: '{variable.name}' holds {low} to {high}"
            yield Problem(variable.initial.at, what, "use a wider type")
    if variable.most is not None and variable.most < 1:
        yield Problem(variable.at, f"a list of at most {variable.most} holds nothing", "give max: 1 or more")


def _queue(queue: Queue) -> Iterator[Problem]:
    if queue.size < 1:
        yield Problem(queue.at, f"the queue '{queue.name}' has no room", "give size: 1 or more")
    if not queue.holds:
        yield Problem(queue.at, f"the queue '{queue.name}' holds nothing", "add holds: {name: type}")


def _locals(protocol: Protocol, sequence: Sequence) -> Iterator[Problem]:
    """Report variables of a sequence with the name of a frame: a bare word in `send` would mean the frame."""
    frames: Mapping[str, Frame] = protocol.frames
    for name in (*sequence.takes, *sequence.local):
        if name in frames:
            what = f"'{name}' is a variable of '{sequence.name}' and a frame"
            at = sequence.at if sequence.at.file == protocol.at.file else frames[name].at
            yield Problem(at, what, "give one of them another name")


# ---- station and line ---------------------------------------------------------------------------------------


def _station(protocol: Protocol) -> Iterator[Problem]:
    station = protocol.station
    default = station.default
    if default is None:
        return
    number = constant_number(default)
    if station.limits is not None and number is not None and not station.limits[0] <= number <= station.limits[1]:
        low, high = station.limits
        yield Problem(default.at, f"the default station {number} is not in {low}..{high}", "correct one of them")
    if station.type == "none":
        yield Problem(default.at, "there are no stations here", "leave default out")


def _marks(protocol: Protocol) -> Iterator[Problem]:
    """Report a missing or useless `mark`: with nine-bit characters a frame must give the index of the marked byte."""
    line = protocol.line
    formats = [text.strip() for text in (line.format, *line.formats)]
    marked = [frame for frame in protocol.frames.values() if frame.mark is not None]
    inside = protocol.carried
    for frame in marked:
        if frame.inner or (frame.side == "none" and frame.name in inside):
            what = f"'{frame.name}' stands inside other frames, so no byte of it is marked by itself"
            yield Problem(frame.at, what, "write mark in the frame around it")
        elif line.kind == "stream":
            yield Problem(frame.at, f"no byte of '{frame.name}' can be marked on a stream", "leave mark out")
        elif other := [text for text in formats if not text.startswith("9")]:
            what = f"'{frame.name}' marks a byte, and characters of {other[0]} have no ninth bit"
            yield Problem(frame.at, what, "write line: {format: 9N1}, or leave mark out")
    if (
        line.has_marks
        and is_format(line.format)
        and all(frame.mark in (None, "none") for frame in marked)
        and protocol.frames
    ):
        what = f"the line has characters of nine bits ({line.format}), and no frame marks a byte"
        yield Problem(line.at, what, "write mark: first in a frame, or format: 8S1")
    if line.has_marks and protocol.receiver.delimiter is not None:
        what = "frames of nine-bit characters have no delimiter: the mark shows where one begins or ends"
        yield Problem(protocol.receiver.delimiter_at, what, "leave delimiter out")


def _delimiter(protocol: Protocol, is_whole: bool) -> Iterator[Problem]:
    """Yield frames that hold the delimiter between their first and last byte, and a delimiter without a frame.

    The latter only if `is_whole`: a frame that was not read may begin with the delimiter.
    """
    byte, is_used = protocol.receiver.delimiter, False
    if byte is None:
        return
    inner = protocol.carried
    for frame in protocol.frames.values():
        first, last = (frame.segments[0], frame.segments[-1]) if frame.segments else (None, None)
        if frame.inner or frame.name in inner or not (isinstance(first, Const) and first.data[:1] == bytes((byte,))):
            continue
        is_used = is_used or first.when is None
        if first is last or first.when or not isinstance(last, Const) or last.when or last.data != bytes((byte,)):
            what = f"'{frame.name}' begins with the delimiter {byte:02X}, and does not always end with it"
            yield Problem(frame.at, what, f"end it with {{const: {byte:02X}}}, or leave delimiter out of receiver")
        elif byte in first.data[1:] or byte in bytes_of(frame.segments[1:-1], protocol.frames):
            what = f"the delimiter {byte:02X} may stand inside '{frame.name}' too"
            yield Problem(frame.at, what, "put what stands between into a wrap that escapes it")
    if is_whole and not is_used:
        what = f"no frame begins with the delimiter {byte:02X}"
        yield Problem(protocol.receiver.delimiter_at, what, f"begin them with {{const: {byte:02X}}}, or leave it out")


def _line(protocol: Protocol) -> Iterator[Problem]:
    line = protocol.line
    at = protocol.at if line.at == NOWHERE else line.at
    if not all(1 <= speed <= MOST_SPEED for speed in (line.speed, *line.speeds)):
        yield Problem(at, f"a line speed is a number of bits a second, 1 to {MOST_SPEED}", "write 9600")
    if line.speeds and line.speed not in line.speeds:
        listed = ", ".join(map(str, line.speeds))
        yield Problem(at, f"the default speed {line.speed} is none of its choices", f"add it, or choose of {listed}")
    if line.formats and line.format not in line.formats:
        listed = ", ".join(line.formats)
        yield Problem(at, f"the default format {line.format} is none of its choices", f"add it, or choose of {listed}")
    if line.tcp is not None and not 1 <= line.tcp <= 65535:
        yield Problem(at, f"{line.tcp} is no port number", "use 1 to 65535")


def check_protocol(
    protocol: Protocol,
    broken: frozenset[str] = frozenset(),
    words_of_forms: frozenset[str] = frozenset(),
    rest: Rest | None = None,
) -> list[Problem]:
    """Return all problems of a loaded protocol, including warnings.

    `broken`: names of parts that could not be loaded; their problems have been reported, and references to them are not
    reported again. `words_of_forms`: the same for names that broken forms of addresses may define. `rest`: the good
    segments and keys of broken parts.
    """
    is_whole = not broken
    rest = Rest() if rest is None else rest
    parts_broken = broken
    broken |= words_of_forms
    problems = NameChecker(protocol, broken).check(rest)
    for partly_read in rest.frames:
        problems += check_partly_read(partly_read)
    ends = FrameEnds(protocol)
    for frame in protocol.frames.values():
        problems += check_frame(protocol, frame, ends)
    problems += check_sections(protocol, is_whole)
    problems += check_profile(protocol)
    problems += check_procedure(protocol, broken)
    problems += [*check_services(protocol, broken), *check_constructors_of(rest, protocol)]
    problems += check_commands(protocol, broken)
    problems += check_forms(protocol.addresses, protocol.areas, protocol.tables, parts_broken)
    if is_whole:
        problems += _groups(protocol)
    reported = {problem.at for problem in problems}
    is_right = is_whole and all(problem.warning for problem in problems)
    more = [*check_kinds(protocol), *((*check_parts(protocol), *check_texts(protocol)) if is_right else ())]
    return [*problems, *(problem for problem in more if problem.at not in reported)]
