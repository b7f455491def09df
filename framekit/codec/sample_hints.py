"""What conditions say about fields: bounds, values that are allowed or not, the letters at a place of a text.

Only plain comparisons of one field with something known are understood; samples of the rest are made and tried.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

from framekit.definition.expression.syntax import Call, Compare, Index, Logic, Name, Node, Number, Slice, Text
from framekit.definition.model.segments import Require, Segment, Value

Evaluate = Callable[[Node], Any]
"""The value of a part of an expression, or None when it cannot be told."""

_MIRRORED = {"<": ">", "<=": ">=", ">": "<", ">=": "<=", "==": "==", "!=": "!="}


@dataclass(slots=True)
class Hints:
    """What is known about one field. `letters`: place in the text → what may stand there; `rest`: from a place on."""

    least: int | None = None
    most: int | None = None
    allowed: list[Any] | None = None
    denied: list[Any] = field(default_factory=list)
    letters: dict[int, list[str]] = field(default_factory=dict)
    rest: tuple[int, str] | None = None

    def add(self, operator: str, value: Any) -> None:
        """Notes `field operator value`."""
        if operator in ("==", "in"):
            values = [value] if operator == "==" else list(value)
            self.allowed = values if self.allowed is None else [one for one in self.allowed if one in values]
        elif operator in ("!=", "not in"):
            self.denied += [value] if operator == "!=" else list(value)
        elif isinstance(value, int):
            bound = value + {"<": -1, ">": 1}.get(operator, 0)
            if operator in ("<", "<="):
                self.most = bound if self.most is None else min(self.most, bound)
            else:
                self.least = bound if self.least is None else max(self.least, bound)

    def add_letter(self, place: int, operator: str, value: Any) -> None:
        """Notes `field[place] operator value`."""
        if operator in ("==", "in"):
            values = [value] if operator == "==" else [one for one in value if isinstance(one, str)]
            before = self.letters.get(place)
            self.letters[place] = values if before is None else [one for one in before if one in values]


def hints_of(segments: Iterable[Segment], evaluate: Evaluate) -> dict[str, Hints]:
    """Hints about the fields of a record by name; what they are compared with is worked out by `evaluate`."""
    segments = tuple(segments)
    derived = {part.name: part.read.root for part in segments if isinstance(part, Value) and part.build is None}
    found: dict[str, Hints] = {}
    for node in _conditions(segments):
        _note_rest(found, node)
        if not isinstance(node, Compare):
            continue
        left = node.first
        for operator, right in node.rest:
            _note(found, derived, left, operator, right, evaluate)
            if operator in _MIRRORED:
                _note(found, derived, right, _MIRRORED[operator], left, evaluate)
            left = right
    return found


def _conditions(segments: Iterable[Segment]) -> Iterator[Node]:
    """The parts of all conditions that must each hold."""
    for segment in segments:
        if isinstance(segment, Require):
            root = segment.condition.root
            yield from root.operands if isinstance(root, Logic) and root.operator == "and" else (root,)


def _note_rest(found: dict[str, Hints], node: Node) -> None:
    """Notes `only(field[place:], letters)`."""
    match node:
        case Call(
            function="only", arguments=(Slice(value=Name(name=name), start=start, stop=None), Text(value=letters))
        ):
            place = start.value if isinstance(start, Number) else 0
            found.setdefault(name, Hints()).rest = place, letters


def _note(
    found: dict[str, Hints], derived: dict[str, Node], subject: Node, operator: str, other: Node, evaluate: Evaluate
) -> None:
    if isinstance(subject, Name):
        subject = derived.get(subject.name, subject)
    if isinstance(subject, Call) and subject.function in ("upper", "lower"):
        subject = subject.arguments[0]
    place: int | None = None
    if isinstance(subject, Index) and isinstance(subject.index, Number):
        place, subject = subject.index.value, subject.value
    if not isinstance(subject, Name):
        return
    value = evaluate(other)
    if value is None or (operator in ("in", "not in") and not hasattr(value, "__iter__")):
        return
    hints = found.setdefault(subject.name, Hints())
    if place is None:
        hints.add(operator, value)
    else:
        hints.add_letter(place, operator, value)
