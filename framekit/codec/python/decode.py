"""Write decoders: one function per frame that takes bytes and returns values; `BufferReader` writes its body.

Pairs of a frame and a plain inner frame have a fused decoder, which reads both at once. This module chooses the pairs,
joins their segments to one list, and writes the function. A fused decoder reads only bytes that fit; all others are
left to the frame's own decoder, which reports faults.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

from framekit.codec.python.choices import Leaf, Switch, in_order, tree_of
from framekit.codec.python.expressions import FieldScope
from framekit.codec.python.facts import PathTarget, by_path
from framekit.codec.python.function import Fields, Function, Offset
from framekit.codec.python.module import Module
from framekit.codec.python.reader import BufferReader, ScopedSegment
from framekit.codec.python.registry import kind_of, summary, write_docstring
from framekit.codec.python.source import Source, bytes_literal, quoted
from framekit.definition.expression import BIT_OR, Expression
from framekit.definition.model.frames import Frame, StaticSizes, bytes_of, everything, in_place_of_records, names_read
from framekit.definition.model.segments import Check, Const, Inner, Length, Segment, Sizes


def write_decoder(
    module: Module,
    identifier: str,
    name: str,
    segments: tuple[Segment, ...],
    frame: Frame | None,
    fused: tuple[str, int] | None = None,
) -> Source:
    """Return the source of `decode_…` of a frame, or of a layout if `frame` is None.

    `fused`: the table of the fused decoders, and the offset of the byte that selects one.
    """
    function = Function(module, identifier, segments)
    fields = Fields(function.names.fresh("fields"))
    function.tells_wrong = may_refuse = module.static.may_refuse(segments)
    reader = BufferReader(function, "data", "at")
    if segments and all(isinstance(segment, Const) and segment.when is None for segment in segments):
        whole = b"".join(segment.data for segment in segments if isinstance(segment, Const))
        function.mismatch_if(f"data != {bytes_literal(whole)}")
    else:
        tail = frame.tail[0] if frame is not None and frame.delimited and frame.tail else None
        if frame is not None and isinstance(tail, Const) and tail.data[0] in bytes_of(frame.body, module.static.frames):
            _ends_at_tail(function, reader, frame, tail)
        reader.read(segments, FieldScope(), fields)
        reader.close()
    for action in function.late:
        action()
    if frame is not None and frame.most is not None:
        limit(function, frame.most, segments)
    function.finish()
    result = fields.text(function.out)
    out = Source()
    kind = "frame" if frame is not None else "layout"
    with out.block(f"def decode_{identifier}(data: bytes, ctx: Context = DEFAULTS) -> dict[str, Any]:"):
        write_docstring(out, f"Read the {kind} `{name}`. Raises FrameError.", summary(segments))
        function.write_hoisted(out)
        for local in function.regions:
            out.add(f'{local} = b""')
        if function.flag:
            out.add(f"{function.flag} = False")
        if fused is not None:
            _try_fused(out, *fused)
        with out.block("try:"):
            out.extend(function.out)
        at_once = f"raise diagnose_{identifier}(data, ctx).error({quoted(name)}) from None"
        when_asked = f"raise Misread({quoted(name)}, diagnose_{identifier}, data, ctx) from None"
        if function.raises_wrong:
            with out.block("except Wrong:"):
                out.add(when_asked)
        with out.block("except MISMATCHES:"):
            out.add(at_once if may_refuse else when_asked)
        out.add(f"return {result}")
    return out


def _ends_at_tail(function: Function, reader: BufferReader, frame: Frame, tail: Const) -> None:
    """Add the condition that a delimited body ends at the first byte of the tail, whatever its content."""
    head = function.static.all(frame.head).fixed
    if head is None:
        reader.body_begins = next(in_place_of_records(frame.body), None)
    else:
        reader.body_place = Offset("", head)
    function.tracked.add(tail.path)

    def compare() -> None:
        found = f"data.find({tail.data[0]:#04x}, {reader.body_place.text('data')})"
        function.mismatch_if(f"{found} != {function.bounds[tail.path].first.text('data')}")

    function.late.append(compare)


def _try_fused(out: Source, table: str, place: int) -> None:
    """Write the attempt to read the frame with a fused decoder; bytes that do not fit are read normally."""
    with out.block("try:"):
        out.add(f"fused = {table}[data[{place}]]")
        with out.block("if fused is not None:"):
            out.add("return fused(data, ctx)")
    with out.block("except MISMATCHES:"):
        out.add("pass")


def limit(function: Function, most: int, segments: tuple[Segment, ...]) -> None:
    """Add the condition that a frame is not longer than its definition allows."""
    longest = function.static.all(segments).most
    if longest is not None and longest <= most:
        return
    least = next((one for one in function.conditions if re.fullmatch(r"len\(data\) < \d+", one)), None)
    if least is None:
        function.mismatch_if(f"len(data) > {most}")
    else:
        function.conditions[function.conditions.index(least)] = f"not {least.rpartition(' ')[2]} <= len(data) <= {most}"


# ---- a frame and the one inside it ---------------------------------------------------------------------------

MOST_PAIRS = 40
"""Limit of the fused decoders of a frame; each is a function of about ten lines."""
MOST_SEGMENTS = 24
"""Pairs with more segments than this are not fused: reading them takes so long that a saved call does not matter."""


@dataclass(frozen=True, slots=True)
class Pair:
    """A frame together with one of its possible inner frames."""

    inner: Inner
    """The segment that holds the inner frame."""
    inside_name: str
    inside: tuple[Segment, ...]
    """The segments of the inner frame."""
    segments: tuple[Segment, ...]
    """The segments of both frames, in order."""


def pairs_of(static: StaticSizes, frame: Frame) -> Iterator[Pair]:
    """Yield the pairs of a frame that deserve a fused decoder: plain inner frames that one byte selects."""
    inner = place_of(static, frame)
    if inner is None:
        return
    for name in likely_names(static, inner[0])[:MOST_PAIRS]:
        pair = _pair(static, frame, inner[0], name)
        if pair is not None:
            yield pair


def place_of(static: StaticSizes, frame: Frame) -> tuple[Inner, int] | None:
    """Return the only inner frame of a frame, and the offset of the byte that selects it; None if its offset varies."""
    found = [segment for segment in everything(frame.segments) if isinstance(segment, Inner)]
    if len(found) != 1 or found[0].when is not None or frame.delimited or found[0] not in frame.segments:
        return None
    inner = found[0]
    before = frame.segments[: frame.segments.index(inner)]
    if any(segment.when is not None for segment in frame.segments):
        return None
    front = static.all(before).fixed
    tree = tree_of(static, in_order(static, inner.frames))
    return None if front is None else (inner, front + (tree.at if isinstance(tree, Switch) else 0))


def likely_names(static: StaticSizes, inner: Inner) -> list[str]:
    """Return the inner frames that are tried first because of their deciding byte; see `Choice.likely`."""
    tree = tree_of(static, in_order(static, inner.frames))
    branches = [branch for _, branch in tree.cases] + [tree.others] if isinstance(tree, Switch) else [tree]
    firsts = [branch.frames[0] for branch in branches if isinstance(branch, Leaf) and 1 <= len(branch.frames) <= 2]
    return [name for name in dict.fromkeys(firsts) if static.frames[name].refuse is None]


def _pair(static: StaticSizes, frame: Frame, inner: Inner, name: str) -> Pair | None:
    """Return the segments of a frame and its inner frame as one list; None if they cannot be read together."""
    other = static.frames[name]
    inside = tuple(renamed(segment) for segment in static.segments(other))
    sizes = static.all(inside)
    if not inside or other.delimited or not is_plain(inside):
        return None
    if other.most is not None and (sizes.most is None or sizes.most > other.most):
        return None
    if not _ends_alike(static, frame, inner, sizes):
        return None
    around = tuple(segment for segment in frame.segments if segment is not inner)
    if {inner.name, name} & (names_of(around) | names_of(inside)) or not _are_independent(around, inside, inner):
        return None
    parts = tuple(segment.name for segment in inside if segment.name and segment.takes_bytes)
    lists = (
        tuple(one for segment in part for one in (inside if segment is inner else (counting(segment, inner, parts),)))
        for part in (frame.head, frame.body, frame.tail)
    )
    head, body, tail = lists
    fused = static.segments(replace(frame, head=head, body=body, tail=tail))
    # conditions come last, so that they do not separate fields that one struct can read
    return Pair(inner, name, inside, tuple(sorted(fused, key=lambda segment: segment.condition is not None)))


def _are_independent(around: tuple[Segment, ...], inside: tuple[Segment, ...], inner: Inner) -> bool:
    """Return whether a frame and its inner frame share no names, and neither reads or covers values of the other."""
    if names_of(around) & names_of(inside):
        return False
    if names_read(around) & (names_of(inside) | {inner.name}) or names_read(inside) & (names_of(around) | {inner.name}):
        return False
    return not any(isinstance(segment, Check) and inner.name in segment.edges for segment in everything(around))


def _ends_alike(static: StaticSizes, frame: Frame, inner: Inner, sizes: Sizes) -> bool:
    """Return whether the inner frame, read from its own definition, ends at the end of its region."""
    if isinstance(inner.size, int):
        return sizes.fixed == inner.size
    segments = static.segments(frame)
    behind = segments[segments.index(inner) + 1 :]
    if all(static.of(segment).fixed is not None for segment in behind):
        return True
    told = isinstance(inner.size, Expression) or (inner.size is None and static.present(inner).fixed is not None)
    return told and sizes.fixed is not None


def renamed(segment: Segment) -> Segment:
    """Return the segment with a new name if it fills a frame up, as these have the same name in every frame."""
    return replace(segment, name="_fill_inside") if segment.name == "_fill" else segment


def is_plain(segments: Iterable[Segment]) -> bool:
    """Return whether the segments are few, unconditional, and readable in a fused function."""
    every = tuple(everything(segments))
    return len(every) <= MOST_SEGMENTS and all(
        segment.when is None and kind_of(segment).is_plain(segment) for segment in every
    )


def names_of(segments: Iterable[Segment]) -> set[str]:
    every = tuple(everything(segments))
    return {segment.name for segment in every if segment.name} | {name for one in every for name in one.value_names}


def counting(segment: Segment, inner: Inner, parts: tuple[str, ...]) -> Segment:
    """Return a length or check over the inner frame as a length or check over its segments."""

    def spread(names: Iterable[str]) -> tuple[str, ...]:
        return tuple(one for name in names for one in (parts if name == inner.name else (name,)))

    if isinstance(segment, Length):
        return replace(segment, of=spread(segment.of))
    if isinstance(segment, Check):
        return segment.with_names(spread)
    return segment


class Apart:
    """Assign names and values of a pair's segments to the outer or the inner frame."""

    def __init__(self, function: Function, pair: Pair, fields: Fields) -> None:
        self._inside = {id(segment) for segment in pair.inside}
        named = Fields(function.names.fresh(pair.inner.name), (fields, pair.inner.name))
        inside = Fields(function.names.fresh(pair.inside_name), (named, pair.inside_name))
        self._where = FieldScope(), inside

    def where(self, segment: Segment, scope: FieldScope, fields: Fields) -> tuple[FieldScope, Fields]:
        """Return the scope and the dictionary of a segment; `scope` and `fields` are those of the outer frame."""
        return self._where if id(segment) in self._inside else (scope, fields)


class _PairReader(BufferReader):
    """Read a pair as one list of segments."""

    def __init__(self, function: Function, pair: Pair, fields: Fields) -> None:
        super().__init__(function, "data", "at")
        self.apart = Apart(function, pair, fields)

    def items(self, segments: Iterable[Segment], scope: FieldScope, fields: Fields) -> list[ScopedSegment]:
        return [
            item
            for segment in segments
            for item in super(_PairReader, self).items((segment,), *self.apart.where(segment, scope, fields))
        ]


def write_pairs(module: Module, identifier: str, frame: Frame) -> tuple[list[Source], tuple[str, int] | None]:
    """Return the fused decoders of a frame, and their table with the offset of the deciding byte, or None."""
    place, sources, readers = place_of(module.static, frame), [], {}
    for pair in pairs_of(module.static, frame):
        name = readers[pair.inside_name] = module.names.fresh(f"{identifier}_with_{pair.inside_name}")
        sources.append(write_fused(module, name, identifier, frame, pair))
    if place is None or not readers:
        return [], None
    return sources, (module.fused(identifier, place[0].frames, readers), place[1])


def function_of(module: Module, title: str, pair: Pair) -> Function:
    """Return the function that will read a pair."""
    function = Function(module, title, pair.segments)
    if isinstance(pair.inner.size, Expression):
        function.tracked |= set(_parts(pair))
    return function


def compare_size(function: Function, pair: Pair, scope: FieldScope) -> None:
    """Add the condition that the inner frame has the size that the outer frame states."""
    if isinstance(pair.inner.size, Expression):
        size = function.writer(scope).text(pair.inner.size, BIT_OR)
        function.mismatch_if(f"{size} != {function.room(_parts(pair), plain=False)}")


def _parts(pair: Pair) -> dict[str, PathTarget]:
    return by_path(segment for segment in pair.inside if segment.takes_bytes)


def write_fused(module: Module, identifier: str, title: str, frame: Frame, pair: Pair) -> Source:
    """Return the source of a fused decoder, with the result of `decode_…` for a frame with the pair's inner frame.

    For other frames the decoder raises any exception.
    """
    function = function_of(module, title, pair)
    fields, scope = Fields(function.names.fresh("fields")), FieldScope()
    reader = _PairReader(function, pair, fields)
    reader.read(pair.segments, scope, fields)
    reader.close()
    for action in function.late:
        action()
    compare_size(function, pair, scope)
    if frame.most is not None:
        limit(function, frame.most, pair.segments)
    function.flush()
    result = fields.text(function.out)
    out = Source()
    with out.block(f"def {identifier}(data: bytes, ctx: Context) -> dict[str, Any]:"):
        out.docstring(f"Read `{frame.name}` with `{pair.inside_name}` inside.")
        function.write_hoisted(out)
        for local in function.regions:
            out.add(f'{local} = b""')
        out.extend(function.out)
        out.add(f"return {result}")
    return out
