"""Stations that answer later than the time limit: how late, and the setting that helps."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Any, NamedTuple

from framekit.definition.times import readable_time

WELL = 20
"""After so many replies in time in sequence a station is no longer slow."""

STEPS = (1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)
"""Leading digits of suggested time limits."""


class SlowStation(NamedTuple):
    """A station whose replies come after the time limit. As text: what to set, for the user."""

    station: Any
    """None for the only station of the line."""
    time: int
    """Time from the request to the reply (ns)."""
    limit: str
    """Name of the parameter that holds the time limit; empty if none does."""

    @property
    def who(self) -> str:
        """Return the station in words."""
        is_named = isinstance(self.station, (int, str)) and self.station != ""
        return f"station {self.station}" if is_named else "the other side"

    def __str__(self) -> str:
        what = f"set {self.limit} to" if self.limit else "its time limit has to be"
        time, limit = readable_time(rounded(self.time)), readable_time(suggested(self.time))
        return f"{self.who} answers after {time}: {what} {limit} or more"


def rounded(time: int) -> int:
    """Return a time with two digits."""
    unit: int = 10 ** max(0, len(str(time)) - 2)
    return (time + unit // 2) // unit * unit


def suggested(time: int) -> int:
    """Return a round time limit that is a tenth longer than `time` at least."""
    wanted = time + time // 10
    unit = 10 ** (len(str(wanted)) - 1)
    return next(int(step * unit) for step in STEPS if step * unit >= wanted)


class SlowStations:
    """The stations of a line that are slow now."""

    def __init__(self) -> None:
        self.on_change: Callable[[SlowStation, bool], None] = lambda station, is_slow: None
        """Called when a station is slow, when its time grows by more than a quarter, and when it is well again."""
        self._slow: dict[Hashable, SlowStation] = {}
        self._in_time: dict[Hashable, int] = {}

    def __bool__(self) -> bool:
        return bool(self._slow)

    @property
    def present(self) -> tuple[SlowStation, ...]:
        """Return the slow stations."""
        return tuple(self._slow.values())

    def answered_late(self, station: Any, time: int, limit: str) -> None:
        """Note a reply that came after `time`, and report it if that is new."""
        key = key_of(station)
        before = self._slow.get(key)
        self._in_time[key] = 0
        if before is None or (time - before.time) * 4 > before.time:
            self._slow[key] = found = SlowStation(station, time, limit)
            self.on_change(found, True)

    def answered_in_time(self, station: Any) -> None:
        """Note a reply in time, and report the end if it is the last of many."""
        key = key_of(station)
        if key in self._slow:
            self._in_time[key] += 1
            if self._in_time[key] >= WELL:
                self.on_change(self._slow.pop(key), False)


def key_of(station: Any) -> Hashable:
    """Return a station as a key."""
    return station if isinstance(station, Hashable) else repr(station)
