"""Verbs that use a line by themselves: monitor, replay, loopback, and decode with a capture."""

from __future__ import annotations

import asyncio
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

from framekit.api.monitor import LineMonitor
from framekit.api.rows import fields_text
from framekit.cli.common import seen_data, seen_text
from framekit.cli.main import main
from framekit.codec.contents import contents_of
from framekit.definition.load.protocol import load_protocol
from framekit.link.events import Seen
from framekit.service.capture import Capture, CaptureReader
from framekit.transport.clock import VirtualClock
from framekit.transport.port import LineEvent
from framekit.transport.pty_port import PtyPair

MS = 1_000_000
ASK = bytes.fromhex("11 03 00 6B 00 03 76 87")
ANSWER = bytes.fromhex("11 03 06 AE 41 56 52 43 40 49 AD")
BAD = bytes.fromhex("11 03 00 6B 00 03 76 88")


def captured(path: Path, *pieces: tuple[str, bytes]) -> Path:
    capture = Capture(path, (1,), VirtualClock())
    for number, (direction, data) in enumerate(pieces):
        capture.write(1, LineEvent("data", (number + 1) * 100 * MS, direction, data))  # type: ignore[arg-type]
    capture.close()
    return path


@contextmanager
def process(*words: str) -> Iterator[subprocess.Popen[str]]:
    one = subprocess.Popen(
        [sys.executable, "-m", "framekit", *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        yield one
    finally:
        one.kill()
        one.communicate()


# ---- decode --capture -------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["x.pcap", "x.jsonl"])
def test_a_capture_of_one_side_is_decoded(tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    path = captured(tmp_path / name, ("out", ASK), ("in", ANSWER))
    assert main(["decode", "--capture", str(path), "modbus-rtu", "--json"]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [(line["direction"], line["frame"], line["result"]) for line in lines] == [
        ("out", "request_adu", "modbus-rtu client"),
        ("in", "reply_adu", "modbus-rtu server"),
    ]
    assert lines[0]["fields"]["pdu"] == {"read_holding": {"function": 3, "address": 107, "count": 3}}
    assert lines[1]["time_ns"] == 200 * MS


def test_a_capture_between_others_and_its_bad_frames(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = captured(tmp_path / "x.pcap", ("in", ASK), ("in", ANSWER), ("in", BAD))
    assert main(["decode", "--capture", str(path), "modbus-rtu"]) == 1
    out = capsys.readouterr().out
    assert out.startswith("00:00:00.100000  ch 1 ← request_adu")
    assert "(check at byte 6" in out
    assert out.splitlines()[-1].startswith("2 frames, 1 bad")
    assert main(["decode", "--capture", str(path), "modbus-rtu", "--bad", "--json"]) == 1
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert lines[0] | {"reason": "check", "offset": 6, "result": "unknown"} == lines[0]
    assert {line["event"] for line in lines} <= {"bad", "noise"}


def test_what_decode_refuses(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["decode", "modbus-rtu"])
    assert "HEX" in capsys.readouterr().err
    (tmp_path / "x").write_bytes(b"nothing")
    assert main(["decode", "--capture", str(tmp_path / "x"), "modbus-rtu"]) == 1
    assert "no pcap file" in capsys.readouterr().err
    path = captured(tmp_path / "x.pcap", ("in", ASK))
    assert main(["decode", "--capture", str(path), "modbus-rtu", "--param", "wings=2"]) == 2
    assert "no such parameter" in capsys.readouterr().err
    path.write_bytes(path.read_bytes()[:-13])
    assert main(["decode", "--capture", str(path), "modbus-rtu"]) == 0
    assert "not whole" in capsys.readouterr().err


# ---- replay -----------------------------------------------------------------------------------------------


def test_replay_on_a_real_port(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = captured(tmp_path / "x.pcap", ("out", ASK), ("in", ANSWER), ("out", BAD))
    with PtyPair() as pair:
        other = os.open(pair.second, os.O_RDWR | os.O_NOCTTY)
        try:
            assert main(["replay", str(path), "--port", pair.first, "--as-fast", "--json"]) == 0
            heard = b""
            while len(heard) < 16:
                heard += os.read(other, 100)
        finally:
            os.close(other)
    assert heard == ASK + BAD
    event = json.loads(capsys.readouterr().out)
    assert (event["sent"], event["pieces"], event["of"]) == (16, 2, 2)


def test_replay_to_whoever_connects(tmp_path: Path) -> None:
    path = captured(tmp_path / "x.pcap", ("out", ASK), ("in", ANSWER))
    words = ("--port", "tcp-listen://127.0.0.1:0", "--direction", "in", "--as-fast", "--json")
    with process("replay", str(path), *words) as one:
        assert one.stderr is not None and one.stdout is not None
        port = int(one.stderr.readline().rpartition(":")[2])
        with socket.create_connection(("127.0.0.1", port), timeout=180) as client:
            heard = b""
            while piece := client.recv(100):
                heard += piece
        assert heard == ANSWER
        event = json.loads(one.stdout.readline())
        assert (event["sent"], event["pieces"], one.wait(30)) == (len(ANSWER), 1, 0)


def test_what_replay_refuses(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = captured(tmp_path / "x.jsonl", ("out", ASK))
    for words, what in (
        (("--direction", "in"), "no bytes of direction in"),
        (("--speed-up", "0"), "above 0"),
        (("--format", "9X9"), "line format"),
        (("--channel", "7"), "no bytes"),
    ):
        assert main(["replay", str(path), "--port", "/dev/null", *words]) == 2
        assert what in capsys.readouterr().err
    assert main(["replay", str(path), "--port", "tcp-listen://here"]) == 2
    assert main(["replay", str(path), "--port", "tcp-listen://192.0.2.1:4000"]) == 3
    assert main(["replay", str(path), "--port", str(tmp_path / "none")]) == 3
    assert "no such device" in capsys.readouterr().err


# ---- loopback ---------------------------------------------------------------------------------------------


def test_loopback(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["loopback", "loop://", "--speeds", "9600,115200", "--formats", "8N1,7E1", "--json"]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [line["line"] for line in lines] == ["9600 8N1", "9600 7E1", "115200 8N1", "115200 7E1"]
    assert all(line["passed"] and line["sent"] == line["received"] for line in lines)
    assert main(["loopback", "/dev/there-is-none", "--speeds", "9600"]) == 1
    assert "no such device" in capsys.readouterr().out
    assert main(["loopback", "loop://", "--speeds", "fast"]) == 2
    assert "'fast' is not a speed" in capsys.readouterr().err


# ---- monitor ----------------------------------------------------------------------------------------------


def test_monitor_hears_both_sides_and_captures(tmp_path: Path) -> None:
    path = tmp_path / "heard.pcap"
    words = ("monitor", "--port", "{}", "modbus-rtu", "--json", "--capture", str(path))
    with PtyPair() as pair, process(*(word.format(pair.first) for word in words)) as one:
        assert one.stdout is not None
        assert json.loads(one.stdout.readline())["event"] == "open"
        other = os.open(pair.second, os.O_RDWR | os.O_NOCTTY)
        lines = []
        for data in (ASK, ANSWER, BAD):
            os.write(other, data)
            lines.append(json.loads(one.stdout.readline()))
        one.send_signal(signal.SIGTERM)
        out, errors = one.communicate(timeout=180)
        assert (one.returncode, errors) == (0, "")
        os.set_blocking(other, False)
        with pytest.raises(BlockingIOError):
            os.read(other, 1)  # no byte was sent
        os.close(other)
    assert [(line["event"], line.get("frame"), line["result"]) for line in lines] == [
        ("frame", "request_adu", "modbus-rtu client"),
        ("frame", "reply_adu", "modbus-rtu server"),
        ("bad", "request_adu", "unknown"),
    ]
    summary = json.loads(out.splitlines()[-1])
    assert summary | {"event": "line", "frames": 2, "bad": 1} == summary
    with CaptureReader(path) as reader:
        heard = b"".join(event.data for _, event in reader.events())
    assert heard == ASK + ANSWER + BAD


@pytest.mark.parametrize("options", [(), ("--bytes",)])
def test_monitor_names_sides_and_fields_or_shows_bytes(options: tuple[str, ...]) -> None:
    words = ("monitor", "--port", "{}", "modbus-rtu", *options)
    with PtyPair() as pair, process(*(word.format(pair.first) for word in words)) as one:
        assert one.stdout is not None
        assert one.stdout.readline().split()[1:] == ["open"]
        other = os.open(pair.second, os.O_RDWR | os.O_NOCTTY)
        lines = []
        for data in (ASK, ANSWER, BAD):
            os.write(other, data)
            lines.append(one.stdout.readline().rstrip().split(maxsplit=1)[1])
        os.close(other)
    if options:
        assert lines[0].split() == ["←", "request_adu", str(len(ASK)), *ASK.hex(" ").upper().split()]
        assert lines[1].split() == ["←", "reply_adu", str(len(ANSWER)), *ANSWER.hex(" ").upper().split()]
    else:
        assert lines[0] == "→ request_adu station=17 read_holding function=3 address=107 count=3"
        assert lines[1].startswith("← reply_adu station=17 read_holding_reply function=3 bytes=6 values='")
    assert "bad request_adu (check at byte" in lines[2] and BAD.hex(" ").upper() in lines[2]


def test_fields_in_one_line() -> None:
    data = "00 " * 30
    fields = {"level": 512, "name": "a b", "list": [1, 2], "pdu": {"read": {"at": 1, "data": data}}, "esc": "\x1b"}
    assert fields_text(fields) == f"level=512 name='a b' list=[1, 2] read at=1 data='{data[:40]} …' esc=\\x1b"


def test_a_monitor_of_datagrams_says_who_sent_them() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        number = free.getsockname()[1]

    async def scenario() -> list[Seen]:
        seen: list[Seen] = []
        protocol, came = load_protocol("modbus-rtu"), asyncio.Event()

        def show(event: Seen) -> None:
            seen.append(event)
            came.set()

        monitor = LineMonitor.at(protocol, f"udp-listen://127.0.0.1:{number}", show, line=None)
        monitor.start()
        for who in (None, *senders):
            if who is not None:
                who.sendto(ASK, ("127.0.0.1", number))
            await asyncio.wait_for(came.wait(), 60)
            came.clear()
        monitor.stop()
        return seen

    senders = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2)]
    try:
        seen = asyncio.run(scenario())
        names = [f"127.0.0.1:{sender.getsockname()[1]}" for sender in senders]
    finally:
        for sender in senders:
            sender.close()
    assert [event.client for event in seen if event.kind == "frame"] == names
    assert f"0.500  {names[0]} ← request_adu" in seen_text(seen[1], 0.5, "")
    assert seen_data(seen[1], 0.5, contents_of(load_protocol("modbus-rtu")))["client"] == names[0]


def test_monitor_filters_and_ascii() -> None:
    words = ("monitor", "--port", "{}", "mldp", "--ascii", "--filter", "%MW1")
    with PtyPair() as pair, process(*(word.format(pair.first) for word in words)) as one:
        assert one.stdout is not None
        assert one.stdout.readline().split()[1:] == ["open"]
        other = os.open(pair.second, os.O_RDWR | os.O_NOCTTY)
        os.write(other, bytes.fromhex("05 30 31 52 53 53 30 31 30 36 25 4D 57 32 30 30 04"))
        os.write(other, bytes.fromhex("05 30 31 52 53 53 30 31 30 36 25 4D 57 31 30 30 04"))
        line = one.stdout.readline()
        os.close(other)
    assert "read_individual" in line
    assert line.rstrip().endswith("·01RSS0106%MW100·")


def test_what_monitor_refuses(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for words, what in (
        (("--port", str(tmp_path / "none")), "no such device"),
        (("--port", "nowhere:1"), "is no port"),
        (("--port", "loop://", "--param", "wings=2"), "no such parameter"),
        (("--port", "loop://", "--format", "8"), "line format"),
    ):
        assert main(["monitor", "modbus-rtu", *words]) == (3 if what == "no such device" else 2)
        assert what in capsys.readouterr().err
