"""The model in the form the compiler works on: segments have names, what holds others under a condition is a choice."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from framekit.definition.expression.syntax import Conditional, Expression, Number
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.segments import Choose, Optional, Record, Repeat, Segment, Wrap


def normal_protocol(protocol: Protocol) -> Protocol:
    """The protocol with frames and layouts in normal form."""
    numbers = iter(range(1, 1 << 30))
    frames = {
        name: replace(
            frame,
            head=_all(frame.head, numbers),
            body=_all(frame.body, numbers),
            tail=_all(frame.tail, numbers),
        )
        for name, frame in protocol.frames.items()
    }
    layouts = {
        name: replace(layout, segments=_all(layout.segments, numbers)) for name, layout in protocol.layouts.items()
    }
    return replace(protocol, frames=frames, layouts=layouts)


def _all(segments: tuple[Segment, ...], numbers: Iterator[int]) -> tuple[Segment, ...]:
    return tuple(_one(segment, numbers) for segment in segments)


def _one(segment: Segment, numbers: Iterator[int]) -> Segment:
    if segment.name is None:
        segment = replace(segment, name=_name(segment, numbers))
    if isinstance(segment, Choose):
        cases = tuple((keys, _all(of, numbers)) for keys, of in segment.cases)
        otherwise = None if segment.otherwise is None else _all(segment.otherwise, numbers)
        return _chosen(replace(segment, cases=cases, otherwise=otherwise), numbers)
    if isinstance(segment, (Wrap, Optional)):
        return _chosen(replace(segment, of=_all(segment.of, numbers)), numbers)
    if isinstance(segment, (Record, Repeat)) and isinstance(segment.of, tuple):
        return replace(segment, of=_all(segment.of, numbers))
    return segment


def _chosen(segment: Choose | Wrap | Optional, numbers: Iterator[int]) -> Segment:
    """What holds segments of the frame itself, under a condition, as a choice of two cases."""
    if segment.when is None:
        return segment
    root = segment.when.root
    on = Conditional(root.at, root, Number(root.at, 1), Number(root.at, 0))
    return Choose(
        at=segment.at,
        name=segment.name,
        on=Expression(f"1 if {segment.when} else 0", on),
        cases=(((1,), (replace(segment, when=None, name=_name(segment, numbers)),)),),
        otherwise=(),
    )


def _name(segment: Segment, numbers: Iterator[int]) -> str:
    return f"_{type(segment).__name__.lower()}_n{next(numbers)}"
