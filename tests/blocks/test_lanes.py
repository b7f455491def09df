"""One channel: order of the blocks, silences, and rare polling of stations that do not answer."""

from __future__ import annotations

import sys
from collections.abc import Hashable
from itertools import pairwise
from types import FrameType

import pytest

from framekit.definition.expression import parse_expression
from framekit.definition.problems import NOWHERE
from framekit.link.addresses import Address
from framekit.memory.memory import Area, DeviceMemory
from framekit.run.block_state import BlockState, Failure
from framekit.run.lanes import Held, LaneRules
from framekit.run.model import Block, DeadRule, Silence
from framekit.run.scheduler import Scheduler
from framekit.run.triggers import Every, While

MS = 1_000_000


def block(number: int, period: int, station: int = 1, **keys: object) -> Block:
    """Return a block that is due every `period` ms."""
    trigger = Every(period=period * MS, phase=0)
    keys = {"triggers": (trigger,), **keys}
    return Block(number=number, set=1, name="", instruction="read", channel=1, station=station, at=NOWHERE, **keys)  # type: ignore[arg-type]


class Bench:
    """A channel whose exchanges take `duration` ms.

    `outcomes` maps stations to the end of their exchanges (default: done).
    """

    def __init__(self, *blocks: Block, duration: int = 10, **rules: object) -> None:
        self.memory = DeviceMemory([Area("M", size=16)])
        self.memory.write("M", "word", 1, [1])
        self.duration = duration * MS
        self.durations: dict[int, int] = {}
        self.outcomes: dict[int, str] = {}
        self.starts: list[tuple[int, int]] = []
        self.died: list[tuple[int, Hashable, bool]] = []
        self.end: tuple[int, BlockState] | None = None
        self.now = 0
        self.held: dict[int, tuple[int, bool]] = {}
        self.delayed: list[tuple[int, int]] = []
        self.scheduler = Scheduler(
            blocks, self.memory, lambda text: Address("M", "word", int(text[1:])),
            {1: LaneRules(**rules)},  # type: ignore[arg-type]
            self._start, lambda: None, station_of=lambda state: state.block.station,
            died=lambda channel, station, dead: self.died.append((self.now // MS, station, dead)),
            held_until=lambda channel, station: Held(*self.held.get(station, (0, False))),  # type: ignore[call-overload]
            delayed=lambda state, until: self.delayed.append((state.block.number, until // MS)),
        )  # fmt: skip
        self.scheduler.begin(0)

    def _start(self, state: BlockState, now: int) -> None:
        self.starts.append((now // MS, state.block.number))
        self.end = now + self.durations.get(state.block.station, self.duration), state

    def run_until(self, time: int) -> None:
        while (due := min(self.scheduler.deadline, self.end[0] if self.end else 1 << 62)) <= time * MS:
            self.now = now = max(self.now, due)
            if self.end is not None and self.end[0] <= now:
                state, self.end = self.end[1], None
                outcome = self.outcomes.get(state.block.station)
                self.scheduler.finished(state.block.id, Failure(outcome=outcome) if outcome else None, now)
            self.scheduler.tick(now)
        self.now = time * MS

    def of(self, number: int) -> list[int]:
        return [time for time, one in self.starts if one == number]


def always(number: int, **keys: object) -> Block:
    return block(number, 1, triggers=(While(condition=parse_expression("M1", NOWHERE)),), **keys)


def test_a_write_that_is_due_is_not_starved_by_reads_that_go_on_and_on() -> None:
    bench = Bench(always(0), always(1, priority=9), block(2, 1000))
    bench.run_until(10_000)
    starts = bench.of(2)
    assert len(starts) in (10, 11) and max(time % 1000 for time in starts) <= 20, "after two exchanges at the latest"


def test_a_write_that_is_due_is_not_starved_by_an_overloaded_channel() -> None:
    bench = Bench(*(block(number, 20, priority=number) for number in range(8)), block(60, 500))
    bench.run_until(10_000)
    starts = bench.of(60)
    assert 20 <= len(starts) <= 21 and max(time % 500 for time in starts) <= 90, "each of the others once, at most"
    for number in range(8):
        counters = bench.scheduler.states[number]
        assert counters.overruns > 0 and counters.started + counters.overruns == pytest.approx(501, abs=1)


def test_silence_when_the_station_changes_and_between_exchanges() -> None:
    silence = Silence(between=5 * MS, station=20 * MS)
    bench = Bench(block(0, 1000), block(1, 1000, station=2), block(2, 1000, station=2), silence=silence)
    bench.run_until(500)
    assert bench.starts == [(0, 0), (30, 1), (45, 2)]


def test_silence_after_opening() -> None:
    bench = Bench(block(0, 1000), silence=Silence(connect=200 * MS))
    bench.run_until(500)
    bench.scheduler.set_open(1, False)
    bench.run_until(1600)
    bench.scheduler.set_open(1, True, 1600 * MS)
    bench.run_until(1900)
    assert bench.of(0) == [0, 1800]


DEAD = DeadRule(failures=3, after=1000 * MS, every=5000 * MS)


def test_a_station_is_dead_after_failures_and_time_and_comes_back() -> None:
    bench = Bench(block(0, 100), block(1, 100, station=2), duration=30, dead=DEAD)
    bench.outcomes[2] = "no_reply"
    bench.run_until(20_000)
    asks = [time for time in bench.of(1) if time < 2000]
    assert len(asks) == 5 and bench.died[0][0] >= 1030, "after 1 s, not after 3 failures"
    probes = [time for time in bench.of(1) if time > 2000]
    assert [later - earlier for earlier, later in pairwise(probes)] == [5000] * (len(probes) - 1)
    assert [(station, dead) for _, station, dead in bench.died] == [(2, True)]
    bench.outcomes.clear()
    bench.run_until(30_000)
    assert [(station, dead) for _, station, dead in bench.died] == [(2, True), (2, False)]
    assert bench.of(1)[-1] >= 29_900
    assert len(bench.of(0)) == 301, "nothing of the other station is lost"


def test_a_suspected_station_lets_the_others_go_first_and_is_asked_ever_more_rarely() -> None:
    """After its first failure a station gets single attempts; the pauses grow up to that of a dead station."""
    rule = DeadRule(failures=99, after=0, every=2000 * MS)
    bench = Bench(block(0, 100), block(1, 100, station=2), block(2, 100), duration=30, dead=rule)
    bench.outcomes[2] = "no_reply"
    attempts: list[tuple[int, bool]] = []
    start = bench._start
    bench.scheduler._start = lambda state, now: (  # type: ignore[method-assign]
        attempts.append((now // MS, state.probing)) if state.block.number == 1 else None,
        start(state, now),
    )[1]
    bench.run_until(10_000)
    assert attempts[:2] == [(30, False), (160, True)], "the second time after both others"
    pauses = [later[0] - earlier[0] - 30 for earlier, later in pairwise(attempts)]
    wanted = [100, 300, 700, 1500, 2000, 2000]
    assert all(0 <= pause - least <= 60 for pause, least in zip(pauses[1:], wanted, strict=False)), pauses
    assert len(bench.of(0)) >= 100 and len(bench.of(2)) >= 100, "the others miss nothing"
    assert bench.died == []
    bench.outcomes.clear()
    bench.run_until(20_000)
    assert len([time for time in bench.of(1) if time >= 12_100]) >= 78, "the first answer ends it"


def test_a_station_alone_on_its_channel_is_not_suspected() -> None:
    bench = Bench(block(0, 100), duration=30, dead=DeadRule(failures=99, after=0))
    bench.outcomes[1] = "no_reply"
    bench.run_until(2_050)
    assert bench.of(0) == list(range(0, 2_001, 100))


def test_a_suspected_station_has_its_turn_on_a_line_without_a_pause() -> None:
    """Blocks that are always due delay the station by a period at most."""
    bench = Bench(always(0), block(1, 100, station=2), duration=30, dead=DeadRule(failures=4, after=0))
    bench.outcomes[2] = "no_reply"
    bench.run_until(5_000)
    assert len(bench.of(1)) == 4 and [dead for _, _, dead in bench.died] == [True]


def test_several_blocks_of_a_suspected_station_ask_once_in_a_period_together() -> None:
    others = [block(number, 500, station=2) for number in range(1, 6)]
    bench = Bench(block(0, 100), *others, duration=30, dead=DeadRule(failures=99, after=0))
    bench.outcomes[2] = "no_reply"
    bench.run_until(1_400)
    asks = [time for time, number in bench.starts if number > 0]
    assert asks == [30, 530, 1060], "the five blocks together once in 500 ms"
    bench.outcomes.clear()
    bench.run_until(5_000)
    assert all(len([time for time in bench.of(number) if time > 2_000]) >= 5 for number in range(1, 6)), (
        "back at once, all of them"
    )


@pytest.mark.parametrize("outcome", ["refused", "cannot_send", "bad_setting", "unfit_reply", "not_allowed"])
def test_other_failures_are_no_silence(outcome: str) -> None:
    bench = Bench(block(0, 100), dead=DEAD)
    bench.outcomes[1] = outcome
    bench.run_until(10_000)
    assert bench.died == [] and len(bench.of(0)) == 101


def test_an_answer_between_failures_counts_anew() -> None:
    bench = Bench(block(0, 100), dead=DEAD)
    for time in range(1, 21):
        bench.outcomes[1] = "no_reply"
        bench.run_until(500 * time - 50)
        bench.outcomes.clear()
        bench.run_until(500 * time + 50)
    assert bench.died == []


def test_a_single_station_may_have_its_own_rule() -> None:
    bench = Bench(block(0, 100), block(1, 100, station=2), dead=DEAD, stations={2: None})
    bench.outcomes |= {1: "no_reply", 2: "no_reply"}
    bench.run_until(10_000)
    assert [station for _, station, _ in bench.died] == [1]
    assert len(bench.of(1)) >= 100


def test_a_probe_keeps_the_silence_before_another_station() -> None:
    """Station 2 is dead; 5 ms of silence separate exchanges with different stations."""
    bench = Bench(
        block(0, 20, station=1), block(1, 20, station=2), duration=10,
        silence=Silence(station=5 * MS), dead=DeadRule(failures=1, after=0, every=100 * MS),
    )  # fmt: skip
    bench.outcomes[2] = "no_reply"
    bench.run_until(2_000)
    changes = [(a, b) for a, b in pairwise(bench.starts) if a[1] != b[1]]
    assert len(changes) > 10
    assert all(b[0] - a[0] >= 15 for a, b in changes)


def test_probes_of_many_dead_stations_leave_every_other_turn_to_the_living() -> None:
    """Seven dead stations whose probes take longer than their period allows: block 0 still gets half of the line."""
    dead = [block(number, 10, station=number + 1) for number in range(1, 8)]
    bench = Bench(block(0, 20), *dead, duration=10, dead=DeadRule(failures=1, after=0, every=20 * MS))
    for one in dead:
        bench.outcomes[one.station] = "no_reply"
    bench.run_until(4_000)
    late = [number for time, number in bench.starts if time > 2_000]
    assert late.count(0) >= 0.45 * len(late)
    for state in bench.scheduler.states.values():
        assert state.started == state.done + state.failed + state.running


def test_a_block_that_is_redirected_leaves_its_dead_station_at_once() -> None:
    """The block's flag is cleared, and no further probe of the dead station is sent."""
    bench = Bench(block(0, 100, station=2), dead=DeadRule(failures=1, after=0, every=10_000 * MS))
    bench.outcomes[2] = "no_reply"
    bench.run_until(350)
    state = bench.scheduler.states[0]
    assert state.dead and state.started == 1
    state.block = block(0, 100, station=3)
    bench.run_until(1_050)
    assert not state.dead
    assert state.done == 7


def test_a_reopened_port_and_a_reset_take_the_flag_of_dead_stations_away() -> None:
    for again in ("reopened", "reset"):
        bench = Bench(block(0, 100, station=2), dead=DeadRule(failures=1, after=0, every=10_000 * MS))
        bench.outcomes[2] = "no_reply"
        bench.run_until(50)
        assert bench.scheduler.states[0].dead
        if again == "reset":
            bench.scheduler.reset(bench.now)
        else:
            bench.scheduler.set_open(1, False)
            bench.scheduler.set_open(1, True, bench.now)
        assert not bench.scheduler.states[0].dead
        assert bench.died[-1][1:] == (2, False)


def test_a_slow_station_waits_for_what_came_due_at_others() -> None:
    """Three blocks of a station that takes 2.5 s per exchange: another station has a turn after each of them."""
    bench = Bench(*(block(number, 1000, 3) for number in range(3)), block(3, 1000, 1), block(4, 1000, 1))
    bench.durations[3] = 2500 * MS
    bench.run_until(60_000)
    order = [number for _, number in bench.starts]
    assert {number for number in order if number < 3} == {0, 1, 2}
    assert all(
        not (before < 3 and after < 3) for before, after in pairwise(order[1:])
    )  # the first exchange began before the station was known to be slow
    assert order.count(3) > 20 and order.count(4) > 20


def test_blocks_of_a_station_that_waits_for_late_replies_are_delayed_and_the_others_go_on() -> None:
    bench = Bench(block(0, 100), block(1, 100, station=2), block(2, 100, station=2))
    bench.held[2] = 1000 * MS, True
    bench.run_until(500)
    assert [number for _, number in bench.starts] == [0] * 6
    assert bench.delayed == [(1, 1000), (2, 1000)], "also when they come due again"
    bench.held[2] = 0, False
    bench.scheduler.look_at(1)
    bench.run_until(560)
    assert bench.starts[6:8] == [(510, 1), (520, 2)]


@pytest.mark.parametrize(("others_are_free", "first"), [(True, 900), (False, 0)])
def test_a_delay_lasts_as_long_as_the_hold_of_its_station(others_are_free: bool, first: int) -> None:
    """On the line it would keep the other stations waiting. A hold of all stations delays no single block."""
    bench = Bench(block(0, 1000), block(1, 1000, station=2))
    bench.held[2] = 300 * MS, others_are_free
    bench.run_until(200)
    bench.held[2] = 900 * MS, others_are_free
    bench.run_until(950)
    ((begun, _),) = [start for start in bench.starts if start[1] == 1]
    assert begun == max(first, 10)


def test_delayed_blocks_are_cleared_and_redirected() -> None:
    bench = Bench(block(0, 1000), block(1, 1000, station=2), block(2, 50, station=2))
    bench.held[2] = 10_000 * MS, True
    bench.run_until(20)
    bench.scheduler.enable([*bench.scheduler.states][1], False, bench.now)
    bench.held[2] = 0, False
    bench.scheduler.look_at(1)
    bench.run_until(45)
    assert [number for _, number in bench.starts] == [0, 2]


def calls_after_a_slow_exchange(count: int, is_held: bool) -> int:
    """Return the number of calls while all blocks of a slow station are parked or delayed at once."""
    others = [block(number, 1_000_000, station=2) for number in range(2, count)]
    dead = None if is_held else DeadRule(failures=9, after=1000 * MS)
    bench = Bench(block(0, 1_000_000, station=2), block(1, 10), *others, dead=dead)
    bench.durations[1] = 200 * MS
    bench.outcomes[2] = "no_reply"
    if is_held:
        bench.held[2] = 1 << 60, True
    calls = 0

    def counted(frame: object, event: str, argument: object) -> None:
        nonlocal calls
        calls += event in ("call", "c_call")

    sys.setprofile(counted)
    try:
        bench.run_until(300)
    finally:
        sys.setprofile(None)
    lane = bench.scheduler.lanes[1]
    away = lane.delays[2].entries if is_held else lane.failing[2].parked
    assert (bench.starts, len(away)) == ([(0, 0), (10, 1), (210, 1)], count - 2)
    return calls


@pytest.mark.parametrize("is_held", [True, False])
def test_blocks_that_are_parked_or_delayed_beside_a_slow_station_take_work_once(is_held: bool) -> None:
    few, many = (calls_after_a_slow_exchange(count, is_held) for count in (100, 400))
    assert many < 4 * 1.3 * few


def work_of_blocks_that_come_due_again(count: int) -> int:
    """Return the number of byte codes of one more period, while all blocks of a station are delayed."""
    bench = Bench(block(0, 10), *(block(number, 50, station=2) for number in range(1, count)))
    bench.held[2] = 1 << 60, True
    bench.run_until(60)
    assert len(bench.scheduler.lanes[1].delays[2].entries) == count - 1
    done = 0

    def counted(frame: FrameType, event: str, argument: object) -> object:
        nonlocal done
        frame.f_trace_opcodes, frame.f_trace_lines = True, False
        done += event == "opcode"
        return counted

    sys.settrace(counted)
    try:
        bench.run_until(110)
    finally:
        sys.settrace(None)
    assert all(bench.scheduler.states[number].overruns >= 2 for number in range(1, count))
    return done


def test_delayed_blocks_that_come_due_again_take_work_for_themselves_only() -> None:
    few, many = (work_of_blocks_that_come_due_again(count) for count in (50, 200))
    assert many < 4 * 1.3 * few
