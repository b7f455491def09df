"""Recordings: content of the file, output, and the effects of lost ports, slow disks and stopped readers."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from framekit.cli.main import main
from framekit.definition.load.protocol import load_protocol
from framekit.definition.times import LineFormat
from framekit.extras.guess.record import ByteRows, ByteView, Heard, Recorder, usual_pause
from framekit.link.events import CharacterFault, LineFault
from framekit.service import capture as captures
from framekit.service.capture import Capture, CaptureDecoder, CaptureReader, PcapReader
from framekit.service.write_queue import WriteQueue
from framekit.transport.clock import VirtualClock
from framekit.transport.port import LineEvent, Port, PortEvents
from framekit.transport.pty_port import PtyPair

MS = 1_000_000
NINE = LineFormat(9600)
CHARACTER = NINE.character_time
ASK = bytes.fromhex("11 03 00 6B 00 03 76 87")
ANSWER = bytes.fromhex("11 03 06 AE 41 56 52 43 40 49 AD")


class Wire(Port):
    """A port that the test drives."""

    sees_damage = True

    def __init__(self, name: str, clock: VirtualClock) -> None:
        self.name, self.settings, self.clock = name, NINE, clock
        self.events: PortEvents | None = None
        self.is_there = True
        self.opened = 0
        self.sent: list[bytes | str] = []

    def open(self, events: PortEvents) -> None:
        self.opened += 1
        if self.is_there:
            self.events = events
            self.clock.call_soon(lambda: events.opened(self.clock.now()))
        else:
            self.clock.call_soon(lambda: events.closed(self.clock.now(), f"{self.name}: there is no such device"))

    def write(self, data: bytes) -> None:
        self.sent.append(data)

    def send_break(self, duration: int) -> None:
        self.sent.append("break")

    def close(self) -> None:
        self.events = None

    def hear(self, data: bytes, *faults: CharacterFault) -> None:
        assert self.events is not None
        self.events.received(data, self.clock.now(), faults)

    def lose(self) -> None:
        events, self.events, self.is_there = self.events, None, False
        assert events is not None
        events.closed(self.clock.now(), f"{self.name}: the device is gone")


class Bench:
    """A recorder on virtual time with one or two wires."""

    def __init__(self, path: Path | None, wires: int = 1, *, through: bool = False) -> None:
        self.clock = VirtualClock()
        self.wires = [Wire(f"wire{number}", self.clock) for number in range(wires)]
        self.shown: list[Heard] = []
        self.states: list[tuple[int, str]] = []
        capture = None if path is None else Capture(path, (1,), self.clock, later=True)
        self.recorder = Recorder(
            self.wires,
            self.clock,
            capture,
            self.shown.append,
            lambda *state: self.states.append(state),
            through=through,
        )
        self.recorder.start()
        self.clock.run_for(0)


def records_of(path: Path) -> int:
    with CaptureReader(path) as reader:
        return sum(1 for _ in reader._reader._records())  # type: ignore[union-attr]


def events_of(path: Path) -> list[LineEvent]:
    with CaptureReader(path) as reader:
        found = [event for _, event in reader.events()]
        assert not reader.is_cut
    return found


def until_written(queue: WriteQueue) -> None:
    with queue.change:
        assert queue.change.wait_for(lambda: not queue.waiting, timeout=60)


# ---- the file -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["x.pcap", "x.jsonl"])
def test_bytes_damage_breaks_and_losses_are_in_the_file(tmp_path: Path, name: str) -> None:
    bench = Bench(path := tmp_path / name)
    (wire,) = bench.wires
    bench.clock.run_for(100 * MS)
    wire.hear(b"\x01\x02\x03", CharacterFault(1, LineFault.FRAMING), CharacterFault(2, LineFault.PARITY))
    bench.clock.run_for(100 * MS)
    assert wire.events is not None
    wire.events.line_break(bench.clock.now())
    wire.lose()
    bench.clock.run_for(3000 * MS)
    assert wire.opened > 2, "it is tried again"
    wire.is_there = True
    bench.clock.run_for(5000 * MS)
    wire.hear(b"\x04")
    bench.recorder.stop()
    found = events_of(path)
    assert [event.kind for event in found] == ["open", "data", "break", "closed", "open", "data", "closed"]
    assert (found[1].at, found[1].data) == (100 * MS, b"\x01\x02\x03")
    assert found[1].faults == (CharacterFault(1, LineFault.FRAMING), CharacterFault(2, LineFault.PARITY))
    assert found[2].at == 200 * MS
    assert found[5].data == b"\x04"
    assert bench.recorder.problems == []
    counts = bench.recorder.wires[0].counts
    assert (counts.bytes, counts.framing, counts.parity, counts.breaks, counts.missing) == (4, 1, 1, 1, 0)
    assert [text for _, text in bench.states if text != "open"][:2] == [
        "wire0: the device is gone", "wire0: there is no such device",
    ]  # fmt: skip
    assert [heard.event.kind for heard in bench.shown] == [event.kind for event in found]
    assert wire.sent == [], "a recorder sends nothing"


@pytest.mark.parametrize("name", ["x.pcap", "x.jsonl"])
def test_two_ports_are_two_directions_that_are_decoded(tmp_path: Path, name: str) -> None:
    bench = Bench(path := tmp_path / name, wires=2)
    for _ in range(3):
        for wire, data in zip(bench.wires[::-1], (ASK, ANSWER), strict=True):
            bench.clock.run_for(50 * MS)
            wire.hear(data)
    bench.recorder.stop()
    data = [event for event in events_of(path) if event.kind == "data"]
    assert [event.direction for event in data] == ["out", "in"] * 3
    assert data[0].at == 50 * MS - len(ASK) * CHARACTER, "bytes that went out have the time of their first bit"
    assert data[1].at == 100 * MS
    decoder = CaptureDecoder(path, load_protocol("modbus-rtu"), line=NINE, client="out")
    assert [seen.frame for _, seen in decoder.seen() if seen.kind == "frame"] == ["request_adu", "reply_adu"] * 3


def test_through_passes_on_what_comes_at_one_port_to_the_other(tmp_path: Path) -> None:
    bench = Bench(path := tmp_path / "x.jsonl", wires=2, through=True)
    master, device = bench.wires
    master.hear(ASK)
    bench.clock.run_for(50 * MS)
    device.hear(ANSWER)
    assert device.events is not None
    device.events.line_break(bench.clock.now())
    assert (master.sent, device.sent) == ([ANSWER, "break"], [ASK])
    device.lose()
    master.hear(ASK)
    bench.recorder.stop()
    assert [(event.direction, event.data) for event in events_of(path) if event.data] == [
        ("in", ASK), ("out", ANSWER), ("in", ASK),
    ]  # fmt: skip
    assert bench.recorder.problems == ["8 bytes from wire0 not passed on: the other port is closed or slow"]


def test_what_waits_to_be_passed_on_is_bounded() -> None:
    bench = Bench(None, wires=2, through=True)
    fast, slow = bench.wires
    for _ in range(200):
        fast.hear(bytes(1000))
    waiting = len(slow.sent)
    assert 64 <= waiting <= 67
    assert slow.events is not None
    slow.events.sent(bench.clock.now())
    fast.hear(b"!")
    assert slow.sent[waiting:] == [b"!"]
    bench.recorder.stop()
    assert bench.recorder.problems[0].startswith(f"{(200 - waiting) * 1000} bytes from wire0 not passed on")


def test_what_a_killed_recorder_has_heard_is_there(tmp_path: Path) -> None:
    bench = Bench(path := tmp_path / "x.pcap")
    bench.wires[0].hear(ASK)
    until_written(bench.recorder._capture._sinks[1]._queue)  # type: ignore[union-attr]
    with path.open("rb") as file:
        assert [event.kind for _, event in PcapReader(file).events()] == ["open", "data"]
    bench.recorder.stop()


@pytest.mark.parametrize("name", ["x.pcap", "x.jsonl"])
def test_a_slow_disk_holds_up_nothing_and_the_file_says_what_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    go_on, writing = threading.Event(), threading.Event()
    write = captures._Sink.write_records

    def slow(sink: captures._Sink, records: bytes, number: int) -> None:
        writing.set()
        go_on.wait()
        write(sink, records, number)

    monkeypatch.setattr(captures, "MOST_WAITING", 2000)
    monkeypatch.setattr(captures._Sink, "write_records", slow)
    bench = Bench(path := tmp_path / name)
    writing.wait()
    sent = [bytes([number]) * 100 for number in range(60)]
    for data in sent[:50]:
        bench.clock.run_for(100 * MS)
        bench.wires[0].hear(data)
    assert len(bench.shown) == 51, "all has been heard while the disk stood still"
    go_on.set()
    for data in sent[50:]:
        until_written(bench.recorder._capture._sinks[1]._queue)  # type: ignore[union-attr]
        bench.clock.run_for(100 * MS)
        bench.wires[0].hear(data)
    bench.recorder.stop()
    found = events_of(path)
    data = [event.data for event in found if event.kind == "data"]
    missing = len(sent) - len(data)
    assert missing > 20 and data == sent[: 50 - missing] + sent[50:], "what is there is in order and whole"
    kinds = [event.kind for event in found]
    gap = 1 + 50 - missing
    assert kinds[:gap] == ["open"] + ["data"] * (50 - missing)
    assert kinds[gap : gap + 2] == ["closed", "open"]
    assert bench.recorder.problems == [
        f"{100 * missing} bytes are not in the file: it could not be written as fast as they came"
    ]


def test_missing_bytes_at_the_very_end_are_told_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(captures, "MOST_WAITING", 0)
    monkeypatch.setattr(WriteQueue, "add", _only_when_waiting(WriteQueue.add))
    bench = Bench(path := tmp_path / "x.jsonl")
    bench.wires[0].hear(ASK)
    bench.recorder.stop()
    assert [event.kind for event in events_of(path)] == ["closed", "open"]
    assert "missing here" in events_of(path)[0].reason
    assert bench.recorder.problems == ["8 bytes are not in the file: it could not be written as fast as they came"]


def _only_when_waiting(add: Callable[..., bool]) -> Callable[..., bool]:
    def refusing(queue: WriteQueue, record: bytes, *, wait: bool = False) -> bool:
        queue.most = 1 << 20 if wait else 0
        return add(queue, record, wait=wait)

    return refusing


@pytest.mark.parametrize("number", [1, 3])
def test_a_full_disk_is_told(tmp_path: Path, number: int) -> None:
    """The records are queued, and the writer thread writes them together."""
    full = tmp_path / "x.pcap"
    bench = Bench(full)
    sink = next(iter(bench.recorder._capture._sinks.values()))  # type: ignore[union-attr]
    queue = sink._queue  # type: ignore[union-attr]
    with queue.change:
        assert queue.change.wait_for(lambda: not queue.waiting, 60)
        os.dup2(descriptor := os.open("/dev/full", os.O_WRONLY), sink._sink._file.fileno())  # type: ignore[union-attr]
        os.close(descriptor)
        for _ in range(number):
            bench.wires[0].hear(ASK)
    bench.recorder.stop()
    (problem,) = bench.recorder.problems
    whole = Bench(tmp_path / "whole.pcap")
    for _ in range(number):
        whole.wires[0].hear(ASK)
    whole.recorder.stop()
    lost = records_of(tmp_path / "whole.pcap") - records_of(full)
    assert lost >= number and problem.endswith(f" {lost} records were lost")


def test_an_error_of_the_thread_that_writes_is_a_trouble_of_the_capture(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    raised: list[object] = []
    monkeypatch.setattr(threading, "excepthook", lambda hook: raised.append(hook.exc_type))
    bench = Bench(path := tmp_path / "x.jsonl")
    reports: list[str] = []
    bench.recorder.watch_troubles(lambda report: reports.append(report.text))
    later = next(iter(bench.recorder._capture._sinks.values()))  # type: ignore[union-attr]
    later._sink._file.write = None  # type: ignore[union-attr]
    bench.wires[0].hear(ASK)
    later._queue.thread.join(60)  # type: ignore[union-attr]
    bench.wires[0].hear(ASK)
    bench.recorder.stop()
    assert reports == [f"capture {path}: TypeError: 'NoneType' object is not callable – the capture ends here"]
    (problem,) = bench.recorder.problems
    assert problem.startswith(f"capture {path}: TypeError: 'NoneType' object is not callable, ")
    assert problem.endswith(" records were lost")
    assert raised == [TypeError]


def test_what_waits_for_a_slow_writer_is_bounded() -> None:
    go_on, written, numbers = threading.Event(), bytearray(), list[int]()

    def write(data: bytes, number: int) -> None:
        go_on.wait()
        written.extend(data)
        numbers.append(number)

    queue = WriteQueue(write, 100, "test")
    taken = [queue.add(bytes([number]) * 10) for number in range(40)]
    assert 10 <= taken.count(True) <= 20 and taken == sorted(taken, reverse=True)
    go_on.set()
    assert queue.add(b"end", wait=True)
    queue.close()
    assert bytes(written) == b"".join(bytes([number]) * 10 for number in range(taken.count(True))) + b"end"
    assert sum(numbers) == taken.count(True) + 1
    assert not queue.add(b"more")


# ---- what is shown --------------------------------------------------------------------------------------------


def heard(at: int, data: bytes, *faults: CharacterFault, wire: int = 0) -> Heard:
    way = ("in", "out")[wire]
    event = LineEvent("data", at, way, data, faults)  # type: ignore[arg-type]
    return Heard(wire, event, at - len(data) * CHARACTER, at)


def test_rows_show_hex_ascii_pauses_and_damage() -> None:
    rows = ByteRows(0, 5 * MS)
    found = rows.add(Heard(0, LineEvent("open", 0), 0, 0))
    found += rows.add(
        heard(50 * MS, b"\x02Hello", CharacterFault(0, LineFault.FRAMING), CharacterFault(5, LineFault.PARITY))
    )
    found += rows.add(heard(53 * MS, b"!\x03"))
    assert rows.deadline == 58 * MS
    found += rows.add(heard(200 * MS, bytes(range(0x41, 0x55)), wire=1))
    found += rows.add(Heard(0, LineEvent("break", 300 * MS, "in"), 300 * MS, 300 * MS))
    found += rows.add(Heard(0, LineEvent("closed", 400 * MS, reason="the device is gone"), 400 * MS, 400 * MS))
    assert found == [
        "     0.000             ← open",
        "     0.044             ← 02!48 65 6C 6C 6F?21 03                          ·Hello!·",
        "     0.179   126.2 ms  → 41 42 43 44 45 46 47 48 49 4A 4B 4C 4D 4E 4F 50  ABCDEFGHIJKLMNOP",
        "     0.196             → 51 52 53 54                                      QRST",
        "     0.300     100 ms  ← break",
        "     0.400     100 ms  ← closed the device is gone",
    ]
    assert (
        usual_pause(None) == 20 * MS
        and usual_pause(NINE) == 5 * CHARACTER
        and usual_pause(LineFormat(115200)) == 5 * MS
    )


def test_a_row_ends_after_a_pause_and_at_the_end() -> None:
    clock, rows = VirtualClock(), list[str]()
    view = ByteView(clock, 0, ByteRows(0, 5 * MS), rows.append)
    clock.run_for(10 * MS)
    view.show(heard(clock.now(), b"AB"))
    assert rows == []
    clock.run_for(5 * MS)
    assert len(rows) == 1 and rows[0].endswith("AB")
    view.show(heard(clock.now(), b"CD"))
    view.close()
    assert len(rows) == 2 and rows[1].endswith("CD")


# ---- the verb -------------------------------------------------------------------------------------------------


@contextmanager
def recording(*words: str) -> Iterator[subprocess.Popen[str]]:
    one = subprocess.Popen(
        [sys.executable, "-m", "framekit", "record", *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        yield one
    finally:
        one.kill()
        one.communicate()


@pytest.mark.parametrize("name", ["heard.pcap", "heard.jsonl"])
def test_a_line_is_recorded_until_ctrl_c_and_decoded(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    path = tmp_path / name
    with PtyPair() as pair, recording(pair.first, "-o", str(path), "--json") as one:
        assert one.stdout is not None
        assert json.loads(one.stdout.readline())["event"] == "open"
        other = os.open(pair.second, os.O_RDWR | os.O_NOCTTY)
        for data in (ASK, ANSWER):
            os.write(other, data)
            came = json.loads(one.stdout.readline())
            assert (came["event"], came["direction"], came["bytes"]) == ("data", "in", data.hex(" ").upper())
        one.send_signal(signal.SIGINT)
        out, errors = one.communicate(timeout=180)
        os.set_blocking(other, False)
        with pytest.raises(BlockingIOError):
            os.read(other, 1)  # no byte was sent
        os.close(other)
    assert one.returncode == 0
    assert errors == f"{pair.first}: damaged characters and breaks cannot be seen here, only bytes and times\n"
    summary = json.loads(out.splitlines()[-1])
    assert (summary["event"], summary["port"], summary["bytes"]) == ("line", pair.first, 19)
    assert "framing" not in summary, "what cannot be seen is not counted"
    assert [event.kind for event in events_of(path)] == ["open", "data", "data", "closed"]
    assert main(["decode", "--capture", str(path), "modbus-rtu"]) == 0
    assert capsys.readouterr().out.splitlines()[-1].startswith("2 frames, 0 bad")


def test_a_connection_that_is_lost_is_made_again(tmp_path: Path) -> None:
    path = tmp_path / "x.jsonl"
    with socket.create_server(("127.0.0.1", 0)) as server:
        url = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        with recording(url, "-o", str(path), "--json") as one:
            assert one.stdout is not None
            for data in (ASK, ANSWER):
                with server.accept()[0] as connection:
                    assert json.loads(one.stdout.readline())["event"] == "open"
                    connection.sendall(data)
                    assert json.loads(one.stdout.readline())["bytes"] == data.hex(" ").upper()
                assert json.loads(one.stdout.readline())["event"] == "closed"
            one.send_signal(signal.SIGTERM)
            _, errors = one.communicate(timeout=180)
    assert one.returncode == 0 and errors.count("trying again") == 2, "each loss is told once"
    assert [event.kind for event in events_of(path)] == ["open", "data", "closed"] * 2


def test_the_file_is_whole_when_its_shower_has_gone(tmp_path: Path) -> None:
    path = tmp_path / "x.pcap"
    with PtyPair() as pair, recording(pair.first, "-o", str(path)) as one:
        assert one.stdout is not None
        assert one.stdout.readline().endswith("open\n")
        one.stdout.close()
        other = os.open(pair.second, os.O_RDWR | os.O_NOCTTY)
        os.write(other, ASK)
        assert one.stderr is not None
        assert any("standard output: its reader has gone" in line for line in iter(one.stderr.readline, ""))
        one.send_signal(signal.SIGTERM)
        assert one.wait(60) == 0
        os.close(other)
    assert [event.kind for event in events_of(path)][-1] == "closed"


def test_a_conversation_goes_through_by_the_verb(tmp_path: Path) -> None:
    path = tmp_path / "x.pcap"
    with PtyPair() as one, PtyPair() as other:
        with recording(one.first, other.first, "--through", "-o", str(path), "--json") as process:
            assert process.stdout is not None
            assert {json.loads(process.stdout.readline())["event"] for _ in range(2)} == {"open"}
            master, device = (os.open(pair.second, os.O_RDWR | os.O_NOCTTY) for pair in (one, other))
            for sender, receiver, data in ((master, device, ASK), (device, master, ANSWER)) * 2:
                os.write(sender, data)
                came = b""
                while len(came) < len(data):
                    came += os.read(receiver, 100)
                assert came == data
            process.send_signal(signal.SIGINT)
            process.communicate(timeout=180)
            assert process.returncode == 0
        os.close(master)
        os.close(device)
    data = [(event.direction, event.data) for event in events_of(path) if event.data]
    assert data == [("in", ASK), ("out", ANSWER)] * 2


def test_two_ports_by_the_verb(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "x.jsonl"
    with PtyPair() as one, PtyPair() as other:
        assert main(["record", one.first, "--for", "1ms"]) == 0
        assert "recorded" not in capsys.readouterr().out
        assert main(["record", one.first, other.first, "-o", str(path), "--for", "1ms"]) == 0
    shown = capsys.readouterr()
    assert "← open" in shown.out and "→ open" in shown.out and f"recorded in {path}" in shown.out
    assert f"{one.first}: 0 bytes" in shown.out and f"{other.first}: 0 bytes" in shown.out
    assert shown.err.count("cannot be seen here") == 2


def test_speed_and_format_of_a_pseudo_terminal_cannot_be_found(capsys: pytest.CaptureFixture[str]) -> None:
    with PtyPair() as pair:
        words = ["--try", "--speeds", "9600,19200", "--formats", "8N1,7E1", "--each", "1ms"]
        assert main(["record", pair.first, *words]) == 1
        shown = capsys.readouterr()
        assert "4 settings of speed and format" in shown.err and shown.err.count("silence") == 4
        assert shown.out == "nothing was heard – is the line in use, and wired to this port?\n"
        assert main(["record", pair.first, *words, "--json"]) == 1
        found = json.loads(capsys.readouterr().out)
        assert (found["event"], found["certainty"], found["line"]) == ("found", "silent", None)


def test_what_record_refuses(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file, existing = str(tmp_path / "x.pcap"), tmp_path / "there.pcap"
    existing.write_bytes(b"precious")
    for status, words, what in (
        (2, ["loop://", "--quiet"], "name a file with -o"),
        (2, ["loop://", "-o", file, "--format", "8"], "line format"),
        (2, ["loop://", "-o", file, "--each", "1s"], "add --try"),
        (2, ["loop://", "-o", file, "--pause", "0s"], "above 0"),
        (2, ["loop://", "--try", "--speed", "9600"], "is what --try finds"),
        (2, ["loop://", "--try", "--speeds", "fast"], "'fast' is not a speed"),
        (2, ["loop://", "spy://", "--try"], "one port"),
        (2, ["tcp://127.0.0.1:1", "--try"], "has no speed"),
        (2, ["loop://", "--through"], "name the second one"),
        (2, ["nowhere:1", "-o", file], "is no port"),
        (2, ["loop://", "loop://", "-o", file], "named twice"),
        (2, ["loop://", "a", "b", "-o", file], "too many"),
        (3, [str(tmp_path / "none"), "-o", file], "no such device"),
        (3, ["loop://", str(tmp_path / "none"), "-o", file], "no such device"),
        (2, ["loop://", "-o", str(existing)], "is there already"),
        (3, [str(tmp_path / "none"), "--try"], "no such device"),
        (1, ["loop://", "-o", str(tmp_path / "no" / "x")], "no does not exist"),
    ):
        assert main(["record", *words]) == status, words
        assert what in capsys.readouterr().err, words
        assert not Path(file).exists(), "a recording of nothing does not stay"
    assert existing.read_bytes() == b"precious"
