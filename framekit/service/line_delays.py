"""Report lines that cannot keep up: stations that answer after the time limit, and more reads than the line carries.

Each is one trouble: a line when it begins, when the measured time changes, and when it is over. While it lasts, values
that are too old and waits for late replies of the channel are its consequences, and are not reported.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable
from math import ceil
from typing import NamedTuple

from framekit.definition.problems import plural
from framekit.definition.times import readable_time
from framekit.link.late import LateReplies
from framekit.link.slow import SlowStation, key_of, rounded, suggested
from framekit.run.block_state import BlockState
from framekit.run.trouble import SECOND, Troubles, TroubleSource
from framekit.transport.clock import Clock

FULL = 0.9
"""From this share of its time on a line carries no more exchanges: the rest are the pauses between them."""
LOOK_AGAIN = 10 * SECOND
"""Time between two looks whether a line is overloaded still (ns)."""
LONG_EXCHANGE = 3 * SECOND
"""Least time of an exchange under way that makes values too old by itself (ns)."""
CHANGED = "the channel was removed or changed"
"""The end of a trouble of a line that an edit has changed."""
CALM = 60 * SECOND
"""An overload is over when it has made no value too old for this time (ns)."""


class Demand(NamedTuple):
    """The time that the exchanges of a lane take, against the time between them."""

    number: int
    """Number of different exchanges."""
    time: int
    """Time that they take together, each done once (ns)."""
    share: float
    """Share of the time of the line that they need."""
    periods: frozenset[int]
    """Their periods (ns)."""
    only_read: bool

    def __str__(self) -> str:
        what = "read" if self.only_read else "exchange"
        if len(self.periods) == 1:
            time, period = readable_time(rounded(self.time)), readable_time(next(iter(self.periods)))
            takes = "takes" if self.number == 1 else "take"
            together = "" if self.number == 1 else " together"
            is_due = "is" if self.number == 1 else "are"
            advice = f"set every: to {readable_time(suggested(self.time))} or more"
            return f"{plural(self.number, what)} {takes} {time}{together} and {is_due} due every {period}: {advice}"
        factor = ceil(self.share * 11) / 10
        return (
            f"{plural(self.number, what)} take {self.share:.1f} s of each second: "
            f"set every: to {factor:.1f} times as much or more"
        )


def demand_of(states: Iterable[BlockState]) -> Demand | None:
    """Return the demand of the blocks of a lane by their last exchanges; a joined exchange counts once."""
    periods: dict[tuple[int, int], int] = {}
    only_read = True
    for state in states:
        if not (state.enabled and state.period and state.ended_well):
            continue
        key = state.last_end or 0, state.took
        periods[key] = min(periods.get(key, state.period), state.period)
        only_read = only_read and state.block.instruction == "read"
    if not periods:
        return None
    share = sum(took / period for (_, took), period in periods.items())
    time = sum(took for _, took in periods)
    return Demand(len(periods), time, share, frozenset(periods.values()), only_read)


class _Overload:
    """The trouble of a channel whose exchanges take longer than the time between them."""

    def __init__(self, source: TroubleSource) -> None:
        self.source = source
        self.needed_at = 0
        """When a value was last too old because of the measured overload (ns)."""
        self.looks = False
        """Whether a timer runs."""


class LineDelays:
    """The slow stations and the overloads of a run.

    `states` returns the blocks of the run, `late_of` the late replies of a channel; None without the channel.
    """

    def __init__(
        self, troubles: Troubles, clock: Clock, states: Callable[[], Iterable[BlockState]],
        late_of: Callable[[int], LateReplies | None],
    ) -> None:  # fmt: skip
        self._troubles, self._clock, self._states, self._late_of = troubles, clock, states, late_of
        self._slow: dict[int, dict[Hashable, TroubleSource]] = {}
        """Troubles of stations that answer after the time limit, by channel and station."""
        self._overloads: dict[int, _Overload] = {}
        self.on_explained: Callable[[int], None] = lambda channel: None
        """Called when a trouble begins that explains old values of a channel."""

    @property
    def names(self) -> set[str]:
        """Return the names of its troubles."""
        found = {source.name for sources in self._slow.values() for source in sources.values()}
        return found | {overload.source.name for overload in self._overloads.values()}

    def slow(self, channel: int, station: SlowStation, is_slow: bool) -> None:
        """Report that a station answers too late, again when its time changes, and when it answers in time."""
        sources, key = self._slow.setdefault(channel, {}), key_of(station.station)
        source = sources.get(key)
        if source is None:
            well = f"{station.who} answers in time again"
            source = sources[key] = self._troubles.source(f"channel {channel}", unit="", well=well, is_file=False)
        if not is_slow:
            source.ends()
        elif source.reason:
            source.changes(str(station))
        else:
            source.begins(str(station))
            self.on_explained(channel)

    def forget(self, channel: int) -> None:
        """End the troubles of a channel that is removed, or made again."""
        for source in self._slow.pop(channel, {}).values():
            source.ends(CHANGED)
        if (overload := self._overloads.get(channel)) is not None:
            overload.source.ends(CHANGED)

    def explains(self, channel: int, station: Hashable, blocks: Iterable[BlockState]) -> bool:
        """Return whether a trouble of the line explains that values of a station are too old; report such an overload.

        `station`: None if the channel has a single station; `blocks`: its blocks. A slow station counts for a minute
        after its last late reply, an overload for `CALM` after its last measurement. Neither explains a long exchange
        with another station.
        """
        now, late = self._clock.now(), self._late_of(channel)
        slow = {key for key, source in self._slow.get(channel, {}).items() if source.reason}
        own = slow if station is None else slow & {key_of(station), None}
        if own and late is not None and late.slow.is_late(now, station):
            return True
        if any(state.running and now - state.started_at > max(LONG_EXCHANGE, 2 * state.took) for state in blocks):
            return False
        if slow and late is not None and late.slow.is_late(now):
            return True
        overload = self._overloads.get(channel)
        demand = None if late is None or late.state_at(now) != "in step" else self._demand(channel)
        if demand is None:
            return overload is not None and bool(overload.source.reason) and now - overload.needed_at < CALM
        if overload is None:
            source = self._troubles.source(f"channel {channel}", unit="", well="the line keeps up again", is_file=False)
            overload = self._overloads[channel] = _Overload(source)
        overload.needed_at = now
        if not overload.source.reason:
            overload.source.begins(str(demand))
            self._look_later(channel, overload)
            self.on_explained(channel)
        return True

    def _demand(self, channel: int) -> Demand | None:
        """Return the demand of the lane of a channel that is overloaded; None if no lane is.

        The channel is in step: while late replies may come, an exchange may take longer than usual.
        """
        lanes: dict[Hashable, list[BlockState]] = {}
        for state in self._states():
            if state.block.channel == channel and state.block.job is None:
                lanes.setdefault(state.lane, []).append(state)
        demands = [demand for states in lanes.values() if (demand := demand_of(states)) is not None]
        return next((demand for demand in demands if demand.share >= FULL), None)

    def _look_later(self, channel: int, overload: _Overload) -> None:
        if not overload.looks:
            overload.looks = True
            self._clock.call_at(self._clock.now() + LOOK_AGAIN, lambda: self._look(channel, overload))

    def _look(self, channel: int, overload: _Overload) -> None:
        """End an overload when all values have been new enough for some time."""
        overload.looks = False
        if not overload.source.reason:
            return
        if self._clock.now() - overload.needed_at >= CALM:
            overload.source.ends()
        else:
            self._look_later(channel, overload)
