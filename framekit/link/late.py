"""Replies that may still come when the wait for them is over, and until when nothing else goes out (guide: sequences).

A protocol without a number for each exchange cannot tell a late reply from the reply to the next request. So what was
asked for and has not come is counted. While it is due, no other request goes out: not before it has come, or its time,
and as much again, is over. Nothing is sent or received here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import NamedTuple

from framekit.definition.expression import Expression, names_in
from framekit.definition.model.procedure import Role, Row, Sequence, Step
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.values import FrameOf
from framekit.link.scope import Scope
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

LONGEST = 60_000_000_000
"""No late reply is waited for longer than this (ns)."""

MOST_HOLDS = 5
"""A request that is held back so many times the usual time fails: frames that were not asked for come without end."""


class Beginning(NamedTuple):
    """One of the first steps of an exchange: it sends `when` that holds, and then waits for a reply or for none."""

    when: Evaluate | None
    has_reply: bool


class Replies(NamedTuple):
    """What exchanges of a role wait for. `frames`: replies that repeat no number of their request; `requests`: frames
    that services ask for those with, or that carry these; `waits`: how long steps wait for them. `stations`: which
    fields of such a frame hold the station; `beginnings`: for each exchange its first steps that send, and whether a
    reply follows.
    """

    frames: frozenset[str]
    requests: frozenset[str]
    waits: tuple[Evaluate, ...]
    stations: Mapping[str, tuple[str, Inverse]] = {}
    beginnings: tuple[tuple[Beginning, ...], ...] = ()

    def is_broadcast(self, value: FrameValue, names: Names) -> bool:
        """Whether an exchange would send this request without waiting for a reply, as its station is everyone."""
        if value.frame not in self.stations:
            return False
        field, inverse = self.stations[value.frame]
        try:
            station = inverse.solve(value.fields[field], names)
            known = Names({"request": value, "station": station}, names)
            return bool(self.beginnings) and not any(_has_reply(steps, known) for steps in self.beginnings)
        except EVALUATION_ERRORS:
            return False


class LateReplies:
    """`due` replies may still come; requests wait until the time `until` (0: none is held back).

    `lost`: replies that were due and have not come in that time. Something on the way may keep them until the next one.
    `expected`: what exchanges of the role wait for. `within`: how long the last exchange waited for its reply. `items`
    put frames out that were sent by themselves and wait too. `by_itself`: what is due answers such a frame.
    """

    __slots__ = ("_late", "_scope", "by_itself", "due", "expected", "items", "lost", "until", "within")

    def __init__(self, protocol: Protocol, scope: Scope) -> None:
        late = protocol.line.late
        self._late = compile_optional(late)
        self._scope = scope
        self.due = 0
        self.lost = 0
        self.until = 0
        self.within = 0
        self.expected = Replies(frozenset(), frozenset(), ())
        self.items: list[Callable[[], None]] = []
        self.by_itself = False

    def time(self, names: Names, within: int) -> int:
        """How long after its time, `within`, a reply may still come: as long again where the line does not say."""
        more = within
        if self._late is not None:
            try:
                more = int(self._late(names))
            except EVALUATION_ERRORS:
                more = within
        return min(max(0, more), LONGEST)

    def missed(self, names: Names, started: int, within: int) -> None:
        """A wait that began at `started` is over, or its request is repeated, and no reply to it has come."""
        if self.time(names, within):
            self.due += 1
            self.by_itself = False
            self.until = max(self.until, self._scope.now)
            self.extend(names, started, within)

    def asked(self, value: FrameValue, is_asking: bool) -> bool:
        """Whether a frame sent by itself has to wait; if not, and a service asks with it, its reply is due from now.

        No reply is due to a broadcast. `is_asking`: an exchange waits for its reply.
        """
        scope = self._scope
        asks = value.frame in self.expected.requests and not self.expected.is_broadcast(value, scope)
        if self.until > scope.now:
            return True
        if not asks:
            return False
        within = self.longest()
        more = self.time(scope, within)
        if more and is_asking:
            self.until = scope.now + within
            return True
        if more:
            self.clear()
            self.due, self.by_itself = 1, True
            self.extend(scope, scope.now, within)
        return False

    def longest(self) -> int:
        """The longest time that a step of the role waits for a reply, as far as that is known without an exchange."""
        found = 0
        for wait in self.expected.waits:
            try:
                found = max(found, int(wait(self._scope)))
            except EVALUATION_ERRORS:
                continue
        return found

    def extend(self, names: Names, started: int, within: int) -> None:
        """The reply to a repeated request came: that of an earlier one, or its own."""
        now = self._scope.now
        answered_by = min(max(now, started + within), now + LONGEST)
        self.until = max(self.until, answered_by + self.time(names, within))

    def came(self, frame: str, is_awaited: bool) -> bool:
        """A good frame came that no step waits for. Tells whether it is one of the replies that are due.

        `is_awaited`: such frames come by themselves too, so one that is not due holds nothing back.
        """
        if frame not in self.expected.frames or (is_awaited and not self.due):
            return False
        more = self.time(self._scope, self.within)
        if self.due == 1:
            self.due = self.until = 0
            return True
        was_due = self.due > 0
        self.due -= was_due
        if more:
            self.until = max(self.until, self._scope.now + more)
        return was_due

    def was_kept(self, frame: str, more: bool) -> bool:
        """Whether a good frame is one of the lost: one `more` came behind it. Alone it is what is waited for."""
        if frame not in self.expected.frames:
            return False
        self.lost = self.lost - 1 if more else 0
        return more

    def clear(self) -> None:
        """Nothing is due any more, or its time is over."""
        self.lost = self.due
        self.due = self.until = 0

    def forget(self) -> None:
        """The connection is gone, or new: nothing that was asked for over another one will come."""
        self.lost = self.due = self.until = 0
        self.items.clear()


def replies_of(protocol: Protocol, role: Role | None) -> Replies:
    """What exchanges of a role wait for, and what asks for it."""
    if role is None:
        return Replies(frozenset(), frozenset(), ())
    session = protocol.sessions.get(role.session or "")
    run = [name for lane in role.lanes for name in lane.exchange]
    run += () if session is None else (*session.open, *session.close)
    sequences = list(protocol.called_from(run))
    steps = [step for sequence in sequences for step in sequence.steps if step.receive]
    steps = [step for step in steps if not is_numbered(step, protocol)]
    frames = frozenset(name for step in steps for name in _waited_for(step.receive or (), protocol))
    asking = [
        row.request
        for row in protocol.service_rows
        if row.request is not None and any(reply.frame and reply.frame.frame in frames for reply in row.reply)
    ]
    asking += [carrier for one in sequences for carrier in _carriers(one, steps)]
    requests = frozenset(one.frame for one in asking)
    waits = tuple(wait for step in steps if (wait := compile_optional(step.within)) is not None)
    exchanges = [protocol.sequences[name] for lane in role.lanes for name in lane.exchange]
    beginnings = tuple(tuple(_beginnings(sequence)) for sequence in exchanges)
    return Replies(frames, requests, waits, _stations(asking), beginnings)


def _has_reply(steps: tuple[Beginning, ...], names: Names) -> bool:
    """Whether the first of these steps that is not skipped waits for a reply."""
    return next((step.has_reply for step in steps if step.when is None or step.when(names)), True)


def _beginnings(sequence: Sequence) -> Iterator[Beginning]:
    """The steps with which it can begin."""
    for number, step in enumerate(sequence.steps):
        when = compile_optional(step.when)
        yield Beginning(when, step.send is None or _waits(sequence, number))
        if when is None:
            return


def _waits(sequence: Sequence, number: int) -> bool:
    """Whether from this step on it may come to one that waits for a frame, or does what is not known here."""
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
    """The frames in which steps send the request that a sequence was given."""
    for step in sequence.steps:
        if step in steps and isinstance(step.send, FrameOf):
            values = (one for one in step.send.fields.values() if isinstance(one, Expression))
            if any(bare_name(value) in sequence.takes for value in values):
                yield step.send


def _stations(asking: list[FrameOf]) -> dict[str, tuple[str, Inverse]]:
    """The field of each request that holds the station, and how it is read from that."""
    found = {}
    for request in asking:
        for name, value in request.fields.items():
            inverse = inverse_of(value) if isinstance(value, Expression) else None
            if inverse is not None and inverse.name == "station":
                found[request.frame] = name, inverse
    return found


def is_numbered(step: Step, protocol: Protocol) -> bool:
    """Whether each reply repeats a number that the step's request gets anew every time: no other one looks like it."""
    if not isinstance(step.send, FrameOf):
        return False
    counted = {
        target.name
        for target, value in step.set
        if target.name in protocol.state and isinstance(value, Expression) and target.name in names_in(value.root)
    }
    numbers = {
        name
        for name, value in step.send.fields.items()
        if isinstance(value, Expression) and names_in(value.root) & counted
    }
    frames = _waited_for(step.receive or (), protocol)
    return bool(frames) and all(
        any(bare_name(source) in numbers for source in protocol.frames[name].echo.values()) for name in frames
    )


def _waited_for(rows: tuple[Row, ...], protocol: Protocol) -> set[str]:
    found = {name for row in rows for name in row.frames}
    return found.union(_of_services(protocol)) if any(row.expected for row in rows) else found


def _of_services(protocol: Protocol) -> Iterator[str]:
    for row in protocol.service_rows:
        yield from (reply.frame.frame for reply in row.reply if reply.frame is not None)
    errors = protocol.errors
    for name in () if errors is None else errors.frames:
        yield from protocol.frames_of(name)
