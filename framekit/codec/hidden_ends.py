"""Ends that are none: constants that data may hold before them, and silence where there is no silence.

Reference, section 14.
"""

from __future__ import annotations

from collections.abc import Iterator

from framekit.codec.codec import Codec
from framekit.codec.samples import Sampler
from framekit.definition.model.frames import Frame
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.segments import Check, Const, Data, Inner, Segment
from framekit.definition.model.walk import parts_of
from framekit.definition.problems import Problem

_DIGITS = b"0123456789ABCDEF"


def check_hidden_ends(protocol: Protocol) -> Iterator[Problem]:
    """At most one warning a frame. Delimited bodies cannot hold their end: that is checked elsewhere."""
    for frame in protocol.frames.values():
        for place, segment in enumerate(frame.segments[:-1]):
            end = frame.segments[place + 1]
            if frame.delimited or not isinstance(segment, Data) or not isinstance(end, Const) or segment.when:
                continue
            warning = _warning(protocol, frame, segment, end, frame.segments[place + 2 :])
            if warning is not None and _may_hold(segment, end.data[0]):
                yield warning
                break


def check_silent_ends(codec: Codec, sampler: Sampler) -> Iterator[Problem]:
    """Frames that only silence ends, on a connection where nobody says how long that is: there it ends nothing."""
    protocol = codec.protocol
    if protocol.line.kind != "stream" or protocol.receiver.quiet is not None:
        return
    within = {name for inner in parts_of(dict(protocol.frames), Inner) for name in inner.frames}
    for frame in protocol.frames.values():
        samples = () if frame.inner or frame.side == "none" else sampler.samples(frame.name)
        if any(codec.measure(frame.name, sample.data, ctx=sampler.context) == codec.QUIET for sample in samples):
            what = f"only silence ends '{frame.name}', and a connection has none of its own"
            todo = "add a length or an end constant, or receiver: {quiet: TIME}"
            if frame.name in within:
                todo = f"write from: none if it stands only inside other frames, else {todo}"
            yield Problem(frame.at, what, todo)


def _may_hold(data: Data, byte: int) -> bool:
    return data.convert != "hex_to_ascii" or byte in _DIGITS


def _warning(protocol: Protocol, frame: Frame, data: Data, end: Const, behind: tuple[Segment, ...]) -> Problem | None:
    sign = f"{end.data[0]:02X}"
    if data.size == "rest":
        guarded = any(check.verify == "error" for check in parts_of(behind, Check))
        where = f"the first {sign} with a fitting check code" if guarded else f"the first {sign}, whatever was meant"
        what = f"'{data.name}' may hold {sign}, which ends it: '{frame.name}' ends at {where}"
        return Problem(data.at, what, "give it a size, or send it as digits or in a wrap", warning=True)
    if protocol.profile is not None and isinstance(data.size, int) and end in frame.tail:
        what = f"'{data.name}' may hold {sign}, the first byte of the tail: '{frame.name}' ends by its size, not there"
        return Problem(data.at, what, "nothing to do if the size is right", warning=True)
    return None
