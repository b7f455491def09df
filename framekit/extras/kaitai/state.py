"""Hold the common state of a Kaitai file while it is written: its names, its problems, and the current frame."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from framekit.definition.expression import names_in
from framekit.definition.model.frames import Frame, StaticSizes, expressions_of
from framekit.definition.model.protocol import Protocol
from framekit.definition.problems import Position, Problem
from framekit.extras.kaitai.expressions import MOST_NUMBER, KaitaiExpressions
from framekit.extras.kaitai.source import KsyNames

Keys = dict[str, Any]
"""A mapping of the file."""
FRAME_KIND, UNEXPECTED = "frame_kind", "unexpected"
"""The names of the enumeration of the frames, and of the type that always fails."""


class KsyFile:
    """A file while it is written."""

    def __init__(self, protocol: Protocol) -> None:
        self.protocol = protocol
        self.static = StaticSizes(protocol.frames)
        self.expressions = KaitaiExpressions(protocol, self.tell)
        self.problems: dict[Problem, None] = {}
        self.enums: dict[tuple[tuple[int, str], ...], str] = {}
        self.names = KsyNames((FRAME_KIND, UNEXPECTED))
        self.name = self.names.new_type(protocol.name)
        self.types = {frame: self.names.new_type(frame) for frame in protocol.frames}
        self.without_end: set[str] = set()
        """Frames that are read from a stream that continues after them."""
        self.inside: set[str] = set()
        """Frames that fill a substream inside another frame."""

    def tell(self, at: Position, what: str, why: str) -> None:
        self.problems.setdefault(Problem(at, what, why))

    def enum(self, name: str, values: Mapping[int, str], at: Position) -> str | None:
        """Return the name of an enumeration of these numbers; None, after a report, if Kaitai cannot represent it."""
        if any(abs(number) > MOST_NUMBER for number in values):
            self.tell(at, f"the numbers of '{name}' have no names", "Kaitai has names of numbers of 63 bits")
            return None
        known = tuple(values.items())
        if known not in self.enums:
            self.enums[known] = self.names.new_type(name)
        return self.enums[known]


class KsyFrame:
    """A frame while it is written: the names and types inside its own type."""

    def __init__(self, file: KsyFile, frame: Frame) -> None:
        self.file = file
        self.frame = frame
        self.names = KsyNames((*file.types.values(), UNEXPECTED))
        self.types: dict[str, Keys] = {}
        self.asked = {name for one in expressions_of(frame.segments) for name in names_in(one.root)}
