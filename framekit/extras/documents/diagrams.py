"""State diagrams of link procedures, as states and arrows and as Mermaid text, from the same steps that are executed.

The diagrams contain only the definition. The execution of a step is not known here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Literal, NamedTuple

from framekit.definition.expression import Expression
from framekit.definition.model.procedure import Action, Row, Sequence, Step
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.values import FrameOf, Value
from framekit.definition.problems import printable

EVENTS = {
    "on_timeout": "time is up",
    "on_bad": "bad frame",
    "on_other": "another frame",
    "on_noise": "noise",
    "on_break": "break",
    "on_closed": "closed",
    "on_held": "not clear to send",
    "on_exhausted": "retries used up",
    "on_fail": "it failed",
    "on_byte": "a byte",
}


class ArrowEnd(NamedTuple):
    """The end of an arrow: a step, the failure of the sequence with an outcome, or its good end (without a name)."""

    kind: Literal["step", "failed", "end"]
    name: str = ""


class Arrow(NamedTuple):
    """A transition of a step: event, condition and actions as a label, which may be empty, and the target."""

    label: str
    target: ArrowEnd


class DiagramState(NamedTuple):
    """A step: its name, its actions in words, and its transitions, each once."""

    name: str
    does: str
    arrows: tuple[Arrow, ...]


_Find = Callable[[str | None, str | None, str], ArrowEnd]
"""Returns the target for `then`, `fail` and the default for `then`."""

LONGEST = 60
"""Largest number of characters of a condition that are shown."""
MOST_FRAMES = 3
"""Largest number of frames of a row that are named."""


def sequence_states(sequence: Sequence) -> tuple[DiagramState, ...]:
    """Return the states of a sequence: one for each step, in order; the first one begins."""
    states = []
    for place, step in enumerate(sequence.steps):
        following = sequence.steps[place + 1].name if place + 1 < len(sequence.steps) else "end"
        arrows = dict.fromkeys(Arrow(label, target) for label, target in _arrows(sequence, step, following))
        states.append(DiagramState(step.name, _does(step), tuple(arrows)))
    return tuple(states)


def sequence_diagram(sequence: Sequence) -> str:
    """Return a Mermaid state diagram: a state for each step and failure, an arrow for each row, handler or branch."""
    states = sequence_states(sequence)
    lines = ["stateDiagram-v2", f"    [*] --> {_state(states[0].name)}"]
    failures: dict[str, None] = {}
    for state in states:
        lines.append(f"    {_state(state.name)}: {_text(state.does)}")
        for label, target in state.arrows:
            failures |= {target.name: None} if target.kind == "failed" else {}
            end = "[*]" if target.kind == "end" else _state(target.name, target.kind)
            lines.append(f"    {_state(state.name)} --> {end}" + (f": {_text(label)}" if label else ""))
    lines += [f"    {_state(name, 'failed')}: fails – {_text(name)}" for name in failures]
    lines += [f"    {_state(name, 'failed')} --> [*]" for name in failures]
    return "\n".join(dict.fromkeys(lines)) + "\n"


def diagrams(protocol: Protocol) -> str:
    """Return all link procedures of a protocol as Markdown, each with a heading, a Mermaid diagram and the roles that
    run it.
    """
    parts = [f"# Sequences of {protocol.name}\n"]
    for sequence in protocol.sequences.values():
        parts.append(f"## {sequence.name}\n\n{_run_by(protocol, sequence.name)}\n")
        parts.append(f"```mermaid\n{sequence_diagram(sequence)}```\n")
    return "\n".join(parts)


def _run_by(protocol: Protocol, name: str) -> str:
    found = []
    for role in protocol.roles.values():
        for lane in role.lanes:
            if name in lane.exchange:
                found.append(f"exchange of role {role.name}")
            if name == lane.listen:
                found.append(f"runs by itself in role {role.name}")
    for session in protocol.sessions.values():
        found += [f"opens session {session.name}"] if name in session.open else []
        found += [f"closes session {session.name}"] if name in session.close else []
        found += [f"keeps session {session.name} alive"] if name == session.keep_alive_run else []
    callers = [
        other.name
        for other in protocol.sequences.values()
        if any(step.call is not None and step.call.sequence == name for step in other.steps)
    ]
    found += [f"called by {caller}" for caller in callers]
    sentence = "; ".join(found)
    return sentence[:1].upper() + sentence[1:] + "." if sentence else "Nothing runs it."


# ---- a step -----------------------------------------------------------------------------------------------


def _does(step: Step) -> str:
    """Return the actions of a step, in a few words."""
    words = [step.name]
    if step.parts is not None:
        words.append("for each piece")
    if step.hold_break is not None:
        words.append(f"break {step.hold_break.text}")
    if step.flush:
        words.append("flush")
    if step.wait is not None:
        words.append(f"wait {step.wait.text}")
    if step.call is not None:
        words.append(f"call {step.call.sequence}")
    if step.ask is not None:
        words.append(f"ask {step.ask.frame}")
    if step.decode is not None:
        words.append(f"decode {step.decode.of.text}")
    if step.serve is not None:
        words.append("validate the request" if step.serve.check_only else "serve the request")
    words += step.more
    if step.send is not None:
        words.append(f"send {_named(step.send)}")
    if step.line is not None:
        parts = [str(one) for one in (step.line.speed, step.line.format) if one is not None]
        words.append(" ".join(["line", *(parts or ["own"])]))
    if step.receive is not None:
        words.append("receive" + (f" within {step.within.text}" if step.within is not None else ""))
    return " · ".join(words)


def _arrows(sequence: Sequence, step: Step, following: str) -> Iterator[tuple[str, ArrowEnd]]:
    """Yield label and target of each transition of a step."""

    def target(word: str | None, fail: str | None, default: str) -> ArrowEnd:
        if fail is not None:
            return ArrowEnd("failed", fail)
        word = default if word is None else word
        if word in ("again", "restart", "resend"):
            return ArrowEnd("step", step.name)
        word = following if word == "next" else word
        return ArrowEnd("end") if word == "end" else ArrowEnd("step", word)

    if step.when is not None:
        yield f"unless {_short(step.when)}", target(following, None, following)
    for row in (*(step.receive or ()), *(sequence.always if step.receive is not None else ())):
        yield from _action(row, _expected(row), "next", target)
    for action in step.branch or ():
        yield from _action(action, "", "next", target)
    if step.receive is None and step.branch is None:
        yield "", target(step.then, None, step.then)
    for name, actions in ({**sequence.handlers, **step.handlers} if _waits(step) else step.handlers).items():
        for action in actions:
            yield from _action(action, EVENTS[name], "again", target)


def _waits(step: Step) -> bool:
    return step.receive is not None or step.call is not None or step.ask is not None


def _action(action: Action, event: str, default: str, target: _Find) -> Iterator[tuple[str, ArrowEnd]]:
    words = [event] if event else []
    if action.when is not None:
        words.append(f"[{_short(action.when)}]")
    if action.at_most is not None:
        words.append(f"at most {action.at_most.text} times")
    if action.send is not None:
        words.append(f"/ send {_named(action.send)}")
    if action.then in ("restart", "resend"):
        words.append(f"/ {action.then}")
    yield " ".join(words), target(action.then, action.fail, default)
    if action.otherwise is not None:
        yield from _action(action.otherwise, f"{event} more often".strip(), default, target)


def _expected(row: Row) -> str:
    if row.queue is not None:
        return f"from {row.queue}"
    if row.room is not None:
        return f"room in {row.room}"
    if row.expected:
        return "expected reply"
    shown = row.frames if len(row.frames) <= MOST_FRAMES else row.frames[: MOST_FRAMES - 1]
    more = len(row.frames) - len(shown)
    return " or ".join(shown) + (f" or {more} more" if more else "")


# ---- words ------------------------------------------------------------------------------------------------


def _named(value: Value) -> str:
    if isinstance(value, FrameOf):
        return value.frame
    return value.text if isinstance(value, Expression) else "a frame"


def _short(expression: Expression) -> str:
    text = expression.text
    return text if len(text) <= LONGEST else text[: LONGEST - 1] + "…"


def _state(name: str, kind: str = "step") -> str:
    """Return a name for a state that is no keyword of Mermaid."""
    return f"{kind}_" + "".join(letter if letter.isalnum() or letter == "_" else "_" for letter in name)


def _text(words: str) -> str:
    """Return a label with character codes in place of the characters that have a meaning in Mermaid."""
    return "".join(f"#{ord(letter)};" if letter in '#;:"{}<>' else letter for letter in printable(words))
