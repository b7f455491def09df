"""Trouble of a run: one line when it begins, when data are lost and when it ends, and the same in status and JSON."""

from __future__ import annotations

import errno
import json
import os
from pathlib import Path
from typing import Any, cast

import pytest
from points.test_sinks import run_file

from framekit.api.rows import trouble_row
from framekit.api.run import VirtualRun
from framekit.cli.main import main
from framekit.run.trouble import (
    AT_ONCE,
    Dropped,
    SampleCount,
    Trouble,
    TroubleReport,
    Troubles,
    lasted,
    listed_troubles,
)
from framekit.service.capture import _Sink
from framekit.sinks.files import CsvColumns

SECOND = 1_000_000_000


class FullDisk:
    """A disk without room for the writes whose numbers, from 1 on, are in `full`."""

    def __init__(self, full: range) -> None:
        self.full = full
        self.writes = 0
        self._write = os.write

    def __call__(self, file: int, data: bytes) -> int:
        self.writes += 1
        if self.writes in self.full:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return self._write(file, data)


def test_each_event_is_reported_once() -> None:
    time = 0
    reports: list[tuple[str, str]] = []
    troubles = Troubles(lambda: time)
    count = SampleCount()
    source = troubles.source("sink csv a.csv", lambda: "values wait", lambda: count)
    source.begins("No space left on device")
    troubles.listen(lambda report: reports.append((report.event, report.text)))
    assert reports == [("begins", "sink csv a.csv: No space left on device – make room there; values wait")]
    time = 90 * SECOND
    source.begins("Input/output error")
    assert [trouble.reason for trouble in troubles.present()] == ["Input/output error"] and len(reports) == 1
    count = SampleCount(3, 2, {"level": 2})
    source.loses("too many wait")
    source.loses("too many wait")
    source.ends()
    source.ends()
    assert reports[1:] == [
        ("loses", "sink csv a.csv: too many wait"),
        ("ends", "sink csv a.csv: works again after 90 s, 2 samples were lost (level 2)"),
    ]
    (left,) = troubles.present()
    assert str(left) == "sink csv a.csv: 2 samples were lost (level 2)"
    assert trouble_row(left, time) == (
        "sink csv a.csv", "-", "3", "2 samples were lost (level 2)", "works again"
    )  # fmt: skip
    source.begins("gone")
    source.loses("too many wait")
    assert [event for event, _ in reports[3:]] == ["begins", "loses"], "another trouble is reported anew"


@pytest.mark.parametrize("error", [BrokenPipeError, ValueError("I/O operation on closed file")])
def test_a_listener_may_report_itself_and_may_have_gone(error: Exception) -> None:
    troubles = Troubles(lambda: 0)
    heard: list[str] = []

    def listen(report: TroubleReport) -> None:
        heard.append(report.text)
        if len(heard) == 1:
            troubles.note("clock", "second")
            assert heard == ["clock: first"]
        raise error

    troubles.listen(listen)
    troubles.note("clock", "first")
    troubles.note("clock", "third")
    assert heard == ["clock: first", "clock: second", "clock: third"]


def test_a_dropped_sample_that_arrives_does_not_count() -> None:
    dropped = Dropped()
    dropped.sending(2)
    for number in range(4):
        dropped.drop(number, ["level", "state"])
    assert (dropped.samples, dropped.points) == (4, {"level": 4, "state": 4})
    dropped.confirmed(1)
    assert (dropped.samples, dropped.points) == (3, {"level": 3, "state": 3})
    dropped.sending(6)
    dropped.confirmed(6)
    assert dropped.samples == 3, "the second was dropped, and its attempt had failed"


def test_many_points_are_counted_not_named() -> None:
    names = {f"p{number}": 9 - number for number in range(8)}
    trouble = Trouble(name="sink csv a", reason="", since=0, waiting=0, lost=1, points=names)
    assert trouble.loss == "1 sample was lost (p0 9, p1 8, p2 7, p3 6, p4 5, and 3 more points)"


@pytest.mark.parametrize(
    ("time", "text"),
    [(0.04, "0.0 s"), (9.9, "9.9 s"), (12.3, "12 s"), (119, "119 s"), (600, "10 min"), (3 * 3600, "3 h")],
)
def test_durations(time: float, text: str) -> None:
    assert lasted(round(time * SECOND)) == text


def test_many_troubles_at_once_are_joined() -> None:
    time = 0
    reports: list[tuple[str, str]] = []
    troubles = Troubles(lambda: time)
    troubles.listen(lambda report: reports.append((report.event, report.text)))
    counts = [SampleCount(0, 2, {"level": 2, f"point {number}": 1}) for number in range(500)]
    sources = [
        troubles.source(f"sink csv {number}.csv", lambda: "samples wait", lambda number=number: counts[number])
        for number in range(500)
    ]
    for number, source in enumerate(sources):
        source.begins("Input/output error" if number % 10 == 9 else "No space left on device")
    assert len(reports) == AT_ONCE, "the first, at once"
    assert reports[0] == ("begins", "sink csv 0.csv: No space left on device – make room there; samples wait")
    troubles.flush()
    assert len(reports) == AT_ONCE
    time += 10 * SECOND
    troubles.flush()
    assert reports[AT_ONCE:] == [(
        "begins",
        "480 more are in trouble: No space left on device; Input/output error – sink csv 20.csv, sink csv 21.csv, "
        "sink csv 22.csv, sink csv 23.csv, sink csv 24.csv, …",
    )]  # fmt: skip
    lines = listed_troubles(troubles.present())
    assert len(lines) == AT_ONCE + 1
    assert lines[-1] == (
        "480 more parts: No space left on device; Input/output error, 960 samples were lost "
        "(level 960, point 20 1, point 21 1, point 22 1, point 23 1, and 476 more points)"
    )
    del reports[:]
    for source in sources:
        source.ends()
        source.begins("No space left on device")
    assert len(reports) == AT_ONCE
    troubles.flush(at_end=True)
    assert [(event, text.partition(":")[0]) for event, text in reports[AT_ONCE:]] == [
        ("ends", "490 more work again"), ("begins", "490 more are in trouble"),
    ]  # fmt: skip
    time += 60 * SECOND
    sources[7].ends()
    assert len(reports) == AT_ONCE + 3 and reports[-1][1].startswith("sink csv 7.csv: works again"), "one at a time"


def test_joined_losses_keep_their_reasons_and_a_single_report_is_passed_on_unchanged() -> None:
    time = 0
    reports: list[str] = []
    troubles = Troubles(lambda: time)
    troubles.listen(lambda report: reports.append(report.text))
    sources = [troubles.source(f"sink {number}") for number in range(AT_ONCE)]
    for source in sources:
        source.begins("no space left")
    sources[0].loses("the oldest samples are dropped")
    sources[1].loses("a sample is refused")
    troubles.note("channel 1", "its port has another name")
    time += 10 * SECOND
    troubles.flush()
    assert reports[AT_ONCE:] == [
        "2 more lose data: the oldest samples are dropped; a sample is refused – sink 0, sink 1",
        "channel 1: its port has another name",
    ]


@pytest.mark.usefixtures("small_heap")
def test_many_sinks_in_trouble_have_a_bounded_output(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    run = str(run_file(tmp_path, *(f"{{csv: s{number:03}.csv, every: 1 s}}" for number in range(100))))
    monkeypatch.setattr(CsvColumns, "write", _full)
    assert main(["run", run, "--virtual", "--for", "20500ms", "--quiet"]) == 1
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == AT_ONCE + 1 + AT_ONCE + 1
    assert lines[AT_ONCE].startswith(f"80 more are in trouble: No space left on device – sink csv {tmp_path}/s020.csv")
    lost = "1600 samples were lost (temperature 1600, state 1600)"
    assert lines[-1] == f"80 more parts: No space left on device, {lost}"


def _full(sink: Any, samples: Any) -> int:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


# ---- the command line ----------------------------------------------------------------------------------------


@pytest.mark.usefixtures("small_heap")
def test_a_full_disk_is_told_at_once_and_when_it_is_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:  # fmt: skip
    run = str(run_file(tmp_path, "{csv: every.csv, every: 1 s}"))
    monkeypatch.setattr(os, "write", FullDisk(range(4, 6)))
    assert main(["run", run, "--virtual", "--for", "5500ms", "--status-every", "2500ms"]) == 0
    output = capsys.readouterr()
    assert output.err.splitlines() == [
        f"sink csv {tmp_path}/every.csv: No space left on device – make room there; "
        "1 sample waits, the oldest are dropped from 100,000 on",
        f"sink csv {tmp_path}/every.csv: works again after 2.0 s, no sample was lost",
    ]
    shown = output.out.split("status at ")[1]
    assert "trouble" in shown and "No space left on device" in shown.partition("trouble")[2]
    assert "trouble" not in output.out.split("status at ")[2]


@pytest.mark.usefixtures("small_heap")
def test_programs_hear_of_it_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:  # fmt: skip
    run = str(run_file(tmp_path, "{csv: every.csv, every: 1 s}"))
    monkeypatch.setattr(os, "write", FullDisk(range(4, 1000)))
    assert main(["run", run, "--virtual", "--for", "4500ms", "--json", "--status"]) == 1
    rows = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    name = f"sink csv {tmp_path}/every.csv"
    (begun,) = [row for row in rows if row["event"] == "run_trouble"]
    text = f"{name}: No space left on device – make room there; 1 sample waits, the oldest are dropped from 100,000 on"
    assert begun == {
        "event": "run_trouble", "time": 2.0, "what": "begins", "text": text, "name": name,
        "reason": "No space left on device", "waiting": 1, "lost": 0, "points": {},
    }  # fmt: skip
    (status,) = [row for row in rows if row["event"] == "status"]
    assert status["troubles"] == [
        {"name": name, "reason": "No space left on device", "waiting": 3, "lost": 0, "points": {}, "since": 2.0}
    ]
    assert [row["reason"] for row in rows if row["event"] == "warning"] == [
        f"{name}: No space left on device, 3 samples were lost (temperature 3, state 3)"
    ]


@pytest.mark.usefixtures("small_heap")
def test_a_run_that_cannot_write_ends_before_it_starts(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "taken").write_text("")
    run = str(run_file(tmp_path, "{csv: taken/a.csv}", "{sqlite: taken/a.db}"))
    assert main(["run", run, "--for", "1h"]) == 1
    output = capsys.readouterr()
    assert output.out == ""
    assert output.err.splitlines() == [
        f"{run}:{line}:5: {tmp_path}/taken/{file} cannot be opened and written: {tmp_path}/taken is no folder – "
        "check the path, or name another file"
        for line, file in ((8, "a.csv"), (9, "a.db"))
    ]


@pytest.mark.usefixtures("small_heap")
def test_an_empty_state_file_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = run_file(tmp_path, "{csv: a.csv}")
    path.write_text(
        path.read_text("utf-8")
        + 'state: kept.state\nmemory: masterlogic\nblocks: {0: {read: "40001", into: M0, every: 1 s}}\n',
        "utf-8",
    )
    (tmp_path / "kept.state").touch()
    for told in (f"state {tmp_path}/kept.state: the file was empty, memory and counters begin anew\n", ""):
        assert main(["run", str(path), "--virtual", "--for", "1s"]) == 0
        assert capsys.readouterr().err == told


def test_a_capture_ends_with_a_whole_record_and_counts_the_missing_ones(tmp_path: Path) -> None:
    class FullFile:
        closed = False

        def write(self, data: bytes) -> int:
            return len(data) // 2

        def truncate(self, size: int) -> None:
            sizes.append(size)

        def close(self) -> None: ...

    sizes: list[int] = []
    reports: list[str] = []
    path = tmp_path / "line.pcap"
    run = VirtualRun(run_file(tmp_path, "{csv: a.csv}"), capture=path)
    run.watch_troubles(lambda report: reports.append(report.text))
    run.run_for("100 ms")
    capture = run._capture
    assert capture is not None
    (sink,) = capture._sinks.values()
    assert isinstance(sink, _Sink)
    sink._file.close()
    size = path.stat().st_size
    sink._file = cast(Any, FullFile())
    run.run_for("2 s")
    run.stop()
    assert reports == [f"capture {path}: No space left on device – make room there; the capture ends here"]
    assert sizes == [size]
    (problem,) = run.problems
    assert problem.startswith(f"capture {path}: No space left on device, ") and problem.endswith(" records were lost")


def test_a_part_that_fails_at_the_end_says_how_many_samples_wait() -> None:
    troubles = Troubles(lambda: 0)
    troubles.source("sink mqtt plant", count=lambda: SampleCount(18)).begins("Connection refused")
    assert listed_troubles(troubles.present()) == ["sink mqtt plant: Connection refused, 18 samples wait"]
