"""The ninth bit of characters: how far a frame reaches by it, and whether it stands where the frame's `mark` says.

On a line of nine bits (guide: lines) a marked byte is the first of some frames and the last of others; nothing else is
marked. So a frame ends before the next marked byte, or with it, whatever its bytes say.
"""

from __future__ import annotations

from bisect import bisect_left

from framekit.link.frame_table import FrameInfo
from framekit.link.stream import Stream


def marked_in(info: FrameInfo, size: int) -> int | None:
    """Which byte of a frame of `size` bytes is marked; None for none."""
    mark = info.frame.mark
    if mark == "first":
        return 0
    return size - 1 if mark == "last" else None


class Marks:
    """Looks at the marks in a stream."""

    __slots__ = ("_stream",)

    def __init__(self, stream: Stream) -> None:
        self._stream = stream

    def next(self, index: int) -> int | None:
        """The buffer index of the first marked byte from `index` on."""
        marks = self._stream.marks
        found = bisect_left(marks, self._stream.base + index)
        return marks[found] - self._stream.base if found < len(marks) else None

    def beginning(self, levels: tuple[tuple[FrameInfo, ...], ...]) -> tuple[tuple[FrameInfo, ...], ...]:
        """Those that may begin at the present place; all of them where none may, so that one can be told as bad."""
        position = self._stream.position
        is_marked = self.next(position) == position
        fitting = tuple(
            tuple(info for info in infos if info.frame.mark == "last" or (info.frame.mark == "first") is is_marked)
            for infos in levels
        )
        return fitting if any(fitting) else levels

    def end_for(self, info: FrameInfo, limit: int) -> int:
        """How far a frame that begins at the present place can reach, up to `limit` (buffer index)."""
        found = self._end(info)
        return limit if found is None else min(limit, found + (info.frame.mark == "last"))

    def ends(self, info: FrameInfo, size: int) -> bool:
        """Whether a frame of `size` bytes at the present place may end there: one with a marked last byte has it."""
        last = self._stream.position + size - 1
        return info.frame.mark != "last" or self.next(last) == last

    def stops(self, info: FrameInfo, limit: int) -> bool:
        """Whether a mark ends a frame that begins at the present place before `limit` (buffer index)."""
        found = self._end(info)
        return found is not None and found < limit

    def _end(self, info: FrameInfo) -> int | None:
        """The mark that ends it."""
        return self.next(self._stream.position + (info.frame.mark != "last"))

    def wrong_in(self, info: FrameInfo, start: int, end: int) -> int | None:
        """The first byte of a frame in `buffer[start:end]` (0 = first) that is marked and should not be, or not marked
        and should be.
        """
        wanted = marked_in(info, end - start)
        found = self.next(start)
        is_there = found is not None and found < end
        if wanted is None:
            return found - start if is_there and found is not None else None
        if not is_there or found is None or found - start > wanted:
            return wanted
        if found - start < wanted:
            return found - start
        more = self.next(found + 1)
        return more - start if more is not None and more < end else None
