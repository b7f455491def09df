"""The verbs on a system without POSIX: no `pty`, `termios`, `resource` or `fcntl`, and a loop without signals.

Windows is not available: a process of its own hides the modules that Windows lacks. The verbs use real sockets and
simulated lines.
"""

from __future__ import annotations

import asyncio
import io
import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from framekit.api.event_loop import LOOP_VARIABLE
from framekit.cli.main import fit_output
from framekit.transport.clock import AsyncioClock
from framekit.transport.schemes import is_known, open_port, scheme_name
from framekit.transport.serial_port import SERIAL_ERRORS, reason_of

FOREIGN = """
import asyncio, os, signal, sys
import multiprocessing, platformdirs, selectors, serial, sqlite3, subprocess, tempfile, threading

def refuse(*words):
    raise NotImplementedError

for name in ("pty", "tty", "termios", "resource", "fcntl", "pwd", "grp"):
    sys.modules[name] = None
for name in ("geteuid", "getuid", "O_NOFOLLOW", "set_blocking", "ttyname", "fork", "openpty"):
    delattr(os, name)
for name in ("SIGHUP", "SIGUSR1", "SIGUSR2"):
    delattr(signal, name)
for loop in (asyncio.SelectorEventLoop, asyncio.AbstractEventLoop):
    loop.add_signal_handler = loop.remove_signal_handler = refuse
asyncio.SelectorEventLoop.add_reader = asyncio.SelectorEventLoop.add_writer = refuse
sys.platform = "win32"
from framekit.cli.main import main
sys.exit(main(sys.argv[1:]))
"""
"""A program that runs `framekit` without any POSIX module; the standard library is imported beforehand."""

DEVICE = "device: bench\nprotocol: modbus-tcp\nstation: 1\nmemory: {set: {40001: [100, 200, 300]}}\n"
RUN = """run: foreign
memory: masterlogic
channels:
  1: {port: "PORT", protocol: modbus-tcp, station: 1}
blocks:
  0: {read: "40001", count: 3, into: M100, every: 20 ms}
"""

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="this hides what POSIX has")


@contextmanager
def foreign(folder: Path, *words: str) -> Iterator[subprocess.Popen[str]]:
    """Run a verb in a process without POSIX, and kill it at the end."""
    process = subprocess.Popen(
        [sys.executable, "-c", FOREIGN, *words], cwd=folder, text=True, encoding="utf-8",
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        env={**os.environ, LOOP_VARIABLE: ""},
    )  # fmt: skip
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def line_of(process: subprocess.Popen[str], wanted: str) -> str:
    """Return the next line that contains `wanted`."""
    assert process.stdout is not None
    for line in process.stdout:
        if wanted in line:
            return line
    raise AssertionError(f"no {wanted}: {process.communicate()[1]}")


def ended(process: subprocess.Popen[str], how: signal.Signals) -> tuple[int, str]:
    """Return exit status and standard output after the signal; assert that no traceback was printed."""
    process.send_signal(how)
    output, errors = process.communicate(timeout=60)
    assert "Traceback" not in errors
    return process.returncode, output


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "bench.device.yaml").write_text(DEVICE, "utf-8")
    (tmp_path / "foreign.run.yaml").write_text(RUN.replace("PORT", "sim:bench.device.yaml"), "utf-8")
    monkeypatch.setenv("FRAMEKIT_CACHE", str(tmp_path.parent / "foreign-cache"))
    monkeypatch.setenv("HOME", str(tmp_path.parent))
    return tmp_path


@pytest.mark.long
def test_a_run_ends_as_elsewhere(folder: Path) -> None:
    with foreign(
        folder, "run", "foreign.run.yaml", "--json", "--frames", "--control", "--status-every", "1h"
    ) as process:
        line_of(process, '"frame"')
        status, output = ended(process, signal.SIGTERM)
    assert status == 0
    assert json.loads(output.splitlines()[-1])["event"] == "channel"  # the summary of a run that has ended by itself
    assert any((folder.parent / "foreign-cache").iterdir())  # compiled protocols are kept there too


def test_a_server_answers_a_run_over_tcp_and_both_end(folder: Path) -> None:
    with foreign(folder, "serve", "bench.device.yaml", "--port", "tcp://127.0.0.1:0", "--json") as server:
        port = json.loads(line_of(server, '"ready"'))["port"]
        (folder / "tcp.run.yaml").write_text(RUN.replace("PORT", port), "utf-8")
        with foreign(folder, "run", "tcp.run.yaml", "--json", "--frames") as run:
            line_of(run, '"frame"')
            line_of(run, '"frame"')
            assert ended(run, signal.SIGINT)[0] == 0
        status, output = ended(server, signal.SIGTERM)
    assert status == 0
    assert '"services": 0' not in output


def silent_peer() -> tuple[socket.socket, str]:
    """Return a listening socket and its port URL."""
    peer = socket.create_server(("127.0.0.1", 0))
    return peer, f"tcp://127.0.0.1:{peer.getsockname()[1]}"


def test_a_monitor_and_a_recording_end_by_ctrl_c_and_a_replay_by_itself(folder: Path) -> None:
    peer, port = silent_peer()
    with peer, foreign(folder, "monitor", "modbus-tcp", "--port", port, "--json") as monitor:
        peer.accept()[0].sendall(bytes.fromhex("000100000006010300000001"))
        line_of(monitor, '"frame"')
        status, output = ended(monitor, signal.SIGINT)
        assert (status, json.loads(output.splitlines()[-1])["frames"]) == (0, 1)
    peer, port = silent_peer()
    with peer, foreign(folder, "record", port, "-o", "line.jsonl", "--json") as record:
        peer.accept()[0].sendall(b"\x01\x02\x03")
        line_of(record, "01 02 03")
        status, output = ended(record, signal.SIGINT)
        assert (status, json.loads(output.splitlines()[-1])["bytes"]) == (0, 3)
    peer, port = silent_peer()
    with peer, foreign(folder, "replay", "line.jsonl", "--port", port, "--direction", "in", "--json") as replay:
        assert peer.accept()[0].recv(3) == b"\x01\x02\x03"
        output, errors = replay.communicate(timeout=60)
    assert (replay.returncode, json.loads(output)["sent"], errors) == (0, 3, "")


@pytest.mark.long
def test_command_blocks_are_carried_out(folder: Path) -> None:
    (folder / "plc.device.yaml").write_text("device: plc\nprotocol: snp\nstation: A\nmemory: {set: {R1: 7}}\n", "utf-8")
    words = ["snp_attach", "id=A", "+", "snp_read", "type=R", "address=1", "count=1", "here_type=R", "here=5"]
    with foreign(folder, "commreq", "snp", "--port", "sim:plc.device.yaml", *words, "--json") as commreq:
        output, errors = commreq.communicate(timeout=60)
        assert (commreq.returncode, errors) == (0, "")
        assert '"%R5": [7]' in output


@pytest.mark.long
def test_a_fleet_says_that_its_broker_is_not_there(folder: Path) -> None:
    with foreign(folder, "fleet", "127.0.0.1:1", "--watch") as fleet:
        output, errors = fleet.communicate(timeout=60)
    assert (fleet.returncode, output) == (1, "")
    assert errors.startswith("framekit fleet: ")


@pytest.mark.long
def test_a_port_that_is_not_there_is_told(folder: Path) -> None:
    with foreign(folder, "record", "COM3", "--quiet", "-o", "line.jsonl") as record:
        _, errors = record.communicate(timeout=60)
    assert (record.returncode, errors) == (3, "framekit record: COM3: there is no such device\n")


# ---- names of ports ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["COM3", "com4", "COM3:", "COM12", r"\\.\COM12", r"\\.\com1"])
def test_names_of_windows_are_serial_ports(name: str) -> None:
    assert scheme_name(name) == ""
    assert is_known(name)


@pytest.mark.parametrize("name", ["comx:", "COM:", "COM3:4", "xCOM3:"])
def test_what_only_looks_like_one_is_not(name: str) -> None:
    assert scheme_name(name) != ""
    assert not is_known(name)


def test_reasons_that_pyserial_gives_on_windows_are_told_in_our_words() -> None:
    words = "could not open port 'COM3': {}"
    gone = SERIAL_ERRORS[0](words.format("FileNotFoundError(2, 'The system cannot find the file specified.', None, 2)"))
    taken = SERIAL_ERRORS[0](words.format("PermissionError(13, 'Access is denied.', None, 5)"))
    assert reason_of(gone) == "there is no such device"
    assert reason_of(taken) == "another program has it open"


def test_a_terminal_of_its_own_is_refused_there(monkeypatch: pytest.MonkeyPatch) -> None:
    async def ask() -> None:
        open_port("pty:", None, AsyncioClock(asyncio.get_running_loop()), serves=True)

    monkeypatch.setattr(sys, "platform", "win32")
    with pytest.raises(ValueError, match="Windows has no pseudo-terminals – name a port such as COM3"):
        asyncio.run(ask())


@pytest.mark.parametrize(
    ("system", "chosen", "shown"),
    [("win32", None, "→ é".encode()), ("win32", "cp1252", b"\\u2192 \xe9"), ("linux", None, b"\\u2192 \xe9")],
)
def test_output_is_written_whatever_the_code_page(
    system: str, chosen: str | None, shown: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    written = io.BytesIO()
    monkeypatch.setattr(sys, "platform", system)
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(written, encoding="cp1252"))
    monkeypatch.delenv("PYTHONIOENCODING", raising=False)
    if chosen is not None:
        monkeypatch.setenv("PYTHONIOENCODING", chosen)
    fit_output()
    print("→ é", end="", flush=True)
    assert written.getvalue() == shown
