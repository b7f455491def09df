"""Parameter sets, blocks and channels switched on and off, reset, silences, and stations that do not answer."""

from __future__ import annotations

from collections.abc import Hashable
from itertools import pairwise

import pytest

from framekit.definition.problems import NOWHERE
from framekit.link.addresses import Address
from framekit.memory.memory import Area, DeviceMemory
from framekit.run.block_state import BlockState, Failure
from framekit.run.lanes import LaneRules
from framekit.run.model import Block, DeadRule, Silence
from framekit.run.scheduler import Scheduler
from framekit.run.triggers import BlockEnd, Every, Trigger

MS = 1_000_000
SECOND = 1000 * MS


def block(number: int, *triggers: Trigger, set_: int = 1, station: Hashable = None, priority: int = 0) -> Block:
    return Block(
        number=number, set=set_, name=f"block {number}", instruction="read", channel=1, station=station,
        triggers=triggers, priority=priority, at=NOWHERE,
    )  # fmt: skip


def every(period: int) -> Every:
    return Every(period=period * MS, phase=0)


class Bench:
    """A scheduler on one channel; exchanges take `duration`, those with a station in `silent` five times as long."""

    def __init__(
        self, *blocks: Block, rules: LaneRules | None = None, duration: int = 10, sets: dict[int, bool] | None = None
    ) -> None:
        self.now = 0
        self.duration = duration * MS
        self.silent: set[Hashable] = set()
        self.starts: list[tuple[int, int]] = []
        self.deaths: list[tuple[int, Hashable, bool]] = []
        self.running: tuple[int, int, Failure | None] | None = None
        self.scheduler = Scheduler(
            blocks, DeviceMemory([Area("M", size=16)]), self._no_address, {1: rules or LaneRules()},
            self._start, lambda: None, station_of=lambda state: state.block.station,
            sets=sets or {1: True}, died=lambda _, station, dead: self.deaths.append((self.now, station, dead)),
        )  # fmt: skip
        self.scheduler.begin(0)

    @staticmethod
    def _no_address(text: str) -> Address:
        raise ValueError(text)

    def _start(self, state: BlockState, now: int) -> None:
        assert self.running is None, "one exchange at a time"
        self.starts.append((now // MS, state.block.id))
        silent = state.block.station in self.silent
        failure = Failure(outcome="no_reply") if silent else None
        self.running = now + self.duration * (5 if silent else 1), state.block.id, failure

    def run_until(self, time: int) -> None:
        while True:
            end = self.running[0] if self.running is not None else 1 << 62
            due = max(self.now, min(self.scheduler.deadline, end))
            if due > time * MS:
                self.now = time * MS
                return
            self.now = due
            if self.running is not None and end <= due:
                _, number, failure = self.running
                self.running = None
                self.scheduler.finished(number, failure, due)
            self.scheduler.tick(due)
            for state in self.scheduler.states.values():
                counters = state
                assert counters.started == counters.done + counters.failed + counters.running

    def done(self, number: int) -> int:
        return self.scheduler.states[number].done


def test_the_same_number_in_two_sets_is_two_blocks() -> None:
    bench = Bench(
        block(5, every(100)), block(6, BlockEnd(block=5, ok=True)),
        block(5, every(200), set_=2), block(6, BlockEnd(block=5, ok=True), set_=2), sets={1: True, 2: True},
    )  # fmt: skip
    bench.run_until(1000)
    assert [bench.done(number) for number in (5, 6, 69, 70)] == [10, 10, 5, 5]


def test_a_set_that_is_off_does_nothing_and_counts_from_when_it_is_switched_on() -> None:
    bench = Bench(block(0, every(100)), block(0, every(100), set_=2), sets={1: True, 2: False})
    bench.run_until(450)
    assert (bench.done(0), bench.done(64)) == (5, 0)
    bench.scheduler.enable_set(2, True, bench.now)
    bench.scheduler.enable_set(1, False, bench.now)
    bench.run_until(900)
    assert (bench.done(0), bench.done(64)) == (5, 5)
    assert [time for time, number in bench.starts if number == 64] == [450, 550, 650, 750, 850]
    with pytest.raises(KeyError):
        bench.scheduler.enable_set(3, True, bench.now)


def test_switching_off_forgets_what_waits_and_lets_run_what_runs() -> None:
    bench = Bench(block(0, every(1000)), block(1, every(1000)), duration=100)
    bench.run_until(50)
    bench.scheduler.enable(1, False, bench.now)
    bench.scheduler.enable(0, False, bench.now)
    bench.run_until(3000)
    assert (bench.done(0), bench.done(1)) == (1, 0)
    assert not bench.scheduler.states[1].waiting


def test_reset_counts_anew() -> None:
    bench = Bench(block(0, every(100)), block(1, every(100)), duration=30)
    bench.run_until(510)
    assert bench.running is not None
    bench.scheduler.reset(bench.now)
    assert sum(state.started for state in bench.scheduler.states.values()) == 1, "what runs is still counted"
    bench.run_until(1500)
    for state in bench.scheduler.states.values():
        assert state.done in (10, 11)
    assert [time for time, number in bench.starts if number == 1][-1] % 100 == 40, "cycles count from the reset"


def test_silence_between_exchanges_stations_and_after_opening() -> None:
    rules = LaneRules(silence=Silence(between=5 * MS, station=20 * MS, connect=50 * MS))
    bench = Bench(
        block(0, every(1000), station=1),
        block(1, every(1000), station=1),
        block(2, every(1000), station=2),
        rules=rules,
    )
    bench.scheduler.set_open(1, False, 0)
    bench.starts.clear()
    bench.run_until(100)
    bench.scheduler.set_open(1, True, 100 * MS)
    bench.run_until(500)
    times = [time for time, _ in bench.starts]
    assert times[0] >= 150
    gaps = [later - sooner for sooner, later in pairwise(times)]
    assert all(gap in (15, 30) for gap in gaps), "10 ms of exchange, then 5 ms, or 20 ms to another station"


def test_a_station_is_dead_after_failures_and_time_and_comes_back_by_itself() -> None:
    rule = DeadRule(failures=3, after=SECOND, every=5 * SECOND)
    bench = Bench(block(0, every(100), station=1), block(1, every(100), station=2), rules=LaneRules(dead=rule))
    bench.silent.add(2)
    bench.run_until(20_000)
    died = bench.deaths[0][0]
    assert bench.deaths[0][1:] == (2, True)
    assert SECOND <= died <= SECOND + 500 * MS, "a suspected station is asked ever more rarely"
    probes = [time for time, number in bench.starts if number == 1 and time * MS > died]
    assert len(probes) == 3
    assert all(abs(later - sooner - 5000) <= 60 for sooner, later in pairwise(probes))
    assert bench.scheduler.states[1].dead and not bench.scheduler.states[0].dead
    assert bench.done(0) >= 195, "the other station goes on"
    bench.silent.clear()
    bench.run_until(30_000)
    assert bench.deaths[-1][1:] == (2, False)
    assert not bench.scheduler.states[1].dead
    assert bench.done(1) >= 40


def test_failures_that_say_nothing_of_the_station_do_not_count() -> None:
    rule = DeadRule(failures=2, after=0, every=SECOND)
    bench = Bench(block(0, every(100), station=1), rules=LaneRules(dead=rule))
    lane = bench.scheduler.lanes[1]
    for outcome in ("closed", "bad_setting", "refused", "damaged_reply"):
        for _ in range(5):
            bench.now += 10 * MS
            lane.running[0] = 1
            lane.ended(bench.scheduler.states[0], Failure(outcome=outcome), bench.now, 0)
    assert lane.changed == []


def test_one_that_is_never_dead() -> None:
    rules = LaneRules(dead=DeadRule(failures=1, after=0, every=SECOND), stations={2: None})
    bench = Bench(block(0, every(100), station=2), rules=rules)
    bench.silent.add(2)
    bench.run_until(1000)
    assert bench.deaths == []
    assert bench.scheduler.states[0].failed >= 9


def test_a_write_is_not_starved_by_reads_that_overload_the_channel() -> None:
    reads = [block(number, every(20)) for number in range(5)]
    bench = Bench(*reads, block(9, every(1000)), duration=20)
    bench.run_until(10_000)
    assert bench.done(9) == 10
    waits = [time % 1000 for time, number in bench.starts if number == 9]
    assert max(waits) <= 120, "at most one exchange of each of the others is before it"
