"""Extract hints about fields from the conditions of a record.

A hint is a bound, a set of allowed or forbidden values, or the letters at an offset. Only simple comparisons are
analyzed; for other conditions, the strategies must try values.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

from framekit.codec.evaluate import EVALUATION_ERRORS, MissingName
from framekit.definition.expression import (
    Attribute,
    Call,
    Compare,
    Index,
    Logic,
    Name,
    Node,
    Number,
)
from framekit.definition.model.segments import Require, Segment, Value

Evaluate = Callable[[Node], Any]
_MIRRORED = {"<": ">", "<=": ">=", ">": "<", ">=": "<=", "==": "==", "!=": "!="}


@dataclass
class Hints:
    """Constraints of one field. `letters` maps an offset in the text to (allowed, forbidden) letters."""

    least: int | None = None
    most: int | None = None
    allowed: list[Any] | None = None
    denied: list[Any] = field(default_factory=list)
    letters: dict[int, tuple[list[str] | None, list[str]]] = field(default_factory=dict)

    def add(self, operator: str, value: Any) -> None:
        if operator in ("==", "in"):
            values = [value] if operator == "==" else list(value)
            self.allowed = values if self.allowed is None else [item for item in self.allowed if item in values]
        elif operator in ("!=", "not in"):
            self.denied += [value] if operator == "!=" else list(value)
        elif isinstance(value, int):
            bound = value + {"<": -1, ">": 1}.get(operator, 0)
            if operator in ("<", "<="):
                self.most = bound if self.most is None else min(self.most, bound)
            else:
                self.least = bound if self.least is None else max(self.least, bound)

    def add_letter(self, place: int, operator: str, value: Any) -> None:
        allowed, denied = self.letters.get(place, (None, []))
        values = [value] if operator in ("==", "!=") else list(value)
        if operator in ("==", "in"):
            allowed = values if allowed is None else [item for item in allowed if item in values]
        elif operator in ("!=", "not in"):
            denied = [*denied, *values]
        self.letters[place] = allowed, denied


def conditions(segments: Iterable[Segment]) -> Iterator[Node]:
    """Yield the conditions that must all be true, with `and` split into its operands."""
    for segment in segments:
        if isinstance(segment, Require):
            root = segment.condition.root
            yield from root.operands if isinstance(root, Logic) and root.operator == "and" else (root,)


def same_attributes(segments: Iterable[Segment]) -> dict[str, list[str]]:
    """Return the lists whose items must agree in an attribute: `same(list.attribute)`."""
    found: dict[str, list[str]] = {}
    for node in conditions(segments):
        match node:
            case Call(function="same", arguments=(Attribute(value=Name(name=items), name=name),)):
                found.setdefault(items, []).append(name)
    return found


def hints_of(segments: Iterable[Segment], evaluate: Evaluate) -> dict[str, Hints]:
    """Return hints by field name, if the other sides of the comparisons can be evaluated."""
    segments = tuple(segments)
    values = [segment for segment in segments if isinstance(segment, Value) and segment.build is None]
    derived = {segment.name: segment.read.root for segment in values}
    found: dict[str, Hints] = {}
    for node in conditions(segments):
        if isinstance(node, Compare):
            operands = [node.first, *(operand for _, operand in node.rest)]
            for place, (operator, _) in enumerate(node.rest):
                _note(found, derived, operands[place], operator, operands[place + 1], evaluate)
                if operator in _MIRRORED:
                    _note(found, derived, operands[place + 1], _MIRRORED[operator], operands[place], evaluate)
    return found


def _note(
    found: dict[str, Hints], derived: dict[str, Node], subject: Node, operator: str, other: Node, evaluate: Evaluate
) -> None:
    if isinstance(subject, Name):
        subject = derived.get(subject.name, subject)
    if isinstance(subject, Call) and subject.function in ("upper", "lower"):
        subject = subject.arguments[0]
    match subject:
        case Name(name=name):
            place = None
        case Index(value=Name(name=name), index=Number(value=place)):
            pass
        case _:
            return
    try:
        value = evaluate(other)
    except (MissingName, *EVALUATION_ERRORS):
        return
    hints = found.setdefault(name, Hints())
    if place is None:
        hints.add(operator, value)
    else:
        hints.add_letter(place, operator, value)
