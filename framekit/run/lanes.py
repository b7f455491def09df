"""The blocks of one channel that wait: one exchange at a time, silences between them, stations that do not answer.

A station that shares its channel is suspected after its first failed exchange: its blocks are parked, and one of them
asks at most once in each period, without retries, after the blocks of other stations. So is a station that has not
answered since the port was opened: the first tries of a read are turns of their own. A station that has failed often
enough for long enough is dead: one of its blocks asks now and then until it answers. While a request to a station would
have to wait for late replies, and requests to other stations would not, its blocks are delayed. A lane knows neither
triggers nor exchanges.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

from framekit.definition.times import NEVER
from framekit.run.block_state import Failure
from framekit.run.model import DeadRule, Silence

if TYPE_CHECKING:
    from framekit.run.block_state import BlockState


Entry = tuple[int, int, int, "BlockState"]
"""When a block came due, its priority (less is sooner), its id, and the block."""

Taken = tuple["BlockState", Hashable]
"""A block whose turn it is, and the station it talks to."""


class Held(NamedTuple):
    """The wait for late replies of a station."""

    until: int = 0
    """Time before which no request to it is sent (ns); 0: it may be asked."""
    others_are_free: bool = False
    """Whether requests to some other station may be sent meanwhile."""
    is_late: bool = False
    """Whether its replies were late: it answers, perhaps after repeats."""


NOT_HELD = Held()

ALIVE = frozenset({"refused", "damaged_reply", "unfit_reply", "cannot_store"})
"""Failures after which a station is known to be there."""
OWN = frozenset(
    {
        "closed", "cancelled", "cannot_send", "bad_setting", "abandoned", "no_sequence", "queue_full", "expression",
        "circle", "interrupted", "not_allowed", "late_replies",
    }
)  # fmt: skip
"""Failures with another cause than the station."""


MOST_DOUBLED = 16
"""Failures after which the pause of a suspected station grows no more."""


LONGEST_DELAY = 180_000_000_000
"""After this time (ns) a delayed block waits on the line, where its exchange fails if late replies have no end."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LaneRules:
    """How a channel treats the line and its stations. `stations`: rules of single stations, None for never dead."""

    silence: Silence = field(default_factory=Silence)
    dead: DeadRule | None = None
    stations: Mapping[Hashable, DeadRule | None] = field(default_factory=dict)
    command_queue: int | None = None
    """Most command blocks that may wait; None: no limit."""
    command_start: int = 0
    """Time after the start of the run before which no command block is taken (ns)."""
    tries: int = 1
    """How often an exchange sends its request."""

    def dead_rule(self, station: Hashable) -> DeadRule | None:
        return self.stations.get(station, self.dead)


@dataclass(slots=True)
class _Failing:
    """A station that does not answer."""

    failures: int = 0
    """Failed exchanges since its last answer."""
    since: int = 0
    """Time of the first of them (ns)."""
    is_dead: bool = False
    ask_at: int | None = None
    """Time of the next exchange while the station is suspected or dead (ns); None: its blocks wait as usual."""
    pressing_from: int = NEVER
    """From this time on blocks of other stations no longer go first."""
    period: int = NEVER
    """Shortest period of the blocks that have failed (ns)."""
    parked: list[Entry] = field(default_factory=list)
    """Its blocks that wait, a heap."""


@dataclass(slots=True)
class _Delay:
    """The blocks of a station whose requests would have to wait for late replies."""

    until: int
    """Time at which they wait for their turn again, at the latest (ns)."""
    since: int
    """Time of the first delay (ns)."""
    entries: list[Entry] = field(default_factory=list)


class BlockLane:
    """One channel. `station_of` returns the station of a block; None counts as no station.

    `held_until` returns the time before which no request to a station is sent, because a late reply may come.
    """

    def __init__(
        self,
        rules: LaneRules,
        station_of: Callable[[BlockState], Hashable],
        order: int = 0,
        held_until: Callable[[Hashable], Held] = lambda station: NOT_HELD,
    ) -> None:
        self.order = order
        """Its place among the lanes."""
        self.asked_for = NEVER
        """Time of its entry in the heap of `ReadyQueue`."""
        self.noted = False
        """Whether `ReadyQueue` looks at it soon."""
        self.rules = rules
        self.station_of = station_of
        self._held_until = held_until
        self.stations: set[str] = set()
        """Stations of its blocks, as the run file names them."""
        self.waiting: list[Entry] = []
        """The blocks whose turn comes, a heap."""
        self.running: dict[int, Hashable] = {}
        """Ids of the blocks that run, each with its station."""
        self.open = True
        self.held = False
        self.free_from = 0
        """Time before which no block starts (ns)."""
        self.failing: dict[Hashable, _Failing] = {}
        """Stations that do not answer."""
        self._known: set[Hashable] = set()
        """Stations that have answered since the port was opened."""
        self._first_tries: dict[Hashable, int] = {}
        """For other stations the number of tries of their first reads."""
        self._probed = False
        """Whether the last block asked a station that is suspected or dead."""
        self._last: tuple[Hashable, int] | None = None
        """Station and end of the last exchange."""
        self._slow: tuple[Hashable, int] | None = None
        """Station and end of an exchange that took longer than its period; what came due before goes first."""
        self.delays: dict[Hashable, _Delay] = {}
        """Stations whose blocks are delayed."""
        self.delayed: list[tuple[BlockState, int]] = []
        """Blocks that have been delayed since the last report, each with the time of its turn at the latest (ns)."""
        self._away: dict[int, Hashable] = {}
        """Ids of blocks that were parked or delayed, each with the station for which that was done last."""
        self.changed: list[tuple[Hashable, bool]] = []
        """Stations that have died (True) or come back (False)."""

    @property
    def busy(self) -> bool:
        return bool(self.running)

    # ---- waiting ------------------------------------------------------------------------------------------

    def command_fault(self, since_start: int) -> str:
        """Return why no further command block may wait, or ''. `since_start`: time since the start of the run (ns)."""
        if since_start < self.rules.command_start:
            return "the channel takes no commands yet"
        if self.rules.command_queue is None:
            return ""
        waiting = sum(entry[3].block.commands is not None for entry in self.waiting)
        return "the queue of the channel is full" if waiting >= self.rules.command_queue else ""

    def look_again(self, state: BlockState) -> None:
        """Put a parked or delayed block back among the waiting blocks if its station has changed."""
        if state.id not in self._away or self._away[state.id] == self.station_of(state):
            return
        del self._away[state.id]
        for failing in self.failing.values():
            found = [entry for entry in failing.parked if entry[3] is state]
            for entry in found:
                failing.parked.remove(entry)
                heapq.heapify(failing.parked)
                heapq.heappush(self.waiting, entry)
        for delay in self.delays.values():
            for entry in [entry for entry in delay.entries if entry[3] is state]:
                delay.entries.remove(entry)
                heapq.heappush(self.waiting, entry)

    def clear(self, which: Callable[[BlockState], bool] = lambda state: True) -> None:
        """Forget blocks that wait."""
        parked = [failing.parked for failing in self.failing.values()]
        for entries in (self.waiting, *parked, *(delay.entries for delay in self.delays.values())):
            kept = [entry for entry in entries if not which(entry[3])]
            for *_, state in entries:
                if which(state):
                    state.waiting = False
                    self._away.pop(state.id, None)
            entries[:] = kept
            heapq.heapify(entries)

    @property
    def deadline(self) -> int:
        """Return when `take` may have something; NEVER without a waiting block, or while a block runs."""
        if self.running or not self.open or self.held:
            return NEVER
        if self.waiting:
            return self.free_from
        if not self.failing and not self.delays:
            return NEVER
        asks = [one.ask_at for one in self.failing.values() if one.parked and one.ask_at is not None]
        asks += [one.until for one in self.delays.values() if one.entries]
        return max(self.free_from, min(asks, default=NEVER))

    def take(self, now: int) -> BlockState | None:
        """Return the block that starts now, and count it as running; None if no block may start."""
        if self.running or not self.open or self.held or now < self.free_from:
            return None
        if self.delays:
            self._end_delays(now)
        if self.failing or len(self.stations) > 1:
            return self._take_besides_failing(now)
        waiting, last = self.waiting, self._last
        if not waiting:
            return None
        entry = heapq.heappop(waiting)
        state = entry[3]
        station = self.station_of(state) if state.has_station else None
        if last is not None and station != last[0] and not self._silent_for(station, now):
            heapq.heappush(waiting, entry)
            return None
        self._probed = False
        self.running[state.id] = station
        return state

    def _take_besides_failing(self, now: int) -> BlockState | None:
        """Return the next block, which may ask a station that does not answer; such turns and others alternate."""
        taken = None if self._probed else self._probe(now, pressing=True)
        if taken is None and now >= self.free_from:
            taken = self._next(now)
        if taken is None and now >= self.free_from:
            taken = self._probe(now, pressing=False)
        if taken is None:
            return None
        state, station = taken
        self._probed = state.probing
        if station not in self._known and station is not None and state.period and state.block.instruction == "read":
            state.probing = state.probing or (len(self.stations) > 1 and self.rules.tries > 1)
        if state.probing and self._held_until(station).is_late:
            state.probing = False  # a single try would never get a value
        self.running[state.id] = station
        return state

    def _probe(self, now: int, pressing: bool) -> Taken | None:
        """Return a block that asks a suspected or dead station whose time has come.

        `pressing`: only a dead station, or a suspected station that other stations have kept waiting for a period. A
        parked block that talks to another station now waits as usual again.
        """
        for station, failing in self.failing.items():
            rule = self.rules.dead_rule(station)
            if rule is None or failing.ask_at is None or failing.ask_at > now:
                continue
            if pressing and not failing.is_dead and failing.pressing_from > now:
                continue
            while failing.parked:
                entry = heapq.heappop(failing.parked)
                state = entry[3]
                if self.station_of(state) != station:
                    heapq.heappush(self.waiting, entry)
                    continue
                if not self._silent_for(station, now):
                    heapq.heappush(failing.parked, entry)
                    return None
                failing.ask_at = now + rule.longest_pause
                state.probing = True
                return state, station
        return None

    def _silent_for(self, station: Hashable, now: int) -> bool:
        """Return whether the line has been silent long enough for a station; else the channel is free when it has."""
        if self._last is None or station == self._last[0]:
            return True
        ready = self._last[1] + self.rules.silence.station
        if now < ready:
            self.free_from = ready
        return now >= ready

    def _next(self, now: int) -> Taken | None:
        """Return the next block of a station that answers.

        Blocks of other stations than a slow station that came due before its exchange ended go first. All waiting
        blocks are looked at once, however many of them are parked or delayed.
        """
        if self._slow is not None:
            slow, end = self._slow
            first: list[Entry] = []
            later: list[Entry] = []
            for entry in self.waiting:
                (first if entry[0] <= end and self.station_of(entry[3]) != slow else later).append(entry)
            heapq.heapify(first)
            taken = self._first_of(first, now)
            is_over = taken is None and not first
            self.waiting = first + later
            heapq.heapify(self.waiting)
            if not is_over:
                return taken
            self._slow = None
        return self._first_of(self.waiting, now)

    def _first_of(self, entries: list[Entry], now: int) -> Taken | None:
        """Take the first block of a heap that may start; park or delay the blocks before it."""
        last = self._last
        while entries:
            entry = heapq.heappop(entries)
            state = entry[3]
            station = self.station_of(state) if state.has_station else None
            failing = self.failing.get(station)
            if failing is not None and failing.ask_at is not None:
                heapq.heappush(failing.parked, entry)
                self._away[state.id] = station
                continue
            if self._is_delayed(entry, station, now):
                continue
            if last is not None and station != last[0] and not self._silent_for(station, now):
                heapq.heappush(entries, entry)
                return None
            return state, station
        return None

    def _is_delayed(self, entry: Entry, station: Hashable, now: int) -> bool:
        """Delay a block whose request would have to wait while other stations may be asked; return whether it does.

        Each wait is limited: afterwards the request waits on the line, if it still has to.
        """
        if len(self.stations) < 2:
            return False
        delay = self.delays.get(station)
        if delay is None:
            until, others_are_free, _ = self._held_until(station)
            if until <= now or not others_are_free:
                return False
            delay = self.delays[station] = _Delay(until, now)
        if delay.until <= now:
            return False
        delay.entries.append(entry)
        self._away[entry[3].id] = station
        self.delayed.append((entry[3], delay.until))
        return True

    def _end_delays(self, now: int) -> None:
        """Put the delayed blocks of stations that may be asked now back among the waiting blocks."""
        for station, delay in list(self.delays.items()):
            until, others_are_free, _ = self._held_until(station)
            is_free = until <= now
            if not is_free and others_are_free:
                delay.until = max(delay.until, min(until, delay.since + LONGEST_DELAY))
            if is_free or delay.until <= now:
                entries, delay.entries = delay.entries, []
                for entry in entries:
                    heapq.heappush(self.waiting, entry)
            if is_free:
                del self.delays[station]

    def companions(self, wanted: Callable[[list[BlockState]], list[BlockState]]) -> list[BlockState]:
        """Take the waiting blocks that `wanted` picks for the exchange of the block just taken; return them."""
        chosen = wanted([entry[3] for entry in self.waiting])
        if chosen:
            ids = {state.id for state in chosen}
            self.waiting = [entry for entry in self.waiting if entry[3].block.id not in ids]
            heapq.heapify(self.waiting)
            for state in chosen:
                self.running[state.id] = self.station_of(state)
        return chosen

    # ---- outcomes -----------------------------------------------------------------------------------------

    def ended(self, state: BlockState, failure: Failure | None, now: int, least: int) -> None:
        """Count the end of an exchange; the channel is free after the silence, and after `least` at the earliest."""
        station = self.running.pop(state.id)
        state.probing = False
        self._last = station, now
        if station in self.delays and self.delays[station].until <= now:
            del self.delays[station]
        if state.period and now - state.started_at > state.period and len(self.stations) > 1:
            self._slow = station, now
        between = self.rules.silence.between
        self.free_from = now + (least if least > between else between)
        if failure is None and station not in self._known:
            self._known.add(station)
        if station is not None and (failure is not None or self.failing):
            self._count_failure(state, station, failure, now)

    def tries_again(self, state: BlockState, failure: Failure | None) -> bool:
        """Return whether the failure of a read was the first or second try of a station that has not answered yet."""
        station = self.running[state.id]
        if not state.probing or station in self._known or station in self.failing or failure is None:
            return False
        if failure.outcome in OWN or failure.outcome in ALIVE or failure.device_code is not None:
            return False
        tries = self._first_tries[station] = self._first_tries.get(station, 0) + 1
        return tries < self.rules.tries

    def postponed(self, state: BlockState, now: int) -> None:
        """Note that an exchange has made way for other stations, and that its block waits again."""
        station = self.running.pop(state.id)
        state.probing = False
        self._last = self._slow = station, now
        self.free_from = now + self.rules.silence.between
        self._ask_again(state, station, now)

    def _count_failure(self, state: BlockState, station: Hashable, failure: Failure | None, now: int) -> None:
        if failure is not None and failure.outcome in OWN:
            self._ask_again(state, station, now)
            return
        failing = self.failing.get(station)
        if failure is None or failure.outcome in ALIVE or failure.device_code is not None:
            self._known.add(station)
            if failing is not None:
                del self.failing[station]
                for entry in failing.parked:
                    heapq.heappush(self.waiting, entry)
                if failing.is_dead:
                    self.changed.append((station, False))
            return
        rule = self.rules.dead_rule(station)
        if rule is None:
            return
        if failing is None:
            failing = self.failing[station] = _Failing(since=now)
        failing.failures += 1
        failing.period = min(failing.period, state.period or 2 * (now - state.started_at))
        if failing.is_dead:
            if self._costs_nobody(rule):
                failing.ask_at = self._next_ask(failing, rule, state, now)
            return
        if failing.failures >= rule.failures and now - failing.since >= rule.after:
            alone = self._costs_nobody(rule)
            failing.is_dead = True
            failing.ask_at = self._next_ask(failing, rule, state, now) if alone else now + rule.longest_pause
            self.changed.append((station, True))
        elif len(self.stations) > 1:
            failing.ask_at = now
            self._ask_again(state, station, now)

    def _costs_nobody(self, rule: DeadRule) -> bool:
        """Return whether a dead station may be asked often: it is alone on its channel, and the file sets no time."""
        return rule.every is None and len(self.stations) <= 1

    def _next_ask(self, failing: _Failing, rule: DeadRule, state: BlockState, now: int) -> int:
        """Return when a dead station that is alone is asked again: a period after the last request at the earliest.

        The line rests for as long as that request took.
        """
        took = now - state.started_at
        return min(max(state.started_at + failing.period, now + took), now + rule.longest_pause)

    def _ask_again(self, state: BlockState, station: Hashable, now: int) -> None:
        """Set when a suspected station is asked again: a period after it was asked, and later after each failure more.

        The pauses are 1, 3, 7 … periods from the second failure on, but not longer than those of a dead station.
        """
        failing, rule = self.failing.get(station), self.rules.dead_rule(station)
        if failing is None or failing.ask_at is None or failing.is_dead or rule is None:
            return
        pause = min(failing.period * ((1 << min(failing.failures, MOST_DOUBLED) - 1) - 1), rule.longest_pause)
        failing.ask_at = max(now + pause, state.started_at + failing.period, self._held_until(station).until)
        failing.pressing_from = failing.ask_at + failing.period

    def is_failing(self, state: BlockState) -> bool:
        """Return whether the station of a running block is suspected or dead."""
        return bool(self.failing) and self.running[state.id] in self.failing

    def is_dead(self, station: Hashable) -> bool:
        failing = self.failing.get(station)
        return failing is not None and failing.is_dead

    def changes(self) -> list[tuple[Hashable, bool]]:
        """Return the entries of `changed` since the last call."""
        found, self.changed = self.changed, []
        return found

    def opened(self, now: int) -> None:
        """Note that the port is open: blocks start after a silence of the line, and every station gets a new chance."""
        self.open = True
        self.free_from = max(self.free_from, now + self.rules.silence.connect)
        self.forget_failures()

    def forget_failures(self) -> None:
        for station, failing in self.failing.items():
            for entry in failing.parked:
                heapq.heappush(self.waiting, entry)
            if failing.is_dead:
                self.changed.append((station, False))
        self.failing.clear()
        self._known.clear()
        self._first_tries.clear()
