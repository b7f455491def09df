"""Keeps the state of a run: what was kept is put back, and written again every so often and at the end.

Writing is done by a thread of its own, one write at a time, so the run never waits for a disk; a turn that finds the
last write unfinished is left out. What cannot be written is reported and tried again at the next turn.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Iterable
from concurrent.futures import Future, ThreadPoolExecutor

from framekit.definition.fingerprint import fingerprint
from framekit.definition.times import NEVER
from framekit.memory.memory import DeviceMemory
from framekit.run.block_state import BlockState, Failure
from framekit.service.state_file import Kept, KeptBlock, StateError, StateFile
from framekit.transport.clock import Clock, Handle

log = logging.getLogger(__name__)

Words = tuple[str, int, int]
"""An area, a word of it, and how many from there on."""


class StateKeeper:
    """Keeps the areas of `file.shape` and the counters of the blocks that `states` gives, every `every` nanoseconds."""

    def __init__(
        self,
        file: StateFile,
        memory: DeviceMemory,
        states: Callable[[], Collection[BlockState]],
        clock: Clock,
        every: int,
    ) -> None:
        self.file = file
        self.memory = memory
        self.states = states
        self.clock = clock
        self.every = every
        self.problem = ""
        self._contents: dict[int, tuple[object, str]] = {}
        self._last = Kept()
        self._writing: Future[int] | None = None
        self._writer = ThreadPoolExecutor(1, "framekit-state")
        self._timer: Handle | None = None
        self._stopped = False

    # ---- putting back -------------------------------------------------------------------------------------

    def restore(self, words_of_blocks: Iterable[Words]) -> None:
        """Puts memory back, except these words, and the counters of blocks that are what they were.

        An exchange that was under way when the file was written counts as failed, `interrupted`.
        """
        kept = self.file.kept
        spared = [(area, first, self.memory.read(area, "word", first, count)) for area, first, count in words_of_blocks]
        for name, content in kept.areas.items():
            self.memory.write_bytes(name, 0, content, force=True)
        for area, first, values in spared:
            self.memory.write(area, "word", first, values, force=True)
        for state in self.states():
            found = kept.blocks.get((state.block.set, state.block.number))
            if found is not None and found.content == self._content(state):
                put_back(state, found)

    def _content(self, state: BlockState) -> str:
        """The fingerprint of a block, worked out once."""
        known = self._contents.get(id(state.block))
        if known is None:
            known = self._contents[id(state.block)] = (state.block, fingerprint(state.block))
        return known[1]

    # ---- writing ------------------------------------------------------------------------------------------

    def start(self) -> None:
        """Writes from now on; only at the end, if `every` says never."""
        if self.every < NEVER:
            self._timer = self.clock.call_at(self.clock.now() + self.every, self._turn)

    def stop(self) -> None:
        """Writes a last time, waits for that, and lets go of the file; `problem` says whether it went well.

        A second call does nothing.
        """
        if self._stopped:
            return
        self._stopped = True
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        self._see(wait=True)
        self._write()
        self._see(wait=True)
        self._writer.shutdown()
        self.file.close()

    def _turn(self) -> None:
        self.start()
        if self._see():
            self._write()

    def _see(self, wait: bool = False) -> bool:
        """How the last write went, if it has ended: whether the next may begin."""
        writing = self._writing
        if writing is None:
            return True
        if not wait and not writing.done():
            return False
        self._writing = None
        try:
            writing.result()
        except StateError as error:
            self._last = Kept()
            if str(error) != self.problem:
                log.error("%s", error)
            self.problem = str(error)
        else:
            self.problem = ""
        return True

    def _write(self) -> None:
        kept = self.kept()
        if kept != self._last:
            self._last = kept
            self._writing = self._writer.submit(self.file.save, kept)

    def kept(self) -> Kept:
        """What there is to keep now."""
        areas = {name: self.memory.read_bytes(name, 0, self.memory.area(name).size_bytes) for name in self.names()}
        blocks = [kept_of(state, self._content(state)) for state in self.states()]
        return Kept(areas, {(block.set, block.number): block for block in blocks})

    def names(self) -> list[str]:
        """The areas that are kept."""
        return [name for name, _, _ in self.file.shape]


def kept_of(state: BlockState, content: str) -> KeptBlock:
    """A block's counters and its last failure."""
    counters, failure = state.counters, state.last_failure
    return KeptBlock(
        set=state.block.set,
        number=state.block.number,
        content=content,
        started=counters.started,
        done=counters.done,
        failed=counters.failed,
        overruns=counters.overruns,
        outcome="" if failure is None else failure.outcome,
        cause="" if failure is None else failure.cause,
        device_code=None if failure is None else failure.device_code,
        meaning="" if failure is None else failure.meaning,
    )


def put_back(state: BlockState, kept: KeptBlock) -> None:
    """Gives a block its counters and its last failure back."""
    interrupted = kept.started - kept.done - kept.failed
    counters = state.counters
    counters.started, counters.done, counters.overruns = kept.started, kept.done, kept.overruns
    counters.failed = kept.failed + interrupted
    if interrupted:
        state.last_failure = Failure(outcome="interrupted")
    elif kept.outcome:
        state.last_failure = Failure(
            outcome=kept.outcome, cause=kept.cause, device_code=kept.device_code, meaning=kept.meaning
        )
