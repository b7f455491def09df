"""Archives of captures: the same rows by one process, by several, and by a cluster.

An archive is complete or missing.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from framekit.api.errors import RequestError
from framekit.cli.main import main
from framekit.extras.archive import archive as archive_module
from framekit.extras.archive.archive import archive
from framekit.service.capture import Capture
from framekit.transport.clock import VirtualClock
from framekit.transport.port import LineEvent

pq = pytest.importorskip("pyarrow.parquet", reason="pyarrow is not installed")

SECOND = 1_000_000_000
ASK, ANSWER = bytes.fromhex("01 03 00 00 00 02 C4 0B"), bytes.fromhex("01 03 04 00 01 00 02 2A 32")
WRONG = ASK[:-1] + b"\x0c"


def captures(folder: Path, count: int = 3) -> list[Path]:
    """Write captures of one, two, … exchanges; the last capture ends with a damaged frame."""
    found = []
    for number in range(1, count + 1):
        path = folder / f"day{number}.pcap"
        capture = Capture(path, (1,), VirtualClock())
        capture.write(1, LineEvent("open", number * SECOND))
        for exchange in range(number):
            at = number * SECOND + exchange * 100_000_000
            capture.write(1, LineEvent("data", at, "out", ASK))
            capture.write(1, LineEvent("data", at + 50_000_000, "in", ANSWER))
        if number == count:
            capture.write(1, LineEvent("data", number * SECOND + SECOND // 2, "out", WRONG))
        capture.close()
        found.append(path)
    return found


def rows(target: Path) -> list[dict[str, Any]]:
    """Return all rows in order, times in nanoseconds."""
    tables = [pq.read_table(part) for part in sorted(target.iterdir())]
    place = tables[0].schema.get_field_index("time")
    tables = [table.set_column(place, "time", table["time"].cast("int64")) for table in tables]
    return [row for table in tables for row in table.to_pylist()]


def test_a_row_for_everything_seen(tmp_path: Path) -> None:
    target = tmp_path / "all.parquet"
    done = sorted(archive(captures(tmp_path), "modbus-rtu", target, jobs=1), key=lambda one: one.capture)
    assert [capture.rows for capture in done] == [3, 5, 8]
    assert [capture.counts["frame"] for capture in done] == [2, 4, 6] and done[2].counts["bad"] == 1
    assert [path.name for path in sorted(target.iterdir())] == [f"0000{n}-day{n}.parquet" for n in (1, 2, 3)]
    found = rows(target)
    assert pq.read_table(target).num_rows == len(found) == 16  # the folder is one table
    request = found[1]
    assert request | {"time": None} == {
        "capture": "day1.pcap", "time": None, "channel": 1, "direction": "out", "event": "frame",
        "frame": request["frame"], "result": request["result"], "size": 8, "bytes": ASK, "fields": request["fields"],
        "reason": None, "segment": None, "offset": None,
    }  # fmt: skip
    assert SECOND <= request["time"] < SECOND + SECOND // 10
    assert json.loads(request["fields"])["station"] == 1
    bad = found[-1]
    assert bad["event"] == "bad" and bad["offset"] is not None and bad["reason"] and bad["bytes"] == WRONG


@pytest.mark.long
def test_processes_give_the_same_rows(tmp_path: Path) -> None:
    found = captures(tmp_path, 2)
    for jobs in (1, 2):
        list(archive(found, "modbus-rtu", tmp_path / f"{jobs}.parquet", jobs=jobs))
    assert rows(tmp_path / "1.parquet") == rows(tmp_path / "2.parquet")


@pytest.mark.long
def test_a_cluster_gives_the_same_rows(tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed", reason="distributed is not installed")
    found = captures(tmp_path)
    list(archive(found, "modbus-rtu", tmp_path / "here.parquet", jobs=1))
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, local_directory=str(tmp_path)
    ) as cluster:
        engine = cluster.scheduler_address.replace("tcp://", "dask://")
        list(archive(found, "modbus-rtu", tmp_path / "there.parquet", engine=engine))
    assert rows(tmp_path / "here.parquet") == rows(tmp_path / "there.parquet")


def test_what_cannot_be_read_is_told_and_the_rest_is_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    whole = captures(tmp_path)[0].read_bytes()
    (tmp_path / "day2.pcap").write_bytes(whole[:-3])
    (tmp_path / "day3.pcap").write_bytes(b"no capture at all")
    assert main(["decode", "modbus-rtu", "--capture", "day*.pcap", "--to", "all.parquet", "--jobs", "1"]) == 1
    out, err = capsys.readouterr()
    assert out.splitlines() == [
        "day1.pcap: 2 frames, 0 bad, 0 noise",
        "day2.pcap: 2 frames, 0 bad, 0 noise",
        "day3.pcap: 0 frames, 0 bad, 0 noise",
        "all.parquet: 6 rows of 3 captures; 4 frames, 0 bad, 0 noise",
    ]
    assert "day2.pcap: the last record is not whole" in err and "day3.pcap" in err
    assert main(["decode", "modbus-rtu", "--capture", "day1.pcap", "--to", "one.parquet", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["rows"] == 3


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        ("--capture x*.pcap --to a.parquet", "x*.pcap: there is no such file"),
        ("--capture day*.pcap", "a pattern needs --to OUT.parquet"),
        ("--capture day1.pcap --jobs 2", "--jobs has no effect without --to"),
        ("--capture day1.pcap --to day1.pcap", "write a name that ends in .parquet"),
        ("--capture day1.pcap --to old.parquet", "old.parquet is there already"),
        ("--capture day1.pcap --to a.parquet --engine spark://here", "'spark://here' is no engine"),
        pytest.param(
            "--capture day1.pcap --to a.parquet --engine dask://127.0.0.1:1",
            "dask://127.0.0.1:1 does not answer",
            marks=pytest.mark.long,
        ),
        ("--capture day1.pcap --to a.parquet --jobs 0", "1 or more"),
        ("--capture day1.pcap --to a.parquet --ascii", "--ascii has no effect with --to"),
    ],
)
def test_what_is_wrong_with_the_words(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], words: str, problem: str
) -> None:
    monkeypatch.setattr(archive_module, "LONGEST_CONNECT", 1.0)
    if "dask" in words:
        pytest.importorskip("distributed", reason="distributed is not installed")
    monkeypatch.chdir(tmp_path)
    captures(tmp_path, 1)
    (tmp_path / "old.parquet").mkdir()
    assert main(["decode", "modbus-rtu", *words.split()]) == 2
    assert problem in capsys.readouterr().err
    assert {path.name for path in tmp_path.iterdir()} == {"day1.pcap", "old.parquet"}


def test_nothing_is_left_where_it_was_given_up(tmp_path: Path) -> None:
    given_up = archive(captures(tmp_path), "modbus-rtu", tmp_path / "all.parquet", jobs=1)
    next(given_up)
    given_up.close()
    assert not (tmp_path / "all.parquet").exists() and not (tmp_path / "all.parquet.part").exists()
    with pytest.raises(RequestError, match="no such capture"):
        next(archive([], "modbus-rtu", tmp_path / "all.parquet"))
