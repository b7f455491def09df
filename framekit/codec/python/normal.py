"""The model in the form the compiler works on: segments have names, what holds others under a condition is a choice."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from framekit.definition.expression.syntax import Conditional, Expression, Number
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.segments import Choose, Segment


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
    segment = segment.with_lists(lambda inside: _all(inside, numbers))
    return _chosen(segment, numbers) if segment.blocks and segment.when is not None else segment


def _chosen(segment: Segment, numbers: Iterator[int]) -> Segment:
    """What holds segments of the frame itself, under a condition, as a choice of two cases."""
    assert segment.when is not None
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
