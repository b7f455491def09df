"""Behaviours: how values in the memory of a simulated device move by themselves, with time and with each other.

A kind is a class and a row of `BEHAVIOURS`: its keys in a device file, made by `key` (the first names the kind), and
`value`, which works the value out at a moment. A behaviour is frozen: it goes on from what stands in memory.

At work the memory moves with time. That is sans-I/O: it is told the time. Each behaviour is worked out at `after`,
`after + every`, `after + 2 × every` … from the start; times that were missed are skipped. Those that go on from what
stands there (counters, walks, what lags) go by what the others were before, the others by what all are now. A number
beyond its type stays at that end, or begins again at the other one (`wraps`); one that cannot be worked out changes
nothing and is told.
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
from framekit.definition.keys import IDENTIFIER, NUMBER, Form, KeyReading, key, kind_schema, ref, words
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
"""Nothing of a behaviour takes less (ns)."""
SECOND = 1_000_000_000
TYPES = tuple(name for name in (*UNIT_BITS, *VIEWS) if name != "string")
"""What a place can hold that behaves."""


class BehaviourMoment(NamedTuple):
    """When a value is worked out: `time` since the behaviour began, `passed` since it was worked out before (ns).

    `passed` is 0 the first time, then a multiple of `every`. `before`: the value that stands there. `worked_out`: what
    its formula comes to, over what stands in memory. `dice`: chance, repeatable by a seed.
    """

    time: int
    passed: int
    before: Callable[[], float]
    worked_out: Callable[[], float]
    dice: random.Random


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
    """A number as files write it; whole ones stay whole. Raises ValueError."""
    try:
        return int(text)
    except ValueError:
        return float(text)


def _span(reading: KeyReading, node: Node) -> tuple[float, float]:
    first, _, last = reading.reader.text(node).partition("..")
    return number_of(first), number_of(last)


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
"""An expression over names of behaviours and addresses; the loader sees to it that they are there."""


def _word(name: str, *known: str) -> Form:
    return Form(words(name, *known), lambda r, node: r.reader.text(node))


# ---- what all have in common ----------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class Behaviour(ABC):
    """What a device file says of one place that moves by itself. `place`: the value there, as points have it; `names`:
    the places that its formula reads, by the names it uses.

    `every` (ns): how often it is worked out, the first time `after` ns after the start.
    """

    word: ClassVar[str]
    name: str | None = key("name", IDENTIFIER, "What expressions call it; its address does as well.", default=None)
    type: str | None = key("type", _word("a type", *TYPES), "What stands there: a unit of memory, or int16, uint32, "
        "float32 …; default: what the address says.", default=None)  # fmt: skip
    order: str | None = key("order", _word("an order of bytes", *ORDERS), "How the bytes of a longer number stand in "
        "its words; ABCD high word first; default CDAB, low word first.", default=None)  # fmt: skip
    scale: float = key("scale", AMOUNT, "The value is the number that stands there times this, exactly.", default=1)
    offset: float = key("offset", AMOUNT, "Added to it.", default=0)
    every: int = key("every", PERIOD, "How often it is worked out; default 1 s.", default=SECOND)
    after: int = key("after", DELAY, "It begins so long after the start; default: at once.", default=0)
    place: Point
    names: Mapping[str, Point] = field(default_factory=dict)
    at: Position

    @abstractmethod
    def value(self, now: BehaviourMoment) -> float | None:
        """The value then; None: what stands there stays. Raises EVALUATION_ERRORS."""

    @property
    def first(self) -> float | None:
        """What stands there when the device starts, also while it waits; None: what the memory holds."""
        return None

    @property
    def numbers(self) -> Iterator[tuple[str, float]]:
        """The numbers that will stand there for certain, each with its key."""
        yield from ()

    @property
    def formula(self) -> Expression | None:
        """What it is worked out from."""
        return None

    @property
    def goes_on(self) -> bool:
        """Whether it goes on from what stands there: then it goes by what the others were before."""
        return False

    @property
    def wraps(self) -> bool:
        """Whether whole numbers begin again at the other end of their type; if not, they stay at this one."""
        return False

    def useless(self) -> Iterator[tuple[str, str]]:
        """Keys that have no effect here, with the reason."""
        yield from ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Starting(Behaviour):
    """A behaviour that goes on from a start value."""

    start: float | None = key(
        "start", AMOUNT, "What stands there at the start; default: what the memory holds.", default=None
    )

    @property
    def first(self) -> float | None:
        return self.start

    @property
    def start_number(self) -> Iterator[tuple[str, float]]:
        """The start value as one of the numbers that will stand there."""
        if self.start is not None:
            yield "start", self.start

    @property
    def numbers(self) -> Iterator[tuple[str, float]]:
        return self.start_number


# ---- the kinds ------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class Hold(Behaviour):
    """Stands there until someone writes something else."""

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
    """Adds something each time: it counts, and it integrates what an expression is."""

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
    """Is what an expression says, at once or slowly."""

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
    """Registers a kind of behaviour of a program's own.

    Raises ValueError for a word that means something in a behaviour already, and for no schema.
    """
    add_kind_of("device", "behaviour", word, schema_of(kind), kind.__module__)
    BEHAVIOURS[word] = kind


def schema_of(kind: type[Behaviour]) -> dict[str, Any]:
    """The schema of a behaviour of this kind."""
    return kind_schema(kind, f"{kind.word} behaviour")


# ---- at work --------------------------------------------------------------------------------------------------


Told = Callable[[str], None]


class _BehavingPlace:
    """A value in a memory: read and written in its own scale."""

    def __init__(self, point: Point, memory: DeviceMemory) -> None:
        self.point, self.form = point, point.form
        address = point.place.address
        self._area, self._first = memory.area(address.area), address.first_bit

    def numbers(self) -> list[int]:
        """What stands there, as elements of memory."""
        return self._area.read_from(self._first, self.form.carrier, self.form.units)

    def read(self) -> float:
        """The value there. Raises ValueError where none stands."""
        numbers, form = self.numbers(), self.form
        value: float = scaled(self.point, form.values(memory_of(numbers, form.carrier), numbers)[0])
        return value

    def write(self, value: float, wraps: bool) -> float:
        """Stores a value, and says which: one that its type can hold. Raises ValueError for what is no number."""
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
        """The value less a number of memory, exactly: its fraction stays."""
        scaling = self.point.scaling
        exact = Fraction(str(value)) - Fraction(raw) * Fraction(1 if scaling is None else scaling.factor)
        return int(exact) if exact.denominator == 1 else float(exact)


class _Values:
    """What an expression reads: values by name, as they are now."""

    def __init__(self, readers: Mapping[str, Callable[[], float]]) -> None:
        self._readers = readers

    def __getitem__(self, name: str) -> float:
        return self._readers[name]()


class _Course:
    """A behaviour at work. It keeps the exact value of what it has stored, until others write there."""

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
        """The value there, exactly where nothing else has been written since."""
        if self._exact is not None and self._exact[0] == self.place.numbers():
            return self._exact[1]
        return self.place.read()

    def store(self, value: float) -> None:
        """Raises ValueError for what is no number."""
        kept = self.place.write(value, self.behaviour.wraps)
        self._exact = self.place.numbers(), kept


class Behaving:
    """The behaviours of one device over its memory. `told` hears what cannot be worked out, once as long as it lasts.

    `behaviours` stand in the order in which they are worked out: those that others need come before these. `name`: of
    the device; chance of another device is another one.
    """

    def __init__(self, behaviours: Sequence[Behaviour], memory: DeviceMemory, name: str, told: Told) -> None:
        self._told = told
        self._states = [
            _Course(one, memory, f"{getattr(one, 'seed', 0)} {name} {one.place.address}") for one in behaviours
        ]
        self._due: list[tuple[int, int]] = []
        self._began = 0

    def begin(self, now: int) -> None:
        """The device starts: values stand as they are at first."""
        self._began = now
        for number, state in enumerate(self._states):
            if state.behaviour.first is not None:
                state.store(state.behaviour.first)
            self._due.append((now + state.behaviour.after, number))
        heapq.heapify(self._due)
        self.tick(now)

    @property
    def deadline(self) -> int:
        """When the next value is to be worked out."""
        return self._due[0][0] if self._due else NEVER

    def tick(self, now: int) -> None:
        """Works out what is due."""
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
