"""Sinks: files and histories of values, complete after crashes, in order, and without delaying a line."""

from __future__ import annotations

import csv
import errno
import json
import os
import sqlite3
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, cast

import pytest

from framekit.api.run import Run, VirtualRun, loaded
from framekit.definition.keys import key
from framekit.definition.problems import NOWHERE, DefinitionError
from framekit.link.addresses import Address
from framekit.link.packing import Typed
from framekit.run.block_state import Failure
from framekit.run.model import OwnPlace, Point
from framekit.run.points import PointValue, iso_time
from framekit.run.trouble import TroubleReport
from framekit.runfile.schema_files import read_files
from framekit.service import sinks as at_work
from framekit.service import waiting
from framekit.service.points import PointService
from framekit.service.sinks import SinkFeeder, SinkHost
from framekit.sinks import SINKS, Sink, SinkKind
from framekit.sinks.base import FILE, Sampled
from framekit.sinks.files import CsvFile, JsonLines
from framekit.sinks.sqlite import HistoryError, SqliteHistory, read_history
from framekit.transport.clock import Clock

SECOND = 1_000_000_000
START = 1_772_366_400 * SECOND  # 2026-03-01T12:00:00Z


def point(name: str, unit: str = "") -> Point:
    place = OwnPlace(address=Address("M", "word", 0, "M0", {}), text="M0")
    return Point(
        name=name, form=Typed("word", None, None, 1, 1, "word"), place=place, address="M0", unit=unit, at=NOWHERE
    )


POINTS = [point("level", "m"), point("state")]


def sample(seconds: float, name: str = "level", value: Any = 1.5, quality: Any = "good", reason: str = "") -> Sampled:
    time = START + round(seconds * SECOND)
    return Sampled(time, (PointValue(name, value, quality, reason, time),))


def lines_of(path: Path) -> list[str]:
    return path.read_text("utf-8").splitlines()


def taken(sink: Sink, samples: Sequence[Sampled], points: Sequence[Point] = POINTS) -> None:
    """Write all samples, in as many calls as the sink needs."""
    sink.open(points)
    rest = list(samples)
    while rest:
        rest = rest[sink.write(rest) :]
    sink.close()


# ---- files ------------------------------------------------------------------------------------------------------


def test_a_line_for_each_value(tmp_path: Path) -> None:
    path = tmp_path / "rows.csv"
    taken(
        CsvFile(csv=str(path), at=NOWHERE).make(),
        [sample(0), sample(0.25, "state", 'a "b", c'), sample(1, value=2, quality="failed", reason="no_reply")],
    )
    assert lines_of(path) == [
        "time,point,value,unit,quality,reason",
        "2026-03-01T12:00:00.000Z,level,1.5,m,good,",
        '2026-03-01T12:00:00.250Z,state,"a ""b"", c",,good,',
        "2026-03-01T12:00:01.000Z,level,,m,failed,no_reply",
    ]


def test_a_column_for_each_point(tmp_path: Path) -> None:
    path = tmp_path / "columns.csv"
    both = (PointValue("level", 1, "good", "", START), PointValue("state", "on", "stale", "old", START))
    taken(CsvFile(csv=str(path), every=SECOND, at=NOWHERE).make(), [Sampled(START, both), sample(1, value=2)])
    assert lines_of(path) == [
        "time,level (m),state",
        "2026-03-01T12:00:00.000Z,1,",
        "2026-03-01T12:00:01.000Z,2,",
    ]


def test_an_object_for_each_value(tmp_path: Path) -> None:
    path = tmp_path / "values.jsonl"
    taken(JsonLines(jsonl=str(path), at=NOWHERE).make(), [sample(0), sample(1, "state", "on", "stale", "old")])
    assert [json.loads(line) for line in lines_of(path)] == [
        {"time": "2026-03-01T12:00:00.000Z", "point": "level", "value": 1.5, "unit": "m", "quality": "good"},
        {"time": "2026-03-01T12:00:01.000Z", "point": "state", "value": None, "quality": "stale", "reason": "old"},
    ]


@pytest.mark.parametrize("cut", range(1, 44))
def test_what_a_crash_has_cut_is_taken_away(tmp_path: Path, cut: int) -> None:
    path = tmp_path / "rows.csv"
    sink = CsvFile(csv=str(path), at=NOWHERE)
    taken(sink.make(), [sample(0), sample(1)])
    whole = path.read_bytes()
    path.write_bytes(whole[:-cut])
    taken(sink.make(), [sample(2)])
    rows = list(csv.DictReader(lines_of(path)))
    assert [row["time"][17:19] for row in rows] == ["00", "02"]
    assert {row["value"] for row in rows} == {"1.5"}


def test_a_file_with_another_head_is_put_aside(tmp_path: Path) -> None:
    path = tmp_path / "columns.csv"
    taken(CsvFile(csv=str(path), at=NOWHERE).make(), [sample(0)])
    taken(CsvFile(csv=str(path), form="columns", at=NOWHERE).make(), [sample(1)])
    assert sorted(path.name for path in tmp_path.iterdir()) == ["columns.20260301T120000.csv", "columns.csv"]
    assert len(lines_of(path)) == 2


def test_full_files_get_a_name_of_their_own_and_few_are_kept(tmp_path: Path) -> None:
    path = tmp_path / "rows.csv"
    taken(CsvFile(csv=str(path), rotate=150, keep=3, at=NOWHERE).make(), [sample(60 * number) for number in range(21)])
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == ["rows.20260301T121400.csv", "rows.20260301T121600.csv", "rows.20260301T121800.csv", "rows.csv"]
    times = [row["time"][14:16] for name in names for row in csv.DictReader(lines_of(tmp_path / name))]
    assert times == ["14", "15", "16", "17", "18", "19", "20"]
    assert all((tmp_path / name).stat().st_size <= 150 for name in names)


def test_a_new_file_each_day_also_after_a_restart(tmp_path: Path) -> None:
    path, sink = tmp_path / "rows.csv", CsvFile(csv=str(tmp_path / "rows.csv"), rotate="day", at=NOWHERE)
    taken(sink.make(), [sample(0), sample(13 * 3600)])
    taken(sink.make(), [sample(14 * 3600), sample(37 * 3600)])
    assert [
        len(lines_of(tmp_path / name)) - 1 for name in ("rows.20260301T120000.csv", "rows.20260302T010000.csv")
    ] == [1, 2]
    assert len(lines_of(path)) == 2


def test_a_full_disk_leaves_whole_lines(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "rows.csv"
    sink = CsvFile(csv=str(path), at=NOWHERE).make()
    sink.open(POINTS)
    assert sink.write([sample(0)]) == 1
    whole = path.read_bytes()
    write = os.write
    monkeypatch.setattr("framekit.sinks.files.os.write", lambda file, data: write(file, bytes(data)[:10]))
    with pytest.raises(OSError, match="the disk is full"):
        sink.write([sample(1)])
    assert path.read_bytes() == whole
    monkeypatch.undo()
    assert sink.write([sample(1)]) == 1
    assert len(lines_of(path)) == 3
    sink.close()


# ---- SQLite -----------------------------------------------------------------------------------------------------


def test_a_history_is_read_by_point_and_time(tmp_path: Path) -> None:
    path = tmp_path / "history.db"
    kind = SqliteHistory(sqlite=str(path), at=NOWHERE)
    taken(kind.make(), [sample(0), sample(1, "state", "on"), sample(2, value=3)])
    taken(kind.make(), [sample(3, value=4, quality="failed", reason="no_reply")])
    rows = list(read_history(path))
    assert [(row.point, row.value, row.unit, row.quality) for row in rows] == [
        ("level", 1.5, "m", "good"),
        ("state", "on", "", "good"),
        ("level", 3, "m", "good"),
        ("level", None, "m", "failed"),
    ]
    assert [row.value for row in read_history(path, ["le*"], since=START + SECOND, until=START + 2 * SECOND)] == [3]
    assert list(read_history(path, ["l[e]vel"])) == []
    with sqlite3.connect(path) as database:
        assert database.execute("PRAGMA journal_mode").fetchone() == ("wal",)


def test_old_values_are_taken_out(tmp_path: Path) -> None:
    path = tmp_path / "history.db"
    kind = SqliteHistory(sqlite=str(path), keep=3600 * SECOND, at=NOWHERE)
    taken(kind.make(), [sample(0), sample(1800)])
    taken(kind.make(), [sample(4000)])
    assert [row.time for row in read_history(path)] == [START + 1800 * SECOND, START + 4000 * SECOND]


def test_a_file_of_something_else_is_left_alone(tmp_path: Path) -> None:
    text, other = tmp_path / "text.db", tmp_path / "other.db"
    text.write_text("no database, but long enough to be looked at\n" * 40)
    with sqlite3.connect(other) as database:
        database.execute("CREATE TABLE mine (a)")
    for path, why in ((text, "is no database"), (other, "is a database of something else")):
        before = path.read_bytes()
        with pytest.raises(HistoryError, match=why):
            SqliteHistory(sqlite=str(path), at=NOWHERE).make().open(POINTS)
        assert path.read_bytes() == before
    with pytest.raises(HistoryError, match="has the run been started"):
        list(read_history(tmp_path / "none.db"))


@pytest.mark.parametrize("kind", [CsvFile(csv="a", at=NOWHERE), SqliteHistory(sqlite="a", at=NOWHERE)])
def test_two_processes_do_not_write_one_file(kind: SinkKind, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    first, second = kind.make(), kind.make()  # a lock belongs to an opened file, not to a process
    first.open(POINTS)
    before = Path("a").read_bytes()
    with pytest.raises(BlockingIOError, match="another process writes there"):
        second.open(POINTS)
    second.close()
    assert Path("a").read_bytes() == before
    first.close()
    taken(second, [sample(0)])


# ---- in a run ---------------------------------------------------------------------------------------------------

DEVICE = """device: meter
protocol: modbus-tcp
station: 1
memory: {set: {"40001": [217, 2]}}
"""
RUN = """run: plant
channels:
  1: {port: "sim:meter.device.yaml", protocol: modbus-tcp, station: 1}
points:
  temperature: {channel: 1, address: "40001", scale: 0.1, unit: °C}
  state: {channel: 1, address: "40002", enum: {0: off, 2: heating}}
sinks:
"""


def run_file(folder: Path, *sinks: str) -> Path:
    (folder / "meter.device.yaml").write_text(DEVICE, "utf-8")
    path = folder / "plant.run.yaml"
    path.write_text(RUN + "".join(f"  - {sink}\n" for sink in sinks), "utf-8")
    return path


def test_a_run_fills_its_sinks(tmp_path: Path) -> None:
    sinks = (
        "{csv: every.csv, every: 2 s}", "{jsonl: changes.jsonl, points: temp*}", "{sqlite: history.db, keep: 1 d}",
    )  # fmt: skip
    run = VirtualRun(run_file(tmp_path, *sinks))
    run.run_for("2500 ms")
    run.device("meter").write("40001", [220, 0])
    run.run_for("4 s")
    run.stop()
    assert lines_of(tmp_path / "every.csv") == [
        "time,temperature (°C),state",
        "2000-01-01T00:00:02.000Z,21.7,heating",
        "2000-01-01T00:00:04.000Z,22.0,off",
        "2000-01-01T00:00:06.000Z,22.0,off",
    ]
    assert [json.loads(line)["value"] for line in lines_of(tmp_path / "changes.jsonl")] == [21.7, 22.0]
    assert [row.value for row in read_history(tmp_path / "history.db")] == [21.7, "heating", 22.0, "off"]
    assert run.problems == []


def test_a_sink_in_real_time_has_everything_at_the_end(tmp_path: Path) -> None:
    report = threading.Event()
    run = Run(run_file(tmp_path, "{jsonl: values.jsonl}"))
    run.points.watch(lambda value: report.set())
    with run:
        assert report.wait(10)
    assert len(lines_of(tmp_path / "values.jsonl")) == 2


def test_a_run_does_not_start_without_its_files(tmp_path: Path) -> None:
    """Each sink that cannot write is reported with its place; the files of the others are left for another run."""
    (tmp_path / "taken").write_text("")
    (tmp_path / "folder").mkdir()
    (tmp_path / "text.db").write_text("no database\n" * 100)
    path = run_file(
        tmp_path, "{csv: taken/values.csv}", "{jsonl: values.jsonl}", "{jsonl: folder}", "{sqlite: text.db}",
        '{mqtt: "127.0.0.1:1", store: taken/a.db}',
    )  # fmt: skip
    for _ in range(2):
        run = VirtualRun(path)
        with pytest.raises(DefinitionError) as error:
            run.start()
        assert not run.running
        run.stop()
        assert [str(problem).partition(f"{path}:")[2] for problem in error.value.problems] == [
            f"8:5: {tmp_path}/taken/values.csv cannot be opened and written: {tmp_path}/taken is no folder – "
            "check the path, or name another file",
            f"10:5: {tmp_path}/folder is a folder – move it away, or name another file",
            f"11:5: {tmp_path}/text.db is no database – name another file",
            f"12:5: {tmp_path}/taken/a.db cannot be opened and written: {tmp_path}/taken is no folder – "
            "check the path, or name another file",
        ]


def test_a_missing_folder_is_an_error_at_the_start(tmp_path: Path) -> None:
    """The folder is not created: it may be the mount point of a disk."""
    path = run_file(tmp_path, "{csv: log/a.csv}", "{sqlite: log/a.db}", '{mqtt: "127.0.0.1:1", store: log/b.db}')
    run = VirtualRun(path)
    with pytest.raises(DefinitionError) as error:
        run.start()
    run.stop()
    assert not (tmp_path / "log").exists()
    assert [str(problem).partition(f"{path}:")[2] for problem in error.value.problems] == [
        f"{line}:5: {tmp_path}/log/{name} cannot be opened and written: the folder {tmp_path}/log does not exist – "
        "make the folder, or name another file"
        for line, name in ((8, "a.csv"), (9, "a.db"), (10, "b.db"))
    ]


def test_a_file_that_cannot_be_written_later_is_told_at_once_and_when_it_is_well(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:  # fmt: skip
    reports: list[TroubleReport] = []
    run = VirtualRun(run_file(tmp_path, "{csv: every.csv, every: 1 s}"))
    run.watch_troubles(reports.append)
    run.run_for("1500 ms")
    with monkeypatch.context() as patch:
        patch.setattr("framekit.sinks.files.os.write", full)
        run.run_for("3 s")
        name = f"sink csv {tmp_path}/every.csv"
        assert [(report.event, report.text) for report in reports] == [
            (
                "begins",
                f"{name}: No space left on device – make room there; 1 sample waits, "
                "the oldest are dropped from 100,000 on",
            )
        ]
        status = run.status()
        assert [(trouble.name, trouble.reason, trouble.waiting, trouble.lost) for trouble in status.troubles] == [
            (name, "No space left on device", 3, 0)
        ]
        assert run.problems == [f"{name}: No space left on device, 3 samples wait"]
        assert status.sinks[0].problem == "No space left on device"
    run.run_for("1 s")
    run.stop()
    assert [report.text for report in reports[1:]] == [f"{name}: works again after 3.0 s, no sample was lost"]
    assert (run.problems, run.status().troubles) == ([], ())
    assert [line[17:19] for line in lines_of(tmp_path / "every.csv")[1:]] == ["01", "02", "03", "04", "05"]


def test_what_is_lost_at_the_end_is_told_by_point(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run = VirtualRun(run_file(tmp_path, "{csv: changes.csv}"))
    run.start()
    monkeypatch.setattr("framekit.sinks.files.os.write", full)
    run.run_for("1500 ms")
    run.device("meter").write("40001", [220])
    run.run_for("1500 ms")
    run.stop()
    name = f"sink csv {tmp_path}/changes.csv"
    assert run.problems == [f"{name}: No space left on device, 3 samples were lost (temperature 2, state 1)"]
    assert run.troubles[0].points == {"temperature": 2, "state": 1}


def full(file: int, data: bytes) -> int:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.mark.parametrize(
    ("sink", "problem"),
    [
        ("{tsv: a.csv}", "unknown key 'tsv' in a sink – did you mean 'csv'?"),
        (
            "{every: 1 s}",
            "a sink has no kind – add one of csv, jsonl, sqlite, parquet, prometheus, mqtt, sparkplug, influx, …",
        ),
        ("{csv: a.csv, jsonl: b}", "a sink has more than one kind: 'csv' and 'jsonl' – keep one"),
        ("{csv: a.csv, every: 10 ms}", "values are taken every 100 ms at most – leave every out, or write 1 s"),
        ("{csv: a.csv, every: never}", "no value would ever be taken – leave every out, or write 1 s"),
        ("{csv: a.csv, keep: 3}", "'keep' has no effect: there is one file, and nothing before it – add rotate: day"),
        ("{jsonl: a, keep: 0, rotate: day}", "nothing would be kept – give 1 or more, or leave keep out"),
        ("{sqlite: a, keep: never}", "'keep: never' has no effect: without keep values stay for ever – remove it"),
        ("{csv: a.csv, points: tmp}", "no point is called 'tmp' – known: state, temperature"),
        ("{csv: a.csv, rotate: week}", "'week' is not day, hour, or a size (10 MB)"),
        ("{sqlite: a.db, keep: 5}", "'5' is not a time (50 ms, 3 s or never)"),
        ("{sqlite: a.db, rotate: day}", "unknown key 'rotate' in a sqlite sink – known: every, keep, points, sqlite"),
    ],
)
def test_what_is_wrong_with_a_sink(tmp_path: Path, sink: str, problem: str) -> None:
    with pytest.raises(DefinitionError) as error:
        loaded(run_file(tmp_path, sink))
    assert [str(problem).partition(": ")[2] for problem in error.value.problems] == [problem]


def test_two_sinks_have_two_files(tmp_path: Path) -> None:
    with pytest.raises(DefinitionError, match="is the file of a sink in line 8 already"):
        loaded(run_file(tmp_path, "{csv: a.csv}", "{jsonl: b/../a.csv}"))


# ---- a sink of another kind ---------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class Remembered(SinkKind):
    """A sink whose values the test inspects."""

    word: ClassVar[str] = "remembered"
    remembered: str = key("remembered", FILE, "Where they would go.")
    sinks: ClassVar[list[Remembering]] = []

    @property
    def target(self) -> str:
        return self.remembered

    def make(self) -> Sink:
        self.sinks.append(Remembering())
        return self.sinks[-1]


class Remembering(Sink):
    """A sink that accepts two samples at once; `on_write` may raise or wait."""

    def __init__(self) -> None:
        self.taken: list[Sampled] = []
        self.on_write: Callable[[], None] = lambda: None

    def open(self, points: Sequence[Point]) -> None: ...

    def write(self, samples: Sequence[Sampled]) -> int:
        self.on_write()
        self.taken += samples[:2]
        return len(samples[:2])

    def close(self) -> None: ...


def feeder(threaded: bool) -> tuple[SinkFeeder, Remembering]:
    found = SinkFeeder(Remembered(remembered="there", at=NOWHERE), POINTS, threaded)
    return found, Remembered.sinks[-1]


def test_what_fails_is_tried_again_in_order() -> None:
    one, sink = feeder(threaded=False)
    one.start()
    tries = iter([None, OSError("gone"), None])

    def fail() -> None:
        error = next(tries, None)
        if error is not None:
            raise error

    sink.on_write = fail
    samples = [sample(number, value=number) for number in range(5)]
    for each in samples:
        one.put(each)
    assert sink.taken == samples
    assert (one.status.written, one.status.waiting, one.status.dropped, one.status.problem) == (5, 0, 0, "")
    one.stop()


def test_an_error_of_the_queue_is_a_trouble_of_its_sink(monkeypatch: pytest.MonkeyPatch) -> None:
    one, sink = feeder(threaded=False)
    one.start()

    def fails(most: int) -> tuple[int, list[Sampled]]:
        raise RuntimeError("a defect")

    with monkeypatch.context() as broken:
        broken.setattr(one._waiting, "first", fails)
        one.put(sample(0, value=0))
    assert one.status.problem == "a defect"
    one.put(sample(1, value=1))
    assert (len(sink.taken), one.status.problem) == (2, "")
    one.stop()


def test_a_sink_that_hangs_holds_nothing_up_and_the_oldest_go_first(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(waiting, "MOST_WAITING", 10)
    monkeypatch.setattr(at_work, "AT_ONCE", 4)
    one, sink = feeder(threaded=True)
    hangs, goes_on = threading.Event(), threading.Event()

    def hang() -> None:
        hangs.set()
        assert goes_on.wait(10)

    sink.on_write = hang
    one.start()
    one.put(sample(0, value=0))
    assert hangs.wait(10)
    for number in range(1, 30):
        one.put(sample(number, value=number))
    assert one.status.waiting == 10
    goes_on.set()
    one.stop()
    values = [each.values[0].value for each in sink.taken]
    assert values == [0, *range(20, 30)]
    assert (one.status.written, one.status.dropped) == (11, 19)


def test_a_sink_that_fails_has_its_pause_and_a_last_try(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(at_work, "LONGEST_WAIT", 0.05)
    one, sink = feeder(threaded=True)
    tries: list[int] = []
    third = threading.Event()

    def fail() -> None:
        tries.append(len(tries))
        if len(tries) == 3:
            third.set()
        if len(tries) < 4:
            raise OSError(28, "No space left on device")

    sink.on_write = fail
    one.start()
    for number in range(6):
        one.put(sample(number, value=number))
    assert third.wait(10)
    assert one.status.problem == "No space left on device"
    one.stop()
    assert [each.values[0].value for each in sink.taken] == [0, 1, 2, 3, 4, 5]


@pytest.mark.parametrize("taken", [None, 0, 7, "two"])
def test_a_sink_that_does_not_say_how_much_it_took_has_failed(taken: Any) -> None:
    one, sink = feeder(threaded=False)
    sink.write = lambda samples: taken  # type: ignore[method-assign]
    one.start()
    one.put(sample(0))
    assert one.status.problem == f"write took {taken!r} of 1 samples"
    one.stop()
    assert one.status.dropped == 1


def test_an_answer_that_cannot_be_told_is_logged(caplog: pytest.LogCaptureFixture) -> None:
    class Points:
        def write(self, point: str, value: Any, who: str, told: Callable[[Failure | None], None]) -> None:
            if value == "much":
                raise ValueError("'much' is no number")
            told(None)

    def report(why: str) -> None:
        raise RecursionError(f"too deep, {why or 'well'}")

    host = SinkHost("plant", cast(Clock, None), cast(PointService, Points()))
    for value in ("much", 5):
        host.write("level", value, "anna", report)
    lost = [record.getMessage() for record in caplog.records if "lost" in record.getMessage()]
    head = "point level: the answer to anna is lost: too deep, "
    assert lost == [head + "'much' is no number", head + "well"]


def test_numbers_beyond_sqlite_are_kept_as_texts(tmp_path: Path) -> None:
    path = tmp_path / "history.db"
    taken(SqliteHistory(sqlite=str(path), at=NOWHERE).make(), [sample(0, value=1 << 63), sample(1, value=-(1 << 63))])
    assert [row.value for row in read_history(path)] == [str(1 << 63), -(1 << 63)]


def test_a_line_end_in_a_text_does_not_end_the_line(tmp_path: Path) -> None:
    path = tmp_path / "rows.csv"
    taken(CsvFile(csv=str(path), at=NOWHERE).make(), [sample(0, value="a\nb\r")])
    assert lines_of(path)[1:] == ["2026-03-01T12:00:00.000Z,level,a\\nb\\r,m,good,"]


@pytest.mark.parametrize("name", ["plant.run.yaml", "kept.db"])
def test_files_of_the_run_itself_are_no_sinks(tmp_path: Path, name: str) -> None:
    path = run_file(tmp_path, f"{{sqlite: {name}}}")
    path.write_text(
        path.read_text("utf-8")
        + 'state: {file: kept.db}\nmemory: masterlogic\nblocks: {0: {read: "40001", into: M0, every: 1 s}}\n',
        "utf-8",
    )
    with pytest.raises(DefinitionError, match=r"is a name of definitions|is where the state is kept already"):
        loaded(path)


def test_the_times_of_files_are_iso_8601() -> None:
    assert iso_time(START + 250_999_999) == "2026-03-01T12:00:00.250Z"


def test_schemas_have_every_kind() -> None:
    schema = read_files(Path(__file__).parents[2] / "schemas")["run.schema.json"]["$defs"]
    assert {f"{word}_sink" for word in SINKS} <= schema.keys()
