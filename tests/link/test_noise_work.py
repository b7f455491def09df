"""Noise costs little a byte, however it is cut: calls are counted, so that no other load on the machine matters."""

from __future__ import annotations

import sys
from functools import cache
from random import Random
from typing import Any

import pytest
from shipped import PROTOCOLS

from framekit.codec.codec import compile_protocol
from framekit.definition.load import load_protocol
from framekit.link.engine import Engine

SIZE = 12_000
MOST = 60
"""Calls of functions for each byte of random noise: the dearest of the shipped protocols needs about half of it."""


@cache
def compiled(name: str) -> tuple[Any, Any]:
    protocol = load_protocol(name)
    return protocol, compile_protocol(protocol)


def engine(name: str, role: str | None) -> Engine:
    protocol, codec = compiled(name)
    own: Any = {"number": 1, "text": "A", "bytes": bytes(protocol.station.size or 0)}.get(protocol.station.type)
    made = Engine(protocol, codec, role, own=own)
    made.opened(0)
    return made


def calls(name: str, role: str | None, pieces: list[bytes]) -> tuple[int, Engine]:
    """How many functions are called while these pieces come one right after the other."""
    hearing, count = engine(name, role), 0

    def counted(frame: object, event: str, argument: object) -> None:
        nonlocal count
        count += event in ("call", "c_call")

    sys.setprofile(counted)
    try:
        for number, piece in enumerate(pieces):
            hearing.receive(piece, 1_000_000_000 + 1000 * number)
    finally:
        sys.setprofile(None)
    return count, hearing


def cut(data: bytes, size: int) -> list[bytes]:
    return [data[place : place + size] for place in range(0, len(data), size)]


SIDES = [(name, role) for name in PROTOCOLS if name != "standard" for role in [*load_protocol(name).roles] or [None]]


@pytest.mark.parametrize(("name", "role"), SIDES, ids=str)
@pytest.mark.parametrize("size", [64, 1500, SIZE])
def test_a_byte_of_random_noise_takes_few_calls(name: str, role: str | None, size: int) -> None:
    data = Random(1).randbytes(SIZE)
    count, hearing = calls(name, role, cut(data, size))
    assert count / len(data) < MOST
    counters = hearing.counters
    assert counters.noise_bytes or counters.bad or hearing.receiver.stream.buffer or hearing.receiver.broken


@pytest.mark.parametrize(("name", "role"), SIDES, ids=str)
def test_the_work_a_byte_does_not_grow_with_the_noise(name: str, role: str | None) -> None:
    data = Random(2).randbytes(8 * SIZE)
    few, many = calls(name, role, cut(data[: 2 * SIZE], 1500))[0], calls(name, role, cut(data, 1500))[0]
    assert many < 4 * few * 1.5 + 20_000


@pytest.mark.parametrize("name", ["modbus-rtu", "ge-rtu"])
def test_frames_that_silence_ends_hold_nothing_up_for_longer_than_their_greatest_length(name: str) -> None:
    hearing = engine(name, "server")
    most = compiled(name)[0].frames["request_adu"].most
    for number, piece in enumerate(cut(Random(1).randbytes(SIZE), 100)):
        hearing.receive(piece, 1_000_000_000 + 1000 * number)
        assert len(hearing.receiver.stream.buffer) - hearing.receiver.stream.position <= most + 100
    assert hearing.counters.bad > SIZE // (2 * most)
