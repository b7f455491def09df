"""Sequences: every step can be reached and left, waits have a limit, circles wait, nothing is said in vain."""

from __future__ import annotations

from collections.abc import Collection, Iterator

from framekit.definition.model.procedure import Action, Sequence, Step
from framekit.definition.model.protocol import Protocol
from framekit.definition.problems import Position, Problem, did_you_mean

WAITING = ("again", "restart", "resend")
WORDS = ("next", "end", *WAITING)


def check_procedure(protocol: Protocol, broken: Collection[str] = ()) -> list[Problem]:
    """Everything wrong with the sequences, roles and sessions of a protocol."""
    found: list[Problem] = []
    for sequence in protocol.sequences.values():
        found += _SequenceChecker(protocol, sequence).check()
    found += _calls_in_circles(protocol)
    for role in protocol.roles.values():
        if role.session is not None and role.session not in protocol.sessions:
            hint = did_you_mean(role.session, protocol.sessions)
            found.append(Problem(role.at, f"there is no session '{role.session}'", hint))
    return found


class _SequenceChecker:
    def __init__(self, protocol: Protocol, sequence: Sequence) -> None:
        self.protocol = protocol
        self.sequence = sequence
        self.names = [step.name for step in sequence.steps]
        self.found: list[Problem] = []

    def check(self) -> list[Problem]:
        for name in sorted({name for name in self.names if self.names.count(name) > 1}):
            again = [step for step in self.sequence.steps if step.name == name][1]
            self._note(again.at, f"there are two steps '{name}' in '{self.sequence.name}'", "give one another name")
        for step in self.sequence.steps:
            self._step(step)
        for action in self._shared_actions():
            self._words(action, None)
        self._reachable()
        self._circles()
        return self.found

    def _note(self, at: Position, what: str, todo: str = "") -> None:
        self.found.append(Problem(at, what, todo))

    # ---- one step -----------------------------------------------------------------------------------------

    def _step(self, step: Step) -> None:
        self._word(step.then, step.at, None)
        alone = step.call is not None or step.ask is not None
        if alone and (step.send is not None or step.receive is not None or step.branch is not None):
            what = f"step '{step.name}' calls and does something on the line"
            self._note(step.at, what, "put send, receive and branch into a step of their own")
        if step.receive is not None and step.branch is not None:
            self._note(step.at, f"step '{step.name}' receives and branches", "make two steps of it")
        if step.call is not None:
            self._call(step)
        for action in actions_of(step):
            self._words(action, step)
        self._rows(step)
        self._limits(step)

    def _call(self, step: Step) -> None:
        assert step.call is not None
        called = self.protocol.sequences.get(step.call.sequence)
        if called is None:
            hint = did_you_mean(step.call.sequence, self.protocol.sequences)
            self._note(step.at, f"there is no sequence '{step.call.sequence}' to call", hint)
            return
        for name in step.call.arguments:
            if name not in called.takes:
                self._note(step.at, f"'{called.name}' takes no '{name}'", did_you_mean(name, called.takes))
        for name in called.takes:
            if name not in step.call.arguments:
                self._note(step.at, f"'{called.name}' is called without '{name}'", f"add {name}: to with")
        for name in step.call.into.values():
            if name not in called.gives:
                self._note(step.at, f"'{called.name}' gives no '{name}'", did_you_mean(name, called.gives))

    def _rows(self, step: Step) -> None:
        """Behind a row that takes its frames without a condition, rows for the same frames are dead."""
        taken: set[str] = set()
        for row in step.receive or ():
            if row.frames and set(row.frames) <= taken and not row.expected:
                names = ", ".join(row.frames[:3])
                self._note(
                    row.at, f"this row is never reached: a row above takes every {names}", "move it up, or drop it"
                )
            if row.when is None and row.at_most is None:
                taken |= set(row.frames)

    def _limits(self, step: Step) -> None:
        """A receive in an exchange must end some time; what is sent again must have a bound."""
        if step.receive and step.within is None and self.sequence.name in self._exchanges():
            rows = [row for row in step.receive if row.queue is None]
            if rows:
                self._note(step.at, f"step '{step.name}' may wait for ever", "add within: TIME and on_timeout:")
        bounded = step.retries is not None
        for action in actions_of(step):
            if action.then == "resend" and action.at_most is None and not bounded:
                self._note(action.at, f"step '{step.name}' may send again for ever", "add at_most: N or retries: N")

    def _exchanges(self) -> set[str]:
        """Sequences that exchanges run, with everything they call."""
        names = {name for role in self.protocol.roles.values() for lane in role.lanes for name in lane.exchange}
        while True:
            called = {
                step.call.sequence
                for name in names
                if name in self.protocol.sequences
                for step in self.protocol.sequences[name].steps
                if step.call is not None
            }
            if called <= names:
                return names
            names |= called

    # ---- where actions lead -------------------------------------------------------------------------------

    def _shared_actions(self) -> list[Action]:
        shared: list[Action] = list(self.sequence.always)
        for handler in self.sequence.handlers.values():
            shared += handler
        return [inner for action in shared for inner in with_else(action)]

    def _words(self, action: Action, step: Step | None) -> None:
        if action.then is not None:
            self._word(action.then, action.at, step)
        if action.then is not None and action.fail is not None:
            self._note(action.at, "an action goes on or fails, not both", "leave then or fail out")

    def _word(self, word: str, at: Position, step: Step | None) -> None:
        if word in WORDS or word in self.names:
            return
        hint = did_you_mean(word, [*self.names, *WORDS])
        self._note(at, f"there is no step '{word}' in '{self.sequence.name}'", hint)

    def _targets(self, step: Step) -> set[str | None]:
        """The steps that may follow; None is the end of the sequence."""
        following: set[str | None] = set()
        words = {action.then for action in actions_of(step) if action.then is not None}
        if self._falls_through(step):
            words.add(step.then)
        if step.when is not None:
            words.add("next")
        for word in words | {action.then for action in self._shared_actions() if action.then is not None}:
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
        """Whether `then` of the step itself can be taken."""
        actions: list[Action] = [*(step.receive or ()), *(step.branch or ())]
        if step.receive is None and step.branch is None:
            return True
        handlers = [action for handler in step.handlers.values() for action in handler]
        return any(action.then is None and action.fail is None for action in [*actions, *handlers])

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
            if step.name not in reached:
                self._note(step.at, f"step '{step.name}' is never reached", "lead to it with then:, or drop it")

    def _circles(self) -> None:
        """A circle of steps none of which waits or changes anything would run for ever within one moment."""
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


def waits(step: Step) -> bool:
    """Whether a step takes time or looks at the line; calls and asks are taken to."""
    timed = (step.wait, step.hold_break, step.receive, step.call, step.ask, step.send)
    return any(part is not None for part in timed) or any(action.send is not None for action in actions_of(step))


def gets_on(step: Step) -> bool:
    """Whether a step changes what its conditions may depend on."""
    return bool(step.set) or any(action.set or action.take for action in actions_of(step))


def actions_of(step: Step) -> Iterator[Action]:
    """Every action of a step: rows, branches, handlers, and what they do otherwise."""
    for action in [*(step.receive or ()), *(step.branch or ())]:
        yield from with_else(action)
    for handler in step.handlers.values():
        for action in handler:
            yield from with_else(action)


def with_else(action: Action) -> Iterator[Action]:
    """An action and those that are done when its `at_most` is used up."""
    yield action
    if action.otherwise is not None:
        yield from with_else(action.otherwise)


def _calls_in_circles(protocol: Protocol) -> Iterator[Problem]:
    calls = {
        name: {step.call.sequence for step in sequence.steps if step.call is not None}
        for name, sequence in protocol.sequences.items()
    }
    for name in calls:
        ahead, seen = list(calls[name]), set()
        while ahead:
            other = ahead.pop()
            if other == name:
                yield Problem(
                    protocol.sequences[name].at, f"'{name}' calls itself", "sequences may not call in a circle"
                )
                break
            if other not in seen:
                seen.add(other)
                ahead.extend(calls.get(other, ()))
