"""What takes a frame out of a buffer: for every kind of segment what measuring and decoding say, or less."""

from __future__ import annotations

from typing import Any

import pytest
from segment_cases import CASES, Case

from framekit.codec.codec import Codec, compile_protocol
from framekit.codec.errors import FrameError
from framekit.definition.load import load_protocol_text


def measured(codec: Codec, data: bytes, place: int) -> Any:
    """Bytes and values of the frame at a place; None and its size if its check code is wrong, and 0 if there is none.

    () if it has begun, None if nothing of that is sure.
    """
    size = codec.measure("f", data, place, len(data))
    if size <= 0:
        return () if codec.QUIET < size < 0 else (None, 0) if size == 0 else None
    try:
        return data[place : place + size], codec.decode("f", data[place : place + size])
    except FrameError as error:
        return (None, size) if error.cause == "check" and error.refuse is None else None


def takers(codec: Codec, data: bytes, place: int) -> list[Any]:
    found = [codec.frames["f"].take]
    if "f" in codec.together:
        at, table = codec.together["f"]
        found += [table[data[place + at]]] if place + at < len(data) else []
    return [take for take in found if take is not None]


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.title)
def test_nothing_is_taken_that_is_not_measured_and_decoded(case: Case) -> None:
    codec = compile_protocol(load_protocol_text(case.yaml))
    frame = case.bytes
    for before in (b"", b"\x10\x02"):
        place, data = len(before), before + frame + b"\x10\x03\x00"
        damaged = [
            before + frame[:at] + bytes([frame[at] ^ change]) + frame[at + 1 :] + behind
            for at in range(len(frame))
            for change in (1, 0x10, 0x80, 0xFF)
            for behind in (b"", b"\x00\x01\x10\x03")
        ]
        cut = [before + frame[:size] for size in range(len(frame))]
        for tried in (data, before + frame, *cut, *damaged):
            for take in takers(codec, tried, place):
                taken = take(tried, place, len(tried), codec.defaults)
                assert taken is None or taken == measured(codec, tried, place), tried.hex(" ")


def test_most_kinds_of_segments_are_taken() -> None:
    taken = 0
    for case in CASES:
        codec = compile_protocol(load_protocol_text(case.yaml))
        data = b"\xff" + case.bytes + b"\xff"
        found = [take(data, 1, len(data), codec.defaults) for take in takers(codec, data, 1)]
        taken += any(one and one[0] is not None for one in found)
    assert taken > len(CASES) * 0.6
