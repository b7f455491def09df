"""The ready queue gives the same lanes as asking every lane for work."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from framekit.definition.expression import parse_expression
from framekit.definition.problems import NOWHERE
from framekit.link.addresses import Address
from framekit.memory.memory import Area, DeviceMemory
from framekit.run.block_state import BlockState, Failure
from framekit.run.lanes import LaneRules
from framekit.run.model import Block, DeadRule, Silence
from framekit.run.scheduler import Scheduler
from framekit.run.triggers import Rising

CHANNELS = (1, 2, 3)
MS = 1_000_000


class Bench:
    """Three channels with two blocks each, triggered by bits 0 to 5 of M; the test ends the started exchanges."""

    def __init__(self) -> None:
        self.memory = DeviceMemory([Area("M", size=1)])
        self.running: list[BlockState] = []
        self.started: list[int] = []
        blocks = [
            Block(
                number=number, set=1, name="", instruction="read", channel=1 + number % 3, station=number % 2,
                at=NOWHERE, triggers=(Rising(condition=parse_expression(f"M{number}", NOWHERE)),),
            )
            for number in range(6)
        ]  # fmt: skip
        rules = LaneRules(
            silence=Silence(between=2 * MS, connect=3 * MS, station=5 * MS), dead=DeadRule(failures=1, after=0)
        )
        self.scheduler = Scheduler(
            blocks, self.memory, lambda text: Address("M", "bit", int(text[1:])), dict.fromkeys(CHANNELS, rules),
            self._start, lambda: None, station_of=lambda state: state.block.station,
        )  # fmt: skip
        self.scheduler.begin(0)

    def _start(self, state: BlockState, now: int) -> None:
        self.running.append(state)
        self.started.append(state.id)

    def do(self, action: str, number: int, now: int) -> None:
        scheduler = self.scheduler
        if action == "fire":
            self.memory.write("M", "bit", number, [0])
            self.memory.write("M", "bit", number, [1])
        elif action in ("well", "badly") and self.running:
            failure = None if action == "well" else Failure(outcome="no_reply")
            scheduler.finished(self.running.pop(number % len(self.running)).id, failure, now)
        elif action == "open":
            scheduler.set_open(1 + number % 3, number < 3, now)
        elif action == "hold":
            scheduler.hold(CHANNELS[: number % 3])
        elif action == "off":
            scheduler.enable(number, number % 2 == 0, now)
        scheduler.tick(now)


actions = st.tuples(
    st.sampled_from(["fire", "fire", "well", "badly", "open", "hold", "off", "wait"]),
    st.integers(0, 5),
    st.integers(0, 4 * MS),
)


@given(st.lists(actions, max_size=60))
def test_the_next_time_is_that_of_the_first_lane_and_nothing_due_stays(history: list[tuple[str, int, int]]) -> None:
    bench, now = Bench(), 0
    for action, number, passed in history:
        now += passed
        bench.do(action, number, now)
        expected = min(lane.deadline for lane in bench.scheduler.lanes.values())
        assert bench.scheduler.deadline == expected
        bench.scheduler.tick(now)
        assert len(bench.running) == len({state.lane for state in bench.running})


def test_lanes_that_are_due_at_once_start_in_their_order() -> None:
    bench = Bench()
    for number in (2, 1, 0):
        bench.memory.write("M", "bit", number, [1])
    bench.scheduler.tick(0)
    assert bench.started == [0, 1, 2]
