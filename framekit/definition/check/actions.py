"""Actions of steps: queues there are, words that mean something where they stand, counters that can count.

It looks at one step at a time; how steps follow each other is checked elsewhere.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping

from framekit.definition.expression.syntax import Expression, Number, Unary
from framekit.definition.model.procedure import Action, Row, Sequence, Step
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.values import FrameOf, Value
from framekit.definition.model.walk import parts_of
from framekit.definition.problems import Position, Problem, did_you_mean

WAITING = ("again", "restart", "resend")
ARRIVALS = ("on_bad", "on_other", "on_noise", "on_timeout")
"""Handlers of what only a step that receives can hear of."""

LIMITS = ("within", "complete", "gap")


def check_actions(protocol: Protocol, sequence: Sequence, broken: Collection[str]) -> list[Problem]:
    """What is wrong with the actions of a sequence, each by itself."""
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
        self.delivers = any(action.deliver is not None for action in parts_of(protocol.sequences, Action)) or any(
            step.deliver is not None for step in parts_of(protocol.sequences, Step)
        )

    def _note(self, at: Position, what: str, todo: str = "") -> None:
        self.found.append(Problem(at, what, todo))

    def step(self, step: Step) -> None:
        self._puts(step.put, step.places.get("put", step.at))
        self._sent(step.send, step.places.get("send", step.at))
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
        again = any(action.then == "resend" for action in actions_of(step))
        if step.retries is not None and step.receive is not None and not again:
            what = f"nothing in step '{step.name}' sends again: retries has no meaning"
            at = step.places["retries"]
            self.found.append(Problem(at, what, "add then: resend, for instance to on_timeout:", warning=True))

    def _handlers(self, step: Step) -> None:
        for event in step.handlers:
            at = step.places.get(event, step.at)
            if event in ARRIVALS and step.receive is None:
                self._note(at, f"{event} never comes: step '{step.name}' waits for nothing", "add receive:")
            elif event == "on_timeout" and all(getattr(step, key) is None for key in LIMITS):
                self._note(at, f"on_timeout never comes: step '{step.name}' has no time limit", "add within: TIME")
            elif event == "on_fail" and step.call is None and step.ask is None:
                self._note(at, f"on_fail never comes: step '{step.name}' calls nothing", "use on_timeout: or on_bad:")
            elif event == "on_exhausted" and not _counts(step):
                what = f"on_exhausted never comes: nothing in step '{step.name}' is counted"
                self._note(at, what, "add retries: N, or at_most: N to a row")

    def _dead(self, actions: tuple[Action, ...]) -> None:
        """Behind an action without a condition, the others of a list are never taken."""
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
        if isinstance(action, Row):
            self._row(action)

    def _row(self, row: Row) -> None:
        for key, name in (("queue", row.queue), ("room", row.room)):
            if name is not None:
                self._queue(name, row.places.get(key, row.at))
        if self.delivers:
            return
        for name in row.frames:
            frame = self.protocol.frames.get(name)
            if frame is not None and frame.inner:
                what = f"'{name}' never comes by itself: it stands inside other frames"
                self._note(row.places.get("frame", row.at), what, "wait for a frame that carries it")
                return

    def _words(self, action: Action, step: Step) -> None:
        """`again`, `restart` and `resend` need something that is waited for, and something that was sent."""
        at = action.places.get("then", action.at)
        if action.then in WAITING and step.receive is None:
            what = f"'{action.then}' has no meaning: step '{step.name}' waits for nothing"
            self._note(at, what, "name the step to go to, or next or end")
        elif action.then == "resend" and step.send is None:
            self._note(at, f"step '{step.name}' sends nothing that could be sent again", "use restart, or name a step")

    def _sent(self, value: Value | None, at: Position) -> None:
        frame = self.protocol.frames.get(value.frame) if isinstance(value, FrameOf) else None
        if frame is not None and frame.inner:
            what = f"'{frame.name}' cannot be sent by itself: it stands inside other frames"
            self._note(at, what, "send a frame that carries it")

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


def actions_of(step: Step) -> Iterator[Action]:
    """Every action of a step: rows, branches, handlers, and what they do otherwise."""
    for action in [*(step.receive or ()), *(step.branch or ())]:
        yield from with_else(action)
    for handler in step.handlers.values():
        for action in handler:
            yield from with_else(action)


def shared_actions(sequence: Sequence) -> list[Action]:
    """The actions that hold for all steps of a sequence."""
    shared: list[Action] = list(sequence.always)
    for handler in sequence.handlers.values():
        shared += handler
    return [inner for action in shared for inner in with_else(action)]


def with_else(action: Action) -> Iterator[Action]:
    """An action and those that are done when its `at_most` is used up."""
    yield action
    if action.otherwise is not None:
        yield from with_else(action.otherwise)
