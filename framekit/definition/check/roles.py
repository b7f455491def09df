"""Roles, lanes and sessions: every lane has something to do, and what it runs gets what it takes."""

from __future__ import annotations

from collections.abc import Collection, Iterator

from framekit.definition.check.actions import actions_of
from framekit.definition.check.addresses import parts_in
from framekit.definition.check.known_names import OFFERED
from framekit.definition.expression.syntax import Text, walk
from framekit.definition.model.procedure import Lane, Role, Sequence, Session, Step
from framekit.definition.model.protocol import Protocol
from framekit.definition.problems import Problem, did_you_mean

LANE_KEYS = frozenset({"exchange", "listen", "at_once", "doc"})
OF_EXCHANGES = frozenset({"request", "buffer", "expected", "station"})
"""What an exchange can hand to its sequence."""


def check_roles(protocol: Protocol, broken: Collection[str]) -> Iterator[Problem]:
    """Everything wrong with the roles and sessions of a protocol."""
    for role in protocol.roles.values():
        if role.session is not None and role.session not in protocol.sessions and role.session not in broken:
            hint = did_you_mean(role.session, protocol.sessions)
            yield Problem(role.at, f"there is no session '{role.session}'", hint)
        if role.other_side is not None and role.other_side not in {*protocol.roles, *broken}:
            hint = did_you_mean(role.other_side, protocol.roles)
            yield Problem(role.at, f"there is no role '{role.other_side}'", hint)
        for lane in role.lanes:
            yield from _lane(protocol, role, lane)
    for session in protocol.sessions.values():
        yield from _session(protocol, session)
    yield from _never_run(protocol)


def _never_run(protocol: Protocol) -> Iterator[Problem]:
    """Sequences that nothing leads to. Without roles a definition is there for others to extend."""
    run = {name for role in protocol.roles.values() for lane in role.lanes for name in (*lane.exchange, lane.listen)}
    for session in protocol.sessions.values():
        run |= {*session.open, *session.close, session.keep_alive_run}
    for rows in protocol.services.values():
        for row in rows:
            nodes = walk(row.run.root) if row.run is not None else ()
            run |= {node.value for node in nodes if isinstance(node, Text)}
    for sequence in protocol.sequences.values():
        run |= {step.call.sequence for step in sequence.steps if step.call is not None}
    lanes = [lane for role in protocol.roles.values() for lane in role.lanes]
    misspelt = any(not lane.places.keys() <= LANE_KEYS for lane in lanes) or not run <= {None, *protocol.sequences}
    if not lanes or misspelt:
        return  # what is misspelt there may be what runs it
    for name, sequence in protocol.sequences.items():
        if name not in run:
            what = f"nothing runs the sequence '{name}'"
            yield Problem(sequence.at, what, "name it in a role, or drop it", warning=True)


def exchanged(protocol: Protocol) -> set[str]:
    """Sequences that exchanges run, with everything they call."""
    names = {name for role in protocol.roles.values() for lane in role.lanes for name in lane.exchange}
    while True:
        called = {
            step.call.sequence
            for name in names
            if name in protocol.sequences
            for step in protocol.sequences[name].steps
            if step.call is not None
        }
        if called <= names:
            return names
        names |= called


def _lane(protocol: Protocol, role: Role, lane: Lane) -> Iterator[Problem]:
    if not lane.exchange and lane.listen is None and lane.places.keys() <= LANE_KEYS:
        what = f"lane '{lane.name}' of role '{role.name}' does nothing"
        yield Problem(lane.at, what, "add exchange: or listen: with a sequence")
    for name in lane.exchange:
        sequence = protocol.sequences.get(name)
        known = OF_EXCHANGES | _given_by_services(protocol, name)
        for argument in sequence.takes if sequence is not None else ():
            if argument not in known:
                what = f"an exchange has no '{argument}' for '{name}'"
                yield Problem(lane.places.get("exchange", lane.at), what, "known: " + ", ".join(sorted(known)))
    if lane.listen is not None and lane.listen in lane.exchange:
        what = f"lane '{lane.name}' listens with '{lane.listen}' and runs it for exchanges too"
        yield Problem(lane.places.get("listen", lane.at), what, "make two sequences of it")
        return
    listening = protocol.sequences.get(lane.listen or "")
    if listening is not None:
        yield from _listening(lane, listening)


def _given_by_services(protocol: Protocol, sequence: str) -> set[str]:
    """The arguments that every service which runs a sequence takes, and so hands to it.

    Rows of read and write without a request hand over the names they have of the place and the data.
    """
    places = {*OFFERED, *(name for form in protocol.addresses for name in form.results)}
    places |= {part.name for form in protocol.addresses for part in parts_in(form)}
    given = [
        places
        if row.service in ("read", "write") and row.request is None
        else {argument.name for argument in row.takes}
        for rows in protocol.services.values()
        for row in rows
        if row.run is not None and any(isinstance(node, Text) and node.value == sequence for node in walk(row.run.root))
    ]
    return set.intersection(*given) if given else set()


def _listening(lane: Lane, sequence: Sequence) -> Iterator[Problem]:
    at = lane.places.get("listen", lane.at)
    if sequence.takes:
        yield Problem(at, f"nobody gives '{sequence.name}' its '{sequence.takes[0]}' here", "let it take nothing")
    if not any(_pauses(step) for step in sequence.steps):
        what = f"'{sequence.name}' waits for nothing, so it would run round for ever"
        yield Problem(at, what, "let a step of it receive")


def _pauses(step: Step) -> bool:
    timed = (step.receive, step.wait, step.hold_break, step.call, step.ask)
    return any(part is not None for part in timed) or any(action.send is not None for action in actions_of(step))


def _session(protocol: Protocol, session: Session) -> Iterator[Problem]:
    if session.reconnect and protocol.line.kind != "stream":
        what = f"session '{session.name}' cannot be connected again on a serial line"
        yield Problem(session.at, what, "leave reconnect out, or write line: {kind: stream}")
    for name in (*session.open, *session.close, session.keep_alive_run):
        sequence = protocol.sequences.get(name or "")
        if sequence is not None and set(sequence.takes) - OF_EXCHANGES:
            argument = min(set(sequence.takes) - OF_EXCHANGES)
            yield Problem(session.at, f"nobody gives '{name}' its '{argument}' here", "let it take nothing")
