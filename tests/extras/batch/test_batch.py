"""Batch decoding gives the same values and faults as decoding frame by frame, with NumPy and without."""

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import framekit
from framekit.codec.codec import compile_protocol
from framekit.codec.columns import Cut
from framekit.codec.errors import FrameError
from framekit.definition.load.protocol import load_protocol
from framekit.extras.batch import batch as batches
from framekit.service.capture import Capture, CaptureError, cut_of_capture
from framekit.transport.clock import VirtualClock
from framekit.transport.port import LineEvent

Make = Callable[[random.Random], dict[str, Any]]


def request(choose: random.Random) -> dict[str, Any]:
    pdus: list[dict[str, Any]] = [
        {"read_holding": {"address": choose.randrange(65536), "count": choose.randrange(1, 126)}},
        {"read_coils": {"address": choose.randrange(65536), "count": choose.randrange(1, 2001)}},
        {"write_coil": {"address": choose.randrange(65536), "value": choose.choice(("ON", "OFF"))}},
        {"write_registers": {"address": 3, "count": 2, "values": choose.randbytes(4)}},
        {"mask_write": {"address": 7, "and_mask": choose.randrange(65536), "or_mask": 1}},
        {"report_id": {}},
    ]
    return {"station": choose.randrange(256), "pdu": choose.choice(pdus)}


def reply(choose: random.Random) -> dict[str, Any]:
    pdus: list[dict[str, Any]] = [
        {"read_holding_reply": {"values": choose.randbytes(2 * choose.randrange(1, 20))}},
        {"exception": {"function": choose.randrange(1, 100), "code": choose.randrange(1, 12)}},
        {"write_coil_reply": {"address": choose.randrange(65536), "value": "ON"}},
    ]
    return {"station": choose.randrange(256), "pdu": choose.choice(pdus)}


def write(choose: random.Random) -> dict[str, Any]:
    return {"payload": choose.randbytes(44)}


def individual(choose: random.Random) -> dict[str, Any]:
    return {"station": choose.randrange(32), "command": "r", "values": [{"data": choose.randbytes(2)}]}


CASES = [
    ("modbus-rtu", "request_adu", request),
    ("modbus-rtu", "reply_adu", reply),
    ("modbus-tcp", "request_adu", lambda choose: {**request(choose), "transaction": choose.randrange(65536)}),
    ("third-party-plc", "WR.REQ", write),  # a check code in digits: decoded frame by frame
    ("mldp", "read_individual_reply", individual),
]


def frames_of(protocol: str, frame: str, make: Make) -> list[bytes]:
    """Return some hundred frames; every tenth is damaged, cut or lengthened."""
    choose, codec = random.Random(7), compile_protocol(load_protocol(protocol))
    found = []
    for number in range(600):
        values = make(choose)
        values = {name: value for name, value in values.items() if name != "transaction" or protocol == "modbus-tcp"}
        data = bytearray(codec.encode(frame, values))
        if number % 10 == 3:
            data[choose.randrange(len(data))] ^= 1 << choose.randrange(8)
        elif number % 50 == 8:
            data = data[:-1] if number % 100 == 8 else data + b"\0"
        found.append(bytes(data))
    return [*found, b"", b"\x01"]


def comparable(result: dict[str, Any] | FrameError) -> Any:
    if isinstance(result, FrameError):
        return result.cause, result.segment, result.offset, result.refuse
    return result


def one_by_one(protocol: str, frame: str, frames: list[bytes]) -> list[Any]:
    codec, results = compile_protocol(load_protocol(protocol)), list[Any]()
    for data in frames:
        try:
            results.append(codec.decode(frame, data))
        except FrameError as error:
            results.append(comparable(error))
    return results


@pytest.mark.parametrize(("protocol", "frame", "make"), CASES, ids=[f"{case[0]} {case[1]}" for case in CASES])
@pytest.mark.parametrize("with_numpy", [True, False])
def test_batches_give_what_decode_gives(
    protocol: str, frame: str, make: Make, with_numpy: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not with_numpy:
        monkeypatch.setattr(batches, "numpy", None)
    frames = frames_of(protocol, frame, make)
    codec = compile_protocol(load_protocol(protocol))
    batch = batches.BatchDecoder(codec, frame).decode(Cut.of(frames))
    assert [comparable(result) for result in batch] == one_by_one(protocol, frame, frames)
    assert bool(batch.groups) == (with_numpy and protocol == "modbus-rtu")
    assert len(batch) == len(frames) and set(batch.faults) <= set(batch.singles)


def test_most_good_frames_are_in_columns() -> None:
    frames = frames_of("modbus-rtu", "request_adu", request)
    batch = framekit.load("modbus-rtu").decode_many(frames, "request_adu")
    good = len(batch) - len(batch.faults)
    assert sum(len(group.rows) for group in batch.groups) > 0.9 * good
    reads = next(group for group in batch.groups if ("pdu", "read_holding", "count") in group.columns)
    counts = reads.columns["pdu", "read_holding", "count"]
    assert counts.min() >= 1 and counts.max() <= 125


def test_what_is_refused_is_told_with_its_code() -> None:
    codec = compile_protocol(load_protocol("modbus-rtu"))
    good = codec.encode("request_adu", {"station": 1, "pdu": {"read_holding": {"address": 0, "count": 9}}})
    over = {**codec.defaults, "limit_read_words": 8}
    with pytest.raises(FrameError) as refused:
        batches.BatchDecoder(codec, "request_adu", over).decode(Cut.of([good, good]))[1]
    assert refused.value.refuse == 3


def test_an_index_outside_is_told() -> None:
    batch = framekit.load("modbus-rtu").decode_many([b""], "request_adu")
    with pytest.raises(IndexError):
        batch[1]


@pytest.mark.parametrize("name", ["line.pcap", "line.jsonl"])
def test_a_capture_is_cut_into_its_records(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    frames = [data for data in frames_of("modbus-rtu", "request_adu", request) if data]
    capture = Capture(path, [1], VirtualClock())
    for number, data in enumerate(frames):
        capture.write(1, LineEvent("data", 1000 * number, "in", data))
        capture.write(1, LineEvent("data", 1000 * number + 500, "out", b"\x01\x02"))
    capture.close()
    cut = cut_of_capture(path, "in")
    assert [cut[index] for index in range(len(cut))] == frames
    batch = framekit.load("modbus-rtu").decode_capture(path, "request_adu")
    assert [comparable(result) for result in batch] == one_by_one("modbus-rtu", "request_adu", frames)
    assert len(cut_of_capture(path, "out")) == len(frames)


def test_what_is_no_capture_is_told(tmp_path: Path) -> None:
    (tmp_path / "text").write_text("nothing of the kind, but long enough for a header")
    for name in ("text", "missing"):
        with pytest.raises(CaptureError, match=name):
            cut_of_capture(tmp_path / name, "in")
