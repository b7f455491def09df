"""Runs that save their state: restart, kill, and refused state files."""

from __future__ import annotations

import signal
import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest

from framekit.cli.main import main
from framekit.run.block_state import ErrorCode
from framekit.runfile.run_file import load_run
from framekit.service.run import RunService
from framekit.service.state import StateError, StateFile
from framekit.transport.clock import VirtualClock

SECOND = 1_000_000_000
DEVICE = "device: one\nprotocol: modbus-rtu\nstation: 1\nmemory: {set: {40001: [11, 12]}}\n"
RUN = """
run: plant
memory: masterlogic
state: plant.state
set: {M0: 7, K0: 3}
channels:
  1: {port: "sim:one.device.yaml", protocol: modbus-rtu, dead: no, params: {reply_timeout: 50 ms, retries: 0}}
blocks:
  0: {read: "40001", station: 1, into: K100, every: 1 s}
  1: {read: "40002", station: 9, into: K101, every: 1 s, phase: 500 ms}
"""


class Bench:
    """The started run of a folder."""

    def __init__(self, folder: Path, run: str = RUN) -> None:
        (folder / "one.device.yaml").write_text(DEVICE, encoding="utf-8")
        (folder / "plant.run.yaml").write_text(run, encoding="utf-8")
        self.clock = VirtualClock()
        self.service = RunService(load_run(folder / "plant.run.yaml"), self.clock)
        self.memory = self.service.memory
        self.service.start()

    def counts(self) -> list[tuple[int, int, int, int]]:
        states = self.service.states.values()
        return [(s.started, s.done, s.failed, s.running) for s in states]


def test_a_restart_goes_on_where_it_was(tmp_path: Path) -> None:
    first = Bench(tmp_path)
    first.clock.run_for(10 * SECOND + 100_000_000)
    first.memory.write("K", "word", 0, [99])
    first.memory.write("M", "word", 0, [99])
    first.memory.write("N", "word", 0, [5])
    first.service.stop()
    assert first.counts() == [(10, 10, 0, 0), (10, 0, 10, 0)]
    second = Bench(tmp_path)
    assert second.counts() == [(10, 10, 0, 0), (10, 0, 10, 0)]
    assert second.memory.read("K", "word", 100) == [11] and second.memory.read("K", "word", 0) == [99]
    assert second.memory.read("M", "word", 0) == [7] and second.memory.read("N", "word", 0) == [1], "not retained"
    assert second.memory.read("L", "word", 625, 12) == [0, 0, 10, 0, 0, 0, 0, ErrorCode.NO_REPLY, 0, 0, 10, 0]
    second.clock.run_for(SECOND + 100_000_000)
    assert second.counts() == [(11, 11, 0, 0), (11, 0, 11, 0)]
    second.service.stop()
    second.service.stop()


def test_an_exchange_under_way_counts_as_failed(tmp_path: Path) -> None:
    first = Bench(tmp_path)
    first.clock.run_for(SECOND // 2 + 10_000_000)
    first.service.stop()
    assert first.counts()[1] == (1, 0, 1, 0) or first.counts()[1] == (1, 0, 0, 1)
    second = Bench(tmp_path)
    assert second.counts()[1] == (1, 0, 1, 0)
    assert second.service.status()[1].reason in (ErrorCode.INTERRUPTED, ErrorCode.CLOSED)
    second.service.stop()


def test_a_changed_block_begins_anew_and_a_moved_one_does_not(tmp_path: Path) -> None:
    first = Bench(tmp_path)
    first.clock.run_for(3 * SECOND)
    first.service.stop()
    second = Bench(tmp_path, "# a remark\n" + RUN.replace("station: 9", "station: 8"))
    assert [counts[0] for counts in second.counts()] == [3, 0]
    second.service.stop()


def test_other_areas_and_settings(tmp_path: Path) -> None:
    kept = RUN.replace("plant.state", "{file: plant.state, keep: [M, W, N], every: 100 ms}")
    first = Bench(tmp_path, kept)
    first.memory.write("M", "word", 0, [99])
    first.memory.write("N", "word", 0, [5, 6])
    first.memory.write("N", "word", 41 * 2, [8])
    first.memory.write("ZR", "word", 65535, [0xABCD])
    first.clock.run_for(SECOND)
    first.service.stop()
    second = Bench(tmp_path, kept)
    assert second.memory.read("M", "word", 0) == [99] and second.memory.read("K", "word", 0) == [3]
    assert second.memory.read("ZR", "word", 65535) == [0xABCD]
    assert second.memory.read("N", "word", 0) == [1], "the run says which station"
    assert second.memory.read("N", "word", 41 * 2) == [8], "free memory is kept"
    second.service.stop()


def test_it_is_written_while_the_run_goes_on(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    for _ in range(10):
        bench.clock.run_for(SECOND)
        assert bench.service.keeper is not None
        bench.service.keeper._see(wait=True)
    keeper = bench.service.keeper
    assert keeper is not None
    keeper.file.close()
    shape = keeper.file.shape
    with closing(StateFile(tmp_path / "plant.state", "plant", shape)) as file:
        assert 8 <= file.kept.blocks[1, 0].started <= 10


@pytest.mark.usefixtures("small_heap")
@pytest.mark.parametrize("words", [["--virtual"], ["--virtual", "--json"], []])
def test_a_run_whose_last_state_cannot_be_written_ends_with_status_1(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], words: list[str]
) -> None:
    Bench(tmp_path).service.stop()
    line = ["run", str(next(tmp_path.glob("*.run.yaml"))), "--for", "50ms", *words]
    assert main(line) == 0
    capsys.readouterr()

    def full(file: StateFile, kept: object) -> int:
        raise StateError("plant.state: the disk is full")

    monkeypatch.setattr(StateFile, "save", full)
    (tmp_path / "plant.state").unlink()
    assert main(line) == 1
    output = capsys.readouterr()
    assert "plant.state: the disk is full" in (output.out if "--json" in words else output.err)


def test_what_cannot_be_written_is_told_and_tried_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(tmp_path)
    keeper = bench.service.keeper
    assert keeper is not None

    def full(kept: object) -> int:
        raise StateError(f"{tmp_path}/plant.state: the disk is full")

    reports: list[str] = []
    bench.service.troubles.listen(
        lambda report: reports.append(report.text) if report.trouble.name.startswith("state") else None
    )

    with monkeypatch.context() as patch:
        patch.setattr(keeper.file, "save", full)
        for _ in range(3):
            bench.clock.run_for(SECOND)
            keeper._see(wait=True)
        assert bench.service.problems == [f"state {tmp_path}/plant.state: the disk is full"]
    bench.clock.run_for(2 * SECOND)
    assert bench.counts()[0][0] == 5
    bench.service.stop()
    assert bench.service.problems == []
    assert reports == [
        f"state {tmp_path}/plant.state: the disk is full – make room there; the file keeps an older state, "
        "each write is tried again",
        reports[-1],
    ]
    assert reports[-1].startswith(f"state {tmp_path}/plant.state: works again after ")
    second = Bench(tmp_path)
    assert second.counts()[0][0] == 5
    second.service.stop()


def test_refused_files_from_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bench = Bench(tmp_path)
    bench.service.stop()
    path = tmp_path / "plant.state"
    run = str(tmp_path / "plant.run.yaml")
    assert main(["run", run, "--virtual", "--for", "2s"]) == 0
    Path(run).write_text(RUN.replace("run: plant", "run: mill"), encoding="utf-8")
    before = path.read_bytes()
    assert main(["run", run, "--virtual", "--for", "1s"]) == 1
    assert "is the state of run 'plant', this run is 'mill' – name another file" in capsys.readouterr().err
    path.write_bytes(before[:5000])
    assert main(["run", run, "--virtual", "--for", "1s"]) == 1
    message = capsys.readouterr().err
    assert "is damaged" in message and "Traceback" not in message
    assert path.read_bytes() == before[:5000]


@pytest.mark.long
def test_killed_again_and_again(tmp_path: Path) -> None:
    (tmp_path / "one.device.yaml").write_text(DEVICE, encoding="utf-8")
    often = RUN.replace("plant.state", "{file: plant.state, every: 100 ms}").replace("every: 1 s", "every: 20 ms")
    (tmp_path / "plant.run.yaml").write_text(often, encoding="utf-8")
    command = [sys.executable, "-m", "framekit", "run", "--frames", str(tmp_path / "plant.run.yaml")]
    last = 0
    for turn in range(2):
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            for _ in range(20 + 37 * turn):
                assert process.stdout.readline(), "it runs"
            process.send_signal(signal.SIGKILL)
        with closing(sqlite3.connect(tmp_path / "plant.state")) as base:
            assert base.execute("PRAGMA integrity_check").fetchone() == ("ok",)
            rows = base.execute("SELECT started, done, failed FROM blocks").fetchall()
        assert all(started - done - failed in (0, 1) for started, done, failed in rows)
        started = sum(row[0] for row in rows)
        assert started >= last
        last = started
    assert last > 0
    bench = Bench(tmp_path, often)
    assert sum(counts[0] for counts in bench.counts()) == last
    assert all(started == done + failed and not running for started, done, failed, running in bench.counts())
    bench.service.stop()


def test_blocks_that_an_edit_has_taken_out_are_kept_no_more(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    path = tmp_path / "plant.run.yaml"
    block = '  1: {read: "40002", station: 9, into: K101, every: 1 s, phase: 500 ms}\n'

    def kept() -> list[int]:
        with closing(sqlite3.connect(tmp_path / "plant.state")) as base:
            return [number for (number,) in base.execute("SELECT number FROM blocks ORDER BY number")]

    keeper = bench.service.keeper
    assert keeper is not None
    for phase in range(20, 40):
        path.write_text(RUN.replace("500 ms", f"{phase}0 ms"), encoding="utf-8")
        bench.service.edit(load_run(path))
        keeper.kept()
        assert len(keeper._contents) == 2
    bench.service.edit(load_run(path))
    path.write_text(RUN.replace(block, ""), encoding="utf-8")
    bench.service.edit(load_run(path))
    bench.clock.run_for(3 * SECOND)
    bench.service.stop()
    assert kept() == [0]
    path.write_text(RUN, encoding="utf-8")
    again = Bench(tmp_path)
    assert again.counts()[1] == (0, 0, 0, 0), "a block that comes back begins anew"
    again.service.stop()
    assert kept() == [0, 1]
