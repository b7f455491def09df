"""All functions of a protocol that take frames out of a buffer: which there are, and the tables they are found by.

How one is written is not known here.
"""

from __future__ import annotations

from collections.abc import Mapping

from framekit.codec.python.joined import pairs_of, place_of
from framekit.codec.python.module import Module
from framekit.codec.python.source import Source
from framekit.codec.python.take import PairTakeWriter, TakeWriter
from framekit.codec.python.take_rows import write_rows
from framekit.definition.model.frames import Frame
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.segments import Inner
from framekit.definition.model.walk import parts_of

Together = dict[str, tuple[int, str]]
"""Of a frame that is taken together with the one inside it: the place of a byte, the table of what takes them by it."""


def write_takes(
    module: Module, protocol: Protocol, identifiers: Mapping[str, str]
) -> tuple[dict[str, Source], Together, dict[str, Source]]:
    """The sources of `take_…` by identifiers: of all frames that are looked for on the line and can be read so.

    And of those inside them, as far as they are read from the same buffer, and of both at once. The third: those of
    `rows_…` by the frame's name.
    """
    found: dict[str, Source] = {}
    together: Together = {}
    rows: dict[str, Source] = {}
    inside = {name for frame in protocol.frames.values() for part in parts_of(frame, Inner) for name in part.frames}
    asked: dict[str, None] = {}
    for name, frame in protocol.frames.items():
        if frame.inner or name in inside:
            continue
        writer = TakeWriter(module, identifiers[name], frame)
        if not writer.can_be_taken:
            continue
        found[identifiers[name]] = writer.function_on_line()
        place, pairs = place_of(module.shapes, frame), _pairs(module, identifiers[name], frame)
        if place is not None and pairs:
            found.update({pair.identifier: pair.function_on_line() for pair in pairs.values()})
            readers = {inner: f"take_{pair.identifier}" for inner, pair in pairs.items()}
            is_measured = place[0].size is None and module.shapes.present(place[0]).fixed is None
            where_none_is = "take_none" if is_measured else ""  # else nobody looks inside to see how long it is
            table = module.at_once(f"take_{identifiers[name]}", place[0].frames, readers, where_none_is)
            together[name] = place[1], table
            in_rows = write_rows(module, identifiers[name], frame, pairs, "(None, 0)" if is_measured else "None")
            if in_rows is not None:
                rows[name] = in_rows
        asked.update({inner: None for inner in writer.reader.asked if inner not in pairs})
    done: set[str] = set()
    while left := [name for name in asked if name not in done]:
        for name in left:
            writer = TakeWriter(module, identifiers[name], protocol.frames[name], is_inner=True)
            if writer.can_be_taken:
                found[identifiers[name]] = writer.inner_function()
                asked.update(writer.reader.asked)
        done.update(left)
    return found, together, rows


def _pairs(module: Module, identifier: str, frame: Frame) -> dict[str, PairTakeWriter]:
    """What takes a frame and the plain one inside it at once, by the name of that."""
    found = {}
    for pair in pairs_of(module.shapes, frame):
        known = module.names.fresh(f"take_{identifier}_with_{pair.inside_name}").removeprefix("take_")
        writer = PairTakeWriter(module, known, frame, pair)
        if writer.can_be_taken:
            found[pair.inside_name] = writer
    return found
