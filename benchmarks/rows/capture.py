"""A capture of a million Modbus requests decoded in columns, compared with reading and decoding frame by frame.

And `framekit decode --capture` of requests and replies as users run it: the frames found, shown with their fields.
"""

from __future__ import annotations

import contextlib
import io
import random
import tempfile
from collections.abc import Iterator
from pathlib import Path

from benchmarks.cases import codec_of
from benchmarks.measure import compare_once
from benchmarks.row import Row, Target, faster, slower
from framekit.cli.main import main
from framekit.codec.codec import Codec
from framekit.codec.columns import Cut
from framekit.codec.errors import FrameError
from framekit.extras.batch.batch import BatchDecoder
from framekit.service.capture import GLOBAL_HEADER, CaptureReader, PcapRecords, cut_of_capture
from framekit.transport.port import LineEvent

NAME = "Decode of a capture of 1 million frames"
TARGET = "≥ 5 × faster by batch than one by one, same values"
AT_LEAST = Target("at least", 5)
FRAMES = 1_000_000
SHOWN = 20_000
DAMAGED = 0.001
FRAME = "request_adu"


def run(rounds: int) -> list[Row]:
    codec, rounds = codec_of("modbus-rtu"), min(rounds, 3)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "line.pcap"
        _write(path, codec)
        cut = cut_of_capture(path, "in")
        frames = [cut[index] for index in range(len(cut))]
        assert list(map(_told, BatchDecoder(codec, FRAME).decode(cut))) == [_told(_one(codec, data)) for data in frames]
        both = Path(folder) / "both.pcap"
        both.write_bytes(b"".join(requests_and_replies(codec, SHOWN)))
        found = compare_once(
            {
                "shown": lambda: _show(both),
                "shown one by one": lambda: _read_both(both, codec),
                "framekit": lambda: BatchDecoder(codec, FRAME).decode(cut_of_capture(path, "in")),
                "one by one": lambda: _read_one_by_one(path, codec),
                "cut by batch": lambda: BatchDecoder(codec, FRAME).decode(Cut.of(frames)),
                "cut one by one": lambda: [_one(codec, data) for data in frames],
            },
            rounds,
        )
    what = "1 million requests, decoded to columns"
    return [
        faster(f"{what}, from a file", "one by one", found["framekit"], found["one by one"], AT_LEAST, 1.0),
        faster(f"{what}, cut already", "one by one", found["cut by batch"], found["cut one by one"], None, 1.0),
        slower(f"decode --capture, {SHOWN} frames", "one by one", found["shown"], found["shown one by one"], None, 1.0),
    ]


def _write(path: Path, codec: Codec) -> None:
    choose, records = random.Random(3), PcapRecords(0)
    made = []
    for _ in range(5000):
        address, count = choose.randrange(65536), choose.randrange(1, 126)
        pdus = ({"read_holding": {"address": address, "count": count}}, {"read_coils": {"address": 1, "count": count}})
        data = codec.encode(FRAME, {"station": choose.randrange(1, 248), "pdu": choose.choice(pdus)})
        made.append(data if choose.random() >= DAMAGED else data[:-1] + bytes((data[-1] ^ 1,)))
    with path.open("wb") as file:
        file.write(GLOBAL_HEADER)
        for number in range(FRAMES):
            file.write(records.of(LineEvent("data", number * 1_000_000, "in", choose.choice(made))))


def requests_and_replies(codec: Codec, frames: int) -> Iterator[bytes]:
    """Return the pieces of a capture: a client polls, its requests are sent, the replies arrive."""
    choose, records = random.Random(3), PcapRecords(0)
    yield GLOBAL_HEADER
    for number in range(frames // 2):
        station, count = choose.randrange(1, 5), choose.randrange(1, 20)
        request = {"station": station, "pdu": {"read_holding": {"address": 1, "count": count}}}
        reply = {"station": station, "pdu": {"read_holding_reply": {"values": choose.randbytes(2 * count)}}}
        yield records.of(LineEvent("data", number * 100_000_000, "out", codec.encode(FRAME, request)))
        yield records.of(LineEvent("data", number * 100_000_000 + 50_000_000, "in", codec.encode("reply_adu", reply)))


def _show(path: Path) -> None:
    with contextlib.redirect_stdout(io.StringIO()) as shown:
        main(["decode", "modbus-rtu", "--capture", str(path)])
    assert shown.getvalue().endswith(f"{SHOWN} frames, 0 bad, 0 noise\n")


def _read_both(path: Path, codec: Codec) -> None:
    with CaptureReader(path) as reader:
        for _, event in reader.events():
            if event.kind == "data":
                codec.decode(FRAME if event.direction == "out" else "reply_adu", event.data)


def _one(codec: Codec, data: bytes) -> object:
    try:
        return codec.decode(FRAME, data)
    except FrameError as error:
        return error


def _told(result: object) -> object:
    return (result.cause, result.offset) if isinstance(result, FrameError) else result


def _read_one_by_one(path: Path, codec: Codec) -> list[object]:
    with CaptureReader(path) as reader:
        return [_one(codec, event.data) for _, event in reader.events() if event.kind == "data"]
