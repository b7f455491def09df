"""The check of a rolled file: a process of its own, a time limit, and refusals without content of other files."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest
from spread import spread

from framekit.api.replaced_file import ReplacedFile
from framekit.definition.problems import DefinitionError
from framekit.extras.fleet.rolled_file import check_apart, more_than, refusal
from framekit.runfile.run_file import load_run

DEVICE = "device: meter\nprotocol: modbus-tcp\nstation: 1\n"
RUN = """run: meter
channels:
  1: {port: "sim:meter.device.yaml", protocol: modbus-tcp, station: 1}
points:
  count: {channel: 1, address: "40001"}
sinks:
  - {jsonl: rows.jsonl}
fleet: {broker: "127.0.0.1:1", name: one}
"""
CHANNEL = '"sim:meter.device.yaml", protocol: modbus-tcp'


@pytest.fixture
def run_file(tmp_path: Path) -> Path:
    """Write a gateway's run file, with a secret and a table in the same folder."""
    (tmp_path / "meter.device.yaml").write_text(DEVICE)
    (tmp_path / "db.password").write_text("S3cr3t: {very: S3cr3t}\n")
    (tmp_path / "S3.points.yaml").write_text("points: {S3cr3t: {adress: S3cr3t}}\n")
    (tmp_path / "meter.run.yaml").write_text(RUN)
    return tmp_path / "meter.run.yaml"


def reasons_of(path: Path, text: str, limit: float = 120.0) -> list[str]:
    """Return the refusal of a rolled text; empty if its check finds no errors."""
    try:
        asyncio.run(check_apart(path, text.encode(), limit))
    except ValueError as error:
        return refusal(error, path)
    return []


@pytest.mark.parametrize(
    "rolled",
    spread(
        [
            RUN.replace("protocol: modbus-tcp", "protocol: db.password"),
            RUN.replace("station: 1}", "station: 1, faults: db.password}"),
            RUN.replace('points:\n  count: {channel: 1, address: "40001"}', "points: S3"),
            f"{RUN}memory: db.password\n",
        ],
        2,
    ),
)
def test_a_refusal_names_other_files_and_quotes_none(run_file: Path, rolled: str) -> None:
    reasons = reasons_of(run_file, rolled)
    assert not any("S3cr3t" in reason for reason in reasons), reasons
    (reason,) = [reason for reason in reasons if reason.startswith(("db.password: ", "S3.points.yaml: "))]
    assert "problem" in reason and "framekit check on the gateway" in reason


@pytest.mark.parametrize("is_relative", [False, True])
@pytest.mark.parametrize(
    "change",
    [
        ("sim:meter.device.yaml", "sim:db.password"),
        ("protocol: modbus-tcp", "protocol: db.password"),
        ("station: 1}", "station: 1, faults: db.password}"),
        ("run: meter\n", "run: meter\nmemory: db.password\n"),
    ],
)
def test_a_file_that_only_the_start_reads_is_not_quoted_either(
    run_file: Path, monkeypatch: pytest.MonkeyPatch, is_relative: bool, change: tuple[str, str]
) -> None:
    """A gateway may name its run file relative to its own folder."""
    from framekit.api.run import VirtualRun

    monkeypatch.chdir(run_file.parent)
    path = Path(run_file.name) if is_relative else run_file
    with pytest.raises(DefinitionError) as wrong:
        VirtualRun(load_run(path, RUN.replace(*change)))
    assert "S3cr3t" in str(wrong.value)
    assert not any("S3cr3t" in reason for reason in refusal(wrong.value, path))


def test_problems_of_the_rolled_file_are_quoted_with_their_places(run_file: Path) -> None:
    assert reasons_of(run_file, RUN) == []
    reasons = reasons_of(run_file, RUN.replace("count: {", "count: {unit: [], "))
    assert reasons and all(reason.startswith("meter.run.yaml:5:") for reason in reasons), reasons


def test_an_unforeseen_error_is_reported_by_its_type(run_file: Path) -> None:
    (reason,) = refusal(KeyError("S3cr3t"), run_file)
    assert "KeyError" in reason and "S3cr3t" not in reason


def test_a_check_ends_at_its_time_limit(run_file: Path) -> None:
    (reason,) = reasons_of(run_file, RUN, limit=0.0)
    assert "the check took longer than 0 s" in reason


@pytest.mark.parametrize(
    ("name", "is_allowed"),
    [
        ("more.csv", True), ("more.JSONL", True), ("sitecustomize.py", False), ("more.pth", False), ("Makefile", False),
        (".hidden.csv", False), ("fresh/.ssh.txt", False), ("modbus-tcp.so", False),
    ],
)  # fmt: skip
def test_a_rolled_file_creates_data_files_only(run_file: Path, name: str, is_allowed: bool) -> None:
    new = load_run(run_file, RUN.replace("rows.jsonl", name))
    problems = list(more_than(load_run(run_file), new, ReplacedFile(run_file), set()))
    assert [problem.what.partition("' ")[2] for problem in problems] == (
        [] if is_allowed else ["is not the name of a data file, and a rolled file creates no others"]
    )
