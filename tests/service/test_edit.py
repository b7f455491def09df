"""Edited runs: unchanged parts continue undisturbed, changed parts restart, an invalid edit is refused as a whole."""

from __future__ import annotations

from pathlib import Path

import pytest

from framekit.api.run import carry_out, run_status
from framekit.cli.run_output import status_data, status_text
from framekit.definition.problems import DefinitionError
from framekit.link.events import Seen
from framekit.run.edit import Edit, plan_edit
from framekit.run.model import RunModel
from framekit.runfile.run_file import load_run
from framekit.service.run import RunService
from framekit.transport.clock import VirtualClock

SECOND = 1_000_000_000
MS = 1_000_000
ONE = "device: one\nprotocol: modbus-rtu\nstation: 1\nmemory: {set: {40001: [11, 12]}}\n"
TWO = "device: two\nprotocol: modbus-rtu\nstation: 2\nmemory: {set: {40001: [22, 23]}}\n"
RUN = """
run: plant
memory: masterlogic
channels:
  1: {port: "sim:one.device.yaml", protocol: modbus-rtu, params: {reply_timeout: 200 ms, retries: 0}}
  2: {port: "sim:two.device.yaml", protocol: modbus-rtu}
blocks:
  0: {read: "40001", channel: 1, station: 1, into: M0, every: 1 s, phase: 300 ms}
  1: {read: "40001", channel: 2, station: 2, into: M1, every: 1 s}
  2: {read: "40002", channel: 1, station: 1, into: M2, when: block 1 done}
"""


class Bench:
    """A running run, its file, and all events on its lines."""

    def __init__(self, folder: Path) -> None:
        (folder / "one.device.yaml").write_text(ONE, encoding="utf-8")
        (folder / "two.device.yaml").write_text(TWO, encoding="utf-8")
        self.path = folder / "plant.run.yaml"
        self.path.write_text(RUN, encoding="utf-8")
        self.clock = VirtualClock()
        self.seen: list[tuple[int, Seen]] = []
        self.service = RunService(
            load_run(self.path), self.clock, lambda number, seen: self.seen.append((number, seen))
        )
        self.memory = self.service.memory
        self.edits: list[Edit] = []
        self.service.start()

    def edit(self, *changes: tuple[str, str], text: str = RUN) -> None:
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        self.path.write_text(text, encoding="utf-8")
        self.service.edit(load_run(self.path), self.edits.append)

    def counts(self, number: int) -> tuple[int, int, int]:
        counters = self.service.states[number]
        assert counters.started == counters.done + counters.failed + counters.running
        return counters.started, counters.done, counters.failed

    def openings(self, channel: int) -> int:
        return len([seen for number, seen in self.seen if number == channel and seen.kind == "open"])

    def requests(self, channel: int) -> list[int]:
        return [seen.at for number, seen in self.seen if number == channel and seen.direction == "out"]


def test_what_is_the_same_goes_on(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    bench.clock.run_for(5 * SECOND + 500 * MS)
    bench.memory.write("M", "word", 50, [77])
    bench.edit(("run: plant", "# moved by a remark\nrun: plant"))
    assert str(bench.edits[0]) == "nothing is different"
    bench.edit(("into: M1, every: 1 s", "into: M101, every: 2 s"))
    assert str(bench.edits[1]) == "block 1 changed"
    bench.clock.run_for(5 * SECOND)
    assert bench.counts(0) == (11, 11, 0) and bench.requests(1)[-1] == 10 * SECOND + 300 * MS, "count and phase"
    assert bench.counts(1) == (2, 2, 0), "begun anew, 2 s after the edit"
    assert bench.counts(2) == (7, 7, 0), "it waits for the new block 1 as for the old one"
    assert bench.memory.read("M", "word", 101) == [22] and bench.memory.read("M", "word", 50) == [77]
    assert bench.openings(1) == bench.openings(2) == 1, "no channel was reopened"
    assert list(bench.service.states) == [0, 1, 2]


def test_blocks_come_and_go(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    bench.clock.run_for(2 * SECOND + 500 * MS)
    bench.edit(
        ("  2: {read", "  7: {read: \"40002\", channel: 2, station: 2, into: M7, once: yes}\n  3: {read"),
    )  # fmt: skip
    assert str(bench.edits[0]) == "block 2 gone, blocks 3 and 7 new"
    bench.clock.run_for(2 * SECOND)
    assert set(bench.service.states) == {0, 1, 3, 7}
    assert bench.counts(7) == (1, 1, 0) and bench.counts(3) == (2, 2, 0) and bench.counts(1) == (4, 4, 0)
    assert bench.memory.read("M", "word", 7) == [23]
    assert bench.memory.read("L", "word", 625 + 12, 6) == [0] * 6, "words of block 2 are free"
    assert bench.memory.read("N", "word", 41 * 2, 41) == [0] * 41
    assert bench.memory.read("L", "word", 625 + 42, 6) == [0, 0, 1, 0, 0, 0]
    bench.edit()
    bench.clock.run_for(SECOND)
    assert set(bench.service.states) == {0, 1, 2}


def test_control_lines_know_the_edited_run(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    bench.clock.run_for(SECOND)
    sets = "sets:\n  1:\n    blocks:" + RUN[RUN.index("blocks:") + 7 :].replace("\n", "\n    ")
    sets += '\n  2: {blocks: {5: {read: "40002", channel: 3, station: 1, into: M9}}}\n'
    text = RUN[: RUN.index("blocks:")] + '  3: {port: "sim:one.device.yaml", protocol: modbus-rtu}\n' + sets
    before = ("fire 2.5", "enable 2.5", "disable set 2", "disable channel 3")
    for line in before:
        with pytest.raises(ValueError, match="there is no"):
            carry_out(bench.service, line)
    bench.edit(text=text)
    carry_out(bench.service, "fire 2.5")
    bench.clock.run_for(SECOND)
    assert bench.counts(64 + 5) == (1, 1, 0) and bench.memory.read("M", "word", 9) == [12]
    for line in ("disable 2.5", "disable set 2", "disable channel 3"):
        carry_out(bench.service, line)
    assert not bench.service.states[64 + 5].enabled and run_status(bench.service).channels[-1].state != "open"
    bench.edit()
    for line in before:
        with pytest.raises(ValueError, match="there is no"):
            carry_out(bench.service, line)


def test_what_removed_blocks_counted_stays_in_the_totals(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    bench.clock.run_for(5 * SECOND + 500 * MS)
    before = {channel.number: (channel.services, channel.errors) for channel in run_status(bench.service).channels}
    assert before == {1: (11, 0), 2: (5, 0)} and run_status(bench.service).removed == ()
    bench.edit(("into: M1, every: 1 s", "into: M101, every: 2 s"), (RUN[RUN.index('  2: {read: "40002"') :], ""))
    status = run_status(bench.service)
    assert {channel.number: (channel.services, channel.errors) for channel in status.channels} == before
    assert [(channel.channel, channel.blocks, channel.started, channel.done) for channel in status.removed] == [
        (1, 1, 5, 5),
        (2, 1, 5, 5),
    ]
    text = status_text(status, 0)
    assert "-    -      1 removed block  1        gone   5     0       0         -" in text
    shown = status_data(status, 0)["removed"][1]
    assert shown == {
        "channel": 2, "blocks": 1, "started": 5, "done": 5, "failed": 0, "overruns": 0, "reasons": {},
    }  # fmt: skip
    bench.clock.run_for(2 * SECOND + 500 * MS)
    assert [channel.services for channel in run_status(bench.service).channels] == [13, 6]
    bench.service.reset()
    assert run_status(bench.service).removed == () and run_status(bench.service).channels[0].services == 0


def test_failures_of_removed_blocks_stay_with_their_reasons(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    bench.edit(('{read: "40002", channel: 1, station: 1', '{read: "40002", channel: 1, station: 9'))
    bench.clock.run_for(3 * SECOND + 900 * MS)
    errors = run_status(bench.service).channels[0].errors
    assert errors and run_status(bench.service).channels[0].reasons == {"no_reply": errors}
    bench.edit()
    channel = run_status(bench.service).channels[0]
    assert (channel.errors, channel.reasons) == (errors, {"no_reply": errors})
    assert f"{errors} × no_reply" in status_text(run_status(bench.service), 0).splitlines()[-1]


def test_channels_change_come_and_go(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    bench.clock.run_for(2 * SECOND + 500 * MS)
    brought: list[int] = []
    bench.service.on_channel = lambda number, channel: brought.append(number)
    third = '  3: {port: "sim:two.device.yaml", protocol: modbus-rtu}\n'
    fast = "protocol: modbus-rtu, speed: 9600}\n" + third
    bench.edit(
        ('sim:two.device.yaml", protocol: modbus-rtu}\n', f'sim:two.device.yaml", {fast}'),
        ("blocks:", 'blocks:\n  4: {read: "40001", channel: 3, station: 2, into: M4, every: 1 s}'),
    )
    assert str(bench.edits[0]) == "channel 2 changed, channel 3 new, block 4 new"
    bench.clock.run_for(3 * SECOND + 200 * MS)
    assert (bench.openings(1), bench.openings(2), bench.openings(3)) == (1, 2, 1)
    assert bench.counts(1) == (5, 5, 0), "the block of the changed channel goes on"
    assert bench.counts(4) == (3, 3, 0)
    bench.edit()
    bench.clock.run_for(2 * SECOND)
    assert set(bench.service.channels) == {1, 2} and len(bench.service.devices) == 2
    assert brought == [2, 3, 2], "whoever watches ports hears of every other one"
    assert bench.counts(1) == (7, 7, 0)
    before = len(bench.requests(3))
    bench.clock.run_for(2 * SECOND)
    assert len(bench.requests(3)) == before


def test_an_exchange_is_never_broken_off(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    text = RUN.replace('0: {read: "40001", channel: 1, station: 1', '0: {read: "40001", channel: 1, station: 9')
    bench.edit(text=text)
    bench.clock.run_for(350 * MS)
    assert bench.counts(0) == (1, 0, 0), "nobody answers: it runs until 500 ms"
    bench.edit(text=RUN.replace("1 s, phase: 300 ms", "100 ms"))
    assert len(bench.edits) == 1, "it waits"
    bench.clock.run_for(100 * MS)
    assert bench.counts(0) == (1, 0, 0) and len(bench.edits) == 1
    bench.clock.run_for(100 * MS)
    assert len(bench.edits) == 2
    bench.clock.run_for(SECOND + 100 * MS)  # the wait for its late reply starts again
    assert bench.counts(0)[0] >= 10 and bench.counts(0)[2] == 0, "begun anew"
    assert [seen for _, seen in bench.seen if seen.kind == "bad"] == []


def test_address_and_size_of_a_block_change_after_its_exchange(tmp_path: Path) -> None:
    """As Table 81 of the Snet manual allows: the exchange under way ends with the old values."""
    bench = Bench(tmp_path)
    bench.clock.run_for(301 * MS)
    assert bench.counts(0) == (1, 0, 0), "it runs"
    bench.edit(
        (
            '0: {read: "40001", channel: 1, station: 1, into: M0',
            '0: {read: "40001", count: 2, channel: 1, station: 1, into: M20',
        )
    )
    bench.clock.run_for(200 * MS)
    assert len(bench.edits) == 1 and bench.memory.read("M", "word", 0, 2) == [11, 0]
    assert bench.memory.read("M", "word", 20, 2) == [0, 0]
    bench.clock.run_for(2 * SECOND)
    assert bench.memory.read("M", "word", 20, 2) == [11, 12]


def test_an_edit_that_waits_gives_way_to_the_next(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    bench.edit(text=RUN.replace("station: 1, into: M0", "station: 9, into: M0"))
    bench.clock.run_for(350 * MS)
    bench.edit(text=RUN.replace("1 s, phase: 300 ms", "100 ms"))
    bench.edit(text=RUN.replace("1 s, phase: 300 ms", "5 s"))
    bench.clock.run_for(10 * SECOND)
    assert [str(edit) for edit in bench.edits] == ["block 0 changed", "block 0 changed"]
    assert bench.counts(0) == (1, 1, 0)


def test_receiving_blocks_change(tmp_path: Path) -> None:
    example = Path(__file__).parents[2] / "examples"
    for name in ("third-party-plc.run.yaml", "third-party-plc.device.yaml"):
        (tmp_path / name).write_text((example / name).read_text(encoding="utf-8"), encoding="utf-8")
    path = tmp_path / "third-party-plc.run.yaml"
    clock = VirtualClock()
    service = RunService(load_run(path), clock)
    service.start()
    clock.run_for(3 * SECOND + 500 * MS)
    path.write_text(path.read_text(encoding="utf-8").replace("payload: M100", "payload: D100"), encoding="utf-8")
    service.memory.write("M", "word", 100, [0, 0, 0])
    service.edit(load_run(path))
    clock.run_for(3 * SECOND)
    assert service.memory.read("M", "word", 100, 3) == [0, 0, 0]
    assert service.memory.read("D", "word", 100, 3) == [1, 2, 3]
    assert service.states[1].done == 3 and service.states[2].done == 6


def test_clocks_tick_for_new_blocks(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    bench.clock.run_for(3 * SECOND + 500 * MS)
    bench.edit(("into: M1, every: 1 s", "into: M1, when: F00093"))
    bench.clock.run_for(3 * SECOND)
    assert bench.counts(1) == (3, 3, 0)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("masterlogic", "{profile: masterlogic, scan: 20 ms}", "the memory of a run that goes on stays as it is"),
        ("run: plant", "run: plant\nstatus: no", "whether blocks have words in memory cannot change"),
        ("run: plant", "run: plant\nstate: s", "where the state is kept"),
        ("sim:two", "sim:none", "none.device.yaml"),
        ("into: M1,", "into: Q1,", "Q1"),
    ],
)
def test_an_edit_is_refused_whole(tmp_path: Path, old: str, new: str, message: str) -> None:
    bench = Bench(tmp_path)
    bench.clock.run_for(2 * SECOND + 500 * MS)
    run, blocks = bench.service.run, list(bench.service.states.values())
    with pytest.raises(DefinitionError) as found:
        bench.edit((old, new), ("into: M2", "into: M3"))
    assert any(message in problem.what and problem.at.file.endswith(".yaml") for problem in found.value.problems)
    bench.clock.run_for(2 * SECOND)
    assert bench.service.run is run and list(bench.service.states.values()) == blocks and bench.edits == []
    assert bench.counts(1) == (4, 4, 0) and bench.counts(2) == (4, 4, 0)


def test_other_start_values_are_told(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    bench.path.write_text(RUN + "set: {M5: 5}\n", encoding="utf-8")
    edit = plan_edit(bench.service.run, load_run(bench.path))
    assert str(edit) == "nothing is different"
    assert [problem.what for problem in edit.warnings] == [
        "memory stays as it is: other start values count from the next start on"
    ]


POINTS_RUN = """run: plant
channels:
  1: {port: "sim:one.device.yaml", protocol: modbus-rtu, station: 1}
points:
  a: {channel: 1, address: "40001"}
  b: {channel: 1, address: "40002"}
sinks:
  - {csv: a.csv}
"""
A = '  a: {channel: 1, address: "40001"}\n'


@pytest.mark.parametrize(
    ("old", "new", "place", "what"),
    [
        ("40002", "40003", (6, 3), "point b changed"),
        ("sinks:", '  c: {channel: 1, address: "40001"}\nsinks:', (7, 3), "point c new"),
        (A, "", (5, 3), "point a gone"),
        ("  a:", "  d:", (5, 3), "point d new, point a gone"),
        (A, "".join(f'  x{number}: {{channel: 1, address: "40001"}}\n' for number in range(7)), (5, 3),
         "points x0, x1, x2, x3, x4 and 2 others new, point a gone"),
    ],
)  # fmt: skip
def test_a_refused_edit_of_points_names_them_at_their_place(
    tmp_path: Path, old: str, new: str, place: tuple[int, int], what: str
) -> None:
    before, after = edited(tmp_path, old, new)
    with pytest.raises(DefinitionError) as error:
        plan_edit(before, after)
    (problem,) = error.value.problems
    assert (problem.at.line, problem.at.column) == place
    assert problem.what == f"the points of a run that goes on stay as they are: {what}"


@pytest.mark.parametrize(
    ("old", "new", "place"),
    [
        ("{csv: a.csv}", "{csv: b.csv}", (8, 5)),
        ("{csv: a.csv}", "{csv: a.csv}\n  - {csv: b.csv}", (9, 5)),
        ("sinks:\n  - {csv: a.csv}\n", "", (1, 1)),
    ],
)
def test_a_refused_edit_of_sinks_has_their_place(tmp_path: Path, old: str, new: str, place: tuple[int, int]) -> None:
    with pytest.raises(DefinitionError, match="where the values of a run go") as error:
        plan_edit(*edited(tmp_path, old, new))
    (problem,) = error.value.problems
    assert (problem.at.line, problem.at.column) == place


def edited(folder: Path, old: str, new: str) -> tuple[RunModel, RunModel]:
    """Return a run of points before and after a change of its text."""
    assert old in POINTS_RUN
    (folder / "one.device.yaml").write_text(ONE, encoding="utf-8")
    path = folder / "points.run.yaml"
    path.write_text(POINTS_RUN, encoding="utf-8")
    before = load_run(path)
    path.write_text(POINTS_RUN.replace(old, new), encoding="utf-8")
    return before, load_run(path)
