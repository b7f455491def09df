"""Words that are names in some expressions only: which, and where they are known."""

from __future__ import annotations

from typing import Any

from framekit.definition.expression import Compare, Expression, Text, walk
from framekit.definition.kinds.base import Segment
from framekit.definition.model.frames import Frame, field_names, flat, parts_of
from framekit.definition.model.procedure import Action, Sequence

BUILT_IN = frozenset({"station", "own", "role", "line", "now", "clock"})
EXCHANGE = frozenset({"request", "reply", "buffer", "reply_buffer", "expected", "refusal"})
IN_HANDLERS = frozenset({"cause", "frame", "outcome"})
ONLY_THERE = {
    "it": "it is what a row has taken: use it in a row, or in a step behind one",
    "part": "it is the piece of a step that has parts:",
    "cause": "it is known in on_bad and other handlers",
    "frame": "it is known in on_bad and other handlers; a frame's name is it.frame",
    "outcome": "it is known in on_fail",
    "reply": "it is what serve: answers: add serve: {request: …} before",
    "index": "it is the number of an item: use it in the segments of a repeat",
    "last": "it tells whether an item is the last one: use it in the segments of a repeat",
    "previous": "it is the item before: use it in the segments of a repeat",
}
"""Words that have a value only in some places."""

OFFERED = frozenset({
    "area", "unit", "code", "start", "count", "bytes", "data", "bits", "value", "values", "text", "first", "done",
    "total", "element_bytes", "own_bytes", "spans", "old", "key", "entry",
})  # fmt: skip
IN_BLOCKS = frozenset({
    "result", "reply", "buffer", "data", "block", "outcome", "cause", "code", "ok", "refused", "status",
    "record",
})  # fmt: skip
"""What the row of a command block knows besides, and all that is done when its exchange has ended."""
OF_EVERY_FRAME = frozenset({"frame", "refusal"})


def behind_a_refusal(frame: Frame) -> set[str]:
    """Fields that a frame may lack when it is to be refused: those from its first segment with a code on."""
    segments = list(flat(frame.segments))
    place = next((place for place, segment in enumerate(segments) if segment.refuse is not None), len(segments))
    return field_names(segments[place:]) - field_names(segments[:place])


def asked_for(expression: Expression) -> set[str]:
    """Fields that an expression asks for first: `'station' in it`."""
    return {
        node.first.value
        for node in walk(expression.root)
        if isinstance(node, Compare) and isinstance(node.first, Text) and node.rest[0][0] in ("in", "not in")
    }


def takes_something(sequence: Sequence) -> bool:
    """Whether something can have arrived that `it` may stand for."""
    if sequence.always or "on_other" in sequence.handlers:
        return True
    return any(step.receive or any(action.take for action in parts_of(step, Action)) for step in sequence.steps)


def without_parts(segment: Segment) -> list[Any]:
    """What a segment says itself, without the segments it holds (they are checked on their own)."""
    parts = [
        getattr(segment, name)
        for name in segment.__dataclass_fields__
        if name not in ("of", "cases", "otherwise", "method")
    ]
    return [part for part in parts if part is not None]
