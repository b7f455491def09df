"""Kinds of frames: the bytes that distinguish them, their number, and a definition of them that reads other frames."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from framekit.codec.checks import compute
from framekit.definition.model.checks import ready_methods
from framekit.extras.guess.draft import write_definition
from framekit.extras.guess.guess import guess
from framekit.extras.guess.model import Direction, Guess, HeardBytes
from framekit.extras.guess.recordings import reading_of

CHECK = ready_methods()["crc16-ibm-3740"]


def frame(text: bytes) -> bytes:
    return text + compute(CHECK, text).to_bytes(2, "big")


def exchanges(pairs: list[tuple[bytes, bytes]]) -> list[HeardBytes]:
    found = []
    for at, pair in enumerate(pairs):
        ways: tuple[Direction, Direction] = ("out", "in")
        for step, (way, text) in enumerate(zip(ways, pair, strict=True)):
            found.append(HeardBytes((at * 10 + step) * 20_000_000, way, frame(text)))
    return found


def meter(count: int, temperature: int, spread: int, seed: int) -> list[HeardBytes]:
    """Return requests with a counter, of three kinds, and replies of words, whose length field counts words."""
    rng, pairs, energy = random.Random(seed), list[tuple[bytes, bytes]](), 5000
    for at in range(count):
        first, number = [(0, 4), (4, 2), (6, 1)][at % 3]
        energy += rng.randint(1, 40)
        words = [
            temperature + rng.randint(-spread, spread), 1013 + rng.randint(-3, 3), rng.randint(0, 900), 1,
            energy >> 16, energy & 0xFFFF, rng.randint(150, 350),
        ][first : first + number]  # fmt: skip
        head = bytes([0x11, 0x10 + at & 0xFF])
        reply = b"".join(word.to_bytes(2, "big") for word in words)
        pairs.append((b"\xc3\x04" + head + bytes([0, first, 0, number]), bytes([0x3C, 2 + number]) + head + reply))
    return exchanges(pairs)


def names(found: Guess) -> list[str]:
    return [kind.name for kind in found.kinds]


@pytest.mark.parametrize(
    ("count", "temperature", "spread"), [(20, 215, 2), (40, 215, 30), (100, 250, 20), (200, 3000, 500)]
)
def test_a_measured_byte_tells_no_kinds_apart(tmp_path: Path, count: int, temperature: int, spread: int) -> None:
    found = guess(meter(count, temperature, spread, 2))
    assert names(found) == ["asked", "told"]
    draft = write_definition(found, tmp_path / "found.yaml", "meter")
    assert draft.problems == () and "{length: length, type: u8, of: [data], unit: words, plus: 2}" in draft.text
    others = reading_of(tmp_path / "found.yaml", meter(90, 900, 300, 7)).data
    assert (others["frames"], others["bad"], others["noise"]) == (180, 0, 0)


def test_what_drifts_tells_no_kinds_apart() -> None:
    """A slow number: its high byte increases once, at the same time as another byte."""
    rng, chunks = random.Random(3), []
    for at in range(60):
        late = at >= 30
        rest = bytes(rng.randrange(256) for _ in range(1 + at % 3 if late else 2))
        chunks.append(HeardBytes(at * 100_000_000, "in", frame(bytes([0x55, late, 4 + late]) + rest)))
    assert names(guess(chunks)) == ["frame"]


def test_what_request_and_reply_have_alike_tells_kinds_apart() -> None:
    """The reply has the function byte of the request with another bit set.

    An error has one more bit, and is counted.
    """
    rng, pairs = random.Random(5), []
    for at in range(60):
        function = at % 3 + 1
        body = bytes(rng.randrange(256) for _ in range([0, 2, 7, 4][function]))
        reply = bytes([9, 0x40 | function]) + body if at % 10 else bytes([9, 0xC0 | function, 4])
        pairs.append((bytes([9, function, rng.randrange(256)]), reply))
    found = guess(exchanges(pairs))
    assert {"told_41", "told_42", "told_43"} <= set(names(found))


def test_frames_of_other_layouts_are_kinds_without_requests() -> None:
    rng, chunks = random.Random(6), []
    for at in range(60):
        which = rng.choice([1, 2, 9])
        middle = {1: b"\x00\x07", 2: b"\xaa\xab", 9: b"\x10\x11\x12"}[which]
        text = bytes([0x55, which]) + middle + rng.randrange(1 << 16).to_bytes(2, "big")
        chunks.append(HeardBytes(at * 100_000_000, "in", frame(text)))
    assert sorted(names(guess(chunks))) == ["frame_01", "frame_02", "frame_09"]


def test_what_is_said_of_a_kind_is_counted_in_it() -> None:
    rng, pairs = random.Random(8), []
    for at in range(60):
        function = 0x20 + at % 5
        size = [3, 1, 6, 2, 9][at % 5]
        body = bytes(rng.randrange(256) for _ in range(size))
        pairs.append((bytes([7, at, function, 1]), bytes([7, at, function]) + body))
    found = guess(exchanges(pairs))
    statements = {statement.text: str(statement.evidence) for statement in found.statements}
    assert statements["told_20: byte 1 copy_1: as in the request"] == "12 of 12"
    answered = [text for text in statements if "is answered by" in text]
    assert answered and all("is answered by told_2" in text for text in answered)


def test_kinds_that_are_not_named_are_counted() -> None:
    rng, pairs = random.Random(8), []
    for at in range(60):
        codes = [0x20, 0x30, 0x40, 0x50, 0x60][rng.randrange(5)]
        pairs.append((bytes([7, at]), bytes([7, at, codes]) + bytes(rng.randrange(256) for _ in range(codes >> 4))))
    statements = [statement.text for statement in guess(exchanges(pairs)).statements]
    assert any(" or 2 more (" in text for text in statements)
    assert "asked: byte 1 copy_1: goes up by one from frame to frame; the reply repeats it" in statements


def test_a_length_in_words_is_said_in_words() -> None:
    found = guess(meter(40, 215, 30, 2))
    abouts = [field.about for kind in found.kinds for field in kind.fields if field.kind == "length"]
    assert set(abouts) == {"it counts words: the frame has twice that, and 2 bytes more"}
    assert any(statement.text.endswith("big end first; equal frames count once") for statement in found.statements)
