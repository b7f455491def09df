"""What a live display shows of lines at work: channels with their load, blocks, frames. It has no display itself.

A run and a monitor both fill one; whoever draws asks it, as often as it likes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from framekit.run.block_state import BlockStatus
from framekit.service.frame_log import FrameLog
from framekit.service.line_load import LineLoad
from framekit.transport.clock import Clock


@dataclass(frozen=True, slots=True)
class ChannelView:
    """One line: what it is called, whether it is open, and the part of the time it is busy, lately and altogether."""

    number: int
    name: str
    state: str
    load_now: float | None
    load: float | None


@dataclass(frozen=True, slots=True)
class LineOf:
    """Where a channel's data comes from."""

    name: str
    state: Callable[[], str]
    load: LineLoad


class LiveView:
    """`blocks` tells how the blocks are doing; without blocks there are none."""

    def __init__(
        self,
        log: FrameLog,
        clock: Clock,
        lines: Mapping[int, LineOf],
        blocks: Callable[[], list[BlockStatus]] = list,
    ) -> None:
        self.log = log
        self.blocks = blocks
        self._clock = clock
        self._lines = lines
        self.began = clock.now()

    @property
    def elapsed(self) -> int:
        """Since it began (ns)."""
        return self._clock.now() - self.began

    def seconds(self, at: int) -> float:
        """A time of the clock in seconds since it began."""
        return (at - self.began) / 1e9

    def channels(self) -> list[ChannelView]:
        """The lines as they are now; `load_now` is of the time since this was asked the last time."""
        now = self._clock.now()
        return [
            ChannelView(number, line.name, line.state(), line.load.since_last(now), line.load.share(now))
            for number, line in self._lines.items()
        ]
