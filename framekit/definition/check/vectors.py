"""Vectors held against their protocol: frames, fields, roles, services, parameters and state that there are."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping

from framekit.definition.check.kinds import KindChecker
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.sizes import field_names
from framekit.definition.model.vectors import Conversation, FrameVector, Vectors
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


class _Case:
    """One case: where its keys stand, and which names of the protocol they may have."""

    def __init__(self, at: Position, places: Mapping[str, Position]) -> None:
        self.at = at
        self.places = places

    def unknown(
        self, key: str, names: Collection[str], known: Collection[str], kind: str, whose: str = "there is"
    ) -> Iterator[Problem]:
        for name in names:
            if name not in known:
                at = self.places.get(f"{key}.{name}", self.places.get(key, self.at))
                yield Problem(at, f"{whose} no {kind} '{name}'", did_you_mean(name, known))


def _frame(vector: FrameVector, protocol: Protocol) -> Iterator[Problem]:
    case = _Case(vector.at, vector.places)
    yield from case.unknown("params", vector.params, protocol.params, "parameter")
    yield from case.unknown("state", vector.state, protocol.state, "variable")
    if vector.frame is None:
        return
    if vector.frame not in protocol.frames:
        yield from case.unknown("frame", [vector.frame], protocol.frames, "frame")
        return
    known = field_names(protocol.frames[vector.frame].segments)
    yield from case.unknown("values", vector.values or {}, known, "field", f"frame '{vector.frame}' has")


def _conversation(conversation: Conversation, protocol: Protocol) -> Iterator[Problem]:
    case = _Case(conversation.at, conversation.places)
    yield from case.unknown("params", conversation.params, protocol.params, "parameter")
    yield from case.unknown("state", conversation.state, protocol.state, "variable")
    if conversation.role is not None:
        yield from case.unknown("role", [conversation.role], protocol.roles, "role")
    checker = KindChecker({})
    for line in conversation.script:
        for time in (line.time, line.not_before, line.within):
            checker.wants(time, "time")
    yield from checker.problems
    services = [name for name in conversation.do or () if name not in BESIDE_SERVICES]
    yield from case.unknown("do", services, protocol.services, "service")
