"""Reading ahead: the good frames in bytes that a receiver has not used yet; the bytes stay at hand."""

from __future__ import annotations

from collections.abc import Iterator

from framekit.definition.model.protocol import Protocol
from framekit.link.events import CharacterFault, LineFault
from framekit.link.frame_table import ProtocolCodec
from framekit.link.receiver import Receiver
from framekit.link.values import FrameValue, Names


class Ahead:
    """Reads the unused bytes of a receiver a second time."""

    def __init__(self, codec: ProtocolCodec, protocol: Protocol, names: Names, receiver: Receiver) -> None:
        self._codec, self._protocol, self._names, self._receiver = codec, protocol, names, receiver
        self._second: Receiver | None = None
        """Made when it is needed first: most replies come alone."""

    def frames(self, names: tuple[str, ...], now: int) -> Iterator[FrameValue]:
        """Yield the good frames named in `names` that follow the last frame of the receiver.

        Unfinished frames, and frames that only a silence ends, are left out.
        """
        first, second = self._receiver, self._second
        if second is None:
            second = self._second = Receiver(self._codec, self._protocol, self._names, first.table)
        stream = first.stream
        begin = stream.base + stream.position
        faults = [CharacterFault(at - begin, fault) for at, fault in stream.faults if at >= begin]
        faults += [CharacterFault(at - begin, LineFault.MARK) for at in stream.marks if at >= begin]
        second.reset()
        second.hear_marks(first.hears_marks)
        second.append(bytes(stream.buffer[stream.position :]), now, faults)
        expected = second.expect(names)
        while (found := second.next_of(expected)) is not None:
            if isinstance(found, FrameValue):
                yield found
