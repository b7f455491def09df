"""The frames of a protocol with sample values, for tests of what the link works out about their bytes."""

from __future__ import annotations

from functools import cache

from framekit.codec.codec import compile_protocol
from framekit.codec.samples import Sample, Sampler
from framekit.definition.load import load_protocol, load_protocol_text
from framekit.link.frame_table import FrameTable
from framekit.link.scope import Scope
from framekit.link.spans import Span, spans_of
from framekit.link.values import FrameValue


class Frames:
    """All frames of a protocol with samples."""

    def __init__(self, name: str) -> None:
        """`name`: a shipped protocol, or the text of one."""
        self.protocol = load_protocol(name) if "\n" not in name else load_protocol_text(name, "p")
        self.codec = compile_protocol(self.protocol)
        self.scope = Scope(self.protocol, role=next(iter(self.protocol.roles), None))
        self.table = FrameTable(self.protocol, self.codec)
        self.sampler = Sampler(self.codec, self.scope)

    def samples(self, frame: str) -> tuple[Sample, ...]:
        return self.sampler.samples(frame, 3, 12)

    def value(self, frame: str, data: bytes) -> FrameValue:
        """The frame as it is received."""
        return self.table.received(frame, self.codec.decode(frame, data, self.scope), data, None)

    def spans(self, frame: str, data: bytes) -> tuple[Span, ...] | None:
        return spans_of(self.value(frame, data), len(data), self.table.infos)


@cache
def frames_of(name: str) -> Frames:
    """Those of a shipped protocol, made once."""
    return Frames(name)
