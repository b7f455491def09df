"""Troubles of several kinds in sequence: no value is wrong, and values come again soon after the device is well."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from random import Random

import pytest
from service.late_world import MS, SECOND, LateWorld
from spread import spread

from framekit.run.model import FaultRule
from framekit.runfile.run_file import load_run
from framekit.service.run import RunService
from framekit.transport.clock import VirtualClock

ALIKE = ("modbus-rtu", "modbus-ascii", "mldp", "ge-rtu", "registers")


def rule(kind: str, begin: float, end: float, time: float = 0) -> FaultRule:
    """Return a fault of all replies in a span of time (s)."""
    return FaultRule(kind=kind, begin=int(begin * SECOND), end=int(end * SECOND), time=int(time * SECOND))


IN_SEQUENCE = (rule("wrong_check", 3, 7), rule("wrong_station", 10, 14), rule("delay", 17, 26, 3))
DAMAGED_THEN_LATE = (rule("wrong_check", 3, 15), rule("delay", 17, 26, 3))


def poll(world: LateWorld, until: int) -> list[int]:
    """Exchange once a second at most; return the times (ns) of good values."""
    good = []
    while world.clock.now() < until:
        begun = world.clock.now()
        if world.exchange() == "ok":
            good.append(world.clock.now())
        world.clock.run_until(max(world.clock.now(), begun + SECOND))
    return good


@pytest.mark.parametrize("rules", [IN_SEQUENCE, DAMAGED_THEN_LATE], ids=["three kinds", "damaged, then late"])
@pytest.mark.parametrize("name", ALIKE)
def test_values_come_soon_after_damaged_and_late_replies(name: str, rules: tuple[FaultRule, ...]) -> None:
    """A request whose reply was damaged is not taken for the request of a late reply: the hold would last too long."""
    well = 26 * SECOND
    world = LateWorld(name, *rules)
    good = [time for time in poll(world, well + 40 * SECOND) if time > well]
    assert world.wrong == []
    assert good[0] < well + 10 * SECOND and len(good) > 30, good


@pytest.mark.parametrize(("kind", "most"), [("wrong_check", 3), ("no_reply", 6)])
@pytest.mark.parametrize("name", ALIKE)
def test_one_bad_reply_in_twenty_stops_no_line(name: str, kind: str, most: int) -> None:
    """A device that answers promptly is read on; a lost reply costs its time limit and the proof of the next values."""
    world = LateWorld(name, FaultRule(kind=kind, rate=1 / 20))
    good = poll(world, 300 * SECOND)
    assert world.wrong == []
    assert len(good) >= 298 - most, len(good)


@pytest.mark.parametrize(("name", "seed"), spread(product(ALIKE, range(12)), 5))
def test_no_value_is_wrong_in_drawn_sequences_of_troubles(name: str, seed: int) -> None:
    """Spans of damaged, strange, lost and late replies, and single late replies.

    They are late by less than four time limits: after five losses no request stays open for longer.
    """
    random = Random(f"{name} {seed}")
    rules, begin = [FaultRule(kind="jitter", time=7 * SECOND // 2, rate=1 / 50)] * (seed % 2), 2.0
    while begin < 200:
        end = begin + random.uniform(1, 15)
        kind = random.choice(["wrong_check", "wrong_station", "no_reply", "truncate", "delay"])
        rules.append(rule(kind, begin, end, random.choice([1.2, 2.5, 3.5])))
        begin = end + random.choice([0.5, 3, 20])
    lateness = None
    if seed % 3 == 0:
        lateness = lambda now: int(random.random() < 0.1) * random.choice([1200, 2500, 3500]) * MS  # noqa: E731
        rules = [rule for rule in rules if rule.kind != "delay"]
    world = LateWorld(name, *rules, seed=seed, lateness=lateness, retries=seed % 3)
    good = poll(world, 300 * SECOND)
    assert world.wrong == []
    assert len(good) > 12  # 100 s of the 300 are without trouble, and the longest hold takes 60 s


RUN = """run: alone
memory: masterlogic
channels:
  1: {port: "sim:d1.device.yaml", protocol: modbus-rtu, station: 1DEAD}
blocks:
  0: {read: "40001", into: D00000, channel: 1, every: 1 s}
"""


@pytest.mark.parametrize(
    ("dead", "soon"), [("", 3), (", dead: {failures: 5}", 3), (", dead: {every: 30 s}", 31)],
    ids=["by default", "other failures", "with a time"],
)  # fmt: skip
def test_a_dead_station_that_is_alone_on_its_line_is_asked_often(dead: str, soon: int, tmp_path: Path) -> None:
    """It costs no neighbour: it is asked as often as its block comes due, and the line rests half of the time."""
    text = "device: d1\nprotocol: modbus-rtu\nstation: 1\nmemory: {set: {40001: [7]}}\n"
    (tmp_path / "d1.device.yaml").write_text(text)
    path = tmp_path / "r.run.yaml"
    path.write_text(RUN.replace("DEAD", dead))
    clock = VirtualClock()
    service = RunService(load_run(path), clock)
    start = service.devices[0].start
    service.devices[0].start = lambda: None  # type: ignore[method-assign]
    service.start()
    clock.run_for(40 * SECOND)
    state = service.states[0]
    assert state.dead
    failed = state.failed
    clock.run_for(60 * SECOND)
    assert state.failed - failed <= 60 // 2 + 1, "the line rests as long as a request takes"
    start()
    clock.run_for(soon * SECOND)
    assert state.done >= 1 and not state.dead
    assert (state.failed - failed >= 20) is (soon == 3)


SHARED = """run: shared
channels:
  1: {port: "sim:d1.device.yaml,d3.device.yaml", protocol: modbus-rtu}
points:
  quick: {channel: 1, station: 1, address: "40001"}
  a: {channel: 1, station: 3, address: "40001"}
  b: {channel: 1, station: 3, address: "40101"}
  c: {channel: 1, station: 3, address: "40201"}
"""
HELD = {"quick": 1111, "a": 3111, "b": 3222, "c": 3333}


def test_a_station_whose_requests_wait_for_late_replies_lets_its_neighbour_go_first(tmp_path: Path) -> None:
    """The replies name their station. Station 3 answers after 2.5 s, and its first late replies have to be proved."""
    slow = "faults: {seed: 2, rules: [{fault: delay, time: 2500 ms, from: 15 s, until: 135 s}]}\n"
    for station, values in ((1, '"40001": 1111'), (3, '"40001": 3111, "40101": 3222, "40201": 3333')):
        text = f"device: d{station}\nprotocol: modbus-rtu\nstation: {station}\nmemory: {{set: {{{values}}}}}\n"
        (tmp_path / f"d{station}.device.yaml").write_text(text + slow * (station == 3))
    path = tmp_path / "r.run.yaml"
    path.write_text(SHARED)
    clock = VirtualClock()
    service = RunService(load_run(path), clock)
    service.start()
    done: list[list[int]] = []
    while clock.now() < 150 * SECOND:
        clock.run_for(SECOND)
        done.append([state.done for state in service.states.values()])
        row = [(point.name, point.value) for point in service.points.table if point.value is not None]
        assert all(value == HELD[name] for name, value in row)
    quick, *others = (done[133][at] - done[44][at] for at in range(4))
    assert quick >= 65, "in 89 s; it was 12"
    assert sum(others) >= 9, "a reply takes 2.5 s, and the late replies to two repeats the same"
    assert not any(state.failed for state in service.states.values())


@pytest.mark.parametrize(
    ("name", "seed"), spread(product(("snp", "snp-x", "ccm", "df1", "mldp", "modbus-rtu", "registers"), (1, 2, 3)), 2)
)
def test_values_come_soon_after_replies_that_came_with_the_next_reply(name: str, seed: int) -> None:
    """A reply that a device or a gateway keeps until the next request is not late: a wait does not bring it."""
    well = 33 * SECOND
    world = LateWorld(name, FaultRule(kind="glue", rate=0.1, begin=3 * SECOND, end=well), seed=seed)
    good = [time for time in poll(world, well + 60 * SECOND) if time > well]
    assert world.wrong == [] and world.injected["glue"] > 0
    assert good[0] < well + 30 * SECOND, "snp and ccm needed 57 to 133 s"
    assert len(good) > 12
