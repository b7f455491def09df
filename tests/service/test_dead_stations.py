"""Stations that do not answer: polled rarely after some failures, recovered by themselves, without delaying others."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import pytest

from framekit.link.events import Seen
from framekit.run.block_state import BlockState
from framekit.runfile.run_file import load_run
from framekit.service.run import RunService
from framekit.transport.clock import VirtualClock

SECOND = 1_000_000_000
CHANNELS, BLOCKS = 2, 8
DEAD = 3
"""Block 3 of every channel polls a station of its own; the station on channel 1 is missing."""


def write_run(folder: Path) -> Path:
    """Write a run of 64 blocks on eight channels, all once a second, one block of each channel with station 2."""
    for station in (1, 2):
        text = (
            f"device: d{station}\nprotocol: modbus-rtu\nstation: {station}\nmemory: {{set: {{40001: [{station}]}}}}\n"
        )
        (folder / f"d{station}.device.yaml").write_text(text, encoding="utf-8")
    lines = ["run: one-dead", "memory: masterlogic", "channels:"]
    lines += [
        f'  {number}: {{port: "sim:d1.device.yaml,d2.device.yaml", protocol: modbus-rtu, speed: 38400, '
        "params: {reply_timeout: 200 ms, retries: 2}}"
        for number in range(1, CHANNELS + 1)
    ]
    lines.append("blocks:")
    for block in range(CHANNELS * BLOCKS):
        channel, number = block // BLOCKS + 1, block % BLOCKS
        station = 2 if number == DEAD else 1
        lines.append(
            f'  {block}: {{read: "40001", into: D{block:05}, station: {station}, channel: {channel}, every: 1 s}}'
        )
    path = folder / "r.run.yaml"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


@pytest.mark.long
def test_with_one_dead_station_the_others_keep_their_rate(tmp_path: Path) -> None:
    """The station is dead from the start; the failures before its detection count as well."""
    seconds = 100
    clock = VirtualClock()
    service = RunService(load_run(write_run(tmp_path)), clock)
    service.devices[1].start = lambda: None  # type: ignore[method-assign]
    service.start()
    clock.run_for(seconds * SECOND + SECOND // 2)
    for number, state in service.states.items():
        counters = state
        assert counters.started == counters.done + counters.failed + counters.running
        if number == DEAD:
            assert counters.done == 0 and counters.failed < 20, "it is asked rarely"
        elif number < BLOCKS:
            assert counters.done >= 0.99 * seconds, number
        else:
            assert counters.done == seconds, "other channels do not even notice"
    assert [status.block for status in service.status() if status.dead] == [DEAD]


RUN = """run: back
memory: masterlogic
channels:
  1:
    port: "sim:d1.device.yaml,d2.device.yaml"
    protocol: modbus-rtu
    params: {reply_timeout: 100 ms, retries: 0}
    dead: {failures: 3, after: 2 s, every: 10 s}
blocks:
  0: {read: "40001", into: D00000, station: 1, every: 200 ms}
  1: {read: "40001", into: D00001, station: 2, every: 200 ms}
"""


def test_it_comes_back_by_itself(tmp_path: Path) -> None:
    write_run(tmp_path)
    path = tmp_path / "back.run.yaml"
    path.write_text(RUN, encoding="utf-8")
    clock = VirtualClock()
    service = RunService(load_run(path), clock)
    service.start()
    clock.run_for(5 * SECOND)
    device = service.devices[1]
    device.stop()
    clock.run_for(SECOND)
    assert not service.status()[1].dead, "failures alone are not enough, it takes time as well"
    clock.run_for(4 * SECOND)
    assert service.status()[1].dead
    failed = service.states[1].failed
    clock.run_for(30 * SECOND)
    assert 2 <= service.states[1].failed - failed <= 4, "every 10 s"
    device.start()
    before = service.states[1].done
    clock.run_for(11 * SECOND)
    assert not service.status()[1].dead
    clock.run_for(10 * SECOND)
    assert service.states[1].done - before >= 50


THREE = """run: three
memory: masterlogic
channels:
  1: {port: "sim:d1.device.yaml,d2.device.yaml,d3.device.yaml", protocol: modbus-rtu}
blocks:
  0: {read: "40001", into: D00000, station: 1, every: 1 s}
  1: {read: "40001", into: D00001, station: 2, every: 1 s}
  2: {read: "40001", into: D00002, station: 3, every: 1 s}
"""


def three(folder: Path) -> Path:
    for station in (1, 2, 3):
        text = (
            f"device: d{station}\nprotocol: modbus-rtu\nstation: {station}\nmemory: {{set: {{40001: [{station}]}}}}\n"
        )
        (folder / f"d{station}.device.yaml").write_text(text, encoding="utf-8")
    path = folder / "three.run.yaml"
    path.write_text(THREE, encoding="utf-8")
    return path


def test_with_the_defaults_a_dead_station_costs_its_neighbours_little(tmp_path: Path) -> None:
    """A time-out takes 1 s, the wait for late replies up to 2 s.

    The blocks of the other stations are due every second.
    """
    clock = VirtualClock()
    ends: dict[int, list[int]] = {0: [], 1: [], 2: []}
    tries: list[int] = []

    def ended(state: BlockState, ok: bool) -> None:
        ends[state.block.number].append(clock.now())

    def seen(channel: int, event: Seen) -> None:
        if event.direction == "out" and event.raw[:1] == b"\2":
            tries.append(event.at)

    service = RunService(load_run(three(tmp_path)), clock, seen, ended)
    service.devices[1].start = lambda: None  # type: ignore[method-assign]
    service.start()
    clock.run_for(25 * SECOND)
    attempts = len(tries)
    assert 4 <= service.states[1].failed == attempts - 2 <= 6, "three tries at first, each in a turn of its own"
    assert [status.block for status in service.status() if status.dead] == [1]
    for number in (0, 2):
        assert len(ends[number]) >= 15, ends[number]
        gaps = [later - earlier for earlier, later in pairwise(ends[number])]
        assert max(gaps) < 3.2 * SECOND, "one time-out and one wait for late replies at most"
    clock.run_for(60 * SECOND)
    assert all(len(ends[number]) >= 15 + 56 for number in (0, 2))
    assert len(tries) == attempts + 1, "once a minute"


def test_a_station_that_comes_back_while_it_is_suspected(tmp_path: Path) -> None:
    clock = VirtualClock()
    service = RunService(load_run(three(tmp_path)), clock)
    start = service.devices[1].start
    service.devices[1].start = lambda: None  # type: ignore[method-assign]
    service.start()
    clock.run_for(8 * SECOND)
    assert service.states[1].failed == 1
    start()
    clock.run_for(10 * SECOND)
    assert not service.status()[1].dead and service.states[1].done >= 8


@pytest.mark.parametrize("retries", [0, 2])
@pytest.mark.parametrize(
    ("protocol", "address"), [("modbus-rtu", "40001"), ("modbus-ascii", "40001"), ("mldp", "D100"), ("ge-rtu", "40001")]
)
def test_a_dead_station_costs_its_neighbours_a_few_readings(
    protocol: str, address: str, retries: int, tmp_path: Path
) -> None:
    """Three stations are read once a second. The wait for late replies of the dead station delays only that station."""
    for number in (1, 2, 3):
        text = f"device: d{number}\nprotocol: {protocol}\nstation: {number}\n"
        (tmp_path / f"d{number}.device.yaml").write_text(text, encoding="utf-8")
    blocks = "".join(
        f'  {number}: {{read: "{address}", into: D{number:05}, station: {number + 1}, every: 1 s}}\n'
        for number in range(3)
    )
    path = tmp_path / "r.run.yaml"
    path.write_text(
        'run: r\nmemory: masterlogic\nchannels:\n  1: {port: "sim:d1.device.yaml,d2.device.yaml,d3.device.yaml", '
        f"protocol: {protocol}, params: {{retries: {retries}}}}}\nblocks:\n{blocks}",
        encoding="utf-8",
    )
    clock = VirtualClock()
    service = RunService(load_run(path), clock)
    service.devices[1].start = lambda: None  # type: ignore[method-assign]
    service.start()
    clock.run_for(90 * SECOND + SECOND // 2)
    done = [service.states[number].done for number in range(3)]
    assert done[1] == 0 and min(done[0], done[2]) >= 87


@pytest.mark.parametrize("retries", [0, 2])
def test_only_the_first_failure_costs_its_neighbours_all_tries(retries: int, tmp_path: Path) -> None:
    """Three stations are read each second, and one falls silent: the time between two values of the others."""
    for station, rules in ((1, ""), (2, "{fault: no_reply, from: 20 s}"), (3, "")):
        device = f"device: d{station}\nprotocol: modbus-rtu\nstation: {station}\nmemory: {{set: {{40001: [7]}}}}\n"
        (tmp_path / f"d{station}.device.yaml").write_text(f"{device}faults: {{rules: [{rules}]}}\n")
    path = tmp_path / "r.run.yaml"
    path.write_text(
        "run: r\nchannels:\n  1: {port: 'sim:d1.device.yaml,d2.device.yaml,d3.device.yaml', protocol: modbus-rtu, "
        f"params: {{reply_timeout: 300 ms, retries: {retries}}}}}\npoints:\n"
        + "".join(
            f"  p{station}: {{channel: 1, station: {station}, address: '40001', every: 1 s}}\n" for station in (1, 2, 3)
        )
    )
    clock = VirtualClock()
    ends: list[tuple[str, int]] = []
    service = RunService(load_run(path), clock, on_end=lambda state, ok: ends.append((state.block.name, clock.now())))
    service.start()
    clock.run_for(100 * SECOND)
    gaps = {
        name: [(later - earlier, later) for earlier, later in pairwise(at for block, at in ends if block == name)]
        for name in ("p1", "p3")
    }
    at_first = [gap for found in gaps.values() for gap, at in found if at < 21.5 * SECOND]
    later = [gap for found in gaps.values() for gap, at in found if at >= 21.5 * SECOND]
    assert max(at_first) <= SECOND + (retries + 1) * 320_000_000
    assert max(later) <= SECOND + 320_000_000


@pytest.mark.parametrize("dead", [1, 2, 3])
def test_a_station_that_is_dead_at_the_start_costs_its_neighbours_one_time_out(dead: int, tmp_path: Path) -> None:
    """The tries of a station that has not answered yet are turns of their own; before, all three were one turn."""
    clock = VirtualClock()
    good: dict[int, list[int]] = {number: [SECOND] for number in range(3)}
    service = RunService(
        load_run(three(tmp_path)), clock, on_end=lambda state, ok: good[state.block.number].append(clock.now())
    )
    service.devices[dead - 1].start = lambda: None  # type: ignore[method-assign]
    service.start()
    clock.run_for(30 * SECOND)
    for number in {0, 1, 2} - {dead - 1}:
        gaps = [later - earlier for earlier, later in pairwise(good[number])]
        assert max(gaps) < 2.1 * SECOND, "a period and a time-out; it was 3.04 s"
        assert service.states[number].done >= 27


def test_a_station_that_is_slow_from_the_start_is_asked_with_all_tries(tmp_path: Path) -> None:
    """A single try brings no value of a station that answers after the time limit."""
    path = three(tmp_path)
    device = tmp_path / "d2.device.yaml"
    device.write_text(device.read_text() + "faults: {rules: [{fault: delay, time: 2500 ms}]}\n")
    clock = VirtualClock()
    service = RunService(load_run(path), clock)
    service.start()
    clock.run_for(60 * SECOND)
    assert service.states[1].done >= 5 and not service.status()[1].dead
    assert min(service.states[0].done, service.states[2].done) >= 40
