"""Unknown lines: framing, fields and sides, random protocols of the score, and the verbs."""

from __future__ import annotations

import json
import random
import sys
from pathlib import Path

import pytest

from framekit.cli.main import main
from framekit.codec.checks import compute
from framekit.definition.model.checks import ready_methods
from framekit.definition.sources import shipped_folder
from framekit.extras.guess.differences import differences
from framekit.extras.guess.draft import write_definition
from framekit.extras.guess.guess import guess
from framekit.extras.guess.known_lines import INDEX, index_text, known_protocols
from framekit.extras.guess.model import Direction, Guess, HeardBytes, LengthField
from framekit.extras.guess.recordings import HeardError, heard, reading_of

sys.path.insert(0, str(Path(__file__).parents[3]))
from benchmarks.guess_score import draw_case, judged

MODBUS = ready_methods()["crc16-modbus"]


def rtu(data: bytes) -> bytes:
    return data + compute(MODBUS, data).to_bytes(2, "little")


def polls(count: int, one_wire: bool = False) -> list[HeardBytes]:
    """Return polls of Modbus RTU with two stations and three functions."""
    rng, found = random.Random(1), list[HeardBytes]()
    for at in range(count):
        head = bytes([rng.choice([1, 2]), rng.choice([3, 3, 4, 6])])
        size = rng.randrange(1, 9)
        request = reply = head + rng.randrange(100).to_bytes(2, "big") + rng.randrange(65536).to_bytes(2, "big")
        if head[1] != 6:
            request = request[:4] + size.to_bytes(2, "big")
            reply = head + bytes([2 * size]) + bytes(rng.randrange(256) for _ in range(2 * size))
        now = at * 100_000_000
        found.append(HeardBytes(now, "" if one_wire else "out", rtu(request)))
        found.append(HeardBytes(now + 20_000_000, "" if one_wire else "in", rtu(reply)))
    return found


FUNCTIONS = ["asked_03", "asked_04", "asked_06", "told_03", "told_04", "told_06"]


@pytest.mark.parametrize("one_wire", [False, True])
def test_requests_and_replies_are_told_apart(one_wire: bool) -> None:
    found = guess(polls(40, one_wire))
    assert found.framing is not None and found.framing.kind == "pauses" and len(found.frames) == 80
    assert found.check is not None and found.check.name == "crc16-modbus"
    assert [kind.name for kind in found.kinds] == FUNCTIONS
    reply_kind = next(kind for kind in found.kinds if kind.name == "told_03")
    assert [(field.name, field.kind) for field in reply_kind.fields] == [
        ("copy_0", "copy"), ("function", "constant"), ("count", "count"), ("data", "value"), ("check", "check"),
    ]  # fmt: skip


def test_long_recordings_are_seen_from_both_sides() -> None:
    rng = random.Random(3)
    ways: list[Direction] = ["out", "in"]
    chunks = [
        HeardBytes(None, ways[at % 2], rtu(bytes([1, at % 2, rng.randrange(256)]) + bytes(3 * (at % 2))))
        for at in range(4200)
    ]
    found = guess(chunks)
    assert found.noise == 0 and [len(kind.frames) for kind in found.kinds] == [2100, 2100]


def test_a_stream_without_pieces_is_cut_by_its_length_field() -> None:
    rng, data = random.Random(2), b""
    for at in range(60):
        inner = bytes([1, 3]) + bytes(rng.randrange(256) for _ in range(rng.choice([4, 7, 11])))
        data += at.to_bytes(2, "big") + b"\0\0" + len(inner).to_bytes(2, "big") + inner
    found = guess([HeardBytes(None, "in", data)])
    assert found.framing is not None and len(found.frames) == 60
    length = found.framing.length
    assert length is not None and length.end == LengthField(4, 2, "big", 6).end and length.plus == 6


def test_frames_in_two_pieces_are_put_together_where_the_check_says_so() -> None:
    chunks = []
    for chunk in polls(40):
        is_cut = chunk.time is not None and chunk.time % 700_000_000 == 0
        parts = [chunk.data[:2], chunk.data[2:]] if is_cut else [chunk.data]
        chunks += [chunk._replace(data=part) for part in parts]
    assert len(chunks) > 80
    assert [frame.data for frame in guess(chunks).frames] == [chunk.data for chunk in polls(40)]


@pytest.mark.parametrize(
    "chunks", [[], [HeardBytes(0, "", b"")], [HeardBytes(0, "", b"A")], [HeardBytes(None, "in", bytes(9))] * 3]
)
def test_little_is_said_of_little(chunks: list[HeardBytes]) -> None:
    found = guess(chunks)
    assert not any(statement.is_sure for statement in found.statements) and found.check is None


def test_made_up_protocols() -> None:
    marks = [judged(draw_case(seed)) for seed in range(36)]
    assert sum(mark.framing for mark in marks) >= 34
    checks = [mark.check for mark in marks if mark.check is not None]
    assert sum(checks) >= 0.94 * len(checks)
    assert sum(len(mark.wrong) for mark in marks) <= 2


def test_hex_text_is_read(tmp_path: Path) -> None:
    path = tmp_path / "heard.txt"
    path.write_text("# a line\n> 01 03\n1.5 < 0103,0A\n\n02:04 tx\n".replace("02:04 tx", "tx: 02:04"), "utf-8")
    assert heard(path) == [
        HeardBytes(None, "out", b"\1\3"), HeardBytes(1_500_000_000, "in", b"\1\3\n"), HeardBytes(None, "out", b"\2\4"),
    ]  # fmt: skip
    path.write_text("02 54 31\n0254 31\n", "utf-8")  # the first byte must not be read as a time
    assert [chunk.data for chunk in heard(path)] == [b"\x02T1", b"\x02T1"]
    path.write_text("01 03\n01 0G\n", "utf-8")
    with pytest.raises(HeardError, match=r"heard.txt:2:1: this is no line of hex digits"):
        heard(path)
    path.write_text("0x01 0x03\n", "utf-8")
    with pytest.raises(HeardError, match=r"heard.txt:1:1: this is no line of hex digits"):
        heard(path)


@pytest.mark.parametrize("data", [b"\xff\xfe\0", b"\x7e\1\2\x7e", b"$GPGLL,4916.45,N*31\r\n$GPGLL,4916.46,N*32\r\n"])
def test_a_file_of_bytes_is_read(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "heard.bin"
    path.write_bytes(data)
    assert heard(path) == [HeardBytes(None, "", data)]


def test_connections_of_a_pcap_file_are_read(tmp_path: Path) -> None:
    dpkt = pytest.importorskip("dpkt")
    one, two = b"\x7f\0\0\1", b"\x7f\0\0\2"
    with (tmp_path / "some.pcap").open("wb") as file:
        writer = dpkt.pcap.Writer(file, linktype=dpkt.pcap.DLT_RAW)
        sent = [(one, two, 10, b"ask"), (two, one, 50, b"told"), (one, two, 10, b"ask more"), (one, two, 18, b"!")]
        for at, (source, target, number, data) in enumerate(sent):
            ports = (5000, 502) if source == one else (502, 5000)
            tcp = dpkt.tcp.TCP(sport=ports[0], dport=ports[1], seq=number, data=data)
            ip = dpkt.ip.IP(src=source, dst=target, p=dpkt.ip.IP_PROTO_TCP, data=tcp)
            ip.len = len(ip)
            writer.writepkt(ip, ts=float(at))
    found = heard(tmp_path / "some.pcap")
    assert [piece[1:] for piece in found] == [("out", b"ask"), ("in", b"told"), ("out", b" more"), ("out", b"!")]


def test_a_protocol_that_is_there_is_named() -> None:
    assert [protocol.name for protocol in known_protocols(polls(10))] == ["modbus-rtu", "ge-rtu"]
    assert known_protocols([HeardBytes(None, "", b"T=21.5 ")] * 9) == []


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "protocol"),
    [
        ("pymodbus-ascii", "modbus-ascii"), ("nmea", "nmea0183"), ("ubx", "ubx"), ("osdp", "osdp"), ("shdlc", "shdlc"),
        ("dynamixel-2", "dynamixel"), ("mewtocol", "mewtocol"),
    ],
)  # fmt: skip
def test_a_program_not_written_here_is_named(name: str, protocol: str) -> None:
    chunks = heard(Path(__file__).parents[2] / "data" / "guess" / f"{name}.pcap")
    assert protocol in [protocol.name for protocol in known_protocols(chunks)]


@pytest.mark.long
def test_the_index_of_first_bytes_is_that_of_the_definitions() -> None:
    assert (shipped_folder("frames") / INDEX).read_text("utf-8") == index_text()


def test_a_definition_is_written_checked_and_read_back(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = "".join(f"{'>' if chunk.direction == 'out' else '<'} {chunk.data.hex(' ')}\n" for chunk in polls(40))
    (tmp_path / "heard.txt").write_text(text, "utf-8")
    written = tmp_path / "meter.yaml"
    assert main(["guess", str(tmp_path / "heard.txt"), "--write", str(written)]) == 0
    assert "this is modbus-rtu: 80 frames" in capsys.readouterr().out
    assert main(["check", str(written)]) == 0 and main(["test", str(written)]) == 0
    capsys.readouterr()
    assert main(["guess", str(tmp_path / "heard.txt"), "--with", str(written), "--json"]) == 0
    output = json.loads(capsys.readouterr().out)
    assert (output["frames"], output["bad"], output["noise"]) == (80, 0, 0)
    assert main(["guess", str(tmp_path / "heard.txt"), "--write", str(written)]) == 2
    assert "is there already" in capsys.readouterr().err
    assert main(["guess", str(tmp_path / "heard.txt"), "--write", str(tmp_path / "A B.yaml")]) == 1
    assert "is no name of a protocol" in capsys.readouterr().err


def test_what_differs_between_two_recordings(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rng = random.Random(4)
    for name, switch in (("off", 0), ("on", 1)):
        frames = [rtu(bytes([2, 3, switch, rng.randrange(256), rng.randrange(256)])) for _ in range(20)]
        (tmp_path / name).write_text("".join(f"{frame.hex()}\n" for frame in frames), "utf-8")
    assert main(["diff", str(tmp_path / "off"), str(tmp_path / "on")]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split() for line in lines[1:]] == [["frame", "2", "unknown_1", "00", "01"]]
    assert main(["diff", str(tmp_path / "off"), str(tmp_path / "off")]) == 0
    assert capsys.readouterr().out == "no field differs\n"


def of_one_direction(found: Guess) -> list[str]:
    return [kind.name for kind in found.kinds]


def test_nothing_is_stuffed_where_marks_explain_all() -> None:
    rng = random.Random(8)
    texts = [f"$WIMWV,{rng.randrange(360)},R,{rng.randrange(300) / 10},N,A*09\r\n".encode() for _ in range(60)]
    words = [f"T={rng.uniform(-30, 30):+.1f} C P={rng.randrange(900, 1100)}\r\n".encode() for _ in range(60)]
    framed = [
        b"\xeb\x90" + bytes(rng.randrange(256) for _ in range(rng.choice([4, 7, 9]))) + b"\xaa" for _ in range(60)
    ]
    for frames in (texts, words, framed):
        found = guess([HeardBytes(None, "", frame) for frame in frames])
        assert found.framing is not None and found.framing.stuffing is None
        assert [frame.data for frame in found.frames] == frames


def test_a_counter_is_as_wide_as_its_carries_show() -> None:
    rng = random.Random(9)

    def counters(first: int, width: int) -> list[tuple[int, int]]:
        numbers = [(first + at).to_bytes(4, "big")[4 - width :] for at in range(60)]
        frames = [b"\x02" + number + b"\x07" + bytes([rng.randrange(256)]) for number in numbers]
        found = guess([HeardBytes(None, "", frame) for frame in frames])
        return [(field.offset, field.size) for kind in found.kinds for field in kind.fields if field.kind == "counter"]

    assert counters(10, 1) == [(1, 1)]
    assert counters(230, 2) == [(1, 2)]  # a carry into the high byte
    assert counters(10, 2) == [(2, 1)]  # none


def test_a_port_that_hears_both_sides_is_one_wire() -> None:
    chunks = [chunk._replace(direction="in") for chunk in polls(40)]
    assert of_one_direction(guess(chunks)) == FUNCTIONS
    alone = [HeardBytes(at * 10_000_000, "in", rtu(bytes([7, at, 3, at * 7 & 255]))) for at in range(40)]
    assert of_one_direction(guess(alone)) == ["frame"]


def test_data_of_varying_size_is_compared_byte_by_byte() -> None:
    rng = random.Random(10)

    def recording(pump: int) -> list[HeardBytes]:
        sizes = [rng.choice([2, 5]) for _ in range(40)]
        return [
            HeardBytes(None, "", rtu(bytes([0xA5, size, pump]) + bytes(rng.randrange(256) for _ in range(size))))
            for size in sizes
        ]

    found = differences(recording(0), recording(1))
    assert [(piece.offset, piece.first, piece.second) for piece in found] == [(2, "00", "01")]


@pytest.mark.parametrize(("name", "start"), [("crc16-arc", b""), ("lrc8", b""), ("crc16-arc", b"\x10\x02")])
def test_a_code_behind_the_end_mark_is_found(name: str, start: bytes, tmp_path: Path) -> None:
    """As in DF1: the CRC covers the content without stuffing and the ETX, the sum covers the content only."""
    rng, chunks = random.Random(13), list[HeardBytes]()
    for _ in range(40):
        data = bytes(rng.choice([0x10, rng.randrange(256)]) for _ in range(rng.choice([5, 8, 12])))
        counted = start + data + b"\x03" if name == "crc16-arc" else data
        method = ready_methods()[name]
        code = compute(method, counted).to_bytes(method.size, "little")
        chunks.append(HeardBytes(None, "out", b"\x10\x02" + data.replace(b"\x10", b"\x10\x10") + b"\x10\x03" + code))
        chunks.append(HeardBytes(None, "in", b"\x10\x06"))
    found = guess(chunks)
    assert found.framing is not None and (found.framing.end, found.framing.behind) == (b"\x10\x03", len(code))
    assert found.check is not None and found.check.name == name
    assert [frame.data for frame in found.frames] == [chunk.data for chunk in chunks]
    path = tmp_path / "found.yaml"
    assert write_definition(found, path, "made up").problems == ()
    reading = reading_of(path, chunks).data
    assert (reading["frames"], reading["bad"], reading["noise"]) == (80, 0, 0)


@pytest.mark.parametrize(("start", "counted"), [(b"\x10\x02", 2), (b"\x10\x02", 1), (b"\x7e", 1)])
def test_a_check_in_a_wrap_counts_the_start_mark(start: bytes, counted: int, tmp_path: Path) -> None:
    rng, chunks = random.Random(17), list[HeardBytes]()
    for number in range(40):
        data = bytes([0x3A, 0x27, *(rng.choice([0x10, 0x7D, 0x7E, rng.randrange(256)]) for _ in range(4 + number % 7))])
        data += compute(ready_methods()["crc16-modbus"], start[-counted:] + data).to_bytes(2, "little")
        if start == b"\x7e":
            inner, end = data.replace(b"\x7d", b"\x7d\x5d").replace(b"\x7e", b"\x7d\x5e"), start
        else:
            inner, end = data.replace(b"\x10", b"\x10\x10"), b"\x10\x03"
        chunks.append(HeardBytes(None, "", start + inner + end))
    found = guess(chunks)
    assert found.check is not None and found.check.name == "crc16-modbus"
    assert found.check.place.start == len(start) - counted
    path = tmp_path / "found.yaml"
    assert write_definition(found, path, "made up").problems == ()
    assert f"over: {len(start) - counted}..here" in path.read_text("utf-8")
    reading = reading_of(path, chunks).data
    assert (reading["frames"], reading["bad"], reading["noise"]) == (40, 0, 0)


def test_a_check_that_begins_within_a_field_of_a_wrap_is_left_out(tmp_path: Path) -> None:
    rng, chunks = random.Random(19), list[HeardBytes]()
    for number in range(40):
        data = bytes([0x3A, 0x27, *(rng.choice([0x10, rng.randrange(256)]) for _ in range(4 + number % 7))])
        data += compute(ready_methods()["crc16-modbus"], data[1:]).to_bytes(2, "little")
        chunks.append(HeardBytes(None, "", b"\x10\x02" + data.replace(b"\x10", b"\x10\x10") + b"\x10\x03"))
    found = guess(chunks)
    assert found.check is not None and found.check.place.start == 3
    path = tmp_path / "found.yaml"
    assert write_definition(found, path, "made up").problems == ()
    assert "# crc16-modbus, counted from byte 3 on: no name stands where that" in path.read_text("utf-8")
    reading = reading_of(path, chunks).data
    assert (reading["frames"], reading["bad"], reading["noise"]) == (40, 0, 0)


@pytest.mark.parametrize(("form", "shown"), [("decimal", "03d"), ("hex", "04X")])
def test_a_length_as_digits_is_found(form: str, shown: str, tmp_path: Path) -> None:
    rng, chunks = random.Random(14), list[HeardBytes]()
    for _ in range(60):
        data = "".join(rng.choice("ABCDEFGHxyz=.") for _ in range(rng.choice([4, 9, 13, 22, 31])))
        chunks.append(HeardBytes(None, "", f"#{len(data):{shown}}{data}!".encode()))
    found = guess(chunks)
    assert found.framing is not None and found.framing.length is not None
    assert (found.framing.length.offset, found.framing.length.form) == (1, form)
    assert [frame.data for frame in found.frames] == [chunk.data for chunk in chunks]
    path = tmp_path / "found.yaml"
    assert write_definition(found, path, "made up").problems == ()
    reading = reading_of(path, chunks).data
    assert (reading["frames"], reading["bad"], reading["noise"]) == (60, 0, 0)
