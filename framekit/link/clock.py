"""The simulated device's clock: a moment that runs with the engine's time and can be set.

It reads no clock of the computer; where it starts is told from outside.
"""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime, timedelta
from typing import Any

from framekit.link.evaluate import Names
from framekit.link.values import attribute

DEFAULT_START = datetime(2000, 1, 1)
_TIME, _DATE = ("second", "minute", "hour"), ("day", "month", "year")
_MODES = {1: _TIME + _DATE, 2: _TIME, 3: _DATE, "both": _TIME + _DATE, "time": _TIME, "date": _DATE}


def moment(at: datetime) -> dict[str, int]:
    """A moment as the language sees it: second, minute, hour, day, month, year, weekday (1 = Sunday)."""
    return {
        "second": at.second,
        "minute": at.minute,
        "hour": at.hour,
        "day": at.day,
        "month": at.month,
        "year": at.year,
        "weekday": at.isoweekday() % 7 + 1,
    }


def with_date(clock: Mapping[str, int], frame: Any, mode: int | str) -> dict[str, int]:
    """`clock` with the parts that `mode` names (1 both, 2 time, 3 date) taken from the frame's fields.

    Years below 100 are of 1970 to 2069. Raises ValueError for a date that does not exist.
    """
    parts = dict(clock)
    for name in _MODES[mode]:
        parts[name] = attribute(frame, name)
    return moment(_datetime(parts))


def _datetime(parts: Mapping[str, int]) -> datetime:
    year = parts["year"]
    if year < 100:
        year += 1900 if year >= 70 else 2000
    return datetime(year, parts["month"], parts["day"], parts["hour"], parts["minute"], parts["second"])


class DeviceClock:
    """A clock that stood at `start` when the engine's time was `now` (ns)."""

    __slots__ = ("_now", "_start")

    def __init__(self, now: int, start: datetime = DEFAULT_START) -> None:
        self._now, self._start = now, start

    def read(self, now: int) -> dict[str, int]:
        return moment(self._start + timedelta(microseconds=(now - self._now) // 1000))

    def set(self, to: Mapping[str, int], now: int) -> None:
        """Raises KeyError or ValueError when `to` is no moment."""
        self._start, self._now = _datetime(to), now


class DeviceState(Names):
    """Variables of scope `device` by name, put in by the first engine that has this one.

    `changes` grows whenever one of them changes; `clock` is None until an engine has begun.
    """

    __slots__ = ("changes", "clock")

    def __init__(self) -> None:
        super().__init__()
        self.changes = 0
        self.clock: DeviceClock | None = None
