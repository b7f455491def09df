"""The words in memory that belong to the blocks of a run: their state is shown there, their settings come from there.

Brings status words and settings together with the scheduler's blocks. Sans-I/O: the owner tells the time.
"""

from __future__ import annotations

from framekit.blocks.block_settings import BlockSettings, settings_sections
from framekit.blocks.block_state import BlockState
from framekit.blocks.block_status import BlockStatus
from framekit.blocks.model import Block
from framekit.blocks.status_words import StatusWords, status_sections
from framekit.definition.model.protocol import Protocol
from framekit.memory.memory import DeviceMemory
from framekit.memory.profile import MemoryProfile


class BlockMemory:
    """The words of blocks in `memory`; with `shown` false there are none, and all of it is plain memory.

    `areas`: the names of the areas that they stand in.
    """

    def __init__(self, memory: DeviceMemory, profile: MemoryProfile, shown: bool = True) -> None:
        sections = tuple(profile.flags.values()) if shown else ()
        self.areas = {section.area for section in sections}
        self.words = StatusWords(memory, status_sections(sections), profile.scan)
        self.settings = BlockSettings(memory, settings_sections(sections))

    def add(self, state: BlockState, protocol: Protocol | None) -> None:
        """A block of the run: its state is put into its words, and its settings, if a protocol says what they are."""
        if protocol is not None:
            self.settings.show(state.block, protocol)
        self.words.show(state.key, state)

    def remove(self, block: Block) -> None:
        """A block is no more: its words are free, and 0."""
        self.settings.forget((block.set, block.number))
        self.words.forget((block.set, block.number))

    def effective(self, block: Block) -> Block:
        """The block with its settings as they stand in memory. Raises SettingError."""
        return self.settings.effective(block)

    def started(self, state: BlockState) -> None:
        """An exchange begins."""
        if self.words.shows_starts:
            self.words.show(state.key, state)

    def changed(self, state: BlockState) -> None:
        """Something about a block is different, such as whether it is enabled."""
        self.words.show(state.key, state)

    def ended(self, state: BlockState, ok: bool, now: int) -> None:
        """A completion: counts, error and one pulse."""
        self.words.completed(state.key, state, ok, now)

    def places(self, block: Block) -> list[tuple[str, int, int]]:
        """The words of a block: area, first word, how many."""
        key = (block.set, block.number)
        return [
            (section.area, first, section.words)
            for section, first in (*self.words.words(key), *self.settings.words(key))
        ]

    @property
    def deadline(self) -> int:
        """When `tick` has something to do."""
        return self.words.deadline

    def tick(self, now: int) -> None:
        """Ends the pulses whose time is over."""
        self.words.tick(now)


def status_of(state: BlockState) -> BlockStatus:
    """A block's state and counters as they are now."""
    block, counters = state.block, state.counters
    return BlockStatus(
        set=block.set,
        block=block.number,
        name=block.name,
        instruction=block.instruction,
        channel=block.channel,
        enabled=state.enabled,
        waiting=state.waiting,
        started=counters.started,
        done=counters.done,
        failed=counters.failed,
        overruns=counters.overruns,
        dead=state.dead,
        last_failure=state.last_failure,
        last_end=state.last_end,
    )
