"""A run of bytes that fit nothing, collected until it ends."""

from __future__ import annotations

from framekit.link.arrivals import Noise, new_tuple
from framekit.link.stream import Stream

LONGEST = 65536
"""A run is reported in pieces of this many bytes, so that endless noise takes no endless memory."""


class NoiseRun:
    """Bytes since the run began. `skipped`: they are what a bad frame that has been reported left behind."""

    __slots__ = ("_last", "_offset", "_started", "data", "skipped")

    def __init__(self) -> None:
        self.data = bytearray()
        self._offset = self._started = self._last = 0
        self.skipped = False

    def __bool__(self) -> bool:
        return bool(self.data)

    @property
    def is_long(self) -> bool:
        return len(self.data) >= LONGEST

    def collect(self, stream: Stream, start: int, end: int, skipped: bool) -> None:
        """Takes `buffer[start:end]` of the stream; the stream's position is not moved."""
        started, self._last = stream.times_of(start, end)
        if not self.data:
            self.skipped, self._started = skipped, started
            self._offset = stream.offset + start - stream.position
        self.data += stream.buffer[start:end]

    def take(self) -> Noise:
        """The run as it stands; it begins anew."""
        noise = new_tuple(Noise, (bytes(self.data), self._offset, self._started, self._last, self.skipped))
        self.data.clear()
        return noise
