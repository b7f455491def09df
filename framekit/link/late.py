"""Replies that may still come when the wait for them is over, and until when nothing else goes out (section 7).

A protocol without a number for each exchange cannot tell a late reply from the reply to the next request. So what was
asked for and has not come is counted. While it is due, no other request goes out: not before it has come, or its time,
and as much again, is over. Nothing is sent or received here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

from framekit.definition.expression import Expression, names_in
from framekit.definition.model.procedure import Role, Row, Step
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.values import FrameOf
from framekit.link.evaluate import EVALUATION_ERRORS, Evaluate, Names, bare_name, compile_optional
from framekit.link.scope import Scope

LONGEST = 60_000_000_000
"""No late reply is waited for longer than this (ns)."""

MOST_HOLDS = 5
"""A request that is held back so many times the usual time fails: frames that were not asked for come without end."""


class Replies(NamedTuple):
    """What exchanges of a role wait for. `frames`: replies that repeat no number of their request; `requests`: frames
    that services ask for those with; `waits`: how long steps wait for them.
    """

    frames: frozenset[str]
    requests: frozenset[str]
    waits: tuple[Evaluate, ...]


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

    def asked(self, frame: str, is_asking: bool) -> bool:
        """Whether a frame sent by itself has to wait; if not, and a service asks with it, its reply is due from now.

        `is_asking`: an exchange waits for its reply.
        """
        scope = self._scope
        asks = frame in self.expected.requests
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

    def came(self, frame: str) -> bool:
        """A good frame came that nothing waits for. Tells whether it is one of the replies that are due."""
        if frame not in self.expected.frames:
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
    steps = [step for sequence in protocol.called_from(run) for step in sequence.steps if step.receive]
    steps = [step for step in steps if not is_numbered(step, protocol)]
    frames = frozenset(name for step in steps for name in _waited_for(step.receive or (), protocol))
    requests = frozenset(
        row.request.frame
        for rows in protocol.services.values()
        for row in rows
        if row.request is not None and any(reply.frame and reply.frame.frame in frames for reply in row.reply)
    )
    waits = tuple(wait for step in steps if (wait := compile_optional(step.within)) is not None)
    return Replies(frames, requests, waits)


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
    for rows in protocol.services.values():
        for row in rows:
            yield from (reply.frame.frame for reply in row.reply if reply.frame is not None)
    errors = protocol.errors
    for name in () if errors is None else errors.frames:
        yield from protocol.frames_of(name)
