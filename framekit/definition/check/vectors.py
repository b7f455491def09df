"""Vectors held against their protocol: frames, fields, roles, services, parameters and state that there are.

Addresses are looked at elsewhere: they belong to a layer above.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import Any

from framekit.definition.check.typed import KindChecker
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.vectors import Conversation, FrameVector, Vectors
from framekit.definition.model.walk import field_names
from framekit.definition.problems import Position, Problem, did_you_mean

BESIDE_SERVICES = (
    "station", "unit", "count", "value", "values", "send", "exchange", "expected", "run",
)  # fmt: skip
"""Keys of `do` that are no service: what goes with one, and what is done instead of one."""


def check_vectors(vectors: Vectors, protocol: Protocol) -> list[Problem]:
    """Everything in the cases that names what the protocol does not have."""
    found: list[Problem] = []
    for case in vectors.frames:
        found += _frame(case, protocol)
    for conversation in vectors.conversations:
        found += _conversation(conversation, protocol)
    return found


class _CaseCheck:
    """One case: where its keys stand, and which names of the protocol they may have."""

    def __init__(self, at: Position, places: Mapping[str, Position]) -> None:
        self.at = at
        self.places = places

    def unknown(
        self, key: str, names: Collection[str], known: Collection[str], kind: str, whose: str = "there is"
    ) -> Iterator[Problem]:
        for name in names:
            if name not in known:
                at = self.places.get(f"{key}.{name}") or self.places.get(key) or self.places.get("do", self.at)
                yield Problem(at, f"{whose} no {kind} '{name}'", did_you_mean(name, known))

    def made(self, key: str, frames: Any, protocol: Protocol) -> Iterator[Problem]:
        """`{FRAME: {field: value}}`."""
        for frame, fields in frames.items() if isinstance(frames, Mapping) else ():
            yield from self.unknown(key, [frame], protocol.frames, "frame")
            if frame in protocol.frames and isinstance(fields, Mapping):
                known = field_names(protocol.frames[frame].segments)
                yield from self.unknown(key, fields, known, "field", f"frame '{frame}' has")


def _frame(vector: FrameVector, protocol: Protocol) -> Iterator[Problem]:
    case = _CaseCheck(vector.at, vector.places)
    yield from case.unknown("params", vector.params, protocol.params, "parameter")
    yield from case.unknown("state", vector.state, protocol.state, "variable")
    yield from case.made("request", vector.request, protocol)
    if vector.frame is None:
        return
    if vector.frame not in protocol.frames:
        yield from case.unknown("frame", [vector.frame], protocol.frames, "frame")
        return
    known = field_names(protocol.frames[vector.frame].segments)
    yield from case.unknown("values", vector.values or {}, known, "field", f"frame '{vector.frame}' has")


def _conversation(conversation: Conversation, protocol: Protocol) -> Iterator[Problem]:
    case = _CaseCheck(conversation.at, conversation.places)
    yield from case.unknown("params", conversation.params, protocol.params, "parameter")
    yield from case.unknown("state", conversation.state, protocol.state, "variable")
    if conversation.role is not None:
        yield from case.unknown("role", [conversation.role], protocol.roles, "role")
    checker = KindChecker({})
    for line in conversation.script:
        for time in (line.time, line.not_before, line.within):
            checker.wants(time, "time")
    yield from checker.problems
    yield from case.unknown("result", conversation.result.state, {*protocol.state, *protocol.params}, "variable")
    if conversation.do is not None:
        yield from _asked(case, conversation.do, protocol)


def _asked(case: _CaseCheck, do: Mapping[str, Any], protocol: Protocol) -> Iterator[Problem]:
    """What the tested side is to do."""
    for key in ("send", "exchange"):
        yield from case.made(f"do.{key}", do.get(key), protocol)
    expected = do.get("expected", [])
    groups = {group for frame in protocol.frames.values() for group in frame.groups}
    wanted = expected if isinstance(expected, list) else [expected]
    yield from case.unknown("do.expected", wanted, {*protocol.frames, *groups}, "frame")
    yield from case.unknown("do.run", [do["run"]] if "run" in do else [], protocol.sequences, "sequence")
    services = [name for name in do if name not in BESIDE_SERVICES]
    yield from case.unknown("do", services, protocol.services, "service")
    for name in services:
        arguments = do[name]
        if name in protocol.services and name not in ("read", "write") and isinstance(arguments, Mapping):
            known = {"addresses", *(argument.name for row in protocol.services[name] for argument in row.takes)}
            yield from case.unknown(f"do.{name}", arguments, known, "argument", f"'{name}' takes")
