"""`framekit serve` as a process of its own on a pseudo-terminal or on TCP, ended by a signal."""

from __future__ import annotations

import asyncio
import json
import os
import select
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

import framekit
from framekit.api.server import aserve
from framekit.cli.main import main
from framekit.cli.serve_verb import ServeSession
from framekit.service.capture import CaptureReader
from framekit.transport.pty_port import PtyPair

LONGEST = 180
READ_M100 = b"\x0501rSB06%MW10001\x0492"
M100_IS_1234 = b"\x0601rSB01021234\x03FE"


@contextmanager
def serving(*words: str) -> Iterator[subprocess.Popen[str]]:
    process = subprocess.Popen(
        [sys.executable, "-m", "framekit", "serve", *words],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env={**os.environ, "PYTHONUNBUFFERED": ""},
    )  # fmt: skip
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def line_of(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    return process.stdout.readline().rstrip("\n")


def ended(process: subprocess.Popen[str], number: signal.Signals = signal.SIGTERM) -> str:
    """Return the remaining output of the process after the signal; assert exit status 0 without errors."""
    process.send_signal(number)
    output, errors = process.communicate(timeout=LONGEST)
    assert (process.returncode, errors) == (0, "")
    return output


def ask(descriptor: int, request: bytes, size: int) -> bytes:
    os.write(descriptor, request)
    reply = b""
    while len(reply) < size and select.select([descriptor], [], [], LONGEST)[0]:
        reply += os.read(descriptor, 256)
    return reply


@contextmanager
def opened(path: str) -> Iterator[int]:
    descriptor = os.open(path, os.O_RDWR | os.O_NOCTTY)
    try:
        yield descriptor
    finally:
        os.close(descriptor)


def test_the_status_is_shown_when_it_is_asked_for() -> None:
    words = ("mldp", "--station", "1", "--json", "--quiet", "--status-every", "1 h")
    with PtyPair() as pair, serving(*words, "--port", pair.first) as process:
        assert json.loads(line_of(process))["event"] == "ready"
        with opened(pair.second) as descriptor:
            assert len(ask(descriptor, READ_M100, len(M100_IS_1234))) == len(M100_IS_1234)
        process.send_signal(signal.SIGUSR1)
        assert json.loads(line_of(process))["event"] == "status"
        assert json.loads(line_of(process))["services"] == 1
        assert json.loads(line_of(process))["event"] == "line"
        assert json.loads(ended(process).splitlines()[0])["services"] == 1


def test_a_pseudo_terminal_and_sigterm() -> None:
    words = ("mldp", "--station", "1", "--set", "M100=0x1234", "--param", "answer_delay=1 ms")
    with PtyPair() as pair, serving(*words, "--port", pair.first) as process:
        assert line_of(process) == f"ready: mldp station 1 on {pair.first} at 9600 8N1"
        with opened(pair.second) as descriptor:
            assert ask(descriptor, READ_M100, len(M100_IS_1234)) == M100_IS_1234
            assert line_of(process).endswith("← read_continuous         19 " + READ_M100.hex(" ").upper())
            assert line_of(process).endswith("→ read_continuous_reply   17 " + M100_IS_1234.hex(" ").upper())
            refused = ask(descriptor, b"\x0501RSS0106%QW100\x04", 11)
            assert refused == b"\x1501RSS1132\x03"
            os.write(descriptor, READ_M100[:-1] + b"0")  # a wrong check code: no answer
            while "bad" not in line_of(process):
                pass
        summary = [line.split(maxsplit=1) for line in ended(process).splitlines() if line]
        assert ["1", "1         1"] in summary
        assert ["1", "refused 0x1132 unknown area letter  1"] in summary
        assert any(where == "line" and text.startswith("bad frame: check") for where, text in summary)


@pytest.mark.usefixtures("small_heap")
@pytest.mark.parametrize(
    ("words", "ready"),
    [
        (("snp-x",), "snp-x without a station of its own"),
        (("snp-x", "--station", "UNIT7"), "snp-x station UNIT7"),
        (("modbus-tcp",), "modbus-tcp station 1"),
        (("srtp",), "srtp"),
    ],
)
def test_the_ready_line_says_which_station_answers(
    capsys: pytest.CaptureFixture[str], words: tuple[str, ...], ready: str
) -> None:
    assert main(["serve", *words, "--port", "tcp://127.0.0.1:0", "--for", "1ms"]) == 0
    assert capsys.readouterr().out.startswith(f"ready: {ready} on tcp://127.0.0.1:")


def test_a_client_after_another_is_not_taken_for_it() -> None:
    """A DF1 receiver drops a command with the previous header, so each client starts with another number."""
    with serving("df1", "--role", "full", "--port", "pty:", "--json", "--quiet") as process:
        port = json.loads(line_of(process))["port"]
        for _ in range(2):
            with framekit.connect("df1", port, role="full", station=1, params={"reply_timeout": "2 s"}) as client:
                assert client.read("N7:0", 2) == [0, 0]


def test_stations_with_a_memory_each() -> None:
    with serving("mldp", "--station", "1,2", "--port", "pty:", "--json", "--quiet") as process:
        ready = json.loads(line_of(process))
        assert (ready["event"], ready["stations"], ready["line"]) == ("ready", [1, 2], "9600 8N1")
        with opened(ready["port"]) as descriptor:
            assert ask(descriptor, b"\x0502WSS0106%MW1001234\x04", 7) == b"\x0602WSS\x03"
            assert ask(descriptor, b"\x0501RSB06%MW10001\x04", 15) == b"\x0601RSB01020000\x03"
            assert ask(descriptor, b"\x0502RSB06%MW10001\x04", 15) == b"\x0602RSB01021234\x03"
        events = [json.loads(line) for line in ended(process, signal.SIGINT).splitlines()]
        assert [(line["station"], line["services"]) for line in events if line["event"] == "station"] == [
            (1, 1),
            (2, 2),
        ]


def test_a_listener_with_mapped_memory() -> None:
    places = ("holding=M500", "coil=M300", "input=P20", "input_register=M400")
    words = [word for place in places for word in ("--map", place)] + ["--set", "M509=4242", "--set", "P0020A=1"]
    memory = ("modbus-tcp", "--memory", "masterlogic")
    with serving(*memory, *words, "--port", "tcp-listen://127.0.0.1:0", "--json") as process:
        port = json.loads(line_of(process))["port"]
        with socket.create_connection(("127.0.0.1", int(port.rpartition(":")[2])), timeout=LONGEST) as client:
            client.sendall(bytes.fromhex("000100000006 01 03 0009 0001"))
            assert client.recv(64) == bytes.fromhex("000100000005 01 03 02 1092"), "register 10 is M509"
            client.sendall(bytes.fromhex("000200000006 01 02 0000 0010"))
            assert client.recv(64) == bytes.fromhex("000200000005 01 02 02 0004"), "input 11 is bit A of P20"
        seen = [json.loads(line_of(process)) for _ in range(5)]
        assert [line["event"] for line in seen] == ["open", "frame", "frame", "frame", "frame"]
        assert seen[2]["fields"]["pdu"]["read_holding_reply"]["values"] == "10 92" and seen[2]["station"] == 1
        events = [json.loads(line) for line in ended(process).splitlines()]
        assert events[-1]["connections"] == 1


@pytest.mark.parametrize(("name", "channels"), [("x.jsonl", [1, 2]), ("x.pcap", [1])])
def test_each_connection_is_a_channel_of_the_capture(tmp_path: Path, name: str, channels: list[int]) -> None:
    path = tmp_path / name
    with serving("modbus-tcp", "--port", "tcp://127.0.0.1:0", "--capture", str(path), "--json") as process:
        port = int(json.loads(line_of(process))["port"].rpartition(":")[2])
        for number in (1, 2):
            with socket.create_connection(("127.0.0.1", port), timeout=LONGEST) as client:
                client.sendall(bytes.fromhex(f"000{number}00000006 01 03 0009 0001"))
                assert len(client.recv(64)) == 11
        ended(process)
    with CaptureReader(path) as reader:
        found = [(channel, event.data) for channel, event in reader.events() if event.direction == "in"]
    assert sorted({channel for channel, _ in found}) == channels
    assert [data[1] for _, data in found] == [1, 2]


def test_a_device_that_answers_frames_by_its_own_sequences() -> None:
    device = Path(__file__).parents[2] / "examples" / "third-party-plc.device.yaml"
    with serving(str(device), "--port", "pty:", "--set", "M0=0x4241", "--quiet") as process:
        with opened(line_of(process).split()[3]) as descriptor:
            body = b"\x05WR44" + bytes(44) + b"\x04"
            reply = ask(descriptor, body + b"%02X" % (sum(body) % 256), 32)
            assert reply[:7] == b"\x02RD24AB"
        assert ended(process).splitlines()[-1].split() == ["-", "1", "0"]


def test_nobody_reads_the_output_any_more() -> None:
    """The device continues to answer, and a line on standard error reports it."""
    with serving("mldp", "--port", "pty:") as process:
        path = line_of(process).split()[5]
        assert process.stdout is not None
        process.stdout.close()
        with opened(path) as descriptor:
            for _ in range(2):
                os.write(descriptor, READ_M100)
                assert os.read(descriptor, 1)
        process.send_signal(signal.SIGTERM)
        assert process.wait(timeout=LONGEST) == 0 and process.stderr is not None
        errors = process.stderr.read()
        assert "standard output" in errors and "Traceback" not in errors


@pytest.mark.parametrize(
    ("words", "message", "status"),
    [
        (("mldp", "--port", "/dev/no-such"), "there is no such device", 3),
        (("mldp", "--port", "tcp://127.0.0.1:none"), "is not HOST:PORT", 2),
        (("mldp", "--port", "tcp-listen:127.0.0.1:502"), "is no port – write tcp-listen://HOST:PORT", 2),
        (("mldp", "--port", "tcp://192.0.2.1:4000"), "annot assign", 3),
        (("mldp", "--port", "what:"), "is no port", 2),
        (("modbus-pdu", "--port", "pty:"), "has no line of its own", 2),
        (("masterlogic.memory.yaml", "--port", "pty:"), "there is no", 2),
        (("mldp", "--port", "pty:", "--station", "32"), "--station 32: station 32 is not in 0..31", 2),
        (("ge-rtu", "--port", "pty:", "--station", "248"), "--station 248: station 248 is not in 0..247", 2),
        (("mldp", "--port", "pty:", "--station", "1,1"), "--station 1,1: station 1 stands here twice", 2),
        (("mldp", "--port", "pty:", "--set", "Q1=1"), "--set Q1=1: ", 2),
        (("mldp", "--port", "pty:", "--set", "M1"), "'M1' is not ADDRESS=VALUE", 2),
        (("mldp", "--port", "pty:", "--set", "M1=65536"), "does not fit", 2),
        (("mldp", "--port", "pty:", "--param", "retires=1"), "--param retires=1: 'mldp' has no parameter 'retires'", 2),
        (("mldp", "--port", "pty:", "--memory", "masterlogik"), "there is no memory profile 'masterlogik'", 2),
        (("mldp", "--port", "pty:", "--role", "servant"), "--role servant: there is no role 'servant'", 2),
        (("mldp", "--port", "pty:", "--format", "8X1"), "'8X1' is not a line format", 2),
        (("mldp", "--port", "pty:", "--for", "a while"), "--for: ", 2),
        (("modbus-tcp", "--port", "tcp://127.0.0.1:0", "--speed", "9600"), "neither speed nor format", 2),
        (("modbus-rtu", "--port", "pty:", "--memory", "masterlogic", "--map", "coils=M0"), "has no area 'coils'", 2),
        (("mldp", "--port", "pty:", "--status-every", "bogus"), "--status-every: 'bogus' is not a time", 2),
        (("mldp", "--port", "pty:", "--screen", "--status-every", "bogus"), "--status-every: 'bogus'", 2),
        (("mldp", "modbus-rtu", "--port", "pty:"), "two devices have the station 1", 2),
    ],
)
def test_what_cannot_be_served(
    capsys: pytest.CaptureFixture[str], words: tuple[str, ...], message: str, status: int
) -> None:
    assert main(("serve", *words)) == status
    output = capsys.readouterr()
    assert message in output.err and "Traceback" not in output.err and not output.out


def test_an_error_while_the_display_opens_the_port_ends_it(monkeypatch: pytest.MonkeyPatch) -> None:
    async def fails() -> None:
        raise OverflowError("a defect")

    async def drive() -> ServeSession:
        server = aserve("modbus-rtu", "pty:", station=1)
        monkeypatch.setattr(server, "open", fails)
        session = ServeSession(server, None)
        session.view = session.begin()
        while not session.is_over:
            await asyncio.sleep(0)
        await session.end()
        return session

    assert str(asyncio.run(drive()).failure) == "a defect"
