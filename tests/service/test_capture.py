"""Captures can be read again, by framekit and by tshark; captures of killed writers and files of other programs."""

from __future__ import annotations

import json
import shutil
import struct
import subprocess
import sys
from pathlib import Path
from types import FrameType

import pytest

from framekit.codec.codec import compile_protocol
from framekit.codec.plain import PlainValues
from framekit.definition.load.protocol import load_protocol
from framekit.link.events import CharacterFault, LineFault
from framekit.service.capture import Capture, CaptureDecoder, CaptureError, CaptureReader
from framekit.transport.clock import VirtualClock
from framekit.transport.port import LineEvent
from framekit.transport.simulated_line import SimulatedLine

PARITY, FRAMING, OVERRUN = LineFault.PARITY, LineFault.FRAMING, LineFault.OVERRUN
HEAD = '{"capture": "framekit", "version": 1}\n'
EVENTS = [
    LineEvent("open", 0),
    LineEvent("data", 1_000_000_001, "out", bytes.fromhex("01 03 00 00 00 02 C4 0B")),
    LineEvent("data", 1_012_345_678, "in", b"abcdef", (CharacterFault(0, PARITY), CharacterFault(3, FRAMING))),
    LineEvent("data", 1_012_345_999, "in", b"xy", (CharacterFault(1, OVERRUN),)),
    LineEvent("control", 1_100_000_000, lines={"cts": True, "ri": True}),
    LineEvent("control", 1_200_000_000, lines={"ri": False}),
    LineEvent("break", 1_300_000_000),
    LineEvent("closed", 2_000_000_000),
]


def written(path: Path, events: list[LineEvent], channels: tuple[int, ...] = (1,)) -> Path:
    capture = Capture(path, channels, VirtualClock())
    for event in events:
        capture.write(channels[0], event)
    capture.close()
    assert not capture.problems
    return path


def read(path: Path) -> list[LineEvent]:
    with CaptureReader(path) as reader:
        found = [event for _, event in reader.events()]
        assert not reader.is_cut
    return found


@pytest.mark.parametrize("name", ["x.pcap", "x.jsonl"])
def test_what_is_written_is_read_again(tmp_path: Path, name: str) -> None:
    assert read(written(tmp_path / name, EVENTS)) == EVENTS


def test_long_data_is_one_piece_again(tmp_path: Path) -> None:
    event = LineEvent("data", 5, "out", bytes(range(256)) * 600)
    assert read(written(tmp_path / "x.pcap", [event])) == [event]


def test_the_layout_of_a_record(tmp_path: Path) -> None:
    """The page of LINKTYPE_RTAC_SERIAL: two times, event type, control lines, footer; big-endian."""
    lines = LineEvent("control", 0, lines={"cts": True, "rts": True})
    event = LineEvent("data", 1_600_000_000_123_456_789, "out", b"\x05\x06")
    data = written(tmp_path / "x.pcap", [lines, event]).read_bytes()
    assert struct.unpack("<IHHiIII", data[:24]) == (0xA1B23C4D, 2, 4, 0, 0, 65535, 250)
    record = data[24 + 16 + 12 :]
    assert struct.unpack("<IIII", record[:16]) == (1_600_000_000, 123_456_789, 14, 14)
    assert record[16:30] == struct.pack(">IIBBH", 1_600_000_000, 123_456, 1, 0x01 | 0x08, 0) + b"\x05\x06"


@pytest.mark.parametrize("name", ["x.pcap", "x.jsonl"])
def test_a_killed_writer_leaves_a_file_that_can_be_read(tmp_path: Path, name: str) -> None:
    """All records before the last are complete, however much of the last record was written."""
    path = tmp_path / name
    capture = Capture(path, (1,), VirtualClock())
    sizes = [path.stat().st_size]
    for event in EVENTS[:4]:
        capture.write(1, event)
        sizes.append(path.stat().st_size)  # a record is in the file at once
    whole = path.read_bytes()
    for size in range(sizes[0], len(whole) + 1):
        path.write_bytes(whole[:size])
        with CaptureReader(path) as reader:
            found = [event for _, event in reader.events()]
            complete = [number for number, end in enumerate(sizes) if end <= size][-1]
            assert found[:complete] == EVENTS[:complete]
            if name.endswith("jsonl"):
                assert reader.is_cut == (size not in sizes)


@pytest.mark.parametrize(
    ("data", "what"),
    [
        (b"", "no pcap file"),
        (b"PK\x03\x04" + bytes(40), "no pcap file"),
        (struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 1), "link type 1 – serial lines are 250"),
        (b"{}\n", "no capture"),
        (b'{"capture": "framekit", "version": 9}\n', "version 9"),
        (b'{"capture": "framekit", "version": 1}\n{"event": "data"}\n', "line 2 is no event"),
        (b'{"capture": "framekit", "version": 1}\n[1]\n', "line 2 is no event"),
        (b'{"capture": ' + b"[" * 100_000 + b"\n", "no capture"),
        (b'{"capture": "framekit", "version": 1}\n' + b"[" * 100_000 + b"\n", "line 2 .* nested too deeply"),
        (b'{"capture": "framekit", "version": 1}\n{"event": ' + b"[" * 100_000 + b"\n", "nested too deeply"),
        *(
            (f'{HEAD}{{"event": "open", "channel": {channel}, "time_ns": {time}}}\n'.encode(), "number is too large")
            for channel, time in ((1, "Infinity"), (1, 1 << 64), (1, -(10**400)), (10**400, 1), (-1, 1))
        ),
    ],
)
def test_files_that_are_no_captures(tmp_path: Path, data: bytes, what: str) -> None:
    path = tmp_path / "x"
    path.write_bytes(data)
    with pytest.raises(CaptureError, match=what), CaptureReader(path) as reader:
        list(reader.events())
    with pytest.raises(CaptureError, match="No such file"):
        CaptureReader(tmp_path / "none.pcap")


def test_files_of_others_with_microseconds_and_the_other_byte_order(tmp_path: Path) -> None:
    path = tmp_path / "x.pcap"
    serial = struct.pack(">IIBBH", 7, 8, 2, 0, 0) + b"hello"
    record = struct.pack(">IIII", 7, 8, len(serial), len(serial)) + serial
    unknown = struct.pack(">IIII", 7, 9, 12, 12) + struct.pack(">IIBBH", 7, 9, 0x77, 0, 0)
    path.write_bytes(struct.pack(">IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 250) + record + unknown)
    assert read(path) == [LineEvent("data", 7_000_008_000, "in", b"hello")]


def test_several_channels_have_a_pcap_file_each(tmp_path: Path) -> None:
    capture = Capture(tmp_path / "run.pcap", (1, 2), VirtualClock())
    capture.write(1, LineEvent("data", 1, "in", b"one"))
    capture.write(2, LineEvent("data", 2, "in", b"two"))
    capture.close()
    assert capture.paths == [tmp_path / "run-1.pcap", tmp_path / "run-2.pcap"]
    assert [read(path)[0].data for path in capture.paths] == [b"one", b"two"]
    capture = Capture(tmp_path / "run.jsonl", (1, 2), VirtualClock())
    capture.write(2, LineEvent("data", 2, "in", b"two"))
    capture.close()
    lines = [json.loads(line) for line in (tmp_path / "run.jsonl").read_text().splitlines()]
    assert lines[1] == {"time_ns": 2, "channel": 2, "event": "data", "direction": "in", "bytes": "74 77 6F"}


def test_a_full_disk_stops_the_capture_and_nothing_else(tmp_path: Path) -> None:
    if not Path("/dev/full").exists():
        pytest.skip("there is no /dev/full here")
    with pytest.raises(OSError, match="space"):
        Capture(Path("/dev/full"), (1,), VirtualClock())


class Listening:
    """Recorder of port events."""

    def __init__(self) -> None:
        self.told: list[tuple[str, bytes]] = []

    def opened(self, now: int) -> None:
        self.told.append(("opened", b""))

    def received(self, data: bytes, now: int, faults: tuple[CharacterFault, ...] = ()) -> None:
        self.told.append(("received", data))

    def line_break(self, now: int) -> None:
        self.told.append(("break", b""))

    def sent(self, now: int) -> None:
        self.told.append(("sent", b""))

    def closed(self, now: int, reason: str) -> None:
        self.told.append(("closed", b""))

    def control(self, lines: object, now: int) -> None:
        self.told.append(("control", b""))


def test_a_port_with_a_capture_around_it_behaves_as_before(tmp_path: Path) -> None:
    clock = VirtualClock()
    line = SimulatedLine(clock, None, latency=1000)
    capture = Capture(tmp_path / "x.jsonl", (3,), clock)
    port, other = capture.around(3, line.port("mine")), line.port("other")
    mine, theirs = Listening(), Listening()
    port.open(mine)
    other.open(theirs)
    clock.run_for(10_000)
    port.write(b"question")
    clock.run_for(10_000)
    other.write(b"answer")
    clock.run_for(10_000)
    port.close()
    port.write(b"not sent")
    clock.run_for(10_000)
    capture.close()
    assert mine.told == [("opened", b""), ("sent", b""), ("received", b"answer")]
    assert ("received", b"question") in theirs.told
    shown = [(event.kind, event.direction, event.data) for event in read(tmp_path / "x.jsonl")]
    assert shown == [("open", "", b""), ("data", "out", b"question"), ("data", "in", b"answer"), ("closed", "", b"")]


@pytest.mark.skipif(shutil.which("tshark") is None, reason="tshark is not installed")
def test_tshark_reads_it(tmp_path: Path) -> None:
    path = written(tmp_path / "x.pcap", EVENTS)
    fields = ["-e", "rtacser.eventtype", "-e", "frame.len", "-e", "rtacser.cts"]
    done = subprocess.run(
        ["tshark", "-r", str(path), "-T", "fields", *fields], capture_output=True, text=True, check=True
    )
    rows = [line.split("\t") for line in done.stdout.splitlines()]
    kinds = [int(row[0], 16) for row in rows]
    assert kinds == [0, 1, 8, 4, 7, 4, 4, 10, 0, 0, 9, 5, 6]
    assert [int(row[1]) for row in rows][1:3] == [20, 13]


def test_functions_called_for_each_frame_of_a_capture(tmp_path: Path) -> None:
    """Reading, scanning, decoding and displaying the fields; the count was 106 when records were scanned twice."""
    protocol = load_protocol("modbus-rtu")
    codec, plain = compile_protocol(protocol), PlainValues(protocol)
    request = codec.encode("request_adu", {"station": 1, "pdu": {"read_holding": {"address": 1, "count": 2}}})
    reply = codec.encode("reply_adu", {"station": 1, "pdu": {"read_holding_reply": {"values": b"1234"}}})
    line = [
        LineEvent("data", n * 1_000_000_000, "in" if n % 2 else "out", reply if n % 2 else request) for n in range(200)
    ]
    decoder = CaptureDecoder(written(tmp_path / "line.pcap", line), protocol)
    frames, calls = [], 0

    def note(frame: FrameType, event: str, argument: object) -> None:
        nonlocal calls
        calls += event == "call"

    found = ((seen.frame, plain.to_plain(seen.frame, seen.fields)) for _, seen in decoder.seen())
    frames += [next(found) for _ in range(100)]  # work done once is not counted
    sys.setprofile(note)
    try:
        frames += found
    finally:
        sys.setprofile(None)
    assert [frame for frame, _ in frames] == ["request_adu", "reply_adu"] * 100
    assert frames[1][1] == {
        "station": 1,
        "pdu": {"read_holding_reply": {"function": 3, "bytes": 4, "values": "31 32 33 34"}},
    }
    assert calls / 100 <= 76, calls


def test_a_port_closed_while_bytes_still_leave_it_is_shown_closed_after_them(tmp_path: Path) -> None:
    request = bytes.fromhex("01 03 00 00 00 02 C4 0B")
    path = written(tmp_path / "x.pcap", [LineEvent("data", 1_000, "out", request), LineEvent("closed", 2_000)])
    seen = [one for _, one in CaptureDecoder(path, load_protocol("modbus-rtu")).seen()]
    assert [(event.kind, event.frame) for event in seen] == [("frame", "request_adu"), ("closed", "")]
    assert seen[0].at == seen[1].at > 2_000
