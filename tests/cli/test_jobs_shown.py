"""The output of `framekit run --status` for jobs: slots, counted commands, the log; also as JSON."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from job_bench import write_device

from framekit.cli.main import main

RUN = """
run: shown
memory: masterlogic
dead: no
jobs: {profile: ge-channels, status: P0, surplus: lost}
channels:
  1: {port: "sim:far.device.yaml", protocol: modbus-tcp, station: 1, host: 3.0.0.2}
blocks:
  0: {job: 5, read: "40001", count: 4, into: D100, every: 100 ms, times: 10, once: yes}
  1: {job: 6, read: "49999", into: D110, every: 200 ms, late: 100 ms, once: yes}
  2: {job: 7, report: D50, host: 3.0.0.2, after: 500 ms}
"""


@pytest.fixture
def run(tmp_path: Path) -> str:
    write_device(tmp_path, "far")
    path = tmp_path / "shown.run.yaml"
    path.write_text(RUN, encoding="utf-8")
    return str(path)


def test_jobs_are_shown(run: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", run, "--virtual", "--for", "550ms", "--status"]) == 0
    out = capsys.readouterr().out
    assert [" ".join(line.split()) for line in out.splitlines() if line.startswith(("5 ", "6 "))] == [
        "5 read 40001 channel 1 waiting 100 ms 4 6 0 0 0 0x0001 success",
        "6 read 49999 channel 1 waiting 200 ms - 0 3 0 0 0x0205 server: service request error, 0x02",
    ]
    assert "\ncommands: 3 taken, 3 job; 1 refused, 0 lost, 0 faults\n" in out
    assert "\nevents: 2, the last 2:\n0.000 s error slot 6 0x0205 server: service request error, 0x02\n" in out
    assert "\n0.500 s refused slot 7 0x008B client: illegal service request\n" in out


def test_and_for_programs(run: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", run, "--virtual", "--for", "550ms", "--status", "--json"]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    jobs = next(line["jobs"] for line in lines if line["event"] == "status" and "jobs" in line)
    first, second = jobs["slots"]
    assert (first["slot"], first["state"], first["left"], first["counters"]["good"]) == (5, "waiting", 4, 6)
    assert (second["word"], second["last_good"], second["last_error"], second["period"]) == (0x0205, None, 0.4, 0.2)
    assert [(event["time"], event["event"], event["slot"]) for event in jobs["log"]] == [
        (0.0, "error", 6), (0.5, "refused", 7),
    ]  # fmt: skip
    assert jobs["commands"] == {"taken": 3, "lost": 0, "faults": 0, "refused": 1, "kinds": {"job": 3}}


def test_a_warning_that_comes_again_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    chan4 = Path(__file__).parents[2] / "examples" / "ge-channels" / "chan4.run.yaml"
    assert main(["check", str(chan4)]) == 0
    (line,) = capsys.readouterr().err.splitlines()
    assert "chan4.run.yaml:15:86: warning: the period is over before the time-out" in line
    assert ", 4 times: also at 16:86, 17:86 and 18:86 – " in line
    assert main(["check", "--json", str(chan4)]) == 0
    (found,) = json.loads(capsys.readouterr().out)
    assert [problem["line"] for problem in found["problems"]] == [15, 16, 17, 18]
