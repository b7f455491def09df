"""Observation of a run: capture of every channel, status at intervals and on a signal, the log."""

from __future__ import annotations

import json
import logging
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from framekit.api.run import run_status
from framekit.cli.common import begin_log
from framekit.cli.main import main
from framekit.runfile.run_file import load_run
from framekit.service.capture import CaptureReader, _Sink
from framekit.service.run import RunService
from framekit.transport.clock import VirtualClock
from framekit.transport.pty_port import PtyPair

EXAMPLES = Path(__file__).parents[2] / "examples"
SECOND = 1_000_000_000
TWO = EXAMPLES / "mldp-two-channels.run.yaml"


def lines_of(capsys: pytest.CaptureFixture[str]) -> list[dict[str, object]]:
    return [json.loads(line) for line in capsys.readouterr().out.splitlines()]


def test_the_status_of_a_run() -> None:
    """Services and errors of a channel are the sums of its blocks; the reasons add up to the errors."""
    clock = VirtualClock()
    service = RunService(load_run(EXAMPLES / "third-party-plc.run.yaml"), clock)
    service.start()
    clock.run_for(10 * SECOND)
    status = run_status(service)
    (channel,) = status.channels
    assert (channel.driver, channel.role, channel.mode, channel.state) == ("user-defined", None, "run", "open")
    assert channel.services == sum(block.done for block in status.blocks) > 20
    assert channel.errors == sum(channel.reasons.values()) == sum(block.failed for block in status.blocks)
    assert channel.load is not None
    assert 0 < channel.load < 1
    service.stop()
    assert run_status(service).channels[0].mode == "stop"


def test_errors_by_reason(tmp_path: Path) -> None:
    (tmp_path / "d.device.yaml").write_text("device: d\nprotocol: modbus-rtu\nstation: 1\n")
    (tmp_path / "r.run.yaml").write_text(
        "run: r\nmemory: masterlogic\nchannels:\n"
        "  1: {port: 'sim:d.device.yaml', protocol: modbus-rtu, station: 9, type: rs485}\n"
        "blocks:\n  0: {read: '40001', into: M0, every: 5 s}\n"
    )
    clock = VirtualClock()
    service = RunService(load_run(tmp_path / "r.run.yaml"), clock)
    service.start()
    clock.run_for(60 * SECOND)
    (channel,) = run_status(service).channels
    assert channel.line_type == "RS-485 half duplex"
    assert list(channel.reasons) == ["no_reply"]
    assert channel.errors == channel.reasons["no_reply"] > 1


def test_capture_and_status_of_a_virtual_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "x.jsonl"
    words = [
        "run",
        str(TWO),
        "--virtual",
        "--for",
        "2500ms",
        "--status-every",
        "1s",
        "--capture",
        str(path),
        "--json",
        "--frames",
    ]
    assert main(words) == 0
    lines = lines_of(capsys)
    statuses = [line for line in lines if line["event"] == "status"]
    assert [line["time"] for line in statuses] == [1.0, 2.0, 2.5]
    sent = [(line["channel"], line["bytes"]) for line in lines if line.get("direction") == "out"]
    with CaptureReader(path) as reader:
        captured = [(number, event) for number, event in reader.events() if event.direction == "out"]
    assert sorted((number, event.data.hex(" ").upper()) for number, event in captured) == sorted(sent)
    assert {line["result"] for line in lines if line["event"] == "frame"} == {"mldp client"}
    assert main(["run", str(TWO), "--virtual", "--for", "1s", "--frames", "--ascii"]) == 0
    assert "·07rSS0206%MW25006%MW260·77" in capsys.readouterr().out
    assert main(["run", str(TWO), "--virtual", "--for", "1s", "--capture", str(tmp_path / "x.pcap"), "--status"]) == 0
    assert "mldp client" in capsys.readouterr().out
    assert sorted(path.name for path in tmp_path.glob("*.pcap")) == ["x-1.pcap", "x-2.pcap"]


@pytest.mark.long
def test_the_output_of_a_run_cuts_no_transmission_into_pieces(tmp_path: Path) -> None:
    """The output of the first exchange is printed 20 ms after its start, while the second reply is transmitted."""
    (tmp_path / "d.device.yaml").write_text("device: d\nprotocol: modbus-rtu\nstation: 1\n")
    (tmp_path / "r.run.yaml").write_text(
        "run: r\nchannels:\n  1: {port: 'sim:d.device.yaml', protocol: modbus-rtu, station: 1}\n"
        "points:\n  door: {channel: 1, address: '10003'}\n  level: {channel: 1, address: '40010', type: float32}\n"
    )
    pieces = {}
    for name, options in {"shown": ["--frames"], "quiet": ["--quiet"]}.items():
        path = tmp_path / f"{name}.pcap"
        words = ["run", str(tmp_path / "r.run.yaml"), "--virtual", "--for", "2500ms", "--capture", str(path)]
        assert main([*words, *options]) == 0
        with CaptureReader(path) as reader:
            pieces[name] = [(event.at, event.direction, event.data.hex(" ")) for _, event in reader.events()]
    assert pieces["shown"] == pieces["quiet"]
    assert [len(data.split()) for _, direction, data in pieces["shown"] if direction == "in" and data] == [6, 9] * 3


def test_a_run_is_the_same_with_and_without_a_capture(tmp_path: Path) -> None:
    def shown(*words: str) -> str:
        command = [sys.executable, "-m", "framekit", "run", str(TWO), "--virtual", "--for", "1s", "--frames", *words]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout

    assert shown() == shown("--capture", str(tmp_path / "x.pcap"))


def test_what_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for words, what in (
        (("--status-every", "soon"), "--status-every: 'soon' is not a time"),
        (("--status-every", "0 s"), "above 0"),
        (("--capture", str(tmp_path / "none" / "x.pcap")), "none does not exist"),
    ):
        assert main(["run", str(TWO), "--virtual", "--for", "1s", *words]) == (1 if words[0] == "--capture" else 2)
        assert what in capsys.readouterr().err


def test_sigusr1_shows_the_status() -> None:
    command = [sys.executable, "-u", "-m", "framekit", "run", str(TWO), "--json", "--frames"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        while json.loads(process.stdout.readline())["event"] != "frame":
            pass
        process.send_signal(signal.SIGUSR1)
        while (line := json.loads(process.stdout.readline()))["event"] != "status":
            pass
        assert [channel["number"] for channel in line["channels"]] == [1, 2]
        process.send_signal(signal.SIGTERM)
        process.communicate(timeout=180)
        assert process.returncode == 0
    finally:
        process.kill()
        process.communicate()


def test_the_log_is_silent_unless_asked_for(capsys: pytest.CaptureFixture[str]) -> None:
    logger = logging.getLogger("framekit")
    before = list(logger.handlers)
    assert any(isinstance(handler, logging.NullHandler) for handler in before)
    begin_log(None)
    assert logger.handlers == before
    begin_log("info")
    logging.getLogger("framekit.service.driver").info("port lost")
    assert "INFO    framekit.service.driver: port lost" in capsys.readouterr().err
    begin_log(None)
    assert logger.handlers == before, "the log of an earlier verb ends"


@pytest.mark.usefixtures("small_heap")
@pytest.mark.parametrize("verb", ["run", "serve", "monitor"])
def test_a_capture_that_could_not_be_written_is_told_and_ends_with_status_1(
    verb: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(_Sink, "_write", lambda sink, records, number: sink.trouble.begins("the disk is full"))
    with PtyPair() as pair:
        words = {
            "run": [str(EXAMPLES / "third-party-plc.run.yaml"), "--virtual"],
            "serve": ["modbus-rtu", "--port", "pty:"],
            "monitor": ["modbus-rtu", "--port", pair.first],
        }[verb]
        assert main([verb, *words, "--for", "30ms", "--capture", str(tmp_path / "x.pcap")]) == 1
    assert "x.pcap: the disk is full" in capsys.readouterr().err
