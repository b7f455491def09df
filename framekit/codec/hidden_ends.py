"""Ends that are none: constants that data may hold before them, and silence where there is no silence.

Reference, section 14.
"""

from __future__ import annotations

from collections.abc import Iterator

from framekit.codec.codec import Codec
from framekit.codec.errors import EncodeError
from framekit.codec.samples import Sampler, beginning
from framekit.definition.check.frames import takes_rest, title
from framekit.definition.model.contents import bytes_of
from framekit.definition.model.frames import Frame
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.segments import Check, Const, Data, Inner, Optional, Repeat, Segment
from framekit.definition.model.walk import parts_of
from framekit.definition.problems import Problem


def check_hidden_ends(protocol: Protocol) -> Iterator[Problem]:
    """At most one warning a frame. Delimited bodies cannot hold their end: that is checked elsewhere."""
    for frame in protocol.frames.values():
        for place, segment in enumerate(frame.segments[:-1]):
            if frame.delimited or segment.when:
                continue
            behind = frame.segments[place + 1 :]
            end = next((one for one in behind if isinstance(one, Const) and one.when is None), None)
            if end is None:
                break
            warning = _warning(protocol, frame, segment, end, behind)
            if warning is not None:
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


def check_ends_inside(codec: Codec, sampler: Sampler) -> Iterator[Problem]:
    """Frames inside whose bytes may be the beginning of one that is tried before them: a receiver waits for that."""
    for frame in codec.protocol.frames.values():
        for inner in parts_of(frame.segments, Inner):
            for later in inner.frames[1:] if inner.size is None else ():
                data = _waiting(codec, sampler, frame.name, inner, later)
                if data is not None:
                    what = f"'{later}' in '{frame.name}' may be the beginning of a frame that is tried first"
                    what = f"{what}: {beginning(data)}"
                    todo = f"give '{inner.name}' a size, or write the frame with less bytes first"
                    yield Problem(inner.at, what, todo)
                    break


def _waiting(codec: Codec, sampler: Sampler, frame: str, inner: Inner, later: str) -> bytes | None:
    """A frame with another inside that is complete without silence, and measured as if more came."""
    outer = [sample.values for sample in sampler.samples(frame) if inner.name in sample.values]
    for values, inside in zip(outer, sampler.samples(later), strict=False):
        if codec.measure(later, inside.data, ctx=sampler.context) == codec.QUIET:
            continue
        try:
            data = codec.encode(frame, {**values, inner.name: {later: inside.values}}, sampler.context)
        except EncodeError:
            continue
        if codec.QUIET < codec.measure(frame, data, ctx=sampler.context) < 0:
            return data
    return None


def _warning(
    protocol: Protocol, frame: Frame, segment: Segment, end: Const, behind: tuple[Segment, ...]
) -> Problem | None:
    sign = f"{end.data[0]:02X}"
    before = behind[: behind.index(end)]
    open_ended = takes_rest(segment) or (isinstance(segment, Inner) and segment.size == "rest")
    if open_ended and end.data[0] in bytes_of([segment, *before], protocol.frames):
        guarded = any(check.verify == "error" for check in parts_of(behind, Check))
        where = f"the first {sign} with a fitting check code" if guarded else f"the first {sign}, whatever was meant"
        holder, todo = segment, "give it a size, or send it as digits or in a wrap"
        if isinstance(segment, (Repeat, Optional)):
            todo = "say by a field how much there is of it, or send it as digits or in a wrap"
        if end.data[0] not in bytes_of([segment], protocol.frames):
            holder = next(one for one in before if end.data[0] in bytes_of([one], protocol.frames))
            todo = "send it as digits, or put it after the end"
        what = f"{title(holder)} may hold {sign}, which ends it: '{frame.name}' ends at {where}"
        return Problem(holder.at, what, todo, warning=True)
    sized = protocol.profile is not None and isinstance(segment, Data) and isinstance(segment.size, int)
    if sized and not before and end in frame.tail and end.data[0] in bytes_of([segment]):
        what = (
            f"{title(segment)} may hold {sign}, the first byte of the tail: '{frame.name}' ends by its size, not there"
        )
        return Problem(segment.at, what, "nothing to do if the size is right", warning=True)
    return None
