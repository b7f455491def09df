"""What blocks have counted that an edit of the run took out or changed, so that totals never go backwards."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field

from framekit.blocks.block_state import BlockState


@dataclass(slots=True)
class RemovedBlocks:
    """The counts of all blocks of a channel that are there no more; commands to jobs count for channel 0.

    `blocks` is how many they were; one that was changed counts, as it began anew. None of them runs.
    """

    channel: int
    blocks: int = 0
    started: int = 0
    done: int = 0
    failed: int = 0
    overruns: int = 0
    reasons: Counter[str] = field(default_factory=Counter)


class Removed:
    """Those of a run, by channels; none before the first edit."""

    def __init__(self) -> None:
        self._channels: dict[int, RemovedBlocks] = {}

    def __iter__(self) -> Iterator[RemovedBlocks]:
        return iter([one for _, one in sorted(self._channels.items())])

    def of(self, channel: int) -> RemovedBlocks:
        """What is gone of a channel."""
        return self._channels.get(channel) or RemovedBlocks(channel)

    def add(self, state: BlockState) -> None:
        """A block is taken out, with what it has counted."""
        if not (state.started or state.overruns):
            return
        one = self._channels.setdefault(state.block.channel, RemovedBlocks(state.block.channel))
        one.blocks += 1
        one.started += state.started
        one.done += state.done
        one.failed += state.failed
        one.overruns += state.overruns
        one.reasons.update(state.reasons)

    def clear(self) -> None:
        """Counting begins anew."""
        self._channels.clear()
