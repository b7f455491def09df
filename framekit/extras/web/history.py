"""Past values of points for charts: the last minutes in memory, and older values out of the history file of the run."""

from __future__ import annotations

import asyncio
from array import array
from collections.abc import Sequence
from math import isfinite, nan
from pathlib import Path
from typing import NamedTuple

from framekit.api.errors import RequestError
from framekit.api.points import Course, RunPoint, course_of
from framekit.run.points import PointValue

MOST_KEPT = 600
MOST_NUMBERS = 2_000_000
"""Limits of the history: moments per point, and numbers in all (8 bytes each)."""
STEPS = 400
"""Steps of a stored course; each has a least and a greatest number."""


class Drawn(NamedTuple):
    """Numbers of points at common times (seconds since 1970)."""

    times: list[float]
    numbers: list[list[float | None]]


def number_of(value: PointValue) -> float:
    """Return the number to draw for a value; nan if it is not good, or not a number."""
    number = value.number
    if value.quality != "good" or not isinstance(number, (int, float)):
        return nan
    try:
        return float(number)
    except OverflowError:
        return nan


class PointHistory:
    """The latest moments of all points: `size` numbers for each, taken at common times (seconds since 1970)."""

    def __init__(self, points: int) -> None:
        self.size = max(2, min(MOST_KEPT, MOST_NUMBERS // max(1, points)))
        self.taken = 0
        self._times = array("d", bytes(8 * self.size))
        self._numbers = [array("d", bytes(8 * self.size)) for _ in range(points)]

    def take(self, time: float, values: Sequence[PointValue]) -> None:
        """Add a moment; it replaces the oldest if the history is full."""
        at = self.taken % self.size
        self._times[at] = time
        for numbers, value in zip(self._numbers, values, strict=True):
            numbers[at] = number_of(value)
        self.taken += 1

    def last(self, point: int, most: int) -> tuple[list[float], list[float | None]]:
        """Return the latest moments of a point, oldest first: times, and numbers or None."""
        count = min(most, self.taken, self.size)
        places = [at % self.size for at in range(self.taken - count, self.taken)]
        numbers = self._numbers[point]
        return (
            [self._times[at] for at in places],
            [number if isfinite(number := numbers[at]) else None for at in places],
        )


class StoredHistory:
    """The values in the history file of a run. One query at a time, in a thread: the run goes on meanwhile."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lock = asyncio.Lock()

    async def courses(self, points: Sequence[RunPoint], since: int, until: int) -> Drawn:
        """Return the stored numbers of points between two times (ns since 1970). Raises RequestError."""
        if self._lock.locked():
            raise RequestError("another query of the history is running – try again")
        async with self._lock:
            return await asyncio.to_thread(self._read, points, since, until)

    def _read(self, points: Sequence[RunPoint], since: int, until: int) -> Drawn:
        found = [course_of(self.path, point, since, until, STEPS) for point in points]
        return Drawn(_times(found[0]), [_numbers(course) for course in found])


def _times(course: Course) -> list[float]:
    """Return two moments for each step, at a quarter and at three quarters of it."""
    half = course.step / 2
    return [(course.since + half * (at + 0.5)) / 1e9 for at in range(2 * len(course.least))]


def _numbers(course: Course) -> list[float | None]:
    """Return least and greatest number of each step, nearer to the number before it first."""
    found: list[float | None] = []
    last: float | None = None
    for low, high in zip(course.least, course.greatest, strict=True):
        is_falling = last is not None and low is not None and high is not None and abs(last - high) < abs(last - low)
        pair = (high, low) if is_falling else (low, high)
        found += pair
        last = pair[1]
    return found
