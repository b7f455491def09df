"""Sinks whose file name is already used by another file, a folder or a device."""

from __future__ import annotations

import os
import socket
from pathlib import Path

import pytest

from framekit.api.run import VirtualRun
from framekit.cli.main import main
from framekit.definition.problems import DefinitionError

DEVICE = """device: meter
protocol: modbus-tcp
station: 1
memory: {set: {"40001": [217, 2]}}
"""
RUN = """run: plant
channels:
  1: {port: "sim:meter.device.yaml", protocol: modbus-tcp, station: 1}
points:
  temperature: {channel: 1, address: "40001"}
sinks:
"""
ROWS = "time,point,value,unit,quality,reason\n2026-01-01T00:00:00.000Z,old,5,,good,\n"
COLUMNS = "time,old (m)\n2026-01-01T00:00:00.000Z,5\n"
JSON = '{"time": "2026-01-01T00:00:00.000Z", "point": "old", "value": 5, "quality": "good"}\n'


@pytest.fixture(autouse=True)
def _folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("meter.device.yaml").write_text(DEVICE, "utf-8")


def run_file(*sinks: str) -> Path:
    path = Path("plant.run.yaml")
    path.write_text(RUN + "".join(f"  - {sink}\n" for sink in sinks), "utf-8")
    return path


def errors_of(*sinks: str) -> list[str]:
    """Return the errors at the start of a run with these sinks, without the folder of the run file."""
    run = VirtualRun(run_file(*sinks))
    with pytest.raises(DefinitionError) as error:
        run.start()
    run.stop()
    return [str(problem).removeprefix(f"{os.getcwd()}/") for problem in error.value.problems]


def files() -> set[str]:
    return set(os.listdir()) - {"meter.device.yaml", "plant.run.yaml"}


# ---- foreign content ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "content",
    [
        "my notes\n", "my notes", "\n", "time flies\n", "time,voltage\n0.1,5\n", "time,voltage\n2026-01-01,5\n",
        "time;point\n", "time\n", "\0" * 100 + "x", '{"time": "2026-01-01T00:00:00.000Z", "level": "info"}\n',
        '{"columns": 3}',
    ],
)  # fmt: skip
@pytest.mark.parametrize(
    ("sink", "name", "noun"),
    [
        ("{csv: values}", "values", "csv file"),
        ("{csv: values, every: 1 s}", "values", "csv file"),
        ("{csv: values, rotate: day, keep: 1}", "values", "csv file"),
        ("{jsonl: values}", "values", "jsonl file"),
        ("{parquet: values}", "values.part", "file of rows"),
    ],
)  # fmt: skip
def test_a_file_of_other_content_is_an_error_and_stays(sink: str, name: str, noun: str, content: str) -> None:
    if name.endswith(".part"):
        pytest.importorskip("pyarrow")
    Path(name).write_text(content)
    assert errors_of(sink) == [
        f"plant.run.yaml:7:5: {name} is no {noun} of framekit – move it away, or name another file"
    ]
    assert (files(), Path(name).read_text()) == ({name}, content)


def test_a_file_of_zero_bytes_as_a_loss_of_power_leaves_it_is_put_aside() -> None:
    Path("values.csv").write_bytes(bytes(4096))
    run = VirtualRun(run_file("{csv: values.csv}"))
    run.start()
    run.run_for("3 s")
    run.stop()
    assert Path("values.csv").read_text().startswith("time,point,value")
    assert sorted(path.stat().st_size for path in Path().glob("values.*")).count(4096) == 1


# ---- devices, folders, pipes, sockets ------------------------------------------------------------------------------

SINKS = ["{csv: values}", "{jsonl: values}", "{sqlite: values}", '{mqtt: "127.0.0.1:1", store: values}']


def make(kind: str) -> None:
    path = Path("values")
    match kind:
        case "a folder":
            path.mkdir()
        case "a pipe":
            os.mkfifo(path)
        case "a socket":
            with socket.socket(socket.AF_UNIX) as made:
                made.bind("values")
        case "a character device":
            try:
                os.mknod(path, 0o20666, os.makedev(1, 7))
            except PermissionError:
                pytest.skip("only root makes devices")


@pytest.mark.parametrize("link", [False, True])
@pytest.mark.parametrize("kind", ["a folder", "a pipe", "a socket", "a character device"])
@pytest.mark.parametrize("sink", SINKS)
def test_a_special_file_is_an_error_and_stays(sink: str, kind: str, link: bool) -> None:
    make(kind)
    if link:
        Path("values").rename("real")
        Path("values").symlink_to("real")
    before = {name: os.lstat(name)[:3] for name in files()}
    todo = "name another file" if kind == "a character device" else "move it away, or name another file"
    assert errors_of(sink) == [f"plant.run.yaml:7:5: values is {kind} – {todo}"]
    assert {name: os.lstat(name)[:3] for name in files()} == before


def test_a_part_of_parquet_that_is_a_folder_is_an_error() -> None:
    pytest.importorskip("pyarrow")
    Path("values.part").mkdir()
    assert errors_of("{parquet: values}") == [
        "plant.run.yaml:7:5: values.part is a folder – move it away, or name another file"
    ]


# ---- files of framekit with other columns --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("sink", "content", "aside"),
    [
        ("{csv: values.csv, every: 1 s}", COLUMNS, "values.20260101T000000.csv"),
        ("{csv: values.csv, every: 1 s}", ROWS, "values.20260101T000000.csv"),
        ("{csv: values.csv}", COLUMNS, "values.20260101T000000.csv"),
        ("{csv: values.csv}", COLUMNS[:20], "values.before.csv"),
        ("{csv: values.csv}", COLUMNS[:9], "values.before.csv"),
    ],
)
def test_a_table_of_other_columns_is_put_aside_with_a_line(
    capsys: pytest.CaptureFixture[str], sink: str, content: str, aside: str
) -> None:
    Path("values.csv").write_text(content)
    assert main(["run", str(run_file(sink)), "--virtual", "--for", "3s", "--quiet"]) == 0
    assert capsys.readouterr().err == (
        f"sink csv values.csv: the file has other columns, it is {aside} now – a new file begins\n"
    )
    assert files() == {"values.csv", aside}
    assert Path(aside).read_text() == content


def test_rows_of_other_columns_become_a_parquet_file_with_a_line(capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("pyarrow")
    Path("values.parquet.part").write_text(
        '{"columns": [["old", "int64", ""]]}\n["2026-01-01T00:00:00.000Z", {"old": 5}]\n'
    )
    assert main(["run", str(run_file("{parquet: values.parquet}")), "--virtual", "--for", "3s", "--quiet"]) == 0
    aside = "values.20260101T000000.parquet"
    assert capsys.readouterr().err == (
        f"sink parquet values.parquet: the file has other columns, it is {aside} now – a new file begins\n"
    )
    assert aside in files()


@pytest.mark.parametrize(("sink", "content"), [("{csv: values}", ROWS), ("{jsonl: values}", JSON)])
@pytest.mark.parametrize("cut", [0, 1, 30, 60, 80])
def test_an_own_file_is_continued_without_a_line(
    capsys: pytest.CaptureFixture[str], sink: str, content: str, cut: int
) -> None:
    Path("values").write_text(content[: len(content) - cut])
    assert main(["run", str(run_file(sink)), "--virtual", "--for", "3s", "--quiet"]) == 0
    assert capsys.readouterr().err == ""
    assert (files(), Path("values").read_text().count("old")) == ({"values"}, 0 if cut else 1)


def test_a_link_stays_when_its_file_is_put_aside() -> None:
    Path("disk").mkdir()
    Path("disk/table.csv").write_text(COLUMNS)
    Path("values.csv").symlink_to("disk/table.csv")
    run = VirtualRun(run_file("{csv: values.csv}"))
    run.run_for("1 s")
    run.stop()
    assert Path("values.csv").is_symlink()
    assert sorted(os.listdir("disk")) == ["table.20260101T000000.csv", "table.csv"]
    assert Path("disk/table.20260101T000000.csv").read_text() == COLUMNS
    assert "temperature" in Path("disk/table.csv").read_text()


def test_a_folder_that_comes_during_the_run_is_trouble_until_it_is_moved_away() -> None:
    run = VirtualRun(run_file("{csv: values.csv, every: 1 s}"))
    run.run_for("1500 ms")
    Path("values.csv").rename("first.csv")
    Path("values.csv").mkdir()
    run.run_for("2 s")
    (problem,) = run.problems
    assert problem.startswith("sink csv values.csv: this is a folder – move it away, or name another file")
    Path("values.csv").rename("folder")
    run.run_for("60 s")
    assert run.problems == []


def test_a_foreign_file_that_comes_during_the_run_is_trouble_until_it_goes() -> None:
    """The rows wait meanwhile; they are written when the file is gone."""
    run = VirtualRun(run_file("{csv: values.csv, every: 1 s}"))
    run.run_for("1500 ms")
    Path("values.csv").rename("first.csv")
    Path("values.csv").write_text("my notes\n")
    run.run_for("2 s")
    foreign = "sink csv values.csv: this is no csv file of framekit – move it away, or name another file"
    assert run.problems == [f"{foreign}, 2 samples wait"]
    assert Path("values.csv").read_text() == "my notes\n"
    Path("values.csv").rename("notes.txt")
    run.run_for("1 s")
    run.stop()
    assert run.problems == []
    assert len(Path("first.csv").read_text().splitlines()) + len(Path("values.csv").read_text().splitlines()) == 2 + 4


# ---- state files -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "problem"),
    [
        ("a text", "values is no state file – name another file"),
        ("a folder", "values is no plain file – name another file"),
        ("a pipe", "values is no plain file – name another file"),
        ("a character device", "values is no plain file – name another file"),
    ],
)
def test_a_state_file_of_other_content_is_an_error_with_its_place(
    capsys: pytest.CaptureFixture[str], kind: str, problem: str
) -> None:
    make(kind)
    if kind == "a text":
        Path("values").write_text("my notes\n")
    before = {name: os.lstat(name)[:3] for name in files()}
    Path("plant.run.yaml").write_text(RUN.replace("sinks:", "state: values"), "utf-8")
    assert main(["run", "plant.run.yaml", "--virtual", "--for", "1s", "--quiet"]) == 1
    assert capsys.readouterr().err == f"plant.run.yaml:6:8: {problem}\n"
    assert {name: os.lstat(name)[:3] for name in files()} == before
