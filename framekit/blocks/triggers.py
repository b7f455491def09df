"""Triggers at work: what makes a block due, kept so that an idle block costs nothing.

Time triggers sit in the scheduler's heap, memory triggers hang on watches of the words they read, the end of a block is
looked up by its number. Nothing here starts an exchange.
"""

from __future__ import annotations

from collections.abc import Callable

from framekit.blocks.conditions import Condition, Resolve
from framekit.blocks.model import Block, Changed, Rising, While
from framekit.definition.times import NEVER
from framekit.link.addresses import Address
from framekit.memory.memory import DeviceMemory
from framekit.memory.watch import Watch

Fire = Callable[[Block], None]


def words_of(address: Address, element_bits: int, count: int = 1) -> tuple[int, int]:
    """First word and number of words that `count` elements of `element_bits` at an address lie in."""
    first = address.start * element_bits // 16
    last = ((address.start + count) * element_bits - 1) // 16
    return first, last - first + 1


UNIT_BITS = {"bit": 1, "byte": 8, "word": 16, "dword": 32, "lword": 64}


class MemoryTriggers:
    """The memory triggers of one block: looked at when a word they read changes, and once at the start.

    A condition that holds already when the run starts counts as having just come true.
    """

    def __init__(self, block: Block, memory: DeviceMemory, resolve: Resolve, fire: Fire) -> None:
        self.block = block
        self.memory = memory
        self.fire = fire
        self.watches: list[Watch] = []
        self.levels: list[Condition] = []
        for trigger in block.triggers:
            if isinstance(trigger, (Rising, While)):
                self._watch_condition(Condition(trigger.condition, resolve), isinstance(trigger, While))
            elif isinstance(trigger, Changed):
                self._watch(trigger.address, trigger.words, lambda *_: self.fire(self.block))

    def _watch_condition(self, condition: Condition, level: bool) -> None:
        if level:
            self.levels.append(condition)
        before = False

        def look(*_: object) -> None:
            nonlocal before
            now = condition.holds(self.memory)
            if now and not before:
                self.fire(self.block)
            before = now

        for address in condition.addresses.values():
            self._watch(address, 1, look)
        look()

    def _watch(self, address: Address, count: int, look: Callable[..., None]) -> None:
        first, words = words_of(address, UNIT_BITS[address.unit], count)
        self.watches.append(self.memory.watch(address.area, first, words, look))

    def level_holds(self) -> bool:
        """Whether a `while` condition asks for another start."""
        return any(condition.holds(self.memory) for condition in self.levels)

    def cancel(self) -> None:
        for watch in self.watches:
            watch.cancel()


class Cycle:
    """A regular cycle: due times are `origin + n × period`; those that were missed are skipped, the phase stays."""

    def __init__(self, origin: int, period: int) -> None:
        self.due = origin
        self.period = period

    def step(self, now: int) -> int:
        """Moves to the first due time after `now`; how many were missed beside the one just taken."""
        if self.period <= 0:
            self.due = NEVER
            return 0
        steps = max(1, (now - self.due) // self.period + 1)
        self.due += steps * self.period
        return steps - 1
