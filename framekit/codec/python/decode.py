"""Decoders: one function a frame that takes bytes and gives values.

What reads its segments the `BufferReader` writes.
"""

from __future__ import annotations

import re

from framekit.codec.python.expressions import Scope
from framekit.codec.python.function import Fields, Function, Offset
from framekit.codec.python.module import Module
from framekit.codec.python.reader import BufferReader
from framekit.codec.python.registry import summary, write_docstring
from framekit.codec.python.source import Source, bytes_literal, quoted
from framekit.definition.model.frames import Frame, bytes_of, in_place_of_records
from framekit.definition.model.segments import Const, Segment


def write_decoder(
    module: Module,
    identifier: str,
    name: str,
    segments: tuple[Segment, ...],
    frame: Frame | None,
    fused: tuple[str, int] | None = None,
) -> Source:
    """The source of `decode_…` of a frame, or of a layout if `frame` is None.

    `fused`: the table of what reads the frame together with the one inside it, and the place of the byte it goes by.
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
        reader.read(segments, Scope(), fields)
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
    """A delimited body ends at the first byte of the tail, whatever is in it."""
    head = function.static.all(frame.head).fixed
    if head is None:
        reader.body_begins = next(in_place_of_records(frame.body), None)
    else:
        reader.body_place = Offset("", head)
    function.tracked.add(tail.name or "")

    def compare() -> None:
        found = f"data.find({tail.data[0]:#04x}, {reader.body_place.text('data')})"
        function.mismatch_if(f"{found} != {function.bounds[tail.name or ''].first.text('data')}")

    function.late.append(compare)


def _try_fused(out: Source, table: str, place: int) -> None:
    """Most frames are read in one go; whatever does not fit is looked at part by part."""
    with out.block("try:"):
        out.add(f"fused = {table}[data[{place}]]")
        with out.block("if fused is not None:"):
            out.add("return fused(data, ctx)")
    with out.block("except MISMATCHES:"):
        out.add("pass")


def limit(function: Function, most: int, segments: tuple[Segment, ...]) -> None:
    """A frame must not be longer than its definition says."""
    longest = function.static.all(segments).most
    if longest is not None and longest <= most:
        return
    least = next((one for one in function.conditions if re.fullmatch(r"len\(data\) < \d+", one)), None)
    if least is None:
        function.mismatch_if(f"len(data) > {most}")
    else:
        function.conditions[function.conditions.index(least)] = f"not {least.rpartition(' ')[2]} <= len(data) <= {most}"
