"""Sequences, roles and lanes: every step can be reached and left, waits have a limit, circles wait."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from itertools import chain

from framekit.definition.check.addresses import parts_in
from framekit.definition.expression import Expression, Number, Text, Unary
from framekit.definition.kinds.base import constant_number
from framekit.definition.model.frames import parts_of
from framekit.definition.model.procedure import Action, CallOf, Lane, LineChange, Role, Row, Sequence, Session, Step
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.services import OFFERED
from framekit.definition.model.values import FrameOf, RecordOf, Value
from framekit.definition.problems import Position, Problem, did_you_mean, parted
from framekit.definition.times import MOST_SPEED, parse_format

WAITING = ("again", "restart", "resend")
ARRIVALS = ("on_bad", "on_other", "on_noise", "on_timeout")
"""Handlers of events that only a receiving step can have."""

LIMITS = ("within", "complete", "gap")


def check_actions(protocol: Protocol, sequence: Sequence, broken: Collection[str]) -> list[Problem]:
    """Return the problems of the actions of a sequence, each checked by itself."""
    checker = _ActionChecker(protocol, broken)
    for step in sequence.steps:
        checker.step(step)
    for action in shared_actions(sequence):
        checker.action(action)
    return checker.found


class _ActionChecker:
    def __init__(self, protocol: Protocol, broken: Collection[str]) -> None:
        self.protocol = protocol
        self.broken = broken
        self.found: list[Problem] = []

    def _note(self, at: Position, what: str, todo: str = "") -> None:
        self.found.append(Problem(at, what, todo))

    def step(self, step: Step) -> None:
        self._puts(step.put, step.places.get("put", step.at))
        self._sent(step.send, step.places.get("send", step.at))
        self._is_frame(step.deliver)
        if step.decode is not None and step.receive is not None:
            what = f"step '{step.name}' decodes and receives, and on_bad would mean both"
            self._note(step.decode.at, what, "put receive: into a step of its own")
        self._keys(step)
        self._handlers(step)
        if step.retries is not None:
            self._at_least_zero(step.retries, "retries")
        for action in actions_of(step):
            self.action(action)
            self._words(action, step)
        for actions in [step.branch or (), *step.handlers.values()]:
            self._dead(actions)

    # ---- keys of a step -----------------------------------------------------------------------------------

    def _keys(self, step: Step) -> None:
        for key in (*LIMITS, "retries"):
            if getattr(step, key) is not None and step.receive is None:
                self._note(
                    step.places[key], f"step '{step.name}' waits for nothing: {key} has no meaning", "add receive:"
                )
        if step.line is not None:
            self._line(step, step.line)
        again = any(action.then == "resend" for action in actions_of(step))
        if step.retries is not None and step.receive is not None and not again:
            what = f"nothing in step '{step.name}' sends again: retries has no meaning"
            at = step.places["retries"]
            self.found.append(Problem(at, what, "add then: resend, for instance to on_timeout:", warning=True))

    def _line(self, step: Step, line: LineChange) -> None:
        if self.protocol.line.kind == "stream":
            what = f"step '{step.name}' changes a line that is a stream: it has no speed and no format"
            self._note(line.at, what, "leave line: out")
        speed = None if line.speed is None else constant_number(line.speed)
        if line.speed is not None and speed is not None and not 1 <= speed <= MOST_SPEED:
            self._note(line.speed.at, f"{speed} is not a line speed", f"write 1 to {MOST_SPEED} bits a second")
        if line.format is not None and isinstance(line.format.root, Text):
            try:
                parse_format(line.format.root.value, 1)
            except ValueError as error:
                self._note(line.format.at, *parted(error))

    def _handlers(self, step: Step) -> None:
        for event in step.handlers:
            at = step.places.get(event, step.at)
            if event == "on_bad" and step.decode is not None:
                continue
            if event in ARRIVALS and step.receive is None:
                self._note(at, f"{event} never comes: step '{step.name}' waits for nothing", "add receive:")
            elif event == "on_timeout" and all(getattr(step, key) is None for key in LIMITS):
                self._note(at, f"on_timeout never comes: step '{step.name}' has no time limit", "add within: TIME")
            elif event == "on_fail" and step.call is None and step.ask is None:
                self._note(at, f"on_fail never comes: step '{step.name}' calls nothing", "use on_timeout: or on_bad:")
            elif event == "on_held" and self.protocol.line.clear_time is None:
                self._note(at, "on_held never comes: the line has no clear_time", "add clear_time: TIME to line:")
            elif event == "on_exhausted" and not _counts(step):
                what = f"on_exhausted never comes: nothing in step '{step.name}' is counted"
                self._note(at, what, "add retries: N, or at_most: N to a row")

    def _dead(self, actions: tuple[Action, ...]) -> None:
        """Note actions after an action without a condition: they are never taken."""
        for place, action in enumerate(actions[:-1]):
            if action.when is None:
                self._note(actions[place + 1].at, "this action is never taken: the one above has no condition", "")
                return

    # ---- one action ---------------------------------------------------------------------------------------

    def action(self, action: Action) -> None:
        places = action.places
        if action.because is not None and action.fail is None:
            self._note(action.because.at, "because: gives the reason of a failure", "add fail: OUTCOME")
        if action.then is not None and action.fail is not None:
            self._note(action.at, "an action goes on or fails, not both", "leave then or fail out")
        if action.otherwise is not None and action.at_most is None:
            self._note(places.get("else", action.at), "else belongs to at_most", "add at_most: N")
        if action.at_most is not None:
            self._at_least_zero(action.at_most, "at_most")
        if action.take is not None:
            self._queue(action.take, places.get("take", action.at))
        self._puts(action.put, places.get("put", action.at))
        self._sent(action.send, places.get("send", action.at))
        self._is_frame(action.deliver)
        if isinstance(action, Row):
            self._row(action)

    def _row(self, row: Row) -> None:
        for key, name in (("queue", row.queue), ("room", row.room)):
            if name is not None:
                self._queue(name, row.places.get(key, row.at))
        for name in row.frames:
            frame = self.protocol.frames.get(name)
            if frame is not None and frame.inner and not self.protocol.delivers:
                what = f"'{name}' never comes by itself: it stands inside other frames"
                self._note(row.places.get("frame", row.at), what, "wait for a frame that carries it")
                return

    def _words(self, action: Action, step: Step) -> None:
        """Note `again`, `restart` and `resend` in steps that do not receive, or have not sent anything."""
        at = action.places.get("then", action.at)
        if action.then in WAITING and step.receive is None:
            what = f"'{action.then}' has no meaning: step '{step.name}' waits for nothing"
            self._note(at, what, "name the step to go to, or next or end")
        elif action.then == "resend" and step.send is None:
            self._note(at, f"step '{step.name}' sends nothing that could be sent again", "use restart, or name a step")
        elif action.then == "resend" and step.line is not None:
            what = f"what step '{step.name}' sends again would go out with the line changed"
            self._note(at, what, "put line: and receive: into a step of their own, and name the step that sends")

    def _sent(self, value: Value | None, at: Position) -> None:
        self._is_frame(value)
        frame = self.protocol.frames.get(value.frame) if isinstance(value, FrameOf) else None
        if frame is not None and frame.inner:
            what = f"'{frame.name}' cannot be sent by itself: it stands inside other frames"
            self._note(at, what, "send a frame that carries it")

    def _is_frame(self, value: Value | None) -> None:
        """Note a sent or delivered value that is no frame; the kind of expressions is checked elsewhere."""
        if value is None or isinstance(value, (Expression, FrameOf)):
            return
        name = next(iter(value.fields), "") if isinstance(value, RecordOf) and len(value.fields) == 1 else ""
        if name in self.protocol.frames:
            what = f"the frame '{name}' is made of its fields, not of bytes"
            self._note(value.at, what, f"write {{{name}: {{field: value}}}}")
        elif name not in self.broken:
            hint = did_you_mean(name, self.protocol.frames) if name and isinstance(value, RecordOf) else ""
            todo = hint or "write the name of a frame, a variable, or {FRAME: {field: value}}"
            self._note(value.at, "this is no frame, and only a frame can be sent or delivered", todo)

    def _at_least_zero(self, expression: Expression, key: str) -> None:
        if _is_negative(expression):
            self._note(expression.at, f"{key} is a number of times, {expression} is none", "use 0 or more")

    # ---- queues -------------------------------------------------------------------------------------------

    def _queue(self, name: str, at: Position) -> bool:
        known = self.protocol.queues
        if name not in known and name not in self.broken:
            self._note(at, f"there is no queue '{name}'", did_you_mean(name, known) or f"add {name}: to queues")
        return name in known

    def _puts(self, puts: tuple[tuple[str, Mapping[str, Value]], ...], at: Position) -> None:
        for name, fields in puts:
            if not self._queue(name, at):
                continue
            holds = self.protocol.queues[name].holds
            for field, value in fields.items():
                if field not in holds:
                    self._note(value.at, f"an item of queue '{name}' has no '{field}'", did_you_mean(field, holds))
            for field in holds:
                if field not in fields:
                    self._note(at, f"'{field}' is missing in the item for queue '{name}'", f"add {field}:")


def _counts(step: Step) -> bool:
    return step.retries is not None or any(
        action.at_most is not None and action.otherwise is None for action in actions_of(step)
    )


def _is_negative(expression: Expression) -> bool:
    match expression.root:
        case Unary(operator="-", operand=Number(value=value)):
            return value > 0
        case Number(value=value):
            return value < 0
    return False


def actions_of(*holders: object) -> Iterator[Action]:
    """Yield every action of a step or of its parts: rows, branches, handlers, and their `else`."""
    return parts_of(holders, Action)


def shared_actions(sequence: Sequence) -> Iterator[Action]:
    """Return the actions that apply to all steps of a sequence."""
    return actions_of(sequence.always, dict(sequence.handlers))


LANE_KEYS = frozenset({"exchange", "listen", "at_once", "doc"})
OF_EXCHANGES = frozenset({"request", "buffer", "expected", "station"})
"""Arguments that an exchange can pass to its sequence."""


def check_roles(protocol: Protocol, broken: Collection[str]) -> Iterator[Problem]:
    """Report all problems of the roles and sessions of a protocol."""
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
    """Report sequences that are never run. A definition without roles exists to be extended, and is not checked."""
    run = {name for lane in protocol.lanes for name in (*lane.exchange, lane.listen)}
    for session in protocol.sessions.values():
        run |= {*session.open, *session.close, session.keep_alive_run}
    for row in protocol.service_rows:
        run |= row.sequences
    for sequence in protocol.sequences.values():
        run |= {step.call.sequence for step in sequence.steps if step.call is not None}
    misspelt = any(not lane.places.keys() <= LANE_KEYS for lane in protocol.lanes)
    if not protocol.lanes or misspelt or not run <= {None, *protocol.sequences}:
        return  # a misspelt key there may be the one that runs it
    for name, sequence in protocol.sequences.items():
        if name not in run:
            what = f"nothing runs the sequence '{name}'"
            yield Problem(sequence.at, what, "name it in a role, or drop it", warning=True)


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
    """Return the arguments that every service with this sequence takes, and so passes to it.

    Rows of read and write without a request pass their names of the place and the data.
    """
    places = {*OFFERED, *(name for form in protocol.addresses for name in form.results)}
    places |= {part.name for form in protocol.addresses for part in parts_in(form)}
    given = [
        places
        if row.service in ("read", "write") and row.request is None
        else {argument.name for argument in row.takes}
        for row in protocol.service_rows
        if sequence in row.sequences
    ]
    return set.intersection(*given) if given else set()


def _listening(lane: Lane, sequence: Sequence) -> Iterator[Problem]:
    at = lane.places.get("listen", lane.at)
    if sequence.takes:
        what = f"'{sequence.name}' takes '{sequence.takes[0]}', and a lane that listens gives it nothing"
        yield Problem(at, what, "let it take nothing")
    if not any(waits(step, sending=False) for step in sequence.steps):
        what = f"'{sequence.name}' waits for nothing, so it would run round for ever"
        yield Problem(at, what, "let a step of it receive")


def _session(protocol: Protocol, session: Session) -> Iterator[Problem]:
    if session.reconnect and protocol.line.kind != "stream":
        what = f"session '{session.name}' cannot be connected again on a serial line"
        yield Problem(session.at, what, "leave reconnect out, or write line: {kind: stream}")
    for name in (*session.open, *session.close, session.keep_alive_run):
        sequence = protocol.sequences.get(name or "")
        if sequence is not None and set(sequence.takes) - OF_EXCHANGES:
            argument = min(set(sequence.takes) - OF_EXCHANGES)
            yield Problem(
                session.at, f"'{name}' takes '{argument}', which a session does not give", "let it take nothing"
            )


WORDS = ("next", "end", *WAITING)


def check_procedure(protocol: Protocol, broken: Collection[str] = ()) -> list[Problem]:
    """Return all problems of the sequences, roles and sessions of a protocol."""
    found: list[Problem] = []
    run = {sequence.name for sequence in protocol.called_from(protocol.exchanged)}
    for sequence in protocol.sequences.values():
        found += _SequenceChecker(protocol, sequence, run, broken).check()
        found += check_actions(protocol, sequence, broken)
    return [*found, *_calls_in_circles(protocol), *check_roles(protocol, broken)]


class _SequenceChecker:
    def __init__(self, protocol: Protocol, sequence: Sequence, run: set[str], broken: Collection[str]) -> None:
        self.protocol = protocol
        self.sequence = sequence
        self.is_exchange = sequence.name in run
        self.broken = broken
        self.names = [step.name for step in sequence.steps]
        self.leads_astray = False
        self.found: list[Problem] = []

    def check(self) -> list[Problem]:
        for name in sorted({name for name in self.names if self.names.count(name) > 1}):
            again = [step for step in self.sequence.steps if step.name == name][1]
            self._note(again.at, f"there are two steps '{name}' in '{self.sequence.name}'", "give one another name")
        for step in self.sequence.steps:
            self._step(step)
        for action in shared_actions(self.sequence):
            self._word(action.then, action.places.get("then", action.at))
        if self.sequence.name not in self.broken:
            self._reachable()
            self._circles()
        return self.found

    def _note(self, at: Position, what: str, todo: str = "") -> None:
        self.found.append(Problem(at, what, todo))

    # ---- one step -----------------------------------------------------------------------------------------

    def _step(self, step: Step) -> None:
        at = step.places.get("then", step.at)
        if step.then in WAITING:
            self._note(at, f"'{step.then}' is no step to go to", "it stands in rows and handlers")
        else:
            self._word(step.then, at)
        alone = step.call is not None or step.ask is not None
        if alone and (step.send is not None or step.receive is not None or step.branch is not None):
            what = f"step '{step.name}' calls and does something on the line"
            self._note(step.at, what, "put send, receive and branch into a step of their own")
        if step.call is not None:
            self._call(step, step.call)
        if step.ask is not None:
            self._ask(step, step.ask)
        if step.decode is not None:
            self._variable(step.decode.into, step.decode.at)
            self._takes_frame(step.decode.into, step.decode.at)
            if not step.decode.frames and not self.broken:
                self._note(step.decode.at, "this names no frame that the bytes could be", "name frames or groups")
        if "into" in step.places and not alone:
            self._note(step.places["into"], "nothing here has results", "into: stands in a step with call: or ask:")
        for action in actions_of(step):
            self._word(action.then, action.places.get("then", action.at))
        if self.sequence.name not in self.broken:
            self._rows(step)
            self._limits(step)

    def _call(self, step: Step, call: CallOf) -> None:
        at = step.places.get("call", step.at)
        called = self.protocol.sequences.get(call.sequence)
        if called is None:
            if call.sequence not in self.broken:
                hint = did_you_mean(call.sequence, self.protocol.sequences)
                self._note(at, f"there is no sequence '{call.sequence}' to call", hint)
            return
        for name, value in call.arguments.items():
            if name not in called.takes:
                self._note(value.at, f"'{called.name}' takes no '{name}'", did_you_mean(name, called.takes))
        for name in called.takes:
            if name not in call.arguments:
                self._note(at, f"'{called.name}' is called without '{name}'", f"add {name}: to with")
        self._into(step, call.into, called.name, called.gives)

    def _ask(self, step: Step, ask: FrameOf) -> None:
        rows = self.protocol.services.get(ask.frame)
        if rows is None:
            hint = did_you_mean(ask.frame, self.protocol.services)
            self._note(ask.at, f"there is no service '{ask.frame}' to ask", hint)
            return
        taken = {argument.name for row in rows for argument in row.takes}
        for name, value in ask.fields.items():
            if name not in taken:
                self._note(value.at, f"'{ask.frame}' takes no '{name}'", did_you_mean(name, taken))
        given = [name for name in rows[0].gives if all(name in row.gives for row in rows)] if rows else []
        self._into(step, step.ask_into, ask.frame, given)

    def _into(self, step: Step, into: Mapping[str, str], giver: str, given: Collection[str]) -> None:
        """Note unknown results of a call or a service, and unknown variables that they are stored in."""
        at = step.places.get("into", step.at)
        for variable, name in into.items():
            if name not in given:
                self._note(at, f"'{giver}' gives no '{name}'", did_you_mean(name, given))
            self._variable(variable, at)

    def _takes_frame(self, name: str, at: Position) -> None:
        """Note a variable for the result of `decode` that is not of type frame."""
        variable = self.protocol.state.get(name)
        type_ = self.sequence.local.get(name) or ("frame" if variable is None else variable.type)
        if name not in self.sequence.takes and type_ != "frame":
            self._note(at, f"decode gives a frame, and '{name}' is of type {type_}", "give a variable of type frame")

    def _variable(self, name: str, at: Position) -> None:
        """Note a variable to be set that does not exist."""
        known = [*self.sequence.local, *self.sequence.takes, *self.protocol.state]
        if name not in known and name not in self.broken:
            self._note(at, f"there is no variable '{name}' to set", did_you_mean(name, known))

    def _rows(self, step: Step) -> None:
        """Note rows that are never reached because an earlier row takes the same frames without a condition."""
        taken: set[str] = set()
        for row in step.receive or ():
            if row.expected and not self.is_exchange and self.protocol.roles:
                what = f"nothing is expected here: no service runs '{self.sequence.name}'"
                self._note(row.places.get("frame", row.at), what, "name the frames, or make it an exchange of a role")
            if row.frames and set(row.frames) <= taken and not row.expected:
                names = ", ".join(row.frames[:3])
                self._note(
                    row.at, f"this row is never reached: a row above takes every {names}", "move it up, or drop it"
                )
            if row.when is None and row.station is None:
                taken |= set(row.frames)

    def _limits(self, step: Step) -> None:
        """Note a receive of an exchange without a time limit, and repetitions without a bound."""
        if step.receive and step.within is None and self.is_exchange:
            rows = [row for row in step.receive if row.queue is None]
            if rows:
                self._note(step.at, f"step '{step.name}' may wait for ever", "add within: TIME and on_timeout:")
        bounded = step.retries is not None
        for action in actions_of(step):
            if action.then == "resend" and action.at_most is None and not bounded:
                at = action.places.get("then", action.at)
                self._note(at, f"step '{step.name}' may send again for ever", "add at_most: N or retries: N")

    # ---- where actions lead -------------------------------------------------------------------------------

    def _word(self, word: str | None, at: Position) -> None:
        if word is None or word in WORDS or word in self.names:
            return
        hint = did_you_mean(word, [*self.names, *WORDS])
        self.leads_astray = True
        self._note(at, f"there is no step '{word}' in '{self.sequence.name}'", hint)

    def _targets(self, step: Step) -> set[str | None]:
        """Return the steps that may follow; None is the end of the sequence."""
        following: set[str | None] = set()
        words = {action.then for action in actions_of(step) if action.then is not None}
        if self._falls_through(step):
            words.add(step.then)
        if step.when is not None:
            words.add("next")
        for word in words | {action.then for action in shared_actions(self.sequence) if action.then is not None}:
            if word == "end":
                following.add(None)
            elif word == "next":
                place = self.names.index(step.name) + 1
                following.add(self.names[place] if place < len(self.names) else None)
            elif word in self.names:
                following.add(word)
        return following

    @staticmethod
    def _falls_through(step: Step) -> bool:
        """Return whether `then` of the step itself can apply."""
        if step.receive is None and step.branch is None:
            return True
        actions = (*(step.receive or ()), *(step.branch or ()), *chain(*step.handlers.values()))
        return any(action.then is None and action.fail is None for action in actions)

    def _reachable(self) -> None:
        by_name = {step.name: step for step in self.sequence.steps}
        reached: set[str | None] = set()
        ahead: list[str | None] = [self.names[0]]
        while ahead:
            name = ahead.pop()
            if name in reached or name is None:
                continue
            reached.add(name)
            ahead.extend(self._targets(by_name[name]))
        for step in self.sequence.steps:
            if step.name not in reached and not self.leads_astray:  # a misspelt name may mean it
                self._note(step.at, f"step '{step.name}' is never reached", "lead to it with then:, or drop it")

    def _circles(self) -> None:
        """Note circles of steps that neither wait nor change anything: they would run for ever within one moment."""
        by_name = {step.name: step for step in self.sequence.steps}
        quick = {name for name, step in by_name.items() if not waits(step) and not gets_on(step)}
        state: dict[str, int] = {}

        def visit(name: str) -> bool:
            state[name] = 1
            for target in self._targets(by_name[name]):
                if target is None or target not in quick:
                    continue
                if state.get(target) == 1 or (target not in state and visit(target)):
                    return True
            state[name] = 2
            return False

        for name in self.names:
            if name in quick and name not in state and visit(name):
                what = f"steps of '{self.sequence.name}' run in a circle without waiting, from '{name}' on"
                self._note(by_name[name].at, what, "let one of them wait or receive")
                return


def waits(step: Step, *, sending: bool = True) -> bool:
    """Return whether a step takes time or observes the line, with `sending` also by sending; calls and asks are assumed
    to.
    """
    timed = (step.wait, step.hold_break, step.receive, step.call, step.ask, step.send if sending else None)
    return any(part is not None for part in timed) or any(action.send is not None for action in actions_of(step))


def gets_on(step: Step) -> bool:
    """Return whether a step changes values that its conditions may depend on."""
    return bool(step.set) or any(action.set or action.take for action in actions_of(step))


def _calls_in_circles(protocol: Protocol) -> Iterator[Problem]:
    """Report every circle of calls, once, at the first of its sequences."""
    calls = {
        name: [step.call.sequence for step in sequence.steps if step.call is not None]
        for name, sequence in protocol.sequences.items()
    }
    reported: set[str] = set()
    for name in calls:
        circle = _circle(calls, name, [])
        if circle and not reported & set(circle):
            reported |= set(circle)
            chain = " → ".join([*circle, name])
            what = f"sequences call each other in a circle: {chain}" if len(circle) > 1 else f"'{name}' calls itself"
            yield Problem(protocol.sequences[name].at, what, "let one of them end instead")


def _circle(calls: dict[str, list[str]], name: str, before: list[str]) -> list[str]:
    """Return the sequences of a circle that begins with the first of `before`, or with `name`; an empty list if none
    exists.
    """
    chain = [*before, name]
    for called in calls.get(name, ()):
        if called == chain[0]:
            return chain
        if called not in chain and (found := _circle(calls, called, chain)):
            return found
    return []
