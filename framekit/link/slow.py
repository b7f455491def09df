"""Stations that answer later than the time limit: how late, and the setting that helps."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Any, Literal, NamedTuple

from framekit.definition.times import readable_time

WELL, WELL_TIME = 20, 60_000_000_000
"""A station is no longer slow after so many replies in time in sequence, and this time (ns) without a late reply."""

GROWN = 3
"""A longer time is believed after so many longer times in sequence: repeated requests may wait in the device."""

GROWN_IN_DOUBT = 10
"""So many replies in sequence show that replies are kept if others of the station came late by themselves."""

UNSURE = 5
"""A time is believed after so many times more in sequence, if an older request has no reply."""

REMEMBERED = 3_600_000_000_000
"""A station that is slow again within this time after its last late reply (ns) is not reported again."""

STEPS = (1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)
"""Leading digits of suggested time limits."""


class Prompt(NamedTuple):
    """What a late reply came with."""

    by: Literal["", "repeat", "request"]
    """A repeat of its own request, or a request of a later exchange; empty: neither."""
    is_just_late: bool
    """Whether it came just after the time limit, too: a longer time limit may help."""


NO_PROMPT = Prompt("", is_just_late=False)


class SlowStation(NamedTuple):
    """A station whose replies come after the time limit. As text: what to set, for the user."""

    station: Any
    """None for the only station of the line."""
    time: int
    """Time from the request to the reply (ns)."""
    limit: str
    """Name of the parameter that holds the time limit; empty if none does."""
    is_kept: bool = False
    """Whether its replies come only with the next request, so that a longer time limit does not help."""

    is_just_late: bool = False
    """Whether these replies came just after the time limit, too, so that a longer time limit may nevertheless help."""

    @property
    def who(self) -> str:
        """Return the station in words."""
        is_named = isinstance(self.station, (int, str)) and self.station != ""
        return f"station {self.station}" if is_named else "the other side"

    def __str__(self) -> str:
        if self.is_kept and not self.is_just_late:
            no_help = f"a longer {self.limit or 'time limit'} does not help"
            return f"{self.who} answers only when it is asked again: {no_help}, a gateway or an adapter keeps replies"
        what = f"set {self.limit} to" if self.limit else "its time limit has to be"
        time, limit = readable_time(rounded(self.time)), readable_time(suggested(self.time))
        keeps = "; if that does not help, a gateway or an adapter keeps replies" if self.is_kept else ""
        return f"{self.who} answers after {time}: {what} {limit} or more{keeps}"


def rounded(time: int) -> int:
    """Return a time with two digits."""
    unit: int = 10 ** max(0, len(str(time)) - 2)
    return (time + unit // 2) // unit * unit


def suggested(time: int) -> int:
    """Return a round time limit that is a tenth longer than `time` at least."""
    wanted = time + time // 10
    unit = 10 ** (len(str(wanted)) - 1)
    return next(int(step * unit) for step in STEPS if step * unit >= wanted)


class _Advice:
    """The advice for one station."""

    __slots__ = ("found", "in_time", "is_shown", "is_slow", "late_at", "longer")

    def __init__(self, found: SlowStation) -> None:
        self.found = found
        self.is_slow = self.is_shown = True
        """Whether the station is slow now, and whether the last report was that it is slow."""
        self.in_time = 0
        """Number of replies in time since the last late reply."""
        self.late_at = 0
        """Time of the last late reply (ns)."""
        self.longer: list[int] = []
        """The last times in sequence that are longer than the time of the advice (ns)."""

    def show(self, found: SlowStation) -> None:
        """Replace the advice by `found`, which is reported."""
        self.found, self.is_shown = found, True
        self.longer.clear()


class SlowStations:
    """The stations of a line that are slow now."""

    def __init__(self) -> None:
        self.on_change: Callable[[SlowStation, bool], None] = lambda station, is_slow: None
        """Called when a station is slow, when its time grows by more than a quarter, and when it is well again.

        A station that is slow again soon after that, for no longer time, is not reported again.
        """
        self._known: dict[Hashable, _Advice] = {}
        self._prompted: dict[Hashable, int] = {}
        """For each station the number of late replies in sequence that came with the next request."""
        self._late_alone: set[Hashable] = set()
        """Stations with late replies that came by themselves."""
        self._unsure: dict[Hashable, int] = {}
        """For each station the number of late replies in sequence that came while an older request had no reply."""
        self.number = 0
        """Number of slow stations."""

    @property
    def present(self) -> tuple[SlowStation, ...]:
        """Return the slow stations."""
        return tuple(advice.found for advice in self._known.values() if advice.is_slow)

    def is_late(self, now: int, station: Any = None) -> bool:
        """Return whether a slow station has answered late within `WELL_TIME`; with `station`, whether it is this."""
        return any(
            advice.is_slow and now - advice.late_at < WELL_TIME and (station is None or key in (key_of(station), None))
            for key, advice in self._known.items()
        )

    def is_likely(self, station: Any, *, is_prompted: bool) -> bool:
        """Count a late reply while an older request has no reply; return whether its time is believed.

        The reply may answer the older request, so a single such time may be too short.
        """
        number = self._unsure[key_of(station)] = 0 if is_prompted else self._unsure.get(key_of(station), 0) + 1
        return number > UNSURE

    def answered_itself(self, station: Any) -> None:
        """Note that the first reply of a proof was the reply to its own request: none was kept before it."""
        self._prompted.pop(key_of(station), None)

    def answered_late(self, station: Any, time: int, limit: str, now: int, prompt: Prompt = NO_PROMPT) -> None:
        """Note a reply that came after `time`, and report it if that is new.

        A few replies in sequence that came with a repeat or with the next request show that they are kept until then.
        """
        key = key_of(station)
        self._unsure.pop(key, None)
        prompted = self._prompted[key] = self._prompted.get(key, 0) + 1 if prompt.by else 0
        if not prompt.by:
            self._late_alone.add(key)
        is_kept = prompted >= (GROWN_IN_DOUBT if key in self._late_alone else GROWN)
        found = SlowStation(station, time, limit, is_kept, is_kept and prompt.is_just_late)
        advice = self._known.get(key)
        if advice is None or (not advice.is_slow and now - advice.late_at >= REMEMBERED):
            if prompt.by == "request" and not is_kept:
                return
            advice = self._known[key] = _Advice(found)
            self.number = len(self.present)
            self.on_change(advice.found, True)
        elif is_kept and (not advice.found.is_kept or (advice.found.is_just_late and not prompt.is_just_late)):
            advice.show(found)
            self.on_change(found, True)
        elif not prompt.by and (time - advice.found.time) * 4 > advice.found.time:
            advice.longer.append(time)
            if len(advice.longer) == GROWN:
                advice.show(SlowStation(station, min(advice.longer), limit))
                self.on_change(advice.found, True)
        else:
            advice.longer.clear()
        advice.in_time, advice.late_at, advice.is_slow = 0, now, True
        self.number = len(self.present)

    def answered_in_time(self, station: Any, now: int) -> None:
        """Note a reply in time, and report the end if it is the last of many."""
        advice = self._known.get(key_of(station))
        if advice is None or not advice.is_slow:
            return
        advice.in_time += 1
        if advice.in_time >= WELL and now - advice.late_at >= WELL_TIME:
            was_shown, advice.is_slow, advice.is_shown = advice.is_shown, False, False
            self.number = len(self.present)
            if was_shown:
                self.on_change(advice.found, False)


def key_of(station: Any) -> Hashable:
    """Return a station as a key."""
    return station if isinstance(station, Hashable) else repr(station)
