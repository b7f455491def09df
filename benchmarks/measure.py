"""Measuring: several functions in interleaved rounds, so that what disturbs the machine disturbs all of them alike."""

from __future__ import annotations

import gc
import platform
import statistics
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.metadata import version

ROUND = 0.02
"""Seconds one function runs in one round, about."""


@dataclass(frozen=True, slots=True)
class Timing:
    """Seconds a call: the median of the rounds, and the spread between their quartiles."""

    median: float
    spread: float


def compare(functions: Mapping[str, Callable[[], object]], rounds: int) -> dict[str, Timing]:
    """Times of all functions, measured in turn, `rounds` times."""
    counts = {name: _calls_a_round(function) for name, function in functions.items()}
    times: dict[str, list[float]] = {name: [] for name in functions}
    gc.collect()
    gc.disable()
    try:
        for _ in range(rounds):
            for name, function in functions.items():
                times[name].append(_time(function, counts[name]))
    finally:
        gc.enable()
    return {name: Timing(statistics.median(found), _spread(found)) for name, found in times.items()}


def _time(function: Callable[[], object], count: int) -> float:
    calls = range(count)
    begin = time.perf_counter()
    for _ in calls:
        function()
    return (time.perf_counter() - begin) / count


def _calls_a_round(function: Callable[[], object]) -> int:
    count = 1
    while _time(function, count) * count < ROUND / 4:
        count *= 4
    return max(1, round(ROUND / _time(function, count)))


def _spread(times: list[float]) -> float:
    low, _, high = statistics.quantiles(times, n=4)
    return high - low


def machine() -> str:
    """What was measured on, in a line."""
    parts = [f"Python {platform.python_version()}", platform.machine(), platform.system()]
    parts += [f"{name} {version(name)}" for name in ("construct", "pymodbus")]
    return ", ".join(parts)
