"""Decoders: one function a frame that reads it on the fast path, and leaves any fault to the careful one."""

from __future__ import annotations

import re

from framekit.codec.python.describe import summary, write_docstring
from framekit.codec.python.expressions import Scope
from framekit.codec.python.function import Function
from framekit.codec.python.module import Module
from framekit.codec.python.places import Fields, Place
from framekit.codec.python.reader import BufferReader
from framekit.codec.python.shape import in_place_of_records
from framekit.codec.python.source import Source, bytes_literal, quoted
from framekit.definition.model.frames import Frame, bytes_of
from framekit.definition.model.segments import Const, Segment


def write_decoder(
    module: Module,
    identifier: str,
    name: str,
    segments: tuple[Segment, ...],
    frame: Frame | None,
    at_once: tuple[str, int] | None = None,
) -> Source:
    """The source of `decode_…` of a frame, or of a layout if `frame` is None.

    `at_once`: the table of what reads the frame together with the one inside it, and the place of the byte it goes by.
    """
    function = Function(module, identifier, segments)
    fields = Fields(function.names.fresh("fields"))
    reader = BufferReader(function, "data", "at")
    if segments and all(isinstance(segment, Const) and segment.when is None for segment in segments):
        whole = b"".join(segment.data for segment in segments if isinstance(segment, Const))
        function.misfit_if(f"data != {bytes_literal(whole)}")
    else:
        tail = frame.tail[0] if frame is not None and frame.delimited and frame.tail else None
        if frame is not None and isinstance(tail, Const) and tail.data[0] in bytes_of(frame.body, module.shapes.frames):
            _ends_at_tail(function, reader, frame, tail)
        reader.read(segments, Scope(), fields)
        reader.close()
    for action in function.late:
        action()
    if frame is not None and frame.most is not None:
        limit(function, frame.most, segments)
    function.flush()
    result = fields.text(function.out)
    out = Source()
    kind = "frame" if frame is not None else "layout"
    with out.block(f"def decode_{identifier}(data: bytes, ctx: Context = DEFAULTS) -> dict[str, Any]:"):
        write_docstring(out, f"Read the {kind} `{name}`. Raises FrameError.", summary(segments))
        for context, local in function.hoisted.items():
            out.add(f"{local} = {module.given(context)}")
        for local in function.regions:
            out.add(f'{local} = b""')
        if at_once is not None:
            _try_at_once(out, *at_once)
        with out.block("try:"):
            out.extend(function.out)
        with out.block("except MISFITS:"):
            if module.shapes.may_refuse(segments):
                out.add(f"raise examine_{identifier}(data, ctx).error({quoted(name)}) from None")
            else:
                out.add(f"raise Misread({quoted(name)}, examine_{identifier}, data, ctx) from None")
        out.add(f"return {result}")
    return out


def _ends_at_tail(function: Function, reader: BufferReader, frame: Frame, tail: Const) -> None:
    """A delimited body ends at the first byte of the tail, whatever is in it."""
    head = function.shapes.all(frame.head).fixed
    if head is None:
        reader.body_begins = next(in_place_of_records(frame.body), None)
    else:
        reader.body_place = Place("", head)
    function.tracked.add(tail.name or "")

    def compare() -> None:
        found = f"data.find({tail.data[0]:#04x}, {reader.body_place.text('data')})"
        function.misfit_if(f"{found} != {function.bounds[tail.name or ''].first.text('data')}")

    function.late.append(compare)


def _try_at_once(out: Source, table: str, place: int) -> None:
    """Most frames are read in one go; whatever does not fit is looked at part by part."""
    with out.block("try:"):
        out.add(f"at_once = {table}[data[{place}]]")
        with out.block("if at_once is not None:"):
            out.add("return at_once(data, ctx)")
    with out.block("except MISFITS:"):
        out.add("pass")


def limit(function: Function, most: int, segments: tuple[Segment, ...]) -> None:
    """A frame must not be longer than its definition says."""
    longest = function.shapes.all(segments).most
    if longest is not None and longest <= most:
        return
    least = next((one for one in function.conditions if re.fullmatch(r"len\(data\) < \d+", one)), None)
    if least is None:
        function.misfit_if(f"len(data) > {most}")
    else:
        function.conditions[function.conditions.index(least)] = f"not {least.rpartition(' ')[2]} <= len(data) <= {most}"
