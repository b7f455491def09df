"""Undetected errors of 8-bit check codes, measured and compared with theory; docs/protocols gives these figures."""

from __future__ import annotations

import math
from random import Random

import pytest

from framekit.codec.codec import compile_protocol
from framekit.codec.errors import FrameError
from framekit.definition.load.protocol import load_protocol
from framekit.link.values import Names

FEW, TRIES = 2_000, pytest.param(20_000, marks=pytest.mark.long)
"""Number of damaged blocks; the bounds below are four standard deviations for this number."""


def passes(flips: int, seed: int, tries: int) -> float:
    """Return the share of blocks with this number of wrong bits, at random places of data and check, that pass."""
    codec = compile_protocol(load_protocol("ccm"))
    names = Names({"left": 256})
    random = Random(seed)
    good = codec.encode("block", {"data": random.randbytes(256), "end": 0x03}, names)
    places = [place for place in range(len(good)) if place not in (0, len(good) - 2)]
    bits = [(place, bit) for place in places for bit in range(8)]
    taken = 0
    for _ in range(tries):
        data = bytearray(good)
        for place, bit in random.sample(bits, flips):
            data[place] ^= 1 << bit
        try:
            codec.decode("block", bytes(data), names)
        except FrameError:
            continue
        taken += 1
    return taken / tries


@pytest.mark.parametrize("tries", [FEW, TRIES])
@pytest.mark.parametrize(("flips", "theory"), [(1, 0.0), (2, 1 / 8), (3, 0.0), (4, 176 / 4096)])
def test_exclusive_or_of_all_bytes(flips: int, theory: float, tries: int) -> None:
    """Wrong bits cancel if every column has an even number of them: 8 of 64 pairs, 8 + 3 · 56 of 4,096 quadruples."""
    measured = passes(flips, flips, tries)
    assert abs(measured - theory) <= 4 * math.sqrt(theory * (1 - theory) / tries)


@pytest.mark.parametrize("tries", [FEW, TRIES])
@pytest.mark.parametrize(("flips", "theory"), [(1, 0.0), (2, 1 / 8), (3, 0.0), (4, 176 / 4096)])
def test_exclusive_or_turned_by_one_bit_a_byte(flips: int, theory: float, tries: int) -> None:
    """Rotation does not help: each message bit still changes one code bit, and an eighth of them the same bit."""
    codec = compile_protocol(load_protocol("snp"))
    random = Random(flips)
    data = random.randbytes(256)
    names = Names(codec.defaults | {"announced": 264})
    good = codec.encode("data_message", {"type": 0x54, "data": data}, names)
    bits = [(place, bit) for place in range(2, 258) for bit in range(8)]
    taken = 0
    for _ in range(tries):
        damaged = bytearray(good)
        for place, bit in random.sample(bits, flips):
            damaged[place] ^= 1 << bit
        try:
            codec.decode("data_message", bytes(damaged), names)
        except FrameError:
            continue
        taken += 1
    measured = taken / tries
    assert abs(measured - theory) <= 4 * math.sqrt(theory * (1 - theory) / tries)


@pytest.mark.parametrize("tries", [FEW, TRIES])
@pytest.mark.parametrize(("wrong", "theory"), [(1, 0.0), (2, 1 / 254), (3, 253 / 254**2)])
def test_sum_of_all_bytes(wrong: int, theory: float, tries: int) -> None:
    """Bytes are replaced at random, none by a DLE; the last replacement must cancel the others."""
    codec = compile_protocol(load_protocol("df1"))
    names = Names({"check_kind": "bcc", "max_packet": 250})
    random = Random(wrong)
    packet = {"reply": {"dst": 0, "src": 1, "cmd": 15, "tns": 7, "data": bytes(range(0x20, 0x80))}}
    good = codec.encode("message", {"packet": packet}, names)
    others = [value for value in range(256) if value != 0x10]
    taken = 0
    for _ in range(tries):
        data = bytearray(good)
        for place in random.sample(range(8, 8 + 96), wrong):
            data[place] = random.choice([value for value in others if value != data[place]])
        try:
            codec.decode("message", bytes(data), names)
        except FrameError:
            continue
        taken += 1
    measured = taken / tries
    assert abs(measured - theory) <= 4 * math.sqrt(theory * (1 - theory) / tries)


@pytest.mark.parametrize("damage", ["swapped", "inserted", "removed"])
def test_what_a_sum_of_all_bytes_never_sees(damage: str) -> None:
    """Swapped bytes, and inserted or removed bytes of 0, do not change the sum."""
    codec = compile_protocol(load_protocol("df1"))
    names = Names({"check_kind": "bcc", "max_packet": 250})
    packet = {"reply": {"dst": 0, "src": 1, "cmd": 15, "tns": 7, "data": bytes(range(0x20, 0x40)) + bytes(4)}}
    data = bytearray(codec.encode("message", {"packet": packet}, names))
    if damage == "swapped":
        data[10], data[20] = data[20], data[10]
    elif damage == "inserted":
        data.insert(12, 0)
    else:
        del data[data.index(b"\x3f\0") + 1]
    taken = codec.decode("message", bytes(data), names)
    assert taken["packet"]["reply"]["data"] != packet["reply"]["data"]
    crc = codec.encode("message", {"packet": packet}, Names({"check_kind": "crc", "max_packet": 250}))
    damaged = bytes(data[:-1]) + crc[-2:]
    with pytest.raises(FrameError):
        codec.decode("message", damaged, Names({"check_kind": "crc", "max_packet": 250}))
