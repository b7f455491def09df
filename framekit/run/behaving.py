"""Behaviours at work: the memory of a simulated device moves with time. Sans-I/O: it is told the time.

Each behaviour is worked out at `after`, `after + every`, `after + 2 × every` … from the start; times that were missed
are skipped. Those that go on from what stands there (counters, walks, what lags) go by what the others were before, the
others by what all are now. A number beyond its type stays at that end, or begins again at the other one (`wraps`); one
that cannot be worked out changes nothing and is told.
"""

from __future__ import annotations

import heapq
import random
from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from functools import partial

from framekit.definition.times import NEVER
from framekit.link.packing import memory_of
from framekit.link.values import EVALUATION_ERRORS, compile_optional
from framekit.memory.memory import DeviceMemory
from framekit.run.behaviours import Behaviour, BehaviourMoment
from framekit.run.model import Point
from framekit.run.points import scaled, unscaled

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
