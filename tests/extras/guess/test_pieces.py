"""Recordings that are not cut at frame boundaries: the guess equals that of whole frames, or states less."""

from __future__ import annotations

import random
import sys
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path

import pytest
from extras.guess.recut import CUTS, byte_times, in_portions, timed
from spread import spread

from framekit.codec.checks import compute
from framekit.definition.model.checks import ready_methods
from framekit.extras.guess.guess import guess
from framekit.extras.guess.model import HeardBytes
from framekit.extras.guess.pieces import are_portions, other_cuttings, say_little

sys.path.insert(0, str(Path(__file__).parents[3]))
from benchmarks.guess_real import TRUTHS, case_of, judged_real

LINES = "16 bytes a line"
NOT_FROM_LINES = {
    "pymodbus-rtu", "minimalmodbus-rtu", "mbpoll-rtu", "mbpoll-silent", "pymodbus-silent", "df1", "melsec-4e",
    "melsec-3e-ascii", "melsec-1c", "osdp", "m-bus", "iec62056-21", "sbf", "msp",
}  # fmt: skip
"""Recordings whose frames are not found in streams without pauses."""


def held_against(name: str, cut: str, count: int = 80) -> None:
    """Compare the guess for a recording cut like this with the guess for whole frames."""
    case = case_of(name, count)
    ways = {way: b"".join(chunk.data for chunk in case.chunks if chunk.direction == way) for way in ("in", "out")}
    frames = timed(
        [HeardBytes(None, "in" if way == "in" else "out", ways[way][begin:end]) for way, begin, end in case.spans]
    )
    marks = judged_real(replace(case, chunks=CUTS[cut](frames)))
    assert marks.wrong == []
    if cut != LINES or name not in NOT_FROM_LINES:
        whole = judged_real(replace(case, chunks=frames))
        assert marks.framing
        assert (marks.check, marks.length) == (whole.check, whole.length)


QUICK = [
    ("pymodbus-rtu", "byte by byte"), ("shdlc", "every 16 ms"), ("nmea", LINES), ("ubx", "50 % in two"),
    ("osdp", "byte by byte"), ("mewtocol", "20 % in two"), ("mbpoll-silent", "every 16 ms"), ("msp", "every 16 ms"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "cut"), QUICK)
def test_pieces_do_not_change_what_is_said(name: str, cut: str) -> None:
    held_against(name, cut, 40)


ALL = list(product(TRUTHS, CUTS))


@pytest.mark.parametrize(("name", "cut"), spread(ALL, len(ALL), first=len(ALL), part=4))
def test_pieces_of_any_recording_do_not_change_what_is_said(name: str, cut: str) -> None:
    held_against(name, cut)


MODBUS = ready_methods()["crc16-modbus"]


def polled(count: int) -> list[bytes]:
    """Return requests and replies of Modbus RTU, in turns."""
    rng, found = random.Random(5), list[bytes]()
    for _ in range(count):
        size = rng.randrange(1, 6)
        request = bytes([rng.choice([1, 2]), 3, 0, rng.randrange(100), 0, size])
        reply = request[:2] + bytes([2 * size]) + rng.randbytes(2 * size)
        found += [frame + compute(MODBUS, frame).to_bytes(2, "little") for frame in (request, reply)]
    return found


def test_on_one_wire_a_reply_that_comes_with_its_request_is_a_frame_of_its_own() -> None:
    frames = polled(40)
    now, heard = 0, list[HeardBytes]()
    for at, frame in enumerate(frames):
        now += len(frame) * 1_000_000 + (6_000_000 if at % 2 else 100_000_000)
        heard.append(HeardBytes(now, "in", frame))
    for cut in (byte_times, in_portions):
        found = guess(cut(heard))
        assert found.check is not None and found.check.name == "crc16-modbus"
        assert [frame.data for frame in found.frames] == frames
    together = [HeardBytes(None, "in", asked + told) for asked, told in zip(frames[::2], frames[1::2], strict=True)]
    assert [frame.data for frame in guess(together).frames] == frames


def random_pieces(size: int, count: int) -> list[HeardBytes]:
    rng = random.Random(size)
    return [HeardBytes(None, "in", rng.randbytes(size)) for _ in range(count)]


@pytest.mark.parametrize("size", [1, 16])
def test_pieces_of_one_size_are_no_frames_of_that_size(size: int) -> None:
    statements = guess(random_pieces(size, 40)).statements
    assert [statement.is_sure for statement in statements] == [False]
    assert "where frames end was not found" in statements[0].text


def test_pieces_of_one_size_with_a_mark_are_frames() -> None:
    heard = [chunk._replace(data=b"\xaa\x55" + chunk.data[2:]) for chunk in random_pieces(16, 30)]
    statements = guess(heard).statements
    assert {"a frame begins with AA 55", "every frame has 16 bytes"} <= {statement.text for statement in statements}


def sizes_of(pieces: Sequence[HeardBytes]) -> list[int]:
    return [len(piece.data) for piece in pieces]


def test_cuttings_of_a_line() -> None:
    frames = timed([HeardBytes(None, "out" if at % 2 == 0 else "in", one) for at, one in enumerate(polled(10))])
    heard = byte_times(frames)
    assert say_little(heard) and are_portions(heard)
    assert not say_little(frames) and not are_portions(frames)
    found = other_cuttings(heard)
    assert [cut.kind for cut in found] == ["pauses", "whole"]  # cuts at turns equal cuts at pauses
    assert sizes_of(found[0].pieces) == sizes_of(frames)
    assert len(found[1].pieces) == 2
