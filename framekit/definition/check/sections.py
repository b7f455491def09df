"""The small sections – parameters, state, queues, station, line: fitting defaults, types there are, one name each."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any

from framekit.definition.check.segments import constant_number
from framekit.definition.expression.syntax import Bytes, Expression, List, Name, Number, Text
from framekit.definition.model.frames import Frame
from framekit.definition.model.procedure import Sequence
from framekit.definition.model.protocol import Parameter, Protocol, Queue, StateVariable
from framekit.definition.problems import NOWHERE, Problem, did_you_mean, plural
from framekit.definition.times import format_time

RESERVED = frozenset({
    "it", "part", "request", "reply", "buffer", "reply_buffer", "expected", "own", "role", "now", "frame", "refusal",
    "station", "line", "clock", "cause", "outcome",
})  # fmt: skip
"""Words with a meaning of their own."""

PLAIN_TYPES = ("flag", "text", "bytes", "time", "list", "record", "frame", "number", "f32", "f64")
_INTEGER = re.compile(r"([ui])(8|16|24|32|40|48|56|64)")


def check_sections(protocol: Protocol) -> Iterator[Problem]:
    """Everything wrong with these sections by themselves."""
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


def _names(protocol: Protocol) -> Iterator[Problem]:
    """One name means one thing, and words with a meaning are no names."""
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
    if parameter.limits is not None and not {parameter.type, parameter.items} & {"number", "time"}:
        todo = "add of: number" if parameter.type == "list" else "leave range out, or make it a number or a time"
        yield Problem(parameter.at, f"a {parameter.type} has no range", todo)
    if parameter.type == "choice" and not parameter.choices:
        yield Problem(parameter.at, f"'{name}' has nothing to choose from", "add of: [words]")
    if default is None:
        return
    if parameter.type == "choice":
        yield from _choice(parameter, default)
    yield from _in_range(parameter, default)
    if parameter.size is not None and isinstance(default.root, Bytes) and len(default.root.value) != parameter.size:
        what = f"the default of '{name}' has {plural(len(default.root.value), 'byte')}, not {parameter.size}"
        yield Problem(default.at, what, "correct one of them")


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
        if isinstance(node, Number) and not low <= node.value <= high:
            value, least, most = (_shown(number, parameter) for number in (node.value, low, high))
            what = f"the default {value} of '{parameter.name}' is not in {least}..{most}"
            yield Problem(node.at, what, "correct one of them")


def _shown(number: int, parameter: Parameter) -> str:
    return format_time(number) if "time" in (parameter.type, parameter.items) else str(number)


def _variable(protocol: Protocol, variable: StateVariable) -> Iterator[Problem]:
    type_ = variable.type
    plain = type_ in PLAIN_TYPES or _INTEGER.fullmatch(type_)
    if variable.keys is not None and not plain and type_ not in protocol.layouts:
        what = f"there is no type or layout '{type_}' for the entries of '{variable.name}'"
        yield Problem(variable.at, what, did_you_mean(type_, [*PLAIN_TYPES, *protocol.layouts]) or "write u16, text, …")
    number = constant_number(variable.initial)
    match = _INTEGER.fullmatch(type_)
    if number is not None and match is not None and variable.initial is not None:
        bits = int(match[2])
        low, high = (0, (1 << bits) - 1) if match[1] == "u" else (-(1 << bits - 1), (1 << bits - 1) - 1)
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
    """No variable of a sequence is a frame: a bare word in `send` would mean that."""
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


def _line(protocol: Protocol) -> Iterator[Problem]:
    line = protocol.line
    at = protocol.at if line.at == NOWHERE else line.at
    if line.speed < 1 or any(speed < 1 for speed in line.speeds):
        yield Problem(at, "a line speed is a number of bits a second, 1 or more", "write 9600")
    if line.speeds and line.speed not in line.speeds:
        listed = ", ".join(map(str, line.speeds))
        yield Problem(at, f"the default speed {line.speed} is none of its choices", f"add it, or choose of {listed}")
    if line.formats and line.format not in line.formats:
        listed = ", ".join(line.formats)
        yield Problem(at, f"the default format {line.format} is none of its choices", f"add it, or choose of {listed}")
    if line.tcp is not None and not 1 <= line.tcp <= 65535:
        yield Problem(at, f"{line.tcp} is no port number", "use 1 to 65535")
