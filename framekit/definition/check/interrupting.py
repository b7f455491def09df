"""Frames that interrupt others (`inside` of a frame): the outer frame never holds the byte that they begin with."""

from __future__ import annotations

from collections.abc import Iterator

from framekit.definition.model.frames import Frame, StaticSizes, bytes_of, parts_of
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.segments import Const, Count, Data, Field, Inner, Length, Repeat, Segment, Segments, Wrap
from framekit.definition.problems import Problem


def check_interrupting(protocol: Protocol, frame: Frame, is_open: bool) -> Iterator[Problem]:
    """What keeps a receiver from telling the frames in `inside` from the bytes of the frame; there is one at least.

    `is_open`: only silence ends the frame.
    """
    todo = "leave inside out"
    inner = {name for one in parts_of(protocol.frames, Inner) for name in one.frames}
    if frame.inner or frame.name in inner:
        what = f"'{frame.name}' stands only in other frames"
        yield Problem(frame.at, what, "write inside: at the frames around it")
        return
    if is_open:
        what = f"only silence ends '{frame.name}': what comes next may follow it as well as interrupt it"
        yield Problem(frame.at, what, f"give its open part a size or an end, or {todo}")
    if any(wrap.inside for wrap in parts_of(frame.segments, Wrap)):
        yield Problem(frame.at, f"a wrap of '{frame.name}' has inside: too", "write it at one place only")
        return
    firsts: dict[int, str] = {}
    for name in frame.inside:
        other = protocol.frames.get(name)
        if other is None:
            continue
        is_constant = other.size is None and all(_is_constant(one) for one in other.segments)
        if other.inner or name in inner or not is_constant:
            what = f"'{name}' cannot interrupt '{frame.name}': it is more than constant bytes"
            yield Problem(frame.at, what, f"make it of const: only, or {todo}")
        elif other.segments:
            first = other.segments[0]
            assert isinstance(first, Const)
            firsts.setdefault(first.data[0], name)
    for segment in _parts(protocol, StaticSizes(protocol.frames).segments(frame), frozenset()):
        held = _bytes_held(segment) & firsts.keys()
        if held:
            byte = min(held)
            verb = "holds" if isinstance(segment, Const) else "may hold"
            what = f"{segment.title} {verb} {byte:02X}, which tells where '{firsts[byte]}' interrupts '{frame.name}'"
            yield Problem(segment.at, what, _remedy(segment, sorted(held)))


def _is_constant(segment: Segment) -> bool:
    return isinstance(segment, Const) and segment.when is None


def _parts(protocol: Protocol, segments: Segments, around: frozenset[str]) -> Iterator[Segment]:
    """The segments that stand for bytes as they are on the wire, those of frames inside too, wraps as a whole."""
    for segment in segments:
        inside = segment.blocks if segment.inner_record is None else (segment.inner_record,)
        names = [name for name in segment.frames_inside if name in protocol.frames and name not in around]
        if isinstance(segment, Wrap) or not (inside or segment.frames_inside):
            yield segment
            continue
        if isinstance(segment, Repeat):
            yield segment
        for block in inside:
            yield from _parts(protocol, block, around)
        for name in names:
            known = around | {*segment.frames_inside}
            yield from _parts(protocol, StaticSizes(protocol.frames).segments(protocol.frames[name]), known)


def _bytes_held(segment: Segment) -> frozenset[int]:
    """The bytes that a segment itself may hold; of a list with segments of its own, what fills its items up."""
    is_list = isinstance(segment, Repeat) and segment.align <= 1 and bool(segment.members)
    return frozenset() if is_list else bytes_of((segment,))


def _remedy(segment: Segment, held: list[int]) -> str:
    shown = ", ".join(f"{byte:02X}" for byte in held)
    if isinstance(segment, Data) and segment.convert is None:
        return f"add never: [{shown}] to '{segment.name}'"
    if isinstance(segment, Field) and segment.type.kind in ("ascii", "bytes"):
        return f"take {{data: {segment.name}, never: [{shown}]}}"
    if isinstance(segment, (Field, Length, Count)) and segment.type.kind == "int" and segment.type.size == 1:
        return f"give '{segment.name}' a range without {shown}"
    if isinstance(segment, Const):
        return "take another byte, or leave inside out"
    return "send it as ASCII digits, or leave inside out"
