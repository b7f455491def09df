"""Names of numbers, resolved all over a definition: each field's names narrowed to the frames that are meant.

`it` of a row means its frames, `request` and `reply` of a service row the frames it sends and takes. What resolving
one expression means is in `named`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TypeVar

from framekit.definition.expression.syntax import Attribute, Name, Node
from framekit.definition.load.named import numbers_by_name, resolve_names
from framekit.definition.load.reader import Reader
from framekit.definition.model.frames import Frame
from framekit.definition.model.procedure import Row, Sequence
from framekit.definition.model.protocol import StateVariable
from framekit.definition.model.segments import Bits, Field, Segment
from framekit.definition.model.services import ServiceRow
from framekit.definition.model.walk import flat

T = TypeVar("T")


class NumberNames:
    """Resolves the names of numbers, narrowed to the frames in question."""

    def __init__(self, reader: Reader, frames: Mapping[str, Frame], state: Mapping[str, StateVariable]) -> None:
        self.reader = reader
        self.by_frame = {name: _named_fields(frame.segments) for name, frame in frames.items()}
        everything = [item for fields in self.by_frame.values() for item in fields]
        everything += [(name, variable.values) for name, variable in state.items() if variable.values]
        self.everywhere = numbers_by_name(everything)

    def frame(self, frame: Frame) -> Frame:
        own = numbers_by_name(self.by_frame[frame.name])

        def numbers(node: Node) -> Mapping[str, int] | None:
            name = node.name if isinstance(node, (Name, Attribute)) else ""
            if isinstance(node, Name) and name in own:
                return own[name]
            return self.everywhere.get(name)

        resolved: Frame = resolve_names(self.reader, frame, numbers)
        return resolved

    def plainly(self, value: T) -> T:
        resolved: T = resolve_names(self.reader, value, self._anywhere)
        return resolved

    def _anywhere(self, node: Node) -> Mapping[str, int] | None:
        return self.everywhere.get(node.name) if isinstance(node, (Name, Attribute)) else None

    def sequence(self, sequence: Sequence) -> Sequence:
        """Rows first, with `it` narrowed to their frames; what is resolved there is a number already afterwards."""
        return self.plainly(_rows_changed(sequence, self._row))

    def _row(self, row: Row) -> Row:
        narrowed = numbers_by_name([item for name in row.frames for item in self.by_frame.get(name, ())])

        def numbers(node: Node) -> Mapping[str, int] | None:
            match node:
                case Attribute(value=Name(name="it"), name=name) if name in narrowed:
                    return narrowed[name]
            return self._anywhere(node)

        resolved: Row = resolve_names(self.reader, row, numbers)
        return resolved

    def service(self, row: ServiceRow) -> ServiceRow:
        """`request` and `reply` narrowed to the frames of the row."""
        sent = () if row.request is None else self.by_frame.get(row.request.frame, ())
        replies = [reply.frame.frame for reply in row.reply if reply.frame is not None]
        frames = {
            "request": numbers_by_name(sent),
            "reply": numbers_by_name([item for name in replies for item in self.by_frame.get(name, ())]),
        }

        def numbers(node: Node) -> Mapping[str, int] | None:
            match node:
                case Attribute(value=Name(name=("request" | "reply") as whose), name=name) if name in frames[whose]:
                    return frames[whose][name]
            return self._anywhere(node)

        resolved: ServiceRow = resolve_names(self.reader, row, numbers)
        return resolved


def _rows_changed(sequence: Sequence, change: Callable[[Row], Row]) -> Sequence:
    steps = tuple(
        step if step.receive is None else replace(step, receive=tuple(change(row) for row in step.receive))
        for step in sequence.steps
    )
    return replace(sequence, steps=steps, always=tuple(change(row) for row in sequence.always))


def _named_fields(segments: tuple[Segment, ...]) -> list[tuple[str, Mapping[int, str] | None]]:
    found: list[tuple[str, Mapping[int, str] | None]] = []
    for segment in flat(segments):
        if isinstance(segment, Field):
            found.append((segment.name, segment.values))
        elif isinstance(segment, Bits):
            found.extend((part.name, part.values) for part in segment.parts)
        found.extend(_named_fields(segment.inner_record or ()))
    return found
