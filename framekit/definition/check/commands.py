"""Command blocks: the section `commands` fits its frames, and only applications with that section start exchanges."""

from __future__ import annotations

from collections.abc import Collection, Iterator

from framekit.definition.model.commands import BlockWork, CommandRules, PlaceOf
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.segments import Inner
from framekit.definition.model.walk import parts_of
from framekit.definition.problems import Position, Problem, did_you_mean

PLACES = ("area", "memory", "code", "text")
"""The words that say which area a place is in; exactly one of them."""


def check_commands(protocol: Protocol, broken: Collection[str] = ()) -> Iterator[Problem]:
    """Everything wrong with command blocks."""
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
        for after in work.then:
            yield from _stored(after.store, after.at)


def _rules(protocol: Protocol, rules: CommandRules) -> Iterator[Problem]:
    frame = protocol.frames.get(rules.frame)
    inner = {part.name: part for part in parts_of(frame, Inner)} if frame is not None else {}
    if frame is not None and rules.request not in inner:
        hint = did_you_mean(rules.request, inner) or "give it {inner: NAME, of: GROUP}"
        yield Problem(rules.at, f"frame '{rules.frame}' carries no '{rules.request}'", hint)
    if rules.most < 1:
        yield Problem(rules.at, "a command block has no words", "give most: 1 or more")
    yield from _place(rules.at, rules.status)
    for after in rules.then:
        yield from _stored(after.store, after.at)


def _stored(place: PlaceOf | None, at: Position) -> Iterator[Problem]:
    yield from _place(at, place)
    if place is not None and "data" not in place:
        yield Problem(at, "nothing says what is stored", "add data: to store")


def _place(at: Position, place: PlaceOf | None) -> Iterator[Problem]:
    if place is None:
        return
    given = [word for word in PLACES if word in place]
    if len(given) != 1:
        yield Problem(at, "a place has exactly one of area, memory, code and text", "say which area is meant")
