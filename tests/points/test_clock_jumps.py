"""Jumps of the wall clock: no history loses values, rotated files continue, and the jump is reported."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from points.test_sinks import POINTS, START, run_file, sample

from framekit.api.run import VirtualRun
from framekit.definition.problems import NOWHERE
from framekit.run.points import PointValue, iso_time, nanoseconds_of
from framekit.sinks import Sink
from framekit.sinks.base import Sampled
from framekit.sinks.files import CsvFile
from framekit.sinks.sqlite import CLEANING, SqliteHistory, read_history

SECOND = 1_000_000_000
HOUR, DAY = 3600, 86400
IN_2038 = 2_200_000_000 - START // SECOND


class Clock:
    """The clock of a run for a sink, and the wall clock with an `offset` in seconds."""

    run = "plant"

    def __init__(self) -> None:
        self.time = 1000
        self.offset = 0
        self.reports: list[str] = []

    def now(self) -> int:
        return self.time * SECOND

    def report(self, what: str) -> None:
        self.reports.append(what)

    def sample(self) -> Sampled:
        time = START + (self.time + self.offset) * SECOND
        return Sampled(time, (PointValue("level", self.time, "good", "", time),))

    def write(self, sink: Sink, times: range, offset: int = 0) -> None:
        """Write a value at each of these times of the run's clock."""
        self.offset = offset
        for self.time in times:
            assert sink.write([self.sample()]) == 1


def opened(path: Path, keep: int = HOUR) -> tuple[Any, Clock]:
    sink: Any = SqliteHistory(sqlite=str(path), keep=keep * SECOND, at=NOWHERE).make()
    clock = Clock()
    sink.meet(clock)
    sink.open(POINTS)
    return sink, clock


def kept(path: Path) -> list[Any]:
    return [row.value for row in read_history(path)]


@pytest.mark.parametrize("jump", [DAY, -DAY, IN_2038, -HOUR])
def test_a_jump_removes_nothing(tmp_path: Path, jump: int) -> None:
    path = tmp_path / "history.db"
    sink, clock = opened(path)
    clock.write(sink, range(0, 1800, 60))
    clock.write(sink, range(1800, 3600, 60), jump)
    sink.close()
    assert sorted(kept(path)) == list(range(0, 3600, 60))
    sink, clock = opened(path)
    clock.write(sink, range(5000, 5060, 60))
    assert len(kept(path)) == 61, "at the start of a run nothing is removed"
    sink.close()


@pytest.mark.parametrize("jump", [0, DAY, -DAY, IN_2038])
def test_values_are_removed_by_their_real_age(tmp_path: Path, jump: int) -> None:
    path = tmp_path / "history.db"
    sink, clock = opened(path)
    clock.write(sink, range(0, 1800, 60))
    clock.write(sink, range(1800, 3 * HOUR, 60), jump)
    clock.write(sink, range(3 * HOUR, 5 * HOUR, 60))
    oldest = 5 * HOUR - 60 - HOUR - 2 * CLEANING // SECOND
    found = sorted(kept(path))
    assert set(range(4 * HOUR, 5 * HOUR, 60)) <= set(found), "values of the last hour stay"
    assert oldest <= found[0], "older ones are removed, also those that were written in 2038"
    sink.close()


def test_a_wrong_clock_at_the_start_has_time_to_be_set(tmp_path: Path) -> None:
    path = tmp_path / "history.db"
    sink, clock = opened(path)
    clock.write(sink, range(0, 1800, 60))
    sink.close()
    sink, clock = opened(path)
    clock.write(sink, range(1800, 1860, 60), DAY)
    clock.write(sink, range(1860, 3600, 60))
    sink.close()
    assert sorted(kept(path)) == list(range(0, 3600, 60))


def test_values_of_earlier_runs_are_removed_whatever_their_time(tmp_path: Path) -> None:
    path = tmp_path / "history.db"
    sink, clock = opened(path)
    clock.write(sink, range(0, 1800, 60), IN_2038)
    sink.close()
    sink, clock = opened(path)
    clock.write(sink, range(1800, 1800 + 2 * HOUR, 60))
    assert min(kept(path)) >= 1800
    sink.close()


def test_an_empty_history_is_reported(tmp_path: Path) -> None:
    path = tmp_path / "history.db"
    path.touch()
    for reports in (["the file was empty, a new history begins"], []):
        sink, clock = opened(path)
        sink.close()
        assert clock.reports == reports


# ---- files -------------------------------------------------------------------------------------------------------


def values_of(folder: Path) -> dict[str, list[str]]:
    return {
        path.name: [row["value"] for row in csv.DictReader(path.read_text().splitlines())]
        for path in sorted(folder.iterdir())
    }


def written(sink: Sink, *seconds: float) -> None:
    for number, time in enumerate(seconds):
        assert sink.write([sample(time, value=number)]) == 1


def test_a_file_of_another_day_ends_whichever_way_the_clock_jumps(tmp_path: Path) -> None:
    sink = CsvFile(csv=str(tmp_path / "rows.csv"), rotate="day", at=NOWHERE).make()
    sink.open(POINTS)
    for seconds in ((0, 60), (DAY, DAY + 60), (120, 180), (IN_2038,), (240,)):
        written(sink, *seconds)
    sink.close()
    assert values_of(tmp_path) == {
        "rows.20260301T120000.csv": ["0", "1"],
        "rows.20260301T120200.csv": ["0", "1"],
        "rows.20260302T120000.csv": ["0", "1"],
        "rows.20390918T230640.csv": ["0"],
        "rows.csv": ["0"],
    }


def test_values_that_are_a_little_late_do_not_end_a_file(tmp_path: Path) -> None:
    sink = CsvFile(csv=str(tmp_path / "rows.csv"), rotate="day", at=NOWHERE).make()
    sink.open(POINTS)
    midnight = 12 * HOUR
    written(sink, midnight - 1, midnight + 0.5, midnight - 0.5, midnight + 1, midnight - 2)
    sink.close()
    assert values_of(tmp_path) == {"rows.20260301T235959.csv": ["0"], "rows.csv": ["1", "2", "3", "4"]}


def test_files_of_the_future_go_before_those_of_this_run(tmp_path: Path) -> None:
    sink = CsvFile(csv=str(tmp_path / "rows.csv"), rotate="hour", keep=2, at=NOWHERE).make()
    sink.open(POINTS)
    written(sink, *(IN_2038 + hour * HOUR for hour in range(4)))
    written(sink, *(hour * HOUR for hour in range(4)))
    sink.close()
    names = list(values_of(tmp_path))
    assert names == ["rows.20260301T130000.csv", "rows.20260301T140000.csv", "rows.csv"]


@pytest.mark.parametrize("seconds", [0.25, IN_2038, DAY])
def test_times_are_read_as_they_were_written(seconds: float) -> None:
    time = START + round(seconds * SECOND)
    assert nanoseconds_of(iso_time(time)) == time


# ---- in a run ----------------------------------------------------------------------------------------------------


def test_a_jump_is_reported(tmp_path: Path) -> None:
    run = VirtualRun(run_file(tmp_path, "{csv: every.csv, every: 1 s}"))
    heard: list[str] = []
    run.watch_troubles(lambda report: heard.append(report.text))
    table = run._service.points.table
    right: Callable[[int], int] = table.wall
    run.run_for("3 s")
    table.wall = lambda now: right(now) + DAY * SECOND
    run.run_for("100 s")
    table.wall = right
    run.run_for("3 s")
    run.stop()
    why = "no sink deletes values for that"
    assert heard == [
        f"clock: the time of day has jumped forward by 24 h; {why}",
        f"clock: the time of day has jumped back by 24 h; {why}",
    ]
    assert run.problems == []
