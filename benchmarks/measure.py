"""Measure several functions in interleaved rounds, so disturbances of the machine affect all of them alike."""

from __future__ import annotations

import gc
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

ROUND = 0.02
"""Approximate duration in seconds of a function in a round."""


@dataclass(frozen=True, slots=True)
class Timing:
    """Seconds per call, round by round."""

    rounds: tuple[float, ...]

    @property
    def median(self) -> float:
        return statistics.median(self.rounds)

    def ratio(self, other: Timing) -> Ratio:
        """Return how many times as long as `other` this takes, round by round: the median and the quartiles."""
        found = [mine / its for mine, its in zip(self.rounds, other.rounds, strict=True)]
        return Ratio(statistics.median(found), *quartiles(found))


@dataclass(frozen=True, slots=True)
class Ratio:
    """The median of the ratios of all rounds, and their quartiles; a disturbance of a whole round cancels out."""

    value: float
    low: float
    high: float


def quartiles(figures: Sequence[float]) -> tuple[float, float]:
    """Return the lower and upper quartile; for a single figure that figure itself."""
    if len(figures) < 2:
        return figures[0], figures[0]
    low, _, high = statistics.quantiles(figures, n=4, method="inclusive")
    return low, high


def compare(functions: Mapping[str, Callable[[], object]], rounds: int) -> dict[str, Timing]:
    """Return processor times of short functions, each called for about `ROUND` seconds in turn, `rounds` times."""
    counts = {name: _calls_a_round(function) for name, function in functions.items()}
    return interleave({name: _timed(function, counts[name]) for name, function in functions.items()}, rounds)


def compare_once(functions: Mapping[str, Callable[[], object]], rounds: int) -> dict[str, Timing]:
    """Return processor times of long functions, each called once per round in turn."""
    return interleave({name: _timed(function, 1) for name, function in functions.items()}, rounds)


def interleave(measures: Mapping[str, Callable[[], float]], rounds: int) -> dict[str, Timing]:
    """Like `compare`, for functions that measure themselves: each returns the seconds (or another figure) of a round.

    The garbage collector runs between rounds only.
    """
    found: dict[str, list[float]] = {name: [] for name in measures}
    try:
        for _ in range(rounds):
            for name, measure in measures.items():
                gc.collect()
                gc.disable()
                found[name].append(measure())
                gc.enable()
    finally:
        gc.enable()
    return {name: Timing(tuple(figures)) for name, figures in found.items()}


def _timed(function: Callable[[], object], count: int) -> Callable[[], float]:
    return lambda: _time(function, count)


def _time(function: Callable[[], object], count: int) -> float:
    calls = range(count)
    begin = time.process_time()
    for _ in calls:
        function()
    return (time.process_time() - begin) / count


def _calls_a_round(function: Callable[[], object]) -> int:
    count = 1
    while _time(function, count) * count < ROUND / 4:
        count *= 4
    return max(1, round(ROUND / _time(function, count)))
