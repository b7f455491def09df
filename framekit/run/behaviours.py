"""Behaviours: values in the memory of a simulated device that change by themselves, with time and with each other.

A kind of behaviour is a class and a row of `BEHAVIOURS`: `key` declares its keys in a device file (the first one names
the kind), and `value` computes the value at a moment. A behaviour is frozen; it continues from the values in memory.

`Behaving` runs the behaviours of a device. It is sans-I/O: its owner passes the time. Each behaviour is computed at
`after`, `after + every`, `after + 2 × every` … from the start; missed times are skipped. At each moment, behaviours
without a formula and those that continue from their last value (counters, walks, followers with a lag) are computed
from the memory before the moment; the other formulas follow and see all values stored so far. A number outside the
range of its type is limited to the range, or wraps to the other end (`wraps`). A value that cannot be computed leaves
the memory as it is and is reported.
"""

from __future__ import annotations

import heapq
import math
import random
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import partial
from typing import Any, ClassVar, NamedTuple

from framekit.definition.expression import Expression
from framekit.definition.keys import IDENTIFIER, NUMBER, TEXT, Form, KeyReading, key, kind_schema, ref, words
from framekit.definition.model.services import UNIT_BITS
from framekit.definition.nodes import Node
from framekit.definition.problems import Position
from framekit.definition.schema import add_kind_of
from framekit.definition.times import NEVER
from framekit.link.packing import memory_of
from framekit.link.values import EVALUATION_ERRORS, compile_optional
from framekit.memory.memory import DeviceMemory
from framekit.memory.views import ORDERS, VIEWS
from framekit.run.model import Point
from framekit.run.points import scaled, unscaled

SHORTEST = 1_000_000
"""The shortest period of a behaviour, and of the times in its keys (ns)."""
SECOND = 1_000_000_000
TYPES = tuple(name for name in (*UNIT_BITS, *VIEWS) if name != "string")
"""The types of the values that a behaviour can set."""


class BehaviourMoment(NamedTuple):
    """The moment for which a value is computed."""

    time: int
    """The time since the first computation was due (ns), a multiple of `every`."""
    passed: int
    """The time since the last computation (ns): 0 for the first computation, then a multiple of `every`."""
    before: Callable[[], float]
    """Return the present value of the place."""
    worked_out: Callable[[], float]
    """Return the result of the formula for the present values in memory."""
    dice: random.Random
    """A random generator with a seed, so that runs are repeatable."""


# ---- forms of values ------------------------------------------------------------------------------------------


def _period(reading: KeyReading, node: Node) -> int:
    time = reading.reader.time(node)
    if not SHORTEST <= time < NEVER:
        what = f"'{reading.reader.text(node)}' is no time of a behaviour"
        raise reading.reader.broken(node.at, what, "give 1 ms or more")
    return time


def _delay(reading: KeyReading, node: Node) -> int:
    time = reading.reader.time(node)
    if not 0 < time < NEVER:
        raise reading.reader.broken(node.at, f"'{reading.reader.text(node)}' is no delay", "give a time such as 30 s")
    return time


def _number(reading: KeyReading, node: Node) -> float:
    with reading.reader.refusing(node.at):
        found = number_of(reading.reader.text(node))
    return found


def number_of(text: str) -> float:
    """Return a number as files write it; whole numbers stay whole. Raise ValueError if the text is not a number."""
    try:
        return int(text)
    except ValueError:
        return float(text)


def _span(reading: KeyReading, node: Node) -> tuple[float, float]:
    text = reading.reader.text(node)
    first, _, last = text.partition("..")
    try:
        return number_of(first), number_of(last)
    except ValueError:
        raise reading.reader.broken(node.at, f"'{text}' is not a range (0..100)", "") from None


def _limits(reading: KeyReading, node: Node) -> tuple[float, float]:
    low, high = _span(reading, node)
    if low >= high:
        what = f"the range {reading.reader.text(node)} is empty"
        raise reading.reader.broken(node.at, what, "give the smaller number first")
    return low, high


def _formula(reading: KeyReading, node: Node) -> Expression:
    found: Expression = reading.loader.formula(node)
    return found


_IN_POINTS = "points.schema.json#/$defs/"
PERIOD = Form(ref("time"), _period)
DELAY = Form(ref("time"), _delay)
AMOUNT = Form({"$ref": f"{_IN_POINTS}exact"}, _number)
SPAN = Form({"$ref": f"{_IN_POINTS}span"}, _span)
LIMITS = Form({"$ref": f"{_IN_POINTS}span"}, _limits)
FORMULA = Form(ref("expression"), _formula)
"""An expression over names of behaviours and addresses; the loader checks that they exist."""


def _word(name: str, *known: str) -> Form:
    return Form(words(name, *known), lambda r, node: r.reader.text(node))


# ---- common base ----------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class Behaviour(ABC):
    """A behaviour of one place, as a device file defines it."""

    word: ClassVar[str]
    name: str | None = key("name", IDENTIFIER, "What expressions call it; its address does as well.", default=None)
    type: str | None = key("type", _word("a type", *TYPES), "What stands there: a unit of memory, or int16, uint32, "
        "float32 …; default: what the address says.", default=None)  # fmt: skip
    order: str | None = key("order", _word("an order of bytes", *ORDERS), "How the bytes of a longer number stand in "
        "its words; ABCD high word first; default CDAB, low word first.", default=None)  # fmt: skip
    scale: float = key("scale", AMOUNT, "The value is the number that stands there times this, exactly.", default=1)
    offset: float = key("offset", AMOUNT, "Added to it.", default=0)
    unit: str = key("unit", TEXT, "In what it is measured, for people: °C, kWh.", default="")
    every: int = key("every", PERIOD, "How often it is worked out; default 1 s.", default=SECOND)
    """The period of the computation (ns)."""
    after: int = key("after", DELAY, "It begins so long after the start; default: at once.", default=0)
    """The time from the start of the device to the first computation (ns)."""
    place: Point
    """The place, with the type and scaling of its value, like a point of a run."""
    names: Mapping[str, Point] = field(default_factory=dict)
    """The places that the formula reads, by the names in the formula."""
    at: Position

    @abstractmethod
    def value(self, now: BehaviourMoment) -> float | None:
        """Return the value for this moment, or None to leave the memory as it is. Raise EVALUATION_ERRORS."""

    @property
    def first(self) -> float | None:
        """Return the value to store when the device starts, also before `after` has passed; None: keep the memory."""
        return None

    @property
    def numbers(self) -> Iterator[tuple[str, float]]:
        """Yield the numbers that the behaviour certainly stores, each with the key that gives it."""
        yield from ()

    @property
    def formula(self) -> Expression | None:
        """Return the expression that the value depends on, or None."""
        return None

    @property
    def goes_on(self) -> bool:
        """Return whether the value continues from the last value, and thus is computed from the previous memory."""
        return False

    @property
    def wraps(self) -> bool:
        """Return whether a whole number outside its type wraps to the other end; if not, it is limited to the range."""
        return False

    def useless(self) -> Iterator[tuple[str, str]]:
        """Yield the keys that have no effect here, each with the reason."""
        yield from ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Starting(Behaviour):
    """A behaviour that continues from a start value."""

    start: float | None = key(
        "start", AMOUNT, "What stands there at the start; default: what the memory holds.", default=None
    )

    @property
    def first(self) -> float | None:
        return self.start

    @property
    def start_number(self) -> Iterator[tuple[str, float]]:
        """Yield the start value, if it is given, as one of the `numbers`."""
        if self.start is not None:
            yield "start", self.start

    @property
    def numbers(self) -> Iterator[tuple[str, float]]:
        return self.start_number


# ---- the kinds ------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class Hold(Behaviour):
    """Keeps its value until a client writes another."""

    word: ClassVar[str] = "hold"
    hold: float = key("hold", AMOUNT, "A start value; what is written there stays.")

    def value(self, now: BehaviourMoment) -> float | None:
        return None if now.passed else self.hold

    @property
    def first(self) -> float | None:
        return None if self.after else self.hold

    @property
    def numbers(self) -> Iterator[tuple[str, float]]:
        yield "hold", self.hold

    def useless(self) -> Iterator[tuple[str, str]]:
        if self.every != SECOND:
            yield "every", "the value is put there once"


@dataclass(frozen=True, slots=True, kw_only=True)
class Ramp(Behaviour):
    """Goes evenly from one value to another."""

    word: ClassVar[str] = "ramp"
    ramp: tuple[float, float] = key("ramp", SPAN, "The first and the last value, FIRST..LAST.")
    over: int = key("over", PERIOD, "How long it takes.")
    then: str = key("then", _word("an end of a ramp", "again", "back", "stay"), "What comes then: again from the first "
        "value (the default), the way back, or the last value stays.", default="again")  # fmt: skip

    def value(self, now: BehaviourMoment) -> float | None:
        first, last = self.ramp
        rounds, into = divmod(now.time, self.over)
        if rounds and self.then == "stay":
            return last
        if rounds % 2 and self.then == "back":
            into = self.over - into
        return first + (last - first) * into / self.over

    @property
    def numbers(self) -> Iterator[tuple[str, float]]:
        yield from (("ramp", one) for one in self.ramp)


@dataclass(frozen=True, slots=True, kw_only=True)
class Sine(Behaviour):
    """Swings evenly between two values; it begins in the middle, upwards."""

    word: ClassVar[str] = "sine"
    sine: tuple[float, float] = key("sine", LIMITS, "The lowest and the highest value, LOW..HIGH.")
    period: int = key("period", PERIOD, "How long a swing takes.")

    def value(self, now: BehaviourMoment) -> float | None:
        low, high = self.sine
        part = now.time % self.period / self.period
        return (low + high) / 2 + (high - low) / 2 * math.sin(2 * math.pi * part)

    @property
    def numbers(self) -> Iterator[tuple[str, float]]:
        yield from (("sine", one) for one in self.sine)


@dataclass(frozen=True, slots=True, kw_only=True)
class Square(Behaviour):
    """Jumps between two values; the second one comes at the end of each period."""

    word: ClassVar[str] = "square"
    square: tuple[float, float] = key("square", SPAN, "The two values, FIRST..SECOND.")
    period: int = key("period", PERIOD, "How long both take together.")
    pulse: int | None = key(
        "pulse", PERIOD, "How long the second value stays; default: half of the time.", default=None
    )

    def value(self, now: BehaviourMoment) -> float | None:
        pulse = self.period // 2 if self.pulse is None else self.pulse
        return self.square[now.time % self.period >= self.period - pulse]

    @property
    def numbers(self) -> Iterator[tuple[str, float]]:
        yield from (("square", one) for one in self.square)

    def useless(self) -> Iterator[tuple[str, str]]:
        if self.pulse is not None and self.pulse >= self.period:
            yield "pulse", "it leaves nothing of the period to the first value"


@dataclass(frozen=True, slots=True, kw_only=True)
class RandomWalk(Starting):
    """Goes up or down by chance, a step each time, and stays within its limits."""

    word: ClassVar[str] = "random walk"
    random_walk: tuple[float, float] = key("random walk", LIMITS, "Its limits, LOW..HIGH.")
    step: float = key("step", AMOUNT, "The largest step; default 1.", default=1)
    seed: int = key("seed", NUMBER, "The same seed gives the same walk; default 0.", default=0)

    def value(self, now: BehaviourMoment) -> float | None:
        low, high = self.random_walk
        step = now.dice.uniform(-self.step, self.step) if now.passed else 0
        return min(max(now.before() + step, low), high)

    @property
    def numbers(self) -> Iterator[tuple[str, float]]:
        yield from (("random walk", one) for one in self.random_walk)
        yield from self.start_number

    @property
    def goes_on(self) -> bool:
        return True

    def useless(self) -> Iterator[tuple[str, str]]:
        if self.step <= 0:
            yield "step", "a walk takes steps larger than 0"
        low, high = self.random_walk
        if self.start is not None and not low <= self.start <= high:
            yield "start", "it is not within the limits"


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseBetween(Behaviour):
    """Any value between two, each as likely as the others."""

    word: ClassVar[str] = "noise"
    noise: tuple[float, float] = key("noise", LIMITS, "The lowest and the highest value, LOW..HIGH.")
    seed: int = key("seed", NUMBER, "The same seed gives the same noise; default 0.", default=0)

    def value(self, now: BehaviourMoment) -> float | None:
        return now.dice.uniform(*self.noise)

    @property
    def numbers(self) -> Iterator[tuple[str, float]]:
        yield from (("noise", one) for one in self.noise)


@dataclass(frozen=True, slots=True, kw_only=True)
class Counter(Starting):
    """Adds a number each time: it counts, or integrates the value of an expression."""

    word: ClassVar[str] = "counter"
    counter: Expression = key("counter", FORMULA, "What is added each time: a number, or an expression.")

    def value(self, now: BehaviourMoment) -> float | None:
        return now.before() + now.worked_out() * (now.passed // self.every)

    @property
    def formula(self) -> Expression | None:
        return self.counter

    @property
    def goes_on(self) -> bool:
        return True

    @property
    def wraps(self) -> bool:
        return True


@dataclass(frozen=True, slots=True, kw_only=True)
class Follow(Starting):
    """Follows the value of an expression, at once or slowly."""

    word: ClassVar[str] = "follow"
    follow: Expression = key("follow", FORMULA, "An expression over names of behaviours and addresses.")
    lag: int | None = key("lag", PERIOD, "It comes nearer slowly: 63 % of the way in this time.", default=None)

    def value(self, now: BehaviourMoment) -> float | None:
        aim = now.worked_out()
        if self.lag is None:
            return aim
        before = now.before()
        return before + (aim - before) * -math.expm1(-now.passed / self.lag)

    @property
    def formula(self) -> Expression | None:
        return self.follow

    @property
    def goes_on(self) -> bool:
        return self.lag is not None

    def useless(self) -> Iterator[tuple[str, str]]:
        if self.start is not None and self.lag is None and not self.after:
            yield "start", "the value is worked out at once"


BEHAVIOURS: dict[str, type[Behaviour]] = {}
"""The kinds of behaviours by the key that names them."""
BEHAVIOURS.update((kind.word, kind) for kind in (Hold, Ramp, Sine, Square, RandomWalk, NoiseBetween, Counter, Follow))


def add_behaviour(word: str, kind: type[Behaviour]) -> None:
    """Register a program's own kind of behaviour.

    Raise ValueError for a word that is already a key of behaviours, and for an invalid schema.
    """
    add_kind_of("device", "behaviour", word, schema_of(kind), kind.__module__)
    BEHAVIOURS[word] = kind


def schema_of(kind: type[Behaviour]) -> dict[str, Any]:
    """Return the schema of this kind of behaviour."""
    return kind_schema(kind, f"{kind.word} behaviour")


# ---- at work --------------------------------------------------------------------------------------------------


Told = Callable[[str], None]


class _BehavingPlace:
    """A place in memory that is read and written as a value in the scale of its point."""

    def __init__(self, point: Point, memory: DeviceMemory) -> None:
        self.point, self.form = point, point.form
        address = point.place.address
        self._area, self._first = memory.area(address.area), address.first_bit

    def numbers(self) -> list[int]:
        """Return the elements of memory at the place."""
        return self._area.read_from(self._first, self.form.carrier, self.form.units)

    def read(self) -> float:
        """Return the value of the place. Raise ValueError if the elements are not a value of its type."""
        numbers, form = self.numbers(), self.form
        value: float = scaled(self.point, form.values(memory_of(numbers, form.carrier), numbers)[0])
        return value

    def write(self, value: float, wraps: bool) -> float:
        """Store a value within the range of its type and return the stored value. Raise ValueError for a non-number."""
        raw: float = unscaled(self.point, value)
        assert self.form.bounds is not None
        least, most = self.form.bounds
        if not least <= raw <= most:
            if wraps and not self.form.is_float:
                span = most - least + 1
                beyond = int(raw - least) // span * span
                raw -= beyond
                value = self._less(value, beyond)
            else:
                raw = min(max(raw, least), most)
                value = scaled(self.point, raw)
        self._area.write_from(self._first, self.form.carrier, self.form.numbers([raw]), force=True)
        return value

    def _less(self, value: float, raw: float) -> float:
        """Return the value minus a number of memory, calculated exactly: its fraction stays."""
        scaling = self.point.scaling
        exact = Fraction(str(value)) - Fraction(raw) * Fraction(1 if scaling is None else scaling.factor)
        return int(exact) if exact.denominator == 1 else float(exact)


class _Values:
    """The operands of an expression: present values by name."""

    def __init__(self, readers: Mapping[str, Callable[[], float]]) -> None:
        self._readers = readers

    def __getitem__(self, name: str) -> float:
        return self._readers[name]()


class _Course:
    """The state of a behaviour at work.

    It keeps the exact value that it stored until the memory at its place changes.
    """

    def __init__(self, behaviour: Behaviour, memory: DeviceMemory, seed: str) -> None:
        self.behaviour = behaviour
        self.place = _BehavingPlace(behaviour.place, memory)
        self.last = -1
        self.dice = random.Random(seed)
        self.trouble = ""
        self._exact: tuple[list[int], float] | None = None
        formula = compile_optional(behaviour.formula)
        values = _Values({name: _BehavingPlace(point, memory).read for name, point in behaviour.names.items()})
        self.worked_out: Callable[[], float] = self._nothing if formula is None else partial(formula, values)  # type: ignore[arg-type]

    @staticmethod
    def _nothing() -> float:
        raise ValueError("it has no formula")

    def before(self) -> float:
        """Return the value of the place: the exact one if the memory is as this behaviour stored it."""
        if self._exact is not None and self._exact[0] == self.place.numbers():
            return self._exact[1]
        return self.place.read()

    def store(self, value: float) -> None:
        """Store a value. Raise ValueError if it is not a number."""
        kept = self.place.write(value, self.behaviour.wraps)
        self._exact = self.place.numbers(), kept


class Behaving:
    """The behaviours of one device over its memory.

    `behaviours` are in the order of their computation: a behaviour comes after those that its formula reads. `name` is
    the name of the device; it is part of the seed, so that devices differ. A callback receives a message for each value
    that cannot be computed; a message that repeats is passed once.
    """

    def __init__(self, behaviours: Sequence[Behaviour], memory: DeviceMemory, name: str, told: Told) -> None:
        self._told = told
        self._states = [
            _Course(one, memory, f"{getattr(one, 'seed', 0)} {name} {one.place.address}") for one in behaviours
        ]
        self._due: list[tuple[int, int]] = []
        self._began = 0

    def begin(self, now: int) -> None:
        """Start the device: store the start values and schedule the first computations."""
        self._began = now
        for number, state in enumerate(self._states):
            if state.behaviour.first is not None:
                state.store(state.behaviour.first)
            self._due.append((now + state.behaviour.after, number))
        heapq.heapify(self._due)
        self.tick(now)

    @property
    def deadline(self) -> int:
        """Return the time of the next computation."""
        return self._due[0][0] if self._due else NEVER

    def tick(self, now: int) -> None:
        """Compute and store the values that are due."""
        due = []
        while self._due and self._due[0][0] <= now:
            due.append(heapq.heappop(self._due)[1])
        found, rest = [], []
        for number in sorted(due):
            state = self._states[number]
            origin = self._began + state.behaviour.after
            time = (now - origin) // state.behaviour.every * state.behaviour.every
            heapq.heappush(self._due, (origin + time + state.behaviour.every, number))
            if state.behaviour.formula is None or state.behaviour.goes_on:
                found.append((state, time, self._value(state, time)))
            else:
                rest.append((state, time))
        for state, time, value in found:
            self._store(state, time, value)
        for state, time in rest:
            self._store(state, time, self._value(state, time))

    def _value(self, state: _Course, time: int) -> float | None:
        passed = 0 if state.last < 0 else time - state.last
        try:
            value = state.behaviour.value(BehaviourMoment(time, passed, state.before, state.worked_out, state.dice))
        except EVALUATION_ERRORS as error:
            self._cannot(state, error)
            return None
        return int(value) if isinstance(value, bool) else value

    def _store(self, state: _Course, time: int, value: float | None) -> None:
        state.last = time
        if value is None:
            return
        try:
            state.store(value)
        except EVALUATION_ERRORS as error:
            self._cannot(state, error)
        else:
            state.trouble = ""

    def _cannot(self, state: _Course, error: Exception) -> None:
        text = f"the behaviour of {state.behaviour.place.address}: {error}"
        if text != state.trouble:
            state.trouble = text
            self._told(text)
