"""Feasibility of cycles: the time that the blocks of a channel need in total, for given durations of an exchange."""

from __future__ import annotations

from pathlib import Path

import pytest

from framekit.runfile.run_file import load_run
from framekit.service.feasibility import BlockLoad, ChannelLoad, Cost, channel_loads, load_problems, simulated_costs

MS = 1_000_000
HEAD = """run: r
memory: masterlogic
channels:
  1: {port: /dev/null, protocol: modbus-rtu, speed: 9600, station: 1}
blocks:
"""


def loads(folder: Path, blocks: str, *durations: int) -> ChannelLoad:
    """Return the load of a channel whose exchanges take these durations in ms and 10 bytes each."""
    path = folder / "r.run.yaml"
    path.write_text(HEAD + blocks, encoding="utf-8")
    costs = {(1, number): Cost(duration * MS, 10, 2) for number, duration in enumerate(durations)}
    (found,) = channel_loads(load_run(path), costs)
    return found


def periods(load: ChannelLoad) -> list[int | None]:
    return [None if block.period is None else block.period // MS for block in load.blocks]


@pytest.mark.parametrize(
    ("trigger", "period"),
    [
        ("every: 200 ms", 200), ("when: F00090", 20), ("when: F00097", 60_000), ("when: F00092 and M00001", 200),
        ("when: not F00093", 1000), ("when: M00001", None), ("when: F00090 or F00091", None), ("while: F00093", None),
        ("on_change: M100", None), ("once: yes", None), ("when: [F00093, F00092]", 200),
        ("every: 3 s, when: F00093", 1000),
    ],
)  # fmt: skip
def test_what_has_a_period(tmp_path: Path, trigger: str, period: int | None) -> None:
    found = loads(tmp_path, f'  0: {{read: "40001", into: M200, {trigger}}}\n', 5)
    assert periods(found) == [period]


def test_a_channel_that_is_switched_off_has_no_load(tmp_path: Path) -> None:
    path = tmp_path / "r.run.yaml"
    blocks = '  0: {read: "40001", into: M200, every: 100 ms}\n'
    path.write_text((HEAD + blocks).replace("station: 1}", "station: 1, enabled: no}"), encoding="utf-8")
    run = load_run(path)
    assert channel_loads(run, simulated_costs(run)) == ()


def test_blocks_behind_others_have_their_period(tmp_path: Path) -> None:
    blocks = """
  0: {read: "40001", into: M200, every: 100 ms}
  1: {read: "40001", into: M201, when: block 0 done}
  2: {read: "40001", into: M202, when: block 1 done}
  3: {read: "40001", into: M203, when: block 0 failed}
  4: {read: "40001", into: M204, when: block 5 done}
  5: {read: "40001", into: M205, when: block 4 done}
  6: {read: "40001", into: M206, when: L006310}
  7: {read: "40001", into: M207, when: L006311}
"""
    found = [100, 100, 100, None, None, None, 100, None]
    assert periods(loads(tmp_path, blocks, *[5] * 8)) == found, "L006310 is NDR of block 1, L006311 its ERR"


def test_loads_add_up(tmp_path: Path) -> None:
    blocks = '  0: {read: "40001", into: M200, every: 100 ms}\n  1: {read: "40001", into: M201, when: F00092}\n'
    blocks += (
        '  2: {read: "40001", into: M202, when: M00001}\n  3: {read: "40001", into: M2, every: 1 ms, enabled: no}\n'
    )
    found = loads(tmp_path, blocks, 10, 30, 50, 50)
    assert found.busy == pytest.approx(10 / 100 + 30 / 200)
    assert found.round == 40 * MS
    character = 11 / 9600
    assert found.line == pytest.approx(10 * character / 0.1 + 10 * character / 0.2, rel=1e-6)
    assert len(found.blocks) == 3, "a block that is switched off counts nothing"
    assert load_problems((found,)) == []


def by_number(load: ChannelLoad) -> dict[int, BlockLoad]:
    return {block.block.number: block for block in load.blocks}


def test_an_exchange_longer_than_its_cycle(tmp_path: Path) -> None:
    found = loads(tmp_path, '  0: {read: "40001", into: M200, every: 20 ms}\n', 34)
    assert by_number(found)[0].reached == pytest.approx(40 * MS, rel=0.01), "every other cycle is missed"
    (problem,) = load_problems((found,))
    assert (problem.warning, problem.at.line, problem.at.column) == (True, 6, 3)
    assert problem.what == "block 0 wants 20 ms, one exchange takes 34 ms: it runs every 40 ms"
    assert problem.todo == "use a longer period, a faster line or fewer blocks on this channel"


def test_cycles_that_have_no_time_beside_each_other(tmp_path: Path) -> None:
    blocks = "".join(f'  {n}: {{read: "40001", into: M20{n}, every: 20 ms}}\n' for n in range(3))
    found = loads(tmp_path, blocks, 10, 12, 12)
    assert found.busy == pytest.approx(34 / 20)
    problems = load_problems((found,))
    assert [problem.at.line for problem in problems] == [6, 7, 8]
    assert "block 1 wants 20 ms, channel 1 needs 34 ms for all its cycles: it runs every " in problems[1].what


def test_exchanges_much_longer_than_their_cycles(tmp_path: Path) -> None:
    """A period is over before each block had its turn."""
    blocks = "".join(f'  {n}: {{read: "40001", into: M20{n}, every: 20 ms}}\n' for n in range(6))
    found = loads(tmp_path, blocks, *[40] * 6)
    assert all(200 * MS < load.reached < 300 * MS for load in by_number(found).values())


def test_a_full_channel_is_not_too_full(tmp_path: Path) -> None:
    blocks = "".join(f'  {n}: {{read: "40001", into: M20{n}, every: 30 ms}}\n' for n in range(3))
    assert load_problems((loads(tmp_path, blocks, 10, 10, 10),)) == []


def test_priority_lets_others_miss(tmp_path: Path) -> None:
    blocks = (
        '  0: {read: "40001", into: M200, every: 10 ms}\n  1: {read: "40001", into: M201, every: 10 ms, priority: 1}\n'
    )
    found = by_number(loads(tmp_path, blocks, 10, 8))
    assert found[0].missed > 0


def test_a_long_exchange_makes_a_short_cycle_miss_though_the_load_is_small(tmp_path: Path) -> None:
    blocks = '  0: {read: "40001", into: M200, every: 10 ms}\n  1: {read: "40001", into: M201, every: 1 s}\n'
    found = loads(tmp_path, blocks, 1, 100)
    assert found.busy == pytest.approx(0.2)
    short, long = by_number(found)[0], by_number(found)[1]
    assert long.missed == 0
    assert short.missed == pytest.approx(9 / 100, abs=0.01), "of 100 cycles a second it misses those of one exchange"
