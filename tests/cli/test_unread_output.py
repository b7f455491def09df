"""Verbs that keep a line alive end without a traceback when the reader of their output has gone."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from cli.small_run import DEVICE, RUN
from spread import spread

WORDS = ["2003", "5", "0", "1", "1", "0", "8", "100", "8", "50", "4", "1", "4", "3", "0", "0", "1"]


@pytest.mark.parametrize(
    "words",
    spread(
        [
            ["run", "unread.run.yaml", "--frames"],
            ["run", "unread.run.yaml", "--frames", "--json"],
            ["run", "unread.run.yaml", "--virtual", "--for", "1h", "--frames"],
            ["read", "modbus-tcp", "--port", "sim:far.device.yaml", "--station", "1", "40001", "--every", "5 ms"],
            ["commreq", "srtp", "--commands", "ge-channels", "--port", "sim:plc.device.yaml", *WORDS],
        ],
        4,
    ),
)
def test_nobody_reads_any_more(tmp_path: Path, words: list[str]) -> None:
    (tmp_path / "far.device.yaml").write_text(DEVICE, encoding="utf-8")
    (tmp_path / "plc.device.yaml").write_text("device: plc\nprotocol: srtp\n", encoding="utf-8")
    (tmp_path / "unread.run.yaml").write_text(RUN, encoding="utf-8")
    with subprocess.Popen(
        [sys.executable, "-m", "framekit.cli.main", *words],
        cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        assert process.stdout is not None and process.stderr is not None
        process.stdout.readline()
        process.stdout.close()
        assert process.wait(60) == 1 and process.stderr.read() == ""


def test_closed_streams_take_no_text_and_stop_nothing(tmp_path: Path) -> None:
    """As a daemon starts a program: `>&- 2>&-`."""
    (tmp_path / "far.device.yaml").write_text(DEVICE, encoding="utf-8")
    (tmp_path / "unread.run.yaml").write_text(RUN, encoding="utf-8")
    words = f"{sys.executable} -m framekit.cli.main run unread.run.yaml --virtual --for 1s --capture seen.jsonl"
    done = subprocess.run(["sh", "-c", f"{words} >&- 2>&-"], cwd=tmp_path, timeout=60)
    assert done.returncode == 0
    assert (tmp_path / "seen.jsonl").read_text("utf-8").count("\n") > 300
    closed = subprocess.run(
        ["sh", "-c", f"{words.replace('--capture seen.jsonl', '')} >&-"],
        cwd=tmp_path,
        timeout=60,
        stderr=subprocess.PIPE,
    )
    assert (closed.returncode, closed.stderr) == (0, b"")
