"""Sequences: every step can be reached and left, waits have a limit, circles wait, nothing is said in vain."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping

from framekit.definition.check.actions import WAITING, actions_of, check_actions, shared_actions
from framekit.definition.check.roles import check_roles, exchanged
from framekit.definition.model.procedure import Action, CallOf, Sequence, Step
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.values import FrameOf
from framekit.definition.problems import Position, Problem, did_you_mean

WORDS = ("next", "end", *WAITING)


def check_procedure(protocol: Protocol, broken: Collection[str] = ()) -> list[Problem]:
    """Everything wrong with the sequences, roles and sessions of a protocol."""
    found: list[Problem] = []
    run = exchanged(protocol)
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
        """Results of a call, or of a service, that go into variables."""
        at = step.places.get("into", step.at)
        known = [*self.sequence.local, *self.sequence.takes, *self.protocol.state]
        for variable, name in into.items():
            if name not in given:
                self._note(at, f"'{giver}' gives no '{name}'", did_you_mean(name, given))
            if variable not in known and variable not in self.broken:
                self._note(at, f"there is no variable '{variable}' to set", did_you_mean(variable, known))

    def _rows(self, step: Step) -> None:
        """Behind a row that takes its frames without a condition, rows for the same frames are dead."""
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
            if row.when is None:
                taken |= set(row.frames)

    def _limits(self, step: Step) -> None:
        """A receive in an exchange must end some time; what is sent again must have a bound."""
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
        """The steps that may follow; None is the end of the sequence."""
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
            if step.name not in reached and not self.leads_astray:  # else some step is meant that is not known
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


def _calls_in_circles(protocol: Protocol) -> Iterator[Problem]:
    """One problem for every circle of calls, at the first of its sequences."""
    calls = {
        name: [step.call.sequence for step in sequence.steps if step.call is not None]
        for name, sequence in protocol.sequences.items()
    }
    told: set[str] = set()
    for name in calls:
        circle = _circle(calls, name, [])
        if circle and not told & set(circle):
            told |= set(circle)
            chain = " → ".join([*circle, name])
            what = f"sequences call each other in a circle: {chain}" if len(circle) > 1 else f"'{name}' calls itself"
            yield Problem(protocol.sequences[name].at, what, "let one of them end instead")


def _circle(calls: dict[str, list[str]], name: str, before: list[str]) -> list[str]:
    """The sequences of a circle that begins with the first of `before`, or with `name`; none if there is no such."""
    chain = [*before, name]
    for called in calls.get(name, ()):
        if called == chain[0]:
            return chain
        if called not in chain and (found := _circle(calls, called, chain)):
            return found
    return []
