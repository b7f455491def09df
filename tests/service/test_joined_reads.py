"""Neighbouring reads of one station as one exchange, and settings of single stations and blocks, in whole runs."""

from __future__ import annotations

from pathlib import Path

import pytest

from framekit.link.events import Seen
from framekit.runfile.run_file import load_run
from framekit.service.run import RunService
from framekit.transport.clock import VirtualClock

SECOND = 1_000_000_000
DEVICE = (
    "device: d\nprotocol: modbus-rtu\nstation: 1\nmemory: {set: {40001: [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12]}}\n"
)


class Bench:
    def __init__(self, folder: Path, text: str) -> None:
        (folder / "d.device.yaml").write_text(DEVICE, encoding="utf-8")
        path = folder / "r.run.yaml"
        path.write_text(f"run: r\nmemory: masterlogic\n{text}", encoding="utf-8")
        self.clock = VirtualClock()
        self.seen: list[Seen] = []
        self.service = RunService(load_run(path), self.clock, lambda channel, seen: self.seen.append(seen))
        self.service.start()

    def requests(self) -> list[str]:
        """Return start and count of every requested read."""
        found = []
        for seen in self.seen:
            if seen.direction == "out" and seen.kind == "frame":
                found.append(f"{seen.raw[2] << 8 | seen.raw[3]}+{seen.raw[5]}")
        return found


READS = """\
channels: {1: {port: "sim:d.device.yaml", protocol: modbus-rtu, station: 1MORE}}
blocks:
  0: {read: 40001, count: 2, into: M0, every: 1 s, phase: 0 s}
  1: {read: 40003, count: 3, into: M10, every: 1 s, phase: 0 s}
  2: {read: 40008, count: 2, into: M20, every: 1 s, phase: 0 s}
"""


@pytest.mark.parametrize(
    ("more", "requests"),
    [
        ("", ["0+2", "2+3", "7+2"]),
        (", merge: yes", ["0+5", "7+2"]),
        (", merge: {gap: 2}", ["0+9"]),
        (", merge: {gap: 2, max: 5}", ["0+5", "7+2"]),
        (", merge: {gap: 9, max: 2}", ["0+2", "2+3", "7+2"]),
    ],
)
def test_reads_that_are_due_together(tmp_path: Path, more: str, requests: list[str]) -> None:
    bench = Bench(tmp_path, READS.replace("MORE", more))
    bench.clock.run_for(SECOND // 2)
    assert bench.requests() == requests
    memory = bench.service.memory
    assert [memory.read("M", "word", place, count) for place, count in ((0, 2), (10, 3), (20, 2))] == [
        [1, 2], [3, 4, 5], [8, 9],
    ]  # fmt: skip
    for state in bench.service.states.values():
        assert (state.started, state.done) == (1, 1)


def test_a_joined_read_that_is_refused_is_not_joined_again(tmp_path: Path) -> None:
    more = ", merge: yes, faults: {rules: [{fault: error_reply, times: 1}]}"
    bench = Bench(tmp_path, READS.replace("MORE", more))
    bench.clock.run_for(SECOND + SECOND // 2)
    assert bench.requests() == ["0+5", "7+2", "0+2", "2+3", "7+2"]
    counters = list(bench.service.states.values())
    assert [(counter.started, counter.done, counter.failed) for counter in counters] == [
        (2, 1, 1),
        (2, 1, 1),
        (2, 2, 0),
    ]


def test_blocks_that_have_been_edited_are_joined_again(tmp_path: Path) -> None:
    more = ", merge: yes, faults: {rules: [{fault: error_reply, times: 1}]}"
    bench = Bench(tmp_path, READS.replace("MORE", more))
    bench.clock.run_for(SECOND + SECOND // 2)
    path = tmp_path / "r.run.yaml"
    text = path.read_text(encoding="utf-8").replace("into: M0,", "into: M1,").replace("into: M10", "into: M11")
    path.write_text(text, encoding="utf-8")
    bench.service.edit(load_run(path))
    bench.seen.clear()
    bench.clock.run_for(SECOND // 4)
    assert bench.requests() == ["0+5"]


def test_one_block_and_one_station_with_other_times(tmp_path: Path) -> None:
    bench = Bench(
        tmp_path,
        """\
dead: no
channels:
  1: {port: "sim:d.device.yaml", protocol: modbus-rtu, retries: 1, timeout: 200 ms, stations: {8: {retries: 0}}}
blocks:
  0: {read: 40001, station: 7, into: M0, once: yes}
  1: {read: 40001, station: 8, into: M0, once: yes}
  2: {read: 40001, station: 9, into: M0, once: yes, retries: 3, timeout: 50 ms}
  3: {read: 40001, station: 7, into: M0, after: 5 s}
""",
    )
    bench.clock.run_for(10 * SECOND)
    requests = [(seen.raw[0], seen.at) for seen in bench.seen if seen.direction == "out" and seen.raw]
    assert [station for station, _ in requests] == [7, 7, 8, 9, 9, 9, 9, 7, 7]
    pauses = [(requests[place + 1][1] - requests[place][1]) // 1_000_000 for place in (0, 3, 7)]
    assert [200 <= pauses[0] < 215, 50 <= pauses[1] < 65, 200 <= pauses[2] < 215] == [True] * 3


def test_a_channel_switched_off_and_on(tmp_path: Path) -> None:
    bench = Bench(tmp_path, READS.replace("MORE", ""))
    bench.clock.run_for(2 * SECOND + SECOND // 2)
    before = bench.service.states[0].done
    bench.service.enable_channel(1, False)
    bench.clock.run_for(5 * SECOND)
    assert bench.service.states[0].done == before
    bench.service.enable_channel(1, True)
    bench.clock.run_for(5 * SECOND)
    assert bench.service.states[0].done in (before + 5, before + 6)


def test_sets_in_a_run(tmp_path: Path) -> None:
    bench = Bench(
        tmp_path,
        """\
channels: {1: {port: "sim:d.device.yaml", protocol: modbus-rtu, station: 1}}
sets:
  1: {blocks: {0: {read: 40001, into: M0, every: 1 s, phase: 0 s}, 1: {read: 40002, into: M1, when: block 0 done}}}
  8: {enabled: no, blocks: {0: {read: 40003, into: M2, every: 1 s, phase: 0 s}}}
""",
    )
    bench.clock.run_for(3 * SECOND - 1)
    done = {number: state.done for number, state in bench.service.states.items()}
    assert done == {0: 3, 1: 3, 448: 0}
    bench.service.enable_set(8)
    bench.clock.run_for(3 * SECOND)
    assert bench.service.states[448].done == 3
    assert bench.service.memory.read("M", "word", 0, 3) == [1, 2, 3]
    base = 625 + 6 * 64 * 7
    assert bench.service.memory.read("L", "word", base + 2, 1) == [3], "SVCCNT of set 8, block 0"


def test_joined_reads_have_the_times_of_their_station(tmp_path: Path) -> None:
    text = READS.replace(
        "station: 1MORE", "station: 9, merge: yes, dead: no, stations: {9: {retries: 0, timeout: 100 ms}}"
    )
    bench = Bench(tmp_path, text)
    bench.clock.run_for(SECOND // 2)
    assert bench.requests() == ["0+5", "7+2"], "asked once each"
    assert [state.failed for state in bench.service.states.values()] == [1, 1, 1]
    scope = bench.service.channels[1].engine.scope
    assert (scope["retries"], scope["reply_timeout"]) == (2, SECOND), "and then as before"
