"""Sizes that are known before reading: of the segments after the rest of a region, and of whole frames.

This module reads the model only. An `Evaluate` returns the value of an expression, or None if it is not known yet.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Any

from framekit.definition.expression import Expression, names_in
from framekit.definition.model.frames import Frame, flat
from framekit.definition.model.segments import (
    Bits,
    Check,
    Choose,
    Const,
    Count,
    Data,
    Field,
    FieldType,
    Inner,
    ItemEnd,
    Length,
    Nested,
    Record,
    Repeat,
    Require,
    Segment,
    Segments,
    Size,
    Skip,
    Value,
    Wrap,
    exactly,
)

Evaluate = Callable[[Expression], Any]


def nothing_known(expression: Expression) -> None:
    """The `Evaluate` before any byte is read: no expression has a value."""


def wire_size(data: Data, size: int) -> int:
    """Return the size on the wire for `size` bytes in memory."""
    if data.convert == "hex_to_ascii":
        return size * 2
    return size // 2 if data.convert == "ascii_to_hex" else size


class KnownSizes:
    """Compute sizes; `frames` are needed for segments that contain frames."""

    def __init__(self, frames: Mapping[str, Frame]) -> None:
        self.frames = frames
        self._of_frame: dict[str, int | None] = {}

    def frame(self, name: str) -> int | None:
        """Return the size of every frame of this name, or None if it varies."""
        if name not in self._of_frame:
            self._of_frame[name] = None
            self._of_frame[name] = self.of_frame(self.frames[name])
        return self._of_frame[name]

    def of_frame(self, frame: Frame) -> int | None:
        """Return the size of a frame, or of a layout made into a frame; None if it varies."""
        return frame.size or self.all(frame.segments, nothing_known)

    def all(self, segments: Iterable[Segment], evaluate: Evaluate) -> int | None:
        """Return the total size of the segments."""
        total = 0
        for segment in segments:
            size = self.of(segment, evaluate)
            if size is None:
                return None
            total += size
        return total

    def of(self, segment: Segment, evaluate: Evaluate) -> int | None:
        """Return the size of a segment; 0 if it is absent."""
        if segment.when is not None:
            present = evaluate(segment.when)
            if present is None and self.of(replace(segment, when=None), evaluate) == 0:
                return 0
            if not present:
                return None if present is None else 0
        match segment:
            case Const(data=data):
                return len(data)
            case Skip(size=size) | Check(size=size):
                return size
            case Value() | Require() | ItemEnd():
                return 0
            case Field(long=long) if long is not None:
                return None
            case Field(type=type_) | Length(type=type_) | Count(type=type_) | Bits(type=type_):
                return _number(type_.size, evaluate)
            case Data(size=size):
                number = _number(size, evaluate)
                return None if number is None else wire_size(segment, number)
            case Record(of=of):
                return self.all(of, _from_outside(of, evaluate))
        return self._with_content(segment, evaluate)

    def _with_content(self, segment: Segment, evaluate: Evaluate) -> int | None:
        match segment:
            case Repeat(times=times, of=of):
                number = _number(times, evaluate)
                item = _number(of.size, evaluate) if isinstance(of, FieldType) else self.all(of, nothing_known)
                return None if number is None or item is None else segment.filled(item, number)
            case Choose(on=on, cases=cases, otherwise=otherwise):
                value = evaluate(on)
                chosen = next((of for keys, of in cases if value in keys), otherwise)
                return None if value is None or chosen is None else self.all(chosen, evaluate)
            case Wrap(size=size) if size is not None:
                return _number(size, evaluate)
            case Wrap(coding=coding, of=of):
                content = self.all(of, evaluate)
                return None if content is None else coding.sizes(exactly(content)).fixed
            case Nested(frame=name):
                return self.frame(name)
            case Inner(size=None, frames=names):
                sizes = {self.frame(name) for name in names}
                return sizes.pop() if len(sizes) == 1 else None
            case Inner(size=size):
                return _number(size, evaluate)
        return None


def _from_outside(of: Segments, evaluate: Evaluate) -> Evaluate:
    """Restrict `evaluate` to expressions that use no value of the record itself; all others return None."""
    own = {name for segment in flat(of) for name in segment.value_names}
    return lambda expression: None if names_in(expression.root) & own else evaluate(expression)


def _number(size: Size | None, evaluate: Evaluate) -> int | None:
    if isinstance(size, Expression):
        value = evaluate(size)
        return value if isinstance(value, int) and value >= 0 else None
    return size if isinstance(size, int) else None
