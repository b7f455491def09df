"""Triggers: what makes a block due, kept so that an idle block costs nothing.

A kind of trigger is a class and a row of `TRIGGERS`: its keys in a block and how they are read, what it hangs on while
the block is armed (`arm`), and how often it makes blocks due, where that is known (`periods`). Time triggers sit in a
heap, memory triggers hang on watches of the words they read, the end of a block is looked up by its number. Nothing
here starts an exchange: when a block that is due may start is the scheduler's business.
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


# ---- what triggers are made of --------------------------------------------------------------------------------


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
        """As `reader`, for a look after each write: what reads a number, and the bit of it that says so.

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


class ArmedTriggers:
    """The triggers of one block while it is armed; they call what is here when the block is due.

    `note` and `wake` are called when it comes due by something in memory; `at(when, cycle)` makes it due at a time.
    `unless`: whether the block is held back now; None where it never is. `levels`: each asks for another start.
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
        self.unless: Callable[[], bool] | None = None

    def arm(self, triggers: Iterable[Trigger], unless: Expression | None, now: int) -> None:
        """From now on the triggers make the block due, unless that condition holds it back."""
        held = None if unless is None else Condition(unless, self.resolve)
        self.unless = None if held is None else held.reader(self.memory)
        for trigger in triggers:
            trigger.arm(self, now)
        if self.levels and held is not None:
            self._watch_hold(held)

    def fire(self) -> None:
        """The block is due."""
        self._note()
        self._wake()

    def watch(self, address: Address, bits: int, look: Callable[..., None]) -> None:
        """Calls `look` when bits from an address on change: of a single word only these, of several each bit."""
        first, last = address.first_bit // 16, (address.first_bit + bits - 1) // 16
        mask = ((1 << bits) - 1) << address.first_bit % 16 if first == last else ALL_BITS
        self._watches.append(self.memory.watch(address.area, first, last - first + 1, look, mask))

    def watch_condition(self, condition: Condition) -> None:
        """Fires when the condition comes true; one that holds already has just come true."""
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
        """Asks for another start as long as the condition holds."""
        self.levels.append(condition.reader(self.memory))
        self.watch_condition(condition)

    def _watch_hold(self, unless: Condition) -> None:
        """A level that `unless` has held back goes on when that is over."""
        holds_back = unless.reader(self.memory)

        def look(*_: object) -> None:
            if self.level_holds() and not holds_back():
                self.fire()

        for address in unless.addresses.values():
            self.watch(address, address.unit_bits, look)

    def level_holds(self) -> bool:
        """Whether a level asks for another start."""
        return bool(self.levels) and any(holds() for holds in self.levels)

    def cancel(self) -> None:
        """Nothing in memory makes the block due any more."""
        for watch in self._watches:
            watch.cancel()


class KnownPeriods(Protocol):
    """What is known of a run when periods (ns) are worked out."""

    def of_condition(self, condition: Expression) -> Iterable[int]:
        """Periods in which a condition rises, as far as clocks and ends of blocks say so."""

    def of_block(self, number: int) -> Iterable[int]:
        """The period of another block of the set."""


class TriggerReader:
    """Reads triggers of blocks; `address` and `condition` read the own memory's, `room` notes what is beyond it."""

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
        """All triggers of a block. Raises Broken after all of them have been looked at."""
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
        """A time (ns) at which something can be. Raises Broken."""
        time = self.reader.time(node)
        if time >= NEVER:
            raise self.reader.broken(node.at, "never is no time to start at", "give a time such as 200 ms")
        return time

    def waits_for(self, number: int, node: Node) -> None:
        """A trigger waits for the end of a block; whether there is such a block is known later."""
        self._ends.append((number, node))

    def check_ends(self, numbers: set[int]) -> None:
        """Notes triggers that wait for a block there is not."""
        for number, node in self._ends:
            if number not in numbers:
                known = ", ".join(map(str, sorted(numbers)))
                self.reader.note(node.at, f"there is no block {number} to wait for", f"known: {known}")
        self._ends.clear()


# ---- the kinds ------------------------------------------------------------------------------------------------


class Trigger(ABC):
    """What makes a block due. A kind is a frozen value: runs that go on compare theirs with those of an edited file."""

    __slots__ = ()

    @property
    def is_cycle(self) -> bool:
        """Whether it makes the block due again and again by itself, in a time that is known."""
        return False

    @property
    def follows(self) -> tuple[int, bool] | None:
        """The block of the set whose end it waits for, and whether that has to be a good one."""
        return None

    @abstractmethod
    def arm(self, armed: ArmedTriggers, now: int) -> None:
        """Hangs it on what makes the block due. The end of a block that it `follows` needs nothing."""

    def periods(self, known: KnownPeriods) -> Iterable[int]:
        """How often it makes the block due (ns), if that is known."""
        return ()

    def places(self, resolve: Resolve) -> Iterable[tuple[Address, int]]:
        """What it looks at in memory: addresses, and how many bits from there on."""
        return ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Every(Trigger):
    """A regular cycle: due at `phase` after the start and every `period` (ns) from there, without drift."""

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
    """Due when the expression over memory goes from false to true."""

    condition: Expression

    def arm(self, armed: ArmedTriggers, now: int) -> None:
        armed.watch_condition(Condition(self.condition, armed.resolve))

    def periods(self, known: KnownPeriods) -> Iterable[int]:
        return known.of_condition(self.condition)

    def places(self, resolve: Resolve) -> Iterable[tuple[Address, int]]:
        return [(one, one.unit_bits) for one in Condition(self.condition, resolve).addresses.values()]


@dataclass(frozen=True, slots=True, kw_only=True)
class While(Trigger):
    """Due again and again, as long as the expression over memory is true."""

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
    """Due when the place changes, or one of `words` words from it on."""

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
        """How many bits from its address on it looks at."""
        return self.address.unit_bits if self.words is None else 16 * self.words

    def arm(self, armed: ArmedTriggers, now: int) -> None:
        """Other bits of the words that it lies in do not count."""
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
        """Nothing: ends are looked up by the number of the block, also while this one is not armed."""

    def periods(self, known: KnownPeriods) -> Iterable[int]:
        return known.of_block(self.block) if self.ok else ()


_BLOCK_END = re.compile(r"block\s+(\d+)\s+(done|failed)")


def load_when(read: TriggerReader, node: Node, keys: MappingNode) -> Trigger:
    """An item of `when`: the end of a block, or a condition."""
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
"""Reads the value of a key of a block; also the other keys of the block are given. None: no trigger. Raises Broken."""


class TriggerKind(NamedTuple):
    """How the key is read, and the schemas of the keys of a block that belong to it, its own first."""

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
"""By the key of a block. `when` may have a list, each item of which is read."""


def add_trigger(key: str, load: Load, schema: Schema) -> None:
    """Registers a kind of trigger; `schema` is the JSON schema of its value.

    Raises ValueError for a key that another module has, and for what is no schema.
    """
    add_keys("run", "block", {key: schema}, load.__module__)
    TRIGGERS[key] = TriggerKind(load, {key: schema})


def awaited_bits(triggers: Iterable[Trigger], resolve: Resolve) -> set[tuple[str, int]]:
    """The bits that triggers look at, by area and number: of a memory's own bits only these have to tick."""
    return {
        (place.area, place.first_bit + bit)
        for trigger in triggers
        for place, bits in trigger.places(resolve)
        for bit in range(bits)
    }
