"""`framekit run --control`: lines on standard input are commands of the run, answers are warnings."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from framekit.api.run import FileWatch
from framekit.cli.main import main

RUN = """run: by-hand
memory: masterlogic
channels:
  1: {port: "sim:there.device.yaml", protocol: modbus-rtu, station: 1}
blocks:
  3: {read: "40002", into: M101, enabled: no}
"""
DEVICE = "device: there\nprotocol: modbus-rtu\nstation: 1\n"


@pytest.fixture
def run_file(tmp_path: Path) -> Path:
    (tmp_path / "r.run.yaml").write_text(RUN, encoding="utf-8")
    (tmp_path / "there.device.yaml").write_text(DEVICE, encoding="utf-8")
    return tmp_path / "r.run.yaml"


def test_lines_reach_the_run(run_file: Path) -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "framekit", "run", str(run_file), "--json", "--frames", "--control", "--for", "30s"],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert process.stdin is not None and process.stdout is not None
    with process:
        lines: list[dict[str, object]] = []

        def until(event: str) -> dict[str, object]:
            while True:
                text = process.stdout.readline()  # type: ignore[union-attr]
                assert text, f"it has ended, after {lines[-3:]}"
                lines.append(json.loads(text))
                if lines[-1]["event"] == event:
                    return lines[-1]

        until("open")
        process.stdin.write("fire 4\nenable 3\nfire 3\n")
        process.stdin.flush()
        assert until("warning")["reason"] == "control: there is no block 4 – known: 3"
        until("frame")
        assert until("frame")["direction"] == "in"
        process.stdin.write("stop\n")
        process.stdin.flush()
        block = until("block")
        assert (block["started"], block["failed"]) == (1, 0)
        assert process.wait() == 0


def test_not_on_simulated_time(run_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", str(run_file), "--virtual", "--for", "1s", "--control"]) == 2
    assert "leave --virtual out" in capsys.readouterr().err


def test_a_wrong_byte_spoils_its_line_only(run_file: Path) -> None:
    process = subprocess.run(
        [sys.executable, "-m", "framekit", "run", str(run_file), "--json", "--frames", "--control", "--for", "30s"],
        input=b"fire \xff\nstop\n", stdout=subprocess.PIPE, check=True,
    )  # fmt: skip
    lines = [json.loads(text) for text in process.stdout.splitlines()]
    (answer,) = [reason for line in lines if (reason := line.get("reason", "")).startswith("control: ")]
    assert r"fire \xff" in answer


def test_a_watch_that_fails_is_reported_and_the_run_goes_on(
    run_file: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    async def fails(self: FileWatch) -> None:
        raise MemoryError("a defect")

    monkeypatch.setattr(FileWatch, "watch", fails)
    assert main(["run", str(run_file), "--watch", "--for", "100ms"]) == 0
    output = capsys.readouterr()
    assert "r.run.yaml is not watched any more: a defect" in output.err and "block" in output.out
