"""Verbs whose reader has gone: verbs that only print end quietly like SIGPIPE programs; runs and servers continue."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest
from cli.small_run import DEVICE, RUN
from cli.test_live_output import ask, go_on
from spread import spread

WORDS = ["2003", "5", "0", "1", "1", "0", "8", "100", "8", "50", "4", "1", "4", "3", "0", "0", "1"]


@pytest.mark.parametrize(
    "words",
    spread(
        [
            ["run", "unread.run.yaml", "--virtual", "--for", "1h", "--frames"],
            ["read", "modbus-tcp", "--port", "sim:far.device.yaml", "--station", "1", "40001", "--every", "5 ms"],
            ["commreq", "srtp", "--commands", "ge-channels", "--port", "sim:plc.device.yaml", *WORDS],
        ],
        4,
    ),
)
def test_verbs_that_only_print_end_quietly(tmp_path: Path, words: list[str]) -> None:
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
        assert process.wait(60) == 141 and process.stderr.read() == ""


@pytest.mark.parametrize("options", spread([(("--frames",),), (("--frames", "--json"),)], 2))
def test_a_run_goes_on_without_its_reader(tmp_path: Path, options: tuple[str, ...]) -> None:
    """`framekit run plant.run.yaml

    head -1`: a line reports it, and values are still stored.
    """
    (tmp_path / "far.device.yaml").write_text(DEVICE, encoding="utf-8")
    points = 'points:\n  level: {channel: 1, address: "40001", every: 20 ms}\nsinks:\n  - {csv: a.csv, every: 100 ms}\n'
    (tmp_path / "unread.run.yaml").write_text(RUN + points, encoding="utf-8")
    with subprocess.Popen(
        [sys.executable, "-m", "framekit.cli.main", "run", "unread.run.yaml", *options],
        cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        assert process.stdout is not None and process.stderr is not None
        process.stdout.readline()
        process.stdout.close()
        assert process.stderr.readline() == "standard output: its reader has gone – the run goes on without it\n"
        before = (tmp_path / "a.csv").stat().st_size
        go_on(tmp_path / "a.csv")
        process.send_signal(signal.SIGTERM)
        assert process.wait(60) == 0 and process.stderr.read() == ""
    assert (tmp_path / "a.csv").stat().st_size > before


def test_a_server_goes_on_without_its_reader(tmp_path: Path) -> None:
    words = ["serve", "modbus-tcp", "--port", "tcp-listen://127.0.0.1:0", "--station", "1"]
    with subprocess.Popen(
        [sys.executable, "-m", "framekit.cli.main", *words],
        cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        assert process.stdout is not None and process.stderr is not None
        port = int(process.stdout.readline().rpartition(":")[2])
        process.stdout.close()
        with closing(socket.create_connection(("127.0.0.1", port), 60)) as place:
            for number in range(3):
                ask(place, number)
        assert process.stderr.readline() == "standard output: its reader has gone – the server goes on without it\n"
        process.send_signal(signal.SIGTERM)
        assert process.wait(60) == 0


def test_text_ends_as_a_program_that_sigpipe_has_ended(tmp_path: Path) -> None:
    with subprocess.Popen(
        [sys.executable, "-m", "framekit.cli.main", "schema", "run"],
        cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        assert process.stdout is not None and process.stderr is not None
        process.stdout.close()
        assert process.wait(60) == 141 and process.stderr.read() == ""


def test_closed_streams_take_no_text_and_stop_nothing(tmp_path: Path) -> None:
    """Streams closed as by a daemon that starts a program: `>&- 2>&-`."""
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
