"""Whole runs on the virtual clock: frames on the line, values in memory, and consistent counters."""

from __future__ import annotations

from pathlib import Path

import pytest

from framekit.link.events import Seen
from framekit.runfile.run_file import load_run
from framekit.service.run import RunService
from framekit.transport.clock import VirtualClock

EXAMPLES = Path(__file__).parents[2] / "examples"
SECOND = 1_000_000_000


class Bench:
    """A run of a file on a virtual clock, with all events on its lines."""

    def __init__(self, path: Path) -> None:
        self.clock = VirtualClock()
        self.seen: list[tuple[int, Seen]] = []
        self.service = RunService(load_run(path), self.clock, lambda channel, seen: self.seen.append((channel, seen)))
        self.service.start()

    def run_for(self, time: int) -> None:
        self.clock.run_for(time)
        self.check()

    def check(self) -> None:
        for state in self.service.states.values():
            found = state
            assert found.started == found.done + found.failed + found.running
            assert found.running in (0, 1)

    def frames(self, direction: str) -> list[str]:
        return [seen.frame for _, seen in self.seen if seen.kind == "frame" and seen.direction == direction]

    def counters(self, number: int) -> tuple[int, int, int]:
        found = self.service.states[number]
        return found.started, found.done, found.failed


def write(folder: Path, **files: str) -> Path:
    for name, text in files.items():
        (folder / f"{name.replace('_', '.')}.yaml").write_text(text, encoding="utf-8")
    return folder / "r.run.yaml"


def test_the_third_party_plc() -> None:
    bench = Bench(EXAMPLES / "third-party-plc.run.yaml")
    for _ in range(100):
        bench.run_for(SECOND // 10)
    assert bench.frames("out").count("WR.REQ") == 10
    assert bench.frames("in") == ["RD.DATA"] * 9
    assert bench.frames("out").count("IMM.RESPONSE") == 9
    assert bench.service.memory.read("M", "word", 100, 12) == list(range(1, 13))
    device = bench.service.devices[0]
    assert device.memory.read("M", "word", 100, 4) == [0x1111, 0x2222, 0x3333, 0x4444]
    assert device.engine.scope["good"] == 9 and device.engine.scope["late"] == 0


def test_every_request_is_a_second_after_the_last() -> None:
    bench = Bench(EXAMPLES / "third-party-plc.run.yaml")
    bench.run_for(60 * SECOND)
    times = [seen.at for _, seen in bench.seen if seen.frame == "WR.REQ"]
    assert times == [second * SECOND for second in range(1, 61)]


@pytest.mark.parametrize("name", ["mldp-flags", "mldp-two-channels", "modbus-remote-io", "scale"])
def test_the_other_examples_have_no_failures(name: str) -> None:
    bench = Bench(EXAMPLES / f"{name}.run.yaml")
    bench.run_for(10 * SECOND)
    assert all(state.failed == 0 for state in bench.service.states.values())
    assert any(state.done for state in bench.service.states.values())


SILENT = """
run: silent
memory: masterlogic
dead: no
channels:
  1: {port: "sim:there.device.yaml", protocol: modbus-rtu, params: {reply_timeout: 100 ms, retries: 1}}
  2: {port: "sim:there.device.yaml", protocol: modbus-rtu}
blocks:
  0: {read: "40001", channel: 1, station: 9, into: M100, every: 1 s}
  1: {read: "40001", channel: 2, station: 1, into: M101, every: 100 ms}
"""
THERE = "device: there\nprotocol: modbus-rtu\nstation: 1\nmemory: {set: {40001: 77}}\n"


def test_a_device_that_does_not_answer_is_reported_and_stops_nobody_else(tmp_path: Path) -> None:
    bench = Bench(write(tmp_path, r_run=SILENT, there_device=THERE))
    bench.service.memory.write("M", "word", 100, [5])
    bench.run_for(10 * SECOND + SECOND // 2)
    assert bench.counters(0) == (10, 0, 10)
    assert str(bench.service.states[0].last_failure) == "no_reply"
    assert bench.service.memory.read("M", "word", 100, 2) == [5, 77], "nothing is stored without a reply"
    assert len([seen for channel, seen in bench.seen if channel == 1 and seen.direction == "out"]) == 20, (
        "one retry each"
    )
    started, done, failed = bench.counters(1)
    assert started >= 100 and failed == 0 and done >= 100


def test_stop_in_the_middle_of_an_exchange(tmp_path: Path) -> None:
    bench = Bench(write(tmp_path, r_run=SILENT, there_device=THERE))
    bench.run_for(SECOND + 50_000_000)
    bench.service.stop()
    bench.check()
    before = len(bench.seen)
    bench.run_for(10 * SECOND)
    assert len(bench.seen) == before


@pytest.mark.long
def test_ten_minutes_of_polling_count_every_exchange(tmp_path: Path) -> None:
    bench = Bench(write(tmp_path, r_run=SILENT.replace("every: 100 ms", "every: 2 s"), there_device=THERE))
    for _ in range(10):
        bench.run_for(60 * SECOND)
    assert bench.counters(0)[0] == 600
    assert bench.counters(1) == (300, 299, 0) or bench.counters(1) == (300, 300, 0)
