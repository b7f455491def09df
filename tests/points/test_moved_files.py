"""Files that another program moves, deletes, replaces or cuts while they are written: reported, and no row is lost."""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path

import pytest
from points.test_parquet import POINTS as TYPED_POINTS
from points.test_parquet import names, rows_of, sink_of
from points.test_parquet import sample as typed_sample
from points.test_sinks import POINTS, SECOND, lines_of, run_file, sample

from framekit.api.run import VirtualRun
from framekit.definition.problems import NOWHERE
from framekit.run.trouble import TroubleReport, Troubles
from framekit.service.capture import Capture, CaptureReader
from framekit.service.sinks import SinkFeeder, SinkHost
from framekit.service.state import KeptRun, StateFile
from framekit.sinks import SinkKind
from framekit.sinks.files import CsvFile, JsonLines
from framekit.sinks.opened_file import CUT, MOVED, REPLACED, OpenedFile
from framekit.sinks.sqlite import SqliteHistory, read_history
from framekit.sinks.store import Store, StoreError
from framekit.transport.clock import VirtualClock
from framekit.transport.port import LineEvent


def _move(path: Path) -> None:
    path.rename(path.with_name(f"moved-{path.name}"))


def _move_and_create(path: Path) -> None:
    """Act as logrotate does with `create`."""
    _move(path)
    path.touch()


def _cut(path: Path) -> None:
    """Act as logrotate does with `copytruncate`."""
    path.with_name(f"moved-{path.name}").write_bytes(path.read_bytes())
    os.truncate(path, 0)


class Feeding:
    """An active sink without a thread, and the lines of its trouble."""

    def __init__(self, kind: SinkKind) -> None:
        clock = VirtualClock()
        troubles = Troubles(clock.now)
        self.lines: list[str] = []
        troubles.listen(lambda report: self.lines.append(report.text))
        self.feeder = SinkFeeder(kind, POINTS, False, SinkHost("run", clock), troubles)
        self.feeder.open()
        self.feeder.start()

    def put(self, *seconds: int) -> None:
        for at in seconds:
            self.feeder.put(sample(at, value=at))


def _values(path: Path) -> list[str]:
    """Return the values of a csv file with its head."""
    head, *rows = lines_of(path)
    assert head == "time,point,value,unit,quality,reason"
    return [row.split(",")[2] for row in rows]


@pytest.mark.parametrize(
    ("change", "line"),
    [(_move, MOVED), (Path.unlink, MOVED), (_move_and_create, MOVED), (_cut, CUT)],
    ids=["moved", "deleted", "logrotate-create", "logrotate-copytruncate"],
)
def test_a_csv_file_begins_anew_with_its_head(tmp_path: Path, change: Callable[[Path], None], line: str) -> None:
    path = tmp_path / "a.csv"
    work = Feeding(CsvFile(csv=str(path), at=NOWHERE))
    work.put(1, 2)
    change(path)
    work.put(3, 4)
    work.feeder.stop()
    assert _values(path) == ["3", "4"]
    moved = tmp_path / "moved-a.csv"
    assert not moved.exists() or _values(moved) == ["1", "2"]
    assert work.lines == [f"sink csv {path}: {line}"]
    assert work.feeder.status.written == 4 and work.feeder.status.dropped == 0


def test_a_file_that_was_put_there_is_continued(tmp_path: Path) -> None:
    path, other = tmp_path / "a.jsonl", tmp_path / "other.jsonl"
    work = Feeding(JsonLines(jsonl=str(path), at=NOWHERE))
    work.put(1)
    other.write_text('{"time": "2019-01-01T00:00:00.000Z", "point": "mine", "value": 1, "quality": "good"}\n')
    other.replace(path)
    work.put(2)
    work.feeder.stop()
    assert [line[:14] for line in lines_of(path)] == ['{"time": "2019', '{"time": "2026']
    assert work.lines == [f"sink jsonl {path}: {REPLACED}"]


def test_the_log_of_a_database_that_was_put_there_is_kept(tmp_path: Path) -> None:
    """The copy includes the log of the database, which has the last rows."""
    path, copied = tmp_path / "a.db", tmp_path / "copied"
    work, other = Feeding(SqliteHistory(sqlite=str(path), at=NOWHERE)), tmp_path / "other.db"
    work.put(1)
    from_there = Feeding(SqliteHistory(sqlite=str(other), at=NOWHERE))
    from_there.put(5, 6)
    copied.mkdir()
    for end in ("", "-wal"):
        (copied / f"a.db{end}").write_bytes(Path(f"{other}{end}").read_bytes())
    from_there.feeder.stop()
    for end in ("", "-wal", "-shm"):
        Path(f"{path}{end}").rename(tmp_path / f"moved.db{end}")
    for end in ("", "-wal"):
        (copied / f"a.db{end}").rename(f"{path}{end}")
    work.put(3)
    work.feeder.stop()
    assert [row.value for row in read_history(path)] == [3, 5, 6]
    assert [row.value for row in read_history(tmp_path / "moved.db")] == [1]


def test_values_wait_while_the_folder_is_missing(tmp_path: Path) -> None:
    """The disk is unmounted: the folder must not be created on the disk below."""
    folder = tmp_path / "disk"
    folder.mkdir()
    path = folder / "a.csv"
    work = Feeding(CsvFile(csv=str(path), at=NOWHERE))
    work.put(1)
    folder.rename(tmp_path / "gone")
    work.put(2, 3)
    assert not folder.exists() and work.feeder.status.waiting == 2
    folder.mkdir()
    work.put(4)
    work.feeder.stop()
    assert _values(path) == ["2", "3", "4"] and _values(tmp_path / "gone" / "a.csv") == ["1"]
    assert work.lines[0] == (
        f"sink csv {path}: the folder {folder} does not exist – make the folder; 1 sample waits, "
        "the oldest are dropped from 100,000 on"
    )
    assert work.lines[1].endswith("no sample was lost") and len(work.lines) == 2


def _history(path: Path) -> list[object]:
    return [row.value for row in read_history(path)]


@pytest.mark.parametrize("change", [_move, Path.unlink, _move_and_create])
def test_a_history_begins_anew_with_its_tables(tmp_path: Path, change: Callable[[Path], None]) -> None:
    path = tmp_path / "a.db"
    work = Feeding(SqliteHistory(sqlite=str(path), keep=1000 * SECOND, at=NOWHERE))
    work.put(1, 2)
    change(path)
    work.put(3, 4)
    assert _history(path) == [3, 4]
    work.feeder.stop()
    assert not list(tmp_path.glob("*-wal"))
    assert _history(path) == [3, 4]
    moved = tmp_path / "moved-a.db"
    assert not moved.exists() or _history(moved) == [1, 2], "also what only its log had"
    assert work.lines[0] == f"sink sqlite {path}: {MOVED}"


def test_a_history_moved_after_its_last_row_is_complete(tmp_path: Path) -> None:
    path = tmp_path / "a.db"
    work = Feeding(SqliteHistory(sqlite=str(path), at=NOWHERE))
    work.put(1, 2)
    _move(path)
    work.feeder.stop()
    assert names(tmp_path) == ["a.db.lock", "moved-a.db"]
    assert _history(tmp_path / "moved-a.db") == [1, 2]


def test_rows_of_a_parquet_file_outlast_their_deleted_file(tmp_path: Path) -> None:
    path = tmp_path / "a.parquet"
    sink = sink_of(path)
    sink.open(TYPED_POINTS)
    sink.write([typed_sample(0, {"count": 1}), typed_sample(1, {"count": 2})])
    (tmp_path / "a.parquet.part").unlink()
    sink.write([typed_sample(2, {"count": 3})])
    (tmp_path / "a.parquet.part").unlink()
    sink.close()
    assert sorted(
        row[3] for name in names(tmp_path) if name.endswith(".parquet") for row in rows_of(tmp_path / name)
    ) == [1, 2, 3]


# ---- stores -----------------------------------------------------------------------------------------------


def _store(path: Path, changes: list[str]) -> Store:
    store = Store(path, 4, changes.append)
    store.open()
    return store


@pytest.mark.parametrize("change", [_move, Path.unlink, _move_and_create])
def test_samples_outlast_their_deleted_store(tmp_path: Path, change: Callable[[Path], None]) -> None:
    path, changes = tmp_path / "a.db", list[str]()
    samples = [sample(at, value=at) for at in range(5)]
    store = _store(path, changes)
    store.add(samples[:3])
    start, sent = store.first(1)
    change(path)
    store.add(samples[3:4])
    store.done(start, len(sent))
    assert changes == [MOVED] and store.first(9)[1] == samples[1:4]
    path.unlink()
    store.close()
    again = _store(path, changes)
    assert again.first(9)[1] == samples[1:4] and changes == [MOVED, MOVED], "a store is complete at the end of a run"
    again.close()


def test_another_store_at_the_path_is_left_alone(tmp_path: Path) -> None:
    path, other, changes = tmp_path / "a.db", tmp_path / "b.db", list[str]()
    mine, theirs = _store(path, changes), _store(other, changes)
    mine.add([sample(1)])
    theirs.add([sample(2), sample(3)])
    theirs.close()
    other.replace(path)
    for _ in range(2):
        with pytest.raises(StoreError, match="was replaced"):
            mine.add([sample(4)])
    assert mine.first(9)[1] == [sample(1)], "the open file is used on"
    with pytest.raises(StoreError):
        mine.close()
    assert mine.dropped.samples == 1 and mine.dropped.points == {"level": 1}
    assert _samples(path) == [sample(2), sample(3)]


def _samples(path: Path) -> Sequence[object]:
    store = _store(path, [])
    try:
        return store.first(9)[1]
    finally:
        store.close()


# ---- state and captures -----------------------------------------------------------------------------------

SHAPE = (("M", "word", 4096),)


def _kept(*words: tuple[int, int]) -> KeptRun:
    memory = bytearray(8192)
    for at, word in words:
        memory[2 * at : 2 * at + 2] = word.to_bytes(2, "little")
    return KeptRun({"M": bytes(memory)}, {})


def _state(path: Path) -> KeptRun:
    with closing(StateFile(path, "plant", SHAPE)) as file:
        return file.kept


@pytest.mark.parametrize("change", [_move, Path.unlink, _move_and_create])
def test_the_whole_state_goes_to_a_new_file(tmp_path: Path, change: Callable[[Path], None]) -> None:
    path = tmp_path / "plant.state"
    with closing(StateFile(path, "plant", SHAPE)) as file:
        file.save(_kept((1, 5), (3000, 7)))
        change(path)
        assert file.follow_path() == MOVED
        file.save(_kept((1, 6), (3000, 7)))
        assert file.follow_path() == ""
    assert _state(path) == _kept((1, 6), (3000, 7))
    moved = tmp_path / "moved-plant.state"
    assert not moved.exists() or _state(moved) == _kept((1, 5), (3000, 7))


def test_a_state_that_was_put_there_is_replaced_by_the_present(tmp_path: Path) -> None:
    path, copy = tmp_path / "plant.state", tmp_path / "copy"
    with closing(StateFile(path, "plant", SHAPE)) as file:
        with closing(StateFile(copy, "plant", SHAPE)) as other:
            other.save(_kept((2000, 9)))
        file.save(_kept((1, 5)))
        copy.replace(path)
        assert file.follow_path() == REPLACED
        file.save(_kept((1, 6)))
    assert _state(path) == _kept((1, 6))


STATE_RUN = """
run: plant
memory: masterlogic
state: {file: a.state, every: 1 s}
channels:
  1: {port: "sim:meter.device.yaml", protocol: modbus-tcp, station: 1}
"""


def test_a_deleted_state_is_written_again_though_it_has_not_changed(tmp_path: Path) -> None:
    run_file(tmp_path)
    (tmp_path / "a.run.yaml").write_text(STATE_RUN)
    reports: list[TroubleReport] = []
    run = VirtualRun(tmp_path / "a.run.yaml")
    run.watch_troubles(reports.append)
    run.start()
    run.run_for(3)
    (tmp_path / "a.state").unlink()
    run.run_for(3)
    run.stop()
    assert (tmp_path / "a.state").exists()
    assert [report.text for report in reports] == [f"state {tmp_path}/a.state: {MOVED}"]


@pytest.mark.parametrize("name", ["a.pcap", "a.jsonl"])
@pytest.mark.parametrize("change", [_move, Path.unlink, _move_and_create, _cut])
@pytest.mark.parametrize("later", [False, True])
def test_a_capture_begins_anew_with_its_head(
    tmp_path: Path, name: str, change: Callable[[Path], None], later: bool
) -> None:
    path, lines = tmp_path / name, list[str]()
    clock = VirtualClock()
    troubles = Troubles(clock.now)
    troubles.listen(lambda report: lines.append(report.text))
    capture = Capture(path, (1,), clock, troubles, later=later)
    capture.write(1, LineEvent("data", 1, "in", b"one"))
    if later:
        queue = capture._sinks[1]._queue  # type: ignore[union-attr]
        with queue.change:
            assert queue.change.wait_for(lambda: not queue.waiting, timeout=60)
    change(path)
    capture.write(1, LineEvent("data", 2, "in", b"two"))
    capture.close()
    with CaptureReader(path) as found:
        assert [event.data for _, event in found.events() if event.kind == "data"] == [b"two"]
    assert lines == [f"capture {path}: {CUT if change is _cut else MOVED}"]


def test_a_pipe_never_changes(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    assert OpenedFile(tmp_path / "pipe").change(100) == ""


# ---- a run ------------------------------------------------------------------------------------------------


def test_a_run_reports_moved_files_and_loses_no_value(tmp_path: Path) -> None:
    path = run_file(tmp_path, "{csv: a.csv, every: 1 s}", "{sqlite: a.db, every: 1 s}")
    reports: list[TroubleReport] = []
    run = VirtualRun(path)
    run.watch_troubles(reports.append)
    run.start()
    run.run_for(5)
    before = len(lines_of(tmp_path / "a.csv")) - 1
    _move(tmp_path / "a.csv")
    (tmp_path / "a.db").unlink()
    run.run_for(10)
    run.stop()
    after = len(lines_of(tmp_path / "a.csv")) - 1
    with closing(sqlite3.connect(tmp_path / "a.db")) as database:
        assert database.execute("SELECT count(*) FROM history").fetchone() == (2 * after,)
    assert before + after == 15 and before in (4, 5) and not run.lost
    assert sorted(report.text for report in reports) == [
        f"sink csv {tmp_path}/a.csv: {MOVED}", f"sink sqlite {tmp_path}/a.db: {MOVED}",
    ]  # fmt: skip
