"""A protocol file of EPICS StreamDevice as a definition: frames, a service for each protocol, and the omitted parts.

A protocol of one `out` and one `in` becomes a request and its reply, which a simulated device answers too; others
become sequences of the client. Texts of the file are written to the definition as quoted text, hex bytes, or names made
of letters, digits and `_`. `stream_file.py` reads the file, `stream_body.py` makes the bodies of frames.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from framekit.definition.check.protocol import RESERVED
from framekit.definition.imported import ImportedDefinition
from framekit.definition.problems import CannotSayError, DefinitionError, Position, Problem
from framekit.definition.written import comment, flow, yaml_lines
from framekit.extras.streamdevice.stream_body import HEARD, StreamBody, StreamValue, body_of
from framekit.extras.streamdevice.stream_file import (
    StreamCommand,
    StreamProtocol,
    StreamSettings,
    named,
    read_stream_file,
)

ALIKE = 200
"""Largest number of requests with the same first bytes that a simulated device answers: a definition has a limit of its
own.
"""
FIRST = 6
"""Number of first bytes by which a receiver distinguishes frames."""

_TIMES = range(10, 60_001)
"""Range of the parameter `reply_timeout` (ms)."""
_TAKEN = RESERVED | {
    "if", "else", "or", "and", "not", "in", "never", "retries", "reply_timeout", "byte_timeout", "late_reply",
    "answer_delay",
}  # fmt: skip
"""Names that have another meaning in services and sequences."""
_SERVICES = frozenset({"answer", "request", "reply", "read", "write"})


def from_streamdevice(text: str, file: str, name: str) -> ImportedDefinition:
    """Return the definition of a protocol file. `name`: of the protocol. Raises DefinitionError for an invalid file."""
    found = read_stream_file(text, file)
    writer = _StreamWriter(name, found.left_out)
    for protocol in found.protocols:
        writer.add(protocol)
    if not writer.frames:
        problems = writer.left_out or [
            Problem(Position(file, 1, 1), "no protocol sends or takes anything", "write out")
        ]
        raise DefinitionError(problems)
    lines = [
        comment("Made of a protocol file of StreamDevice. It says nothing of speed and format: add them to line."),
        *yaml_lines(writer.definition(), compact=True),
    ]
    return ImportedDefinition("\n".join(lines) + "\n", tuple(sorted({*writer.left_out, *writer.heard()})))


class _Times(NamedTuple):
    """Time limits (ms): for the first byte of a reply, and between its bytes."""

    reply: int
    byte: int


@dataclass(slots=True)
class _MadeFrame:
    """A frame of the definition. `is_request`: whether a simulated device answers it; `side`: its sender otherwise."""

    name: str
    body: StreamBody
    side: str
    echo: tuple[str, ...] = ()
    is_request: bool = False


class _Step(NamedTuple):
    """A command as a step; without a frame it waits."""

    command: StreamCommand
    frame: _MadeFrame | None


@dataclass(slots=True)
class _MadeService:
    """A service. `is_pair`: whether it has one request and one reply."""

    name: str
    steps: list[_Step]
    times: _Times
    is_pair: bool


@dataclass(slots=True)
class _FreeNames:
    """Unique names: equal names get numbers."""

    used: set[str] = field(default_factory=set)
    counts: Counter[str] = field(default_factory=Counter)

    def unused(self, name: str) -> str:
        found = name
        while found in self.used:
            self.counts[name] += 1
            found = f"{name}_{self.counts[name] + 1}"
        self.used.add(found)
        return found


class _StreamWriter:
    """Collects frames and services, then writes the definition."""

    def __init__(self, name: str, left_out: Sequence[Problem]) -> None:
        self.left_out = list(left_out)
        self.frames: dict[str, _MadeFrame] = {}
        self._name = name
        self._services: list[_MadeService] = []
        self._service_names = _FreeNames(set(_SERVICES))
        self._frame_names = _FreeNames()
        self._narrower: dict[str, list[Position]] = {}
        self._without_end: list[Position] = []

    # ---- protocols ----------------------------------------------------------------------------------------

    def add(self, protocol: StreamProtocol) -> None:
        name = re.sub(r"[^A-Za-z0-9_]", "_", protocol.name[:64])
        if re.fullmatch(r"exchange(_\d+)*", name):
            name = f"{name}_p"
        self._service(protocol, protocol.commands, protocol.at, self._service_names.unused(name))
        if protocol.init_at is not None and protocol.init:
            init = self._service_names.unused(f"{name}_init")
            if self._service(protocol, protocol.init, protocol.init_at, init):
                what = f"the handler @init is the service '{init}', which nothing calls by itself"
                todo = "call it where a run begins, or leave it"
                self.left_out.append(Problem(protocol.init_at, what, todo, warning=True))

    def _service(self, protocol: StreamProtocol, commands: Sequence[StreamCommand], at: Position, name: str) -> bool:
        """Add a protocol, or its handler, as a service; return whether that was possible.

        The reason of a failure is noted.
        """
        before = len(self.left_out)
        bodies: list[StreamBody | None] = []
        for command in commands:
            try:
                bodies.append(None if command.word == "wait" else self._body(command, protocol.settings))
            except CannotSayError as error:
                one = error.problem
                self.left_out.append(Problem(one.at, f"{one.what}: {named(protocol.name)} is left out", one.todo))
        if len(self.left_out) > before:
            return False
        words = [command.word for command in commands]
        if not {"in", "out"} & set(words):
            self.left_out.append(
                Problem(at, f"{named(protocol.name)} sends and takes nothing: it is left out", "write out")
            )
            return False
        asked: set[int] = set()
        for command, body in zip(commands, bodies, strict=True):
            if body is not None and command.word == "out":
                asked = set(body.arguments)
            elif body is not None and not set(body.arguments) <= asked:
                what = f"an argument is taken that nothing before sends: {named(protocol.name)} is left out"
                self.left_out.append(Problem(command.at, what, "write the reply by hand"))
                return False
        is_pair = words == ["out", "in"]
        numbers: Counter[str] = Counter()
        steps: list[_Step] = []
        for command, body in zip(commands, bodies, strict=True):
            numbers[command.word] += 1
            frame = None
            if body is not None:
                number = f"_{numbers[command.word]}" if numbers[command.word] > 1 else ""
                frame = self._frame(f"{name}_{command.word}{number}", body, command.word)
                frame.is_request |= is_pair and command.word == "out"
            steps.append(_Step(command, frame))
        times = _Times(protocol.settings.reply_timeout, protocol.settings.read_timeout)
        self._services.append(_MadeService(name, steps, times, is_pair))
        return True

    def _body(self, command: StreamCommand, settings: StreamSettings) -> StreamBody:
        reads = command.word == "in"
        body = body_of(command.elements, settings, reads, command.at)
        if (settings.in_terminator if reads else settings.out_terminator) is None:
            self._without_end.append(command.at)
        for kind, at in body.narrower:
            self._narrower.setdefault(kind, []).append(at)
        return body

    def _frame(self, name: str, body: StreamBody, word: str) -> _MadeFrame:
        """Return the frame of this body; equal bytes give the same frame."""
        key = f"{word} {flow(body.segments)}"
        if key not in self.frames:
            side = "client" if word == "out" else "server"
            echo = tuple(f"arg_{number}" for number in body.arguments) if word == "in" else ()
            self.frames[key] = _MadeFrame(self._frame_names.unused(name), body, side, echo)
        return self.frames[key]

    def heard(self) -> Iterator[Problem]:
        """Yield the forms that StreamDevice accepts and frames do not: the first place of each, and their number."""
        for kind, places in self._narrower.items():
            what, todo = HEARD[kind]
            yield Problem(min(places), what + _more(places), todo, warning=True)
        if self._without_end:
            what = f"no terminator is set for this command{_more(self._without_end)}: the IOC may set one for the port"
            yield Problem(min(self._without_end), what, "write Terminator = …; at the head of the file", warning=True)

    # ---- the definition -----------------------------------------------------------------------------------

    def definition(self) -> dict[str, Any]:
        self._choose_requests()
        served = any(frame.is_request for frame in self.frames.values())
        times = Counter(one.times for one in self._services if one.is_pair == served)
        usual = times.most_common(1)[0][0] if times else _Times(1000, 100)
        services = dict(self._service_rows(usual))
        sequences = dict(self._sequences(usual))
        exchanges = list(sequences)
        checks = {name: code for frame in self.frames.values() for name, code in frame.body.checks.items()}
        found: dict[str, Any] = {"protocol": self._name}
        if served:
            found |= {
                "extends": "standard",
                "station": {"type": "none"},
                "params": {
                    **({"reply_timeout": {"default": f"{usual.reply} ms"}} if usual.reply in _TIMES else {}),
                    "byte_timeout": {"default": f"{usual.byte} ms"},
                    "retries": {"default": 0},
                },
                "groups": {"request": {"from": "client"}},
            }
        else:
            found |= {
                "station": {"type": "none"},
                "params": {
                    "reply_timeout": {"type": "time", "default": f"{usual.reply} ms"},
                    "byte_timeout": {"type": "time", "default": f"{usual.byte} ms"},
                },
                "line": {"late": "reply_timeout"},
                "receiver": {"gap": "byte_timeout", "resync": "next_start"},
            }
        if checks:
            found["checks"] = checks
        found["frames"] = dict(self._frames_in_order())
        found["services"] = services
        if sequences:
            found["sequences"] = sequences
        found["roles"] = {"client": {"lanes": {"main": {"exchange": exchanges}}}}
        return found

    def _choose_requests(self) -> None:
        """Select the requests that a device can distinguish by their first bytes; only a client sends the others.

        Constant requests come first, then those with more constant bytes.
        """
        requests = [frame for frame in self.frames.values() if frame.is_request]
        requests.sort(key=lambda frame: (frame.body.varies, -len(frame.body.before)))
        beginnings: set[bytes] = set()
        whole: set[bytes] = set()
        alike: Counter[bytes] = Counter()
        for frame in requests:
            before = frame.body.before[:_LONGEST]
            fits = before not in beginnings and not any(before[:size] in whole for size in range(len(before) + 1))
            fits = fits and alike[before[:FIRST]] < ALIKE
            frame.is_request = fits
            if fits:
                alike[before[:FIRST]] += 1
                whole.add(before)
                beginnings.update(before[:size] for size in range(len(before) + 1))

    def _frames_in_order(self) -> Iterator[tuple[str, Any]]:
        """Yield constant frames first, and a frame of text alone, which matches nearly everything, last."""

        def order(frame: _MadeFrame) -> tuple[bool, int]:
            return frame.body.varies, -sum(
                len(str(one.get("text", one.get("const", "")))) for one in frame.body.segments
            )

        for frame in sorted(self.frames.values(), key=order):
            head: dict[str, Any] = {"group": "request"} if frame.is_request else {"from": frame.side}
            if frame.echo:
                head["echo"] = list(frame.echo)
            yield frame.name, {**head, "body": frame.body.segments}

    # ---- services -----------------------------------------------------------------------------------------

    def _service_rows(self, usual: _Times) -> Iterator[tuple[str, list[Any]]]:
        asked: set[str] = set()
        for service in self._services:
            takes, gives, fills, _ = _values_of(service)
            row: dict[str, Any] = {}
            kinds = {name: {} if kind == "number" else {"type": kind} for name, kind in takes.items()}
            if kinds:
                row["takes"] = kinds
            if not service.is_pair:
                row |= {"run": quoted_name(service.name), "client_only": True}
                row |= {"gives": {name: name for name in gives}} if gives else {}
                yield service.name, [row]
                continue
            (_, request), (_, reply) = service.steps
            assert request is not None and reply is not None
            row["request"] = {request.name: fills[0]}
            row["reply"] = {reply.name: {one.field: one.start for one in reply.body.values}}
            if gives:
                row["gives"] = {name: f"reply.{one.field}" for name, (_, one) in gives.items()}
            if service.times != usual:
                row["run"] = quoted_name(_exchange(service.times, usual))
            if not request.is_request or request.name in asked:
                row["client_only"] = True
            asked.add(request.name)
            yield service.name, [row]

    def _sequences(self, usual: _Times) -> Iterator[tuple[str, Any]]:
        used = {one.times for one in self._services if one.is_pair}
        for times in sorted(used, key=lambda times: (times != usual, times)):
            again = {"then": "resend", "at_most": "retries"}
            step = {
                "step": "ask",
                "send": "request",
                "receive": [{"frame": "expected", "set": {"answer": "it"}, "then": "end"}],
                **_waiting(times, usual),
            }
            step |= {key: {**again, "else": step[key]} for key in ("on_timeout", "on_bad")}
            yield (
                _exchange(times, usual),
                {"takes": ["request"], "gives": {"reply": "answer"}, "local": {"answer": "frame"}, "steps": [step]},
            )
        for service in self._services:
            if not service.is_pair:
                yield service.name, self._sequence(service, usual)

    def _sequence(self, service: _MadeService, usual: _Times) -> dict[str, Any]:
        """Return the steps of a service.

        Frames that arrive during a `wait` are not lost: the step that takes them begins before, and the wait precedes
        the next transmission.
        """
        takes, gives, fills, replies = _values_of(service)
        steps: list[dict[str, Any]] = []
        early = 0
        for number, (command, frame) in enumerate(service.steps):
            if frame is None:
                early += command.ms
                continue
            if command.word == "out":
                if early:
                    steps.append({"wait": f"{early} ms"})
                    early = 0
                steps.append({"send": {frame.name: fills[number]} if fills[number] else frame.name})
                continue
            if not steps or "send" not in steps[-1] or "receive" in steps[-1]:
                steps.append({})
            row: dict[str, Any] = {"frame": frame.name}
            if frame.echo:
                row["when"] = " and ".join(f"it.{one} == {one}" for one in frame.echo)
            if number in replies:
                row["set"] = {replies[number]: "it"}
            row["then"] = "next"
            steps[-1] |= {"receive": [row], **_waiting(service.times, usual, early)}
        if early and service.steps[-1].frame is None:
            steps.append({"wait": f"{early} ms"})
        found: dict[str, Any] = {}
        if takes:
            found["takes"] = list(takes)
        if gives:
            found["gives"] = {name: f"{replies[number]}.{one.field}" for name, (number, one) in gives.items()}
            found["local"] = dict.fromkeys(replies.values(), "frame")
        found["steps"] = [{"step": f"step_{number}", **step} for number, step in enumerate(steps, 1)]
        return found


_LONGEST = 64
"""Number of first bytes of requests that are compared."""


def quoted_name(name: str) -> str:
    """Return a name as an expression for its text."""
    return f"'{name}'"


def _argument(number: int) -> str:
    return f"arg_{number}"


def _exchange(times: _Times, usual: _Times) -> str:
    return "exchange" if times == usual else f"exchange_{times.reply}_{times.byte}"


def _waiting(times: _Times, usual: _Times, early: int = 0) -> dict[str, Any]:
    """Return the time limits of a receiving step, from `early` ms before, and the actions at their end."""
    is_usual = times == usual
    within = "reply_timeout" if is_usual and usual.reply in _TIMES else f"{max(times.reply, 1)} ms"
    return {
        "within": f"{within} + {early} ms" if early else within,
        "gap": "byte_timeout" if is_usual else f"{max(times.byte, 1)} ms",
        "on_timeout": {"fail": "no_reply"},
        "on_bad": {"fail": "damaged_reply"},
        "on_other": {"fail": "damaged_reply"},
    }


def _more(places: Sequence[Position]) -> str:
    others = len(set(places)) - 1
    return f" (and at {others} more place{'s' * (others > 1)})" if others else ""


def _values_of(
    service: _MadeService,
) -> tuple[dict[str, str], dict[str, tuple[int, StreamValue]], dict[int, dict[str, str]], dict[int, str]]:
    """Return arguments and results of a service, the fields of its frames, and the variables of its replies.

    These are: the kind of each argument by name; step and value of each result by name; the fields of the frame of each
    step; the variable that keeps the frame of each step.
    """
    names = _FreeNames()
    takes: dict[str, str] = {}
    gives: dict[str, tuple[int, StreamValue]] = {}
    fills: dict[int, dict[str, str]] = {}
    replies: dict[int, str] = {}
    for number, (command, frame) in enumerate(service.steps):
        if frame is None:
            continue
        if command.word == "out":
            fills[number] = {}
            for argument in frame.body.arguments:
                takes[_argument(argument)] = "text"
                fills[number][_argument(argument)] = _argument(argument)
            for value in frame.body.values:
                name = names.unused(_value_name(value.wanted))
                takes[name] = value.kind
                fills[number][value.field] = name
            continue
        for value in frame.body.values:
            if value.is_given:
                gives[names.unused(_value_name(value.wanted))] = number, value
                replies[number] = f"got_{number + 1}"
    return takes, gives, fills, replies


def _value_name(wanted: str) -> str:
    """Return the name of a value: the text in round brackets in the file if it is a valid name."""
    name = re.sub(r"[^a-z0-9_]+", "_", wanted[:64].lower()).strip("_")
    if not re.match(r"[a-z]", name):
        return "value"
    is_other = name in _TAKEN or re.fullmatch(r"(arg|got|exchange)_.*|.*_(in|out)(_\d+)?|.*_\d+", name)
    return f"{name}_value" if is_other else name
