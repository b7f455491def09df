"""The scheduler alone: cycles without drift, edges, chains, overruns, one exchange at a time, counters."""

from __future__ import annotations

import itertools

import pytest

from framekit.definition.expression import parse_expression
from framekit.definition.problems import NOWHERE
from framekit.definition.times import NEVER
from framekit.link.addresses import Address
from framekit.memory.memory import Area, DeviceMemory
from framekit.run.block_state import BlockState, Failure
from framekit.run.model import Block
from framekit.run.scheduler import Scheduler
from framekit.run.triggers import AfterStart, BlockEnd, Changed, Every, Rising, Trigger, While

MS = 1_000_000


def block(number: int, *triggers: Trigger, channel: int = 1, **more: object) -> Block:
    return Block(
        number=number, set=1, name=f"block {number}", instruction="send", channel=channel,
        triggers=triggers, at=NOWHERE, **more,
    )  # type: ignore[arg-type]  # fmt: skip


def resolve(name: str) -> Address:
    """Resolve names: `M3` is word 3, `M3b5` is its bit 5."""
    word, _, bit = name[1:].partition("b")
    return Address("M", "bit", int(word) * 16 + int(bit), name) if bit else Address("M", "word", int(word), name)


class Bench:
    """A scheduler whose exchanges take `duration`; the test calls it."""

    def __init__(self, *blocks: Block, duration: int = 0, pause: int = 0) -> None:
        self.memory = DeviceMemory([Area("M", size=64)])
        self.starts: list[tuple[int, int]] = []
        self.ends: list[tuple[int, int, bool]] = []
        self.duration = duration
        self.now = 0
        self.bad: set[int] = set()
        channels = {block.channel: pause for block in blocks}
        self.scheduler = Scheduler(blocks, self.memory, resolve, channels, self._start, lambda: None)
        self.scheduler.begin(0)

    def _start(self, state: BlockState, now: int) -> None:
        number = state.block.number
        self.starts.append((now // MS, number))
        self.ends.append((now + self.duration, number, number not in self.bad))

    def run_until(self, time: int) -> None:
        while True:
            due = min([self.scheduler.deadline, *(end[0] for end in self.ends)])
            due = max(due, self.now)
            if due > time * MS:
                self.now = time * MS
                return
            self.now = due
            ready = [end for end in self.ends if end[0] <= due]
            self.ends = [end for end in self.ends if end[0] > due]
            for _, number, ok in ready:
                self.scheduler.finished(number, None if ok else Failure(outcome="no_reply"), due)
            self.scheduler.tick(due)

    def counters(self, number: int) -> tuple[int, int, int, int]:
        found = self.scheduler.states[number]
        assert found.started == found.done + found.failed + found.running
        return found.started, found.done, found.failed, found.overruns


def test_a_cycle_keeps_its_phase() -> None:
    bench = Bench(block(0, Every(period=100 * MS, phase=30 * MS)), duration=40 * MS)
    bench.run_until(1000)
    assert [time for time, _ in bench.starts] == list(range(30, 1000, 100))
    assert bench.counters(0) == (10, 10, 0, 0)


def test_a_slow_exchange_skips_cycles_and_counts_them() -> None:
    bench = Bench(block(0, Every(period=100 * MS, phase=100 * MS)), duration=250 * MS)
    bench.run_until(1000)
    assert [time for time, _ in bench.starts] == [100, 400, 700, 1000]
    assert bench.scheduler.states[0].overruns == 6


def test_a_rising_edge_starts_once() -> None:
    bench = Bench(block(0, Rising(condition=parse_expression("M3b5", NOWHERE))))
    for value in (1, 1, 0, 1):
        bench.memory.write("M", "bit", 53, [value])
        bench.run_until(bench.now // MS + 1)
    assert bench.counters(0)[0] == 2


def test_a_pulse_between_two_ticks_is_not_missed() -> None:
    bench = Bench(block(0, Rising(condition=parse_expression("M3b5", NOWHERE))))
    bench.memory.write("M", "bit", 53, [1])
    bench.memory.write("M", "bit", 53, [0])
    bench.run_until(1)
    assert bench.counters(0)[0] == 1


def test_an_expression_over_words_is_looked_at_when_they_change() -> None:
    bench = Bench(block(0, Rising(condition=parse_expression("M1 > 5 and M2 == 0", NOWHERE))))
    bench.memory.write("M", "word", 1, [6])
    bench.run_until(1)
    bench.memory.write("M", "word", 2, [1])
    bench.memory.write("M", "word", 2, [0])
    bench.run_until(2)
    assert bench.counters(0)[0] == 2


def test_while_starts_again_as_long_as_it_holds() -> None:
    bench = Bench(block(0, While(condition=parse_expression("M1", NOWHERE))), duration=9 * MS)
    bench.memory.write("M", "word", 1, [1])
    bench.run_until(95)
    bench.memory.write("M", "word", 1, [0])
    bench.run_until(300)
    assert [time for time, _ in bench.starts] == [0, *range(10, 100, 10)]


def test_a_change_of_an_area_starts() -> None:
    bench = Bench(block(0, Changed(address=Address("M", "word", 4), words=3)))
    for word in (3, 4, 6, 7):
        bench.memory.write("M", "word", word, [1])
        bench.run_until(bench.now // MS + 1)
    assert bench.counters(0)[0] == 2


def test_blocks_follow_the_end_of_others() -> None:
    bench = Bench(
        block(0, Every(period=100 * MS, phase=0)),
        block(1, BlockEnd(block=0, ok=True)),
        block(2, BlockEnd(block=0, ok=False)),
        duration=5 * MS,
    )
    bench.run_until(90)
    bench.bad.add(0)
    bench.run_until(190)
    assert bench.starts == [(0, 0), (5, 1), (100, 0), (105, 2)]


def test_one_exchange_at_a_time_by_due_time_priority_and_number() -> None:
    bench = Bench(
        block(0, AfterStart(delay=0)),
        block(3, AfterStart(delay=2 * MS)),
        block(2, AfterStart(delay=2 * MS)),
        block(1, AfterStart(delay=2 * MS), priority=5),
        duration=10 * MS,
        pause=5 * MS,
    )
    bench.run_until(200)
    assert bench.starts == [(0, 0), (15, 1), (30, 2), (45, 3)]


def test_channels_do_not_wait_for_each_other() -> None:
    bench = Bench(block(0, AfterStart(delay=0)), block(1, AfterStart(delay=0), channel=2), duration=50 * MS)
    bench.run_until(10)
    assert bench.starts == [(0, 0), (0, 1)]


def test_due_again_while_waiting_is_an_overrun_and_runs_once() -> None:
    bench = Bench(
        block(0, Rising(condition=parse_expression("M1", NOWHERE))), block(1, AfterStart(delay=0)), duration=50 * MS
    )
    for value in (1, 0, 1, 0, 1):
        bench.memory.write("M", "word", 1, [value])
    bench.run_until(300)
    assert bench.counters(0) == (1, 1, 0, 2)


@pytest.mark.parametrize(("repeat", "expected"), [(3, 3), (None, 10)])
def test_repeat_bounds_the_starts(repeat: int | None, expected: int) -> None:
    bench = Bench(block(0, Every(period=10 * MS, phase=10 * MS), repeat=repeat))
    bench.run_until(100)
    assert bench.counters(0)[0] == expected


def test_unless_holds_a_block_back() -> None:
    bench = Bench(block(0, Every(period=10 * MS, phase=10 * MS), unless=parse_expression("M1", NOWHERE)))
    bench.run_until(50)
    bench.memory.write("M", "word", 1, [1])
    bench.run_until(100)
    assert bench.counters(0)[0] == 5


def test_nothing_is_due_after_the_end() -> None:
    bench = Bench(block(0, Every(period=10 * MS)), block(1, Rising(condition=parse_expression("M1", NOWHERE))))
    bench.scheduler.end()
    bench.memory.write("M", "word", 1, [1])
    assert bench.scheduler.deadline == NEVER


def test_a_block_fired_by_hand() -> None:
    bench = Bench(block(0))
    bench.scheduler.fire(0, 0)
    bench.run_until(1)
    assert bench.counters(0) == (1, 1, 0, 0)
    with pytest.raises(KeyError):
        bench.scheduler.fire(9, 0)


@pytest.mark.parametrize("took", [0, 70_000, MS - 1])
def test_blocks_that_fail_at_once_and_start_each_other_hold_their_channel(took: int) -> None:
    bench = Bench(
        block(0, AfterStart(delay=MS), BlockEnd(block=1, ok=False)),
        block(1, BlockEnd(block=0, ok=False)),
        duration=took,
    )
    bench.bad = {0, 1}
    bench.run_until(100)
    assert 49 <= len(bench.starts) <= 101, "1 ms after each"
    assert bench.counters(0)[0] + bench.counters(1)[0] == len(bench.starts)


def test_exchanges_that_end_well_within_a_millisecond_wait_for_nothing() -> None:
    bench = Bench(block(0, AfterStart(delay=MS), BlockEnd(block=1, ok=True)), block(1, BlockEnd(block=0, ok=True)))
    bench.duration = MS // 10
    bench.run_until(100)
    assert len(bench.starts) > 900


class AtOnce:
    """A scheduler whose exchanges end within their start, except those in `waits`.

    Each start takes time nevertheless.
    """

    TAKES = 20_000

    def __init__(self, *blocks: Block) -> None:
        self.now = 0
        self.waits: set[int] = set()
        self.starts: list[tuple[int, int]] = []
        channels = {block.channel: 0 for block in blocks}
        memory = DeviceMemory([Area("M", size=100)])
        self.scheduler = Scheduler(blocks, memory, resolve, channels, self._start, lambda: None)
        for number in channels:
            self.scheduler.set_open(number, True)
        self.scheduler.begin(0)

    def _start(self, state: BlockState, now: int) -> None:
        self.starts.append((now, state.block.number))
        if state.id in self.waits:
            return
        self.now += self.TAKES
        self.scheduler.finished(state.id, None, self.now)

    def run_until(self, time: int) -> None:
        while (due := max(self.scheduler.deadline, self.now)) < time:
            self.now = due
            self.scheduler.tick(due)
        self.now = time


@pytest.mark.parametrize("channels", [(1, 1, 1), (1, 2, 3)])
@pytest.mark.parametrize("count", [1, 2, 3])
def test_blocks_in_a_circle_that_wait_for_nothing_stop_nobody(count: int, channels: tuple[int, ...]) -> None:
    bench = AtOnce(*(block(n, BlockEnd(block=(n - 1) % count, ok=True), channel=channels[n]) for n in range(count)))
    bench.scheduler.fire(0, 0)
    bench.run_until(10 * MS)
    rounds = [now for now, number in bench.starts if number == 0]
    assert 8 <= len(rounds) <= 10 and min(after - now for now, after in itertools.pairwise(rounds)) >= MS
    assert [number for _, number in bench.starts[: 2 * count]] == [*range(count)] * 2


def test_a_row_of_blocks_that_wait_for_nothing_is_not_held_up() -> None:
    bench = AtOnce(block(0), block(1, BlockEnd(block=0, ok=True)), block(2, BlockEnd(block=1, ok=True)))
    for round_ in range(10):
        bench.scheduler.fire(0, bench.now)
        bench.run_until(bench.now + 3 * bench.TAKES)
        assert [number for _, number in bench.starts] == [0, 1, 2] * (round_ + 1)


def test_an_exchange_that_is_waited_for_makes_it_no_circle() -> None:
    bench = AtOnce(block(0, BlockEnd(block=1, ok=True)), block(1, BlockEnd(block=0, ok=True)))
    bench.waits.add(1)
    bench.scheduler.fire(0, 0)
    for _ in range(5):
        bench.run_until(bench.now + 2 * bench.TAKES)
        assert bench.starts[-1][1] == 1, "block 0 started at once, and has started block 1"
        bench.scheduler.finished(1, None, bench.now)
