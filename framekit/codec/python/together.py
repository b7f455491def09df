"""Frames as one: a frame and those inside it as one list of segments, to be shown, or to be built at once.

Which frames may be put together so that building them at once gives what building one after the other gives; how bytes
are made of them is not known here.
"""

from __future__ import annotations

from dataclasses import replace

from framekit.codec.python.joined import counting, is_plain, names_of, renamed
from framekit.codec.python.parameters import Level
from framekit.codec.python.shape import names_read
from framekit.definition.expression.syntax import Binary, Expression, Name, Node, Number
from framekit.definition.model.frame_sizes import StaticSizes
from framekit.definition.model.segments import (
    Bits,
    Check,
    Const,
    Count,
    Data,
    Field,
    Fill,
    Inner,
    Length,
    Repeat,
    Require,
    Segment,
    Skip,
    Value,
    Wrap,
)
from framekit.definition.model.walk import everything, without_when


class NotPlain(Exception):  # noqa: N818 - no error, the encoder does it then
    """Some frames cannot be built by one function without a look at nested values."""


def shown(levels: tuple[Level, ...]) -> tuple[Segment, ...]:
    """The segments of the frames, each in the place where it stands in the one before it."""
    *before, last = levels
    found = last.frame.segments
    for level in reversed(before):
        assert level.inner is not None
        found = _put_in(level.frame.segments, level.inner, found)
    return found


def _put_in(segments: tuple[Segment, ...], inner: Inner, inside: tuple[Segment, ...]) -> tuple[Segment, ...]:
    """The segments with others in the place of an inner frame."""
    found: list[Segment] = []
    for segment in segments:
        if segment is inner:
            found.extend(inside)
        else:
            found.append(segment.with_blocks(lambda block: _put_in(block, inner, inside)))
    return tuple(found)


class Together:
    """Some frames as one list of segments, and the sizes that have to come out: expression, names of what it counts.

    Raises NotPlain where they cannot be built so.
    """

    def __init__(self, shapes: StaticSizes, levels: tuple[Level, ...]) -> None:
        self.shapes = shapes
        self.sizes: list[tuple[Expression, tuple[str, ...]]] = []
        found: tuple[Segment, ...] = ()
        for level in reversed(levels):
            segments = shapes.segments(level.frame)
            found = segments if level.inner is None else self._around(segments, level.inner, found)
            if level is not levels[0]:
                found = self._inside(level, tuple(renamed(segment) for segment in found))
        self.segments = found
        if not all(_is_simple(segment) for segment in everything(found)):
            raise NotPlain

    def _inside(self, level: Level, segments: tuple[Segment, ...]) -> tuple[Segment, ...]:
        """A frame that is to stand in another one, if it may."""
        frame, most = level.frame, self.shapes.all(segments).most
        if frame.delimited or not is_plain(_as_if_there(segments)):
            raise NotPlain
        if frame.most is not None and (most is None or most > frame.most):
            raise NotPlain
        return segments

    def _around(self, segments: tuple[Segment, ...], inner: Inner, inside: tuple[Segment, ...]) -> tuple[Segment, ...]:
        around = _put_in(segments, inner, ())
        theirs, ours = names_of(inside), names_of(around) | {inner.name}
        if theirs & ours or names_read(around) & (theirs | {inner.name}):
            raise NotPlain
        if names_read(inside) & ours or inner.when is not None:
            raise NotPlain
        if any(isinstance(one, Check) and inner.name in (one.span or ()) for one in everything(around)):
            raise NotPlain
        parts = tuple(one.name for one in inside if one.name and not isinstance(one, (Require, Value)))
        if isinstance(inner.size, int) and self.shapes.all(inside).fixed != inner.size:
            raise NotPlain
        if isinstance(inner.size, Expression) and not self._is_told(inner, inner.size, segments):
            self.sizes.append((inner.size, parts))
        return _put_in(_counting_in(segments, inner, parts), inner, inside)

    def _is_told(self, inner: Inner, size: Expression, segments: tuple[Segment, ...]) -> bool:
        """Whether a size is nothing but a length that counts the frame, less what else it counts."""
        root, less = _without_number(size.root)
        named = {one.name: one for one in segments if one.name is not None}
        length = named.get(root.name) if isinstance(root, Name) else None
        if not isinstance(length, Length) or length.unit != 1 or length.plus or inner.name not in length.of:
            return False
        others = [named[name] for name in length.of if name != inner.name and name in named]
        return len(others) == len(length.of) - 1 and self.shapes.all(others).fixed == less


def _without_number(node: Node) -> tuple[Node, int]:
    """What a number is taken from, and the number."""
    if isinstance(node, Binary) and node.operator == "-" and isinstance(node.right, Number):
        return node.left, node.right.value
    return node, 0


def _counting_in(segments: tuple[Segment, ...], inner: Inner, parts: tuple[str, ...]) -> tuple[Segment, ...]:
    """The segments, those in wraps too, with lengths and checks over the frame inside being over its segments."""
    return tuple(
        replace(one, of=_counting_in(one.of, inner, parts)) if isinstance(one, Wrap) else counting(one, inner, parts)
        for one in segments
    )


def _is_simple(segment: Segment) -> bool:
    """Whether a segment has its values at hand, and holds no frame."""
    if isinstance(segment, Check):
        return True
    return (isinstance(segment, (Fill, Wrap)) and segment.when is None) or is_plain(_as_if_there((segment,)))


def _as_if_there(segments: tuple[Segment, ...]) -> tuple[Segment, ...]:
    """The segments without the conditions under which single values are there."""
    return tuple(without_when(one) if isinstance(one, _MAY_BE_ABSENT) else one for one in segments)


_MAY_BE_ABSENT = (Bits, Const, Count, Data, Field, Length, Repeat, Require, Skip)
