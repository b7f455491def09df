"""How much of the time a line carries bits: measured, from bytes, speed and format.

Each character takes the bit times of its format. Both directions count, so a full-duplex line can be busy up to twice.
"""

from __future__ import annotations

from framekit.definition.times import LineFormat


class LineLoad:
    """Counts the bytes of one line. `line` None: there is no speed, and no load can be told."""

    __slots__ = ("_sampled_at", "_sampled_bytes", "began", "bytes_in", "bytes_out", "character_time")

    def __init__(self, line: LineFormat | None, began: int) -> None:
        self.character_time = 0 if line is None else line.character_time
        self.began = self._sampled_at = began
        self.bytes_in = self.bytes_out = 0
        self._sampled_bytes = 0

    def begin(self, now: int) -> None:
        """Time counts from now on, if nothing has been on the line before."""
        if not self.bytes:
            self.began = self._sampled_at = now

    @property
    def bytes(self) -> int:
        """Bytes of both directions."""
        return self.bytes_in + self.bytes_out

    def share(self, now: int) -> float | None:
        """The part of the time since the beginning that the line was busy (0 to 1); None without a speed."""
        return self._share(self.bytes, now - self.began)

    def since_last(self, now: int) -> float | None:
        """The same for the time since this was asked the last time."""
        found = self._share(self.bytes - self._sampled_bytes, now - self._sampled_at)
        self._sampled_at, self._sampled_bytes = now, self.bytes
        return found

    def _share(self, count: int, elapsed: int) -> float | None:
        if not self.character_time:
            return None
        return count * self.character_time / elapsed if elapsed > 0 else 0.0
