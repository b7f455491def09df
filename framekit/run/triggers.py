"""Triggers: the conditions that make a block due, at no cost for an idle block.

A kind of trigger is a class and a row of `TRIGGERS`: its keys in a block and their schemas, the registration at its
sources while the block is armed (`arm`), and the periods at which it makes blocks due, if known (`periods`). Time
triggers are in a heap, memory triggers are watches of the words that they read, and the end of a block is looked up by
its number. This module starts no exchange: the scheduler decides when a due block may start.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple, Protocol

from framekit.definition.expression import Expression, Name, names_in
from framekit.definition.keys import Schema, ref
from framekit.definition.load.reader import Broken, Reader
from framekit.definition.nodes import Mapping as MappingNode
from framekit.definition.nodes import Node
from framekit.definition.schema import add_keys
from framekit.definition.times import NEVER
from framekit.link.addresses import Address
from framekit.link.values import EVALUATION_ERRORS, Names, compile_expression
from framekit.memory.memory import ALL_BITS, DeviceMemory, Watch

Resolve = Callable[[str], Address]
Call = Callable[[], object]


# ---- parts of triggers ----------------------------------------------------------------------------------------


class Condition:
    """An expression over a memory; `addresses` are the places that it reads, by the names in the expression."""

    def __init__(self, expression: Expression, resolve: Resolve) -> None:
        self.expression = expression
        self.addresses = {name: resolve(name) for name in names_in(expression.root)}
        self._evaluate = compile_expression(expression)
        root = expression.root
        self._bit = self.addresses[root.name] if isinstance(root, Name) else None
        if self._bit is not None and self._bit.unit != "bit":
            self._bit = None

    def reader(self, memory: DeviceMemory) -> Callable[[], bool]:
        """Return a function that evaluates the condition; a condition that cannot be evaluated is false."""
        bit = self._bit
        if bit is not None:  # most conditions are a bit: no expression is evaluated
            return partial(memory.area(bit.area).read_bit, bit.start)
        return partial(self._holds, memory)

    def number_reader(self, memory: DeviceMemory) -> tuple[Callable[[], int], int]:
        """Return a function that reads a number after each write, and the mask of the bit that shows the condition.

        For a condition of a single bit it reads the byte of the bit, without a Python call between a write and its
        trigger.
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


class Cycle:
    """A regular cycle: due times are `origin + n × period`. Missed times are skipped; the phase stays."""

    def __init__(self, origin: int, period: int) -> None:
        self.due = origin
        self.period = period

    def step(self, now: int) -> int:
        """Move to the first due time after `now`; return the number of times missed, without the one that was due."""
        if self.period <= 0:
            self.due = NEVER
            return 0
        steps = max(1, (now - self.due) // self.period + 1)
        self.due += steps * self.period
        return steps - 1


class ArmedTriggers:
    """The triggers of one block while it is armed; they call the given functions when the block is due.

    `note` and `wake` are called when memory makes the block due; `at(when, cycle)` makes it due at a time.
    """

    def __init__(
        self, memory: DeviceMemory, resolve: Resolve, note: Call, wake: Call, at: Callable[[int, Cycle | None], None]
    ) -> None:
        self.memory = memory
        self.resolve = resolve
        self.at = at
        self._note, self._wake = note, wake
        self._watches: list[Watch] = []
        self.levels: list[Callable[[], bool]] = []
        """The conditions that request another start as long as they hold."""
        self.unless: Callable[[], bool] | None = None
        """Return whether the block is held back now; None if it has no such condition."""

    def arm(self, triggers: Iterable[Trigger], unless: Expression | None, now: int) -> None:
        """Arm the triggers; while the condition `unless` holds, the block is held back."""
        held = None if unless is None else Condition(unless, self.resolve)
        self.unless = None if held is None else held.reader(self.memory)
        for trigger in triggers:
            trigger.arm(self, now)
        if self.levels and held is not None:
            self._watch_hold(held)

    def fire(self) -> None:
        """Make the block due."""
        self._note()
        self._wake()

    def watch(self, address: Address, bits: int, look: Callable[..., None]) -> None:
        """Call `look` on changes of bits from an address on.

        Bits within one word: only their changes count; else changes of all bits of the words.
        """
        first, last = address.first_bit // 16, (address.first_bit + bits - 1) // 16
        mask = ((1 << bits) - 1) << address.first_bit % 16 if first == last else ALL_BITS
        self._watches.append(self.memory.watch(address.area, first, last - first + 1, look, mask))

    def watch_condition(self, condition: Condition) -> None:
        """Fire when the condition becomes true; a condition that is already true fires at once."""
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
            self.watch(address, address.unit_bits, look)
        look()

    def watch_level(self, condition: Condition) -> None:
        """Request another start as long as the condition holds."""
        self.levels.append(condition.reader(self.memory))
        self.watch_condition(condition)

    def _watch_hold(self, unless: Condition) -> None:
        """Fire for a level that `unless` has held back, when `unless` ends."""
        holds_back = unless.reader(self.memory)

        def look(*_: object) -> None:
            if self.level_holds() and not holds_back():
                self.fire()

        for address in unless.addresses.values():
            self.watch(address, address.unit_bits, look)

    def level_holds(self) -> bool:
        """Return whether a level requests another start."""
        return bool(self.levels) and any(holds() for holds in self.levels)

    def cancel(self) -> None:
        """Cancel the watches: memory no longer makes the block due."""
        for watch in self._watches:
            watch.cancel()


class KnownPeriods(Protocol):
    """The periods (ns) of a run that its clocks and cycles define."""

    def of_condition(self, condition: Expression) -> Iterable[int]:
        """Return the periods in which a condition becomes true, as far as clocks and ends of blocks define them."""

    def of_block(self, number: int) -> Iterable[int]:
        """Return the periods of another block of the set."""


class TriggerReader:
    """Read the triggers of blocks.

    `address` and `condition` read addresses and expressions of the own memory; `room` reports a place beyond its area.
    """

    def __init__(
        self, reader: Reader, address: Callable[[Node], Address], condition: Callable[[Node], Expression],
        room: Callable[[Node, Address, int], None],
    ) -> None:  # fmt: skip
        self.reader = reader
        self.address = address
        self.condition = condition
        self.room = room
        self._ends: list[tuple[int, Node]] = []

    def triggers(self, keys: MappingNode) -> tuple[Trigger, ...]:
        """Return all triggers of a block. Raise Broken after all of them have been checked."""
        found: list[Trigger] = []
        broken = False
        for key, kind in TRIGGERS.items():
            node = keys.get(key)
            for item in () if node is None else self.reader.items(node) if key == "when" else (node,):
                try:
                    trigger = kind.load(self, item, keys)
                except Broken:
                    broken = True
                    continue
                if trigger is not None:
                    found.append(trigger)
        if broken:
            raise Broken("triggers")
        return tuple(found)

    def some_time(self, node: Node) -> int:
        """Return a finite time (ns). Raise Broken."""
        time = self.reader.time(node)
        if time >= NEVER:
            raise self.reader.broken(node.at, "never is no time to start at", "give a time such as 200 ms")
        return time

    def waits_for(self, number: int, node: Node) -> None:
        """Note that a trigger waits for the end of a block; `check_ends` checks later that the block exists."""
        self._ends.append((number, node))

    def check_ends(self, numbers: set[int]) -> None:
        """Report triggers that wait for a missing block."""
        for number, node in self._ends:
            if number not in numbers:
                known = ", ".join(map(str, sorted(numbers)))
                self.reader.note(node.at, f"there is no block {number} to wait for", f"known: {known}")
        self._ends.clear()


# ---- the kinds ------------------------------------------------------------------------------------------------


class Trigger(ABC):
    """A condition that makes a block due.

    A kind is a frozen value: an edit of a running run compares old and new triggers.
    """

    __slots__ = ()

    @property
    def is_cycle(self) -> bool:
        """Return whether the trigger repeats by itself with a known period."""
        return False

    @property
    def follows(self) -> tuple[int, bool] | None:
        """Return the block whose end it waits for, and whether that end must be good; None for other triggers."""
        return None

    @abstractmethod
    def arm(self, armed: ArmedTriggers, now: int) -> None:
        """Register the trigger at its source. A trigger that `follows` a block needs no registration."""

    def periods(self, known: KnownPeriods) -> Iterable[int]:
        """Return the periods at which it makes the block due (ns), if they are known."""
        return ()

    def places(self, resolve: Resolve) -> Iterable[tuple[Address, int]]:
        """Return the addresses that it reads in memory, each with the number of bits."""
        return ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Every(Trigger):
    """A regular cycle: due at `phase` after the start, then every `period` (ns), without drift."""

    period: int
    phase: int = 0

    @classmethod
    def load(cls, read: TriggerReader, node: Node, keys: MappingNode) -> Every:
        period = read.some_time(node)
        if period <= 0:
            raise read.reader.broken(node.at, "a cycle of no time never ends", "give a time such as 200 ms")
        phase = keys.get("phase")
        return cls(period=period, phase=period if phase is None else read.some_time(phase))

    @property
    def is_cycle(self) -> bool:
        return True

    def arm(self, armed: ArmedTriggers, now: int) -> None:
        armed.at(now + self.phase, Cycle(now + self.phase, self.period))

    def periods(self, known: KnownPeriods) -> Iterable[int]:
        return (self.period,)


@dataclass(frozen=True, slots=True, kw_only=True)
class Rising(Trigger):
    """Due when the expression over memory changes from false to true."""

    condition: Expression

    def arm(self, armed: ArmedTriggers, now: int) -> None:
        armed.watch_condition(Condition(self.condition, armed.resolve))

    def periods(self, known: KnownPeriods) -> Iterable[int]:
        return known.of_condition(self.condition)

    def places(self, resolve: Resolve) -> Iterable[tuple[Address, int]]:
        return [(one, one.unit_bits) for one in Condition(self.condition, resolve).addresses.values()]


@dataclass(frozen=True, slots=True, kw_only=True)
class While(Trigger):
    """Due again and again as long as the expression over memory is true."""

    condition: Expression

    @classmethod
    def load(cls, read: TriggerReader, node: Node, keys: MappingNode) -> While:
        return cls(condition=read.condition(node))

    def arm(self, armed: ArmedTriggers, now: int) -> None:
        armed.watch_level(Condition(self.condition, armed.resolve))

    def places(self, resolve: Resolve) -> Iterable[tuple[Address, int]]:
        return [(one, one.unit_bits) for one in Condition(self.condition, resolve).addresses.values()]


@dataclass(frozen=True, slots=True, kw_only=True)
class Changed(Trigger):
    """Due when the place changes, or one of the `words` words from it on."""

    address: Address
    words: int | None = None

    @classmethod
    def load(cls, read: TriggerReader, node: Node, keys: MappingNode) -> Changed:
        address = read.address(node)
        words = None if (count := keys.get("words")) is None else read.reader.number(count)
        if words is not None and words < 1 and count is not None:
            raise read.reader.broken(count.at, f"{words} words never change", "give 1 or more")
        trigger = cls(address=address, words=words)
        read.room(node if count is None else count, address, trigger.bits)
        return trigger

    @property
    def bits(self) -> int:
        """Return the number of watched bits from its address on."""
        return self.address.unit_bits if self.words is None else 16 * self.words

    def arm(self, armed: ArmedTriggers, now: int) -> None:
        """Watch the bits; changes of other bits of the same words do not count."""
        area, first, bits = armed.memory.area(self.address.area), self.address.first_bit, self.bits
        before = area.read_bits(first, bits)

        def look(*_: object) -> None:
            nonlocal before
            there = area.read_bits(first, bits)
            if there != before:
                before = there
                armed.fire()

        armed.watch(self.address, bits, look)

    def places(self, resolve: Resolve) -> Iterable[tuple[Address, int]]:
        return ((self.address, self.bits),)


@dataclass(frozen=True, slots=True, kw_only=True)
class AfterStart(Trigger):
    """Due once, `delay` ns after the start; `once` is a delay of 0."""

    delay: int

    @classmethod
    def load(cls, read: TriggerReader, node: Node, keys: MappingNode) -> AfterStart:
        return cls(delay=read.some_time(node))

    @classmethod
    def load_once(cls, read: TriggerReader, node: Node, keys: MappingNode) -> AfterStart | None:
        return cls(delay=0) if read.reader.flag(node) else None

    def arm(self, armed: ArmedTriggers, now: int) -> None:
        armed.at(now + self.delay, None)


@dataclass(frozen=True, slots=True, kw_only=True)
class BlockEnd(Trigger):
    """Due when another block of the set ends well (`done`) or badly (`failed`)."""

    block: int
    ok: bool

    @property
    def follows(self) -> tuple[int, bool] | None:
        return self.block, self.ok

    def arm(self, armed: ArmedTriggers, now: int) -> None:
        """Register nowhere: ends are looked up by the number of the block, also while this trigger is not armed."""

    def periods(self, known: KnownPeriods) -> Iterable[int]:
        return known.of_block(self.block) if self.ok else ()


_BLOCK_END = re.compile(r"block\s+(\d+)\s+(done|failed)")


def load_when(read: TriggerReader, node: Node, keys: MappingNode) -> Trigger:
    """Return an item of `when`: the end of a block, or a condition."""
    text = read.reader.text(node).strip()
    match = _BLOCK_END.fullmatch(text)
    if match is None and re.match(r"block\s", text):
        raise read.reader.broken(node.at, f"'{text}' is no end of a block", "write block N done or block N failed")
    if match is None:
        return Rising(condition=read.condition(node))
    end = BlockEnd(block=int(match[1]), ok=match[2] == "done")
    read.waits_for(end.block, node)
    return end


_WHEN = (
    "Trigger: a bit or an expression over memory that becomes true, or block N done, block N failed; or a list of them."
)

Load = Callable[[TriggerReader, Node, MappingNode], Trigger | None]
"""Read the value of a key of a block; the third argument has all keys of the block. None: no trigger. Raise Broken."""


class TriggerKind(NamedTuple):
    """The loader of a key, and the schemas of the keys of a block that belong to it, with its own key first."""

    load: Load
    schemas: Mapping[str, Schema]


def _kind(load: Load, **keys: tuple[str, str]) -> TriggerKind:
    return TriggerKind(load, {key: {**ref(form), "description": text} for key, (form, text) in keys.items()})


TRIGGERS: dict[str, TriggerKind] = {
    "every": _kind(
        Every.load,
        every=("time", "Regular cycle; the period of a job's transfers, 0 s: back to back."),
        phase=("time", "First time of the cycle after the start; default: one period."),
    ),
    "when": _kind(load_when, when=("texts", _WHEN)),
    "while": _kind(While.load, **{"while": ("expression", "Runs again and again while this is true.")}),
    "on_change": _kind(
        Changed.load,
        on_change=("address", "Trigger: the place changes."),
        words=("number", "How many words on_change looks at; default 1."),
    ),
    "once": _kind(AfterStart.load_once, once=("flag", "yes: runs once, at the start.")),
    "after": _kind(AfterStart.load, after=("time", "Runs once, so long after the start.")),
}
"""The kinds of triggers, by their key in a block. A list under `when` is read item by item."""


def add_trigger(key: str, load: Load, schema: Schema) -> None:
    """Register a kind of trigger; `schema` is the JSON schema of its value.

    Raise ValueError for a key of another module, and for an invalid schema.
    """
    add_keys("run", "block", {key: schema}, load.__module__)
    TRIGGERS[key] = TriggerKind(load, {key: schema})


def awaited_bits(triggers: Iterable[Trigger], resolve: Resolve) -> set[tuple[str, int]]:
    """Return the bits that triggers read, by area and number; a memory must update its own bits only for these."""
    return {
        (place.area, place.first_bit + bit)
        for trigger in triggers
        for place, bits in trigger.places(resolve)
        for bit in range(bits)
    }
