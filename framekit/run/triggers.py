"""Triggers: what makes a block due, kept so that an idle block costs nothing.

Time triggers sit in a heap, memory triggers hang on watches of the words they read, the end of a block is looked up by
its number. Nothing here starts an exchange: when a block that is due may start is the scheduler's business.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial

from framekit.definition.expression.syntax import Expression, Name, names_in
from framekit.definition.times import NEVER
from framekit.link.addresses import Address
from framekit.link.evaluate import EVALUATION_ERRORS, Names, compile_expression
from framekit.memory.memory import ALL_BITS, DeviceMemory, Watch
from framekit.run.model import Block, Changed, Rising, While

Resolve = Callable[[str], Address]


class Condition:
    """An expression over a memory; `addresses` are the places it reads, by the names it uses."""

    def __init__(self, expression: Expression, resolve: Resolve) -> None:
        self.expression = expression
        self.addresses = {name: resolve(name) for name in names_in(expression.root)}
        self._evaluate = compile_expression(expression)
        root = expression.root
        self._bit = self.addresses[root.name] if isinstance(root, Name) else None
        if self._bit is not None and self._bit.unit != "bit":
            self._bit = None

    def reader(self, memory: DeviceMemory) -> Callable[[], bool]:
        """Tells at every call whether it is true in this memory then; a condition that cannot be worked out is not."""
        bit = self._bit
        if bit is not None:  # most conditions are a bit, and nothing stands between a write and what it triggers
            return partial(memory.area(bit.area).read_bit, bit.start)
        return partial(self._holds, memory)

    def number_reader(self, memory: DeviceMemory) -> tuple[Callable[[], int], int]:
        """As `reader`, for whoever looks after each write: what reads a number, and the bit of it that says so.

        Of a bit it reads the byte, which takes no call of Python between a write and what it triggers.
        """
        bit = self._bit
        if bit is not None:
            return memory.area(bit.area).byte_reader(bit.start // 8), 1 << bit.start % 8
        return partial(self._holds, memory), 1

    def _holds(self, memory: DeviceMemory) -> bool:
        values = {
            name: memory.read(place.area, place.unit, place.start, 1)[0] for name, place in self.addresses.items()
        }
        try:
            return bool(self._evaluate(Names(values)))
        except EVALUATION_ERRORS:
            return False


Call = Callable[[], object]


def bits_of(trigger: Changed) -> int:
    """How many bits from its address on an `on_change` looks at."""
    return trigger.address.unit_bits if trigger.words is None else 16 * trigger.words


def awaited_bits(blocks: Iterable[Block], resolve: Resolve) -> set[tuple[str, int]]:
    """The bits that triggers look at, by area and number: of a memory's own bits only these have to tick."""
    found: set[tuple[str, int]] = set()
    for block in blocks:
        for trigger in block.triggers:
            if isinstance(trigger, (Rising, While)):
                places = [(one, one.unit_bits) for one in Condition(trigger.condition, resolve).addresses.values()]
            elif isinstance(trigger, Changed):
                places = [(trigger.address, bits_of(trigger))]
            else:
                continue
            found |= {(place.area, place.first_bit + bit) for place, bits in places for bit in range(bits)}
    return found


class MemoryTriggers:
    """The memory triggers of one block: looked at when a word they read changes, and once at the start.

    A condition that holds already when the run starts counts as having just come true. `unless`: whether the block is
    held back now; None where it never is. When the block comes due `note` is called, then `wake`.
    """

    def __init__(self, block: Block, memory: DeviceMemory, resolve: Resolve, note: Call, wake: Call) -> None:
        self.memory = memory
        self._note, self._wake = note, wake
        self.watches: list[Watch] = []
        unless = None if block.unless is None else Condition(block.unless, resolve)
        self.unless = None if unless is None else unless.reader(memory)
        self._levels: list[Callable[[], bool]] = []
        for trigger in block.triggers:
            if isinstance(trigger, (Rising, While)):
                condition = Condition(trigger.condition, resolve)
                if isinstance(trigger, While):
                    self._levels.append(condition.reader(memory))
                self._watch_condition(condition)
            elif isinstance(trigger, Changed):
                self._watch_change(trigger)
        if self._levels and unless is not None:
            self._watch_hold(unless)

    def _watch_condition(self, condition: Condition) -> None:
        (read, mask), before = condition.number_reader(self.memory), 0
        note, wake = self._note, self._wake

        def look(*_: object) -> None:
            nonlocal before
            now = read() & mask
            if now and not before:
                note()
                wake()
            before = now

        for address in condition.addresses.values():
            self._watch(address, address.unit_bits, look)
        look()

    def _watch_change(self, trigger: Changed) -> None:
        """Other bits of the words that it lies in do not count."""
        area, first, bits = self.memory.area(trigger.address.area), trigger.address.first_bit, bits_of(trigger)
        before = area.read_bits(first, bits)

        def look(*_: object) -> None:
            nonlocal before
            now = area.read_bits(first, bits)
            if now != before:
                before = now
                self._fire()

        self._watch(trigger.address, bits, look)

    def _watch_hold(self, unless: Condition) -> None:
        """A `while` that `unless` has held back goes on when that is over."""
        holds_back = unless.reader(self.memory)

        def look(*_: object) -> None:
            if self.level_holds() and not holds_back():
                self._fire()

        for address in unless.addresses.values():
            self._watch(address, address.unit_bits, look)

    def _fire(self) -> None:
        self._note()
        self._wake()

    def _watch(self, address: Address, bits: int, look: Callable[..., None]) -> None:
        """Of a single word only the bits asked for count; so a write to the others does not call `look`."""
        first, last = address.first_bit // 16, (address.first_bit + bits - 1) // 16
        mask = ((1 << bits) - 1) << address.first_bit % 16 if first == last else ALL_BITS
        self.watches.append(self.memory.watch(address.area, first, last - first + 1, look, mask))

    def level_holds(self) -> bool:
        """Whether a `while` condition asks for another start."""
        return bool(self._levels) and any(holds() for holds in self._levels)

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
